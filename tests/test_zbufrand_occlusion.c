/* The depth pyramid against its definition, pixel by pixel; boxes against all pixels they may reach. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"

typedef struct scene {
    zbufrandi_keys keys, exact;
    zbufrandi_pyramid p;
    void *memory;
    float *shown; /* depth that each pixel shows */
    uint32_t d;
} scene;

static uint64_t *key_buffer(uint32_t n) {
    uint64_t *k = (uint64_t *)malloc(n * sizeof *k);
    if (k == NULL) abort();
    memset(k, 0xff, n * sizeof *k);
    return k;
}

static void scene_open(scene *s, uint32_t w, uint32_t h, uint32_t d, int exact) {
    memset(s, 0, sizeof *s);
    s->keys.width = s->exact.width = w;
    s->keys.height = s->exact.height = h;
    s->keys.key = key_buffer(w * h);
    if (exact) s->exact.key = key_buffer(w * h);
    s->d = d;
    s->memory = malloc(zbufrandi_pyramid_bytes(w, h));
    s->shown = (float *)malloc((size_t)w * h * sizeof(float));
    if (s->memory == NULL || s->shown == NULL) abort();
    zbufrandi_pyramid_begin(&s->p, s->memory, w, h, d);
}
static void scene_refresh(scene *s, int level) {
    zbufrand_env env;
    memset(&env, 0, sizeof env);
    env.thread_count = 1;
    zbufrandi_pyramid_refresh(&env, &s->p, &s->keys, s->exact.key != NULL ? &s->exact : NULL, level);
}

static void scene_close(scene *s) {
    free(s->keys.key);
    free(s->exact.key);
    free(s->memory);
    free(s->shown);
}

/* Paint a block for each sample. */
static void scene_show(scene *s) {
    int w = (int)s->keys.width, h = (int)s->keys.height, lo = ((int)s->d - 1) / 2, hi = (int)s->d / 2, x, y, i, j;
    for (i = 0; i < w * h; i++) s->shown[i] = INFINITY;
    for (y = 0; y < h; y++) {
        for (x = 0; x < w; x++) {
            uint64_t key = s->keys.key[y * w + x];
            if (s->exact.key != NULL && s->exact.key[y * w + x] != ZBUFRANDI_EMPTY) {
                float z = zbufrandi_key_depth(s->exact.key[y * w + x]);
                if (z < s->shown[y * w + x]) s->shown[y * w + x] = z;
            }
            if (key == ZBUFRANDI_EMPTY) continue;
            for (j = y - lo; j <= y + hi; j++) {
                for (i = x - lo; i <= x + hi; i++) {
                    float z = zbufrandi_key_depth(key);
                    if (i >= 0 && j >= 0 && i < w && j < h && z < s->shown[j * w + i]) s->shown[j * w + i] = z;
                }
            }
        }
    }
}

static float tile_most(const scene *s, uint32_t x0, uint32_t y0, uint32_t size) {
    float most = 0;
    uint32_t x, y;
    for (y = y0; y < y0 + size && y < s->keys.height; y++) {
        for (x = x0; x < x0 + size && x < s->keys.width; x++) {
            float z = s->shown[y * s->keys.width + x];
            if (z > most) most = z;
        }
    }
    return most;
}

static void scene_random(scene *s, test_rng *g, double fill) {
    uint32_t i, n = s->keys.width * s->keys.height;
    for (i = 0; i < n; i++) {
        s->keys.key[i] = test_rng_double(g) < fill ? zbufrandi_key(test_rng_range(g, 0.1f, 100.0f), test_rng_u32(g)) : ZBUFRANDI_EMPTY;
        if (s->exact.key != NULL) {
            s->exact.key[i] = test_rng_double(g) < fill ? zbufrandi_key(test_rng_range(g, 0.1f, 100.0f), test_rng_u32(g)) : ZBUFRANDI_EMPTY;
        }
    }
}

static void check_pyramid(scene *s) {
    uint32_t l, x, y, wrong = 0;
    scene_show(s);
    for (l = 0; l < s->p.levels; l++) {
        for (y = 0; y < s->p.rows[l]; y++) {
            for (x = 0; x < s->p.columns[l]; x++) {
                wrong += s->p.depth[l][y * s->p.columns[l] + x] != tile_most(s, x << (3 + l), y << (3 + l), 8u << l);
            }
        }
    }
    CHECK_MSG(wrong == 0, "%u x %u, d %u: %u cells", s->keys.width, s->keys.height, s->d, wrong);
    CHECK(s->p.columns[s->p.levels - 1] == 1 && s->p.rows[s->p.levels - 1] == 1);
}

TEST(pyramid) {
    static const uint32_t sizes[][2] = {{1, 1}, {7, 9}, {8, 8}, {64, 48}, {65, 47}, {130, 20}, {200, 150}};
    static const uint32_t ds[] = {1, 2, 3, 4, 5, 10, 16};
    test_rng g = test_rng_make(1);
    uint32_t n, k, level;
    for (n = 0; n < 7; n++) {
        for (k = 0; k < 7; k++) {
            for (level = 1; level <= 3; level += 2) {
                scene s;
                scene_open(&s, sizes[n][0], sizes[n][1], ds[k], (int)(n + k + level / 2) & 1);
                check_pyramid(&s); /* empty */
                scene_random(&s, &g, k == 0 ? 0.99 : 3.0 / (ds[k] * ds[k]));
                scene_refresh(&s, (int)level);
                check_pyramid(&s);
                scene_close(&s);
            }
        }
    }
}

/* A wider window is cut: what is stored is never nearer than what is shown. */
TEST(wide_window) {
    test_rng g = test_rng_make(2);
    scene s;
    uint32_t x, y, covered = 0;
    scene_open(&s, 100, 80, 40, 0);
    scene_random(&s, &g, 0.02);
    scene_refresh(&s, 0);
    scene_show(&s);
    for (y = 0; y < s.p.rows[0]; y++) {
        for (x = 0; x < s.p.columns[0]; x++) {
            float z = s.p.depth[0][y * s.p.columns[0] + x];
            CHECK(z >= tile_most(&s, 8 * x, 8 * y, 8));
            covered += z < INFINITY;
        }
    }
    CHECK(covered > 20);
    scene_close(&s);
}

/* Keys come nearer, and the pyramid follows. */
TEST(later_keys) {
    test_rng g = test_rng_make(3);
    int n;
    for (n = 0; n < 60; n++) {
        scene s;
        uint32_t x0, y0, x1, y1, x, y, round;
        scene_open(&s, 90 + (uint32_t)n, 70, 1 + (uint32_t)n % 4, n & 1);
        scene_random(&s, &g, 0.9);
        scene_refresh(&s, 0);
        for (round = 0; round < 3; round++) {
            x0 = test_rng_below(&g, s.keys.width); x1 = x0 + 1 + test_rng_below(&g, 30);
            y0 = test_rng_below(&g, s.keys.height); y1 = y0 + 1 + test_rng_below(&g, 30);
            for (y = y0; y < y1 && y < s.keys.height; y++) {
                for (x = x0; x < x1 && x < s.keys.width; x++) {
                    zbufrandi_key_min(&s.keys.key[y * s.keys.width + x], zbufrandi_key(test_rng_range(&g, 0.01f, 50), 1));
                    if (s.exact.key != NULL) zbufrandi_key_min(&s.exact.key[y * s.keys.width + x], zbufrandi_key(test_rng_range(&g, 0.01f, 50), 1));
                }
            }
            scene_refresh(&s, n % 3 == 0 ? 1 : 0);
            check_pyramid(&s);
        }
        scene_close(&s);
    }
}

TEST(threads) {
    test_rng g = test_rng_make(4);
    zbufrand_env env;
    scene s;
    memset(&env, 0, sizeof env);
    env.thread_count = 5;
    scene_open(&s, 700, 500, 2, 1);
    scene_random(&s, &g, 0.8);
    zbufrandi_pyramid_refresh(&env, &s.p, &s.keys, &s.exact, 0);
    check_pyramid(&s);
    scene_close(&s);
}

/* The definition: every pixel that a sample of the rectangle could paint shows something nearer. */
static int hidden_exact(const scene *s, const float rect[4], float z) {
    int lo = ((int)s->d - 1) / 2, hi = (int)s->d / 2, x, y;
    int x0 = (int)floorf(rect[0]) - lo, y0 = (int)floorf(rect[1]) - lo, x1 = (int)floorf(rect[2]) + hi, y1 = (int)floorf(rect[3]) + hi;
    for (y = y0 < 0 ? 0 : y0; y <= y1 && y < (int)s->keys.height; y++) {
        for (x = x0 < 0 ? 0 : x0; x <= x1 && x < (int)s->keys.width; x++) {
            if (!(s->shown[y * (int)s->keys.width + x] < z)) return 0;
        }
    }
    return 1;
}

TEST(rectangles) {
    test_rng g = test_rng_make(5);
    int n, k;
    uint32_t found = 0, possible = 0;
    for (n = 0; n < 12; n++) {
        scene s;
        scene_open(&s, 300 + (uint32_t)n, 200 - (uint32_t)n, 1 + (uint32_t)n, n & 1);
        scene_random(&s, &g, n > 3 ? 0.2 : n % 3 == 0 ? 1.0 : 0.98);
        scene_refresh(&s, 0);
        scene_show(&s);
        for (k = 0; k < (test_quick() ? 500 : 4000); k++) {
            float rect[4], z = test_rng_range(&g, n > 3 ? 20.0f : 50.0f, 130), size = powf(2.0f, test_rng_range(&g, -3, 9));
            int got, want;
            rect[0] = test_rng_range(&g, -40, 340); rect[1] = test_rng_range(&g, -40, 240);
            rect[2] = rect[0] + size * test_rng_float(&g); rect[3] = rect[1] + size * test_rng_float(&g);
            got = zbufrandi_pyramid_hidden(&s.p, rect, z);
            want = hidden_exact(&s, rect, z);
            CHECK_MSG(!got || want, "rect %g %g %g %g, z %g", (double)rect[0], (double)rect[1], (double)rect[2], (double)rect[3], (double)z);
#if ZBUFRANDI_AVX2
            if (zbufrandi_cpu_level() >= 3) CHECK_EQ_U64(zbufrandi_pyramid_hidden_avx2(&s.p, rect, z), got);
#endif
            found += got != 0;
            possible += want != 0;
        }
        scene_close(&s);
    }
    CHECK_MSG(found > possible / 2, "%u of %u", found, possible);
}

TEST(odd_rectangles) {
    static const float inf = INFINITY;
    scene s;
    float r[4];
    uint32_t i;
    int k;
    scene_open(&s, 64, 64, 1, 0);
    for (i = 0; i < 64 * 64; i++) s.keys.key[i] = zbufrandi_key(1.0f, i);
    scene_refresh(&s, 0);
    for (k = 0; k < 2; k++) {
        int (*hidden)(const zbufrandi_pyramid *, const float[4], float) = zbufrandi_pyramid_hidden;
#if ZBUFRANDI_AVX2
        if (k == 1 && zbufrandi_cpu_level() >= 3) hidden = zbufrandi_pyramid_hidden_avx2;
#endif
        r[0] = r[1] = -inf; r[2] = r[3] = inf;
        CHECK(hidden(&s.p, r, 1.5f));
        CHECK(!hidden(&s.p, r, 1.0f)); /* equal depth is not behind */
        CHECK(!hidden(&s.p, r, NAN));
        r[0] = NAN;
        CHECK(!hidden(&s.p, r, 2.0f));
        r[0] = 5; r[2] = 4;
        CHECK(!hidden(&s.p, r, 2.0f));
        r[0] = 70; r[2] = 80; r[1] = 0; r[3] = 5;
        CHECK(hidden(&s.p, r, 0.5f)); /* beside the picture */
        r[0] = -9; r[2] = -0.5f;
        CHECK(hidden(&s.p, r, 0.5f));
        r[0] = 63.5f; r[2] = 1e30f;
        CHECK(hidden(&s.p, r, 1.5f));
        CHECK(!hidden(&s.p, r, 0.5f));
    }
    scene_close(&s);
}

TEST(sizes) {
    zbufrandi_pyramid p;
    CHECK_EQ_U64(zbufrandi_pyramid_bytes(0, 5), 0);
    CHECK_EQ_U64(zbufrandi_pyramid_bytes(5, 0), 0);
    CHECK_EQ_U64(zbufrandi_pyramid_bytes(40000, 5), 0);
    CHECK(zbufrandi_pyramid_bytes(32768, 32768) > 4096u * 4096u * 4u);
    CHECK(zbufrandi_pyramid_layout(&p, 32768, 32768, 1) > 0);
    CHECK_EQ_U64(p.levels, ZBUFRANDI_PYRAMID_LEVELS);
}

/* Children whose boxes are hidden: no point of such a box shows in front, checked by points; and both forms agree. */
static void hidden_boxes(uint32_t block) {
    test_rng g = test_rng_make(6);
    zbufrandi_cut cut;
    scene s;
    zbufrandi_camera camera;
    zbufrandi_local local;
    zbufrandi_sides sides;
    uint32_t i, hidden_count = 0;
    int n, k, c, many = test_quick() ? 200 : 3000;
    scene_open(&s, 200, 150, block, block == 2);
    for (i = 0; i < 200 * 150; i++) s.keys.key[i] = zbufrandi_key(2.0f + (float)(i % 200) * 0.02f + test_rng_float(&g) * 0.1f, i);
    for (i = 0; i < 20; i++) s.keys.key[test_rng_below(&g, 200 * 150)] = ZBUFRANDI_EMPTY;
    for (i = 0; i < 200 * 150 && block == 2; i++) { /* few samples, many rastered pixels, or the other way */
        if (i / 200 % 20 < 10 && i % 3 != 0) s.keys.key[i] = ZBUFRANDI_EMPTY;
        if (i / 200 % 20 < 10) s.exact.key[i] = zbufrandi_key(2.2f + (float)(i % 200) * 0.02f + test_rng_float(&g) * 0.1f, i);
    }
    scene_refresh(&s, 0);
    scene_show(&s);
    memset(&camera, 0, sizeof camera);
    camera.focal = 170; camera.center_x = 100; camera.center_y = 75; camera.near_z = 0.1; camera.far_z = (double)INFINITY;
    camera.width = 200; camera.height = 150;
    zbufrandi_camera_sides(&camera);
    memset(&cut, 0, sizeof cut);
    cut.camera = camera;
    cut.focal = 170; cut.center_x = 100; cut.center_y = 75; cut.near_z = 0.1f; cut.far_z = 1e30f; cut.density_f2 = 1.0f;
    cut.pyramid = &s.p;
    for (n = 0; n < many; n++) {
        zbufrandi_node8 node;
        zbufrandi_tested tested, tested3;
        double a = test_rng_double(&g) * 6.28, scale = pow(2.0, (double)test_rng_range(&g, -3, 3)), eye[3];
        uint32_t got, got3, inside;
        memset(&local, 0, sizeof local);
        memset(&node, 0, sizeof node);
        node.count = 8;
        for (c = 0; c < 8; c++) {
            node.cosine[c] = -1.0f;
            node.area[c] = 1.0f;
        }
        local.to_camera[0][0] = cos(a) * scale; local.to_camera[0][2] = sin(a) * scale;
        local.to_camera[1][1] = scale;
        local.to_camera[2][0] = -sin(a) * scale; local.to_camera[2][2] = cos(a) * scale;
        for (k = 0; k < 3; k++) eye[k] = (double)test_rng_range(&g, -5, 5);
        for (k = 0; k < 3; k++) for (c = 0; c < 3; c++) local.to_camera[k][3] -= local.to_camera[k][c] * eye[c];
        local.scale = (float)scale;
        zbufrandi_local_finish(&local);
        zbufrandi_sides_of(&camera, &local, &sides);
        for (c = 0; c < 8; c++) {
            for (k = 0; k < 3; k++) {
                float x = (float)((double)local.eye[k] + (test_rng_double(&g) - 0.5) * 16 / scale);
                node.lo[k][c] = x;
                node.hi[k][c] = x + (float)(test_rng_double(&g) * (c % 2 ? 2 : 0.2) / scale);
            }
            if (c == 7 && n % 3 == 0) for (k = 0; k < 3; k++) { node.lo[k][c] = INFINITY; node.hi[k][c] = -INFINITY; } /* no child */
        }
        cut.keys = n % 4 != 0 ? &s.keys : NULL;
        cut.exact = s.exact.key;
        cut.block = block;
        cut.level = 1;
        zbufrandi_test_node(&cut, &local, &sides, &node, &tested);
        inside = 255u & ~tested.outside;
        got = zbufrandi_hidden_children(&cut, &tested, inside);
        cut.level = zbufrandi_level(ZBUFRAND_ISA_AUTO);
        zbufrandi_test_node(&cut, &local, &sides, &node, &tested3);
        CHECK(tested.outside == tested3.outside && memcmp(tested.x0, tested3.x0, sizeof tested.x0) == 0);
        got3 = zbufrandi_hidden_children(&cut, &tested3, inside);
        CHECK_EQ_U64(got, got3);
        CHECK_EQ_U64(zbufrandi_hidden_children(&cut, &tested3, inside & 0x55u), got & 0x55u);
        for (c = 0; c < 8; c++) {
            if ((got >> c & 1) == 0 || (c == 7 && n % 3 == 0)) continue;
            hidden_count++;
            for (i = 0; i < 30; i++) {
                double p[3], q[3];
                int r, x, y, px, py;
                for (k = 0; k < 3; k++) {
                    double t = i < 8 ? (double)(i >> k & 1) : test_rng_double(&g);
                    p[k] = (double)node.lo[k][c] + t * ((double)node.hi[k][c] - (double)node.lo[k][c]) - (double)local.eye[k];
                }
                for (r = 0; r < 3; r++) q[r] = p[0] * (double)local.m[r][0] + p[1] * (double)local.m[r][1] + p[2] * (double)local.m[r][2];
                CHECK(q[2] > 0.1);
                px = (int)floor(100 + 170 * q[0] / q[2]);
                py = (int)floor(75 - 170 * q[1] / q[2]);
                for (y = py; y < py + (int)block; y++) {
                    for (x = px; x < px + (int)block; x++) {
                        if (x < 0 || y < 0 || x >= 200 || y >= 150) continue;
                        CHECK((double)s.shown[y * 200 + x] < q[2]);
                    }
                }
            }
        }
    }
    CHECK_MSG(hidden_count > (uint32_t)many / 6, "%u", hidden_count);
    scene_close(&s);
}

TEST(nodes) {
    hidden_boxes(2);
    hidden_boxes(1);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(pyramid);
    RUN(wide_window);
    RUN(later_keys);
    RUN(threads);
    RUN(rectangles);
    RUN(odd_rectangles);
    RUN(sizes);
    RUN(nodes);
    return test_end();
}
