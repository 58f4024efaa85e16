/* fuzz_vox.c - any bytes as a voxel file, plain or shared, by every way to load one: version 5 compact, raw, mapped and in pages, version 4 as
   it is, mirrored and with its angles swapped. What is accepted is asked everything, traced, drawn, changed, converted, and is
   the same after it was saved and loaded. Checksums are made right first, otherwise only they would be tested. */
#define _POSIX_C_SOURCE 200112L
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
#include <unistd.h>
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { W = 20, H = 12, LIMIT = 1 << 26 };
static uint32_t g_turn; /* different pictures for different inputs */

static void must(int ok) { if (!ok) abort(); }

static int seen(void *user, const voxrt_voxel *v, uint32_t index) {
    uint64_t *sum = (uint64_t *)user;
    (void)index;
    *sum += 1;
    if (v->has_normal) must(voxrti_finite_f(v->normal[0]) && voxrti_finite_f(v->normal[1]) && voxrti_finite_f(v->normal[2]));
    return *sum > 4096;
}

/* A small picture with everything in it; of a tree, or of a geometry. */
static void draw(const voxrt_tree *t, const voxrt_geometry *g) {
    static uint8_t rgba8[4 * W * H];
    static float rgba[4 * W * H], depth[W * H], normal[3 * W * H];
    static voxrt_hit hit[W * H];
    voxrt_render_desc d;
    voxrt_image m;
    voxrt_render_stats stats;
    voxrt_blur_desc b;
    voxrt_result r;
    size_t i;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    memset(&stats, 0, sizeof stats);
    m.width = W;
    m.height = H;
    m.rgba8 = rgba8;
    m.rgba = rgba;
    m.depth = depth;
    m.normal = normal;
    m.hit = hit;
    d.env.thread_count = 1;
    d.geometry = g;
    d.geometry_count = g != NULL;
    d.view = (voxrt_view)(g_turn % 7);
    d.isa = (voxrt_isa)(g_turn / 7 % 5);
    d.shadows = g_turn & 1;
    d.tolerance = g_turn & 2 ? 3.0f : 0.0f;
    d.object_lod = g_turn >> 2 & 1;
    d.max_level_plus_1 = g_turn >> 3 & 7;
    d.thesis_compose = g_turn >> 6 & 1;
    d.pixel_step = g_turn >> 7 & 3;
    d.samples = 1 + (g_turn >> 9 & 1);
    d.blend = g_turn >> 10 & 1;
    d.cubes = (g_turn >> 11 & 3) == 3;
    g_turn = g_turn * 1664525u + 1013904223u;
    r = voxrt_render(&d, t, &m, &stats);
    if (r == VOXRT_ERR_INVALID_ARG) return; /* so far out that no camera frames it in floats */
    must(r == VOXRT_OK);
    for (i = 0; i < 4 * W * H; i++) must(voxrti_finite_f(rgba[i]));
    if (d.view < VOXRT_VIEW_HEAT_OUTER)
        for (i = 0; i < W * H; i++) must(depth[i] >= 0.0f && voxrti_finite_f(normal[3 * i]));
    if (t == NULL || d.view >= VOXRT_VIEW_HEAT_OUTER) return;
    memset(&b, 0, sizeof b);
    b.footprint = 0.01f;
    b.voxel_size = (float)t->voxel_size;
    b.depth = t->depth;
    (void)voxrt_blur(&b, &m);
    for (i = 0; i < 4 * W * H; i++) must(voxrti_finite_f(rgba[i]));
}

static void use_octree(voxrt_octree *o, int may_change);

/* A file in pages, drawn while pages are read, between pictures or at once; t, if there is one, has the same hits. */
static void use_paged(const uint8_t *data, size_t size, const voxrt_tree *t) {
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    voxrt_geometry g, whole;
    uint32_t wait, i;
    for (wait = 0; wait < 2; wait++) {
        memset(&d, 0, sizeof d);
        d.data = data;
        d.size = size;
        d.wait = wait;
        d.trust_input = 1;
        d.memory = LIMIT / 8;
        d.env.memory_limit = LIMIT;
        if (voxrt_paged_open(&d, &p) != VOXRT_OK) {
            must(p == NULL && t == NULL);
            return;
        }
        voxrt_paged_geometry(p, &g);
        for (i = 0; i < 3; i++) {
            voxrt_ray ray[5];
            voxrt_surface s[5], same[5];
            uint8_t occluded[5];
            voxrt_trace_desc td;
            uint32_t k, a;
            draw(NULL, &g);
            memset(&td, 0, sizeof td);
            td.isa = (voxrt_isa)(g_turn % 5);
            td.cone_spread = g_turn & 32 ? 0.1f : 0.0f;
            td.blend = g_turn >> 6 & 1;
            for (k = 0; k < 5; k++) {
                memset(&ray[k], 0, sizeof ray[k]);
                ray[k].t_max = INFINITY;
                for (a = 0; a < 3; a++) {
                    const double size_a = g.box_max[a] - g.box_min[a];
                    ray[k].org[a] = (float)(g.box_min[a] + ((k >> a & 1) != 0 ? -0.3 : 1.2) * size_a);
                    ray[k].dir[a] = (float)(g.box_min[a] + 0.37 * (a + 1) / 2.0 * size_a) - ray[k].org[a];
                }
            }
            g.trace_fn(g.user, &td, ray, s, 5);
            g.occluded_fn(g.user, &td, ray, occluded, 5);
            for (k = 0; k < 5; k++) must(wait || occluded[k] == (s[k].t < INFINITY)); /* reading it again may fail */
            if (wait && t != NULL) {
                voxrt_tree_geometry(t, &whole);
                whole.trace_fn(whole.user, &td, ray, same, 5);
                for (k = 0; k < 5; k++) { /* each has finishes of its own */
                    must((s[k].finish != NULL) == (same[k].finish != NULL));
                    if (s[k].finish != NULL) must(memcmp(s[k].finish, same[k].finish, sizeof *s[k].finish) == 0);
                    s[k].finish = same[k].finish = NULL;
                }
                must(memcmp(s, same, sizeof s) == 0);
            }
            (void)voxrt_paged_update(p, 0, NULL);
        }
        voxrt_paged_destroy(p);
        p = NULL;
    }
}

/* What a file says of finishes: numbers as they have to be, and the same from a hit as from what a ray sees. */
static void finishes(const voxrt_tree *t, const voxrt_ray ray[8], const voxrt_hit hit[8]) {
    voxrt_geometry g;
    voxrt_trace_desc td;
    voxrt_surface s[8];
    uint32_t entries = 0, i;
    (void)voxrt_tree_palette(t, &entries);
    must(voxrt_tree_finish(t, entries) == NULL && voxrt_tree_finish(t, 0xffffffffu) == NULL);
    for (i = 0; i < entries && i < 4096; i++) {
        const voxrt_finish *f = voxrt_tree_finish(t, i);
        must(f == NULL || voxrti_finish_ok(f));
    }
    memset(&td, 0, sizeof td);
    voxrt_tree_geometry(t, &g);
    g.trace_fn(g.user, &td, ray, s, 8);
    for (i = 0; i < 8; i++) {
        must((s[i].t < INFINITY) == (hit[i].node != VOXRT_NO_NODE));
        if (hit[i].node != VOXRT_NO_NODE) must(s[i].finish == voxrt_hit_finish(t, &hit[i]));
    }
}

static int same_finish(const voxrt_finish *a, const voxrt_finish *b) {
    return a == NULL || b == NULL ? a == b : memcmp(a, b, sizeof *a) == 0;
}

static void use(voxrt_tree *t) {
    voxrt_tree *again = NULL;
    voxrt_octree *o = NULL;
    voxrt_octree_desc od;
    voxrt_load_desc l;
    voxrt_save_desc s;
    voxrt_tree_info info;
    voxrt_ray ray[8];
    voxrt_hit hit[8], one;
    uint8_t occluded[8], rgb[3];
    float normal[3];
    size_t size = 0, i, a;
    int how, small;
    voxrt_tree_get_info(t, &info);
    small = !info.shared || info.voxel_count < 100000; /* a small file can be a large tree then */
    for (i = 0; i < 8; i++) {
        memset(&ray[i], 0, sizeof ray[i]);
        ray[i].t_max = INFINITY;
        for (a = 0; a < 3; a++) {
            double from = (i + a) % 3 == 0 ? -3.0 : (double)t->cell_max[a];
            if (i >= 4) from = 0.5 * ((double)t->cell_min[a] + (double)t->cell_max[a]); /* from the middle */
            ray[i].org[a] = (float)(t->origin[a] + t->voxel_size * from);
            ray[i].dir[a] = (float)(t->voxel_size * ((double)t->cell_min[a] - from + (i >= 4 ? (double)(i * a) : 0.0)));
        }
    }
    must(voxrt_trace(t, NULL, ray, hit, 8) == VOXRT_OK && voxrt_occluded(t, NULL, ray, occluded, 8) == VOXRT_OK);
    for (i = 0; i < 8; i++) {
        must(voxrt_trace1(t, &ray[i], &one) == (hit[i].node != VOXRT_NO_NODE) && memcmp(&one, &hit[i], sizeof one) == 0);
        must(occluded[i] == (one.node != VOXRT_NO_NODE));
        if (one.node == VOXRT_NO_NODE) continue;
        voxrt_hit_normal(t, &one, normal);
        voxrt_hit_color(t, &one, rgb);
        must(voxrt_tree_get(t, one.level, one.cell[0], one.cell[1], one.cell[2], NULL));
    }
    finishes(t, ray, hit);
    for (i = 0; i <= t->depth; i++) {
        uint64_t sum = 0;
        (void)voxrt_tree_each(t, (uint32_t)i, seen, &sum);
        must(sum == info.level_count[i] || (sum > 4096 && sum < info.level_count[i]));
    }
    draw(t, NULL);
    memset(&s, 0, sizeof s);
    memset(&l, 0, sizeof l);
    s.env.thread_count = l.env.thread_count = 1;
    for (how = 0; how < 4; how++) { /* compact; raw; raw, mapped; raw, mapped, trusted */
        void *file = NULL;
        s.encoding = how == 0 ? VOXRT_ENCODING_COMPACT : VOXRT_ENCODING_RAW;
        l.trust_input = how == 3;
        must(voxrt_tree_save_memory(t, &s, NULL, 0, &size) == VOXRT_OK);
        if (posix_memalign(&file, 64, size) != 0) abort();
        must(voxrt_tree_save_memory(t, &s, file, size, &size) == VOXRT_OK);
        if (how < 2 || !voxrti_little_endian()) must(voxrt_tree_load_memory(&l, file, size, &again) == VOXRT_OK);
        else must(voxrt_tree_map_memory(&l, file, size, &again) == VOXRT_OK);
        if (small) must(voxrt_tree_hash(again) == voxrt_tree_hash(t));
        voxrt_tree_destroy(again);
        free(file);
    }
    if (info.voxel_count < 20000) {
        uint8_t *file;
        s.encoding = VOXRT_ENCODING_PAGED;
        must(voxrt_tree_save_memory(t, &s, NULL, 0, &size) == VOXRT_OK);
        file = (uint8_t *)malloc(size);
        must(file != NULL);
        must(voxrt_tree_save_memory(t, &s, file, size, &size) == VOXRT_OK);
        use_paged(file, size, t);
        free(file);
    }
    for (how = 0; how < 2; how++) { /* shared and back, or the other way round */
        voxrt_tree *other = NULL;
        voxrt_env e;
        memset(&e, 0, sizeof e);
        e.thread_count = 1;
        e.memory_limit = LIMIT;
        if ((how == 0 ? voxrt_tree_share(t, &e, &other) : voxrt_tree_unshare(t, &e, &other)) != VOXRT_OK) continue;
        if (small) must(voxrt_tree_hash(other) == voxrt_tree_hash(t));
        for (i = 0; i < 8; i++) {
            must(voxrt_trace1(other, &ray[i], &one) == (hit[i].node != VOXRT_NO_NODE));
            if (one.node != VOXRT_NO_NODE) must(same_finish(voxrt_hit_finish(other, &one), voxrt_hit_finish(t, &hit[i])));
            one.node = hit[i].node;
            must(memcmp(&one, &hit[i], sizeof one) == 0);
        }
        voxrt_tree_destroy(other);
    }
    memset(&od, 0, sizeof od);
    od.env.thread_count = 1;
    od.env.memory_limit = LIMIT;
    od.disable_collapse = g_turn & 1;
    if (voxrt_octree_from_tree(&od, t, &o) == VOXRT_OK) use_octree(o, 0);
    voxrt_octree_destroy(o);
    voxrt_tree_destroy(t);
}

static void use_octree(voxrt_octree *o, int may_change) {
    voxrt_octree_info info;
    voxrt_octree *again = NULL;
    voxrt_octree_desc d;
    voxrt_geometry g;
    voxrt_ray ray[5];
    voxrt_hit hit[5], one[5];
    voxrt_octree_trace_desc td;
    float normal[15];
    uint8_t *file = NULL, rgb[3];
    size_t size = 0, i, a;
    voxrt_octree_get_info(o, &info);
    must(info.leaf_count == 7 * info.node_count + 1);
    memset(&td, 0, sizeof td);
    for (i = 0; i < 5; i++) {
        memset(&ray[i], 0, sizeof ray[i]);
        ray[i].t_max = INFINITY;
        for (a = 0; a < 3; a++) {
            const double full = info.voxel_size * (double)(1u << info.depth), to = 0.37 * full * (double)(a + 1) / 2.0;
            ray[i].org[a] = (float)(info.world_origin[a] + ((i >> a & 1) != 0 ? -0.3 : 1.2) * full);
            ray[i].dir[a] = (float)(info.world_origin[a] + to) - ray[i].org[a];
        }
    }
    td.max_level_plus_1 = g_turn >> 4 & 3;
    must(voxrt_octree_trace(o, &td, ray, hit, 5) == VOXRT_OK);
    td.isa = VOXRT_ISA_SCALAR;
    must(voxrt_octree_trace(o, &td, ray, one, 5) == VOXRT_OK && memcmp(hit, one, sizeof one) == 0);
    voxrt_octree_hit_normals(o, hit, normal, 5);
    for (i = 0; i < 5; i++) if (hit[i].node != VOXRT_NO_NODE) voxrt_octree_hit_color(o, &hit[i], rgb);
    voxrt_octree_geometry(o, &g);
    draw(NULL, &g);
    must(voxrt_octree_save_memory(o, NULL, NULL, 0, &size) == VOXRT_OK && (file = (uint8_t *)malloc(size)) != NULL);
    must(voxrt_octree_save_memory(o, NULL, file, size, &size) == VOXRT_OK);
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    must(voxrt_octree_load_memory(&d, file, size, &again) == VOXRT_OK);
    {
        size_t size2 = 0;
        uint8_t *file2;
        must(voxrt_octree_save_memory(again, NULL, NULL, 0, &size2) == VOXRT_OK && size2 == size);
        must((file2 = (uint8_t *)malloc(size2)) != NULL);
        must(voxrt_octree_save_memory(again, NULL, file2, size2, &size2) == VOXRT_OK && memcmp(file, file2, size) == 0);
        free(file2);
    }
    voxrt_octree_destroy(again);
    free(file);
    if (!may_change) return;
    must(voxrt_octree_build_lod(o) == VOXRT_OK && voxrt_octree_collapse(o) == VOXRT_OK);
    must(voxrt_octree_insert(o, 0, 0, 0, info.palette_count, NULL) == VOXRT_OK);
    must(voxrt_octree_build_grid(o, info.depth < 4 ? info.depth + 1 : 5) == VOXRT_OK);
    must(voxrt_octree_trace(o, NULL, ray, hit, 5) == VOXRT_OK);
}

/* The same by way of a file that has a name. */
static void by_name(const void *data, size_t size, const voxrt_load_desc *d, const voxrt_octree_desc *od) {
    char path[64];
    voxrt_tree *t[2] = {NULL, NULL};
    voxrt_octree *o[2] = {NULL, NULL};
    FILE *f;
    size_t n = 0;
    (void)snprintf(path, sizeof path, "/tmp/fuzz_vox.%ld.vox", (long)getpid());
    f = fopen(path, "wb");
    if (f == NULL) return;
    n = fwrite(data, 1, size, f);
    if (fclose(f) == 0 && n == size) {
        must(voxrt_tree_load_file(d, path, &t[0]) == voxrt_tree_load_memory(d, data, size, &t[1]));
        if (t[0] != NULL && t[0]->voxel_count < 100000) must(voxrt_tree_hash(t[0]) == voxrt_tree_hash(t[1]));
        must(voxrt_octree_load_file(od, path, &o[0]) == voxrt_octree_load_memory(od, data, size, &o[1]));
    }
    voxrt_tree_destroy(t[0]);
    voxrt_tree_destroy(t[1]);
    voxrt_octree_destroy(o[0]);
    voxrt_octree_destroy(o[1]);
    (void)remove(path);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    void *copy = NULL;
    voxrt_load_desc d;
    voxrt_octree_desc od;
    voxrt_tree *t;
    voxrt_octree *o;
    size_t i;
    uint32_t turn;
    for (i = 0, g_turn = (uint32_t)size; i < size && i < 64; i++) g_turn = g_turn * 31u + data[i];
    turn = g_turn;
    memset(&d, 0, sizeof d);
    memset(&od, 0, sizeof od);
    d.env.thread_count = 1;
    d.env.memory_limit = LIMIT;
    od.env = d.env;
    if (posix_memalign(&copy, 64, size + !size) != 0) return 0;
    if (size != 0) memcpy(copy, data, size);
    if (voxrt_file_kind(copy, size) == 5) voxrti_v5_seal((uint8_t *)copy, size);
    if (voxrt_tree_load_memory(&d, copy, size, &t) == VOXRT_OK) use(t);
    if (voxrt_tree_map_memory(&d, copy, size, &t) == VOXRT_OK) use(t);
    use_paged((const uint8_t *)copy, size, NULL);
    for (i = 0; i < 2; i++) {
        if (voxrt_octree_load_memory(&od, copy, size, &o) == VOXRT_OK) {
            if (voxrt_tree_from_octree(&od, o, &t) == VOXRT_OK) use(t);
            use_octree(o, 1);
            voxrt_octree_destroy(o);
        }
        od.flip_y = g_turn & 1;
        od.flip_z = 1;
        od.swap_angles = g_turn >> 1 & 1;
        od.disable_grid = 1;
    }
    if ((turn * 0x9e3779b1u) >> 26 == 0) by_name(copy, size, &d, &od); /* now and then: files are slow */
    free(copy);
    return 0;
}
