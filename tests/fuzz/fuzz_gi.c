/* fuzz_gi.c - bytes as a scene of lamps and meshes, a G-buffer and options of voxrt_gi_render: light that is finite and
   not below zero, the same for every isa and number of threads, or a refusal; then edits, and light again. Bytes: 24 of
   options; eight for each object; then 16-bit numbers, odd: a multiple of 1/64, even: the upper half of a float. */
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"

enum { WIDE = 11, HIGH = 7, NUMBERS = 160, OBJECTS = 4, LIGHTS = 4, OPTIONS = 24, POINTS = 12 };
typedef struct picture {
    float position[WIDE * HIGH][3], normal[WIDE * HIGH][3], albedo[WIDE * HIGH][3], specular[WIDE * HIGH][4];
    float emission[WIDE * HIGH][3], before[WIDE * HIGH][3], direct[WIDE * HIGH][3], indirect[WIDE * HIGH][3];
} picture;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static float unit(float x) { /* any number as one from 0 to 1 */
    x = x < 0.0f ? 0.0f - x : x;
    return x < 1e6f ? x - (float)(int32_t)x : 0.5f;
}

/* The same picture by scalar code on one thread and by the best on one or two: p[0], p[1]. */
static void draw(voxrt_gi *gi, const uint8_t *o, const float *f, const voxrt_gi_render_desc *desc, voxrt_gi_history *const h[2],
                 picture p[2]) {
    voxrt_gi_surface surface;
    voxrt_result r[2];
    uint32_t k, i, a;
    memset(p, 0, 2 * sizeof *p);
    for (k = 0; k < 2; k++) {
        voxrt_gi_render_desc d = *desc;
        voxrt_gbuffer g;
        voxrt_env env;
        memset(&g, 0, sizeof g);
        memset(&env, 0, sizeof env);
        env.thread_count = k != 0 && (o[20] & 1) != 0 ? 2u : 1u;
        env.memory_limit = 1u << 26;
        d.env = env;
        d.isa = k ? VOXRT_ISA_AUTO : VOXRT_ISA_SCALAR;
        d.history = o[20] & 2 ? h[k] : NULL;
        g.width = WIDE;
        g.height = HIGH;
        g.position = p[k].position[0];
        g.normal = p[k].normal[0];
        g.albedo = p[k].albedo[0];
        if (o[20] & 4) g.specular = p[k].specular[0];
        if (o[20] & 8) g.emission = p[k].emission[0];
        if (o[20] & 16) g.before = p[k].before[0];
        if (o[20] & 32 || voxrt_gbuffer_from_gi(&env, &d.camera, gi, &g) != VOXRT_OK) { /* as the numbers come */
            for (i = 0; i < WIDE * HIGH; i++)
                for (a = 0; a < 3; a++) {
                    p[k].position[i][a] = f[(3 * i + a) % NUMBERS];
                    p[k].normal[i][a] = f[(7 * i + a + 11) % NUMBERS];
                    p[k].albedo[i][a] = unit(f[(5 * i + a) % NUMBERS]);
                    if (o[20] & 4) p[k].specular[i][a] = unit(f[(3 * i + a + 5) % NUMBERS]);
                    if (o[20] & 4) p[k].specular[i][3] = f[(3 * i + 9) % NUMBERS];
                    if (o[20] & 16) p[k].before[i][a] = f[(2 * i + a) % NUMBERS];
                    if (i % 3 != 0) p[k].normal[i][a] = a == i % 3 ? 1.0f : 0.0f;
                }
        } else {
            (void)voxrt_gbuffer_edges(&env, &d.camera, gi, &g);
            (void)voxrt_gbuffer_materials(&env, gi, &g);
        }
        r[k] = voxrt_gi_render(&d, gi, &g, o[20] & 64 ? NULL : p[k].direct[0], o[20] & 128 ? NULL : p[k].indirect[0], NULL);
    }
    if (r[0] != r[1] || (r[0] == VOXRT_OK && memcmp(&p[0], &p[1], sizeof p[0]) != 0)) abort();
    for (i = 0; r[0] == VOXRT_OK && i < WIDE * HIGH; i++)
        for (a = 0; a < 3; a++)
            if (!(p[0].direct[i][a] >= 0.0f && p[0].direct[i][a] < INFINITY && p[0].indirect[i][a] >= 0.0f && p[0].indirect[i][a] < INFINITY))
                abort();
    for (i = 0; i < 8; i++) { /* and what a ray sees */
        voxrt_ray ray;
        voxrt_column_hit hit;
        for (a = 0; a < 3; a++) {
            ray.org[a] = f[(11 * i + a) % NUMBERS];
            ray.dir[a] = f[(13 * i + a + 3) % NUMBERS];
        }
        ray.t_min = 0;
        ray.t_max = INFINITY;
        if (voxrt_columns_trace(voxrt_gi_columns(gi), NULL, &ray, &hit, 1) != VOXRT_OK) abort();
        if (!(hit.t < INFINITY) || !voxrt_gi_get(gi, &hit, ray.dir, &surface)) continue;
        for (a = 0; a < 3; a++) if (!(surface.radiance[a] >= 0.0f && surface.radiance[a] < INFINITY)) abort();
    }
}

/* A G-buffer of a few voxels, what it shows on a display, how long frames take. */
static void display(const uint8_t *o, const float *f, const voxrt_camera *camera, const picture *light) {
    static picture p[2];
    voxrt_voxel v[4];
    voxrt_build_desc bd;
    voxrt_tree *t = NULL;
    voxrt_geometry geometry;
    voxrt_gi_budget budget;
    float shown[WIDE * HIGH][3];
    uint32_t i, k, a;
    memset(v, 0, sizeof v);
    memset(&bd, 0, sizeof bd);
    memset(p, 0, sizeof p);
    memset(&budget, 0, sizeof budget);
    bd.env.thread_count = 1;
    for (i = 0; i < 4; i++) {
        v[i].x = o[21] >> (2 * i) & 3;
        v[i].y = o[22] >> (2 * i) & 3;
        v[i].z = o[23] >> (2 * i) & 3;
        v[i].rgb[i % 3] = o[21];
    }
    if (voxrt_tree_from_voxels(&bd, v, 4, 2, &t) != VOXRT_OK) abort();
    voxrt_tree_geometry(t, &geometry);
    for (k = 0; k < 2; k++) {
        voxrt_env env;
        voxrt_gbuffer g;
        memset(&env, 0, sizeof env);
        memset(&g, 0, sizeof g);
        env.thread_count = 1 + k;
        g.width = WIDE;
        g.height = HIGH;
        g.position = p[k].position[0];
        g.normal = p[k].normal[0];
        g.albedo = p[k].albedo[0];
        g.before = p[k].before[0];
        if (o[20] & 4) g.specular = p[k].specular[0];
        if (voxrt_gbuffer_from_geometry(&env, camera, &geometry, &g) != VOXRT_OK) break;
    }
    if (k == 2 && memcmp(&p[0], &p[1], sizeof p[0]) != 0) abort();
    for (i = 0; k == 2 && i < WIDE * HIGH; i++)
        for (a = 0; a < 3; a++) if (!(p[0].albedo[i][a] >= 0.0f && p[0].albedo[i][a] <= 1.0f && p[0].position[i][a] - p[0].position[i][a] == 0.0f)) abort();
    voxrt_tree_destroy(t);
    for (k = 0; k < 4; k++) {
        const float *rgb = o[22] & 1 ? f : light->indirect[0];
        if (voxrt_tone_map((voxrt_tone)k, o[22] & 2 ? f[22] : 1.0f, rgb, shown[0], o[22] & 1 ? 40 : WIDE * HIGH) != VOXRT_OK) continue;
        for (i = 0; i < (o[22] & 1 ? 40 : WIDE * HIGH); i++)
            for (a = 0; a < 3; a++) if (!(shown[i][a] >= 0.0f && shown[i][a] <= 1.0f)) abort();
    }
    budget.most = o[23] & 63;
    for (k = 0; k < 4; k++) {
        voxrt_gi_report report;
        memset(&report, 0, sizeof report);
        report.rays = o[21];
        report.shaded = o[22] * 100u;
        (void)voxrt_gi_budget_update(&budget, o[23] & 128 ? NULL : &report, f[30 + k], f[34 + k], f[38]);
        if (budget.rays == 0 || budget.rays > (budget.most != 0 ? budget.most : 64u) || budget.coarse == 0 || budget.coarse > 16) abort();
    }
}

static void set_lights(voxrt_gi *gi, const uint8_t *o, const float *f) {
    voxrt_gi_light l[LIGHTS];
    uint32_t i, a;
    memset(l, 0, sizeof l);
    for (i = 0; i < LIGHTS; i++) {
        l[i].kind = (voxrt_gi_light_kind)(o[18] >> (2 * i) & 3);
        l[i].angle = f[19 + 20 * i];
        for (a = 0; a < 3; a++) {
            l[i].position[a] = f[20 * i + a];
            l[i].direction[a] = f[20 * i + a + 3];
            l[i].edge_u[a] = f[20 * i + a + 6];
            l[i].edge_v[a] = f[20 * i + a + 9];
            l[i].color[a] = f[20 * i + a + 12] < 0 ? 0.0f - f[20 * i + a + 12] : f[20 * i + a + 12];
        }
        if (o[19] >> i & 1) l[i].angle = 1.0f + 88.0f * unit(l[i].angle);
    }
    (void)voxrt_gi_set_lights(gi, l, (o[19] >> 4) % (LIGHTS + 1));
}

/* An object of twelve points: a box, or whatever they are. */
static voxrt_gi_object object(const uint8_t *q, const float *f, float (*position)[3]) {
    static const uint32_t corner[12][3] = {{0, 1, 3}, {0, 3, 2}, {4, 6, 7}, {4, 7, 5}, {0, 4, 5}, {0, 5, 1},
                                           {2, 3, 7}, {2, 7, 6}, {0, 2, 6}, {0, 6, 4}, {1, 5, 7}, {1, 7, 3}};
    static const uint8_t rgb[36] = {255, 0, 0, 0, 255, 0, 0, 0, 255, 90, 90, 90, 255, 255, 0, 0, 255, 255, 255, 255};
    voxrt_gi_object o;
    uint32_t i, a;
    memset(&o, 0, sizeof o);
    for (i = 0; i < POINTS; i++)
        for (a = 0; a < 3; a++)
            position[i][a] = q[0] & 1 ? f[(q[1] + (i >> a & 1) * 3u + a) % NUMBERS] : f[(q[1] + 3 * i + a) % NUMBERS] * (q[0] & 2 ? 1.0f / 64 : 1.0f);
    o.mesh.positions = position[0];
    o.mesh.vertex_count = POINTS - (q[0] >> 7) * 6u;
    o.mesh.triangle_count = q[0] & 4 ? 12 : 4;
    if (q[0] & 4) o.mesh.indices = corner[0];
    if (q[0] & 8) o.mesh.vertex_rgb = rgb;
    if (q[0] & 16) o.mesh.triangle_rgb = rgb;
    o.still = q[0] >> 5 & 1;
    o.mode = (voxrt_columns_mode)(q[2] % 7);
    o.spacing = q[2] & 128 ? f[q[3] % NUMBERS] : 0.0f;
    for (a = 0; a < 3; a++) {
        o.material.albedo[a] = unit(f[(q[3] + a) % NUMBERS]);
        if (q[4] & 1) o.material.specular[a] = unit(f[(q[5] + a) % NUMBERS]);
        if (q[4] & 2) o.material.emission[a] = f[(q[6] + a) % NUMBERS] < 0 ? 0 : f[(q[6] + a) % NUMBERS];
    }
    if (q[4] & 1) o.material.exponent = f[(q[6] + 4) % NUMBERS];
    if (q[4] & 4) {
        for (i = 0; i < 12; i++) o.to_world[i] = (double)f[(q[7] + i) % NUMBERS];
        for (i = 0; i < 3 && (q[4] & 8); i++) for (a = 0; a < 3; a++) o.to_world[4 * i + a] = a == (i + q[4]) % 3 ? 1.0 : 0.0;
    }
    return o;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static picture p[2]; /* 12 KB */
    float f[NUMBERS + 32], position[OBJECTS][POINTS][3];
    const uint8_t *o = data + 1, *at;
    voxrt_gi_desc gd;
    voxrt_gi_render_desc d;
    voxrt_gi *gi = NULL;
    voxrt_gi_history *h[2] = {NULL, NULL};
    uint32_t id[OBJECTS], i, a;
    const size_t n = size > OPTIONS + 1 ? 1 + data[0] % OBJECTS : 0;
    size_t have, j;
    if (n == 0 || size < OPTIONS + 1 + 8 * n) return 0;
    at = data + OPTIONS + 1 + 8 * n;
    have = (size - (size_t)(at - data)) / 2;
    memset(f, 0, sizeof f);
    for (j = 0; j < NUMBERS + 32; j++) { /* those that are missing repeat the others */
        const size_t k = have != 0 ? j % have : 0;
        const uint32_t u = have != 0 ? (uint32_t)at[2 * k] << 8 | at[2 * k + 1] : 513, w = u << 16;
        memcpy(&f[j], &w, sizeof w);
        if (u & 1) f[j] = ((float)(u >> 1) - 16384.0f) / 64.0f;
    }
    memset(&gd, 0, sizeof gd);
    memset(&d, 0, sizeof d);
    gd.env.thread_count = 1;
    gd.env.memory_limit = 1u << 26;
    gd.columns.size_x = 4u << (o[0] & 3);
    gd.columns.size_y = 4u << (o[0] >> 2 & 3);
    gd.columns.size_z = 64u << (o[0] >> 4 & 1);
    gd.columns.depth_axis_plus_1 = o[0] >> 5 & 3;
    gd.nested = o[1] & 3;
    for (a = 0; a < 3; a++) {
        gd.columns.box_min[a] = o[1] & 4 ? (double)f[a] : -64.0;
        gd.columns.box_max[a] = o[1] & 4 ? (double)f[a + 3] : 64.0;
        d.camera.eye[a] = o[1] & 8 ? f[6 + a] : 10.0f;
        d.camera.at[a] = o[1] & 16 ? f[9 + a] : 0;
        d.camera.up[a] = o[1] & 32 ? f[12 + a] : 0;
    }
    if (o[1] & 64) d.camera.fov_y = f[15];
    d.method = (voxrt_gi_method)(o[2] % 5);
    d.lookup = (voxrt_gi_lookup)(o[2] >> 4 & 3);
    d.rays = 1 + o[3] % 6;
    d.bounces = o[3] >> 6;
    d.pattern = 1 + (o[4] & 3);
    d.map_size = 1 + (o[4] >> 2 & 15);
    d.coarse = 1u << (o[4] >> 6);
    d.first_ray = o[5];
    d.filter = o[6] & 7;
    d.direct_filter = o[6] >> 4 & 7;
    if (o[7] & 1) d.radius = f[16];
    if (o[7] & 2) d.detail = f[17];
    if (o[7] & 4) d.d_min = f[18];
    if (o[7] & 8) d.tolerance = f[19];
    if (o[7] & 16) d.keep = f[20];
    if (o[7] & 32) d.relief = unit(f[21]);
    if (voxrt_gi_create(&gd, &gi) != VOXRT_OK) return 0;
    for (i = 0; i < 2; i++) if (voxrt_gi_history_create(NULL, &h[i]) != VOXRT_OK) abort();
    memset(id, 255, sizeof id);
    for (i = 0; i < n; i++) {
        const voxrt_gi_object one = object(data + OPTIONS + 1 + 8 * i, f, position[i]);
        if (voxrt_gi_add(gi, &one, &id[i]) != VOXRT_OK) id[i] = 0xffffffffu;
    }
    set_lights(gi, o, f);
    if (voxrt_gi_update(gi, NULL) == VOXRT_OK) draw(gi, o, f, &d, h, p);
    for (i = 0; i < 3; i++) { /* edits, and light again */
        const uint8_t e = o[8 + 3 * i];
        double centre[3];
        for (a = 0; a < 3; a++) centre[a] = (double)f[(o[9 + 3 * i] + a) % NUMBERS];
        if (e & 1) (void)voxrt_gi_follow(gi, centre, NULL);
        if (e & 2) {
            const uint32_t k = o[9 + 3 * i] % (uint32_t)n;
            voxrt_gi_object one = object(data + OPTIONS + 1 + 8 * k, f + o[10 + 3 * i] % 8, position[k]);
            (void)voxrt_gi_set(gi, id[k], &one);
        }
        if (e & 4) (void)voxrt_gi_remove(gi, id[o[10 + 3 * i] % n]);
        if (e & 8) set_lights(gi, o, f + o[10 + 3 * i] % 32);
        if (e & 16) d.camera.eye[0] += 0.5f;
        if (e == 0 || voxrt_gi_update(gi, NULL) != VOXRT_OK) continue;
        if (e & 32) (void)voxrt_gi_bounce(gi, NULL, 1 + (e >> 6), e & 128 ? 0.25f : 0.0f, e);
        draw(gi, o, f, &d, h, p);
    }
    {
        float lights[9 * 16];
        (void)voxrt_gi_virtual_lights(gi, lights, 16);
        display(o, f, &d.camera, &p[0]);
    }
    for (i = 0; i < 2; i++) voxrt_gi_history_destroy(h[i]);
    voxrt_gi_destroy(gi);
    return 0;
}
