/* Trees from lists of voxels: what is read back, filling, level of detail, colours, memory, progress. The oracles are
   dense arrays and the definitions. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "shapes.h"
#include "voxel_list.h"

static voxrt_build_desc defaults(void) {
    voxrt_build_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    return d;
}

static voxrt_tree *tree_make(const voxrt_build_desc *d, const cells *l, uint32_t depth) {
    voxrt_tree *t = NULL;
    voxrt_result r = voxrt_tree_from_voxels(d, l->v, l->n, depth, &t);
    CHECK_EQ_U64(r, VOXRT_OK);
    CHECK((r == VOXRT_OK) == (t != NULL));
    return t;
}

static uint32_t pack(const voxrt_voxel *v) {
    return (uint32_t)v->rgb[0] | (uint32_t)v->rgb[1] << 8 | (uint32_t)v->rgb[2] << 16;
}

/* ---- reading back ---------------------------------------------------------------------------------------------- */

typedef struct walk {
    const voxrt_tree *t;
    const voxrt_tree_info *info;
    uint32_t level;
    uint64_t count, last;
    int wrong;
    uint64_t stop_after;
} walk;

static int walk_cell(void *user, const voxrt_voxel *v, uint32_t palette_index) {
    walk *w = (walk *)user;
    voxrt_voxel got;
    uint64_t key = voxrti_morton(v->x, v->y, v->z);
    uint32_t colors;
    const uint8_t *p = voxrt_tree_palette(w->t, &colors);
    if (w->count != 0 && key <= w->last) w->wrong |= 1;
    w->last = key;
    w->count++;
    if ((v->x | v->y | v->z) >> w->level) w->wrong |= 2;
    if (!voxrt_tree_get(w->t, w->level, v->x, v->y, v->z, &got)) w->wrong |= 4;
    else if (got.x != v->x || got.y != v->y || got.z != v->z || pack(&got) != pack(v) || got.has_normal != v->has_normal ||
             memcmp(got.normal, v->normal, sizeof got.normal) != 0) w->wrong |= 8;
    if (palette_index >= colors || memcmp(p + 3 * palette_index, v->rgb, 3) != 0) w->wrong |= 16;
    if (w->level != 0 && !voxrt_tree_get(w->t, w->level - 1, v->x / 2, v->y / 2, v->z / 2, NULL)) w->wrong |= 32;
    if (w->level != w->info->depth) { /* a cell is filled if and only if something below it is */
        uint32_t i, any = 0;
        for (i = 0; i < 8; i++)
            any |= (uint32_t)voxrt_tree_get(w->t, w->level + 1, 2 * v->x + (i & 1), 2 * v->y + (i >> 1 & 1), 2 * v->z + (i >> 2), NULL);
        if (!any) w->wrong |= 64;
    }
    if (v->has_normal != w->info->has_normals) w->wrong |= 128;
    if (v->has_normal) {
        double l = 0;
        for (colors = 0; colors < 3; colors++) l += (double)v->normal[colors] * (double)v->normal[colors];
        if (!(fabs(l - 1) < 1e-5)) w->wrong |= 256;
    } else if (v->normal[0] != 0 || v->normal[1] != 0 || v->normal[2] != 0) {
        w->wrong |= 512;
    }
    return w->stop_after != 0 && w->count == w->stop_after ? 77 : 0;
}

/* All levels: order, counts, what get() says, parents and children. */
static void check_tree(const voxrt_tree *t) {
    voxrt_tree_info info;
    uint32_t level;
    if (t == NULL) return;
    voxrt_tree_get_info(t, &info);
    for (level = 0; level <= info.depth; level++) {
        walk w;
        memset(&w, 0, sizeof w);
        w.t = t;
        w.info = &info;
        w.level = level;
        CHECK_EQ_U64(voxrt_tree_each(t, level, walk_cell, &w), 0);
        CHECK_MSG(w.wrong == 0, "level %u: fault %d", level, w.wrong);
        CHECK_EQ_U64(w.count, info.level_count[level]);
    }
    CHECK_EQ_U64(info.level_count[0], 1);
    CHECK_EQ_U64(info.level_count[info.depth], info.voxel_count);
    CHECK_EQ_U64(voxrt_tree_each(t, info.depth + 1, walk_cell, NULL), 0);
    CHECK_EQ_U64(voxrt_tree_get(t, info.depth + 1, 0, 0, 0, NULL), 0);
    CHECK_EQ_U64(voxrt_tree_get(t, 0, 1, 0, 0, NULL), 0);
    CHECK(info.total_bytes >= info.geometry_bytes + info.color_bytes + info.normal_bytes);
}

TEST(random_voxels) {
    static const uint32_t depths[10] = {1, 2, 3, 4, 5, 6, 7, 12, 19, 20};
    uint32_t k;
    for (k = 0; k < 20; k++) {
        test_rng rng = test_rng_make(k);
        uint32_t depth = depths[k % 10], n = k < 10 ? 300 : 1 + test_rng_below(&rng, 20), i, j, side = 1u << depth;
        uint32_t lo[3] = {0xffffffffu, 0xffffffffu, 0xffffffffu}, hi[3] = {0, 0, 0}, unique = 0;
        cells l;
        voxrt_build_desc d = defaults();
        voxrt_tree *t;
        voxrt_tree_info info;
        memset(&l, 0, sizeof l);
        for (i = 0; i < n; i++) {
            uint32_t c[3], a, again = 0;
            for (a = 0; a < 3; a++) c[a] = test_rng_below(&rng, i % 3 ? side : side < 9 ? side : 9);
            if (i == 5) c[0] = c[1] = c[2] = side - 1;
            for (j = 0; j < i; j++) again |= l.v[j].x == c[0] && l.v[j].y == c[1] && l.v[j].z == c[2];
            unique += !again;
            cells_add(&l, c[0], c[1], c[2], test_rng_below(&rng, 5) * 0x102030u);
            if (k & 1) cells_normal(&l, test_rng_double(&rng) - 0.5, test_rng_double(&rng) - 0.5, 0.2);
            for (a = 0; a < 3; a++) {
                lo[a] = c[a] < lo[a] ? c[a] : lo[a];
                hi[a] = c[a] + 1 > hi[a] ? c[a] + 1 : hi[a];
            }
        }
        t = tree_make(&d, &l, depth);
        check_tree(t);
        voxrt_tree_get_info(t, &info);
        CHECK_EQ_U64(info.voxel_count, unique);
        CHECK_EQ_U64(info.depth, depth);
        CHECK_EQ_U64(info.resolution, side);
        CHECK_NEAR(info.voxel_size, 1, 0);
        for (j = 0; j < 3; j++) {
            CHECK_EQ_U64(info.cell_min[j], lo[j]);
            CHECK_EQ_U64(info.cell_max[j], hi[j]);
        }
        for (i = 0; i < n; i++) CHECK(voxrt_tree_get(t, depth, l.v[i].x, l.v[i].y, l.v[i].z, NULL));
        if (depth <= 5) { /* and nothing else */
            uint32_t x, y, z, filled = 0;
            for (z = 0; z < side; z++)
                for (y = 0; y < side; y++)
                    for (x = 0; x < side; x++) filled += (uint32_t)voxrt_tree_get(t, depth, x, y, z, NULL);
            CHECK_EQ_U64(filled, unique);
        }
        { /* the order of the list does not matter */
            uint64_t h = voxrt_tree_hash(t);
            voxrt_tree *again;
            for (i = n; i > 1; i--) {
                uint32_t q = test_rng_below(&rng, i);
                voxrt_voxel x = l.v[q];
                l.v[q] = l.v[i - 1];
                l.v[i - 1] = x;
            }
            d.env.thread_count = 3;
            again = tree_make(&d, &l, depth);
            CHECK(voxrt_tree_hash(again) == h);
            voxrt_tree_destroy(again);
            l.v[0].rgb[1] ^= 255; /* and one colour does */
            if (n > 1) {
                again = tree_make(&d, &l, depth);
                CHECK(voxrt_tree_hash(again) != h);
                voxrt_tree_destroy(again);
            }
        }
        voxrt_tree_destroy(t);
        cells_free(&l);
    }
}

TEST(each_can_stop) {
    cells l;
    voxrt_build_desc d = defaults();
    voxrt_tree *t;
    voxrt_tree_info info;
    walk w;
    uint32_t i;
    memset(&l, 0, sizeof l);
    for (i = 0; i < 100; i++) cells_add(&l, i % 16, i / 16, i % 7, 0);
    t = tree_make(&d, &l, 4);
    voxrt_tree_get_info(t, &info);
    memset(&w, 0, sizeof w);
    w.t = t;
    w.info = &info;
    w.level = 4;
    w.stop_after = 13;
    CHECK_EQ_U64(voxrt_tree_each(t, 4, walk_cell, &w), 77);
    CHECK_EQ_U64(w.count, 13);
    CHECK_EQ_U64(voxrt_tree_each(t, 4, NULL, NULL), 0);
    CHECK_EQ_U64(voxrt_tree_each(NULL, 0, walk_cell, &w), 0);
    CHECK_EQ_U64(voxrt_tree_get(NULL, 0, 0, 0, 0, NULL), 0);
    CHECK_EQ_U64(voxrt_tree_hash(NULL), 0);
    voxrt_tree_destroy(t);
    voxrt_tree_destroy(NULL);
    cells_free(&l);
}

/* The same colours and normals in other places, one cell elsewhere, another place in the world: other hashes. */
TEST(hash_sees_everything) {
    uint64_t h[6];
    int k, i;
    for (k = 0; k < 6; k++) {
        cells l;
        voxrt_build_desc d = defaults();
        voxrt_tree *t;
        memset(&l, 0, sizeof l);
        cells_add(&l, 0, 0, 0, k == 1 ? 0x0000ff : 0xff0000);
        cells_normal(&l, k == 2, k != 2, 0);
        cells_add(&l, 7, k == 3 ? 6 : 7, 7, k == 1 ? 0xff0000 : 0x0000ff);
        cells_normal(&l, k != 2, k == 2, 0);
        d.box_size = k == 4 ? 16 : 8;
        d.box_min[1] = k == 5;
        t = tree_make(&d, &l, 3);
        h[k] = voxrt_tree_hash(t);
        for (i = 0; i < k; i++) CHECK_MSG(h[i] != h[k], "%d and %d", i, k);
        voxrt_tree_destroy(t);
        cells_free(&l);
    }
}

TEST(from_voxels_arguments) {
    cells l;
    voxrt_build_desc d = defaults();
    voxrt_tree *t = (voxrt_tree *)&l;
    voxrt_tree_info info;
    voxrt_error e;
    uint32_t k;
    memset(&l, 0, sizeof l);
    memset(&e, 0, sizeof e);
    d.env.error = &e;
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, NULL, 0, 4, &t), VOXRT_ERR_EMPTY);
    CHECK(t == NULL && e.code == VOXRT_ERR_EMPTY);
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, NULL, 1, 4, &t), VOXRT_ERR_INVALID_ARG);
    for (k = 0; k < 10; k++) cells_add(&l, k, 0, 0, 0);
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 4, NULL), VOXRT_ERR_INVALID_ARG);
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 0, &t), VOXRT_ERR_RANGE);
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 21, &t), VOXRT_ERR_RANGE);
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 3, &t), VOXRT_ERR_RANGE);
    CHECK_EQ_U64(e.where, 8);
    CHECK(t == NULL && e.code == VOXRT_ERR_RANGE && e.text[0] != 0);
    d.box_size = 32;
    d.box_min[2] = -5;
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 4, &t), VOXRT_OK);
    voxrt_tree_get_info(t, &info);
    CHECK_NEAR(info.voxel_size, 2, 0);
    CHECK_NEAR(info.world_origin[2], -5, 0);
    voxrt_tree_destroy(t);
    for (k = 0; k < 2; k++) { /* garbage in the desc: refused before any pointer in it is used */
        memset(&d, k ? 0 : 0x5a, sizeof d);
        if (k) d._end_zero = 1;
        CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 4, &t), VOXRT_ERR_UNINIT_DESC);
        CHECK(t == NULL);
        {
            voxrt_mesh m;
            memset(&m, 0, sizeof m);
            CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_ERR_UNINIT_DESC);
        }
    }
    d = defaults();
    d.palette_size = 16777217;
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 4, &t), VOXRT_ERR_RANGE);
    d = defaults();
    d.lod_method = (voxrt_lod_method)2;
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 4, &t), VOXRT_ERR_INVALID_ARG);
    d = defaults();
    d.env.allocator.alloc_fn = test_alloc_fn; /* one without the other */
    CHECK_EQ_U64(voxrt_tree_from_voxels(&d, l.v, l.n, 4, &t), VOXRT_ERR_INVALID_ARG);
    cells_free(&l);
}

/* ---- filling ----------------------------------------------------------------------------------------------------- */

/* Dense flood from the border through faces; then layers from the surface inwards. */
typedef struct dense { uint32_t n; uint8_t *wall, *out; uint16_t *layer; } dense;

static size_t tree_at(uint32_t n, uint32_t x, uint32_t y, uint32_t z) { return ((size_t)z * n + y) * n + x; }

static int neighbour(uint32_t n, size_t i, uint32_t face, size_t *k) { /* 0: beyond the border */
    uint32_t c[3], a = face / 2;
    c[0] = (uint32_t)(i % n);
    c[1] = (uint32_t)(i / n % n);
    c[2] = (uint32_t)(i / n / n);
    if (face & 1 ? c[a] + 1 == n : c[a] == 0) return 0;
    c[a] += face & 1 ? 1u : 0xffffffffu;
    *k = tree_at(n, c[0], c[1], c[2]);
    return 1;
}

static dense dense_make(uint32_t n) {
    dense g;
    g.n = n;
    g.wall = (uint8_t *)calloc((size_t)n * n * n, 1);
    g.out = (uint8_t *)calloc((size_t)n * n * n, 1);
    g.layer = (uint16_t *)calloc((size_t)n * n * n, 2);
    if (g.wall == NULL || g.out == NULL || g.layer == NULL) abort();
    return g;
}

static void dense_free(dense *g) {
    free(g->wall);
    free(g->out);
    free(g->layer);
}

/* layer: 0 surface, k: k steps through faces inside, 0xffff: outside */
static void dense_fill(dense *g) {
    size_t total = (size_t)g->n * g->n * g->n, i, k, head = 0, tail = 0;
    uint32_t *queue = (uint32_t *)malloc(total * 4), f;
    if (queue == NULL) abort();
    memset(g->out, 0, total);
    for (i = 0; i < total; i++) {
        int border = 0;
        for (f = 0; f < 6; f++) border |= !neighbour(g->n, i, f, &k);
        if (border && !g->wall[i]) {
            g->out[i] = 1;
            queue[tail++] = (uint32_t)i;
        }
    }
    while (head < tail) {
        i = queue[head++];
        for (f = 0; f < 6; f++)
            if (neighbour(g->n, i, f, &k) && !g->wall[k] && !g->out[k]) {
                g->out[k] = 1;
                queue[tail++] = (uint32_t)k;
            }
    }
    head = tail = 0;
    for (i = 0; i < total; i++) {
        g->layer[i] = 0xffff;
        if (g->wall[i]) {
            g->layer[i] = 0;
            queue[tail++] = (uint32_t)i;
        }
    }
    while (head < tail) {
        i = queue[head++];
        for (f = 0; f < 6; f++)
            if (neighbour(g->n, i, f, &k) && g->layer[k] == 0xffff && !g->out[k]) {
                g->layer[k] = (uint16_t)(g->layer[i] + 1);
                queue[tail++] = (uint32_t)k;
            }
    }
    free(queue);
}

/* The walls as a list, each with its own colour and normal, filled to `depth_limit`; compared with the oracle. */
static void check_fill(dense *g, uint32_t tree_depth, uint32_t depth_limit, const char *what, size_t expect_inner) {
    cells l;
    voxrt_build_desc d = defaults();
    voxrt_tree *t;
    size_t total = (size_t)g->n * g->n * g->n, i, inner = 0, wrong = 0, colour = 0;
    memset(&l, 0, sizeof l);
    dense_fill(g);
    for (i = 0; i < total; i++) {
        if (!g->wall[i]) continue;
        cells_add(&l, (uint32_t)(i % g->n), (uint32_t)(i / g->n % g->n), (uint32_t)(i / g->n / g->n),
                 (uint32_t)((i * 2654435761u) >> 7) & 0xffffffu);
        cells_normal(&l, (double)(i % 5) - 2, (double)(i % 7) - 3, (double)(i % 3) - 0.5);
    }
    d.fill = 1;
    d.fill_depth = depth_limit;
    d.palette_size = 1u << 24;
    t = tree_make(&d, &l, tree_depth);
    for (i = 0; t != NULL && i < total; i++) {
        voxrt_voxel v, w;
        uint32_t x = (uint32_t)(i % g->n), y = (uint32_t)(i / g->n % g->n), z = (uint32_t)(i / g->n / g->n), f;
        int want = g->layer[i] != 0xffff && (depth_limit == 0 || g->layer[i] <= depth_limit), ok = 0;
        size_t k;
        if (voxrt_tree_get(t, tree_depth, x, y, z, &v) != want) {
            wrong++;
            continue;
        }
        if (!want || g->layer[i] == 0) {
            if (want && pack(&v) != ((uint32_t)((i * 2654435761u) >> 7) & 0xffffffu)) colour++;
            continue;
        }
        inner++; /* what it has comes from a neighbour that is one step nearer to the surface */
        for (f = 0; f < 6 && !ok; f++) {
            if (!neighbour(g->n, i, f, &k) || g->layer[k] + 1 != g->layer[i]) continue;
            (void)voxrt_tree_get(t, tree_depth, (uint32_t)(k % g->n), (uint32_t)(k / g->n % g->n), (uint32_t)(k / g->n / g->n), &w);
            ok = pack(&w) == pack(&v) && memcmp(w.normal, v.normal, sizeof v.normal) == 0;
        }
        colour += !ok;
    }
    CHECK_MSG(wrong == 0, "%s, depth %u, limit %u: %u wrong cells", what, tree_depth, depth_limit, (unsigned)wrong);
    CHECK_MSG(colour == 0, "%s, depth %u, limit %u: %u wrong colours", what, tree_depth, depth_limit, (unsigned)colour);
    if (expect_inner != (size_t)-1) CHECK_MSG(inner == expect_inner, "%s: %u inside, not %u", what, (unsigned)inner, (unsigned)expect_inner);
    if (t != NULL) {
        voxrt_tree_info info;
        size_t count = 0;
        voxrt_tree_get_info(t, &info);
        for (i = 0; i < total; i++) count += g->layer[i] != 0xffff && (depth_limit == 0 || g->layer[i] <= depth_limit);
        CHECK_EQ_U64(info.voxel_count, count);
    }
    voxrt_tree_destroy(t);
    cells_free(&l);
}

static void shell(dense *g, uint32_t x0, uint32_t y0, uint32_t z0, uint32_t x1, uint32_t y1, uint32_t z1) {
    uint32_t x, y, z;
    for (z = z0; z <= z1; z++)
        for (y = y0; y <= y1; y++)
            for (x = x0; x <= x1; x++)
                if (x == x0 || x == x1 || y == y0 || y == y1 || z == z0 || z == z1) g->wall[tree_at(g->n, x, y, z)] = 1;
}

TEST(fill_boxes) {
    static const uint32_t sides[7][2] = {{2, 1}, {4, 2}, {8, 3}, {16, 4}, {24, 5}, {32, 5}, {50, 6}}; /* cells, depth */
    uint32_t k;
    for (k = 0; k < 7; k++) {
        uint32_t n = sides[k][0], depth = sides[k][1], e = n - 1, limit;
        dense g = dense_make(n);
        size_t inner = n > 2 ? (size_t)(n - 2) * (n - 2) * (n - 2) : 0;
        shell(&g, 0, 0, 0, e, e, e); /* the hull is on the border of the grid */
        check_fill(&g, depth, 0, "box on the border", inner);
        for (limit = 1; limit < 4; limit++) check_fill(&g, depth, limit, "box, layers", (size_t)-1);
        if (n > 2) { /* a hole of one voxel */
            g.wall[tree_at(n, e, n / 2, n / 2)] = 0;
            check_fill(&g, depth, 0, "box with a hole", 0);
            g.wall[tree_at(n, e, n / 2, n / 2)] = 1;
            g.wall[tree_at(n, 0, 0, 0)] = g.wall[tree_at(n, e, e, e)] = g.wall[tree_at(n, 0, e, 0)] = 0; /* corners and an edge: tight */
            g.wall[tree_at(n, n / 2, 0, 0)] = 0;
            check_fill(&g, depth, 0, "box without corners", inner);
        }
        dense_free(&g);
    }
}

TEST(fill_nested_and_touching) {
    dense g = dense_make(64);
    uint32_t x, y;
    shell(&g, 3, 5, 2, 60, 50, 61);
    shell(&g, 10, 12, 9, 40, 44, 51); /* inside of the first: all of it is filled */
    check_fill(&g, 6, 0, "nested", (size_t)-1);
    check_fill(&g, 6, 2, "nested, two layers", (size_t)-1);
    for (x = 3; x <= 60; x++)
        for (y = 5; y <= 50; y++)
            if (x > 3 && x < 60 && y > 5 && y < 50) g.wall[tree_at(64, x, y, 2)] = 0; /* open below: the inner one is closed */
    check_fill(&g, 6, 0, "nested, outer one open", (size_t)29 * 31 * 41);
    dense_free(&g);
}

static void tree_ball(dense *g, double cx, double cy, double cz, double ring, double r) { /* cells that the surface passes */
    uint32_t x, y, z, n = g->n, f;
    uint8_t *in = (uint8_t *)calloc((size_t)n * n * n, 1);
    size_t i, k;
    if (in == NULL) abort();
    for (z = 0; z < n; z++)
        for (y = 0; y < n; y++)
            for (x = 0; x < n; x++) {
                double px = x - cx, py = y - cy, pz = z - cz, q = sqrt(px * px + py * py) - ring;
                in[tree_at(n, x, y, z)] = ring > 0 ? sqrt(q * q + pz * pz) < r : sqrt(px * px + py * py + pz * pz) < r;
            }
    for (i = 0; i < (size_t)n * n * n; i++)
        for (f = 0; in[i] && f < 6; f++)
            if (!neighbour(n, i, f, &k) || !in[k]) g->wall[i] = 1; /* 6-separating, in diagonal steps */
    free(in);
}

TEST(fill_round_hulls) {
    dense g = dense_make(64);
    tree_ball(&g, 31.2, 30.7, 32.4, 0, 28.3);
    check_fill(&g, 6, 0, "ball", (size_t)-1);
    check_fill(&g, 6, 5, "ball, five layers", (size_t)-1);
    tree_ball(&g, 31.2, 30.7, 32.4, 0, 15.5);
    tree_ball(&g, 31.2, 30.7, 32.4, 0, 6.5);
    check_fill(&g, 6, 0, "nested balls", (size_t)-1);
    dense_free(&g);
    g = dense_make(72);
    tree_ball(&g, 35.2, 34.7, 36.4, 22.5, 10.2);
    check_fill(&g, 7, 0, "torus", (size_t)-1);
    { /* one voxel less: it all runs out */
        size_t i;
        for (i = 0; i < (size_t)72 * 72 * 72; i++)
            if (g.wall[i]) {
                uint32_t f, inner = 0;
                size_t k;
                dense_fill(&g);
                for (f = 0; f < 6; f++) inner |= neighbour(72, i, f, &k) && !g.wall[k] && !g.out[k];
                if (!inner) continue;
                g.wall[i] = 0;
                break;
            }
    }
    check_fill(&g, 7, 0, "torus with a hole", 0);
    dense_free(&g);
}

/* Anything: random walls of many densities, in sizes that are not multiples of a block, corridors through blocks. */
TEST(fill_random) {
    uint32_t k, rounds = test_quick() ? 12 : 40;
    for (k = 0; k < rounds; k++) {
        test_rng rng = test_rng_make(4000 + k);
        uint32_t depth = 1 + k % 6, n = (1u << depth) - test_rng_below(&rng, depth > 2 ? 7 : 1), full = 20 + test_rng_below(&rng, 75);
        dense g = dense_make(n);
        size_t i, total = (size_t)n * n * n;
        for (i = 0; i < total; i++) g.wall[i] = test_rng_below(&rng, 100) < full;
        if (k % 2 == 0) { /* blocks of 4 and 16 that are all wall or all empty */
            for (i = 0; i < total; i++) {
                uint32_t s = k % 4 ? 2 : 4, x = (uint32_t)(i % n) >> s, y = (uint32_t)(i / n % n) >> s, z = (uint32_t)(i / n / n) >> s;
                uint32_t h = (x * 73856093u ^ y * 19349663u ^ z * 83492791u ^ k * 2971215073u) >> 7;
                if (h % 4 != 0) g.wall[i] = h % 4 == 1;
            }
        }
        for (i = 0; i < total && !g.wall[i]; i++) {}
        if (i < total) {
            check_fill(&g, depth, 0, "random", (size_t)-1);
            if (k % 3 == 0) check_fill(&g, depth, 1 + k % 4, "random, layers", (size_t)-1);
        }
        dense_free(&g);
    }
}

static int count_cell(void *user, const voxrt_voxel *v, uint32_t palette_index) {
    (void)v;
    (void)palette_index;
    ++*(uint64_t *)user;
    return 0;
}

/* Meshes: the volume of what is filled. Leaves nothing of thousands of empty blocks in a large grid. */
/* Deeper than filling goes: refused before there is a voxel. */
static void fill_is_for_shallow_grids(const cells *l) {
    static const float corner[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    static const uint32_t resolution[3] = {16385, 65536, 16384};
    voxrt_mesh m;
    int k;
    memset(&m, 0, sizeof m);
    m.positions = corner;
    m.vertex_count = 3;
    m.triangle_count = 1;
    for (k = 0; k < 5; k++) {
        voxrt_build_desc d = defaults();
        voxrt_error e;
        voxrt_tree *t = NULL;
        test_alloc ta;
        voxrt_result r;
        memset(&e, 0, sizeof e);
        test_alloc_init(&ta);
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        d.env.error = &e;
        d.env.memory_limit = (size_t)1 << 26; /* depth 14 is for those who have 8 GB for the inside of the grid */
        d.fill = 1;
        if (k < 3) {
            d.resolution = resolution[k];
            d.box_size = k < 2 ? 0 : 4096;
            r = voxrt_tree_build(&d, &m, NULL, &t);
        } else {
            r = voxrt_tree_from_voxels(&d, l->v, l->n, k == 3 ? 15 : 14, &t);
        }
        CHECK_MSG(r == (k == 2 || k == 4 ? VOXRT_ERR_NO_MEMORY : VOXRT_ERR_RANGE) && t == NULL, "%d: result %d", k, (int)r);
        if (r == VOXRT_ERR_RANGE) CHECK(ta.count == 0 && e.code == r && e.where == (k == 1 ? 16 : 15) && strstr(e.text, "fill") != NULL);
        test_alloc_check(&ta);
    }
}

TEST(fill_meshes) {
    shape s;
    voxrt_mesh m;
    voxrt_build_desc d = defaults();
    voxrt_tree *t = NULL;
    voxrt_build_stats st;
    voxrt_tree_info info;
    const double pi = 3.14159265358979323846;
    uint32_t k;
    for (k = 0; k < 4; k++) {
        double volume = 0, turn[9];
        memset(&s, 0, sizeof s);
        shape_rotation(0.3, 0.2 + k * 0.1, 0.7, turn);
        if (k == 0) {
            shape_sphere(&s, 0, 0, 0, 60, 80);
            volume = 4 / 3.0 * pi * 60 * 60 * 60;
        } else if (k == 1) {
            shape_torus(&s, 0, 0, 0, 40, 15, 150, 60);
            volume = 2 * pi * pi * 40 * 15 * 15;
        } else if (k == 2) {
            shape_box(&s, -30, -35, -40, 30, 35, 40);
            volume = 60 * 70 * 80;
        } else {
            shape_sphere(&s, 0, 0, 0, 50, 60);
            s.triangles -= 40; /* open */
        }
        shape_place(&s, turn, 64.2, 63.9, 64.5);
        m.positions = NULL;
        memset(&m, 0, sizeof m);
        m.positions = s.p;
        m.vertex_count = s.vertices;
        m.indices = s.t;
        m.triangle_count = s.triangles;
        d.resolution = 128;
        d.box_size = 128;
        d.fill = 1;
        CHECK_EQ_U64(voxrt_tree_build(&d, &m, &st, &t), VOXRT_OK);
        if (k == 1) check_tree(t);
        voxrt_tree_get_info(t, &info);
        CHECK_EQ_U64(st.voxels, info.voxel_count);
        if (k < 3) CHECK_MSG(fabs((double)st.voxels / volume - 1) < 0.06, "%u: %u instead of %.0f", k, (unsigned)st.voxels, volume);
        voxrt_tree_destroy(t);
        if (k == 3) {
            uint64_t closed = st.voxels;
            d.fill = 0;
            CHECK_EQ_U64(voxrt_tree_build(&d, &m, &st, &t), VOXRT_OK);
            CHECK_EQ_U64(closed, st.voxels);
            voxrt_tree_destroy(t);
        }
        shape_free(&s);
    }
    { /* a box of 8 cells in a grid of 1024^3 */
        cells l;
        dense g = dense_make(8);
        uint64_t n = 0;
        size_t i;
        memset(&l, 0, sizeof l);
        shell(&g, 0, 0, 0, 7, 7, 7);
        for (i = 0; i < 512; i++)
            if (g.wall[i]) cells_add(&l, 509 + (uint32_t)(i % 8), 1016 + (uint32_t)(i / 8 % 8), (uint32_t)(i / 64), 0);
        d = defaults();
        d.fill = 1;
        t = tree_make(&d, &l, 10);
        (void)voxrt_tree_each(t, 10, count_cell, &n);
        CHECK_EQ_U64(n, 512);
        voxrt_tree_destroy(t);
        fill_is_for_shallow_grids(&l);
        dense_free(&g);
        cells_free(&l);
    }
}

/* ---- level of detail ------------------------------------------------------------------------------------------------- */

static double tree_to_linear(uint32_t byte) {
    double c = byte / 255.0;
    return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4);
}

static uint32_t to_byte(double l) { return (uint32_t)(255 * (l <= 0.0031308 ? l * 12.92 : 1.055 * pow(l, 1 / 2.4) - 0.055) + 0.5); }

TEST(lod_mean) { /* weighted by leaves, in linear light; leaves of depth 3 */
    cells l;
    voxrt_build_desc d = defaults();
    voxrt_tree *t;
    voxrt_voxel v;
    uint32_t i;
    memset(&l, 0, sizeof l);
    for (i = 0; i < 8; i++) { /* octant 0: eight red leaves in one parent */
        cells_add(&l, i & 1, i >> 1 & 1, i >> 2, 0x0000ff);
        cells_normal(&l, 1, 0, 0);
    }
    cells_add(&l, 2, 0, 0, 0xff0000); /* beside it one blue leaf */
    cells_normal(&l, 0, 1, 0);
    cells_add(&l, 7, 7, 7, 0x00ff00); /* far off a green one, its normal cancels the blue one's */
    cells_normal(&l, 0, -1, 0);
    t = tree_make(&d, &l, 3);
    check_tree(t);
    REQUIRE(t != NULL);
    CHECK(voxrt_tree_get(t, 2, 0, 0, 0, &v) && pack(&v) == 0x0000ff);
    CHECK(voxrt_tree_get(t, 2, 1, 0, 0, &v) && pack(&v) == 0xff0000);
    CHECK_NEAR(v.normal[1], 1, 1e-4);
    CHECK(voxrt_tree_get(t, 1, 0, 0, 0, &v));
    CHECK_MSG(pack(&v) == (to_byte(8 / 9.0) | to_byte(1 / 9.0) << 16), "%06x", pack(&v));
    CHECK_NEAR(v.normal[0], 8 / sqrt(65.0), 0.01);
    CHECK_NEAR(v.normal[1], 1 / sqrt(65.0), 0.015);
    CHECK(voxrt_tree_get(t, 1, 1, 1, 1, &v) && pack(&v) == 0x00ff00);
    CHECK(!voxrt_tree_get(t, 1, 1, 0, 0, &v));
    CHECK(voxrt_tree_get(t, 0, 0, 0, 0, &v));
    CHECK_MSG(pack(&v) == (to_byte(0.8) | to_byte(0.1) << 8 | to_byte(0.1) << 16), "%06x", pack(&v));
    CHECK_NEAR(v.normal[0], 1, 1e-4);
    voxrt_tree_destroy(t);
    cells_free(&l);
}

/* Random trees against sums over the leaves below a cell. */
TEST(lod_mean_random) {
    uint32_t k;
    for (k = 0; k < 8; k++) {
        test_rng rng = test_rng_make(60 + k);
        uint32_t depth = 2 + k, n = 40 + 100 * k, i, level, side = 1u << depth;
        cells l;
        voxrt_build_desc d = defaults();
        voxrt_tree *t;
        uint8_t *used;
        memset(&l, 0, sizeof l);
        used = (uint8_t *)calloc((size_t)side * side * side, 1);
        if (used == NULL) abort();
        for (i = 0; i < n; i++) {
            uint32_t x = test_rng_below(&rng, side), y = test_rng_below(&rng, 1 + side / 4), z = test_rng_below(&rng, 1 + side / 8);
            if (used[tree_at(side, x, y, z)]) continue;
            used[tree_at(side, x, y, z)] = 1;
            cells_add(&l, x, y, z, test_rng_u32(&rng) & 0xffffffu);
            cells_normal(&l, test_rng_double(&rng) - 0.3, test_rng_double(&rng) - 0.3, test_rng_double(&rng) - 0.3);
        }
        d.palette_size = 1u << 24;
        t = tree_make(&d, &l, depth);
        check_tree(t);
        for (level = 0; t != NULL && level < depth; level++) {
            uint32_t q, shift = depth - level;
            for (q = 0; q < l.n; q += 7) {
                uint32_t x = l.v[q].x >> shift, y = l.v[q].y >> shift, z = l.v[q].z >> shift, a, count = 0;
                double rgb[3] = {0, 0, 0}, normal[3] = {0, 0, 0}, length = 0, dot = 0;
                voxrt_voxel v;
                for (i = 0; i < l.n; i++) {
                    const voxrt_voxel *e = &l.v[i];
                    double s = 0;
                    if (e->x >> shift != x || e->y >> shift != y || e->z >> shift != z) continue;
                    for (a = 0; a < 3; a++) s += (double)e->normal[a] * (double)e->normal[a];
                    for (a = 0; a < 3; a++) {
                        rgb[a] += tree_to_linear(e->rgb[a]);
                        normal[a] += (double)e->normal[a] / sqrt(s);
                    }
                    count++;
                }
                CHECK(voxrt_tree_get(t, level, x, y, z, &v));
                for (a = 0; a < 3; a++) {
                    CHECK_MSG(fabs((double)v.rgb[a] - to_byte(rgb[a] / count)) <= 1, "%u is not %u", v.rgb[a], to_byte(rgb[a] / count));
                    length += normal[a] * normal[a];
                    dot += normal[a] * (double)v.normal[a];
                }
                if (length > 0.25 * count * count)
                    CHECK_MSG(dot / sqrt(length) > cos(2.5 / 57.29578), "%.2f degrees", 57.29578 * acos(dot / sqrt(length)));
            }
        }
        free(used);
        voxrt_tree_destroy(t);
        cells_free(&l);
    }
}

TEST(lod_majority) {
    cells l;
    voxrt_build_desc d = defaults();
    voxrt_tree *t;
    voxrt_voxel v;
    uint32_t i, count;
    const uint8_t *palette;
    memset(&l, 0, sizeof l);
    d.lod_method = VOXRT_LOD_MAJORITY;
    /* parent (0,0,0): three of A, two of B, one of C */
    for (i = 0; i < 6; i++) cells_add(&l, i & 1, i >> 1 & 1, i >> 2, i < 3 ? 0xaaaaaa : i < 5 ? 0xbbbbbb : 0xcccccc);
    /* parent (1,0,0): a tie of A and B, one each: the lower index of the palette */
    cells_add(&l, 2, 0, 0, 0xbbbbbb);
    cells_add(&l, 3, 0, 0, 0xaaaaaa);
    /* parent (0,1,0): B alone, 8 times */
    for (i = 0; i < 8; i++) cells_add(&l, i & 1, 2 + (i >> 1 & 1), i >> 2, 0xbbbbbb);
    /* the grandparents (4.., 0, 0): two of A with one leaf each, two of C with eight: a tie by votes, C by weight */
    cells_add(&l, 4, 0, 0, 0xaaaaaa);
    cells_add(&l, 6, 0, 0, 0xaaaaaa);
    for (i = 0; i < 8; i++) cells_add(&l, 4 + (i & 1), 2 + (i >> 1 & 1), i >> 2, 0xcccccc);
    for (i = 0; i < 8; i++) cells_add(&l, 6 + (i & 1), 2 + (i >> 1 & 1), i >> 2, 0xcccccc);
    t = tree_make(&d, &l, 3);
    check_tree(t);
    REQUIRE(t != NULL);
    palette = voxrt_tree_palette(t, &count);
    CHECK_EQ_U64(count, 3);
    CHECK(voxrt_tree_get(t, 2, 0, 0, 0, &v) && pack(&v) == 0xaaaaaa);
    CHECK(voxrt_tree_get(t, 2, 0, 1, 0, &v) && pack(&v) == 0xbbbbbb);
    CHECK(voxrt_tree_get(t, 2, 1, 0, 0, &v));
    for (i = 0; i < count && palette[3 * i] != 0xaa && palette[3 * i] != 0xbb; i++) {}
    CHECK_EQ_U64(v.rgb[0], palette[3 * i]);
    CHECK(voxrt_tree_get(t, 1, 1, 0, 0, &v));
    CHECK_MSG(pack(&v) == 0xcccccc, "%06x", pack(&v));
    voxrt_tree_destroy(t);
    cells_free(&l);
}

TEST(lod_opposite_normals) { /* they cancel: one of them, never zero or NaN; twenty levels deep */
    int method;
    for (method = 0; method < 2; method++) {
        uint32_t depth;
        for (depth = 1; depth <= 20; depth += depth < 4 ? 1 : 4) {
            cells l;
            voxrt_build_desc d = defaults();
            voxrt_tree *t;
            uint32_t i, level, side = 1u << depth;
            memset(&l, 0, sizeof l);
            d.lod_method = (voxrt_lod_method)method;
            for (i = 0; i < 6; i++) {
                cells_add(&l, i & 1 ? side - 1 : 0, i & 2 ? side - 1 : 0, i & 4 ? side - 1 : 0, i * 0x202020u);
                cells_normal(&l, i / 2 == 0 ? (i & 1 ? 1 : -1) : 0, i / 2 == 1 ? (i & 1 ? 1 : -1) : 0, i / 2 == 2 ? (i & 1 ? 1 : -1) : 0);
            }
            t = tree_make(&d, &l, depth);
            check_tree(t); /* checks the length of all normals */
            for (level = 0; t != NULL && level <= depth; level++) {
                voxrt_voxel v;
                CHECK(voxrt_tree_get(t, level, 0, 0, 0, &v));
                CHECK(fabsf(v.normal[0]) + fabsf(v.normal[1]) + fabsf(v.normal[2]) < 1.02f); /* along an axis */
            }
            voxrt_tree_destroy(t);
            cells_free(&l);
        }
    }
}

TEST(same_voxel_twice) { /* the means are kept */
    cells l;
    voxrt_build_desc d = defaults();
    voxrt_tree *t;
    voxrt_voxel v;
    memset(&l, 0, sizeof l);
    cells_add(&l, 5, 6, 7, 0x0000ff);
    cells_normal(&l, 1, 0, 0);
    cells_add(&l, 1, 1, 1, 0x123456);
    cells_normal(&l, 0, 0, 2);
    cells_add(&l, 5, 6, 7, 0xff0000);
    cells_normal(&l, 0, 1, 0);
    t = tree_make(&d, &l, 3);
    REQUIRE(t != NULL);
    CHECK(voxrt_tree_get(t, 3, 5, 6, 7, &v));
    CHECK_MSG(pack(&v) == 0xbc00bc, "%06x", pack(&v));
    CHECK_NEAR(v.normal[0], 0.7071, 0.012);
    CHECK_NEAR(v.normal[1], 0.7071, 0.012);
    CHECK(voxrt_tree_get(t, 3, 1, 1, 1, &v) && pack(&v) == 0x123456);
    CHECK_NEAR(v.normal[2], 1, 1e-4);
    voxrt_tree_destroy(t);
    cells_free(&l);
}

/* Normals need not be unit, also where there is more than one. */
TEST(same_voxel_twice_with_any_normals) {
    static const float length[6] = {1e-30f, 1e-5f, 0.5f, 3.0f, 1e7f, 1e30f};
    voxrt_build_desc d = defaults();
    uint32_t k, i;
    for (k = 0; k < 36; k++) {
        cells l;
        voxrt_tree *t;
        voxrt_voxel v;
        memset(&l, 0, sizeof l);
        for (i = 0; i < 2; i++) {
            const float s = length[i ? k / 6 : k % 6];
            cells_add(&l, 5, 6, 7, 0);
            cells_normal(&l, (double)(i ? 0 : s), (double)(0.1f * s), (double)(i ? -s : 0));
        }
        cells_add(&l, 5, 6, 7, 0);
        cells_normal(&l, (double)NAN, 1, 0); /* no direction */
        t = tree_make(&d, &l, 3);
        REQUIRE(t != NULL);
        CHECK(voxrt_tree_get(t, 3, 5, 6, 7, &v));
        CHECK_MSG(fabsf(v.normal[0] - 0.7f) < 0.02f && fabsf(v.normal[1] - 0.14f) < 0.02f && fabsf(v.normal[2] + 0.7f) < 0.02f,
                  "%g and %g: %g %g %g", (double)length[k % 6], (double)length[k / 6], (double)v.normal[0], (double)v.normal[1],
                  (double)v.normal[2]);
        voxrt_tree_destroy(t);
        cells_free(&l);
    }
}

/* ---- colours ----------------------------------------------------------------------------------------------------------- */

TEST(palettes) {
    static const uint32_t colours[6] = {1, 2, 3, 300, 3000, 40000};
    int k, method;
    for (k = 0; k < (test_quick() ? 4 : 6); k++) {
        for (method = 0; method < 2; method++) {
            uint32_t n = colours[k], i, count, wrong = 0, total = n < 4096 ? 4096 : n;
            cells l;
            voxrt_build_desc d = defaults();
            voxrt_tree *t;
            voxrt_tree_info info;
            memset(&l, 0, sizeof l);
            for (i = 0; i < total; i++)
                cells_add(&l, i & 63, i >> 6 & 63, i >> 12, ((i % n) * 2654435761u) >> 8 & 0xffffffu);
            if (n == 40000) d.palette_size = 1u << 24;
            d.lod_method = (voxrt_lod_method)method;
            t = tree_make(&d, &l, 6);
            check_tree(t);
            REQUIRE(t != NULL);
            for (i = 0; i < total; i++) {
                voxrt_voxel v;
                CHECK(voxrt_tree_get(t, 6, l.v[i].x, l.v[i].y, l.v[i].z, &v));
                wrong += pack(&v) != pack(&l.v[i]);
            }
            CHECK_MSG(wrong == 0, "%u colours, method %d: %u voxels", n, method, wrong);
            voxrt_tree_get_info(t, &info);
            (void)voxrt_tree_palette(t, &count);
            CHECK_EQ_U64(count, info.palette_count);
            if (method == 1 || n == 1) CHECK_EQ_U64(count, n); /* the means of mean level of detail are new colours */
            else CHECK(count >= n);
            CHECK_EQ_U64(info.has_normals, 0);
            voxrt_tree_destroy(t);
            cells_free(&l);
        }
    }
}

TEST(few_colours_for_many) {
    static const uint32_t sizes[4] = {1, 2, 16, 1000};
    int k, method;
    for (k = 0; k < 4; k++) {
        for (method = 0; method < 2; method++) {
            uint32_t i, count;
            cells l;
            voxrt_build_desc d = defaults();
            voxrt_tree *t;
            double worst = 0;
            memset(&l, 0, sizeof l);
            for (i = 0; i < 4096; i++) cells_add(&l, i & 15, i >> 4 & 15, i >> 8, i & 1 ? 0xff - (i >> 7) : 0xff0000 - (i >> 7 << 16));
            d.palette_size = sizes[k];
            d.lod_method = (voxrt_lod_method)method;
            t = tree_make(&d, &l, 4);
            check_tree(t);
            REQUIRE(t != NULL);
            (void)voxrt_tree_palette(t, &count);
            CHECK(count <= sizes[k] && count >= 1);
            for (i = 0; i < 4096; i++) {
                voxrt_voxel v;
                uint32_t a;
                (void)voxrt_tree_get(t, 4, l.v[i].x, l.v[i].y, l.v[i].z, &v);
                for (a = 0; a < 3; a++) worst = fmax(worst, fabs((double)v.rgb[a] - (double)l.v[i].rgb[a]));
            }
            if (sizes[k] > 1 && method == 1) CHECK_MSG(worst < 40, "%u colours: %.0f", sizes[k], worst);
            if (sizes[k] == 1000) CHECK_MSG(worst < 8, "%.0f", worst);
            voxrt_tree_destroy(t);
            cells_free(&l);
        }
    }
}

/* ---- memory, progress ------------------------------------------------------------------------------------------------ */

typedef struct job {
    shape s;
    uint8_t *rgb;
    voxrt_mesh mesh;
    cells l;
} job;

static void job_make(job *j, uint32_t rings) {
    test_rng rng = test_rng_make(3);
    size_t i;
    memset(j, 0, sizeof *j);
    shape_sphere(&j->s, 16, 16, 16, 14, rings);
    j->rgb = (uint8_t *)malloc(3 * j->s.vertices);
    if (j->rgb == NULL) abort();
    for (i = 0; i < 3 * j->s.vertices; i++) j->rgb[i] = (uint8_t)test_rng_u32(&rng);
    j->mesh.positions = j->s.p;
    j->mesh.vertex_count = j->s.vertices;
    j->mesh.indices = j->s.t;
    j->mesh.triangle_count = j->s.triangles;
    j->mesh.vertex_rgb = j->rgb;
    for (i = 0; i < 300; i++) {
        cells_add(&j->l, test_rng_below(&rng, 16), test_rng_below(&rng, 16), test_rng_below(&rng, 16), test_rng_u32(&rng) & 0xffffffu);
        cells_normal(&j->l, 1, 0.5, 0.1);
    }
}

static void job_free(job *j) {
    shape_free(&j->s);
    free(j->rgb);
    cells_free(&j->l);
}

static voxrt_result job_run(const job *j, int what, voxrt_env env, voxrt_tree **t) { /* 0, 1, 2: mesh; 3: voxels */
    voxrt_build_desc d;
    memset(&d, 0, sizeof d);
    d.env = env;
    d.resolution = 16;
    d.fill = what == 1 || what == 3;
    d.separating = what == 2 ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6;
    d.palette_size = what == 2 ? 50 : 0;
    d.lod_method = what == 1 ? VOXRT_LOD_MAJORITY : VOXRT_LOD_MEAN;
    if (what == 3) return voxrt_tree_from_voxels(&d, j->l.v, j->l.n, 4, t);
    return voxrt_tree_build(&d, &j->mesh, NULL, t);
}

TEST(every_allocation_fails_once) {
    job j;
    int what, threads, after;
    job_make(&j, 12);
    for (what = 0; what < 4; what++) {
        for (threads = 1; threads <= 3; threads += 2) {
            for (after = 0; after < 2; after++) { /* only that one, or all later ones too */
                int64_t k, all = 0, step = threads == 1 && after == 0 && !test_quick() ? 1 : threads == 1 ? 3 : 5;
                uint64_t hash = 0;
                for (k = -1; k < all; k += k < 0 ? 1 : step) {
                    test_alloc ta;
                    voxrt_env env;
                    voxrt_error e;
                    voxrt_tree *t = (voxrt_tree *)&ta;
                    voxrt_result r;
                    memset(&env, 0, sizeof env);
                    memset(&e, 0, sizeof e);
                    test_alloc_init(&ta);
                    ta.fail_at = k;
                    ta.fail_after = after;
                    env.allocator.alloc_fn = test_alloc_fn;
                    env.allocator.free_fn = test_free_fn;
                    env.allocator.user = &ta;
                    env.thread_count = (uint32_t)threads;
                    env.error = &e;
                    r = job_run(&j, what, env, &t);
                    if (k < 0) {
                        CHECK_EQ_U64(r, VOXRT_OK);
                        all = ta.count;
                        hash = voxrt_tree_hash(t);
                        CHECK(ta.live_blocks > 0); /* the tree is in there, nothing in malloc */
                    } else if (ta.failed != 0) {
                        CHECK_MSG(r == VOXRT_ERR_NO_MEMORY, "job %d, allocation %d: %d", what, (int)k, (int)r);
                        CHECK_MSG(t == NULL && ta.live_blocks == 0, "job %d, allocation %d: %d blocks left", what, (int)k,
                                  (int)ta.live_blocks);
                        CHECK_MSG(e.code == VOXRT_ERR_NO_MEMORY && e.text[0] != 0, "job %d, allocation %d: error not set", what, (int)k);
                    } else {
                        CHECK(r == VOXRT_OK && voxrt_tree_hash(t) == hash);
                    }
                    voxrt_tree_destroy(r == VOXRT_OK ? t : NULL);
                    test_alloc_check(&ta);
                }
            }
        }
    }
    job_free(&j);
}

TEST(memory_limit) {
    job j;
    int what;
    job_make(&j, 30);
    for (what = 0; what < 4; what++) {
        size_t limit = (size_t)1 << 24, fails = 0, oks = 0;
        for (; limit > 100; limit -= limit / 5) {
            test_alloc ta;
            voxrt_env env;
            voxrt_tree *t = NULL;
            voxrt_result r;
            memset(&env, 0, sizeof env);
            test_alloc_init(&ta);
            env.allocator.alloc_fn = test_alloc_fn;
            env.allocator.free_fn = test_free_fn;
            env.allocator.user = &ta;
            env.thread_count = 1;
            env.memory_limit = limit;
            r = job_run(&j, what, env, &t);
            CHECK(r == VOXRT_OK || r == VOXRT_ERR_NO_MEMORY);
            CHECK_MSG(ta.peak_bytes <= limit, "%u bytes, the limit is %u", (unsigned)ta.peak_bytes, (unsigned)limit);
            oks += r == VOXRT_OK;
            fails += r != VOXRT_OK;
            CHECK(r != VOXRT_OK || fails == 0);
            voxrt_tree_destroy(t);
            test_alloc_check(&ta);
        }
        CHECK(oks > 0 && fails > 0);
    }
    job_free(&j);
}

TEST(peak_memory_is_told) {
    job j;
    test_alloc ta;
    voxrt_build_desc d = defaults();
    voxrt_build_stats st;
    voxrt_tree *t = NULL;
    voxrt_tree_info info;
    job_make(&j, 60);
    test_alloc_init(&ta);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    d.resolution = 256;
    CHECK_EQ_U64(voxrt_tree_build(&d, &j.mesh, &st, &t), VOXRT_OK);
    CHECK_EQ_U64(st.peak_bytes, ta.peak_bytes);
    voxrt_tree_get_info(t, &info);
    CHECK(ta.live_bytes >= info.total_bytes && ta.live_bytes < info.total_bytes + 4096 + info.total_bytes / 4);
    voxrt_tree_destroy(t);
    test_alloc_check(&ta);
    job_free(&j);
}

typedef struct progress { uint64_t calls, done, total, stop_at; int wrong; } progress;

static int on_progress(void *user, uint64_t done, uint64_t total) {
    progress *p = (progress *)user;
    if (p->calls != 0 && (done < p->done || total != p->total)) p->wrong = 1;
    if (done > total || total == 0) p->wrong = 1;
    p->done = done;
    p->total = total;
    p->calls++;
    return p->stop_at != 0 && p->calls == p->stop_at;
}

/* What failed within a call says more than its result does. */
TEST(errors_keep_their_place) {
    static const uint8_t palette[3] = {1, 2, 3};
    voxrt_build_desc d = defaults();
    voxrti_leafset set;
    voxrti_grid grid;
    voxrti_mem mem;
    voxrt_error e;
    voxrt_tree *t;
    memset(&set, 0, sizeof set);
    memset(&grid, 0, sizeof grid);
    memset(&e, 0, sizeof e);
    d.env.error = &e;
    REQUIRE(voxrti_env_open(&d.env, &mem) == VOXRT_OK);
    grid.depth = 2;
    grid.resolution = 4;
    grid.voxel_size = 1;
    set.block_count = set.voxel_count = 1;
    set.key = (uint64_t *)voxrti_alloc_zero(&mem, 1, 8);
    set.mask = (uint64_t *)voxrti_alloc_zero(&mem, 1, 8);
    set.rgb = (uint32_t *)voxrti_alloc_zero(&mem, 1, 4);
    REQUIRE(set.key != NULL && set.mask != NULL && set.rgb != NULL);
    set.mask[0] = 1;
    set.rgb[0] = 0x1000005; /* no index of a palette */
    CHECK_EQ_U64(voxrti_tree_from_leafset_palette(&mem, &d, &grid, &set, palette, 1, NULL, &t), VOXRT_ERR_RANGE);
    CHECK(e.code == VOXRT_ERR_RANGE && strstr(e.text, "palette index") != NULL);
    CHECK_EQ_U64(e.where, 0x1000005);
}

TEST(progress_and_cancel) {
    const uint32_t count = 300000; /* progress is told after each 256 tasks, a task has at least 1024 triangles */
    float *p9 = (float *)malloc((size_t)count * 36);
    test_rng rng = test_rng_make(5);
    voxrt_mesh m;
    uint32_t threads, k;
    uint64_t calls = 0;
    if (p9 == NULL) abort();
    for (k = 0; k < 9 * count; k++) p9[k] = k % 9 < 3 ? test_rng_range(&rng, 1, 511) : p9[k - 3] + 0.3f * test_rng_float(&rng);
    memset(&m, 0, sizeof m);
    m.positions = p9;
    m.vertex_count = 3 * (size_t)count;
    m.triangle_count = count;
    for (threads = 1; threads <= 4; threads += 3) {
        for (k = 0; k < 3; k++) {
            test_alloc ta;
            progress p;
            voxrt_error e;
            voxrt_build_desc d = defaults();
            voxrt_tree *t = (voxrt_tree *)&p;
            voxrt_result r;
            memset(&p, 0, sizeof p);
            memset(&e, 0, sizeof e);
            test_alloc_init(&ta);
            d.resolution = 512;
            d.box_size = 512;
            d.disable_normals = 1;
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.env.thread_count = threads;
            d.env.progress_fn = on_progress;
            d.env.progress_user = &p;
            d.env.error = &e;
            p.stop_at = k == 0 ? 0 : k == 1 ? 1 : calls;
            r = voxrt_tree_build(&d, &m, NULL, &t);
            CHECK(!p.wrong);
            if (k == 0) {
                CHECK_EQ_U64(r, VOXRT_OK);
                CHECK_MSG(p.calls >= 2, "%u calls", (unsigned)p.calls);
                CHECK_EQ_U64(p.done, p.total);
                calls = p.calls;
            } else { /* at the first and at the last call */
                CHECK_EQ_U64(r, VOXRT_ERR_CANCELLED);
                CHECK_EQ_U64(e.code, VOXRT_ERR_CANCELLED);
                CHECK_EQ_U64(p.calls, p.stop_at);
                CHECK(t == NULL);
            }
            voxrt_tree_destroy(r == VOXRT_OK ? t : NULL);
            test_alloc_check(&ta);
        }
    }
    free(p9);
}

static void count_for(voxrt_task_fn *task, void *ctx, uint32_t count, void *user) {
    uint32_t i;
    ++*(uint32_t *)user;
    for (i = 0; i < count; i++) task(ctx, count - 1 - i);
}

/* More than one chunk of nodes on a level: threads share the levels of detail. */
TEST(many_nodes) {
    test_rng rng = test_rng_make(12);
    cells l;
    uint32_t i, k, calls = 0;
    uint64_t hash[2] = {0, 0};
    memset(&l, 0, sizeof l);
    for (i = 0; i < (test_quick() ? 20000u : 60000u); i++) {
        cells_add(&l, test_rng_below(&rng, 256), test_rng_below(&rng, 256), test_rng_below(&rng, 256), (test_rng_u32(&rng) & 7u) * 0x111111u);
        cells_normal(&l, test_rng_double(&rng) - 0.5, test_rng_double(&rng) - 0.5, test_rng_double(&rng) - 0.5);
    }
    for (k = 0; k < 8; k++) {
        static const uint32_t threads[4] = {1, 2, 7, 16};
        voxrt_build_desc d = defaults();
        voxrt_tree *t;
        d.lod_method = (voxrt_lod_method)(k & 1);
        d.env.thread_count = threads[k / 2];
        if (k / 2 == 3) {
            d.env.parallel.for_fn = count_for;
            d.env.parallel.user = &calls;
        }
        t = tree_make(&d, &l, 8);
        if (k < 2) {
            check_tree(t);
            hash[k] = voxrt_tree_hash(t);
        }
        CHECK(voxrt_tree_hash(t) == hash[k & 1]);
        voxrt_tree_destroy(t);
    }
    CHECK(calls > 0);
    CHECK(hash[0] != hash[1]);
    cells_free(&l);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(random_voxels);
    RUN(each_can_stop);
    RUN(hash_sees_everything);
    RUN(from_voxels_arguments);
    RUN(fill_boxes);
    RUN(fill_nested_and_touching);
    RUN(fill_round_hulls);
    RUN(fill_random);
    RUN(fill_meshes);
    RUN(lod_mean);
    RUN(lod_mean_random);
    RUN(lod_majority);
    RUN(lod_opposite_normals);
    RUN(same_voxel_twice);
    RUN(same_voxel_twice_with_any_normals);
    RUN(palettes);
    RUN(few_colours_for_many);
    RUN(every_allocation_fails_once);
    RUN(memory_limit);
    RUN(peak_memory_is_told);
    RUN(errors_keep_their_place);
    RUN(progress_and_cancel);
    RUN(many_nodes);
    return test_end();
}
