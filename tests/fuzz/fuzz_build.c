/* fuzz_build.c - eight bytes of options, then triangles of nine numbers: any float, in the box, on a lattice, an earlier
   one again. The tree must agree with itself and must not depend on threads nor on the order of the triangles. */
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
static const voxrt_finish finishes[2] = {{1, {1, 0, 0}, 9, {0, 0, 0}, {0, 0, 0}, 0, {0, 0, 0}, {0, 0, 0}},
                                         {0, {0, 0, 0}, 0, {1, 1, 1}, {0, 0, 0}, 0, {0, 0, 0}, {0, 0, 0}}};
/* every: of many voxels one in so many is looked up in the tree, too */
typedef struct seen { const voxrt_tree *t; uint32_t level; uint64_t count, last, every; int plain; } seen;
static int cell(void *user, const voxrt_voxel *v, uint32_t index) {
    seen *s = (seen *)user;
    uint64_t key = voxrti_morton(v->x, v->y, v->z);
    const voxrt_finish *f = voxrt_tree_finish(s->t, index);
    voxrt_voxel got;
    if (f != NULL && (s->plain || (memcmp(f, &finishes[0], sizeof *f) != 0 && memcmp(f, &finishes[1], sizeof *f) != 0))) abort();
    if ((s->count++ != 0 && key <= s->last) || index >= s->t->palette_count) abort();
    if (s->count % s->every != 0) return s->last = key, 0;
    if (!voxrt_tree_get(s->t, s->level, v->x, v->y, v->z, &got) || memcmp(got.rgb, v->rgb, 3) != 0) abort();
    if (s->level != 0 && !voxrt_tree_get(s->t, s->level - 1, v->x / 2, v->y / 2, v->z / 2, NULL)) abort();
    return s->last = key, 0;
}

static void sample(void *user, voxrt_sample *s) {
    int k;
    (void)user;
    for (k = 0; k < 3; k++) {
        if (!(s->weight[k] >= 0.0f && s->weight[k] <= 1.0f)) abort();
        s->color[k] = s->weight[k];
    }
    s->normal[0] -= s->weight[1];
}

/* A model of a tree has its voxels, and so has the tree of that, also after an edit that is undone. */
typedef struct modelled { const voxrt_model *m; uint64_t count, every; uint32_t depth; } modelled;
static int in_model(void *user, const voxrt_voxel *v, uint32_t index) {
    modelled *s = (modelled *)user;
    voxrt_voxel got;
    (void)index;
    if (s->count++ % s->every != 0) return 0;
    if (!voxrt_model_get(s->m, s->depth, v->x, v->y, v->z, &got) || memcmp(got.rgb, v->rgb, 3) != 0) abort();
    return 0;
}

static void as_model(const voxrt_tree *t, uint8_t how) {
    voxrt_model *m = NULL;
    voxrt_tree *again = NULL;
    voxrt_tree_info info, info2;
    voxrt_model_info of;
    voxrt_build_desc d = {0};
    voxrt_edit_desc e = {0};
    voxrt_env env = {0};
    modelled in;
    double centre[3], lo[3], hi[3];
    int k;
    env.memory_limit = (size_t)1 << 26;
    if (voxrt_model_from_tree(&env, t, &m) != VOXRT_OK) return;
    voxrt_tree_get_info(t, &info), voxrt_model_get_info(m, &of);
    if (of.voxel_count != info.voxel_count || of.depth != info.depth) abort();
    in.m = m, in.count = 0, in.every = 1 + info.voxel_count / 4096, in.depth = of.depth;
    if (voxrt_tree_each(t, info.depth, in_model, &in) != 0) abort();
    d.env = env, d.palette_size = 1u << 20, d.env.thread_count = 1;
    if (voxrt_tree_from_model(&d, m, &again) == VOXRT_OK) {
        voxrt_tree_get_info(again, &info2);
        if (info2.voxel_count != info.voxel_count || info2.depth != info.depth) abort();
        voxrt_tree_destroy(again), again = NULL;
    }
    voxrt_tree_bounds(t, lo, hi);
    for (k = 0; k < 3; k++) centre[k] = lo[k] + (hi[k] - lo[k]) * (double)(how >> (2 * k) & 3) / 3;
    e.env = d.env, e.op = (voxrt_edit_op)(how >> 6);
    if (voxrt_model_sphere(m, &e, centre, (hi[0] - lo[0]) / 3, NULL) == VOXRT_OK && voxrt_tree_from_model(&d, m, &again) == VOXRT_OK) {
        voxrt_tree_get_info(again, &info2), voxrt_model_get_info(m, &of);
        if (info2.voxel_count != of.voxel_count) abort();
    }
    voxrt_tree_destroy(again), voxrt_model_destroy(m);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    float p[2][9 * 64];
    uint8_t rgb[2][3 * 64], finish[2][64];
    voxrt_tree *t = NULL, *again = NULL;
    size_t n = size < 8 ? 0 : (size - 8) / 45 < 64 ? (size - 8) / 45 : 64, i, k;
    for (i = 0; i < 9 * n; i++) {
        const uint8_t *b = data + 8 + 5 * i;
        memcpy(&p[0][i], b, 4);
        if (b[4] % 4 == 1 || b[4] % 4 == 2) p[0][i] = b[4] % 4 == 1 ? (float)(b[0] | b[1] << 8) / 4096.0f : (float)(b[0] % 65) / 4;
        if (b[4] % 4 == 3) p[0][i] = i < 3 ? 0.0f : p[0][i - 3 * (1 + b[0] % (i / 3))];
    }
    for (i = 0; i < n; i++) memcpy(rgb[0] + 3 * i, data + 8 + 45 * i, 3), memcpy(rgb[1] + 3 * (n - 1 - i), data + 8 + 45 * i, 3);
    for (i = 0; i < n; i++) finish[0][i] = finish[1][n - 1 - i] = data[8 + 45 * i] % 3;
    for (i = 0; i < n; i++) memcpy(p[1] + 9 * (n - 1 - i), p[0] + 9 * i, 36);
    for (k = 0; k < 2 && n != 0; k++) {
        voxrt_build_desc d = {0};
        voxrt_mesh m = {p[k], 3 * n, 0, NULL, n, NULL, 0, NULL, 0, data[7] % 4 == 1 ? rgb[k] : NULL,
                        data[7] & 8 ? finish[k] : NULL, data[7] & 4 ? sample : NULL, NULL};
        d.resolution = 1 + data[0] % 64, d.separating = (voxrt_separating)(data[1] % 3), d.palette_size = data[2] % 8 * 5;
        if ((data[3] & 1) != 0 && d.resolution > 24) d.resolution = 17 + d.resolution % 8; /* bodies of few voxels */
        d.fill = data[3] & 1, d.fill_depth = data[3] >> 6, d.disable_normals = data[4] & 1, d.planes = (data[4] & 3) == 2, d.box_size = data[5] & 1 ? 16 : 0;
        d.spread = (data[4] & 5) == 4, d.finishes = finishes, d.finish_count = data[7] & 8 ? 2 : 0;
        d.lod_method = (voxrt_lod_method)(data[6] & 1), d.env.memory_limit = (size_t)1 << 26, d.env.thread_count = k == 0 ? 1 : 2;
        if ((voxrt_tree_build(&d, &m, NULL, k ? &again : &t) == VOXRT_OK) != ((k ? again : t) != NULL)) abort();
    }
    if (voxrt_tree_hash(t) != voxrt_tree_hash(again)) abort(); /* 0: no tree */
    for (k = 0; t != NULL && k <= t->depth; k++) {
        seen s = {t, (uint32_t)k, 0, 0, 1, (data[7] & 8) == 0};
        voxrt_tree_info info;
        voxrt_tree_get_info(t, &info), s.every = 1 + info.level_count[k] / 4096;
        if (voxrt_tree_each(t, s.level, cell, &s) != 0 || s.count != info.level_count[k]) abort();
    }
    if (t != NULL) as_model(t, (uint8_t)(data[5] >> 1 ^ data[6] >> 1 ^ data[0] / 64 * 64));
    return voxrt_tree_destroy(t), voxrt_tree_destroy(again), 0;
}
