/* test_voxrt_octree.c - the thesis' octree: structure, version 4 files, conversions, rays */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "../bench/baseline/neighbour.h"
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC push_options
#  pragma GCC optimize("fp-contract=off") /* private functions are inlined here: as in the header */
#endif

/* ---- helpers ---------------------------------------------------------------------------------------------- */

static const uint8_t golden[50] = { /* thesis fig. 17 */
    0x4d, 0x42, 0x04, 0x00, 0x02, 0x00, 0xff, 0xff, 0xff, 0x00, 0x00, 0x00, 0x7c, 0x7c,
    0x05, 0x00, 0xa1, 0x76, 0x04, 0x00, 0x3d, 0x42, 0x02, 0x00, 0x91, 0xbc, 0x04, 0x00, 0x1c, 0xaa,
    0x02, 0x00, 0x74, 0x32, 0x04, 0x00, 0x4a, 0x8f, 0x02, 0x00, 0x88, 0xe2, 0x04, 0x00, 0xf9, 0xc5,
    0x02, 0x00, 0x61, 0x5d};

static uint8_t palette4[12] = {255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9};

typedef struct bytes { uint8_t *p; size_t n, cap; } bytes;

static void octree_put(bytes *b, uint32_t v) {
    if (b->n == b->cap) {
        b->cap = b->cap != 0 ? 2 * b->cap : 1024;
        b->p = (uint8_t *)realloc(b->p, b->cap);
    }
    b->p[b->n++] = (uint8_t)v;
}

static void put_header(bytes *b, uint32_t colors) {
    uint32_t i;
    octree_put(b, 0x4d); octree_put(b, 0x42); octree_put(b, 4); octree_put(b, 0);
    octree_put(b, colors & 255u); octree_put(b, colors >> 8);
    for (i = 0; i < 3 * colors; i++) octree_put(b, i * 37 + 11);
    octree_put(b, 0x7c); octree_put(b, 0x7c);
}

typedef struct counts { uint64_t level[32], nodes, leaves, filled; uint32_t depth; } counts;

static void put_tree(bytes *b, test_rng *r, uint32_t level, uint32_t max_level, uint32_t colors,
    uint32_t node_percent, counts *c) {
    uint32_t node = level < max_level && (level == 0 || test_rng_below(r, 100) < node_percent), i;
    uint32_t index = test_rng_below(r, 2) ? test_rng_below(r, colors + 1) : 0, w = index << 1 | node;
    octree_put(b, w & 255u); octree_put(b, w >> 8);
    octree_put(b, test_rng_below(r, 4) ? test_rng_u32(r) & 255u : 0); octree_put(b, test_rng_u32(r) & 255u);
    c->level[level]++;
    if (level > c->depth) c->depth = level;
    if (!node) {
        c->leaves++;
        c->filled += index != 0;
        return;
    }
    c->nodes++;
    for (i = 0; i < 8; i++) put_tree(b, r, level + 1, max_level, colors, node_percent, c);
}

static voxrt_octree *make_octree(uint32_t depth, const voxrt_allocator *a) {
    voxrt_octree_desc d;
    voxrt_octree *t = NULL;
    memset(&d, 0, sizeof d);
    if (a != NULL) d.env.allocator = *a;
    CHECK(voxrt_octree_create(&d, depth, palette4, 4, &t) == VOXRT_OK);
    return t;
}

/* cells of a shell around the middle, of random noise, or both; the normal points outwards */
static voxrt_octree *make_shell(uint32_t depth, double radius, uint32_t noise, uint64_t seed) {
    voxrt_octree *t = make_octree(depth, NULL);
    test_rng r = test_rng_make(seed);
    uint32_t n = 1u << depth, x, y, z;
    for (z = 0; z < n; z++) {
        for (y = 0; y < n; y++) {
            for (x = 0; x < n; x++) {
                double m = 0.5 * n, dx = x + 0.5 - m, dy = y + 0.5 - m, dz = z + 0.5 - m;
                double d = sqrt(dx * dx + dy * dy + dz * dz) - radius * n;
                float v[3];
                v[0] = (float)dx; v[1] = (float)dy; v[2] = (float)dz;
                if (fabs(d) < 0.6 || (noise != 0 && test_rng_below(&r, noise) == 0))
                    CHECK(voxrt_octree_insert(t, x, y, z, 1 + (x + y + z) % 4, v) == VOXRT_OK);
            }
        }
    }
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK);
    return t;
}

static int same_octree(const voxrt_octree *a, const voxrt_octree *b) {
    return a->depth == b->depth && a->block_count == b->block_count && memcmp(a->voxel, b->voxel,
        64 * a->block_count) == 0;
}

/* ---- files ------------------------------------------------------------------------------------------------ */

TEST(golden_file) {
    voxrt_octree *t = NULL;
    voxrt_octree_info info;
    const voxrt_octree_voxel *v;
    uint8_t out[64];
    uint32_t colors;
    size_t n = 0, i;
    REQUIRE(voxrt_octree_load_memory(NULL, golden, sizeof golden, &t) == VOXRT_OK);
    voxrt_octree_get_info(t, &info);
    CHECK(info.depth == 1 && info.voxel_count == 9 && info.node_count == 1 && info.leaf_count == 8);
    CHECK(info.filled_leaves == 8 && info.palette_count == 2 && info.voxel_bytes == 72);
    v = voxrt_octree_voxels(t, &n);
    CHECK(n == 16 && v[0].index == 2 && v[0].children == 1 && v[0].theta == 0xa1 && v[0].phi == 0x76);
    for (i = 0; i < 8; i++) CHECK(v[8 + i].index == (i & 1 ? 1 : 2) && v[8 + i].children == 0);
    CHECK(v[9].theta == 0x91 && v[9].phi == (int8_t)-0x44);
    CHECK(voxrt_octree_save_memory(t, NULL, NULL, 0, &n) == VOXRT_OK && n == 50);
    CHECK(voxrt_octree_save_memory(t, NULL, out, 49, &n) == VOXRT_ERR_RANGE && n == 50);
    CHECK(voxrt_octree_save_memory(t, NULL, out, sizeof out, &n) == VOXRT_OK && n == 50);
    CHECK(memcmp(out, golden, 50) == 0);
    CHECK(voxrt_file_kind(golden, sizeof golden) == 4);
    CHECK(memcmp(voxrt_octree_palette(t, &colors), golden + 6, 6) == 0 && colors == 2);
    CHECK(voxrt_octree_palette(NULL, &colors) == NULL && colors == 0);
    voxrt_octree_destroy(t);
}

TEST(random_files_round_trip) {
    test_rng r = test_rng_make(2);
    int k, rounds = test_quick() ? 60 : 300;
    for (k = 0; k < rounds; k++) {
        bytes b;
        counts c;
        voxrt_octree *t = NULL;
        voxrt_octree_info info;
        uint8_t *out;
        size_t n = 0;
        uint32_t colors = k % 7 == 0 ? 32767 : test_rng_below(&r, 300), l;
        memset(&b, 0, sizeof b);
        memset(&c, 0, sizeof c);
        put_header(&b, colors);
        put_tree(&b, &r, 0, test_rng_below(&r, 7), colors, 10 + test_rng_below(&r, 50), &c);
        REQUIRE(voxrt_octree_load_memory(NULL, b.p, b.n, &t) == VOXRT_OK);
        voxrt_octree_get_info(t, &info);
        CHECK(info.depth == c.depth && info.node_count == c.nodes && info.leaf_count == c.leaves);
        CHECK(info.filled_leaves == c.filled && info.voxel_count % 8 == 1 &&
            info.leaf_count == 7 * info.node_count + 1);
        for (l = 0; l <= VOXRT_MAX_DEPTH; l++) CHECK(info.level_count[l] == c.level[l]);
        out = (uint8_t *)malloc(b.n);
        CHECK(voxrt_octree_save_memory(t, NULL, out, b.n, &n) == VOXRT_OK && n == b.n);
        CHECK(memcmp(out, b.p, b.n) == 0);
        free(out);
        free(b.p);
        voxrt_octree_destroy(t);
    }
}

static voxrt_result octree_try_load(const uint8_t *p, size_t n, test_alloc *ta) { /* from a block of exactly n bytes */
    voxrt_octree_desc d;
    voxrt_octree *t = (voxrt_octree *)1;
    voxrt_error e;
    voxrt_result r;
    uint8_t *copy = (uint8_t *)malloc(n != 0 ? n : 1);
    memset(&d, 0, sizeof d);
    memset(&e, 0xff, sizeof e);
    if (n != 0) memcpy(copy, p, n);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = ta;
    d.env.error = &e;
    d.grid_level = 2;
    r = voxrt_octree_load_memory(&d, copy, n, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    CHECK(e.code == r);
    if (t != NULL) {
        size_t size = 0;
        CHECK(voxrt_octree_save_memory(t, NULL, NULL, 0, &size) == VOXRT_OK && size == n);
    }
    voxrt_octree_destroy(t);
    free(copy);
    return r;
}

TEST(hostile_files) {
    test_alloc ta;
    test_rng r = test_rng_make(3);
    bytes b;
    counts c;
    size_t n, k;
    uint8_t buf[64];
    test_alloc_init(&ta);
    memset(&b, 0, sizeof b);
    memset(&c, 0, sizeof c);
    put_header(&b, 3);
    put_tree(&b, &r, 0, 4, 3, 40, &c);
    for (n = 0; n < b.n; n++) CHECK(octree_try_load(b.p, n, &ta) == VOXRT_ERR_TRUNCATED);
    CHECK(octree_try_load(b.p, b.n, &ta) == VOXRT_OK);
    for (k = 1; k < 40; k += 3) { /* trailing bytes */
        bytes x = b;
        x.p = (uint8_t *)malloc(b.n + k);
        memcpy(x.p, b.p, b.n);
        memset(x.p + b.n, 0, k);
        CHECK(octree_try_load(x.p, b.n + k, &ta) == VOXRT_ERR_FORMAT);
        free(x.p);
    }
    for (k = 0; k < 8; k++) {
        memcpy(buf, golden, 50);
        buf[2] = (uint8_t)k;
        CHECK(octree_try_load(buf, 50, &ta) == (k == 4 ? VOXRT_OK : VOXRT_ERR_VERSION));
    }
    memcpy(buf, golden, 50);
    buf[0] = 0x42;
    CHECK(octree_try_load(buf, 50, &ta) == VOXRT_ERR_FORMAT);
    memcpy(buf, golden, 50);
    buf[5] = 0x80; /* 32770 colours */
    CHECK(octree_try_load(buf, 50, &ta) == VOXRT_ERR_FORMAT);
    memcpy(buf, golden, 50);
    buf[14 + 8] = 6; /* index 3 of 2 */
    CHECK(octree_try_load(buf, 50, &ta) == VOXRT_ERR_FORMAT);
    memcpy(buf, golden, 50);
    buf[12] = 0; /* separator: a warning */
    CHECK(octree_try_load(buf, 50, &ta) == VOXRT_OK);
    for (n = 19; n < 22; n++) { /* chains: 20 levels are allowed */
        bytes x;
        size_t i;
        memset(&x, 0, sizeof x);
        put_header(&x, 0);
        for (i = 0; i < n; i++) { octree_put(&x, 1); octree_put(&x, 0); octree_put(&x, 0); octree_put(&x, 0); }
        for (i = 0; i < 4 * (7 * n + 1); i++) octree_put(&x, 0);
        CHECK(octree_try_load(x.p, x.n, &ta) == (n <= 20 ? VOXRT_OK : VOXRT_ERR_FORMAT));
        free(x.p);
    }
    for (k = 0; k < (test_quick() ? 3000u : 20000u); k++) { /* flips */
        uint8_t *x = (uint8_t *)malloc(b.n);
        uint32_t f = 1 + test_rng_below(&r, 4);
        memcpy(x, b.p, b.n);
        while (f-- != 0) x[test_rng_below(&r, (uint32_t)b.n)] ^= (uint8_t)(1u << test_rng_below(&r, 8));
        (void)octree_try_load(x, b.n, &ta);
        free(x);
    }
    test_alloc_check(&ta);
    CHECK_MSG(ta.peak_bytes < 4 * b.n + 2000, "peak %lu for %lu", (unsigned long)ta.peak_bytes, (unsigned long)b.n);
    free(b.p);
}

TEST(file_options) {
    test_rng r = test_rng_make(4);
    bytes b;
    counts c;
    voxrt_octree *t[4];
    voxrt_octree_desc d;
    uint32_t x, y, z, l, n, k;
    memset(&b, 0, sizeof b);
    memset(&c, 0, sizeof c);
    put_header(&b, 5);
    put_tree(&b, &r, 0, 4, 5, 60, &c);
    memset(&d, 0, sizeof d);
    REQUIRE(voxrt_octree_load_memory(&d, b.p, b.n, &t[0]) == VOXRT_OK);
    d.flip_y = 1;
    d.box_size = 8;
    d.box_min[1] = -1;
    REQUIRE(voxrt_octree_load_memory(&d, b.p, b.n, &t[1]) == VOXRT_OK);
    d.flip_y = 0;
    d.flip_z = 1;
    REQUIRE(voxrt_octree_load_memory(&d, b.p, b.n, &t[2]) == VOXRT_OK);
    d.flip_z = 0;
    d.swap_angles = 1;
    REQUIRE(voxrt_octree_load_memory(&d, b.p, b.n, &t[3]) == VOXRT_OK);
    CHECK(t[1]->origin[1] == -1 && t[1]->voxel_size == 8.0 / (1u << c.depth) && t[0]->voxel_size == 1);
    l = c.depth;
    n = 1u << l;
    for (z = 0; z < n; z++) {
        for (y = 0; y < n; y++) {
            for (x = 0; x < n; x++) {
                uint32_t lev[4];
                voxrt_octree_voxel v[4];
                float n0[3], n1[3];
                for (k = 0; k < 4; k++)
                    v[k] = voxrt_octree_get(t[k], l, x, k == 1 ? n - 1 - y : y, k == 2 ? n - 1 - z : z, &lev[k]);
                for (k = 1; k < 4; k++) CHECK(v[k].index == v[0].index && lev[k] == lev[0]);
                CHECK(v[3].theta == (uint8_t)v[0].phi && (uint8_t)v[3].phi == v[0].theta);
                voxrti_sph_decode(v[0].theta, v[0].phi, n0);
                voxrti_sph_decode(v[1].theta, v[1].phi, n1);
                CHECK_NEAR(n0[0], n1[0], 1e-6);
                CHECK_NEAR(n0[1], -n1[1], 1e-6);
                voxrti_sph_decode(v[2].theta, v[2].phi, n1);
                CHECK_NEAR(n0[2], -n1[2], v[0].theta == 0 ? 1e-4 : 1e-6);
                CHECK_NEAR(n0[0], n1[0], v[0].theta == 0 ? 0.013 : 1e-6);
            }
        }
    }
    for (k = 0; k < 4; k++) voxrt_octree_destroy(t[k]);
    free(b.p);
}

TEST(files_on_disk) {
    const char *path = test_temp_path(".vox");
    char part[1100];
    voxrt_octree *t = NULL, *u = NULL;
    uint8_t *p;
    size_t n;
    FILE *f;
    REQUIRE(voxrt_octree_load_memory(NULL, golden, sizeof golden, &t) == VOXRT_OK);
    CHECK(voxrt_octree_save_file(t, NULL, path) == VOXRT_OK);
    p = test_read_file(path, &n);
    CHECK(p != NULL && n == 50 && memcmp(p, golden, 50) == 0);
    free(p);
    snprintf(part, sizeof part, "%s.part", path);
    f = fopen(part, "rb");
    CHECK(f == NULL);
    CHECK(voxrt_octree_load_file(NULL, path, &u) == VOXRT_OK && same_octree(t, u));
    voxrt_octree_destroy(u);
    remove(path);
    CHECK(voxrt_octree_load_file(NULL, path, &u) == VOXRT_ERR_IO && u == NULL);
    CHECK(voxrt_octree_save_file(t, NULL, "/nowhere/at/all.vox") == VOXRT_ERR_IO);
    voxrt_octree_destroy(t);
}

/* What is read from a file counts as well, until it has been read. */
TEST(limits_while_loading) {
    const char *path = test_temp_path(".vox");
    voxrt_octree *t = make_shell(5, 0.4, 50, 3);
    uint8_t *p;
    size_t n = 0, limit;
    int named;
    CHECK(voxrt_octree_save_file(t, NULL, path) == VOXRT_OK);
    p = test_read_file(path, &n);
    REQUIRE(p != NULL);
    for (named = 0; named < 2; named++) {
        int refused = 0, done = 0;
        for (limit = n / 2; limit < 100 * n && done < 3; limit += 1 + limit / 16) {
            voxrt_octree_desc d;
            voxrt_octree *u = NULL;
            voxrt_result r;
            test_alloc ta;
            memset(&d, 0, sizeof d);
            test_alloc_init(&ta);
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.env.memory_limit = limit;
            d.grid_level = 3;
            r = named ? voxrt_octree_load_file(&d, path, &u) : voxrt_octree_load_memory(&d, p, n, &u);
            CHECK((r == VOXRT_OK || r == VOXRT_ERR_NO_MEMORY) && (r == VOXRT_OK) == (u != NULL));
            CHECK_MSG(ta.peak_bytes <= limit, "%d: %u bytes, the limit is %u", named, (unsigned)ta.peak_bytes, (unsigned)limit);
            refused += r != VOXRT_OK;
            done += r == VOXRT_OK;
            voxrt_octree_destroy(u);
            test_alloc_check(&ta);
        }
        CHECK_MSG(refused > 8 && done == 3, "%d: %d refused, %d done", named, refused, done);
    }
    free(p);
    remove(path);
    voxrt_octree_destroy(t);
}

/* ---- structure -------------------------------------------------------------------------------------------- */

/* An octree keeps the limit of the call that made it, whatever that call held besides. */
TEST(limits_that_stay) {
    enum { N = 128 };
    const char *path = test_temp_path(".vox");
    voxrt_octree_desc d;
    voxrt_build_desc b;
    voxrt_voxel *v = (voxrt_voxel *)calloc(N * N, sizeof *v);
    voxrt_tree *t = NULL, *s = NULL;
    voxrt_octree *o = NULL;
    size_t before = 0, after = 0;
    uint32_t how, i;
    REQUIRE(v != NULL);
    for (i = 0; i < N * N; i++) {
        v[i].x = i % N;
        v[i].y = i / N;
        v[i].z = v[i].x * v[i].y / N;
    }
    memset(&b, 0, sizeof b);
    b.disable_normals = 1;
    REQUIRE(voxrt_tree_from_voxels(&b, v, N * N, 7, &t) == VOXRT_OK && voxrt_tree_share(t, NULL, &s) == VOXRT_OK);
    free(v);
    memset(&d, 0, sizeof d);
    d.disable_grid = 1;
    REQUIRE(voxrt_octree_from_tree(&d, t, &o) == VOXRT_OK && voxrt_octree_save_file(o, NULL, path) == VOXRT_OK);
    (void)voxrt_octree_voxels(o, &before);
    voxrt_octree_destroy(o);
    d.env.memory_limit = 3 * 8 * before + 8192; /* what there is, and twice as much while it is copied */
    for (how = 0; how < 3; how++) {
        o = NULL;
        if (how == 2) CHECK(voxrt_octree_load_file(&d, path, &o) == VOXRT_OK);
        else CHECK(voxrt_octree_from_tree(&d, how == 0 ? t : s, &o) == VOXRT_OK);
        REQUIRE(o != NULL);
        for (i = 0; i < N * N * N; i++)
            if (voxrt_octree_insert(o, i % N, i / N % N, i / N / N, 1, NULL) != VOXRT_OK) break;
        CHECK(i < N * N * N);
        (void)voxrt_octree_voxels(o, &after);
        CHECK_MSG(after >= 2 * before, "%u: from %u to %u voxels", how, (unsigned)before, (unsigned)after);
        voxrt_octree_destroy(o);
    }
    voxrt_tree_destroy(t);
    voxrt_tree_destroy(s);
    remove(path);
}

TEST(dense_counts) { /* thesis table 4 */
    static const uint64_t table[9][4] = {{1, 1, 0, 1}, {2, 8, 1, 9}, {3, 64, 9, 73}, {4, 512, 73, 585},
        {5, 4096, 585, 4681}, {6, 32768, 4681, 37449}, {7, 262144, 37449, 299593}, {8, 2097152, 299593, 2396745},
        {9, 16777216, 2396745, 19173961}};
    uint32_t level, levels = test_quick() ? 7 : 9;
    for (level = 1; level <= levels; level++) {
        uint32_t depth = level - 1;
        uint64_t n = table[level - 1][3], i;
        uint8_t *p = (uint8_t *)malloc((size_t)(4 * n + 11)), *q = p + 11;
        uint32_t left[16], sp = 0; /* a full tree in pre-order */
        voxrt_octree_desc d;
        voxrt_octree_info info;
        voxrt_octree *t = NULL;
        memset(&d, 0, sizeof d);
        d.disable_grid = 1;
        memcpy(p, "MB\4\0\1\0abc||", 11);
        for (i = 0; i < n; i++, q += 4) {
            while (sp > 0 && left[sp - 1] == 0) sp--;
            if (sp > 0) left[sp - 1]--;
            memset(q, 0, 4);
            q[0] = (uint8_t)(2u | (sp < depth));
            if (sp < depth) left[sp++] = 8;
        }
        REQUIRE(voxrt_octree_load_memory(&d, p, (size_t)(4 * n + 11), &t) == VOXRT_OK);
        voxrt_octree_get_info(t, &info);
        CHECK_EQ_U64(info.leaf_count, table[level - 1][1]);
        CHECK_EQ_U64(info.node_count, table[level - 1][2]);
        CHECK_EQ_U64(info.voxel_count, n);
        CHECK_EQ_U64(info.voxel_bytes, 8 * n);
        CHECK_EQ_U64(info.depth, depth);
        CHECK(info.leaf_count == 7 * info.node_count + 1);
        CHECK(voxrt_octree_collapse(t) == VOXRT_OK);
        voxrt_octree_get_info(t, &info);
        CHECK(info.voxel_count == 1 && info.filled_leaves == 1);
        voxrt_octree_destroy(t);
        free(p);
    }
}

TEST(insertion) {
    test_alloc ta;
    voxrt_allocator a;
    voxrt_octree *t;
    test_rng r = test_rng_make(5);
    uint8_t *cells = (uint8_t *)calloc(32768, 1);
    uint32_t i, x, y, z, level;
    static const float up[3] = {0, 2, 0};
    test_alloc_init(&ta);
    a.alloc_fn = test_alloc_fn; a.free_fn = test_free_fn; a.user = &ta;
    t = make_octree(5, &a);
    CHECK(voxrt_octree_insert(t, 32, 0, 0, 1, NULL) == VOXRT_ERR_RANGE);
    CHECK(voxrt_octree_insert(t, 0, 0, 0, 5, NULL) == VOXRT_ERR_RANGE);
    CHECK(voxrt_octree_insert(NULL, 0, 0, 0, 1, NULL) == VOXRT_ERR_INVALID_ARG);
    for (i = 0; i < 9000; i++) {
        x = test_rng_below(&r, 32); y = test_rng_below(&r, 32); z = test_rng_below(&r, 32);
        cells[x + 32 * y + 1024 * z] = (uint8_t)test_rng_below(&r, 5);
        CHECK(voxrt_octree_insert(t, x, y, z, cells[x + 32 * y + 1024 * z], up) == VOXRT_OK);
        if (i % 1000 == 999) CHECK((i & 1024 ? voxrt_octree_collapse(t) : voxrt_octree_build_lod(t)) == VOXRT_OK);
    }
    for (i = 0; i < 32768; i++) {
        voxrt_octree_voxel v = voxrt_octree_get(t, 5, i & 31u, i >> 5 & 31u, i >> 10, &level);
        CHECK(v.index == cells[i]);
        if (v.index != 0) CHECK(v.theta == 128 && v.phi == 64);
    }
    voxrt_octree_destroy(t);
    /* a filled leaf that is split hands its payload on */
    t = make_octree(3, &a);
    for (i = 0; i < 512; i++) CHECK(voxrt_octree_insert(t, i & 7u, i >> 3 & 7u, i >> 6, 3, up) == VOXRT_OK);
    CHECK(voxrt_octree_collapse(t) == VOXRT_OK && t->block_count == 1 && t->voxel[0].index == 3);
    CHECK(voxrt_octree_insert(t, 7, 0, 2, 0, NULL) == VOXRT_OK);
    for (i = 0; i < 512; i++)
        CHECK(voxrt_octree_get(t, 3, i & 7u, i >> 3 & 7u, i >> 6, NULL).index == (i == 7 + 128 ? 0 : 3));
    CHECK(t->block_count == 4);
    voxrt_octree_destroy(t);
    test_alloc_check(&ta);
    free(cells);
}

TEST(order_does_not_matter) {
    test_rng r = test_rng_make(6);
    uint32_t cell[3000], i, k;
    voxrt_octree *t[2];
    for (i = 0; i < 3000; i++) cell[i] = test_rng_below(&r, 1u << 15) & (i & 1 ? 0x1ce7u : 0x7fffu);
    for (k = 0; k < 2; k++) {
        t[k] = make_octree(5, NULL);
        for (i = 0; i < 3000; i++) {
            uint32_t c = cell[k ? 2999 - i : i];
            CHECK(voxrt_octree_insert(t[k], c & 31u, c >> 5 & 31u, c >> 10, 1 + (c >> 7) % 4, NULL) == VOXRT_OK);
        }
        CHECK(voxrt_octree_build_lod(t[k]) == VOXRT_OK);
    }
    CHECK(!same_octree(t[0], t[1]));
    for (k = 0; k < 2; k++) CHECK(voxrt_octree_collapse(t[k]) == VOXRT_OK);
    CHECK(same_octree(t[0], t[1]));
    for (k = 0; k < 2; k++) voxrt_octree_destroy(t[k]);
}

/* The rule of the specification in its own words, on one level; returns the volume of the filled leaves. */
static uint64_t lod_oracle(const voxrt_octree *t, uint32_t level, uint32_t x, uint32_t y, uint32_t z, uint32_t *index,
                           double normal[3]) {
    uint32_t got, i, c;
    voxrt_octree_voxel v = voxrt_octree_get(t, level, x, y, z, &got);
    uint32_t child[8], votes[5], best = 0;
    uint64_t volume[5], total = 0;
    double n[8][3], sum[3] = {0, 0, 0}, l;
    CHECK(got == level);
    normal[0] = sin(v.theta * 3.14159265358979 / 256) * cos(v.phi * 3.14159265358979 / 128);
    normal[1] = sin(v.theta * 3.14159265358979 / 256) * sin(v.phi * 3.14159265358979 / 128);
    normal[2] = cos(v.theta * 3.14159265358979 / 256);
    if (v.children == 0) {
        *index = v.index;
        return v.index != 0 ? (uint64_t)1 << 3 * (t->depth - level) : 0;
    }
    memset(votes, 0, sizeof votes);
    memset(volume, 0, sizeof volume);
    for (i = 0; i < 8; i++) {
        uint64_t w = lod_oracle(t, level + 1, 2 * x + (i & 1u), 2 * y + (i >> 1 & 1u), 2 * z + (i >> 2), &child[i],
            n[i]);
        CHECK((w != 0) == (child[i] != 0));
        if (child[i] != 0) { votes[child[i]]++; volume[child[i]] += w; total += w; }
    }
    for (c = 1; c < 5; c++)
        if (votes[c] > votes[best] || (votes[c] == votes[best] && volume[c] > volume[best])) best = c;
    CHECK_MSG(v.index == best, "index %u, should be %u", v.index, best);
    *index = best;
    if (best == 0) return 0;
    for (i = 0; i < 8; i++)
        if (child[i] != 0) { sum[0] += n[i][0]; sum[1] += n[i][1]; sum[2] += n[i][2]; }
    l = sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
    if (l > 0.01) CHECK((sum[0] * normal[0] + sum[1] * normal[1] + sum[2] * normal[2]) / l > cos(0.0138));
        /* 0.79 degrees */
    return total;
}

TEST(lod_majority) {
    static const float left[3] = {-1, 0, 0}, right[3] = {1, 0, 0};
    voxrt_octree *t = make_octree(1, NULL);
    test_rng r = test_rng_make(7);
    int k, i;
    /* 3 votes against 2 */
    for (i = 0; i < 5; i++) CHECK(voxrt_octree_insert(t, i & 1, i >> 1 & 1, (uint32_t)i >> 2, i < 3 ? 4 : 2,
        NULL) == VOXRT_OK);
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK && t->voxel[0].index == 4);
    /* a tie: the lower index; opposite normals: that of the winner */
    voxrt_octree_destroy(t);
    t = make_octree(1, NULL);
    CHECK(voxrt_octree_insert(t, 0, 0, 0, 3, left) == VOXRT_OK && voxrt_octree_insert(t, 1, 1, 1, 2,
        right) == VOXRT_OK);
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK && t->voxel[0].index == 2);
    CHECK(t->voxel[0].theta == 128 && t->voxel[0].phi == 0);
    CHECK(voxrt_octree_insert(t, 0, 0, 0, 0, NULL) == VOXRT_OK && voxrt_octree_insert(t, 1, 1, 1, 0, NULL) == VOXRT_OK);
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK && t->voxel[0].index == 0);
    voxrt_octree_destroy(t);
    /* a tie of votes: the one with more leaves */
    t = make_octree(2, NULL);
    CHECK(voxrt_octree_insert(t, 0, 0, 0, 1, NULL) == VOXRT_OK);
    CHECK(voxrt_octree_insert(t, 3, 3, 3, 4, NULL) == VOXRT_OK && voxrt_octree_insert(t, 3, 3, 2, 4, NULL) == VOXRT_OK);
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK && t->voxel[0].index == 4);
    voxrt_octree_destroy(t);
    for (k = 0; k < 20; k++) {
        uint32_t index;
        double n[3];
        t = make_octree(4, NULL);
        for (i = 0; i < 200 * (k + 1); i++) {
            float v[3];
            uint32_t a;
            for (a = 0; a < 3; a++) v[a] = test_rng_range(&r, -1, 1);
            CHECK(voxrt_octree_insert(t, test_rng_below(&r, 16), test_rng_below(&r, 16), test_rng_below(&r, 16),
                                      test_rng_below(&r, 5), v) == VOXRT_OK);
        }
        if (k & 1) CHECK(voxrt_octree_collapse(t) == VOXRT_OK); /* large leaves count for their volume */
        CHECK(voxrt_octree_build_lod(t) == VOXRT_OK);
        (void)lod_oracle(t, 0, 0, 0, 0, &index, n);
        voxrt_octree_destroy(t);
    }
}

TEST(normal_codec) {
    uint32_t c, k;
    test_rng r = test_rng_make(8);
    double sum = 0, worst = 0;
    int n = test_quick() ? 20000 : 200000, i;
    const voxrti_voxel *four[4];
    voxrti_voxel v[4];
    float out[12];
    for (c = 0; c < 65536; c += 4) {
        for (k = 0; k < 4; k++) {
            float f[3], eight[3] = {0, 0, 0};
            double t = ((c + k) & 255u) / 256.0 * 3.14159265358979323846,
                p = (int8_t)((c + k) >> 8) / 128.0 * 3.14159265358979323846;
            voxrti_voxel_set(&v[k], 1, c + k);
            CHECK(v[k].theta == ((c + k) & 255u) && (uint8_t)v[k].phi == (c + k) >> 8);
            four[k] = &v[k];
            voxrti_sph_decode(v[k].theta, v[k].phi, f);
            CHECK_NEAR(f[0], sin(t) * cos(p), 3e-7);
            CHECK_NEAR(f[1], sin(t) * sin(p), 3e-7);
            CHECK_NEAR(f[2], cos(t), 3e-7);
            for (i = 0; i < 8; i++) { eight[0] += f[0]; eight[1] += f[1]; eight[2] += f[2]; }
            CHECK(voxrti_sph_encode(eight) == (v[k].theta == 0 ? 0 : c + k)); /* the same again;
                one code for the pole */
        }
#if VOXRTI_X64
        if (voxrti_cpu_level() >= 2) {
            voxrti_sph_decode4(four, out);
            for (k = 0; k < 4; k++) {
                float f[3];
                voxrti_sph_decode(v[k].theta, v[k].phi, f);
                CHECK(memcmp(f, out + 3 * k, sizeof f) == 0);
            }
        }
#endif
    }
    (void)four;
    (void)out;
    for (i = 0; i < 8; i++) { /* close to the pole: its one code */
        float f[3];
        f[0] = i & 1 ? -0.002f : 0.003f;
        f[1] = i & 2 ? -0.004f : 0.001f;
        f[2] = i & 4 ? 1.0f : 100.0f;
        CHECK(voxrti_sph_encode(f) == 0);
    }
    for (i = 0; i < n; i++) { /* even on the sphere */
        double z = 2 * test_rng_double(&r) - 1, p = 6.283185307179586 * test_rng_double(&r), s = sqrt(1 - z * z), e;
        float f[3], g[3];
        uint32_t code;
        f[0] = (float)(s * cos(p)); f[1] = (float)(s * sin(p)); f[2] = (float)z;
        code = voxrti_sph_encode(f);
        voxrti_sph_decode(code & 255u, (int8_t)(code >> 8), g);
        e = asin(0.5 * sqrt(pow((double)(f[0] - g[0]), 2) + pow((double)(f[1] - g[1]), 2) +
                                 pow((double)(f[2] - g[2]), 2))) * 2 * 57.29577951308232;
        sum += e;
        if (e > worst) worst = e;
    }
    CHECK_NEAR(sum / n, 0.354, 0.004);
    CHECK_MSG(worst < 0.79 && worst > 0.7, "worst %g degrees", worst);
}

/* ---- conversion ------------------------------------------------------------------------------------------- */

typedef struct octree_compare { const voxrt_octree *t; uint64_t count; uint32_t level; int colors, normals; } octree_compare;

static int compare_cell(void *user, const voxrt_voxel *voxel, uint32_t palette_index) {
    octree_compare *c = (octree_compare *)user;
    uint32_t level;
    voxrt_octree_voxel v = voxrt_octree_get(c->t, c->level, voxel->x, voxel->y, voxel->z, &level);
    CHECK(v.index != 0);
    if (c->colors) CHECK_MSG(v.index == palette_index + 1, "level %u: index %u, not %u", c->level, v.index,
        palette_index + 1);
    if (c->normals) {
        float n[3];
        voxrti_sph_decode(v.theta, v.phi, n);
        CHECK(n[0] * voxel->normal[0] + n[1] * voxel->normal[1] + n[2] * voxel->normal[2] > cosf(0.0138f));
    }
    c->count++;
    return 0;
}

static void compare_trees(const voxrt_tree *s, const voxrt_octree *t, int lod_colors, int normals) {
    octree_compare c;
    uint32_t l;
    voxrt_tree_info info;
    voxrt_tree_get_info(s, &info);
    CHECK(info.depth == t->depth);
    CHECK(info.voxel_size == t->voxel_size && memcmp(info.world_origin, t->origin, sizeof t->origin) == 0);
    for (l = 0; l <= info.depth; l++) {
        memset(&c, 0, sizeof c);
        c.t = t;
        c.level = l;
        c.colors = lod_colors || l == info.depth;
        c.normals = normals || l == info.depth;
        (void)voxrt_tree_each(s, l, compare_cell, &c);
        CHECK_EQ_U64(c.count, info.level_count[l]);
    }
}

static uint8_t *octree_file(const voxrt_octree *t, size_t *size) {
    uint8_t *p;
    if (voxrt_octree_save_memory(t, NULL, NULL, 0, size) != VOXRT_OK) return NULL;
    p = (uint8_t *)malloc(*size);
    if (p != NULL && voxrt_octree_save_memory(t, NULL, p, *size, size) == VOXRT_OK) return p;
    free(p);
    return NULL;
}

/* A tree through a version 5 file. how: 0 compact, 1 raw, 2 raw and mapped (the file has to stay) */
static voxrt_tree *through_file(const voxrt_tree *s, int how, void **file) {
    voxrt_save_desc d;
    voxrt_tree *t = NULL;
    size_t size;
    memset(&d, 0, sizeof d);
    d.encoding = how == 0 ? VOXRT_ENCODING_COMPACT : VOXRT_ENCODING_RAW;
    *file = NULL;
    if (voxrt_tree_save_memory(s, &d, NULL, 0, &size) != VOXRT_OK || posix_memalign(file, 64, size) != 0) return NULL;
    if (voxrt_tree_save_memory(s, &d, *file, size, &size) != VOXRT_OK) return NULL;
    if (how < 2) (void)voxrt_tree_load_memory(NULL, *file, size, &t);
    else if (voxrti_little_endian()) (void)voxrt_tree_map_memory(NULL, *file, size, &t);
    else (void)voxrt_tree_load_memory(NULL, *file, size, &t);
    return t;
}

/* Levels of detail that were never made: a tree makes them by majority, as the octree would. */
static void levels_by_majority(test_rng *r) {
    voxrt_octree *t = make_octree(5, NULL), *back = NULL;
    voxrt_tree *s = NULL;
    voxrt_octree_desc d;
    float nv[3] = {0, 0, 1};
    uint32_t k;
    memset(&d, 0, sizeof d);
    for (k = 0; k < 700; k++) {
        nv[k % 3] = test_rng_range(r, -1, 1);
        CHECK(voxrt_octree_insert(t, test_rng_below(r, 32), test_rng_below(r, 32), test_rng_below(r, 32),
                                  1 + test_rng_below(r, t->palette_count), nv) == VOXRT_OK);
    }
    REQUIRE(voxrt_tree_from_octree(NULL, t, &s) == VOXRT_OK);
    REQUIRE(voxrt_octree_from_tree(&d, s, &back) == VOXRT_OK);
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK && voxrt_octree_collapse(t) == VOXRT_OK);
    CHECK(same_octree(t, back));
    voxrt_tree_destroy(s);
    voxrt_octree_destroy(t);
    voxrt_octree_destroy(back);
}

/* Octree -> tree -> file of version 5 -> tree -> octree -> file of version 4 loses nothing: cells, indices, normals and
   levels of detail, all 65536 codes of normals among them. */
TEST(lossless_there_and_back) {
    test_rng r = test_rng_make(31);
    uint32_t depth, k, l;
    int how;
    for (depth = 0; depth <= 8; depth++) {
        voxrt_octree *t = make_octree(depth, NULL), *back = NULL;
        voxrt_tree *s = NULL, *loaded, *again = NULL;
        voxrt_tree_info info;
        size_t size = 0, size2 = 0;
        uint8_t *file, *file2;
        uint32_t n = depth == 8 ? 80000u : 4u << 2 * depth;
        for (k = 0; k < n; k++) {
            uint32_t x = test_rng_below(&r, 1u << depth), y = test_rng_below(&r, 1u << depth), a;
            uint32_t z = test_rng_below(&r, 1u << depth), vi = 0;
            uint32_t index = 1 + test_rng_below(&r, t->palette_count);
            CHECK(voxrt_octree_insert(t, x, y, z, index, NULL) == VOXRT_OK);
            for (a = depth; a-- > 0;) vi = 8 * t->voxel[vi].children + voxrti_child(x, y, z, a);
            voxrti_voxel_set(&t->voxel[vi], index, depth == 8 ? k & 65535u : k * 257u & 65535u);
        }
        if (depth > 2) { /* an octant of equal voxels, to be collapsed */
            uint32_t half = depth < 5 ? 2u : 4u;
            for (k = 0; k < half * half * half; k++)
                CHECK(voxrt_octree_insert(t, k % half, k / half % half, k / half / half, 1, NULL) == VOXRT_OK);
        }
        CHECK(voxrt_octree_build_lod(t) == VOXRT_OK && voxrt_octree_collapse(t) == VOXRT_OK);
        for (l = 0; l < 8 * t->block_count; l++) { /* levels of detail that no rule would give */
            voxrti_voxel *v = &t->voxel[l];
            if (v->children != 0) voxrti_voxel_set(v, 1 + l % t->palette_count, l * 977u & 65535u);
        }
        REQUIRE(voxrt_tree_from_octree(NULL, t, &s) == VOXRT_OK);
        file = octree_file(t, &size);
        for (how = 0; how < 3; how++) {
            void *v5;
            voxrt_octree_desc d;
            memset(&d, 0, sizeof d);
            loaded = through_file(s, how, &v5);
            REQUIRE(loaded != NULL);
            CHECK_EQ_U64(voxrt_tree_hash(loaded), voxrt_tree_hash(s));
            REQUIRE(voxrt_octree_from_tree(&d, loaded, &back) == VOXRT_OK);
            if (depth > 0) {
                CHECK(same_octree(t, back));
                file2 = octree_file(back, &size2);
                CHECK(file != NULL && file2 != NULL && size == size2 && memcmp(file, file2, size) == 0);
                free(file2);
            } else { /* a tree has a level below its root: the same cube in eight equal voxels, collapsed again */
                CHECK(back->block_count == 1 && memcmp(back->voxel, t->voxel, 8) == 0);
            }
            voxrt_octree_destroy(back);
            voxrt_tree_destroy(loaded);
            free(v5);
        }
        free(file);
        /* tree -> octree -> tree, the octree not collapsed */
        {
            voxrt_octree_desc d;
            memset(&d, 0, sizeof d);
            d.disable_collapse = 1;
            REQUIRE(voxrt_octree_from_tree(&d, s, &back) == VOXRT_OK);
            REQUIRE(voxrt_tree_from_octree(NULL, back, &again) == VOXRT_OK);
            CHECK_EQ_U64(voxrt_tree_hash(again), voxrt_tree_hash(s));
            voxrt_octree_destroy(back);
            voxrt_tree_destroy(again);
        }
        voxrt_tree_get_info(s, &info);
        for (l = 0; l <= info.depth; l++) { /* normals are decoded by the thesis' formula */
            voxrt_voxel v;
            uint32_t at;
            voxrt_octree_voxel o;
            uint32_t c = test_rng_below(&r, 1u << l);
            if (depth == 0 || !voxrt_tree_get(s, l, c, c, c, &v)) continue;
            o = voxrt_octree_get(t, l, c, c, c, &at);
            {
                float nv[3];
                voxrti_sph_decode(o.theta, o.phi, nv);
                CHECK(memcmp(nv, v.normal, sizeof nv) == 0);
            }
        }
        voxrt_tree_destroy(s);
        voxrt_octree_destroy(t);
    }
    levels_by_majority(&r);
}

TEST(conversions) {
    test_rng r = test_rng_make(9);
    uint32_t depth;
    for (depth = 1; depth <= 7; depth++) {
        uint32_t n = depth < 3 ? 5 : 3000, i, a, big = depth > 3 ? 8u : 1u;
        voxrt_voxel *v = (voxrt_voxel *)calloc(n * 2 + 512, sizeof *v);
        voxrt_tree *s = NULL, *s2 = NULL;
        voxrt_octree *t = NULL, *t2 = NULL;
        voxrt_build_desc b;
        voxrt_octree_desc d;
        voxrt_octree_info info, info2;
        uint32_t c1 = 0, c2 = 0;
        memset(&b, 0, sizeof b);
        memset(&d, 0, sizeof d);
        b.lod_method = VOXRT_LOD_MAJORITY;
        b.box_size = 10;
        b.box_min[2] = 3;
        for (i = 0; i < n; i++) {
            v[i].x = test_rng_below(&r, 1u << depth);
            v[i].y = test_rng_below(&r, 1u << depth);
            v[i].z = test_rng_below(&r, 1u << depth);
            v[i].has_normal = 1;
            for (a = 0; a < 3; a++) {
                v[i].rgb[a] = (uint8_t)(test_rng_below(&r, 3) * 100);
                v[i].normal[a] = test_rng_range(&r, -1, 1);
            }
        }
        for (; i < n + big * big * big; i++) { /* something that collapses */
            v[i].x = i % big; v[i].y = i / big % big; v[i].z = (i / big / big) % big;
            v[i].has_normal = 1;
            v[i].normal[0] = 1;
            v[i].rgb[1] = 77;
        }
        REQUIRE(voxrt_tree_from_voxels(&b, v, i, depth, &s) == VOXRT_OK);
        REQUIRE(voxrt_octree_from_tree(&d, s, &t) == VOXRT_OK);
        compare_trees(s, t, 1, 1);
        voxrt_octree_get_info(t, &info);
        CHECK(info.leaf_count == 7 * info.node_count + 1);
        CHECK(info.palette_count == s->palette_count && memcmp(t->palette, s->palette, 3 * s->palette_count) == 0);
        d.disable_collapse = 1;
        REQUIRE(voxrt_octree_from_tree(&d, s, &t2) == VOXRT_OK);
        compare_trees(s, t2, 1, 1);
        voxrt_octree_get_info(t2, &info2);
        CHECK(info2.voxel_count >= info.voxel_count && (depth < 4 || info2.voxel_count > info.voxel_count));
        CHECK(voxrt_octree_build_lod(t2) == VOXRT_OK); /* the tree's majority is the same rule */
        compare_trees(s, t2, 1, 0);
        CHECK(voxrt_octree_collapse(t2) == VOXRT_OK);
        voxrt_octree_get_info(t2, &info2);
        CHECK(info2.voxel_count == info.voxel_count);
        voxrt_octree_destroy(t2);
        /* and back */
        REQUIRE(voxrt_tree_from_octree(NULL, t, &s2) == VOXRT_OK);
        compare_trees(s2, t, 1, 0);
        CHECK(memcmp(voxrt_tree_palette(s2, &c1), voxrt_tree_palette(s, &c2), 3 * s->palette_count) == 0 && c1 == c2);
        memset(&d, 0, sizeof d);
        REQUIRE(voxrt_octree_from_tree(&d, s2, &t2) == VOXRT_OK);
        CHECK(same_octree(t, t2)); /* nothing is lost any more */
        voxrt_octree_destroy(t);
        voxrt_octree_destroy(t2);
        voxrt_tree_destroy(s);
        voxrt_tree_destroy(s2);
        free(v);
    }
    {
        voxrt_octree *t = make_octree(3, NULL);
        voxrt_tree *s = (voxrt_tree *)1;
        CHECK(voxrt_tree_from_octree(NULL, t, &s) == VOXRT_ERR_EMPTY && s == NULL);
        voxrt_octree_destroy(t);
        t = make_octree(20, NULL); /* one leaf, 2^60 voxels */
        CHECK(voxrt_octree_insert(t, 1, 1, 1, 1, NULL) == VOXRT_OK);
        t->voxel[0].children = 0;
        t->voxel[0].index = 1;
        CHECK(voxrt_tree_from_octree(NULL, t, &s) == VOXRT_ERR_RANGE && s == NULL);
        voxrt_octree_destroy(t);
        t = make_octree(0, NULL);
        CHECK(voxrt_octree_insert(t, 0, 0, 0, 1, NULL) == VOXRT_OK);
        REQUIRE(voxrt_tree_from_octree(NULL, t, &s) == VOXRT_OK);
        CHECK(s->depth == 1 && s->voxel_count == 8 && s->voxel_size == 0.5);
        voxrt_tree_destroy(s);
        voxrt_octree_destroy(t);
    }
}

TEST(no_memory) {
    test_alloc ta;
    voxrt_octree *src = make_shell(4, 0.4, 20, 10);
    voxrt_tree *tree = NULL;
    int kind, k;
    REQUIRE(voxrt_tree_from_octree(NULL, src, &tree) == VOXRT_OK);
    for (kind = 0; kind < 8; kind++) {
        for (k = 0;; k++) {
            voxrt_octree_desc d;
            voxrt_octree *t = NULL;
            voxrt_tree *s = NULL;
            voxrt_result r = VOXRT_OK;
            test_alloc_init(&ta);
            memset(&d, 0, sizeof d);
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.env.thread_count = 1;
            if (kind < 3 || kind == 7) ta.fail_at = k;
            if (kind == 0) r = voxrt_octree_from_tree(&d, tree, &t);
            if (kind == 1) r = voxrt_tree_from_octree(&d, src, &s);
            if (kind == 2) r = voxrt_octree_load_memory(&d, golden, sizeof golden, &t);
            if (kind == 7) r = voxrt_octree_create(&d, 4, palette4, 4, &t);
            else if (kind >= 3) {
                REQUIRE(voxrt_octree_create(&d, 4, palette4, 4, &t) == VOXRT_OK);
                if (kind > 3) {
                    int i;
                    for (i = 0; i < 300; i++) CHECK(voxrt_octree_insert(t, i & 15, i >> 4 & 15,
                        (uint32_t)(i * 7) & 15u, 1, NULL) == VOXRT_OK);
                }
                ta.fail_at = ta.count + k;
                if (kind == 3) {
                    uint32_t i;
                    for (i = 0; i < 300 && r == VOXRT_OK; i++) r = voxrt_octree_insert(t, i & 15, i >> 4 & 15,
                        i * 7 & 15, 1, NULL);
                }
                if (kind == 4) r = voxrt_octree_build_lod(t);
                if (kind == 5) r = voxrt_octree_collapse(t);
                if (kind == 6) r = voxrt_octree_build_grid(t, 4);
            }
            CHECK(r == VOXRT_OK || r == VOXRT_ERR_NO_MEMORY);
            if (kind < 3 || kind == 7) CHECK((r == VOXRT_OK) == (t != NULL || s != NULL));
            CHECK((r == VOXRT_OK) == (ta.failed == 0));
            voxrt_octree_destroy(t);
            voxrt_tree_destroy(s);
            test_alloc_check(&ta);
            if (ta.failed == 0 || k > 500) break;
        }
        CHECK_MSG(k < 500 && k >= 1, "%d: %d requests", kind, k);
    }
    voxrt_tree_destroy(tree);
    voxrt_octree_destroy(src);
}

/* The last number of a voxel stands for none, so there is a block less than numbers for blocks, whatever room there is. */
TEST(blocks_have_numbers) {
    voxrt_octree t;
    memset(&t, 0, sizeof t);
    t.block_count = VOXRTI_MAX_BLOCKS;
    t.block_capacity = (size_t)VOXRTI_MAX_BLOCKS + 1;
    CHECK_EQ_U64(voxrti_octree_block(&t), 0);
}

TEST(bad_arguments) {
    voxrt_octree *t = make_octree(2, NULL), *u = t;
    voxrt_octree_desc d;
    voxrt_octree_trace_desc td;
    voxrt_tree *s = NULL;
    voxrt_hit h;
    size_t n;
    memset(&d, 0, sizeof d);
    memset(&td, 0, sizeof td);
    CHECK(voxrt_octree_create(&d, 21, palette4, 4, &u) == VOXRT_ERR_RANGE && u == NULL);
    CHECK(voxrt_octree_create(&d, 2, palette4, 32768, &u) == VOXRT_ERR_RANGE);
    CHECK(voxrt_octree_create(&d, 2, NULL, 1, &u) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_octree_create(&d, 2, NULL, 1, NULL) == VOXRT_ERR_INVALID_ARG);
    d.grid_level = 11;
    CHECK(voxrt_octree_load_memory(&d, golden, 50, &u) == VOXRT_ERR_RANGE);
    d.grid_level = 0;
    d._end_zero = 1;
    CHECK(voxrt_octree_load_memory(&d, golden, 50, &u) == VOXRT_ERR_UNINIT_DESC);
    CHECK(voxrt_octree_from_tree(NULL, NULL, &u) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_tree_from_octree(NULL, NULL, &s) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_octree_save_memory(NULL, NULL, NULL, 0, &n) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_octree_build_grid(t, 4) == VOXRT_ERR_RANGE);
    CHECK(voxrt_octree_trace(NULL, NULL, NULL, NULL, 0) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_octree_trace(t, NULL, NULL, &h, 1) == VOXRT_ERR_INVALID_ARG);
    td.offset = 1;
    CHECK(voxrt_octree_trace(t, &td, NULL, NULL, 0) == VOXRT_ERR_INVALID_ARG);
    td.offset = 0;
    td._begin_zero = 1;
    CHECK(voxrt_octree_trace(t, &td, NULL, NULL, 0) == VOXRT_ERR_UNINIT_DESC);
    CHECK(voxrt_octree_trace(t, NULL, NULL, NULL, 0) == VOXRT_OK);
    voxrt_octree_destroy(NULL);
    voxrt_octree_destroy(t);
}

/* ---- rays ------------------------------------------------------------------------------------------------- */

/* Does the ray cross the cube [c, c + edge] grown by g? Interval of t in double. World: voxel size 1, origin 0. */
static int slab(const voxrt_ray *r, const double lo[3], double edge, double g, double *in, double *out) {
    int a;
    *in = (double)r->t_min;
    *out = (double)r->t_max;
    for (a = 0; a < 3; a++) {
        double o = (double)r->org[a], l = lo[a] - g - o, h = lo[a] + edge + g - o, d = (double)r->dir[a];
        if (d == 0) {
            if (l > 0 || h < 0) return 0;
        } else {
            double t0 = l / d, t1 = h / d;
            if (t0 > t1) { double x = t0; t0 = t1; t1 = x; }
            if (t0 > *in) *in = t0;
            if (t1 < *out) *out = t1;
        }
    }
    return *in <= *out;
}

/* Every voxel against the ray: first entry into the voxels shrunk by g (what a result must not miss). */
typedef struct filled_list { double (*lo)[3]; double *edge; uint32_t *voxel; size_t n; } filled_list;

static filled_list list_filled(const voxrt_octree *t, uint32_t max_level) {
    filled_list f;
    voxrti_walk w;
    memset(&f, 0, sizeof f);
    f.lo = (double (*)[3])malloc(t->block_count * 8 * sizeof *f.lo);
    f.edge = (double *)malloc(t->block_count * 8 * sizeof *f.edge);
    f.voxel = (uint32_t *)malloc(t->block_count * 8 * sizeof *f.voxel);
    voxrti_walk_start(&w, t);
    while (voxrti_walk_next(&w)) {
        const voxrti_voxel *v = &t->voxel[w.voxel];
        if (v->index == 0 || w.level > max_level || (v->children != 0 && w.level < max_level)) continue;
        f.edge[f.n] = (double)(1u << (t->depth - w.level));
        f.lo[f.n][0] = voxrti_compact3(w.code) * f.edge[f.n];
        f.lo[f.n][1] = voxrti_compact3(w.code >> 1) * f.edge[f.n];
        f.lo[f.n][2] = voxrti_compact3(w.code >> 2) * f.edge[f.n];
        f.voxel[f.n++] = w.voxel;
    }
    return f;
}

static void list_free(filled_list *f) { free(f->lo); free(f->edge); free(f->voxel); }

/* Is the hit one that a ray within g cells of this one could have? 1: exactly the nearest. 2: admissible. 0: wrong. */
static int octree_judge(const voxrt_octree *tree, const filled_list *f, const voxrt_ray *ray, const voxrt_hit *h, double g) {
    double must = HUGE_VAL, nearest = HUGE_VAL, in, out, len = 0, slack;
    const double t_min = (double)ray->t_min, t_max = (double)ray->t_max, t = (double)h->t;
    size_t i, best = 0;
    int a;
    for (a = 0; a < 3; a++) len += (double)ray->dir[a] * (double)ray->dir[a];
    len = sqrt(len);
    slack = g / len;
    for (i = 0; i < f->n; i++) {
        if (!slab(ray, f->lo[i], f->edge[i], 0, &in, &out)) continue;
        if (in < nearest) { nearest = in; best = i; }
        if (slab(ray, f->lo[i], f->edge[i], -g, &in, &out) && in < must && out < t_max - slack &&
            out > t_min + slack) must = in;
    }
    if (h->node == VOXRT_NO_NODE) { /* beyond the largest float is a miss too */
        if (!(nearest < t_max) || nearest > 3.4e38) return 1;
        return must > 3.4e38 ? 2 : 0;
    }
    for (i = 0; i < f->n && f->voxel[i] != h->node; i++) { }
    if (i == f->n) return 0;
    for (a = 0; a < 3; a++) if ((double)h->cell[a] * f->edge[i] != f->lo[i][a]) return 0;
    if ((1u << (tree->depth - h->level)) != (uint32_t)f->edge[i]) return 0;
    if (!(h->t >= ray->t_min) || !(h->t < ray->t_max)) return 0;
    if (!slab(ray, f->lo[i], f->edge[i], g, &in, &out)) return 0;
    if (t < in - slack || t > out + slack) return 0;
    if (must < t - 2 * slack) return 0;
    return i == best ? 1 : 2;
}

static voxrt_ray octree_random_ray(test_rng *r, double n, int kind) { /* kind 0: from outside; 1: inside; 2: adversarial */
    voxrt_ray ray;
    uint32_t a;
    memset(&ray, 0, sizeof ray);
    ray.t_max = INFINITY;
    for (a = 0; a < 3; a++) {
        float p = (float)(n * test_rng_double(r));
        ray.org[a] = kind == 0 ? (float)(n * (test_rng_double(r) * 4 - 1.5)) : p;
        ray.dir[a] = kind == 0 ? p - ray.org[a] : test_rng_range(r, -1, 1);
    }
    if (kind == 2) {
        static const float odd[8] = {0.0f, -0.0f, 1e-45f, 1e-30f, 1.0f, -1.0f, 0.5f, -1e-12f};
        uint32_t how = test_rng_below(r, 4);
        float scale = test_rng_below(r, 3) == 0 ? (test_rng_below(r, 2) ? 1e20f : 1e-20f) : 1.0f;
        for (a = 0; a < 3; a++) {
            if (how != 0) ray.org[a] = (float)(int)ray.org[a]; /* corners and faces */
            if (how == 2) ray.dir[a] = odd[test_rng_below(r, 8)];
            if (how == 3) ray.dir[a] = test_rng_below(r, 2) ? 1.0f : -1.0f;
            if (test_rng_below(r, 3) == 0) ray.org[a] -= 64 * ray.dir[a];
        }
        for (a = 0; a < 3; a++) ray.dir[a] *= scale;
        if (test_rng_below(r, 4) == 0) {
            ray.t_min = test_rng_range(r, -2, 5) / scale;
            ray.t_max = ray.t_min + test_rng_range(r, -1, 10) / scale;
        }
    }
    return ray;
}

static void set_path(voxrt_octree_trace_desc *d, int path) {
    memset(d, 0, sizeof *d);
    d->isa = path & 1 ? VOXRT_ISA_SSE : VOXRT_ISA_SCALAR;
    d->disable_grid = path < 2;
}

/* Every result must be one that a ray 0.002 cells beside the real one could have, and nearly all exactly right. */
TEST(rays_against_brute_force) {
    int kind, k, n = test_quick() ? 3000 : 6000, path, right[3] = {0, 0, 0}, all[3] = {0, 0, 0};
    uint32_t level;
    voxrt_octree *t = make_shell(5, 0.4, 60, 11);
    voxrt_ray *rays = (voxrt_ray *)malloc((size_t)n * sizeof *rays);
    voxrt_hit *hits[4];
    CHECK(voxrt_octree_insert(t, 0, 0, 0, 1, NULL) == VOXRT_OK && voxrt_octree_insert(t, 31, 31, 31, 2,
        NULL) == VOXRT_OK);
    for (k = 0; k < 4096; k++) /* a large leaf and a hollow */
        CHECK(voxrt_octree_insert(t, k & 15, k >> 4 & 15, 16 + (uint32_t)(k >> 8), k & 0x888 ? 3 : 0,
            NULL) == VOXRT_OK);
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK && voxrt_octree_collapse(t) == VOXRT_OK);
    CHECK(voxrt_octree_build_grid(t, 3) == VOXRT_OK);
    for (path = 0; path < 4; path++) hits[path] = (voxrt_hit *)malloc((size_t)n * sizeof(voxrt_hit));
    for (level = 2; level <= 6; level++) {
        filled_list f = list_filled(t, level);
        test_rng r = test_rng_make(level);
        int m = level == 6 ? n : n / 6;
        for (kind = 0; kind < 3; kind++) {
            for (k = 0; k < m; k++) rays[k] = octree_random_ray(&r, 32, kind);
            for (path = 0; path < 4; path++) {
                voxrt_octree_trace_desc d;
                set_path(&d, path);
                d.max_level_plus_1 = level + 1;
                CHECK(voxrt_octree_trace(t, &d, rays, hits[path], (size_t)m) == VOXRT_OK);
                CHECK(memcmp(hits[path], hits[0], (size_t)m * sizeof(voxrt_hit)) == 0);
            }
            for (k = 0; k < m; k++) {
                int j;
                const voxrt_ray *ray = &rays[k];
                if (!(ray->t_min <= ray->t_max) || (ray->dir[0] == 0 && ray->dir[1] == 0 && ray->dir[2] == 0)) {
                    CHECK(hits[0][k].node == VOXRT_NO_NODE && hits[0][k].t == INFINITY);
                    continue;
                }
                j = octree_judge(t, &f, ray, &hits[0][k], 0.002);
                all[kind]++;
                right[kind] += j == 1;
                CHECK_MSG(j != 0, "level %u kind %d ray %d: org %g %g %g dir %g %g %g t %g..%g: hit %u at %g", level,
                          kind, k, (double)ray->org[0], (double)ray->org[1], (double)ray->org[2], (double)ray->dir[0],
                          (double)ray->dir[1], (double)ray->dir[2], (double)ray->t_min, (double)ray->t_max,
                          hits[0][k].node, (double)hits[0][k].t);
            }
        }
        list_free(&f);
    }
    CHECK_MSG(right[0] > all[0] - all[0] / 1000 && right[1] > all[1] - all[1] / 1000,
        "%d of %d, %d of %d exactly right",
              right[0], all[0], right[1], all[1]);
    if (test_g.verbose) printf("    not exactly right: %d of %d, %d of %d, adversarial %d of %d\n", all[0] - right[0],
        all[0],
                               all[1] - right[1], all[1], all[2] - right[2], all[2]);
    for (path = 0; path < 4; path++) free(hits[path]);
    free(rays);
    voxrt_octree_destroy(t);
}

TEST(packets_and_bad_rays) {
    voxrt_octree *t = make_shell(5, 0.4, 50, 12);
    test_rng r = test_rng_make(13);
    int k;
    for (k = 0; k < 3000; k++) {
        voxrt_ray rays[9];
        voxrt_hit a[9], b[9], c;
        voxrt_octree_stats sa, sb, sc;
        voxrt_octree_trace_desc d;
        size_t n = test_rng_below(&r, 10), i;
        int path;
        for (i = 0; i < n; i++) {
            uint32_t axis = test_rng_below(&r, 3);
            rays[i] = octree_random_ray(&r, 32, (int)test_rng_below(&r, 3));
            if (test_rng_below(&r, 6) == 0) rays[i].org[axis] = test_rng_bits(&r);
            if (test_rng_below(&r, 6) == 0) rays[i].dir[axis] = test_rng_bits(&r);
            if (test_rng_below(&r, 8) == 0) rays[i].t_min = test_rng_bits(&r);
            if (test_rng_below(&r, 8) == 0) rays[i].t_max = test_rng_bits(&r);
            if (test_rng_below(&r, 20) == 0) memset(rays[i].dir, 0, sizeof rays[i].dir);
        }
        if (k == 1500) CHECK(voxrt_octree_build_grid(t, 4) == VOXRT_OK);
        for (path = 0; path < 2; path++) {
            set_path(&d, path + 2);
            memset(path ? &sb : &sa, 0, sizeof sa);
            d.stats = path ? &sb : &sa;
            d.offset = k % 3 == 2 ? 1e-6f : 0;
            CHECK(voxrt_octree_trace(t, &d, rays, path ? b : a, n) == VOXRT_OK);
        }
        CHECK(n == 0 || memcmp(a, b, n * sizeof *a) == 0);
        CHECK(memcmp(&sa, &sb, sizeof sa) == 0);
        d.stats = NULL; /* other code */
        CHECK(voxrt_octree_trace(t, &d, rays, b, n) == VOXRT_OK);
        CHECK(n == 0 || memcmp(a, b, n * sizeof *a) == 0);
        CHECK(sa.rays == n && (d.offset > 0 || sa.stuck == 0));
        memset(&sc, 0, sizeof sc);
        for (i = 0; i < n; i++) { /* alone in its packet */
            int bad = 0, moving = 0, x;
            d.stats = &sc;
            CHECK(voxrt_octree_trace(t, &d, &rays[i], &c, 1) == VOXRT_OK && memcmp(&c, &a[i], sizeof c) == 0);
            for (x = 0; x < 3; x++) {
                bad |= !isfinite(rays[i].org[x]) || !isfinite(rays[i].dir[x]);
                moving |= rays[i].dir[x] != 0;
            }
            if (bad || !moving || !(rays[i].t_min <= rays[i].t_max)) {
                CHECK(a[i].node == VOXRT_NO_NODE && a[i].t == INFINITY);
                CHECK(sa.bad_rays-- != 0);
            }
        }
        CHECK(sa.bad_rays == 0);
        CHECK(sa.outer == sc.outer && sa.inner == sc.inner && sa.hits == sc.hits && sa.stuck == sc.stuck);
    }
    voxrt_octree_destroy(t);
}

/* An offset far below the rounding error has to grow several times; still no ray is stuck and nearly all are right. */
TEST(growing_offset) {
    uint32_t depth = 6;
    voxrt_octree *t = make_shell(depth, 0.4, 100, 20);
    test_rng r = test_rng_make(21);
    size_t n = 3000, i, differ = 0;
    voxrt_ray *rays = (voxrt_ray *)malloc(n * sizeof *rays);
    voxrt_hit *a = (voxrt_hit *)malloc(n * sizeof *a), *b = (voxrt_hit *)malloc(n * sizeof *b);
    voxrt_octree_stats sa, sb, s;
    voxrt_octree_trace_desc d;
    voxrti_octrace c;
    memset(&c, 0, sizeof c);
    memset(&d, 0, sizeof d);
    memset(&s, 0, sizeof s);
    c.t = t;
    c.full = 64;
    c.max_outer = 6 * 64;
    c.scale = 1;
    c.offset = 64.0f / 1073741824.0f;
    for (i = 0; i < n; i++) rays[i] = octree_random_ray(&r, 64, (int)(i % 3));
    d.stats = &s;
    CHECK(voxrt_octree_trace(t, &d, rays, a, n) == VOXRT_OK);
    memset(&sa, 0, sizeof sa);
    for (i = 0; i < n; i++) voxrti_octrace_one(&c, &rays[i], &b[i], &sa);
    for (i = 0; i < n; i++) differ += memcmp(&a[i], &b[i], sizeof *a) != 0;
    CHECK(sa.stuck == 0 && sa.outer > 2 * s.outer && sa.rays == n);
    CHECK_MSG(differ < n / 10, "%lu differ", (unsigned long)differ); /* adversarial rays have ties */
#if VOXRTI_X64
    if (voxrti_cpu_level() >= 2) {
        memset(&sb, 0, sizeof sb);
        voxrti_octrace_packets(&c, rays, a, n, &sb);
        CHECK(memcmp(a, b, n * sizeof *a) == 0 && memcmp(&sa, &sb, sizeof sa) == 0);
    }
#else
    (void)sb;
#endif
    free(rays);
    free(a);
    free(b);
    voxrt_octree_destroy(t);
}

/* Counters and hits equal those of listing 5 to the letter, whatever the grid. */
TEST(grids_and_counters) {
    uint32_t depth = test_quick() ? 6 : 7, g;
    voxrt_octree *t = make_shell(depth, 0.42, 3000, 14);
    test_rng r = test_rng_make(15);
    size_t n = test_quick() ? 3000 : 12000, i;
    voxrt_ray *rays = (voxrt_ray *)malloc(n * sizeof *rays);
    voxrt_hit *a = (voxrt_hit *)malloc(n * sizeof *a), *b = (voxrt_hit *)malloc(n * sizeof *b);
    baseline_stats sa, sc;
    baseline_desc d;
    uint64_t inner = 0;
    CHECK(voxrt_octree_collapse(t) == VOXRT_OK);
    for (i = 0; i < n; i++) rays[i] = octree_random_ray(&r, (double)(1u << depth), i & 1);
    memset(&sa, 0, sizeof sa);
    memset(&d, 0, sizeof d);
    d.offset = (float)(1u << depth) * VOXRTI_OCTREE_OFFSET * 4; /* enough that none needs more */
    baseline_octree_trace(t, &d, rays, a, n, &sa);
    CHECK(sa.stuck == 0 && sa.hits > n / 2);
    for (g = 0; g <= depth + 1; g++) {
        int isa;
        CHECK(voxrt_octree_build_grid(t, g) == VOXRT_OK);
        for (isa = 1; isa <= 2; isa++) {
            voxrt_octree_trace_desc td;
            voxrt_octree_stats s;
            memset(&td, 0, sizeof td);
            memset(&s, 0, sizeof s);
            td.isa = (voxrt_isa)isa;
            td.offset = d.offset;
            td.stats = &s;
            CHECK(voxrt_octree_trace(t, &td, rays, b, n) == VOXRT_OK);
            CHECK(memcmp(a, b, n * sizeof *a) == 0);
            CHECK_EQ_U64(s.outer, sa.outer);
            CHECK_EQ_U64(s.hits, sa.hits);
            CHECK_EQ_U64(s.grid, g != 0 ? s.outer : 0);
            if (g == 0) CHECK_EQ_U64(s.inner, sa.inner);
            if (g > 1) CHECK(s.inner < inner || isa == 2);
            inner = s.inner;
        }
        if (g == 0) continue;
        memset(&sc, 0, sizeof sc);
        d.mode = BASELINE_GRID_LEAF;
        baseline_octree_trace(t, &d, rays, b, n, &sc);
        CHECK(memcmp(a, b, n * sizeof *a) == 0 && sc.outer == sa.outer && sc.inner == inner);
        memset(&sc, 0, sizeof sc);
        d.mode = BASELINE_GRID_CELL;
        baseline_octree_trace(t, &d, rays, b, n, &sc);
        CHECK(sc.outer >= sa.outer);
        if (g == depth) CHECK(sc.outer > 2 * sa.outer);
    }
    CHECK(inner == 0); /* a grid of leaves */
    for (g = BASELINE_NEIGHBOUR; g <= BASELINE_XOR; g++) {
        memset(&sc, 0, sizeof sc);
        d.mode = (baseline_mode)g;
        baseline_octree_trace(t, &d, rays, b, n, &sc);
        CHECK(memcmp(a, b, n * sizeof *a) == 0 && sc.outer == sa.outer);
        if (test_g.verbose) printf("    %s: %.2f down, %.2f up a ray; restart %.2f down\n",
            g == BASELINE_XOR ? "xor" : "neighbour",
                                   (double)sc.inner / (double)n, (double)sc.up / (double)n,
                                       (double)sa.inner / (double)n);
        CHECK(2 * sc.inner < sa.inner);
        if (g == BASELINE_NEIGHBOUR) CHECK(sc.up <= sc.inner && 2 * sc.up > sc.inner); /* as many up as down: no gain */
    }
    free(rays);
    free(a);
    free(b);
    voxrt_octree_destroy(t);
}

/* A forced level shows the same as a tree that ends there. */
TEST(forced_level) {
    uint32_t depth = 6, level, x, y, z;
    voxrt_octree *t = make_shell(depth, 0.4, 400, 16);
    test_rng r = test_rng_make(17);
    size_t n = 2000, i;
    voxrt_ray *rays = (voxrt_ray *)malloc(n * sizeof *rays);
    voxrt_hit *a = (voxrt_hit *)malloc(n * sizeof *a), *b = (voxrt_hit *)malloc(n * sizeof *b);
    for (i = 0; i < n; i++) {
        rays[i] = octree_random_ray(&r, 64, (int)(i % 3));
        rays[i].t_min = 0; /* limits so close together that they underflow depend on the unit */
        rays[i].t_max = INFINITY;
    }
    CHECK(voxrt_octree_collapse(t) == VOXRT_OK);
    for (level = 0; level <= depth; level++) {
        voxrt_octree_desc d;
        voxrt_octree *u = NULL;
        uint32_t cells = 1u << level, path;
        memset(&d, 0, sizeof d);
        d.box_size = 64;
        REQUIRE(voxrt_octree_create(&d, level, palette4, 4, &u) == VOXRT_OK);
        for (z = 0; z < cells; z++)
            for (y = 0; y < cells; y++)
                for (x = 0; x < cells; x++)
                    CHECK(voxrt_octree_insert(u, x, y, z, voxrt_octree_get(t, level, x, y, z, NULL).index,
                        NULL) == VOXRT_OK);
        CHECK(voxrt_octree_collapse(u) == VOXRT_OK);
        for (path = 0; path < 4; path++) {
            voxrt_octree_trace_desc td;
            size_t differ = 0;
            set_path(&td, (int)path);
            CHECK(voxrt_octree_build_grid(t, path < 2 ? 0 : 6) == VOXRT_OK);
            CHECK(voxrt_octree_trace(u, &td, rays, b, n) == VOXRT_OK);
            td.max_level_plus_1 = level + 1;
            CHECK(voxrt_octree_trace(t, &td, rays, a, n) == VOXRT_OK);
            for (i = 0; i < n; i++) {
                uint8_t ca[3], cb[3];
                if (a[i].node != VOXRT_NO_NODE && b[i].node != VOXRT_NO_NODE) {
                    voxrt_octree_hit_color(t, &a[i], ca);
                    voxrt_octree_hit_color(u, &b[i], cb);
                    differ += memcmp(&a[i].t, &b[i].t, 4) != 0 || memcmp(ca, cb, 3) != 0 || a[i].level > level;
                } else {
                    differ += a[i].node != b[i].node;
                }
            }
            CHECK_MSG(differ == 0, "level %u path %u: %lu differ", level, path, (unsigned long)differ);
        }
        voxrt_octree_destroy(u);
    }
    free(rays);
    free(a);
    free(b);
    voxrt_octree_destroy(t);
}

TEST(collapse_keeps_the_picture) {
    voxrt_octree *t = make_octree(6, NULL);
    test_rng r = test_rng_make(18);
    size_t n = 4000, i, differ = 0;
    voxrt_ray *rays = (voxrt_ray *)malloc(n * sizeof *rays);
    voxrt_hit *a = (voxrt_hit *)malloc(n * sizeof *a), *b = (voxrt_hit *)malloc(n * sizeof *b);
    float *normals = (float *)malloc(3 * n * sizeof(float));
    voxrt_octree_info before, after;
    uint32_t x, y, z;
    for (z = 0; z < 64; z++) for (y = 0; y < 64; y++) for (x = 0; x < 64; x++) {
        int ball = (int)((x - 31) * (x - 31) + (y - 31) * (y - 31) + (z - 31) * (z - 31));
        if (ball < 800) CHECK(voxrt_octree_insert(t, x, y, z, 1 + (x >> 4) % 4, NULL) == VOXRT_OK);
        else if ((x ^ y) > 60) CHECK(voxrt_octree_insert(t, x, y, z, 0, NULL) == VOXRT_OK);
            /* empty leaves for nothing */
    }
    CHECK(voxrt_octree_build_lod(t) == VOXRT_OK);
    for (i = 0; i < n; i++) rays[i] = octree_random_ray(&r, 64, 0);
    CHECK(voxrt_octree_trace(t, NULL, rays, a, n) == VOXRT_OK);
    voxrt_octree_get_info(t, &before);
    CHECK(voxrt_octree_collapse(t) == VOXRT_OK);
    voxrt_octree_get_info(t, &after);
    CHECK(after.voxel_count < before.voxel_count / 2 && after.leaf_count == 7 * after.node_count + 1);
    CHECK(voxrt_octree_trace(t, NULL, rays, b, n) == VOXRT_OK);
    for (i = 0; i < n; i++) differ += memcmp(&a[i].t, &b[i].t, 4) != 0 || a[i].face != b[i].face;
    CHECK_MSG(differ <= n / 1000, "%lu rays differ", (unsigned long)differ);
    voxrt_octree_hit_normals(t, b, normals, n);
    for (i = 0; i < n; i++) {
        float one[3] = {0, 0, 0};
        if (b[i].node != VOXRT_NO_NODE) voxrt_octree_hit_normal(t, &b[i], one);
        CHECK(memcmp(one, normals + 3 * i, sizeof one) == 0);
    }
    free(rays);
    free(a);
    free(b);
    free(normals);
    voxrt_octree_destroy(t);
}

TEST(lod_level) {
    voxrt_octree_desc d;
    voxrt_octree *t = NULL;
    static const float inside[3] = {5, 5, 5}, eye[3] = {5, 5, 1034};
    memset(&d, 0, sizeof d);
    d.box_size = 1024;
    REQUIRE(voxrt_octree_create(&d, 10, palette4, 4, &t) == VOXRT_OK);
    CHECK(voxrt_octree_lod_level(t, inside, 0.001f, 1) == 10);
    /* 10 away: a pixel is 10 s wide; level = ceil(log2(1024 / (10 s))) */
    CHECK(voxrt_octree_lod_level(t, eye, 0.05f, 1) == 10);
    CHECK(voxrt_octree_lod_level(t, eye, 0.3f, 1) == 9);
    CHECK(voxrt_octree_lod_level(t, eye, 0.8f, 1) == 7);
    CHECK(voxrt_octree_lod_level(t, eye, 0.8f, 2) == 6);
    CHECK(voxrt_octree_lod_level(t, eye, 200.0f, 1) == 0);
    voxrt_octree_destroy(t);
}

/* What a fixed offset does (thesis 3.5.1, 4.2.1): large ones miss corners, small ones get stuck. A small ball in a
   corner of a large grid, against the exact tracer. */
TEST(offset_sweep) {
    static const uint32_t depths[3] = {9, 12, 14};
    static const float offsets[7] = {1e-1f, 1e-2f, 1e-3f, 1e-4f, 1e-5f, 0, 0};
    uint32_t k, o;
    for (k = 0; k < 3; k++) {
        double full = (double)(1u << depths[k]), ball = 100, c[3];
        double wrong[7], stuck[7];
        voxrt_octree *t = make_octree(depths[k], NULL);
        voxrt_tree *s = NULL;
        test_rng r = test_rng_make(19);
        size_t n = test_quick() ? 5000 : 20000, i;
        voxrt_ray *rays = (voxrt_ray *)malloc(n * sizeof *rays);
        voxrt_hit *a = (voxrt_hit *)malloc(n * sizeof *a), *b = (voxrt_hit *)malloc(n * sizeof *b);
        int x, y, z;
        c[0] = full - 104.3; c[1] = full - 107.1; c[2] = full * 0.5 + 2.3;
        for (z = -102; z <= 102; z++) for (y = -102; y <= 102; y++) for (x = -102; x <= 102; x++) {
            double dx = floor(c[0]) + x + 0.5 - c[0], dy = floor(c[1]) + y + 0.5 - c[1],
                dz = floor(c[2]) + z + 0.5 - c[2];
            if (fabs(sqrt(dx * dx + dy * dy + dz * dz) - ball) > 0.5) continue;
            CHECK(voxrt_octree_insert(t, (uint32_t)(c[0] + x), (uint32_t)(c[1] + y), (uint32_t)(c[2] + z), 1,
                NULL) == VOXRT_OK);
        }
        REQUIRE(voxrt_tree_from_octree(NULL, t, &s) == VOXRT_OK);
        for (i = 0; i < n; i++) {
            uint32_t j;
            memset(&rays[i], 0, sizeof rays[i]);
            rays[i].t_max = INFINITY;
            for (j = 0; j < 3; j++) {
                double e = full * (test_rng_double(&r) * 2 - 0.5);
                if (j == i % 3) e = test_rng_below(&r, 2) ? -0.3 * full : 1.3 * full; /* from outside */
                rays[i].org[j] = (float)e;
                rays[i].dir[j] = (float)((c[j] + (test_rng_double(&r) - 0.5) * 1.4 * ball - e) / full);
            }
        }
        CHECK(voxrt_trace(s, NULL, rays, a, n) == VOXRT_OK);
        for (o = 0; o < 7; o++) {
            voxrt_octree_trace_desc d;
            voxrt_octree_stats st;
            baseline_desc bd;
            baseline_stats bs;
            memset(&d, 0, sizeof d);
            memset(&st, 0, sizeof st);
            memset(&bd, 0, sizeof bd);
            memset(&bs, 0, sizeof bs);
            d.offset = offsets[o];
            d.stats = &st;
            bd.offset = 1e-3f; /* a plain reading: offset along the ray, the ray's own origin */
            bd.along_ray = bd.far_origin = 1;
            if (o < 6) CHECK(voxrt_octree_trace(t, &d, rays, b, n) == VOXRT_OK);
            else baseline_octree_trace(t, &bd, rays, b, n, &bs);
            wrong[o] = 0;
            for (i = 0; i < n; i++)
                wrong[o] += (a[i].node == VOXRT_NO_NODE) != (b[i].node == VOXRT_NO_NODE) || memcmp(a[i].cell,
                    b[i].cell, sizeof a[i].cell) != 0;
            wrong[o] = (wrong[o] - (double)(o < 6 ? st.stuck : bs.stuck)) / (double)n;
            stuck[o] = (double)(o < 6 ? st.stuck : bs.stuck) / (double)n;
            if (test_g.verbose && o < 5) printf("    2^%u fixed offset %g: wrong %.3f %% stuck %.3f %%\n", depths[k],
                (double)offsets[o], 100 * wrong[o], 100 * stuck[o]);
            if (test_g.verbose && o >= 5) printf("    2^%u %s: wrong %.3f %% stuck %.3f %%\n", depths[k],
                o == 5 ? "default" : "lambda + 1e-3", 100 * wrong[o], 100 * stuck[o]);
        }
        CHECK(wrong[0] > 4 * wrong[1] && wrong[1] > 4 * wrong[2]); /* in proportion to the offset */
        CHECK(wrong[0] > 0.05 && stuck[0] == 0 && stuck[1] == 0);
        CHECK(stuck[4] > 0.1 && stuck[4] >= stuck[3] && stuck[3] >= stuck[2]); /* too small: no progress */
        CHECK(stuck[6] > stuck[5]); /* lambda + eps is stuck where grazing */
        CHECK(stuck[5] == 0 && wrong[5] < (k == 0 ? 5e-4 : k == 1 ? 1.5e-3 : 5e-3)); /* the default */
        free(rays);
        free(a);
        free(b);
        voxrt_tree_destroy(s);
        voxrt_octree_destroy(t);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(golden_file);
    RUN(random_files_round_trip);
    RUN(hostile_files);
    RUN(file_options);
    RUN(files_on_disk);
    RUN(limits_while_loading);
    RUN(limits_that_stay);
    RUN(dense_counts);
    RUN(insertion);
    RUN(order_does_not_matter);
    RUN(lod_majority);
    RUN(normal_codec);
    RUN(lossless_there_and_back);
    RUN(conversions);
    RUN(no_memory);
    RUN(blocks_have_numbers);
    RUN(bad_arguments);
    RUN(rays_against_brute_force);
    RUN(packets_and_bad_rays);
    RUN(growing_offset);
    RUN(grids_and_counters);
    RUN(forced_level);
    RUN(collapse_keeps_the_picture);
    RUN(lod_level);
    RUN(offset_sweep);
    return test_end();
}
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC pop_options
#endif
