/* bench_tetcast_ways.h - functions, bricks and tetrahedra against each other, and what goes around them - MIT OR Unlicense,
   see LICENSE

   BM45 functions: by tiles, by cells, decoded to bricks     BM50 shaders of the caller
   BM46 the encoder by the number of points                  BM51 clipping by bodies
   BM47 planes through cells, bricks and functions           BM52 frames in tiles, coded and put together again
   BM48 adaptive bricks and plain grids                      BM53 one volume by all structures
   BM49 opacity of slices at borders of levels, step against error
   Included by bench_tetcast.c after its other parts. */
#ifndef BENCH_TETCAST_WAYS_H
#define BENCH_TETCAST_WAYS_H
#include "baseline/lipschitz_steps.h"
#include "baseline/opacity_slices.h"
#include "../examples/support/tile_file.h"

static tetcast_optics *ways_optics(double lo, double hi, double thick, tetcast_transfer **t) {
    tetcast_control_point p[3] = {{0.1f, {0, 0.2f, 1}, 0}, {0.5f, {0.3f, 1, 0.3f}, 4.0f}, {1.5f, {1, 0.2f, 0}, 20.0f}};
    tetcast_transfer_desc d;
    tetcast_optics *o = NULL;
    int i;
    for (i = 0; i < 3; i++) {
        p[i].value = (float)(lo + (hi - lo) * 0.5 * i);
        p[i].extinction = (float)((double)p[i].extinction * thick);
    }
    memset(&d, 0, sizeof d);
    d.points = p;
    d.point_count = 3;
    must(tetcast_transfer_create(&d, t), "transfer");
    must(tetcast_optics_create(*t, NULL, &o), "optics");
    return o;
}

static double ways_rms(const float *a, const float *b, size_t pixels) {
    double sum = 0.0;
    size_t i;
    for (i = 0; i < 4 * pixels; i++) sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
    return 255.0 * sqrt(sum / (4.0 * (double)pixels));
}

/* ---- BM45 ---- */

static void bm45(void) {
    static const struct { uint32_t count; int shock; double wide; const char *name; } all[] = {
        {1173, 1, 0.03, "shock-1173"}, {435, 0, 0.06, "dense-435"}, {2000, 0, 0.1, "wide-2000"}};
    static const uint32_t samples[3] = {32, 64, 150};
    static const char *const ways[3] = {"tiles", "cells", "bricks"};
    enum { SIDE = 400 };
    tetcast_transfer *t = NULL;
    tetcast_optics *o = ways_optics(0.1, 1.5, 1.0, &t);
    size_t i, k;
    int kind;
    for (i = 0; i < 3; i++)
        for (k = 0; k < (g_opt.full ? 3u : 1u); k++) {
            tetcast_rbf *m = rbf_model(all[i].count, all[i].shock, all[i].wide, TETCAST_KERNEL_GAUSS, 1);
            float *exact = (float *)must_alloc(SIDE * SIDE, 16);
            const uint32_t n = samples[g_opt.full ? k : 1];
            char kase[64];
            snprintf(kase, sizeof kase, "%s-%u", all[i].name, n);
            for (kind = 1; kind >= 0; kind--) {
                rbf_frame f;
                double s;
                memset(&f, 0, sizeof f);
                f.m = m;
                f.o = o;
                f.d.env.thread_count = 1;
                f.d.step = (float)(1.0 / n);
                f.d.gather = (uint32_t)kind;
                f.image.width = f.image.height = SIDE;
                f.image.rgba = (float *)must_alloc(SIDE * SIDE, 16);
                s = fastest(rbf_run_frame, &f, kind ? 1 : 3);
                if (kind) memcpy(exact, f.image.rgba, SIDE * SIDE * 16);
                bench_line("tetcast.rbf_way", kase, "frame_seconds", s, "s");
                bench_num("error", ways_rms(f.image.rgba, exact, SIDE * SIDE));
                bench_text("error_unit", "1/255 rms to cells");
                bench_text("way", ways[kind]);
                bench_num("bytes", (double)m->mem.used);
                bench_num("threads", 1);
                bench_end();
                free(f.image.rgba);
            }
            {
                tetcast_bricks_desc d;
                tetcast_bricks *b = NULL;
                tetcast_bricks_report report;
                tetcast_cut *cut = NULL;
                brick_frame f;
                double made = bench_cpu(), s;
                memset(&d, 0, sizeof d);
                memset(&f, 0, sizeof f);
                d.env.thread_count = 1;
                d.longest = n + 1 > 129 ? 257 : n + 1 > 65 ? 129 : 65;
                d.max_error = 0.01f;
                must(tetcast_bricks_create_rbf(&d, m, TETCAST_RBF_CHANNEL_AUTO, 0, &report, &b), "decode");
                made = bench_cpu() - made;
                must(tetcast_cut_create(NULL, b, &cut), "cut");
                f.cut = cut;
                f.optics = o;
                f.d.env.thread_count = 1;
                f.image.width = f.image.height = SIDE;
                f.image.rgba = (float *)must_alloc(SIDE * SIDE, 16);
                s = fastest(run_brick_frame, &f, 3);
                bench_line("tetcast.rbf_way", kase, "frame_seconds", s, "s");
                bench_num("error", ways_rms(f.image.rgba, exact, SIDE * SIDE));
                bench_text("error_unit", "1/255 rms to cells");
                bench_text("way", ways[2]);
                bench_num("bytes", (double)b->mem.used);
                bench_num("value_error", report.error);
                bench_num("build_seconds", made);
                bench_num("threads", 1);
                bench_end();
                free(f.image.rgba);
                tetcast_cut_destroy(cut);
                tetcast_bricks_destroy(b);
            }
            free(exact);
            tetcast_rbf_destroy(m);
        }
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
}

/* ---- BM46 ---- */

static void bm46(void) {
    static const uint32_t sides[4] = {22, 46, 100, 215};
    int i;
    for (i = 0; i < (g_opt.full ? 3 : 2); i++) {
        const uint32_t n = sides[i];
        rbf_encode e;
        float *v = (float *)must_alloc((size_t)n * n * n, 4);
        char kase[32];
        double s;
        size_t k;
        for (k = 0; k < (size_t)n * n * n; k++) {
            const double x = (double)(k % n) / (n - 1), y = (double)(k / n % n) / (n - 1), z = (double)(k / n / n) / (n - 1);
            v[k] = (float)(tanh((x + 0.4 * y - 0.8) * 20.0) + 0.5 * tanh((sqrt(x * x + y * y + z * z) - 0.7) * 15.0));
        }
        memset(&e, 0, sizeof e);
        e.p.values.data = v;
        e.p.components = 1;
        e.p.dims[0] = e.p.dims[1] = e.p.dims[2] = n;
        e.p.count = (size_t)n * n * n;
        e.d.max_error = 0.02f;
        e.d.env.thread_count = 1;
        s = fastest(rbf_run_encode, &e, 1);
        snprintf(kase, sizeof kase, "shock-%u", n);
        bench_line("tetcast.rbf_scaling", kase, "us_per_point", 1e6 * s / (double)e.p.count, "us");
        bench_num("error", e.report.max_error);
        bench_text("error_unit", "share of the range, at most");
        bench_num("points", (double)e.p.count);
        bench_num("seconds", s);
        bench_num("functions", e.report.functions);
        bench_num("bytes", (double)e.report.bytes);
        bench_num("between_max", e.report.between_max);
        bench_num("threads", 1);
        bench_end();
        tetcast_rbf_destroy(e.m);
        free(v);
    }
}

/* ---- BM47 ---- */

static void ways_plane_line(const char *kind, double seconds, double pixels, double error, const char *unit) {
    bench_line("tetcast.plane", kind, "pixels_per_second", pixels / seconds, "1/s");
    bench_num("error", error);
    bench_text("error_unit", unit);
    bench_num("seconds", seconds);
    bench_num("thesis_seconds", 0.125);
    bench_num("threads", 1);
    bench_end();
}

static void bm47(void) {
    enum { SIDE = 1024 };
    const tetcast_mesh *mesh = get_mesh(MESH_BLUNT);
    float *out = (float *)must_alloc(SIDE * SIDE, 4), *x = (float *)must_alloc(3 * SIDE, 4);
    double start, s, covered = 0.0, worst = 0.0;
    tetcast_env env;
    size_t i;
    uint32_t j, a;
    memset(&env, 0, sizeof env);
    env.thread_count = 1;
    if (mesh != NULL) {
        tetcast_mesh_info info;
        tetcast_plane p;
        tetcast_section section;
        tetcast_mesh_get_info(mesh, &info);
        memset(&p, 0, sizeof p);
        for (a = 0; a < 3; a++) {
            const double side = info.box_max[a] - info.box_min[a];
            p.origin[a] = info.box_min[a] + (a == 2 ? 0.31 * side : 0.0);
            p.u[a] = a == 0 ? side : a == 2 ? 0.2 * side : 0.0;
            p.v[a] = a == 1 ? side : a == 2 ? 0.3 * side : 0.0;
        }
        start = bench_cpu();
        must(tetcast_plane_sample(&env, mesh, &p, SIDE, SIDE, out), "plane");
        s = bench_cpu() - start;
        for (i = 0; i < SIDE * SIDE; i++) covered += out[i] == out[i];
        start = bench_cpu();
        must(tetcast_plane_section(&env, mesh, &p, &section), "section");
        start = bench_cpu() - start;
        /* where both say what the area is */
        worst = fabs(section.area / (sqrt(p.u[0] * p.u[0] + p.u[2] * p.u[2]) * p.v[1] + 1e-30) - covered / (SIDE * SIDE));
        ways_plane_line("tetrahedra", s, covered, worst, "area of the section against points in cells");
        ways_plane_line("section", start, section.polygon_count, 0.0, "polygons a second instead of pixels");
        tetcast_section_free(&section);
    }
    {
        tetcast_bricks *b = head_bricks(257, TETCAST_TYPE_F32);
        tetcast_cut *cut = NULL;
        must(tetcast_cut_create(NULL, b, &cut), "cut");
        start = bench_cpu();
        for (j = 0; j < SIDE; j++) {
            for (i = 0; i < SIDE; i++) {
                x[i] = 256.0f * (float)i / SIDE;
                x[SIDE + i] = 256.0f * (float)j / SIDE;
                x[2 * SIDE + i] = 100.0f + 20.0f * (float)j / SIDE;
            }
            tetcast_cut_sample(cut, x, x + SIDE, x + 2 * SIDE, SIDE, TETCAST_ISA_AUTO, out + (size_t)j * SIDE);
        }
        s = bench_cpu() - start;
        worst = 0.0;
        for (i = 0; i < SIDE; i++) {
            float v;
            tetcast_cut_sample(cut, x + i, x + SIDE + i, x + 2 * SIDE + i, 1, TETCAST_ISA_SCALAR, &v);
            worst = fmax(worst, fabs((double)v - (double)out[(size_t)(SIDE - 1) * SIDE + i]));
        }
        ways_plane_line("bricks", s, SIDE * SIDE, worst, "scalar against wide");
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(b);
    }
    {
        tetcast_rbf *m = rbf_model(1173, 1, 0.03, TETCAST_KERNEL_GAUSS, 1);
        tetcast_rbf_eval_desc d;
        double *p = (double *)must_alloc(SIDE * SIDE, 24);
        float *again = (float *)must_alloc(SIDE, 4);
        memset(&d, 0, sizeof d);
        d.env.thread_count = 1;
        for (i = 0; i < SIDE * SIDE; i++) {
            p[3 * i] = (double)(i % SIDE) / SIDE;
            p[3 * i + 1] = (double)(i / SIDE) / SIDE;
            p[3 * i + 2] = 0.3 + 0.2 * p[3 * i + 1];
        }
        start = bench_cpu();
        must(tetcast_rbf_eval(&d, m, p, SIDE * SIDE, out, NULL), "eval");
        s = bench_cpu() - start;
        d.all = 1;
        must(tetcast_rbf_eval(&d, m, p + 3 * 500 * SIDE, SIDE, again, NULL), "eval");
        for (i = 0, worst = 0.0; i < SIDE; i++) worst = fmax(worst, fabs((double)again[i] - (double)out[500 * SIDE + i]));
        ways_plane_line("functions", s, SIDE * SIDE, worst, "cells against all functions");
        free(p);
        free(again);
        tetcast_rbf_destroy(m);
    }
    free(out);
    free(x);
}

/* ---- BM48 ---- */

static void bm48(void) {
    static const float asked[3] = {0.05f, 0.02f, 0.01f};
    const tetcast_mesh *mesh = get_mesh(MESH_BLUNT);
    float lo = 0.0f, hi = 1.0f;
    int i;
    if (mesh == NULL) return;
    (void)tetcast_mesh_field(mesh, 0, &lo, &hi);
    for (i = 0; i < (g_opt.full ? 3 : 2); i++) {
        tetcast_bricks_desc d;
        tetcast_bricks_report report;
        tetcast_bricks *b = NULL;
        uint64_t nodes;
        uint32_t longest = 9;
        double start = bench_cpu();
        char kase[32];
        memset(&d, 0, sizeof d);
        d.env.thread_count = 1;
        d.storage = TETCAST_TYPE_F16;
        d.max_error = asked[i] * (hi - lo);
        d.longest_end = 513;
        must(tetcast_bricks_create_mesh(&d, mesh, &report, &b), "bricks");
        snprintf(kase, sizeof kase, "blunt-%g", (double)asked[i]);
        nodes = (uint64_t)b->count * b->nodes;
        bench_line("tetcast.adaptive", kase, "bytes", (double)nodes * 2.0, "B");
        bench_num("error", report.error / (double)(hi - lo));
        bench_text("error_unit", "share of the range, at most");
        bench_num("mean_error", report.mean_error / (double)(hi - lo));
        bench_num("seconds", bench_cpu() - start);
        bench_text("method", "adaptive");
        bench_num("threads", 1);
        bench_end();
        tetcast_bricks_destroy(b);
        for (;;) { /* the plain grid of as many bytes */
            tetcast_lattice l;
            must(tetcast_lattice_fit(mesh, longest, &l), "lattice");
            if ((uint64_t)l.dims[0] * l.dims[1] * l.dims[2] >= nodes) break;
            longest += longest / 8 + 1;
        }
        d.max_error = 0.0f;
        d.longest = longest;
        d.levels = 1;
        start = bench_cpu();
        must(tetcast_bricks_create_mesh(&d, mesh, &report, &b), "grid");
        bench_line("tetcast.adaptive", kase, "bytes", (double)b->lattice.dims[0] * b->lattice.dims[1] * b->lattice.dims[2] * 2.0, "B");
        bench_num("error", report.error / (double)(hi - lo));
        bench_text("error_unit", "share of the range, at most");
        bench_num("mean_error", report.mean_error / (double)(hi - lo));
        bench_num("seconds", bench_cpu() - start);
        bench_text("method", "grid");
        bench_num("threads", 1);
        bench_end();
        tetcast_bricks_destroy(b);
    }
}

/* ---- BM49 ---- */

enum { BM49_DELTAS = 5, BM49_RULES = 5, BM49_SIDE = 129, BM49_RAYS = 64, BM49_PIXELS = BM49_RAYS * BM49_RAYS };
enum { BM49_SLOTS = 132, BM49_ROOM = 48 * BM49_SIDE }; /* slots begin before the bricks, where the eye has them begin */
static const double bm49_delta[BM49_DELTAS] = {0.4, 0.2, 0.1, 0.05, 0.025}; /* how much values change in a step */
static const double bm49_extinction = 3.0;

typedef struct slice_scene {
    tetcast_bricks *bricks;
    tetcast_transfer *transfer;
    tetcast_optics *optics;
    tetcast_cut *cut;
    brick_frame f;
    float *finest; /* the picture that errors are to */
} slice_scene;

typedef struct slice_ray {
    float x[BM49_SLOTS], y[BM49_SLOTS], z[BM49_SLOTS], v[BM49_SLOTS];
    uint8_t level[BM49_SLOTS];
    double opacity; /* in the finest picture */
} slice_ray;

typedef struct slice_total { double sum, samples, seconds, off; } slice_total; /* sum: of squares of errors */

static void ways_slices_open(slice_scene *s) {
    static tetcast_control_point points[2] = {{0.0f, {1, 1, 1}, 0}, {1.0f, {1, 1, 1}, 3.0f}};
    tetcast_transfer_desc td;
    tetcast_cut_desc cd;
    memset(s, 0, sizeof *s);
    memset(&td, 0, sizeof td);
    memset(&cd, 0, sizeof cd);
    s->bricks = head_bricks(BM49_SIDE, TETCAST_TYPE_F32);
    td.points = points;
    td.point_count = 2;
    must(tetcast_transfer_create(&td, &s->transfer), "transfer");
    must(tetcast_optics_create(s->transfer, NULL, &s->optics), "optics");
    cd.env.thread_count = 1;
    cd.focus[1] = cd.focus[2] = 0.5;
    cd.focus_radius = 0.3;
    cd.max_jump = 1;
    must(tetcast_cut_create(&cd, s->bricks, &s->cut), "cut");
    s->f.cut = s->cut;
    s->f.optics = s->optics;
    s->f.d.env.thread_count = 1;
    s->f.d.camera.ortho_height = 1.0f;
    s->f.d.camera.eye[0] = -1.0;
    s->f.d.camera.eye[1] = s->f.d.camera.eye[2] = s->f.d.camera.at[1] = s->f.d.camera.at[2] = 0.5;
    s->f.d.camera.at[0] = 0.5;
    s->f.d.camera.up[1] = 1.0;
    s->f.image.width = s->f.image.height = BM49_RAYS;
    s->f.image.rgba = (float *)must_alloc(BM49_PIXELS, 16);
    s->f.d.step = 1.0f / 64.0f;
    run_brick_frame(&s->f);
    s->finest = s->f.image.rgba;
    s->f.image.rgba = (float *)must_alloc(BM49_PIXELS, 16);
}

static void ways_slices_close(slice_scene *s) {
    free(s->finest);
    free(s->f.image.rgba);
    tetcast_cut_destroy(s->cut);
    tetcast_bricks_destroy(s->bricks);
    tetcast_optics_destroy(s->optics);
    tetcast_transfer_destroy(s->transfer);
}

/* The picture in steps of this length: seconds, samples and squares of errors. */
static slice_total ways_slices_frame(slice_scene *s, float step, int fixed) {
    slice_total total = {0, 0, 0, 0};
    uint32_t i;
    s->f.d.step = step;
    s->f.d.fixed_step = (uint32_t)fixed;
    total.seconds = fastest(run_brick_frame, &s->f, 3);
    total.samples = (double)s->f.stats.steps / BM49_PIXELS;
    for (i = 0; i < BM49_PIXELS; i++) total.sum += pow((double)s->finest[4 * i + 3] - (double)s->f.image.rgba[4 * i + 3], 2.0);
    return total;
}

/* The ray of pixel (i, j): looking along x with y up, z to the right or left; and the values in its slots. */
static void ways_slices_ray(const slice_scene *s, uint32_t i, uint32_t j, slice_ray *r) {
    tetcast_ray ray;
    uint32_t k;
    must(tetcast_camera_ray(&s->f.d.camera, BM49_RAYS, BM49_RAYS, i + 0.5, j + 0.5, &ray), "ray");
    for (k = 0; k < BM49_SLOTS; k++) {
        uint32_t at[3];
        r->x[k] = (float)k - 3.0f;
        r->y[k] = (float)(ray.org[1] * (BM49_SIDE - 1));
        r->z[k] = (float)(ray.org[2] * (BM49_SIDE - 1));
        at[0] = k < 3 ? 0 : (k - 3) >> 4 < 8 ? (k - 3) >> 4 : 7;
        at[1] = (uint32_t)r->y[k] >> 4 < 8 ? (uint32_t)r->y[k] >> 4 : 7;
        at[2] = (uint32_t)r->z[k] >> 4 < 8 ? (uint32_t)r->z[k] >> 4 : 7;
        r->level[k] = tetcast_cut_levels(s->cut)[at[0] + 8 * (at[1] + 8 * at[2])];
    }
    tetcast_cut_sample(s->cut, r->x, r->y, r->z, BM49_SLOTS, TETCAST_ISA_AUTO, r->v);
    for (k = 0; k < BM49_SLOTS; k++) r->v[k] = k < 3 || k > 3 + 128 ? 0.0f : r->v[k];
    r->opacity = (double)s->finest[4 * (i + BM49_RAYS * j) + 3];
}

/* Steps by slope; nodes of the bricks are x = 0 .. SIDE - 1. Samples in the middles of steps, or (linear) at their ends,
   with what is linear between them integrated. bounds: room for five times BM49_ROOM. */
static void ways_slices_by_slope(const tetcast_cut *cut, const slice_ray *r, double delta, int linear, float *bounds, slice_total *total) {
    float *border = bounds, *at = bounds + BM49_ROOM, *ys = bounds + 2 * BM49_ROOM, *zs = bounds + 3 * BM49_ROOM;
    float *value = bounds + 4 * BM49_ROOM;
    double thick = 0.0;
    const double start = bench_cpu();
    const size_t n = lipschitz_steps(r->v + 3, BM49_SIDE, 16, delta, 16.0, border, BM49_ROOM);
    size_t q;
    for (q = 0; q + 1 < n + (size_t)linear; q++) at[q] = linear ? border[q] : 0.5f * (border[q] + border[q + 1]);
    for (q = 0; q < n; q++) { /* y and z are the ray's */
        ys[q] = r->y[0];
        zs[q] = r->z[0];
    }
    tetcast_cut_sample(cut, at, ys, zs, n - 1 + (size_t)linear, TETCAST_ISA_AUTO, value);
    for (q = 0; q + 1 < n; q++) {
        const double mean = linear ? 0.5 * ((double)value[q] + (double)value[q + 1]) : (double)value[q];
        thick += ((double)border[q + 1] - (double)border[q]) / (BM49_SIDE - 1) * bm49_extinction * mean;
    }
    total->seconds += bench_cpu() - start;
    total->samples += (double)(n - 1 + (size_t)linear) / BM49_PIXELS;
    total->sum += pow(r->opacity - (1.0 - exp(-thick)), 2.0);
}

static void ways_slices_by_rule(opacity_rule how, const slice_ray *r, slice_total *total) {
    uint32_t ways[BM49_SLOTS], k;
    double thick = 0.0, slots = 0.0;
    const double start = bench_cpu();
    opacity_slots(how, r->level, BM49_SLOTS, ways);
    for (k = 0; k < BM49_SLOTS; k++) {
        ways[k] = ways[k] < BM49_SLOTS - k ? ways[k] : BM49_SLOTS - k; /* none goes on behind the last */
        thick += (double)ways[k] / (BM49_SIDE - 1) * bm49_extinction * (double)r->v[k];
        total->samples += (ways[k] != 0) / (double)BM49_PIXELS;
        slots += (double)ways[k];
    }
    total->off += fabs(slots - BM49_SLOTS) / (double)BM49_PIXELS;
    total->seconds += bench_cpu() - start;
    total->sum += pow(r->opacity - (1.0 - exp(-thick)), 2.0);
}

static void ways_slices_rule_line(const char *name, const slice_total *total) {
    bench_line("tetcast.slices", name, "samples_per_ray", total->samples, "");
    bench_num("error", 255.0 * sqrt(total->sum / BM49_PIXELS));
    bench_text("error_unit", "1/255 rms of opacity, to 64 times as many samples");
    bench_num("way_off", total->off / BM49_SLOTS); /* share of a ray that counts twice or not at all */
    bench_num("seconds", total->seconds);
    bench_num("threads", 1);
    bench_end();
}

static void ways_slices_step_line(const char *kase, double step, const slice_total *total) {
    bench_line("tetcast.steps", kase, "samples_per_ray", total->samples, "");
    bench_num("error", 255.0 * sqrt(total->sum / BM49_PIXELS));
    bench_text("error_unit", "1/255 rms of opacity");
    bench_num("step", step);
    bench_num("seconds", total->seconds);
    bench_num("threads", 1);
    bench_end();
}

/* Opacity along rays in x through bricks that get coarser away from one face: by slices as the thesis counts them. */
static void bm49(void) {
    static const char *const names[BM49_RULES] = {"naive", "repaired", "misprint", "exact", "ours"};
    static const float steps[5] = {0.25f, 0.5f, 1.0f, 2.0f, 4.0f};
    slice_scene s;
    slice_total rules[BM49_RULES], slopes[2][BM49_DELTAS];
    float *bounds = (float *)must_alloc(5 * BM49_ROOM, sizeof *bounds);
    uint32_t i, j;
    int how, kind;
    memset(rules, 0, sizeof rules);
    memset(slopes, 0, sizeof slopes);
    ways_slices_open(&s);
    rules[4] = ways_slices_frame(&s, 1.0f, 0);
    for (j = 0; j < BM49_RAYS; j++)
        for (i = 0; i < BM49_RAYS; i++) {
            slice_ray r;
            ways_slices_ray(&s, i, j, &r);
            for (how = 0; how < BM49_DELTAS; how++)
                for (kind = 0; kind < 2; kind++) ways_slices_by_slope(s.cut, &r, bm49_delta[how], kind, bounds, &slopes[kind][how]);
            for (how = 0; how < 4; how++) ways_slices_by_rule((opacity_rule)how, &r, &rules[how]);
        }
    free(bounds);
    for (how = 0; how < BM49_RULES; how++) ways_slices_rule_line(names[how], &rules[how]);
    for (kind = 0; kind < 2; kind++) /* step: of the value */
        for (how = 0; how < BM49_DELTAS; how++)
            ways_slices_step_line(kind != 0 ? "by slope, linear" : "by slope", bm49_delta[how], &slopes[kind][how]);
    for (how = 0; how < 5; how++) /* step against error */
        for (kind = 0; kind < 2; kind++) {
            const slice_total total = ways_slices_frame(&s, steps[how], kind);
            ways_slices_step_line(kind != 0 ? "fixed" : "by level", (double)steps[how], &total);
        }
    ways_slices_close(&s);
}

/* ---- BM50 ---- */

static void ways_shade(void *user, const tetcast_packet *in, float rgba[4][8]) { /* what optics of one slope do, by samples */
    const float k = *(const float *)user;
    int i;
    for (i = 0; i < 8; i++) {
        const float s = 0.5f * (in->front[i] + in->back[i]), a = k * s * in->length[i];
        rgba[3][i] = a < 1.0f ? a : 1.0f;
        rgba[0][i] = rgba[1][i] = rgba[2][i] = s * rgba[3][i];
    }
}
static int ways_empty(void *user, float lo, float hi) {
    (void)user;
    (void)lo;
    return !(hi > 0.0f);
}

static void bm50(void) {
    static const char *const names[3] = {"optics", "shader", "shader with gradients"};
    static const tetcast_control_point points[2] = {{0.0f, {0, 0, 0}, 0}, {1.0f, {1, 1, 1}, 3.0f}};
    tetcast_bricks *b = head_bricks(257, TETCAST_TYPE_F32);
    tetcast_cut *cut = NULL;
    tetcast_transfer_desc td;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    float thick = 3.0f, *first = NULL;
    int kind;
    memset(&td, 0, sizeof td);
    td.points = points;
    td.point_count = 2;
    must(tetcast_transfer_create(&td, &t), "transfer");
    must(tetcast_optics_create(t, NULL, &o), "optics");
    must(tetcast_cut_create(NULL, b, &cut), "cut");
    for (kind = 0; kind < 3; kind++) {
        tetcast_shader s;
        brick_frame f;
        double seconds;
        memset(&s, 0, sizeof s);
        memset(&f, 0, sizeof f);
        s.user = &thick;
        s.needs = kind == 2 ? TETCAST_NEED_GRADIENT : 0;
        s.shade_fn = ways_shade;
        s.empty_fn = ways_empty;
        f.cut = cut;
        f.optics = o;
        f.d.env.thread_count = 1;
        f.d.shader = kind != 0 ? &s : NULL;
        f.image.width = f.image.height = SIZE;
        f.image.rgba = (float *)must_alloc((size_t)SIZE * SIZE, 16);
        seconds = fastest(run_brick_frame, &f, 3);
        if (kind == 0) first = f.image.rgba;
        bench_line("tetcast.shader", names[kind], "ns_per_segment", 1e9 * seconds / (double)f.stats.steps, "ns");
        bench_num("error", ways_rms(f.image.rgba, first, (size_t)SIZE * SIZE));
        bench_text("error_unit", "1/255 rms: thin segments against exact ones");
        bench_num("frame_seconds", seconds);
        bench_num("segments", (double)f.stats.steps);
        bench_num("threads", 1);
        bench_end();
        if (kind != 0) free(f.image.rgba);
    }
    free(first);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
}

/* ---- BM51 ---- */

/* A ball of n x 2n quadrilaterals. */
static void ways_ball(uint32_t n, tetcast_clip_body *body) {
    const uint32_t rings = n, sides = 2 * n;
    double (*p)[3] = (double (*)[3])must_alloc((size_t)(rings + 1) * sides, 24);
    uint32_t *t = (uint32_t *)must_alloc((size_t)rings * sides * 6, 4), i, j, k = 0;
    for (j = 0; j <= rings; j++)
        for (i = 0; i < sides; i++) {
            const double a = 3.14159265358979 * j / rings, u = 6.28318530717959 * i / sides, r = j == 0 || j == rings ? 0.0 : sin(a);
            p[i + (size_t)sides * j][0] = 0.5 + 0.4 * r * cos(u);
            p[i + (size_t)sides * j][1] = 0.5 + 0.4 * cos(a);
            p[i + (size_t)sides * j][2] = 0.5 + 0.4 * r * sin(u);
        }
    for (j = 0; j < rings; j++)
        for (i = 0; i < sides; i++) {
            const uint32_t q = i + sides * j, r = (i + 1) % sides + sides * j;
            t[k++] = q;
            t[k++] = r;
            t[k++] = q + sides;
            t[k++] = r;
            t[k++] = r + sides;
            t[k++] = q + sides;
        }
    memset(body, 0, sizeof *body);
    body->points = (const double (*)[3])p;
    body->point_count = (size_t)(rings + 1) * sides;
    body->indices = t;
    body->triangle_count = k / 3;
}

static void bm51(void) {
    static const uint32_t rings[4] = {0, 16, 50, 160};
    tetcast_bricks *b = head_bricks(129, TETCAST_TYPE_F32);
    tetcast_cut *cut = NULL;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = ways_optics(-1.0, 1.0, 0.02, &t);
    double plain = 0.0;
    int i;
    must(tetcast_cut_create(NULL, b, &cut), "cut");
    for (i = 0; i < (g_opt.full ? 4 : 3); i++) {
        tetcast_clip_desc cd;
        tetcast_clip_body body;
        tetcast_clip *clip = NULL;
        brick_frame f;
        double s, made = 0.0, volume = 0.0;
        uint32_t k;
        char kase[32];
        memset(&cd, 0, sizeof cd);
        memset(&body, 0, sizeof body);
        memset(&f, 0, sizeof f);
        if (rings[i] != 0) {
            ways_ball(rings[i], &body);
            cd.bodies = &body;
            cd.body_count = 1;
            made = bench_cpu();
            must(tetcast_clip_create(&cd, &clip), "clip");
            made = bench_cpu() - made;
        }
        f.cut = cut;
        f.optics = o;
        f.d.env.thread_count = 1;
        f.d.clip = clip;
        f.d.camera.ortho_height = 1.0f;
        f.d.camera.eye[0] = -1.0;
        f.d.camera.eye[1] = f.d.camera.eye[2] = f.d.camera.at[0] = f.d.camera.at[1] = f.d.camera.at[2] = 0.5;
        f.d.camera.up[1] = 1.0;
        f.image.width = f.image.height = SIZE;
        f.image.rgba = (float *)must_alloc((size_t)SIZE * SIZE, 16);
        f.image.length = (float *)must_alloc((size_t)SIZE * SIZE, 4);
        s = fastest(run_brick_frame, &f, 3);
        for (k = 0; k < SIZE * SIZE; k++) volume += (double)f.image.length[k] / ((double)SIZE * SIZE);
        if (i == 0) plain = s;
        snprintf(kase, sizeof kase, "ball-%lu", (unsigned long)body.triangle_count);
        bench_line("tetcast.clip", kase, "frame_seconds", s, "s");
        bench_num("error", rings[i] != 0 ? fabs(volume / (4.0 / 3.0 * 3.14159265358979 * 0.064) - 1.0) : fabs(volume - 1.0));
        bench_text("error_unit", "of the volume that rays see, to a ball");
        bench_num("times_as_slow", s / plain);
        bench_num("build_seconds", made);
        bench_num("segments", (double)f.stats.steps);
        bench_num("threads", 1);
        bench_end();
        free(f.image.rgba);
        free(f.image.length);
        tetcast_clip_destroy(clip);
        free((void *)(uintptr_t)body.points);
        free((void *)(uintptr_t)body.indices);
    }
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
}

/* ---- BM52 ---- */

/* What machines that share a frame do, on one: draw a tile, code it, decode it where the frame is put together. */
static void bm52(void) {
    static const uint32_t grids[4][2] = {{1, 1}, {2, 2}, {4, 4}, {8, 6}};
    static const char *const codecs[3] = {"cells", "alpha", "lossless"};
    tetcast_bricks *b = head_bricks(257, TETCAST_TYPE_F32);
    tetcast_cut *cut = NULL;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = ways_optics(0.02, 1.0, 1.0, &t);
    uint8_t *whole = (uint8_t *)must_alloc((size_t)SIZE * SIZE, 4), *parts = (uint8_t *)must_alloc((size_t)SIZE * SIZE, 4);
    int g, codec;
    must(tetcast_cut_create(NULL, b, &cut), "cut");
    for (g = 0; g < 4; g++)
        for (codec = g == 0 ? SUP_TILE_LOSSLESS : 0; codec < 3; codec++) {
            const uint32_t nx = grids[g][0], ny = grids[g][1];
            double slowest = 0.0, coding = 0.0, bytes = 0.0, sum = 0.0, all = 0.0;
            uint32_t x, y, row;
            size_t i;
            char kase[48];
            for (y = 0; y < ny; y++)
                for (x = 0; x < nx; x++) {
                    brick_frame f;
                    uint8_t *data, *back;
                    uint32_t w = 0, h = 0;
                    size_t size;
                    sup_error err;
                    double start = bench_cpu();
                    memset(&f, 0, sizeof f);
                    f.cut = cut;
                    f.optics = o;
                    f.d.env.thread_count = 1;
                    f.d.frame[0] = f.d.frame[1] = SIZE;
                    f.d.background[3] = 1.0f;
                    f.d.part[0] = x * SIZE / nx;
                    f.d.part[1] = y * SIZE / ny;
                    f.image.width = (x + 1) * SIZE / nx - f.d.part[0];
                    f.image.height = (y + 1) * SIZE / ny - f.d.part[1];
                    f.image.rgba8 = (uint8_t *)must_alloc((size_t)f.image.width * f.image.height, 4);
                    run_brick_frame(&f);
                    start = bench_cpu() - start;
                    slowest = start > slowest ? start : slowest;
                    all += start;
                    start = bench_cpu();
                    if (sup_tile_encode(codec, f.image.rgba8, f.image.width, f.image.height, &data, &size)) return;
                    if (sup_tile_decode(data, size, &back, &w, &h, &err)) return;
                    for (row = 0; row < h; row++)
                        memcpy(parts + 4 * ((size_t)(f.d.part[1] + row) * SIZE + f.d.part[0]), back + 4 * (size_t)row * w, 4 * (size_t)w);
                    coding += bench_cpu() - start;
                    bytes += (double)size;
                    free(f.image.rgba8);
                    SUP_FREE(data);
                    SUP_FREE(back);
                }
            if (g == 0) memcpy(whole, parts, (size_t)SIZE * SIZE * 4);
            for (i = 0; i < (size_t)SIZE * SIZE * 4; i++) sum += pow((double)whole[i] - (double)parts[i], 2.0);
            snprintf(kase, sizeof kase, "%ux%u-%s", nx, ny, codecs[codec]);
            bench_line("tetcast.tiles", kase, "latency_seconds", slowest + coding, "s");
            bench_num("error", sqrt(sum / (4.0 * SIZE * SIZE)));
            bench_text("error_unit", "1/255 rms to the frame drawn at once");
            bench_num("slowest_tile", slowest);
            bench_num("all_tiles", all);
            bench_num("coding_seconds", coding);
            bench_num("bytes", bytes);
            bench_num("threads", 1);
            bench_end();
        }
    free(whole);
    free(parts);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
}

/* ---- BM53: one volume, one picture, by all structures ---- */

typedef struct three {
    const tetcast_mesh *mesh;
    const tets *source;
    tetcast_transfer *transfer;
    tetcast_optics *optics;
    tetcast_camera camera;
    tetcast_image image;      /* of the way that is being looked at */
    float *exact;             /* the picture of the exact integrator */
    float lo, hi;
} three;

static void three_line(const three *w, const char *method, double setting, double frame_s, double made, double bytes) {
    const double rms = ways_rms(w->image.rgba, w->exact, (size_t)SIZE * SIZE) / 255.0;
    bench_line("tetcast.three", g_mesh_name[MESH_D31K], "frame_seconds", frame_s, "s");
    bench_num("error", 255.0 * rms);
    bench_text("error_unit", "1/255 rms to tetrahedra");
    bench_text("method", method);
    bench_num("setting", setting);
    bench_num("psnr", rms > 0.0 ? -20.0 * log10(rms) : 200.0);
    bench_num("build_seconds", made);
    bench_num("bytes", bytes);
    bench_num("threads", 1);
    bench_end();
}

static void three_tetrahedra(three *w) {
    tetcast_mesh_info info;
    int i;
    tetcast_mesh_get_info(w->mesh, &info);
    for (i = 0; i < 2; i++) {
        frame f;
        double s;
        memset(&f, 0, sizeof f);
        f.d.camera = w->camera;
        f.d.env.thread_count = 1;
        f.d.method = i == 0 ? TETCAST_METHOD_WALK : TETCAST_METHOD_PROJECT;
        f.mesh = w->mesh;
        f.optics = w->optics;
        f.image = w->image;
        s = fastest(run_frame, &f, 2);
        if (i == 0) memcpy(w->exact, w->image.rgba, (size_t)SIZE * SIZE * 16);
        three_line(w, i == 0 ? "tetrahedra" : "tetrahedra, projected", 0.0, s, 0.0, (double)info.total_bytes);
    }
}

static void three_bricks(three *w) {
    static const struct { float error, step; } ways[] = {
        {0.3f, 1}, {0.15f, 1}, {0.08f, 1}, {0.02f, 1}, {0.02f, 8}, {0.02f, 4}, {0.02f, 2}, {0.02f, 0.5f}
    };
    int i;
    for (i = 0; i < 8; i++) { /* by what the bricks leave out, and by steps */
        tetcast_bricks_desc d;
        tetcast_bricks *b = NULL;
        tetcast_cut *cut = NULL;
        brick_frame f;
        double s, made = bench_cpu();
        memset(&d, 0, sizeof d);
        memset(&f, 0, sizeof f);
        d.env.thread_count = 1;
        d.storage = TETCAST_TYPE_F16;
        d.max_error = ways[i].error * (w->hi - w->lo);
        d.longest_end = 257;
        must(tetcast_bricks_create_mesh(&d, w->mesh, NULL, &b), "bricks");
        must(tetcast_cut_create(NULL, b, &cut), "cut");
        made = bench_cpu() - made;
        f.cut = cut;
        f.optics = w->optics;
        f.d.camera = w->camera;
        f.d.env.thread_count = 1;
        f.d.no_hull = 1;
        f.d.step = ways[i].step;
        f.image = w->image;
        s = fastest(run_brick_frame, &f, 2);
        three_line(w, i < 4 ? "bricks, error of values" : "bricks, steps", (double)(i < 4 ? ways[i].error : ways[i].step), s, made,
                   (double)tetcast_bricks_file_size(b));
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(b);
    }
}

static void three_functions(three *w) {
    static const float error[] = {0.2f, 0.1f, 0.05f, 0.02f};
    int i;
    for (i = 0; i < 4; i++) {
        rbf_encode e;
        rbf_frame f;
        double s, made;
        memset(&e, 0, sizeof e);
        memset(&f, 0, sizeof f);
        e.p.values.data = w->source->s;
        e.p.positions.data = w->source->p;
        e.p.positions.type = TETCAST_TYPE_F64;
        e.p.tets = w->source->t;
        e.p.tet_count = w->source->nt;
        e.p.count = w->source->nv;
        e.p.components = 1;
        e.d.max_error = error[i];
        e.d.env.thread_count = 1;
        made = fastest(rbf_run_encode, &e, 1);
        f.m = e.m;
        f.o = w->optics;
        f.d.camera = w->camera;
        f.d.env.thread_count = 1;
        f.image = w->image;
        s = fastest(rbf_run_frame, &f, 2);
        three_line(w, "functions", (double)error[i], s, made, (double)e.report.bytes);
        tetcast_rbf_destroy(e.m);
    }
}

/* Cells of constant colour around the vertices. */
static void three_foam(three *w) {
    tetcast_foam_info info;
    foam_job j;
    double s, made;
    size_t i;
    memset(&j, 0, sizeof j);
    j.sites = (tetcast_site *)must_alloc(w->source->nv, sizeof *j.sites);
    j.count = w->source->nv;
    for (i = 0; i < j.count; i++) {
        float rgba[4];
        tetcast_transfer_eval(w->transfer, w->source->s[i], rgba);
        memcpy(j.sites[i].position, w->source->p + 3 * i, sizeof j.sites[i].position);
        memcpy(j.sites[i].rgb, rgba, sizeof j.sites[i].rgb);
        j.sites[i].extinction = rgba[3];
    }
    made = fastest(run_foam, &j, 1);
    tetcast_foam_get_info(j.foam, &info);
    j.d.env.thread_count = 1;
    j.d.camera = w->camera;
    j.image = w->image;
    s = fastest(run_foam_frame, &j, 2);
    three_line(w, "foam", (double)j.count, s, made, (double)info.bytes);
    tetcast_foam_destroy(j.foam);
    free(j.sites);
}

static void bm53(void) {
    three w;
    memset(&w, 0, sizeof w);
    w.mesh = get_mesh(MESH_D31K);
    w.source = get_tets(MESH_D31K);
    if (w.mesh == NULL || w.source == NULL) return;
    w.hi = 1.0f;
    (void)tetcast_mesh_field(w.mesh, 0, &w.lo, &w.hi);
    w.optics = ways_optics((double)w.lo, (double)w.hi, 0.3, &w.transfer);
    place_camera(&w.camera, w.mesh);
    w.exact = (float *)must_alloc((size_t)SIZE * SIZE, 16);
    w.image.width = w.image.height = SIZE;
    w.image.rgba = (float *)must_alloc((size_t)SIZE * SIZE, 16);
    three_tetrahedra(&w);
    three_bricks(&w);
    three_functions(&w);
    three_foam(&w);
    free(w.image.rgba);
    free(w.exact);
    tetcast_optics_destroy(w.optics);
    tetcast_transfer_destroy(w.transfer);
}

#endif
