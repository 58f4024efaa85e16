/* Edits of built scenes: after any of them everything in the structures is what a build would have made of it, and the scene
   is the one that was asked for: areas, counts, boxes, points and pictures against a scene of flattened meshes built anew. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "zbufrand_shapes.h"

static zbufrand_error g_error;

static zbufrand_scene *open_scene(uint32_t threads, test_alloc *alloc) {
    zbufrand_scene_desc d;
    zbufrand_scene *s = NULL;
    memset(&d, 0, sizeof d);
    d.env.error = &g_error;
    d.env.thread_count = threads;
    if (alloc != NULL) {
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = alloc;
    }
    if (zbufrand_scene_create(&d, &s) != ZBUFRAND_OK) abort();
    return s;
}

/* A rotation, a scale, mirrored or not, a place within `reach`. */
static zbufrand_transform any_transform(test_rng *r, double reach) {
    zbufrand_transform t;
    double q[9], scale = 0.4 + test_rng_double(r);
    uint32_t a, b;
    shape_rotation(test_rng_double(r), test_rng_double(r), test_rng_double(r), q);
    if (test_rng_below(r, 4) == 0) scale = -scale;
    for (a = 0; a < 3; a++) {
        for (b = 0; b < 3; b++) t.m[a][b] = q[3 * a + b] * scale;
        t.m[a][3] = reach * (2 * test_rng_double(r) - 1);
    }
    return t;
}

/* ---- is everything in there what it should be? ---- */

static uint64_t hash_structure(const zbufrandi_structure *s) {
    uint64_t h = 0;
    if (s->node_count == 0) return 1;
    h = test_fnv1a(s->node, s->node_count * sizeof *s->node, h);
    h = test_fnv1a(s->set, ((size_t)s->cluster_count + s->node_count) * 512, h);
    if (s->set_rgb != NULL) h = test_fnv1a(s->set_rgb, ((size_t)s->cluster_count + s->node_count) * 256, h);
    h = test_fnv1a(s->instance, s->instance_count * sizeof *s->instance, h);
    return h;
}

static int same_lane(const zbufrandi_lane *a, const zbufrandi_lane *b) {
    return memcmp(a->lo, b->lo, sizeof a->lo) == 0 && memcmp(a->hi, b->hi, sizeof a->hi) == 0 &&
           memcmp(a->axis, b->axis, sizeof a->axis) == 0 && !(a->cosine < b->cosine) && !(a->cosine > b->cosine) &&
           !(a->o_lo < b->o_lo) && !(a->o_lo > b->o_lo) && !(a->o_hi < b->o_hi) && !(a->o_hi > b->o_hi) && !(a->area < b->area) &&
           !(a->area > b->area) && !(a->edge < b->edge) && !(a->edge > b->edge) && a->triangles == b->triangles && a->flags == b->flags;
}

/* Each lane against what it stands for, by the functions that built it; each leaf once. Returns how many leaves. */
static uint32_t check_node(const zbufrand_scene *scene, uint32_t index, uint32_t node, uint32_t depth, uint8_t *seen, uint8_t *nodes) {
    const zbufrandi_structure *s = &scene->structure[index];
    const zbufrandi_live_structure *l = &scene->live->s[index];
    const zbufrandi_node8 *n = &s->node[node];
    uint32_t i, leaves = 0;
    CHECK(depth < 60 && n->count >= 1 && n->count <= 8 && nodes[node] == 0);
    nodes[node] = 1;
    for (i = 0; i < 8; i++) {
        const uint32_t kind = ZBUFRANDI_CHILD_KIND(n->child[i]), at = ZBUFRANDI_CHILD_INDEX(n->child[i]);
        zbufrandi_lane is, be;
        zbufrandi_shape measured;
        if (i >= n->count) {
            CHECK(kind == ZBUFRANDI_CHILD_NONE && n->lo[0][i] > n->hi[0][i] && !(n->area[i] > 0.0f));
            continue;
        }
        zbufrandi_lane_get(n, i, &is);
        be = is;
        if (kind == ZBUFRANDI_CHILD_NODE) {
            CHECK_EQ_U64(l->health[at].up, 8 * node + i);
            leaves += check_node(scene, index, at, depth + 1, seen, nodes);
            zbufrandi_node_lane(&s->node[at], &be);
        } else if (kind == ZBUFRANDI_CHILD_CLUSTER) {
            CHECK_EQ_U64(l->at[at], 8 * node + i);
            CHECK_EQ_U64(seen[at]++, 0);
            zbufrandi_measure_cluster(s, at, &measured, &be);
            leaves++;
        } else {
            CHECK_EQ_U64(l->at[s->cluster_count + at], 8 * node + i);
            CHECK_EQ_U64(seen[s->cluster_count + at]++, 0);
            CHECK(zbufrandi_instance_box(&s->instance[at], &scene->structure[s->instance[at].structure], be.lo, be.hi));
            zbufrandi_instance_lane(scene, &s->instance[at], &be);
            CHECK(s->depth > scene->structure[s->instance[at].structure].depth);
            CHECK(!s->instance[at].hidden);
            leaves++;
        }
        CHECK_MSG(same_lane(&is, &be), "structure %u node %u lane %u kind %u is stale", index, node, i, kind);
    }
    CHECK_EQ_U64(l->health[node].leaves, leaves);
    CHECK_EQ_U64(l->health[node].height, zbufrandi_live_height(s, l, node));
    CHECK(!l->is_dirty[node]);
    return leaves;
}

static void check_scene(zbufrand_scene *scene) {
    uint32_t i, k;
    if (scene->live == NULL) return;
    CHECK_EQ_U64(scene->pending_count + scene->gone_count + scene->set_count, 0);
    CHECK_EQ_U64(scene->live->touched_count, 0);
    for (i = 0; i < scene->structure_count; i++) {
        zbufrandi_structure *s = &scene->structure[i];
        const zbufrandi_live_structure *l = &scene->live->s[i];
        const size_t items = (size_t)s->cluster_count + s->instance_count;
        uint8_t *seen = (uint8_t *)calloc(items + 1, 1), *nodes = (uint8_t *)calloc(s->node_count + 1u, 1);
        uint32_t count = 0, uses = 0, made = 0;
        uint64_t hash = hash_structure(s);
        zbufrandi_build b;
        zbufrandi_use use;
        if (seen == NULL || nodes == NULL) abort();
        if (l->used) {
            CHECK_EQ_U64(l->dirty_count, 0);
            if (s->node_count != 0) (void)check_node(scene, i, 0, 0, seen, nodes);
            for (k = 0; k < s->node_count; k++) count += nodes[k];
            CHECK_EQ_U64(count + l->free_nodes, s->node_count);
            for (k = 0, count = 0; k < s->cluster_count; k++) count += !seen[k];
            CHECK_EQ_U64(count, l->dead_clusters);
            for (k = 0, count = 0; k < s->instance_count; k++) {
                const zbufrandi_instance *it = &s->instance[k];
                if (!(it->scale > 0.0)) count++;
                else CHECK_EQ_U64(seen[s->cluster_count + k], !it->hidden && scene->structure[it->structure].node_count != 0);
            }
            CHECK_EQ_U64(count, l->free_instances);
            for (use = l->first; use.structure != ZBUFRANDI_NIL; use = scene->live->s[use.structure].next[use.instance]) {
                CHECK_EQ_U64(scene->structure[use.structure].instance[use.instance].structure, i);
                uses++;
            }
            for (k = 0; k < scene->structure_count; k++) {
                uint32_t j;
                for (j = 0; j < scene->structure[k].instance_count; j++)
                    made += scene->structure[k].instance[j].scale > 0.0 && scene->structure[k].instance[j].structure == i;
            }
            CHECK_EQ_U64(uses, made);
            memset(&b, 0, sizeof b); /* stored points: making them again changes nothing */
            b.scene = scene;
            b.s = s;
            b.index = i;
            for (k = 0; k < s->node_count; k++) if (nodes[k]) zbufrandi_node_finish(&b, k);
            CHECK_EQ_U64(hash_structure(s), hash);
        }
        free(seen);
        free(nodes);
    }
}

/* ---- a model of the graph, flattened ---- */

enum { LIST, MESH, REFERENCE, ARRAY, NODES = 4000, MESHES = 4, ENTRIES = 6, PIECES = 4096 };

typedef struct model_node {
    zbufrand_node id;
    int kind, parent, mesh, target, alive, hidden, refs;
    zbufrand_transform m;
    zbufrand_transform entry[ENTRIES]; /* of arrays: as they are; `given` was handed over and is borrowed */
    zbufrand_transform given[ENTRIES];
    int drawn[ENTRIES];
} model_node;

typedef struct piece { zbufrand_transform m; int mesh; } piece;

typedef struct model {
    model_node *node;
    int count;
    shape mesh[MESHES];
    double area[MESHES];
    piece *piece;
    int pieces;
} model;

static zbufrand_transform times(const zbufrand_transform *a, const zbufrand_transform *b) {
    zbufrand_transform r;
    int i, j;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 4; j++)
            r.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j] + (j == 3 ? a->m[i][3] : 0.0);
    }
    return r;
}

static void flatten(model *w, int at, const zbufrand_transform *m) { /* what the node is, in its own coordinates */
    const model_node *n = &w->node[at];
    int i;
    if (n->kind == MESH) {
        if (w->pieces < PIECES) {
            w->piece[w->pieces].m = *m;
            w->piece[w->pieces++].mesh = n->mesh;
        }
    } else if (n->kind == REFERENCE) {
        flatten(w, n->target, m);
    } else if (n->kind == ARRAY) {
        for (i = 0; i < ENTRIES; i++) {
            zbufrand_transform t = times(m, &n->entry[i]);
            if (n->drawn[i]) flatten(w, n->target, &t);
        }
    } else {
        for (i = 1; i < w->count; i++) {
            zbufrand_transform t;
            if (!w->node[i].alive || w->node[i].parent != at || w->node[i].hidden) continue;
            t = times(m, &w->node[i].m);
            flatten(w, i, &t);
        }
    }
}

static void model_open(model *w) {
    int k;
    size_t i;
    memset(w, 0, sizeof *w);
    w->node = (model_node *)calloc(NODES, sizeof *w->node);
    w->piece = (piece *)calloc(PIECES, sizeof *w->piece);
    if (w->node == NULL || w->piece == NULL) abort();
    shape_box(&w->mesh[0], -0.5, -0.5, -0.5, 0.5, 0.5, 0.5);
    shape_sphere(&w->mesh[1], 0, 0, 0, 0.6, 8);
    shape_sphere(&w->mesh[2], 0.2, 0, 0, 0.4, 14);
    shape_box(&w->mesh[3], -1, -0.05, -1, 1, 0.05, 1);
    for (k = 0; k < MESHES; k++) {
        for (i = 0; i < w->mesh[k].triangles; i++) {
            const uint32_t *t = w->mesh[k].t + 3 * i;
            double n[3];
            zbufrandi_cross(w->mesh[k].p + 3 * t[0], w->mesh[k].p + 3 * t[1], w->mesh[k].p + 3 * t[2], n);
            w->area[k] += 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        }
    }
    w->node[0].id = ZBUFRAND_ROOT;
    w->node[0].alive = 1;
    w->node[0].m = move_scale(0, 0, 0, 1);
    w->count = 1;
}

static void model_close(model *w) {
    int k;
    for (k = 0; k < MESHES; k++) shape_free(&w->mesh[k]);
    free(w->node);
    free(w->piece);
}

static int model_add(model *w, zbufrand_scene *s, int kind, int parent, const zbufrand_transform *m, int what, int hidden, test_rng *r) {
    model_node *n = &w->node[w->count];
    zbufrand_mesh mesh;
    zbufrand_result result = ZBUFRAND_OK;
    int i;
    if (w->count == NODES) return 0;
    memset(n, 0, sizeof *n);
    n->kind = kind;
    n->parent = parent;
    n->m = *m;
    n->hidden = hidden;
    n->alive = 1;
    if (kind == LIST) result = zbufrand_add_list(s, w->node[parent].id, m, hidden ? ZBUFRAND_HIDDEN : 0, &n->id);
    if (kind == MESH) {
        n->mesh = what;
        mesh = mesh_of(&w->mesh[what]);
        result = zbufrand_add_mesh(s, w->node[parent].id, m, hidden ? ZBUFRAND_HIDDEN : 0, &mesh, &n->id);
    }
    if (kind >= REFERENCE) {
        n->target = what;
        w->node[what].refs++;
    }
    if (kind == REFERENCE) result = zbufrand_add_reference(s, w->node[parent].id, m, w->node[what].id, &n->id);
    if (kind == ARRAY) {
        n->m = move_scale(0, 0, 0, 1);
        for (i = 0; i < ENTRIES; i++) {
            n->given[i] = n->entry[i] = any_transform(r, 6);
            n->drawn[i] = 1;
        }
        result = zbufrand_add_references(s, w->node[parent].id, n->given, ENTRIES, w->node[what].id, &n->id);
    }
    CHECK_EQ_U64(result, ZBUFRAND_OK);
    return w->count++;
}

/* Dead, with all below. */
static void model_kill(model *w, int at) {
    int i;
    w->node[at].alive = 0;
    if (w->node[at].kind >= REFERENCE) w->node[w->node[at].target].refs--;
    for (i = 1; i < w->count; i++) if (w->node[i].alive && w->node[i].parent == at) model_kill(w, i);
}

static int model_below(const model *w, int at, int top) { /* is `at` in `top`? */
    for (; at != 0; at = w->node[at].parent) if (at == top) return 1;
    return top == 0;
}

/* May it be removed: does nothing outside of it refer into it? */
static int model_removable(const model *w, int top) {
    int i;
    for (i = 1; i < w->count; i++)
        if (w->node[i].alive && w->node[i].kind >= REFERENCE && model_below(w, w->node[i].target, top) && !model_below(w, i, top)) return 0;
    return 1;
}

static int model_pick(const model *w, test_rng *r, int kind) { /* a living node of that kind, -1: any but the root; 0: none */
    int tries;
    for (tries = 0; tries < 200; tries++) {
        const int at = 1 + (int)test_rng_below(r, (uint32_t)(w->count > 1 ? w->count - 1 : 1));
        if (at < w->count && w->node[at].alive && (kind < 0 || w->node[at].kind == kind)) return at;
    }
    return 0;
}

/* One edit that is allowed, of the scene and of the model. `library` is a hidden list: its members may be referred to, and refer
   to members before them. */
static void model_edit(model *w, zbufrand_scene *s, test_rng *r, int library) {
    const uint32_t what = test_rng_below(r, 12);
    zbufrand_transform t = any_transform(r, 8);
    int at, list, target;
    list = test_rng_below(r, 3) == 0 ? model_pick(w, r, LIST) : 0;
    if (what <= 1) {
        (void)model_add(w, s, MESH, list, &t, (int)test_rng_below(r, MESHES), list == library && test_rng_below(r, 2), r);
    } else if (what == 2) {
        (void)model_add(w, s, LIST, list, &t, 0, 0, r);
    } else if (what <= 5) { /* a reference from outside to the library, or within it to what came before */
        target = model_pick(w, r, -1);
        if (target == 0 || !model_below(w, target, library) || target == library) return;
        if (model_below(w, list, library)) { /* the member of the library that it would be part of has to come later */
            int member = list, of = target;
            if (list == library) member = w->count;
            while (member < w->count && w->node[member].parent != library) member = w->node[member].parent;
            while (w->node[of].parent != library) of = w->node[of].parent;
            if (of >= member) return;
        }
        (void)model_add(w, s, test_rng_below(r, 3) == 0 ? ARRAY : REFERENCE, list, &t, target, 0, r);
    } else if (what <= 8) {
        at = model_pick(w, r, -1);
        if (at == 0) return;
        CHECK_EQ_U64(zbufrand_move(s, w->node[at].id, &t), ZBUFRAND_OK);
        w->node[at].m = t;
    } else if (what == 9) {
        const uint32_t i = test_rng_below(r, ENTRIES);
        const int drawn = test_rng_below(r, 3) != 0;
        at = model_pick(w, r, ARRAY);
        if (at == 0 || (s->graph[w->node[at].id].home == 0 && s->graph[w->node[at].id].structure == 0)) return; /* not built */
        CHECK_EQ_U64(zbufrand_set_reference(s, w->node[at].id, i, drawn ? &t : NULL), ZBUFRAND_OK);
        w->node[at].drawn[i] = drawn;
        if (drawn) w->node[at].entry[i] = t;
    } else {
        at = model_pick(w, r, -1);
        if (at == 0 || at == library) return;
        if (!model_removable(w, at)) {
            CHECK_EQ_U64(zbufrand_remove(s, w->node[at].id), ZBUFRAND_ERR_INVALID_ARG);
            return;
        }
        CHECK_EQ_U64(zbufrand_remove(s, w->node[at].id), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_move(s, w->node[at].id, NULL), ZBUFRAND_ERR_INVALID_ARG);
        model_kill(w, at);
    }
}

static zbufrand_scene *model_build(const model *w, zbufrand_scene_info *info) { /* flattened, anew */
    zbufrand_scene *s = open_scene(1, NULL);
    int i;
    for (i = 0; i < w->pieces; i++) {
        zbufrand_mesh m = mesh_of(&w->mesh[w->piece[i].mesh]);
        CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, &w->piece[i].m, 0, &m, NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, info), ZBUFRAND_OK);
    return s;
}

static void flatten_all(model *w) {
    const zbufrand_transform unit = move_scale(0, 0, 0, 1);
    w->pieces = 0;
    flatten(w, 0, &unit);
}

/* Points of both by slabs of x, y and z, independent ones: the same law? */
static void compare_points(const zbufrand_scene *a, const zbufrand_scene *b, const zbufrand_scene_info *info, uint32_t seed) {
    enum { N = 20000, SLABS = 12 };
    static float pa[3 * N], pb[3 * N];
    zbufrand_surface_points_desc d;
    int k, i;
    memset(&d, 0, sizeof d);
    d.independent = 1;
    d.seed = seed;
    CHECK_EQ_U64(zbufrand_surface_points(a, &d, N, pa, NULL, NULL, NULL), ZBUFRAND_OK);
    d.seed = seed + 1;
    CHECK_EQ_U64(zbufrand_surface_points(b, &d, N, pb, NULL, NULL, NULL), ZBUFRAND_OK);
    for (k = 0; k < 3; k++) {
        double count[2][SLABS], chi = 0, wide = info->box_max[k] - info->box_min[k];
        int used = 0;
        memset(count, 0, sizeof count);
        for (i = 0; i < N; i++) {
            const double x = ((double)pa[3 * i + k] - info->box_min[k]) / wide, y = ((double)pb[3 * i + k] - info->box_min[k]) / wide;
            CHECK(x > -1e-3 && x < 1.001);
            count[0][x <= 0 ? 0 : x >= 1 ? SLABS - 1 : (int)(x * SLABS)]++;
            count[1][y <= 0 ? 0 : y >= 1 ? SLABS - 1 : (int)(y * SLABS)]++;
        }
        for (i = 0; i < SLABS; i++) {
            const double sum = count[0][i] + count[1][i], d2 = count[0][i] - count[1][i];
            if (sum < 10) continue;
            chi += d2 * d2 / sum;
            used++;
        }
        CHECK_MSG(chi < 50.0, "chi-square %g of %d slabs along %d", chi, used, k); /* p below 1e-6 for 12 */
    }
}

static zbufrand_frame *g_frame;

static void draw(const zbufrand_scene *s, const zbufrand_camera *c, zbufrand_hybrid hybrid, float *depth, uint32_t width, uint32_t height) {
    zbufrand_render_desc d;
    zbufrand_image m;
    zbufrand_frame_desc fd;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    memset(&fd, 0, sizeof fd);
    fd.env.thread_count = 1;
    if (g_frame == NULL) CHECK_EQ_U64(zbufrand_frame_create(&fd, &g_frame), ZBUFRAND_OK);
    d.camera = *c;
    d.hybrid = hybrid;
    m.width = width;
    m.height = height;
    m.depth = depth;
    CHECK_EQ_U64(zbufrand_render(g_frame, &d, s, &m, NULL), ZBUFRAND_OK);
}

/* Rastered pictures of both, and a sampled one of the edited scene, agree in nearly all pixels. */
static void compare_pictures(const zbufrand_scene *edited, const zbufrand_scene *anew, const zbufrand_scene_info *info) {
    enum { W = 160, H = 120 };
    static float a[W * H], b[W * H], c[W * H];
    zbufrand_camera camera;
    int i, off = 0, wrong = 0, covered = 0;
    memset(&camera, 0, sizeof camera);
    camera.up[1] = 1;
    CHECK_EQ_U64(zbufrand_camera_fit(&camera, info->box_min, info->box_max, NULL, W, H), ZBUFRAND_OK);
    draw(edited, &camera, ZBUFRAND_HYBRID_ALL, a, W, H);
    draw(anew, &camera, ZBUFRAND_HYBRID_ALL, b, W, H);
    draw(edited, &camera, ZBUFRAND_HYBRID_OFF, c, W, H);
    for (i = 0; i < W * H; i++) {
        covered += b[i] < INFINITY;
        off += (a[i] < INFINITY) != (b[i] < INFINITY) || (a[i] < INFINITY && fabsf(a[i] - b[i]) > 2e-3f * b[i]);
        wrong += b[i] < INFINITY && !(fabsf(c[i] - b[i]) < 0.1f * b[i]);
    }
    CHECK_MSG(off <= 12, "%d of %d pixels differ", off, covered); /* edges, by rounding */
    CHECK_MSG(wrong <= covered / 12 + 20, "%d of %d sampled pixels are far off", wrong, covered); /* silhouettes */
}

static void compare(model *w, zbufrand_scene *s, uint32_t seed, int thorough) {
    zbufrand_scene_info is, be;
    zbufrand_scene *anew;
    double area = 0;
    uint64_t triangles = 0;
    int i, k;
    flatten_all(w);
    REQUIRE(w->pieces < PIECES);
    zbufrand_scene_get_info(s, &is);
    for (i = 0; i < w->pieces; i++) {
        const double scale = zbufrandi_m34_scale(ZBUFRANDI_M34(w->piece[i].m.m), ZBUFRANDI_SIMILAR_PRODUCT);
        triangles += w->mesh[w->piece[i].mesh].triangles;
        area += w->area[w->piece[i].mesh] * scale * scale;
    }
    CHECK_EQ_U64(is.triangles, triangles);
    CHECK_NEAR(is.area, area, 1e-5 * area + 1e-12);
    check_scene(s);
    if (!thorough) return;
    anew = model_build(w, &be);
    CHECK_EQ_U64(be.triangles, is.triangles);
    if (w->pieces > 0) {
        for (k = 0; k < 3; k++) { /* boxes of instances are those of turned boxes: never smaller */
            const double wide = be.box_max[k] - be.box_min[k];
            CHECK(is.box_min[k] <= be.box_min[k] + 1e-5 * wide && is.box_max[k] >= be.box_max[k] - 1e-5 * wide);
            CHECK(is.box_min[k] >= be.box_min[k] - 3 * wide - 3 && is.box_max[k] <= be.box_max[k] + 3 * wide + 3);
        }
        compare_points(s, anew, &be, seed);
        compare_pictures(s, anew, &be);
    } else {
        CHECK(is.box_min[0] > is.box_max[0]);
    }
    zbufrand_scene_destroy(anew);
}

static int model_start(model *w, zbufrand_scene *s, test_rng *r) { /* something of everything; returns the library */
    int library, list, i;
    zbufrand_transform t = move_scale(0, 0, 0, 1);
    library = model_add(w, s, LIST, 0, &t, 0, 1, r);
    for (i = 0; i < 3; i++) (void)model_add(w, s, MESH, library, &t, i, 0, r);
    list = model_add(w, s, LIST, library, &t, 0, 0, r);
    t = any_transform(r, 2);
    (void)model_add(w, s, MESH, list, &t, 3, 0, r);
    t = any_transform(r, 2);
    (void)model_add(w, s, REFERENCE, list, &t, 2, 0, r);
    for (i = 0; i < 20; i++) {
        t = any_transform(r, 8);
        if (i % 4 == 0) (void)model_add(w, s, MESH, 0, &t, i % MESHES, 0, r);
        else if (i % 4 == 1) (void)model_add(w, s, REFERENCE, 0, &t, list, 0, r);
        else if (i % 4 == 2) list = list + 0 * model_add(w, s, LIST, 0, &t, 0, 0, r);
        else (void)model_add(w, s, i == 7 ? ARRAY : MESH, w->count - 1, &t, i == 7 ? 3 : 1, 0, r);
    }
    return library;
}

TEST(any_sequence_of_edits) {
    const uint32_t rounds = test_quick() ? 20 : 60;
    uint32_t seed, k, n;
    for (seed = 1; seed <= (test_quick() ? 2u : 4u); seed++) {
        test_rng r = test_rng_make(seed);
        zbufrand_scene *s = open_scene(1 + seed % 2, NULL);
        model w;
        int library;
        model_open(&w);
        library = model_start(&w, s, &r);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        compare(&w, s, seed, 0);
        for (k = 0; k < rounds; k++) {
            for (n = 1 + test_rng_below(&r, k % 10 == 9 ? 40 : 5); n > 0; n--) model_edit(&w, s, &r, library);
            REQUIRE(zbufrand_scene_update(s, NULL) == ZBUFRAND_OK);
            flatten_all(&w);
            compare(&w, s, seed * 1000 + k, k % 12 == 11);
            if (w.pieces > 2500 || w.count > NODES - 100) break;
        }
        { /* a build of the same graph makes the same scene; arrays are read as they were given */
            int i;
            zbufrand_scene_info info;
            for (i = 1; i < w.count; i++) memcpy(w.node[i].given, w.node[i].entry, sizeof w.node[i].given);
            for (i = 1; i < w.count; i++) {
                int e;
                for (e = 0; e < ENTRIES; e++) w.node[i].drawn[e] = 1;
            }
            CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
            flatten_all(&w);
            if (w.pieces < PIECES) compare(&w, s, seed, 0);
        }
        zbufrand_scene_destroy(s);
        model_close(&w);
    }
}

TEST(same_for_any_threads) {
    uint64_t hash[3] = {0, 0, 0};
    uint32_t threads;
    for (threads = 1; threads <= 3; threads++) {
        test_rng r = test_rng_make(77);
        zbufrand_scene *s = open_scene(threads, NULL);
        model w;
        uint32_t k, i;
        int library;
        model_open(&w);
        library = model_start(&w, s, &r);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        for (k = 0; k < 12; k++) {
            for (i = 0; i < 12; i++) model_edit(&w, s, &r, library);
            CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        }
        for (i = 0; i < s->structure_count; i++) hash[threads - 1] = hash[threads - 1] * 31 + hash_structure(&s->structure[i]);
        zbufrand_scene_destroy(s);
        model_close(&w);
    }
    CHECK_EQ_U64(hash[0], hash[1]);
    CHECK_EQ_U64(hash[0], hash[2]);
}

/* Everything goes, everything comes back; numbers of nodes are given out again, but not at once. */
TEST(nothing_left_and_back) {
    zbufrand_scene *s = open_scene(1, NULL);
    shape ball;
    zbufrand_mesh m;
    zbufrand_scene_info info;
    zbufrand_node proto, n[50], extra;
    zbufrand_transform t;
    uint32_t round, i;
    size_t graph = 0;
    memset(&ball, 0, sizeof ball);
    shape_sphere(&ball, 0, 0, 0, 1, 16);
    m = mesh_of(&ball);
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_ERR_EMPTY);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK); /* nothing */
    CHECK_EQ_U64(info.triangles, 0);
    CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &proto), ZBUFRAND_OK);
    for (round = 0; round < 60; round++) {
        for (i = 0; i < 50; i++) {
            t = move_scale(3.0 * i, 0, round, 1);
            if (i == 7) CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, &t, 0, &m, &n[i]), ZBUFRAND_OK);
            else CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, proto, &n[i]), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
        CHECK_EQ_U64(info.triangles, 50u * ball.triangles);
        CHECK_EQ_U64(info.instances, 50);
        CHECK_EQ_U64(zbufrand_remove(s, proto), ZBUFRAND_ERR_INVALID_ARG); /* it is referred to */
        CHECK_EQ_U64(g_error.where, proto);
        for (i = 0; i < 50; i++) CHECK_EQ_U64(zbufrand_remove(s, n[i]), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_remove(s, n[3]), ZBUFRAND_ERR_INVALID_ARG); /* dead */
        CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, NULL, n[3], NULL), ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(zbufrand_add_list(s, n[3], NULL, 0, NULL), ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(zbufrand_list_append(s, ZBUFRAND_ROOT, n[3]), ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(zbufrand_set_reference(s, n[3], 0, &t), ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
        CHECK_EQ_U64(info.triangles, 0);
        CHECK_EQ_U64(info.instances, 0);
        CHECK(info.box_min[0] > info.box_max[0] && !(info.area > 0.0));
        check_scene(s);
        if (round == 40) graph = s->graph_count;
    }
    CHECK_EQ_U64(s->graph_count, graph);
    CHECK(s->mesh_count <= 30 && s->structure_count <= 4);
    CHECK_EQ_U64(zbufrand_remove(s, proto), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.stored_triangles, 0);
    CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, 0, &m, &extra), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, ball.triangles);
    check_scene(s);
    zbufrand_scene_destroy(s);
    shape_free(&ball);
}

TEST(errors) {
    zbufrand_scene *s = open_scene(1, NULL);
    shape box;
    zbufrand_mesh m;
    zbufrand_scene_info info;
    zbufrand_node a, b, c, mesh, loose, r, array;
    zbufrand_transform t = move_scale(1, 2, 3, 1), two[2];
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 1, 1, 1);
    m = mesh_of(&box);
    two[0] = two[1] = t;
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, 0, &a), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, a, NULL, 0, &b), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, b, NULL, 0, &m, &mesh), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, 0, &c), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_references(s, c, two, 2, mesh, &array), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_set_reference(s, array, 0, &t), ZBUFRAND_ERR_INVALID_ARG); /* not built */
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 36);
    CHECK_EQ_U64(zbufrand_move(s, 0, &t), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_move(s, ZBUFRAND_ROOT, &t), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_move(s, 4711, &t), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_remove(s, ZBUFRAND_ROOT), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_remove(s, 4711), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_set_reference(s, array, 2, &t), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_set_reference(s, mesh, 0, &t), ZBUFRAND_ERR_INVALID_ARG);
    t.m[0][0] = 3;
    CHECK_EQ_U64(zbufrand_move(s, a, &t), ZBUFRAND_ERR_INVALID_ARG); /* no similarity */
    CHECK_EQ_U64(zbufrand_set_reference(s, array, 0, &t), ZBUFRAND_ERR_INVALID_ARG);
    t = move_scale(1, 2, 3, 1);
    CHECK_EQ_U64(zbufrand_remove(s, a), ZBUFRAND_ERR_INVALID_ARG); /* the mesh in it is referred to from outside */
    CHECK_EQ_U64(g_error.where, mesh);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK); /* nothing to do */
    CHECK_EQ_U64(info.triangles, 36);
    /* a cycle: nothing changes until it is gone */
    CHECK_EQ_U64(zbufrand_add_reference(s, b, NULL, a, &r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_ERR_INVALID_ARG);
    CHECK(strstr(g_error.text, "cycle") != NULL);
    zbufrand_scene_get_info(s, &info);
    CHECK_EQ_U64(info.triangles, 36);
    CHECK_EQ_U64(zbufrand_remove(s, r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    check_scene(s);
    /* by way of two structures, both new edges */
    CHECK_EQ_U64(zbufrand_add_reference(s, b, NULL, c, &r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK); /* c draws the mesh twice, b contains c: fine */
    CHECK_EQ_U64(info.triangles, 60);
    check_scene(s);
    CHECK_EQ_U64(zbufrand_add_reference(s, c, NULL, b, &loose), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_remove(s, loose), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 60);
    /* a target in no list */
    CHECK_EQ_U64(zbufrand_add_list(s, 0, NULL, 0, &loose), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, NULL, loose, &r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(g_error.where, r);
    CHECK_EQ_U64(zbufrand_list_append(s, ZBUFRAND_ROOT, loose), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_list_append(s, a, loose), ZBUFRAND_ERR_INVALID_ARG); /* already in one */
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, loose, &t, 0, &m, NULL), ZBUFRAND_OK); /* what was empty is drawn twice now */
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 84);
    check_scene(s);
    /* out of range */
    t = move_scale(1e16, 0, 0, 1);
    CHECK_EQ_U64(zbufrand_move(s, mesh, &t), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_ERR_RANGE);
    t = move_scale(0, 0, 0, 1);
    CHECK_EQ_U64(zbufrand_move(s, mesh, &t), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 84);
    check_scene(s);
    zbufrand_scene_destroy(s);
    shape_free(&box);
}

/* The thesis' trees are not kept up to date: they go, and pictures are drawn without them until the next build. */
TEST(trees_of_the_thesis) {
    zbufrand_scene *s = open_scene(1, NULL);
    test_rng r = test_rng_make(4);
    zbufrand_build_desc d;
    zbufrand_scene_info info;
    model w;
    int library, k;
    memset(&d, 0, sizeof d);
    d.structure = ZBUFRAND_STRUCTURE_CLASSES;
    model_open(&w);
    library = model_start(&w, s, &r);
    CHECK_EQ_U64(zbufrand_scene_build(s, &d, &info), ZBUFRAND_OK);
    CHECK(info.list_objects > 0);
    for (k = 0; k < 30; k++) model_edit(&w, s, &r, library);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.list_objects, 0);
    compare(&w, s, 3, 1);
    zbufrand_scene_destroy(s);
    model_close(&w);
}

/* A bad triangle in a new mesh: left out and counted, or with `strict` an error until the mesh is gone. */
TEST(bad_triangles_come) {
    static const float p[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {NAN, 0, 0}, {1e30f, 0, 0}};
    static const uint32_t t[4][3] = {{0, 1, 2}, {0, 1, 3}, {0, 1, 1}, {0, 1, 4}};
    uint32_t strict;
    for (strict = 0; strict < 2; strict++) {
        zbufrand_scene *s = open_scene(1, NULL);
        zbufrand_build_desc d;
        zbufrand_scene_info info;
        zbufrand_mesh m;
        zbufrand_node node;
        memset(&d, 0, sizeof d);
        memset(&m, 0, sizeof m);
        d.strict = strict;
        m.positions = p[0];
        m.vertex_count = 5;
        m.indices = t[0];
        m.triangle_count = 4;
        CHECK_EQ_U64(zbufrand_scene_build(s, &d, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, 0, &m, &node), ZBUFRAND_OK);
        if (strict) {
            CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_ERR_INVALID_ARG);
            CHECK_EQ_U64(g_error.where, 1);
            CHECK_EQ_U64(zbufrand_remove(s, node), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
            CHECK_EQ_U64(info.triangles, 0);
        } else {
            CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
            CHECK_EQ_U64(info.triangles, 1);
            CHECK_EQ_U64(info.skipped_triangles, 3);
        }
        check_scene(s);
        zbufrand_scene_destroy(s);
    }
}

TEST(levels) { /* 64 are allowed, however they come about */
    zbufrand_scene *s = open_scene(1, NULL);
    shape box;
    zbufrand_mesh m;
    zbufrand_node lib, node[70];
    zbufrand_scene_info info;
    uint32_t i;
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 1, 1, 1);
    m = mesh_of(&box);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, ZBUFRAND_OWN_STRUCTURE, &node[0]), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
    for (i = 1; i < 70; i++) { /* from the top down: each refers to the next, which is still empty */
        CHECK_EQ_U64(zbufrand_add_list(s, lib, NULL, 0, &node[i]), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_reference(s, node[i - 1], NULL, node[i], NULL), ZBUFRAND_OK);
        if (zbufrand_scene_update(s, NULL) == ZBUFRAND_ERR_RANGE) break;
    }
    CHECK_EQ_U64(i, 64);
    CHECK_EQ_U64(zbufrand_remove(s, s->graph[node[i - 1]].first), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, node[i - 1], NULL, 0, &m, NULL), ZBUFRAND_OK);
    if (zbufrand_scene_update(s, &info) != ZBUFRAND_OK) { /* the mesh is a level of its own: one too many */
        CHECK_EQ_U64(zbufrand_remove(s, s->graph[node[i - 1]].first), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, node[i - 2], NULL, 0, &m, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(info.triangles, 12);
    check_scene(s);
    zbufrand_scene_destroy(s);
    shape_free(&box);
}

/* Any allocation of an update fails: the scene is what it was, and the same update goes through afterwards. */
TEST(memory_runs_out) {
    int64_t k;
    for (k = 0; k < 400; k++) {
        test_alloc alloc;
        test_rng r = test_rng_make(5);
        zbufrand_scene *s;
        zbufrand_scene_info before, info;
        zbufrand_result result;
        model w;
        uint32_t i;
        int library, done;
        test_alloc_init(&alloc);
        s = open_scene(1, &alloc);
        model_open(&w);
        library = model_start(&w, s, &r);
        REQUIRE(zbufrand_scene_build(s, NULL, &before) == ZBUFRAND_OK);
        if (k % 2) { /* not the first update */
            for (i = 0; i < 6; i++) model_edit(&w, s, &r, library);
            REQUIRE(zbufrand_scene_update(s, &before) == ZBUFRAND_OK);
        }
        for (i = 0; i < 14; i++) model_edit(&w, s, &r, library);
        alloc.fail_at = alloc.count + k / 2;
        result = zbufrand_scene_update(s, &info);
        alloc.fail_at = -1;
        done = result == ZBUFRAND_OK;
        if (!done) {
            CHECK_EQ_U64(result, ZBUFRAND_ERR_NO_MEMORY);
            zbufrand_scene_get_info(s, &info);
            CHECK_EQ_U64(info.triangles, before.triangles);
            CHECK_NEAR(info.area, before.area, 1e-6 * before.area);
            REQUIRE(zbufrand_scene_update(s, NULL) == ZBUFRAND_OK);
        }
        compare(&w, s, 1, 0);
        zbufrand_scene_destroy(s);
        model_close(&w);
        test_alloc_check(&alloc);
        if (done && k % 2 && alloc.failed == 0) break;
    }
    CHECK_MSG(k > 20 && k < 400, "%d allocations", (int)k);
}

static double tree_cost(const zbufrand_scene *s, uint32_t index, uint32_t *depth) { /* surfaces of boxes over that of the root's */
    const zbufrandi_structure *t = &s->structure[index];
    double sum = 0;
    float lo[3], hi[3];
    uint32_t i, k, stack[4096], level[4096], n = 0;
    zbufrandi_box_empty(lo, hi);
    stack[n] = level[n] = 0;
    n++;
    *depth = 0;
    while (n > 0) {
        const zbufrandi_node8 *node = &t->node[stack[--n]];
        const uint32_t at = level[n];
        if (at > *depth) *depth = at;
        for (i = 0; i < node->count; i++) {
            float a[3], b[3];
            for (k = 0; k < 3; k++) {
                a[k] = node->lo[k][i];
                b[k] = node->hi[k][i];
            }
            if (at == 0) zbufrandi_box_add(lo, hi, a, b);
            sum += (double)zbufrandi_half_surface(a, b);
            if (ZBUFRANDI_CHILD_KIND(node->child[i]) != ZBUFRANDI_CHILD_NODE || n + 1 >= 4096) continue;
            level[n] = at + 1;
            stack[n++] = ZBUFRANDI_CHILD_INDEX(node->child[i]);
        }
    }
    return sum / (double)zbufrandi_half_surface(lo, hi);
}

/* Trees stay good: thousands of insertions, all moved anew; insertions ever closer to one place do not make a chain. */
TEST(trees_stay_good) {
    enum { N = 3000 };
    static zbufrand_node n[N];
    zbufrand_scene *s = open_scene(1, NULL), *anew;
    test_rng r = test_rng_make(8);
    shape box;
    zbufrand_mesh m;
    zbufrand_node proto;
    zbufrand_transform t;
    uint32_t i, k, depth, fresh_depth, way;
    double cost, fresh;
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 0.3, 0.3, 0.3);
    m = mesh_of(&box);
    CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &proto), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
    for (way = 0; way < 4; way++) {
        for (i = 0; i < N; i++) {
            if (way < 2) t = move_scale(40 * test_rng_double(&r), 2 * test_rng_double(&r), 40 * test_rng_double(&r), 1);
            else if (way == 2) t = move_scale((double)i * 0.02, 0, 0, 1); /* a line, one after the other */
            else t = move_scale(50.0 * pow(0.98, (double)i), 0, 0, 0.02 * pow(0.985, (double)i) + 1e-6);
            if (way == 0) CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, proto, &n[i]), ZBUFRAND_OK);
            else CHECK_EQ_U64(zbufrand_move(s, n[i], &t), ZBUFRAND_OK);
            if (i % 10 == 9) CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        check_scene(s);
        anew = open_scene(1, NULL);
        CHECK_EQ_U64(zbufrand_add_mesh(anew, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &proto), ZBUFRAND_OK);
        for (i = 0; i < N; i++) {
            for (k = 0; k < 12; k++) t.m[k / 4][k % 4] = s->graph[n[i]].m[k / 4][k % 4];
            CHECK_EQ_U64(zbufrand_add_reference(anew, ZBUFRAND_ROOT, &t, proto, NULL), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_scene_build(anew, NULL, NULL), ZBUFRAND_OK);
        cost = tree_cost(s, 0, &depth);
        fresh = tree_cost(anew, 0, &fresh_depth);
        CHECK_MSG(cost < 2.0 * fresh, "way %u: cost %g, anew %g", way, cost, fresh);
        CHECK_MSG(depth < 50, "way %u: %u levels, anew %u", way, depth, fresh_depth);
        zbufrand_scene_destroy(anew);
    }
    zbufrand_scene_destroy(s);
    shape_free(&box);
}

/* 10^5 moves, removals and returns of references, in updates of a thousand: all sums are those of a scene that is built from
   what is left. */
TEST(hundred_thousand_edits) {
    enum { N = 3000 };
    static zbufrand_transform at[N];
    static uint8_t drawn[N];
    zbufrand_scene *s = open_scene(1, NULL), *anew = open_scene(1, NULL);
    zbufrand_scene_info info[2];
    test_rng r = test_rng_make(9);
    shape box;
    zbufrand_mesh m;
    zbufrand_node proto, node;
    uint32_t i, k, a;
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 0.3, 0.2, 0.1);
    m = mesh_of(&box);
    for (i = 0; i < N; i++) {
        at[i] = move_scale(40 * test_rng_double(&r), 2 * test_rng_double(&r), 40 * test_rng_double(&r), 1);
        drawn[i] = 1;
    }
    CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &proto), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_references(s, ZBUFRAND_ROOT, at, N, proto, &node), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
    for (k = 0; k < (test_quick() ? 5000u : 100000u); k++) {
        i = test_rng_below(&r, N);
        drawn[i] = test_rng_below(&r, 4) != 0;
        at[i] = move_scale(40 * test_rng_double(&r), 2 * test_rng_double(&r), 40 * test_rng_double(&r), exp2(2 * test_rng_double(&r) - 1));
        CHECK_EQ_U64(zbufrand_set_reference(s, node, i, drawn[i] ? &at[i] : NULL), ZBUFRAND_OK);
        if (k % 1000 == 999) CHECK_EQ_U64(zbufrand_scene_update(s, &info[0]), ZBUFRAND_OK);
    }
    check_scene(s);
    CHECK_EQ_U64(zbufrand_add_mesh(anew, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &proto), ZBUFRAND_OK);
    for (i = 0; i < N; i++) if (drawn[i]) CHECK_EQ_U64(zbufrand_add_reference(anew, ZBUFRAND_ROOT, &at[i], proto, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(anew, NULL, &info[1]), ZBUFRAND_OK);
    CHECK_EQ_U64(info[0].triangles, info[1].triangles);
    CHECK_NEAR(info[0].area / info[1].area, 1, 1e-6); /* floats of nodes, in another order */
    for (a = 0; a < 3; a++) {
        CHECK_NEAR(info[0].box_min[a], info[1].box_min[a], 1e-5);
        CHECK_NEAR(info[0].box_max[a], info[1].box_max[a], 1e-5);
    }
    zbufrand_scene_destroy(s);
    zbufrand_scene_destroy(anew);
    shape_free(&box);
}

static const float g_corner[9] = {-1, -1, 0, 1, -1, 0, 0, 1, 0};

static zbufrand_node add_triangle(zbufrand_scene *s, zbufrand_node parent, uint32_t flags) {
    zbufrand_mesh m;
    zbufrand_node node = 0;
    memset(&m, 0, sizeof m);
    m.positions = g_corner;
    m.vertex_count = 3;
    m.triangle_count = 1;
    m.two_sided = 1;
    CHECK_EQ_U64(zbufrand_add_mesh(s, parent, NULL, flags, &m, &node), ZBUFRAND_OK);
    return node;
}
static zbufrand_node add_list(zbufrand_scene *s, zbufrand_node parent, uint32_t flags) {
    zbufrand_node node = 0;
    CHECK_EQ_U64(zbufrand_add_list(s, parent, NULL, flags, &node), ZBUFRAND_OK);
    return node;
}
static zbufrand_node add_at(zbufrand_scene *s, zbufrand_node parent, double x, double y, double z, zbufrand_node target) {
    const zbufrand_transform t = {{{1, 0, 0, x}, {0, 1, 0, y}, {0, 0, 1, z}}};
    zbufrand_node node = 0;
    CHECK_EQ_U64(zbufrand_add_reference(s, parent, &t, target, &node), ZBUFRAND_OK);
    return node;
}
static void move_to(zbufrand_scene *s, zbufrand_node node, double x, double y, double z) {
    const zbufrand_transform t = {{{1, 0, 0, x}, {0, 1, 0, y}, {0, 0, 1, z}}};
    CHECK_EQ_U64(zbufrand_move(s, node, &t), ZBUFRAND_OK);
}

/* What was moved while nothing drew it, and is drawn from now on: at its new place. */
TEST(moved_in_what_was_hidden) {
    static const zbufrand_transform many[2] = {{{{1, 0, 0, 0}, {0, 1, 0, 5}, {0, 0, 1, 0}}}, {{{1, 0, 0, 0}, {0, 1, 0, 9}, {0, 0, 1, 0}}}};
    zbufrand_scene *s = open_scene(1, NULL);
    zbufrand_scene_info info;
    zbufrand_node list, mesh, single, several = 0, target;
    (void)add_triangle(s, ZBUFRAND_ROOT, 0);
    target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    list = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    mesh = add_triangle(s, list, 0);
    single = add_at(s, list, 0, 0, 0, target);
    CHECK_EQ_U64(zbufrand_add_references(s, list, many, 2, target, &several), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    move_to(s, mesh, 10, 0, 0);
    move_to(s, single, 20, 0, 0);
    move_to(s, several, 30, 0, 0);
    (void)add_at(s, ZBUFRAND_ROOT, 100, 0, 0, list);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 5);
    CHECK_NEAR(info.box_max[0], 131, 1e-4);
    CHECK_NEAR(info.box_max[1], 10, 1e-4);
    check_scene(s);
    move_to(s, single, 70, 0, 0); /* and once more */
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_NEAR(info.box_max[0], 171, 1e-4);
    check_scene(s);
    zbufrand_scene_destroy(s);
}

/* A new reference to a list that has no structure yet, and then something new in that list: in both places. */
TEST(new_in_what_is_referred_to) {
    zbufrand_scene *s = open_scene(1, NULL);
    zbufrand_scene_info info;
    zbufrand_node list, inner;
    list = add_list(s, ZBUFRAND_ROOT, 0);
    (void)add_triangle(s, list, 0);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    (void)add_at(s, ZBUFRAND_ROOT, 10, 0, 0, list);
    (void)add_triangle(s, list, 0);
    inner = add_list(s, list, 0);
    (void)add_triangle(s, inner, 0);
    (void)add_triangle(s, list, ZBUFRAND_OWN_STRUCTURE);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 8);
    CHECK_NEAR(info.box_max[0], 11, 1e-4);
    check_scene(s);
    zbufrand_scene_destroy(s);
}

/* What has nothing but instances of empty lists comes to something by what is added below. */
TEST(empty_levels) {
    zbufrand_scene *s = open_scene(1, NULL);
    zbufrand_scene_info info;
    zbufrand_node none, some, around;
    none = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    some = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    (void)add_at(s, some, 1, 0, 0, none);
    (void)add_at(s, ZBUFRAND_ROOT, 0, 0, 0, some);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    (void)add_at(s, some, 2, 0, 0, none);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    around = add_list(s, ZBUFRAND_ROOT, 0);
    (void)add_at(s, around, 100, 0, 0, some);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 0);
    (void)add_triangle(s, some, 0);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 2);
    check_scene(s);
    (void)add_triangle(s, none, 0);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 6);
    CHECK_NEAR(info.box_max[0], 103, 1e-3);
    check_scene(s);
    zbufrand_scene_destroy(s);
}

/* An update that fails after something has become a structure: the trees of the thesis do not know of it. */
TEST(trees_of_the_thesis_after_a_failure) {
    zbufrand_scene *s = open_scene(1, NULL);
    zbufrand_build_desc d;
    zbufrand_transform bad;
    zbufrand_scene_info info;
    zbufrand_camera c;
    zbufrand_node list, target, wrong = 0;
    static float depth[64 * 64], before[64 * 64];
    int i, off = 0;
    memset(&d, 0, sizeof d);
    memset(&bad, 0, sizeof bad);
    memset(&c, 0, sizeof c);
    d.structure = ZBUFRAND_STRUCTURE_FAIR_SPLIT;
    target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    list = add_list(s, ZBUFRAND_ROOT, 0);
    for (i = 0; i < 4; i++) (void)add_at(s, list, 3 * i, 0, 0, target);
    CHECK_EQ_U64(zbufrand_scene_build(s, &d, &info), ZBUFRAND_OK);
    CHECK(info.list_objects > 0);
    draw(s, &c, ZBUFRAND_HYBRID_AUTO, before, 64, 64);
    move_to(s, list, 0, 3, 0);
    CHECK_EQ_U64(zbufrand_add_references(s, ZBUFRAND_ROOT, &bad, 1, target, &wrong), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_ERR_INVALID_ARG);
    zbufrand_scene_get_info(s, &info);
    CHECK_EQ_U64(info.triangles, 4);
    draw(s, &c, ZBUFRAND_HYBRID_AUTO, depth, 64, 64);
    for (i = 0; i < 64 * 64; i++) off += (depth[i] < INFINITY) != (before[i] < INFINITY);
    CHECK_MSG(off < 40, "%d pixels", off);
    CHECK_EQ_U64(zbufrand_remove(s, wrong), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_NEAR(info.box_max[1], 4, 1e-4);
    check_scene(s);
    zbufrand_scene_destroy(s);
}

/* Many instances go to other places in a tree because what they show moved, and then those of something that was empty come:
   each into a full node, so that each needs a new one. */
TEST(room_for_all_that_comes) {
    enum { MOVED = 64, COME = 8 };
    zbufrand_scene *s = open_scene(1, NULL);
    zbufrand_scene_info info;
    zbufrand_node target, moving, inner, empty;
    int i, k;
    target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    moving = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    inner = add_at(s, moving, 0, 0, 0, target);
    empty = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    for (i = 0; i < 2 * MOVED + COME; i++) { /* groups of eight; in the first ones one of them will move */
        const double x = 1000.0 * (i < MOVED ? i : i - MOVED), y = i < MOVED ? 0 : 1e6;
        for (k = 0; k < 8; k++)
            (void)add_at(s, ZBUFRAND_ROOT, x + 10 * (k & 1), y + 10 * (k >> 1 & 1), 10 * (k >> 2), i < MOVED && k == 7 ? moving : target);
    }
    for (i = 0; i < COME; i++) (void)add_at(s, ZBUFRAND_ROOT, 1000.0 * (MOVED + i) + 5, 1e6 + 5, 5, empty);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    move_to(s, inner, -5, 1e6 - 5, -5);
    (void)add_triangle(s, empty, 0);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 8 * (2 * MOVED + COME) + COME);
    for (i = 0; i < (int)s->structure_count; i++) CHECK(s->structure[i].node_count <= s->live->s[i].node_capacity);
    check_scene(s);
    zbufrand_scene_destroy(s);
}

/* Two models a level, each made of both of the level below: 2^40 ways lead up from the lowest. */
TEST(many_ways_up) {
    zbufrand_scene *s = open_scene(1, NULL);
    zbufrand_node low[2], next[2], mesh;
    zbufrand_scene_info info;
    int i, k;
    for (k = 0; k < 2; k++) low[k] = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    mesh = add_triangle(s, low[0], 0);
    for (k = 0; k < 2; k++) (void)add_triangle(s, low[k], 0);
    for (i = 0; i < 40; i++) {
        for (k = 0; k < 2; k++) next[k] = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
        for (k = 0; k < 4; k++) (void)add_at(s, next[k & 1], k < 2 ? 0 : 3, 0, 0, low[(k & 1) ^ k >> 1]);
        memcpy(low, next, sizeof low);
    }
    for (k = 0; k < 2; k++) (void)add_at(s, ZBUFRAND_ROOT, 0, 0, 0, low[k]);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    move_to(s, mesh, 0, 0.1, 0);
    CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.levels, 42);
    check_scene(s);
    zbufrand_scene_destroy(s);
}

/* ---- orders of places that make chains of trees ---- */

enum { ROW, ROW_INWARDS, ONE_PLACE, SHRINKING, GROWING, TWO_ROWS, ORDERS };

static zbufrand_transform place_of(int order, uint32_t i, uint32_t count) {
    switch (order) {
    case ROW: return move_scale(3.0 * i, 0, 0, 1);
    case ROW_INWARDS: return move_scale(3.0 * (i % 2 != 0 ? (double)count - i : (double)i), 0, 0, 1);
    case ONE_PLACE: return move_scale(0, 0, 0, 1);
    case SHRINKING: return move_scale(0, 0, 0, pow(0.99, (double)i) + 1e-6);
    case GROWING: return move_scale(0, 0, 0, 1.0 + i);
    default: return move_scale(3.0 * i, i % 2 != 0 ? 1000 : 0, 0, 1);
    }
}

/* How often work was handed out: refits do so for each level of nodes, so this says how deep a tree was when they began. */
static void count_rounds(void (*task)(void *ctx, uint32_t index), void *ctx, uint32_t count, void *user) {
    uint32_t i;
    ++*(uint32_t *)user;
    for (i = 0; i < count; i++) task(ctx, i);
}

static zbufrand_scene *open_counting(uint32_t *rounds, test_alloc *alloc) {
    zbufrand_scene *s = open_scene(1, alloc);
    s->env.parallel.for_fn = count_rounds;
    s->env.parallel.user = rounds;
    return s;
}

static uint32_t deepest(const zbufrand_scene *scene) { /* levels below a root; without a stack, as there may be thousands */
    uint32_t i, node, up, lane, depth, most = 0;
    for (i = 0; i < scene->structure_count; i++) {
        const zbufrandi_structure *s = &scene->structure[i];
        if (!scene->live->s[i].used || s->node_count == 0) continue;
        for (node = lane = depth = 0; node != 0 || lane < s->node[0].count;) {
            if (lane == s->node[node].count) {
                up = scene->live->s[i].health[node].up;
                node = up >> 3;
                lane = (up & 7u) + 1;
                depth--;
            } else if (ZBUFRANDI_CHILD_KIND(s->node[node].child[lane]) == ZBUFRANDI_CHILD_NODE) {
                node = ZBUFRANDI_CHILD_INDEX(s->node[node].child[lane]);
                lane = 0;
                depth++;
                most = depth > most ? depth : most;
            } else {
                lane++;
            }
        }
    }
    return most;
}

static void check_balance(zbufrand_scene *s, uint64_t triangles, uint32_t rounds, const char *what, int order) {
    zbufrand_scene_info info;
    zbufrand_scene_get_info(s, &info);
    CHECK_EQ_U64(info.triangles, triangles);
    CHECK_MSG(deepest(s) <= ZBUFRANDI_DEEP, "%s, order %d: %u levels", what, order, deepest(s));
    CHECK_MSG(rounds < 100, "%s, order %d: work in %u rounds", what, order, rounds);
    if (deepest(s) < 60) check_scene(s);
}

/* All that comes in one update and goes where boxes grow least, however it lies and whichever way it comes: trees stay as deep as
   they may be, during the update, too. */
TEST(rows_and_heaps_in_one_update) {
    const uint32_t n = test_quick() ? 1500 : 6000;
    zbufrand_node *node = (zbufrand_node *)malloc(n * sizeof *node);
    uint32_t i, rounds = 0;
    int order;
    if (node == NULL) abort();
    for (order = test_quick(); order < ORDERS; order += test_quick() ? 2 : 1) {
        test_rng r = test_rng_make(30 + (uint64_t)order);
        zbufrand_scene *s = open_counting(&rounds, NULL);
        zbufrand_node target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN), list, empty, melted;
        zbufrand_transform t;
        for (i = 0; i < 100; i++) (void)add_at(s, ZBUFRAND_ROOT, 100 * test_rng_double(&r), 100 * test_rng_double(&r), 0, target);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        for (i = 0; i < n; i++) { /* added */
            t = place_of(order, i, n);
            CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, target, &node[i]), ZBUFRAND_OK);
        }
        rounds = 0;
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        check_balance(s, 100 + n, rounds, "added", order);
        for (i = 0; i < n; i++) move_to(s, node[i], 1e4 * test_rng_double(&r), 1e4 * test_rng_double(&r), 50);
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        for (i = 0; i < n; i++) { /* moved; what went, comes to other places at once */
            t = place_of(order, i, n);
            if (i % 3 != 0) CHECK_EQ_U64(zbufrand_move(s, node[i], &t), ZBUFRAND_OK);
            else CHECK_EQ_U64(zbufrand_remove(s, node[i]), ZBUFRAND_OK);
            if (i % 3 == 0) CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, target, &node[i]), ZBUFRAND_OK);
        }
        rounds = 0;
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        check_balance(s, 100 + n, rounds, "moved", order);
        empty = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
        list = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_OWN_STRUCTURE);
        for (i = 0; i < n; i++) {
            t = place_of(order, i, n);
            CHECK_EQ_U64(zbufrand_add_reference(s, list, &t, empty, NULL), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        (void)add_triangle(s, empty, 0); /* what they refer to comes to something */
        rounds = 0;
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        check_balance(s, 100 + 2 * n, rounds, "no longer empty", order);
        melted = add_list(s, ZBUFRAND_ROOT, 0);
        for (i = 0; i < n / 4; i++) node[i] = add_triangle(s, melted, 0);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        for (i = 0; i < n / 4; i++) {
            t = place_of(order, i, n);
            CHECK_EQ_U64(zbufrand_move(s, node[i], &t), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        check_balance(s, 100 + 2 * n + n / 4, 0, "on their own", order); /* work in many rounds: each structure is built, too */
        zbufrand_scene_destroy(s);
    }
    free(node);
}

/* Room for nodes is kept for what leaves the tree and comes back in the same update - content that goes and other content that
   comes, references hidden and shown - while much else moves because of what it refers to. */
TEST(content_goes_and_comes) {
    enum { MOVED = 20000, BACK = 100 };
    static zbufrand_node back[BACK];
    static zbufrand_transform place[BACK];
    int way;
    for (way = 0; way < 2; way++) {
        test_rng r = test_rng_make(40 + (uint64_t)way);
        zbufrand_scene *s = open_scene(1, NULL);
        const zbufrandi_live_structure *top;
        zbufrand_node target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN), inner = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN),
                      much = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN), some = add_list(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN),
                      content = add_at(s, much, 0, 0, 0, target), many = ZBUFRAND_ROOT, old = ZBUFRAND_ROOT;
        uint32_t i;
        (void)add_at(s, inner, 0, 0, 0, target);
        if (way == 0) old = add_at(s, some, 0, 0, 0, inner);
        for (i = 0; i < MOVED; i++) { /* turned, so that they go apart */
            const double a = 6.2831853 * test_rng_double(&r), c = cos(a), n = sin(a);
            zbufrand_transform t = {{{c, -n, 0, 1000 * test_rng_double(&r)}, {n, c, 0, 1000 * test_rng_double(&r)}, {0, 0, 1, 0}}};
            CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, much, NULL), ZBUFRAND_OK);
        }
        for (i = 0; i < BACK; i++) {
            const zbufrand_transform t = {{{1, 0, 0, 100 * test_rng_double(&r)}, {0, 1, 0, 100 * test_rng_double(&r)}, {0, 0, 1, -50}}};
            place[i] = t;
            back[i] = add_at(s, ZBUFRAND_ROOT, 5e4 + test_rng_double(&r), 5e4 + test_rng_double(&r), 0, some);
        }
        if (way == 1) CHECK_EQ_U64(zbufrand_add_references(s, ZBUFRAND_ROOT, place, BACK, target, &many), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        move_to(s, content, 20000, 0, 0);
        for (i = 0; i < BACK && way == 0; i++) move_to(s, back[i], 6e4 + test_rng_double(&r), 5e4 + test_rng_double(&r), 0);
        for (i = 0; i < BACK && way == 1; i++) {
            CHECK_EQ_U64(zbufrand_set_reference(s, many, i, NULL), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_set_reference(s, many, i, &place[i]), ZBUFRAND_OK);
        }
        if (way == 0) CHECK_EQ_U64(zbufrand_remove(s, old), ZBUFRAND_OK);
        (void)add_at(s, some, 0, 0, 1, inner);
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        top = &s->live->s[0];
        CHECK(s->structure[0].node_count <= top->node_capacity && deepest(s) <= ZBUFRANDI_DEEP);
        for (i = 0; i < s->structure_count; i++) CHECK(s->live->s[i].promised == 0 && s->live->s[i].spare == 0);
        check_scene(s);
        zbufrand_scene_destroy(s);
    }
}

/* A tree that is almost as deep as it may be needs room for packing, but no more than it has leaves. */
TEST(deep_trees_take_little_room) {
    enum { LONG_ROW = 308 };
    static zbufrand_node node[LONG_ROW];
    zbufrand_scene *s = open_scene(1, NULL);
    zbufrand_node target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    uint32_t i;
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
    for (i = 0; i < LONG_ROW; i++) node[i] = add_at(s, ZBUFRAND_ROOT, 3.0 * i, 0, 0, target);
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
    CHECK(deepest(s) + 2 > ZBUFRANDI_DEEP);
    for (i = 0; i < LONG_ROW; i++) move_to(s, node[i], 3.0 * i, 0.5, 0);
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
    CHECK_MSG(s->live->s[0].node_capacity < 4 * LONG_ROW, "%lu nodes", (unsigned long)s->live->s[0].node_capacity);
    zbufrand_scene_destroy(s);
}

/* The same, one by one and in small updates, with what was there before going away, and the tree that results is as good as one
   that is built. */
TEST(rows_and_heaps_one_by_one) {
    enum { N = 4000, KEPT = 1200 };
    static zbufrand_node node[N];
    uint32_t i, k, rounds = 0, depth;
    double cost, fresh;
    int order;
    for (order = 0; order < ORDERS; order += test_quick() ? 2 : 1) {
        zbufrand_scene *s = open_counting(&rounds, NULL), *anew = open_scene(1, NULL);
        zbufrand_node target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
        zbufrand_transform t;
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        for (i = 0; i < N; i++) {
            t = place_of(order, i, N);
            CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, target, &node[i]), ZBUFRAND_OK);
            if (i >= KEPT) CHECK_EQ_U64(zbufrand_remove(s, node[i - KEPT]), ZBUFRAND_OK);
            rounds = 0;
            if (i % 64 < 40 || i % 64 == 63) CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
            if (i % 512 == 511) check_balance(s, i < KEPT ? i + 1 : KEPT, rounds, "one by one", order);
        }
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        check_balance(s, KEPT, 0, "one by one", order);
        target = add_triangle(anew, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
        for (i = N - KEPT; i < N; i++) {
            for (k = 0; k < 12; k++) t.m[k / 4][k % 4] = s->graph[node[i]].m[k / 4][k % 4];
            CHECK_EQ_U64(zbufrand_add_reference(anew, ZBUFRAND_ROOT, &t, target, NULL), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(zbufrand_scene_build(anew, NULL, NULL), ZBUFRAND_OK);
        cost = tree_cost(s, 0, &depth);
        fresh = tree_cost(anew, 0, &depth);
        CHECK_MSG(cost < 2.0 * fresh, "order %d: cost %g, anew %g", order, cost, fresh);
        zbufrand_scene_destroy(s);
        zbufrand_scene_destroy(anew);
    }
}

/* Memory is refused from any point of such an update on: either nothing has happened, or all has, and no tree is too deep. */
TEST(rows_and_heaps_without_memory) {
    const uint32_t n = test_quick() ? 700 : 2000;
    int64_t k;
    int order, done;
    for (order = ROW; order <= ONE_PLACE; order += ONE_PLACE - ROW) {
        for (k = 0, done = 0; !done; k++) {
            uint32_t i, rounds = 0;
            test_alloc alloc;
            zbufrand_scene *s;
            zbufrand_scene_info before, info;
            zbufrand_node target, list;
            zbufrand_result result;
            test_alloc_init(&alloc);
            s = open_counting(&rounds, &alloc);
            target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
            list = add_list(s, ZBUFRAND_ROOT, 0);
            for (i = 0; i < 60; i++) (void)add_at(s, list, 1, 2, 3, target);
            CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &before), ZBUFRAND_OK);
            for (i = 0; i < n; i++) {
                const zbufrand_transform t = place_of(order, i, n);
                CHECK_EQ_U64(zbufrand_add_reference(s, ZBUFRAND_ROOT, &t, target, NULL), ZBUFRAND_OK);
            }
            move_to(s, list, 0, 0, 4);
            alloc.fail_at = alloc.count + k;
            alloc.fail_after = 1;
            rounds = 0;
            result = zbufrand_scene_update(s, NULL);
            done = alloc.failed == 0;
            alloc.fail_at = -1;
            alloc.fail_after = 0;
            if (result != ZBUFRAND_OK) {
                CHECK_EQ_U64(result, ZBUFRAND_ERR_NO_MEMORY);
                zbufrand_scene_get_info(s, &info);
                CHECK_EQ_U64(info.triangles, before.triangles);
                rounds = 0;
                CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
            }
            check_balance(s, 60 + n, rounds, "without memory", order);
            zbufrand_scene_destroy(s);
            test_alloc_check(&alloc);
        }
        CHECK_MSG(k > 20, "%d requests", (int)k);
    }
}

/* A tree that is as deep as may be, and one more at its deepest place by each update, with no room but what updates reserve. */
TEST(deepest_place) {
    uint32_t i, rounds = 0, most = 0;
    zbufrand_scene *s = open_counting(&rounds, NULL);
    const zbufrand_node target = add_triangle(s, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
    for (i = 0; i < 7 * ZBUFRANDI_DEEP; i++) (void)add_at(s, ZBUFRAND_ROOT, 3.0 * i, 0, 0, target);
    CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
    CHECK_MSG(deepest(s) + 3 >= ZBUFRANDI_DEEP, "%u levels", deepest(s));
    for (; i < 7 * ZBUFRANDI_DEEP + 60; i++) {
        s->live->s[0].node_capacity = s->structure[0].node_count + 1u;
        (void)add_at(s, ZBUFRAND_ROOT, 3.0 * i, 0, 0, target);
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_OK);
        check_balance(s, i + 1, 0, "the deepest place", 0);
        most = deepest(s) > most ? deepest(s) : most;
    }
    CHECK_EQ_U64(most, ZBUFRANDI_DEEP);
    zbufrand_scene_destroy(s);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(any_sequence_of_edits);
    RUN(same_for_any_threads);
    RUN(nothing_left_and_back);
    RUN(errors);
    RUN(trees_of_the_thesis);
    RUN(moved_in_what_was_hidden);
    RUN(new_in_what_is_referred_to);
    RUN(empty_levels);
    RUN(trees_of_the_thesis_after_a_failure);
    RUN(room_for_all_that_comes);
    RUN(many_ways_up);
    RUN(bad_triangles_come);
    RUN(levels);
    RUN(memory_runs_out);
    RUN(trees_stay_good);
    RUN(rows_and_heaps_in_one_update);
    RUN(content_goes_and_comes);
    RUN(deep_trees_take_little_room);
    RUN(rows_and_heaps_one_by_one);
    RUN(rows_and_heaps_without_memory);
    RUN(deepest_place);
    RUN(hundred_thousand_edits);
    zbufrand_frame_destroy(g_frame);
    return test_end();
}
