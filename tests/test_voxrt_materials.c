/* Finishes: what mirrors show is the mirrored scene; glass bends light by Snell, mirrors by Fresnel, and takes nothing in
   a white furnace; light goes through panes by their transparency; pictures do not depend on threads and instruction
   sets; files, shared trees, instances and coarser cells keep finishes; hostile files; textures by a function. */
#include "test.h"
#include "shapes.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"

enum { SIDE = 96, CELLS = 64, MOST = 40000 };

typedef struct list { voxrt_voxel v[MOST]; uint8_t finish[MOST]; size_t n; } list;
static list materials_cells;

static void materials_add(uint32_t x, uint32_t y, uint32_t z, int r, int g, int b, int finish) {
    voxrt_voxel *v = &materials_cells.v[materials_cells.n];
    if (materials_cells.n == MOST) return;
    memset(v, 0, sizeof *v);
    v->x = x;
    v->y = y;
    v->z = z;
    v->rgb[0] = (uint8_t)r;
    v->rgb[1] = (uint8_t)g;
    v->rgb[2] = (uint8_t)b;
    materials_cells.finish[materials_cells.n++] = (uint8_t)finish;
}

static void add_box(uint32_t x0, uint32_t x1, uint32_t y0, uint32_t y1, uint32_t z0, uint32_t z1, int r, int g, int b, int finish) {
    uint32_t x, y, z;
    for (x = x0; x < x1; x++)
        for (y = y0; y < y1; y++)
            for (z = z0; z < z1; z++) materials_add(x, y, z, r, g, b, finish);
}

static void mirror(voxrt_finish *f, float share) {
    memset(f, 0, sizeof *f);
    f->diffuse = 1;
    f->mirror[0] = f->mirror[1] = f->mirror[2] = share;
}
static void glass(voxrt_finish *f, float share, float index) {
    memset(f, 0, sizeof *f);
    f->diffuse = 1;
    f->transparency[0] = f->transparency[1] = f->transparency[2] = share;
    f->refraction = index;
}

static voxrt_tree *materials_make(const voxrt_finish *finishes, size_t count) { /* of the cells: one is a unit cube */
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    memset(&d, 0, sizeof d);
    d.finishes = finishes;
    d.finish_count = count;
    d.voxel_finish = count != 0 ? materials_cells.finish : NULL;
    CHECK(voxrt_tree_from_voxels(&d, materials_cells.v, materials_cells.n, 6, &t) == VOXRT_OK);
    return t;
}

/* A ball, a pane and a floor of a mesh, with normals; finish 1 mirrors, 2 is glass. */
static voxrt_tree *make_mesh(uint32_t resolution, uint32_t planes, const voxrt_finish *finishes, size_t count, int number,
                             const voxrt_env *env) {
    voxrt_build_desc d;
    voxrt_mesh m;
    voxrt_tree *t = NULL;
    uint8_t *of;
    size_t i, ball;
    shape s;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    shape_sphere(&s, 1, 1, 1, 0.5, 48);
    ball = s.triangles;
    shape_box(&s, 0.1, 0.2, 0.1, 1.9, 0.3, 1.9);
    of = (uint8_t *)calloc(s.triangles, 1);
    for (i = 0; of != NULL && i < s.triangles; i++) of[i] = (uint8_t)(i < ball ? number : 0);
    if (env != NULL) d.env = *env;
    d.resolution = resolution;
    d.box_size = 2;
    d.planes = planes;
    d.finishes = finishes;
    d.finish_count = count;
    m.positions = s.p;
    m.vertex_count = s.vertices;
    m.indices = s.t;
    m.triangle_count = s.triangles;
    m.normals = s.normal;
    m.triangle_finish = of;
    (void)voxrt_tree_build(&d, &m, NULL, &t);
    free(of);
    shape_free(&s);
    return t;
}

static void look(voxrt_render_desc *d, float ex, float ey, float ez, float ax, float ay, float az) {
    memset(d, 0, sizeof *d);
    d->camera.eye[0] = ex;
    d->camera.eye[1] = ey;
    d->camera.eye[2] = ez;
    d->camera.at[0] = ax;
    d->camera.at[1] = ay;
    d->camera.at[2] = az;
}

static const voxrt_light no_light = {{0, 1, 0}, 1, {0, 0, 0}, 1};
static const voxrt_material flat = {{1, 1, 1}, 0, 0, 0}; /* colours as they are */

/* Surfaces show their colours and what they emit: no light but what the background sends. */
static void look_unlit(voxrt_render_desc *d, float fov, float ex, float ey, float ez, float ax, float ay, float az) {
    look(d, ex, ey, ez, ax, ay, az);
    d->camera.fov_y = fov;
    d->lights = &no_light;
    d->light_count = 1;
    d->material = &flat;
}

/* Walls at right angles to x between y, z = 0 and 64. */
static void add_wall(uint32_t x, int r, int g, int b, int finish) { add_box(x, x + 1, 0, 64, 0, 64, r, g, b, finish); }

static int draw(const voxrt_render_desc *d, const voxrt_tree *t, float (*rgba)[4]) {
    voxrt_image image;
    memset(&image, 0, sizeof image);
    image.width = image.height = SIDE;
    image.rgba = rgba[0];
    return voxrt_render(d, t, &image, NULL) == VOXRT_OK;
}
static float materials_picture[2][SIDE * SIDE][4];

/* ---- mirrors ---- */

TEST(mirrors_show_the_mirrored_scene) {
    voxrt_finish f;
    voxrt_tree *t;
    voxrt_render_desc d;
    uint32_t i, k, side, other, seen = 0, seed = 1;
    for (side = 0; side < 2; side++) {
        materials_cells.n = 0;
        for (i = 0; i < 60; i++) { /* lumps before the wall; its visible face is at x = 33 */
            uint32_t p[3];
            for (k = 0; k < 3; k++) {
                seed = seed * 1664525u + 1013904223u;
                p[k] = (k == 0 ? 37 : 10) + (seed >> 16) % (k == 0 ? 10u : 44u);
            }
            add_box(p[0], p[0] + 2, p[1], p[1] + 2, p[2], p[2] + 2, (int)(20 + 4 * i), (int)(255 - 4 * i), (int)(i * 37 % 256), 0);
        }
        seed = 1;
        other = (uint32_t)materials_cells.n;
        mirror(&f, 1);
        if (side == 0) add_wall(32, 90, 90, 90, 1);
        else for (i = 0; i < other; i++) materials_add(65 - materials_cells.v[i].x, materials_cells.v[i].y, materials_cells.v[i].z,
            materials_cells.v[i].rgb[0], materials_cells.v[i].rgb[1], materials_cells.v[i].rgb[2], 0);
        t = materials_make(&f, 1);
        look_unlit(&d, 50, 60.37f, 33.1f, 31.7f, 33, 32, 32);
        d.background[0] = 0.25f;
        d.background[3] = 1;
        CHECK(draw(&d, t, materials_picture[side]));
        voxrt_tree_destroy(t);
    }
    for (i = other = 0; i < SIDE * SIDE; i++) {
        other += memcmp(materials_picture[0][i], materials_picture[1][i], sizeof materials_picture[0][i]) != 0;
        seen += materials_picture[0][i][0] != 0.25f;
    }
    CHECK_MSG(seen > 2000 && other <= 40, "%u pixels differ, %u show something", other, seen); /* rounding at edges */
}

/* Three mirrors and a limit: each bounce takes its share. */
TEST(bounces_end) {
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t;
    uint32_t k;
    float expect = 0, weight = 1;
    materials_cells.n = 0;
    mirror(&f, 0.5f);
    f.emission[0] = 1; /* two walls that face each other: sums of 2^-k */
    add_wall(10, 0, 0, 0, 1);
    add_wall(50, 0, 0, 0, 1);
    t = materials_make(&f, 1);
    for (k = 1; k <= 6; k++) {
        look_unlit(&d, 1, 30, 32, 32, 10, 32.01f, 32.02f);
        d.bounces_plus_1 = k;
        CHECK(draw(&d, t, materials_picture[0]));
        expect += weight;
        weight *= 0.5f;
        CHECK_NEAR(materials_picture[0][SIDE * SIDE / 2][0], expect, 1e-6);
    }
    d.bounces_plus_1 = 0;
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][SIDE * SIDE / 2][0], 2 - 1 / 256.0, 1e-6); /* eight */
    d.bounces_plus_1 = 34;
    CHECK(!draw(&d, t, materials_picture[0]));
    voxrt_tree_destroy(t);
}

/* Half of the light that comes to one of `count` panes, 8 apart, is mirrored: what of it leaves, by the rules of paths. */
static double leaves(int count, double x, int up, double weight, uint32_t depth, uint32_t bounces) {
    int next = up ? (int)ceil(x) : (int)floor(x); /* x is between panes */
    if (next < 0 || next >= count) return weight;
    if (depth == bounces || 0.5 * weight < 1 / 512.0) return 0;
    return leaves(count, next + 0.5, 1, 0.5 * weight, depth + 1, bounces) + leaves(count, next - 0.5, 0, 0.5 * weight, depth + 1, bounces);
}

/* Each bounce makes two rays of one: more than are kept at a time. */
TEST(many_rays_wait) {
    static const uint32_t bounces[4] = {32, 8, 5, 2};
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t;
    uint32_t i, k;
    materials_cells.n = 0;
    glass(&f, 0.5f, 0);
    f.mirror[0] = f.mirror[1] = f.mirror[2] = 1;
    for (i = 0; i < 8; i++) add_wall(3 + 8 * i, 0, 0, 0, 1);
    t = materials_make(&f, 1);
    for (k = 0; k < 4; k++) {
        const double expect = leaves(8, 3.5, 0, 1, 0, bounces[k]);
        look_unlit(&d, 1, 31, 32.3f, 32.4f, 3, 32.35f, 32.45f);
        d.pixel_step = 4;
        d.bounces_plus_1 = bounces[k] + 1;
        for (i = 0; i < 4; i++) d.background[i] = 1;
        CHECK(draw(&d, t, materials_picture[0]));
        CHECK((k == 3 || expect > 0) && expect < 1);
        for (i = 0; i < SIDE * SIDE; i += 97) CHECK_NEAR(materials_picture[0][i][1], expect, 1e-6);
    }
    voxrt_tree_destroy(t);
}

/* ---- glass ---- */

/* One surface, seen at an angle: directions and shares of what goes on. */
TEST(snell_and_fresnel) {
    static const float index[4] = {1.33f, 1.5f, 2.4f, 0.7f};
    uint32_t i, k, side, total = 0;
    voxrti_render c;
    voxrt_render_desc d;
    memset(&c, 0, sizeof c);
    memset(&d, 0, sizeof d);
    c.d = &d;
    c.bounces = 8;
    for (i = 0; i < 4; i++) {
        for (side = 0; side < 2; side++) {
            for (k = 0; k < 90; k++) {
                const double angle = (double)k * 3.14159265358979 / 180, eta = side ? (double)index[i] : 1 / (double)index[i];
                const double s = eta * sin(angle), ci = cos(angle), ct = s < 1 ? sqrt(1 - s * s) : 0;
                const double rs = (eta * ci - ct) / (eta * ci + ct), rp = (ci - eta * ct) / (ci + eta * ct);
                const double share = s < 1 ? 0.5 * (rs * rs + rp * rp) : 1;
                voxrt_finish f;
                voxrt_surface met;
                voxrt_ray ray;
                voxrti_path from, out[2];
                uint32_t n, j;
                double sum = 0;
                glass(&f, 1, index[i]);
                memset(&met, 0, sizeof met);
                memset(&from, 0, sizeof from);
                memset(&ray, 0, sizeof ray);
                from.weight[0] = from.weight[1] = from.weight[2] = 1;
                from.body[0] = side ? &f : NULL;
                met.t = 3;
                met.edge = 0.01f;
                met.normal[1] = side ? -1.0f : 1.0f;
                met.finish = &f;
                ray.dir[0] = 2 * (float)sin(angle); /* of length 2 */
                ray.dir[1] = -2 * (float)cos(angle);
                n = voxrti_path_split(&c, &ray, &met, &from, side ? VOXRTI_BACK : VOXRTI_FRONT, out);
                for (j = 0; j < n; j++) {
                    const int through = out[j].dir[1] < 0;
                    const float *v = out[j].dir;
                    CHECK_NEAR(v[0] * v[0] + v[1] * v[1] + v[2] * v[2], 4, 1e-5);
                    CHECK_NEAR(v[0], 2 * (through ? s : sin(angle)), 2e-6);
                    CHECK_NEAR(out[j].weight[1], through ? 1 - share : share, 1e-5);
                    CHECK(out[j].body[0] == (through != (int)side ? &f : NULL) && out[j].body[1] == NULL);
                    CHECK_NEAR(out[j].org[0] + v[0] * 3, ray.dir[0] * 3, 1e-5 + (k > 75 ? 1 : 0)); /* lifted where it grazes */
                    CHECK(out[j].t_min > 3);
                    sum += (double)out[j].weight[0];
                }
                if (s >= 1) total++;
                CHECK(s < 1 || (n == 1 && out[0].weight[0] == 1.0f));
                CHECK_NEAR(sum, 1, share > 0.002 && share < 0.998 ? 1e-5 : 0.0021); /* less than the cutoff may be missing */
            }
        }
    }
    CHECK_MSG(total > 90, "%u total reflections", total);
}

/* A body of glass between two sheets: behind it everything is shifted as the law says. Each cell of the wall behind has
   a colour of its own. */
TEST(glass_shifts_what_is_behind_it) {
    const float index = 1.5f;
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t;
    uint32_t i, y, z, right = 0, sure = 0, plain = 0;
    materials_cells.n = 0;
    glass(&f, 1, index);
    for (y = 0; y < 64; y++)
        for (z = 0; z < 64; z++) materials_add(4, y, z, (int)(4 * y), (int)(4 * z), 7, 0);
    add_wall(20, 255, 255, 255, 1);
    add_wall(40, 255, 255, 255, 1); /* its face at x = 41 is entered, that at x = 21 left */
    t = materials_make(&f, 1);
    look_unlit(&d, 20, 75, 70, 32, 41, 40, 32);
    CHECK(draw(&d, t, materials_picture[0]));
    for (i = 0; i < SIDE * SIDE; i++) {
        voxrt_ray r;
        double p[3], u[3], l = 0, k, at[2], straight[2];
        int a, inner = 1;
        CHECK(voxrt_camera_ray(&d.camera, SIDE, SIDE, (double)(i % SIDE) + 0.5, (double)(i / SIDE) + 0.5, &r) == VOXRT_OK);
        for (a = 0; a < 3; a++) l += (double)r.dir[a] * (double)r.dir[a];
        for (a = 0; a < 3; a++) u[a] = (double)r.dir[a] / sqrt(l);
        k = (41 - (double)r.org[0]) / u[0];
        for (a = 0; a < 3; a++) p[a] = (double)r.org[a] + k * u[a];
        k = -sqrt(1 - (1 - u[0] * u[0]) / (double)(index * index)); /* x of the direction in the glass */
        for (a = 1; a < 3; a++) {
            straight[a - 1] = p[a] + (5 - 41) * u[a] / u[0];
            at[a - 1] = p[a] + (21 - 41) * (u[a] / (double)index) / k + (5 - 21) * u[a] / u[0];
            inner &= at[a - 1] > 1 && at[a - 1] < 63 && p[a] > 1 && p[a] < 63 && fabs(at[a - 1] - floor(at[a - 1]) - 0.5) < 0.49;
        }
        if (!inner) continue;
        sure++;
        /* red and green of the cell, less what is mirrored: their ratio stays */
        {
            const double red = voxrti_srgb_to_linear(4 * floor(at[0]) / 255), green = voxrti_srgb_to_linear(4 * floor(at[1]) / 255);
            const double blue = voxrti_srgb_to_linear(7.0 / 255), share = (double)materials_picture[0][i][2] / blue;
            right += fabs((double)materials_picture[0][i][0] - share * red) < 2e-3 &&
                fabs((double)materials_picture[0][i][1] - share * green) < 2e-3 && share > 0.8;
            plain += floor(straight[0]) == floor(at[0]);
        }
    }
    CHECK_MSG(sure > 1000 && right >= sure - sure / 100, "%u of %u cells are right", right, sure);
    CHECK_MSG(plain < sure / 10, "%u cells would be the same without glass", plain);
    voxrt_tree_destroy(t);
}

/* In a white surrounding a body that takes no light cannot be told from it; none is ever brighter. */
TEST(furnace) {
    uint32_t k, i, planes;
    for (planes = 0; planes < 2; planes++) {
        for (k = 0; k < 4; k++) {
            voxrt_finish f;
            voxrt_render_desc d;
            voxrt_tree *t;
            double least = 9, most = 0, mean = 0, hits = 0;
            if (k == 0) mirror(&f, 1);
            else glass(&f, 1, k == 1 ? 1.5f : k == 2 ? 2.4f : 1.0f);
            t = make_mesh(128, planes, &f, 1, 1, NULL);
            REQUIRE(t != NULL);
            look_unlit(&d, 18, 1.3f, 1.4f, 4.5f, 1, 1, 1); /* the floor is white, too */
            d.bounces_plus_1 = 33;
            for (i = 0; i < 4; i++) d.background[i] = 1;
            CHECK(draw(&d, t, materials_picture[0]));
            for (i = 0; i < SIDE * SIDE; i++) {
                const double v = (double)materials_picture[0][i][1];
                if (v == 1) continue;
                hits++;
                mean += v;
                least = v < least ? v : least;
                most = v > most ? v : most;
            }
            mean = hits > 0 ? mean / hits : 1;
            if (test_g.verbose)
                printf("furnace: planes %u, finish %u: %.0f pixels are not 1: least %.4f, mean %.5f, most %.7f\n", planes, k, hits, least, mean, most);
            CHECK_MSG(most <= 1 + 1e-5, "brighter than its surroundings: %.7f", most);
            CHECK_MSG(mean > 0.998 && least > 0.99, "light is lost: mean %.5f, least %.5f", mean, least);
            voxrt_tree_destroy(t);
        }
    }
}

/* ---- against an exact tracer ---- */

/* A ball or a box; hollow: what it encloses is air in the body around it. */
typedef struct body { int box, hollow; double c[3], r[3]; const voxrt_finish *f; } body;

/* What is seen in direction (from the middle) u, where nothing is in the way. */
static void surroundings(const double u[3], double color[3]) {
    int a;
    for (a = 0; a < 3; a++) color[a] = 0.5 + 0.4 * sin(3 * u[a] + u[(a + 1) % 3] + a);
}

static const double far_away = 30, middle[3] = {1, 1, 1};

static double far_sphere(const double o[3], const double u[3]) { /* from inside */
    double b = 0, c = -far_away * far_away, l = 0;
    int a;
    for (a = 0; a < 3; a++) {
        b += (o[a] - middle[a]) * u[a];
        c += (o[a] - middle[a]) * (o[a] - middle[a]);
        l += u[a] * u[a];
    }
    return b * b > l * c ? (-b + sqrt(b * b - l * c)) / l : -1;
}

static void far_trace(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, voxrt_surface *surfaces, size_t count) {
    size_t i;
    int a;
    (void)user;
    (void)desc;
    for (i = 0; i < count; i++) {
        double o[3], u[3], color[3], t;
        for (a = 0; a < 3; a++) {
            o[a] = (double)rays[i].org[a];
            u[a] = (double)rays[i].dir[a];
        }
        t = far_sphere(o, u);
        if (!(t > (double)rays[i].t_min && t < (double)rays[i].t_max)) continue;
        for (a = 0; a < 3; a++) u[a] = (o[a] + t * u[a] - middle[a]) / far_away;
        surroundings(u, color);
        surfaces[i].t = (float)t;
        surfaces[i].face = 6;
        for (a = 0; a < 3; a++) {
            surfaces[i].normal[a] = (float)-u[a];
            surfaces[i].rgb[a] = (uint8_t)(255 * voxrti_linear_to_srgb(color[a]) + 0.5);
        }
    }
}
static void far_occluded(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, uint8_t *occluded, size_t count) {
    (void)user;
    (void)desc;
    (void)rays;
    memset(occluded, 0, count);
}

/* The nearest body in front of o; n: its normal. */
static double exact_hit(const body *b, size_t count, const double o[3], const double u[3], double n[3], const body **out) {
    double best = 1e30;
    size_t i;
    int a, k;
    *out = NULL;
    for (i = 0; i < count; i++, b++) {
        double t[2] = {-1e30, 1e30}, at = 0, c = 0;
        int axis[2] = {0, 0};
        for (a = 0; a < 3 && b->box; a++) {
            const double t0 = (b->c[a] - b->r[a] - o[a]) / u[a], t1 = (b->c[a] + b->r[a] - o[a]) / u[a];
            if (fmin(t0, t1) > t[0]) axis[0] = a;
            if (fmax(t0, t1) < t[1]) axis[1] = a;
            t[0] = fmax(t[0], fmin(t0, t1));
            t[1] = fmin(t[1], fmax(t0, t1));
        }
        if (!b->box) {
            for (a = 0, c = -b->r[0] * b->r[0]; a < 3; a++) {
                at += (o[a] - b->c[a]) * u[a];
                c += (o[a] - b->c[a]) * (o[a] - b->c[a]);
            }
            if (at * at <= c) continue;
            t[0] = -at - sqrt(at * at - c);
            t[1] = -at + sqrt(at * at - c);
        }
        if (t[0] > t[1]) continue;
        k = t[0] > 1e-9 ? 0 : 1;
        if (!(t[k] > 1e-9 && t[k] < best)) continue;
        best = t[k];
        *out = b;
        for (a = 0; a < 3; a++) {
            n[a] = b->box ? (a == axis[k] ? (o[a] + best * u[a] > b->c[a] ? 1.0 : -1.0) : 0.0) : (o[a] + best * u[a] - b->c[a]) / b->r[0];
            if (b->hollow) n[a] = -n[a];
        }
    }
    return best;
}

static void exact_ray(const body *b, size_t count, const double o[3], const double u[3], const voxrt_finish *const *in, uint32_t depth,
                      const double weight[3], double sum[3]) {
    const body *met;
    const voxrt_finish *beyond[4], *f;
    double n[3], p[3], w[3], v[3], color[3], t = exact_hit(b, count, o, u, n, &met), cosine = 0, share = 1, eta = 1, square = 0, other = 0;
    int a, k = 0, bends, out;
    if (met == NULL) {
        t = far_sphere(o, u);
        for (a = 0; a < 3; a++) p[a] = (o[a] + t * u[a] - middle[a]) / far_away;
        surroundings(p, color);
        for (a = 0; a < 3; a++) sum[a] += weight[a] * color[a];
        return;
    }
    if (depth == 8) return;
    f = met->f;
    bends = f->transparency[0] > 0;
    for (a = 0; a < 3; a++) {
        p[a] = o[a] + t * u[a];
        w[a] = weight[a] * (in[0] != NULL ? exp(-(double)in[0]->absorption[a] * t) : 1);
        cosine -= u[a] * n[a];
    }
    out = cosine < 0;
    for (a = 0; a < 3 && out; a++) n[a] = -n[a];
    cosine = fabs(cosine);
    memset(beyond, 0, sizeof beyond);
    if (!out) beyond[k++] = f;
    for (a = 0; a < 3; a++)
        if (in[a] != NULL && in[a] != f) beyond[k++] = in[a];
    if (bends) {
        eta = (in[0] != NULL ? (double)in[0]->refraction : 1) / (beyond[0] != NULL ? (double)beyond[0]->refraction : 1);
        square = 1 - eta * eta * (1 - cosine * cosine);
        if (square > 0) {
            const double x = (eta * cosine - sqrt(square)) / (eta * cosine + sqrt(square));
            const double y = (cosine - eta * sqrt(square)) / (cosine + eta * sqrt(square));
            share = 0.5 * (x * x + y * y);
            other = sqrt(square);
        }
        if (share < 1) {
            for (a = 0; a < 3; a++) v[a] = eta * u[a] + (eta * cosine - other) * n[a];
            for (a = 0; a < 3; a++) color[a] = w[a] * (1 - share) * (double)f->transparency[a];
            if (fmax(color[0], fmax(color[1], color[2])) >= 1 / 512.0) exact_ray(b, count, p, v, beyond, depth + 1, color, sum);
        }
        for (a = 0; a < 3; a++) w[a] *= share * (double)f->transparency[a];
    } else {
        for (a = 0; a < 3; a++) w[a] *= (double)f->mirror[a];
    }
    for (a = 0; a < 3; a++) v[a] = u[a] + 2 * cosine * n[a];
    if (fmax(w[0], fmax(w[1], w[2])) >= 1 / 512.0) exact_ray(b, count, p, v, in, depth + 1, w, sum);
}

/* A tree of bodies; finish k + 1 is that of body k, in `finishes`. */
static voxrt_tree *make_bodies(const body *b, size_t count, const voxrt_finish *finishes, size_t finish_count, uint32_t resolution, uint32_t planes) {
    voxrt_build_desc d;
    voxrt_mesh m;
    voxrt_tree *t = NULL;
    uint8_t *of = NULL;
    size_t i, k, c, first, vertex;
    shape s;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    for (i = 0; i < count; i++) {
        const double *at = b[i].c, *r = b[i].r;
        first = s.triangles;
        vertex = s.vertices;
        if (b[i].box) shape_box(&s, at[0] - r[0], at[1] - r[1], at[2] - r[2], at[0] + r[0], at[1] + r[1], at[2] + r[2]);
        else shape_sphere(&s, at[0], at[1], at[2], r[0], 128);
        for (k = first; k < s.triangles && b[i].hollow; k++) {
            const uint32_t swap = s.t[3 * k + 1];
            s.t[3 * k + 1] = s.t[3 * k + 2];
            s.t[3 * k + 2] = swap;
        }
        for (k = 3 * vertex; k < 3 * s.vertices && b[i].hollow; k++) s.normal[k] = -s.normal[k];
        of = (uint8_t *)realloc(of, s.triangles);
        for (c = 0; c < finish_count && b[i].f != &finishes[c]; c++) { }
        for (k = first; of != NULL && k < s.triangles; k++) of[k] = (uint8_t)(c + 1);
    }
    d.resolution = resolution;
    d.box_size = 2;
    d.planes = planes;
    d.finishes = finishes;
    d.finish_count = finish_count;
    m.positions = s.p;
    m.vertex_count = s.vertices;
    m.indices = s.t;
    m.triangle_count = s.triangles;
    m.normals = s.normal;
    m.triangle_finish = of;
    if (of != NULL) (void)voxrt_tree_build(&d, &m, NULL, &t);
    free(of);
    shape_free(&s);
    return t;
}

/* Balls and boxes of glass: pictures are those of a tracer that has the bodies themselves, not voxels. */
TEST(bodies_against_an_exact_tracer) {
    static const struct { const char *name; float eye[3], at[3], fov; double most; } cases[] = {
        {"ball", {1.3f, 1.4f, 4.5f}, {1, 1, 1}, 18, 0.012},
        {"ball, from inside", {1.1f, 0.9f, 1.15f}, {1, 1.1f, 0}, 70, 0.006},
        {"ball of glass in water", {1.3f, 1.4f, 4.5f}, {1, 1, 1}, 18, 0.024},
        {"bubble in a ball", {1.3f, 1.4f, 4.5f}, {1, 1, 1}, 18, 0.041},
        {"mirror in a ball", {1.3f, 1.4f, 4.5f}, {1, 1, 1}, 18, 0.036},
        {"ball of air in water", {1.3f, 1.4f, 4.5f}, {1, 1, 1}, 18, 0.029},
        {"box", {2.3f, 2.6f, 3.9f}, {1, 1, 1}, 26, 0.028},
        {"column from above", {1.05f, 4.9f, 1.03f}, {1, 1, 1}, 14, 0.018},
        {"box from inside", {1.1f, 0.9f, 1.15f}, {1, 1.1f, 0}, 70, 0.025},
    };
    uint32_t k, planes, i, a;
    for (k = 0; k < sizeof cases / sizeof *cases; k++) {
        for (planes = 0; planes < 2; planes++) {
            voxrt_finish f[2];
            body b[2];
            size_t count = 1;
            voxrt_tree *t;
            voxrt_render_desc d;
            voxrt_geometry around;
            double off = 0;
            uint32_t seen = 0, wrong = 0;
            if (test_quick() && (k + planes) % 2 != 0) continue;
            memset(b, 0, sizeof b);
            glass(&f[0], 1, 1.5f);
            glass(&f[1], 1, 1.5f);
            f[0].absorption[0] = 0.5f;
            f[0].absorption[2] = 0.1f;
            for (a = 0; a < 3; a++) {
                b[0].c[a] = b[1].c[a] = 1;
                b[0].r[a] = 0.5;
                b[1].r[a] = 0.25;
            }
            b[1].c[0] = 1.05;
            b[0].f = &f[0];
            b[1].f = &f[1];
            if (k == 2 || k == 5) f[0].refraction = 1.33f;
            if (k == 2) f[1].refraction = 1.8f;
            if (k == 5) f[1].refraction = 1.0001f;
            if (k == 3) {
                b[1].f = &f[0];
                b[1].hollow = 1;
            }
            if (k == 4) mirror(&f[1], 1);
            if (k >= 2 && k <= 5) count = 2;
            if (k >= 6) b[0].box = 1;
            if (k == 7) {
                b[0].r[0] = 0.2;
                b[0].r[1] = 0.95;
            }
            t = make_bodies(b, count, f, count == 2 && k != 3 ? 2 : 1, 256, planes);
            REQUIRE(t != NULL);
            look_unlit(&d, cases[k].fov, cases[k].eye[0], cases[k].eye[1], cases[k].eye[2], cases[k].at[0], cases[k].at[1], cases[k].at[2]);
            memset(&around, 0, sizeof around);
            around.trace_fn = far_trace;
            around.occluded_fn = far_occluded;
            for (a = 0; a < 3; a++) {
                around.box_min[a] = middle[a] - far_away;
                around.box_max[a] = middle[a] + far_away;
            }
            d.geometry = &around;
            d.geometry_count = 1;
            CHECK(draw(&d, t, materials_picture[0]));
            for (i = 0; i < SIDE * SIDE; i++) {
                const voxrt_finish *in[4] = {NULL, NULL, NULL, NULL};
                double o[3], u[3], l = 0, n[3], weight[3] = {1, 1, 1}, sum[3] = {0, 0, 0}, most = 0;
                const body *met;
                voxrt_ray r;
                CHECK(voxrt_camera_ray(&d.camera, SIDE, SIDE, (double)(i % SIDE) + 0.5, (double)(i / SIDE) + 0.5, &r) == VOXRT_OK);
                for (a = 0; a < 3; a++) {
                    o[a] = (double)r.org[a];
                    u[a] = (double)r.dir[a];
                    l += u[a] * u[a];
                }
                for (a = 0; a < 3; a++) u[a] /= sqrt(l);
                if (exact_hit(b, count, o, u, n, &met) >= 1e30) continue;
                if (k == 1 || k == 8) in[0] = &f[0];
                exact_ray(b, count, o, u, in, 0, weight, sum);
                for (a = 0; a < 3; a++) most = fmax(most, fabs(sum[a] - (double)materials_picture[0][i][a]));
                off += most;
                wrong += most > 0.05;
                seen++;
            }
            if (test_g.verbose)
                printf("%-24s planes %u: %5u pixels, off by %.4f, %5.2f %% by more than 0.05\n", cases[k].name, planes, seen, off / seen,
                       100.0 * wrong / seen);
            CHECK_MSG(seen > 2000 && off / seen < cases[k].most, "%s: off by %.4f", cases[k].name, off / seen);
            voxrt_tree_destroy(t);
        }
    }
}

/* ---- bodies in bodies, lamps and eyes in them ---- */

static void faint(voxrt_finish *f, float red, float green) { /* bends next to nothing, but has an inside */
    glass(f, 1, 1.0001f);
    f->absorption[0] = red;
    f->absorption[1] = green;
}

TEST(absorption_of_bodies_in_bodies) {
    /* places of two walls of each body, and how long the way is in each */
    static const struct { uint32_t wall[4][2]; float way[4]; } cases[] = {
        {{{10, 50}, {24, 34}, {0, 0}, {0, 0}}, {30, 10, 0, 0}},    /* one in the other */
        {{{10, 30}, {20, 40}, {0, 0}, {0, 0}}, {20, 10, 0, 0}},    /* they overlap: the one that was entered last counts */
        {{{10, 20}, {30, 40}, {44, 50}, {0, 0}}, {10, 10, 6, 0}},  /* behind each other */
        {{{10, 50}, {14, 46}, {18, 42}, {0, 0}}, {8, 8, 24, 0}},
        {{{10, 50}, {14, 46}, {18, 42}, {22, 38}}, {8, 8, 24, 0}}, /* more than three: the fourth is not seen */
    };
    uint32_t k, i;
    for (k = 0; k < sizeof cases / sizeof *cases; k++) {
        voxrt_finish f[4];
        voxrt_render_desc d;
        voxrt_tree *t;
        double expect[2] = {0, 0};
        materials_cells.n = 0;
        for (i = 0; i < 4; i++) {
            const float red = 0.01f * (float)(i + 1), green = 0.05f / (float)(i + 1);
            faint(&f[i], red, green);
            expect[0] -= (double)(red * cases[k].way[i]);
            expect[1] -= (double)(green * cases[k].way[i]);
            if (cases[k].wall[i][1] == 0) continue;
            add_wall(cases[k].wall[i][0], 255, 255, 255, (int)i + 1);
            add_wall(cases[k].wall[i][1], 255, 255, 255, (int)i + 1);
        }
        add_wall(2, 255, 255, 255, 0);
        t = materials_make(f, 4);
        look_unlit(&d, 1, 60, 32, 32, 30, 32.01f, 32.01f);
        CHECK(draw(&d, t, materials_picture[0]));
        for (i = 0; i < 2; i++) CHECK_NEAR(materials_picture[0][100][i], exp(expect[i]), 2e-4);
        CHECK_NEAR(materials_picture[0][100][2], 1, 1e-4);
        voxrt_tree_destroy(t);
    }
}

/* An eye in a body sees all through it: what its surface scatters, and what is behind. */
TEST(eye_in_a_body) {
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t;
    size_t i;
    materials_cells.n = 0;
    faint(&f, 0.05f, 0);
    f.transparency[0] = f.transparency[1] = f.transparency[2] = 0.5f;
    add_wall(20, 255, 255, 255, 1);
    add_wall(40, 255, 255, 255, 1);
    for (i = 0; i < materials_cells.n; i++) {
        materials_cells.v[i].has_normal = 1;
        materials_cells.v[i].normal[0] = materials_cells.v[i].x == 20 ? -1.0f : 1.0f;
    }
    t = materials_make(&f, 1);
    look_unlit(&d, 1, 30.5f, 32, 32, 20, 32.01f, 32.01f);
    d.background[0] = d.background[1] = d.background[3] = 1;
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][100][0], exp(-0.05 * 9.5), 1e-4); /* the face of the wall is at x = 21 */
    CHECK_NEAR(materials_picture[0][100][1], 1, 1e-4);
    voxrt_tree_destroy(t);
}

/* Where rays end light gets out of a body, but for bodies that the eye is in: such light may never have come in. Who has
   left the body of the eye is in no such body any more. */
TEST(light_gets_out_at_the_end) {
    static const int wall[4] = {40, 20, 14, 6};
    uint32_t k;
    for (k = 0; k < 2; k++) { /* the last wall is that of another body; of the eye's */
        voxrt_finish f[2];
        voxrt_render_desc d;
        voxrt_tree *t;
        size_t i;
        materials_cells.n = 0;
        glass(&f[0], 1, 1.0001f); /* mirrors next to nothing */
        glass(&f[1], 1, 2);
        if (k == 0) {
            for (i = 0; i < 4; i++) add_wall((uint32_t)wall[i], 255, 255, 255, i < 2 ? 1 : 2);
        } else {
            add_wall(6, 255, 255, 255, 2);
        }
        for (i = 0; i < materials_cells.n; i++) {
            const uint32_t x = materials_cells.v[i].x;
            materials_cells.v[i].has_normal = 1;
            materials_cells.v[i].normal[0] = x == 40 || x == 14 ? 1.0f : x == 20 ? -1.0f : -0.5f;
            if (x == 6) materials_cells.v[i].normal[1] = 0.8660254f; /* mirrors all of it, down */
        }
        add_box(1, 3, 16, 29, 0, 64, 0, 0, 0, 0); /* black: what is mirrored goes there */
        t = materials_make(f, 2);
        look_unlit(&d, 1, 30.5f, 32, 32, 20, 32.01f, 32.01f);
        d.bounces_plus_1 = k == 0 ? 4 : 2;
        for (i = 0; i < 4; i++) d.background[i] = 1;
        CHECK(draw(&d, t, materials_picture[0]));
        CHECK_NEAR(materials_picture[0][100][0], k == 0 ? 8.0 / 9.0 : 0, 1e-3); /* a ninth is mirrored where the second body begins */
        voxrt_tree_destroy(t);
    }
}

TEST(absorption_by_length) {
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t;
    materials_cells.n = 0;
    glass(&f, 1, 1.0000001f); /* next to nothing is mirrored; not 1: it has an inside */
    f.refraction = 1.0001f;
    f.absorption[0] = 0.05f;
    f.absorption[1] = 0.01f;
    add_wall(20, 255, 255, 255, 1);
    add_wall(40, 255, 255, 255, 1);
    add_wall(2, 255, 255, 255, 0);
    t = materials_make(&f, 1);
    look_unlit(&d, 1, 60, 32, 32, 30, 32.01f, 32.01f);
    CHECK(draw(&d, t, materials_picture[0])); /* from x = 41 to x = 21 */
    CHECK_NEAR(materials_picture[0][100][0], exp(-0.05 * 20), 1e-4);
    CHECK_NEAR(materials_picture[0][100][1], exp(-0.01 * 20), 1e-4);
    CHECK_NEAR(materials_picture[0][100][2], 1, 1e-4);
    voxrt_tree_destroy(t);
}

/* ---- shadows and coverage ---- */

TEST(light_goes_through_panes) {
    static const float share[3] = {0.5f, 0.25f, 1};
    const voxrt_light sun = {{0.1f, 1, 0.05f}, 1, {1, 1, 1}, 0};
    const voxrt_material m = {{0, 0, 0}, 1, 0, 0};
    uint32_t panes, a, i;
    for (panes = 0; panes < 4; panes++) { /* 3: the last is opaque */
        voxrt_finish f[2];
        voxrt_render_desc d;
        voxrt_tree *t;
        materials_cells.n = 0;
        glass(&f[0], 1, 0);
        memcpy(f[0].transparency, share, sizeof share);
        mirror(&f[1], 0.5f);
        add_box(0, 64, 4, 5, 0, 64, 255, 255, 255, 0);
        for (i = 0; i < panes; i++) add_box(0, 64, 40 + 8 * i, 41 + 8 * i, 0, 64, 255, 255, 255, i == 2 ? 2 : 1);
        t = materials_make(f, 2);
        look(&d, 32, 30, 32, 32.1f, 4, 32.1f);
        d.camera.fov_y = 20;
        d.lights = &sun;
        d.light_count = 1;
        d.material = &m;
        d.shadows = 1;
        CHECK(draw(&d, t, materials_picture[panes != 0]));
        for (a = 0; a < 3; a++) {
            const double expect = panes == 3 ? 0 : (double)materials_picture[0][777][a] * pow((double)share[a], (double)panes);
            CHECK(materials_picture[0][777][a] > 0.9f);
            CHECK_NEAR(materials_picture[panes != 0][777][a], expect, 1e-5);
        }
        d.bounces_plus_1 = panes + 1; /* as many as there are panes, and one less */
        CHECK(draw(&d, t, materials_picture[1]));
        CHECK((materials_picture[1][777][2] > 0.9f) == (panes != 3));
        d.bounces_plus_1 = panes;
        if (panes > 1) CHECK(draw(&d, t, materials_picture[1]) && materials_picture[1][777][2] == 0.0f);
        d.bounces_plus_1 = 1; /* panes are opaque then */
        CHECK(draw(&d, t, materials_picture[1]));
        CHECK(materials_picture[1][777][0] == (panes == 0 ? materials_picture[0][777][0] : 0.0f));
        voxrt_tree_destroy(t);
    }
}

/* Layers at right angles to y over a part of a floor; up: their normals go up, else down. */
static void add_layers(uint32_t y0, uint32_t y1, int up, int finish) {
    size_t i = materials_cells.n;
    add_box(24, 40, y0, y1, 24, 40, 255, 255, 255, finish);
    for (; i < materials_cells.n; i++) {
        materials_cells.v[i].has_normal = 1;
        materials_cells.v[i].normal[1] = up ? 1.0f : -1.0f;
    }
}

/* Red of a point of a white floor at y = 5 below what the cells are; lamp: where it is, 0: far above. */
static double lit(const voxrt_finish *f, size_t count, float lamp) {
    const voxrt_light sun = {{lamp > 0 ? 32.3f : 0.003f, lamp > 0 ? lamp : 1, lamp > 0 ? 32.2f : 0.002f}, lamp <= 0, {1, 1, 1}, 0};
    const voxrt_material m = {{0, 0, 0}, 1, 0, 0};
    voxrt_render_desc d;
    voxrt_tree *t;
    add_layers(4, 5, 1, 0);
    t = materials_make(f, count);
    look(&d, 32.4f, 9, 32.3f, 32.45f, 5, 32.35f);
    d.camera.fov_y = 1;
    d.lights = &sun;
    d.light_count = 1;
    d.material = &m;
    d.shadows = 1;
    CHECK(draw(&d, t, materials_picture[0]));
    voxrt_tree_destroy(t);
    return (double)materials_picture[0][SIDE * SIDE / 2][0];
}

TEST(light_goes_through_bodies) {
    voxrt_finish f[3];
    uint32_t i;
    double v;
    glass(&f[0], 0.5f, 0); /* panes, seen from behind: there is no body for their absorption */
    f[0].absorption[0] = 0.1f;
    for (i = 1; i < 3; i++) {
        materials_cells.n = 0;
        add_layers(30, 31, 1, 1);
        if (i == 2) add_layers(40, 41, 1, 1);
        CHECK_NEAR(lit(f, 1, 0), i == 2 ? 0.25 : 0.5, 1e-4);
    }
    faint(&f[0], 0.05f, 0);
    materials_cells.n = 0;
    add_layers(20, 21, 0, 1);
    add_layers(40, 41, 1, 1);
    CHECK_NEAR(lit(f, 1, 0), exp(-0.05 * 20), 1e-3);
    CHECK_NEAR(lit(f, 1, 60), exp(-0.05 * 20), 1e-3);
    CHECK_NEAR(lit(f, 1, 30.5f), exp(-0.05 * 10.5), 1e-3); /* the lamp is in it */
    CHECK_NEAR(lit(f, 1, 21), exp(-0.05 * 1), 1e-3);       /* and just behind its surface */
    materials_cells.n = 0;
    add_layers(12, 13, 0, 1);
    add_layers(52, 53, 1, 1);
    add_layers(22, 23, 0, 2);
    add_layers(32, 33, 1, 2);
    faint(&f[0], 0.02f, 0);
    faint(&f[1], 0.1f, 0);
    CHECK_NEAR(lit(f, 2, 0), exp(-0.02 * 30 - 0.1 * 10), 1e-3);
    CHECK_NEAR(lit(f, 2, 27), exp(-0.02 * 10 - 0.1 * 5), 1e-3);
    materials_cells.n = 0; /* the floor is in the body */
    add_layers(50, 51, 1, 1);
    v = lit(f, 1, 0);
    CHECK(v > exp(-0.02 * 45) - 1e-6 && v < exp(-0.02 * 43) + 1e-6); /* but for what is near the floor */
    materials_cells.n = 0; /* hulls of three voxels: rays pass some of them, behind each surface */
    glass(&f[0], 0.9f, 1.5f);
    for (i = 0; i < 3; i++) {
        add_layers(12 + 14 * i, 15 + 14 * i, 0, 1);
        add_layers(20 + 14 * i, 23 + 14 * i, 1, 1);
    }
    CHECK_NEAR(lit(f, 1, 0), pow(0.9, 6), 1e-4);
}

/* Surfaces of the caller's without a thickness: rays go on from them, not to them again. */
typedef struct plane { voxrt_finish f; float y; } plane;

static void plane_trace(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, voxrt_surface *surfaces, size_t count) {
    const plane *p = (const plane *)user;
    size_t i;
    (void)desc;
    for (i = 0; i < count; i++) {
        const float t = (p->y - rays[i].org[1]) / rays[i].dir[1];
        if (!(t > rays[i].t_min && t < rays[i].t_max)) continue;
        surfaces[i].t = t;
        surfaces[i].normal[1] = 1;
        surfaces[i].rgb[0] = surfaces[i].rgb[1] = surfaces[i].rgb[2] = 255;
        surfaces[i].face = 6;
        surfaces[i].finish = &p->f;
    }
}
static void plane_occluded(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, uint8_t *occluded, size_t count) {
    voxrt_surface s[64];
    size_t i;
    for (i = 0; i < count; i++) s[i].t = INFINITY;
    plane_trace(user, desc, rays, s, count);
    for (i = 0; i < count; i++) occluded[i] = s[i].t < INFINITY;
}

TEST(surfaces_without_thickness) {
    plane p;
    voxrt_geometry g;
    voxrt_render_desc d;
    voxrt_light sun = {{0.1f, 1, 0.2f}, 1, {1, 1, 1}, 0};
    voxrt_material m = {{0, 0, 0}, 1, 0, 0};
    voxrt_tree *t;
    uint32_t i, k, wrong;
    memset(&g, 0, sizeof g);
    g.trace_fn = plane_trace;
    g.occluded_fn = plane_occluded;
    g.user = &p;
    g.glass = 1;
    for (k = 0; k < 3; k++) {
        for (i = 0; i < 3; i++) {
            g.box_min[i] = i == 1 ? 0 : -1e4;
            g.box_max[i] = i == 1 ? 0 : 1e4;
        }
        p.y = k == 2 ? 733.1f : 0;
        if (k == 0) mirror(&p.f, 1);
        else glass(&p.f, 0.5f, 0);
        look_unlit(&d, 40, 0.3f, p.y + 1.7f, 0.2f, 0.9f, p.y, 0.4f);
        if (k == 2) d.camera.eye[0] = -3000;
        d.geometry = &g;
        d.geometry_count = 1;
        for (i = 0; i < 4; i++) d.background[i] = 0.25f;
        CHECK(draw(&d, NULL, materials_picture[0]));
        for (i = wrong = 0; i < SIDE * SIDE; i++) {
            voxrt_ray r;
            CHECK(voxrt_camera_ray(&d.camera, SIDE, SIDE, (double)(i % SIDE) + 0.5, (double)(i / SIDE) + 0.5, &r) == VOXRT_OK);
            wrong += fabsf(materials_picture[0][i][2] - (k == 0 || r.dir[1] >= 0 ? 0.25f : 0.5f + 0.5f * 0.25f)) > 1e-5f;
        }
        CHECK_MSG(wrong == 0, "plane %u: %u pixels", k, wrong);
    }
    p.y = 20; /* its shadow on a floor */
    materials_cells.n = 0;
    add_layers(4, 5, 1, 0);
    t = materials_make(NULL, 0);
    look(&d, 32, 9, 32, 32.05f, 5, 32.05f);
    d.camera.fov_y = 5;
    d.geometry = &g;
    d.geometry_count = 1;
    d.lights = &sun;
    d.light_count = 1;
    d.material = &m;
    CHECK(draw(&d, t, materials_picture[0]));
    d.shadows = 1;
    CHECK(draw(&d, t, materials_picture[1]));
    CHECK(materials_picture[0][99][0] > 0.9f);
    CHECK_NEAR(materials_picture[1][99][0], 0.5 * (double)materials_picture[0][99][0], 1e-6);
    voxrt_tree_destroy(t);
}

TEST(what_is_seen_through_glass_is_background) {
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t;
    materials_cells.n = 0;
    glass(&f, 0.75f, 0);
    add_wall(20, 255, 255, 255, 1);
    t = materials_make(&f, 1);
    look_unlit(&d, 5, 60, 32, 32, 30, 32, 32);
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][5][3], 0.25, 1e-6); /* no background: transparent */
    CHECK_NEAR(materials_picture[0][5][0], 0.25, 1e-6);
    d.background[0] = 1;
    d.background[1] = 0.5f;
    d.background[3] = 1;
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][5][3], 1, 1e-6);
    CHECK_NEAR(materials_picture[0][5][0], 1, 1e-6);
    CHECK_NEAR(materials_picture[0][5][1], 0.25 + 0.75 * 0.5, 1e-6);
    voxrt_tree_destroy(t);
    f.transparency[0] = 0.9f; /* coverage is what colours let through on the average */
    f.transparency[1] = 0.3f;
    t = materials_make(&f, 1);
    memset(d.background, 0, sizeof d.background);
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][5][3], 1 - 1.95 / 3, 1e-6);
    voxrt_tree_destroy(t);
    mirror(&f, 1); /* a mirror is not transparent, whatever it shows */
    t = materials_make(&f, 1);
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK(materials_picture[0][5][3] == 1.0f && materials_picture[0][5][0] == 0.0f);
    voxrt_tree_destroy(t);
}

/* Views that are not shaded and pictures of 2009 send no rays on. */
TEST(where_rays_bounce) {
    const voxrt_material dim = {{0.25f, 0.25f, 0.25f}, 0, 0, 0};
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t, *plain;
    uint32_t k;
    materials_cells.n = 0;
    mirror(&f, 0.5f);
    add_wall(20, 255, 255, 255, 1);
    t = materials_make(&f, 1);
    plain = materials_make(NULL, 0);
    look_unlit(&d, 20, 60, 32, 32, 30, 32, 32);
    d.material = &dim;
    for (k = 0; k < 4; k++) d.background[k] = 1;
    d.view = VOXRT_VIEW_SPLIT;
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][SIDE * SIDE / 2 + 5][0], 1, 1e-6);                 /* colours */
    CHECK_NEAR(materials_picture[0][SIDE * SIDE / 2 + SIDE / 2][0], 0.5 * 0.25 + 0.5, 1e-6); /* shaded: half is mirrored */
    CHECK_NEAR(materials_picture[0][SIDE * SIDE / 2 + SIDE - 5][0], 0.25, 1e-6);       /* brightness */
    d.view = VOXRT_VIEW_SHADED;
    d.thesis_compose = 1;
    CHECK(draw(&d, t, materials_picture[0]) && draw(&d, plain, materials_picture[1]));
    CHECK(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) == 0);
    d.thesis_compose = 0;
    d.stage = VOXRT_STAGE_TRACE;
    CHECK(draw(&d, t, materials_picture[0]) && draw(&d, plain, materials_picture[1]));
    CHECK(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) == 0);
    voxrt_tree_destroy(plain);
    voxrt_tree_destroy(t);
    f.diffuse = 0.5f;
    t = materials_make(&f, 1);
    d.stage = VOXRT_STAGE_FULL;
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][SIDE * SIDE / 2 + SIDE / 2][0], 0.5 * 0.5 * 0.25 + 0.5, 1e-6);
    voxrt_tree_destroy(t);
}

static void paint_green(void *user, const voxrt_ray *rays, const voxrt_surface *surfaces, const float (*normals)[3], float (*colors)[4], size_t count) {
    size_t i;
    (void)user;
    (void)rays;
    for (i = 0; i < count; i++) {
        if (!(surfaces[i].t < INFINITY) || surfaces[i].finish != NULL) continue;
        CHECK_NEAR(normals[i][0], -1, 1e-6);
        colors[i][0] = colors[i][2] = 0;
        colors[i][1] = 0.75f;
    }
}

TEST(steps_of_the_caller_see_bounces) {
    voxrt_states own;
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_tree *t;
    materials_cells.n = 0;
    mirror(&f, 0.5f);
    add_wall(10, 0, 0, 0, 1);
    add_wall(50, 255, 255, 255, 0);
    t = materials_make(&f, 1);
    look_unlit(&d, 1, 30, 32, 32, 10, 32.01f, 32.02f);
    memset(&own, 0, sizeof own);
    own.shade_fn = paint_green;
    d.states = &own;
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK_NEAR(materials_picture[0][99][0], 0, 1e-6);
    CHECK_NEAR(materials_picture[0][99][1], 0.5 * 0.75, 1e-6);
    voxrt_tree_destroy(t);
}

/* Rays that graze a ridge, where the normal of a voxel faces away from them. */
TEST(ridges) {
    uint32_t k, j, n, kind;
    voxrti_render c;
    voxrt_render_desc d;
    memset(&c, 0, sizeof c);
    memset(&d, 0, sizeof d);
    c.d = &d;
    c.bounces = 8;
    for (kind = 0; kind < 2; kind++) {
        for (k = 0; k <= 20; k++) {
            voxrt_finish f;
            voxrt_surface met;
            voxrt_ray ray;
            voxrti_path from, out[2];
            double sum = 0;
            const float along = 0.01f * (float)k; /* of the ray and the normal */
            if (kind == 0) mirror(&f, 1);
            else glass(&f, 1, 1.5f);
            memset(&met, 0, sizeof met);
            memset(&from, 0, sizeof from);
            memset(&ray, 0, sizeof ray);
            from.weight[0] = from.weight[1] = from.weight[2] = 1;
            met.t = 1;
            met.edge = 0.01f;
            met.normal[1] = 1;
            met.finish = &f;
            ray.dir[0] = sqrtf(1 - along * along);
            ray.dir[1] = along;
            n = voxrti_path_split(&c, &ray, &met, &from, VOXRTI_FRONT, out);
            CHECK(n >= 1);
            for (j = 0; j < n; j++) {
                const float *v = out[j].dir;
                CHECK_NEAR(v[0] * v[0] + v[1] * v[1] + v[2] * v[2], 1, 1e-5);
                CHECK(out[j].t_min > 1 && out[j].t_min < 1.1f);
                if (out[j].body[0] == NULL) CHECK_MSG(v[1] >= along - 1e-3f, "%u: goes into the ridge: %g", k, (double)v[1]);
                sum += (double)out[j].weight[0];
            }
            CHECK_NEAR(sum, 1, 2.1e-3);
        }
    }
}

/* Coefficients of an entry do what those of the picture do. */
TEST(phong_of_an_entry) {
    voxrt_finish f;
    voxrt_render_desc d;
    voxrt_material m;
    voxrt_tree *shiny, *plain;
    memset(&f, 0, sizeof f);
    memset(&m, 0, sizeof m);
    f.diffuse = 1;
    f.specular[0] = f.specular[1] = f.specular[2] = 0.5f;
    f.shininess = 20;
    shiny = make_mesh(64, 0, &f, 1, 1, NULL);
    plain = make_mesh(64, 0, NULL, 0, 0, NULL);
    REQUIRE(shiny != NULL && plain != NULL);
    look(&d, 1.5f, 1.7f, 3.5f, 1, 1.1f, 1);
    d.camera.fov_y = 12; /* nothing but the ball */
    d.shadows = 1;
    CHECK(draw(&d, shiny, materials_picture[0]));
    m.ambient[0] = m.ambient[1] = m.ambient[2] = 0.05f;
    m.diffuse = 1;
    m.specular = 0.5f;
    m.shininess = 20;
    d.material = &m;
    CHECK(draw(&d, plain, materials_picture[1]));
    CHECK(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) == 0);
    m.shininess = 21;
    CHECK(draw(&d, plain, materials_picture[1]));
    CHECK(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) != 0);
    voxrt_tree_destroy(shiny);
    voxrt_tree_destroy(plain);
}

/* ---- the same picture in all ways ---- */

TEST(same_bits_in_all_ways) {
    voxrt_finish f[2];
    voxrt_tree *t, *shared = NULL;
    voxrt_render_desc d;
    voxrt_instance instance;
    voxrt_geometry g[3], at;
    voxrt_group *group = NULL;
    voxrt_render_stats stats;
    voxrt_image image;
    uint32_t k, i;
    mirror(&f[0], 0.6f);
    glass(&f[1], 0.9f, 1.5f);
    t = make_mesh(100, 1, f, 2, 2, NULL);
    REQUIRE(t != NULL);
    look(&d, 1.3f, 2.2f, 4.0f, 1, 0.8f, 1);
    d.shadows = 1;
    d.tolerance = 0.5f;
    d.env.thread_count = 1;
    d.isa = VOXRT_ISA_SCALAR;
    CHECK(draw(&d, t, materials_picture[0]));
    CHECK(voxrt_tree_share(t, NULL, &shared) == VOXRT_OK);
    for (k = 0; k < 8; k++) {
        d.isa = (voxrt_isa)(k % 4);
        d.env.thread_count = k < 4 ? 1 : 3;
        CHECK(draw(&d, k & 1 ? shared : t, materials_picture[1]));
        CHECK_MSG(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) == 0, "way %u", k);
    }
    memset(&stats, 0, sizeof stats);
    memset(&image, 0, sizeof image);
    image.width = image.height = SIDE;
    image.rgba = materials_picture[1][0];
    CHECK(voxrt_render(&d, t, &image, &stats) == VOXRT_OK && stats.bounce.rays > 1000 && stats.bounce.hits < stats.bounce.rays);
    CHECK(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) == 0);
    voxrt_tree_geometry(t, &g[0]);
    CHECK(g[0].glass == 1);
    d.geometry = g;
    d.geometry_count = 1;
    CHECK(draw(&d, NULL, materials_picture[1]));
    CHECK(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) == 0);
    memset(&instance, 0, sizeof instance); /* where it was: also in a group */
    instance.geometry = g[0];
    instance.to_world[0] = instance.to_world[5] = instance.to_world[10] = 1;
    CHECK(voxrt_instance_geometry(&instance, &g[1]) == VOXRT_OK && g[1].glass == 1);
    CHECK(voxrt_group_create(NULL, g + 1, 1, &group) == VOXRT_OK);
    voxrt_group_geometry(group, &at);
    CHECK(at.glass == 1);
    d.geometry = &at;
    CHECK(draw(&d, NULL, materials_picture[1]));
    for (i = k = 0; i < SIDE * SIDE; i++) k += fabsf(materials_picture[0][i][0] - materials_picture[1][i][0]) > 1e-3f; /* normals were rounded once more */
    CHECK_MSG(k < 20, "%u pixels differ", k);
    voxrt_group_destroy(group);
    voxrt_tree_destroy(shared);
    voxrt_tree_destroy(t);
}

/* ---- what is kept ---- */

/* Finish of what a ray meets; level: cells of that level. */
static const voxrt_finish *finish_at(const voxrt_geometry *g, uint32_t level, float x, float y, float z) {
    voxrt_trace_desc td;
    voxrt_surface s;
    voxrt_ray ray;
    memset(&td, 0, sizeof td);
    memset(&ray, 0, sizeof ray);
    memset(&s, 0, sizeof s);
    td.max_level_plus_1 = level + 1;
    ray.org[0] = x;
    ray.org[1] = y;
    ray.org[2] = z - 100;
    ray.dir[2] = 1;
    ray.t_max = INFINITY;
    s.t = INFINITY;
    g->trace_fn(g->user, &td, &ray, &s, 1);
    CHECK(s.t < INFINITY);
    return s.finish;
}

TEST(coarser_cells_have_what_most_voxels_have) {
    voxrt_finish f[2];
    voxrt_tree *t;
    voxrt_ray ray;
    voxrt_hit hit;
    voxrt_trace_desc td;
    uint32_t lod;
    for (lod = 0; lod < 2; lod++) {
        voxrt_build_desc d;
        mirror(&f[0], 1);
        mirror(&f[1], 0.5f);
        materials_cells.n = 0;
        add_box(0, 2, 0, 2, 0, 1, 9, 9, 9, 2); /* of eight: four, three, one */
        add_box(0, 2, 0, 1, 1, 2, 9, 9, 9, 1);
        materials_add(0, 1, 1, 9, 9, 9, 1);
        materials_add(1, 1, 1, 9, 9, 9, 0);
        add_box(8, 10, 8, 10, 8, 10, 9, 9, 9, 0);
        add_box(32, 34, 0, 2, 0, 1, 9, 9, 9, 2); /* four each: the lower number */
        add_box(32, 34, 0, 2, 1, 2, 9, 9, 9, 1);
        add_box(48, 50, 0, 2, 0, 2, 9, 9, 9, 2); /* eight in one octant, and one in each of two */
        materials_add(50, 0, 0, 9, 9, 9, 1);
        materials_add(50, 2, 0, 9, 9, 9, 1);
        memset(&d, 0, sizeof d);
        d.finishes = f;
        d.finish_count = 2;
        d.voxel_finish = materials_cells.finish;
        d.lod_method = lod ? VOXRT_LOD_MAJORITY : VOXRT_LOD_MEAN;
        CHECK(voxrt_tree_from_voxels(&d, materials_cells.v, materials_cells.n, 6, &t) == VOXRT_OK);
        memset(&td, 0, sizeof td);
        memset(&ray, 0, sizeof ray);
        ray.org[0] = 0.5f;
        ray.org[1] = 0.5f;
        ray.org[2] = -5;
        ray.dir[2] = 1;
        ray.t_max = INFINITY;
        td.max_level_plus_1 = 6; /* cells of two voxels */
        CHECK(voxrt_trace(t, &td, &ray, &hit, 1) == VOXRT_OK && hit.level == 5);
        CHECK(voxrt_hit_finish(t, &hit) != NULL && voxrt_hit_finish(t, &hit)->mirror[0] == 0.5f);
        ray.org[0] = 32.5f;
        CHECK(voxrt_trace(t, &td, &ray, &hit, 1) == VOXRT_OK && hit.level == 5 && (lod == 1 || voxrt_hit_finish(t, &hit)->mirror[0] == 1.0f));
        ray.org[0] = 48.5f;
        td.max_level_plus_1 = 5;
        CHECK(voxrt_trace(t, &td, &ray, &hit, 1) == VOXRT_OK && hit.level == 4 && (lod == 1 || voxrt_hit_finish(t, &hit)->mirror[0] == 0.5f));
        ray.org[0] = 0.5f;
        td.max_level_plus_1 = 0;
        ray.org[1] = 1.5f;
        ray.org[2] = 1.01f;
        CHECK(voxrt_trace(t, &td, &ray, &hit, 1) == VOXRT_OK && voxrt_hit_finish(t, &hit)->mirror[0] == 1.0f);
        ray.org[0] = 1.5f;
        CHECK(voxrt_trace(t, &td, &ray, &hit, 1) == VOXRT_OK && hit.t < 10 && voxrt_hit_finish(t, &hit) == NULL);
        voxrt_tree_destroy(t);
    }
}

/* Two halves of a wall meet in the voxels 5 along x, a quarter of which is the right one's. */
TEST(voxels_have_the_finish_of_the_largest_part) {
    static const float corner[8][3] = {{1, 1, 4.5f}, {5.75f, 1, 4.5f}, {5.75f, 9, 4.5f}, {1, 9, 4.5f},
                                       {5.75f, 1, 4.5f}, {9, 1, 4.5f}, {9, 9, 4.5f}, {5.75f, 9, 4.5f}};
    static const uint32_t triangle[4][3] = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}};
    uint32_t k, y;
    for (k = 0; k < 4; k++) { /* numbers and triangles in either order */
        voxrt_finish f[2];
        voxrt_build_desc d;
        voxrt_mesh m;
        voxrt_tree *t = NULL;
        voxrt_geometry g;
        uint32_t index[4][3];
        const uint8_t left = k & 1 ? 2 : 1, right = k & 1 ? 1 : 2, one = k & 2 ? right : left, two = k & 2 ? left : right;
        const uint8_t of[4] = {one, one, two, two};
        memset(&d, 0, sizeof d);
        memset(&m, 0, sizeof m);
        memcpy(index, k & 2 ? triangle[2] : triangle[0], sizeof *triangle * 2);
        memcpy(index[2], k & 2 ? triangle[0] : triangle[2], sizeof *triangle * 2);
        mirror(&f[0], 0.25f);
        mirror(&f[1], 0.5f);
        d.resolution = 16;
        d.box_size = 16;
        d.separating = VOXRT_SEPARATING_26;
        d.finishes = f;
        d.finish_count = 2;
        m.positions = corner[0];
        m.vertex_count = 8;
        m.indices = index[0];
        m.triangle_count = 4;
        m.triangle_finish = of;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
        voxrt_tree_geometry(t, &g);
        for (y = 2; y < 8; y++) {
            CHECK(finish_at(&g, 4, 4.5f, (float)y + 0.5f, 0)->mirror[0] == f[left - 1].mirror[0]);
            CHECK(finish_at(&g, 4, 5.5f, (float)y + 0.5f, 0)->mirror[0] == f[left - 1].mirror[0]);
            CHECK(finish_at(&g, 4, 6.5f, (float)y + 0.5f, 0)->mirror[0] == f[right - 1].mirror[0]);
        }
        voxrt_tree_destroy(t);
    }
}

/* Finishes that nothing has are left out; entries are pairs of a colour and a finish. */
TEST(entries_are_pairs) {
    voxrt_finish f[3];
    voxrt_tree *t, *u;
    voxrt_tree_info info, plain;
    const uint8_t *palette;
    uint32_t i, n, seen = 0;
    for (i = 0; i < 3; i++) mirror(&f[i], 0.25f * (float)(i + 1));
    materials_cells.n = 0;
    for (i = 0; i < 64; i++) materials_add(i, i, i, i & 1 ? 200 : 10, 5, 5, i % 4 == 0 ? 3 : i % 4 == 1 ? 1 : 0);
    t = materials_make(f, 3);
    u = materials_make(NULL, 0);
    voxrt_tree_get_info(t, &info);
    voxrt_tree_get_info(u, &plain);
    CHECK_EQ_U64(info.finish_count, 2);
    CHECK_EQ_U64(plain.finish_count, 0);
    CHECK(voxrt_tree_hash(t) != voxrt_tree_hash(u));
    palette = voxrt_tree_palette(t, &n);
    for (i = 0; i < n; i++) {
        const voxrt_finish *e = voxrt_tree_finish(t, i);
        if (e != NULL) seen |= e->mirror[0] == 0.25f ? 1u : e->mirror[0] == 0.75f ? 2u : 8u;
        if (e != NULL && e->mirror[0] == 0.75f && palette[3 * i] == 10) seen |= 4;
    }
    CHECK_EQ_U64(seen, 7);
    CHECK(voxrt_tree_finish(t, n) == NULL && voxrt_tree_finish(NULL, 0) == NULL && voxrt_tree_finish(u, 0) == NULL);
    voxrt_tree_destroy(u);
    memset(materials_cells.finish, 0, sizeof materials_cells.finish); /* none is used: as if there were none */
    u = materials_make(f, 3);
    voxrt_tree_get_info(u, &info);
    CHECK(info.finish_count == 0 && info.total_bytes == plain.total_bytes && info.palette_count == plain.palette_count);
    voxrt_tree_destroy(u);
    voxrt_tree_destroy(t);
}

/* Finishes without colours; of a cell given twice the highest number counts; hashes know which entry has which. */
TEST(numbers_of_finishes) {
    voxrt_finish f[3];
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    voxrt_voxel v;
    voxrt_ray ray;
    voxrt_hit hit;
    uint64_t hash[3];
    uint32_t i, k;
    static const uint8_t order[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    for (i = 0; i < 3; i++) mirror(&f[i], 0.25f * (float)(i + 1));
    for (i = 0; i < 6; i++) {
        memset(&d, 0, sizeof d);
        d.finishes = f;
        d.finish_count = 3;
        d.voxel_finish = materials_cells.finish;
        d.disable_colors = i & 1;
        materials_cells.n = 0;
        for (k = 0; k < 3; k++) materials_add(7, 8, 9, 10, 20, 30, order[i][k]);
        materials_add(3, 3, 3, 1, 2, 3, 3);
        CHECK(voxrt_tree_from_voxels(&d, materials_cells.v, materials_cells.n, 6, &t) == VOXRT_OK);
        memset(&ray, 0, sizeof ray);
        ray.org[0] = 7.5f;
        ray.org[1] = 8.5f;
        ray.dir[2] = 1;
        ray.t_max = INFINITY;
        CHECK(voxrt_trace(t, NULL, &ray, &hit, 1) == VOXRT_OK && voxrt_hit_finish(t, &hit) != NULL && voxrt_hit_finish(t, &hit)->mirror[0] == 0.5f);
        CHECK(voxrt_tree_get(t, 6, 7, 8, 9, &v) && v.rgb[0] == (i & 1 ? 255 : 10) && v.rgb[2] == (i & 1 ? 255 : 30));
        voxrt_tree_destroy(t);
    }
    for (i = 0; i < 3; i++) {
        materials_cells.n = 0;
        materials_add(1, 1, 1, 10, 10, 10, i == 1 ? 2 : 1);
        materials_add(2, 2, 2, 20, 20, 20, i == 1 ? 1 : 2);
        if (i == 2) mirror(&f[1], 0.6f);
        t = materials_make(f, 2);
        hash[i] = voxrt_tree_hash(t);
        voxrt_tree_destroy(t);
    }
    CHECK(hash[0] != hash[1] && hash[0] != hash[2] && hash[1] != hash[2]);
    for (i = 0; i < 2; i++) { /* the same palette and finishes */
        materials_cells.n = 0;
        for (k = 1; k < 4; k++) materials_add(k, k, k, 10 * (int)k, 10, 10, k == 3 || (k == 2 && i == 1));
        t = materials_make(f, 1);
        hash[i] = voxrt_tree_hash(t);
        voxrt_tree_destroy(t);
    }
    CHECK(hash[0] != hash[1]);
}

TEST(bad_descs) {
    voxrt_build_desc d;
    voxrt_finish f, bad[256];
    voxrt_error error;
    voxrt_tree *t;
    voxrt_mesh m;
    uint32_t k;
    static const float corner[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    uint8_t of = 2;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    mirror(&f, 1);
    m.positions = corner;
    m.vertex_count = 3;
    m.triangle_count = 1;
    m.triangle_finish = &of;
    d.env.error = &error;
    d.finishes = &f;
    d.finish_count = 1;
    CHECK(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_ERR_INVALID_ARG && t == NULL && error.text[0] != 0);
    of = 1;
    for (k = 0; k < VOXRTI_FINISH_FLOATS + 5; k++) {
        float v[VOXRTI_FINISH_FLOATS];
        mirror(&bad[0], 1);
        memcpy(v, &bad[0], sizeof v);
        if (k < VOXRTI_FINISH_FLOATS) v[k] = k % 3 == 0 ? NAN : k % 3 == 1 ? -1e-3f : INFINITY;
        else v[k == 18 ? 0 : k == 19 ? 5 : k == 20 ? 8 : 11] = k == 21 ? 17.0f : k == 22 ? 0.01f : 1.001f;
        memcpy(&bad[0], v, sizeof v);
        d.finishes = bad;
        CHECK_MSG(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_ERR_INVALID_ARG && t == NULL, "number %u", k);
    }
    d.finish_count = 256;
    CHECK(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_ERR_RANGE);
    d.finishes = NULL;
    d.finish_count = 1;
    CHECK(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_ERR_INVALID_ARG);
    d.finishes = &f;
    CHECK(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
    voxrt_tree_destroy(t);
}

/* 64-byte aligned, for mapping. */
static void *aligned_block(size_t size) {
    void *p = NULL;
    return posix_memalign(&p, 64, size + 64) == 0 ? p : NULL;
}
static void free_block(void *p) { free(p); }

static uint8_t *materials_save(const voxrt_tree *t, voxrt_encoding encoding, size_t *size) {
    voxrt_save_desc d;
    uint8_t *p;
    memset(&d, 0, sizeof d);
    d.encoding = encoding;
    if (voxrt_tree_save_memory(t, &d, NULL, 0, size) != VOXRT_OK) return NULL;
    p = (uint8_t *)aligned_block(*size);
    if (p != NULL && voxrt_tree_save_memory(t, &d, p, *size, size) != VOXRT_OK) *size = 0;
    return p;
}

static voxrt_tree *small_scene(void) {
    voxrt_finish f[2];
    materials_cells.n = 0;
    mirror(&f[0], 0.5f);
    glass(&f[1], 0.5f, 1.5f);
    f[1].absorption[2] = 3;
    add_box(10, 13, 10, 13, 10, 13, 50, 100, 200, 1);
    add_box(30, 33, 10, 13, 10, 13, 50, 100, 200, 2);
    add_box(30, 33, 30, 33, 10, 13, 50, 100, 20, 0);
    return materials_make(f, 2);
}

TEST(files_keep_finishes) {
    voxrt_tree *t = small_scene(), *shared = NULL;
    uint32_t k;
    REQUIRE(t != NULL && voxrt_tree_share(t, NULL, &shared) == VOXRT_OK);
    CHECK(voxrt_tree_hash(t) == voxrt_tree_hash(shared));
    for (k = 0; k < 6; k++) {
        size_t size = 0, again = 0;
        uint8_t *file = materials_save(k & 1 ? shared : t, k < 2 ? VOXRT_ENCODING_COMPACT : VOXRT_ENCODING_RAW, &size), *second;
        voxrt_tree *u = NULL;
        uint32_t i, n;
        REQUIRE(file != NULL);
        CHECK((k < 4 ? voxrt_tree_load_memory(NULL, file, size, &u) : voxrt_tree_map_memory(NULL, file, size, &u)) == VOXRT_OK);
        REQUIRE(u != NULL);
        CHECK(voxrt_tree_hash(u) == voxrt_tree_hash(t));
        (void)voxrt_tree_palette(t, &n);
        for (i = 0; i < n; i++) {
            const voxrt_finish *a = voxrt_tree_finish(t, i), *b = voxrt_tree_finish(u, i);
            CHECK((a == NULL) == (b == NULL) && (a == NULL || memcmp(a, b, sizeof *a) == 0));
        }
        second = materials_save(u, k < 2 ? VOXRT_ENCODING_COMPACT : VOXRT_ENCODING_RAW, &again);
        CHECK(second != NULL && again == size && memcmp(file, second, size) == 0);
        free_block(second);
        voxrt_tree_destroy(u);
        free_block(file);
    }
    voxrt_tree_destroy(shared);
    voxrt_tree_destroy(t);
}

/* Any byte changed, with checksums that fit: what is accepted can be drawn. Files that end early are refused. */
TEST(hostile_files) {
    voxrt_tree *t = small_scene();
    uint32_t raw, accepted = 0;
    REQUIRE(t != NULL);
    for (raw = 0; raw < 2; raw++) {
        size_t size = 0, i, section = 0, length = 0;
        uint8_t *file = materials_save(t, raw ? VOXRT_ENCODING_RAW : VOXRT_ENCODING_COMPACT, &size), *copy;
        REQUIRE(file != NULL);
        for (i = 0; i < voxrti_load_u16(file + 14); i++) {
            const uint8_t *e = file + 64 + 40 * i;
            if (voxrti_load_u32(e) != VOXRTI_V5_FINISHES) continue;
            section = (size_t)voxrti_load_u64(e + 8);
            length = (size_t)voxrti_load_u64(e + 16);
        }
        CHECK(length >= 2 * VOXRTI_V5_FINISH + 3);
        copy = (uint8_t *)aligned_block(size);
        REQUIRE(copy != NULL);
        for (i = 0; i < size; i++) {
            voxrt_tree *u = NULL;
            voxrt_render_desc d;
            uint32_t k;
            if (i >= 64 + 40u * voxrti_load_u16(file + 14) && (i < section || i >= section + length)) continue;
            for (k = 0; k < 3; k++) {
                memcpy(copy, file, size);
                copy[i] = (uint8_t)(k == 0 ? copy[i] ^ 0x80 : k == 1 ? 0xff : copy[i] + 1);
                voxrti_v5_seal(copy, size);
                if (voxrt_tree_load_memory(NULL, copy, size, &u) != VOXRT_OK) continue;
                accepted++;
                look(&d, 60, 32, 50, 31, 12, 12);
                d.shadows = 1;
                d.pixel_step = 8;
                CHECK(draw(&d, u, materials_picture[0]));
                voxrt_tree_destroy(u);
            }
        }
        for (i = 0; i < size; i += 7) {
            voxrt_tree *u = NULL;
            CHECK(voxrt_tree_load_memory(NULL, file, i, &u) != VOXRT_OK && u == NULL);
        }
        copy[0] = 0;
        memcpy(copy, file, size);
        copy[section + length - 1] = 3; /* an entry with a finish that is not there */
        voxrti_v5_seal(copy, size);
        {
            voxrt_tree *u = NULL;
            voxrt_load_desc load;
            voxrt_error error;
            memset(&load, 0, sizeof load);
            load.env.error = &error;
            CHECK(voxrt_tree_load_memory(NULL, copy, size, &u) == VOXRT_ERR_FORMAT);
            memcpy(copy, file, size);
            memset(copy + section + VOXRTI_V5_FINISH, 255, 4); /* the second one is bad */
            voxrti_v5_seal(copy, size);
            CHECK(voxrt_tree_load_memory(NULL, copy, size, &u) == VOXRT_ERR_FORMAT);
            memcpy(copy, file, size);
            memset(copy + section + VOXRTI_V5_FINISH, 0, length - VOXRTI_V5_FINISH); /* one, all is plain, but a byte is missing */
            for (i = 0; i < voxrti_load_u16(file + 14); i++) {
                uint8_t *e = copy + 64 + 40 * i;
                if (voxrti_load_u32(e) != VOXRTI_V5_FINISHES) continue;
                CHECK(voxrti_load_u64(e + 16) == length && voxrti_load_u64(e + 24) == length);
                voxrti_store_u64(e + 16, length - 1);
                voxrti_store_u64(e + 24, length - 1);
            }
            CHECK(section + length == size && voxrti_load_u64(copy + 16) == size);
            voxrti_store_u64(copy + 16, size - 1);
            voxrti_v5_seal(copy, size - 1);
            memset(&error, 0, sizeof error);
            CHECK(voxrt_tree_load_memory(&load, copy, size - 1, &u) == VOXRT_ERR_FORMAT);
            CHECK_MSG(error.where == section && strstr(error.text, "has a wrong size") != NULL, "%s", error.text);
        }
        free_block(copy);
        free_block(file);
    }
    CHECK_MSG(accepted > 50, "%u files were accepted", accepted);
    voxrt_tree_destroy(t);
}

/* ---- models ---- */

/* A model of a ball of glass, a mirror and a floor that go through many blocks: pictures and trees are those of the tree
   it was made from. Edits make plain voxels; what is painted keeps its finish. */
TEST(models_keep_finishes) {
    voxrt_finish f[3];
    voxrt_tree *t, *u = NULL;
    voxrt_model *m = NULL, *copy = NULL;
    voxrt_geometry g;
    voxrt_render_desc d;
    voxrt_edit_desc e;
    voxrt_build_desc b;
    voxrt_tree_info info;
    const double lo[3] = {0, 0, 0}, hi[3] = {2, 2, 2}, from[3] = {0.9, 0.2, 0}, to[3] = {1.1, 0.5, 2};
    uint32_t number, level, x, y, different, kinds;
    mirror(&f[0], 0.6f);
    glass(&f[1], 0.9f, 1.5f);
    mirror(&f[2], 0.25f);
    for (number = 1; number < 3; number++) {
        t = make_mesh(200, 0, f, 3, (int)number, NULL);
        REQUIRE(t != NULL && voxrt_model_from_tree(NULL, t, &m) == VOXRT_OK && voxrt_model_copy(NULL, m, &copy) == VOXRT_OK);
        CHECK(voxrt_tree_from_model(NULL, copy, &u) == VOXRT_OK && voxrt_tree_hash(u) == voxrt_tree_hash(t));
        voxrt_tree_destroy(u);
        look(&d, 1.3f, 2.2f, 4.0f, 1, 0.8f, 1);
        d.shadows = 1;
        CHECK(draw(&d, t, materials_picture[0]));
        voxrt_model_geometry(copy, &g);
        voxrt_model_destroy(m); /* what it shared stays */
        CHECK(g.glass == (number == 2));
        d.geometry = &g;
        d.geometry_count = 1;
        CHECK(draw(&d, NULL, materials_picture[1]));
        CHECK(memcmp(materials_picture[0], materials_picture[1], sizeof materials_picture[0]) == 0);
        for (level = 0; level <= 8; level++) { /* also of cells larger than blocks */
            voxrt_geometry whole;
            voxrt_tree_geometry(t, &whole);
            for (y = different = kinds = 0; y < 20; y++) {
                for (x = 0; x < 20; x++) {
                    const float px = 0.6f + 0.04f * (float)x, py = 0.22f + 0.06f * (float)y, off = (px - 1) * (px - 1) + (py - 1) * (py - 1);
                    const voxrt_finish *one, *other;
                    if (off > 0.24f && py > 0.28f) continue;
                    one = finish_at(&whole, level, px, py, 0);
                    other = finish_at(&g, level, px, py, 0);
                    different += (one == NULL) != (other == NULL) || (one != NULL && memcmp(one, other, sizeof *one) != 0);
                    kinds |= one == NULL ? 1u : 2u;
                }
            }
            CHECK_MSG(different == 0, "level %u: %u finishes differ", level, different);
            CHECK(level < 6 || kinds == 3);
        }
        memset(&e, 0, sizeof e);
        e.op = VOXRT_EDIT_PAINT;
        e.rgb[0] = 200;
        CHECK(voxrt_model_box(copy, &e, lo, hi, NULL) == VOXRT_OK);
        voxrt_model_geometry(copy, &g);
        CHECK(finish_at(&g, 8, 1, 1, 0) != NULL && finish_at(&g, 8, 1, 1, 0)->mirror[0] == f[number - 1].mirror[0]);
        CHECK(finish_at(&g, 8, 1, 0.25f, 0) == NULL);
        e.op = VOXRT_EDIT_SET;
        CHECK(voxrt_model_box(copy, &e, from, to, NULL) == VOXRT_OK);
        voxrt_model_geometry(copy, &g);
        CHECK(finish_at(&g, 8, 1, 1, 0) != NULL && finish_at(&g, 8, 1, 0.49f, 0) == NULL);
        memset(&b, 0, sizeof b);
        b.disable_colors = 1;
        CHECK(voxrt_tree_from_model(&b, copy, &u) == VOXRT_OK);
        voxrt_tree_get_info(u, &info);
        CHECK(info.finish_count == 1 && info.palette_count == 2);
        voxrt_tree_destroy(u);
        e.op = VOXRT_EDIT_CLEAR;
        CHECK(voxrt_model_sphere(copy, &e, hi, 9, NULL) == VOXRT_OK);
        CHECK(voxrt_tree_from_model(NULL, copy, &u) == VOXRT_ERR_EMPTY);
        voxrt_model_destroy(copy);
        voxrt_tree_destroy(t);
    }
}

/* Edits give finishes: to boxes, balls, triangles and lists, filled or painted; copies from before know nothing of it. */
TEST(edits_give_finishes) {
    static const float corner[3][3] = {{10, 10, 150.5f}, {60, 10, 150.5f}, {10, 60, 150.5f}};
    static const uint32_t triangle[3] = {0, 1, 2};
    voxrt_model_desc md;
    voxrt_edit_desc e;
    voxrt_finish f[2], many;
    voxrt_model *m = NULL, *copy = NULL;
    voxrt_geometry g;
    voxrt_tree *t = NULL;
    voxrt_tree_info info;
    voxrt_mesh mesh;
    voxrt_voxel v;
    const double lo[3] = {0, 0, 0}, hi[3] = {100, 100, 10}, mid[3] = {50, 50, 10}, all[3] = {256, 256, 256};
    uint32_t i, level;
    mirror(&f[0], 0.75f);
    mirror(&f[1], 0.25f);
    memset(&md, 0, sizeof md);
    md.depth = 8;
    REQUIRE(voxrt_model_create(&md, &m) == VOXRT_OK);
    memset(&e, 0, sizeof e);
    e.rgb[1] = 99;
    e.finish = &f[0];
    CHECK(voxrt_model_box(m, &e, lo, hi, NULL) == VOXRT_OK);
    REQUIRE(voxrt_model_copy(NULL, m, &copy) == VOXRT_OK);
    e.op = VOXRT_EDIT_PAINT;
    e.finish = &f[1];
    CHECK(voxrt_model_sphere(m, &e, mid, 20, NULL) == VOXRT_OK);
    voxrt_model_geometry(m, &g);
    for (level = 7; level <= 8; level++) {
        CHECK(finish_at(&g, level, 1.5f, 1.5f, 0) != NULL && finish_at(&g, level, 1.5f, 1.5f, 0)->mirror[0] == 0.75f);
        CHECK(finish_at(&g, level, 50.5f, 50.5f, 0) != NULL && finish_at(&g, level, 50.5f, 50.5f, 9.2f)->mirror[0] == 0.25f);
    }
    voxrt_model_geometry(copy, &g);
    CHECK(finish_at(&g, 8, 50.5f, 50.5f, 0) != NULL && finish_at(&g, 8, 50.5f, 50.5f, 0)->mirror[0] == 0.75f);
    e.finish = NULL; /* keeps it */
    CHECK(voxrt_model_box(m, &e, lo, all, NULL) == VOXRT_OK);
    memset(&mesh, 0, sizeof mesh);
    mesh.positions = corner[0];
    mesh.vertex_count = 3;
    mesh.indices = triangle;
    mesh.triangle_count = 1;
    memset(&v, 0, sizeof v);
    v.x = v.y = 200;
    v.z = 150;
    v.normal[2] = 1;
    e.op = VOXRT_EDIT_SET;
    e.finish = &f[1];
    CHECK(voxrt_model_mesh(m, &e, &mesh, NULL) == VOXRT_OK && voxrt_model_voxels(m, &e, &v, 1, NULL) == VOXRT_OK);
    voxrt_model_geometry(m, &g);
    CHECK(finish_at(&g, 8, 1.5f, 1.5f, 0) != NULL && finish_at(&g, 8, 1.5f, 1.5f, 0)->mirror[0] == 0.75f);
    CHECK(finish_at(&g, 8, 20.5f, 20.5f, 140) != NULL && finish_at(&g, 8, 20.5f, 20.5f, 140)->mirror[0] == 0.25f);
    CHECK(finish_at(&g, 8, 200.5f, 200.5f, 140) != NULL && finish_at(&g, 8, 200.5f, 200.5f, 140)->mirror[0] == 0.25f);
    CHECK(voxrt_tree_from_model(NULL, m, &t) == VOXRT_OK);
    voxrt_tree_get_info(t, &info);
    CHECK(info.finish_count == 2);
    voxrt_tree_destroy(t);
    e.finish = NULL; /* plain again */
    CHECK(voxrt_model_voxels(m, &e, &v, 1, NULL) == VOXRT_OK);
    voxrt_model_geometry(m, &g);
    CHECK(finish_at(&g, 8, 200.5f, 200.5f, 140) == NULL);
    for (i = 0; i < 260; i++) { /* the same one counts once; the last ones find no room */
        mirror(&many, 0.001f * (float)(i / 2 * 2 + 1));
        if (i < 200) mirror(&many, 0.75f);
        else many.emission[0] = (float)i;
        e.finish = &many;
        CHECK(voxrt_model_voxels(m, &e, &v, 1, NULL) == VOXRT_OK);
    }
    for (i = 260; i < 500; i++) {
        mirror(&many, 0.5f);
        many.emission[0] = (float)i;
        CHECK(voxrt_model_voxels(m, &e, &v, 1, NULL) == (i < 200 + 253 ? VOXRT_OK : VOXRT_ERR_RANGE));
    }
    mirror(&many, 1.5f);
    CHECK(voxrt_model_voxels(m, &e, &v, 1, NULL) == VOXRT_ERR_INVALID_ARG);
    voxrt_model_destroy(m);
    voxrt_model_destroy(copy);
    md.disable_colors = 1;
    REQUIRE(voxrt_model_create(&md, &m) == VOXRT_OK);
    e.finish = &f[0];
    CHECK(voxrt_model_box(m, &e, lo, hi, NULL) == VOXRT_ERR_INVALID_ARG);
    e.op = VOXRT_EDIT_CLEAR; /* what is cleared has none */
    CHECK(voxrt_model_box(m, &e, lo, hi, NULL) == VOXRT_OK);
    voxrt_model_destroy(m);
}

/* A pane that lets all light through and shines: no coverage, but light; as one that takes a trace of it. */
TEST(clear_panes_shine) {
    static const float shine[3] = {0.25f, 0.5f, 0.75f};
    voxrt_finish f;
    voxrt_build_desc b;
    voxrt_render_desc d;
    voxrt_image m;
    static float rgba[16 * 16][4], sum[16 * 16][4];
    uint8_t rgba8[16 * 16][4];
    uint32_t k, a;
    materials_cells.n = 0;
    add_box(0, 16, 0, 16, 8, 9, 9, 9, 9, 1);
    memset(&b, 0, sizeof b);
    b.finishes = &f;
    b.finish_count = 1;
    b.voxel_finish = materials_cells.finish;
    memset(&m, 0, sizeof m);
    m.width = m.height = 16;
    m.rgba = rgba[0];
    m.sum = sum[0];
    m.rgba8 = rgba8[0];
    look(&d, 8, 8, 40, 8, 8, 0);
    for (k = 0; k < 3; k++) {
        voxrt_tree *t = NULL;
        glass(&f, k == 1 ? 0.9999f : 1, 0);
        memcpy(f.emission, shine, sizeof shine);
        d.background[3] = k == 2 ? 1.0f : 0.0f;
        REQUIRE(voxrt_tree_from_voxels(&b, materials_cells.v, materials_cells.n, 4, &t) == VOXRT_OK);
        CHECK(voxrt_render(&d, t, &m, NULL) == VOXRT_OK);
        for (a = 0; a < 3; a++) {
            CHECK_NEAR(rgba[8 * 16 + 8][a], shine[a], 1e-4);
            CHECK_NEAR(sum[8 * 16 + 8][a], shine[a], 1e-4);
        }
        CHECK_NEAR(rgba[8 * 16 + 8][3], k == 2 ? 1 : 0, 2e-4);
        CHECK(rgba8[8 * 16 + 8][3] == (k == 2 ? 255 : 0) && (k == 2 || rgba[0][0] == 0.0f));
        voxrt_tree_destroy(t);
    }
}

/* Rays that begin behind their origin, in a body: light fades from there on, as if the origin were there. */
static void behind_ray(void *user, double x, double y, voxrt_ray *ray) {
    const float shift = *(const float *)user;
    uint32_t a;
    (void)x;
    (void)y;
    for (a = 0; a < 3; a++) ray->org[a] += shift * ray->dir[a];
    ray->t_min = -shift;
}

TEST(eyes_behind_origins) {
    voxrt_finish f;
    voxrt_build_desc b;
    voxrt_render_desc d;
    voxrt_states s;
    voxrt_tree *t = NULL;
    double mean[2][3];
    uint32_t x, y, z, i, k, a;
    float shift;
    glass(&f, 0.9f, 1.5f);
    f.absorption[0] = 0.01f;
    f.absorption[1] = 0.05f;
    f.absorption[2] = 40.0f;
    materials_cells.n = 0;
    for (z = 0; z < 32; z++)
        for (y = 0; y < 32; y++)
            for (x = 0; x < 32; x++) {
                const double u = x - 15.5, v = y - 15.5, w = z - 15.5, r = sqrt(u * u + v * v + w * w);
                if (r < 12 || r > 14) continue;
                materials_add(x, y, z, 200, 200, 200, 1);
                materials_cells.v[materials_cells.n - 1].has_normal = 1;
                materials_cells.v[materials_cells.n - 1].normal[0] = (float)u;
                materials_cells.v[materials_cells.n - 1].normal[1] = (float)v;
                materials_cells.v[materials_cells.n - 1].normal[2] = (float)w;
            }
    memset(&b, 0, sizeof b);
    b.finishes = &f;
    b.finish_count = 1;
    b.voxel_finish = materials_cells.finish;
    REQUIRE(voxrt_tree_from_voxels(&b, materials_cells.v, materials_cells.n, 5, &t) == VOXRT_OK);
    memset(&s, 0, sizeof s);
    s.ray_fn = behind_ray;
    s.user = &shift;
    look(&d, 16, 16, 16, 20, 17, 16);
    d.states = &s;
    for (a = 0; a < 4; a++) d.background[a] = 1;
    for (k = 0; k < 2; k++) {
        shift = k == 0 ? 0.0f : 64.0f;
        CHECK(draw(&d, t, materials_picture[k]));
        for (a = 0; a < 3; a++) {
            mean[k][a] = 0;
            for (i = 0; i < SIDE * SIDE; i++) mean[k][a] += (double)materials_picture[k][i][a] / (SIDE * SIDE);
        }
    }
    CHECK(mean[0][0] > 0.5 && mean[0][1] < 0.8 * mean[0][0] && mean[0][2] < 0.01);
    for (a = 0; a < 3; a++) CHECK_NEAR(mean[1][a], mean[0][a], 1e-3);
    voxrt_tree_destroy(t);
}

static int stop(void *user, uint64_t done, uint64_t total) {
    (void)user;
    (void)done;
    (void)total;
    return 1;
}

/* Edits that do nothing, and those that fail, leave all of the 255 finishes to others. */
TEST(edits_in_vain) {
    const voxrt_finish *kept;
    voxrt_model_desc md;
    voxrt_edit_desc e;
    voxrt_finish f;
    voxrt_model *m = NULL;
    voxrt_geometry g;
    voxrt_voxel v;
    const double lo[3] = {10, 10, 10}, hi[3] = {20, 20, 20}, off[3] = {-9, -9, -9}, bad[3] = {0, (double)NAN, 0};
    uint32_t i;
    memset(&md, 0, sizeof md);
    memset(&e, 0, sizeof e);
    memset(&v, 0, sizeof v);
    md.depth = 7;
    v.x = 128; /* outside */
    REQUIRE(voxrt_model_create(&md, &m) == VOXRT_OK);
    e.finish = &f;
    for (i = 0; i < 260; i++) {
        mirror(&f, 0.5f);
        f.emission[0] = (float)i;
        CHECK(voxrt_model_sphere(m, &e, off, 1, NULL) == VOXRT_OK && voxrt_model_sphere(m, &e, lo, 0, NULL) == VOXRT_OK);
        e.op = VOXRT_EDIT_PAINT;
        CHECK(voxrt_model_box(m, &e, lo, hi, NULL) == VOXRT_OK); /* nothing is filled */
        e.op = VOXRT_EDIT_SET;
        CHECK(voxrt_model_box(m, &e, lo, bad, NULL) == VOXRT_ERR_INVALID_ARG);
        CHECK(voxrt_model_voxels(m, &e, &v, 1, NULL) == VOXRT_ERR_RANGE);
        CHECK(voxrt_model_mesh(m, &e, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
        e.env.progress_fn = stop;
        CHECK(voxrt_model_box(m, &e, lo, hi, NULL) == VOXRT_ERR_CANCELLED);
        e.env.progress_fn = NULL;
    }
    CHECK(voxrt_model_box(m, &e, lo, hi, NULL) == VOXRT_OK);
    voxrt_model_geometry(m, &g);
    CHECK(finish_at(&g, 7, 15.5f, 15.5f, 0) != NULL && finish_at(&g, 7, 15.5f, 15.5f, 0)->emission[0] == 259.0f);
    kept = finish_at(&g, 7, 15.5f, 15.5f, 0);
    f.emission[0] = 300;
    e.env.progress_fn = stop;
    CHECK(voxrt_model_box(m, &e, lo, hi, NULL) == VOXRT_ERR_CANCELLED);
    CHECK(finish_at(&g, 7, 15.5f, 15.5f, 0) == kept && kept->emission[0] == 259.0f); /* it is still where it was */
    voxrt_model_destroy(m);
}

/* One full block and three with a voxel each: the cell around them has what most voxels have, not most blocks. */
TEST(blocks_count_by_their_voxels) {
    voxrt_finish f[3];
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    voxrt_model *m = NULL;
    voxrt_geometry g, whole;
    uint32_t level;
    mirror(&f[0], 0.75f); /* of one voxel: no large cell has it */
    mirror(&f[1], 0.25f);
    mirror(&f[2], 0.5f);
    materials_cells.n = 0;
    add_box(0, 8, 0, 8, 0, 8, 255, 255, 255, 2);
    materials_add(9, 9, 9, 255, 255, 255, 1);
    materials_add(64, 0, 0, 255, 255, 255, 3);
    materials_add(0, 64, 0, 255, 255, 255, 3);
    materials_add(64, 64, 0, 255, 255, 255, 3);
    materials_add(200, 200, 200, 255, 255, 255, 0);
    memset(&d, 0, sizeof d);
    d.finishes = f;
    d.finish_count = 3;
    d.voxel_finish = materials_cells.finish;
    REQUIRE(voxrt_tree_from_voxels(&d, materials_cells.v, materials_cells.n, 8, &t) == VOXRT_OK && voxrt_model_from_tree(NULL, t, &m) == VOXRT_OK);
    voxrt_tree_geometry(t, &whole);
    voxrt_model_geometry(m, &g);
    for (level = 0; level <= 8; level++) {
        CHECK(finish_at(&whole, level, 0.5f, 0.5f, 0)->mirror[0] == 0.25f && finish_at(&g, level, 0.5f, 0.5f, 0)->mirror[0] == 0.25f);
        CHECK(finish_at(&whole, level, 64.5f, 0.5f, 0)->mirror[0] == (level < 2 ? 0.25f : 0.5f));
        CHECK(finish_at(&g, level, 64.5f, 0.5f, 0)->mirror[0] == (level < 2 ? 0.25f : 0.5f));
    }
    CHECK(finish_at(&g, 8, 200.5f, 200.5f, 180) == NULL && finish_at(&g, 0, 0.5f, 0.5f, 0) == finish_at(&g, 8, 0.5f, 0.5f, 0)); /* one place */
    voxrt_model_destroy(m);
    voxrt_tree_destroy(t);
}

/* ---- textures by a function ---- */

typedef struct paint { const float (*corner)[3]; const uint32_t (*triangle)[3]; uint32_t calls; } paint;

static void paint_places(void *user, voxrt_sample *s) { /* colours are places */
    const paint *p = (const paint *)user;
    uint32_t a, k;
    float sum = 0;
    for (a = 0; a < 3; a++) {
        s->color[a] = 0;
        for (k = 0; k < 3; k++) s->color[a] += s->weight[k] * p->corner[p->triangle[s->triangle][k]][a];
    }
    for (k = 0; k < 3; k++) {
        CHECK(s->weight[k] >= 0 && s->weight[k] <= 1);
        sum += s->weight[k];
    }
    CHECK_NEAR(sum, 1, 1e-6);
    CHECK_NEAR(s->footprint, 1.0 / 64, 1e-9);
    s->normal[0] = 0.6f * 3; /* any length */
    s->normal[1] = 0;
    s->normal[2] = 0.8f * 3;
}

static int check_place(void *user, const voxrt_voxel *v, uint32_t entry) {
    uint32_t *n = (uint32_t *)user, a;
    double off = 0;
    (void)entry;
    for (a = 0; a < 3; a++) {
        const double at = (double)(a == 0 ? v->x : a == 1 ? v->y : v->z) + 0.5;
        off = fmax(off, fabs(64 * voxrti_srgb_to_linear((double)v->rgb[a] / 255) - at));
    }
    n[0]++;
    n[1] += off > 1.6; /* slanted triangles, bytes of dark colours */
    CHECK_NEAR(v->normal[0], 0.6, 0.02);
    CHECK_NEAR(v->normal[2], 0.8, 0.02);
    return 0;
}

TEST(samples_are_where_they_say) {
    static const float corner[5][3] = {{0.2f, 0.25f, 0.3f}, {0.9f, 0.3f, 0.35f}, {0.4f, 0.9f, 0.8f}, {3.0f, 0.8f, 0.6f}, {0.31f, 0.3f, 0.31f}};
    static const uint32_t triangle[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}, {1, 3, 2}, {0, 4, 1}}; /* one leaves the grid */
    static const voxrt_separating separating[3] = {VOXRT_SEPARATING_6, VOXRT_SEPARATING_26, VOXRT_SEPARATING_THESIS};
    uint32_t k, way;
    for (way = 0; way < 3; way++) {
        for (k = 0; k < 6; k++) {
            voxrt_build_desc d;
            voxrt_mesh m;
            voxrt_tree *t = NULL;
            paint p;
            uint32_t n[2] = {0, 0};
            memset(&d, 0, sizeof d);
            memset(&m, 0, sizeof m);
            d.resolution = 64;
            d.box_size = 1;
            d.separating = separating[way];
            m.positions = corner[0];
            m.vertex_count = 5;
            m.indices = triangle[k];
            m.triangle_count = 1;
            p.corner = corner;
            p.triangle = (const uint32_t (*)[3])&triangle[k];
            m.sample_fn = paint_places;
            m.sample_user = &p;
            REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
            (void)voxrt_tree_each(t, 6, check_place, n);
            CHECK_MSG(n[0] > 20 && n[1] <= n[0] / 20, "way %u, triangle %u: %u of %u voxels have the colour of another place", way, k, n[1], n[0]);
            voxrt_tree_destroy(t);
        }
    }
}

static void paint_red(void *user, voxrt_sample *s) {
    (void)user;
    s->color[0] = 1;
    s->color[1] = s->color[2] = 0;
}

static int count_not_white(void *user, const voxrt_voxel *v, uint32_t entry) {
    *(uint32_t *)user += v->rgb[0] != 255 || v->rgb[1] != 255 || v->rgb[2] != 255;
    return (int)(entry & 0);
}

/* Without colours all is white, whatever the caller's function says, also if the colours have to carry finishes. */
TEST(samples_without_colours) {
    static const float p[3][3] = {{1, 5, 5}, {9, 5, 5}, {1, 9, 5}};
    static const uint8_t number[1] = {1};
    voxrt_finish finish;
    uint32_t k;
    memset(&finish, 0, sizeof finish);
    finish.diffuse = 1;
    for (k = 0; k < 4; k++) {
        voxrt_build_desc d;
        voxrt_mesh m;
        voxrt_tree *t = NULL;
        voxrt_tree_info info;
        uint32_t coloured = 0;
        memset(&d, 0, sizeof d);
        memset(&m, 0, sizeof m);
        d.resolution = 16;
        d.disable_colors = k & 1u;
        d.finishes = &finish;
        d.finish_count = 1;
        m.positions = p[0];
        m.vertex_count = 3;
        m.triangle_count = 1;
        m.triangle_finish = k < 2 ? number : NULL;
        m.sample_fn = paint_red;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        (void)voxrt_tree_each(t, info.depth, count_not_white, &coloured);
        CHECK_EQ_U64(coloured, k & 1u ? 0 : info.voxel_count);
        CHECK_EQ_U64(info.finish_count, k < 2);
        voxrt_tree_destroy(t);
    }
}

static void check_weights(void *user, voxrt_sample *s) {
    uint32_t *calls = (uint32_t *)user, k;
    __atomic_fetch_add(calls, 1u, __ATOMIC_RELAXED);
    for (k = 0; k < 3; k++) CHECK(s->weight[k] >= 0 && s->weight[k] <= 1);
    CHECK_NEAR(s->weight[0] + s->weight[1] + s->weight[2], 1, 1e-5);
}

/* Triangles that are larger than a voxel by more than squares of doubles can tell. */
TEST(samples_of_huge_triangles) {
    static const float corner[2][9] = {{-1e38f, -1e38f, 0, 1e38f, -1e38f, 0, 0, 1e38f, 0}, {-1e38f, -1e38f, 0, 2e38f, -1e38f, 0, -1e38f, 2e38f, 0}};
    static const double size[4] = {1, 1e-60, 1e-80, 1e-250};
    uint32_t k, calls;
    for (k = 0; k < 8; k++) {
        voxrt_build_desc d;
        voxrt_mesh m;
        voxrt_tree *t = NULL;
        memset(&d, 0, sizeof d);
        memset(&m, 0, sizeof m);
        d.resolution = 16;
        d.box_size = size[k / 2];
        m.positions = corner[k % 2];
        m.vertex_count = 3;
        m.triangle_count = 1;
        m.sample_fn = check_weights;
        m.sample_user = &calls;
        calls = 0;
        CHECK(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
        CHECK(calls >= 256);
        voxrt_tree_destroy(t);
    }
}

/* ---- highlights of coarser levels ---- */

/* A rough floor: normals are tilted in all directions. Brightness of the coarser levels against that of the voxels. */
TEST(highlights_of_coarser_levels) {
    const voxrt_light sun = {{0.5f, 1, 0}, 1, {1, 1, 1}, 1};
    const voxrt_material shiny = {{0, 0, 0}, 0, 1, 60};
    static double seen[2][3][36];
    double mean[2][3], error[2][3];
    uint32_t way, level, i, k;
    test_rng rng = test_rng_make(5);
    static const uint32_t cut[3] = {0, 4, 3}; /* voxels, cells of 8 and of 16 */
    materials_cells.n = 0;
    for (i = 0; i < 64 * 64; i++) {
        voxrt_voxel *v = &materials_cells.v[materials_cells.n];
        materials_add(i % 64, 20, i / 64, 0, 0, 0, 0);
        v->has_normal = 1;
        v->normal[1] = 1;
        for (k = 0; k < 3; k += 2) v->normal[k] = (float)(0.5 * (test_rng_double(&rng) + test_rng_double(&rng) - 1));
    }
    for (way = 0; way < 2; way++) {
        voxrt_build_desc b;
        voxrt_tree *t = NULL, *shared = NULL, *loaded = NULL;
        voxrt_tree_info info;
        size_t size;
        uint8_t *file;
        memset(&b, 0, sizeof b);
        b.spread = way;
        REQUIRE(voxrt_tree_from_voxels(&b, materials_cells.v, materials_cells.n, 6, &t) == VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        CHECK(info.has_spread == way);
        for (level = 0; level < 3; level++) {
            voxrt_render_desc d;
            mean[way][level] = 0;
            for (k = 0; k < 36; k++) { /* from all around where a flat floor mirrors the light to, (12, 60, 32) */
                look(&d, 12 + 12 * ((float)(k % 6) - 2.5f), 60, 32 + 12 * ((float)(k / 6) - 2.5f), 32, 20, 32);
                d.camera.fov_y = 20;
                d.pixel_step = 4;
                d.lights = &sun;
                d.light_count = 1;
                d.material = &shiny;
                d.max_level_plus_1 = cut[level];
                CHECK(draw(&d, t, materials_picture[0]));
                seen[way][level][k] = 0;
                for (i = 0; i < SIDE * SIDE; i++) seen[way][level][k] += (double)materials_picture[0][i][0] / (SIDE * SIDE);
                mean[way][level] += seen[way][level][k] / 36;
            }
        }
        CHECK(voxrt_tree_share(t, NULL, &shared) == VOXRT_OK && voxrt_tree_hash(shared) == voxrt_tree_hash(t));
        for (k = 0; k < 4; k++) {
            file = materials_save(k & 1 ? shared : t, k & 2 ? VOXRT_ENCODING_RAW : VOXRT_ENCODING_COMPACT, &size);
            REQUIRE(file != NULL && voxrt_tree_load_memory(NULL, file, size, &loaded) == VOXRT_OK);
            CHECK(voxrt_tree_hash(loaded) == voxrt_tree_hash(t));
            voxrt_tree_destroy(loaded);
            CHECK(voxrt_tree_load_memory(NULL, file, size - 1, &loaded) != VOXRT_OK);
            free_block(file);
        }
        CHECK(voxrt_tree_unshare(shared, NULL, &loaded) == VOXRT_OK && voxrt_tree_hash(loaded) == voxrt_tree_hash(t));
        voxrt_tree_destroy(loaded);
        voxrt_tree_destroy(shared);
        voxrt_tree_destroy(t);
    }
    if (test_g.verbose)
        for (way = 0; way < 2; way++)
            printf("highlights: spread %u: %.5f, larger cells %.5f %.5f\n", way, mean[way][0], mean[way][1], mean[way][2]);
    CHECK(mean[0][0] == mean[1][0] && mean[0][0] > 0.02);
    for (way = 0; way < 2; way++) {
        for (level = 0; level < 3; level++) { /* of the brightness that is seen from a place, as a share of the mean */
            error[way][level] = 0;
            for (k = 0; k < 36; k++) error[way][level] += pow(seen[way][level][k] - seen[0][0][k], 2) / 36;
            error[way][level] = sqrt(error[way][level]) / mean[0][0];
        }
    }
    for (level = 1; level < 3; level++) {
        if (test_g.verbose) printf("highlights: off by %.3f with spread, %.3f without\n", error[1][level], error[0][level]);
        CHECK_MSG(error[1][level] < 0.35 * error[0][level], "level %u: off by %.3f with spread, %.3f without", level, error[1][level], error[0][level]);
        CHECK_NEAR(mean[1][level], mean[1][0], 0.05 * mean[1][0]); /* nothing is lost or won */
    }
}

/* Along any axis. */
TEST(equal_normals_have_no_spread) {
    uint32_t a, k;
    for (a = 0; a < 3; a++) {
        voxrt_voxel v[2];
        voxrt_build_desc b;
        voxrt_tree *t = NULL;
        memset(v, 0, sizeof v);
        memset(&b, 0, sizeof b);
        v[1].x = v[1].y = v[1].z = 1;
        v[0].normal[a] = v[1].normal[a] = 1;
        v[0].has_normal = v[1].has_normal = 1;
        b.spread = 1;
        REQUIRE(voxrt_tree_from_voxels(&b, v, 2, 4, &t) == VOXRT_OK && t->spread != NULL);
        for (k = 0; k < voxrti_spread_count(t); k++) CHECK(t->spread[k] <= 1);
        voxrt_tree_destroy(t);
    }
}

/* Between two levels of detail there is so much of each, also of what normals differ by. */
TEST(spread_between_levels) {
    voxrt_build_desc b;
    voxrt_tree *t = NULL;
    voxrt_geometry g;
    voxrt_trace_desc td;
    voxrt_surface s[3];
    voxrt_ray ray;
    test_rng rng = test_rng_make(7);
    uint32_t i, k;
    materials_cells.n = 0;
    for (i = 0; i < 64 * 64; i++) {
        voxrt_voxel *v = &materials_cells.v[materials_cells.n];
        materials_add(i % 64, 20, i / 64, 0, 0, 0, 0);
        v->has_normal = 1;
        v->normal[1] = 1;
        for (k = 0; k < 3; k += 2) v->normal[k] = (float)(2 * test_rng_double(&rng) - 1);
    }
    memset(&b, 0, sizeof b);
    b.spread = 1;
    REQUIRE(voxrt_tree_from_voxels(&b, materials_cells.v, materials_cells.n, 6, &t) == VOXRT_OK);
    voxrt_tree_geometry(t, &g);
    memset(&ray, 0, sizeof ray);
    ray.org[0] = ray.org[2] = 30.5f;
    ray.org[1] = 60;
    ray.dir[1] = -1;
    ray.t_max = INFINITY;
    for (i = 0; i < 3; i++) { /* cells of 2, of 4, and half way */
        memset(&td, 0, sizeof td);
        memset(&s[i], 0, sizeof s[i]);
        s[i].t = INFINITY;
        if (i < 2) td.max_level_plus_1 = 6 - i;
        td.blend = 1;
        if (i == 2) td.cone_width = 3;
        g.trace_fn(g.user, &td, &ray, &s[i], 1);
        CHECK(s[i].t < INFINITY && s[i].edge == (i == 1 ? 4.0f : 2.0f));
    }
    CHECK(s[0].spread > 0.01f && fabsf(s[0].spread - s[1].spread) > 0.01f);
    CHECK_NEAR(s[2].spread, 0.5 * (double)(s[0].spread + s[1].spread), 1e-6);
    voxrt_tree_destroy(t);
}

/* ---- memory ---- */

TEST(memory_runs_out) {
    voxrt_finish f[2];
    int64_t k;
    int done = 0, step = test_quick() ? 7 : 1;
    mirror(&f[0], 0.5f);
    glass(&f[1], 0.5f, 1.5f);
    for (k = 0; !done && k < 4000; k += step) {
        test_alloc ta;
        voxrt_env e;
        voxrt_tree *t, *u = NULL, *v = NULL;
        voxrt_load_desc ld;
        voxrt_save_desc sd;
        size_t size = 0;
        uint8_t *file = NULL;
        test_alloc_init(&ta);
        ta.fail_at = k;
        memset(&e, 0, sizeof e);
        memset(&ld, 0, sizeof ld);
        memset(&sd, 0, sizeof sd);
        e.thread_count = 1;
        e.allocator.alloc_fn = test_alloc_fn;
        e.allocator.free_fn = test_free_fn;
        e.allocator.user = &ta;
        ld.env = sd.env = e;
        t = make_mesh(24, 0, f, 2, 2, &e);
        if (t != NULL && voxrt_tree_share(t, &e, &u) == VOXRT_OK &&
            voxrt_tree_save_memory(u, &sd, NULL, 0, &size) == VOXRT_OK && (file = (uint8_t *)malloc(size)) != NULL &&
            voxrt_tree_save_memory(u, &sd, file, size, &size) == VOXRT_OK && voxrt_tree_load_memory(&ld, file, size, &v) == VOXRT_OK) {
            CHECK(voxrt_tree_hash(v) == voxrt_tree_hash(t));
            done = 1;
        }
        voxrt_tree_destroy(t);
        voxrt_tree_destroy(u);
        voxrt_tree_destroy(v);
        free(file);
        test_alloc_check(&ta);
    }
    CHECK_MSG(done && k > 30, "%d after %ld", done, (long)k);
}

TEST(memory_of_models_runs_out) {
    voxrt_finish f[2];
    const double lo[3] = {0, 0, 0}, hi[3] = {1, 1, 1};
    voxrt_tree *t;
    int64_t k;
    int done = 0;
    mirror(&f[0], 0.5f);
    glass(&f[1], 0.5f, 1.5f);
    t = make_mesh(72, 0, f, 2, 2, NULL); /* some blocks */
    REQUIRE(t != NULL);
    for (k = 0; !done && k < 4000; k += test_quick() ? 7 : 1) {
        test_alloc ta;
        voxrt_env e;
        voxrt_tree *u = NULL;
        voxrt_model *model = NULL, *other = NULL;
        voxrt_edit_desc edit;
        voxrt_finish give;
        voxrt_build_desc built;
        test_alloc_init(&ta);
        ta.fail_at = k;
        memset(&e, 0, sizeof e);
        memset(&edit, 0, sizeof edit);
        memset(&built, 0, sizeof built);
        e.thread_count = 1;
        e.allocator.alloc_fn = test_alloc_fn;
        e.allocator.free_fn = test_free_fn;
        e.allocator.user = &ta;
        mirror(&give, 0.125f);
        edit.finish = &give;
        edit.env = built.env = e;
        if (voxrt_model_from_tree(&e, t, &model) == VOXRT_OK && voxrt_model_copy(&e, model, &other) == VOXRT_OK &&
            voxrt_model_box(other, &edit, lo, hi, NULL) == VOXRT_OK && voxrt_tree_from_model(&built, model, &u) == VOXRT_OK) {
            CHECK(voxrt_tree_hash(u) == voxrt_tree_hash(t));
            done = 1;
        }
        voxrt_tree_destroy(u);
        voxrt_model_destroy(model);
        voxrt_model_destroy(other);
        test_alloc_check(&ta);
    }
    CHECK_MSG(done && k > 100, "%d after %ld", done, (long)k);
    voxrt_tree_destroy(t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(mirrors_show_the_mirrored_scene);
    RUN(bounces_end);
    RUN(many_rays_wait);
    RUN(snell_and_fresnel);
    RUN(ridges);
    RUN(glass_shifts_what_is_behind_it);
    RUN(furnace);
    RUN(bodies_against_an_exact_tracer);
    RUN(absorption_of_bodies_in_bodies);
    RUN(eye_in_a_body);
    RUN(light_gets_out_at_the_end);
    RUN(absorption_by_length);
    RUN(light_goes_through_panes);
    RUN(light_goes_through_bodies);
    RUN(surfaces_without_thickness);
    RUN(what_is_seen_through_glass_is_background);
    RUN(where_rays_bounce);
    RUN(steps_of_the_caller_see_bounces);
    RUN(phong_of_an_entry);
    RUN(same_bits_in_all_ways);
    RUN(coarser_cells_have_what_most_voxels_have);
    RUN(voxels_have_the_finish_of_the_largest_part);
    RUN(entries_are_pairs);
    RUN(numbers_of_finishes);
    RUN(bad_descs);
    RUN(files_keep_finishes);
    RUN(hostile_files);
    RUN(models_keep_finishes);
    RUN(edits_give_finishes);
    RUN(edits_in_vain);
    RUN(clear_panes_shine);
    RUN(eyes_behind_origins);
    RUN(blocks_count_by_their_voxels);
    RUN(samples_are_where_they_say);
    RUN(samples_without_colours);
    RUN(samples_of_huge_triangles);
    RUN(highlights_of_coarser_levels);
    RUN(equal_normals_have_no_spread);
    RUN(spread_between_levels);
    RUN(memory_runs_out);
    RUN(memory_of_models_runs_out);
    return test_end();
}
