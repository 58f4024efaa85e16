/* test_tetcast_integrate.c - segments of a ray against brute force in double, scalar against eight lanes */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "transfer_oracle.h"

#define GOLDEN 0x60ee4d04655a0b2au /* hash of golden_bits: changes only when the arithmetic does */

/* ---- helpers ---- */

static tetcast_optics *make_optics(const tetcast_control_point *p, size_t count, int independent, tetcast_model model,
                                   float t_min) {
    tetcast_optics_desc d;
    memset(&d, 0, sizeof d);
    d.model = model;
    d.t_min = t_min;
    return oracle_optics(p, count, independent, NULL, 0, &d);
}

static tetcast_segment random_segment(test_rng *r, float longest, const tetcast_control_point *p, size_t count) {
    tetcast_segment s;
    const uint32_t kind = test_rng_below(r, 16);
    s.front = test_rng_range(r, -0.2f, 1.2f);
    s.back = test_rng_range(r, -0.2f, 1.2f);
    if (kind < 6) s.back = s.front + 0.05f * (test_rng_float(r) - 0.5f);
    if (kind == 6) s.back = s.front;
    if (kind == 7) s.back = s.front + 1e-6f * (test_rng_float(r) - 0.5f);
    if (kind == 8) s.front = p[test_rng_below(r, (uint32_t)count)].value;
    if (kind == 9) s.back = p[test_rng_below(r, (uint32_t)count)].value;
    if (kind == 10) s.front = s.back = p[test_rng_below(r, (uint32_t)count)].value;
    if (kind == 11) {
        s.front = p[test_rng_below(r, (uint32_t)count)].value;
        s.back = p[test_rng_below(r, (uint32_t)count)].value;
    }
    s.length = longest * test_rng_float(r) * test_rng_float(r);
    if (test_rng_below(r, 50) == 0) s.length = 0.0f;
    s.depth = 0.0f;
    return s;
}

/* ---- against brute force ---- */

static void against_oracle(const char *name, const tetcast_control_point *p, size_t count, int independent,
                           float longest,
                           int samples, double allowed) {
    tetcast_optics *o = make_optics(p, count, independent, TETCAST_MODEL_VOLUME, -1.0f);
    test_rng r = test_rng_make(0x5e6);
    double worst = 0.0;
    int i, c;
    if (o == NULL) return;
    if (test_quick()) samples /= 10;
    for (i = 0; i < samples; i++) {
        const tetcast_segment s = random_segment(&r, longest, p, count);
        float got[4];
        double want[4];
        CHECK(tetcast_optics_ray(o, &s, 1, got, NULL) == TETCAST_OK);
        oracle_segment(p, count, independent, &s, want);
        for (c = 0; c < 4; c++) {
            const double e = fabs((double)got[c] - want[c]) / (independent && c < 3 ? fmax(1.0, (double)longest) : 1.0);
            if (!(e <= worst)) worst = e;
            if (!(e <= allowed)) {
                CHECK_MSG(0, "%s: front %.9g back %.9g length %.9g channel %d: %.9g is not %.9g (error %.2g)", name,
                          (double)s.front, (double)s.back, (double)s.length, c, (double)got[c], want[c], e);
                tetcast_optics_destroy(o);
                return;
            }
        }
    }
    if (getenv("TEST_PRINT") != NULL) printf("%-24s largest error %.2g\n", name, worst);
    tetcast_optics_destroy(o);
}

TEST(exact_smooth) {
    against_oracle("smooth", oracle_smooth, ORACLE_SMOOTH, 0, 2.0f, 20000, 1e-6);
    against_oracle("smooth, independent", oracle_smooth, ORACLE_SMOOTH, 1, 2.0f, 20000, 1e-6);
    against_oracle("scene", oracle_scene, ORACLE_SCENE, 0, 2.0f, 20000, 1e-6);
}

TEST(exact_steps) {
    against_oracle("steps", oracle_steps, ORACLE_STEPS, 0, 2.0f, 20000, 1e-6);
    against_oracle("steps, independent", oracle_steps, ORACLE_STEPS, 1, 2.0f, 20000, 1e-6);
}

TEST(exact_peaks) {
    float width;
    for (width = 1e-1f; width > 0.5e-5f; width *= 0.1f) {
        tetcast_control_point p[5];
        char name[32];
        oracle_peak(p, 0.5f, width, 60.0f);
        snprintf(name, sizeof name, "peak %g", (double)width);
        against_oracle(name, p, 5, 0, 2.0f, 10000, width > 0.5e-3f ? 2e-6 : 1e-5);
    }
}

TEST(exact_opaque) { /* far beyond one piece of the polynomials */
    tetcast_control_point p[5];
    oracle_peak(p, 0.5f, 0.2f, 3000.0f);
    against_oracle("opaque", p, 5, 0, 10.0f, 5000, 2e-6);
    { /* where a steep ramp falls to nothing */
        tetcast_optics *o = make_optics(p, 5, 0, TETCAST_MODEL_VOLUME, -1.0f);
        tetcast_segment s;
        float got[4];
        double want[4];
        int c;
        s.front = 0.699976206f;
        s.back = 0.699999988f;
        s.length = 5.86114407f;
        s.depth = 0.0f;
        CHECK(tetcast_optics_ray(o, &s, 1, got, NULL) == TETCAST_OK);
        oracle_segment(p, 5, 0, &s, want);
        for (c = 0; c < 4; c++) CHECK_NEAR((double)got[c], want[c], 1e-6);
        tetcast_optics_destroy(o);
    }
    oracle_peak(p, 0.5f, 0.2f, 1e6f);
    against_oracle("more opaque", p, 5, 0, 10.0f, 3000, 2e-6);
}

TEST(exact_huge_extinction) { /* nothing but finite colours between those of the ends */
    tetcast_control_point p[3];
    tetcast_optics *o;
    tetcast_segment s;
    float e, rgba[4];
    memset(p, 0, sizeof p);
    for (e = 1e3f; e <= 1e18f; e *= 10.0f) {
        p[0].value = 0.0f;
        p[1].value = 1.0f;
        p[0].rgb[0] = 1.0f;
        p[1].rgb[1] = 1.0f;
        p[0].extinction = p[1].extinction = e;
        o = make_optics(p, 2, 0, TETCAST_MODEL_VOLUME, -1.0f);
        REQUIRE(o != NULL);
        s.front = 0.25f;
        s.back = 0.75f;
        s.length = 1e3f;
        s.depth = 0.0f;
        CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_OK);
        CHECK_NEAR((double)rgba[0], 0.75, 1e-5 + 5.0 / (double)e);
        CHECK_NEAR((double)rgba[1], 0.25, 1e-5 + 5.0 / (double)e);
        CHECK(rgba[3] == 1.0f);
        s.front = s.back = 0.25f;
        CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_OK);
        CHECK_NEAR((double)rgba[0], 0.75, 1e-5);
        tetcast_optics_destroy(o);
        p[0].extinction = 0.0f; /* ramp from nothing */
        o = make_optics(p, 2, 0, TETCAST_MODEL_VOLUME, -1.0f);
        REQUIRE(o != NULL);
        s.front = 0.0f;
        s.back = 1.0f;
        CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_OK);
        CHECK_NEAR((double)(rgba[0] + rgba[1]), 1.0, 1e-5);
        CHECK(rgba[1] >= 0.0f && rgba[1] <= 0.05f);
        tetcast_optics_destroy(o);
    }
}

/* ---- rays ---- */

TEST(long_rays) { /* many segments: the sums in float */
    static tetcast_segment s[2000];
    tetcast_optics *o = make_optics(oracle_smooth, ORACLE_SMOOTH, 0, TETCAST_MODEL_VOLUME, -1.0f);
    test_rng r = test_rng_make(3);
    double worst = 0.0;
    int rep, i, c;
    REQUIRE(o != NULL);
    for (rep = 0; rep < (test_quick() ? 4 : 40); rep++) {
        const int n = 20 + (int)test_rng_below(&r, 1980);
        float v = test_rng_float(&r), got[4];
        double want[4], t = 1.0;
        memset(want, 0, sizeof want);
        for (i = 0; i < n; i++) {
            double e[4];
            s[i].front = v;
            v = fabsf(v + 0.1f * (test_rng_float(&r) - 0.5f));
            v = v > 1.0f ? 2.0f - v : v;
            s[i].back = v;
            s[i].length = 4.0f / (float)n * test_rng_float(&r);
            s[i].depth = 0.0f;
            oracle_segment(oracle_smooth, ORACLE_SMOOTH, 0, &s[i], e);
            for (c = 0; c < 3; c++) want[c] += t * e[c];
            t *= 1.0 - e[3];
        }
        want[3] = 1.0 - t;
        CHECK(tetcast_optics_ray(o, s, (size_t)n, got, NULL) == TETCAST_OK);
        for (c = 0; c < 4; c++) {
            const double e = fabs((double)got[c] - want[c]);
            if (e > worst) worst = e;
            CHECK_NEAR((double)got[c], want[c], 3e-6);
        }
    }
    if (getenv("TEST_PRINT") != NULL) printf("%-24s largest error %.2g\n", "rays of 20..2000", worst);
    tetcast_optics_destroy(o);
}

TEST(subdivision) { /* cutting a segment in pieces changes nothing */
    tetcast_optics *o[3];
    test_rng r = test_rng_make(4);
    int i, c, k;
    o[0] = make_optics(oracle_smooth, ORACLE_SMOOTH, 0, TETCAST_MODEL_VOLUME, -1.0f);
    o[1] = make_optics(oracle_steps, ORACLE_STEPS, 0, TETCAST_MODEL_VOLUME, -1.0f);
    o[2] = make_optics(oracle_smooth, ORACLE_SMOOTH, 1, TETCAST_MODEL_VOLUME, -1.0f);
    for (k = 0; k < 3; k++) {
        for (i = 0; i < 2000; i++) {
            const tetcast_segment s = random_segment(&r, 2.0f, oracle_smooth, ORACLE_SMOOTH);
            const int n = 2 + (int)test_rng_below(&r, 9);
            tetcast_segment part[10];
            float whole[4], parts[4];
            int j;
            for (j = 0; j < n; j++) {
                part[j] = s;
                part[j].front = (float)((double)s.front + ((double)s.back - (double)s.front) * j / n);
                part[j].back = (float)((double)s.front + ((double)s.back - (double)s.front) * (j + 1) / n);
                part[j].length = s.length / (float)n;
            }
            CHECK(tetcast_optics_ray(o[k], &s, 1, whole, NULL) == TETCAST_OK);
            CHECK(tetcast_optics_ray(o[k], part, (size_t)n, parts, NULL) == TETCAST_OK);
            for (c = 0; c < 4; c++) CHECK_NEAR((double)whole[c], (double)parts[c], 4e-6);
        }
        tetcast_optics_destroy(o[k]);
    }
}

TEST(symmetry) { /* opacity does not depend on the direction, colour does; constant colour does not either */
    tetcast_control_point gray[ORACLE_SMOOTH];
    tetcast_optics *o = make_optics(oracle_smooth, ORACLE_SMOOTH, 0, TETCAST_MODEL_VOLUME, -1.0f), *g;
    test_rng r = test_rng_make(5);
    double differ = 0.0;
    int i, c;
    memcpy(gray, oracle_smooth, sizeof gray);
    for (i = 0; i < ORACLE_SMOOTH; i++) gray[i].rgb[0] = gray[i].rgb[1] = gray[i].rgb[2] = 0.5f;
    g = make_optics(gray, ORACLE_SMOOTH, 0, TETCAST_MODEL_VOLUME, -1.0f);
    for (i = 0; i < 5000; i++) {
        tetcast_segment s = random_segment(&r, 2.0f, oracle_smooth, ORACLE_SMOOTH), b = s;
        float x[4], y[4];
        b.front = s.back;
        b.back = s.front;
        (void)tetcast_optics_ray(o, &s, 1, x, NULL);
        (void)tetcast_optics_ray(o, &b, 1, y, NULL);
        CHECK_NEAR((double)x[3], (double)y[3], 1e-6);
        differ = fmax(differ, fabs((double)x[0] - (double)y[0]));
        (void)tetcast_optics_ray(g, &s, 1, x, NULL);
        (void)tetcast_optics_ray(g, &b, 1, y, NULL);
        for (c = 0; c < 3; c++) {
            CHECK_NEAR((double)x[c], (double)y[c], 1e-6);
            CHECK_NEAR((double)x[c], 0.5 * (double)x[3], 1e-6);
        }
    }
    CHECK(differ > 0.05);
    tetcast_optics_destroy(o);
    tetcast_optics_destroy(g);
}

TEST(early_end) { /* the light that is left bounds the difference; smaller thresholds never read less */
    tetcast_segment s[200];
    tetcast_optics *full = make_optics(oracle_smooth, ORACLE_SMOOTH, 0, TETCAST_MODEL_VOLUME, -1.0f);
    const float t_min[4] = {0.5f, 0.05f, 1.0f / 512.0f, 1e-6f};
    test_rng r = test_rng_make(6);
    size_t before[50], used;
    int k, i, rep, c;
    memset(before, 0, sizeof before);
    for (k = 0; k < 4; k++) {
        tetcast_optics *o = make_optics(oracle_smooth, ORACLE_SMOOTH, 0, TETCAST_MODEL_VOLUME, t_min[k]);
        r = test_rng_make(6);
        for (rep = 0; rep < 50; rep++) {
            float v = test_rng_float(&r), a[4], b[4];
            for (i = 0; i < 200; i++) {
                s[i].front = v;
                v = fabsf(v + 0.2f * (test_rng_float(&r) - 0.5f));
                s[i].back = v;
                s[i].length = 0.2f * test_rng_float(&r);
                s[i].depth = 0.0f;
            }
            CHECK(tetcast_optics_ray(o, s, 200, a, &used) == TETCAST_OK);
            CHECK(tetcast_optics_ray(full, s, 200, b, NULL) == TETCAST_OK);
            CHECK(used >= before[rep]);
            before[rep] = used;
            for (c = 0; c < 4; c++) CHECK_NEAR((double)a[c], (double)b[c], (double)t_min[k] * 1.001 + 1e-6);
            if (k == 1) CHECK(used < 200);
        }
        tetcast_optics_destroy(o);
    }
    tetcast_optics_destroy(full);
}

/* ---- transparent means nothing at all ---- */

TEST(exactly_black) {
    /* the only knots of colour are at the ends: bends of extinction alone must not be lost */
    tetcast_control_point p[4];
    tetcast_optics *o;
    tetcast_segment s;
    float rgba[4], v;
    int i, c, model;
    memset(p, 0, sizeof p);
    p[0].value = 0.0f; p[1].value = 0.1f; p[2].value = 0.4f; p[3].value = 1.0f;
    for (i = 0; i < 4; i++) {
        p[i].rgb[0] = 0.2f + 0.7f * p[i].value;
        p[i].rgb[1] = 1.0f - 0.5f * p[i].value;
        p[i].rgb[2] = 0.3f;
    }
    p[0].extinction = 3.0f;
    p[3].extinction = 7.0f;
    for (model = 0; model < 3; model++) {
        o = make_optics(p, 4, 0, (tetcast_model)model, -1.0f);
        REQUIRE(o != NULL);
        for (i = 0; i < 1000; i++) {
            s.front = v = 0.1f + 0.3f * (float)i / 999.0f;
            s.back = i % 3 == 0 ? v : 0.1f + 0.3f * (float)(i * 7919 % 1000) / 999.0f;
            if (s.front > 0.4f) s.front = 0.4f;
            if (s.back > 0.4f) s.back = 0.4f;
            if (s.front == s.back && s.front == 0.4f) s.back = 0.3f;
            s.length = 1000.0f;
            s.depth = 0.0f;
            CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_OK);
            for (c = 0; c < 4; c++) CHECK(rgba[c] == 0.0f);
        }
        s.front = s.back = 0.4f; /* the knot itself, from both sides */
        CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_OK);
        CHECK(rgba[3] == 0.0f && rgba[0] == 0.0f);
        s.front = s.back = 0.05f; /* and half way down the ramp */
        CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_OK);
        CHECK(rgba[0] > 0.1f || rgba[3] > 0.9f);
        tetcast_optics_destroy(o);
    }
}

TEST(bends_of_extinction_only) { /* two lists; the same as one list with the colours interpolated */
    tetcast_control_point color[2], ext[6], all[6];
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_transfer *t = NULL;
    tetcast_optics *a = NULL, *b;
    test_rng r = test_rng_make(8);
    int i, c;
    memset(color, 0, sizeof color);
    memset(ext, 0, sizeof ext);
    color[1].value = 1.0f;
    color[1].rgb[0] = color[0].rgb[2] = 1.0f;
    for (i = 0; i < 6; i++) {
        ext[i].value = (float)i * 0.2f;
        ext[i].extinction = (i & 1) ? 5.0f : 0.0f;
        all[i] = ext[i];
        all[i].rgb[0] = ext[i].value < 1.0f ? ext[i].value : 1.0f;
        all[i].rgb[1] = 0.0f;
        all[i].rgb[2] = 1.0f - all[i].rgb[0];
    }
    memset(&td, 0, sizeof td);
    td.color_points = color;
    td.color_count = 2;
    td.extinction_points = ext;
    td.extinction_count = 6;
    REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK);
    memset(&od, 0, sizeof od);
    od.t_min = -1.0f;
    REQUIRE(tetcast_optics_create(t, &od, &a) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    b = make_optics(all, 6, 0, TETCAST_MODEL_VOLUME, -1.0f);
    for (i = 0; i < 5000; i++) {
        const tetcast_segment s = random_segment(&r, 2.0f, all, 6);
        float x[4], y[4];
        (void)tetcast_optics_ray(a, &s, 1, x, NULL);
        (void)tetcast_optics_ray(b, &s, 1, y, NULL);
        for (c = 0; c < 4; c++) CHECK_NEAR((double)x[c], (double)y[c], 2e-6);
    }
    tetcast_optics_destroy(a);
    tetcast_optics_destroy(b);
}

/* ---- scalar and eight lanes ---- */

static void same_bits(const tetcast_control_point *p, size_t count, int independent, tetcast_model model, int cue,
                      float t_min, float longest) {
    tetcast_optics_desc d;
    tetcast_optics *o = NULL;
    tetcast_transfer *t = oracle_transfer(p, count, independent, NULL, 0);
    tetcasti_segment8_fn *fn;
    test_rng r = test_rng_make(77 + count);
    int rep, step;
    uint32_t k;
    memset(&d, 0, sizeof d);
    d.model = model;
    d.t_min = t_min;
    d.cue = (uint32_t)cue;
    d.cue_depth[0] = 0.5f;
    d.cue_depth[1] = 5.0f;
    d.cue_scale[0] = 1.0f;
    d.cue_scale[1] = 0.2f;
    d.fog[0] = 0.3f;
    d.fog[2] = 0.7f;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    if (o == NULL) return;
    fn = tetcasti_segment8_pick(o, TETCAST_ISA_AVX2);
    for (rep = 0; rep < (test_quick() ? 20 : 200); rep++) {
        tetcasti_ray_sum one[8];
        tetcasti_ray_sum8 sum;
        for (k = 0; k < 8; k++) {
            tetcasti_ray_begin(o, &one[k]);
            tetcasti_lane_begin(o, &sum, k);
        }
        for (step = 0; step < 25; step++) {
            tetcasti_seg8 seg;
            const uint32_t lanes = test_rng_u32(&r) & 255u;
            uint32_t ended = 0, got;
            const int calm = step % 3 == 0;
            for (k = 0; k < 8; k++) {
                tetcast_segment s = random_segment(&r, longest, p, count);
                if (calm) s.back = s.front + 1e-3f * (test_rng_float(&r) - 0.5f);
                if (!(lanes >> k & 1u)) { /* garbage in lanes that are off */
                    s.front = test_rng_bits(&r);
                    s.back = test_rng_bits(&r);
                    s.length = test_rng_bits(&r);
                    s.depth = test_rng_bits(&r);
                } else {
                    s.depth = 6.0f * test_rng_float(&r);
                    o->segment(o, s.front, s.back, s.length, s.depth, &one[k]);
                    ended |= (uint32_t)tetcasti_ray_ended(o, &one[k]) << k;
                }
                seg.front[k] = s.front;
                seg.back[k] = s.back;
                seg.length[k] = s.length;
                seg.depth[k] = s.depth;
            }
            got = fn(o, &seg, lanes, &sum);
            CHECK_EQ_U64(got, ended);
        }
        for (k = 0; k < 8; k++) {
            tetcasti_ray_sum lane;
            tetcasti_lane_load(&sum, k, &lane);
            CHECK_MSG(memcmp(lane.c, one[k].c, sizeof lane.c) == 0 && memcmp(&lane.t, &one[k].t, sizeof lane.t) == 0,
                      "%u knots, model %d: %.9g %.9g %.9g %.9g is not %.9g %.9g %.9g %.9g", (unsigned)count, (int)model,
                      (double)lane.c[0], (double)lane.c[1], (double)lane.c[2], (double)lane.t, (double)one[k].c[0],
                      (double)one[k].c[1], (double)one[k].c[2], (double)one[k].t);
        }
    }
    tetcast_optics_destroy(o);
}

TEST(lanes_same_bits) {
    static tetcast_control_point many[300];
    static const size_t counts[] = {1, 2, 5, 7, 8, 14, 15, 16, 17, 40, 300};
    tetcast_control_point peak[5];
    test_rng r = test_rng_make(9);
    size_t i, k;
    int model, independent, cue;
    if (tetcast_isa_best() < TETCAST_ISA_AVX2) SKIP("no AVX2");
    oracle_peak(peak, 0.5f, 0.05f, 400.0f);
    for (k = 0; k < sizeof counts / sizeof counts[0]; k++) {
        const size_t n = counts[k];
        for (i = 0; i < n; i++) {
            many[i].value = n > 1 ? (float)i / (float)(n - 1) : 0.5f;
            if (i % 5 == 4) many[i].value = many[i - 1].value; /* a jump */
            many[i].rgb[0] = test_rng_float(&r);
            many[i].rgb[1] = test_rng_float(&r);
            many[i].rgb[2] = test_rng_float(&r);
            many[i].extinction = test_rng_below(&r, 3) == 0 ? 0.0f : 10.0f * test_rng_float(&r);
        }
        for (model = 0; model <= (int)TETCAST_MODEL_MAXIMUM; model++) {
            for (independent = 0; independent < 2; independent++) {
                for (cue = 0; cue < 2; cue++) {
                    same_bits(many, n, independent, (tetcast_model)model, cue, 0.0f, 1.0f);
                    same_bits(many, n, independent, (tetcast_model)model, cue, -1.0f, 1.0f);
                }
            }
        }
    }
    same_bits(oracle_steps, ORACLE_STEPS, 0, TETCAST_MODEL_VOLUME, 0, 0.0f, 10.0f);
    same_bits(peak, 5, 0, TETCAST_MODEL_VOLUME, 0, -1.0f, 10.0f);
    same_bits(peak, 5, 1, TETCAST_MODEL_VOLUME, 0, -1.0f, 1e6f);
    same_bits(peak, 5, 0, TETCAST_MODEL_VOLUME, 0, -1.0f, 1e16f);
}

TEST(segments_one_by_one) { /* the batch call gives what single calls give */
    tetcast_optics *o = make_optics(oracle_steps, ORACLE_STEPS, 0, TETCAST_MODEL_VOLUME, 0.0f);
    static tetcast_segment s[1003];
    static float rgba[1003][4];
    test_rng r = test_rng_make(10);
    int i, isa;
    for (i = 0; i < 1003; i++) s[i] = random_segment(&r, 1.0f, oracle_steps, ORACLE_STEPS);
    for (isa = TETCAST_ISA_AUTO; isa <= TETCAST_ISA_AVX2; isa++) {
        CHECK(tetcast_optics_segments(o, s, 1003, (tetcast_isa)isa, rgba) == TETCAST_OK);
        for (i = 0; i < 1003; i++) {
            float one[4];
            CHECK(tetcast_optics_ray(o, &s[i], 1, one, NULL) == TETCAST_OK);
            CHECK(memcmp(one, rgba[i], sizeof one) == 0);
        }
    }
    tetcast_optics_destroy(o);
}

TEST(golden_bits) { /* the same on every compiler, optimisation level and instruction set */
    static tetcast_segment s[999];
    static float rgba[999][4];
    tetcast_control_point peak[5];
    test_rng r = test_rng_make(12);
    uint64_t hash[2] = {0, 0};
    int i, k, isa;
    oracle_peak(peak, 0.5f, 0.05f, 400.0f);
    for (i = 0; i < 999; i++) { /* no sums of products here: the compiler may fuse those */
        s[i].front = test_rng_float(&r);
        s[i].back = i % 7 == 0 ? s[i].front : test_rng_float(&r);
        if (i % 11 == 0) s[i].front = 0.5f;
        s[i].length = 2.0f * test_rng_float(&r);
        s[i].depth = 0.0f;
    }
    for (isa = 0; isa < 2; isa++) {
        for (k = 0; k < 8; k++) {
            const tetcast_control_point *p = k < 2 ? oracle_smooth : k < 6 ? oracle_steps : peak;
            const size_t n = k < 2 ? ORACLE_SMOOTH : k < 6 ? ORACLE_STEPS : 5;
            tetcast_optics *o = make_optics(p, n, k & 1, k == 4 ? TETCAST_MODEL_EMISSION : k == 5 ? TETCAST_MODEL_MAXIMUM
                                            : TETCAST_MODEL_VOLUME, 0.0f);
            REQUIRE(o != NULL);
            CHECK(tetcast_optics_segments(o, s, 999, isa ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR, rgba) == TETCAST_OK);
            for (i = 0; i < 999 * 4; i++) { /* bytes in one order */
                uint32_t u, b;
                memcpy(&u, &rgba[i / 4][i % 4], 4);
                for (b = 0; b < 4; b++, u >>= 8) {
                    const uint8_t byte = (uint8_t)u;
                    hash[isa] = test_fnv1a(&byte, 1, hash[isa]);
                }
            }
            tetcast_optics_destroy(o);
        }
    }
    CHECK_EQ_U64(hash[0], hash[1]);
    CHECK_EQ_U64(hash[0], GOLDEN);
}

/* ---- odd numbers ---- */

TEST(odd_values) {
    tetcast_optics *o = make_optics(oracle_steps, ORACLE_STEPS, 0, TETCAST_MODEL_VOLUME, 0.0f);
    tetcast_segment s;
    float rgba[4];
    test_rng r = test_rng_make(11);
    int i, c, good = 0;
    for (i = 0; i < 20000; i++) {
        tetcast_result res;
        s.front = test_rng_bits(&r);
        s.back = test_rng_bits(&r);
        s.length = test_rng_bits(&r);
        s.depth = test_rng_bits(&r);
        res = tetcast_optics_ray(o, &s, 1, rgba, NULL);
        if (res != TETCAST_OK) continue;
        good++;
        for (c = 0; c < 4; c++) CHECK(rgba[c] >= -1e-6f && rgba[c] <= 1.0f + 1e-6f);
    }
    CHECK(good > 1000);
    /* neighbours in the last place across a knot, denormal distances */
    s.front = 0.0f;
    s.back = 2.9e-45f;
    s.length = 1.0f;
    s.depth = 0.0f;
    CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_OK);
    for (c = 0; c < 4; c++) CHECK(rgba[c] >= 0.0f && rgba[c] <= 1.0f);
    s.front = NAN;
    CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_ERR_INVALID_ARG);
    s.front = 0.0f;
    s.length = -1.0f;
    CHECK(tetcast_optics_ray(o, &s, 1, rgba, NULL) == TETCAST_ERR_INVALID_ARG);
    CHECK(tetcast_optics_ray(o, NULL, 0, rgba, NULL) == TETCAST_OK);
    CHECK(rgba[3] == 0.0f);
    tetcast_optics_destroy(o);
}

TEST(absorption_is_summed) { /* depth added, one exponential: 1000 thin segments against one thick one */
    tetcast_optics *o = make_optics(oracle_smooth, ORACLE_SMOOTH, 0, TETCAST_MODEL_ABSORPTION, 0.0f);
    tetcast_segment s[1000], all;
    float a[4], b[4];
    int i;
    for (i = 0; i < 1000; i++) {
        s[i].front = (float)i / 1000.0f;
        s[i].back = (float)(i + 1) / 1000.0f;
        s[i].length = 0.003f;
        s[i].depth = 0.0f;
    }
    all = s[0];
    all.back = s[999].back;
    all.length = 3.0f;
    CHECK(tetcast_optics_ray(o, s, 1000, a, NULL) == TETCAST_OK);
    CHECK(tetcast_optics_ray(o, &all, 1, b, NULL) == TETCAST_OK);
    CHECK_NEAR((double)a[3], (double)b[3], 1e-6);
    CHECK(a[0] == 0.0f && a[3] > 0.9f);
    tetcast_optics_destroy(o);
}

/* Color and opacity rounded to multiples of 1 / steps after each segment, as frame buffers of few bits would. */
static double few_bits(float (*part)[4], size_t count, double steps, const double want[4]) {
    double sum[4] = {0, 0, 0, 0}, worst = 0;
    size_t i;
    int c;
    for (i = 0; i < count; i++) {
        const double left = 1 - sum[3];
        for (c = 0; c < 4; c++) sum[c] = floor((sum[c] + left * (double)part[i][c]) * steps + 0.5) / steps;
    }
    for (c = 0; c < 4; c++) worst = fmax(worst, fabs(sum[c] - want[c]));
    return worst;
}

TEST(bits_between_segments) { /* why sums are floats: each segment is exact, but 8 bits between them are not enough */
    static const size_t counts[4] = {16, 64, 256, 1024};
    static tetcast_segment s[1024];
    static float part[1024][4];
    tetcast_optics *o = make_optics(oracle_smooth, ORACLE_SMOOTH, 0, TETCAST_MODEL_VOLUME, -1.0f);
    double bytes[4], words[4], floats[4];
    size_t i, n, k;
    int c;
    for (k = 0; k < 4; k++) {
        double want[4] = {0, 0, 0, 0}, left = 1;
        float got[4];
        n = counts[k];
        for (i = 0; i < n; i++) {
            double e[4];
            s[i].front = (float)i / (float)n;
            s[i].back = (float)(i + 1) / (float)n;
            s[i].length = 2.0f / (float)n;
            s[i].depth = 0;
            oracle_segment(oracle_smooth, ORACLE_SMOOTH, 0, &s[i], e);
            for (c = 0; c < 3; c++) want[c] += left * e[c];
            left *= 1 - e[3];
        }
        want[3] = 1 - left;
        CHECK(tetcast_optics_segments(o, s, n, TETCAST_ISA_AUTO, part) == TETCAST_OK);
        CHECK(tetcast_optics_ray(o, s, n, got, NULL) == TETCAST_OK);
        for (c = 0, floats[k] = 0; c < 4; c++) floats[k] = fmax(floats[k], fabs((double)got[c] - want[c]));
        bytes[k] = few_bits(part, n, 255, want);
        words[k] = few_bits(part, n, 65535, want);
        if (getenv("TEST_PRINT") != NULL)
            printf("%4u segments: 8 bits %.2g, 16 bits %.2g, floats %.2g\n", (unsigned)n, bytes[k], words[k], floats[k]);
        CHECK(floats[k] < 1e-6);
        CHECK(words[k] < 1.5 * (double)n / 65535 && words[k] > floats[k]); /* half a step for each segment, and the rest */
    }
    CHECK(bytes[0] < 0.02 && bytes[2] < 0.2); /* the error grows with the segments */
    CHECK(bytes[3] > 0.2 && bytes[3] > 10 * bytes[0]); /* what each of many adds is less than half a step: it vanishes */
    tetcast_optics_destroy(o);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(exact_smooth);
    RUN(exact_steps);
    RUN(exact_peaks);
    RUN(exact_opaque);
    RUN(exact_huge_extinction);
    RUN(long_rays);
    RUN(subdivision);
    RUN(symmetry);
    RUN(early_end);
    RUN(exactly_black);
    RUN(bends_of_extinction_only);
    RUN(lanes_same_bits);
    RUN(segments_one_by_one);
    RUN(golden_bits);
    RUN(odd_values);
    RUN(absorption_is_summed);
    RUN(bits_between_segments);
    return test_end();
}
