/* Shared trees: what is kept is what a slow count says; attributes, levels, rays and files as of the plain tree. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "voxel_list.h"

static void share_add(cells *c, uint32_t x, uint32_t y, uint32_t z) {
    (void)cells_add(c, x, y, z, x % 4 * 60 | (y >> 2 << 6 & 255u) << 8 | z % 3 * 80 << 16);
    cells_normal(c, x % 17 - 8.0, 1.0 + y % 3, z % 5 - 2.0);
}

static int in_menger(uint32_t x, uint32_t y, uint32_t z) {
    for (; x != 0 || y != 0 || z != 0; x /= 3, y /= 3, z /= 3)
        if ((x % 3 == 1) + (y % 3 == 1) + (z % 3 == 1) >= 2) return 0;
    return 1;
}

enum { SHARE_KINDS = 12, MANY = 11 };

static uint32_t share_make_cells(int kind, cells *c) { /* returns the depth */
    test_rng r = test_rng_make((uint64_t)kind + 77);
    uint32_t i, k, x, y, z, n;
    memset(c, 0, sizeof *c);
    switch (kind) {
    case 0: share_add(c, 1, 0, 1); return 1; /* the smallest tree, odd depth */
    case 1: share_add(c, 3, 2, 1); share_add(c, 0, 0, 0); return 2;
    case 2: share_add(c, 0xfffff, 0xfffff, 0xfffff); share_add(c, 0, 0, 0); share_add(c, 0, 1, 0xfffff); return 20; /* the deepest */
    case 3: share_add(c, 0x12345, 0x6789a, 0x7ffff); return 19;
    case 4: for (i = 0; i < 32768; i++) share_add(c, i & 31, i >> 5 & 31, i >> 10); return 5; /* all full */
    case 5: for (i = 0; i < 64 * 64; i++) share_add(c, i & 63, i >> 6, 17); return 7; /* a wall */
    case 6:
        for (i = 0; i < 81 * 81 * 81; i++)
            if (in_menger(i % 81, i / 81 % 81, i / 6561)) share_add(c, i % 81, i / 81 % 81, i / 6561);
        return 7;
    case 7: /* noise */
    case 8: /* less of it in more room */
        n = kind == 7 ? 4000 : 300;
        for (i = 0; i < n; i++) {
            uint32_t u = test_rng_u32(&r), w = kind == 7 ? 31 : 255;
            share_add(c, u & w, u >> 8 & w, u >> 16 & w);
        }
        return kind == 7 ? 5 : 8;
    case 9: /* the same thing again and again, where nodes begin and elsewhere */
        for (k = 0; k < 40; k++) {
            uint32_t o[3];
            for (i = 0; i < 3; i++) o[i] = test_rng_below(&r, 200) & (k < 30 ? ~15u : ~0u);
            for (i = 0; i < 12; i++) share_add(c, o[0] + i * i % 16, o[1] + i * 7 % 16, o[2] + i % 5 * 3);
        }
        return 8;
    case 10: /* a sphere */
        for (z = 0; z < 96; z++)
            for (y = 0; y < 96; y++)
                for (x = 0; x < 96; x++) {
                    double p = x - 47.3, q = y - 47.9, s = z - 48.1, d = sqrt(p * p + q * q + s * s);
                    if (fabs(d - 44.0) < 0.6) share_add(c, x, y, z);
                }
        return 7;
    default: /* more different leaf nodes than codes; some come again near by, some far away */
        for (i = 0; i < 88000; i++) {
            uint64_t what = i % 9 == 0 ? i / 90 : i % 9 == 1 ? i / 512 + 1000000 : i + 2000000, h;
            x = i & 63;
            y = i >> 6 & 63;
            z = i >> 12;
            h = voxrti_hash_mix(99, what);
            for (k = 0; k < 5; k++, h >>= 8) share_add(c, 4 * x + (h & 3), 4 * y + (h >> 2 & 3), 4 * z + (h >> 4 & 3));
        }
        return 8;
    }
}

static voxrt_tree *share_make_tree(int kind, int colors, int normals) {
    cells c;
    voxrt_build_desc d;
    uint32_t depth = share_make_cells(kind, &c);
    memset(&d, 0, sizeof d);
    d.lod_method = kind == 6 || kind == MANY ? VOXRT_LOD_MAJORITY : VOXRT_LOD_MEAN; /* few colours to merge */
    d.disable_colors = !colors;
    d.disable_normals = !normals;
    return cells_tree(&c, &d, depth);
}

static voxrt_tree *share(const voxrt_tree *t) {
    voxrt_tree *s = NULL;
    CHECK(voxrt_tree_share(t, NULL, &s) == VOXRT_OK);
    return s;
}

static uint8_t *share_save(const voxrt_tree *t, int encoding, size_t *size) {
    voxrt_save_desc d;
    uint8_t *p = NULL;
    void *block = NULL;
    size_t again = 0;
    memset(&d, 0, sizeof d);
    d.encoding = (voxrt_encoding)encoding;
    if (voxrt_tree_save_memory(t, &d, NULL, 0, size) != VOXRT_OK) return NULL;
    if (posix_memalign(&block, 64, *size) != 0) exit(1);
    p = (uint8_t *)block;
    if (voxrt_tree_save_memory(t, &d, p, *size, &again) != VOXRT_OK || again != *size) {
        test_fail(__FILE__, __LINE__, "save failed");
        free(p);
        return NULL;
    }
    return p;
}

static int same_bytes(const voxrt_tree *a, const voxrt_tree *b, int encoding) {
    size_t n = 0, m = 0;
    uint8_t *p = share_save(a, encoding, &n), *q = share_save(b, encoding, &m);
    const int same = p != NULL && q != NULL && n == m && memcmp(p, q, n) == 0;
    free(p);
    free(q);
    return same;
}

/* ---- what is kept, counted slowly: everything below a node as text, lists of children as the texts in a row ---- */

typedef struct text { char *p; size_t n; } text;

static text describe(const voxrt_tree *t, uint32_t w, uint32_t node) { /* plain tree */
    text out = {NULL, 0}, kid;
    uint64_t mask = w + 1 == t->wide ? t->leaf[node] : t->node[node].mask;
    uint32_t k, n = (uint32_t)__builtin_popcountll(mask);
    out.p = (char *)malloc(24);
    out.n = (size_t)snprintf(out.p, 24, "(%llx", (unsigned long long)mask);
    for (k = 0; k < n && w + 1 < t->wide; k++) {
        kid = describe(t, w + 1, t->node[node].child + k);
        out.p = (char *)realloc(out.p, out.n + kid.n + 2);
        memcpy(out.p + out.n, kid.p, kid.n);
        out.n += kid.n;
        free(kid.p);
    }
    out.p[out.n++] = ')';
    return out;
}

static int by_text(const void *a, const void *b) {
    const text *x = (const text *)a, *y = (const text *)b;
    int c = memcmp(x->p, y->p, x->n < y->n ? x->n : y->n);
    return c != 0 ? c : x->n < y->n ? -1 : x->n > y->n;
}

TEST(what_is_kept) {
    int kind;
    for (kind = 0; kind < SHARE_KINDS; kind++) {
        voxrt_tree *t, *s;
        uint32_t w, i, k, kept = 1;
        uint64_t masks = 0;
        if (kind == 4 || kind == 6 || kind == 10 || kind == MANY) continue; /* too much text */
        t = share_make_tree(kind, 0, 0);
        s = share(t);
        REQUIRE(t != NULL && s != NULL);
        CHECK(s->level_nodes[0] == 1);
        for (w = 0; w + 1 < t->wide; w++) { /* different lists of children, and how long they are together */
            text *list = (text *)calloc(t->level_nodes[w], sizeof *list), kid;
            for (i = 0; i < t->level_nodes[w]; i++) {
                const voxrti_node *n = &t->node[t->level_first[w] + i];
                for (k = 0; k < (uint32_t)__builtin_popcountll(n->mask); k++) {
                    kid = describe(t, w + 1, n->child + k);
                    list[i].p = (char *)realloc(list[i].p, list[i].n + kid.n + 1);
                    memcpy(list[i].p + list[i].n, kid.p, kid.n);
                    list[i].n += kid.n;
                    free(kid.p);
                }
            }
            qsort(list, t->level_nodes[w], sizeof *list, by_text);
            for (i = 0, kept = 0; i < t->level_nodes[w]; i++) {
                int depth = 0;
                if (i > 0 && by_text(&list[i], &list[i - 1]) == 0) continue;
                for (k = 0; k < list[i].n; k++) {
                    depth += list[i].p[k] == '(' ? 1 : list[i].p[k] == ')' ? -1 : 0;
                    kept += list[i].p[k] == ')' && depth == 0;
                }
            }
            for (i = 0; i < t->level_nodes[w]; i++) free(list[i].p);
            free(list);
            CHECK_EQ_U64(s->level_nodes[w + 1], kept);
        }
        for (i = 0; i < t->level_nodes[t->wide - 1]; i++) {
            for (k = 0; k < i && t->leaf[k] != t->leaf[i]; k++) {}
            masks += k == i;
        }
        CHECK_EQ_U64(s->mask_count, masks);
        for (i = 1; i < s->mask_count; i++) { /* the most frequent first */
            uint32_t n[2] = {0, 0};
            for (k = 0; k < s->level_nodes[s->wide - 1]; k++) {
                n[0] += s->code[k] == i - 1;
                n[1] += s->code[k] == i;
            }
            CHECK(n[0] >= n[1]);
        }
        voxrt_tree_destroy(s);
        voxrt_tree_destroy(t);
    }
}

TEST(many_masks) {
    voxrt_tree *t = share_make_tree(MANY, 0, 0), *s = share(t);
    uint32_t i, n, block, k;
    REQUIRE(t != NULL && s != NULL);
    n = s->level_nodes[s->wide - 1];
    CHECK(s->mask_count > 65536);
    CHECK(s->mask_count < n + 1000); /* far repetitions are kept twice, near ones are not */
    for (block = 0, k = 0; block < n; block += 4096) { /* the extras of a block are its own, each once, in order */
        uint32_t next = 0;
        for (i = block; i < n && i < block + 4096; i++) {
            if (s->code[i] < 61440) continue;
            CHECK(s->code[i] - 61440u <= next);
            next += s->code[i] - 61440u == next;
            for (k = i < 40 ? 0 : i - 40; k < i; k++)
                CHECK((s->code[k] == s->code[i]) == (s->leaf[voxrti_leaf_at(s, k)] == s->leaf[voxrti_leaf_at(s, i)]) || k < block);
        }
    }
    voxrt_tree_destroy(s);
    voxrt_tree_destroy(t);
}

/* Masks as if somebody knew the set's hash function: all of them fall on few places of it. */
TEST(masks_that_collide) {
    enum { COUNT = 200000, DISTINCT = 60000 };
    const uint64_t inverse = 0xf1de83e19937733du; /* of 0x9e3779b97f4a7c15 */
    uint64_t *leaf = (uint64_t *)malloc(COUNT * sizeof *leaf);
    uint32_t *first = (uint32_t *)malloc(DISTINCT * sizeof *first), *to[2], i, which, numbers;
    clock_t spent[2];
    test_rng r;
    to[0] = (uint32_t *)malloc(2 * COUNT * sizeof **to);
    REQUIRE(leaf != NULL && first != NULL && to[0] != NULL && inverse * 0x9e3779b97f4a7c15u == 1);
    to[1] = to[0] + COUNT;
    r = test_rng_make(7);
    for (which = 0; which < 2; which++) {
        voxrti_mem mem;
        voxrti_sharer h;
        voxrt_env env;
        memset(&env, 0, sizeof env);
        REQUIRE(voxrti_env_open(&env, &mem) == VOXRT_OK);
        memset(&h, 0, sizeof h);
        h.mem = &mem;
        for (i = 0; i < COUNT; i++) {
            const uint64_t k = i < DISTINCT ? i + 1u : test_rng_below(&r, DISTINCT) + 1u;
            leaf[i] = which ? k * inverse : voxrti_hash_mix(voxrti_hash_mix(1, k), 2); /* hash: k, so its upper bits are 0 */
        }
        spent[which] = clock();
        REQUIRE(voxrti_share_masks(&h, leaf, COUNT, to[which]) == VOXRT_OK);
        spent[which] = clock() - spent[which];
        memset(first, 0xff, DISTINCT * sizeof *first);
        for (i = 0, numbers = 0; i < COUNT; i++) { /* in the order in which they come up */
            REQUIRE(to[which][i] <= numbers && to[which][i] < h.mask_count && h.mask[to[which][i]] == leaf[i]);
            numbers += to[which][i] == numbers;
        }
        CHECK(numbers == h.mask_count && numbers == DISTINCT);
        voxrti_free(&mem, h.mask);
        CHECK(mem.used == 0);
    }
    CHECK(spent[1] < 20 * spent[0] + CLOCKS_PER_SEC / 5); /* the collisions one by one are 1.8e9 */
    free(leaf);
    free(first);
    free(to[0]);
}

/* Fewer of them, so many that they are sorted, with each request refused. */
TEST(masks_that_collide_without_memory) {
    enum { COUNT = 1000, DISTINCT = 600 };
    const uint64_t inverse = 0xf1de83e19937733du; /* as above */
    uint64_t leaf[COUNT];
    uint32_t to[COUNT], i;
    voxrt_result r = VOXRT_ERR_NO_MEMORY;
    test_alloc ta;
    int64_t k;
    for (i = 0; i < COUNT; i++) leaf[i] = (i % DISTINCT + 1) * inverse;
    for (k = 0; k < 100 && r != VOXRT_OK; k++) {
        voxrti_mem mem;
        voxrti_sharer h;
        voxrt_env env;
        memset(&env, 0, sizeof env);
        memset(&h, 0, sizeof h);
        test_alloc_init(&ta);
        ta.fail_at = k;
        env.allocator.alloc_fn = test_alloc_fn;
        env.allocator.free_fn = test_free_fn;
        env.allocator.user = &ta;
        REQUIRE(voxrti_env_open(&env, &mem) == VOXRT_OK);
        h.mem = &mem;
        r = voxrti_share_masks(&h, leaf, COUNT, to);
        CHECK(r == (ta.failed ? VOXRT_ERR_NO_MEMORY : VOXRT_OK));
        for (i = 0; i < COUNT && r == VOXRT_OK; i++) CHECK(to[i] == i % DISTINCT && h.mask[to[i]] == leaf[i]);
        CHECK(r != VOXRT_OK || (h.mask_count == DISTINCT && h.mask_capacity == DISTINCT)); /* sorted: no room is left over */
        voxrti_free(&mem, h.mask);
        test_alloc_check(&ta);
    }
    CHECK(r == VOXRT_OK && k > 5);
}

/* ---- cells and attributes ---- */

typedef struct seen { voxrt_voxel v; uint32_t index; } seen;
typedef struct seen_list { seen *s; size_t n; } seen_list;

static int note(void *user, const voxrt_voxel *voxel, uint32_t index) {
    seen_list *l = (seen_list *)user;
    l->s[l->n].v = *voxel;
    l->s[l->n++].index = index;
    return 0;
}

static int stop_at(void *user, const voxrt_voxel *voxel, uint32_t index) {
    int *left = (int *)user;
    (void)voxel;
    (void)index;
    return --*left == 0 ? 42 : 0;
}

TEST(same_cells) {
    int kind, what;
    for (kind = 0; kind < SHARE_KINDS; kind++)
        for (what = 0; what < 3; what++) {
            voxrt_tree *t, *s, *u = NULL, *again;
            voxrt_tree_info a, b;
            test_rng r = test_rng_make(3);
            uint32_t level, i;
            if (kind == MANY && (what != 0 || test_quick())) continue;
            t = share_make_tree(kind, what != 1, what != 2);
            s = share(t);
            REQUIRE(t != NULL && s != NULL);
            CHECK(voxrt_tree_unshare(s, NULL, &u) == VOXRT_OK);
            voxrt_tree_get_info(t, &a);
            voxrt_tree_get_info(s, &b);
            CHECK(!a.shared && b.shared);
            CHECK(a.voxel_count == b.voxel_count && memcmp(a.level_count, b.level_count, sizeof a.level_count) == 0);
            CHECK(memcmp(a.cell_min, b.cell_min, sizeof a.cell_min) == 0);
            CHECK(memcmp(a.cell_max, b.cell_max, sizeof a.cell_max) == 0);
            CHECK_EQ_U64(voxrt_tree_hash(t), voxrt_tree_hash(s));
            CHECK(same_bytes(t, u, 0) && same_bytes(t, u, 1));
            again = share(s);
            CHECK(same_bytes(s, again, 0) && same_bytes(s, again, 1));
            voxrt_tree_destroy(again);
            voxrt_tree_destroy(u);
            for (level = 0; level <= a.depth; level++) {
                seen_list x, y;
                int left = 3, left2 = 3;
                x.n = y.n = 0;
                x.s = (seen *)malloc((size_t)a.level_count[level] * sizeof *x.s);
                y.s = (seen *)malloc((size_t)a.level_count[level] * sizeof *y.s);
                REQUIRE(x.s != NULL && y.s != NULL);
                memset(x.s, 0, (size_t)a.level_count[level] * sizeof *x.s);
                memset(y.s, 0, (size_t)a.level_count[level] * sizeof *y.s);
                (void)voxrt_tree_each(t, level, note, &x);
                (void)voxrt_tree_each(s, level, note, &y);
                CHECK(x.n == y.n && x.n == a.level_count[level] && memcmp(x.s, y.s, x.n * sizeof *x.s) == 0);
                CHECK(voxrt_tree_each(t, level, stop_at, &left) == voxrt_tree_each(s, level, stop_at, &left2));
                for (i = 0; i < 300 && y.n != 0; i++) { /* what is there, and what is beside it */
                    const voxrt_voxel *v = &y.s[test_rng_below(&r, (uint32_t)y.n)].v;
                    const uint32_t d = test_rng_below(&r, 2), size = 1u << level;
                    voxrt_voxel p, q;
                    memset(&p, 1, sizeof p);
                    memset(&q, 1, sizeof q);
                    if (v->x + d >= size) continue;
                    CHECK(voxrt_tree_get(t, level, v->x + d, v->y, v->z, &p) ==
                          voxrt_tree_get(s, level, v->x + d, v->y, v->z, &q));
                    CHECK(memcmp(&p, &q, sizeof p) == 0);
                }
                free(x.s);
                free(y.s);
            }
            voxrt_tree_destroy(s);
            voxrt_tree_destroy(t);
        }
}

/* ---- rays ---- */

static float random_in(test_rng *r, double lo, double hi) {
    return (float)(lo + (hi - lo) * ((double)test_rng_u32(r) / 4294967296.0));
}

TEST(same_hits) {
    enum { RAYS = 1024 };
    static voxrt_ray rays[RAYS];
    static voxrt_hit a[RAYS], b[RAYS], first[RAYS];
    test_rng r = test_rng_make(8);
    int kind, how;
    size_t hits = 0;
    for (kind = 0; kind < SHARE_KINDS; kind++) {
        voxrt_tree *t, *s;
        voxrt_tree_info info;
        t = share_make_tree(kind, 1, 1);
        s = share(t);
        REQUIRE(t != NULL && s != NULL);
        voxrt_tree_get_info(t, &info);
        for (how = 0; how < (kind == MANY ? 2 : 6); how++) { /* tiles, chords; without and with level of detail */
            voxrt_trace_desc d;
            int isa, i, k;
            memset(&d, 0, sizeof d);
            if (how == 2 || how == 3) d.cone_spread = 0.02f;
            if (how == 4) d.max_level_plus_1 = info.depth > 2 ? info.depth - 1 : 2;
            if (how == 5) d.cone_width = 3.0f;
            for (i = 0; i < RAYS; i++) {
                voxrt_ray *p = &rays[i];
                memset(p, 0, sizeof *p);
                p->t_max = INFINITY;
                for (k = 0; k < 3; k++) {
                    const double lo = info.cell_min[k], hi = info.cell_max[k];
                    if ((how & 1) != 0) {
                        p->org[k] = random_in(&r, lo, hi);
                        p->dir[k] = random_in(&r, lo, hi) - p->org[k];
                    } else { /* 64 rays from one place, close together */
                        if ((i & 63) == 0) {
                            p->org[k] = random_in(&r, lo - (hi - lo), lo);
                            p->dir[k] = random_in(&r, lo, hi);
                        } else {
                            p->org[k] = rays[i & ~63].org[k];
                            p->dir[k] = rays[i & ~63].dir[k] + p->org[k] + random_in(&r, 0, 0.03 * (hi - lo));
                        }
                        p->dir[k] -= p->org[k];
                    }
                }
            }
            for (isa = VOXRT_ISA_SCALAR; isa <= VOXRT_ISA_AVX2; isa++) {
                d.isa = (voxrt_isa)isa;
                CHECK(voxrt_trace(t, &d, rays, a, RAYS) == VOXRT_OK);
                CHECK(voxrt_trace(s, &d, rays, b, RAYS) == VOXRT_OK);
                if (isa == VOXRT_ISA_SCALAR) memcpy(first, b, sizeof b);
                CHECK(memcmp(first, b, sizeof b) == 0);
                for (i = 0; i < RAYS; i++) {
                    uint8_t ca[3], cb[3];
                    float na[3], nb[3];
                    voxrt_hit x = a[i];
                    x.node = b[i].node;
                    CHECK((a[i].node == VOXRT_NO_NODE) == (b[i].node == VOXRT_NO_NODE));
                    CHECK(memcmp(&x, &b[i], sizeof x) == 0);
                    if (a[i].node == VOXRT_NO_NODE || b[i].node == VOXRT_NO_NODE) continue;
                    hits++;
                    voxrt_hit_color(t, &a[i], ca);
                    voxrt_hit_color(s, &b[i], cb);
                    voxrt_hit_normal(t, &a[i], na);
                    voxrt_hit_normal(s, &b[i], nb);
                    CHECK(memcmp(ca, cb, sizeof ca) == 0 && memcmp(na, nb, sizeof na) == 0);
                }
            }
        }
        voxrt_tree_destroy(s);
        voxrt_tree_destroy(t);
    }
    CHECK(hits > 50000);
}

static void share_draw(const voxrt_tree *t, int how, uint32_t w, uint32_t h, uint8_t *rgba8, float *depth, float *normal) {
    voxrt_render_desc d;
    voxrt_geometry g;
    voxrt_image m;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    m.width = w;
    m.height = h;
    m.rgba8 = rgba8;
    m.depth = depth;
    m.normal = normal;
    d.shadows = 1;
    d.view = (voxrt_view)(how % 7); /* also those that count steps */
    d.tolerance = how % 3 == 0 ? 2.0f : 0.0f;
    d.object_lod = how == 8;
    d.lod_split = how == 9 ? 4 : 0;
    d.samples = how == 10 ? 3 : 1;
    if (how == 11) { /* as one geometry among others */
        voxrt_tree_geometry(t, &g);
        d.geometry = &g;
        d.geometry_count = 1;
    }
    CHECK(voxrt_render(&d, how == 11 ? NULL : t, &m, NULL) == VOXRT_OK);
}

TEST(same_picture_and_octree) {
    enum { W = 64, H = 48 };
    static uint8_t p[2][4 * W * H];
    static float depth[2][W * H], normal[2][3 * W * H];
    voxrt_tree *t[2];
    voxrt_octree *o[2] = {NULL, NULL};
    size_t n[2] = {0, 0};
    uint8_t *f[2];
    int i, how;
    t[0] = share_make_tree(10, 1, 1);
    t[1] = share(t[0]);
    REQUIRE(t[0] != NULL && t[1] != NULL);
    for (how = 0; how < 12; how++) {
        for (i = 0; i < 2; i++) share_draw(t[i], how, W, H, p[i], depth[i], normal[i]);
        CHECK_MSG(memcmp(p[0], p[1], sizeof p[0]) == 0, "picture %d", how);
        CHECK(memcmp(depth[0], depth[1], sizeof depth[0]) == 0 && memcmp(normal[0], normal[1], sizeof normal[0]) == 0);
    }
    for (i = 0; i < 2; i++) {
        CHECK(voxrt_octree_from_tree(NULL, t[i], &o[i]) == VOXRT_OK);
        CHECK(voxrt_octree_save_memory(o[i], NULL, NULL, 0, &n[i]) == VOXRT_OK);
        f[i] = (uint8_t *)malloc(n[i] + 1);
        CHECK(voxrt_octree_save_memory(o[i], NULL, f[i], n[i], &n[i]) == VOXRT_OK);
        voxrt_octree_destroy(o[i]);
        voxrt_tree_destroy(t[i]);
    }
    CHECK(n[0] == n[1] && memcmp(f[0], f[1], n[0]) == 0);
    free(f[0]);
    free(f[1]);
}

/* ---- files ---- */

static voxrt_tree *load(const uint8_t *p, size_t size, int map, int trust) {
    voxrt_load_desc d;
    voxrt_tree *t = NULL;
    memset(&d, 0, sizeof d);
    d.trust_input = (uint32_t)trust;
    CHECK((map ? voxrt_tree_map_memory(&d, p, size, &t) : voxrt_tree_load_memory(&d, p, size, &t)) == VOXRT_OK);
    return t;
}

TEST(files) {
    int kind, how;
    for (kind = 0; kind < SHARE_KINDS; kind++) {
        voxrt_tree *t = share_make_tree(kind, kind & 1, kind != 3 && kind != MANY), *s = share(t);
        REQUIRE(t != NULL && s != NULL);
        for (how = 0; how < (kind == MANY ? test_quick() ? 1 : 2 : 6); how++) { /* compact, raw, mapped; and trusted */
            size_t size = 0;
            uint8_t *p = share_save(s, how % 3 != 0, &size);
            voxrt_tree *u, *v = NULL;
            REQUIRE(p != NULL);
            if (how % 3 == 2 && !voxrti_little_endian()) {
                free(p);
                continue;
            }
            u = load(p, size, how % 3 == 2, how >= 3);
            REQUIRE(u != NULL);
            CHECK(u->code != NULL);
            CHECK_EQ_U64(voxrt_tree_hash(u), voxrt_tree_hash(t));
            if (how < 3) { /* how it was checked makes no other tree */
                CHECK(same_bytes(u, s, how == 0)); /* the other form than it came from */
                CHECK(voxrt_tree_unshare(u, NULL, &v) == VOXRT_OK);
                CHECK(same_bytes(v, t, 0));
                voxrt_tree_destroy(v);
            }
            voxrt_tree_destroy(u);
            free(p);
        }
        voxrt_tree_destroy(s);
        voxrt_tree_destroy(t);
    }
}

/* Load with a limit; use what is accepted. It is the same when it is written down in the compact form and read again. */
static int share_try_load(const uint8_t *p, size_t size) {
    voxrt_load_desc d;
    voxrt_tree *t = NULL;
    voxrt_tree_info info;
    voxrt_ray ray;
    voxrt_hit hit;
    uint8_t rgb[3];
    float normal[3];
    void *block = NULL;
    int map, loaded = 0;
    if (posix_memalign(&block, 64, size != 0 ? size : 1) != 0) exit(1); /* ends where the file ends */
    if (size != 0) memcpy(block, p, size);
    memset(&d, 0, sizeof d);
    d.env.memory_limit = 1 << 25;
    for (map = 0; map < 2; map++) {
        const voxrt_result r = map ? voxrt_tree_map_memory(&d, block, size, &t) : voxrt_tree_load_memory(&d, block, size, &t);
        if (r != VOXRT_OK) {
            CHECK(t == NULL);
            continue;
        }
        loaded = 1;
        voxrt_tree_get_info(t, &info);
        if (info.voxel_count < 100000 && map == 0) {
            voxrt_tree *again = NULL;
            size_t n = 0;
            uint8_t *q = share_save(t, 0, &n);
            CHECK(q != NULL && voxrt_tree_load_memory(&d, q, n, &again) == VOXRT_OK);
            CHECK_EQ_U64(voxrt_tree_hash(again), voxrt_tree_hash(t));
            voxrt_tree_destroy(again);
            free(q);
        }
        memset(&ray, 0, sizeof ray);
        ray.t_max = INFINITY;
        ray.dir[0] = 0.31f;
        ray.dir[1] = 0.37f;
        ray.dir[2] = 0.41f;
        ray.org[0] = ray.org[1] = ray.org[2] = -1.0f;
        if (voxrt_trace1(t, &ray, &hit)) {
            voxrt_hit_color(t, &hit, rgb);
            voxrt_hit_normal(t, &hit, normal);
        }
        voxrt_tree_destroy(t);
    }
    free(block);
    return loaded;
}

TEST(damaged_files) {
    static const int kinds[4] = {1, 3, 8, 9};
    test_rng r = test_rng_make(4);
    int k, encoding, round, rounds = test_quick() || TEST_SANITIZED ? 300 : 1500;
    size_t loaded = 0, refused = 0;
    for (k = 0; k < 4; k++)
        for (encoding = 0; encoding < 2; encoding++) {
            voxrt_tree *t = share_make_tree(kinds[k], k & 1, k >> 1 & 1), *s = share(t);
            size_t size = 0, n, i;
            uint8_t *p, *q;
            REQUIRE(t != NULL && s != NULL);
            p = share_save(s, encoding, &size);
            REQUIRE(p != NULL);
            q = (uint8_t *)malloc(size + 8);
            REQUIRE(q != NULL);
            memcpy(q, p, size);
            for (n = 0; n < size; n += n < 1000 ? 1 : 61) CHECK(!share_try_load(p, n));
            CHECK(!share_try_load(q, size + 1));
            for (round = 0; round < rounds / 8; round++) {
                const size_t at = test_rng_below(&r, (uint32_t)size), m = 1 + test_rng_below(&r, 3);
                memcpy(q, p, size);
                for (i = 0; i < m; i++) {
                    size_t to = (at + (i == 0 ? 0 : test_rng_below(&r, (uint32_t)size))) % size;
                    if (test_rng_below(&r, 2)) q[to] ^= (uint8_t)(1u << test_rng_below(&r, 8));
                    else q[to] = (uint8_t)test_rng_u32(&r);
                }
                voxrti_v5_seal(q, size);
                if (share_try_load(q, size)) loaded++;
                else refused++;
            }
            free(q);
            free(p);
            voxrt_tree_destroy(s);
            voxrt_tree_destroy(t);
        }
    CHECK(loaded > (size_t)rounds / 50 && refused > (size_t)rounds / 4);
}

static uint8_t *section(uint8_t *p, uint32_t id, size_t *size) {
    uint32_t i, n = voxrti_load_u16(p + 14);
    for (i = 0; i < n; i++) {
        uint8_t *e = p + 64 + 40 * i;
        if (voxrti_load_u32(e) != id) continue;
        *size = (size_t)voxrti_load_u64(e + 16);
        return p + (size_t)voxrti_load_u64(e + 8);
    }
    return NULL;
}

/* Each of these is the only thing that is wrong. */
TEST(wrong_values) {
    voxrt_tree *t = share_make_tree(9, 1, 1), *s = share(t);
    int encoding;
    REQUIRE(t != NULL && s != NULL);
    for (encoding = 0; encoding < 2; encoding++) {
        size_t size = 0, n = 0, i, wrong = 0, tried = 0;
        uint8_t *p = share_save(s, encoding, &size), *q = (uint8_t *)malloc(size), *at;
        REQUIRE(p != NULL && q != NULL);
        CHECK(share_try_load(p, size));
        memcpy(q, p, size);
        at = section(q, 10, &n);
        REQUIRE(at != NULL);
        for (i = 0; i < n; i++) { /* counts, owners, runs: no bit of it can be another one */
            memcpy(q, p, size);
            at[i] ^= (uint8_t)(1u << (i * 5u & 7u));
            voxrti_v5_seal(q, size);
            tried++;
            wrong += (size_t)share_try_load(q, size);
        }
        CHECK(tried >= 48);
        /* but for a run that is named instead of another one of the same length, with as many cells in it */
        CHECK_MSG(wrong <= tried / 20, "%u of %u", (unsigned)wrong, (unsigned)tried);
        if (encoding == 1) {
            at = section(q, 3, &n);
            for (i = 8; at != NULL && i < n; i += 16) { /* first children and cells before */
                memcpy(q, p, size);
                voxrti_store_u32(at + i + 4, voxrti_load_u32(at + i + 4) + 1);
                voxrti_v5_seal(q, size);
                CHECK(!share_try_load(q, size));
                memcpy(q, p, size);
                voxrti_store_u32(at + i, 0x7fffffffu);
                voxrti_v5_seal(q, size);
                CHECK(!share_try_load(q, size));
            }
            at = section(q, 11, &n);
            memcpy(q, p, size);
            REQUIRE(at != NULL);
            voxrti_store_u16(at, s->mask_count + 9); /* no such mask, nor anything that follows them */
            voxrti_v5_seal(q, size);
            CHECK(!share_try_load(q, size));
            at = section(q, 4, &n);
            memcpy(q, p, size);
            REQUIRE(at != NULL);
            voxrti_store_u64(at, 0); /* an empty node */
            voxrti_v5_seal(q, size);
            CHECK(!share_try_load(q, size));
        }
        free(q);
        free(p);
    }
    voxrt_tree_destroy(s);
    voxrt_tree_destroy(t);
}

/* A run is named that begins within another one: as long, with as many cells, and still no run. */
TEST(runs_within_runs) {
    cells c;
    voxrt_tree *t, *s;
    size_t size = 0, n = 0;
    uint32_t i;
    uint8_t *p, *at;
    memset(&c, 0, sizeof c);
    share_add(&c, 0, 0, 0); /* the box stays the same */
    share_add(&c, 255, 255, 255);
    for (i = 0; i < 3; i++) { /* P Q, R S, P Q */
        share_add(&c, 64 * i + 1 + (i & 1), 64 + 2, 64 + 3);
        share_add(&c, 64 * i + 18 + (i & 1), 64 + 1, 64 + 2 * (i & 1));
    }
    t = cells_tree(&c, NULL, 8);
    s = share(t);
    REQUIRE(t != NULL && s != NULL);
    p = share_save(s, 0, &size);
    REQUIRE(p != NULL);
    at = section(p, 10, &n);
    REQUIRE(at != NULL && n > 52);
    at += n - 4; /* the only node that names the run of another one */
    CHECK(share_try_load(p, size));
    CHECK_EQ_U64(voxrti_load_u32(at), 1);
    voxrti_store_u32(at, 2);
    voxrti_v5_seal(p, size);
    CHECK(!share_try_load(p, size));
    voxrti_store_u32(at, 3); /* R S: another tree */
    voxrti_v5_seal(p, size);
    CHECK(share_try_load(p, size));
    free(p);
    voxrt_tree_destroy(s);
    voxrt_tree_destroy(t);
}

/* Raw files of the same tree in other orders. Runs have one order, which the compact form builds on; masks may stand as
   they like. */
TEST(other_orders) {
    voxrt_tree *t = share_make_tree(9, 1, 1), *s = share(t);
    size_t size = 0, n = 0, swaps = 0, alike = 0;
    uint32_t i, k, j;
    uint8_t *p, *q, *node, *code, *leaf;
    REQUIRE(t != NULL && s != NULL);
    p = share_save(s, 1, &size);
    q = (uint8_t *)malloc(size);
    REQUIRE(p != NULL && q != NULL);
    CHECK(share_try_load(p, size));
    for (i = s->level_first[s->wide - 2]; i + 1 < s->node_count; i++) { /* two runs change places */
        const voxrti_node *a = &s->node[i], *b = &s->node[i + 1];
        const uint32_t m = voxrti_popcount64(a->mask), l = voxrti_popcount64(b->mask);
        uint32_t named = 0;
        for (k = s->level_first[s->wide - 2]; k < s->node_count; k++)
            named += s->node[k].child == a->child || s->node[k].child == a->child + m;
        if (b->child != a->child + m || named != 2) continue;
        memcpy(q, p, size);
        node = section(q, 3, &n);
        code = section(q, 11, &n);
        REQUIRE(node != NULL && code != NULL);
        voxrti_store_u32(node + 16 * i + 8, a->child + l);
        voxrti_store_u32(node + 16 * i + 24, a->child);
        for (k = 0; k < m; k++) voxrti_store_u16(code + 2 * (a->child + l + k), s->code[a->child + k]);
        for (k = 0; k < l; k++) voxrti_store_u16(code + 2 * (a->child + k), s->code[b->child + k]);
        voxrti_v5_seal(q, size);
        CHECK(!share_try_load(q, size));
        swaps++;
    }
    CHECK(swaps > 2);
    for (i = 0; i < s->mask_count && (i <= 8 || alike <= 4); i++)
        for (j = 0; j < i; j++) { /* masks i and j change places; or i is used for both, and j is not used or the same */
            for (k = 0; k < 3; k++) {
                uint32_t c;
                if (k > 0 && (voxrti_popcount64(s->leaf[i]) != voxrti_popcount64(s->leaf[j]) ||
                    voxrti_popcount64(voxrti_octants(s->leaf[i])) != voxrti_popcount64(voxrti_octants(s->leaf[j]))))
                    break;
                if (k == 0 && i > 8) continue;
                memcpy(q, p, size);
                code = section(q, 11, &n);
                leaf = section(q, 4, &n);
                REQUIRE(code != NULL && leaf != NULL);
                for (c = 0; c < s->level_nodes[s->wide - 1]; c++) {
                    if (k < 2 && s->code[c] == j) voxrti_store_u16(code + 2 * c, i);
                    if (k == 0 && s->code[c] == i) voxrti_store_u16(code + 2 * c, j);
                }
                if (k == 0) voxrti_store_u64(leaf + 8 * i, s->leaf[j]);
                if (k != 1) voxrti_store_u64(leaf + 8 * j, s->leaf[i]);
                voxrti_v5_seal(q, size);
                if (k == 0) CHECK(share_try_load(q, size));
                else alike += (size_t)share_try_load(q, size); /* the box may be another one */
            }
        }
    CHECK(alike > 4);
    free(q);
    free(p);
    voxrt_tree_destroy(s);
    voxrt_tree_destroy(t);
}

/* Nodes with children A B, A, and B: a run of them each. The second one names the begin of the first one's, the third
   one its end; nobody names the nodes that were theirs. */
TEST(runs_that_overlap) {
    cells c;
    voxrt_tree *t, *s;
    size_t size = 0, n = 0;
    uint32_t i, k, first[3] = {0, 0, 0}, count = 0;
    uint8_t *p, *q, *node;
    memset(&c, 0, sizeof c);
    share_add(&c, 0, 0, 0);
    share_add(&c, 255, 255, 255);
    for (i = 0; i < 3; i++) {
        if (i != 2) share_add(&c, 64 + 16 * i + 1, 64 + 2, 64 + 3);
        if (i != 1) share_add(&c, 64 + 16 * i + 4 + 2, 64 + 1, 64);
    }
    t = cells_tree(&c, NULL, 8);
    s = share(t);
    REQUIRE(t != NULL && s != NULL);
    for (i = s->level_first[s->wide - 2]; i < s->node_count; i++) /* the one with two children, and those behind it */
        if (count != 0 || voxrti_popcount64(s->node[i].mask) == 2)
            if (count < 3) first[count++] = i;
    REQUIRE(count == 3);
    p = share_save(s, 1, &size);
    q = (uint8_t *)malloc(size);
    REQUIRE(p != NULL && q != NULL);
    for (k = 0; k < 4; k++) {
        memcpy(q, p, size);
        node = section(q, 3, &n);
        REQUIRE(node != NULL);
        if (k & 1) voxrti_store_u32(node + 16 * first[1] + 8, s->node[first[0]].child);
        if (k & 2) voxrti_store_u32(node + 16 * first[2] + 8, s->node[first[0]].child + 1);
        voxrti_v5_seal(q, size);
        CHECK_EQ_U64(share_try_load(q, size), k == 0);
    }
    free(q);
    free(p);
    voxrt_tree_destroy(s);
    voxrt_tree_destroy(t);
}

/* ---- memory, threads, arguments ---- */

TEST(allocation_failures) {
    static const int kinds[3] = {1, 9, MANY};
    int which, what;
    for (which = 0; which < 3; which++) {
        voxrt_tree *t = share_make_tree(kinds[which], 1, 1), *s = share(t), *u;
        REQUIRE(t != NULL && s != NULL);
        for (what = 0; what < 6; what++) { /* share, unshare, save and load, compact and raw */
            size_t size = 0, out;
            uint8_t *p = share_save(s, what & 1, &size);
            int64_t k;
            if (which == 2 && what > 1) {
                free(p);
                continue;
            }
            REQUIRE(p != NULL);
            for (k = 0; k < 2000; k += which == 2 && test_quick() ? 5 : 1) {
                test_alloc ta;
                voxrt_env e;
                voxrt_save_desc sd;
                voxrt_load_desc ld;
                voxrt_result r;
                test_alloc_init(&ta);
                ta.fail_at = k;
                memset(&e, 0, sizeof e);
                memset(&sd, 0, sizeof sd);
                memset(&ld, 0, sizeof ld);
                e.allocator.alloc_fn = test_alloc_fn;
                e.allocator.free_fn = test_free_fn;
                e.allocator.user = &ta;
                e.thread_count = 1;
                sd.env = ld.env = e;
                sd.encoding = (voxrt_encoding)(what & 1);
                u = NULL;
                if (what == 0) r = voxrt_tree_share(t, &e, &u);
                else if (what == 1) r = voxrt_tree_unshare(s, &e, &u);
                else if (what < 4) r = voxrt_tree_save_memory(s, &sd, p, size, &out);
                else r = voxrt_tree_load_memory(&ld, p, size, &u);
                CHECK(r == (ta.failed ? VOXRT_ERR_NO_MEMORY : VOXRT_OK));
                CHECK((u != NULL) == (r == VOXRT_OK && (what < 2 || what > 3)));
                voxrt_tree_destroy(u);
                test_alloc_check(&ta);
                if (!ta.failed) break;
            }
            CHECK(k >= (what == 3 ? 1 : 5) && k < 300);
            free(p);
        }
        voxrt_tree_destroy(s);
        voxrt_tree_destroy(t);
    }
}

TEST(threads_and_arguments) {
    voxrt_tree *t = share_make_tree(6, 1, 1), *s = NULL, *one = NULL;
    voxrt_error error;
    voxrt_env e;
    REQUIRE(t != NULL);
    memset(&e, 0, sizeof e);
    e.thread_count = 1;
    CHECK(voxrt_tree_share(t, &e, &one) == VOXRT_OK);
    e.thread_count = 7;
    CHECK(voxrt_tree_share(t, &e, &s) == VOXRT_OK);
    CHECK(same_bytes(s, one, 0) && same_bytes(s, one, 1));
    voxrt_tree_destroy(s);
    voxrt_tree_destroy(one);
    e.error = &error;
    CHECK(voxrt_tree_share(t, &e, NULL) == VOXRT_ERR_INVALID_ARG);
    s = t;
    CHECK(voxrt_tree_share(NULL, &e, &s) == VOXRT_ERR_INVALID_ARG && s == NULL && error.code == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_tree_unshare(NULL, NULL, &s) == VOXRT_ERR_INVALID_ARG && s == NULL);
    e.memory_limit = 1000;
    CHECK(voxrt_tree_share(t, &e, &s) == VOXRT_ERR_NO_MEMORY && s == NULL && error.code == VOXRT_ERR_NO_MEMORY);
    voxrt_tree_destroy(t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(what_is_kept);
    RUN(many_masks);
    RUN(masks_that_collide);
    RUN(masks_that_collide_without_memory);
    RUN(same_cells);
    RUN(same_hits);
    RUN(same_picture_and_octree);
    RUN(files);
    RUN(damaged_files);
    RUN(wrong_values);
    RUN(runs_within_runs);
    RUN(other_orders);
    RUN(runs_that_overlap);
    RUN(allocation_failures);
    RUN(threads_and_arguments);
    return test_end();
}
