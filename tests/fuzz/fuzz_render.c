/* fuzz_render.c - bytes as voxels, camera, lights, material, an instance, finishes and options: a picture of finite numbers,
   the same for every isa and number of threads, or a refusal. Bytes: voxels, 8 of options; 5 a voxel; then 16-bit numbers,
   odd: a multiple of 1/64, even: the upper half of a float. */
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"

enum { WIDE = 12, HIGH = 9, NUMBERS = 60 };
typedef struct picture {
    float rgba[HIGH * WIDE][4], depth[HIGH * WIDE], normal[HIGH * WIDE][3];
    uint8_t rgba8[HIGH * WIDE][4];
    voxrt_hit hit[HIGH * WIDE];
} picture;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Three finishes of all kinds, by a number: mostly shares that are seldom 0, ends of the ranges now and then. */
static void make_finishes(uint32_t seed, voxrt_finish finish[3]) {
    static const float share[8] = {0, 1, 0.5f, 1, 0.25f, 0.9f, 0, 1e-9f}, index[8] = {0, 1, 1.5f, 0.0625f, 16, 1.0001f, 0.7f, 1.33f};
    static const float amount[8] = {0, 1, 20, 0, 1e12f, 1e-30f, 0.1f, 0};
    uint32_t i, k;
    for (i = 0; i < 3; i++) {
        float v[VOXRTI_FINISH_FLOATS];
        for (k = 0; k < VOXRTI_FINISH_FLOATS; k++) {
            seed = seed * 1664525u + 1013904223u;
            v[k] = k == 11 ? index[seed >> 29] : k == 0 || (k >= 5 && k < 11) ? share[seed >> 29] : amount[seed >> 29];
        }
        memcpy(&finish[i], v, sizeof v);
    }
}

/* Cameras that frame a box or a tree, and rays of them; colours once more. */
static void cameras(const voxrt_tree *t, const float *f, const voxrt_camera *camera) {
    voxrt_ray ray;
    voxrt_budget budget;
    double lo[3], hi[3];
    uint32_t k;
    for (k = 0; k < 5; k++) {
        voxrt_camera c = *camera;
        voxrt_result r;
        const float *view = k & 1 ? f + 53 : NULL;
        if (k == 1 || k == 2) r = voxrt_camera_fit_tree(&c, t, view, WIDE, k == 1 ? HIGH : 0);
        else {
            uint32_t a;
            voxrt_tree_bounds(t, lo, hi);
            for (a = 0; a < 3 && k == 4; a++) {
                lo[a] = (double)f[54 + a];
                hi[a] = lo[a] + (double)f[57 + a];
            }
            r = k == 0 ? VOXRT_OK : voxrt_camera_fit(&c, lo, hi, view, WIDE, HIGH);
        }
        if (r != VOXRT_OK && memcmp(&c, camera, sizeof c) != 0) abort();
        r = voxrt_camera_ray(&c, WIDE, HIGH, (double)f[58], (double)f[59], &ray);
        if (r != VOXRT_OK || !(voxrti_absf(f[58]) < 1e30f && voxrti_absf(f[59]) < 1e30f)) continue; /* farther out, floats do not reach */
        if (!(ray.dir[0] - ray.dir[0] + (ray.dir[1] - ray.dir[1]) + (ray.dir[2] - ray.dir[2]) == 0.0f)) abort();
    }
    memset(&budget, 0, sizeof budget);
    for (k = 0; k < 5; k++) {
        const float tolerance = voxrt_budget_update(&budget, f[50 + k], f[55], f[56]);
        if (!(tolerance > 0.0f && tolerance <= 64.0f)) abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    voxrt_voxel v[64];
    float f[NUMBERS];
    picture p[2];
    voxrt_image m;
    voxrt_build_desc b;
    voxrt_render_desc d;
    voxrt_blur_desc blur;
    voxrt_light light[2];
    voxrt_material material;
    voxrt_instance instance;
    voxrt_geometry g[2];
    voxrt_finish finish[3];
    uint8_t of[64];
    voxrt_tree *t = NULL;
    voxrt_result r[2];
    const uint8_t *o = data + 1, *at;
    size_t i, k, n = size > 9 ? data[0] % 64u : 0;
    if (n == 0 || size < 9 + 5 * n) return 0;
    memset(v, 0, sizeof v); memset(&b, 0, sizeof b); memset(&d, 0, sizeof d); memset(&blur, 0, sizeof blur);
    memset(light, 0, sizeof light); memset(&instance, 0, sizeof instance); memset(p, 0, sizeof p); memset(f, 0, sizeof f);
    for (i = 0; i < n; i++) {
        const uint8_t *q = data + 9 + 5 * i;
        v[i].x = q[0] % 16; v[i].y = q[0] / 16; v[i].z = q[1] % 16;
        memcpy(v[i].rgb, q + 2, 3);
        v[i].has_normal = q[1] >> 7;
        for (k = 0; k < 3; k++) v[i].normal[k] = (float)(q[1] >> 4 & 7) - (float)(q[2 + k] % 8);
    }
    at = data + 9 + 5 * n;
    for (i = 0; i < NUMBERS && (size_t)(at + 2 * i + 2 - data) <= size; i++) {
        uint32_t u = (uint32_t)at[2 * i] << 8 | at[2 * i + 1], w = u << 16;
        memcpy(&f[i], &w, sizeof w);
        if (u & 1) f[i] = ((float)(u >> 1) - 16384.0f) / 64.0f;
    }
    b.env.thread_count = 1;
    b.disable_normals = o[0] & 1; b.box_size = o[0] & 2 ? (double)f[0] : 0;
    for (k = 0; k < 3; k++) b.box_min[k] = (double)f[1 + k];
    if (o[6] != 0) {
        make_finishes(o[6], finish);
        for (i = 0; i < n; i++) of[i] = data[9 + 5 * i + 4] % 4;
        b.finishes = finish; b.finish_count = 3; b.voxel_finish = of;
        d.bounces_plus_1 = o[7] % 34;
    }
    if (voxrt_tree_from_voxels(&b, v, n, 4, &t) != VOXRT_OK) return 0;
    memcpy(&d.camera, f + 4, sizeof d.camera);
    memcpy(&material, f + 14, sizeof material);
    for (i = 0; i < 2; i++) {
        memcpy(light[i].position, f + 20 + 6 * i, 12); memcpy(light[i].color, f + 23 + 6 * i, 12);
        light[i].directional = o[1] >> i & 1; light[i].no_shadow = o[1] >> (2 + i) & 1;
    }
    d.light_count = o[1] >> 4 & 3; if (d.light_count > 2) d.light_count = 0;
    d.lights = d.light_count ? light : NULL;
    d.material = o[1] & 64 ? &material : NULL;
    memcpy(d.background, f + 32, 16);
    d.tolerance = o[1] & 128 ? f[36] : 0;
    d.view = (voxrt_view)(o[2] % 8); d.samples = o[2] >> 3 & 3; d.shadows = o[2] >> 5 & 1; d.face_normals = o[2] >> 6 & 1;
    d.one_sided = o[2] >> 7; d.thesis_compose = o[3] & 1; d.thesis_shadows = o[3] >> 1 & 1; d.object_lod = o[3] >> 2 & 1;
    d.pixel_step = o[3] >> 3 & 3; d.lod_split = o[3] >> 5; d.max_level_plus_1 = o[4] & 7; d.heat_max = f[37];
    d.stage = (voxrt_stage)(o[4] >> 3 & 3); d.no_compose = o[4] >> 5 & 1; d.first_sample = o[4] >> 6;
    voxrt_tree_geometry(t, &instance.geometry);
    for (k = 0; k < 12; k++) instance.to_world[k] = (double)f[38 + k] * (o[5] & 2 && k % 4 != 3 ? 1.0 / 64 : 1.0);
    if (o[5] & 1 && voxrt_instance_geometry(&instance, &g[0]) == VOXRT_OK) { d.geometry = g; d.geometry_count = 1; }
    for (k = 0; k < 2; k++) {
        memset(&m, 0, sizeof m);
        m.width = WIDE; m.height = HIGH;
        m.rgba = p[k].rgba[0]; m.rgba8 = p[k].rgba8[0]; m.depth = p[k].depth; m.normal = p[k].normal[0]; m.hit = p[k].hit;
        d.isa = k ? VOXRT_ISA_AUTO : VOXRT_ISA_SCALAR;
        d.env.thread_count = (uint32_t)(k && o[5] & 4 ? 2 : 1);
        r[k] = voxrt_render(&d, d.geometry_count && o[5] & 8 ? NULL : t, &m, NULL);
        blur.env.thread_count = 1;
        blur.radius = f[50]; blur.footprint = o[5] & 32 ? f[51] : 0; blur.voxel_size = f[52]; blur.depth = o[5] >> 6;
        if (r[k] == VOXRT_OK && o[5] & 16) (void)voxrt_blur(&blur, &m);
        else if (r[k] == VOXRT_OK && !d.no_compose && !d.thesis_compose) { /* nothing has changed */
            uint8_t again[HIGH * WIDE][4];
            m.rgba8 = again[0];
            if (voxrt_image_encode(&d.env, &m) != VOXRT_OK || memcmp(again, p[k].rgba8, sizeof again) != 0) abort();
        }
    }
    if (r[0] != r[1] || memcmp(&p[0], &p[1], sizeof p[0]) != 0) abort();
    for (i = 0; r[0] == VOXRT_OK && i < HIGH * WIDE; i++) {
        for (k = 0; k < 4; k++) if (!voxrti_finite_f(p[0].rgba[i][k])) abort();
        for (k = 0; k < 3; k++) if (!(voxrti_absf(p[0].normal[i][k]) <= 1.001f)) abort();
        if (p[0].depth[i] != p[0].depth[i]) abort();
    }
    cameras(t, f, &d.camera);
    voxrt_tree_destroy(t);
    return 0;
}
