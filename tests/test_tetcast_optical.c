/* test_tetcast_optical.c - models: emission, absorption, maximum, depth cueing, isosurfaces; error bounds */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "transfer_oracle.h"
#include "../examples/support/volume_look.h"

static tetcast_optics_desc desc_of(tetcast_model model) {
    tetcast_optics_desc d;
    memset(&d, 0, sizeof d);
    d.model = model;
    d.t_min = -1.0f;
    return d;
}

/* A ray of n segments whose values wander about. */
static void optical_random_ray(test_rng *r, tetcast_segment *s, int n, float longest) {
    float v = test_rng_float(r), depth = 0.0f;
    int i;
    for (i = 0; i < n; i++) {
        s[i].front = v;
        if (test_rng_below(r, 8) != 0) v += 0.3f * (test_rng_float(r) - 0.5f);
        v = v < 0.0f ? -v : v;
        v = v > 1.0f ? 2.0f - v : v;
        s[i].back = v;
        s[i].length = longest * test_rng_float(r);
        s[i].depth = depth;
        depth += s[i].length;
    }
}

static const tetcast_control_point *pick(int k, size_t *n) {
    *n = k == 0 ? ORACLE_SMOOTH : ORACLE_STEPS;
    return k == 0 ? oracle_smooth : oracle_steps;
}

/* ---- order-independent models ---- */

TEST(emission) { /* against the midpoint rule; continuous for equal ends; any order */
    test_rng r = test_rng_make(1);
    int k, independent, rep, i, c, j;
    for (k = 0; k < 2; k++) {
        for (independent = 0; independent < 2; independent++) {
            size_t n;
            const tetcast_control_point *p = pick(k, &n);
            tetcast_optics_desc d = desc_of(TETCAST_MODEL_EMISSION);
            tetcast_optics *o = oracle_optics(p, n, independent, NULL, 0, &d);
            for (rep = 0; rep < 30; rep++) {
                tetcast_segment s[20];
                float got[4], other[4];
                double want[3] = {0.0, 0.0, 0.0};
                optical_random_ray(&r, s, 20, 0.3f);
                CHECK(tetcast_optics_ray(o, s, 20, got, NULL) == TETCAST_OK);
                for (i = 0; i < 20; i++) {
                    for (j = 0; j < 2000; j++) {
                        double v[4];
                        oracle_eval(p, n, (double)s[i].front + ((double)s[i].back - (double)s[i].front) * (j +
                            0.5) / 2000, 1, v);
                        for (c = 0; c < 3; c++) want[c] += v[c] * (independent ? 1.0
                                                                   : v[3]) * (double)s[i].length / 2000;
                    }
                }
                for (c = 0; c < 3; c++) CHECK_NEAR((double)got[c], want[c], (k ? 3e-3 : 2e-5) * (1.0 + want[c]));
                CHECK(got[3] == 0.0f);
                for (i = 19; i > 0; i--) {
                    const int with = (int)test_rng_below(&r, (uint32_t)i + 1);
                    const tetcast_segment x = s[i];
                    s[i] = s[with];
                    s[with] = x;
                }
                (void)tetcast_optics_ray(o, s, 20, other, NULL);
                for (c = 0; c < 3; c++) CHECK_NEAR((double)got[c], (double)other[c], 1e-6 * (1.0 + want[c]));
            }
            { /* s_back -> s_front */
                tetcast_segment s;
                float a[4], b[4], step;
                s.front = s.back = 0.42f;
                s.length = 1.0f;
                s.depth = 0.0f;
                (void)tetcast_optics_ray(o, &s, 1, a, NULL);
                for (step = 1e-3f; step > 1e-8f; step *= 0.1f) {
                    s.back = 0.42f + step;
                    (void)tetcast_optics_ray(o, &s, 1, b, NULL);
                    for (c = 0; c < 3; c++) CHECK_NEAR((double)a[c], (double)b[c], 1e-6 + 10.0 * (double)step);
                }
            }
            tetcast_optics_destroy(o);
        }
    }
}

TEST(absorption) {
    test_rng r = test_rng_make(2);
    int k, rep, i, c;
    for (k = 0; k < 2; k++) {
        size_t n;
        const tetcast_control_point *p = pick(k, &n);
        tetcast_optics_desc d = desc_of(TETCAST_MODEL_ABSORPTION);
        tetcast_optics *o = oracle_optics(p, n, 0, NULL, 0, &d);
        for (rep = 0; rep < 200; rep++) {
            tetcast_segment s[50];
            float got[4], other[4];
            double t = 1.0;
            optical_random_ray(&r, s, 50, 0.05f);
            CHECK(tetcast_optics_ray(o, s, 50, got, NULL) == TETCAST_OK);
            for (i = 0; i < 50; i++) {
                double e[4];
                oracle_segment(p, n, 0, &s[i], e);
                t *= 1.0 - e[3];
            }
            CHECK_NEAR((double)got[3], 1.0 - t, 1e-6);
            for (c = 0; c < 3; c++) CHECK(got[c] == 0.0f);
            for (i = 0; i < 25; i++) {
                const tetcast_segment x = s[i];
                s[i] = s[49 - i];
                s[49 - i] = x;
            }
            (void)tetcast_optics_ray(o, s, 50, other, NULL);
            CHECK_NEAR((double)got[3], (double)other[3], 1e-6);
        }
        tetcast_optics_destroy(o);
    }
}

TEST(maximum) { /* ends, knots and the tops of products of two ramps, against many samples */
    test_rng r = test_rng_make(3);
    int k, independent, rep, i, c, j;
    for (k = 0; k < 2; k++) {
        for (independent = 0; independent < 2; independent++) {
            size_t n;
            const tetcast_control_point *p = pick(k, &n);
            tetcast_optics_desc d = desc_of(TETCAST_MODEL_MAXIMUM);
            tetcast_optics *o = oracle_optics(p, n, independent, NULL, 0, &d);
            double scale = 0.0;
            for (j = 0; j <= 100000; j++) {
                double v[4];
                oracle_eval(p, n, j / 100000.0, 1, v);
                for (c = 0; c < 3; c++) scale = fmax(scale, v[c] * (independent ? 1.0 : v[3]));
            }
            for (rep = 0; rep < 30; rep++) {
                tetcast_segment s[6], none;
                float got[4], other[4];
                double want[3] = {0.0, 0.0, 0.0};
                optical_random_ray(&r, s, 6, 1.0f);
                CHECK(tetcast_optics_ray(o, s, 6, got, NULL) == TETCAST_OK);
                for (i = 0; i < 6; i++) {
                    for (j = 0; j <= 5000; j++) {
                        double v[4];
                        oracle_eval(p, n, (double)s[i].front + ((double)s[i].back - (double)s[i].front) * j / 5000, 1,
                                    v);
                        for (c = 0; c < 3; c++) want[c] = fmax(want[c], v[c] * (independent ? 1.0 : v[3]) / scale);
                    }
                }
                for (c = 0; c < 3; c++) CHECK_NEAR((double)got[c], want[c], 1e-3);
                for (c = 0; c < 3; c++) CHECK((double)got[c] >= want[c] - 1e-5 && got[c] <= 1.00001f);
                none = s[0]; /* nothing of no length */
                none.front = none.back = 0.7f;
                none.length = 0.0f;
                s[0] = s[5];
                (void)tetcast_optics_ray(o, s, 6, got, NULL);
                s[0] = none;
                (void)tetcast_optics_ray(o, s, 6, other, NULL);
                for (c = 0; c < 3; c++) CHECK(got[c] >= other[c]);
            }
            tetcast_optics_destroy(o);
        }
    }
}

/* ---- depth cueing ---- */

TEST(depth_cue) {
    static const tetcast_model models[4] = {TETCAST_MODEL_VOLUME, TETCAST_MODEL_EMISSION, TETCAST_MODEL_MAXIMUM,
                                            TETCAST_MODEL_ABSORPTION};
    test_rng r = test_rng_make(4);
    int k, i, c;
    for (k = 0; k < 4; k++) {
        tetcast_optics_desc d = desc_of(models[k]);
        tetcast_optics *plain = oracle_optics(oracle_smooth, ORACLE_SMOOTH, 0, NULL, 0, &d), *same, *cue;
        d.cue = 1;
        d.cue_depth[0] = 1.0f;
        d.cue_depth[1] = 3.0f;
        d.cue_scale[0] = d.cue_scale[1] = 1.0f;
        same = oracle_optics(oracle_smooth, ORACLE_SMOOTH, 0, NULL, 0, &d);
        d.cue_scale[1] = 0.25f;
        if (models[k] == TETCAST_MODEL_VOLUME) d.fog[1] = 0.5f;
        cue = oracle_optics(oracle_smooth, ORACLE_SMOOTH, 0, NULL, 0, &d);
        for (i = 0; i < 500; i++) {
            tetcast_segment s;
            float a[4], b[4], x[4];
            double factor;
            s.front = test_rng_float(&r);
            s.back = test_rng_float(&r);
            s.length = 0.5f * test_rng_float(&r);
            s.depth = 4.0f * test_rng_float(&r);
            (void)tetcast_optics_ray(plain, &s, 1, a, NULL);
            (void)tetcast_optics_ray(same, &s, 1, b, NULL);
            (void)tetcast_optics_ray(cue, &s, 1, x, NULL);
            factor = 1.0 - 0.75 * ((double)s.depth + 0.5 * (double)s.length - 1.0) / 2.0;
            factor = fmin(1.0, fmax(0.25, factor));
            for (c = 0; c < 4; c++) CHECK_NEAR((double)a[c], (double)b[c], 1e-6);
            for (c = 0; c < 3; c++) {
                const double fog = models[k] == TETCAST_MODEL_VOLUME
                    ? (1.0 - factor) * (double)d.fog[c] * (double)a[3] : 0.0;
                CHECK_NEAR((double)x[c], factor * (double)a[c] + fog, 1e-6 * (1.0 + (double)a[c]));
            }
            if (models[k] == TETCAST_MODEL_VOLUME || models[k] == TETCAST_MODEL_ABSORPTION) CHECK_NEAR((double)x[3],
                (double)a[3], 1e-6);
        }
        tetcast_optics_destroy(plain);
        tetcast_optics_destroy(same);
        tetcast_optics_destroy(cue);
    }
    { /* the other integrators see the same fog */
        int which;
        for (which = 1; which < (int)TETCAST_INTEGRATOR_COUNT; which++) {
            tetcast_control_point flat[1];
            tetcast_optics_desc d = desc_of(TETCAST_MODEL_VOLUME);
            tetcast_optics *o;
            tetcast_segment s;
            float x[4];
            memset(flat, 0, sizeof flat);
            flat[0].rgb[0] = 1.0f;
            flat[0].extinction = 0.1f;
            d.integrator = (tetcast_integrator)which;
            d.longest = 1.0f;
            d.step = 0.25f;
            d.table_values = 16;
            d.table_lengths = 64;
            d.cue = 1;
            d.cue_depth[1] = 1.0f;
            d.cue_scale[0] = d.cue_scale[1] = 0.5f;
            d.fog[2] = 1.0f;
            o = oracle_optics(flat, 1, 0, NULL, 0, &d);
            s.front = 0.3f;
            s.back = 0.4f;
            s.length = 0.5f;
            s.depth = 0.3f;
            (void)tetcast_optics_ray(o, &s, 1, x, NULL);
            CHECK_NEAR((double)x[3], 1.0 - exp(-0.05), 1e-3);
            CHECK_NEAR((double)x[0], 0.5 * (double)x[3], 2e-3);
            CHECK_NEAR((double)x[2], 0.5 * (double)x[3], 2e-3);
            tetcast_optics_destroy(o);
        }
    }
}

/* ---- isosurfaces ---- */

static tetcast_isovalue iso_of(float value, float red, float green, float opacity) {
    tetcast_isovalue v;
    memset(&v, 0, sizeof v);
    v.value = value;
    v.rgb[0] = red;
    v.rgb[1] = green;
    v.opacity = opacity;
    return v;
}

TEST(hits_of_a_ray) { /* continuous values crossing v: one hit per crossing, one per touch, none on a plateau */
    tetcast_isovalue iso[2];
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_ISOSURFACE);
    tetcast_optics *o;
    static const struct { float v[6]; int n; uint32_t hits; } rays[] = {
        {{0.0f, 1.0f}, 2, 1},                         /* through */
        {{1.0f, 0.0f}, 2, 1},
        {{0.0f, 0.5f, 1.0f}, 3, 1},                   /* through a vertex of that value */
        {{1.0f, 0.5f, 0.0f}, 3, 1},
        {{0.0f, 0.5f, 0.0f}, 3, 1},                   /* touching from below and from above */
        {{1.0f, 0.5f, 1.0f}, 3, 1},
        {{0.0f, 0.5f, 0.5f, 1.0f}, 4, 1},             /* a plateau on the way */
        {{0.0f, 0.5f, 0.5f, 0.5f, 0.5f, 0.0f}, 6, 1},
        {{0.5f, 0.5f, 0.5f}, 3, 0},                   /* only a plateau */
        {{0.5f, 1.0f}, 2, 0},                         /* starting on it */
        {{0.0f, 0.4f, 0.45f}, 3, 0},
        {{0.0f, 1.0f, 0.0f, 1.0f}, 4, 3}};
    size_t k;
    iso[0] = iso_of(0.5f, 1.0f, 0.0f, 0.25f);
    o = oracle_optics(NULL, 0, 0, iso, 1, &d);
    REQUIRE(o != NULL && o->iso_count == 1);
    for (k = 0; k < sizeof rays / sizeof rays[0]; k++) {
        uint32_t hits = 0, first, lanes;
        float rgba[4];
        tetcast_segment s[6];
        tetcasti_seg8 seg;
        int i, j;
        memset(&seg, 0, sizeof seg);
        for (i = 0; i + 1 < rays[k].n; i++) {
            const uint32_t n = tetcasti_iso_hits(o, rays[k].v[i], rays[k].v[i + 1], &first);
            hits += n;
            if (n != 0) CHECK(first == 0);
            s[i].front = rays[k].v[i];
            s[i].back = rays[k].v[i + 1];
            s[i].length = 1.0f;
            s[i].depth = (float)i;
            for (j = 0; j < 8; j++) {
                seg.front[j] = s[i].front;
                seg.back[j] = s[i].back;
            }
            lanes = tetcasti_iso_lanes(o, &seg, 0xa5u);
            CHECK_EQ_U64(lanes, n != 0 ? 0xa5u : 0u);
        }
        CHECK_MSG(hits == rays[k].hits, "ray %d: %u hits instead of %u", (int)k, hits, rays[k].hits);
        CHECK(tetcast_optics_ray(o, s, (size_t)rays[k].n - 1, rgba, NULL) == TETCAST_OK);
        CHECK_NEAR((double)rgba[3], 1.0 - pow(0.75, (double)hits), 1e-6);
        CHECK_NEAR((double)rgba[0], (double)rgba[3], 1e-6);
    }
    tetcast_optics_destroy(o);
}

TEST(several_isovalues_in_order) { /* given unsorted; both directions; materials of their own */
    tetcast_isovalue iso[9];
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_ISOSURFACE);
    tetcast_optics *o;
    test_rng r = test_rng_make(5);
    int i, rep, c;
    for (i = 0; i < 9; i++) iso[i] = iso_of((float)((i * 4) % 9) * 0.1f + 0.1f, (float)i / 8.0f,
                                            1.0f - (float)i / 8.0f, 0.1f * (float)i);
    o = oracle_optics(NULL, 0, 0, iso, 9, &d);
    REQUIRE(o != NULL && o->iso_count == 9);
    for (rep = 0; rep < 2000; rep++) {
        tetcast_segment s;
        float got[4];
        double want[3] = {0.0, 0.0, 0.0}, t = 1.0;
        uint32_t step;
        s.front = test_rng_below(&r, 3) == 0 ? 0.1f * (float)test_rng_below(&r, 11) : test_rng_float(&r);
        s.back = test_rng_below(&r, 3) == 0 ? 0.1f * (float)test_rng_below(&r, 11) : test_rng_float(&r);
        s.length = 1.0f;
        s.depth = 0.0f;
        CHECK(tetcast_optics_ray(o, &s, 1, got, NULL) == TETCAST_OK);
        for (step = 0; step < 9; step++) { /* from the lowest up, or from the highest down */
            float v = 0.0f;
            int at = -1, j;
            for (j = 0; j < 9; j++) { /* the step-th smallest */
                int below = 0, m;
                for (m = 0; m < 9; m++) below += iso[m].value < iso[j].value;
                if (below == (s.back > s.front ? (int)step : 8 - (int)step)) at = j;
            }
            REQUIRE(at >= 0);
            v = iso[at].value;
            if (!((s.front < v && v <= s.back) || (s.front > v && v >= s.back))) continue;
            for (c = 0; c < 3; c++) want[c] += t * (double)iso[at].opacity * (double)iso[at].rgb[c];
            t *= 1.0 - (double)iso[at].opacity;
        }
        for (c = 0; c < 3; c++) CHECK_NEAR((double)got[c], want[c], 1e-6);
        CHECK_NEAR((double)got[3], 1.0 - t, 1e-6);
    }
    tetcast_optics_destroy(o);
}

TEST(mixed) { /* translucent surfaces inside a volume, in the right order */
    tetcast_isovalue iso[2];
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_MIXED);
    tetcast_optics *o;
    test_rng r = test_rng_make(6);
    int rep, c, k;
    iso[0] = iso_of(0.6f, 1.0f, 0.2f, 0.5f);
    iso[1] = iso_of(0.25f, 0.1f, 1.0f, 0.3f);
    for (k = 0; k < 2; k++) {
        size_t n;
        const tetcast_control_point *p = pick(k, &n);
        o = oracle_optics(p, n, 0, iso, 2, &d);
        for (rep = 0; rep < 3000; rep++) {
            tetcast_segment s, part;
            float got[4];
            double want[3] = {0.0, 0.0, 0.0}, t = 1.0, e[4], x[4];
            int count = 0, which[2] = {0, 0}, i;
            s.front = test_rng_float(&r);
            s.back = test_rng_below(&r, 10) == 0 ? s.front : test_rng_float(&r);
            s.length = 1.5f * test_rng_float(&r);
            s.depth = 0.0f;
            CHECK(tetcast_optics_ray(o, &s, 1, got, NULL) == TETCAST_OK);
            x[0] = 0.0;
            for (i = 0; i < 2; i++) {
                const int j = s.back > s.front ? 1 - i : i; /* 0.25 first when rising */
                const float v = iso[j].value;
                if (!((s.front < v && v <= s.back) || (s.front > v && v >= s.back))) continue;
                which[count] = j;
                x[++count] = ((double)v - (double)s.front) / ((double)s.back - (double)s.front);
            }
            x[count + 1] = 1.0;
            for (i = 0; i <= count; i++) {
                part.front = (float)((double)s.front + x[i] * ((double)s.back - (double)s.front));
                part.back = (float)((double)s.front + x[i + 1] * ((double)s.back - (double)s.front));
                part.length = (float)((double)s.length * (x[i + 1] - x[i]));
                part.depth = 0.0f;
                oracle_segment(p, n, 0, &part, e);
                for (c = 0; c < 3; c++) want[c] += t * e[c];
                t *= 1.0 - e[3];
                if (i == count) break;
                for (c = 0; c < 3; c++) want[c] += t * (double)iso[which[i]].opacity * (double)iso[which[i]].rgb[c];
                t *= 1.0 - (double)iso[which[i]].opacity;
            }
            for (c = 0; c < 3; c++) CHECK_NEAR((double)got[c], want[c], 1e-5);
            CHECK_NEAR((double)got[3], 1.0 - t, 1e-5);
        }
        tetcast_optics_destroy(o);
    }
}

typedef struct shade_user { float gradient[3], fraction; int calls; } shade_user;
static void shade_normal(void *user, float fraction, float normal[3]) {
    shade_user *u = (shade_user *)user;
    memcpy(normal, u->gradient, sizeof u->gradient);
    u->fraction = fraction;
    u->calls++;
}

TEST(shading) { /* ambient, diffuse and highlight of two lights; both sides; no gradient; bounded */
    tetcast_isovalue iso[1];
    tetcast_light light[2];
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_ISOSURFACE);
    tetcast_optics *o;
    shade_user u;
    const float view[3] = {0.0f, 0.0f, 1.0f};
    int side, c, i;
    test_rng r = test_rng_make(7);
    iso[0] = iso_of(0.5f, 0.8f, 0.4f, 1.0f);
    iso[0].specular = 0.5f;
    iso[0].shininess = 10.0f;
    memset(light, 0, sizeof light);
    light[0].direction[2] = -2.0f;
    light[0].rgb[0] = light[0].rgb[1] = light[0].rgb[2] = 1.0f;
    light[1].direction[0] = 1.0f;
    light[1].direction[2] = -1.0f;
    light[1].rgb[1] = 0.5f;
    d.lights = light;
    d.light_count = 2;
    d.ambient[0] = d.ambient[1] = d.ambient[2] = 0.1f;
    o = oracle_optics(NULL, 0, 0, iso, 1, &d);
    for (i = 0; i < 200; i++) {
        tetcasti_ray_sum sum;
        double n[3], want[3], len = 0.0;
        for (c = 0; c < 3; c++) {
            n[c] = 2.0 * test_rng_double(&r) - 1.0;
            len += n[c] * n[c];
        }
        len = sqrt(len);
        for (side = 0; side < 2; side++) {
            const double l[2][3] = {{0.0, 0.0, -1.0}, {sqrt(0.5), 0.0, -sqrt(0.5)}};
            float rgba[4];
            int k;
            for (c = 0; c < 3; c++) u.gradient[c] = (float)(n[c] * (side ? -37.0 : 1.0));
            u.calls = 0;
            tetcasti_ray_begin(o, &sum);
            tetcasti_segment_iso(o, 0.2f, 0.7f, 2.0f, 0.0f, shade_normal, &u, view, &sum);
            tetcasti_ray_finish(o, &sum, rgba);
            CHECK(u.calls == 1);
            CHECK_NEAR((double)u.fraction, 0.6, 1e-6);
            for (c = 0; c < 3; c++) want[c] = 0.1 * (double)iso[0].rgb[c];
            for (k = 0; k < 2; k++) {
                const double flip = n[2] > 0.0 ? -1.0 / len : 1.0 / len;
                double h[3], hl = 0.0, dot = 0.0, nh = 0.0;
                for (c = 0; c < 3; c++) {
                    dot += flip * n[c] * l[k][c];
                    h[c] = l[k][c] - (double)view[c];
                    hl += h[c] * h[c];
                }
                for (c = 0; c < 3; c++) nh += flip * n[c] * h[c] / sqrt(hl);
                if (dot <= 0.0) continue;
                for (c = 0; c < 3; c++) {
                    want[c] += (double)light[k].rgb[c] * ((double)iso[0].rgb[c] * dot +
                                                          0.5 * (nh > 0.0 ? pow(nh, 10.0) : 0.0));
                }
            }
            for (c = 0; c < 3; c++) CHECK_NEAR((double)rgba[c], want[c], 1e-5);
            CHECK(rgba[3] == 1.0f);
        }
    }
    { /* no gradient: seen from the front */
        tetcasti_ray_sum sum;
        float rgba[4];
        memset(u.gradient, 0, sizeof u.gradient);
        tetcasti_ray_begin(o, &sum);
        tetcasti_segment_iso(o, 0.2f, 0.7f, 2.0f, 0.0f, shade_normal, &u, view, &sum);
        tetcasti_ray_finish(o, &sum, rgba);
        CHECK(rgba[0] > 0.8f && rgba[0] < 10.0f);
        u.gradient[0] = NAN;
        tetcasti_ray_begin(o, &sum);
        tetcasti_segment_iso(o, 0.2f, 0.7f, 2.0f, 0.0f, shade_normal, &u, view, &sum);
        tetcasti_ray_finish(o, &sum, rgba);
        CHECK(rgba[0] > 0.8f && rgba[0] < 10.0f);
    }
    tetcast_optics_destroy(o);
}

TEST(opaque_surface_ends_the_ray) {
    tetcast_isovalue iso[1];
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_MIXED);
    tetcast_optics *o;
    tetcast_segment s[3];
    float a[4], b[4];
    size_t used;
    int i;
    iso[0] = iso_of(0.5f, 1.0f, 1.0f, 1.0f);
    d.t_min = 0.0f;
    o = oracle_optics(oracle_smooth, ORACLE_SMOOTH, 0, iso, 1, &d);
    for (i = 0; i < 3; i++) {
        s[i].front = 0.3f * (float)i;
        s[i].back = 0.3f * (float)(i + 1);
        s[i].length = 0.1f;
        s[i].depth = 0.1f * (float)i;
    }
    CHECK(tetcast_optics_ray(o, s, 3, a, &used) == TETCAST_OK);
    CHECK(used == 2 && a[3] == 1.0f);
    CHECK(tetcast_optics_ray(o, s, 2, b, NULL) == TETCAST_OK);
    CHECK(memcmp(a, b, sizeof a) == 0);
    tetcast_optics_destroy(o);
}

TEST(surfaces_by_lane) { /* a lane of eight gives the bits of the single ray */
    tetcast_isovalue iso[2];
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_MIXED);
    tetcast_optics *o;
    test_rng r = test_rng_make(8);
    const float view[3] = {0.6f, 0.0f, 0.8f};
    int rep, step;
    uint32_t k;
    iso[0] = iso_of(0.6f, 1.0f, 0.2f, 0.5f);
    iso[1] = iso_of(0.25f, 0.1f, 1.0f, 0.3f);
    o = oracle_optics(oracle_smooth, ORACLE_SMOOTH, 0, iso, 2, &d);
    for (rep = 0; rep < 100; rep++) {
        tetcasti_ray_sum one[8];
        tetcasti_ray_sum8 sum;
        shade_user u;
        u.gradient[0] = 0.5f;
        u.gradient[1] = 1.0f;
        u.gradient[2] = -0.2f;
        for (k = 0; k < 8; k++) {
            tetcasti_ray_begin(o, &one[k]);
            tetcasti_lane_begin(o, &sum, k);
        }
        for (step = 0; step < 20; step++) {
            tetcasti_seg8 seg;
            uint32_t hit;
            for (k = 0; k < 8; k++) {
                seg.front[k] = test_rng_float(&r);
                seg.back[k] = seg.front[k] + 0.2f * (test_rng_float(&r) - 0.5f);
                seg.length[k] = 0.1f * test_rng_float(&r);
                seg.depth[k] = 0.0f;
                tetcasti_segment_iso(o, seg.front[k], seg.back[k], seg.length[k], 0.0f, shade_normal, &u, view,
                                     &one[k]);
            }
            hit = tetcasti_iso_lanes(o, &seg, 255);
            (void)o->segment8(o, &seg, 255 & ~hit, &sum);
            for (k = 0; k < 8; k++) {
                if (hit >> k & 1u) tetcasti_lane_segment_iso(o, k, &seg, shade_normal, &u, view, &sum);
            }
        }
        for (k = 0; k < 8; k++) {
            float a[4], b[4];
            tetcasti_ray_finish(o, &one[k], a);
            tetcasti_lane_finish(o, &sum, k, b);
            CHECK(memcmp(a, b, sizeof a) == 0);
        }
    }
    tetcast_optics_destroy(o);
}

TEST(lanes_that_are_off) { /* nothing is added to them, and nothing else in the others, wherever 0 lies among the knots */
    static tetcast_control_point p[40];
    static const int counts[3] = {4, 12, 40}, models[4] = {TETCAST_MODEL_VOLUME, TETCAST_MODEL_EMISSION, TETCAST_MODEL_ABSORPTION,
                                                           TETCAST_MODEL_MAXIMUM};
    test_rng r = test_rng_make(12);
    int m, n, independent, rep, i;
    uint32_t k, c;
    for (m = 0; m < 4; m++)
        for (n = 0; n < 3; n++)
            for (independent = 0; independent < 2; independent++) {
                tetcast_optics_desc d = desc_of((tetcast_model)models[m]);
                tetcast_optics *o;
                memset(p, 0, sizeof p);
                for (i = 0; i < counts[n]; i++) {
                    p[i].value = -1.0f + 1.5f * ((float)i + 0.8f * test_rng_float(&r)) / (float)counts[n];
                    for (c = 0; c < 3; c++) p[i].rgb[c] = test_rng_float(&r);
                    p[i].extinction = 3.0f * test_rng_float(&r);
                }
                o = oracle_optics(p, (size_t)counts[n], independent, NULL, 0, &d);
                for (rep = 0; rep < 200; rep++) {
                    const uint32_t on = 1 + test_rng_below(&r, 255);
                    tetcasti_ray_sum one[8];
                    tetcasti_ray_sum8 sum;
                    tetcasti_seg8 seg;
                    int step;
                    for (k = 0; k < 8; k++) {
                        tetcasti_ray_begin(o, &one[k]);
                        tetcasti_lane_begin(o, &sum, k);
                    }
                    for (step = 0; step < 3; step++) {
                        for (k = 0; k < 8; k++) {
                            seg.front[k] = 2.0f * test_rng_float(&r) - 1.25f;
                            seg.back[k] = 2.0f * test_rng_float(&r) - 1.25f;
                            seg.length[k] = (rep & 1 ? 3.0f : 0.1f) * test_rng_float(&r);
                            seg.depth[k] = 0.0f;
                            if (step == 1 && (on >> k & 1u) == 0) continue;
                            o->segment(o, seg.front[k], seg.back[k], seg.length[k], 0.0f, &one[k]);
                        }
                        (void)o->segment8(o, &seg, step == 1 ? on : 255u, &sum);
                    }
                    for (k = 0; k < 8; k++) {
                        float a[4], b[4];
                        tetcasti_ray_finish(o, &one[k], a);
                        tetcasti_lane_finish(o, &sum, k, b);
                        CHECK_MSG(memcmp(a, b, sizeof a) == 0, "model %d, %d knots, lanes %x, lane %u: %g %g %g %g, alone %g %g %g %g",
                                  models[m], counts[n], on, k, (double)b[0], (double)b[1], (double)b[2], (double)b[3], (double)a[0],
                                  (double)a[1], (double)a[2], (double)a[3]);
                    }
                }
                tetcast_optics_destroy(o);
            }
}

TEST(numbers_at_the_ends_of_what_is_allowed) { /* extinctions of 1e18, knots from 1e-40 to 1e30: finite, not negative, one sum */
    static const int models[4] = {TETCAST_MODEL_VOLUME, TETCAST_MODEL_EMISSION, TETCAST_MODEL_ABSORPTION, TETCAST_MODEL_MAXIMUM};
    test_rng r = test_rng_make(61);
    int rep, i;
    uint32_t k, c, large = 0;
    for (rep = 0; rep < 1600; rep++) {
        const int count = 1 + (int)test_rng_below(&r, 12);
        tetcast_optics_desc d = desc_of((tetcast_model)models[rep & 3]);
        tetcast_control_point p[12];
        tetcast_segment s[64];
        float rgba[64][4];
        tetcast_optics *o;
        memset(p, 0, sizeof p);
        memset(s, 0, sizeof s);
        for (i = 0; i < count; i++) {
            p[i].value = (float)i / 12.0f + (test_rng_below(&r, 4) ? test_rng_float(&r) / 12.0f : (float)ldexp(1.0, -(int)test_rng_below(&r, 130)));
            if (i == count - 1 && test_rng_below(&r, 3) == 0) p[i].value = 1e30f * (1.0f + test_rng_float(&r));
            if (i && p[i].value < p[i - 1].value) p[i].value = p[i - 1].value;
            if (i > 1 && p[i].value <= p[i - 2].value) p[i].value = p[i - 2].value + 0.25f;
            for (c = 0; c < 3; c++) p[i].rgb[c] = c == 1 ? (float)test_rng_below(&r, 2) : test_rng_float(&r);
            p[i].extinction = test_rng_below(&r, 5) == 0 ? 1e18f * test_rng_float(&r) : 10.0f * test_rng_float(&r);
        }
        o = oracle_optics(p, (size_t)count, rep / 4 & 1, NULL, 0, &d);
        if (o == NULL) continue;
        for (k = 0; k < 64; k++) {
            s[k].front = test_rng_below(&r, 2) ? p[test_rng_below(&r, (uint32_t)count)].value : test_rng_float(&r);
            s[k].back = test_rng_below(&r, 2) ? p[test_rng_below(&r, (uint32_t)count)].value : test_rng_float(&r);
            s[k].length = (float)ldexp((double)test_rng_float(&r), (int)test_rng_below(&r, 10) - 6);
        }
        CHECK(tetcast_optics_segments(o, s, 64, TETCAST_ISA_AUTO, rgba) == TETCAST_OK);
        for (k = 0; k < 64; k++) {
            float alone[4];
            tetcast_optics_ray(o, &s[k], 1, alone, NULL);
            for (c = 0; c < 4; c++) CHECK_MSG(isfinite(alone[c]) && alone[c] >= 0.0f, "%d %u: %g", rep, k, (double)alone[c]);
            CHECK_MSG(memcmp(alone, rgba[k], sizeof alone) == 0, "%d %u: %g %g", rep, k, (double)alone[0], (double)rgba[k][0]);
            large += alone[0] > 1e17f;
        }
        tetcast_optics_destroy(o);
    }
    CHECK(large > 100);
}

TEST(units) { /* values and lengths of any size: the picture is that of ordinary ones */
    static const int models[4] = {TETCAST_MODEL_VOLUME, TETCAST_MODEL_EMISSION, TETCAST_MODEL_ABSORPTION, TETCAST_MODEL_MAXIMUM};
    static const int units[7][2] = {{0, 0}, {-60, 0}, {-100, 0}, {-118, 0}, {60, 0}, {110, 0}, {-90, 55}}; /* values, lengths: powers of 2 */
    test_rng r = test_rng_make(62);
    int m, u, k, c, rep, independent;
    size_t n;
    for (m = 0; m < 4; m++)
        for (independent = 0; independent < 2; independent++)
            for (k = 0; k < 3; k++) {
                tetcast_segment s[20];
                float want[4] = {0, 0, 0, 0};
                tetcast_optics_desc d = desc_of((tetcast_model)models[m]);
                const tetcast_control_point *p = pick(k & 1, &n);
                optical_random_ray(&r, s, 20, 0.3f);
                for (u = 0; u < 7; u++) {
                    const float value = (float)ldexp(1, units[u][0]), length = (float)ldexp(1, units[u][1]);
                    tetcast_control_point q[40];
                    tetcast_segment x[20];
                    float rgba[20][4], alone[4], got[4];
                    size_t count = k == 2 ? 40 : n; /* knots that are not in registers */
                    tetcast_optics *o;
                    for (c = 0; c < (int)count; c++) {
                        q[c] = p[k == 2 ? (c < 38 ? c % 2 : c - 36) : c];
                        if (k == 2) q[c].value = (float)c / 39.0f;
                        q[c].value *= value;
                        q[c].extinction /= length;
                        for (rep = 0; rep < 3 && independent; rep++) q[c].rgb[rep] /= length;
                    }
                    for (c = 0; c < 20; c++) {
                        x[c] = s[c];
                        x[c].front *= value;
                        x[c].back *= value;
                        x[c].length *= length;
                    }
                    o = oracle_optics(q, count, independent, NULL, 0, &d);
                    REQUIRE(o != NULL);
                    CHECK(tetcast_optics_ray(o, x, 20, got, NULL) == TETCAST_OK);
                    if (u == 0) memcpy(want, got, sizeof want);
                    for (c = 0; c < 4; c++)
                        CHECK_MSG(fabs((double)got[c] - (double)want[c]) < 4e-6 * (1 + fabs((double)want[c])),
                                  "model %d, %d, function %d, units %d: %g is not %g",
                                  m, independent, k, u, (double)got[c], (double)want[c]);
                    CHECK(tetcast_optics_segments(o, x, 20, TETCAST_ISA_AUTO, rgba) == TETCAST_OK);
                    for (c = 0; c < 20; c++) {
                        CHECK(tetcast_optics_ray(o, &x[c], 1, alone, NULL) == TETCAST_OK);
                        CHECK_MSG(memcmp(alone, rgba[c], sizeof alone) == 0,
                                  "model %d, %d, function %d, units %d, segment %d: %g is not %g", m, independent, k, u, c,
                                  (double)rgba[c][0], (double)alone[0]);
                    }
                    tetcast_optics_destroy(o);
                }
            }
}

TEST(what_ends_a_ray) { /* is not looked at: what is behind may be anything */
    static const tetcast_control_point p[] = {{0.0f, {1, 0, 0}, 1e6f}};
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_VOLUME);
    tetcast_segment s[2];
    tetcast_optics *o;
    float rgba[4];
    size_t used = 0;
    memset(s, 0, sizeof s);
    s[0].length = 1.0f;
    s[1].front = s[1].length = NAN;
    d.t_min = 0.0f;
    o = oracle_optics(p, 1, 0, NULL, 0, &d);
    CHECK_EQ_U64(tetcast_optics_ray(o, s, 2, rgba, &used), TETCAST_OK);
    CHECK(used == 1 && rgba[0] > 0.99f);
    CHECK_EQ_U64(tetcast_optics_ray(o, s + 1, 1, rgba, &used), TETCAST_ERR_INVALID_ARG);
    tetcast_optics_destroy(o);
}

TEST(light_through_dark_fog) { /* what is left after n segments is right in all its digits, not only beside 1 */
    static const tetcast_control_point p[] = {{0.0f, {0, 0, 0}, 2.0f}, {0.5f, {0, 0, 0}, 2.0f}, {0.5f, {1, 1, 1}, 1e6f}, {1.0f, {1, 1, 1}, 1e6f}};
    tetcast_optics_desc d = desc_of(TETCAST_MODEL_VOLUME);
    tetcast_optics *o = oracle_optics(p, 4, 0, NULL, 0, &d);
    tetcast_segment s[1025];
    float rgba[4];
    int n, i;
    memset(s, 0, sizeof s);
    for (n = 1; n <= 1024; n *= 2) { /* 2 * 6.93 = 13.86 = 20 ln 2 in all */
        for (i = 0; i < n; i++) {
            s[i].front = 0.1f;
            s[i].back = 0.4f;
            s[i].length = 6.931471805599453f / (float)n;
        }
        s[n].front = s[n].back = 0.75f;
        s[n].length = 1.0f;
        tetcast_optics_ray(o, s, (size_t)n + 1, rgba, NULL);
        CHECK_MSG(fabs((double)rgba[0] * 1048576.0 - 1.0) < 4e-6 + 1.2e-7 * n, "%d: %.9g", n, (double)rgba[0] * 1048576.0);
    }
    tetcast_optics_destroy(o);
}

/* ---- error control ---- */

TEST(tolerance_holds) { /* the promised bound against the double reference, for functions of many knots */
    static tetcast_control_point p[200];
    static tetcast_segment s[300];
    test_rng r = test_rng_make(9);
    const float tolerance[4] = {0.05f, 0.5f, 1.0f, 8.0f};
    int k, rep, i, c, independent;
    for (independent = 0; independent < 2; independent++) {
        uint32_t knots = 1000;
        for (i = 0; i < 200; i++) {
            const float x = (float)i / 199.0f;
            p[i].value = x;
            p[i].rgb[0] = 0.5f + 0.5f * sinf(5.0f * x);
            p[i].rgb[1] = x * x;
            p[i].rgb[2] = 1.0f - x;
            p[i].extinction = x < 0.2f ? 0.0f : 4.0f * (x - 0.2f) * (1.1f - x) + 0.2f;
        }
        for (k = 0; k < 4; k++) {
            tetcast_optics_desc d;
            tetcast_optics_info info;
            tetcast_optics *o;
            double worst = 0.0;
            memset(&d, 0, sizeof d);
            d.tolerance = tolerance[k];
            d.path_length = 3.0f;
            o = oracle_optics(p, 200, independent, NULL, 0, &d);
            tetcast_optics_get_info(o, &info);
            CHECK(info.bound <= tolerance[k] && info.bound > 0.0f);
            CHECK(info.knot_count <= knots);
            knots = info.knot_count;
            CHECK(info.t_min > 0.0f);
            for (rep = 0; rep < (test_quick() ? 10 : 60); rep++) {
                double want[4] = {0.0, 0.0, 0.0, 1.0};
                float got[4];
                optical_random_ray(&r, s, 300, 0.02f); /* at most 6 long, 3 on average */
                for (i = 0; i < 300; i++) {
                    double e[4];
                    s[i].length *= 0.5f;
                    oracle_segment(p, 200, independent, &s[i], e);
                    for (c = 0; c < 3; c++) want[c] += want[3] * e[c];
                    want[3] *= 1.0 - e[3];
                }
                want[3] = 1.0 - want[3];
                CHECK(tetcast_optics_ray(o, s, 300, got, NULL) == TETCAST_OK);
                for (c = 0; c < 4; c++) worst = fmax(worst, 255.0 * fabs((double)got[c] - want[c]));
            }
            CHECK_MSG(worst <= (double)info.bound, "tolerance %g, bound %g, error %g", (double)tolerance[k],
                      (double)info.bound, worst);
            if (getenv("TEST_PRINT") != NULL) {
                printf("tolerance %5.2f bound %.3f error %.3f knots %u t_min %.2g\n", (double)tolerance[k],
                       (double)info.bound, worst,
                       info.knot_count, (double)info.t_min);
            }
            tetcast_optics_destroy(o);
        }
        CHECK(knots < 60);
    }
}

/* What leaving out knots changes grows with the way through the mesh. A parabola lies below its chords everywhere: along a
   ray of one value the errors only add up. */
TEST(tolerance_of_long_rays) {
    enum { POINTS = 200 };
    static tetcast_control_point p[POINTS];
    static const float path[3] = {0.05f, 1.0f, 400.0f};
    int i, k, independent;
    for (independent = 0; independent < 2; independent++)
        for (k = 0; k < 3; k++) {
            tetcast_optics *plain, *o;
            tetcast_optics_desc d;
            tetcast_optics_info info;
            double worst = 0.0;
            memset(p, 0, sizeof p);
            for (i = 0; i < POINTS; i++) {
                const float x = (float)i / (float)(POINTS - 1), y = 0.12f * (x - 0.5f) * (x - 0.5f) / path[k];
                p[i].value = x;
                p[i].rgb[0] = independent ? y : 1.0f;
                p[i].extinction = independent ? 0.0f : y;
            }
            memset(&d, 0, sizeof d);
            plain = oracle_optics(p, POINTS, independent, NULL, 0, &d);
            d.tolerance = 8.0f;
            d.path_length = path[k];
            o = oracle_optics(p, POINTS, independent, NULL, 0, &d);
            tetcast_optics_get_info(o, &info);
            for (i = 0; i <= 1000; i++) {
                tetcast_segment s;
                float a[4], b[4];
                memset(&s, 0, sizeof s);
                s.front = s.back = (float)i / 1000.0f;
                s.length = path[k];
                CHECK(tetcast_optics_ray(plain, &s, 1, a, NULL) == TETCAST_OK);
                CHECK(tetcast_optics_ray(o, &s, 1, b, NULL) == TETCAST_OK);
                worst = fmax(worst, 255.0 * fabs((double)a[0] - (double)b[0]));
            }
            CHECK_MSG(info.knot_count < 20 && worst <= (double)(info.bound_knots + info.bound_integral) &&
                          worst > 0.2 * (double)info.bound_knots,
                      "way %g, %s: %u knots, bound %g, error %g", (double)path[k], independent ? "independent" : "associated",
                      info.knot_count, (double)info.bound_knots, worst);
            tetcast_optics_destroy(plain);
            tetcast_optics_destroy(o);
        }
}

TEST(bound_without_a_length) { /* what emits behind something dark adds up as long as the ray goes on */
    static tetcast_segment s[100];
    tetcast_control_point p[2];
    float tolerance;
    int i;
    memset(p, 0, sizeof p);
    memset(s, 0, sizeof s);
    p[1].value = 1.0f;
    p[0].extinction = 0.5f;
    for (i = 0; i < 3; i++) p[0].rgb[i] = p[1].rgb[i] = 1.0f;
    for (i = 0; i < 100; i++) {
        s[i].front = s[i].back = i < 14 ? 0.0f : 1.0f;
        s[i].length = 1.0f;
    }
    for (tolerance = 0.0f; tolerance < 9.0f; tolerance += 2.0f) {
        tetcast_optics_desc d;
        tetcast_optics_info info;
        tetcast_optics *o, *whole;
        float a[4], b[4];
        memset(&d, 0, sizeof d);
        d.tolerance = tolerance;
        o = oracle_optics(p, 2, 1, NULL, 0, &d);
        d.t_min = -1.0f;
        whole = oracle_optics(p, 2, 1, NULL, 0, &d);
        tetcast_optics_get_info(o, &info);
        CHECK(tetcast_optics_ray(o, s, 100, a, NULL) == TETCAST_OK);
        CHECK(tetcast_optics_ray(whole, s, 100, b, NULL) == TETCAST_OK);
        CHECK(b[0] > 2.05f);
        if (tolerance > 0.0f) CHECK(info.bound >= 0.0f && info.bound <= tolerance);
        else CHECK(info.bound < 0.0f && info.bound_end < 0.0f);
        if (tolerance > 0.0f) { /* with a length they may end early, a little */
            tetcast_optics *known;
            d.t_min = 0.0f;
            d.path_length = 100.0f;
            known = oracle_optics(p, 2, 1, NULL, 0, &d);
            tetcast_optics_get_info(known, &info);
            CHECK(tetcast_optics_ray(known, s, 100, a, NULL) == TETCAST_OK);
            CHECK_MSG(info.t_min > 0.0f && 255.0f * fabsf(a[0] - b[0]) <= info.bound, "bound %g, error %g", (double)info.bound,
                      255.0 * fabs((double)a[0] - (double)b[0]));
            tetcast_optics_destroy(known);
            tetcast_optics_get_info(o, &info);
            CHECK(tetcast_optics_ray(o, s, 100, a, NULL) == TETCAST_OK);
        }
        if (info.bound >= 0.0f) CHECK_MSG(255.0f * fabsf(a[0] - b[0]) <= info.bound, "bound %g, error %g", (double)info.bound,
                                          255.0 * fabs((double)a[0] - (double)b[0]));
        tetcast_optics_destroy(o);
        tetcast_optics_destroy(whole);
    }
}

TEST(bound_with_bright_fog) { /* what is behind may be brighter than white */
    tetcast_control_point p;
    tetcast_segment s[2];
    tetcast_optics_desc d;
    tetcast_optics_info info;
    tetcast_optics *o;
    float a[4], b[4];
    int i;
    memset(&p, 0, sizeof p);
    memset(s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    p.extinction = 1.0f;
    d.tolerance = 4.0f;
    d.path_length = 20.0f;
    d.cue = 1;
    d.cue_depth[1] = 4.0f;
    d.cue_scale[0] = 1.0f;
    for (i = 0; i < 3; i++) d.fog[i] = 40.0f;
    o = oracle_optics(&p, 1, 0, NULL, 0, &d);
    tetcast_optics_get_info(o, &info);
    s[0].length = 0.001f - logf(info.t_min); /* just beyond where it may end */
    s[1].length = 8.0f;
    s[1].depth = s[0].length;
    CHECK(tetcast_optics_ray(o, s, 2, a, NULL) == TETCAST_OK);
    tetcast_optics_destroy(o);
    d.tolerance = 0.0f;
    d.t_min = -1.0f;
    o = oracle_optics(&p, 1, 0, NULL, 0, &d);
    CHECK(tetcast_optics_ray(o, s, 2, b, NULL) == TETCAST_OK);
    CHECK_MSG(255.0f * fabsf(a[0] - b[0]) <= info.bound && a[0] != b[0], "bound %g, t_min %g, %.9g not %.9g", (double)info.bound,
              (double)info.t_min, (double)a[0], (double)b[0]);
    tetcast_optics_destroy(o);
}

/* Single scattering by a shader that casts rays to the light: in a cube of one density what a ray brings is
       tau int_0^D (ambient + (1 - ambient) exp(-tau way to the light)) exp(-tau x) dx */
TEST(single_scattering) {
    enum { N = 17, W = 8 };
    static float value[N * N * N], rgba[W * W * 4];
    static const float light[2][3] = {{0, 1, 0}, {0, 0.6f, 0.8f}}; /* at right angles to the rays, aslant */
    const tetcast_control_point p[2] = {{0, {1, 0.5f, 0.25f}, 2}, {1, {1, 0.5f, 0.25f}, 2}};
    tetcast_transfer *t = oracle_transfer(p, 2, 0, NULL, 0);
    tetcast_optics_desc od = desc_of(TETCAST_MODEL_VOLUME);
    tetcast_optics *o = oracle_optics(p, 2, 0, NULL, 0, &od);
    tetcast_grid grid;
    tetcast_field field;
    tetcast_mesh *mesh = NULL;
    int which, x, y, k, c;
    memset(&grid, 0, sizeof grid);
    memset(&field, 0, sizeof field);
    for (k = 0; k < N * N * N; k++) value[k] = 0.5f;
    field.values.data = value;
    grid.fields = &field;
    grid.field_count = 1;
    for (k = 0; k < 3; k++) {
        grid.dims[k] = N;
        grid.spacing[k] = 1.0 / (N - 1);
    }
    REQUIRE(tetcast_mesh_create_grid(NULL, &grid, NULL, &mesh) == TETCAST_OK);
    for (which = 0; which < 2; which++) {
        tetcast_shade_desc d;
        tetcast_image image;
        sup_shadow shadow;
        double worst = 0;
        memset(&d, 0, sizeof d);
        memset(&image, 0, sizeof image);
        REQUIRE(sup_shadow_open(&shadow, mesh, t, o, light[which], 0.25f) == TETCAST_OK);
        d.shader = &shadow.shader;
        d.camera.eye[0] = d.camera.eye[1] = d.camera.at[0] = d.camera.at[1] = d.camera.at[2] = 0.5;
        d.camera.eye[2] = 3;
        d.camera.ortho_height = 0.9f;
        image.width = image.height = W;
        image.rgba = rgba;
        CHECK_EQ_U64(tetcast_render_shaded(&d, mesh, NULL, &image, NULL), TETCAST_OK);
        for (y = 0; y < W; y++)
            for (x = 0; x < W; x++) {
                const double above = 0.5 + 0.9 * ((y + 0.5) / W - 0.5); /* as far below the upper face */
                double want = 0;
                for (k = 0; k < 2000; k++) {
                    const double at = (k + 0.5) / 2000;
                    const double up = above / (double)light[which][1], front = which ? at / (double)light[which][2] : 9;
                    want += 2 * (0.25 + 0.75 * exp(-2 * fmin(up, front))) * exp(-2 * at) / 2000;
                }
                for (c = 0; c < 3; c++)
                    worst = fmax(worst, fabs((double)rgba[4 * (y * W + x) + c] - want * (double)p[0].rgb[c]));
                CHECK_NEAR(rgba[4 * (y * W + x) + 3], 1 - exp(-2), 2.0 / 512);
            }
        CHECK_MSG(worst < 1e-3, "light %d: %g", which, worst);
        sup_shadow_close(&shadow);
    }
    tetcast_mesh_destroy(mesh);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
}

TEST(bad_descs) {
    tetcast_transfer *t = oracle_transfer(oracle_smooth, ORACLE_SMOOTH, 0, NULL, 0);
    tetcast_optics_desc d;
    tetcast_optics *o = NULL;
    tetcast_optics_info info;
    int i;
    CHECK(tetcast_optics_create(NULL, NULL, &o) == TETCAST_ERR_INVALID_ARG);
    CHECK(tetcast_optics_create(t, NULL, NULL) == TETCAST_ERR_INVALID_ARG);
    CHECK(tetcast_optics_create(t, NULL, &o) == TETCAST_OK);
    tetcast_optics_get_info(o, &info);
    CHECK(info.t_min == 1.0f / 512.0f && info.knot_count == ORACLE_SMOOTH);
    CHECK_NEAR((double)info.bound, 255.0 / 512.0, 1e-2);
    tetcast_optics_destroy(o);
    for (i = 0; i < 14; i++) {
        memset(&d, 0, sizeof d);
        switch (i) {
        case 0: d.model = (tetcast_model)99; break;
        case 1: d.integrator = (tetcast_integrator)-1; break;
        case 2: d.tolerance = NAN; break;
        case 3: d.t_min = INFINITY; break;
        case 4: d.cue = 1; break; /* no depths */
        case 5: d.cue = 1; d.cue_depth[1] = 1.0f; d.cue_scale[0] = 2.0f; break;
        case 6: d.light_count = 1; break;
        case 7: d.light_count = 100; break;
        case 8: d.fog[1] = NAN; break;
        case 9: d.ambient[2] = -1.0f; break;
        case 10: d.path_length = -1.0f; break;
        case 11: d.env.allocator.alloc_fn = test_alloc_fn; break;
        case 12: d.longest = INFINITY; break;
        default: d._begin_zero = 1; break;
        }
        CHECK(tetcast_optics_create(t, &d, &o) == (i == 13 ? TETCAST_ERR_UNINIT_DESC : TETCAST_ERR_INVALID_ARG));
        CHECK(o == NULL);
    }
    {
        tetcast_light light;
        memset(&light, 0, sizeof light);
        memset(&d, 0, sizeof d);
        d.lights = &light;
        d.light_count = 1;
        CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_INVALID_ARG); /* no direction */
    }
    for (i = 100; i < 2000; i += 300) { /* bytes: at first nothing, then part of it */
        tetcast_error err;
        memset(&err, 0, sizeof err);
        memset(&d, 0, sizeof d);
        d.env.memory_limit = (size_t)i;
        d.env.error = &err;
        CHECK(tetcast_optics_create(t, &d, &o) == TETCAST_ERR_NO_MEMORY);
        CHECK(o == NULL && err.code == TETCAST_ERR_NO_MEMORY && err.text[0] != 0);
    }
    tetcast_optics_destroy(NULL);
    tetcast_optics_get_info(NULL, &info);
    CHECK(info.table_bytes == 0);
    tetcast_transfer_destroy(t);
}

TEST(cue_of_a_surface) { /* at its own depth, not at that of the cell */
    static const tetcast_control_point point = {0, {1, 1, 1}, 0};
    const tetcast_segment segment = {0, 1, 2, 1};
    tetcast_isovalue iso;
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_transfer *t;
    tetcast_optics *o;
    float rgba[4];
    memset(&iso, 0, sizeof iso);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    iso.value = 0.5f; /* halfway: depth 2 */
    iso.rgb[0] = iso.rgb[1] = iso.rgb[2] = iso.opacity = 1;
    td.points = &point;
    td.point_count = 1;
    td.isovalues = &iso;
    td.isovalue_count = 1;
    od.model = TETCAST_MODEL_ISOSURFACE;
    od.cue = 1;
    od.cue_depth[1] = 4;
    od.cue_scale[0] = 1;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &t), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(t, &od, &o), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_ray(o, &segment, 1, rgba, NULL), TETCAST_OK);
    CHECK_NEAR(rgba[0], 0.5, 1e-6);
    CHECK_NEAR(rgba[3], 1, 1e-6);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(emission);
    RUN(absorption);
    RUN(maximum);
    RUN(depth_cue);
    RUN(hits_of_a_ray);
    RUN(several_isovalues_in_order);
    RUN(mixed);
    RUN(shading);
    RUN(opaque_surface_ends_the_ray);
    RUN(surfaces_by_lane);
    RUN(lanes_that_are_off);
    RUN(numbers_at_the_ends_of_what_is_allowed);
    RUN(units);
    RUN(what_ends_a_ray);
    RUN(light_through_dark_fog);
    RUN(cue_of_a_surface);
    RUN(tolerance_holds);
    RUN(tolerance_of_long_rays);
    RUN(bound_without_a_length);
    RUN(bound_with_bright_fog);
    RUN(single_scattering);
    RUN(bad_descs);
    return test_end();
}
