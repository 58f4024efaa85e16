/* bench_worlds.h - scenes, pictures and how wrong they are, for bench_zbufrand.c - C99 - MIT OR Unlicense, see LICENSE.
   Include it after bench.h, the support headers, zbufrand.h and worlds.h.

   What is right is found by rays: through the centre of a pixel for the exact z-buffer picture, and 16 x 16 jittered ones
   within a pixel for what the pixel should show. They go to every n-th tile of 8 x 8 pixels, errors are those of these
   tiles. Three numbers say how wrong a picture is:
       rmse    of sRGB values 0..1 against the mean of the 256 rays of a pixel
       ssim    of luminance, mean over tiles
       hidden  share of pixels whose depth is that of no surface which any of the 256 rays saw in this pixel (up to 0.5 %):
               they show something that is not visible there */
#ifndef BENCH_WORLDS_H_INCLUDED
#define BENCH_WORLDS_H_INCLUDED
#include "baseline/hit_matrix.h"

static bench_options g_opt;
static double g_busy_sum, g_busy_count; /* wall over CPU seconds of one-thread runs */

static int run_failed(const char *what, const char *why) {
    fprintf(stderr, "bench_zbufrand: %s: %s\n", what, why);
    exit(1);
}
static void must(zbufrand_result r, const char *what) {
    if (r != ZBUFRAND_OK) run_failed(what, zbufrand_result_string(r));
}
static void *must_alloc(size_t n, size_t size) {
    void *p = calloc(n > 0 ? n : 1, size);
    if (p == NULL) run_failed("memory", "not enough");
    return p;
}

/* ---- worlds ---- */

typedef struct world {
    char name[48];
    sup_world w;
    zbufrand_scene_info info;
    double cpu, wall;           /* of the build */
    zbufrand_camera camera;
} world;

static world *world_open(const char *name, uint32_t threads) {
    world *w = (world *)must_alloc(1, sizeof *w);
    zbufrand_scene_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = threads;
    snprintf(w->name, sizeof w->name, "%s", name);
    must(zbufrand_scene_create(&d, &w->w.scene), name);
    return w;
}

static void world_build(world *w) {
    const double wall = bench_wall(), cpu = bench_cpu();
    if (w->w.failed) run_failed(w->name, "cannot be made");
    must(zbufrand_scene_build(w->w.scene, NULL, &w->info), w->name);
    w->cpu = bench_cpu() - cpu;
    w->wall = bench_wall() - wall;
}

/* Build it again with one of the thesis' trees beside the default, or without. */
static void world_structure(world *w, zbufrand_structure structure, uint32_t classes) {
    zbufrand_build_desc d;
    double cpu = bench_cpu();
    memset(&d, 0, sizeof d);
    d.structure = structure;
    d.normal_depth = classes;
    must(zbufrand_scene_build(w->w.scene, &d, &w->info), w->name);
    w->cpu = bench_cpu() - cpu;
}

static void world_free(world *w) {
    sup_world_free(&w->w);
    free(w);
}

static void world_view(world *w, double ex, double ey, double ez, double ax, double ay, double az, double fov) {
    zbufrand_camera *c = &w->camera;
    memset(c, 0, sizeof *c);
    c->eye[0] = ex;
    c->eye[1] = ey;
    c->eye[2] = ez;
    c->at[0] = ax;
    c->at[1] = ay;
    c->at[2] = az;
    c->fov_y = fov;
}

/* One of the cameras that the scene brings along. */
static void world_own_view(world *w, size_t k) {
    const sup_world_view *v = &w->w.views[k];
    world_view(w, (double)v->eye[0], (double)v->eye[1], (double)v->eye[2], (double)v->at[0], (double)v->at[1],
               (double)v->at[2], (double)v->fov);
}

static world *world_named(const char *name, size_t view) {
    world *w = world_open(name, (uint32_t)g_opt.threads);
    if (strcmp(name, "forest") == 0) supi_world_forest(&w->w);
    else if (strcmp(name, "city") == 0) supi_world_city(&w->w, 343478, 2);
    else if (strcmp(name, "city-small") == 0) supi_world_city(&w->w, 177315, 1);
    else if (strcmp(name, "city-low") == 0) supi_world_city(&w->w, 18946, 1);
    else if (strcmp(name, "chess") == 0) supi_world_chess(&w->w, 1280, 1, 0);
    else supi_world_landscape(&w->w);
    world_build(w);
    world_own_view(w, view);
    return w;
}

static supi_make blob_mesh(int rows) {
    supi_make make;
    memset(&make, 0, sizeof make);
    supi_add_blob(&make, 0.0f, 0.0f, 0.0f, 1.0f, 2 * rows, rows, 0.6f, 2.5f, 8, 3.1f);
    return make;
}

/* A displaced sphere of 4 rows^2 triangles, seen as the comparison programs see it. */
static world *world_blob(int rows) {
    char name[32];
    supi_make make = blob_mesh(rows);
    world *w;
    snprintf(name, sizeof name, "blob-%.2gM", 4e-6 * (double)rows * (double)rows);
    w = world_open(name, (uint32_t)g_opt.threads);
    (void)supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, 0);
    world_build(w);
    world_view(w, 0.9, 0.8, 2.4, 0, 0, 0, 50);
    return w;
}

static world *world_hall(int n) {
    supi_make make;
    char name[32];
    world *w;
    memset(&make, 0, sizeof make);
    supi_make_hall(&make, n);
    snprintf(name, sizeof name, "hall-%.2gM", 1e-6 * (double)make.mesh.triangle_count);
    w = world_open(name, (uint32_t)g_opt.threads);
    (void)supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, 0);
    world_build(w);
    world_view(w, -7.7, 0.9, -7.4, 0.5, -0.4, 0.7, 60);
    return w;
}

/* k^3 blobs of 1,048,576 triangles, turned and moved at random. inside: seen from among them. */
static world *world_blobs(int k, int inside) {
    supi_make make = blob_mesh(512);
    const size_t count = (size_t)k * (size_t)k * (size_t)k;
    const double l = 4.0 * (double)k;
    bench_rng rng = {4};
    zbufrand_transform *t;
    zbufrand_node node;
    char name[48];
    world *w;
    size_t i;
    snprintf(name, sizeof name, "%d^3 blobs, %s", k, inside ? "inside" : "outside");
    w = world_open(name, (uint32_t)g_opt.threads);
    node = supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, ZBUFRAND_HIDDEN);
    t = supi_world_array(&w->w, count);
    if (t == NULL) run_failed(name, "not enough memory");
    for (i = 0; i < count; i++) {
        const double turn = 6.28318 * (double)bench_random(&rng), x = (double)(i % (size_t)k),
                     y = (double)(i / (size_t)k % (size_t)k), z = (double)(i / (size_t)k / (size_t)k);
        const double jx = 1.5 * (double)bench_random(&rng), jy = 1.5 * (double)bench_random(&rng);
        t[i] = supi_world_place(4.0 * x + jx, 4.0 * y + jy, 4.0 * z + 1.5 * (double)bench_random(&rng), turn, 1.0);
    }
    must(zbufrand_add_references(w->w.scene, ZBUFRAND_ROOT, t, count, node, NULL), name);
    world_build(w);
    if (inside) world_view(w, 0.5 * l + 2.3, 0.5 * l + 1.9, 0.5 * l + 2.1, l, 0.45 * l, 0.9 * l, 60);
    else world_view(w, -0.6 * l, 0.9 * l, -0.8 * l, 0.5 * l, 0.4 * l, 0.5 * l, 45);
    return w;
}

static void world_set_blobs_inside(world *w, int k, int inside) {
    const double l = 4.0 * (double)k;
    if (inside) world_view(w, 0.5 * l + 2.3, 0.5 * l + 1.9, 0.5 * l + 2.1, l, 0.45 * l, 0.9 * l, 60);
    else world_view(w, -0.6 * l, 0.9 * l, -0.8 * l, 0.5 * l, 0.4 * l, 0.5 * l, 45);
}

/* fields x fields, n x n copies, levels of them; the whole board small in the picture. */
static world *world_chess(int fields, int n, int levels) {
    char name[48];
    world *w;
    snprintf(name, sizeof name, "%dx%d fields, %dx%d, %d levels", fields, fields, n, n, levels);
    w = world_open(name, (uint32_t)g_opt.threads);
    supi_world_chess(&w->w, fields, n, levels);
    world_build(w);
    world_view(w, 0, 3, 6, 0, 0, 0, 45);
    return w;
}

/* The thesis' forest for sweeps: 20 x 20 trees of three models. above: from far above, else over the border with depths
   that differ by a factor of 18. */
static world *world_trees(int above) {
    static const int leaf[3][3] = {{52, 84, 30}, {70, 92, 34}, {88, 96, 30}};
    world *w = world_open(above ? "400 trees from above" : "400 trees, depths 1 to 18", (uint32_t)g_opt.threads);
    zbufrand_node model[3];
    zbufrand_transform *t[3];
    bench_rng rng = {9};
    size_t count[3] = {0, 0, 0};
    int i, k;
    model[0] = supi_world_tree(&w->w, 11, 6.4f, 2.4f, 16, 5, leaf[0], 33000);
    model[1] = supi_world_tree(&w->w, 12, 5.2f, 2.1f, 14, 5, leaf[1], 33000);
    model[2] = supi_world_tree(&w->w, 13, 7.4f, 2.2f, 18, 4, leaf[2], 34000);
    for (k = 0; k < 3; k++) {
        t[k] = supi_world_array(&w->w, 400);
        if (t[k] == NULL) run_failed("trees", "not enough memory");
    }
    for (i = 0; i < 400; i++) {
        const double x = 5.0 * ((double)(i % 20) - 9.5) + (double)bench_random(&rng),
                     z = 5.0 * ((double)(i / 20) - 9.5) + (double)bench_random(&rng);
        k = (int)(bench_random_u32(&rng) % 3u);
        t[k][count[k]++] = supi_world_place(x, 0.0, z, 6.2831853 * (double)bench_random(&rng), 1.0);
    }
    for (k = 0; k < 3; k++)
        must(zbufrand_add_references(w->w.scene, ZBUFRAND_ROOT, t[k], count[k], model[k], NULL), "trees");
    world_build(w);
    if (above) world_view(w, 0, 183, 1, 0, 3, 0, 45);
    else world_view(w, 0, 9.6, 54, 0, 2, 30, 45);
    return w;
}

/* Boxes strewn evenly over a square, three for each unit of area, seen from its middle: half a side is 10^(levels + 1). Squares
   of 20 x 20 with 1,200 boxes of four kinds, in levels of 10 x 10. */
static world *world_ground(int levels) {
    enum { BOXES = 1200 };
    char name[48];
    supi_make make;
    bench_rng rng = {17};
    zbufrand_transform *t;
    zbufrand_node node, list;
    const float lo[3] = {-0.3f, 0.0f, -0.3f}, hi[3] = {0.3f, 1.0f, 0.3f};
    double side = 20.0;
    world *w;
    int l, i;
    snprintf(name, sizeof name, "ground, half a side 1e%d", levels + 1);
    w = world_open(name, (uint32_t)g_opt.threads);
    memset(&make, 0, sizeof make);
    supi_make_colour(&make, 200, 170, 120);
    supi_make_box(&make, lo, hi, 0);
    node = supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, ZBUFRAND_HIDDEN);
    for (l = -1; l < levels; l++) {
        const int count = l < 0 ? BOXES : 100;
        t = supi_world_array(&w->w, (size_t)count);
        if (t == NULL) run_failed(name, "not enough memory");
        for (i = 0; i < count; i++) {
            const double x = (double)bench_random(&rng), z = (double)bench_random(&rng);
            if (l < 0) t[i] = supi_world_place(20.0 * x - 10.0, 0.0, 20.0 * z - 10.0, 6.28 * x, 1.0);
            else t[i] = supi_world_place(side * ((double)(i % 10) - 4.5), 0.0, side * ((double)(i / 10) - 4.5), 1.5707963267948966 * floor(4.0 * x), 1.0);
        }
        if (l >= 0) side *= 10.0;
        must(zbufrand_add_list(w->w.scene, ZBUFRAND_ROOT, NULL, l + 1 < levels ? ZBUFRAND_HIDDEN : 0, &list), name);
        must(zbufrand_add_references(w->w.scene, list, t, (size_t)count, node, NULL), name);
        node = list;
    }
    world_build(w);
    world_view(w, 0, 2, 0, 0, 1.9, -1, 45);
    return w;
}

/* `layers` height fields of 2 n^2 triangles behind one another, which fill the picture; of 32 kinds. */
static world *world_layers(int layers, int n) {
    char name[32];
    zbufrand_node first[SUP_WORLD_MESHES] = {0};
    world *w;
    int k, i, j;
    snprintf(name, sizeof name, "%d layers", layers);
    w = world_open(name, (uint32_t)g_opt.threads);
    for (k = 0; k < layers; k++) {
        supi_make make;
        zbufrand_transform t = supi_world_place(0.0, 0.0, -0.1 * (double)k, 0.0, 1.0 + 0.04 * (double)k);
        if (k >= SUP_WORLD_MESHES) { /* the same again, elsewhere */
            must(zbufrand_add_reference(w->w.scene, ZBUFRAND_ROOT, &t, first[k % SUP_WORLD_MESHES], NULL), name);
            continue;
        }
        memset(&make, 0, sizeof make);
        for (j = 0; j <= n; j++) {
            for (i = 0; i <= n; i++) {
                const float x = 2.0f * (float)i / (float)n - 1.0f, y = 2.0f * (float)j / (float)n - 1.0f;
                (void)supi_make_point(&make, 1.6f * x, 1.2f * y, 0.03f * supi_noise(9.0f * x, 9.0f * y, (float)k));
            }
        }
        for (j = 0; j < n; j++) {
            for (i = 0; i < n; i++) {
                const uint32_t a = (uint32_t)(j * (n + 1) + i), m = (uint32_t)n + 1;
                supi_make_colour(&make, 90 + 37 * k % 150, 90 + 71 * k % 150, 90 + 53 * (i + j) % 150);
                supi_make_quad(&make, a, a + 1, a + m + 1, a + m);
            }
        }
        if (w->w.mesh_count < SUP_WORLD_MESHES && !make.failed) { /* each layer is a mesh of its own, moved back */
            sup_mesh *m = &w->w.meshes[w->w.mesh_count++];
            zbufrand_mesh z;
            *m = make.mesh;
            memset(&z, 0, sizeof z);
            z.positions = m->positions;
            z.vertex_count = m->vertex_count;
            z.indices = m->indices;
            z.triangle_count = m->triangle_count;
            z.triangle_rgb = m->triangle_rgb;
            must(zbufrand_add_mesh(w->w.scene, ZBUFRAND_ROOT, &t, 0, &z, &first[k]), name);
        } else {
            sup_mesh_free(&make.mesh);
        }
    }
    world_build(w);
    world_view(w, 0, 0, 2.5, 0, 0, 0, 45);
    return w;
}

/* ---- pictures ---- */

/* Evenly lit, so that rays are shaded by the same formula without knowing how the library does it. */
static const double g_light[3] = {0.365148, 0.730297, 0.577350};
static const float g_light_color = 0.85f, g_ambient = 0.2f;
static const float g_sky[4] = {0.35f, 0.50f, 0.70f, 1.0f};

typedef struct picture_job {
    zbufrand_frame *frame;
    zbufrand_render_desc desc;
    zbufrand_light light;
    const zbufrand_scene *scene;
    zbufrand_image image;
    zbufrand_stats stats;
    uint32_t mean;              /* frames to be averaged; 0: one */
} picture_job;

static double cpu_clock(void *user) {
    (void)user;
    return bench_cpu();
}

static picture_job picture_open(const world *w, uint32_t width, uint32_t height, uint32_t threads) {
    picture_job p;
    zbufrand_frame_desc fd;
    const size_t pixels = (size_t)width * height;
    int a;
    memset(&p, 0, sizeof p);
    memset(&fd, 0, sizeof fd);
    fd.env.thread_count = threads;
    must(zbufrand_frame_create(&fd, &p.frame), "frame");
    p.scene = w->w.scene;
    p.desc.camera = w->camera;
    p.desc.light_count = 1;
    p.desc.clock_fn = cpu_clock;
    p.light.directional = 1;
    for (a = 0; a < 3; a++) {
        p.light.position[a] = g_light[a];
        p.light.color[a] = g_light_color;
        p.desc.ambient[a] = g_ambient;
    }
    memcpy(p.desc.background, g_sky, sizeof g_sky);
    p.image.width = width;
    p.image.height = height;
    p.image.rgba8 = (uint8_t *)must_alloc(pixels, 4);
    p.image.rgba = (float *)must_alloc(pixels, 16);
    p.image.depth = (float *)must_alloc(pixels, 4);
    return p;
}

static void picture_free(picture_job *p) {
    zbufrand_frame_destroy(p->frame);
    free(p->image.rgba8);
    free(p->image.rgba);
    free(p->image.depth);
    memset(p, 0, sizeof *p);
}

static void picture_run(void *ctx) {
    picture_job *p = (picture_job *)ctx;
    zbufrand_render_desc d = p->desc;
    d.lights = &p->light;
    if (p->mean > 1) { /* that noise is never reached */
        d.noise = 1e-9;
        d.max_frames = p->mean;
    }
    must(zbufrand_render(p->frame, &d, p->scene, &p->image, &p->stats), "render");
}

/* What the thesis takes an ordinary z-buffer for: all triangles in view, one after the other. */
static void picture_raster(picture_job *p, int occlusion) {
    p->desc.hybrid = ZBUFRAND_HYBRID_ALL;
    p->desc.no_occlusion = !occlusion;
    p->desc.no_repair = 1;
}

/* Time it on its own; how busy the machine was goes into the report. rounds 0: what takes seconds, once, without warming
   up. */
static bench_job picture_time(picture_job *p, const char *name, int rounds) {
    bench_job b;
    memset(&b, 0, sizeof b);
    b.name = name;
    if (rounds == 0) {
        const double cpu = bench_cpu(), wall = bench_wall();
        picture_run(p);
        b.cpu[0] = bench_cpu() - cpu;
        b.wall[0] = bench_wall() - wall;
        b.rounds = 1;
        return b;
    }
    b.run = picture_run;
    b.ctx = p;
    bench_interleave(&b, 1, rounds);
    g_busy_sum += bench_busy(&b);
    g_busy_count += 1.0;
    return b;
}

static uint64_t picture_hash(const picture_job *p) {
    return bench_hash_bytes(p->image.rgba8, 4 * (size_t)p->image.width * p->image.height);
}

/* ---- rays ---- */

typedef struct eye_rays { /* rays through a picture */
    const zbufrand_scene *scene;
    zbufrandi_camera camera;
} eye_rays;

static eye_rays rays_open(const picture_job *p) {
    eye_rays r;
    r.scene = p->scene;
    must(zbufrandi_camera_open(&p->desc.camera, p->scene, p->image.width, p->image.height, 0, &r.camera), "camera");
    return r;
}

static void ray_at(const eye_rays *r, double x, double y, zbufrandi_ray *ray) {
    const zbufrandi_camera *c = &r->camera;
    const double u = (x - c->center_x) / c->focal, v = (c->center_y - y) / c->focal;
    int a;
    for (a = 0; a < 3; a++) {
        ray->o[a] = c->eye[a] - r->scene->structure[0].origin[a];
        ray->d[a] = c->dir[a] + u * c->right[a] + v * c->up[a];
    }
    ray->t_min = c->near_z;
    ray->t_max = c->far_z;
}

/* Colour of a hit, linear. */
static void ray_color(const eye_rays *r, const zbufrandi_ray *ray, const zbufrandi_ray_hit *hit, const zbufrandi_srgb *srgb,
                      float rgb[3]) {
    const zbufrandi_structure *s = &r->scene->structure[hit->structure];
    const zbufrandi_cluster *c;
    const uint8_t *tri;
    float bary[3], n[3];
    double m[3][4], q[3], face[3], e[2][3], dot = 0.0, toward = 0.0, length = 0.0;
    const float *v[3];
    uint32_t k, a, t, code;
    if (!(hit->t < (double)INFINITY)) {
        memcpy(rgb, g_sky, 3 * sizeof rgb[0]);
        return;
    }
    c = &s->cluster[hit->cluster];
    t = hit->triangle - c->first_triangle;
    tri = s->triangle + 3 * (size_t)hit->triangle;
    bary[0] = 1.0f - hit->u - hit->v;
    bary[1] = hit->u;
    bary[2] = hit->v;
    for (k = 0; k < 3; k++) v[k] = s->position + 3 * ((size_t)c->first_vertex + tri[k]);
    for (a = 0; a < 3; a++) {
        e[0][a] = (double)v[1][a] - (double)v[0][a];
        e[1][a] = (double)v[2][a] - (double)v[0][a];
    }
    zbufrandi_cross3(e[0], e[1], face);
    memcpy(q, face, sizeof q);
    if (c->flags & ZBUFRANDI_HAS_NORMALS) {
        zbufrandi_point_normal(s, c, t, bary, n);
        for (a = 0; a < 3; a++) q[a] = (double)n[a];
    }
    baseline_hit_matrix(r->scene->rays, hit, m);
    for (a = 0; a < 3; a++) {
        const double turned = m[a][0] * q[0] + m[a][1] * q[1] + m[a][2] * q[2];
        dot += turned * g_light[a];
        toward += (m[a][0] * face[0] + m[a][1] * face[1] + m[a][2] * face[2]) * ray->d[a]; /* which side is seen */
        length += turned * turned;
    }
    if (toward > 0.0) dot = -dot;
    dot = dot > 0.0 && length > 0.0 ? dot / sqrt(length) : 0.0;
    code = zbufrandi_point_rgb(s, c, t, bary, srgb);
    for (a = 0; a < 3; a++)
        rgb[a] = srgb->linear[code >> 8 * a & 255u] * (g_ambient + g_light_color * (float)dot);
}

typedef struct cast_job { /* one ray a pixel, in small tiles; rows of tiles: one of `every` */
    eye_rays rays;
    uint32_t width, height, every;
    float *depth;
    size_t cast, hits;
} cast_job;

static void cast_run(void *ctx) {
    cast_job *j = (cast_job *)ctx;
    zbufrandi_ray ray[32];
    static zbufrandi_ray_hit hit[32]; /* 10 KB */
    uint32_t x, y, k, n;
    j->cast = j->hits = 0;
    for (y = 0; y + 4 <= j->height; y += 4 * j->every) {
        for (x = 0; x < j->width; x += 8) {
            for (k = 0, n = 0; k < 32; k++)
                if (x + k % 8 < j->width) ray_at(&j->rays, (double)(x + k % 8) + 0.5, (double)(y + k / 8) + 0.5, &ray[n++]);
            j->hits += zbufrandi_ray_cast_many(j->rays.scene->rays, ray, n, hit, NULL, NULL);
            j->cast += n;
            for (k = 0, n = 0; k < 32; k++)
                if (x + k % 8 < j->width) j->depth[(size_t)(y + k / 8) * j->width + x + k % 8] = (float)hit[n++].t;
        }
    }
}

/* ---- what is right ---- */

enum { TILE = 8, SPP = 256 };

typedef struct truth {
    eye_rays rays;
    uint32_t width, height, tile_count;
    uint32_t *tile;             /* corner: y * width + x */
    float *mean;                /* linear rgb of each pixel of the tiles, of 256 rays */
    float *few;                 /* the same of the first 4, 16, 64 rays: [3][pixel][3] */
    float *exact, *exact_depth; /* of the ray through its centre */
    float *depth;               /* of the 256 rays, ascending */
    const zbufrandi_srgb *srgb;
    uint32_t next;              /* of the tiles, for threads */
} truth;

static int compare_float(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static void truth_pixel(truth *t, size_t at, uint32_t x, uint32_t y, zbufrandi_ray *ray, zbufrandi_ray_hit *hit) {
    bench_rng rng = {(uint64_t)y * 100003u + x + 1};
    double sum[3] = {0, 0, 0};
    uint32_t i, a, k = 0;
    for (i = 0; i < SPP; i++) { /* strata of 16 x 16; the first 4^n rays are a stratified set themselves */
        uint32_t sx = 0, sy = 0, b;
        for (b = 0; b < 4; b++) { /* bits of i, highest strata first; within each of the others in any order, or the first ones
                                     would all lie in the same corner of theirs */
            const uint64_t h = bench_mix(bench_mix((uint64_t)y * 100003u + x, b + 1), i & ((1u << 2 * b) - 1u));
            sx |= ((i >> 2 * b ^ (uint32_t)(h >> 40)) & 1u) << (3 - b);
            sy |= ((i >> (2 * b + 1) ^ i >> 2 * b ^ (uint32_t)(h >> 41)) & 1u) << (3 - b);
        }
        ray_at(&t->rays, (double)x + ((double)sx + (double)bench_random(&rng)) / 16.0,
               (double)y + ((double)sy + (double)bench_random(&rng)) / 16.0, &ray[i]);
    }
    (void)zbufrandi_ray_cast_many(t->rays.scene->rays, ray, SPP, hit, NULL, NULL);
    for (i = 0; i < SPP; i++) {
        float rgb[3];
        ray_color(&t->rays, &ray[i], &hit[i], t->srgb, rgb);
        for (a = 0; a < 3; a++) sum[a] += (double)rgb[a];
        t->depth[SPP * at + i] = (float)hit[i].t;
        if (i == 3 || i == 15 || i == 63) {
            float *few = t->few + 3 * ((size_t)k * t->tile_count * TILE * TILE + at);
            for (a = 0; a < 3; a++) few[a] = (float)(sum[a] / (double)(i + 1));
            k++;
        }
    }
    for (a = 0; a < 3; a++) t->mean[3 * at + a] = (float)(sum[a] / (double)SPP);
    qsort(t->depth + SPP * at, SPP, sizeof(float), compare_float);
    ray_at(&t->rays, (double)x + 0.5, (double)y + 0.5, &ray[0]);
    (void)zbufrandi_ray_cast(t->rays.scene->rays, &ray[0], &hit[0], NULL, 0);
    ray_color(&t->rays, &ray[0], &hit[0], t->srgb, t->exact + 3 * at);
    t->exact_depth[at] = (float)hit[0].t;
}

static void truth_task(void *ctx, uint32_t tile) {
    truth *t = (truth *)ctx;
    zbufrandi_ray *ray = (zbufrandi_ray *)must_alloc(SPP, sizeof *ray);
    zbufrandi_ray_hit *hit = (zbufrandi_ray_hit *)must_alloc(SPP, sizeof *hit);
    uint32_t k;
    for (k = 0; k < TILE * TILE; k++) {
        truth_pixel(t, (size_t)tile * TILE * TILE + k, t->tile[tile] % t->width + k % TILE, t->tile[tile] / t->width + k / TILE,
                    ray, hit);
    }
    free(ray);
    free(hit);
}

/* every: of the tiles. */
static truth *truth_make(const picture_job *p, uint32_t every) {
    truth *t = (truth *)must_alloc(1, sizeof *t);
    zbufrandi_srgb *srgb = (zbufrandi_srgb *)must_alloc(1, sizeof *srgb);
    zbufrand_env env;
    size_t pixels;
    uint32_t x, y, n = 0;
    memset(&env, 0, sizeof env);
    env.thread_count = (uint32_t)g_opt.threads;
    zbufrandi_srgb_open(srgb);
    t->srgb = srgb;
    t->rays = rays_open(p);
    t->width = p->image.width;
    t->height = p->image.height;
    t->tile = (uint32_t *)must_alloc((size_t)(t->width / TILE) * (t->height / TILE), sizeof *t->tile);
    for (y = 0; y + TILE <= t->height; y += TILE) {
        for (x = 0; x + TILE <= t->width; x += TILE) {
            if (n++ % every == 0) t->tile[t->tile_count++] = y * t->width + x;
        }
        n += 5; /* not one below the other */
    }
    pixels = (size_t)t->tile_count * TILE * TILE;
    t->mean = (float *)must_alloc(3 * pixels, sizeof(float));
    t->few = (float *)must_alloc(9 * pixels, sizeof(float));
    t->exact = (float *)must_alloc(3 * pixels, sizeof(float));
    t->exact_depth = (float *)must_alloc(pixels, sizeof(float));
    t->depth = (float *)must_alloc(SPP * pixels, sizeof(float));
    zbufrandi_parallel_for(&env, truth_task, t, t->tile_count);
    return t;
}

static void truth_free(truth *t) {
    free((void *)(uintptr_t)t->srgb);
    free(t->tile);
    free(t->mean);
    free(t->few);
    free(t->exact);
    free(t->exact_depth);
    free(t->depth);
    free(t);
}

/* ---- what several benchmarks use: made once, kept to the end ---- */

enum { SHARED_FOREST, SHARED_BLOB, SHARED_CITY, SHARED_COUNT };
static world *g_shared[SHARED_COUNT];
static struct { const world *w; size_t view; truth *t; } g_truths[16];
static int g_truth_count;

/* The forest of 6.8*10^11 triangles, a blob of 8.4 M, the city of 17.7 M; seen from view `view` of their own. */
static world *shared_world(int id, size_t view) {
    if (g_shared[id] == NULL) {
        g_shared[id] = id == SHARED_FOREST ? world_named("forest", view) : id == SHARED_CITY ? world_named("city-small", view) :
                       world_blob(1448);
    }
    if (id != SHARED_BLOB) {
        world_own_view(g_shared[id], view);
        snprintf(g_shared[id]->name, sizeof g_shared[id]->name, "%s-%u", id == SHARED_FOREST ? "forest" : "city-small",
                 (unsigned)view + 1);
    }
    return g_shared[id];
}

/* Of a shared world, in its one size of picture. */
static const truth *shared_truth(const world *w, size_t view, const picture_job *p) {
    int i;
    for (i = 0; i < g_truth_count; i++) if (g_truths[i].w == w && g_truths[i].view == view) return g_truths[i].t;
    if (g_truth_count == 16) run_failed("truths", "too many");
    g_truths[g_truth_count].w = w;
    g_truths[g_truth_count].view = view;
    g_truths[g_truth_count].t = truth_make(p, g_opt.full ? 8 : w == g_shared[SHARED_FOREST] ? 128 : 48);
    return g_truths[g_truth_count++].t;
}

static void shared_free(void) {
    int i;
    while (g_truth_count > 0) truth_free(g_truths[--g_truth_count].t);
    for (i = 0; i < SHARED_COUNT; i++) if (g_shared[i] != NULL) world_free(g_shared[i]);
}

/* ---- how wrong ---- */

typedef struct wrong {
    double rmse, ssim, hidden;
    double rmse_exact;          /* against the exact z-buffer picture */
    double holes;               /* share of pixels that show nothing though all rays met something */
    double psnr;
} wrong;

static double shown(double linear) { return zbufrandi_linear_to_srgb(linear < 0.0 ? 0.0 : linear > 1.0 ? 1.0 : linear); }

static double luminance(const float *c) {
    return 0.2126 * shown((double)c[0]) + 0.7152 * shown((double)c[1]) + 0.0722 * shown((double)c[2]);
}

static double tile_ssim(const double *a, const double *b) {
    double ma = 0, mb = 0, va = 0, vb = 0, cov = 0;
    int i;
    for (i = 0; i < TILE * TILE; i++) {
        ma += a[i] / (TILE * TILE);
        mb += b[i] / (TILE * TILE);
    }
    for (i = 0; i < TILE * TILE; i++) {
        va += (a[i] - ma) * (a[i] - ma) / (TILE * TILE - 1);
        vb += (b[i] - mb) * (b[i] - mb) / (TILE * TILE - 1);
        cov += (a[i] - ma) * (b[i] - mb) / (TILE * TILE - 1);
    }
    return (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4));
}

/* Is depth z that of something visible in the pixel? depth: ascending. */
static int depth_visible(const float *depth, float z) {
    int lo = 0, hi = SPP;
    if (!(z < INFINITY)) return !(depth[SPP - 1] < INFINITY);
    while (lo < hi) {
        const int mid = (lo + hi) / 2;
        if (depth[mid] < z) lo = mid + 1;
        else hi = mid;
    }
    if (lo < SPP && depth[lo] - z <= 0.005f * z) return 1;
    return lo > 0 && z - depth[lo - 1] <= 0.005f * z;
}

/* rgba: stride floats a pixel, over the background; `rgb3` are the colours of the pixels of the tiles alone; depth may be NULL. */
static wrong judge(const truth *t, const float *rgba, const float *rgb3, const float *depth, const float *depth3) {
    wrong w;
    double sum = 0.0, exact = 0.0;
    uint32_t tile, k, a;
    const double pixels = (double)t->tile_count * TILE * TILE;
    memset(&w, 0, sizeof w);
    for (tile = 0; tile < t->tile_count; tile++) {
        double la[TILE * TILE], lb[TILE * TILE];
        for (k = 0; k < TILE * TILE; k++) {
            const size_t at = (size_t)tile * TILE * TILE + k;
            const size_t pixel = (size_t)t->tile[tile] + (size_t)(k / TILE) * t->width + k % TILE;
            const float *c = rgba != NULL ? rgba + 4 * pixel : rgb3 + 3 * at;
            const float z = depth != NULL ? depth[pixel] : depth3 != NULL ? depth3[at] : 0.0f;
            for (a = 0; a < 3; a++) {
                const double d = shown((double)c[a]) - shown((double)t->mean[3 * at + a]),
                             e = shown((double)c[a]) - shown((double)t->exact[3 * at + a]);
                sum += d * d;
                exact += e * e;
            }
            la[k] = luminance(c);
            lb[k] = luminance(t->mean + 3 * at);
            if (depth == NULL && depth3 == NULL) continue;
            w.hidden += !depth_visible(t->depth + SPP * at, z);
            w.holes += !(z < INFINITY) && t->depth[SPP * at + SPP - 1] < INFINITY;
        }
        w.ssim += tile_ssim(la, lb) / (double)t->tile_count;
    }
    w.rmse = sqrt(sum / (3.0 * pixels));
    w.rmse_exact = sqrt(exact / (3.0 * pixels));
    w.hidden /= pixels;
    w.holes /= pixels;
    w.psnr = w.rmse > 0.0 ? -20.0 * log10(w.rmse) : 99.0;
    return w;
}

static void wrong_nums(const wrong *w) {
    bench_num("psnr", w->psnr);
    bench_num("ssim", w->ssim);
    bench_num("hidden_share", w->hidden);
    bench_num("holes_share", w->holes);
    bench_num("rmse_exact", w->rmse_exact);
}

/* ---- the acceptance table ---- */

static bench_row g_rows[] = {
    {"points", "area-weighted points in random order, position and normal", "M/s/core", "40", "150", ""},
    {"kernel", "stored samples: decode, cull, project, depth test, payload", "M/s/core", "100", "300", ""},
    {"dense", "whole frame, samples accepted, dense (blob of 8.4 M, all sampled)", "M/s/core", "15", "40", ""},
    {"sparse", "the same, sparse (forest of 6.8*10^11)", "M/s/core", "5", "15", ""},
    {"blob-8M", "8.4 M triangles, 1024x768, Gaussian of radius 1.1; holes; PSNR against 256 samples", "ms", "120; 0.1 %; 30 dB", "30", ""},
    {"huge", "1.05*10^12 instanced triangles, 1024x768, from outside / inside", "ms", "250", "60", ""},
    {"growth", "growth from 10^6 to 10^12 triangles, same view", "times", "4", "2", ""},
    {"chess", "1.3*10^13 triangles against 32, same projected area", "times", "1.5", "1.2", ""},
    {"level", "one more level of instances", "", "+5 %", "+3 %", ""},
    {"overview", "forest, 6.8*10^11 triangles, overview, 640x480, d=2", "ms", "250", "60", ""},
    {"trees", "forest, depths 1 to 18, 640x480, d=2", "ms", "80", "40", ""},
    {"city", "city, 1.9 M triangles, 640x480", "ms", "60", "30", ""},
    {"raster", "our rasteriser on small triangles (blob of 8.4 M)", "M triangles/s/core", "20", "40", ""},
    {"never", "against our own rasteriser, worst scene of the set, by CPU time", "times", "1.05", "1", ""},
    {"rays", "against rays through our own tree, at the errors of 1, 4 and 16 rays a pixel: forest / over the crowns / among the trees / "
     "400 trees", "times faster", "1", "3", ""},
    {"sweep", "error-driven cut against the best cell of each parameter sweep (worst): the thesis' program / ours with its cut", "times", "1",
     "< 1 everywhere", ""},
    {"complete", "samples per pixel for a complete picture with probability 0.95 (rays per 1000 pixels)", "", "6.5",
     "3 + repair", ""},
    {"build", "build of 10^6 triangles, wall with --threads (CPU)", "s", "0.6", "0.15", ""},
    {"memory", "memory of that, everything in, per triangle", "B", "48", "24", ""},
    {"edit", "move / insert / insert new: object of 10^4 triangles", "ms", "2", "0.2", ""}
};

static bench_table g_table = {g_rows, sizeof g_rows / sizeof g_rows[0], "One core by CPU time, but for what says otherwise", "table_zbufrand.md"};
#define table_set(...) bench_table_set(&g_table, __VA_ARGS__)

#endif
