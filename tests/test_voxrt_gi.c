/* Global illumination: attributes of cells, light on them, closed forms, the same bits whatever computes them. */
#include "test.h"
#include <pthread.h>
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "gi_models.h"

TEST(shared_exponents) {
    uint32_t i, a;
    rng_state = 3;
    for (i = 0; i < 20000; i++) {
        float c[3], d[3], most = 0;
        for (a = 0; a < 3; a++) {
            c[a] = (float)(rnd() * exp2(30 * rnd() - 15));
            if (i % 7 == 0) c[a] = (float)((i / 7) % 512 + (i % 2 ? 0.5 : 0));
            most = c[a] > most ? c[a] : most;
        }
        voxrti_rgb9e5_decode(voxrti_rgb9e5(c), d);
        for (a = 0; a < 3; a++) CHECK_MSG(fabsf(c[a] - d[a]) <= most / 511 + 1e-7f, "%g became %g of %g", (double)c[a], (double)d[a], (double)most);
    }
    {
        const float odd[3] = {INFINITY, -1, NAN}, none[3] = {0, 0, 0};
        float d[3];
        voxrti_rgb9e5_decode(voxrti_rgb9e5(odd), d);
        CHECK(d[0] == 65408.0f && d[1] == 0 && d[2] == 0);
        voxrti_rgb9e5_decode(voxrti_rgb9e5(none), d);
        CHECK(d[0] == 0 && d[1] == 0 && d[2] == 0);
        CHECK(voxrti_rgb9e5(odd) != VOXRTI_GI_UNKNOWN);
    }
    for (i = 0; i < 40; i++) { /* nor is white, however bright it is */
        const float white[3] = {(float)exp2(i), (float)exp2(i), (float)exp2(i)};
        float d[3];
        CHECK(voxrti_rgb9e5(white) != VOXRTI_GI_UNKNOWN);
        voxrti_rgb9e5_decode(voxrti_rgb9e5(white), d);
        for (a = 0; a < 3; a++) CHECK(fabsf(d[a] - fminf(white[a], 65408.0f)) <= d[a] / 500);
    }
}

TEST(samples_are_spread) { /* every power of two of points: one in each elementary interval; cosine density */
    uint32_t n, i, seed;
    for (seed = 0; seed < 20; seed++)
        for (n = 4; n <= 256; n *= 4) {
            uint8_t cell[16][16];
            uint32_t side = 1, full = 0;
            while (side * side < n) side *= 2;
            memset(cell, 0, sizeof cell);
            for (i = 0; i < n; i++) {
                float u[2];
                voxrti_sobol2(i, voxrti_hash32(seed), u);
                CHECK(u[0] >= 0 && u[0] < 1 && u[1] >= 0 && u[1] < 1);
                full += cell[(uint32_t)(u[1] * (float)side)][(uint32_t)(u[0] * (float)side)]++ == 0;
            }
            CHECK_MSG(full == n, "%u of %u cells", full, n);
        }
    {
        const float normal[3] = {0.36f, 0.48f, 0.8f};
        double sum = 0, sum2 = 0;
        for (i = 0; i < 4096; i++) {
            float u[2], d[3], c;
            voxrti_sobol2(i, 7, u);
            c = voxrti_lobe_direction(normal, u, 1.0f, d);
            CHECK(fabsf(voxrti_dot3(d, d) - 1) < 1e-5f && fabsf(voxrti_dot3(d, normal) - c) < 1e-5f);
            sum += (double)c;
            (void)voxrti_lobe_direction(normal, u, 4.0f, d);
            sum2 += (double)voxrti_dot3(d, normal);
        }
        CHECK(fabs(sum / 4096 - 2.0 / 3.0) < 1e-3);  /* E[cos] of density (n+1)/(2 pi) cos^n is (n+1)/(n+2) */
        CHECK(fabs(sum2 / 4096 - 5.0 / 6.0) < 1e-3);
    }
}

TEST(both_sides_of_a_thin_plate) { /* a plate thinner than a cell: each side keeps its normal and its colour. With one
                                      value a cell, of the last that was written, one of the sides is lost */
    static model m;
    static uint8_t writers[64][64][64]; /* bits of the sides that wrote; 4: side 1 was the last */
    uint32_t round, i, k, cells = 0, wrong = 0, both = 0, lost = 0, wrong_of_both = 0;
    rng_state = 5;
    for (round = 0; round < (test_quick() ? 60u : 100u); round++) {
        voxrt_gi *gi = make_gi(64, 64, 64, 32);
        double e[3][3], p[8][3];
        voxrt_gi_object o;
        for (k = 0; k < 2; k++) {
            double l = 0, dot = 0;
            for (i = 0; i < 3; i++) e[k][i] = 2 * rnd() - 1;
            for (i = 0; i < 3 && k; i++) dot += e[0][i] * e[1][i];
            for (i = 0; i < 3 && k; i++) e[1][i] -= dot * e[0][i];
            for (i = 0; i < 3; i++) l += e[k][i] * e[k][i];
            for (i = 0; i < 3; i++) e[k][i] /= sqrt(l);
        }
        for (i = 0; i < 3; i++) e[2][i] = e[0][(i + 1) % 3] * e[1][(i + 2) % 3] - e[0][(i + 2) % 3] * e[1][(i + 1) % 3];
        for (k = 0; k < 8; k++)
            for (i = 0; i < 3; i++)
                p[k][i] = (k < 4 ? 0.15 : -0.15) * e[0][i] + ((k + 1) % 4 < 2 ? -14 : 14) * e[1][i] + (k % 4 < 2 ? -14 : 14) * e[2][i];
        m.points = m.triangles = 0;
        quad(&m, p[0], p[1], p[2], p[3], 255); /* upper: white, normal e0 */
        quad(&m, p[7], p[6], p[5], p[4], 60);
        o = object_of(&m, 1);
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
        memset(writers, 0, sizeof writers);
        for (i = 0; i < 2 * 280 * 280; i++) { /* samples of the one side, then of the other */
            const double u = (i % 280) / 10.0 - 13.95, v = (i / 280 % 280) / 10.0 - 13.95, w = i < 280 * 280 ? 0.15 : -0.15;
            uint32_t c[3];
            for (k = 0; k < 3; k++) c[k] = (uint32_t)(w * e[0][k] + u * e[1][k] + v * e[2][k] + 32);
            writers[c[2]][c[1]][c[0]] = (uint8_t)((writers[c[2]][c[1]][c[0]] & 3u) | (i < 280 * 280 ? 1u : 2u + 4u));
        }
        for (i = 0; i < 400; i++) {
            voxrt_ray r;
            voxrt_column_hit h;
            voxrt_gi_surface s;
            const double u = 24 * rnd() - 12, v = 24 * rnd() - 12, side = i & 1 ? 1 : -1;
            uint32_t bits;
            memset(&r, 0, sizeof r);
            for (k = 0; k < 3; k++) {
                r.org[k] = (float)(u * e[1][k] + v * e[2][k] + 12 * side * e[0][k]);
                r.dir[k] = (float)(-side * e[0][k] + 0.2 * e[1][k]);
            }
            r.t_max = INFINITY;
            CHECK(voxrt_columns_trace(voxrt_gi_columns(gi), NULL, &r, &h, 1) == VOXRT_OK);
            if (!(h.t < INFINITY)) continue;
            cells++;
            bits = writers[h.cell[2]][h.cell[1]][h.cell[0]];
            both += (bits & 3u) == 3;
            lost += (bits & 3u) == 3 && ((bits & 4u) != 0) == (side > 0);
            if (!voxrt_gi_get(gi, &h, r.dir, &s)) {
                wrong++; /* a cell that only the other side was put into */
                wrong_of_both += (bits & 3u) == 3;
                continue;
            }
            for (k = 0; k < 3; k++) if (fabs((double)s.normal[k] - side * e[0][k]) > 0.02) wrong++;
            CHECK(fabsf(s.albedo[0] - (side > 0 ? 1.0f : (float)voxrti_srgb_to_linear(60.0 / 255.0))) < 0.01f);
        }
        voxrt_gi_destroy(gi);
    }
    CHECK(cells > 20000 && both > cells / 2);
    CHECK_MSG(wrong < cells / 6, "%u of %u", wrong, cells);
    CHECK_MSG(wrong_of_both < both / 100, "%u of the %u that have both", wrong_of_both, both);
    CHECK_MSG(lost > both * 2 / 5, "the last writer's: %u of %u lost", lost, both);
}

TEST(still_and_moving_objects_look_the_same) {
    static model a, b;
    voxrt_gi *one = make_gi(64, 64, 64, 10), *two = make_gi(64, 64, 64, 10);
    voxrt_gi_object oa, ob;
    voxrt_gi_update_stats su;
    uint32_t id = 9, frame, i, k, wrong = 0, seen = 0;
    sphere(&a, 9.0, 40, 200, 1);
    sphere(&b, 3.0, 20, 120, 0);
    oa = object_of(&a, 1);
    ob = object_of(&b, 1);
    ob.to_world[0] = ob.to_world[5] = ob.to_world[10] = 1;
    ob.to_world[3] = 1.5;
    CHECK(voxrt_gi_add(one, &oa, NULL) == VOXRT_OK && voxrt_gi_add(two, &oa, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_add(one, &ob, NULL) == VOXRT_OK);
    ob.still = 0;
    CHECK(voxrt_gi_add(two, &ob, &id) == VOXRT_OK && id == 1);
    for (frame = 0; frame < 3; frame++) { /* away, and back */
        ob.to_world[7] = frame == 1 ? 4.0 : 0.0;
        CHECK(voxrt_gi_set(two, id, &ob) == VOXRT_OK);
        CHECK(voxrt_gi_update(two, &su) == VOXRT_OK);
        CHECK(su.moving_cells > 300 && su.still_cells > 3000 && su.rejected == 0);
    }
    CHECK(voxrt_gi_update(one, &su) == VOXRT_OK);
    CHECK(su.moving_cells == 0);
    CHECK(memcmp(one->columns->bits, two->columns->bits, 4 * (size_t)64 * 64 * 2) == 0);
    rng_state = 8;
    for (i = 0; i < 3000; i++) {
        voxrt_ray r;
        voxrt_column_hit h[2];
        voxrt_gi_surface s[2];
        memset(&r, 0, sizeof r);
        for (k = 0; k < 3; k++) r.dir[k] = (float)(2 * rnd() - 1);
        r.org[0] = -5;
        r.t_max = INFINITY;
        CHECK(voxrt_columns_trace(one->columns, NULL, &r, &h[0], 1) == VOXRT_OK);
        CHECK(voxrt_columns_trace(two->columns, NULL, &r, &h[1], 1) == VOXRT_OK);
        wrong += memcmp(&h[0], &h[1], sizeof h[0]) != 0;
        if (voxrt_gi_get(one, &h[0], r.dir, &s[0]) != voxrt_gi_get(two, &h[1], r.dir, &s[1])) wrong++;
        wrong += memcmp(&s[0], &s[1], sizeof s[0]) != 0;
        seen += s[0].object == 1;
    }
    CHECK(seen > 100);
    CHECK_MSG(wrong == 0, "%u", wrong);
    CHECK(voxrt_gi_remove(two, id) == VOXRT_OK && voxrt_gi_remove(two, id) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_gi_update(two, &su) == VOXRT_OK && su.moving_cells == 0);
    voxrt_gi_destroy(one);
    voxrt_gi_destroy(two);
}

/* A closed sphere of radius r and albedo q with a point light of intensity i in its middle: everywhere i/r^2 of direct
   light, and after k bounces i/r^2 (q + q^2 + ... + q^k) of indirect light. */
TEST(closed_sphere) {
    static model m;
    static float position[32][3], normal[32][3], albedo[32][3], direct[32][3], indirect[32][3];
    const double r = 9.0, q = 0.5;
    const uint8_t grey = (uint8_t)floor(255 * voxrti_linear_to_srgb(q) + 0.5);
    const double real_q = voxrti_srgb_to_linear(grey / 255.0);
    voxrt_gi *gi = make_gi(64, 64, 64, 10);
    voxrt_gi_light light = point_light(0, 0, 0, 81.0f);
    voxrt_gi_object o;
    voxrt_gbuffer g;
    voxrt_gi_render_desc d;
    double sum_direct = 0, sum;
    uint32_t i, k, bounces;
    rng_state = 13;
    sphere(&m, r, 60, grey, 1);
    o = object_of(&m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    g = gbuffer_of(8, 4, position, normal, albedo);
    for (i = 0; i < 32; i++) {
        double v[3], l = 0;
        for (k = 0; k < 3; k++) {
            v[k] = 2 * rnd() - 1;
            l += v[k] * v[k];
        }
        for (k = 0; k < 3; k++) {
            normal[i][k] = (float)(-v[k] / sqrt(l));
            position[i][k] = (float)(v[k] / sqrt(l) * r);
            albedo[i][k] = 1.0f;
        }
    }
    d.rays = test_quick() ? 64 : 128;
    for (bounces = 1; bounces <= 3; bounces++) {
        double want = 0, factor = real_q;
        for (i = 0; i < bounces; i++, factor *= real_q) want += factor;
        for (k = 0; k < 2; k++) { /* light on cells, and paths */
            d.method = k == 0 ? VOXRT_GI_GATHER : VOXRT_GI_PATH;
            d.bounces = bounces;
            CHECK(voxrt_gi_render(&d, gi, &g, direct[0], indirect[0], NULL) == VOXRT_OK);
            sum = sum_direct = 0;
            for (i = 0; i < 32; i++) {
                sum += 3.14159265358979 * (double)indirect[i][0] / 32;
                sum_direct += 3.14159265358979 * (double)direct[i][0] / 32;
            }
            CHECK_MSG(fabs(sum / want - 1) < 0.03, "%u bounces by method %u: %.4f, not %.4f", bounces, k, sum, want);
        }
        CHECK_MSG(fabs(sum_direct - 1) < 0.005, "direct light %.4f", sum_direct);
        CHECK(voxrt_gi_bounce(gi, NULL, 16, 0.0f, bounces) == VOXRT_OK);
    }
    voxrt_gi_destroy(gi);
}

/* Every way to find light, in the closed sphere: 32 points on it. Returns indirect irradiance over what is expected. */
typedef struct ball {
    model m;
    float position[32][3], normal[32][3], albedo[32][3], specular[32][4], direct[32][3], indirect[32][3];
    voxrt_gi *gi;
    voxrt_gbuffer g;
    double q;
} ball;
static void ball_open(ball *b, double r, const voxrt_gi_material *material) {
    const uint8_t grey = (uint8_t)floor(255 * voxrti_linear_to_srgb(0.5) + 0.5);
    voxrt_gi_light light = point_light(0, 0, 0, (float)(r * r));
    voxrt_gi_object o;
    uint32_t i, k;
    b->q = voxrti_srgb_to_linear(grey / 255.0);
    b->gi = make_gi(64, 64, 64, 10);
    sphere(&b->m, r, 60, grey, 1);
    o = object_of(&b->m, 1);
    if (material != NULL) o.material = *material;
    CHECK(voxrt_gi_add(b->gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(b->gi, &light, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(b->gi, NULL) == VOXRT_OK);
    memset(&b->g, 0, sizeof b->g);
    b->g = gbuffer_of(8, 4, b->position, b->normal, b->albedo);
    rng_state = 17;
    for (i = 0; i < 32; i++) {
        double v[3], l = 0;
        for (k = 0; k < 3; k++) {
            v[k] = 2 * rnd() - 1;
            l += v[k] * v[k];
        }
        for (k = 0; k < 3; k++) {
            b->normal[i][k] = (float)(-v[k] / sqrt(l));
            b->position[i][k] = (float)(v[k] / sqrt(l) * r);
            b->albedo[i][k] = 1.0f;
        }
    }
}
static double ball_light(ball *b, voxrt_gi_render_desc *d) { /* mean irradiance that comes indirectly */
    double sum = 0;
    uint32_t i;
    CHECK(voxrt_gi_render(d, b->gi, &b->g, b->direct[0], b->indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < 32; i++) sum += 3.14159265358979 * (double)b->indirect[i][0] / 32;
    return sum;
}

/* The same with the lamp near the wall: what comes back once from everywhere is the same everywhere, q i / r^2, but half of
   it from a spot as wide as the lamp is far. By 64 rays, without any for that spot, points differ by all there is. */
TEST(lamps_near_surfaces_leave_no_dots) {
    static ball b;
    const double r = 9.0;
    voxrt_gi_render_desc d;
    uint32_t i, k;
    ball_open(&b, r, NULL);
    memset(&d, 0, sizeof d);
    d.rays = 64;
    for (k = 0; k < 6; k++) { /* points and spots; near the wall, nearer; gathered, by paths */
        const double h = k & 1 ? 0.4 : 0.8;
        voxrt_gi_light light = point_light((float)(h - r), 0, 0, (float)(r * r));
        double want = b.q, mean = 0, error = 0;
        if (k >= 4) { /* less than half of the light, to the wall */
            light.kind = VOXRT_GI_SPOT;
            light.direction[0] = -1.0f;
            light.angle = 80.0f;
            want *= 0.5 * (1 - cos(80 * 3.14159265358979 / 180));
        }
        d.method = k == 2 || k == 3 ? VOXRT_GI_PATH : VOXRT_GI_GATHER;
        d.bounces = 1;
        CHECK(voxrt_gi_set_lights(b.gi, &light, 1) == VOXRT_OK);
        CHECK(voxrt_gi_update(b.gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_render(&d, b.gi, &b.g, b.direct[0], b.indirect[0], NULL) == VOXRT_OK);
        for (i = 0; i < 32; i++) {
            const double it = 3.14159265358979 * (double)b.indirect[i][0] / want;
            mean += it / 32;
            error += (it - 1) * (it - 1) / 32 * want * want / (b.q * b.q);
        }
        CHECK_MSG(fabs(mean - 1) < 0.04, "%u: %.4f of the light", k, mean);
        CHECK_MSG(sqrt(error) < 0.2, "%u: %.4f of error", k, sqrt(error)); /* 0.55 and 1.5 without */
    }
    voxrt_gi_destroy(b.gi);
}

TEST(ways_to_look_up_light) { /* q i / r^2 for one bounce; maps may lose or leak a little */
    static ball b;
    uint32_t way;
    ball_open(&b, 9.0, NULL);
    for (way = 0; way < 4; way++) {
        voxrt_gi_render_desc d;
        double got;
        memset(&d, 0, sizeof d);
        d.rays = 128;
        d.lookup = (voxrt_gi_lookup)way;
        got = ball_light(&b, &d) / b.q;
        CHECK_MSG(fabs(got - 1) < 0.02, "lookup %u: %.4f", way, got);
        d.lookup = VOXRT_GI_LOOKUP_MAPS;
        d.map_size = 32;
    }
    CHECK(b.gi->map != NULL && b.gi->map[0].faces == 6 && b.gi->map[0].side == 256);
    voxrt_gi_destroy(b.gi);
}

TEST(virtual_lights) { /* k bounces: q + q^2 + ...; the kernel between points of a sphere is constant: no variance */
    static ball b;
    voxrt_gi_render_desc d;
    uint32_t bounces;
    double want = 0, factor, got;
    ball_open(&b, 9.0, NULL);
    memset(&d, 0, sizeof d);
    d.method = VOXRT_GI_VPL;
    d.rays = 64;
    d.pattern = 2;
    for (bounces = 1, factor = b.q; bounces <= 2; bounces++, factor *= b.q) {
        want += factor;
        d.bounces = bounces;
        if (bounces == 2) CHECK(voxrt_gi_bounce(b.gi, NULL, 32, 0, 1) == VOXRT_OK); /* short rays see it, too */
        got = ball_light(&b, &d);
        CHECK_MSG(fabs(got / want - 1) < 0.03, "%u bounces: %.4f, not %.4f", bounces, got, want);
    }
    CHECK(voxrt_gi_virtual_lights(b.gi, NULL, 0) == 2 * 4 * 64);
    { /* their flux is that of the lamp: 4 pi i, the share of each set */
        float v[9 * 256];
        double sum = 0;
        uint32_t i;
        CHECK(voxrt_gi_virtual_lights(b.gi, v, 256) == 512);
        for (i = 0; i < 256; i++) sum += (double)v[9 * i + 6] / 4;
        CHECK_MSG(fabs(sum / (4 * 3.14159265 * 81) - 1) < 1e-3, "%.5f", sum / (4 * 3.14159265 * 81));
    }
    d.d_min = 1e-6f; /* the thesis' form is the same where nothing is cut off; near lights have 1 / d^2 */
    d.bounces = 1;
    got = ball_light(&b, &d) / b.q;
    CHECK_MSG(fabs(got - 1) < 0.06, "1 / (d_min + d^2): %.4f", got);
    d.d_min = 81.0f; /* and loses light: the mean of d^2 / (81 + d^2), d^2 uniform in 0 .. 4 * 81 */
    got = ball_light(&b, &d) / b.q;
    CHECK_MSG(fabs(got - (1 - log(5.0) / 4)) < 0.03, "cut off: %.4f, not %.4f", got, 1 - log(5.0) / 4);
    voxrt_gi_destroy(b.gi);
}

TEST(spot_lights_become_virtual_ones) { /* uniform in solid angle: flux of a cone 2 pi (1 - cos) i, whatever its angle */
    uint32_t angle;
    for (angle = 10; angle < 90; angle += 25) {
        static ball b;
        voxrt_gi_render_desc d;
        voxrt_gi_light l = point_light(0, 0, 0, 81);
        const double part = 0.5 * (1 - cos(angle * 3.14159265358979 / 180));
        double got;
        ball_open(&b, 9.0, NULL);
        l.kind = VOXRT_GI_SPOT;
        l.direction[0] = 0.3f;
        l.direction[1] = 0.5f;
        l.direction[2] = -0.8f;
        l.angle = (float)angle;
        CHECK(voxrt_gi_set_lights(b.gi, &l, 1) == VOXRT_OK);
        memset(&d, 0, sizeof d);
        d.method = VOXRT_GI_VPL;
        d.rays = 64;
        d.pattern = 1;
        got = ball_light(&b, &d) / (b.q * part); /* spreads over the whole sphere */
        CHECK_MSG(fabs(got - 1) < 0.05, "%u degrees: %.4f", angle, got);
        voxrt_gi_destroy(b.gi);
    }
}

TEST(sharp_lobes) { /* far beside a lobe there is nothing, however sharp it is */
    uint32_t i, k;
    static const float exponent[6] = {1.0f, 20.0f, 300.0f, 5000.0f, 100000.0f, 1e6f};
    for (k = 0; k < 6; k++)
        for (i = 0; i < 200; i++) {
            const double angle = 1.57 * i / 200.0, n = (double)exponent[k];
            const float view[3] = {0, -1, 0}, up[3] = {0, 1, 0}, to[3] = {(float)sin(angle), (float)cos(angle), 0};
            const double want = (n + 2) * 0.15915494309189535 * pow((double)to[1], n), is = (double)voxrti_phong(view, up, to, exponent[k]);
            CHECK_MSG(fabs(is - want) <= 2e-6 * want + 1e-25, "exponent %g, angle %g: %g, not %g", n, angle, is, want);
        }
}

TEST(phong_lobes) { /* of light from everywhere, radiance l: at normal incidence a white lobe sends l back, by rays */
    static ball b;
    static const float exponents[4] = {1, 4, 16, 256};
    voxrt_gi_render_desc d;
    uint32_t e, i, k;
    double got;
    ball_open(&b, 9.0, NULL);
    memset(&d, 0, sizeof d);
    d.rays = 256;
    b.g.specular = b.specular[0];
    for (e = 0; e < 4; e++) {
        for (i = 0; i < 32; i++) { /* seen from the middle; no diffuse part */
            for (k = 0; k < 3; k++) {
                b.specular[i][k] = 1.0f;
                b.albedo[i][k] = 0.0f;
            }
            b.specular[i][3] = exponents[e];
        }
        d.camera.at[2] = 1;
        got = ball_light(&b, &d) / b.q; /* pi * radiance: radiance everywhere is q / pi */
        CHECK_MSG(fabs(got - 1) < 0.02, "exponent %g: %.4f", (double)exponents[e], got);
        { /* direct: the lamp is where the eye is: (n + 2) / (2 pi) of what falls there */
            double direct = 0;
            for (i = 0; i < 32; i++) direct += (double)b.direct[i][0] / 32;
            CHECK_MSG(fabs(direct / (((double)exponents[e] + 2) / 6.283185307) - 1) < 0.01, "direct, exponent %g: %.4f", (double)exponents[e], direct);
        }
    }
    voxrt_gi_destroy(b.gi);
}

TEST(phong_senders) { /* a sphere with a lobe and a lamp in its middle: lobes are around normals */
    static ball b;
    voxrt_gi_material m;
    voxrt_gi_render_desc d;
    uint32_t way;
    memset(&m, 0, sizeof m);
    m.specular[0] = m.specular[1] = m.specular[2] = 0.5f;
    m.exponent = 4;
    m.albedo[0] = m.albedo[1] = m.albedo[2] = 1e-6f;
    ball_open(&b, 9.0, &m);
    memset(&d, 0, sizeof d);
    for (way = 0; way < 4; way++) { /* by cells, by shadow rays, by paths, by virtual lights */
        /* rays leave with density cos / pi: E = integral of L cos, L = s (n + 2) / (2 pi) cos^n, both cosines are the same:
           2 pi s (n + 2) / (2 pi) * integral of c^(n+1) dc = s */
        double got;
        d.method = way < 2 ? VOXRT_GI_GATHER : way == 2 ? VOXRT_GI_PATH : VOXRT_GI_VPL;
        d.lookup = way == 1 ? VOXRT_GI_LOOKUP_RAYS : VOXRT_GI_LOOKUP_CACHE;
        d.rays = way == 3 ? 256 : 128;
        got = ball_light(&b, &d);
        CHECK_MSG(fabs(got / 0.5 - 1) < 0.05, "way %u: %.4f, not 0.5", way, got);
    }
    voxrt_gi_destroy(b.gi);
}

TEST(meshes_that_emit) { /* the inside of a sphere with radiance l: pi l everywhere, by direct light alone */
    static ball b;
    static model small;
    voxrt_gi_material m;
    voxrt_gi_render_desc d;
    uint32_t i;
    double sum = 0;
    memset(&m, 0, sizeof m);
    memset(&d, 0, sizeof d);
    m.emission[0] = m.emission[1] = m.emission[2] = 2.0f;
    ball_open(&b, 9.0, NULL);
    CHECK(voxrt_gi_set_lights(b.gi, NULL, 0) == VOXRT_OK);
    { /* a small one in the middle: irradiance on the large one pi l (1 / 9)^2 */
        voxrt_gi_object o;
        sphere(&small, 1.0, 12, 200, 0);
        o = object_of(&small, 0);
        o.material = m;
        CHECK(voxrt_gi_add(b.gi, &o, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_update(b.gi, NULL) == VOXRT_OK);
        CHECK(b.gi->emitter_count > 500 && fabs(b.gi->emitter[b.gi->emitter_count - 1].sum / (2 * 4 * 3.14159265) - 1) < 0.03);
    }
    d.rays = 256;
    {
        const double want = 3.14159265 * 2 / 81, back = ball_light(&b, &d);
        for (i = 0; i < 32; i++) sum += 3.14159265 * (double)b.direct[i][0] / 32;
        CHECK_MSG(fabs(sum / want - 1) < 0.05, "direct %.4f, not %.4f", sum, want);
        /* what comes back: q times that, but for the small sphere, which hides 1 / 81 of it and sends some itself */
        CHECK_MSG(fabs(back / (b.q * want) - 1) < 0.06, "indirect %.4f, not %.4f", back, b.q * want);
        d.method = VOXRT_GI_VPL;
        d.rays = 128;
        sum = ball_light(&b, &d);
        CHECK_MSG(fabs(sum / (b.q * want) - 1) < 0.1, "virtual lights %.4f, not %.4f", sum, b.q * want);
    }
    voxrt_gi_destroy(b.gi);
}

/* A closed room with a block and a lamp, seen by a camera in it. */
typedef struct room {
    model m, block;
    float position[96 * 64][3], normal[96 * 64][3], albedo[96 * 64][3], before[96 * 64][3], direct[96 * 64][3], indirect[96 * 64][3];
    voxrt_gi *gi;
    voxrt_gi_object object;
    voxrt_gbuffer g;
    voxrt_camera camera;
    voxrt_gi_light light;
    uint32_t id;
} room;
static void box(model *m, double half, uint8_t grey, int inwards) {
    uint32_t i, k, wall;
    for (k = 0; k < 3; k++)
        for (wall = 0; wall < 2; wall++) {
            double p[4][3];
            const uint32_t turn = (wall != 0) == (inwards != 0) ? 1 : 3;
            for (i = 0; i < 4; i++) {
                p[i][k] = wall ? half : -half;
                p[i][(k + 1) % 3] = (i + 1) % 4 < 2 ? half : -half;
                p[i][(k + 2) % 3] = i < 2 ? -half : half;
            }
            quad(m, p[0], p[turn], p[2], p[4 - turn], grey);
        }
}
static void room_open(room *r, uint32_t width, uint32_t height, uint32_t threads) {
    voxrt_gi_object o;
    r->m.points = r->m.triangles = r->block.points = r->block.triangles = 0;
    box(&r->m, 9.0, 200, 1);
    box(&r->block, 2.0, 160, 0);
    r->gi = make_gi(64, 64, 64, 10);
    r->gi->env.thread_count = threads;
    o = object_of(&r->m, 1);
    CHECK(voxrt_gi_add(r->gi, &o, NULL) == VOXRT_OK);
    r->object = object_of(&r->block, 0);
    r->object.to_world[0] = r->object.to_world[5] = r->object.to_world[10] = 1;
    r->object.to_world[7] = -6.8;
    r->object.to_world[3] = -3;
    CHECK(voxrt_gi_add(r->gi, &r->object, &r->id) == VOXRT_OK);
    r->light = point_light(3, 6, 2, 80);
    CHECK(voxrt_gi_set_lights(r->gi, &r->light, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(r->gi, NULL) == VOXRT_OK);
    memset(&r->g, 0, sizeof r->g);
    r->g = gbuffer_of(width, height, r->position, r->normal, r->albedo);
    r->g.before = r->before[0];
    memset(&r->camera, 0, sizeof r->camera);
    r->camera.eye[0] = 2;
    r->camera.eye[1] = 1;
    r->camera.eye[2] = 8;
    r->camera.at[1] = -3;
    r->camera.fov_y = 70;
    CHECK(voxrt_gbuffer_from_gi(&r->gi->env, &r->camera, r->gi, &r->g) == VOXRT_OK);
    CHECK(voxrt_gbuffer_materials(&r->gi->env, r->gi, &r->g) == VOXRT_OK);
}
TEST(coarse_meshes_of_pixels) {
    static room r;
    static float full[96 * 64][3];
    voxrt_gi_render_desc d;
    voxrt_gi_report report;
    double e;
    room_open(&r, 96, 64, 0);
    memset(&d, 0, sizeof d);
    d.rays = 64;
    d.report = &report;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, full[0], NULL) == VOXRT_OK);
    CHECK(report.shaded == report.pixels && report.pixels > 96 * 63);
    d.coarse = 8;
    d.detail = 1e-9f; /* nothing may be interpolated: the same bits */
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    CHECK(report.shaded == report.pixels && memcmp(full, r.indirect, sizeof full) == 0);
    d.detail = 0;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    e = rms(r.indirect, full, 96 * 64); /* most of it the noise of 64 rays in both */
    CHECK_MSG(report.shaded < 96 * 64 / 2, "%u of %u", (unsigned)report.shaded, 96 * 64);
    CHECK_MSG(e < 0.12, "%.4f with %.3f of the pixels", e, (double)report.shaded / (96 * 64));
    d.method = VOXRT_GI_VPL; /* no noise but that of the short rays */
    d.pattern = 1;
    d.coarse = 1;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, full[0], NULL) == VOXRT_OK);
    d.coarse = 8;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    e = rms(r.indirect, full, 96 * 64);
    CHECK_MSG(e < 0.03 && report.shaded < 96 * 64 * 2 / 3, "virtual lights: %.4f with %.3f of the pixels", e, (double)report.shaded / (96 * 64));
    d.pattern = 2; /* neighbours see other lights: every pixel */
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK && report.shaded == report.pixels);
    d.method = VOXRT_GI_GATHER;
    d.rays = 64;
    d.coarse = 1;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, full[0], NULL) == VOXRT_OK);
    d.coarse = 8;
    d.tolerance = 0.5f; /* in two halves, the same mesh */
    d.rays = 8;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    CHECK(rms(r.indirect, full, 96 * 64) < 0.5);
    voxrt_gi_destroy(r.gi);
}

TEST(noise_is_what_was_asked_for) { /* and what is reported is the difference from the truth */
    static room r;
    static float truth[40 * 24][3];
    voxrt_gi_render_desc d;
    voxrt_gi_report report;
    uint32_t i, before = 0;
    room_open(&r, 40, 24, 0);
    memset(&d, 0, sizeof d);
    d.rays = 768;
    d.first_ray = 1u << 20;
    d.report = &report;
    for (i = 0; i < 40 * 24; i++) r.albedo[i][0] = r.albedo[i][1] = r.albedo[i][2] = 1; /* noise is of light, not of colours */
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, truth[0], NULL) == VOXRT_OK);
    CHECK(report.noise == 0 && report.rays == 768);
    d.first_ray = 0;
    d.rays = 0;
    for (i = 0; i < 3; i++) {
        double e;
        d.tolerance = i == 0 ? 0.2f : i == 1 ? 0.1f : 0.05f;
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        e = rms(r.indirect, truth, 40 * 24);
        CHECK_MSG(report.noise <= d.tolerance && report.rays > before, "%g: %g with %u rays", (double)d.tolerance, (double)report.noise, report.rays);
        CHECK_MSG(e < 1.2 * (double)d.tolerance && fabs(e / (double)report.noise - 1) < 0.3, "%g, said %g", e, (double)report.noise);
        before = report.rays;
    }
    d.tolerance = 1e-4f;
    d.rays = 64;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    CHECK(report.noise > d.tolerance && report.rays == 64);
    voxrt_gi_destroy(r.gi);
}

/* The same for lights, cameras and tolerances at random; the reference has noise, too. */
TEST(noise_of_random_views) {
    enum { W = 30, H = 20, N = W * H };
    static room r;
    static float truth[N][3];
    const uint32_t count = test_quick() ? 8 : 128;
    double sum = 0, worst = 0, least = 1e9;
    uint32_t k, i, n = 0;
    room_open(&r, W, H, 0);
    for (k = 0; k < count; k++) {
        test_rng rng = test_rng_make(770 + k);
        voxrt_gi_render_desc d;
        voxrt_gi_report report;
        double e;
        memset(&d, 0, sizeof d);
        for (i = 0; i < 3; i++) {
            const float low = i == 1 ? -4 : -7.5f; /* the block is lower */
            r.light.position[i] = low + (7.5f - low) * test_rng_float(&rng);
            r.camera.eye[i] = low + (7.5f - low) * test_rng_float(&rng);
            r.camera.at[i] = 12 * test_rng_float(&rng) - 6;
        }
        r.camera.fov_y = 40 + 40 * test_rng_float(&rng);
        CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK && voxrt_gi_update(r.gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gbuffer_from_gi(&r.gi->env, &r.camera, r.gi, &r.g) == VOXRT_OK);
        for (i = 0; i < N; i++) r.albedo[i][0] = r.albedo[i][1] = r.albedo[i][2] = 1;
        d.rays = 768;
        d.first_ray = 1u << 20;
        d.report = &report;
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, truth[0], NULL) == VOXRT_OK);
        if (report.pixels < N) continue;
        d.rays = d.first_ray = 0;
        d.tolerance = (float)(0.05 * pow(6, test_rng_double(&rng)));
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        e = rms(r.indirect, truth, N);
        if (test_g.verbose) printf("%3u: asked %.3f, said %.3f, is %.3f, %u rays\n", k, (double)d.tolerance, (double)report.noise, e, report.rays);
        CHECK_MSG(report.noise <= d.tolerance, "view %u: %g of %g", k, (double)report.noise, (double)d.tolerance);
        e /= (double)report.noise;
        sum += e * e;
        worst = fmax(worst, e);
        least = fmin(least, e);
        n++;
    }
    if (test_g.verbose) printf("root of the mean square %.3f, %.3f .. %.3f of what was said, %u views\n", sqrt(sum / n), least, worst, n);
    CHECK(3 * n > count && sqrt(sum / n) < 1.05 && sqrt(sum / n) > 0.8 && worst < 1.4);
    voxrt_gi_destroy(r.gi);
}

TEST(history_of_a_still_scene_is_the_mean) { /* n pictures of 4 rays: one of 4 n */
    static room r;
    static float many[48 * 32][3];
    voxrt_gi_history *h = NULL;
    voxrt_gi_render_desc d;
    voxrt_gi_report report;
    uint32_t i, k;
    double worst = 0;
    room_open(&r, 48, 32, 0);
    memset(&d, 0, sizeof d);
    d.camera = r.camera;
    d.rays = 32;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, r.direct[0], many[0], NULL) == VOXRT_OK);
    CHECK(voxrt_gi_history_create(NULL, &h) == VOXRT_OK);
    d.history = h;
    d.report = &report;
    d.rays = 4;
    for (i = 0; i < 8; i++) {
        CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK); /* the same: no change */
        CHECK(voxrt_gi_update(r.gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, r.direct[0], r.indirect[0], NULL) == VOXRT_OK);
        CHECK(report.kept == (i == 0 ? 0.0f : 1.0f));
    }
    for (i = 0; i < 48 * 32; i++)
        for (k = 0; k < 3; k++) worst = fmax(worst, fabs((double)r.indirect[i][k] - (double)many[i][k]));
    CHECK_MSG(worst < 1e-4, "%g", worst);
    d.radius = 2.0f; /* other settings: from the start */
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, r.direct[0], r.indirect[0], NULL) == VOXRT_OK && report.kept == 0);
    voxrt_gi_history_destroy(h);
    voxrt_gi_history_destroy(NULL);
    voxrt_gi_destroy(r.gi);
}

TEST(history_follows_changes) { /* lamp off and on, with the camera still and moving; then all move */
    static room r;
    static float truth[64 * 40][3];
    voxrt_gi_history *h = NULL;
    voxrt_gi_render_desc d;
    voxrt_gi_report report;
    voxrt_gi_light dark;
    uint32_t i, still;
    double sum, bright = 0, plain;
    const size_t n = 64 * 40;
    room_open(&r, 64, 40, 0);
    CHECK(voxrt_gi_history_create(NULL, &h) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    d.camera = r.camera;
    d.history = h;
    d.report = &report;
    d.rays = 4;
    for (still = 0; still < 2; still++) {
        for (i = 0; i < 6; i++) CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        for (i = 0, bright = 0; i < n; i++) bright += (double)r.indirect[i][1];
        dark = point_light(3, 6, 2, 1e-6f);
        CHECK(voxrt_gi_set_lights(r.gi, &dark, 1) == VOXRT_OK);
        for (i = 0; i < 4; i++) {
            d.camera.eye[0] += still ? 0.0f : 1e-4f;
            CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        }
        for (i = 0, sum = 0; i < n; i++) sum += (double)r.indirect[i][1];
        CHECK_MSG(sum < 0.02 * bright, "off: %.4f is left", sum / bright);
        CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK);
        for (i = 0; i < 8; i++) {
            d.camera.eye[0] += still ? 0.0f : 1e-4f;
            CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        }
        for (i = 0, sum = 0; i < n; i++) sum += (double)r.indirect[i][1];
        CHECK_MSG(sum > 0.9 * bright, "on: %.4f is there", sum / bright);
    }
    for (i = 0; i < 8; i++) { /* camera and block go on their way: history must beat the picture alone */
        r.camera.eye[0] -= 0.1f;
        r.object.to_world[3] += 0.15;
        CHECK(voxrt_gi_set(r.gi, r.id, &r.object) == VOXRT_OK);
        CHECK(voxrt_gi_update(r.gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gbuffer_from_gi(NULL, &r.camera, r.gi, &r.g) == VOXRT_OK);
        CHECK(voxrt_gbuffer_materials(NULL, r.gi, &r.g) == VOXRT_OK);
        d.camera = r.camera;
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        CHECK_MSG(report.kept > 0.85f && report.kept < 1.0f, "%g", (double)report.kept);
    }
    { /* points on the block were 0.15 to the left of where they are */
        uint32_t on = 0;
        for (i = 0; i < n; i++) on += fabs((double)(r.position[i][0] - r.before[i][0]) - 0.15) < 1e-4;
        CHECK_MSG(on > 50 && on < n / 2, "%u", on);
    }
    d.history = NULL;
    d.rays = 64;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, truth[0], NULL) == VOXRT_OK);
    sum = rms(r.indirect, truth, n);
    d.rays = 4;
    d.first_ray = 12345;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    plain = rms(r.indirect, truth, n);
    CHECK_MSG(sum < 0.6 * plain, "%.4f with history, %.4f without", sum, plain);
    voxrt_gi_history_destroy(h);
    voxrt_gi_destroy(r.gi);
}

TEST(nested_volumes) { /* from the middle of the inner one rays reach a lit sphere in the outer one: irradiance q */
    static model m;
    static float position[16][3], normal[16][3], albedo[16][3], indirect[16][3];
    voxrt_gi_desc gd;
    voxrt_gi_render_desc d;
    voxrt_gi *gi = NULL, *other = NULL;
    voxrt_gi_light light = point_light(0, 0, 0, 81);
    voxrt_gi_object o;
    voxrt_gbuffer g;
    voxrt_gi_update_stats su;
    const double centre[3] = {1.7, 0, -0.4};
    double sum = 0;
    const double q = voxrti_srgb_to_linear(floor(255 * voxrti_linear_to_srgb(0.5) + 0.5) / 255.0);
    uint32_t i, k, moved = 9, known = 0, all = 0;
    memset(&gd, 0, sizeof gd);
    gd.columns.size_x = gd.columns.size_y = gd.columns.size_z = 64;
    for (i = 0; i < 3; i++) {
        gd.columns.box_min[i] = -2.5;
        gd.columns.box_max[i] = 2.5;
    }
    gd.nested = 9;
    CHECK(voxrt_gi_create(&gd, &gi) == VOXRT_ERR_INVALID_ARG && gi == NULL);
    gd.nested = 3;
    CHECK(voxrt_gi_create(&gd, &gi) == VOXRT_OK);
    sphere(&m, 9.0, 60, (uint8_t)floor(255 * voxrti_linear_to_srgb(0.5) + 0.5), 1);
    o = object_of(&m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, &su) == VOXRT_OK && su.still_cells > 1000);
    g = gbuffer_of(16, 1, position, normal, albedo);
    rng_state = 23;
    for (i = 0; i < 16; i++) {
        for (k = 0; k < 3; k++) {
            position[i][k] = (float)(3 * (2 * rnd() - 1)); /* some in the second volume */
            normal[i][k] = (float)(2 * rnd() - 1);
            albedo[i][k] = 1;
        }
        CHECK(voxrti_normalize(normal[i]));
    }
    memset(&d, 0, sizeof d);
    d.rays = 256;
    CHECK(voxrt_gi_render(&d, gi, &g, NULL, indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < 16; i++) {
        const double e = 3.14159265358979 * (double)indirect[i][0] / q;
        CHECK_MSG(fabs(e - 1) < 0.04, "point %u: %.4f", i, e);
        sum += e / 16;
    }
    CHECK_MSG(fabs(sum - 1) < 0.02, "%.4f", sum);
    CHECK(voxrt_gi_bounce(gi, NULL, 4, 0, 0) == VOXRT_OK);
    CHECK(voxrt_gi_follow(gi, centre, &moved) == VOXRT_OK);
    CHECK_MSG(moved == 3, "%u", moved); /* by steps of 0.625, 1.25, 2.5 */
    CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
    { /* the same bits as volumes that were there from the start */
        const voxrt_gi *a = gi, *b;
        for (i = 0; i < 3; i++, a = a->outer) {
            voxrt_gi_desc one = gd;
            for (k = 0; k < 3; k++) {
                one.columns.box_min[a->columns->axis[k]] = a->columns->origin[k];
                one.columns.box_max[a->columns->axis[k]] = a->columns->origin[k] + 64 * a->columns->cell[k];
            }
            one.nested = 1;
            one.columns.depth_axis_plus_1 = a->columns->axis[2] + 1;
            CHECK(voxrt_gi_create(&one, &other) == VOXRT_OK);
            CHECK(voxrt_gi_add(other, &o, NULL) == VOXRT_OK && voxrt_gi_update(other, NULL) == VOXRT_OK);
            b = other;
            CHECK(memcmp(a->columns->bits, b->columns->bits, 4 * (size_t)64 * 64 * 2) == 0);
            voxrt_gi_destroy(other);
        }
        for (i = 0; i < 2 * gi->outer->layer[0].count; i++) { /* what bounced stayed where it was */
            const voxrti_gi_layer *l = &gi->outer->outer->layer[0];
            if (i >= 2 * l->count || l->record[i / 2].area[i % 2] == 0) continue;
            all++;
            known += l->bounce[i] != VOXRTI_GI_UNKNOWN;
        }
        CHECK_MSG(known == all, "%u of %u", known, all);
    }
    voxrt_gi_destroy(gi);
}

TEST(bounced_light_moves_with_objects) { /* a lit block that moves and turns keeps what it knew */
    static room r;
    uint32_t i, frame, known = 0, all = 0;
    room_open(&r, 8, 8, 0);
    CHECK(voxrt_gi_bounce(r.gi, NULL, 4, 0, 0) == VOXRT_OK);
    for (frame = 1; frame <= 3; frame++) {
        const double a = 0.1 * frame;
        r.object.to_world[0] = r.object.to_world[10] = cos(a);
        r.object.to_world[2] = sin(a);
        r.object.to_world[8] = -sin(a);
        r.object.to_world[3] += 0.5;
        CHECK(voxrt_gi_set(r.gi, r.id, &r.object) == VOXRT_OK);
        CHECK(voxrt_gi_update(r.gi, NULL) == VOXRT_OK);
    }
    for (i = 0; i < 2 * r.gi->layer[1].count; i++) {
        if (r.gi->layer[1].record[i / 2].area[i % 2] == 0) continue;
        all++;
        known += r.gi->layer[1].bounce[i] != VOXRTI_GI_UNKNOWN;
    }
    CHECK_MSG(all > 500 && known > all * 95 / 100, "%u of %u", known, all);
    voxrt_gi_destroy(r.gi);
}

TEST(time_budget) { /* a machine that takes 10 ms and 1 us a ray: after a few frames, frames take what they may */
    static const float target[4] = {16, 50, 200, 2000};
    uint32_t i, f;
    for (i = 0; i < 4; i++) {
        voxrt_gi_budget b;
        voxrt_gi_report r;
        double ms = 0;
        memset(&b, 0, sizeof b);
        memset(&r, 0, sizeof r);
        CHECK(voxrt_gi_budget_update(&b, NULL, 0, 0, 0) == 0 && b.rays == 4 && b.coarse == 1);
        for (f = 0; f < 10; f++) {
            r.pixels = 10000;
            r.shaded = 10000 / (b.coarse < 4 ? b.coarse * b.coarse : 16);
            r.rays = b.rays;
            ms = 10 + 1e-3 * (double)r.shaded * (double)r.rays;
            (void)voxrt_gi_budget_update(&b, &r, (float)ms, (float)(ms - 10), target[i]);
        }
        CHECK_MSG(ms < 1.1 * (double)target[i] && (ms > 0.5 * (double)target[i] || b.rays == 64),
                  "%g ms of %g: %u rays, coarse %u", ms, (double)target[i], b.rays, b.coarse);
        CHECK(voxrt_gi_budget_update(&b, &r, NAN, 1, 10) == 0);
    }
    for (i = 1; i < 6; i++) { /* few rays at best: no more of them, and never none; times without end are none */
        for (f = 0; f < 40; f++) {
            static const float ms[4] = {1000, 1e-3f, 3, 1};
            voxrt_gi_budget b;
            voxrt_gi_report r;
            uint32_t k;
            memset(&b, 0, sizeof b);
            memset(&r, 0, sizeof r);
            b.most = i;
            b.coarse = f < 20 ? 0 : 8;
            CHECK(voxrt_gi_budget_update(&b, NULL, 0, 0, 0) == 0 && b.rays >= 1 && b.rays <= i);
            r.shaded = r.rays = 100;
            r.pixels = 1u << f % 20;
            for (k = 0; k < 6; k++) {
                (void)voxrt_gi_budget_update(&b, &r, ms[(f + k) % 4], ms[(f + k) % 4], 1);
                CHECK_MSG(b.rays >= 1 && b.rays <= i, "%u rays, %u at best", b.rays, i);
            }
            CHECK(voxrt_gi_budget_update(&b, &r, 1, INFINITY, 10) == 0 && voxrt_gi_budget_update(&b, &r, 1, 1, INFINITY) == 0);
            CHECK(b._ray_ms < INFINITY);
        }
    }
}

TEST(nothing_leaks_through_a_thin_wall) { /* a room of single triangles, a wall of 0.1 cells in the middle, light on one side */
    static model m;
    static float position[64][3], normal[64][3], albedo[64][3], direct[64][3], indirect[64][3];
    voxrt_gi *gi = make_gi(64, 64, 64, 10);
    voxrt_gi_light light = point_light(-5, 1, 2, 50.0f);
    voxrt_gbuffer g;
    voxrt_gi_render_desc d;
    voxrt_gi_object o;
    double sum[2] = {0, 0};
    uint32_t i, k, wall;
    m.points = m.triangles = 0;
    for (k = 0; k < 3; k++)
        for (wall = 0; wall < 2; wall++) {
            double p[4][3];
            for (i = 0; i < 4; i++) {
                p[i][k] = wall ? 9.0 : -9.0;
                p[i][(k + 1) % 3] = (i + 1) % 4 < 2 ? -9.0 : 9.0;
                p[i][(k + 2) % 3] = i < 2 ? -9.0 : 9.0;
            }
            quad(&m, p[0], p[1], p[2], p[3], 220);
        }
    for (wall = 0; wall < 2; wall++) { /* tilted */
        double p[4][3];
        const double x = wall ? 0.031 : 0.0;
        for (i = 0; i < 4; i++) {
            p[i][1] = (i + 1) % 4 < 2 ? -9.0 : 9.0;
            p[i][2] = i < 2 ? -9.0 : 9.0;
            p[i][0] = x + 0.1 * p[i][1] + 0.07 * p[i][2];
        }
        quad(&m, p[0], p[wall ? 1 : 3], p[2], p[wall ? 3 : 1], 220);
    }
    o = object_of(&m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
    for (i = 0; i < 3; i++) CHECK(voxrt_gi_bounce(gi, NULL, 16, 0.0f, i) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    g = gbuffer_of(64, 1, position, normal, albedo);
    for (i = 0; i < 64; i++) { /* the floor, left and right */
        position[i][0] = (float)(i < 32 ? -8.5 + 0.2 * i : 8.5 - 0.2 * (i - 32));
        position[i][1] = -9.0f;
        position[i][2] = 0.3f;
        normal[i][1] = 1.0f;
        albedo[i][0] = albedo[i][1] = albedo[i][2] = 1.0f;
    }
    d.rays = 128;
    CHECK(voxrt_gi_render(&d, gi, &g, direct[0], indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < 64; i++) sum[i / 32] += (double)direct[i][0] + (double)indirect[i][0];
    CHECK(sum[0] > 1.0);
    CHECK_MSG(sum[1] / sum[0] < 0.005, "%.5f of the light", sum[1] / sum[0]);
    voxrt_gi_destroy(gi);
}

/* A room of +-9, its floor wherever in its cell, a wall of 0.1 cells that may lean: light behind it, at its foot. axis:
   which one is up; turned: or down. Returns the worst share of the light before it that is within five cells behind it, direct and indirect. */
static double light_at_feet(uint32_t axis, int turned, double within, double wall_x, double lean, uint32_t quality) {
    enum { BEFORE = 64, BEHIND = 192 };
    static model m;
    static float position[256][3], normal[256][3], albedo[256][3], direct[256][3], indirect[256][3];
    const double cell = 20.0 / 64, low = (3.0 + within) * cell - 10.0;
    const uint32_t side = (axis + 1) % 3, along = (axis + 2) % 3;
    voxrt_gi *gi = make_gi(64, 64, 64, 10);
    voxrt_gi_light light = point_light(0, 0, 0, 100.0f);
    voxrt_gbuffer g;
    voxrt_gi_render_desc d;
    voxrt_gi_object o;
    double sum[2] = {0, 0};
    uint32_t i, k, wall;
    light.position[side] = -5.0f;
    m.points = m.triangles = 0;
    for (k = 0; k < 3; k++)
        for (wall = 0; wall < 2; wall++) {
            double p[4][3];
            for (i = 0; i < 4; i++) {
                p[i][k] = wall ? 9.0 : -9.0;
                p[i][(k + 1) % 3] = (i + 1) % 4 < 2 ? -9.0 : 9.0;
                p[i][(k + 2) % 3] = i < 2 ? -9.0 : 9.0;
                if (p[i][axis] < 0.0) p[i][axis] = low;
            }
            quad(&m, p[wall ? 3 : 0], p[wall ? 2 : 1], p[wall ? 1 : 2], p[wall ? 0 : 3], 180);
        }
    for (wall = 0; wall < 2; wall++) {
        double p[4][3];
        for (i = 0; i < 4; i++) {
            p[i][axis] = (i + 1) % 4 < 2 ? low : 9.0;
            p[i][along] = i < 2 ? -9.0 : 9.0;
            p[i][side] = wall_x + (wall ? 0.1 * cell : 0.0) + lean * (p[i][axis] - low);
        }
        quad(&m, p[0], p[wall ? 1 : 3], p[2], p[wall ? 3 : 1], 180);
    }
    for (i = 0; i < m.points && turned; i++) m.p[i][axis] = 0.0f - m.p[i][axis];
    for (i = 0; i < m.triangles && turned; i++) {
        const uint32_t v = m.index[i][1];
        m.index[i][1] = m.index[i][2];
        m.index[i][2] = v;
    }
    o = object_of(&m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_bounce(gi, NULL, 16, 0.0f, 1) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    g = gbuffer_of(256, 1, position, normal, albedo);
    for (i = 0; i < BEFORE + BEHIND; i++) {
        const double off = i < BEFORE ? -0.4 - 7.6 * i / BEFORE : cell * (0.6 + 4.4 * (i - BEFORE) / BEHIND);
        position[i][axis] = (float)(turned ? -low : low);
        position[i][side] = (float)(wall_x + off);
        position[i][along] = (float)(16.0 * fmod(i * 0.6180339887, 1.0) - 8.0);
        normal[i][0] = normal[i][1] = normal[i][2] = 0.0f;
        normal[i][axis] = turned ? -1.0f : 1.0f;
        albedo[i][0] = albedo[i][1] = albedo[i][2] = 1.0f;
    }
    d.rays = quality;
    CHECK(voxrt_gi_render(&d, gi, &g, direct[0], indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < BEFORE + BEHIND; i++)
        sum[i >= BEFORE] += ((double)direct[i][0] + (double)indirect[i][0]) / (i < BEFORE ? BEFORE : BEHIND);
    CHECK(sum[0] > 0.1);
    voxrt_gi_destroy(gi);
    return sum[1] / sum[0];
}

TEST(feet_of_walls_let_nothing_through) { /* wherever floor and wall lie in their cells */
    static const double leans[4] = {0.0, 0.3, -0.3, 0.7}, within[8] = {0.02, 0.14, 0.27, 0.4, 0.53, 0.66, 0.8, 0.93};
    uint32_t axis, place, way;
    for (axis = 0; axis < 3; axis++)
        for (place = test_quick() ? axis : 0; place < 8; place += test_quick() ? 3 : 1)
            for (way = 0; way < (test_quick() ? 1u : 4u); way++) {
                const double lean = leans[test_quick() ? (axis + place) % 4 : way], x = lean < 0.5 ? 0.04 * ((3 * place) % 8) + 0.013 : 0.025;
                const double leak = light_at_feet(axis, (int)(place / 2 + way) & 1, within[place], x, lean, test_quick() ? 64 : 256);
                CHECK_MSG(leak < (lean < 0.5 ? 0.002 : 0.01), "axis %u, floor at %.2f of its cell, lean %.1f: %.5f of the light", axis,
                          within[place], lean, leak);
            }
}

/* One model that does not move, in 128 x 128 x 128 cells of 1. */
static voxrt_gi *alone(const model *m) {
    voxrt_gi *gi = make_gi(128, 128, 128, 64);
    const voxrt_gi_object o = object_of(m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
    return gi;
}

TEST(feet_end_where_walls_end) { /* a wall that ends at z = 0 hides half as much there as an endless one; a sheet on the floor hides nothing */
    static model m;
    static float position[64][3], normal[64][3], albedo[64][3], open[64][3];
    const double h = 25.0, cell = 1.0;
    uint32_t i, place, what;
    for (place = 0; place < 4; place++)
        for (what = 0; what < 2; what++) {
            const double floor_y = -20.0 + 0.3 * place, wall_x = 10.4, sheet_y = floor_y + 0.3 * cell;
            const double f[4][3] = {{-500, floor_y, 500}, {500, floor_y, 500}, {500, floor_y, -500}, {-500, floor_y, -500}};
            const double w[4][3] = {{wall_x, floor_y, -500}, {wall_x, floor_y, 0}, {wall_x, floor_y + h, 0}, {wall_x, floor_y + h, -500}};
            const double s[4][3] = {{wall_x, sheet_y, 500}, {500, sheet_y, 500}, {500, sheet_y, -500}, {wall_x, sheet_y, -500}};
            const double e[4][3] = {{wall_x, floor_y, -500}, {wall_x, floor_y, 500}, {wall_x, sheet_y, 500}, {wall_x, sheet_y, -500}};
            double sum[2] = {0, 0};
            voxrt_gi *gi;
            voxrt_gbuffer g;
            voxrt_gi_render_desc d;
            m.points = m.triangles = 0;
            quad(&m, f[0], f[1], f[2], f[3], 255);
            if (what == 0) quad(&m, w[0], w[1], w[2], w[3], 255);
            else {
                quad(&m, s[0], s[1], s[2], s[3], 255);
                quad(&m, e[0], e[1], e[2], e[3], 255);
            }
            gi = alone(&m);
            memset(&d, 0, sizeof d);
            g = gbuffer_of(64, 1, position, normal, albedo);
            for (i = 0; i < 64; i++) {
                const double a = 1.2 + 0.25 * (i / 4);
                position[i][0] = (float)(wall_x - a);
                position[i][1] = (float)floor_y;
                position[i][2] = 0.25f * (float)(i % 4) - 0.375f;
                normal[i][0] = normal[i][2] = 0.0f;
                normal[i][1] = 1.0f;
                sum[1] += what == 0 ? 0.25 * (1 - a / sqrt(a * a + h * h)) / 64 : 0.0;
            }
            d.method = VOXRT_GI_AO;
            d.rays = 1024;
            CHECK(voxrt_gi_render(&d, gi, &g, NULL, open[0], NULL) == VOXRT_OK);
            for (i = 0; i < 64; i++) sum[0] += (1 - (double)open[i][0]) / 64;
            CHECK_MSG(fabs(sum[0] - sum[1]) < 0.015, "%s, floor %u: %.4f, not %.4f", what ? "sheet" : "wall", place, sum[0], sum[1]);
            voxrt_gi_destroy(gi);
        }
}

/* A floor and one side of a wall that ends at z = 0, in cells of 1; nested: there are smaller ones elsewhere. Light of a lamp on the floor, at p,
   as a share of what there would be without the wall. */
static double past_a_foot(double floor_y, double wall_x, int turned, int nested, int moving, const double p[3], const double lamp[3]) {
    static model m;
    float position[1][3], normal[1][3] = {{0, 1, 0}}, albedo[1][3], direct[1][3];
    const double f[4][3] = {{-500, floor_y, 500}, {500, floor_y, 500}, {500, floor_y, -500}, {-500, floor_y, -500}};
    const double w[4][3] = {{wall_x, floor_y, -500}, {wall_x, floor_y, 0}, {wall_x, floor_y + 9, 0}, {wall_x, floor_y + 9, -500}};
    const voxrt_gi_light light = point_light((float)lamp[0], (float)lamp[1], (float)lamp[2], 1.0f);
    double to[3], far2 = 0;
    voxrt_gbuffer g;
    voxrt_gi_render_desc d;
    voxrt_gi_desc gd;
    voxrt_gi *gi = NULL;
    voxrt_gi_object o;
    uint32_t a;
    m.points = m.triangles = 0;
    quad(&m, f[0], f[1], f[2], f[3], 255);
    quad(&m, w[0], w[turned ? 3 : 1], w[2], w[turned ? 1 : 3], 255);
    memset(&gd, 0, sizeof gd);
    gd.columns.size_x = gd.columns.size_y = gd.columns.size_z = 128;
    gd.nested = nested ? 2 : 1;
    for (a = 0; a < 3; a++) {
        gd.columns.box_max[a] = nested ? 32 : 64;
        gd.columns.box_min[a] = -gd.columns.box_max[a];
    }
    o = object_of(&m, !moving);
    CHECK(voxrt_gi_create(&gd, &gi) == VOXRT_OK && voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    g = gbuffer_of(1, 1, position, normal, albedo);
    for (a = 0; a < 3; a++) {
        position[0][a] = (float)p[a];
        albedo[0][a] = 1.0f;
        to[a] = lamp[a] - p[a];
        far2 += to[a] * to[a];
    }
    CHECK(voxrt_gi_render(&d, gi, &g, direct[0], NULL, NULL) == VOXRT_OK);
    voxrt_gi_destroy(gi);
    return (double)direct[0][0] * 3.14159265 * far2 * sqrt(far2) / to[1];
}

TEST(feet_stop_light_on_their_own_side) { /* low lamps: before the wall in the cell of its foot, past its end, behind it */
    uint32_t place, turned;
    for (place = 0; place < 4; place++)
        for (turned = 0; turned < 2; turned++) {
            const int nested = place % 2 != 0, moving = place > 1;
            const double y = -20.0 + 0.04 + 0.21 * place, x = nested ? 50.55 : 10.55, h = y + 0.3;
            const double at[3] = {x - 3.4, y, -7.3}, before[3] = {x - 0.3, h, -7.2}, behind[3] = {x + 0.4, h, -7.2};
            const double by[3] = {x - 0.3, y, -1.5}, past[3] = {x + 1.0, h, 10.0}, hidden[3] = {x + 1.0, h, 1.0};
            double part[4];
            part[0] = past_a_foot(y, x, (int)turned, nested, moving, at, before);
            part[1] = past_a_foot(y, x, (int)turned, nested, moving, at, behind);
            part[2] = past_a_foot(y, x, (int)turned, nested, moving, by, past);
            part[3] = past_a_foot(y, x, (int)turned, nested, moving, by, hidden);
            CHECK_MSG(fabs(part[0] - 1) < 0.01 && fabs(part[2] - 1) < 0.01 && part[1] < 1e-6 && part[3] < 1e-6,
                      "place %u, turned %u: before %.3f, behind %.3f, past %.3f, hidden %.3f", place, turned, part[0], part[1], part[2], part[3]);
        }
}

TEST(openness_is_a_form_factor) { /* a wall of height h at distance a hides 1/2 (1 - a / sqrt(a^2 + h^2)) */
    static model m;
    static float position[16][3], normal[16][3], albedo[16][3], open[16][3];
    voxrt_gi *gi;
    voxrt_gbuffer g;
    voxrt_gi_render_desc d;
    uint32_t i;
    const double floor_y = -20.2, wall_x = 10.4, h = 25.0;
    const double f[4][3] = {{-500, floor_y, 500}, {500, floor_y, 500}, {500, floor_y, -500}, {-500, floor_y, -500}};
    const double w[4][3] = {{wall_x, floor_y, -500}, {wall_x, floor_y, 500}, {wall_x, floor_y + h, 500}, {wall_x, floor_y + h, -500}};
    m.points = m.triangles = 0;
    quad(&m, f[0], f[1], f[2], f[3], 255);
    quad(&m, w[0], w[1], w[2], w[3], 255);
    gi = alone(&m);
    memset(&d, 0, sizeof d);
    g = gbuffer_of(16, 1, position, normal, albedo);
    for (i = 0; i < 16; i++) {
        position[i][0] = (float)(wall_x - 1.7 - 2.0 * i);
        position[i][1] = (float)floor_y;
        normal[i][1] = 1.0f;
    }
    d.method = VOXRT_GI_AO;
    d.rays = 2048;
    CHECK(voxrt_gi_render(&d, gi, &g, NULL, open[0], NULL) == VOXRT_OK);
    for (i = 0; i < 16; i++) {
        const double a = 1.7 + 2.0 * i, want = 0.5 * (1 - a / sqrt(a * a + h * h));
        CHECK_MSG(fabs(1 - (double)open[i][0] - want) < 0.03, "at %.1f: %.4f, not %.4f", a, 1 - (double)open[i][0], want);
    }
    voxrt_gi_destroy(gi);
}

TEST(threads_and_instruction_sets) {
    static model a, b;
    enum { W = 40, H = 24 };
    static float position[W * H][3], normal[W * H][3], albedo[W * H][3], direct[W * H][3], indirect[W * H][3], first[2][W * H][3];
    voxrt_gi_light lights[4];
    voxrt_camera camera;
    voxrt_gbuffer g;
    uint32_t way, k;
    g = gbuffer_of(W, H, position, normal, albedo);
    sphere(&a, 9.0, 40, 200, 1);
    sphere(&b, 3.0, 20, 120, 0);
    memset(lights, 0, sizeof lights);
    lights[0] = point_light(3, 5, 1, 40);
    lights[1] = point_light(-3, 4, 2, 60);
    lights[1].kind = VOXRT_GI_SPOT;
    lights[1].direction[1] = -1;
    lights[1].angle = 50;
    lights[2].kind = VOXRT_GI_AREA;
    lights[2].position[1] = 7;
    lights[2].edge_u[0] = 1;
    lights[2].edge_v[2] = 1;
    lights[2].color[0] = 9;
    lights[3].kind = VOXRT_GI_DIRECTIONAL;
    lights[3].direction[0] = 1;
    lights[3].color[1] = 0.5f;
    memset(&camera, 0, sizeof camera);
    camera.eye[2] = 7.0f;
    camera.fov_y = 60.0f;
    for (way = 0; way < 5; way++) {
        voxrt_gi *gi = make_gi(64, 64, 64, 10);
        voxrt_gi_object oa = object_of(&a, 1), ob = object_of(&b, 0);
        voxrt_gi_render_desc d;
        voxrt_stats stats;
        memset(&d, 0, sizeof d);
        memset(&stats, 0, sizeof stats);
        gi->env.thread_count = way == 1 ? 5 : way == 0 ? 1 : 2;
        d.env.thread_count = way == 1 ? 5 : way == 0 ? 1 : 2;
        d.isa = way == 2 ? VOXRT_ISA_SCALAR : way == 4 ? VOXRT_ISA_AVX2 : VOXRT_ISA_AUTO;
        CHECK(voxrt_gi_add(gi, &oa, NULL) == VOXRT_OK && voxrt_gi_add(gi, &ob, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_set_lights(gi, lights, 4) == VOXRT_OK);
        CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_bounce(gi, &d.env, 4, 0.5f, 3) == VOXRT_OK);
        CHECK(voxrt_gbuffer_from_gi(&d.env, &camera, gi, &g) == VOXRT_OK);
        d.rays = 4;
        d.filter = way == 3 ? 0 : 3;
        CHECK(voxrt_gi_render(&d, gi, &g, direct[0], indirect[0], &stats) == VOXRT_OK);
        CHECK(stats.rays >= 4 * (uint64_t)W * H * 9 / 10); /* some see no side of a cell */
        CHECK_MSG(stats.hits >= stats.rays - stats.rays / 100, "%lu of %lu", (unsigned long)stats.hits, (unsigned long)stats.rays);
        if (way == 0) {
            memcpy(first[0], direct, sizeof direct);
            memcpy(first[1], indirect, sizeof indirect);
            for (k = 0; k < W * H; k++) {
                CHECK(direct[k][0] >= 0 && indirect[k][0] >= 0 && direct[k][0] < 1e6f && indirect[k][0] < 1e6f);
            }
        } else {
            CHECK(memcmp(first[0], direct, sizeof direct) == 0);
            CHECK((memcmp(first[1], indirect, sizeof indirect) == 0) == (way != 3)); /* unfiltered is something else */
        }
        voxrt_gi_destroy(gi);
    }
}

TEST(threads_and_instruction_sets_in_all_methods) { /* the same bits: virtual lights, lobes, maps, meshes, history, tolerance, nested */
    enum { W = 24, H = 12, WAYS = 7 };
    static model a, b;
    static float position[W * H][3], normal[W * H][3], albedo[W * H][3], specular[W * H][4], emission[W * H][3], before[W * H][3];
    static float direct[W * H][3], indirect[W * H][3], first[WAYS][2][W * H][3];
    voxrt_gi_light lights[3];
    voxrt_camera camera;
    voxrt_gbuffer g;
    uint32_t run, way, k;
    g = gbuffer_of(W, H, position, normal, albedo);
    g.specular = specular[0];
    g.emission = emission[0];
    g.before = before[0];
    sphere(&a, 9.0, 40, 200, 1);
    sphere(&b, 3.0, 20, 120, 0);
    memset(lights, 0, sizeof lights);
    lights[0] = point_light(3, 5, 1, 40);
    lights[1] = point_light(-3, 4, 2, 60);
    lights[1].kind = VOXRT_GI_SPOT;
    lights[1].direction[1] = -1;
    lights[1].angle = 50;
    lights[2].kind = VOXRT_GI_DIRECTIONAL;
    lights[2].direction[0] = 1;
    lights[2].color[1] = 0.5f;
    memset(&camera, 0, sizeof camera);
    camera.eye[2] = 7.0f;
    camera.fov_y = 60.0f;
    for (run = 0; run < 4; run++)
        for (way = 0; way < WAYS; way++) {
            voxrt_gi_desc gd;
            voxrt_gi *gi = NULL;
            voxrt_gi_history *h = NULL;
            voxrt_gi_object oa = object_of(&a, 1), ob = object_of(&b, 0);
            voxrt_gi_render_desc d;
            memset(&gd, 0, sizeof gd);
            memset(&d, 0, sizeof d);
            gd.env.thread_count = d.env.thread_count = run == 1 ? 3 : 1;
            gd.columns.size_x = gd.columns.size_y = gd.columns.size_z = 64;
            gd.nested = way == 6 ? 2 : 1;
            for (k = 0; k < 3; k++) {
                gd.columns.box_min[k] = way == 6 ? -5 : -10;
                gd.columns.box_max[k] = way == 6 ? 5 : 10;
            }
            d.isa = run == 2 ? VOXRT_ISA_SCALAR : run == 3 ? VOXRT_ISA_AVX2 : VOXRT_ISA_AUTO;
            CHECK(voxrt_gi_create(&gd, &gi) == VOXRT_OK && voxrt_gi_history_create(&d.env, &h) == VOXRT_OK);
            ob.material.specular[0] = ob.material.specular[1] = 0.4f;
            ob.material.exponent = 8;
            ob.material.emission[2] = 3;
            CHECK(voxrt_gi_add(gi, &oa, NULL) == VOXRT_OK && voxrt_gi_add(gi, &ob, NULL) == VOXRT_OK);
            CHECK(voxrt_gi_set_lights(gi, lights, 3) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
            CHECK(voxrt_gbuffer_from_gi(&d.env, &camera, gi, &g) == VOXRT_OK && voxrt_gbuffer_materials(&d.env, gi, &g) == VOXRT_OK);
            d.camera = camera;
            d.rays = 4;
            d.filter = d.direct_filter = 2;
            d.method = way == 0 ? VOXRT_GI_VPL : way == 1 ? VOXRT_GI_PATH : VOXRT_GI_GATHER;
            d.bounces = 2;
            d.pattern = 2;
            d.lookup = way == 2 ? VOXRT_GI_LOOKUP_RAYS : way == 3 ? VOXRT_GI_LOOKUP_MAPS : VOXRT_GI_LOOKUP_CACHE;
            d.map_size = 32;
            d.coarse = way == 4 ? 4 : 1;
            d.tolerance = way == 5 ? 0.3f : 0;
            d.history = way >= 4 ? h : NULL;
            for (k = 0; k < 2; k++) {
                lights[0].position[1] = k ? 5.5f : 5.0f;
                CHECK(voxrt_gi_set_lights(gi, lights, 3) == VOXRT_OK);
                CHECK(voxrt_gi_render(&d, gi, &g, direct[0], indirect[0], NULL) == VOXRT_OK);
            }
            for (k = 0; k < W * H; k++) CHECK(direct[k][0] >= 0 && indirect[k][0] >= 0 && direct[k][0] < 1e6f && indirect[k][0] < 1e6f);
            if (run == 0) {
                memcpy(first[way][0], direct, sizeof direct);
                memcpy(first[way][1], indirect, sizeof indirect);
            }
            CHECK_MSG(memcmp(first[way][0], direct, sizeof direct) == 0 && memcmp(first[way][1], indirect, sizeof indirect) == 0, "way %u, run %u", way, run);
            voxrt_gi_history_destroy(h);
            voxrt_gi_destroy(gi);
        }
}

TEST(filter_keeps_to_surfaces) { /* a constant stays one; nothing crosses a right-angled edge */
    enum { W = 32, H = 16 };
    static float position[W * H][3], normal[W * H][3], albedo[W * H][3], light[W * H][3];
    voxrt_gi *gi = make_gi(64, 64, 64, 10);
    voxrt_gbuffer g;
    voxrt_env none;
    voxrti_ask ask;
    uint32_t x, y, a;
    double worst = 0;
    memset(&none, 0, sizeof none);
    voxrti_ask_open(&ask, &none, 1);
    g = gbuffer_of(W, H, position, normal, albedo);
    for (y = 0; y < H; y++)
        for (x = 0; x < W; x++) { /* left half a floor, right half a wall */
            const uint32_t i = y * W + x;
            position[i][0] = x < W / 2 ? (float)x * 0.1f : W * 0.05f;
            position[i][1] = x < W / 2 ? 0.0f : (float)(x - W / 2) * 0.1f;
            position[i][2] = (float)y * 0.1f;
            normal[i][x < W / 2 ? 1 : 0] = x < W / 2 ? 1.0f : -1.0f;
            for (a = 0; a < 3; a++) light[i][a] = x < W / 2 ? 3.0f : 1.0f;
        }
    CHECK(voxrti_gi_filter_run(&ask, &g, gi->columns->diagonal, 5, light[0], &gi->mem) == VOXRT_OK);
    for (y = 0; y < H; y++)
        for (x = 0; x < W; x++) worst = fmax(worst, fabs((double)light[y * W + x][0] - (x < W / 2 ? 3.0 : 1.0)));
    CHECK_MSG(worst < 1e-5, "%g", worst);
    voxrt_gi_destroy(gi);
}

TEST(filters_leave_colours) { /* light is filtered, then coloured: a pattern of colours is as sharp as before */
    static room r;
    static float white[48 * 32][3];
    voxrt_gi_render_desc d;
    uint32_t i, a, bad = 0;
    room_open(&r, 48, 32, 0);
    memset(&d, 0, sizeof d);
    d.rays = 8;
    d.filter = 5;
    for (i = 0; i < 48 * 32; i++) for (a = 0; a < 3; a++) r.albedo[i][a] = 1;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, white[0], NULL) == VOXRT_OK);
    for (i = 0; i < 48 * 32; i++) for (a = 0; a < 3; a++) r.albedo[i][a] = (i + i / 48 + a) % 2 ? 0.75f : 0.125f;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < 48 * 32; i++) for (a = 0; a < 3; a++) bad += r.indirect[i][a] != white[i][a] * r.albedo[i][a];
    CHECK_MSG(bad == 0, "%u values", bad);
    voxrt_gi_destroy(r.gi);
}

TEST(units_of_light_do_not_matter) { /* lamps 2^40 times as bright or dark: the same bits, times that */
    static room r;
    static float first[48 * 32][3];
    static const float times[4] = {1.0f, 1099511627776.0f, 1.0f / 1099511627776.0f, 1.0f};
    voxrt_gi_render_desc d;
    uint32_t k, i, a, bad;
    for (k = 0; k < 4; k++) {
        room_open(&r, 48, 32, 0);
        memset(&d, 0, sizeof d);
        d.rays = 8;
        if (k == 3) { /* bounced light goes over from one unit to the other */
            r.light.color[0] = r.light.color[1] = r.light.color[2] = 80 * 65536.0f;
            CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK);
            CHECK(voxrt_gi_bounce(r.gi, NULL, 8, 0, 3) == VOXRT_OK);
            for (a = 0; a < 3; a++) r.light.color[a] = 80;
            CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK);
        } else {
            for (a = 0; a < 3; a++) r.light.color[a] *= times[k];
            CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK);
            CHECK(voxrt_gi_bounce(r.gi, NULL, 8, 0, 3) == VOXRT_OK);
        }
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        if (k == 0) memcpy(first, r.indirect, sizeof first);
        for (i = 0, bad = 0; i < 48 * 32 && k < 3; i++) for (a = 0; a < 3; a++) bad += r.indirect[i][a] != first[i][a] * times[k];
        CHECK_MSG(bad == 0, "times %g: %u values", (double)times[k], bad);
        for (i = 0, bad = 0; i < 48 * 32 && k == 3; i++) for (a = 0; a < 3; a++) bad += !(r.indirect[i][a] > first[i][a]);
        CHECK_MSG(bad < 48 * 32, "bounced light is gone: %u values", bad); /* it was 65536 times as bright */
        voxrt_gi_destroy(r.gi);
    }
}

TEST(many_rays_sum_up) { /* 2^19 rays in a closed sphere of constant radiance: what some of them say */
    static ball b;
    voxrt_gi_render_desc d;
    double few, many;
    ball_open(&b, 9.0, NULL);
    b.g.width = b.g.height = 1;
    memset(&d, 0, sizeof d);
    d.rays = 4096;
    few = ball_light(&b, &d);
    d.rays = 1u << (test_quick() ? 14 : 19);
    many = ball_light(&b, &d);
    CHECK_MSG(fabs(many / few - 1) < 2e-3, "%.6f, not %.6f", many, few);
    voxrt_gi_destroy(b.gi);
}

TEST(lamps_near_cells_give_no_more_than_they_send) { /* a floor under a lamp, from 4 cells to 1/20 of a cell above it: all
                                                         cells together get what it sends downwards */
    static const float height[4] = {0.05f, 0.3f, 1, 4};
    static model m;
    const double p[4][3] = {{-30, -30, 0.3}, {30, -30, 0.3}, {30, 30, 0.3}, {-30, 30, 0.3}};
    const float down[3] = {0, 0, -1};
    uint32_t k, x, y;
    m.points = m.triangles = 0;
    quad(&m, p[0], p[1], p[2], p[3], 255);
    for (k = 0; k < 4; k++) {
        voxrt_gi *gi = make_gi(64, 64, 64, 32);
        const voxrt_gi_object o = object_of(&m, 1);
        const voxrt_gi_light lamp = point_light(0.5f, 0.5f, 0.3f + height[k], 1);
        double sum = 0;
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_set_lights(gi, &lamp, 1) == VOXRT_OK);
        CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
        for (y = 0; y < 64; y++)
            for (x = 0; x < 64; x++) {
                voxrt_column_hit hit;
                voxrt_gi_surface s;
                memset(&hit, 0, sizeof hit);
                hit.cell[0] = x;
                hit.cell[1] = y;
                hit.cell[2] = 32;
                if (voxrt_gi_get(gi, &hit, down, &s)) sum += 3.14159265358979 * (double)s.radiance[0];
            }
        sum /= 6.28318530717959; /* 60 x 60 cells catch all but the rays that go nearly sideways */
        CHECK_MSG(sum > 0.84 && sum < 1.1, "%g cells above: %.3f of its light", (double)height[k], sum);
        voxrt_gi_destroy(gi);
    }
}

TEST(sheets_have_two_sides) { /* a sheet of two triangles, lit from above: from below it is black */
    static model m;
    static float position[16][3], normal[16][3], albedo[16][3], indirect[16][3];
    const double lit[4][3] = {{-9, 0, -9}, {-9, 0, 9}, {9, 0, 9}, {9, 0, -9}}; /* its front is up */
    voxrt_gi *gi = make_gi(64, 64, 64, 10);
    voxrt_gi_light light = point_light(0, 4, 0, 50);
    voxrt_gi_object o;
    voxrt_gi_render_desc d;
    voxrt_gbuffer g = gbuffer_of(16, 1, position, normal, albedo);
    double sum[2] = {0, 0};
    uint32_t i, a;
    m.points = m.triangles = 0;
    quad(&m, lit[0], lit[1], lit[2], lit[3], 200);
    o = object_of(&m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    for (i = 0; i < 16; i++) { /* above it, looking down, and below it, looking up */
        position[i][0] = (float)(i / 2) - 4;
        position[i][1] = i % 2 ? -6.0f : 6.0f;
        normal[i][1] = i % 2 ? 1.0f : -1.0f;
        for (a = 0; a < 3; a++) albedo[i][a] = 1;
    }
    memset(&d, 0, sizeof d);
    d.rays = 64;
    CHECK(voxrt_gi_render(&d, gi, &g, NULL, indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < 16; i++) sum[i % 2] += (double)indirect[i][0];
    CHECK_MSG(sum[0] > 0.5 && sum[1] == 0.0, "above %g, below %g", sum[0], sum[1]);
    voxrt_gi_destroy(gi);
}

TEST(still_scenes_come_to_rest) { /* frames as they are drawn of what moves, but nothing does: each differs from the one
                                     before by less than 0.2 %, and they do not drift */
    enum { N = 32 * 20 };
    const uint32_t frames = test_quick() ? 36 : 120;
    static room r;
    static float last[N][3], truth[N][3];
    voxrt_gi_history *h = NULL;
    voxrt_gi_render_desc d;
    uint32_t f, i;
    double worst = 0, mean[2] = {0, 0};
    room_open(&r, 32, 20, 0);
    REQUIRE(voxrt_gi_history_create(NULL, &h) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    d.camera = r.camera;
    d.filter = 3;
    for (f = 0; f < frames; f++) {
        d.history = h;
        d.rays = 16;
        CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK && voxrt_gi_update(r.gi, NULL) == VOXRT_OK); /* the same */
        if (f < 8) CHECK(voxrt_gi_bounce(r.gi, NULL, 4, 0.75f, 7) == VOXRT_OK); /* then it is at rest: the mean of all from there on */
        memcpy(last, r.indirect, sizeof last);
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        if (f >= 30) worst = fmax(worst, rms(r.indirect, last, N));
    }
    d.history = NULL;
    d.rays = 512;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, truth[0], NULL) == VOXRT_OK);
    for (i = 0; i < N; i++) {
        mean[0] += (double)r.indirect[i][1];
        mean[1] += (double)truth[i][1];
    }
    CHECK_MSG(worst < 0.002, "%.5f from one frame to the next", worst);
    CHECK_MSG(fabs(mean[0] / mean[1] - 1) < 0.003, "%.5f of the light", mean[0] / mean[1]);
    voxrt_gi_history_destroy(h);
    voxrt_gi_destroy(r.gi);
}

/* ---- pixels that share a sequence, pixels at edges ---- */

TEST(neighbours_share_a_sequence) { /* 4 samples each of 16 x 16 pixels: one of the 1024 in each 1/32 x 1/32, and of any
                                       aligned block and pixel likewise */
    enum { SIDE = 64, LOG = 2 };
    static float position[SIDE * SIDE][3], normal[SIDE * SIDE][3];
    static uint8_t cell[32][32];
    voxrti_gather w;
    voxrt_gbuffer g;
    uint32_t block, turn, y, x, s, i, far_off = 0;
    memset(&w, 0, sizeof w);
    memset(&g, 0, sizeof g);
    g.width = g.height = SIDE;
    g.position = position[0];
    g.normal = normal[0];
    w.g = &g;
    for (turn = 0; turn < 2; turn++) /* the first samples, and the next ones: of another sequence */
        for (block = 1; block <= 16; block *= 4) {
            const uint32_t n = block * block << LOG, side = (uint32_t)(sqrt((double)n) + 0.5);
            uint32_t most = 0;
            memset(cell, 0, sizeof cell);
            for (y = 0; y < block; y++)
                for (x = 0; x < block; x++) {
                    const uint32_t pixel = (16 + y) * SIDE + 32 + x;
                    voxrti_points q;
                    voxrti_gather_open(&w, &pixel, 1, LOG, &q);
                    for (s = 0; s < 1u << LOG; s++) {
                        uint32_t index, seed;
                        float u[2];
                        voxrti_point_sample(&q, 0, s + 4 * turn, &index, &seed);
                        voxrti_sobol2(index, seed, u);
                        i = ++cell[(int)(u[1] * (float)side)][(int)(u[0] * (float)side)];
                        most = i > most ? i : most;
                    }
                }
            CHECK_MSG(most == 1, "%u x %u pixels: %u in one interval", block, block, most);
        }
    for (i = 0; i < 2; i++) { /* pixels with a sequence each: none is like another */
        const uint32_t pixel[2] = {5, 6};
        voxrti_points q;
        voxrti_gather_open(&w, pixel, 2, 32, &q);
        far_off += q.seed[0] != q.seed[1];
    }
    CHECK(far_off == 2);
}

/* Noise over pixels that share a sequence: what varies slowly, and passes a filter, is a small part of it; that of pixels
   with a sequence each is as strong at all frequencies. 4 rays to a sky that is brighter on one side. */
TEST(noise_of_neighbours_is_high_in_frequency) {
    enum { SIDE = 64, LOG = 2, TURNS = 4 };
    static float position[SIDE * SIDE][3], normal[SIDE * SIDE][3];
    static double error[SIDE][SIDE], re[SIDE][SIDE], im[SIDE][SIDE], wave[SIDE][2];
    const double pi = 3.14159265358979;
    double low[2] = {0, 0}, all[2] = {0, 0};
    voxrti_gather w;
    voxrt_gbuffer g;
    uint32_t way, turn, x, y, k, s;
    memset(&w, 0, sizeof w);
    memset(&g, 0, sizeof g);
    g.width = g.height = SIDE;
    g.position = position[0];
    g.normal = normal[0];
    w.g = &g;
    for (x = 0; x < SIDE; x++) {
        wave[x][0] = cos(2 * pi * x / SIDE);
        wave[x][1] = sin(2 * pi * x / SIDE);
    }
    for (way = 0; way < 2; way++) /* together, each for itself */
        for (turn = 0; turn < TURNS; turn++) {
            uint32_t low_count = 0;
            double sum_low = 0, sum_all = 0, mean = 0;
            for (y = 0; y < SIDE; y++)
                for (x = 0; x < SIDE; x++) {
                    const uint32_t pixel = y * SIDE + x;
                    const float up[3] = {0, 0, 1};
                    voxrti_points q;
                    voxrti_gather_open(&w, &pixel, 1, way == 0 ? LOG : 32, &q);
                    error[y][x] = 0;
                    for (s = 0; s < 1u << LOG; s++) {
                        uint32_t index, seed;
                        float u[2], d[3];
                        voxrti_point_sample(&q, 0, s + (turn << LOG), &index, &seed);
                        voxrti_sobol2(index, seed, u);
                        (void)voxrti_lobe_direction(up, u, 1.0f, d);
                        error[y][x] += 1 + 0.8 * (double)d[0] + (d[1] > 0.3f ? 0.5 : 0);
                    }
                    mean += error[y][x] / (SIDE * SIDE);
                }
            for (y = 0; y < SIDE; y++) /* rows, then columns */
                for (k = 0; k < SIDE; k++) {
                    re[y][k] = im[y][k] = 0;
                    for (x = 0; x < SIDE; x++) {
                        re[y][k] += (error[y][x] - mean) * wave[k * x % SIDE][0];
                        im[y][k] -= (error[y][x] - mean) * wave[k * x % SIDE][1];
                    }
                }
            for (k = 0; k < SIDE; k++)
                for (s = 0; s < SIDE; s++) {
                    const double fx = k < SIDE / 2 ? k : SIDE - k, fy = s < SIDE / 2 ? s : SIDE - s;
                    double a = 0, b = 0;
                    for (y = 0; y < SIDE; y++) {
                        a += re[y][k] * wave[s * y % SIDE][0] + im[y][k] * wave[s * y % SIDE][1];
                        b += im[y][k] * wave[s * y % SIDE][0] - re[y][k] * wave[s * y % SIDE][1];
                    }
                    if (k == 0 && s == 0) continue;
                    sum_all += a * a + b * b;
                    if (fx * fx + fy * fy > 64) continue; /* waves of 8 pixels and more */
                    sum_low += a * a + b * b;
                    low_count++;
                }
            all[way] += sum_all / (SIDE * SIDE - 1) / TURNS;
            low[way] += sum_low / low_count / TURNS;
        }
    CHECK_MSG(low[0] < 0.2 * all[0], "together: %.3f of the power at low frequencies", low[0] / all[0]);
    CHECK_MSG(low[1] > 0.8 * all[1] && low[1] < 1.2 * all[1], "each for itself: %.3f", low[1] / all[1]);
    CHECK_MSG(all[0] < 1.3 * all[1], "%g, %g of noise in all", all[0], all[1]);
}

TEST(neighbours_make_less_noise) { /* what a filter averages: against the same rays with a sequence for each pixel */
    static room r;
    static float truth[64 * 48][3], own[64 * 48][3];
    voxrt_gi_render_desc d;
    voxrti_mem mem;
    voxrti_ask ask;
    double together, apart;
    room_open(&r, 64, 48, 0);
    memset(&d, 0, sizeof d);
    voxrti_ask_open(&ask, &d.env, 1);
    d.rays = test_quick() ? 128 : 256;
    d.first_ray = 1u << 20;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, truth[0], NULL) == VOXRT_OK);
    d.rays = 4;
    d.first_ray = 0;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, own[0], NULL) == VOXRT_OK); /* no filter: a sequence each */
    d.filter = 4;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    REQUIRE(voxrti_env_open(&d.env, &mem) == VOXRT_OK); /* colours here are near to each other */
    CHECK(voxrti_gi_filter_run(&ask, &r.g, r.gi->columns->diagonal, 4, own[0], &mem) == VOXRT_OK);
    CHECK(voxrti_gi_filter_run(&ask, &r.g, r.gi->columns->diagonal, 4, truth[0], &mem) == VOXRT_OK);
    together = rms(r.indirect, truth, 64 * 48);
    apart = rms(own, truth, 64 * 48);
    CHECK_MSG(together < 0.7 * apart, "%.4f together, %.4f each for itself", together, apart);
    voxrt_gi_destroy(r.gi);
}

TEST(edges_keep_both_faces) { /* a block that is turned: cells along its edges know both faces, in any of its directions */
    static model m;
    uint32_t turn, both = 0, wrong = 0;
    for (turn = 0; turn < 4; turn++) {
        voxrt_gi *gi = make_gi(64, 64, 64, 4);
        const double a = 0.13 + 0.31 * turn, c = cos(a), s = sin(a);
        const double rot[9] = {c, 0, s, s * s, c, -s * c, -s * c, s, c * c};
        const double half = 2.2;
        voxrt_gi_object o;
        size_t at = 0;
        uint32_t x, y, z, i, k, side;
        m.points = m.triangles = 0;
        box(&m, half, 180, 0);
        o = object_of(&m, turn & 1);
        for (i = 0; i < 3; i++) for (k = 0; k < 3; k++) o.to_world[4 * i + k] = rot[3 * i + k];
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
        for (y = 0; y < 64; y++)
            for (x = 0; x < 64; x++)
                for (z = 0; z < 64; z++) {
                    const voxrti_gi_layer *l = &gi->layer[!(turn & 1)];
                    const voxrti_gi_record *r;
                    float face[2][3] = {{0, 0, 0}, {0, 0, 0}};
                    if (!voxrt_columns_get(gi->columns, 0, x, y, z)) continue;
                    r = &l->record[at++];
                    for (side = 0; side < 2; side++) { /* every side is one of the faces, or at corners two of them */
                        const float *n = face[side];
                        double best = 0;
                        if (r->area[side] == 0) continue;
                        voxrti_oct_decode(r->normal[side], face[side]);
                        for (k = 0; k < 3; k++) best = fmax(best, fabs((double)n[0] * rot[k] + (double)n[1] * rot[3 + k] + (double)n[2] * rot[6 + k]));
                        wrong += best < 0.99;
                    }
                    both += r->area[0] != 0 && r->area[1] != 0 && fabs((double)voxrti_dot3(face[0], face[1])) < 0.1;
                }
        voxrt_gi_destroy(gi);
    }
    CHECK_MSG(both > 4 * 60 && wrong <= 4 * 8, "%u cells with both faces, %u sides that are none", both, wrong);
}

TEST(lamps_do_not_shade_themselves) { /* a ball that emits, with shadows by rays through its own voxels: pi l (r / d)^2 */
    static model m;
    static float position[1][3], normal[1][3], albedo[1][3], direct[1][3];
    voxrt_gi *gi = make_gi(64, 64, 64, 8);
    voxrt_gi_object o;
    voxrt_build_desc build;
    voxrt_tree *tree = NULL;
    voxrt_tree_info info;
    voxrt_geometry geometry;
    voxrt_gbuffer g;
    voxrt_gi_render_desc d;
    uint32_t a;
    sphere(&m, 1.0, 40, 180, 0);
    o = object_of(&m, 1);
    for (a = 0; a < 3; a++) o.material.emission[a] = 2;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    memset(&build, 0, sizeof build);
    build.resolution = 256;
    REQUIRE(voxrt_tree_build(&build, &o.mesh, NULL, &tree) == VOXRT_OK);
    voxrt_tree_get_info(tree, &info);
    voxrt_tree_geometry(tree, &geometry);
    memset(&d, 0, sizeof d);
    g = gbuffer_of(1, 1, position, normal, albedo);
    position[0][1] = -4;
    normal[0][1] = 1;
    albedo[0][0] = albedo[0][1] = albedo[0][2] = 1;
    d.rays = 256;
    d.shadow = &geometry;
    d.shadow_lift = (float)(1.5 * info.voxel_size);
    CHECK(voxrt_gi_render(&d, gi, &g, direct[0], NULL, NULL) == VOXRT_OK);
    CHECK_MSG(fabs((double)direct[0][1] / (2.0 / 16) - 1) < 0.05, "%.4f of what it is", (double)direct[0][1] / (2.0 / 16));
    voxrt_tree_destroy(tree);
    voxrt_gi_destroy(gi);
}

TEST(walls_on_borders_of_cells) { /* each wall of a lit box between two layers of cells, and a little beside: no cell of it
                                     lies in its own shadow */
    static model m;
    uint32_t turn;
    for (turn = 0; turn < 5; turn++) {
        const double half = 3.0 + (turn == 0 ? 0.0 : turn == 1 ? 1e-6 : turn == 2 ? -1e-6 : turn == 3 ? 3e-4 : -3e-4);
        voxrt_gi *gi = make_gi(64, 64, 64, 4); /* borders at multiples of 1/8 */
        voxrt_gi_light light = point_light(0.1f, 0.2f, -0.3f, 20);
        voxrt_gi_render_desc d;
        voxrt_gi_object o;
        voxrti_ask ask;
        uint32_t l = 0, i, dark = 0, all = 0;
        m.points = m.triangles = 0;
        box(&m, half, 180, 1);
        o = object_of(&m, 1);
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
        CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
        memset(&d, 0, sizeof d);
        d.lookup = VOXRT_GI_LOOKUP_VOLUME;
        voxrti_ask_open(&ask, &d.env, 1);
        CHECK(voxrti_gi_prepare(&d, gi, (int)voxrt_isa_best(), &ask) == VOXRT_OK);
        for (i = 0; i < 2 * gi->layer[l].count; i++) {
            float rgb[3];
            if (gi->layer[l].record[i / 2].area[i % 2] == 0) continue;
            voxrti_rgb9e5_decode(gi->layer[l].direct[i], rgb);
            all++;
            dark += !(rgb[1] * gi->unit > 0.1f); /* at least 20 cos / r^2 */
        }
        CHECK_MSG(all > 10000 && dark < all / 200, "%g: %u of %u sides are dark", half, dark, all);
        voxrt_gi_destroy(gi);
    }
}

TEST(pixels_at_edges_show_one_face) {
    static model m;
    static float position[4][3], normal[4][3], albedo[4][3];
    voxrt_gi *gi = make_gi(64, 64, 64, 4);
    voxrt_gi_object o;
    voxrt_camera camera;
    voxrt_gbuffer g;
    uint32_t i;
    m.points = m.triangles = 0;
    box(&m, 2.05, 180, 0);
    o = object_of(&m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    memset(&camera, 0, sizeof camera);
    g = gbuffer_of(4, 1, position, normal, albedo);
    camera.eye[1] = 3.0f; /* above the block a little, in front of it far */
    camera.eye[2] = 20.0f;
    camera.fov_y = 40;
    for (i = 0; i < 4; i++) {
        position[i][0] = 0.3f;
        position[i][1] = position[i][2] = 2.05f;
    }
    normal[0][1] = normal[0][2] = 0.70710678f;               /* a mix of top and front */
    normal[1][1] = 0.70710678f;
    normal[1][0] = 0.70710678f;                              /* not one of theirs */
    normal[2][2] = 1.0f;                                     /* the front itself */
    normal[3][1] = 1.0f;
    CHECK(voxrt_gbuffer_edges(NULL, &camera, gi, &g) == VOXRT_OK);
    CHECK_MSG(normal[0][2] > 0.99f, "%g %g %g", (double)normal[0][0], (double)normal[0][1], (double)normal[0][2]);
    CHECK(normal[1][0] > 0.7f && normal[1][2] == 0.0f);
    CHECK(normal[2][2] == 1.0f && normal[3][1] == 1.0f);
    camera.eye[1] = -8.0f;                                   /* from below the top cannot be seen */
    normal[3][1] = 0.99995f;
    normal[3][2] = 0.01f;
    CHECK(voxrt_gbuffer_edges(NULL, &camera, gi, &g) == VOXRT_OK);
    CHECK_MSG(normal[3][2] > 0.99f, "%g %g %g", (double)normal[3][0], (double)normal[3][1], (double)normal[3][2]);
    normal[0][1] = normal[0][2] = 0.70710678f;               /* a mesh that brings normals may mean the mix */
    normal[3][1] = 0.99995f;
    normal[3][2] = 0.01f;
    o.mesh.normals = m.p[0];
    CHECK(voxrt_gi_set(gi, 0, &o) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    CHECK(voxrt_gbuffer_edges(NULL, &camera, gi, &g) == VOXRT_OK);
    CHECK(normal[0][1] == 0.70710678f && normal[3][2] == 0.01f);
    CHECK(voxrt_gbuffer_edges(NULL, NULL, gi, &g) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_gbuffer_edges(NULL, &camera, NULL, &g) == VOXRT_ERR_INVALID_ARG);
    voxrt_gi_destroy(gi);
}

TEST(relief) { /* times relief * cos + 1 - relief */
    static room r;
    static float plain[48 * 32][3];
    voxrt_gi_render_desc d;
    uint32_t i, k;
    double worst = 0;
    room_open(&r, 48, 32, 0);
    memset(&d, 0, sizeof d);
    d.rays = 4;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, plain[0], NULL) == VOXRT_OK);
    d.relief = 0.75f;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_ERR_INVALID_ARG); /* no camera */
    d.camera = r.camera;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, r.direct[0], r.indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < 48 * 32; i++) {
        double to[3], l = 0, c = 0;
        for (k = 0; k < 3; k++) {
            to[k] = (double)r.camera.eye[k] - (double)r.position[i][k];
            l += to[k] * to[k];
            c += to[k] * (double)r.normal[i][k];
        }
        worst = fmax(worst, fabs((double)r.indirect[i][1] - (double)plain[i][1] * (0.75 * fmax(0, c / sqrt(l)) + 0.25)));
    }
    CHECK_MSG(worst < 1e-4, "%g", worst);
    d.relief = 1.5f;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_ERR_INVALID_ARG);
    voxrt_gi_destroy(r.gi);
}

TEST(lists_have_every_pixel_once) { /* odd sizes, patterns; a run of 64 has one place of the pattern */
    static const uint32_t size[3][2] = {{64, 32}, {37, 21}, {3, 5}};
    static float normal[64 * 32][3], position[64 * 32][3];
    static uint32_t list[64 * 32 * 64];
    static uint8_t seen[64 * 32];
    uint32_t k, set, i;
    for (k = 0; k < 3; k++)
        for (set = 1; set <= 5; set++) {
            voxrt_gbuffer g;
            const uint32_t n = size[k][0] * size[k][1];
            uint32_t wrong = 0, want = 0;
            size_t count;
            memset(&g, 0, sizeof g);
            memset(seen, 0, sizeof seen);
            g.width = size[k][0];
            g.height = size[k][1];
            g.normal = normal[0];
            g.position = position[0];
            for (i = 0; i < n; i++) {
                normal[i][1] = i % 7 == 3 ? 0.0f : 1.0f;
                want += i % 7 != 3;
            }
            count = voxrti_list_all(&g, set, NULL);
            REQUIRE(count <= sizeof list / sizeof list[0] && voxrti_list_all(&g, set, list) == count);
            for (i = 0; i < count; i++) {
                const uint32_t first = list[i / VOXRTI_COLUMN_BATCH * VOXRTI_COLUMN_BATCH];
                if (list[i] == VOXRTI_NO_PIXEL) continue;
                wrong += list[i] >= n || seen[list[i]]++ != 0 || list[i] % 7 == 3;
                wrong += list[i] % g.width % set != first % g.width % set || list[i] / g.width % set != first / g.width % set;
                want--;
            }
            CHECK_MSG(wrong == 0 && want == 0, "%u x %u, pattern %u: %u wrong, %u missing", g.width, g.height, set, wrong, want);
        }
}

/* ---- scenes that are changed, stopped, drawn at once ---- */

typedef struct stopper { uint32_t calls, after; uint64_t last, total; uint32_t backwards; } stopper;
static int stop_fn(void *user, uint64_t done, uint64_t total) {
    stopper *s = (stopper *)user;
    s->backwards += done < s->last || done > total || (s->total != 0 && total != s->total);
    s->last = done;
    s->total = total;
    return ++s->calls == s->after;
}

TEST(stopped_pictures_leave_no_trace) {
    enum { W = 192, H = 128 };
    static room r;
    static float position[W * H][3], normal[W * H][3], albedo[W * H][3], out[2][2][W * H][3];
    voxrt_gi_render_desc d;
    uint32_t run, frame;
    room_open(&r, 16, 16, 2);
    r.g = gbuffer_of(W, H, position, normal, albedo);
    r.g.before = NULL;
    CHECK(voxrt_gbuffer_from_gi(NULL, &r.camera, r.gi, &r.g) == VOXRT_OK);
    for (run = 0; run < 2; run++) { /* not stopped; stopped before each picture */
        voxrt_gi_history *h = NULL;
        REQUIRE(voxrt_gi_history_create(NULL, &h) == VOXRT_OK);
        memset(&d, 0, sizeof d);
        d.camera = r.camera;
        d.history = h;
        d.rays = 2;
        d.filter = 2;
        for (frame = 0; frame < 2; frame++) {
            stopper s;
            memset(&s, 0, sizeof s);
            d.env.progress_user = &s;
            d.env.progress_fn = run == 1 ? stop_fn : NULL;
            s.after = 1;
            if (run == 1) {
                CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, out[run][frame][0], NULL) == VOXRT_ERR_CANCELLED && s.calls == 1);
                memset(&s, 0, sizeof s);
            }
            CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, out[run][frame][0], NULL) == VOXRT_OK);
            if (run == 1) CHECK_MSG(s.calls > 1 && s.backwards == 0 && s.last == s.total, "%u calls, %lu of %lu", s.calls, (unsigned long)s.last,
                                    (unsigned long)s.total);
        }
        voxrt_gi_history_destroy(h);
    }
    CHECK(memcmp(out[0], out[1], sizeof out[0]) == 0);
    d.history = NULL;
    d.tolerance = 0.01f; /* stopped in rounds of rays, in meshes of pixels */
    d.coarse = 4;
    d.rays = 64;
    {
        stopper s;
        memset(&s, 0, sizeof s);
        s.after = 3;
        d.env.progress_user = &s;
        d.env.progress_fn = stop_fn;
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, out[0][0][0], NULL) == VOXRT_ERR_CANCELLED && s.calls == 3);
    }
    voxrt_gi_destroy(r.gi);
}

typedef struct two_rooms { room r; float out[48 * 32][3]; } two_rooms;
static void *draw_room(void *user) {
    two_rooms *t = (two_rooms *)user;
    voxrt_gi_render_desc d;
    memset(&d, 0, sizeof d);
    d.rays = 8;
    d.env.thread_count = 2;
    if (voxrt_gi_bounce(t->r.gi, &d.env, 8, 0.0f, 1) != VOXRT_OK) return user;
    if (voxrt_gi_render(&d, t->r.gi, &t->r.g, NULL, t->out[0], NULL) != VOXRT_OK) return user;
    return NULL;
}

TEST(two_scenes_at_once) {
    static two_rooms t[3];
    pthread_t thread[2];
    uint32_t i;
#if defined(__wasm__) && !defined(_REENTRANT)
    SKIP("no threads without -pthread");
#endif
    for (i = 0; i < 3; i++) room_open(&t[i].r, 48, 32, 1);
    CHECK(draw_room(&t[2]) == NULL);
    for (i = 0; i < 2; i++) REQUIRE(pthread_create(&thread[i], NULL, draw_room, &t[i]) == 0);
    for (i = 0; i < 2; i++) {
        void *bad = NULL;
        CHECK(pthread_join(thread[i], &bad) == 0 && bad == NULL);
        CHECK(memcmp(t[i].out, t[2].out, sizeof t[2].out) == 0);
    }
    for (i = 0; i < 3; i++) voxrt_gi_destroy(t[i].r.gi);
}

/* All functions that only read a scene, by several threads at once, from a cache that is empty: each gets what one alone gets. */
typedef struct reader {
    const room *r;
    voxrt_gi_surface s[48 * 32];
    float normal[48 * 32][3], specular[48 * 32][4], albedo[48 * 32][3], position[48 * 32][3];
} reader;
static void *read_room(void *user) {
    reader *t = (reader *)user;
    voxrt_gbuffer g;
    voxrt_env env;
    uint32_t i, k;
    memset(&env, 0, sizeof env);
    memset(&g, 0, sizeof g);
    env.thread_count = 1;
    g.width = 48;
    g.height = 32;
    g.position = t->position[0];
    g.normal = t->normal[0];
    g.albedo = t->albedo[0];
    g.specular = t->specular[0];
    if (voxrt_gbuffer_from_gi(&env, &t->r->camera, t->r->gi, &g) != VOXRT_OK || voxrt_gbuffer_materials(&env, t->r->gi, &g) != VOXRT_OK ||
        voxrt_gbuffer_edges(&env, &t->r->camera, t->r->gi, &g) != VOXRT_OK) return user;
    for (i = 0; i < 48 * 32; i++) {
        voxrt_ray ray;
        voxrt_column_hit hit;
        if (voxrt_camera_ray(&t->r->camera, 48, 32, i % 48 + 0.5, i / 48 + 0.5, &ray) != VOXRT_OK ||
            voxrt_columns_trace(voxrt_gi_columns(t->r->gi), NULL, &ray, &hit, 1) != VOXRT_OK) return user;
        memset(&t->s[i], 0, sizeof t->s[i]);
        if (voxrt_gi_get(t->r->gi, &hit, ray.dir, &t->s[i]))
            for (k = 0; k < 3; k++) if (!(t->s[i].radiance[k] >= 0.0f)) return user;
    }
    return voxrt_gi_virtual_lights(t->r->gi, NULL, 0) == 0 ? NULL : user;
}

TEST(readers_at_once) {
    static room r[2];
    static reader t[4]; /* the last one is alone */
    pthread_t thread[3];
    uint32_t i, lit = 0;
#if defined(__wasm__) && !defined(_REENTRANT)
    SKIP("no threads without -pthread");
#endif
    for (i = 0; i < 2; i++) room_open(&r[i], 48, 32, 1);
    for (i = 0; i < 4; i++) t[i].r = &r[i / 3];
    CHECK(read_room(&t[3]) == NULL);
    for (i = 0; i < 48 * 32; i++) lit += t[3].s[i].radiance[0] > 0.0f;
    CHECK_MSG(lit > 500, "%u pixels", lit);
    for (i = 0; i < 3; i++) REQUIRE(pthread_create(&thread[i], NULL, read_room, &t[i]) == 0);
    for (i = 0; i < 3; i++) {
        void *bad = NULL;
        CHECK(pthread_join(thread[i], &bad) == 0 && bad == NULL);
        CHECK(memcmp(t[i].s, t[3].s, sizeof t[3].s) == 0 && memcmp(t[i].normal, t[3].normal, sizeof t[3].normal) == 0);
        CHECK(memcmp(t[i].position, t[3].position, sizeof t[3].position) == 0 && memcmp(t[i].specular, t[3].specular, sizeof t[3].specular) == 0);
    }
    for (i = 0; i < 2; i++) voxrt_gi_destroy(r[i].gi);
}

TEST(every_edit_begins_anew) { /* progressive pictures: after any change nothing old is in the mean; light may be glaring */
    static room r;
    static float fresh[48 * 32][3];
    voxrt_gi_render_desc d;
    voxrt_gi_report report;
    uint32_t edit, i, k, id = 0, bad = 0;
    voxrt_gi_object o;
    room_open(&r, 48, 32, 0);
    r.g.before = NULL;
    for (edit = 0; edit < 12; edit++) {
        voxrt_gi_history *h = NULL;
        REQUIRE(voxrt_gi_history_create(NULL, &h) == VOXRT_OK);
        memset(&d, 0, sizeof d);
        d.camera = r.camera;
        d.history = h;
        d.report = &report;
        d.rays = 2;
        for (i = 0; i < 2; i++) CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        CHECK(report.kept == 1.0f);
        o = r.object;
        if (edit == 0) o.to_world[3] += 0.4;
        if (edit == 1) o.material.albedo[0] = o.material.albedo[1] = o.material.albedo[2] = 0.25f;
        if (edit == 2) r.light.position[0] += 0.1f;
        if (edit == 3) r.light.color[1] = 1e6f;
        if (edit == 4) r.light.kind = VOXRT_GI_SPOT, r.light.direction[1] = -1, r.light.angle = 50;
        if (edit == 5) CHECK(voxrt_gi_add(r.gi, &o, &id) == VOXRT_OK);
        if (edit == 6) CHECK(voxrt_gi_remove(r.gi, id) == VOXRT_OK);
        if (edit == 7) d.radius = 3;
        if (edit == 8) d.method = VOXRT_GI_PATH;
        if (edit == 9) d.coarse = 4;
        if (edit > 9) CHECK(voxrt_gi_bounce(r.gi, NULL, 4, edit == 10 ? 0.0f : 0.25f, 1) == VOXRT_OK);
        if (edit < 2) CHECK(voxrt_gi_set(r.gi, r.id, &o) == VOXRT_OK);
        CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK && voxrt_gi_update(r.gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
        CHECK_MSG(report.kept == (edit == 11 ? 1.0f : 0.0f), "edit %u: %g kept", edit, (double)report.kept); /* it follows */
        d.history = NULL; /* as if there had been nothing, but with the rays of its turn */
        for (i = k = 0; i < 2 && k == 0; i++) {
            d.first_ray = i * d.rays;
            CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, fresh[0], NULL) == VOXRT_OK);
            k = edit == 11 || memcmp(fresh, r.indirect, sizeof fresh) == 0;
        }
        CHECK_MSG(k == 1, "edit %u", edit);
        for (i = 0; i < 48 * 32; i++) for (k = 0; k < 3; k++) bad += !(r.indirect[i][k] >= 0.0f && r.indirect[i][k] < 1e12f);
        voxrt_gi_history_destroy(h);
    }
    CHECK(bad == 0);
    voxrt_gi_destroy(r.gi);
}

/* ---- what moves ---- */

TEST(things_that_turn_do_not_pop) { /* a block that turns by 0.2 degrees a frame: cells come and go, light stays smooth */
    enum { N = 64 * 40 };
    const uint32_t frames = test_quick() ? 7 : 120;
    static room r;
    static float last[3][N][3];
    static double second[N];
    voxrt_gi_render_desc d;
    double mean = 0, sum = 0, p99;
    uint32_t f, i, over = 0;
    room_open(&r, 64, 40, 0);
    memset(&d, 0, sizeof d);
    d.rays = 16;
    d.filter = 3;
    d.camera = r.camera;
    memset(second, 0, sizeof second);
    for (f = 0; f < frames; f++) {
        const double a = 0.4 + f * 0.2 * 3.14159265358979 / 180;
        r.object.to_world[0] = r.object.to_world[10] = cos(a);
        r.object.to_world[2] = sin(a);
        r.object.to_world[8] = -sin(a);
        CHECK(voxrt_gi_set(r.gi, r.id, &r.object) == VOXRT_OK && voxrt_gi_update(r.gi, NULL) == VOXRT_OK);
        memmove(last[0], last[1], 2 * sizeof last[0]);
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, last[2][0], NULL) == VOXRT_OK);
        for (i = 0; i < N && f >= 2; i++)
            second[i] += fabs((double)last[2][i][1] - 2 * (double)last[1][i][1] + (double)last[0][i][1]) / (frames - 2);
    }
    for (i = 0; i < N; i++) {
        mean += (double)last[2][i][1] / N;
        sum += second[i] / N;
    }
    p99 = 0.05 * mean;
    for (i = 0; i < N; i++) over += second[i] > p99;
    CHECK_MSG(sum < 0.01 * mean, "popping %.4f of the mean", sum / mean);
    CHECK_MSG(over <= N / 100, "%u of %u pixels over 5 %%", over, N);
    voxrt_gi_destroy(r.gi);
}

TEST(deforming_meshes) { /* a ball whose surface swells in waves: each frame as if made anew, and no flicker but the light's own */
    enum { N = 48 * 32 };
    const uint32_t frames = test_quick() ? 6 : 120;
    static room r;
    static model still, wave;
    static float last[2][3][N][3], fresh[N][3];
    voxrt_gi_object o;
    double sum[2] = {0, 0};
    uint32_t f, i, k, way, id;
    room_open(&r, 48, 32, 0);
    r.g.before = NULL;
    sphere(&still, 2.5, 30, 180, 0);
    wave = still;
    o = object_of(&wave, 0);
    CHECK(voxrt_gi_add(r.gi, &o, &id) == VOXRT_OK);
    for (f = 0; f < frames; f++) {
        for (i = 0; i < still.points; i++)
            for (k = 0; k < 3; k++) wave.p[i][k] = still.p[i][k] * (1.0f + 0.2f * (float)sin((double)still.p[i][1] * 2 + 0.15 * f));
        CHECK(voxrt_gi_set(r.gi, id, &o) == VOXRT_OK && voxrt_gi_update(r.gi, NULL) == VOXRT_OK);
        for (way = 0; way < 2; way++) {
            voxrt_gi_render_desc d;
            memset(&d, 0, sizeof d);
            d.rays = way == 0 ? 128 : 16;
            d.filter = way == 0 ? 0 : 3;
            memmove(last[way][0], last[way][1], 2 * sizeof last[0][0]);
            CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, last[way][2][0], NULL) == VOXRT_OK);
            for (i = 0; i < N && f >= 2; i++)
                sum[way] += fabs((double)last[way][2][i][1] - 2 * (double)last[way][1][i][1] + (double)last[way][0][i][1]);
        }
    }
    CHECK_MSG(sum[1] < 1.3 * sum[0], "flicker %.4f, of many rays %.4f", sum[1], sum[0]);
    {
        voxrt_gi *gi = make_gi(64, 64, 64, 10);
        const voxrt_gi_object room_object = object_of(&r.m, 1);
        voxrt_gi_render_desc d;
        memset(&d, 0, sizeof d);
        d.rays = 16;
        d.filter = 3;
        CHECK(voxrt_gi_add(gi, &room_object, NULL) == VOXRT_OK && voxrt_gi_add(gi, &r.object, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_set_lights(gi, &r.light, 1) == VOXRT_OK);
        CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_render(&d, gi, &r.g, NULL, fresh[0], NULL) == VOXRT_OK);
        CHECK(memcmp(fresh, last[1][2], sizeof fresh) == 0);
        voxrt_gi_destroy(gi);
    }
    voxrt_gi_destroy(r.gi);
}

/* An object by points on its surface, and solid: dark inside, and the same from outside. */
TEST(objects_by_samples_and_solid) {
    enum { N = 48 * 32, WAYS = 5 };
    static const voxrt_columns_mode mode[WAYS] = {VOXRT_COLUMNS_THIN, VOXRT_COLUMNS_SAMPLES, VOXRT_COLUMNS_SOLID, VOXRT_COLUMNS_FAT, VOXRT_COLUMNS_BODY};
    static room r;
    static float light[WAYS][N][3];
    uint32_t way, i, k;
    double mean = 0;
    room_open(&r, 48, 32, 0);
    for (way = 0; way < WAYS; way++) {
        voxrt_gi_render_desc d;
        voxrt_gi_update_stats stats;
        voxrt_column_hit middle;
        voxrt_gi_surface s;
        const float down[3] = {0, -1, 0};
        double rms = 0;
        memset(&d, 0, sizeof d);
        d.rays = 64;
        r.object.mode = mode[way];
        CHECK(voxrt_gi_set(r.gi, r.id, &r.object) == VOXRT_OK && voxrt_gi_update(r.gi, &stats) == VOXRT_OK);
        CHECK(stats.open_columns == 0);
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, light[way][0], NULL) == VOXRT_OK);
        memset(&middle, 0, sizeof middle);
        for (k = 0; k < 3; k++) middle.cell[k] = (uint32_t)((r.object.to_world[4 * k + 3] + 10.0) * 64.0 / 20.0);
        CHECK(voxrt_columns_get(r.gi->columns, 0, middle.cell[0], middle.cell[1], middle.cell[2]) ==
              (mode[way] == VOXRT_COLUMNS_SOLID || mode[way] == VOXRT_COLUMNS_BODY));
        CHECK(voxrt_gi_get(r.gi, &middle, down, &s) == 0);
        for (i = 0; i < N; i++) {
            const double e = (double)light[way][i][1] - (double)light[0][i][1];
            rms += e * e / N;
            if (way == 0) mean += (double)light[0][i][1] / N;
        }
        CHECK_MSG(sqrt(rms) < (mode[way] == VOXRT_COLUMNS_FAT ? 0.15 : mode[way] == VOXRT_COLUMNS_BODY ? 0.1 : 0.05) * mean,
                  "way %u: %.4f of %.4f", way, sqrt(rms), mean);
    }
    { /* what a body's cells are made of: from outside each ray sees a face that faces it, in the block's colour */
        uint32_t dark = 0, seen = 0;
        rng_state = 9;
        for (i = 0; i < 4000; i++) {
            voxrt_ray ray;
            voxrt_column_hit h;
            voxrt_gi_surface s;
            double p[3], l = 0;
            memset(&ray, 0, sizeof ray);
            for (k = 0; k < 3; k++) {
                p[k] = 2 * rnd() - 1;
                l += p[k] * p[k];
            }
            for (k = 0; k < 3; k++) {
                const double to = r.object.to_world[4 * k + 3] + 3.0 * (rnd() - 0.5);
                ray.org[k] = (float)(r.object.to_world[4 * k + 3] + 4.6 * p[k] / sqrt(l));
                ray.dir[k] = (float)to - ray.org[k];
            }
            ray.t_max = INFINITY;
            if (ray.org[1] < -8.5f) continue; /* below the floor */
            CHECK(voxrt_columns_trace(r.gi->columns, NULL, &ray, &h, 1) == VOXRT_OK && h.t < INFINITY);
            seen++;
            if (!voxrt_gi_get(r.gi, &h, ray.dir, &s)) dark++;
            else if (s.object == r.id) CHECK(fabs((double)s.albedo[0] - voxrti_srgb_to_linear(160.0 / 255.0)) < 0.01);
        }
        CHECK_MSG(seen > 2000 && dark * 100 < seen, "%u of %u see a back", dark, seen);
    }
    r.block.triangles -= 2; /* a face is missing */
    r.object = object_of(&r.block, 0);
    r.object.mode = VOXRT_COLUMNS_SOLID;
    {
        voxrt_gi_update_stats stats;
        CHECK(voxrt_gi_set(r.gi, r.id, &r.object) == VOXRT_OK && voxrt_gi_update(r.gi, &stats) == VOXRT_OK);
        CHECK(stats.open_columns > 100);
    }
    voxrt_gi_destroy(r.gi);
}

/* Points on a surface follow it as it moves, turns and bends, and are the same ones until it has grown. */
TEST(samples_follow_objects) {
    static model bend;
    static uint16_t first[40000][2];
    voxrt_gi *gi = make_gi(64, 64, 64, 10), *thin = make_gi(64, 64, 64, 10);
    voxrt_gi_object o;
    uint32_t id[2], same = 0, frame;
    sphere(&bend, 3.0, 12, 180, 0);
    o = object_of(&bend, 0);
    CHECK(voxrt_gi_add(thin, &o, &id[1]) == VOXRT_OK);
    o.mode = VOXRT_COLUMNS_SAMPLES;
    CHECK(voxrt_gi_add(gi, &o, &id[0]) == VOXRT_OK);
    for (frame = 0; frame < 24; frame++) {
        const double turn = 0.1 * frame, more = frame < 12 ? 1.0 : frame < 18 ? 1.05 : 2.0;
        uint32_t lost = 0, many = 0, x, y, z;
        size_t rec;
        o.to_world[0] = more * cos(turn);
        o.to_world[1] = -sin(turn);
        o.to_world[4] = more * sin(turn);
        o.to_world[5] = cos(turn);
        o.to_world[10] = 1;
        o.to_world[3] = 0.11 * frame - 1;
        CHECK(voxrt_gi_set(gi, id[0], &o) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
        o.mode = VOXRT_COLUMNS_THIN;
        CHECK(voxrt_gi_set(thin, id[1], &o) == VOXRT_OK && voxrt_gi_update(thin, NULL) == VOXRT_OK);
        o.mode = VOXRT_COLUMNS_SAMPLES;
        if (frame == 0) memcpy(first, gi->entry[id[0]].lattice, bend.triangles * sizeof first[0]);
        same = memcmp(first, gi->entry[id[0]].lattice, bend.triangles * sizeof first[0]) == 0;
        CHECK(same == (frame < 18));
        for (z = 0; z < 64; z++)
            for (y = 0; y < 64; y++)
                for (x = 0; x < 64; x++) {
                    lost += voxrt_columns_get(thin->columns, 0, x, y, z) && !voxrt_columns_get(gi->columns, 0, x, y, z);
                    many += (uint32_t)voxrt_columns_get(thin->columns, 0, x, y, z);
                }
        CHECK_MSG(lost * 50 < many, "frame %u: %u of %u cells lost", frame, lost, many);
        for (rec = 0; rec < gi->layer[1].count; rec++) { /* sides that are there, of this object, in its colour */
            const voxrti_gi_record *q = &gi->layer[1].record[rec];
            if (q->area[0] + q->area[1] == 0 || q->object[q->area[0] == 0] != id[0]) many = 0;
            if (q->rgb[q->area[0] == 0][0] != (uint8_t)(sqrt(voxrti_srgb_to_linear(180.0 / 255.0)) * 255.0 + 0.5)) many = 0;
        }
        CHECK_MSG(many != 0, "frame %u: attributes", frame);
    }
    voxrt_gi_destroy(gi);
    voxrt_gi_destroy(thin);
}

TEST(a_camera_that_pans) { /* with history there is less error than without, and nothing old where the picture shows what
                              was not in it before */
    enum { W = 64, H = 40, N = W * H };
    const uint32_t frames = test_quick() ? 8 : 120;
    static room r;
    static float truth[N][3], alone[N][3];
    voxrt_gi_history *h = NULL;
    voxrt_gi_render_desc d;
    double with, without, new_with = 0, new_without = 0;
    uint32_t f, i, x;
    room_open(&r, W, H, 0);
    r.g.before = NULL;
    REQUIRE(voxrt_gi_history_create(NULL, &h) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    for (f = 0; f < frames; f++) {
        r.camera.at[0] = 0.35f * ((float)f - (float)(frames - 8));
        CHECK(voxrt_gbuffer_from_gi(NULL, &r.camera, r.gi, &r.g) == VOXRT_OK);
        d.camera = r.camera;
        d.rays = 4;
        d.filter = 3;
        d.history = h;
        CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, r.indirect[0], NULL) == VOXRT_OK);
    }
    d.history = NULL;
    d.first_ray = 4 * 7;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, alone[0], NULL) == VOXRT_OK);
    d.rays = 256;
    d.first_ray = 1u << 20;
    CHECK(voxrt_gi_render(&d, r.gi, &r.g, NULL, truth[0], NULL) == VOXRT_OK);
    with = rms(r.indirect, truth, N);
    without = rms(alone, truth, N);
    CHECK_MSG(with < 0.8 * without, "%.4f with history, %.4f without", with, without);
    for (i = 0; i < N; i++) { /* the side that came in over the last four pictures */
        x = i % W;
        if (x < W - 8) continue;
        new_with += fabs((double)r.indirect[i][1] - (double)truth[i][1]);
        new_without += fabs((double)alone[i][1] - (double)truth[i][1]);
    }
    CHECK_MSG(new_with < 1.4 * new_without, "where it is new: %.4f with history, %.4f without", new_with, new_without);
    voxrt_gi_history_destroy(h);
    voxrt_gi_destroy(r.gi);
}

TEST(volumes_that_follow_leave_no_seam) { /* points that stay while three nested volumes go past them: the same light */
    enum { N = 32 };
    static model m, block;
    static float position[N][3], normal[N][3], albedo[N][3], first[N][3], indirect[N][3];
    voxrt_gi_desc gd;
    voxrt_gi_render_desc d;
    voxrt_gi_light light = point_light(1, 5, -2, 80);
    voxrt_gi_object o;
    voxrt_gbuffer g;
    voxrt_gi *gi = NULL;
    uint32_t i, step;
    memset(&gd, 0, sizeof gd);
    gd.columns.size_x = gd.columns.size_y = 64;
    gd.columns.size_z = 64;
    for (i = 0; i < 3; i++) {
        gd.columns.box_min[i] = -5;
        gd.columns.box_max[i] = 5;
    }
    gd.nested = 3;
    REQUIRE(voxrt_gi_create(&gd, &gi) == VOXRT_OK);
    m.points = m.triangles = block.points = block.triangles = 0;
    box(&m, 9, 190, 1);
    box(&block, 1.5, 170, 0);
    o = object_of(&m, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    o = object_of(&block, 1);
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
    g = gbuffer_of(N, 1, position, normal, albedo);
    rng_state = 31;
    for (i = 0; i < N; i++) { /* on the top and a side of the block, near the middle */
        position[i][0] = (float)(2.4 * rnd() - 1.2);
        position[i][i % 2 ? 1 : 2] = 1.5f;
        position[i][i % 2 ? 2 : 1] = (float)(2.4 * rnd() - 1.2);
        normal[i][i % 2 ? 1 : 2] = 1.0f;
        albedo[i][0] = albedo[i][1] = albedo[i][2] = 1;
    }
    memset(&d, 0, sizeof d);
    d.rays = test_quick() ? 128 : 512;
    for (step = 0; step < 3; step++) {
        const double centre[3] = {1.3 * step, -0.9 * step, 0.4 * step};
        double mean = 0, worst = 0, sum = 0;
        CHECK(voxrt_gi_follow(gi, centre, NULL) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_render(&d, gi, &g, NULL, indirect[0], NULL) == VOXRT_OK);
        if (step == 0) memcpy(first, indirect, sizeof first);
        for (i = 0; i < N; i++) {
            mean += (double)first[i][0] / N;
            sum += (double)indirect[i][0] / N;
            worst = fmax(worst, fabs((double)indirect[i][0] - (double)first[i][0]));
        }
        CHECK_MSG(fabs(sum / mean - 1) < 0.005, "step %u: %.5f of what it was", step, sum / mean);
        CHECK_MSG(worst < 0.04 * mean, "step %u: %.4f of the mean", step, worst / mean);
    }
    voxrt_gi_destroy(gi);
}

TEST(tones) {
    float in[300], out[300], most = 8.0f;
    uint32_t tone, i;
    for (i = 0; i < 100; i++) in[3 * i] = in[3 * i + 1] = in[3 * i + 2] = (float)i * 0.09f;
    for (tone = 0; tone < 3; tone++) {
        CHECK(voxrt_tone_map((voxrt_tone)tone, most, in, out, 100) == VOXRT_OK);
        CHECK(out[0] == 0);
        for (i = 1; i < 100; i++) CHECK(out[3 * i] >= out[3 * i - 3] && out[3 * i] <= 1);
        CHECK(out[297] > 0.99f); /* 8.91 */
    }
    { /* Drago with bias 0.85 as its authors print it, maximum 100 cd/m2 */
        const double y = 2.0, want = 1.0 / log10(8.0 + 1.0) * log(y + 1) / log(2 + 8 * pow(y / 8.0, log(0.85) / log(0.5)));
        in[0] = in[1] = in[2] = 2.0f;
        CHECK(voxrt_tone_map(VOXRT_TONE_DRAGO, most, in, out, 1) == VOXRT_OK);
        CHECK_MSG(fabs((double)out[0] - want) < 1e-6, "%g, not %g", (double)out[0], want);
    }
    for (tone = 0; tone < 3; tone++) /* in any unit: `most` is white, half of it is not, or nearly (Drago) */
        for (i = 0; i < 60; i++) {
            const float unit = (float)pow(10, (double)i - 30);
            in[0] = in[1] = in[2] = unit;
            in[3] = in[4] = in[5] = 0.5f * unit;
            CHECK(voxrt_tone_map((voxrt_tone)tone, unit, in, out, 2) == VOXRT_OK);
            CHECK_MSG(fabsf(out[0] - 1) < 1e-5f, "tone %u: %g of %g", tone, (double)out[0], (double)unit);
            CHECK_MSG(out[3] >= 0.49f && (out[3] < 0.999f || (tone == VOXRT_TONE_DRAGO && unit > 1)), "tone %u: %g of half of %g",
                      tone, (double)out[3], (double)unit);
        }
    in[0] = NAN;
    in[1] = INFINITY;
    in[2] = -1;
    CHECK(voxrt_tone_map(VOXRT_TONE_LOG, most, in, out, 1) == VOXRT_OK);
    CHECK(out[0] == 0 && out[1] >= 0 && out[1] <= 1 && out[2] == 0);
    CHECK(voxrt_tone_map(VOXRT_TONE_LOG, 0, in, out, 1) == VOXRT_ERR_INVALID_ARG);
}

TEST(bad_input) {
    static model m;
    voxrt_gi *gi = make_gi(64, 64, 64, 10), *none = NULL;
    voxrt_gi_desc gd;
    voxrt_gi_object o;
    voxrt_gi_light l = point_light(0, 0, 0, 1);
    voxrt_gi_render_desc d;
    voxrt_gbuffer g;
    voxrt_gi_update_stats su;
    float one[3] = {0, 0, 0}, up[3] = {0, 1, 0};
    memset(&gd, 0, sizeof gd);
    memset(&g, 0, sizeof g);
    memset(&d, 0, sizeof d);
    CHECK(voxrt_gi_create(NULL, &none) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_gi_create(&gd, &none) == VOXRT_ERR_INVALID_ARG && none == NULL);
    gd._begin_zero = 1;
    CHECK(voxrt_gi_create(&gd, &none) == VOXRT_ERR_UNINIT_DESC);
    sphere(&m, 5.0, 4, 200, 0);
    o = object_of(&m, 0);
    CHECK(voxrt_gi_add(gi, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    o.to_world[5] = (double)NAN;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_INVALID_ARG);
    o.to_world[5] = 0;
    o.material.albedo[1] = 1.5f;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_INVALID_ARG);
    o.material.albedo[1] = 0;
    o.material.emission[0] = INFINITY;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_INVALID_ARG);
    o.material.emission[0] = 0;
    o.mode = (voxrt_columns_mode)6;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_INVALID_ARG);
    o.mode = VOXRT_COLUMNS_SAMPLES;
    o.spacing = -1.0f;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_INVALID_ARG);
    o.mode = VOXRT_COLUMNS_THIN;
    o.spacing = 0.0f;
    CHECK(voxrt_gi_set(gi, 0, &o) == VOXRT_ERR_INVALID_ARG);
    {
        const size_t count = o.mesh.triangle_count;
        o.mesh.triangle_count = SIZE_MAX;
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_RANGE);
        o.mesh.triangle_count = count;
        o.mesh.position_stride = 3;
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_INVALID_ARG);
        o.mesh.position_stride = 0;
        o.mesh.vertex_rgb_stride = 2;
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_ERR_INVALID_ARG);
        o.mesh.vertex_rgb_stride = 0;
    }
    m.p[3][1] = NAN;
    m.index[5][2] = 1u << 30;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, &su) == VOXRT_OK && su.rejected >= 2 && su.moving_cells > 100);
    l.color[1] = -1;
    CHECK(voxrt_gi_set_lights(gi, &l, 1) == VOXRT_ERR_INVALID_ARG);
    l.color[1] = 1;
    l.kind = VOXRT_GI_SPOT;
    CHECK(voxrt_gi_set_lights(gi, &l, 1) == VOXRT_ERR_INVALID_ARG);
    l.kind = VOXRT_GI_AREA;
    CHECK(voxrt_gi_set_lights(gi, &l, 1) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_gi_set_lights(gi, NULL, 1) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_gi_set_lights(gi, NULL, 0) == VOXRT_OK);
    CHECK(voxrt_gi_render(&d, gi, &g, NULL, NULL, NULL) == VOXRT_OK); /* no pixels */
    g.width = g.height = 1;
    CHECK(voxrt_gi_render(&d, gi, &g, NULL, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    g.position = one;
    g.normal = up;
    g.albedo = up;
    d.radius = -1;
    CHECK(voxrt_gi_render(&d, gi, &g, NULL, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    d.radius = 0;
    CHECK(voxrt_gi_render(&d, NULL, &g, NULL, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    one[0] = NAN; /* a position that is none: no light, no NaN */
    {
        float direct[3] = {9, 9, 9}, indirect[3] = {9, 9, 9};
        CHECK(voxrt_gi_render(&d, gi, &g, direct, indirect, NULL) == VOXRT_OK);
        CHECK(direct[0] == 0 && indirect[1] == 0);
    }
    CHECK(voxrt_gi_bounce(gi, NULL, 4, NAN, 0) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_gi_bounce(NULL, NULL, 4, 0, 0) == VOXRT_ERR_INVALID_ARG);
    {
        voxrt_column_hit hit;
        voxrt_gi_surface surface;
        memset(&hit, 0, sizeof hit);
        CHECK(voxrt_gi_get(gi, &hit, NULL, &surface) == 0 && voxrt_gi_get(gi, &hit, up, NULL) == 0 && voxrt_gi_get(gi, NULL, up, &surface) == 0);
        CHECK(voxrt_gi_virtual_lights(gi, NULL, 5) == 0 && voxrt_gi_virtual_lights(NULL, one, 0) == 0);
    }
    voxrt_gi_destroy(gi);
    voxrt_gi_destroy(NULL);
}

#define SAYS(call, what) \
    do { \
        memset(&error, 0, sizeof error); \
        CHECK_MSG((call) == VOXRT_ERR_INVALID_ARG && error.code == VOXRT_ERR_INVALID_ARG && strstr(error.text, what) != NULL, "%s: %s", #call, \
                  error.text); \
    } while (0)

TEST(errors_say_what_is_wrong) {
    voxrt_error error;
    voxrt_gi_desc gd;
    voxrt_gi_render_desc d;
    voxrt_gi *gi = NULL;
    voxrt_camera camera, nowhere;
    voxrt_geometry none;
    voxrt_gbuffer g, empty;
    voxrt_env env;
    float p[3] = {0, 0, 0}, n[3] = {0, 1, 0};
    uint32_t k;
    memset(&gd, 0, sizeof gd);
    memset(&d, 0, sizeof d);
    memset(&camera, 0, sizeof camera);
    memset(&nowhere, 0, sizeof nowhere);
    memset(&none, 0, sizeof none);
    memset(&g, 0, sizeof g);
    memset(&env, 0, sizeof env);
    env.error = gd.env.error = d.env.error = &error;
    env.thread_count = d.env.thread_count = 1;
    gd.columns.size_x = gd.columns.size_y = 16;
    gd.columns.size_z = 64;
    for (k = 0; k < 3; k++) gd.columns.box_max[k] = 1;
    camera.eye[2] = 2;
    g.width = g.height = 1;
    empty = g;
    g.position = p;
    g.normal = g.albedo = n;
    REQUIRE(voxrt_gi_create(&gd, &gi) == VOXRT_OK);
    SAYS(voxrt_gi_add(gi, NULL, NULL), "object");
    SAYS(voxrt_gi_set(gi, 0, NULL), "object");
    SAYS(voxrt_gi_set_lights(gi, NULL, 2), "lights");
    SAYS(voxrt_gi_follow(gi, NULL, NULL), "centre");
    SAYS(voxrt_gi_bounce(NULL, &env, 16, 0, 0), "scene");
    SAYS(voxrt_gi_bounce(gi, &env, 16, 2, 0), "weight");
    SAYS(voxrt_gi_bounce(gi, &env, (1u << 20) + 1, 0, 0), "rays");
    SAYS(voxrt_gi_render(&d, NULL, &g, NULL, NULL, NULL), "scene");
    SAYS(voxrt_gi_render(&d, gi, NULL, NULL, NULL, NULL), "G-buffer");
    d.method = (voxrt_gi_method)9;
    SAYS(voxrt_gi_render(&d, gi, &g, NULL, NULL, NULL), "method");
    d.method = VOXRT_GI_NONE;
    d.shadow = &none;
    SAYS(voxrt_gi_render(&d, gi, &g, n, NULL, NULL), "functions");
    SAYS(voxrt_gbuffer_from_geometry(&env, &camera, &none, &g), "functions");
    SAYS(voxrt_gbuffer_from_gi(&env, &camera, NULL, &g), "scene");
    SAYS(voxrt_gbuffer_from_gi(&env, NULL, gi, &g), "camera");
    SAYS(voxrt_gbuffer_from_gi(&env, &nowhere, gi, &g), "camera");
    SAYS(voxrt_gbuffer_from_gi(&env, &camera, gi, NULL), "G-buffer");
    SAYS(voxrt_gbuffer_from_gi(&env, &camera, gi, &empty), "position");
    SAYS(voxrt_gbuffer_from_geometry(&env, &camera, NULL, &g), "geometry");
    SAYS(voxrt_gbuffer_edges(&env, NULL, gi, &g), "camera");
    SAYS(voxrt_gbuffer_edges(&env, &nowhere, gi, &g), "camera");
    SAYS(voxrt_gbuffer_edges(&env, &camera, NULL, &g), "scene");
    SAYS(voxrt_gbuffer_edges(&env, &camera, gi, &empty), "position");
    SAYS(voxrt_gbuffer_materials(&env, NULL, &g), "scene");
    SAYS(voxrt_gbuffer_materials(&env, gi, &empty), "position");
    g.width = 65536;
    SAYS(voxrt_gbuffer_materials(&env, gi, &g), "65535");
    CHECK(voxrt_gbuffer_from_gi(NULL, NULL, gi, &g) == VOXRT_ERR_INVALID_ARG); /* without a place to say it */
    CHECK(voxrt_gi_follow(NULL, NULL, NULL) == VOXRT_ERR_INVALID_ARG && voxrt_gi_add(NULL, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    voxrt_gi_destroy(gi);
}

/* Pixels of a G-buffer that are none among others: normals that are no unit vectors, positions, exponents. No other pixel
   gets a value that is none from them. */
TEST(pixels_that_are_none) {
    enum { N = 24 * 16 };
    static room r;
    static float specular[N][4], got[2][N][3], position[N][3], normal[N][3];
    static const float odd[6] = {NAN, INFINITY, -INFINITY, 1e30f, -1e30f, 100.0f};
    voxrt_gi_render_desc d;
    voxrt_gi_history *history = NULL;
    uint32_t way, i, k, what;
    room_open(&r, 24, 16, 1);
    r.g.specular = specular[0];
    memcpy(position, r.position, sizeof position);
    memcpy(normal, r.normal, sizeof normal);
    CHECK(voxrt_gi_history_create(NULL, &history) == VOXRT_OK);
    for (way = 0; way < 5; way++) { /* gathering, openness, virtual lights, coarse meshes, pictures before this one */
        memset(&d, 0, sizeof d);
        d.env.thread_count = 1;
        d.camera = r.camera;
        d.rays = 4;
        d.method = way == 1 ? VOXRT_GI_AO : way == 2 ? VOXRT_GI_VPL : VOXRT_GI_GATHER;
        d.coarse = way == 3 ? 4 : 0;
        d.filter = way == 3 ? 0 : 3;
        d.direct_filter = way == 2 ? 2 : 0;
        d.history = way == 4 ? history : NULL;
        for (what = 0; what < 6; what++) {
            for (i = 0; i < N; i++) {
                memcpy(r.position[i], position[i], 12);
                memcpy(r.normal[i], normal[i], 12);
                memcpy(r.before[i], position[i], 12);
                for (k = 0; k < 3; k++) specular[i][k] = 0.25f;
                specular[i][3] = i % 2 ? 8.0f : 0.0f;
                if (i % 7 != 3) continue;
                if (i % 4 == 0) r.normal[i][1] = odd[what];
                if (i % 4 == 1) r.position[i][2] = odd[what];
                if (i % 4 == 2) specular[i][3] = odd[what];
                if (i % 4 == 3) r.before[i][0] = odd[what];
            }
            CHECK(voxrt_gi_render(&d, r.gi, &r.g, got[0][0], got[1][0], NULL) == VOXRT_OK);
            for (i = 0; i < N; i++)
                for (k = 0; k < 3; k++)
                    CHECK_MSG(got[0][i][k] >= 0 && got[0][i][k] < 1e3f && got[1][i][k] >= 0 && got[1][i][k] < 1e3f, "way %u, %g: pixel %u is %g, %g",
                              way, (double)odd[what], i, (double)got[0][i][k], (double)got[1][i][k]);
        }
    }
    voxrt_gi_history_destroy(history);
    voxrt_gi_destroy(r.gi);
}

/* Everything that asks for memory, request `fail` refused; the modes that objects are in, by `way`. True where it was not asked for. */
static uint32_t scene_refused(const model *m, uint32_t way, uint32_t fail) {
    test_alloc ta;
    voxrt_gi_desc d;
    voxrt_gi *gi = NULL;
    voxrt_gi_object o = object_of(m, 1);
    voxrt_gi_light l = point_light(0, 0, 0, 1);
    voxrt_result r;
    uint32_t a, done = 0;
    test_alloc_init(&ta);
    ta.fail_at = (int64_t)fail;
    memset(&d, 0, sizeof d);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    d.columns.size_x = d.columns.size_y = 8;
    d.columns.size_z = 64;
    d.env.thread_count = 1 + way / 2;
    d.nested = 1 + way % 2;
    o.material.emission[1] = way >= 2 ? 2.0f : 0.0f;
    o.mode = way == 0 ? VOXRT_COLUMNS_THIN : way == 1 ? VOXRT_COLUMNS_SAMPLES : way == 2 ? VOXRT_COLUMNS_SOLID : VOXRT_COLUMNS_BODY;
    for (a = 0; a < 3; a++) {
        d.columns.box_min[a] = -6;
        d.columns.box_max[a] = 6;
    }
    r = voxrt_gi_create(&d, &gi);
    CHECK(r == VOXRT_OK || (r == VOXRT_ERR_NO_MEMORY && gi == NULL));
    if (gi != NULL) {
        uint32_t tries;
        for (tries = 0; tries < 3; tries++) { /* what failed once can be called again */
            const voxrt_result r1 = voxrt_gi_add(gi, &o, NULL), r2 = voxrt_gi_set_lights(gi, &l, 1), r3 = voxrt_gi_update(gi, NULL);
            const voxrt_result r4 = voxrt_gi_bounce(gi, NULL, 1, 0, 0);
            voxrt_gi_render_desc rd;
            voxrt_gbuffer g;
            voxrt_gi_history *h = NULL;
            float p[4 * 4][3], n[4 * 4][3], c[4 * 4][3], sp[4 * 4][4], in[2][4 * 4][3];
            voxrt_result r5, r6;
            uint32_t k;
            memset(&rd, 0, sizeof rd);
            memset(n, 0, sizeof n);
            for (k = 0; k < 16; k++) {
                p[k][0] = p[k][1] = 0;
                p[k][2] = 0.1f * (float)k;
                n[k][2] = sp[k][3] = 1;
                c[k][0] = c[k][1] = c[k][2] = sp[k][0] = sp[k][1] = sp[k][2] = 0.5f;
            }
            g = gbuffer_of(4, 4, p, n, c);
            g.specular = sp[0];
            rd.env = d.env;
            rd.env.thread_count = 1;
            rd.rays = 1;
            rd.filter = 1;
            rd.camera.at[2] = 1;
            rd.camera.fov_y = 40;
            rd.coarse = 1u << tries;
            rd.lookup = tries == 0 ? VOXRT_GI_LOOKUP_MAPS : VOXRT_GI_LOOKUP_CACHE;
            rd.map_size = 8;
            rd.tolerance = tries == 1 ? 1.0f : 0;
            r5 = voxrt_gi_history_create(&d.env, &h);
            CHECK(r5 == VOXRT_OK || (r5 == VOXRT_ERR_NO_MEMORY && h == NULL));
            rd.history = h;
            r5 = voxrt_gi_render(&rd, gi, &g, in[0][0], in[1][0], NULL);
            rd.method = VOXRT_GI_VPL;
            r6 = voxrt_gi_render(&rd, gi, &g, NULL, in[1][0], NULL);
            CHECK((r5 == VOXRT_OK || r5 == VOXRT_ERR_NO_MEMORY) && (r6 == VOXRT_OK || r6 == VOXRT_ERR_NO_MEMORY));
            voxrt_gi_history_destroy(h);
            CHECK((r1 == VOXRT_OK || r1 == VOXRT_ERR_NO_MEMORY) && (r2 == VOXRT_OK || r2 == VOXRT_ERR_NO_MEMORY));
            CHECK((r3 == VOXRT_OK || r3 == VOXRT_ERR_NO_MEMORY) && (r4 == VOXRT_OK || r4 == VOXRT_ERR_NO_MEMORY));
            o.still = 0;
        }
        done = ta.failed == 0;
        voxrt_gi_destroy(gi);
    }
    test_alloc_check(&ta);
    return done;
}

TEST(memory) {
    static model m;
    uint32_t fail, way;
    sphere(&m, 2.5, 4, 200, 0);
    for (way = 0; way < 4; way++) {
        for (fail = 0; fail < 1000 && !scene_refused(&m, way, fail);) fail += test_quick() ? 1 + fail / 8 : 1; /* quick: the first ones all, later ones some */
        CHECK_MSG(fail > 50 && fail < 1000, "way %u: %u requests", way, fail);
    }
}

/* Memory runs out in a call: it has done nothing, or the next one ends as if nothing had been. Three nested volumes. */
TEST(memory_that_runs_out_loses_nothing) {
    static model a, b;
    static uint32_t want[3][2][40000];
    static size_t many[3][2];
    int64_t fail;
    uint32_t i, l, k, lost = 0, more = 1;
    sphere(&a, 3.0, 12, 200, 1);
    sphere(&b, 1.0, 10, 160, 0);
    for (fail = -1; fail < 400 && more; fail += test_quick() ? 1 + fail / 12 : 1) { /* the first time nothing fails; quick: later ones some */
        test_alloc ta;
        voxrt_gi_desc d;
        voxrt_gi *gi = NULL, *g;
        voxrt_gi_object oa = object_of(&a, 1), ob = object_of(&b, 0);
        const voxrt_gi_light light = point_light(0, 2, 0, 9);
        uint32_t id = 99, ids[2];
        voxrt_result r;
        test_alloc_init(&ta);
        memset(&d, 0, sizeof d);
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        d.env.thread_count = 1;
        d.columns.size_x = d.columns.size_y = 16;
        d.columns.size_z = 64;
        d.nested = 3;
        for (k = 0; k < 3; k++) {
            d.columns.box_min[k] = -4;
            d.columns.box_max[k] = 4;
        }
        REQUIRE(voxrt_gi_create(&d, &gi) == VOXRT_OK);
        ta.fail_at = fail >= 0 && fail < 3 ? ta.count + fail : -1;
        r = voxrt_gi_add(gi, &oa, &id);
        CHECK(r == (ta.failed != 0 ? VOXRT_ERR_NO_MEMORY : VOXRT_OK));
        for (g = gi; g != NULL && r != VOXRT_OK; g = g->outer)
            for (i = 0; i < g->entry_count; i++) CHECK_MSG(!g->entry[i].used, "an object that is not there");
        ta.fail_at = -1;
        if (r != VOXRT_OK) CHECK(voxrt_gi_add(gi, &oa, &id) == VOXRT_OK);
        ids[0] = id;
        ob.to_world[0] = ob.to_world[5] = ob.to_world[10] = 1;
        CHECK(voxrt_gi_add(gi, &ob, &ids[1]) == VOXRT_OK && voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK);
        CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK && voxrt_gi_bounce(gi, NULL, 2, 0, 0) == VOXRT_OK);
        oa.material.albedo[0] = 0.5f; /* what stands still and what moves are made anew */
        ob.to_world[3] = 1.5;
        CHECK(voxrt_gi_set(gi, ids[0], &oa) == VOXRT_OK && voxrt_gi_set(gi, ids[1], &ob) == VOXRT_OK);
        more = fail < 3;
        ta.failed = 0;
        ta.fail_at = fail >= 0 ? ta.count + fail : -1;
        for (i = 0; i < 2; i++) { /* it fails once more, the next time */
            r = voxrt_gi_update(gi, NULL);
            CHECK(r == (ta.failed != 0 ? VOXRT_ERR_NO_MEMORY : VOXRT_OK));
            if (r == VOXRT_OK) break;
            more = 2;
            ta.failed = 0;
            ta.fail_at = i == 0 ? ta.count + fail % 4 : -1;
        }
        ta.fail_at = -1;
        if (r != VOXRT_OK) CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
        for (g = gi, k = 0; g != NULL; g = g->outer, k++)
            for (l = 0; l < 2; l++) {
                if (fail < 0) many[k][l] = g->layer[l].count;
                REQUIRE(many[k][l] == g->layer[l].count && many[k][l] <= 20000);
                if (fail < 0) memcpy(want[k][l], g->layer[l].bounce, 8 * many[k][l]);
                lost += memcmp(want[k][l], g->layer[l].bounce, 8 * many[k][l]) != 0;
                for (i = 0, id = 0; i < 2 * many[k][l]; i++) id += want[k][l][i] != VOXRTI_GI_UNKNOWN;
                CHECK_MSG(k != 0 || id > many[k][l] / 2, "light is known on %u of %u cells", id, (uint32_t)many[k][l]);
            }
        CHECK_MSG(lost == 0, "allocation %d: light that bounced is lost", (int)fail);
        voxrt_gi_destroy(gi);
        test_alloc_check(&ta);
    }
    CHECK_MSG(!more && fail > 10, "%d requests", (int)fail);
}

TEST(lamps_that_change_before_the_next_try) { /* what bounced keeps its brightness when memory runs out in between */
    static model a, b;
    static uint32_t want[2][20000];
    int64_t fail;
    uint32_t k, l, some = 1, lost = 0;
    sphere(&a, 3.0, 12, 200, 1);
    sphere(&b, 1.0, 10, 160, 0);
    for (fail = -1; some; fail++) { /* the first time nothing fails */
        test_alloc ta;
        voxrt_gi_desc d;
        voxrt_gi *gi = NULL;
        voxrt_gi_object o[2];
        voxrt_gi_light light = point_light(0, 2, 0, 9);
        test_alloc_init(&ta);
        memset(&d, 0, sizeof d);
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        d.env.thread_count = 1;
        d.columns.size_x = d.columns.size_y = 16;
        d.columns.size_z = 64;
        for (k = 0; k < 3; k++) {
            d.columns.box_min[k] = -4;
            d.columns.box_max[k] = 4;
        }
        REQUIRE(voxrt_gi_create(&d, &gi) == VOXRT_OK);
        o[0] = object_of(&a, 1);
        o[1] = object_of(&b, 0);
        for (k = 0; k < 2; k++) CHECK(voxrt_gi_add(gi, &o[k], NULL) == VOXRT_OK);
        CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
        CHECK(voxrt_gi_bounce(gi, NULL, 2, 0, 0) == VOXRT_OK);
        for (k = 0; k < 2; k++) {
            o[k].material.albedo[0] = 0.5f;
            CHECK(voxrt_gi_set(gi, k, &o[k]) == VOXRT_OK);
        }
        if (fail >= 0) {
            ta.fail_at = ta.count + fail;
            ta.failed = 0;
            some = voxrt_gi_update(gi, NULL) == VOXRT_ERR_NO_MEMORY;
            ta.fail_at = -1;
        }
        for (k = 0; k < 3; k++) light.color[k] *= 1.0f / 64;
        if (some) CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
        for (l = 0; l < 2 && some; l++) {
            REQUIRE(gi->layer[l].count > 100 && gi->layer[l].count <= 10000);
            if (fail < 0) memcpy(want[l], gi->layer[l].bounce, 8 * gi->layer[l].count);
            lost += memcmp(want[l], gi->layer[l].bounce, 8 * gi->layer[l].count) != 0;
        }
        voxrt_gi_destroy(gi);
        test_alloc_check(&ta);
    }
    CHECK_MSG(fail > 5 && lost == 0, "%u of %d times", lost, (int)fail);
}

/* A scene whose objects move from one place to the next; the update in between may be stopped, or have no memory. What
   objects are known to have moved by, and what bounced: 1, if both are those of `want` (of 0: these are kept). */
typedef struct moves { uint32_t nested, places, how; int64_t stop; } moves; /* how: 0 not at all, 1 cancel, 2 memory */
typedef struct moved_state { double back[2][2][12]; uint32_t light[2][2][20000]; } moved_state;
static int after_moves(const moves *m, moved_state *want, voxrt_result *stopped) {
    static model a, b;
    const double way[3][3] = {{0, 0, 0}, {0.5, 0.25, 0}, {0.75, 0.75, 0.25}};
    stopper s;
    test_alloc ta;
    voxrt_gi_desc d;
    voxrt_gi *gi = NULL, *g;
    voxrt_gi_object o[2];
    voxrt_gi_light light = point_light(0, 3, 0, 9e-12f); /* what glows is brighter by far */
    uint32_t k, l, place, same = 1;
    const int fill = m->how == 0;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    test_alloc_init(&ta);
    sphere(&a, 1.0, 12, 200, 0);
    sphere(&b, 0.75, 10, 160, 0);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    d.env.progress_fn = stop_fn;
    d.env.progress_user = &s;
    d.env.thread_count = 1;
    d.nested = m->nested;
    d.columns.size_x = d.columns.size_y = 32;
    d.columns.size_z = 64;
    for (k = 0; k < 3; k++) {
        d.columns.box_min[k] = -4;
        d.columns.box_max[k] = 4;
    }
    if (voxrt_gi_create(&d, &gi) != VOXRT_OK) return 0;
    o[0] = object_of(&a, 1);
    o[1] = object_of(&b, 0);
    o[1].material.emission[0] = 2.0f;
    for (place = 0; place <= m->places; place++) {
        o[0].material.emission[1] = place == 0 ? 0.0f : 0.01f; /* more triangles glow than before */
        for (k = 0; k < 2; k++) {
            for (l = 0; l < 12; l++) o[k].to_world[l] = l % 5 == 0;
            for (l = 0; l < 3; l++) o[k].to_world[4 * l + 3] = way[place][l] * (k == 0 ? -1.0 : 1.0) + (k == 0 ? -1.0 : 1.0);
            CHECK((place == 0 ? voxrt_gi_add(gi, &o[k], NULL) : voxrt_gi_set(gi, k, &o[k])) == VOXRT_OK);
        }
        if (place == 0) {
            CHECK(voxrt_gi_set_lights(gi, &light, 1) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
            CHECK(voxrt_gi_bounce(gi, NULL, 2, 0, 0) == VOXRT_OK);
        } else if (place == 1 && m->how != 0) {
            s.calls = 0;
            s.after = m->how == 1 ? (uint32_t)m->stop + 1 : 0;
            ta.fail_at = m->how == 2 ? ta.count + m->stop : -1;
            *stopped = voxrt_gi_update(gi, NULL);
            s.after = 0;
            ta.fail_at = -1;
        }
    }
    if (m->how == 0 || *stopped != VOXRT_OK) CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
    for (g = gi, l = 0; g != NULL && l < 2; g = g->outer, l++)
        for (k = 0; k < 2; k++) {
            const size_t bytes = 8 * g->layer[k].count;
            CHECK_MSG(g->entry[k].moved && bytes > 100 && bytes <= sizeof want->light[l][k], "%u, %u: %u bytes", l, k, (unsigned)bytes);
            if (fill) memcpy(want->back[l][k], g->entry[k].back, sizeof g->entry[k].back);
            if (fill) memcpy(want->light[l][k], g->layer[k].bounce, bytes);
            same &= g->entry[k].moved && memcmp(want->back[l][k], g->entry[k].back, sizeof g->entry[k].back) == 0;
            same &= memcmp(want->light[l][k], g->layer[k].bounce, bytes) == 0;
        }
    voxrt_gi_destroy(gi);
    test_alloc_check(&ta);
    return (int)same;
}

TEST(updates_that_fail_see_no_move) { /* wherever they end: objects still come from where the last one that ended well had them */
    static moved_state want;
    moves m;
    for (m.nested = 1; m.nested <= 2; m.nested++)
        for (m.places = 1; m.places <= 2; m.places++) { /* on to a third place before the next try */
            voxrt_result r = VOXRT_OK;
            m.how = 0;
            m.stop = 0;
            CHECK(after_moves(&m, &want, &r));
            for (m.how = 1; m.how <= 2; m.how++) {
                uint32_t lost = 0, tries = 0;
                for (m.stop = 0;; m.stop++) {
                    const int same = after_moves(&m, &want, &r);
                    if (r == VOXRT_OK) break;
                    CHECK(r == (m.how == 1 ? VOXRT_ERR_CANCELLED : VOXRT_ERR_NO_MEMORY));
                    tries++;
                    lost += !same;
                }
                CHECK_MSG(tries > (m.how == 1 ? m.nested - 1 : 5) && lost == 0, "%u volumes, %u places, %s: %u of %u lost", m.nested, m.places,
                          m.how == 1 ? "cancelled" : "memory", lost, tries);
            }
        }
}

TEST(lamps_that_go_out) { /* for a picture, and come back as they were: what has bounced is the same bits */
    static room r;
    static uint32_t first[40000];
    const float bright = 80 * 1099511627776.0f;
    room_open(&r, 8, 8, 0);
    r.light.color[0] = r.light.color[1] = r.light.color[2] = bright;
    CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK && voxrt_gi_bounce(r.gi, NULL, 4, 0, 3) == VOXRT_OK);
    REQUIRE(r.gi->layer[0].count <= 20000 && r.gi->layer[0].count > 5000);
    memcpy(first, r.gi->layer[0].bounce, 8 * r.gi->layer[0].count);
    CHECK(voxrt_gi_set_lights(r.gi, NULL, 0) == VOXRT_OK && voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK);
    CHECK(memcmp(first, r.gi->layer[0].bounce, 8 * r.gi->layer[0].count) == 0);
    voxrt_gi_destroy(r.gi);
}

TEST(lamps_that_fade) { /* what has bounced is much too bright for the new lamps: it stays as bright as cells can say */
    static room r;
    size_t i, lost = 0, lit = 0;
    room_open(&r, 8, 8, 0);
    CHECK(voxrt_gi_bounce(r.gi, NULL, 4, 0, 3) == VOXRT_OK);
    r.light.color[0] = r.light.color[1] = r.light.color[2] = r.light.color[0] * 1e-9f;
    CHECK(voxrt_gi_set_lights(r.gi, &r.light, 1) == VOXRT_OK);
    for (i = 0; i < 2 * r.gi->layer[0].count; i++) {
        lit += r.gi->layer[0].record[i / 2].area[i % 2] != 0;
        lost += r.gi->layer[0].record[i / 2].area[i % 2] != 0 && r.gi->layer[0].bounce[i] == VOXRTI_GI_UNKNOWN;
    }
    CHECK_MSG(lit > 5000 && lost == 0, "%u of %u sides lost", (unsigned)lost, (unsigned)lit);
    voxrt_gi_destroy(r.gi);
}

/* A sheet of `layers` triangles in one cell, one on the other: red from above; blue from below, a little lower. */
static void crowd(uint32_t layers, uint32_t threads, voxrt_gi_surface s[2]) {
    static const float p[6][3] = {{0.4f, 0.4f, 0.6f}, {0.6f, 0.4f, 0.6f}, {0.4f, 0.6f, 0.6f}, {0.4f, 0.4f, 0.4f}, {0.4f, 0.6f, 0.4f}, {0.6f, 0.4f, 0.4f}};
    const float dir[2][3] = {{0, 0, -1}, {0, 0, 1}};
    uint32_t (*index)[3] = (uint32_t (*)[3])malloc((size_t)layers * sizeof *index);
    uint8_t (*rgb)[3] = (uint8_t (*)[3])calloc(layers, sizeof *rgb);
    voxrt_gi_desc d;
    voxrt_gi *gi = NULL;
    voxrt_gi_object o;
    voxrt_column_hit hit;
    uint32_t i, k;
    if (index == NULL || rgb == NULL) abort();
    for (i = 0; i < layers; i++) {
        for (k = 0; k < 3; k++) index[i][k] = k + 3 * (i & 1u);
        rgb[i][i & 1u ? 2 : 0] = 255;
    }
    memset(&d, 0, sizeof d);
    d.env.thread_count = threads;
    d.columns.size_x = d.columns.size_y = 4;
    d.columns.size_z = 64;
    d.columns.depth_axis_plus_1 = 3;
    for (k = 0; k < 3; k++) {
        d.columns.box_min[k] = k < 2 ? -2 : -32;
        d.columns.box_max[k] = k < 2 ? 2 : 32;
    }
    memset(&o, 0, sizeof o);
    o.mesh.positions = p[0];
    o.mesh.vertex_count = 6;
    o.mesh.indices = index[0];
    o.mesh.triangle_count = layers;
    o.mesh.triangle_rgb = rgb[0];
    o.mode = VOXRT_COLUMNS_FAT;
    memset(&hit, 0, sizeof hit);
    hit.cell[0] = hit.cell[1] = 2;
    hit.cell[2] = 32;
    CHECK(voxrt_gi_create(&d, &gi) == VOXRT_OK && voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    for (k = 0; k < 2; k++) CHECK(voxrt_gi_get(gi, &hit, dir[k], &s[k]) != 0);
    voxrt_gi_destroy(gi);
    free(index);
    free(rgb);
}

TEST(crowds_in_cells) { /* however many triangles lie in a cell, they have the colours and normals of two */
    static const uint32_t layers[6] = {100, 65536, 131100, 140000, 400000, 1200000};
    voxrt_gi_surface two[2], s[2];
    uint32_t i, k, a;
    crowd(2, 1, two);
    for (i = 0; i < (test_quick() ? 5u : 6u); i++) {
        crowd(layers[i], 1 + i % 2, s);
        for (k = 0; k < 2; k++)
            for (a = 0; a < 3; a++) {
                CHECK_MSG(fabsf(s[k].albedo[a] - two[k].albedo[a]) < 0.01f, "%u: side %u, colour %g, not %g", layers[i], k,
                          (double)s[k].albedo[a], (double)two[k].albedo[a]);
                CHECK_MSG(fabsf(s[k].normal[a] - two[k].normal[a]) < 0.01f, "%u: side %u, normal %g, not %g", layers[i], k,
                          (double)s[k].normal[a], (double)two[k].normal[a]);
                CHECK(fabsf(s[k].position[a] - two[k].position[a]) < 0.01f);
            }
    }
    CHECK(two[0].albedo[0] > 0.99f && two[0].albedo[2] < 0.01f && two[1].albedo[2] > 0.99f && two[1].normal[2] < -0.99f);
}

TEST(lobes_beside_open_skies) { /* direct light is the same whatever is asked for beside it */
    static model m;
    const double f[4][3] = {{-5, -5, 0}, {5, -5, 0}, {5, 5, 0}, {-5, 5, 0}};
    const voxrt_gi_light l = point_light(0, 0, 3, 1);
    float position[1][3] = {{0, 0, 0}}, normal[1][3] = {{0, 0, 1}}, albedo[1][3] = {{0.5f, 0.5f, 0.5f}}, specular[4] = {0.5f, 0.5f, 0.5f, 10};
    float direct[2][3], open[3];
    voxrt_gbuffer g = gbuffer_of(1, 1, position, normal, albedo);
    voxrt_gi_render_desc d;
    voxrt_gi *gi;
    m.points = m.triangles = 0;
    quad(&m, f[0], f[1], f[2], f[3], 255);
    gi = alone(&m);
    CHECK(voxrt_gi_set_lights(gi, &l, 1) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    d.camera.eye[2] = 4;
    g.specular = specular;
    d.method = VOXRT_GI_NONE;
    CHECK(voxrt_gi_render(&d, gi, &g, direct[0], NULL, NULL) == VOXRT_OK);
    d.method = VOXRT_GI_AO;
    CHECK(voxrt_gi_render(&d, gi, &g, direct[1], open, NULL) == VOXRT_OK);
    CHECK(direct[0][0] > 0 && memcmp(direct[0], direct[1], sizeof direct[0]) == 0);
    CHECK(open[0] == 1);
    voxrt_gi_destroy(gi);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(shared_exponents);
    RUN(samples_are_spread);
    RUN(both_sides_of_a_thin_plate);
    RUN(still_and_moving_objects_look_the_same);
    RUN(closed_sphere);
    RUN(lamps_near_surfaces_leave_no_dots);
    RUN(ways_to_look_up_light);
    RUN(virtual_lights);
    RUN(spot_lights_become_virtual_ones);
    RUN(sharp_lobes);
    RUN(phong_lobes);
    RUN(phong_senders);
    RUN(meshes_that_emit);
    RUN(coarse_meshes_of_pixels);
    RUN(noise_is_what_was_asked_for);
    RUN(noise_of_random_views);
    RUN(history_of_a_still_scene_is_the_mean);
    RUN(history_follows_changes);
    RUN(nested_volumes);
    RUN(bounced_light_moves_with_objects);
    RUN(time_budget);
    RUN(nothing_leaks_through_a_thin_wall);
    RUN(feet_of_walls_let_nothing_through);
    RUN(feet_end_where_walls_end);
    RUN(feet_stop_light_on_their_own_side);
    RUN(openness_is_a_form_factor);
    RUN(threads_and_instruction_sets);
    RUN(threads_and_instruction_sets_in_all_methods);
    RUN(filter_keeps_to_surfaces);
    RUN(filters_leave_colours);
    RUN(units_of_light_do_not_matter);
    RUN(many_rays_sum_up);
    RUN(lamps_near_cells_give_no_more_than_they_send);
    RUN(sheets_have_two_sides);
    RUN(still_scenes_come_to_rest);
    RUN(neighbours_share_a_sequence);
    RUN(noise_of_neighbours_is_high_in_frequency);
    RUN(neighbours_make_less_noise);
    RUN(edges_keep_both_faces);
    RUN(lamps_do_not_shade_themselves);
    RUN(walls_on_borders_of_cells);
    RUN(pixels_at_edges_show_one_face);
    RUN(relief);
    RUN(lists_have_every_pixel_once);
    RUN(stopped_pictures_leave_no_trace);
    RUN(two_scenes_at_once);
    RUN(readers_at_once);
    RUN(every_edit_begins_anew);
    RUN(things_that_turn_do_not_pop);
    RUN(deforming_meshes);
    RUN(objects_by_samples_and_solid);
    RUN(samples_follow_objects);
    RUN(a_camera_that_pans);
    RUN(volumes_that_follow_leave_no_seam);
    RUN(tones);
    RUN(bad_input);
    RUN(errors_say_what_is_wrong);
    RUN(pixels_that_are_none);
    RUN(memory);
    RUN(memory_that_runs_out_loses_nothing);
    RUN(lamps_that_go_out);
    RUN(updates_that_fail_see_no_move);
    RUN(lamps_that_fade);
    RUN(lamps_that_change_before_the_next_try);
    RUN(crowds_in_cells);
    RUN(lobes_beside_open_skies);
    return test_end();
}
