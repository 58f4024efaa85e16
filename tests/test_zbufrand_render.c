/* Pictures: against a z-buffer in double precision; the same for any threads and instruction set; what is promised about
   completeness and noise is kept; odd cameras, sizes, memory. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "zbufrand_shapes.h"

static zbufrand_scene *render_scene_of(const zbufrand_mesh *m, uint32_t count) {
    zbufrand_scene *s = NULL;
    zbufrand_build_desc b;
    uint32_t i;
    memset(&b, 0, sizeof b);
    b.ids = 1;
    if (zbufrand_scene_create(NULL, &s) != ZBUFRAND_OK) abort();
    for (i = 0; i < count; i++) CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m[i], NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, &b, NULL), ZBUFRAND_OK);
    return s;
}

static zbufrand_frame *open_frame(uint32_t threads, zbufrand_isa isa) {
    zbufrand_frame_desc d;
    zbufrand_frame *f = NULL;
    memset(&d, 0, sizeof d);
    d.env.thread_count = threads;
    d.isa = isa;
    CHECK_EQ_U64(zbufrand_frame_create(&d, &f), ZBUFRAND_OK);
    if (f == NULL) abort();
    return f;
}

typedef struct buffers {
    zbufrand_image image;
    uint8_t *rgba8;
    float *rgba, *depth;
    uint32_t *node;
} buffers;

static void buffers_open(buffers *b, uint32_t w, uint32_t h) {
    size_t n = (size_t)w * h;
    memset(b, 0, sizeof *b);
    b->image.width = w;
    b->image.height = h;
    b->image.rgba8 = b->rgba8 = (uint8_t *)malloc(4 * n);
    b->image.rgba = b->rgba = (float *)malloc(16 * n);
    b->image.depth = b->depth = (float *)malloc(4 * n);
    b->image.node = b->node = (uint32_t *)malloc(4 * n);
    if (b->rgba8 == NULL || b->rgba == NULL || b->depth == NULL || b->node == NULL) abort();
}
static void buffers_close(buffers *b) {
    free(b->rgba8);
    free(b->rgba);
    free(b->depth);
    free(b->node);
}
static uint64_t buffers_hash(const buffers *b) {
    size_t n = (size_t)b->image.width * b->image.height;
    return test_fnv1a(b->node, 4 * n, test_fnv1a(b->depth, 4 * n, test_fnv1a(b->rgba, 16 * n, test_fnv1a(b->rgba8, 4 * n, 0))));
}

/* ---- oracle: nearest depth at sub-pixel positions, k x k in each pixel, of one mesh ---- */

typedef struct exact {
    uint32_t w, h, k;
    double *z;
    uint32_t *triangle, now; /* which one is nearest; NULL: nobody asks */
} exact;

static void exact_open(exact *e, uint32_t w, uint32_t h, uint32_t k) {
    size_t i, n = (size_t)w * h * k * k;
    e->w = w;
    e->h = h;
    e->k = k;
    e->triangle = NULL;
    e->now = 0;
    e->z = (double *)malloc(n * sizeof *e->z);
    if (e->z == NULL) abort();
    for (i = 0; i < n; i++) e->z[i] = (double)INFINITY;
}

static void exact_triangle(exact *e, const zbufrandi_camera *c, const double *p0, const double *p1, const double *p2, int two_sided) {
    const double *p[3];
    double q[3][3], x[3], y[3], iz[3], area, lo_x = 1e300, hi_x = -1e300, lo_y = 1e300, hi_y = -1e300;
    int i, a;
    int64_t ix, iy, x0, x1, y0, y1, W = (int64_t)e->w * e->k, H = (int64_t)e->h * e->k;
    p[0] = p0;
    p[1] = p1;
    p[2] = p2;
    for (i = 0; i < 3; i++) {
        q[i][0] = q[i][1] = q[i][2] = 0;
        for (a = 0; a < 3; a++) {
            double d = p[i][a] - c->eye[a];
            q[i][0] += d * c->right[a];
            q[i][1] += d * c->up[a];
            q[i][2] += d * c->dir[a];
        }
        if (q[i][2] <= c->near_z) return; /* the oracle's scenes lie in front */
        iz[i] = 1 / q[i][2];
        x[i] = (c->center_x + c->focal * q[i][0] * iz[i]) * e->k;
        y[i] = (c->center_y - c->focal * q[i][1] * iz[i]) * e->k;
        lo_x = fmin(lo_x, x[i]);
        hi_x = fmax(hi_x, x[i]);
        lo_y = fmin(lo_y, y[i]);
        hi_y = fmax(hi_y, y[i]);
    }
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]); /* rows count downward: the front has it negative */
    if (area == 0 || (area > 0 && !two_sided)) return;
    x0 = lo_x > 0 ? (int64_t)lo_x : 0;
    x1 = hi_x < (double)W ? (int64_t)hi_x : W - 1;
    y0 = lo_y > 0 ? (int64_t)lo_y : 0;
    y1 = hi_y < (double)H ? (int64_t)hi_y : H - 1;
    for (iy = y0; iy <= y1; iy++) {
        for (ix = x0; ix <= x1; ix++) {
            double px = (double)ix + 0.5, py = (double)iy + 0.5, w[3], z;
            for (i = 0; i < 3; i++) {
                int j = (i + 1) % 3, k = (i + 2) % 3;
                w[i] = ((x[j] - px) * (y[k] - py) - (x[k] - px) * (y[j] - py)) / area;
            }
            if (w[0] < 0 || w[1] < 0 || w[2] < 0) continue;
            z = 1 / (w[0] * iz[0] + w[1] * iz[1] + w[2] * iz[2]);
            if (!(z < e->z[iy * W + ix])) continue;
            e->z[iy * W + ix] = z;
            if (e->triangle != NULL) e->triangle[iy * W + ix] = e->now;
        }
    }
}

static void exact_mesh(exact *e, const zbufrandi_camera *c, const zbufrand_mesh *m) {
    size_t t;
    int k, a;
    for (t = 0; t < m->triangle_count; t++) {
        double p[3][3];
        for (k = 0; k < 3; k++) for (a = 0; a < 3; a++) p[k][a] = (double)m->positions[3 * m->indices[3 * t + (size_t)k] + (size_t)a];
        e->now = (uint32_t)t;
        exact_triangle(e, c, p[0], p[1], p[2], (int)m->two_sided);
    }
}

/* Nearest and farthest of what is seen in a pixel; *share: how much of it is covered. */
static void exact_pixel(const exact *e, uint32_t x, uint32_t y, double *lo, double *hi, double *share) {
    uint32_t i, j, n = 0;
    *lo = (double)INFINITY;
    *hi = -(double)INFINITY;
    for (j = 0; j < e->k; j++) {
        for (i = 0; i < e->k; i++) {
            double z = e->z[((size_t)y * e->k + j) * e->w * e->k + (size_t)x * e->k + i];
            if (!(z < (double)INFINITY)) continue;
            *lo = fmin(*lo, z);
            *hi = fmax(*hi, z);
            n++;
        }
    }
    *share = (double)n / (e->k * e->k);
}

/* ---- pictures look like those of a z-buffer ---- */

typedef struct verdict { uint32_t covered, missing, wrong, extra; double worst; } verdict;

/* Pixels that are covered with all their neighbours have to show a depth that occurs in them (a little more, as depths are those of
   planes at the centre); pixels without anything near have to be empty. */
static void judge(const exact *e, const float *depth, double slack, verdict *v) {
    uint32_t x, y;
    int i, j;
    memset(v, 0, sizeof *v);
    for (y = 0; y < e->h; y++) {
        for (x = 0; x < e->w; x++) {
            double lo = (double)INFINITY, hi = -(double)INFINITY, least = 1, most = 0, z = (double)depth[(size_t)y * e->w + x];
            for (j = -1; j <= 1; j++) {
                for (i = -1; i <= 1; i++) {
                    double a, b, share;
                    if ((int)x + i < 0 || (int)y + j < 0 || (int)x + i >= (int)e->w || (int)y + j >= (int)e->h) continue;
                    exact_pixel(e, (uint32_t)((int)x + i), (uint32_t)((int)y + j), &a, &b, &share);
                    lo = fmin(lo, a);
                    hi = fmax(hi, b);
                    least = fmin(least, share);
                    most = fmax(most, share);
                }
            }
            if (most == 0) {
                v->extra += z < (double)INFINITY;
            } else if (least == 1) {
                v->covered++;
                v->missing += !(z < (double)INFINITY);
                if (z < (double)INFINITY && (z > hi * (1 + slack) || z < lo * (1 - slack))) {
                    v->wrong++;
                    v->worst = fmax(v->worst, z / hi);
                }
            }
        }
    }
}

/* Square pixels that a triangle covers, if it faces the eye; of what lies in the picture as a whole. */
static double exact_area(const zbufrandi_camera *c, const zbufrand_mesh *m, size_t t, double w, double h) {
    double x[3], y[3], area;
    int k, a;
    for (k = 0; k < 3; k++) {
        double q[3] = {0, 0, 0};
        for (a = 0; a < 3; a++) {
            double d = (double)m->positions[3 * m->indices[3 * t + (size_t)k] + (size_t)a] - c->eye[a];
            q[0] += d * c->right[a];
            q[1] += d * c->up[a];
            q[2] += d * c->dir[a];
        }
        x[k] = c->center_x + c->focal * q[0] / q[2];
        y[k] = c->center_y - c->focal * q[1] / q[2];
        if (x[k] < 0 || x[k] > w || y[k] < 0 || y[k] > h) return 0;
    }
    area = (y[1] - y[0]) * (x[2] - x[0]) - (x[1] - x[0]) * (y[2] - y[0]);
    return area > 0 ? 0.5 * area : 0;
}

static void three_balls(shape *s, uint32_t rings) { /* one before the other */
    memset(s, 0, sizeof *s);
    shape_sphere(s, 0, 0, 0, 1, rings);
    shape_sphere(s, 0.9, 0.5, 1.5, 0.5, rings);
    shape_sphere(s, -1, 0.2, -2, 1.2, rings);
    shape_torus(s, 0, 0, -4, 2, 0.7, 2 * rings, rings);
}

TEST(like_a_z_buffer) {
    static const zbufrand_hybrid modes[3] = {ZBUFRAND_HYBRID_AUTO, ZBUFRAND_HYBRID_OFF, ZBUFRAND_HYBRID_ALL};
    uint32_t rings, k, i;
    for (rings = 10; rings <= (test_quick() ? 40u : 160u); rings *= 4) {
        shape s;
        zbufrand_mesh m;
        zbufrand_scene *scene;
        zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        zbufrandi_camera camera;
        exact e;
        buffers b;
        three_balls(&s, rings);
        m = mesh_of(&s);
        scene = render_scene_of(&m, 1);
        exact_open(&e, 200, 150, 9); /* slivers between outlines are seen, too */
        buffers_open(&b, 200, 150);
        for (k = 0; k < 3; k++) {
            zbufrand_render_desc d;
            zbufrand_stats st;
            verdict v;
            memset(&d, 0, sizeof d);
            d.camera.eye[0] = 2;
            d.camera.eye[1] = 1.5;
            d.camera.eye[2] = 9;
            d.camera.at[2] = -1;
            d.hybrid = modes[k];
            d.no_plane_depth = 1; /* the plane of a steep triangle may leave it before the centre of the pixel */
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
            if (k == 0) {
                CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, 200, 150, 0, &camera), ZBUFRAND_OK);
                exact_mesh(&e, &camera, &m);
            }
            judge(&e, b.depth, 0.002, &v);
            CHECK(v.covered > 3000);
            CHECK_MSG(v.missing == 0 && v.wrong == 0 && v.extra == 0, "rings %u, mode %u: of %u pixels %u are empty, %u wrong (%g), %u too many", rings, k,
                      v.covered, v.missing, v.wrong, v.worst, v.extra);
            CHECK(st.incomplete <= 0.05 && st.covered > 3000);
            { /* front faces, hidden ones, too: what they cover together */
                zbufrand_stats all;
                double area = 0;
                for (i = 0; i < m.triangle_count; i++) area += exact_area(&camera, &m, i, 200, 150);
                d.no_occlusion = 1;
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &all), ZBUFRAND_OK);
                CHECK_MSG(fabs(all.projected_area / area - 1) < 0.02, "mode %u: area %g of %g", k, all.projected_area, area);
                CHECK(st.projected_area < 1.02 * area && st.projected_area > 0.98 * (double)st.covered);
            }
            for (i = 0; i < 200 * 150; i++) {
                int shown = b.depth[i] < INFINITY;
                CHECK(b.rgba8[4 * i + 3] == (shown ? 255 : 0));
                CHECK((b.rgba[4 * i + 3] == 1.0f) == shown);
                if (!shown) CHECK(b.rgba[4 * i] == 0.0f && b.node[i] == 0);
            }
        }
        buffers_close(&b);
        free(e.z);
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
}

static void note_triangles(void *user, const zbufrand_surface *s, size_t count, float *rgba) {
    uint32_t *triangle = (uint32_t *)user;
    size_t i;
    for (i = 0; i < count; i++) {
        triangle[s[i].pixel] = s[i].triangle;
        memset(rgba + 4 * i, 0, 4 * sizeof *rgba);
    }
}

/* A correct picture (Definition 3): what a pixel shows is visible somewhere in it. Bodies before one another, far enough apart that
   samples tell them apart; by 32 x 32 places in each pixel, which miss what is smaller. */
TEST(shows_what_is_visible) {
    enum { W = 72, H = 54, K = 32 };
    static uint32_t shown[W * H];
    const zbufrand_hybrid ways[3] = {ZBUFRAND_HYBRID_OFF, ZBUFRAND_HYBRID_AUTO, ZBUFRAND_HYBRID_ALL};
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    uint32_t looked[3] = {0, 0, 0}, wrong[3] = {0, 0, 0}, view, way, seed, x, y, i, j;
    zbufrand_scene *scene;
    zbufrand_mesh m;
    buffers b;
    shape s;
    exact e;
    three_balls(&s, 16);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    exact_open(&e, W, H, K);
    e.triangle = (uint32_t *)malloc((size_t)W * H * K * K * sizeof *e.triangle);
    REQUIRE(e.triangle != NULL);
    buffers_open(&b, W, H);
    for (view = 0; view < (test_quick() ? 1u : 4u); view++) {
        zbufrand_render_desc d;
        zbufrandi_camera camera;
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = 6 * cos(0.5 + 1.7 * view);
        d.camera.eye[1] = 1.5 - view;
        d.camera.eye[2] = 6 * sin(0.5 + 1.7 * view);
        d.shade_fn = note_triangles;
        d.shade_user = shown;
        CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, W, H, 0, &camera), ZBUFRAND_OK);
        for (i = 0; i < W * H * K * K; i++) e.z[i] = (double)INFINITY;
        exact_mesh(&e, &camera, &m);
        for (way = 0; way < 3; way++) {
            for (seed = 0; seed < (way == 2 ? 1u : 3u); seed++) {
                d.hybrid = ways[way];
                d.seed = seed;
                memset(shown, 0xff, sizeof shown);
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
                for (y = 0; y < H; y++) {
                    for (x = 0; x < W; x++) {
                        int visible = 0;
                        if (shown[y * W + x] == ~0u) continue; /* nothing, or a stored point */
                        for (j = y * K; j < (y + 1) * K && !visible; j++)
                            for (i = x * K; i < (x + 1) * K; i++)
                                visible |= e.z[j * (W * K) + i] < (double)INFINITY && e.triangle[j * (W * K) + i] == shown[y * W + x];
                        looked[way]++;
                        wrong[way] += !visible;
                    }
                }
            }
        }
    }
    for (way = 0; way < 3; way++) {
        if (test_g.verbose) printf("way %u: %u of %u pixels show what is not visible in them\n", way, wrong[way], looked[way]);
        CHECK_MSG(looked[way] > 1000 && wrong[way] * 1000u <= looked[way], "way %u: %u of %u pixels", way, wrong[way], looked[way]);
    }
    free(e.triangle);
    free(e.z);
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* Rastered pictures are exact at the centres of pixels. */
TEST(raster_is_exact) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = open_frame(2, ZBUFRAND_ISA_AUTO);
    zbufrandi_camera camera;
    zbufrand_render_desc d;
    exact e;
    buffers b;
    uint32_t i, off = 0, both = 0;
    three_balls(&s, 40);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    exact_open(&e, 200, 150, 1);
    buffers_open(&b, 200, 150);
    memset(&d, 0, sizeof d);
    d.camera.eye[0] = 2;
    d.camera.eye[2] = 9;
    d.hybrid = ZBUFRAND_HYBRID_ALL;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, 200, 150, 0, &camera), ZBUFRAND_OK);
    exact_mesh(&e, &camera, &m);
    for (i = 0; i < 200 * 150; i++) {
        if ((e.z[i] < (double)INFINITY) != (b.depth[i] < INFINITY)) {
            off++; /* vertices are rounded to 1/4096 pixel */
        } else if (e.z[i] < (double)INFINITY) {
            both++;
            off += fabs((double)b.depth[i] / e.z[i] - 1) > 1e-4;
        }
    }
    CHECK(both > 5000);
    CHECK_MSG(off < both / 500, "%u of %u pixels differ", off, both);
    buffers_close(&b);
    free(e.z);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* ---- the same picture ---- */

static void parallel_backwards(zbufrand_task_fn *task, void *ctx, uint32_t count, void *user) {
    (void)user;
    while (count > 0) task(ctx, --count);
}

static zbufrand_scene *forest(shape *s, uint32_t n) { /* colourful, two-sided, nested, mirrored */
    zbufrand_scene *scene = NULL;
    zbufrand_node lib, leaf, ball, tree;
    zbufrand_mesh m;
    test_rng r = test_rng_make(9);
    static uint8_t rgb[3 * 20000];
    uint32_t i, a, b;
    zbufrand_transform t;
    memset(s, 0, 2 * sizeof *s);
    for (i = 0; i < 400; i++) { /* leaves */
        double c[3], e = 0.1;
        uint32_t v[3];
        for (a = 0; a < 3; a++) c[a] = 2 * test_rng_double(&r) - 1;
        for (a = 0; a < 3; a++) v[a] = shape_vertex(&s[0], c[0] + e * test_rng_double(&r), c[1] + e * test_rng_double(&r), c[2] + e * test_rng_double(&r));
        shape_triangle(&s[0], v[0], v[1], v[2]);
    }
    shape_sphere(&s[1], 0, 0, 0, 0.5, 30);
    for (i = 0; i < sizeof rgb; i++) rgb[i] = (uint8_t)test_rng_u32(&r);
    if (zbufrand_scene_create(NULL, &scene) != ZBUFRAND_OK) abort();
    CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    m = mesh_of(&s[0]);
    m.two_sided = 1;
    m.triangle_rgb = rgb;
    CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &leaf), ZBUFRAND_OK);
    m = mesh_of(&s[1]);
    m.vertex_rgb = rgb;
    m.normals = s[1].normal;
    CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &ball), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(scene, lib, NULL, 0, &tree), ZBUFRAND_OK);
    for (i = 0; i < 4 + n; i++) {
        double q[9];
        shape_rotation(test_rng_double(&r), test_rng_double(&r), test_rng_double(&r), q);
        for (a = 0; a < 3; a++) {
            for (b = 0; b < 3; b++) t.m[a][b] = q[3 * a + b] * (i < 4 ? 0.5 : i % 5 == 0 ? -1.0 : 1.0);
            t.m[a][3] = (i < 4 ? 1 : a == 1 ? 3 : 60) * (test_rng_double(&r) - 0.5);
        }
        CHECK_EQ_U64(zbufrand_add_reference(scene, i < 4 ? tree : 1, &t, i < 4 ? (i & 1 ? ball : leaf) : tree, NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    return scene;
}

/* A floor seen at an angle below an empty sky, rasterised or sampled. Whatever fill is asked for, and nothing else: the floor has
   no holes, the sky stays empty. */
TEST(fills_without_asking) {
    enum { W = 160, H = 120 };
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    buffers a, b;
    uint32_t i, k, way, fill, top = H;
    memset(&s, 0, sizeof s);
    for (i = 0; i <= 60; i++) for (k = 0; k <= 60; k++) (void)shape_vertex(&s, (i - 30.0) / 3, 0, (k - 30.0) / 3);
    for (i = 0; i < 60; i++) {
        for (k = 0; k < 60; k++) {
            shape_triangle(&s, 61 * i + k, 61 * i + k + 1, 61 * i + k + 62);
            shape_triangle(&s, 61 * i + k, 61 * i + k + 62, 61 * i + k + 61);
        }
    }
    m = mesh_of(&s);
    m.two_sided = 1;
    scene = render_scene_of(&m, 1);
    buffers_open(&a, W, H);
    buffers_open(&b, W, H);
    for (way = 0; way < 2; way++) {
        for (fill = 0; fill <= 5; fill++) {
            zbufrand_render_desc d;
            uint32_t covered = 0, missing = 0, beyond = 0;
            memset(&d, 0, sizeof d);
            d.camera.eye[1] = 1.5;
            d.camera.at[1] = 1.2;
            d.camera.at[2] = -3;
            d.camera.fov_y = 50;
            d.hybrid = ZBUFRAND_HYBRID_ALL;
            if (fill == 0 && way == 0) { /* which pixels are floor */
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &a.image, NULL), ZBUFRAND_OK);
                for (i = 0; i < W * H; i++) if (a.depth[i] < (float)INFINITY && i / W < top) top = i / W;
                CHECK(top > 40 && top < 80);
            }
            if (fill == 0) continue;
            if (way) d.hybrid = ZBUFRAND_HYBRID_OFF;
            d.reconstruct.fill = (zbufrand_fill)fill;
            d.reconstruct.block = 4;
            d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
            for (i = 0; i < W * H; i++) {
                covered += a.depth[i] < (float)INFINITY;
                missing += a.depth[i] < (float)INFINITY && !(b.rgba[4 * i + 3] > 0.9f);
                beyond += i / W + 20 < top && b.rgba[4 * i + 3] != 0;
            }
            CHECK_MSG(missing <= covered / 500, "fill %u way %u: %u of %u pixels of the floor are empty", fill, way, missing, covered);
            CHECK_MSG(beyond == 0, "fill %u way %u: %u pixels of the sky are not", fill, way, beyond);
        }
    }
    buffers_close(&a);
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

TEST(same_bits) {
    shape s[2];
    zbufrand_scene *scene = forest(s, getenv("TEST_FULL") != NULL ? 1000 : test_quick() ? 60 : 400); /* 400: several rounds, all kinds of draws */
    uint32_t mode, k;
    for (mode = 0; mode < 12; mode++) {
        static const float half = 0.5f;
        zbufrand_render_desc d;
        uint64_t hash = 0;
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = 40;
        d.camera.eye[1] = mode == 5 ? 0.3 : 12;
        d.camera.eye[2] = mode == 5 ? 0 : 40;
        if (mode == 1) d.hybrid = ZBUFRAND_HYBRID_OFF;
        if (mode == 2) d.hybrid = ZBUFRAND_HYBRID_ALL;
        if (mode == 3) d.reconstruct.block = 3;
        if (mode == 4) d.independent = 1;
        if (mode == 6) d.no_plane_depth = 1;
        if (mode == 7) {
            d.reconstruct.block = 2;
            d.reconstruct.plane_depth = 1;
            d.reconstruct.fill = ZBUFRAND_FILL_GAUSS;
        }
        if (mode == 10) { /* points without depth buffer, by slope and colour, weighted by their regions */
            d.reconstruct.block = 4;
            d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
            d.reconstruct.fill = ZBUFRAND_FILL_REGIONS;
            d.reconstruct.tolerance_color = 0.05f;
            d.comb = 1;
        }
        if (mode == 11) d.oversample = 2;
        if (mode == 9) {
            d.opacity = &half;
            d.opacity_count = 1;
        }
        if (mode == 8) {
            d.noise = 0.05;
            d.max_frames = 5;
        }
        for (k = 0; k < 6; k++) {
            zbufrand_frame *frame;
            buffers b;
            if (k < 5) {
                frame = open_frame(k == 0 ? 1 : k == 1 ? 2 : k == 2 ? 7 : 1, k == 3 ? ZBUFRAND_ISA_SCALAR : k == 4 ? ZBUFRAND_ISA_AVX2 : ZBUFRAND_ISA_AUTO);
            } else {
                zbufrand_frame_desc fd;
                memset(&fd, 0, sizeof fd);
                fd.env.parallel.for_fn = parallel_backwards;
                frame = NULL;
                CHECK_EQ_U64(zbufrand_frame_create(&fd, &frame), ZBUFRAND_OK);
            }
            buffers_open(&b, 117, 91);
            if (k == 2) { /* whatever was drawn before leaves no trace */
                zbufrand_render_desc other;
                memset(&other, 0, sizeof other);
                other.seed = 5;
                CHECK_EQ_U64(zbufrand_render(frame, &other, scene, &b.image, NULL), ZBUFRAND_OK);
            }
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
            if (k == 0) hash = buffers_hash(&b);
            CHECK_MSG(buffers_hash(&b) == hash, "mode %u: run %u gives another picture", mode, k);
            zbufrand_frame_destroy(frame);
            buffers_close(&b);
        }
    }
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* Other seeds and frames are other pictures; hidden things make no difference that is seen. */
TEST(seeds_and_occlusion) {
    shape s[2];
    zbufrand_scene *scene = forest(s, test_quick() ? 300 : 2000);
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_render_desc d;
    zbufrand_stats st[2];
    buffers b[2];
    uint64_t hash[3];
    uint32_t i, k;
    double difference = 0, sum[2] = {0, 0};
    memset(&d, 0, sizeof d);
    d.camera.eye[1] = 2;
    d.camera.eye[0] = 30;
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    buffers_open(&b[0], 240, 160);
    buffers_open(&b[1], 240, 160);
    for (k = 0; k < 3; k++) {
        d.seed = k == 1;
        d.frame = k == 2;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b[0].image, NULL), ZBUFRAND_OK);
        hash[k] = buffers_hash(&b[0]);
    }
    CHECK(hash[0] != hash[1] && hash[0] != hash[2] && hash[1] != hash[2]);
    d.frame = 0;
    d.density = 8;
    for (k = 0; k < 2; k++) {
        d.no_occlusion = k;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b[k].image, &st[k]), ZBUFRAND_OK);
    }
    CHECK(st[0].samples[0] + st[0].samples[1] <= st[1].samples[0] + st[1].samples[1]);
    for (i = 0; i < 240 * 160; i++) {
        for (k = 0; k < 2; k++) sum[k] += b[k].depth[i] < INFINITY ? 1.0 / (double)b[k].depth[i] : 0;
        difference += (b[0].depth[i] < INFINITY) != (b[1].depth[i] < INFINITY);
    }
    CHECK_NEAR(sum[0] / sum[1], 1, 0.01);
    CHECK(difference < 240 * 160 * 0.01);
    buffers_close(&b[0]);
    buffers_close(&b[1]);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* ---- promises ---- */

/* A wall before a wall, both wider than the view. */
static void walls(shape *s, uint32_t n) {
    uint32_t z, i, j;
    memset(s, 0, sizeof *s);
    for (z = 0; z < 2; z++) {
        const uint32_t first = (uint32_t)s->vertices;
        for (i = 0; i <= n; i++) for (j = 0; j <= n; j++) (void)shape_vertex(s, 8.0 * i / n - 4, 8.0 * j / n - 4, z == 0 ? 0 : -1);
        for (i = 0; i < n; i++) {
            for (j = 0; j < n; j++) {
                const uint32_t a = first + i * (n + 1) + j, c = a + n + 1;
                shape_triangle(s, a, c, c + 1);
                shape_triangle(s, a, c + 1, a + 1);
            }
        }
    }
}

/* A hilly landscape. */
static void hills(shape *s, uint32_t n) {
    uint32_t i, j;
    memset(s, 0, sizeof *s);
    for (i = 0; i <= n; i++) {
        for (j = 0; j <= n; j++) {
            const double x = 6.0 * i / n - 3, z = 6.0 * j / n - 3;
            (void)shape_vertex(s, x, 0.35 * sin(3.1 * x + 2 * cos(2.3 * z)) * cos(2.9 * z + x), z);
        }
    }
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++) {
            const uint32_t a = i * (n + 1) + j, c = a + n + 1;
            shape_triangle(s, a, a + 1, c + 1);
            shape_triangle(s, a, c + 1, c);
        }
    }
}

/* Is there a pixel that shows nothing, or what is more than 1 % deeper than all that is seen in it and around it? */
static int incomplete(const float *behind, const float *depth, uint32_t n) {
    uint32_t i;
    for (i = 0; i < n; i++) if (depth[i] > behind[i]) return 1;
    return 0;
}

/* Probability of n and more where `mean` are expected. */
static double poisson_tail(uint32_t n, double mean) {
    double p = exp(-mean), sum = 0;
    uint32_t i;
    for (i = 0; i < n; i++) {
        sum += p;
        p *= mean / (i + 1);
    }
    return 1 - sum;
}

/* A camera somewhere around a world, or before its walls. */
static void look_from_anywhere(zbufrand_render_desc *d, uint32_t world, test_rng *r) {
    const double angle = 6.2831853 * test_rng_double(r), from = test_rng_double(r), high = test_rng_double(r);
    uint32_t i;
    memset(d, 0, sizeof *d);
    for (i = 0; i < 3; i++) d->camera.at[i] = world == 2 ? 0.5 : 0;
    d->camera.eye[0] = d->camera.at[0] + (world == 0 ? 5 + 6 * from : world == 1 ? 4 + 3 * from : 1 + from) * cos(angle);
    d->camera.eye[1] = d->camera.at[1] + (world == 0 ? 6 * high - 3 : world == 1 ? 0.8 + 2 * high : high - 0.5);
    d->camera.eye[2] = d->camera.at[2] + (world == 0 ? 5 + 6 * from : world == 1 ? 4 + 3 * from : 1 + from) * sin(angle);
    if (world == 3) {
        d->camera.eye[0] = d->camera.at[0] = from;
        d->camera.eye[1] = high;
        d->camera.eye[2] = 4 + 0.1 * angle;
    }
}

/* The depths that a pixel may not be behind: the most around it, or around blocks of 2 x 2, which reach beyond the picture. How many
   pixels have one is returned. */
static uint32_t deepest_around(const exact *e, uint32_t blocks, float *behind) {
    const uint32_t reach = blocks ? 3 : 1;
    uint32_t x, y, i, j, covered = 0;
    for (y = 0; y < e->h; y++) {
        for (x = 0; x < e->w; x++) {
            const int inside = !blocks || (x >= reach && y >= reach && x + reach < e->w && y + reach < e->h);
            const uint32_t x0 = x < reach ? 0 : x - reach, y0 = y < reach ? 0 : y - reach;
            double most = inside ? 0 : (double)INFINITY;
            for (j = y0 * e->k; inside && j < (y + reach + 1) * e->k && j < e->h * e->k; j++)
                for (i = x0 * e->k; i < (x + reach + 1) * e->k && i < e->w * e->k; i++) {
                    const double z = e->z[j * (e->w * e->k) + i];
                    most = z > most ? z : most;
                }
            behind[y * e->w + x] = (float)(most * 1.01);
            covered += most < (double)INFINITY;
        }
    }
    return covered;
}

/* Pictures from random cameras, with random numbers of their own: the share of incomplete ones is at most what is
   reported, and that at most what was asked for. Walls, balls before balls, hills, leaves. */
TEST(reported_share_is_incomplete) {
    enum { WAYS = 8 };
    static const struct { const char *name; zbufrand_hybrid hybrid; uint32_t independent, no_repair, seeds, block, parts; double tolerance; } way[WAYS] = {
        {"strata", ZBUFRAND_HYBRID_OFF, 0, 0, 7, 1, 1, 0.05}, {"strata, tolerance 0.5", ZBUFRAND_HYBRID_OFF, 0, 0, 1, 1, 1, 0.5},
        {"by cost", ZBUFRAND_HYBRID_AUTO, 0, 0, 3, 1, 1, 0.05}, {"independent", ZBUFRAND_HYBRID_OFF, 1, 0, 3, 1, 1, 0.5},
        {"strata, no rays", ZBUFRAND_HYBRID_OFF, 0, 1, 1, 1, 1, 0.5}, {"independent, no rays", ZBUFRAND_HYBRID_OFF, 1, 1, 2, 1, 1, 0.5},
        {"blocks", ZBUFRAND_HYBRID_OFF, 0, 0, 2, 2, 1, 0.05}, {"parts of pixels", ZBUFRAND_HYBRID_OFF, 0, 1, 1, 1, 3, 0.05}
    };
    enum { W = 96, H = 72, N = W * H, K = 3 };
    const uint32_t cameras = test_quick() ? 1 : 10;
    test_rng r = test_rng_make(31);
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    double reported[2][WAYS] = {{0}}, promised = 0;
    uint32_t bad[2][WAYS] = {{0}}, pictures[2][WAYS] = {{0}}, covered = 0, failed = 0, world, k, c, i, m;
    static float behind[2][N];
    buffers b;
    exact e;
    exact_open(&e, W, H, K);
    buffers_open(&b, W, H);
    b.image.rgba8 = NULL; /* depths are all that is asked for: no colours are made */
    b.image.rgba = NULL;
    b.image.node = NULL;
    for (world = 0; world < 4; world += test_quick() ? 3 : 1) {
        const uint32_t wall = world == 3;
        shape s;
        zbufrand_mesh mesh;
        zbufrand_scene *scene;
        memset(&s, 0, sizeof s);
        if (world == 0) three_balls(&s, 90);
        else if (world == 1) hills(&s, 150);
        else if (world == 2) soup(&s, &r, 20000, 0.02, 1);
        else walls(&s, 100);
        mesh = mesh_of(&s);
        mesh.two_sided = world == 2;
        scene = render_scene_of(&mesh, 1);
        for (c = 0; c < cameras; c++) {
            zbufrand_render_desc d;
            zbufrandi_camera camera;
            look_from_anywhere(&d, world, &r);
            CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, W, H, 0, &camera), ZBUFRAND_OK);
            for (i = 0; i < N * K * K; i++) e.z[i] = (double)INFINITY;
            exact_mesh(&e, &camera, &mesh);
            for (m = 0; m < 2; m++) covered += deepest_around(&e, m, behind[m]);
            for (k = 0; k < WAYS; k++) {
                d.oversample = way[k].parts;
                d.hybrid = way[k].hybrid;
                d.independent = way[k].independent;
                d.no_repair = way[k].no_repair;
                d.tolerance = way[k].tolerance;
                d.reconstruct.block = way[k].block;
                for (i = 0; i < (wall ? 3 : 1) * way[k].seeds; i++) {
                    zbufrand_stats st;
                    d.seed = 1000 * c + 100 * world + i;
                    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
                    /* one pass is enough: what is missed is what its density lets expect */
                    CHECK_MSG(st.incomplete <= d.tolerance * 1.0001 && st.density < 15, "%s: %g at density %g", way[k].name, st.incomplete, st.density);
                    if (d.no_repair == 0) { /* what the inside needs, and a little more for the borders */
                        const double inner = 0.2 * log(80.0 * (W * H) / d.tolerance), n = st.density * way[k].block * way[k].block;
                        CHECK_MSG(n > inner * (1 - 1e-6) && n < inner + 0.13, "%g of %g", n, inner);
                    }
                    reported[wall][k] += st.incomplete;
                    pictures[wall][k]++;
                    bad[wall][k] += (uint32_t)incomplete(behind[way[k].block - 1], b.depth, N);
                }
            }
        }
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
    CHECK(covered > 6 * cameras * N / 8);
    for (i = 0; i < 2 * WAYS; i++) {
        const double mean = reported[i & 1][i / 2];
        const uint32_t n = bad[i & 1][i / 2], of = pictures[i & 1][i / 2];
        if (test_g.verbose) printf("%s%s: %u of %u pictures are incomplete, %.2f were reported\n", way[i / 2].name, i & 1 ? ", walls" : "", n, of, mean);
        CHECK_MSG(poisson_tail(n, mean) > 1e-5, "%s%s: %u of %u pictures are incomplete, %g reported", way[i / 2].name, i & 1 ? ", walls" : "", n, of, mean);
        if (way[i / 2].tolerance < 0.1) { /* together they say more */
            failed += n;
            promised += mean;
        }
        /* and it is not a number that says nothing: the wall is right at all its pixels with the probability of the theory */
        if ((i & 1) != 0 && way[i / 2].independent && way[i / 2].no_repair) CHECK_MSG(n > 0.5 * mean - 4 * sqrt(mean), "%u of %u, %g reported", n, of, mean);
    }
    CHECK_MSG(poisson_tail(failed, promised) > 1e-5, "%u pictures are incomplete, %g reported", failed, promised);
    CHECK(cameras < 10 || promised > 20);
    buffers_close(&b);
    free(e.z);
    zbufrand_frame_destroy(frame);
}

/* Bodies, hills, leaves or walls, of any size and fineness; *centre: about where they are, *radius: how far they go. */
static void random_scene(shape *s, test_rng *r, uint32_t kind, double centre[3], double *radius) {
    uint32_t i, n;
    size_t v;
    memset(s, 0, sizeof *s);
    for (i = 0; i < 3; i++) centre[i] = kind == 2 ? 0.5 : 0;
    *radius = kind == 0 ? 2.5 : kind == 1 ? 3 : kind == 2 ? 0.9 : 2;
    if (kind == 0) {
        n = 2 + test_rng_below(r, 5);
        for (i = 0; i < n; i++) {
            const double x = 4 * test_rng_double(r) - 2, y = 4 * test_rng_double(r) - 2, z = 4 * test_rng_double(r) - 2, size = 0.3 + test_rng_double(r);
            const uint32_t rings = 6 + test_rng_below(r, 50);
            if (test_rng_below(r, 3) == 0) shape_torus(s, x, y, z, size, 0.4 * size, 2 * rings, rings);
            else shape_sphere(s, x, y, z, size, rings);
        }
    } else if (kind == 1) hills(s, 20 + test_rng_below(r, 100));
    else if (kind == 2) soup(s, r, 100u << test_rng_below(r, 7), 0.02 * pow(12, test_rng_double(r)), 1);
    else walls(s, 10 + test_rng_below(r, 90));
    if (kind == 1) {
        const double high = 0.3 + 2 * test_rng_double(r);
        for (v = 0; v < s->vertices; v++) s->p[3 * v + 1] = (float)((double)s->p[3 * v + 1] * high);
    }
}

/* The same for scenes, cameras, tolerances and ways that are all drawn at random. Samples alone that are independent fail most often:
   there the number says the most. */
TEST(tolerance_of_random_scenes) {
    enum { W = 64, H = 48, N = W * H, K = 3, SEEDS = 4, GROUPS = 16 + 3 };
    const uint32_t count = test_quick() ? 24 : 240;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    double reported[2] = {0, 0}, said[GROUPS];
    uint32_t bad[2] = {0, 0}, pictures[2] = {0, 0}, wrong[GROUPS], covered = 0, k, i, j, x, y;
    static float behind[N];
    buffers b;
    exact e;
    exact_open(&e, W, H, K);
    buffers_open(&b, W, H);
    b.image.rgba8 = NULL;
    b.image.rgba = NULL;
    b.image.node = NULL;
    memset(said, 0, sizeof said);
    memset(wrong, 0, sizeof wrong);
    for (k = 0; k < count; k++) {
        test_rng r = test_rng_make(6100 + k);
        const uint32_t kind = k % 4;
        const double angle = 6.2831853 * test_rng_double(&r), high = 1.8 * test_rng_double(&r) - 0.9, far_away = 1.1 + 3 * test_rng_double(&r);
        double centre[3], radius;
        uint32_t reach, plain, group[2];
        zbufrand_render_desc d;
        zbufrand_scene *scene;
        zbufrand_mesh mesh;
        zbufrandi_camera camera;
        shape s;
        random_scene(&s, &r, kind, centre, &radius);
        mesh = mesh_of(&s);
        mesh.two_sided = kind != 3 && test_rng_below(&r, 2);
        scene = render_scene_of(&mesh, 1);
        memset(&d, 0, sizeof d);
        for (i = 0; i < 3; i++) d.camera.at[i] = centre[i] + 0.3 * radius * (test_rng_double(&r) - 0.5);
        d.camera.eye[0] = centre[0] + radius * far_away * cos(angle);
        d.camera.eye[1] = centre[1] + radius * far_away * (kind == 1 ? fabs(high) + 0.1 : high);
        d.camera.eye[2] = centre[2] + radius * far_away * sin(angle);
        d.camera.fov_y = 25 + 45 * test_rng_double(&r);
        if (kind == 3) { /* straight on, so that they fill the picture */
            for (i = 0; i < 2; i++) d.camera.eye[i] = d.camera.at[i] = test_rng_double(&r);
            d.camera.at[2] = 0;
            d.camera.eye[2] = 1 + 3 * test_rng_double(&r);
            d.camera.fov_y = 25 + 15 * test_rng_double(&r);
        }
        d.tolerance = 0.01 * pow(90, test_rng_double(&r));
        d.hybrid = test_rng_below(&r, 3) == 0 ? ZBUFRAND_HYBRID_AUTO : ZBUFRAND_HYBRID_OFF;
        d.independent = test_rng_below(&r, 2);
        d.no_repair = test_rng_below(&r, 2);
        d.reconstruct.block = 1 + (test_rng_below(&r, 4) == 0);
        reach = d.reconstruct.block == 1 ? 1 : 3;
        plain = d.independent && d.no_repair && d.hybrid == ZBUFRAND_HYBRID_OFF;
        group[0] = 4 * kind + 2 * d.independent + d.no_repair;
        group[1] = 16 + (d.tolerance < 0.05 ? 0 : d.tolerance < 0.2 ? 1 : 2);
        CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, W, H, 0, &camera), ZBUFRAND_OK);
        for (i = 0; i < N * K * K; i++) e.z[i] = (double)INFINITY;
        exact_mesh(&e, &camera, &mesh);
        for (y = 0; y < H; y++) {
            for (x = 0; x < W; x++) {
                const int inside = x >= reach && y >= reach && x + reach < W && y + reach < H;
                double most = inside ? 0 : (double)INFINITY;
                for (j = (y - reach) * K; inside && j < (y + reach + 1) * K; j++)
                    for (i = (x - reach) * K; i < (x + reach + 1) * K; i++) most = e.z[j * (W * K) + i] > most ? e.z[j * (W * K) + i] : most;
                behind[y * W + x] = (float)(most * 1.01);
                covered += most < (double)INFINITY;
            }
        }
        for (i = 0; i < SEEDS; i++) {
            zbufrand_stats st;
            d.seed = SEEDS * k + i;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
            CHECK_MSG(st.incomplete >= 0 && st.incomplete <= d.tolerance * 1.0001, "scene %u: %g, tolerance %g", k, st.incomplete, d.tolerance);
            reported[plain] += st.incomplete;
            pictures[plain]++;
            j = (uint32_t)incomplete(behind, b.depth, N);
            bad[plain] += j;
            said[group[0]] += st.incomplete; /* of each kind of scene and way, and of small and large tolerances: none hides behind others */
            said[group[1]] += st.incomplete;
            wrong[group[0]] += j;
            wrong[group[1]] += j;
        }
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
    for (i = 0; i < 2; i++) {
        if (test_g.verbose)
            printf("%s: %u of %u pictures are incomplete, %.2f were reported\n", i == 0 ? "other ways" : "independent", bad[i], pictures[i], reported[i]);
        CHECK_MSG(poisson_tail(bad[i], reported[i]) > 1e-5, "%u of %u pictures are incomplete, %g reported", bad[i], pictures[i], reported[i]);
    }
    for (i = 0; i < GROUPS; i++) {
        if (test_g.verbose) printf("group %u: %u are incomplete, %.2f were reported\n", i, wrong[i], said[i]);
        CHECK_MSG(poisson_tail(wrong[i], said[i]) > 1e-6, "group %u: %u are incomplete, %g reported", i, wrong[i], said[i]);
    }
    CHECK(covered > 400 * count);
    CHECK(count < 240 || (reported[0] > 50 && bad[1] > 0)); /* it does use what it is allowed */
    buffers_close(&b);
    free(e.z);
    zbufrand_frame_destroy(frame);
}

/* Means of frames are as near to what they tend to as `noise` says, in the mean over scenes, cameras, errors and ways at random: against
   the mean of many more frames with other random numbers. In pictures that small single ones are up to twice as far off. */
TEST(noise_of_random_scenes) {
    enum { W = 64, H = 48, N = W * H, MANY = 128 };
    const uint32_t count = test_quick() ? 8 : 208;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    double ratio = 0, worst = 0, least = 1e9;
    uint32_t k, i, c, noisy = 0;
    buffers b[2];
    buffers_open(&b[0], W, H);
    buffers_open(&b[1], W, H);
    for (k = 0; k < count; k++) {
        test_rng r = test_rng_make(9400 + k);
        const uint32_t kind = k % 4;
        const double angle = 6.2831853 * test_rng_double(&r), far_away = 1.5 + 2 * test_rng_double(&r);
        double centre[3], radius, error = 0;
        zbufrand_render_desc d;
        zbufrand_stats st, many;
        zbufrand_scene *scene;
        zbufrand_mesh mesh;
        shape s;
        random_scene(&s, &r, kind, centre, &radius);
        mesh = mesh_of(&s);
        mesh.two_sided = 1;
        scene = render_scene_of(&mesh, 1);
        memset(&d, 0, sizeof d);
        for (i = 0; i < 3; i++) d.camera.at[i] = centre[i];
        d.camera.eye[0] = centre[0] + radius * far_away * cos(angle);
        d.camera.eye[1] = centre[1] + radius * far_away * 0.6;
        d.camera.eye[2] = centre[2] + radius * far_away * sin(angle);
        d.camera.fov_y = 40;
        d.hybrid = test_rng_below(&r, 3) == 0 ? ZBUFRAND_HYBRID_AUTO : ZBUFRAND_HYBRID_OFF;
        d.reconstruct.block = 1 + (test_rng_below(&r, 4) == 0);
        d.noise = 1e-9;
        d.max_frames = MANY;
        d.seed = 1000 + k;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b[1].image, &many), ZBUFRAND_OK);
        CHECK(many.frames == MANY || many.rmse <= 1e-9);
        d.noise = many.rmse * 11.3 / (2 + 3 * test_rng_double(&r)); /* that of 4 to 25 frames */
        if (many.frames < MANY) d.noise = 1e-9; /* all of it is rastered, frames differ by roundings */
        d.seed = k;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b[0].image, &st), ZBUFRAND_OK);
        CHECK_MSG(st.rmse <= d.noise && st.frames < MANY, "scene %u: %g of %g after %u frames", k, st.rmse, d.noise, (unsigned)st.frames);
        for (i = 0; i < N; i++)
            for (c = 0; c < 3; c++) {
                const double e = (double)b[0].image.rgba[4 * i + c] - (double)b[1].image.rgba[4 * i + c];
                error += e * e;
            }
        if (many.frames < MANY) CHECK_MSG(sqrt(error / (3 * N)) < 1e-8, "scene %u: %g", k, sqrt(error / (3 * N))); /* roundings */
        error = many.frames < MANY ? 1 : sqrt(error / (3 * N)) / sqrt(st.rmse * st.rmse + many.rmse * many.rmse);
        noisy += many.frames == MANY;
        if (test_g.verbose) printf("scene %u: asked %.4f, said %.4f, is %.3f of that, %u frames\n", k, d.noise, st.rmse, error, (unsigned)st.frames);
        ratio += error * error / count;
        if (d.noise > 1e-4) worst = error > worst ? error : worst; /* less is one pixel, in one frame of many */
        least = error < least ? error : least;
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
    CHECK(10 * noisy > 9 * count);
    if (test_g.verbose) printf("root of the mean square %.3f, %.3f .. %.3f\n", sqrt(ratio), least, worst);
    CHECK_MSG(sqrt(ratio) < 1.05 && sqrt(ratio) > 0.7 && worst < 2 && least > 0.2, "%.3f, %.3f .. %.3f of what was said", sqrt(ratio), least, worst);
    buffers_close(&b[0]);
    buffers_close(&b[1]);
    zbufrand_frame_destroy(frame);
}

/* Where nearly all is rastered only areas with samples are looked at for pixels to repair: they hold all samples that are shown, and
   three pixels around them. */
TEST(few_samples_among_rastered) {
    enum { W = 210, H = 149 };
    const uint32_t cameras = test_quick() ? 4 : 24;
    test_rng r = test_rng_make(77);
    zbufrand_frame *frame = open_frame(2, ZBUFRAND_ISA_AUTO);
    zbufrand_scene *scene;
    zbufrand_mesh m[2];
    uint32_t c, found = 0, pictures = 0;
    shape s[2];
    buffers b;
    buffers_open(&b, W, H);
    three_balls(&s[0], 24);
    memset(&s[1], 0, sizeof s[1]);
    soup(&s[1], &r, 1200, 0.004, 1);
    m[0] = mesh_of(&s[0]);
    m[1] = mesh_of(&s[1]);
    m[1].two_sided = 1;
    scene = render_scene_of(m, 2);
    for (c = 0; c < cameras; c++) {
        const double angle = 6.2831853 * test_rng_double(&r), far = 1.5 + 4 * test_rng_double(&r);
        const zbufrandi_picture *p;
        const zbufrandi_recon *recon;
        zbufrand_render_desc d;
        uint32_t x, y;
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = far * cos(angle);
        d.camera.eye[1] = 2 * test_rng_double(&r);
        d.camera.eye[2] = far * sin(angle);
        d.reconstruct.block = 1 + c % 3;
        d.seed = c;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
        p = frame->picture;
        recon = &frame->recon;
        if (p->where == NULL) continue; /* too many samples, or none */
        pictures++;
        for (y = 0; y < H; y++) {
            for (x = 0; x < W; x++) {
                const uint64_t key = recon->result[(size_t)(y + recon->result_guard) * recon->result_width + x + recon->result_guard];
                uint32_t kind, u, v;
                if (key == ZBUFRANDI_EMPTY) continue;
                kind = frame->draw[frame->block_draw[((zbufrandi_key_number(key) >> 6) - p->first_block) & 0x3ffffffu]].item >> ZBUFRANDI_DRAW_SHIFT;
                if (kind != ZBUFRANDI_DRAW_STORED && kind != ZBUFRANDI_DRAW_SAMPLED) continue;
                found++;
                for (v = y > 3 ? y - 3 : 0; v <= y + 3 && v < H; v += 3)
                    for (u = x > 3 ? x - 3 : 0; u <= x + 3 && u < W; u += 3)
                        CHECK_MSG(p->where[v / 16 * ((W + 15) / 16) + u / 16] == 1, "camera %u: nobody looks at %u %u, beside a sample", c, u, v);
            }
        }
    }
    CHECK_MSG(pictures >= cameras / 4 && found > 10 * pictures, "%u samples in %u pictures", found, pictures);
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* The mean of frames comes as close as was asked for to the mean of many such means with other seeds. */
TEST(noise_is_kept) {
    shape s[2];
    zbufrand_scene *scene = forest(s, 600);
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_render_desc d;
    zbufrand_stats st;
    buffers b;
    const uint32_t runs = test_quick() ? 6 : 12, n = 4 * 96 * 72;
    double *sum = (double *)malloc(n * sizeof *sum);
    uint32_t k, i, run;
    REQUIRE(sum != NULL);
    buffers_open(&b, 96, 72);
    memset(&d, 0, sizeof d);
    d.camera.eye[1] = 8;
    d.camera.eye[0] = 40;
    d.noise = 1e-9;
    d.max_frames = 5;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
    CHECK_EQ_U64(st.frames, 5);
    d.max_frames = 0;
    for (k = 0; k < 2; k++) {
        double error = 0;
        d.noise = k == 0 ? 0.04 : 0.02;
        for (i = 0; i < n; i++) sum[i] = 0;
        for (run = 0; run <= runs; run++) {
            d.seed = run;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
            CHECK(st.rmse > 0 && st.rmse <= d.noise);
            CHECK(st.frames >= 4 && st.frames < 256);
            for (i = 0; i < n && run < runs; i++) sum[i] += (double)b.rgba[i] / runs;
        }
        for (i = 0; i < n; i++) {
            double e = (double)b.rgba[i] - sum[i];
            if (i % 4 < 3) error += e * e / (0.75 * n);
        }
        error = sqrt(error / (1 + 1.0 / runs)); /* the mean is noisy, too */
        CHECK_MSG(error < d.noise && error > 0.75 * st.rmse, "RMSE %g, wanted %g, estimated %g after %u frames", error, d.noise, st.rmse, st.frames);
    }
    free(sum);
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* ---- odd views ---- */

TEST(odd_cameras) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_render_desc d;
    zbufrand_stats st;
    buffers b;
    test_rng r = test_rng_make(4);
    uint32_t i, k, a;
    three_balls(&s, 20);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    buffers_open(&b, 64, 48);
    for (k = 0; k < (test_quick() ? 40u : 400u); k++) {
        memset(&d, 0, sizeof d);
        for (a = 0; a < 3; a++) {
            const float *v = s.p + 3 * test_rng_below(&r, (uint32_t)s.vertices);
            d.camera.eye[a] = k % 4 == 0 ? (double)v[a] : k % 4 == 1 ? 0 : 6 * test_rng_double(&r) - 3; /* on vertices, inside, in boxes */
            d.camera.at[a] = k % 7 == 0 ? d.camera.eye[a] + (a == 0) : 4 * test_rng_double(&r) - 2;
        }
        if (k % 5 == 0) d.camera.near_z = 1e-6;
        if (k % 6 == 0) d.camera.far_z = 1.5;
        d.camera.fov_y = k % 3 == 0 ? 150 : 40;
        d.hybrid = (zbufrand_hybrid)(k % 3);
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        for (i = 0; i < 64 * 48; i++) {
            CHECK(b.depth[i] > 0.0f && b.rgba[4 * i] >= 0.0f && b.rgba[4 * i] < 100.0f);
            if (k % 6 == 0) CHECK(b.depth[i] == INFINITY || b.depth[i] <= 1.5001f);
        }
    }
    /* inside a box that is drawn from both sides everything is covered, through the near plane and beyond */
    {
        shape box;
        zbufrand_scene *room;
        memset(&box, 0, sizeof box);
        shape_box(&box, -1, -1, -1, 1, 1, 1);
        m = mesh_of(&box);
        m.two_sided = 1;
        room = render_scene_of(&m, 1);
        for (k = 0; k < 40; k++) {
            memset(&d, 0, sizeof d);
            for (a = 0; a < 3; a++) {
                d.camera.eye[a] = 1.9 * test_rng_double(&r) - 0.95;
                d.camera.at[a] = d.camera.eye[a] + test_rng_double(&r) - 0.5;
            }
            d.camera.fov_y = 20 + 120 * test_rng_double(&r);
            d.camera.near_z = 1e-6;
            d.hybrid = (zbufrand_hybrid)(k % 3);
            CHECK_EQ_U64(zbufrand_render(frame, &d, room, &b.image, &st), ZBUFRAND_OK);
            CHECK_MSG(st.covered == 64 * 48, "%llu pixels of a room are covered", (unsigned long long)st.covered);
        }
        zbufrand_scene_destroy(room);
        shape_free(&box);
    }
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* A triangle a million times as large as the picture, all in front of the near plane, is not sampled point by point, whatever the
   options say and by whatever tree. */
TEST(far_too_large) {
    static const float position[3][3] = {{-900, -900, 0}, {900, -900, 0}, {0, 900, 0}};
    static const uint32_t index[3] = {0, 1, 2};
    uint32_t tree;
    for (tree = 0; tree < 5; tree++) {
        zbufrand_scene *scene = NULL;
        zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        zbufrand_build_desc bd;
        zbufrand_render_desc d;
        zbufrand_stats st;
        zbufrand_mesh m;
        buffers b;
        buffers_open(&b, 13, 9);
        memset(&m, 0, sizeof m);
        memset(&d, 0, sizeof d);
        memset(&bd, 0, sizeof bd);
        m.positions = position[0];
        m.vertex_count = 3;
        m.indices = index;
        m.triangle_count = 1;
        bd.structure = (zbufrand_structure)tree;
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, ZBUFRAND_ROOT, NULL, 0, &m, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(scene, &bd, NULL), ZBUFRAND_OK);
        d.camera.eye[2] = 0.5;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.independent = tree == 1;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        CHECK_EQ_U64(st.covered, 13 * 9);
        CHECK_MSG(st.samples[0] + st.samples[1] < 2000000, "tree %u: %g samples for 117 pixels", tree, (double)(st.samples[0] + st.samples[1]));
        buffers_close(&b);
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
    }
}

TEST(wrong_arguments) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_render_desc d;
    zbufrand_stats st;
    buffers b;
    uint32_t i;
    three_balls(&s, 6);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    buffers_open(&b, 16, 16);
    memset(&d, 0, sizeof d);
    CHECK_EQ_U64(zbufrand_render(frame, NULL, scene, &b.image, &st), ZBUFRAND_OK); /* all defaults frame the scene */
    CHECK(st.covered > 30);
    CHECK_EQ_U64(zbufrand_render(NULL, &d, scene, &b.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_render(frame, &d, NULL, &b.image, &st), ZBUFRAND_OK); /* nothing */
    CHECK_EQ_U64(st.covered, 0);
    for (i = 0; i < 23; i++) {
        static const float bad[3] = {1.5f, -0.1f, NAN};
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = 3;
        if (i == 0) d._begin_zero = 1;
        if (i == 1) d._end_zero = 1;
        if (i == 2) d.camera.fov_y = 180;
        if (i == 3) d.camera.fov_y = -1;
        if (i == 4) d.camera.eye[1] = (double)NAN;
        if (i == 5) d.camera.at[1] = (double)INFINITY;
        if (i == 6) d.camera.near_z = -1;
        if (i == 7) {
            d.camera.near_z = 2;
            d.camera.far_z = 1;
        }
        if (i == 8) d.density = -1;
        if (i == 9) d.tolerance = 1;
        if (i == 10) d.hybrid = (zbufrand_hybrid)9;
        if (i == 11) d.spread = 3;
        if (i == 12) d.light_count = 1;
        if (i == 13) d.points_count = 1;
        if (i == 14) d.background[1] = NAN;
        if (i == 15) d.noise = (double)NAN;
        if (i == 16) d.density = (double)NAN;
        if (i == 17) d.reconstruct.block = 100000;
        if (i == 18) d.opacity_count = 1;
        if (i >= 19 && i < 22) {
            d.opacity = &bad[i - 19];
            d.opacity_count = 1;
        }
        if (i == 22) d.hybrid_radius = (double)NAN;
        CHECK_MSG(zbufrand_render(frame, &d, scene, &b.image, NULL) != ZBUFRAND_OK, "case %u was accepted", i);
    }
    b.image.width = 0;
    CHECK_EQ_U64(zbufrand_render(frame, NULL, scene, &b.image, NULL), ZBUFRAND_OK);
    b.image.width = 40000;
    CHECK_EQ_U64(zbufrand_render(frame, NULL, scene, &b.image, NULL), ZBUFRAND_ERR_RANGE);
    b.image.width = 16; /* and the frame is as good as before */
    CHECK_EQ_U64(zbufrand_render(frame, NULL, scene, &b.image, &st), ZBUFRAND_OK);
    CHECK(st.covered > 30);
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    zbufrand_frame_destroy(NULL);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* ---- memory ---- */

TEST(nothing_is_allocated_twice) {
    shape s[2];
    zbufrand_scene *scene = forest(s, 500);
    test_alloc ta;
    zbufrand_frame_desc fd;
    zbufrand_frame *frame = NULL;
    zbufrand_render_desc d;
    buffers b;
    int64_t count;
    uint32_t k;
    test_alloc_init(&ta);
    memset(&fd, 0, sizeof fd);
    fd.env.allocator.alloc_fn = test_alloc_fn;
    fd.env.allocator.free_fn = test_free_fn;
    fd.env.allocator.user = &ta;
    fd.env.thread_count = 2;
    CHECK_EQ_U64(zbufrand_frame_create(&fd, &frame), ZBUFRAND_OK);
    buffers_open(&b, 120, 90);
    memset(&d, 0, sizeof d);
    for (k = 0; k < 4; k++) {
        if (k == 1) d.reconstruct.block = 2;
        d.oversample = k == 3 ? 2 : 0;
        if (k == 2) {
            d.noise = 0.1;
            d.max_frames = 4;
        }
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
        count = ta.count;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
        CHECK_EQ_I64(ta.count, count);
    }
    zbufrand_frame_destroy(frame);
    test_alloc_check(&ta);
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

enum { MEMORY_FRAME, MEMORY_FRAMES, MEMORY_RAYS, MEMORY_RASTER, MEMORY_CLOUDS, MEMORY_LAST_DRAW, MEMORY_MODES };

static void memory_mode(uint32_t mode, zbufrand_render_desc *d, buffers *b) {
    memset(d, 0, sizeof *d);
    b->image.width = mode == MEMORY_RASTER ? 12 : 60;
    b->image.height = mode == MEMORY_RASTER ? 8 : 40;
    if (mode == MEMORY_FRAMES) {
        d->oversample = 2;
        d->reconstruct.block = 2;
        d->reconstruct.fill = ZBUFRAND_FILL_GAUSS;
        d->noise = 0.1;
        d->max_frames = 2;
    }
    if (mode == MEMORY_RAYS || mode >= MEMORY_CLOUDS) { /* few samples, and rays for the rest */
        d->hybrid = ZBUFRAND_HYBRID_OFF;
        d->density = 0.5;
        d->camera.eye[0] = 30;
        d->camera.eye[1] = 1;
        d->camera.eye[2] = 3;
    }
    if (mode == MEMORY_RASTER) d->hybrid = ZBUFRAND_HYBRID_ALL; /* down to each cluster: much is open at once */
}

/* Each request refused once; a frame that was refused one draws the same picture as any other. */
static void memory_refused(const char *name, const zbufrand_render_desc *d, const zbufrand_scene *scene, buffers *b) {
    uint64_t hash = 0;
    int64_t k;
    int done = 0;
    for (k = -1; k < 5000 && !done; k++) { /* the first time nothing fails */
        test_alloc ta;
        zbufrand_frame_desc fd;
        zbufrand_frame *frame = NULL;
        zbufrand_result r;
        test_alloc_init(&ta);
        ta.fail_at = k;
        memset(&fd, 0, sizeof fd);
        fd.env.allocator.alloc_fn = test_alloc_fn;
        fd.env.allocator.free_fn = test_free_fn;
        fd.env.allocator.user = &ta;
        fd.env.thread_count = 1;
        r = zbufrand_frame_create(&fd, &frame);
        if (r == ZBUFRAND_OK) {
            r = zbufrand_render(frame, d, scene, &b->image, NULL);
            if (r != ZBUFRAND_OK) { /* and it goes on when there is memory again */
                CHECK_EQ_U64(r, ZBUFRAND_ERR_NO_MEMORY);
                CHECK_EQ_U64(zbufrand_render(frame, d, scene, &b->image, NULL), ZBUFRAND_OK);
            }
            if (hash == 0) hash = buffers_hash(b);
            CHECK_EQ_U64(buffers_hash(b), hash);
        }
        zbufrand_frame_destroy(frame);
        done = k >= 0 && ta.failed == 0;
        CHECK(r == ZBUFRAND_OK || (ta.failed != 0 && r == ZBUFRAND_ERR_NO_MEMORY));
        test_alloc_check(&ta);
    }
    CHECK_MSG(done && k > 20, "%s: %d requests", name, (int)k);
    if (test_g.verbose) printf("%s: %d requests\n", name, (int)k - 1);
}

/* How many clouds of a point make that of the rays the draw that needs more room than those before it. */
static size_t memory_clouds(zbufrand_render_desc *d, const zbufrand_scene *scene, buffers *b, uint64_t *repaired) {
    size_t n;
    for (n = 1; n < 200; n++) {
        zbufrand_frame *f = open_frame(1, ZBUFRAND_ISA_AUTO);
        zbufrand_stats st;
        int found;
        d->points_count = n;
        CHECK_EQ_U64(zbufrand_render(f, d, scene, &b->image, &st), ZBUFRAND_OK);
        found = f->draw_count > 1 && f->draw_capacity == 2 * (f->draw_count - 1) &&
                f->draw[f->draw_count - 1].item >> ZBUFRANDI_DRAW_SHIFT == ZBUFRANDI_DRAW_RAYS;
        *repaired = st.repaired;
        zbufrand_frame_destroy(f);
        if (found) break;
    }
    return n;
}

TEST(out_of_memory) {
    static const char *const name[MEMORY_MODES] = {"a frame", "frames", "rays", "all rastered", "clouds", "the last draw"};
    static const float at[3] = {0, 0, 0};
    zbufrand_points cloud[200];
    shape s[2];
    zbufrand_scene *scene = forest(s, 30);
    buffers b;
    uint64_t repaired = 0;
    uint32_t mode, i;
    memset(cloud, 0, sizeof cloud);
    for (i = 0; i < 200; i++) {
        cloud[i].positions = at;
        cloud[i].count = 1;
    }
    buffers_open(&b, 60, 40);
    for (mode = 0; mode < MEMORY_MODES; mode++) {
        zbufrand_render_desc d;
        memory_mode(mode, &d, &b);
        if (mode >= MEMORY_CLOUDS) d.points = cloud;
        if (mode == MEMORY_CLOUDS) d.points_count = 20;
        if (mode == MEMORY_LAST_DRAW) CHECK(memory_clouds(&d, scene, &b, &repaired) < 200 && repaired > 0);
        memory_refused(name[mode], &d, scene, &b);
    }
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* ---- what surfaces look like ---- */

typedef struct seen_by { zbufrand_camera camera; uint32_t count, nodes, bad; uint32_t lock; const shape *s; } seen_by;

static void own_shade(void *user, const zbufrand_surface *f, size_t count, float *rgba) {
    seen_by *u = (seen_by *)user;
    size_t i;
    int a;
    for (i = 0; i < count; i++) {
        double p = 0, n = 0, toward = 0, outward = 0, e[3];
        for (a = 0; a < 3; a++) {
            p += f[i].position[a] * f[i].position[a];
            n += (double)f[i].normal[a] * (double)f[i].normal[a];
            e[a] = u->camera.eye[a] - f[i].position[a];
            toward += e[a] * (double)f[i].normal[a];
            outward += f[i].position[a] * (double)f[i].normal[a];
        }
        /* at the rim smooth normals look away from the eye, and stay what they are */
        if (outward < 0.9) __atomic_fetch_add(&u->bad, 1u, __ATOMIC_RELAXED);
        if (fabs(sqrt(p) - 1) > 0.02 || fabs(n - 1) > 1e-4 || toward < -0.3 || f[i].material != 3 || !(f[i].depth > 2 && f[i].depth < 6)) {
            __atomic_fetch_add(&u->bad, 1u, __ATOMIC_RELAXED);
        }
        if (f[i].node != 0) __atomic_fetch_add(&u->nodes, 1u, __ATOMIC_RELAXED);
        __atomic_fetch_add(&u->count, 1u, __ATOMIC_RELAXED);
        for (a = 0; a < 3; a++) rgba[4 * i + (size_t)a] = f[i].rgb[a];
        rgba[4 * i + 3] = 1;
    }
}

/* Strips of two colours in one plane, far narrower than pixels: all at one depth, so chance decides which a pixel shows. The mean
   of many frames is the mean of the surface, in each pixel; with strips of which every other one lies behind, the nearer one
   shows more often than it is large, by as much as the law of pixels says. 30 x 20 pixels, p below 1e-5. */
TEST(colours_are_unbiased) {
    enum { W = 30, H = 20, STRIPS = 2048 };
    const uint32_t frames = test_quick() ? 64 : 400;
    uint32_t behind, i, k;
    for (behind = 0; behind < 2; behind++) {
        shape s;
        zbufrand_mesh m;
        zbufrand_scene *scene = NULL;
        zbufrand_frame *frame = NULL;
        zbufrand_render_desc d;
        zbufrand_image image;
        uint8_t *rgb = (uint8_t *)malloc(3 * 2 * STRIPS);
        float *rgba = (float *)malloc(4 * W * H * sizeof *rgba);
        double *sum = (double *)calloc(W * H, sizeof *sum), share = 1.0 / 3, want = share, mean = 0, worst = 0;
        memset(&s, 0, sizeof s);
        REQUIRE(rgb != NULL && rgba != NULL && sum != NULL);
        for (i = 0; i < STRIPS; i++) { /* every other strip is white, and half as wide as the black ones */
            const double x0 = 4.0 * (i / 2 + (i & 1 ? share : 0)) / (STRIPS / 2) - 2, x1 = 4.0 * (i / 2 + (i & 1 ? 1 : share)) / (STRIPS / 2) - 2;
            const double z = behind && (i & 1) ? -0.001 : 0, left = behind && (i & 1) ? 4.0 * (i / 2) / (STRIPS / 2) - 2 : x0;
            const uint32_t v = shape_vertex(&s, left, -2, z);
            (void)shape_vertex(&s, x1, -2, z);
            (void)shape_vertex(&s, x1, 2, z);
            (void)shape_vertex(&s, left, 2, z);
            shape_triangle(&s, v, v + 1, v + 2);
            shape_triangle(&s, v, v + 2, v + 3);
            memset(rgb + 6 * i, i & 1 ? 0 : 255, 6);
        }
        m = mesh_of(&s);
        m.triangle_rgb = rgb;
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, ZBUFRAND_ROOT, NULL, 0, &m, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
        memset(&d, 0, sizeof d);
        memset(&image, 0, sizeof image);
        d.camera.eye[2] = 3;
        d.camera.fov_y = 40;
        d.density = 6;
        d.independent = 1;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.no_repair = d.no_plane_depth = d.no_occlusion = d.unlit = 1;
        image.width = W;
        image.height = H;
        image.rgba = rgba;
        for (k = 0; k < frames; k++) {
            d.frame = k;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, NULL), ZBUFRAND_OK);
            for (i = 0; i < W * H; i++) sum[i] += (double)rgba[4 * i] / frames;
        }
        if (behind) { /* fragments of a pixel: a third of it in front, white; all of it behind, black */
            const double area[2] = {1.0 / 3, 1.0}, value[2] = {1, 0};
            want = zbufrand_expected_pixel(area, value, 2, d.density, 0, NULL);
        } else {
            want = share * (1 - exp(-d.density)); /* pixels without a sample are black */
        }
        for (i = 0; i < W * H; i++) {
            const double off = fabs(sum[i] - want) / sqrt(want * (1 - want) / frames);
            worst = off > worst ? off : worst;
            mean += sum[i] / (W * H);
        }
        /* a pair is a twenty-eighth of a pixel, so pixels differ by a hundredth */
        CHECK_MSG(worst < 5.5 + 0.012 / sqrt(want * (1 - want) / frames), "%s: a pixel is off by %g standard deviations",
                  behind ? "one behind the other" : "side by side", worst);
        CHECK_MSG(fabs(mean - want) < 4.5 * sqrt(want * (1 - want) / frames / (W * H)) + 0.002, "%s: mean %g, not %g",
                  behind ? "one behind the other" : "side by side", mean, want);
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
        free(rgb);
        free(rgba);
        free(sum);
    }
}

/* A square across the picture at a depth, of n x n squares of one material and its colour. */
static void pane_add(zbufrand_scene *scene, shape *s, uint8_t *rgb, uint32_t n, double z, uint32_t material) {
    static const uint8_t shade[3][3] = {{255, 255, 255}, {0, 0, 0}, {255, 0, 0}};
    zbufrand_mesh m;
    uint32_t i;
    memset(s, 0, sizeof *s);
    for (i = 0; i < (n + 1) * (n + 1); i++) (void)shape_vertex(s, 5.4 * (i / (n + 1)) / n - 2.7, 5.4 * (i % (n + 1)) / n - 2.7, z);
    for (i = 0; i < n * n; i++) {
        const uint32_t a = i / n * (n + 1) + i % n, c = a + n + 1;
        shape_triangle(s, a, c, c + 1);
        shape_triangle(s, a, c + 1, a + 1);
        memcpy(rgb + 6 * i, shade[material], 3);
        memcpy(rgb + 6 * i + 3, shade[material], 3);
    }
    m = mesh_of(s);
    m.triangle_rgb = rgb;
    m.material = material;
    CHECK_EQ_U64(zbufrand_add_mesh(scene, ZBUFRAND_ROOT, NULL, 0, &m, NULL), ZBUFRAND_OK);
}

static void pane_way(zbufrand_render_desc *d, uint32_t way) { /* by which pixels come about */
    memset(d, 0, sizeof *d);
    d->camera.eye[2] = 4;
    d->unlit = 1;
    d->no_lists = way != 5 && way != 6;
    d->density = 7;
    if (way == 0) d->hybrid = ZBUFRAND_HYBRID_ALL;
    if (way == 1 || way >= 6) d->hybrid = ZBUFRAND_HYBRID_OFF;
    if (way == 2 || way == 3) { /* so dear that stored points are drawn, or points of clusters */
        d->hybrid = ZBUFRAND_HYBRID_OFF;
        if (way == 2) d->costs.cluster = d->costs.sample = 1e6f;
        else d->costs.set = 1e6f;
    }
    if (way == 9) { /* stored points of nodes, which have some of all panes */
        d->density = 0.05;
        d->hybrid = ZBUFRAND_HYBRID_OFF;
        d->no_repair = 1;
    }
    if (way == 4) { /* rays have to find a quarter of it */
        d->density = 1.4;
        d->hybrid = ZBUFRAND_HYBRID_OFF;
    }
}

/* A wall of glass before a wall, both over all of the picture. Whatever way a pixel comes about (rasterised, samples of clusters,
   stored ones, the thesis' trees, rays; scalar or not), it shows the same wall in the same frame, and glass as often as it is opaque:
   in the mean of frames, for all pixels together and for each of them (p below 1e-5). A second pane behind the first, of the same
   material, changes nothing; one of another material takes its share of what shines through. */
TEST(panes) {
    enum { W = 33, H = 21, WAYS = 10 };
    static const float opacity[3] = {0.3f, 1.0f, 0.6f};
    const uint32_t frames = test_quick() ? 40 : 150;
    uint32_t panes, fine, way, k, i, j, seen = 0;
    for (panes = 1; panes <= 3; panes++) {
        double first[W * H], sum[3] = {0, 0, 0}, worst = 0;
        memset(first, 0, sizeof first);
        for (fine = 0; fine < 2; fine++) { /* two triangles, many: stored points are of all panes then */
            zbufrand_scene *scene = NULL;
            zbufrand_build_desc bd;
            shape s[4];
            uint8_t *rgb[4];
            static float rgba[WAYS][4 * W * H];
            memset(&bd, 0, sizeof bd);
            bd.structure = ZBUFRAND_STRUCTURE_FAIR_SPLIT;
            CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
            for (j = 0; j <= panes; j++) { /* glass, perhaps again, perhaps red glass; the wall is the last */
                const uint32_t material = j == panes ? 1 : panes == 3 && j == 1 ? 2 : 0, n = fine ? 110 : 1;
                rgb[j] = (uint8_t *)malloc(6 * n * n);
                REQUIRE(rgb[j] != NULL);
                pane_add(scene, &s[j], rgb[j], n, -0.1 * j, material);
                if (j == panes) CHECK_EQ_U64(zbufrand_scene_build(scene, &bd, NULL), ZBUFRAND_OK);
            }
            for (k = 0; k < (fine ? 2 : frames); k++) {
                for (way = 0; way < (k < 2 ? WAYS : 1); way++) {
                    zbufrand_frame *frame = open_frame(way == 8 ? 3 : 1, way == 7 ? ZBUFRAND_ISA_SCALAR : ZBUFRAND_ISA_AUTO);
                    zbufrand_render_desc d;
                    zbufrand_image image;
                    zbufrand_stats st;
                    pane_way(&d, way);
                    memset(&image, 0, sizeof image);
                    image.width = W;
                    image.height = H;
                    image.rgba = rgba[way];
                    d.frame = k;
                    d.opacity = opacity;
                    d.opacity_count = 3;
                    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, &st), ZBUFRAND_OK);
                    if (way == 4) CHECK(st.repaired > 0);
                    if (way == 2 && fine) CHECK(st.draws[0] > 0 && st.draws[2] == 0);
                    if (way == 9 && fine) CHECK(st.draws[0] > 0 && st.draws[1] == 0);
                    if (way == 3 && fine) CHECK(st.draws[1] > 0 && st.draws[2] == 0);
                    zbufrand_frame_destroy(frame);
                    for (i = 0; i < W * H && way == 9; i++) { /* few samples: nothing that the pixel does not show */
                        const float *c = &rgba[9][4 * i], *e = &rgba[0][4 * i];
                        CHECK((c[1] < 0.5f || e[1] > 0.5f) && (c[0] < 0.5f || c[1] > 0.5f || e[0] > 0.5f));
                        seen += c[3] > 0.0f;
                    }
                    if (way == 9) break;
                    for (i = 0, j = 0; i < W * H; i++) j += memcmp(&rgba[way][4 * i], &rgba[0][4 * i], 16) != 0;
                    /* a pixel without a sample shows what is behind: exp(-7) of them, and what rays do not find */
                    CHECK_MSG(j <= (way == 4 ? W * H / 6 : 8), "%u panes, mesh %u, frame %u, way %u: %u pixels differ", panes, fine, k, way, j);
                }
                for (i = 0; i < W * H && !fine; i++) {
                    const float *c = &rgba[0][4 * i];
                    const int white = c[1] > 0.5f, red = c[0] > 0.5f && !white;
                    first[i] += (double)white / frames;
                    sum[white ? 0 : red ? 2 : 1] += 1.0 / ((double)frames * W * H);
                }
            }
            for (j = 0; j <= panes; j++) {
                free(rgb[j]);
                shape_free(&s[j]);
            }
            zbufrand_scene_destroy(scene);
        }
        for (i = 0; i < W * H; i++) {
            const double off = fabs(first[i] - 0.3) / sqrt(0.3 * 0.7 / frames);
            worst = off > worst ? off : worst;
        }
        CHECK_MSG(worst < 5.5, "%u panes: a pixel is off by %g standard deviations", panes, worst);
        CHECK_MSG(fabs(sum[0] - 0.3) < 4.5 * sqrt(0.21 / ((double)frames * W * H)), "%u panes: %g of 0.3", panes, sum[0]);
        CHECK_MSG(fabs(sum[2] - (panes == 3 ? 0.7 * 0.6 : 0)) < 4.5 * sqrt(0.25 / ((double)frames * W * H)), "%u panes: red %g", panes, sum[2]);
    }
    CHECK(seen > 200);
}

TEST(own_shading) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = open_frame(3, ZBUFRAND_ISA_AUTO);
    zbufrand_render_desc d;
    zbufrand_stats st;
    buffers b;
    uint8_t *rgb;
    uint32_t rings, i, k, a;
    for (rings = 20; rings <= 500; rings *= 5) {
        seen_by u;
        memset(&s, 0, sizeof s);
        shape_sphere(&s, 0, 0, 0, 1, rings);
        rgb = (uint8_t *)malloc(3 * s.vertices);
        REQUIRE(rgb != NULL);
        for (i = 0; i < s.vertices; i++) for (k = 0; k < 3; k++) rgb[3 * i + k] = (uint8_t)(127.5f + 127.0f * s.normal[3 * i + k]);
        m = mesh_of(&s);
        m.vertex_rgb = rgb;
        m.normals = s.normal;
        m.material = 3;
        scene = render_scene_of(&m, 1);
        buffers_open(&b, 100, 80);
        memset(&d, 0, sizeof d);
        memset(&u, 0, sizeof u);
        d.camera.eye[0] = 1;
        d.camera.eye[2] = 4;
        u.camera = d.camera;
        u.s = &s;
        d.shade_fn = own_shade;
        d.shade_user = &u;
        if (rings == 500) d.hybrid = ZBUFRAND_HYBRID_OFF;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        CHECK_EQ_U64(u.count, st.covered); /* winners only */
        CHECK_MSG(u.bad == 0, "%u of %u surfaces are not as they should be", u.bad, u.count);
        if (rings == 20) CHECK_EQ_U64(u.nodes, st.covered);
        { /* the colours come out as sRGB bytes again */
            zbufrandi_camera c;
            uint32_t off = 0;
            CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, 100, 80, 0, &c), ZBUFRAND_OK);
            for (i = 0; i < 100 * 80; i++) {
                double x = ((double)(i % 100) + 0.5 - c.center_x) / c.focal, y = (c.center_y - (double)(i / 100) - 0.5) / c.focal, p;
                if (!(b.depth[i] < 3.9f)) continue;
                for (a = 0; a < 3; a++) {
                    p = c.eye[a] + (double)b.depth[i] * (c.dir[a] + x * c.right[a] + y * c.up[a]);
                    off += fabs((double)b.rgba8[4 * i + a] - (127.5 + 127 * p)) > 12;
                }
            }
            CHECK_MSG(off < st.covered / 50, "%u channels are off", off);
        }
        buffers_close(&b);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
        free(rgb);
    }
    zbufrand_frame_destroy(frame);
}

TEST(nodes_backgrounds_strides) {
    shape s[2];
    zbufrand_mesh m[2];
    zbufrand_scene *scene = NULL;
    zbufrand_node node[2];
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_render_desc d;
    zbufrand_image image;
    static uint8_t rgba8[50 * 700];
    static float depth[50 * 200];
    static uint32_t ids[50 * 90];
    uint32_t k, x, y, left = 0, right = 0;
    memset(s, 0, sizeof s);
    shape_box(&s[0], -2, -1, -1, -0.5, 1, 1);
    shape_box(&s[1], 0.5, -1, -1, 2, 1, 1);
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
    for (k = 0; k < 2; k++) {
        m[k] = mesh_of(&s[k]);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, NULL, 0, &m[k], &node[k]), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    memset(&image, 0, sizeof image);
    memset(&d, 0, sizeof d);
    memset(rgba8, 0x55, sizeof rgba8);
    image.width = 80;
    image.height = 50;
    image.rgba8 = rgba8;
    image.rgba8_stride = 700;
    image.depth = depth;
    image.depth_stride = 800;
    image.node = ids;
    image.node_stride = 360;
    d.camera.eye[2] = 8;
    d.unlit = 1;
    d.background[0] = 0.5f;
    d.background[3] = 1.0f;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, NULL), ZBUFRAND_OK);
    for (y = 0; y < 50; y++) {
        for (x = 0; x < 80; x++) {
            const uint8_t *p = rgba8 + 700 * y + 4 * x;
            int empty = !(depth[200 * y + x] < INFINITY);
            uint32_t id = ids[90 * y + x];
            CHECK(empty ? id == 0 : x < 40 ? id == node[0] : id == node[1]);
            left += id == node[0];
            right += id == node[1];
            if (empty) CHECK(p[0] == 188 && p[1] == 0 && p[2] == 0 && p[3] == 255);
            else CHECK(p[0] == 255 && p[1] == 255 && p[2] == 255 && p[3] == 255);
        }
        CHECK(rgba8[700 * y + 320] == 0x55);
    }
    CHECK(left > 100 && right > 100);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* Point clouds: one sample each, the nearest is seen, with a scene between them. */
TEST(clouds) {
    test_rng r = test_rng_make(6);
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = open_frame(2, ZBUFRAND_ISA_AUTO);
    zbufrand_points p;
    zbufrand_render_desc d;
    zbufrand_stats st;
    zbufrandi_camera c;
    buffers b;
    const uint32_t n = 100000;
    float *xyz = (float *)malloc(12 * n), want[80 * 60];
    uint8_t *rgb = (uint8_t *)malloc(3 * n);
    uint32_t i, k, a, differ = 0;
    REQUIRE(xyz != NULL && rgb != NULL);
    memset(&s, 0, sizeof s);
    shape_box(&s, -1, -1, -0.1, 1, 1, 0.1);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    for (i = 0; i < n; i++) {
        for (a = 0; a < 3; a++) xyz[3 * i + a] = test_rng_range(&r, -3, 3);
        for (a = 0; a < 3; a++) rgb[3 * i + a] = (uint8_t)(i >> 8 * a);
    }
    xyz[5] = NAN;
    buffers_open(&b, 80, 60);
    for (k = 0; k < 2; k++) {
        memset(&p, 0, sizeof p);
        memset(&d, 0, sizeof d);
        p.positions = xyz;
        p.rgb = rgb;
        p.count = n;
        d.points = &p;
        d.points_count = 1;
        d.camera.eye[2] = 7;
        d.camera.near_z = 1;
        d.unlit = 1;
        CHECK_EQ_U64(zbufrand_render(frame, &d, k ? scene : NULL, &b.image, &st), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, NULL, 80, 60, 0, &c), ZBUFRAND_OK);
        for (i = 0; i < 80 * 60; i++) want[i] = INFINITY;
        for (i = 0; i < n; i++) {
            double z = 7 - (double)xyz[3 * i + 2], x = c.center_x + c.focal * (double)xyz[3 * i] / z, y = c.center_y - c.focal * (double)xyz[3 * i + 1] / z;
            if (!(z >= 1 && x >= 0 && x < 80 && y >= 0 && y < 60)) continue;
            if ((float)z < want[(int)y * 80 + (int)x]) want[(int)y * 80 + (int)x] = (float)z;
        }
        for (i = 0; i < 80 * 60; i++) {
            if (k == 0) {
                differ += want[i] != b.depth[i] && fabs((double)want[i] / (double)b.depth[i] - 1) > 1e-6;
                if (b.depth[i] < INFINITY) { /* the colour says which point it was */
                    uint32_t at = (uint32_t)b.rgba8[4 * i] | (uint32_t)b.rgba8[4 * i + 1] << 8 | (uint32_t)b.rgba8[4 * i + 2] << 16;
                    CHECK(at < n && fabs(7 - (double)xyz[3 * at + 2] - (double)b.depth[i]) < 1e-5);
                }
            } else if (b.depth[i] < want[i] * 0.999f) {
                CHECK(b.depth[i] > 6.5f && b.depth[i] < 7.5f); /* the box is before it */
            } else {
                CHECK(want[i] == INFINITY || fabs((double)want[i] / (double)b.depth[i] - 1) < 1e-5);
            }
        }
        CHECK_MSG(differ < 4, "%u pixels differ", differ);
        if (k == 0) CHECK(st.points > 50000);
    }
    buffers_close(&b);
    free(xyz);
    free(rgb);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* 10^6 away, four levels deep: the same picture as at home. */
TEST(far_from_home) {
    shape s;
    zbufrand_mesh m;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    buffers b[2];
    uint32_t k, i, l, n, differ;
    zbufrand_stats st;
    memset(&s, 0, sizeof s);
    shape_torus(&s, 0, 0, 0, 1, 0.4, 60, 30);
    m = mesh_of(&s);
    for (n = 0; n < 4; n++) { /* rastered; sampled, with rays */
        zbufrand_scene *scene = NULL;
        zbufrand_node lib, node, list;
        zbufrand_render_desc d;
        k = n & 1;
        buffers_open(&b[k], 100, 80);
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &node), ZBUFRAND_OK);
        for (l = 0; l < 4; l++) {
            zbufrand_transform t;
            memset(&t, 0, sizeof t);
            t.m[0][0] = t.m[1][1] = t.m[2][2] = 1;
            if (k == 1) t.m[0][3] = t.m[2][3] = 1e6 * (l + 1);
            CHECK_EQ_U64(zbufrand_add_list(scene, l == 3 ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_add_reference(scene, list, &t, node, NULL), ZBUFRAND_OK);
            node = list;
        }
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
        memset(&d, 0, sizeof d);
        d.camera.at[0] = d.camera.at[2] = k == 1 ? 1e7 : 0;
        d.camera.eye[0] = d.camera.at[0] + 0.3;
        d.camera.eye[2] = d.camera.at[2] + 4;
        d.camera.eye[1] = 2;
        d.camera.near_z = 0.01;
        d.hybrid = n < 2 ? ZBUFRAND_HYBRID_ALL : ZBUFRAND_HYBRID_OFF;
        d.density = 2;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b[k].image, &st), ZBUFRAND_OK);
        CHECK(st.covered > 1000 && (n < 2 || st.repaired > 10));
        zbufrand_scene_destroy(scene);
        if (k == 0) continue;
        differ = 0;
        for (i = 0; i < 100 * 80; i++) {
            differ += (b[0].depth[i] < INFINITY) != (b[1].depth[i] < INFINITY) ||
                      (b[0].depth[i] < INFINITY && fabs((double)b[0].depth[i] / (double)b[1].depth[i] - 1) > 1e-5);
        }
        CHECK_MSG(differ < 20, "%s: %u pixels differ", n < 2 ? "rastered" : "sampled", differ);
        buffers_close(&b[0]);
        buffers_close(&b[1]);
    }
    zbufrand_frame_destroy(frame);
    shape_free(&s);
}

/* Numbers of triangles hardly matter: 1.3 * 10^13 against 10^4 of the same area in the picture. */
TEST(thirteen_decades) {
    shape s;
    zbufrand_mesh m;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    uint64_t covered[2] = {0, 0}, work[2] = {0, 0};
    uint32_t k, l, i, j;
    memset(&s, 0, sizeof s);
    for (i = 0; i <= 60; i++) for (j = 0; j <= 60; j++) (void)shape_vertex(&s, i / 60.0, 0, j / 60.0);
    for (i = 0; i < 60; i++) {
        for (j = 0; j < 60; j++) {
            uint32_t a = i * 61 + j, b = a + 61;
            shape_triangle(&s, a, a + 1, b + 1);
            shape_triangle(&s, a, b + 1, b);
        }
    }
    m = mesh_of(&s);
    for (k = 0; k < 2; k++) {
        zbufrand_scene *scene = NULL;
        zbufrand_node lib, node, list;
        zbufrand_scene_info info;
        zbufrand_render_desc d;
        zbufrand_stats st;
        buffers b;
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &node), ZBUFRAND_OK);
        for (l = 0; l < (k == 0 ? 1u : 5u); l++) {
            uint32_t n = k == 0 ? 1 : 8;
            CHECK_EQ_U64(zbufrand_add_list(scene, l == (k == 0 ? 0u : 4u) ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
            for (i = 0; i < n; i++) {
                for (j = 0; j < n; j++) {
                    zbufrand_transform t;
                    memset(&t, 0, sizeof t);
                    t.m[0][0] = t.m[1][1] = t.m[2][2] = 1.0 / n;
                    t.m[0][3] = (double)i / n;
                    t.m[2][3] = (double)j / n;
                    CHECK_EQ_U64(zbufrand_add_reference(scene, list, &t, node, NULL), ZBUFRAND_OK);
                }
            }
            node = list;
        }
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, &info), ZBUFRAND_OK);
        CHECK_EQ_U64(info.triangles, k == 0 ? 7200u : 7200ull << 30);
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = d.camera.at[0] = d.camera.at[2] = 0.5;
        d.camera.eye[1] = 1.5;
        d.camera.eye[2] = 3;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        buffers_open(&b, 320, 240);
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        covered[k] = st.covered;
        work[k] = st.samples[0] + st.samples[1] + 20 * st.nodes;
        buffers_close(&b);
        zbufrand_scene_destroy(scene);
    }
    CHECK(covered[0] > 4000);
    CHECK_NEAR((double)covered[1] / (double)covered[0], 1, 0.02);
    CHECK_MSG((double)work[1] < 1.5 * (double)work[0], "work %llu and %llu", (unsigned long long)work[0], (unsigned long long)work[1]);
    zbufrand_frame_destroy(frame);
    shape_free(&s);
}

/* Draws more when the rays show that more pixels were wrong than the density promises. No scene does that as long as bounds hold, so
   the areas of all nodes are made too small by hand, and with them the numbers of samples. */
TEST(draws_more_if_too_little) {
    enum { W = 120, H = 120, N = 240 };
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    buffers a, b;
    zbufrand_stats st[3];
    uint32_t i, k, way, differ;
    memset(&s, 0, sizeof s);
    memset(st, 0, sizeof st);
    for (i = 0; i <= N; i++) for (k = 0; k <= N; k++) (void)shape_vertex(&s, 4.0 * i / N - 2, 4.0 * k / N - 2, 0.1 * sin(0.1 * i) * cos(0.07 * k));
    for (i = 0; i < N; i++) {
        for (k = 0; k < N; k++) {
            const uint32_t at = i * (N + 1) + k, next = at + N + 1;
            shape_triangle(&s, at, next, next + 1);
            shape_triangle(&s, at, next + 1, at + 1);
        }
    }
    m = mesh_of(&s);
    m.two_sided = 1;
    scene = render_scene_of(&m, 1);
    buffers_open(&a, W, H);
    buffers_open(&b, W, H);
    for (way = 0; way < 3; way++) { /* rastered, right areas, areas too small */
        zbufrand_render_desc d;
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = 0.5;
        d.camera.eye[2] = 9;
        d.tolerance = 0.001;
        d.hybrid = way == 0 ? ZBUFRAND_HYBRID_ALL : ZBUFRAND_HYBRID_OFF;
        for (i = 0; way == 2 && i < scene->structure[0].node_count; i++)
            for (k = 0; k < scene->structure[0].node[i].count; k++) scene->structure[0].node[i].area[k] *= 0.5f;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, way == 0 ? &a.image : &b.image, &st[way]), ZBUFRAND_OK);
        if (way == 0) continue;
        CHECK(st[way].samples[0] > st[way].samples[1] && st[way].covered > 2000);
        CHECK_MSG(st[way].incomplete <= 0.001, "way %u: %g", way, st[way].incomplete);
        for (i = 0, differ = 0; i < W * H; i++)
            differ += a.depth[i] < INFINITY && !(fabsf(b.depth[i] / a.depth[i] - 1) < 0.01f);
        CHECK_MSG(differ < 200, "way %u: %u pixels differ", way, differ); /* at the outline */
    }
    CHECK_MSG(st[2].density > 1.2 * st[1].density, "density %g and %g", st[2].density, st[1].density);
    CHECK(2 * st[2].samples[0] > st[1].samples[0] + st[1].samples[0] / 10); /* half of them and more */
    CHECK_MSG(st[2].repaired > 50, "%llu repaired", (unsigned long long)st[2].repaired);
    buffers_close(&a);
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    zbufrand_frame_destroy(frame);
    shape_free(&s);
}

/* Tiles of posts in many colours, nested, seen from far away: all parts of the picture have the colours of an exact picture,
   though each tile is drawn from few stored points. There are no points for directions of view of what is made of instances: they
   are too few for it, and all of a part of the picture would have the colour of some of them. */
TEST(far_away_as_colourful) {
    enum { W = 160, H = 90, PARTS = 8 };
    zbufrand_scene *scene = NULL;
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_node lib, node, tile, list, post[8];
    zbufrand_mesh m;
    zbufrand_transform t;
    buffers b;
    double mean[2][PARTS][3];
    test_rng r = test_rng_make(12);
    static uint8_t rgb[8][36];
    shape s[8];
    uint32_t i, k, l, way;
    memset(mean, 0, sizeof mean);
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    for (i = 0; i < 8; i++) {
        memset(&s[i], 0, sizeof s[i]);
        shape_box(&s[i], -0.5, 0, -0.5, 0.5, 1 + 0.2 * i, 0.5);
        m = mesh_of(&s[i]);
        for (k = 0; k < 36; k++) rgb[i][k] = (uint8_t)(i >> k % 3 & 1 ? 230 : 20);
        m.triangle_rgb = rgb[i];
        CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &post[i]), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_add_list(scene, lib, NULL, 0, &tile), ZBUFRAND_OK);
    for (i = 0; i < 100; i++) {
        t = move_scale(i % 10 + 0.5, 0, i / 10 + 0.5, 0.9);
        CHECK_EQ_U64(zbufrand_add_reference(scene, tile, &t, post[test_rng_below(&r, 8)], NULL), ZBUFRAND_OK);
    }
    for (l = 0, node = tile; l < 2; l++) { /* 8 x 8, and that 4 x 4 times */
        const uint32_t n = l == 0 ? 8 : 4;
        CHECK_EQ_U64(zbufrand_add_list(scene, l == 1 ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
        for (i = 0; i < n * n; i++) {
            t = move_scale((l == 0 ? 10.0 : 80.0) * (i % n), 0, (l == 0 ? 10.0 : 80.0) * (i / n), 1);
            CHECK_EQ_U64(zbufrand_add_reference(scene, list, &t, node, NULL), ZBUFRAND_OK);
        }
        node = list;
    }
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    for (i = 0; i < scene->structure_count; i++) CHECK(scene->structure[i].instance_count == 0 || scene->structure[i].first_view == 0);
    buffers_open(&b, W, H);
    for (way = 0; way < 2; way++) {
        zbufrand_render_desc d;
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = d.camera.at[0] = 160;
        d.camera.eye[1] = 300;
        d.camera.eye[2] = 1200;
        d.camera.at[2] = 160;
        d.camera.fov_y = 10;
        d.density = 2;
        d.unlit = 1;
        d.oversample = 2;
        d.hybrid = way ? ZBUFRAND_HYBRID_OFF : ZBUFRAND_HYBRID_ALL;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
        for (i = 0; i < W * H; i++) {
            const uint32_t part = i / W * 2 / H * 4 + i % W * 4 / W;
            for (k = 0; k < 3; k++) mean[way][part][k] += (double)b.rgba[4 * i + k] / (W * H / PARTS);
        }
    }
    for (i = 0; i < PARTS; i++) {
        for (k = 0; k < 3; k++) {
            CHECK_MSG(fabs(mean[1][i][k] / mean[0][i][k] - 1) < 0.06, "part %u, channel %u: %g, not %g", i, k, mean[1][i][k], mean[0][i][k]);
        }
    }
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    for (i = 0; i < 8; i++) shape_free(&s[i]);
}

/* Tiles of spikes, half of them bright, from two distances: tiles are drawn as a whole, and from the parts of their tree. Whatever the
   seed, the mean colour is that of an exact picture, at each distance: no seam between them. All tiles once showed the same 64 points:
   the mean was off by up to 0.34; with 64 sets of the whole and 8 of the parts by 0.041 (root of the mean square). */
TEST(any_seed_as_colourful) {
    enum { W = 96, H = 54, SPIKES = 2048, MODELS = 8, SEEDS = 10, FAR = 2, PICTURES = 8 };
    static const double fov[FAR] = {40, 16};
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    buffers b;
    shape s;
    static uint8_t rgb[3 * 3 * SPIKES];
    double mean[FAR], square[FAR];
    test_rng r = test_rng_make(21);
    uint32_t i, k, seed, away, picture;
    memset(mean, 0, sizeof mean);
    memset(square, 0, sizeof square);
    memset(&s, 0, sizeof s);
    for (i = 0; i < SPIKES; i++) {
        const double x = (double)(i % 16) + 0.5, z = (double)(i / 16 % 16) + 0.5, h = 1 + 3 * test_rng_double(&r);
        const uint8_t light = (uint8_t)(test_rng_below(&r, 2) == 0 ? 180 : 60);
        uint32_t v[4];
        for (k = 0; k < 3; k++) v[k] = shape_vertex(&s, x + 0.8 * cos(2.1 * k + (double)i), 0, z - 0.8 * sin(2.1 * k + (double)i));
        v[3] = shape_vertex(&s, x, h, z);
        for (k = 0; k < 3; k++) shape_triangle(&s, v[k], v[(k + 1) % 3], v[3]);
        memset(&rgb[9 * i], light, 9);
    }
    buffers_open(&b, W, H);
    for (seed = 0; seed <= SEEDS; seed++) { /* 0: rastered */
        zbufrand_scene *scene = NULL;
        zbufrand_node lib, spikes[MODELS], tile;
        zbufrand_build_desc build;
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene, lib, NULL, 0, &tile), ZBUFRAND_OK);
        for (i = 0; i < MODELS; i++) {
            const size_t triangles = 3 * SPIKES / MODELS;
            zbufrand_mesh m = mesh_of(&s);
            m.indices += 3 * i * triangles;
            m.triangle_count = triangles;
            m.triangle_rgb = rgb + 3 * i * triangles;
            CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &spikes[i]), ZBUFRAND_OK);
        }
        for (i = 0; i < 32; i++) { /* tiles of 8 x 4 models, 16 x 32 tiles */
            zbufrand_transform t = move_scale(4.0 * (i % 8), 0, 4.0 * (i / 8), 0.25);
            CHECK_EQ_U64(zbufrand_add_reference(scene, tile, &t, spikes[i * 5 % MODELS], NULL), ZBUFRAND_OK);
        }
        for (i = 0; i < 16 * 32; i++) {
            zbufrand_transform t = move_scale(32.0 * (i % 16) - 256, 0, 16.0 * (i / 16) - 256, 1);
            CHECK_EQ_U64(zbufrand_add_reference(scene, 1, &t, tile, NULL), ZBUFRAND_OK);
        }
        memset(&build, 0, sizeof build);
        build.seed = seed;
        CHECK_EQ_U64(zbufrand_scene_build(scene, &build, NULL), ZBUFRAND_OK);
        for (away = 0; away < FAR; away++) {
            zbufrand_render_desc d;
            double sum = 0, covered = 1e-9;
            memset(&d, 0, sizeof d);
            d.camera.eye[2] = 1000;
            d.camera.eye[1] = 500;
            d.camera.fov_y = fov[away];
            d.density = 1.5;
            d.unlit = 1;
            d.oversample = seed == 0 ? 4 : 1;
            d.hybrid = seed == 0 ? ZBUFRAND_HYBRID_ALL : ZBUFRAND_HYBRID_OFF;
            for (picture = 0; picture < (seed == 0 ? 1 : PICTURES); picture++) { /* which tile takes which points is another chance */
                d.seed = seed * PICTURES + picture;
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
                for (i = 0; i < W * H; i++) {
                    sum += (double)b.rgba[4 * i];
                    covered += (double)b.rgba[4 * i + 3];
                }
            }
            CHECK_MSG(covered > W * H / 24, "%g", covered);
            sum /= covered;
            if (seed == 0) mean[away] = sum;
            if (test_g.verbose) printf("%+.3f ", sum / mean[away] - 1);
            CHECK_MSG(fabs(sum / mean[away] - 1) < 0.1, "seed %u, distance %u: %+.3f", seed, away, sum / mean[away] - 1);
            square[away] += (sum / mean[away] - 1) * (sum / mean[away] - 1) / SEEDS;
        }
        zbufrand_scene_destroy(scene);
    }
    for (away = 0; away < FAR; away++) CHECK_MSG(square[away] < 0.033 * 0.033, "distance %u: %.3f", away, sqrt(square[away]));
    buffers_close(&b);
    zbufrand_frame_destroy(frame);
    shape_free(&s);
}

/* ---- larger pictures, averaged ---- */

/* Each pixel is the mean of its parts in the larger picture, bit for bit; its depth and mesh those of the nearest. */
TEST(oversampled) {
    enum { W = 61, H = 43, K = 3, LARGE = W * K * H * K };
    shape s[2];
    zbufrand_scene *scene = forest(s, 300);
    zbufrand_frame *frame = open_frame(2, ZBUFRAND_ISA_AUTO);
    zbufrand_render_desc d;
    zbufrand_stats st[2];
    buffers one, parts;
    uint32_t i, k, x, y, way, wrong = 0, edges = 0;
    buffers_open(&one, W, H);
    buffers_open(&parts, W * K, H * K);
    for (way = 0; way < 2; way++) { /* transparent, before a sky */
        memset(&d, 0, sizeof d);
        d.camera.eye[0] = 40;
        d.camera.eye[1] = 12;
        d.camera.eye[2] = 40;
        d.density = 2;
        d.background[2] = d.background[3] = (float)way;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &parts.image, &st[0]), ZBUFRAND_OK);
        d.oversample = K;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &one.image, &st[1]), ZBUFRAND_OK);
        CHECK_EQ_U64(st[1].samples[0] + st[1].samples[1] + st[1].covered, st[0].samples[0] + st[0].samples[1] + st[0].covered);
        for (i = 0; i < W * H; i++) {
            float sum[4] = {0, 0, 0, 0}, z = INFINITY;
            uint32_t node = 0;
            uint8_t want[4];
            for (y = i / W * K; y < i / W * K + K; y++) {
                for (x = i % W * K; x < i % W * K + K; x++) {
                    const size_t at = (size_t)y * W * K + x;
                    for (k = 0; k < 4; k++) sum[k] += parts.rgba[4 * at + k];
                    if (parts.depth[at] < z) {
                        z = parts.depth[at];
                        node = parts.node[at];
                    }
                }
            }
            for (k = 0; k < 4; k++) sum[k] *= 1.0f / (K * K);
            edges += sum[3] > 0 && sum[3] < 1;
            for (k = 0; k < 3; k++) want[k] = (uint8_t)(255 * zbufrandi_linear_to_srgb(sum[3] > 0 ? (double)(sum[k] / sum[3]) : 0) + 0.5);
            want[3] = (uint8_t)(255 * sum[3] + 0.5f);
            for (k = 0; k < 4; k++) wrong += abs((int)one.rgba8[4 * i + k] - (int)want[k]) > 1;
            wrong += memcmp(sum, one.rgba + 4 * i, sizeof sum) != 0 || one.depth[i] != z || one.node[i] != node;
        }
        CHECK_MSG(wrong == 0, "way %u: %u values are off", way, wrong);
    }
    CHECK(edges > 100);
    d.oversample = 17;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &one.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
    d.oversample = 16;
    one.image.width = 2001;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &one.image, NULL), ZBUFRAND_ERR_RANGE);
    one.image.width = 0;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &one.image, NULL), ZBUFRAND_OK);
    buffers_close(&one);
    buffers_close(&parts);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* ---- quality ---- */

/* How near a picture is to the mean of 8 x 8 exact ones for each pixel: PSNR and SSIM (7 x 7 windows, green, sRGB) of one frame, of
   2 x 2 parts, of blocks of 2. Thresholds are a little below what is reached today: what makes pictures worse is seen here. */
static void similarity(const float *rgba, const float *want, uint32_t w, uint32_t h, double *psnr, double *ssim) {
    double sum = 0, windows = 0;
    uint32_t x, y, i, j;
    *ssim = 0;
    for (i = 0; i < w * h; i++) {
        for (j = 0; j < 3; j++) {
            const double e = zbufrandi_linear_to_srgb((double)rgba[4 * i + j]) - zbufrandi_linear_to_srgb((double)want[4 * i + j]);
            sum += e * e / (3.0 * w * h);
        }
    }
    *psnr = -10 * log10(sum);
    for (y = 0; y + 7 <= h; y += 4) {
        for (x = 0; x + 7 <= w; x += 4) {
            double a = 0, b = 0, aa = 0, bb = 0, ab = 0;
            for (i = 0; i < 49; i++) {
                const uint32_t at = (y + i / 7) * w + x + i % 7;
                const double p = zbufrandi_linear_to_srgb((double)rgba[4 * at + 1]), q = zbufrandi_linear_to_srgb((double)want[4 * at + 1]);
                a += p / 49;
                b += q / 49;
                aa += p * p / 49;
                bb += q * q / 49;
                ab += p * q / 49;
            }
            *ssim += (2 * a * b + 1e-4) * (2 * (ab - a * b) + 9e-4) / ((a * a + b * b + 1e-4) * (aa - a * a + bb - b * b + 9e-4));
            windows++;
        }
    }
    *ssim /= windows;
}

TEST(pictures_stay_as_good) {
    enum { W = 120, H = 90 };
    static const struct { double psnr, ssim; } least[3][3] = {
        {{31.6, 0.97}, {39.0, 0.99}, {26.9, 0.93}}, {{20.6, 0.77}, {25.9, 0.88}, {19.3, 0.72}}, {{19.65, 0.62}, {25.0, 0.83}, {18.1, 0.57}}
    }; /* forests: four standard deviations of seeds of builds, 0.1 to 0.2 dB, below their mean */
    uint32_t world, way;
    for (world = 0; world < 3; world++) {
        zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        test_rng r = test_rng_make(3);
        shape s[2];
        zbufrand_mesh m;
        zbufrand_scene *scene;
        buffers want, b;
        memset(s, 0, sizeof s);
        buffers_open(&want, W, H);
        buffers_open(&b, W, H);
        if (world == 0) three_balls(&s[0], 60);
        if (world == 1) soup(&s[0], &r, 20000, 0.02, 1);
        m = mesh_of(&s[0]);
        m.two_sided = world == 1;
        scene = world == 2 ? forest(s, 400) : render_scene_of(&m, 1);
        for (way = 0; way < 4; way++) {
            zbufrand_render_desc d;
            double psnr, ssim;
            memset(&d, 0, sizeof d);
            d.background[1] = d.background[2] = 0.3f;
            d.background[3] = 1;
            d.camera.eye[0] = world == 2 ? 40 : 2;
            d.camera.eye[1] = world == 2 ? 12 : 1.5;
            d.camera.eye[2] = world == 2 ? 40 : world == 1 ? 3 : 9;
            if (world == 1) d.camera.at[0] = d.camera.at[1] = d.camera.at[2] = 0.5;
            if (way == 0) {
                d.hybrid = ZBUFRAND_HYBRID_ALL;
                d.oversample = 8;
            } else {
                d.hybrid = ZBUFRAND_HYBRID_OFF;
            }
            if (way == 2) d.oversample = 2;
            if (way == 3) d.reconstruct.block = 2;
            if (way == 0) {
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &want.image, NULL), ZBUFRAND_OK);
                continue;
            }
            psnr = ssim = 0.0;
            for (d.frame = 0; d.frame < (way == 1 ? 4u : 1u); d.frame++) { /* of samples alone one scatters by 0.3 dB */
                double one[2] = {0.0, 0.0};
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
                similarity(b.rgba, want.rgba, W, H, &one[0], &one[1]);
                psnr += (way == 1 ? 0.25 : 1.0) * one[0];
                ssim += (way == 1 ? 0.25 : 1.0) * one[1];
            }
            CHECK_MSG(psnr > least[world][way - 1].psnr && ssim > least[world][way - 1].ssim, "world %u, way %u: %.2f dB, SSIM %.4f", world, way, psnr, ssim);
        }
        zbufrand_scene_destroy(scene);
        shape_free(&s[0]);
        shape_free(&s[1]);
        buffers_close(&want);
        buffers_close(&b);
        zbufrand_frame_destroy(frame);
    }
}

/* ---- golden pictures ---- */

static void put_u32(uint8_t *out, uint32_t v) {
    uint32_t k;
    for (k = 0; k < 4; k++) out[k] = (uint8_t)(v >> 8 * k);
}

/* Of cells and squares a fill mixes what lies around a pixel: rays go where nothing does, and to few pixels beside them. */
TEST(gaps_between_squares) {
    enum { W = 160, H = 120 };
    static const zbufrand_fill fills[2] = {ZBUFRAND_FILL_GAUSS, ZBUFRAND_FILL_PULL_PUSH};
    static uint8_t full[W * H];
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    test_rng r = test_rng_make(77);
    uint32_t i, k, x, y;
    memset(&s, 0, sizeof s);
    for (i = 0; i < 300000; i++) { /* leaves, many behind one another */
        double q[3], e[6];
        for (k = 0; k < 3; k++) q[k] = (test_rng_double(&r) - 0.5) * (k == 2 ? 6 : 2);
        for (k = 0; k < 6; k++) e[k] = 0.04 * (test_rng_double(&r) - 0.5);
        (void)shape_vertex(&s, q[0], q[1], q[2]);
        (void)shape_vertex(&s, q[0] + e[0], q[1] + e[1], q[2] + e[2]);
        (void)shape_vertex(&s, q[0] + e[3], q[1] + e[4], q[2] + e[5]);
        shape_triangle(&s, 3 * i, 3 * i + 1, 3 * i + 2);
    }
    m = mesh_of(&s);
    m.two_sided = 1;
    scene = render_scene_of(&m, 1);
    for (i = 0; i < 3; i++) {
        zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        zbufrand_render_desc d;
        zbufrand_stats st;
        buffers b;
        uint32_t gaps = 0, inside = 0;
        buffers_open(&b, W, H);
        memset(&d, 0, sizeof d);
        d.camera.eye[2] = 12;
        d.camera.fov_y = 10;
        d.hybrid = i == 0 ? ZBUFRAND_HYBRID_ALL : ZBUFRAND_HYBRID_OFF;
        if (i > 0) {
            d.reconstruct.block = 2;
            d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
            d.reconstruct.fill = fills[i - 1];
        }
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        for (y = 0; y < H; y++)
            for (x = 0; x < W; x++) {
                const float alpha = b.image.rgba[4 * (y * W + x) + 3];
                if (i == 0) full[y * W + x] = alpha > 0.5f;
                else if (x > 2 && y > 2 && x < W - 3 && y < H - 3) {
                    int all = 1;
                    for (k = 0; k < 25; k++) all &= full[(y + k / 5 - 2) * W + x + k % 5 - 2];
                    inside += (uint32_t)all;
                    gaps += (uint32_t)(all && alpha < 0.5f);
                }
            }
        if (i > 0) {
            CHECK_MSG(inside > 5000 && gaps * 1000 < inside, "%u of %u", gaps, inside);
            if (i == 2) CHECK_MSG((st.holes + st.wrong) * 5 < inside, "%lu of %u", (unsigned long)(st.holes + st.wrong), inside);
        }
        buffers_close(&b);
        zbufrand_frame_destroy(frame);
    }
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* The least depth around each pixel, in passes, against all pixels around it one by one, those beside the picture, too; what keeps
   its colour keeps its depth. */
TEST(depths_between_samples) {
    enum { W = 37, H = 23, N = W * H };
    static float depth[3 * N], z[N];
    static uint64_t keys[N];
    test_rng r = test_rng_make(4);
    uint32_t way, i, x, y, u, v;
    for (way = 0; way < 60; way++) {
        const int keeps = (int)(way & 1);
        const uint32_t guard = way % 5, width = W - 2 * guard, height = H - 2 * guard;
        zbufrand_frame f;
        zbufrandi_picture p;
        uint64_t covered = 0;
        uint32_t reach, wrong = 0;
        memset(&f, 0, sizeof f);
        memset(&p, 0, sizeof p);
        p.f = &f;
        f.env.thread_count = 1 + way % 3;
        f.depth = depth;
        f.level = way % 4 == 3 ? 3 : 0;
        if (f.level > zbufrandi_level(ZBUFRAND_ISA_AUTO)) f.level = 0;
        f.recon.width = width;
        f.recon.height = height;
        f.recon.result_width = W;
        f.recon.result_height = H;
        f.recon.result_guard = guard;
        f.recon.result = keys;
        f.recon.o.occlusion = ZBUFRAND_OCCLUSION_CELLS;
        f.recon.o.block = 2 + way / 2;
        f.recon.o.gauss_radius = (float)(2 + way);
        f.recon.o.gauss_support = 1;
        f.recon.o.fill = keeps ? ZBUFRAND_FILL_PULL_PUSH : ZBUFRAND_FILL_GAUSS;
        reach = zbufrandi_recon_between(&f.recon.o);
        CHECK_EQ_U64(reach, keeps ? 4 + 2 * (way / 2) : 1 + way);
        for (i = 0; i < N; i++) {
            uint32_t bits;
            z[i] = test_rng_double(&r) < 0.02 ? (float)(1 + test_rng_double(&r)) : (float)INFINITY;
            memcpy(&bits, &z[i], sizeof bits);
            keys[i] = z[i] < (float)INFINITY ? (uint64_t)bits << 32 : ZBUFRANDI_EMPTY;
        }
        p.seen[0] = p.seen[1] = 0;
        zbufrandi_between_depths(&p);
        for (y = guard; y < guard + height; y++)
            for (x = guard; x < guard + width; x++) {
                float least = z[y * W + x];
                for (v = y < reach ? 0 : y - reach; v < H && v <= y + reach && !(keeps && z[y * W + x] < (float)INFINITY); v++)
                    for (u = x < reach ? 0 : x - reach; u < W && u <= x + reach; u++) least = z[v * W + u] < least ? z[v * W + u] : least;
                covered += least < (float)INFINITY;
                wrong += !(depth[(y - guard) * width + x - guard] == least);
            }
        CHECK_EQ_U64(wrong, 0);
        CHECK_EQ_U64(zbufrandi_tally(p.seen), covered);
    }
}

/* A red wall hides a blue one, of samples or rastered: pictures with a blue pixel are as few as the tolerance says, at the borders,
   too, and what is reported is about all pixels that show something, however few keep a sample. */
TEST(borders_and_mixtures_keep_promises) {
    enum { W = 80, H = 60, N = 40, WAYS = 28 };
    const uint32_t frames = test_quick() ? 15 : 40;
    static const zbufrand_fill fills[3] = {ZBUFRAND_FILL_VORONOI, ZBUFRAND_FILL_GAUSS, ZBUFRAND_FILL_PULL_PUSH};
    static const uint32_t edges[4] = {2, 3, 8, 1};
    static float rgba[4 * W * H], depth[W * H];
    static uint8_t rgb[2 * 4 * N * N * 3];
    uint32_t i, k, way, seed, rastered;
    for (rastered = 0; rastered < 2; rastered++) {
        const uint32_t side[2] = {N, rastered ? 1 : N};
        zbufrand_scene *scene;
        zbufrand_frame *frame;
        zbufrand_mesh m;
        shape s;
        memset(&s, 0, sizeof s);
        memset(rgb, 0, sizeof rgb);
        for (k = 0; k < 2; k++)
            for (i = 0; i < side[k] * side[k]; i++) {
                const double half = k == 0 ? 2.2 : rastered ? 1000 : 6, step = 2 * half / side[k];
                const double x = step * (i % side[k]) - half, y = step * (i / side[k]) - half;
                const uint32_t v = shape_vertex(&s, x, y, -6.0 * k);
                (void)shape_vertex(&s, x + step, y, -6.0 * k);
                (void)shape_vertex(&s, x + step, y + step, -6.0 * k);
                (void)shape_vertex(&s, x, y + step, -6.0 * k);
                shape_triangle(&s, v, v + 1, v + 2);
                shape_triangle(&s, v, v + 2, v + 3);
            }
        for (i = 0; i < s.vertices; i++) rgb[3 * i + (i < 4 * N * N ? 0 : 2)] = 255;
        m = mesh_of(&s);
        m.vertex_rgb = rgb;
        scene = render_scene_of(&m, 1);
        frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        for (way = test_quick() ? rastered : 0; way < WAYS; way += test_quick() ? 2 : 1) { /* cells, squares, blocks */
            double incomplete = 0;
            uint32_t bad = 0;
            for (seed = 0; seed < frames; seed++) {
                zbufrand_render_desc d;
                zbufrand_stats st;
                zbufrand_image image;
                memset(&d, 0, sizeof d);
                memset(&image, 0, sizeof image);
                d.camera.eye[2] = 4;
                d.camera.fov_y = 30;
                d.seed = seed;
                d.independent = d.unlit = d.no_occlusion = 1;
                d.hybrid = ZBUFRAND_HYBRID_OFF;
                d.tolerance = 0.2;
                d.reconstruct.fill = way < 18 ? fills[way % 3] : ZBUFRAND_FILL_NONE;
                d.reconstruct.block = way < 18 ? edges[way / 3 % 3] : way < 22 ? edges[way - 18] : edges[way % 3];
                d.reconstruct.occlusion = way < 9 || (way >= 22 && way < 25) ? ZBUFRAND_OCCLUSION_CELLS :
                    way < 18 || way >= 25 ? ZBUFRAND_OCCLUSION_SQUARES : ZBUFRAND_OCCLUSION_BLOCKS;
                image.width = W;
                image.height = H;
                image.rgba = rgba;
                image.depth = depth;
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, &st), ZBUFRAND_OK);
                CHECK((st.draws[2] != 0) == rastered);
                for (i = 0; i < W * H && (rgba[4 * i] > 1e-3f || (way >= 22 && !(depth[i] < (float)INFINITY))); i++) { }
                bad += i < W * H;
                incomplete += st.incomplete / frames;
            }
            CHECK_MSG(incomplete > 0.01 && incomplete <= 0.2000001, "way %u: %g", way, incomplete);
            if (test_g.verbose) printf("way %u: %u\n", way, bad);
            CHECK_MSG(bad <= (test_quick() ? 9u : 18u), "way %u: %u of %u", way, bad, frames); /* a fifth, and four standard deviations */
        }
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
}

/* Slats at an angle of 70 degrees, 2 * n of them, the nearest edge of each at z; closed: with nothing between them to see
   through. */
static void slats(shape *s, int n, double z, int closed) {
    int i;
    for (i = -n; i < n; i++) {
        const uint32_t v = shape_vertex(s, 0.1 * i, -0.1 * n, z);
        (void)shape_vertex(s, 0.1 * i + 0.1, -0.1 * n, z - 0.27);
        (void)shape_vertex(s, 0.1 * i + 0.1, 0.1 * n, z - 0.27);
        (void)shape_vertex(s, 0.1 * i, 0.1 * n, z);
        shape_triangle(s, v, v + 1, v + 2);
        shape_triangle(s, v, v + 2, v + 3);
        if (!closed) continue;
        (void)shape_vertex(s, 0.1 * i + 0.1, -0.1 * n, z);
        (void)shape_vertex(s, 0.1 * i + 0.1, 0.1 * n, z);
        shape_triangle(s, v + 1, v + 4, v + 5);
        shape_triangle(s, v + 1, v + 5, v + 2);
    }
}

/* Steep slats behind a flat wall, or behind others: cells and squares keep samples of steep surfaces that are deeper than the
   nearest, but none of hidden ones. */
TEST(steep_surfaces_stay_hidden) {
    enum { W = 80, H = 60, FRAMES = 15 };
    static float rgba[4 * W * H], depth[W * H];
    static uint8_t rgb[3 * 2000];
    uint32_t i, way, seed, steep;
    for (steep = 0; steep < 2; steep++) {
        zbufrand_scene *scene;
        zbufrand_frame *frame;
        zbufrand_mesh m;
        uint32_t front;
        shape s;
        memset(&s, 0, sizeof s);
        memset(rgb, 0, sizeof rgb);
        if (steep) slats(&s, 22, 0, 1);
        else {
            (void)shape_vertex(&s, -2.2, -2.2, 0);
            (void)shape_vertex(&s, 2.2, -2.2, 0);
            (void)shape_vertex(&s, 2.2, 2.2, 0);
            (void)shape_vertex(&s, -2.2, 2.2, 0);
            shape_triangle(&s, 0, 1, 2);
            shape_triangle(&s, 0, 2, 3);
        }
        front = (uint32_t)s.vertices;
        slats(&s, 60, steep ? -3 : -1.2, 0);
        CHECK(s.vertices <= 2000);
        for (i = 0; i < s.vertices; i++) rgb[3 * i + (i < front ? 0 : 2)] = 255;
        m = mesh_of(&s);
        m.vertex_rgb = rgb;
        scene = render_scene_of(&m, 1);
        frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        for (way = 0; way < 12; way += test_quick() ? 5 : 1) { /* blocks 3 and 8, no fill and Voronoi, cells and both sorts of squares */
            uint32_t bad = 0;
            double covered = 0;
            for (seed = 0; seed < FRAMES; seed++) {
                zbufrand_render_desc d;
                zbufrand_stats st;
                zbufrand_image image;
                memset(&d, 0, sizeof d);
                memset(&image, 0, sizeof image);
                d.camera.eye[2] = 12;
                d.camera.fov_y = 10;
                d.seed = seed;
                d.independent = d.unlit = d.no_occlusion = 1;
                d.hybrid = ZBUFRAND_HYBRID_OFF;
                d.tolerance = 0.05;
                d.reconstruct.fill = way & 1 ? ZBUFRAND_FILL_VORONOI : ZBUFRAND_FILL_NONE;
                d.reconstruct.block = way & 2 ? 8 : 3;
                d.reconstruct.occlusion = (zbufrand_occlusion)(ZBUFRAND_OCCLUSION_CELLS + way / 4);
                image.width = W;
                image.height = H;
                image.rgba = rgba;
                image.depth = depth;
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, &st), ZBUFRAND_OK);
                CHECK(st.incomplete <= 0.0500001);
                covered += (double)st.covered / (W * H * FRAMES);
                for (i = 0; i < W * H && (rgba[4 * i] > 1e-3f || !(depth[i] < (float)INFINITY)); i++) { }
                bad += i < W * H;
            }
            if (test_g.verbose) printf("steep %u way %u: %u bad, %g shown\n", steep, way, bad, covered);
            CHECK_MSG(bad <= 4, "steep %u way %u: %u of %d", steep, way, bad, FRAMES); /* 0.75, and four standard deviations */
        }
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
}

/* A wall before a huge one that is rastered, in the pictures that d asks for: how many of them show what is behind in the first `look`
   pixels, and what they report of it on average. */
static uint32_t walls_that_fail(double half_x, double half_y, uint32_t side, zbufrand_render_desc *d, uint32_t width, uint32_t height,
                                uint32_t frames, uint32_t look, float *rgba, double *incomplete) {
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_scene *scene;
    zbufrand_image image;
    zbufrand_stats st;
    zbufrand_mesh m;
    uint32_t i, bad = 0;
    uint8_t *rgb;
    shape s;
    memset(&s, 0, sizeof s);
    memset(&image, 0, sizeof image);
    for (i = 0; i <= side * side; i++) {
        const int last = i == side * side; /* the huge one */
        const double x = last ? -1000 : half_x * (2.0 * (i % side) / side - 1), y = last ? -1000 : half_y * (2.0 * (i / side) / side - 1);
        const double dx = last ? 2000 : 2 * half_x / side, dy = last ? 2000 : 2 * half_y / side, z = last ? -6 : 0;
        const uint32_t v = shape_vertex(&s, x, y, z);
        (void)shape_vertex(&s, x + dx, y, z);
        (void)shape_vertex(&s, x + dx, y + dy, z);
        (void)shape_vertex(&s, x, y + dy, z);
        shape_triangle(&s, v, v + 1, v + 2);
        shape_triangle(&s, v, v + 2, v + 3);
    }
    rgb = (uint8_t *)calloc(s.vertices, 3);
    for (i = 0; i < 4 * side * side; i++) rgb[3 * i] = 255;
    m = mesh_of(&s);
    m.vertex_rgb = rgb;
    scene = render_scene_of(&m, 1);
    d->camera.eye[2] = 4;
    if (!(d->camera.fov_y > 0)) d->camera.fov_y = 30;
    d->independent = d->unlit = d->no_occlusion = 1;
    image.width = width;
    image.height = height;
    image.rgba = rgba;
    *incomplete = 0;
    for (d->seed = 0; d->seed < frames; d->seed++) {
        CHECK_EQ_U64(zbufrand_render(frame, d, scene, &image, &st), ZBUFRAND_OK);
        for (i = 0; i < look && rgba[4 * i] > 1e-3f; i++) { }
        bad += i < look;
        *incomplete += st.incomplete / frames;
    }
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
    free(rgb);
    return bad;
}

/* Also where few samples are expected, and of means of frames: there that somewhere no frame is right. */
TEST(small_parts_and_means_keep_promises) {
    static float rgba[4 * 240 * 180];
    const uint32_t means = test_quick() ? 20 : 100;
    zbufrand_render_desc d;
    double incomplete;
    uint32_t bad, k;
    memset(&d, 0, sizeof d);
    d.camera.eye[1] = d.camera.at[1] = -1.0357; /* two pixels at the end of a row */
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    d.tolerance = 0.001;
    bad = walls_that_fail(0.03, 0.0358, 20, &d, 1, 60, 3000, 1, rgba, &incomplete);
    CHECK_MSG(incomplete > 1e-4 && incomplete <= 0.001 && bad <= 10, "%u of 3000, %g", bad, incomplete); /* 3, and four deviations */
    memset(&d, 0, sizeof d);
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    d.noise = 1e-9;
    d.max_frames = 2;
    d.reconstruct.block = 4;
    bad = walls_that_fail(4, 4, 40, &d, 240, 180, means, 240 * 180, rgba, &incomplete);
    CHECK_MSG(incomplete < 0.99 && bad <= means * incomplete + 4 * sqrt(means * incomplete), "%u of %u, %g", bad, means, incomplete);
    CHECK_MSG(incomplete > 0.05, "%g", incomplete); /* what was measured */
    for (k = 0; k < 4; k++) { /* one pixel, into which regions grow */
        memset(&d, 0, sizeof d);
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.camera.fov_y = 0.5;
        d.tolerance = 0.2;
        d.reconstruct.block = k & 1 ? 16 : 8;
        d.reconstruct.occlusion = k & 2 ? ZBUFRAND_OCCLUSION_SQUARES : ZBUFRAND_OCCLUSION_CELLS;
        d.reconstruct.fill = ZBUFRAND_FILL_VORONOI;
        bad = walls_that_fail(4, 4, 60, &d, 1, 1, 600, 1, rgba, &incomplete);
        CHECK_MSG(incomplete > 0.1 && incomplete <= 0.2000001 && bad <= 120 + 39, "%u: %u of 600, %g", k, bad, incomplete);
    }
}

/* A wall is complete as often as is asked for, whatever the size of what it is made of: fine grids, as one mesh before another wall,
   and as instances. Points at the same places of all parts, which are rows or columns of a grid, left gaps in nearly every picture. */
TEST(stored_points_are_no_combs) {
    enum { W = 80, H = 60, FRAMES = 20, EDGE = 16 };
    static const struct { uint32_t side, block; double cell; } ways[8] = {
        {0, 2, 0.2391}, {0, 2, 0.4718}, {0, 1, 0.2391}, {0, 2, 0.7}, {900, 2, 0}, {930, 2, 0}, {870, 1, 0}, {1100, 2, 0}};
    static float rgba[4 * W * H];
    const double pixel = 8.0 * 0.26794919243112 / H; /* of the wall */
    uint32_t i, k, a, way, seed;
    for (way = test_quick() ? 1 : 0; way < (test_quick() ? 2u : 8u); way++) {
        const double cell = ways[way].cell * pixel, edge = way < 4 ? cell / EDGE : 4.4026 / ways[way].side, from = way < 4 ? 0 : -2.2013;
        const uint32_t n = way < 4 ? EDGE : ways[way].side, side = way < 4 ? (uint32_t)(4.4 / cell) + 2 : 1;
        zbufrand_transform *to = (zbufrand_transform *)calloc(2 * (size_t)side * side, sizeof *to);
        zbufrand_scene *scene = NULL;
        zbufrand_frame *frame;
        zbufrand_mesh m;
        zbufrand_node node;
        uint32_t bad = 0;
        double incomplete = 0;
        uint8_t *rgb;
        shape s;
        memset(&s, 0, sizeof s);
        for (i = 0; i < n * n; i++) {
            const double x = from + edge * (i % n), y = from + edge * (i / n);
            const uint32_t v = shape_vertex(&s, x, y, 0);
            (void)shape_vertex(&s, x + edge, y, 0);
            (void)shape_vertex(&s, x + edge, y + edge, 0);
            (void)shape_vertex(&s, x, y + edge, 0);
            shape_triangle(&s, v, v + 1, v + 2);
            shape_triangle(&s, v, v + 2, v + 3);
        }
        if (way >= 4) { /* what is behind, black, has to be seen nowhere */
            const uint32_t v = shape_vertex(&s, -1000, -1000, -6);
            (void)shape_vertex(&s, 1000, -1000, -6);
            (void)shape_vertex(&s, 1000, 1000, -6);
            (void)shape_vertex(&s, -1000, 1000, -6);
            shape_triangle(&s, v, v + 1, v + 2);
            shape_triangle(&s, v, v + 2, v + 3);
        }
        rgb = (uint8_t *)calloc(2 * s.vertices, 3);
        for (i = 0; i < 4 * n * n; i++) rgb[3 * i] = 255;
        m = mesh_of(&s);
        m.vertex_rgb = rgb;
        for (i = 0; i < side * side; i++) {
            for (k = 0; k < 3; k++) to[i].m[k][k] = 1;
            if (way < 4) to[i].m[0][3] = ((double)(i % side) - side / 2) * cell + 0.1317 * pixel;
            if (way < 4) to[i].m[1][3] = ((double)(i / side) - side / 2) * cell + 0.1317 * pixel;
        }
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, ZBUFRAND_ROOT, NULL, way < 4 ? ZBUFRAND_HIDDEN : 0, &m, &node), ZBUFRAND_OK);
        for (k = 0; k < 2 && way < 4; k++) {
            zbufrand_transform *place = to + (size_t)k * side * side;
            CHECK_EQ_U64(zbufrand_add_references(scene, ZBUFRAND_ROOT, place, (size_t)side * side, node, NULL), ZBUFRAND_OK);
            if (k == 1) break;
            for (i = 0; i < side * side; i++) { /* behind, black */
                for (a = 0; a < 3; a++) place[side * side + i].m[a][a] = 2.5;
                for (a = 0; a < 2; a++) place[side * side + i].m[a][3] = 2.5 * (place[i].m[a][3] - 0.1317 * pixel);
                place[side * side + i].m[2][3] = -6;
            }
            m.vertex_rgb = rgb + 3 * s.vertices;
            CHECK_EQ_U64(zbufrand_add_mesh(scene, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &node), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
        frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        for (seed = 0; seed < FRAMES; seed++) {
            zbufrand_render_desc d;
            zbufrand_image image;
            zbufrand_stats st;
            memset(&d, 0, sizeof d);
            memset(&image, 0, sizeof image);
            d.camera.eye[2] = 4;
            d.camera.fov_y = 30;
            if (way == 7) d.camera.up[0] = 0.29237170472274, d.camera.up[1] = 0.95630475596304;
            d.seed = seed;
            d.unlit = d.no_occlusion = 1;
            if (way < 4) d.hybrid = ZBUFRAND_HYBRID_OFF;
            d.tolerance = 0.05;
            d.reconstruct.block = ways[way].block;
            image.width = W;
            image.height = H;
            image.rgba = rgba;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, &st), ZBUFRAND_OK);
            CHECK(st.draws[0] > 10); /* stored points */
            for (i = 0; i < W * H && rgba[4 * i] > 1e-3f; i++) { }
            bad += i < W * H;
            incomplete += st.incomplete / FRAMES;
        }
        if (test_g.verbose) printf("way %u: %u of %d, %g\n", way, bad, FRAMES, incomplete);
        CHECK_MSG(bad <= 5 && incomplete <= 0.05, "way %u: %u of %d, %g", way, bad, FRAMES, incomplete); /* 1, and four standard deviations */
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
        free(rgb);
        free(to);
    }
}

/* Triangles anywhere, in lists that are placed many times, some in each other. */
static void golden_scene(zbufrand_scene **scene, shape *s) {
    static uint8_t rgb[3 * 2500];
    zbufrand_node lib, leaf, tree;
    test_rng r = test_rng_make(5);
    zbufrand_mesh m;
    zbufrand_transform t;
    uint32_t i, a;
    memset(s, 0, sizeof *s);
    for (i = 0; i < 2500; i++) {
        double u[14]; /* one after the other: arguments have no order */
        for (a = 0; a < 14; a++) u[a] = test_rng_double(&r);
        u[0] = 0.002 + 0.3 * u[0] * u[1];
        for (a = 0; a < 3; a++)
            (void)shape_vertex(s, 2 * u[2] - 1 + u[0] * u[5 + 3 * a], 2 * u[3] - 1 + u[0] * u[6 + 3 * a], 2 * u[4] - 1 + u[0] * u[7 + 3 * a]);
        shape_triangle(s, 3 * i, 3 * i + 1, 3 * i + 2);
        for (a = 0; a < 3; a++) rgb[3 * i + a] = (uint8_t)test_rng_u32(&r);
    }
    m = mesh_of(s);
    m.two_sided = 1;
    m.triangle_rgb = rgb;
    CHECK_EQ_U64(zbufrand_scene_create(NULL, scene), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(*scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(*scene, lib, NULL, 0, &m, &leaf), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(*scene, lib, NULL, 0, &tree), ZBUFRAND_OK);
    for (i = 0; i < 44; i++) { /* quarter turns, mirrors, powers of two */
        const double scale = ldexp(1, i < 4 ? -1 : 1 - (int)(i % 3));
        memset(&t, 0, sizeof t);
        t.m[0][i % 3] = i & 1 ? scale : -scale;
        t.m[1][(i + 1) % 3] = scale;
        t.m[2][(i + 2) % 3] = i & 4 ? scale : -scale;
        for (a = 0; a < 3; a++) t.m[a][3] = (i < 4 ? 2 : 12) * (double)(test_rng_float(&r) - 0.5f);
        CHECK_EQ_U64(zbufrand_add_reference(*scene, i < 4 ? tree : 1, &t, i < 4 ? leaf : tree, NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(*scene, NULL, NULL), ZBUFRAND_OK);
}

static void golden_way(zbufrand_render_desc *d, uint32_t way) { /* by which its picture is made */
    static const float half[1] = {0.5f};
    memset(d, 0, sizeof *d);
    d->camera.eye[0] = 3;
    d->camera.eye[1] = way == 2 ? 0.25 : 4;
    d->camera.eye[2] = way == 2 ? 1 : 14;
    if (way == 1) d->hybrid = ZBUFRAND_HYBRID_OFF;
    if (way == 2) d->hybrid = ZBUFRAND_HYBRID_ALL;
    if (way == 3) {
        d->reconstruct.block = 2;
        d->reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
        d->reconstruct.fill = ZBUFRAND_FILL_GAUSS;
    }
    if (way == 4) d->independent = 1;
    if (way == 5) d->oversample = 2;
    if (way == 6) {
        d->reconstruct.block = 3;
        d->reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
        d->reconstruct.fill = ZBUFRAND_FILL_REGIONS;
    }
    if (way == 7) {
        d->reconstruct.block = 4;
        d->reconstruct.occlusion = ZBUFRAND_OCCLUSION_CELLS;
        d->reconstruct.fill = ZBUFRAND_FILL_VORONOI_L1;
        d->hybrid = ZBUFRAND_HYBRID_CUBE;
        d->hybrid_radius = 6;
    }
    if (way == 8) { /* the mean of three frames, of blocks that follow their planes */
        d->reconstruct.block = 2;
        d->reconstruct.plane_depth = 1;
        d->noise = 1e-9;
        d->max_frames = 3;
    }
    if (way == 9) {
        d->opacity = half;
        d->opacity_count = 1;
        d->reconstruct.fill = ZBUFRAND_FILL_PULL_PUSH;
        d->no_repair = 1;
    }
}

/* Whole pictures have these bits on every machine, with every compiler, any number of threads: a soup, nested and mirrored, as
   samples, rastered, by rays, in blocks and filters. Only exact arithmetic makes the scene: no libm. */
TEST(golden_pictures) {
    enum { W = 101, H = 77, WAYS = 10 };
    static const uint64_t want[WAYS] = {
        UINT64_C(0x07085c4b35813cdf), UINT64_C(0xb67b0002e019815a), UINT64_C(0x55648bb114835777), UINT64_C(0xac5119586ceb8f54),
        UINT64_C(0x76937fa34d547cea), UINT64_C(0x7697dc4af336e0df), UINT64_C(0x5b1aba2e7f6700d8),
        UINT64_C(0xa8960008b0730004), UINT64_C(0x483893578b8d879b), UINT64_C(0x1952a3c0611c8b83)
    };
    zbufrand_scene *scene = NULL;
    static uint8_t bytes[4 * W * H];
    static float rgba[4 * W * H], depth[W * H];
    shape s;
    uint32_t way, i;
    golden_scene(&scene, &s);
    for (way = 0; way < WAYS; way++) {
        zbufrand_frame *frame = open_frame(way == 1 ? 3 : 1, ZBUFRAND_ISA_AUTO);
        zbufrand_render_desc d;
        zbufrand_image image;
        zbufrand_stats st;
        uint64_t hash;
        golden_way(&d, way);
        memset(&image, 0, sizeof image);
        image.width = W;
        image.height = H;
        image.rgba8 = bytes;
        image.rgba = rgba;
        image.depth = depth;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, &st), ZBUFRAND_OK);
        CHECK(st.covered > 500);
        hash = test_fnv1a(bytes, sizeof bytes, 0);
        for (i = 0; i < 5 * W * H; i++) { /* the bytes of floats in one order */
            uint32_t u;
            uint8_t b[4];
            memcpy(&u, i < W * H ? &depth[i] : &rgba[i - W * H], 4);
            put_u32(b, u);
            hash = test_fnv1a(b, 4, hash);
        }
        CHECK_MSG(hash == want[way], "way %u: 0x%016llx", way, (unsigned long long)hash);
        zbufrand_frame_destroy(frame);
    }
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* A quadrilateral, two triangles of one colour each (rgb: 3 bytes for each triangle of the shape). */
static void golden_quad(shape *s, uint8_t *rgb, double p[4][3], uint32_t color) {
    uint32_t v[4], k, a;
    for (k = 0; k < 4; k++) v[k] = shape_vertex(s, p[k][0], p[k][1], p[k][2]);
    for (k = 0; k < 2; k++) {
        const size_t at = 3 * (size_t)s->triangles;
        shape_triangle(s, v[0], v[k + 1], v[k + 2]);
        for (a = 0; a < 3; a++) rgb[at + a] = (uint8_t)(color >> 8 * a);
    }
}

/* A rectangle across axis `axis` of a box of given corners: at its low side, or its high one. */
static void golden_side(shape *s, uint8_t *rgb, const double lo[3], const double hi[3], uint32_t axis, int high, uint32_t color) {
    const uint32_t u = (axis + 1) % 3, v = (axis + 2) % 3;
    double p[4][3];
    uint32_t k;
    for (k = 0; k < 4; k++) {
        p[k][axis] = high ? hi[axis] : lo[axis];
        p[k][high ? u : v] = k == 1 || k == 2 ? hi[high ? u : v] : lo[high ? u : v];
        p[k][high ? v : u] = k >= 2 ? hi[high ? v : u] : lo[high ? v : u];
    }
    golden_quad(s, rgb, p, color);
}

static void golden_box(shape *s, uint8_t *rgb, double x, double y, double z, double wide, double high, uint32_t color) {
    const double lo[3] = {x, y, z}, hi[3] = {x + wide, y + high, z + wide};
    uint32_t k;
    for (k = 0; k < 6; k++) golden_side(s, rgb, lo, hi, k / 2, (int)(k & 1), color + 0x101010 * k);
}

enum { GOLDEN_SCENES = 10, GOLDEN_TRIANGLES = 8192 };
static const char *const golden_name[GOLDEN_SCENES] = {
    "chessboard", "stripes", "height field", "sphere", "roof and walls", "city", "fractal tree", "dust", "decals and slats", "corridor"
};

static void golden_stripes(shape *s, uint8_t *rgb) { /* tilted ones before a wall */
    uint32_t i, j;
    double p[4][3];
    for (i = 0; i < 96; i++) {
        for (j = 0; j < 4; j++) {
            const double x = -6 + 0.125 * i + (j == 1 || j == 2 ? 0.0625 : 0), y = j >= 2 ? 5 : -5;
            p[j][0] = 0.8 * x - 0.6 * y;
            p[j][1] = 0.6 * x + 0.8 * y;
            p[j][2] = 0.25 * x;
        }
        golden_quad(s, rgb, p, 0x3060c0 + i);
    }
    for (j = 0; j < 4; j++) {
        p[j][0] = j == 1 || j == 2 ? 9 : -9;
        p[j][1] = j >= 2 ? 7 : -7;
        p[j][2] = -1.5;
    }
    golden_quad(s, rgb, p, 0xd0c040);
}

static void golden_heights(shape *s, uint8_t *rgb, test_rng *r) { /* coarse ones, and finer ones between them */
    uint32_t i, j, n;
    double p[4][3], h[33][33];
    for (i = 0; i < 33 * 33; i++) h[i / 33][i % 33] = 0;
    for (n = 8; n > 0; n /= 2)
        for (i = 0; i < 33; i += n)
            for (j = 0; j < 33; j += n) h[i][j] += (test_rng_double(r) - 0.5) * (0.3 * n);
    for (i = 0; i < 32 * 32; i++) {
        for (j = 0; j < 4; j++) {
            const uint32_t x = i % 32 + (j >= 2), z = i / 32 + (j == 1 || j == 2);
            p[j][0] = 0.5 * x - 8;
            p[j][1] = h[z][x];
            p[j][2] = 0.5 * z - 8;
        }
        golden_quad(s, rgb, p, 0x306030 + 2 * (i & 31));
    }
}

static void golden_ball(shape *s, uint8_t *rgb) { /* a cube of 6 x 16 x 16 fields, blown up */
    uint32_t i, j, n;
    double p[4][3];
    for (i = 0; i < 6 * 256; i++) {
        const uint32_t axis = i / 512, high = i / 256 & 1;
        for (j = 0; j < 4; j++) {
            double length = 0;
            const double a = ((double)(i % 16) + (j == 1 || j == 2)) / 8 - 1, b = ((double)(i / 16 % 16) + (j >= 2)) / 8 - 1;
            p[j][axis] = high != 0 ? 1 : -1;
            p[j][(axis + (high != 0 ? 1 : 2)) % 3] = a;
            p[j][(axis + (high != 0 ? 2 : 1)) % 3] = b;
            for (n = 0; n < 3; n++) length += p[j][n] * p[j][n];
            length = sqrt(length);
            for (n = 0; n < 3; n++) p[j][n] = 5 * p[j][n] / length;
        }
        golden_quad(s, rgb, p, 0xc08040);
    }
}

static void golden_houses(shape *s, uint8_t *rgb) { /* a roof just above its walls */
    uint32_t i, j, n;
    double p[4][3];
    for (i = 0; i < 64; i++) {
        const double x = (double)(i % 8) * 2 - 8, z = (double)(i / 8) * 2 - 8;
        golden_box(s, rgb, x, 0, z, 1.25, 1, 0x607080);
        for (n = 0; n < 2; n++) {
            for (j = 0; j < 4; j++) {
                p[j][0] = x + (n == 0 ? -0.125 : 1.375) + (j >= 2 ? (n == 0 ? 0.75 : -0.75) : 0);
                p[j][1] = j >= 2 ? 1.75 : 0.96875;
                p[j][2] = z + ((j == 1 || j == 2) == (n == 0) ? 1.375 : -0.125);
            }
            golden_quad(s, rgb, p, 0x3040c0);
        }
    }
}

/* What scene k is made of, of numbers that are the same everywhere: sums, products, square roots. */
static void golden_shape(uint32_t k, shape *s, uint8_t *rgb) {
    test_rng r = test_rng_make(k + 70);
    uint32_t i, j, n;
    double p[4][3], u[4];
    memset(s, 0, sizeof *s);
    switch (k) {
    case 0: /* 24 x 24 fields */
        for (i = 0; i < 576; i++) {
            const double lo[3] = {(double)(i % 24) - 12, 0, (double)(i / 24) - 12}, hi[3] = {lo[0] + 1, 0, lo[2] + 1};
            golden_side(s, rgb, lo, hi, 1, 1, ((i % 24 ^ i / 24) & 1) != 0 ? 0xe0e8f0 : 0x201810);
        }
        break;
    case 1: golden_stripes(s, rgb); break;
    case 2: golden_heights(s, rgb, &r); break;
    case 3: golden_ball(s, rgb); break;
    case 4: golden_houses(s, rgb); break;
    case 5: /* a block of towers, and streets between such blocks */
        for (i = 0; i < 16; i++)
            golden_box(s, rgb, (double)(i % 4), 0, (double)(i / 4), 0.75, 0.5 + 3 * test_rng_double(&r), 0x506070 + 0x050301 * i);
        break;
    case 6: /* a branch with leaves */
        golden_box(s, rgb, -0.0625, 0, -0.0625, 0.125, 1.25, 0x204060);
        for (i = 0; i < 24; i++) {
            for (n = 0; n < 4; n++) u[n] = test_rng_double(&r);
            for (j = 0; j < 4; j++) {
                p[j][0] = u[0] - 0.5 + (j == 1 ? 0.1875 * u[3] : 0);
                p[j][1] = 0.25 + u[1] + (j == 2 ? 0.1875 * u[3] : 0);
                p[j][2] = u[2] - 0.5 + (j == 3 ? 0.125 : 0);
            }
            golden_quad(s, rgb, p, 0x206020 + (i << 11));
        }
        break;
    case 7: /* a piece of what is mostly empty */
        golden_box(s, rgb, -1, -1, -1, 2, 2, 0x80b0e0);
        break;
    case 8: /* planes 2^-10 apart, and slats before them */
        for (i = 0; i < 24; i++) {
            const double lo[3] = {(double)(i % 6) * 2 - 6, (double)(i / 6) * 2 - 4, i * 0.0009765625}, hi[3] = {lo[0] + 3, lo[1] + 3, lo[2]};
            golden_side(s, rgb, lo, hi, 2, 1, 0x3050e0 + 0x080402 * i);
        }
        for (i = 0; i < 40; i++) {
            const double y = 0.25 * i - 5;
            for (j = 0; j < 4; j++) {
                p[j][0] = j == 1 || j == 2 ? 6 : -6;
                p[j][1] = y + (j >= 2 ? 0.15 : 0);
                p[j][2] = 1 + (j >= 2 ? -0.2 : 0);
            }
            golden_quad(s, rgb, p, 0xb0b0b0);
        }
        break;
    default: /* pillars along both walls, many behind each other */
        for (i = 0; i < 60; i++)
            golden_box(s, rgb, (i & 1) != 0 ? 1.5 : -2.5, -2, 8 - (double)(i / 2), 0.5 + 0.5 * test_rng_double(&r), 4, 0x405060 + 0x010204 * i);
        for (i = 0; i < 4; i++) {
            const double lo[3] = {-3, -2, -24}, hi[3] = {3, 2, 12};
            golden_side(s, rgb, lo, hi, i / 2, (i & 1) == 0, 0x708090);
        }
        break;
    }
}

/* Ten scenes of the specification's kinds, each by cost, from samples in blocks of 2, and rastered: what is drawn is known bit by bit. */
TEST(golden_scenes) {
    enum { W = 93, H = 71, WAYS = 3 };
    static const uint64_t want[GOLDEN_SCENES] = {
        UINT64_C(0x8ed1846d011625e3), UINT64_C(0xfb451c29500d9210), UINT64_C(0xc807cd76e1274cfe),
        UINT64_C(0xb1a51e101f7b8f92), UINT64_C(0x6f5cb80fdc7df8a5), UINT64_C(0x89e3648fa38d46b6),
        UINT64_C(0x1195ae456f52c45b), UINT64_C(0xb963b603f086c845), UINT64_C(0x20674d27761ad736),
        UINT64_C(0x7508ce43020b6ba6)
    };
    static const float eye[GOLDEN_SCENES][3] = {
        {1, 2, 14}, {2, 1, 18}, {3, 6, 14}, {4, 5, 14}, {6, 5, 14}, {30, 24, 62}, {1, 3, 9}, {5, 6, 11}, {3, 1, 14}, {0.5f, 0.25f, 11}
    };
    static uint8_t rgb[3 * GOLDEN_TRIANGLES], bytes[4 * W * H];
    static float rgba[4 * W * H], depth[W * H];
    uint32_t k, way, i, a, level;
    for (k = 0; k < GOLDEN_SCENES; k++) {
        const uint32_t levels = k == 5 ? 1u : k == 6 ? 5u : k == 7 ? 4u : 0u, fan = k == 5 ? 100u : k == 6 ? 3u : 8u;
        zbufrand_scene *scene = NULL;
        zbufrand_node lib, branch, below, list;
        zbufrand_transform t;
        zbufrand_mesh m;
        shape s;
        uint64_t hash = 0;
        golden_shape(k, &s, rgb);
        if (s.triangles > GOLDEN_TRIANGLES) abort();
        m = mesh_of(&s);
        m.two_sided = k != 5;
        m.triangle_rgb = rgb;
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, levels == 0 ? 1 : lib, NULL, 0, &m, &branch), ZBUFRAND_OK);
        below = branch;
        for (level = 0; level < levels; level++, below = list) {
            CHECK_EQ_U64(zbufrand_add_list(scene, level + 1 == levels ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
            for (i = 0; i < fan + (k == 6); i++) {
                memset(&t, 0, sizeof t);
                for (a = 0; a < 3; a++) t.m[a][a] = k == 7 ? 0.3125 : 1;
                if (k == 5) { /* 10 x 10 blocks */
                    t.m[0][3] = 6.0 * (i % 10) - 27;
                    t.m[2][3] = 6.0 * (i / 10) - 27;
                }
                for (a = 0; a < 3 && k == 7; a++) t.m[a][3] = (i >> a & 1u) != 0 ? 0.6875 : -0.6875; /* corners of a cube */
                if (k == 7 && level + 1 == levels) for (a = 0; a < 12; a++) t.m[a / 4][a % 4] *= 4;
                if (k == 6 && i < fan) { /* turned away from the branch, and around it; the last one is the branch itself */
                    const double turn[3][2] = {{1, 0}, {-0.6, 0.8}, {-0.28, -0.96}}, c = turn[i][0], d = turn[i][1];
                    const double q[3][3] = {{0.8 * c, -0.6 * c, d}, {0.6, 0.8, 0}, {-0.8 * d, 0.6 * d, c}};
                    for (a = 0; a < 9; a++) t.m[a / 3][a % 3] = 0.75 * q[a / 3][a % 3];
                    t.m[1][3] = 1.125;
                }
                CHECK_EQ_U64(zbufrand_add_reference(scene, list, &t, i < fan ? below : branch, NULL), ZBUFRAND_OK);
            }
        }
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
        for (way = 0; way < 2 * WAYS; way++) { /* the second time by other instructions, on other threads: the same picture */
            zbufrand_frame *frame = open_frame(way < WAYS ? 1 : 3, way < WAYS ? ZBUFRAND_ISA_AUTO : ZBUFRAND_ISA_SCALAR);
            zbufrand_render_desc d;
            zbufrand_image image;
            zbufrand_stats st;
            static uint64_t first[WAYS];
            uint64_t here;
            memset(&d, 0, sizeof d);
            memset(&image, 0, sizeof image);
            image.width = W;
            image.height = H;
            image.rgba8 = bytes;
            image.rgba = rgba;
            image.depth = depth;
            for (a = 0; a < 3; a++) d.camera.eye[a] = (double)eye[k][a];
            if (k == 6) d.camera.at[1] = 2;
            if (way % WAYS == 1) {
                d.hybrid = ZBUFRAND_HYBRID_OFF;
                d.reconstruct.block = 2;
            }
            if (way % WAYS == 2) d.hybrid = ZBUFRAND_HYBRID_ALL;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, &st), ZBUFRAND_OK);
            CHECK_MSG(st.covered > 400, "%s: %u pixels", golden_name[k], (unsigned)st.covered);
            here = test_fnv1a(bytes, sizeof bytes, 0);
            for (i = 0; i < 5 * W * H; i++) { /* the bytes of floats in one order */
                uint32_t u;
                uint8_t b[4];
                memcpy(&u, i < W * H ? &depth[i] : &rgba[i - W * H], 4);
                put_u32(b, u);
                here = test_fnv1a(b, 4, here);
            }
            zbufrand_frame_destroy(frame);
            if (way < WAYS) {
                first[way] = here;
                hash = hash * UINT64_C(0x100000001b3) + here;
            } else {
                CHECK_MSG(here == first[way - WAYS], "%s, way %u: other instructions, another picture", golden_name[k], way - WAYS);
            }
        }
        CHECK_MSG(hash == want[k], "%s: 0x%016llx", golden_name[k], (unsigned long long)hash);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
}

/* ---- costs ---- */

static double ticks(void *user) { /* a clock of its own: every look at it takes longer than the one before */
    uint64_t *n = (uint64_t *)user;
    *n += 1000 + *n % 700;
    return 1e-9 * (double)*n;
}
static double no_time(void *user) {
    (void)user;
    return 0;
}

TEST(costs_are_measured) {
    zbufrand_costs c;
    uint64_t n = 0;
    int64_t k;
    uint32_t i;
    for (i = test_quick() ? 1 : 0; i < 2; i++) { /* whatever the clock says, what comes out is a cost */
        const float *v = &c.triangle;
        uint32_t a;
        CHECK_EQ_U64(zbufrand_measure_costs(NULL, i == 0 ? ticks : no_time, &n, &c), ZBUFRAND_OK);
        for (a = 0; a < sizeof c / sizeof *v; a++) CHECK_MSG(v[a] > 0 && v[a] < 1e9f, "cost %u: %g", a, (double)v[a]);
    }
    CHECK_EQ_U64(zbufrand_measure_costs(NULL, NULL, NULL, &c), ZBUFRAND_ERR_INVALID_ARG);
    CHECK(c.triangle == 0.0f && c.listed == 0.0f);
    CHECK_EQ_U64(zbufrand_measure_costs(NULL, no_time, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    for (k = 0; k < 1000; k += test_quick() ? 30 : 1) {
        zbufrand_frame_desc fd;
        zbufrand_result r;
        test_alloc ta;
        test_alloc_init(&ta);
        ta.fail_at = k;
        memset(&fd, 0, sizeof fd);
        fd.env.allocator.alloc_fn = test_alloc_fn;
        fd.env.allocator.free_fn = test_free_fn;
        fd.env.allocator.user = &ta;
        r = zbufrand_measure_costs(&fd, no_time, NULL, &c);
        CHECK_EQ_U64(r, ta.failed != 0 ? ZBUFRAND_ERR_NO_MEMORY : ZBUFRAND_OK);
        CHECK((c.triangle == 0.0f) == (r != ZBUFRAND_OK));
        test_alloc_check(&ta);
        if (ta.failed == 0) break;
    }
    CHECK_MSG(k > 20 && k < 1000, "%d requests", (int)k);
}

/* No more is held than memory_limit says, and that is enough when it says so. */
TEST(memory_limit) {
    shape s[2];
    zbufrand_scene *scene = forest(s, 60);
    buffers b;
    zbufrand_frame_desc fd;
    test_alloc ta;
    size_t enough = 0, limit;
    uint32_t k, failed = 0;
    zbufrand_render_desc d;
    buffers_open(&b, 60, 40);
    memset(&fd, 0, sizeof fd);
    memset(&d, 0, sizeof d);
    d.max_frames = 5;
    fd.env.thread_count = 1;
    fd.env.allocator.alloc_fn = test_alloc_fn;
    fd.env.allocator.free_fn = test_free_fn;
    fd.env.allocator.user = &ta;
    for (k = 0; k < 24; k++) { /* without a limit, then with more and more; a frame, then a mean of some */
        zbufrand_frame *frame = NULL;
        zbufrand_stats st;
        zbufrand_result r;
        limit = k % 12 == 0 ? 0 : enough * (k % 12) / 10;
        d.noise = k < 12 ? 0 : 1e-9;
        test_alloc_init(&ta);
        fd.env.memory_limit = limit;
        r = zbufrand_frame_create(&fd, &frame);
        if (r == ZBUFRAND_OK) r = zbufrand_render(frame, &d, scene, &b.image, &st);
        if (r == ZBUFRAND_OK) CHECK(st.bytes <= ta.live_bytes && st.bytes + 65536 > ta.live_bytes);
        CHECK(r == ZBUFRAND_OK || r == ZBUFRAND_ERR_NO_MEMORY);
        CHECK_MSG(limit == 0 || ta.peak_bytes <= limit, "%zu bytes of %zu", (size_t)ta.peak_bytes, limit);
        failed += r != ZBUFRAND_OK;
        if (k % 12 == 0) enough = (size_t)ta.peak_bytes;
        if (k % 12 == 0 || k % 12 == 11) CHECK_EQ_U64(r, ZBUFRAND_OK);
        zbufrand_frame_destroy(frame);
        test_alloc_check(&ta);
    }
    CHECK(failed > 10);
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    shape_free(&s[0]);
    shape_free(&s[1]);
}

/* ---- cancelled ---- */

typedef enum asking { ASK_PLAIN, ASK_LIGHTS, ASK_LARGER, ASK_FRAMES, ASK_CELLS, ASK_SQUARES, ASK_POINTS, ASK_ONE_DRAW, ASK_THESIS, ASK_THESIS_DRAW,
                      ASK_SELECT, ASK_THESIS_SELECT, ASK_STREAM, ASK_COUNT } asking;

typedef struct ask_world { zbufrand_scene *forest, *thesis, *flat, *flat_thesis; zbufrand_points points; zbufrand_light light[65]; } ask_world;

static int no_sample(void *user, const zbufrand_sample *samples, const uint32_t *numbers, size_t count) {
    (void)samples;
    (void)numbers;
    *(uint64_t *)user += count;
    return 0;
}

static zbufrand_result ask(asking what, ask_world *w, zbufrand_frame *frame, buffers *b) {
    zbufrand_render_desc d;
    const zbufrand_scene *scene = w->forest;
    zbufrand_group group[4];
    uint64_t samples = 0;
    size_t n;
    memset(&d, 0, sizeof d);
    switch (what) {
    case ASK_LIGHTS: /* rows one by one */
        d.lights = w->light;
        d.light_count = 65;
        break;
    case ASK_LARGER: d.oversample = 2; break;
    case ASK_FRAMES:
        d.noise = 1e-9;
        d.max_frames = 5;
        d.reconstruct.fill = ZBUFRAND_FILL_PULL_PUSH;
        break;
    case ASK_CELLS:
    case ASK_SQUARES:
        d.reconstruct.occlusion = what == ASK_CELLS ? ZBUFRAND_OCCLUSION_CELLS : ZBUFRAND_OCCLUSION_SQUARES_ALL;
        d.reconstruct.fill = what == ASK_CELLS ? ZBUFRAND_FILL_GAUSS : ZBUFRAND_FILL_REGIONS;
        d.reconstruct.block = 5;
        d.reconstruct.tolerance_color = 0.05f;
        break;
    case ASK_POINTS:
        scene = NULL;
        d.points = &w->points;
        d.points_count = 1;
        break;
    case ASK_ONE_DRAW: case ASK_STREAM: scene = w->flat; break;
    case ASK_THESIS: case ASK_THESIS_SELECT: scene = w->thesis; break;
    case ASK_THESIS_DRAW: scene = w->flat_thesis; break;
    default: break;
    }
    if (scene == w->flat || scene == w->flat_thesis) { /* more than a million samples in one draw */
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.no_occlusion = 1;
        d.density = 600;
        d.camera.eye[2] = 3;
    }
    if (what == ASK_SELECT || what == ASK_THESIS_SELECT) return zbufrand_select(frame, &d, scene, 60, 40, group, 4, &n, NULL);
    if (what == ASK_STREAM) return zbufrand_sample_scene(frame, &d, scene, 60, 40, no_sample, &samples, NULL);
    return zbufrand_render(frame, &d, scene, &b->image, NULL);
}

static zbufrand_scene *flat_scene(int thesis) { /* a triangle across the view */
    static const float position[9] = {-1, -1, 0, 1, -1, 0, 0, 1, 0};
    zbufrand_scene *scene = NULL;
    zbufrand_build_desc bd;
    zbufrand_mesh m;
    memset(&bd, 0, sizeof bd);
    memset(&m, 0, sizeof m);
    if (thesis) zbufrand_preset_thesis(&bd, NULL);
    m.positions = position;
    m.vertex_count = 3;
    m.triangle_count = 1;
    if (zbufrand_scene_create(NULL, &scene) != ZBUFRAND_OK) abort();
    CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(scene, &bd, NULL), ZBUFRAND_OK);
    return scene;
}

static void ask_world_open(ask_world *w, shape s[4]) {
    zbufrand_build_desc bd;
    uint32_t i;
    memset(w, 0, sizeof *w);
    memset(&bd, 0, sizeof bd);
    zbufrand_preset_thesis(&bd, NULL);
    w->forest = forest(s, 60);
    w->thesis = forest(s + 2, 400);
    CHECK_EQ_U64(zbufrand_scene_build(w->thesis, &bd, NULL), ZBUFRAND_OK);
    w->flat = flat_scene(0);
    w->flat_thesis = flat_scene(1);
    w->points.positions = s[1].p;
    w->points.count = s[1].vertices;
    for (i = 0; i < 65; i++) {
        w->light[i].directional = 1;
        w->light[i].position[i % 3] = 1;
        w->light[i].color[i % 3] = 0.01f;
    }
}

/* Whatever asks is cancelled at each of its questions: that is what it says, nothing is left, and the next picture of the
   frame is the one that nobody asks about. */
TEST(cancelled) {
    static const uint32_t least[ASK_COUNT] = {8, 40, 13, 60, 60, 60, 2, 8, 5, 8, 2, 1, 40};
    shape s[4];
    ask_world w;
    buffers b;
    uint32_t what, threads;
    ask_world_open(&w, s);
    buffers_open(&b, 60, 40);
    for (what = 0; what < ASK_COUNT; what++) {
        uint64_t want = 0;
        for (threads = 1; threads <= 3; threads += 2) {
            uint64_t at;
            if (test_quick() && (threads == 3) != (what % 2 == 1)) continue;
            for (at = 0;; at += at < 8 ? 1 : 1 + at / 2) { /* 0: never, to count the questions */
                zbufrand_frame_desc fd;
                zbufrand_frame *frame = NULL;
                zbufrand_error error;
                test_alloc ta;
                test_stopper q;
                zbufrand_result r;
                memset(&fd, 0, sizeof fd);
                memset(&q, 0, sizeof q);
                memset(&error, 0, sizeof error);
                test_alloc_init(&ta);
                fd.env.allocator.alloc_fn = test_alloc_fn;
                fd.env.allocator.free_fn = test_free_fn;
                fd.env.allocator.user = &ta;
                fd.env.thread_count = threads;
                fd.env.error = &error;
                fd.env.progress_fn = test_stop_fn;
                fd.env.progress_user = &q;
                q.stop_at = at;
                CHECK_EQ_U64(zbufrand_frame_create(&fd, &frame), ZBUFRAND_OK);
                r = ask((asking)what, &w, frame, &b);
                if (at == 0) /* one of several threads asks, between the tasks that it takes: how many that are is up to the machine */
                    CHECK_MSG(r == ZBUFRAND_OK && q.calls >= (threads == 1 ? least[what] : 1), "%u asks %u times, result %d", what, (unsigned)q.calls, (int)r);
                else if (q.calls >= at) {
                    CHECK_MSG(r == ZBUFRAND_ERR_CANCELLED, "%u, question %u: result %d", what, (unsigned)at, (int)r);
                    if (what != ASK_STREAM) CHECK_EQ_U64(error.code, ZBUFRAND_ERR_CANCELLED);
                    if (threads == 1) CHECK_EQ_U64(q.calls, at); /* once is enough */
                    q.stop_at = 0;
                    q.done = 0;
                    CHECK_EQ_U64(ask((asking)what, &w, frame, &b), ZBUFRAND_OK);
                }
                CHECK_MSG(threads > 1 || q.backwards == 0, "%u: %u steps back", what, q.backwards);
                if (what < ASK_SELECT && want == 0) want = buffers_hash(&b);
                if (what < ASK_SELECT) CHECK_EQ_U64(buffers_hash(&b), want);
                zbufrand_frame_destroy(frame);
                test_alloc_check(&ta);
                if (at != 0 && (q.calls < at || at > (test_quick() ? 6 : 200))) break;
            }
        }
        if (what < ASK_SELECT) { /* nobody is asked */
            zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
            CHECK_EQ_U64(ask((asking)what, &w, frame, &b), ZBUFRAND_OK);
            CHECK_EQ_U64(buffers_hash(&b), want);
            zbufrand_frame_destroy(frame);
        }
    }
    buffers_close(&b);
    zbufrand_scene_destroy(w.forest);
    zbufrand_scene_destroy(w.thesis);
    zbufrand_scene_destroy(w.flat);
    zbufrand_scene_destroy(w.flat_thesis);
    for (what = 0; what < 4; what++) shape_free(&s[what]);
}

/* Draws of many samples are drawn in pieces: with all that a stream of them has, once. More than there are numbers for
   are refused soon. */
TEST(large_draws) {
    uint32_t i;
    for (i = 0; i < 6; i++) {
        zbufrand_scene *scene = flat_scene(i % 2 == 1);
        zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
        zbufrand_render_desc d;
        zbufrand_stats st;
        buffers b;
        uint64_t samples = 0;
        memset(&d, 0, sizeof d);
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.no_occlusion = d.no_thinning = d.no_repair = 1;
        d.camera.eye[2] = 3;
        d.density = 700;
        d.independent = i / 2 == 1;
        d.comb = i / 2 == 2;
        buffers_open(&b, 60, 40);
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, 60, 40, no_sample, &samples, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(st.accepted, samples);
        CHECK_MSG(st.samples[1] > 400000, "%u samples", (unsigned)st.samples[1]);
        if (i == 1) { /* as dense, 2^32 of them: by hundreds of triangles, each below the most of one */
            buffers large;
            zbufrand_scene *ball = scene;
            shape s;
            zbufrand_mesh m;
            zbufrand_build_desc bd;
            memset(&s, 0, sizeof s);
            memset(&bd, 0, sizeof bd);
            zbufrand_preset_thesis(&bd, NULL);
            shape_sphere(&s, 0, 0, 0, 1, 40);
            m = mesh_of(&s);
            CHECK_EQ_U64(zbufrand_add_mesh(ball, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_scene_build(ball, &bd, NULL), ZBUFRAND_OK);
            d.density = 999999;
            buffers_open(&large, 400, 300);
            CHECK_EQ_U64(zbufrand_render(frame, &d, ball, &large.image, &st), ZBUFRAND_ERR_RANGE);
            buffers_close(&large);
            shape_free(&s);
        }
        buffers_close(&b);
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
    }
}

/* A picture of nodes alone has parts without any. */
TEST(only_nodes) {
    static const float corner[9] = {-1, -1, 0, 1, -1, 0, 0, 1, 0};
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_scene *scene;
    zbufrand_mesh m;
    zbufrand_render_desc d;
    zbufrand_stats st;
    buffers b;
    uint32_t i, seen, k;
    memset(&m, 0, sizeof m);
    m.positions = corner;
    m.vertex_count = 3;
    m.triangle_count = 1;
    scene = render_scene_of(&m, 1);
    buffers_open(&b, 200, 50);
    b.image.rgba8 = NULL;
    b.image.rgba = b.image.depth = NULL;
    memset(&d, 0, sizeof d);
    d.hybrid = ZBUFRAND_HYBRID_ALL;
    for (k = 0; k < 2; k++) {
        memset(b.node, 0x55, 4 * 200 * 50);
        d.oversample = k == 0 ? 1 : 2;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        for (i = 0, seen = 0; i < 200 * 50; i++) {
            CHECK(b.node[i] == 0 || b.node[i] == 2);
            seen += b.node[i] != 0;
        }
        CHECK(seen > 200 && (k == 1 || seen == st.covered));
    }
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    zbufrand_frame_destroy(frame);
}

/* Units are anybody's: the same picture of the same square in any of them, with normals and colours of vertices, and with a
   point light. */
TEST(any_unit) {
    static const uint32_t index[6] = {0, 1, 2, 0, 2, 3};
    static const uint8_t rgb[12] = {255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255};
    float corner[12], normal[12];
    zbufrand_mesh m;
    zbufrand_light light;
    int e, i, k, isa, way;
    for (way = 0; way < 4; way++) {
        static float first[4 * 64 * 48];
        uint64_t hash = 0;
        for (e = -20; e <= 14; e += e == 10 ? 4 : 5) {
            const double size = pow(10, e);
            memset(&m, 0, sizeof m);
            memset(&light, 0, sizeof light);
            for (i = 0; i < 4; i++) {
                corner[3 * i] = (float)(size * (i == 1 || i == 2 ? 1 : -1));
                corner[3 * i + 1] = (float)(size * (i > 1 ? 1 : -1));
                corner[3 * i + 2] = (float)(size * 0.2 * i);
                for (k = 0; k < 3; k++) normal[3 * i + k] = k == 2 ? 1 : 0.3f * corner[3 * i + k] / (float)size;
            }
            m.positions = corner;
            m.vertex_count = 4;
            m.indices = index;
            m.triangle_count = 2;
            if (way & 1) m.normals = normal;
            if (way & 1) m.vertex_rgb = rgb;
            for (isa = 1; isa <= 3; isa += 2) {
                zbufrand_frame *frame = open_frame(1, isa == 1 ? ZBUFRAND_ISA_SCALAR : ZBUFRAND_ISA_AUTO);
                zbufrand_scene *scene = render_scene_of(&m, 1);
                zbufrand_render_desc d;
                buffers b;
                double worst = 0, bright = 0;
                buffers_open(&b, 64, 48);
                memset(&d, 0, sizeof d);
                d.hybrid = way & 1 ? ZBUFRAND_HYBRID_OFF : ZBUFRAND_HYBRID_ALL;
                d.camera.eye[2] = 4 * size;
                light.position[0] = 2 * size;
                light.position[2] = 3 * size;
                for (k = 0; k < 3; k++) light.color[k] = 1;
                if (way & 2) d.lights = &light;
                d.light_count = way & 2 ? 1 : 0;
                CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
                if (isa == 1) hash = buffers_hash(&b);
                else CHECK_EQ_U64(buffers_hash(&b), hash);
                if (e == -20 && isa == 1) memcpy(first, b.rgba, sizeof first);
                for (i = 0; i < 4 * 64 * 48; i++) worst = fmax(worst, fabs((double)b.rgba[i] - (double)first[i]) * (b.rgba[i | 3] > 0 && first[i | 3] > 0));
                CHECK_MSG(worst < 2e-3, "way %d, 10^%d: off by %g", way, e, worst);
                for (k = 0, i = 4 * (24 * 64 + 32); k < 3; k++) bright += (double)b.rgba[i + k];
                CHECK_MSG(bright > 0.4, "way %d, 10^%d: only %g", way, e, bright);
                buffers_close(&b);
                zbufrand_scene_destroy(scene);
                zbufrand_frame_destroy(frame);
            }
        }
    }
}

/* Directions of any length, and lights farther away than floats reach. */
TEST(lights_of_any_length) {
    static const float corner[9] = {-1, -1, 0, 1, -1, 0, 0, 1, 0};
    static const double length[5] = {1, 1e-200, 1e200, 1e300, 1e30};
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_scene *scene;
    zbufrand_mesh m;
    zbufrand_render_desc d;
    zbufrand_light light;
    buffers b;
    float want = 0;
    int i, k, directional;
    memset(&m, 0, sizeof m);
    m.positions = corner;
    m.vertex_count = 3;
    m.triangle_count = 1;
    scene = render_scene_of(&m, 1);
    buffers_open(&b, 64, 64);
    for (directional = 1; directional >= 0; directional--) {
        for (i = 0; i < 5; i++) {
            if (!directional && length[i] <= 1) continue;
            memset(&d, 0, sizeof d);
            memset(&light, 0, sizeof light);
            d.lights = &light;
            d.light_count = 1;
            d.hybrid = ZBUFRAND_HYBRID_ALL;
            d.camera.eye[2] = 4;
            light.directional = (uint32_t)directional;
            light.position[0] = 0.6 * length[i];
            light.position[2] = 0.8 * length[i];
            for (k = 0; k < 3; k++) light.color[k] = 1;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
            if (i == 0) want = b.rgba[4 * (32 * 64 + 32)];
            CHECK_NEAR(want, 0.85, 1e-3);
            CHECK_NEAR(b.rgba[4 * (32 * 64 + 32)], want, 1e-5);
        }
    }
    {
        static const double view[3] = {0, 0, 1e200};
        static const double lo[3] = {-1, -1, -1}, hi[3] = {1, 1, 1};
        CHECK_EQ_U64(zbufrand_camera_fit(&d.camera, lo, hi, view, 64, 64), ZBUFRAND_OK);
        CHECK(d.camera.eye[2] > 2 && d.camera.eye[2] < 20);
        { /* a box that is too large to be looked at */
            static const double least[3] = {-1e308, -1e308, -1e308}, most[3] = {1e308, 1e308, 1e308};
            zbufrand_camera c = d.camera;
            CHECK_EQ_U64(zbufrand_camera_fit(&c, least, most, NULL, 64, 64), ZBUFRAND_ERR_INVALID_ARG);
            CHECK(memcmp(&c, &d.camera, sizeof c) == 0);
        }
    }
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    zbufrand_frame_destroy(frame);
}

/* Probabilities below what doubles have: nothing, and no noise of bits. */
TEST(incomplete_of_many_samples) {
    static const double density[7] = {3, 100, 700, 1500, 2500, 3000, 9000};
    zbufrand_frame *frame = open_frame(2, ZBUFRAND_ISA_AUTO);
    zbufrand_scene *scene;
    zbufrand_render_desc d;
    zbufrand_stats st;
    zbufrand_mesh m;
    shape s;
    buffers b;
    int i;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 0, 0, 0, 1, 40);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    buffers_open(&b, 32, 32);
    for (i = 0; i < 9; i++) {
        memset(&d, 0, sizeof d);
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.density = i < 7 ? density[i] : i == 7 ? 1 : 3;
        if (i == 7) d.reconstruct.block = 50; /* 2500 samples a block */
        if (i == 8) d.oversample = 16;        /* 256 parts of 3 */
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, &st), ZBUFRAND_OK);
        CHECK_MSG(st.incomplete >= 0 && st.incomplete <= (i == 0 ? 0.2 : 1e-30), "%d: %g", i, st.incomplete);
    }
    CHECK(zbufrandi_share_pow(0.135, 1500) >= 0 && zbufrandi_share_pow(0.135, 1500) < 1e-290); /* of so many frames */
    CHECK(zbufrandi_share_pow(0.0, 2) <= 0 && zbufrandi_block_empty(0, 1) >= 1);
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
    zbufrand_frame_destroy(frame);
}

static int stop_at_once(void *user, const zbufrand_sample *samples, const uint32_t *numbers, size_t count) {
    (void)user;
    (void)samples;
    (void)numbers;
    return count != 0;
}

/* The brightest that is allowed: no pixel overflows, whatever adds them up; a little more is refused. */
TEST(bright_pictures) {
    zbufrand_frame *frame = open_frame(1, ZBUFRAND_ISA_AUTO);
    zbufrand_scene *scene;
    zbufrand_render_desc d;
    zbufrand_light light[3];
    zbufrand_mesh m;
    shape s;
    buffers b;
    uint32_t k, i, bad;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 0, 0, 0, 1, 20);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    buffers_open(&b, 40, 32);
    for (k = 0; k < 24; k++) {
        memset(&d, 0, sizeof d);
        memset(light, 0, sizeof light);
        d.reconstruct.fill = (zbufrand_fill)(k % 6);
        d.reconstruct.block = 1 + k % 2;
        d.oversample = k / 6 % 2 ? 2 : 0;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.lights = light;
        d.light_count = 3;
        for (i = 0; i < 9; i++) {
            light[i / 3].position[i % 3] = 1;
            light[i / 3].directional = 1;
            light[i / 3].color[i % 3] = k < 12 ? 1e12f : -1e12f;
        }
        for (i = 0; i < 3; i++) d.ambient[i] = 1e12f;
        for (i = 0; i < 4; i++) d.background[i] = k < 12 ? 1e12f : -1e12f;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
        for (i = bad = 0; i < 4 * 40 * 32; i++) bad += (uint32_t)!isfinite(b.rgba[i]);
        CHECK_MSG(bad == 0, "%u: %u values are not finite", k, bad);
        light[2].color[k % 3] = 1.1e12f;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
        light[2].color[k % 3] = 0;
        d.ambient[k % 3] = -3.4e38f;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
        d.ambient[k % 3] = 0;
        d.background[k % 4] = (float)NAN;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
        d.background[k % 4] = 3.4e38f;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
    }
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
    zbufrand_frame_destroy(frame);
}

/* What env.error says is what was wrong. */
TEST(reasons) {
    zbufrand_error error;
    zbufrand_frame_desc fd;
    zbufrand_frame *frame = NULL;
    zbufrand_scene *scene;
    zbufrand_render_desc d;
    zbufrand_mesh m;
    shape s;
    buffers b;
    static zbufrand_light lights[65536];
    memset(&fd, 0, sizeof fd);
    memset(&error, 0, sizeof error);
    fd.env.error = &error;
    CHECK_EQ_U64(zbufrand_frame_create(&fd, &frame), ZBUFRAND_OK);
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 0, 0, 0, 1, 20);
    m = mesh_of(&s);
    scene = render_scene_of(&m, 1);
    buffers_open(&b, 32, 32);
    memset(&d, 0, sizeof d);
    d.reconstruct.block = 2000;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_RANGE);
    CHECK_STR(error.text, "block 2000 is above 1024");
    d.reconstruct.block = 0;
    d.reconstruct.tolerance = -1;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_STR(error.text, "a tolerance is negative or not a number");
    d.reconstruct.tolerance = 0;
    d.lights = lights;
    d.light_count = 65536;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_RANGE);
    CHECK_STR(error.text, "render: 65536 lights are more than 65535");
    d.lights = NULL;
    d.light_count = 0;
    d.density = -1;
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_STR(error.text, "render: a camera, light, cloud or option is wrong");
    d.density = 0;
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, 32, 32, stop_at_once, NULL, NULL), ZBUFRAND_ERR_CANCELLED);
    CHECK_EQ_U64(error.code, ZBUFRAND_ERR_CANCELLED);
    CHECK_STR(error.text, "query: cancelled");
    CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &b.image, NULL), ZBUFRAND_OK);
    buffers_close(&b);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
    zbufrand_frame_destroy(frame);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(like_a_z_buffer);
    RUN(shows_what_is_visible);
    RUN(raster_is_exact);
    RUN(fills_without_asking);
    RUN(same_bits);
    RUN(seeds_and_occlusion);
    RUN(reported_share_is_incomplete);
    RUN(tolerance_of_random_scenes);
    RUN(noise_of_random_scenes);
    RUN(few_samples_among_rastered);
    RUN(noise_is_kept);
    RUN(odd_cameras);
    RUN(far_too_large);
    RUN(wrong_arguments);
    RUN(nothing_is_allocated_twice);
    RUN(out_of_memory);
    RUN(colours_are_unbiased);
    RUN(panes);
    RUN(own_shading);
    RUN(nodes_backgrounds_strides);
    RUN(only_nodes);
    RUN(any_unit);
    RUN(lights_of_any_length);
    RUN(incomplete_of_many_samples);
    RUN(bright_pictures);
    RUN(reasons);
    RUN(clouds);
    RUN(far_from_home);
    RUN(thirteen_decades);
    RUN(draws_more_if_too_little);
    RUN(far_away_as_colourful);
    RUN(any_seed_as_colourful);
    RUN(oversampled);
    RUN(pictures_stay_as_good);
    RUN(gaps_between_squares);
    RUN(depths_between_samples);
    RUN(borders_and_mixtures_keep_promises);
    RUN(steep_surfaces_stay_hidden);
    RUN(small_parts_and_means_keep_promises);
    RUN(stored_points_are_no_combs);
    RUN(golden_pictures);
    RUN(golden_scenes);
    RUN(costs_are_measured);
    RUN(memory_limit);
    RUN(cancelled);
    RUN(large_draws);
    return test_end();
}
