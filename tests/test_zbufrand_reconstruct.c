/* From samples to pictures, on synthetic samples: each stage against its definition by brute force, the laws of sampled
   pixels by statistics (each check fails by chance with probability below 1e-4; fixed seeds), repairs on pictures whose
   right answer is known, the same bits for any number of threads, any instruction set and any order of samples. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"

#define INF_F ((float)INFINITY)

static uint32_t poisson(test_rng *r, double mean) {
    double limit = exp(-mean), p = 1.0;
    uint32_t k = 0;
    if (mean > 50.0) {
        k = poisson(r, 0.5 * mean);
        return k + poisson(r, 0.5 * mean);
    }
    for (;; k++) {
        p *= test_rng_double(r);
        if (p <= limit) return k;
    }
}

/* ---- lists of samples -------------------------------------------------------------------------------------------- */

typedef struct list { zbufrand_sample *s; size_t n, room; } list;

static zbufrand_sample *add(list *l, double x, double y, double z) {
    zbufrand_sample *s;
    if (l->n == l->room) {
        l->room = 2 * l->room + 256;
        l->s = (zbufrand_sample *)realloc(l->s, l->room * sizeof *l->s);
        if (l->s == NULL) abort();
    }
    s = &l->s[l->n++];
    memset(s, 0, sizeof *s);
    s->x = (float)x;
    s->y = (float)y;
    s->z = (float)z;
    return s;
}
static void drop(list *l) { free(l->s); memset(l, 0, sizeof *l); }

static zbufrand_canvas_desc reconstruct_defaults(uint32_t w, uint32_t h, uint32_t d) {
    zbufrand_canvas_desc c;
    memset(&c, 0, sizeof c);
    c.env.thread_count = 1;
    c.width = w;
    c.height = h;
    c.reconstruct.block = d;
    c.reconstruct.tolerance_slope = -1.0f; /* by the letter */
    return c;
}

typedef struct reconstruct_view { /* a picture with its buffers */
    zbufrand_picture p;
    zbufrand_resolve_stats stats;
    zbufrand_submit_stats submitted;
    uint32_t w, h, guard;
} reconstruct_view;

static void view_free(reconstruct_view *v) {
    free(v->p.rgba);
    free(v->p.depth);
    free(v->p.number);
    memset(v, 0, sizeof *v);
}

static reconstruct_view render_seed(const zbufrand_canvas_desc *d, const list *l, uint32_t seed) {
    zbufrand_canvas *c = NULL;
    zbufrand_source source;
    size_t n = (size_t)d->width * d->height;
    reconstruct_view v;
    memset(&v, 0, sizeof v);
    memset(&source, 0, sizeof source);
    v.w = d->width;
    v.h = d->height;
    v.p.rgba = (float *)malloc(n * 16);
    v.p.depth = (float *)malloc(n * 4);
    v.p.number = (uint32_t *)malloc(n * 4);
    source.shade_fn = zbufrand_samples_shade;
    source.surface_fn = zbufrand_samples_surface;
    source.user = l->s;
    CHECK_EQ_U64(zbufrand_canvas_create(d, &c), ZBUFRAND_OK);
    if (c == NULL) return v;
    zbufrand_canvas_clear(c, seed);
    v.guard = zbufrand_canvas_guard(c);
    CHECK_EQ_U64(zbufrand_canvas_submit(c, l->s, l->n, 0, &v.submitted), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_canvas_resolve(c, &source, &v.p, &v.stats), ZBUFRAND_OK);
    zbufrand_canvas_destroy(c);
    return v;
}
static reconstruct_view render(const zbufrand_canvas_desc *d, const list *l) { return render_seed(d, l, 1); }

static uint64_t reconstruct_hash_words(const void *data, size_t n, uint64_t hash) { /* the same on machines of either byte order */
    const uint8_t *p = (const uint8_t *)data;
    size_t i;
    for (i = 0; i < n; i++) {
        uint32_t x;
        memcpy(&x, p + 4 * i, 4);
        hash = (hash ^ x) * 0x100000001b3u;
        hash ^= hash >> 29;
    }
    return hash;
}
static uint64_t view_hash(const reconstruct_view *v) {
    size_t n = (size_t)v->w * v->h;
    return reconstruct_hash_words(v->p.number, n, reconstruct_hash_words(v->p.depth, n, reconstruct_hash_words(v->p.rgba, 4 * n, 1)));
}

/* Random samples around a picture: places, few distinct depths so that there are ties, colours. */
static void scatter(list *l, test_rng *r, uint32_t w, uint32_t h, uint32_t guard, size_t count, uint32_t depths) {
    size_t i;
    for (i = 0; i < count; i++) {
        /* all products are exact in double: the same samples whatever the compiler fuses */
        double x = (double)test_rng_float(r) * (w + 2.0 * guard + 2.0), y = (double)test_rng_float(r) * (h + 2.0 * guard + 2.0);
        double z = depths ? 1.0 + test_rng_below(r, depths) : 0.5 + 3.0 * (double)test_rng_float(r);
        zbufrand_sample *s = add(l, x - guard - 1.0, y - guard - 1.0, z);
        s->rgb[0] = test_rng_float(r);
        s->rgb[1] = test_rng_float(r);
        s->rgb[2] = test_rng_float(r);
        s->slope_x = (test_rng_float(r) - 0.5f) * 0.04f;
        s->slope_y = (test_rng_float(r) - 0.5f) * 0.04f;
        s->flags = test_rng_below(r, 4) == 0 ? ZBUFRAND_SAMPLE_BACK : 0;
    }
}

/* ---- per pixel and blocks ---------------------------------------------------------------------------------------- */

/* The nearest of all samples whose block covers the pixel: the definition of painting blocks. Ties by the hash. */
static uint64_t painted(const list *l, uint32_t seed, int x, int y, int d) {
    uint64_t best = ~(uint64_t)0;
    uint32_t salt = zbufrandi_hash32(seed);
    int lo = (d - 1) / 2, hi = d / 2;
    size_t i;
    for (i = 0; i < l->n; i++) {
        int ix = (int)floor((double)l->s[i].x), iy = (int)floor((double)l->s[i].y);
        if (x >= ix - lo && x <= ix + hi && y >= iy - lo && y <= iy + hi) {
            uint64_t key = zbufrandi_key(l->s[i].z, (uint32_t)i ^ salt);
            if (key < best) best = key;
        }
    }
    return best;
}

TEST(blocks_are_painted) {
    test_rng r = test_rng_make(1);
    int d, isa, k;
    for (d = 1; d <= 33; d += d < 8 ? 1 : 5) {
        for (k = 0; k < 3; k++) {
            uint32_t w = 1 + test_rng_below(&r, k == 2 ? 530 : 70), h = 1 + test_rng_below(&r, k == 2 ? 4 : 50), x, y;
            zbufrand_canvas_desc desc = reconstruct_defaults(w, h, (uint32_t)d);
            list l = {NULL, 0, 0};
            scatter(&l, &r, w, h, (uint32_t)d, 40 + test_rng_below(&r, 150), k == 0 ? 3 : 0);
            for (isa = ZBUFRAND_ISA_SCALAR; isa <= ZBUFRAND_ISA_AVX2; isa += 2) {
                reconstruct_view v;
                uint32_t wrong = 0, colors = 0;
                desc.isa = (zbufrand_isa)isa;
                v = render(&desc, &l);
                CHECK_EQ_U64(v.guard, d / 2);
                for (y = 0; y < h; y++) {
                    for (x = 0; x < w; x++) {
                        uint64_t key = painted(&l, 1, (int)x, (int)y, d);
                        uint32_t number = key != ~(uint64_t)0 ? zbufrandi_key_number(key) ^ zbufrandi_hash32(1) : ~0u;
                        float z = key != ~(uint64_t)0 ? zbufrandi_key_depth(key) : INF_F;
                        size_t at = (size_t)y * w + x;
                        wrong += v.p.number[at] != number || !(v.p.depth[at] == z);
                        if (number == ~0u) colors += v.p.rgba[4 * at + 3] != 0.0f || v.p.rgba[4 * at] != 0.0f;
                        else colors += memcmp(v.p.rgba + 4 * at, l.s[number].rgb, 12) != 0 || v.p.rgba[4 * at + 3] != 1.0f;
                    }
                }
                CHECK_MSG(wrong == 0 && colors == 0, "%ux%u d %d isa %d: %u pixels, %u colours differ", w, h, d, isa, wrong, colors);
                view_free(&v);
            }
            drop(&l);
        }
    }
}

TEST(min_filter_of_any_size) { /* the stage alone: blocks and squares, sizes around the strips and bands */
    static const uint32_t sizes[6][2] = {{1, 1}, {255, 3}, {256, 65}, {257, 130}, {300, 64}, {70, 300}};
    test_rng r = test_rng_make(2);
    uint32_t i, k, d;
    for (i = 0; i < 6; i++) {
        for (k = 0; k < 9; k++) {
            static const uint32_t ds[9] = {1, 2, 3, 4, 5, 8, 17, 33, 100};
            zbufrandi_mem mem;
            zbufrand_env env;
            zbufrand_reconstruct o;
            zbufrandi_recon a, b;
            size_t n, q;
            int squares;
            d = ds[k];
            memset(&env, 0, sizeof env);
            memset(&o, 0, sizeof o);
            env.thread_count = 1;
            o.block = d;
            o.tolerance_slope = -1.0f; /* there are no slopes */
            CHECK_EQ_U64(zbufrandi_env_open(&env, &mem), ZBUFRAND_OK);
            for (squares = 0; squares < 2; squares++) {
                o.occlusion = squares ? ZBUFRAND_OCCLUSION_SQUARES : ZBUFRAND_OCCLUSION_BLOCKS;
                CHECK_EQ_U64(zbufrandi_recon_open(&mem, &env, ZBUFRAND_ISA_SCALAR, &o, sizes[i][0], sizes[i][1], 1, &a), ZBUFRAND_OK);
                CHECK_EQ_U64(zbufrandi_recon_open(&mem, &env, ZBUFRAND_ISA_AUTO, &o, sizes[i][0], sizes[i][1], 1, &b), ZBUFRAND_OK);
                zbufrandi_recon_clear(&a);
                zbufrandi_recon_clear(&b);
                n = (size_t)a.canvas.width * a.canvas.height;
                for (q = 0; q < n / (d * d + 1) + 3; q++) {
                    size_t at = (size_t)(test_rng_double(&r) * (double)n);
                    b.canvas.key[at] = a.canvas.key[at] = zbufrandi_key(1.0f + (float)test_rng_below(&r, 5), test_rng_u32(&r));
                    at = (size_t)(test_rng_double(&r) * (double)n);
                    if (a.exact != NULL) b.exact[at] = a.exact[at] = zbufrandi_key(1.5f, test_rng_u32(&r));
                }
                CHECK((a.exact != NULL) == (d > 1 && !squares));
                zbufrandi_recon_keys(&a);
                zbufrandi_recon_keys(&b);
                CHECK_EQ_U64(memcmp(a.result, b.result, (size_t)sizes[i][0] * sizes[i][1] * 8), 0);
                if (!squares) { /* by definition, at some pixels */
                    uint32_t t, wrong = 0;
                    for (t = 0; t < 40; t++) {
                        uint32_t x = test_rng_below(&r, sizes[i][0]), y = test_rng_below(&r, sizes[i][1]), u, v;
                        uint64_t best = a.exact ? a.exact[(size_t)(y + a.guard) * a.canvas.width + x + a.guard] : ~(uint64_t)0;
                        for (v = y + a.guard - d / 2; v <= y + a.guard + (d - 1) / 2; v++) {
                            for (u = x + a.guard - d / 2; u <= x + a.guard + (d - 1) / 2; u++) {
                                uint64_t key = a.canvas.key[(size_t)v * a.canvas.width + u];
                                if (key < best) best = key;
                            }
                        }
                        wrong += a.result[(size_t)y * sizes[i][0] + x] != best;
                    }
                    CHECK_MSG(wrong == 0, "size %u d %u: %u of 40 pixels", i, d, wrong);
                }
                zbufrandi_recon_close(&mem, &a);
                zbufrandi_recon_close(&mem, &b);
            }
            CHECK_EQ_U64(mem.used, 0);
        }
    }
}

TEST(planes_beside_exact_pixels) { /* blocks that follow their surface, and a rasteriser's pixels that are not widened */
    test_rng r = test_rng_make(29);
    uint32_t d;
    for (d = 2; d <= 8; d += 2) {
        zbufrandi_mem mem;
        zbufrand_env env;
        zbufrand_reconstruct o;
        zbufrandi_recon a[2];
        size_t n, q, exact = 0, wrong = 0;
        int i;
        memset(&env, 0, sizeof env);
        memset(&o, 0, sizeof o);
        env.thread_count = 1;
        o.block = d;
        o.plane_depth = 1;
        CHECK_EQ_U64(zbufrandi_env_open(&env, &mem), ZBUFRAND_OK);
        for (i = 0; i < 2; i++) {
            CHECK_EQ_U64(zbufrandi_recon_open(&mem, &env, i ? ZBUFRAND_ISA_AUTO : ZBUFRAND_ISA_SCALAR, &o, 77, 40, 1, &a[i]), ZBUFRAND_OK);
            zbufrandi_recon_clear(&a[i]);
            if (a[i].exact == NULL || a[i].slope_x == NULL) return;
        }
        n = (size_t)a[0].canvas.width * a[0].canvas.height;
        for (q = 0; q < n; q++) {
            float sx = test_rng_range(&r, -0.1f, 0.1f), sy = test_rng_bits(&r);
            for (i = 0; i < 2; i++) {
                a[i].slope_x[q] = sx;
                a[i].slope_y[q] = q % 5 == 0 ? sy : 0.0f; /* anything: NaN, infinite */
            }
            if (test_rng_below(&r, d * d) == 0) a[1].canvas.key[q] = a[0].canvas.key[q] = zbufrandi_key(test_rng_range(&r, 1.0f, 3.0f), test_rng_u32(&r));
            if (test_rng_below(&r, 9) == 0) a[1].exact[q] = a[0].exact[q] = zbufrandi_key(1.2f, test_rng_u32(&r));
        }
        for (i = 0; i < 2; i++) zbufrandi_recon_keys(&a[i]);
        CHECK_EQ_U64(memcmp(a[0].result, a[1].result, 77 * 40 * 8), 0);
        for (q = 0; q < 77 * 40; q++) { /* an exact pixel is there unless something nearer is */
            uint64_t e = a[0].exact[(q / 77 + a[0].guard) * a[0].canvas.width + q % 77 + a[0].guard];
            float z = a[0].result[q] != ZBUFRANDI_EMPTY ? zbufrandi_key_depth(a[0].result[q]) : INF_F;
            exact += a[0].result[q] == e && e != ZBUFRANDI_EMPTY;
            wrong += a[0].result[q] > e || !(z > 0.0f);
        }
        CHECK(wrong == 0 && exact > 50);
        for (i = 0; i < 2; i++) zbufrandi_recon_close(&mem, &a[i]);
        CHECK_EQ_U64(mem.used, 0);
    }
}

static double reconstruct_below(double x) { return (double)nextafterf((float)x, -INF_F); }

TEST(pixel_borders) { /* half-open pixels, guard band, bad samples */
    zbufrand_canvas_desc d = reconstruct_defaults(4, 3, 3);
    list l = {NULL, 0, 0};
    reconstruct_view v;
    add(&l, 0.0, 0.0, 1.0);
    add(&l, reconstruct_below(1.0), 2.0, 1.0);
    add(&l, reconstruct_below(4.0), reconstruct_below(3.0), 1.0);
    add(&l, -0.5, 1.5, 0.5);      /* in the guard band: its block reaches column 0 */
    add(&l, -1.0, 1.5, 0.25);     /* just inside of it */
    add(&l, reconstruct_below(-1.0), 1.5, 0.125);
    add(&l, 5.0, 1.0, 1.0);
    add(&l, reconstruct_below(5.0), 1.0, 1.0);
    add(&l, 1e30, 1.0, 1.0);
    add(&l, 1.0, (double)NAN, 1.0);
    add(&l, (double)INFINITY, 1.0, 1.0);
    add(&l, 1.0, 1.0, 0.0);
    add(&l, 1.0, 1.0, -1.0);
    add(&l, 1.0, 1.0, (double)NAN);
    add(&l, 1.0, 1.0, (double)INFINITY);
    add(&l, 1.0, 1.0, 1e-45);
    add(&l, 1.0, 1.0, 0.9e-30);
    add(&l, 1.0, 1.0, 1.1e30);
    v = render(&d, &l);
    CHECK_EQ_U64(v.submitted.accepted, 6);
    CHECK_EQ_U64(v.submitted.outside, 3);
    CHECK_EQ_U64(v.submitted.bad, 9);
    CHECK_EQ_U64(v.p.number[0 * 4 + 0], 4); /* nearest of those whose blocks reach column 0 */
    CHECK_EQ_U64(v.p.number[2 * 4 + 0], 4);
    CHECK_EQ_U64(v.p.number[2 * 4 + 1], 1);
    CHECK_EQ_U64(v.p.number[0 * 4 + 1], 0);
    CHECK_EQ_U64(v.p.number[0 * 4 + 3], 7);
    CHECK_EQ_U64(v.p.number[2 * 4 + 2], 2);
    CHECK(v.p.number[1 * 4 + 3] == 2 || v.p.number[1 * 4 + 3] == 7);
    CHECK_EQ_U64(v.p.number[0 * 4 + 2], ~0u);
    CHECK_EQ_U64(v.stats.covered, 11);
    view_free(&v);
    drop(&l);
}

TEST(one_sample_per_patch_is_shaded) {
    test_rng r = test_rng_make(3);
    zbufrand_canvas_desc d = reconstruct_defaults(320, 240, 5);
    list l = {NULL, 0, 0};
    reconstruct_view v;
    uint64_t distinct = 0;
    uint8_t *seen;
    size_t i;
    scatter(&l, &r, 320, 240, 2, 40000, 0);
    v = render(&d, &l);
    seen = (uint8_t *)calloc(l.n, 1);
    for (i = 0; i < 320 * 240; i++) {
        if (v.p.number[i] != ~0u && !seen[v.p.number[i]]) {
            seen[v.p.number[i]] = 1;
            distinct++;
        }
    }
    CHECK_MSG(v.stats.shaded >= distinct && v.stats.shaded < distinct * 13 / 10, "%u of %u seen samples shaded", (unsigned)v.stats.shaded, (unsigned)distinct);
    CHECK(v.stats.shaded * 4 < v.stats.covered);
    free(seen);
    view_free(&v);
    drop(&l);
}

/* ---- the same bits ----------------------------------------------------------------------------------------------- */

typedef struct feeder { zbufrand_canvas *c; const list *l; const uint32_t *order; } feeder;
static void feed(void *user, uint32_t task) { /* every 8th sample, in its own order, one at a time */
    feeder *f = (feeder *)user;
    size_t i;
    for (i = task; i < f->l->n; i += 8) {
        uint32_t k = f->order[i];
        zbufrand_canvas_submit(f->c, &f->l->s[k], 1, k, NULL);
    }
}

TEST(same_bits) { /* threads 1, 2, 3, 8, 64, both instruction sets, shuffled and concurrent submission, all options */
    static const uint32_t threads[5] = {1, 2, 3, 8, 64};
    test_rng r = test_rng_make(4);
    uint32_t option, t, i, w = 333, h = 141;
    list l = {NULL, 0, 0};
    uint32_t *order;
    uint64_t all = 0;
    scatter(&l, &r, w, h, 8, 30000, 0);
    order = (uint32_t *)malloc(l.n * 4);
    for (i = 0; i < l.n; i++) order[i] = i;
    for (i = (uint32_t)l.n - 1; i > 0; i--) {
        uint32_t j = test_rng_below(&r, i + 1), x = order[i];
        order[i] = order[j];
        order[j] = x;
    }
    for (option = 0; option < 15; option++) {
        zbufrand_canvas_desc d = reconstruct_defaults(w, h, 1 + option % 5);
        uint64_t first = 0;
        if (option >= 5) d.reconstruct.occlusion = (zbufrand_occlusion)((option - 5) % 4);
        if (option >= 9) d.reconstruct.fill = (zbufrand_fill)(option - 9);
        d.reconstruct.plane_depth = option == 2 || option == 7;
        d.reconstruct.drop_back = option & 1;
        d.reconstruct.tolerance = option == 6 ? 0.1f : 0.0f;
        d.reconstruct.tolerance_slope = option == 8 ? 1.5f : -1.0f;
        d.reconstruct.repair = option == 4 || option == 11;
        d.bucket_bits = option == 3 ? 8 : 0;
        for (t = 0; t < (test_quick() ? 2u : 5u); t++) {
            zbufrand_canvas *c = NULL;
            zbufrand_source source;
            zbufrand_env env;
            feeder f;
            reconstruct_view v;
            uint64_t hash;
            size_t n = (size_t)w * h;
            memset(&source, 0, sizeof source);
            memset(&v, 0, sizeof v);
            memset(&env, 0, sizeof env);
            v.w = w;
            v.h = h;
            v.p.rgba = (float *)malloc(n * 16);
            v.p.depth = (float *)malloc(n * 4);
            v.p.number = (uint32_t *)malloc(n * 4);
            source.shade_fn = zbufrand_samples_shade;
            source.surface_fn = zbufrand_samples_surface;
            source.user = l.s;
            d.env.thread_count = threads[t];
            d.isa = t & 1 ? ZBUFRAND_ISA_SCALAR : ZBUFRAND_ISA_AUTO;
            CHECK_EQ_U64(zbufrand_canvas_create(&d, &c), ZBUFRAND_OK);
            if (c == NULL) break;
            zbufrand_canvas_clear(c, 77);
            f.c = c;
            f.l = &l;
            f.order = order;
            if (t == 0) CHECK_EQ_U64(zbufrand_canvas_submit(c, l.s, l.n, 0, NULL), ZBUFRAND_OK);
            env.thread_count = threads[t];
            if (t != 0) zbufrandi_parallel_for(&env, feed, &f, 8);
            CHECK_EQ_U64(zbufrand_canvas_resolve(c, &source, &v.p, &v.stats), ZBUFRAND_OK);
            hash = view_hash(&v);
            if (t == 0) {
                first = hash;
                if (option < 14) all = (all ^ hash) * 0x100000001b3u;
            }
            CHECK_MSG(hash == first, "option %u: other bits with %u threads", option, threads[t]);
            CHECK_EQ_U64(zbufrand_canvas_resolve(c, &source, &v.p, NULL), ZBUFRAND_OK); /* again: the same */
            CHECK_EQ_U64(view_hash(&v), first);
            for (i = 0; i < 4 * n; i++) {
                if (!(v.p.rgba[i] >= 0.0f && v.p.rgba[i] <= 1.0001f)) break;
            }
            CHECK_MSG(i == 4 * n, "option %u: colour %u is %g", option, i, (double)v.p.rgba[i < 4 * n ? i : 0]);
            zbufrand_canvas_destroy(c);
            view_free(&v);
        }
    }
    CHECK_EQ_U64(all, 0xc8002027477d998au); /* the same on every machine */
    free(order);
    drop(&l);
}

/* ---- cells and squares ------------------------------------------------------------------------------------------- */

/* Survivors by the definitions, over all samples (each pixel keeps its nearest). number -> kept; 2: as rounding has it */
static void survivors(const list *l, const zbufrand_canvas_desc *d, uint32_t guard, uint8_t *kept) {
    int w = (int)d->width + 2 * (int)guard, h = (int)d->height + 2 * (int)guard, b = (int)d->reconstruct.block, r = b / 2;
    uint32_t salt = zbufrandi_hash32(1);
    size_t i, j, m = 0, *who = (size_t *)malloc(l->n * sizeof *who);
    int *px = (int *)malloc(l->n * sizeof *px), *py = (int *)malloc(l->n * sizeof *py);
    float *limit = (float *)malloc(l->n * sizeof *limit), *least = (float *)malloc(l->n * sizeof *least);
    memset(kept, 0, l->n);
    for (i = 0; i < l->n; i++) { /* one per pixel */
        int x = (int)floor((double)l->s[i].x), y = (int)floor((double)l->s[i].y);
        int best = x >= -(int)guard && y >= -(int)guard && x + (int)guard < w && y + (int)guard < h;
        for (j = 0; best && j < l->n; j++) {
            if ((int)floor((double)l->s[j].x) == x && (int)floor((double)l->s[j].y) == y) {
                best = zbufrandi_key(l->s[j].z, (uint32_t)j ^ salt) >= zbufrandi_key(l->s[i].z, (uint32_t)i ^ salt);
            }
        }
        if (!best) continue;
        who[m] = i;
        px[m] = x;
        py[m++] = y;
    }
    for (i = 0; i < m; i++) { /* minimum of its own square, or of its cell */
        least[i] = INF_F;
        for (j = 0; j < m; j++) {
            int together = abs(px[i] - px[j]) <= r && abs(py[i] - py[j]) <= r;
            if (d->reconstruct.occlusion == ZBUFRAND_OCCLUSION_CELLS) {
                together = (int)floor((double)px[i] / b) == (int)floor((double)px[j] / b) && (int)floor((double)py[i] / b) == (int)floor((double)py[j] / b);
            }
            if (together && l->s[who[j]].z < least[i]) least[i] = l->s[who[j]].z;
        }
    }
    for (i = 0; i < m; i++) {
        limit[i] = least[i];
        if (d->reconstruct.occlusion == ZBUFRAND_OCCLUSION_SQUARES_ALL) {
            for (j = 0; j < m; j++) {
                if (abs(px[i] - px[j]) <= r && abs(py[i] - py[j]) <= r && least[j] < limit[i]) limit[i] = least[j];
            }
        }
    }
    for (i = 0; i < m; i++) {
        const zbufrand_sample *s = &l->s[who[i]];
        const zbufrand_reconstruct *o = &d->reconstruct;
        double f = (double)o->focal, z = (double)s->z, y = (double)limit[i];
        int ok = s->z <= limit[i];
        if (o->tolerance > 0.0f) ok |= s->z <= limit[i] * (1.0f + o->tolerance);
        if (o->tolerance_projected > 0.0f) ok |= f * z / (f + z) <= f * y / (f + y) + (double)o->tolerance_projected;
        for (j = 0; j < m && o->tolerance_slope > 0.0f; j++) { /* on a quadric through both? */
            const zbufrand_sample *t = &l->s[who[j]];
            double g = fmin(hypot((double)s->slope_x, (double)s->slope_y), hypot((double)t->slope_x, (double)t->slope_y)), off;
            double room = (g * b * (double)o->tolerance_slope + 0.005 / z) - (z - y) / (z * z);
            if (t->z != limit[i]) continue;
            off = (double)(s->slope_x + t->slope_x) * (px[i] - px[j]) + (double)(s->slope_y + t->slope_y) * (py[i] - py[j]);
            off = 1.5 * g + 0.005 / z - fabs(1 / z - 1 / y - off / 2);
            if (room < off) off = room;
            if (!ok) ok = fabs(off) < 1e-5 ? 2 : off > 0;
            break;
        }
        for (j = 0; j < m && !ok && o->tolerance_color > 0.0f; j++) { /* the nearest one: no two are as deep then */
            const zbufrand_sample *t = &l->s[who[j]];
            if (t->z != limit[i]) continue;
            ok = fabsf(s->rgb[0] - t->rgb[0]) <= o->tolerance_color && fabsf(s->rgb[1] - t->rgb[1]) <= o->tolerance_color &&
                 fabsf(s->rgb[2] - t->rgb[2]) <= o->tolerance_color;
            break;
        }
        if (o->drop_back && (s->flags & ZBUFRAND_SAMPLE_BACK)) ok = 0;
        kept[who[i]] = (uint8_t)ok;
    }
    for (i = 0; i < m && d->reconstruct.tolerance_slope >= 0.0f && b > 1; i++) { /* the nearest of its cell, of which nothing is left? */
        int first = 1, left = 0, unsure = 0;
        for (j = 0; j < m; j++) {
            if (floor((double)px[i] / b) != floor((double)px[j] / b) || floor((double)py[i] / b) != floor((double)py[j] / b)) continue;
            if (l->s[who[j]].z < l->s[who[i]].z) first = 0;
            left |= kept[who[j]] == 1;
            unsure |= kept[who[j]] == 2;
        }
        if (first && !left) kept[who[i]] = unsure ? 2 : 3;
    }
    for (i = 0; i < m; i++) if (kept[who[i]] == 3) kept[who[i]] = 1;
    free(who);
    free(px);
    free(py);
    free(limit);
    free(least);
}

TEST(cells_and_squares) {
    test_rng r = test_rng_make(5);
    int d, variant, occlusion;
    size_t fitting = 0, nearest = 0;
    uint8_t *kept[3];
    for (d = 1; d <= 9; d++) {
        for (variant = 0; variant < 6; variant++) {
            uint32_t w = 20 + test_rng_below(&r, 30), h = 20 + test_rng_below(&r, 30);
            list l = {NULL, 0, 0};
            size_t i, n[3] = {0, 0, 0}, beyond = 0;
            scatter(&l, &r, w, h, 6, 400, variant == 4 ? 3 : 0);
            for (occlusion = 1; occlusion <= 3; occlusion++) {
                zbufrand_canvas_desc desc = reconstruct_defaults(w, h, (uint32_t)d);
                reconstruct_view v;
                size_t wrong = 0, q;
                desc.reconstruct.occlusion = (zbufrand_occlusion)occlusion;
                desc.reconstruct.focal = 3.0f;
                if (variant == 1) desc.reconstruct.tolerance = 0.2f;
                if (variant == 2) desc.reconstruct.tolerance_projected = 0.1f;
                if (variant == 3) desc.reconstruct.tolerance_slope = 2.0f;
                if (variant == 5) desc.reconstruct.tolerance_color = 0.4f;
                desc.reconstruct.drop_back = variant == 1;
                v = render(&desc, &l);
                kept[occlusion - 1] = (uint8_t *)malloc(l.n);
                survivors(&l, &desc, v.guard, kept[occlusion - 1]);
                for (i = 0; i < l.n; i++) {
                    int x = (int)floor((double)l.s[i].x), y = (int)floor((double)l.s[i].y), shown = 0;
                    if (x < 0 || y < 0 || x >= (int)w || y >= (int)h) continue;
                    shown = v.p.number[(size_t)y * w + (size_t)x] == i;
                    wrong += kept[occlusion - 1][i] != 2 && shown != kept[occlusion - 1][i];
                    fitting += variant == 3 && shown;
                    nearest += variant == 0 && shown;
                    n[occlusion - 1] += (size_t)shown;
                }
                for (q = 0; q < (size_t)w * h; q++) wrong += v.p.number[q] != ~0u && !kept[occlusion - 1][v.p.number[q]];
                CHECK_MSG(wrong == 0, "d %d variant %d occlusion %d: %u samples", d, variant, occlusion, (unsigned)wrong);
                view_free(&v);
            }
            for (i = 0; i < l.n; i++) beyond += kept[2][i] && !kept[1][i];
            if (variant != 3 && variant != 5) { /* which have another one to compare with */
                CHECK_EQ_U64(beyond, 0); /* the stricter reading keeps a subset */
                if (d >= 3) CHECK(n[2] <= n[1]);
            }
            if (d >= 3 && variant == 0) CHECK(n[2] < n[1]);
            for (i = 0; i < 3; i++) free(kept[i]);
            drop(&l);
        }
    }
    CHECK_MSG(fitting > nearest + nearest / 10, "%u with slopes, %u without", (unsigned)fitting, (unsigned)nearest);
}

TEST(squares_agree_with_blocks) { /* odd d: a sample survives exactly if the painted picture shows it at its own pixel */
    test_rng r = test_rng_make(6);
    zbufrand_canvas_desc a = reconstruct_defaults(90, 70, 5), b = a;
    list l = {NULL, 0, 0};
    reconstruct_view u, v;
    size_t i, wrong = 0, shown = 0;
    scatter(&l, &r, 90, 70, 4, 2500, 0);
    b.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
    u = render(&a, &l);
    v = render(&b, &l);
    for (i = 0; i < l.n; i++) {
        int x = (int)floor((double)l.s[i].x), y = (int)floor((double)l.s[i].y);
        size_t at = (size_t)y * 90 + (size_t)x;
        if (x < 0 || y < 0 || x >= 90 || y >= 70) continue;
        wrong += (u.p.number[at] == i) != (v.p.number[at] == i);
        shown += v.p.number[at] == i;
    }
    CHECK_EQ_U64(wrong, 0);
    CHECK(shown > 100);
    view_free(&u);
    view_free(&v);
    drop(&l);
}

/* Depth tolerance: a flat wall keeps all its samples, a silhouette lets the back side through unless it is dropped. */
TEST(tolerance_and_backs) {
    test_rng r = test_rng_make(7);
    int pass;
    size_t i, counts[4][2];
    memset(counts, 0, sizeof counts);
    for (pass = 0; pass < 4; pass++) { /* nothing, slope, relative, relative and backs dropped */
        zbufrand_canvas_desc d = reconstruct_defaults(128, 128, 8);
        list l = {NULL, 0, 0};
        reconstruct_view v;
        for (i = 0; i < 8000; i++) { /* a tilted wall; in its middle a ball, both sides of it */
            double x = test_rng_double(&r) * 128.0, y = test_rng_double(&r) * 128.0, rho = hypot(x - 64.0, y - 64.0) / 40.0;
            double nz = rho < 1.0 ? sqrt(1.0 - rho * rho) : 0.0;
            zbufrand_sample *s;
            if (rho < 1.0 && (i & 1)) {
                s = add(&l, x, y, 10.0 - nz);
                s->slope_x = (float)((x - 64.0) / 1600.0 / (nz + 1e-3) / -((10.0 - nz) * (10.0 - nz)));
                s->slope_y = (float)((y - 64.0) / 1600.0 / (nz + 1e-3) / -((10.0 - nz) * (10.0 - nz)));
            } else if (rho < 1.0) {
                s = add(&l, x, y, 10.0 + nz);
                s->flags = ZBUFRAND_SAMPLE_BACK;
            } else {
                s = add(&l, x, y, 1.0 / (0.08 + 0.0001 * x));
                s->slope_x = 0.0001f;
            }
        }
        d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
        if (pass == 1) d.reconstruct.tolerance_slope = 0.0f; /* what there is if nothing is asked for */
        if (pass >= 2) d.reconstruct.tolerance = 0.1f;
        d.reconstruct.drop_back = pass == 3;
        v = render(&d, &l);
        for (i = 0; i < 128 * 128; i++) {
            if (v.p.number[i] != ~0u) counts[pass][l.s[v.p.number[i]].flags & ZBUFRAND_SAMPLE_BACK]++;
        }
        view_free(&v);
        drop(&l);
    }
    CHECK_MSG(counts[1][0] > 4 * counts[0][0], "samples used: %u without, %u with the slope", (unsigned)counts[0][0], (unsigned)counts[1][0]);
    CHECK_EQ_U64(counts[1][1], 0); /* the slope lets nothing through: back sides have none here */
    CHECK_MSG(counts[2][1] > 5, "%u back sides through the tolerance", (unsigned)counts[2][1]); /* at the silhouette */
    CHECK_EQ_U64(counts[3][1], 0);
    CHECK(counts[3][0] + counts[3][0] / 8 > counts[2][0]);
}

/* ---- laws of sampled pixels -------------------------------------------------------------------------------------- */

TEST(law_of_a_pixel) { /* random stacks of fragments, 10^5 pixels each: chi-square of which fragment is shown */
    test_rng r = test_rng_make(8);
    int stack, side = test_quick() ? 80 : 316;
    for (stack = 0; stack < 5; stack++) {
        zbufrand_canvas_desc d = reconstruct_defaults((uint32_t)side, (uint32_t)side, 1);
        double area[6], p[6], mu = 0.5 + 4.0 * test_rng_double(&r), empty, chi = 0.0;
        uint32_t layers = 2 + test_rng_below(&r, 5), i, x, y, k, seen[7];
        list l = {NULL, 0, 0};
        reconstruct_view v;
        size_t q, n = (size_t)side * (size_t)side;
        int dof = -1;
        memset(seen, 0, sizeof seen);
        for (i = 0; i < layers; i++) area[i] = test_rng_double(&r);
        for (y = 0; y < (uint32_t)side; y++) {
            for (x = 0; x < (uint32_t)side; x++) {
                for (i = 0; i < layers; i++) {
                    for (k = poisson(&r, mu * area[i]); k > 0; k--) {
                        add(&l, x + test_rng_double(&r), y + test_rng_double(&r), 1.0 + i)->flags = i << 8;
                    }
                }
            }
        }
        v = render(&d, &l);
        for (q = 0; q < n; q++) seen[v.p.number[q] == ~0u ? 6 : l.s[v.p.number[q]].flags >> 8]++;
        empty = zbufrand_pixel_law(area, layers, mu, p);
        for (i = 0; i <= layers; i++) {
            double want = (i < layers ? p[i] : empty) * (double)n, got = seen[i < layers ? i : 6];
            if (want < 5.0) continue;
            chi += (got - want) * (got - want) / want;
            dof++;
        }
        CHECK_MSG(chi < dof + 6.0 * sqrt(2.0 * dof + 4.0), "stack %d: chi-square %g at %d", stack, chi, dof);
        view_free(&v);
        drop(&l);
    }
}

/* A strip of pixels in which two surfaces tilt along x through each pixel. Returns the share of pixels that bleed. */
static double bleed(test_rng *r, uint32_t side, double mu, double ratio, int layers, int plane, double *out_empty) {
    zbufrand_canvas_desc d = reconstruct_defaults(side, side, 1);
    list l = {NULL, 0, 0};
    reconstruct_view v;
    uint32_t x, y, k;
    size_t q, bad = 0, covered = 0;
    int i;
    double tilt = 1e-3; /* 1/z falls by this within a pixel */
    d.reconstruct.plane_depth = (uint32_t)plane;
    for (y = 0; y < side; y++) {
        for (x = 0; x < side; x++) {
            for (i = 0; i <= layers; i++) {
                for (k = poisson(r, mu); k > 0; k--) {
                    double u = test_rng_double(r), w = test_rng_double(r);
                    double inverse = 1.0 - tilt * (u - 0.5) - (i != 0 ? tilt * ratio : 0.0);
                    zbufrand_sample *s = add(&l, x + u, y + w, 1.0 / inverse);
                    /* the position has to be what the depth belongs to: it is rounded to float */
                    s->z = (float)(1.0 / (1.0 - tilt * ((double)s->x - x - 0.5) - (i != 0 ? tilt * ratio : 0.0)));
                    s->slope_x = (float)-tilt;
                    s->flags = (uint32_t)(i != 0) << 8;
                }
            }
        }
    }
    v = render(&d, &l);
    for (q = 0; q < (size_t)side * side; q++) {
        covered += v.p.number[q] != ~0u;
        bad += v.p.number[q] != ~0u && l.s[v.p.number[q]].flags != 0;
    }
    if (out_empty != NULL) *out_empty = 1.0 - (double)covered / ((double)side * side);
    view_free(&v);
    drop(&l);
    return (double)bad / ((double)side * side);
}

TEST(bleeding_law) {
    static const double ratio[5] = {0.0, 0.05, 0.1, 0.3, 0.5};
    test_rng r = test_rng_make(9);
    uint32_t side = test_quick() ? 40 : 130;
    double n = (double)side * side, mu = 6.0;
    int i, k;
    for (k = 1; k <= 4; k++) {
        for (i = 0; i < 5; i++) {
            double want = zbufrand_bleed(mu, ratio[i], 1.0, k), got;
            if (k != 1 && i % 2 == 1) continue;
            got = bleed(&r, side, mu, ratio[i], k, 0, NULL);
            CHECK_MSG(fabs(got - want) < 4.2 * sqrt(want * (1.0 - want) / n) + 1.0 / n, "%d layers, ratio %g: %g is not %g", k, ratio[i], got, want);
        }
    }
}

TEST(planes_do_not_bleed) { /* with the depth of the plane at the pixel's centre, decals 1:2000 and less apart */
    static const double gap[3] = {5e-4, 1e-5, 1e-6}; /* relative to the depth; the tilt within a pixel is 1e-3 */
    test_rng r = test_rng_make(10);
    uint32_t side = test_quick() ? 40 : 110;
    double n = (double)side * side, mu = 6.0;
    int i;
    for (i = 0; i < 3; i++) {
        double with = bleed(&r, side, mu, gap[i] / 1e-3, 1, 1, NULL), without = bleed(&r, side / 2, mu, gap[i] / 1e-3, 1, 0, NULL);
        double missing = exp(-mu); /* a pixel without a sample of the front shows the decal's ground: no one can help it */
        CHECK_MSG(with < missing + 4.2 * sqrt(missing / n) + 1e-4, "gap %g: %g with planes", gap[i], with);
        if (i > 0) CHECK_MSG(without > 0.4, "gap %g: only %g without", gap[i], without);
    }
}

TEST(z_dominance_table) {
    static const double alpha[3] = {0.10, 0.25, 0.50}, mu[5] = {0.1, 1, 3, 7, 13};
    test_rng r = test_rng_make(11);
    uint32_t side = test_quick() ? 40 : 100;
    int i, j, bucket;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 5; j++) {
            for (bucket = 0; bucket < 2; bucket++) { /* a stripe in front of a ground, 0.1 % apart; bucketed depths */
                zbufrand_canvas_desc d = reconstruct_defaults(side, side, 1);
                double want = bucket ? alpha[i] : zbufrand_front_share(alpha[i], mu[j]), got, hits = 0.0, front = 0.0;
                list l = {NULL, 0, 0};
                reconstruct_view v;
                uint32_t x, y, k, seed;
                size_t q;
                d.bucket_bits = bucket ? 6 : 0;
                for (y = 0; y < side; y++) {
                    for (x = 0; x < side; x++) {
                        for (k = poisson(&r, mu[j]); k > 0; k--) {
                            double u = test_rng_double(&r), w = test_rng_double(&r);
                            add(&l, x + u, y + w, u < alpha[i] ? 1.2 : 1.2012)->flags = u < alpha[i];
                        }
                    }
                }
                for (seed = 0; seed < 4; seed++) {
                    v = render_seed(&d, &l, seed);
                    for (q = 0; q < (size_t)side * side; q++) {
                        hits += v.p.number[q] != ~0u;
                        front += v.p.number[q] != ~0u && l.s[v.p.number[q]].flags;
                    }
                    view_free(&v);
                }
                got = front / hits;
                /* the four pictures are of the same samples; borders of buckets fall between the two depths in some */
                CHECK_MSG(fabs(got - want) < 4.2 * sqrt(want * (1.0 - want) / (hits / 4.0)) + (bucket ? 0.001 : 0.0),
                          "share %g density %g bucket %d: %g is not %g", alpha[i], mu[j], bucket, got, want);
                drop(&l);
            }
        }
    }
}

TEST(borders_of_buckets_move) { /* depths on both sides of a power of two are mostly equal, too */
    test_rng r = test_rng_make(28);
    uint32_t side = 60, seeds = 60, seed, k, split = 0;
    zbufrand_canvas_desc d = reconstruct_defaults(side, side, 1);
    list l = {NULL, 0, 0};
    d.bucket_bits = 5;
    for (k = 0; k < side * side * 12; k++) add(&l, test_rng_double(&r) * side, test_rng_double(&r) * side, k & 1 ? 1.9997 : 2.0003)->flags = k & 1;
    for (seed = 0; seed < seeds; seed++) {
        reconstruct_view v = render_seed(&d, &l, seed);
        double front = 0.0, hits = 0.0;
        size_t q;
        for (q = 0; q < (size_t)side * side; q++) {
            hits += v.p.number[q] != ~0u;
            front += v.p.number[q] != ~0u && l.s[v.p.number[q]].flags;
            if (v.p.number[q] != ~0u) CHECK(fabsf(v.p.depth[q] - 2.0f) < 2.0f * 0.033f);
        }
        if (front / hits > 0.7) split++;
        else CHECK_NEAR(front / hits, 0.5, 5.0 * sqrt(0.25 / hits));
        view_free(&v);
    }
    CHECK_MSG(split < 8, "%u of %u pictures keep them apart", split, seeds); /* 2 % are expected */
    drop(&l);
}

TEST(equal_depths_give_the_mean_image) { /* stripes in a plane; power: with keys in order of place it must fail */
    test_rng r = test_rng_make(12);
    enum { W = 24, H = 2 };
    int frames = test_quick() ? 300 : 2500, ordered, f, strata = 8;
    for (ordered = 0; ordered < 2; ordered++) {
        double sum[W * H], worst = 0.0;
        zbufrand_canvas_desc d = reconstruct_defaults(W, H, 1);
        zbufrand_canvas *c = NULL;
        int q;
        memset(sum, 0, sizeof sum);
        CHECK_EQ_U64(zbufrand_canvas_create(&d, &c), ZBUFRAND_OK);
        if (c == NULL) return;
        for (f = 0; f < frames; f++) {
            zbufrand_picture p;
            uint32_t number[W * H], k = 0;
            static zbufrand_sample s[W * H * 8];
            memset(&p, 0, sizeof p);
            p.number = number;
            zbufrand_canvas_clear(c, (uint32_t)f);
            for (q = 0; q < W * H; q++) { /* one sample in each of 8 strips of a pixel, numbers in order of place */
                int i;
                for (i = 0; i < strata; i++, k++) {
                    memset(&s[k], 0, sizeof s[k]);
                    s[k].x = (float)(q % W + (i + test_rng_double(&r)) / strata);
                    s[k].y = (float)(q / W + test_rng_double(&r));
                    s[k].z = 2.0f;
                    if (ordered) {
                        uint64_t *at = &c->recon.canvas.key[q], key = (uint64_t)0x40000000u << 32 | k;
                        if (key < *at) *at = key;
                    }
                }
            }
            if (!ordered) CHECK_EQ_U64(zbufrand_canvas_submit(c, s, k, 0, NULL), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_canvas_resolve(c, NULL, &p, NULL), ZBUFRAND_OK);
            for (q = 0; q < W * H; q++) {
                uint32_t n = ordered ? (uint32_t)c->recon.canvas.key[q] : number[q];
                double x = n < k ? (double)s[n].x : 0.0;
                sum[q] += x * 1.7 - floor(x * 1.7) < 0.5; /* black and white stripes */
            }
        }
        for (q = 0; q < W * H; q++) { /* exact coverage of the stripes */
            double white = 0.0, sigma;
            int i;
            for (i = 0; i < 10000; i++) {
                double x = q % W + (i + 0.5) / 10000.0;
                white += x * 1.7 - floor(x * 1.7) < 0.5;
            }
            white /= 10000.0;
            sigma = sqrt(0.25 / frames);
            worst = fmax(worst, fabs(sum[q] / frames - white) / sigma);
        }
        if (!ordered) CHECK_MSG(worst < 5.0, "off the mean image by %g standard deviations", worst);
        else CHECK_MSG(worst > 10.0, "in order: only %g", worst);
        zbufrand_canvas_destroy(c);
    }
}

TEST(case_of_a_partial_front) { /* A covers a part of the pixel, C behind it but nearer than the rest B */
    test_rng r = test_rng_make(13);
    uint32_t side = test_quick() ? 60 : 200, x, y, k, i;
    double area[3] = {0.4, 0.7, 0.6}, p[3], mu = 3.0, got;
    zbufrand_canvas_desc d = reconstruct_defaults(side, side, 1);
    list l = {NULL, 0, 0};
    reconstruct_view v;
    size_t q, shown = 0, n = (size_t)side * side;
    for (y = 0; y < side; y++) {
        for (x = 0; x < side; x++) {
            for (i = 0; i < 3; i++) {
                for (k = poisson(&r, mu * area[i]); k > 0; k--) add(&l, x + 0.5, y + 0.5, 1.0 + i + 0.5 * test_rng_double(&r))->flags = i;
            }
        }
    }
    v = render(&d, &l);
    for (q = 0; q < n; q++) shown += v.p.number[q] != ~0u && l.s[v.p.number[q]].flags == 1;
    zbufrand_pixel_law(area, 3, mu, p);
    CHECK_NEAR(p[1], exp(-mu * 0.4) * (1.0 - exp(-mu * 0.7)), 1e-15);
    got = (double)shown / (double)n;
    CHECK_MSG(fabs(got - p[1]) < 4.2 * sqrt(p[1] * (1.0 - p[1]) / (double)n), "%g is not %g", got, p[1]);
    view_free(&v);
    drop(&l);
}

/* Shapes at constant depths, on a raster of 8 x 8 points in each pixel: what covers what is known exactly. */
static int reconstruct_covers(int scene, uint32_t k, double x, double y, test_rng *r) {
    double u, v;
    (void)r;
    switch (scene) {
    case 0: return k == 0 ? fmod(x, 3.0) < 1.5 : 1;                                  /* fence before a wall */
    case 1: return fmod(y + 0.37 * k, 1.0) < 0.2;                                    /* slats one behind the other */
    case 2: return (x - 20.0) * (x - 20.0) + (y - 20.0) * (y - 20.0) < 300.0 / (k + 1.0); /* cone of discs, nearest smallest */
    case 3: return (((int)floor(x * 2.3) + (int)floor(y * 2.3)) & 1) == (int)(k & 1); /* chessboard on two depths */
    case 4: return fabs(x - 10.0 - 5.0 * k) + fabs(y - 20.0) < 12.0;                 /* overlapping squares on a corner */
    case 5: return 1;                                                                /* full layers: separated */
    default: /* turned stripes of many widths */
        u = x * cos(0.7 * k + scene) + y * sin(0.7 * k + scene) + 100.0;
        v = 0.3 + 0.4 * k + 0.1 * scene;
        return fmod(u, v) < 0.5 * v;
    }
}

TEST(share_of_wrong_pixels) { /* a pixel that shows what is nowhere visible in it: predicted by the law of the pixel */
    enum { W = 40, H = 40, LAYERS = 6 };
    test_rng r = test_rng_make(31);
    int scene, t, trials = test_quick() ? 4 : 25;
    double mu[2] = {2.0, 6.0};
    for (scene = 0; scene < 12; scene++) {
        static uint64_t mask[H][W][LAYERS];
        uint32_t layers = scene == 0 || scene == 3 ? 2 : scene == 1 ? 6 : 4, x, y, k, b, m;
        for (y = 0; y < H; y++) {
            for (x = 0; x < W; x++) {
                for (k = 0; k < layers; k++) {
                    mask[y][x][k] = 0;
                    for (b = 0; b < 64; b++) {
                        if (reconstruct_covers(scene, k, x + ((b & 7) + 0.5) / 8.0, y + ((b >> 3) + 0.5) / 8.0, &r)) mask[y][x][k] |= (uint64_t)1 << b;
                    }
                }
            }
        }
        for (m = 0; m < 2; m++) {
            zbufrand_canvas_desc d = reconstruct_defaults(W, H, 1);
            double predicted = 0.0, variance = 0.0, wrong = 0.0;
            for (y = 0; y < H; y++) {
                for (x = 0; x < W; x++) {
                    double area[LAYERS], p[LAYERS], bad = 0.0, empty;
                    uint64_t open = ~(uint64_t)0;
                    for (k = 0; k < layers; k++) area[k] = zbufrandi_popcount64(mask[y][x][k]) / 64.0;
                    empty = zbufrand_pixel_law(area, layers, mu[m], p);
                    for (k = 0; k < layers; k++) {
                        if ((mask[y][x][k] & open) == 0) bad += p[k];
                        open &= ~mask[y][x][k];
                    }
                    if (open == 0) bad += empty; /* nothing is shown where no background is visible */
                    predicted += bad;
                    variance += bad * (1.0 - bad);
                }
            }
            for (t = 0; t < trials; t++) {
                list l = {NULL, 0, 0};
                reconstruct_view v;
                for (y = 0; y < H; y++) {
                    for (x = 0; x < W; x++) {
                        for (k = 0; k < layers; k++) {
                            uint32_t n = poisson(&r, mu[m]);
                            for (; n > 0; n--) {
                                b = test_rng_below(&r, 64);
                                if (mask[y][x][k] >> b & 1) add(&l, x + ((b & 7) + 0.5) / 8.0, y + ((b >> 3) + 0.5) / 8.0, 1.0 + k)->flags = k << 8;
                            }
                        }
                    }
                }
                v = render(&d, &l);
                for (y = 0; y < H; y++) {
                    for (x = 0; x < W; x++) {
                        uint32_t n = v.p.number[y * W + x];
                        uint64_t open = ~(uint64_t)0;
                        for (k = 0; k < layers && (n == ~0u || k < l.s[n].flags >> 8); k++) open &= ~mask[y][x][k];
                        if (n == ~0u) wrong += open == 0;
                        else wrong += (open & mask[y][x][k]) == 0;
                    }
                }
                view_free(&v);
                drop(&l);
            }
            CHECK_MSG(fabs(wrong / trials - predicted) < 4.2 * sqrt(variance / trials) + 0.1,
                      "scene %d density %g: %g wrong pixels, predicted %g", scene, mu[m], wrong / trials, predicted);
            if (scene == 5) CHECK_NEAR(predicted, 1600.0 * exp(-mu[m]), 1e-6); /* separated: missing fronts only */
        }
    }
}

TEST(wrong_pixels_of_the_practical_rule) { /* "cells as large as blocks" leaves about d^2 ln 2 wrong pixels at s = 1/2 */
    static const int ds[3] = {2, 3, 5};
    static const double want[3] = {2.83, 6.15, 17.5};
    test_rng r = test_rng_make(15);
    int i, t, trials = test_quick() ? 60 : 700; /* of any size of picture it is the same number */
    for (i = 0; i < 3; i++) {
        zbufrand_canvas_desc d = reconstruct_defaults(80, 60, (uint32_t)ds[i]);
        double v_px = 4800.0, cells = v_px / (ds[i] * ds[i]), m = zbufrand_samples(ZBUFRAND_BOUND_LEMMA3, cells, cells, 1.0, 0.5), wrong = 0.0;
        double guard = ds[i] / 2, all = (80.0 + 2.0 * guard) * (60.0 + 2.0 * guard);
        for (t = 0; t < trials; t++) {
            list l = {NULL, 0, 0};
            reconstruct_view v;
            uint32_t k = 0, n = (uint32_t)(m * all / v_px + sqrt(m) * (test_rng_double(&r) + test_rng_double(&r) + test_rng_double(&r) - 1.5) * 2.0);
            for (k = 0; k < n; k++) add(&l, test_rng_double(&r) * (80.0 + 2.0 * guard) - guard, test_rng_double(&r) * (60.0 + 2.0 * guard) - guard, 1.0);
            v = render(&d, &l);
            wrong += v_px - (double)v.stats.covered;
            view_free(&v);
            drop(&l);
        }
        wrong /= trials;
        CHECK_MSG(fabs(wrong / want[i] - 1.0) < (test_quick() ? 0.6 : 0.1), "d %d: %g wrong pixels, %g expected", ds[i], wrong, want[i]);
    }
}

/* ---- silhouettes ------------------------------------------------------------------------------------------------- */

/* Depths at both ends of what samples may have, steep slopes, all fills: what is shown has a depth, and it is above 0. */
TEST(depths_at_the_ends) {
    static const float ends[4] = {1e-30f, 1.5e-30f, 0.9e30f, 1e30f};
    enum { W = 24, H = 20 };
    test_rng r = test_rng_make(61);
    static float rgba[4 * W * H], depth[W * H];
    uint32_t k, i, n;
    for (k = 0; k < 600; k++) {
        zbufrand_canvas_desc d = reconstruct_defaults(W, H, 1 + k % 5);
        zbufrand_sample s[150];
        zbufrand_canvas *c = NULL;
        zbufrand_source source;
        zbufrand_picture p;
        uint32_t bad = 0, shown = 0;
        d.isa = k % 2 ? ZBUFRAND_ISA_AUTO : ZBUFRAND_ISA_SCALAR;
        d.bucket_bits = k % 3 ? 0 : 1 + k % 22;
        d.reconstruct.fill = (zbufrand_fill)(k / 5 % 6);
        d.reconstruct.occlusion = (zbufrand_occlusion)(k / 30 % 4);
        d.reconstruct.plane_depth = k / 7 % 2;
        d.reconstruct.repair = k / 11 % 2;
        if (zbufrand_canvas_create(&d, &c) != ZBUFRAND_OK) continue;
        memset(s, 0, sizeof s);
        n = 150;
        for (i = 0; i < n; i++) {
            s[i].x = (float)test_rng_range(&r, 0, W);
            s[i].y = (float)test_rng_range(&r, 0, H);
            s[i].z = test_rng_below(&r, 4) ? ends[k / 120 == 4 ? test_rng_below(&r, 4) : k / 120] : 1;
            if (i % 3) s[i].slope_x = test_rng_below(&r, 2) ? 3e38f : -3e38f;
            if (i % 5) s[i].slope_y = test_rng_below(&r, 2) ? 3e38f : -3e38f;
            s[i].rgb[0] = 0.5f;
        }
        CHECK_EQ_U64(zbufrand_canvas_submit(c, s, n, 0, NULL), ZBUFRAND_OK);
        memset(&source, 0, sizeof source);
        memset(&p, 0, sizeof p);
        source.shade_fn = zbufrand_samples_shade;
        source.surface_fn = zbufrand_samples_surface;
        source.user = s;
        p.rgba = rgba;
        p.depth = depth;
        CHECK_EQ_U64(zbufrand_canvas_resolve(c, &source, &p, NULL), ZBUFRAND_OK);
        for (i = 0; i < W * H; i++) {
            bad += !(depth[i] > 0.0f) || !isfinite(rgba[4 * i]);
            shown += depth[i] < INF_F;
        }
        CHECK_MSG(bad == 0 && shown > 8, "%u: %u pixels are wrong, %u shown: fill %d, occlusion %d", k, bad, shown, (int)d.reconstruct.fill,
                  (int)d.reconstruct.occlusion);
        zbufrand_canvas_destroy(c);
    }
}

TEST(silhouettes) { /* a front half plane x < edge before a ground: how far outside is the front shown? */
    test_rng r = test_rng_make(16);
    enum { W = 64, H = 40 };
    int method, t, trials = test_quick() ? 10 : 60, d = 8, i;
    double edge = 32.0, mu = 0.09, grown[3], profile[16]; /* 5.8 samples a block */
    memset(profile, 0, sizeof profile);
    for (method = 0; method < 3; method++) { /* blocks, Voronoi over squares, blocks with planes */
        zbufrand_canvas_desc desc = reconstruct_defaults(W, H, (uint32_t)d);
        double area = 0.0;
        if (method == 1) {
            desc.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
            desc.reconstruct.fill = ZBUFRAND_FILL_VORONOI;
        }
        desc.reconstruct.plane_depth = method == 2;
        for (t = 0; t < trials; t++) {
            list l = {NULL, 0, 0};
            reconstruct_view v;
            uint32_t n = poisson(&r, mu * (W + 40) * (H + 40)), k, layer;
            size_t q;
            for (layer = 0; layer < 2; layer++) {
                for (k = 0; k < n; k++) {
                    double x = test_rng_double(&r) * (W + 40) - 20.0, y = test_rng_double(&r) * (H + 40) - 20.0;
                    if (layer == 0 && x >= edge) continue;
                    add(&l, x, y, layer == 0 ? 1.0 : 2.0)->flags = layer == 0;
                }
            }
            v = render(&desc, &l);
            for (q = 0; q < W * H; q++) {
                int x = (int)(q % W), front = v.p.number[q] != ~0u && l.s[v.p.number[q]].flags;
                area += front - (x < edge);
                if (method == 0 && x >= 32 && x < 48) profile[x - 32] += front;
            }
            view_free(&v);
            drop(&l);
        }
        grown[method] = area / ((double)H * trials);
    }
    for (i = 0; i < 8; i++) {
        /* pixel 32 + i shows the front if a sample lies in the columns [32 + i - hi, 32): hi - i of them */
        double want = 1.0 - exp(-mu * d * (d / 2 - i > 0 ? d / 2 - i : 0)), n = (double)H * trials, got = profile[i] / n;
        /* rows of a block are not independent */
        CHECK_MSG(fabs(got - want) < 4.2 * sqrt((want * (1.0 - want) * d) / n) + 1e-9, "%d pixels outside: %g is not %g", i, got, want);
        CHECK_NEAR(want, zbufrand_block_spill(mu, d, i), 1e-12);
    }
    if (getenv("SHOW")) printf("grown by %g (blocks), %g (Voronoi), %g (planes)\n", grown[0], grown[1], grown[2]);
    CHECK_MSG(grown[0] > 2.7 && grown[0] < 3.3, "blocks grow by %g pixels", grown[0]);
    /* planes keep surfaces apart in depth, they do not cut blocks at the edge of a surface */
    CHECK_MSG(fabs(grown[2] - grown[0]) < 0.2, "blocks with planes grow by %g pixels, blocks by %g", grown[2], grown[0]);
    CHECK_MSG(grown[1] < 0.75 * grown[0], "Voronoi regions grow by %g pixels, blocks by %g", grown[1], grown[0]);
}

/* ---- fills ------------------------------------------------------------------------------------------------------- */

TEST(gauss_against_the_sum) { /* the thesis' sum over all points, one by one */
    static const float radius[4] = {1.0f, 2.5f, 6.0f, 20.0f};
    test_rng r = test_rng_make(17);
    int k, occlusion;
    for (k = 0; k < 4; k++) {
        for (occlusion = 0; occlusion < 3; occlusion += 2) {
            uint32_t w = 61, h = 47, x, y;
            zbufrand_canvas_desc d = reconstruct_defaults(w, h, occlusion ? 4 : 1), e;
            list l = {NULL, 0, 0};
            uint8_t *kept;
            reconstruct_view v;
            double worst = 0.0, c = (double)radius[k];
            uint32_t holes = 0, wrong = 0;
            size_t i;
            scatter(&l, &r, w, h, 20, k == 0 ? 900 : 500, 0);
            d.reconstruct.fill = ZBUFRAND_FILL_GAUSS;
            d.reconstruct.gauss_radius = radius[k];
            d.reconstruct.occlusion = (zbufrand_occlusion)occlusion;
            v = render(&d, &l);
            kept = (uint8_t *)malloc(l.n);
            e = d;
            if (!occlusion) e.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES; /* of one pixel: per pixel */
            survivors(&l, &e, v.guard, kept);
            for (y = 0; y < h; y++) {
                for (x = 0; x < w; x++) {
                    double s[3] = {0, 0, 0}, sum = 0.0, iz = 0.0;
                    size_t at = (size_t)y * w + x;
                    int j;
                    for (i = 0; i < l.n; i++) {
                        double dx = floor((double)l.s[i].x) - x, dy = floor((double)l.s[i].y) - y, f;
                        if (!kept[i] || fabs(dx) >= c || fabs(dy) >= c) continue;
                        f = exp(-(2.25 * dx * dx + 2.25 * dy * dy) / (c * c));
                        for (j = 0; j < 3; j++) s[j] += f * (double)l.s[i].rgb[j];
                        iz += f / (double)l.s[i].z;
                        sum += f;
                    }
                    if (sum == 0.0) {
                        holes++;
                        wrong += v.p.rgba[4 * at + 3] != 0.0f || v.p.rgba[4 * at] != 0.0f || v.p.depth[at] < INF_F;
                        continue;
                    }
                    wrong += v.p.rgba[4 * at + 3] != 1.0f;
                    for (j = 0; j < 3; j++) worst = fmax(worst, fabs(s[j] / sum - (double)v.p.rgba[4 * at + (size_t)j]));
                    worst = fmax(worst, fabs(iz / sum - 1.0 / (double)v.p.depth[at]));
                }
            }
            CHECK_MSG(worst < 2e-6 && wrong == 0, "radius %g: off by %g, %u pixels wrong", c, worst, wrong);
            if (k == 0) CHECK(holes > 20);
            free(kept);
            view_free(&v);
            drop(&l);
        }
    }
    { /* standard deviation 0.471 c; the value where it is cut off */
        float weight[ZBUFRANDI_GAUSS_TAPS];
        int32_t n = zbufrandi_gauss_weights(20.0f, 1.5f, weight), i;
        double m0 = (double)weight[0], m2 = 0.0;
        CHECK_EQ_I64(n, 30);
        for (i = 1; i < n; i++) {
            m0 += 2.0 * (double)weight[i];
            m2 += 2.0 * (double)weight[i] * i * i;
        }
        CHECK_NEAR(sqrt(m2 / m0) / 20.0, 0.471, 0.01);
        CHECK_NEAR((double)weight[20], exp(-2.25), 1e-6);
        CHECK_NEAR((double)weight[29], exp(-2.25 * 29.0 * 29.0 / 400.0), 1e-6);
    }
}

/* Weights by regions: every pixel has the colour of the sample nearest to it, and these are weighted by the Gaussian. Of a smooth
   picture that is closer to its mean around a pixel than the mean of the samples there, as chance has put them. */
TEST(regions_against_the_sum) {
    const uint32_t w = 64, h = 48;
    const double c = 9.0;
    zbufrand_canvas_desc d = reconstruct_defaults(w, h, 1);
    double off[2] = {0, 0}, worst = 0.0;
    uint32_t seed, mode, x, y, n = 0;
    d.reconstruct.gauss_radius = (float)c;
    for (seed = 0; seed < 6; seed++) {
        test_rng r = test_rng_make(500 + seed);
        list l = {NULL, 0, 0};
        uint32_t i;
        for (i = 0; i < 220; i++) {
            zbufrand_sample *s = add(&l, floor(test_rng_double(&r) * w) + 0.5, floor(test_rng_double(&r) * h) + 0.5, 2.0);
            s->rgb[0] = s->x / (float)w; /* a slope across the picture: in its middle the mean is the value there */
            s->rgb[1] = s->rgb[2] = 0.5f;
        }
        for (mode = 0; mode < 2; mode++) {
            reconstruct_view v;
            d.reconstruct.fill = mode ? ZBUFRAND_FILL_REGIONS : ZBUFRAND_FILL_GAUSS;
            v = render(&d, &l);
            for (y = 12; y < h - 12; y++) {
                for (x = 12; x < w - 12; x++) {
                    const double e = (double)v.p.rgba[4 * ((size_t)y * w + x)] - (x + 0.5) / w;
                    off[mode] += e * e;
                    n += mode;
                }
            }
            for (y = 20; mode && seed == 0 && y < 28; y++) { /* the sum itself; of equally near samples any may be taken */
                for (x = 20; x < 44; x++) {
                    double lo = 0.0, hi = 0.0, sum = 0.0, at = (double)v.p.rgba[4 * ((size_t)y * w + x)];
                    int i0, j0;
                    for (j0 = -8; j0 <= 8; j0++) {
                        for (i0 = -8; i0 <= 8; i0++) {
                            const double f = exp(-2.25 * (i0 * i0 + j0 * j0) / (c * c)), px = (double)x + i0 + 0.5, py = (double)y + j0 + 0.5;
                            double best = 1e300, least = 2.0, most = -1.0;
                            for (i = 0; i < l.n; i++) {
                                const double dx = (double)l.s[i].x - px, dy = (double)l.s[i].y - py, q = dx * dx + dy * dy, k = (double)l.s[i].rgb[0];
                                if (q < best) least = most = k;
                                else if (q == best) { least = fmin(least, k); most = fmax(most, k); }
                                best = fmin(best, q);
                            }
                            lo += f * least;
                            hi += f * most;
                            sum += f;
                        }
                    }
                    worst = fmax(worst, fmax(lo / sum - at, at - hi / sum));
                }
            }
            view_free(&v);
        }
        drop(&l);
    }
    CHECK_MSG(worst < 1e-6, "off by %g", worst);
    CHECK_MSG(off[1] < 0.2 * off[0], "RMSE %g by regions, %g without", sqrt(off[1] / n), sqrt(off[0] / n));
}

TEST(fills_keep_a_constant) { /* one colour stays one colour, and one sample fills everything in reach */
    test_rng r = test_rng_make(18);
    int fill;
    for (fill = 1; fill <= 5; fill++) {
        zbufrand_canvas_desc d = reconstruct_defaults(75, 50, 3);
        list l = {NULL, 0, 0};
        reconstruct_view v;
        size_t i, n = 75 * 50, off = 0;
        d.reconstruct.fill = (zbufrand_fill)fill;
        d.reconstruct.gauss_radius = 12.0f;
        d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
        for (i = 0; i < 300; i++) {
            zbufrand_sample *s = add(&l, test_rng_double(&r) * 75.0, test_rng_double(&r) * 50.0, 3.0);
            s->rgb[0] = 0.25f;
            s->rgb[1] = 0.5f;
            s->rgb[2] = 0.75f;
        }
        v = render(&d, &l);
        for (i = 0; i < n; i++) {
            off += fabsf(v.p.rgba[4 * i] - 0.25f) > 1e-5f || fabsf(v.p.rgba[4 * i + 1] - 0.5f) > 1e-5f || v.p.rgba[4 * i + 3] != 1.0f;
            off += fabsf(v.p.depth[i] - 3.0f) > 1e-4f;
        }
        CHECK_MSG(off == 0, "fill %d: %u pixels", fill, (unsigned)off);
        view_free(&v);
        l.n = 0; /* none: all stays empty */
        v = render(&d, &l);
        for (i = 0, off = 0; i < n; i++) off += v.p.rgba[4 * i + 3] != 0.0f || v.p.depth[i] < INF_F || v.p.number[i] != ~0u;
        CHECK_EQ_U64(off, 0);
        view_free(&v);
        add(&l, 20.5, 20.5, 3.0); /* one, with a limit */
        d.reconstruct.reach = fill == 1 ? 0 : 8;
        v = render(&d, &l);
        for (i = 0, off = 0; i < n; i++) {
            double dx = (double)(i % 75) - 20.0, dy = (double)(i / 75) - 20.0;
            int in = fill == 2 ? fabs(dx) + fabs(dy) <= 8.0 : fill == 3 ? dx * dx + dy * dy <= 64.0 : fabs(dx) < 12.0 && fabs(dy) < 12.0;
            if (fill == 5) { /* a disc of 8, and 12 more of the square */
                if (dx * dx + dy * dy <= 64.0) off += v.p.rgba[4 * i + 3] != 1.0f;
                if (fabs(dx) >= 20.0 || fabs(dy) >= 20.0) off += v.p.rgba[4 * i + 3] != 0.0f;
                continue;
            }
            if (fill == 4) { /* a pyramid of cells of 8 pixels: it reaches somewhere between 4 and 16 */
                if (fabs(dx) <= 3.0 && fabs(dy) <= 3.0) off += v.p.rgba[4 * i + 3] != 1.0f;
                if (fabs(dx) > 16.0 || fabs(dy) > 16.0) off += v.p.rgba[4 * i + 3] != 0.0f;
                continue;
            }
            off += (v.p.rgba[4 * i + 3] == 1.0f) != in;
        }
        CHECK_MSG(off == 0, "fill %d: %u pixels out of reach or missing", fill, (unsigned)off);
        view_free(&v);
        drop(&l);
    }
}

/* The thesis' growing regions: a queue, four neighbours. dist: of the result */
static void grow(const uint8_t *seed, uint32_t w, uint32_t h, uint32_t *dist) {
    uint32_t *queue = (uint32_t *)malloc((size_t)w * h * 4), head = 0, tail = 0, i;
    for (i = 0; i < w * h; i++) {
        dist[i] = ~0u;
        if (!seed[i]) continue;
        dist[i] = 0;
        queue[tail++] = i;
    }
    while (head < tail) {
        uint32_t p = queue[head++], x = p % w, y = p / w, k;
        for (k = 0; k < 4; k++) {
            uint32_t u = x + (k == 0) - (k == 1), v = y + (k == 2) - (k == 3);
            if (u >= w || v >= h || dist[v * w + u] != ~0u) continue;
            dist[v * w + u] = dist[p] + 1;
            queue[tail++] = v * w + u;
        }
    }
    free(queue);
}

TEST(voronoi_regions) { /* distances by brute force and by the queue; ties of L1 by the hash */
    test_rng r = test_rng_make(19);
    int k, euclidean;
    for (k = 0; k < 10; k++) {
        for (euclidean = 0; euclidean < 2; euclidean++) {
            uint32_t w = 1 + test_rng_below(&r, 90), h = 1 + test_rng_below(&r, 70), x, y, wrong = 0;
            zbufrand_canvas_desc d = reconstruct_defaults(w, h, 1);
            list l = {NULL, 0, 0};
            reconstruct_view v, u;
            uint32_t *dist;
            uint8_t *seed;
            size_t i, *shown, m = 0;
            if (k == 0) add(&l, 0.5 * w, 0.5 * h, 1.0);
            else scatter(&l, &r, w, h, 0, k == 1 ? 9u * w * h : 1 + test_rng_below(&r, 60), 0);
            for (i = 0; i < l.n; i++) { /* inside only: the queue below knows nothing else */
                l.s[i].x = fminf(fmaxf(l.s[i].x, 0.0f), (float)w - 0.5f);
                l.s[i].y = fminf(fmaxf(l.s[i].y, 0.0f), (float)h - 0.5f);
            }
            u = render(&d, &l);
            d.reconstruct.fill = euclidean ? ZBUFRAND_FILL_VORONOI : ZBUFRAND_FILL_VORONOI_L1;
            v = render(&d, &l);
            dist = (uint32_t *)malloc((size_t)w * h * 4);
            seed = (uint8_t *)malloc((size_t)w * h);
            shown = (size_t *)malloc((size_t)w * h * sizeof *shown);
            for (i = 0; i < (size_t)w * h; i++) {
                seed[i] = u.p.number[i] != ~0u;
                if (seed[i]) shown[m++] = i;
            }
            grow(seed, w, h, dist);
            for (y = 0; y < h; y++) {
                for (x = 0; x < w; x++) {
                    uint64_t best = ~(uint64_t)0, got = 0;
                    uint32_t winner = 0, at = y * w + x, n = v.p.number[at];
                    for (i = 0; i < m; i++) {
                        int64_t dx = (int64_t)(shown[i] % w) - x, dy = (int64_t)(shown[i] / w) - y;
                        uint64_t c = euclidean ? (uint64_t)(dx * dx + dy * dy) : (uint64_t)(llabs(dx) + llabs(dy));
                        uint32_t number = u.p.number[shown[i]];
                        if (number == n) got = c;
                        if (!euclidean) c = c << 32 | zbufrandi_hash32(number ^ zbufrandi_hash32(1));
                        if (c < best) {
                            best = c;
                            winner = number;
                        }
                    }
                    if (n == ~0u) wrong++;
                    else if (euclidean) wrong += got != best;
                    else wrong += winner != n || got != dist[at];
                }
            }
            CHECK_MSG(wrong == 0, "%ux%u, %u samples, %s: %u pixels", w, h, (unsigned)m, euclidean ? "L2" : "L1", wrong);
            free(dist);
            free(seed);
            free(shown);
            view_free(&v);
            view_free(&u);
            drop(&l);
        }
    }
}

/* Bilinear at (x, y) in units of pixels of a level, (0, 0) the centre of the first; clamped at the border. */
static void interpolate(double (*p)[4], int w, int h, double x, double y, double *sum) {
    int m;
    memset(sum, 0, 4 * sizeof *sum);
    for (m = 0; m < 4; m++) {
        int cx = (int)floor(x) + (m & 1), cy = (int)floor(y) + (m >> 1), j;
        double weight = (1.0 - fabs(x - cx)) * (1.0 - fabs(y - cy));
        cx = cx < 0 ? 0 : cx >= w ? w - 1 : cx;
        cy = cy < 0 ? 0 : cy >= h ? h - 1 : cy;
        for (j = 0; j < 4; j++) sum[j] += weight * p[cy * w + cx][j];
    }
}

TEST(pull_push_by_definition) { /* small pictures, level by level in double */
    test_rng r = test_rng_make(20);
    int k;
    for (k = 0; k < 12; k++) {
        uint32_t w = 1 + test_rng_below(&r, 23), h = 1 + test_rng_below(&r, 23), lw[8], lh[8], n = 1, x, y, j, l;
        static double level[8][32 * 32][4];
        float *rgba = (float *)malloc((size_t)w * h * 16), *levels = (float *)malloc(zbufrandi_pull_push_floats(w, h) * 4 + 4);
        zbufrand_env env;
        double worst = 0.0;
        memset(&env, 0, sizeof env);
        env.thread_count = 1;
        lw[0] = w;
        lh[0] = h;
        for (x = 0; x < w * h; x++) {
            float a = test_rng_below(&r, 4) == 0 || x == 0 ? 1.0f : 0.0f;
            for (j = 0; j < 4; j++) {
                rgba[4 * x + j] = j == 3 ? a : a * test_rng_float(&r);
                level[0][x][j] = (double)rgba[4 * x + j];
            }
        }
        for (; lw[n - 1] > 1 || lh[n - 1] > 1; n++) {
            lw[n] = (lw[n - 1] + 1) / 2;
            lh[n] = (lh[n - 1] + 1) / 2;
            memset(level[n], 0, sizeof level[n]);
            for (y = 0; y < lh[n - 1]; y++) {
                for (x = 0; x < lw[n - 1]; x++) {
                    for (j = 0; j < 4; j++) level[n][(y / 2) * lw[n] + x / 2][j] += level[n - 1][y * lw[n - 1] + x][j];
                }
            }
            for (x = 0; x < lw[n] * lh[n]; x++) {
                double s = level[n][x][3] > 1.0 ? 1.0 / level[n][x][3] : 1.0;
                for (j = 0; j < 4; j++) level[n][x][j] *= s;
            }
        }
        for (l = n - 1; l-- > 0;) {
            for (y = 0; y < lh[l]; y++) {
                for (x = 0; x < lw[l]; x++) {
                    double sum[4], *p = level[l][y * lw[l] + x];
                    interpolate(level[l + 1], (int)lw[l + 1], (int)lh[l + 1], (x + 0.5) / 2.0 - 0.5, (y + 0.5) / 2.0 - 0.5, sum);
                    for (j = 0; j < 3; j++) p[j] += (1.0 - p[3]) * sum[j] / sum[3];
                    p[3] = 1.0;
                }
            }
        }
        zbufrandi_pull_push_run(&env, NULL, rgba, w, h, levels, 0);
        for (x = 0; x < w * h; x++) {
            for (j = 0; j < 4; j++) {
                double e = fabs(level[0][x][j] - (double)rgba[4 * x + j]);
                if (!(e <= worst)) worst = e; /* NaN, too; fmax here breaks gcc 12 for aarch64 */
            }
        }
        CHECK_MSG(worst < 2e-6, "%ux%u: off by %g", w, h, worst);
        free(rgba);
        free(levels);
    }
}

/* ---- blocks that follow their surface ---------------------------------------------------------------------------- */

TEST(blocks_with_planes) { /* by definition, and what they are for: a decal above a tilted ground */
    test_rng r = test_rng_make(21);
    int k, isa;
    for (k = 0; k < 8; k++) {
        uint32_t w = 20 + test_rng_below(&r, 30), h = 20, x, y, d = 1 + test_rng_below(&r, 7), salt = zbufrandi_hash32(1);
        zbufrand_canvas_desc desc = reconstruct_defaults(w, h, d);
        list l = {NULL, 0, 0};
        int lo = (int)(d - 1) / 2, hi = (int)d / 2;
        scatter(&l, &r, w, h, d, 500, k & 1 ? 2 : 0);
        for (x = 0; x < l.n; x++) {
            if (k & 1) l.s[x].slope_x = l.s[x].slope_y = 0.0f; /* ties */
            if (k & 2) l.s[x].slope_x *= 40.0f;                /* too steep to be trusted */
        }
        for (isa = ZBUFRAND_ISA_SCALAR; isa <= ZBUFRAND_ISA_AVX2; isa += 2) {
            reconstruct_view v;
            uint32_t wrong = 0;
            desc.isa = (zbufrand_isa)isa;
            desc.reconstruct.plane_depth = 1;
            v = render(&desc, &l);
            for (y = 0; y < h; y++) {
                for (x = 0; x < w; x++) {
                    float best = 0.0f;
                    uint32_t hash = ~0u, who = ~0u;
                    int i, j;
                    for (j = (int)y - hi; j <= (int)y + lo; j++) {
                        for (i = (int)x - hi; i <= (int)x + lo; i++) { /* the winner of pixel (i, j), then its plane here */
                            uint64_t key = ~(uint64_t)0;
                            uint32_t m, n;
                            float iz, at;
                            for (m = 0; m < l.n; m++) {
                                const zbufrand_sample *s = &l.s[m];
                                uint64_t other;
                                if ((int)floor((double)s->x) != i || (int)floor((double)s->y) != j) continue;
                                other = zbufrandi_key(zbufrandi_plane_depth(s->z, (double)s->x, (double)s->y, (double)s->slope_x,
                                                                            (double)s->slope_y, i, j), m ^ salt);
                                if (other < key) key = other;
                            }
                            if (key == ~(uint64_t)0) continue;
                            n = zbufrandi_key_number(key) ^ salt;
                            iz = 1.0f / zbufrandi_key_depth(key);
                            if (d == 1) at = iz;
                            else at = iz + (l.s[n].slope_x * (float)((int)x - i) + l.s[n].slope_y * (float)((int)y - j));
                            at = fminf(fmaxf(at, 0.5f * iz), 2.0f * iz);
                            if (at > best || (at == best && (uint32_t)key < hash)) {
                                best = at;
                                hash = (uint32_t)key;
                                who = n;
                            }
                        }
                    }
                    wrong += v.p.number[y * w + x] != who;
                    if (who != ~0u) wrong += fabsf(v.p.depth[y * w + x] * best - 1.0f) > 1e-6f;
                }
            }
            CHECK_MSG(wrong == 0, "d %u isa %d: %u pixels", d, isa, wrong);
            view_free(&v);
        }
        drop(&l);
    }
    for (k = 0; k < 2; k++) { /* 1/z falls by 2 % a pixel; the decal lies 0.2 % in front: blocks of 3 x 3 */
        zbufrand_canvas_desc desc = reconstruct_defaults(100, 100, 3);
        list l = {NULL, 0, 0};
        reconstruct_view v;
        double bad = 0.0;
        size_t i;
        desc.reconstruct.plane_depth = (uint32_t)k;
        for (i = 0; i < 30000; i++) {
            double x = test_rng_double(&r) * 104.0 - 2.0, y = test_rng_double(&r) * 104.0 - 2.0, iz = 3.0 - 0.02 * x;
            zbufrand_sample *s = add(&l, x, y, 1.0 / (i & 1 ? iz : iz * 1.002));
            s->slope_x = -0.02f;
            s->flags = (uint32_t)(i & 1) << 8;
        }
        v = render(&desc, &l);
        for (i = 0; i < 10000; i++) bad += v.p.number[i] != ~0u && l.s[v.p.number[i]].flags != 0;
        if (k == 0) CHECK_MSG(bad > 1500.0, "flat blocks: %g pixels bleed", bad);
        else CHECK_MSG(bad < 10.0, "with planes: %g pixels bleed", bad);
        view_free(&v);
        drop(&l);
    }
}

/* ---- layered coverage -------------------------------------------------------------------------------------------- */

static int inside_stripe(double u, double alpha) { return u - floor(u) < alpha; }

TEST(layered_coverage) {
    static const double alpha[5] = {0.1, 0.25, 0.5, 0.9, 1.0};
    test_rng r = test_rng_make(22);
    int i, stratified;
    uint32_t side = test_quick() ? 30 : 60;
    for (stratified = 0; stratified < 2; stratified++) {
        for (i = 0; i < 5; i++) { /* stripes within each pixel before a ground; colours 1 and 0 */
            zbufrand_layers_desc d;
            zbufrand_layers *l = NULL;
            list s = {NULL, 0, 0};
            float *rgba = (float *)malloc((size_t)side * side * 16), *coverage = (float *)malloc((size_t)side * side * 8);
            double mu = 13.0, mean = 0.0, opaque = 0.0, tol;
            uint32_t x, y, k, layer, rounds = 0;
            size_t q, n = (size_t)side * side;
            memset(&d, 0, sizeof d);
            d.env.thread_count = 2;
            d.width = d.height = side;
            d.density = (float)mu;
            d.dispersion = stratified ? 0.3f : 0.0f;
            for (y = 0; y < side; y++) {
                for (x = 0; x < side; x++) {
                    for (layer = 0; layer < 2; layer++) {
                        uint32_t m = stratified ? (uint32_t)mu : poisson(&r, mu);
                        for (k = 0; k < m; k++) {
                            double u = stratified ? (k + test_rng_double(&r)) / mu : test_rng_double(&r), w = test_rng_double(&r);
                            zbufrand_sample *t;
                            if (layer == 0 && !inside_stripe(u, alpha[i])) continue;
                            t = add(&s, x + u, y + w, layer ? 2.0 : 1.0);
                            t->rgb[0] = t->rgb[1] = t->rgb[2] = layer ? 0.0f : 1.0f;
                        }
                    }
                }
            }
            CHECK_EQ_U64(zbufrand_layers_create(&d, &l), ZBUFRAND_OK);
            if (l == NULL) return;
            do {
                CHECK_EQ_U64(zbufrand_layers_submit(l, s.s, s.n), ZBUFRAND_OK);
                rounds++;
            } while (zbufrand_layers_next(l));
            CHECK_EQ_U64(rounds, 3);
            CHECK_EQ_U64(zbufrand_layers_resolve(l, rgba, coverage), ZBUFRAND_OK);
            for (q = 0; q < n; q++) {
                mean += (double)rgba[4 * q];
                opaque += (double)rgba[4 * q + 3];
                CHECK(coverage[2 * q] >= 0.0f && coverage[2 * q] <= 1.0f);
            }
            mean /= (double)n;
            opaque /= (double)n;
            tol = i == 3 ? 0.1 : stratified ? 0.02 : 0.03;
            CHECK_MSG(fabs(mean - alpha[i]) < tol, "front covers %g: shown %g (stratified %d)", alpha[i], mean, stratified);
            CHECK_MSG(opaque > 0.985, "front covers %g: alpha %g", alpha[i], opaque);
            zbufrand_layers_destroy(l);
            free(rgba);
            free(coverage);
            drop(&s);
        }
    }
}

typedef struct layer_feeder { zbufrand_layers *l; const list *s; int reverse; } layer_feeder;
static void feed_layers(void *user, uint32_t task) {
    layer_feeder *f = (layer_feeder *)user;
    size_t i;
    for (i = task; i < f->s->n; i += 8) zbufrand_layers_submit(f->l, &f->s->s[f->reverse ? f->s->n - 1 - i : i], 1);
}

TEST(layers_same_bits) {
    test_rng r = test_rng_make(23);
    list s = {NULL, 0, 0};
    uint64_t first = 0;
    uint32_t t;
    scatter(&s, &r, 50, 40, 3, 20000, 3);
    for (t = 0; t < 4; t++) {
        zbufrand_layers_desc d;
        zbufrand_layers *l = NULL;
        layer_feeder f;
        zbufrand_env env;
        float *rgba = (float *)malloc(50 * 40 * 16);
        size_t i;
        memset(&d, 0, sizeof d);
        memset(&env, 0, sizeof env);
        env.thread_count = d.env.thread_count = 1 + 2 * t;
        d.width = 50;
        d.height = 40;
        d.layers = 3;
        d.density = 8.0f;
        CHECK_EQ_U64(zbufrand_layers_create(&d, &l), ZBUFRAND_OK);
        if (l == NULL) return;
        f.l = l;
        f.s = &s;
        f.reverse = t & 1;
        zbufrand_layers_clear(l);
        do zbufrandi_parallel_for(&env, feed_layers, &f, 8); while (zbufrand_layers_next(l));
        CHECK_EQ_U64(zbufrand_layers_resolve(l, rgba, NULL), ZBUFRAND_OK);
        if (t == 0) first = test_fnv1a(rgba, 50 * 40 * 16, 0);
        CHECK_EQ_U64(test_fnv1a(rgba, 50 * 40 * 16, 0), first);
        for (i = 0; i < 50 * 40 * 4; i++) CHECK(rgba[i] >= 0.0f && rgba[i] <= 1.001f);
        zbufrand_layers_destroy(l);
        free(rgba);
    }
    drop(&s);
}

/* ---- suspicious pixels ------------------------------------------------------------------------------------------- */

/* Scenes of known depth: what is seen at (x, y). Returns the front depth, INFINITY for background; *second: the surface
   behind it. */
static double scene_depth(int scene, double x, double y, double *second) {
    double dx = x - 100.0, dy = y - 75.0, ground = y > 60.0 ? 300.0 / (y - 50.0) : (double)INFINITY;
    *second = (double)INFINITY;
    switch (scene) {
    case 0: /* a wall with a wide window, background behind */
        return fabs(dx) < 20.0 && fabs(dy) < 12.0 ? (double)INFINITY : 5.0 + 0.01 * x;
    case 1: /* a ball before a ground plane */
        if (dx * dx + dy * dy < 1600.0) {
            *second = ground;
            return 6.0 - 1.0 * sqrt(1.0 - (dx * dx + dy * dy) / 1600.0);
        }
        return ground;
    case 2: /* a fence of bars of 6 and gaps of 5 pixels before a wall */
        if (fmod(x, 11.0) < 6.0) {
            *second = 8.0 + 0.005 * y;
            return 4.0;
        }
        return 8.0 + 0.005 * y;
    case 4: /* a jalousie: slats of 8 pixels, each turned so that its lower edge is nearer by a sixth, a wall behind */
        *second = 12.0;
        return 6.0 / (1.0 + 0.02 * fmod(y, 8.0));
    case 5: /* a decal a two-thousandth before a wall: what bleeds through is no pixel to mend */
        if (fabs(dx) < 40.0 && fabs(dy) < 30.0) {
            *second = 5.0;
            return 5.0 * (1.0 - 1.0 / 2000.0);
        }
        return 5.0;
    default: /* corner of a room: two walls and a floor, seen from within; a valley everywhere */
        return 1.0 / fmax(fmax(0.1 + 0.0008 * x, 0.26 - 0.0008 * x), 0.0022 * y);
    }
}

typedef struct found { double recall_holes, recall_wrong, false_holes, false_wrong; size_t holes, wrong; } found;

static found detect(int scene, double mu, uint64_t seed) {
    enum { W = 200, H = 150 };
    test_rng r = test_rng_make(seed);
    zbufrand_suspect_desc d;
    float *depth = (float *)malloc(W * H * 4);
    uint8_t *truth = (uint8_t *)calloc(W * H, 1), *flag = (uint8_t *)calloc(W * H, 1);
    zbufrand_suspect *list_of = (zbufrand_suspect *)malloc(W * H * sizeof *list_of);
    size_t count = 0, i;
    found f;
    uint32_t x, y, k, found_holes = 0, found_wrong = 0, clear = 0, right = 0;
    memset(&f, 0, sizeof f);
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.width = W;
    d.height = H;
    for (y = 0; y < H; y++) {
        for (x = 0; x < W; x++) {
            double best = (double)INFINITY, second, front_all = 0.0, back = 0.0;
            int edge = 0, i8, j8;
            for (k = poisson(&r, mu); k > 0; k--) { /* both surfaces are sampled alike */
                double z = scene_depth(scene, x + test_rng_double(&r), y + test_rng_double(&r), &second);
                if (z < best) best = z;
                front_all = 1.0;
            }
            for (k = poisson(&r, mu); k > 0; k--) {
                (void)scene_depth(scene, x + test_rng_double(&r), y + test_rng_double(&r), &second);
                if (second < best) best = second;
            }
            depth[y * W + x] = (float)best;
            back = scene_depth(scene, x + 0.5, y + 0.5, &second);
            for (j8 = -1; j8 <= 2; j8++) { /* within a pixel of a silhouette everything is allowed */
                for (i8 = -1; i8 <= 2; i8++) {
                    double z = scene_depth(scene, (double)x + i8, (double)y + j8, &second);
                    if (!(z == back || fabs(z - back) < 0.15 * fmin(z, back) + 0.0)) edge = 1;
                }
            }
            (void)front_all;
            if (edge) truth[y * W + x] = 9;
            else if (!(back < (double)INFINITY)) truth[y * W + x] = 3;          /* background */
            else if (!(best < (double)INFINITY)) truth[y * W + x] = 1;          /* covered but empty */
            else if (best > back * 1.06) truth[y * W + x] = 2;                  /* shows what is behind */
        }
    }
    CHECK_EQ_U64(zbufrand_find_suspects(&d, depth, list_of, W * H, &count), ZBUFRAND_OK);
    for (i = 0; i < count; i++) {
        flag[list_of[i].pixel] = (uint8_t)list_of[i].kind;
        if (i > 0) CHECK(list_of[i].pixel > list_of[i - 1].pixel);
    }
    for (i = 0; i < W * H; i++) {
        f.holes += truth[i] == 1;
        f.wrong += truth[i] == 2;
        found_holes += truth[i] == 1 && flag[i] == 1;
        found_wrong += truth[i] == 2 && flag[i] == 2;
        clear += truth[i] == 3;
        right += truth[i] == 0;
        f.false_holes += truth[i] == 3 && flag[i] != 0;
        f.false_wrong += truth[i] == 0 && flag[i] != 0;
    }
    f.recall_holes = f.holes ? (double)found_holes / (double)f.holes : 1.0;
    f.recall_wrong = f.wrong ? (double)found_wrong / (double)f.wrong : 1.0;
    f.false_holes /= clear ? clear : 1;
    f.false_wrong /= right ? right : 1;
    free(depth);
    free(truth);
    free(flag);
    free(list_of);
    return f;
}

TEST(suspects) {
    int scene, t, trials = test_quick() ? 1 : 4;
    static const double mu[3] = {2.0, 3.0, 4.6};
    int m;
    for (scene = 0; scene < 6; scene++) {
        for (m = 0; m < 3; m++) {
            double holes = 0, wrong = 0, found_holes = 0, found_wrong = 0, false_holes = 0, false_wrong = 0;
            for (t = 0; t < trials; t++) {
                found f = detect(scene, mu[m], (uint64_t)(100 * scene + 10 * m + t));
                holes += (double)f.holes;
                wrong += (double)f.wrong;
                found_holes += f.recall_holes * (double)f.holes;
                found_wrong += f.recall_wrong * (double)f.wrong;
                false_holes += f.false_holes / trials;
                false_wrong += f.false_wrong / trials;
            }
            if (getenv("SHOW")) printf("scene %d mu %g: holes %g of %g, wrong %g of %g, false holes %g, false wrong %g\n",
                                       scene, mu[m], found_holes, holes, found_wrong, wrong, false_holes, false_wrong);
            if (holes > 0) CHECK_MSG(found_holes >= (mu[m] > 2.5 ? 0.999 : 0.995) * holes - 2.0,
                                     "scene %d density %g: %g of %g holes", scene, mu[m], found_holes, holes);
            if (wrong > 0) CHECK_MSG(found_wrong >= (mu[m] > 4.0 ? 0.97 : mu[m] > 2.5 ? 0.9 : 0.7) * wrong - 2.0,
                                     "scene %d density %g: %g of %g wrong", scene, mu[m], found_wrong, wrong);
            CHECK_MSG(false_holes == 0.0, "scene %d density %g: %g of the background suspected", scene, mu[m], false_holes);
            CHECK_MSG(false_wrong < 0.003, "scene %d density %g: %g of the right pixels suspected", scene, mu[m], false_wrong);
        }
    }
}

TEST(gaps_are_left_alone) { /* bars with gaps of 1, 2, 3 pixels; fully sampled */
    enum { W = 60, H = 40 };
    int gap, behind;
    for (behind = 0; behind < 2; behind++) {
        for (gap = 1; gap <= 4; gap++) {
            float depth[W * H];
            zbufrand_suspect_desc d;
            size_t n = 0, open = 0, i;
            memset(&d, 0, sizeof d);
            d.env.thread_count = 1;
            d.width = W;
            d.height = H;
            for (i = 0; i < W * H; i++) {
                int in_gap = (int)(i % W) % (6 + gap) >= 6;
                depth[i] = in_gap ? (behind ? 9.0f : INF_F) : 3.0f;
                open += (size_t)in_gap;
            }
            CHECK_EQ_U64(zbufrand_find_suspects(&d, depth, NULL, 0, &n), ZBUFRAND_OK);
            if (gap == 1) CHECK_MSG(n > open * 9 / 10, "gap of one pixel: %u of %u", (unsigned)n, (unsigned)open); /* left to rays */
            else CHECK_EQ_U64(n, 0);
        }
    }
}

TEST(mending) { /* a wall with holes and see-through pixels gets its own colour and depth back */
    enum { W = 80, H = 60 };
    test_rng r = test_rng_make(24);
    float *rgba = (float *)malloc(W * H * 16), *depth = (float *)malloc(W * H * 4);
    zbufrand_suspect *s = (zbufrand_suspect *)malloc(W * H * sizeof *s);
    zbufrand_suspect_desc d;
    size_t n = 0, i, off = 0, left = 0;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.width = W;
    d.height = H;
    for (i = 0; i < W * H; i++) {
        uint32_t what = test_rng_below(&r, 20);
        rgba[4 * i] = what == 1 ? 1.0f : 0.25f;
        rgba[4 * i + 1] = rgba[4 * i + 2] = 0.0f;
        rgba[4 * i + 3] = what == 0 ? 0.0f : 1.0f;
        if (what == 0) rgba[4 * i] = 0.0f;
        depth[i] = what == 0 ? INF_F : what == 1 ? 20.0f : 1.0f / (0.2f + 0.0005f * (float)(i % W));
    }
    CHECK_EQ_U64(zbufrand_find_suspects(&d, depth, s, W * H, &n), ZBUFRAND_OK);
    CHECK(n > 300 && n < 700);
    CHECK_EQ_U64(zbufrand_mend(&d, rgba, depth, s, n), ZBUFRAND_OK);
    for (i = 0; i < W * H; i++) {
        float want = 1.0f / (0.2f + 0.0005f * (float)(i % W));
        if (!(depth[i] < 10.0f)) left++;
        else off += fabsf(depth[i] - want) > 0.012f * want || fabsf(rgba[4 * i] - 0.25f) > 1e-6f || rgba[4 * i + 3] != 1.0f;
    }
    { /* their number is looked at before what they are */
        zbufrand_suspect *one = (zbufrand_suspect *)calloc(1, sizeof *one);
        CHECK(one != NULL && zbufrand_mend(&d, rgba, depth, one, W * H + 1) == ZBUFRAND_ERR_INVALID_ARG);
        free(one);
    }
    CHECK_EQ_U64(off, 0);
    CHECK_MSG(left < 40, "%u pixels are left", (unsigned)left); /* at the border of the picture and in clusters */
    free(rgba);
    free(depth);
    free(s);
}

static uint8_t suspect_of(const float *depth, const uint8_t *holes, uint32_t w, uint32_t h, uint32_t x, uint32_t y, const zbufrand_suspect_desc *d) {
    static const int dx[8] = {1, 1, 0, -1, -1, -1, 0, 1}, dy[8] = {0, 1, 1, 1, 0, -1, -1, -1};
    uint32_t hole = d->hole_count ? d->hole_count : 4, wrong = d->wrong_count ? d->wrong_count : 5, n = 0, k, i, sides = 0;
    float z = depth[y * w + x], keep = 1.0f - 0.01f, at[8], x1;
    for (k = 0; k < 8; k++) {
        uint32_t u = x + (uint32_t)dx[k], v = y + (uint32_t)dy[k], u2 = u + (uint32_t)dx[k], v2 = v + (uint32_t)dy[k];
        float z1 = u < w && v < h ? depth[v * w + u] : INF_F, z2 = u2 < w && v2 < h ? depth[v2 * w + u2] : INF_F;
        if (!(z < INF_F)) {
            n += z1 < INF_F || (u < w && v < h && holes[v * w + u]);
            continue;
        }
        if (!(z1 < z * keep)) continue;
        if (z2 < z1 && !((2.0f / z1 - 1.0f / z2) * (z * keep) > 1.0f)) continue;
        at[n++] = z1;
        sides |= 1u << k;
    }
    if (!(z < INF_F)) return n >= hole;
    if (n < wrong) return 0;
    for (i = 0; i < n; i++) {
        for (k = i + 1; k < n; k++) {
            if (at[k] > at[i]) {
                x1 = at[i];
                at[i] = at[k];
                at[k] = x1;
            }
        }
    }
    return (sides & (sides >> 4)) != 0 && z - at[0] >= at[0] - at[wrong - 1] ? 2 : 0;
}

TEST(suspects_same_bits) { /* and by definition */
    test_rng r = test_rng_make(25);
    int k;
    for (k = 0; k < 30; k++) {
        uint32_t w = 1 + test_rng_below(&r, 70), h = 1 + test_rng_below(&r, 60), i;
        float *depth = (float *)malloc((size_t)w * h * 4);
        zbufrand_suspect *a = (zbufrand_suspect *)malloc((size_t)w * h * sizeof *a), *b = (zbufrand_suspect *)malloc((size_t)w * h * sizeof *b);
        zbufrand_suspect_desc d;
        size_t n = 0, m = 0;
        memset(&d, 0, sizeof d);
        d.width = w;
        d.height = h;
        d.hole_count = test_rng_below(&r, 9);
        d.wrong_count = test_rng_below(&r, 2) ? 0 : 2 + test_rng_below(&r, 8);
        d.hole_rounds = test_rng_below(&r, 9);
        for (i = 0; i < w * h; i++) depth[i] = test_rng_below(&r, 3) == 0 ? INF_F : 1.0f + 0.02f * (float)test_rng_below(&r, 4) + (float)test_rng_below(&r, 2);
        for (i = 0; i < w * h && k % 3 == 2; i += 1 + test_rng_below(&r, 20)) depth[i] = (float)NAN; /* empty, too */
        d.env.thread_count = 1;
        d.isa = ZBUFRAND_ISA_SCALAR;
        CHECK_EQ_U64(zbufrand_find_suspects(&d, depth, a, (size_t)w * h, &n), ZBUFRAND_OK);
        d.env.thread_count = 3;
        d.isa = ZBUFRAND_ISA_AUTO;
        CHECK_EQ_U64(zbufrand_find_suspects(&d, depth, b, (size_t)w * h, &m), ZBUFRAND_OK);
        CHECK_EQ_U64(n, m);
        if (n == m) CHECK_EQ_U64(memcmp(a, b, n * sizeof *a), 0);
        {
            uint8_t *found_so_far = (uint8_t *)calloc((size_t)w * h, 1), *next = (uint8_t *)calloc((size_t)w * h, 1);
            uint32_t round, x, y;
            for (round = 0; round < (d.hole_rounds ? d.hole_rounds : 2); round++) {
                for (y = 0; y < h; y++) {
                    for (x = 0; x < w; x++) {
                        if (!next[y * w + x]) next[y * w + x] = suspect_of(depth, found_so_far, w, h, x, y, &d);
                    }
                }
                for (i = 0; i < w * h; i++) found_so_far[i] = next[i] == 1;
            }
            for (i = 0, m = 0; i < w * h; i++) {
                if (next[i]) {
                    CHECK(m < n && a[m].pixel == i && a[m].kind == next[i]);
                    m++;
                }
            }
            CHECK_EQ_U64(m, n);
            free(found_so_far);
            free(next);
        }
        free(depth);
        free(a);
        free(b);
    }
}

/* ---- projecting -------------------------------------------------------------------------------------------------- */

static void turned_view(zbufrand_view *v) { /* from (1, 2, 3) */
    double c = cos(0.7), t = sin(0.7), m[3][3], eye[3] = {1.0, 2.0, 3.0};
    int i, k;
    memset(v, 0, sizeof *v);
    m[0][0] = c; m[0][1] = 0; m[0][2] = t;
    m[1][0] = 0; m[1][1] = 1; m[1][2] = 0;
    m[2][0] = -t; m[2][1] = 0; m[2][2] = c;
    for (i = 0; i < 3; i++) {
        for (k = 0; k < 3; k++) v->world_to_camera[i][k] = m[i][k];
        v->world_to_camera[i][3] = -(m[i][0] * eye[0] + m[i][1] * eye[1] + m[i][2] * eye[2]);
    }
    v->focal = 200.0;
    v->center_x = 200.0;
    v->center_y = 150.0;
    v->near_z = 0.1;
    v->far_z = 30.0;
}

/* Samples of 50 points against the pinhole camera in double; point 1 is no number. */
static void check_projected(const zbufrand_view *v, const zbufrand_points *p, const zbufrand_sample *s) {
    int i, k;
    for (i = 0; i < 50; i++) {
        double q[3], n[3], d, iz0, iz1;
        for (k = 0; k < 3; k++) {
            const double *m = v->world_to_camera[k];
            q[k] = m[0] * (double)p->positions[3 * i] + m[1] * (double)p->positions[3 * i + 1] + m[2] * (double)p->positions[3 * i + 2] + m[3];
            n[k] = m[0] * (double)p->normals[3 * i] + m[1] * (double)p->normals[3 * i + 1] + m[2] * (double)p->normals[3 * i + 2];
        }
        if (i == 1 || q[2] < 0.1 || q[2] > 30.0) {
            CHECK(s[i].z == 0.0f);
            continue;
        }
        CHECK_NEAR(s[i].z, q[2], 1e-5);
        CHECK_NEAR(s[i].x, 200.0 + 200.0 * q[0] / q[2], 1e-3 * (1.0 + fabs(q[0] / q[2])));
        CHECK_NEAR(s[i].y, 150.0 - 200.0 * q[1] / q[2], 1e-3 * (1.0 + fabs(q[1] / q[2])));
        d = n[0] * q[0] + n[1] * q[1] + n[2] * q[2];
        CHECK((s[i].flags == ZBUFRAND_SAMPLE_BACK) == (d > 0.0));
        /* slope: move one pixel along the plane */
        iz0 = (n[0] * (q[0] / q[2]) + n[1] * (q[1] / q[2]) + n[2]) / d;
        iz1 = (n[0] * (q[0] / q[2] + 1.0 / 200.0) + n[1] * (q[1] / q[2]) + n[2]) / d;
        CHECK_NEAR(s[i].slope_x, iz1 - iz0, 1e-6 * (1.0 + fabs(iz1 - iz0)));
        iz1 = (n[0] * (q[0] / q[2]) + n[1] * (q[1] / q[2] - 1.0 / 200.0) + n[2]) / d;
        CHECK_NEAR(s[i].slope_y, iz1 - iz0, 1e-6 * (1.0 + fabs(iz1 - iz0)));
        CHECK_NEAR(s[i].rgb[0], zbufrandi_srgb_to_linear(p->rgb[3 * i] / 255.0), 1e-6);
    }
}

/* Submitted in one go or by hand: the same picture. */
static void submitted_in_one_go(const zbufrand_view *v, zbufrand_points *p, const zbufrand_sample *s) {
    zbufrand_canvas_desc d = reconstruct_defaults(400, 300, 2);
    zbufrand_canvas *a = NULL, *b = NULL;
    zbufrand_source source;
    zbufrand_picture pic;
    zbufrand_submit_stats st;
    static uint32_t one[400 * 300], two[400 * 300];
    static float color[400 * 300 * 4];
    int i;
    memset(&pic, 0, sizeof pic);
    memset(&source, 0, sizeof source);
    memset(&st, 0, sizeof st);
    CHECK_EQ_U64(zbufrand_canvas_create(&d, &a), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_canvas_create(&d, &b), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_canvas_submit_points(a, v, p, 0, &st), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_canvas_submit(b, s, 50, 0, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(st.accepted + st.outside + st.bad, 50);
    CHECK(st.accepted > 3);
    source.shade_fn = zbufrand_points_shade;
    source.user = p;
    pic.number = one;
    pic.rgba = color;
    CHECK_EQ_U64(zbufrand_canvas_resolve(a, &source, &pic, NULL), ZBUFRAND_OK);
    pic.number = two;
    pic.rgba = NULL;
    CHECK_EQ_U64(zbufrand_canvas_resolve(b, NULL, &pic, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(memcmp(one, two, sizeof one), 0);
    for (i = 0; i < 400 * 300; i++) if (one[i] != ~0u) CHECK(color[4 * i] == s[one[i]].rgb[0] && color[4 * i + 2] == s[one[i]].rgb[2]);
    zbufrand_canvas_destroy(a);
    zbufrand_canvas_destroy(b);
}

TEST(projection) {
    test_rng r = test_rng_make(26);
    zbufrand_view v;
    zbufrand_points p;
    float positions[3 * 50], normals[3 * 50];
    uint8_t rgb[3 * 50];
    zbufrand_sample s[50];
    int i, k;
    turned_view(&v);
    memset(&p, 0, sizeof p);
    for (i = 0; i < 150; i++) {
        positions[i] = test_rng_range(&r, -8.0f, 8.0f);
        normals[i] = test_rng_range(&r, -1.0f, 1.0f);
        rgb[i] = (uint8_t)test_rng_below(&r, 256);
    }
    positions[3] = (float)NAN;
    p.positions = positions;
    p.normals = normals;
    p.rgb = rgb;
    p.count = 50;
    CHECK_EQ_U64(zbufrand_project(&v, &p, 0, 50, s), ZBUFRAND_OK);
    check_projected(&v, &p, s);
    submitted_in_one_go(&v, &p, s);
    for (i = 0; i < 50; i++) { /* so far to the side that floats do not hold it */
        positions[3 * i + i % 2] = i % 4 < 2 ? 1e20f : -1e20f;
        positions[3 * i + 2] = i % 3 == 0 ? 2e20f : 5;
    }
    for (i = 0; i < 12; i++) v.world_to_camera[i / 4][i % 4] = i % 5 == 0 ? 1 : 0;
    v.focal = 1e30;
    v.far_z = 0;
    CHECK_EQ_U64(zbufrand_project(&v, &p, 0, 50, s), ZBUFRAND_OK);
    for (i = 0, k = 0; i < 50; i++) {
        CHECK(isfinite(s[i].x) && isfinite(s[i].y) && (s[i].z > 0 || s[i].z == 0.0f));
        k += s[i].z > 0;
    }
    CHECK_EQ_U64(k, 17); /* those of every third depth */
    for (i = 0; i < 50; i++) { /* depths that samples have, and those beyond */
        static const float z[5] = {0.9e-30f, 1.1e-30f, 0.9e30f, 1.1e30f, 3e38f};
        memset(&positions[3 * i], 0, 3 * sizeof *positions);
        positions[3 * i + 2] = z[i % 5];
    }
    v.focal = 100.0;
    v.near_z = 1e-38;
    CHECK_EQ_U64(zbufrand_project(&v, &p, 0, 50, s), ZBUFRAND_OK);
    for (i = 0; i < 50; i++) CHECK((s[i].z > 0) == (i % 5 == 1 || i % 5 == 2));
    CHECK_EQ_U64(zbufrand_project(&v, &p, 40, 11, s), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_project(NULL, &p, 0, 1, s), ZBUFRAND_ERR_INVALID_ARG);
    v.focal = 0.0;
    CHECK_EQ_U64(zbufrand_project(&v, &p, 0, 1, s), ZBUFRAND_ERR_INVALID_ARG);
    v.focal = 200.0;
    v.world_to_camera[1][1] = (double)NAN;
    CHECK_EQ_U64(zbufrand_project(&v, &p, 0, 1, s), ZBUFRAND_ERR_INVALID_ARG);
}

TEST(depth_at_the_centre) {
    static const double bad[5] = {(double)NAN, (double)INFINITY, -(double)INFINITY, 1e300, -1e300};
    test_rng r = test_rng_make(27);
    int i;
    for (i = 0; i < 1000; i++) {
        double z = 0.1 + 10.0 * test_rng_double(&r), x = 5.0 + test_rng_double(&r), y = 7.0 + test_rng_double(&r);
        double sx = (test_rng_double(&r) - 0.5) * 0.4 / z, sy = (test_rng_double(&r) - 0.5) * 0.4 / z;
        double want = 1.0 / (1.0 / (double)(float)z + sx * (5.5 - x) + sy * (7.5 - y));
        CHECK_NEAR(zbufrandi_plane_depth((float)z, x, y, sx, sy, 5, 7), want, 1e-6 * want);
    }
    for (i = 0; i < 5; i++) { /* never beyond a factor of two, never NaN */
        float a = zbufrandi_plane_depth(3.0f, 5.2, 7.5, bad[i], 0.0, 5, 7), b = zbufrandi_plane_depth(3.0f, 5.2, 7.1, bad[i], bad[4 - i], 5, 7);
        CHECK(a >= 1.5f && a <= 6.0f && b >= 1.5f && b <= 6.0f);
    }
    CHECK(zbufrandi_plane_depth(3.0f, 5.0, 7.5, 10.0, 0.0, 5, 7) == 1.5f && zbufrandi_plane_depth(3.0f, 5.0, 7.5, -10.0, 0.0, 5, 7) == 6.0f);
    CHECK(zbufrandi_plane_depth(3.0f, 5.0, 7.5, (double)NAN, 0.0, 5, 7) == 3.0f);
    CHECK(zbufrandi_plane_depth(1e-6f, 5.0, 7.5, -1e9, 0.0, 5, 7) == 2e-6f);
    CHECK(zbufrandi_plane_depth(1e-30f, 5.0, 7.5, (double)NAN, 0.0, 5, 7) == 1e-30f);
}

/* ---- errors and memory ------------------------------------------------------------------------------------------- */

/* A shading callback that hands samples to its own canvas, or asks for its picture. */
typedef struct meddler {
    zbufrand_canvas *canvas;
    zbufrand_result submitted, points_submitted, resolved;
    uint32_t calls;
} meddler;

static void shade_and_meddle(void *user, const uint32_t *numbers, size_t count, float *rgba) {
    meddler *m = (meddler *)user;
    static const float at[3] = {0, 0, 1};
    zbufrand_sample s;
    zbufrand_points points;
    zbufrand_view from;
    zbufrand_picture none;
    memset(&s, 0, sizeof s);
    memset(&points, 0, sizeof points);
    memset(&none, 0, sizeof none);
    s.x = s.y = 3.5f;
    s.z = 0.5f; /* nearer than what is being drawn */
    points.positions = at;
    points.count = 1;
    memset(&from, 0, sizeof from);
    from.world_to_camera[0][0] = from.world_to_camera[1][1] = from.world_to_camera[2][2] = 1.0;
    from.focal = 4.0;
    from.center_x = from.center_y = 4.0;
    from.near_z = 0.1;
    m->calls++;
    m->submitted = zbufrand_canvas_submit(m->canvas, &s, 1, 99, NULL);
    m->points_submitted = zbufrand_canvas_submit_points(m->canvas, &from, &points, 99, NULL);
    m->resolved = zbufrand_canvas_resolve(m->canvas, NULL, &none, NULL);
    (void)numbers;
    for (size_t i = 0; i < 4 * count; i++) rgba[i] = 1.0f;
}

TEST(nothing_comes_in_while_a_picture_is_made) {
    zbufrand_canvas_desc d = reconstruct_defaults(8, 8, 1);
    zbufrand_source source;
    zbufrand_picture p;
    zbufrand_sample s;
    uint32_t number[64];
    float rgba[64 * 4];
    meddler m;
    memset(&source, 0, sizeof source);
    memset(&p, 0, sizeof p);
    memset(&m, 0, sizeof m);
    memset(&s, 0, sizeof s);
    d.env.thread_count = 1;
    CHECK_EQ_U64(zbufrand_canvas_create(&d, &m.canvas), ZBUFRAND_OK);
    s.x = s.y = 3.5f;
    s.z = 1.0f;
    CHECK_EQ_U64(zbufrand_canvas_submit(m.canvas, &s, 1, 7, NULL), ZBUFRAND_OK);
    source.shade_fn = shade_and_meddle;
    source.user = &m;
    p.rgba = rgba;
    p.number = number;
    for (int twice = 0; twice < 2; twice++) { /* afterwards all is as it was: nothing came in, and the canvas works */
        CHECK_EQ_U64(zbufrand_canvas_resolve(m.canvas, &source, &p, NULL), ZBUFRAND_OK);
        CHECK(m.calls > 0);
        CHECK_EQ_U64(m.submitted, ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(m.points_submitted, ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(m.resolved, ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(number[3 * 8 + 3], 7);
    }
    s.z = 0.5f;
    CHECK_EQ_U64(zbufrand_canvas_submit(m.canvas, &s, 1, 8, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_canvas_resolve(m.canvas, &source, &p, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(number[3 * 8 + 3], 8);
    zbufrand_canvas_destroy(m.canvas);
}

TEST(errors) {
    zbufrand_canvas_desc d = reconstruct_defaults(8, 8, 1), e;
    zbufrand_canvas *c = NULL;
    zbufrand_error err;
    zbufrand_picture p;
    zbufrand_suspect_desc sd;
    zbufrand_layers_desc ld;
    zbufrand_layers *l = NULL;
    size_t n;
    float depth[64];
    zbufrand_suspect s;
    memset(&p, 0, sizeof p);
    memset(&err, 0, sizeof err);
    d.env.error = &err;
    CHECK_EQ_U64(zbufrand_canvas_create(NULL, &c), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_canvas_create(&d, NULL), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e._begin_zero = 1;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_UNINIT_DESC);
    e = d; e._end_zero = 1;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_UNINIT_DESC);
    e = d; e.width = 0;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.height = 65536;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_RANGE);
    CHECK_EQ_U64(err.where, 65536);
    e = d; e.width = e.height = 65535;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_RANGE);
    e = d; e.reconstruct.block = 1025;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_RANGE);
    e = d; e.reconstruct.block = 33; e.reconstruct.plane_depth = 1;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_RANGE);
    e = d; e.reconstruct.fill = (zbufrand_fill)9;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.isa = (zbufrand_isa)5;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.reconstruct.occlusion = (zbufrand_occlusion)4;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.reconstruct.gauss_radius = -1.0f;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_RANGE);
    e = d; e.reconstruct.gauss_radius = (float)NAN;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_RANGE);
    e = d; e.reconstruct.tolerance = (float)NAN;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_INVALID_ARG);
    e = d; e.bucket_bits = 23;
    CHECK_EQ_U64(zbufrand_canvas_create(&e, &c), ZBUFRAND_ERR_RANGE);
    CHECK(c == NULL);
    CHECK_EQ_U64(zbufrand_canvas_create(&d, &c), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_canvas_submit(NULL, NULL, 0, 0, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_canvas_submit(c, NULL, 1, 0, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_canvas_submit(c, NULL, 0, 0, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_canvas_resolve(c, NULL, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_canvas_resolve(c, NULL, &p, NULL), ZBUFRAND_OK);
    p.rgba = depth;
    CHECK_EQ_U64(zbufrand_canvas_resolve(c, NULL, &p, NULL), ZBUFRAND_ERR_INVALID_ARG);
    zbufrand_canvas_destroy(c);
    zbufrand_canvas_destroy(NULL);
    zbufrand_canvas_clear(NULL, 0);
    CHECK_EQ_U64(zbufrand_canvas_guard(NULL), 0);
    memset(&sd, 0, sizeof sd);
    memset(depth, 0, sizeof depth);
    sd.width = sd.height = 8;
    CHECK_EQ_U64(zbufrand_find_suspects(&sd, depth, NULL, 0, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_find_suspects(NULL, depth, NULL, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_find_suspects(&sd, NULL, NULL, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_find_suspects(&sd, depth, NULL, 5, &n), ZBUFRAND_ERR_INVALID_ARG);
    sd.tolerance = 1.0f;
    CHECK_EQ_U64(zbufrand_find_suspects(&sd, depth, NULL, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    sd.tolerance = 0.0f;
    sd.hole_count = 9;
    CHECK_EQ_U64(zbufrand_find_suspects(&sd, depth, NULL, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    sd.hole_count = 0;
    sd.isa = (zbufrand_isa)5;
    CHECK_EQ_U64(zbufrand_find_suspects(&sd, depth, NULL, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    sd.isa = ZBUFRAND_ISA_AUTO;
    s.pixel = 64;
    s.kind = ZBUFRAND_SUSPECT_HOLE;
    CHECK_EQ_U64(zbufrand_mend(&sd, NULL, depth, &s, 1), ZBUFRAND_ERR_INVALID_ARG);
    s.pixel = 63;
    CHECK_EQ_U64(zbufrand_mend(&sd, NULL, depth, &s, 1), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_mend(&sd, NULL, depth, NULL, 0), ZBUFRAND_OK);
    memset(&ld, 0, sizeof ld);
    ld.width = ld.height = 8;
    CHECK_EQ_U64(zbufrand_layers_create(&ld, &l), ZBUFRAND_ERR_INVALID_ARG); /* density is needed */
    ld.density = 4.0f;
    ld.layers = 5;
    CHECK_EQ_U64(zbufrand_layers_create(&ld, &l), ZBUFRAND_ERR_RANGE);
    ld.layers = 1;
    CHECK_EQ_U64(zbufrand_layers_create(&ld, &l), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_layers_submit(l, NULL, 1), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_layers_resolve(l, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_layers_next(NULL), 0);
    zbufrand_layers_destroy(l);
    zbufrand_layers_destroy(NULL);
}

static zbufrand_canvas_desc refused_options(int option) {
    zbufrand_canvas_desc d = reconstruct_defaults(40, 30, option == 8 ? 1 : 3);
    if (option < 6) d.reconstruct.fill = (zbufrand_fill)option;
    if (option & 1) d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
    d.reconstruct.plane_depth = option == 6;
    d.reconstruct.drop_back = option == 7;
    d.reconstruct.tolerance_color = option == 7 ? 0.1f : 0.0f;
    d.reconstruct.tolerance_slope = option == 7 ? 1.0f : -1.0f;
    d.reconstruct.repair = option == 8 || option == 0;
    return d;
}

/* Request k of a canvas refused; the canvas then makes the picture that it was asked for. 0: there are fewer requests. */
static int canvas_refused(int option, int64_t k, uint64_t *hash) {
    test_alloc ta;
    zbufrand_canvas_desc d = refused_options(option);
    zbufrand_canvas *c = NULL;
    zbufrand_picture p;
    zbufrand_source source;
    zbufrand_resolve_stats st;
    zbufrand_result r;
    zbufrand_sample s;
    static float rgba[40 * 30 * 4];
    int failed;
    uint32_t i;
    memset(&p, 0, sizeof p);
    memset(&source, 0, sizeof source);
    memset(&s, 0, sizeof s);
    test_alloc_init(&ta);
    ta.fail_at = k;
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    r = zbufrand_canvas_create(&d, &c);
    CHECK((r == ZBUFRAND_OK) == (c != NULL));
    failed = r == ZBUFRAND_ERR_NO_MEMORY;
    if (r == ZBUFRAND_OK) {
        for (i = 0; i < 40 * 30; i++) { /* a wall with holes, so that the repair has something to do */
            s.x = (float)(i % 40) + 0.5f;
            s.y = (float)(i / 40) + 0.5f;
            s.z = 1.0f;
            if (i % 7 != 0) zbufrand_canvas_submit(c, &s, 1, 0, NULL);
        }
        source.shade_fn = zbufrand_samples_shade;
        source.user = &s;
        p.rgba = rgba;
        r = zbufrand_canvas_resolve(c, &source, &p, &st);
        CHECK(r == ZBUFRAND_OK || r == ZBUFRAND_ERR_NO_MEMORY);
        failed = r == ZBUFRAND_ERR_NO_MEMORY;
        if (failed) CHECK_EQ_U64(zbufrand_canvas_resolve(c, &source, &p, &st), ZBUFRAND_OK);
        CHECK((st.holes > 100) == (option == 8));
        if (*hash == 0) *hash = test_fnv1a(rgba, sizeof rgba, 0);
        CHECK_EQ_U64(test_fnv1a(rgba, sizeof rgba, 0), *hash);
        zbufrand_canvas_destroy(c);
    }
    test_alloc_check(&ta);
    CHECK(failed == (ta.failed != 0));
    return failed;
}

TEST(memory_runs_out) {
    int64_t k;
    int option;
    for (option = 0; option < 9; option++) {
        uint64_t hash = 0;
        for (k = 0; k <= 40 && canvas_refused(option, k, &hash); k++) {}
        CHECK_MSG(k > 3 && k <= 40, "option %d: %d requests", option, (int)k);
    }
    for (k = 0;; k++) {
        test_alloc ta;
        zbufrand_layers_desc d;
        zbufrand_layers *l = NULL;
        zbufrand_result r;
        memset(&d, 0, sizeof d);
        test_alloc_init(&ta);
        ta.fail_at = k;
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        d.width = d.height = 9;
        d.density = 1.0f;
        r = zbufrand_layers_create(&d, &l);
        zbufrand_layers_destroy(l);
        test_alloc_check(&ta);
        CHECK((r == ZBUFRAND_ERR_NO_MEMORY) == (ta.failed != 0));
        if (ta.failed == 0) break;
    }
}

TEST(large_blocks_small_pictures) {
    static const uint32_t sizes[5][3] = {{1, 1, 1}, {1, 1, 200}, {3, 2, 50}, {2000, 1, 7}, {1, 3000, 300}};
    int i;
    for (i = 0; i < 5; i++) {
        zbufrand_canvas_desc d = reconstruct_defaults(sizes[i][0], sizes[i][1], sizes[i][2]);
        list l = {NULL, 0, 0};
        reconstruct_view v;
        add(&l, 0.5, 0.5, 1.0)->rgb[0] = 0.5f;
        add(&l, (double)sizes[i][0] + 2.0, 0.5, 1.0);
        v = render(&d, &l);
        CHECK_EQ_U64(v.p.number[0], sizes[i][2] > 4 && sizes[i][0] < 3 && v.p.number[0] == 1 ? 1 : 0);
        view_free(&v);
        d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES_ALL;
        d.reconstruct.fill = ZBUFRAND_FILL_VORONOI_L1;
        v = render(&d, &l);
        CHECK(v.p.number[0] <= 1);
        view_free(&v);
        d.reconstruct.occlusion = ZBUFRAND_OCCLUSION_CELLS;
        d.reconstruct.fill = ZBUFRAND_FILL_PULL_PUSH;
        v = render(&d, &l);
        CHECK(v.p.rgba[3] == 1.0f);
        view_free(&v);
        drop(&l);
    }
}

/* ---- cancelled ---- */

/* Each way of reconstruction is cancelled at each of its questions; the samples stay, the picture can be made again. */
TEST(cancelled) {
    enum { W = 50, H = 40 };
    int option;
    uint32_t threads;
    for (option = 0; option < 4 * 6 * 2; option += test_quick() ? 5 : 1) { /* 5: each value of each still comes */
        for (threads = 1; threads <= 3; threads += 2) {
            uint64_t at, want = 0;
            if (test_quick() && (threads == 3) != ((option / 24 + option) % 2 == 1)) continue;
            for (at = 0;; at += at < 8 ? 1 : 1 + at / 2) { /* 0: never, to count the questions */
                static float rgba[W * H * 4], depth[W * H];
                static uint32_t number[W * H];
                zbufrand_canvas_desc d = reconstruct_defaults(W, H, option / 24 ? 70 : 4);
                zbufrand_canvas *c = NULL;
                zbufrand_picture p;
                zbufrand_source source;
                zbufrand_error error;
                zbufrand_result r;
                test_stopper q;
                list l = {NULL, 0, 0};
                test_rng rng = test_rng_make(5);
                size_t i;
                memset(&source, 0, sizeof source);
                memset(&error, 0, sizeof error);
                memset(&q, 0, sizeof q);
                d.reconstruct.occlusion = (zbufrand_occlusion)(option % 4);
                d.reconstruct.fill = (zbufrand_fill)(option / 4 % 6);
                d.reconstruct.tolerance_color = 0.2f;
                d.reconstruct.drop_back = 1;
                d.reconstruct.tolerance_slope = option % 4 == 2 ? 1.0f : -1.0f;
                d.reconstruct.plane_depth = option < 24;
                d.reconstruct.repair = 1;
                d.env.thread_count = threads;
                d.env.error = &error;
                d.env.progress_fn = test_stop_fn;
                d.env.progress_user = &q;
                q.stop_at = at;
                for (i = 0; i < 600; i++) {
                    zbufrand_sample *s = add(&l, W * test_rng_double(&rng), H * test_rng_double(&rng), 1 + test_rng_double(&rng));
                    s->rgb[1] = (float)test_rng_double(&rng);
                }
                CHECK_EQ_U64(zbufrand_canvas_create(&d, &c), ZBUFRAND_OK);
                CHECK_EQ_U64(zbufrand_canvas_submit(c, l.s, l.n, 0, NULL), ZBUFRAND_OK);
                source.shade_fn = zbufrand_samples_shade;
                source.surface_fn = zbufrand_samples_surface;
                source.user = l.s;
                p.rgba = rgba;
                p.depth = depth;
                p.number = number;
                r = zbufrand_canvas_resolve(c, &source, &p, NULL);
                if (at == 0)
                    CHECK_MSG(r == ZBUFRAND_OK && q.calls >= (threads == 1 ? 4u : 1u), "%d asks %u times, result %d", option, (unsigned)q.calls, (int)r);
                else if (q.calls >= at) {
                    CHECK_MSG(r == ZBUFRAND_ERR_CANCELLED && error.code == r, "%d, question %u: result %d", option, (unsigned)at, (int)r);
                    if (threads == 1) CHECK_EQ_U64(q.calls, at); /* once is enough */
                    q.stop_at = q.done = 0;
                    CHECK_EQ_U64(zbufrand_canvas_resolve(c, &source, &p, NULL), ZBUFRAND_OK);
                }
                CHECK_MSG(threads > 1 || q.backwards == 0, "%d: %u steps back", option, q.backwards);
                i = (size_t)test_fnv1a(number, sizeof number, test_fnv1a(depth, sizeof depth, test_fnv1a(rgba, sizeof rgba, 0)));
                if (at == 0) want = i;
                CHECK_EQ_U64(i, want);
                zbufrand_canvas_destroy(c);
                drop(&l);
                if (at != 0 && (q.calls < at || at > (test_quick() ? 10 : 100))) break;
            }
        }
    }
}

/* Much may have to be looked at for each pixel: then few are done from question to question. */
TEST(asks_within_rows) {
    enum { W = 200, H = 40 };
    int i;
    for (i = 0; i < 2; i++) {
        static zbufrand_sample s[W * H];
        static float rgba[W * H * 4];
        zbufrand_canvas_desc d = reconstruct_defaults(W, H, 1024);
        zbufrand_canvas *c = NULL;
        zbufrand_picture p;
        zbufrand_source source;
        test_stopper q;
        uint32_t k;
        memset(s, 0, sizeof s);
        memset(&p, 0, sizeof p);
        memset(&q, 0, sizeof q);
        memset(&source, 0, sizeof source);
        d.reconstruct.occlusion = i == 0 ? ZBUFRAND_OCCLUSION_SQUARES : ZBUFRAND_OCCLUSION_SQUARES_ALL;
        d.reconstruct.tolerance_color = 0.5f;
        d.env.progress_fn = test_stop_fn;
        d.env.progress_user = &q;
        for (k = 0; k < W * H; k++) { /* the nearest, of no other's colour, is below to the right */
            s[k].x = (float)(k % W) + 0.5f;
            s[k].y = (float)(k / W) + 0.5f;
            s[k].z = 2.0f - (float)k * 1e-5f;
            s[k].rgb[0] = k == W * H - 1;
        }
        CHECK_EQ_U64(zbufrand_canvas_create(&d, &c), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_canvas_submit(c, s, W * H, 0, NULL), ZBUFRAND_OK);
        source.shade_fn = zbufrand_samples_shade;
        source.user = s;
        p.rgba = rgba;
        q.stop_at = 1500; /* some hundred are those of all rows */
        CHECK_EQ_U64(zbufrand_canvas_resolve(c, &source, &p, NULL), ZBUFRAND_ERR_CANCELLED);
        CHECK_EQ_U64(q.calls, 1500);
        zbufrand_canvas_destroy(c);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(blocks_are_painted);
    RUN(min_filter_of_any_size);
    RUN(planes_beside_exact_pixels);
    RUN(pixel_borders);
    RUN(one_sample_per_patch_is_shaded);
    RUN(same_bits);
    RUN(cells_and_squares);
    RUN(squares_agree_with_blocks);
    RUN(tolerance_and_backs);
    RUN(law_of_a_pixel);
    RUN(bleeding_law);
    RUN(planes_do_not_bleed);
    RUN(z_dominance_table);
    RUN(borders_of_buckets_move);
    RUN(equal_depths_give_the_mean_image);
    RUN(case_of_a_partial_front);
    RUN(share_of_wrong_pixels);
    RUN(wrong_pixels_of_the_practical_rule);
    RUN(depths_at_the_ends);
    RUN(silhouettes);
    RUN(gauss_against_the_sum);
    RUN(regions_against_the_sum);
    RUN(fills_keep_a_constant);
    RUN(voronoi_regions);
    RUN(pull_push_by_definition);
    RUN(blocks_with_planes);
    RUN(layered_coverage);
    RUN(layers_same_bits);
    RUN(suspects);
    RUN(gaps_are_left_alone);
    RUN(mending);
    RUN(suspects_same_bits);
    RUN(projection);
    RUN(depth_at_the_centre);
    RUN(nothing_comes_in_while_a_picture_is_made);
    RUN(errors);
    RUN(memory_runs_out);
    RUN(large_blocks_small_pictures);
    RUN(cancelled);
    RUN(asks_within_rows);
    return test_end();
}
