/* bench_zbufrand_parts.h - blocks, filters, z-buffers of samples, numbers of samples - C99 - MIT OR Unlicense, see LICENSE

   BM18 blocks and filters as the thesis writes them, and ours; one key buffer, atomics, tiles
   BM19 holes and errors over the probability and the share of holes that are asked for
   BM20 the thesis' small scenes: a cylinder with highlights, a closed mesh from 2,920 samples
   Included by bench_zbufrand.c after its other parts. */
#ifndef BENCH_ZBUFRAND_PARTS_H
#define BENCH_ZBUFRAND_PARTS_H

/* ---- BM18: what samples become ---- */

typedef struct parts_job { /* independent samples of a surface that fills the picture and `guard` pixels around it */
    zbufrand_sample *sample;
    size_t count;
    uint32_t width, height, guard, block;
    zbufrand_canvas *canvas;
    zbufrand_picture picture;
    zbufrand_reconstruct how;
    uint64_t *key;              /* of the thesis' ways: width + 2 guard wide */
    float *rgba;
    uint8_t *kept;
    uint32_t *queue;
} parts_job;

static parts_job parts_open(uint32_t width, uint32_t height, uint32_t guard, size_t count) {
    parts_job j;
    bench_rng rng = {21};
    const size_t pixels = (size_t)width * height, all = (size_t)(width + 2 * guard) * (height + 2 * guard);
    size_t i;
    int a;
    memset(&j, 0, sizeof j);
    j.width = width;
    j.height = height;
    j.guard = guard;
    j.count = count;
    j.sample = (zbufrand_sample *)must_alloc(count, sizeof *j.sample);
    for (i = 0; i < count; i++) {
        zbufrand_sample *s = &j.sample[i];
        s->x = (float)((double)bench_random(&rng) * (double)(width + 2 * guard) - (double)guard);
        s->y = (float)((double)bench_random(&rng) * (double)(height + 2 * guard) - (double)guard);
        s->slope_x = 1e-5f;
        s->slope_y = 2e-5f;
        s->z = 1.0f / (0.3f + s->slope_x * s->x + s->slope_y * s->y);
        for (a = 0; a < 3; a++) s->rgb[a] = 0.5f + 0.5f * sinf(0.03f * s->x + 0.05f * s->y + (float)a);
    }
    j.key = (uint64_t *)must_alloc(all, sizeof *j.key);
    j.picture.rgba = (float *)must_alloc(4 * pixels, sizeof(float));
    j.picture.depth = (float *)must_alloc(pixels, sizeof(float));
    j.picture.number = (uint32_t *)must_alloc(pixels, sizeof(uint32_t));
    j.rgba = (float *)must_alloc(4 * pixels, sizeof(float));
    j.kept = (uint8_t *)must_alloc(count, 1);
    j.queue = (uint32_t *)must_alloc(pixels, sizeof(uint32_t));
    return j;
}

static void parts_free(parts_job *j) {
    free(j->sample);
    free(j->key);
    free(j->picture.rgba);
    free(j->picture.depth);
    free(j->picture.number);
    free(j->rgba);
    free(j->kept);
    free(j->queue);
}

static void parts_canvas(parts_job *j) {
    zbufrand_canvas_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.width = j->width;
    d.height = j->height;
    d.reconstruct = j->how;
    zbufrand_canvas_destroy(j->canvas);
    j->canvas = NULL;
    must(zbufrand_canvas_create(&d, &j->canvas), "canvas");
}

static void parts_ours(void *ctx) {
    parts_job *j = (parts_job *)ctx;
    zbufrand_source source;
    memset(&source, 0, sizeof source);
    source.shade_fn = zbufrand_samples_shade;
    source.surface_fn = zbufrand_samples_surface;
    source.user = j->sample;
    zbufrand_canvas_clear(j->canvas, 1);
    must(zbufrand_canvas_submit(j->canvas, j->sample, j->count, 0, NULL), "samples");
    must(zbufrand_canvas_resolve(j->canvas, &source, &j->picture, NULL), "picture");
}

static uint64_t parts_key(const zbufrand_sample *s, size_t number) {
    uint32_t bits;
    memcpy(&bits, &s->z, sizeof bits);
    return (uint64_t)bits << 32 | (uint32_t)number;
}

/* Algorithm 2 with colour blocks: each sample paints its block through the z-buffer, pixel by pixel. */
static void parts_paint(parts_job *j) {
    const int32_t wide = (int32_t)(j->width + 2 * j->guard), high = (int32_t)(j->height + 2 * j->guard);
    const int32_t before = ((int32_t)j->block - 1) / 2, after = (int32_t)j->block / 2;
    size_t i;
    memset(j->key, 0xff, (size_t)wide * (size_t)high * sizeof *j->key);
    for (i = 0; i < j->count; i++) {
        const uint64_t key = parts_key(&j->sample[i], i);
        const int32_t x = (int32_t)(j->sample[i].x + (float)j->guard), y = (int32_t)(j->sample[i].y + (float)j->guard);
        const int32_t x0 = x > before ? x - before : 0, x1 = x + after < wide ? x + after : wide - 1;
        const int32_t y1 = y + after < high ? y + after : high - 1;
        int32_t u, v;
        for (v = y > before ? y - before : 0; v <= y1; v++) {
            uint64_t *row = j->key + (size_t)v * (size_t)wide;
            for (u = x0; u <= x1; u++) if (key < row[u]) row[u] = key;
        }
    }
}

static void parts_painted(void *ctx) {
    parts_job *j = (parts_job *)ctx;
    uint32_t x, y, a;
    parts_paint(j);
    for (y = 0; y < j->height; y++) {
        for (x = 0; x < j->width; x++) {
            const uint64_t key = j->key[(size_t)(y + j->guard) * (j->width + 2 * j->guard) + x + j->guard];
            float *to = j->rgba + 4 * ((size_t)y * j->width + x);
            to[3] = key != UINT64_MAX ? 1.0f : 0.0f;
            for (a = 0; a < 3; a++) to[a] = key != UINT64_MAX ? j->sample[(uint32_t)key].rgb[a] : 0.0f;
        }
    }
}

/* Algorithm 4: which samples have no nearer one in the square around them. */
static void parts_squares(parts_job *j) {
    const uint32_t wide = j->width + 2 * j->guard;
    size_t i;
    parts_paint(j);
    for (i = 0; i < j->count; i++) {
        const uint32_t x = (uint32_t)(j->sample[i].x + (float)j->guard), y = (uint32_t)(j->sample[i].y + (float)j->guard);
        j->kept[i] = (uint32_t)j->key[(size_t)y * wide + x] == (uint32_t)i;
    }
}

/* Algorithm 5: for each pixel all samples whose Gaussian reaches it. Sample by sample, which needs no buckets. */
static void parts_gauss(void *ctx) {
    parts_job *j = (parts_job *)ctx;
    const size_t pixels = (size_t)j->width * j->height;
    const float c = j->how.gauss_radius;
    const int32_t reach = (int32_t)ceilf(c) - 1;
    size_t i;
    parts_squares(j);
    memset(j->rgba, 0, 4 * pixels * sizeof(float));
    for (i = 0; i < j->count; i++) {
        const zbufrand_sample *s = &j->sample[i];
        const int32_t x = (int32_t)floorf(s->x), y = (int32_t)floorf(s->y);
        int32_t u, v, a;
        if (!j->kept[i]) continue;
        for (v = y - reach; v <= y + reach; v++) {
            for (u = x - reach; u <= x + reach; u++) {
                const float dx = 1.5f * (float)(u - x) / c, dy = 1.5f * (float)(v - y) / c;
                float *to = j->rgba + 4 * ((size_t)v * j->width + (size_t)u), f;
                if (u < 0 || v < 0 || u >= (int32_t)j->width || v >= (int32_t)j->height) continue;
                f = expf(-(dx * dx + dy * dy));
                for (a = 0; a < 3; a++) to[a] += f * s->rgb[a];
                to[3] += f;
            }
        }
    }
    for (i = 0; i < pixels; i++) {
        float *to = j->rgba + 4 * i;
        int32_t a;
        for (a = 0; a < 4 && to[3] > 0.0f; a++) to[a] /= to[3];
    }
}

/* Algorithm 6: regions grow around the samples that are left, a queue says where next. */
static void parts_queue(void *ctx) {
    parts_job *j = (parts_job *)ctx;
    const uint32_t w = j->width, h = j->height;
    uint32_t *owner = (uint32_t *)(void *)j->key; /* twice as many as there are pixels */
    size_t i, begin = 0, end = 0;
    uint32_t a;
    parts_squares(j);
    memset(owner, 0xff, (size_t)w * h * sizeof *owner);
    for (i = 0; i < j->count; i++) {
        const zbufrand_sample *s = &j->sample[i];
        size_t at;
        if (!j->kept[i] || !(s->x >= 0.0f && s->y >= 0.0f && s->x < (float)w && s->y < (float)h)) continue;
        at = (size_t)s->y * w + (size_t)s->x;
        if (owner[at] == ~0u) j->queue[end++] = (uint32_t)at;
        owner[at] = (uint32_t)i;
    }
    while (begin < end) {
        const uint32_t at = j->queue[begin++], x = at % w, y = at / w;
        const uint32_t next[4] = {x > 0 ? at - 1 : at, x + 1 < w ? at + 1 : at, y > 0 ? at - w : at, y + 1 < h ? at + w : at};
        for (a = 0; a < 4; a++) {
            if (owner[next[a]] != ~0u) continue;
            owner[next[a]] = owner[at];
            j->queue[end++] = next[a];
        }
    }
    for (i = 0; i < (size_t)w * h; i++) {
        float *to = j->rgba + 4 * i;
        to[3] = owner[i] != ~0u ? 1.0f : 0.0f;
        for (a = 0; a < 3; a++) to[a] = owner[i] != ~0u ? j->sample[owner[i]].rgb[a] : 0.0f;
    }
}

/* Both ways in turn. model: what the thesis' formula predicts of the painter in seconds; 0: it has none. */
static double parts_line(parts_job *j, const char *kase, const char *method, void (*thesis)(void *ctx), int rounds, double model) {
    const size_t pixels = (size_t)j->width * j->height;
    bench_job b[2];
    double sum = 0.0;
    size_t i;
    int k;
    memset(b, 0, sizeof b);
    b[0].run = parts_ours;
    b[1].run = thesis;
    b[0].ctx = b[1].ctx = j;
    parts_canvas(j);
    bench_interleave(b, 2, rounds);
    for (i = 0; i < 4 * pixels; i++) sum += ((double)j->rgba[i] - (double)j->picture.rgba[i]) * ((double)j->rgba[i] - (double)j->picture.rgba[i]);
    for (k = 0; k < 2; k++) {
        bench_line("zbufrand.filters", kase, "picture_time", 1e3 * bench_seconds(&b[k]), "ms");
        bench_num("error", sqrt(sum / (4.0 * (double)pixels)));
        bench_text("error_unit", "RMSE between both");
        bench_text("method", method);
        bench_text("way", k == 0 ? "ours" : "the thesis'");
        bench_num("block", j->block);
        bench_num("samples", (double)j->count);
        if (k == 0) bench_num("times_as_fast", bench_ratio(&b[1], &b[0]));
        if (k == 1 && model > 0.0) bench_num("model_ms", 1e3 * model);
        bench_num("threads", 1);
        bench_end();
    }
    return bench_seconds(&b[1]);
}

/* Blocks of all sizes with as many samples as they need for a probability of 0.99, painted and by our filter; the painter's
   time against the thesis' model, whose two constants are those of the first and the last size. */
static void parts_blocks(void) {
    static const uint32_t sizes[7] = {1, 2, 3, 5, 10, 20, 80};
    const double v = 640.0 * 480.0;
    double seconds[7] = {0, 0, 0, 0, 0, 0, 0}, project = 0.0, paint = 0.0;
    int pass, i;
    for (pass = 0; pass < 2; pass++) {
        for (i = 0; i < 7; i++) {
            const double d = (double)sizes[i], all = (640.0 + 2.0 * d) * (480.0 + 2.0 * d);
            parts_job j;
            if (pass == 0 && i > 0 && i < 6) continue;
            j = parts_open(640, 480, sizes[i], (size_t)zbufrand_samples(ZBUFRAND_BOUND_UNION, all, v, d, 0.99));
            j.block = j.how.block = sizes[i];
            if (pass == 0) {
                bench_job b;
                memset(&b, 0, sizeof b);
                b.run = parts_painted;
                b.ctx = &j;
                bench_interleave(&b, 1, 3);
                seconds[i] = bench_seconds(&b);
            } else {
                seconds[i] = parts_line(&j, "640 x 480, filled", "blocks", parts_painted, g_opt.full ? 5 : 3,
                                        zbufrand_block_time(project, paint, v, v, d));
            }
            zbufrand_canvas_destroy(j.canvas);
            parts_free(&j);
        }
        if (pass == 0) { /* two equations for the two constants; the last size has hardly any samples */
            paint = seconds[6] / (v * log(v / 6400.0));
            project = seconds[0] / (v * log(v)) - paint;
        }
    }
}

static void parts_filters(void) {
    static const float radius[3] = {2.0f, 5.0f, 20.0f};
    parts_job j = parts_open(640, 480, 16, 38000);
    int i;
    j.block = j.how.block = 5;
    j.how.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
    j.how.tolerance_slope = -1.0f; /* to the letter */
    j.how.fill = ZBUFRAND_FILL_GAUSS;
    for (i = 0; i < 3; i++) {
        char name[32];
        j.how.gauss_radius = radius[i];
        snprintf(name, sizeof name, "Gauss, radius %g", (double)radius[i]);
        (void)parts_line(&j, "640 x 480, squares of 5", name, parts_gauss, g_opt.full ? 5 : 3, 0.0);
    }
    j.how.fill = ZBUFRAND_FILL_VORONOI_L1;
    (void)parts_line(&j, "640 x 480, squares of 5", "Voronoi", parts_queue, 5, 0.0);
    zbufrand_canvas_destroy(j.canvas);
    parts_free(&j);
}

/* Ways to bring samples in random order into a z-buffer: plain minima, compare-and-swap as several threads need it, tiles of
   64 x 64 pixels that samples are sorted to first. */
typedef struct scatter_job {
    uint32_t *pixel, *start, *order;
    uint64_t *key, *to;
    size_t count, pixels;
    uint32_t width, tiles, wide;
} scatter_job;

static void scatter_plain(void *ctx) {
    scatter_job *j = (scatter_job *)ctx;
    size_t i;
    memset(j->to, 0xff, j->pixels * sizeof *j->to);
    for (i = 0; i < j->count; i++) {
        uint64_t *to = &j->to[j->pixel[i]];
        *to = j->key[i] < *to ? j->key[i] : *to;
    }
}

static void scatter_swap(void *ctx) {
    scatter_job *j = (scatter_job *)ctx;
    size_t i;
    memset(j->to, 0xff, j->pixels * sizeof *j->to);
    for (i = 0; i < j->count; i++) zbufrandi_key_min(&j->to[j->pixel[i]], j->key[i]);
}

static uint32_t scatter_tile(const scatter_job *j, uint32_t pixel) {
    return pixel / j->width / 64 * j->wide + pixel % j->width / 64;
}

static void scatter_tiles(void *ctx) {
    scatter_job *j = (scatter_job *)ctx;
    size_t i;
    uint32_t t;
    memset(j->to, 0xff, j->pixels * sizeof *j->to);
    memset(j->start, 0, (j->tiles + 1) * sizeof *j->start);
    for (i = 0; i < j->count; i++) j->start[scatter_tile(j, j->pixel[i]) + 1]++;
    for (t = 0; t < j->tiles; t++) j->start[t + 1] += j->start[t];
    for (i = 0; i < j->count; i++) j->order[j->start[scatter_tile(j, j->pixel[i])]++] = (uint32_t)i;
    for (i = 0; i < j->count; i++) {
        const uint32_t k = j->order[i];
        uint64_t *to = &j->to[j->pixel[k]];
        *to = j->key[k] < *to ? j->key[k] : *to;
    }
}

static void parts_scatter(void) {
    static const uint32_t sizes[2][2] = {{640, 480}, {1920, 1080}};
    static const char *const names[3] = {"plain minima", "compare and swap", "sorted to tiles"};
    int i, k;
    for (i = 0; i < 2; i++) {
        bench_rng rng = {33};
        scatter_job j;
        bench_job b[3];
        uint64_t hash = 0;
        char kase[64];
        size_t n;
        memset(&j, 0, sizeof j);
        memset(b, 0, sizeof b);
        j.width = sizes[i][0];
        j.pixels = (size_t)sizes[i][0] * sizes[i][1];
        j.wide = (sizes[i][0] + 63) / 64;
        j.tiles = j.wide * ((sizes[i][1] + 63) / 64);
        j.count = 4u << 20;
        j.pixel = (uint32_t *)must_alloc(j.count, sizeof *j.pixel);
        j.order = (uint32_t *)must_alloc(j.count, sizeof *j.order);
        j.key = (uint64_t *)must_alloc(j.count, sizeof *j.key);
        j.to = (uint64_t *)must_alloc(j.pixels, sizeof *j.to);
        j.start = (uint32_t *)must_alloc(j.tiles + 1, sizeof *j.start);
        for (n = 0; n < j.count; n++) {
            j.pixel[n] = (uint32_t)((double)bench_random_u32(&rng) * (1.0 / 4294967296.0) * (double)j.pixels);
            j.key[n] = (uint64_t)bench_random_u32(&rng) << 32 | (uint32_t)n;
        }
        b[0].run = scatter_plain;
        b[1].run = scatter_swap;
        b[2].run = scatter_tiles;
        for (k = 0; k < 3; k++) b[k].ctx = &j;
        bench_interleave(b, 3, g_opt.full ? 5 : 3);
        snprintf(kase, sizeof kase, "%u x %u, random order", sizes[i][0], sizes[i][1]);
        for (k = 0; k < 3; k++) {
            b[k].run(&j);
            if (k == 0) hash = bench_hash_bytes(j.to, j.pixels * sizeof *j.to);
            bench_line("zbufrand.scatter", kase, "samples_per_second", bench_rate(&b[k], (double)j.count), "1/s");
            bench_num("error", (double)(bench_hash_bytes(j.to, j.pixels * sizeof *j.to) != hash));
            bench_text("error_unit", "pictures that differ");
            bench_text("method", names[k]);
            bench_num("threads", 1);
            bench_end();
        }
        free(j.pixel);
        free(j.order);
        free(j.key);
        free(j.to);
        free(j.start);
    }
}

static void bm18(void) {
    parts_blocks();
    parts_filters();
    parts_scatter();
}

/* ---- BM19: how many samples ---- */

/* Pictures of a surface that fills them, by samples alone: holes that stay and the error, as many samples as the theory has for
   a probability of no hole at all, or for a share of holes. */
static void bm19(void) {
    static const double probability[6] = {0.05, 0.5, 0.95, 0.99, 0.9999, 0.999999}, share[5] = {0.5, 0.25, 0.1, 0.01, 0.001};
    const double v = 320.0 * 240.0;
    world *w = world_blob(512);
    picture_job p;
    truth *t;
    int i, way;
    world_view(w, 0.3, 0.2, 1.9, 0, 0, 0, 30);
    p = picture_open(w, 320, 240, 1);
    t = truth_make(&p, g_opt.full ? 8 : 48);
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    p.desc.no_repair = 1;
    for (i = 0; i < 11; i++) {
        for (way = 0; way < 2; way++) {
            double holes = 0.0, cpu;
            char kase[64];
            wrong out;
            uint32_t k, pictures = g_opt.full ? 50 : 3;
            if (!g_opt.full && (i & 1) == 0 && i < 6) continue;
            p.desc.independent = (uint32_t)(way == 0);
            p.desc.density = i < 6 ? zbufrand_samples(ZBUFRAND_BOUND_DIRECT, v, v, 1.0, probability[i]) / v
                                   : zbufrand_samples_for_share(v, 1.0, share[i - 6]) / v;
            cpu = bench_cpu();
            for (k = 0; k < pictures; k++) {
                p.desc.frame = k;
                picture_run(&p);
                holes += (v - (double)p.stats.covered) / (double)pictures;
            }
            cpu = (bench_cpu() - cpu) / (double)pictures;
            out = judge(t, p.image.rgba, NULL, p.image.depth, NULL);
            snprintf(kase, sizeof kase, i < 6 ? "probability %g" : "share of holes %g", i < 6 ? probability[i] : share[i - 6]);
            bench_line("zbufrand.numbers", kase, "holes", holes, "pixels");
            bench_num("expected_if_independent", zbufrand_expected_holes(p.desc.density, v, 1.0));
            bench_num("density", p.desc.density);
            bench_num("ms", 1e3 * cpu);
            bench_num("error", out.rmse);
            bench_text("error_unit", "RMSE to 256 samples");
            wrong_nums(&out);
            bench_text("method", way == 0 ? "independent" : "stratified");
            bench_num("pictures", pictures);
            bench_num("threads", 1);
            bench_end();
        }
    }
    truth_free(t);
    picture_free(&p);
    world_free(w);
}

/* ---- BM20: small scenes ---- */

/* Twelve of the 24 facets of its side are seen; the normals are those of the round one. */
static world *world_cylinder(void) {
    supi_make make;
    uint32_t last[2] = {0, 0}, next[2];
    world *w = world_open("cylinder", (uint32_t)g_opt.threads);
    int i, k;
    memset(&make, 0, sizeof make);
    supi_make_colour(&make, 205, 32, 26);
    for (i = 0; i <= 24; i++) {
        const float angle = 6.2831853f * (float)i / 24.0f, normal[3] = {sinf(angle), 0.0f, cosf(angle)};
        for (k = 0; k < 2; k++) {
            const float p[3] = {normal[0], k == 0 ? -1.0f : 1.0f, normal[2]};
            next[k] = supi_make_vertex(&make, p, normal, NULL);
        }
        if (i > 0) supi_make_quad(&make, last[0], next[0], next[1], last[1]);
        memcpy(last, next, sizeof last);
    }
    (void)supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, 0);
    world_build(w);
    world_view(w, 0.0, 1.2, 4.5, 0, 0, 0, 40);
    return w;
}

static void bm20(void) {
    static const struct { const char *name; zbufrand_fill fill; float gauss; double thesis; } fills[3] = {
        {"blocks, d=10", ZBUFRAND_FILL_NONE, 0.0f, 360.0}, {"Voronoi L1, d=10", ZBUFRAND_FILL_VORONOI_L1, 0.0f, 4700.0},
        {"Gauss of 20, d=10", ZBUFRAND_FILL_GAUSS, 20.0f, 245000.0}
    };
    world *w = world_cylinder();
    picture_job p = picture_open(w, 640, 480, 1);
    truth *t = truth_make(&p, g_opt.full ? 8 : 48);
    bench_job b;
    double area;
    int i;
    for (i = 0; i < 3; i++) { /* sampled or rastered, shaded by a callback; its colours are not those of the truth */
        zbufrand_render_desc plain = p.desc;
        if (i > 0) {
            p.desc.shade_fn = shade_phong;
            p.desc.shade_user = p.desc.camera.eye;
        }
        p.desc.hybrid = i == 2 ? ZBUFRAND_HYBRID_OFF : ZBUFRAND_HYBRID_AUTO;
        b = picture_time(&p, "cylinder", 3);
        (void)picture_line("zbufrand.small", w->name, i == 0 ? "by cost" : i == 1 ? "by cost, highlights" : "sampled, highlights", &p, &b,
                           i == 0 ? t : NULL, 1);
        p.desc = plain;
    }
    truth_free(t);
    picture_free(&p);
    world_free(w);
    w = world_blob(46);
    snprintf(w->name, sizeof w->name, "closed mesh of 8,464 triangles, 2,920 samples");
    p = picture_open(w, 640, 480, 1);
    t = truth_make(&p, g_opt.full ? 8 : 48);
    p.desc.hybrid = ZBUFRAND_HYBRID_OFF;
    p.desc.no_repair = 1;
    p.desc.no_occlusion = 1;
    picture_run(&p);
    area = p.stats.projected_area;
    p.desc.density = 2920.0 / area;
    p.desc.independent = 1;
    p.desc.reconstruct.block = 10;
    for (i = 0; i < 3; i++) {
        p.desc.reconstruct.fill = fills[i].fill;
        p.desc.reconstruct.occlusion = i == 0 ? ZBUFRAND_OCCLUSION_BLOCKS : ZBUFRAND_OCCLUSION_SQUARES;
        p.desc.reconstruct.gauss_radius = fills[i].gauss;
        b = picture_time(&p, fills[i].name, 3);
        (void)picture_line("zbufrand.small", w->name, fills[i].name, &p, &b, t, 1);
        bench_line("zbufrand.small", w->name, "times_of_the_thesis", fills[i].thesis / (1e3 * bench_seconds(&b)), "");
        bench_text("method", fills[i].name);
        bench_num("thesis_ms", fills[i].thesis);
        bench_end();
    }
    truth_free(t);
    picture_free(&p);
    world_free(w);
}

#endif
