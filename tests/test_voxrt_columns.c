/* Bit columns: voxelisers against brute force, hierarchy, rays against plain stepping in double precision. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"

static uint32_t columns_rng_state = 1;
static uint32_t rng(void) { return columns_rng_state = voxrti_hash32(columns_rng_state + 0x9e3779b9u); }
static double columns_rnd(void) { return (double)rng() / 4294967296.0; }
static double rnd_in(double lo, double hi) { return lo + (hi - lo) * columns_rnd(); }

static voxrt_columns *make(uint32_t nx, uint32_t ny, uint32_t nz) { /* cells are unit cubes, depth is z */
    voxrt_columns_desc d;
    voxrt_columns *c = NULL;
    memset(&d, 0, sizeof d);
    d.size_x = nx;
    d.size_y = ny;
    d.size_z = nz;
    d.depth_axis_plus_1 = 3;
    d.box_max[0] = nx;
    d.box_max[1] = ny;
    d.box_max[2] = nz;
    if (voxrt_columns_create(&d, &c) != VOXRT_OK) abort();
    return c;
}
static voxrt_result insert(voxrt_columns *c, voxrt_columns_mode mode, const float *p, const uint32_t *index, size_t n,
                           size_t vertices, uint32_t still, voxrt_columns_insert_stats *stats) {
    voxrt_columns_insert_desc d;
    voxrt_mesh m;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    d.mode = mode;
    d.still = still;
    m.positions = p;
    m.vertex_count = vertices;
    m.indices = index;
    m.triangle_count = n;
    return voxrt_columns_insert(c, &d, &m, stats);
}
static int get(const voxrt_columns *c, int x, int y, int z) {
    return x >= 0 && y >= 0 && z >= 0 && voxrt_columns_get(c, 0, (uint32_t)x, (uint32_t)y, (uint32_t)z);
}

TEST(masks) {
    int lo, hi, w, k;
    for (lo = 0; lo < 96; lo++)
        for (hi = 0; hi < 96; hi++)
            for (w = 0; w < 3; w++) {
                uint32_t m = 0;
                for (k = lo; k <= hi; k++) if (k / 32 == w) m |= 1u << (k % 32);
                if (voxrti_column_mask(lo, hi, w) != m) CHECK_MSG(0, "cells %d..%d of word %d", lo, hi, w);
            }
    CHECK(voxrti_column_mask(5, 5, 0) == 32);
}

TEST(bad_input) {
    voxrt_columns_desc d;
    voxrt_columns *c = NULL;
    voxrt_columns_insert_desc in;
    voxrt_columns_insert_stats stats;
    voxrt_error e;
    const float p[9] = {0, 0, 0, NAN, 0, 0, 1, 1, 1};
    const uint32_t index[6] = {0, 1, 2, 0, 2, 7};
    memset(&d, 0, sizeof d);
    memset(&e, 0, sizeof e);
    d.env.error = &e;
    CHECK(voxrt_columns_create(NULL, &c) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_INVALID_ARG && c == NULL && e.text[0] != 0);
    d.box_max[0] = d.box_max[1] = d.box_max[2] = 1.0;
    d.size_x = 100;
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_INVALID_ARG && e.where == 100);
    d.size_x = 8192;
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_INVALID_ARG);
    d.size_x = 0;
    d.size_z = 32;
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_INVALID_ARG);
    d.size_z = 0;
    d.depth_axis_plus_1 = 4;
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_INVALID_ARG);
    d.depth_axis_plus_1 = 0;
    d.box_max[1] = (double)INFINITY;
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_INVALID_ARG);
    d.box_max[1] = 1.0;
    d._end_zero = 1;
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_UNINIT_DESC);
    d._end_zero = 0;
    d.env.memory_limit = 100000;
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_ERR_NO_MEMORY && c == NULL);
    d.env.memory_limit = 0;
    REQUIRE(voxrt_columns_create(&d, &c) == VOXRT_OK);
    memset(&in, 0, sizeof in);
    in.to_world[3] = (double)NAN;
    CHECK(voxrt_columns_insert_points(c, &in, p, 0, 3, NULL) == VOXRT_ERR_INVALID_ARG);
    memset(&stats, 0, sizeof stats);
    CHECK(insert(c, VOXRT_COLUMNS_THIN, p, index, 2, 3, 0, &stats) == VOXRT_OK);
    CHECK(stats.items == 2 && stats.rejected == 2 && stats.outside == 0);
    CHECK(insert(c, (voxrt_columns_mode)9, p, index, 2, 3, 0, &stats) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_columns_insert(c, NULL, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    {
        voxrt_mesh m;
        uint32_t stride;
        memset(&m, 0, sizeof m);
        in.to_world[3] = 0;
        in.env.error = &e;
        m.positions = p;
        m.vertex_count = 3;
        m.triangle_count = SIZE_MAX;
        CHECK(voxrt_columns_insert(c, &in, &m, NULL) == VOXRT_ERR_RANGE && e.where == SIZE_MAX && strstr(e.text, "too many") != NULL);
        if (sizeof(size_t) > 4) CHECK(voxrt_columns_insert_points(c, &in, p, 0, SIZE_MAX, NULL) == VOXRT_ERR_RANGE);
        m.triangle_count = 1;
        for (stride = 1; stride < 12; stride++) {
            m.position_stride = stride;
            CHECK(voxrt_columns_insert(c, &in, &m, NULL) == VOXRT_ERR_INVALID_ARG && strstr(e.text, "stride") != NULL);
            CHECK(voxrt_columns_insert_points(c, &in, p, stride, 3, NULL) == VOXRT_ERR_INVALID_ARG && strstr(e.text, "points") != NULL);
        }
        m.position_stride = 12;
        CHECK(voxrt_columns_insert(c, &in, &m, NULL) == VOXRT_OK);
    }
    CHECK(voxrt_columns_insert_points(c, NULL, NULL, 0, 1, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_columns_trace(NULL, NULL, NULL, NULL, 0) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_columns_trace(c, NULL, NULL, NULL, 1) == VOXRT_ERR_INVALID_ARG);
    voxrt_columns_destroy(c);
    voxrt_columns_destroy(NULL);
    voxrt_columns_update(NULL);
    voxrt_columns_clear(NULL, 1);
}

TEST(placement) { /* a box that is no cube: the depth is its shortest side, points come where they belong */
    voxrt_columns_desc d;
    voxrt_columns_info info;
    voxrt_columns_insert_stats stats;
    voxrt_columns *c = NULL;
    const float p[4][3] = {{1.01f, -0.99f, 5.01f}, {8.99f, -0.01f, 8.99f}, {3.0f, -0.5f, 7.0f}, {0.5f, -0.5f, 7.0f}};
    memset(&d, 0, sizeof d);
    memset(&stats, 0, sizeof stats);
    d.box_min[0] = 1;
    d.box_min[1] = -1;
    d.box_min[2] = 5;
    d.box_max[0] = 9;
    d.box_max[1] = 0;
    d.box_max[2] = 9;
    d.size_x = 64;
    d.size_y = 32;
    d.size_z = 256;
    REQUIRE(voxrt_columns_create(&d, &c) == VOXRT_OK);
    CHECK(voxrt_columns_insert_points(c, NULL, p[0], 0, 4, &stats) == VOXRT_OK);
    CHECK(stats.items == 4 && stats.outside == 1);
    voxrt_columns_update(c);
    voxrt_columns_get_info(c, &info);
    CHECK(info.axis[0] == 2 && info.axis[1] == 0 && info.axis[2] == 1); /* z, x, and y is the depth */
    CHECK(info.cell[0] == 4.0 / 64 && info.cell[1] == 8.0 / 32 && info.cell[2] == 1.0 / 256);
    CHECK(info.cells == 3);
    CHECK(get(c, 0, 0, 2) && get(c, 63, 31, 253) && get(c, 32, 8, 128));
    CHECK(voxrt_columns_get(c, 6, 0, 0, 128) && !voxrt_columns_get(c, 6, 0, 0, 127) && !voxrt_columns_get(c, 7, 0, 0, 128));
    voxrt_columns_destroy(c);
}

/* ---- voxelisers ---- */

/* Does line `a` through the centre of the cells meet the triangle? In integers, sample by sample. */
static int line_meets(const int64_t p[3][3], uint32_t a, int64_t su, int64_t sv) {
    const uint32_t u = a == 2 ? 0 : 2, v = a == 1 ? 0 : 1;
    int64_t area = (p[1][u] - p[0][u]) * (p[2][v] - p[0][v]) - (p[1][v] - p[0][v]) * (p[2][u] - p[0][u]);
    int e;
    if (area == 0) return 0;
    for (e = 0; e < 3; e++) {
        const int64_t *s = p[e], *t = p[(e + 1) % 3];
        int64_t du = t[u] - s[u], dv = t[v] - s[v], x = du * (sv - s[v]) - dv * (su - s[u]);
        if (area < 0) {
            du = -du;
            dv = -dv;
            x = -x;
        }
        if (x < 0 || (x == 0 && !(dv > 0 || (dv == 0 && du > 0)))) return 0;
    }
    return 1;
}

TEST(thin_is_three_crosshairs) {
    int round, rounds = test_quick() ? 100 : 600;
    columns_rng_state = 3;
    for (round = 0; round < rounds; round++) {
        voxrt_columns *c = make(16, 8, 64), *raster = make(16, 8, 64);
        static uint8_t want[3][64][8][16];
        float p[3][3];
        int64_t s[3][3];
        int e, a, x, y, z, wrong = 0;
        memset(want, 0, sizeof want);
        for (e = 0; e < 3; e++)
            for (a = 0; a < 3; a++) {
                const double size[3] = {16, 8, 64};
                p[e][a] = (float)rnd_in(-4, size[a] + 4);
                if (round % 3 == 0) p[e][a] = (float)floor((double)p[e][a] * 2) / 2; /* on centres and borders */
                if (round % 7 == 1 && e > 0) p[e][a] = p[0][a] + (p[e][a] - p[0][a]) * 0.05f;
                s[e][a] = (int64_t)floor((double)p[e][a] * 256.0 + 0.5);
            }
        if (insert(c, VOXRT_COLUMNS_THIN, p[0], NULL, 1, 3, 0, NULL) != VOXRT_OK) CHECK(0);
        if (insert(raster, VOXRT_COLUMNS_RASTER, p[0], NULL, 1, 3, 0, NULL) != VOXRT_OK) CHECK(0);
        for (a = 0; a < 3; a++) {
            const int size[3] = {16, 8, 64}, u = a == 2 ? 0 : 2, v = a == 1 ? 0 : 1;
            int i, j;
            double n[3];
            for (e = 0; e < 3; e++) {
                const int b = (e + 1) % 3, d = (e + 2) % 3;
                n[e] = (double)((s[1][b] - s[0][b]) * (s[2][d] - s[0][d]) - (s[1][d] - s[0][d]) * (s[2][b] - s[0][b]));
            }
            for (j = 0; j < size[v]; j++)
                for (i = 0; i < size[u]; i++) {
                    int at[3];
                    long double w;
                    if (!line_meets((const int64_t (*)[3])s, (uint32_t)a, 256 * i + 128, 256 * j + 128)) continue;
                    w = (long double)s[0][a] - ((long double)n[u] * (256 * i + 128 - s[0][u]) +
                                                (long double)n[v] * (256 * j + 128 - s[0][v])) / (long double)n[a];
                    at[u] = i;
                    at[v] = j;
                    at[a] = (int)floorl(w / 256.0L);
                    if (fabsl(w / 256.0L - roundl(w / 256.0L)) < 1e-9L) at[a] = (int)roundl(w / 256.0L); /* else either */
                    if (at[a] < 0 || at[a] >= size[a]) continue;
                    want[a == 2 ? 1 : 0][at[2]][at[1]][at[0]] = 1;
                    want[2][at[2]][at[1]][at[0]] = (uint8_t)(fabsl(w / 256.0L - roundl(w / 256.0L)) < 1e-9L);
                }
        }
        for (z = 0; z < 64; z++)
            for (y = 0; y < 8; y++)
                for (x = 0; x < 16; x++) {
                    const int thin = want[0][z][y][x] | want[1][z][y][x];
                    if (want[2][z][y][x] || (z > 0 && want[2][z - 1][y][x]) || (z < 63 && want[2][z + 1][y][x]) ||
                        (y > 0 && want[2][z][y - 1][x]) || (y < 7 && want[2][z][y + 1][x]) ||
                        (x > 0 && want[2][z][y][x - 1]) || (x < 15 && want[2][z][y][x + 1])) continue; /* ties */
                    wrong += get(c, x, y, z) != thin;
                    wrong += get(raster, x, y, z) != want[1][z][y][x];
                }
        CHECK_MSG(wrong == 0, "triangle %d: %d cells", round, wrong);
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(raster);
    }
}

/* Separating axes: do a triangle and the cube [lo, hi]^3 meet, both closed? (Akenine-Moeller 2001) */
static int box_meets(const double t[3][3], const double lo[3], const double hi[3]) {
    double c[3], h[3], v[3][3], e[3][3], axis[13][3];
    int i, j, k, n = 0;
    for (i = 0; i < 3; i++) {
        c[i] = 0.5 * (lo[i] + hi[i]);
        h[i] = 0.5 * (hi[i] - lo[i]);
        for (j = 0; j < 3; j++) v[j][i] = t[j][i] - c[i];
    }
    for (j = 0; j < 3; j++) for (i = 0; i < 3; i++) e[j][i] = v[(j + 1) % 3][i] - v[j][i];
    memset(axis, 0, sizeof axis);
    for (i = 0; i < 3; i++) axis[n++][i] = 1;
    for (i = 0; i < 3; i++) axis[n][i] = e[0][(i + 1) % 3] * e[1][(i + 2) % 3] - e[0][(i + 2) % 3] * e[1][(i + 1) % 3];
    n++;
    for (i = 0; i < 3; i++)
        for (j = 0; j < 3; j++, n++) {
            axis[n][(i + 1) % 3] = -e[j][(i + 2) % 3];
            axis[n][(i + 2) % 3] = e[j][(i + 1) % 3];
        }
    for (k = 0; k < n; k++) {
        double least = 1e300, most = -1e300, r = 0;
        for (i = 0; i < 3; i++) r += h[i] * fabs(axis[k][i]);
        for (j = 0; j < 3; j++) {
            const double d = v[j][0] * axis[k][0] + v[j][1] * axis[k][1] + v[j][2] * axis[k][2];
            least = fmin(least, d);
            most = fmax(most, d);
        }
        if (least > r || most < -r) return 0;
    }
    return 1;
}

TEST(fat_is_what_is_touched) {
    int round, rounds = test_quick() ? 60 : 300;
    columns_rng_state = 5;
    for (round = 0; round < rounds; round++) {
        voxrt_columns *c = make(16, 8, 64), *thin = make(16, 8, 64);
        float p[3][3];
        double t[3][3];
        int e, a, x, y, z, missing = 0, extra = 0, outside = 0;
        for (e = 0; e < 3; e++)
            for (a = 0; a < 3; a++) {
                const double size[3] = {16, 8, 64};
                p[e][a] = (float)rnd_in(-4, size[a] + 4);
                if (round % 4 == 0 && a == (round / 4) % 3) p[e][a] = (float)(round % 8); /* a plane between cells */
                if (round % 7 == 1 && e > 0) p[e][a] = p[0][a] + (p[e][a] - p[0][a]) * 0.05f;
                if (round % 5 == 2 && e == 0) p[e][a] = (float)(columns_rnd() < 0.5 ? rnd_in(-1, 1) : size[a] + rnd_in(-1, 1));
                if (round % 5 == 2 && e > 0) p[e][a] = p[0][a] + (p[e][a] - p[0][a]) * 0.1f; /* small, across borders */
                if (round % 13 == 3 && e == 2) p[e][a] = p[0][a] * 0.7f + p[1][a] * 0.3f; /* no area, or next to none */
                if (round % 11 == 1 && a == 2) p[e][a] = (float)rnd_in(-500, 500);
                t[e][a] = (double)p[e][a];
            }
        if (insert(c, VOXRT_COLUMNS_FAT, p[0], NULL, 1, 3, 0, NULL) != VOXRT_OK) CHECK(0);
        if (insert(thin, VOXRT_COLUMNS_THIN, p[0], NULL, 1, 3, 0, NULL) != VOXRT_OK) CHECK(0);
        for (z = 0; z < 64; z++)
            for (y = 0; y < 8; y++)
                for (x = 0; x < 16; x++) {
                    const double lo[3] = {x + 1e-9, y + 1e-9, z + 1e-9}, hi[3] = {x + 1 - 1e-9, y + 1 - 1e-9, z + 1 - 1e-9};
                    const double lo2[3] = {x - 1e-4, y - 1e-4, z - 1e-4}, hi2[3] = {x + 1 + 1e-4, y + 1 + 1e-4, z + 1 + 1e-4};
                    const double lo3[3] = {x - 0.01, y - 0.01, z - 0.01}, hi3[3] = {x + 1.01, y + 1.01, z + 1.01};
                    const int is = get(c, x, y, z);
                    missing += !is && box_meets((const double (*)[3])t, lo, hi);
                    extra += is && !box_meets((const double (*)[3])t, lo2, hi2);
                    outside += get(thin, x, y, z) && !is && !box_meets((const double (*)[3])t, lo3, hi3);
                }
        CHECK_MSG(missing == 0 && extra == 0 && outside == 0, "triangle %d: %d missing, %d extra, %d thin ones", round,
                  missing, extra, outside);
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(thin);
    }
}

/* Triangles that are done several at a time, of all sizes, some of them nowhere, against one at a time. */
TEST(four_triangles_at_a_time) {
    static float p[259][3];
    static uint32_t index[512][3];
    int round, rounds = test_quick() ? 40 : 400;
    columns_rng_state = 29;
    for (round = 0; round < rounds; round++) {
        const voxrt_columns_mode mode = round & 1 ? VOXRT_COLUMNS_FAT : VOXRT_COLUMNS_THIN;
        const uint32_t still = (uint32_t)round >> 1 & 1;
        const double size[3] = {32, 16, 64}, wide = round % 3 == 0 ? 1.0 : round % 3 == 1 ? 4.0 : 30.0;
        voxrt_columns *all = make(32, 16, 64), *single = make(32, 16, 64);
        voxrt_columns_insert_stats of_all, of_single;
        uint32_t i, a, e, x, y, z, wrong = 0;
        memset(&of_all, 0, sizeof of_all);
        memset(&of_single, 0, sizeof of_single);
        for (i = 0; i < 256; i += 4) {
            for (a = 0; a < 3; a++) p[i][a] = (float)rnd_in(-3, size[a] + 3);
            for (e = 1; e < 4; e++) for (a = 0; a < 3; a++) p[i + e][a] = p[i][a] + (float)rnd_in(-wide, wide);
        }
        for (i = 0; i < 256; i++)
            for (a = 0; a < 3; a++) {
                if (round % 8 == 4) p[i][a] = floorf(2 * p[i][a]) / 2; /* on centres and borders */
                if (columns_rnd() < 0.002) p[i][a] = columns_rnd() < 0.5 ? NAN : (float)rnd_in(-1e6, 1e6);
                if (columns_rnd() < 0.002) p[i][a] = 1e30f;
                if (round % 8 == 6 && i % 4 == 3) p[i][a] = 0.25f * p[i - 1][a] + 0.75f * p[i - 2][a]; /* hardly any area */
            }
        for (i = 0; i < 512; i++)
            for (e = 0; e < 3; e++) index[i][e] = columns_rnd() < 0.001 ? 259 + rng() % 9 : columns_rnd() < 0.01 ? 258 : (4 * (i / 8) + rng() % 4);
        CHECK(insert(all, mode, p[0], index[0], 512, 259, still, &of_all) == VOXRT_OK);
        for (i = 0; i < 512; i++) CHECK(insert(single, mode, p[0], index[i], 1, 259, still, &of_single) == VOXRT_OK);
        for (z = 0; z < 64; z++)
            for (y = 0; y < 16; y++)
                for (x = 0; x < 32; x++) wrong += voxrt_columns_get(all, 0, x, y, z) != voxrt_columns_get(single, 0, x, y, z);
        CHECK_MSG(wrong == 0, "round %d: %u cells", round, wrong);
        CHECK(of_all.items == of_single.items && of_all.rejected == of_single.rejected && of_all.outside == of_single.outside);
        CHECK(of_all.rejected > 0 || of_all.outside > 0);
        voxrt_columns_destroy(all);
        voxrt_columns_destroy(single);
    }
}

/* Turned in space, triangles whose corners lie on a line have a normal that is rounding: none of their cells is lost. */
TEST(triangles_without_area_are_lines) {
    int round, k;
    columns_rng_state = 31;
    for (round = 0; round < 300; round++) {
        voxrt_columns *c = make(32, 16, 64);
        voxrt_columns_insert_desc d;
        voxrt_mesh m;
        float p[13][3]; /* the last one is not used: all that is used is read four at a time */
        const double s = sin(0.1 * round), k0 = cos(0.1 * round), s1 = sin(0.37 * round), k1 = cos(0.37 * round);
        const double size[3] = {32, 16, 64};
        uint32_t a, e, missing = 0;
        memset(&d, 0, sizeof d);
        memset(&m, 0, sizeof m);
        memset(p, 0, sizeof p);
        for (e = 0; e < 12; e++)
            for (a = 0; a < 3; a++)
                p[e][a] = e < 2 ? (float)floor(rnd_in(-20, 20) * 256) / 256 : e == 2 ? 0.5f * (p[0][a] + p[1][a]) : p[e - 3][a];
        d.to_world[0] = k0 * k1;
        d.to_world[1] = -s;
        d.to_world[2] = k0 * s1;
        d.to_world[4] = s * k1;
        d.to_world[5] = k0;
        d.to_world[6] = s * s1;
        d.to_world[8] = -s1;
        d.to_world[10] = k1;
        for (a = 0; a < 3; a++) d.to_world[4 * a + 3] = 0.5 * size[a];
        d.mode = VOXRT_COLUMNS_FAT;
        m.positions = p[0];
        m.vertex_count = 13;
        m.triangle_count = round & 1 ? 1 : 4;
        CHECK(voxrt_columns_insert(c, &d, &m, NULL) == VOXRT_OK);
        for (k = 0; k <= 2000; k++) {
            const double t = k / 2000.0;
            double q[3], w[3];
            for (a = 0; a < 3; a++) q[a] = (double)p[0][a] * (1 - t) + (double)p[1][a] * t;
            for (a = 0; a < 3; a++)
                w[a] = d.to_world[4 * a] * q[0] + d.to_world[4 * a + 1] * q[1] + d.to_world[4 * a + 2] * q[2] + d.to_world[4 * a + 3];
            if (w[0] < 0 || w[1] < 0 || w[2] < 0 || w[0] >= 32 || w[1] >= 16 || w[2] >= 64) continue;
            missing += !get(c, (int)w[0], (int)w[1], (int)w[2]);
        }
        CHECK_MSG(missing == 0, "line %d: %u points", round, missing);
        voxrt_columns_destroy(c);
    }
}

/* ---- closed meshes ---- */

typedef struct { float p[5000][3]; uint32_t index[10000][3]; uint32_t points, triangles; } closed; /* of up to 49 rings */

static void make_sphere(closed *m, double cx, double cy, double cz, double r, uint32_t rings) {
    uint32_t i, j, n = 2 * rings;
    m->points = m->triangles = 0;
    for (i = 0; i <= rings; i++)
        for (j = 0; j < n; j++) {
            const double a = 3.14159265358979 * i / rings, b = 3.14159265358979 * 2 * j / n;
            m->p[m->points][0] = (float)(cx + r * sin(a) * cos(b));
            m->p[m->points][1] = (float)(cy + r * sin(a) * sin(b));
            m->p[m->points++][2] = (float)(cz + r * cos(a));
        }
    for (j = 1; j < n; j++) { /* one point at each pole */
        memcpy(m->p[j], m->p[0], 12);
        memcpy(m->p[rings * n + j], m->p[rings * n], 12);
    }
    for (i = 0; i < rings; i++)
        for (j = 0; j < n; j++) {
            const uint32_t a = i * n + j, b = i * n + (j + 1) % n, t[2][3] = {{a, a + n, b}, {b, a + n, b + n}};
            memcpy(m->index[m->triangles], t, sizeof t);
            m->triangles += 2;
        }
}
static void make_cube(closed *m, const double c[3], double half, const double angle[3]) {
    static const uint32_t quad[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
    uint32_t i, a;
    for (i = 0; i < 8; i++) {
        double v[3] = {i & 1 ? half : -half, i & 2 ? half : -half, i & 4 ? half : -half};
        for (a = 0; a < 3; a++) {
            const uint32_t b = (a + 1) % 3, d = (a + 2) % 3;
            const double s = sin(angle[a]), k = cos(angle[a]), x = v[b] * k - v[d] * s;
            v[d] = v[b] * s + v[d] * k;
            v[b] = x;
        }
        for (a = 0; a < 3; a++) m->p[i][a] = (float)(c[a] + v[a]);
    }
    for (i = 0; i < 6; i++) {
        const uint32_t t[2][3] = {{quad[i][0], quad[i][1], quad[i][2]}, {quad[i][0], quad[i][2], quad[i][3]}};
        memcpy(m->index[2 * i], t, sizeof t);
    }
    m->points = 8;
    m->triangles = 12;
}

/* How many free cells can be reached from a corner of the grid through faces? */
static uint32_t flood(const voxrt_columns *c, uint32_t nx, uint32_t ny, uint32_t nz, uint8_t *seen) {
    uint32_t *todo = (uint32_t *)malloc(4 * (size_t)nx * ny * nz), n = 0, count = 0;
    memset(seen, 0, (size_t)nx * ny * nz);
    todo[n++] = 0;
    seen[0] = 1;
    while (n != 0) {
        const uint32_t i = todo[--n], x = i % nx, y = i / nx % ny, z = i / nx / ny;
        uint32_t f;
        count++;
        for (f = 0; f < 6; f++) {
            const uint32_t d = f & 1 ? 1u : 0xffffffffu, x2 = x + (f >> 1 == 0 ? d : 0), y2 = y + (f >> 1 == 1 ? d : 0);
            const uint32_t z2 = z + (f >> 1 == 2 ? d : 0), k = (z2 * ny + y2) * nx + x2;
            if (x2 >= nx || y2 >= ny || z2 >= nz || seen[k] || voxrt_columns_get(c, 0, x2, y2, z2)) continue;
            seen[k] = 1;
            todo[n++] = k;
        }
    }
    free(todo);
    return count;
}

TEST(closed_meshes_are_tight_and_fill) {
    static closed m;
    static uint8_t seen[64 * 32 * 64];
    int round, rounds = test_quick() ? 8 : 40, gaps = 0;
    columns_rng_state = 8;
    for (round = 0; round < rounds; round++) {
        voxrt_columns *c = make(64, 32, 64), *solid = make(64, 32, 64), *raster = make(64, 32, 64);
        const double center[3] = {rnd_in(28, 36), rnd_in(14, 18), rnd_in(28, 36)};
        const double angle[3] = {rnd_in(0, 6), rnd_in(0, 6), round % 5 == 0 ? 0.0174 : rnd_in(0, 6)};
        const uint32_t mid = ((uint32_t)center[2] * 32 + (uint32_t)center[1]) * 64 + (uint32_t)center[0];
        voxrt_columns_insert_stats stats;
        double volume = 0;
        uint32_t i, x, y, z, wrong = 0;
        voxrt_columns_info info, thin;
        memset(&stats, 0, sizeof stats);
        if (round % 2) make_sphere(&m, center[0], center[1], center[2], 12.3, 16);
        else make_cube(&m, center, 7.5, angle);
        CHECK(insert(c, VOXRT_COLUMNS_THIN, m.p[0], m.index[0], m.triangles, m.points, 0, NULL) == VOXRT_OK);
        CHECK(insert(raster, VOXRT_COLUMNS_RASTER, m.p[0], m.index[0], m.triangles, m.points, 0, NULL) == VOXRT_OK);
        CHECK(insert(solid, VOXRT_COLUMNS_SOLID, m.p[0], m.index[0], m.triangles, m.points, 0, &stats) == VOXRT_OK);
        (void)flood(c, 64, 32, 64, seen);
        CHECK(seen[mid] == 0);
        for (i = 0; i < m.triangles; i++) { /* volume by the divergence theorem */
            const float *a = m.p[m.index[i][0]], *b = m.p[m.index[i][1]], *d = m.p[m.index[i][2]];
            volume += ((double)a[0] * ((double)b[1] * (double)d[2] - (double)b[2] * (double)d[1]) - (double)a[1] *
                       ((double)b[0] * (double)d[2] - (double)b[2] * (double)d[0]) +
                       (double)a[2] * ((double)b[0] * (double)d[1] - (double)b[1] * (double)d[0])) / 6;
        }
        for (z = 0; z < 64; z++) /* what is not reached from outside, and the surface, is all of the solid */
            for (y = 0; y < 32; y++)
                for (x = 0; x < 64; x++)
                    wrong += voxrt_columns_get(solid, 0, x, y, z) != !seen[(z * 32 + y) * 64 + x];
        CHECK_MSG(wrong == 0, "mesh %d: %u cells", round, wrong);
        CHECK(stats.open_columns == 0);
        voxrt_columns_get_info(solid, &info);
        voxrt_columns_get_info(c, &thin);
        CHECK(fabs((double)info.cells - fabs(volume) - 0.5 * (double)thin.cells) < 0.25 * (double)thin.cells);
        (void)flood(raster, 64, 32, 64, seen);
        gaps += seen[mid];
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(solid);
        voxrt_columns_destroy(raster);
    }
    CHECK(gaps > rounds / 2); /* lines along one axis alone leave gaps: the test above could fail */
}

/* Cells of a body are those with their centre inside, which is neither more nor less than its volume; where it is thinner
   than a cell they are a wall that nothing gets through. */
TEST(bodies_are_as_wide_as_they_are) {
    static closed m;
    int round, rounds = test_quick() ? 12 : 60;
    double volume = 0, cells = 0, fat = 0;
    uint32_t beside = 0;
    columns_rng_state = 18;
    for (round = 0; round < rounds; round++) {
        voxrt_columns *c = make(64, 32, 64), *thin = make(64, 32, 64);
        const double center[3] = {rnd_in(28, 36), rnd_in(14, 18), rnd_in(28, 36)}, half = rnd_in(1.6, 4.0);
        const double angle[3] = {rnd_in(0, 6), rnd_in(0, 6), round % 5 == 0 ? 0.0 : rnd_in(0, 6)};
        voxrt_columns_insert_stats stats;
        voxrt_columns_info info;
        uint32_t i, x, y, z, wrong = 0;
        memset(&stats, 0, sizeof stats);
        if (round % 2) make_sphere(&m, center[0], center[1], center[2], half, 16);
        else make_cube(&m, center, half, angle);
        CHECK(insert(c, VOXRT_COLUMNS_BODY, m.p[0], m.index[0], m.triangles, m.points, round % 3 == 0, &stats) == VOXRT_OK);
        CHECK(insert(thin, VOXRT_COLUMNS_SOLID, m.p[0], m.index[0], m.triangles, m.points, 0, NULL) == VOXRT_OK);
        CHECK(stats.open_columns == 0 && stats.items == m.triangles && stats.outside == 0);
        {
            double v = 0;
            for (i = 0; i < m.triangles; i++) {
                const float *a = m.p[m.index[i][0]], *b = m.p[m.index[i][1]], *d = m.p[m.index[i][2]];
                v += ((double)a[0] * ((double)b[1] * (double)d[2] - (double)b[2] * (double)d[1]) - (double)a[1] *
                      ((double)b[0] * (double)d[2] - (double)b[2] * (double)d[0]) +
                      (double)a[2] * ((double)b[0] * (double)d[1] - (double)b[1] * (double)d[0])) / 6;
            }
            volume += fabs(v);
        }
        voxrt_columns_get_info(c, &info);
        cells += (double)info.cells;
        voxrt_columns_get_info(thin, &info);
        fat += (double)info.cells;
        for (z = 0; z < 64; z++) /* centres are in a ball a little larger, and all in one a little smaller are cells */
            for (y = 0; y < 32; y++)
                for (x = 0; x < 64; x++) {
                    const double dx = x + 0.5 - center[0], dy = y + 0.5 - center[1], dz = z + 0.5 - center[2];
                    const double d = sqrt(dx * dx + dy * dy + dz * dz);
                    const int is = voxrt_columns_get(c, 0, x, y, z);
                    if (round % 2 && !is) wrong += d < 0.98 * half - 0.01;
                    if (round % 2 && is) beside += d > half + 0.01;
                    wrong += is && !voxrt_columns_get(thin, 0, x, y, z);
                }
        CHECK_MSG(wrong == 0, "mesh %d: %u cells", round, wrong);
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(thin);
    }
    /* edges and tips that lie between two centres are cells, too */
    CHECK_MSG(fabs(cells / volume - 1) < 0.06 && fat > 1.35 * volume, "%g cells, %g with their surface, volume %g", cells, fat, volume);
    CHECK_MSG(beside < 0.04 * cells, "%u of %g", beside, cells);
    for (round = 0; round < rounds; round++) { /* plates of 0.2 to 2 cells that fill the grid */
        voxrt_columns *c = make(64, 32, 64);
        const double thick = rnd_in(0.1, 1.0), n[3] = {rnd_in(-1, 1), rnd_in(-1, 1), round % 4 ? rnd_in(-1, 1) : 0.0};
        const double l = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        double u[3], v[3];
        uint32_t i, k, x, y, z, through = 0, free_cells = 0;
        voxrt_columns_insert_stats stats;
        u[0] = n[1] / sqrt(n[0] * n[0] + n[1] * n[1]);
        u[1] = -n[0] / sqrt(n[0] * n[0] + n[1] * n[1]);
        u[2] = 0;
        for (k = 0; k < 3; k++) v[k] = (n[(k + 1) % 3] * u[(k + 2) % 3] - n[(k + 2) % 3] * u[(k + 1) % 3]) / l;
        make_cube(&m, n, 1.0, n); /* for its triangles */
        for (i = 0; i < 8; i++)
            for (k = 0; k < 3; k++)
                m.p[i][k] = (float)((k == 1 ? 16.2 : 32.3) + (i & 1 ? 90 : -90) * u[k] + (i & 2 ? 90 : -90) * v[k] + (i & 4 ? thick : -thick) * n[k] / l);
        memset(&stats, 0, sizeof stats);
        CHECK(insert(c, VOXRT_COLUMNS_BODY, m.p[0], m.index[0], m.triangles, m.points, 0, &stats) == VOXRT_OK);
        CHECK(stats.open_columns == 0); /* they end above the grid */
        for (z = 0; z < 64; z++) /* no two free cells side by side have it between them */
            for (y = 0; y < 32; y++)
                for (x = 0; x + 1 < 64; x++) {
                    const double a = ((x + 0.5 - 32.3) * n[0] + (y + 0.5 - 16.2) * n[1] + (z + 0.5 - 32.3) * n[2]) / l, b = a + n[0] / l;
                    if (voxrt_columns_get(c, 0, x, y, z) || voxrt_columns_get(c, 0, x + 1, y, z)) continue;
                    free_cells++;
                    through += (a < 0) != (b < 0);
                }
        CHECK_MSG(through == 0 && free_cells > 1000, "plate %d: %u ways through, %u free", round, through, free_cells);
        voxrt_columns_destroy(c);
    }
}

TEST(open_meshes_get_no_inside) {
    static closed m;
    voxrt_columns *c = make(64, 32, 64), *thin = make(64, 32, 64);
    voxrt_columns_insert_stats stats;
    voxrt_columns_info a, b;
    memset(&stats, 0, sizeof stats);
    make_sphere(&m, 32, 16, 32, 12.3, 16);
    CHECK(insert(c, VOXRT_COLUMNS_SOLID, m.p[0], m.index[0], m.triangles / 2, m.points, 0, &stats) == VOXRT_OK);
    CHECK(insert(thin, VOXRT_COLUMNS_THIN, m.p[0], m.index[0], m.triangles / 2, m.points, 0, NULL) == VOXRT_OK);
    voxrt_columns_get_info(c, &a);
    voxrt_columns_get_info(thin, &b);
    CHECK(stats.open_columns > 400 && a.cells == b.cells);
    voxrt_columns_destroy(c);
    voxrt_columns_destroy(thin);
}

/* Points of a lattice on each triangle: cells that they are in are touched by it; close ones close a mesh, those that lie
   far apart leave gaps, as an atlas that is too coarse does; small triangles cost by their area. */
TEST(samples_of_surfaces) {
    static closed m, fine;
    static uint8_t seen[64 * 32 * 64];
    int round, rounds = test_quick() ? 6 : 24, gaps = 0;
    columns_rng_state = 77;
    for (round = 0; round < rounds; round++) {
        voxrt_columns *c = make(64, 32, 64), *fat = make(64, 32, 64), *thin = make(64, 32, 64);
        const double center[3] = {rnd_in(28, 36), rnd_in(14, 18), rnd_in(28, 36)};
        const double angle[3] = {rnd_in(0, 6), rnd_in(0, 6), rnd_in(0, 6)};
        const uint32_t mid = ((uint32_t)center[2] * 32 + (uint32_t)center[1]) * 64 + (uint32_t)center[0];
        uint32_t x, y, z, beside = 0, lost = 0, many = 0;
        voxrt_columns_insert_desc d;
        voxrt_mesh mesh;
        if (round % 2) make_sphere(&m, center[0], center[1], center[2], 12.3, 16);
        else make_cube(&m, center, 7.5, angle);
        CHECK(insert(c, VOXRT_COLUMNS_SAMPLES, m.p[0], m.index[0], m.triangles, m.points, 0, NULL) == VOXRT_OK);
        CHECK(insert(fat, VOXRT_COLUMNS_FAT, m.p[0], m.index[0], m.triangles, m.points, 0, NULL) == VOXRT_OK);
        CHECK(insert(thin, VOXRT_COLUMNS_THIN, m.p[0], m.index[0], m.triangles, m.points, 0, NULL) == VOXRT_OK);
        for (z = 0; z < 64; z++)
            for (y = 0; y < 32; y++)
                for (x = 0; x < 64; x++) {
                    beside += voxrt_columns_get(c, 0, x, y, z) && !voxrt_columns_get(fat, 0, x, y, z);
                    lost += voxrt_columns_get(thin, 0, x, y, z) && !voxrt_columns_get(c, 0, x, y, z);
                    many += (uint32_t)voxrt_columns_get(thin, 0, x, y, z);
                }
        CHECK_MSG(beside == 0, "%u cells beside the surface", beside);
        CHECK_MSG(lost * 100 < many, "mesh %d: %u of %u cells lost", round, lost, many);
        memset(&d, 0, sizeof d);
        memset(&mesh, 0, sizeof mesh);
        d.mode = VOXRT_COLUMNS_SAMPLES;
        mesh.positions = m.p[0];
        mesh.vertex_count = m.points;
        mesh.indices = m.index[0];
        mesh.triangle_count = m.triangles;
        for (x = 0; x < 2; x++) {
            d.spacing = x == 0 ? 0.25f : 2.0f;
            voxrt_columns_clear(c, 1);
            CHECK(voxrt_columns_insert(c, &d, &mesh, NULL) == VOXRT_OK);
            (void)flood(c, 64, 32, 64, seen);
            if (x == 0) CHECK_MSG(seen[mid] == 0, "mesh %d leaks", round);
            else gaps += seen[mid];
        }
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(fat);
        voxrt_columns_destroy(thin);
    }
    CHECK(gaps == rounds);
    { /* a ball of many triangles in a grid where it is 5 cells wide: nearly all of its cells by fewer points */
        voxrt_columns *c = make(64, 32, 64), *thin = make(64, 32, 64);
        voxrt_columns_insert_desc d;
        voxrt_mesh mesh;
        voxrt_columns_info a, b;
        uint32_t i, points = 0;
        make_sphere(&fine, 16, 16, 32, 2.5, 40);
        CHECK(insert(c, VOXRT_COLUMNS_SAMPLES, fine.p[0], fine.index[0], fine.triangles, fine.points, 0, NULL) == VOXRT_OK);
        CHECK(insert(thin, VOXRT_COLUMNS_THIN, fine.p[0], fine.index[0], fine.triangles, fine.points, 0, NULL) == VOXRT_OK);
        voxrt_columns_get_info(c, &a);
        voxrt_columns_get_info(thin, &b);
        CHECK_MSG(a.cells >= b.cells && a.cells < 2 * b.cells, "%u cells, thin %u", (unsigned)a.cells, (unsigned)b.cells);
        for (i = 0; i < fine.triangles; i++) {
            double p[3][3];
            uint16_t l[2] = {9, 9};
            uint32_t e, k;
            for (e = 0; e < 3; e++) for (k = 0; k < 3; k++) p[e][k] = (double)fine.p[fine.index[i][e]][k];
            voxrti_lattice_make((const double (*)[3])p, 2.0, i, l);
            CHECK(l[0] <= 1);
            points += l[0];
        }
        CHECK_MSG(points < fine.triangles / 2 && points > 400, "%u points for %u triangles", points, fine.triangles);
        memset(&d, 0, sizeof d);
        memset(&mesh, 0, sizeof mesh);
        d.mode = VOXRT_COLUMNS_SAMPLES;
        d.spacing = 100.0f;
        CHECK(voxrt_columns_insert(c, &d, &mesh, NULL) == VOXRT_ERR_INVALID_ARG);
        d.spacing = NAN;
        CHECK(voxrt_columns_insert(c, &d, &mesh, NULL) == VOXRT_ERR_INVALID_ARG);
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(thin);
    }
}

TEST(samples_far_apart) { /* points are the same in a box that ends and in one that goes on behind it */
    static const uint32_t wide[3] = {64, 64, 512};
    uint32_t round, axis, k, x, y, z, points = 0, differ = 0;
    columns_rng_state = 23;
    for (round = 0; round < 60; round++) {
        voxrt_columns *c[2] = {NULL, NULL};
        float p[3][3];
        axis = round & 1u;
        for (k = 0; k < 9; k++) p[k / 3][k % 3] = (float)(60 * columns_rnd() + 2);
        p[1][axis] = (float)(200 + 300 * columns_rnd()); /* from the box out of it; the longest edge begins within it */
        p[2][axis] = (float)(100 + 50 * columns_rnd());
        for (k = 0; k < 2; k++) {
            voxrt_columns_desc d;
            voxrt_columns_insert_desc in;
            voxrt_mesh mesh;
            memset(&d, 0, sizeof d);
            memset(&in, 0, sizeof in);
            memset(&mesh, 0, sizeof mesh);
            d.size_x = wide[k == 0 ? 0 : 2 - axis];
            d.size_y = wide[k == 0 ? 0 : 1 + axis];
            d.size_z = 64;
            d.depth_axis_plus_1 = 3;
            d.box_max[0] = d.size_x;
            d.box_max[1] = d.size_y;
            d.box_max[2] = 64;
            in.mode = VOXRT_COLUMNS_SAMPLES;
            in.spacing = (float)(0.5 + round / 3);
            mesh.positions = p[0];
            mesh.vertex_count = 3;
            mesh.triangle_count = 1;
            CHECK(voxrt_columns_create(&d, &c[k]) == VOXRT_OK && voxrt_columns_insert(c[k], &in, &mesh, NULL) == VOXRT_OK);
        }
        for (x = 0; x < 64; x++)
            for (y = 0; y < 64; y++)
                for (z = 0; z < 64; z++) {
                    points += (uint32_t)voxrt_columns_get(c[1], 0, x, y, z);
                    differ += voxrt_columns_get(c[0], 0, x, y, z) != voxrt_columns_get(c[1], 0, x, y, z);
                }
        for (k = 0; k < 2; k++) voxrt_columns_destroy(c[k]);
    }
    CHECK_MSG(differ == 0 && points > 1000, "%u of %u cells", differ, points);
}

TEST(triangles_far_outside) { /* a floor of 10^6 cells, cut before it is snapped; neighbours leave no gap */
    voxrt_columns *c = make(64, 32, 64);
    const float p[4][3] = {{-1e6f, -1e6f, 10.3f}, {1e6f, -1e6f, 10.3f}, {1e6f, 1e6f, 10.3f}, {-1e6f, 1e6f, 10.3f}};
    const uint32_t index[6] = {0, 1, 2, 0, 2, 3};
    voxrt_columns_info info;
    CHECK(insert(c, VOXRT_COLUMNS_THIN, p[0], index, 2, 4, 0, NULL) == VOXRT_OK);
    voxrt_columns_get_info(c, &info);
    CHECK_EQ_U64(info.cells, 64 * 32);
    voxrt_columns_clear(c, 1);
    CHECK(insert(c, VOXRT_COLUMNS_FAT, p[0], index, 2, 4, 0, NULL) == VOXRT_OK);
    voxrt_columns_get_info(c, &info);
    CHECK_EQ_U64(info.cells, 64 * 32);
    voxrt_columns_clear(c, 1);
    CHECK(insert(c, VOXRT_COLUMNS_SAMPLES, p[0], index, 2, 4, 0, NULL) == VOXRT_OK);
    voxrt_columns_get_info(c, &info);
    CHECK_EQ_U64(info.cells, 64 * 32);
    { /* as many rows as a lattice can have, of which few are in the box */
        const float q[3][3] = {{-3000.0f, -2000.0f, 10.3f}, {4900.0f, -2000.0f, 10.3f}, {1000.0f, 4000.0f, 10.3f}};
        voxrt_columns_clear(c, 1);
        CHECK(insert(c, VOXRT_COLUMNS_SAMPLES, q[0], index, 1, 3, 0, NULL) == VOXRT_OK);
        voxrt_columns_get_info(c, &info);
        CHECK_EQ_U64(info.cells, 64 * 32);
    }
    voxrt_columns_destroy(c);
}

/* Closed tetrahedra with corners up to 10^7 cells above and below the grid: THIN cells are part of SOLID ones, and what
   else there is has its centre inside, by its side of the four planes. */
TEST(solids_far_outside) {
    static const uint32_t index[12] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3};
    int round;
    columns_rng_state = 77;
    for (round = 0; round < 60; round++) {
        voxrt_columns *solid = make(32, 16, 64), *thin = make(32, 16, 64);
        voxrt_columns_insert_stats stats;
        const double reach = pow(10.0, rnd_in(4.5, 7.0));
        uint32_t a, b, lost = 0, wrong = 0, within = 0;
        int x, y, z;
        float p[4][3];
        memset(&stats, 0, sizeof stats);
        for (a = 0; a < 4; a++) {
            p[a][0] = (float)(16 + rnd_in(-12, 12));
            p[a][1] = (float)(8 + rnd_in(-12, 12));
            p[a][2] = (float)(32 + rnd_in(-20, 20));
        }
        p[round & 3][2] = (float)(round & 4 ? reach : -reach);
        if (round & 8) p[(round + 1) & 3][2] = (float)(round & 16 ? reach : -reach);
        if (round % 5 == 0) p[(round + 2) & 3][0] = (float)reach;
        CHECK(insert(solid, VOXRT_COLUMNS_SOLID, p[0], index, 4, 4, 0, &stats) == VOXRT_OK);
        CHECK(insert(thin, VOXRT_COLUMNS_THIN, p[0], index, 4, 4, 0, NULL) == VOXRT_OK);
        CHECK_EQ_U64(stats.open_columns, 0);
        for (z = 0; z < 64; z++)
            for (y = 0; y < 16; y++)
                for (x = 0; x < 32; x++) {
                    const double q[3] = {x + 0.5, y + 0.5, z + 0.5};
                    uint32_t plus = 0, minus = 0;
                    lost += (uint32_t)(get(thin, x, y, z) && !get(solid, x, y, z));
                    for (a = 0; a < 4; a++) {
                        double u[3], v[3], w[3], n[3], side, way;
                        for (b = 0; b < 3; b++) {
                            u[b] = (double)p[index[3 * a + 1]][b] - (double)p[index[3 * a]][b];
                            v[b] = (double)p[index[3 * a + 2]][b] - (double)p[index[3 * a]][b];
                            w[b] = q[b] - (double)p[index[3 * a]][b];
                        }
                        for (b = 0; b < 3; b++) n[b] = u[(b + 1) % 3] * v[(b + 2) % 3] - u[(b + 2) % 3] * v[(b + 1) % 3];
                        side = n[0] * w[0] + n[1] * w[1] + n[2] * w[2];
                        way = 0.02 * (fabs(n[0]) + fabs(n[1]) + fabs(n[2])); /* corners are moved by up to 1/512 */
                        plus += side > way;
                        minus += side < 0 - way;
                    }
                    within += plus == 4 || minus == 4;
                    if (plus == 4 || minus == 4) wrong += (uint32_t)!get(solid, x, y, z);
                    if (plus > 0 && minus > 0 && !get(thin, x, y, z)) wrong += (uint32_t)(get(solid, x, y, z) != 0);
                }
        CHECK_MSG(lost == 0 && wrong == 0, "round %d: %u thin cells are lost, %u are wrong of %u", round, lost, wrong, within);
        voxrt_columns_destroy(solid);
        voxrt_columns_destroy(thin);
    }
}

TEST(threads_and_order_do_not_matter) {
    static closed m;
    voxrt_columns *c[4];
    uint32_t i, mode;
    make_sphere(&m, 32, 16, 32, 14.3, 40);
    for (mode = 0; mode < 4; mode++) {
        for (i = 0; i < 4; i++) {
            voxrt_columns_insert_desc d;
            voxrt_mesh mesh;
            memset(&d, 0, sizeof d);
            memset(&mesh, 0, sizeof mesh);
            c[i] = make(64, 32, 64);
            d.mode = (voxrt_columns_mode)mode;
            d.env.thread_count = i == 0 ? 1 : i + 1;
            mesh.positions = m.p[0];
            mesh.vertex_count = m.points;
            mesh.indices = m.index[0];
            mesh.triangle_count = m.triangles;
            CHECK(voxrt_columns_insert(c[i], &d, &mesh, NULL) == VOXRT_OK);
            voxrt_columns_update(c[i]);
            if (i > 0) CHECK(memcmp(c[0]->bits, c[i]->bits, 4 * (size_t)c[0]->start[c[0]->levels - 1]) == 0);
            if (i == 1) { /* the other way round */
                uint32_t k;
                for (k = 0; k < m.triangles / 2; k++) {
                    uint32_t t[3];
                    memcpy(t, m.index[k], 12);
                    memcpy(m.index[k], m.index[m.triangles - 1 - k], 12);
                    memcpy(m.index[m.triangles - 1 - k], t, 12);
                }
            }
        }
        for (i = 0; i < 4; i++) voxrt_columns_destroy(c[i]);
    }
}

/* ---- hierarchy ---- */

static uint32_t hierarchy_errors(const voxrt_columns *c) {
    uint32_t l, x, y, z, wrong = 0;
    for (l = 1; l < c->levels; l++)
        for (y = 0; y < c->rows[l]; y++)
            for (x = 0; x < 1u << c->row_log[l]; x++)
                for (z = 0; z < c->size[2]; z++) {
                    const uint32_t x2 = c->row_log[l - 1] ? 2 * x : 0, y2 = c->rows[l - 1] > 1 ? 2 * y : 0;
                    const int any = voxrt_columns_get(c, l - 1, x2, y2, z) | voxrt_columns_get(c, l - 1, x2 + 1, y2, z) |
                        voxrt_columns_get(c, l - 1, x2, y2 + 1, z) | voxrt_columns_get(c, l - 1, x2 + 1, y2 + 1, z);
                    wrong += any != voxrt_columns_get(c, l, x, y, z);
                }
    return wrong;
}

TEST(still_and_moving) { /* frame by frame the same as all anew; every level is the OR of the one below */
    static const uint32_t size[3][3] = {{64, 8, 64}, {4, 128, 64}, {32, 32, 256}};
    uint32_t s, frame, frames = test_quick() ? 10 : 70;
    columns_rng_state = 11;
    for (s = 0; s < 3; s++) {
        voxrt_columns *c = make(size[s][0], size[s][1], size[s][2]);
        voxrt_columns *still = make(size[s][0], size[s][1], size[s][2]);
        voxrt_columns_insert_desc d;
        float p[600][3];
        uint32_t i, a;
        memset(&d, 0, sizeof d);
        d.still = 1;
        for (i = 0; i < 600; i++) for (a = 0; a < 3; a++) p[i][a] = (float)rnd_in(0, size[s][a]);
        CHECK(voxrt_columns_insert_points(c, &d, p[0], 0, 300, NULL) == VOXRT_OK);
        CHECK(voxrt_columns_insert_points(still, NULL, p[0], 0, 300, NULL) == VOXRT_OK);
        for (frame = 0; frame < frames; frame++) {
            voxrt_columns *anew = make(size[s][0], size[s][1], size[s][2]);
            const uint32_t n = frame % 5 == 4 ? 0 : rng() % 200;
            for (i = 300; i < 600; i++) for (a = 0; a < 3; a++) p[i][a] = (float)rnd_in(-1, size[s][a] + 1.0);
            voxrt_columns_clear(c, 0);
            CHECK(voxrt_columns_insert_points(c, NULL, p[300], 0, n, NULL) == VOXRT_OK);
            if (frame % 3 != 1) voxrt_columns_update(c); /* clearing and inserting twice between updates is fine */
            CHECK(voxrt_columns_insert_points(anew, NULL, p[0], 0, 300, NULL) == VOXRT_OK);
            CHECK(voxrt_columns_insert_points(anew, NULL, p[300], 0, n, NULL) == VOXRT_OK);
            anew->all_changed = 1;
            voxrt_columns_update(anew);
            if (frame % 3 != 1) {
                CHECK(memcmp(anew->bits, c->bits, 4 * ((size_t)c->start[c->levels - 1] + c->words)) == 0);
                if (frame < 4) CHECK(hierarchy_errors(c) == 0);
            }
            voxrt_columns_destroy(anew);
        }
        voxrt_columns_clear(c, 0);
        voxrt_columns_update(c);
        voxrt_columns_update(still);
        CHECK(memcmp(still->bits, c->bits, 4 * ((size_t)c->start[c->levels - 1] + c->words)) == 0);
        voxrt_columns_clear(c, 1);
        voxrt_columns_update(c);
        for (i = 0; i < c->start[c->levels - 1] + c->words; i++) if (c->bits[i] != 0) break;
        CHECK(i == c->start[c->levels - 1] + c->words);
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(still);
    }
}

/* ---- rays ---- */

typedef struct { int hit, tie, cell[3]; double t; } plain;

/* Cell by cell in double precision, on the ray that the library has made of it. tie: somewhere on the way two cells were
   equally near, or a border, to 1e-4 of a cell. */
static plain step_plain(const voxrt_columns *c, const voxrti_column_ray *r) {
    plain out;
    double o[3], d[3], t = 0, inv[3];
    int a, cell[3], steps;
    memset(&out, 0, sizeof out);
    for (a = 0; a < 3; a++) {
        o[a] = (double)r->o[a];
        d[a] = (double)r->d[a];
        inv[a] = d[a] != 0 ? 1 / d[a] : 0;
        cell[a] = (int)o[a];
        if (fabs(o[a] - floor(o[a] + 0.5)) < 1e-4) out.tie = 1;
    }
    for (steps = 0; steps < 100000; steps++) {
        double next = 1e300, second = 1e300;
        int axis = 0;
        if (get(c, cell[0], cell[1], cell[2])) {
            out.hit = 1;
            out.t = t;
            memcpy(out.cell, cell, sizeof cell);
            return out;
        }
        for (a = 0; a < 3; a++) {
            const double u = d[a] != 0 ? ((cell[a] + (d[a] > 0)) - o[a]) * inv[a] : 1e300;
            if (u < next) {
                second = next;
                next = u;
                axis = a;
            } else if (u < second) {
                second = u;
            }
        }
        if (second - next < 1e-4 || fabs(next - (double)r->t_max) < 1e-4) out.tie = 1;
        if (next > (double)r->t_max) return out;
        t = next;
        cell[axis] += d[axis] > 0 ? 1 : -1;
        if (cell[axis] < 0 || cell[axis] >= (int)c->size[axis]) return out;
    }
    return out;
}

static void hall(voxrt_columns *c, double density) { /* walls, pillars and dust */
    voxrti_insert in;
    uint32_t x, y, z;
    memset(&in, 0, sizeof in);
    in.columns = c;
    for (y = 0; y < c->size[1]; y++)
        for (x = 0; x < c->size[0]; x++) {
            if (x == 0 || y == 0 || x + 1 == c->size[0] || y + 1 == c->size[1]) voxrti_insert_run(&in, x, y, 0, c->size[2] - 1);
            if (x % 16 < 3 && y % 16 < 3) voxrti_insert_run(&in, x, y, 0, c->size[2] - 5);
            voxrti_insert_run(&in, x, y, 1, 1);
            for (z = 0; z < c->size[2]; z++) if (columns_rnd() < density) voxrti_insert_run(&in, x, y, z, z);
        }
    voxrt_columns_update(c);
}

static voxrt_ray random_ray(const voxrt_columns *c, uint32_t kind) {
    static const float odd[6] = {0.0f, -0.0f, 1e-40f, 1e-20f, 1.0f, -1.0f};
    voxrt_ray r;
    uint32_t a;
    memset(&r, 0, sizeof r);
    r.t_max = kind % 3 == 0 ? INFINITY : (float)rnd_in(0, 100);
    for (a = 0; a < 3; a++) {
        r.org[a] = (float)rnd_in(0, c->size[a]);
        r.dir[a] = (float)rnd_in(-1, 1);
        if (kind >= 4) r.org[a] = (float)floor((double)r.org[a] * 2) / 2;          /* on faces, edges, corners, centres */
        if (kind >= 6) r.dir[a] = (float)floor((double)r.dir[a] * 3 + 0.5) / 3;    /* diagonals, axes */
        if (kind == 8) r.dir[a] = odd[rng() % 6];
        if (kind == 9) r.org[a] = (float)rnd_in(-1000, 1000);
        if (kind == 10) r.dir[a] *= 1e-30f;
        if (kind == 11) r.dir[a] *= 1e30f;
    }
    return r;
}

TEST(rays_hit_what_plain_stepping_hits) {
    static const uint32_t size[3][3] = {{128, 64, 128}, {256, 256, 128}, {16, 16, 256}};
    uint32_t s, kind, i, n = test_quick() ? 300 : 12000;
    uint64_t counted = 0, missed = 0, extra = 0, other = 0, untied = 0;
    columns_rng_state = 21;
    for (s = 0; s < 3; s++) {
        voxrt_columns *c = make(size[s][0], size[s][1], size[s][2]);
        hall(c, s == 1 ? 0.0005 : 0.003);
        for (kind = 0; kind < 12; kind++) {
            uint64_t wrong = 0;
            for (i = 0; i < n; i++) {
                voxrt_ray ray = random_ray(c, kind);
                voxrti_column_ray r;
                voxrt_column_hit hit;
                plain want;
                const int open = voxrti_column_ray_open(c, &ray, &r);
                if (voxrt_columns_trace(c, NULL, &ray, &hit, 1) != VOXRT_OK) CHECK(0);
                if (open != 1) {
                    if (hit.t < INFINITY) CHECK_MSG(0, "a hit outside");
                    continue;
                }
                want = step_plain(c, &r);
                counted++;
                if (want.hit != (hit.t < INFINITY)) {
                    wrong++;
                    untied += !want.tie;
                    if (want.hit) missed++;
                    else extra++;
                } else if (want.hit && (want.cell[0] != (int)hit.cell[0] || want.cell[1] != (int)hit.cell[1] ||
                                        want.cell[2] != (int)hit.cell[2])) {
                    wrong++;
                    untied += !want.tie;
                    other++;
                } else if (want.hit) {
                    const double t = r.t_in + want.t * r.per_t;
                    if (fabs((double)hit.t - t) > 1e-4 * r.per_t + 1e-6 * fabs(t)) CHECK_MSG(0, "t %g, not %g", (double)hit.t, t);
                }
            }
            if (kind < 4) CHECK_MSG(wrong <= n / 2000, "kind %u: %lu of %u", kind, (unsigned long)wrong, n);
        }
        voxrt_columns_destroy(c);
    }
    CHECK(counted > n * 20);
    CHECK_MSG(untied == 0, "%lu rays differ without a tie (%lu missed, %lu extra, %lu other cells of %lu)",
              (unsigned long)untied, (unsigned long)missed, (unsigned long)extra, (unsigned long)other, (unsigned long)counted);
}

TEST(segments_from_both_ends) { /* what lies between two points does not depend on where one looks from */
    const uint32_t n = test_quick() ? 4000 : 40000;
    voxrt_columns *c = make(64, 64, 64);
    uint32_t i, k, a, differ = 0, hit = 0;
    columns_rng_state = 61;
    hall(c, 0.01);
    for (i = 0; i < n; i++) {
        voxrt_ray r[2];
        uint8_t dark[2];
        memset(r, 0, sizeof r);
        for (a = 0; a < 3; a++) {
            const float p = (float)rnd_in(1, 63), q = (float)rnd_in(1, 63);
            for (k = 0; k < 2; k++) {
                r[k].org[a] = k ? q : p;
                r[k].dir[a] = k ? p - q : q - p;
                r[k].t_max = 1.0f;
            }
        }
        CHECK(voxrt_columns_occluded(c, NULL, r, dark, 2) == VOXRT_OK);
        differ += dark[0] != dark[1];
        hit += dark[0];
    }
    CHECK(hit > n / 20 && hit < n - n / 20);
    CHECK_MSG(differ <= n / 10000, "%u of %u", differ, n);
    voxrt_columns_destroy(c);
}

TEST(large_grids) { /* 1024 x 1024: more levels than a register of AVX2 has lanes */
    voxrt_columns *c = make(1024, 1024, 64);
    const uint32_t n = test_quick() ? 300 : 3000;
    voxrti_insert in;
    uint32_t i, wrong = 0, hits = 0;
    memset(&in, 0, sizeof in);
    in.columns = c;
    columns_rng_state = 62;
    for (i = 0; i < 20000; i++) {
        const uint32_t k = rng() % 60;
        voxrti_insert_run(&in, rng() % 1024, rng() % 1024, k, k + rng() % 4);
    }
    voxrt_columns_update(c);
    CHECK(hierarchy_errors(c) == 0);
    for (i = 0; i < n; i++) {
        const voxrt_ray ray = random_ray(c, i % 4);
        voxrti_column_ray r;
        voxrt_column_hit hit;
        plain want;
        const int open = voxrti_column_ray_open(c, &ray, &r);
        CHECK(voxrt_columns_trace(c, NULL, &ray, &hit, 1) == VOXRT_OK);
        if (open != 1) continue;
        want = step_plain(c, &r);
        hits += want.hit != 0;
        if (want.hit != (hit.t < INFINITY) || (want.hit && (want.cell[0] != (int)hit.cell[0] || want.cell[1] != (int)hit.cell[1] ||
                                                            want.cell[2] != (int)hit.cell[2])))
            wrong += !want.tie;
    }
    CHECK_MSG(wrong == 0 && hits > n / 40, "%u wrong, %u hits of %u", wrong, hits, n);
    voxrt_columns_destroy(c);
}

#if VOXRTI_AVX2
TEST(planes_may_leave_two_intervals) { /* seldom: then the first cell on the way is looked for one by one */
    static voxrti_column_const k;
    static uint32_t bits[8 * 4];
    uint32_t turn, i, p, w, met = 0;
    columns_rng_state = 71;
    k.bits = (const int *)(const void *)bits;
    for (turn = 0; turn < 400; turn++) {
        int32_t column[8], gone[4][8], ka[8], lo[8], hi[8], want[8];
        k.planes = 1 + turn % 2;
        for (i = 0; i < 8; i++) {
            int32_t at;
            column[i] = (int32_t)(4 * i);
            for (w = 0; w < 4; w++) bits[4 * i + w] = rng() & rng() & rng() & rng();
            lo[i] = (int32_t)(rng() % 128);
            hi[i] = lo[i] + (int32_t)(rng() % (128 - (uint32_t)lo[i]));
            ka[i] = rng() % 2 ? lo[i] : hi[i];
            for (p = 0; p < 2 * k.planes; p++) gone[p][i] = (int32_t)(rng() % 128);
            want[i] = -1;
            for (at = ka[i]; at >= lo[i] && at <= hi[i] && want[i] < 0; at += ka[i] == lo[i] ? 1 : -1) {
                int out = 0;
                for (p = 0; p < k.planes; p++) out |= at >= gone[2 * p][i] && at <= gone[2 * p + 1][i];
                if (!out && (bits[4 * i + ((uint32_t)at >> 5)] >> ((uint32_t)at & 31u) & 1u) != 0) want[i] = at;
            }
        }
        voxrti_column_apart(&k, column, (const int32_t (*)[8])gone, ka, lo, hi);
        for (i = 0; i < 8; i++) {
            if (want[i] < 0) CHECK(lo[i] > hi[i]);
            else CHECK(lo[i] == want[i] && hi[i] == want[i]);
            met += want[i] >= 0;
        }
    }
    CHECK(met > 400 && met < 3200);
}
#endif

static void rays_in_all_ways(uint32_t depth) {
    enum { N = 4000 };
    static voxrt_ray ray[N];
    static voxrt_column_hit a[N], b[N];
    static uint8_t dark[N];
    static float normal[N][3], end[N][3];
    voxrt_columns *c = make(128, 64, depth);
    voxrt_columns_trace_desc d;
    voxrt_stats sa, sb;
    const uint32_t many = depth == 128 ? N : N / 5;
    uint32_t i, k, isa, level, wrong = 0;
    columns_rng_state = 31;
    hall(c, 0.002);
    for (i = 0; i < many; i++) {
        ray[i] = random_ray(c, i % 12);
        if (i % 97 == 0) ray[i].dir[0] = NAN;
        if (i % 89 == 0) ray[i].t_min = 5.0f;
        for (k = 0; k < 3; k++) {
            normal[i][k] = (float)rnd_in(-1, 1);
            end[i][k] = i % 5 == 0 ? 0.0f : (float)rnd_in(-1, 1);
        }
        if (i % 7 == 0) normal[i][0] = normal[i][1] = 0.0f;
    }
    for (k = 0; k < 3; k++) { /* no planes, one, two */
        memset(&d, 0, sizeof d);
        memset(&sa, 0, sizeof sa);
        d.normals = k > 0 ? normal[0] : NULL;
        d.end_normals = k > 1 ? end[0] : NULL;
        d.isa = VOXRT_ISA_SCALAR;
        d.stats = &sa;
        CHECK(voxrt_columns_trace(c, &d, ray, a, many) == VOXRT_OK);
        CHECK(sa.rays == many && sa.hits > many / 4 && sa.bad_rays >= many / 97 && sa.steps > sa.hits);
        for (isa = VOXRT_ISA_SCALAR; isa <= VOXRT_ISA_AVX512; isa++)
            for (level = 0; level < 9; level += 2) {
                memset(&sb, 0, sizeof sb);
                d.isa = (voxrt_isa)isa;
                d.start_level_plus_1 = level < 8 ? level : 0xffffffffu;
                d.stats = &sb;
                CHECK(voxrt_columns_trace(c, &d, ray, b, many) == VOXRT_OK);
                CHECK(voxrt_columns_occluded(c, &d, ray, dark, many) == VOXRT_OK);
                CHECK(sb.rays == 2 * sa.rays && sb.hits == 2 * sa.hits && sb.bad_rays == 2 * sa.bad_rays);
                for (i = 0; i < many; i++) {
                    wrong += memcmp(&a[i], &b[i], sizeof a[i]) != 0;
                    wrong += dark[i] != (a[i].t < INFINITY);
                }
            }
        for (isa = VOXRT_ISA_AVX2; isa <= VOXRT_ISA_AVX512; isa++) { /* few at a time: 1 to 70 of them */
            uint32_t n = 1;
            d.isa = (voxrt_isa)isa;
            d.stats = NULL;
            for (i = 0; i + n <= many / 2; i += n, n = n % 70 + 1) {
                d.normals = k > 0 ? normal[i] : NULL;
                d.end_normals = k > 1 ? end[i] : NULL;
                CHECK(voxrt_columns_trace(c, &d, ray + i, b, n) == VOXRT_OK && voxrt_columns_occluded(c, &d, ray + i, dark, n) == VOXRT_OK);
                wrong += memcmp(&a[i], b, n * sizeof a[0]) != 0;
                for (level = 0; level < n; level++) wrong += dark[level] != (a[i + level].t < INFINITY);
            }
        }
    }
    CHECK_MSG(wrong == 0, "%u differ", wrong);
    voxrt_columns_destroy(c);
}

TEST(rays_in_all_ways_the_same) { /* instruction sets, start levels, any hit, groups of rays; columns of 2, 4 and 8 words */
    uint32_t depth;
    for (depth = 64; depth <= 256; depth *= 2) rays_in_all_ways(depth);
}

TEST(rays_explained) { /* what a ray looks at follows on each other, is what the columns hold, and ends at its hit */
    enum { N = 1500, MOST = 400 };
    static voxrt_column_step s[MOST];
    voxrt_columns *c = make(128, 64, 128);
    voxrt_columns_trace_desc d;
    uint32_t i, hits = 0;
    columns_rng_state = 51;
    hall(c, 0.002);
    for (i = 0; i < N; i++) {
        const voxrt_ray ray = random_ray(c, i % 12);
        voxrt_column_hit hit, want;
        voxrt_stats stats;
        size_t n, k;
        uint32_t wrong = 0;
        memset(&d, 0, sizeof d);
        memset(&stats, 0, sizeof stats);
        d.stats = &stats;
        d.start_level_plus_1 = i % 9 < 8 ? i % 9 : 0xfffffff0u + i % 16;
        n = voxrt_columns_explain(c, &d, &ray, s, MOST, &hit);
        REQUIRE(n <= MOST);
        CHECK(voxrt_columns_explain(c, &d, &ray, NULL, 0, NULL) == n);
        CHECK(stats.rays == 2 && 2 * n == stats.steps + stats.descents + stats.hits);
        CHECK(voxrt_columns_trace(c, NULL, &ray, &want, 1) == VOXRT_OK && memcmp(&hit, &want, sizeof hit) == 0);
        for (k = 0; k < n; k++) {
            uint32_t z, set = 0;
            for (z = s[k].depth[0]; z <= s[k].depth[1]; z++)
                set |= (uint32_t)voxrt_columns_get(c, s[k].level, s[k].column[0], s[k].column[1], z);
            wrong += set != (s[k].found != 0) || !(s[k].t_in <= s[k].t_out) || (s[k].found == 2 && s[k].level != 0);
            if (k + 1 == n) wrong += (s[k].found == 2) != (hit.t < INFINITY);
            else if (s[k].found == 0) wrong += s[k + 1].t_in != s[k].t_out || s[k + 1].level > s[k].level + 1;
            else wrong += s[k].found == 2 || s[k + 1].t_in != s[k].t_in || s[k + 1].level + 1 != s[k].level;
        }
        CHECK_MSG(wrong == 0, "ray %u: %u of %u steps", i, wrong, (unsigned)n);
        hits += hit.t < INFINITY;
    }
    CHECK(hits > N / 4);
    CHECK(voxrt_columns_explain(c, NULL, NULL, s, MOST, NULL) == 0 && voxrt_columns_explain(NULL, NULL, NULL, NULL, 0, NULL) == 0);
    voxrt_columns_destroy(c);
}

TEST(times_of_hits_are_finite) { /* rays with directions next to 0 take longer than floats can say: they miss, to all that look */
    enum { N = 64 };
    static const voxrt_isa isa[4] = {VOXRT_ISA_SCALAR, VOXRT_ISA_SSE, VOXRT_ISA_AVX2, VOXRT_ISA_AVX512};
    voxrt_columns *c = make(128, 64, 128);
    voxrt_ray rays[N];
    voxrt_column_hit hit[4][N];
    uint8_t occluded[N];
    uint32_t i, k, hits = 0;
    columns_rng_state = 61;
    hall(c, 0.002);
    for (i = 0; i < N; i++) {
        rays[i] = random_ray(c, 9);
        for (k = 0; k < 3; k++) /* towards the grid; from the longest times on */
            rays[i].dir[k] = (float)ldexp(rnd_in(0, c->size[k]) - (double)rays[i].org[k], -122 - (int)(i % 24));
        rays[i].t_min = 0;
        rays[i].t_max = INFINITY;
    }
    for (k = 0; k < 4; k++) {
        voxrt_columns_trace_desc d;
        memset(&d, 0, sizeof d);
        d.isa = isa[k];
        CHECK(voxrt_columns_trace(c, &d, rays, hit[k], N) == VOXRT_OK && voxrt_columns_occluded(c, &d, rays, occluded, N) == VOXRT_OK);
        for (i = 0; i < N; i++) {
            CHECK_MSG(occluded[i] == (hit[k][i].t < INFINITY), "isa %u, ray %u: any hit %u, first at %g", k, i, occluded[i], (double)hit[k][i].t);
            hits += hit[k][i].t < INFINITY;
        }
        CHECK(memcmp(hit[0], hit[k], sizeof hit[0]) == 0);
    }
    CHECK_MSG(hits > N / 2 && hits < 4 * N, "%u", hits);
    voxrt_columns_destroy(c);
}

TEST(boxes_of_any_size) { /* as far as rays through them have a speed that is a number; others are refused */
    static const double edge[8] = {1e-285, 0.99e-150, 1e-150, 1e-60, 1e60, 1e150, 1.01e150, 1e300};
    static const voxrt_isa isa[4] = {VOXRT_ISA_SCALAR, VOXRT_ISA_SSE, VOXRT_ISA_AVX2, VOXRT_ISA_AVX512};
    uint32_t i, k, a;
    for (i = 0; i < 8; i++)
        for (a = 0; a < 3; a++) {
            voxrt_columns_desc d;
            voxrt_columns *c = NULL;
            voxrt_error error;
            voxrt_columns_info info;
            voxrt_ray rays[8];
            voxrt_column_hit hit[8], first[8];
            voxrt_result r;
            memset(&d, 0, sizeof d);
            memset(&error, 0, sizeof error);
            d.env.error = &error;
            d.size_x = d.size_y = 16;
            d.size_z = 64;
            d.depth_axis_plus_1 = 3;
            for (k = 0; k < 3; k++) d.box_max[k] = i >= 2 && i < 6 ? edge[i] : 1.0;
            d.box_max[a] = edge[i];
            r = voxrt_columns_create(&d, &c);
            if (i < 2 || i >= 6) {
                CHECK(r == VOXRT_ERR_INVALID_ARG && c == NULL && error.where == a && strstr(error.text, "1e-150..1e150") != NULL);
                continue;
            }
            REQUIRE(r == VOXRT_OK);
            voxrt_columns_get_info(c, &info);
            CHECK(info.diagonal > 0.08 * edge[i] && info.diagonal < 0.1 * edge[i]);
            c->bits[voxrti_column(c, 0, 0, 0)] = 1; /* the corner in which all of them start */
            c->bits[voxrti_column(c, 0, 15, 15)] = 1;
            c->all_changed = 1;
            voxrt_columns_update(c);
            memset(rays, 0, sizeof rays);
            for (k = 0; k < 8; k++) {
                rays[k].dir[0] = k % 2 ? 3e38f : 1e-45f;
                rays[k].dir[1] = k & 2 ? 3e38f : 1e-45f;
                rays[k].dir[2] = k & 4 ? 3e38f : 1e-45f;
                rays[k].t_max = INFINITY;
            }
            for (k = 0; k < 4; k++) {
                voxrt_columns_trace_desc td;
                memset(&td, 0, sizeof td);
                td.isa = isa[k];
                CHECK(voxrt_columns_trace(c, &td, rays, hit, 8) == VOXRT_OK);
                if (k == 0) memcpy(first, hit, sizeof hit);
                CHECK(hit[0].t == 0.0f && hit[7].t == 0.0f && memcmp(first, hit, sizeof hit) == 0);
            }
            voxrt_columns_destroy(c);
        }
}

TEST(a_hit_lies_on_its_face) {
    voxrt_columns *c = make(128, 64, 128);
    uint32_t i, k, hits = 0;
    columns_rng_state = 41;
    hall(c, 0.002);
    for (i = 0; i < 4000; i++) {
        voxrt_ray r = random_ray(c, 9);
        voxrt_column_hit h;
        double p;
        for (k = 0; k < 3; k++) r.dir[k] = (float)rnd_in(0, c->size[k]) - r.org[k]; /* towards the grid */
        r.t_max = INFINITY;
        CHECK(voxrt_columns_trace(c, NULL, &r, &h, 1) == VOXRT_OK);
        if (!(h.t < INFINITY)) continue;
        hits++;
        if (h.face == 6) continue;
        p = (double)r.org[h.face >> 1] + (double)h.t * (double)r.dir[h.face >> 1];
        CHECK_MSG(fabs(p - (h.cell[h.face >> 1] + (h.face & 1u))) < 2e-3, "face %u at %g", h.face, p);
        CHECK((r.dir[h.face >> 1] > 0) == ((h.face & 1u) == 0));
    }
    CHECK(hits > 3000);
    voxrt_columns_destroy(c);
}

/* Rays that start on a surface without an offset: cosine-distributed ones. From planes of many orientations none may hit
   its own plane; beside a wall or a kerb the share that is occluded is the form factor. */
static void cosine_ray(const double frame[3][3], voxrt_ray *r) {
    const double u = columns_rnd(), phi = 6.283185307 * columns_rnd(), s = sqrt(u), up = sqrt(1 - u);
    uint32_t a;
    for (a = 0; a < 3; a++)
        r->dir[a] = (float)(up * frame[0][a] + s * cos(phi) * frame[1][a] + s * sin(phi) * frame[2][a]);
}

TEST(tangent_planes_instead_of_offsets) {
    const uint32_t orientations = 24, rays = test_quick() ? 400 : 4000;
    const double up[3][3] = {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}};
    const double distance[2] = {0.7, 1.7}, bound[2][2] = {{0.04, 0.02}, {0.01, 0.01}};
    voxrt_columns_trace_desc d;
    voxrt_ray r;
    uint32_t o, i, k, n = 0, none = 0, self = 0, at;
    uint8_t dark = 0;
    columns_rng_state = 51;
    memset(&d, 0, sizeof d);
    memset(&r, 0, sizeof r);
    for (o = 0; o < orientations; o++) {
        const uint32_t index[6] = {0, 1, 2, 0, 2, 3};
        voxrt_columns *c = make(128, 128, 128);
        double e[3][3]; /* normal and two tangents */
        float p[4][3], normal[3];
        for (k = 0; k < 2; k++) {
            double l = 0, dot = 0;
            for (i = 0; i < 3; i++) e[k][i] = o < 3 && k == 0 ? (double)(i == o) : rnd_in(-1, 1);
            for (i = 0; i < 3 && k == 1; i++) dot += e[0][i] * e[1][i];
            for (i = 0; i < 3 && k == 1; i++) e[1][i] -= dot * e[0][i];
            for (i = 0; i < 3; i++) l += e[k][i] * e[k][i];
            for (i = 0; i < 3; i++) e[k][i] /= sqrt(l);
        }
        for (i = 0; i < 3; i++) {
            e[2][i] = e[0][(i + 1) % 3] * e[1][(i + 2) % 3] - e[0][(i + 2) % 3] * e[1][(i + 1) % 3];
            normal[i] = (float)e[0][i];
        }
        for (k = 0; k < 4; k++)
            for (i = 0; i < 3; i++)
                p[k][i] = (float)(64.3 + (k == 0 || k == 3 ? -200 : 200) * e[1][i] + (k < 2 ? -200 : 200) * e[2][i]);
        CHECK(insert(c, VOXRT_COLUMNS_FAT, p[0], index, 2, 4, 0, NULL) == VOXRT_OK);
        voxrt_columns_update(c);
        r.t_max = 40.0f;
        for (i = 0; i < rays; i++, n++) {
            const double u = rnd_in(-4, 4), v = rnd_in(-4, 4);
            for (k = 0; k < 3; k++) r.org[k] = (float)(64.3 + u * e[1][k] + v * e[2][k]);
            cosine_ray((const double (*)[3])e, &r);
            d.normals = normal;
            CHECK(voxrt_columns_occluded(c, &d, &r, &dark, 1) == VOXRT_OK);
            self += dark;
            d.normals = NULL;
            CHECK(voxrt_columns_occluded(c, &d, &r, &dark, 1) == VOXRT_OK);
            none += dark;
        }
        voxrt_columns_destroy(c);
    }
    CHECK_MSG(none > n * 9 / 10, "%u of %u", none, n); /* nearly all rays are stopped where they start, otherwise */
    CHECK_MSG(self < n / 500, "%u of %u rays hit their own plane", self, n);
    for (k = 0; k < 2; k++) { /* a wall of 24.7 cells above the floor, a kerb of 2.7 */
        voxrt_columns *c = make(128, 128, 128);
        const float normal[3] = {0, 0, 1};
        const double height = k == 0 ? 24.7 : 2.7;
        voxrti_insert in;
        uint32_t x, y;
        memset(&in, 0, sizeof in);
        in.columns = c;
        for (y = 0; y < 128; y++)
            for (x = 0; x < 128; x++) {
                voxrti_insert_run(&in, x, y, 20, 20);
                if (k == 0 ? x == 30 : x >= 24 && x <= 30) voxrti_insert_run(&in, x, y, 20, k == 0 ? 44 : 22);
            }
        voxrt_columns_update(c);
        d.normals = normal;
        for (at = 0; at < 2; at++) {
            const double a = distance[at], exact = 0.5 * (1 - a / sqrt(a * a + height * height));
            const uint32_t many = 10 * rays;
            uint32_t hits = 0;
            r.t_max = k == 0 ? 120.0f : 40.0f;
            for (i = 0; i < many; i++) {
                r.org[0] = (float)(31 + a);
                r.org[1] = (float)rnd_in(64, 65);
                r.org[2] = 20.3f;
                cosine_ray(up, &r);
                CHECK(voxrt_columns_occluded(c, &d, &r, &dark, 1) == VOXRT_OK);
                hits += dark;
            }
            /* 4 standard deviations */
            CHECK_MSG(fabs((double)hits / many - exact) < bound[k][at] + 4 * sqrt(0.25 / many), "%s at %.1f: %.4f, exact %.4f",
                      k == 0 ? "wall" : "kerb", a, (double)hits / many, exact);
        }
        voxrt_columns_destroy(c);
    }
}

typedef struct asked { uint32_t calls, stop; } asked;
static int asked_fn(void *user, uint64_t done, uint64_t total) {
    asked *a = (asked *)user;
    return ++a->calls == a->stop || done > total;
}

TEST(points_can_be_cancelled) { /* some of them are cells then; without a stop all are, on any number of threads */
    enum { N = 1 << 22, CELLS = 64 * 64 * 64 };
    voxrt_columns_desc cd;
    voxrt_columns_insert_desc d;
    float *p = (float *)malloc((size_t)N * 12);
    uint32_t i, k, threads;
    REQUIRE(p != NULL);
    memset(&cd, 0, sizeof cd);
    cd.size_x = cd.size_y = cd.size_z = 64;
    cd.depth_axis_plus_1 = 3;
    for (k = 0; k < 3; k++) cd.box_max[k] = 64.0;
    for (i = 0; i < N; i++) { /* each cell, one after the other */
        p[3 * i] = (float)(i / (N / CELLS) % 64) + 0.5f;
        p[3 * i + 1] = (float)(i / (N / CELLS) / 64 % 64) + 0.5f;
        p[3 * i + 2] = (float)(i / (N / 64)) + 0.5f;
    }
    for (threads = 1; threads <= 3; threads++)
        for (k = 0; k < 3; k++) {
            voxrt_columns *c = NULL;
            voxrt_columns_info info;
            voxrt_columns_insert_stats stats;
            voxrt_error error;
            asked a = {0, k};
            memset(&d, 0, sizeof d);
            memset(&stats, 0, sizeof stats);
            memset(&error, 0, sizeof error);
            d.env.thread_count = threads;
            d.env.progress_fn = asked_fn;
            d.env.progress_user = &a;
            d.env.error = &error;
            REQUIRE(voxrt_columns_create(&cd, &c) == VOXRT_OK);
            CHECK(voxrt_columns_insert_points(c, &d, p, 0, N, &stats) == (k == 0 ? VOXRT_OK : VOXRT_ERR_CANCELLED));
            voxrt_columns_get_info(c, &info);
            if (k == 0) CHECK(a.calls > 1 && stats.items == N && info.cells == CELLS);
            else CHECK(a.calls == k && stats.items == 0 && info.cells < CELLS && error.code == VOXRT_ERR_CANCELLED);
            voxrt_columns_destroy(c);
        }
    free(p);
}

TEST(memory) { /* each request refused, of all that sets cells; nothing is set then */
    voxrt_columns_desc d;
    voxrt_columns_insert_desc in;
    static closed m;
    voxrt_mesh mesh;
    uint32_t way, fail;
    make_sphere(&m, 32, 16, 32, 12.3, 8);
    memset(&mesh, 0, sizeof mesh);
    mesh.positions = m.p[0];
    mesh.vertex_count = m.points;
    mesh.indices = m.index[0];
    mesh.triangle_count = m.triangles;
    for (way = 0; way < 14; way++) { /* modes and points, what moves and what is still */
        int done = 0;
        for (fail = 0; fail < 1000 && !done; fail++) {
            test_alloc ta;
            voxrt_columns *c = NULL;
            voxrt_columns_info info;
            voxrt_result r;
            test_alloc_init(&ta);
            ta.fail_at = (int64_t)fail;
            memset(&d, 0, sizeof d);
            memset(&in, 0, sizeof in);
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.env.thread_count = in.env.thread_count = 1;
            d.size_x = d.size_y = d.size_z = 64;
            d.box_max[0] = d.box_max[1] = d.box_max[2] = 64;
            in.still = way & 1;
            r = voxrt_columns_create(&d, &c);
            CHECK((r == VOXRT_OK) == (c != NULL));
            if (c != NULL) {
                if (way / 2 == 6) r = voxrt_columns_insert_points(c, &in, m.p[0], 12, m.points, NULL);
                else {
                    in.mode = (voxrt_columns_mode)(way / 2);
                    r = voxrt_columns_insert(c, &in, &mesh, NULL);
                }
                voxrt_columns_update(c);
                voxrt_columns_get_info(c, &info);
                CHECK((r == VOXRT_OK) == (info.cells > 100) && (r == VOXRT_OK || info.cells == 0));
                voxrt_columns_destroy(c);
            }
            CHECK(r == (ta.failed != 0 ? VOXRT_ERR_NO_MEMORY : VOXRT_OK));
            done = ta.failed == 0;
            test_alloc_check(&ta);
        }
        CHECK_MSG(done && fail >= 3, "way %u: %u requests", way, fail);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(masks);
    RUN(bad_input);
    RUN(placement);
    RUN(thin_is_three_crosshairs);
    RUN(fat_is_what_is_touched);
    RUN(four_triangles_at_a_time);
    RUN(triangles_without_area_are_lines);
    RUN(closed_meshes_are_tight_and_fill);
    RUN(bodies_are_as_wide_as_they_are);
    RUN(open_meshes_get_no_inside);
    RUN(samples_of_surfaces);
    RUN(samples_far_apart);
    RUN(triangles_far_outside);
    RUN(solids_far_outside);
    RUN(threads_and_order_do_not_matter);
    RUN(still_and_moving);
    RUN(rays_hit_what_plain_stepping_hits);
    RUN(segments_from_both_ends);
    RUN(large_grids);
#if VOXRTI_AVX2
    RUN(planes_may_leave_two_intervals);
#endif
    RUN(rays_in_all_ways_the_same);
    RUN(rays_explained);
    RUN(times_of_hits_are_finite);
    RUN(boxes_of_any_size);
    RUN(a_hit_lies_on_its_face);
    RUN(tangent_planes_instead_of_offsets);
    RUN(points_can_be_cancelled);
    RUN(memory);
    return test_end();
}
