/* bench_models.h - models, trees, ray sets and timed traces shared by the benches of voxrt.h - C99 - MIT OR Unlicense,
   see LICENSE. Include it after bench.h, the support headers and voxrt.h. */
#ifndef BENCH_MODELS_H_INCLUDED
#define BENCH_MODELS_H_INCLUDED
#include "../examples/support/voxel_mesh.h"

/* ---- meshes ---- */

enum { MODEL_BLOB, MODEL_HALL, MODEL_DRAGON, MODEL_BUNNY, MODEL_COUNT };

typedef struct model {
    const char *name, *file;  /* file: NULL for generated scenes */
    sup_mesh mesh;
    int state;                /* 0: not read, 1: there, 2: absent */
} model;

static model g_models[MODEL_COUNT] = {
    {"blob", NULL, {0}, 0}, {"hall", NULL, {0}, 0}, {"dragon", "dragon.ply.gz", {0}, 0},
    {"bunny", "stanford-bunny.obj", {0}, 0}
};
static bench_options g_opt;
static double g_busy_sum, g_busy_count; /* wall over CPU seconds of one-thread runs */

static int run_failed(const char *what, const char *why) {
    fprintf(stderr, "bench_voxrt: %s: %s\n", what, why);
    exit(1);
}
static void must(voxrt_result r, const char *what) {
    if (r != VOXRT_OK) run_failed(what, voxrt_result_string(r));
}
static void *must_alloc(size_t n, size_t size) {
    void *p = calloc(n > 0 ? n : 1, size);
    if (p == NULL) run_failed("memory", "not enough");
    return p;
}

/* All that `gunzip -c path` writes. */
static char *read_pipe(const char *path, size_t *size) {
    char command[800], *data = NULL;
    size_t room = 0, used = 0, got;
    FILE *p;
    if (strchr(path, '\'') != NULL || access(path, R_OK) != 0) return NULL;
    snprintf(command, sizeof command, "gunzip -c '%s' 2>/dev/null", path);
    p = popen(command, "r");
    if (p == NULL) return NULL;
    do {
        data = (char *)sup_grow(data, &room, used + (1u << 20), 1);
        if (data == NULL) run_failed(path, "not enough memory");
        got = fread(data + used, 1, room - used, p);
        used += got;
    } while (got > 0);
    if (pclose(p) != 0) used = 0;
    *size = used;
    return data;
}

static int read_model(model *m) {
    char path[700];
    sup_error err;
    if (m->file == NULL) return sup_scene_make(m->name, 0, &m->mesh);
    snprintf(path, sizeof path, "%s/meshes/%s", g_opt.data, m->file);
    if (strstr(m->file, ".gz") != NULL) {
        size_t size = 0;
        char *data = read_pipe(path, &size);
        int bad = size == 0;
        bad = bad || sup_mesh_read_memory(data, size, SUP_FORMAT_AUTO, m->file, NULL, NULL, &m->mesh, &err);
        SUP_FREE(data);
        if (bad) { /* the decimated one stands in */
            snprintf(path, sizeof path, "%s/meshes/dragon_res3.ply", g_opt.data);
            if (sup_mesh_read(path, &m->mesh, &err)) return 1;
            m->name = "dragon_res3";
        }
    } else if (sup_mesh_read(path, &m->mesh, &err)) {
        return 1;
    }
    return m->mesh.normals == NULL && sup_mesh_compute_normals(&m->mesh, &err);
}

/* NULL when the file is not there. */
static const model *get_model(int id) {
    model *m = &g_models[id];
    if (m->state == 0) m->state = read_model(m) ? 2 : 1;
    return m->state == 1 ? m : NULL;
}

/* ---- trees: kept until drop_trees ---- */

enum { KIND_DEFAULT, KIND_PEER, KIND_PLANES }; /* PEER: every voxel that is touched, in the cube that the peers' voxeliser uses */

typedef struct tree_slot {
    int id, kind;
    uint32_t resolution;
    voxrt_tree *tree;
} tree_slot;
static tree_slot g_trees[64];
static int g_tree_count;

static void drop_trees(void) {
    while (g_tree_count > 0) voxrt_tree_destroy(g_trees[--g_tree_count].tree);
}

static void peer_box(const sup_mesh *mesh, voxrt_build_desc *d) {
    float lo[3], hi[3], e = 0.0f;
    int a;
    (void)sup_mesh_bounds(mesh, lo, hi);
    for (a = 0; a < 3; a++) if (hi[a] - lo[a] > e) e = hi[a] - lo[a];
    e *= 1.0002f;
    for (a = 0; a < 3; a++) d->box_min[a] = (double)(0.5f * (lo[a] + hi[a]) - 0.5f * e);
    d->box_size = (double)e;
}

static const voxrt_tree *get_tree(int id, uint32_t resolution, int kind) {
    const model *m = get_model(id);
    voxrt_build_desc d;
    voxrt_mesh mesh;
    int i;
    if (m == NULL) return NULL;
    for (i = 0; i < g_tree_count; i++) {
        tree_slot *s = &g_trees[i];
        if (s->id == id && s->resolution == resolution && s->kind == kind) return s->tree;
    }
    memset(&d, 0, sizeof d);
    d.env.thread_count = (uint32_t)g_opt.threads;
    d.resolution = resolution;
    mesh = sup_voxel_mesh(&m->mesh);
    if (kind == KIND_PEER) {
        d.separating = VOXRT_SEPARATING_26;
        peer_box(&m->mesh, &d);
    }
    d.planes = kind == KIND_PLANES;
    must(voxrt_tree_build(&d, &mesh, NULL, &g_trees[g_tree_count].tree), "build");
    g_trees[g_tree_count].id = id;
    g_trees[g_tree_count].kind = kind;
    g_trees[g_tree_count].resolution = resolution;
    return g_trees[g_tree_count++].tree;
}

static voxrt_octree *make_octree(const voxrt_tree *tree) {
    voxrt_octree_desc d;
    voxrt_octree *o;
    memset(&d, 0, sizeof d);
    d.env.thread_count = (uint32_t)g_opt.threads;
    must(voxrt_octree_from_tree(&d, tree, &o), "octree");
    return o;
}

/* ---- rays ---- */

/* ray: tiles of 8x8 pixels, row by row. quad: the same rays, in each tile in Morton order, so that four in a row are
   2x2 pixels; quad[i] = ray[from[i]]. Where rays have no such order both are the same. */
typedef struct rayset {
    voxrt_ray *ray, *quad;
    uint32_t *from;
    size_t count;
    float spread;             /* growth of a pixel's width per unit of t; 0: not camera rays */
} rayset;

static rayset make_rayset(size_t count) {
    rayset s;
    memset(&s, 0, sizeof s);
    s.ray = (voxrt_ray *)must_alloc(count, sizeof *s.ray);
    s.quad = (voxrt_ray *)must_alloc(count, sizeof *s.quad);
    s.from = (uint32_t *)must_alloc(count, sizeof *s.from);
    s.count = count;
    return s;
}

static void free_rayset(rayset *s) {
    free(s->ray);
    free(s->quad);
    free(s->from);
    memset(s, 0, sizeof *s);
}

static void order_quads(rayset *s, int tiles) {
    size_t i;
    for (i = 0; i < s->count; i++) {
        const size_t j = i & 63u;
        const size_t x = (j & 1) | (j >> 1 & 2) | (j >> 2 & 4), y = (j >> 1 & 1) | (j >> 2 & 2) | (j >> 3 & 4);
        s->from[i] = (uint32_t)(tiles ? (i & ~(size_t)63) + 8 * y + x : i);
        s->quad[i] = s->ray[s->from[i]];
    }
}

static void frame_camera(const voxrt_tree *tree, uint32_t w, uint32_t h, voxrt_camera *c) {
    double lo[3], hi[3];
    memset(c, 0, sizeof *c);
    c->fov_y = 40.0f;
    voxrt_tree_bounds(tree, lo, hi);
    must(voxrt_camera_fit(c, lo, hi, NULL, w, h), "camera");
}

/* The default camera; sides are multiples of 8. */
static rayset camera_rays(const voxrt_tree *tree, uint32_t w, uint32_t h) {
    rayset s = make_rayset((size_t)w * h);
    voxrt_camera c;
    uint32_t tx, ty, i;
    voxrt_ray *out = s.ray;
    frame_camera(tree, w, h, &c);
    for (ty = 0; ty < h; ty += 8) {
        for (tx = 0; tx < w; tx += 8) {
            for (i = 0; i < 64; i++, out++) {
                must(voxrt_camera_ray(&c, w, h, tx + (i & 7u) + 0.5, ty + (i >> 3) + 0.5, out), "camera ray");
            }
        }
    }
    s.spread = (float)(2.0 * tan((double)c.fov_y * 3.14159265358979323846 / 360.0) / h);
    order_quads(&s, 1);
    return s;
}

/* The same rays from two origins in turn that differ in the last bit: no run of them has a common start. */
static rayset rays_apart(const rayset *from) {
    rayset s = make_rayset(from->count);
    size_t i;
    for (i = 0; i < s.count; i++) {
        s.ray[i] = from->ray[i];
        if (i & 1) s.ray[i].org[0] = nextafterf(s.ray[i].org[0], INFINITY);
    }
    s.spread = from->spread;
    order_quads(&s, 1);
    return s;
}

/* The peers' camera for blob or hall, 1024x768. */
static rayset peer_rays(const char *name) {
    rayset s = make_rayset(1024 * 768);
    float *r = NULL;
    size_t i;
    if (sup_scene_rays_primary(name, 1024, 768, &r)) run_failed(name, "no rays");
    for (i = 0; i < s.count; i++) {
        memcpy(s.ray[i].org, r + 6 * i, 12);
        memcpy(s.ray[i].dir, r + 6 * i + 3, 12);
        s.ray[i].t_max = INFINITY;
    }
    SUP_FREE(r);
    s.spread = 2.0f * (strcmp(name, "hall") == 0 ? 0.577350318f : 0.466307670f) / 768.0f;
    order_quads(&s, 1);
    return s;
}

enum { SECOND_COSINE, SECOND_MIRROR };

/* One ray from each primary hit, pushed 4 voxels along itself; t_max times the longest side of the box, 0: no end. */
static rayset second_rays(const voxrt_tree *tree, const rayset *first, int what, float t_max) {
    voxrt_hit *hit = (voxrt_hit *)must_alloc(first->count, sizeof *hit);
    voxrt_tree_info info;
    bench_rng rng = {777};
    rayset s;
    size_t i, n = 0;
    int a;
    voxrt_tree_get_info(tree, &info);
    must(voxrt_trace(tree, NULL, first->ray, hit, first->count), "trace");
    for (i = 0; i < first->count; i++) n += hit[i].node != VOXRT_NO_NODE;
    s = make_rayset(n);
    for (n = i = 0; i < first->count; i++) {
        const voxrt_ray *r = &first->ray[i];
        float normal[3], d[3], dot;
        if (hit[i].node == VOXRT_NO_NODE) continue;
        voxrt_hit_normal(tree, &hit[i], normal);
        dot = (normal[0] * r->dir[0] + normal[1] * r->dir[1] + normal[2] * r->dir[2]);
        if (dot > 0.0f) for (a = 0; a < 3; a++) normal[a] = -normal[a];
        if (what == SECOND_COSINE) {
            bench_cosine(&rng, normal, d);
        } else {
            for (a = 0; a < 3; a++) d[a] = r->dir[a] + 2.0f * fabsf(dot) * normal[a];
            bench_unit(d);
        }
        for (a = 0; a < 3; a++) {
            s.ray[n].org[a] = r->org[a] + hit[i].t * r->dir[a] + 4.0f * (float)info.voxel_size * d[a];
            s.ray[n].dir[a] = d[a];
        }
        s.ray[n].t_max = t_max > 0.0f ? t_max * (float)(info.voxel_size * info.resolution) : INFINITY;
        n++;
    }
    free(hit);
    order_quads(&s, 0);
    return s;
}

/* Chords between random points of the box of the filled voxels. */
static rayset chord_rays(const voxrt_tree *tree, size_t count) {
    rayset s = make_rayset(count);
    double lo[3], hi[3];
    bench_rng rng = {4242};
    size_t i;
    int a;
    voxrt_tree_bounds(tree, lo, hi);
    for (i = 0; i < count; i++) {
        for (a = 0; a < 3; a++) {
            s.ray[i].org[a] = (float)lo[a] + (float)(hi[a] - lo[a]) * bench_random(&rng);
            s.ray[i].dir[a] = (float)lo[a] + (float)(hi[a] - lo[a]) * bench_random(&rng) - s.ray[i].org[a];
        }
        bench_unit(s.ray[i].dir);
        s.ray[i].t_max = INFINITY;
    }
    order_quads(&s, 0);
    return s;
}

/* From inside a closed body around the origin: the share of them that leaves it is the error of its voxels and of the
   tracer. at: where each ray goes, 3 floats, NULL: any direction. */
static rayset inner_rays(const float *at, size_t count, uint64_t seed) {
    rayset s = make_rayset(count);
    bench_rng rng = {seed};
    size_t i;
    int a;
    for (i = 0; i < count; i++) {
        voxrt_ray *r = &s.ray[i];
        float q;
        for (a = 0; a < 3 && at == NULL; a++) r->org[a] = 0.3f * (2.0f * bench_random(&rng) - 1.0f);
        do {
            for (a = 0, q = 0.0f; a < 3; a++) {
                r->dir[a] = at != NULL ? at[3 * i + (size_t)a] : 2.0f * bench_random(&rng) - 1.0f;
                q += r->dir[a] * r->dir[a];
            }
        } while (at == NULL && !(q > 1e-3f && q < 1.0f));
        r->t_max = INFINITY;
    }
    order_quads(&s, 0);
    return s;
}

static float odd_number(bench_rng *r, int size, int kind) { /* a coordinate on a plane, on 1/8 cells, or anywhere */
    if (kind == 0) return (float)(bench_random_u32(r) % (uint32_t)(size + 1));
    if (kind == 1) return (float)(bench_random_u32(r) % (uint32_t)(8 * size + 1)) * 0.125f;
    return (float)size * bench_random(r);
}

/* What numbers can do to a tracer in a grid of size^3 cells: rays exactly through corners and edges, along axes and in
   planes of the grid, with components that are 0, -0, denormal, tiny or equal, with very long or short directions, from
   10^7 grids away, at a hair's breadth from corners, starting on faces, edges and corners. */
static rayset adversarial_rays(int size, size_t count, uint64_t seed) {
    static const float odd[14] = {0.0f, -0.0f, 1e-45f, -1e-45f, 1e-30f, -1e-30f, 1.0f, -1.0f, 1.0f, -1.0f, 0.5f, -0.5f,
                                  0.25f, 3.0f};
    rayset s = make_rayset(count);
    bench_rng rng = {seed};
    size_t i;
    for (i = 0; i < count; i++) {
        voxrt_ray *r = &s.ray[i];
        const uint32_t kind = bench_random_u32(&rng) % 10u, b = bench_random_u32(&rng) % 3u;
        const float far_off = (float)size * ((bench_random_u32(&rng) & 1u) != 0 ? 1e7f : 1048576.0f);
        float to[3];
        uint32_t a;
        for (a = 0; a < 3; a++) {
            r->org[a] = odd_number(&rng, 2 * size, (int)(bench_random_u32(&rng) % 2u)) - 0.5f * (float)size;
            to[a] = odd_number(&rng, size, kind == 1 && a == b ? 2 : 0); /* a corner; kind 1: an edge */
            r->dir[a] = to[a] - r->org[a];
        }
        for (a = 0; a < 3; a++) {
            if (kind == 2) r->dir[a] = odd[bench_random_u32(&rng) % 14u];
            if (kind == 3) r->dir[a] = a == b ? odd[6 + (bench_random_u32(&rng) & 1u)] : odd[bench_random_u32(&rng) & 1u];
            if (kind == 3 && a != b) r->org[a] = odd_number(&rng, size, 0);
            if (kind == 4 && a == b) r->org[a] = to[a];
            if (kind == 4 && a == b) r->dir[a] = odd[bench_random_u32(&rng) & 1u];
            if (kind == 5) r->org[a] = a <= b ? to[a] : odd_number(&rng, size, 2);
            if (kind == 5) r->dir[a] = 2.0f * bench_random(&rng) - 1.0f;
            if (kind == 6) r->dir[a] = odd[6 + (bench_random_u32(&rng) & 1u)];
            if (kind == 6) r->org[a] = to[a] - r->dir[a] * far_off;
            if (kind == 7) r->dir[a] *= b == 0 ? 1e20f : b == 1 ? 1e-20f : ldexpf(1.0f, -140);
            if (kind == 8) r->dir[a] = a == b && (i & 1) != 0 ? 0.0f : odd[6 + (bench_random_u32(&rng) & 1u)] * 0.7f;
            if (kind == 9 && (bench_random_u32(&rng) & 1u) != 0) {
                r->dir[a] = nextafterf(r->dir[a], (bench_random_u32(&rng) & 1u) != 0 ? INFINITY : -INFINITY);
            }
        }
        if (r->dir[0] == 0.0f && r->dir[1] == 0.0f && r->dir[2] == 0.0f) r->dir[b] = 1.0f;
        r->t_max = kind < 6 && bench_random_u32(&rng) % 4u == 0 ? 1.0f : INFINITY;
    }
    order_quads(&s, 0);
    return s;
}

/* ---- timed traces ---- */

typedef struct trace_job {
    const voxrt_tree *tree;       /* one of tree and octree */
    const voxrt_octree *octree;
    const rayset *rays;
    voxrt_isa isa;
    float cone_spread;
    uint8_t *occluded;            /* tree only: any hit instead of the closest */
    voxrt_hit *hit;               /* out, in the order of rays->ray (octree: of rays->quad) */
    voxrt_octree_stats *octree_stats;
} trace_job;

static void run_trace(void *ctx) {
    trace_job *j = (trace_job *)ctx;
    if (j->octree != NULL) {
        voxrt_octree_trace_desc d;
        memset(&d, 0, sizeof d);
        d.isa = j->isa;
        d.stats = j->octree_stats;
        must(voxrt_octree_trace(j->octree, &d, j->rays->quad, j->hit, j->rays->count), "octree trace");
    } else {
        voxrt_trace_desc d;
        memset(&d, 0, sizeof d);
        d.isa = j->isa;
        d.cone_spread = j->cone_spread;
        must(j->occluded != NULL ? voxrt_occluded(j->tree, &d, j->rays->ray, j->occluded, j->rays->count) :
            voxrt_trace(j->tree, &d, j->rays->ray, j->hit, j->rays->count), "trace");
    }
}

/* From the order of rays->quad to that of rays->ray. */
static void unorder(const rayset *s, voxrt_hit *hit) {
    voxrt_hit tile[64];
    size_t i, n, k;
    for (i = 0; i < s->count; i += n) {
        n = s->count - i < 64 ? s->count - i : 64;
        for (k = 0; k < n; k++) tile[s->from[i + k] - i] = hit[i + k];
        memcpy(hit + i, tile, n * sizeof tile[0]);
    }
}

/* Rays whose hit or cell differs; a larger leaf that contains the exact cell is right. */
static size_t count_wrong(const voxrt_hit *exact, const voxrt_hit *hit, size_t count) {
    size_t i, wrong = 0;
    for (i = 0; i < count; i++) {
        const int miss = exact[i].node == VOXRT_NO_NODE;
        if (miss != (hit[i].node == VOXRT_NO_NODE)) {
            wrong++;
        } else if (!miss) {
            const unsigned up = exact[i].level > hit[i].level ? (unsigned)(exact[i].level - hit[i].level) : 0u;
            int a, same = 1;
            for (a = 0; a < 3; a++) same &= exact[i].cell[a] >> up == hit[i].cell[a];
            wrong += !same;
        }
    }
    return wrong;
}

/* Widest cell that stood in for smaller ones, in pixels: what the tolerance bounds. */
static double widest_cell(const voxrt_tree *tree, const rayset *s, const voxrt_hit *hit) {
    voxrt_tree_info info;
    double widest = 0.0;
    size_t i;
    voxrt_tree_get_info(tree, &info);
    for (i = 0; i < s->count; i++) {
        double edge;
        if (hit[i].node == VOXRT_NO_NODE || hit[i].level >= info.depth) continue;
        edge = info.voxel_size * ldexp(1.0, (int)(info.depth - hit[i].level));
        edge /= (double)s->spread * (double)hit[i].t;
        if (edge > widest) widest = edge;
    }
    return widest;
}

static uint64_t hash_hits(const voxrt_hit *hit, size_t count) {
    uint64_t h = count;
    size_t i;
    for (i = 0; i < count; i++) {
        if (hit[i].node == VOXRT_NO_NODE) continue;
        h = bench_mix(h, i);
        h = bench_mix(h, (uint64_t)hit[i].cell[0] | (uint64_t)hit[i].cell[1] << 20 | (uint64_t)hit[i].cell[2] << 40);
    }
    return h;
}

static size_t count_hits(const voxrt_hit *hit, size_t count) {
    size_t i, n = 0;
    for (i = 0; i < count; i++) n += hit[i].node != VOXRT_NO_NODE;
    return n;
}

/* ---- the acceptance table ---- */

static bench_row g_rows[] = {
    {"blob-512-primary", "primary rays, blob 512", "M rays/s/core", "24", "56", ""},
    {"hall-512-primary", "primary rays, hall 512", "M rays/s/core", "19", "43", ""},
    {"blob-1024-primary", "primary rays, blob 1024", "M rays/s/core", "18", "40", ""},
    {"hall-1024-primary", "primary rays, hall 1024", "M rays/s/core", "18", "40", ""},
    {"blob-2048-primary", "primary rays, blob 2048", "M rays/s/core", "12", "36", ""},
    {"hall-2048-primary", "primary rays, hall 2048", "M rays/s/core", "9", "25", ""},
    {"dragon-4096-ratio", "dragon 4096, default view, against the thesis' SSE packets", "times", "3", "6", ""},
    {"dragon-4096-lod", "the same, cells up to 1 px", "times", "3", "8", ""},
    {"blob-512-diffuse", "diffuse rays, blob 512", "M rays/s/core", "12", "21", ""},
    {"blob-1024-diffuse", "diffuse rays, blob 1024", "M rays/s/core", "10", "17", ""},
    {"blob-2048-diffuse", "diffuse rays, blob 2048", "M rays/s/core", "8", "14", ""},
    {"blob-2048-random", "random rays, blob 2048", "M rays/s/core", "3", "8", ""},
    {"growth-lod", "frame time per level from 1024, cells up to 1 px: mean (most)", "", "+4 %", "0 %", ""},
    {"growth", "frame time per level from 1024, full detail: mean (most)", "", "+15 %", "+8 %", ""},
    {"convert", "1,048,576 triangles to a 1024 file, wall with --threads (CPU)", "s", "1.0", "0.3", ""},
    {"build-4096", "voxelise and build, dragon 4096, wall with --threads (per CPU second)", "M voxels/s", "10", "25", ""},
    {"geometry-bits", "geometry in memory, dragon 2048, 6-separating", "bits/leaf", "6.4", "4.4", ""},
    {"geometry-bits-26", "geometry in memory, blob 1024, 26-separating (as the peers)", "bits/leaf", "6.4", "4.4", ""},
    {"attributes", "50 M leaves: normals, 24 colours, all levels (scaled from dragon 2048)", "MiB", "260", "160", ""},
    {"attributes-smooth", "the same, a colour of its own for each vertex (blob 1024)", "MiB", "260", "160", ""},
    {"shared-bits", "geometry in memory, equal parts once, dragon 2048 / pillars 4096", "bits/leaf", "", "2.0 / 0.5", ""},
    {"shared-file", "the same in a compact file", "bits/leaf", "", "1.5 / 0.3", ""},
    {"shared-rays", "rays, equal parts once against plain: dragon 2048, camera / diffuse / chords", "times", "1", "", ""},
    {"shared-smooth", "50 M leaves, equal parts once, a colour of its own for each vertex (blob 1024)", "MiB", "260", "160", ""},
    {"file-bits", "geometry in a compact file, dragon 2048, 6-separating", "bits/leaf", "2.7", "2.0", ""},
    {"file-bits-26", "geometry in a compact file, blob 1024, 26-separating", "bits/leaf", "2.7", "2.0", ""},
    {"wrong", "missed or extra hits against exact stepping, blob and hall 512", "rays", "0", "0", ""},
    {"adversarial", "the same, rays through corners, edges and along planes of a 64 grid", "rays", "0", "0", ""},
    {"leaks", "rays that escape a closed shell: blob 1024, all vertices, edge midpoints, random", "rays", "0", "0", ""},
    {"load-compact", "load a compact file, wall with --threads (1 core, CPU)", "M voxels/s", "100", "", ""},
    {"load-raw", "load a raw file, wall with --threads (1 core, CPU)", "M voxels/s", "100", "", ""},
    {"pages", "terrain 4096 in pages (--full: 32768), full detail, loaded: pictures that are not exact, or took more memory than they may", "pictures",
     "0", "0", ""},
    {"normals", "error of normals, mean / most", "degrees", "0.315 / 0.64", "", ""}
};

static bench_table g_table = {g_rows, sizeof g_rows / sizeof g_rows[0], "Rays: one core by CPU time, the default instruction set first", "table.md"};
#define table_set(...) bench_table_set(&g_table, __VA_ARGS__)

#endif
