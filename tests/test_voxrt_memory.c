/* test_voxrt_memory.c - files, pages, volumes and models with each request for memory refused once and with all from one on:
   NO_MEMORY, nothing leaks, no file is left half written; calls cancelled at each question; buffers for global illumination
   from geometry; names.
   SPDX-License-Identifier: MIT OR Unlicense */
#include "test.h"
#include <pthread.h>
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "shapes.h"

enum { MEMORY_SIDE = 40, MEMORY_EDITS = 3 };

typedef struct world {
    shape s;
    voxrt_mesh mesh;
    voxrt_tree *tree;
    voxrt_octree *octree;
    const char *tree_file, *octree_file, *paged_file, *fresh;
    /* of world_more */
    voxrt_tree *solid, *small;
    voxrt_gi *gi;
    const char *large_file;
    uint64_t edited[MEMORY_EDITS + 1]; /* hash of the model after so many edits */
} world;

static voxrt_camera camera_at(double x, double y, double z) {
    voxrt_camera c;
    memset(&c, 0, sizeof c);
    c.eye[0] = (float)x;
    c.eye[1] = (float)y;
    c.eye[2] = (float)z;
    c.fov_y = 40;
    return c;
}

static void world_open(world *w) {
    voxrt_build_desc d;
    voxrt_save_desc s;
    memset(w, 0, sizeof *w);
    memset(&d, 0, sizeof d);
    memset(&s, 0, sizeof s);
    shape_sphere(&w->s, 0, 0, 0, 1, 24);
    w->mesh.positions = w->s.p;
    w->mesh.vertex_count = w->s.vertices;
    w->mesh.indices = w->s.t;
    w->mesh.triangle_count = w->s.triangles;
    w->mesh.normals = w->s.normal;
    d.resolution = 64;
    d.spread = 1;
    d.env.thread_count = 1;
    CHECK(voxrt_tree_build(&d, &w->mesh, NULL, &w->tree) == VOXRT_OK);
    CHECK(voxrt_octree_from_tree(NULL, w->tree, &w->octree) == VOXRT_OK);
    w->tree_file = test_temp_path(".vox");
    w->octree_file = test_temp_path(".vox");
    w->paged_file = test_temp_path(".vox");
    w->fresh = test_temp_path(".vox");
    CHECK(voxrt_tree_save_file(w->tree, NULL, w->tree_file) == VOXRT_OK);
    CHECK(voxrt_octree_save_file(w->octree, NULL, w->octree_file) == VOXRT_OK);
    s.encoding = VOXRT_ENCODING_PAGED;
    CHECK(voxrt_tree_save_file(w->tree, &s, w->paged_file) == VOXRT_OK);
}

static void world_close(world *w) {
    voxrt_tree_destroy(w->tree);
    voxrt_octree_destroy(w->octree);
    voxrt_tree_destroy(w->solid);
    voxrt_tree_destroy(w->small);
    voxrt_gi_destroy(w->gi);
    shape_free(&w->s);
    (void)remove(w->tree_file);
    (void)remove(w->octree_file);
    (void)remove(w->paged_file);
    (void)remove(w->fresh);
    if (w->large_file != NULL) (void)remove(w->large_file);
}

/* A file is there as a whole or not at all. */
static voxrt_result written(const world *w, voxrt_result r, const char *like) {
    size_t size = 0, want = 0;
    uint8_t *p = test_read_file(w->fresh, &size), *q = like != NULL ? test_read_file(like, &want) : NULL;
    CHECK((r == VOXRT_OK) == (p != NULL));
    if (p != NULL && q != NULL) CHECK(size == want && memcmp(p, q, size) == 0);
    free(p);
    free(q);
    (void)remove(w->fresh);
    return r;
}

static voxrt_result save_tree(world *w, const voxrt_env *env) {
    voxrt_save_desc d;
    memset(&d, 0, sizeof d);
    d.env = *env;
    return written(w, voxrt_tree_save_file(w->tree, &d, w->fresh), w->tree_file);
}

static voxrt_result memory_load(const voxrt_env *env, const char *path) {
    voxrt_load_desc d;
    voxrt_tree *t = NULL;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    r = voxrt_tree_load_file(&d, path, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    voxrt_tree_destroy(t);
    return r;
}
static voxrt_result load_tree(world *w, const voxrt_env *env) { return memory_load(env, w->tree_file); }
static voxrt_result load_large(world *w, const voxrt_env *env) { return memory_load(env, w->large_file); }

static voxrt_result save_octree(world *w, const voxrt_env *env) {
    return written(w, voxrt_octree_save_file(w->octree, env, w->fresh), w->octree_file);
}

static voxrt_result load_octree(world *w, const voxrt_env *env) {
    voxrt_octree_desc d;
    voxrt_octree *t = NULL;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    r = voxrt_octree_load_file(&d, w->octree_file, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    voxrt_octree_destroy(t);
    return r;
}

static voxrt_result save_pages(world *w, const voxrt_env *env) {
    voxrt_save_desc d;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.encoding = VOXRT_ENCODING_PAGED;
    return written(w, voxrt_tree_save_file(w->tree, &d, w->fresh), w->paged_file);
}

static voxrt_result build_pages(world *w, const voxrt_env *env) {
    voxrt_build_desc d;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.resolution = 64;
    d.spread = 1;
    return written(w, voxrt_paged_build_file(&d, &w->mesh, w->fresh, NULL), NULL);
}

static voxrt_result draw_pages(world *w, const voxrt_env *env) {
    static float depth[MEMORY_SIDE * MEMORY_SIDE], exact[MEMORY_SIDE * MEMORY_SIDE];
    voxrt_paged_desc d;
    voxrt_render_desc rd;
    voxrt_geometry g;
    voxrt_image image;
    voxrt_paged *p = NULL;
    voxrt_result r;
    int i;
    memset(&d, 0, sizeof d);
    memset(&rd, 0, sizeof rd);
    memset(&image, 0, sizeof image);
    d.env = *env;
    r = voxrt_paged_open_file(&d, w->paged_file, &p);
    CHECK((r == VOXRT_OK) == (p != NULL));
    if (p == NULL) return r;
    voxrt_paged_geometry(p, &g);
    rd.env.thread_count = 1;
    rd.camera = camera_at(3, 2, 4);
    image.width = image.height = MEMORY_SIDE;
    image.depth = exact;
    CHECK(voxrt_render(&rd, w->tree, &image, NULL) == VOXRT_OK);
    rd.geometry = &g;
    rd.geometry_count = 1;
    for (i = 0; i < 20 && r == VOXRT_OK; i++) {
        voxrt_paged_update_stats u;
        image.depth = depth;
        CHECK(voxrt_render(&rd, NULL, &image, NULL) == VOXRT_OK);
        r = voxrt_paged_update(p, 0, &u);
        if (r == VOXRT_OK && u.wanted == 0) break;
    }
    CHECK(i < 20);
    for (i = 0; i < MEMORY_SIDE * MEMORY_SIDE && r == VOXRT_OK; i++) CHECK(depth[i] <= exact[i] * 1.00001f);
    if (r == VOXRT_OK) CHECK(memcmp(depth, exact, sizeof depth) == 0);
    voxrt_paged_destroy(p);
    return r;
}

/* Points and meshes in columns, a scene, its light. */
static voxrt_result points(world *w, const voxrt_env *env) {
    voxrt_columns_desc d;
    voxrt_columns_insert_desc in;
    voxrt_columns *c = NULL;
    voxrt_result r;
    int a;
    memset(&d, 0, sizeof d);
    memset(&in, 0, sizeof in);
    d.env = *env;
    in.env.thread_count = env->thread_count;
    d.size_x = d.size_y = d.size_z = 64;
    for (a = 0; a < 3; a++) {
        d.box_min[a] = -1.2;
        d.box_max[a] = 1.2;
    }
    r = voxrt_columns_create(&d, &c);
    if (r == VOXRT_OK) r = voxrt_columns_insert_points(c, &in, w->s.p, 12, w->s.vertices, NULL);
    if (r == VOXRT_OK) r = voxrt_columns_insert(c, &in, &w->mesh, NULL);
    if (r == VOXRT_OK) voxrt_columns_update(c);
    voxrt_columns_destroy(c);
    return r;
}

static voxrt_result scene_of(world *w, const voxrt_env *env, voxrt_gi **out) {
    voxrt_gi_desc d;
    voxrt_gi_object o;
    voxrt_gi_light l;
    double centre[3] = {0.3, 0, 0};
    voxrt_result r;
    int a;
    memset(&d, 0, sizeof d);
    memset(&o, 0, sizeof o);
    memset(&l, 0, sizeof l);
    d.env = *env;
    d.columns.size_x = d.columns.size_y = d.columns.size_z = 64;
    for (a = 0; a < 3; a++) {
        d.columns.box_min[a] = -1.3;
        d.columns.box_max[a] = 1.3;
        o.material.albedo[a] = 0.5f;
        l.color[a] = 1;
    }
    d.nested = 2;
    o.mesh = w->mesh;
    l.position[1] = 1.2f;
    l.position[2] = 1.2f;
    r = voxrt_gi_create(&d, out);
    if (r == VOXRT_OK) r = voxrt_gi_add(*out, &o, NULL);
    if (r == VOXRT_OK) r = voxrt_gi_set_lights(*out, &l, 1);
    if (r == VOXRT_OK) r = voxrt_gi_update(*out, NULL);
    if (r == VOXRT_OK) r = voxrt_gi_follow(*out, centre, NULL);
    if (r == VOXRT_OK) r = voxrt_gi_update(*out, NULL);
    return r;
}

static voxrt_result memory_scene(world *w, const voxrt_env *env) {
    voxrt_gi *gi = NULL;
    voxrt_result r = scene_of(w, env, &gi);
    voxrt_gi_destroy(gi);
    return r;
}

/* A model from nothing, changed in all ways, and its tree; a blurred picture. */
static voxrt_result memory_model(world *w, const voxrt_env *env) {
    static const double lo[3] = {-0.9, -0.3, -0.3}, hi[3] = {0.9, 0.4, 0.5};
    voxrt_model_desc d;
    voxrt_edit_desc e;
    voxrt_build_desc b;
    voxrt_finish mirror;
    voxrt_voxel v[40];
    voxrt_model *m = NULL;
    voxrt_tree *t = NULL;
    voxrt_result r;
    uint32_t i;
    memset(&d, 0, sizeof d);
    memset(&e, 0, sizeof e);
    memset(&b, 0, sizeof b);
    memset(&mirror, 0, sizeof mirror);
    memset(v, 0, sizeof v);
    d.env = e.env = b.env = *env;
    d.depth = 6;
    d.box_min[0] = d.box_min[1] = d.box_min[2] = -1.2;
    d.box_size = 2.4;
    mirror.mirror[0] = 1;
    for (i = 0; i < 40; i++) {
        v[i].x = i;
        v[i].y = 60;
        v[i].z = i;
        v[i].rgb[i % 3] = (uint8_t)(6 * i);
    }
    r = voxrt_model_create(&d, &m);
    CHECK((r == VOXRT_OK) == (m != NULL));
    e.finish = &mirror;
    if (r == VOXRT_OK) r = voxrt_model_box(m, &e, lo, hi, NULL);
    e.finish = NULL;
    if (r == VOXRT_OK) r = voxrt_model_mesh(m, &e, &w->mesh, NULL);
    if (r == VOXRT_OK) r = voxrt_model_voxels(m, &e, v, 40, NULL);
    e.op = VOXRT_EDIT_PAINT;
    if (r == VOXRT_OK) r = voxrt_model_sphere(m, &e, lo, 0.5, NULL);
    e.op = VOXRT_EDIT_CLEAR;
    if (r == VOXRT_OK) r = voxrt_model_mesh(m, &e, &w->mesh, NULL);
    if (r == VOXRT_OK) r = voxrt_tree_from_model(&b, m, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    voxrt_tree_destroy(t);
    voxrt_model_destroy(m);
    return r;
}

static voxrt_result blur(world *w, const voxrt_env *env) {
    static float rgba[MEMORY_SIDE * MEMORY_SIDE * 4];
    voxrt_image image;
    voxrt_blur_desc d;
    (void)w;
    memset(&image, 0, sizeof image);
    memset(&d, 0, sizeof d);
    d.env = *env;
    image.width = image.height = MEMORY_SIDE;
    image.rgba = rgba;
    return voxrt_blur(&d, &image);
}

/* A small thing in a large box, in more rows of bricks than one pass sorts; with what normals spread. */
static voxrt_result build_small(world *w, const voxrt_env *env) {
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.resolution = 512;
    d.box_min[0] = d.box_min[1] = d.box_min[2] = -52; /* all in one brick */
    d.box_size = 80;
    d.spread = 1;
    r = voxrt_tree_build(&d, &w->mesh, NULL, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    if (r == VOXRT_OK && w->small != NULL) CHECK(voxrt_tree_hash(t) == voxrt_tree_hash(w->small));
    if (r == VOXRT_OK && w->small == NULL) w->small = t;
    else voxrt_tree_destroy(t);
    return r;
}

static voxrt_result share_and_back(world *w, const voxrt_env *env) {
    voxrt_tree *s = NULL, *t = NULL;
    voxrt_result r = voxrt_tree_share(w->small, env, &s);
    CHECK((r == VOXRT_OK) == (s != NULL));
    if (r == VOXRT_OK) r = voxrt_tree_unshare(s, env, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    if (t != NULL) CHECK(voxrt_tree_hash(t) == voxrt_tree_hash(w->small));
    voxrt_tree_destroy(s);
    voxrt_tree_destroy(t);
    return r;
}

/* Most of it merges. Room that is left over is given back where there is memory for the copy; where there is none, the
   octree is the same. */
static voxrt_result octree_of_solid(world *w, const voxrt_env *env) {
    voxrt_octree_desc d;
    voxrt_octree *o = NULL;
    voxrt_tree *t = NULL;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    r = voxrt_octree_from_tree(&d, w->solid, &o);
    CHECK((r == VOXRT_OK) == (o != NULL));
    if (r == VOXRT_OK) CHECK(voxrt_tree_from_octree(NULL, o, &t) == VOXRT_OK && voxrt_tree_hash(t) == voxrt_tree_hash(w->solid));
    voxrt_tree_destroy(t);
    voxrt_octree_destroy(o);
    return r;
}

/* Cut into pieces: with this limit there is more in it than in a piece. */
static voxrt_result build_pieces(world *w, const voxrt_env *env) {
    static const float p[4][3] = {{300, 300, 300}, {356, 300, 302}, {300, 356, 302}, {356, 356, 304}};
    static const uint32_t corner[6] = {0, 1, 2, 2, 1, 3};
    voxrt_build_desc d;
    voxrt_mesh m;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    m.positions = p[0];
    m.vertex_count = 4;
    m.indices = corner;
    m.triangle_count = 2;
    d.env = *env;
    d.env.memory_limit = 1u << 20;
    d.resolution = 2048;
    d.box_size = 2048;
    return written(w, voxrt_paged_build_file(&d, &m, w->fresh, NULL), NULL);
}

static uint64_t model_hash(const voxrt_model *m) {
    voxrt_tree *t = NULL;
    uint64_t hash;
    CHECK(voxrt_tree_from_model(NULL, m, &t) == VOXRT_OK);
    hash = voxrt_tree_hash(t);
    voxrt_tree_destroy(t);
    return hash;
}

/* A slab in four blocks; painted with all there is; half a sphere cut out. One that fails has done nothing. */
static voxrt_result edit_blocks(world *w, const voxrt_env *env) {
    static const double lo[2][3] = {{-1, -1, 0.1}, {-12, -12, -12}}, hi[2][3] = {{1, 1, 0.3}, {12, 12, 12}};
    voxrt_model_desc d;
    voxrt_edit_desc e;
    voxrt_mesh half = w->mesh;
    voxrt_model *m = NULL;
    voxrt_result r;
    uint32_t i;
    memset(&d, 0, sizeof d);
    memset(&e, 0, sizeof e);
    d.env = e.env = *env;
    d.depth = 8;
    d.box_min[0] = d.box_min[1] = d.box_min[2] = -12;
    d.box_size = 24;
    half.triangle_count /= 2;
    r = voxrt_model_create(&d, &m);
    CHECK((r == VOXRT_OK) == (m != NULL));
    for (i = 0; i < MEMORY_EDITS && r == VOXRT_OK; i++) {
        e.op = i == 0 ? VOXRT_EDIT_SET : i == 1 ? VOXRT_EDIT_PAINT : VOXRT_EDIT_CLEAR;
        e.rgb[i] = 200;
        r = i == 2 ? voxrt_model_mesh(m, &e, &half, NULL) : voxrt_model_box(m, &e, lo[i], hi[i], NULL);
        if (w->edited[i + 1] == 0 && r == VOXRT_OK) w->edited[i + 1] = model_hash(m); /* the first time */
        if (i != 0 && r != VOXRT_OK) CHECK_MSG(model_hash(m) == w->edited[i], "edit %u that failed", i);
    }
    if (r == VOXRT_OK) CHECK(model_hash(m) == w->edited[MEMORY_EDITS]);
    voxrt_model_destroy(m);
    return r;
}

/* Every other pixel first, each with its virtual lights. */
static voxrt_result coarse_lights(world *w, const voxrt_env *env) {
    enum { COARSE = 16 };
    static float position[COARSE * COARSE][3], normal[COARSE * COARSE][3], albedo[COARSE * COARSE][3], out[2][COARSE * COARSE][3];
    static int known;
    const voxrt_camera c = camera_at(1, 2.5, 1.5);
    voxrt_gi_render_desc d;
    voxrt_gbuffer g;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    memset(&g, 0, sizeof g);
    g.width = g.height = COARSE;
    g.position = position[0];
    g.normal = normal[0];
    g.albedo = albedo[0];
    CHECK(voxrt_gbuffer_from_gi(NULL, &c, w->gi, &g) == VOXRT_OK);
    d.env = *env;
    d.method = VOXRT_GI_VPL;
    d.pattern = 1;
    d.coarse = 2;
    d.rays = 16;
    r = voxrt_gi_render(&d, w->gi, &g, NULL, out[known][0], NULL);
    if (r == VOXRT_OK && known) CHECK(memcmp(out[0], out[1], sizeof out[0]) == 0);
    known |= r == VOXRT_OK;
    return r;
}

/* What the larger calls need: a tree with many normals in a file, a filled one, a scene; what comes of calls that are not refused. */
static void world_more(world *w) {
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    voxrt_env env;
    memset(&d, 0, sizeof d);
    memset(&env, 0, sizeof env);
    d.env.thread_count = env.thread_count = 1;
    d.resolution = 150;
    CHECK(voxrt_tree_build(&d, &w->mesh, NULL, &t) == VOXRT_OK);
    w->large_file = test_temp_path(".vox");
    CHECK(voxrt_tree_save_file(t, NULL, w->large_file) == VOXRT_OK);
    voxrt_tree_destroy(t);
    d.resolution = 30;
    d.fill = 1;
    d.disable_normals = 1;
    CHECK(voxrt_tree_build(&d, &w->mesh, NULL, &w->solid) == VOXRT_OK);
    CHECK(scene_of(w, &env, &w->gi) == VOXRT_OK);
    CHECK(build_small(w, &env) == VOXRT_OK && edit_blocks(w, &env) == VOXRT_OK && coarse_lights(w, &env) == VOXRT_OK);
    CHECK(w->edited[1] != w->edited[2] && w->edited[2] != w->edited[3]);
}

static const struct call { const char *name; voxrt_result (*run)(world *w, const voxrt_env *env); uint32_t least; } call[] = {
    {"save a tree", save_tree, 3}, {"load a tree", load_tree, 3}, {"save an octree", save_octree, 1}, {"load an octree", load_octree, 2},
    {"save pages", save_pages, 3}, {"build pages", build_pages, 5}, {"draw pages", draw_pages, 3}, {"points", points, 3}, {"scene", memory_scene, 5},
    {"model", memory_model, 10}, {"blur", blur, 1}, {"load a large tree", load_large, 5}, {"build what is small", build_small, 20},
    {"share and back", share_and_back, 10}, {"octree of what is filled", octree_of_solid, 5}, {"build pieces", build_pieces, 20},
    {"edit blocks", edit_blocks, 20}, {"coarse virtual lights", coarse_lights, 5}
};

typedef struct one_call { world *w; uint32_t which; } one_call;

static int run_call(void *user, test_alloc *ta, unsigned threads) {
    const one_call *c = (const one_call *)user;
    voxrt_env env;
    memset(&env, 0, sizeof env);
    env.allocator.alloc_fn = test_alloc_fn;
    env.allocator.free_fn = test_free_fn;
    env.allocator.user = ta;
    env.thread_count = threads;
    return (int)call[c->which].run(c->w, &env);
}

TEST(every_request_refused) {
    world w;
    one_call c;
    unsigned threads;
    world_open(&w);
    world_more(&w);
    c.w = &w;
    for (c.which = 0; c.which < sizeof call / sizeof call[0]; c.which++)
        for (threads = 1; threads <= 2; threads++) {
            if (test_quick() && (threads == 2) != (c.which % 2 == 1)) continue; /* one of them */
            test_refuse_requests(call[c.which].name, run_call, &c, threads, (int)VOXRT_ERR_NO_MEMORY, call[c.which].least,
                                 test_quick() || threads == 2 ? 8 : 0); /* quick: the first ones all, later ones some */
        }
    world_close(&w);
}

/* ---- calls that ask ---- */

/* Triangles of many colours, filled: more colours than the palette has, for either way to choose it. */
static voxrt_result built(world *w, const voxrt_env *env, voxrt_palette_method method, uint32_t planes) {
    static uint8_t rgb[4096 * 3];
    voxrt_build_desc d;
    voxrt_mesh m = w->mesh;
    voxrt_tree *t = NULL;
    voxrt_result r;
    size_t i;
    memset(&d, 0, sizeof d);
    CHECK(m.vertex_count <= sizeof rgb / 3);
    for (i = 0; i < 3 * m.vertex_count && i < sizeof rgb; i++) rgb[i] = (uint8_t)(i * 2654435761u >> 13);
    m.vertex_rgb = rgb;
    d.env = *env;
    d.resolution = method == VOXRT_PALETTE_THESIS ? 30 : 100;
    d.palette_size = 200;
    d.palette_method = method;
    d.planes = planes;
    d.fill = 1;
    r = voxrt_tree_build(&d, &m, NULL, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    voxrt_tree_destroy(t);
    return r;
}
static voxrt_result build_oklab(world *w, const voxrt_env *env) { return built(w, env, VOXRT_PALETTE_OKLAB, 1); }
static voxrt_result build_thesis(world *w, const voxrt_env *env) { return built(w, env, VOXRT_PALETTE_THESIS, 0); }

static voxrt_result one_large_triangle(world *w, const voxrt_env *env) { /* tens of thousands of rows of bricks are looked at */
    static const float p[9] = {0, 0, 0, 16000, 16000, 100, 16000, 15999, 16000};
    voxrt_build_desc d;
    voxrt_mesh m;
    voxrt_tree *t = NULL;
    voxrt_result r;
    (void)w;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    m.positions = p;
    m.vertex_count = 3;
    m.triangle_count = 1;
    d.env = *env;
    d.env.memory_limit = 8u << 20; /* it ends soon behind that */
    d.resolution = 8192;
    r = voxrt_tree_build(&d, &m, NULL, &t);
    CHECK(t == NULL && r != VOXRT_OK);
    return r == VOXRT_ERR_NO_MEMORY ? VOXRT_OK : r;
}

static voxrt_result build_list(world *w, const voxrt_env *env) {
    voxrt_build_desc d;
    voxrt_voxel v[6 * 400];
    voxrt_tree *t = NULL;
    voxrt_result r;
    uint32_t i;
    (void)w;
    memset(&d, 0, sizeof d);
    memset(v, 0, sizeof v);
    for (i = 0; i < 6 * 400; i++) { /* a hollow box */
        const uint32_t face = i / 400, a = face / 2;
        uint32_t at[3];
        at[a] = face & 1 ? 20 : 1;
        at[(a + 1) % 3] = 1 + i % 20;
        at[(a + 2) % 3] = 1 + i / 20 % 20;
        v[i].x = at[0];
        v[i].y = at[1];
        v[i].z = at[2];
    }
    d.env = *env;
    d.fill = 1;
    r = voxrt_tree_from_voxels(&d, v, 6 * 400, 5, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    voxrt_tree_destroy(t);
    return r;
}

static voxrt_result build_octree(world *w, const voxrt_env *env) {
    voxrt_octree_desc d;
    voxrt_tree *t = NULL;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    r = voxrt_tree_from_octree(&d, w->octree, &t);
    CHECK((r == VOXRT_OK) == (t != NULL));
    voxrt_tree_destroy(t);
    return r;
}

/* An edit that is cancelled has done nothing. */
static voxrt_result edited(world *w, const voxrt_env *env, int way) {
    static const double lo[3] = {0, 0, 0}, hi[3] = {250, 250, 6}, centre[3] = {128, 128, 128};
    voxrt_model_desc d;
    voxrt_edit_desc e;
    voxrt_build_desc b;
    voxrt_edit_stats stats;
    voxrt_model_info before, after;
    voxrt_model *m = NULL;
    voxrt_tree *t = NULL;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    memset(&e, 0, sizeof e);
    memset(&b, 0, sizeof b);
    d.env = *env;
    d.env.progress_fn = NULL;
    e.env = d.env;
    d.depth = 8;
    if (way == 2) {
        d.box_min[0] = d.box_min[1] = d.box_min[2] = -1.2;
        d.box_size = 2.4;
    }
    CHECK(voxrt_model_create(&d, &m) == VOXRT_OK);
    if (way != 2) CHECK(voxrt_model_sphere(m, &e, centre, 20, NULL) == VOXRT_OK);
    voxrt_model_get_info(m, &before);
    e.env = b.env = *env;
    r = way == 0 ? voxrt_model_box(m, &e, lo, hi, &stats) : way == 1 ? voxrt_model_sphere(m, &e, centre, 80, &stats) :
        way == 2 ? voxrt_model_mesh(m, &e, &w->mesh, &stats) : VOXRT_OK;
    voxrt_model_get_info(m, &after);
    if (way < 3) CHECK(r == VOXRT_OK ? after.voxel_count > before.voxel_count : memcmp(&before, &after, sizeof after) == 0 && stats.filled == 0);
    if (way == 3) {
        r = voxrt_tree_from_model(&b, m, &t);
        CHECK((r == VOXRT_OK) == (t != NULL));
        voxrt_tree_destroy(t);
    }
    voxrt_model_destroy(m);
    return r;
}
static voxrt_result edit_box(world *w, const voxrt_env *env) { return edited(w, env, 0); }
static voxrt_result edit_sphere(world *w, const voxrt_env *env) { return edited(w, env, 1); }
static voxrt_result edit_mesh(world *w, const voxrt_env *env) { return edited(w, env, 2); }
static voxrt_result tree_of_model(world *w, const voxrt_env *env) { return edited(w, env, 3); }

enum { TINY = 8 };

/* Few pixels with many samples: nothing is between two rows of tiles. */
static voxrt_result drawn(world *w, const voxrt_env *env) {
    static float rgba[TINY * TINY * 4];
    voxrt_render_desc d;
    voxrt_image image;
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    d.env = *env;
    d.samples = 5000;
    d.view = VOXRT_VIEW_UNLIT;
    image.width = image.height = TINY;
    image.rgba = rgba;
    return voxrt_render(&d, w->tree, &image, NULL);
}

static voxrt_result blurred(const voxrt_env *env, float footprint) {
    enum { WIDE = 128 };
    static float rgba[WIDE * WIDE * 4], depth[WIDE * WIDE];
    static voxrt_hit hit[WIDE * WIDE];
    voxrt_image image;
    voxrt_blur_desc d;
    int i;
    memset(&image, 0, sizeof image);
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.radius = 64;
    d.footprint = footprint;
    d.voxel_size = 1;
    for (i = 0; i < WIDE * WIDE; i++) depth[i] = 1;
    image.width = image.height = WIDE;
    image.rgba = rgba;
    image.depth = depth;
    image.hit = hit;
    return voxrt_blur(&d, &image);
}
static voxrt_result blur_all(world *w, const voxrt_env *env) { (void)w; return blurred(env, 0); }
static voxrt_result blur_voxels(world *w, const voxrt_env *env) { (void)w; return blurred(env, 0.06f); }

/* Few pixels with many rays, each way. A bounce that is cancelled leaves light as it was. */
static voxrt_result memory_lit(world *w, const voxrt_env *env, voxrt_gi_method method, voxrt_gi_lookup lookup, float tolerance, int what) {
    static float position[TINY * TINY][3], normal[TINY * TINY][3], albedo[TINY * TINY][3], out[3][TINY * TINY][3];
    const voxrt_camera c = camera_at(1, 2.5, 1.5);
    voxrt_env quiet = *env;
    voxrt_gi_render_desc d;
    voxrt_gi_light l[20];
    voxrt_gi_object o;
    voxrt_gbuffer g;
    voxrt_gi *gi = NULL;
    voxrt_result r;
    int i;
    memset(&d, 0, sizeof d);
    memset(&g, 0, sizeof g);
    memset(l, 0, sizeof l);
    quiet.progress_fn = NULL;
    CHECK(scene_of(w, &quiet, &gi) == VOXRT_OK);
    memset(&o, 0, sizeof o); /* a small sphere beside the large one */
    o.mesh = w->mesh;
    o.to_world[0] = o.to_world[5] = o.to_world[10] = 0.3;
    o.to_world[3] = o.to_world[7] = 0.9;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    l[0].position[0] = 0.3f;
    l[0].position[1] = l[1].position[1] = 1.25f;
    l[0].color[0] = l[1].color[1] = 1;
    l[1].kind = VOXRT_GI_AREA;
    l[1].edge_u[0] = l[1].edge_v[2] = 0.1f;
    for (i = 2; i < 20; i++) l[i] = l[0];
    CHECK(voxrt_gi_set_lights(gi, l, lookup == VOXRT_GI_LOOKUP_VOLUME ? 20 : 2) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    g.width = g.height = TINY;
    g.position = position[0];
    g.normal = normal[0];
    g.albedo = albedo[0];
    CHECK(voxrt_gbuffer_from_gi(&quiet, &c, gi, &g) == VOXRT_OK);
    d.env = *env;
    d.method = method;
    d.lookup = lookup;
    d.tolerance = tolerance;
    d.bounces = method == VOXRT_GI_PATH ? 4 : 1;
    d.pattern = 1;
    d.map_size = 512;
    d.rays = what == 1 || (what == 0 && method == VOXRT_GI_NONE) ? 4 : 4000;
    if (what == 0) {
        r = voxrt_gi_render(&d, gi, &g, method == VOXRT_GI_NONE ? out[0][0] : NULL, out[1][0], NULL);
    } else if (what == 1) {
        d.env = quiet;
        CHECK(voxrt_gi_bounce(gi, &quiet, 4, 0, 1) == VOXRT_OK);
        CHECK(voxrt_gi_render(&d, gi, &g, NULL, out[0][0], NULL) == VOXRT_OK);
        r = voxrt_gi_bounce(gi, env, 16, 0, 2);
        CHECK(voxrt_gi_render(&d, gi, &g, NULL, out[1][0], NULL) == VOXRT_OK);
        CHECK((memcmp(out[0], out[1], sizeof out[0]) == 0) == (r != VOXRT_OK));
    } else { /* light of a lamp with an area, as many rays to it */
        r = voxrt_gi_render(&d, gi, &g, out[0][0], NULL, NULL);
    }
    voxrt_gi_destroy(gi);
    return r;
}
static voxrt_result gather(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_GATHER, VOXRT_GI_LOOKUP_RAYS, 0, 0); }
static voxrt_result until(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_GATHER, VOXRT_GI_LOOKUP_CACHE, 1e-6f, 0); }
static voxrt_result paths(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_PATH, VOXRT_GI_LOOKUP_CACHE, 0, 0); }
static voxrt_result occlusion(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_AO, VOXRT_GI_LOOKUP_CACHE, 0, 0); }
static voxrt_result virtual_lights(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_VPL, VOXRT_GI_LOOKUP_CACHE, 0, 0); }
static voxrt_result all_cells(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_NONE, VOXRT_GI_LOOKUP_VOLUME, 0, 0); }
static voxrt_result maps(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_NONE, VOXRT_GI_LOOKUP_MAPS, 0, 0); }
static voxrt_result bounce(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_GATHER, VOXRT_GI_LOOKUP_CACHE, 0, 1); }
static voxrt_result wide_lamp(world *w, const voxrt_env *env) { return memory_lit(w, env, VOXRT_GI_NONE, VOXRT_GI_LOOKUP_CACHE, 0, 2); }

static int deaf; /* stop_fn only says that all may go on */

/* Points of triangles, too many to wait for; a scene of them can be made after it was cancelled. */
static voxrt_result sampled(world *w, const voxrt_env *env) {
    voxrt_columns_desc d;
    voxrt_columns_insert_desc in;
    voxrt_columns *c = NULL;
    voxrt_result r;
    int a;
    memset(&d, 0, sizeof d);
    memset(&in, 0, sizeof in);
    d.env = in.env = *env;
    in.mode = VOXRT_COLUMNS_SAMPLES;
    in.spacing = 0.05f;
    d.size_x = d.size_y = d.size_z = 64;
    for (a = 0; a < 3; a++) {
        d.box_min[a] = -1.2;
        d.box_max[a] = 1.2;
    }
    CHECK(voxrt_columns_create(&d, &c) == VOXRT_OK);
    r = voxrt_columns_insert(c, &in, &w->mesh, NULL);
    voxrt_columns_destroy(c);
    return r;
}

static voxrt_result sampled_scene(world *w, const voxrt_env *env) {
    voxrt_gi_desc d;
    voxrt_gi_object o;
    voxrt_gi_update_stats whole, again;
    voxrt_gi *gi[2] = {NULL, NULL};
    voxrt_result r = VOXRT_OK;
    int a, k;
    memset(&d, 0, sizeof d);
    memset(&o, 0, sizeof o);
    memset(&whole, 0, sizeof whole);
    memset(&again, 0, sizeof again);
    d.env = *env;
    d.columns.size_x = d.columns.size_y = d.columns.size_z = 64;
    for (a = 0; a < 3; a++) {
        d.columns.box_min[a] = -1.2;
        d.columns.box_max[a] = 1.2;
    }
    o.mesh = w->mesh;
    o.mode = VOXRT_COLUMNS_SAMPLES;
    o.spacing = 0.1f;
    for (k = 0; k < 2; k++) {
        if (k == 1) d.env.progress_fn = NULL;
        CHECK(voxrt_gi_create(&d, &gi[k]) == VOXRT_OK && voxrt_gi_add(gi[k], &o, NULL) == VOXRT_OK);
    }
    r = voxrt_gi_update(gi[0], &again);
    deaf = 1;
    CHECK(voxrt_gi_update(gi[1], &whole) == VOXRT_OK);
    if (r != VOXRT_OK) CHECK(voxrt_gi_update(gi[0], &again) == VOXRT_OK);
    CHECK(whole.moving_cells != 0 && whole.moving_cells == again.moving_cells);
    deaf = 0;
    for (k = 0; k < 2; k++) voxrt_gi_destroy(gi[k]);
    return r;
}

static const struct ask { const char *name; voxrt_result (*run)(world *w, const voxrt_env *env); uint32_t least; } ask[] = {
    {"build", build_oklab, 20}, {"build with the palette of the thesis", build_thesis, 8}, {"build from a list", build_list, 3},
    {"a large triangle", one_large_triangle, 10}, {"build from an octree", build_octree, 2}, {"edit a box", edit_box, 4},
    {"edit a sphere", edit_sphere, 6}, {"edit by a mesh", edit_mesh, 10}, {"tree of a model", tree_of_model, 2}, {"picture", drawn, 4},
    {"blur", blur_all, 12}, {"blur by voxels", blur_voxels, 12}, {"gather", gather, 3}, {"gather until", until, 2}, {"paths", paths, 4},
    {"occlusion", occlusion, 2}, {"virtual lights", virtual_lights, 2}, {"light on all cells", all_cells, 1}, {"maps", maps, 20},
    {"bounce", bounce, 8}, {"wide lamp", wide_lamp, 1},
    {"samples", sampled, 4}, {"scene of samples", sampled_scene, 4}
};

typedef struct memory_stopper {
    pthread_mutex_t lock;
    uint64_t calls, stop_at, done, total;
    unsigned backwards, twice;
} memory_stopper;

static int memory_stop_fn(void *user, uint64_t done, uint64_t total) {
    memory_stopper *s = (memory_stopper *)user;
    int stop;
    if (deaf) return 0;
    if (pthread_mutex_trylock(&s->lock) != 0) { /* never two at once */
        s->twice++;
        return 0;
    }
    s->backwards += done < s->done || done > total || total == 0 || (s->calls != 0 && total != s->total);
    s->done = done;
    s->total = total;
    stop = ++s->calls == s->stop_at;
    (void)pthread_mutex_unlock(&s->lock);
    return stop;
}

/* The first ones, then always twice as far; when it has to be quick one in the middle. */
static uint64_t next_question(uint64_t at, uint64_t most) {
    if (test_quick()) return at == 0 && most > 0 ? (most + 1) / 2 : most + 1;
    return at < 4 ? at + 1 : 2 * at;
}

/* Every call that asks whether to go on is cancelled at its questions: that is what it says, it asks no more, and nothing
   is left. With one thread and with three; when it has to be quick every other call with one. */
TEST(cancelled) {
    world w;
    uint32_t i, threads;
    world_open(&w);
    for (i = 0; i < sizeof ask / sizeof ask[0]; i++)
        for (threads = 1; threads <= 3; threads += 2) {
            uint64_t at, most = 0;
            if (test_quick() && (threads == 3) != (i % 2 == 1)) continue;
            for (at = 0; at <= most; at = next_question(at, most)) { /* 0: never, to count the questions */
                voxrt_env env;
                voxrt_error error;
                test_alloc ta;
                memory_stopper s;
                voxrt_result r;
                test_alloc_init(&ta);
                memset(&env, 0, sizeof env);
                memset(&error, 0, sizeof error);
                memset(&s, 0, sizeof s);
                (void)pthread_mutex_init(&s.lock, NULL);
                env.allocator.alloc_fn = test_alloc_fn;
                env.allocator.free_fn = test_free_fn;
                env.allocator.user = &ta;
                env.thread_count = threads;
                env.error = &error;
                env.progress_fn = memory_stop_fn;
                env.progress_user = &s;
                s.stop_at = at;
                r = ask[i].run(&w, &env);
                test_alloc_check(&ta);
                (void)pthread_mutex_destroy(&s.lock);
                if (at == 0) {
                    CHECK_MSG(r == VOXRT_OK && s.calls >= (threads == 1 ? ask[i].least : 1), "%s asks %u times, result %d",
                              ask[i].name, (unsigned)s.calls, (int)r);
                    most = s.calls;
                } else if (s.calls >= at) {
                    CHECK_MSG(r == VOXRT_ERR_CANCELLED && error.code == r && s.calls == at, "%s, question %u of %u: result %d, %u", ask[i].name,
                              (unsigned)at, (unsigned)most, (int)r, (unsigned)s.calls);
                }
                CHECK_MSG(s.backwards == 0 && s.twice == 0, "%s: %u steps back, %u at once", ask[i].name, s.backwards, s.twice);
            }
        }
    world_close(&w);
}

/* What a tree or an octree gives to global illumination: places on the sphere, its normals, its colour. */
TEST(buffers_from_geometry) {
    static float position[MEMORY_SIDE * MEMORY_SIDE][3], normal[MEMORY_SIDE * MEMORY_SIDE][3], albedo[MEMORY_SIDE * MEMORY_SIDE][3],
        specular[MEMORY_SIDE * MEMORY_SIDE][4], emission[MEMORY_SIDE * MEMORY_SIDE][3],
        before[MEMORY_SIDE * MEMORY_SIDE][3];
    const voxrt_camera c = camera_at(2, 1.5, 3);
    voxrt_gbuffer g;
    world w;
    voxrt_gi *gi = NULL;
    voxrt_env env;
    int way;
    memset(&g, 0, sizeof g);
    memset(&env, 0, sizeof env);
    g.width = g.height = MEMORY_SIDE;
    g.position = position[0];
    g.normal = normal[0];
    g.albedo = albedo[0];
    g.specular = specular[0];
    g.emission = emission[0];
    g.before = before[0];
    world_open(&w);
    CHECK(scene_of(&w, &env, &gi) == VOXRT_OK);
    for (way = 0; way < 3; way++) {
        voxrt_geometry from;
        double worst = 0, off = 0;
        int i, a, hits = 0;
        memset(specular, 1, sizeof specular);
        memset(emission, 1, sizeof emission);
        if (way == 0) voxrt_tree_geometry(w.tree, &from);
        if (way == 1) voxrt_octree_geometry(w.octree, &from);
        CHECK((way < 2 ? voxrt_gbuffer_from_geometry(NULL, &c, &from, &g) : voxrt_gbuffer_from_gi(NULL, &c, gi, &g)) == VOXRT_OK);
        for (i = 0; i < MEMORY_SIDE * MEMORY_SIDE; i++) {
            double n = 0, radius = 0, dot = 0;
            float rest = 0;
            for (a = 0; a < 3; a++) {
                n += (double)normal[i][a] * (double)normal[i][a];
                radius += (double)position[i][a] * (double)position[i][a];
                dot += (double)position[i][a] * (double)normal[i][a];
                rest += fabsf(specular[i][a]) + fabsf(emission[i][a]) + fabsf(before[i][a] - position[i][a]);
            }
            CHECK(rest <= 0);
            if (n < 0.5) {
                CHECK(radius <= 0);
                continue;
            }
            CHECK_NEAR(n, 1, 1e-4);
            worst = fmax(worst, fabs(sqrt(radius) - 1));
            off += 1 - dot / sqrt(radius);
            hits++;
        }
        CHECK_MSG(hits > MEMORY_SIDE * MEMORY_SIDE / 4 && worst < (way < 2 ? 2 * 0.0554 : 2 * 0.141), "way %d: %d hits, %g off", way, hits, worst);
        CHECK_MSG(off < 0.02 * hits, "way %d: normals %g off", way, off / hits);
    }
    CHECK(voxrt_gbuffer_from_geometry(NULL, &c, NULL, &g) == VOXRT_ERR_INVALID_ARG);
    g.albedo = NULL;
    CHECK(voxrt_gbuffer_from_gi(NULL, &c, gi, &g) == VOXRT_ERR_INVALID_ARG);
    voxrt_gi_destroy(gi);
    world_close(&w);
}

TEST(names) {
    int i, k;
#define NAME(id, value, text) CHECK(strcmp(voxrt_result_string((voxrt_result)value), text) == 0);
    VOXRT_RESULT_LIST(NAME)
#undef NAME
    CHECK(strcmp(voxrt_result_string((voxrt_result)1234), "unknown result") == 0);
    for (i = 0; i <= VOXRT_ISA_AVX512; i++)
        for (k = 0; k < i; k++) CHECK(strcmp(voxrt_isa_name((voxrt_isa)i), voxrt_isa_name((voxrt_isa)k)) != 0);
    CHECK(strcmp(voxrt_isa_name((voxrt_isa)99), "unknown") == 0);
    CHECK(voxrt_version() == VOXRT_VERSION);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(every_request_refused);
    RUN(cancelled);
    RUN(buffers_from_geometry);
    RUN(names);
    return test_end();
}
