/* test_tetcast_transfer.c - transfer functions: evaluation, jumps, ranges, simplification, bad input */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "transfer_oracle.h"

static tetcast_transfer *transfer_make(const tetcast_control_point *p, size_t count, int independent, float simplify) {
    tetcast_transfer_desc d;
    tetcast_transfer *t = NULL;
    memset(&d, 0, sizeof d);
    d.points = p;
    d.point_count = count;
    d.simplify = simplify;
    d.color_mode = independent ? TETCAST_COLOR_INDEPENDENT : TETCAST_COLOR_ASSOCIATED;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    return t;
}

/* Random points, some at equal values, some stretches empty. */
static size_t transfer_random_points(test_rng *r, tetcast_control_point *p, size_t most) {
    const size_t n = 1 + test_rng_below(r, (uint32_t)most);
    float v = -1.0f;
    size_t i;
    int empty = 0;
    for (i = 0; i < n; i++) {
        if (test_rng_below(r, 5) != 0) v += 0.001f + test_rng_float(r) * 0.2f;
        if (test_rng_below(r, 4) == 0) empty = !empty;
        p[i].value = v;
        p[i].rgb[0] = test_rng_float(r);
        p[i].rgb[1] = test_rng_below(r, 3) ? 0.0f : 1.0f;
        p[i].rgb[2] = 2.0f * test_rng_float(r);
        p[i].extinction = empty ? 0.0f : 20.0f * test_rng_float(r);
    }
    return n;
}

TEST(eval_like_oracle) {
    tetcast_control_point p[60];
    test_rng r = test_rng_make(1);
    int rep, i, c;
    for (rep = 0; rep < 200; rep++) {
        const size_t n = transfer_random_points(&r, p, rep < 100 ? 12 : 60);
        tetcast_transfer *t = transfer_make(p, n, 0, 0.0f);
        REQUIRE(t != NULL);
        for (i = 0; i < 100; i++) {
            float v = test_rng_range(&r, -2.0f, 8.0f), got[4];
            double want[4];
            if (i % 3 == 0) v = p[test_rng_below(&r, (uint32_t)n)].value; /* at a jump: from above */
            tetcast_transfer_eval(t, v, got);
            oracle_eval(p, n, (double)v, 1, want);
            for (c = 0; c < 4; c++) CHECK_NEAR((double)got[c], want[c], c == 3 ? 2e-5 : 1e-6);
        }
        tetcast_transfer_destroy(t);
    }
}

TEST(find_is_exact) { /* buckets, counting and a plain search agree, also for knots a hair apart */
    static tetcast_control_point p[2000];
    test_rng r = test_rng_make(2);
    int rep;
    size_t i, n;
    for (rep = 0; rep < 40; rep++) {
        tetcast_transfer *t;
        float v = rep & 1 ? -3.0f : 0.5f;
        n = rep < 20 ? 2 + (size_t)rep : 1500;
        for (i = 0; i < n; i++) {
            memset(&p[i], 0, sizeof p[i]);
            p[i].value = v;
            p[i].extinction = (i & 1) ? 1.0f : 2.0f;
            v = test_rng_below(&r, 3) == 0 ? v + 0.01f : v + fabsf(v) * 2e-7f + 1e-9f;
        }
        t = transfer_make(p, n, 0, 0.0f);
        REQUIRE(t != NULL);
        for (i = 0; i < 3000; i++) {
            float s = p[test_rng_below(&r, (uint32_t)n)].value;
            uint32_t want = 0, k;
            const uint32_t kind = test_rng_below(&r, 4);
            if (kind == 1) s = nextafterf(s, 10.0f);
            if (kind == 2) s = nextafterf(s, -10.0f);
            if (kind == 3) s = test_rng_range(&r, p[0].value - 1.0f, p[n - 1].value + 1.0f);
            for (k = 1; k < t->tf.n; k++) want += t->tf.knot[k] <= s;
            CHECK_EQ_U64(tetcasti_tf_find(&t->tf, s), want);
        }
        tetcast_transfer_destroy(t);
    }
}

TEST(largest_in_range) {
    tetcast_control_point p[60];
    test_rng r = test_rng_make(3);
    int rep, i, k, c, mode;
    for (rep = 0; rep < 60; rep++) {
        const size_t n = transfer_random_points(&r, p, rep < 30 ? 8 : 60);
        for (mode = 0; mode < 2; mode++) {
            tetcast_transfer *t = transfer_make(p, n, mode, 0.0f);
            for (i = 0; i < 30; i++) {
                float lo = test_rng_range(&r, -1.5f, 6.0f), hi = test_rng_range(&r, -1.5f, 6.0f), ext, rgb[3];
                double want[4] = {0.0, 0.0, 0.0, 0.0};
                if (lo > hi) { const float x = lo; lo = hi; hi = x; }
                if (i % 5 == 0) hi = lo;
                ext = tetcast_transfer_max_extinction(t, lo, hi);
                tetcast_transfer_max_emission(t, lo, hi, rgb);
                for (k = 0; k <= (int)n * 200; k++) { /* brute force: 200 places between all neighbouring points */
                    const int j = k / 200;
                    const double from = fmax((double)lo, j == 0 ? -1e9 : (double)p[j - 1].value);
                    const double to = fmin((double)hi, j == (int)n ? 1e9 : (double)p[j].value);
                    double v[4];
                    if (!(from <= to)) continue;
                    oracle_eval(p, n, from + (to - from) * (k % 200) / 200.0, 1, v);
                    want[3] = fmax(want[3], v[3]);
                    for (c = 0; c < 3; c++) want[c] = fmax(want[c], v[c] * (mode ? 1.0 : v[3]));
                }
                { /* the ends */
                    double v[4];
                    oracle_eval(p, n, (double)hi, 1, v);
                    want[3] = fmax(want[3], v[3]);
                    for (c = 0; c < 3; c++) want[c] = fmax(want[c], v[c] * (mode ? 1.0 : v[3]));
                }
                for (k = 0; k < (int)n * 2; k++) {
                    const double s = (double)p[k / 2].value;
                    double v[4];
                    if (!(s >= (double)lo && s <= (double)hi) || (s == (double)lo && (k & 1) == 0)) continue;
                    oracle_eval(p, n, s, k & 1, v);
                    want[3] = fmax(want[3], v[3]);
                    for (c = 0; c < 3; c++) want[c] = fmax(want[c], v[c] * (mode ? 1.0 : v[3]));
                }
                CHECK_NEAR((double)ext, want[3], 1e-5 * want[3] + 1e-5);
                for (c = 0; c < 3; c++) CHECK_NEAR((double)rgb[c], want[c], 1e-4 * want[c] + 1e-4);
            }
            tetcast_transfer_destroy(t);
        }
    }
}

TEST(empty_ranges) {
    tetcast_control_point p[60];
    test_rng r = test_rng_make(4);
    int rep, i, mode, said = 0;
    for (rep = 0; rep < 100; rep++) {
        const size_t n = transfer_random_points(&r, p, rep < 50 ? 10 : 60);
        for (mode = 0; mode < 2; mode++) {
            tetcast_transfer *t;
            size_t k;
            for (k = 0; k < n && mode; k++) if (p[k].extinction == 0.0f) memset(p[k].rgb, 0, sizeof p[k].rgb);
            t = transfer_make(p, n, mode, 0.0f);
            for (i = 0; i < 60; i++) {
                float lo = test_rng_range(&r, -1.5f, 6.0f), hi = lo + test_rng_float(&r) * (i & 1 ? 0.3f : 3.0f);
                int want = 1, got;
                size_t j;
                if (i % 4 == 1) lo = p[test_rng_below(&r, (uint32_t)n)].value;
                if (i % 4 == 2) hi = p[test_rng_below(&r, (uint32_t)n)].value;
                if (i % 8 == 3) lo = hi = p[test_rng_below(&r, (uint32_t)n)].value;
                if (!(lo <= hi)) continue;
                got = tetcast_transfer_is_empty(t, lo, hi);
                /* the values at both ends and in the middle between all neighbouring points inside */
                for (j = 0; j <= n; j++) {
                    const float a = j == 0 ? lo : p[j - 1].value, b = j == n ? hi : p[j].value;
                    const double from = fmax((double)a, (double)lo), to = fmin((double)b, (double)hi);
                    double v[4];
                    if (!(from <= to)) continue;
                    oracle_eval(p, n, 0.5 * (from + to), 1, v);
                    if (v[3] != 0.0 || (mode && v[0] + v[1] + v[2] != 0.0)) want = 0;
                }
                { /* and the ends: a ray may rest there, seen from above */
                    double v[4], w[4];
                    oracle_eval(p, n, (double)lo, 1, v);
                    oracle_eval(p, n, (double)hi, 1, w);
                    if (v[3] + w[3] != 0.0) want = 0;
                    if (mode && v[0] + v[1] + v[2] + w[0] + w[1] + w[2] != 0.0) want = 0;
                }
                CHECK_MSG(got == want, "[%.9g, %.9g]: %d is not %d", (double)lo, (double)hi, got, want);
                said += got;
            }
            tetcast_transfer_destroy(t);
        }
    }
    CHECK(said > 500);
}

TEST(prefix_integrals) {
    tetcast_control_point p[40];
    test_rng r = test_rng_make(5);
    int rep, i, k, c, mode;
    for (rep = 0; rep < 40; rep++) {
        const size_t n = transfer_random_points(&r, p, 40);
        mode = rep & 1;
        {
            tetcast_transfer *t = transfer_make(p, n, mode, 0.0f);
            for (i = 0; i < 10; i++) {
                const float a = test_rng_range(&r, -1.5f, 5.0f), b = test_rng_range(&r, -1.5f, 5.0f);
                double x[7], y[7], want[7] = {0, 0, 0, 0, 0, 0, 0}, scale = 1.0;
                const int steps = 4000;
                tetcasti_tf_integral(&t->tf, a, x);
                tetcasti_tf_integral(&t->tf, b, y);
                for (k = 0; k < steps; k++) {
                    double v[4], d = ((double)b - (double)a) / steps;
                    oracle_eval(p, n, (double)a + d * (k + 0.5), 1, v);
                    want[0] += v[3] * d;
                    for (c = 0; c < 3; c++) {
                        want[1 + c] += (mode ? 1.0 : v[3]) * v[c] * d;
                        want[4 + c] += v[c] * d;
                    }
                    scale += fabs(v[3] * d);
                }
                for (c = 0; c < 7; c++) CHECK_NEAR(y[c] - x[c], want[c], 4e-3 * scale);
            }
            tetcast_transfer_destroy(t);
        }
    }
}

TEST(collinear_knots_go) { /* a ramp of 256 samples is one interval; bends and jumps stay */
    float table[256][4];
    tetcast_transfer_desc d;
    tetcast_transfer *t = NULL;
    tetcast_transfer_info info;
    int i, c;
    for (i = 0; i < 256; i++) {
        for (c = 0; c < 3; c++) table[i][c] = (float)i / 255.0f;
        table[i][3] = 10.0f * (float)i / 255.0f;
    }
    memset(&d, 0, sizeof d);
    d.table = &table[0][0];
    d.table_count = 256;
    d.table_value[0] = -3.0f;
    d.table_value[1] = 5.0f;
    REQUIRE(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    tetcast_transfer_get_info(t, &info);
    CHECK_EQ_U64(info.knot_count, 2);
    CHECK_EQ_U64(info.dropped_count, 254);
    CHECK(info.value[0] == -3.0f && info.value[1] == 5.0f);
    CHECK(info.largest_extinction == 10.0f && info.largest_color == 1.0f);
    CHECK_NEAR(info.largest_emission, 10.0, 1e-5);
    tetcast_transfer_destroy(t);
    for (i = 100; i < 256; i++) table[i][3] = 0.0f; /* empty from there on */
    table[180][1] = 5.0f; /* a colour of nothing */
    REQUIRE(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    tetcast_transfer_get_info(t, &info);
    CHECK_EQ_U64(info.knot_count, 7); /* ends, 99, 100, 179, 180, 181 */
    CHECK(tetcast_transfer_is_empty(t, -3.0f + 8.0f * 100.0f / 255.0f, 7.0f));
    CHECK(!tetcast_transfer_is_empty(t, -3.0f + 8.0f * 99.9f / 255.0f, 7.0f));
    tetcast_transfer_destroy(t);
    d.table_steps = 1;
    REQUIRE(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    tetcast_transfer_get_info(t, &info);
    CHECK_EQ_U64(info.jump_count, 255);
    { /* constant around each sample */
        float v[4];
        tetcast_transfer_eval(t, -3.0f + 8.0f * 50.4f / 255.0f, v);
        CHECK(v[3] == table[50][3]);
        tetcast_transfer_eval(t, -3.0f + 8.0f * 50.6f / 255.0f, v);
        CHECK(v[3] == table[51][3]);
        tetcast_transfer_eval(t, -100.0f, v);
        CHECK(v[3] == 0.0f && v[0] == 0.0f);
    }
    tetcast_transfer_destroy(t);
}

TEST(simplify_within_bound) {
    static tetcast_control_point p[1000];
    test_rng r = test_rng_make(6);
    const float share[4] = {1e-4f, 1e-3f, 1e-2f, 0.1f};
    uint32_t before = 2000;
    int k, i, c;
    for (i = 0; i < 1000; i++) {
        const float x = (float)i / 999.0f;
        p[i].value = x;
        p[i].rgb[0] = 0.5f + 0.5f * sinf(9.0f * x);
        p[i].rgb[1] = x * x;
        p[i].rgb[2] = 0.3f;
        p[i].extinction = x < 0.3f || x > 0.9f ? 0.0f : 40.0f * (x - 0.3f) * (0.9f - x);
    }
    for (k = 0; k < 4; k++) {
        tetcast_transfer *t = transfer_make(p, 1000, 0, share[k]);
        tetcast_transfer_info info;
        REQUIRE(t != NULL);
        tetcast_transfer_get_info(t, &info);
        CHECK(info.knot_count < before);
        CHECK(info.knot_count > 3);
        before = info.knot_count;
        CHECK(info.simplify_color <= share[k] * 1.001f && info.simplify_extinction <= share[k] * 3.6001f);
        CHECK(info.simplify_color > 0.0f && info.simplify_extinction > 0.0f);
        for (i = 0; i < 5000; i++) {
            const float v = test_rng_float(&r);
            float got[4];
            double want[4];
            tetcast_transfer_eval(t, v, got);
            oracle_eval(p, 1000, (double)v, 1, want);
            for (c = 0; c < 4; c++) {
                CHECK_NEAR((double)got[c], want[c], (double)(c < 3 ? info.simplify_color : info.simplify_extinction) +
                           1e-5);
            }
            if (v < 0.299f || v > 0.901f) CHECK(got[3] == 0.0f); /* what is empty stays empty */
        }
        tetcast_transfer_destroy(t);
    }
    CHECK(before < 12);
}

TEST(difference_of_an_edit) {
    tetcast_control_point p[9], q[10];
    tetcast_transfer *a, *b;
    float lo, hi;
    int i;
    memset(p, 0, sizeof p);
    for (i = 0; i < 9; i++) {
        p[i].value = (float)i;
        p[i].rgb[0] = (float)(i & 1);
        p[i].extinction = (float)(i * i);
    }
    a = transfer_make(p, 9, 0, 0.0f);
    b = transfer_make(p, 9, 0, 0.0f);
    tetcast_transfer_difference(a, b, &lo, &hi);
    CHECK(lo > hi);
    tetcast_transfer_destroy(b);
    memcpy(q, p, sizeof p);
    q[4].extinction = 100.0f;
    b = transfer_make(q, 9, 0, 0.0f);
    tetcast_transfer_difference(a, b, &lo, &hi);
    CHECK(lo == 3.0f && hi == 5.0f);
    tetcast_transfer_destroy(b);
    q[4] = p[4];
    q[4].value = 4.25f; /* moved */
    b = transfer_make(q, 9, 0, 0.0f);
    tetcast_transfer_difference(a, b, &lo, &hi);
    CHECK(lo == 3.0f && hi == 5.0f);
    tetcast_transfer_destroy(b);
    memcpy(q, p, 4 * sizeof *p); /* one more */
    q[4] = p[3];
    q[4].value = 3.5f;
    memcpy(q + 5, p + 4, 5 * sizeof *p);
    b = transfer_make(q, 10, 0, 0.0f);
    tetcast_transfer_difference(a, b, &lo, &hi);
    CHECK(lo == 3.0f && hi == 4.0f);
    tetcast_transfer_difference(b, a, &lo, &hi);
    CHECK(lo == 3.0f && hi == 4.0f);
    tetcast_transfer_destroy(b);
    memcpy(q, p, sizeof p);
    q[8].extinction = 1.0f; /* the last: from there to infinity */
    b = transfer_make(q, 9, 0, 0.0f);
    tetcast_transfer_difference(a, b, &lo, &hi);
    CHECK(lo == 7.0f && hi == INFINITY);
    tetcast_transfer_destroy(b);
    b = transfer_make(p, 9, 1, 0.0f);
    tetcast_transfer_difference(a, b, &lo, &hi);
    CHECK(lo == -INFINITY && hi == INFINITY);
    tetcast_transfer_destroy(b);
    tetcast_transfer_destroy(a);
}

TEST(small_functions) { /* none, one point, one value with a jump, constant */
    tetcast_control_point p[2];
    tetcast_transfer *t = NULL;
    tetcast_transfer_info info;
    float v[4];
    REQUIRE(tetcast_transfer_create(NULL, &t) == TETCAST_OK);
    tetcast_transfer_eval(t, 0.0f, v);
    CHECK(v[3] == 0.0f);
    CHECK(tetcast_transfer_is_empty(t, -1e30f, 1e30f));
    CHECK(tetcast_transfer_max_extinction(t, -1.0f, 1.0f) == 0.0f);
    tetcast_transfer_destroy(t);
    memset(p, 0, sizeof p);
    p[0].value = p[1].value = 2.0f;
    p[0].extinction = 3.0f;
    p[1].extinction = 5.0f;
    t = transfer_make(p, 1, 0, 0.0f);
    tetcast_transfer_eval(t, -7.0f, v);
    CHECK(v[3] == 3.0f);
    tetcast_transfer_eval(t, 7.0f, v);
    CHECK(v[3] == 3.0f);
    tetcast_transfer_destroy(t);
    t = transfer_make(p, 2, 0, 0.0f);
    tetcast_transfer_get_info(t, &info);
    CHECK(info.knot_count == 1 && info.jump_count == 1);
    tetcast_transfer_eval(t, 1.999f, v);
    CHECK(v[3] == 3.0f);
    tetcast_transfer_eval(t, 2.0f, v);
    CHECK(v[3] == 5.0f);
    CHECK(tetcast_transfer_max_extinction(t, 0.0f, 1.0f) == 3.0f);
    CHECK(tetcast_transfer_max_extinction(t, 0.0f, 2.0f) == 5.0f);
    CHECK(tetcast_transfer_max_extinction(t, INFINITY, INFINITY) == 5.0f);
    CHECK(tetcast_transfer_max_extinction(t, NAN, 1.0f) == 0.0f);
    CHECK(!tetcast_transfer_is_empty(t, NAN, 1.0f));
    CHECK(!tetcast_transfer_is_empty(NULL, 0.0f, 1.0f));
    tetcast_transfer_eval(t, NAN, v);
    CHECK(v[3] == 0.0f);
    tetcast_transfer_difference(t, NULL, &v[0], &v[1]);
    CHECK(v[0] == -INFINITY && v[1] == INFINITY);
    tetcast_transfer_destroy(t);
    tetcast_transfer_destroy(NULL);
}

TEST(far_values) { /* knots just below the largest that there can be */
    tetcast_control_point p[3];
    tetcast_transfer *t = NULL;
    tetcast_transfer_desc d;
    float rgb[3];
    int i, side;
    for (side = -1; side <= 1; side += 2) {
        memset(&d, 0, sizeof d);
        memset(p, 0, sizeof p);
        for (i = 0; i < 3; i++) {
            p[i].value = side > 0 ? (0.6f + 0.15f * (float)i) * 1e38f : -(0.9f - 0.15f * (float)i) * 1e38f;
            p[i].extinction = (side > 0) == (i > 0) ? 2.0f : 0.0f;
            p[i].rgb[1] = 1.0f;
        }
        d.points = p;
        d.point_count = 3;
        CHECK_EQ_U64(tetcast_transfer_create(&d, &t), TETCAST_OK);
        REQUIRE(t != NULL);
        CHECK(!tetcast_transfer_is_empty(t, side > 0 ? 0.7e38f : -0.85e38f, side > 0 ? 0.8e38f : -0.7e38f));
        CHECK(tetcast_transfer_is_empty(t, side > 0 ? 0.0f : -0.55e38f, side > 0 ? 0.55e38f : 0.0f));
        CHECK(tetcast_transfer_max_extinction(t, side > 0 ? 0.9e38f : -3e38f, side > 0 ? 3e38f : -0.9e38f) == 2.0f);
        tetcast_transfer_max_emission(t, -INFINITY, INFINITY, rgb);
        CHECK(rgb[0] == 0.0f && rgb[1] == 2.0f);
        tetcast_transfer_destroy(t);
    }
}

TEST(bad_input) {
    tetcast_control_point p[4];
    tetcast_isovalue iso[3];
    float table[8];
    tetcast_transfer_desc d;
    tetcast_transfer *t = NULL;
    tetcast_error e;
    int i, k;
    const float bad[6] = {NAN, INFINITY, -INFINITY, -1.0f, 1e19f, 3e38f};
    memset(p, 0, sizeof p);
    memset(iso, 0, sizeof iso);
    memset(table, 0, sizeof table);
    for (i = 0; i < 4; i++) p[i].value = (float)i;
    memset(&d, 0, sizeof d);
    d.env.error = &e;
    d.points = p;
    d.point_count = 4;
    CHECK(tetcast_transfer_create(&d, NULL) == TETCAST_ERR_INVALID_ARG);
    d._end_zero = 1;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_UNINIT_DESC);
    d._end_zero = 0;
    for (k = 0; k < 6; k++) {
        for (i = 0; i < 5; i++) {
            float *at = i == 0 ? &p[2].value : i < 4 ? &p[2].rgb[i - 1] : &p[2].extinction;
            const float old = *at;
            if (i == 0 && k == 4) continue; /* a fine value */
            *at = bad[k];
            t = (tetcast_transfer *)(void *)&d;
            CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG);
            CHECK(t == NULL && e.where == 2 && strstr(e.text, "control point 2") != NULL);
            *at = old;
        }
    }
    p[1].value = 2.5f;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG);
    CHECK(e.where == 2 && strstr(e.text, "ascending") != NULL);
    p[1].value = 1.0f;
    d.table = table;
    d.table_count = 2;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG); /* two sources */
    d.point_count = 0;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG); /* no range */
    d.table_value[1] = 1.0f;
    table[6] = NAN;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG && e.where == 1);
    table[6] = 0.0f;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    d.isovalues = iso;
    d.isovalue_count = 2;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG && e.where == 1); /* equal values */
    iso[1].value = 1.0f;
    iso[1].opacity = 1.5f;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG && e.where == 1);
    iso[1].opacity = 1.0f;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    d.points = NULL;
    d.point_count = 3;
    d.table_count = 0;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG);
    d.point_count = 0;
    d.extinction_scale = -1.0f;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG);
    d.extinction_scale = 0.0f;
    d.color_mode = (tetcast_color_mode)7;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_INVALID_ARG);
    d.color_mode = TETCAST_COLOR_ASSOCIATED;
    d.table_count = (size_t)-1 / 2;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_RANGE);
}

TEST(no_memory) { /* each allocation fails once: no leak, no object */
    tetcast_control_point p[30];
    tetcast_isovalue iso[2];
    tetcast_transfer_desc d;
    int64_t k;
    int i;
    memset(p, 0, sizeof p);
    memset(iso, 0, sizeof iso);
    iso[1].value = 1.0f;
    for (i = 0; i < 30; i++) {
        p[i].value = (float)i;
        p[i].extinction = (float)(i & 1);
    }
    memset(&d, 0, sizeof d);
    d.points = p;
    d.point_count = 30;
    d.isovalues = iso;
    d.isovalue_count = 2;
    for (k = 0; k < 20; k++) {
        test_alloc ta;
        tetcast_transfer *t = NULL;
        tetcast_result r;
        test_alloc_init(&ta);
        ta.fail_at = k;
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        r = tetcast_transfer_create(&d, &t);
        CHECK(r == (ta.failed != 0 ? TETCAST_ERR_NO_MEMORY : TETCAST_OK));
        CHECK((t == NULL) == (r != TETCAST_OK));
        tetcast_transfer_destroy(t);
        test_alloc_check(&ta);
        if (r == TETCAST_OK) break;
    }
    CHECK(k > 5 && k < 20);
    memset(&d.env, 0, sizeof d.env);
    d.env.memory_limit = 1000;
    {
        tetcast_transfer *t = NULL;
        CHECK(tetcast_transfer_create(&d, &t) == TETCAST_ERR_NO_MEMORY);
    }
}

TEST(steep_ramps) { /* values a few denormal numbers apart, widths below the last place of the slope */
    tetcast_control_point p[4];
    tetcast_transfer *t;
    float v[4];
    memset(p, 0, sizeof p);
    p[1].value = 1.4e-45f;
    p[2].value = 2.8e-45f;
    p[3].value = 1.0f;
    p[1].extinction = 1e18f;
    t = transfer_make(p, 4, 0, 0.0f);
    REQUIRE(t != NULL);
    tetcast_transfer_eval(t, 0.0f, v);
    CHECK(v[3] >= 0.0f && v[3] <= 1e18f);
    tetcast_transfer_eval(t, 0.5f, v);
    CHECK(v[3] == 0.0f);
    CHECK(tetcast_transfer_max_extinction(t, -1.0f, 1.0f) <= 1e18f);
    tetcast_transfer_destroy(t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(eval_like_oracle);
    RUN(find_is_exact);
    RUN(largest_in_range);
    RUN(empty_ranges);
    RUN(prefix_integrals);
    RUN(collinear_knots_go);
    RUN(simplify_within_bound);
    RUN(difference_of_an_edit);
    RUN(small_functions);
    RUN(far_values);
    RUN(bad_input);
    RUN(no_memory);
    RUN(steep_ramps);
    return test_end();
}
