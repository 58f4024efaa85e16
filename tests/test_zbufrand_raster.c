/* The rasteriser: which pixels a triangle covers, at what depth; gaps and overlaps; clipping; bad input; the same bits
   from both forms. The oracles go over all pixels with 64-bit integers, or over rays in double. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"

#define UNIT 4096

typedef struct view {
    zbufrandi_camera camera;
    zbufrandi_local local;
    zbufrandi_keys keys;
    zbufrandi_raster r;
} view;

/* A camera at the origin of the structure that looks along +z with x to the right, y up: a left-handed frame, as the
   axes of a real camera (right, up, forward) are. Counter-clockwise triangles seen from outside are drawn. */
static void view_open(view *v, uint32_t w, uint32_t h, double focal, double near_z, int level) {
    int k;
    memset(v, 0, sizeof *v);
    v->camera.focal = focal;
    v->camera.center_x = 0.5 * w;
    v->camera.center_y = 0.5 * h;
    v->camera.near_z = near_z;
    v->camera.far_z = (double)INFINITY;
    v->camera.width = w;
    v->camera.height = h;
    for (k = 0; k < 3; k++) v->local.m[k][k] = 1.0f;
    v->local.scale = 1.0f;
    v->keys.width = w;
    v->keys.height = h;
    v->keys.key = (uint64_t *)malloc((size_t)w * h * sizeof(uint64_t));
    if (v->keys.key == NULL) abort();
    memset(v->keys.key, 0xff, (size_t)w * h * sizeof(uint64_t));
    zbufrandi_raster_begin(&v->r, &v->camera, &v->keys, 1, level);
    zbufrandi_raster_local(&v->r, &v->local);
}
static void view_clear(view *v) { memset(v->keys.key, 0xff, (size_t)v->keys.width * v->keys.height * sizeof(uint64_t)); }
static void view_close(view *v) { free(v->keys.key); }

static void random_rotation(test_rng *g, double m[3][3]) {
    double q[4], l = 0;
    int k;
    for (k = 0; k < 4; k++) { q[k] = test_rng_double(g) - 0.5; l += q[k] * q[k]; }
    for (k = 0; k < 4; k++) q[k] /= sqrt(l);
    m[0][0] = 1 - 2 * (q[2] * q[2] + q[3] * q[3]); m[0][1] = 2 * (q[1] * q[2] - q[0] * q[3]); m[0][2] = 2 * (q[1] * q[3] + q[0] * q[2]);
    m[1][0] = 2 * (q[1] * q[2] + q[0] * q[3]); m[1][1] = 1 - 2 * (q[1] * q[1] + q[3] * q[3]); m[1][2] = 2 * (q[2] * q[3] - q[0] * q[1]);
    m[2][0] = 2 * (q[1] * q[3] - q[0] * q[2]); m[2][1] = 2 * (q[2] * q[3] + q[0] * q[1]); m[2][2] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
}

/* ---- oracle on rounded vertices ---- */

static int64_t edge(const zbufrandi_raster_vertex *a, const zbufrandi_raster_vertex *b, int64_t x, int64_t y) {
    return (int64_t)(b->x - a->x) * (y - a->y) - (int64_t)(b->y - a->y) * (x - a->x);
}

/* Whether a triangle that runs clockwise on the screen (positive area, rows downward) covers the centre of (i, j). */
static int covers(const zbufrandi_raster_vertex v[3], int i, int j) {
    int k;
    for (k = 0; k < 3; k++) {
        const zbufrandi_raster_vertex *a = &v[k], *b = &v[(k + 1) % 3];
        int64_t e = edge(a, b, (int64_t)i * UNIT + UNIT / 2, (int64_t)j * UNIT + UNIT / 2);
        int left = b->y < a->y, top = b->y == a->y && b->x > a->x;
        if (e < 0 || (e == 0 && !left && !top)) return 0;
    }
    return 1;
}

static void check_triangle(view *v, const float p[9], int mirrored, int two_sided) {
    static const uint8_t index[3] = {0, 1, 2};
    zbufrandi_raster_vertex q[3], t;
    int64_t area;
    uint32_t i, j, want = 0, got, number = 77, wrong = 0;
    double worst = 0;
    v->r.mirrored = mirrored;
    view_clear(v);
    got = zbufrandi_raster_cluster(&v->r, p, 3, index, 1, two_sided, number);
    if (zbufrandi_raster_project(&v->r, p, 3, q) != 0) { CHECK(0); return; }
    area = edge(&q[0], &q[1], q[2].x, q[2].y);
    if (area < 0) { t = q[1]; q[1] = q[2]; q[2] = t; }
    if (area == 0 || (!two_sided && (area > 0) != mirrored)) {
        CHECK_EQ_U64(got, 0);
        return;
    }
    for (j = 0; j < v->keys.height; j++) {
        for (i = 0; i < v->keys.width; i++) {
            uint64_t key = v->keys.key[(size_t)j * v->keys.width + i];
            int in = covers(q, (int)i, (int)j);
            want += (uint32_t)in;
            if (in != (key != ZBUFRANDI_EMPTY)) wrong++;
            else if (in) {
                int64_t x = (int64_t)i * UNIT + UNIT / 2, y = (int64_t)j * UNIT + UNIT / 2;
                double w0 = (double)edge(&q[1], &q[2], x, y), w1 = (double)edge(&q[2], &q[0], x, y), w2 = (double)edge(&q[0], &q[1], x, y);
                double z = (w0 + w1 + w2) / (w0 * (double)q[0].iz + w1 * (double)q[1].iz + w2 * (double)q[2].iz);
                double d = fabs((double)zbufrandi_key_depth(key) - z) / z;
                if (d > worst) worst = d;
                if (zbufrandi_key_number(key) != number) wrong++;
            }
        }
    }
    CHECK_MSG(wrong == 0, "%u pixels wrong, area %lld", wrong, (long long)area);
    CHECK_EQ_U64(got, want);
    CHECK_MSG(worst < 6e-7, "depth is wrong by %g", worst);
}

/* Corners at a given distance from each other on the screen, some exactly on centres, rims and the same rows. */
static void random_triangle(test_rng *g, const view *v, double size, float p[9]) {
    double x = test_rng_double(g) * v->keys.width, y = test_rng_double(g) * v->keys.height;
    int k, snap = (int)test_rng_below(g, 3);
    for (k = 0; k < 3; k++) {
        double sx = x + (test_rng_double(g) - 0.5) * size, sy = y + (test_rng_double(g) - 0.5) * size;
        double z = snap == 2 ? 4.0 : 2.0 + 6.0 * test_rng_double(g);
        if (snap != 0) { sx = floor(2 * sx) / 2; sy = floor(2 * sy) / 2; }
        p[3 * k] = (float)((sx - v->camera.center_x) * z / v->camera.focal);
        p[3 * k + 1] = (float)((v->camera.center_y - sy) * z / v->camera.focal);
        p[3 * k + 2] = (float)z;
    }
}

TEST(pixels_and_depth) {
    static const double sizes[] = {0.5, 1, 2, 4, 7, 9, 20, 60, 300, 4000};
    test_rng g = test_rng_make(1);
    int level, s, n, many = test_quick() ? 40 : 400;
    for (level = 1; level <= 3; level += 2) {
        view v;
        view_open(&v, 61, 47, 64.0, 0.5, level);
        for (s = 0; s < 10; s++) {
            for (n = 0; n < many; n++) {
                float p[9];
                random_triangle(&g, &v, sizes[s], p);
                check_triangle(&v, p, n & 1, n >> 1 & 1);
            }
        }
        view_close(&v);
    }
}

/* Rounded positions are the exact ones but for half a unit and the rounding of floats. */
TEST(projection) {
    test_rng g = test_rng_make(2);
    view v;
    int n;
    view_open(&v, 1920, 1080, 1500.0, 0.1, 1);
    for (n = 0; n < 20000; n++) {
        float p[3];
        zbufrandi_raster_vertex q;
        double x, y;
        int k;
        for (k = 0; k < 3; k++) p[k] = test_rng_range(&g, -3, 3);
        p[2] += 4.0f;
        CHECK_EQ_U64(zbufrandi_raster_project(&v.r, p, 1, &q), 0);
        x = (v.camera.center_x + v.camera.focal * (double)p[0] / (double)p[2]) * UNIT;
        y = (v.camera.center_y - v.camera.focal * (double)p[1] / (double)p[2]) * UNIT;
        CHECK_NEAR(q.x, x, 0.51 + fabs(x - v.camera.center_x * UNIT) * 3e-7);
        CHECK_NEAR(q.y, y, 0.51 + fabs(y - v.camera.center_y * UNIT) * 3e-7);
        CHECK_NEAR((double)q.iz * (double)p[2], 1.0, 2e-7);
    }
    view_close(&v);
}

/* The eye far from zero in the structure: subtracting it first keeps every bit. */
TEST(projection_far_from_zero) {
    test_rng g = test_rng_make(3);
    view a, b;
    int n, k;
    view_open(&a, 640, 480, 500.0, 0.1, 1);
    view_open(&b, 640, 480, 500.0, 0.1, 1);
    b.local.eye[0] = 1e6f; b.local.eye[1] = -3e6f; b.local.eye[2] = 4e6f;
    zbufrandi_raster_local(&b.r, &b.local);
    for (n = 0; n < 1000; n++) {
        float p[3], q[3];
        zbufrandi_raster_vertex va, vb;
        for (k = 0; k < 3; k++) {
            p[k] = floorf(test_rng_range(&g, -8, 8)) + (k == 2 ? 10.0f : 0.0f);
            q[k] = p[k] + b.local.eye[k];
        }
        zbufrandi_raster_project(&a.r, p, 1, &va);
        zbufrandi_raster_project(&b.r, q, 1, &vb);
        CHECK(memcmp(&va, &vb, sizeof va) == 0);
    }
    view_close(&a);
    view_close(&b);
}

/* ---- meshes ---- */

typedef struct mesh { float p[3 * 256]; uint8_t t[3 * 256]; uint32_t vertices, triangles; } mesh;

static void mesh_sphere(mesh *m, test_rng *g, int nu, int nv, double radius, const double at[3]) {
    double rot[3][3];
    int i, j, k;
    random_rotation(g, rot);
    m->vertices = m->triangles = 0;
    for (j = 0; j <= nv; j++) {
        for (i = 0; i < (j == 0 || j == nv ? 1 : nu); i++) {
            double a = 3.14159265358979 * j / nv, b = 6.28318530717959 * i / nu, s[3], r = radius * (0.8 + 0.2 * test_rng_double(g));
            s[0] = sin(a) * cos(b); s[1] = cos(a); s[2] = sin(a) * sin(b);
            for (k = 0; k < 3; k++) m->p[3 * m->vertices + (uint32_t)k] = (float)(at[k] + r * (rot[k][0] * s[0] + rot[k][1] * s[1] + rot[k][2] * s[2]));
            m->vertices++;
        }
    }
    for (j = 0; j < nv; j++) {
        for (i = 0; i < nu; i++) {
            int a = j == 0 ? 0 : 1 + (j - 1) * nu + i, b = j == 0 ? 0 : 1 + (j - 1) * nu + (i + 1) % nu;
            int c = j + 1 == nv ? 1 + (nv - 1) * nu : 1 + j * nu + i, d = j + 1 == nv ? c : 1 + j * nu + (i + 1) % nu;
            uint8_t *t = &m->t[3 * m->triangles];
            if (j != 0) { t[0] = (uint8_t)a; t[1] = (uint8_t)b; t[2] = (uint8_t)c; t += 3; m->triangles++; }
            if (j + 1 != nv) { t[0] = (uint8_t)b; t[1] = (uint8_t)d; t[2] = (uint8_t)c; m->triangles++; }
        }
    }
}

/* How often each pixel is covered by triangles of one orientation. */
static void count_cover(view *v, const mesh *m, int mirrored, uint32_t *count) {
    uint32_t t, i, n = v->keys.width * v->keys.height;
    memset(count, 0, n * sizeof *count);
    v->r.mirrored = mirrored;
    for (t = 0; t < m->triangles; t++) {
        view_clear(v);
        if (zbufrandi_raster_cluster(&v->r, m->p, m->vertices, m->t + 3 * t, 1, 0, 0) == 0) continue;
        for (i = 0; i < n; i++) count[i] += v->keys.key[i] != ZBUFRANDI_EMPTY;
    }
}

/* A closed surface is crossed inward as often as outward on every line of sight, whatever rounding did to it. */
TEST(closed_surfaces) {
    test_rng g = test_rng_make(4);
    int n, level;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < (test_quick() ? 4 : 30); n++) {
            static const double radii[] = {0.02, 0.3, 1.0, 1.9};
            double at[3];
            uint32_t front[32 * 24], back[32 * 24], i, seen = 0, wrong = 0;
            mesh m;
            view v;
            view_open(&v, 32, 24, 30.0, 0.01, level);
            at[0] = test_rng_double(&g) - 0.5; at[1] = test_rng_double(&g) - 0.5; at[2] = 2.5;
            mesh_sphere(&m, &g, 12, 8, radii[n % 4], at);
            count_cover(&v, &m, 0, front);
            count_cover(&v, &m, 1, back);
            for (i = 0; i < 32 * 24; i++) {
                wrong += front[i] != back[i];
                seen += front[i] != 0;
            }
            CHECK_MSG(wrong == 0, "radius %g: %u pixels", radii[n % 4], wrong);
            if (n % 4 > 0) CHECK(seen > 10);
            view_close(&v);
        }
    }
}

/* A plane of 10 x 10 squares with jittered corners. */
static void mesh_plane(mesh *m, test_rng *g, const double origin[3], const double u[3], const double w[3], double jitter) {
    int i, j, k;
    m->vertices = m->triangles = 0;
    for (j = 0; j <= 10; j++) {
        for (i = 0; i <= 10; i++) {
            double a = i, b = j;
            if (i % 10 != 0 && j % 10 != 0) { a += jitter * (test_rng_double(g) - 0.5); b += jitter * (test_rng_double(g) - 0.5); }
            for (k = 0; k < 3; k++) m->p[3 * m->vertices + (uint32_t)k] = (float)(origin[k] + a / 10 * u[k] + b / 10 * w[k]);
            m->vertices++;
            if (i < 10 && j < 10) {
                uint8_t *t = &m->t[3 * m->triangles];
                int c = j * 11 + i;
                t[0] = (uint8_t)c; t[1] = (uint8_t)(c + 1); t[2] = (uint8_t)(c + 12);
                t[3] = (uint8_t)c; t[4] = (uint8_t)(c + 12); t[5] = (uint8_t)(c + 11);
                m->triangles += 2;
            }
        }
    }
}

/* Each pixel exactly once: nobody is left out, and the number of covered pixels says that nobody came twice. */
TEST(planes_once) {
    test_rng g = test_rng_make(5);
    int n, level, i;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < (test_quick() ? 20 : 200); n++) {
            static const double scale[] = {7, 30, 3e4, 1e9};
            double u[3], w[3], o[3], s = scale[n % 4], z = 1.0;
            uint32_t total, empty = 0, k;
            mesh m;
            view v;
            view_open(&v, 100 + (uint32_t)n, 77, 90.0, 1e-3, level);
            /* a plane z = 1 + a x + b y that the picture lies within */
            for (i = 0; i < 3; i++) u[i] = w[i] = 0;
            u[0] = s; w[1] = s;
            u[2] = s * 0.3 * (test_rng_double(&g) - 0.5); w[2] = s * 0.3 * (test_rng_double(&g) - 0.5);
            o[0] = -s / 2 + (test_rng_double(&g) - 0.5) * s * 0.2; o[1] = -s / 2 + (test_rng_double(&g) - 0.5) * s * 0.2;
            o[2] = z + u[2] * o[0] / s + w[2] * o[1] / s;
            mesh_plane(&m, &g, o, u, w, 0.4);
            /* u right, w up: counter-clockwise as the camera sees it */
            total = zbufrandi_raster_cluster(&v.r, m.p, m.vertices, m.t, m.triangles, 0, 0);
            for (k = 0; k < v.keys.width * v.keys.height; k++) empty += v.keys.key[k] == ZBUFRANDI_EMPTY;
            CHECK_MSG(empty == 0, "scale %g: %u empty", s, empty);
            CHECK_EQ_U64(total, v.keys.width * v.keys.height);
            view_close(&v);
        }
    }
}

/* The ground: crosses the near plane and reaches beyond the guard band on both sides; everything well below the horizon is
   covered once, at the depth of the plane. */
TEST(ground_once) {
    test_rng g = test_rng_make(6);
    int n, level;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < (test_quick() ? 20 : 100); n++) {
            static const double near_z[] = {1e-6, 1e-3, 0.5};
            double o[3], u[3], w[3], s = n & 1 ? 40.0 : 4000.0, high = 0.1 + test_rng_double(&g);
            uint32_t total, i, j, empty = 0, full = 0, wrong = 0;
            mesh m;
            view v;
            view_open(&v, 90, 80, 60.0, near_z[n % 3], level);
            o[0] = -s / 2 + test_rng_double(&g); o[1] = -high; o[2] = -s / 2 + test_rng_double(&g);
            u[0] = s; u[1] = 0; u[2] = 0;
            w[0] = 0; w[1] = 0; w[2] = s;
            mesh_plane(&m, &g, o, u, w, 0.4);
            total = zbufrandi_raster_cluster(&v.r, m.p, m.vertices, m.t, m.triangles, 0, 0);
            for (j = 0; j < 80; j++) {
                for (i = 0; i < 90; i++) {
                    double down = (j + 0.5 - 40) / 60, z = high / down;
                    uint64_t key = v.keys.key[90 * j + i];
                    if (key != ZBUFRANDI_EMPTY) {
                        full++;
                        if (!(fabs((double)zbufrandi_key_depth(key) / z - 1) < 1e-3)) wrong++;
                    } else if (down > 0 && z < 15.0 && z > near_z[n % 3] * 1.001) {
                        empty++;
                    }
                }
            }
            CHECK_MSG(empty == 0, "%u empty (near %g, ground %g)", empty, near_z[n % 3], s);
            CHECK_MSG(wrong == 0, "%u of %u depths (near %g, ground %g, height %g)", wrong, full, near_z[n % 3], s, high);
            CHECK_EQ_U64(total, full);
            view_close(&v);
        }
    }
}

/* Corners from 10^-20 to 10^30 away, before and behind, the near plane next to 0: the plain way and the vector way give
   the same, and no depth is nearer than the near plane, or none. */
TEST(near_and_far_at_once) {
    static const double near_z[] = {0.0, 1e-30, 1e-6, 3.0};
    static const uint8_t index[3] = {0, 1, 2};
    test_rng g = test_rng_make(16);
    uint32_t n, k, drawn = 0, behind = 0;
    for (n = 0; n < (test_quick() ? 4000u : 100000u); n++) {
        view v[2];
        float p[9];
        for (k = 0; k < 9; k++)
            p[k] = (float)(pow(10.0, 50.0 * test_rng_double(&g) - 20.0) * (test_rng_double(&g) < 0.5 ? -1 : 1));
        if (n & 1) for (k = 0; k < 9; k++) if (test_rng_double(&g) < 0.5) p[k] = (float)(8.0 * test_rng_double(&g) - 4.0);
        for (k = 0; k < 2; k++) {
            view_open(&v[k], 24, 18, 20.0, near_z[n / 2 % 4], k ? 3 : 1);
            (void)zbufrandi_raster_cluster(&v[k].r, p, 3, index, 1, 1, 0);
        }
        CHECK_MSG(memcmp(v[0].keys.key, v[1].keys.key, 24 * 18 * 8) == 0, "triangle %u", n);
        for (k = 0; k < 24 * 18; k++) {
            const uint64_t key = v[0].keys.key[k];
            if (key == ZBUFRANDI_EMPTY) continue;
            drawn++;
            behind += !(zbufrandi_key_depth(key) >= v[0].r.near_z && zbufrandi_key_depth(key) <= 1e37f);
        }
        for (k = 0; k < 2; k++) view_close(&v[k]);
    }
    CHECK(drawn > 10000);
    CHECK_EQ_U64(behind, 0);
}

/* Triangles anywhere around the camera against rays in double; pixels within a hundredth of an edge are not judged. */
TEST(clipped_against_rays) {
    test_rng g = test_rng_make(7);
    int n, level, many = test_quick() ? 200 : 3000;
    for (level = 1; level <= 3; level += 2) {
        view v;
        view_open(&v, 40, 30, 25.0, 0.25, level);
        for (n = 0; n < many; n++) {
            static const uint8_t index[3] = {0, 1, 2};
            float p[9];
            double e1[3], e2[3], nn[3], scale = n % 5 == 0 ? 1e5 : 4;
            uint32_t i, j, wrong = 0;
            int k;
            for (k = 0; k < 9; k++) p[k] = (float)(scale * (test_rng_double(&g) - 0.5));
            if (n % 7 == 0) p[2] = 0.25f; /* a vertex on the near plane */
            view_clear(&v);
            zbufrandi_raster_cluster(&v.r, p, 3, index, 1, 1, 5);
            for (k = 0; k < 3; k++) { e1[k] = (double)p[3 + k] - (double)p[k]; e2[k] = (double)p[6 + k] - (double)p[k]; }
            for (k = 0; k < 3; k++) nn[k] = e1[(k + 1) % 3] * e2[(k + 2) % 3] - e1[(k + 2) % 3] * e2[(k + 1) % 3];
            for (j = 0; j < 30; j++) {
                for (i = 0; i < 40; i++) {
                    int state = 1, d, c; /* 1 inside, 0 outside, -1 close to an edge */
                    uint64_t key = v.keys.key[40 * j + i];
                    for (d = 0; d < 9 && state >= 0; d++) {
                        double dir[3], hit, dot = 0, off = 0, b[3], in = 1;
                        dir[0] = (i + 0.5 + 0.01 * (d % 3 - 1) - 20) / 25;
                        dir[1] = (15 - (j + 0.5 + 0.01 * (d / 3 - 1))) / 25;
                        dir[2] = 1;
                        for (c = 0; c < 3; c++) { dot += nn[c] * dir[c]; off += nn[c] * (double)p[c]; }
                        hit = off / dot;
                        for (c = 0; c < 3; c++) { /* side of edge c, by the volume of eye, edge and ray */
                            const float *a = &p[3 * c], *q = &p[3 * ((c + 1) % 3)];
                            b[c] = dir[0] * ((double)a[1] * (double)q[2] - (double)a[2] * (double)q[1]) + dir[1] *
                                ((double)a[2] * (double)q[0] - (double)a[0] * (double)q[2]) +
                                   dir[2] * ((double)a[0] * (double)q[1] - (double)a[1] * (double)q[0]);
                        }
                        if (!((b[0] > 0 && b[1] > 0 && b[2] > 0) || (b[0] < 0 && b[1] < 0 && b[2] < 0))) in = 0;
                        if (!(hit > 0.25)) in = 0;
                        if (d == 0) state = in != 0;
                        else if (state != (in != 0)) state = -1;
                        if (fabs(hit - 0.25) < 1e-3) state = -1;
                        if (d == 8 && state == 1 && key != ZBUFRANDI_EMPTY) { /* depth: between those a hundredth away */
                            double mid_off = off, mid = nn[0] * (i + 0.5 - 20) / 25 + nn[1] * (15 - (j + 0.5)) / 25 + nn[2];
                            double slope = (fabs(nn[0]) + fabs(nn[1])) / 25 * 0.001;
                            double z = (double)zbufrandi_key_depth(key), lo = mid_off / mid, tol = fabs(lo) * (slope / fabs(mid)) + fabs(lo) * 1e-5;
                            if (!(fabs(z - lo) <= tol)) wrong++;
                        }
                    }
                    if (state >= 0 && state != (key != ZBUFRANDI_EMPTY)) wrong++;
                }
            }
            CHECK_MSG(wrong == 0, "triangle %d: %u pixels", n, wrong);
        }
        view_close(&v);
    }
}

/* ---- forms, orders, threads ---- */

static uint64_t draw_hash(const mesh *m, int n, double size, uint64_t seed, int level, int exclusive, int two_sided, uint64_t *out_sum) {
    test_rng g = test_rng_make(seed);
    view v;
    uint64_t h;
    int k;
    view_open(&v, 200, 150, 150.0, 0.5, level);
    v.r.exclusive = exclusive;
    for (k = 0; k < n; k++) {
        double rot[3][3];
        int a, b;
        random_rotation(&g, rot);
        for (a = 0; a < 3; a++) {
            for (b = 0; b < 3; b++) v.local.m[a][b] = (float)(rot[a][b] * size);
            v.local.eye[a] = test_rng_range(&g, -2, 2);
        }
        v.local.rest[2] = (float)(3 + 4 * test_rng_double(&g));
        v.local.mirrored = (uint32_t)(k & 1);
        zbufrandi_raster_local(&v.r, &v.local);
        *out_sum += zbufrandi_raster_cluster(&v.r, m->p, m->vertices, m->t, m->triangles, two_sided, (uint32_t)(256 * k));
    }
    h = test_fnv1a(v.keys.key, (size_t)200 * 150 * 8, 0);
    view_close(&v);
    return h;
}

TEST(same_bits) {
    test_rng g = test_rng_make(8);
    int n, many = test_quick() ? 4 : 40;
    for (n = 0; n < many; n++) {
        static const double sizes[] = {0.003, 0.02, 0.1, 0.5, 2.0, 10.0};
        double at[3] = {0, 0, 0};
        uint64_t sum[4] = {0, 0, 0, 0}, h;
        mesh m;
        mesh_sphere(&m, &g, 8 + n % 8, 7, 1.0, at);
        h = draw_hash(&m, 60, sizes[n % 6], (uint64_t)n, 1, 1, n & 1, &sum[0]);
        CHECK_EQ_U64(draw_hash(&m, 60, sizes[n % 6], (uint64_t)n, 1, 0, n & 1, &sum[1]), h);
        CHECK_EQ_U64(draw_hash(&m, 60, sizes[n % 6], (uint64_t)n, 3, 1, n & 1, &sum[2]), h);
        CHECK_EQ_U64(draw_hash(&m, 60, sizes[n % 6], (uint64_t)n, 3, 0, n & 1, &sum[3]), h);
        CHECK(sum[0] == sum[1] && sum[0] == sum[2] && sum[0] == sum[3]);
        CHECK(sum[0] > 0 || n % 6 < 2);
    }
}

TEST(same_projection) {
#if ZBUFRANDI_AVX2
    test_rng g = test_rng_make(9);
    view v;
    int n, k;
    view_open(&v, 640, 480, 500.0, 0.1, 0);
    if (v.r.level < 3) { view_close(&v); SKIP("no AVX2"); }
    for (n = 0; n < 3000; n++) {
        float p[3 * 21];
        zbufrandi_raster_vertex a[21], b[24];
        uint32_t count = 1 + test_rng_below(&g, 21), i, ca, cb;
        for (k = 0; k < 63; k++) p[k] = test_rng_below(&g, 8) == 0 && n % 2 ? test_rng_bits(&g) : test_rng_range(&g, -5, 5);
        ca = zbufrandi_raster_project(&v.r, p, count, a);
        cb = zbufrandi_raster_project_avx2(&v.r, p, count, b);
        CHECK_EQ_U64(ca, cb);
        for (i = 0; i < count; i++) {
            CHECK_EQ_U64(a[i].code, b[i].code);
            if (a[i].code == 0) CHECK(memcmp(&a[i], &b[i], sizeof a[i]) == 0);
        }
    }
    view_close(&v);
#else
    SKIP("no AVX2");
#endif
}

typedef struct job { const view *v; const mesh *m; } job;
static void job_run(void *ctx, uint32_t i) {
    const job *j = (const job *)ctx;
    test_rng g = test_rng_make(i / 4);
    zbufrandi_raster r = j->v->r;
    zbufrandi_local l = j->v->local;
    l.eye[0] = test_rng_range(&g, -1, 1);
    l.eye[1] = test_rng_range(&g, -1, 1);
    l.rest[2] = test_rng_range(&g, 1.5f, 4);
    zbufrandi_raster_local(&r, &l);
    (void)zbufrandi_raster_cluster(&r, j->m->p, j->m->vertices, j->m->t, j->m->triangles, 1, 256 * i);
}

TEST(threads) { /* many draws of the same pixels at the same depth: the smallest key wins whoever came first */
    test_rng g = test_rng_make(10);
    double at[3] = {0, 0, 0};
    uint64_t hash[3] = {0, 0, 0};
    mesh m;
    uint32_t k;
    mesh_sphere(&m, &g, 12, 9, 1.0, at);
    for (k = 0; k < 3; k++) {
        zbufrand_env env;
        view v;
        job j;
        memset(&env, 0, sizeof env);
        env.thread_count = k == 0 ? 1 : 1 + 3 * k;
        view_open(&v, 64, 48, 60.0, 0.01, k == 1 ? 1 : 0);
        v.r.exclusive = 0;
        j.v = &v;
        j.m = &m;
        zbufrandi_parallel_for(&env, job_run, &j, 200);
        hash[k] = test_fnv1a(v.keys.key, 64 * 48 * 8, 0);
        view_close(&v);
    }
    CHECK_EQ_U64(hash[0], hash[1]);
    CHECK_EQ_U64(hash[0], hash[2]);
}

/* Parts of the picture drawn one after the other give the whole. */
TEST(parts) {
    test_rng g = test_rng_make(11);
    int level, n;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < 30; n++) {
            double at[3];
            mesh m;
            view a, b;
            int32_t x, y, cx = 1 + (int32_t)test_rng_below(&g, 62), cy = 1 + (int32_t)test_rng_below(&g, 46);
            uint32_t sum = 0, all;
            at[0] = at[1] = 0; at[2] = 2;
            mesh_sphere(&m, &g, 3 + n % 9, 3 + n % 7, 1.8, at);
            view_open(&a, 64, 48, 60.0, 0.5, level);
            view_open(&b, 64, 48, 60.0, 0.5, level);
            all = zbufrandi_raster_cluster(&a.r, m.p, m.vertices, m.t, m.triangles, 1, 0);
            for (y = 0; y < 2; y++) {
                for (x = 0; x < 2; x++) {
                    b.r.x0 = x ? cx : 0; b.r.x1 = x ? 64 : cx;
                    b.r.y0 = y ? cy : 0; b.r.y1 = y ? 48 : cy;
                    sum += zbufrandi_raster_cluster(&b.r, m.p, m.vertices, m.t, m.triangles, 1, 0);
                }
            }
            CHECK_EQ_U64(sum, all);
            CHECK(memcmp(a.keys.key, b.keys.key, 64 * 48 * 8) == 0);
            b.r.x0 = b.r.x1;
            CHECK_EQ_U64(zbufrandi_raster_cluster(&b.r, m.p, m.vertices, m.t, m.triangles, 1, 0), 0);
            view_close(&a);
            view_close(&b);
        }
    }
}

TEST(far_plane) {
    test_rng g = test_rng_make(12);
    int level;
    for (level = 1; level <= 3; level += 2) {
        double o[3] = {-50, -1, 0.5}, u[3] = {100, 0, 0}, w[3] = {0, 0, 100};
        uint32_t i, wrong = 0, some = 0;
        mesh m;
        view v;
        view_open(&v, 64, 64, 60.0, 0.1, level);
        v.camera.far_z = 5.0;
        zbufrandi_raster_begin(&v.r, &v.camera, &v.keys, 1, level);
        zbufrandi_raster_local(&v.r, &v.local);
        mesh_plane(&m, &g, o, u, w, 0);
        zbufrandi_raster_cluster(&v.r, m.p, m.vertices, m.t, m.triangles, 0, 0);
        for (i = 0; i < 64 * 64; i++) {
            double z = 60.0 / (i / 64 + 0.5 - 32);
            int want = z > 0.5 && z <= 5.0;
            wrong += want != (v.keys.key[i] != ZBUFRANDI_EMPTY);
            some += want != 0;
        }
        CHECK_EQ_U64(wrong, 0);
        CHECK(some > 100);
        view_close(&v);
    }
}

/* ---- bad input ---- */

TEST(any_bits) {
    test_rng g = test_rng_make(13);
    int level, n, k, many = test_quick() ? 300 : 4000;
    for (level = 1; level <= 3; level += 2) {
        view v;
        uint64_t hash = 0;
        view_open(&v, 37, 29, 30.0, 1e-6, level);
        for (n = 0; n < many; n++) {
            mesh m;
            uint32_t i;
            m.vertices = 1 + test_rng_below(&g, 40);
            m.triangles = 1 + test_rng_below(&g, 100);
            for (i = 0; i < 3 * m.vertices; i++) {
                m.p[i] = n % 3 == 0 || test_rng_below(&g, 20) == 0 ? test_rng_bits(&g) : test_rng_range(&g, -3, 3);
                if (n % 3 == 2) m.p[i] *= powf(10.0f, test_rng_range(&g, -30, 30));
            }
            for (i = 0; i < 3 * m.triangles; i++) m.t[i] = (uint8_t)test_rng_below(&g, m.vertices);
            for (k = 0; k < 3; k++) {
                v.local.rest[k] = test_rng_range(&g, -1, 1);
                v.local.eye[k] = n % 50 == 0 ? test_rng_bits(&g) : test_rng_range(&g, -1, 1);
            }
            zbufrandi_raster_local(&v.r, &v.local);
            view_clear(&v);
            zbufrandi_raster_cluster(&v.r, m.p, m.vertices, m.t, m.triangles, n & 1, 0);
            for (i = 0; i < 37 * 29; i++) {
                float z = zbufrandi_key_depth(v.keys.key[i]);
                if (v.keys.key[i] == ZBUFRANDI_EMPTY) continue;
                CHECK_MSG(z >= 0.9e-6f && z < 1.1e37f && zbufrandi_key_number(v.keys.key[i]) < m.triangles, "%d: depth %g, number %u of %u", n, (double)z,
                          zbufrandi_key_number(v.keys.key[i]), m.triangles);
            }
            hash = test_fnv1a(v.keys.key, 37 * 29 * 8, hash);
        }
        if (level == 1) { /* the other level must come to the same */
            test_rng again = test_rng_make(13);
            g = again;
            v.keys.key[0] = hash;
        }
        {
            static uint64_t first;
            if (level == 1) first = hash;
            else CHECK_EQ_U64(hash, first);
        }
        view_close(&v);
    }
}

TEST(degenerate) {
    static const uint8_t index[9] = {0, 1, 2, 0, 0, 1, 3, 3, 3};
    float p[12];
    int level, k;
    for (level = 1; level <= 3; level += 2) {
        view v;
        view_open(&v, 16, 16, 16.0, 0.1, level);
        for (k = 0; k < 12; k++) p[k] = 0;
        p[2] = p[5] = p[8] = p[11] = 1;
        p[3] = 0.5f; p[6] = 1.0f; /* on a line */
        CHECK_EQ_U64(zbufrandi_raster_cluster(&v.r, p, 4, index, 3, 1, 0), 0);
        CHECK_EQ_U64(zbufrandi_raster_cluster(&v.r, p, 4, index, 0, 1, 0), 0);
        p[7] = 0.5f;
        p[6] = NAN;
        CHECK_EQ_U64(zbufrandi_raster_cluster(&v.r, p, 4, index, 3, 1, 0), 0);
        p[6] = INFINITY;
        CHECK_EQ_U64(zbufrandi_raster_cluster(&v.r, p, 4, index, 3, 1, 0), 0);
        p[6] = 1.0f;
        p[7] = 0.5f;
        CHECK(zbufrandi_raster_cluster(&v.r, p, 4, index, 3, 1, 0) > 0);
        for (k = 0; k < 4; k++) p[3 * k + 2] = -1; /* behind */
        CHECK_EQ_U64(zbufrandi_raster_cluster(&v.r, p, 4, index, 3, 1, 0), 0);
        view_close(&v);
    }
}

/* Identical triangles: a tie, and the smaller hash wins. */
TEST(ties) {
    static const uint8_t index[6] = {0, 2, 1, 0, 2, 1};
    static const float p[9] = {-4, -4, 2, 4, -4, 2, 0, 4, 2};
    int level;
    for (level = 1; level <= 3; level += 2) {
        uint32_t n;
        for (n = 0; n < 20; n++) {
            view v;
            uint32_t want = zbufrandi_hash32(n) < zbufrandi_hash32(n + 1) ? n : n + 1;
            view_open(&v, 16, 16, 16.0, 0.1, level);
            v.r.mirrored = 1;
            zbufrandi_raster_cluster(&v.r, p, 3, index, 2, 0, n);
            CHECK_EQ_U64(zbufrandi_key_number(v.keys.key[8 * 16 + 8]), want);
            view_close(&v);
        }
    }
}

TEST(sizes) { /* from one pixel to the widest picture; a triangle over everything */
    static const uint32_t size[][2] = {{1, 1}, {3, 1}, {1, 9}, {8, 8}, {9, 17}, {ZBUFRANDI_RASTER_MAX_SIZE, 2}, {2, ZBUFRANDI_RASTER_MAX_SIZE}};
    static const uint8_t index[3] = {0, 1, 2};
    static const float p[9] = {-1e6f, -1e6f, 3, 1e6f, -1e6f, 3, 0, 2e6f, 3};
    int level, n;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < 7; n++) {
            view v;
            view_open(&v, size[n][0], size[n][1], 20000.0, 0.1, level);
            CHECK_EQ_U64(zbufrandi_raster_cluster(&v.r, p, 3, index, 1, 0, 0), (uint64_t)size[n][0] * size[n][1]);
            CHECK_NEAR(zbufrandi_key_depth(v.keys.key[(size_t)size[n][0] * size[n][1] - 1]), 3, 1e-5);
            view_close(&v);
        }
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(pixels_and_depth);
    RUN(projection);
    RUN(projection_far_from_zero);
    RUN(closed_surfaces);
    RUN(planes_once);
    RUN(ground_once);
    RUN(near_and_far_at_once);
    RUN(clipped_against_rays);
    RUN(same_bits);
    RUN(same_projection);
    RUN(threads);
    RUN(parts);
    RUN(far_plane);
    RUN(any_bits);
    RUN(degenerate);
    RUN(ties);
    RUN(sizes);
    return test_end();
}
