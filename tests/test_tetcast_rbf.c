/* test_tetcast_rbf.c - radial basis functions: values, files, the encoder's promise, pictures, traces, against doubles */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "../bench/baseline/rbf_steps.h"

/* ---- helpers ---- */

enum { RBF_MOST = 4096 };
static tetcast_rbf_function g_f[RBF_MOST];

static double kernel_oracle(tetcast_kernel kernel, double cut, double epsilon, double most, double d, double w) {
    const double q2 = d / (3.70 * w), q4 = d / (4.22 * w), q8 = d / (4.21 * w);
    const double e = exp(-0.5 * cut * cut), g = exp(-0.5 * d * d / (w * w));
    switch (kernel) {
    case TETCAST_KERNEL_GAUSS: return d < cut * w ? (g - e) / (1.0 - e) : 0.0;
    case TETCAST_KERNEL_GAUSS_CUT: return most * g > epsilon ? g : 0.0;
    case TETCAST_KERNEL_WENDLAND2: return q2 < 1.0 ? pow(1.0 - q2, 4.0) * (4.0 * q2 + 1.0) : 0.0;
    case TETCAST_KERNEL_WENDLAND4: return q4 < 1.0 ? pow(1.0 - q4, 6.0) * ((35.0 * q4 + 18.0) * q4 + 3.0) / 3.0 : 0.0;
    default: return q8 < 1.0 ? pow(1.0 - q8 * q8, 8.0) : 0.0;
    }
}

/* Sum over all functions in double; sum of the absolute values in *all. */
static double value_oracle(const tetcast_rbf_desc *d, const double p[3], uint32_t c, double *all) {
    const double cut = d->cut != 0.0f ? (double)d->cut : 3.5;
    double sum = (double)d->offset[c], most_weight = 0.0;
    size_t i;
    uint32_t a;
    *all = fabs(sum);
    for (i = 0; i < d->function_count; i++)
        for (a = 0; a < d->components; a++) most_weight = fmax(most_weight, fabs((double)d->functions[i].weight[a]));
    for (i = 0; i < d->function_count; i++) {
        const tetcast_rbf_function *f = &d->functions[i];
        double d2 = 0.0, most = 0.0, along = 0.0, length = 0.0, v;
        for (a = 0; a < 3; a++) {
            const double x = (p[a] - f->centre[a]) / (d->metric[a] != 0.0 ? d->metric[a] : 1.0);
            d2 += x * x;
            along += x * f->axis[a];
            length += f->axis[a] * f->axis[a];
        }
        if (f->stretch != 0.0) { /* what is along the axis counts 1 / stretch of it */
            along = along * along / length;
            d2 = d2 - along + along / (f->stretch * f->stretch);
        }
        for (a = 0; a < d->components; a++) most = fmax(most, fabs((double)f->weight[a]));
        v = (double)f->weight[c] * kernel_oracle(d->kernel, cut, d->epsilon > 0.0f ? (double)d->epsilon : 1e-3 * most_weight, most,
                                                 sqrt(d2), f->width);
        sum += v;
        *all += fabs(v);
    }
    return sum;
}

static tetcast_rbf_desc random_desc(uint64_t seed, uint32_t count, uint32_t components, double narrow, double wide, double shift) {
    test_rng r = test_rng_make(seed);
    tetcast_rbf_desc d;
    uint32_t i, a;
    memset(&d, 0, sizeof d);
    for (i = 0; i < count; i++) {
        for (a = 0; a < 3; a++) g_f[i].centre[a] = shift + test_rng_double(&r) * 2.0;
        g_f[i].width = narrow * pow(wide / narrow, test_rng_double(&r));
        for (a = 0; a < 4; a++) g_f[i].weight[a] = test_rng_range(&r, -1.0f, 1.0f);
        g_f[i].axis[0] = g_f[i].axis[1] = g_f[i].axis[2] = g_f[i].stretch = 0.0;
    }
    for (a = 0; a < 3; a++) {
        d.box_min[a] = shift;
        d.box_max[a] = shift + 2.0;
    }
    d.components = components;
    for (a = 0; a < 4; a++) d.offset[a] = 0.25f * (float)a - 0.1f;
    d.functions = g_f;
    d.function_count = count;
    return d;
}

/* Every second function of g_f becomes an ellipsoid. */
static void bend(const tetcast_rbf_desc *d, double most) {
    test_rng r = test_rng_make(4711);
    size_t i;
    uint32_t a;
    for (i = 0; i < d->function_count; i++)
        for (a = 0; a < 4; a++) {
            const double x = test_rng_double(&r) * 2.0 - 1.0;
            if (i % 2 == 0) continue;
            if (a < 3) g_f[i].axis[a] = 3.0 * x;
            else g_f[i].stretch = pow(most, x);
        }
}

static tetcast_rbf *make(const tetcast_rbf_desc *d) {
    tetcast_rbf *m = NULL;
    CHECK(tetcast_rbf_create(d, &m) == TETCAST_OK);
    return m;
}

static tetcast_result eval(const tetcast_rbf *m, tetcast_isa isa, uint32_t all, uint32_t threads, const double *p, size_t n, float *v,
                           float *j) {
    tetcast_rbf_eval_desc d;
    memset(&d, 0, sizeof d);
    d.isa = isa;
    d.all = all;
    d.env.thread_count = threads;
    return tetcast_rbf_eval(&d, m, p, n, v, j);
}

static void random_points(double *p, size_t n, const tetcast_rbf_desc *d, uint64_t seed) {
    test_rng r = test_rng_make(seed);
    size_t i;
    for (i = 0; i < 3 * n; i++) {
        const double side = d->box_max[i % 3] - d->box_min[i % 3];
        const uint32_t kind = test_rng_below(&r, 12); /* also on cell faces, and outside of the box */
        p[i] = d->box_min[i % 3] + side * (kind == 0 ? (double)test_rng_below(&r, 65) / 64.0
                                          : kind == 1 ? test_rng_double(&r) * 1.4 - 0.2 : test_rng_double(&r));
    }
}

/* ---- values ---- */

/* 2^x for x <= 0: relative error, and what is below. */
TEST(exponential) {
    test_rng r = test_rng_make(1);
    double worst = 0.0;
    int i;
    for (i = 0; i < 200000; i++) {
        const float x = i < 1000 ? (float)i * -0.12f : -119.0f * test_rng_float(&r);
        const double e = fabs((double)tetcasti_exp2_fast(x) / exp2((double)x) - 1.0);
        worst = e > worst ? e : worst;
    }
    CHECK_MSG(worst < 4e-7, "relative error %.3g", worst);
    CHECK(tetcasti_exp2_fast(-0.0f) == tetcasti_exp2_fast(0.0f));
    CHECK(tetcasti_exp2_fast(-150.0f) < 1e-36f && tetcasti_exp2_fast(-1e30f) < 1e-36f && tetcasti_exp2_fast(-INFINITY) < 1e-36f);
    CHECK(tetcasti_exp2_fast((float)NAN) < 1e-36f);
}

/* All kernels and numbers of components: near a sum in double, the same bits by lists and by all functions, scalar and
   vectors, any number of threads. */
TEST(sums) {
    enum { N = 500 };
    static double p[3 * N];
    static float v[4][4 * N];
    uint32_t kernel, n, i, c, k;
    for (kernel = 0; kernel < TETCAST_KERNEL_COUNT; kernel++)
        for (n = 1; n <= 4; n++) {
            tetcast_rbf_desc d = random_desc(77 + kernel, n == 1 ? 2000 : 150, n, 0.01, 0.3, -1.0);
            tetcast_rbf *m;
            const size_t count = test_quick() ? 200 : n == 1 ? N / 2 : N / 4;
            double worst = 0.0;
            d.kernel = (tetcast_kernel)kernel;
            if (kernel == TETCAST_KERNEL_GAUSS && n == 2) d.cut = 2.0f;
            if (n == 3) {
                d.metric[0] = 0.5;
                d.metric[1] = d.metric[2] = 2.0;
            }
            if (n == 3 || kernel + n == 5 || kernel + n == 2) bend(&d, 4.0);
            m = make(&d);
            REQUIRE(m != NULL);
            random_points(p, count, &d, 5 + n);
            CHECK(eval(m, TETCAST_ISA_SCALAR, 0, 1, p, count, v[0], NULL) == TETCAST_OK);
            CHECK(eval(m, TETCAST_ISA_SCALAR, 1, 1, p, count, v[1], NULL) == TETCAST_OK);
            CHECK(eval(m, TETCAST_ISA_AUTO, 0, 3, p, count, v[2], NULL) == TETCAST_OK);
            CHECK(eval(m, TETCAST_ISA_AUTO, 1, 2, p, count, v[3], NULL) == TETCAST_OK);
            for (k = 1; k < 4; k++) CHECK(memcmp(v[0], v[k], count * n * sizeof(float)) == 0);
            for (i = 0; i < count; i++)
                for (c = 0; c < n; c++) {
                    double all, want = value_oracle(&d, p + 3 * i, c, &all);
                    double e = fabs((double)v[0][i * n + c] - want) / (all + 1e-3);
                    /* the cut form jumps by epsilon where rounding decides */
                    if (kernel == TETCAST_KERNEL_GAUSS_CUT) e = e > 1.1e-3 ? e : 0.0;
                    if (!(e <= worst)) worst = e;
                }
            CHECK_MSG(worst < 3e-5, "kernel %u, %u components: %.3g", kernel, n, worst); /* centres are floats: 6e-8 / width */
            tetcast_rbf_destroy(m);
        }
}

/* A function that does not reach a point adds 0, which may turn a sum of -0: what comes out is the same by lists and by all. */
TEST(sign_of_zero) {
    enum { N = 9 };
    static const tetcast_isa isas[2] = {TETCAST_ISA_SCALAR, TETCAST_ISA_AUTO};
    float base[8], v[2][N], j[2][3 * N];
    uint32_t way, k, i, n;
    for (way = 0; way < 3; way++) {
        tetcast_rbf_function f[2];
        tetcast_rbf_desc d;
        tetcast_rbf *m;
        double p[3 * N];
        memset(&d, 0, sizeof d);
        memset(f, 0, sizeof f);
        for (k = 0; k < 3; k++) {
            d.box_max[k] = 10.0;
            f[0].centre[k] = 9.0; /* reaches none of the points */
        }
        f[0].width = f[1].width = 0.1;
        f[0].weight[0] = 1.0f;
        d.components = 1;
        d.kernel = TETCAST_KERNEL_POWER;
        d.functions = f;
        d.function_count = 1;
        if (way == 0) d.offset[0] = -0.0f;
        if (way == 1) { /* steps of -0 and of less along y */
            for (i = 0; i < 8; i++) base[i] = i == 2 ? -0.0f : i & 2 ? -5.0f : 0.0f;
            d.base = base;
            d.base_dims[0] = d.base_dims[1] = d.base_dims[2] = 2;
        }
        if (way == 2) { /* one that reaches them, with less than floats hold */
            f[1].weight[0] = -1e-38f;
            f[1].centre[0] = 0.1;
            d.function_count = 2;
        }
        m = make(&d);
        REQUIRE(m != NULL);
        for (i = 0; i < 3 * N; i++) p[i] = 0.0;
        for (i = 0; way == 2 && i < N; i++) /* towards the end of its reach */
            p[3 * i] = 0.1 + (double)m->record[m->record[0].w[0] > 0.0f].radius * m->scale[0] * (0.94 + 0.005 * i);
        for (n = 1; n <= N; n += 8) /* those that reach one point are picked from the list */
            for (k = 0; k < 2; k++) {
                for (i = 0; i < 2; i++) CHECK(eval(m, isas[k], i, 1, p, n, v[i], j[i]) == TETCAST_OK);
                CHECK(memcmp(v[0], v[1], n * sizeof(float)) == 0 && memcmp(j[0], j[1], 3 * n * sizeof(float)) == 0);
                for (i = 0; i < n; i++) CHECK(v[0][i] != 0.0f || !signbit(v[0][i]));
                for (i = 0; i < 3 * n; i++) CHECK(j[0][i] != 0.0f || !signbit(j[0][i]));
                CHECK(v[0][n - 1] == 0.0f);
            }
        tetcast_rbf_destroy(m);
    }
}

/* Jacobians against differences of the double sum, and they have the same bits everywhere. */
TEST(derivatives) {
    enum { N = 300 };
    static double p[3 * N];
    static float v[3 * N], j[2][9 * N];
    uint32_t kernel, i, c, a;
    for (kernel = 0; kernel < TETCAST_KERNEL_COUNT; kernel++) {
        tetcast_rbf_desc d = random_desc(99, 60, 3, 0.1, 0.4, 10.0);
        tetcast_rbf *m;
        double worst = 0.0, most = 0.0;
        if (kernel == TETCAST_KERNEL_GAUSS_CUT) continue; /* jumps */
        d.kernel = (tetcast_kernel)kernel;
        d.metric[1] = 2.0;
        d.metric[0] = d.metric[2] = 1.0;
        bend(&d, 1.5);
        m = make(&d);
        REQUIRE(m != NULL);
        random_points(p, N, &d, 3);
        CHECK(eval(m, TETCAST_ISA_SCALAR, 0, 1, p, N, v, j[0]) == TETCAST_OK);
        CHECK(eval(m, TETCAST_ISA_AUTO, 1, 2, p, N, NULL, j[1]) == TETCAST_OK);
        CHECK(memcmp(j[0], j[1], sizeof j[0]) == 0);
        for (i = 0; i < N; i++)
            for (c = 0; c < 3; c++)
                for (a = 0; a < 3; a++) {
                    const double h = 1e-5;
                    double q[3], all, up, down, want;
                    memcpy(q, p + 3 * i, sizeof q);
                    q[a] += h;
                    up = value_oracle(&d, q, c, &all);
                    q[a] -= 2.0 * h;
                    down = value_oracle(&d, q, c, &all);
                    want = (up - down) / (2.0 * h);
                    most = fmax(most, fabs(want));
                    if (!(fabs((double)j[0][(i * 3 + c) * 3 + a] - want) <= worst))
                        worst = fabs((double)j[0][(i * 3 + c) * 3 + a] - want);
                }
        /* a point within h of a rim sees its kink: 1e-3 of the slope */
        CHECK_MSG(worst < (kernel == TETCAST_KERNEL_GAUSS ? 1e-3 : 2e-5) * most, "kernel %u: %.3g of %.3g", kernel, worst, most);
        tetcast_rbf_destroy(m);
    }
}

/* Wide functions: values to 2e-6 of what is added up, slopes to 1e-5 of the largest by the formula, not by differences. */
TEST(wide_functions) {
    enum { N = 400 };
    static double p[3 * N];
    static float v[N], j[3 * N];
    static const uint32_t counts[5] = {1, 10, 100, 1000, 4096};
    uint32_t t, i, k, a;
    for (t = 0; t < (test_quick() ? 4u : 5u); t++) {
        tetcast_rbf_desc d = random_desc(60 + t, counts[t], 1, 0.2, 0.5, 0.0);
        tetcast_rbf *m = make(&d);
        double worst = 0, steep = 0, most = 0;
        REQUIRE(m != NULL);
        random_points(p, N, &d, t);
        CHECK(tetcast_rbf_eval(NULL, m, p, N, v, j) == TETCAST_OK);
        for (i = 0; i < N; i++) {
            double all, want[3] = {0, 0, 0}, way[3], d2, near_rim = 1;
            const double value = value_oracle(&d, p + 3 * i, 0, &all);
            for (k = 0; k < counts[t]; k++) {
                const double w2 = g_f[k].width * g_f[k].width, e = exp(-0.5 * 3.5 * 3.5);
                for (a = 0, d2 = 0; a < 3; a++) {
                    way[a] = p[3 * i + a] - g_f[k].centre[a];
                    d2 += way[a] * way[a];
                }
                near_rim = fmin(near_rim, fabs(sqrt(d2 / w2) - 3.5));
                if (d2 < 3.5 * 3.5 * w2) for (a = 0; a < 3; a++) want[a] -= (double)g_f[k].weight[0] * exp(-0.5 * d2 / w2) / (1 - e) * way[a] / w2;
            }
            worst = fmax(worst, fabs((double)v[i] - value) / (all + 1e-30));
            for (a = 0; a < 3; a++) {
                most = fmax(most, fabs(want[a]));
                if (near_rim > 1e-5) steep = fmax(steep, fabs((double)j[3 * i + a] - want[a])); /* there it has a kink */
            }
        }
        CHECK_MSG(worst < 2e-6, "%u functions: %g", counts[t], worst);
        CHECK_MSG(steep < 1e-5 * most, "%u functions: slopes off by %g of %g", counts[t], steep, most);
        tetcast_rbf_destroy(m);
    }
}

/* No function is missed in the list of any leaf: the bits of the sum over all of them, for very many points, a quarter in faces of leaves. */
TEST(no_function_missed) {
    enum { CHUNK = 10000 };
    static double p[3 * CHUNK];
    static float v[2][CHUNK];
    const uint32_t chunks = test_quick() ? TETCAST_KERNEL_COUNT : 100;
    uint32_t kernel, c, i;
    for (kernel = 0; kernel < TETCAST_KERNEL_COUNT; kernel++) {
        tetcast_rbf_desc d = random_desc(90 + kernel, 700, 1, 0.01, 0.3, 0.0);
        test_rng r = test_rng_make(kernel);
        tetcast_rbf *m;
        size_t wrong = 0;
        d.kernel = (tetcast_kernel)kernel;
        bend(&d, 3.0);
        m = make(&d);
        REQUIRE(m != NULL);
        for (c = kernel; c < chunks; c += TETCAST_KERNEL_COUNT) { /* all kernels together see 10^6 points */
            for (i = 0; i < 3 * CHUNK; i++) p[i] = i % 12 < 3 && i % 3 == c % 3 ? (double)test_rng_below(&r, 257) / 128.0 : 2.0 * test_rng_double(&r);
            CHECK(eval(m, TETCAST_ISA_AUTO, 0, 1, p, CHUNK, v[0], NULL) == TETCAST_OK && eval(m, TETCAST_ISA_AUTO, 1, 1, p, CHUNK, v[1], NULL) == TETCAST_OK);
            for (i = 0; i < CHUNK; i++) wrong += memcmp(&v[0][i], &v[1][i], 4) != 0;
        }
        CHECK_EQ_U64(wrong, 0);
        tetcast_rbf_destroy(m);
    }
}

/* Base grids: trilinear inside, the nearest node outside, thin ones. */
TEST(bases) {
    static const uint32_t dims[][3] = {{2, 2, 2}, {3, 4, 5}, {1, 4, 4}, {4, 1, 1}, {1, 1, 1}};
    float node[60], v[2];
    double p[6];
    uint32_t t, i;
    for (t = 0; t < 5; t++) {
        tetcast_rbf_desc d = random_desc(1, 0, 1, 1, 1, 0.0);
        tetcast_rbf *m;
        float want;
        for (i = 0; i < 60; i++) {
            const uint32_t x = i % dims[t][0], y = i / dims[t][0] % dims[t][1], z = i / dims[t][0] / dims[t][1];
            node[i] = 1.0f + (dims[t][0] > 1 ? 2.0f * (float)x / (float)(dims[t][0] - 1) : 0.0f) +
                      (dims[t][1] > 1 ? 3.0f * (float)y / (float)(dims[t][1] - 1) : 0.0f) +
                      (dims[t][2] > 1 ? 4.0f * (float)z / (float)(dims[t][2] - 1) : 0.0f);
        }
        memcpy(d.base_dims, dims[t], sizeof dims[t]);
        d.base = node;
        m = make(&d);
        REQUIRE(m != NULL);
        p[0] = 0.5;
        p[1] = 1.2;
        p[2] = 1.9;
        p[3] = p[4] = p[5] = 5.0;
        CHECK(tetcast_rbf_eval(NULL, m, p, 2, v, NULL) == TETCAST_OK);
        want = 1.0f + (dims[t][0] > 1 ? 2.0f * 0.25f : 0.0f) + (dims[t][1] > 1 ? 3.0f * 0.6f : 0.0f) + (dims[t][2] > 1 ? 4.0f * 0.95f : 0.0f);
        CHECK_NEAR(v[0], want, 1e-5);
        want = 1.0f + (dims[t][0] > 1 ? 2.0f : 0.0f) + (dims[t][1] > 1 ? 3.0f : 0.0f) + (dims[t][2] > 1 ? 4.0f : 0.0f);
        CHECK_NEAR(v[1], want, 1e-5);
        tetcast_rbf_destroy(m);
    }
}

TEST(bounds_hold) {
    test_rng r = test_rng_make(8);
    static float node[4 * 4 * 4];
    uint32_t kernel, t, i, a;
    for (i = 0; i < 64; i++) node[i] = test_rng_range(&r, -1.0f, 1.0f);
    for (kernel = 0; kernel < TETCAST_KERNEL_COUNT; kernel++) {
        tetcast_rbf_desc d = random_desc(5, 100, 1, 0.05, 0.3, 0.0);
        tetcast_rbf *m;
        d.kernel = (tetcast_kernel)kernel;
        d.base_dims[0] = d.base_dims[1] = d.base_dims[2] = 4;
        d.base = node;
        d.metric[0] = 0.5;
        d.metric[1] = d.metric[2] = 1.0;
        bend(&d, 3.0);
        m = make(&d);
        REQUIRE(m != NULL);
        for (t = 0; t < 60; t++) {
            double lo[3], hi[3], p[3 * 50];
            float v[50], j[150], least = 0.0f, most = 0.0f, steep = 0.0f;
            for (a = 0; a < 3; a++) {
                const double s = test_rng_double(&r) * (t % 3 == 0 ? 0.5 : 0.05);
                lo[a] = (2.0 - s) * test_rng_double(&r);
                hi[a] = lo[a] + s;
            }
            for (i = 0; i < 150; i++) p[i] = lo[i % 3] + (hi[i % 3] - lo[i % 3]) * test_rng_double(&r);
            CHECK(tetcast_rbf_bounds(m, 0, lo, hi, &least, &most, &steep) == TETCAST_OK);
            CHECK(tetcast_rbf_eval(NULL, m, p, 50, v, j) == TETCAST_OK);
            for (i = 0; i < 50; i++) {
                CHECK(v[i] >= least && v[i] <= most);
                CHECK(sqrt((double)j[3 * i] * (double)j[3 * i] + (double)j[3 * i + 1] * (double)j[3 * i + 1] +
                           (double)j[3 * i + 2] * (double)j[3 * i + 2]) <= (double)steep);
            }
        }
        tetcast_rbf_destroy(m);
    }
}

/* Each function is rounded when it is added; here, half a unit is lost 10000 times. */
TEST(bounds_of_many) {
    enum { K = 10000 };
    tetcast_rbf_function *f = (tetcast_rbf_function *)calloc(K, sizeof *f);
    const double at[3] = {0.5, 0.5, 0.5};
    float least = 0.0f, most = 0.0f, v = 0.0f;
    tetcast_rbf_desc d;
    tetcast_rbf *m;
    uint32_t i, a;
    REQUIRE(f != NULL);
    memset(&d, 0, sizeof d);
    for (i = 0; i < K; i++) {
        for (a = 0; a < 3; a++) f[i].centre[a] = 0.5;
        f[i].width = 0.1;
        f[i].weight[0] = 1.0f;
    }
    for (a = 0; a < 3; a++) d.box_max[a] = 1.0;
    d.functions = f;
    d.function_count = K;
    d.offset[0] = 16777216.0f;
    m = make(&d);
    REQUIRE(m != NULL);
    CHECK(tetcast_rbf_bounds(m, 0, at, at, &least, &most, NULL) == TETCAST_OK);
    CHECK(tetcast_rbf_eval(NULL, m, at, 1, &v, NULL) == TETCAST_OK);
    CHECK_MSG(v >= least && v <= most, "%.9g in %.9g .. %.9g", (double)v, (double)least, (double)most);
    tetcast_rbf_destroy(m);
    free(f);
}

/* Functions that are cut off high end in a jump: bounds on both sides of it, as near as doubles go. */
TEST(bounds_at_jumps) {
    int k;
    for (k = 0; k < 12; k++) {
        tetcast_rbf_desc d = random_desc(1, 1, 1, 0.3, 0.3, 0.0);
        const double epsilon = 1.0 - 0.5 * pow(0.3, k), reach = 0.3 * sqrt(-2.0 * log((double)(float)epsilon));
        tetcast_rbf *m;
        int i, wrong = 0, in = 0;
        d.kernel = TETCAST_KERNEL_GAUSS_CUT;
        d.epsilon = (float)epsilon;
        d.offset[0] = 0.0f;
        g_f[0].weight[0] = k % 2 ? 1.0f : -1.0f;
        for (i = 0; i < 3; i++) g_f[0].centre[i] = 1.0;
        m = make(&d);
        REQUIRE(m != NULL);
        for (i = -2000; i <= 2000; i++) {
            const double p[3] = {1.0 + reach * (1.0 + 2e-7 * i), 1.0, 1.0};
            float v, lo, hi;
            CHECK(eval(m, TETCAST_ISA_AUTO, 0, 1, p, 1, &v, NULL) == TETCAST_OK);
            CHECK(tetcast_rbf_bounds(m, 0, p, p, &lo, &hi, NULL) == TETCAST_OK);
            wrong += !(lo <= v && v <= hi);
            in += v != 0.0f;
        }
        CHECK_MSG(wrong == 0 && (in > 0 || k > 8), "epsilon %g: %d", epsilon, wrong);
        tetcast_rbf_destroy(m);
    }
}

/* The thinnest functions, seen from far away: no number is too large. */
TEST(thinnest_functions) {
    static const double distance[4] = {1e3, 1e9, 1e13, 1e200};
    int kernel, k;
    for (kernel = 0; kernel < (int)TETCAST_KERNEL_COUNT; kernel++) {
        tetcast_rbf_desc d = random_desc(2, 2, 1, 2e-6, 2e-6, 0.0);
        tetcast_rbf *m;
        d.kernel = (tetcast_kernel)kernel;
        for (k = 0; k < 2; k++) {
            g_f[k].axis[0] = 1.0;
            g_f[k].stretch = 1.0 / 64.0;
        }
        m = make(&d);
        REQUIRE(m != NULL);
        for (k = 0; k < 8; k++) {
            const double p[3] = {distance[k / 2], 3.0, k % 2 ? -distance[k / 2] : 2.0};
            float v[2], j[2][3];
            CHECK(eval(m, TETCAST_ISA_AUTO, 0, 1, p, 1, &v[0], j[0]) == TETCAST_OK);
            CHECK(eval(m, TETCAST_ISA_SCALAR, 1, 1, p, 1, &v[1], j[1]) == TETCAST_OK);
            CHECK(v[0] == d.offset[0] && v[1] == v[0]);
            CHECK(j[0][0] == 0.0f && j[0][1] == 0.0f && j[0][2] == 0.0f && j[1][0] == 0.0f && j[1][2] == 0.0f);
        }
        tetcast_rbf_destroy(m);
    }
}

/* Across faces of the cells that lists belong to, a little on both sides: no seam but the slope. */
TEST(no_seams) {
    enum { N = 400 };
    static double p[2][3 * N];
    static float v[2][N], j[3 * N];
    uint32_t kernel, i;
    for (kernel = 0; kernel < TETCAST_KERNEL_COUNT; kernel++) {
        tetcast_rbf_desc d = random_desc(21 + kernel, 1500, 1, 0.02, 0.3, -1.0);
        test_rng r = test_rng_make(kernel);
        tetcast_rbf *m;
        double worst = 0.0;
        d.kernel = (tetcast_kernel)kernel;
        d.epsilon = 1e-4f;
        m = make(&d);
        REQUIRE(m != NULL);
        CHECK(m->tree_depth >= 2);
        for (i = 0; i < N; i++) {
            const uint32_t a = i % 3, cells = 1u << (1 + test_rng_below(&r, m->tree_depth));
            uint32_t k;
            for (k = 0; k < 3; k++) p[0][3 * i + k] = p[1][3 * i + k] = -1.0 + 2.0 * test_rng_double(&r);
            p[0][3 * i + a] = -1.0 + 2.0 * (double)(1 + test_rng_below(&r, cells - 1)) / cells;
            p[1][3 * i + a] = p[0][3 * i + a] + 1e-7;
            p[0][3 * i + a] -= 1e-7;
        }
        CHECK(eval(m, TETCAST_ISA_AUTO, 0, 1, p[0], N, v[0], j) == TETCAST_OK);
        CHECK(eval(m, TETCAST_ISA_AUTO, 0, 1, p[1], N, v[1], NULL) == TETCAST_OK);
        for (i = 0; i < N; i++) {
            double all;
            (void)value_oracle(&d, p[0] + 3 * i, 0, &all);
            /* rounding of places, 2^-24, moves a value as well */
            worst = fmax(worst, (fabs((double)v[1][i] - (double)v[0][i]) - 5e-7 * fabs((double)j[3 * i + i % 3])) / (1.0 + all));
        }
        CHECK_MSG(worst < (kernel == TETCAST_KERNEL_GAUSS_CUT ? 1e-3 : 2e-5), "kernel %u: %g", kernel, worst);
        tetcast_rbf_destroy(m);
    }
}

/* Widths from far too small to far too large, weights of any size; places far from the origin. */
TEST(extremes) {
    tetcast_rbf_desc d = random_desc(4, 200, 1, 1e-5, 1e5, 0.0);
    tetcast_rbf *m;
    double p[3 * 100];
    float v[100], near_v[100], j[300], near_j[300];
    uint32_t i, k;
    test_rng r = test_rng_make(6);
    for (i = 0; i < 200; i++) g_f[i].weight[0] = (float)pow(10.0, (double)test_rng_range(&r, -30.0f, 30.0f));
    m = make(&d);
    REQUIRE(m != NULL);
    random_points(p, 100, &d, 2);
    CHECK(tetcast_rbf_eval(NULL, m, p, 100, v, NULL) == TETCAST_OK);
    for (i = 0; i < 100; i++) CHECK(v[i] - v[i] == 0.0f);
    tetcast_rbf_destroy(m);
    for (k = 0; k < 3; k++) { /* the same at the origin and far away */
        const double shift = k == 0 ? 0.0 : k == 1 ? 1048576.0 : 1073741824.0;
        d = random_desc(4, 200, 1, 0.05, 0.2, shift);
        m = make(&d);
        REQUIRE(m != NULL);
        random_points(p, 100, &d, 2);
        CHECK(tetcast_rbf_eval(NULL, m, p, 100, v, j) == TETCAST_OK);
        for (i = 0; i < 300; i++) { /* slopes: up to 10 each; places are 2^-22 apart at 2^30 */
            if (k == 0) near_j[i] = j[i];
            else CHECK_NEAR(j[i], near_j[i], k == 1 ? 1e-4 : 1e-3);
        }
        for (i = 0; i < 100; i++) {
            if (k == 0) near_v[i] = v[i];
            else CHECK_NEAR(v[i], near_v[i], 1e-4);
        }
        tetcast_rbf_destroy(m);
    }
    for (k = 0; k < TETCAST_KERNEL_COUNT; k++) { /* places that are far off, but finite: the base alone, no slope */
        float slope[2][9], value[2][3], lo, hi, steep;
        d = random_desc(4, 60, 1, 0.05, 0.9, 0.0);
        d.kernel = (tetcast_kernel)k;
        bend(&d, 30.0);
        m = make(&d);
        REQUIRE(m != NULL);
        for (i = 0; i < 61; i++) {
            const double off = i == 60 ? 1.7e308 : pow(10.0, 5.0 * i + 3.0);
            uint32_t a;
            memset(p, 0, 9 * sizeof *p);
            for (a = 0; a < 3; a++) p[3 * a + a] = off * (a == 1 ? -1.0 : 1.0);
            p[7] = off;
            CHECK(eval(m, TETCAST_ISA_AUTO, i % 2, 1, p, 3, value[0], slope[0]) == TETCAST_OK);
            CHECK(eval(m, TETCAST_ISA_SCALAR, i % 2, 1, p, 3, value[1], slope[1]) == TETCAST_OK);
            for (a = 0; a < 3; a++) CHECK(value[0][a] == d.offset[0] && value[1][a] == d.offset[0]);
            for (a = 0; a < 9; a++) CHECK(slope[0][a] == 0.0f && slope[1][a] == 0.0f);
            for (a = 0; a < 3; a++) {
                p[a] = -off;
                p[3 + a] = off;
            }
            CHECK(tetcast_rbf_bounds(m, 0, p, p + 3, &lo, &hi, &steep) == TETCAST_OK);
            CHECK(lo <= d.offset[0] && hi >= d.offset[0] && lo > -100.0f && hi < 100.0f && steep > 0.0f);
        }
        tetcast_rbf_destroy(m);
    }
    d = random_desc(4, 10, 1, 0.05, 0.2, 0.0);
    g_f[3].width = (double)NAN;
    CHECK(tetcast_rbf_create(&d, &m) == TETCAST_ERR_INVALID_ARG && m == NULL);
    g_f[3].width = 0.0;
    CHECK(tetcast_rbf_create(&d, &m) == TETCAST_ERR_INVALID_ARG);
    g_f[3].width = 0.1;
    g_f[4].centre[1] = (double)INFINITY;
    CHECK(tetcast_rbf_create(&d, &m) == TETCAST_ERR_INVALID_ARG);
    d = random_desc(4, 10, 1, 0.05, 0.2, 0.0);
    d.box_max[1] = -1.0;
    CHECK(tetcast_rbf_create(&d, &m) == TETCAST_ERR_INVALID_ARG);
    d = random_desc(4, 0, 1, 0.05, 0.2, 0.0); /* nothing at all: a constant */
    m = make(&d);
    REQUIRE(m != NULL);
    p[0] = (double)NAN;
    CHECK(tetcast_rbf_eval(NULL, m, p, 2, v, NULL) == TETCAST_OK && v[0] != v[0] && v[1] == d.offset[0]);
    CHECK(eval(m, (tetcast_isa)99, 0, 1, p, 2, v, NULL) == TETCAST_ERR_INVALID_ARG);
    tetcast_rbf_destroy(m);
    for (i = 0; i < 3; i++) d.box_max[i] = d.box_min[i]; /* a box that is a point */
    m = make(&d);
    REQUIRE(m != NULL);
    CHECK(tetcast_rbf_eval(NULL, m, d.box_min, 1, v, NULL) == TETCAST_OK && v[0] == d.offset[0]);
    tetcast_rbf_destroy(m);
}

/* ---- files ---- */

static unsigned char *save(const tetcast_rbf *m, size_t *size) {
    unsigned char *p;
    CHECK(tetcast_rbf_save_memory(m, NULL, 0, size) == TETCAST_OK);
    p = (unsigned char *)malloc(*size);
    if (p == NULL) return NULL;
    CHECK(tetcast_rbf_save_memory(m, p, *size - 1, size) == TETCAST_ERR_RANGE);
    CHECK(tetcast_rbf_save_memory(m, p, *size, size) == TETCAST_OK);
    return p;
}

/* The tornado of R. Crawfis, discontinuous by design. */
static void tornado(uint32_t n, float *out) {
    size_t i;
    for (i = 0; i < (size_t)n * n * n; i++, out += 3) {
        const double x = (double)(i % n) / (n - 1), y = (double)(i / n % n) / (n - 1), z = (double)(i / n / n) / (n - 1);
        const double xc = 0.5 + 0.1 * sin(10 * z), yc = 0.5 + 0.1 * cos(3 * z), r = 0.1 + 0.4 * z * z + 0.1 * z * sin(8 * z);
        double t = sqrt((x - xc) * (x - xc) + (y - yc) * (y - yc)), s = fabs(r - t), up = fmax(0.0, 0.1 * (0.1 - t * z));
        s = s > 0.2 + 0.1 * z ? 0.8 - s : 1.0;
        t = sqrt(t * t + up * up);
        s = (r + 0.2 + 0.1 * z - t) * s / ((t + 1e-11) * (1 + z));
        out[0] = (float)(s * (y - yc) + 0.1 * (x - xc));
        out[1] = (float)(0.1 * (y - yc) - s * (x - xc));
        out[2] = (float)(s * up);
    }
}

static tetcast_rbf_points grid_points(const float *values, uint32_t nx, uint32_t ny, uint32_t nz, uint32_t components) {
    tetcast_rbf_points p;
    memset(&p, 0, sizeof p);
    p.values.data = values;
    p.components = components;
    p.dims[0] = nx;
    p.dims[1] = ny;
    p.dims[2] = nz;
    p.count = (size_t)nx * ny * nz;
    return p;
}

TEST(files) {
    static float data[3 * 10 * 10 * 10];
    tetcast_rbf_points p = grid_points(data, 10, 10, 10, 3);
    tetcast_rbf_desc d = random_desc(7, 40, 2, 0.05, 0.3, 0.0);
    tetcast_rbf *m[2] = {NULL, NULL}, *again = NULL;
    uint32_t k, i;
    test_rng r = test_rng_make(3);
    tornado(10, data);
    CHECK(tetcast_rbf_fit(NULL, &p, NULL, &m[0]) == TETCAST_OK);
    CHECK(m[0] != NULL && m[0]->ellipsoids > 0 && m[0]->ellipsoids < m[0]->count);
    bend(&d, 4.0);
    m[1] = make(&d);
    for (k = 0; k < 2; k++) {
        size_t size, size2, n;
        unsigned char *b, *c;
        REQUIRE(m[k] != NULL);
        b = save(m[k], &size);
        REQUIRE(b != NULL);
        CHECK(tetcast_rbf_load_memory(NULL, b, size, &again) == TETCAST_OK);
        REQUIRE(again != NULL);
        CHECK(again->count == m[k]->count && memcmp(again->record, m[k]->record, again->count * sizeof *again->record) == 0);
        CHECK(again->index_count == m[k]->index_count);
        c = save(again, &size2);
        CHECK(c != NULL && size == size2 && memcmp(b, c, size) == 0);
        free(c);
        tetcast_rbf_destroy(again);
        for (n = 0; n < size; n += n < 230 ? 1 : 137) { /* any end that is too early */
            c = (unsigned char *)malloc(n + (n == 0));
            if (c == NULL) continue;
            memcpy(c, b, n);
            CHECK(tetcast_rbf_load_memory(NULL, c, n, &again) != TETCAST_OK && again == NULL);
            free(c);
        }
        c = (unsigned char *)malloc(size + 1); /* a byte too many */
        REQUIRE(c != NULL);
        memcpy(c, b, size);
        c[size] = 0;
        CHECK(tetcast_rbf_load_memory(NULL, c, size + 1, &again) != TETCAST_OK);
        for (i = 0; i < 230; i++) { /* damage: found by the checksum, or by what it says when that is right */
            const size_t at = i < 216 ? i : test_rng_below(&r, (uint32_t)size);
            const int seal = i % 3 != 0 && at >= 32;
            uint64_t sum;
            memcpy(c, b, size);
            c[at] = (unsigned char)(c[at] ^ (1u << test_rng_below(&r, 8)));
            if (i % 5 == 0 && at + 4 < size && at >= 32) memset(c + at, test_rng_below(&r, 2) ? 0xff : 0, 4);
            sum = tetcasti_rbf_checksum(c, size);
            if (seal) tetcasti_store_u64(c + 24, sum);
            again = NULL;
            if (tetcast_rbf_load_memory(NULL, c, size, &again) == TETCAST_OK) {
                double q[3];
                float v[4];
                CHECK(seal || memcmp(b, c, size) == 0);
                memcpy(q, again->box_min, sizeof q);
                CHECK(tetcast_rbf_eval(NULL, again, q, 1, v, NULL) == TETCAST_OK);
                tetcast_rbf_destroy(again);
            } else CHECK(again == NULL);
        }
        free(b);
        free(c);
    }
    {
        const char *path = test_temp_path(".rbf");
        char part[1100];
        size_t n = 0;
        CHECK(test_write_file(path, "old", 3)); /* is replaced */
        CHECK(tetcast_rbf_save_file(m[0], NULL, path) == TETCAST_OK);
        CHECK(tetcast_rbf_load_file(NULL, path, &again) == TETCAST_OK && again != NULL && again->count == m[0]->count);
        tetcast_rbf_destroy(again);
        snprintf(part, sizeof part, "%s.part", path);
        CHECK(test_read_file(part, &n) == NULL);
        CHECK(tetcast_rbf_save_file(m[0], NULL, "/nowhere/at/all.rbf") == TETCAST_ERR_IO);
        (void)remove(path);
        CHECK(tetcast_rbf_load_file(NULL, path, &again) == TETCAST_ERR_IO && again == NULL);
        CHECK(tetcast_rbf_load_file(NULL, "/", &again) == TETCAST_ERR_IO && again == NULL);
        if (strchr(path, '/') != NULL) { /* a folder has the name: nothing is left behind */
            snprintf(part, sizeof part, "%.*s/.", (int)(strrchr(path, '/') - path), path);
            CHECK(tetcast_rbf_save_file(m[0], NULL, part) == TETCAST_ERR_IO);
            snprintf(part, sizeof part, "%.*s/..part", (int)(strrchr(path, '/') - path), path);
            CHECK(test_read_file(part, &n) == NULL);
        }
    }
    tetcast_rbf_destroy(m[0]);
    tetcast_rbf_destroy(m[1]);
}

/* ---- the encoder ---- */

/* Largest and mean error at the points, from values asked for one by one. */
/* The largest weights that are allowed; epsilon is 1e-3 of them. */
TEST(files_of_large_weights) {
    static const float weight[] = {1e29f, 2e33f, 9e37f};
    uint32_t k, a;
    for (k = 0; k < 6; k++) {
        tetcast_rbf_function f;
        tetcast_rbf_desc d;
        tetcast_rbf *m, *again = NULL;
        unsigned char *p;
        size_t size;
        memset(&f, 0, sizeof f);
        memset(&d, 0, sizeof d);
        for (a = 0; a < 3; a++) {
            f.centre[a] = 0.5;
            d.box_max[a] = 1.0;
        }
        f.width = 0.1;
        f.weight[0] = weight[k % 3];
        d.functions = &f;
        d.function_count = 1;
        d.kernel = k < 3 ? TETCAST_KERNEL_GAUSS : TETCAST_KERNEL_GAUSS_CUT;
        m = make(&d);
        REQUIRE(m != NULL);
        p = save(m, &size);
        CHECK(tetcast_rbf_load_memory(NULL, p, size, &again) == TETCAST_OK);
        CHECK(again != NULL && again->count == 1 && again->weight[0] == weight[k % 3]);
        free(p);
        tetcast_rbf_destroy(again);
        d.epsilon = m->epsilon; /* what a model has may be asked for */
        again = make(&d);
        CHECK(again != NULL && again->epsilon == m->epsilon);
        tetcast_rbf_destroy(again);
        tetcast_rbf_destroy(m);
    }
}

static void errors(const tetcast_rbf *m, const tetcast_rbf_points *p, const double *at, const float *values, double range, double out[2]) {
    size_t i;
    uint32_t c;
    out[0] = out[1] = 0.0;
    for (i = 0; i < p->count; i++) {
        double q[3], e = 0.0;
        float v[4];
        if (at != NULL) memcpy(q, at + 3 * i, sizeof q);
        else {
            q[0] = p->origin[0] + (p->spacing[0] != 0.0 ? p->spacing[0] : 1.0) * (double)(i % p->dims[0]);
            q[1] = p->origin[1] + (p->spacing[1] != 0.0 ? p->spacing[1] : 1.0) * (double)(i / p->dims[0] % p->dims[1]);
            q[2] = p->origin[2] + (p->spacing[2] != 0.0 ? p->spacing[2] : 1.0) * (double)(i / p->dims[0] / p->dims[1]);
        }
        CHECK(tetcast_rbf_eval(NULL, m, q, 1, v, NULL) == TETCAST_OK);
        for (c = 0; c < p->components; c++)
            e += ((double)v[c] - (double)values[i * p->components + c]) * ((double)v[c] - (double)values[i * p->components + c]);
        e = sqrt(e) / range;
        out[0] = fmax(out[0], e);
        out[1] += e / (double)p->count;
    }
}

static double shock(const double *p) { /* two sheets, 2 cells wide on 24 */
    return tanh((p[0] + 0.4 * p[1] - 0.8) * 20.0) + 0.5 * tanh((sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) - 0.7) * 15.0);
}
static double ripple(const double *p) { /* of Marschner and Lobb, with one wave instead of six: 12 points see no more */
    const double x = 2 * p[0] - 1, y = 2 * p[1] - 1, z = 2 * p[2] - 1, r = sqrt(x * x + y * y);
    return (1.0 - sin(1.5707963267948966 * z) + 0.25 * (1.0 + cos(3.1415926535897931 * cos(1.5707963267948966 * r)))) / 2.5;
}

/* Between the points: no more than three times the error at them where the points resolve the field. Where they do not (sheets
   two cells wide, a tornado that jumps) the middles of cells as points hold that for a tenth of the range; for less they make
   it better only (4.6 and 9 times), and the report has to say so. */
TEST(between_the_points) {
    enum { N = 12 };
    static float value[3 * N * N * N];
    static const float asked[2] = {0.1f, 0.03f};
    int field, t, between;
    double without = 0;
    size_t i;
    for (field = 0; field < 3; field++)
        for (t = 0; t < (test_quick() ? 1 : 2); t++)
            for (between = 0; between < 2; between++) {
                tetcast_rbf_points p = grid_points(value, N, N, N, field == 2 ? 3 : 1);
                tetcast_rbf_fit_desc d;
                tetcast_rbf_report report;
                tetcast_rbf *m = NULL;
                double ratio;
                if (between == 0) without = 0;
                for (i = 0; i < p.count && field < 2; i++) {
                    const double at[3] = {(double)(i % N) / (N - 1), (double)(i / N % N) / (N - 1), (double)(i / N / N) / (N - 1)};
                    value[i] = (float)(field == 0 ? ripple(at) : shock(at));
                }
                if (field == 2) tornado(N, value);
                for (i = 0; i < 3; i++) p.spacing[i] = 1.0 / (N - 1);
                memset(&d, 0, sizeof d);
                d.max_error = asked[t];
                d.between = (uint32_t)between;
                CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK);
                CHECK(report.between_count > 10000);
                ratio = report.between_max / report.max_error;
                if (getenv("TEST_PRINT") != NULL)
                    printf("field %d tolerance %g between %d: %.2f times the error at the points, mean %.2f\n", field, (double)asked[t], between,
                           ratio, report.between_mean / report.mean_error);
                if (between) CHECK_MSG(ratio < without || ratio <= 1.0, "field %d, %g: %g times, %g without middles", field, (double)asked[t], ratio, without);
                else without = ratio;
                if (field == 0 || (between && t == 0)) CHECK_MSG(ratio <= 3.0, "field %d, %g, between %d: %g times", field, (double)asked[t], between, ratio);
                if (field == 2 && !between) CHECK_MSG(ratio > 3.0, "a tornado that jumps: only %g times", ratio);
                tetcast_rbf_destroy(m);
            }
}

TEST(promise) {
    enum { N = 12 };
    static float value[3 * N * N * N];
    static double at[3 * N * N * N];
    static const float asked[] = {0.1f, 0.03f, 0.01f};
    int field, t, scattered;
    size_t i;
    for (field = 0; field < 3; field++)
        for (t = 0; t < (test_quick() ? 1 : 3); t++)
            for (scattered = 0; scattered < 2; scattered++) {
                const uint32_t n = field == 2 ? 3 : 1;
                tetcast_rbf_points p = grid_points(value, N, N, N, n);
                tetcast_rbf_fit_desc d;
                tetcast_rbf_report report;
                tetcast_rbf *m = NULL;
                double e[2];
                test_rng r = test_rng_make(17);
                if ((field == 2 && (scattered || t == 2)) || (t == 2 && scattered == field)) continue;
                for (i = 0; i < p.count; i++) {
                    uint32_t a;
                    const size_t k[3] = {i % N, i / N % N, i / N / N};
                    for (a = 0; a < 3; a++)
                        at[3 * i + a] = scattered ? test_rng_double(&r) : (double)k[a] / (N - 1);
                    if (field < 2) value[i] = (float)(field == 0 ? ripple(at + 3 * i) : shock(at + 3 * i));
                }
                if (field == 2) tornado(N, value);
                for (i = 0; i < 3; i++) p.spacing[i] = 1.0 / (N - 1);
                if (scattered) {
                    p.positions.data = at;
                    p.positions.type = TETCAST_TYPE_F64;
                }
                memset(&d, 0, sizeof d);
                d.max_error = asked[t];
                if (t == 1 && scattered) d.method = TETCAST_RBF_METHOD_PURE;
                if (t == 1 && !scattered && field == 0) d.kernel = TETCAST_KERNEL_POWER;
                if (t == 1 && !scattered && field == 1) d.kernel = TETCAST_KERNEL_WENDLAND2;
                if (t == 0 && scattered) d.mean_error = 0.01f;
                CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK);
                REQUIRE(m != NULL);
                errors(m, &p, scattered ? at : NULL, value, report.range, e);
                CHECK_MSG(e[0] <= (double)asked[t] * (1.0 + 1e-4), "field %d, %g: %g", field, (double)asked[t], e[0]);
                CHECK_NEAR(e[0], report.max_error, 1e-5);
                CHECK_NEAR(e[1], report.mean_error, 1e-5);
                CHECK(report.p999_error <= report.max_error && report.rms_error >= report.mean_error);
                CHECK(d.mean_error == 0.0f || report.mean_error <= 0.01);
                CHECK(report.largest_weight < 100.0 && report.points == p.count && report.functions == m->count);
                if (getenv("TEST_PRINT") != NULL)
                    printf("field %d scattered %d tolerance %g: %u functions, %llu bytes, max %.4f mean %.5f, between %.4f %.5f\n", field,
                           scattered, (double)asked[t], report.functions, (unsigned long long)report.bytes, report.max_error,
                           report.mean_error, report.between_max, report.between_mean);
                if (!scattered && field < 2) CHECK(report.between_mean < 3.0 * report.mean_error + 0.003);
                if (field == 1 && t == 0 && !scattered) { /* plates are for sheets */
                    tetcast_rbf_report round;
                    tetcast_rbf *other = NULL;
                    d.round = 1;
                    CHECK(tetcast_rbf_fit(&d, &p, &round, &other) == TETCAST_OK);
                    CHECK(report.ellipsoids > report.functions / 10 && report.ellipsoids == m->ellipsoids && round.ellipsoids == 0);
                    CHECK_MSG(report.bytes < round.bytes, "%u and %u bytes", (unsigned)report.bytes, (unsigned)round.bytes);
                    tetcast_rbf_destroy(other);
                }
                tetcast_rbf_destroy(m);
            }
}

/* What is said about directions is so: angles at the points, those of short vectors count less. */
TEST(directions) {
    enum { N = 10 };
    static float value[3 * N * N * N], got[3 * N * N * N];
    static double at[3 * N * N * N];
    tetcast_rbf_points p = grid_points(value, N, N, N, 3);
    tetcast_rbf_fit_desc d;
    tetcast_rbf_report report;
    tetcast_rbf *m = NULL;
    double sum = 0, weights = 0, worst = 0;
    size_t i, low = 0;
    tornado(N, value);
    for (i = 0; i < p.count; i++) {
        at[3 * i] = (double)(i % N);
        at[3 * i + 1] = (double)(i / N % N);
        at[3 * i + 2] = (double)(i / N / N);
        if (i % 3 == 0) value[3 * i] *= 0.02f, value[3 * i + 1] *= 0.02f, value[3 * i + 2] *= 0.02f; /* short ones as well */
    }
    memset(value + 3 * 17, 0, 12); /* no direction at all */
    memset(&d, 0, sizeof d);
    d.max_error = 0.03f;
    CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK);
    REQUIRE(m != NULL && tetcast_rbf_eval(NULL, m, at, p.count, got, NULL) == TETCAST_OK);
    for (i = 0; i < p.count; i++) {
        double a2 = 0, b2 = 0, ab = 0, w, angle;
        int c;
        for (c = 0; c < 3; c++) {
            a2 += (double)value[3 * i + (size_t)c] * (double)value[3 * i + (size_t)c];
            b2 += (double)got[3 * i + (size_t)c] * (double)got[3 * i + (size_t)c];
            ab += (double)value[3 * i + (size_t)c] * (double)got[3 * i + (size_t)c];
        }
        w = fmin(1.0, sqrt(a2) / (0.05 * report.range));
        if (!(a2 > 0.0 && b2 > 0.0)) continue;
        low += w < 1.0;
        angle = w * acos(fmax(-1.0, fmin(1.0, ab / sqrt(a2 * b2)))) * 57.29577951308232;
        sum += angle;
        weights += w;
        worst = fmax(worst, angle);
    }
    CHECK(low > 100);
    CHECK_NEAR(report.direction_mean, sum / weights, 0.02);
    CHECK_NEAR(report.direction_max, worst, 0.02 * worst + 0.02);
    CHECK_MSG(worst > 0.5 && worst < 90.0, "%g degrees", worst);
    tetcast_rbf_destroy(m);
}

/* The middles of cells keep the error where that is asked for, and do not where it is not. */
TEST(middles) {
    enum { N = 12, CELLS = (N - 1) * (N - 1) * (N - 1) };
    static float value[N * N * N];
    static double at[3 * N * N * N];
    static uint32_t tets[4 * 5 * CELLS];
    tetcast_rbf_points p = grid_points(value, N, N, N, 1);
    double worst[2] = {0.0, 0.0};
    uint32_t between, tetra, i, k, n = 0;
    for (i = 0; i < N * N * N; i++) {
        at[3 * i] = i % N;
        at[3 * i + 1] = i / N % N;
        at[3 * i + 2] = i / N / N;
        value[i] = at[3 * i] + 0.37 * at[3 * i + 1] + 0.21 * at[3 * i + 2] > 8.3 ? 1.0f : 0.0f;
    }
    for (i = 0; i < CELLS; i += 7) /* some tetrahedra: one of a cell */
        for (k = 0; k < 4; k++) {
            static const uint32_t corner[4] = {0, 1, N, N * N};
            tets[n++] = i % (N - 1) + N * (i / (N - 1) % (N - 1)) + N * N * (i / (N - 1) / (N - 1)) + corner[k];
        }
    for (tetra = 0; tetra < 2; tetra++)
        for (between = 0; between < 2; between++) {
            tetcast_rbf_fit_desc d;
            tetcast_rbf_report report;
            tetcast_rbf *m = NULL;
            memset(&d, 0, sizeof d);
            d.max_error = 0.1f;
            d.between = between;
            if (tetra) {
                p.positions.data = at;
                p.positions.type = TETCAST_TYPE_F64;
                p.tets = tets;
                p.tet_count = n / 4;
            }
            CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK);
            REQUIRE(m != NULL);
            CHECK(report.points == (between ? p.count + (tetra ? n / 4 : CELLS) : p.count) && report.raw_bytes == p.count * (tetra ? 16 : 4));
            worst[between] = 0.0;
            for (i = 0; i < (tetra ? n / 4 : (uint32_t)CELLS); i++) {
                const uint32_t first = i % (N - 1) + N * (i / (N - 1) % (N - 1)) + N * N * (i / (N - 1) / (N - 1));
                double q[3] = {0.0, 0.0, 0.0}, want = 0.0;
                float v;
                uint32_t a;
                for (k = 0; k < (tetra ? 4u : 8u); k++) {
                    const uint32_t j = tetra ? tets[4 * i + k] : first + (k & 1u) + N * (k >> 1 & 1u) + N * N * (k >> 2);
                    for (a = 0; a < 3; a++) q[a] += at[3 * j + a] / (tetra ? 4.0 : 8.0);
                    want += (double)value[j] / (tetra ? 4.0 : 8.0);
                }
                CHECK(tetcast_rbf_eval(NULL, m, q, 1, &v, NULL) == TETCAST_OK);
                worst[between] = fmax(worst[between], fabs((double)v - want));
            }
            tetcast_rbf_destroy(m);
        }
    CHECK_MSG(worst[1] <= 0.1 * (1.0 + 1e-4) && worst[0] > 0.12, "%g without, %g with", worst[0], worst[1]);
}

/* The baseline: what it says of its error is so, it finds simple things, domains add up. */
TEST(thesis_steps) {
    enum { N = 9 };
    static double p[N * N * N][3], value[N * N * N * 2];
    int leaves;
    for (leaves = 0; leaves < 2; leaves++) {
        steps_desc d;
        steps_model m;
        double worst = 0.0;
        size_t i;
        for (i = 0; i < N * N * N; i++) {
            const double q[2][3] = {{0.3, 0.4, 0.5}, {0.7, 0.6, 0.45}};
            p[i][0] = (double)(i % N) / (N - 1);
            p[i][1] = (double)(i / N % N) / (N - 1);
            p[i][2] = (double)(i / N / N) / (N - 1);
            value[2 * i] = 0.2 + exp(-steps_way2(p[i], q[0]) / 0.06) - 0.7 * exp(-steps_way2(p[i], q[1]) / 0.05);
            value[2 * i + 1] = 0.5 * exp(-steps_way2(p[i], q[0]) / 0.1);
        }
        memset(&d, 0, sizeof d);
        d.max_error = 0.03;
        d.leaf = leaves ? 300 : 0;
        d.overlap = 0.15;
        d.rounds = 20;
        d.cut = 4.0;
        CHECK(steps_run(&d, (const double (*)[3])p, value, N * N * N, 2, &m));
        CHECK(m.leaves == (leaves ? 4u : 1u) && m.count > 1 && steps_bytes(&m) == m.count * 28 + 8 + (leaves ? 96 : 0));
        for (i = 0; i < N * N * N; i++) {
            double v[STEPS_MOST];
            steps_value(&m, d.cut, p[i], v);
            worst = fmax(worst, hypot(v[0] - value[2 * i], v[1] - value[2 * i + 1]));
        }
        CHECK_NEAR(worst, m.max_error, 1e-12);
        CHECK_MSG(m.max_error <= (leaves ? 2.0 : 1.0) * d.max_error, "%d leaves: %g with %lu functions", (int)m.leaves, m.max_error,
                  (unsigned long)m.count);
        CHECK_MSG(m.count < (leaves ? N * N * N : N * N * N / 4), "%lu", (unsigned long)m.count);
        steps_model_free(&m);
    }
}

/* ---- decoding ---- */

TEST(decoded) {
    static const tetcast_rbf_channel channels[3] = {TETCAST_RBF_CHANNEL_COMPONENT, TETCAST_RBF_CHANNEL_LENGTH,
                                                    TETCAST_RBF_CHANNEL_VORTICITY};
    int kind;
    for (kind = 0; kind < 3; kind++) {
        tetcast_rbf_desc d = random_desc(31, 40, kind == 0 ? 1 : 3, 0.15, 0.5, 3.0);
        tetcast_rbf *m;
        tetcast_bricks_desc bd;
        tetcast_bricks_report report;
        tetcast_bricks_info info;
        tetcast_bricks *b[2] = {NULL, NULL};
        tetcast_cut *cut = NULL;
        test_rng r = test_rng_make(5);
        double worst = 0.0;
        uint32_t i, a;
        d.box_max[2] = d.box_min[2] + 1.0;
        m = make(&d);
        REQUIRE(m != NULL);
        memset(&bd, 0, sizeof bd);
        bd.storage = TETCAST_TYPE_F32;
        bd.max_error = kind == 2 ? 0.2f : 0.02f;
        bd.checks = 20000;
        bd.longest_end = 129;
        bd.log_cells = 3;
        for (i = 0; i < (kind == 2 ? 1u : 2u); i++) { /* derivatives take the longest: once */
            bd.env.thread_count = i || kind == 2 ? 3 : 1;
            CHECK(tetcast_bricks_create_rbf(&bd, m, channels[kind], 0, &report, &b[i]) == TETCAST_OK);
            REQUIRE(b[i] != NULL);
        }
        if (kind < 2) CHECK(b[0]->count == b[1]->count && memcmp(b[0]->data, b[1]->data, b[0]->count * b[0]->nodes * 4) == 0);
        CHECK_MSG(report.above == 0 && report.error <= (double)bd.max_error && report.checks == 20000, "%g after %u tries", report.error,
                  report.tries);
        tetcast_bricks_get_info(b[0], &info);
        CHECK(info.lattice.dims[0] == info.lattice.dims[1] && info.lattice.dims[2] == (info.lattice.dims[0] + 1) / 2);
        REQUIRE(tetcast_cut_create(NULL, b[0], &cut) == TETCAST_OK);
        for (i = 0; i < 2000; i++) {
            double p[3], v[3], all, want;
            float x[3], got;
            for (a = 0; a < 3; a++) {
                p[a] = d.box_min[a] + test_rng_double(&r) * (d.box_max[a] - d.box_min[a]);
                x[a] = (float)((p[a] - info.lattice.origin[a]) / info.lattice.spacing[a]);
            }
            if (kind == 2) {
                float f[3], j[9];
                tetcast_flow flow;
                CHECK(tetcast_rbf_eval(NULL, m, p, 1, f, j) == TETCAST_OK);
                tetcast_flow_features(f, j, &flow);
                for (a = 0; a < 3; a++) v[a] = (double)flow.vorticity[a];
            } else for (a = 0; a < d.components; a++) v[a] = value_oracle(&d, p, a, &all);
            want = kind == 0 ? v[0] : sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
            tetcast_cut_sample(cut, x, x + 1, x + 2, 1, TETCAST_ISA_SCALAR, &got);
            worst = fmax(worst, fabs((double)got - want));
        }
        CHECK_MSG(worst <= 1.2 * (double)bd.max_error, "%d: %g", kind, worst); /* other points than those that were checked */
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(b[1]);
        bd.longest = 9; /* too coarse: says so */
        CHECK(tetcast_bricks_create_rbf(&bd, m, channels[kind], 0, &report, &b[1]) == TETCAST_OK && report.above > 0 && report.tries == 1);
        tetcast_bricks_destroy(b[0]);
        tetcast_bricks_destroy(b[1]);
        CHECK(tetcast_bricks_create_rbf(&bd, NULL, channels[0], 0, NULL, &b[0]) == TETCAST_ERR_INVALID_ARG && b[0] == NULL);
        CHECK(tetcast_bricks_create_rbf(&bd, m, channels[0], d.components, NULL, &b[0]) == TETCAST_ERR_INVALID_ARG);
        if (kind == 0) CHECK(tetcast_bricks_create_rbf(&bd, m, TETCAST_RBF_CHANNEL_HELICITY, 0, NULL, &b[0]) == TETCAST_ERR_INVALID_ARG);
        bd.longest = 0;
        bd.max_error = 0.0f;
        CHECK(tetcast_bricks_create_rbf(&bd, m, channels[0], 0, NULL, &b[0]) == TETCAST_ERR_INVALID_ARG);
        tetcast_rbf_destroy(m);
    }
}

TEST(same_model) {
    static float value[320 * 12 * 7];
    size_t i, size[5] = {0, 0, 0, 0, 0};
    unsigned char *bytes[5] = {NULL, NULL, NULL, NULL, NULL};
    double e[2];
    int k;
    for (k = 0; k < 5; k++) {
        /* the last two: a long bar in eight blocks */
        const uint32_t n[3] = {k < 3 ? 20 : 320, 12, 7};
        tetcast_rbf_points p = grid_points(value, n[0], n[1], n[2], 1);
        tetcast_rbf_fit_desc d;
        tetcast_rbf *m = NULL;
        for (i = 0; i < p.count; i++) {
            const double x = 0.1 * (double)(i % n[0]), y = 0.1 * (double)(i / n[0] % n[1]), z = 0.1 * (double)(i / n[0] / n[1]);
            value[i] = (float)(sin(2.0 * x + y) + cos(3.0 * z - x));
        }
        memset(&d, 0, sizeof d);
        d.max_error = k < 3 ? 0.05f : 0.2f;
        d.sweeps = 1;
        d.env.thread_count = k == 1 || k == 4 ? 3 : 1;
        d.isa = k == 0 || k == 3 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO;
        CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_OK);
        REQUIRE(m != NULL);
        if (k > 2) { /* from functions in all blocks */
            tetcast_rbf_report report;
            d.start = m;
            for (i = 0; i < p.count; i++) value[i] *= 1.0f + 0.001f * (float)(i % 320);
            CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK && report.started > d.start->count * 9 / 10);
            errors(m, &p, NULL, value, report.range, e);
            CHECK_MSG(e[0] <= 0.2001 && 2 * report.inserted < report.functions, "%g, %u of %u inserted", e[0], report.inserted, report.functions);
            tetcast_rbf_destroy((tetcast_rbf *)(uintptr_t)d.start);
        }
        bytes[k] = save(m, &size[k]);
        tetcast_rbf_destroy(m);
    }
    REQUIRE(bytes[0] != NULL && bytes[1] != NULL && bytes[2] != NULL && bytes[3] != NULL && bytes[4] != NULL);
    CHECK(size[0] == size[1] && memcmp(bytes[0], bytes[1], size[0]) == 0);
    CHECK(size[0] == size[2] && memcmp(bytes[0], bytes[2], size[0]) == 0);
    CHECK(size[3] == size[4] && memcmp(bytes[3], bytes[4], size[3]) == 0);
    for (k = 0; k < 5; k++) free(bytes[k]);
}

/* ---- few functions ---- */

/* Data that are a sum of ten functions come back as ten functions (eleven at most), whatever the instruction set and the
   number of threads; widths between the steps that are stored need not many more at a loose tolerance. */
TEST(few_come_back) {
    enum { N = 12, M = 10 };
    static float value[N * N * N * 2];
    const uint32_t dims[3] = {N, N, N}, first = test_quick() ? 8 : 0, end = test_quick() ? 10 : 24;
    uint32_t k, i, a;
    for (k = first; k < end; k++) {
        const uint32_t components = k % 3 == 2 ? 2 : 1, between = k % 4 == 1; /* of the steps of widths */
        tetcast_rbf_desc d = random_desc(300 + k, M, components, 0.2, 0.4, 0.0);
        tetcast_rbf_points p = grid_points(value, N, N, N, components);
        tetcast_rbf_fit_desc q;
        tetcast_rbf_report report;
        tetcast_rbf *m, *fit = NULL, *same = NULL;
        test_rng r = test_rng_make(40 + k);
        size_t size[2];
        void *bytes[2];
        double e[2];
        for (i = 0; i < M; i++) {
            g_f[i].width = 0.25 * exp2((between ? 8.0 * test_rng_double(&r) : (double)test_rng_below(&r, 9)) / 8.0);
            for (a = 0; a < 4; a++) g_f[i].weight[a] += g_f[i].weight[a] < 0.0f ? -0.5f : 0.5f;
        }
        m = make(&d);
        REQUIRE(m != NULL && tetcast_rbf_grid(NULL, m, dims, value) == TETCAST_OK);
        for (a = 0; a < 3; a++) p.spacing[a] = 2.0 / (N - 1);
        memset(&q, 0, sizeof q);
        q.max_error = between ? 0.05f : 1e-4f;
        q.env.thread_count = 1;
        q.isa = TETCAST_ISA_SCALAR;
        q.method = k % 2 == 0 ? TETCAST_RBF_METHOD_HYBRID : TETCAST_RBF_METHOD_PURE;
        CHECK(tetcast_rbf_fit(&q, &p, &report, &fit) == TETCAST_OK);
        REQUIRE(fit != NULL);
        CHECK_MSG(report.functions <= (between ? 2 * M : M + 1), "case %u: %u functions, %g", k, report.functions, report.max_error);
        errors(fit, &p, NULL, value, report.range, e);
        CHECK_MSG(e[0] <= (double)q.max_error * 1.0001, "case %u: %g", k, e[0]);
        q.env.thread_count = 3;
        q.isa = TETCAST_ISA_AUTO;
        CHECK(tetcast_rbf_fit(&q, &p, NULL, &same) == TETCAST_OK);
        REQUIRE(same != NULL);
        bytes[0] = save(fit, &size[0]);
        bytes[1] = save(same, &size[1]);
        CHECK(size[0] == size[1] && memcmp(bytes[0], bytes[1], size[0]) == 0);
        free(bytes[0]);
        free(bytes[1]);
        tetcast_rbf_destroy(fit);
        tetcast_rbf_destroy(same);
        tetcast_rbf_destroy(m);
    }
}

/* Tasks of blocks of one colour that run at once: between the blocks is room for the widest function, no more. */
static void tasks_looked_at(tetcast_task_fn *task, void *ctx, uint32_t count, void *user) {
    uint32_t *wide = (uint32_t *)user, i;
    for (i = 0; i < count; i++) task(ctx, i);
    if (task == tetcasti_task_fit_greedy && count > 1) {
        const tetcasti_fit *t = (const tetcasti_fit *)ctx;
        const size_t blocks = (size_t)t->blocks[0] * t->blocks[1] * t->blocks[2];
        size_t k, j;
        for (k = 0; k < blocks; k++)
            for (j = 0; j < t->block[k].count; j++) wide[1] += t->block[k].f[j].width > t->widest;
    }
    wide[0] += task == tetcasti_task_fit_greedy;
}

/* A broad function upon rounding that none keeps: what is added to the few that are fitted at once is as broad. */
TEST(few_and_more) {
    enum { N = 180 };
    static float value[N * N];
    const double w = 0.12 * N, e = exp(-0.5 * 3.5 * 3.5);
    tetcast_rbf_points p = grid_points(value, N, N, 1, 1);
    tetcast_rbf_fit_desc q;
    tetcast_rbf *m = NULL;
    uint32_t i, wide[2] = {0, 0};
    for (i = 0; i < N * N; i++) {
        const double x = i % N - 0.43 * N, y = i / N - 0.52 * N, g = exp(-(x * x + y * y) / (2.0 * w * w));
        value[i] = (float)(1000.0 + (g > e ? (g - e) / (1.0 - e) : 0.0));
    }
    memset(&q, 0, sizeof q);
    q.max_error = 5.2e-5f;
    q.method = TETCAST_RBF_METHOD_PURE;
    q.max_functions = 200;
    q.env.parallel.for_fn = tasks_looked_at;
    q.env.parallel.user = wide;
    CHECK(tetcast_rbf_fit(&q, &p, NULL, &m) == TETCAST_ERR_RANGE && m == NULL);
    CHECK_MSG(wide[0] != 0 && wide[1] == 0, "%u passes, %u functions too wide", wide[0], wide[1]);
    q.env.parallel.for_fn = NULL; /* by threads, for sanitizers */
    q.env.thread_count = 4;
    CHECK(tetcast_rbf_fit(&q, &p, NULL, &m) == TETCAST_ERR_RANGE && m == NULL);
}

/* A limit of the number counts for the few that are fitted at once, too. */
TEST(few_are_too_many) {
    enum { N = 20 };
    static float value[N * N * N];
    static const double c[3][4] = {{12.507, 7.106, 10.013, 1.823}, {9.659, 10.824, 12.401, 1.973}, {14.276, 5.395, 10.735, 3.031}};
    tetcast_rbf_points p = grid_points(value, N, N, N, 1);
    uint32_t i, k, most;
    for (i = 0; i < N * N * N; i++) {
        double s = 0.0;
        for (k = 0; k < 3; k++) {
            const double x = i % N - c[k][0], y = i / N % N - c[k][1], z = i / N / N - c[k][2];
            const double g = exp(-(x * x + y * y + z * z) / (2.0 * c[k][3] * c[k][3])), e = exp(-0.5 * 3.5 * 3.5);
            s += (k == 1 ? 1.0 : 1.5) * (g > e ? (g - e) / (1.0 - e) : 0.0);
        }
        value[i] = (float)s;
    }
    for (most = 0; most < 4; most++) {
        tetcast_rbf_fit_desc q;
        tetcast_rbf_report report;
        tetcast_rbf *m = NULL;
        tetcast_result got;
        memset(&q, 0, sizeof q);
        q.max_error = 0.01f;
        q.max_functions = most;
        got = tetcast_rbf_fit(&q, &p, &report, &m);
        CHECK_MSG(got == TETCAST_OK ? most == 0 || report.functions <= most : got == TETCAST_ERR_RANGE,
                  "%u allowed: %s, %u functions", most, tetcast_result_string(got), report.functions);
        CHECK(most != 0 || got == TETCAST_OK);
        tetcast_rbf_destroy(m);
    }
}

/* Doubles and integers that floats do not have: errors are against the data. */
TEST(values_that_are_no_floats) {
    enum { N = 12 };
    static double value[N * N * N];
    static int32_t integer[N * N * N];
    static const double offset[] = {0.0, 1e3, 1e5, 1e6, 1e8};
    uint32_t k, i, kind, good = 0;
    for (kind = 0; kind < 2; kind++)
        for (k = 0; k < 5; k++) {
            const double step = kind == 0 ? 1.0 : 1000.0; /* the largest integers: 1e9 and their bits */
            tetcast_rbf_points p = grid_points(NULL, N, N, N, 1);
            tetcast_rbf_fit_desc q;
            tetcast_rbf_report report;
            tetcast_rbf *m = NULL;
            tetcast_result got;
            double worst = 0.0;
            for (i = 0; i < N * N * N; i++) {
                value[i] = offset[k] + step * (sin(i % N * 0.5) * cos(i / N % N * 0.4) + 0.3 * sin(i / N / N * 0.6));
                integer[i] = (int32_t)(10.0 * value[i]);
                if (kind == 1) value[i] = (double)integer[i];
            }
            if (kind == 0) p.values.data = value;
            else p.values.data = integer;
            p.values.type = kind == 0 ? TETCAST_TYPE_F64 : TETCAST_TYPE_I32;
            memset(&q, 0, sizeof q);
            q.max_error = 0.01f;
            got = tetcast_rbf_fit(&q, &p, &report, &m);
            CHECK(got == TETCAST_OK || (got == TETCAST_ERR_RANGE && offset[k] >= 1e6));
            if (m == NULL) continue;
            good++;
            for (i = 0; i < N * N * N; i++) {
                const double at[3] = {i % N, i / N % N, i / N / N};
                float v;
                CHECK(tetcast_rbf_eval(NULL, m, at, 1, &v, NULL) == TETCAST_OK);
                worst = fmax(worst, fabs((double)v - value[i]) / report.range);
            }
            CHECK_MSG(worst <= 0.01 && worst <= report.max_error + 1e-9, "offset %g: %g, told %g", offset[k], worst, report.max_error);
            tetcast_rbf_destroy(m);
        }
    CHECK(good >= 7);
}

/* One value, which no float is: its error is a share of it. And a range so small that steps of weights are hardly floats: files
   of that are read. */
TEST(constants_and_tiny_ranges) {
    static const double constant[5] = {0.1, 101325.1, 1000000000.33, 6.02214076e23, -1.6e-19};
    static double value[6 * 6 * 6];
    tetcast_rbf_points p = grid_points(NULL, 6, 6, 6, 1);
    tetcast_rbf_fit_desc q;
    tetcast_rbf_report report;
    tetcast_rbf *m = NULL, *again = NULL;
    uint32_t i, k, got = 0;
    memset(&q, 0, sizeof q);
    p.values.data = value;
    p.values.type = TETCAST_TYPE_F64;
    for (k = 0; k < 5; k++) {
        const double at[3] = {1, 2, 3};
        float v;
        for (i = 0; i < 216; i++) value[i] = constant[k];
        REQUIRE(tetcast_rbf_fit(&q, &p, &report, &m) == TETCAST_OK);
        CHECK(tetcast_rbf_eval(NULL, m, at, 1, &v, NULL) == TETCAST_OK);
        CHECK_MSG(report.max_error < 1.2e-7 && fabs((double)v - constant[k]) / fmax(1.0, fabs(constant[k])) <= report.max_error * 1.001, "%g: told %g",
                  constant[k], report.max_error);
        tetcast_rbf_destroy(m);
    }
    q.max_error = 1e-6f;
    for (k = 0; k < 10; k++) {
        uint8_t *bytes;
        size_t size;
        for (i = 0; i < 216; i++) value[i] = 1.01e-30 * (5.0 + 0.25 * k + (double)((i * 2654435761u >> 8) % 1000u) / 999.0);
        if (tetcast_rbf_fit(&q, &p, &report, &m) != TETCAST_OK) continue;
        got++;
        bytes = save(m, &size);
        CHECK(tetcast_rbf_load_memory(NULL, bytes, size, &again) == TETCAST_OK);
        free(bytes);
        tetcast_rbf_destroy(again);
        tetcast_rbf_destroy(m);
    }
    CHECK(got >= 3);
}

/* ---- steps of a series ---- */

/* Sheets and a ripple that wander with the time. */
static void wander(uint32_t n, double time, float *out) {
    size_t i;
    for (i = 0; i < (size_t)n * n * n; i++) {
        const double at[3] = {(double)(i % n) / (n - 1), (double)(i / n % n) / (n - 1), (double)(i / n / n) / (n - 1)};
        const double moved[3] = {at[0] + 0.3 * time, at[1] - 0.2 * time, at[2]};
        out[i] = (float)(shock(moved) + 0.5 * ripple(at) + 0.2 * time * sin(3.0 * at[2]));
    }
}

/* An earlier result as a start: the same promise, fewer functions to find, as few bytes as without; plates stay plates. */
TEST(series) {
    enum { N = 14, STEPS = 5 };
    static float value[N * N * N];
    tetcast_rbf *last = NULL, *cold = NULL, *warm = NULL;
    uint64_t bytes[2] = {0, 0}, inserted[2] = {0, 0}, ellipsoids[2] = {0, 0};
    uint32_t step, k;
    for (step = 0; step < STEPS; step++) {
        tetcast_rbf_points p = grid_points(value, N, N, N, 1);
        tetcast_rbf_fit_desc d;
        tetcast_rbf_report alone, with;
        double e[2];
        wander(N, 0.02 * step, value);
        for (k = 0; k < 3; k++) p.spacing[k] = 1.0 / (N - 1);
        memset(&d, 0, sizeof d);
        d.max_error = 0.03f;
        CHECK(tetcast_rbf_fit(&d, &p, &alone, &cold) == TETCAST_OK && alone.started == 0);
        REQUIRE(cold != NULL);
        if (step == 0) {
            last = cold;
            continue;
        }
        d.start = last;
        CHECK(tetcast_rbf_fit(&d, &p, &with, &warm) == TETCAST_OK);
        REQUIRE(warm != NULL);
        errors(warm, &p, NULL, value, with.range, e);
        CHECK_MSG(e[0] <= 0.03 * (1.0 + 1e-4), "step %u: %g", step, e[0]);
        CHECK_NEAR(e[0], with.max_error, 1e-5);
        CHECK_MSG(with.started > last->count * 9 / 10 && with.started <= last->count, "step %u: %u of %u", step, with.started, last->count);
        CHECK(memcmp(with.base_dims, last->dims, sizeof with.base_dims) == 0 && with.functions == warm->count);
        CHECK(with.functions == with.started + with.inserted - with.dropped);
        bytes[0] += alone.bytes;
        bytes[1] += with.bytes;
        inserted[0] += alone.inserted;
        inserted[1] += with.inserted;
        if (getenv("TEST_PRINT") != NULL)
            printf("step %u: %u functions, %u bytes, %u inserted; from the step before %u, %u bytes, %u kept, %u inserted, %u dropped\n", step,
                   alone.functions, (unsigned)alone.bytes, alone.inserted, with.functions, (unsigned)with.bytes, with.started, with.inserted, with.dropped);
        ellipsoids[0] += alone.ellipsoids;
        ellipsoids[1] += with.ellipsoids;
        tetcast_rbf_destroy(cold);
        tetcast_rbf_destroy(last);
        last = warm;
    }
    CHECK_MSG(2 * inserted[1] < inserted[0], "%u inserted, %u without a start", (unsigned)inserted[1], (unsigned)inserted[0]);
    CHECK_MSG(3 * ellipsoids[1] > 2 * ellipsoids[0], "%u plates, %u without a start", (unsigned)ellipsoids[1], (unsigned)ellipsoids[0]);
    CHECK_MSG((double)bytes[1] < 1.1 * (double)bytes[0], "%u bytes, %u without a start", (unsigned)bytes[1], (unsigned)bytes[0]);
    tetcast_rbf_destroy(last);
}

/* A start in another box, of another kind, of functions that no point is near; the same bits however it is computed. */
TEST(starts) {
    enum { N = 12 };
    static float value[N * N * N], other[N * N * N];
    tetcast_rbf_points p = grid_points(value, N, N, N, 1);
    tetcast_rbf_fit_desc d;
    tetcast_rbf_report report;
    tetcast_rbf *m = NULL, *first = NULL, *odd;
    tetcast_rbf_desc r = random_desc(5, 300, 1, 0.01, 0.9, 3.0);
    unsigned char *bytes[3];
    size_t size[3], i;
    double e[2];
    int k;
    for (k = 0; k < 3; k++) {
        p.spacing[k] = 2.0 / (N - 1);
        p.origin[k] = 3.0;
    }
    wander(N, 0.0, value);
    memset(&d, 0, sizeof d);
    CHECK(tetcast_rbf_fit(&d, &p, &report, &first) == TETCAST_OK);
    REQUIRE(first != NULL);
    d.start = first;
    wander(N, 0.03, value);
    for (k = 0; k < 3; k++) {
        d.env.thread_count = k == 1 ? 3 : 1;
        d.isa = k == 2 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO;
        CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK && report.started > 0);
        REQUIRE(m != NULL);
        bytes[k] = save(m, &size[k]);
        tetcast_rbf_destroy(m);
        REQUIRE(bytes[k] != NULL);
        CHECK(size[k] == size[0] && memcmp(bytes[k], bytes[0], size[0]) == 0);
    }
    for (k = 0; k < 3; k++) free(bytes[k]);
    for (k = 0; k < 3; k++) p.origin[k] = 4.0; /* half of each side: an eighth of the functions, about */
    CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK && report.started < first->count / 2);
    REQUIRE(m != NULL);
    errors(m, &p, NULL, value, report.range, e);
    CHECK_MSG(e[0] <= 0.0501, "another box: %g", e[0]);
    tetcast_rbf_destroy(m);
    for (k = 0; k < 3; k++) p.origin[k] = 40.0;
    CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK && report.started == 0);
    tetcast_rbf_destroy(m);
    for (k = 0; k < 3; k++) p.origin[k] = 3.0;
    { /* other data altogether: what is not for them goes, so that it costs no more than a twelfth of the bytes */
        tetcast_rbf_report alone;
        for (i = 0; i < p.count; i++) other[i] = value[p.count - 1 - i];
        p.values.data = other;
        d.start = NULL;
        d.max_error = 0.03f;
        CHECK(tetcast_rbf_fit(&d, &p, &alone, &m) == TETCAST_OK);
        tetcast_rbf_destroy(m);
        d.start = first;
        CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK && report.started > 0);
        tetcast_rbf_destroy(m);
        CHECK_MSG(12 * report.bytes < 13 * alone.bytes, "%u bytes, %u without a start", (unsigned)report.bytes, (unsigned)alone.bytes);
        if (getenv("TEST_PRINT") != NULL)
            printf("other data: %u bytes from %u, %u without a start\n", (unsigned)report.bytes, report.started, (unsigned)alone.bytes);
        p.values.data = value;
        d.max_error = 0.05f;
    }
    for (k = 0; k < 4; k++) { /* functions of anybody: all widths, ellipsoids, heavy and in between the points */
        if (k == 1) bend(&r, 30.0);
        for (i = 0; i < r.function_count && k == 2; i++) g_f[i].weight[0] *= 1e20f;
        for (i = 0; i < r.function_count && k == 3; i++) g_f[i].width = 0.004;
        odd = make(&r);
        REQUIRE(odd != NULL);
        d.start = odd;
        CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_OK);
        REQUIRE(m != NULL);
        errors(m, &p, NULL, value, report.range, e);
        CHECK_MSG(e[0] <= 0.0501, "kind %d: %g", k, e[0]);
        if (k == 3) CHECK_MSG(report.started > 20 && report.started < 120, "%u functions near points", report.started);
        tetcast_rbf_destroy(m);
        tetcast_rbf_destroy(odd);
    }
    d.start = first;
    d.max_functions = 5;
    CHECK(tetcast_rbf_fit(&d, &p, &report, &m) == TETCAST_ERR_RANGE && m == NULL);
    d.max_functions = 0;
    d.kernel = TETCAST_KERNEL_POWER;
    CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_ERR_INVALID_ARG && m == NULL);
    d.kernel = TETCAST_KERNEL_GAUSS;
    d.cut = 3.0f;
    CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_ERR_INVALID_ARG);
    d.cut = 3.5f;
    d.isa = (tetcast_isa)99;
    CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_ERR_INVALID_ARG);
    d.isa = TETCAST_ISA_AUTO;
    CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_OK);
    tetcast_rbf_destroy(m);
    p.count /= 3;
    p.dims[2] /= 3;
    p.components = 3;
    CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_ERR_INVALID_ARG);
    tetcast_rbf_destroy(first);
}

/* Nothing, one point, coincident, on a line, in a plane, all equal, not finite; thin and stretched grids. */
TEST(odd_data) {
    static double at[3 * 64];
    static float value[3 * 64 * 4];
    static const uint32_t thin[][3] = {{1, 1, 1}, {64, 1, 1}, {1, 8, 8}, {8, 8, 1}, {4, 4, 4}, {2, 2, 2}};
    test_rng r = test_rng_make(2);
    tetcast_rbf *m = NULL;
    tetcast_rbf_report report;
    uint32_t kind, i, a;
    for (kind = 0; kind < 9; kind++) {
        tetcast_rbf_points p;
        tetcast_result result;
        double e[2];
        memset(&p, 0, sizeof p);
        p.positions.data = at;
        p.positions.type = TETCAST_TYPE_F64;
        p.values.data = value;
        p.components = kind == 6 ? 3 : 1;
        p.count = kind < 4 ? kind : 64;
        for (i = 0; i < 64; i++) {
            for (a = 0; a < 3; a++) at[3 * i + a] = kind == 4 ? 5.0 : kind == 5 && a > 0 ? 1.0 : kind == 6 && a == 2 ? 1e6 : test_rng_double(&r);
            for (a = 0; a < p.components; a++) value[i * p.components + a] = kind == 7 ? 3.5f : test_rng_range(&r, -1.0f, 1.0f);
        }
        if (kind == 4) for (i = 0; i < 64; i++) value[i] = 2.0f; /* one place */
        if (kind == 8) { /* twice, and not finite */
            for (i = 0; i < 32; i++) {
                memcpy(at + 3 * (i + 32), at + 3 * i, 3 * sizeof *at);
                value[i + 32] = value[i];
            }
            value[3] = (float)NAN;
            at[3 * 5] = (double)INFINITY;
        }
        result = tetcast_rbf_fit(NULL, &p, &report, &m);
        if (p.count == 0) {
            CHECK(result == TETCAST_ERR_EMPTY && m == NULL);
            continue;
        }
        CHECK_MSG(result == TETCAST_OK, "kind %u: %s", kind, tetcast_result_string(result));
        REQUIRE(m != NULL);
        if (kind == 8) CHECK(report.rejected == 2 && report.duplicates == 30);
        if (kind != 8 && report.range > 0.0) {
            errors(m, &p, at, value, report.range, e);
            CHECK_MSG(e[0] <= 0.0501, "kind %u: %g", kind, e[0]);
        }
        tetcast_rbf_destroy(m);
    }
    for (kind = 0; kind < 6; kind++) {
        tetcast_rbf_points p = grid_points(value, thin[kind][0], thin[kind][1], thin[kind][2], 1);
        double e[2];
        for (i = 0; i < 64; i++) value[i] = (float)sin(0.3 * i);
        p.spacing[0] = p.spacing[1] = 1.0;
        p.spacing[2] = 1000.0;
        if (kind == 5) p.spacing[0] = -1.0;
        CHECK(tetcast_rbf_fit(NULL, &p, &report, &m) == TETCAST_OK);
        REQUIRE(m != NULL);
        if (report.range > 0.0 && kind != 0) {
            errors(m, &p, NULL, value, report.range, e);
            CHECK_MSG(e[0] <= 0.0501, "grid %u: %g", kind, e[0]);
        }
        tetcast_rbf_destroy(m);
    }
    { /* too few functions are allowed; cancelled; bad arguments */
        tetcast_rbf_points p = grid_points(value, 4, 4, 4, 1);
        tetcast_rbf_fit_desc d;
        memset(&d, 0, sizeof d);
        d.max_error = 0.001f;
        d.max_functions = 2;
        CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_ERR_RANGE && m == NULL);
        d.max_error = -1.0f;
        CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_ERR_INVALID_ARG);
        memset(&d, 0, sizeof d);
        d._end_zero = 1;
        CHECK(tetcast_rbf_fit(&d, &p, NULL, &m) == TETCAST_ERR_UNINIT_DESC);
        p.components = 5;
        CHECK(tetcast_rbf_fit(NULL, &p, NULL, &m) == TETCAST_ERR_INVALID_ARG);
        p = grid_points(value, 4, 4, 5, 1);
        p.count = 64;
        CHECK(tetcast_rbf_fit(NULL, &p, NULL, &m) == TETCAST_ERR_INVALID_ARG);
    }
}

/* ---- flows ---- */

static void features(const double j[9], tetcast_flow *f) {
    const float v[3] = {1.0f, 2.0f, 3.0f};
    float g[9];
    int i;
    for (i = 0; i < 9; i++) g[i] = (float)j[i];
    tetcast_flow_features(v, g, f);
}

/* Clipped from any distance: what is left of a constant in a cube is known, and so is its length. */
TEST(clipped_from_far_away) {
    enum { W = 6, H = 5 };
    static float rgba[W * H * 4], length[W * H];
    tetcast_control_point point;
    tetcast_transfer_desc td;
    tetcast_transfer *transfer = NULL;
    tetcast_optics *o = NULL;
    tetcast_clip_plane plane;
    tetcast_clip_desc cd;
    tetcast_clip *clip = NULL;
    tetcast_rbf_desc rd;
    tetcast_rbf *m;
    double away;
    uint32_t i;
    memset(&td, 0, sizeof td); memset(&cd, 0, sizeof cd); memset(&plane, 0, sizeof plane); memset(&point, 0, sizeof point);
    point.extinction = 1.0f;
    td.points = &point;
    td.point_count = 1;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &transfer), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(transfer, NULL, &o), TETCAST_OK);
    plane.normal[0] = 1.0;
    plane.offset = 0.4;
    cd.planes = &plane;
    cd.plane_count = 1;
    CHECK_EQ_U64(tetcast_clip_create(&cd, &clip), TETCAST_OK);
    memset(&rd, 0, sizeof rd);
    for (i = 0; i < 3; i++) rd.box_max[i] = 1.0;
    rd.components = 1;
    m = make(&rd);
    REQUIRE(m != NULL && o != NULL && clip != NULL);
    for (away = 2.0; away < 1e9; away *= 8.0) {
        tetcast_rbf_render_desc d;
        tetcast_image image;
        memset(&d, 0, sizeof d); memset(&image, 0, sizeof image);
        for (i = 0; i < 3; i++) d.camera.eye[i] = d.camera.at[i] = 0.5;
        d.camera.eye[0] += away;
        d.camera.ortho_height = 0.5f;
        d.clip = clip;
        image.width = W;
        image.height = H;
        image.rgba = rgba;
        image.length = length;
        CHECK_EQ_U64(tetcast_rbf_render(&d, m, o, &image, NULL), TETCAST_OK);
        for (i = 0; i < W * H; i++) {
            CHECK_NEAR((double)length[i], 0.6, 1e-5);
            CHECK_NEAR((double)rgba[4 * i + 3], 1.0 - exp(-0.6), 1e-5);
        }
    }
    tetcast_clip_destroy(clip);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(transfer);
    tetcast_rbf_destroy(m);
}

/* A mean that is far less than the largest error: weights are as fine as that takes, in files as well. */
TEST(means_far_below_the_largest_error) {
    enum { N = 300 };
    static double p[3 * N], v[N];
    static float got[2][N];
    test_rng r = test_rng_make(91);
    double mean;
    size_t i, a;
    for (i = 0; i < N; i++) {
        for (a = 0; a < 3; a++) p[3 * i + a] = (double)test_rng_float(&r);
        v[i] = sin(6.0 * p[3 * i]) * cos(5.0 * p[3 * i + 1]) + p[3 * i + 2] + 0.02 * (double)test_rng_float(&r);
    }
    for (mean = 1e-3; mean > 5e-7; mean *= 0.1) {
        tetcast_rbf_points in;
        tetcast_rbf_fit_desc d;
        tetcast_rbf_report report;
        tetcast_rbf *m = NULL, *again = NULL;
        uint8_t *file;
        size_t size = 0;
        double sum = 0.0;
        memset(&in, 0, sizeof in);
        memset(&d, 0, sizeof d);
        in.positions.data = p;
        in.values.data = v;
        in.positions.type = in.values.type = TETCAST_TYPE_F64;
        in.count = N;
        in.components = 1;
        d.max_error = 0.05f;
        d.mean_error = (float)mean;
        REQUIRE(tetcast_rbf_fit(&d, &in, &report, &m) == TETCAST_OK);
        CHECK(report.mean_error <= (double)d.mean_error && report.max_error <= 0.05);
        CHECK(tetcast_rbf_save_memory(m, NULL, 0, &size) == TETCAST_OK);
        file = (uint8_t *)malloc(size);
        CHECK(tetcast_rbf_save_memory(m, file, size, &size) == TETCAST_OK);
        REQUIRE(tetcast_rbf_load_memory(NULL, file, size, &again) == TETCAST_OK);
        free(file);
        CHECK(tetcast_rbf_eval(NULL, m, p, N, got[0], NULL) == TETCAST_OK && tetcast_rbf_eval(NULL, again, p, N, got[1], NULL) == TETCAST_OK);
        CHECK(memcmp(got[0], got[1], sizeof got[0]) == 0);
        for (i = 0; i < N; i++) sum += fabs((double)got[1][i] - v[i]);
        CHECK_MSG(sum / N <= mean * report.range + 1e-7, "%g: %g", mean, sum / N / report.range);
        tetcast_rbf_destroy(again);
        tetcast_rbf_destroy(m);
    }
}

/* Numbers of any size: the same functions, the same files but for the range. Reading gives the same bits, and a fit goes
   on from another one. */
TEST(data_of_any_size) {
    enum { N = 8 };
    static const double scale[9] = {1.0, 3e-30, 1e-27, 1.6e-19, 1e-15, 1e15, 1e20, 2.7e25, 1e29};
    static float v[N * N * N][2];
    int method, k;
    uint32_t n;
    for (n = 1; n < 3; n++)
        for (method = 0; method < 2; method++) {
            uint32_t functions = 0;
            for (k = 0; k < 9; k += test_quick() ? 3 : 1) {
                const float unit = ldexpf(1.0f, (int)floor(log2(scale[k]))); /* powers of two: the same digits */
                tetcast_rbf_points in;
                tetcast_rbf_fit_desc d;
                tetcast_rbf_report report;
                tetcast_rbf *m = NULL, *again = NULL, *next = NULL;
                double positions[3 * 64], most = 0.0;
                float got[64 * 2], read[64 * 2];
                size_t size = 0, i;
                uint8_t *p;
                memset(&in, 0, sizeof in);
                memset(&d, 0, sizeof d);
                for (i = 0; i < N * N * N; i++) {
                    const double x = (double)(i % N), y = (double)(i / N % N), z = (double)(i / N / N);
                    v[i][0] = (float)(sin(0.7 * x) * cos(0.9 * y + 0.3 * z) + (x > 4 && y > 3 ? 0.7 : 0.0)) * unit;
                    v[i][1] = (float)(0.04 * z * x) * unit;
                }
                in.values.data = v;
                in.values.stride = 8;
                in.count = N * N * N;
                in.components = n;
                in.dims[0] = in.dims[1] = in.dims[2] = N;
                d.max_error = 0.03f;
                d.method = method ? TETCAST_RBF_METHOD_PURE : TETCAST_RBF_METHOD_HYBRID;
                d.env.thread_count = 2;
                if (method == 0) d.base_dims[0] = d.base_dims[1] = d.base_dims[2] = 4;
                REQUIRE(tetcast_rbf_fit(&d, &in, &report, &m) == TETCAST_OK);
                CHECK(report.max_error <= 0.03 && report.between_count != 0 && report.between_mean < 0.2);
                CHECK_NEAR(report.range / (double)unit, n == 1 ? 2.3 : 2.6, 0.5);
                if (k == 0) functions = report.functions;
                CHECK_EQ_U64(report.functions, functions);
                for (i = 0; i < 64; i++) {
                    const size_t at = i * 17 % (N * N * N);
                    positions[3 * i] = (double)(at % N);
                    positions[3 * i + 1] = (double)(at / N % N);
                    positions[3 * i + 2] = (double)(at / N / N);
                }
                CHECK(tetcast_rbf_eval(NULL, m, positions, 64, got, NULL) == TETCAST_OK);
                for (i = 0; i < 64; i++) {
                    double e = 0.0;
                    uint32_t c;
                    for (c = 0; c < n; c++) e += pow(((double)got[i * n + c] - (double)v[i * 17 % (N * N * N)][c]) / report.range, 2.0);
                    most = fmax(most, sqrt(e));
                }
                CHECK_MSG(most <= 0.03, "%g: %g", scale[k], most);
                CHECK(tetcast_rbf_save_memory(m, NULL, 0, &size) == TETCAST_OK);
                p = (uint8_t *)malloc(size);
                CHECK(tetcast_rbf_save_memory(m, p, size, &size) == TETCAST_OK);
                CHECK(tetcast_rbf_load_memory(NULL, p, size, &again) == TETCAST_OK);
                free(p);
                REQUIRE(again != NULL && tetcast_rbf_eval(NULL, again, positions, 64, read, NULL) == TETCAST_OK);
                CHECK(memcmp(got, read, 64 * n * sizeof(float)) == 0);
                d.start = again;
                CHECK(tetcast_rbf_fit(&d, &in, &report, &next) == TETCAST_OK);
                CHECK(report.max_error <= 0.03 && report.started > functions / 2);
                tetcast_rbf_destroy(next);
                tetcast_rbf_destroy(again);
                tetcast_rbf_destroy(m);
            }
        }
}

TEST(flows) {
    const double rotation[9] = {0, -3, 0, 3, 0, 0, 0, 0, 0}, shear[9] = {0, 2, 0, 0, 0, 0, 0, 0, 0};
    const double swell[9] = {2, 0, 0, 0, 2, 0, 0, 0, 2}, none[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    test_rng r = test_rng_make(12);
    tetcast_flow f, g;
    double j[9];
    int t, i;
    features(rotation, &f); /* W^2 = diag(-9, -9, 0), S = 0 */
    CHECK_NEAR(f.lambda2, -9.0, 1e-5);
    CHECK_NEAR(f.vorticity[2], 6.0, 1e-6);
    CHECK_NEAR(f.helicity, 18.0, 1e-5);
    CHECK_NEAR(f.speed, sqrt(14.0), 1e-6);
    features(shear, &f);
    CHECK_NEAR(f.lambda2, 0.0, 1e-6);
    CHECK_NEAR(f.vorticity[2], -2.0, 1e-6);
    features(swell, &f);
    CHECK_NEAR(f.lambda2, 4.0, 1e-5);
    features(none, &f);
    CHECK(f.lambda2 == 0.0f);
    for (t = 1; t < 40; t++) { /* a vortex of Lamb and Oseen with a core of 1: lambda2 is strain^2 - spin^2, twice */
        const double r2 = 0.05 * t * t * 0.05 * 4.0, e = exp(-r2), turn = 0.3 * t, x = sqrt(r2) * cos(turn), y = sqrt(r2) * sin(turn);
        const double way = (1.0 - e) / r2, slope = 2.0 * (e - way) / r2; /* speed / r, and its derivative by r, over r */
        const double spin = e, strain = 0.5 * slope * r2;
        memset(j, 0, sizeof j); /* velocity: way * (-y, x, 0) */
        j[0] = -y * slope * x;
        j[1] = -way - y * slope * y;
        j[3] = way + x * slope * x;
        j[4] = x * slope * y;
        features(j, &f);
        CHECK_NEAR(f.vorticity[2], 2.0 * spin, 1e-5);
        CHECK_MSG(fabs((double)f.lambda2 - (strain * strain - spin * spin)) < 1e-4 * (strain * strain + spin * spin), "r2 %g: %g instead of %g", r2,
                  (double)f.lambda2, strain * strain - spin * spin);
    }
    for (t = 0; t < 2000; t++) { /* the largest numbers */
        float v[3], h[9];
        for (i = 0; i < 9; i++) h[i] = (test_rng_below(&r, 2) ? 3.4e38f : -3.4e38f) * (test_rng_below(&r, 2) ? 1.0f : test_rng_float(&r));
        for (i = 0; i < 3; i++) v[i] = (test_rng_below(&r, 2) ? 3.4e38f : -3.4e38f) * (float)test_rng_below(&r, 2);
        tetcast_flow_features(v, h, &f);
        CHECK(f.speed - f.speed == 0.0f && f.lambda2 - f.lambda2 == 0.0f && f.helicity - f.helicity == 0.0f);
        for (i = 0; i < 3; i++) CHECK(f.vorticity[i] - f.vorticity[i] == 0.0f);
    }
    for (t = 0; t < 9 * 9 * 120; t++) { /* one large number and one of any smaller size: what is left of squares underflows */
        memset(j, 0, sizeof j);
        j[t % 9] = 7.34686772e-41 * exp2(t / 81);
        j[t / 9 % 9] = -2.42584116e+36;
        features(j, &f);
        CHECK(f.lambda2 - f.lambda2 == 0.0f);
    }
    for (t = 0; t < 2000; t++) { /* the characteristic polynomial vanishes there and one root lies on each side; scales */
        double m[9], q, a, b, c, x, value, slope;
        int k, l;
        for (i = 0; i < 9; i++) j[i] = (double)test_rng_range(&r, -1.0f, 1.0f) * (t % 4 == 0 && i % 3 == 1 ? 1e-4 : 1.0);
        features(j, &f);
        for (k = 0; k < 3; k++)
            for (l = 0; l < 3; l++) {
                m[3 * k + l] = 0.0;
                for (i = 0; i < 3; i++) {
                    const double s1 = 0.5 * (j[3 * k + i] + j[3 * i + k]), s2 = 0.5 * (j[3 * i + l] + j[3 * l + i]);
                    const double w1 = 0.5 * (j[3 * k + i] - j[3 * i + k]), w2 = 0.5 * (j[3 * i + l] - j[3 * l + i]);
                    m[3 * k + l] += s1 * s2 + w1 * w2;
                }
            }
        a = m[0] + m[4] + m[8];
        b = m[0] * m[4] + m[0] * m[8] + m[4] * m[8] - m[1] * m[1] - m[2] * m[2] - m[5] * m[5];
        c = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6]);
        x = (double)f.lambda2;
        value = ((x - a) * x + b) * x - c;
        slope = (3.0 * x - 2.0 * a) * x + b;
        q = fabs(m[0]) + fabs(m[4]) + fabs(m[8]) + 1e-9;
        CHECK(fabs(value) < 1e-4 * q * q * q + 1e-12);
        CHECK(slope < 1e-3 * q * q); /* between the other two the polynomial falls */
        for (i = 0; i < 9; i++) j[i] *= t % 2 ? 1e15 : 1e-15;
        features(j, &g);
        CHECK(g.lambda2 - g.lambda2 == 0.0f);
        if (fabs(x) > 1e-3) CHECK_NEAR((double)g.lambda2 / x * (t % 2 ? 1e-30 : 1e30), 1.0, 1e-3);
    }
}

/* Rigid rotation, exactly a base of 2 x 2 x 2: the error of RK4 goes with dt^4, Euler leaves as Euler does. */
TEST(traces) {
    static const double seed[6] = {0.5, 0.0, 0.2, 3.0, 0.0, 0.0};
    float node[24];
    tetcast_rbf_desc d = random_desc(1, 0, 3, 1, 1, 0.0);
    tetcast_rbf_trace_desc t;
    tetcast_rbf *m;
    tetcast_trace_end end[2];
    uint32_t length[2], i, k;
    double path[2 * 3 * 401], error[2];
    for (i = 0; i < 8; i++) {
        node[3 * i] = (i & 2u) ? -1.0f : 1.0f;
        node[3 * i + 1] = (i & 1u) ? 1.0f : -1.0f;
        node[3 * i + 2] = 0.0f;
    }
    for (i = 0; i < 3; i++) {
        d.box_min[i] = -1.0;
        d.box_max[i] = 1.0;
        d.base_dims[i] = 2;
    }
    d.base = node;
    m = make(&d);
    REQUIRE(m != NULL);
    for (k = 0; k < 2; k++) {
        memset(&t, 0, sizeof t);
        t.steps = k ? 40 : 20;
        t.dt = 6.283185307179586 / (double)t.steps;
        CHECK(tetcast_rbf_trace(&t, m, seed, 2, path, length, end) == TETCAST_OK);
        CHECK(length[0] == t.steps + 1 && end[0] == TETCAST_TRACE_STEPS && length[1] == 1 && end[1] == TETCAST_TRACE_BAD);
        error[k] = hypot(path[3 * t.steps] - 0.5, path[3 * t.steps + 1]);
    }
    CHECK_NEAR(log2(error[0] / error[1]), 4.0, 0.2);
    for (k = 0; k < 2; k++) { /* two long steps around; the error goes with the tolerance, in company or alone, backwards too */
        double alone[3 * 401];
        t.stepper = TETCAST_STEPPER_DOPRI5;
        t.steps = 2;
        t.dt = (k ? -1.0 : 1.0) * 3.141592653589793;
        t.tolerance = k ? 1e-9 : 1e-4;
        CHECK(tetcast_rbf_trace(&t, m, seed, 2, path, length, end) == TETCAST_OK);
        CHECK(length[0] == 3 && end[0] == TETCAST_TRACE_STEPS && end[1] == TETCAST_TRACE_BAD);
        error[k] = hypot(path[6] - 0.5, path[7]);
        CHECK_MSG(error[k] < (k ? 3e-6 : 2e-3), "%g", error[k]); /* velocities are floats */
        CHECK_NEAR(path[3], -0.5, k ? 3e-6 : 2e-3);
        CHECK(tetcast_rbf_trace(&t, m, seed, 1, alone, length, end) == TETCAST_OK && memcmp(alone, path, 9 * sizeof *path) == 0);
    }
    CHECK(error[1] < 0.1 * error[0]);
    t.tolerance = 1e-300; /* floats cannot */
    CHECK(tetcast_rbf_trace(&t, m, seed, 1, path, length, end) == TETCAST_OK && end[0] == TETCAST_TRACE_STUCK && length[0] == 1);
    t.tolerance = -1.0;
    CHECK(tetcast_rbf_trace(&t, m, seed, 1, path, length, end) == TETCAST_ERR_INVALID_ARG);
    t.tolerance = 0.0;
    t.stepper = TETCAST_STEPPER_EULER;
    t.steps = 400;
    t.dt = 0.1;
    CHECK(tetcast_rbf_trace(&t, m, seed, 1, path, length, end) == TETCAST_OK && end[0] == TETCAST_TRACE_LEFT);
    for (i = 1; i < length[0]; i++) { /* each step is longer by sqrt(1 + dt^2) */
        CHECK_NEAR(hypot(path[3 * i], path[3 * i + 1]) / hypot(path[3 * i - 3], path[3 * i - 2]), sqrt(1.0 + 0.01), 1e-6);
    }
    t.min_speed = 10.0f;
    CHECK(tetcast_rbf_trace(&t, m, seed, 1, path, length, end) == TETCAST_OK && end[0] == TETCAST_TRACE_SLOW && length[0] == 1);
    t.isa = (tetcast_isa)99;
    CHECK(tetcast_rbf_trace(&t, m, seed, 1, path, length, end) == TETCAST_ERR_INVALID_ARG);
    t.isa = TETCAST_ISA_AUTO;
    t.dt = 0.0;
    CHECK(tetcast_rbf_trace(&t, m, seed, 1, path, length, end) == TETCAST_ERR_INVALID_ARG);
    tetcast_rbf_destroy(m);
}

/* A field that bends, of functions: Euler's steps go where they go in double, the others where far smaller ones do. */
TEST(traces_in_functions) {
    enum { SEEDS = 4, MOST_STEPS = 64 };
    static const tetcast_stepper steppers[3] = {TETCAST_STEPPER_EULER, TETCAST_STEPPER_RK4, TETCAST_STEPPER_DOPRI5};
    tetcast_rbf_desc d = random_desc(41, 30, 3, 0.4, 0.8, 2.0);
    static double path[SEEDS * 3 * (MOST_STEPS + 1)];
    double seed[3 * SEEDS];
    tetcast_trace_end end[SEEDS];
    uint32_t length[SEEDS], i, k, s, a;
    tetcast_rbf *m = make(&d);
    REQUIRE(m != NULL);
    for (i = 0; i < 3 * SEEDS; i++) seed[i] = 2.8 + 0.1 * (double)(i * 7 % 5);
    for (k = 0; k < 3; k++)
        for (s = 0; s < 2; s++) {
            const uint32_t steps = k == 2 ? 8 : s ? 64 : 16, fine = k == 0 ? 1 : 16;
            tetcast_rbf_trace_desc t;
            double worst = 0.0, moved = 0.0;
            memset(&t, 0, sizeof t);
            t.stepper = steppers[k];
            t.steps = steps;
            t.dt = 0.25 / (double)steps;
            CHECK(tetcast_rbf_trace(&t, m, seed, SEEDS, path, length, end) == TETCAST_OK);
            for (i = 0; i < SEEDS; i++) { /* Euler against Euler, the others against small steps of the fourth order */
                double p[3], all;
                uint32_t n;
                memcpy(p, seed + 3 * i, sizeof p);
                CHECK(length[i] == steps + 1 && end[i] == TETCAST_TRACE_STEPS);
                for (n = 0; n < steps * fine; n++) {
                    const double h = t.dt / fine;
                    double slope[4][3], q[3];
                    uint32_t stage;
                    for (stage = 0; stage < (k == 0 ? 1u : 4u); stage++) {
                        const double at = stage == 0 ? 0.0 : stage == 3 ? h : 0.5 * h;
                        for (a = 0; a < 3; a++) q[a] = p[a] + (stage ? at * slope[stage - 1][a] : 0.0);
                        for (a = 0; a < 3; a++) slope[stage][a] = value_oracle(&d, q, a, &all);
                    }
                    for (a = 0; a < 3; a++)
                        p[a] += k == 0 ? h * slope[0][a]
                                       : h / 6.0 * (slope[0][a] + 2.0 * slope[1][a] + 2.0 * slope[2][a] + slope[3][a]);
                }
                for (a = 0; a < 3; a++) {
                    const double e = fabs(path[3 * ((size_t)i * (steps + 1) + steps) + a] - p[a]);
                    worst = fmax(worst, e);
                    moved = fmax(moved, fabs(p[a] - seed[3 * i + a]));
                }
            }
            CHECK_MSG(worst < 1e-5 && moved > 0.3, "stepper %u, %u steps: off by %g of %g", k, steps, worst, moved);
        }
    tetcast_rbf_destroy(m);
}

/* ---- pictures ---- */

static tetcast_optics *rbf_make_optics(tetcast_model model, float iso) {
    static const tetcast_control_point points[] = {{0.05f, {0, 0, 1}, 0}, {0.4f, {0.2f, 1, 0.3f}, 1.5f}, {1.0f, {1, 0.2f, 0}, 4.0f}};
    tetcast_transfer_desc d;
    tetcast_optics_desc o;
    tetcast_isovalue value;
    tetcast_transfer *t = NULL;
    tetcast_optics *optics = NULL;
    memset(&d, 0, sizeof d);
    memset(&o, 0, sizeof o);
    memset(&value, 0, sizeof value);
    value.value = iso;
    value.rgb[0] = value.rgb[1] = value.rgb[2] = value.opacity = 1.0f;
    d.points = points;
    d.point_count = 3;
    d.isovalues = &value;
    d.isovalue_count = 1;
    o.model = model;
    o.t_min = -1.0f;
    CHECK(tetcast_transfer_create(&d, &t) == TETCAST_OK);
    CHECK(tetcast_optics_create(t, &o, &optics) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    return optics;
}

static void eye_within(tetcast_camera *camera) { /* inside of the box */
    camera->eye[0] = camera->eye[1] = camera->eye[2] = 4.9;
    camera->at[0] = 6.0;
    camera->at[1] = 5.2;
    camera->at[2] = 5.5;
    camera->fov_y = 70.0f;
}

/* The colour of a ray in fine steps through the box, or 0 where it misses it. */
static int ray_in_steps(const tetcast_rbf *m, const tetcast_rbf_desc *d, const tetcast_optics *o, const tetcast_ray *ray, float want[4]) {
    static tetcast_segment segment[2000];
    static double p[3 * 2001];
    static float v[2001];
    const uint32_t n = test_quick() ? 400 : 2000;
    double ends[2] = {0.0, 1e30};
    uint32_t a, s;
    for (a = 0; a < 3; a++) {
        const double x = (d->box_min[a] - ray->org[a]) / ray->dir[a], y = (d->box_max[a] - ray->org[a]) / ray->dir[a];
        ends[0] = fmax(ends[0], fmin(x, y));
        ends[1] = fmin(ends[1], fmax(x, y));
    }
    if (!(ends[1] > ends[0])) return 0;
    for (s = 0; s <= n; s++)
        for (a = 0; a < 3; a++) p[3 * s + a] = ray->org[a] + ray->dir[a] * (ends[0] + (ends[1] - ends[0]) * s / n);
    CHECK(tetcast_rbf_eval(NULL, m, p, n + 1, v, NULL) == TETCAST_OK);
    for (s = 0; s < n; s++) {
        segment[s].front = v[s];
        segment[s].back = v[s + 1];
        segment[s].length = (float)((ends[1] - ends[0]) / n);
        segment[s].depth = 0.0f;
    }
    CHECK(tetcast_optics_ray(o, segment, n, want, NULL) == TETCAST_OK);
    return 1;
}

/* Tiles against samples one by one against an oracle that steps along the ray in double; same bits for threads and
   instruction sets. */
TEST(pictures) {
    enum { W = 45, H = 37 };
    static float rgba[4][W * H][4], depth[W * H];
    static float node[3 * 3 * 3 * 3];
    uint32_t kernel, k, i, c;
    tetcast_optics *o = rbf_make_optics(TETCAST_MODEL_VOLUME, 0.5f);
    test_rng r = test_rng_make(9);
    REQUIRE(o != NULL);
    for (i = 0; i < 81; i++) node[i] = test_rng_range(&r, 0.0f, 0.3f);
    for (kernel = 0; kernel < TETCAST_KERNEL_COUNT; kernel++) {
        tetcast_rbf_desc d = random_desc(11, 120, kernel == 1 ? 3 : 1, 0.01, 0.3, 4.0);
        tetcast_rbf *m;
        double worst = 0.0, worst_oracle = 0.0;
        d.kernel = (tetcast_kernel)kernel;
        d.epsilon = 1e-5f;
        if (kernel != 2) {
            d.base_dims[0] = d.base_dims[1] = d.base_dims[2] = 3;
            d.base = node;
        }
        if (kernel == 3) {
            d.metric[0] = 1.0;
            d.metric[1] = 1.5;
            d.metric[2] = 0.7;
        }
        if (kernel != 2) bend(&d, 2.0);
        m = make(&d);
        REQUIRE(m != NULL);
        for (k = 0; k < 4; k++) {
            tetcast_rbf_render_desc q;
            tetcast_image image;
            memset(&q, 0, sizeof q);
            memset(&image, 0, sizeof image);
            image.width = W;
            image.height = H;
            image.rgba = rgba[k][0];
            image.depth = depth;
            q.isa = k == 0 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO;
            q.env.thread_count = k == 1 ? 1 : 3;
            q.gather = k == 3;
            q.step = kernel == 4 ? 0.005f : 0.02f;
            if (kernel == 0) eye_within(&q.camera);
            if (kernel == 1) q.camera.ortho_height = 3.0f;
            CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_OK);
        }
        CHECK(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0 && memcmp(rgba[0], rgba[2], sizeof rgba[0]) == 0);
        for (i = 0; i < W * H; i++)
            for (c = 0; c < 4; c++) {
                const double e = fabs((double)rgba[0][i][c] - (double)rgba[3][i][c]);
                if (!(e <= worst)) worst = e;
            }
        CHECK_MSG(worst < 1.0 / 1024.0, "kernel %u: tiles and samples differ by %.3g", kernel, worst);
        for (i = 0; i < W * H && kernel != 1; i += 13) { /* the same field in fine steps through the box */
            tetcast_camera camera;
            tetcast_ray ray;
            float want[4];
            memset(&camera, 0, sizeof camera);
            if (kernel == 0) eye_within(&camera);
            else CHECK(tetcast_camera_fit(&camera, d.box_min, d.box_max, NULL, W, H) == TETCAST_OK);
            CHECK(tetcast_camera_ray(&camera, W, H, i % W + 0.5, i / W + 0.5, &ray) == TETCAST_OK);
            if (!ray_in_steps(m, &d, o, &ray, want)) {
                CHECK(rgba[0][i][3] == 0.0f);
                continue;
            }
            for (c = 0; c < 4; c++) {
                const double e = fabs((double)rgba[0][i][c] - (double)want[c]);
                if (!(e <= worst_oracle)) worst_oracle = e;
            }
        }
        CHECK_MSG(worst_oracle < 0.02, "kernel %u: off by %.3g", kernel, worst_oracle); /* steps of 0.02 with widths from 0.01 */
        tetcast_rbf_destroy(m);
    }
    tetcast_optics_destroy(o);
}

/* The same model far from the origin is the same picture. */
TEST(pictures_far_away) {
    enum { W = 33, H = 25 };
    static float rgba[3][W * H * 4];
    tetcast_optics *o = rbf_make_optics(TETCAST_MODEL_MIXED, 0.5f);
    uint32_t k, i, a;
    for (k = 0; k < 3; k++) {
        const double shift = k == 0 ? 0.0 : k == 1 ? 1048576.0 : 1073741824.0;
        tetcast_rbf_desc d = random_desc(14, 80, 1, 0.1, 0.3, shift);
        tetcast_rbf_render_desc q;
        tetcast_image image;
        tetcast_rbf *m = make(&d);
        double worst = 0;
        REQUIRE(m != NULL && o != NULL);
        memset(&q, 0, sizeof q);
        memset(&image, 0, sizeof image);
        image.width = W;
        image.height = H;
        image.rgba = rgba[k];
        q.step = 0.0625f;
        q.camera.ortho_height = 2.5f;
        for (a = 0; a < 3; a++) {
            q.camera.at[a] = shift + 1.0;
            q.camera.eye[a] = shift + (a == 2 ? 5.0 : 1.5 + 0.25 * a);
        }
        CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_OK);
        for (i = 0; i < W * H * 4; i++) worst = fmax(worst, fabs((double)rgba[k][i] - (double)rgba[0][i]));
        CHECK_MSG(worst < 1e-4 && rgba[k][4 * (H / 2 * W + W / 2) + 3] > 0.1f, "at %g: %g", shift, worst);
        tetcast_rbf_destroy(m);
    }
    tetcast_optics_destroy(o);
}

/* Opacity in the middle of a picture of `m` by parallel rays along z from `eye`. */
static float opacity_along_z(const tetcast_rbf *m, const tetcast_optics *o, const tetcast_clip *clip, double eye, float step,
                             tetcast_isa isa) {
    static float rgba[8 * 8 * 4];
    tetcast_rbf_render_desc d;
    tetcast_image image;
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    d.isa = isa;
    d.clip = clip;
    d.step = step;
    d.camera.eye[0] = d.camera.at[0] = 0.52;
    d.camera.eye[1] = d.camera.at[1] = 0.51;
    d.camera.eye[2] = eye;
    d.camera.up[1] = 1.0;
    d.camera.ortho_height = 0.25f;
    image.width = image.height = 8;
    image.rgba = rgba;
    CHECK(tetcast_rbf_render(&d, m, o, &image, NULL) == TETCAST_OK);
    return rgba[4 * (8 * 4 + 4) + 3];
}

/* A clip of slabs along z, [from, to] each. */
static tetcast_clip *slabs(const double (*z)[2], uint32_t count) {
    static const uint32_t cube[12][3] = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                                         {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
    double p[4 * 8][3];
    uint32_t t[4 * 12][3], i, k, c;
    tetcast_clip_body body;
    tetcast_clip_desc d;
    tetcast_clip *clip = NULL;
    memset(&body, 0, sizeof body);
    memset(&d, 0, sizeof d);
    for (i = 0; i < count; i++) {
        for (k = 0; k < 8; k++) {
            p[8 * i + k][0] = k & 1u ? 9.0 : -9.0;
            p[8 * i + k][1] = k & 2u ? 9.0 : -9.0;
            p[8 * i + k][2] = z[i][k >> 2];
        }
        for (k = 0; k < 12; k++)
            for (c = 0; c < 3; c++) t[12 * i + k][c] = 8 * i + cube[k][c];
    }
    body.points = (const double (*)[3])p;
    body.point_count = 8 * count;
    body.indices = t[0];
    body.triangle_count = 12 * count;
    d.bodies = &body;
    d.body_count = 1;
    CHECK(tetcast_clip_create(&d, &clip) == TETCAST_OK);
    return clip;
}

/* A slab too thin for floats takes nothing away from what is behind it; integrators with steps of their own do not go on
   through what is clipped away; far away and with any step there is what there is. */
TEST(clipped_functions) {
    static const double two[2][2] = {{0.1, 0.8}, {0.9 - 1e-12, 0.9}}, apart[2][2] = {{0.05, 0.371}, {0.613, 0.97}};
    static const float rise[2] = {0.0f, 1.0f};
    tetcast_control_point p[8];
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_rbf_desc d;
    tetcast_rbf *constant = NULL, *linear = NULL;
    tetcast_transfer *t = NULL;
    tetcast_optics *flat = NULL, *band = NULL;
    tetcast_clip *clip;
    int k;
    uint32_t a;
    memset(&d, 0, sizeof d);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    memset(p, 0, sizeof p);
    for (a = 0; a < 3; a++) d.box_max[a] = 1.0;
    d.offset[0] = 0.5f;
    constant = make(&d);
    d.base_dims[0] = d.base_dims[1] = 1;
    d.base_dims[2] = 2;
    d.base = rise;
    linear = make(&d);
    p[0].extinction = p[1].extinction = 1.0f;
    p[1].value = 1.0f;
    td.points = p;
    td.point_count = 2;
    REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, NULL, &flat) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    for (k = 0; k < 4; k++) {
        const tetcast_isa isa = k % 2 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO;
        clip = slabs(two, k / 2 ? 2 : 1);
        CHECK_NEAR(opacity_along_z(constant, flat, clip, 3.03, 0.5f, isa), 1.0 - exp(-0.7), 1e-5);
        tetcast_clip_destroy(clip);
    }
    for (k = 0; k < 8; k++) { /* 13 powers of ten off, and more steps up to there than integers have numbers */
        const float o = opacity_along_z(constant, flat, NULL, pow(10.0, 1 + 2 * k), k % 2 ? 0.0f : 1.0f / 36000.0f, TETCAST_ISA_AUTO);
        CHECK_MSG(fabs((double)o - (1.0 - exp(-1.0))) < (k == 7 ? 0.1 : 1e-3), "1e%d: %g", 1 + 2 * k, (double)o);
    }
    CHECK_NEAR(opacity_along_z(constant, flat, NULL, 1e15, 1.0f / 36000.0f, TETCAST_ISA_AUTO), 1.0 - exp(-1.0), 0.1);
    p[0].value = 0.1f; /* a little at both ends, much in the middle, which is clipped away */
    p[0].extinction = p[7].extinction = 0.001f;
    p[1].value = 0.11f;
    p[1].extinction = 0.0f;
    p[2].value = 0.4f;
    p[3].value = 0.41f;
    p[4].value = 0.5f;
    p[3].extinction = p[4].extinction = 9.0f;
    p[5].value = 0.51f;
    p[6].value = 0.9f;
    p[7].value = 0.91f;
    td.point_count = 8;
    od.integrator = TETCAST_INTEGRATOR_TABLE_2D;
    od.longest = 1.0f;
    od.step = 0.1f;
    REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, &od, &band) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    clip = slabs(apart, 2);
    CHECK(opacity_along_z(linear, band, NULL, 3.03, 0.03f, TETCAST_ISA_AUTO) > 0.5f);
    for (k = 0; k < 2; k++)
        CHECK(opacity_along_z(linear, band, clip, 3.03, 0.03f, k ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO) < 0.001f);
    tetcast_clip_destroy(clip);
    tetcast_optics_destroy(band);
    tetcast_optics_destroy(flat);
    tetcast_rbf_destroy(linear);
    tetcast_rbf_destroy(constant);
    { /* a step as long as floats have it in a small box */
        tetcast_rbf *m;
        memset(&d, 0, sizeof d);
        for (a = 0; a < 3; a++) d.box_max[a] = 1.0;
        for (a = 0; a < 3; a++) d.metric[a] = 1e-15;
        d.offset[0] = 0.5f;
        m = make(&d);
        td.point_count = 2;
        p[0].value = 0.0f;
        p[1].value = 1.0f;
        p[0].extinction = p[1].extinction = 1.0f;
        REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, NULL, &flat) == TETCAST_OK);
        for (k = 0; k < 2; k++)
            CHECK_NEAR(opacity_along_z(m, flat, NULL, 3.03, k ? 9e29f : 1.0f, TETCAST_ISA_AUTO), 1.0 - exp(-1.0), 1e-5);
        tetcast_transfer_destroy(t);
        tetcast_optics_destroy(flat);
        tetcast_rbf_destroy(m);
    }
}

/* One Gaussian: its isosurface is a sphere; depth and normal by the formula. */
TEST(sphere) {
    enum { W = 64 };
    static float rgba[W * W][4], depth[W * W];
    tetcast_rbf_desc d;
    tetcast_rbf_function f;
    tetcast_rbf_render_desc q;
    tetcast_image image;
    tetcast_rbf *m;
    tetcast_optics *o = rbf_make_optics(TETCAST_MODEL_ISOSURFACE, 0.5f);
    const double e = exp(-0.5 * 3.5 * 3.5), radius = 0.2 * sqrt(-2.0 * log(0.5 * (1.0 - e) + e));
    double worst = 0.0, bright = 0.0;
    int i, hits = 0, k;
    memset(&f, 0, sizeof f);
    memset(&d, 0, sizeof d);
    memset(&q, 0, sizeof q);
    memset(&image, 0, sizeof image);
    f.width = 0.2;
    f.weight[0] = 1.0f;
    d.functions = &f;
    d.function_count = 1;
    for (k = 0; k < 3; k++) {
        d.box_min[k] = -1.0;
        d.box_max[k] = 1.0;
    }
    m = make(&d);
    REQUIRE(m != NULL && o != NULL);
    q.camera.eye[2] = 3.0;
    q.camera.fov_y = 20.0f;
    q.step = 0.05f;
    image.width = image.height = W;
    image.rgba = rgba[0];
    image.depth = depth;
    CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_OK);
    for (i = 0; i < W * W; i++) {
        tetcast_ray r;
        double b, c, t, n;
        CHECK(tetcast_camera_ray(&q.camera, W, W, i % W + 0.5, i / W + 0.5, &r) == TETCAST_OK);
        b = 3.0 * r.dir[2];
        c = b * b - 9.0 + radius * radius;
        if (c < 0.0) {
            if (c < -0.01) CHECK(depth[i] == INFINITY);
            continue;
        }
        if (c < 0.01) continue; /* grazing: two crossings between two samples */
        t = -b - sqrt(c);
        n = -((r.dir[0] * t) * r.dir[0] + (r.dir[1] * t) * r.dir[1] + (3.0 + r.dir[2] * t) * r.dir[2]) / radius;
        hits++;
        worst = fmax(worst, fabs((double)depth[i] - t * -r.dir[2]));
        bright = fmax(bright, fabs((double)rgba[i][0] - n)); /* a light from the eye, no ambient */
    }
    CHECK(hits > 500);
    CHECK_MSG(worst < 0.2 * 1e-4, "depth off by %.3g", worst);
    CHECK_MSG(bright < 2e-4, "cosine off by %.3g", bright);
    tetcast_rbf_destroy(m);
    tetcast_optics_destroy(o);
}

/* ---- shaders and clipping ---- */

typedef struct field_probe {
    const tetcast_rbf *m;
    float density;
    int bad;                     /* gradients and places that are not those of the field */
} field_probe;

static void field_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    field_probe *q = (field_probe *)user;
    int i, a;
    for (i = 0; i < 8; i++) {
        const float middle = 0.5f * (in->front[i] + in->back[i]);
        double p[3];
        float v[1], j[3];
        if (!(in->mask >> i & 1u)) continue;
        for (a = 0; a < 3; a++) p[a] = (double)in->position[a][i];
        if (tetcast_rbf_eval(NULL, q->m, p, 1, v, j) != TETCAST_OK || !(fabs((double)v[0] - (double)middle) < 0.05)) q->bad++;
        for (a = 0; a < 3; a++)
            if (!(fabs((double)j[a] - (double)in->gradient[a][i]) < 2e-3 * (1.0 + fabs((double)j[a])))) q->bad++;
        rgba[3][i] = 1.0f - expf(-q->density * (middle > 0.0f ? middle : 0.0f) * in->length[i]);
        rgba[0][i] = rgba[3][i];
    }
}

/* Extinction in proportion to the value, red. */
static tetcast_optics *red_optics(void) {
    tetcast_control_point points[2];
    tetcast_transfer_desc td;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    memset(points, 0, sizeof points);
    memset(&td, 0, sizeof td);
    points[1].value = 100.0f;
    points[1].extinction = 100.0f * 0.4f;
    points[0].rgb[0] = points[1].rgb[0] = 1.0f;
    td.points = points;
    td.point_count = 2;
    CHECK(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, NULL, &o) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    return o;
}

/* A picture by the scalar code, the left part of it and the right one, on three threads. */
static void in_two_parts(const tetcast_rbf_render_desc *desc, const tetcast_rbf *m, const tetcast_optics *o, const tetcast_image *image) {
    tetcast_rbf_render_desc q = *desc;
    tetcast_image part = *image;
    uint32_t i;
    q.isa = TETCAST_ISA_SCALAR;
    q.env.thread_count = 3;
    q.frame[0] = image->width;
    q.frame[1] = image->height;
    for (i = 0; i < 2; i++) {
        q.part[0] = i * 13;
        part.width = i != 0 ? image->width - 13 : 13;
        part.rgba = image->rgba + 4 * q.part[0];
        part.rgba_stride = image->width * 16;
        CHECK(tetcast_rbf_render(&q, m, o, &part, NULL) == TETCAST_OK);
    }
}

/* A shader that does what the optics do gives their picture; half of the box and the other half are the whole; parts of
   a frame have its bits. */
TEST(shaded_functions) {
    enum { W = 36, H = 28 };
    static float rgba[6][W * H * 4];
    tetcast_rbf_desc d = random_desc(9, 60, 1, 0.1, 0.4, 0.1);
    tetcast_optics *o = red_optics();
    tetcast_rbf_render_desc q;
    tetcast_image image;
    tetcast_shader s;
    tetcast_clip_desc cd;
    tetcast_clip_plane plane;
    tetcast_clip *clip = NULL;
    field_probe probe;
    tetcast_rbf *m;
    double worst = 0.0, halves = 0.0;
    uint32_t i, k;
    for (i = 0; i < 60; i++) g_f[i].weight[0] = fabsf(g_f[i].weight[0]);
    d.offset[0] = 0.1f;
    m = make(&d);
    memset(&q, 0, sizeof q);
    memset(&image, 0, sizeof image);
    memset(&s, 0, sizeof s);
    memset(&cd, 0, sizeof cd);
    memset(&plane, 0, sizeof plane);
    image.width = W;
    image.height = H;
    q.step = 0.02f;
    q.env.thread_count = 1;
    probe.m = m;
    probe.density = 0.4f;
    probe.bad = 0;
    s.user = &probe;
    s.needs = TETCAST_NEED_GRADIENT | TETCAST_NEED_POSITION;
    s.shade_fn = field_shade;
    image.rgba = rgba[0];
    CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_OK);
    q.shader = &s;
    image.rgba = rgba[1];
    CHECK(tetcast_rbf_render(&q, m, NULL, &image, NULL) == TETCAST_OK);
    q.shader = NULL;
    CHECK_EQ_U64((uint64_t)probe.bad, 0);
    for (k = 0; k < 2; k++) {
        plane.normal[0] = k == 0 ? 1.0 : -1.0;
        plane.normal[1] = k == 0 ? 0.3 : -0.3;
        plane.offset = plane.normal[0] * 0.5 * (d.box_min[0] + d.box_max[0]) + plane.normal[1] * 0.5 * (d.box_min[1] + d.box_max[1]);
        cd.planes = &plane;
        cd.plane_count = 1;
        CHECK(tetcast_clip_create(&cd, &clip) == TETCAST_OK);
        q.clip = clip;
        image.rgba = rgba[2 + k];
        CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_OK);
        if (k == 0) { /* the same by the scalar code, in two parts, on three threads */
            image.rgba = rgba[4];
            in_two_parts(&q, m, o, &image);
            CHECK(memcmp(rgba[2], rgba[4], sizeof rgba[2]) == 0);
        }
        tetcast_clip_destroy(clip);
        q.clip = NULL;
    }
    for (i = 0; i < W * H; i++) {
        const double a = (double)rgba[0][4 * i + 3], b = (double)rgba[2][4 * i + 3], c = (double)rgba[3][4 * i + 3];
        worst = fmax(worst, fabs(a - (double)rgba[1][4 * i + 3]));
        worst = fmax(worst, fabs((double)rgba[0][4 * i] - (double)rgba[1][4 * i]));
        halves = fmax(halves, fabs((1.0 - a) - (1.0 - b) * (1.0 - c))); /* light through one and the other */
    }
    CHECK_MSG(worst < 3e-3, "%g", worst);
    CHECK_MSG(halves < 1e-5, "%g", halves);
    for (k = 0; k < 2; k++) { /* ranges of depth, nearest first */
        float limit[W * H];
        for (i = 0; i < W * H; i++) limit[i] = 4.0f;
        q.limit = k == 0 ? limit : NULL;
        q.clip_near = k == 0 ? 0.0f : 4.0f;
        image.rgba = rgba[2 + k];
        CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_OK);
    }
    tetcast_over(rgba[2], rgba[3], W * H);
    for (i = 0, worst = 0.0; i < 4 * W * H; i++) worst = fmax(worst, fabs((double)rgba[0][i] - (double)rgba[2][i]));
    CHECK_MSG(worst < 1e-5, "%g", worst);
    q.isa = (tetcast_isa)99;
    CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_ERR_INVALID_ARG);
    q.isa = TETCAST_ISA_AUTO;
    s.shade_fn = NULL;
    q.shader = &s;
    CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_ERR_INVALID_ARG);
    tetcast_optics_destroy(o);
    tetcast_rbf_destroy(m);
}

typedef struct rbf_channel_probe {
    const tetcast_rbf *m;
    tetcast_rbf_channel channel;
    const tetcast_camera *camera;
    double off, most;            /* from the features at the middles; of these */
    uint32_t seen, bad;
} rbf_channel_probe;

static void rbf_channel_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    rbf_channel_probe *q = (rbf_channel_probe *)user;
    int i, a;
    for (i = 0; i < 8; i++) {
        double p[3], want, along = 0.0;
        float v[3], j[9];
        tetcast_flow f;
        rgba[0][i] = rgba[1][i] = rgba[2][i] = rgba[3][i] = 0.0f;
        if (!(in->mask >> i & 1u)) continue;
        for (a = 0; a < 3; a++) {
            p[a] = (double)in->position[a][i];
            along += (p[a] - q->camera->eye[a]) * (double)in->direction[a][i];
        }
        q->bad += !(fabs(along - (double)(in->depth[i] + 0.5f * in->length[i])) < 1e-4);
        q->bad += tetcast_rbf_eval(NULL, q->m, p, 1, v, j) != TETCAST_OK;
        q->bad += !(in->front[i] - in->front[i] == 0.0f && in->back[i] - in->back[i] == 0.0f);
        tetcast_flow_features(v, j, &f);
        want = q->channel == TETCAST_RBF_CHANNEL_COMPONENT ? (double)v[1] : q->channel == TETCAST_RBF_CHANNEL_VORTICITY
            ? sqrt((double)f.vorticity[0] * (double)f.vorticity[0] + (double)f.vorticity[1] * (double)f.vorticity[1] +
                   (double)f.vorticity[2] * (double)f.vorticity[2])
            : q->channel == TETCAST_RBF_CHANNEL_LAMBDA2 ? -(double)f.lambda2 : q->channel == TETCAST_RBF_CHANNEL_HELICITY ? (double)f.helicity
            : (double)f.speed;
        q->off = fmax(q->off, fabs(0.5 * ((double)in->front[i] + (double)in->back[i]) - want));
        q->most = fmax(q->most, fabs(want));
        q->seen++;
    }
}

/* What is seen of a flow is what its features say; the same for tiles and for samples one by one. */
TEST(channels_of_flows) {
    tetcast_rbf_desc d = random_desc(24, 40, 3, 0.3, 0.6, 0.0);
    tetcast_rbf *m = make(&d), *large;
    uint32_t channel, gather, i;
    for (i = 0; i < 3 * 40; i++) g_f[i / 3].weight[i % 3] *= 1e36f; /* squares are infinite, what is seen is not */
    large = make(&d);
    REQUIRE(m != NULL && large != NULL);
    for (channel = TETCAST_RBF_CHANNEL_AUTO; channel <= TETCAST_RBF_CHANNEL_HELICITY; channel++)
        for (gather = 0; gather < 4; gather++) {
            float rgba[6 * 5 * 4];
            tetcast_rbf_render_desc q;
            tetcast_image image;
            tetcast_shader s;
            rbf_channel_probe probe;
            memset(&q, 0, sizeof q);
            memset(&image, 0, sizeof image);
            memset(&s, 0, sizeof s);
            memset(&probe, 0, sizeof probe);
            probe.m = gather < 2 ? m : large;
            probe.channel = (tetcast_rbf_channel)channel;
            probe.camera = &q.camera;
            q.env.thread_count = 1;
            q.channel = (tetcast_rbf_channel)channel;
            q.component = 1;
            q.gather = gather & 1u;
            q.step = 0.02f;
            q.camera.ortho_height = 1.5f;
            q.camera.eye[0] = 4.0;
            q.camera.eye[1] = q.camera.at[1] = q.camera.eye[2] = q.camera.at[2] = 1.0;
            s.user = &probe;
            s.needs = TETCAST_NEED_POSITION | TETCAST_NEED_DIRECTION | TETCAST_NEED_DEPTH;
            s.shade_fn = rbf_channel_shade;
            q.shader = &s;
            image.width = 6;
            image.height = 5;
            image.rgba = rgba;
            CHECK(tetcast_rbf_render(&q, probe.m, NULL, &image, NULL) == TETCAST_OK);
            CHECK_MSG(probe.seen > 2000 && probe.bad == 0 && (gather >= 2 || probe.off < 0.02 * probe.most) && probe.most > 0.1,
                      "channel %u: %u seen, %u bad, off by %g of %g", channel, probe.seen, probe.bad, probe.off, probe.most);
        }
    tetcast_rbf_destroy(m);
    tetcast_rbf_destroy(large);
}

/* Functions left out while moving: faster, and off by no more than all that is left out; those with weights above stay as they are. */
TEST(left_out) {
    enum { W = 40, H = 30 };
    static float rgba[4][W * H * 4];
    static const float epsilon[4] = {0.0f, 1e-6f, 0.05f, 0.3f};
    tetcast_rbf_desc d = random_desc(33, 300, 1, 0.05, 0.2, 0.0);
    tetcast_optics *o = rbf_make_optics(TETCAST_MODEL_VOLUME, 0.5f);
    uint64_t work[4];
    double off[4] = {0, 0, 0, 0};
    tetcast_rbf *m;
    uint32_t i, k;
    for (i = 0; i < 300; i++) {
        const float w = g_f[i].weight[0];
        g_f[i].weight[0] = i % 3 == 0 ? 0.5f + 0.5f * fabsf(w) : i % 3 == 1 ? 0.02f * w : 0.2f * w;
    }
    m = make(&d);
    REQUIRE(m != NULL && o != NULL);
    for (k = 0; k < 4; k++) {
        tetcast_rbf_render_desc q;
        tetcast_rbf_render_stats st;
        tetcast_image image;
        memset(&q, 0, sizeof q);
        memset(&st, 0, sizeof st);
        memset(&image, 0, sizeof image);
        q.epsilon = epsilon[k];
        q.step = 0.02f;
        image.width = W;
        image.height = H;
        image.rgba = rgba[k];
        CHECK(tetcast_rbf_render(&q, m, o, &image, &st) == TETCAST_OK);
        work[k] = st.evaluations;
        for (i = 0; i < W * H * 4; i++) off[k] = fmax(off[k], fabs((double)rgba[k][i] - (double)rgba[0][i]));
    }
    CHECK(work[1] == work[0] && off[1] == 0.0);
    CHECK_MSG(work[2] < work[1] && work[3] < work[2], "%u %u %u evaluations", (unsigned)work[1], (unsigned)work[2], (unsigned)work[3]);
    CHECK_MSG(off[2] > 0.0 && off[2] < 0.05 && off[3] > off[2] && off[3] < 0.5, "off by %g and %g", off[2], off[3]);
    { /* a picture of the functions that stay */
        tetcast_rbf_render_desc q;
        tetcast_image image;
        tetcast_rbf *rest;
        float most = 0.0f;
        for (i = 0; i < 300; i++) most = fabsf(g_f[i].weight[0]) > most ? fabsf(g_f[i].weight[0]) : most;
        for (i = 0; i < 300; i++) if (fabsf(g_f[i].weight[0]) <= 0.05f * most) g_f[i].weight[0] = 0.0f;
        rest = make(&d);
        REQUIRE(rest != NULL);
        memset(&q, 0, sizeof q);
        memset(&image, 0, sizeof image);
        q.step = 0.02f;
        image.width = W;
        image.height = H;
        image.rgba = rgba[3];
        CHECK(tetcast_rbf_render(&q, rest, o, &image, NULL) == TETCAST_OK);
        CHECK(memcmp(rgba[3], rgba[2], sizeof rgba[2]) == 0);
        tetcast_rbf_destroy(rest);
    }
    tetcast_rbf_destroy(m);
    tetcast_optics_destroy(o);
}

/* Functions that are narrow or flat, so that samples are far into their tails, against samples one by one. */
TEST(narrow_functions) {
    enum { W = 32 };
    static float rgba[3][W * W * 4];
    tetcast_optics *o = rbf_make_optics(TETCAST_MODEL_VOLUME, 0.5f);
    test_rng r = test_rng_make(57);
    const uint32_t rounds = test_quick() ? 25 : 400;
    uint32_t round, i, k, a;
    REQUIRE(o != NULL);
    for (round = 0; round < rounds; round++) {
        tetcast_rbf_desc d = random_desc(round, 1, 1, 0.002, 0.06, 0.0);
        tetcast_rbf_render_desc q;
        tetcast_rbf *m;
        uint32_t bad = 0;
        d.kernel = round % 5 == 4 ? TETCAST_KERNEL_GAUSS_CUT : TETCAST_KERNEL_GAUSS;
        g_f[0].weight[0] = 1.0f;
        g_f[0].stretch = round % 2 ? 0.1 : pow(2.0, -6.0 * test_rng_double(&r));
        memset(&q, 0, sizeof q);
        for (a = 0; a < 3; a++) {
            g_f[0].axis[a] = test_rng_double(&r) - 0.5;
            q.camera.at[a] = g_f[0].centre[a];
            q.camera.eye[a] = g_f[0].centre[a] + 4.0 * (test_rng_double(&r) - 0.5);
        }
        m = make(&d);
        REQUIRE(m != NULL);
        for (k = 0; k < 3; k++) {
            tetcast_image image;
            memset(&image, 0, sizeof image);
            image.width = image.height = W;
            image.rgba = rgba[k];
            q.gather = k == 2;
            q.isa = k == 0 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO;
            CHECK(tetcast_rbf_render(&q, m, o, &image, NULL) == TETCAST_OK);
        }
        for (i = 0; i < W * W * 4; i++) bad += !(fabsf(rgba[0][i] - rgba[2][i]) <= 1e-4f);
        CHECK_MSG(bad == 0, "function %u: %u numbers", round, bad);
        CHECK(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
        tetcast_rbf_destroy(m);
    }
    tetcast_optics_destroy(o);
}

/* The recurrence along rays against the formula: steps from far smaller to far larger than the width, starts in tails. */
TEST(recurrence) {
    test_rng r = test_rng_make(31);
    static float rows[2][4096 * 8];
    double worst = 0.0;
    int t, j, l, rounds = test_quick() ? 60 : 400;
    for (t = 0; t < rounds; t++) {
        tetcasti_rbf_group g;
        tetcasti_rbf_record f;
        tetcasti_rbf_reach reach;
        const double ratio = pow(10.0, (double)test_rng_range(&r, -4.0f, 1.0f)); /* h / width */
        const float width = 0.05f;
        memset(&g, 0, sizeof g);
        memset(&f, 0, sizeof f);
        g.h = (float)(ratio * (double)width);
        g.per = 1.0f / g.h;
        g.n = 4096;
        f.e = (float)exp(-0.5 * 3.5 * 3.5);
        f.a = (float)(-0.72134752044448170368 / ((double)width * (double)width));
        f.radius = 3.5f * width;
        f.w[0] = 1.0f;
        if (t % 2 != 0) { /* an ellipsoid */
            const double stretch = pow(3.0, (double)test_rng_range(&r, -1.0f, 1.0f)), turn = (double)test_rng_range(&r, 0.0f, 6.0f);
            f.m[0] = (float)(0.8 * cos(turn));
            f.m[1] = 0.6f;
            f.m[2] = (float)(0.8 * sin(turn));
            f.k = (float)(1.0 / (stretch * stretch) - 1.0);
            if (stretch > 1.0) f.radius *= (float)stretch;
        }
        f.c[2] = test_rng_range(&r, -0.3f, 1.0f);
        for (l = 0; l < 8; l++) {
            g.o[0][l] = test_rng_range(&r, -0.2f, 0.2f);
            g.d[0][l] = test_rng_range(&r, -0.01f, 0.01f);
            g.d[2][l] = sqrtf(1.0f - g.d[0][l] * g.d[0][l]);
        }
        memset(rows, 0, sizeof rows);
        memset(&reach, 0, sizeof reach);
        reach.decay = (float)exp2(fmax(-120.0, 2.0 * (double)f.a * (double)g.h * (double)g.h));
        if (!tetcasti_rbf_meet(&g, &f, &reach)) continue;
        tetcasti_rbf_run_scalar(TETCAST_KERNEL_GAUSS, 1, &g, &f, &reach, rows[0], 0);
#if TETCASTI_AVX2
        if (tetcast_isa_best() >= TETCAST_ISA_AVX2) {
            tetcasti_rbf_reach again = reach;
            CHECK(t % 2 != 0 ? tetcasti_rbf_meet_ellipsoid8(&g, &f, &again) : tetcasti_rbf_meet8(&g, &f, &again));
            CHECK(memcmp(&again, &reach, sizeof reach) == 0);
            tetcasti_rbf_run8(TETCAST_KERNEL_GAUSS, 1, &g, &f, &reach, rows[1], 0);
            CHECK(memcmp(rows[0], rows[1], sizeof rows[0]) == 0);
        }
#endif
        for (j = 0; j < 4096; j++)
            for (l = 0; l < 8; l++) {
                const double x = (double)g.o[0][l] + (double)j * (double)g.h * (double)g.d[0][l];
                const double z = (double)j * (double)g.h * (double)g.d[2][l] - (double)f.c[2];
                const double s = x * (double)f.m[0] + z * (double)f.m[2], d2 = x * x + z * z + (double)f.k * s * s;
                const double v = exp(-0.5 * d2 / ((double)width * (double)width)) - (double)f.e;
                const double e = fabs((double)rows[0][j * 8 + l] - (v > 0.0 ? v : 0.0));
                if (!(e <= worst)) worst = e;
            }
    }
    CHECK_MSG(worst < 4e-5, "off by %.3g of the height", worst);
}

/* What comes after a fit: its file, a picture, bricks. */
static tetcast_result fitted_on(const tetcast_env *env, const tetcast_rbf *m, const tetcast_optics *o) {
    enum { W = 20 };
    static float rgba[W * W * 4];
    tetcast_rbf_render_desc q;
    tetcast_bricks_desc bd;
    tetcast_image image;
    tetcast_rbf *again = NULL;
    tetcast_bricks *b = NULL;
    size_t size = 0;
    void *bytes = save(m, &size);
    tetcast_result result = tetcast_rbf_load_memory(env, bytes, size, &again);
    CHECK((result == TETCAST_OK) == (again != NULL));
    tetcast_rbf_destroy(again);
    free(bytes);
    memset(&q, 0, sizeof q);
    memset(&image, 0, sizeof image);
    q.env = *env;
    image.width = image.height = W;
    image.rgba = rgba;
    if (result == TETCAST_OK) result = tetcast_rbf_render(&q, m, o, &image, NULL);
    if (result != TETCAST_OK) return result;
    memset(&bd, 0, sizeof bd);
    bd.env = *env;
    bd.log_cells = 3;
    bd.max_error = 0.05f;
    bd.longest_end = 17;
    bd.checks = 100;
    result = tetcast_bricks_create_rbf(&bd, m, TETCAST_RBF_CHANNEL_AUTO, 0, NULL, &b);
    CHECK((result == TETCAST_OK) == (b != NULL));
    tetcast_bricks_destroy(b);
    return result;
}

/* The k-th allocation fails, for all k; quick: for every third. */
TEST(out_of_memory) {
    static float data[4 * 4 * 4];
    tetcast_rbf_points p = grid_points(data, 4, 4, 4, 1);
    tetcast_rbf *first = NULL;
    tetcast_optics *o = rbf_make_optics(TETCAST_MODEL_VOLUME, 0.5f);
    test_rng r = test_rng_make(14);
    uint32_t how, i;
    for (i = 0; i < 64; i++) data[i] = test_rng_float(&r);
    CHECK(tetcast_rbf_fit(NULL, &p, NULL, &first) == TETCAST_OK);
    for (how = 0; how < 4; how++) { /* from nothing or from another, with plates or held down between the points */
        int64_t k;
        int done = 0;
        for (k = test_quick() ? how % 3 : 0; !done && k < 2000; k += test_quick() ? 3 : 1) {
            tetcast_rbf_fit_desc d;
            tetcast_rbf *m = NULL;
            tetcast_result result;
            test_alloc ta;
            test_alloc_init(&ta);
            ta.fail_at = k;
            memset(&d, 0, sizeof d);
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.env.thread_count = 1;
            d.max_error = 0.3f;
            d.compare = 1;
            d.between = how >= 2;
            d.start = how % 2 != 0 ? first : NULL;
            result = tetcast_rbf_fit(&d, &p, NULL, &m);
            CHECK((result == TETCAST_OK) == (m != NULL));
            if (result == TETCAST_OK && how == 0) result = fitted_on(&d.env, m, o);
            CHECK(result == TETCAST_OK || (result == TETCAST_ERR_NO_MEMORY && ta.failed != 0));
            done = result == TETCAST_OK;
            tetcast_rbf_destroy(m);
            test_alloc_check(&ta);
        }
        CHECK_MSG(done && k > 20, "%u: %d", how, (int)k);
    }
    tetcast_rbf_destroy(first);
    tetcast_optics_destroy(o);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(exponential);
    RUN(sums);
    RUN(sign_of_zero);
    RUN(derivatives);
    RUN(wide_functions);
    RUN(no_function_missed);
    RUN(bases);
    RUN(bounds_hold);
    RUN(bounds_of_many);
    RUN(bounds_at_jumps);
    RUN(thinnest_functions);
    RUN(no_seams);
    RUN(extremes);
    RUN(files);
    RUN(files_of_large_weights);
    RUN(promise);
    RUN(between_the_points);
    RUN(directions);
    RUN(middles);
    RUN(thesis_steps);
    RUN(decoded);
    RUN(same_model);
    RUN(few_come_back);
    RUN(few_and_more);
    RUN(few_are_too_many);
    RUN(values_that_are_no_floats);
    RUN(constants_and_tiny_ranges);
    RUN(series);
    RUN(starts);
    RUN(odd_data);
    RUN(data_of_any_size);
    RUN(means_far_below_the_largest_error);
    RUN(clipped_from_far_away);
    RUN(flows);
    RUN(traces);
    RUN(traces_in_functions);
    RUN(pictures);
    RUN(pictures_far_away);
    RUN(clipped_functions);
    RUN(sphere);
    RUN(shaded_functions);
    RUN(channels_of_flows);
    RUN(left_out);
    RUN(narrow_functions);
    RUN(recurrence);
    RUN(out_of_memory);
    return test_end();
}
