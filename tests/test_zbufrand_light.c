/* test_zbufrand_light.c - lights of the caller, normals of clouds, and requests for memory of what works without pictures
   SPDX-License-Identifier: MIT OR Unlicense */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "zbufrand_shapes.h"

enum { W = 120, H = 90, LIGHTS = 6 };

static zbufrand_scene *scene_of(const zbufrand_env *env, const zbufrand_mesh *m, zbufrand_result *r) {
    zbufrand_scene *s = NULL;
    zbufrand_scene_desc d;
    memset(&d, 0, sizeof d);
    if (env != NULL) d.env = *env;
    *r = zbufrand_scene_create(&d, &s);
    if (*r == ZBUFRAND_OK) *r = zbufrand_add_mesh(s, 1, NULL, 0, m, NULL);
    if (*r == ZBUFRAND_OK) *r = zbufrand_scene_build(s, NULL, NULL);
    return s;
}

/* Lambert in doubles: what a white point with this unit normal shows. */
static void shaded(const zbufrand_render_desc *d, const double p[3], const double n[3], double rgb[3]) {
    size_t i;
    int a;
    for (a = 0; a < 3; a++) rgb[a] = (double)d->ambient[a];
    for (i = 0; i < d->light_count; i++) {
        const zbufrand_light *l = &d->lights[i];
        double to[3], length = 0, c = 0;
        for (a = 0; a < 3; a++) {
            to[a] = l->position[a] - (l->directional ? 0 : p[a]);
            length += to[a] * to[a];
            c += to[a] * n[a];
        }
        for (a = 0; a < 3 && c > 0; a++) rgb[a] += (double)l->color[a] * c / sqrt(length);
    }
}

/* A smooth sphere far from the origin, and its points as a cloud with normals: every pixel against Lambert's law, near lights and
   far ones, from all sides, inside of nothing. */
TEST(lights) {
    static float rgba[W * H * 4], depth[W * H], normals[60000 * 3], positions[60000 * 3];
    static const double away[3] = {100, -50, 20};
    zbufrand_frame *frame = NULL;
    zbufrand_frame_desc fd;
    zbufrand_scene *scene;
    zbufrand_image image;
    zbufrand_surface_points_desc pd;
    zbufrand_result r;
    zbufrand_mesh m;
    shape s;
    test_rng rng = test_rng_make(8);
    uint32_t way, i, a;
    memset(&s, 0, sizeof s);
    memset(&fd, 0, sizeof fd);
    memset(&image, 0, sizeof image);
    memset(&pd, 0, sizeof pd);
    shape_sphere(&s, away[0], away[1], away[2], 1, 80);
    m = mesh_of(&s);
    m.normals = s.normal;
    scene = scene_of(NULL, &m, &r);
    CHECK_EQ_U64(r, ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_frame_create(&fd, &frame), ZBUFRAND_OK);
    REQUIRE(frame != NULL);
    pd.vertex_normals = 1;
    CHECK_EQ_U64(zbufrand_surface_points(scene, &pd, 60000, positions, normals, NULL, NULL), ZBUFRAND_OK);
    image.width = W;
    image.height = H;
    image.rgba = rgba;
    image.depth = depth;
    for (way = 0; way < 12; way++) { /* rastered, sampled, a cloud */
        zbufrand_light light[LIGHTS];
        zbufrand_render_desc d;
        zbufrand_points cloud;
        zbufrandi_camera c;
        double sum = 0, worst = 0, bright = 0;
        uint32_t seen = 0;
        memset(light, 0, sizeof light);
        memset(&d, 0, sizeof d);
        memset(&cloud, 0, sizeof cloud);
        for (i = 0; i < LIGHTS; i++) {
            light[i].directional = i % 2;
            for (a = 0; a < 3; a++) {
                light[i].position[a] = (i % 2 ? 0 : away[a]) + 6 * (test_rng_double(&rng) - 0.5);
                light[i].color[a] = 0.5f * test_rng_float(&rng);
            }
        }
        light[0].position[0] = away[0] + 1.7;
        d.lights = light;
        d.light_count = way == 4 ? 0 : way % 5 + 1;
        for (a = 0; a < 3; a++) {
            d.ambient[a] = 0.02f * (float)(a + 1);
            d.camera.at[a] = away[a];
            d.camera.eye[a] = away[a] + (a == way % 3 ? 4.0 : 1.0);
        }
        d.hybrid = way % 3 == 1 ? ZBUFRAND_HYBRID_OFF : ZBUFRAND_HYBRID_AUTO;
        if (way % 3 == 2) {
            cloud.positions = positions;
            cloud.normals = normals;
            cloud.count = 60000;
            d.points = &cloud;
            d.points_count = 1;
        }
        CHECK_EQ_U64(zbufrand_render(frame, &d, way % 3 == 2 ? NULL : scene, &image, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, W, H, 0, &c), ZBUFRAND_OK);
        for (i = 0; i < W * H; i++) {
            const double x = ((double)(i % W) + 0.5 - c.center_x) / c.focal, y = (c.center_y - (double)(i / W) - 0.5) / c.focal;
            double p[3], n[3], want[3], length = 0, facing = 0;
            if (!(rgba[4 * i + 3] > 0)) continue;
            for (a = 0; a < 3; a++) {
                p[a] = c.eye[a] + (double)depth[i] * (c.dir[a] + x * c.right[a] + y * c.up[a]);
                n[a] = p[a] - away[a];
                length += n[a] * n[a];
            }
            for (a = 0; a < 3; a++) {
                n[a] /= sqrt(length);
                facing += n[a] * (c.eye[a] - p[a]) / 3.5;
            }
            if (facing < 0.4) continue; /* at the rim a pixel shows a wide stretch, and through gaps of the cloud its far side */
            shaded(&d, p, n, want);
            for (a = 0; a < 3; a++) {
                const double off = fabs((double)rgba[4 * i + a] - want[a]);
                sum += off;
                worst = fmax(worst, off);
                bright = fmax(bright, want[a]);
            }
            seen++;
        }
        CHECK(d.light_count > 0 || bright < 0.07);
        CHECK_MSG(seen > 1000 && sum < 0.01 * 3 * seen && worst < 0.12 * (1 + bright), "way %u: %u pixels, %g off, %g at most", way, seen,
                  sum / (3.0 * seen), worst);
        light[0].position[1] = (double)NAN;
        CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, NULL), d.light_count > 0 ? ZBUFRAND_ERR_INVALID_ARG : ZBUFRAND_OK);
    }
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* ---- memory ---- */

typedef struct world { zbufrand_mesh mesh, coloured; uint8_t rgb[3000]; shape s; } world;

/* Whatever was refused: from here on there is memory. */
static void memory_again(const zbufrand_env *env) {
    test_alloc *ta = (test_alloc *)env->allocator.user;
    ta->fail_at = -1;
}

static zbufrand_result points_of_scene(const world *w, const zbufrand_env *env) {
    static float position[3 * 500], normal[3 * 500];
    static uint8_t rgb[3 * 500];
    zbufrand_surface_points_desc d;
    zbufrand_result r;
    zbufrand_scene *s = scene_of(env, &w->mesh, &r);
    memset(&d, 0, sizeof d);
    if (r == ZBUFRAND_OK) r = zbufrand_surface_points(s, &d, 500, position, normal, rgb, NULL);
    d.independent = 1;
    if (r == ZBUFRAND_OK) r = zbufrand_surface_points(s, &d, 500, position, normal, NULL, NULL);
    zbufrand_scene_destroy(s);
    return r;
}

static zbufrand_result whole_page(const world *w, const zbufrand_env *env) { /* a million points: written page by page where that is faster */
    float *p = (float *)malloc(12 * (size_t)(1 << 20));
    zbufrand_result r;
    zbufrand_scene *s = scene_of(env, &w->mesh, &r);
    if (p == NULL) abort();
    if (r == ZBUFRAND_OK) r = zbufrand_surface_points(s, NULL, 1 << 20, p, NULL, NULL, NULL);
    zbufrand_scene_destroy(s);
    free(p);
    return r;
}

static int each_sample(void *user, const zbufrand_sample *sample, const uint32_t *numbers, size_t count) {
    (void)sample;
    (void)numbers;
    *(size_t *)user += count;
    return 0;
}

static zbufrand_result choices(const world *w, const zbufrand_env *env) {
    zbufrand_frame_desc fd;
    zbufrand_render_desc d;
    zbufrand_frame *f = NULL;
    zbufrand_result r;
    size_t n = 0, samples = 0;
    zbufrand_scene *s = scene_of(env, &w->mesh, &r);
    memset(&fd, 0, sizeof fd);
    memset(&d, 0, sizeof d);
    fd.env = *env;
    d.camera.eye[2] = 5;
    if (r == ZBUFRAND_OK) r = zbufrand_frame_create(&fd, &f);
    if (r == ZBUFRAND_OK) r = zbufrand_select(f, &d, s, W, H, NULL, 0, &n, NULL);
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    if (r == ZBUFRAND_OK) r = zbufrand_sample_scene(f, &d, s, W, H, each_sample, &samples, NULL);
    CHECK(r != ZBUFRAND_OK || (n > 0 && samples > 1000));
    zbufrand_frame_destroy(f);
    zbufrand_scene_destroy(s);
    return r;
}

static zbufrand_result edited(const world *w, const zbufrand_env *env) { /* the first mesh with colours and normals comes when all is built */
    zbufrand_transform t;
    zbufrand_node node;
    zbufrand_result r;
    zbufrand_scene *s = scene_of(env, &w->mesh, &r);
    memset(&t, 0, sizeof t);
    t.m[0][0] = t.m[1][1] = t.m[2][2] = 1;
    t.m[0][3] = 3;
    if (r == ZBUFRAND_OK) r = zbufrand_add_mesh(s, 1, &t, 1, &w->coloured, &node);
    if (r == ZBUFRAND_OK) r = zbufrand_scene_update(s, NULL);
    if (r == ZBUFRAND_OK) r = zbufrand_move(s, node, &t);
    if (r == ZBUFRAND_OK) r = zbufrand_scene_update(s, NULL);
    if (r == ZBUFRAND_OK) r = zbufrand_remove(s, node);
    if (r == ZBUFRAND_OK) r = zbufrand_scene_update(s, NULL);
    zbufrand_scene_destroy(s);
    return r;
}

/* Points of a scene whose areas edits changed: they are summed anew. Refused, and asked for again, they are the same. */
static zbufrand_result points_of_edited(const world *w, const zbufrand_env *env) {
    static float position[2][3 * 50];
    static int known;
    zbufrand_transform t = move_scale(3, 0, 0, 2);
    zbufrand_node node;
    zbufrand_result r;
    zbufrand_scene *s = scene_of(env, &w->mesh, &r);
    if (r == ZBUFRAND_OK) r = zbufrand_add_mesh(s, 1, &t, 0, &w->coloured, &node);
    if (r == ZBUFRAND_OK) r = zbufrand_scene_update(s, NULL);
    if (r == ZBUFRAND_OK) {
        CHECK(s->structure[0].sum_stale);
        r = zbufrand_surface_points(s, NULL, 50, position[known], NULL, NULL, NULL);
        if (r != ZBUFRAND_OK) {
            memory_again(env);
            CHECK_EQ_U64(zbufrand_surface_points(s, NULL, 50, position[known], NULL, NULL, NULL), ZBUFRAND_OK);
        }
        if (known) CHECK(memcmp(position[0], position[1], sizeof position[0]) == 0);
        known = 1;
    }
    zbufrand_scene_destroy(s);
    return r;
}

static zbufrand_result mended(const world *w, const zbufrand_env *env) { /* a wall with holes; a picture that is not mended stays as it was */
    static float rgba[40 * 40 * 4], depth[40 * 40];
    zbufrand_suspect_desc d;
    zbufrand_suspect list[400];
    zbufrand_result r;
    size_t n = 0, i;
    (void)w;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.width = d.height = 40;
    for (i = 0; i < 40 * 40; i++) {
        depth[i] = i % 7 == 0 ? INFINITY : 1;
        rgba[4 * i] = rgba[4 * i + 3] = i % 7 == 0 ? 0.0f : 1.0f;
    }
    r = zbufrand_find_suspects(&d, depth, list, 400, &n);
    CHECK((r == ZBUFRAND_OK) == (n != 0) && n <= 400);
    if (r == ZBUFRAND_OK) r = zbufrand_mend(&d, rgba, depth, list, n);
    for (i = 40; i < 39 * 40; i++) {
        const int border = i % 40 == 0 || i % 40 == 39;
        CHECK(border || (depth[i] < INFINITY) == (i % 7 != 0 || r == ZBUFRAND_OK));
    }
    return r;
}

static zbufrand_result lists(const world *w, const zbufrand_env *env) { /* nodes that come into lists one by one */
    zbufrand_scene_desc d;
    zbufrand_scene *s = NULL;
    zbufrand_result r;
    zbufrand_node node[20], list;
    int i;
    memset(&d, 0, sizeof d);
    d.env = *env;
    r = zbufrand_scene_create(&d, &s);
    if (r == ZBUFRAND_OK) r = zbufrand_add_list(s, ZBUFRAND_ROOT, NULL, 0, &list);
    for (i = 0; i < 20 && r == ZBUFRAND_OK; i++) {
        r = i % 2 ? zbufrand_add_reference(s, 0, NULL, node[0], &node[i]) : zbufrand_add_mesh(s, 0, NULL, 0, &w->mesh, &node[i]);
        if (r == ZBUFRAND_OK) r = zbufrand_list_append(s, list, node[i]);
    }
    if (r == ZBUFRAND_OK) r = zbufrand_scene_build(s, NULL, NULL);
    zbufrand_scene_destroy(s);
    return r;
}

/* Many places of a mesh, and another one for one of them. What is refused changes nothing. */
static zbufrand_result places(const world *w, const zbufrand_env *env) {
    zbufrand_scene_desc d;
    zbufrand_scene *s = NULL;
    zbufrand_scene_info info;
    zbufrand_transform t[5], up;
    zbufrand_result r;
    zbufrand_node lib = 0, mesh = 0, many = 0;
    int i, k;
    memset(&d, 0, sizeof d);
    memset(t, 0, sizeof t);
    d.env = *env;
    for (i = 0; i < 5; i++) {
        for (k = 0; k < 3; k++) t[i].m[k][k] = 1;
        t[i].m[0][3] = 3 * i;
    }
    up = t[2];
    up.m[1][3] = 10;
    r = zbufrand_scene_create(&d, &s);
    if (r == ZBUFRAND_OK) r = zbufrand_add_list(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &lib);
    if (r == ZBUFRAND_OK) r = zbufrand_add_mesh(s, lib, NULL, 0, &w->mesh, &mesh);
    for (i = 0; i < 40 && r == ZBUFRAND_OK; i++) { /* the last ones are drawn */
        r = zbufrand_add_references(s, i < 39 ? lib : ZBUFRAND_ROOT, t, i < 39 ? 1 : 5, mesh, &many);
        CHECK((r == ZBUFRAND_OK) == (many != 0));
    }
    if (r == ZBUFRAND_OK) r = zbufrand_scene_build(s, NULL, &info);
    if (r == ZBUFRAND_OK) {
        CHECK(info.triangles == 5 * w->mesh.triangle_count && info.box_max[1] < 2);
        r = zbufrand_set_reference(s, many, 2, &up);
        if (r != ZBUFRAND_OK) { /* refused: what stands is what was built */
            const zbufrand_result again = zbufrand_scene_update(s, &info);
            CHECK(again == ZBUFRAND_ERR_NO_MEMORY || (again == ZBUFRAND_OK && info.box_max[1] < 2));
        }
    }
    if (r == ZBUFRAND_OK) {
        r = zbufrand_scene_update(s, &info);
        if (r == ZBUFRAND_OK) CHECK(info.triangles == 5 * w->mesh.triangle_count && info.box_max[1] > 10);
    }
    zbufrand_scene_destroy(s);
    return r;
}

/* Many nodes that wait for the next update, by one function: lists that are added before there is a structure, nodes that move, nodes
   that come into a list. What is refused has not happened. */
static zbufrand_result waiting(const world *w, const zbufrand_env *env, int what) {
    enum { MANY = 40 };
    zbufrand_scene_desc d;
    zbufrand_scene *s = NULL;
    zbufrand_scene_info info;
    zbufrand_transform up;
    zbufrand_result r;
    zbufrand_node node[MANY], mesh = 0, list = 0;
    int i, done = 0;
    memset(&d, 0, sizeof d);
    memset(&up, 0, sizeof up);
    for (i = 0; i < 3; i++) up.m[i][i] = 1;
    up.m[1][3] = 10;
    d.env = *env;
    r = zbufrand_scene_create(&d, &s);
    if (r == ZBUFRAND_OK) r = zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, 0, &w->mesh, &mesh);
    if (r == ZBUFRAND_OK) r = zbufrand_add_list(s, ZBUFRAND_ROOT, NULL, 0, &list);
    for (i = 0; i < MANY && r == ZBUFRAND_OK; i++) {
        r = what == 0 ? zbufrand_add_list(s, list, NULL, 0, &node[i]) : zbufrand_add_reference(s, what == 1 ? list : 0, NULL, mesh, &node[i]);
        CHECK((r == ZBUFRAND_OK) == (node[i] != 0));
    }
    if (r == ZBUFRAND_OK) r = zbufrand_scene_build(s, NULL, &info);
    for (i = 0; i < MANY && r == ZBUFRAND_OK && what != 0; i++) {
        r = what == 1 ? zbufrand_move(s, node[i], &up) : zbufrand_list_append(s, list, node[i]);
        done += r == ZBUFRAND_OK;
    }
    if (done != 0) {
        const zbufrand_result again = zbufrand_scene_update(s, &info);
        if (again == ZBUFRAND_OK) {
            CHECK_EQ_U64(info.triangles, w->mesh.triangle_count * (what == 1 ? MANY + 1u : (uint32_t)done + 1u));
            CHECK((info.box_max[1] > 10) == (what == 1));
        }
        if (r == ZBUFRAND_OK) r = again;
    }
    zbufrand_scene_destroy(s);
    return r;
}
static zbufrand_result many_lists(const world *w, const zbufrand_env *env) { return waiting(w, env, 0); }
static zbufrand_result many_moves(const world *w, const zbufrand_env *env) { return waiting(w, env, 1); }
static zbufrand_result many_appended(const world *w, const zbufrand_env *env) { return waiting(w, env, 2); }

/* A scene that makes a build ask for more than it usually does. Refused and built again, it is all there. */
enum { UNUSUAL_NESTED, UNUSUAL_SMALLER, UNUSUAL_ATTRIBUTES, UNUSUAL_VIEWS };

static zbufrand_result unusual_nodes(const world *w, zbufrand_scene *s, int what, uint64_t *triangles) {
    enum { DEEP = 70, SMALLER = 600, MANY = 33 };
    static zbufrand_transform t[SMALLER];
    zbufrand_mesh m = w->mesh;
    zbufrand_node node = ZBUFRAND_ROOT;
    zbufrand_result r = ZBUFRAND_OK;
    const uint32_t count = what == UNUSUAL_SMALLER ? SMALLER : MANY, meshes = what == UNUSUAL_VIEWS ? 4 : what == UNUSUAL_SMALLER ? 1 : 2;
    const int hidden = what == UNUSUAL_SMALLER || what == UNUSUAL_VIEWS;
    uint32_t i;
    for (i = 0; i < (what == UNUSUAL_NESTED ? DEEP : 1u) && r == ZBUFRAND_OK; i++)
        r = zbufrand_add_list(s, node, NULL, hidden ? ZBUFRAND_HIDDEN : 0u, &node);
    for (i = 0; i < meshes && r == ZBUFRAND_OK; i++) {
        if (what == UNUSUAL_ATTRIBUTES && i == 1) { /* this one has colours and normals, and another material */
            m = w->coloured;
            m.material = 1;
        }
        r = zbufrand_add_mesh(s, node, NULL, 0, &m, NULL);
    }
    *triangles = (uint64_t)meshes * m.triangle_count * (hidden ? count : 1);
    for (i = 0; i < count; i++) /* three at each place, ever smaller: trees are deep there; or many alike */
        t[i] = what == UNUSUAL_VIEWS ? move_scale(3.0 * i, 0, 0, 1) : move_scale(pow(0.8, (double)(i / 3)), 0, 0, pow(0.8, (double)(i / 3)));
    return r == ZBUFRAND_OK && hidden ? zbufrand_add_references(s, ZBUFRAND_ROOT, t, count, node, NULL) : r;
}

static zbufrand_result unusual(const world *w, const zbufrand_env *env, int what) {
    zbufrand_scene_desc d;
    zbufrand_scene_info info;
    zbufrand_scene *s = NULL;
    zbufrand_result r;
    uint64_t triangles = 0;
    memset(&d, 0, sizeof d);
    d.env = *env;
    r = zbufrand_scene_create(&d, &s);
    if (r == ZBUFRAND_OK) r = unusual_nodes(w, s, what, &triangles);
    if (r == ZBUFRAND_OK) {
        r = zbufrand_scene_build(s, NULL, &info);
        if (r != ZBUFRAND_OK) {
            memory_again(env);
            CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
        }
        CHECK_EQ_U64(info.triangles, triangles);
        if (what == UNUSUAL_ATTRIBUTES) CHECK(s->structure[0].set_rgb != NULL && s->structure[0].set_normal != NULL && s->structure[0].set_material != NULL);
        if (what == UNUSUAL_VIEWS) CHECK(s->structure_count == 2 && s->structure[1].view != NULL);
    }
    zbufrand_scene_destroy(s);
    return r;
}
static zbufrand_result nested_lists(const world *w, const zbufrand_env *env) { return unusual(w, env, UNUSUAL_NESTED); }
static zbufrand_result ever_smaller(const world *w, const zbufrand_env *env) { return unusual(w, env, UNUSUAL_SMALLER); }
static zbufrand_result all_attributes(const world *w, const zbufrand_env *env) { return unusual(w, env, UNUSUAL_ATTRIBUTES); }
static zbufrand_result with_views(const world *w, const zbufrand_env *env) { return unusual(w, env, UNUSUAL_VIEWS); }

static const struct call { const char *name; zbufrand_result (*run)(const world *w, const zbufrand_env *env); uint32_t least; } call[] = {
    {"points", points_of_scene, 5}, {"page of points", whole_page, 5}, {"choices", choices, 5}, {"edits", edited, 5},
    {"suspects", mended, 2}, {"lists", lists, 5}, {"places", places, 8},
    {"many lists", many_lists, 5}, {"many moves", many_moves, 8}, {"many come into a list", many_appended, 8},
    {"points of what was edited", points_of_edited, 5}, {"nested lists", nested_lists, 8}, {"ever smaller", ever_smaller, 8},
    {"all attributes", all_attributes, 8}, {"with views", with_views, 8}
};

typedef struct one_call { world *w; uint32_t which; } one_call;

static int run_call(void *user, test_alloc *ta, unsigned threads) {
    const one_call *c = (const one_call *)user;
    zbufrand_env env;
    memset(&env, 0, sizeof env);
    env.allocator.alloc_fn = test_alloc_fn;
    env.allocator.free_fn = test_free_fn;
    env.allocator.user = ta;
    env.thread_count = threads;
    return (int)call[c->which].run(c->w, &env);
}

TEST(every_request_refused) {
    static world w;
    one_call c;
    memset(&w, 0, sizeof w);
    shape_sphere(&w.s, 0, 0, 0, 1, 12);
    REQUIRE(w.s.vertices * 3 <= sizeof w.rgb);
    w.mesh = w.coloured = mesh_of(&w.s);
    w.coloured.normals = w.s.normal;
    w.coloured.vertex_rgb = w.rgb;
    c.w = &w;
    for (c.which = 0; c.which < sizeof call / sizeof call[0]; c.which++)
        test_refuse_requests(call[c.which].name, run_call, &c, 1, (int)ZBUFRAND_ERR_NO_MEMORY, call[c.which].least, 0);
    shape_free(&w.s);
}

TEST(names) {
    int i, k;
#define NAME(id, value, text) CHECK(strcmp(zbufrand_result_string((zbufrand_result)value), text) == 0);
    ZBUFRAND_RESULT_LIST(NAME)
#undef NAME
    CHECK(strcmp(zbufrand_result_string((zbufrand_result)1234), "unknown result") == 0);
    for (i = 0; i <= ZBUFRAND_ISA_AVX512; i++)
        for (k = 0; k < i; k++) CHECK(strcmp(zbufrand_isa_name((zbufrand_isa)i), zbufrand_isa_name((zbufrand_isa)k)) != 0);
    CHECK(strcmp(zbufrand_isa_name((zbufrand_isa)99), "unknown") == 0);
    CHECK_EQ_U64(zbufrand_version(), ZBUFRAND_VERSION);
    CHECK(zbufrand_isa_best() <= ZBUFRAND_ISA_AVX512 && zbufrand_isa_best() >= ZBUFRAND_ISA_SCALAR);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(lights);
    RUN(every_request_refused);
    RUN(names);
    return test_end();
}
