/* Geometry in other places and groups of it: what is cut into pieces, moved and put together again looks like the whole,
   bit by bit where the numbers allow it, and a group gives what a loop over all of its members gives. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"

enum { RUN = 64 };

static voxrt_tree *scene_tree_of(const voxrt_voxel *v, size_t n, uint32_t depth, int normals) {
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    memset(&d, 0, sizeof d);
    d.disable_normals = !normals;
    CHECK(voxrt_tree_from_voxels(&d, v, n, depth, &t) == VOXRT_OK);
    return t;
}

static voxrt_voxel voxel_at(uint32_t x, uint32_t y, uint32_t z, uint32_t color) {
    voxrt_voxel v;
    memset(&v, 0, sizeof v);
    v.x = x;
    v.y = y;
    v.z = z;
    v.rgb[0] = (uint8_t)(color * 40);
    v.rgb[1] = (uint8_t)(255 - color * 17);
    v.rgb[2] = (uint8_t)(color * 91);
    return v;
}

static voxrt_voxel any_voxel(test_rng *r, uint32_t side) { /* one number after the other: arguments have no order */
    const uint32_t x = test_rng_below(r, side), y = test_rng_below(r, side), z = test_rng_below(r, side);
    return voxel_at(x, y, z, 0);
}

/* A shell of voxels around the middle of a grid, with the normals of a sphere. */
static voxrt_tree *scene_ball(uint32_t depth) {
    const uint32_t n = 1u << depth;
    voxrt_voxel *v = (voxrt_voxel *)malloc(sizeof *v * n * n * n);
    voxrt_tree *t;
    size_t count = 0;
    uint32_t x, y, z;
    if (v == NULL) exit(1);
    for (z = 0; z < n; z++)
        for (y = 0; y < n; y++)
            for (x = 0; x < n; x++) {
                const double p[3] = {x + 0.5 - n / 2.0, y + 0.5 - n / 2.0, z + 0.5 - n / 2.0};
                const double r = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), want = 0.42 * n;
                int a;
                if (fabs(r - want) > 0.87) continue;
                v[count] = voxel_at(x, y, z, (x ^ y ^ z) & 7u);
                v[count].has_normal = 1;
                for (a = 0; a < 3; a++) v[count].normal[a] = (float)(p[a] / r);
                count++;
            }
    t = scene_tree_of(v, count, depth, 1);
    free(v);
    return t;
}

typedef struct scene_picture { voxrt_image m; } scene_picture;

static scene_picture scene_make_picture(uint32_t w, uint32_t h) {
    scene_picture p;
    memset(&p, 0, sizeof p);
    p.m.width = w;
    p.m.height = h;
    p.m.rgba8 = (uint8_t *)calloc((size_t)w * h, 4);
    p.m.depth = (float *)calloc((size_t)w * h, 4);
    p.m.normal = (float *)calloc((size_t)w * h, 12);
    if (p.m.rgba8 == NULL || p.m.depth == NULL || p.m.normal == NULL) exit(1);
    return p;
}
static void scene_free_picture(scene_picture *p) {
    free(p->m.rgba8);
    free(p->m.depth);
    free(p->m.normal);
}
static uint32_t differences(const scene_picture *p, const scene_picture *q) {
    uint32_t i, n = 0;
    for (i = 0; i < p->m.width * p->m.height; i++)
        n += memcmp(p->m.rgba8 + 4 * i, q->m.rgba8 + 4 * i, 4) != 0 || p->m.depth[i] != q->m.depth[i] ||
             memcmp(p->m.normal + 3 * i, q->m.normal + 3 * i, 12) != 0;
    return n;
}

/* Pixels that differ though what is seen is not just one of two things at the same distance, as where a ray meets an
   edge that two pieces share. */
static uint32_t true_differences(const scene_picture *p, const scene_picture *q, uint32_t *ties) {
    uint32_t i, n = 0;
    for (i = 0; i < p->m.width * p->m.height; i++) {
        if (memcmp(p->m.rgba8 + 4 * i, q->m.rgba8 + 4 * i, 4) == 0 && p->m.depth[i] == q->m.depth[i] &&
            memcmp(p->m.normal + 3 * i, q->m.normal + 3 * i, 12) == 0)
            continue;
        if (p->m.depth[i] == q->m.depth[i] && memcmp(p->m.normal + 3 * i, q->m.normal + 3 * i, 12) != 0) ++*ties;
        else n++;
    }
    return n;
}

static voxrt_camera scene_look(float ex, float ey, float ez, float at, float fov) {
    voxrt_camera c;
    memset(&c, 0, sizeof c);
    c.eye[0] = ex;
    c.eye[1] = ey;
    c.eye[2] = ez;
    c.at[0] = c.at[1] = c.at[2] = at;
    c.fov_y = fov;
    return c;
}

/* A matrix of a permutation with signs, a scale and a shift. */
static void turn(double m[12], uint32_t how, double scale, double x, double y, double z) {
    static const uint8_t order[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {1, 0, 2}, {2, 1, 0}};
    uint32_t a;
    memset(m, 0, 12 * sizeof *m);
    for (a = 0; a < 3; a++) m[4 * a + order[how % 6][a]] = (how / 6 >> a & 1u) ? -scale : scale;
    m[3] = x;
    m[7] = y;
    m[11] = z;
}

/* Any rotation, scaled. */
static void rotate(double m[12], test_rng *r, double scale, double reach) {
    double q[4], l = 0;
    int i;
    for (i = 0; i < 4; i++) {
        q[i] = test_rng_double(r) * 2 - 1;
        l += q[i] * q[i];
    }
    for (i = 0, l = sqrt(l); i < 4; i++) q[i] /= l;
    m[0] = 1 - 2 * (q[2] * q[2] + q[3] * q[3]);
    m[1] = 2 * (q[1] * q[2] - q[0] * q[3]);
    m[2] = 2 * (q[1] * q[3] + q[0] * q[2]);
    m[4] = 2 * (q[1] * q[2] + q[0] * q[3]);
    m[5] = 1 - 2 * (q[1] * q[1] + q[3] * q[3]);
    m[6] = 2 * (q[2] * q[3] - q[0] * q[1]);
    m[8] = 2 * (q[1] * q[3] - q[0] * q[2]);
    m[9] = 2 * (q[2] * q[3] + q[0] * q[1]);
    m[10] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
    for (i = 0; i < 12; i++) m[i] = i % 4 == 3 ? reach * (test_rng_double(r) * 2 - 1) : m[i] * scale;
}

/* ---- the whole from its pieces ---- */

TEST(pieces_in_a_group_are_the_whole) { /* voxels dealt out to trees whose boxes overlap everywhere */
    enum { N = 3000, PIECES = 23 };
    static voxrt_voxel all[N], part[N];
    voxrt_tree *whole, *piece[PIECES];
    voxrt_geometry g[PIECES], joined;
    voxrt_group *group = NULL;
    voxrt_render_desc d;
    test_rng r = test_rng_make(1);
    scene_picture p = scene_make_picture(160, 120), q = scene_make_picture(160, 120);
    uint32_t i, k, view, ties = 0;
    size_t n;
    for (i = 0; i < N; i++)
        all[i] = any_voxel(&r, 32);
    for (i = 0; i < N; i++) all[i].rgb[0] = all[i].rgb[1] = all[i].rgb[2] = (uint8_t)(all[i].x * 5 + all[i].y * 2 + all[i].z);
    whole = scene_tree_of(all, N, 5, 0);
    for (k = 0; k < PIECES; k++) {
        for (i = 0, n = 0; i < N; i++)
            if ((all[i].x * 7 + all[i].y * 13 + all[i].z * 29) % PIECES == k) part[n++] = all[i];
        piece[k] = scene_tree_of(part, n, 5, 0);
        voxrt_tree_geometry(piece[k], &g[k]);
    }
    REQUIRE(voxrt_group_create(NULL, g, PIECES, &group) == VOXRT_OK);
    voxrt_group_geometry(group, &joined);
    for (i = 0; i < 3; i++) {
        double lo[3], hi[3];
        voxrt_tree_bounds(whole, lo, hi);
        CHECK(joined.box_min[i] == lo[i] && joined.box_max[i] == hi[i]);
    }
    for (view = 0; view < 4; view++) {
        memset(&d, 0, sizeof d);
        d.shadows = 1;
        d.samples = view == 1 ? 3 : 1;
        d.camera = view == 0 ? scene_look(60, 50, 80, 16, 30) : view == 1 ? scene_look(-40, 16, 16, 16, 50) :
                   view == 2 ? scene_look(16, 16, 16.5f, 20, 90) : scene_look(16, 300, 16.01f, 16, 9);
        CHECK(voxrt_render(&d, whole, &p.m, NULL) == VOXRT_OK);
        d.geometry = &joined;
        d.geometry_count = 1;
        CHECK(voxrt_render(&d, NULL, &q.m, NULL) == VOXRT_OK);
        CHECK_EQ_U64(true_differences(&p, &q, &ties), 0);
        d.geometry = g; /* the same by testing all of them */
        d.geometry_count = PIECES;
        CHECK(voxrt_render(&d, NULL, &q.m, NULL) == VOXRT_OK);
        CHECK_EQ_U64(true_differences(&p, &q, &ties), 0);
    }
    CHECK_MSG(ties <= 4, "%u ties", ties);
    voxrt_group_destroy(group);
    voxrt_tree_destroy(whole);
    for (k = 0; k < PIECES; k++) voxrt_tree_destroy(piece[k]);
    scene_free_picture(&p);
    scene_free_picture(&q);
}

/* A small thing set down in all 48 orientations, some twice as large: one tree with all of its voxels shows the same. */
TEST(instances_are_the_tree_of_their_voxels) {
    enum { COPIES = 48, ROOM = 16 };
    static voxrt_voxel all[COPIES * 120 * 8];
    voxrt_voxel thing[120];
    voxrt_tree *small, *whole;
    voxrt_instance instance[COPIES];
    voxrt_geometry g[COPIES], joined;
    voxrt_group *group = NULL;
    voxrt_render_desc d;
    scene_picture p = scene_make_picture(200, 150), q = scene_make_picture(200, 150);
    test_rng r = test_rng_make(2);
    uint32_t i, k, a, view;
    size_t n = 0;
    for (i = 0; i < 120; i++)
        thing[i] = any_voxel(&r, 8);
    for (i = 0; i < 120; i++) thing[i].rgb[1] = (uint8_t)(thing[i].x * 30); /* of cells given twice the mean is the same */
    small = scene_tree_of(thing, 120, 3, 0);
    memset(instance, 0, sizeof instance);
    for (k = 0; k < COPIES; k++) {
        const double at[3] = {(double)(k % 4 * 2 + 1) * ROOM / 2 * 2 - ROOM / 2, (double)(k / 4 % 4 * 2 + 1) * ROOM - ROOM / 2,
                              (double)(k / 16 * 2 + 1) * ROOM - ROOM / 2};
        const int scale = k % 3 == 0 ? 2 : 1;
        double *m = instance[k].to_world;
        voxrt_tree_geometry(small, &instance[k].geometry);
        turn(m, k, scale, at[0], at[1], at[2]);
        for (a = 0; a < 3; a++) { /* turned about the middle of its 8^3 grid, which stands at `at` */
            m[4 * a + 3] -= 4 * (m[4 * a] + m[4 * a + 1] + m[4 * a + 2]);
        }
        CHECK(voxrt_instance_geometry(&instance[k], &g[k]) == VOXRT_OK);
        for (i = 0; i < 120; i++) {
            uint32_t part;
            for (part = 0; part < (scale == 2 ? 8u : 1u); part++) {
                double c[3];
                for (a = 0; a < 3; a++) {
                    const double half = 0.5 / scale;
                    const double u[3] = {thing[i].x + (scale == 2 ? half * (0.5 + (part & 1)) * 2 : 0.5),
                                         thing[i].y + (scale == 2 ? half * (0.5 + (part >> 1 & 1)) * 2 : 0.5),
                                         thing[i].z + (scale == 2 ? half * (0.5 + (part >> 2 & 1)) * 2 : 0.5)};
                    c[a] = m[4 * a] * u[0] + m[4 * a + 1] * u[1] + m[4 * a + 2] * u[2] + m[4 * a + 3];
                }
                all[n] = thing[i];
                all[n].x = (uint32_t)floor(c[0]);
                all[n].y = (uint32_t)floor(c[1]);
                all[n++].z = (uint32_t)floor(c[2]);
            }
        }
    }
    whole = scene_tree_of(all, n, 7, 0);
    REQUIRE(voxrt_group_create(NULL, g, COPIES, &group) == VOXRT_OK);
    voxrt_group_geometry(group, &joined);
    for (view = 0; view < 4; view++) {
        memset(&d, 0, sizeof d);
        d.shadows = 1;
        d.view = view == 3 ? VOXRT_VIEW_NORMALS : VOXRT_VIEW_SHADED;
        d.camera = view == 0 ? scene_look(180, 150, 220, 50, 30) : view == 1 ? scene_look(50, 51, 49, 100, 80) :
                   scene_look(-90, 20, 30, 50, 60);
        CHECK(voxrt_render(&d, whole, &p.m, NULL) == VOXRT_OK);
        d.geometry = view & 1 ? g : &joined;
        d.geometry_count = view & 1 ? COPIES : 1;
        CHECK(voxrt_render(&d, NULL, &q.m, NULL) == VOXRT_OK);
        if (view == 1) { /* normals of faces and colours agree; lifted shadow origins differ for voxels of twice the size */
            uint32_t wrong = 0;
            for (i = 0; i < 200 * 150; i++)
                wrong += p.m.depth[i] != q.m.depth[i] || memcmp(p.m.normal + 3 * i, q.m.normal + 3 * i, 12) != 0;
            CHECK_EQ_U64(wrong, 0);
            continue;
        }
        for (i = 0, k = 0; i < 200 * 150; i++) {
            k += p.m.depth[i] < INFINITY;
            CHECK(p.m.depth[i] == q.m.depth[i]);
        }
        CHECK(k > 2000);
        d.shadows = 0;
        d.geometry = NULL;
        d.geometry_count = 0;
        CHECK(voxrt_render(&d, whole, &p.m, NULL) == VOXRT_OK);
        d.geometry = &joined;
        d.geometry_count = 1;
        CHECK(voxrt_render(&d, NULL, &q.m, NULL) == VOXRT_OK);
        CHECK_EQ_U64(differences(&p, &q), 0);
    }
    voxrt_group_destroy(group);
    voxrt_tree_destroy(whole);
    voxrt_tree_destroy(small);
    scene_free_picture(&p);
    scene_free_picture(&q);
}

/* ---- against plain computations ---- */

static void any_ray(test_rng *r, float reach, voxrt_ray *q) {
    static const float odd[10] = {0.0f, -0.0f, 1.0f, -1.0f, 1e-30f, 1e-45f, 0.5f, -0.5f, 1e20f, 3.0f};
    uint32_t a, kind = test_rng_below(r, 12);
    q->t_min = 0;
    q->t_max = INFINITY;
    for (a = 0; a < 3; a++) {
        q->org[a] = test_rng_range(r, -1.5f * reach, 1.5f * reach);
        q->dir[a] = test_rng_range(r, -1, 1);
        if (kind < 6) q->dir[a] = -q->org[a] + test_rng_range(r, -0.5f * reach, 0.5f * reach); /* towards the middle */
        if (kind == 6) q->dir[a] = odd[test_rng_below(r, 10)];
        if (kind == 7) q->org[a] = floorf(q->org[a]);
    }
    if (kind == 8) q->org[test_rng_below(r, 3)] = NAN;
    if (kind == 9) q->dir[0] = q->dir[1] = q->dir[2] = 0;
    if (kind == 10) q->dir[test_rng_below(r, 3)] = INFINITY;
    if (test_rng_below(r, 4) == 0) q->t_max = test_rng_range(r, 0, 3);
    if (test_rng_below(r, 6) == 0) q->t_min = test_rng_range(r, -1, 2);
}

/* Rays that come from far off meet an instance as they meet the same tree built there, lines and cones, whoever goes with them. */
TEST(instances_far_away) {
    voxrt_voxel thing[300];
    voxrt_build_desc b;
    voxrt_tree *t = NULL;
    test_rng r = test_rng_make(31);
    double away;
    uint32_t i, k, a, differ = 0, hits = 0;
    for (i = 0; i < 300; i++) thing[i] = any_voxel(&r, 16);
    memset(&b, 0, sizeof b);
    b.box_size = 1.0;
    REQUIRE(voxrt_tree_from_voxels(&b, thing, 300, 4, &t) == VOXRT_OK);
    for (away = 10.0; away < 2e6; away *= 10.0) /* farther, floats aim at corners of the box only */
        for (k = 0; k < 60; k++) {
            voxrt_instance s;
            voxrt_geometry g, there;
            voxrt_tree *in_place = NULL;
            voxrt_ray ray[RUN];
            voxrt_surface one[2], found[2][RUN];
            uint8_t occluded[2][RUN];
            voxrt_trace_desc desc;
            memset(&s, 0, sizeof s);
            memset(&desc, 0, sizeof desc);
            for (a = 0; a < 3; a++) {
                s.to_world[5 * a] = 1.0;
                s.to_world[4 * a + 3] = b.box_min[a] = floor(away * (double)test_rng_range(&r, -1.0f, 1.0f));
            }
            if (k % 4 == 3) {
                desc.cone_width = 0.01f;
                desc.cone_spread = (float)(0.1 / away);
            }
            REQUIRE(voxrt_tree_from_voxels(&b, thing, 300, 4, &in_place) == VOXRT_OK);
            voxrt_tree_geometry(t, &s.geometry);
            voxrt_tree_geometry(in_place, &there);
            REQUIRE(voxrt_instance_geometry(&s, &g) == VOXRT_OK);
            memset(ray, 0, sizeof ray);
            memset(occluded, 0, sizeof occluded);
            memset(found, 0, sizeof found);
            for (i = 0; i < RUN; i++) {
                for (a = 0; a < 3; a++) {
                    ray[i].dir[a] = (float)(b.box_min[a] + test_rng_double(&r) * (i % 8 == 7 ? 4.0 : 1.0));
                    if (i % 16 == 5) ray[i].dir[a] = -ray[i].dir[a];
                    if (i % 16 == 9) ray[i].org[a] = (float)(0.4 * b.box_min[a]);
                    if (i % 16 == 9) ray[i].dir[a] -= ray[i].org[a];
                }
                ray[i].t_min = i % 5 == 4 ? 0.9999f : 0.0f;
                ray[i].t_max = i % 7 == 6 ? 1.00001f : i % 13 == 12 ? 0.5f : INFINITY;
                found[0][i].t = found[1][i].t = INFINITY;
            }
            g.trace_fn(g.user, &desc, ray, found[0], RUN);
            g.occluded_fn(g.user, &desc, ray, occluded[0], RUN);
            there.trace_fn(there.user, &desc, ray, found[1], RUN);
            there.occluded_fn(there.user, &desc, ray, occluded[1], RUN);
            for (i = 0; i < RUN; i++) {
                hits += found[1][i].t < INFINITY;
                differ += (found[0][i].t < INFINITY) != (found[1][i].t < INFINITY) || memcmp(found[0][i].rgb, found[1][i].rgb, 3) != 0 ||
                          occluded[0][i] != occluded[1][i];
                CHECK((occluded[0][i] != 0) == (found[0][i].t < INFINITY));
                if (found[0][i].t < INFINITY && found[1][i].t < INFINITY)
                    CHECK_NEAR((double)found[0][i].t, (double)found[1][i].t, 1e-6 + (desc.cone_width > 0 ? 0.5 / away : 0.0));
                memset(one, 0, sizeof one);
                one[0].t = INFINITY;
                g.trace_fn(g.user, &desc, &ray[i], one, 1);
                CHECK(memcmp(&one[0], &found[0][i], sizeof one[0]) == 0);
            }
            voxrt_tree_destroy(in_place);
        }
    CHECK_MSG(differ == 0 && hits > 5000, "%u of %u", differ, hits);
    voxrt_tree_destroy(t);
}

TEST(an_instance_is_its_ray_in_the_other_space) {
    voxrt_tree *t = scene_ball(4);
    test_rng r = test_rng_make(3);
    uint32_t k, i, a, hits = 0;
    for (k = 0; k < 60; k++) {
        voxrt_instance s;
        voxrt_geometry g;
        voxrt_ray ray[RUN], own;
        voxrt_surface found[RUN];
        uint8_t occluded[RUN];
        voxrt_trace_desc desc, own_desc;
        double size = k < 40 ? 0.1 + 3 * test_rng_double(&r) : 1.0, shear = k % 3 == 2 ? 0.4 : 0.0, longest = 0;
        memset(&desc, 0, sizeof desc);
        memset(&s, 0, sizeof s);
        rotate(s.to_world, &r, size, 8);
        for (a = 0; a < 3; a++) { /* not only rotations: stretched and sheared, and mirrored now and then */
            s.to_world[4 * a + 1] += shear * s.to_world[4 * a];
            if (k % 5 == 4) s.to_world[4 * a + 2] *= -1.7;
        }
        for (i = 0; i < 3; i++) {
            double l = 0;
            for (a = 0; a < 3; a++) l += s.to_world[4 * a + i] * s.to_world[4 * a + i];
            longest = sqrt(l) > longest ? sqrt(l) : longest;
        }
        voxrt_tree_geometry(t, &s.geometry);
        REQUIRE(voxrt_instance_geometry(&s, &g) == VOXRT_OK);
        if (k % 2) {
            desc.cone_width = 0.5f;
            desc.cone_spread = 0.05f;
        }
        for (i = 0; i < RUN; i++) any_ray(&r, 10, &ray[i]);
        for (i = 0; i < RUN; i++) { /* aim at it */
            for (a = 0; a < 3 && i % 2 == 0; a++) ray[i].dir[a] = (float)(0.5 * (g.box_min[a] + g.box_max[a])) - ray[i].org[a];
        }
        g.trace_fn(g.user, &desc, ray, found, RUN);
        g.occluded_fn(g.user, &desc, ray, occluded, RUN);
        for (i = 0; i < RUN; i++) {
            voxrt_hit hit;
            double inverse[12], n[3] = {0, 0, 0}, l = 0, facing = 0;
            float normal[3];
            uint32_t b;
            memcpy(inverse, s._to_object, sizeof inverse);
            for (a = 0; a < 3; a++) { /* it is the inverse */
                for (b = 0; b < 4; b++) {
                    double x = b == 3 ? inverse[4 * a + 3] : 0;
                    uint32_t c;
                    for (c = 0; c < 3; c++) x += inverse[4 * a + c] * s.to_world[4 * c + b];
                    CHECK_NEAR(x, a == b ? 1 : 0, 1e-9 * (1 + 10 / size));
                }
            }
            own = ray[i];
            for (a = 0; a < 3; a++) {
                double o = inverse[4 * a + 3], v = 0;
                for (b = 0; b < 3; b++) {
                    o += inverse[4 * a + b] * (double)ray[i].org[b];
                    v += inverse[4 * a + b] * (double)ray[i].dir[b];
                }
                own.org[a] = (float)o;
                own.dir[a] = (float)v;
            }
            own_desc = desc;
            own_desc.cone_width = (float)((double)desc.cone_width / longest);
            own_desc.cone_spread = (float)((double)desc.cone_spread / longest);
            CHECK(voxrt_trace(t, &own_desc, &own, &hit, 1) == VOXRT_OK);
            CHECK(occluded[i] == (found[i].t < INFINITY));
            if ((hit.node == VOXRT_NO_NODE) != !(found[i].t < INFINITY)) {
                /* sums in another order may round the ray differently at a graze */
                continue;
            }
            if (hit.node == VOXRT_NO_NODE) continue;
            hits++;
            CHECK_NEAR(found[i].t, hit.t, 1e-4 * (fabs((double)hit.t) + 1e-3));
            CHECK_NEAR(found[i].edge, (double)(1u << (4 - hit.level)) * longest, 1e-4 * longest);
            voxrt_hit_normal(t, &hit, normal);
            for (a = 0; a < 3; a++) {
                for (b = 0; b < 3; b++) n[a] += inverse[4 * b + a] * (double)normal[b];
                l += n[a] * n[a];
            }
            for (a = 0; a < 3; a++) facing += n[a] / sqrt(l) * (double)found[i].normal[a];
            CHECK(facing > 0.9999);
        }
    }
    CHECK(hits > 800);
    voxrt_tree_destroy(t);
}

TEST(a_group_is_a_loop_over_its_members) {
    enum { MOST = 301 };
    static voxrt_instance instance[MOST];
    static voxrt_geometry g[MOST];
    static const size_t counts[7] = {1, 2, 3, 5, 17, 100, MOST};
    voxrt_tree *t[2];
    test_rng r = test_rng_make(4);
    uint32_t k, i, round, hits = 0;
    double asked = 0, all = 0;
    size_t m;
    t[0] = scene_ball(3);
    t[1] = scene_ball(4);
    for (k = 0; k < 7; k++) {
        voxrt_group *group = NULL;
        voxrt_geometry joined;
        const size_t n = counts[k];
        memset(instance, 0, sizeof instance);
        for (m = 0; m < n; m++) {
            voxrt_tree_geometry(t[m & 1], &instance[m].geometry);
            if (m % 7 == 6) memcpy(instance[m].to_world, instance[m - 1].to_world, sizeof instance[m].to_world);
            else rotate(instance[m].to_world, &r, m % 11 == 10 ? 2.0 : 0.3, 20);
            CHECK(voxrt_instance_geometry(&instance[m], &g[m]) == VOXRT_OK);
        }
        REQUIRE(voxrt_group_create(NULL, g, n, &group) == VOXRT_OK);
        voxrt_group_geometry(group, &joined);
        for (round = 0; round < (test_quick() ? 10u : 60u); round++) {
            voxrt_ray ray[RUN];
            voxrt_surface found[RUN], best[RUN], other[RUN];
            uint8_t dark[RUN], each[RUN], any[RUN];
            voxrt_trace_desc desc;
            voxrt_stats stats;
            const size_t count = 1 + test_rng_below(&r, RUN);
            memset(&desc, 0, sizeof desc);
            memset(&stats, 0, sizeof stats);
            if (round & 1) desc.cone_spread = 0.02f;
            for (i = 0; i < count; i++) any_ray(&r, 20, &ray[i]);
            for (i = 1; i < count && round % 3 == 0; i++) memcpy(ray[i].org, ray[0].org, 12); /* a camera's */
            memset(any, 0, sizeof any);
            for (i = 0; i < count; i++) {
                memset(&best[i], 0, sizeof best[i]);
                best[i].t = INFINITY;
            }
            for (m = 0; m < n; m++) {
                for (i = 0; i < count; i++) {
                    memset(&other[i], 0, sizeof other[i]);
                    other[i].t = INFINITY;
                }
                g[m].trace_fn(g[m].user, &desc, ray, other, count);
                memset(each, 0, sizeof each);
                g[m].occluded_fn(g[m].user, &desc, ray, each, count);
                for (i = 0; i < count; i++) {
                    if (other[i].t < best[i].t) best[i] = other[i];
                    any[i] |= each[i];
                }
            }
            desc.stats = &stats;
            joined.trace_fn(joined.user, &desc, ray, found, count);
            desc.stats = NULL;
            joined.occluded_fn(joined.user, &desc, ray, dark, count);
            for (i = 0; i < count; i++) {
                CHECK(memcmp(&found[i], &best[i], sizeof best[i]) == 0);
                CHECK(dark[i] == any[i] && any[i] == (best[i].t < INFINITY));
                hits += best[i].t < INFINITY;
            }
            asked += n == MOST ? (double)stats.rays : 0;
            all += n == MOST ? (double)(n * count) : 0;
        }
        voxrt_group_destroy(group);
    }
    CHECK_MSG(hits > (test_quick() ? 150u : 1000u), "%u hits", hits);
    CHECK_MSG(asked * 10 < all, "%g of %g rays reach an object", asked, all); /* it is a hierarchy, after all */
    voxrt_tree_destroy(t[0]);
    voxrt_tree_destroy(t[1]);
}

/* Groups in instances in groups: 5^4 balls from five of them. */
TEST(groups_of_groups) {
    voxrt_tree *t = scene_ball(3);
    voxrt_instance instance[4][5];
    voxrt_geometry g[5], joined;
    voxrt_group *group[4];
    voxrt_render_desc d;
    scene_picture p = scene_make_picture(120, 100);
    uint32_t level, k, i, hits = 0;
    memset(instance, 0, sizeof instance);
    voxrt_tree_geometry(t, &joined);
    for (level = 0; level < 4; level++) {
        for (k = 0; k < 5; k++) {
            instance[level][k].geometry = joined;
            turn(instance[level][k].to_world, k * 7, 1, 0, 0, 0);
            for (i = 0; i < 3; i++) instance[level][k].to_world[4 * i + 3] = (k >> i & 1u ? 12.0 : -12.0) * (1u << level);
            CHECK(voxrt_instance_geometry(&instance[level][k], &g[k]) == VOXRT_OK);
        }
        REQUIRE(voxrt_group_create(NULL, g, 5, &group[level]) == VOXRT_OK);
        voxrt_group_geometry(group[level], &joined);
    }
    memset(&d, 0, sizeof d);
    d.geometry = &joined;
    d.geometry_count = 1;
    d.shadows = 1;
    CHECK(voxrt_render(&d, NULL, &p.m, NULL) == VOXRT_OK);
    for (i = 0; i < 120 * 100; i++) hits += p.m.depth[i] < INFINITY;
    CHECK_MSG(hits > 1000, "%u", hits);
    for (level = 0; level < 4; level++) voxrt_group_destroy(group[level]);
    voxrt_tree_destroy(t);
    scene_free_picture(&p);
}

/* Equal distances: the first of the list is seen, wherever the hierarchy puts it. */
TEST(the_first_of_equals_is_seen) {
    enum { N = 40 };
    voxrt_tree *t[N];
    voxrt_geometry g[N], joined;
    uint32_t i, round;
    test_rng r = test_rng_make(5);
    for (i = 0; i < N; i++) {
        voxrt_voxel v[2];
        v[0] = voxel_at(3, 3, 3, 0);
        v[0].rgb[0] = (uint8_t)i;
        v[1] = any_voxel(&r, 8); /* different boxes */
        v[1].z = 0;
        t[i] = scene_tree_of(v, 2, 3, 0);
    }
    for (round = 0; round < 20; round++) {
        voxrt_group *group = NULL;
        voxrt_trace_desc desc;
        voxrt_ray ray;
        voxrt_surface s;
        uint32_t first = test_rng_below(&r, N);
        memset(&desc, 0, sizeof desc);
        memset(&ray, 0, sizeof ray);
        for (i = 0; i < N; i++) voxrt_tree_geometry(t[(first + i) % N], &g[i]);
        REQUIRE(voxrt_group_create(NULL, g, N, &group) == VOXRT_OK);
        voxrt_group_geometry(group, &joined);
        ray.org[0] = 3.5f;
        ray.org[1] = 3.25f;
        ray.org[2] = 20;
        ray.dir[2] = -1;
        ray.t_max = INFINITY;
        joined.trace_fn(joined.user, &desc, &ray, &s, 1);
        CHECK(s.t == 16 && s.rgb[0] == first);
        voxrt_group_destroy(group);
    }
    for (i = 0; i < N; i++) voxrt_tree_destroy(t[i]);
}

TEST(bad_arguments) {
    voxrt_tree *t = scene_ball(3);
    voxrt_geometry g[3], out;
    voxrt_group *group = (voxrt_group *)1;
    voxrt_instance s;
    voxrt_error error;
    voxrt_env env;
    uint32_t i;
    memset(&s, 0, sizeof s);
    memset(&env, 0, sizeof env);
    env.error = &error;
    for (i = 0; i < 3; i++) voxrt_tree_geometry(t, &g[i]);
    CHECK(voxrt_group_create(NULL, g, 3, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_group_create(NULL, NULL, 3, &group) == VOXRT_ERR_INVALID_ARG && group == NULL);
    CHECK(voxrt_group_create(NULL, g, 0, &group) == VOXRT_ERR_INVALID_ARG);
    g[1].box_max[2] = (double)INFINITY;
    CHECK(voxrt_group_create(&env, g, 3, &group) == VOXRT_ERR_INVALID_ARG && error.where == 1);
    g[1].box_max[2] = (double)NAN;
    CHECK(voxrt_group_create(&env, g, 3, &group) == VOXRT_ERR_INVALID_ARG);
    g[1].box_max[2] = g[1].box_min[2] - 1;
    CHECK(voxrt_group_create(&env, g, 3, &group) == VOXRT_ERR_INVALID_ARG);
    voxrt_tree_geometry(t, &g[1]);
    g[2].occluded_fn = NULL;
    CHECK(voxrt_group_create(&env, g, 3, &group) == VOXRT_ERR_INVALID_ARG && error.where == 2);
    voxrt_group_destroy(NULL);
    CHECK(voxrt_instance_geometry(NULL, &out) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_instance_geometry(&s, &out) == VOXRT_ERR_INVALID_ARG); /* nothing to show */
    voxrt_tree_geometry(t, &s.geometry);
    CHECK(voxrt_instance_geometry(&s, &out) == VOXRT_ERR_INVALID_ARG); /* all zero: no inverse */
    turn(s.to_world, 0, 1, 0, 0, 0);
    CHECK(voxrt_instance_geometry(&s, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_instance_geometry(&s, &out) == VOXRT_OK);
    memcpy(s.to_world + 4, s.to_world, 4 * sizeof *s.to_world); /* flat */
    CHECK(voxrt_instance_geometry(&s, &out) == VOXRT_ERR_INVALID_ARG);
    turn(s.to_world, 0, 1, 0, 0, 0);
    s.to_world[7] = (double)INFINITY;
    CHECK(voxrt_instance_geometry(&s, &out) == VOXRT_ERR_INVALID_ARG);
    turn(s.to_world, 0, 1e-200, 0, 0, 0);
    CHECK(voxrt_instance_geometry(&s, &out) == VOXRT_ERR_INVALID_ARG);
    voxrt_tree_destroy(t);
}

TEST(no_memory) {
    voxrt_tree *t = scene_ball(3);
    voxrt_geometry g[9];
    voxrt_group *group = NULL;
    test_alloc ta;
    voxrt_env env;
    int k, i;
    for (i = 0; i < 9; i++) voxrt_tree_geometry(t, &g[i]);
    for (k = 0;; k++) {
        voxrt_result result;
        test_alloc_init(&ta);
        ta.fail_at = k;
        memset(&env, 0, sizeof env);
        env.allocator.alloc_fn = test_alloc_fn;
        env.allocator.free_fn = test_free_fn;
        env.allocator.user = &ta;
        result = voxrt_group_create(&env, g, 9, &group);
        CHECK(result == VOXRT_OK || (result == VOXRT_ERR_NO_MEMORY && group == NULL));
        voxrt_group_destroy(group);
        test_alloc_check(&ta);
        if (result == VOXRT_OK) break;
    }
    CHECK(k == 4);
    memset(&env, 0, sizeof env);
    env.memory_limit = 100;
    CHECK(voxrt_group_create(&env, g, 9, &group) == VOXRT_ERR_NO_MEMORY && group == NULL);
    voxrt_tree_destroy(t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(pieces_in_a_group_are_the_whole);
    RUN(instances_are_the_tree_of_their_voxels);
    RUN(an_instance_is_its_ray_in_the_other_space);
    RUN(instances_far_away);
    RUN(a_group_is_a_loop_over_its_members);
    RUN(groups_of_groups);
    RUN(the_first_of_equals_is_seen);
    RUN(bad_arguments);
    RUN(no_memory);
    return test_end();
}
