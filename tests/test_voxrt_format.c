/* Format 5 files: round trips, an independent reader written from docs/formats.md, damaged and hostile files. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "voxel_list.h"

static void add(cells *c, uint32_t x, uint32_t y, uint32_t z) {
    (void)cells_add(c, x, y, z, (x * 3 & 255u) | (uint32_t)(c->n % 7 * 30) << 8 | (z >> 2 << 4 & 255u) << 16);
    cells_normal(c, x % 17 - 8.0, 1.0, z % 5 - 2.0);
}

static void add_sphere(cells *c, uint32_t size, double radius) {
    size_t i;
    cells_sphere(c, size, radius);
    for (i = 0; i < c->n; i++) { /* colours */
        c->v[i].rgb[0] = (uint8_t)(c->v[i].x * 3);
        c->v[i].rgb[1] = (uint8_t)(i % 7 * 30);
        c->v[i].rgb[2] = (uint8_t)(c->v[i].z >> 2 << 4);
    }
}

enum { FORMAT_KINDS = 9 };

static uint32_t make_cells(int kind, cells *c) { /* returns the depth */
    test_rng r = test_rng_make((uint64_t)kind);
    uint32_t i, k;
    memset(c, 0, sizeof *c);
    switch (kind) {
    case 0: add(c, 1, 0, 1); return 1;                                    /* the smallest tree, odd depth */
    case 1: add(c, 3, 2, 1); add(c, 0, 0, 0); return 2;
    case 2: add(c, 0xfffff, 0xfffff, 0xfffff); add(c, 0, 0, 0); return 20; /* the deepest */
    case 3: add(c, 0x12345, 0x6789a, 0x7ffff); return 19;
    case 4: for (i = 0; i < 4096; i++) add(c, i & 15, i >> 4 & 15, i >> 8); return 4; /* all full: no bits at all */
    case 5: add_sphere(c, 32, 14.0); return 5;
    case 6: /* noise */
        for (i = 0; i < 512; i++) {
            uint32_t u = test_rng_u32(&r);
            for (k = 0; k < i; k++) if (c->v[k].x == (u & 127) && c->v[k].y == (u >> 7 & 127) && c->v[k].z == (u >> 14 & 127)) break;
            if (k == i || c->n == 0) add(c, u & 127, u >> 7 & 127, u >> 14 & 127);
        }
        return 7;
    case 7: add_sphere(c, 64, 30.0); return 8;
    default: add_sphere(c, 128, 60.0); return 7; /* several chunks of nodes */
    }
}

static voxrt_tree *make_tree(int kind, int colors, int normals) {
    cells c;
    voxrt_build_desc d;
    uint32_t depth = make_cells(kind, &c);
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.palette_size = 64;
    d.disable_colors = !colors;
    d.disable_normals = !normals;
    return cells_tree(&c, &d, depth);
}

static uint8_t *save(const voxrt_tree *t, int encoding, size_t *size) {
    voxrt_save_desc d;
    uint8_t *p;
    size_t again = 0;
    memset(&d, 0, sizeof d);
    d.encoding = (voxrt_encoding)encoding;
    if (voxrt_tree_save_memory(t, &d, NULL, 0, size) != VOXRT_OK) return NULL;
    p = (uint8_t *)malloc(*size);
    if (p == NULL || voxrt_tree_save_memory(t, &d, p, *size, &again) != VOXRT_OK || again != *size) {
        test_fail(__FILE__, __LINE__, "save failed");
        free(p);
        return NULL;
    }
    return p;
}

/* Exactly `size` bytes, 64-byte aligned, so that a sanitizer sees what is read behind the end. */
static uint8_t *aligned_copy(const uint8_t *p, size_t size, void **block) {
    uint8_t *q = NULL;
    *block = NULL;
    if (posix_memalign(block, 64, size != 0 ? size : 1) != 0) exit(1);
    q = (uint8_t *)*block;
    if (size != 0) memcpy(q, p, size);
    return q;
}

/* The checksum as docs/formats.md describes it. */
static uint64_t sum(uint64_t h, const uint8_t *p, size_t n) {
    while (n > 0) {
        uint64_t v = 0;
        size_t k = n >= 8 ? 8 : 1, i;
        for (i = 0; i < k; i++) v |= (uint64_t)p[i] << (8 * i);
        h = (h ^ v) * 0x9e3779b97f4a7c15u;
        h ^= h >> 29;
        p += k;
        n -= k;
    }
    return h;
}
#define SUM_START 0x243f6a8885a308d3u

static uint64_t format_get(const uint8_t *p, uint32_t bytes) {
    uint64_t v = 0;
    while (bytes-- > 0) v = v << 8 | p[bytes];
    return v;
}
static void put(uint8_t *p, uint32_t bytes, uint64_t v) {
    for (; bytes > 0; bytes--, v >>= 8) *p++ = (uint8_t)v;
}

/* Make all checksums right that can be made right. */
static void seal(uint8_t *p, size_t size) {
    uint32_t i, n = (uint32_t)format_get(p + 14, 2);
    uint8_t head[64];
    if (64 + (size_t)n * 40 > size) return;
    for (i = 0; i < n; i++) {
        uint8_t *e = p + 64 + (size_t)i * 40;
        uint64_t at = format_get(e + 8, 8), bytes = format_get(e + 16, 8);
        if (at <= size && bytes <= size - at) put(e + 32, 8, sum(SUM_START ^ bytes, p + at, (size_t)bytes));
    }
    memcpy(head, p, 64);
    memset(head + 24, 0, 8);
    put(p + 24, 8, sum(sum(SUM_START ^ 64, head, 64), p + 64, (size_t)n * 40));
}

static uint8_t *entry(uint8_t *p, uint32_t id) {
    uint32_t i, n = (uint32_t)format_get(p + 14, 2);
    for (i = 0; i < n; i++)
        if (format_get(p + 64 + 40 * i, 4) == id) return p + 64 + 40 * i;
    return NULL;
}

static int count_cells(void *user, const voxrt_voxel *voxel, uint32_t palette_index) {
    uint64_t *n = (uint64_t *)user;
    n[0]++;
    n[1] += voxel->x + voxel->rgb[0] + palette_index;
    return 0;
}

/* Use a tree in every way that reads its arrays. */
static void use(const voxrt_tree *t) {
    voxrt_tree_info info;
    test_rng r = test_rng_make(5);
    uint64_t n[2] = {0, 0};
    uint32_t i, level;
    voxrt_tree_get_info(t, &info);
    for (level = 0; level <= info.depth; level++) {
        n[0] = 0;
        if (info.level_count[level] < 10000) (void)voxrt_tree_each(t, level, count_cells, n);
        if (info.level_count[level] < 10000) CHECK_EQ_U64(n[0], info.level_count[level]);
    }
    for (i = 0; i < 32; i++) {
        voxrt_ray ray;
        voxrt_hit hit;
        voxrt_voxel v;
        float normal[3];
        uint8_t rgb[3];
        uint32_t a;
        double size = info.voxel_size * (double)(1u << info.depth);
        for (a = 0; a < 3; a++) {
            double from = info.cell_min[a] + (info.cell_max[a] - info.cell_min[a]) * test_rng_double(&r);
            ray.org[a] = (float)(info.world_origin[a] + size * (test_rng_double(&r) * 3 - 1));
            ray.dir[a] = (float)(info.world_origin[a] + info.voxel_size * from - (double)ray.org[a]);
        }
        ray.t_min = 0;
        ray.t_max = INFINITY;
        if (voxrt_trace(t, NULL, &ray, &hit, 1) == VOXRT_OK && hit.node != VOXRT_NO_NODE) {
            voxrt_hit_color(t, &hit, rgb);
            voxrt_hit_normal(t, &hit, normal);
        }
        (void)voxrt_tree_get(t, info.depth, info.cell_min[0], info.cell_min[1], info.cell_min[2], &v);
    }
}

/* ---- an independent reader: docs/formats.md in the plainest code ------------------------------------------- */

/* `bad` is set by whatever the description forbids. */
typedef struct slow_rans {
    const uint8_t *section, *tables, *chunk;  /* ends of the parts are checked by the order in which they stand */
    size_t size, at, end;
    uint32_t x, bad, chunks, next;
    uint16_t freq[258][256];
    int empty[258];
} slow_rans;

static uint32_t slow_byte(slow_rans *r) {
    if (r->at >= r->end) { r->bad = 1; return 0; }
    return r->section[r->at++];
}

static uint32_t slow_number(slow_rans *r) {
    uint32_t v = slow_byte(r), high;
    if (v < 128) return v;
    high = slow_byte(r);
    if (high == 0 || high > 127) r->bad = 1;
    return (v & 127u) | high << 7;
}

static void slow_open(slow_rans *r, const uint8_t *section, size_t size) {
    uint32_t i, k, n, sum;
    uint64_t total = 0;
    int last;
    memset(r, 0, sizeof *r);
    r->section = section;
    r->size = size;
    if (size < 8) { r->bad = 1; return; }
    r->chunks = (uint32_t)format_get(section, 4);
    r->at = 8 + 2 * (size_t)r->chunks;
    r->end = r->at + (size_t)format_get(section + 4, 4);
    if (r->end > size) { r->bad = 1; return; }
    for (i = 0; i < r->chunks; i++) {
        k = (uint32_t)format_get(section + 8 + 2 * i, 2);
        if (k < 4 || k % 2 != 0) r->bad = 1;
        total += k;
    }
    if (r->end + total != size) r->bad = 1;
    for (i = 0; i < 258 && !r->bad; i++) {
        n = slow_number(r);
        r->empty[i] = n == 0;
        for (k = 0, sum = 0, last = -1; k < n && !r->bad; k++) {
            int s = (int)slow_byte(r);
            uint32_t f = slow_number(r);
            if (s <= last || f == 0) r->bad = 1;
            r->freq[i][s] = (uint16_t)f;
            last = s;
            sum += f;
        }
        if (n != 0 && sum != 4096) r->bad = 1;
    }
    if (r->at != r->end) r->bad = 1;
    r->x = 65536;
}

static void slow_chunk(slow_rans *r) { /* the one before has to be used up */
    if (r->bad || r->x != 65536 || r->at != r->end || r->next == r->chunks) { r->bad = 1; return; }
    r->end = r->at + (size_t)format_get(r->section + 8 + 2 * r->next++, 2);
    r->x = (uint32_t)format_get(r->section + r->at, 4);
    r->at += 4;
    if (r->x < 65536) r->bad = 1;
}

static uint32_t slow_symbol(slow_rans *r, uint32_t context) {
    uint32_t t = r->empty[2 + context] ? context / 128 : 2 + context, slot = r->x & 4095u, s = 0, start = 0, low;
    if (r->empty[t]) r->bad = 1;
    if (r->bad) return 1;
    while (start + r->freq[t][s] <= slot) start += r->freq[t][s++];
    r->x = r->freq[t][s] * (r->x >> 12) + slot - start;
    if (r->x < 65536) {
        low = slow_byte(r);
        r->x = r->x << 16 | low | slow_byte(r) << 8;
    }
    return s;
}

static int slow_close(const slow_rans *r) { return !r->bad && r->x == 65536 && r->at == r->size && r->next == r->chunks; }

static uint32_t slow_mirror(uint32_t mask, uint32_t b) {
    uint32_t i, r = 0;
    for (i = 0; i < 8; i++) if (mask >> i & 1u) r |= 1u << (i ^ b);
    return r;
}

static uint32_t slow_bits(uint64_t x) {
    uint32_t n = 0;
    for (; x != 0; x &= x - 1) n++;
    return n;
}

/* All leaf masks of a compact file in order; returns their number, 0: the file is not as described. */
static size_t slow_geometry(uint8_t *file, uint64_t *leaf, size_t room) {
    slow_rans *r = (slow_rans *)malloc(sizeof *r);
    const uint8_t *place = file + format_get(entry(file, 1) + 8, 8), *e = entry(file, 6);
    uint32_t wide = ((uint32_t)format_get(file + 36, 4) + 1) / 2, w, i;
    uint64_t *above = (uint64_t *)calloc(room, 8), *level = (uint64_t *)malloc(room * 8), voxels = 0;
    size_t n = 1, below = 1;
    if (r == NULL || above == NULL || level == NULL) exit(1);
    slow_open(r, file + format_get(e + 8, 8), (size_t)format_get(e + 16, 8));
    above[0] = 1;
    for (w = 0; w < wide && !r->bad; w++) {
        uint32_t parent = 0, bit = 0, o, b, octant_count = 0;
        n = (size_t)format_get(place + 64 + 4 * w, 4);
        if (n > room || n != below) { r->bad = 1; break; }
        for (i = 0, below = 0; i < n; i++, bit++) {
            uint32_t siblings, octants;
            if (i % 4096 == 0) slow_chunk(r);
            for (;;) {
                if (bit == 64) { bit = 0; parent++; }
                else if (above[parent] >> bit & 1u) break;
                else bit++;
            }
            siblings = (uint32_t)(above[parent] >> (bit & 56u)) & 255u;
            b = bit & 7u;
            octants = slow_mirror(slow_symbol(r, slow_mirror(siblings, b) / 2), b);
            if (octants == 0) r->bad = 1;
            level[i] = 0;
            for (o = 0; o < 8; o++) {
                uint32_t s;
                if ((octants >> o & 1u) == 0) continue;
                octant_count++;
                s = slow_symbol(r, (w + 1 == wide ? 128u : 0u) + slow_mirror(octants, o) / 2);
                if (s == 0) r->bad = 1;
                level[i] |= (uint64_t)slow_mirror(s, o) << (8 * o);
            }
            below += slow_bits(level[i]);
            if (w + 1 == wide) voxels += slow_bits(level[i]);
        }
        if (octant_count != format_get(place + 104 + 4 * w, 4)) r->bad = 1;
        memcpy(above, level, n * 8);
    }
    if (!slow_close(r) || voxels != format_get(file + 56, 8)) n = 0;
    memcpy(leaf, above, n * 8);
    free(above);
    free(level);
    free(r);
    return n;
}

static uint32_t slow_class(uint32_t d) {
    uint32_t m = d < 128 ? d : 256 - d, n = 0;
    for (; m != 0; m >>= 1) n++;
    return n;
}

/* All normals; 0: not as described. */
static int slow_normals(uint8_t *file, uint16_t *normal, uint64_t count) {
    slow_rans *r = (slow_rans *)malloc(sizeof *r);
    const uint8_t *e = entry(file, 7);
    uint32_t x = 0, y = 0, k = 0;
    uint64_t i;
    int ok;
    if (r == NULL) exit(1);
    slow_open(r, file + format_get(e + 8, 8), (size_t)format_get(e + 16, 8));
    for (i = 0; i < count && !r->bad; i++) {
        uint32_t dx, dy;
        if (i % 4096 == 0) {
            slow_chunk(r);
            x = y = 0x80;
            k = 0;
        }
        dx = slow_symbol(r, k);
        dy = slow_symbol(r, 128 + 4 * slow_class(dx) + k / 4);
        k = slow_class(dx) + slow_class(dy);
        if (k > 12) k = 12;
        x = (x + dx) & 255;
        y = (y + dy) & 255;
        normal[i] = (uint16_t)(x | y << 8);
    }
    ok = slow_close(r);
    free(r);
    return ok;
}

/* What load takes is what the slow reader takes: changes of a few bytes, checksums made right. */
TEST(coded_sections_exactly) {
    static const int kinds[4] = {1, 2, 4, 6};
    test_rng rng = test_rng_make(77);
    uint32_t round, taken = 0;
    int kind, normals;
    for (kind = 0; kind < 4; kind++)
        for (normals = 0; normals < 2; normals++) {
            voxrt_tree *t = make_tree(kinds[kind], 0, normals), *u;
            size_t size, at, bytes, n;
            uint8_t *p, *q;
            uint64_t leaf[600];
            uint16_t *normal;
            REQUIRE(t != NULL);
            p = save(t, 0, &size);
            REQUIRE(p != NULL);
            q = (uint8_t *)malloc(size);
            normal = (uint16_t *)malloc((size_t)t->attr_count * 2);
            REQUIRE(q != NULL && normal != NULL);
            at = (size_t)format_get(entry(p, normals ? 7 : 6) + 8, 8);
            bytes = (size_t)format_get(entry(p, normals ? 7 : 6) + 16, 8);
            if (format_get(entry(p, normals ? 7 : 6) + 4, 4) != 1) bytes = 0; /* so few normals are stored raw */
            for (round = 0; bytes != 0 && round < (test_quick() || TEST_SANITIZED ? 100u : 400u); round++) {
                uint32_t k, m = round % 4 != 0 ? 1 : 1 + test_rng_below(&rng, 3);
                memcpy(q, p, size);
                for (k = 0; k < m; k++) {
                    size_t i = at + test_rng_below(&rng, (uint32_t)(round % 2 && bytes > 600 ? 600 : bytes));
                    if (round % 3 != 0) q[i] = (uint8_t)(q[i] + (round % 3 == 1 ? 1 : 255));
                    else q[i] ^= (uint8_t)(1u << test_rng_below(&rng, 8));
                }
                if (round % 8 == 7 && bytes > 300) { /* move a frequency from one symbol to the next, or a word */
                    size_t i = at + bytes - 1 - test_rng_below(&rng, 40);
                    q[i]++;
                    q[i - 2]--;
                }
                seal(q, size);
                u = NULL;
                (void)voxrt_tree_load_memory(NULL, q, size, &u);
                n = slow_geometry(q, leaf, 600);
                if (u == NULL) continue;
                taken++;
                CHECK(n == u->level_nodes[u->wide - 1]);
                if (n != 0) CHECK(memcmp(leaf, u->leaf, n * 8) == 0);
                if (normals) CHECK(slow_normals(q, normal, u->attr_count) && memcmp(normal, u->normal, (size_t)u->attr_count * 2) == 0);
                voxrt_tree_destroy(u);
            }
            free(normal);
            free(p);
            free(q);
            voxrt_tree_destroy(t);
        }
    CHECK_MSG(taken > 0, "no changed file was valid");
}

/* Sections made by hand: each rule of coded sections broken alone. */
TEST(coded_sections_by_hand) {
    /* depth 2, one node, all 64 voxels: octant mask 255 in context 0, eight bytes 255 in context 128 + 127 */
    static const uint8_t good[4] = {0, 0, 1, 0};
    uint32_t test;
    for (test = 0; test < 13; test++) {
        uint8_t file[2048], *p = file, *s, *e;
        voxrt_tree *t = NULL, *u = NULL;
        cells c;
        uint32_t i;
        size_t size, n = 0;
        voxrt_build_desc d;
        memset(&d, 0, sizeof d);
        memset(&c, 0, sizeof c);
        d.disable_colors = d.disable_normals = 1;
        for (i = 0; i < 64; i++) add(&c, i & 3, i >> 2 & 3, i >> 4);
        CHECK(voxrt_tree_from_voxels(&d, c.v, c.n, 2, &t) == VOXRT_OK);
        free(c.v);
        REQUIRE(t != NULL);
        p = save(t, 0, &size);
        REQUIRE(p != NULL && size < 1000);
        voxrt_tree_destroy(t);
        memset(file, 0, sizeof file);
        memcpy(file, p, size);
        free(p);
        e = entry(file, 6);
        s = file + format_get(e + 8, 8);
        put(s, 4, 1);
        n = 10;
        for (i = 0; i < 258; i++) {
            if (test == 12 && i == 0) { s[n++] = 0x81; s[n++] = 0; } /* 1 in two bytes */
            else s[n++] = (uint8_t)(i < 2 ? (test == 1 ? 2 - i : test == 2 ? 2 : 1) : 0);
            if (i >= 2) continue;
            if (test == 1 && i == 0) { s[n++] = 255; s[n++] = 0x80; s[n++] = 0x10; s[n++] = 255; s[n++] = 0x80; s[n++] = 0x10; } /* twice */
            else if (test == 2) { s[n++] = 255; s[n++] = 0x80; s[n++] = 0x10; s[n++] = 254; s[n++] = 1; }                         /* descending, too much */
            else if (test == 3) { s[n++] = 255; s[n++] = 0xff; s[n++] = 0x1f; }                                                   /* sums up to 4095 */
            else if (test == 4) { s[n++] = 0; s[n++] = 0x80; s[n++] = 0x20; }                                                     /* symbol 0 */
            else { s[n++] = 255; s[n++] = 0x80; s[n++] = 0x20; }
        }
        if (test == 5) s[n++] = 0;              /* tables end, bytes do not */
        put(s + 4, 4, n - 10);
        if (test == 6) put(s + 4, 4, n - 11);
        memcpy(s + n, good, 4);
        n += 4;
        if (test == 7) s[n - 4] = 1;            /* ends in another state */
        if (test == 8) s[n - 2] = 0;            /* begins in a state that does not exist */
        if (test == 9) { s[n++] = 0; s[n++] = 0; } /* a word too many */
        put(s + 8, 2, test == 9 ? 6 : test == 10 ? 2 : 4);
        if (test == 10) n -= 2;
        if (test == 11) put(s, 4, 2);
        put(e + 16, 8, n);
        size = (size_t)(s - file) + n;
        put(file + 16, 8, size);
        seal(file, size);
        CHECK_MSG(voxrt_tree_load_memory(NULL, file, size, &u) == (test == 0 ? VOXRT_OK : VOXRT_ERR_FORMAT), "case %u", test);
        voxrt_tree_destroy(u);
    }
}

/* Normals of one section, chunk by chunk or in lanes. 0: they do not decode. */
static int decode_normals(voxrt_tree *t, const voxrti_bytes *b, int lanes) {
    voxrt_env env;
    voxrti_mem mem;
    voxrti_normal_decoder g;
    uint32_t k;
    int ok;
    memset(&env, 0, sizeof env);
    env.thread_count = lanes ? 0 : 1;
    if (voxrti_env_open(&env, &mem) != VOXRT_OK) abort();
    if (lanes) return voxrti_normals_decode(&mem, &env, t, b->data, b->size) == VOXRT_OK;
    memset(&g, 0, sizeof g);
    g.t = t;
    ok = voxrti_decoder_open(&mem, b->data, b->size, (t->attr_count + 4095) / 4096, &g.d) == VOXRT_OK;
    t->normal = (uint16_t *)voxrti_alloc_array(&mem, (size_t)t->attr_count, sizeof(uint16_t));
    if (t->normal == NULL) abort();
    for (k = 0; ok && k < g.d.chunks; k++) voxrti_normal_chunk(&g, k);
    ok = ok && g.d.bad == 0;
    voxrti_decoder_close(&mem, &g.d);
    return ok;
}

/* Many chunks decode in lanes where there is AVX2: the same normals, the same damage is seen. */
TEST(normals_in_lanes) {
    const size_t count = test_quick() ? 70000 : 300000;
    test_rng r = test_rng_make(77);
    voxrt_env env;
    voxrti_mem mem;
    voxrti_bytes b;
    voxrt_tree t, a, c;
    uint32_t n = 0x8080, round, good = 0, damaged = 0;
    size_t i, at;
    memset(&env, 0, sizeof env);
    memset(&b, 0, sizeof b);
    memset(&t, 0, sizeof t);
    REQUIRE(voxrti_env_open(&env, &mem) == VOXRT_OK);
    t.attr_count = count;
    t.normal = (uint16_t *)malloc(count * 2);
    REQUIRE(t.normal != NULL);
    for (i = 0; i < count; i++) { /* a walk whose steps are small here and large there */
        uint32_t reach = 1u << i / 5000 % 9;
        n = (n + test_rng_u32(&r) % reach + 256 * (test_rng_u32(&r) % reach)) & 0xffff;
        t.normal[i] = (uint16_t)n;
    }
    REQUIRE(voxrti_encode(&mem, &env, voxrti_normal_symbols, &t, (uint32_t)((count + 4095) / 4096), &b) == VOXRT_OK);
    for (round = 0; round < (test_quick() ? 20u : 150u); round++) {
        int ok, same;
        a = t;
        c = t;
        at = (size_t)test_rng_u32(&r) % b.size;
        n = b.data[at];
        if (round > 0) b.data[at] = (uint8_t)(b.data[at] ^ 1u << test_rng_u32(&r) % 8);
        a.normal = c.normal = NULL;
        ok = decode_normals(&a, &b, 0);
        same = decode_normals(&c, &b, 1) == ok;
        CHECK_MSG(same, "byte %u of %u", (unsigned)at, (unsigned)b.size);
        if (ok && same) CHECK(memcmp(a.normal, c.normal, count * 2) == 0);
        if (round == 0) CHECK(ok && memcmp(a.normal, t.normal, count * 2) == 0);
        if (ok) good++;
        else damaged++;
        voxrti_free(&mem, a.normal);
        voxrti_free(&mem, c.normal);
        b.data[at] = (uint8_t)n;
    }
    CHECK(good > 0 && damaged > 0);
    voxrti_free(&mem, b.data);
    free(t.normal);
}

TEST(independent_reader) {
    int kind;
    for (kind = 0; kind < FORMAT_KINDS; kind++) {
        voxrt_tree *t = make_tree(kind, 1, 1);
        size_t raw_size, size, n, i, leaves, voxels = 0;
        uint8_t *raw, *p;
        uint64_t *leaf, palette_count;
        REQUIRE(t != NULL);
        raw = save(t, 1, &raw_size);
        p = save(t, 0, &size);
        REQUIRE(raw != NULL && p != NULL);
        CHECK(memcmp(p, "\x89VOX\r\n\x1a\n", 8) == 0);
        CHECK_EQ_U64(format_get(p + 16, 8), size);
        CHECK_EQ_U64(format_get(p + 36, 4), t->depth);
        CHECK_EQ_U64(format_get(p + 56, 8), t->voxel_count);
        leaves = t->level_nodes[t->wide - 1];
        leaf = (uint64_t *)malloc((leaves + t->node_count + 1) * 8);
        REQUIRE(leaf != NULL);
        n = slow_geometry(p, leaf, leaves + t->node_count + 1);
        CHECK_EQ_U64(n, leaves);
        for (i = 0; i < n; i++) {
            CHECK(leaf[i] == t->leaf[i]);
            CHECK(format_get(raw + format_get(entry(raw, 4) + 8, 8) + 8 * i, 8) == t->leaf[i]);
            voxels += voxrti_popcount64(leaf[i]);
        }
        CHECK_EQ_U64(voxels, format_get(p + 56, 8));
        for (i = 0; i < t->node_count; i++) {
            const uint8_t *q = raw + format_get(entry(raw, 3) + 8, 8) + 16 * i;
            CHECK(format_get(q, 8) == t->node[i].mask && format_get(q + 8, 4) == t->node[i].child && format_get(q + 12, 4) == t->node[i].octant);
        }
        for (i = 0; i < t->attr_count; i++) CHECK(format_get(raw + format_get(entry(raw, 7) + 8, 8) + 2 * i, 2) == t->normal[i]);
        if (format_get(entry(p, 7) + 4, 4) == 1) {
            uint16_t *normal = (uint16_t *)malloc((size_t)t->attr_count * 2);
            REQUIRE(normal != NULL);
            CHECK(slow_normals(p, normal, t->attr_count) && memcmp(normal, t->normal, (size_t)t->attr_count * 2) == 0);
            free(normal);
        }
        palette_count = format_get(p + format_get(entry(p, 1) + 8, 8) + 56, 4);
        CHECK_EQ_U64(palette_count, t->palette_count);
        CHECK(memcmp(p + format_get(entry(p, 2) + 8, 8), t->palette, (size_t)palette_count * 3) == 0);
        free(leaf);
        free(raw);
        free(p);
        voxrt_tree_destroy(t);
    }
}

/* ---- round trips ------------------------------------------------------------------------------------------- */

static void same_tree(const voxrt_tree *a, const voxrt_tree *b) {
    voxrt_tree_info x, y;
    voxrt_tree_get_info(a, &x);
    voxrt_tree_get_info(b, &y);
    CHECK(memcmp(&x, &y, sizeof x) == 0);
    CHECK_EQ_U64(voxrt_tree_hash(a), voxrt_tree_hash(b));
    CHECK(memcmp(a->attr_first, b->attr_first, sizeof a->attr_first) == 0);
    CHECK(memcmp(a->level_first, b->level_first, sizeof a->level_first) == 0);
    CHECK(memcmp(a->rank, b->rank, (size_t)voxrti_rank_count(a) * 4) == 0);
    CHECK(memcmp(a->node, b->node, a->node_count * sizeof *a->node) == 0);
}

TEST(round_trips) {
    int kind, encoding, attributes;
    for (kind = 0; kind < FORMAT_KINDS; kind++)
        for (attributes = 0; attributes < 4; attributes++)
            for (encoding = test_quick() && kind == FORMAT_KINDS - 1 && attributes != 3 ? 2 : 0; encoding < 2; encoding++) {
                voxrt_tree *t = make_tree(kind, attributes & 1, attributes >> 1), *u = NULL;
                size_t size, size2, k;
                uint8_t *p, *q, *odd;
                voxrt_load_desc d;
                test_alloc ta;
                REQUIRE(t != NULL);
                p = save(t, encoding, &size);
                REQUIRE(p != NULL);
                odd = (uint8_t *)malloc(size + 1); /* any alignment will do */
                REQUIRE(odd != NULL);
                memcpy(odd + 1, p, size);
                for (k = 0; k < 6; k += test_quick() ? 3 : 1) {
                    memset(&d, 0, sizeof d);
                    test_alloc_init(&ta);
                    d.env.allocator.alloc_fn = test_alloc_fn;
                    d.env.allocator.free_fn = test_free_fn;
                    d.env.allocator.user = &ta;
                    d.env.thread_count = (uint32_t)k % 3 + 1 + (uint32_t)(test_quick() && kind % 2);
                    d.trust_input = k > 2;
                    CHECK(voxrt_tree_load_memory(&d, odd + 1, size, &u) == VOXRT_OK);
                    REQUIRE(u != NULL);
                    same_tree(t, u);
                    if (k == 0 || k == 3) use(u);
                    if (k == 0) {
                        q = save(u, encoding, &size2);
                        CHECK(q != NULL && size2 == size && memcmp(p, q, size) == 0);
                        free(q);
                    }
                    voxrt_tree_destroy(u);
                    test_alloc_check(&ta);
                }
                free(odd);
                free(p);
                voxrt_tree_destroy(t);
            }
}

/* wide tree -> octree -> version 4 -> octree -> wide tree -> version 5 -> wide tree: cells and colours stay, and from the
   second tree on everything */
TEST(through_both_formats) {
    int kind;
    for (kind = 0; kind < 7; kind++) {
        voxrt_tree *t = make_tree(kind, 1, 1), *u = NULL, *v = NULL;
        voxrt_octree *o = NULL, *o2 = NULL;
        voxrt_tree_info x, y;
        voxrt_voxel a, b;
        uint8_t *p, *q;
        size_t n = 0, size;
        cells c;
        uint32_t depth = make_cells(kind, &c), i;
        REQUIRE(t != NULL);
        CHECK(voxrt_octree_from_tree(NULL, t, &o) == VOXRT_OK);
        REQUIRE(o != NULL && voxrt_octree_save_memory(o, NULL, NULL, 0, &n) == VOXRT_OK);
        p = (uint8_t *)malloc(n);
        REQUIRE(p != NULL && voxrt_octree_save_memory(o, NULL, p, n, &n) == VOXRT_OK);
        CHECK(voxrt_octree_load_memory(NULL, p, n, &o2) == VOXRT_OK && voxrt_tree_from_octree(NULL, o2, &u) == VOXRT_OK);
        REQUIRE(u != NULL);
        q = save(u, kind & 1, &size);
        REQUIRE(q != NULL);
        CHECK(voxrt_tree_load_memory(NULL, q, size, &v) == VOXRT_OK);
        REQUIRE(v != NULL);
        same_tree(u, v);
        voxrt_tree_get_info(t, &x);
        voxrt_tree_get_info(v, &y);
        CHECK_EQ_U64(x.voxel_count, y.voxel_count);
        for (i = 0; kind != 4 && y.depth == depth && i < c.n; i++) {
            CHECK(voxrt_tree_get(t, depth, c.v[i].x, c.v[i].y, c.v[i].z, &a) && voxrt_tree_get(v, depth, c.v[i].x, c.v[i].y, c.v[i].z, &b));
            CHECK(memcmp(a.rgb, b.rgb, 3) == 0);
            CHECK(a.normal[0] * b.normal[0] + a.normal[1] * b.normal[1] + a.normal[2] * b.normal[2] > 0.9995f);
        }
        free(c.v);
        free(p);
        free(q);
        voxrt_octree_destroy(o);
        voxrt_octree_destroy(o2);
        voxrt_tree_destroy(t);
        voxrt_tree_destroy(u);
        voxrt_tree_destroy(v);
    }
}

TEST(map_in_place) {
    int kind, trust;
    for (kind = 0; kind < FORMAT_KINDS; kind++)
        for (trust = 0; trust < 2; trust++) {
            voxrt_tree *t = make_tree(kind, kind & 1, 1), *u = NULL;
            size_t size;
            uint8_t *p, *q;
            void *block;
            voxrt_load_desc d;
            test_alloc ta;
            REQUIRE(t != NULL);
            memset(&d, 0, sizeof d);
            test_alloc_init(&ta);
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.trust_input = (uint32_t)trust;
            p = save(t, 1, &size);
            REQUIRE(p != NULL);
            q = aligned_copy(p, size, &block);
            if (!voxrti_little_endian()) { /* refused, nothing kept */
                CHECK(voxrt_tree_map_memory(&d, q, size, &u) == VOXRT_ERR_INVALID_ARG && u == NULL);
                test_alloc_check(&ta);
                free(block);
                free(p);
                voxrt_tree_destroy(t);
                continue;
            }
            CHECK(voxrt_tree_map_memory(&d, q, size, &u) == VOXRT_OK);
            REQUIRE(u != NULL);
            CHECK(ta.count == 1);
            CHECK(ta.peak_bytes < 2048);
            CHECK((const uint8_t *)u->leaf > q && (const uint8_t *)u->leaf < q + size);
            same_tree(t, u);
            use(u);
            voxrt_tree_destroy(u);
            CHECK(memcmp(p, q, size) == 0); /* nothing was written */
            test_alloc_check(&ta);
            free(block);
            free(p);
            voxrt_tree_destroy(t);
        }
}

TEST(without_normals) {
    voxrt_tree *t = make_tree(5, 1, 1), *u = NULL;
    voxrt_save_desc d;
    voxrt_tree_info info;
    size_t size = 0, all = 0;
    uint8_t *p;
    REQUIRE(t != NULL);
    memset(&d, 0, sizeof d);
    CHECK(voxrt_tree_save_memory(t, NULL, NULL, 0, &all) == VOXRT_OK);
    d.disable_normals = 1;
    CHECK(voxrt_tree_save_memory(t, &d, NULL, 0, &size) == VOXRT_OK && size < all);
    p = (uint8_t *)malloc(size);
    REQUIRE(p != NULL);
    CHECK(voxrt_tree_save_memory(t, &d, p, size, &size) == VOXRT_OK);
    CHECK(voxrt_tree_load_memory(NULL, p, size, &u) == VOXRT_OK);
    REQUIRE(u != NULL);
    voxrt_tree_get_info(u, &info);
    CHECK(!info.has_normals && info.has_colors);
    voxrt_tree_destroy(u);
    voxrt_tree_destroy(t);
    free(p);
}

TEST(bits_per_leaf) {
    cells c;
    voxrt_build_desc d;
    voxrt_tree *t = NULL, *u = NULL;
    uint32_t size = test_quick() ? 128 : 256;
    double bits, all, start, seconds;
    size_t bytes;
    uint8_t *p;
    memset(&c, 0, sizeof c);
    add_sphere(&c, size, 0.45 * size);
    memset(&d, 0, sizeof d);
    d.disable_colors = 1;
    CHECK(voxrt_tree_from_voxels(&d, c.v, c.n, size == 128 ? 7 : 8, &t) == VOXRT_OK);
    REQUIRE(t != NULL);
    p = save(t, 0, &bytes);
    REQUIRE(p != NULL);
    bits = 8.0 * (double)format_get(entry(p, 6) + 16, 8) / (double)c.n;
    all = 8.0 * (double)bytes / (double)c.n;
    start = test_now();
    CHECK(voxrt_tree_load_memory(NULL, p, bytes, &u) == VOXRT_OK);
    seconds = test_now() - start;
    printf("sphere %u^3: %u voxels, geometry %.3f bits a voxel, file with normals %.3f, load %.1f M voxels/s\n", size,
           (unsigned)c.n, bits, all, 1e-6 * (double)c.n / seconds);
    CHECK_MSG(bits <= 2.0, "%.3f bits", bits);
    CHECK_MSG(all <= 14.0, "%.3f bits", all);
    voxrt_tree_destroy(u);
    voxrt_tree_destroy(t);
    free(p);
    free(c.v);
}

/* ---- damage ------------------------------------------------------------------------------------------------ */

/* Load and, if aligned, map. Returns the result of load; a tree that is accepted is used. */
static voxrt_result try_load(const uint8_t *p, size_t size) {
    voxrt_tree *u = NULL, *m = NULL;
    void *block;
    uint8_t *q = aligned_copy(p, size, &block);
    voxrt_error error;
    voxrt_load_desc d;
    voxrt_result r, rm;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.env.error = &error;
    r = voxrt_tree_load_memory(&d, q, size, &u);
    CHECK((r == VOXRT_OK) == (u != NULL));
    CHECK(error.code == r && (r == VOXRT_OK || error.text[0] != 0));
    if (u != NULL) use(u);
    rm = voxrt_tree_map_memory(&d, q, size, &m);
    CHECK((rm == VOXRT_OK) == (m != NULL));
    if (rm != VOXRT_ERR_INVALID_ARG) CHECK((rm == VOXRT_OK) == (r == VOXRT_OK));
    if (m != NULL && u != NULL) CHECK_EQ_U64(voxrt_tree_hash(m), voxrt_tree_hash(u));
    voxrt_tree_destroy(u);
    voxrt_tree_destroy(m);
    free(block);
    return r;
}

static int is_damage(voxrt_result r) {
    return r == VOXRT_ERR_TRUNCATED || r == VOXRT_ERR_FORMAT || r == VOXRT_ERR_CHECKSUM || r == VOXRT_ERR_VERSION;
}

TEST(every_truncation_and_one_more) {
    int kind, encoding;
    for (kind = 0; kind < 6; kind += kind == 1 ? 4 : 1)
        for (encoding = 0; encoding < 2; encoding++) {
            voxrt_tree *t = make_tree(kind, 1, 1);
            size_t size, k, step;
            uint8_t *p, *q;
            REQUIRE(t != NULL);
            p = save(t, encoding, &size);
            REQUIRE(p != NULL);
            step = size > 4000 && test_quick() ? 17 : 1;
            for (k = 0; k < size; k += step) CHECK(try_load(p, k) == VOXRT_ERR_TRUNCATED);
            q = (uint8_t *)malloc(size + 1);
            REQUIRE(q != NULL);
            memcpy(q, p, size);
            q[size] = 0;
            CHECK(try_load(q, size + 1) == VOXRT_ERR_FORMAT);
            put(q + 16, 8, size + 1);
            seal(q, size + 1);
            CHECK(try_load(q, size + 1) == VOXRT_ERR_FORMAT);
            put(q + 16, 8, size - 1); /* the last section reaches beyond */
            seal(q, size - 1);
            CHECK(is_damage(try_load(q, size - 1)));
            free(q);
            free(p);
            voxrt_tree_destroy(t);
        }
}

TEST(every_byte_changed) {
    int kind, encoding;
    uint32_t loaded = 0;
    for (kind = 0; kind < 7; kind++)
        for (encoding = 0; encoding < 2; encoding++) {
            voxrt_tree *t = make_tree(kind, 1, 1);
            size_t size, k, step;
            uint8_t *p, was;
            uint32_t bit;
            REQUIRE(t != NULL);
            p = save(t, encoding, &size);
            REQUIRE(p != NULL);
            step = size > 3000 ? (test_quick() || TEST_SANITIZED ? 29 : 11) : 1;
            for (k = 0; k < size; k += step) {
                was = p[k];
                for (bit = 0; bit < 8; bit += 3) { /* found as it is: each byte is covered */
                    p[k] = (uint8_t)(was ^ (1u << bit));
                    CHECK_MSG(is_damage(try_load(p, size)), "kind %d encoding %d byte %u", kind, encoding, (unsigned)k);
                }
                p[k] = was;
            }
            for (k = 0; k < size; k += step) { /* with right checksums: rejected or safe */
                static const uint8_t change[4] = {0x01, 0x80, 0xff, 0x10};
                uint8_t *q = (uint8_t *)malloc(size);
                if (q == NULL) exit(1);
                memcpy(q, p, size);
                q[k] ^= change[k & 3];
                seal(q, size);
                if (try_load(q, size) == VOXRT_OK) loaded++;
                free(q);
            }
            free(p);
            voxrt_tree_destroy(t);
        }
    CHECK(loaded > 100); /* colours and placement may be anything */
}

TEST(random_damage_with_right_checksums) {
    test_rng r = test_rng_make(9);
    int round, rounds = test_quick() || TEST_SANITIZED ? 300 : 3000;
    size_t size[2][7];
    uint8_t *p[2][7];
    int kind, encoding;
    for (kind = 0; kind < 7; kind++)
        for (encoding = 0; encoding < 2; encoding++) {
            voxrt_tree *t = make_tree(kind, 1, 1);
            REQUIRE(t != NULL);
            p[encoding][kind] = save(t, encoding, &size[encoding][kind]);
            REQUIRE(p[encoding][kind] != NULL);
            voxrt_tree_destroy(t);
        }
    for (round = 0; round < rounds; round++) {
        uint32_t k, e = test_rng_below(&r, 2), f = test_rng_below(&r, 7), n = 1 + test_rng_below(&r, 8);
        size_t s = size[e][f], at, i;
        uint8_t *q = (uint8_t *)malloc(s);
        REQUIRE(q != NULL);
        memcpy(q, p[e][f], s);
        for (k = 0; k < n; k++) {
            at = test_rng_below(&r, (uint32_t)s);
            if (test_rng_below(&r, 3) == 0) at %= 512; /* more often header, table and placement */
            if (at >= s) at = s - 1;
            i = test_rng_below(&r, 4);
            if (i == 0) q[at] = (uint8_t)test_rng_u32(&r);
            else if (i == 1) q[at] ^= (uint8_t)(1u << test_rng_below(&r, 8));
            else if (i == 2 && at + 4 <= s) put(q + at, 4, test_rng_below(&r, 2) ? 0xffffffffu : test_rng_u32(&r));
            else if (at + 8 <= s) put(q + (at & ~(size_t)7), 8, test_rng_below(&r, 2) ? ~(uint64_t)0 : format_get(q + (at & ~(size_t)7), 8) + 1);
        }
        seal(q, s);
        (void)try_load(q, s);
        free(q);
    }
    for (kind = 0; kind < 7; kind++)
        for (encoding = 0; encoding < 2; encoding++) free(p[encoding][kind]);
}

TEST(versions_and_sections) {
    voxrt_tree *t = make_tree(5, 1, 1);
    size_t size, at, n;
    uint8_t *p, *q, *e;
    uint32_t id;
    int encoding;
    REQUIRE(t != NULL);
    for (encoding = 0; encoding < 2; encoding++) {
        p = save(t, encoding, &size);
        REQUIRE(p != NULL);
        n = (size_t)format_get(p + 14, 2);
        q = (uint8_t *)malloc(size + 512);
        REQUIRE(q != NULL);
#define AGAIN() memcpy(q, p, size)
#define EXPECT(result) do { seal(q, size); CHECK_EQ_U64(try_load(q, size), result); } while (0)
        AGAIN(); put(q + 8, 2, 4); EXPECT(VOXRT_ERR_VERSION);
        AGAIN(); put(q + 8, 2, 6); EXPECT(VOXRT_ERR_VERSION);
        AGAIN(); put(q + 10, 2, 7); EXPECT(VOXRT_OK);          /* a later minor version */
        AGAIN(); put(q + 12, 2, 128); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 14, 2, 0); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 14, 2, n - 1); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 14, 2, 65535); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 32, 4, format_get(q + 32, 4) ^ 1); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 32, 4, format_get(q + 32, 4) | 8); EXPECT(VOXRT_OK); /* the same normals in the other code */
        AGAIN(); put(q + 32, 4, format_get(q + 32, 4) | 16); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 36, 4, 0); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 36, 4, 21); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 36, 4, 7); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 36, 4, 6); EXPECT(VOXRT_OK);          /* the same cells in a corner of twice the cube */
        AGAIN(); put(q + 40, 4, 0); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 40, 4, 33); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 40, 4, 31); EXPECT(VOXRT_OK);
        AGAIN(); put(q + 48, 8, format_get(q + 48, 8) + 1); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 56, 8, format_get(q + 56, 8) + 1); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + 56, 8, 0xffffffffu); EXPECT(VOXRT_ERR_FORMAT);
        for (id = 1; id < 10; id++) {
            if (entry(p, id) == NULL) continue;
            AGAIN(); e = entry(q, id); put(e + 4, 4, 2); EXPECT(VOXRT_ERR_VERSION);
            AGAIN(); e = entry(q, id); put(e + 8, 8, format_get(e + 8, 8) - 64); EXPECT(VOXRT_ERR_FORMAT); /* overlap */
            AGAIN(); e = entry(q, id); put(e + 8, 8, format_get(e + 8, 8) + 64); EXPECT(VOXRT_ERR_FORMAT); /* gap */
            AGAIN(); e = entry(q, id); put(e + 8, 8, format_get(e + 8, 8) + 1); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); e = entry(q, id); put(e + 8, 8, (uint64_t)0 - 64); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); e = entry(q, id); put(e + 16, 8, format_get(e + 16, 8) - 1); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); e = entry(q, id); put(e + 16, 8, (uint64_t)0 - 1); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); e = entry(q, id); put(e + 24, 8, format_get(e + 24, 8) + 1); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); e = entry(q, id); put(e, 4, 11); CHECK(is_damage((seal(q, size), try_load(q, size))));
            at = (size_t)(format_get(entry(p, id) + 8, 8) - 1); /* what is before a section must be zero */
            if (id != 1 && p[at] == 0 && format_get(entry(p, id) - 32, 8) + format_get(entry(p, id) - 24, 8) <= at) {
                AGAIN(); q[at] = 1; EXPECT(VOXRT_ERR_FORMAT);
            }
        }
        /* one more section: the table grows by an entry and still ends before the first section */
        at = (size_t)format_get(p + 64 + 8, 8);
        for (id = 0; id < 2; id++) {
            size_t end = (size + 63) & ~(size_t)63, move = 64 + (n + 1) * 40 > at ? 64 : 0, i;
            memset(q, 0, size + 512);
            memcpy(q, p, 64 + n * 40);
            memcpy(q + at + move, p + at, size - at);
            for (i = 0; i < n; i++) put(q + 64 + 40 * i + 8, 8, format_get(q + 64 + 40 * i + 8, 8) + move);
            put(q + 14, 2, n + 1);
            e = q + 64 + 40 * n;
            put(e, 4, id == 0 ? 0x80000001u : 77u);
            put(e + 4, 4, 9);
            put(e + 8, 8, end + move);
            put(e + 16, 8, 5);
            memcpy(q + end + move, "hello", 5);
            put(q + 16, 8, end + move + 5);
            seal(q, end + move + 5);
            CHECK_EQ_U64(try_load(q, end + move + 5), id == 0 ? VOXRT_OK : VOXRT_ERR_VERSION);
            if (id == 0) { /* two of them: only in order */
                uint32_t second;
                size_t from = at + move, more = 64 + (n + 2) * 40 > from ? 64 : 0, last = end + move + 64 + more;
                put(q + 14, 2, n + 2);
                for (i = 0; i < n + 1; i++) put(q + 64 + 40 * i + 8, 8, format_get(q + 64 + 40 * i + 8, 8) + more);
                memmove(q + from + more, q + from, end + move + 64 - from);
                memset(q + 64 + 40 * (n + 1), 0, from + more - (64 + 40 * (n + 1)));
                put(e + 48, 8, last);
                put(e + 56, 8, 1);
                put(q + 16, 8, last + 1);
                for (second = 0; second < 3; second++) {
                    put(e + 40, 4, 0x80000000u + second);
                    seal(q, last + 1);
                    CHECK_EQ_U64(try_load(q, last + 1), second == 2 ? VOXRT_OK : VOXRT_ERR_FORMAT);
                }
                continue;
            }
            e[32] ^= 1; /* also what is skipped has to be whole */
            CHECK(is_damage(try_load(q, end + move + 5)));
        }
        free(q);
        free(p);
    }
    voxrt_tree_destroy(t);
}

TEST(wrong_values) {
    voxrt_tree *t = make_tree(6, 1, 1);
    size_t size, place;
    uint8_t *p, *q;
    double bad[4];
    uint64_t bits;
    uint32_t i, encoding;
    REQUIRE(t != NULL);
    bad[0] = (double)NAN;
    bad[1] = (double)INFINITY;
    bad[2] = -1;
    bad[3] = 0;
    for (encoding = 0; encoding < 2; encoding++) {
        p = save(t, (int)encoding, &size);
        REQUIRE(p != NULL);
        q = (uint8_t *)malloc(size);
        REQUIRE(q != NULL);
        place = (size_t)format_get(entry(p, 1) + 8, 8);
        for (i = 0; i < 4; i++) {
            memcpy(&bits, &bad[i], 8);
            AGAIN(); put(q + place + 24, 8, bits); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + place + 8, 8, bits); EXPECT(i < 2 ? VOXRT_ERR_FORMAT : VOXRT_OK);
        }
        for (i = 0; i < 6; i++) { /* a box that is too large or too little */
            AGAIN(); put(q + place + 32 + 4 * i, 4, format_get(q + place + 32 + 4 * i, 4) + 1); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + place + 32 + 4 * i, 4, format_get(q + place + 32 + 4 * i, 4) - 1); EXPECT(VOXRT_ERR_FORMAT);
        }
        for (i = 0; i < 2; i++) { /* a depth that no tree has: where it stands */
            voxrt_tree *u = NULL;
            voxrt_load_desc d;
            voxrt_error error;
            memset(&d, 0, sizeof d);
            d.env.error = &error;
            AGAIN(); put(q + 36, 4, i == 0 ? 0 : 21); EXPECT(VOXRT_ERR_FORMAT);
            CHECK(voxrt_tree_load_memory(&d, q, size, &u) == VOXRT_ERR_FORMAT && error.where == 36);
        }
        AGAIN(); put(q + place + 56, 4, 0); EXPECT(VOXRT_ERR_FORMAT);
        AGAIN(); put(q + place + 60, 4, 1); EXPECT(VOXRT_ERR_FORMAT);
        for (i = 0; i < 10; i++) {
            AGAIN(); put(q + place + 64 + 4 * i, 4, format_get(q + place + 64 + 4 * i, 4) + 1); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + place + 104 + 4 * i, 4, format_get(q + place + 104 + 4 * i, 4) + 1); EXPECT(VOXRT_ERR_FORMAT);
        }
        if (encoding == 1) {
            size_t nodes = (size_t)format_get(entry(p, 3) + 8, 8), leaves = (size_t)format_get(entry(p, 4) + 8, 8),
                ranks = (size_t)format_get(entry(p, 5) + 8, 8);
            AGAIN(); put(q + nodes, 8, 0); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + nodes, 8, format_get(q + nodes, 8) | (uint64_t)1 << 63); EXPECT(VOXRT_ERR_FORMAT); /* odd depth: octant 0 only */
            AGAIN(); put(q + nodes + 8, 4, 0xffffffffu); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + nodes + 16 + 12, 4, 99); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + leaves + 16, 8, 0); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + leaves + (size_t)format_get(entry(p, 4) + 16, 8) - 8, 8, 1); EXPECT(VOXRT_ERR_FORMAT);
            { /* an empty leaf node, its voxel moved to another one of the same 16: only the empty mask tells */
                size_t one[2] = {0, 0}, found = 0, k;
                for (k = 0; k < 16 && found < 2; k++)
                    if (slow_bits(format_get(p + leaves + 8 * k, 8)) == 1) one[found++] = leaves + 8 * k;
                CHECK(found == 2);
                AGAIN();
                put(q + one[0], 8, 0);
                put(q + one[1], 8, format_get(q + one[1], 8) | (format_get(q + one[1], 8) > 255 ? 1u : 0x100u));
                EXPECT(VOXRT_ERR_FORMAT);
            }
            AGAIN(); put(q + ranks, 4, 1); EXPECT(VOXRT_ERR_FORMAT);
            AGAIN(); put(q + ranks + (size_t)format_get(entry(p, 5) + 16, 8) - 4, 4, 1); EXPECT(VOXRT_ERR_FORMAT);
        }
        free(q);
        free(p);
    }
    voxrt_tree_destroy(t);
}

TEST(wrong_counts_without_attributes) {
    voxrt_tree *t = make_tree(6, 0, 0), *u = NULL;
    voxrt_load_desc d;
    size_t size, place;
    uint8_t *p, *q;
    uint32_t i, encoding;
    REQUIRE(t != NULL);
    for (encoding = 0; encoding < 2; encoding++) {
        p = save(t, (int)encoding, &size);
        REQUIRE(p != NULL);
        q = (uint8_t *)malloc(size);
        REQUIRE(q != NULL);
        place = (size_t)format_get(entry(p, 1) + 8, 8);
        AGAIN(); EXPECT(VOXRT_OK);
        for (i = 0; i < 10; i++) {
            AGAIN(); put(q + place + 104 + 4 * i, 4, format_get(q + place + 104 + 4 * i, 4) + 1); EXPECT(VOXRT_ERR_FORMAT);
        }
        AGAIN(); put(q + 56, 8, format_get(q + 56, 8) + 1); EXPECT(VOXRT_ERR_FORMAT);
        for (i = 1; encoding == 0 && i < t->wide; i++) { /* one node more or less, wherever it is counted */
            uint32_t k, less;
            for (less = 0; less < 2; less++) {
                uint64_t change = less ? ~(uint64_t)0 : 1;
                AGAIN();
                put(q + place + 64 + 4 * i, 4, format_get(q + place + 64 + 4 * i, 4) + change);
                put(q + 48, 8, format_get(q + 48, 8) + change);
                for (k = 0; k < 6; k++) if (entry(q, 6) == q + 64 + 40 * k) put(q + 64 + 40 * k + 24, 8, format_get(q + 48, 8));
                EXPECT(VOXRT_ERR_FORMAT);
            }
        }
        free(q);
        free(p);
    }
    voxrt_tree_destroy(t);
    t = make_tree(1, 0, 0); /* depth 2 with voxels in two octants is no tree of depth 1, trusted or not */
    REQUIRE(t != NULL);
    for (encoding = 0; encoding < 2; encoding++) {
        p = save(t, (int)encoding, &size);
        REQUIRE(p != NULL);
        place = (size_t)format_get(entry(p, 1) + 8, 8);
        put(p + 36, 4, 1);
        put(p + 40, 4, 2);
        for (i = 0; i < 6; i++) put(p + place + 32 + 4 * i, 4, i < 3 ? 0 : 2);
        seal(p, size);
        memset(&d, 0, sizeof d);
        for (d.trust_input = 0; d.trust_input < 2; d.trust_input++)
            CHECK(voxrt_tree_load_memory(&d, p, size, &u) == VOXRT_ERR_FORMAT);
        free(p);
    }
    voxrt_tree_destroy(t);
}

/* Files of a few hundred bytes that speak of billions. */
TEST(hostile_counts) {
    int kind, encoding;
    for (kind = 0; kind < 8; kind++)
        for (encoding = 0; encoding < 2; encoding++) {
            voxrt_tree *t = make_tree(kind / 2, 0, kind & 1), *u = NULL;
            voxrt_load_desc d;
            test_alloc ta;
            size_t size, place;
            uint8_t *p, *e;
            uint32_t id, wide;
            uint64_t nodes, attributes = 4200000000u;
            REQUIRE(t != NULL);
            wide = t->wide;
            p = save(t, encoding, &size);
            REQUIRE(p != NULL);
            place = (size_t)format_get(entry(p, 1) + 8, 8);
            nodes = wide > 1 ? 4000000000u : 1;
            put(p + place + 64 + 4 * (wide - 1), 4, nodes);
            put(p + place + 104 + 4 * (wide - 1), 4, 4000000000u);
            for (id = 0; id + 1 < wide; id++) nodes += format_get(p + place + 64 + 4 * id, 4);
            for (id = 0; id < wide; id++) attributes += format_get(p + place + 104 + 4 * id, 4);
            attributes += nodes;
            put(p + 48, 8, nodes);
            put(p + 56, 8, 4200000000u);
            if (encoding == 0) put(p + format_get(entry(p, 6) + 8, 8), 4, wide - 1 + (wide > 1 ? 976563u : 1u));
            for (id = 3; id < 8; id++) {
                e = entry(p, id);
                if (e != NULL) put(e + 24, 8, id == 7 ? attributes : id == 6 ? nodes : 4000000000u);
            }
            seal(p, size);
            for (id = 0; id < 2; id++) {
                test_alloc_init(&ta);
                memset(&d, 0, sizeof d);
                d.env.allocator.alloc_fn = test_alloc_fn;
                d.env.allocator.free_fn = test_free_fn;
                d.env.allocator.user = &ta;
                d.trust_input = id;
                CHECK(voxrt_tree_load_memory(&d, p, size, &u) == VOXRT_ERR_FORMAT);
                CHECK(u == NULL);
                CHECK_MSG(ta.peak_bytes < 100000, "%llu bytes", (unsigned long long)ta.peak_bytes);
                test_alloc_check(&ta);
            }
            free(p);
            voxrt_tree_destroy(t);
        }
}

/* ---- resources --------------------------------------------------------------------------------------------- */

TEST(allocation_failures) {
    int kind, what;
    for (kind = 5; kind < 9; kind += 3)
        for (what = 0; what < 5; what++) {
            voxrt_tree *t = make_tree(kind, 1, 1), *u;
            size_t size = 0, out;
            uint8_t *p, *q;
            void *block;
            int64_t k;
            const int raw = what == 4 || (what & 1); /* only such a file can be mapped */
            REQUIRE(t != NULL);
            p = save(t, raw, &size);
            REQUIRE(p != NULL);
            q = aligned_copy(p, size, &block);
            for (k = 0; k < 100; k++) {
                test_alloc ta;
                voxrt_save_desc s;
                voxrt_load_desc d;
                voxrt_result r;
                test_alloc_init(&ta);
                ta.fail_at = k;
                memset(&s, 0, sizeof s);
                memset(&d, 0, sizeof d);
                s.env.allocator.alloc_fn = test_alloc_fn;
                s.env.allocator.free_fn = test_free_fn;
                s.env.allocator.user = &ta;
                d.env = s.env;
                s.encoding = raw ? VOXRT_ENCODING_RAW : VOXRT_ENCODING_COMPACT;
                u = NULL;
                if (what < 2) r = voxrt_tree_load_memory(&d, q, size, &u);
                else if (what < 4) r = voxrt_tree_save_memory(t, &s, q, size, &out);
                else r = voxrt_tree_map_memory(&d, q, size, &u);
                if (what == 4 && !voxrti_little_endian()) {
                    CHECK(r == VOXRT_ERR_INVALID_ARG && u == NULL);
                    k = 2;
                    break;
                }
                CHECK(r == (ta.failed ? VOXRT_ERR_NO_MEMORY : VOXRT_OK));
                CHECK((u != NULL) == (r == VOXRT_OK && (what < 2 || what == 4)));
                voxrt_tree_destroy(u);
                test_alloc_check(&ta);
                if (!ta.failed) break;
            }
            CHECK(k < 100);
            if (what < 2) CHECK(k > 5);
            if (what == 4) CHECK(k > 0);
            free(block);
            free(p);
            voxrt_tree_destroy(t);
        }
}

TEST(memory_limit) {
    voxrt_tree *t = make_tree(7, 1, 1), *u = NULL;
    const char *path = test_temp_path(".vox");
    size_t size, limit;
    uint8_t *p;
    int raw, named;
    REQUIRE(t != NULL);
    for (raw = 0; raw < 2; raw++)
        for (named = 0; named < 2; named++) { /* what is read from a file counts as well, until it has been read */
            int refused = 0, done = 0;
            p = save(t, raw, &size);
            REQUIRE(p != NULL && test_write_file(path, p, size));
            for (limit = 1000; limit < 10000000 && done < 3; limit = limit * 9 / 8) {
                voxrt_load_desc d;
                test_alloc ta;
                voxrt_result r;
                test_alloc_init(&ta);
                memset(&d, 0, sizeof d);
                d.env.allocator.alloc_fn = test_alloc_fn;
                d.env.allocator.free_fn = test_free_fn;
                d.env.allocator.user = &ta;
                d.env.memory_limit = limit;
                r = named ? voxrt_tree_load_file(&d, path, &u) : voxrt_tree_load_memory(&d, p, size, &u);
                CHECK(r == VOXRT_OK || r == VOXRT_ERR_NO_MEMORY);
                CHECK_MSG(ta.peak_bytes <= limit, "%d %d: %u bytes, the limit is %u", raw, named, (unsigned)ta.peak_bytes, (unsigned)limit);
                refused += r != VOXRT_OK;
                done += r == VOXRT_OK;
                voxrt_tree_destroy(u);
                test_alloc_check(&ta);
            }
            CHECK_MSG(refused > 3 && done == 3, "%d %d: %d refused, %d done", raw, named, refused, done);
            free(p);
        }
    remove(path);
    voxrt_tree_destroy(t);
}

TEST(buffers_of_every_size) {
    voxrt_tree *t = make_tree(1, 1, 1);
    uint8_t *p, *q;
    size_t size, k, out, i;
    int encoding;
    REQUIRE(t != NULL);
    for (encoding = 0; encoding < 2; encoding++) {
        voxrt_save_desc d;
        memset(&d, 0, sizeof d);
        d.encoding = (voxrt_encoding)encoding;
        p = save(t, encoding, &size);
        REQUIRE(p != NULL);
        for (k = 0; k <= size + 1; k += k > 300 && k + 300 < size ? 13 : 1) {
            q = (uint8_t *)malloc(k != 0 ? k : 1);
            REQUIRE(q != NULL);
            memset(q, 0xa5, k != 0 ? k : 1);
            out = 0;
            CHECK(voxrt_tree_save_memory(t, &d, q, k, &out) == (k < size ? VOXRT_ERR_RANGE : VOXRT_OK));
            CHECK(out == size);
            if (k < size) for (i = 0; i < k; i++) CHECK(q[i] == 0xa5);
            else CHECK(memcmp(p, q, size) == 0);
            if (k > size) CHECK(q[size] == 0xa5);
            free(q);
        }
        free(p);
    }
    voxrt_tree_destroy(t);
}

TEST(arguments) {
    voxrt_tree *t = make_tree(1, 1, 1), *u = (voxrt_tree *)t;
    voxrt_save_desc s;
    voxrt_load_desc d;
    voxrt_error error;
    size_t size = 1, raw_size;
    uint8_t *p, *raw, *q;
    void *block;
    REQUIRE(t != NULL);
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    d.env.error = s.env.error = &error;
    CHECK(voxrt_tree_save_memory(NULL, &s, NULL, 0, &size) == VOXRT_ERR_INVALID_ARG && size == 0);
    CHECK(voxrt_tree_save_memory(t, &s, NULL, 0, NULL) == VOXRT_ERR_INVALID_ARG);
    s.encoding = (voxrt_encoding)3;
    CHECK(voxrt_tree_save_memory(t, &s, NULL, 0, &size) == VOXRT_ERR_INVALID_ARG);
    s._end_zero = 1;
    CHECK(voxrt_tree_save_memory(t, &s, NULL, 0, &size) == VOXRT_ERR_UNINIT_DESC);
    p = save(t, 0, &size);
    raw = save(t, 1, &raw_size);
    REQUIRE(p != NULL && raw != NULL);
    CHECK(voxrt_tree_load_memory(&d, p, size, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_tree_load_memory(&d, NULL, size, &u) == VOXRT_ERR_INVALID_ARG && u == NULL);
    CHECK(voxrt_tree_load_memory(&d, NULL, 0, &u) == VOXRT_ERR_TRUNCATED && u == NULL);
    CHECK(voxrt_tree_load_memory(&d, "MB\4\0 this is another format", 20, &u) == VOXRT_ERR_FORMAT);
    CHECK(error.code == VOXRT_ERR_FORMAT && error.text[0] != 0);
    d._begin_zero = 1;
    CHECK(voxrt_tree_load_memory(&d, p, size, &u) == VOXRT_ERR_UNINIT_DESC);
    d._begin_zero = 0;
    d.env.allocator.alloc_fn = test_alloc_fn;
    CHECK(voxrt_tree_load_memory(&d, p, size, &u) == VOXRT_ERR_INVALID_ARG && strstr(error.text, "free_fn") != NULL);
    d.env.allocator.alloc_fn = NULL;
    q = aligned_copy(p, size, &block);
    CHECK(voxrt_tree_map_memory(&d, q, size, &u) == VOXRT_ERR_INVALID_ARG && u == NULL); /* compact */
    free(block);
    q = (uint8_t *)malloc(raw_size + 128);
    REQUIRE(q != NULL);
    {
        uint8_t *a = q + (64 - ((uintptr_t)q & 63u)) % 64;
        memcpy(a + 8, raw, raw_size);
        CHECK(voxrt_tree_map_memory(&d, a + 8, raw_size, &u) == VOXRT_ERR_INVALID_ARG && u == NULL);
        memmove(a, a + 8, raw_size);
        if (voxrti_little_endian()) CHECK(voxrt_tree_map_memory(&d, a, raw_size, &u) == VOXRT_OK && u != NULL);
        else CHECK(voxrt_tree_map_memory(&d, a, raw_size, &u) == VOXRT_ERR_INVALID_ARG && u == NULL);
        voxrt_tree_destroy(u);
    }
    CHECK_EQ_U64(voxrt_file_kind(p, size), 5);
    CHECK_EQ_U64(voxrt_file_kind(p, 12), 5);
    CHECK_EQ_U64(voxrt_file_kind(p, 11), 0);
    CHECK_EQ_U64(voxrt_file_kind("MB\4\0", 4), 4);
    CHECK_EQ_U64(voxrt_file_kind("MB\3\0", 4), 0);
    CHECK_EQ_U64(voxrt_file_kind("MB", 2), 0);
    CHECK_EQ_U64(voxrt_file_kind(NULL, 0), 0);
    p[8] = 6;
    CHECK_EQ_U64(voxrt_file_kind(p, size), 0);
    free(p);
    free(q);
    free(raw);
    voxrt_tree_destroy(t);
}

/* A file is in memory once while it is read; one that does not tell how long it is, too. */
TEST(file_read) {
    enum { N = 300001 };
    const char *path = test_temp_path(".bytes");
    uint8_t *bytes = (uint8_t *)calloc(N, 1);
    voxrt_env env;
    voxrti_mem mem;
    test_alloc ta;
    void *got = NULL;
    size_t size = 0;
    REQUIRE(bytes != NULL);
    bytes[N - 1] = 7;
    memset(&env, 0, sizeof env);
    test_alloc_init(&ta);
    env.allocator.alloc_fn = test_alloc_fn;
    env.allocator.free_fn = test_free_fn;
    env.allocator.user = &ta;
    CHECK(voxrti_env_open(&env, &mem) == VOXRT_OK);
    CHECK(test_write_file(path, bytes, N));
    CHECK(voxrti_read_file(&mem, path, &got, &size) == VOXRT_OK);
    CHECK(size == N && got != NULL && memcmp(got, bytes, N) == 0);
    CHECK_MSG(ta.peak_bytes < N + 1000, "%.0f bytes", (double)ta.peak_bytes);
    voxrti_free(&mem, got);
#ifdef __linux__ /* says that it is empty */
    CHECK(voxrti_read_file(&mem, "/proc/cpuinfo", &got, &size) == VOXRT_OK && size > 10);
    voxrti_free(&mem, got);
    ta.fail_at = ta.count; /* no room for it */
    CHECK(voxrti_read_file(&mem, "/proc/cpuinfo", &got, &size) == VOXRT_ERR_NO_MEMORY && got == NULL && ta.failed == 1);
#endif
    test_alloc_check(&ta);
    remove(path);
    free(bytes);
}

TEST(files) {
    voxrt_tree *t = make_tree(7, 1, 1), *u = NULL;
    const char *path = test_temp_path(".vox");
    char other[1100];
    test_alloc ta;
    voxrt_save_desc s;
    voxrt_load_desc d;
    size_t size, got;
    uint8_t *p, *q;
    REQUIRE(t != NULL);
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    p = save(t, 0, &size);
    REQUIRE(p != NULL);
    CHECK(test_write_file(path, "old", 3)); /* is replaced */
    CHECK(voxrt_tree_save_file(t, NULL, path) == VOXRT_OK);
    q = test_read_file(path, &got);
    CHECK(q != NULL && got == size && memcmp(p, q, size) == 0);
    free(q);
    snprintf(other, sizeof other, "%s.part", path);
    CHECK(test_read_file(other, &got) == NULL);
    test_alloc_init(&ta);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    CHECK(voxrt_tree_load_file(&d, path, &u) == VOXRT_OK);
    REQUIRE(u != NULL);
    same_tree(t, u);
    voxrt_tree_destroy(u);
    test_alloc_check(&ta);
    d.env.memory_limit = size; /* not even the file's bytes and what surrounds them */
    CHECK(voxrt_tree_load_file(&d, path, &u) == VOXRT_ERR_NO_MEMORY && u == NULL);
    d.env.memory_limit = 0;
    test_alloc_check(&ta);
    CHECK(voxrt_tree_load_file(&d, "/nowhere/at/all.vox", &u) == VOXRT_ERR_IO && u == NULL);
    CHECK(voxrt_tree_load_file(&d, "/", &u) == VOXRT_ERR_IO && u == NULL);
    CHECK(voxrt_tree_load_file(&d, NULL, &u) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_tree_save_file(t, &s, "/nowhere/at/all.vox") == VOXRT_ERR_IO);
    CHECK(voxrt_tree_save_file(t, &s, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(test_write_file(path, "", 0));
    CHECK(voxrt_tree_load_file(&d, path, &u) == VOXRT_ERR_TRUNCATED && u == NULL);
    test_alloc_check(&ta);
    remove(path);
    free(p);
    voxrt_tree_destroy(t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(independent_reader);
    RUN(coded_sections_exactly);
    RUN(coded_sections_by_hand);
    RUN(normals_in_lanes);
    RUN(round_trips);
    RUN(through_both_formats);
    RUN(map_in_place);
    RUN(without_normals);
    RUN(bits_per_leaf);
    RUN(every_truncation_and_one_more);
    RUN(every_byte_changed);
    RUN(random_damage_with_right_checksums);
    RUN(versions_and_sections);
    RUN(wrong_values);
    RUN(wrong_counts_without_attributes);
    RUN(hostile_counts);
    RUN(allocation_failures);
    RUN(memory_limit);
    RUN(buffers_of_every_size);
    RUN(arguments);
    RUN(file_read);
    RUN(files);
    return test_end();
}
