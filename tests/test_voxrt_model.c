/* Editing: what is filled, its colours and normals against plain arrays; all levels, rays and pictures against one tree
   of the same voxels; copies, failures, any number of threads. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"

enum { MODEL_MOST = 160 * 160 * 160 };

/* The oracle: edge n, a cube of cells. */
typedef struct model_world {
    uint32_t n;
    uint8_t *filled;
    uint8_t (*rgb)[3];
    float (*normal)[3];
} model_world;

static int model_world_open(model_world *w, uint32_t n) {
    const size_t all = (size_t)n * n * n;
    w->n = n;
    w->filled = (uint8_t *)calloc(all, 1);
    w->rgb = (uint8_t (*)[3])calloc(all, 3);
    w->normal = (float (*)[3])calloc(all, sizeof *w->normal);
    return w->filled != NULL && w->rgb != NULL && w->normal != NULL;
}

static void model_world_close(model_world *w) {
    free(w->filled);
    free(w->rgb);
    free(w->normal);
}

static size_t at(const model_world *w, uint32_t x, uint32_t y, uint32_t z) { return x + w->n * (y + (size_t)w->n * z); }

static int full(const model_world *w, const uint8_t *filled, int64_t x, int64_t y, int64_t z) {
    const int64_t n = w->n;
    return x >= 0 && y >= 0 && z >= 0 && x < n && y < n && z < n && filled[x + n * (y + n * z)];
}

typedef struct model_shape {
    int sphere;
    double lo[3], hi[3], centre[3], radius;
} model_shape;

static int inside(const model_shape *s, double x, double y, double z) {
    if (s->sphere) return (x - s->centre[0]) * (x - s->centre[0]) + (y - s->centre[1]) * (y - s->centre[1]) +
                          (z - s->centre[2]) * (z - s->centre[2]) < s->radius * s->radius;
    return x >= s->lo[0] && x < s->hi[0] && y >= s->lo[1] && y < s->hi[1] && z >= s->lo[2] && z < s->hi[2];
}

/* Outward, of a sphere exactly; of a box the face that is nearest, of which there may be several: 0 then, as deep
   inside, where nothing shows. */
static void outward(const model_shape *s, const uint32_t p[3], float n[3]) {
    double d[3], length = 0.0;
    int k;
    if (s->sphere) {
        for (k = 0; k < 3; k++) {
            d[k] = p[k] + 0.5 - s->centre[k];
            length += d[k] * d[k];
        }
        for (k = 0; k < 3; k++) n[k] = length > 1e-12 && sqrt(length) > s->radius - 1.9 ? (float)(d[k] / sqrt(length)) : 0.0f;
        return;
    }
    memset(n, 0, 3 * sizeof *n);
}

static void world_edit(model_world *w, const model_shape *s, voxrt_edit_op op, const uint8_t rgb[3], voxrt_edit_stats *stats) {
    const size_t all = (size_t)w->n * w->n * w->n;
    uint8_t *before = (uint8_t *)malloc(all);
    uint32_t p[3];
    static const int step[6][3] = {{-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}};
    int k, a;
    if (before == NULL) abort();
    memcpy(before, w->filled, all);
    for (p[2] = 0; p[2] < w->n; p[2]++) {
        for (p[1] = 0; p[1] < w->n; p[1]++) {
            for (p[0] = 0; p[0] < w->n; p[0]++) {
                const size_t i = at(w, p[0], p[1], p[2]);
                const int in = inside(s, p[0] + 0.5, p[1] + 0.5, p[2] + 0.5);
                if (in && op == VOXRT_EDIT_CLEAR) {
                    stats->cleared += before[i];
                    w->filled[i] = 0;
                } else if (in && (op == VOXRT_EDIT_SET || before[i])) {
                    if (before[i]) stats->painted++;
                    else stats->filled++;
                    w->filled[i] = 1;
                    memcpy(w->rgb[i], rgb, 3);
                    if (op == VOXRT_EDIT_SET) outward(s, p, w->normal[i]);
                } else if (!in && op == VOXRT_EDIT_CLEAR && before[i]) {
                    int buried = 1, beside = 0;
                    float into[3], *normal = w->normal[i];
                    for (k = 0; k < 6; k++) {
                        const double x = p[0] + 0.5 + step[k][0], y = p[1] + 0.5 + step[k][1], z = p[2] + 0.5 + step[k][2];
                        const int was = full(w, before, (int64_t)p[0] + step[k][0], (int64_t)p[1] + step[k][1], (int64_t)p[2] + step[k][2]);
                        buried &= was;
                        beside |= was && inside(s, x, y, z);
                    }
                    if (!beside) continue;
                    outward(s, p, into);
                    if (!buried) { /* half way between both normals, if both are known */
                        const int known = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2] > 0.5f &&
                                          into[0] * into[0] + into[1] * into[1] + into[2] * into[2] > 0.5f;
                        double sum[3], length = 0.0;
                        for (a = 0; a < 3; a++) {
                            sum[a] = (double)normal[a] - (double)into[a];
                            length += sum[a] * sum[a];
                        }
                        for (a = 0; a < 3; a++) into[a] = known && length > 0.1 ? (float)(-sum[a] / sqrt(length)) : 0.0f;
                    }
                    for (a = 0; a < 3; a++) normal[a] = -into[a];
                }
            }
        }
    }
    free(before);
}

/* A random edit of both; counts have to agree. */
static void random_edit(test_rng *r, model_world *w, voxrt_model *m, int threads, voxrt_edit_op op) {
    voxrt_edit_desc d;
    voxrt_edit_stats stats, want;
    voxrt_model_info info;
    model_shape s;
    double lo[3], hi[3];
    int k;
    memset(&d, 0, sizeof d);
    memset(&want, 0, sizeof want);
    memset(&s, 0, sizeof s);
    voxrt_model_get_info(m, &info);
    d.op = op;
    d.env.thread_count = (uint32_t)threads;
    for (k = 0; k < 3; k++) d.rgb[k] = (uint8_t)test_rng_below(r, 256);
    s.sphere = (int)test_rng_below(r, 2);
    s.radius = test_rng_double(r) * w->n * 0.4;
    for (k = 0; k < 3; k++) {
        s.centre[k] = (test_rng_double(r) * 1.2 - 0.1) * w->n;
        s.lo[k] = s.centre[k] - test_rng_double(r) * w->n * 0.4;
        s.hi[k] = s.centre[k] + test_rng_double(r) * w->n * 0.4;
        if (test_rng_below(r, 4) == 0) s.lo[k] = floor(s.lo[k]) + 0.5; /* faces through centres */
        lo[k] = info.world_origin[k] + info.voxel_size * s.lo[k];
        hi[k] = info.world_origin[k] + info.voxel_size * s.hi[k];
        s.centre[k] = floor(s.centre[k] * 8) / 8; /* no rounding in either */
    }
    s.radius = floor(s.radius * 8) / 8 + 1.0 / 32;
    world_edit(w, &s, op, d.rgb, &want);
    if (s.sphere) {
        double c[3];
        for (k = 0; k < 3; k++) c[k] = info.world_origin[k] + info.voxel_size * s.centre[k];
        CHECK(voxrt_model_sphere(m, &d, c, info.voxel_size * s.radius, &stats) == VOXRT_OK);
    } else {
        CHECK(voxrt_model_box(m, &d, lo, hi, &stats) == VOXRT_OK);
    }
    CHECK_MSG(stats.filled == want.filled && stats.cleared == want.cleared && stats.painted == want.painted,
              "%llu %llu %llu, not %llu %llu %llu", (unsigned long long)stats.filled, (unsigned long long)stats.cleared,
              (unsigned long long)stats.painted, (unsigned long long)want.filled, (unsigned long long)want.cleared,
              (unsigned long long)want.painted);
}

/* Voxels of both are the same; list: those of the model, or NULL. */
static size_t compare(const model_world *w, const voxrt_model *m, voxrt_voxel *list) {
    voxrt_model_info info;
    uint32_t x, y, z, wrong = 0, turned = 0;
    size_t n = 0;
    voxrt_model_get_info(m, &info);
    for (z = 0; z < w->n; z++) {
        for (y = 0; y < w->n; y++) {
            for (x = 0; x < w->n; x++) {
                const size_t i = at(w, x, y, z);
                voxrt_voxel v;
                const int has = voxrt_model_get(m, info.depth, x, y, z, &v);
                wrong += has != w->filled[i] || (has && memcmp(v.rgb, w->rgb[i], 3) != 0);
                if (has && (w->normal[i][0] != 0.0f || w->normal[i][1] != 0.0f || w->normal[i][2] != 0.0f))
                    turned += v.normal[0] * w->normal[i][0] + v.normal[1] * w->normal[i][1] + v.normal[2] * w->normal[i][2] < 0.999f;
                if (has && list != NULL) list[n] = v;
                n += (size_t)has;
            }
        }
    }
    CHECK_MSG(wrong == 0, "%u voxels are wrong", wrong);
    CHECK_MSG(turned == 0, "%u normals are wrong", turned);
    CHECK(n == info.voxel_count);
    return n;
}

typedef struct levels { const voxrt_model *m; uint32_t level; size_t wrong, count; } levels;

static int same_cell(void *user, const voxrt_voxel *v, uint32_t index) {
    levels *l = (levels *)user;
    voxrt_voxel o;
    (void)index;
    l->count++;
    l->wrong += !voxrt_model_get(l->m, l->level, v->x, v->y, v->z, &o) || memcmp(o.rgb, v->rgb, 3) != 0 ||
                memcmp(o.normal, v->normal, sizeof o.normal) != 0 || o.has_normal != v->has_normal;
    return 0;
}

/* One tree of all voxels: the same cells of all levels, and what the model becomes has the same hash. */
static voxrt_tree *one_tree(const voxrt_model *m, const voxrt_voxel *list, size_t n) {
    voxrt_build_desc d;
    voxrt_model_info info;
    voxrt_tree *t = NULL, *back = NULL;
    uint32_t level, edge, step, x, y, z, k;
    voxrt_model_get_info(m, &info);
    memset(&d, 0, sizeof d);
    d.palette_size = 16777216;
    memcpy(d.box_min, info.world_origin, sizeof d.box_min);
    d.box_size = info.voxel_size * (double)(1u << info.depth);
    CHECK(voxrt_tree_from_voxels(&d, list, n, info.depth, &t) == (n != 0 ? VOXRT_OK : VOXRT_ERR_EMPTY));
    CHECK(voxrt_tree_from_model(&d, m, &back) == (n != 0 ? VOXRT_OK : VOXRT_ERR_EMPTY));
    if (t == NULL || back == NULL) return NULL;
    CHECK(voxrt_tree_hash(t) == voxrt_tree_hash(back));
    voxrt_tree_destroy(back);
    for (level = 0; level <= info.depth; level++) {
        levels l;
        memset(&l, 0, sizeof l);
        l.m = m;
        l.level = level;
        (void)voxrt_tree_each(t, level, same_cell, &l);
        CHECK_MSG(l.wrong == 0, "%u of %u cells of level %u are different", (unsigned)l.wrong, (unsigned)l.count, level);
        edge = 1u << level;
        step = edge > 32 ? edge / 32 : 1;
        for (k = 0, z = 0; z < edge; z += step) /* nothing is there that should not be */
            for (y = 0; y < edge; y += step)
                for (x = 0; x < edge; x += step) k += voxrt_model_get(m, level, x, y, z, NULL) != voxrt_tree_get(t, level, x, y, z, NULL);
        CHECK(k == 0);
    }
    return t;
}

/* Rays from around and from inside: the same distances, cells' colours and normals; and what is occluded. */
static void same_rays(const voxrt_model *m, const voxrt_tree *t, test_rng *r, float spread) {
    enum { RAYS = 64 };
    voxrt_geometry a, b;
    voxrt_trace_desc d;
    voxrt_model_info info;
    uint32_t n, i, k, other = 0, block = 0, total = 0;
    memset(&d, 0, sizeof d);
    d.cone_spread = spread;
    voxrt_model_geometry(m, &a);
    voxrt_tree_geometry(t, &b);
    voxrt_model_get_info(m, &info);
    for (n = 0; n < 60; n++) {
        voxrt_ray ray[RAYS];
        voxrt_surface sa[RAYS], sb[RAYS];
        uint8_t oa[RAYS], ob[RAYS];
        const double size = info.voxel_size * (double)(1u << info.depth);
        for (i = 0; i < RAYS; i++) {
            const int axis = test_rng_below(r, 8) == 0 ? (int)test_rng_below(r, 3) : 3;
            for (k = 0; k < 3; k++) {
                const double from = n < 30 ? test_rng_double(r) : test_rng_double(r) * 3.0 - 1.0, to = test_rng_double(r);
                ray[i].org[k] = (float)(info.world_origin[k] + size * from);
                ray[i].dir[k] = axis == 3 || axis == (int)k ? (float)(size * (to - from)) : 0.0f;
            }
            ray[i].t_min = 0.0f;
            ray[i].t_max = test_rng_below(r, 4) == 0 ? 0.5f : INFINITY;
        }
        a.trace_fn(a.user, &d, ray, sa, RAYS);
        b.trace_fn(b.user, &d, ray, sb, RAYS);
        a.occluded_fn(a.user, &d, ray, oa, RAYS);
        b.occluded_fn(b.user, &d, ray, ob, RAYS);
        for (i = 0; i < RAYS; i++) {
            total += sb[i].t < INFINITY;
            block += oa[i] != ob[i];
            other += sa[i].t != sb[i].t || memcmp(sa[i].rgb, sb[i].rgb, 3) != 0 || sa[i].face != sb[i].face ||
                     memcmp(sa[i].normal, sb[i].normal, sizeof sa[i].normal) != 0 || sa[i].edge != sb[i].edge;
        }
    }
    CHECK(total > 200);
    if (spread == 0.0f) CHECK_MSG(other == 0 && block == 0, "%u of %u hits, %u shadows are different", other, total, block);
    else CHECK_MSG(other < total / 25 && block < total / 25, "%u of %u hits, %u shadows are different", other, total, block);
}

static voxrt_model *open_model(uint32_t depth, double size) {
    voxrt_model_desc d;
    voxrt_model *m = NULL;
    memset(&d, 0, sizeof d);
    d.depth = depth;
    d.box_size = size;
    if (size > 0.0) d.box_min[0] = -1.0;
    return voxrt_model_create(&d, &m) == VOXRT_OK ? m : NULL;
}

TEST(random_edits) {
    static const uint32_t depths[] = {1, 2, 3, 5, 6, 7};
    test_rng r = test_rng_make(5);
    voxrt_voxel *list = (voxrt_voxel *)malloc((size_t)MODEL_MOST * sizeof *list);
    uint32_t k, i;
    REQUIRE(list != NULL);
    for (k = 0; k < sizeof depths / sizeof depths[0]; k++) {
        model_world w;
        voxrt_model *m = open_model(depths[k], k % 2 ? 2.0 : 0.0);
        const uint32_t rounds = test_quick() ? 3 : depths[k] == 7 ? 6 : 9;
        REQUIRE(m != NULL && model_world_open(&w, 1u << depths[k]));
        for (i = 0; i < rounds; i++) {
            size_t n;
            voxrt_tree *t;
            random_edit(&r, &w, m, 1 + (int)(i % 2), i < 2 ? VOXRT_EDIT_SET : (voxrt_edit_op)test_rng_below(&r, 3));
            if (depths[k] == 7 && i % 2 == 0) continue;
            n = compare(&w, m, list);
            t = one_tree(m, list, n);
            if (t != NULL && depths[k] == 7) {
                same_rays(m, t, &r, 0.0f);
                same_rays(m, t, &r, 0.02f);
            }
            voxrt_tree_destroy(t);
        }
        voxrt_model_destroy(m);
        model_world_close(&w);
    }
    free(list);
}

/* Lists and triangles; a model of a tree, shared or not, is that tree. */
TEST(lists_meshes_and_trees) {
    static const float corner[9] = {0.1f, 0.2f, 0.3f, 1.7f, 0.4f, 0.9f, 0.6f, 1.9f, 1.2f};
    static const uint32_t index[3] = {0, 1, 2};
    static const uint8_t red[3] = {200, 10, 20};
    voxrt_model *m = open_model(7, 2.0), *copy = NULL;
    voxrt_build_desc b;
    voxrt_edit_desc d;
    voxrt_edit_stats stats;
    voxrt_model_info info;
    voxrt_mesh mesh;
    voxrt_tree *t = NULL, *back = NULL, *shared = NULL;
    voxrt_voxel v[3];
    voxrt_tree_info ti;
    REQUIRE(m != NULL);
    memset(&b, 0, sizeof b);
    memset(&d, 0, sizeof d);
    memset(&mesh, 0, sizeof mesh);
    mesh.positions = corner;
    mesh.vertex_count = 3;
    mesh.indices = index;
    mesh.triangle_count = 1;
    mesh.triangle_rgb = red;
    b.resolution = 128;
    b.box_size = 2.0;
    b.box_min[0] = -1.0;
    REQUIRE(voxrt_tree_build(&b, &mesh, NULL, &t) == VOXRT_OK);
    voxrt_tree_get_info(t, &ti);
    CHECK(voxrt_model_mesh(m, &d, &mesh, &stats) == VOXRT_OK && stats.filled == ti.voxel_count && stats.painted == 0);
    REQUIRE(voxrt_tree_from_model(&b, m, &back) == VOXRT_OK);
    CHECK(voxrt_tree_hash(t) == voxrt_tree_hash(back));
    voxrt_tree_destroy(back);
    CHECK(voxrt_model_mesh(m, &d, &mesh, &stats) == VOXRT_OK && stats.filled == 0 && stats.painted == ti.voxel_count);
    REQUIRE(voxrt_tree_share(t, NULL, &shared) == VOXRT_OK && voxrt_model_from_tree(NULL, shared, &copy) == VOXRT_OK);
    REQUIRE(voxrt_tree_from_model(&b, copy, &back) == VOXRT_OK);
    CHECK(voxrt_tree_hash(t) == voxrt_tree_hash(back));
    voxrt_tree_destroy(back);
    voxrt_tree_destroy(shared);
    { /* no colours, no normals */
        voxrt_tree *bare = NULL;
        voxrt_model *of_bare = NULL;
        b.disable_colors = b.disable_normals = 1;
        REQUIRE(voxrt_tree_build(&b, &mesh, NULL, &bare) == VOXRT_OK);
        b.disable_colors = b.disable_normals = 0;
        REQUIRE(voxrt_model_from_tree(NULL, bare, &of_bare) == VOXRT_OK);
        REQUIRE(voxrt_tree_from_model(&b, of_bare, &back) == VOXRT_OK);
        CHECK(voxrt_tree_hash(bare) == voxrt_tree_hash(back));
        voxrt_tree_destroy(bare);
        voxrt_tree_destroy(back);
        voxrt_model_destroy(of_bare);
    }
    /* a list: one new voxel twice, one that is there */
    memset(v, 0, sizeof v);
    CHECK(!voxrt_model_get(copy, 7, 127, 127, 127, NULL));
    v[0].x = v[0].y = v[0].z = v[1].x = v[1].y = v[1].z = 127;
    v[0].rgb[0] = 255;
    v[1].rgb[0] = 255;
    v[2].x = ti.cell_min[0];
    for (v[2].y = 0; v[2].y < 128; v[2].y++) {
        for (v[2].z = 0; v[2].z < 128; v[2].z++)
            if (voxrt_model_get(copy, 7, v[2].x, v[2].y, v[2].z, NULL)) break;
        if (v[2].z < 128) break;
    }
    REQUIRE(v[2].y < 128);
    CHECK(voxrt_model_voxels(copy, &d, v, 3, &stats) == VOXRT_OK && stats.filled == 1 && stats.painted == 1 && stats.blocks == 2);
    CHECK(voxrt_model_get(copy, 7, 127, 127, 127, &v[1]) && v[1].rgb[0] == 255 && v[1].rgb[1] == 0);
    d.op = VOXRT_EDIT_CLEAR;
    CHECK(voxrt_model_voxels(copy, &d, v, 3, &stats) == VOXRT_OK && stats.cleared == 2);
    CHECK(!voxrt_model_get(copy, 7, 127, 127, 127, NULL) && voxrt_model_get(copy, 0, 0, 0, 0, NULL));
    CHECK(voxrt_model_mesh(copy, &d, &mesh, &stats) == VOXRT_OK && stats.cleared == ti.voxel_count - 1);
    voxrt_model_get_info(copy, &info);
    CHECK(info.voxel_count == 0 && info.block_count == 0 && !voxrt_model_get(copy, 0, 0, 0, 0, NULL));
    CHECK(voxrt_tree_from_model(&b, copy, &back) == VOXRT_ERR_EMPTY && back == NULL);
    v[0].x = 128;
    CHECK(voxrt_model_voxels(m, &d, v, 2, &stats) == VOXRT_ERR_RANGE);
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
    voxrt_model_destroy(copy);
}

/* Solid, then a list of voxels goes: what lay behind them shows, with normals into the hole, across blocks. */
TEST(holes_of_lists) {
    const double lo[3] = {0, 0, 0}, hi[3] = {128, 128, 128};
    voxrt_model *m = open_model(7, 0.0);
    voxrt_edit_desc d;
    voxrt_edit_stats stats;
    voxrt_voxel hole, v;
    int k;
    REQUIRE(m != NULL);
    memset(&d, 0, sizeof d);
    memset(&hole, 0, sizeof hole);
    CHECK(voxrt_model_box(m, &d, lo, hi, &stats) == VOXRT_OK && stats.filled == 128u * 128 * 128);
    CHECK(voxrt_model_get(m, 7, 0, 50, 60, &v) && v.normal[0] < -0.999f);
    d.op = VOXRT_EDIT_CLEAR;
    hole.x = 63; /* the last of its block */
    hole.y = hole.z = 40;
    CHECK(voxrt_model_voxels(m, &d, &hole, 1, &stats) == VOXRT_OK && stats.cleared == 1 && stats.blocks == 2);
    for (k = 0; k < 6; k++) {
        const int side = k % 2 ? 1 : -1;
        const uint32_t p[3] = {63u + (k < 2 ? (uint32_t)side : 0u), 40u + (k / 2 == 1 ? (uint32_t)side : 0u),
                               40u + (k / 2 == 2 ? (uint32_t)side : 0u)};
        CHECK(voxrt_model_get(m, 7, p[0], p[1], p[2], &v) && v.normal[k / 2] * (float)side < -0.999f);
    }
    voxrt_model_destroy(m);
}

/* Copies keep what was; the last that has a block frees it. */
TEST(undo) {
    enum { STEPS = 6 };
    test_rng r = test_rng_make(9);
    voxrt_model *m = open_model(7, 0.0), *before[STEPS];
    uint64_t hash[STEPS];
    model_world w;
    int i, other = 0;
    REQUIRE(m != NULL && model_world_open(&w, 128));
    for (i = 0; i < 4; i++) random_edit(&r, &w, m, 2, VOXRT_EDIT_SET);
    for (i = 0; i < STEPS; i++) {
        voxrt_tree *t = NULL;
        random_edit(&r, &w, m, 2, (voxrt_edit_op)(i % 3));
        before[i] = NULL;
        REQUIRE(voxrt_model_copy(NULL, m, &before[i]) == VOXRT_OK);
        REQUIRE(voxrt_tree_from_model(NULL, m, &t) == VOXRT_OK);
        hash[i] = voxrt_tree_hash(t);
        voxrt_tree_destroy(t);
    }
    for (i = 1; i < STEPS; i++) other += hash[i] != hash[i - 1];
    CHECK(other >= 3); /* the others have hit nothing */
    voxrt_model_destroy(m);
    for (i = STEPS; i-- > 0;) {
        voxrt_tree *t = NULL;
        REQUIRE(voxrt_tree_from_model(NULL, before[i], &t) == VOXRT_OK);
        CHECK(voxrt_tree_hash(t) == hash[i]);
        voxrt_tree_destroy(t);
        voxrt_model_destroy(before[i]);
    }
    model_world_close(&w);
}

/* Rays through the edges of blocks, along them, in worlds around 0; cells larger than blocks; allocators of edits. */
TEST(edges_of_blocks) {
    voxrt_model *m = open_model(7, 0.0);
    voxrt_voxel v[256];
    voxrt_model_desc md;
    voxrt_geometry g;
    voxrt_trace_desc td;
    voxrt_ray ray;
    voxrt_surface s;
    voxrt_tree *t = NULL, *back = NULL;
    voxrt_build_desc b;
    uint32_t n = 0, x;
    REQUIRE(m != NULL);
    memset(v, 0, sizeof v);
    memset(&td, 0, sizeof td);
    memset(&ray, 0, sizeof ray);
    memset(&md, 0, sizeof md);
    memset(&b, 0, sizeof b);
    for (x = 0; x < 128; x++, n++) { /* a wall at right angles to the ray, whose cells touch at edges only */
        v[n].x = x;
        v[n].y = 127 - x;
    }
    CHECK(voxrt_model_voxels(m, NULL, v, n, NULL) == VOXRT_OK);
    voxrt_model_geometry(m, &g);
    ray.org[0] = ray.org[1] = ray.org[2] = 0.5f;
    ray.dir[0] = ray.dir[1] = 1.0f;
    ray.t_max = INFINITY;
    g.trace_fn(g.user, &td, &ray, &s, 1);
    CHECK(s.t == 63.5f);
    voxrt_model_destroy(m);
    md.depth = 7;
    md.box_size = 128.0;
    md.box_min[0] = md.box_min[1] = md.box_min[2] = -64.0;
    REQUIRE(voxrt_model_create(&md, &m) == VOXRT_OK);
    v[0].x = v[0].y = 64;
    v[0].z = 100;
    CHECK(voxrt_model_voxels(m, NULL, v, 1, NULL) == VOXRT_OK);
    voxrt_model_geometry(m, &g);
    ray.org[0] = -1e-16f;
    ray.org[1] = 0.5f;
    ray.org[2] = -100.0f;
    ray.dir[0] = ray.dir[1] = 0.0f;
    ray.dir[2] = 1.0f;
    g.trace_fn(g.user, &td, &ray, &s, 1);
    CHECK(s.t == 136.0f);
    REQUIRE(voxrt_tree_from_model(NULL, m, &t) == VOXRT_OK);
    for (td.max_level_plus_1 = 1; td.max_level_plus_1 <= 8; td.max_level_plus_1++) { /* a cell of each level */
        voxrt_voxel cell;
        const uint32_t level = td.max_level_plus_1 - 1, up = 7 - level;
        g.trace_fn(g.user, &td, &ray, &s, 1);
        CHECK(voxrt_tree_get(t, level, 64u >> up, 64u >> up, 100u >> up, &cell));
        CHECK(s.t < INFINITY && memcmp(s.rgb, cell.rgb, 3) == 0 && s.edge == (float)(1u << up));
    }
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
    b.resolution = 100; /* is kept, until something lies beyond it */
    b.box_size = 100.0;
    v[0].z = 10;
    REQUIRE(voxrt_tree_from_voxels(&b, v, 1, 7, &t) == VOXRT_OK);
    t->resolution = 100;
    REQUIRE(voxrt_model_from_tree(NULL, t, &m) == VOXRT_OK && voxrt_tree_from_model(NULL, m, &back) == VOXRT_OK);
    CHECK(back->resolution == 100 && voxrt_tree_hash(back) == voxrt_tree_hash(t));
    voxrt_tree_destroy(back);
    v[0].x = 100;
    CHECK(voxrt_model_voxels(m, NULL, v, 1, NULL) == VOXRT_OK && voxrt_tree_from_model(NULL, m, &back) == VOXRT_OK);
    CHECK(back->resolution == 128);
    voxrt_tree_destroy(back);
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
    md.box_size = 1e39;
    CHECK(voxrt_model_create(&md, &m) == VOXRT_ERR_RANGE && m == NULL);
}

/* A picture of the model is that of the tree. */
TEST(same_picture) {
    enum { W = 96, H = 64 };
    static uint8_t a[W * H * 4], b[W * H * 4];
    const double lo[3] = {10, 10, 10}, hi[3] = {118, 60, 118}, centre[3] = {64, 64, 64};
    voxrt_model *m = open_model(7, 0.0);
    voxrt_edit_desc d;
    voxrt_render_desc rd;
    voxrt_geometry g;
    voxrt_image image;
    voxrt_tree *t = NULL;
    voxrt_build_desc bd;
    REQUIRE(m != NULL);
    memset(&d, 0, sizeof d);
    memset(&rd, 0, sizeof rd);
    memset(&bd, 0, sizeof bd);
    bd.palette_size = 16777216;
    d.rgb[1] = 180;
    CHECK(voxrt_model_box(m, &d, lo, hi, NULL) == VOXRT_OK);
    d.op = VOXRT_EDIT_CLEAR;
    CHECK(voxrt_model_sphere(m, &d, centre, 40.0, NULL) == VOXRT_OK);
    REQUIRE(voxrt_tree_from_model(&bd, m, &t) == VOXRT_OK);
    memset(&image, 0, sizeof image);
    image.width = W;
    image.height = H;
    rd.shadows = 1;
    rd.camera.eye[0] = 200.0f; rd.camera.eye[1] = 160.0f; rd.camera.eye[2] = -90.0f;
    rd.camera.at[0] = rd.camera.at[2] = 64.0f; rd.camera.at[1] = 30.0f;
    image.rgba8 = a;
    CHECK(voxrt_render(&rd, t, &image, NULL) == VOXRT_OK);
    voxrt_model_geometry(m, &g);
    rd.geometry = &g;
    rd.geometry_count = 1;
    image.rgba8 = b;
    CHECK(voxrt_render(&rd, NULL, &image, NULL) == VOXRT_OK);
    CHECK(memcmp(a, b, sizeof a) == 0);
    CHECK(a[4 * (W * H / 2 + W / 2) + 3] == 255);
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
}

/* Models of trees whose resolution is no power of two reach as far as the others: triangles, too. */
TEST(beyond_the_resolution) {
    static float first[9] = {0, 0, 0, 99.5f, 0, 0, 0, 99.5f, 99.5f};
    static float wall[9] = {90.5f, 50.5f, 50.5f, 120.5f, 50.5f, 50.5f, 90.5f, 50.5f, 80.5f};
    const double lo[3] = {99, 49, 49}, hi[3] = {121, 52, 81};
    voxrt_mesh mesh;
    voxrt_build_desc bd;
    voxrt_edit_desc d;
    voxrt_edit_stats stats[2];
    voxrt_model *m = NULL, *plain = open_model(7, 0.0), *copy = NULL;
    voxrt_tree *t = NULL;
    uint32_t x, y, z, beyond = 0;
    memset(&mesh, 0, sizeof mesh);
    memset(&bd, 0, sizeof bd);
    memset(&d, 0, sizeof d);
    mesh.positions = first;
    mesh.vertex_count = 3;
    mesh.triangle_count = 1;
    bd.resolution = 100;
    bd.box_size = 100.0;
    REQUIRE(plain != NULL && voxrt_tree_build(&bd, &mesh, NULL, &t) == VOXRT_OK);
    REQUIRE(voxrt_model_from_tree(NULL, t, &m) == VOXRT_OK && voxrt_model_copy(NULL, m, &copy) == VOXRT_OK);
    mesh.positions = wall;
    REQUIRE(voxrt_model_mesh(m, &d, &mesh, &stats[0]) == VOXRT_OK);
    REQUIRE(voxrt_model_mesh(plain, &d, &mesh, &stats[1]) == VOXRT_OK);
    CHECK(stats[0].filled + stats[0].painted == stats[1].filled);
    for (z = 49; z < 82; z++)
        for (y = 49; y < 53; y++)
            for (x = 100; x < 122; x++) {
                const int is = voxrt_model_get(plain, 7, x, y, z, NULL);
                CHECK(voxrt_model_get(m, 7, x, y, z, NULL) == is);
                beyond += (uint32_t)is;
            }
    CHECK(beyond > 100);
    REQUIRE(voxrt_model_box(copy, &d, lo, hi, NULL) == VOXRT_OK);
    d.op = VOXRT_EDIT_CLEAR;
    REQUIRE(voxrt_model_mesh(copy, &d, &mesh, &stats[0]) == VOXRT_OK);
    CHECK(stats[0].cleared >= beyond && !voxrt_model_get(copy, 7, 105, 50, 55, NULL));
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
    voxrt_model_destroy(copy);
    voxrt_model_destroy(plain);
}

/* The mesh that a tree was made of finds the tree's voxels again, also those of faces on the far side of its box and of triangles
   that leave it; and voxels beyond are those of a whole grid. Without memory nothing changes. */
TEST(edits_by_the_same_mesh) {
    static const float corner[8][3] = {{0, 0, 0}, {20, 0, 0}, {0, 20, 0}, {20, 20, 0}, {0, 0, 20}, {20, 0, 20}, {0, 20, 20}, {20, 20, 20}};
    static const uint32_t cube[36] = {0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5};
    static const float cut[9] = {-1.5f, 2.2f, 4.1f, 24.9f, 6.3f, 8.8f, 12.1f, 23.7f, 18.3f};
    uint32_t way;
    for (way = 0; way < 4; way++) { /* the cube, the triangle; with planes */
        test_alloc ta;
        voxrt_mesh mesh;
        voxrt_build_desc bd;
        voxrt_edit_desc d;
        voxrt_model_info info, before;
        voxrt_edit_stats stats;
        voxrt_env env;
        voxrt_tree *t = NULL;
        voxrt_model *m = NULL, *copy = NULL, *whole = NULL;
        voxrt_result got = VOXRT_ERR_NO_MEMORY;
        uint32_t x, y, z, k, beyond = 0;
        memset(&mesh, 0, sizeof mesh);
        memset(&bd, 0, sizeof bd);
        memset(&d, 0, sizeof d);
        memset(&env, 0, sizeof env);
        test_alloc_init(&ta);
        mesh.positions = way % 2 ? cut : corner[0];
        mesh.vertex_count = way % 2 ? 3 : 8;
        mesh.indices = way % 2 ? NULL : cube;
        mesh.triangle_count = way % 2 ? 1 : 12;
        bd.resolution = 20;
        bd.box_size = 20.0;
        bd.planes = way / 2;
        REQUIRE(voxrt_tree_build(&bd, &mesh, NULL, &t) == VOXRT_OK);
        bd.resolution = 32;
        bd.box_size = 32.0;
        env.allocator.alloc_fn = test_alloc_fn;
        env.allocator.free_fn = test_free_fn;
        env.allocator.user = &ta;
        env.thread_count = 1;
        d.env = env;
        REQUIRE(voxrt_model_from_tree(&env, t, &m) == VOXRT_OK && voxrt_model_copy(&env, m, &copy) == VOXRT_OK);
        voxrt_tree_destroy(t);
        REQUIRE(voxrt_tree_build(&bd, &mesh, NULL, &t) == VOXRT_OK && voxrt_model_from_tree(NULL, t, &whole) == VOXRT_OK);
        voxrt_model_get_info(m, &before);
        for (k = 0; got == VOXRT_ERR_NO_MEMORY; k++) {
            ta.fail_at = ta.count + k;
            got = voxrt_model_mesh(m, &d, &mesh, &stats);
            if (got == VOXRT_OK) break;
            voxrt_model_get_info(m, &info);
            CHECK(got == VOXRT_ERR_NO_MEMORY && info.voxel_count == before.voxel_count);
        }
        ta.fail_at = -1;
        CHECK(k > 10);
        voxrt_model_get_info(m, &info);
        for (z = 0; z < 32; z++)
            for (y = 0; y < 32; y++)
                for (x = 0; x < 32; x++) {
                    const int is = voxrt_model_get(m, 5, x, y, z, NULL), out = x >= 20 || y >= 20 || z >= 20;
                    if (is != (out && way % 2 ? voxrt_model_get(whole, 5, x, y, z, NULL) : voxrt_model_get(copy, 5, x, y, z, NULL)))
                        CHECK_MSG(0, "way %u: %u %u %u", way, x, y, z);
                    beyond += (uint32_t)(is && out);
                }
        CHECK(way % 2 ? beyond > 10 : beyond == 0);
        CHECK_EQ_U64(info.voxel_count, before.voxel_count + beyond);
        d.op = VOXRT_EDIT_CLEAR;
        CHECK(voxrt_model_mesh(m, &d, &mesh, &stats) == VOXRT_OK);
        CHECK(voxrt_model_mesh(copy, &d, &mesh, &stats) == VOXRT_OK);
        voxrt_model_get_info(copy, &info);
        CHECK_EQ_U64(info.voxel_count, 0);
        voxrt_model_get_info(m, &info);
        CHECK_EQ_U64(info.voxel_count, 0);
        voxrt_tree_destroy(t);
        voxrt_model_destroy(m);
        voxrt_model_destroy(copy);
        voxrt_model_destroy(whole);
        test_alloc_check(&ta);
    }
}

/* Without memory nothing has happened, and nothing leaks. */
typedef struct failing { uint32_t left; int64_t bytes; } failing;
static void *failing_alloc(size_t size, void *user) {
    failing *f = (failing *)user;
    if (f->left == 0) return NULL;
    f->left--;
    f->bytes += (int64_t)size;
    return malloc(size);
}
static void failing_free(void *p, size_t size, void *user) {
    failing *f = (failing *)user;
    f->bytes -= (int64_t)size;
    free(p);
}

TEST(allocation_failures) {
    const double centre[3] = {60, 66, 64}, other[3] = {30, 64, 64};
    failing f;
    voxrt_model_desc md;
    voxrt_model *m = NULL, *copy = NULL, *of_tree = NULL;
    voxrt_tree *t = NULL;
    voxrt_build_desc bd;
    voxrt_edit_desc d;
    voxrt_env env;
    uint64_t hash;
    uint32_t step, n = 0, k;
    memset(&md, 0, sizeof md);
    memset(&d, 0, sizeof d);
    memset(&bd, 0, sizeof bd);
    memset(&env, 0, sizeof env);
    f.left = 0xffffffffu;
    f.bytes = 0;
    md.depth = 7;
    env.allocator.alloc_fn = failing_alloc;
    env.allocator.free_fn = failing_free;
    env.allocator.user = &f;
    env.thread_count = 1;
    md.env = d.env = bd.env = env;
    d.rgb[0] = 9;
    REQUIRE(voxrt_model_create(&md, &m) == VOXRT_OK && voxrt_model_sphere(m, &d, centre, 8.0, NULL) == VOXRT_OK);
    REQUIRE(voxrt_tree_from_model(&bd, m, &t) == VOXRT_OK);
    hash = voxrt_tree_hash(t);
    for (step = 0; step < 4; step++) {
        for (n = 0;; n += test_quick() ? 1 + n / 16 : 1) { /* quick: the first ones all, later ones some */
            const int64_t before = f.bytes;
            voxrt_result r;
            f.left = n;
            if (step == 0) r = voxrt_model_copy(&env, m, &copy);
            else if (step == 1) r = voxrt_model_from_tree(&env, t, &of_tree);
            else {
                d.op = step == 2 ? VOXRT_EDIT_CLEAR : VOXRT_EDIT_SET;
                r = voxrt_model_sphere(step == 2 ? copy : of_tree, &d, other, 30.0, NULL);
            }
            f.left = 0xffffffffu;
            if (r == VOXRT_OK) break;
            CHECK(r == VOXRT_ERR_NO_MEMORY);
            CHECK(f.bytes == before);
            if (step >= 2 && n % (n < 64 ? 4 : 16) == 0) {
                voxrt_tree *now = NULL;
                REQUIRE(voxrt_tree_from_model(&bd, step == 2 ? copy : of_tree, &now) == VOXRT_OK);
                CHECK(voxrt_tree_hash(now) == hash);
                voxrt_tree_destroy(now);
            }
        }
        CHECK(n > 5);
    }
    for (k = 0, n = 0; n < 100; n++) { /* a limit is kept, and nothing is lost */
        env.memory_limit = 1000 * n;
        d.env = env;
        k += voxrt_model_sphere(m, &d, other, 30.0, NULL) == VOXRT_ERR_NO_MEMORY;
    }
    CHECK(k > 5);
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
    voxrt_model_destroy(copy);
    voxrt_model_destroy(of_tree);
    CHECK(f.bytes == 0);
}

/* What calls on models hold at once stays below their limit, with as many blocks as there are voxels. */
TEST(memory_limits) {
    enum { N = 500 };
    voxrt_model_desc md;
    voxrt_edit_desc d;
    voxrt_voxel *v = (voxrt_voxel *)calloc(N, sizeof *v);
    voxrt_model *m = NULL;
    voxrt_tree *t = NULL;
    voxrt_build_desc bd;
    uint32_t i, step, n;
    REQUIRE(v != NULL);
    memset(&md, 0, sizeof md);
    memset(&d, 0, sizeof d);
    memset(&bd, 0, sizeof bd);
    md.depth = 12;
    for (i = 0; i < N; i++) {
        v[i].x = (uint16_t)(64 * (i % 64) + i % 61);
        v[i].y = (uint16_t)(64 * (i / 64) + i % 59);
        v[i].z = (uint16_t)(i % 4096);
        v[i].rgb[i % 3] = 200;
    }
    REQUIRE(voxrt_model_create(&md, &m) == VOXRT_OK && voxrt_model_voxels(m, &d, v, N, NULL) == VOXRT_OK);
    REQUIRE(voxrt_tree_from_model(&bd, m, &t) == VOXRT_OK);
    for (step = 0; step < 4; step++) {
        uint32_t refused = 0, done = 0;
        for (n = 1; n < 100 && done < 3; n++) {
            voxrt_env env;
            voxrt_model *out = NULL;
            voxrt_tree *tree = NULL;
            voxrt_result r;
            test_alloc ta;
            memset(&env, 0, sizeof env);
            test_alloc_init(&ta);
            env.allocator.alloc_fn = test_alloc_fn;
            env.allocator.free_fn = test_free_fn;
            env.allocator.user = &ta;
            env.thread_count = 1 + n % 3;
            md.env = bd.env = d.env = env;
            if (step == 3) REQUIRE(voxrt_model_create(&md, &out) == VOXRT_OK);
            env.memory_limit = (size_t)n * (step == 0 ? 10000 : 100000);
            bd.env = d.env = env;
            if (step == 0) r = voxrt_model_copy(&env, m, &out);
            else if (step == 1) r = voxrt_model_from_tree(&env, t, &out);
            else if (step == 2) r = voxrt_tree_from_model(&bd, m, &tree);
            else r = voxrt_model_voxels(out, &d, v, N, NULL);
            refused += r == VOXRT_ERR_NO_MEMORY;
            done += r == VOXRT_OK;
            CHECK(r == VOXRT_OK || r == VOXRT_ERR_NO_MEMORY);
            CHECK_MSG(ta.peak_bytes <= env.memory_limit + (step == 3 ? 4096 : 0), "%u: %lu bytes with a limit of %lu", step,
                      (unsigned long)ta.peak_bytes, (unsigned long)env.memory_limit); /* an empty model was there before */
            voxrt_model_destroy(out);
            voxrt_tree_destroy(tree);
            test_alloc_check(&ta);
        }
        CHECK_MSG(refused >= 1 && done == 3, "%u: %u, %u", step, refused, done);
    }
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
    free(v);
}

TEST(arguments) {
    const double lo[3] = {0, 0, 0}, hi[3] = {1e300, 1e300, 1e300}, bad[3] = {0, (double)NAN, 0};
    voxrt_model *m = open_model(3, 0.0), *deep = open_model(20, 0.0);
    voxrt_model_desc md;
    voxrt_edit_desc d;
    voxrt_edit_stats stats;
    voxrt_error error;
    voxrt_geometry g;
    voxrt_trace_desc td;
    voxrt_ray ray;
    voxrt_surface s;
    uint8_t hidden = 1;
    REQUIRE(m != NULL && deep != NULL);
    memset(&md, 0, sizeof md);
    memset(&d, 0, sizeof d);
    memset(&td, 0, sizeof td);
    memset(&ray, 0, sizeof ray);
    d.env.error = md.env.error = &error;
    ray.dir[0] = 1.0f;
    ray.t_max = INFINITY;
    voxrt_model_geometry(m, &g); /* nothing is in it */
    g.trace_fn(g.user, &td, &ray, &s, 1);
    g.occluded_fn(g.user, &td, &ray, &hidden, 1);
    CHECK(s.t == INFINITY && hidden == 0 && !voxrt_model_get(m, 0, 0, 0, 0, NULL) && g.box_max[0] == 8.0);
    CHECK(voxrt_model_box(m, &d, lo, bad, &stats) == VOXRT_ERR_INVALID_ARG && error.code == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_model_sphere(m, &d, bad, 1.0, &stats) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_model_box(m, &d, NULL, hi, &stats) == VOXRT_ERR_INVALID_ARG && strcmp(error.text, "no box") == 0);
    CHECK(voxrt_model_box(m, &d, lo, NULL, &stats) == VOXRT_ERR_INVALID_ARG && strcmp(error.text, "no box") == 0);
    CHECK(voxrt_model_sphere(m, &d, NULL, 1.0, &stats) == VOXRT_ERR_INVALID_ARG && strcmp(error.text, "no centre") == 0);
    CHECK(voxrt_model_sphere(m, &d, lo, -1.0, &stats) == VOXRT_OK && stats.filled == 0);
    CHECK(voxrt_model_box(m, &d, hi, lo, &stats) == VOXRT_OK && stats.filled == 0);
    CHECK(voxrt_model_box(m, &d, lo, hi, &stats) == VOXRT_OK && stats.filled == 512 && stats.blocks == 1);
    CHECK(voxrt_model_sphere(m, &d, lo, 1e300, &stats) == VOXRT_OK && stats.painted == 512);
    CHECK(voxrt_model_box(deep, &d, lo, hi, &stats) == VOXRT_ERR_RANGE);
    CHECK(voxrt_model_sphere(deep, &d, lo, 20.0, &stats) == VOXRT_OK && stats.filled > 3000 && stats.filled < 5000);
    d.op = VOXRT_EDIT_CLEAR; /* more blocks than there are */
    CHECK(voxrt_model_box(deep, &d, lo, hi, &stats) == VOXRT_OK && stats.cleared > 3000);
    CHECK(!voxrt_model_get(deep, 20, 0, 0, 0, NULL));
    d.op = (voxrt_edit_op)3;
    CHECK(voxrt_model_box(m, &d, lo, hi, &stats) == VOXRT_ERR_INVALID_ARG);
    d._begin_zero = 1;
    CHECK(voxrt_model_box(m, &d, lo, hi, &stats) == VOXRT_ERR_UNINIT_DESC);
    md.depth = 21;
    voxrt_model_destroy(m);
    CHECK(voxrt_model_create(&md, &m) == VOXRT_ERR_RANGE && m == NULL);
    m = open_model(3, 0.0);
    CHECK(voxrt_model_mesh(m, NULL, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    {
        static const float corner[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
        voxrt_mesh mesh;
        memset(&mesh, 0, sizeof mesh);
        d.op = (voxrt_edit_op)0;
        d._begin_zero = 0;
        mesh.positions = corner;
        mesh.vertex_count = 3;
        mesh.triangle_count = SIZE_MAX;
        CHECK(voxrt_model_mesh(m, &d, &mesh, &stats) == VOXRT_ERR_RANGE && error.where == SIZE_MAX && strstr(error.text, "too many") != NULL);
        mesh.triangle_count = 1;
        mesh.position_stride = 8;
        CHECK(voxrt_model_mesh(m, &d, &mesh, &stats) == VOXRT_ERR_INVALID_ARG && strstr(error.text, "stride") != NULL);
        mesh.position_stride = 12;
        CHECK(voxrt_model_mesh(m, &d, &mesh, &stats) == VOXRT_OK && stats.filled > 0);
    }
    CHECK(voxrt_model_voxels(m, NULL, NULL, 1, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_model_box(NULL, NULL, lo, hi, NULL) == VOXRT_ERR_INVALID_ARG);
    voxrt_model_destroy(m);
    voxrt_model_destroy(deep);
    voxrt_model_destroy(NULL);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(random_edits);
    RUN(lists_meshes_and_trees);
    RUN(holes_of_lists);
    RUN(undo);
    RUN(edges_of_blocks);
    RUN(same_picture);
    RUN(beyond_the_resolution);
    RUN(edits_by_the_same_mesh);
    RUN(allocation_failures);
    RUN(memory_limits);
    RUN(arguments);
    return test_end();
}
