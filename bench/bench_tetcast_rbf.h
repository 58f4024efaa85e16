/* bench_tetcast_rbf.h - radial basis functions: evaluations, pictures, the encoder, traces - MIT OR Unlicense, see LICENSE

   BM21 evaluations, direct and along rays     BM24 the encoder: bytes, errors, time
   BM22 pictures of functions                  BM27 planes and particles
   Included by bench_tetcast.c. */
#ifndef BENCH_TETCAST_RBF_H
#define BENCH_TETCAST_RBF_H

enum { RBF_MOST = 100000 };

static double rbf_random(uint32_t *h) {
    *h = tetcasti_hash32(*h + 0x9e3779b9u);
    return (double)*h / 4294967296.0;
}

/* count functions in the unit cube; shock: small ones on a bow before a body, as a shock fitted by functions has them. */
static tetcast_rbf *rbf_model(uint32_t count, int shock, double wide, tetcast_kernel kernel, uint32_t components) {
    tetcast_rbf_function *f = (tetcast_rbf_function *)must_alloc(count, sizeof *f);
    tetcast_rbf_desc d;
    tetcast_rbf *m = NULL;
    uint32_t i, k, h = 1234;
    memset(&d, 0, sizeof d);
    for (i = 0; i < count; i++) {
        for (k = 0; k < 3; k++) f[i].centre[k] = rbf_random(&h);
        if (shock) f[i].centre[2] = 0.25 + 0.6 * ((f[i].centre[0] - 0.5) * (f[i].centre[0] - 0.5) +
                                                  (f[i].centre[1] - 0.5) * (f[i].centre[1] - 0.5)) * 2.0 + 0.05 * f[i].centre[2];
        f[i].width = wide * (0.5 + rbf_random(&h));
        for (k = 0; k < components; k++) f[i].weight[k] = (float)(shock ? 0.2 + 0.8 * rbf_random(&h) : 2.0 * rbf_random(&h) - 1.0);
    }
    for (k = 0; k < 3; k++) d.box_max[k] = 1.0;
    d.functions = f;
    d.function_count = count;
    d.components = components;
    d.kernel = kernel;
    must(tetcast_rbf_create(&d, &m), "functions");
    free(f);
    return m;
}

/* ---- BM21 ---- */

typedef struct rbf_sums {
    const tetcast_rbf *m;
    tetcasti_rbf_add_fn *add;
    tetcasti_rbf_packet v;
    tetcasti_rbf_group g;
    float *rows;
    uint32_t repeat, along;
    double work;
} rbf_sums;

static void rbf_run_sums(void *ctx) {
    rbf_sums *s = (rbf_sums *)ctx;
    uint32_t i, k;
    s->work = 0;
    for (k = 0; k < s->repeat; k++) {
        if (!s->along) {
            s->add(s->m, NULL, s->m->count, 0, &s->v);
            s->work += 8.0 * s->m->count;
            continue;
        }
        for (i = 0; i < s->m->count;) { /* as pictures do: some meet first */
            tetcasti_rbf_reach r[TETCASTI_RBF_BATCH];
            uint32_t list[TETCASTI_RBF_BATCH], met = 0, j;
            for (; i < s->m->count && met < TETCASTI_RBF_BATCH; i++) {
                list[met] = i;
#if TETCASTI_AVX2
                if (s->along == 2) met += (uint32_t)tetcasti_rbf_meet8(&s->g, &s->m->record[i], &r[met]);
                else
#endif
                met += (uint32_t)tetcasti_rbf_meet(&s->g, &s->m->record[i], &r[met]);
            }
            for (j = 0; j < met; j++) {
                const tetcasti_rbf_record *f = &s->m->record[list[j]];
                r[j].decay = 0.99f;
#if TETCASTI_AVX2
                if (s->along == 2) tetcasti_rbf_run8(s->m->kernel, 1, &s->g, f, &r[j], s->rows, 0);
                else
#endif
                (tetcasti_has_fma() ? tetcasti_rbf_run_fma : tetcasti_rbf_run_scalar)(s->m->kernel, 1, &s->g, f, &r[j], s->rows, 0);
                s->work += 8.0 * (double)(r[j].last - r[j].first + 1);
            }
        }
    }
}

/* A kernel in doubles, as the records have it. */
static double rbf_exact(tetcast_kernel kernel, const tetcasti_rbf_record *f, double d2) {
    const double x = (double)f->a * d2, g = exp2(x), q = sqrt(-x), u = q < 1 ? 1 - q : 0, v = -x < 1 ? 1 + x : 0;
    switch (kernel) {
    case TETCAST_KERNEL_GAUSS: return g > (double)f->e ? g - (double)f->e : 0;
    case TETCAST_KERNEL_GAUSS_CUT: return g > (double)f->e ? g : 0;
    case TETCAST_KERNEL_WENDLAND2: return pow(u, 4) * (4 * q + 1);
    case TETCAST_KERNEL_WENDLAND4: return pow(u, 6) * ((35 * q + 18) * q + 3) / 3;
    default: return pow(v, 8);
    }
}

/* Largest error of a function by itself at the places of the sums, as a share of its height. */
static double rbf_error(rbf_sums *s) {
    const tetcast_kernel kernel = s->m->kernel;
    double worst = 0;
    uint32_t i, k, l, a;
    for (i = 0; i < s->m->count; i++) {
        const tetcasti_rbf_record *f = &s->m->record[i];
        const double height = (double)f->w[0] * rbf_exact(kernel, f, 0);
        tetcasti_rbf_reach r;
        memset(s->rows, 0, 65 * 8 * sizeof *s->rows);
        if (s->along && tetcasti_rbf_meet(&s->g, f, &r)) {
            r.decay = (float)exp2(2.0 * (double)f->a * (double)s->g.h * (double)s->g.h);
#if TETCASTI_AVX2
            if (s->along == 2) tetcasti_rbf_run8(kernel, 1, &s->g, f, &r, s->rows, 0);
            else
#endif
            (tetcasti_has_fma() ? tetcasti_rbf_run_fma : tetcasti_rbf_run_scalar)(kernel, 1, &s->g, f, &r, s->rows, 0);
        }
        for (k = 0; k < (uint32_t)s->g.n; k++) {
            tetcasti_rbf_packet v;
            memset(&v, 0, sizeof v);
            for (l = 0; l < 8; l++)
                for (a = 0; a < 3; a++) v.p[a][l] = s->g.o[a][l] + (float)k * s->g.h * s->g.d[a][l];
            if (!s->along) s->add(s->m, &i, 1, 0, &v);
            for (l = 0; l < 8; l++) {
                double d2 = 0, g;
                for (a = 0; a < 3; a++) {
                    const double x = (double)v.p[a][l] - (double)f->c[a];
                    d2 += x * x;
                }
                g = exp2((double)f->a * d2);
                if (kernel == TETCAST_KERNEL_GAUSS_CUT && fabs(g - (double)f->e) < 1e-3 * (double)f->e) continue; /* jumps */
                g = (double)(s->along ? s->rows[8 * k + l] : v.sum[0][l]) - (double)f->w[0] * rbf_exact(kernel, f, d2);
                worst = fmax(worst, fabs(g / height));
            }
        }
    }
    return worst;
}

static void rbf_evaluations(void) {
    static const char *const names[] = {"gauss", "gauss-cut", "wendland2", "wendland4", "power"};
    int kernel, along, l;
    for (kernel = 0; kernel < TETCAST_KERNEL_COUNT; kernel++)
        for (along = 0; along < 3; along++) {
            rbf_sums s;
            bench_job b;
            const tetcast_isa isa = along == 1 ? TETCAST_ISA_SCALAR : tetcasti_rbf_isa(TETCAST_ISA_AUTO);
            tetcast_rbf *m = rbf_model(60, 0, 0.2, (tetcast_kernel)kernel, 1);
            memset(&s, 0, sizeof s);
            memset(&b, 0, sizeof b);
            s.m = m;
            s.add = tetcasti_rbf_add_pick(m, isa);
            s.along = along == 0 ? 0u : along == 1 ? 1u : isa >= TETCAST_ISA_AVX2 ? 2u : 1u;
            s.repeat = along == 1 ? 2000 : 20000;
            s.g.n = 64;
            s.g.h = 1.0f / 64.0f;
            s.g.per = 64.0f;
            s.rows = (float *)must_alloc(65 * 8, sizeof(float));
            for (l = 0; l < 8; l++) {
                s.v.p[0][l] = s.g.o[0][l] = 0.5f + 0.01f * (float)l;
                s.v.p[1][l] = s.g.o[1][l] = 0.45f;
                s.v.p[2][l] = 0.4f;
                s.g.d[2][l] = 1.0f;
            }
            b.name = names[kernel];
            b.run = rbf_run_sums;
            b.ctx = &s;
            bench_interleave(&b, 1, ROUNDS);
            bench_line("tetcast.rbf_evaluations", names[kernel], "evaluations_per_second", bench_rate(&b, s.work), "1/s");
            bench_num("best", bench_rate_best(&b, s.work));
            bench_num("error", rbf_error(&s));
            bench_text("error_unit", "share of the height");
            bench_text("isa", tetcast_isa_name(isa));
            finish_line(&b, along ? "along rays" : "direct");
            if (kernel == 0 && along == 0) table_set("rbf_direct", "%.2f", 1e-9 * bench_rate(&b, s.work));
            if (kernel == 0 && along == 2) table_set("rbf_rays", "%.2f", 1e-9 * bench_rate(&b, s.work));
            free(s.rows);
            tetcast_rbf_destroy(m);
        }
}

/* ---- BM22 ---- */

typedef struct rbf_frame {
    tetcast_rbf_render_desc d;
    tetcast_image image;
    const tetcast_rbf *m;
    const tetcast_optics *o;
    tetcast_rbf_render_stats stats;
} rbf_frame;

static void rbf_run_frame(void *ctx) {
    rbf_frame *f = (rbf_frame *)ctx;
    memset(&f->stats, 0, sizeof f->stats);
    must(tetcast_rbf_render(&f->d, f->m, f->o, &f->image, &f->stats), "render");
}

static void rbf_frames(void) {
    static const struct { uint32_t count; int shock; double wide; uint32_t size, samples; const char *name; } all[] = {
        {1173, 1, 0.03, 400, 64, "shock-1173"}, {141, 0, 0.06, 400, 64, "few-141"}, {435, 0, 0.06, 400, 32, "dense-435"},
        {5703, 1, 0.02, 400, 64, "shock-5703"}, {RBF_MOST, 0, 0.004, 400, 64, "small-100000"}};
    static const tetcast_control_point points[] = {{0.1f, {0, 0.2f, 1}, 0}, {0.5f, {0.3f, 1, 0.3f}, 4.0f}, {1.5f, {1, 0.2f, 0}, 20.0f}};
    tetcast_transfer_desc td;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    size_t i, k, c;
    memset(&td, 0, sizeof td);
    td.points = points;
    td.point_count = 3;
    must(tetcast_transfer_create(&td, &t), "transfer");
    must(tetcast_optics_create(t, NULL, &o), "optics");
    for (i = 0; i < (g_opt.full ? sizeof all / sizeof all[0] : 3); i++) {
        tetcast_rbf *m = rbf_model(all[i].count, all[i].shock, all[i].wide, TETCAST_KERNEL_GAUSS, 1);
        rbf_frame f, exact;
        bench_job b;
        double most = 0.0;
        const size_t pixels = (size_t)all[i].size * all[i].size;
        memset(&f, 0, sizeof f);
        memset(&b, 0, sizeof b);
        f.m = m;
        f.o = o;
        f.d.env.thread_count = 1;
        f.d.step = (float)(1.0 / all[i].samples);
        f.image.width = f.image.height = all[i].size;
        f.image.rgba = (float *)must_alloc(pixels, 16);
        b.name = all[i].name;
        b.run = rbf_run_frame;
        b.ctx = &f;
        bench_interleave(&b, 1, ROUNDS);
        exact = f; /* the same samples, each by its cell */
        exact.d.gather = 1;
        exact.image.rgba = (float *)must_alloc(pixels, 16);
        rbf_run_frame(&exact);
        for (k = 0; k < pixels; k++)
            for (c = 0; c < 4; c++) most = fmax(most, fabs((double)f.image.rgba[4 * k + c] - (double)exact.image.rgba[4 * k + c]));
        bench_line("tetcast.rbf_frame", all[i].name, "frames_per_second", 1.0 / bench_seconds(&b), "1/s");
        bench_num("best", 1.0 / bench_seconds_best(&b));
        bench_num("error", 255.0 * most);
        bench_text("error_unit", "1/255");
        bench_num("functions", all[i].count);
        bench_num("samples", (double)f.stats.samples);
        bench_num("evaluations", (double)f.stats.evaluations);
        bench_num("evaluations_per_second", (double)f.stats.evaluations / bench_seconds(&b));
        bench_hash(bench_hash_bytes(f.image.rgba, pixels * 16));
        finish_line(&b, "tiles");
        if (i == 0) table_set("rbf_frames", "%.1f (%.3f)", 1.0 / bench_seconds(&b), 255.0 * most);
        free(f.image.rgba);
        free(exact.image.rgba);
        tetcast_rbf_destroy(m);
    }
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
}

/* ---- BM24 ---- */

/* R. Crawfis' tornado on n^3 points. */
static float *rbf_tornado(uint32_t n) {
    float *out = (float *)must_alloc((size_t)n * n * n, 12), *p = out;
    size_t i;
    for (i = 0; i < (size_t)n * n * n; i++, p += 3) {
        const double x = (double)(i % n) / (n - 1), y = (double)(i / n % n) / (n - 1), z = (double)(i / n / n) / (n - 1);
        const double xc = 0.5 + 0.1 * sin(10 * z), yc = 0.5 + 0.1 * cos(3 * z), r = 0.1 + 0.4 * z * z + 0.1 * z * sin(8 * z);
        double t = sqrt((x - xc) * (x - xc) + (y - yc) * (y - yc)), s = fabs(r - t), up = fmax(0.0, 0.1 * (0.1 - t * z));
        s = s > 0.2 + 0.1 * z ? 0.8 - s : 1.0;
        t = sqrt(t * t + up * up);
        s = (r + 0.2 + 0.1 * z - t) * s / ((t + 1e-11) * (1 + z));
        p[0] = (float)(s * (y - yc) + 0.1 * (x - xc));
        p[1] = (float)(0.1 * (y - yc) - s * (x - xc));
        p[2] = (float)(s * up);
    }
    return out;
}

typedef struct rbf_encode {
    tetcast_rbf_fit_desc d;
    tetcast_rbf_points p;
    tetcast_rbf_report report;
    tetcast_rbf *m;
} rbf_encode;

static void rbf_run_encode(void *ctx) {
    rbf_encode *e = (rbf_encode *)ctx;
    tetcast_rbf_destroy(e->m);
    must(tetcast_rbf_fit(&e->d, &e->p, &e->report, &e->m), "fit");
}

static void rbf_encoder(void) {
    static const float asked[] = {0.0682f, 0.1f, 0.05f, 0.02f};
    float *v = rbf_tornado(32);
    int i, method;
    for (i = 0; i < (g_opt.full ? 4 : 1); i++)
        for (method = 0; method < 2; method++) {
            rbf_encode e;
            bench_job b;
            char kase[32];
            memset(&e, 0, sizeof e);
            memset(&b, 0, sizeof b);
            e.p.values.data = v;
            e.p.components = 3;
            e.p.dims[0] = e.p.dims[1] = e.p.dims[2] = 32;
            e.p.count = 32768;
            e.d.max_error = asked[i];
            e.d.mean_error = i == 0 ? 0.0182f : 0.0f;
            e.d.method = (tetcast_rbf_method)method;
            e.d.env.thread_count = 1;
            e.d.compare = 1;
            b.name = method ? "pure" : "hybrid";
            b.run = rbf_run_encode;
            b.ctx = &e;
            bench_interleave(&b, 1, 1);
            (void)snprintf(kase, sizeof kase, "tornado-32-%.4g", (double)asked[i]);
            bench_line("tetcast.rbf_fit", kase, "bytes", (double)e.report.bytes, "B");
            bench_num("error", e.report.max_error);
            bench_text("error_unit", "share of the range, at most");
            bench_num("mean_error", e.report.mean_error);
            bench_num("between_max", e.report.between_max);
            bench_num("between_mean", e.report.between_mean);
            bench_num("functions", e.report.functions);
            bench_num("grid_bytes", (double)e.report.grid_bytes);
            bench_num("seconds", bench_seconds(&b));
            bench_num("us_per_point", 1e6 * bench_seconds(&b) / 32768.0);
            finish_line(&b, b.name);
            if (i == 0 && method == 0)
                table_set("rbf_fit", "%.1f in %.2f s (%.2f %%, %.2f %%)", 1e-3 * (double)e.report.bytes, bench_seconds(&b),
                          100.0 * e.report.mean_error, 100.0 * e.report.max_error);
            tetcast_rbf_destroy(e.m);
        }
    free(v);
    { /* the thesis' encoder, and ours for the same points */
        const uint32_t n = g_opt.full ? 32 : 12;
        double (*p)[3] = (double (*)[3])must_alloc((size_t)n * n * n, 24), *w = (double *)must_alloc((size_t)n * n * n, 24), s;
        double range = 0.0;
        steps_desc d;
        steps_model m;
        char kase[32];
        size_t k;
        v = rbf_tornado(n);
        for (k = 0; k < (size_t)n * n * n; k++) {
            p[k][0] = (double)(k % n);
            p[k][1] = (double)(k / n % n);
            p[k][2] = (double)(k / n / n);
            for (i = 0; i < 3; i++) w[3 * k + (size_t)i] = (double)v[3 * k + (size_t)i];
            range = fmax(range, sqrt(w[3 * k] * w[3 * k] + w[3 * k + 1] * w[3 * k + 1] + w[3 * k + 2] * w[3 * k + 2]));
        }
        memset(&d, 0, sizeof d);
        d.max_error = 0.0682 * range;
        d.mean_error = 0.0182 * range;
        d.leaf = n > 12 ? 2048 : 0;
        d.overlap = 0.15;
        d.rounds = 40;
        d.cut = 4.0;
        (void)snprintf(kase, sizeof kase, "tornado-%u-0.0682", n);
        s = bench_cpu();
        if (steps_run(&d, (const double (*)[3])p, w, (size_t)n * n * n, 3, &m)) {
            s = bench_cpu() - s;
            bench_line("tetcast.rbf_fit", kase, "bytes", (double)steps_bytes(&m), "B");
            bench_num("error", m.max_error / range);
            bench_text("error_unit", "share of the range, at most");
            bench_num("mean_error", m.mean_error / range);
            bench_num("functions", (double)m.count);
            bench_num("domains", m.leaves);
            bench_num("rounds", m.rounds);
            bench_num("seconds", s);
            bench_text("method", "thesis");
            bench_num("threads", 1);
            bench_end();
            steps_model_free(&m);
        }
        free(p);
        free(w);
        free(v);
    }
}

/* ---- BM27 ---- */

typedef struct rbf_moves {
    tetcast_rbf_trace_desc d;
    const tetcast_rbf *m;
    double *seeds, *paths;
    uint32_t count, *lengths;
} rbf_moves;

static void rbf_run_moves(void *ctx) {
    rbf_moves *t = (rbf_moves *)ctx;
    must(tetcast_rbf_trace(&t->d, t->m, t->seeds, t->count, t->paths, t->lengths, NULL), "trace");
}

static void rbf_traces(void) {
    enum { PARTICLES = 400, STEPS = 400 };
    float *v = rbf_tornado(32);
    rbf_encode e;
    rbf_moves t;
    bench_job b[2];
    double steps = 0.0;
    uint32_t i, h = 5;
    memset(&e, 0, sizeof e);
    memset(&t, 0, sizeof t);
    memset(b, 0, sizeof b);
    e.p.values.data = v;
    e.p.components = 3;
    e.p.dims[0] = e.p.dims[1] = e.p.dims[2] = 32;
    e.p.count = 32768;
    e.d.max_error = 0.0682f;
    rbf_run_encode(&e);
    t.m = e.m;
    t.d.env.thread_count = 1;
    t.d.steps = STEPS;
    t.d.dt = 0.5;
    t.count = PARTICLES;
    t.seeds = (double *)must_alloc(PARTICLES, 24);
    t.paths = (double *)must_alloc((size_t)PARTICLES * (STEPS + 1), 24);
    t.lengths = (uint32_t *)must_alloc(PARTICLES, 4);
    for (i = 0; i < 3 * PARTICLES; i++) t.seeds[i] = 31.0 * rbf_random(&h);
    for (i = 0; i < 2; i++) {
        uint32_t k;
        t.d.stepper = i ? TETCAST_STEPPER_EULER : TETCAST_STEPPER_RK4;
        b[i].name = i ? "euler" : "rk4";
        b[i].run = rbf_run_moves;
        b[i].ctx = &t;
        bench_interleave(&b[i], 1, 3);
        for (k = 0, steps = 0.0; k < PARTICLES; k++) steps += t.lengths[k] - 1;
        bench_line("tetcast.rbf_trace", "tornado-32", "steps_per_second", bench_rate(&b[i], steps), "1/s");
        bench_num("best", bench_rate_best(&b[i], steps));
        bench_num("error", e.report.max_error);
        bench_text("error_unit", "share of the greatest speed");
        bench_num("functions", e.report.functions);
        finish_line(&b[i], b[i].name);
    }
    free(t.seeds);
    free(t.paths);
    free(t.lengths);
    free(v);
    tetcast_rbf_destroy(e.m);
}

#endif
