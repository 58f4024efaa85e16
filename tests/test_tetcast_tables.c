/* test_tetcast_tables.c - sampling rules, prefix integrals, psi table, pre-integrated tables and their builders */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "transfer_oracle.h"

static const char *const names[TETCAST_INTEGRATOR_COUNT] = {
    "exact", "psi table", "riemann", "trapezoid", "midpoint", "pre-classified", "prefix integrals", "table 3D",
    "table incremental", "table sub-range", "table 2D", "table prefix"};

static tetcast_optics *tables_make(const tetcast_control_point *p, size_t count, int independent, const tetcast_optics_desc *d) {
    return oracle_optics(p, count, independent, NULL, 0, d);
}

static tetcast_optics_desc tables_desc_of(tetcast_integrator which, uint32_t values, uint32_t lengths, float longest) {
    tetcast_optics_desc d;
    memset(&d, 0, sizeof d);
    d.integrator = which;
    d.table_values = values;
    d.table_lengths = lengths;
    d.longest = longest;
    d.t_min = -1.0f;
    return d;
}

/* Largest and mean colour error over random segments inside the domain, d <= longest. */
static double error_of(const tetcast_optics *o, const tetcast_control_point *p, size_t count, int independent,
                       float longest,
                       int samples, double *mean) {
    test_rng r = test_rng_make(123);
    double worst = 0.0, sum = 0.0;
    int i, c;
    for (i = 0; i < samples; i++) {
        tetcast_segment s;
        float got[4];
        double want[4];
        s.front = test_rng_float(&r);
        s.back = test_rng_float(&r);
        s.length = longest * test_rng_float(&r) * test_rng_float(&r);
        s.depth = 0.0f;
        CHECK(tetcast_optics_ray(o, &s, 1, got, NULL) == TETCAST_OK);
        oracle_segment(p, count, independent, &s, want);
        for (c = 0; c < 4; c++) {
            const double e = fabs((double)got[c] - want[c]);
            CHECK(e < 1e3); /* no NaN */
            if (e > worst) worst = e;
            sum += e / (4.0 * samples);
        }
    }
    if (mean != NULL) *mean = sum;
    return worst;
}

TEST(oracle_against_brute_force) { /* the yardstick itself: 20,000 steps */
    tetcast_control_point peak[5];
    test_rng r = test_rng_make(1);
    int i, c, k;
    oracle_peak(peak, 0.5f, 0.02f, 60.0f);
    for (k = 0; k < 4; k++) {
        const tetcast_control_point *p = k == 0 ? oracle_smooth : k == 1 ? oracle_steps : k == 2 ? peak : oracle_smooth;
        const size_t n = k == 1 ? ORACLE_STEPS : k == 2 ? 5 : ORACLE_SMOOTH;
        for (i = 0; i < (test_quick() ? 10 : 60); i++) {
            tetcast_segment s;
            double a[4], b[4];
            s.front = test_rng_float(&r);
            s.back = test_rng_float(&r);
            s.length = 2.0f * test_rng_float(&r);
            s.depth = 0.0f;
            oracle_segment(p, n, k == 3, &s, a);
            oracle_brute(p, n, k == 3, &s, 20000, b);
            for (c = 0; c < 4; c++) CHECK_NEAR(a[c], b[c], k == 1 ? 1e-3 : 1e-6);
        }
    }
}

TEST(exp_of_negative) {
    double worst = 0.0;
    float x;
    for (x = 0.0f; x < 80.0f; x = x * 1.001f + 1e-5f) {
        const double want = exp(-(double)x);
        worst = fmax(worst, fabs((double)tetcasti_exp_neg(x) - want) / want);
    }
    CHECK_MSG(worst < 3e-7, "relative error %.3g", worst);
    CHECK(tetcasti_exp_neg(0.0f) == 1.0f);
    CHECK(tetcasti_exp_neg(1e30f) == 0.0f);
    CHECK(tetcasti_exp_neg(NAN) == 0.0f);
}

static double psi_of(double a, double b) { /* int_0^1 exp(-(a x + (b - a) x^2 / 2)) dx */
    double sum = 0.0;
    int k, i;
    const int parts = 4 + (int)(a + b);
    for (k = 0; k < parts; k++) {
        for (i = 0; i < 8; i++) {
            const double x = (k + oracle_x[i]) / parts;
            sum += oracle_w[i] / parts * exp(-(a * x + 0.5 * (b - a) * x * x));
        }
    }
    return sum;
}

TEST(psi_and_its_table) {
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_PSI_TABLE, 0, 0, 0.0f);
    tetcast_optics *o = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
    test_rng r = test_rng_make(2);
    double node = 0.0, table = 0.0, exact = 0.0;
    int i;
    REQUIRE(o != NULL && o->psi != NULL);
    CHECK_EQ_U64(o->info.table_bytes, 512 * 512 * 4);
    for (i = 0; i < 20000; i++) {
        const uint32_t x = test_rng_below(&r, 511), y = test_rng_below(&r, 511);
        const double a = 50.0 * test_rng_double(&r) * test_rng_double(&r), b =
            50.0 * test_rng_double(&r) * test_rng_double(&r);
        tetcasti_ray_sum sum;
        float c[8];
        node = fmax(node, fabs((double)o->psi[x * 512 + y] - psi_of((double)x / (511.0 - x), (double)y / (511.0 - y))));
        table = fmax(table, fabs((double)tetcasti_psi_lookup(o->psi, (float)a, (float)b) - psi_of(a, b)));
        memset(&sum, 0, sizeof sum);
        memset(c, 0, sizeof c);
        sum.t = 1.0f;
        c[0] = (float)a;
        c[1] = (float)(b - a);
        c[2] = 1.0f;
        c[3] = -1.0f;
        tetcasti_piece(1, TETCASTI_KIND_ASSOCIATED, 0, NULL, 1.0f, c, 0.0f, 1.0f, 1.0f, &sum);
        exact = fmax(exact, fabs(1.0 - (double)sum.c[0] - psi_of(a, b)));
    }
    CHECK_MSG(exact < 1e-6, "psi: %.3g", exact);
    CHECK_MSG(node < 1e-6, "psi at the nodes: %.3g", node);
    CHECK_MSG(table < 5e-4, "psi table: %.3g", table);
    if (getenv("TEST_PRINT") != NULL) printf("psi %.2g, at nodes %.2g, table %.2g\n", exact, node, table);
    tetcast_optics_destroy(o);
}

TEST(errors_of_all) { /* bounds a little above what was measured; prints a table */
    static const double largest[3][TETCAST_INTEGRATOR_COUNT] = {
        /* exact  psi   riem  trap  mid   pre   prefix 3D     incr   sub    2D     tprefix */
        {1e-6, 1e-5, 1.0, 1.0, 1.0, 1.0, 10., 3e-3, 6e-3, 1e-2, 0.2, 10.},
        {1e-6, 1e-4, 1.1, 1.1, 1.1, 1.1, 60., 0.5, 0.6, 0.5, 0.5, 60.},
        {1e-6, 1e-5, 1.1, 1.1, 1.1, 1.1, 20., 0.4, 0.4, 0.6, 0.5, 20.}};
    tetcast_control_point peak[5];
    int k, which;
    oracle_peak(peak, 0.5f, 0.02f, 60.0f);
    for (k = 0; k < 3; k++) {
        const tetcast_control_point *p = k == 0 ? oracle_smooth : k == 1 ? peak : oracle_steps;
        const size_t n = k == 0 ? ORACLE_SMOOTH : k == 1 ? 5 : ORACLE_STEPS;
        for (which = 0; which < (int)TETCAST_INTEGRATOR_COUNT; which++) {
            tetcast_optics_desc d = tables_desc_of((tetcast_integrator)which, 128, 64, 2.0f);
            tetcast_optics *o = tables_make(p, n, 0, &d);
            double mean, worst;
            REQUIRE(o != NULL);
            worst = error_of(o, p, n, 0, 2.0f, test_quick() ? 500 : 4000, &mean);
            CHECK_MSG(worst <= largest[k][which], "%s, function %d: %.3g", names[which], k, worst);
            if (getenv("TEST_PRINT") != NULL) printf("%d %-18s largest %.2g mean %.2g\n", k, names[which], worst, mean);
            tetcast_optics_destroy(o);
        }
    }
}

TEST(halved_steps) { /* one value all along: twice half the way gives what the whole way gives, by each rule without a table of lengths */
    static const tetcast_integrator rules[6] = {TETCAST_INTEGRATOR_EXACT, TETCAST_INTEGRATOR_RIEMANN, TETCAST_INTEGRATOR_TRAPEZOID,
                                                TETCAST_INTEGRATOR_MIDPOINT, TETCAST_INTEGRATOR_PRE, TETCAST_INTEGRATOR_PREFIX};
    int rule, i, c;
    for (rule = 0; rule < 6; rule++) {
        const tetcast_optics_desc d = tables_desc_of(rules[rule], 0, 0, 1.0f);
        tetcast_optics *o = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
        test_rng r = test_rng_make(47);
        double seen = 0.0;
        for (i = 0; i < 1000; i++) {
            tetcast_segment s[3];
            float whole[4], halves[4];
            memset(s, 0, sizeof s);
            s[0].front = s[0].back = test_rng_float(&r);
            s[0].length = 2.0f * test_rng_float(&r);
            s[1] = s[0];
            s[1].length *= 0.5f;
            s[2] = s[1];
            CHECK(tetcast_optics_ray(o, s, 1, whole, NULL) == TETCAST_OK);
            CHECK(tetcast_optics_ray(o, s + 1, 2, halves, NULL) == TETCAST_OK);
            /* prefix integrals leave out what a segment absorbs of its own light: only their opacity */
            for (c = rules[rule] == TETCAST_INTEGRATOR_PREFIX ? 3 : 0; c < 4; c++)
                CHECK_MSG(fabs((double)whole[c] - (double)halves[c]) <= 1e-6, "%s: %g %g", names[rules[rule]], (double)whole[c],
                          (double)halves[c]);
            seen += (double)whole[3];
        }
        CHECK_MSG(seen > 100.0, "%s: %g", names[rules[rule]], seen);
        tetcast_optics_destroy(o);
    }
}

TEST(order_of_sampling) { /* Riemann: halving the step halves the error; trapezoid and midpoint: a quarter */
    static const tetcast_integrator rules[3] = {TETCAST_INTEGRATOR_RIEMANN, TETCAST_INTEGRATOR_TRAPEZOID,
                                                TETCAST_INTEGRATOR_MIDPOINT};
    int k;
    for (k = 0; k < 3; k++) {
        double mean[3];
        int i;
        for (i = 0; i < 3; i++) {
            tetcast_optics_desc d = tables_desc_of(rules[k], 0, 0, 0.0f);
            tetcast_optics *o;
            d.samples = 16u << (2 * i);
            o = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
            (void)error_of(o, oracle_smooth, ORACLE_SMOOTH, 0, 2.0f, 300, &mean[i]);
            tetcast_optics_destroy(o);
        }
        for (i = 0; i < 2; i++) {
            const double order = log(mean[i] / mean[i + 1]) / log(4.0);
            CHECK_MSG(order > (k == 0 ? 0.9 : 1.7) && order < (k == 0 ? 1.1 : 2.3), "%s: order %.2f (%.3g, %.3g)",
                      names[rules[k]], order, mean[i], mean[i + 1]);
        }
    }
}

TEST(order_of_tables) { /* smooth function: doubling the table quarters the mean error */
    double mean[3];
    int i;
    for (i = 0; i < 3; i++) {
        tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_TABLE_3D, 32u << i, 16u << i, 2.0f);
        tetcast_optics *o = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
        CHECK_EQ_U64(o->info.table_bytes, (size_t)16 * (32u << i) * (32u << i) * (16u << i));
        (void)error_of(o, oracle_smooth, ORACLE_SMOOTH, 0, 2.0f, 2000, &mean[i]);
        tetcast_optics_destroy(o);
    }
    for (i = 0; i < 2; i++) CHECK_MSG(mean[i] / mean[i + 1] > 2.7 && mean[i] / mean[i + 1] < 6.0, "%g %g", mean[i],
                                      mean[i + 1]);
}

TEST(pre_classification) { /* the same as the exact integral for a linear function, not for others */
    tetcast_control_point line[2];
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_PRE, 0, 0, 0.0f);
    tetcast_optics *o;
    double worst;
    memset(line, 0, sizeof line);
    line[1].value = 1.0f;
    line[0].rgb[0] = line[1].rgb[1] = 1.0f;
    line[0].extinction = 0.5f;
    line[1].extinction = 3.0f;
    o = tables_make(line, 2, 0, &d);
    worst = error_of(o, line, 2, 0, 2.0f, 2000, NULL);
    CHECK_MSG(worst < 1e-6, "%g", worst);
    tetcast_optics_destroy(o);
    o = tables_make(line, 2, 1, &d);
    worst = error_of(o, line, 2, 1, 2.0f, 2000, NULL);
    CHECK_MSG(worst < 1e-6, "%g", worst);
    tetcast_optics_destroy(o);
    o = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
    CHECK(error_of(o, oracle_smooth, ORACLE_SMOOTH, 0, 2.0f, 2000, NULL) > 1e-2);
    tetcast_optics_destroy(o);
}

TEST(prefix_is_exact_for_opacity) { /* and for the colour where nothing absorbs; equal values are no 0 / 0 */
    tetcast_control_point clear[ORACLE_STEPS];
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_PREFIX, 0, 0, 0.0f);
    tetcast_optics *o = tables_make(oracle_steps, ORACLE_STEPS, 0, &d), *e;
    test_rng r = test_rng_make(3);
    int i, c;
    memcpy(clear, oracle_steps, sizeof clear);
    for (i = 0; i < ORACLE_STEPS; i++) clear[i].extinction = 0.0f;
    e = tables_make(clear, ORACLE_STEPS, 1, &d);
    for (i = 0; i < 5000; i++) {
        tetcast_segment s;
        float got[4];
        double want[4];
        s.front = test_rng_float(&r);
        s.back = i % 3 == 0 ? s.front : i % 3 == 1 ? test_rng_float(&r) : s.front + 1e-6f * (test_rng_float(&r) - 0.5f);
        if (i % 7 == 0) s.front = 0.5f;
        s.length = 2.0f * test_rng_float(&r);
        s.depth = 0.0f;
        (void)tetcast_optics_ray(o, &s, 1, got, NULL);
        oracle_segment(oracle_steps, ORACLE_STEPS, 0, &s, want);
        CHECK_NEAR((double)got[3], want[3], 1e-6);
        for (c = 0; c < 3; c++) CHECK((double)got[c] >= want[c] - 1e-6); /* too bright, never too dark */
        (void)tetcast_optics_ray(e, &s, 1, got, NULL);
        oracle_segment(clear, ORACLE_STEPS, 1, &s, want);
        for (c = 0; c < 3; c++) CHECK_NEAR((double)got[c], want[c], 2e-6);
    }
    tetcast_optics_destroy(o);
    tetcast_optics_destroy(e);
}

/* ---- builders ---- */

TEST(entries_of_the_exact_builder) {
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_TABLE_3D, 33, 7, 1.5f);
    tetcast_optics *o = tables_make(oracle_steps, ORACLE_STEPS, 0, &d);
    uint32_t i, j, l;
    int c;
    REQUIRE(o != NULL);
    for (l = 0; l < 7; l++) {
        for (i = 0; i < 33; i++) {
            for (j = 0; j < 33; j++) {
                tetcast_segment s;
                double want[4];
                const float *e = o->table.entry[((size_t)l * 33 + i) * 33 + j];
                s.front = tetcasti_table_value(&o->table, i);
                s.back = tetcasti_table_value(&o->table, j);
                s.length = tetcasti_table_length(&o->table, l);
                s.depth = 0.0f;
                oracle_segment(oracle_steps, ORACLE_STEPS, 0, &s, want);
                for (c = 0; c < 4; c++) CHECK_NEAR((double)e[c], want[c], 1e-6);
            }
        }
    }
    tetcast_optics_destroy(o);
}

TEST(subrange_is_the_plain_composite) { /* every entry: N steps one after the other, in double */
    const uint32_t n = 61, lengths = 5;
    int independent;
    for (independent = 0; independent < 2; independent++) {
        tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_TABLE_SUBRANGE, n, lengths, 1.5f);
        tetcast_optics *o = tables_make(oracle_smooth, ORACLE_SMOOTH, independent, &d);
        uint32_t i, j, l;
        int c;
        double worst = 0.0;
        REQUIRE(o != NULL);
        for (l = 0; l < lengths; l++) {
            for (i = 0; i < n; i++) {
                for (j = 0; j < n; j++) {
                    const uint32_t run = i < j ? j - i : i - j;
                    const double step = (double)tetcasti_table_length(&o->table, l) / (run != 0 ? run : 1);
                    double sum[4] = {0.0, 0.0, 0.0, 1.0};
                    uint32_t k;
                    for (k = 0; k < (run != 0 ? run : 1); k++) {
                        const uint32_t at = i < j ? i + k : i - k, next = run == 0 ? at : i < j ? at + 1 : at - 1;
                        float a[4], b[4];
                        double m, left;
                        tetcasti_tf_at(&o->tf, tetcasti_table_value(&o->table, at), a);
                        tetcasti_tf_at(&o->tf, tetcasti_table_value(&o->table, next), b);
                        m = 0.5 * ((double)a[0] + (double)b[0]) * step;
                        left = exp(-m);
                        for (c = 0; c < 3; c++) {
                            sum[c] += sum[3] * 0.5 * ((double)a[1 + c] + (double)b[1 + c]) *
                                      (independent ? (m > 1e-9 ? (1.0 - left) / m : 1.0) * step : 1.0 - left);
                        }
                        sum[3] *= left;
                    }
                    for (c = 0; c < 4; c++) {
                        const double want = c < 3 ? sum[c] : 1.0 - sum[3];
                        worst = fmax(worst, fabs((double)o->table.entry[((size_t)l * n + i) * n + j][c] - want));
                    }
                }
            }
        }
        CHECK_MSG(worst < 2e-7, "%g", worst); /* the entries are float */
        tetcast_optics_destroy(o);
    }
}

TEST(incremental_near_the_exact) {
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_TABLE_INCREMENTAL, 128, 64, 2.0f);
    tetcast_optics *a = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d), *b;
    double worst = 0.0, mean_a, mean_b;
    size_t i;
    int c;
    d.integrator = TETCAST_INTEGRATOR_TABLE_3D;
    b = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
    for (i = 0; i < (size_t)128 * 128 * 64; i++) {
        for (c = 0; c < 4; c++) worst = fmax(worst, fabs((double)a->table.entry[i][c] - (double)b->table.entry[i][c]));
    }
    CHECK_MSG(worst > 1e-5 && worst < 5e-3, "%g", worst);
    (void)error_of(a, oracle_smooth, ORACLE_SMOOTH, 0, 2.0f, 2000, &mean_a);
    (void)error_of(b, oracle_smooth, ORACLE_SMOOTH, 0, 2.0f, 2000, &mean_b);
    CHECK_MSG(mean_a > mean_b && mean_a < 5.0 * mean_b, "%g %g", mean_a, mean_b);
    tetcast_optics_destroy(a);
    tetcast_optics_destroy(b);
}

TEST(opacity_is_symmetric) {
    static const tetcast_integrator kinds[4] = {TETCAST_INTEGRATOR_TABLE_3D, TETCAST_INTEGRATOR_TABLE_SUBRANGE,
                                                TETCAST_INTEGRATOR_TABLE_PREFIX, TETCAST_INTEGRATOR_TABLE_2D};
    int k;
    for (k = 0; k < 4; k++) {
        tetcast_optics_desc d = tables_desc_of(kinds[k], 64, 8, 2.0f);
        tetcast_optics *o = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
        const uint32_t n = 64;
        uint32_t i, j, l;
        double differ = 0.0;
        for (l = 0; l < o->table.lengths; l++) {
            for (i = 0; i < n; i++) {
                for (j = 0; j < n; j++) {
                    const float *x = o->table.entry[(l * n + i) * n + j], *y = o->table.entry[(l * n + j) * n + i];
                    CHECK_NEAR((double)x[3], (double)y[3], 1e-6);
                    differ = fmax(differ, fabs((double)x[0] - (double)y[0]));
                }
            }
        }
        CHECK((differ > 0.01) == (kinds[k] != TETCAST_INTEGRATOR_TABLE_PREFIX));
        tetcast_optics_destroy(o);
    }
}

TEST(local_update) { /* an edit recomputes a part; the table is that of a new build, bit for bit */
    static const tetcast_integrator kinds[5] = {TETCAST_INTEGRATOR_TABLE_3D, TETCAST_INTEGRATOR_TABLE_INCREMENTAL,
                                                TETCAST_INTEGRATOR_TABLE_SUBRANGE, TETCAST_INTEGRATOR_TABLE_2D,
                                                TETCAST_INTEGRATOR_TABLE_PREFIX};
    tetcast_control_point p[20], q[20];
    test_rng r = test_rng_make(4);
    int rep, k, i;
    for (rep = 0; rep < (test_quick() ? 6 : 40); rep++) {
        const uint32_t at = test_rng_below(&r, 20);
        for (i = 0; i < 20; i++) {
            memset(&p[i], 0, sizeof p[i]);
            p[i].value = (float)i / 19.0f;
            p[i].rgb[0] = test_rng_float(&r);
            p[i].rgb[2] = test_rng_float(&r);
            p[i].extinction = 20.0f * test_rng_float(&r);
        }
        memcpy(q, p, sizeof q);
        if (rep % 3 != 0) q[at].extinction += 3.0f;
        if (rep % 3 == 1) q[(at + 2) % 20].rgb[1] = 0.7f;
        if (rep % 5 == 4 && at > 0 && at < 19) q[at].value += 0.01f;
        for (k = 0; k < 5; k++) {
            tetcast_optics_desc d = tables_desc_of(kinds[k], 47, 9, 1.0f);
            tetcast_transfer *t = oracle_transfer(q, 20, 0, NULL, 0);
            tetcast_optics *old = tables_make(p, 20, 0, &d), *fresh = tables_make(q, 20, 0, &d), *update = NULL;
            CHECK(tetcast_optics_update(old, t, &d, &update) == TETCAST_OK);
            REQUIRE(update != NULL);
            CHECK(memcmp(update->table.entry, fresh->table.entry, update->info.table_bytes) == 0);
            tetcast_optics_destroy(old);
            tetcast_optics_destroy(fresh);
            tetcast_optics_destroy(update);
            tetcast_transfer_destroy(t);
        }
    }
}

TEST(threads_same_bits) {
    static const tetcast_integrator kinds[4] = {TETCAST_INTEGRATOR_TABLE_3D, TETCAST_INTEGRATOR_TABLE_INCREMENTAL,
                                                TETCAST_INTEGRATOR_TABLE_SUBRANGE, TETCAST_INTEGRATOR_PSI_TABLE};
    int k;
    uint32_t threads;
    for (k = 0; k < 4; k++) {
        tetcast_optics *one = NULL;
        for (threads = 1; threads <= 5; threads += 2) {
            tetcast_optics_desc d = tables_desc_of(kinds[k], 50, 20, 1.0f);
            tetcast_optics *o;
            d.env.thread_count = threads;
            o = tables_make(oracle_steps, ORACLE_STEPS, 0, &d);
            REQUIRE(o != NULL);
            if (one == NULL) {
                one = o;
                continue;
            }
            if (o->psi != NULL) CHECK(memcmp(o->psi, one->psi, o->info.table_bytes) == 0);
            else CHECK(memcmp(o->table.entry, one->table.entry, o->info.table_bytes) == 0);
            tetcast_optics_destroy(o);
        }
        tetcast_optics_destroy(one);
    }
}

TEST(lengths_beyond_the_table) { /* cut into parts that fit: not clamped */
    tetcast_control_point flat[1];
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_TABLE_3D, 16, 64, 0.5f);
    tetcast_optics *o;
    float length;
    memset(flat, 0, sizeof flat);
    flat[0].value = 0.5f;
    flat[0].rgb[1] = 1.0f;
    flat[0].extinction = 0.7f;
    o = tables_make(flat, 1, 0, &d);
    for (length = 0.01f; length < 20.0f; length *= 1.3f) {
        tetcast_segment s;
        float got[4];
        s.front = 0.2f;
        s.back = 0.9f;
        s.length = length;
        s.depth = 0.0f;
        CHECK(tetcast_optics_ray(o, &s, 1, got, NULL) == TETCAST_OK);
        CHECK_NEAR((double)got[3], 1.0 - exp(-0.7 * (double)length), 1e-4);
        CHECK_NEAR((double)got[1], (double)got[3], 1e-6);
    }
    tetcast_optics_destroy(o);
}

TEST(values_outside) { /* of the table: what the function is there, also behind a jump at its end */
    static const tetcast_control_point jumps[4] = {
        {0.3f, {0.1f, 0.3f, 0.9f}, 0.3f}, {0.3f, {0.9f, 0.4f, 0.1f}, 6}, {0.7f, {0.9f, 0.4f, 0.1f}, 8}, {0.7f, {0.2f, 0.9f, 0.2f}, 1}};
    static const tetcast_control_point ramp[3] = {
        {0.3f, {0.1f, 0.3f, 0.9f}, 0.5f}, {0.5f, {0.9f, 0.4f, 0.1f}, 3}, {0.7f, {0.2f, 0.9f, 0.2f}, 1}};
    int which, k, i, c;
    for (which = TETCAST_INTEGRATOR_TABLE_3D; which <= (int)TETCAST_INTEGRATOR_TABLE_SUBRANGE; which++)
        for (k = 0; k < 3; k++) { /* one side, the other, across a function without jumps */
            tetcast_optics_desc d = tables_desc_of((tetcast_integrator)which, 128, 64, 2.0f);
            tetcast_optics *o = tables_make(k == 2 ? ramp : jumps, k == 2 ? 3 : 4, 0, &d);
            test_rng r = test_rng_make(77);
            double worst = 0;
            REQUIRE(o != NULL);
            for (i = 0; i < 1000; i++) {
                tetcast_segment s;
                float got[4];
                double want[4];
                s.front = k == 0 ? test_rng_range(&r, -0.5f, 0.29f) : k == 1 ? test_rng_range(&r, 0.71f, 1.5f) : test_rng_range(&r, -0.5f, 1.5f);
                s.back = k == 0 ? test_rng_range(&r, -0.5f, 0.29f) : k == 1 ? test_rng_range(&r, 0.71f, 1.5f) : test_rng_range(&r, -0.5f, 1.5f);
                s.length = 3.0f * test_rng_float(&r);
                s.depth = 0;
                CHECK(tetcast_optics_ray(o, &s, 1, got, NULL) == TETCAST_OK);
                oracle_segment(k == 2 ? ramp : jumps, k == 2 ? 3 : 4, 0, &s, want);
                for (c = 0; c < 4; c++) worst = fmax(worst, fabs((double)got[c] - want[c]));
            }
            CHECK_MSG(worst < 0.005, "%s, %d: %.3g", names[which], k, worst);
            tetcast_optics_destroy(o);
        }
}

TEST(equidistant_steps) { /* across segments and gaps: converges to the exact ray; the rest at the end counts */
    tetcast_segment s[60];
    test_rng r = test_rng_make(5);
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_EXACT, 0, 0, 0.0f);
    tetcast_optics *exact = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
    double error[3] = {0.0, 0.0, 0.0};
    int k, rep, i, c;
    for (k = 0; k < 3; k++) {
        tetcast_optics *o;
        r = test_rng_make(5);
        d = tables_desc_of(TETCAST_INTEGRATOR_TABLE_2D, 512, 0, 1.0f);
        d.step = 0.04f / (float)(1 << (2 * k));
        o = tables_make(oracle_smooth, ORACLE_SMOOTH, 0, &d);
        CHECK_EQ_U64(o->info.table_bytes, 512 * 512 * 16);
        for (rep = 0; rep < 50; rep++) {
            float v = test_rng_float(&r), a[4], b[4];
            for (i = 0; i < 60; i++) {
                if (i == 30) v = test_rng_float(&r); /* a gap */
                s[i].front = v;
                v += 0.1f * (test_rng_float(&r) - 0.5f);
                s[i].back = v;
                s[i].length = 0.05f * test_rng_float(&r);
                s[i].depth = 0.0f;
            }
            CHECK(tetcast_optics_ray(o, s, 60, a, NULL) == TETCAST_OK);
            CHECK(tetcast_optics_ray(exact, s, 60, b, NULL) == TETCAST_OK);
            for (c = 0; c < 4; c++) error[k] = fmax(error[k], fabs((double)a[c] - (double)b[c]));
        }
        tetcast_optics_destroy(o);
    }
    CHECK_MSG(error[0] < 0.05 && error[1] < 0.35 * error[0] && error[2] < 5e-4, "%g %g %g", error[0], error[1],
              error[2]);
    tetcast_optics_destroy(exact);
}

TEST(pending_step) { /* lengths that add up to just a step by rounding, then a segment of no length */
    static const tetcast_control_point p[3] = {{0.0f, {1, 0, 0}, 5.0f}, {0.5f, {0, 1, 0}, 0.0f}, {1.0f, {0, 1, 0}, 0.0f}};
    tetcast_optics_desc d;
    tetcast_segment s[4];
    tetcast_optics *o;
    float rgba[4];
    int i;
    memset(&d, 0, sizeof d);
    memset(s, 0, sizeof s);
    d.integrator = TETCAST_INTEGRATOR_TABLE_2D;
    d.longest = 4.0f;
    d.step = 1.0f;
    o = oracle_optics(p, 3, 0, NULL, 0, &d);
    for (i = 0; i < 4; i++) s[i].front = s[i].back = 1.0f; /* where nothing is */
    s[0].length = 1.0f - 5.9604645e-8f;
    s[1].length = 4.4703484e-8f;
    s[3].length = 1.0f;
    CHECK(tetcast_optics_ray(o, s, 4, rgba, NULL) == TETCAST_OK);
    CHECK_MSG(rgba[0] == 0.0f && rgba[1] == 0.0f && rgba[3] == 0.0f, "%g %g %g", (double)rgba[0], (double)rgba[1], (double)rgba[3]);
    tetcast_optics_destroy(o);
}

TEST(bad_tables) {
    tetcast_transfer *t = oracle_transfer(oracle_smooth, ORACLE_SMOOTH, 0, NULL, 0);
    tetcast_optics_desc d = tables_desc_of(TETCAST_INTEGRATOR_TABLE_3D, 0, 0, 0.0f);
    tetcast_optics *o = NULL;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_INVALID_ARG); /* longest */
    d.longest = 1.0f;
    d.table_values = 1;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_RANGE);
    d.table_values = 4096;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_RANGE);
    d.table_values = 64;
    d.table_lengths = 5000;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_RANGE);
    d.table_lengths = 16;
    d.longest = NAN;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_INVALID_ARG);
    d.longest = 1.0f;
    d.env.memory_limit = 100000;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_NO_MEMORY);
    d.env.memory_limit = 0;
    d.samples = 4097;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_INVALID_ARG);
    d.samples = 4096;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_OK);
    tetcast_optics_destroy(o);
    o = NULL;
    d.samples = 0;
    d.integrator = TETCAST_INTEGRATOR_COUNT;
    CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_INVALID_ARG);
    CHECK(o == NULL);
    d.integrator = TETCAST_INTEGRATOR_TABLE_SUBRANGE;
    {
        int64_t k;
        for (k = 0; k < 20; k++) {
            test_alloc ta;
            tetcast_result r;
            test_alloc_init(&ta);
            ta.fail_at = k;
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            r = tetcast_optics_create(t, &d, &o);
            CHECK(r == (ta.failed != 0 ? TETCAST_ERR_NO_MEMORY : TETCAST_OK));
            tetcast_optics_destroy(o);
            test_alloc_check(&ta);
            if (r == TETCAST_OK) break;
        }
        CHECK(k > 5 && k < 20);
    }
    tetcast_transfer_destroy(t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(oracle_against_brute_force);
    RUN(exp_of_negative);
    RUN(psi_and_its_table);
    RUN(errors_of_all);
    RUN(halved_steps);
    RUN(order_of_sampling);
    RUN(order_of_tables);
    RUN(pre_classification);
    RUN(prefix_is_exact_for_opacity);
    RUN(entries_of_the_exact_builder);
    RUN(subrange_is_the_plain_composite);
    RUN(incremental_near_the_exact);
    RUN(opacity_is_symmetric);
    RUN(local_update);
    RUN(threads_same_bits);
    RUN(lengths_beyond_the_table);
    RUN(values_outside);
    RUN(equidistant_steps);
    RUN(pending_step);
    RUN(bad_tables);
    return test_end();
}
