/* bench_voxrt_gi.c - how fast and how wrong global illumination on bit columns is - MIT OR Unlicense, see LICENSE

   bench_voxrt_gi [--full] [--only BM1,BM6] [--threads N] [--table FILE]

   BM1 voxelising, moving objects     BM5 virtual lights                   BM10 error against time: the thesis' way and ours
   BM2 hierarchy                      BM6 paths                            BM11 memory
   BM3 rays: the thesis' and ours     BM7 closed forms, BM8 coarse meshes  BM12 threads
   BM4 gathering, ways to the light   BM9 filter                           BM13 grid sizes      BM14 a lamp that moves
   One JSON object a line on stdout; the acceptance table on stderr and, after a run of all, in bench/table_gi.md beside
   the program. */
#include "bench.h"
#include "../examples/support/mesh.h"
#include "../examples/support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "../examples/support/voxel_mesh.h"
#include "baseline/columns.h"

enum { ROUNDS = 5, GRID = 256, DEPTH = 128 };

static bench_options g_opt;
static double g_busy_sum, g_busy_count;

static bench_row g_rows[] = {
    {"near", "First hit, 32 cells: thesis' hall / open box", "10^6 rays/s", "12", "30", ""},
    {"far", "First hit, whole box: thesis' hall / open box", "10^6 rays/s", "6", "15", ""},
    {"any", "Any hit, 32 cells: thesis' hall / open box", "10^6 rays/s", "20", "50", ""},
    {"any_far", "Any hit, whole box: thesis' hall / open box", "10^6 rays/s", "20", "50", ""},
    {"points", "Insertion of surface samples", "10^6/s", "60", "150", ""},
    {"update", "Hierarchy, whole", "ms", "0.2", "0.1", ""},
    {"missed", "False misses against stepping in double precision", "rays of", "0", "0", ""},
    {"gather", "Gathering, 16 rays, R = 8 of 6: time a ray against the thesis' stepping", "times faster", "2", "4", ""},
    {"path", "Paths of 2: the same", "times faster", "2", "4", ""},
    {"default", "Time to the error of the thesis' 32 rays and filter: Cornell box, pillars", "of its time", "1/8", "1/20", ""},
    {"sphere", "Closed sphere with a lamp, 1 / 2 / 3 bounces: error", "%", "1", "0.3", ""},
    {"kerb", "Kerb of 2.7 cells, 0.7 / 1.7 cells away: error of what it hides", "", "0.01", "0.005", ""},
    {"leak", "Light through a wall of 0.1 cells: behind it (on 5 cells of floor, that at 0.8, 0.4, 0.02 of its cell)", "%", "0.5", "0.1", ""},
    {"flicker", "Flicker, moving lamp, against the converged reference", "times", "1.3", "1.1", ""}
};
static bench_table g_table = {g_rows, sizeof g_rows / sizeof g_rows[0],
                              "Global illumination on columns of 256 x 256 x 128, one core", "table_gi.md"};

#define table_set(key, ...) bench_table_set(&g_table, key, __VA_ARGS__)

static void must(voxrt_result r, const char *what) {
    if (r == VOXRT_OK) return;
    fprintf(stderr, "bench_voxrt_gi: %s: %s\n", what, voxrt_result_string(r));
    exit(1);
}
static void *must_alloc(size_t n, size_t size) {
    void *p = calloc(n > 0 ? n : 1, size);
    if (p == NULL) must(VOXRT_ERR_NO_MEMORY, "memory");
    return p;
}
static void run_jobs(bench_job *jobs, int count, int rounds) {
    int i;
    bench_interleave(jobs, count, rounds);
    for (i = 0; i < count; i++) {
        g_busy_sum += bench_busy(&jobs[i]);
        g_busy_count += 1.0;
    }
}
static void one_thread(const bench_job *j) {
    bench_text("method", j->name);
    if (j->isa != NULL) bench_text("isa", j->isa);
    bench_num("threads", 1);
    bench_num("wall_per_cpu", bench_busy(j));
}

/* ---- volumes ---- */

static voxrt_columns *make_columns(uint32_t grid, uint32_t depth) { /* cells of one unit */
    voxrt_columns_desc d;
    voxrt_columns *c = NULL;
    memset(&d, 0, sizeof d);
    d.size_x = d.size_y = grid;
    d.size_z = depth;
    d.depth_axis_plus_1 = 3;
    d.box_max[0] = d.box_max[1] = grid;
    d.box_max[2] = depth;
    must(voxrt_columns_create(&d, &c), "columns");
    return c;
}

static int box_shell(int x, int y, int z, const int b[6]) {
    return x >= b[0] && x <= b[1] && y >= b[2] && y <= b[3] && z >= b[4] && z <= b[5] &&
        (x == b[0] || x == b[1] || y == b[2] || y == b[3] || z == b[4] || z == b[5]);
}

/* A hall: shell, ten hollow pillars, a vault, a hollow ball, 9.6 % set; and an open box with two boxes in it, 3.2 %. */
static voxrt_columns *make_volume(int open) {
    static const int boxes[2][6] = {{60, 110, 60, 120, 1, 40}, {150, 210, 130, 190, 1, 80}};
    voxrt_columns *c = make_columns(GRID, DEPTH);
    voxrti_insert in;
    int x, y, z, p;
    memset(&in, 0, sizeof in);
    in.columns = c;
    for (y = 0; y < GRID; y++)
        for (x = 0; x < GRID; x++) {
            double pillar = 100.0;
            for (p = 0; p < 10; p++) pillar = fmin(pillar, fabs(hypot(x - 40 - p % 5 * 44, y - 80 - p / 5 * 96) - 10.0));
            for (z = 0; z < DEPTH; z++) {
                int set;
                if (open) {
                    set = x < 1 || y < 1 || z < 1 || x >= GRID - 1 || z >= DEPTH - 1 || box_shell(x, y, z, boxes[0]) ||
                        box_shell(x, y, z, boxes[1]);
                } else {
                    set = x < 2 || y < 2 || z < 2 || x >= GRID - 2 || y >= GRID - 2 || z >= DEPTH - 2 ||
                        (pillar < 1.0 && z < 110) || fabs(hypot(hypot(x - 128, y - 128), z - 40) - 22.0) < 1.0 ||
                        fabs(z - 95 - 20 * cos((y - 128) / 128.0 * 3.1)) < 1.2;
                }
                if (set) voxrti_insert_run(&in, (uint32_t)x, (uint32_t)y, (uint32_t)z, (uint32_t)z);
            }
        }
    voxrt_columns_update(c);
    return c;
}

/* The same cells as a tree. */
static voxrt_tree *make_tree(const voxrt_columns *c) {
    const size_t words = (size_t)c->size[0] * c->size[1] * c->words;
    voxrt_voxel *voxel;
    voxrt_tree *tree = NULL;
    size_t n = 0, i;
    for (i = 0; i < words; i++) n += voxrti_popcount64(c->bits[i]);
    voxel = (voxrt_voxel *)must_alloc(n, sizeof *voxel);
    for (i = n = 0; i < words; i++)
        for (uint32_t bits = c->bits[i]; bits != 0; bits &= bits - 1, n++) {
            const size_t column = i / c->words;
            voxel[n].x = (uint32_t)(column % c->size[0]);
            voxel[n].y = (uint32_t)(column / c->size[0]);
            voxel[n].z = (uint32_t)(i % c->words) * 32 + voxrti_ctz64(bits);
        }
    must(voxrt_tree_from_voxels(NULL, voxel, n, voxrti_log2_u32(c->size[0]), &tree), "tree");
    free(voxel);
    return tree;
}

typedef struct ray_set { voxrt_ray *ray; float *normal; size_t count; } ray_set;

/* From empty cells beside set ones, into the hemisphere away from them. */
static ray_set make_rays(const voxrt_columns *c, size_t count, float length) {
    static const int side[6][3] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    bench_rng rng = {42};
    ray_set s;
    size_t n = 0;
    s.ray = (voxrt_ray *)must_alloc(count, sizeof *s.ray);
    s.normal = (float *)must_alloc(count, 12);
    s.count = count;
    while (n < count) {
        int at[3], f, a;
        float dot = 0.0f;
        voxrt_ray *r = &s.ray[n];
        for (a = 0; a < 3; a++) at[a] = (int)(bench_random(&rng) * (float)(int32_t)c->size[a]);
        if (baseline_bit(c, at[0], at[1], at[2])) continue;
        for (f = 0; f < 6; f++) {
            const int x = at[0] + side[f][0], y = at[1] + side[f][1], z = at[2] + side[f][2];
            if (x < 0 || y < 0 || z < 0 || x >= (int)c->size[0] || y >= (int)c->size[1] || z >= (int)c->size[2]) continue;
            if (baseline_bit(c, x, y, z)) break;
        }
        if (f == 6) continue;
        for (a = 0; a < 3; a++) r->dir[a] = 2.0f * bench_random(&rng) - 1.0f;
        if (r->dir[0] * r->dir[0] + r->dir[1] * r->dir[1] + r->dir[2] * r->dir[2] > 1.0f) continue;
        bench_unit(r->dir);
        for (a = 0; a < 3; a++) dot -= r->dir[a] * (float)side[f][a];
        for (a = 0; a < 3; a++) {
            if (dot < 0.0f) r->dir[a] = -r->dir[a];
            r->org[a] = (float)at[a] + bench_random(&rng);
            s.normal[3 * n + (size_t)a] = (float)-side[f][a];
        }
        r->t_min = 0.0f;
        r->t_max = length;
        n++;
    }
    return s;
}

/* ---- BM3: rays ---- */

typedef struct ray_job {
    const voxrt_columns *columns;
    const voxrt_tree *tree;
    const voxrt_octree *octree;
    const ray_set *rays;
    int way;                  /* baseline_way; -1: the library; -2: its tree; -3: the thesis' octree */
    uint32_t steps;
    voxrt_isa isa;
    int any, normals;
    size_t group;             /* rays in a call; 0: all */
    voxrti_column_found *found;
    uint8_t *hit;
    voxrt_column_hit *hits;
    voxrt_hit *tree_hits;
} ray_job;

static void run_rays(void *ctx) {
    ray_job *j = (ray_job *)ctx;
    voxrt_columns_trace_desc d;
    size_t i, n;
    memset(&d, 0, sizeof d);
    d.isa = j->isa;
    if (j->way == -2) {
        if (j->any) must(voxrt_occluded(j->tree, NULL, j->rays->ray, j->hit, j->rays->count), "rays");
        else must(voxrt_trace(j->tree, NULL, j->rays->ray, j->tree_hits, j->rays->count), "rays");
        return;
    }
    if (j->way == -3) {
        must(voxrt_octree_trace(j->octree, NULL, j->rays->ray, j->tree_hits, j->rays->count), "rays");
        return;
    }
    if (j->way >= 0) {
        for (i = 0; i < j->rays->count; i++) {
            voxrti_column_ray r;
            j->hit[i] = voxrti_column_ray_open(j->columns, &j->rays->ray[i], &r) == 1 &&
                baseline_ray(j->columns, &r, (baseline_way)j->way, j->steps, &j->found[i]);
        }
        return;
    }
    for (i = 0; i < j->rays->count; i += n) {
        n = j->group != 0 && j->group < j->rays->count - i ? j->group : j->rays->count - i;
        if (j->normals) d.normals = j->rays->normal + 3 * i;
        if (j->any) must(voxrt_columns_occluded(j->columns, &d, j->rays->ray + i, j->hit + i, n), "rays");
        else must(voxrt_columns_trace(j->columns, &d, j->rays->ray + i, j->hits + i, n), "rays");
    }
}

typedef struct wrong { size_t missed, extra, other; } wrong;

/* Columns that a ray looks at, on average and at most by ray: of some of the rays. */
static void count_steps(const ray_job *j) {
    double sum = 0.0, most = 0.0;
    size_t i, n = 0, by = j->rays->count / 4000 + 1;
    for (i = 0; i < j->rays->count; i += by, n++) {
        voxrt_columns_trace_desc d;
        voxrt_stats st;
        voxrt_column_hit hit;
        memset(&d, 0, sizeof d);
        memset(&st, 0, sizeof st);
        d.stats = &st;
        if (j->normals) d.normals = j->rays->normal + 3 * i;
        must(voxrt_columns_trace(j->columns, &d, j->rays->ray + i, &hit, 1), "rays");
        sum += (double)st.steps;
        most = fmax(most, (double)st.steps);
    }
    bench_num("steps_per_ray", sum / (double)n);
    bench_num("most_steps", most);
}

static wrong compare(const ray_job *exact, const ray_job *j) {
    wrong w = {0, 0, 0};
    size_t i;
    for (i = 0; i < j->rays->count; i++) {
        const voxrti_column_found *e = &exact->found[i];
        const int lib = j->way < 0 && !j->any;
        const uint32_t *cell = !lib ? NULL : j->way < -1 ? j->tree_hits[i].cell : j->hits[i].cell;
        const int is = !lib ? j->hit[i] : j->way < -1 ? j->tree_hits[i].t < INFINITY : j->hits[i].t < INFINITY;
        w.missed += exact->hit[i] && !is;
        w.extra += !exact->hit[i] && is;
        if (!exact->hit[i] || !is || j->any) continue;
        if (lib) w.other += (uint32_t)e->x != cell[0] || (uint32_t)e->y != cell[1] || (uint32_t)e->k != cell[2];
        else w.other += e->x != j->found[i].x || e->y != j->found[i].y || e->k != j->found[i].k;
    }
    return w;
}

typedef struct ray_way { const char *name, *isa; int way; uint32_t steps; voxrt_isa isa_id; int any, normals; size_t group; } ray_way;

static const ray_way ray_ways[] = {
    {"cell by cell, double", "scalar", BASELINE_EXACT, 0, VOXRT_ISA_AUTO, 0, 0, 0},
    {"thesis", "scalar", BASELINE_EPSILON, 0, VOXRT_ISA_AUTO, 0, 0, 0},
    {"thesis, 64 steps", "scalar", BASELINE_EPSILON, 64, VOXRT_ISA_AUTO, 0, 0, 0},
    {"90 points", "scalar", BASELINE_MARCH, 90, VOXRT_ISA_AUTO, 0, 0, 0},
    {"90 points of 3 bits", "scalar", BASELINE_MARCH_3, 90, VOXRT_ISA_AUTO, 0, 0, 0},
    {"512 points", "scalar", BASELINE_MARCH, 512, VOXRT_ISA_AUTO, 0, 0, 0},
    {"columns", "scalar", -1, 0, VOXRT_ISA_SCALAR, 0, 0, 0},
    {"columns", "auto", -1, 0, VOXRT_ISA_AUTO, 0, 0, 0},
    {"columns, any hit", "auto", -1, 0, VOXRT_ISA_AUTO, 1, 0, 0},
    {"columns, calls of 64 rays", "auto", -1, 0, VOXRT_ISA_AUTO, 0, 0, 64},
    {"columns, planes of the start", "auto", -1, 0, VOXRT_ISA_AUTO, 0, 1, 0},
    {"tree of the same cells", "auto", -2, 0, VOXRT_ISA_AUTO, 0, 0, 0},
    {"tree of the same cells, any hit", "auto", -2, 0, VOXRT_ISA_AUTO, 1, 0, 0},
    {"octree of the same cells", "auto", -3, 0, VOXRT_ISA_AUTO, 0, 0, 0}
};
enum { RAY_WAYS = sizeof ray_ways / sizeof ray_ways[0] };

/* The same rays through the same cells, in each way; with room for what is found. */
static void make_ray_jobs(ray_job *t, bench_job *b, const voxrt_columns *c, const voxrt_tree *tree, const voxrt_octree *octree,
                          const ray_set *s) {
    int i;
    memset(t, 0, RAY_WAYS * sizeof *t);
    memset(b, 0, RAY_WAYS * sizeof *b);
    for (i = 0; i < RAY_WAYS; i++) {
        t[i].columns = c;
        t[i].tree = tree;
        t[i].octree = octree;
        t[i].rays = s;
        t[i].way = ray_ways[i].way;
        t[i].steps = ray_ways[i].steps;
        t[i].isa = ray_ways[i].isa_id;
        t[i].any = ray_ways[i].any;
        t[i].normals = ray_ways[i].normals;
        t[i].group = ray_ways[i].group;
        t[i].found = (voxrti_column_found *)must_alloc(s->count, sizeof *t[i].found);
        t[i].hit = (uint8_t *)must_alloc(s->count, 1);
        t[i].hits = (voxrt_column_hit *)must_alloc(s->count, sizeof *t[i].hits);
        if (ray_ways[i].way < -1) t[i].tree_hits = (voxrt_hit *)must_alloc(s->count, sizeof *t[i].tree_hits);
        b[i].name = ray_ways[i].name;
        b[i].isa = ray_ways[i].isa;
        b[i].run = run_rays;
        b[i].ctx = &t[i];
    }
}

static void free_ray_jobs(ray_job *t) {
    int i;
    for (i = 0; i < RAY_WAYS; i++) {
        free(t[i].found);
        free(t[i].hit);
        free(t[i].hits);
        free(t[i].tree_hits);
    }
}

/* Of way i, with what it finds wrong. */
static void ray_line(const char *kase, const ray_job *t, const bench_job *b, int i, const wrong *w) {
    const size_t count = t[i].rays->count;
    bench_line("voxrt.columns.rays", kase, "rays_per_second", bench_rate(&b[i], (double)count), "1/s");
    bench_num("best", bench_rate_best(&b[i], (double)count));
    if (!t[i].normals) {
        bench_num("error", (double)w->missed / (double)count);
        bench_text("error_unit", "share of rays that miss what is there");
        bench_num("false_hits", (double)w->extra / (double)count);
        bench_num("other_cells", (double)w->other / (double)count);
    }
    bench_num("times_thesis", bench_ratio(&b[1], &b[i]));
    one_thread(&b[i]);
    bench_num("rays", (double)count);
    if (i == 7 || t[i].normals) count_steps(&t[i]);
    bench_hash(t[i].way < -1 && !t[i].any ? bench_hash_bytes(t[i].tree_hits, count * sizeof *t[i].tree_hits) :
               t[i].way < 0 && !t[i].any ? bench_hash_bytes(t[i].hits, count * sizeof *t[i].hits) :
               bench_hash_bytes(t[i].hit, count));
    bench_end();
}

static void bm3(void) {
    const size_t count = g_opt.full ? 2500000 : 60000; /* 10^7 in all with --full */
    double rate[2][2], any[2][2];
    size_t missed = 0, extra = 0, other = 0;
    int scene, length, i;
    for (scene = 0; scene < 2; scene++) {
        voxrt_columns *c = make_volume(scene);
        voxrt_tree *tree = make_tree(c);
        voxrt_octree *octree = NULL;
        must(voxrt_octree_from_tree(NULL, tree, &octree), "octree");
        for (length = 0; length < 2; length++) {
            ray_set s = make_rays(c, count, length ? 400.0f : 32.0f);
            ray_job t[RAY_WAYS];
            bench_job b[RAY_WAYS];
            char kase[64];
            snprintf(kase, sizeof kase, "%s, %s", scene ? "open box" : "hall", length ? "whole box" : "32 cells");
            make_ray_jobs(t, b, c, tree, octree, &s);
            run_jobs(b, RAY_WAYS, g_opt.full ? 1 : ROUNDS);
            for (i = 0; i < RAY_WAYS; i++) {
                const wrong w = compare(&t[0], &t[i]);
                ray_line(kase, t, b, i, &w);
                if (i == 7) {
                    missed += w.missed;
                    extra += w.extra;
                    other += w.other;
                    rate[length][scene] = 1e-6 * bench_rate(&b[i], (double)count);
                }
                if (i == 8) any[length][scene] = 1e-6 * bench_rate(&b[i], (double)count);
            }
            free_ray_jobs(t);
            free(s.ray);
            free(s.normal);
        }
        voxrt_octree_destroy(octree);
        voxrt_tree_destroy(tree);
        voxrt_columns_destroy(c);
    }
    table_set("near", "%.1f / %.1f", rate[0][0], rate[0][1]);
    table_set("far", "%.1f / %.1f", rate[1][0], rate[1][1]);
    table_set("any", "%.1f / %.1f", any[0][0], any[0][1]);
    table_set("any_far", "%.1f / %.1f", any[1][0], any[1][1]);
    table_set("missed", "%zu of %.1e (%zu extra, %zu other cells)", missed, 4.0 * (double)count, extra, other);
}

/* ---- scenes of meshes ---- */

typedef struct world {
    const char *name;
    sup_mesh mesh;
    voxrt_gi *gi;
    voxrt_gi_light light[2];
    size_t lights;
    voxrt_camera camera;
    voxrt_gbuffer g;
    float *direct, *indirect;
} world;

static voxrt_mesh mesh_of(const sup_mesh *m) { /* with the normals of its triangles */
    voxrt_mesh out = sup_voxel_mesh(m);
    out.normals = NULL;
    return out;
}

static void make_gbuffer(world *w, uint32_t width, uint32_t height) {
    const size_t n = (size_t)width * height;
    w->g.width = width;
    w->g.height = height;
    w->g.position = (float *)must_alloc(n, 12);
    w->g.normal = (float *)must_alloc(n, 12);
    w->g.albedo = (float *)must_alloc(n, 12);
    w->direct = (float *)must_alloc(n, 12);
    w->indirect = (float *)must_alloc(n, 12);
    must(voxrt_gbuffer_from_gi(NULL, &w->camera, w->gi, &w->g), "gbuffer");
}

/* A room, scaled to sides of about 6 units, and one lamp in it. */
static void make_world(world *w, const char *name, uint32_t grid, uint32_t depth, uint32_t width, uint32_t height) {
    voxrt_gi_desc d;
    voxrt_gi_object o;
    float lo[3], hi[3], scale = 0.0f;
    const int cornell = strcmp(name, "cornell") == 0;
    size_t i;
    int a;
    memset(w, 0, sizeof *w);
    memset(&d, 0, sizeof d);
    memset(&o, 0, sizeof o);
    w->name = name;
    if (sup_scene_make(name, 0, &w->mesh) || sup_mesh_bounds(&w->mesh, lo, hi)) must(VOXRT_ERR_NO_MEMORY, name);
    for (a = 0; a < 3; a++) scale = fmaxf(scale, hi[a] - lo[a]);
    scale = 6.0f / scale;
    for (i = 0; i < 3 * w->mesh.vertex_count; i++) w->mesh.positions[i] = (w->mesh.positions[i] - lo[i % 3]) * scale;
    for (a = 0; a < 3; a++) {
        const double side = (double)((hi[a] - lo[a]) * scale);
        d.columns.box_min[a] = -0.012 * side;
        d.columns.box_max[a] = 1.012 * side;
        w->light[0].position[a] = (float)(side * (a == 1 ? 0.8 : a == 0 ? 0.45 : 0.6));
        w->camera.at[a] = (float)(side * (a == 2 ? 0.3 : 0.42));
        w->camera.eye[a] = (float)(side * (a == 2 ? (cornell ? 2.1 : 0.97) : a == 1 ? 0.45 : 0.5));
        w->light[0].color[a] = 12.0f;
    }
    w->camera.up[1] = 1.0f;
    w->camera.fov_y = cornell ? 40.0f : 62.0f;
    d.columns.size_x = d.columns.size_y = grid;
    d.columns.size_z = depth;
    d.env.thread_count = 1;
    must(voxrt_gi_create(&d, &w->gi), "scene");
    o.mesh = mesh_of(&w->mesh);
    o.still = 1;
    must(voxrt_gi_add(w->gi, &o, NULL), "object");
    w->lights = 1;
    must(voxrt_gi_set_lights(w->gi, w->light, w->lights), "lights");
    must(voxrt_gi_update(w->gi, NULL), "update");
    make_gbuffer(w, width, height);
}

static void free_world(world *w) {
    voxrt_gi_destroy(w->gi);
    sup_mesh_free(&w->mesh);
    free(w->g.position);
    free(w->g.normal);
    free(w->g.albedo);
    free(w->direct);
    free(w->indirect);
}

static voxrt_gi_render_desc render_desc(const world *w, uint32_t rays) {
    voxrt_gi_render_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.camera = w->camera;
    d.rays = rays;
    return d;
}

typedef struct light_job {
    world *w;
    voxrt_gi_render_desc d;
    baseline_light_desc base;     /* with rays: the thesis' way instead */
    uint32_t base_filter;
    int anew;                     /* as if light had changed: nothing is known of it on cells, in maps */
    uint32_t frames;              /* so many of still things, the later ones with what those before have found */
    float *out;
    voxrt_stats stats;
} light_job;

static void run_light(void *ctx) {
    light_job *j = (light_job *)ctx;
    const voxrt_gbuffer *g = &j->w->g;
    const size_t n = 3 * (size_t)g->width * g->height;
    voxrti_ask ask;
    size_t i;
    memset(&j->stats, 0, sizeof j->stats);
    if (j->anew) voxrti_gi_darken(j->w->gi);
    if (j->frames > 0) {
        voxrt_gi_render_desc d = j->d;
        must(voxrt_gi_history_create(NULL, &d.history), "history");
        for (i = 0; i < j->frames; i++, d.first_ray += d.rays)
            must(voxrt_gi_render(&d, j->w->gi, g, NULL, j->out, &j->stats), "light");
        voxrt_gi_history_destroy(d.history);
        return;
    }
    if (j->base.rays == 0) {
        must(voxrt_gi_render(&j->d, j->w->gi, g, NULL, j->out, &j->stats), "light");
        return;
    }
    baseline_light(j->w->gi, &j->base, g, j->out);
    voxrti_ask_open(&ask, &j->d.env, 1);
    if (j->base_filter != 0)
        must(voxrti_gi_filter_run(&ask, g, j->w->gi->columns->diagonal, j->base_filter, j->out, &j->w->gi->mem), "filter");
    for (i = 0; i < n; i++) j->out[i] *= g->albedo[i];
}

/* RMS of the difference, as a share of the mean of `want`, over pixels that see something. */
static double error_of(const world *w, const float *is, const float *want) {
    const size_t n = 3 * (size_t)w->g.width * w->g.height;
    double sum = 0.0, mean = 0.0, seen = 0.0;
    size_t i;
    for (i = 0; i < n; i++) {
        const float *m = w->g.normal + i / 3 * 3;
        if (!(m[0] * m[0] + m[1] * m[1] + m[2] * m[2] > 0.5f)) continue;
        sum += ((double)is[i] - (double)want[i]) * ((double)is[i] - (double)want[i]);
        mean += (double)want[i];
        seen += 1.0;
    }
    return sqrt(sum / seen) / (mean / seen);
}

static float *reference(world *w, voxrt_gi_method method, uint32_t bounces, float radius, uint32_t rays) {
    voxrt_gi_render_desc d = render_desc(w, rays);
    float *out = (float *)must_alloc((size_t)w->g.width * w->g.height, 12);
    d.method = method;
    d.bounces = bounces;
    d.radius = radius;
    d.first_ray = 1u << 20; /* other rays than those that are measured */
    d.env.thread_count = (uint32_t)g_opt.threads;
    must(voxrt_gi_render(&d, w->gi, &w->g, NULL, out, NULL), "reference");
    return out;
}

static light_job light_of(world *w, uint32_t rays) {
    light_job j;
    memset(&j, 0, sizeof j);
    j.w = w;
    j.d = render_desc(w, rays);
    j.out = (float *)must_alloc((size_t)w->g.width * w->g.height, 12);
    return j;
}
static light_job thesis_of(world *w, uint32_t rays, uint32_t bounces, float radius) {
    light_job j = light_of(w, rays);
    j.base.way = BASELINE_EPSILON;
    j.base.rays = rays;
    j.base.bounces = bounces;
    j.base.radius = radius > 0.0f ? radius : 100.0f;
    j.base.s_n = 1.0f;
    j.base.s_d = 0.0f;
    return j;
}

static double pixels_of(const world *w) { return (double)w->g.width * w->g.height; }

static void light_line(const char *bench, const char *kase, const light_job *j, const bench_job *b, double rays, double error) {
    bench_line(bench, kase, "time", 1e3 * bench_seconds(b), "ms");
    bench_num("best", 1e3 * bench_seconds_best(b));
    bench_num("error", error);
    bench_text("error_unit", "RMS / mean");
    one_thread(b);
    if (rays > 0.0) bench_num("rays_per_second", bench_rate(b, rays));
    bench_num("pixels", pixels_of(j->w));
    bench_hash(bench_hash_bytes(j->out, (size_t)pixels_of(j->w) * 12));
    bench_end();
}

/* ---- BM1, BM2: voxelising ---- */

typedef struct insert_job {
    voxrt_columns *columns;
    voxrt_mesh mesh;
    voxrt_columns_mode mode;
    const float *points;
    size_t count;
    double to_world[12];
} insert_job;

static void run_insert(void *ctx) {
    insert_job *j = (insert_job *)ctx;
    voxrt_columns_insert_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.mode = j->mode;
    memcpy(d.to_world, j->to_world, sizeof d.to_world);
    voxrt_columns_clear(j->columns, 1);
    if (j->points != NULL) must(voxrt_columns_insert_points(j->columns, &d, j->points, 0, j->count, NULL), "points");
    else must(voxrt_columns_insert(j->columns, &d, &j->mesh, NULL), "mesh");
}

/* Points on all triangles, at most `spacing` apart. */
static float *sample_mesh(const sup_mesh *m, float spacing, size_t *count) {
    float *out = NULL;
    size_t i, n = 0, room = 0;
    int pass;
    for (pass = 0; pass < 2; pass++) {
        n = 0;
        for (i = 0; i < m->triangle_count; i++) {
            const float *p[3];
            float u[3], v[3], lu = 0.0f, lv = 0.0f;
            int a, nu, nv, x, y;
            for (a = 0; a < 3; a++) p[a] = m->positions + 3 * (size_t)m->indices[3 * i + (size_t)a];
            for (a = 0; a < 3; a++) {
                u[a] = p[1][a] - p[0][a];
                v[a] = p[2][a] - p[0][a];
                lu += u[a] * u[a];
                lv += v[a] * v[a];
            }
            nu = (int)(sqrtf(lu) / spacing) + 1;
            nv = (int)(sqrtf(lv) / spacing) + 1;
            for (y = 0; y < nv; y++)
                for (x = 0; x < nu; x++) {
                    const float s = ((float)x + 0.5f) / (float)nu, t = ((float)y + 0.5f) / (float)nv;
                    if (s + t > 1.0f && nu > 1 && nv > 1) continue;
                    if (pass == 1) for (a = 0; a < 3; a++) out[3 * n + (size_t)a] = p[0][a] + fminf(s, 1 - t) * u[a] + t * v[a];
                    n++;
                }
        }
        room = n;
        if (pass == 0) out = (float *)must_alloc(room, 12);
    }
    *count = n;
    return out;
}

static void insert_lines(const char *name, const sup_mesh *m, uint32_t grid) {
    static const struct { const char *name; voxrt_columns_mode mode; int points; } kinds[6] = {
        {"thin", VOXRT_COLUMNS_THIN, 0}, {"fat", VOXRT_COLUMNS_FAT, 0}, {"raster", VOXRT_COLUMNS_RASTER, 0},
        {"solid", VOXRT_COLUMNS_SOLID, 0}, {"surface samples", VOXRT_COLUMNS_THIN, 1}, {"samples of the mesh", VOXRT_COLUMNS_SAMPLES, 0}
    };
    voxrt_columns *c = make_columns(grid, DEPTH);
    float lo[3], hi[3];
    insert_job t[6];
    bench_job b[6];
    double scale = 1e30;
    size_t n = 0, cells[2] = {0, 0};
    float *points;
    char kase[64];
    int i, a;
    (void)sup_mesh_bounds(m, lo, hi);
    memset(t, 0, sizeof t);
    memset(b, 0, sizeof b);
    for (a = 0; a < 3; a++) scale = fmin(scale, 0.97 * (double)c->size[a] / (double)(hi[a] - lo[a]));
    points = sample_mesh(m, (float)(0.7 / scale), &n);
    snprintf(kase, sizeof kase, "%s-%u", name, grid);
    for (i = 0; i < 6; i++) {
        t[i].columns = c;
        t[i].mesh = mesh_of(m);
        t[i].mode = kinds[i].mode;
        t[i].points = kinds[i].points ? points : NULL;
        t[i].count = n;
        for (a = 0; a < 3; a++) {
            t[i].to_world[5 * a] = scale;
            t[i].to_world[4 * a + 3] = 0.5 * (double)c->size[a] - scale * 0.5 * (double)(lo[a] + hi[a]);
        }
        b[i].name = kinds[i].name;
        b[i].run = run_insert;
        b[i].ctx = &t[i];
    }
    run_jobs(b, 6, ROUNDS);
    for (i = 0; i < 6; i++) {
        voxrt_columns_info info;
        const double work = kinds[i].points ? (double)n : (double)m->triangle_count;
        run_insert(&t[i]);
        voxrt_columns_get_info(c, &info);
        if (i == 0) cells[0] = (size_t)info.cells;
        cells[1] = (size_t)info.cells;
        bench_line("voxrt.columns.insert", kase, kinds[i].points ? "points_per_second" : "triangles_per_second",
                   bench_rate(&b[i], work), "1/s");
        bench_num("best", bench_rate_best(&b[i], work));
        bench_num("error", (double)info.cells - (double)cells[0]);
        bench_text("error_unit", "cells more than thin");
        one_thread(&b[i]);
        bench_num("items", work);
        bench_num("cells", (double)info.cells);
        bench_num("ms", 1e3 * bench_seconds(&b[i]));
        bench_hash(bench_hash_bytes(c->bits, (size_t)grid * grid * c->words * 4));
        bench_end();
        if (i == 4 && grid == GRID) table_set("points", "%.0f", 1e-6 * bench_rate(&b[i], work));
    }
    free(points);
    voxrt_columns_destroy(c);
}

typedef struct move_job { world *w; voxrt_gi_object o; uint32_t id[9], count, frame; } move_job;

static void run_move(void *ctx) {
    move_job *j = (move_job *)ctx;
    uint32_t i;
    j->frame++;
    for (i = 0; i < j->count; i++) {
        voxrt_gi_object o = j->o;
        o.to_world[0] = o.to_world[5] = o.to_world[10] = 0.4;
        o.to_world[3] = 1.0 + 0.5 * i + 0.01 * (j->frame % 10);
        o.to_world[7] = 1.5;
        o.to_world[11] = 2.0 + 0.3 * (i % 3);
        must(voxrt_gi_set(j->w->gi, j->id[i], &o), "object");
    }
    must(voxrt_gi_update(j->w->gi, NULL), "update");
}

static void bm1(void) {
    sup_mesh blob;
    world w;
    uint32_t many;
    if (sup_scene_make("blob", 118, &blob)) must(VOXRT_ERR_NO_MEMORY, "blob");
    insert_lines("blob", &blob, GRID);
    if (g_opt.full) insert_lines("blob", &blob, 512);
    sup_mesh_free(&blob);
    if (sup_scene_make("torus", 92, &blob)) must(VOXRT_ERR_NO_MEMORY, "torus");
    for (many = 3; many <= 9; many += 6) { /* in a room that stays */
        move_job t;
        bench_job b[2];
        voxrt_gi_update_stats st;
        int way;
        make_world(&w, "pillars", GRID, DEPTH, 8, 8);
        memset(&t, 0, sizeof t);
        memset(b, 0, sizeof b);
        t.w = &w;
        t.o.mesh = mesh_of(&blob);
        t.count = many;
        for (uint32_t i = 0; i < many; i++) must(voxrt_gi_add(w.gi, &t.o, &t.id[i]), "object");
        for (way = 0; way < 2; way++) {
            b[way].name = way ? "samples, attributes" : "thin, attributes";
            b[way].run = run_move;
            b[way].ctx = &t;
            t.o.mode = way ? VOXRT_COLUMNS_SAMPLES : VOXRT_COLUMNS_THIN;
            run_jobs(&b[way], 1, ROUNDS);
            must(voxrt_gi_update(w.gi, &st), "update");
            bench_line("voxrt.gi.update", many == 3 ? "pillars, 3 objects move" : "pillars, 9 objects move", "time",
                       1e3 * bench_seconds(&b[way]), "ms");
            bench_num("best", 1e3 * bench_seconds_best(&b[way]));
            bench_num("triangles", (double)many * (double)blob.triangle_count);
            bench_num("moving_cells", (double)st.moving_cells);
            bench_num("still_cells", (double)st.still_cells);
            one_thread(&b[way]);
            bench_end();
        }
        free_world(&w);
    }
    sup_mesh_free(&blob);
}

typedef struct update_job { voxrt_columns *columns; const float *points; size_t count; int all; } update_job;

static void run_update(void *ctx) {
    update_job *j = (update_job *)ctx;
    voxrt_columns_insert_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    if (j->all) {
        j->columns->all_changed = 1;
    } else {
        must(voxrt_columns_insert_points(j->columns, &d, j->points, 0, j->count, NULL), "points");
    }
    voxrt_columns_update(j->columns);
    if (!j->all) {
        voxrt_columns_clear(j->columns, 0);
        voxrt_columns_update(j->columns);
    }
}

static void bm2(void) {
    voxrt_columns *c = make_volume(0);
    update_job t[2];
    bench_job b[2];
    float *p = (float *)must_alloc(4000, 12);
    bench_rng rng = {5};
    int i;
    memset(t, 0, sizeof t);
    memset(b, 0, sizeof b);
    for (i = 0; i < 4000; i++) { /* a ball */
        float n[3] = {0, 0, 1}, v[3];
        bench_cosine(&rng, n, v);
        for (int a = 0; a < 3; a++) p[3 * i + a] = 60.5f + 15.0f * v[a];
    }
    for (i = 0; i < 2; i++) {
        t[i].columns = c;
        t[i].all = i == 0;
        t[i].points = p;
        t[i].count = 4000;
        b[i].name = i == 0 ? "all" : "4000 points in, update, out, update";
        b[i].run = run_update;
        b[i].ctx = &t[i];
    }
    run_jobs(b, 2, 15);
    for (i = 0; i < 2; i++) {
        bench_line("voxrt.columns.update", "hall", "time", 1e3 * bench_seconds(&b[i]), "ms");
        bench_num("best", 1e3 * bench_seconds_best(&b[i]));
        one_thread(&b[i]);
        bench_end();
    }
    table_set("update", "%.3f", 1e3 * bench_seconds(&b[0]));
    free(p);
    voxrt_columns_destroy(c);
}

/* ---- BM4, BM5, BM6: light ---- */

static void picture_size(uint32_t *w, uint32_t *h) {
    *w = g_opt.full ? 768 : 144;
    *h = g_opt.full ? 512 : 96;
}

static void bm4(void) {
    static const char *const names[5] = {"cache", "shadow rays", "volume", "maps", "thesis' stepping and offsets"};
    static const voxrt_gi_lookup lookup[4] = {VOXRT_GI_LOOKUP_CACHE, VOXRT_GI_LOOKUP_RAYS, VOXRT_GI_LOOKUP_VOLUME,
                                              VOXRT_GI_LOOKUP_MAPS};
    world w;
    uint32_t width, height;
    int r, i;
    picture_size(&width, &height);
    make_world(&w, "cornell", GRID, DEPTH, width, height);
    for (r = g_opt.full ? 0 : 2; r < 3; r++) {
        const float radius = r == 0 ? 2.0f : r == 1 ? 4.0f : 8.0f;
        float *want = reference(&w, VOXRT_GI_GATHER, 1, radius, g_opt.full ? 1024 : 256);
        light_job t[5];
        bench_job b[5];
        char kase[64];
        memset(b, 0, sizeof b);
        snprintf(kase, sizeof kase, "cornell, 16 rays, R=%.0f", (double)radius);
        for (i = 0; i < 5; i++) {
            t[i] = i < 4 ? light_of(&w, 16) : thesis_of(&w, 16, 1, radius);
            t[i].d.radius = radius;
            if (i < 4) t[i].d.lookup = lookup[i];
            b[i].name = names[i];
            b[i].run = run_light;
            b[i].ctx = &t[i];
        }
        run_jobs(b, 5, ROUNDS);
        for (i = 0; i < 5; i++) {
            light_line("voxrt.gi.gather", kase, &t[i], &b[i], 16.0 * pixels_of(&w), error_of(&w, t[i].out, want));
            free(t[i].out);
        }
        if (r == 2) table_set("gather", "%.1f (%.1f, %.1f 10^6 rays/s)", bench_ratio(&b[4], &b[0]),
                              1e-6 * bench_rate(&b[0], 16.0 * pixels_of(&w)), 1e-6 * bench_rate(&b[4], 16.0 * pixels_of(&w)));
        memset(b, 0, sizeof b);
        for (i = 0; i < 4; i++) { /* the first picture after lamps or objects have moved */
            t[i] = light_of(&w, 16);
            t[i].d.radius = radius;
            t[i].d.lookup = lookup[i];
            t[i].anew = 1;
            b[i].name = names[i];
            b[i].run = run_light;
            b[i].ctx = &t[i];
        }
        snprintf(kase, sizeof kase, "cornell, 16 rays, R=%.0f, light has changed", (double)radius);
        run_jobs(b, 4, 3);
        for (i = 0; i < 4; i++) {
            light_line("voxrt.gi.gather", kase, &t[i], &b[i], 16.0 * pixels_of(&w), error_of(&w, t[i].out, want));
            free(t[i].out);
        }
        free(want);
    }
    free_world(&w);
}

static void bm5(void) {
    static const uint32_t many[4] = {1, 4, 16, 32};
    world w;
    uint32_t width, height;
    float *want;
    light_job t[4];
    bench_job b[4];
    int i;
    picture_size(&width, &height);
    make_world(&w, "cornell", GRID, DEPTH, width, height);
    want = reference(&w, VOXRT_GI_GATHER, 1, 0.0f, 256);
    memset(b, 0, sizeof b);
    for (i = 0; i < 4; i++) {
        t[i] = light_of(&w, many[i]);
        t[i].d.method = VOXRT_GI_VPL;
        b[i].name = "virtual lights, 4 x 4";
        b[i].run = run_light;
        b[i].ctx = &t[i];
    }
    run_jobs(b, 4, 3);
    for (i = 0; i < 4; i++) {
        char kase[64];
        snprintf(kase, sizeof kase, "cornell, %u lights a pixel", many[i]);
        light_line("voxrt.gi.virtual", kase, &t[i], &b[i], (double)many[i] * pixels_of(&w), error_of(&w, t[i].out, want));
        free(t[i].out);
    }
    free(want);
    free_world(&w);
}

static void bm6(void) {
    world w;
    uint32_t width, height, bounces;
    picture_size(&width, &height);
    make_world(&w, "cornell", GRID, DEPTH, width, height);
    for (bounces = 1; bounces <= 3; bounces++) {
        float *want = reference(&w, VOXRT_GI_PATH, bounces, 0.0f, g_opt.full ? 512 : 32);
        light_job t[2];
        bench_job b[2];
        char kase[64];
        int i;
        memset(b, 0, sizeof b);
        snprintf(kase, sizeof kase, "cornell, %u bounces", bounces);
        t[0] = light_of(&w, 16);
        t[0].d.method = VOXRT_GI_PATH;
        t[0].d.bounces = bounces;
        t[1] = thesis_of(&w, 16, bounces, 0.0f);
        for (i = 0; i < 2; i++) {
            b[i].name = i == 0 ? "paths" : "thesis' stepping and offsets";
            b[i].run = run_light;
            b[i].ctx = &t[i];
        }
        run_jobs(b, 2, 3);
        for (i = 0; i < 2; i++)
            light_line("voxrt.gi.paths", kase, &t[i], &b[i], 16.0 * bounces * pixels_of(&w), error_of(&w, t[i].out, want));
        if (bounces == 2) table_set("path", "%.1f", bench_ratio(&b[1], &b[0]));
        for (i = 0; i < 2; i++) free(t[i].out);
        free(want);
    }
    free_world(&w);
    for (int size = 2; size <= 4; size++) { /* twice and four times as many pixels */
        light_job t[3];
        bench_job b[3];
        memset(b, 0, sizeof b);
        make_world(&w, "cornell", GRID, DEPTH, width * (uint32_t)size / 3, height * (uint32_t)size / 3);
        for (int i = 0; i < 3; i++) {
            t[i] = light_of(&w, 16);
            t[i].d.method = VOXRT_GI_PATH;
            t[i].d.bounces = (uint32_t)i + 1;
            b[i].name = "paths";
            b[i].run = run_light;
            b[i].ctx = &t[i];
        }
        run_light(&t[2]); /* light on cells is known then */
        run_jobs(b, 3, 3);
        for (int i = 0; i < 3; i++) {
            char kase[64];
            snprintf(kase, sizeof kase, "cornell, %d bounces, %u x %u pixels", i + 1, w.g.width, w.g.height);
            bench_line("voxrt.gi.sizes", kase, "time_per_pixel", 1e6 * bench_seconds(&b[i]) / pixels_of(&w), "us");
            bench_num("ms", 1e3 * bench_seconds(&b[i]));
            bench_num("times_one_bounce", bench_ratio(&b[i], &b[0]));
            one_thread(&b[i]);
            bench_num("pixels", pixels_of(&w));
            bench_end();
            free(t[i].out);
        }
        free_world(&w);
    }
}

/* ---- BM7: closed forms ---- */

static void add_quad(sup_mesh *m, const double p[4][3]) {
    const uint32_t v = (uint32_t)m->vertex_count, t[6] = {v, v + 1, v + 2, v, v + 2, v + 3};
    for (int i = 0; i < 12; i++) m->positions[3 * m->vertex_count + (size_t)i] = (float)p[i / 3][i % 3];
    memcpy(m->indices + 3 * m->triangle_count, t, sizeof t);
    m->vertex_count += 4;
    m->triangle_count += 2;
}

static voxrt_gi *closed_scene(const sup_mesh *m, double half, double lamp_x, double power) {
    voxrt_gi_desc d;
    voxrt_gi_object o;
    voxrt_gi_light l;
    voxrt_gi *gi = NULL;
    memset(&d, 0, sizeof d);
    memset(&o, 0, sizeof o);
    memset(&l, 0, sizeof l);
    for (int a = 0; a < 3; a++) {
        d.columns.box_min[a] = -half;
        d.columns.box_max[a] = half;
        o.material.albedo[a] = 0.5f;
        l.color[a] = (float)power;
    }
    d.columns.depth_axis_plus_1 = 3;
    l.position[0] = (float)lamp_x;
    must(voxrt_gi_create(&d, &gi), "scene");
    o.mesh = mesh_of(m);
    o.still = 1;
    must(voxrt_gi_add(gi, &o, NULL), "object");
    must(voxrt_gi_set_lights(gi, &l, 1), "lights");
    must(voxrt_gi_update(gi, NULL), "update");
    return gi;
}

/* Points of g are somewhere on a sphere of radius r and look inwards. */
static voxrt_gbuffer sphere_points(uint32_t count, double r) {
    bench_rng rng = {11};
    voxrt_gbuffer g;
    memset(&g, 0, sizeof g);
    g.width = count;
    g.height = 1;
    g.position = (float *)must_alloc(count, 12);
    g.normal = (float *)must_alloc(count, 12);
    g.albedo = (float *)must_alloc(count, 12);
    for (uint32_t i = 0; i < count; i++) {
        float v[3];
        do {
            for (int a = 0; a < 3; a++) v[a] = 2.0f * bench_random(&rng) - 1.0f;
        } while (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > 1.0f || v[0] * v[0] + v[1] * v[1] + v[2] * v[2] < 0.01f);
        bench_unit(v);
        for (int a = 0; a < 3; a++) {
            g.position[3 * i + (uint32_t)a] = (float)r * v[a];
            g.normal[3 * i + (uint32_t)a] = -v[a];
            g.albedo[3 * i + (uint32_t)a] = 1.0f;
        }
    }
    return g;
}

static void quality_line(const char *kase, double error, const char *unit) {
    bench_line("voxrt.gi.closed_forms", kase, "error", error, unit);
    bench_num("error", error);
    bench_text("error_unit", unit);
    bench_end();
}

enum { BM7_POINTS = 512 };

static void inside_out_sphere(double r, sup_mesh *m) {
    if (sup_scene_make("sphere", 96, m)) must(VOXRT_ERR_NO_MEMORY, "sphere");
    for (size_t v = 0; v < m->vertex_count; v++) {
        bench_unit(m->positions + 3 * v);
        for (int k = 0; k < 3; k++) m->positions[3 * v + (size_t)k] *= (float)r;
    }
    for (size_t t = 0; t < m->triangle_count; t++) {
        const uint32_t b = m->indices[3 * t + 1];
        m->indices[3 * t + 1] = m->indices[3 * t + 2];
        m->indices[3 * t + 2] = b;
    }
    free(m->vertex_rgb);
    free(m->triangle_rgb);
    m->vertex_rgb = m->triangle_rgb = NULL;
}

/* Light of one to three bounces in a closed sphere with the lamp in its middle. */
static void light_in_sphere(voxrt_gi_render_desc d, double r, const voxrt_gbuffer *g, float *out) {
    double error[3];
    sup_mesh m;
    voxrt_gi *gi;
    inside_out_sphere(r, &m);
    gi = closed_scene(&m, 10.0, 0.0, r * r);
    for (int k = 1; k <= 3; k++) {
        char kase[64];
        const double q = pow(floor(sqrt(0.5) * 255.0 + 0.5) / 255.0, 2.0), want = q * (1.0 - pow(q, k)) / (1.0 - q);
        double sum = 0.0;
        d.method = k == 1 ? VOXRT_GI_GATHER : VOXRT_GI_PATH;
        d.bounces = (uint32_t)k;
        must(voxrt_gi_render(&d, gi, g, NULL, out, NULL), "light");
        for (int i = 0; i < BM7_POINTS; i++) sum += 3.14159265358979 * (double)out[3 * i] / BM7_POINTS;
        error[k - 1] = 100.0 * (sum / want - 1.0);
        snprintf(kase, sizeof kase, "closed sphere, %d bounces", k);
        quality_line(kase, error[k - 1], "%");
    }
    table_set("sphere", "%+.2f / %+.2f / %+.2f", error[0], error[1], error[2]);
    voxrt_gi_destroy(gi);
    sup_mesh_free(&m);
}

/* A kerb: cells as they are set, rays from a floor beside it. */
static void dark_beside_kerb(void) {
    voxrt_columns *c = make_columns(128, 128);
    voxrti_insert in;
    bench_rng rng = {5};
    const float up[3] = {0, 0, 1};
    double hidden[2];
    memset(&in, 0, sizeof in);
    in.columns = c;
    for (uint32_t y = 0; y < 128; y++)
        for (uint32_t x = 0; x < 128; x++) {
            voxrti_insert_run(&in, x, y, 20, 20);
            if (x >= 24 && x <= 30) voxrti_insert_run(&in, x, y, 20, 22);
        }
    voxrt_columns_update(c);
    for (int k = 0; k < 2; k++) {
        const double a = k == 0 ? 0.7 : 1.7, want = 0.5 * (1.0 - a / sqrt(a * a + 2.7 * 2.7));
        const int many = g_opt.full ? 1000000 : 200000;
        double hits = 0.0;
        voxrt_columns_trace_desc t;
        char kase[64];
        memset(&t, 0, sizeof t);
        t.normals = up;
        for (int i = 0; i < many; i++) {
            voxrt_ray ray;
            uint8_t dark;
            bench_cosine(&rng, up, ray.dir);
            ray.org[0] = (float)(31.0 + a);
            ray.org[1] = 64.0f + bench_random(&rng);
            ray.org[2] = 20.3f;
            ray.t_min = 0.0f;
            ray.t_max = 40.0f;
            must(voxrt_columns_occluded(c, &t, &ray, &dark, 1), "rays");
            hits += dark;
        }
        hidden[k] = hits / many - want;
        snprintf(kase, sizeof kase, "kerb of 2.7 cells, %.1f cells away", a);
        quality_line(kase, hidden[k], "share of the hemisphere");
    }
    table_set("kerb", "%+.4f / %+.4f", hidden[0], hidden[1]);
    voxrt_columns_destroy(c);
}

/* A room of +-9 with its floor at y = low, a wall of 0.1 cells at x = 0.013. */
static void room_with_wall(double cell, double low, sup_mesh *m) {
    double p[4][3];
    memset(m, 0, sizeof *m);
    m->positions = (float *)must_alloc(64, 12);
    m->indices = (uint32_t *)must_alloc(64, 12);
    for (int k = 0; k < 8; k++)
        for (int i = 0; i < 4; i++) {
            const int axis = k < 6 ? k / 2 : 0, u = (axis + 1) % 3, v = (axis + 2) % 3, side = k & 1;
            const int corner = k < 6 && !side ? i : 3 - i;
            p[i][axis] = k < 6 ? (side ? 9.0 : -9.0) : 0.013 + (k == 7 ? 0.1 * cell : 0.0);
            if (k >= 6) {
                p[i][u] = (k == 6 ? 3 - i : i) % 3 == 0 ? -9.0 : 9.0;
                p[i][v] = (k == 6 ? 3 - i : i) < 2 ? -9.0 : 9.0;
            } else {
                p[i][u] = corner % 3 == 0 ? -9.0 : 9.0;
                p[i][v] = corner < 2 ? -9.0 : 9.0;
            }
            p[i][1] = p[i][1] < 0.0 ? low : p[i][1];
            if (i == 3) add_quad(m, (const double (*)[3])p);
        }
}

/* Points of the floor on both sides of the wall, odd ones on that of no lamp; every fourth at the wall's foot there. */
static void points_beside_wall(double cell, double low, voxrt_gbuffer *g) {
    for (int i = 0; i < BM7_POINTS; i++) {
        bench_rng rng = {(uint64_t)i + 1};
        float *q = g->position + 3 * i, *n = g->normal + 3 * i;
        q[0] = (float)(i & 1 ? 1.0 : -1.0) * (0.4f + 8.0f * bench_random(&rng));
        if (i % 4 == 3) q[0] = 0.013f + (float)cell * (0.6f + 4.4f * bench_random(&rng));
        q[1] = (float)low;
        q[2] = 16.0f * bench_random(&rng) - 8.0f;
        n[0] = n[2] = 0.0f;
        n[1] = 1.0f;
    }
}

/* The lamp is on one side of the wall: light on the other side. What reaches its foot goes through the cells that floor and
   wall have in common, so it depends on where the floor lies in them: at 0.8 of a cell, and at 0.4 and 0.02. */
static void light_through_wall(voxrt_gi_render_desc d, voxrt_gbuffer *g, float *out) {
    static const double within[3] = {0.8, 0.4, 0.02};
    const double cell = 20.0 / GRID;
    double at_foot[3] = {0, 0, 0}, whole = 0.0;
    float *direct = (float *)must_alloc(BM7_POINTS, 12);
    d.method = VOXRT_GI_GATHER;
    d.bounces = 3;
    for (int place = 0; place < 3; place++) {
        const double low = (12.0 + within[place]) * cell - 10.0;
        double lit = 0.0, dark = 0.0, foot = 0.0;
        char kase[96];
        sup_mesh m;
        voxrt_gi *gi;
        room_with_wall(cell, low, &m);
        gi = closed_scene(&m, 10.0, -5.0, 100.0);
        must(voxrt_gi_bounce(gi, NULL, 32, 0.0f, 1), "bounce");
        points_beside_wall(cell, low, g);
        must(voxrt_gi_render(&d, gi, g, direct, out, NULL), "light");
        for (int i = 0; i < BM7_POINTS; i++)
            *(i % 4 == 3 ? &foot : i & 1 ? &dark : &lit) += ((double)out[3 * i] + (double)direct[3 * i]) * (i & 1 ? 2.0 : 1.0);
        snprintf(kase, sizeof kase, "light through a wall of 0.1 cells, floor at %.2f of its cell", within[place]);
        quality_line(kase, 100.0 * dark / lit, "%");
        snprintf(kase, sizeof kase, "the same at its foot, floor at %.2f of its cell", within[place]);
        quality_line(kase, 100.0 * foot / lit, "%");
        whole = fmax(whole, 100.0 * dark / lit);
        at_foot[place] = 100.0 * foot / lit;
        voxrt_gi_destroy(gi);
        sup_mesh_free(&m);
    }
    table_set("leak", "%.3f (%.2f, %.2f, %.2f)", whole, at_foot[0], at_foot[1], at_foot[2]);
    free(direct);
}

static void bm7(void) {
    const double r = 9.0;
    voxrt_gi_render_desc d;
    voxrt_gbuffer g = sphere_points(BM7_POINTS, r);
    float *out = (float *)must_alloc(BM7_POINTS, 12);
    memset(&d, 0, sizeof d);
    d.rays = 512;
    d.env.thread_count = 1;
    light_in_sphere(d, r, &g, out);
    dark_beside_kerb();
    light_through_wall(d, &g, out);
    free(g.position);
    free(g.normal);
    free(g.albedo);
    free(out);
}

/* ---- BM8, BM9 ---- */

static void variants(const char *bench, int filters) {
    world w;
    uint32_t width, height;
    float *want;
    light_job t[5];
    bench_job b[5];
    int i;
    picture_size(&width, &height);
    make_world(&w, "cornell", GRID, DEPTH, width, height);
    want = reference(&w, VOXRT_GI_GATHER, 1, 0.0f, 256);
    memset(b, 0, sizeof b);
    for (i = 0; i < 5; i++) {
        t[i] = light_of(&w, filters ? 8 : 64);
        if (filters) t[i].d.filter = (uint32_t)i * (i > 2 ? 3u : 2u);
        else t[i].d.coarse = 1u << i;
        b[i].name = filters ? "8 rays, filter" : "64 rays, coarse mesh";
        b[i].run = run_light;
        b[i].ctx = &t[i];
    }
    run_jobs(b, 5, 3);
    for (i = 0; i < 5; i++) {
        char kase[64];
        if (filters) snprintf(kase, sizeof kase, "cornell, radius %u", t[i].d.filter);
        else snprintf(kase, sizeof kase, "cornell, %u x %u pixels", t[i].d.coarse, t[i].d.coarse);
        light_line(bench, kase, &t[i], &b[i], 0.0, error_of(&w, t[i].out, want));
        free(t[i].out);
    }
    free(want);
    free_world(&w);
}
static void bm8(void) { variants("voxrt.gi.coarse", 0); }
static void bm9(void) { variants("voxrt.gi.filter", 1); }

/* ---- BM10: error against time ---- */

/* The picture that counts has 768 x 512 pixels: in smaller ones filters of so many pixels reach farther. Errors are looked
   at in one of SPARSE x SPARSE of them, so that there is time for a reference with little noise of its own. */
enum { SPARSE = 8 };

static double sparse_error(const world *w, const float *is, const float *want) {
    double sum = 0.0, mean = 0.0, seen = 0.0;
    for (uint32_t y = SPARSE / 2; y < w->g.height; y += SPARSE)
        for (uint32_t x = SPARSE / 2; x < w->g.width; x += SPARSE) {
            const size_t at = 3 * ((size_t)y * w->g.width + x);
            const float *m = w->g.normal + at;
            if (!(m[0] * m[0] + m[1] * m[1] + m[2] * m[2] > 0.5f)) continue;
            for (size_t a = at; a < at + 3; a++) {
                sum += ((double)is[a] - (double)want[a]) * ((double)is[a] - (double)want[a]);
                mean += (double)want[a];
            }
            seen += 3.0;
        }
    return sqrt(sum / seen) / (mean / seen);
}

static float *sparse_reference(world *w, uint32_t rays, uint32_t first) {
    voxrt_gi_render_desc d = render_desc(w, rays);
    voxrt_gbuffer g = w->g;
    const size_t n = (size_t)g.width * g.height;
    float *out = (float *)must_alloc(n, 12);
    g.normal = (float *)must_alloc(n, 12);
    for (uint32_t y = SPARSE / 2; y < g.height; y += SPARSE)
        for (uint32_t x = SPARSE / 2; x < g.width; x += SPARSE) {
            const size_t at = 3 * ((size_t)y * g.width + x);
            memcpy(g.normal + at, w->g.normal + at, 12);
        }
    d.first_ray = first;
    d.env.thread_count = (uint32_t)g_opt.threads;
    must(voxrt_gi_render(&d, w->gi, &g, NULL, out, NULL), "reference");
    free(g.normal);
    return out;
}

typedef enum way {
    WAY_GATHER, WAY_THESIS, WAY_THESIS_LIGHTS, WAY_LIGHTS, WAY_PATHS, WAY_FRAMES, WAY_NOISE /* rays: as many pictures; 1/1000 */
} way;
typedef struct setting { uint32_t rays, filter, coarse; way way; } setting;

static const char *setting_name(const setting *s) {
    switch (s->way) {
    case WAY_THESIS: return "thesis, filter";
    case WAY_THESIS_LIGHTS: return "virtual lights as in the thesis, filter";
    case WAY_LIGHTS: return "virtual lights, filter";
    case WAY_PATHS: return "paths, filter";
    case WAY_FRAMES: return "history, pictures of 4 rays, filter";
    case WAY_NOISE: return "as much noise as asked for, filter";
    case WAY_GATHER: break;
    }
    return s->coarse > 1 ? "coarse mesh and filter" : s->filter == 0 ? "gathering" :
        s->filter < 6 ? "gathering, filter 3 or 4" : "gathering, filter 6";
}

static light_job setting_job(world *w, const setting *s) {
    light_job j = s->way == WAY_THESIS ? thesis_of(w, s->rays, 1, 0.0f) : light_of(w, s->rays);
    if (s->way == WAY_THESIS) j.base_filter = s->filter;
    else j.d.filter = s->filter;
    j.d.coarse = s->coarse;
    if (s->way == WAY_LIGHTS || s->way == WAY_THESIS_LIGHTS) j.d.method = VOXRT_GI_VPL;
    if (s->way == WAY_THESIS_LIGHTS) j.d.d_min = (float)(16.0 * w->gi->columns->diagonal * w->gi->columns->diagonal);
    if (s->way == WAY_PATHS) j.d.method = VOXRT_GI_PATH;
    if (s->way == WAY_FRAMES) {
        j.frames = s->rays;
        j.d.rays = 4;
    }
    if (s->way == WAY_NOISE) {
        j.d.tolerance = 1e-3f * (float)s->rays;
        j.d.rays = 0;
    }
    return j;
}

static void error_scene(const char *name, double *share) {
    static const setting settings[] = {
        {32, 3, 1, WAY_THESIS}, {1, 6, 1, WAY_GATHER}, {2, 6, 1, WAY_GATHER}, {4, 6, 1, WAY_GATHER}, {6, 6, 1, WAY_GATHER},
        {8, 6, 1, WAY_GATHER}, {8, 4, 1, WAY_GATHER}, {16, 3, 1, WAY_GATHER},
        {1, 3, 1, WAY_THESIS}, {4, 3, 1, WAY_THESIS}, {16, 3, 1, WAY_THESIS}, {1, 3, 1, WAY_GATHER}, {4, 3, 1, WAY_GATHER},
        {1, 0, 1, WAY_GATHER}, {8, 0, 1, WAY_GATHER}, {4, 3, 8, WAY_GATHER}, {16, 3, 8, WAY_GATHER}, {64, 3, 8, WAY_GATHER},
        {4, 3, 1, WAY_THESIS_LIGHTS}, {24, 3, 1, WAY_THESIS_LIGHTS}, {4, 3, 1, WAY_LIGHTS}, {24, 3, 1, WAY_LIGHTS},
        {1, 6, 1, WAY_PATHS}, {4, 6, 1, WAY_PATHS}, {16, 6, 1, WAY_PATHS},
        {1, 3, 1, WAY_FRAMES}, {4, 3, 1, WAY_FRAMES}, {16, 3, 1, WAY_FRAMES},
        {200, 3, 1, WAY_NOISE}, {100, 3, 1, WAY_NOISE}, {50, 3, 1, WAY_NOISE}
    };
    enum { COUNT = sizeof settings / sizeof settings[0], GATE = 8 }; /* the first ones count for the table */
    world w;
    float *want, *other;
    light_job t[COUNT];
    bench_job b[COUNT];
    double goal, own, best = 0.0, error[COUNT];
    int i, at = -1;
    make_world(&w, name, GRID, DEPTH, 768, 512);
    want = sparse_reference(&w, g_opt.full ? 8192 : 2048, 1u << 20);
    other = sparse_reference(&w, g_opt.full ? 8192 : 2048, 2u << 20);
    own = sparse_error(&w, other, want) / sqrt(2.0);
    memset(b, 0, sizeof b);
    for (i = 0; i < COUNT; i++) {
        t[i] = setting_job(&w, &settings[i]);
        b[i].name = setting_name(&settings[i]);
        b[i].run = run_light;
        b[i].ctx = &t[i];
    }
    run_jobs(b, GATE, g_opt.full ? 3 : 1);
    run_jobs(b + GATE, COUNT - GATE, 1);
    for (i = 0; i < COUNT; i++) error[i] = sparse_error(&w, t[i].out, want);
    goal = error[0];
    for (i = 0; i < COUNT; i++) {
        const setting *s = &settings[i];
        bench_line("voxrt.gi.error", name, "picture", 1e3 * bench_seconds(&b[i]), "ms");
        bench_num("best", 1e3 * bench_seconds_best(&b[i]));
        bench_num("error", error[i]);
        bench_text("error_unit", "RMS / mean");
        one_thread(&b[i]);
        bench_num("rays", s->way == WAY_FRAMES || s->way == WAY_NOISE ? t[i].d.rays : s->rays);
        bench_num("frames", t[i].frames);
        bench_num("tolerance", (double)t[i].d.tolerance);
        bench_num("filter", s->filter);
        bench_num("coarse", s->coarse);
        bench_num("pixels", pixels_of(&w));
        bench_hash(bench_hash_bytes(t[i].out, (size_t)pixels_of(&w) * 12));
        bench_end();
        if (i > 0 && i < GATE && error[i] <= goal && bench_ratio(&b[0], &b[i]) > best) {
            at = i;
            best = bench_ratio(&b[0], &b[i]);
        }
    }
    *share = best;
    bench_line("voxrt.gi.error", name, "times_faster_to_the_thesis_error", best, "");
    bench_num("error", goal);
    bench_text("error_unit", "RMS / mean");
    bench_num("error_of_the_reference", own);
    bench_num("thesis_ms", 1e3 * bench_seconds(&b[0]));
    if (at >= 0) {
        bench_num("ms", 1e3 * bench_seconds(&b[at]));
        t[at].anew = 1;
        run_jobs(&b[at], 1, 1);
        bench_num("ms_light_changed", 1e3 * bench_seconds(&b[at]));
        bench_num("ours", error[at]);
        bench_num("rays", settings[at].rays);
        bench_num("filter", settings[at].filter);
    }
    bench_end();
    for (i = 0; i < COUNT; i++) free(t[i].out);
    free(want);
    free(other);
    free_world(&w);
}

static void bm10(void) {
    double a, b;
    error_scene("cornell", &a);
    error_scene("pillars", &b);
    if (a > 0.0 && b > 0.0) table_set("default", "1/%.1f, 1/%.1f", a, b);
    else table_set("default", "%s", "not reached"); /* by no setting that was tried */
}

/* ---- BM11, BM12, BM13 ---- */

static void bm11(void) {
    static const char *const names[2] = {"cornell", "pillars"};
    int i;
    for (i = 0; i < 2; i++) {
        world w;
        voxrt_gi_update_stats st;
        make_world(&w, names[i], GRID, DEPTH, 8, 8);
        must(voxrt_gi_update(w.gi, &st), "update");
        bench_line("voxrt.gi.memory", names[i], "bytes", (double)st.bytes, "");
        bench_num("cells", (double)(st.still_cells + st.moving_cells));
        bench_num("thesis_three_volumes_16_bit", 3.0 * 6.0 * GRID * GRID * DEPTH);
        bench_num("columns_and_hierarchy", (double)GRID * GRID * DEPTH / 8.0 * 4.0 / 3.0);
        bench_end();
        free_world(&w);
    }
}

static void bm12(void) {
    world w;
    uint32_t width, height;
    light_job t[2];
    bench_job b[2];
    int i;
    picture_size(&width, &height);
    make_world(&w, "cornell", GRID, DEPTH, width, height);
    memset(b, 0, sizeof b);
    for (i = 0; i < 2; i++) {
        t[i] = light_of(&w, 16);
        t[i].d.env.thread_count = i == 0 ? 1u : (uint32_t)g_opt.threads;
        b[i].name = "gathering";
        b[i].run = run_light;
        b[i].ctx = &t[i];
    }
    bench_interleave(b, 2, ROUNDS);
    for (i = 0; i < 2; i++) {
        bench_line("voxrt.gi.threads", "cornell, 16 rays", "wall_time", 1e3 * bench_median(b[i].wall, b[i].rounds), "ms");
        bench_num("threads", t[i].d.env.thread_count);
        bench_num("times_one_thread", bench_median(b[0].wall, b[0].rounds) / bench_median(b[i].wall, b[i].rounds));
        bench_num("error", (double)(memcmp(t[0].out, t[i].out, (size_t)pixels_of(&w) * 12) != 0));
        bench_text("error_unit", "pictures that differ");
        bench_end();
    }
    for (i = 0; i < 2; i++) free(t[i].out);
    free_world(&w);
}

/* The same pixels with the light of coarser grids, against the finest. */
static void bm13(void) {
    static const uint32_t grid[4] = {64, 128, 256, 512};
    world fine;
    float *want;
    int i, n = g_opt.full ? 4 : 3;
    make_world(&fine, "cornell", grid[n - 1], n == 4 ? 256 : 128, 128, 96);
    want = reference(&fine, VOXRT_GI_GATHER, 1, 0.0f, 256);
    for (i = 0; i < n - 1; i++) {
        world w;
        light_job t;
        bench_job b;
        char kase[64];
        memset(&b, 0, sizeof b);
        make_world(&w, "cornell", grid[i], grid[i] < 128 ? 64 : 128, 128, 96);
        memcpy(w.g.position, fine.g.position, (size_t)pixels_of(&w) * 12);
        memcpy(w.g.normal, fine.g.normal, (size_t)pixels_of(&w) * 12);
        memcpy(w.g.albedo, fine.g.albedo, (size_t)pixels_of(&w) * 12);
        t = light_of(&w, 64);
        b.name = "gathering, 64 rays";
        b.run = run_light;
        b.ctx = &t;
        run_jobs(&b, 1, 3);
        snprintf(kase, sizeof kase, "cornell, %u columns a side", grid[i]);
        light_line("voxrt.gi.grid", kase, &t, &b, 64.0 * pixels_of(&w), error_of(&fine, t.out, want));
        free(t.out);
        free_world(&w);
    }
    free(want);
    free_world(&fine);
}

/* ---- BM14: a lamp that moves ---- */

/* How much pictures flicker that follow each other: second differences in time. The reference of light that bounces on
   cells is noisy itself, and follows it; so it is drawn twice, with other rays: what their difference flickers, over
   sqrt(2), is that noise, and what is left of the reference's flicker without it is what the row is measured by. */
static void bm14(void) {
    enum { FRAMES = 10, WAYS = 6 };
    static const struct { const char *name; uint32_t rays, bounce_rays, filter; int history; uint32_t bounces, of; } ways[WAYS] = {
        {"converged", 256, 0, 0, 0, 1, 0}, {"8 rays, filter 3", 8, 0, 3, 0, 1, 0}, {"8 rays, filter 3, history", 8, 0, 3, 1, 1, 0},
        {"converged, cells bounce twice a frame", 256, 64, 0, 0, 3, 3}, {"the same with other rays", 256, 64, 0, 0, 3, 3},
        {"8 rays, filter 3, history, cells follow by 1/4", 8, 16, 3, 1, 3, 3}
    };
    double flicker[WAYS], seconds[WAYS], noise = 0.0;
    float *want[FRAMES];
    world w;
    int i, f;
    memset(want, 0, sizeof want);
    make_world(&w, "cornell", GRID, DEPTH, 96, 72);
    for (i = 0; i < (g_opt.full ? WAYS : 3); i++) {
        size_t n;
        float *last[3];
        double sum = 0.0, error = 0.0, apart = 0.0, start;
        voxrt_gi_history *history = NULL;
        size_t k;
        if (i == 3) { /* bounces with as many rays on all cells of that grid would take ten minutes */
            free_world(&w);
            make_world(&w, "cornell", GRID / 2, DEPTH / 2, 96, 72);
        }
        start = bench_cpu();
        n = 3 * (size_t)pixels_of(&w);
        if (ways[i].history) must(voxrt_gi_history_create(NULL, &history), "history");
        for (f = 0; f < 3; f++) last[f] = (float *)must_alloc(n, 4);
        for (f = 0; f < FRAMES; f++) {
            voxrt_gi_render_desc d = render_desc(&w, ways[i].rays);
            float *turn = last[0];
            voxrt_gi_light l = w.light[0];
            l.position[0] += 0.05f * (float)f;
            must(voxrt_gi_set_lights(w.gi, &l, 1), "light");
            must(voxrt_gi_update(w.gi, NULL), "update");
            /* the reference: all that is asked for, anew, with many rays; as pictures are drawn: one that lets it follow */
            for (uint32_t more = 1; more < ways[i].bounces; more++) {
                if (ways[i].history && f > 0 && more > 1) break;
                must(voxrt_gi_bounce(w.gi, NULL, ways[i].bounce_rays, ways[i].history && f > 0 ? 0.25f : 1.0f, more + (i == 4 ? 100 : 0)),
                     "bounce");
            }
            d.filter = ways[i].filter;
            d.history = history;
            d.first_ray = i == 4 ? 4096 : 0;
            last[0] = last[1];
            last[1] = last[2];
            last[2] = turn;
            must(voxrt_gi_render(&d, w.gi, &w.g, NULL, last[2], NULL), "light");
            if (ways[i].of == (uint32_t)i) {
                if (want[f] == NULL) want[f] = (float *)must_alloc(n, 4);
                memcpy(want[f], last[2], n * 4);
            }
            error += error_of(&w, last[2], want[f]) / FRAMES;
            for (k = 0; k < n && f >= 2; k++) {
                const double own = (double)last[2][k] - 2.0 * (double)last[1][k] + (double)last[0][k];
                sum += fabs(own);
                apart += fabs(own - ((double)want[f][k] - 2.0 * (double)want[f - 1][k] + (double)want[f - 2][k]));
            }
        }
        seconds[i] = (bench_cpu() - start) / FRAMES;
        flicker[i] = sum;
        if (i == 4) noise = apart / sqrt(2.0);
        bench_line("voxrt.gi.flicker", ways[i].bounces > 1 ? "cornell, half the grid, the lamp moves, light bounces on cells" :
                   "cornell, the lamp moves", "times_reference", sum / flicker[ways[i].of], "");
        bench_num("error", error);
        bench_text("error_unit", "RMS / mean");
        bench_num("flicker_of_difference", apart / flicker[ways[i].of]);
        bench_text("method", ways[i].name);
        bench_num("frame_ms", 1e3 * seconds[i]);
        bench_num("threads", 1);
        bench_end();
        for (f = 0; f < 3; f++) free(last[f]);
        voxrt_gi_history_destroy(history);
    }
    if (g_opt.full) {
        /* the reference without its noise flickers by no less than this */
        const double least = flicker[3] - noise;
        bench_line("voxrt.gi.flicker", "cornell, half the grid, the lamp moves, light bounces on cells", "noise_of_reference",
                   noise / flicker[3], "of its flicker");
        bench_text("method", "converged, cells bounce twice a frame");
        bench_num("times_reference_without_noise_at_most", flicker[5] / (least > 0.0 ? least : 1e-30));
        bench_end();
        table_set("flicker", "%.2f (with history %.2f, and bounces on cells %.2f)", flicker[1] / flicker[0], flicker[2] / flicker[0],
                  flicker[5] / (least > 0.0 ? least : 1e-30));
    } else table_set("flicker", "%.2f (with history %.2f)", flicker[1] / flicker[0], flicker[2] / flicker[0]);
    for (f = 0; f < FRAMES; f++) free(want[f]);
    free_world(&w);
}

int main(int argc, char **argv) {
    static const struct { int number; void (*run)(void); } all[] = {
        {3, bm3}, {1, bm1}, {2, bm2}, {4, bm4}, {5, bm5}, {6, bm6}, {7, bm7}, {8, bm8}, {9, bm9}, {10, bm10}, {11, bm11}, {12, bm12},
        {13, bm13}, {14, bm14}
    };
    size_t i;
    const int status = bench_parse(argc, argv, &g_opt);
    if (status) return status;
    bench_machine("voxrt_gi", argv[0]);
    for (i = 0; i < sizeof all / sizeof all[0]; i++) {
        const double start = bench_wall();
        if (!bench_wanted(&g_opt, all[i].number)) continue;
        all[i].run();
        fprintf(stderr, "BM%d: %.1f s\n", all[i].number, bench_wall() - start);
    }
    bench_table_end(&g_table, &g_opt, g_busy_count > 0 ? g_busy_sum / g_busy_count : 0.0, argv[0]);
    return 0;
}
