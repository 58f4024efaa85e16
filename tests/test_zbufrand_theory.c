/* Sample counts, probabilities and the law of a pixel: the thesis' table to the last digit, and simulations of bins and
   balls. Each statistical check fails by chance with probability below 1e-4; the seeds are fixed. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"

#define INF ((double)INFINITY)

static int is_nan(double x) { return x != x; }
static double rel(double a, double b) { return a == b ? 0.0 : fabs(a - b) / fabs(b); }

static double theory_gauss(test_rng *r) {
    double u = test_rng_double(r), v = test_rng_double(r);
    return sqrt(-2.0 * log(1.0 - u)) * cos(6.283185307179586 * v);
}

static uint32_t theory_poisson(test_rng *r, double mean) { /* exact below 60, normal above 400, else a sum */
    double limit, p = 1.0;
    uint32_t k = 0;
    if (mean > 400.0) return (uint32_t)floor(mean + sqrt(mean) * theory_gauss(r) + 0.5);
    for (; mean > 60.0; mean -= 50.0) k += theory_poisson(r, 50.0);
    limit = exp(-mean);
    for (;; k++) {
        p *= test_rng_double(r);
        if (p <= limit) return k;
    }
}

/* ---- elementary functions ---------------------------------------------------------------------------------------- */

TEST(elementary_functions) {
    test_rng r = test_rng_make(1);
    double e_exp = 0, e_expm1 = 0, e_log = 0, e_log1p = 0, e_gamma = 0, e_tail = 0, e_quantile = 0, eps = 2.220446049250313e-16;
    int i, n = test_quick() ? 20000 : 150000;
    for (i = 0; i < n; i++) {
        double u = test_rng_double(&r), x = (u - 0.5) * 1400.0, y, tiny = exp(-60.0 * test_rng_double(&r)) * (u < 0.5 ? -0.9 : 1.0);
        e_exp = fmax(e_exp, rel(zbufrandi_exp(x), exp(x)));
        e_exp = fmax(e_exp, rel(zbufrandi_exp(x * 0.01), exp(x * 0.01)));
        e_expm1 = fmax(e_expm1, fmax(rel(zbufrandi_expm1(tiny), expm1(tiny)), rel(zbufrandi_expm1(x * 0.02), expm1(x * 0.02))));
        y = exp(x);
        e_log = fmax(e_log, fmax(rel(zbufrandi_log(y), log(y)), rel(zbufrandi_log(1.0 + tiny), log(1.0 + tiny))));
        e_log1p = fmax(e_log1p, fmax(rel(zbufrandi_log1p(tiny), log1p(tiny)), rel(zbufrandi_log1p(y), log1p(y))));
        if (i % 16 == 0) {
            double g = 1e-3 + 60.0 * u * u, p = i % 32 == 0 ? u : exp(-700.0 * u), q = zbufrand_normal_quantile(p);
            e_gamma = fmax(e_gamma, fabs(zbufrandi_log_gamma(g) - lgamma(g)) / fmax(1.0, fabs(lgamma(g))));
            e_tail = fmax(e_tail, rel(zbufrandi_normal_above(u * 12.0), 0.5 * erfc(u * 12.0 / sqrt(2.0))));
            /* p moves by phi(q) dq: what an error in q costs */
            e_quantile = fmax(e_quantile, fabs(0.5 * erfc(-q / sqrt(2.0)) - p) / (exp(-0.5 * q * q) / 2.50662827463) / (1.0 + fabs(q)));
        }
    }
    CHECK_MSG(e_exp < 2.0 * eps, "exp: %g ulp", e_exp / eps);
    CHECK_MSG(e_expm1 < 3.0 * eps, "expm1: %g ulp", e_expm1 / eps);
    CHECK_MSG(e_log < 2.0 * eps, "log: %g ulp", e_log / eps);
    CHECK_MSG(e_log1p < 3.0 * eps, "log1p: %g ulp", e_log1p / eps);
    CHECK_MSG(e_gamma < 2e-14, "log gamma: %g", e_gamma);
    CHECK_MSG(e_tail < 1e-13, "normal tail: %g", e_tail);
    CHECK_MSG(e_quantile < 1e-13, "normal quantile: %g", e_quantile);
    CHECK(zbufrandi_exp(-800.0) == 0.0 && zbufrandi_exp(710.0) == INF && is_nan(zbufrandi_exp((double)NAN)));
    CHECK(zbufrandi_exp(-INF) == 0.0 && zbufrandi_exp(INF) == INF && zbufrandi_exp(0.0) == 1.0);
    CHECK(rel(zbufrandi_exp(-744.0), exp(-744.0)) < 0.2 && rel(zbufrandi_exp(709.7), exp(709.7)) < 1e-13);
    CHECK(zbufrandi_log(0.0) == -INF && zbufrandi_log(1.0) == 0.0 && is_nan(zbufrandi_log(-1.0)));
    CHECK(rel(zbufrandi_log(4.9e-324), log(4.9e-324)) < 1e-15 && zbufrandi_log(INF) == INF);
    CHECK(zbufrandi_log1p(-1.0) == -INF);
    CHECK_NEAR(zbufrand_normal_quantile(0.975), 1.959963984540054, 1e-13);
    CHECK_NEAR(zbufrand_normal_quantile(0.5), 0.0, 1e-15);
    CHECK(is_nan(zbufrand_normal_quantile(0.0)) && is_nan(zbufrand_normal_quantile(1.0)) && is_nan(zbufrand_normal_quantile((double)NAN)));
    {
        double h = 0.0, e = 0.0;
        for (i = 1; i < 3000; i++) {
            h += 1.0 / (double)i;
            e = fmax(e, rel(zbufrand_harmonic((double)i), h));
        }
        CHECK_MSG(e < 1e-13, "harmonic numbers: %g", e);
        CHECK_NEAR(zbufrand_harmonic(0.0), 0.0, 1e-14);
        CHECK_NEAR(zbufrand_harmonic(0.5), 2.0 - 2.0 * log(2.0), 1e-14);
        CHECK(is_nan(zbufrand_harmonic(-1.0)));
    }
}

/* ---- tables of the thesis ----------------------------------------------------------------------------------------- */

TEST(table_1) {
    static const double size[4][2] = {{320, 240}, {640, 480}, {800, 600}, {1024, 768}}, s[3] = {0.05, 0.5, 0.95};
    static const double want[4][3] = {{779652, 892063, 1092024}, {3544489, 3994137, 4793986}, {5752485, 6455060, 7704826},
                                      {9813151, 10964251, 13011868}};
    static const double harmonic[4] = {908251, 4058871, 6556204, 11129961}, overfill[4] = {11.62, 13.00, 13.45, 13.94};
    int i, j;
    for (i = 0; i < 4; i++) {
        double n = size[i][0] * size[i][1];
        for (j = 0; j < 3; j++) {
            CHECK(floor(zbufrand_samples(ZBUFRAND_BOUND_LEMMA2, n, n, 1.0, s[j]) + 0.5) == want[i][j]);
            CHECK(zbufrand_samples_lemma2(n, 0.0, s[j]) == zbufrand_samples(ZBUFRAND_BOUND_LEMMA2, n, n, 1.0, s[j]));
            CHECK(rel(zbufrand_samples(ZBUFRAND_BOUND_LEMMA3, n, n, 1.0, s[j]), want[i][j]) < 1e-5);
        }
        CHECK(floor(zbufrand_samples(ZBUFRAND_BOUND_THEOREM1, n, n, 1.0, 0.5) + 0.5) == harmonic[i]);
        CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_LEMMA2, n, n, 1.0, 0.5) / n, overfill[i], 0.005);
    }
    CHECK_NEAR(307200.0 * log(307200.0), 3881550.0, 1.0);
    { /* Theorem 2, c = 5: exceeded with probability 0.67 % */
        double n = 307200.0, m = zbufrand_samples(ZBUFRAND_BOUND_THEOREM2, n, n, 1.0, exp(-exp(-5.0)));
        CHECK_NEAR(m, n * log(n) + 5.0 * n, 1.0);
        CHECK_NEAR(1.0 - exp(-exp(-5.0)), 0.0067, 0.0001);
    }
}

TEST(corrected_bounds) { /* 640 x 480 */
    double n = 307200.0, a = 3.0 * n;
    CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_THEOREM5, a, n, 1.0, 0.99) / a, 17.95, 0.005);
    CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_DIRECT, a, n, 1.0, 0.99) / a, 17.24, 0.005);
    CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_UNION, a, n, 1.0, 0.99) / a, 17.24, 0.005);
    CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_THEOREM5, a, n, 1.0, 0.5) / a, 13.70, 0.005);
    CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_DIRECT, a, n, 1.0, 0.5) / a, 13.00, 0.005);
    CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_UNION, a, n, 1.0, 0.5) / a, 13.33, 0.005);
    CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_LEMMA2, 50.0 * n, n, 1.0, 0.99) / (50.0 * n), 21.1, 0.1);
    { /* the quadratic of Lemma 4: with m samples the normal law leaves m_v visible ones with probability sqrt(s) */
        double s = 0.95, m = zbufrand_samples(ZBUFRAND_BOUND_LEMMA4, a, n, 1.0, s), p = n / a, q = zbufrand_normal_quantile(sqrt(s));
        double m_v = -n * log(-expm1(log(s) * 0.5 / n));
        CHECK(rel(m * p - q * sqrt(m * p * (1.0 - p)), m_v) < 1e-12);
        CHECK(m < zbufrand_samples(ZBUFRAND_BOUND_THEOREM5, a, n, 1.0, s));
    }
    { /* windows: table of sample counts, millions */
        static const double sizes[3][2] = {{640, 480}, {1920, 1080}, {3840, 2160}}, d[5] = {1, 2, 3, 5, 10};
        static const double want[3][5] = {{5.30, 1.32, 0.588, 0.212, 0.053}, {39.7, 9.93, 4.41, 1.59, 0.40}, {170, 42.6, 18.9, 6.8, 1.7}};
        int i, j;
        for (i = 0; i < 3; i++) {
            for (j = 0; j < 5; j++) {
                double v = sizes[i][0] * sizes[i][1], m = zbufrand_samples(ZBUFRAND_BOUND_UNION, v, v, d[j], 0.99);
                CHECK_MSG(rel(m / 1e6, want[i][j]) < 0.01, "v %g d %g: %g M", v, d[j], m / 1e6);
                CHECK(rel(zbufrand_density(v, d[j], 0.99) * v, m) < 1e-14);
                CHECK_NEAR(zbufrand_success_bound(m / v, v, d[j]), 0.99, 1e-9);
                CHECK(zbufrand_success(m / v, v, d[j]) >= 0.99);
                m = zbufrand_samples(ZBUFRAND_BOUND_DIRECT, v, v, d[j], 0.99);
                CHECK_NEAR(zbufrand_success(m / v, v, d[j]), 0.99, 1e-9);
            }
        }
    }
    { /* the tolerance that the thesis took for useless */
        static const double c[6] = {0.5, 0.25, 0.1, 0.01, 1e-3, 1e-4}, thesis[6] = {12.31, 12.71, 12.90, 12.99, 13.00, 13.00};
        static const double right[6] = {0.693, 1.386, 2.303, 4.605, 6.908, 9.210};
        int i;
        for (i = 0; i < 6; i++) {
            double k = floor(c[i] * n);
            CHECK_NEAR(zbufrand_samples_lemma2(n, k, 0.5) / n, thesis[i], 0.006);
            CHECK_NEAR(zbufrand_samples_tolerant(n, n, k, 0.5) / n, right[i], i < 4 ? 0.001 : 0.01);
            CHECK_NEAR(zbufrand_samples_for_share(n, 1.0, c[i]) / n, right[i], 0.0005);
        }
        CHECK_NEAR(zbufrand_samples_for_share(1920.0 * 1080.0, 2.0, 0.01) / 1e6, 2.4, 0.05);
    }
    { /* comparison of the rules for cells, 320 x 240, s = 1/2: samples per block */
        static const double d[5] = {2, 3, 4, 5, 10}, floored[5] = {46.5, 104.5, 40.9, 63.9, 33.6};
        static const double ceiled[5] = {46.5, 23.0, 40.9, 26.2, 33.6}, rule_d[5] = {10.23, 9.42, 8.84, 8.40, 7.01};
        static const double wrong[5] = {2.83, 6.15, 11.2, 17.5, 68.6};
        double v = 76800.0;
        int i;
        for (i = 0; i < 5; i++) {
            double r = zbufrand_cell_edge(ZBUFRAND_CELLS_THESIS, d[i]), mu;
            CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_LEMMA3, v / (r * r), v / (r * r), 1.0, 0.5) / v * d[i] * d[i], floored[i], 0.06);
            CHECK_NEAR(zbufrand_samples(ZBUFRAND_BOUND_LEMMA3, v, v, d[i], 0.5) / v * d[i] * d[i], ceiled[i], 0.06);
            r = zbufrand_cell_edge(ZBUFRAND_CELLS_PRACTICE, d[i]);
            mu = zbufrand_samples(ZBUFRAND_BOUND_LEMMA3, v / (r * r), v / (r * r), 1.0, 0.5) / v * d[i] * d[i];
            CHECK_NEAR(mu, rule_d[i], 0.006);
            CHECK(fabs(zbufrand_expected_holes(mu / (d[i] * d[i]), v, d[i]) / wrong[i] - 1.0) < 0.03); /* measured there */
            CHECK(fabs(zbufrand_expected_holes(mu / (d[i] * d[i]), v, d[i]) / (d[i] * d[i] * log(2.0)) - 1.0) < 0.1);
            CHECK_NEAR(zbufrand_density(v, d[i], 0.5) * d[i] * d[i], 11.94, 0.006);
        }
    }
    CHECK_NEAR(zbufrand_smoothing_frames(0.1), 19.0, 1e-12);
    { /* time of painted blocks against one pixel: two machines of the thesis */
        double v = 307200.0, t1 = zbufrand_block_time(2.4e-6, 2.9e-9, v, v, 1.0);
        CHECK_NEAR(zbufrand_block_time(2.4e-6, 2.9e-9, v, v, 2.0) / t1, 0.223, 0.001);
        CHECK_NEAR(zbufrand_block_time(2.4e-6, 2.9e-9, v, v, 5.0) / t1, 0.031, 0.001);
        CHECK_NEAR(zbufrand_block_time(2.4e-6, 2.9e-9, v, v, 10.0) / t1, 0.0071, 0.0002);
    }
}

TEST(cells_of_blocks) { /* the largest cell that a block around any of its pixels covers has the edge ceil(d/2) */
    int d;
    for (d = 1; d <= 64; d++) {
        int lo = (d - 1) / 2, hi = d / 2, r, best = 0, x, ok;
        for (r = 1; r <= d; r++) {
            for (ok = 1, x = 0; x < r; x++) ok &= x - lo <= 0 && x + hi >= r - 1;
            if (ok) best = r;
        }
        CHECK((double)best == zbufrand_cell_edge(ZBUFRAND_CELLS_EXACT, (double)d));
        CHECK((double)(d / 2) == zbufrand_cell_edge(ZBUFRAND_CELLS_THESIS, (double)d));
    }
}

/* ---- bins and balls ----------------------------------------------------------------------------------------------- */

static unsigned char bins[1 << 17];

static uint32_t empty_after(test_rng *r, uint32_t n, uint64_t m) {
    uint32_t left = n;
    memset(bins, 0, n);
    while (m-- > 0) {
        uint32_t k = test_rng_below(r, n);
        left -= !bins[k];
        bins[k] = 1;
    }
    return left;
}

TEST(lemma_2_success_rate) {
    static const double s[3] = {0.05, 0.5, 0.95};
    test_rng r = test_rng_make(2);
    /* TEST_FULL=1: all pixels of 320 x 240 */
    const int full = getenv("TEST_FULL") != NULL;
    uint32_t n = full ? 76800 : 4096, trials = test_quick() ? 150 : full ? 3000 : 1200, t;
    int j;
    for (j = 0; j < 3; j++) {
        double m = zbufrand_samples_lemma2((double)n, 0.0, s[j]), se = sqrt(s[j] * (1.0 - s[j]) / (double)trials);
        uint32_t fixed = 0, spread = 0;
        for (t = 0; t < trials; t++) {
            fixed += empty_after(&r, n, (uint64_t)ceil(m)) == 0;
            spread += empty_after(&r, n, theory_poisson(&r, m)) == 0;
        }
        CHECK_MSG(fabs((double)fixed / trials - s[j]) < 4.0 * se + 0.003, "fixed number: %g for %g", (double)fixed / trials, s[j]);
        CHECK_MSG(fabs((double)spread / trials - s[j]) < 4.0 * se + 0.003, "Poisson number: %g for %g", (double)spread / trials, s[j]);
    }
}

TEST(empties_mean_and_variance) {
    static const double c[4] = {0.5, 0.1, 0.01, 0.001};
    test_rng r = test_rng_make(3);
    uint32_t n = 20000, trials = test_quick() ? 100 : 400, t;
    int j;
    for (j = 0; j < 4; j++) {
        double m = floor(zbufrand_samples_for_share((double)n, 1.0, c[j])), mean = 0, square = 0, want, var, ok = 0, tol;
        double m_s = zbufrand_samples_tolerant((double)n, (double)n, c[j] * n, 0.9);
        for (t = 0; t < trials; t++) {
            double x = empty_after(&r, n, (uint64_t)m);
            mean += x;
            square += x * x;
            ok += empty_after(&r, n, (uint64_t)m_s) <= c[j] * n;
        }
        mean /= trials;
        square = square / trials - mean * mean;
        want = n * exp(-m / n);
        var = zbufrand_holes_variance(m, (double)n);
        CHECK_MSG(fabs(mean - want) < 4.5 * sqrt(var / trials) + 0.02, "mean %g is not %g", mean, want);
        tol = 4.5 * sqrt((2.0 + 1.0 / var) / trials);
        CHECK_MSG(fabs(square / var - 1.0) < tol, "variance %g is not %g", square, var);
        CHECK_MSG(ok / trials > 0.9 - 4.0 * sqrt(0.09 / trials), "tolerated with probability %g", ok / trials);
    }
}

TEST(tolerant_counts_solve_the_binomial_law) {
    static const double n[4] = {50, 1000, 3000, 12345}, share[4] = {0.02, 0.3, 0.9, 0.001}, s[4] = {0.01, 0.5, 0.9, 0.9999};
    int i, j, l;
    for (i = 0; i < 4; i++) {
        for (j = 0; j < 4; j++) {
            for (l = 0; l < 4; l++) { /* sum the law */
                double k = floor(n[i] * share[j]), m = zbufrand_samples_tolerant(n[i], n[i], k, s[l]), p = exp(-m / n[i]), x, sum = 0.0;
                for (x = 0; x <= k; x++) {
                    sum += exp(lgamma(n[i] + 1.0) - lgamma(x + 1.0) - lgamma(n[i] - x + 1.0) + x * log(p) + (n[i] - x) * log1p(-p));
                }
                CHECK_MSG(fabs(sum - s[l]) < 1e-8 * n[i], "n %g k %g s %g: %.12g", n[i], k, s[l], sum);
            }
        }
    }
    { /* large n: near the normal law */
        double m = zbufrand_samples_tolerant(1e9, 1e9, 1e6, 0.99) / 1e9, p = exp(-m), z;
        z = (1e6 + 0.5 - 1e9 * p) / sqrt(1e9 * p * (1.0 - p));
        CHECK_NEAR(z, zbufrand_normal_quantile(0.99), 2e-3);
    }
}

static int compare_double(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

TEST(theorem_2_kolmogorov_smirnov) { /* the number of samples that fill all cells */
    static double x[1200];
    test_rng r = test_rng_make(5);
    uint32_t n = 4096, trials = test_quick() ? 200 : 1200, t;
    double worst = 0.0;
    for (t = 0; t < trials; t++) {
        uint32_t left = n;
        uint64_t m = 0;
        memset(bins, 0, n);
        for (; left != 0; m++) {
            uint32_t k = test_rng_below(&r, n);
            left -= !bins[k];
            bins[k] = 1;
        }
        x[t] = exp(-exp(-((double)m - n * log((double)n)) / n));
    }
    qsort(x, trials, sizeof x[0], compare_double);
    for (t = 0; t < trials; t++) worst = fmax(worst, fmax(fabs(x[t] - (double)t / trials), fabs(x[t] - (t + 1.0) / trials)));
    CHECK_MSG(worst < 2.23 / sqrt((double)trials) + 0.003, "largest distance %g", worst); /* p = 1e-4 */
    { /* and its mean is Theorem 1 */
        double m = zbufrand_samples(ZBUFRAND_BOUND_THEOREM1, n, n, 1.0, 0.5), c = (m - n * log((double)n)) / n;
        CHECK_NEAR(c, 0.5772, 0.001); /* mean of Gumbel's law */
    }
}

TEST(theorem_3_tail_bound) {
    test_rng r = test_rng_make(6);
    uint32_t n = 256, trials = test_quick() ? 1000 : 10000, t, beyond[7];
    uint64_t m = 512;
    double mean = n * pow(1.0 - 1.0 / n, (double)m), sd = sqrt(zbufrand_holes_variance((double)m, n));
    int j;
    memset(beyond, 0, sizeof beyond);
    for (t = 0; t < trials; t++) {
        double off = fabs(empty_after(&r, n, m) - mean);
        for (j = 1; j < 7; j++) beyond[j] += off >= j * sd;
    }
    for (j = 1; j < 7; j++) {
        double bound = zbufrand_holes_tail((double)m, n, j * sd);
        CHECK_MSG((double)beyond[j] / trials <= bound, "%d standard deviations: %g above the bound %g", j, (double)beyond[j] / trials, bound);
    }
    CHECK(zbufrand_holes_tail(1000.0, 100.0, 0.0) == 1.0 && zbufrand_holes_tail(0.0, 100.0, 1.0) == 0.0);
}

TEST(two_kinds_of_cells) { /* visible and hidden ones */
    static const double depth[4] = {1.5, 3, 10, 50}, s[2] = {0.5, 0.95};
    test_rng r = test_rng_make(7);
    uint32_t v = 256, trials = test_quick() ? 60 : 500, t;
    int i, j;
    for (i = 0; i < 4; i++) {
        for (j = 0; j < 2; j++) {
            double a = depth[i] * v, direct = zbufrand_samples(ZBUFRAND_BOUND_DIRECT, a, v, 1.0, s[j]);
            double m5 = zbufrand_samples(ZBUFRAND_BOUND_THEOREM5, a, v, 1.0, s[j]), q = zbufrand_normal_quantile(sqrt(s[j]));
            double m_v = -(double)v * log(-expm1(log(s[j]) * 0.5 / v)), printed = a / v * (m_v - q * sqrt(m_v));
            double se = sqrt(s[j] * (1.0 - s[j]) / trials);
            uint32_t ok_direct = 0, ok_5 = 0;
            for (t = 0; t < trials; t++) {
                uint32_t k;
                for (k = 0; k < 2; k++) {
                    uint64_t m = (uint64_t)ceil(k ? m5 : direct);
                    uint32_t left = v, all = (uint32_t)(a + 0.5);
                    memset(bins, 0, v);
                    while (m-- > 0) {
                        uint32_t x = test_rng_below(&r, all);
                        if (x < v) {
                            left -= !bins[x];
                            bins[x] = 1;
                        }
                    }
                    if (k) ok_5 += left == 0;
                    else ok_direct += left == 0;
                }
            }
            CHECK_MSG(fabs((double)ok_direct / trials - s[j]) < 4.0 * se + 0.005, "depth %g: direct %g for %g", depth[i], (double)ok_direct / trials, s[j]);
            CHECK_MSG((double)ok_5 / trials > s[j] - 4.0 * se, "depth %g: Theorem 5 %g for %g", depth[i], (double)ok_5 / trials, s[j]);
            CHECK(printed < m5); /* the printed sign would lower the number where it has to rise */
        }
    }
}

/* Foreground shapes in free positions; inside() of points in a picture of 64 x 64. */
static int inside(int shape, double x, double y) {
    x -= 32.3;
    y -= 31.6;
    switch (shape) {
    case 0: return fabs(x) < 27.2 && fabs(y) < 24.7;
    case 1: return x * x + y * y < 27.0 * 27.0;
    case 2: return y > -25.5 && fabs(x) < (25.3 - y) * 0.55; /* triangle */
    case 3: return x * x + y * y < 29.0 * 29.0 && x * x + y * y > 13.0 * 13.0;
    default: return fabs(0.8 * x + 0.6 * y) < 14.4 && fabs(0.6 * x - 0.8 * y) < 25.0; /* turned */
    }
}

TEST(windows_never_get_too_few) {
    enum { W = 64, G = 5, E = W + 2 * G };
    static unsigned char hit[E][E], row[E][E];
    static char guarded[W][W];
    test_rng r = test_rng_make(8);
    double s = 0.8;
    int d, shape, trials = test_quick() ? 15 : 60;
    for (d = 1; d <= 10; d++) {
        int lo = (d - 1) / 2, hi = d / 2;
        for (shape = 0; shape < 5; shape++) {
            int x, y, i, j, v = 0, ok = 0, t, direct = 0;
            double lambda;
            for (y = 0; y < W; y++) {
                for (x = 0; x < W; x++) {
                    int all = 1;
                    for (j = -hi; j <= lo + 1; j++) {
                        for (i = -hi; i <= lo + 1; i++) all &= inside(shape, x + i, y + j);
                    }
                    guarded[y][x] = (char)all;
                    v += all;
                }
            }
            CHECK(v > 200);
            for (direct = 0; direct < 2; direct++) {
                lambda = direct ? zbufrand_samples(ZBUFRAND_BOUND_DIRECT, v, v, d, s) / v : zbufrand_density(v, d, s);
                for (ok = 0, t = 0; t < trials; t++) {
                    uint32_t m = theory_poisson(&r, lambda * (double)(E * E));
                    int bad = 0;
                    memset(hit, 0, sizeof hit);
                    while (m-- > 0) {
                        double px = test_rng_double(&r) * (double)E, py = test_rng_double(&r) * (double)E;
                        if (inside(shape, px - (double)G, py - (double)G)) hit[(int)py][(int)px] = 1;
                    }
                    for (y = 0; y < E; y++) {
                        for (x = hi; x < E - lo; x++) {
                            unsigned char o = 0;
                            for (i = -hi; i <= lo; i++) o |= hit[y][x + i];
                            row[y][x] = o;
                        }
                    }
                    for (y = 0; y < W; y++) {
                        for (x = 0; x < W; x++) {
                            if (guarded[y][x]) {
                                unsigned char o = 0;
                                for (j = -hi; j <= lo; j++) o |= row[y + G + j][x + G];
                                bad |= !o;
                            }
                        }
                    }
                    ok += !bad;
                }
                CHECK_MSG((double)ok / trials > s - 4.0 * sqrt(s * (1.0 - s) / trials),
                          "d %d shape %d: right with probability %g (%s)", d, shape, (double)ok / trials, direct ? "direct" : "union");
            }
        }
    }
}

TEST(stratified_draws_keep_the_bound) { /* a cell of measure 0.1 that repeats K times along the order of the strata */
    static const int period[4] = {1, 7, 64, 128};
    test_rng r = test_rng_make(9);
    int n = 64, trials = test_quick() ? 20000 : 200000, i, j, t;
    double worst = 0.0, bound = zbufrand_empty_bound(n * 0.1, n);
    for (j = 0; j < 4; j++) {
        int empty = 0, empty_comb = 0;
        for (t = 0; t < trials; t++) {
            int hit = 0, hit_comb = 0;
            double u = test_rng_double(&r);
            for (i = 0; i < n && !(hit && hit_comb); i++) {
                double a = (i + test_rng_double(&r)) / n * period[j], b = (i + u) / n * period[j];
                hit |= a - floor(a) < 0.1;
                hit_comb |= b - floor(b) < 0.1;
            }
            empty += !hit;
            empty_comb += !hit_comb;
        }
        CHECK_MSG((double)empty / trials < bound + 4.0 * sqrt(bound / trials), "period %d: %g above %g", period[j], (double)empty / trials, bound);
        worst = fmax(worst, (double)empty_comb / trials);
    }
    CHECK_MSG(worst > 0.8, "a comb in step with the mesh: only %g", worst); /* why a common offset is not the default */
    CHECK_NEAR(zbufrand_empty_bound(6.4, INF), exp(-6.4), 1e-15);
    CHECK(bound < exp(-6.4));
    CHECK(zbufrand_empty_bound(0.0, 5.0) == 1.0 && zbufrand_empty_bound(5.0, 5.0) == 0.0);
    CHECK_NEAR(zbufrand_thinned_dispersion(0.3, 0.5), 0.65, 1e-15);
}

TEST(thinned_dispersion_law) { /* stratified candidates, each kept with probability rho; counts of a cell of measure 1/20 */
    test_rng r = test_rng_make(10);
    int n = 80, trials = test_quick() ? 5000 : 40000, t, i;
    double rho = 0.4, sum[2] = {0, 0}, square[2] = {0, 0}, f[2];
    for (t = 0; t < trials; t++) {
        double count[2] = {0, 0};
        for (i = 0; i < n; i++) {
            double x = (i + test_rng_double(&r)) / n;
            if (x > 0.3 + 0.3 / n && x < 0.35 + 0.3 / n) {
                count[0]++;
                count[1] += test_rng_double(&r) < rho;
            }
        }
        for (i = 0; i < 2; i++) {
            sum[i] += count[i];
            square[i] += count[i] * count[i];
        }
    }
    for (i = 0; i < 2; i++) f[i] = (square[i] / trials - sum[i] / trials * sum[i] / trials) / (sum[i] / trials);
    CHECK_NEAR(f[1], zbufrand_thinned_dispersion(f[0], rho), 5.0 * sqrt(2.0 / trials));
}

/* ---- the law of a pixel ------------------------------------------------------------------------------------------- */

TEST(pixel_law) {
    double area[4] = {0.3, 0.0, 0.5, 1.0}, p[4], value[4] = {1.0, 5.0, 0.25, 0.5}, var, mean, e, sum;
    int i;
    e = zbufrand_pixel_law(area, 4, 3.0, p);
    CHECK_NEAR(p[0], 1.0 - exp(-0.9), 1e-15);
    CHECK(p[1] == 0.0);
    CHECK_NEAR(p[2], exp(-0.9) * (1.0 - exp(-1.5)), 1e-15);
    CHECK_NEAR(p[3], exp(-2.4) * (1.0 - exp(-3.0)), 1e-15);
    CHECK_NEAR(e, exp(-5.4), 1e-16);
    CHECK_NEAR(p[0] + p[1] + p[2] + p[3] + e, 1.0, 1e-15);
    mean = zbufrand_expected_pixel(area, value, 4, 3.0, 0.1, &var);
    for (sum = e * 0.1, i = 0; i < 4; i++) sum += p[i] * value[i];
    CHECK_NEAR(mean, sum, 1e-15);
    for (sum = e * (0.1 - mean) * (0.1 - mean), i = 0; i < 4; i++) sum += p[i] * (value[i] - mean) * (value[i] - mean);
    CHECK_NEAR(var, sum, 1e-15);
    e = zbufrand_pixel_law(area, 4, 3.0, area); /* in place */
    CHECK(area[0] == p[0] && area[3] == p[3]);
    CHECK(zbufrand_pixel_law(NULL, 0, 1.0, NULL) == 1.0);
    CHECK(zbufrand_expected_pixel(NULL, NULL, 0, 1.0, 0.7, &var) == 0.7 && var == 0.0);
    area[1] = -1.0;
    CHECK(is_nan(zbufrand_pixel_law(area, 4, 1.0, p)) && is_nan(p[0]));
    CHECK(is_nan(zbufrand_expected_pixel(area, value, 4, 1.0, 0.0, &var)) && is_nan(var));
    area[0] = area[1] = 0.0;
    CHECK(zbufrand_pixel_law(area, 2, INF, p) == 1.0 && p[0] == 0.0);
}

TEST(front_share_table) {
    static const double alpha[3] = {0.10, 0.25, 0.50}, mu[5] = {0.1, 1, 3, 7, 13};
    static const double want[3][5] = {{0.105, 0.150, 0.273, 0.504, 0.728}, {0.260, 0.350, 0.555, 0.827, 0.961}, {0.512, 0.622, 0.818, 0.971, 0.9985}};
    int i, j;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 5; j++) {
            double area[2], p[2], empty;
            area[0] = alpha[i];
            area[1] = 1.0 - alpha[i];
            empty = zbufrand_pixel_law(area, 2, mu[j], p);
            CHECK_NEAR(zbufrand_front_share(alpha[i], mu[j]), want[i][j], 0.0006);
            CHECK_NEAR(zbufrand_front_share(alpha[i], mu[j]), p[0] / (1.0 - empty), 1e-14);
        }
    }
    CHECK(zbufrand_front_share(0.3, 0.0) == 0.3 && zbufrand_front_share(0.0, 5.0) == 0.0 && zbufrand_front_share(1.0, 5.0) == 1.0);
    CHECK_NEAR(zbufrand_front_share(0.3, 1e-9), 0.3, 1e-9);
}

static double ramp(double x) { return x < 0.0 ? 0.0 : x > 1.0 ? 1.0 : x; }
static double bend(double x) { x = ramp(x); return x < 0.5 ? 2.0 * x * x : 1.0 - 2.0 * (1.0 - x) * (1.0 - x); }

TEST(bleeding) { /* the closed form, the stack of many thin fragments that it sums up, and the table of the diagonal tilt */
    static const double ratio[5] = {0, 0.05, 0.1, 0.3, 0.5}, want[5] = {0.500, 0.2610, 0.1363, 0.0101, 0.00075};
    static const double tilted[5] = {0.5, 0.345, 0.214, 0.0107, 1.2e-4};
    static double area[2 * 20000];
    const int n = 20000;
    int i, j, k, diagonal;
    for (i = 0; i < 5; i++) {
        CHECK_NEAR(zbufrand_bleed(13.0, ratio[i], 1.0, 1.0), want[i], 0.0002);
        for (k = 1; k <= 4; k++) {
            double b = zbufrand_bleed(13.0, ratio[i] * 2.0, 2.0, k);
            CHECK(fabs(b / (k / (k + 1.0) * exp(-13.0 * ratio[i])) - 1.0) < 0.06);
        }
        for (diagonal = 0; diagonal < 2; diagonal++) {
            double sum = 0.0, hi = 1.0 + ratio[i];
            for (j = 0; j < n; j++) { /* slices of depth: a front one and a layer's one each */
                double z0 = hi * j / n, z1 = hi * (j + 1) / n, s;
                area[2 * j] = diagonal ? bend(z1) - bend(z0) : ramp(z1) - ramp(z0);
                area[2 * j + 1] = diagonal ? bend(z1 - ratio[i]) - bend(z0 - ratio[i]) : ramp(z1 - ratio[i]) - ramp(z0 - ratio[i]);
                s = area[2 * j]; /* fair order within a slice: swap every other one */
                if (j & 1) {
                    area[2 * j] = area[2 * j + 1];
                    area[2 * j + 1] = s;
                }
            }
            zbufrand_pixel_law(area, (size_t)(2 * n), 13.0, area);
            for (j = 0; j < n; j++) sum += area[2 * j + !(j & 1)];
            if (diagonal && i != 3) CHECK_MSG(fabs(sum / tilted[i] - 1.0) < 0.05, "diagonal %g: %g", ratio[i], sum);
            if (!diagonal) CHECK_MSG(fabs(sum - zbufrand_bleed(13.0, ratio[i], 1.0, 1.0)) < 2e-4, "even %g: %g", ratio[i], sum);
        }
    }
    CHECK_NEAR(zbufrand_bleed(3.0, 5.0, 1.0, 2.0), exp(-3.0) * (1.0 - exp(-6.0)), 1e-15); /* apart: a missing front */
    CHECK_NEAR(zbufrand_bleed(3.0, 0.0, 0.0, 2.0), exp(-3.0) * (1.0 - exp(-6.0)), 1e-15);
    CHECK(zbufrand_bleed(0.0, 0.1, 1.0, 1.0) == 0.0 && zbufrand_bleed(5.0, 0.1, 1.0, 0.0) == 0.0);
    { /* at most 1 % needs density gap / range >= ln 50 */
        CHECK_NEAR(zbufrand_bleed(log(50.0) / 0.3, 0.3, 1.0, 1.0), 0.01, 0.0005);
    }
}

TEST(multiple_hits) {
    static const double u[5] = {0.1, 0.25, 0.4, 0.5, 1.0}, want[5] = {0.0047, 0.0265, 0.0616, 0.0902, 0.2642};
    double n = 307200.0, k, p;
    int i;
    for (i = 0; i < 5; i++) {
        CHECK_NEAR(zbufrand_multi_hit(u[i] * n, n), want[i], 0.00006);
        CHECK_NEAR(zbufrand_multi_hit(u[i] * n, n), 1.0 - exp(-u[i]) * (1.0 + u[i]), 1e-6);
    }
    for (k = 2.0; k < 9.0; k++) { /* small numbers exactly */
        for (p = 1.0 / 3.0; p > 1e-9; p /= 7.0) {
            double sum = 0.0, j, c = 1.0;
            for (j = 0.0; j <= k; j++) {
                if (j >= 2.0) sum += c * pow(p, j) * pow(1.0 - p, k - j);
                c *= (k - j) / (j + 1.0);
            }
            CHECK_MSG(rel(zbufrand_multi_hit(k, 1.0 / p), sum) < 1e-11, "k %g p %g", k, p);
        }
    }
    CHECK(rel(zbufrand_multi_hit(0.001001 * 1e6, 1e6), zbufrand_multi_hit(0.000999 * 1e6, 1e6)) < 0.005); /* no step between the two ways */
    CHECK(zbufrand_multi_hit(0.0, 5.0) == 0.0 && zbufrand_multi_hit(1.0, 5.0) == 0.0 && zbufrand_multi_hit(2.0, 1.0) == 1.0);
    CHECK_NEAR(zbufrand_block_spill(0.5, 4.0, 1.0), 1.0 - exp(-2.0), 1e-15);
    CHECK(zbufrand_block_spill(0.5, 4.0, 2.0) == 0.0 && zbufrand_block_spill(0.0, 4.0, 1.0) == 0.0);
}

/* ---- extremes and bad arguments ----------------------------------------------------------------------------------- */

TEST(extremes) {
    double v = 1e10, s = 1.0 - 1e-12, m, u;
    int b;
    m = zbufrand_samples(ZBUFRAND_BOUND_UNION, 1e13, v, 1.0, s);
    CHECK(rel(m, 1e13 * (log(1e10) - log1p(-s))) < 1e-14);
    CHECK(rel(m, 1e13 * (log(1e10) + log(1e12))) < 1e-5);
    CHECK(zbufrand_samples(ZBUFRAND_BOUND_UNION, 1e19, v, 1.0, s) > 1.8446744073709552e19); /* more than 64 bits hold */
    m = zbufrand_samples(ZBUFRAND_BOUND_DIRECT, v, v, 1.0, s);
    CHECK(rel(m / v, log(v) - log(-log(s))) < 1e-9);
    u = zbufrand_samples(ZBUFRAND_BOUND_DIRECT, v, v, 1.0, 1e-12);
    CHECK(rel(u / v, log(v) - log(-log(1e-12))) < 1e-9);
    CHECK(zbufrand_success(m / v, v, 1.0) < 1.0 && rel(1.0 - zbufrand_success(m / v, v, 1.0), 1e-12) < 1e-3);
    CHECK_NEAR(zbufrand_success(u / v, v, 1.0), 1e-12, 1e-18);
    CHECK(zbufrand_samples_lemma2(1.0, 0.0, 0.5) == 1.0);
    for (b = 0; b < 8; b++) {
        zbufrand_bound bound = (zbufrand_bound)b;
        double last = 0.0, x;
        for (x = 1.0; x < 1e11; x *= 9.7) { /* grows with the number of pixels, is finite */
            m = zbufrand_samples(bound, 2.0 * x, x, 1.0, 0.9);
            CHECK_MSG(m > last && m < 1e15, "bound %d: %g pixels, %g samples", b, x, m);
            last = m;
        }
        CHECK(is_nan(zbufrand_samples(bound, (double)NAN, 1.0, 1.0, 0.5)) && is_nan(zbufrand_samples(bound, 10.0, (double)NAN, 1.0, 0.5)));
        CHECK(is_nan(zbufrand_samples(bound, 10.0, 5.0, (double)NAN, 0.5)) && is_nan(zbufrand_samples(bound, 10.0, 5.0, 1.0, (double)NAN)));
        CHECK(is_nan(zbufrand_samples(bound, 10.0, 0.0, 1.0, 0.5)) && is_nan(zbufrand_samples(bound, 4.0, 5.0, 1.0, 0.5)));
        CHECK(is_nan(zbufrand_samples(bound, 10.0, 5.0, 0.5, 0.5)) && is_nan(zbufrand_samples(bound, 10.0, 5.0, 1.0, 0.0)));
        CHECK(is_nan(zbufrand_samples(bound, 10.0, 5.0, 1.0, 1.0)) && is_nan(zbufrand_samples(bound, INF, 5.0, 1.0, 0.5)));
    }
    CHECK(is_nan(zbufrand_samples((zbufrand_bound)99, 10.0, 5.0, 1.0, 0.5)));
    CHECK(is_nan(zbufrand_density(0.0, 1.0, 0.5)) && is_nan(zbufrand_density(5.0, 0.0, 0.5)) && is_nan(zbufrand_density(5.0, 1.0, 2.0)));
    CHECK(zbufrand_density(1.0, 1.0, 0.5) > 0.0 && zbufrand_density(0.1, 1.0, 0.1) == 0.0);
    CHECK(is_nan(zbufrand_samples_for_share(5.0, 1.0, 0.0)) && zbufrand_samples_for_share(5.0, 1.0, 1.0) == 0.0);
    CHECK(is_nan(zbufrand_samples_tolerant(5.0, 5.0, 5.0, 0.5)) && is_nan(zbufrand_samples_tolerant(5.0, 5.0, -1.0, 0.5)));
    CHECK(is_nan(zbufrand_samples_tolerant(5.0, 5.0, 1.0, 1.0)) && is_nan(zbufrand_samples_tolerant(1e13, 1e13, 1.0, 0.5)));
    CHECK(is_nan(zbufrand_success(-1.0, 5.0, 1.0)) && is_nan(zbufrand_success((double)NAN, 5.0, 1.0)));
    CHECK(zbufrand_success(0.0, 5.0, 1.0) == 0.0 && zbufrand_success(0.0, 0.0, 1.0) == 1.0);
    CHECK(zbufrand_success(INF, 5.0, 1.0) == 1.0 && zbufrand_success_bound(0.0, 5.0, 1.0) == 0.0);
    CHECK(is_nan(zbufrand_success_bound((double)NAN, 5.0, 1.0)) && zbufrand_expected_holes(0.0, 5.0, 1.0) == 5.0);
    CHECK(is_nan(zbufrand_cell_edge(ZBUFRAND_CELLS_EXACT, 0.0)) && is_nan(zbufrand_cell_edge((zbufrand_cells)9, 2.0)));
    CHECK(is_nan(zbufrand_holes_variance(-1.0, 5.0)) && is_nan(zbufrand_holes_variance(1.0, 0.0)) && zbufrand_holes_variance(0.0, 5.0) == 0.0);
    CHECK(rel(zbufrand_holes_variance(0.0999 * 5.0, 5.0), zbufrand_holes_variance(0.1001 * 5.0, 5.0)) < 0.005);
    CHECK(rel(zbufrand_holes_variance(1e-6, 1.0), 0.5e-12) < 1e-5);
    CHECK(is_nan(zbufrand_holes_tail(1.0, 0.0, 1.0)) && is_nan(zbufrand_holes_tail(1.0, 5.0, -1.0)));
    CHECK(is_nan(zbufrand_front_share(1.5, 1.0)) && is_nan(zbufrand_front_share(0.5, -1.0)));
    CHECK(is_nan(zbufrand_bleed(1.0, -1.0, 1.0, 1.0)) && is_nan(zbufrand_bleed(1.0, 1.0, (double)NAN, 1.0)));
    CHECK(is_nan(zbufrand_block_spill(1.0, 0.0, 1.0)) && is_nan(zbufrand_multi_hit(1.0, 0.5)) && is_nan(zbufrand_multi_hit((double)NAN, 5.0)));
    CHECK(is_nan(zbufrand_empty_bound(2.0, 1.0)) && is_nan(zbufrand_thinned_dispersion(1.0, 1.5)));
    CHECK(is_nan(zbufrand_smoothing_frames(0.0)) && is_nan(zbufrand_smoothing_frames(1.1)) && zbufrand_smoothing_frames(1.0) == 1.0);
    CHECK(is_nan(zbufrand_block_time(1.0, 1.0, 5.0, 5.0, 3.0)) && is_nan(zbufrand_block_time(-1.0, 1.0, 5.0, 5.0, 1.0)));
}

static uint64_t hash_doubles(const double *p, size_t n, uint64_t hash) { /* the same on machines of either byte order */
    size_t i;
    for (i = 0; i < n; i++) {
        uint64_t x;
        memcpy(&x, &p[i], sizeof x);
        hash = (hash ^ x) * 0x100000001b3u;
        hash ^= hash >> 29;
    }
    return hash;
}

/* Where the formulas as they are written cancel or come to nothing; values by 400 digits. */
TEST(small_numbers) {
    static const double harmonic[6][2] = {{1e-300, 1.64493406684822648e-300}, {1e-9, 1.64493406564616964e-9}, {1.7105475536301064e-8,
        2.8137379087581965e-8}, {0.1, 0.153460724490456073}, {0.4999, 0.613612154515836839}, {0.75, 0.824688118448394024}};
    static const double several[4][3] = {{1.0134944697083033, 548.9300014769035, 2.27213429133226567e-8}, {1.0126410126552994,
        2.1086389045795615, 0.00214774828609770433}, {1.000000001, 1.5, 4.31945657869717774e-10}, {60.0, 600.5, 0.00460339719553394444}};
    int i;
    for (i = 0; i < 6; i++) CHECK_MSG(rel(zbufrand_harmonic(harmonic[i][0]), harmonic[i][1]) < 1e-14, "H of %g", harmonic[i][0]);
    CHECK(zbufrand_harmonic(0.0) == 0.0);
    CHECK(rel(zbufrand_harmonic(0.5 - 1e-16), zbufrand_harmonic(0.5)) < 1e-14);
    for (i = 0; i < 4; i++) CHECK_MSG(rel(zbufrand_multi_hit(several[i][0], several[i][1]), several[i][2]) < 1e-12, "multi_hit %d", i);
    CHECK(rel(zbufrand_samples(ZBUFRAND_BOUND_DIRECT, 0.1, 0.1, 1.0, 0.01), 1.00000000000000282e-21) < 1e-12);
    CHECK(rel(zbufrand_samples(ZBUFRAND_BOUND_DIRECT, 3.0, 2.0, 1.0, 0.5), 3.68384153189854704) < 1e-12);
    CHECK(rel(zbufrand_samples(ZBUFRAND_BOUND_LEMMA3, 0.5, 0.5, 1.0, 1e-9), 5.00000000000000063e-19) < 1e-12);
    CHECK(rel(zbufrand_samples_lemma2(1.0054292861823908, 0.8685887630269843, 0.0677565177899413), 5.48362305378398896e-10) < 1e-12);
    CHECK(rel(zbufrand_empty_bound(60.32724743532043, 60.327948228734016), 1.93146262010206214e-298) < 1e-12);
    CHECK(rel(zbufrand_success(0.0013682762071348172, 102.3178153730334, 1.0), 8.89529025551583458e-294) < 1e-12);
    CHECK(rel(zbufrand_samples_tolerant(2.0, 2.0, 1.0, 1e-9), 1.00000000050000006e-9) < 1e-12);
    CHECK(rel(zbufrand_samples_tolerant(5.0, 5.0, 4.0, 1e-200), 1e-200) < 1e-12); /* one of five: 1 - p^5 = s */
    CHECK(rel(zbufrand_samples_tolerant(40.0, 40.0, 39.0, 1.0 - 0x1p-39), -log1p(-(1.0 - 0x1p-39))) < 1e-12);
}

TEST(same_bits) { /* on every machine: the functions use no libm */
    uint64_t hash = 0;
    double x, area[3] = {0.2, 0.5, 1.0}, p[4];
    int b;
    for (b = 0; b < 8; b++) {
        for (x = 3.0; x < 1e8; x *= 2.3) {
            p[0] = zbufrand_samples((zbufrand_bound)b, 1.7 * x, x, 1.0 + b % 3, (b + 0.5) / 8.0);
            hash = hash_doubles(p, 1, hash);
        }
    }
    for (x = 0.1; x < 20.0; x *= 1.7) {
        p[0] = zbufrand_pixel_law(area, 3, x, p + 1);
        hash = hash_doubles(p, 4, hash);
        p[0] = zbufrand_bleed(x, 0.1, 0.7, 2.0);
        p[1] = zbufrand_front_share(0.3, x);
        p[2] = zbufrand_samples_tolerant(1e5, 1e5, 100.0 * x, 0.3);
        p[3] = zbufrand_normal_quantile(x / 21.0);
        hash = hash_doubles(p, 4, hash);
    }
    CHECK_EQ_U64(hash, 0xedca273e8c98ba0bu);
}

/* Numbers so large that the formulas as they are written would cancel; values to 30 digits from their series. */
TEST(large_numbers) {
    static const double probability[3] = {1e-3, 0.5, 0.99};
    double n, k, area[2] = {23, 0}, value[2] = {1, 0}, variance, open = exp(-23.0);
    int i;
    for (n = 1e6; n <= 1e12; n *= 100) {
        for (k = 1; k <= 1e4; k *= 10) {
            for (i = 0; i < 3; i++) { /* the binomial law at what is given back, added up downwards from k */
                double u = zbufrand_samples_tolerant(n, n, k, probability[i]) / n, p = exp(-u), x = -expm1(-u), sum = 0, term = 1, j, log_k;
                /* ln of C(n, k) p^k x^(n-k) without large numbers */
                for (log_k = 0, j = 0; j < k; j += 1) log_k += log1p(-j / n) - log((j + 1) / (n * p));
                term = exp(log_k + (n - k) * log1p(-p));
                u *= p * n * term; /* of u times the slope of the law: what a relative error of 1 would make */
                for (j = k; j >= 0 && term > 1e-18 * sum; j -= 1) {
                    sum += term;
                    term *= j * x / ((n - j + 1) * p);
                }
                CHECK_MSG(fabs(sum - probability[i]) < 1e-9 * u, "n %g, k %g, %g: %g", n, k, probability[i], fabs(sum - probability[i]) / u);
            }
        }
    }
    CHECK(rel(zbufrand_holes_tail(100, 1e12, 14), 0.7506221976299742) < 1e-12); /* n^2 - E^2 is 2 n m but for 1e-10 */
    CHECK(rel(zbufrand_holes_tail(1, 1e12, 3), 2 * exp(-4.5)) < 1e-11);
    CHECK(zbufrand_holes_tail(0, 5, 1) <= 0 && zbufrand_holes_tail(0, 5, 0) >= 1 && zbufrand_holes_tail(3, 1e200, 1) >= 0);
    (void)zbufrand_expected_pixel(area, value, 1, 1, 0, &variance); /* p (1 - p) */
    CHECK(rel(variance, open * -expm1(-23.0)) < 1e-12);
    value[0] = 1e6;
    (void)zbufrand_expected_pixel(area, value, 2, 1, 1e6 + 1, &variance);
    CHECK(rel(variance, open * -expm1(-23.0)) < 1e-9); /* the mean has errors of 1e-10 */
    { /* 1 - s is 5e-11 + 1.25e-21 */
        const double s = 1 - 1e-10, p = 0.5, q = -zbufrand_normal_quantile((1 - s) / (1 + sqrt(s))),
            m = -5e5 * log(-expm1(log1p(s - 1) / 1e6));
        CHECK(rel(zbufrand_samples(ZBUFRAND_BOUND_THEOREM5, 1e6, 5e5, 1, s), (m + q * sqrt(m)) / p) < 1e-12);
        CHECK(zbufrand_samples(ZBUFRAND_BOUND_LEMMA4, 1e6, 5e5, 1, s) < (m + q * sqrt(m)) / p);
    }
    CHECK(rel(zbufrand_samples_lemma2(1 + 1e-10, 0, 0.5), log(-expm1(log(0.5) / (1 + 1e-10))) / log(1.00000008274037e-10 / (1 + 1e-10))) < 1e-12);
    CHECK(rel(zbufrand_multi_hit(1 + 1e-9, 1e6), 0.5 * (1 + 1e-9) * 1.00000008274037e-9 * 1e-12) < 2e-6);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(elementary_functions);
    RUN(table_1);
    RUN(corrected_bounds);
    RUN(cells_of_blocks);
    RUN(lemma_2_success_rate);
    RUN(empties_mean_and_variance);
    RUN(tolerant_counts_solve_the_binomial_law);
    RUN(theorem_2_kolmogorov_smirnov);
    RUN(theorem_3_tail_bound);
    RUN(two_kinds_of_cells);
    RUN(windows_never_get_too_few);
    RUN(stratified_draws_keep_the_bound);
    RUN(thinned_dispersion_law);
    RUN(pixel_law);
    RUN(front_share_table);
    RUN(bleeding);
    RUN(multiple_hits);
    RUN(large_numbers);
    RUN(extremes);
    RUN(small_numbers);
    RUN(same_bits);
    return test_end();
}
