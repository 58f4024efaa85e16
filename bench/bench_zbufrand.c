/* bench_zbufrand.c - how fast, how large and how wrong zbufrand.h is - MIT OR Unlicense, see LICENSE

   bench_zbufrand [--full] [--only BM1,BM6] [--threads N] [--data DIR] [--table FILE]

   BM1 growth to 10^13 triangles, levels     BM6 time against error, all ways      BM11 inner loops
   BM2 parameters of the thesis' selection   BM7 radius of a disc, hidden layers   BM12 noise from frame to frame
   (BM3: see BM2)                            BM8 resolution                        BM13 worst cases
   BM4 hybrid: radius, costs, never slower   BM9 build                             BM14 threads
   BM5 the thesis' scenes, reconstructions   BM10 edits                            BM15 shading, attributes
   BM16 probability of a complete picture    BM17 surfaces close behind one another, partial coverage
   BM18 blocks, filters, z-buffers of samples    BM19 holes over the number of samples    BM20 small scenes
   One JSON object a line on stdout; the acceptance table on stderr and, after a run of all, in bench/table_zbufrand.md
   beside the program. */
#include "bench.h"
#include "../examples/support/mesh.h"
#include "../examples/support/scenes.h"
#define ZBUFRAND_IMPLEMENTATION
#include "../zbufrand.h"
#include "baseline/zbuffer.h"
#include "../examples/support/worlds.h"
#include "bench_worlds.h"

/* ---- lines about pictures ---- */

static void picture_nums(const picture_job *p, const bench_job *b) {
    const zbufrand_stats *s = &p->stats;
    bench_num("best", 1e3 * bench_seconds_best(b));
    bench_num("wall_per_cpu", bench_busy(b));
    bench_num("samples", (double)(s->samples[0] + s->samples[1]));
    bench_num("accepted", (double)s->accepted);
    bench_num("rastered", (double)s->rastered);
    bench_num("nodes", (double)s->nodes);
    bench_num("draws", (double)(s->draws[0] + s->draws[1] + s->draws[2]));
    bench_num("density", s->density);
    bench_num("rays", (double)(s->holes + s->wrong));
    if (p->mean <= 1) {
        bench_num("select_ms", 1e3 * s->seconds[ZBUFRAND_STAGE_SELECT]);
        bench_num("draw_ms", 1e3 * s->seconds[ZBUFRAND_STAGE_DRAW]);
        bench_num("occlusion_ms", 1e3 * s->seconds[ZBUFRAND_STAGE_OCCLUSION]);
        bench_num("repair_ms", 1e3 * s->seconds[ZBUFRAND_STAGE_REPAIR]);
        bench_num("shade_ms", 1e3 * s->seconds[ZBUFRAND_STAGE_SHADE]);
    }
    bench_text("isa", zbufrand_isa_name(zbufrand_isa_best()));
    bench_num("bytes", (double)s->bytes);
    bench_hash(picture_hash(p));
}

/* truth: may be NULL; then the bound of the probability that the picture is incomplete stands for the error. */
static wrong picture_line(const char *bench, const char *kase, const char *method, const picture_job *p, const bench_job *b,
                          const truth *t, double threads) {
    wrong w;
    memset(&w, 0, sizeof w);
    bench_line(bench, kase, "frame_time", 1e3 * (threads > 1.0 ? bench_median(b->wall, b->rounds) : bench_seconds(b)), "ms");
    if (t != NULL) {
        w = judge(t, p->image.rgba, NULL, p->mean > 1 ? NULL : p->image.depth, NULL);
        bench_num("error", w.rmse);
        bench_text("error_unit", "RMSE to 256 samples");
        wrong_nums(&w);
    } else {
        bench_num("error", p->stats.incomplete);
        bench_text("error_unit", "probability of an incomplete picture");
    }
    bench_text("method", method);
    bench_num("threads", threads);
    picture_nums(p, b);
    bench_end();
    return w;
}

/* The time of a picture with default settings, one thread. */
static double simple_time(const char *bench, const world *w, const char *method, uint32_t width, uint32_t height, uint32_t block,
                          uint32_t every, int rounds, wrong *out) {
    picture_job p = picture_open(w, width, height, 1);
    bench_job b;
    double ms;
    truth *t = every != 0 ? truth_make(&p, every) : NULL;
    p.desc.reconstruct.block = block;
    b = picture_time(&p, method, rounds);
    ms = 1e3 * bench_seconds(&b);
    if (out != NULL) *out = picture_line(bench, w->name, method, &p, &b, t, 1);
    else (void)picture_line(bench, w->name, method, &p, &b, t, 1);
    if (t != NULL) truth_free(t);
    picture_free(&p);
    return ms;
}

/* ---- BM1: growth ---- */

static void bm1(void) {
    static const int rows[30][3] = { /* the thesis' table: fields a side, n x n, levels */
        {2, 1, 0}, {4, 1, 0}, {8, 1, 0}, {16, 1, 0}, {32, 1, 0}, {64, 1, 0}, {128, 1, 0}, {256, 1, 0}, {128, 2, 1}, {256, 2, 1},
        {256, 3, 1}, {256, 4, 1}, {256, 5, 1}, {256, 6, 1}, {256, 7, 1}, {256, 8, 1}, {256, 9, 1}, {256, 10, 1}, {256, 3, 2},
        {256, 4, 2}, {256, 5, 2}, {256, 7, 2}, {256, 10, 2}, {256, 4, 3}, {256, 5, 3}, {256, 7, 3}, {256, 10, 3}, {256, 5, 4},
        {256, 7, 4}, {256, 10, 4}
    };
    static const int few[6] = {1, 7, 17, 22, 26, 29};
    double ms[30], least = 0.0, level;
    const int count = g_opt.full ? 30 : 6;
    picture_job *p = (picture_job *)must_alloc(30, sizeof *p);
    bench_job *b = (bench_job *)must_alloc(30, sizeof *b);
    world *w[30];
    int i;
    for (i = 0; i < count; i++) {
        const int *r = rows[g_opt.full ? i : few[i]];
        w[i] = world_chess(r[0], r[1], r[2]);
        p[i] = picture_open(w[i], 640, 480, 1);
        b[i].name = "samples";
        b[i].run = picture_run;
        b[i].ctx = &p[i];
    }
    bench_interleave(b, count, 5); /* ratios of them are wanted */
    for (i = 0; i < count; i++) {
        truth *t = truth_make(&p[i], g_opt.full ? 4 : 32);
        char kase[64];
        ms[i] = 1e3 * bench_seconds(&b[i]);
        snprintf(kase, sizeof kase, "%.3g triangles", (double)w[i]->info.triangles);
        (void)picture_line("zbufrand.growth", kase, w[i]->name, &p[i], &b[i], t, 1);
        truth_free(t);
        picture_free(&p[i]);
        world_free(w[i]);
    }
    least = ms[g_opt.full ? 1 : 0];
    table_set("chess", "%.2f (%.1f ms, %.1f ms)", ms[count - 1] / least, ms[count - 1], least);
    level = pow(ms[count - 1] / ms[g_opt.full ? 17 : 2], 1.0 / 3.0); /* 10 x 10: from one level to four */
    table_set("level", "%+.1f %%", 100.0 * (level - 1.0));
    free(p);
    free(b);
}

/* The comparison programs' scene of 10^12 triangles, and one of its blobs, which fills as much of the picture. */
static void bm1_huge(void) {
    double one, outside = 0.0, inside = 0.0;
    const int last = 100;
    int k;
    world *w = world_blob(512);
    one = simple_time("zbufrand.huge", w, "samples", 1024, 768, 0, 64, 5, NULL);
    world_free(w);
    for (k = g_opt.full ? 10 : last; k <= last; k = k < 32 ? 32 : k < last ? last : last + 1) {
        char name[48];
        w = world_blobs(k, 0);
        outside = simple_time("zbufrand.huge", w, "samples", 1024, 768, 0, g_opt.full ? 32 : 192, 3, NULL);
        snprintf(name, sizeof name, "%d^3 blobs, inside", k);
        memcpy(w->name, name, sizeof name);
        world_set_blobs_inside(w, k, 1);
        inside = simple_time("zbufrand.huge", w, "samples", 1024, 768, 0, g_opt.full ? 32 : 192, 3, NULL);
        world_free(w);
    }
    table_set("huge", "%.0f / %.0f", outside, inside);
    table_set("growth", "%.2f", outside / one);
}

/* ---- BM2, BM3: the thesis' selection ---- */

/* The thesis' program with other values of its two parameters: epsilon, and levels of halving the normals; same: our
   program, of which only trees and cut are the thesis'. Returns the time of the best cell. few: they take seconds, so only
   one but with --full. fits[0]: exponent of samples, fits[1]: of boxes, over epsilon and sqrt(epsilon) - 1. */
static double sweep_cells(world *w, uint32_t block, const truth *t, int few, int same, double fits[2]) {
    static const double ratios[12] = {1.05, 1.1, 1.2, 1.3, 1.5, 1.7, 2.0, 2.828, 4.0, 5.656, 8.0, 16.0};
    double best = 1e300, x[12], y[12], z[12];
    uint32_t depth;
    int i, n = 0;
    fits[0] = fits[1] = 0.0;
    for (depth = 0; depth <= (g_opt.full ? 8u : 4u); depth += g_opt.full ? 2 : 4) {
        world_structure(w, depth == 0 ? ZBUFRAND_STRUCTURE_FAIR_SPLIT : ZBUFRAND_STRUCTURE_CLASSES, depth);
        for (i = 0; i < 12; i++) {
            picture_job p;
            bench_job b;
            char name[48];
            if (same ? (few && depth != 0 && !g_opt.full) || (i != 1 && i != 4 && (few || i != 8) && (!g_opt.full || i > 8))
                     : !g_opt.full && (few ? i != 2 || depth != 0 : i != 1 && i != 4)) continue;
            p = picture_open(w, 640, 480, 1);
            if (!same) zbufrand_preset_thesis(NULL, &p.desc);
            p.desc.reconstruct.block = block;
            p.desc.depth_ratio = ratios[i];
            snprintf(name, sizeof name, "%s, %u levels of classes", same ? "only the cut" : "thesis", (unsigned)depth);
            b = picture_time(&p, name, same && !few ? 7 : g_opt.full ? 3 : 0);
            bench_line("zbufrand.cells", w->name, "frame_time", 1e3 * bench_seconds(&b), "ms");
            {
                const wrong out = judge(t, p.image.rgba, NULL, p.image.depth, NULL);
                bench_num("error", out.rmse);
                bench_text("error_unit", "RMSE to 256 samples");
                wrong_nums(&out);
            }
            bench_text("method", name);
            bench_num("epsilon", ratios[i]);
            bench_num("classes", depth == 0 ? 1.0 : (double)((uint32_t)1 << depth));
            bench_num("bytes_per_triangle", (double)w->info.bytes / (double)w->info.stored_triangles);
            bench_num("threads", 1);
            picture_nums(&p, &b);
            bench_end();
            if (bench_seconds(&b) < best) best = bench_seconds(&b);
            if (depth == (g_opt.full ? 4u : 0u) && n < 12) {
                x[n] = log(ratios[i]);
                y[n] = log((double)(p.stats.samples[0] + p.stats.samples[1]));
                z[n] = log((double)p.stats.draws[1]);
                n++;
            }
            picture_free(&p);
        }
    }
    if (n > 2) { /* slopes of log samples and log boxes by least squares */
        double sx = 0, sy = 0, sz = 0, sq = 0, sxx = 0, sxy = 0, sqq = 0, sqz = 0;
        for (i = 0; i < n; i++) {
            const double q = log(sqrt(exp(x[i])) - 1.0);
            sx += x[i];
            sy += y[i];
            sz += z[i];
            sq += q;
            sxx += x[i] * x[i];
            sxy += x[i] * y[i];
            sqq += q * q;
            sqz += q * z[i];
        }
        fits[0] = (n * sxy - sx * sy) / (n * sxx - sx * sx);
        fits[1] = (n * sqz - sq * sz) / (n * sqq - sq * sq);
    }
    world_structure(w, ZBUFRAND_STRUCTURE_DEFAULT, 0);
    return best;
}

/* The sweeps of the thesis against the cut without parameters on the same scene and camera. ratio: its time over that of
   the best cell, of the thesis' program and of ours with the thesis' cut. */
static void sweep(world *w, uint32_t block, int few, double ratio[2]) {
    picture_job p = picture_open(w, 640, 480, 1);
    truth *t = truth_make(&p, g_opt.full ? 8 : 128);
    double fits[2];
    bench_job b;
    int same;
    p.desc.reconstruct.block = block;
    b = picture_time(&p, "error-driven cut", 7);
    (void)picture_line("zbufrand.sweep", w->name, "error-driven cut", &p, &b, t, 1);
    for (same = 0; same < 2; same++) {
        ratio[same] = bench_seconds(&b) / sweep_cells(w, block, t, few, same, fits);
        bench_line("zbufrand.sweep", w->name, same ? "times_of_best_cell_of_the_cut_alone" : "times_of_best_cell", ratio[same], "");
        if (g_opt.full) {
            bench_num("samples_exponent", fits[0]); /* over epsilon; the thesis: 1/2 */
            bench_num("boxes_exponent", fits[1]);   /* over sqrt(epsilon) - 1; the thesis: -3, its table: -1.6 */
        }
        bench_num("threads", 1);
        bench_end();
    }
    truth_free(t);
    picture_free(&p);
}

static void bm2(void) {
    double worst[2] = {0.0, 0.0}, ratio[2];
    int i, k;
    for (i = 0; i < 3; i++) {
        world *w = i < 2 ? world_trees(i) : world_named("city-low", 3);
        sweep(w, i < 2 ? 2 : 1, i < 2, ratio);
        for (k = 0; k < 2; k++) worst[k] = ratio[k] > worst[k] ? ratio[k] : worst[k];
        world_free(w);
    }
    table_set("sweep", "%.2f / %.2f", worst[0], worst[1]);
}

/* ---- BM4: hybrid ---- */

static world *world_sheets(int sheets, int turned);

/* Default against all triangles by our own rasteriser, with and without culling what is hidden, and against the default with
   costs measured on this machine (n: 4), in turn; the faster they are the more often. */
static double against_raster(const char *bench, world *w, uint32_t width, uint32_t height, const zbufrand_costs *measured, int n) {
    static const char *const names[4] = {"by cost", "all rastered, hidden ones culled", "all rastered", "by measured costs"};
    picture_job p[4];
    bench_job b[4];
    truth *t;
    double worst, all = 0.0;
    int i, rounds;
    memset(b, 0, sizeof b);
    for (i = 0; i < n; i++) {
        const double start = bench_cpu();
        p[i] = picture_open(w, width, height, 1);
        if (i == 1 || i == 2) picture_raster(&p[i], i == 1);
        if (i == 3) p[i].desc.costs = *measured;
        b[i].name = names[i];
        b[i].run = picture_run;
        b[i].ctx = &p[i];
        picture_run(&p[i]);
        all += bench_cpu() - start;
    }
    rounds = (int)((g_opt.full ? 4.0 : 0.6) / all);
    rounds = rounds < 5 ? 5 : rounds > 31 ? 31 : rounds;
    t = truth_make(&p[0], g_opt.full ? 8 : 384);
    bench_interleave(b, n, rounds);
    for (i = 0; i < n; i++) (void)picture_line(bench, w->name, names[i], &p[i], &b[i], t, 1);
    worst = 1.0 / bench_ratio(&b[1], &b[0]);
    if (1.0 / bench_ratio(&b[2], &b[0]) > worst) worst = 1.0 / bench_ratio(&b[2], &b[0]);
    bench_line(bench, w->name, "times_of_faster_raster", worst, "");
    bench_num("rounds", rounds);
    if (n == 4) bench_num("times_of_measured_costs", 1.0 / bench_ratio(&b[3], &b[0]));
    bench_end();
    truth_free(t);
    for (i = 0; i < n; i++) picture_free(&p[i]);
    return worst;
}

static void radius_sweep(void) {
    world *w = world_named("city-low", 3);
    picture_job p = picture_open(w, 640, 480, 1);
    truth *t = truth_make(&p, g_opt.full ? 8 : 48);
    bench_job b;
    double radius;
    b = picture_time(&p, "by cost", 5);
    (void)picture_line("zbufrand.radius", w->name, "by cost", &p, &b, t, 1);
    table_set("city", "%.1f", 1e3 * bench_seconds(&b));
    p.desc.hybrid = ZBUFRAND_HYBRID_CUBE;
    for (radius = 0.0; radius <= 1000.0; radius = radius == 0.0 ? 25.0 : radius * (g_opt.full ? 1.5 : 6.0)) {
        char name[64];
        p.desc.hybrid_radius = radius;
        snprintf(name, sizeof name, "cube of radius %g", radius);
        b = picture_time(&p, name, g_opt.full ? 5 : 0);
        (void)picture_line("zbufrand.radius", w->name, name, &p, &b, t, 1);
    }
    truth_free(t);
    picture_free(&p);
    world_free(w);
}

/* The k-th scene of BM4; NULL: there are no more, or it is only for --full. */
static world *raster_world(int k) {
    static const struct { const char *name; size_t view; } named[4] = {{"landscape", 0}, {"chess", 0}, {"city-low", 3}, {"city-small", 2}};
    world *w;
    if (k < 4) {
        if (k == 3 && !g_opt.full) return NULL;
        w = world_named(named[k].name, named[k].view);
        snprintf(w->name, sizeof w->name, "%s-%u", named[k].name, (unsigned)named[k].view + 1);
        return w;
    }
    switch (k) {
    case 4: return shared_world(SHARED_CITY, 1);
    case 5: return world_blob(512);
    case 6: return world_hall(512);
    case 7: return shared_world(SHARED_BLOB, 0);
    case 8: return world_trees(0);
    case 9: return world_trees(1);
    case 10: return world_layers(1, 200);
    case 11: return world_layers(25, 200);
    case 12: return world_sheets(1000, 1);
    case 13: return world_chess(4, 1, 0); /* 32 triangles */
    default: return world_blob(3);
    }
}

static void bm4(void) {
    double worst = 0.0, r;
    char most[64] = "";
    zbufrand_costs costs;
    int i;
    must(zbufrand_measure_costs(NULL, cpu_clock, NULL, &costs), "costs");
    bench_line("zbufrand.costs", "this machine", "stored_sample", (double)costs.stored, "ns");
    bench_num("triangle", (double)costs.triangle);
    bench_num("edge", (double)costs.edge);
    bench_num("pixel", (double)costs.pixel);
    bench_num("cluster", (double)costs.cluster);
    bench_num("sample", (double)costs.sample);
    bench_num("set", (double)costs.set);
    bench_end();
    for (i = 0; i < 15; i++) {
        world *w = raster_world(i);
        const int large = i > 4 && i < 8;
        if (w == NULL) continue;
        r = against_raster("zbufrand.raster", w, large ? 1024 : 640, large ? 768 : 480, &costs,
                           g_opt.full || i == 1 || i == 9 ? 4 : 3);
        if (r > worst) {
            worst = r;
            snprintf(most, sizeof most, "%.40s", w->name);
        }
        if (i != 4 && i != 7) world_free(w);
    }
    table_set("never", "%.2f (%s)", worst, most);
    radius_sweep();
}

/* ---- BM5: the thesis' scenes ---- */

static int layers_take(void *user, const zbufrand_sample *samples, const uint32_t *numbers, size_t count) {
    (void)numbers;
    return zbufrand_layers_submit((zbufrand_layers *)user, samples, count) != ZBUFRAND_OK;
}

/* Layered coverage. Its colours are not lit, so only what it covers is judged: hidden surfaces and holes have no depth. */
static void layers_line(const char *kase, const picture_job *of, const truth *t) {
    picture_job p = *of;
    zbufrand_layers_desc ld;
    zbufrand_layers *layers = NULL;
    double cpu = bench_cpu(), off = 0.0, pixels = (double)t->tile_count * TILE * TILE;
    uint32_t tile, k, i;
    memset(&ld, 0, sizeof ld);
    p.desc.lights = &p.light;
    ld.env.thread_count = 1;
    ld.width = p.image.width;
    ld.height = p.image.height;
    ld.density = 8.0f;
    ld.dispersion = 0.4f;
    ld.tolerance = 0.02f;
    memset(&p.desc.reconstruct, 0, sizeof p.desc.reconstruct);
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    p.desc.density = 8.0;
    must(zbufrand_layers_create(&ld, &layers), "layers");
    do {
        must(zbufrand_sample_scene(p.frame, &p.desc, p.scene, ld.width, ld.height, layers_take, layers, &p.stats), "samples");
    } while (zbufrand_layers_next(layers));
    must(zbufrand_layers_resolve(layers, p.image.rgba, NULL), "layers");
    cpu = bench_cpu() - cpu;
    zbufrand_layers_destroy(layers);
    for (tile = 0; tile < t->tile_count; tile++) {
        for (k = 0; k < TILE * TILE; k++) {
            const size_t at = (size_t)tile * TILE * TILE + k, pixel = (size_t)t->tile[tile] + (size_t)(k / TILE) * t->width + k % TILE;
            double covered = 0.0;
            for (i = 0; i < SPP; i++) covered += t->depth[SPP * at + i] < INFINITY ? 1.0 / SPP : 0.0;
            covered -= (double)p.image.rgba[4 * pixel + 3];
            off += covered * covered / pixels;
        }
    }
    bench_line("zbufrand.scenes", kase, "frame_time", 1e3 * cpu, "ms");
    bench_num("error", sqrt(off));
    bench_text("error_unit", "RMSE of the share of a pixel that is covered");
    bench_text("method", "layers of depth, 8 per pixel");
    bench_num("samples", (double)(p.stats.samples[0] + p.stats.samples[1]));
    bench_num("threads", 1);
    bench_end();
}

static void bm5(void) {
    static const struct { const char *name; size_t view; uint32_t block; const char *row; } scenes[8] = {
        {"forest", 0, 2, "overview"}, {"forest", 1, 2, NULL}, {"forest", 2, 2, NULL}, {"forest", 3, 2, NULL}, {"city", 0, 2, NULL},
        {"city", 1, 2, NULL}, {"chess", 0, 1, NULL}, {"landscape", 0, 2, NULL}
    };
    static const uint32_t blocks[5] = {1, 2, 3, 5, 10};
    static const struct { const char *name; zbufrand_fill fill; } fills[5] = {
        {"Gauss, d=2", ZBUFRAND_FILL_GAUSS}, {"Voronoi, d=2", ZBUFRAND_FILL_VORONOI}, {"Voronoi L1, d=2", ZBUFRAND_FILL_VORONOI_L1},
        {"regions, d=2", ZBUFRAND_FILL_REGIONS}, {"pull-push, d=2", ZBUFRAND_FILL_PULL_PUSH}
    };
    world *w;
    size_t i;
    int k;
    for (i = 0; i < 8; i++) {
        const int forest = i < 4;
        picture_job p;
        truth *own = NULL;
        const truth *t;
        if (!g_opt.full && i > 1 && i != 5 && i != 7) continue;
        w = forest ? shared_world(SHARED_FOREST, scenes[i].view) : world_named(scenes[i].name, scenes[i].view);
        snprintf(w->name, sizeof w->name, "%s-%u", scenes[i].name, (unsigned)scenes[i].view + 1);
        p = picture_open(w, 640, 480, 1);
        if (!forest) own = truth_make(&p, g_opt.full ? 8 : 96);
        t = forest ? shared_truth(w, scenes[i].view, &p) : own;
        for (k = 0; k < 5; k++) {
            char name[32];
            bench_job b;
            if (!g_opt.full && blocks[k] != 2 && (i > 0 || blocks[k] == 10)) continue; /* d = 1 is in BM6 */
            p.desc.reconstruct.block = blocks[k];
            snprintf(name, sizeof name, "blocks, d=%u", blocks[k]);
            b = picture_time(&p, name, g_opt.full ? 10 : 3);
            (void)picture_line("zbufrand.scenes", w->name, name, &p, &b, t, 1);
            if (scenes[i].row != NULL && blocks[k] == scenes[i].block)
                table_set(scenes[i].row, "%.1f", 1e3 * bench_seconds(&b));
        }
        for (k = 0; k < 1 && (i == 5 || g_opt.full); k++) { /* blocks along the plane of their surface */
            bench_job b;
            p.desc.reconstruct.block = 2;
            p.desc.reconstruct.plane_depth = 1;
            b = picture_time(&p, "blocks with planes, d=2", 3);
            (void)picture_line("zbufrand.scenes", w->name, "blocks with planes, d=2", &p, &b, t, 1);
            p.desc.reconstruct.plane_depth = 0;
        }
        if (i == 7) layers_line(w->name, &p, t); /* where many layers are hidden it takes a minute */
        for (k = 0; k < 5 && (i == 7 || g_opt.full); k++) {
            bench_job b;
            p.desc.reconstruct.block = 2;
            p.desc.reconstruct.fill = fills[k].fill;
            p.desc.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
            b = picture_time(&p, fills[k].name, 3);
            (void)picture_line("zbufrand.scenes", w->name, fills[k].name, &p, &b, t, 1);
        }
        if (own != NULL) truth_free(own);
        picture_free(&p);
        if (!forest) world_free(w);
    }
    w = world_trees(0);
    table_set("trees", "%.1f", simple_time("zbufrand.scenes", w, "blocks, d=2", 640, 480, 2, g_opt.full ? 8 : 96, 3, NULL));
    world_free(w);
}

/* ---- BM6: time against error ---- */

typedef struct curve { /* points of one method: seconds, rmse */
    double time[8], error[8];
    int count;
} curve;

static void error_lines(const char *kase, const char *method, const char *variant, double seconds, const wrong *w, int has_depth,
                        const picture_job *p, const bench_job *b) {
    static const char *const metrics[3] = {"time_rmse", "time_ssim", "time_hidden"};
    int i;
    for (i = 0; i < (has_depth ? 3 : 2); i++) {
        bench_line("zbufrand.error", kase, metrics[i], 1e3 * seconds, "ms");
        bench_num("error", i == 0 ? w->rmse : i == 1 ? 1.0 - w->ssim : w->hidden);
        bench_text("error_unit", i == 0 ? "RMSE to 256 samples" : i == 1 ? "1 - SSIM to 256 samples"
                                                                        : "share of pixels that show what is not visible there");
        bench_text("method", method);
        bench_text("setting", variant);
        wrong_nums(w);
        bench_num("threads", 1);
        if (p != NULL) picture_nums(p, b);
        bench_end();
    }
}

static void curve_add(curve *c, double time, double error) {
    if (c->count == 8) return;
    c->time[c->count] = time;
    c->error[c->count++] = error;
}

/* Time at which a curve reaches an error, straight lines between its points in logarithms; 0: it does not. Errors are
   made to fall along the curve. */
static double curve_time(const curve *c, double error) {
    double e0 = c->error[0], t0 = c->time[0];
    int i;
    if (c->count == 0) return 0.0;
    if (e0 <= error) return t0;
    for (i = 1; i < c->count; i++) {
        if (c->error[i] >= e0) continue;
        if (c->error[i] <= error)
            return exp(log(t0) + (log(c->time[i]) - log(t0)) * (log(e0) - log(error)) / (log(e0) - log(c->error[i])));
        e0 = c->error[i];
        t0 = c->time[i];
    }
    return 0.0;
}

static picture_job way_open(const world *w, uint32_t width, uint32_t height) { return picture_open(w, width, height, 1); }

/* One way with one setting: timed, judged. */
static double way_line(const char *kase, const char *method, const char *setting, picture_job *p, const truth *t, int rounds,
                       wrong *out) {
    const int one_frame = p->mean <= 1 && p->desc.noise == 0.0;
    bench_job b = picture_time(p, method, rounds);
    *out = judge(t, p->image.rgba, NULL, one_frame ? p->image.depth : NULL, NULL);
    error_lines(kase, method, setting, bench_seconds(&b), out, one_frame, p, &b);
    return bench_seconds(&b);
}

/* What the thesis does, word by word: independent samples, as many as it takes for all pixels, all of them drawn. */
static void way_independent(const char *kase, const world *w, const truth *t) {
    static const double densities[4] = {1.0, 2.5, 6.0, 13.0};
    picture_job p = way_open(w, t->width, t->height);
    wrong out;
    int i;
    p.desc.independent = 1;
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    p.desc.no_repair = 1;
    p.desc.no_occlusion = 1;
    p.desc.no_plane_depth = 1;
    for (i = g_opt.full ? 0 : 2; i < 4; i++) {
        char name[32];
        p.desc.density = densities[i];
        snprintf(name, sizeof name, "%g per pixel", densities[i]);
        (void)way_line(kase, "independent samples, nothing culled", name, &p, t, 0, &out);
    }
    picture_free(&p);
}

/* The thesis' program, with its own tree, which the world has meanwhile. */
static void way_thesis(const char *kase, world *w, const truth *t) {
    picture_job p;
    wrong out;
    if (w->info.stored_triangles > 1000000) return; /* it would have to be built twice */
    world_structure(w, ZBUFRAND_STRUCTURE_FAIR_SPLIT, 0);
    p = way_open(w, t->width, t->height);
    zbufrand_preset_thesis(NULL, &p.desc);
    (void)way_line(kase, "the thesis' program", "d = 2", &p, t, 0, &out);
    picture_free(&p);
    world_structure(w, ZBUFRAND_STRUCTURE_DEFAULT, 0);
}

/* ours: the fastest that one gets to an error with: one frame, larger pictures averaged until the error `target` is reached. */
static void way_samples(const char *kase, const world *w, const truth *t, int all, double target,
                        curve *ours) {
    static const uint32_t blocks[3] = {2, 3, 5}, frames[4] = {1, 4, 16, 64}, larger[4] = {2, 4, 5, 8};
    static const double densities[4] = {1.0, 2.0, 4.0, 8.0};
    picture_job p = way_open(w, t->width, t->height);
    wrong out;
    char name[32];
    double seconds;
    int i;
    for (i = 0; i < (g_opt.full ? 4 : all ? 2 : 1); i++) { /* the default, and means of it */
        p.mean = frames[i];
        snprintf(name, sizeof name, "mean of %u", frames[i]);
        seconds = way_line(kase, "default, means of frames", name, &p, t, i == 0 ? 3 : 0, &out);
        if (i == 0) curve_add(ours, seconds, out.rmse);
    }
    p.mean = 0;
    for (i = 0; i < (g_opt.full ? 4 : 3) && (ours->count == 0 || ours->error[ours->count - 1] > target); i++) {
        p.desc.oversample = larger[i];
        snprintf(name, sizeof name, "%u x %u", larger[i], larger[i]);
        seconds = way_line(kase, "default, larger and averaged", name, &p, t, g_opt.full && i < 2 ? 3 : 0, &out);
        curve_add(ours, seconds, out.rmse);
    }
    p.desc.oversample = 0;
    for (i = 0; i < 3 && (all || g_opt.full); i++) {
        if (!g_opt.full && i == 1) continue;
        p.desc.reconstruct.block = blocks[i];
        snprintf(name, sizeof name, "d=%u", blocks[i]);
        (void)way_line(kase, "default, blocks", name, &p, t, g_opt.full ? 3 : 1, &out);
    }
    p.desc.reconstruct.block = 0;
    p.desc.no_repair = 1;
    for (i = 0; i < 4 && (all || g_opt.full); i++) {
        if (!g_opt.full && (i & 1) != 0) continue;
        p.desc.density = densities[i];
        snprintf(name, sizeof name, "%g per pixel", densities[i]);
        (void)way_line(kase, "samples without rays", name, &p, t, g_opt.full ? 3 : 1, &out);
    }
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    for (i = 0; i < 4 && (g_opt.full || (all && strcmp(kase, "forest-1") != 0)); i++) { /* that one rasters nothing anyway */
        if (!g_opt.full && (i & 1) != 0) continue;
        p.desc.density = densities[i];
        snprintf(name, sizeof name, "%g per pixel", densities[i]);
        (void)way_line(kase, "nothing rastered, without rays", name, &p, t, g_opt.full ? 3 : 1, &out);
    }
    picture_free(&p);
}

/* Squares of samples with what may be between them: blocks of d x d pixels, each larger than the one before. */
static void way_fills(const char *kase, const world *w, const truth *t) {
    static const struct { const char *name; zbufrand_fill fill; } fills[5] = {
        {"filled by a Gaussian", ZBUFRAND_FILL_GAUSS}, {"filled by Voronoi cells", ZBUFRAND_FILL_VORONOI},
        {"filled by Voronoi cells, L1", ZBUFRAND_FILL_VORONOI_L1}, {"filled by regions", ZBUFRAND_FILL_REGIONS},
        {"filled by pull-push", ZBUFRAND_FILL_PULL_PUSH}
    };
    static const uint32_t blocks[4] = {1, 2, 3, 5};
    picture_job p = way_open(w, t->width, t->height);
    wrong out;
    char name[32];
    int i, k;
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    p.desc.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
    for (k = 0; k < 5; k++) {
        p.desc.reconstruct.fill = fills[k].fill;
        for (i = 0; i < 4; i++) {
            if (!g_opt.full && i == 2) continue;
            p.desc.reconstruct.block = blocks[i];
            snprintf(name, sizeof name, "d=%u", blocks[i]);
            (void)way_line(kase, fills[k].name, name, &p, t, g_opt.full ? 3 : 1, &out);
        }
    }
    picture_free(&p);
}

/* What is asked for, and nothing else: how probable an incomplete picture may be, how much noise there may be. */
static void way_promises(const char *kase, const world *w, const truth *t) {
    static const double tolerance[4] = {0.5, 0.05, 1e-3, 1e-6}, noise[3] = {0.08, 0.04, 0.02};
    picture_job p = way_open(w, t->width, t->height);
    wrong out;
    char name[32];
    int i;
    for (i = 0; i < 4; i++) {
        p.desc.tolerance = tolerance[i];
        snprintf(name, sizeof name, "tolerance %g", tolerance[i]);
        (void)way_line(kase, "default, tolerance", name, &p, t, g_opt.full ? 3 : 1, &out);
    }
    p.desc.tolerance = 0.0;
    for (i = 0; i < 3; i++) {
        p.desc.noise = noise[i];
        snprintf(name, sizeof name, "noise %g", noise[i]);
        (void)way_line(kase, "default, noise", name, &p, t, 0, &out);
    }
    picture_free(&p);
}

/* One ray a pixel and more. Colours cost what they cost in the library's own pictures. */
static void way_rays(const char *kase, const world *w, const truth *t, curve *rays) {
    static const int spp[4] = {1, 4, 16, 64};
    picture_job p = way_open(w, t->width, t->height);
    const size_t pixels = (size_t)t->tile_count * TILE * TILE;
    cast_job c;
    bench_job b;
    wrong out;
    double shade, each;
    int i;
    picture_run(&p);
    shade = p.stats.seconds[ZBUFRAND_STAGE_SHADE];
    memset(&c, 0, sizeof c);
    memset(&b, 0, sizeof b);
    c.rays = t->rays;
    c.width = t->width;
    c.height = t->height;
    c.every = g_opt.full ? 1 : 6;
    c.depth = (float *)must_alloc((size_t)t->width * t->height, sizeof(float));
    b.run = cast_run;
    b.ctx = &c;
    bench_interleave(&b, 1, 3);
    each = bench_seconds(&b) / (double)c.cast;
    bench_line("zbufrand.rays", kase, "rays_per_second", 1.0 / each, "1/s");
    bench_num("best", bench_rate_best(&b, (double)c.cast));
    bench_num("error", 0);
    bench_text("error_unit", "rays");
    bench_num("hits", (double)c.hits);
    bench_num("threads", 1);
    bench_hash(bench_hash_bytes(c.depth, 4 * (size_t)t->width * t->height));
    bench_end();
    for (i = 0; i < 4; i++) {
        char name[32];
        const double seconds = (double)spp[i] * (each * (double)t->width * (double)t->height + shade);
        if (i == 0) out = judge(t, NULL, t->exact, NULL, t->exact_depth);
        else out = judge(t, NULL, t->few + 3 * (size_t)(i - 1) * pixels, NULL, NULL);
        snprintf(name, sizeof name, "%d per pixel", spp[i]);
        error_lines(kase, "rays through the tree", name, seconds, &out, i == 0, NULL, NULL);
        curve_add(rays, seconds, out.rmse);
    }
    free(c.depth);
    picture_free(&p);
}

static void way_raster(const char *kase, const world *w, const truth *t, int plain) {
    picture_job p = way_open(w, t->width, t->height);
    wrong out;
    picture_raster(&p, 1);
    (void)way_line(kase, "all rastered, hidden ones culled", "1 per pixel", &p, t, 3, &out);
    picture_raster(&p, 0);
    if (plain) (void)way_line(kase, "all rastered", "1 per pixel", &p, t, 3, &out);
    picture_free(&p);
}

enum { WAY_RASTER = 1, WAY_RASTER_ALL = 2, WAY_INDEPENDENT = 4, WAY_THESIS = 8, WAY_ALL = 16 };

/* Writes how many times as fast as rays ours is, at the errors of 1, 4, 16 and (--full) 64 rays a pixel; "-": the error is
   not reached by any that was measured. */
static void error_scene(world *w, const truth *t, const char *kase, int ways, char *out, size_t size) {
    curve ours, rays;
    size_t at = 0;
    int i;
    memset(&ours, 0, sizeof ours);
    memset(&rays, 0, sizeof rays);
    way_rays(kase, w, t, &rays);
    way_samples(kase, w, t, ways & WAY_ALL, rays.error[g_opt.full ? 3 : 2], &ours);
    if (ways & WAY_ALL) {
        way_fills(kase, w, t);
        way_promises(kase, w, t);
    }
    if (ways & WAY_RASTER) way_raster(kase, w, t, ways & WAY_RASTER_ALL);
    if (ways & WAY_INDEPENDENT) way_independent(kase, w, t);
    if (ways & WAY_THESIS) way_thesis(kase, w, t);
    out[0] = 0;
    for (i = 0; i < (g_opt.full ? rays.count : 3); i++) {
        const double time = curve_time(&ours, rays.error[i]);
        bench_line("zbufrand.equal_error", kase, "times_faster_than_rays", time > 0.0 ? rays.time[i] / time : 0.0, "");
        bench_num("error", rays.error[i]);
        bench_text("error_unit", "RMSE to 256 samples");
        bench_num("rays", (double)((uint32_t)1 << 2 * i));
        bench_num("reached", time > 0.0);
        bench_end();
        if (time > 0.0) at += (size_t)snprintf(out + at, size - at, "%s%.2f", i > 0 ? " " : "", rays.time[i] / time);
        else at += (size_t)snprintf(out + at, size - at, "%s-", i > 0 ? " " : "");
        if (at >= size) return;
    }
}

static void bm6(void) {
    char faster[4][32];
    world *w = shared_world(SHARED_BLOB, 0);
    picture_job p = picture_open(w, 1024, 768, 1);
    truth *t;
    wrong blob[2];
    double blob_ms[2];
    size_t i;
    error_scene(w, shared_truth(w, 0, &p), w->name, WAY_RASTER | WAY_RASTER_ALL | WAY_INDEPENDENT | WAY_ALL, faster[0], sizeof faster[0]);
    for (i = 0; i < 2; i++) { /* one sample a pixel shows no more than one ray; its neighbours know more */
        if (i == 1) {
            p.desc.reconstruct.fill = ZBUFRAND_FILL_GAUSS;
            p.desc.reconstruct.gauss_radius = 1.1f;
            p.desc.reconstruct.gauss_support = 1.5f;
        }
        blob_ms[i] = 1e3 * way_line(w->name, i == 0 ? "default" : "default, Gaussian", i == 0 ? "1 per pixel" : "radius 1.1",
                                    &p, shared_truth(w, 0, &p), 3, &blob[i]);
    }
    table_set("blob-8M", "%.1f; %.3f %%; %.1f dB (plain: %.1f; %.1f dB)", blob_ms[1], 100.0 * blob[1].holes, blob[1].psnr,
              blob_ms[0], blob[0].psnr);
    picture_free(&p);
    for (i = 0; i < 4; i++) { /* of the forest's pictures one has the thesis' program beside it, which takes ten seconds */
        w = i < 3 ? shared_world(SHARED_FOREST, i) : world_trees(0);
        p = way_open(w, 640, 480);
        t = i < 3 ? NULL : truth_make(&p, g_opt.full ? 8 : 96);
        error_scene(w, i < 3 ? shared_truth(w, i, &p) : t, w->name, (i == 0 || g_opt.full ? WAY_ALL | WAY_THESIS : 0) |
                    (i == 3 ? WAY_RASTER | WAY_RASTER_ALL : 0), faster[i], sizeof faster[i]);
        picture_free(&p);
        if (t != NULL) truth_free(t);
        if (i == 3) world_free(w);
    }
    table_set("rays", "%s / %s / %s / %s", faster[0], faster[1], faster[2], faster[3]);
    w = world_named("city-low", 3);
    snprintf(w->name, sizeof w->name, "city-low-4");
    p = way_open(w, 640, 480);
    t = truth_make(&p, g_opt.full ? 8 : 64);
    error_scene(w, t, w->name, WAY_RASTER | WAY_RASTER_ALL | WAY_THESIS | WAY_ALL | (g_opt.full ? WAY_INDEPENDENT : 0),
                faster[0], sizeof faster[0]);
    truth_free(t);
    picture_free(&p);
    world_free(w);
    w = world_blob(256); /* the thesis' program on one mesh */
    p = way_open(w, 640, 480);
    t = truth_make(&p, g_opt.full ? 8 : 48);
    error_scene(w, t, w->name, WAY_RASTER | WAY_RASTER_ALL | WAY_INDEPENDENT | WAY_THESIS | WAY_ALL, faster[0], sizeof faster[0]);
    truth_free(t);
    picture_free(&p);
    world_free(w);
}

/* ---- BM7: radius of a disc, hidden layers ---- */

static void bm7(void) {
    int layers, levels;
    for (levels = 0; levels <= 5; levels += g_opt.full ? 1 : 2 + (levels == 2)) { /* 10, 10^3, 10^6 */
        world *w = world_ground(levels);
        (void)simple_time("zbufrand.disc", w, "samples", 640, 480, 0, g_opt.full ? 48 : 384, g_opt.full ? 3 : 1, NULL);
        world_free(w);
    }
    for (layers = 1; layers <= (g_opt.full ? 125 : 25); layers *= 5) {
        world *w = world_layers(layers, 200);
        picture_job p = picture_open(w, 640, 480, 1);
        truth *t = truth_make(&p, 48);
        int i;
        for (i = 0; i < 4; i++) {
            static const char *const names[4] = {"by cost", "by cost, hidden ones too", "sampled", "sampled, hidden ones too"};
            bench_job b;
            p.desc.no_occlusion = (uint32_t)(i & 1);
            p.desc.hybrid = i < 2 ? ZBUFRAND_HYBRID_AUTO : ZBUFRAND_HYBRID_OFF;
            b = picture_time(&p, names[i], 3);
            (void)picture_line("zbufrand.layers", w->name, names[i], &p, &b, t, 1);
        }
        truth_free(t);
        picture_free(&p);
        world_free(w);
    }
}

/* ---- BM8: resolution ---- */

static void bm8(void) {
    static const uint32_t sizes[6][2] = {{160, 120}, {320, 240}, {640, 480}, {1280, 960}, {1920, 1080}, {3840, 2160}};
    world *w = shared_world(SHARED_FOREST, 0);
    int i;
    for (i = 0; i < (g_opt.full ? 6 : 4); i++) {
        picture_job p = picture_open(w, sizes[i][0], sizes[i][1], 1);
        truth *t = g_opt.full ? truth_make(&p, 16u << i) : NULL;
        bench_job b = picture_time(&p, "samples", i < 3 ? 3 : 1);
        char kase[48];
        snprintf(kase, sizeof kase, "forest-1, %u x %u", sizes[i][0], sizes[i][1]);
        (void)picture_line("zbufrand.resolution", kase, "samples", &p, &b, t, 1);
        if (t != NULL) truth_free(t);
        picture_free(&p);
    }
}

/* ---- BM9: build ---- */

typedef struct build_job {
    supi_make *make;
    zbufrand_scene_desc desc;
    zbufrand_scene_info info;
    uint64_t hash;
} build_job;

static void build_run(void *ctx) {
    build_job *j = (build_job *)ctx;
    const sup_mesh *m = &j->make->mesh;
    zbufrand_scene *s = NULL;
    zbufrand_mesh z;
    memset(&z, 0, sizeof z);
    z.positions = m->positions;
    z.vertex_count = m->vertex_count;
    z.indices = m->indices;
    z.triangle_count = m->triangle_count;
    must(zbufrand_scene_create(&j->desc, &s), "scene");
    must(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, 0, &z, NULL), "mesh");
    must(zbufrand_scene_build(s, NULL, &j->info), "build");
    j->hash = bench_hash_bytes(s->structure[0].node, s->structure[0].node_count * sizeof *s->structure[0].node);
    zbufrand_scene_destroy(s);
}

static void bm9(void) {
    const int sizes[4] = {158, 512, 1448, 5000};
    int i, k;
    for (i = 0; i < (g_opt.full ? 4 : 2); i++) {
        supi_make make = blob_mesh(sizes[i]);
        double wall = 0.0, cpu = 0.0;
        for (k = 0; k < 2; k++) {
            build_job j;
            bench_job b;
            char kase[48];
            memset(&j, 0, sizeof j);
            memset(&b, 0, sizeof b);
            j.make = &make;
            j.desc.env.thread_count = k == 0 ? 1u : (uint32_t)g_opt.threads;
            b.run = build_run;
            b.ctx = &j;
            bench_interleave(&b, 1, i < 2 ? 5 : 1);
            snprintf(kase, sizeof kase, "blob, %.3g triangles", (double)make.mesh.triangle_count);
            if (k == 0) cpu = bench_seconds(&b);
            else wall = bench_median(b.wall, b.rounds);
            bench_line("zbufrand.build", kase, "triangles_per_second",
                       (double)make.mesh.triangle_count / (k == 0 ? cpu : wall), "1/s");
            bench_num("best", (double)make.mesh.triangle_count / bench_least(k == 0 ? b.cpu : b.wall, b.rounds));
            bench_num("error", (double)j.info.skipped_triangles);
            bench_text("error_unit", "triangles left out");
            bench_num("threads", j.desc.env.thread_count);
            bench_num("bytes", (double)j.info.bytes);
            bench_num("bytes_per_triangle", (double)j.info.bytes / (double)j.info.stored_triangles);
            bench_num("peak_bytes_per_triangle", (double)j.info.peak_bytes / (double)j.info.stored_triangles);
            bench_num("wall", bench_median(b.wall, b.rounds));
            bench_hash(j.hash);
            bench_end();
            if (sizes[i] == 512 && k == 1) {
                table_set("build", "%.3f (%.3f)", wall, cpu);
                table_set("memory", "%.1f", (double)j.info.bytes / (double)j.info.stored_triangles);
            }
        }
        sup_mesh_free(&make.mesh);
    }
}

/* ---- BM10: edits ---- */

typedef struct edits {           /* a scene of 400 trees with an object of 10^4 triangles in it */
    world *w;
    supi_make object;
    zbufrand_node node, model;
} edits;

static zbufrand_mesh edit_mesh(const edits *e) {
    zbufrand_mesh m;
    memset(&m, 0, sizeof m);
    m.positions = e->object.mesh.positions;
    m.vertex_count = e->object.mesh.vertex_count;
    m.indices = e->object.mesh.indices;
    m.triangle_count = e->object.mesh.triangle_count;
    return m;
}

/* What is in the scene against what should be: relative error of its area. */
static double edit_line(const edits *e, const char *kase, const char *method, const double *cpu, const double *wall, int n, double work,
                        double area, double threads) {
    zbufrand_scene_info info;
    zbufrand_scene_get_info(e->w->w.scene, &info);
    bench_line("zbufrand.edit", kase, "update_time", 1e3 * bench_median(threads > 1.0 ? wall : cpu, n), "ms");
    bench_num("best", 1e3 * bench_least(threads > 1.0 ? wall : cpu, n));
    bench_num("error", fabs(info.area - area) / area);
    bench_text("error_unit", "of the area");
    bench_text("method", method);
    bench_num("edits", work);
    bench_num("us_an_edit", 1e6 * bench_median(cpu, n) / work);
    bench_num("threads", threads);
    bench_num("bytes", (double)info.bytes);
    bench_end();
    return 1e3 * bench_median(cpu, n);
}

static void edit_update(edits *e, double *cpu, double *wall) {
    const double c = bench_cpu(), t = bench_wall();
    must(zbufrand_scene_update(e->w->w.scene, NULL), "update");
    *cpu = bench_cpu() - c;
    *wall = bench_wall() - t;
}

static void edit_object(edits *e, const char *kase) {
    enum { N = 15 };
    double cpu[N], wall[N], ms[3], area0, area;
    const zbufrand_mesh m = edit_mesh(e);
    zbufrand_scene *s = e->w->w.scene;
    zbufrand_scene_info info;
    int i, k;
    zbufrand_scene_get_info(s, &info);
    area0 = info.area;
    area = 0.0;
    for (k = 0; k < 4; k++) { /* the first move, moves, references, meshes */
        static const char *const names[4] = {"moved for the first time", "moved", "a reference inserted", "a mesh inserted"};
        for (i = 0; i < N; i++) {
            const double turn = 0.4 * (double)i + (double)k;
            zbufrand_transform t = supi_world_place(30.0 * cos(turn), 5.0, 30.0 * sin(turn), turn, 1.0);
            if (k <= 1) must(zbufrand_move(s, e->node, &t), "move");
            if (k == 2) must(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, e->model, NULL), "reference");
            if (k == 3) must(zbufrand_add_mesh(s, ZBUFRAND_ROOT, &t, 0, &m, NULL), "mesh");
            edit_update(e, &cpu[i], &wall[i]);
            if (k == 0) break;
        }
        if (k == 2) {
            zbufrand_scene_get_info(s, &info);
            area = (info.area - area0) / N;
        }
        ms[k > 0 ? k - 1 : 0] = edit_line(e, kase, names[k], cpu, wall, k == 0 ? 1 : N, 1, area0 + (k < 2 ? 0.0 : (double)(k - 1) * N * area), 1);
    }
    table_set("edit", "%.3f / %.3f / %.2f", ms[0], ms[1], ms[2]);
}

/* Parts of 10^5 references moved between two pictures, against building it all anew. */
static void edit_many(void) {
    enum { COUNT = 100000 };
    edits e;
    zbufrand_transform *t;
    bench_rng rng = {5};
    picture_job p;
    double cpu[5], wall[5];
    zbufrand_node node;
    int i, k, share;
    memset(&e, 0, sizeof e);
    e.object = blob_mesh(16);
    e.w = world_open("10^5 instances", (uint32_t)g_opt.threads);
    node = supi_world_mesh(&e.w->w, &e.object, ZBUFRAND_ROOT, 0, 0, ZBUFRAND_HIDDEN);
    t = supi_world_array(&e.w->w, COUNT);
    if (t == NULL) run_failed("edits", "not enough memory");
    for (i = 0; i < COUNT; i++)
        t[i] = supi_world_place(3.0 * (double)(i % 316), 2.0 * (double)bench_random(&rng), 3.0 * (double)(i / 316), (double)i, 1.0);
    must(zbufrand_add_references(e.w->w.scene, ZBUFRAND_ROOT, t, COUNT, node, &e.node), "references");
    world_build(e.w);
    world_view(e.w, 474, 60, 1100, 474, 0, 600, 45);
    bench_line("zbufrand.edit", e.w->name, "build_time", 1e3 * e.w->cpu, "ms");
    bench_num("error", 0);
    bench_text("error_unit", "of the area");
    bench_text("method", "built anew");
    bench_end();
    for (share = 0; share < 3; share++) {
        static const int moved[3] = {1, COUNT / 100, COUNT / 10};
        for (k = 0; k < 5; k++) {
            for (i = 0; i < moved[share]; i++) {
                const size_t at = (size_t)bench_random_u32(&rng) % COUNT;
                t[at].m[0][3] += (double)bench_random(&rng) - 0.5;
                t[at].m[1][3] = 2.0 * (double)bench_random(&rng);
                must(zbufrand_set_reference(e.w->w.scene, e.node, at, &t[at]), "reference");
            }
            edit_update(&e, &cpu[k], &wall[k]);
            if (share == 0 && k == 0) (void)edit_line(&e, e.w->name, "the first update", cpu, wall, 1, 1, e.w->info.area, 1);
        }
        (void)edit_line(&e, e.w->name, share == 0 ? "one moved" : share == 1 ? "1 % moved" : "10 % moved", cpu, wall, 5,
                        moved[share], e.w->info.area, g_opt.threads);
    }
    p = picture_open(e.w, 640, 480, 1);
    for (k = 0; k < 2; k++) { /* pictures before and after a build: what the edits did to the trees */
        bench_job b;
        if (k == 1) must(zbufrand_scene_build(e.w->w.scene, NULL, NULL), "build");
        b = picture_time(&p, k == 0 ? "after 55,000 moves" : "built anew", 5);
        (void)picture_line("zbufrand.edited", e.w->name, k == 0 ? "after 55,000 moves" : "built anew", &p, &b, NULL, 1);
    }
    picture_free(&p);
    world_free(e.w);
}

static void bm10(void) {
    edits e;
    zbufrand_mesh m;
    memset(&e, 0, sizeof e);
    e.w = world_trees(0);
    e.object = blob_mesh(50);
    m = edit_mesh(&e);
    must(zbufrand_add_mesh(e.w->w.scene, ZBUFRAND_ROOT, NULL, 0, &m, &e.node), "mesh");
    must(zbufrand_add_mesh(e.w->w.scene, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &e.model), "mesh");
    must(zbufrand_add_reference(e.w->w.scene, ZBUFRAND_ROOT, NULL, e.model, NULL), "reference");
    world_build(e.w);
    edit_object(&e, e.w->name);
    sup_mesh_free(&e.object.mesh);
    world_free(e.w);
    edit_many();
}

/* ---- BM11: inner loops ---- */

typedef struct points_job {
    const zbufrand_scene *scene;
    zbufrand_surface_points_desc desc;
    size_t count;
    float *positions, *normals;
} points_job;

static void points_run(void *ctx) {
    points_job *j = (points_job *)ctx;
    must(zbufrand_surface_points(j->scene, &j->desc, j->count, j->positions, j->normals, NULL, NULL), "points");
}

static void points_bench(const world *w) {
    points_job j;
    bench_job b;
    int k;
    memset(&j, 0, sizeof j);
    j.scene = w->w.scene;
    j.count = 4u << 20;
    j.positions = (float *)must_alloc(3 * j.count, sizeof(float));
    j.normals = (float *)must_alloc(3 * j.count, sizeof(float));
    for (k = 0; k < 2; k++) {
        double sum[3] = {0, 0, 0}, mean[3] = {0, 0, 0}, off = 0.0;
        size_t i;
        int a;
        memset(&b, 0, sizeof b);
        j.desc.independent = (uint32_t)k;
        if (k == 1) j.count = 1u << 20;
        b.run = points_run;
        b.ctx = &j;
        bench_interleave(&b, 1, 5);
        for (i = 0; i < j.count; i++) { /* the first half against all: in random order their centres agree */
            for (a = 0; a < 3; a++) {
                mean[a] += (double)j.positions[3 * i + (size_t)a] / (double)j.count;
                if (2 * i < j.count) sum[a] += 2.0 * (double)j.positions[3 * i + (size_t)a] / (double)j.count;
            }
        }
        for (a = 0; a < 3; a++) off += (sum[a] - mean[a]) * (sum[a] - mean[a]);
        bench_line("zbufrand.points", w->name, "points_per_second", bench_rate(&b, (double)j.count), "1/s");
        bench_num("best", bench_rate_best(&b, (double)j.count));
        bench_num("error", sqrt(off));
        bench_text("error_unit", "distance of the centre of half of them from that of all");
        bench_text("method", k == 0 ? "stratified" : "independent");
        bench_num("threads", 1);
        bench_num("points", (double)j.count);
        bench_hash(bench_hash_bytes(j.positions, 12 * j.count));
        bench_end();
        if (k == 0) table_set("points", "%.0f", 1e-6 * bench_rate(&b, (double)j.count));
    }
    free(j.positions);
    free(j.normals);
}

typedef struct zbuffer_job {
    const zbufrand_scene *scene;
    zbufrandi_camera camera;
    zbufrandi_keys keys;
    uint64_t triangles, covered;
} zbuffer_job;

static void zbuffer_run(void *ctx) {
    zbuffer_job *j = (zbuffer_job *)ctx;
    zbufrandi_mem mem;
    zbufrand_env env;
    memset(&env, 0, sizeof env);
    env.thread_count = 1;
    must(zbufrandi_env_open(&env, &mem), "memory");
    memset(j->keys.key, 0xff, (size_t)j->keys.width * j->keys.height * 8);
    must(baseline_zbuffer_draw(j->scene, &j->camera, &j->keys, &env, &mem, zbufrandi_cpu_level(), &j->triangles, &j->covered),
         "z-buffer");
}

static void zbuffer_bench(const world *w, int in_table) {
    picture_job p = picture_open(w, 1024, 768, 1);
    zbuffer_job j;
    bench_job b;
    memset(&j, 0, sizeof j);
    memset(&b, 0, sizeof b);
    j.scene = w->w.scene;
    must(zbufrandi_camera_open(&p.desc.camera, p.scene, 1024, 768, 0, &j.camera), "camera");
    j.keys.width = 1024;
    j.keys.height = 768;
    j.keys.key = (uint64_t *)must_alloc(1024 * 768, 8);
    b.run = zbuffer_run;
    b.ctx = &j;
    bench_interleave(&b, 1, 5);
    bench_line("zbufrand.zbuffer", w->name, "triangles_per_second", bench_rate(&b, (double)j.triangles), "1/s");
    bench_num("best", bench_rate_best(&b, (double)j.triangles));
    bench_num("error", 0);
    bench_text("error_unit", "pixels");
    bench_num("threads", 1);
    bench_num("triangles", (double)j.triangles);
    bench_num("pixels", (double)j.covered);
    bench_num("ms", 1e3 * bench_seconds(&b));
    bench_hash(bench_hash_bytes(j.keys.key, 8 * (size_t)1024 * 768));
    bench_end();
    if (in_table) table_set("raster", "%.0f", 1e-6 * bench_rate(&b, (double)j.triangles));
    free(j.keys.key);
    picture_free(&p);
}

/* Rates of whole frames and of their drawing alone when everything is sampled. */
static void rates(const world *w, const char *kase, uint32_t width, uint32_t height, int off, const char *row_frame,
                  const char *row_kernel) {
    picture_job p = picture_open(w, width, height, 1);
    const truth *t = shared_truth(w, 0, &p);
    bench_job b;
    double drawn, draw, draws[5];
    wrong out;
    int k;
    if (off) p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    b = picture_time(&p, "samples", 5);
    out = judge(t, p.image.rgba, NULL, p.image.depth, NULL);
    drawn = (double)(p.stats.samples[0] + p.stats.samples[1]);
    for (k = 0; k < 5; k++) {
        picture_run(&p);
        draws[k] = p.stats.seconds[ZBUFRAND_STAGE_DRAW];
    }
    draw = bench_median(draws, 5);
    bench_line("zbufrand.rates", kase, "accepted_per_second", bench_rate(&b, (double)p.stats.accepted), "1/s");
    bench_num("error", out.rmse);
    bench_text("error_unit", "RMSE to 256 samples");
    bench_num("threads", 1);
    picture_nums(&p, &b);
    bench_end();
    bench_line("zbufrand.rates", kase, "drawn_per_second", drawn / draw, "1/s");
    bench_num("error", out.rmse);
    bench_text("error_unit", "RMSE to 256 samples");
    bench_text("method", "drawing alone");
    bench_num("threads", 1);
    bench_end();
    if (row_frame != NULL) table_set(row_frame, "%.1f", 1e-6 * bench_rate(&b, (double)p.stats.accepted));
    if (row_kernel != NULL) table_set(row_kernel, "%.0f", 1e-6 * drawn / draw);
    picture_free(&p);
}

/* A cloud of the caller's points; the cut alone. */
static void cloud_bench(const world *w) {
    picture_job p = picture_open(w, 1024, 768, 1);
    bench_job b;
    zbufrand_points cloud;
    float *position = (float *)must_alloc(3 << 21, sizeof *position);
    uint8_t *rgb = (uint8_t *)must_alloc(3 << 21, 1);
    double cpu[5];
    size_t groups = 0;
    int k;
    memset(&cloud, 0, sizeof cloud);
    p.desc.lights = &p.light;
    cloud.positions = position;
    cloud.rgb = rgb;
    cloud.count = (size_t)1 << 21;
    for (k = 0; k < 5; k++) {
        const double start = bench_cpu();
        must(zbufrand_select(p.frame, &p.desc, p.scene, 1024, 768, NULL, 0, &groups, &p.stats), "select");
        cpu[k] = bench_cpu() - start;
    }
    bench_line("zbufrand.select", w->name, "children_per_second", (double)p.stats.tested / bench_median(cpu, 5), "1/s");
    bench_num("error", 0);
    bench_num("groups", (double)groups);
    bench_num("nodes", (double)p.stats.nodes);
    bench_num("ms", 1e3 * bench_median(cpu, 5));
    bench_num("threads", 1);
    bench_end();
    must(zbufrand_surface_points(p.scene, NULL, cloud.count, position, NULL, rgb, NULL), "points");
    p.scene = NULL;
    p.desc.points = &cloud;
    p.desc.points_count = 1;
    b = picture_time(&p, "own points", 5);
    bench_line("zbufrand.cloud", w->name, "points_per_second", bench_rate(&b, (double)cloud.count), "1/s");
    bench_num("error", 0);
    bench_num("threads", 1);
    picture_nums(&p, &b);
    bench_end();
    free(position);
    free(rgb);
    picture_free(&p);
}

static void bm11(void) {
    world *w = world_blob(512);
    points_bench(w);
    zbuffer_bench(w, 0);
    cloud_bench(w);
    world_free(w);
    if (g_opt.full) {
        w = world_blob(51);
        points_bench(w);
        world_free(w);
    }
    w = shared_world(SHARED_BLOB, 0);
    if (g_opt.full) points_bench(w);
    zbuffer_bench(w, 1);
    rates(w, w->name, 1024, 768, 1, "dense", NULL);
    w = shared_world(SHARED_FOREST, 0);
    rates(w, w->name, 640, 480, 0, "sparse", "kernel");
}

/* ---- BM12: noise from frame to frame ---- */

/* Error of what an accumulator shows after some frames, of a camera that stands still or moves half a pixel a frame. */
static void temporal(const world *w) {
    static const char *const names[3] = {"mean", "smooth", "adaptive"};
    const uint32_t width = 320, height = 240, frames = g_opt.full ? 64 : 8;
    int way, moving;
    for (moving = 0; moving < 2; moving++) {
        picture_job last = picture_open(w, width, height, 1);
        truth *t;
        last.desc.camera.at[0] += moving ? 0.03 * (double)(frames - 1) : 0.0;
        t = truth_make(&last, g_opt.full ? 4 : 24);
        for (way = moving; way < 3; way++) {
            picture_job p = picture_open(w, width, height, 1);
            zbufrand_accumulator_desc ad;
            zbufrand_accumulator *sum = NULL;
            float *rgba = (float *)must_alloc((size_t)width * height, 16);
            uint32_t k;
            memset(&ad, 0, sizeof ad);
            ad.env.thread_count = 1;
            ad.width = width;
            ad.height = height;
            ad.mode = (zbufrand_accumulation)way;
            ad.blur = moving ? 2.0f : 0.0f;
            p.desc.spread = moving ? 0 : frames;
            must(zbufrand_accumulator_create(&ad, &sum), "accumulator");
            for (k = 0; k < frames; k++) {
                zbufrand_view view;
                p.desc.frame = k;
                p.desc.camera.at[0] = w->camera.at[0] + (moving ? 0.03 * (double)k : 0.0);
                picture_run(&p);
                must(zbufrand_camera_view(&p.desc.camera, p.scene, width, height, &view), "view");
                must(zbufrand_accumulator_add(sum, p.image.rgba, p.image.depth, &view), "frame");
                if ((k & (k + 1)) != 0 || (moving && k + 1 < frames)) continue; /* after 1, 2, 4, ... */
                must(zbufrand_accumulator_get(sum, 0.0f, rgba), "mean");
                {
                    const wrong out = judge(t, rgba, NULL, NULL, NULL);
                    bench_line("zbufrand.temporal", moving ? "moving" : "still", "rmse", out.rmse, "");
                    bench_num("error", out.rmse);
                    bench_num("error_of_one_frame", judge(t, p.image.rgba, NULL, NULL, NULL).rmse);
                    bench_text("error_unit", "RMSE to 256 samples");
                    bench_text("method", names[way]);
                    bench_num("frames", k + 1);
                    bench_end();
                }
            }
            zbufrand_accumulator_destroy(sum);
            free(rgba);
            picture_free(&p);
        }
        truth_free(t);
        picture_free(&last);
    }
}

static void bm12(void) {
    world *w = world_trees(0);
    const uint32_t width = 320, height = 240, frames = g_opt.full ? 64 : 8;
    const size_t values = 3 * (size_t)width * height;
    double *sum = (double *)must_alloc(values, sizeof(double)), *square = (double *)must_alloc(values, sizeof(double));
    int way;
    for (way = 0; way < 5; way++) {
        static const char *const names[5] = {"default", "default, seed kept, eye moves a pixel a frame", "no repair", "independent samples",
                                             "blocks of 2"};
        picture_job p = picture_open(w, width, height, 1);
        double noise = 0.0, flicker = 0.0;
        uint32_t k;
        size_t i;
        memset(sum, 0, values * sizeof *sum);
        memset(square, 0, values * sizeof *square);
        p.desc.no_repair = way == 2 || way == 3;
        if (way >= 2 && way < 4) p.desc.density = 4.0;
        p.desc.independent = way == 3;
        p.desc.reconstruct.block = way == 4 ? 2 : 1;
        for (k = 0; k < frames; k++) {
            if (way != 1) p.desc.frame = k;
            else p.desc.camera.at[0] = w->camera.at[0] + 0.06 * (double)k; /* about a pixel at that distance */
            picture_run(&p);
            for (i = 0; i < values; i++) {
                const double v = shown((double)p.image.rgba[4 * (i / 3) + i % 3]);
                sum[i] += v;
                square[i] += v * v;
            }
        }
        for (i = 0; i < values; i++) {
            const double mean = sum[i] / (double)frames, variance = square[i] / (double)frames - mean * mean;
            noise += variance > 0.0 ? variance : 0.0;
            flicker += variance > 0.01 ? 1.0 : 0.0; /* more than a tenth of the range */
        }
        bench_line("zbufrand.noise", w->name, "deviation", sqrt(noise / (double)values), "");
        bench_num("error", sqrt(noise / (double)values));
        bench_text("error_unit", "sRGB 0..1");
        bench_num("share_above_a_tenth", flicker / (double)values);
        bench_num("frames", frames);
        bench_text("method", names[way]);
        bench_end();
        picture_free(&p);
    }
    free(sum);
    free(square);
    temporal(w);
    world_free(w);
}

/* ---- BM13: worst cases ---- */

/* `sheets` quads seen edge-on, and one that is turned: bounds of whole groups know nothing about them. */
static world *world_sheets(int sheets, int turned) {
    supi_make make;
    char name[48];
    world *w;
    int i;
    memset(&make, 0, sizeof make);
    for (i = 0; i < sheets; i++) {
        const float y = 0.2f * (float)i / (float)sheets, tilt = turned && i == sheets / 2 ? 0.2f : 0.0f;
        const float a[3] = {-1.0f, y, 1.0f}, b[3] = {1.0f, y, 1.0f}, c[3] = {1.0f, y + tilt, -1.0f}, d[3] = {-1.0f, y + tilt, -1.0f};
        supi_make_colour(&make, 100 + i * 31 % 150, 100 + i * 17 % 150, 120);
        supi_make_patch(&make, a, b, c, d);
    }
    snprintf(name, sizeof name, "%d sheets edge-on%s", sheets, turned ? ", one turned" : "");
    w = world_open(name, (uint32_t)g_opt.threads);
    (void)supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, 0);
    world_build(w);
    world_view(w, 0, 0.21, 4.0, 0, 0.1, 0, 45);
    return w;
}

/* Copies of a hall that all overlap. */
static world *world_overlap(int copies) {
    supi_make make;
    char name[48];
    world *w;
    zbufrand_node node;
    zbufrand_transform *t;
    bench_rng rng = {3};
    int i;
    memset(&make, 0, sizeof make);
    supi_make_hall(&make, 128);
    snprintf(name, sizeof name, "%d instances that overlap", copies);
    w = world_open(name, (uint32_t)g_opt.threads);
    node = supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, ZBUFRAND_HIDDEN);
    t = supi_world_array(&w->w, (size_t)copies);
    if (t == NULL) run_failed(name, "not enough memory");
    for (i = 0; i < copies; i++)
        t[i] = supi_world_place((double)bench_random(&rng), 0.2 * (double)bench_random(&rng), (double)bench_random(&rng),
                                6.28 * (double)bench_random(&rng), 1.0);
    must(zbufrand_add_references(w->w.scene, ZBUFRAND_ROOT, t, (size_t)copies, node, NULL), name);
    world_build(w);
    world_view(w, -7.7, 0.9, -7.4, 0.5, -0.4, 0.7, 60);
    return w;
}

/* many: that many large triangles nearly edge-on. Else one huge triangle below `micro` tiny ones. */
static world *world_large(int many, int micro) {
    supi_make make;
    char name[48];
    bench_rng rng = {8};
    world *w;
    int i;
    memset(&make, 0, sizeof make);
    for (i = 0; i < many + (micro > 0) + micro; i++) {
        const float s = i < many ? 3.0f : i == many && micro > 0 ? 1000.0f : 0.002f;
        const float x = i < many || s > 1.0f ? 0.0f : 4.0f * bench_random(&rng) - 2.0f, z = i < many || s > 1.0f ? 0.0f : 4.0f * bench_random(&rng) - 2.0f;
        const float y = i < many ? 0.002f * (float)i : s > 1.0f ? 0.0f : 0.05f * bench_random(&rng), tilt = i < many ? 0.003f * bench_random(&rng) : 0.0f;
        const uint32_t first = supi_make_point(&make, x - s, y, z + s);
        supi_make_colour(&make, 80 + i * 37 % 170, 80 + i * 11 % 170, 90);
        (void)supi_make_point(&make, x + s, y, z + s);
        (void)supi_make_point(&make, x, y + tilt, z - s);
        supi_make_triangle(&make, first, first + 1, first + 2);
    }
    if (many > 0) snprintf(name, sizeof name, "%d large triangles nearly edge-on", many);
    else snprintf(name, sizeof name, "one huge triangle, %.0e tiny ones", (double)micro);
    w = world_open(name, (uint32_t)g_opt.threads);
    (void)supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 1, 0, 0);
    world_build(w);
    world_view(w, 0, many > 0 ? 0.002 * many + 0.05 : 1.5, 4.0, 0, 0, 0, 45);
    return w;
}

static void bm13(void) {
    int i, most = g_opt.full ? 1000000 : 1000;
    for (i = 100; i <= most; i *= 10) {
        int turned;
        for (turned = 0; turned < 2; turned++) {
            world *w = world_sheets(i, turned);
            picture_job p = picture_open(w, 640, 480, 1);
            truth *t = truth_make(&p, g_opt.full ? 32 : 128);
            int way;
            for (way = 0; way < 2; way++) {
                bench_job b;
                p.desc.hybrid = way == 0 ? ZBUFRAND_HYBRID_AUTO : ZBUFRAND_HYBRID_OFF;
                b = picture_time(&p, way == 0 ? "by cost" : "sampled", 3);
                (void)picture_line("zbufrand.worst", w->name, way == 0 ? "by cost" : "sampled", &p, &b, t, 1);
            }
            truth_free(t);
            picture_free(&p);
            world_free(w);
        }
    }
    for (i = 0; i < 2; i++) {
        world *w = i == 0 ? world_large(1000, 0) : world_large(0, g_opt.full ? 10000000 : 200000);
        (void)simple_time("zbufrand.worst", w, "by cost", 640, 480, 0, g_opt.full ? 64 : 192, 3, NULL);
        world_free(w);
    }
    for (i = 1; i <= 64; i *= 8) {
        world *w = world_overlap(i);
        (void)simple_time("zbufrand.worst", w, "by cost", 640, 480, 0, g_opt.full ? 64 : 192, 3, NULL);
        world_free(w);
    }
    { /* slats seen at angles: half of what there is hides the other half */
        static const double angles[4] = {0.1, 1.0, 10.0, 60.0};
        world *w = world_sheets(500, 0);
        for (i = 0; i < (g_opt.full ? 4 : 2); i++) {
            const double a = angles[g_opt.full ? i : 2 * i + 1] * (3.14159265358979 / 180.0);
            char name[48];
            snprintf(name, sizeof name, "500 sheets at %g degrees", angles[g_opt.full ? i : 2 * i + 1]);
            memcpy(w->name, name, sizeof name);
            world_view(w, 0, 0.1 + 4.0 * sin(a), 4.0 * cos(a), 0, 0.1, 0, 45);
            (void)simple_time("zbufrand.worst", w, "by cost", 640, 480, 0, 64, 3, NULL);
        }
        world_free(w);
    }
}

/* ---- BM14: threads ---- */

static void bm14(void) {
    world *w = shared_world(SHARED_FOREST, 0);
    uint64_t hash = 0;
    double one = 0.0;
    int threads;
    for (threads = 1; threads <= g_opt.threads; threads *= 2) {
        picture_job p = picture_open(w, g_opt.full ? 1280 : 640, g_opt.full ? 960 : 480, (uint32_t)threads);
        bench_job b = picture_time(&p, "samples", 3);
        if (threads == 1) hash = picture_hash(&p);
        if (threads == 1) one = bench_median(b.wall, b.rounds);
        bench_line("zbufrand.threads", g_opt.full ? "forest-1, 1280 x 960" : "forest-1, 640 x 480", "wall_time", 1e3 * bench_median(b.wall, b.rounds), "ms");
        bench_num("error", (double)(picture_hash(&p) != hash));
        bench_text("error_unit", "pictures that differ");
        bench_num("threads", threads);
        bench_num("times_one_thread", one / bench_median(b.wall, b.rounds));
        bench_hash(picture_hash(&p));
        bench_end();
        picture_free(&p);
    }
}

/* ---- BM15: shading, attributes ---- */

static void shade_phong(void *user, const zbufrand_surface *s, size_t count, float *rgba) { /* two lights, highlights */
    static const double lights[2][3] = {{0.4, 0.8, 0.45}, {-0.7, 0.5, 0.5}};
    const double *eye = (const double *)user;
    size_t i, k;
    int a;
    for (i = 0; i < count; i++) {
        double bright = 0.2, shine = 0.0, v[3], l = 0.0;
        for (a = 0; a < 3; a++) {
            v[a] = eye[a] - s[i].position[a];
            l += v[a] * v[a];
        }
        l = l > 0.0 ? 1.0 / sqrt(l) : 0.0;
        for (k = 0; k < 2; k++) {
            double d = 0.0, h = 0.0, hl = 0.0;
            for (a = 0; a < 3; a++) {
                const double half = lights[k][a] + v[a] * l;
                d += lights[k][a] * (double)s[i].normal[a];
                h += half * (double)s[i].normal[a];
                hl += half * half;
            }
            if (d > 0.0) bright += 0.5 * d;
            if (h > 0.0) shine += pow(h / sqrt(hl), 40.0);
        }
        for (a = 0; a < 3; a++) rgba[4 * i + (size_t)a] = (float)((double)s[i].rgb[a] * bright + 0.3 * shine);
        rgba[4 * i + 3] = 1.0f;
    }
}

static void bm15(void) {
    static const char *const names[4] = {"unlit", "one light", "eight lights", "callback, two lights with highlights"};
    world *w = world_named("landscape", 0);
    zbufrand_light lights[8];
    int i, k;
    memset(lights, 0, sizeof lights);
    for (k = 0; k < 8; k++) {
        lights[k].position[0] = cos((double)k);
        lights[k].position[1] = 1.0;
        lights[k].position[2] = sin((double)k);
        lights[k].directional = k & 1;
        lights[k].color[0] = lights[k].color[1] = lights[k].color[2] = 0.12f;
    }
    for (i = 0; i < 4; i++) {
        picture_job p = picture_open(w, 640, 480, 1);
        zbufrand_render_desc *d = &p.desc;
        double all[5];
        p.desc.unlit = i == 0;
        p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
        d->lights = i == 2 ? lights : &p.light;
        d->light_count = i == 2 ? 8 : 1;
        if (i == 3) {
            d->shade_fn = shade_phong;
            d->shade_user = d->camera.eye;
        }
        for (k = 0; k < 6; k++) {
            const double t = bench_cpu();
            must(zbufrand_render(p.frame, d, p.scene, &p.image, &p.stats), "render");
            if (k > 0) all[k - 1] = bench_cpu() - t;
        }
        bench_line("zbufrand.shade", "landscape-1", "frame_time", 1e3 * bench_median(all, 5), "ms");
        bench_num("error", p.stats.incomplete);
        bench_text("error_unit", "probability of an incomplete picture");
        bench_text("method", names[i]);
        bench_num("shade_ms", 1e3 * p.stats.seconds[ZBUFRAND_STAGE_SHADE]);
        bench_num("surfaces_shaded", (double)p.stats.covered);
        bench_num("samples_accepted", (double)p.stats.accepted);
        bench_num("threads", 1);
        bench_hash(picture_hash(&p));
        bench_end();
        picture_free(&p);
    }
    world_free(w);
}

/* ---- BM16: how many samples make a complete picture ---- */

/* Pixels that surfaces cover with a margin of a pixel are wrong when they stay empty or show something more than 1 % behind
   all that is seen in them and around them, at 3 x 3 places in each. Counted over pictures with random numbers of their
   own. */
static void complete_way(const world *w, const char *method, int independent, double density, int repair, uint32_t pictures,
                         double *out_density, double *out_rays, double *out_promised, double *out_failed) {
    const uint32_t width = 320, height = 240;
    picture_job p = picture_open(w, width, height, 1);
    picture_job exact = picture_open(w, 3 * width, 3 * height, 1);
    uint32_t k, failed = 0;
    float *behind = (float *)must_alloc((size_t)width * height, sizeof(float));
    size_t i, bad_pixels = 0;
    double rays = 0.0, used = 0.0, promised = 0.0, cpu;
    picture_raster(&exact, 1);
    picture_run(&exact);
    for (i = 0; i < (size_t)width * height; i++) {
        const uint32_t x = (uint32_t)(i % width), y = (uint32_t)(i / width);
        uint32_t dx, dy;
        behind[i] = x == 0 || y == 0 || x + 1 == width || y + 1 == height ? INFINITY : 0.0f;
        for (dy = 0; dy < 9; dy++)
            for (dx = 0; dx < 9 && behind[i] < INFINITY; dx++)
                behind[i] = fmaxf(behind[i], exact.image.depth[(size_t)(3 * y + dy - 3) * (3 * width) + 3 * x + dx - 3] * 1.01f);
    }
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    p.desc.independent = (uint32_t)independent;
    p.desc.no_repair = !repair;
    p.desc.density = density;
    cpu = bench_cpu();
    for (k = 0; k < pictures; k++) {
        size_t bad = 0;
        p.desc.frame = k;
        picture_run(&p);
        for (i = 0; i < (size_t)width * height; i++) bad += p.image.depth[i] > behind[i];
        bad_pixels += bad;
        failed += bad != 0;
        rays += (double)(p.stats.holes + p.stats.wrong) / (double)((size_t)width * height) / (double)pictures;
        used += p.stats.density / (double)pictures;
        promised += p.stats.incomplete / (double)pictures;
    }
    cpu = bench_cpu() - cpu;
    bench_line("zbufrand.complete", "320 x 240, filled", "incomplete_share", (double)failed / (double)pictures, "");
    bench_num("error", (double)bad_pixels / (double)pictures);
    bench_text("error_unit", "pixels a picture");
    bench_text("method", method);
    bench_num("density", used);
    bench_num("rays_per_pixel", rays);
    bench_num("promised_at_most", promised);
    bench_num("pictures", pictures);
    bench_num("ms_a_picture", 1e3 * cpu / (double)pictures);
    bench_end();
    if (out_density != NULL) *out_density = used;
    if (out_rays != NULL) *out_rays = rays;
    if (out_promised != NULL) *out_promised = promised;
    *out_failed = (double)failed / (double)pictures;
    free(behind);
    picture_free(&p);
    picture_free(&exact);
}

/* Upper bound of a probability of which `failed` of n were seen, 95 % sure (Clopper and Pearson), by halving. */
static double at_most(uint32_t failed, uint32_t n) {
    double lo = 0.0, hi = 1.0;
    int i;
    for (i = 0; i < 50; i++) {
        const double p = 0.5 * (lo + hi);
        double term = pow(1.0 - p, (double)n), sum = 0.0;
        uint32_t k;
        for (k = 0; k <= failed; k++) {
            sum += term;
            term *= (double)(n - k) / (double)(k + 1) * p / (1.0 - p);
        }
        if (sum > 0.05) lo = p;
        else hi = p;
    }
    return hi;
}

static void bm16(void) {
    static const double independent[3] = {0.05, 0.5, 0.95}, stratified[6] = {5.0, 6.0, 6.5, 7.0, 7.5, 8.0};
    const uint32_t pictures = g_opt.full ? 400 : 20, most = 400;
    world *w = world_blob(512);
    double density = 0.0, rays = 0.0, promised = 0.0, failed, least = 0.0, alone = 0.0;
    int i;
    world_view(w, 0.3, 0.2, 1.9, 0, 0, 0, 30);
    for (i = g_opt.full ? 0 : 2; i < 3; i++) {
        char name[64];
        snprintf(name, sizeof name, "independent, for probability %g", independent[i]);
        density = -log(-expm1(log(independent[i]) / (320.0 * 240.0)));
        complete_way(w, name, 1, density, 0, pictures, NULL, NULL, NULL, &failed);
    }
    for (i = 0; i < 6; i++) { /* the fewest samples that are complete as often as was asked for, without rays */
        char name[64];
        if (!g_opt.full && i != 1 && i != 2) continue;
        snprintf(name, sizeof name, "stratified, %g per pixel", stratified[i]);
        complete_way(w, name, 0, stratified[i], 0, g_opt.full ? pictures : 200, NULL, NULL, NULL, &failed);
        if (failed <= 0.05 && least == 0.0) {
            least = stratified[i];
            alone = failed;
        }
    }
    complete_way(w, "default: probability 0.95, with rays", 0, 0.0, 1, most, &density, &rays, &promised, &failed);
    table_set("complete", "%.1f (%.1f), %.0f of %u failed: at most %.1f %%, %.1f %% reported; alone %.1f: %.1f %% (iid %.1f)", density, 1e3 * rays,
              failed * (double)most, (unsigned)most, 100.0 * at_most((uint32_t)(failed * (double)most + 0.5), most), 100.0 * promised, least,
              100.0 * alone, -log(-expm1(log(0.95) / (320.0 * 240.0))));
    { /* the same probability by the letter of the thesis, and by ours: what each draws */
        static const char *const names[3] = {"the thesis' program, blocks of 2", "independent samples, nothing culled", "default"};
        for (i = 0; i < 3; i++) {
            picture_job p = picture_open(w, 320, 240, 1);
            bench_job b;
            if (i == 0) world_structure(w, ZBUFRAND_STRUCTURE_FAIR_SPLIT, 0);
            if (i == 0) zbufrand_preset_thesis(NULL, &p.desc);
            if (i == 1) {
                p.desc.independent = p.desc.no_repair = p.desc.no_occlusion = 1;
                p.desc.density = -log(-expm1(log(0.95) / (320.0 * 240.0)));
            }
            p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
            b = picture_time(&p, names[i], i == 0 ? 1 : 5);
            (void)picture_line("zbufrand.equal_probability", "320 x 240, filled, probability 0.95", names[i], &p, &b, NULL, 1);
            if (i == 0) world_structure(w, ZBUFRAND_STRUCTURE_DEFAULT, 0);
            picture_free(&p);
        }
    }
    world_free(w);
}

/* ---- BM17: parallel surfaces, partial coverage ---- */

/* Two coloured planes `gap` apart behind one another across the view, turned by 30 degrees; or stripes of `share` before a ground. */
static world *world_planes(double gap, double share) {
    supi_make make;
    char name[48];
    world *w;
    int i, k, n = 256;
    memset(&make, 0, sizeof make);
    for (k = 0; k < 2; k++) {
        supi_make_colour(&make, k == 0 ? 255 : 0, k == 0 ? 255 : 0, k == 0 ? 255 : 0);
        for (i = 0; i < n; i++) {
            const float width = k == 0 && share < 1.0 ? (float)share : 1.0f, z = (float)(-gap * k);
            const float y0 = -2.0f + 4.0f * (float)i / (float)n, y1 = y0 + 4.0f / (float)n * width;
            const float a[3] = {-2.0f, y0, z}, b[3] = {2.0f, y0, z}, c[3] = {2.0f, y1, z}, d[3] = {-2.0f, y1, z};
            supi_make_patch(&make, a, b, c, d);
        }
    }
    snprintf(name, sizeof name, share < 1.0 ? "stripes of %.2f" : "planes %.0e apart", share < 1.0 ? share : gap);
    w = world_open(name, (uint32_t)g_opt.threads);
    (void)supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, 0);
    world_build(w);
    world_view(w, 1.0, 0.0, 1.75, 0, 0, 0, 40);
    return w;
}

/* Mean of red over the picture, unlit: white is the front, black what is behind. */
static double shown_share(picture_job *p) {
    double sum = 0.0;
    uint32_t i, k;
    const uint32_t n = p->image.width * p->image.height;
    p->desc.unlit = 1;
    p->desc.hybrid = ZBUFRAND_HYBRID_OFF;
    for (k = 0; k < 2; k++) {
        p->desc.frame = k;
        picture_run(p);
        for (i = 0; i < n; i++) sum += (double)p->image.rgba[4 * (size_t)i] / (2.0 * (double)n);
    }
    return sum;
}

static void law_line(const char *bench, const world *w, const char *method, double share, double expected, double predicted) {
    bench_line(bench, w->name, "share", share, "");
    bench_num("error", fabs(share - expected));
    bench_text("error_unit", "of the share that is visible");
    bench_num("predicted", predicted);
    bench_text("method", method);
    bench_end();
}

static void bm17(void) {
    static const double gaps[4] = {1e-1, 1e-2, 1e-3, 1e-5}, shares[4] = {0.1, 0.25, 0.5, 0.9};
    int i, k;
    for (i = 0; i < 4; i++) { /* how much of what is close behind bleeds through */
        world *w = world_planes(gaps[i], 1.0);
        for (k = 0; k < 2; k++) {
            picture_job p = picture_open(w, 160, 120, 1);
            double range;
            p.desc.density = 4.0;
            p.desc.no_repair = 1;
            p.desc.no_plane_depth = k == 0;
            range = 2.0155644 * tan(0.349066) / 60.0 * 0.5; /* what a pixel spans in depth at the middle, by the slope of the planes */
            law_line("zbufrand.bleed", w, k == 0 ? "depth of the sample" : "depth of the plane at the centre", 1.0 - shown_share(&p), 0.0,
                     k == 0 ? zbufrand_bleed(4.0, gaps[i] * 0.868, range, 1.0) : 0.0);
            picture_free(&p);
        }
        world_free(w);
    }
    for (i = 0; i < 4; i++) { /* a front that covers part of each pixel: nearest wins, larger pictures, layers */
        world *w = world_planes(0.05, shares[i]);
        for (k = 0; k < (g_opt.full ? 4 : 3); k++) {
            picture_job p = picture_open(w, 160, 120, 1);
            char name[48];
            const uint32_t over = 1u << k;
            p.desc.density = 4.0;
            p.desc.no_repair = 1;
            p.desc.oversample = over;
            snprintf(name, sizeof name, "%u x %u parts", over, over);
            law_line("zbufrand.dominance", w, name, shown_share(&p), shares[i], k == 0 ? zbufrand_front_share(shares[i], 4.0) : shares[i]);
            picture_free(&p);
        }
        world_free(w);
    }
}

#include "bench_zbufrand_parts.h"

int main(int argc, char **argv) {
    static const struct { int number; void (*run)(void); } all[] = {
        {1, bm1}, {1, bm1_huge}, {2, bm2}, {4, bm4}, {5, bm5}, {6, bm6}, {7, bm7}, {8, bm8}, {9, bm9}, {10, bm10}, {11, bm11}, {12, bm12},
        {13, bm13}, {14, bm14}, {15, bm15}, {16, bm16}, {17, bm17}, {18, bm18}, {19, bm19}, {20, bm20}
    };
    size_t i;
    int status = bench_parse(argc, argv, &g_opt);
    if (status) return status;
    bench_machine("zbufrand", argv[0]);
    for (i = 0; i < sizeof all / sizeof all[0]; i++) {
        const double start = bench_wall(), cpu = bench_cpu();
        if (!bench_wanted(&g_opt, all[i].number)) continue;
        all[i].run();
        fprintf(stderr, "BM%d: %.1f s (CPU %.1f s)\n", all[i].number, bench_wall() - start, bench_cpu() - cpu);
    }
    shared_free();
    bench_table_end(&g_table, &g_opt, g_busy_count > 0 ? g_busy_sum / g_busy_count : 0.0, argv[0]);
    return 0;
}
