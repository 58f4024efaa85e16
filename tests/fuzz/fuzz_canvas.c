/* fuzz_canvas.c - bytes as samples, points, depths and frames of zbufrand.h, which need not come from a scene: a picture of finite numbers,
   the same for every isa, number of threads and order of samples, or a refusal; suspects, layers, means of frames, and what the theory says
   of numbers. Bytes: 24 of options; then 16-bit numbers, odd: a multiple of 1/64, even: the upper half of a float. */
#define ZBUFRAND_IMPLEMENTATION
#include "../../zbufrand.h"

enum { WIDE = 11, HIGH = 8, PIXELS = WIDE * HIGH, OPTIONS = 24, NUMBERS = 320, SAMPLES = 60 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(int ok) {
    if (!ok) abort();
}

static zbufrand_env env_of(uint32_t threads) {
    zbufrand_env e;
    memset(&e, 0, sizeof e);
    e.thread_count = threads;
    e.memory_limit = 1u << 26;
    return e;
}

/* Points seen through a view, or samples as they come; colours are numbers that a picture can have. */
static void samples_of(const uint8_t *o, const float *f, zbufrand_sample s[SAMPLES], zbufrand_view *view) {
    zbufrand_points p;
    uint32_t i, k;
    memset(view, 0, sizeof *view);
    memset(&p, 0, sizeof p);
    for (i = 0; i < 3; i++) view->world_to_camera[i][i] = 1;
    for (i = 0; i < 12 && (o[0] & 1); i++) view->world_to_camera[i / 4][i % 4] = (double)f[i];
    view->focal = o[0] & 2 ? (double)f[12] : 8;
    view->center_x = WIDE / 2.0;
    view->center_y = HIGH / 2.0;
    view->near_z = o[0] & 4 ? (double)f[13] : 0.01;
    view->far_z = o[0] & 8 ? (double)f[14] : 0;
    memset(s, 0, SAMPLES * sizeof *s);
    p.positions = f + 20;
    p.normals = o[0] & 16 ? f + 60 : NULL;
    p.count = SAMPLES;
    if ((o[0] & 32) && zbufrand_project(view, &p, 0, SAMPLES, s) == ZBUFRAND_OK) return;
    for (i = 0; i < SAMPLES; i++) {
        const float *q = f + 3 * i;
        s[i].x = o[1] & 1 ? q[0] : (float)(i * 7 % 23) / 2;
        s[i].y = o[1] & 1 ? q[1] : (float)(i * 5 % 17) / 2;
        s[i].z = o[1] & 2 ? q[2] : 1.0f + (float)(i % 7) / 7;
        if (o[1] & 4) {
            s[i].slope_x = q[100];
            s[i].slope_y = q[101];
        }
        for (k = 0; k < 3; k++) s[i].rgb[k] = (float)((i * (k + 1)) % 5) / 4;
        s[i].flags = i >> 2 & (o[1] >> 3 & 1u);
    }
}

static void canvas(const uint8_t *o, const float *f, zbufrand_sample *s, float *keep_rgba, float *keep_depth) {
    float rgba[2][PIXELS * 4], depth[2][PIXELS];
    uint32_t number[2][PIXELS], k, i;
    zbufrand_result r[2];
    zbufrand_source source;
    memset(rgba, 0, sizeof rgba);
    memset(depth, 0, sizeof depth);
    memset(number, 0, sizeof number);
    memset(&source, 0, sizeof source);
    source.shade_fn = zbufrand_samples_shade;
    source.surface_fn = zbufrand_samples_surface;
    source.user = s;
    for (k = 0; k < 2; k++) {
        zbufrand_canvas_desc d;
        zbufrand_canvas *c = NULL;
        zbufrand_picture picture;
        zbufrand_submit_stats stats;
        memset(&d, 0, sizeof d);
        memset(&stats, 0, sizeof stats);
        d.env = env_of(1 + k);
        d.isa = k ? ZBUFRAND_ISA_AUTO : ZBUFRAND_ISA_SCALAR;
        d.width = WIDE;
        d.height = HIGH;
        d.bucket_bits = o[2] & 1 ? o[2] >> 1 & 31 : 0;
        d.reconstruct.block = o[3] & 15;
        d.reconstruct.occlusion = (zbufrand_occlusion)(o[3] >> 4 & 7);
        d.reconstruct.fill = (zbufrand_fill)(o[4] & 7);
        d.reconstruct.reach = o[4] >> 3 & 7;
        d.reconstruct.plane_depth = o[4] >> 6 & 1;
        d.reconstruct.repair = o[4] >> 7;
        d.reconstruct.gauss_radius = o[5] & 1 ? f[200] : 0;
        d.reconstruct.gauss_support = o[5] & 2 ? f[201] : 0;
        d.reconstruct.tolerance = o[5] & 4 ? f[202] : 0;
        d.reconstruct.tolerance_projected = o[5] & 8 ? f[203] : 0;
        d.reconstruct.focal = o[5] & 16 ? f[204] : 0;
        d.reconstruct.tolerance_slope = o[5] & 32 ? f[205] : 0;
        d.reconstruct.tolerance_color = o[5] & 64 ? f[206] : 0;
        d.reconstruct.drop_back = o[5] >> 7;
        r[k] = zbufrand_canvas_create(&d, &c);
        must((r[k] == ZBUFRAND_OK) == (c != NULL));
        if (c == NULL) continue;
        must(zbufrand_canvas_guard(c) <= 65536);
        zbufrand_canvas_clear(c, o[6]);
        if (k == 0) must(zbufrand_canvas_submit(c, s, SAMPLES, 0, &stats) == ZBUFRAND_OK);
        for (i = SAMPLES; k != 0 && i > 0; i--) must(zbufrand_canvas_submit(c, s + i - 1, 1, i - 1, &stats) == ZBUFRAND_OK); /* any order */
        must(stats.accepted + stats.outside + stats.bad == SAMPLES);
        picture.rgba = rgba[k];
        picture.depth = depth[k];
        picture.number = number[k];
        r[k] = zbufrand_canvas_resolve(c, &source, &picture, NULL);
        zbufrand_canvas_destroy(c);
    }
    must(r[0] == r[1]);
    if (r[0] != ZBUFRAND_OK) return;
    must(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0 && memcmp(depth[0], depth[1], sizeof depth[0]) == 0);
    must(memcmp(number[0], number[1], sizeof number[0]) == 0);
    for (i = 0; i < PIXELS; i++) {
        for (k = 0; k < 4; k++) must(zbufrandi_finite_f(rgba[0][4 * i + k])); /* depths next to 0 have a mean of 0 */
        must(depth[0][i] >= 0 && (number[0][i] < SAMPLES || number[0][i] == 0xffffffffu));
    }
    memcpy(keep_rgba, rgba[0], sizeof rgba[0]);
    memcpy(keep_depth, depth[0], sizeof depth[0]);
}

/* Points, projected on the way or before: the same picture. */
static void points(const uint8_t *o, const float *f, const zbufrand_view *view) {
    static const uint8_t rgb[3 * 5] = {255, 0, 0, 0, 255, 0, 0, 0, 255, 90, 80, 70, 1, 2, 3};
    float rgba[2][PIXELS * 4], depth[2][PIXELS];
    uint32_t number[2][PIXELS], k;
    zbufrand_result r[2] = {ZBUFRAND_OK, ZBUFRAND_OK};
    zbufrand_points p;
    zbufrand_source source;
    memset(rgba, 0, sizeof rgba);
    memset(depth, 0, sizeof depth);
    memset(number, 0, sizeof number);
    memset(&p, 0, sizeof p);
    memset(&source, 0, sizeof source);
    p.positions = f + 20;
    p.position_stride = o[11] & 1 ? 4 * (3 + (o[11] >> 1 & 1u)) : 0;
    p.normals = o[0] & 16 ? f + 60 : NULL;
    p.rgb = o[11] & 4 ? rgb : NULL;
    p.count = p.rgb != NULL ? 5 : SAMPLES;
    source.shade_fn = zbufrand_points_shade;
    source.user = &p;
    for (k = 0; k < 2; k++) {
        zbufrand_canvas_desc d;
        zbufrand_canvas *c = NULL;
        zbufrand_picture picture;
        zbufrand_submit_stats stats;
        zbufrand_sample s[SAMPLES];
        memset(&d, 0, sizeof d);
        memset(&stats, 0, sizeof stats);
        d.env = env_of(1);
        d.isa = o[11] & 8 ? ZBUFRAND_ISA_SCALAR : ZBUFRAND_ISA_AUTO;
        d.width = WIDE;
        d.height = HIGH;
        d.reconstruct.block = 1 + (o[11] >> 4 & 3u);
        must(zbufrand_canvas_create(&d, &c) == ZBUFRAND_OK);
        if (k == 0) r[k] = zbufrand_canvas_submit_points(c, view, &p, 0, &stats);
        else {
            r[k] = zbufrand_project(view, &p, 0, p.count, s);
            if (r[k] == ZBUFRAND_OK) must(zbufrand_canvas_submit(c, s, p.count, 0, &stats) == ZBUFRAND_OK);
        }
        if (r[k] == ZBUFRAND_OK) must(stats.accepted + stats.outside + stats.bad == p.count);
        picture.rgba = rgba[k];
        picture.depth = depth[k];
        picture.number = number[k];
        if (r[k] == ZBUFRAND_OK) must(zbufrand_canvas_resolve(c, &source, &picture, NULL) == ZBUFRAND_OK);
        zbufrand_canvas_destroy(c);
    }
    must(r[0] == r[1] && memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0 && memcmp(depth[0], depth[1], sizeof depth[0]) == 0);
    must(memcmp(number[0], number[1], sizeof number[0]) == 0);
}

static void suspects(const uint8_t *o, const float *f, float *rgba, float *depth) {
    zbufrand_suspect_desc d;
    zbufrand_suspect list[2][PIXELS];
    size_t count[2] = {0, 0}, i;
    uint32_t k;
    memset(&d, 0, sizeof d);
    memset(list, 0, sizeof list);
    for (i = 0; i < PIXELS && (o[7] & 1); i++) depth[i] = f[i];
    for (k = 0; k < 2; k++) {
        d.env = env_of(1 + k);
        d.isa = k ? ZBUFRAND_ISA_AUTO : ZBUFRAND_ISA_SCALAR;
        d.width = WIDE;
        d.height = HIGH;
        d.tolerance = o[7] & 2 ? f[210] : 0;
        d.hole_count = o[8] & 15;
        d.wrong_count = o[8] >> 4;
        d.hole_rounds = o[7] >> 4;
        if (zbufrand_find_suspects(&d, depth, list[k], PIXELS, &count[k]) != ZBUFRAND_OK) return;
        must(count[k] <= PIXELS);
        for (i = 0; i < count[k]; i++) must(list[k][i].pixel < PIXELS && (i == 0 || list[k][i].pixel > list[k][i - 1].pixel));
    }
    must(count[0] == count[1] && memcmp(list[0], list[1], count[0] * sizeof list[0][0]) == 0);
    if (count[0] != 0 && (o[7] & 4)) list[0][0].pixel = o[8] * 7919u; /* any pixel at all is refused or mended */
    (void)zbufrand_mend(&d, rgba, depth, list[0], count[0]);
}

static void layers(const uint8_t *o, const float *f, const zbufrand_sample *s) {
    float rgba[PIXELS * 4], coverage[PIXELS * 4];
    zbufrand_layers_desc d;
    zbufrand_layers *l = NULL;
    uint32_t i, rounds = 0;
    memset(&d, 0, sizeof d);
    d.env = env_of(1 + (o[9] & 1));
    d.width = WIDE;
    d.height = HIGH;
    d.layers = o[9] >> 1 & 7;
    d.density = o[9] & 16 ? f[220] : 2;
    d.tolerance = o[9] & 32 ? f[221] : 0;
    d.dispersion = o[9] & 64 ? f[222] : 0;
    if (zbufrand_layers_create(&d, &l) != ZBUFRAND_OK) return;
    do must(zbufrand_layers_submit(l, s, SAMPLES) == ZBUFRAND_OK && rounds++ < 6); while (zbufrand_layers_next(l));
    if (zbufrand_layers_resolve(l, rgba, coverage) == ZBUFRAND_OK)
        for (i = 0; i < PIXELS * 4; i++) must(zbufrandi_finite_f(rgba[i]));
    zbufrand_layers_clear(l);
    zbufrand_layers_destroy(l);
}

static void frames(const uint8_t *o, float *f, const float *rgba, const float *depth, const zbufrand_view *view) {
    float got[2][PIXELS * 4];
    zbufrand_accumulator_desc d;
    zbufrand_noise noise;
    uint32_t k, i, n;
    memset(got, 0, sizeof got);
    for (k = 0; k < 2; k++) {
        zbufrand_accumulator *a = NULL;
        memset(&d, 0, sizeof d);
        d.env = env_of(1 + k);
        d.width = WIDE;
        d.height = HIGH;
        d.mode = (zbufrand_accumulation)(o[10] & 3);
        d.epsilon = o[10] & 4 ? f[230] : 0;
        d.blur = o[10] & 8 ? f[231] : 0;
        if (zbufrand_accumulator_create(&d, &a) != ZBUFRAND_OK) return;
        for (n = 0; n < 4; n++) {
            zbufrand_view moved = *view;
            float frame[PIXELS * 4];
            moved.world_to_camera[0][3] += o[10] & 16 ? (double)f[232 + n] : 0;
            for (i = 0; i < PIXELS * 4; i++) frame[i] = n & 1 && (o[10] & 32) ? f[i % NUMBERS] : rgba[i];
            (void)zbufrand_accumulator_add(a, frame, depth, &moved);
        }
        if (zbufrand_accumulator_noise(a, o[10] & 64 ? (double)f[240] : 0.01, &noise) == ZBUFRAND_OK) must(noise.rmse >= 0 && noise.frames >= 0);
        if (zbufrand_accumulator_get(a, o[10] & 128 ? f[241] : 0, got[k]) != ZBUFRAND_OK) memset(got[k], 0, sizeof got[k]);
        zbufrand_accumulator_destroy(a);
    }
    must(memcmp(got[0], got[1], sizeof got[0]) == 0);
    for (i = 0; i < PIXELS * 4; i++) must(zbufrandi_finite_f(got[0][i]));
}

static int share(double x) { /* NaN, or a probability */
    return !(x < 0.0) && !(x > 1.0);
}

static void theory(const float *f) {
    double a[8], p[8], value[8], variance;
    uint32_t i;
    for (i = 0; i < 8; i++) {
        a[i] = (double)f[i];
        value[i] = (double)f[8 + i];
    }
    for (i = 0; i < 8; i++) {
        const double n = zbufrand_samples((zbufrand_bound)i, a[0], a[1], a[2], a[3]);
        must(i > 3 || !(n < 0.0)); /* the others are approximations, good for probabilities near 1 */
    }
    must(!(zbufrand_density(a[0], a[1], a[2]) < 0.0) && !(zbufrand_samples_for_share(a[0], a[1], a[2]) < 0.0));
    if (a[1] < 1e6) (void)zbufrand_samples_tolerant(a[0], a[1], a[2], a[3]);
    (void)zbufrand_samples_lemma2(a[0], a[1], a[2]);
    must(share(zbufrand_success(a[0], a[1], a[2])) && share(zbufrand_success_bound(a[0], a[1], a[2])));
    must(!(zbufrand_expected_holes(a[0], a[1], a[2]) < 0.0) && !(zbufrand_holes_variance(a[0], a[1]) < 0.0));
    must(share(zbufrand_holes_tail(a[0], a[1], a[2])) && share(zbufrand_front_share(a[0], a[1])));
    must(share(zbufrand_bleed(a[0], a[1], a[2], a[3])) && share(zbufrand_block_spill(a[0], a[1], a[2])));
    must(share(zbufrand_multi_hit(a[0], a[1])) && share(zbufrand_empty_bound(a[0], a[1])));
    must(share(zbufrand_pixel_law(a, 8, a[0], p)));
    (void)zbufrand_expected_pixel(a, value, 8, a[0], a[1], &variance);
    (void)zbufrand_thinned_dispersion(a[0], a[1]);
    (void)zbufrand_smoothing_frames(a[0]);
    (void)zbufrand_block_time(a[0], a[1], a[2], a[3], a[4]);
    (void)zbufrand_harmonic(a[0]);
    (void)zbufrand_normal_quantile(a[0]);
    for (i = 0; i < 4; i++) (void)zbufrand_cell_edge((zbufrand_cells)i, a[0]);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    float f[NUMBERS], rgba[PIXELS * 4], depth[PIXELS];
    zbufrand_sample s[SAMPLES];
    zbufrand_view view;
    size_t i;
    if (size < OPTIONS + 2) return 0;
    for (i = 0; i < NUMBERS; i++) { /* those that are missing repeat the others */
        const uint8_t *q = data + OPTIONS + 2 * (i % ((size - OPTIONS) / 2));
        uint32_t u = (uint32_t)q[0] << 8 | q[1], w = u << 16;
        memcpy(&f[i], &w, sizeof w);
        if (u & 1) f[i] = ((float)(u >> 1) - 16384.0f) / 64.0f;
    }
    memset(rgba, 0, sizeof rgba);
    for (i = 0; i < PIXELS; i++) depth[i] = (float)INFINITY;
    samples_of(data, f, s, &view);
    canvas(data, f, s, rgba, depth);
    points(data, f, &view);
    layers(data, f, s);
    frames(data, f, rgba, depth, &view);
    suspects(data, f, rgba, depth);
    theory(f);
    return 0;
}
