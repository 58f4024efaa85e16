/* The cut: bounds that are never exceeded, everything covered once, unbiased counts, both forms, the near plane. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "zbufrand_shapes.h"

/* A torus, a two-sided soup, a flat patch with two sides, a box; as instances of many sizes, too. */
static zbufrand_scene *select_mixed_scene(test_rng *r, shape *s) {
    zbufrand_node lib, node[4];
    zbufrand_transform t;
    zbufrand_scene *scene = mixed_meshes(r, s, 60, 1500, 6, &lib, node);
    uint32_t i;
    for (i = 0; i < 60; i++) {
        random_transform(r, pow(10, -1.5 + 2 * test_rng_double(r)), (int)(i % 3 == 0), &t);
        CHECK_EQ_U64(zbufrand_add_reference(scene, 1, &t, node[i & 3], NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    return scene;
}

static void select_random_camera(test_rng *r, zbufrandi_camera *c, double reach) {
    zbufrand_camera k;
    uint32_t a;
    memset(&k, 0, sizeof k);
    for (a = 0; a < 3; a++) {
        k.eye[a] = reach * (2 * test_rng_double(r) - 1);
        k.at[a] = k.eye[a] + 2 * test_rng_double(r) - 1;
    }
    k.fov_y = 20 + 120 * test_rng_double(r);
    k.near_z = 1e-6;
    CHECK_EQ_U64(zbufrandi_camera_open(&k, NULL, 320, 240, 0, c), ZBUFRAND_OK);
}

static void select_open_cut(zbufrandi_cut *cut, const zbufrand_scene *scene) {
    memset(cut, 0, sizeof *cut);
    cut->scene = scene;
    cut->density = 1;
    cut->near_z = (float)cut->camera.near_z;
    cut->far_z = 1e37f;
    cut->level = 1;
}

/* ---- bounds ---- */

typedef struct bound { double factor_max, factor_min, z_min, z_max, f2; const double (*to_camera)[4]; double scale; double worst; uint64_t tried; } bound;

/* Projection factor of a point p with normal n of a structure, in square pixels per world area, against the bounds. */
static void check_point(bound *b, const double p[3], const double n[3], int two_sided) {
    double q[3], m[3], h = 0, prj;
    int a, k;
    for (a = 0; a < 3; a++) {
        q[a] = b->to_camera[a][3];
        m[a] = 0;
        for (k = 0; k < 3; k++) {
            q[a] += b->to_camera[a][k] * p[k];
            m[a] += b->to_camera[a][k] * n[k] / b->scale;
        }
        h -= m[a] * q[a];
    }
    b->tried++;
    CHECK_MSG(q[2] >= b->z_min && q[2] <= b->z_max, "depth %g not in %g..%g", q[2], b->z_min, b->z_max);
    if (two_sided) h = fabs(h);
    if (!(q[2] > 0)) return;
    prj = b->f2 * (h > 0 ? h : 0) / (q[2] * q[2] * q[2]);
    CHECK_MSG(prj <= b->factor_max, "factor %.9g above its bound %.9g", prj, b->factor_max);
    CHECK_MSG(prj >= b->factor_min, "factor %.9g below its bound %.9g", prj, b->factor_min);
}

/* Points of the surface below a child: corners and middles of some triangles, in coordinates of the structure of `m`. */
static void check_below(bound *b, const zbufrand_scene *scene, uint32_t structure, uint32_t child, const double m[3][4], test_rng *r) {
    const zbufrandi_structure *s = &scene->structure[structure];
    uint32_t kind = ZBUFRANDI_CHILD_KIND(child), index = ZBUFRANDI_CHILD_INDEX(child), k, a;
    if (kind == ZBUFRANDI_CHILD_NODE) {
        k = test_rng_below(r, s->node[index].count);
        check_below(b, scene, structure, s->node[index].child[k], m, r);
    } else if (kind == ZBUFRANDI_CHILD_INSTANCE) {
        const zbufrandi_instance *it = &s->instance[index];
        double next[3][4];
        zbufrandi_m34_mul(m, ZBUFRANDI_M34(it->to_parent), next);
        check_below(b, scene, it->structure, ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, 0), ZBUFRANDI_M34(next), r);
    } else {
        const zbufrandi_cluster *c = &s->cluster[index];
        uint32_t t = test_rng_below(r, c->triangle_count);
        const uint8_t *tri = s->triangle + 3 * ((size_t)c->first_triangle + t);
        const float *p[3];
        double n[3], l, q[3], w[3], world[3], scale = cbrt(fabs(zbufrandi_m34_det(m)));
        for (k = 0; k < 3; k++) p[k] = s->position + 3 * ((size_t)c->first_vertex + tri[k]);
        zbufrandi_cross(p[0], p[1], p[2], n);
        l = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (a = 0; a < 3; a++) q[a] = (m[a][0] * n[0] + m[a][1] * n[1] + m[a][2] * n[2]) / (l * scale);
        w[0] = test_rng_double(r);
        w[1] = (1 - w[0]) * test_rng_double(r);
        if (test_rng_below(r, 4) == 0) w[0] = w[1] = 0;
        w[2] = 1 - w[0] - w[1];
        for (a = 0; a < 3; a++) world[a] = w[0] * (double)p[0][a] + w[1] * (double)p[1][a] + w[2] * (double)p[2][a];
        zbufrandi_m34_point(m, world, world);
        check_point(b, world, q, c->flags & ZBUFRANDI_TWO_SIDED);
    }
}

TEST(never_too_few) {
    test_rng r = test_rng_make(77);
    shape s[4];
    zbufrand_scene *scene = select_mixed_scene(&r, s);
    /* TEST_FULL=1: 10^8 points */
    const uint32_t cameras = test_quick() ? 20 : getenv("TEST_FULL") != NULL ? 140000 : 4000;
    uint32_t c, i, k, j;
    uint64_t tried = 0;
    for (c = 0; c < cameras; c++) {
        zbufrandi_cut cut;
        zbufrandi_local local;
        zbufrandi_sides sides;
        uint32_t depth;
        zbufrandi_camera camera;
        double unit[3][4];
        zbufrandi_m34_identity(unit);
        select_random_camera(&r, &camera, c % 3 == 0 ? 0.7 : c % 3 == 1 ? 3 : 100);
        select_open_cut(&cut, scene);
        cut.camera = camera;
        cut.near_z = 1e-6f;
        cut.density_f2 = (float)(camera.focal * camera.focal);
        zbufrandi_local_root(&camera, &scene->structure[0], c, &local);
        for (depth = 0; depth < 2; depth++) {
            const zbufrandi_structure *st = &scene->structure[local.structure];
            zbufrandi_sides_of(&camera, &local, &sides);
            for (i = 0; i < st->node_count; i++) {
                zbufrandi_tested t;
                memset(&t, 0, sizeof t);
                zbufrandi_test_node(&cut, &local, &sides, &st->node[i], &t);
                for (k = 0; k < st->node[i].count; k++) {
                    bound b;
                    const zbufrandi_node8 *n = &st->node[i];
                    uint32_t kind = ZBUFRANDI_CHILD_KIND(n->child[k]), index = ZBUFRANDI_CHILD_INDEX(n->child[k]);
                    b.z_min = (double)t.z_min[k];
                    b.z_max = (double)t.z_max[k];
                    b.f2 = camera.focal * camera.focal;
                    b.scale = (double)local.scale;
                    b.to_camera = ZBUFRANDI_M34(local.to_camera);
                    b.tried = 0;
                    b.factor_max = b.z_min >= 1e-6 && !(t.away >> k & 1) ? b.f2 * (double)t.h[k] / (b.z_min * b.z_min * b.z_min) : t.away >> k & 1 ? 0 : 1e300;
                    b.factor_min = b.z_max > 0 ? b.f2 * (double)t.h_min[k] / (b.z_max * b.z_max * b.z_max) * 0.9999 : 0;
                    for (j = 0; j < 3; j++) check_below(&b, scene, local.structure, n->child[k], ZBUFRANDI_M34(unit), &r);
                    if (kind == ZBUFRANDI_CHILD_INSTANCE) continue;
                    if (kind == ZBUFRANDI_CHILD_NODE) index += st->cluster_count;
                    for (j = 0; j < 4; j++) { /* stored points with their rounded places and normals */
                        const uint32_t *word = st->set + zbufrandi_set_at((size_t)index * 64 + test_rng_below(&r, 64));
                        float lo[3], hi[3], nf[3];
                        double p[3], nd[3];
                        uint32_t a;
                        for (a = 0; a < 3; a++) {
                            lo[a] = n->lo[a][k];
                            hi[a] = n->hi[a][k];
                        }
                        zbufrandi_set_decode(word[0], lo, hi, p);
                        zbufrandi_oct32_decode(word[8], nf);
                        for (a = 0; a < 3; a++) nd[a] = (double)nf[a];
                        b.factor_min = 0;
                        check_point(&b, p, nd, (int)(word[0] >> 31));
                    }
                    tried += b.tried;
                }
            }
            if (depth == 0) { /* then the same in one of the instances, with its local camera */
                zbufrandi_local root = local;
                zbufrandi_local_enter(&cut, &root, 0, test_rng_below(&r, st->instance_count), &local);
            }
        }
    }
    CHECK_MSG(tried > (test_quick() ? 10000u : getenv("TEST_FULL") != NULL ? 100000000u : 1000000u), "only %llu points", (unsigned long long)tried);
    zbufrand_scene_destroy(scene);
    free_shapes(s);
}

/* No direction of a cell, as any point of a structure that is far enough away sees it, shows more of a normal than its weight
   says; the weights are below 1. */
TEST(directions_of_view) {
    test_rng r = test_rng_make(78);
    const uint32_t tries = test_quick() ? 20000 : 2000000;
    uint32_t i, k, a, used[ZBUFRANDI_VIEWS];
    zbufrandi_view view[ZBUFRANDI_VIEWS];
    memset(used, 0, sizeof used);
    for (i = 0; i < ZBUFRANDI_VIEWS; i++) {
        zbufrandi_view_open(i, &view[i]);
        CHECK_EQ_U64(zbufrandi_view_cell(view[i].axis), i);
        CHECK_MSG(view[i].reach < 0.36f, "cell %u reaches %g", i, (double)view[i].reach);
    }
    for (i = 0; i < tries; i++) {
        double v[3][3], length[3] = {0, 0, 0}, d = 0;
        float eye[3], n[3], weight;
        for (k = 0; k < 3; k++) { /* direction, where the point is, normal */
            do {
                for (a = 0, length[k] = 0; a < 3; a++) {
                    v[k][a] = 2 * test_rng_double(&r) - 1;
                    if (test_rng_below(&r, 16) == 0) v[k][a] = 0;
                    length[k] += v[k][a] * v[k][a];
                }
            } while (length[k] > 1 || length[k] < 1e-4);
            for (a = 0; a < 3; a++) v[k][a] /= sqrt(length[k]);
        }
        for (a = 0; a < 3; a++) {
            eye[a] = (float)v[0][a];
            n[a] = (float)v[2][a];
            v[0][a] += v[1][a] / (double)ZBUFRANDI_VIEW_DISTANCE * (i & 1 ? 1.0 : test_rng_double(&r));
        }
        k = zbufrandi_view_cell(eye);
        used[k]++;
        length[0] = sqrt(v[0][0] * v[0][0] + v[0][1] * v[0][1] + v[0][2] * v[0][2]);
        for (a = 0; a < 3; a++) d += v[0][a] / length[0] * v[2][a];
        weight = zbufrandi_view_weight(&view[k], n, 1.0f, (int)(i >> 1 & 1));
        if (i >> 1 & 1) d = fabs(d);
        CHECK_MSG((double)weight >= d * (1 - 2e-6) && weight <= 1.0f, "cell %u: weight %.7g for %.7g", k, (double)weight, d);
    }
    for (i = 0; i < ZBUFRANDI_VIEWS; i++) CHECK(used[i] != 0);
}

TEST(both_forms) {
    test_rng r = test_rng_make(78);
    shape s[4];
    zbufrand_scene *scene = select_mixed_scene(&r, s);
    uint32_t c, i, k;
    if (zbufrandi_cpu_level() < 3 || !ZBUFRANDI_AVX2) {
        zbufrand_scene_destroy(scene);
        free_shapes(s);
        SKIP("no AVX2");
    }
    for (c = 0; c < (test_quick() ? 20u : 300u); c++) {
        zbufrandi_cut cut;
        zbufrandi_local local;
        zbufrandi_sides sides;
        zbufrandi_camera camera;
        select_random_camera(&r, &camera, c % 2 ? 2 : 50);
        select_open_cut(&cut, scene);
        cut.camera = camera;
        cut.near_z = c % 3 ? 1e-6f : 1.0f;
        cut.far_z = c % 5 ? 1e37f : 30.0f;
        cut.density_f2 = (float)(camera.focal * camera.focal);
        zbufrandi_local_root(&camera, &scene->structure[0], c, &local);
        zbufrandi_sides_of(&camera, &local, &sides);
        for (i = 0; i < scene->structure[0].node_count; i++) {
            const zbufrandi_node8 *n = &scene->structure[0].node[i];
            zbufrandi_tested t[2];
            uint32_t used = n->count;
            memset(t, 0, sizeof t);
            cut.level = 1;
            zbufrandi_test_node(&cut, &local, &sides, n, &t[0]);
            cut.level = 3;
            zbufrandi_test_node(&cut, &local, &sides, n, &t[1]);
            CHECK_EQ_U64(t[0].outside, t[1].outside);
            CHECK_EQ_U64(t[0].away, t[1].away);
            for (k = 0; k < used; k++) {
                CHECK(memcmp(&t[0].z_min[k], &t[1].z_min[k], 4) == 0 && memcmp(&t[0].z_max[k], &t[1].z_max[k], 4) == 0);
                CHECK(memcmp(&t[0].h[k], &t[1].h[k], 4) == 0 && memcmp(&t[0].h_min[k], &t[1].h_min[k], 4) == 0);
                CHECK(memcmp(&t[0].expected[k], &t[1].expected[k], 4) == 0);
            }
        }
    }
    zbufrand_scene_destroy(scene);
    free_shapes(s);
}

/* ---- the cut as a list ---- */

/* Mark the triangles of a group of structure 0. */
static void mark(const zbufrandi_structure *s, uint32_t child, uint8_t *seen) {
    uint32_t kind = ZBUFRANDI_CHILD_KIND(child), index = ZBUFRANDI_CHILD_INDEX(child), k;
    if (kind == ZBUFRANDI_CHILD_NODE) {
        for (k = 0; k < s->node[index].count; k++) mark(s, s->node[index].child[k], seen);
    } else {
        for (k = 0; k < s->cluster[index].triangle_count; k++) seen[s->cluster[index].first_triangle + k]++;
    }
}

static int inside_view(const zbufrandi_camera *c, const double p[3]) { /* with nothing to spare */
    double q[3], x, y;
    int a;
    q[0] = q[1] = q[2] = 0;
    for (a = 0; a < 3; a++) {
        double d = p[a] - c->eye[a];
        q[0] += d * c->right[a];
        q[1] += d * c->up[a];
        q[2] += d * c->dir[a];
    }
    if (q[2] < c->near_z * 1.0001) return 0;
    x = c->center_x + c->focal * q[0] / q[2];
    y = c->center_y - c->focal * q[1] / q[2];
    return x > 0 && x < c->width && y > 0 && y < c->height;
}

/* What is narrowed to an instance's own box and ball still holds it: depths, rectangle, and the ball itself; and it is narrower. */
TEST(whole_instances) {
    test_rng r = test_rng_make(97);
    shape s[4];
    zbufrand_scene *scene = select_mixed_scene(&r, s);
    const zbufrandi_structure *st = &scene->structure[0];
    double before = 0, after = 0;
    uint32_t c, n, i, k, a, looked = 0;
    for (i = 1; i < scene->structure_count; i++) { /* all vertices are in the ball */
        const zbufrandi_structure *in = &scene->structure[i];
        for (k = 0; k < in->vertex_count; k++) {
            double d = 0;
            for (a = 0; a < 3; a++) {
                const double e = (double)in->position[3 * k + a] - 0.5 * ((double)in->box_lo[a] + (double)in->box_hi[a]);
                d += e * e;
            }
            CHECK_MSG(sqrt(d) <= (double)in->radius, "structure %u: a vertex at %g, radius %g", i, sqrt(d), (double)in->radius);
        }
    }
    for (c = 0; c < (test_quick() ? 10u : 60u); c++) {
        zbufrandi_cut cut;
        zbufrandi_local root, whole;
        zbufrandi_sides sides;
        select_open_cut(&cut, scene);
        select_random_camera(&r, &cut.camera, 6);
        cut.near_z = (float)cut.camera.near_z;
        cut.focal = (float)cut.camera.focal;
        cut.center_x = (float)cut.camera.center_x;
        cut.center_y = (float)cut.camera.center_y;
        cut.density_f2 = cut.focal * cut.focal;
        zbufrandi_local_root(&cut.camera, st, 1, &root);
        zbufrandi_sides_of(&cut.camera, &root, &sides);
        for (n = 0; n < st->node_count; n++) {
            zbufrandi_tested t, u;
            zbufrandi_test_node(&cut, &root, &sides, &st->node[n], &t);
            for (i = 0; i < st->node[n].count; i++) {
                const uint32_t child = st->node[n].child[i];
                const zbufrandi_structure *in;
                if (ZBUFRANDI_CHILD_KIND(child) != ZBUFRANDI_CHILD_INSTANCE || !(t.expected[i] < INFINITY) || (t.outside >> i & 1)) continue;
                zbufrandi_local_enter(&cut, &root, 0, ZBUFRANDI_CHILD_INDEX(child), &whole);
                in = &scene->structure[whole.structure];
                u = t;
                a = (uint32_t)zbufrandi_narrow(&cut, &whole, &u, i);
                for (k = 0; k < in->vertex_count; k++) {
                    double q[3], x, y;
                    uint32_t b;
                    for (b = 0; b < 3; b++)
                        q[b] = whole.to_camera[b][0] * (double)in->position[3 * k] + whole.to_camera[b][1] * (double)in->position[3 * k + 1] +
                               whole.to_camera[b][2] * (double)in->position[3 * k + 2] + whole.to_camera[b][3];
                    x = cut.camera.center_x + cut.camera.focal * q[0] / q[2];
                    y = cut.camera.center_y - cut.camera.focal * q[1] / q[2];
                    if (!a) CHECK(x < 0 || y < 0 || x > 320 || y > 240);
                    else CHECK_MSG(q[2] >= (double)u.z_min[i] && q[2] <= (double)u.z_max[i] && x >= (double)u.x0[i] && x <= (double)u.x1[i] &&
                                   y >= (double)u.y0[i] && y <= (double)u.y1[i], "camera %u, instance %u: a vertex is outside", c, child);
                }
                if (!a) continue;
                CHECK(u.z_min[i] >= t.z_min[i] && u.x0[i] >= t.x0[i] && u.x1[i] <= t.x1[i]);
                before += log((double)((t.x1[i] - t.x0[i]) * (t.y1[i] - t.y0[i])));
                after += log((double)((u.x1[i] - u.x0[i]) * (u.y1[i] - u.y0[i])));
                looked++;
            }
        }
    }
    CHECK(looked > 50);
    CHECK_MSG(exp((after - before) / looked) < 0.95, "rectangles are %g times as large", exp((after - before) / looked));
    zbufrand_scene_destroy(scene);
    free_shapes(s);
}

TEST(covers_everything_once) {
    test_rng r = test_rng_make(79);
    const zbufrand_hybrid modes[4] = {ZBUFRAND_HYBRID_AUTO, ZBUFRAND_HYBRID_OFF, ZBUFRAND_HYBRID_ALL, ZBUFRAND_HYBRID_CUBE};
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene = NULL;
    zbufrand_frame *frame = NULL;
    uint8_t *seen;
    zbufrand_group *g;
    uint32_t c, i, k, a, visible = 0;
    memset(&s, 0, sizeof s);
    shape_torus(&s, 0, 0, 0, 1, 0.4, 120, 80);
    soup(&s, &r, 2000, 0.3, 0.5);
    m = mesh_of(&s);
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    seen = (uint8_t *)malloc(s.triangles);
    g = (zbufrand_group *)malloc(20000 * sizeof *g);
    REQUIRE(seen != NULL && g != NULL);
    for (c = 0; c < (test_quick() ? 12u : 120u); c++) {
        const zbufrandi_structure *st = &scene->structure[0];
        zbufrand_render_desc d;
        zbufrandi_camera camera;
        size_t count;
        uint32_t stored = 0, rastered = 0, sampled = 0;
        memset(&d, 0, sizeof d);
        for (a = 0; a < 3; a++) {
            double reach = c % 3 == 0 ? 0.8 : c % 3 == 1 ? 3 : 60;
            d.camera.eye[a] = reach * (2 * test_rng_double(&r) - 1);
            d.camera.at[a] = c % 2 ? 0 : d.camera.eye[a] + test_rng_double(&r) - 0.5;
        }
        d.camera.near_z = c % 4 == 0 ? 1e-6 : 0;
        d.density = pow(10, -1 + 2.5 * test_rng_double(&r));
        d.hybrid = modes[c & 3];
        d.hybrid_radius = 0.5;
        CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, 320, 240, 0, &camera), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_select(frame, &d, scene, 320, 240, g, 20000, &count, NULL), ZBUFRAND_OK);
        REQUIRE(count <= 20000);
        memset(seen, 0, s.triangles);
        for (i = 0; i < count; i++) {
            mark(st, g[i].child, seen);
            stored += g[i].kind == ZBUFRAND_DRAW_STORED;
            sampled += g[i].kind == ZBUFRAND_DRAW_SAMPLED;
            rastered += g[i].kind == ZBUFRAND_DRAW_RASTERED;
            CHECK(g[i].factor_max >= g[i].factor_min && g[i].z_max >= g[i].z_min && g[i].area > 0);
            if (g[i].kind == ZBUFRAND_DRAW_STORED) CHECK(g[i].z_min >= camera.near_z * 0.999 && g[i].expected < 64.1 && g[i].count <= 64);
            if (g[i].z_min < camera.near_z * 0.999) CHECK(g[i].kind == ZBUFRAND_DRAW_RASTERED); /* never lost, never sampled */
        }
        CHECK_EQ_U64(stored + sampled + rastered, count);
        if (d.hybrid == ZBUFRAND_HYBRID_ALL) CHECK_EQ_U64(stored + sampled, 0);
        for (i = 0; i < st->cluster_count; i++) {
            const zbufrandi_cluster *cl = &st->cluster[i];
            for (k = 0; k < cl->triangle_count; k++) {
                uint32_t t = cl->first_triangle + k;
                const uint8_t *tri = st->triangle + 3 * (size_t)t;
                const float *p[3];
                double n[3], h = 0, mid[3];
                uint32_t in = 0, q;
                CHECK_MSG(seen[t] <= 1, "triangle %u is drawn %u times", t, seen[t]);
                if (seen[t] != 0) continue;
                for (q = 0; q < 3; q++) p[q] = st->position + 3 * ((size_t)cl->first_vertex + tri[q]);
                zbufrandi_cross(p[0], p[1], p[2], n);
                for (a = 0; a < 3; a++) h -= n[a] * ((double)p[0][a] + st->origin[a] - camera.eye[a]);
                if (!(h > 1e-9)) continue; /* faces away: may be left out */
                for (q = 0; q < 4; q++) {
                    for (a = 0; a < 3; a++) {
                        mid[a] = (q < 3 ? (double)p[q][a] : ((double)p[0][a] + (double)p[1][a] + (double)p[2][a]) / 3) + st->origin[a];
                    }
                    in |= (uint32_t)inside_view(&camera, mid);
                }
                CHECK_MSG(!in, "camera %u: a triangle that is seen is not in the cut", c);
                visible += in;
            }
        }
    }
    CHECK_EQ_U64(visible, 0);
    free(seen);
    free(g);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* Sums of counts over many seeds against the sum of what is expected. */
TEST(unbiased_counts) {
    test_rng r = test_rng_make(80);
    const uint32_t seeds = test_quick() ? 50 : 2000;
    shape s[4];
    zbufrand_scene *scene = select_mixed_scene(&r, s);
    zbufrand_frame *frame = NULL;
    zbufrand_group *g = (zbufrand_group *)malloc(40000 * sizeof *g);
    zbufrand_render_desc d;
    double sum = 0, sum2 = 0, expected = 0, mean;
    uint32_t seed, i;
    size_t count;
    REQUIRE(g != NULL);
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    memset(&d, 0, sizeof d);
    d.camera.eye[2] = 60;
    d.camera.at[0] = 0.1;
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    d.density = 0.3;
    for (seed = 0; seed < seeds; seed++) {
        double n = 0, e = 0;
        d.seed = seed;
        CHECK_EQ_U64(zbufrand_select(frame, &d, scene, 320, 240, g, 40000, &count, NULL), ZBUFRAND_OK);
        REQUIRE(count <= 40000);
        for (i = 0; i < count; i++) {
            if (g[i].kind != ZBUFRAND_DRAW_STORED) continue;
            n += g[i].count;
            e += g[i].expected;
            CHECK(fabs((double)g[i].count - g[i].expected) <= 1.001);
        }
        sum += n;
        sum2 += n * n;
        expected = e;
    }
    mean = sum / seeds;
    CHECK(expected > 30);
    CHECK_MSG(fabs(mean - expected) < 4.5 * sqrt(fmax(sum2 / seeds - mean * mean, 1e-9) / seeds) + 1e-4 * expected, "mean %g, expected %g", mean, expected);
    free(g);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    free_shapes(s);
}

/* Opening a tree costs logarithmic time: a disc seen from its middle, ever larger. */
TEST(visits_grow_slowly) {
    zbufrand_frame *frame = NULL;
    uint64_t nodes[4] = {0, 0, 0, 0};
    uint32_t k, i, j;
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    for (k = 0; k < 4; k++) { /* 16^k tiles a side, nested */
        zbufrand_scene *scene = NULL;
        shape s;
        zbufrand_mesh m;
        zbufrand_node lib, node, list;
        zbufrand_render_desc d;
        zbufrand_stats st;
        size_t count;
        uint32_t l;
        double size = 2;
        memset(&s, 0, sizeof s);
        shape_sphere(&s, 0, 0, 0, 1, 12);
        m = mesh_of(&s);
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &node), ZBUFRAND_OK);
        for (l = 0; l <= k; l++) {
            CHECK_EQ_U64(zbufrand_add_list(scene, l == k ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
            for (i = 0; i < 16; i++) {
                for (j = 0; j < 16; j++) {
                    zbufrand_transform t;
                    memset(&t, 0, sizeof t);
                    t.m[0][0] = t.m[1][1] = t.m[2][2] = 1;
                    t.m[0][3] = size * (i - 7.5);
                    t.m[2][3] = size * (j - 7.5);
                    CHECK_EQ_U64(zbufrand_add_reference(scene, list, &t, node, NULL), ZBUFRAND_OK);
                }
            }
            size *= 16;
            node = list;
        }
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
        memset(&d, 0, sizeof d);
        d.camera.eye[1] = 3;
        d.camera.at[1] = 2.7;
        d.camera.at[2] = -1;
        d.density = 2;
        CHECK_EQ_U64(zbufrand_select(frame, &d, scene, 320, 240, NULL, 0, &count, &st), ZBUFRAND_OK);
        nodes[k] = st.nodes;
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
    CHECK_MSG((double)(nodes[3] - nodes[2]) < 1.3 * (double)(nodes[2] - nodes[1]), "%llu %llu %llu %llu nodes", (unsigned long long)nodes[0],
              (unsigned long long)nodes[1],
              (unsigned long long)nodes[2], (unsigned long long)nodes[3]);
    zbufrand_frame_destroy(frame);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(never_too_few);
    RUN(directions_of_view);
    RUN(both_forms);
    RUN(whole_instances);
    RUN(covers_everything_once);
    RUN(unbiased_counts);
    RUN(visits_grow_slowly);
    return test_end();
}
