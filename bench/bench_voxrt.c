/* bench_voxrt.c - how fast, how large and how wrong voxrt.h is - MIT OR Unlicense, see LICENSE

   bench_voxrt [--full] [--only BM1,BM6] [--threads N] [--data DIR] [--table FILE]

   BM1 paths: the thesis' and ours; errors, leaks   BM6 shadows, occlusion, mirrors   BM11 frame budget
   BM2 resolution                                   BM7 ways through the octree       BM12 is bench/peers/embree_voxrt.cpp
   BM3 stages of a picture, threads                 BM8 converter                     BM13 tolerance against error
   BM4 start grid of the octree                     BM9 loading                       BM14 editing, BM15 planes
   BM5 memory and files                             BM10 normals (setup, compose: BM3) BM16 many objects
                                                                                       BM17 larger than memory
   One JSON object a line on stdout; the acceptance table on stderr and, after a run of all, in bench/table.md beside the
   program. */
#include "bench.h"
#include "../examples/support/mesh.h"
#include "../examples/support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "../tests/oracle.h"
#include "../tests/ball.h"
#include "baseline/neighbour.h"
#include "bench_models.h"

enum { WIDTH = 1312, HEIGHT = 640, ROUNDS = 5 }; /* the thesis' picture */

/* ---- paths ---- */

enum { WITH_THESIS_SCALAR = 1, WITH_LOD = 2, WITH_OCCLUDED = 4, WITH_NO_BEAM = 8 };

typedef struct paths {
    const char *bench, *kase;
    const voxrt_tree *tree;
    const voxrt_octree *octree; /* may be NULL */
    const rayset *rays;
    int with, grid;             /* grid: start grid of the octree, for the lines */
    const char *peer;
    double peer_value;
    /* out, by isa: rays/s, times the thesis' packets, the same with level of detail; 0: not run */
    double rate[VOXRT_ISA_AVX512 + 1], ratio[VOXRT_ISA_AVX512 + 1], ratio_lod[VOXRT_ISA_AVX512 + 1];
} paths;

/* What a caller gets who asks for nothing, then the other fast one. */
static void table_isa(const char *key, const double *v, double scale, int digits) {
    const int best = (int)voxrt_isa_best();
    if (best == VOXRT_ISA_AVX512) {
        table_set(key, "%.*f (avx2 %.*f)", digits, scale * v[best], digits, scale * v[VOXRT_ISA_AVX2]);
    } else {
        table_set(key, "%.*f", digits, scale * v[best]);
    }
}

static void path_lines(const paths *p, const trace_job *t, const bench_job *b, const voxrt_hit *exact, int lod) {
    const rayset *s = p->rays;
    voxrt_tree_info info;
    double error;
    size_t wrong = 0, i;
    voxrt_tree_get_info(p->tree, &info);
    bench_line(p->bench, p->kase, lod ? "lod_rays_per_second" : "rays_per_second", bench_rate(b, (double)s->count),
               "1/s");
    bench_num("best", bench_rate_best(b, (double)s->count));
    if (t->octree != NULL) unorder(s, t->hit);
    if (t->occluded != NULL) {
        for (i = 0; i < s->count; i++) wrong += t->occluded[i] != (exact[i].node != VOXRT_NO_NODE);
    } else {
        wrong = count_wrong(exact, t->hit, s->count);
    }
    error = lod ? widest_cell(p->tree, s, t->hit) : (double)wrong;
    bench_num("error", error);
    bench_text("error_unit", lod ? "px" : "rays");
    bench_text("method", b->name);
    bench_text("isa", b->isa);
    bench_num("threads", 1);
    bench_num("rays", (double)s->count);
    bench_num("hits", (double)(t->occluded != NULL ? count_hits(exact, s->count) : count_hits(t->hit, s->count)));
    bench_num("wall_per_cpu", bench_busy(b));
    g_busy_sum += bench_busy(b);
    g_busy_count += 1.0;
    bench_num("ns_per_ray", 1e9 * bench_seconds(b) / (double)s->count);
    if (t->octree != NULL) {
        size_t n;
        (void)voxrt_octree_voxels(t->octree, &n);
        bench_num("bytes", 8.0 * (double)n);
        bench_num("grid_level", p->grid);
    } else {
        bench_num("bytes", (double)info.geometry_bytes);
    }
    bench_hash(t->occluded != NULL ? bench_hash_bytes(t->occluded, s->count) : hash_hits(t->hit, s->count));
    if (p->peer != NULL && !lod && t->occluded == NULL) {
        bench_text("peer", p->peer);
        bench_num("peer_value", p->peer_value);
    }
    bench_end();
}

/* All paths on one set of rays, in turn; ours against the thesis' packets. */
static void run_paths(paths *p) {
    static const struct { const char *name, *isa; int octree, isa_id, lod, occluded, with; } kinds[9] = {
        {"thesis single ray", "scalar", 1, VOXRT_ISA_SCALAR, 0, 0, WITH_THESIS_SCALAR},
        {"thesis packets", "sse", 1, VOXRT_ISA_SSE, 0, 0, 0},
        {"tree", "scalar", 0, VOXRT_ISA_SCALAR, 0, 0, 0},
        {"tree", "avx2", 0, VOXRT_ISA_AVX2, 0, 0, 0},
        {"tree", "avx512", 0, VOXRT_ISA_AVX512, 0, 0, 0},
        {"tree, 1 px", "avx2", 0, VOXRT_ISA_AVX2, 1, 0, WITH_LOD},
        {"tree, 1 px", "avx512", 0, VOXRT_ISA_AVX512, 1, 0, WITH_LOD},
        {"tree, any hit", "auto", 0, VOXRT_ISA_AUTO, 0, 1, WITH_OCCLUDED},
        {"tree, no common start", "auto", 0, VOXRT_ISA_AUTO, 0, 0, WITH_NO_BEAM}
    };
    trace_job t[9];
    bench_job b[9];
    rayset apart;
    int n = 0, i, base = -1, exact = 0;
    memset(b, 0, sizeof b);
    memset(t, 0, sizeof t);
    memset(&apart, 0, sizeof apart);
    if (p->with & WITH_NO_BEAM) apart = rays_apart(p->rays);
    for (i = 0; i < 9; i++) {
        if ((kinds[i].with & p->with) != kinds[i].with) continue;
        if (kinds[i].octree && p->octree == NULL) continue;
        if (kinds[i].isa_id > (int)voxrt_isa_best()) continue;
        t[n].octree = kinds[i].octree ? p->octree : NULL;
        t[n].tree = p->tree;
        t[n].rays = kinds[i].with == WITH_NO_BEAM ? &apart : p->rays;
        t[n].isa = (voxrt_isa)kinds[i].isa_id;
        t[n].cone_spread = kinds[i].lod ? p->rays->spread : 0.0f;
        t[n].hit = (voxrt_hit *)must_alloc(p->rays->count, sizeof(voxrt_hit));
        if (kinds[i].occluded) t[n].occluded = (uint8_t *)must_alloc(p->rays->count, 1);
        b[n].name = kinds[i].name;
        b[n].isa = kinds[i].isa;
        b[n].run = run_trace;
        b[n].ctx = &t[n];
        if (i == 1) base = n;
        if (i == 2) exact = n;
        n++;
    }
    bench_interleave(b, n, ROUNDS);
    for (i = 0; i < n; i++) path_lines(p, &t[i], &b[i], t[exact].hit, t[i].cone_spread > 0.0f);
    for (i = 0; i < n; i++) {
        const int is_lod = t[i].cone_spread > 0.0f, isa = (int)t[i].isa;
        double r;
        if (t[i].octree != NULL || t[i].occluded != NULL || t[i].rays != p->rays) continue;
        if (!is_lod) p->rate[isa] = bench_rate(&b[i], (double)p->rays->count);
        if (base < 0) continue;
        r = bench_ratio(&b[base], &b[i]);
        (is_lod ? p->ratio_lod : p->ratio)[isa] = r;
        bench_line(p->bench, p->kase, "times_thesis_packets", r, "");
        bench_text("method", b[i].name);
        bench_text("isa", b[i].isa);
        bench_end();
    }
    for (i = 0; i < n; i++) {
        free(t[i].hit);
        free(t[i].occluded);
    }
    free_rayset(&apart);
}

/* The start grid that is fastest for these rays: of 6 to 8, and on from there while the last is the fastest. It is left
   built. */
static int best_grid(voxrt_octree *o, const rayset *rays) {
    voxrt_octree_info info;
    int g, best = 0;
    double least = 1e30;
    voxrt_octree_get_info(o, &info);
    for (g = 6; (g <= 8 || best == g - 1) && g <= 10 && g <= (int)info.depth + 1; g++) {
        trace_job t;
        bench_job b;
        memset(&t, 0, sizeof t);
        memset(&b, 0, sizeof b);
        must(voxrt_octree_build_grid(o, (uint32_t)g), "grid");
        t.octree = o;
        t.rays = rays;
        t.isa = VOXRT_ISA_SSE;
        t.hit = (voxrt_hit *)must_alloc(rays->count, sizeof(voxrt_hit));
        b.run = run_trace;
        b.ctx = &t;
        bench_interleave(&b, 1, g_opt.full ? 3 : 1);
        if (bench_seconds_best(&b) < least) {
            least = bench_seconds_best(&b);
            best = g;
        }
        free(t.hit);
    }
    must(voxrt_octree_build_grid(o, (uint32_t)best), "grid");
    return best;
}

static void paths_default_view(int id, uint32_t resolution) {
    const voxrt_tree *tree = get_tree(id, resolution, KIND_DEFAULT);
    char kase[64];
    paths p;
    voxrt_octree *o;
    rayset rays;
    if (tree == NULL) {
        bench_skip("voxrt.paths", g_models[id].name, "no such file");
        return;
    }
    snprintf(kase, sizeof kase, "%s-%u", g_models[id].name, resolution);
    rays = camera_rays(tree, WIDTH, HEIGHT);
    o = make_octree(tree);
    memset(&p, 0, sizeof p);
    p.grid = best_grid(o, &rays);
    p.bench = "voxrt.paths";
    p.kase = kase;
    p.tree = tree;
    p.octree = o;
    p.rays = &rays;
    p.with = WITH_THESIS_SCALAR | WITH_LOD | WITH_NO_BEAM;
    run_paths(&p);
    if (strcmp(kase, "dragon-4096") == 0) {
        table_isa("dragon-4096-ratio", p.ratio, 1.0, 2);
        table_isa("dragon-4096-lod", p.ratio_lod, 1.0, 2);
    }
    voxrt_octree_destroy(o);
    free_rayset(&rays);
}

/* Rates of others on the same rays, M rays/s/core: VoxelRT at 512 and 1024, a port of ESVO at 2048. */
static const double g_peers[2][3][3] = {
    {{18.7, 11.7, 3.04}, {10.5, 6.8, 1.77}, {7.1, 3.9, 0.98}},
    {{14.4, 10.7, 2.05}, {10.7, 7.4, 1.66}, {5.3, 3.4, 0.88}}
};

static void paths_peer_scene(int id, int at) {
    static const char *const kinds[3] = {"primary", "diffuse", "random"};
    const uint32_t resolution = 512u << at;
    const voxrt_tree *tree = get_tree(id, resolution, KIND_PEER);
    voxrt_octree *o = make_octree(tree);
    rayset first = peer_rays(g_models[id].name), rays[3];
    int k, grid = best_grid(o, &first);
    memset(rays, 0, sizeof rays);
    for (k = 0; k < 3; k++) {
        char kase[64];
        paths p;
        if (!g_opt.full && k > 0 && (id == MODEL_HALL || (k == 2 && at < 2))) continue;
        if (k == 1) rays[1] = second_rays(tree, &first, SECOND_COSINE, 0.0f);
        if (k == 2) rays[2] = chord_rays(tree, g_opt.full ? first.count : first.count / 4);
        snprintf(kase, sizeof kase, "%s-%u-%s", g_models[id].name, resolution, kinds[k]);
        memset(&p, 0, sizeof p);
        p.bench = "voxrt.peer_scenes";
        p.kase = kase;
        p.tree = tree;
        p.octree = o;
        p.rays = k == 0 ? &first : &rays[k];
        p.grid = k > 0 && g_opt.full ? best_grid(o, p.rays) : grid;
        p.with = (k == 0 ? WITH_LOD : 0) | (k == 1 ? WITH_OCCLUDED : 0);
        p.peer = at == 2 ? "ESVO port" : "VoxelRT";
        p.peer_value = 1e6 * g_peers[id][k][at];
        run_paths(&p);
        table_isa(kase, p.rate, 1e-6, 1);
    }
    for (k = 1; k < 3; k++) free_rayset(&rays[k]);
    free_rayset(&first);
    voxrt_octree_destroy(o);
}

static int fill_oracle(void *user, const voxrt_voxel *v, uint32_t index) {
    (void)index;
    oracle_set((oracle_grid *)user, (int32_t)v->x, (int32_t)v->y, (int32_t)v->z);
    return 0;
}

static int fill_voxels(void *user, const voxrt_voxel *v, uint32_t index) {
    voxrt_voxel **at = (voxrt_voxel **)user;
    (void)index;
    *(*at)++ = *v;
    return 0;
}

/* Rays in grid units, so that the exact stepper and the tracers start from the same numbers. */
static rayset rays_in_grid(const rayset *s, const voxrt_tree_info *info, size_t every) {
    rayset out = make_rayset(s->count / every);
    size_t i;
    int a;
    for (i = 0; i < out.count; i++) {
        const voxrt_ray *r = &s->ray[i * every];
        out.ray[i] = *r;
        for (a = 0; a < 3; a++) {
            out.ray[i].org[a] = (float)(((double)r->org[a] - info->world_origin[a]) / info->voxel_size);
        }
    }
    order_quads(&out, 0);
    return out;
}

/* Rays whose hit, miss or cell is wrong; *late: right cell, but not its time to the last bit or not its face. */
static size_t judge_hits(const oracle_grid *g, const rayset *s, const voxrt_hit *hit, size_t *late) {
    size_t i, wrong = 0;
    *late = 0;
    int a;
    for (i = 0; i < s->count; i++) {
        oracle_ray r;
        oracle_hit said, first;
        const char *why;
        memset(&said, 0, sizeof said);
        for (a = 0; a < 3; a++) {
            r.o[a] = (double)s->ray[i].org[a];
            r.d[a] = (double)s->ray[i].dir[a];
            said.cell[a] = (int32_t)hit[i].cell[a];
        }
        r.t_min = (double)s->ray[i].t_min;
        r.t_max = (double)s->ray[i].t_max;
        said.hit = hit[i].node != VOXRT_NO_NODE;
        said.t = (double)hit[i].t;
        said.face = hit[i].face;
        why = oracle_judge(g, &r, &said, &first);
        if (why == NULL) continue;
        if (strncmp(why, "t is", 4) == 0 || strncmp(why, "not the face", 12) == 0) ++*late;
        else wrong++;
    }
    return wrong;
}

/* The filled cells again, as bits for the exact stepper and as trees in which a cell is a unit cube. */
typedef struct exact_grid {
    oracle_grid g;
    voxrt_tree *tree;
    voxrt_octree *octree;
} exact_grid;

static void open_exact(exact_grid *e, const voxrt_tree *tree) {
    const int32_t lo[3] = {0, 0, 0};
    int32_t n[3];
    voxrt_build_desc bd;
    voxrt_octree_desc od;
    voxrt_tree_info info;
    voxrt_voxel *voxels, *end;
    voxrt_tree_get_info(tree, &info);
    n[0] = n[1] = n[2] = (int32_t)(1u << info.depth);
    voxels = end = (voxrt_voxel *)must_alloc(info.voxel_count, sizeof *voxels);
    (void)voxrt_tree_each(tree, info.depth, fill_voxels, &end);
    memset(&bd, 0, sizeof bd);
    bd.disable_colors = bd.disable_normals = 1;
    must(voxrt_tree_from_voxels(&bd, voxels, info.voxel_count, info.depth, &e->tree), "voxels");
    free(voxels);
    if (!oracle_grid_make(&e->g, lo, n)) run_failed("oracle", "not enough memory");
    (void)voxrt_tree_each(e->tree, info.depth, fill_oracle, &e->g);
    memset(&od, 0, sizeof od);
    od.disable_collapse = 1; /* so that its cells are those of the grid */
    must(voxrt_octree_from_tree(&od, e->tree, &e->octree), "octree");
}

static void close_exact(exact_grid *e) {
    free(e->g.bits);
    voxrt_octree_destroy(e->octree);
    voxrt_tree_destroy(e->tree);
}

/* Trace and judge; returns what is wrong with the tree's hits. */
static size_t exact_line(const exact_grid *e, const char *kase, const rayset *s, int octree) {
    trace_job t;
    size_t wrong, late;
    memset(&t, 0, sizeof t);
    t.tree = e->tree;
    t.octree = octree ? e->octree : NULL;
    t.rays = s;
    t.hit = (voxrt_hit *)must_alloc(s->count, sizeof *t.hit);
    run_trace(&t);
    wrong = judge_hits(&e->g, s, t.hit, &late);
    bench_line("voxrt.exact", kase, "wrong_rays", (double)wrong, "rays");
    bench_num("rays", (double)s->count);
    bench_num("hits", (double)count_hits(t.hit, s->count));
    bench_num("inexact_t_or_face", (double)late);
    bench_text("method", octree ? "thesis packets" : "tree");
    bench_hash(hash_hits(t.hit, s->count));
    bench_end();
    free(t.hit);
    return wrong + late;
}

static void exactness(int id, size_t every, size_t *total, size_t *judged) {
    static const char *const kinds[3] = {"primary", "diffuse", "random"};
    const voxrt_tree *tree = get_tree(id, 512, KIND_PEER);
    voxrt_tree_info info;
    exact_grid e;
    rayset first = peer_rays(g_models[id].name), sets[3];
    int k;
    voxrt_tree_get_info(tree, &info);
    open_exact(&e, tree);
    sets[0] = first;
    sets[1] = second_rays(tree, &first, SECOND_COSINE, 0.0f);
    sets[2] = chord_rays(tree, first.count);
    for (k = 0; k < 3; k++) {
        rayset s = rays_in_grid(&sets[k], &info, every);
        char kase[64];
        snprintf(kase, sizeof kase, "%s-512-%s", g_models[id].name, kinds[k]);
        *total += exact_line(&e, kase, &s, 0);
        *judged += s.count;
        (void)exact_line(&e, kase, &s, 1);
        free_rayset(&s);
        free_rayset(&sets[k]);
    }
    close_exact(&e);
}

/* Rays that are hard by their numbers, in batches, against a thin shell and against noise. */
static void adversarial(size_t count) {
    enum { SIZE = 64, BATCH = 250000 };
    size_t wrong = 0, done[2] = {0, 0};
    int k;
    for (k = 0; k < 2; k++) {
        voxrt_build_desc bd;
        voxrt_tree *tree;
        exact_grid e;
        uint64_t batch = 0;
        memset(&bd, 0, sizeof bd);
        bd.disable_normals = 1;
        if (k == 0) {
            const model *m = get_model(MODEL_BLOB);
            voxrt_mesh mesh = sup_voxel_mesh(&m->mesh);
            bd.resolution = SIZE;
            must(voxrt_tree_build(&bd, &mesh, NULL, &tree), "build");
        } else {
            voxrt_voxel *v = (voxrt_voxel *)must_alloc(6000, sizeof *v);
            bench_rng rng = {5};
            size_t i;
            for (i = 0; i < 6000; i++) {
                v[i].x = bench_random_u32(&rng) % SIZE;
                v[i].y = bench_random_u32(&rng) % SIZE;
                v[i].z = bench_random_u32(&rng) % SIZE;
            }
            must(voxrt_tree_from_voxels(&bd, v, 6000, 6, &tree), "voxels");
            free(v);
        }
        open_exact(&e, tree);
        voxrt_tree_destroy(tree);
        while (done[k] < count / 2) {
            const size_t n = count / 2 - done[k] < BATCH ? count / 2 - done[k] : BATCH;
            rayset s = adversarial_rays(SIZE, n, 1000 * (uint64_t)k + ++batch);
            wrong += exact_line(&e, k == 0 ? "adversarial-shell" : "adversarial-noise", &s, 0);
            done[k] += n;
            free_rayset(&s);
        }
        close_exact(&e);
    }
    table_set("adversarial", "%lu of %lu", (unsigned long)wrong, (unsigned long)(done[0] + done[1]));
}

/* Nothing gets out of a closed body: towards all vertices and edge midpoints of its mesh, and anywhere. */
static void leaks(size_t count) {
    enum { BATCH = 1 << 20 };
    static const char *const kinds[3] = {"vertices", "edge midpoints", "random"};
    const model *m = get_model(MODEL_BLOB);
    const size_t corners = 3 * m->mesh.triangle_count;
    voxrt_mesh mesh = sup_voxel_mesh(&m->mesh);
    voxrt_build_desc bd;
    voxrt_tree *tree;
    float *middle = (float *)must_alloc(corners, 12);
    size_t edges = 0, i, leaked = 0, all = 0;
    int k, a;
    memset(&bd, 0, sizeof bd);
    bd.env.thread_count = (uint32_t)g_opt.threads;
    bd.resolution = 1024;
    bd.disable_normals = bd.disable_colors = 1;
    must(voxrt_tree_build(&bd, &mesh, NULL, &tree), "build");
    for (i = 0; i < corners; i++) { /* of a closed mesh each edge is there twice */
        const uint32_t p = m->mesh.indices[i], q = m->mesh.indices[i % 3 == 2 ? i - 2 : i + 1];
        if (p > q) continue;
        for (a = 0; a < 3; a++) {
            middle[3 * edges + (size_t)a] = 0.5f * (m->mesh.positions[3 * (size_t)p + (size_t)a] +
                                                    m->mesh.positions[3 * (size_t)q + (size_t)a]);
        }
        edges++;
    }
    for (k = 0; k < 3; k++) {
        const float *at = k == 0 ? m->mesh.positions : k == 1 ? middle : NULL;
        const size_t total = k == 0 ? m->mesh.vertex_count : k == 1 ? edges : count;
        size_t done = 0, out = 0;
        double seconds = 0.0;
        while (done < total) {
            const size_t n = total - done < BATCH ? total - done : BATCH;
            rayset s = inner_rays(at != NULL ? at + 3 * done : NULL, n, 7 + done);
            trace_job t;
            double start;
            memset(&t, 0, sizeof t);
            t.tree = tree;
            t.rays = &s;
            t.hit = (voxrt_hit *)must_alloc(n, sizeof *t.hit);
            start = bench_cpu();
            run_trace(&t);
            seconds += bench_cpu() - start;
            out += n - count_hits(t.hit, n);
            done += n;
            free(t.hit);
            free_rayset(&s);
        }
        bench_line("voxrt.leaks", "blob-1024", "escaped_rays", (double)out, "rays");
        bench_num("rays", (double)total);
        bench_num("rays_per_second", (double)total / seconds);
        bench_text("method", kinds[k]);
        bench_end();
        leaked += out;
        all += total;
    }
    table_set("leaks", "%lu of %lu", (unsigned long)leaked, (unsigned long)all);
    free(middle);
    voxrt_tree_destroy(tree);
}

static void bm1(void) {
    static const int order[3] = {MODEL_DRAGON, MODEL_BLOB, MODEL_BUNNY};
    size_t wrong = 0, judged = 0;
    int i, at;
    uint32_t r;
    for (i = 0; i < (g_opt.full ? 3 : 2); i++) {
        const uint32_t last = g_opt.full ? 8192u : order[i] == MODEL_DRAGON ? 4096u : 2048u;
        for (r = 1024; r <= last; r *= 2) {
            if (!g_opt.full && i == 1 && r == 1024) continue;
            paths_default_view(order[i], r);
            if (r > 2048) drop_trees();
        }
    }
    drop_trees();
    for (at = 0; at < 3; at++) {
        for (i = MODEL_BLOB; i <= MODEL_HALL; i++) paths_peer_scene(i, at);
        if (at == 0) for (i = MODEL_BLOB; i <= MODEL_HALL; i++) exactness(i, g_opt.full ? 1 : 16, &wrong, &judged);
        drop_trees();
    }
    table_set("wrong", "%lu of %lu", (unsigned long)wrong, (unsigned long)judged);
    adversarial(g_opt.full ? 10000000 : 200000);
    leaks(g_opt.full ? 100000000 : 2000000);
}

/* ---- whole pictures ---- */

typedef struct frame_job {
    const voxrt_tree *tree;
    voxrt_render_desc desc;
    voxrt_image image;
} frame_job;

static void run_frame(void *ctx) {
    frame_job *f = (frame_job *)ctx;
    must(voxrt_render(&f->desc, f->tree, &f->image, NULL), "render");
}

static frame_job make_frame(const voxrt_tree *tree) {
    frame_job f;
    memset(&f, 0, sizeof f);
    f.tree = tree;
    f.desc.env.thread_count = 1;
    frame_camera(tree, WIDTH, HEIGHT, &f.desc.camera);
    f.image.width = WIDTH;
    f.image.height = HEIGHT;
    f.image.rgba8 = (uint8_t *)must_alloc((size_t)WIDTH * HEIGHT, 4);
    return f;
}

/* Pixels that differ from those of the scalar path. */
static size_t frame_differs(const frame_job *f) {
    frame_job s = *f;
    const size_t n = (size_t)WIDTH * HEIGHT;
    size_t i, differ = 0;
    s.desc.isa = VOXRT_ISA_SCALAR;
    s.image.rgba8 = (uint8_t *)must_alloc(n, 4);
    run_frame(&s);
    for (i = 0; i < n; i++) differ += memcmp(s.image.rgba8 + 4 * i, f->image.rgba8 + 4 * i, 4) != 0;
    free(s.image.rgba8);
    return differ;
}

static void frame_line(const char *bench, const char *kase, const frame_job *f, const bench_job *b) {
    bench_line(bench, kase, "frame_time", 1e3 * bench_seconds(b), "ms");
    bench_num("best", 1e3 * bench_seconds_best(b));
    bench_num("wall", 1e3 * bench_median(b->wall, b->rounds));
    bench_num("error", (double)frame_differs(f));
    bench_text("error_unit", "pixels");
    bench_text("method", b->name);
    bench_num("threads", f->desc.env.thread_count);
    bench_hash(bench_hash_bytes(f->image.rgba8, (size_t)4 * WIDTH * HEIGHT));
}

/* BM2: small resolutions are levels of the first tree; from 1024 on each has a tree of its own. */
static void bm2(void) {
    const uint32_t last = g_opt.full ? 8192u : 4096u;
    const int id = get_model(MODEL_DRAGON) != NULL ? MODEL_DRAGON : MODEL_BLOB;
    frame_job f[32];
    bench_job b[32];
    double most[2] = {-1.0, -1.0}, mean[2] = {0.0, 0.0}, count[BENCH_COUNTERS];
    int n = 0, i, k;
    uint32_t r;
    memset(b, 0, sizeof b);
    for (r = 1; r <= last; r *= 2) {
        const voxrt_tree *tree = get_tree(id, r < 1024 ? 1024 : r, KIND_DEFAULT);
        for (k = 0; k < 2; k++, n++) {
            uint32_t level = 0;
            while (1u << level < r) level++;
            f[n] = make_frame(tree);
            f[n].desc.tolerance = k == 1 ? 1.0f : 0.0f;
            if (r < 1024) f[n].desc.max_level_plus_1 = level + 1;
            b[n].name = k == 1 ? "1 px" : "full detail";
            b[n].run = run_frame;
            b[n].ctx = &f[n];
        }
    }
    bench_interleave(b, n, g_opt.full ? 11 : 7);
    for (r = 1, i = 0; i < n; i += 2, r *= 2) {
        for (k = 0; k < 2; k++) {
            char kase[64];
            snprintf(kase, sizeof kase, "%s-%u", g_models[id].name, r);
            frame_line("voxrt.resolution", kase, &f[i + k], &b[i + k]);
            bench_num("ns_per_ray", 1e9 * bench_seconds(&b[i + k]) / ((double)WIDTH * HEIGHT));
            bench_count(run_frame, &f[i + k], count);
            if (count[BENCH_CYCLES] >= 0.0) bench_num("cycles_per_ray", count[BENCH_CYCLES] / ((double)WIDTH * HEIGHT));
            if (count[BENCH_CACHE_MISSES] >= 0.0) {
                bench_num("cache_misses_per_ray", count[BENCH_CACHE_MISSES] / ((double)WIDTH * HEIGHT));
            }
            if (r > 1024) {
                const double growth = 1.0 / bench_ratio(&b[i + k - 2], &b[i + k]) - 1.0;
                bench_num("growth", growth);
                if (growth > most[k]) most[k] = growth;
                mean[k] = pow(1.0 / bench_ratio(&b[20 + k], &b[i + k]), 2.0 / (i - 20)) - 1.0; /* job 20: 2^10 */
            }
            bench_end();
        }
    }
    if (strcmp(g_models[id].name, "dragon") == 0) {
        table_set("growth", "%+.1f %% (%+.1f %%)", 100.0 * mean[0], 100.0 * most[0]);
        table_set("growth-lod", "%+.1f %% (%+.1f %%)", 100.0 * mean[1], 100.0 * most[1]);
    }
    for (i = 0; i < n; i++) free(f[i].image.rgba8);
    drop_trees();
}

/* The whole picture by 1, 2, ... all cores. */
static void frame_threads(const voxrt_tree *tree, const char *kase) {
    const long cores = sysconf(_SC_NPROCESSORS_ONLN);
    double one = 0.0;
    uint32_t n;
    for (n = 1; n <= 64 && (long)n <= cores; n++) {
        frame_job f = make_frame(tree);
        bench_job b;
        char name[32];
        memset(&b, 0, sizeof b);
        snprintf(name, sizeof name, "%u threads", n);
        f.desc.env.thread_count = n;
        b.name = name;
        b.run = run_frame;
        b.ctx = &f;
        bench_interleave(&b, 1, ROUNDS);
        if (n == 1) one = bench_median(b.wall, b.rounds);
        bench_line("voxrt.threads", kase, "frames_per_second", 1.0 / bench_median(b.wall, b.rounds), "1/s");
        bench_num("best", 1.0 / bench_least(b.wall, b.rounds));
        bench_num("speedup", one / bench_median(b.wall, b.rounds));
        bench_num("error", (double)frame_differs(&f));
        bench_text("error_unit", "pixels");
        bench_num("threads", n);
        bench_hash(bench_hash_bytes(f.image.rgba8, (size_t)4 * WIDTH * HEIGHT));
        bench_end();
        free(f.image.rgba8);
    }
}

/* BM3 and BM10: what each stage adds to a frame, and the parts alone. */
static void bm3(void) {
    static const struct { const char *name; int stage, no_compose, face_normals, threads; } stages[7] = {
        {"rays", VOXRT_STAGE_RAYS, 1, 0, 1}, {"rays, setup", VOXRT_STAGE_SETUP, 1, 0, 1},
        {"rays, setup, trace", VOXRT_STAGE_TRACE, 1, 0, 1},
        {"all but compose, face normals", VOXRT_STAGE_FULL, 1, 1, 1},
        {"all but compose", VOXRT_STAGE_FULL, 1, 0, 1}, {"all", VOXRT_STAGE_FULL, 0, 0, 1},
        {"all, threads", VOXRT_STAGE_FULL, 0, 0, 0}
    };
    static const int ids[2] = {MODEL_DRAGON, MODEL_BLOB};
    int m, i;
    for (m = 0; m < 2; m++) {
        const voxrt_tree *tree = get_tree(ids[m], 1024, KIND_DEFAULT);
        frame_job f[7];
        bench_job b[7];
        double full;
        char kase[64];
        if (tree == NULL) continue;
        memset(b, 0, sizeof b);
        snprintf(kase, sizeof kase, "%s-1024", g_models[ids[m]].name);
        for (i = 0; i < 7; i++) {
            f[i] = make_frame(tree);
            f[i].desc.stage = (voxrt_stage)stages[i].stage;
            f[i].desc.no_compose = (uint32_t)stages[i].no_compose;
            f[i].desc.face_normals = (uint32_t)stages[i].face_normals;
            f[i].desc.env.thread_count = stages[i].threads == 1 ? 1u : (uint32_t)g_opt.threads;
            b[i].name = stages[i].name;
            b[i].run = run_frame;
            b[i].ctx = &f[i];
        }
        bench_interleave(b, 7, 11);
        full = bench_seconds(&b[5]);
        for (i = 0; i < 7; i++) {
            frame_line("voxrt.stages", kase, &f[i], &b[i]);
            bench_num("share", bench_seconds(&b[i]) / full);
            bench_end();
        }
        bench_line("voxrt.stages", kase, "ray_setup_share", (bench_seconds(&b[1]) - bench_seconds(&b[0])) / full, "");
        bench_end();
        bench_line("voxrt.stages", kase, "normal_decode_share",
                   (bench_seconds(&b[4]) - bench_seconds(&b[3])) / full, "");
        bench_end();
        bench_line("voxrt.stages", kase, "compose_share", (full - bench_seconds(&b[4])) / full, "");
        bench_end();
        for (i = 0; i < 7; i++) free(f[i].image.rgba8);
        frame_threads(tree, kase);
    }
}

/* BM4 */
static void bm4(void) {
    const int id = get_model(MODEL_DRAGON) != NULL ? MODEL_DRAGON : MODEL_BLOB;
    const voxrt_tree *tree = get_tree(id, 1024, KIND_DEFAULT);
    voxrt_octree *o = make_octree(tree);
    rayset rays = camera_rays(tree, WIDTH, HEIGHT);
    voxrt_hit *exact = (voxrt_hit *)must_alloc(rays.count, sizeof *exact);
    uint32_t g;
    char kase[64];
    must(voxrt_trace(tree, NULL, rays.ray, exact, rays.count), "trace");
    snprintf(kase, sizeof kase, "%s-1024", g_models[id].name);
    for (g = 0; g <= 9; g++) {
        voxrt_octree_stats stats;
        voxrt_octree_info info;
        trace_job t;
        bench_job b;
        char name[32];
        must(voxrt_octree_build_grid(o, g), "grid");
        voxrt_octree_get_info(o, &info);
        memset(&t, 0, sizeof t);
        memset(&b, 0, sizeof b);
        memset(&stats, 0, sizeof stats);
        t.octree = o;
        t.rays = &rays;
        t.isa = VOXRT_ISA_SSE;
        t.hit = (voxrt_hit *)must_alloc(rays.count, sizeof(voxrt_hit));
        b.run = run_trace;
        b.ctx = &t;
        bench_interleave(&b, 1, ROUNDS);
        t.octree_stats = &stats;
        run_trace(&t);
        unorder(&rays, t.hit);
        if (g == 0) snprintf(name, sizeof name, "no grid");
        else snprintf(name, sizeof name, "%u an axis", 1u << (g - 1));
        bench_line("voxrt.start_grid", kase, "rays_per_second", bench_rate(&b, (double)rays.count), "1/s");
        bench_num("best", bench_rate_best(&b, (double)rays.count));
        bench_num("error", (double)count_wrong(exact, t.hit, rays.count));
        bench_text("error_unit", "rays");
        bench_text("method", name);
        bench_text("isa", "sse");
        bench_num("threads", 1);
        bench_num("bytes", (double)info.grid_bytes);
        bench_num("outer_per_ray", (double)stats.outer / (double)rays.count);
        bench_num("inner_per_ray", (double)stats.inner / (double)rays.count);
        bench_hash(hash_hits(t.hit, rays.count));
        bench_end();
        free(t.hit);
    }
    free(exact);
    free_rayset(&rays);
    voxrt_octree_destroy(o);
}

/* ---- BM5: memory ---- */

static void size_line(const char *kase, const char *method, double bytes, const voxrt_tree_info *info) {
    bench_line("voxrt.bytes", kase, "bits_per_leaf", 8.0 * bytes / (double)info->voxel_count, "bit");
    bench_text("method", method);
    bench_num("bytes", bytes);
    bench_end();
}

static size_t file_bytes(const voxrt_tree *tree, voxrt_encoding encoding) {
    voxrt_save_desc d;
    size_t size = 0;
    memset(&d, 0, sizeof d);
    d.env.thread_count = (uint32_t)g_opt.threads;
    d.encoding = encoding;
    must(voxrt_tree_save_memory(tree, &d, NULL, 0, &size), "save");
    return size;
}

/* `materials` bands of colour by height: few colours in large areas, as models have them. */
static uint8_t *banded(const sup_mesh *m, unsigned materials) {
    uint8_t *rgb = (uint8_t *)must_alloc(m->triangle_count, 3);
    float lo[3], hi[3];
    size_t t;
    (void)sup_mesh_bounds(m, lo, hi);
    for (t = 0; t < m->triangle_count; t++) {
        const float y = m->positions[3 * (size_t)m->indices[3 * t] + 1];
        const unsigned k = (unsigned)((float)materials * 0.999f * (y - lo[1]) / (hi[1] - lo[1]));
        rgb[3 * t] = (uint8_t)(40 + k * 53 % 200);
        rgb[3 * t + 1] = (uint8_t)(30 + k * 91 % 200);
        rgb[3 * t + 2] = (uint8_t)(20 + k * 17 % 200);
    }
    return rgb;
}

/* Smooth colours that differ from vertex to vertex: the hard case for palette and blocks. */
static uint8_t *smooth_rgb(const sup_mesh *m) {
    uint8_t *rgb = (uint8_t *)must_alloc(m->vertex_count, 3);
    size_t i;
    for (i = 0; i < m->vertex_count; i++) {
        const float *p = m->positions + 3 * i;
        int a;
        for (a = 0; a < 3; a++) {
            const float v = 0.5f + 0.5f * supi_fbm(5.0f * p[0] + (float)(9 * a), 5.0f * p[1], 5.0f * p[2], 4);
            rgb[3 * i + (size_t)a] = (uint8_t)(255.0f * (v < 0.0f ? 0.0f : v > 1.0f ? 1.0f : v));
        }
    }
    return rgb;
}

static voxrt_tree *shared_tree(const voxrt_tree *tree) {
    voxrt_env env;
    voxrt_tree *out = NULL;
    memset(&env, 0, sizeof env);
    env.thread_count = (uint32_t)g_opt.threads;
    must(voxrt_tree_share(tree, &env, &out), "share");
    return out;
}

static void bytes_of_model(int id, uint32_t resolution) {
    const voxrt_tree *tree = get_tree(id, resolution, KIND_DEFAULT);
    voxrt_tree_info info, plain_info;
    voxrt_octree_info oi;
    voxrt_octree *o;
    voxrt_build_desc bd;
    voxrt_tree *plain, *coloured;
    voxrt_mesh mesh;
    char kase[64];
    size_t v4 = 0;
    uint32_t l;
    uint8_t *rgb;
    if (tree == NULL) return;
    snprintf(kase, sizeof kase, "%s-%u", g_models[id].name, resolution);
    voxrt_tree_get_info(tree, &info);
    for (l = 1; l <= info.depth; l++) {
        bench_line("voxrt.counts", kase, "cells", (double)info.level_count[l], "");
        bench_num("level", l);
        bench_num("growth", (double)info.level_count[l] / (double)info.level_count[l - 1]);
        bench_end();
    }
    o = make_octree(tree);
    voxrt_octree_get_info(o, &oi);
    size_line(kase, "octree (T8)", (double)oi.voxel_bytes, &info);
    must(voxrt_octree_save_memory(o, NULL, NULL, 0, &v4), "save v4");
    size_line(kase, "file, version 4", (double)v4, &info);
    voxrt_octree_destroy(o);
    size_line(kase, "tree (T64), geometry", (double)info.geometry_bytes, &info);
    size_line(kase, "tree (T64), normals, one colour", (double)info.total_bytes, &info);
    size_line(kase, "file, compact, normals", (double)file_bytes(tree, VOXRT_ENCODING_COMPACT), &info);
    size_line(kase, "file, raw, normals", (double)file_bytes(tree, VOXRT_ENCODING_RAW), &info);
    size_line(kase, "uniform grid, 4 bytes a cell", 4.0 * pow((double)(1u << info.depth), 3.0), &info);
    mesh = sup_voxel_mesh(&get_model(id)->mesh);
    memset(&bd, 0, sizeof bd);
    bd.env.thread_count = (uint32_t)g_opt.threads;
    bd.resolution = resolution;
    bd.disable_colors = bd.disable_normals = 1;
    must(voxrt_tree_build(&bd, &mesh, NULL, &plain), "build");
    voxrt_tree_get_info(plain, &plain_info);
    v4 = file_bytes(plain, VOXRT_ENCODING_COMPACT);
    size_line(kase, "file, compact, geometry", (double)v4, &plain_info);
    voxrt_tree_destroy(plain);
    bd.disable_colors = bd.disable_normals = 0;
    rgb = id == MODEL_BLOB ? smooth_rgb(&get_model(id)->mesh) : banded(&get_model(id)->mesh, 24);
    if (id == MODEL_BLOB) mesh.vertex_rgb = rgb;
    else mesh.triangle_rgb = rgb;
    must(voxrt_tree_build(&bd, &mesh, NULL, &coloured), "build");
    free(rgb);
    voxrt_tree_get_info(coloured, &info);
    size_line(kase, id == MODEL_BLOB ? "tree, smooth colours, normals" : "tree, 24 colours, normals",
        (double)info.total_bytes, &info);
    size_line(kase, id == MODEL_BLOB ? "file, compact, smooth colours, normals" : "file, compact, 24 colours, normals",
        (double)file_bytes(coloured, VOXRT_ENCODING_COMPACT), &info);
    plain = shared_tree(coloured);
    voxrt_tree_get_info(plain, &plain_info);
    size_line(kase, id == MODEL_BLOB ? "shared tree, smooth colours, normals" : "shared tree, 24 colours, normals",
        (double)plain_info.total_bytes, &plain_info);
    voxrt_tree_destroy(plain);
    voxrt_tree_destroy(coloured);
    if (id == MODEL_BLOB) {
        table_set("shared-smooth", "%.0f", (double)plain_info.total_bytes / (double)info.voxel_count * 50e6 / 1048576.0);
        table_set("attributes-smooth", "%.0f", (double)info.total_bytes / (double)info.voxel_count * 50e6 / 1048576.0);
    } else if (strcmp(g_models[id].name, "dragon") == 0) {
        const double leaves = (double)info.voxel_count;
        table_set("geometry-bits", "%.2f", 8.0 * (double)info.geometry_bytes / leaves);
        table_set("file-bits", "%.2f", 8.0 * (double)v4 / leaves);
        table_set("attributes", "%.0f", (double)info.total_bytes / leaves * 50e6 / 1048576.0);
    }
}

/* The voxels that the peers' bytes are quoted for. */
static void bytes_of_peer_voxels(void) {
    const model *m = get_model(MODEL_BLOB);
    voxrt_mesh mesh = sup_voxel_mesh(&m->mesh);
    voxrt_build_desc d;
    voxrt_tree_info info;
    voxrt_tree *tree;
    double file;
    memset(&d, 0, sizeof d);
    d.env.thread_count = (uint32_t)g_opt.threads;
    d.resolution = 1024;
    d.separating = VOXRT_SEPARATING_26;
    d.disable_colors = d.disable_normals = 1;
    peer_box(&m->mesh, &d);
    must(voxrt_tree_build(&d, &mesh, NULL, &tree), "build");
    voxrt_tree_get_info(tree, &info);
    file = (double)file_bytes(tree, VOXRT_ENCODING_COMPACT);
    size_line("blob-1024-26-separating", "tree (T64), geometry", (double)info.geometry_bytes, &info);
    size_line("blob-1024-26-separating", "file, compact, geometry", file, &info);
    table_set("geometry-bits-26", "%.2f", 8.0 * (double)info.geometry_bytes / (double)info.voxel_count);
    table_set("file-bits-26", "%.2f", 8.0 * file / (double)info.voxel_count);
    voxrt_tree_destroy(tree);
}

typedef struct share_job {
    const voxrt_tree *tree;
    voxrt_tree *out;
} share_job;

static void run_share(void *ctx) {
    share_job *j = (share_job *)ctx;
    voxrt_env env;
    memset(&env, 0, sizeof env);
    env.thread_count = 1;
    voxrt_tree_destroy(j->out);
    must(voxrt_tree_share(j->tree, &env, &j->out), "share");
}

/* Rays through the plain and the shared tree in turn; 0 of them may differ. */
static double shared_rays(const voxrt_tree *plain, const voxrt_tree *shared, const char *kase, const char *what,
    const rayset *rays) {
    trace_job t[2];
    bench_job b[2];
    double ratio;
    int i;
    memset(t, 0, sizeof t);
    memset(b, 0, sizeof b);
    for (i = 0; i < 2; i++) {
        t[i].tree = i == 0 ? plain : shared;
        t[i].rays = rays;
        t[i].hit = (voxrt_hit *)must_alloc(rays->count, sizeof(voxrt_hit));
        b[i].name = i == 0 ? "tree" : "shared tree";
        b[i].run = run_trace;
        b[i].ctx = &t[i];
    }
    bench_interleave(b, 2, 2 * ROUNDS + 1);
    ratio = bench_ratio(&b[0], &b[1]);
    bench_line("voxrt.shared", kase, "times_plain", ratio, "");
    bench_text("rays", what);
    bench_num("rays_per_s", bench_rate(&b[1], (double)rays->count));
    bench_num("wrong", (double)count_wrong(t[0].hit, t[1].hit, rays->count));
    bench_hash(hash_hits(t[1].hit, rays->count));
    bench_end();
    for (i = 0; i < 2; i++) free(t[i].hit);
    return ratio;
}

/* Equal parts once: what is left, how long it takes, what rays lose or win. */
static void bytes_shared(int regular, double bits[2]) {
    const model *m = regular ? NULL : get_model(MODEL_DRAGON);
    const uint32_t resolution = regular ? (g_opt.full ? 8192 : 4096) : (g_opt.full ? 4096 : 2048);
    sup_mesh made;
    voxrt_mesh mesh;
    voxrt_build_desc d;
    voxrt_tree *plain;
    voxrt_tree_info info, shared;
    share_job job;
    bench_job b;
    rayset camera, other;
    double ratio[3];
    char kase[64];
    memset(&made, 0, sizeof made);
    bits[0] = bits[1] = 0.0;
    if (!regular && m == NULL) return;
    if (regular && sup_scene_make("pillars", 0, &made)) run_failed("pillars", "no mesh");
    mesh = sup_voxel_mesh(regular ? &made : &m->mesh);
    snprintf(kase, sizeof kase, "%s-%u", regular ? "pillars" : m->name, resolution);
    memset(&d, 0, sizeof d);
    d.env.thread_count = (uint32_t)g_opt.threads;
    d.resolution = resolution;
    d.disable_colors = d.disable_normals = 1;
    must(voxrt_tree_build(&d, &mesh, NULL, &plain), "build");
    sup_mesh_free(&made);
    memset(&job, 0, sizeof job);
    memset(&b, 0, sizeof b);
    job.tree = plain;
    b.name = "share";
    b.run = run_share;
    b.ctx = &job;
    bench_interleave(&b, 1, 3);
    voxrt_tree_get_info(plain, &info);
    voxrt_tree_get_info(job.out, &shared);
    size_line(kase, "tree (T64), geometry", (double)info.geometry_bytes, &info);
    size_line(kase, "shared tree, geometry", (double)shared.geometry_bytes, &info);
    bits[0] = 8.0 * (double)shared.geometry_bytes / (double)info.voxel_count;
    bits[1] = (double)file_bytes(job.out, VOXRT_ENCODING_COMPACT);
    size_line(kase, "file, compact, shared, geometry", bits[1], &info);
    bits[1] *= 8.0 / (double)info.voxel_count;
    bench_line("voxrt.shared", kase, "build", bench_seconds(&b), "s");
    bench_num("voxels_per_s", bench_rate(&b, (double)info.voxel_count));
    bench_end();
    camera = camera_rays(plain, WIDTH, HEIGHT);
    ratio[0] = shared_rays(plain, job.out, kase, "camera", &camera);
    other = second_rays(plain, &camera, SECOND_COSINE, 0.0f);
    ratio[1] = shared_rays(plain, job.out, kase, "diffuse", &other);
    free_rayset(&other);
    other = chord_rays(plain, 500000);
    ratio[2] = shared_rays(plain, job.out, kase, "chords", &other);
    free_rayset(&other);
    free_rayset(&camera);
    if (!regular) table_set("shared-rays", "%.2f / %.2f / %.2f", ratio[0], ratio[1], ratio[2]);
    voxrt_tree_destroy(job.out);
    voxrt_tree_destroy(plain);
}

static void bm5(void) {
    double bits[2], regular[2];
    uint32_t r;
    bytes_shared(0, bits);
    bytes_shared(1, regular);
    table_set("shared-bits", "%.2f / %.2f", bits[0], regular[0]);
    table_set("shared-file", "%.2f / %.2f", bits[1], regular[1]);
    bytes_of_peer_voxels();
    for (r = g_opt.full ? 256 : 1024; r <= (g_opt.full ? 4096u : 2048u); r *= 2) {
        bytes_of_model(MODEL_BLOB, g_opt.full ? r : 1024);
        bytes_of_model(MODEL_DRAGON, g_opt.full ? r : 2048);
        drop_trees();
        if (!g_opt.full) break;
    }
}

/* ---- BM6: shadows, occlusion, mirrors ---- */

static void shadows(const voxrt_tree *tree, const char *kase, size_t lights) {
    voxrt_light l[4];
    voxrt_render_stats stats;
    frame_job f = make_frame(tree);
    bench_job b;
    double lo[3], hi[3], rays;
    size_t i;
    int a;
    memset(l, 0, sizeof l);
    memset(&b, 0, sizeof b);
    memset(&stats, 0, sizeof stats);
    voxrt_tree_bounds(tree, lo, hi);
    for (i = 0; i < 4; i++) {
        const double side[4][3] = {{2.0, 3.0, 3.0}, {-2.0, 2.0, 3.0}, {0.5, 4.0, 1.0}, {-1.0, 3.0, -1.0}};
        for (a = 0; a < 3; a++) {
            l[i].position[a] = (float)(0.5 * (lo[a] + hi[a]) + side[i][a] * 0.5 * (hi[0] - lo[0]));
            l[i].color[a] = 0.6f;
        }
    }
    f.desc.lights = l;
    f.desc.light_count = lights;
    f.desc.shadows = 1;
    b.name = lights == 1 ? "1 light" : "4 lights";
    b.run = run_frame;
    b.ctx = &f;
    bench_interleave(&b, 1, ROUNDS);
    must(voxrt_render(&f.desc, tree, &f.image, &stats), "render");
    rays = (double)(stats.primary.rays + stats.shadow.rays);
    frame_line("voxrt.shadows", kase, &f, &b);
    bench_num("rays", rays);
    bench_num("rays_per_second", rays / bench_seconds(&b));
    bench_end();
    free(f.image.rgba8);
}

static void bm6(void) {
    static const int ids[2] = {MODEL_DRAGON, MODEL_BLOB};
    const uint32_t resolution = g_opt.full ? 4096 : 2048;
    int m;
    for (m = 0; m < 2; m++) {
        const voxrt_tree *tree = get_tree(ids[m], resolution, KIND_DEFAULT);
        voxrt_octree *o;
        rayset first, second;
        int k;
        char kase[64];
        if (!g_opt.full && m > 0 && get_model(ids[0]) != NULL) break;
        if (tree == NULL) {
            bench_skip("voxrt.shadows", g_models[ids[m]].name, "no such file");
            continue;
        }
        snprintf(kase, sizeof kase, "%s-%u", g_models[ids[m]].name, resolution);
        shadows(tree, kase, 1);
        shadows(tree, kase, 4);
        first = camera_rays(tree, WIDTH, HEIGHT);
        o = make_octree(tree);
        for (k = 0; k < 3; k++) {
            static const char *const kinds[3] = {"mirror", "occlusion", "random"};
            paths p;
            if (k < 2) second = second_rays(tree, &first, k == 0 ? SECOND_MIRROR : SECOND_COSINE, k == 1 ? 0.1f : 0.0f);
            else second = chord_rays(tree, 200000);
            snprintf(kase, sizeof kase, "%s-%u-%s", g_models[ids[m]].name, resolution, kinds[k]);
            memset(&p, 0, sizeof p);
            p.bench = "voxrt.second_rays";
            p.kase = kase;
            p.tree = tree;
            p.octree = o;
            p.grid = best_grid(o, &second);
            p.rays = &second;
            p.with = WITH_OCCLUDED;
            run_paths(&p);
            free_rayset(&second);
        }
        voxrt_octree_destroy(o);
        free_rayset(&first);
    }
    drop_trees();
}

/* ---- BM7: ways through the octree ---- */

typedef struct walk_job {
    const voxrt_octree *octree;
    const rayset *rays;
    baseline_desc desc;
    baseline_stats stats;
    voxrt_hit *hit;
} walk_job;

static void run_walk(void *ctx) {
    walk_job *w = (walk_job *)ctx;
    memset(&w->stats, 0, sizeof w->stats);
    baseline_octree_trace(w->octree, &w->desc, w->rays->quad, w->hit, w->rays->count, &w->stats);
}

static void bm7(void) {
    static const char *const names[5] = {"restart", "grid, leaf boxes", "grid, cell boxes", "neighbour search", "xor"};
    const int id = get_model(MODEL_DRAGON) != NULL ? MODEL_DRAGON : MODEL_BLOB;
    const voxrt_tree *tree = get_tree(id, 1024, KIND_DEFAULT);
    voxrt_octree *o = make_octree(tree);
    rayset rays = camera_rays(tree, WIDTH, HEIGHT);
    voxrt_hit *exact = (voxrt_hit *)must_alloc(rays.count, sizeof *exact);
    walk_job w[5];
    bench_job b[5];
    char kase[64];
    int i;
    memset(w, 0, sizeof w);
    memset(b, 0, sizeof b);
    must(voxrt_trace(tree, NULL, rays.ray, exact, rays.count), "trace");
    snprintf(kase, sizeof kase, "%s-1024", g_models[id].name);
    for (i = 0; i < 5; i++) {
        w[i].octree = o;
        w[i].rays = &rays;
        w[i].desc.mode = (baseline_mode)i;
        w[i].desc.offset = 1e-3f;
        w[i].hit = (voxrt_hit *)must_alloc(rays.count, sizeof(voxrt_hit));
        b[i].name = names[i];
        b[i].run = run_walk;
        b[i].ctx = &w[i];
    }
    bench_interleave(b, 5, ROUNDS);
    for (i = 0; i < 5; i++) {
        unorder(&rays, w[i].hit);
        bench_line("voxrt.walks", kase, "rays_per_second", bench_rate(&b[i], (double)rays.count), "1/s");
        bench_num("best", bench_rate_best(&b[i], (double)rays.count));
        bench_num("error", (double)count_wrong(exact, w[i].hit, rays.count));
        bench_text("error_unit", "rays");
        bench_text("method", names[i]);
        bench_text("isa", "scalar");
        bench_num("threads", 1);
        bench_num("outer_per_ray", (double)w[i].stats.outer / (double)rays.count);
        bench_num("inner_per_ray", (double)w[i].stats.inner / (double)rays.count);
        bench_num("up_per_ray", (double)w[i].stats.up / (double)rays.count);
        bench_num("stuck", (double)w[i].stats.stuck);
        bench_hash(hash_hits(w[i].hit, rays.count));
        bench_end();
        free(w[i].hit);
    }
    free(exact);
    free_rayset(&rays);
    voxrt_octree_destroy(o);
}

/* ---- BM8: converter ---- */

typedef struct convert_job {
    voxrt_mesh mesh;
    uint32_t resolution, threads;
    int kind, thesis_palette;
    const char *path;             /* file to write, NULL: only build */
    voxrt_build_stats stats;      /* out, of the last run */
    double build, save;           /* out, wall seconds */
    uint64_t hash;
} convert_job;

static void run_convert(void *ctx) {
    convert_job *c = (convert_job *)ctx;
    voxrt_build_desc d;
    voxrt_tree *tree;
    double start = bench_wall();
    memset(&d, 0, sizeof d);
    memset(&c->stats, 0, sizeof c->stats);
    d.env.thread_count = c->threads;
    d.resolution = c->resolution;
    if (c->kind == KIND_PEER) d.separating = VOXRT_SEPARATING_26;
    if (c->thesis_palette) d.palette_method = VOXRT_PALETTE_THESIS;
    must(voxrt_tree_build(&d, &c->mesh, &c->stats, &tree), "build");
    c->build = bench_wall() - start;
    if (c->path != NULL) {
        voxrt_save_desc s;
        memset(&s, 0, sizeof s);
        s.env.thread_count = c->threads;
        start = bench_wall();
        must(voxrt_tree_save_file(tree, &s, c->path), "save");
        c->save = bench_wall() - start;
    }
    if (c->hash == 0) c->hash = voxrt_tree_hash(tree); /* once, in the warm-up */
    voxrt_tree_destroy(tree);
}

static void convert_line(const char *kase, const char *metric, double value, const char *unit, const convert_job *c) {
    bench_line("voxrt.convert", kase, metric, value, unit);
    bench_num("threads", c->threads);
    bench_num("voxels", (double)c->stats.voxels);
    bench_num("fragments", (double)c->stats.fragments);
    bench_num("build_s", c->build);
    bench_num("save_s", c->save);
    bench_num("bytes", (double)c->stats.peak_bytes);
    bench_hash(c->hash);
}

/* Triangles -> file with colours and normals, as the peers do it. */
static void convert_file(void) {
    char path[64];
    sup_mesh mesh;
    sup_error err;
    int i;
    snprintf(path, sizeof path, "/tmp/bench_voxrt_%ld.vox", (long)getpid());
    if (sup_scene_make("blob", 0, &mesh)) run_failed("blob", "cannot be made");
    mesh.vertex_rgb = smooth_rgb(&mesh);
    if (sup_mesh_compute_normals(&mesh, &err)) run_failed("normals", err.text);
    for (i = g_opt.full ? 0 : 2; i < 4; i++) { /* full: one thread too; the peer has 26-separating voxels */
        const char *kase = i % 2 == 0 ? "blob-1024-file" : "blob-1024-file-26-separating";
        convert_job c;
        bench_job b;
        if (!g_opt.full && i == 3) break;
        memset(&c, 0, sizeof c);
        memset(&b, 0, sizeof b);
        c.mesh = sup_voxel_mesh(&mesh);
        c.resolution = 1024;
        c.threads = i < 2 ? 1u : (uint32_t)g_opt.threads;
        c.kind = i % 2 == 0 ? KIND_DEFAULT : KIND_PEER;
        c.path = path;
        b.run = run_convert;
        b.ctx = &c;
        bench_interleave(&b, 1, ROUNDS);
        convert_line(kase, "wall_time", bench_median(b.wall, b.rounds), "s", &c);
        bench_num("best", bench_least(b.wall, b.rounds));
        bench_num("cpu", bench_seconds(&b));
        bench_num("triangles_per_second", (double)mesh.triangle_count / bench_median(b.wall, b.rounds));
        if (i % 2 == 1) {
            bench_text("peer", "ooc_svo_builder");
            bench_num("peer_value", 4.5);
        }
        bench_end();
        if (i == 2) table_set("convert", "%.2f (%.2f)", bench_median(b.wall, b.rounds), bench_seconds(&b));
    }
    (void)remove(path);
    sup_mesh_free(&mesh);
}

/* What colours cost: sums, palette and indices, for 1.8 million different ones and for 32. */
static void convert_colors(void) {
    static const char *const names[4] = {"no colours", "32 colours", "a colour each vertex", "the same, palette of the thesis"};
    sup_mesh mesh;
    bench_job b[4];
    convert_job c[4];
    uint8_t *smooth, *bands;
    const int n = g_opt.full ? 4 : 3;
    int i;
    if (sup_scene_make("blob", g_opt.full ? 0 : 256, &mesh)) run_failed("blob", "cannot be made");
    smooth = smooth_rgb(&mesh);
    bands = banded(&mesh, 32);
    memset(b, 0, sizeof b);
    memset(c, 0, sizeof c);
    for (i = 0; i < n; i++) {
        c[i].mesh = sup_voxel_mesh(&mesh);
        if (i == 1) c[i].mesh.triangle_rgb = bands;
        if (i >= 2) c[i].mesh.vertex_rgb = smooth;
        c[i].thesis_palette = i == 3;
        c[i].resolution = g_opt.full ? 1024 : 512;
        c[i].threads = 1;
        b[i].run = run_convert;
        b[i].ctx = &c[i];
    }
    bench_interleave(b, n, g_opt.full ? ROUNDS : 3);
    for (i = 0; i < n; i++) {
        convert_line(g_opt.full ? "blob-1024-colours" : "blob-512-colours", "build_time", bench_seconds(&b[i]), "s", &c[i]);
        bench_num("best", bench_seconds_best(&b[i]));
        bench_num("colors_in", (double)c[i].stats.colors_in);
        bench_num("colors_time", bench_seconds(&b[i]) - bench_seconds(&b[0]));
        bench_text("method", names[i]);
        bench_end();
    }
    free(smooth);
    free(bands);
    sup_mesh_free(&mesh);
}

static void convert_build(uint32_t resolution, int rounds) {
    const model *m = get_model(MODEL_DRAGON);
    char kase[64];
    int k;
    if (m == NULL) {
        bench_skip("voxrt.convert", "dragon", "no such file");
        return;
    }
    snprintf(kase, sizeof kase, "%s-%u-build", m->name, resolution);
    for (k = g_opt.full ? 0 : 1; k < 2; k++) {
        convert_job c;
        bench_job b;
        double rate;
        memset(&c, 0, sizeof c);
        memset(&b, 0, sizeof b);
        c.mesh = sup_voxel_mesh(&m->mesh);
        c.resolution = resolution;
        c.threads = k == 0 ? 1u : (uint32_t)g_opt.threads;
        b.run = run_convert;
        b.ctx = &c;
        bench_interleave(&b, 1, rounds);
        rate = (double)c.stats.voxels / (k == 0 ? bench_seconds(&b) : bench_median(b.wall, b.rounds));
        convert_line(kase, "voxels_per_second", rate, "1/s", &c);
        bench_num("best", (double)c.stats.voxels / bench_least(k == 0 ? b.cpu : b.wall, b.rounds));
        bench_num("wall", bench_median(b.wall, b.rounds));
        bench_num("cpu", bench_seconds(&b));
        bench_num("bytes_per_voxel", (double)c.stats.peak_bytes / (double)c.stats.voxels);
        bench_end();
        if (k == 1 && resolution == 4096 && strcmp(m->name, "dragon") == 0) {
            table_set("build-4096", "%.1f (%.1f)", 1e-6 * rate, 1e-6 * (double)c.stats.voxels / bench_seconds(&b));
        }
    }
}

static void bm8(void) {
    convert_file();
    if (g_opt.full) {
        convert_build(1024, ROUNDS);
        convert_build(2048, ROUNDS);
    }
    convert_build(4096, ROUNDS);
    convert_colors();
}

/* ---- BM9: loading ---- */

enum { LOAD_COMPACT, LOAD_RAW, LOAD_MAP, LOAD_MAP_TRUST, LOAD_V4 };

typedef struct load_job {
    int how;
    uint32_t threads;
    const void *data;
    size_t size;
    uint64_t hash;                /* out; of the first run */
} load_job;

static uint64_t hash_octree(const voxrt_octree *o) {
    size_t n;
    const voxrt_octree_voxel *v = voxrt_octree_voxels(o, &n);
    return bench_hash_bytes(v, n * sizeof *v);
}

static void run_load(void *ctx) {
    load_job *l = (load_job *)ctx;
    voxrt_tree *tree = NULL;
    if (l->how == LOAD_V4) {
        voxrt_octree_desc d;
        voxrt_octree *o;
        memset(&d, 0, sizeof d);
        d.env.thread_count = l->threads;
        must(voxrt_octree_load_memory(&d, l->data, l->size, &o), "load v4");
        if (l->hash == 0) l->hash = hash_octree(o);
        voxrt_octree_destroy(o);
    } else {
        voxrt_load_desc d;
        memset(&d, 0, sizeof d);
        d.env.thread_count = l->threads;
        d.trust_input = l->how == LOAD_MAP_TRUST;
        if (l->how >= LOAD_MAP) must(voxrt_tree_map_memory(&d, l->data, l->size, &tree), "map");
        else must(voxrt_tree_load_memory(&d, l->data, l->size, &tree), "load");
        if (l->hash == 0) l->hash = voxrt_tree_hash(tree);
        voxrt_tree_destroy(tree);
    }
}

static void *save_aligned(const voxrt_tree *tree, voxrt_encoding encoding, size_t *size) {
    voxrt_save_desc d;
    void *p = NULL;
    *size = file_bytes(tree, encoding);
    if (posix_memalign(&p, 64, *size) != 0) run_failed("memory", "not enough");
    memset(&d, 0, sizeof d);
    d.env.thread_count = (uint32_t)g_opt.threads;
    d.encoding = encoding;
    must(voxrt_tree_save_memory(tree, &d, p, *size, size), "save");
    return p;
}

static void bm9(void) {
    static const char *const names[5] = {"compact", "raw", "raw, mapped", "raw, mapped, trusted", "version 4"};
    const int id = get_model(MODEL_DRAGON) != NULL ? MODEL_DRAGON : MODEL_BLOB;
    const voxrt_tree *tree = get_tree(id, 2048, KIND_DEFAULT);
    voxrt_octree *o = make_octree(tree);
    voxrt_tree_info info;
    void *data[3];
    size_t size[3];
    const uint64_t hash = voxrt_tree_hash(tree), octree_hash = hash_octree(o);
    char kase[64];
    int i, k;
    voxrt_tree_get_info(tree, &info);
    snprintf(kase, sizeof kase, "%s-2048", g_models[id].name);
    data[0] = save_aligned(tree, VOXRT_ENCODING_COMPACT, &size[0]);
    data[1] = save_aligned(tree, VOXRT_ENCODING_RAW, &size[1]);
    must(voxrt_octree_save_memory(o, NULL, NULL, 0, &size[2]), "save v4");
    data[2] = must_alloc(size[2], 1);
    must(voxrt_octree_save_memory(o, NULL, data[2], size[2], &size[2]), "save v4");
    voxrt_octree_destroy(o);
    for (i = 0; i < 5; i++) {
        const int at = i == LOAD_COMPACT ? 0 : i == LOAD_V4 ? 2 : 1;
        double rate1 = 0.0;
        for (k = 0; k < 2; k++) {
            load_job l;
            bench_job b;
            double s;
            memset(&l, 0, sizeof l);
            memset(&b, 0, sizeof b);
            l.how = i;
            l.threads = k == 0 ? 1u : (uint32_t)g_opt.threads;
            l.data = data[at];
            l.size = size[at];
            b.run = run_load;
            b.ctx = &l;
            bench_interleave(&b, 1, ROUNDS);
            s = k == 0 ? bench_seconds(&b) : bench_median(b.wall, b.rounds);
            if (i == LOAD_MAP_TRUST) { /* does not depend on the size: not a rate */
                bench_line("voxrt.load", kase, "map_time", 1e6 * s, "us");
                bench_num("best", 1e6 * bench_least(k == 0 ? b.cpu : b.wall, b.rounds));
            } else {
                bench_line("voxrt.load", kase, "voxels_per_second", (double)info.voxel_count / s, "1/s");
                bench_num("best", (double)info.voxel_count / bench_least(k == 0 ? b.cpu : b.wall, b.rounds));
            }
            if (k == 0) rate1 = 1e-6 * (double)info.voxel_count / s;
            bench_num("error", (double)(l.hash != (i == LOAD_V4 ? octree_hash : hash)));
            bench_text("error_unit", "trees");
            bench_text("method", names[i]);
            bench_num("threads", l.threads);
            bench_num("seconds_per_10m_voxels", s * 1e7 / (double)info.voxel_count);
            bench_num("wall", bench_median(b.wall, b.rounds));
            bench_num("bytes", (double)l.size);
            bench_hash(l.hash);
            bench_end();
            if (k == 1 && i <= LOAD_RAW) {
                table_set(i == LOAD_RAW ? "load-raw" : "load-compact", "%.1f (%.1f)",
                          1e-6 * (double)info.voxel_count / s, rate1);
            }
        }
    }
    for (i = 0; i < 3; i++) free(data[i]);
}

/* ---- BM10: normals ---- */

typedef struct normal_job {
    const voxrt_tree *tree;
    const voxrt_octree *octree;
    const voxrt_hit *hit;
    float *normal;
    size_t count;
    int packets;
} normal_job;

static void run_normals(void *ctx) {
    normal_job *n = (normal_job *)ctx;
    size_t i;
    if (n->packets) {
        voxrt_octree_hit_normals(n->octree, n->hit, n->normal, n->count);
    } else {
        for (i = 0; i < n->count; i++) {
            if (n->octree != NULL) voxrt_octree_hit_normal(n->octree, &n->hit[i], n->normal + 3 * i);
            else voxrt_hit_normal(n->tree, &n->hit[i], n->normal + 3 * i);
        }
    }
}

static size_t keep_hits(voxrt_hit *hit, size_t count) {
    size_t i, n = 0;
    for (i = 0; i < count; i++) if (hit[i].node != VOXRT_NO_NODE) hit[n++] = hit[i];
    return n;
}

static double angle_between(const float a[3], const float b[3]) { /* degrees; exact for small ones */
    double c[3], dot = 0.0, s;
    int k;
    for (k = 0; k < 3; k++) {
        c[k] = (double)a[(k + 1) % 3] * (double)b[(k + 2) % 3] - (double)a[(k + 2) % 3] * (double)b[(k + 1) % 3];
        dot += (double)a[k] * (double)b[k];
    }
    s = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
    return atan2(s, dot) * 57.29577951308232;
}

/* Error of the stored normals over random directions. */
static void normal_error(int spherical, size_t count) {
    bench_rng rng = {99};
    double sum = 0.0, most = 0.0;
    size_t i;
    for (i = 0; i < count; i++) {
        float n[3], d[3], a;
        const float z = 2.0f * bench_random(&rng) - 1.0f, phi = 6.28318531f * bench_random(&rng);
        const float q = sqrtf(1.0f - z * z);
        n[0] = q * cosf(phi);
        n[1] = q * sinf(phi);
        n[2] = z;
        if (spherical) {
            const uint32_t code = voxrti_sph_encode(n);
            voxrti_sph_decode(code & 255u, (int8_t)(code >> 8), d);
        } else {
            voxrti_oct_decode(voxrti_oct_encode(n), d);
        }
        a = (float)angle_between(n, d);
        sum += (double)a;
        if ((double)a > most) most = (double)a;
    }
    bench_line("voxrt.normals", "random directions", "mean_error", sum / (double)count, "degrees");
    bench_num("max", most);
    bench_text("method", spherical ? "spherical, 16 bit" : "octahedral, 16 bit");
    bench_end();
    if (!spherical) table_set("normals", "%.3f / %.3f", sum / (double)count, most);
}

static void bm10(void) {
    static const char *const names[3] = {"tree", "octree, one by one", "octree, packets"};
    const int id = get_model(MODEL_DRAGON) != NULL ? MODEL_DRAGON : MODEL_BLOB;
    const voxrt_tree *tree = get_tree(id, 1024, KIND_DEFAULT);
    voxrt_octree *o = make_octree(tree);
    rayset rays = camera_rays(tree, WIDTH, HEIGHT);
    voxrt_hit *hit[2];
    normal_job n[3];
    bench_job b[3];
    size_t count[2];
    char kase[64];
    int i;
    snprintf(kase, sizeof kase, "%s-1024", g_models[id].name);
    for (i = 0; i < 2; i++) {
        hit[i] = (voxrt_hit *)must_alloc(rays.count, sizeof(voxrt_hit));
        if (i == 0) must(voxrt_trace(tree, NULL, rays.ray, hit[0], rays.count), "trace");
        else must(voxrt_octree_trace(o, NULL, rays.quad, hit[1], rays.count), "trace");
        count[i] = keep_hits(hit[i], rays.count);
    }
    memset(n, 0, sizeof n);
    memset(b, 0, sizeof b);
    for (i = 0; i < 3; i++) {
        n[i].tree = tree;
        n[i].octree = i > 0 ? o : NULL;
        n[i].hit = hit[i > 0];
        n[i].count = count[i > 0];
        n[i].packets = i == 2;
        n[i].normal = (float *)must_alloc(rays.count, 12);
        b[i].name = names[i];
        b[i].run = run_normals;
        b[i].ctx = &n[i];
    }
    bench_interleave(b, 3, 11);
    for (i = 0; i < 3; i++) {
        bench_line("voxrt.normals", kase, "decode_time", 1e9 * bench_seconds(&b[i]) / (double)n[i].count, "ns");
        bench_num("best", 1e9 * bench_seconds_best(&b[i]) / (double)n[i].count);
        bench_text("method", names[i]);
        bench_num("threads", 1);
        bench_hash(bench_hash_bytes(n[i].normal, 12 * n[i].count));
        bench_end();
        free(n[i].normal);
    }
    normal_error(0, g_opt.full ? 10000000 : 1000000);
    normal_error(1, g_opt.full ? 10000000 : 1000000);
    for (i = 0; i < 2; i++) free(hit[i]);
    free_rayset(&rays);
    voxrt_octree_destroy(o);
}

/* ---- BM13: tolerance against error ---- */

static double rmse(const uint8_t *a, const uint8_t *b, size_t pixels) { /* of R, G, B with alpha, 1/255 */
    double sum = 0.0;
    size_t i, k;
    for (i = 0; i < pixels; i++) {
        for (k = 0; k < 3; k++) {
            const double d = (double)(a[4 * i + k] * a[4 * i + 3]) - (double)(b[4 * i + k] * b[4 * i + 3]);
            sum += d * d / (255.0 * 255.0);
        }
    }
    return sqrt(sum / (3.0 * (double)pixels));
}

/* Trees and octrees have the same voxels; those with planes have pictures of their own, also as the reference. */
enum { PARETO_TREE, PARETO_PLANES, PARETO_OCTREE };
typedef struct pareto_way { const char *name; int of; uint32_t samples; float tolerance; uint32_t object, faces, blend; } pareto_way;

static frame_job pareto_frame(const voxrt_tree *tree, const voxrt_octree *octree, voxrt_geometry *geometry, const pareto_way *way) {
    frame_job f = make_frame(tree);
    f.desc.samples = way->samples;
    f.desc.tolerance = way->tolerance;
    f.desc.object_lod = way->object;
    f.desc.face_normals = way->faces;
    f.desc.blend = way->blend;
    if (way->of == PARETO_OCTREE) {
        voxrt_octree_geometry(octree, geometry);
        f.tree = NULL;
        f.desc.geometry = geometry;
        f.desc.geometry_count = 1;
        if (way->tolerance > 0.0f) {
            const float spread = (float)(2.0 * tan((double)f.desc.camera.fov_y * (3.14159265358979323846 / 360.0)) / HEIGHT);
            f.desc.max_level_plus_1 = voxrt_octree_lod_level(octree, f.desc.camera.eye, spread, way->tolerance) + 1;
            f.desc.tolerance = 0.0f;
        }
    }
    return f;
}

static void pareto(int id, uint32_t resolution) {
    static const pareto_way ways[] = {
        {"full detail", PARETO_TREE, 1, 0.0f, 0, 0, 0}, {"full detail", PARETO_TREE, 2, 0.0f, 0, 0, 0},
        {"full detail", PARETO_TREE, 4, 0.0f, 0, 0, 0}, {"full detail", PARETO_TREE, 8, 0.0f, 0, 0, 0},
        {"tolerance, 1 ray", PARETO_TREE, 1, 0.5f, 0, 0, 0}, {"tolerance, 1 ray", PARETO_TREE, 1, 1.0f, 0, 0, 0},
        {"tolerance, 1 ray", PARETO_TREE, 1, 1.41f, 0, 0, 0}, {"tolerance, 1 ray", PARETO_TREE, 1, 2.0f, 0, 0, 0},
        {"tolerance, 1 ray", PARETO_TREE, 1, 4.0f, 0, 0, 0}, {"tolerance, 1 ray", PARETO_TREE, 1, 8.0f, 0, 0, 0},
        {"tolerance, 4 rays", PARETO_TREE, 4, 0.5f, 0, 0, 0}, {"tolerance, 4 rays", PARETO_TREE, 4, 1.0f, 0, 0, 0},
        {"tolerance, 4 rays", PARETO_TREE, 4, 2.0f, 0, 0, 0}, {"tolerance, 4 rays", PARETO_TREE, 4, 4.0f, 0, 0, 0},
        {"one level, 1 ray", PARETO_TREE, 1, 1.0f, 1, 0, 0}, {"one level, 1 ray", PARETO_TREE, 1, 2.0f, 1, 0, 0},
        {"one level, 1 ray", PARETO_TREE, 1, 4.0f, 1, 0, 0}, {"one level, 1 ray", PARETO_TREE, 1, 8.0f, 1, 0, 0},
        {"tolerance, levels blended", PARETO_TREE, 1, 0.5f, 0, 0, 1}, {"tolerance, levels blended", PARETO_TREE, 1, 1.0f, 0, 0, 1},
        {"tolerance, levels blended", PARETO_TREE, 1, 2.0f, 0, 0, 1}, {"tolerance, levels blended", PARETO_TREE, 1, 4.0f, 0, 0, 1},
        {"voxels with planes", PARETO_PLANES, 1, 0.0f, 0, 0, 0}, {"voxels with planes", PARETO_PLANES, 2, 0.0f, 0, 0, 0},
        {"voxels with planes", PARETO_PLANES, 4, 0.0f, 0, 0, 0}, {"voxels with planes", PARETO_PLANES, 8, 0.0f, 0, 0, 0},
        {"planes, tolerance", PARETO_PLANES, 1, 1.0f, 0, 0, 0}, {"planes, tolerance", PARETO_PLANES, 1, 2.0f, 0, 0, 0},
        {"planes, tolerance", PARETO_PLANES, 1, 4.0f, 0, 0, 0},
        {"octree of the thesis", PARETO_OCTREE, 1, 0.0f, 0, 0, 0}, {"octree of the thesis", PARETO_OCTREE, 2, 0.0f, 0, 0, 0},
        {"octree of the thesis", PARETO_OCTREE, 4, 0.0f, 0, 0, 0},
        {"octree, one level", PARETO_OCTREE, 1, 1.0f, 0, 0, 0}, {"octree, one level", PARETO_OCTREE, 1, 2.0f, 0, 0, 0},
        {"octree, one level", PARETO_OCTREE, 1, 4.0f, 0, 0, 0}, {"octree, one level", PARETO_OCTREE, 1, 8.0f, 0, 0, 0},
        {"full detail, normals of faces", PARETO_TREE, 1, 0.0f, 0, 1, 0}
    };
    enum { WAYS = sizeof ways / sizeof ways[0] };
    const voxrt_tree *tree = get_tree(id, resolution, KIND_DEFAULT), *planes = get_tree(id, resolution, KIND_PLANES);
    const size_t pixels = (size_t)WIDTH * HEIGHT;
    voxrt_octree *octree;
    voxrt_geometry geometry;
    frame_job f[WAYS], many[2];
    bench_job b[WAYS];
    char kase[64];
    int i;
    if (tree == NULL || planes == NULL) {
        bench_skip("voxrt.tolerance", g_models[id].name, "no such file");
        return;
    }
    octree = make_octree(tree);
    snprintf(kase, sizeof kase, "%s-%u", g_models[id].name, resolution);
    memset(b, 0, sizeof b);
    for (i = 0; i < WAYS; i++) {
        f[i] = pareto_frame(ways[i].of == PARETO_PLANES ? planes : tree, octree, &geometry, &ways[i]);
        b[i].name = ways[i].name;
        b[i].run = run_frame;
        b[i].ctx = &f[i];
    }
    for (i = 0; i < 2; i++) { /* what a pixel should show: the mean of many rays */
        many[i] = make_frame(i == 0 ? tree : planes);
        many[i].desc.samples = 64;
        many[i].desc.env.thread_count = (uint32_t)g_opt.threads;
        run_frame(&many[i]);
    }
    bench_interleave(b, WAYS, ROUNDS);
    for (i = 0; i < WAYS; i++) {
        bench_line("voxrt.tolerance", kase, "frame_time", 1e3 * bench_seconds(&b[i]), "ms");
        bench_num("best", 1e3 * bench_seconds_best(&b[i]));
        bench_num("error", rmse(f[i].image.rgba8, many[ways[i].of == PARETO_PLANES].image.rgba8, pixels));
        bench_text("error_unit", "RMSE/255 to 64 rays a pixel");
        bench_text("method", ways[i].name);
        bench_num("samples", ways[i].samples);
        bench_num("tolerance_px", (double)ways[i].tolerance);
        bench_num("rmse_full_detail", rmse(f[i].image.rgba8, f[0].image.rgba8, pixels));
        bench_num("threads", 1);
        bench_hash(bench_hash_bytes(f[i].image.rgba8, 4 * pixels));
        bench_end();
    }
    for (i = 0; i < WAYS; i++) free(f[i].image.rgba8);
    for (i = 0; i < 2; i++) free(many[i].image.rgba8);
    voxrt_octree_destroy(octree);
}

static void bm13(void) {
    pareto(MODEL_DRAGON, g_opt.full ? 4096 : 2048);
    pareto(MODEL_BLOB, g_opt.full ? 4096 : 2048);
}

/* ---- BM11: frame budget ---- */

/* A flight around a model and towards it, with shadows, drawn by one thread within `share` of what full detail takes in
   the middle. Times are CPU seconds, so that others on the machine do not count as slow frames. */
static void flight(const voxrt_tree *tree, const char *kase, const char *name, double share, double target,
                   double *full, int frames) {
    voxrt_budget budget;
    voxrt_light light;
    frame_job f = make_frame(tree);
    const voxrt_camera start = f.desc.camera;
    double over = 0.0, far_over = 0.0, sum = 0.0, widest = 0.0, shown = 0.0, steps = 0.0, times[256];
    float tolerance = share > 0.0 ? 0.5f : 0.0f;
    int i, a;
    memset(&budget, 0, sizeof budget);
    memset(&light, 0, sizeof light);
    light.directional = 1;
    light.position[0] = light.position[1] = 1.0f;
    light.position[2] = 0.7f;
    light.color[0] = light.color[1] = light.color[2] = 0.9f;
    f.desc.lights = &light;
    f.desc.light_count = 1;
    f.desc.shadows = 1;
    for (i = 0; i < frames; i++) {
        const double turn = 6.28318530717958648 * i / frames, scale = 1.6 + 1.2 * cos(turn);
        const double v[3] = {(double)(start.eye[0] - start.at[0]), (double)(start.eye[1] - start.at[1]),
                             (double)(start.eye[2] - start.at[2])};
        double seconds;
        for (a = 0; a < 3; a++) f.desc.camera.at[a] = start.at[a];
        f.desc.camera.eye[0] = start.at[0] + (float)(scale * (cos(turn) * v[0] + sin(turn) * v[2]));
        f.desc.camera.eye[1] = start.at[1] + (float)(scale * v[1]);
        f.desc.camera.eye[2] = start.at[2] + (float)(scale * (cos(turn) * v[2] - sin(turn) * v[0]));
        f.desc.tolerance = tolerance;
        f.desc.pixel_step = budget.pixel_step;
        seconds = bench_cpu();
        run_frame(&f);
        times[i] = 1e3 * (bench_cpu() - seconds);
        shown += (double)tolerance;
        steps += budget.pixel_step > 1 ? budget.pixel_step : 1;
        if ((double)tolerance > widest) widest = (double)tolerance;
        sum += times[i];
        over += target > 0.0 && times[i] > target;
        far_over += target > 0.0 && times[i] > 1.1 * target;
        if (share > 0.0) tolerance = voxrt_budget_update(&budget, (float)times[i], (float)target, 0.5f);
    }
    if (full != NULL) *full = sum / frames;
    bench_line("voxrt.budget", kase, "frames_over_budget", over / frames, "");
    bench_num("over_by_a_tenth", far_over / frames);
    bench_text("method", name);
    bench_num("budget_ms", target);
    bench_num("mean_ms", sum / frames);
    bench_num("frames", frames);
    bench_num("tolerance_px_mean", shown / frames);
    bench_num("tolerance_px_most", widest);
    bench_num("pixel_step_mean", steps / frames);
    bench_num("threads", 1);
    bench_end();
    free(f.image.rgba8);
}

static void bm11(void) {
    static const double shares[4] = {0.9, 0.75, 0.5, 0.25};
    const int id = get_model(MODEL_DRAGON) != NULL ? MODEL_DRAGON : MODEL_BLOB, frames = g_opt.full ? 200 : 40;
    const uint32_t resolution = g_opt.full ? 4096 : 2048;
    const voxrt_tree *tree = get_tree(id, resolution, KIND_DEFAULT);
    double full;
    char kase[64], name[64];
    int k;
    snprintf(kase, sizeof kase, "%s-%u", g_models[id].name, resolution);
    flight(tree, kase, "full detail, to measure", 0.0, 0.0, &full, frames);
    for (k = 0; k < 4; k++) {
        snprintf(name, sizeof name, "full detail, budget %.0f %%", 100.0 * shares[k]);
        flight(tree, kase, name, 0.0, shares[k] * full, NULL, frames);
        snprintf(name, sizeof name, "controller, budget %.0f %%", 100.0 * shares[k]);
        flight(tree, kase, name, shares[k], shares[k] * full, NULL, frames);
    }
}

/* ---- BM14: editing ---- */

/* Balls of 10^5 voxels into the surface of a model and out of it; rays before; what a snapshot costs. */
static void bm14(void) {
    enum { PLACES = 16 };
    static const char *const names[3] = {"set a ball", "clear a ball", "paint a ball"};
    const int id = get_model(MODEL_DRAGON) != NULL ? MODEL_DRAGON : MODEL_BLOB;
    const uint32_t resolutions[2] = {1024, g_opt.full ? 8192u : 4096u};
    int k, i, place, pixels;
    for (k = 0; k < 2; k++) {
        const voxrt_tree *tree = get_tree(id, resolutions[k], KIND_DEFAULT);
        voxrt_model *m = NULL;
        voxrt_model_info info;
        frame_job f[2];
        bench_job b[2];
        voxrt_geometry g;
        double start = bench_wall(), take;
        char kase[64];
        snprintf(kase, sizeof kase, "%s-%u", g_models[id].name, resolutions[k]);
        must(voxrt_model_from_tree(NULL, tree, &m), "model");
        take = bench_wall() - start;
        voxrt_model_get_info(m, &info);
        f[0] = f[1] = make_frame(tree);
        f[1].image.rgba8 = (uint8_t *)must_alloc((size_t)WIDTH * HEIGHT, 4);
        f[1].tree = NULL;
        voxrt_model_geometry(m, &g);
        f[1].desc.geometry = &g;
        f[1].desc.geometry_count = 1;
        memset(b, 0, sizeof b);
        for (i = 0; i < 2; i++) {
            b[i].name = i ? "model" : "tree";
            b[i].run = run_frame;
            b[i].ctx = &f[i];
        }
        bench_interleave(b, 2, 5);
        for (i = 0, pixels = 0; i < WIDTH * HEIGHT; i++)
            pixels += memcmp(f[0].image.rgba8 + 4 * i, f[1].image.rgba8 + 4 * i, 4) != 0;
        for (i = 0; i < 2; i++) {
            frame_line("voxrt.edit", kase, &f[i], &b[i]);
            bench_num("differ_from_tree", (double)pixels);
            bench_num("bytes", i ? (double)info.block_bytes : 0.0);
            bench_end();
        }
        for (i = 0; i < 3; i++) {
            double spent = 0.0, most = 0.0, blocks = 0.0, voxels = 0.0, snap = 0.0;
            bench_rng r;
            r.state = 14;
            for (place = 0; place < PLACES; place++) { /* where the picture's rays meet it: on the surface */
                voxrt_model *before = NULL;
                voxrt_edit_desc d;
                voxrt_edit_stats stats;
                voxrt_ray ray;
                voxrt_hit hit;
                double centre[3], seconds;
                int a;
                do {
                    must(voxrt_camera_ray(&f[0].desc.camera, WIDTH, HEIGHT, WIDTH * (double)bench_random(&r),
                                          HEIGHT * (double)bench_random(&r), &ray), "ray");
                } while (!voxrt_trace1(tree, &ray, &hit));
                for (a = 0; a < 3; a++) centre[a] = (double)ray.org[a] + (double)hit.t * (double)ray.dir[a];
                start = bench_wall();
                must(voxrt_model_copy(NULL, m, &before), "copy");
                snap += bench_wall() - start;
                memset(&d, 0, sizeof d);
                d.env.thread_count = (uint32_t)g_opt.threads;
                d.op = VOXRT_EDIT_SET;
                d.rgb[0] = 200;
                if (i != 0) must(voxrt_model_sphere(before, &d, centre, 28.8 * info.voxel_size, NULL), "edit");
                d.op = (voxrt_edit_op)i;
                d.rgb[1] = 100;
                start = bench_wall();
                must(voxrt_model_sphere(before, &d, centre, 28.8 * info.voxel_size, &stats), "edit");
                seconds = bench_wall() - start;
                spent += seconds;
                if (seconds > most) most = seconds;
                blocks += (double)stats.blocks;
                voxels += (double)(stats.filled + stats.cleared + stats.painted);
                voxrt_model_destroy(before);
            }
            bench_line("voxrt.edit", kase, "edit_time", 1e3 * spent / PLACES, "ms");
            bench_text("method", names[i]);
            bench_num("most_ms", 1e3 * most);
            bench_num("voxels", voxels / PLACES);
            bench_num("blocks", blocks / PLACES);
            bench_num("snapshot_ms", 1e3 * snap / PLACES);
            bench_num("from_tree_ms", 1e3 * take);
            bench_num("threads", (double)g_opt.threads);
            bench_end();
        }
        for (i = 0; i < 2; i++) free(f[i].image.rgba8);
        voxrt_model_destroy(m);
    }
}

/* ---- BM15: voxels with planes ---- */

/* Close up, and a voxel a pixel: cubes as they are by default, the voxels that planes need as cubes, and planes. */
static void bm15(void) {
    static const char *const names[3] = {"cubes", "cubes, 26-separating", "planes"};
    static const struct { const char *kase; uint32_t resolution; float at; double pixels; } views[2] = {
        {"ball-256, voxels of 10 px", 256, 0.72f, 10.0}, {"ball-512, voxels of 1 px", 512, 0.0f, 1.0}};
    double *exact = (double *)must_alloc((size_t)WIDTH * HEIGHT, sizeof *exact);
    double *got = (double *)must_alloc((size_t)WIDTH * HEIGHT, sizeof *got);
    sup_mesh mesh;
    int k, i, shadows;
    memset(&mesh, 0, sizeof mesh);
    if (sup_scene_make("sphere", 512, &mesh)) exit(1);
    for (k = 0; k < 2; k++) {
        voxrt_tree *tree[2];
        voxrt_tree_info info;
        voxrt_light light;
        frame_job f[3];
        bench_job b[3];
        double size;
        memset(&light, 0, sizeof light);
        light.directional = 1;
        light.position[0] = 0.6f;
        light.position[1] = 0.7f;
        light.position[2] = 0.5f;
        light.color[0] = light.color[1] = light.color[2] = 0.9f;
        for (i = 0; i < 2; i++) {
            voxrt_mesh m = sup_voxel_mesh(&mesh);
            voxrt_build_desc d;
            memset(&d, 0, sizeof d);
            d.resolution = views[k].resolution;
            d.box_size = 2.2;
            d.box_min[0] = d.box_min[1] = d.box_min[2] = -1.1;
            d.planes = (uint32_t)i;
            must(voxrt_tree_build(&d, &m, NULL, &tree[i]), "build");
        }
        voxrt_tree_get_info(tree[1], &info);
        size = HEIGHT * info.voxel_size / views[k].pixels; /* of the picture at the ball */
        memset(b, 0, sizeof b);
        for (i = 0; i < 3; i++) {
            f[i] = make_frame(tree[i > 0]);
            memset(&f[i].desc.camera, 0, sizeof f[i].desc.camera);
            f[i].desc.camera.at[0] = f[i].desc.camera.eye[0] = views[k].at;
            f[i].desc.camera.at[1] = f[i].desc.camera.eye[1] = views[k].at * 0.8f;
            f[i].desc.camera.eye[2] = 20.0f;
            f[i].desc.camera.fov_y = (float)(2.0 * atan(0.5 * size / 20.0) * 57.29577951308232);
            f[i].desc.lights = &light;
            f[i].desc.light_count = 1;
            f[i].desc.cubes = i == 1;
            b[i].name = names[i];
            b[i].run = run_frame;
            b[i].ctx = &f[i];
        }
        if (!ball_picture(&f[0].desc.camera, WIDTH, HEIGHT, 0.0, 1.0, light.position, exact, NULL)) exit(1);
        ball_bytes(exact, (size_t)WIDTH * HEIGHT);
        for (shadows = 0; shadows < 2; shadows++) {
            for (i = 0; i < 3; i++) f[i].desc.shadows = (uint32_t)shadows;
            bench_interleave(b, 3, ROUNDS);
            for (i = 0; i < 3; i++) {
                frame_job many = f[i];
                int p;
                many.desc.samples = 16;
                many.image.rgba8 = NULL;
                many.image.rgba = (float *)must_alloc((size_t)WIDTH * HEIGHT, 16);
                run_frame(&many);
                for (p = 0; p < WIDTH * HEIGHT; p++) got[p] = ball_srgb((double)many.image.rgba[4 * p]);
                free(many.image.rgba);
                frame_line("voxrt.planes", views[k].kase, &f[i], &b[i]);
                bench_num("shadows", (double)shadows);
                bench_num("psnr_db", ball_psnr(got, exact, (size_t)WIDTH * HEIGHT));
                bench_num("times_cubes", bench_seconds(&b[i]) / bench_seconds(&b[0]));
                bench_num("bytes", i == 2 ? (double)info.plane_bytes : 0.0);
                bench_end();
            }
        }
        for (i = 0; i < 3; i++) free(f[i].image.rgba8);
        for (i = 0; i < 2; i++) voxrt_tree_destroy(tree[i]);
    }
    sup_mesh_free(&mesh);
    free(exact);
    free(got);
}

/* ---- BM16: many objects ---- */

/* Copies of one tree, turned and scaled, in a square; a camera that stands among them: what the hierarchy costs to make
   (for each frame when they move), to hold and to trace. The rays of the smallest scene one object after the other. */
static void bm16(void) {
    const voxrt_tree *tree = get_tree(MODEL_BLOB, 512, KIND_DEFAULT);
    const size_t most = g_opt.full ? 10000000 : 1000000;
    double lo[3], hi[3], wide, first = 0.0;
    size_t n, i;
    voxrt_tree_bounds(tree, lo, hi);
    wide = sqrt((hi[0] - lo[0]) * (hi[0] - lo[0]) + (hi[2] - lo[2]) * (hi[2] - lo[2]));
    for (n = 100; n <= most; n *= 10) {
        const size_t side = (size_t)ceil(sqrt((double)n));
        voxrt_instance *instance = (voxrt_instance *)must_alloc(n, sizeof *instance);
        voxrt_geometry *all = (voxrt_geometry *)must_alloc(n, sizeof *all), together;
        voxrt_group *group = NULL;
        frame_job f = make_frame(tree);
        bench_job b;
        char kase[64];
        double start = bench_wall(), places, build = 1e30;
        size_t wrong = 0;
        bench_rng r;
        int k;
        r.state = 16;
        for (i = 0; i < n; i++) {
            voxrt_instance *p = &instance[i];
            const double turn = 6.283185307179586 * (double)bench_random(&r), size = 0.7 + 0.6 * (double)bench_random(&r);
            const double c = size * cos(turn), d = size * sin(turn);
            memset(p, 0, sizeof *p);
            voxrt_tree_geometry(tree, &p->geometry);
            p->to_world[0] = p->to_world[10] = c;
            p->to_world[2] = d;
            p->to_world[8] = -d;
            p->to_world[5] = size;
            p->to_world[3] = ((double)(i % side) - 0.5 * (double)side + 0.4 * (double)bench_random(&r)) * wide;
            p->to_world[11] = (0.5 * (double)side - (double)(i / side) + 0.4 * (double)bench_random(&r)) * wide;
            must(voxrt_instance_geometry(p, &all[i]), "instance");
        }
        places = bench_wall() - start;
        for (k = 0; k < 3; k++) {
            voxrt_group_destroy(group);
            start = bench_wall();
            must(voxrt_group_create(NULL, all, n, &group), "group");
            if (bench_wall() - start < build) build = bench_wall() - start;
        }
        voxrt_group_geometry(group, &together);
        f.tree = NULL;
        f.desc.geometry = &together;
        f.desc.geometry_count = 1;
        f.desc.tolerance = 1.0f;
        memset(&f.desc.camera, 0, sizeof f.desc.camera);
        f.desc.camera.eye[1] = (float)(3.0 * wide);
        f.desc.camera.eye[2] = (float)(4.0 * wide);
        f.desc.camera.fov_y = 45.0f;
        memset(&b, 0, sizeof b);
        b.name = "group";
        b.run = run_frame;
        b.ctx = &f;
        bench_interleave(&b, 1, 3);
        if (n == 100) { /* without the hierarchy */
            frame_job one = f;
            one.desc.geometry = all;
            one.desc.geometry_count = n;
            one.image.rgba8 = (uint8_t *)must_alloc((size_t)WIDTH * HEIGHT, 4);
            run_frame(&one);
            for (i = 0; i < (size_t)WIDTH * HEIGHT; i++)
                wrong += memcmp(one.image.rgba8 + 4 * i, f.image.rgba8 + 4 * i, 4) != 0;
            free(one.image.rgba8);
            first = bench_seconds(&b);
        }
        snprintf(kase, sizeof kase, "blob-512 %zu times", n);
        frame_line("voxrt.objects", kase, &f, &b);
        bench_num("differ_from_each", (double)wrong);
        bench_num("times_hundred", bench_seconds(&b) / first);
        bench_num("places_ms", 1e3 * places);
        bench_num("group_ms", 1e3 * build);
        bench_num("bytes_each", (double)(sizeof *instance + 136));
        bench_end();
        free(f.image.rgba8);
        voxrt_group_destroy(group);
        free(instance);
        free(all);
    }
}

/* ---- BM17: larger than memory ---- */

static voxrt_paged *open_pages(const char *path, size_t memory, uint32_t wait) {
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    memset(&d, 0, sizeof d);
    d.memory = memory;
    d.wait = wait;
    must(voxrt_paged_open_file(&d, path, &p), "pages");
    return p;
}

static void pages_line(const char *kase, const char *name, double tolerance, size_t memory, const voxrt_paged *p, double first,
                       double all, double wall, int pictures, uint64_t hash) {
    voxrt_paged_info info;
    voxrt_paged_get_info(p, &info);
    bench_line("voxrt.pages", kase, name, all, "s");
    bench_num("tolerance", tolerance);
    bench_num("memory_limit", (double)memory);
    bench_num("first_picture", first);
    bench_num("pictures", pictures);
    bench_num("wall", wall);
    bench_num("pages", info.page_count);
    bench_num("loaded_pages", info.loaded_pages);
    bench_num("reads", (double)info.reads);
    bench_num("read_bytes", (double)info.read_bytes);
    bench_num("loaded_bytes", (double)info.loaded_bytes);
    bench_num("memory", (double)info.memory);
    bench_num("coarse_rays", (double)info.coarse_rays);
    bench_hash(hash);
    bench_end();
}

/* The file of a mesh, and a camera that sees all of it. */
static void build_pages(const voxrt_build_desc *d, const voxrt_mesh *m, const char *path, const char *kase, size_t memory,
                        voxrt_camera *camera) {
    voxrt_build_stats stats;
    voxrt_paged_info info;
    voxrt_geometry g;
    voxrt_paged *p;
    double start = bench_wall(), cpu = bench_cpu();
    must(voxrt_paged_build_file(d, m, path, &stats), "pages");
    cpu = bench_cpu() - cpu;
    start = bench_wall() - start;
    p = open_pages(path, memory, 0);
    voxrt_paged_get_info(p, &info);
    bench_line("voxrt.pages", kase, "build", cpu, "s");
    bench_num("wall", start);
    bench_num("voxels", (double)info.voxel_count);
    bench_num("bytes", (double)info.file_bytes);
    bench_num("pages", info.page_count);
    bench_num("peak_bytes", (double)stats.peak_bytes);
    bench_end();
    voxrt_paged_geometry(p, &g);
    must(voxrt_camera_fit(camera, g.box_min, g.box_max, NULL, WIDTH, HEIGHT), "camera");
    voxrt_paged_destroy(p);
}

/* Pictures until nothing is missing in the last; gives its hash, and in *most the memory that pages took. */
static uint64_t pages_until_exact(frame_job f, const char *path, const char *kase, size_t memory, int wait, size_t *most) {
    voxrt_paged *p = open_pages(path, memory, (uint32_t)wait);
    voxrt_paged_update_stats u;
    voxrt_paged_info info;
    voxrt_geometry g;
    double start, cpu, first = 0.0;
    uint64_t hash;
    int pictures = 0;
    voxrt_paged_geometry(p, &g);
    f.desc.geometry = &g;
    f.desc.geometry_count = 1;
    start = bench_wall();
    cpu = bench_cpu();
    do {
        run_frame(&f);
        if (pictures++ == 0) first = bench_cpu() - cpu;
        must(voxrt_paged_update(p, 0, &u), "pages");
        if (u.no_room != 0) voxrt_paged_wait(p, 1); /* the last picture is exact all the same */
    } while (u.wanted != 0);
    cpu = bench_cpu() - cpu;
    hash = bench_hash_bytes(f.image.rgba8, (size_t)4 * WIDTH * HEIGHT);
    pages_line(kase, wait ? "exact_at_once" : "coarse_to_exact", (double)f.desc.tolerance, memory, p, first, cpu,
               bench_wall() - start, pictures, hash);
    voxrt_paged_get_info(p, &info);
    *most = (size_t)info.memory;
    voxrt_paged_destroy(p);
    return hash;
}

/* All of it in memory: what pages cost when nothing is missing. Gives the hash of the tree's picture. */
static uint64_t pages_beside_tree(frame_job f, const char *path, const char *kase, const voxrt_build_desc *d, const voxrt_mesh *m) {
    voxrt_tree *tree = NULL;
    voxrt_paged *p;
    voxrt_geometry g, whole;
    frame_job of = f;
    bench_job b[2];
    uint64_t exact;
    must(voxrt_tree_build(d, m, NULL, &tree), "tree");
    p = open_pages(path, 1024u << 20, 1);
    voxrt_paged_geometry(p, &g);
    voxrt_tree_geometry(tree, &whole);
    f.desc.geometry = &g;
    of.desc.geometry = &whole;
    f.desc.geometry_count = of.desc.geometry_count = 1;
    run_frame(&f);
    memset(b, 0, sizeof b);
    b[0].name = "tree";
    b[0].run = run_frame;
    b[0].ctx = &of;
    b[1].name = "pages";
    b[1].run = run_frame;
    b[1].ctx = &f;
    bench_interleave(b, 2, ROUNDS);
    run_frame(&of);
    exact = bench_hash_bytes(f.image.rgba8, (size_t)4 * WIDTH * HEIGHT);
    bench_line("voxrt.pages", kase, "warm", 1e3 * bench_seconds(&b[1]), "ms");
    bench_num("tree", 1e3 * bench_seconds(&b[0]));
    bench_num("ratio", bench_ratio(&b[0], &b[1]));
    bench_end();
    voxrt_tree_destroy(tree);
    voxrt_paged_destroy(p);
    return exact;
}

/* A terrain as a file in pages, made piece by piece; then from coarse to exact, picture by picture, and at once; with level
   of detail and without it, in 2 GiB and in a tenth of that. Where it fits into memory also against the tree. */
static void bm17(void) {
    const uint32_t resolution = g_opt.full ? 32768 : 4096;
    const size_t room = (size_t)(g_opt.full ? 2000 : 64) << 20;
    const char *folder = getenv("TMPDIR") != NULL ? getenv("TMPDIR") : "/tmp";
    char path[1024], kase[32];
    sup_mesh mesh;
    voxrt_mesh m;
    voxrt_build_desc d;
    frame_job f;
    uint64_t hash[5] = {0}, exact; /* of the last picture in each way; of that of the tree, or else of what was loaded at once */
    size_t most[5] = {0};
    int way, wrong = 0;
    memset(&mesh, 0, sizeof mesh);
    memset(&d, 0, sizeof d);
    memset(&f, 0, sizeof f);
    snprintf(path, sizeof path, "%s/bench_pages_%ld.vox", folder, (long)getpid());
    snprintf(kase, sizeof kase, "terrain-%u", resolution);
    if (sup_scene_make("terrain", g_opt.full ? 2000 : 500, &mesh)) run_failed("terrain", "no mesh");
    m = sup_voxel_mesh(&mesh);
    d.resolution = resolution;
    d.palette_size = 16777216;
    d.env.thread_count = (uint32_t)g_opt.threads;
    build_pages(&d, &m, path, kase, room, &f.desc.camera);
    f.image.width = WIDTH;
    f.image.height = HEIGHT;
    f.image.rgba8 = (uint8_t *)must_alloc((size_t)WIDTH * HEIGHT, 4);
    f.desc.env.thread_count = 1;
    for (way = 0; way < 5; way++) { /* level of detail, full: from coarse to exact, at once; full in a tenth of the memory */
        f.desc.tolerance = way < 2 ? 1.0f : 0.0f;
        hash[way] = pages_until_exact(f, path, kase, way == 4 ? room / 10 : room, way == 1 || way >= 3, &most[way]);
    }
    exact = g_opt.full ? hash[3] : pages_beside_tree(f, path, kase, &d, &m);
    for (way = 2; way < 5; way++) wrong += hash[way] != exact || most[way] > (way == 4 ? room / 10 : room);
    table_set("pages", "%d of 3", wrong);
    free(f.image.rgba8);
    (void)remove(path);
    sup_mesh_free(&mesh);
}

int main(int argc, char **argv) {
    static const struct { int number; void (*run)(void); } all[] = {
        {1, bm1}, {2, bm2}, {3, bm3}, {4, bm4}, {7, bm7}, {10, bm10}, {13, bm13}, {11, bm11}, {9, bm9}, {5, bm5}, {6, bm6}, {14, bm14},
        {15, bm15}, {16, bm16}, {17, bm17}, {8, bm8}
    };
    size_t i;
    int status = bench_parse(argc, argv, &g_opt);
    if (status) return status;
    bench_machine("voxrt", argv[0]);
    for (i = 0; i < sizeof all / sizeof all[0]; i++) {
        const double start = bench_wall();
        if (!bench_wanted(&g_opt, all[i].number)) continue;
        all[i].run();
        fprintf(stderr, "BM%d: %.1f s\n", all[i].number, bench_wall() - start);
    }
    drop_trees();
    for (i = 0; i < MODEL_COUNT; i++) sup_mesh_free(&g_models[i].mesh);
    bench_table_end(&g_table, &g_opt, g_busy_count > 0 ? g_busy_sum / g_busy_count : 0.0, argv[0]);
    return 0;
}
