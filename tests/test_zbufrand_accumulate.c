/* Means of frames, smoothing, noise estimates, reprojection. Frames are synthetic; each statistical check fails by chance
   with probability below 1e-4, seeds are fixed. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"

#define INF_F ((float)INFINITY)

static double gauss(test_rng *r) {
    double u = test_rng_double(r), v = test_rng_double(r);
    return sqrt(-2.0 * log(1.0 - u)) * cos(6.283185307179586 * v);
}

static uint64_t hash_words(const void *data, size_t n, uint64_t hash) { /* the same on machines of either byte order */
    const uint8_t *p = (const uint8_t *)data;
    size_t i;
    for (i = 0; i < n; i++) {
        uint32_t x;
        memcpy(&x, p + 4 * i, 4);
        hash = (hash ^ x) * 0x100000001b3u;
        hash ^= hash >> 29;
    }
    return hash;
}

static zbufrand_accumulator_desc defaults(uint32_t w, uint32_t h, zbufrand_accumulation mode) {
    zbufrand_accumulator_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.width = w;
    d.height = h;
    d.mode = mode;
    return d;
}

static zbufrand_view looking(double x, double y, double z, double turn, uint32_t w, uint32_t h) { /* along +z, turned about y */
    zbufrand_view v;
    double c = cos(turn), s = sin(turn), m[3][3];
    int i, k;
    memset(&v, 0, sizeof v);
    m[0][0] = c; m[0][1] = 0.0; m[0][2] = -s;
    m[1][0] = 0.0; m[1][1] = 1.0; m[1][2] = 0.0;
    m[2][0] = s; m[2][1] = 0.0; m[2][2] = c;
    for (i = 0; i < 3; i++) {
        for (k = 0; k < 3; k++) v.world_to_camera[i][k] = m[i][k];
        v.world_to_camera[i][3] = -(m[i][0] * x + m[i][1] * y + m[i][2] * z);
    }
    v.focal = w;
    v.center_x = 0.5 * w;
    v.center_y = 0.5 * h;
    v.near_z = 0.01;
    return v;
}

/* Frames of pixels with means m and deviation 0.1 + 0.1 c for channel c. */
static void noisy(test_rng *r, float *rgba, size_t n) {
    size_t i;
    int k;
    for (i = 0; i < n; i++, rgba += 4) {
        for (k = 0; k < 3; k++) rgba[k] = (float)(0.5 + 0.001 * (double)(i % 100) + (0.1 + 0.1 * k) * gauss(r));
        rgba[3] = 1.0f;
    }
}
static double truth_of(size_t i) { return 0.5 + 0.001 * (double)(i % 100); }

static double rmse(const float *rgba, size_t n) {
    double sum = 0.0;
    size_t i;
    int k;
    for (i = 0; i < n; i++) {
        for (k = 0; k < 3; k++) sum += pow((double)rgba[4 * i + (size_t)k] - truth_of(i), 2.0);
    }
    return sqrt(sum / (3.0 * (double)n));
}

TEST(mean_and_its_noise) { /* the error falls with the square root; the estimate knows it */
    enum { W = 60, H = 50, N = W * H };
    static float frame[4 * N], out[4 * N];
    test_rng r = test_rng_make(1);
    zbufrand_accumulator_desc d = defaults(W, H, ZBUFRAND_ACCUMULATE_MEAN);
    zbufrand_accumulator *a = NULL;
    zbufrand_noise noise;
    double one = sqrt((0.01 + 0.04 + 0.09) / 3.0), sx = 0, sy = 0, sxx = 0, sxy = 0, count = 0;
    int n;
    CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
    REQUIRE(a != NULL);
    CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.1, &noise), ZBUFRAND_OK);
    CHECK(noise.rmse == (double)INFINITY && noise.frames == 0.0 && noise.more_frames == 2.0);
    for (n = 1; n <= 256; n++) {
        double e;
        noisy(&r, frame, N);
        CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, NULL, NULL), ZBUFRAND_OK);
        if ((n & (n - 1)) != 0) continue;
        CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.005, &noise), ZBUFRAND_OK);
        e = rmse(out, N);
        CHECK_MSG(fabs(e / (one / sqrt((double)n)) - 1.0) < 0.05, "%d frames: error %g is not %g", n, e, one / sqrt((double)n));
        if (n == 1) {
            CHECK(noise.rmse == (double)INFINITY);
            CHECK_EQ_U64(memcmp(out, frame, sizeof out), 0);
            continue;
        }
        CHECK_MSG(fabs(noise.rmse / e - 1.0) < 0.06, "%d frames: estimate %g of the error %g", n, noise.rmse, e);
        CHECK_NEAR(noise.frames, n, 1e-9);
        if (e > 0.005) CHECK_MSG(fabs((noise.more_frames + n) / (one * one / 2.5e-5) - 1.0) < 0.08, "%g more frames", noise.more_frames);
        sx += log((double)n);
        sy += log(e);
        sxx += log((double)n) * log((double)n);
        sxy += log((double)n) * log(e);
        count++;
    }
    CHECK_NEAR((count * sxy - sx * sy) / (count * sxx - sx * sx), -0.5, 0.03);
    CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.02, &noise), ZBUFRAND_OK);
    CHECK(noise.more_frames == 0.0);
    zbufrand_accumulator_clear(a);
    CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.0, &noise), ZBUFRAND_OK);
    CHECK(noise.frames == 0.0);
    zbufrand_accumulator_destroy(a);
}

TEST(smoothing_and_its_noise) {
    enum { W = 64, H = 64, N = W * H };
    static float frame[4 * N], out[4 * N];
    static const float epsilon[3] = {0.05f, 0.1f, 0.3f};
    double one = sqrt((0.01 + 0.04 + 0.09) / 3.0);
    int k, n;
    for (k = 0; k < 3; k++) {
        test_rng r = test_rng_make(2 + (uint64_t)k);
        zbufrand_accumulator_desc d = defaults(W, H, ZBUFRAND_ACCUMULATE_SMOOTH);
        zbufrand_accumulator *a = NULL;
        zbufrand_noise noise;
        double e = 0.0, want = one * sqrt((double)epsilon[k] / (2.0 - (double)epsilon[k])), share;
        d.epsilon = epsilon[k];
        CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
        if (a == NULL) return;
        for (n = 1; n <= 150; n++) {
            noisy(&r, frame, N);
            CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, NULL, NULL), ZBUFRAND_OK);
            if (n != 3 && n != 10 && n != 150) continue;
            CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_accumulator_noise(a, want * 1.05, &noise), ZBUFRAND_OK);
            e = rmse(out, N);
            share = (double)epsilon[k] / (2.0 - (double)epsilon[k]);
            share = share + (1.0 - share) * pow(1.0 - (double)epsilon[k], 2.0 * (n - 1));
            CHECK_MSG(fabs(e / (one * sqrt(share)) - 1.0) < 0.05, "epsilon %g, %d frames: error %g", (double)epsilon[k], n, e);
            CHECK_MSG(fabs(noise.rmse / e - 1.0) < 0.08, "epsilon %g, %d frames: estimate %g of %g", (double)epsilon[k], n, noise.rmse, e);
        }
        CHECK_MSG(fabs(e / want - 1.0) < 0.03, "epsilon %g: %g is not %g", (double)epsilon[k], e, want);
        CHECK_NEAR(noise.frames, zbufrand_smoothing_frames((double)epsilon[k]), 0.02);
        CHECK_EQ_U64(zbufrand_accumulator_noise(a, want * 0.9, &noise), ZBUFRAND_OK);
        CHECK(noise.more_frames == (double)INFINITY);
        zbufrand_accumulator_clear(a);
        for (n = 0; n < 3; n++) {
            noisy(&r, frame, N);
            CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, NULL, NULL), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_accumulator_noise(a, want * 1.2, &noise), ZBUFRAND_OK);
        if (noise.more_frames > 0.0) {
            share = (double)epsilon[k] / (2.0 - (double)epsilon[k]);
            share = share + (1.0 - share) * pow(1.0 - (double)epsilon[k], 2.0 * (2.0 + noise.more_frames));
            CHECK_MSG(one * sqrt(share) < want * 1.24 && one * sqrt(share) > want * 1.05,
                      "%g more frames bring %g, wanted %g", noise.more_frames, one * sqrt(share), want * 1.2);
        }
        zbufrand_accumulator_destroy(a);
    }
}

TEST(sparse_frames_and_contrast) { /* mean of nearly empty pictures of stripes, made brighter: the mean image */
    enum { W = 40, H = 4, N = W * H };
    static float frame[4 * N], out[4 * N], hit[4 * N];
    test_rng r = test_rng_make(5);
    zbufrand_accumulator_desc d = defaults(W, H, ZBUFRAND_ACCUMULATE_MEAN);
    zbufrand_accumulator *a = NULL;
    double mu = 0.05, worst = 0.0, dark = 0.0;
    int n, frames = test_quick() ? 4000 : 40000, i;
    CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
    REQUIRE(a != NULL);
    for (n = 0; n < frames; n++) { /* a front of stripes covering 0..1 of the pixels, white, over a black ground */
        memset(frame, 0, sizeof frame);
        for (i = 0; i < N; i++) {
            double alpha = (double)(i % W) / (double)(W - 1), p[2], area[2], empty, u = test_rng_double(&r);
            area[0] = alpha;
            area[1] = 1.0 - alpha;
            empty = zbufrand_pixel_law(area, 2, mu, p);
            if (u < empty) continue;
            frame[4 * i] = frame[4 * i + 1] = frame[4 * i + 2] = u < empty + p[0] ? 1.0f : 0.0f;
            frame[4 * i + 3] = 1.0f;
        }
        CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, NULL, NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
    for (i = 0; i < N; i++) dark += (double)out[4 * i] / (double)N;
    CHECK_MSG(dark < 0.03, "without contrast: %g", dark);
    CHECK_EQ_U64(zbufrand_accumulator_get(a, (float)(1.0 / (1.0 - exp(-mu))), out), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_accumulator_get(a, -1.0f, hit), ZBUFRAND_OK);
    for (i = 0; i < N; i++) {
        double alpha = (double)(i % W) / (double)(W - 1), sigma = sqrt(0.25 / (frames * mu)) + 0.003;
        worst = fmax(worst, fabs((double)hit[4 * i] - alpha) / sigma);
        CHECK(hit[4 * i + 3] == 1.0f && out[4 * i + 3] <= 1.00001f);
        CHECK_NEAR(out[4 * i + 3], 1.0, 6.0 / sqrt(frames * mu));
        CHECK_NEAR(out[4 * i], alpha, 6.0 * sigma);
    }
    CHECK_MSG(worst < 4.6, "off the mean image by %g standard deviations", worst);
    zbufrand_accumulator_destroy(a);
}

/* ---- adaptive ---------------------------------------------------------------------------------------------------- */

TEST(still_pictures_converge) { /* the camera at rest: adaptive is the plain mean but for rare false alarms */
    enum { W = 64, H = 48, N = W * H };
    static float frame[4 * N], out[4 * N], depth[N];
    test_rng r = test_rng_make(6);
    zbufrand_accumulator_desc d = defaults(W, H, ZBUFRAND_ACCUMULATE_ADAPTIVE);
    zbufrand_accumulator *a = NULL;
    zbufrand_view v = looking(0, 0, 0, 0, W, H);
    zbufrand_noise noise;
    double one = sqrt((0.01 + 0.04 + 0.09) / 3.0), e;
    int n, frames = 200, i;
    for (i = 0; i < N; i++) depth[i] = 3.0f;
    CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
    REQUIRE(a != NULL);
    for (n = 0; n < frames; n++) {
        noisy(&r, frame, N);
        CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.0, &noise), ZBUFRAND_OK);
    e = rmse(out, N);
    CHECK_MSG(e < 1.1 * one / sqrt((double)frames), "error %g, plain mean %g", e, one / sqrt((double)frames));
    CHECK_MSG(noise.frames > 0.97 * frames, "worth %g of %d frames", noise.frames, frames);
    CHECK_MSG(fabs(noise.rmse / e - 1.0) < 0.1, "estimate %g of %g", noise.rmse, e);
    /* black and white pixels, as samples of stripes are: the law of noise is another one */
    zbufrand_accumulator_clear(a);
    for (n = 0; n < frames; n++) {
        for (i = 0; i < N; i++) {
            float x = test_rng_double(&r) < 0.02 + 0.96 * (i % W) / (double)(W - 1) ? 1.0f : 0.0f;
            frame[4 * i] = frame[4 * i + 1] = frame[4 * i + 2] = x;
        }
        CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.0, &noise), ZBUFRAND_OK);
    for (e = 0.0, i = 0; i < N; i++) e += pow((double)out[4 * i] - (0.02 + 0.96 * (i % W) / (double)(W - 1)), 2.0) / (double)N;
    if (getenv("SHOW")) printf("black and white: error %g, worth %g frames\n", sqrt(e), noise.frames);
    CHECK_MSG(sqrt(e) < 1.25 * sqrt(1.0 / 6.0 / frames), "black and white: error %g", sqrt(e));
    zbufrand_accumulator_destroy(a);
}

TEST(cuts_leave_no_ghosts) { /* another picture all of a sudden: gone within three frames, also without noise */
    enum { W = 64, H = 48, N = W * H };
    static float frame[4 * N], out[4 * N], depth[N];
    test_rng r = test_rng_make(7);
    zbufrand_view v = looking(0, 0, 0, 0, W, H);
    int sigma, n, i, after;
    for (i = 0; i < N; i++) depth[i] = 3.0f;
    for (sigma = 0; sigma < 3; sigma++) {
        zbufrand_accumulator_desc d = defaults(W, H, ZBUFRAND_ACCUMULATE_ADAPTIVE);
        zbufrand_accumulator *a = NULL;
        double noise_level = 0.1 * sigma;
        CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
        if (a == NULL) return;
        for (n = 0; n < 40; n++) {
            for (i = 0; i < N; i++) frame[4 * i] = frame[4 * i + 1] = frame[4 * i + 2] = (float)(0.2 + noise_level * gauss(&r));
            CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
        }
        for (after = 1; after <= 3; after++) {
            double ghost = 0.0;
            for (i = 0; i < N; i++) { /* the right half changes by 0.5 */
                double x = i % W >= W / 2 ? 0.7 : 0.2;
                frame[4 * i] = frame[4 * i + 1] = frame[4 * i + 2] = (float)(x + noise_level * gauss(&r));
            }
            CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
            for (i = 0; i < N; i++) {
                if (i % W >= W / 2 + 2) ghost += (0.7 - (double)out[4 * i]) / ((W / 2 - 2) * H);
            }
            if (after == 3) CHECK_MSG(fabs(ghost) < 0.01, "noise %g: %g of the old picture is left after %d frames", noise_level, ghost, after);
        }
        {
            double other = 0.0; /* the left half has kept its history */
            zbufrand_noise q;
            for (i = 0; i < N; i++) if (i % W < W / 2 - 2) other = fmax(other, fabs((double)out[4 * i] - 0.2));
            CHECK_MSG(other < noise_level * 5.0 / sqrt(40.0) + 1e-6, "noise %g: the unchanged half is off by %g", noise_level, other);
            CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.0, &q), ZBUFRAND_OK);
            CHECK_MSG(q.frames > 20.0 && q.frames < 25.0, "worth %g frames", q.frames);
        }
        zbufrand_accumulator_destroy(a);
    }
}

TEST(equal_frames_stay_equal) {
    enum { W = 33, H = 21, N = W * H };
    static float frame[4 * N], out[4 * N], depth[N];
    test_rng r = test_rng_make(8);
    int mode, n, i;
    for (i = 0; i < N; i++) {
        depth[i] = i % 7 ? 2.0f + 0.1f * (float)(i % W) : INF_F;
        frame[4 * i] = test_rng_float(&r);
        frame[4 * i + 1] = test_rng_float(&r);
        frame[4 * i + 2] = test_rng_float(&r);
        frame[4 * i + 3] = i % 7 ? 1.0f : 0.0f;
    }
    for (mode = 0; mode < 3; mode++) {
        zbufrand_accumulator_desc d = defaults(W, H, (zbufrand_accumulation)mode);
        zbufrand_accumulator *a = NULL;
        zbufrand_view v = looking(0, 0, 0, 0, W, H);
        zbufrand_noise q;
        CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
        if (a == NULL) return;
        for (n = 0; n < 20; n++) {
            CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
            CHECK_EQ_U64(memcmp(out, frame, sizeof out), 0);
        }
        CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.0, &q), ZBUFRAND_OK);
        CHECK(q.rmse == 0.0 && q.more_frames == 0.0);
        zbufrand_accumulator_destroy(a);
    }
}

/* A world of two walls, z = 4 (its stripes vary slowly along x, it ends at x = 0.3) and z = 9 behind it. */
static double wall(double ox, double oz, double dx, double dz, double *depth_t) {
    double t = (4.0 - oz) / dz, x = ox + t * dx;
    if (dz > 0.0 && t > 0.0 && x < 0.3) {
        *depth_t = t;
        return 0.5 + 0.3 * sin(3.0 * x);
    }
    t = (9.0 - oz) / dz;
    *depth_t = t;
    return 0.2 + 0.1 * cos(2.0 * (ox + t * dx));
}

static void shoot(const zbufrand_view *v, double ox, double oz, double turn, uint32_t w, uint32_t h, double sigma,
                  test_rng *r, float *rgba, float *depth, float *truth) {
    uint32_t x, y;
    for (y = 0; y < h; y++) {
        for (x = 0; x < w; x++) {
            double px = (x + 0.5 - v->center_x) / v->focal, t, c = cos(turn), s = sin(turn), color;
            /* camera (px, ., 1) -> world: rows of the rotation are the camera's axes */
            double dx = c * px + s, dz = -s * px + c;
            size_t q = (size_t)y * w + x;
            color = wall(ox, oz, dx, dz, &t);
            truth[q] = (float)color;
            depth[q] = (float)t;
            rgba[4 * q] = rgba[4 * q + 1] = rgba[4 * q + 2] = (float)(color + sigma * gauss(r));
            rgba[4 * q + 3] = 1.0f;
        }
    }
}

TEST(history_follows_the_camera) {
    enum { W = 96, H = 24, N = W * H };
    static float frame[4 * N], out[4 * N], depth[N], truth[N];
    int variant;
    for (variant = 0; variant < 3; variant++) { /* adaptive, smoothing, smoothing with a limit to its trail */
        test_rng r = test_rng_make(9);
        zbufrand_accumulator_desc d = defaults(W, H, variant == 0 ? ZBUFRAND_ACCUMULATE_ADAPTIVE : ZBUFRAND_ACCUMULATE_SMOOTH);
        zbufrand_accumulator *a = NULL;
        zbufrand_noise q;
        double sigma = 0.08, bias = 0.0, square = 0.0, count = 0.0, edge = 0.0;
        int n, i, frames = 60;
        d.blur = variant == 2 ? 2.0f : 0.0f;
        CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
        if (a == NULL) return;
        for (n = 0; n < frames; n++) { /* sideways and turning: about 1.2 pixels a frame on the near wall */
            double ox = -1.5 + 0.03 * n, oz = 0.01 * n, turn = 0.002 * n;
            zbufrand_view v = looking(ox, 0.0, oz, turn, W, H);
            shoot(&v, ox, oz, turn, W, H, sigma, &r, frame, depth, truth);
            CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
            if (n < 30) continue;
            CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
            for (i = 0; i < N; i++) {
                double e = (double)out[4 * i] - (double)truth[i];
                int x = i % W, near_edge = 0, k;
                for (k = -3; k <= 3; k++) if (x + k >= 0 && x + k < W && fabsf(depth[i + k] - depth[i]) > 2.0f) near_edge = 1;
                if (near_edge) {
                    edge = fmax(edge, fabs(e));
                    continue;
                }
                bias += e;
                square += e * e;
                count++;
            }
        }
        CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.0, &q), ZBUFRAND_OK);
        square = sqrt(square / count);
        if (getenv("SHOW")) printf("variant %d: error %g (frame %g), bias %g, edge %g, worth %g frames, estimate %g\n",
                                   variant, square, sigma, bias / count, edge, q.frames, q.rmse);
        if (variant == 0) {
            CHECK_MSG(square < 0.25 * sigma, "moving: error %g of %g", square, sigma);
            CHECK_MSG(fabs(bias / count) < 0.003, "bias %g", bias / count);
            CHECK_MSG(q.frames > 12.0, "worth %g frames", q.frames);
        } else if (variant == 1) {
            CHECK_MSG(square > 0.06, "smoothing blurs a moving picture, but the error is only %g", square);
        } else {
            CHECK_MSG(square < 0.07, "trail of two pixels: error %g", square);
        }
        zbufrand_accumulator_destroy(a);
    }
}

TEST(what_comes_into_view_is_new) { /* a front wall moves away: no trace of it on what was behind */
    enum { W = 80, H = 16, N = W * H };
    static float frame[4 * N], out[4 * N], depth[N];
    test_rng r = test_rng_make(10);
    zbufrand_accumulator_desc d = defaults(W, H, ZBUFRAND_ACCUMULATE_ADAPTIVE);
    zbufrand_accumulator *a = NULL;
    double ghost = 0.0;
    int n, i;
    CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
    REQUIRE(a != NULL);
    for (n = 0; n < 20; n++) { /* white wall at depth 2 for x < edge, black one at 20; sky on the right */
        double eye = 0.05 * n;
        zbufrand_view v = looking(eye, 0, 0, 0, W, H);
        for (i = 0; i < N; i++) {
            double px = ((i % W) + 0.5 - v.center_x) / v.focal;
            int front = eye + 2.0 * px < 0.3, sky = !front && eye + 20.0 * px > 6.0;
            depth[i] = front ? 2.0f : sky ? INF_F : 20.0f;
            frame[4 * i] = frame[4 * i + 1] = frame[4 * i + 2] = (front ? 1.0f : 0.0f) + 0.02f * test_rng_float(&r);
            frame[4 * i + 3] = 1.0f;
        }
        CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
        for (i = 0; i < N; i++) {
            if (i % W > 0 && i % W + 1 < W && depth[i] > 3.0f && depth[i - 1] > 3.0f) ghost = fmax(ghost, (double)out[4 * i]);
        }
    }
    CHECK_MSG(ghost < 0.1, "the front wall is left with %g", ghost);
    zbufrand_accumulator_destroy(a);
}

/* ---- robustness -------------------------------------------------------------------------------------------------- */

TEST(bad_pixels_are_left_out) {
    enum { W = 8, H = 4, N = W * H };
    static float frame[4 * N], out[4 * N], depth[N];
    int mode, n, i;
    for (mode = 0; mode < 3; mode++) {
        test_rng r = test_rng_make(11);
        zbufrand_accumulator_desc d = defaults(W, H, (zbufrand_accumulation)mode);
        zbufrand_accumulator *a = NULL;
        zbufrand_noise q;
        CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
        if (a == NULL) return;
        for (n = 0; n < 12; n++) {
            zbufrand_view v = looking(0.1 * (n / 4), 0, 0, 0, W, H);
            for (i = 0; i < 4 * N; i++) frame[i] = test_rng_float(&r);
            for (i = 0; i < N; i++) depth[i] = i % 3 == 0 ? INF_F : i % 3 == 1 ? 1.0f : 0.0f;
            frame[4 * (n % N)] = (float)NAN;
            frame[4 * ((n + 9) % N) + 3] = INF_F;
            frame[4 * ((n + 11) % N) + 1] = n & 1 ? 3e38f : -3e38f; /* finite, but their difference is not */
            depth[(n + 5) % N] = (float)NAN;
            depth[(n + 6) % N] = -1.0f;
            CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
            for (i = 0; i < 4 * N; i++) if (!(out[i] >= 0.0f && out[i] <= 1.0f)) break;
            CHECK_MSG(i == 4 * N, "mode %d frame %d: %g", mode, n, (double)out[i < 4 * N ? i : 0]);
            CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.01, &q), ZBUFRAND_OK);
            CHECK(q.rmse >= 0.0 && q.frames >= 0.0 && q.more_frames >= 0.0);
        }
        zbufrand_accumulator_destroy(a);
    }
}

TEST(nothing_overflows) { /* colours without the alpha that belongs to them, made as bright as floats go */
    static const float pixel[4][4] = {{1e15f, -1e15f, 0, 1e-45f}, {1e15f, 1, 0, 0}, {0, 0, 0, 1e-45f}, {1e-3f, 0.5f, 0.25f, 0.5f}};
    static const float want[4] = {2e-3f, 1, 0.5f, 1};
    zbufrand_accumulator_desc d = defaults(2, 2, ZBUFRAND_ACCUMULATE_MEAN);
    zbufrand_accumulator *a = NULL;
    float out[4][4], contrast;
    int i;
    CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
    REQUIRE(a != NULL);
    CHECK_EQ_U64(zbufrand_accumulator_add(a, pixel[0], NULL, NULL), ZBUFRAND_OK);
    for (contrast = -1; contrast < 2e38f; contrast = contrast < 0 ? 2 : contrast * 1e19f) {
        CHECK_EQ_U64(zbufrand_accumulator_get(a, contrast, out[0]), ZBUFRAND_OK);
        for (i = 0; i < 16; i++) {
            const double x = (double)out[i / 4][i % 4];
            CHECK_MSG(fabs(x) < 2e38, "contrast %g: number %d is %g", (double)contrast, i, x);
        }
        CHECK(memcmp(out[3], want, sizeof want) == 0);
    }
    zbufrand_accumulator_destroy(a);
}

TEST(same_bits) {
    enum { W = 70, H = 45, N = W * H };
    static float frame[4 * N], out[4 * N], depth[N];
    uint64_t all = 0;
    int mode;
    for (mode = 0; mode < 3; mode++) {
        uint32_t t;
        uint64_t first = 0;
        for (t = 1; t <= 8; t *= 2) {
            test_rng r = test_rng_make(12);
            zbufrand_accumulator_desc d = defaults(W, H, (zbufrand_accumulation)mode);
            zbufrand_accumulator *a = NULL;
            zbufrand_noise q;
            uint64_t hash;
            int n, i;
            d.env.thread_count = t;
            d.blur = 3.0f;
            CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
            if (a == NULL) return;
            for (n = 0; n < 10; n++) {
                zbufrand_view v = looking(0.02 * n, 0, 0, 0, W, H); /* no libm here */
                v.world_to_camera[0][1] = 0.001 * (n / 3);
                for (i = 0; i < 4 * N; i++) frame[i] = test_rng_float(&r);
                for (i = 0; i < N; i++) depth[i] = i % W < 30 ? 2.0f + (float)test_rng_below(&r, 40) / 4096.0f : INF_F;
                CHECK_EQ_U64(zbufrand_accumulator_add(a, frame, depth, &v), ZBUFRAND_OK);
            }
            CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, out), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_accumulator_noise(a, 0.0, &q), ZBUFRAND_OK);
            memcpy(&hash, &q.rmse, sizeof hash);
            hash = hash_words(out, 4 * N, hash);
            if (t == 1) {
                first = hash;
                all = (all ^ hash) * 0x100000001b3u;
            }
            CHECK_EQ_U64(hash, first);
            zbufrand_accumulator_destroy(a);
        }
    }
    CHECK_EQ_U64(all, 0xe9dd3e79a15e28d7u); /* the same on every machine */
}

TEST(errors) {
    zbufrand_accumulator_desc d = defaults(4, 4, ZBUFRAND_ACCUMULATE_MEAN), e;
    zbufrand_accumulator *a = NULL;
    zbufrand_noise q;
    zbufrand_view v = looking(0, 0, 0, 0, 4, 4);
    float rgba[64], depth[16];
    int64_t k;
    memset(rgba, 0, sizeof rgba);
    memset(depth, 0, sizeof depth);
    CHECK_EQ_U64(zbufrand_accumulator_create(NULL, &a), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_create(&d, NULL), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e._end_zero = 1;
    CHECK_EQ_U64(zbufrand_accumulator_create(&e, &a), ZBUFRAND_ERR_UNINIT_DESC);
    e = d; e.width = 0;
    CHECK_EQ_U64(zbufrand_accumulator_create(&e, &a), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.height = 70000;
    CHECK_EQ_U64(zbufrand_accumulator_create(&e, &a), ZBUFRAND_ERR_RANGE);
    e = d; e.epsilon = 1.5f;
    CHECK_EQ_U64(zbufrand_accumulator_create(&e, &a), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.blur = (float)NAN;
    CHECK_EQ_U64(zbufrand_accumulator_create(&e, &a), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.mode = (zbufrand_accumulation)3;
    CHECK_EQ_U64(zbufrand_accumulator_create(&e, &a), ZBUFRAND_ERR_INVALID_ARG);
    CHECK(a == NULL);
    e = d; e.mode = ZBUFRAND_ACCUMULATE_ADAPTIVE;
    CHECK_EQ_U64(zbufrand_accumulator_create(&e, &a), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_accumulator_add(a, rgba, NULL, &v), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_add(a, rgba, depth, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_add(a, NULL, depth, &v), ZBUFRAND_ERR_INVALID_ARG);
    v.focal = (double)NAN;
    CHECK_EQ_U64(zbufrand_accumulator_add(a, rgba, depth, &v), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_noise(a, -1.0, &q), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_noise(NULL, 0.0, &q), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_get(a, (float)NAN, rgba), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_get(a, 0.0f, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_accumulator_get(a, -1.0f, rgba), ZBUFRAND_OK); /* no frame yet: black */
    CHECK(rgba[0] == 0.0f && rgba[3] == 0.0f);
    zbufrand_accumulator_destroy(a);
    zbufrand_accumulator_destroy(NULL);
    zbufrand_accumulator_clear(NULL);
    for (k = 0;; k++) { /* memory */
        test_alloc ta;
        zbufrand_result r;
        test_alloc_init(&ta);
        ta.fail_at = k;
        e.env.allocator.alloc_fn = test_alloc_fn;
        e.env.allocator.free_fn = test_free_fn;
        e.env.allocator.user = &ta;
        r = zbufrand_accumulator_create(&e, &a);
        CHECK((r == ZBUFRAND_OK) == (a != NULL));
        CHECK((r == ZBUFRAND_ERR_NO_MEMORY) == (ta.failed != 0));
        zbufrand_accumulator_destroy(a);
        test_alloc_check(&ta);
        if (ta.failed == 0) break;
    }
}

TEST(nothing_stays_nothing) { /* however bright it is made */
    static const float pixel[2][4] = {{0, 0, 0, 0}, {0.25f, 0.25f, 0.25f, 0.5f}};
    static const float want[2][4] = {{0, 0, 0, 0}, {0.5f, 0.5f, 0.5f, 1}};
    static const float contrast[4] = {2, 1e30f, INFINITY, -1};
    zbufrand_accumulator_desc d = defaults(2, 1, ZBUFRAND_ACCUMULATE_MEAN);
    zbufrand_accumulator *a = NULL;
    float out[2][4];
    int i;
    CHECK_EQ_U64(zbufrand_accumulator_create(&d, &a), ZBUFRAND_OK);
    REQUIRE(a != NULL);
    CHECK_EQ_U64(zbufrand_accumulator_add(a, pixel[0], NULL, NULL), ZBUFRAND_OK);
    for (i = 0; i < 4; i++) {
        CHECK_EQ_U64(zbufrand_accumulator_get(a, contrast[i], out[0]), ZBUFRAND_OK);
        CHECK_MSG(memcmp(out, want, sizeof want) == 0, "contrast %g", (double)contrast[i]);
    }
    zbufrand_accumulator_destroy(a);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(mean_and_its_noise);
    RUN(smoothing_and_its_noise);
    RUN(sparse_frames_and_contrast);
    RUN(still_pictures_converge);
    RUN(cuts_leave_no_ghosts);
    RUN(equal_frames_stay_equal);
    RUN(history_follows_the_camera);
    RUN(what_comes_into_view_is_new);
    RUN(bad_pixels_are_left_out);
    RUN(nothing_overflows);
    RUN(nothing_stays_nothing);
    RUN(same_bits);
    RUN(errors);
    return test_end();
}
