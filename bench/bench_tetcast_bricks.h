/* bench_tetcast_bricks.h - resampling, bricks, codecs: rows BM40 to BM43 of bench_tetcast.c - MIT OR Unlicense, see LICENSE
   BM40 resampling   BM41 samples of bricks   BM42 borders and frames with level of detail   BM43 colour cells
   BM44 cells of locally refined grids */
#ifndef BENCH_TETCAST_BRICKS_H
#define BENCH_TETCAST_BRICKS_H

/* CPU seconds of the fastest of `times` runs. */
static double fastest(void (*run)(void *), void *ctx, int times) {
    double best = 1e30;
    int i;
    for (i = 0; i < times; i++) {
        const double start = bench_cpu();
        run(ctx);
        if (bench_cpu() - start < best) best = bench_cpu() - start;
    }
    return best;
}

typedef struct scan_job {
    tetcast_resample_desc d;
    const tetcast_mesh *mesh;
    tetcast_lattice l;
    float *out;
    tetcast_resample_stats stats;
} scan_job;

/* What writing the nodes takes by itself. */
static void run_fill(void *ctx) {
    scan_job *j = (scan_job *)ctx;
    size_t i, n = (size_t)j->l.dims[0] * j->l.dims[1] * j->l.dims[2];
    for (i = 0; i < n; i++) j->out[i] = NAN;
}

static void run_scan(void *ctx) {
    scan_job *j = (scan_job *)ctx;
    must(tetcast_resample(&j->d, j->mesh, &j->l, j->out, NULL), "resample");
}

static void scan_of(int id, const char *row, const uint32_t dims[3], double thesis) {
    static const char *const axis[4] = {"default: x as a rule", "x", "y", "z"};
    const tetcast_mesh *mesh = get_mesh(id);
    tetcast_mesh_info info;
    scan_job j;
    char kase[64];
    size_t n = (size_t)dims[0] * dims[1] * dims[2];
    uint32_t k;
    if (mesh == NULL) return;
    memset(&j, 0, sizeof j);
    tetcast_mesh_get_info(mesh, &info);
    j.mesh = mesh;
    j.d.env.thread_count = 1;
    j.out = (float *)must_alloc(n, 4);
    for (k = 0; k < 3; k++) {
        j.l.dims[k] = dims[k];
        j.l.origin[k] = info.box_min[k];
        j.l.spacing[k] = (info.box_max[k] - info.box_min[k]) / (dims[k] - 1);
    }
    snprintf(kase, sizeof kase, "%s-%ux%ux%u", g_mesh_name[id], dims[0], dims[1], dims[2]);
    for (k = 0; k < 5; k++) {
        double s;
        if (k > 0 && !g_opt.full && n > 20000000) break;
        j.d.axis = k < 4 ? k : 0;
        j.d.isa = k < 4 ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        s = fastest(run_scan, &j, k == 0 ? 5 : 2);
        memset(&j.stats, 0, sizeof j.stats);
        must(tetcast_resample(&j.d, mesh, &j.l, j.out, &j.stats), "resample");
        bench_line("tetcast.resample", kase, "seconds", s, "s");
        bench_num("error", 0);
        bench_text("error_unit", "nodes lost");
        bench_num("nodes_per_second", (double)n / s);
        bench_num("covered", (double)j.stats.covered);
        bench_num("rows", (double)j.stats.rows);
        bench_num("hit_rows", (double)j.stats.hit_rows);
        bench_num("writes", (double)j.stats.writes);
        bench_num("thesis_seconds", thesis);
        if (k == 0) bench_num("fill_seconds", fastest(run_fill, &j, 3));
        bench_text("axis", axis[k < 4 ? k : 0]);
        bench_text("isa", k < 4 ? "auto" : "scalar");
        bench_num("threads", 1);
        bench_end();
        if (k == 0 && row != NULL) table_set(row, "%.0f", 1e3 * s);
    }
    if (n <= 300000 || g_opt.full) { /* the thesis' other two ways, slice by slice */
        static const char *const ways[2] = {"slices, masked", "slices, sections"};
        float *theirs = (float *)must_alloc(n, 4);
        size_t i;
        j.d.isa = TETCAST_ISA_AUTO;
        must(tetcast_resample(&j.d, mesh, &j.l, j.out, NULL), "resample");
        for (k = 0; k < 2; k++) {
            slices_stats st;
            double s = bench_cpu(), differ = 0;
            if (!slices_resample(mesh, &j.l, (slices_method)k, theirs, &st)) continue;
            s = bench_cpu() - s;
            for (i = 0; i < n; i++) differ += (theirs[i] == theirs[i]) != (j.out[i] == j.out[i]);
            bench_line("tetcast.resample", kase, "seconds", s, "s");
            bench_num("error", differ);
            bench_text("error_unit", "nodes lost");
            bench_num("nodes_per_second", (double)n / s);
            bench_num("pieces", (double)st.pieces);
            bench_num("scanned", (double)st.scanned);
            bench_num("writes", (double)st.written);
            bench_text("axis", ways[k]);
            bench_text("isa", "scalar");
            bench_num("threads", 1);
            bench_end();
        }
        free(theirs);
    }
    free(j.out);
}

static void bm40(void) {
    static const uint32_t sizes[3][3] = {{128, 64, 32}, {256, 128, 64}, {512, 256, 128}}, cube[3] = {512, 512, 512};
    scan_of(MESH_BLUNT, NULL, sizes[0], 0.41);
    scan_of(MESH_BLUNT, NULL, sizes[1], 0.84);
    scan_of(MESH_BLUNT, "resample", sizes[2], 1.67);
    scan_of(MESH_D31K, "resample-512", cube, 20.93);
}

/* ---- bricks of a head: a skull, its inside, noise ---- */

static float head(uint32_t n, uint32_t i, uint32_t j, uint32_t k) {
    const double x = 2.0 * i / (n - 1) - 1, y = 2.0 * j / (n - 1) - 1, z = 2.0 * k / (n - 1) - 1;
    const double r = sqrt(x * x * 1.5 + y * y * 1.2 + z * z), fold = sin(14 * x + 3 * sin(9 * y)) * sin(11 * z + 2 * x);
    if (r > 0.93) return 0.0f;
    if (r > 0.86) return (float)(0.45 * (0.93 - r) / 0.07);
    if (r > 0.8) return 0.9f;
    return (float)(0.5 + 0.12 * fold);
}

static tetcast_bricks *head_bricks(uint32_t n, tetcast_type type) {
    tetcast_bricks_desc d;
    tetcast_lattice l;
    tetcast_array a;
    tetcast_bricks *b = NULL;
    float *v = (float *)must_alloc((size_t)n * n * n, 4);
    uint32_t i, j, k;
    for (k = 0; k < n; k++)
        for (j = 0; j < n; j++)
            for (i = 0; i < n; i++) v[i + (size_t)n * (j + (size_t)n * k)] = head(n, i, j, k);
    memset(&d, 0, sizeof d);
    memset(&l, 0, sizeof l);
    memset(&a, 0, sizeof a);
    for (i = 0; i < 3; i++) {
        l.dims[i] = n;
        l.spacing[i] = 1.0 / (n - 1);
    }
    a.data = v;
    d.env.thread_count = 1;
    d.storage = type;
    must(tetcast_bricks_create_grid(&d, &l, &a, NULL, &b), "bricks");
    free(v);
    return b;
}

typedef struct sample_job {
    const tetcast_cut *cut;
    float *x, *y, *z, *out;
    size_t n;
    tetcast_isa isa;
} sample_job;

static void run_samples(void *ctx) {
    sample_job *j = (sample_job *)ctx;
    tetcast_cut_sample(j->cut, j->x, j->y, j->z, j->n, j->isa, j->out);
}

static void bm41(void) {
    static const tetcast_type types[4] = {TETCAST_TYPE_F32, TETCAST_TYPE_F16, TETCAST_TYPE_U16, TETCAST_TYPE_U8};
    static const char *const names[4] = {"f32", "f16", "u16", "u8"};
    enum { N = 1 << 16, SIDE = 257 };
    int t, coherent;
    for (t = 0; t < 4; t++) {
        tetcast_bricks *b = head_bricks(SIDE, types[t]);
        tetcast_cut *cut = NULL;
        tetcast_bricks_info info;
        sample_job j;
        size_t i;
        must(tetcast_cut_create(NULL, b, &cut), "cut");
        tetcast_bricks_get_info(b, &info);
        j.cut = cut;
        j.n = N;
        j.x = (float *)must_alloc(N, 4);
        j.y = (float *)must_alloc(N, 4);
        j.z = (float *)must_alloc(N, 4);
        j.out = (float *)must_alloc(N, 4);
        for (coherent = 1; coherent >= 0; coherent--) {
            double s, worst = 0;
            test_rng r = test_rng_make(1);
            for (i = 0; i < N; i++) { /* packets of eight rays, half a cell apart; or anywhere */
                const float at = (float)(i / 8 % 256);
                j.x[i] = coherent ? 10 + 0.55f * at + 0.5f * (float)(i % 8) : 256 * test_rng_float(&r);
                j.y[i] = coherent ? 10 + 0.6f * (float)(i / 2048) + 0.32f * at : 256 * test_rng_float(&r);
                j.z[i] = coherent ? 1 + 0.77f * at : 256 * test_rng_float(&r);
            }
            j.isa = TETCAST_ISA_AUTO;
            s = fastest(run_samples, &j, 30);
            for (i = 0; i < 256; i++) { /* at nodes the field itself */
                const float x = (float)i, y = (float)(255 - i), z = (float)(i * 7 % 256);
                float v;
                tetcast_cut_sample(cut, &x, &y, &z, 1, TETCAST_ISA_SCALAR, &v);
                v = fabsf(v - head(SIDE, (uint32_t)i, 255 - (uint32_t)i, (uint32_t)(i * 7 % 256)));
                worst = (double)v > worst ? (double)v : worst;
            }
            bench_line("tetcast.brick_samples", coherent ? "rays" : "random", "samples_per_second", N / s, "1/s");
            bench_num("error", worst);
            bench_text("error_unit", "of the range");
            bench_text("storage", names[t]);
            bench_num("bytes", (double)info.bytes);
            bench_num("threads", 1);
            bench_end();
            if (coherent && t == 0) table_set("brick-samples", "%.0f", 1e-6 * N / s);
        }
        free(j.x);
        free(j.y);
        free(j.z);
        free(j.out);
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(b);
    }
}

/* ---- borders, frames ---- */

typedef struct cut_job {
    tetcast_cut_desc d;
    const tetcast_bricks *b;
    tetcast_cut *cut;
} cut_job;

static void run_cut(void *ctx) {
    cut_job *j = (cut_job *)ctx;
    tetcast_cut_destroy(j->cut);
    must(tetcast_cut_create(&j->d, j->b, &j->cut), "cut");
}

typedef struct brick_frame {
    tetcast_brick_render_desc d;
    const tetcast_cut *cut;
    const tetcast_optics *optics;
    tetcast_image image;
    tetcast_render_stats stats;
} brick_frame;

static void run_brick_frame(void *ctx) {
    brick_frame *f = (brick_frame *)ctx;
    memset(&f->stats, 0, sizeof f->stats);
    must(tetcast_render_bricks(&f->d, f->cut, f->optics, &f->image, &f->stats), "bricks");
}

static void bm42(void) {
    static const tetcast_control_point points[] = {{0.02f, {0, 0, 0}, 0},          {0.1f, {0.8f, 0.5f, 0.4f}, 4},
                                                   {0.4f, {0.8f, 0.5f, 0.4f}, 2},  {0.6f, {0.9f, 0.7f, 0.6f}, 8},
                                                   {0.8f, {1, 1, 0.9f}, 60}};
    static const char *const names[4] = {"full", "half", "quarter", "focus"};
    enum { SIDE = 257 };
    tetcast_bricks *b = head_bricks(SIDE, TETCAST_TYPE_F32);
    tetcast_transfer_desc td;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    tetcast_cut_info full;
    float *reference = (float *)must_alloc((size_t)SIZE * SIZE, 16);
    int i;
    memset(&td, 0, sizeof td);
    td.points = points;
    td.point_count = 5;
    must(tetcast_transfer_create(&td, &t), "transfer");
    must(tetcast_optics_create(t, NULL, &o), "optics");
    memset(&full, 0, sizeof full);
    for (i = 0; i < 4; i++) {
        cut_job j;
        brick_frame f;
        tetcast_cut_info info;
        double cut_s, frame_s, sum = 0;
        size_t k;
        memset(&j, 0, sizeof j);
        memset(&f, 0, sizeof f);
        j.b = b;
        j.d.env.thread_count = 1;
        if (i == 1) j.d.byte_budget = full.full_bytes / 2;
        if (i == 2) j.d.byte_budget = full.full_bytes / 4;
        if (i == 3) {
            j.d.focus[0] = 0.5;
            j.d.focus[2] = 0.8;
            j.d.focus_radius = 0.25;
            j.d.max_jump = 1;
        }
        cut_s = fastest(run_cut, &j, 5);
        tetcast_cut_get_info(j.cut, &info);
        if (i == 0) full = info;
        f.d.env.thread_count = 1;
        f.cut = j.cut;
        f.optics = o;
        f.image.width = f.image.height = SIZE;
        f.image.rgba = (float *)must_alloc((size_t)SIZE * SIZE, 16);
        frame_s = fastest(run_brick_frame, &f, 3);
        if (i == 0) memcpy(reference, f.image.rgba, (size_t)SIZE * SIZE * 16);
        for (k = 0; k < (size_t)SIZE * SIZE * 4; k++) {
            const double e = (double)reference[k] - (double)f.image.rgba[k];
            sum += e * e;
        }
        bench_line("tetcast.bricks", names[i], "frame_seconds", frame_s, "s");
        bench_num("error", 255 * sqrt(sum / ((double)SIZE * SIZE * 4)));
        bench_text("error_unit", "1/255 rms to the finest level");
        bench_num("cut_seconds", cut_s);
        bench_num("bricks", (double)info.bricks);
        bench_num("adapted", (double)info.adapted);
        bench_num("bytes", (double)info.bytes);
        bench_num("byte_share", (double)info.bytes / (double)info.full_bytes);
        bench_num("sample_share", info.samples);
        bench_num("samples", (double)f.stats.steps);
        bench_num("slots", (double)f.stats.walks);
        bench_num("lane_share", f.stats.lanes != 0 ? (double)f.stats.steps / (double)f.stats.lanes : 1.0);
        bench_num("threads", 1);
        bench_end();
        if (i == 1) table_set("bricks-half", "%.0f", 1e3 * frame_s);
        if (i == 0) table_set("bricks-full", "%.0f", 1e3 * frame_s);
        if (i == 3) table_set("borders", "%.1f (%lu)", 1e3 * cut_s, (unsigned long)info.adapted);
        free(f.image.rgba);
        tetcast_cut_destroy(j.cut);
    }
    free(reference);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
    tetcast_bricks_destroy(b);
}

/* ---- cells of locally refined grids ---- */

static void bm44(void) {
    static const char *const names[5] = {"octant", "basis", "current", "nearest", "gti"};
    enum { POINTS = 20000, PAIRS = 20000 };
    tetcast_amr_desc d;
    tetcast_amr *amr = NULL;
    tetcast_patch *patches;
    float *values, *out = (float *)must_alloc(POINTS, 4);
    double (*p)[3] = (double (*)[3])must_alloc(POINTS, 24);
    size_t count = 0, i;
    int method, a;
    if (sup_blast_patches(4, 16, &patches, &count, &values)) return;
    memset(&d, 0, sizeof d);
    d.patches = patches;
    d.patch_count = count;
    for (a = 0; a < 3; a++) {
        d.cells[a] = 16;
        d.spacing[a] = 1.0 / 16.0;
    }
    must(tetcast_amr_create(&d, &amr), "amr");
    for (method = 0; method < 5; method++) {
        double start, s = 1e30, jump = 0, off = 0;
        int k;
        test_rng r = test_rng_make(4);
        for (i = 0; i < POINTS; i++) for (a = 0; a < 3; a++) p[i][a] = test_rng_double(&r);
        for (k = 0; k < 3; k++) {
            start = bench_cpu();
            must(tetcast_amr_sample(amr, (tetcast_amr_method)method, (const double (*)[3])p, POINTS, out), "sample");
            if (bench_cpu() - start < s) s = bench_cpu() - start;
        }
        for (i = 0; i < POINTS; i++) off += fabs((double)out[i] - sup_blast(p[i][0], p[i][1], p[i][2])) / POINTS;
        for (i = 0; i < PAIRS; i += 2) { /* both sides of faces of finest cells */
            a = (int)(i / 2 % 3);
            p[i][a] = (double)(test_rng_u32(&r) % 128) / 128.0;
            memcpy(p[i + 1], p[i], sizeof p[i]);
            p[i][a] -= 1e-9;
            p[i + 1][a] += 1e-9;
        }
        must(tetcast_amr_sample(amr, (tetcast_amr_method)method, (const double (*)[3])p, PAIRS, out), "sample");
        for (i = 0; i < PAIRS; i += 2) jump = fmax(jump, fabs((double)out[i] - (double)out[i + 1]) / 4.0);
        bench_line("tetcast.amr", names[method], "samples_per_second", POINTS / s, "1/s");
        bench_num("error", jump);
        bench_text("error_unit", "of the range, largest jump");
        bench_num("mean_error", off / 4.0);
        bench_num("patches", (double)count);
        bench_num("threads", 1);
        bench_end();
    }
    tetcast_amr_destroy(amr);
    SUP_FREE(patches);
    SUP_FREE(values);
    free(p);
    free(out);
}

/* ---- codecs ---- */

typedef struct codec_job { uint8_t *rgba, *code, *back; size_t size; } codec_job;

static void run_encode(void *ctx) { codec_job *j = (codec_job *)ctx; tetcast_ccc_encode(j->rgba, 512, 512, 0, 0, j->code); }
static void run_fitted(void *ctx) { codec_job *j = (codec_job *)ctx; tetcast_ccc_encode_fitted(j->rgba, 512, 512, 0, 0, j->code); }
static void run_decode(void *ctx) { codec_job *j = (codec_job *)ctx; tetcast_ccc_decode(j->code, 512, 512, 0, 0, j->back); }
static void run_pack(void *ctx) { codec_job *j = (codec_job *)ctx; j->size = tetcast_pack(j->rgba, 512, 512, 0, j->code); }

static void bm43(void) {
    codec_job j;
    double encode, decode, pack, sum = 0;
    size_t i;
    j.rgba = (uint8_t *)must_alloc(512 * 512, 4);
    j.back = (uint8_t *)must_alloc(512 * 512, 4);
    j.code = (uint8_t *)must_alloc(tetcast_pack_bound(512, 512), 1);
    for (i = 0; i < 512 * 512; i++) {
        const double x = (double)(i % 512) - 256, y = (double)(i / 512) - 256, r = sqrt(x * x + y * y) / 256;
        const double a = r < 0.9 ? exp(-4 * r * r) * (1 + 0.3 * sin(x * 0.11) * cos(y * 0.07)) : 0;
        j.rgba[4 * i] = (uint8_t)(a < 1 ? 255 * a : 255);
        j.rgba[4 * i + 1] = (uint8_t)(a < 1 ? 200 * a * a : 200);
        j.rgba[4 * i + 2] = (uint8_t)(sqrt(a) * 0.7 < 1 ? 255 * sqrt(a) * 0.7 : 255);
        j.rgba[4 * i + 3] = 255;
    }
    pack = fastest(run_pack, &j, 20);
    encode = fastest(run_encode, &j, 20);
    decode = fastest(run_decode, &j, 20);
    for (i = 0; i < 4 * 512 * 512; i++) {
        const double e = (double)j.rgba[i] - (double)j.back[i];
        sum += e * e;
    }
    bench_line("tetcast.codec", "cells-512", "encode_seconds", encode, "s");
    bench_num("error", 10 * log10(255.0 * 255.0 / (sum / (3.0 * 512 * 512) + 1e-9)));
    bench_text("error_unit", "dB");
    bench_num("decode_seconds", decode);
    bench_num("bytes", (double)tetcast_ccc_size(512, 512, 0));
    bench_num("threads", 1);
    bench_end();
    table_set("codec", "%.2f / %.3f", 1e3 * encode, 1e3 * decode);
    encode = fastest(run_fitted, &j, 5);
    run_decode(&j);
    for (i = 0, sum = 0; i < 4 * 512 * 512; i++) {
        const double e = (double)j.rgba[i] - (double)j.back[i];
        sum += e * e;
    }
    bench_line("tetcast.codec", "fitted-512", "encode_seconds", encode, "s");
    bench_num("error", 10 * log10(255.0 * 255.0 / (sum / (3.0 * 512 * 512) + 1e-9)));
    bench_text("error_unit", "dB");
    bench_num("bytes", (double)tetcast_ccc_size(512, 512, 0));
    bench_num("threads", 1);
    bench_end();
    bench_line("tetcast.codec", "lossless-512", "encode_seconds", pack, "s");
    bench_num("error", 0);
    bench_text("error_unit", "dB");
    bench_num("bytes", (double)j.size);
    bench_num("threads", 1);
    bench_end();
    free(j.rgba);
    free(j.back);
    free(j.code);
}

/* ---- foams ---- */

typedef struct foam_job {
    tetcast_site *sites;
    size_t count;
    tetcast_foam *foam;
    tetcast_render_desc d;
    tetcast_image image;
    tetcast_render_stats stats;
} foam_job;

static void run_foam(void *ctx) {
    foam_job *j = (foam_job *)ctx;
    tetcast_foam_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    tetcast_foam_destroy(j->foam);
    must(tetcast_foam_create(&d, j->sites, j->count, &j->foam), "foam");
}

static void run_foam_frame(void *ctx) {
    foam_job *j = (foam_job *)ctx;
    memset(&j->stats, 0, sizeof j->stats);
    must(tetcast_foam_render(&j->d, j->foam, &j->image, &j->stats), "render");
}

/* Sites are vertices: of a lattice, at random. */
static void foam_lines(const char *kase, int mesh_id, uint32_t every) {
    const tets *t = get_tets(mesh_id);
    tetcast_foam_info info;
    foam_job j;
    double build, frame;
    uint32_t isa;
    memset(&j, 0, sizeof j);
    j.sites = tet_sites(t);
    j.count = t->nv;
    build = fastest(run_foam, &j, 1);
    tetcast_foam_get_info(j.foam, &info);
    bench_line("tetcast.foam", kase, "build_seconds", build, "s");
    bench_num("cells", (double)info.cell_count);
    bench_num("neighbours", (double)info.neighbour_count / (double)info.cell_count);
    bench_num("bytes", (double)info.bytes);
    bench_num("threads", 1);
    bench_end();
    j.d.env.thread_count = 1;
    must(tetcast_camera_fit(&j.d.camera, info.box_min, info.box_max, NULL, SIZE, SIZE), "camera");
    j.image.width = j.image.height = SIZE;
    j.image.rgba = (float *)must_alloc((size_t)SIZE * SIZE, 16);
    for (isa = TETCAST_ISA_SCALAR; isa <= TETCAST_ISA_AVX2; isa += TETCAST_ISA_AVX2 - TETCAST_ISA_SCALAR) {
        if (isa > (uint32_t)tetcast_isa_best()) continue;
        j.d.isa = (tetcast_isa)isa;
        frame = fastest(run_foam_frame, &j, 5);
        bench_line("tetcast.foam", kase, "cells_per_second", (double)j.stats.steps / frame, "1/s");
        bench_num("seconds", frame);
        bench_num("steps", (double)j.stats.steps);
        bench_num("error", foam_error(j.foam, j.sites, j.count, &j.d.camera, j.image.rgba, SIZE, every));
        bench_text("error_unit", "largest difference of a colour from a march through all sites in doubles");
        bench_num("threads", 1);
        bench_text("isa", tetcast_isa_name((tetcast_isa)isa));
        bench_end();
    }
    if (mesh_id == MESH_D150K) table_set("foam", "%.0f (%.2f)", 1e-6 * (double)j.stats.steps / frame, build);
    tetcast_foam_destroy(j.foam);
    free(j.image.rgba);
    free(j.sites);
}

static void bm54(void) {
    foam_lines("33^3 of a lattice", MESH_K32, 64);
    foam_lines("150,000 at random", MESH_D150K, 128);
}

#endif
