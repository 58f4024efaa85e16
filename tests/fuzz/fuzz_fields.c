/* fuzz_fields.c - bytes as what tetcast.h makes volumes of beside cells: nodes of a lattice, boxes of refined cells, functions, points to fit,
   and planes and bodies that clip them. A refusal, or bricks, sums and pictures that are the same for every isa and number of threads; bounds
   that hold. Bytes: 24 of options; then 16-bit numbers, odd: a multiple of 1/64, even: the upper half of a float. */
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"

enum { WIDE = 8, HIGH = 6, PIXELS = WIDE * HIGH, OPTIONS = 24, NUMBERS = 300, FUNCTIONS = 8, POINTS = 10, ROOM = 1 << 26 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(int ok) {
    if (!ok) abort();
}
static int is_finite(float x) { return x - x == 0.0f; }

static tetcast_env env_of(uint32_t threads) {
    tetcast_env e;
    memset(&e, 0, sizeof e);
    e.thread_count = threads;
    e.memory_limit = ROOM;
    return e;
}

static tetcast_optics *colours(void) {
    static const tetcast_control_point p[3] = {{-1, {0, 0, 1}, 0.5f}, {0.5f, {1, 0.5f, 0}, 2}, {2, {1, 1, 1}, 0}};
    tetcast_transfer_desc td;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    memset(&td, 0, sizeof td);
    td.env = env_of(1);
    td.points = p;
    td.point_count = 3;
    if (tetcast_transfer_create(&td, &t) == TETCAST_OK) (void)tetcast_optics_create(t, NULL, &o);
    tetcast_transfer_destroy(t);
    must(o != NULL);
    return o;
}

static void camera_of(const uint8_t *o, const float *f, tetcast_camera *c) {
    uint32_t k;
    memset(c, 0, sizeof *c);
    for (k = 0; k < 3 && (o[0] & 1); k++) {
        c->eye[k] = (double)f[280 + k];
        c->at[k] = (double)f[283 + k];
    }
    c->ortho_height = o[0] & 2 ? f[286] : 0;
}

static tetcast_clip *clip_of(const uint8_t *o, const float *f) {
    double point[6][3];
    uint32_t index[12], i;
    tetcast_clip_plane plane[2];
    tetcast_clip_body body;
    tetcast_clip_desc d;
    tetcast_clip *c = NULL;
    if ((o[1] & 1) == 0) return NULL;
    memset(&d, 0, sizeof d); memset(&body, 0, sizeof body);
    for (i = 0; i < 18; i++) point[i / 3][i % 3] = (double)f[200 + i];
    for (i = 0; i < 12; i++) index[i] = o[2 + i % 4] / (1u + i) % 7u;
    for (i = 0; i < 8; i++) (i % 4 < 3 ? &plane[i / 4].normal[i % 4] : &plane[i / 4].offset)[0] = (double)f[220 + i];
    body.points = (const double (*)[3])point;
    body.point_count = 6;
    body.indices = index;
    body.triangle_count = 4;
    body.outside = o[1] >> 1 & 1;
    d.env = env_of(1);
    d.planes = plane;
    d.plane_count = o[1] >> 2 & 1 ? 2 : 0;
    d.bodies = &body;
    d.body_count = o[1] >> 3 & 1;
    if (tetcast_clip_create(&d, &c) == TETCAST_OK) {
        tetcast_ray ray;
        double span[4][2];
        uint32_t n;
        memset(&ray, 0, sizeof ray);
        for (i = 0; i < 3; i++) {
            ray.org[i] = (double)f[230 + i];
            ray.dir[i] = (double)f[233 + i];
        }
        n = tetcast_clip_spans(c, &ray, span, 4);
        for (i = 0; n != TETCAST_NONE && i < n && i < 4; i++) must(span[i][0] <= span[i][1] && (i == 0 || span[i - 1][1] <= span[i][0]));
    }
    return c;
}

/* Bricks: what they show, their file, a picture of them. */
static void look_at_bricks(const tetcast_bricks *b, const uint8_t *o, const float *f) {
    static float rgba[2][PIXELS * 4];
    tetcast_cut_desc cd;
    tetcast_cut *cut = NULL;
    tetcast_clip *clip;
    tetcast_optics *optics = colours();
    tetcast_bricks *again = NULL;
    const size_t bytes = tetcast_bricks_file_size(b);
    uint8_t *file = (uint8_t *)malloc(bytes);
    tetcast_env env = env_of(1);
    uint32_t k, i;
    if (file != NULL) {
        must(tetcast_bricks_write(b, file, bytes) == TETCAST_OK && tetcast_bricks_read(&env, file, bytes, &again) == TETCAST_OK);
        free(file);
    }
    memset(&cd, 0, sizeof cd);
    cd.env = env;
    cd.max_jump = o[6] & 1;
    cd.max_error = o[6] & 2 ? f[240] : 0;
    cd.focus_radius = o[6] & 4 ? (double)f[241] : 0;
    cd.byte_budget = o[6] & 8 ? 1u << 13 : 0;
    cd.optics = o[6] & 16 ? optics : NULL;
    clip = clip_of(o, f);
    if (again != NULL && tetcast_cut_create(&cd, again, &cut) == TETCAST_OK) {
        tetcast_result r[2];
        memset(rgba, 0, sizeof rgba);
        for (k = 0; k < 2; k++) {
            tetcast_brick_render_desc d;
            tetcast_image m;
            memset(&d, 0, sizeof d); memset(&m, 0, sizeof m);
            d.env = env_of(1 + (k & (o[6] >> 5 & 1u)));
            d.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
            camera_of(o, f, &d.camera);
            d.step = !(o[7] & 1) || (f[242] > 1e-7f && f[242] < 0.0625f) ? 2 : f[242]; /* small ones are refused or take long */
            d.fixed_step = o[7] >> 1 & 1;
            d.clip = clip;
            d.clip_near = o[7] & 4 ? f[243] : 0;
            m.width = WIDE;
            m.height = HIGH;
            m.rgba = rgba[k];
            r[k] = tetcast_render_bricks(&d, cut, optics, &m, NULL);
        }
        must(r[0] == r[1] && memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
        for (i = 0; i < PIXELS * 4; i++) must(is_finite(rgba[0][i]));
    }
    tetcast_clip_destroy(clip);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(again);
    tetcast_optics_destroy(optics);
}

static void bricks_desc(const uint8_t *o, const float *f, tetcast_bricks_desc *d) {
    static const tetcast_type storage[5] = {TETCAST_TYPE_F32, TETCAST_TYPE_U8, TETCAST_TYPE_U16, TETCAST_TYPE_F16, TETCAST_TYPE_I8};
    memset(d, 0, sizeof *d);
    d->env = env_of(1 + (o[8] & 1));
    d->log_cells = o[8] & 2 ? 3 : 0;
    d->levels = o[8] >> 2 & 3;
    d->storage = storage[o[8] >> 4 & 7 ? (o[8] >> 4 & 7) % 5 : 0];
    d->nearest = o[8] >> 7;
    d->max_error = o[9] & 1 ? f[244] : 0;
    d->longest = o[9] & 2 ? 2u + (o[9] >> 4) : 0;
    d->longest_end = 17;
    d->checks = 10;
}

static void lattice(const uint8_t *o, const float *f) {
    static const tetcast_type type[4] = {TETCAST_TYPE_F32, TETCAST_TYPE_I8, TETCAST_TYPE_U16, TETCAST_TYPE_F16};
    tetcast_bricks_desc d;
    tetcast_lattice l;
    tetcast_array values;
    tetcast_bricks *b = NULL;
    uint32_t k;
    memset(&l, 0, sizeof l); memset(&values, 0, sizeof values);
    bricks_desc(o, f, &d);
    for (k = 0; k < 3; k++) {
        l.dims[k] = 1u + (o[10] >> (2 * k) & 3u) + (k == 0 ? o[11] & 3u : 0u);
        l.origin[k] = o[12] & 1 ? (double)f[100 + k] : 0;
        l.spacing[k] = o[12] & 2 ? (double)f[103 + k] : 1;
    }
    values.data = f;
    values.type = type[o[12] >> 2 & 3];
    if (tetcast_bricks_create_grid(&d, &l, &values, NULL, &b) == TETCAST_OK) look_at_bricks(b, o, f);
    tetcast_bricks_destroy(b);
}

static void refined(const uint8_t *o, const float *f) {
    tetcast_patch patch[3];
    tetcast_amr_desc d;
    tetcast_bricks_desc bd;
    tetcast_amr *a = NULL;
    tetcast_bricks *b = NULL;
    uint32_t i, k, fine = 0;
    memset(patch, 0, sizeof patch); memset(&d, 0, sizeof d);
    d.env = env_of(1 + (o[8] & 1));
    for (k = 0; k < 3; k++) {
        d.cells[k] = 1u + (o[10] >> (2 * k) & 3u);
        d.origin[k] = o[12] & 1 ? (double)f[100 + k] : 0;
        d.spacing[k] = o[12] & 2 ? (double)f[103 + k] : 0;
        patch[0].dims[k] = d.cells[k];
    }
    for (i = 1; i < 3; i++) {
        patch[i].level = o[12 + i] & 3;
        for (k = 0; k < 3; k++) {
            patch[i].lo[k] = (int32_t)(o[14 + i] >> (2 * k) & 3u) - (o[12 + i] >> 7);
            patch[i].dims[k] = 1u + (o[16 + i] >> (2 * k) & 3u);
        }
    }
    for (i = 0; i < 3; i++) patch[i].values = f + 64 * i;
    d.ratio_log = o[12] >> 4 & 3;
    d.patches = patch;
    d.patch_count = 1u + (o[12] >> 2 & 3u) % 3u;
    if (tetcast_amr_create(&d, &a) != TETCAST_OK) return;
    for (i = 0; i < 6; i++) {
        double at[POINTS][3];
        float v[POINTS];
        for (k = 0; k < 3 * POINTS; k++) at[k / 3][k % 3] = (double)f[(150 + k + i) % NUMBERS];
        if (tetcast_amr_sample(a, (tetcast_amr_method)i, (const double (*)[3])at, POINTS, v) == TETCAST_OK)
            for (k = 0; k < POINTS; k++) must(tetcast_amr_level(a, at[k]) < TETCAST_AMR_LEVELS);
    }
    for (i = 1; i < d.patch_count; i++) fine = patch[i].level > fine ? patch[i].level : fine;
    fine *= d.ratio_log != 0 ? d.ratio_log : 1;
    if ((d.cells[0] * d.cells[1] * d.cells[2]) << (3 * (fine < 6 ? fine : 6)) > 100000) { /* seconds for each input, with sanitizers */
        tetcast_amr_destroy(a);
        return;
    }
    bricks_desc(o, f, &bd);
    if (tetcast_bricks_create_amr(&bd, a, (tetcast_amr_method)(o[13] >> 4 & 7), NULL, &b) == TETCAST_OK) look_at_bricks(b, o, f);
    tetcast_bricks_destroy(b);
    tetcast_amr_destroy(a);
}

/* A sum of functions: the same by lists and by all of them, bounds that hold, pictures, particles, bricks. */
static void look_at_functions(const tetcast_rbf *m, const uint8_t *o, const float *f) {
    static float rgba[2][PIXELS * 4];
    tetcast_rbf_info info;
    tetcast_rbf_eval_desc e;
    tetcast_rbf_trace_desc td;
    tetcast_bricks_desc bd;
    tetcast_optics *optics = colours();
    tetcast_clip *clip = clip_of(o, f);
    tetcast_bricks *b = NULL;
    tetcast_result r[2];
    double at[POINTS][3], paths[POINTS * 5 * 3];
    float v[2][POINTS * 4], slope[2][POINTS * 12], lo, hi, steep;
    uint32_t i, k;
    memset(v, 0, sizeof v); memset(slope, 0, sizeof slope); memset(&e, 0, sizeof e); memset(&td, 0, sizeof td);
    tetcast_rbf_get_info(m, &info);
    for (i = 0; i < POINTS; i++)
        for (k = 0; k < 3; k++) {
            const double u = (double)f[160 + 3 * i + k];
            at[i][k] = o[18] & 1 ? u : info.box_min[k] + (info.box_max[k] - info.box_min[k]) * ((i * (k + 3)) % 8) / 7.0;
        }
    for (k = 0; k < 2; k++) {
        e.env = env_of(1);
        e.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        e.all = k;
        must(tetcast_rbf_eval(&e, m, at[0], POINTS, v[k], slope[k]) == TETCAST_OK);
    }
    must(memcmp(v[0], v[1], sizeof v[0]) == 0 && memcmp(slope[0], slope[1], sizeof slope[0]) == 0);
    for (k = 0; k < 2; k++) { /* on a grid, too */
        static float grid[2][4 * 60];
        const uint32_t dims[3] = {1u + (o[20] & 3u), 1u + (o[20] >> 2 & 3u), 1u + (o[20] >> 4) % 3u};
        e.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        e.all = !k;
        must(tetcast_rbf_grid(&e, m, dims, grid[k]) == TETCAST_OK);
        if (k) must(memcmp(grid[0], grid[1], sizeof(float) * dims[0] * dims[1] * dims[2] * info.components) == 0);
    }
    for (i = 0; info.components >= 3 && i < POINTS; i++) {
        const float *u = v[0] + i * info.components, *du = slope[0] + 3 * i * info.components;
        tetcast_flow flow;
        int all = 1;
        for (k = 0; k < 9; k++) all &= is_finite(du[k]) & is_finite(u[k / 3]);
        tetcast_flow_features(u, du, &flow);
        must(!all || (is_finite(flow.speed) && is_finite(flow.lambda2) && is_finite(flow.helicity)));
        for (k = 0; k < 3; k++) must(!all || is_finite(flow.vorticity[k]));
    }
    for (i = 0; i < info.components; i++)
        if (tetcast_rbf_bounds(m, i, info.box_min, info.box_max, &lo, &hi, &steep) == TETCAST_OK && (o[18] & 1) == 0)
            for (k = 0; k < POINTS; k++) must(!(v[0][k * info.components + i] < lo) && !(v[0][k * info.components + i] > hi));
    memset(rgba, 0, sizeof rgba);
    for (k = 0; k < 2; k++) {
        tetcast_rbf_render_desc d;
        tetcast_image image;
        memset(&d, 0, sizeof d); memset(&image, 0, sizeof image);
        d.env = env_of(1 + (k & (o[6] >> 5 & 1u)));
        d.isa = e.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        camera_of(o, f, &d.camera);
        d.channel = (tetcast_rbf_channel)(o[18] >> 1 & 7);
        d.step = o[18] & 16 ? f[245] : (float)((info.box_max[0] - info.box_min[0]) / 16);
        d.epsilon = o[18] & 32 ? f[246] : 0;
        d.gather = o[18] >> 6 & 1;
        d.clip = clip;
        image.width = WIDE;
        image.height = HIGH;
        image.rgba = rgba[k];
        r[k] = tetcast_rbf_render(&d, m, optics, &image, NULL);
    }
    must(r[0] == r[1] && (r[0] != TETCAST_OK || memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0));
    for (i = 0; r[0] == TETCAST_OK && i < PIXELS * 4; i++) must(is_finite(rgba[0][i]));
    td.env = env_of(1);
    td.stepper = (tetcast_stepper)(o[19] & 3);
    td.dt = o[19] & 4 ? (double)f[247] : 0.125;
    td.steps = 4;
    td.min_speed = o[19] & 8 ? f[248] : 0;
    td.tolerance = o[19] & 16 ? (double)f[249] : 0;
    (void)tetcast_rbf_trace(&td, m, at[0], POINTS, paths, NULL, NULL);
    bricks_desc(o, f, &bd);
    if ((o[19] & 32) && tetcast_bricks_create_rbf(&bd, m, (tetcast_rbf_channel)(o[18] >> 1 & 7), 0, NULL, &b) == TETCAST_OK) look_at_bricks(b, o, f);
    tetcast_bricks_destroy(b);
    tetcast_clip_destroy(clip);
    tetcast_optics_destroy(optics);
}

static void functions(const uint8_t *o, const float *f) {
    tetcast_rbf_function list[FUNCTIONS];
    tetcast_rbf_desc d;
    tetcast_rbf *m = NULL;
    uint32_t i, k;
    memset(list, 0, sizeof list); memset(&d, 0, sizeof d);
    for (i = 0; i < FUNCTIONS; i++) {
        for (k = 0; k < 3; k++) {
            list[i].centre[k] = (double)f[12 * i + k];
            list[i].axis[k] = (double)f[12 * i + 3 + k];
        }
        for (k = 0; k < 4; k++) list[i].weight[k] = f[12 * i + 6 + k];
        list[i].width = o[13] & 1 ? (double)f[12 * i + 10] : 0.25 * (i + 1);
        list[i].stretch = o[13] & 2 ? (double)f[12 * i + 11] : 0;
    }
    d.env = env_of(1);
    for (k = 0; k < 3; k++) {
        d.box_min[k] = o[13] & 4 ? (double)f[100 + k] : -2;
        d.box_max[k] = o[13] & 8 ? (double)f[103 + k] : 3;
        d.metric[k] = o[13] & 16 ? (double)f[106 + k] : 0;
        d.base_dims[k] = o[13] & 32 ? o[14] >> (2 * k) & 3u : 0;
    }
    d.components = o[15] % 6u;
    d.kernel = (tetcast_kernel)(o[15] >> 4 & 7);
    d.cut = o[13] & 64 ? f[109] : 0;
    d.epsilon = o[13] & 128 ? f[110] : 0;
    d.functions = list;
    d.function_count = o[16] % (FUNCTIONS + 1u);
    d.base = f;
    if (tetcast_rbf_create(&d, &m) == TETCAST_OK) look_at_functions(m, o, f);
    tetcast_rbf_destroy(m);
}

static void fits(const uint8_t *o, const float *f) {
    tetcast_rbf_fit_desc d;
    tetcast_rbf_points p;
    tetcast_rbf_report report[2];
    tetcast_rbf *m[2] = {NULL, NULL};
    tetcast_result r[2];
    uint32_t k;
    memset(&d, 0, sizeof d); memset(&p, 0, sizeof p); memset(report, 0, sizeof report);
    p.values.data = f;
    p.components = 1u + (o[15] & 1);
    if (o[13] & 1) {
        p.positions.data = f + 60;
        p.count = 20;
    } else {
        p.count = 1;
        for (k = 0; k < 3; k++) {
            p.dims[k] = 1u + (o[14] >> (2 * k) & 3u);
            p.count *= p.dims[k];
            p.origin[k] = o[13] & 2 ? (double)f[100 + k] : 0;
            p.spacing[k] = o[13] & 4 ? (double)f[103 + k] : 0;
        }
    }
    d.method = (tetcast_rbf_method)(o[13] >> 3 & 1);
    d.max_error = o[13] & 16 ? f[106] : 0.2f;
    d.kernel = (tetcast_kernel)(o[15] >> 4 & 7);
    d.cut = o[13] & 32 ? f[107] : 0;
    d.between = o[13] >> 6 & 1;
    d.round = o[13] >> 7;
    d.max_functions = 12;
    d.compare = o[16] & 1;
    for (k = 0; k < 2; k++) {
        d.env = env_of(1 + (k & o[16] >> 1));
        d.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        r[k] = tetcast_rbf_fit(&d, &p, &report[k], &m[k]);
        must((r[k] == TETCAST_OK) == (m[k] != NULL));
    }
    must(r[0] == r[1]);
    if (m[0] != NULL) {
        size_t bytes[2] = {0, 0};
        uint8_t *file[2] = {NULL, NULL};
        tetcast_rbf *again = NULL;
        must(!(report[0].max_error > (double)d.max_error * 1.0001) || d.max_error == 0.0f);
        for (k = 0; k < 2; k++) {
            must(tetcast_rbf_save_memory(m[k], NULL, 0, &bytes[k]) == TETCAST_OK);
            file[k] = (uint8_t *)malloc(bytes[k]);
            if (file[k] != NULL) must(tetcast_rbf_save_memory(m[k], file[k], bytes[k], &bytes[k]) == TETCAST_OK);
        }
        if (file[0] != NULL && file[1] != NULL) must(bytes[0] == bytes[1] && memcmp(file[0], file[1], bytes[0]) == 0);
        if (file[0] != NULL) must(tetcast_rbf_load_memory(NULL, file[0], bytes[0], &again) == TETCAST_OK);
        tetcast_rbf_destroy(again);
        free(file[0]);
        free(file[1]);
        look_at_functions(m[1], o, f);
    }
    tetcast_rbf_destroy(m[0]);
    tetcast_rbf_destroy(m[1]);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    float f[NUMBERS];
    size_t i;
    if (size < OPTIONS + 3) return 0;
    for (i = 0; i < NUMBERS; i++) { /* those that are missing repeat the others */
        const uint8_t *q = data + OPTIONS + 1 + 2 * (i % ((size - OPTIONS - 1) / 2));
        uint32_t u = (uint32_t)q[0] << 8 | q[1], w = u << 16;
        memcpy(&f[i], &w, sizeof w);
        if (u & 1) f[i] = ((float)(u >> 1) - 16384.0f) / 64.0f;
    }
    switch (data[0] & 3) {
    case 0: lattice(data + 1, f); break;
    case 1: refined(data + 1, f); break;
    case 2: functions(data + 1, f); break;
    default: fits(data + 1, f); break;
    }
    return 0;
}
