/* The scene graph: what is allowed, what errors say, what it is cut into, counts beyond 32 bits, bad triangles, memory. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "zbufrand_shapes.h"

static zbufrand_error g_scene_error;

static zbufrand_scene *scene_open_scene(void) {
    zbufrand_scene_desc d;
    zbufrand_scene *s = NULL;
    memset(&d, 0, sizeof d);
    d.env.error = &g_scene_error;
    d.env.thread_count = 1;
    CHECK_EQ_U64(zbufrand_scene_create(&d, &s), ZBUFRAND_OK);
    if (s == NULL) abort();
    return s;
}

TEST(what_is_in_no_scene) {
    zbufrand_scene *s = scene_open_scene();
    shape box;
    zbufrand_mesh m;
    zbufrand_node n = 77;
    zbufrand_transform t = move_scale(0, 0, 0, 1);
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 1, 1, 1);
    m = mesh_of(&box);
    CHECK_EQ_U64(zbufrand_add_list(s, 99, NULL, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(n, 0);
    CHECK_EQ_U64(g_scene_error.where, 99);
    CHECK_EQ_U64(zbufrand_add_mesh(s, 0, NULL, 0, NULL, &n), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 8, &m, &n), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_add_reference(s, 1, NULL, 12345, &n), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_add_reference(s, 1, NULL, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    m.position_stride = 11;
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m, &n), ZBUFRAND_ERR_INVALID_ARG);
    m = mesh_of(&box);
    m.indices = NULL; /* 8 vertices do not make 12 triangles */
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m, &n), ZBUFRAND_ERR_INVALID_ARG);
    m = mesh_of(&box);
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m, &n), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, n, NULL, 0, NULL), ZBUFRAND_ERR_INVALID_ARG); /* a mesh is no list */
    /* no similarities */
    t.m[0][0] = 2;
    CHECK_EQ_U64(zbufrand_add_list(s, 1, &t, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    t = move_scale(0, 0, 0, 0);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, &t, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    t = move_scale((double)NAN, 0, 0, 1);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, &t, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    t = move_scale((double)INFINITY, 0, 0, 1);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, &t, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    t = move_scale(0, 0, 0, 1);
    t.m[0][1] = 0.1; /* a shear */
    CHECK_EQ_U64(zbufrand_add_list(s, 1, &t, 0, &n), ZBUFRAND_ERR_INVALID_ARG);
    t = move_scale(1, 2, 3, -2); /* a mirror is one */
    CHECK_EQ_U64(zbufrand_add_list(s, 1, &t, 0, &n), ZBUFRAND_OK);
    zbufrand_scene_destroy(s);
    shape_free(&box);
}

TEST(lists) {
    zbufrand_scene *s = scene_open_scene();
    zbufrand_node a, b, loose, r;
    zbufrand_scene_info info;
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, 0, &a), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, a, NULL, 0, &b), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_list_append(s, 1, b), ZBUFRAND_ERR_INVALID_ARG); /* already in one */
    CHECK_EQ_U64(g_scene_error.where, b);
    CHECK(strstr(g_scene_error.text, "already") != NULL);
    CHECK_EQ_U64(zbufrand_list_append(s, b, ZBUFRAND_ROOT), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_list_append(s, 4711, b), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_list_append(s, b, 4711), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_add_list(s, 0, NULL, 0, &loose), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_reference(s, 1, NULL, loose, &r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_ERR_INVALID_ARG); /* its target is in no list */
    CHECK_EQ_U64(g_scene_error.where, r);
    CHECK_EQ_U64(zbufrand_list_append(s, 1, loose), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK); /* nothing in it, but fine */
    CHECK_EQ_U64(info.triangles, 0);
    CHECK(info.box_min[0] > info.box_max[0]);
    zbufrand_scene_destroy(s);
}

TEST(cycles) {
    zbufrand_scene *s = scene_open_scene();
    zbufrand_node a, b, c, r;
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, 0, &a), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, a, NULL, 0, &b), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, b, NULL, 0, &c), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_reference(s, c, NULL, a, &r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(g_scene_error.where, r);
    CHECK(strstr(g_scene_error.text, "cycle") != NULL);
    zbufrand_scene_destroy(s);
    s = scene_open_scene(); /* a list that is put into itself by a detour */
    CHECK_EQ_U64(zbufrand_add_list(s, 0, NULL, 0, &a), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, a, NULL, 0, &b), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_list_append(s, b, a), ZBUFRAND_OK); /* seen when it is walked, and nobody walks it */
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_reference(s, 1, NULL, b, &r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    zbufrand_scene_destroy(s);
    s = scene_open_scene(); /* a reference to itself, to the root */
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, 0, &a), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_reference(s, a, NULL, ZBUFRAND_ROOT, &r), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    zbufrand_scene_destroy(s);
}

TEST(deep_lists_and_levels) {
    zbufrand_scene *s = scene_open_scene();
    shape box;
    zbufrand_mesh m;
    zbufrand_node at = 1, next, lib, node;
    zbufrand_scene_info info;
    uint32_t i, levels;
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 1, 1, 1);
    m = mesh_of(&box);
    for (i = 0; i < 100000; i++) { /* no recursion anywhere */
        if (zbufrand_add_list(s, at, NULL, 0, &next) != ZBUFRAND_OK) break;
        at = next;
    }
    CHECK_EQ_U64(zbufrand_add_mesh(s, at, NULL, 0, &m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 12);
    CHECK_EQ_U64(info.structures, 1);
    zbufrand_scene_destroy(s);
    for (levels = 63; levels <= 66; levels++) { /* 64 levels are allowed; two copies each would be 2^64 */
        s = scene_open_scene();
        CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, lib, NULL, 0, &m, &node), ZBUFRAND_OK);
        for (i = 0; i < levels; i++) {
            zbufrand_node list;
            CHECK_EQ_U64(zbufrand_add_list(s, i + 1 == levels ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_add_reference(s, list, NULL, node, NULL), ZBUFRAND_OK);
            node = list;
        }
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), levels <= 64 ? ZBUFRAND_OK : ZBUFRAND_ERR_RANGE);
        if (levels <= 64) CHECK_EQ_U64(info.levels, levels);
        zbufrand_scene_destroy(s);
    }
    shape_free(&box);
}

/* n^levels copies. */
static zbufrand_result build_tower(zbufrand_scene *s, const zbufrand_mesh *m, uint32_t levels, uint32_t n, zbufrand_scene_info *info) {
    zbufrand_node lib, node, list;
    uint32_t l, i;
    double size = 2;
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, lib, NULL, 0, m, &node), ZBUFRAND_OK);
    for (l = 0; l < levels; l++) {
        CHECK_EQ_U64(zbufrand_add_list(s, l + 1 == levels ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
        for (i = 0; i < n; i++) {
            zbufrand_transform t = move_scale(size * i, 0, 0, 1);
            CHECK_EQ_U64(zbufrand_add_reference(s, list, &t, node, NULL), ZBUFRAND_OK);
        }
        size *= n;
        node = list;
    }
    return zbufrand_scene_build(s, NULL, info);
}

TEST(counts_beyond_32_bits) {
    zbufrand_scene *s = scene_open_scene();
    shape box;
    zbufrand_mesh m;
    zbufrand_scene_info info;
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 1, 1, 1);
    m = mesh_of(&box);
    CHECK_EQ_U64(build_tower(s, &m, 6, 100, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 12000000000000u);
    CHECK_EQ_U64(info.stored_triangles, 12);
    CHECK_EQ_U64(info.instances, 600);
    CHECK_NEAR(info.area / 6e12, 1.0, 1e-5);
    CHECK_NEAR(info.box_max[0] / (2e12 - 1), 1.0, 1e-6);
    CHECK_EQ_U64(info.structures, 7);
    zbufrand_scene_destroy(s);
    s = scene_open_scene();
    CHECK_EQ_U64(build_tower(s, &m, 10, 100, &info), ZBUFRAND_ERR_RANGE); /* 1.2e21 */
    CHECK_EQ_U64(info.triangles, 0);
    zbufrand_scene_destroy(s);
    shape_free(&box);
}

/* What no test can store: a structure that is nearly full gets one mesh more. */
TEST(full_structures) {
    uint32_t full;
    shape box;
    zbufrand_mesh m;
    memset(&box, 0, sizeof box);
    shape_box(&box, 0, 0, 0, 1, 1, 1);
    m = mesh_of(&box);
    for (full = 0; full < 2; full++) {
        zbufrand_scene *s = scene_open_scene();
        zbufrandi_structure to;
        zbufrandi_piece piece;
        zbufrandi_build b;
        zbufrand_build_desc d;
        zbufrand_node node;
        CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, 0, &m, &node), ZBUFRAND_OK);
        memset(&to, 0, sizeof to);
        memset(&piece, 0, sizeof piece);
        memset(&b, 0, sizeof b);
        memset(&d, 0, sizeof d);
        zbufrandi_m34_identity(piece.m);
        s->mem.limit = 1 << 20; /* room for the box, not for what is said to be there */
        b.scene = s;
        b.desc = &d;
        b.s = &to;
        if (full == 0) to.triangle_count = 0xffffffffu - 11;
        else to.vertex_count = 0xffffffffu - 7;
        CHECK_EQ_U64(zbufrandi_build_piece(&b, &piece), ZBUFRAND_ERR_RANGE);
        CHECK_EQ_U64(g_scene_error.where, node);
        CHECK(strstr(g_scene_error.text, "2^32") != NULL);
        if (full == 0) to.triangle_count--;
        else to.vertex_count--;
        CHECK_EQ_U64(zbufrandi_build_piece(&b, &piece), ZBUFRAND_ERR_NO_MEMORY); /* it would fit */
        zbufrandi_structure_free(&s->mem, &to);
        zbufrand_scene_destroy(s);
    }
    shape_free(&box);
}

TEST(what_is_drawn) {
    zbufrand_scene *s = scene_open_scene();
    shape box;
    zbufrand_mesh m;
    zbufrand_node mesh, hidden, list;
    zbufrand_scene_info info;
    zbufrand_transform t[3];
    memset(&box, 0, sizeof box);
    shape_box(&box, -1, -1, -1, 1, 1, 1);
    m = mesh_of(&box);
    t[0] = move_scale(10, 0, 0, 1);
    t[1] = move_scale(0, 10, 0, 2);
    t[2] = move_scale(0, 0, 10, -3);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, &t[0], ZBUFRAND_HIDDEN, &hidden), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, hidden, &t[1], 0, &m, &mesh), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 0); /* hidden where it stands */
    CHECK_EQ_U64(zbufrand_add_reference(s, 1, &t[2], mesh, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 12);
    CHECK_NEAR(info.box_min[2], 7, 1e-5); /* the reference's transform takes the place of the target's and its list's */
    CHECK_NEAR(info.box_max[2], 13, 1e-5);
    CHECK_NEAR(info.box_max[1], 3, 1e-5);
    CHECK_NEAR(info.area, 9 * 24, 1e-4 * 9 * 24);
    CHECK_EQ_U64(zbufrand_add_references(s, 1, t, 3, mesh, &list), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 48);
    CHECK_EQ_U64(info.instances, 4);
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, &t[0], ZBUFRAND_OWN_STRUCTURE, &m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 72);
    CHECK_EQ_U64(info.instances, 5);
    CHECK_EQ_U64(info.structures, 3);
    zbufrand_scene_destroy(s);
    shape_free(&box);
}

/* References in one node are the same as one by one: the same bytes. */
static uint64_t scene_hash_structure(const zbufrandi_structure *s) {
    uint64_t h = test_fnv1a(s->origin, sizeof s->origin, 0);
    h = test_fnv1a(s->position, 12 * (size_t)s->vertex_count, h);
    h = test_fnv1a(s->triangle, 3 * (size_t)s->triangle_count, h);
    h = test_fnv1a(s->cluster, s->cluster_count * sizeof *s->cluster, h);
    h = test_fnv1a(s->node, s->node_count * sizeof *s->node, h);
    h = test_fnv1a(s->set, ((size_t)s->cluster_count + s->node_count) * 512, h);
    if (s->set_rgb != NULL) h = test_fnv1a(s->set_rgb, ((size_t)s->cluster_count + s->node_count) * 256, h);
    return h;
}

TEST(references_at_once) {
    zbufrand_transform t[40];
    test_rng r = test_rng_make(5);
    zbufrand_node mesh, lib;
    shape ball;
    zbufrand_mesh m;
    uint64_t hash[2] = {0, 0};
    uint32_t i, k;
    memset(&ball, 0, sizeof ball);
    shape_sphere(&ball, 0, 0, 0, 1, 12);
    m = mesh_of(&ball);
    for (i = 0; i < 40; i++) {
        double q[9];
        uint32_t a, b;
        shape_rotation(test_rng_double(&r), test_rng_double(&r), test_rng_double(&r), q);
        for (a = 0; a < 3; a++) {
            for (b = 0; b < 3; b++) t[i].m[a][b] = q[3 * a + b] * (i % 3 == 0 ? -0.5 : 1.5);
            t[i].m[a][3] = 20 * test_rng_double(&r);
        }
    }
    for (k = 0; k < 2; k++) {
        zbufrand_scene *s = scene_open_scene();
        CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, lib, NULL, 0, &m, &mesh), ZBUFRAND_OK);
        if (k == 0) CHECK_EQ_U64(zbufrand_add_references(s, 1, t, 40, mesh, NULL), ZBUFRAND_OK);
        for (i = 0; i < 40 && k == 1; i++) CHECK_EQ_U64(zbufrand_add_reference(s, 1, &t[i], mesh, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        hash[k] = scene_hash_structure(&s->structure[0]);
        zbufrand_scene_destroy(s);
    }
    CHECK_EQ_U64(hash[0], hash[1]);
    shape_free(&ball);
}

/* Four levels of instances, 10^6 away from the origin: what comes out is where it belongs, and as precise as at home. */
TEST(far_away) {
    zbufrand_scene *s = scene_open_scene();
    shape ball;
    zbufrand_mesh m;
    zbufrand_node lib, node, list;
    zbufrand_scene_info info;
    uint32_t l, a;
    memset(&ball, 0, sizeof ball);
    shape_sphere(&ball, 0, 0, 0, 0.01, 12);
    m = mesh_of(&ball);
    CHECK_EQ_U64(zbufrand_add_list(s, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, lib, NULL, 0, &m, &node), ZBUFRAND_OK);
    for (l = 0; l < 4; l++) {
        zbufrand_transform t = move_scale(1e6, -2e6, 3e6, 1);
        CHECK_EQ_U64(zbufrand_add_list(s, l == 3 ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_reference(s, list, &t, node, NULL), ZBUFRAND_OK);
        node = list;
    }
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    for (a = 0; a < 3; a++) {
        double c = a == 0 ? 4e6 : a == 1 ? -8e6 : 12e6;
        CHECK_NEAR(info.box_min[a], c - 0.01, 1e-6);
        CHECK_NEAR(info.box_max[a], c + 0.01, 1e-6);
    }
    zbufrand_scene_destroy(s);
    shape_free(&ball);
}

/* Each transform is a similarity as far as is asked for; what lists in lists amount to is less of one. */
TEST(nearly_similar) {
    shape box;
    zbufrand_mesh m;
    zbufrand_transform t = move_scale(0, 0, 0, 1), back = t, tiny = move_scale(0, 0, 0, 1e-100), away = move_scale(3e15, 0, 0, 1);
    zbufrand_scene_info info;
    zbufrand_node list, inner, lib, model, node;
    uint32_t kind;
    memset(&box, 0, sizeof box);
    shape_box(&box, -1, -1, -1, 1, 1, 1);
    m = mesh_of(&box);
    t.m[0][1] = 0.9e-5;
    back.m[0][1] = -0.9e-5;
    for (kind = 0; kind < 3; kind++) { /* a structure of its own, a reference, several */
        zbufrand_scene *s = scene_open_scene();
        CHECK_EQ_U64(zbufrand_add_list(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, lib, NULL, 0, &m, &model), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, 0, &m, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(s, ZBUFRAND_ROOT, &t, 0, &list), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(s, list, &t, 0, &inner), ZBUFRAND_OK);
        if (kind == 0) CHECK_EQ_U64(zbufrand_add_mesh(s, inner, &t, ZBUFRAND_OWN_STRUCTURE, &m, &node), ZBUFRAND_OK);
        if (kind == 1) CHECK_EQ_U64(zbufrand_add_reference(s, inner, &t, model, &node), ZBUFRAND_OK);
        if (kind == 2) CHECK_EQ_U64(zbufrand_add_references(s, inner, &t, 1, model, &node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
        CHECK_NEAR(info.area, 48, 1e-3);
        CHECK(info.box_max[0] > 1.00002 && info.box_max[0] < 1.0001);
        CHECK_EQ_U64(zbufrand_move(s, inner, &back), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
        CHECK_NEAR(info.area, 48, 1e-3);
        /* the same among what is new */
        CHECK_EQ_U64(zbufrand_add_list(s, ZBUFRAND_ROOT, &t, 0, &list), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(s, list, &t, 0, &inner), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, inner, &t, ZBUFRAND_OWN_STRUCTURE, &m, &node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_update(s, &info), ZBUFRAND_OK);
        CHECK_NEAR(info.area, 72, 1e-3);
        /* too small to have a scale */
        CHECK_EQ_U64(zbufrand_add_list(s, ZBUFRAND_ROOT, NULL, 0, &list), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(s, list, &tiny, 0, &inner), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(s, inner, &tiny, ZBUFRAND_OWN_STRUCTURE, &m, &node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_update(s, NULL), ZBUFRAND_ERR_RANGE);
        zbufrand_scene_get_info(s, &info);
        CHECK_NEAR(info.area, 72, 1e-3);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_ERR_RANGE);
        CHECK_EQ_U64(g_scene_error.where, node);
        CHECK_EQ_U64(zbufrand_remove(s, list), ZBUFRAND_OK);
        /* too far off, as more than half of the probes are in the middle */
        CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, &away, ZBUFRAND_OWN_STRUCTURE, &m, &node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_ERR_RANGE);
        CHECK_EQ_U64(g_scene_error.where, node);
        CHECK(strstr(g_scene_error.text, "1e15") != NULL);
        CHECK_EQ_U64(zbufrand_remove(s, node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
        CHECK_NEAR(info.area, 72, 1e-3);
        zbufrand_scene_destroy(s);
    }
    shape_free(&box);
}

TEST(bad_triangles) {
    static const float p[][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {NAN, 0, 0}, {INFINITY, 1, 1}, {2, 0, 0}, {1e30f, 0, 0}};
    static const uint32_t t[][3] = {{0, 1, 2}, {0, 1, 4}, {0, 1, 5}, {0, 1, 6}, {0, 0, 1}, {0, 1, 99}, {0, 2, 3}, {0, 1, 7}, {3, 3, 3}};
    zbufrand_scene *s = scene_open_scene();
    zbufrand_mesh m;
    zbufrand_scene_info info;
    zbufrand_build_desc d;
    memset(&m, 0, sizeof m);
    m.positions = p[0];
    m.vertex_count = 8;
    m.indices = t[0];
    m.triangle_count = 9;
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    CHECK_EQ_U64(info.triangles, 2);
    CHECK_EQ_U64(info.skipped_triangles, 7);
    CHECK_NEAR(info.area, 1.0, 1e-6);
    memset(&d, 0, sizeof d);
    d.strict = 1;
    CHECK_EQ_U64(zbufrand_scene_build(s, &d, &info), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(g_scene_error.where, 1);
    CHECK(strstr(g_scene_error.text, "triangle 1 of mesh 2: degenerate") == g_scene_error.text);
    CHECK_EQ_U64(info.triangles, 0);
    zbufrand_scene_get_info(s, &info);
    CHECK_EQ_U64(info.triangles, 0);
    d._end_zero = 1;
    CHECK_EQ_U64(zbufrand_scene_build(s, &d, &info), ZBUFRAND_ERR_UNINIT_DESC);
    zbufrand_scene_destroy(s);
}

/* The same graph, with every allocation failing once; nothing leaks, and the scene can be built afterwards. */
TEST(out_of_memory) {
    shape ball;
    int64_t k, last = test_quick() ? 40 : 400;
    memset(&ball, 0, sizeof ball);
    shape_sphere(&ball, 0, 0, 0, 1, 10);
    for (k = 0; k < last; k++) {
        test_alloc ta;
        zbufrand_scene_desc d;
        zbufrand_scene *s = NULL;
        zbufrand_node lib, mesh;
        zbufrand_mesh m = mesh_of(&ball);
        zbufrand_transform t = move_scale(1, 0, 0, 1);
        zbufrand_result r;
        test_alloc_init(&ta);
        ta.fail_at = k;
        memset(&d, 0, sizeof d);
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        d.env.thread_count = 1;
        r = zbufrand_scene_create(&d, &s);
        if (r == ZBUFRAND_OK) {
            lib = mesh = 0;
            r = zbufrand_add_list(s, 1, NULL, ZBUFRAND_HIDDEN, &lib);
            if (r == ZBUFRAND_OK) r = zbufrand_add_mesh(s, lib, NULL, 0, &m, &mesh);
            if (r == ZBUFRAND_OK) r = zbufrand_add_reference(s, 1, &t, mesh, NULL);
            if (r == ZBUFRAND_OK) r = zbufrand_add_mesh(s, 1, NULL, 0, &m, NULL);
            if (r == ZBUFRAND_OK) {
                r = zbufrand_scene_build(s, NULL, NULL);
                if (r != ZBUFRAND_OK) CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
            }
        }
        CHECK(r == ZBUFRAND_OK || r == ZBUFRAND_ERR_NO_MEMORY);
        CHECK((r == ZBUFRAND_OK) == (ta.failed == 0));
        zbufrand_scene_destroy(s);
        test_alloc_check(&ta);
        if (ta.failed == 0) break;
    }
    CHECK(k > 20);
    CHECK_MSG(test_quick() || k < last, "not all allocations were tried");
    shape_free(&ball);
}

static int cancel_at(void *user, uint64_t done, uint64_t total) {
    (void)total;
    return done >= *(uint64_t *)user;
}

/* Arrays that grew from mesh to mesh end as large as one mesh of all of it would have made them. */
TEST(many_meshes_hold_no_more) {
    shape torus;
    zbufrand_mesh m;
    zbufrand_scene_info info;
    double one = 0, bytes;
    uint32_t n, i;
    memset(&torus, 0, sizeof torus);
    shape_torus(&torus, 0, 0, 0, 1, 0.4, 100, 50);
    m = mesh_of(&torus);
    for (n = 1; n <= 5; n++) {
        zbufrand_scene *s = scene_open_scene();
        for (i = 0; i < n; i++) CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, 0, &m, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
        CHECK_EQ_U64(info.stored_triangles, n * m.triangle_count);
        if (n == 1) one = (double)info.bytes;
        CHECK_MSG((double)info.bytes < 1.05 * one * n, "%u meshes hold %g times as much as one", (unsigned)n, (double)info.bytes / one);
        zbufrand_scene_destroy(s);
    }
    for (n = 0; n < 2; n++) { /* and so do instances: 2^12, and some more */
        static zbufrand_transform place[5000];
        const uint32_t count = n == 0 ? 4096 : 5000;
        zbufrand_scene *s = scene_open_scene();
        zbufrand_node node;
        for (i = 0; i < count; i++) place[i] = move_scale(4.0 * (i % 70), 4.0 * (i / 70), 0, 1);
        m.triangle_count = 1;
        CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_references(s, ZBUFRAND_ROOT, place, count, node, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
        bytes = (double)info.bytes - (double)info.tree_nodes * (sizeof(zbufrandi_node8) + 8 * ZBUFRANDI_SET);
        if (n == 0) one = bytes / count;
        CHECK_MSG(bytes < 1.05 * one * count, "%g bytes for each of %u instances", bytes / count, (unsigned)count);
        zbufrand_scene_destroy(s);
    }
    shape_free(&torus);
}

TEST(views_are_limited) { /* what things have for being drawn many times is bounded in all, not only for each */
    enum { THINGS = 500, TIMES = 33 };
    shape torus;
    zbufrand_mesh m;
    zbufrand_scene_info info;
    zbufrand_scene *s;
    zbufrand_transform place[TIMES];
    double plain = 0;
    uint32_t n, i, with = 0;
    if (test_quick()) SKIP("long");
    s = scene_open_scene();
    memset(&torus, 0, sizeof torus);
    shape_torus(&torus, 0, 0, 0, 1, 0.4, 30, 20);
    m = mesh_of(&torus);
    for (n = 0; n < THINGS; n++) {
        zbufrand_node node;
        for (i = 0; i < TIMES; i++) place[i] = move_scale(4.0 * i, 4.0 * n, 0, 1);
        CHECK_EQ_U64(zbufrand_add_mesh(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &m, &node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_references(s, ZBUFRAND_ROOT, place, TIMES, node, NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, &info), ZBUFRAND_OK);
    for (n = 0; n < s->structure_count; n++) {
        plain += 8.0 * ZBUFRANDI_SET * ((double)s->structure[n].cluster_count + s->structure[n].node_count);
        with += s->structure[n].view != NULL;
    }
    CHECK_MSG(with > 300 && with < THINGS, "%u of %u have views", (unsigned)with, (unsigned)THINGS);
    CHECK_MSG((double)info.bytes < 3 * plain + 1.1 * 67108864.0 + 1000.0 * THINGS * TIMES, "%g bytes, points take %g", (double)info.bytes, plain);
    zbufrand_scene_destroy(s);
    shape_free(&torus);
}

TEST(cancelled) {
    zbufrand_scene_desc d;
    zbufrand_scene *s = NULL;
    shape ball;
    zbufrand_mesh m;
    uint64_t at = 0;
    memset(&ball, 0, sizeof ball);
    shape_sphere(&ball, 0, 0, 0, 1, 10);
    m = mesh_of(&ball);
    memset(&d, 0, sizeof d);
    d.env.progress_fn = cancel_at;
    d.env.progress_user = &at;
    CHECK_EQ_U64(zbufrand_scene_create(&d, &s), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_ERR_CANCELLED);
    at = UINT64_MAX;
    CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
    zbufrand_scene_destroy(s);
    shape_free(&ball);
}

TEST(descs) {
    zbufrand_scene_desc d;
    zbufrand_scene *s = NULL;
    memset(&d, 0, sizeof d);
    d._begin_zero = 1;
    CHECK_EQ_U64(zbufrand_scene_create(&d, &s), ZBUFRAND_ERR_UNINIT_DESC);
    CHECK(s == NULL);
    d._begin_zero = 0;
    d.env.allocator.alloc_fn = test_alloc_fn; /* only one of the two */
    CHECK_EQ_U64(zbufrand_scene_create(&d, &s), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_scene_create(NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &s), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(NULL, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    zbufrand_scene_destroy(s);
    zbufrand_scene_destroy(NULL);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(what_is_in_no_scene);
    RUN(lists);
    RUN(cycles);
    RUN(deep_lists_and_levels);
    RUN(counts_beyond_32_bits);
    RUN(full_structures);
    RUN(what_is_drawn);
    RUN(references_at_once);
    RUN(far_away);
    RUN(nearly_similar);
    RUN(bad_triangles);
    RUN(out_of_memory);
    RUN(many_meshes_hold_no_more);
    RUN(views_are_limited);
    RUN(cancelled);
    RUN(descs);
    return test_end();
}
