/* bench_tetcast.c - how fast, how small and how wrong tetcast.h is - MIT OR Unlicense, see LICENSE

   bench_tetcast [--full] [--only BM1,BM2] [--threads N] [--data DIR] [--table FILE]

   BM1 frames and traversal        BM7  walking or projecting       BM13 against other ways, one picture
   BM2 integrators                 BM8  early termination           BM14 the thesis' scenes
   BM3 forms of cells              BM9  isosurfaces                 BM15 memory, import
   BM4 strips                      BM10 changes of the function     BM16 what exactness costs
   BM5 projection in any order     BM11 meshes that are not convex
   BM6 orders and forms of it      BM12 threads, instruction sets   BM17 tolerance against error
   BM21 to BM27: radial basis functions, see bench_tetcast_rbf.h
   BM40 to BM44: resampling, bricks, codecs, see bench_tetcast_bricks.h; BM45 to BM53: against each other,
   bench_tetcast_ways.h; BM54: foams
   One JSON object a line on stdout; the acceptance table on stderr and, after a run of all, in bench/table_tetcast.md
   beside the program. Errors of pictures are against an integrator in double that splits at every knot. */
#include "bench.h"
#include "../tests/test.h"
#include "../examples/support/volume.h"
#include "../examples/support/volume_scenes.h"
#define TETCAST_IMPLEMENTATION
#include "../tetcast.h"
#include "../tests/ray_oracle.h"
#include "../tests/foam_oracle.h"
#include "baseline/strip_planes.h"
#include "baseline/cell_projection.h"
#include "baseline/slices.h"
#include "baseline/rbf_steps.h"
#include "bench_tets.h"
#include "../examples/support/amr_scenes.h"
#include <sys/resource.h>

enum { SIZE = 512, ROUNDS = 5, EVERY = 4 }; /* the peers' picture; the reference looks at every fourth row and column */
#include "bench_tetcast_bricks.h"

/* ---- frames ---- */

typedef struct frame {
    tetcast_render_desc d;
    const tetcast_mesh *mesh;
    const tetcast_optics *optics;
    tetcast_image image;
    tetcast_render_stats stats;
    tetcast_optics *own;         /* optics to destroy */
} frame;

static void run_frame(void *ctx) {
    frame *f = (frame *)ctx;
    memset(&f->stats, 0, sizeof f->stats);
    must(tetcast_render(&f->d, f->mesh, f->optics, &f->image, &f->stats), "render");
}

/* The peers' camera for the unit cube; others are framed. */
static void place_camera(tetcast_camera *c, const tetcast_mesh *mesh) {
    tetcast_mesh_info info;
    int k, unit = 1;
    tetcast_mesh_get_info(mesh, &info);
    memset(c, 0, sizeof *c);
    for (k = 0; k < 3; k++) unit = unit && fabs(info.box_min[k]) < 0.01 && fabs(info.box_max[k] - 1) < 0.01;
    if (!unit) {
        must(tetcast_camera_fit(c, info.box_min, info.box_max, NULL, SIZE, SIZE), "camera");
        return;
    }
    c->eye[0] = 1.6;
    c->eye[1] = 1.3;
    c->eye[2] = 2.0;
    for (k = 0; k < 3; k++) c->at[k] = 0.5;
    c->fov_y = 40.0f;
}

/* View k of n on the way around both axes at once. */
static void turn_camera(tetcast_camera *c, const tetcast_mesh *mesh, int k, int n) {
    tetcast_camera start;
    double v[3], a = 6.283185307179586 * k / n, y, z;
    int i;
    place_camera(&start, mesh);
    for (i = 0; i < 3; i++) v[i] = start.eye[i] - start.at[i];
    y = v[1] * cos(a) - v[2] * sin(a);
    z = v[1] * sin(a) + v[2] * cos(a);
    v[1] = y;
    v[2] = z;
    z = v[2] * cos(a) - v[0] * sin(a);
    v[0] = v[2] * sin(a) + v[0] * cos(a);
    v[2] = z;
    *c = start;
    for (i = 0; i < 3; i++) c->eye[i] = c->at[i] + v[i];
    c->up[0] = sin(a) * sin(a);
    c->up[1] = cos(a);
    c->up[2] = sin(a) * cos(a);
}

static frame *new_frame(const tetcast_mesh *mesh, const tetcast_optics *optics, uint32_t size) {
    frame *f = (frame *)must_alloc(1, sizeof *f);
    f->d.env.thread_count = 1;
    f->mesh = mesh;
    f->optics = optics;
    place_camera(&f->d.camera, mesh);
    f->image.width = f->image.height = size;
    f->image.rgba = (float *)must_alloc((size_t)size * size, 16);
    return f;
}
static void free_frame(frame *f) {
    tetcast_optics_destroy(f->own);
    free(f->image.rgba);
    free(f->image.rgba8);
    free(f->image.length);
    free(f->image.depth);
    free(f);
}

static bench_job frame_job(const char *name, frame *f) {
    bench_job b;
    memset(&b, 0, sizeof b);
    b.name = name;
    b.isa = "auto";
    b.run = run_frame;
    b.ctx = f;
    return b;
}

/* What every line of one thread ends with. */
static void finish_line(const bench_job *b, const char *method) {
    bench_text("method", method);
    bench_num("threads", 1);
    bench_num("wall_per_cpu", bench_busy(b));
    g_busy_sum += bench_busy(b);
    g_busy_count += 1.0;
    bench_end();
}

/* ---- the reference ---- */

typedef struct reference {
    uint32_t size, every, count;
    double (*rgba)[4];
} reference;

static reference make_reference(const frame *f, const tets *t, int tf, uint32_t every) {
    reference r;
    oracle_cells list;
    uint32_t x, y, n = 0;
    size_t points;
    const tetcast_control_point *p = tf_points(tf, &points);
    memset(&list, 0, sizeof list);
    r.size = f->image.width;
    r.every = every;
    r.rgba = (double (*)[4])must_alloc((size_t)r.size * r.size, sizeof *r.rgba);
    for (y = every / 2; y < r.size; y += every)
        for (x = every / 2; x < r.size; x += every, n++) {
            tetcast_ray ray;
            must(tetcast_camera_ray(&f->d.camera, r.size, r.size, x + 0.5, y + 0.5, &ray), "camera");
            oracle_ray(f->mesh, t, p, points, 0, &ray, &list, r.rgba[n]);
        }
    r.count = n;
    free(list.visit);
    return r;
}

typedef struct difference {
    double most, rms, psnr;
    uint32_t seams;       /* pixels off by more than 1/255 */
} difference;

static difference compare(const frame *f, const reference *r) {
    difference d;
    uint32_t x, y, n = 0;
    int c;
    memset(&d, 0, sizeof d);
    for (y = r->every / 2; y < r->size; y += r->every)
        for (x = r->every / 2; x < r->size; x += r->every, n++) {
            const float *p = f->image.rgba + 4 * ((size_t)y * r->size + x);
            double worst = 0;
            for (c = 0; c < 4; c++) {
                const double e = fabs((double)p[c] - r->rgba[n][c]);
                worst = fmax(worst, e == e ? e : 1e9);
                if (c < 3) d.rms += e * e;
            }
            d.most = fmax(d.most, worst);
            d.seams += worst > 1.0 / 255.0;
        }
    d.rms = sqrt(d.rms / (3.0 * r->count));
    d.psnr = d.rms > 0 ? -20.0 * log10(d.rms) : 999.0;
    return d;
}

static void difference_line(const difference *d) {
    bench_num("error", d->most);
    bench_text("error_unit", "colour");
    bench_num("rms", d->rms);
    bench_num("psnr", d->psnr);
    bench_num("seams", d->seams);
}

static uint64_t hash_frame(const frame *f) {
    return bench_hash_bytes(f->image.rgba, (size_t)f->image.width * f->image.height * 16);
}

/* How far the length of a ray's way is from what it can be in the unit cube when positions are floats: along a side of
   the cube little decides between all and nothing. */
static double length_error(double length, const double o[3], const double d[3]) {
    static const double out[2][3] = {{-3e-7, -3e-7, -3e-7}, {1 + 3e-7, 1 + 3e-7, 1 + 3e-7}};
    static const double in[2][3] = {{3e-7, 3e-7, 3e-7}, {1 - 3e-7, 1 - 3e-7, 1 - 3e-7}};
    const double most = ref_box(o, d, out[0], out[1], 0, 1e30), least = ref_box(o, d, in[0], in[1], 0, 1e30);
    return length >= least && length <= most ? 0 : fmin(fabs(length - least), fabs(length - most));
}

/* Rays of a picture of the unit cube whose way is not the exact one. */
static size_t wrong_lengths(const frame *f, double *most) {
    const uint32_t n = f->image.width;
    size_t wrong = 0;
    uint32_t x, y;
    *most = 0;
    for (y = 0; y < n; y++)
        for (x = 0; x < n; x++) {
            tetcast_ray ray;
            double e;
            must(tetcast_camera_ray(&f->d.camera, n, n, x + 0.5, y + 0.5, &ray), "camera");
            e = length_error((double)f->image.length[(size_t)y * n + x], ray.org, ray.dir);
            *most = fmax(*most, e);
            wrong += !(e < 1e-5);
        }
    return wrong;
}

/* ---- BM1: frames and traversal ---- */

static double g_psnr = 999.0, g_seams;

static void frames_of(const int *ids, int count) {
    static const char *const peer[MESH_COUNT] = {"VTK ray cast", "VTK ray cast", "VTK ray cast", "VTK ray cast"};
    static const double peer_value[MESH_COUNT] = {1.0, 2.1, 1.61, 5.2};
    frame *f[2 * MESH_COUNT];
    bench_job b[2 * MESH_COUNT];
    tetcast_optics *o = make_optics(TF_SMOOTH, NULL), *full = make_optics(TF_FULL, NULL);
    int i, n = 0, id[2 * MESH_COUNT];
    char text[2][32] = {"", ""};
    for (i = 0; i < count; i++) {
        const tetcast_mesh *mesh = get_mesh(ids[i]);
        if (mesh == NULL) {
            bench_skip("tetcast.frame", g_mesh_name[ids[i]], "no data");
            continue;
        }
        id[n] = id[n + 1] = ids[i];
        f[n] = new_frame(mesh, o, SIZE);
        f[n + 1] = new_frame(mesh, full, SIZE);
        b[n] = frame_job("smooth", f[n]);
        b[n + 1] = frame_job("smooth, nothing empty", f[n + 1]);
        n += 2;
    }
    bench_interleave(b, n, ROUNDS);
    for (i = 0; i < n; i++) {
        const int tf = i & 1 ? TF_FULL : TF_SMOOTH;
        reference r = make_reference(f[i], get_tets(id[i]), tf, EVERY);
        difference e = compare(f[i], &r);
        char key[64];
        bench_line("tetcast.frame", g_mesh_name[id[i]], "frame_seconds", bench_seconds(&b[i]), "s");
        bench_num("best", bench_seconds_best(&b[i]));
        difference_line(&e);
        bench_num("steps", (double)f[i]->stats.steps);
        bench_num("ended", (double)f[i]->stats.ended);
        bench_num("occupancy", (double)f[i]->stats.steps / (double)f[i]->stats.lanes);
        bench_text("isa", tetcast_isa_name(f[i]->stats.isa));
        if (!(i & 1) && peer[id[i]] != NULL) {
            bench_text("peer", peer[id[i]]);
            bench_num("peer_value", peer_value[id[i]]);
        }
        bench_hash(hash_frame(f[i]));
        finish_line(&b[i], b[i].name);
        g_psnr = fmin(g_psnr, e.psnr);
        g_seams += e.seams;
        if (!(i & 1)) {
            snprintf(key, sizeof key, "frame-%s", g_mesh_name[id[i]]);
            table_set(key, "%.3f", bench_seconds(&b[i]));
        } else {
            const double ratio = bench_ratio(&b[i], &b[i - 1]);
            bench_line("tetcast.empty", g_mesh_name[id[i]], "ratio", ratio, "times");
            difference_line(&e);
            bench_end();
            if (id[i] == MESH_D31K) snprintf(text[0], sizeof text[0], "%.2f", ratio);
            if (id[i] == MESH_K32) snprintf(text[1], sizeof text[1], " (%.2f)", ratio);
        }
        free(r.rgba);
    }
    table_set("empty-D31k", "%s%s", text[0], text[1]);
    table_set("psnr", "%.1f", g_psnr);
    table_set("seams", "%.0f", g_seams);
    for (i = 0; i < n; i++) free_frame(f[i]);
    tetcast_optics_destroy(o);
    tetcast_optics_destroy(full);
}

static size_t g_failed, g_tried;

static void traversal_of(int mesh_id, const tetcast_mesh *mesh, const char *order, const char *key, int views) {
    enum { MOST = 12 };
    frame *f[MOST];
    bench_job b[MOST];
    double seconds = 0, best = 0, steps = 0, lanes = 0, most = 0, e;
    size_t wrong = 0;
    tetcast_mesh_info info;
    int i;
    tetcast_mesh_get_info(mesh, &info);
    for (i = 0; i < views; i++) {
        f[i] = new_frame(mesh, NULL, SIZE);
        turn_camera(&f[i]->d.camera, mesh, i, views);
        f[i]->d.traverse_only = 1;
        f[i]->image.length = (float *)must_alloc((size_t)SIZE * SIZE, 4);
        b[i] = frame_job("walk", f[i]);
    }
    bench_interleave(b, views, 3);
    for (i = 0; i < views; i++) {
        seconds += bench_seconds(&b[i]);
        best += bench_seconds_best(&b[i]);
        steps += (double)f[i]->stats.steps;
        lanes += (double)f[i]->stats.lanes;
        if (mesh_id != MESH_BLUNT && mesh_id != MESH_SPX) {
            wrong += wrong_lengths(f[i], &e);
            most = fmax(most, e);
            g_tried += (size_t)SIZE * SIZE;
        }
    }
    g_failed += wrong;
    bench_line("tetcast.walk", g_mesh_name[mesh_id], "steps_per_second", steps / seconds, "1/s");
    bench_num("best", steps / best);
    bench_num("error", (double)wrong);
    bench_text("error_unit", "rays");
    bench_num("length_error", most);
    bench_text("variant", order);
    bench_num("steps", steps);
    bench_num("occupancy", steps / lanes);
    bench_num("views", views);
    bench_num("frames_per_second", views / seconds);
    bench_num("bytes", (double)info.connectivity_bytes);
    finish_line(&b[0], "walk");
    if (key != NULL) table_set(key, "%.0f", 1e-6 * steps / seconds);
    for (i = 0; i < views; i++) free_frame(f[i]);
}

static void bm1(void) {
    static const int frames[] = {MESH_K32, MESH_K55, MESH_D31K, MESH_D150K}, walks[] = {MESH_L32, MESH_D150K, MESH_BLUNT};
    static const struct { tetcast_order order; const char *name; } orders[2] = {
        {TETCAST_ORDER_MORTON, "Morton"}, {TETCAST_ORDER_INPUT, "input"}};
    size_t i, k;
    frames_of(frames, 4);
    for (i = 0; i < 3; i++) {
        if (get_mesh(walks[i]) == NULL) continue;
        traversal_of(walks[i], get_mesh(walks[i]), "Hilbert", walks[i] == MESH_L32 ? "walk-L32" : NULL, g_opt.full ? 10 : 3);
        for (k = 0; k < 2 && g_opt.full && walks[i] != MESH_BLUNT; k++) {
            tetcast_mesh_desc d;
            tetcast_mesh *mesh;
            memset(&d, 0, sizeof d);
            d.order = orders[k].order;
            mesh = build_mesh(get_tets(walks[i]), &d);
            traversal_of(walks[i], mesh, orders[k].name, NULL, 3);
            tetcast_mesh_destroy(mesh);
        }
    }
    {
        tetcast_mesh_desc d; /* 10 M: what is not needed for walking stays away */
        tetcast_mesh *mesh;
        memset(&d, 0, sizeof d);
        d.drop_source = d.drop_tets = 1;
        mesh = build_mesh(get_tets(MESH_L128), &d);
        traversal_of(MESH_L128, mesh, "Hilbert", "walk-L128", g_opt.full ? 10 : 2);
        tetcast_mesh_destroy(mesh);
        drop_mesh(MESH_L128);
    }
}

/* ---- BM2: integrators ---- */

typedef struct rule {
    tetcast_integrator integrator;
    const char *name;
    uint32_t samples, values, lengths;
    float step, tolerance; /* in units of 1/255 */
} rule;
static const rule g_rules[] = {
    {TETCAST_INTEGRATOR_EXACT, "exact", 0, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_EXACT, "exact within a tolerance", 0, 0, 0, 0, 0.25f},
    {TETCAST_INTEGRATOR_EXACT, "exact within a tolerance", 0, 0, 0, 0, 1},
    {TETCAST_INTEGRATOR_EXACT, "exact within a tolerance", 0, 0, 0, 0, 4},
    {TETCAST_INTEGRATOR_PSI_TABLE, "psi table", 0, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_RIEMANN, "Riemann", 1, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_RIEMANN, "Riemann", 4, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_RIEMANN, "Riemann", 16, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_TRAPEZOID, "trapezoid", 1, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_TRAPEZOID, "trapezoid", 4, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_TRAPEZOID, "trapezoid", 16, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_MIDPOINT, "midpoint", 1, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_MIDPOINT, "midpoint", 4, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_MIDPOINT, "midpoint", 16, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_PRE, "pre-classified", 0, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_PREFIX, "prefix integrals", 0, 0, 0, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_3D, "3D table", 0, 64, 32, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_3D, "3D table", 0, 128, 64, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_3D, "3D table", 0, 256, 128, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_INCREMENTAL, "incremental", 0, 64, 32, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_INCREMENTAL, "incremental", 0, 128, 64, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_INCREMENTAL, "incremental", 0, 256, 128, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_SUBRANGE, "sub-range", 0, 64, 32, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_SUBRANGE, "sub-range", 0, 128, 64, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_SUBRANGE, "sub-range", 0, 256, 128, 0, 0},
    {TETCAST_INTEGRATOR_TABLE_2D, "equidistant, 2D table", 0, 256, 0, 0.02f, 0},
    {TETCAST_INTEGRATOR_TABLE_2D, "equidistant, 2D table", 0, 256, 0, 0.005f, 0},
    {TETCAST_INTEGRATOR_TABLE_PREFIX, "3D table of prefixes", 0, 128, 64, 0, 0}};
enum { RULES = sizeof g_rules / sizeof g_rules[0] };

/* Random pieces of rays through the field: ns for each, and the largest error of one. */
static void segments_of(const rule *rule_of, int tf, tetcast_optics *o, const tetcast_segment *s, size_t count,
                        const double (*want)[4]) {
    float (*got)[4] = (float (*)[4])must_alloc(count, sizeof *got);
    double t[5], most = 0, sum = 0, seconds;
    size_t i;
    int k, c;
    for (k = 0; k < 5; k++) {
        const double start = bench_cpu();
        must(tetcast_optics_segments(o, s, count, TETCAST_ISA_AUTO, got), "segments");
        t[k] = bench_cpu() - start;
    }
    seconds = bench_median(t, 5);
    for (i = 0; i < count; i++)
        for (c = 0; c < 4; c++) {
            const double e = fabs((double)got[i][c] - want[i][c]);
            most = fmax(most, e);
            sum += e;
        }
    bench_line("tetcast.segment", g_tf_name[tf], "segment_seconds", 1e9 * seconds / (double)count, "ns");
    bench_num("best", 1e9 * bench_least(t, 5) / (double)count);
    bench_num("error", most);
    bench_text("error_unit", "colour");
    bench_num("mean_error", sum / (4.0 * (double)count));
    bench_text("method", rule_of->name);
    bench_num("samples", rule_of->samples);
    bench_num("table", rule_of->values);
    bench_num("threads", 1);
    bench_hash(bench_hash_bytes(got, count * sizeof *got));
    bench_end();
    free(got);
}

static void integrators(int tf, uint32_t size) {
    static double exact_segment[2];
    const size_t count = 20000;
    const tetcast_mesh *mesh = get_mesh(MESH_K32);
    tetcast_segment *s = (tetcast_segment *)must_alloc(count, sizeof *s);
    double (*want)[4] = (double (*)[4])must_alloc(count, sizeof *want);
    frame *f[RULES];
    bench_job b[RULES];
    double build[RULES];
    int which[RULES], n = 0, i, c;
    bench_rng r;
    reference ref;
    tetcast_check check;
    size_t k, points;
    const tetcast_control_point *p = tf_points(tf, &points);
    must(tetcast_mesh_check(mesh, NULL, &check), "check");
    r.state = 77;
    for (k = 0; k < count; k++) { /* a tenth of the range over at most a quarter of the cube, and some longer ones */
        const float wide = k % 8 == 0 ? 1.0f : 0.1f;
        s[k].front = bench_random(&r);
        s[k].back = s[k].front + wide * (bench_random(&r) - 0.5f);
        s[k].back = s[k].back < 0 ? 0 : s[k].back > 1 ? 1 : s[k].back;
        s[k].length = 0.25f * bench_random(&r) * bench_random(&r);
        oracle_segment(p, points, 0, &s[k], want[k]);
    }
    for (i = 0; i < RULES; i++) {
        const rule *u = &g_rules[i];
        tetcast_optics_desc d;
        double start;
        memset(&d, 0, sizeof d);
        d.integrator = u->integrator;
        d.tolerance = u->tolerance;
        d.path_length = 1.75f; /* the diagonal of the cube and a little */
        d.samples = u->samples;
        d.table_values = u->values;
        d.table_lengths = u->lengths;
        d.longest = u->integrator >= TETCAST_INTEGRATOR_TABLE_3D ? (float)check.longest_edge : 0.0f;
        d.step = u->step;
        d.t_min = u->tolerance > 0.0f ? 0.0f : -1.0f; /* ends no ray early: the error is the integrator's */
        d.env.thread_count = 1;
        start = bench_cpu();
        f[n] = new_frame(mesh, make_optics(tf, &d), size);
        build[n] = bench_cpu() - start;
        f[n]->own = (tetcast_optics *)(uintptr_t)f[n]->optics;
        which[n] = i;
        b[n] = frame_job(u->name, f[n]);
        segments_of(u, tf, f[n]->own, s, count, (const double (*)[4])want);
        if (i == 0) {
            float (*got)[4] = (float (*)[4])must_alloc(count, sizeof *got);
            must(tetcast_optics_segments(f[n]->own, s, count, TETCAST_ISA_AUTO, got), "segments");
            for (k = 0; k < count; k++)
                for (c = 0; c < 4 && tf < 2; c++)
                    exact_segment[tf] = fmax(exact_segment[tf], fabs((double)got[k][c] - want[k][c]));
            free(got);
            if (tf == TF_PEAK) table_set("error-smooth-segment", "%.1e / %.1e", exact_segment[0], exact_segment[1]);
        }
        n++;
    }
    bench_interleave(b, n, g_opt.full ? 5 : 2);
    ref = make_reference(f[0], get_tets(MESH_K32), tf, g_opt.full ? 1 : 2);
    for (i = 0; i < n; i++) {
        const rule *u = &g_rules[which[i]];
        difference e = compare(f[i], &ref);
        tetcast_optics_info info;
        char kase[64];
        tetcast_optics_get_info(f[i]->own, &info);
        snprintf(kase, sizeof kase, "K32-%s", g_tf_name[tf]);
        bench_line("tetcast.integrator", kase, "frame_seconds", bench_seconds(&b[i]), "s");
        bench_num("best", bench_seconds_best(&b[i]));
        difference_line(&e);
        bench_num("ns_per_step", 1e9 * bench_seconds(&b[i]) / (double)f[i]->stats.steps);
        bench_num("samples", u->samples);
        bench_num("table", u->values);
        bench_num("step", (double)u->step);
        bench_num("tolerance", (double)u->tolerance);
        bench_num("bytes", (double)info.table_bytes);
        bench_num("build_seconds", build[i]);
        bench_hash(hash_frame(f[i]));
        finish_line(&b[i], u->name);
        if (i == 0 && tf == TF_SMOOTH) table_set("error-smooth", "%.1e", e.most);
        if (i == 0 && tf == TF_PEAK) table_set("error-peak", "%.1e", e.most);
        free_frame(f[i]);
    }
    free(ref.rgba);
    free(s);
    free(want);
}

static void bm2(void) {
    integrators(TF_SMOOTH, 256);
    integrators(TF_PEAK, 256);
    integrators(TF_TABLE, 256);
    if (g_opt.full) integrators(TF_STEP, 256);
}

/* ---- BM3: forms of cells; BM4: strips ---- */

static const char *const g_form[TETCAST_CELLS_COUNT] = {"Tet16", "Tet8", "Tet20", "Tet32", "list of 160 bytes", "strips",
                                                        "strips, general"};

typedef struct build { const tets *t; tetcast_mesh_desc d; tetcast_mesh *mesh; } build;

static void run_build(void *ctx) {
    build *u = (build *)ctx;
    tetcast_mesh_destroy(u->mesh);
    u->mesh = build_mesh(u->t, &u->d);
}

static void forms_of(int id) {
    const uint32_t size = g_opt.full ? SIZE : SIZE / 2;
    const tets *t = get_tets(id);
    tetcast_optics *o = make_optics(TF_SMOOTH, NULL);
    frame *f[2 * TETCAST_CELLS_COUNT];
    bench_job b[2 * TETCAST_CELLS_COUNT];
    build u[TETCAST_CELLS_COUNT];
    double made[TETCAST_CELLS_COUNT];
    uint64_t hash = 0;
    size_t i;
    if (t == NULL) return;
    memset(u, 0, sizeof u);
    for (i = 0; i < TETCAST_CELLS_COUNT; i++) {
        double start = bench_cpu();
        u[i].t = t;
        u[i].d.env.thread_count = 1;
        u[i].d.cells = (tetcast_cells)i;
        run_build(&u[i]);
        made[i] = bench_cpu() - start;
        f[2 * i] = new_frame(u[i].mesh, o, size);
        f[2 * i + 1] = new_frame(u[i].mesh, NULL, size);
        f[2 * i + 1]->d.traverse_only = 1;
        b[2 * i] = frame_job(g_form[i], f[2 * i]);
        b[2 * i + 1] = frame_job(g_form[i], f[2 * i + 1]);
    }
    bench_interleave(b, 2 * TETCAST_CELLS_COUNT, 3);
    hash = hash_frame(f[0]);
    for (i = 0; i < TETCAST_CELLS_COUNT; i++) {
        tetcast_mesh_info info;
        tetcast_mesh_get_info(u[i].mesh, &info);
        bench_line("tetcast.cells", g_mesh_name[id], "steps_per_second",
                   (double)f[2 * i + 1]->stats.steps / bench_seconds(&b[2 * i + 1]), "1/s");
        bench_num("error", hash_frame(f[2 * i]) != hash);
        bench_text("error_unit", "pictures that differ");
        bench_num("frame_seconds", bench_seconds(&b[2 * i]));
        bench_num("bytes", (double)info.connectivity_bytes);
        bench_num("bytes_per_cell", (double)info.connectivity_bytes / (double)info.cell_count);
        bench_num("total_per_cell", (double)info.total_bytes / (double)info.cell_count);
        bench_num("build_seconds", made[i]);
        bench_hash(hash_frame(f[2 * i]));
        finish_line(&b[2 * i + 1], g_form[i]);
        free_frame(f[2 * i]);
        free_frame(f[2 * i + 1]);
        tetcast_mesh_destroy(u[i].mesh);
    }
    tetcast_optics_destroy(o);
}

/* What a mesh holds in all, by what it is to be good for. */
static void bytes_of(int id) {
    static const struct { const char *name; tetcast_cells cells; uint32_t tets, source, clusters; } kinds[] = {
        {"Tet8: rays", TETCAST_CELLS_TET8, 0, 0, 0}, {"Tet8: rays that leap", TETCAST_CELLS_TET8, 0, 0, 1},
        {"Tet8: rays, projection, surfaces", TETCAST_CELLS_TET8, 1, 0, 0}, {"Tet8: all", TETCAST_CELLS_TET8, 1, 1, 1},
        {"Tet16: rays", TETCAST_CELLS_TET16, 0, 0, 0}, {"Tet16: all (default)", TETCAST_CELLS_TET16, 1, 1, 1}};
    enum { KINDS = sizeof kinds / sizeof kinds[0] };
    double total[KINDS];
    size_t i;
    for (i = 0; i < KINDS; i++) {
        tetcast_mesh_info info;
        build u;
        double n;
        memset(&u, 0, sizeof u);
        u.t = get_tets(id);
        u.d.env.thread_count = 1;
        u.d.cells = kinds[i].cells;
        u.d.drop_tets = !kinds[i].tets;
        u.d.drop_source = !kinds[i].source;
        u.d.disable_clusters = !kinds[i].clusters;
        run_build(&u);
        tetcast_mesh_get_info(u.mesh, &info);
        n = (double)info.cell_count;
        total[i] = (double)info.total_bytes / n;
        bench_line("tetcast.bytes", g_mesh_name[id], "bytes_per_cell", total[i], "bytes");
        bench_num("error", 0);
        bench_text("error_unit", "pictures that differ (BM3)");
        bench_text("method", kinds[i].name);
        bench_num("connectivity", (double)info.connectivity_bytes / n);
        bench_num("vertices", (double)info.vertex_bytes / n);
        bench_num("fields", (double)info.field_bytes / n);
        bench_num("hull", (double)info.hull_bytes / n);
        bench_num("clusters", (double)info.cluster_bytes / n);
        bench_num("optional", (double)info.optional_bytes / n);
        bench_end();
        if (i == 0) table_set("bytes", "%.2f / %.2f", (double)info.connectivity_bytes / n, total[0]);
        tetcast_mesh_destroy(u.mesh);
    }
    table_set("bytes-more", "%.2f / %.2f / %.2f / %.2f", total[1], total[2], total[3], total[5]);
}

/* The thesis' strips with what it keeps beside them: bytes against steps of rays by planes, and lengths that are wrong. */
static void strips_planes_of(int id) {
    static const char *const names[4] = {"nothing: planes from positions", "normals", "gradients", "normals and gradients"};
    enum { RAYS = 64 };
    const tets *t = get_tets(id);
    tetcast_mesh_desc d;
    tetcast_mesh *mesh;
    tetcast_optics *o;
    uint32_t keep, x, y;
    if (t == NULL) return;
    memset(&d, 0, sizeof d);
    d.cells = TETCAST_CELLS_STRIPS;
    d.keep_neighbours = 1;
    mesh = build_mesh(t, &d);
    o = make_optics(TF_SMOOTH, NULL);
    for (keep = 0; keep < 4; keep++) {
        tetcast_camera camera;
        strips_planes s;
        baseline_stats stats;
        double seconds = 0;
        size_t wrong = 0;
        memset(&stats, 0, sizeof stats);
        if (!strips_planes_make(mesh, keep, &s)) die("strips", "out of memory");
        place_camera(&camera, mesh);
        for (y = 0; y < RAYS; y++)
            for (x = 0; x < RAYS; x++) {
                tetcast_ray ray;
                tetcast_ray_result want;
                tetcasti_ray_sum sum;
                double length = 0, start;
                float e[3], dir[3], at;
                uint32_t column, k;
                must(tetcast_camera_ray(&camera, RAYS, RAYS, x + 0.5, y + 0.5, &ray), "camera");
                must(tetcast_cast(NULL, mesh, NULL, &ray, 1, &want, NULL), "cast");
                column = strips_planes_enter(&s, mesh, &ray, &at);
                if (column == TETCASTI_NONE) continue;
                for (k = 0; k < 3; k++) {
                    e[k] = (float)ray.org[k];
                    dir[k] = (float)ray.dir[k];
                }
                tetcasti_ray_begin(o, &sum);
                start = bench_cpu();
                strips_planes_walk(&s, e, dir, column, at, o, &sum, &length, &stats);
                seconds += bench_cpu() - start;
                wrong += !(fabs(length - (double)want.length) < 1e-4);
            }
        bench_line("tetcast.strip_planes", g_mesh_name[id], "steps_per_second", (double)stats.steps / seconds, "1/s");
        bench_num("error", (double)wrong);
        bench_text("error_unit", "rays");
        bench_text("method", names[keep]);
        bench_num("bytes", strips_planes_bytes(&s));
        bench_num("bits_per_cell", 8 * strips_planes_bytes(&s) / (double)s.cells);
        bench_num("thesis_bits", keep == 0 ? 117 : keep == 3 ? 608 : 0);
        bench_num("threads", 1);
        bench_end();
        strips_planes_free(&s);
    }
    tetcast_optics_destroy(o);
    tetcast_mesh_destroy(mesh);
}

static void bm3(void) {
    forms_of(MESH_D31K);
    strips_planes_of(MESH_L32);
    bytes_of(MESH_D150K);
    if (g_opt.full) {
        forms_of(MESH_K32);
        forms_of(MESH_D150K);
    }
}

static void bm4(void) {
    static const struct { int id; double thesis[2]; } meshes[] = {{MESH_L32, {63.42, 57.58}}, {MESH_SPX, {63.60, 59.46}},
                                                                  {MESH_BLUNT, {0, 0}}, {MESH_D31K, {0, 0}}};
    size_t i, k;
    for (i = 0; i < 4; i++) {
        for (k = 0; k < 2; k++) {
            tetcast_mesh_info info;
            build u;
            double start, seconds, share;
            strips_rows rows;
            if (meshes[i].id == MESH_BLUNT || get_tets(meshes[i].id) == NULL) continue;
            memset(&u, 0, sizeof u);
            u.t = get_tets(meshes[i].id);
            u.d.env.thread_count = 1;
            run_build(&u); /* what the rest of the import takes */
            start = bench_cpu();
            run_build(&u);
            seconds = start - bench_cpu();
            u.d.cells = k ? TETCAST_CELLS_STRIPS_GENERAL : TETCAST_CELLS_STRIPS;
            start = bench_cpu();
            run_build(&u);
            seconds += bench_cpu() - start;
            tetcast_mesh_get_info(u.mesh, &info);
            share = 100.0 * (double)info.connectivity_bytes / 32.0 / (double)info.cell_count; /* 8 indices a cell */
            bench_line("tetcast.strips", g_mesh_name[meshes[i].id], "share_of_list", share, "%");
            bench_num("error", 0);
            bench_text("error_unit", "cells that differ (tests)");
            bench_text("method", k ? "general" : "sequential");
            bench_num("seconds", seconds);
            bench_num("cells_per_second", (double)info.cell_count / seconds);
            bench_num("bytes", (double)info.connectivity_bytes);
            if (meshes[i].thesis[k] > 0) bench_num("thesis", meshes[i].thesis[k]);
            if (strips_rows_make(u.mesh, 4096, &rows)) { /* in a texture; with two bits a vertex instead of repetitions */
                const double columns = (double)info.cell_count + 3.0 * rows.strips;
                bench_num("used_of_rows", 100.0 * (columns + rows.repeated) / ((double)rows.rows * rows.width));
                bench_num("strips", rows.strips);
                bench_num("share_with_bits", 100.0 * columns * (3.0 + 2.0 / 32.0) / (8.0 * (double)info.cell_count));
                strips_rows_free(&rows);
            }
            bench_end();
            if (k == 0 && meshes[i].id == MESH_L32) table_set("strips", "%.1f", share);
            tetcast_mesh_destroy(u.mesh);
        }
    }
}

/* ---- BM5: projection; BM7: walking or projecting ---- */

static void project_lines(const char *bench, const char *kase, frame *walk, frame *project, const bench_job b[2],
                          double cells) {
    const size_t n = (size_t)walk->image.width * walk->image.height;
    double most = 0;
    size_t i, k;
    for (i = 0; i < 4 * n; i++) most = fmax(most, fabs((double)walk->image.rgba[i] - (double)project->image.rgba[i]));
    for (k = 0; k < 2; k++) {
        const frame *f = k ? project : walk;
        bench_line(bench, kase, "cells_per_second", bench_rate(&b[k], cells), "1/s");
        bench_num("best", bench_rate_best(&b[k], cells));
        bench_num("error", most);
        bench_text("error_unit", "colour, between the two");
        bench_num("frame_seconds", bench_seconds(&b[k]));
        bench_num("pixels_per_cell", (double)walk->stats.steps / cells);
        bench_num("fragments_per_second", (double)walk->stats.steps / bench_seconds(&b[k]));
        if (k) bench_num("times_as_fast", bench_ratio(&b[0], &b[1]));
        bench_hash(hash_frame(f));
        finish_line(&b[k], b[k].name);
    }
}

/* Both ways for one picture; returns cells/s of projection. */
static double both_ways(const char *bench, const char *kase, int id, tetcast_model model, uint32_t size, int rounds) {
    const tetcast_mesh *mesh = get_mesh(id);
    tetcast_optics_desc d;
    tetcast_isovalue iso;
    tetcast_mesh_info info;
    tetcast_optics *o;
    frame *f[2];
    bench_job b[2];
    double rate;
    int k;
    if (mesh == NULL) return 0;
    memset(&d, 0, sizeof d);
    memset(&iso, 0, sizeof iso);
    d.model = model;
    iso.value = 0.5f;
    iso.opacity = 1;
    iso.rgb[0] = iso.rgb[1] = 0.8f;
    tetcast_mesh_get_info(mesh, &info);
    o = make_optics_range(TF_SMOOTH, 0, 1, 1, &d, &iso, model == TETCAST_MODEL_ISOSURFACE ? 1 : 0);
    for (k = 0; k < 2; k++) {
        f[k] = new_frame(mesh, o, size);
        f[k]->d.method = k ? TETCAST_METHOD_PROJECT : TETCAST_METHOD_WALK;
        b[k] = frame_job(k ? "projection" : "walk", f[k]);
    }
    bench_interleave(b, 2, rounds);
    project_lines(bench, kase, f[0], f[1], b, (double)info.cell_count);
    rate = bench_rate(&b[1], (double)info.cell_count);
    for (k = 0; k < 2; k++) free_frame(f[k]);
    tetcast_optics_destroy(o);
    return rate;
}

static void bm5(void) {
    static const struct { tetcast_model model; const char *name; } models[] = {
        {TETCAST_MODEL_EMISSION, "emission"}, {TETCAST_MODEL_ABSORPTION, "absorption"},
        {TETCAST_MODEL_MAXIMUM, "maximum"}, {TETCAST_MODEL_ISOSURFACE, "isosurface"}, {TETCAST_MODEL_VOLUME, "volume"}};
    static const int ids[3] = {MESH_L128, MESH_K55, MESH_K32};
    double rate[3] = {0, 0, 0};
    char kase[64];
    int i, k;
    for (i = 0; i < 3; i++) {
        for (k = 0; k < (g_opt.full ? 5 : 1); k++) {
            double r;
            snprintf(kase, sizeof kase, "%s, %s", g_mesh_name[ids[i]], models[k].name);
            r = both_ways("tetcast.project", kase, ids[i], models[k].model, SIZE, g_opt.full ? 3 : i == 0 ? 1 : 2);
            if (k == 0) rate[i] = r;
        }
        if (i == 0) drop_mesh(MESH_L128);
    }
    table_set("project", "%.1f (%.1f, %.1f)", 1e-6 * rate[0], 1e-6 * rate[1], 1e-6 * rate[2]);
}

/* ---- BM6: projection in order; forms of projection ---- */

typedef struct old_way { frame *f; projection_way how; projection_report report; } old_way;

static void run_old_way(void *ctx) {
    old_way *o = (old_way *)ctx;
    must(projection_project(&o->how, &o->f->d, o->f->mesh, o->f->optics, &o->f->image, &o->report), "projection");
}

typedef struct way { const char *name; projection_way how; } way;

static bench_job old_job(const char *name, old_way *o) {
    bench_job b = frame_job(name, o->f);
    b.run = run_old_way;
    b.ctx = o;
    return b;
}

static double largest_difference(const frame *a, const frame *b) {
    const size_t n = 4 * (size_t)a->image.width * a->image.height;
    double most = 0;
    size_t i;
    for (i = 0; i < n; i++) {
        const double e = fabs((double)a->image.rgba[i] - (double)b->image.rgba[i]);
        most = fmax(most, e == e ? e : 1e9);
    }
    return most;
}

/* Ways of projecting one picture, against the walk. ortho: parallel rays. */
static void ways_of(const char *bench, int id, tetcast_model model, int ortho, const way *ways, int count) {
    enum { MOST = 8 };
    const uint32_t size = g_opt.full ? SIZE : SIZE / 2;
    tetcast_mesh_desc md;
    tetcast_optics_desc d;
    tetcast_mesh_info info;
    tetcast_mesh *mesh;
    tetcast_optics *o;
    old_way old[MOST];
    frame *walk;
    bench_job b[MOST + 1];
    char kase[64];
    int i;
    if (get_tets(id) == NULL) return;
    memset(&md, 0, sizeof md);
    memset(&d, 0, sizeof d);
    memset(old, 0, sizeof old);
    md.keep_neighbours = 1; /* an order of cells needs them */
    mesh = build_mesh(get_tets(id), &md);
    tetcast_mesh_get_info(mesh, &info);
    d.model = model;
    d.t_min = -1; /* rays that end see less of what comes too late */
    o = make_optics(TF_SMOOTH, &d);
    walk = new_frame(mesh, o, size);
    if (ortho) walk->d.camera.ortho_height = 1.8f;
    walk->d.method = TETCAST_METHOD_WALK;
    b[count] = frame_job("walk", walk);
    for (i = 0; i < count; i++) {
        old[i].f = new_frame(mesh, o, size);
        old[i].f->d.camera = walk->d.camera;
        old[i].how = ways[i].how;
        b[i] = old_job(ways[i].name, &old[i]);
    }
    bench_interleave(b, count + 1, g_opt.full ? 3 : 1);
    snprintf(kase, sizeof kase, "%s%s", g_mesh_name[id], ortho ? ", parallel rays" : "");
    for (i = 0; i <= count; i++) {
        bench_line(bench, kase, "cells_per_second", bench_rate(&b[i], (double)info.cell_count), "1/s");
        bench_num("error", i < count ? largest_difference(old[i].f, walk) : 0);
        bench_text("error_unit", "colour, from the walk");
        bench_num("frame_seconds", bench_seconds(&b[i]));
        if (i < count) {
            bench_num("fragments", (double)old[i].report.fragments);
            bench_num("violations", (double)old[i].report.violations);
            bench_num("cycles", (double)old[i].report.cycles);
            bench_hash(hash_frame(old[i].f));
        } else {
            bench_num("fragments", (double)walk->stats.steps);
        }
        finish_line(&b[i], b[i].name);
        if (i < count) free_frame(old[i].f);
    }
    free_frame(walk);
    tetcast_optics_destroy(o);
    tetcast_mesh_destroy(mesh);
}

static const way g_orders[] = {{"lists by depth", {PROJECTION_SIGNS, PROJECTION_LISTS, 0, 0, 0, 0, 0}},
                               {"middles of cells", {PROJECTION_SIGNS, PROJECTION_CENTROID, 0, 0, 0, 0, 0}},
                               {"MPVO", {PROJECTION_SIGNS, PROJECTION_MPVO, 0, 0, 0, 0, 0}},
                               {"k-buffer, k = 2", {PROJECTION_SIGNS, PROJECTION_CENTROID, 2, 0, 0, 0, 0}},
                               {"k-buffer, k = 6", {PROJECTION_SIGNS, PROJECTION_CENTROID, 6, 0, 0, 0, 0}},
                               {"k-buffer, k = 16", {PROJECTION_SIGNS, PROJECTION_CENTROID, 16, 0, 0, 0, 0}},
                               {"no order", {PROJECTION_SIGNS, PROJECTION_RANDOM, 0, 0, 0, 0, 0}}};
static const way g_forms[] = {{"signs", {PROJECTION_SIGNS, PROJECTION_LISTS, 0, 0, 0, 0, 0}},
                              {"faces, way out per fragment", {PROJECTION_FRAGMENT, PROJECTION_LISTS, 0, 0, 0, 3, 0}},
                              {"projected tetrahedra", {PROJECTION_PT, PROJECTION_LISTS, 0, 0, 0, 0, 1}},
                              {"projected tetrahedra, linear in the picture", {PROJECTION_PT, PROJECTION_LISTS, 0, 0, 0, 0, 0}},
                              {"ways at vertices", {PROJECTION_VERTEX, PROJECTION_LISTS, 0, 2, 0, 0, 0}},
                              {"ways at vertices, repaired edges", {PROJECTION_VERTEX, PROJECTION_LISTS, 0, 1, 0, 0, 0}},
                              {"ways at vertices, table of 64^3", {PROJECTION_VERTEX, PROJECTION_LISTS, 0, 1, 64, 0, 0}}};

static void bm6(void) {
    ways_of("tetcast.order", MESH_K32, TETCAST_MODEL_VOLUME, 0, g_orders, 7);
    ways_of("tetcast.order", MESH_D31K, TETCAST_MODEL_VOLUME, 0, g_orders, 7);
    ways_of("tetcast.form", MESH_K32, TETCAST_MODEL_EMISSION, 0, g_forms, 4);
    ways_of("tetcast.form", MESH_K32, TETCAST_MODEL_EMISSION, 1, g_forms, 7);
    if (g_opt.full) ways_of("tetcast.order", MESH_SPX, TETCAST_MODEL_VOLUME, 0, g_orders, 7);
}

static void bm7(void) {
    static const uint32_t sizes[] = {64, 256, 1024};
    static const int ids[] = {MESH_SPX, MESH_K32, MESH_D31K, MESH_D150K};
    char kase[64];
    size_t i, k;
    for (i = 0; i < 4; i++)
        for (k = 0; k < 3; k++) {
            if (!g_opt.full && (i == 3 || k == 2)) continue;
            snprintf(kase, sizeof kase, "%s, %u pixels", g_mesh_name[ids[i]], sizes[k]);
            (void)both_ways("tetcast.crossover", kase, ids[i], TETCAST_MODEL_VOLUME, sizes[k], 3);
        }
}

/* ---- BM8: early termination ---- */

static void ending(int id) {
    static const float ends[] = {-1.0f, 0, 1.0f / 64, 1.0f / 16};
    const tetcast_mesh *mesh = get_mesh(id);
    double all_steps = 0;
    frame *f[8];
    bench_job b[8];
    reference r;
    int i;
    if (mesh == NULL) return;
    for (i = 0; i < 8; i++) {
        tetcast_optics_desc d;
        tetcast_isovalue iso;
        memset(&d, 0, sizeof d);
        memset(&iso, 0, sizeof iso);
        iso.value = 0.7f;
        iso.rgb[0] = iso.rgb[1] = 0.8f;
        iso.opacity = 0.25f * (float)(i - 3);
        d.t_min = i < 4 ? ends[i] : 0.0f;
        d.model = i < 4 ? TETCAST_MODEL_VOLUME : TETCAST_MODEL_ISOSURFACE;
        f[i] = new_frame(mesh, i < 4 ? make_optics(TF_STEP, &d) : make_optics_range(TF_SMOOTH, 0, 1, 1, &d, &iso, 1), SIZE);
        f[i]->own = (tetcast_optics *)(uintptr_t)f[i]->optics;
        b[i] = frame_job(i < 4 ? "volume" : "isosurface", f[i]);
    }
    bench_interleave(b, 8, 3);
    r = make_reference(f[0], get_tets(id), TF_STEP, 8);
    for (i = 0; i < 8; i++) {
        tetcast_optics_info info;
        difference e = compare(f[i], &r);
        tetcast_optics_get_info(f[i]->own, &info);
        if (i == 0) all_steps = (double)f[0]->stats.steps;
        bench_line("tetcast.ending", g_mesh_name[id], "frame_seconds", bench_seconds(&b[i]), "s");
        if (i < 4) {
            difference_line(&e);
            bench_num("t_min", (double)info.t_min);
        } else {
            bench_num("error", 0);
            bench_text("error_unit", "not measured here");
            bench_num("opacity", 0.25 * (i - 3));
        }
        bench_num("steps", (double)f[i]->stats.steps);
        bench_num("share_of_steps", (double)f[i]->stats.steps / all_steps);
        bench_num("ended", (double)f[i]->stats.ended);
        finish_line(&b[i], b[i].name);
        free_frame(f[i]);
    }
    free(r.rgba);
}

static void bm8(void) {
    ending(MESH_D31K);
    if (g_opt.full) ending(MESH_K32);
}

/* ---- BM9: isosurfaces ---- */

typedef struct contour { const tetcast_mesh *mesh; float value; tetcast_surface out; } contour;

static void run_contour(void *ctx) {
    contour *c = (contour *)ctx;
    tetcast_surface_desc d;
    tetcast_surface_free(&c->out);
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.isovalue = c->value;
    must(tetcast_isosurface(&d, c->mesh, &c->out), "isosurface");
}

typedef struct edge_use { uint32_t a, b; int turn; } edge_use;
static int by_edge(const void *p, const void *q) {
    const edge_use *a = (const edge_use *)p, *b = (const edge_use *)q;
    if (a->a != b->a) return a->a < b->a ? -1 : 1;
    return a->b < b->b ? -1 : a->b > b->b;
}

/* Edges inside of the unit cube that do not have one triangle on each side. */
static size_t open_edges(const tetcast_surface *s) {
    edge_use *e = (edge_use *)must_alloc((size_t)s->triangle_count * 3, sizeof *e);
    size_t n = 3 * (size_t)s->triangle_count, i, k, open = 0;
    for (i = 0; i < n; i++) {
        const uint32_t u = s->indices[i], v = s->indices[i % 3 == 2 ? i - 2 : i + 1];
        e[i].a = u < v ? u : v;
        e[i].b = u < v ? v : u;
        e[i].turn = u < v ? 1 : -1;
    }
    qsort(e, n, sizeof *e, by_edge);
    for (i = 0; i < n; i = k) {
        int sum = 0, inside = 0, c;
        for (k = i; k < n && by_edge(&e[i], &e[k]) == 0; k++) sum += e[k].turn;
        if (sum == 0) continue;
        for (c = 0; c < 3; c++) { /* an edge in a side of the cube has both ends there */
            const double x = s->origin[c] + (double)s->positions[3 * e[i].a + (uint32_t)c];
            const double y = s->origin[c] + (double)s->positions[3 * e[i].b + (uint32_t)c];
            inside += !((x < 1e-6 && y < 1e-6) || (x > 1 - 1e-6 && y > 1 - 1e-6));
        }
        open += inside == 3;
    }
    free(e);
    return open;
}

/* How far hits of a part of the rays are off, and how many of them only one side has. */
static void hit_errors(const frame *f, const tets *t, float iso) {
    enum { STEP = 8 };
    const uint32_t n = f->image.width;
    oracle_cells list;
    double most = 0;
    size_t differ = 0, hits = 0;
    uint32_t x, y;
    memset(&list, 0, sizeof list);
    for (y = 0; y < n; y += STEP)
        for (x = 0; x < n; x += STEP) {
            tetcast_ray ray;
            tetcast_ray_result got;
            double want;
            must(tetcast_camera_ray(&f->d.camera, n, n, x + 0.5, y + 0.5, &ray), "camera");
            must(tetcast_cast(&f->d, f->mesh, f->optics, &ray, 1, &got, NULL), "cast");
            want = oracle_hit(f->mesh, t, (double)iso, &ray, &list);
            if (want < 1e30 && fabs((double)got.hit - want) < 0.01) most = fmax(most, fabs((double)got.hit - want));
            else differ += want < 1e30 || got.hit < 1e30f;
            hits += want < 1e30;
        }
    free(list.visit);
    bench_num("error", most);
    bench_text("error_unit", "edge of the cube");
    bench_num("differ", (double)differ);
    bench_num("hits", (double)hits);
}

static void bm9(void) {
    static const int hits[2] = {MESH_K32, MESH_D31K}, contours[4] = {MESH_K55, MESH_D150K, MESH_K32, MESH_D31K};
    char text[2][24] = {"", ""};
    int i, n = 0;
    contour c[4];
    bench_job b[4];
    for (i = 0; i < 2; i++) {
        const tetcast_mesh *mesh = get_mesh(hits[i]);
        tetcast_optics_desc d;
        tetcast_isovalue iso;
        frame *f;
        char key[32];
        if (mesh == NULL) continue;
        memset(&d, 0, sizeof d);
        memset(&iso, 0, sizeof iso);
        d.model = TETCAST_MODEL_ISOSURFACE;
        iso.value = 0.5f;
        iso.rgb[0] = 1;
        iso.opacity = 1;
        f = new_frame(mesh, make_optics_range(TF_SMOOTH, 0, 1, 1, &d, &iso, 1), SIZE);
        f->own = (tetcast_optics *)(uintptr_t)f->optics;
        b[0] = frame_job("walk", f);
        bench_interleave(b, 1, ROUNDS);
        bench_line("tetcast.hit", g_mesh_name[hits[i]], "rays_per_second", bench_rate(&b[0], (double)SIZE * SIZE), "1/s");
        bench_num("best", bench_rate_best(&b[0], (double)SIZE * SIZE));
        hit_errors(f, get_tets(hits[i]), iso.value);
        bench_num("steps", (double)f->stats.steps);
        bench_hash(hash_frame(f));
        bench_text("peer", "Open VKL");
        bench_num("peer_value", i == 0 ? 0.33e6 : 0.0012e6);
        finish_line(&b[0], "walk");
        snprintf(key, sizeof key, "iso-%s", g_mesh_name[hits[i]]);
        table_set(key, "%.2f", 1e-6 * bench_rate(&b[0], (double)SIZE * SIZE));
        free_frame(f);
    }
    memset(c, 0, sizeof c);
    memset(b, 0, sizeof b);
    for (i = 0; i < (g_opt.full ? 4 : 2); i++) {
        if (get_mesh(contours[i]) == NULL) continue;
        c[n].mesh = get_mesh(contours[i]);
        c[n].value = 0.5f;
        b[n].name = g_mesh_name[contours[i]];
        b[n].run = run_contour;
        b[n].ctx = &c[n];
        n++;
    }
    bench_interleave(b, n, ROUNDS);
    for (i = 0; i < n; i++) {
        tetcast_mesh_info info;
        tetcast_mesh_get_info(c[i].mesh, &info);
        bench_line("tetcast.contour", b[i].name, "cells_per_second", bench_rate(&b[i], (double)info.cell_count), "1/s");
        bench_num("best", bench_rate_best(&b[i], (double)info.cell_count));
        bench_num("error", (double)open_edges(&c[i].out));
        bench_text("error_unit", "open edges");
        bench_num("triangles", c[i].out.triangle_count);
        bench_num("vertices", c[i].out.vertex_count);
        bench_text("peer", "vtkContour3DLinearGrid, merged");
        bench_num("peer_value", 20e6);
        bench_hash(bench_hash_bytes(c[i].out.indices, 12 * (size_t)c[i].out.triangle_count));
        finish_line(&b[i], "marching tetrahedra");
        if (i < 2) snprintf(text[i], sizeof text[i], i == 0 ? "%.0f" : " (%.0f)", 1e-6 * bench_rate(&b[i], (double)info.cell_count));
        tetcast_surface_free(&c[i].out);
    }
    table_set("contour", "%s%s", text[0], text[1]);
}

/* ---- BM10: changes of the transfer function ---- */

typedef struct edit { tetcast_optics_desc d; tetcast_transfer *before, *after; tetcast_optics *old; int update; } edit;

static void run_edit(void *ctx) {
    edit *e = (edit *)ctx;
    tetcast_optics *o = NULL;
    if (e->update) must(tetcast_optics_update(e->old, e->after, &e->d, &o), "update");
    else must(tetcast_optics_create(e->after, &e->d, &o), "optics");
    tetcast_optics_destroy(o);
}

static void bm10(void) {
    static const struct { tetcast_integrator integrator; const char *name; int update; } kinds[] = {
        {TETCAST_INTEGRATOR_EXACT, "exact", 0}, {TETCAST_INTEGRATOR_TABLE_3D, "3D table", 0},
        {TETCAST_INTEGRATOR_TABLE_3D, "3D table, local", 1}, {TETCAST_INTEGRATOR_TABLE_INCREMENTAL, "incremental", 0},
        {TETCAST_INTEGRATOR_TABLE_SUBRANGE, "sub-range", 0}, {TETCAST_INTEGRATOR_TABLE_2D, "2D table", 0}};
    enum { KINDS = sizeof kinds / sizeof kinds[0] };
    edit e[KINDS];
    bench_job b[KINDS];
    int i;
    memset(e, 0, sizeof e);
    memset(b, 0, sizeof b);
    for (i = 0; i < KINDS; i++) {
        tetcast_transfer_desc td;
        tetcast_control_point p[TF_POINTS];
        size_t n;
        memcpy(p, tf_points(TF_SMOOTH, &n), sizeof p);
        p[4].extinction = 1.2f; /* what a hand on a slider does */
        memset(&td, 0, sizeof td);
        td.points = p;
        td.point_count = TF_POINTS;
        e[i].before = make_transfer_range(TF_SMOOTH, 0, 1, 1, NULL, 0);
        must(tetcast_transfer_create(&td, &e[i].after), "transfer function");
        e[i].d.integrator = kinds[i].integrator;
        e[i].d.longest = i != 0 ? 0.05f : 0;
        e[i].d.env.thread_count = 1;
        e[i].update = kinds[i].update;
        must(tetcast_optics_create(e[i].before, &e[i].d, &e[i].old), "optics");
        b[i].name = kinds[i].name;
        b[i].run = run_edit;
        b[i].ctx = &e[i];
    }
    bench_interleave(b, KINDS, 3);
    for (i = 0; i < KINDS; i++) {
        tetcast_optics_info info;
        tetcast_optics_get_info(e[i].old, &info);
        bench_line("tetcast.edit", "smooth", "edit_seconds", bench_seconds(&b[i]), "s");
        bench_num("best", bench_seconds_best(&b[i]));
        bench_num("error", 0);
        bench_text("error_unit", "entries that differ from a new table (tests)");
        bench_num("bytes", (double)info.table_bytes);
        finish_line(&b[i], kinds[i].name);
        tetcast_optics_destroy(e[i].old);
        tetcast_transfer_destroy(e[i].before);
        tetcast_transfer_destroy(e[i].after);
    }
    table_set("edit", "%.4f (%.0f)", 1e3 * bench_seconds(&b[0]), 1e3 * bench_seconds(&b[1]));
}

/* ---- BM11: plates behind each other ---- */

static double plates_error(const frame *f, uint32_t x, uint32_t y, uint32_t n) {
    tetcast_ray ray;
    double want = 0;
    uint32_t k;
    must(tetcast_camera_ray(&f->d.camera, SIZE, SIZE, x + 0.5, y + 0.5, &ray), "camera");
    for (k = 0; k < n; k++) {
        const double from[3] = {0, 0, (double)k / n}, to[3] = {1, 1, ((double)k + 0.5) / n};
        want += ref_box(ray.org, ray.dir, from, to, 0, 1e30);
    }
    return fabs((double)f->image.length[(size_t)y * SIZE + x] - want);
}

static void bm11(void) {
    static const int layers[] = {1, 5, 20, 50};
    size_t i;
    for (i = 0; i < sizeof layers / sizeof layers[0]; i++) {
        tets t;
        frame *f;
        bench_job b;
        tetcast_mesh *mesh;
        double most = 0;
        size_t wrong = 0;
        uint32_t x, y, n = (uint32_t)layers[i];
        size_t k;
        memset(&t, 0, sizeof t);
        for (k = 0; k < n; k++) { /* each of them a layer of 24 x 24 cubes */
            size_t first = t.nv, v;
            tets_lattice(&t, 25, 25, 2, 6, NULL);
            for (v = first; v < t.nv; v++) {
                t.p[3 * v] = t.p[3 * v] / 24;
                t.p[3 * v + 1] = t.p[3 * v + 1] / 24;
                t.p[3 * v + 2] = ((double)k + 0.5 * t.p[3 * v + 2]) / n;
                t.s[v] = field(t.p + 3 * v);
            }
        }
        mesh = build_mesh(&t, NULL);
        f = new_frame(mesh, NULL, SIZE);
        f->d.camera.eye[0] = 1.1;
        f->d.camera.eye[1] = 0.9;
        f->d.camera.eye[2] = 2.4;
        for (k = 0; k < 3; k++) f->d.camera.at[k] = 0.5;
        f->d.camera.fov_y = 40;
        f->d.traverse_only = 1;
        f->image.length = (float *)must_alloc((size_t)SIZE * SIZE, 4);
        b = frame_job("hit lists", f);
        bench_interleave(&b, 1, 3);
        for (y = 0; y < SIZE; y += 4)
            for (x = 0; x < SIZE; x += 4) {
                const double e = plates_error(f, x, y, n);
                most = fmax(most, e);
                wrong += !(e < 1e-5);
                g_tried++;
            }
        g_failed += wrong;
        {
            char kase[32];
            snprintf(kase, sizeof kase, "%d plates", layers[i]);
            bench_line("tetcast.plates", kase, "frame_seconds", bench_seconds(&b), "s");
        }
        bench_num("error", (double)wrong);
        bench_text("error_unit", "rays");
        bench_num("length_error", most);
        bench_num("walks", (double)f->stats.walks);
        bench_num("steps", (double)f->stats.steps);
        bench_num("steps_per_second", (double)f->stats.steps / bench_seconds(&b));
        finish_line(&b, "hit lists");
        if (n <= 5 || g_opt.full) { /* the thesis' way: each layer is drawn */
            baseline_list list;
            baseline_desc d;
            baseline_stats stats;
            double start = bench_cpu();
            char kase[32];
            memset(&d, 0, sizeof d);
            memset(&stats, 0, sizeof stats);
            if (!baseline_list_make(mesh, &list) ||
                !baseline_picture(&list, &d, &f->d.camera, SIZE, SIZE, NULL, NULL, f->image.length, &stats))
                die("planes", "out of memory");
            start = bench_cpu() - start;
            snprintf(kase, sizeof kase, "%d plates", layers[i]);
            bench_line("tetcast.plates", kase, "frame_seconds", start, "s");
            for (y = 0, wrong = 0; y < SIZE; y += 4)
                for (x = 0; x < SIZE; x += 4) wrong += !(plates_error(f, x, y, n) < 1e-5);
            bench_num("error", (double)wrong);
            bench_text("error_unit", "rays");
            bench_num("layers", (double)stats.layers);
            bench_num("steps", (double)stats.steps);
            bench_text("method", "peeling, planes");
            bench_num("threads", 1);
            bench_end();
            baseline_list_free(&list);
        }
        free_frame(f);
        tetcast_mesh_destroy(mesh);
        tets_free(&t);
    }
}

/* ---- BM12: threads and instruction sets ---- */

static void bm12(void) {
    const int id = get_mesh(MESH_D31K) != NULL ? MESH_D31K : MESH_K32;
    const tetcast_mesh *mesh = get_mesh(id);
    tetcast_optics *o = make_optics(TF_SMOOTH, NULL);
    uint64_t hash = 0;
    int isa, threads;
    for (isa = TETCAST_ISA_SCALAR; isa <= (int)tetcast_isa_best(); isa++) {
        for (threads = 1; threads <= (isa == (int)tetcast_isa_best() ? g_opt.threads : 1); threads *= 2) {
            frame *f;
            bench_job b;
            f = new_frame(mesh, o, SIZE);
            f->d.isa = (tetcast_isa)isa;
            f->d.env.thread_count = (uint32_t)threads;
            b = frame_job("walk", f);
            bench_interleave(&b, 1, 3);
            if (hash == 0) hash = hash_frame(f);
            bench_line("tetcast.threads", g_mesh_name[id], "frame_seconds", bench_median(b.wall, b.rounds), "s");
            bench_num("best", bench_least(b.wall, b.rounds));
            bench_num("error", hash_frame(f) != hash);
            bench_text("error_unit", "pictures that differ");
            bench_text("isa", tetcast_isa_name(f->stats.isa));
            bench_num("threads", threads);
            bench_num("cpu_seconds", bench_seconds(&b));
            bench_num("occupancy", f->stats.lanes != 0 ? (double)f->stats.steps / (double)f->stats.lanes : 1.0);
            bench_hash(hash_frame(f));
            bench_end();
            free_frame(f);
        }
    }
    tetcast_optics_destroy(o);
}

/* ---- BM13: other ways to the same picture ---- */

typedef struct old_walk { frame *f; const baseline_list *list; baseline_desc d; baseline_stats stats; } old_walk;

static void run_old_walk(void *ctx) {
    old_walk *o = (old_walk *)ctx;
    memset(&o->stats, 0, sizeof o->stats);
    if (!baseline_picture(o->list, &o->d, &o->f->d.camera, SIZE, SIZE, o->f->optics, o->f->image.rgba, NULL, &o->stats))
        die("planes", "out of memory");
}

/* One picture by what is ours, by the thesis' and its time's ways as written here, and as others' programs took for
   the same mesh, camera and function on the same kind of machine. */
static void against(int id) {
    static const struct { int id; const char *name; double seconds; } others[] = {
        {MESH_K32, "VTK, Bunyk and tables", 1.0}, {MESH_K32, "VTK, partial pre-integration", 1.38},
        {MESH_K32, "VTK, ZSweep", 4.7}, {MESH_K32, "VTK, projected tetrahedra on llvmpipe", 0.52},
        {MESH_K32, "Open VKL, sampled every 1.5 cells", 0.37},
        {MESH_D31K, "VTK, Bunyk and tables", 1.61}, {MESH_D31K, "VTK, partial pre-integration", 3.45},
        {MESH_D31K, "VTK, ZSweep", 19}, {MESH_D31K, "VTK, projected tetrahedra on llvmpipe", 0.66},
        {MESH_D31K, "Open VKL, sampled every 1.5 cells", 0.97}};
    static const char *const names[5] = {"walk", "projection", "planes, tables of 128^2 x 64",
                                         "projected tetrahedra, by middles", "the same, colours interpolated"};
    const tetcast_mesh *mesh = get_mesh(id);
    tetcast_optics *exact = make_optics(TF_SMOOTH, NULL);
    tetcast_optics_desc d;
    tetcast_check check;
    baseline_list list;
    old_walk planes_walk;
    old_way pt[2];
    frame *f[5];
    bench_job b[5];
    reference r;
    int i, k;
    if (mesh == NULL) {
        tetcast_optics_destroy(exact);
        return;
    }
    memset(&d, 0, sizeof d);
    memset(pt, 0, sizeof pt);
    memset(&planes_walk, 0, sizeof planes_walk);
    must(tetcast_mesh_check(mesh, NULL, &check), "check");
    d.integrator = TETCAST_INTEGRATOR_TABLE_3D;
    d.longest = (float)check.longest_edge;
    for (i = 0; i < 5; i++) {
        f[i] = new_frame(mesh, exact, SIZE);
        b[i] = frame_job(names[i], f[i]);
        f[i]->d.method = i == 1 ? TETCAST_METHOD_PROJECT : TETCAST_METHOD_WALK;
    }
    f[2]->optics = f[2]->own = make_optics(TF_SMOOTH, &d);
    if (!baseline_list_make(mesh, &list)) die("planes", "out of memory");
    planes_walk.f = f[2];
    planes_walk.list = &list;
    b[2].run = run_old_walk;
    b[2].ctx = &planes_walk;
    for (k = 0; k < 2; k++) {
        pt[k].f = f[3 + k];
        pt[k].how.form = k ? PROJECTION_PT_COLORS : PROJECTION_PT;
        pt[k].how.order = PROJECTION_CENTROID;
        pt[k].how.correction = (uint32_t)!k;
        b[3 + k] = old_job(names[3 + k], &pt[k]);
    }
    bench_interleave(b, 5, g_opt.full ? 3 : 1);
    r = make_reference(f[0], get_tets(id), TF_SMOOTH, EVERY);
    for (i = 0; i < 5; i++) {
        difference e = compare(f[i], &r);
        bench_line("tetcast.against", g_mesh_name[id], "frame_seconds", bench_seconds(&b[i]), "s");
        difference_line(&e);
        bench_hash(hash_frame(f[i]));
        finish_line(&b[i], names[i]);
    }
    for (i = 0; i < (int)(sizeof others / sizeof others[0]); i++) {
        if (others[i].id != id) continue;
        bench_line("tetcast.against", g_mesh_name[id], "frame_seconds", others[i].seconds, "s");
        bench_text("method", others[i].name);
        bench_text("source", "measured before, not by this program");
        bench_num("threads", 1);
        bench_end();
    }
    free(r.rgba);
    baseline_list_free(&list);
    for (i = 0; i < 5; i++) free_frame(f[i]);
    tetcast_optics_destroy(exact);
}

static void bm13(void) {
    against(MESH_K32);
    against(MESH_D31K);
}

/* ---- BM14: the thesis' scenes ---- */

static void scene_of(int id, int surface, double thesis) {
    enum { VIEWS = 5 };
    const tetcast_mesh *mesh = get_mesh(id);
    frame *f[VIEWS];
    bench_job b[VIEWS];
    tetcast_optics_desc d;
    tetcast_isovalue iso;
    tetcast_optics *o;
    tetcast_mesh_info info;
    double seconds = 0, steps = 0, diagonal = 0;
    float lo = 0, hi = 1;
    int i;
    if (mesh == NULL) {
        bench_skip("tetcast.scene", g_mesh_name[id], "no data");
        return;
    }
    tetcast_mesh_get_info(mesh, &info);
    (void)tetcast_mesh_field(mesh, 0, &lo, &hi);
    for (i = 0; i < 3; i++) diagonal += (info.box_max[i] - info.box_min[i]) * (info.box_max[i] - info.box_min[i]);
    memset(&d, 0, sizeof d);
    memset(&iso, 0, sizeof iso);
    iso.value = lo + 0.4f * (hi - lo);
    iso.rgb[1] = 1;
    iso.opacity = 1;
    if (surface) d.model = TETCAST_MODEL_ISOSURFACE;
    o = make_optics_range(TF_SMOOTH, lo, hi, sqrt(3.0 / diagonal), &d, &iso, surface ? 1 : 0);
    for (i = 0; i < VIEWS; i++) {
        f[i] = new_frame(mesh, o, SIZE);
        turn_camera(&f[i]->d.camera, mesh, i, VIEWS);
        b[i] = frame_job("walk", f[i]);
    }
    bench_interleave(b, VIEWS, 3);
    for (i = 0; i < VIEWS; i++) {
        seconds += bench_seconds(&b[i]) / VIEWS;
        steps += (double)f[i]->stats.steps / VIEWS;
    }
    bench_line("tetcast.scene", g_mesh_name[id], "frames_per_second", 1 / seconds, "1/s");
    bench_num("error", 0);
    bench_text("error_unit", "not measured here");
    bench_text("variant", surface ? "isosurface" : "volume");
    bench_num("steps", steps);
    bench_num("cells", (double)info.cell_count);
    bench_num("thesis_fps", thesis);
    bench_hash(hash_frame(f[0]));
    finish_line(&b[0], "walk");
    for (i = 0; i < VIEWS; i++) free_frame(f[i]);
    tetcast_optics_destroy(o);
}

static void bm14(void) {
    scene_of(MESH_BLUNT, 0, 3.37);
    scene_of(MESH_L32, 1, 5.13);
    scene_of(MESH_L32, 0, 4.3);
    scene_of(MESH_SPX, 0, 4.0);
}

/* ---- BM15: import and memory ---- */

static double peak_bytes(void) {
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    return 1024.0 * (double)u.ru_maxrss;
}

static void bm15(void) {
    static const int ids[2] = {MESH_D150K, MESH_K55};
    build u[2];
    bench_job b[2];
    int i;
    memset(u, 0, sizeof u);
    memset(b, 0, sizeof b);
    for (i = 0; i < 2; i++) {
        u[i].t = get_tets(ids[i]);
        u[i].d.env.thread_count = 1;
        b[i].name = g_mesh_name[ids[i]];
        b[i].run = run_build;
        b[i].ctx = &u[i];
    }
    bench_interleave(b, 2, 3);
    for (i = 0; i < 2; i++) {
        tetcast_mesh_info info;
        tetcast_report report;
        tetcast_mesh_get_info(u[i].mesh, &info);
        tetcast_mesh_get_report(u[i].mesh, &report);
        bench_line("tetcast.import", b[i].name, "import_seconds", bench_seconds(&b[i]), "s");
        bench_num("best", bench_seconds_best(&b[i]));
        bench_num("error", (double)(u[i].t->nt - info.cell_count));
        bench_text("error_unit", "cells lost");
        bench_num("cells_per_second", (double)info.cell_count / bench_seconds(&b[i]));
        bench_num("bytes", (double)info.total_bytes);
        bench_num("bytes_per_cell", (double)info.total_bytes / (double)info.cell_count);
        bench_num("hull_faces", (double)report.hull_faces);
        bench_num("peak_bytes", peak_bytes());
        bench_text("peer", "VTK");
        bench_num("peer_value", 1.1);
        finish_line(&b[i], "import");
        tetcast_mesh_destroy(u[i].mesh);
    }
    table_set("import", "%.3f (%.3f)", bench_seconds(&b[0]), bench_seconds(&b[1]));
}

/* ---- BM16: rays through vertices, along edges, in faces ---- */

/* Rays through a lattice of n cubes a side in the unit cube, where all is degenerate. */
static void lattice_rays(tetcast_ray *rays, size_t count, uint32_t n, int kind, double tilt) {
    bench_rng r;
    size_t i;
    int k;
    r.state = 99 + (uint64_t)kind;
    for (i = 0; i < count; i++) {
        double at[3], dir[3] = {0, 0, 0};
        for (k = 0; k < 3; k++) at[k] = (double)(float)((double)(bench_random_u32(&r) % (n - 1) + (kind == 3 ? 0 : 1)) / n);
        if (kind == 0) dir[i % 3] = i & 4 ? 1 : -1;             /* along edges */
        else if (kind == 1) for (k = 0; k < 3; k++) dir[k] = i >> k & 1 ? 1 : -1; /* diagonals, through vertices */
        else if (kind == 2) for (k = 0; k < 3; k++) dir[k] = (double)(bench_random_u32(&r) % 7) - 3; /* in faces */
        else for (k = 0; k < 3; k++) dir[k] = (double)bench_random(&r) - 0.5; /* anywhere */
        if (dir[0] == 0 && dir[1] == 0 && dir[2] == 0) dir[0] = 1;
        for (k = 0; k < 3; k++) dir[k] += tilt * ((double)bench_random(&r) - 0.5);
        ref_unit(dir);
        for (k = 0; k < 3; k++) {
            rays[i].dir[k] = dir[k];
            rays[i].org[k] = at[k] - 2 * dir[k];
        }
    }
}

static void cast_failures(const tetcast_mesh *mesh, const char *kase, uint32_t n, int kind, double tilt, size_t count) {
    tetcast_ray *rays = (tetcast_ray *)must_alloc(count, sizeof *rays);
    tetcast_ray_result *got = (tetcast_ray_result *)must_alloc(count, sizeof *got);
    tetcast_render_desc d;
    size_t i, wrong = 0, steps = 0;
    double most = 0, seconds;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    lattice_rays(rays, count, n, kind, tilt);
    seconds = bench_cpu();
    must(tetcast_cast(&d, mesh, NULL, rays, count, got, NULL), "cast");
    seconds = bench_cpu() - seconds;
    for (i = 0; i < count; i++) {
        const double e = length_error((double)got[i].length, rays[i].org, rays[i].dir);
        most = fmax(most, e);
        wrong += !(e < 1e-5);
        steps += got[i].steps;
    }
    bench_line("tetcast.failures", kase, "failed", (double)wrong, "rays");
    bench_num("error", most);
    bench_text("error_unit", "edge of the cube");
    bench_text("method", "signs of edges");
    bench_num("rays", (double)count);
    bench_num("tilt", tilt);
    bench_num("ns_per_step", 1e9 * seconds / (double)steps);
    bench_end();
    g_failed += wrong;
    g_tried += count;
    free(rays);
    free(got);
}

/* The thesis' walk from plane to plane: what it costs, and what it gets wrong. */
static void planes_end(const char *name, size_t rays, const baseline_stats *stats) {
    bench_num("rays", (double)rays);
    bench_num("no_exit", (double)stats->no_exit);
    bench_num("endless", (double)stats->endless);
    bench_text("method", name);
    bench_num("threads", 1);
    bench_end();
}

static void planes(int id, uint32_t n) {
    static const struct { baseline_form form; const char *name; } forms[4] = {
        {BASELINE_VERTEX, "planes, n.(v-e)/n.d"}, {BASELINE_SIGN, "the same, way in by sign"},
        {BASELINE_OFFSET, "planes, (o-n.e)/n.d"}, {BASELINE_EPSILON, "planes, epsilon"}};
    static const char *const kinds[3] = {"along edges", "diagonals", "in planes of vertices"};
    const tetcast_mesh *mesh = get_mesh(id);
    const size_t count = g_opt.full ? 4000 : 300;
    frame *f = new_frame(mesh, NULL, SIZE);
    tetcast_ray *rays = (tetcast_ray *)must_alloc(count, sizeof *rays);
    baseline_list list;
    char kase[64];
    int i, kind;
    f->d.traverse_only = 1;
    f->image.length = (float *)must_alloc((size_t)SIZE * SIZE, 4);
    if (!baseline_list_make(mesh, &list)) die("planes", "out of memory");
    for (i = 0; i < 4; i++) {
        baseline_desc d;
        baseline_stats stats;
        double start, most;
        memset(&d, 0, sizeof d);
        memset(&stats, 0, sizeof stats);
        d.form = forms[i].form;
        d.epsilon = 1e-6f;
        start = bench_cpu();
        if (!baseline_picture(&list, &d, &f->d.camera, SIZE, SIZE, NULL, NULL, f->image.length, &stats))
            die("planes", "out of memory");
        start = bench_cpu() - start;
        snprintf(kase, sizeof kase, "%s, picture", g_mesh_name[id]);
        bench_line("tetcast.planes", kase, "step_seconds", 1e9 * start / (double)stats.steps, "ns");
        bench_num("error", (double)wrong_lengths(f, &most));
        bench_text("error_unit", "rays");
        planes_end(forms[i].name, (size_t)SIZE * SIZE, &stats);
        for (kind = 0; kind < 3; kind++) {
            size_t wrong = 0, k;
            lattice_rays(rays, count, n, kind, 0);
            memset(&stats, 0, sizeof stats);
            for (k = 0; k < count; k++) {
                double length;
                baseline_ray(&list, &d, rays[k].org, rays[k].dir, 1e-6f, &length, &stats);
                wrong += !(length_error(length, rays[k].org, rays[k].dir) < 1e-4);
            }
            snprintf(kase, sizeof kase, "%s, %s", g_mesh_name[id], kinds[kind]);
            bench_line("tetcast.failures", kase, "failed", (double)wrong, "rays");
            bench_num("error", (double)wrong / (double)count);
            bench_text("error_unit", "share of the rays");
            planes_end(forms[i].name, count, &stats);
        }
    }
    free(rays);
    baseline_list_free(&list);
    free_frame(f);
}

static void bm16(void) {
    static const double tilts[] = {0, 1e-3, 1e-5, 1e-8};
    const size_t count = g_opt.full ? 200000 : 20000;
    static const char *const kinds[4] = {"L32, along edges", "L32, diagonals", "L32, in planes of vertices", "L32, anywhere"};
    int i, kind;
    for (kind = 0; kind < 4; kind++)
        for (i = 0; i < (kind < 3 ? 4 : 1); i++) cast_failures(get_mesh(MESH_L32), kinds[kind], 31, kind, tilts[i], count);
    planes(MESH_L32, 31);
}

/* ---- BM17: tolerance against error ---- */

static void tolerances(int id, int tf) {
    static const float asked[] = {0, 0.25f, 0.5f, 1, 2, 4, 8, 16};
    enum { ASKED = sizeof asked / sizeof asked[0] };
    const uint32_t size = g_opt.full ? SIZE : SIZE / 2;
    const tetcast_mesh *mesh = get_mesh(id);
    frame *f[ASKED];
    bench_job b[ASKED];
    reference r;
    int i;
    char kase[64];
    if (mesh == NULL) return;
    for (i = 0; i < ASKED; i++) {
        tetcast_optics_desc d;
        memset(&d, 0, sizeof d);
        d.tolerance = asked[i];
        d.path_length = 1.7321f;
        if (i == 0) d.t_min = -1;
        f[i] = new_frame(mesh, make_optics(tf, &d), size);
        f[i]->own = (tetcast_optics *)(uintptr_t)f[i]->optics;
        b[i] = frame_job(i == 0 ? "exact" : "tolerance", f[i]);
    }
    bench_interleave(b, ASKED, 3);
    r = make_reference(f[0], get_tets(id), tf, EVERY);
    snprintf(kase, sizeof kase, "%s-%s", g_mesh_name[id], g_tf_name[tf]);
    for (i = 0; i < ASKED; i++) {
        difference e = compare(f[i], &r);
        tetcast_optics_info info;
        tetcast_optics_get_info(f[i]->own, &info);
        bench_line("tetcast.tolerance", kase, "frame_seconds", bench_seconds(&b[i]), "s");
        bench_num("best", bench_seconds_best(&b[i]));
        bench_num("error", 255.0 * e.most);
        bench_text("error_unit", "1/255");
        bench_num("tolerance", (double)asked[i]);
        bench_num("bound", (double)info.bound);
        bench_num("rms", 255.0 * e.rms);
        bench_num("psnr", e.psnr);
        bench_num("t_min", (double)info.t_min);
        bench_num("knots", info.knot_count);
        bench_num("steps", (double)f[i]->stats.steps);
        bench_num("times_as_fast", bench_ratio(&b[0], &b[i]));
        finish_line(&b[i], b[i].name);
        if (id == MESH_D31K && tf == TF_TABLE && asked[i] == 8)
            table_set("tolerance", "%.2f (%.2f)", bench_ratio(&b[0], &b[i]), 255.0 * e.most);
        free_frame(f[i]);
    }
    free(r.rgba);
}

static void bm17(void) {
    tolerances(MESH_D31K, TF_TABLE);
    tolerances(MESH_K32, TF_STEP);
    tolerances(MESH_K32, TF_SMOOTH);
    if (g_opt.full) tolerances(MESH_D150K, TF_SMOOTH);
}

#include "bench_tetcast_rbf.h"
#include "bench_tetcast_ways.h"

int main(int argc, char **argv) {
    static const struct { int number; void (*run)(void); } all[] = {
        {1, bm1}, {2, bm2}, {3, bm3}, {4, bm4}, {5, bm5}, {6, bm6}, {7, bm7}, {8, bm8}, {9, bm9}, {10, bm10}, {11, bm11}, {12, bm12},
        {13, bm13}, {14, bm14}, {15, bm15}, {16, bm16}, {17, bm17},
        {21, rbf_evaluations}, {22, rbf_frames}, {24, rbf_encoder}, {27, rbf_traces},
        {40, bm40}, {41, bm41}, {42, bm42}, {43, bm43}, {44, bm44},
        {45, bm45}, {46, bm46}, {47, bm47}, {48, bm48}, {49, bm49}, {50, bm50}, {51, bm51}, {52, bm52}, {53, bm53}, {54, bm54}
    };
    size_t i;
    int status = bench_parse(argc, argv, &g_opt);
    if (status) return status;
    bench_machine("tetcast", argv[0]);
    for (i = 0; i < sizeof all / sizeof all[0]; i++) {
        const double start = bench_wall();
        if (!bench_wanted(&g_opt, all[i].number)) continue;
        all[i].run();
        fprintf(stderr, "BM%d: %.1f s\n", all[i].number, bench_wall() - start);
    }
    if (g_tried != 0) table_set("failed", "%lu of %lu", (unsigned long)g_failed, (unsigned long)g_tried);
    for (i = 0; i < MESH_COUNT; i++) drop_mesh((int)i);
    bench_table_end(&g_table, &g_opt, g_busy_count > 0 ? g_busy_sum / g_busy_count : 0.0, argv[0]);
    return 0;
}
