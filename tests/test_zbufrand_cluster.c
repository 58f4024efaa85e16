/* Clusters, tree, bounds and stored points of structures, against loops over the triangles they were built from. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "zbufrand_shapes.h"

static zbufrand_scene *build(const zbufrand_mesh *m, uint32_t count, uint32_t threads, zbufrand_scene_info *info) {
    zbufrand_scene_desc d;
    zbufrand_build_desc b;
    zbufrand_scene *s = NULL;
    uint32_t i;
    memset(&d, 0, sizeof d);
    memset(&b, 0, sizeof b);
    d.env.thread_count = threads;
    b.ids = 1;
    if (zbufrand_scene_create(&d, &s) != ZBUFRAND_OK) abort();
    for (i = 0; i < count; i++) CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, &m[i], NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, &b, info), ZBUFRAND_OK);
    return s;
}

/* ---- the curve ---- */

TEST(hilbert_curve) {
    enum { BITS = 4, N = 1 << BITS };
    static uint32_t at[N * N * N][3];
    uint32_t x, y, z, i, k;
    memset(at, 0xff, sizeof at);
    for (x = 0; x < N; x++) {
        for (y = 0; y < N; y++) {
            for (z = 0; z < N; z++) {
                uint64_t h = zbufrandi_hilbert(x, y, z, BITS);
                REQUIRE(h < N * N * N && at[h][0] == ~0u); /* each rank once */
                at[h][0] = x;
                at[h][1] = y;
                at[h][2] = z;
            }
        }
    }
    for (i = 1; i < N * N * N; i++) { /* neighbours on the curve are neighbours */
        uint32_t d = 0;
        for (k = 0; k < 3; k++) d += at[i][k] > at[i - 1][k] ? at[i][k] - at[i - 1][k] : at[i - 1][k] - at[i][k];
        CHECK_EQ_U64(d, 1);
    }
}

TEST(codes_of_points) {
    test_rng r = test_rng_make(3);
    double worst = 0;
    uint32_t i, k;
    for (i = 0; i < 100000; i++) {
        float n[3], m[3];
        double d = 0;
        for (k = 0; k < 3; k++) n[k] = test_rng_range(&r, -1, 1);
        if (i < 27) for (k = 0; k < 3; k++) n[k] = (float)((int)(i / (k == 0 ? 1 : k == 1 ? 3 : 9)) % 3 - 1);
        if (!zbufrandi_normalize(n)) continue;
        zbufrandi_oct32_decode(zbufrandi_oct32_encode(n), m);
        for (k = 0; k < 3; k++) d += ((double)n[k] - (double)m[k]) * ((double)n[k] - (double)m[k]);
        worst = fmax(worst, sqrt(d));
    }
    CHECK_MSG(worst < 8e-5, "normals are off by %g", worst);
    for (i = 0; i < 64; i++) CHECK_EQ_U64(zbufrandi_reverse6(zbufrandi_reverse6(i)), i);
    CHECK_EQ_U64(zbufrandi_reverse6(1), 32);
    for (i = 0; i < 10000; i++) {
        float lo[3], hi[3], step[3];
        double p[3], q[3];
        for (k = 0; k < 3; k++) {
            lo[k] = test_rng_range(&r, -10, 10);
            hi[k] = lo[k] + test_rng_range(&r, 0, 5);
            p[k] = (double)lo[k] + ((double)hi[k] - (double)lo[k]) * test_rng_double(&r);
        }
        zbufrandi_set_step(lo, hi, step);
        zbufrandi_set_decode(zbufrandi_set_encode(p, lo, hi, (int)(i & 1)), lo, hi, q);
        for (k = 0; k < 3; k++) CHECK_NEAR(p[k], q[k], 0.5 * (double)step[k] + 1e-6);
    }
}

/* ---- clusters and trees ---- */

static double oracle_normal(const float *a, const float *b, const float *c, double n[3]) { /* returns the area */
    double u[3], v[3], l;
    int k;
    for (k = 0; k < 3; k++) {
        u[k] = (double)b[k] - (double)a[k];
        v[k] = (double)c[k] - (double)a[k];
    }
    n[0] = u[1] * v[2] - u[2] * v[1];
    n[1] = u[2] * v[0] - u[0] * v[2];
    n[2] = u[0] * v[1] - u[1] * v[0];
    l = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (k = 0; k < 3; k++) n[k] /= l;
    return 0.5 * l;
}

typedef struct below { double area; uint64_t triangles; double o_lo, o_hi, cosine; float edge; } below;

/* Everything under a child against the lane that speaks of it; triangles are marked. */
static void check_child(const zbufrandi_structure *s, const zbufrandi_node8 *n, uint32_t i, uint8_t *seen, below *sum, const zbufrandi_node8 *lane,
                        uint32_t li) {
    uint32_t kind = ZBUFRANDI_CHILD_KIND(n->child[i]), index = ZBUFRANDI_CHILD_INDEX(n->child[i]), k, t, a;
    if (kind == ZBUFRANDI_CHILD_NODE) {
        const zbufrandi_node8 *c = &s->node[index];
        for (k = 0; k < c->count; k++) check_child(s, c, k, seen, sum, lane, li);
        return;
    }
    if (kind == ZBUFRANDI_CHILD_CLUSTER) {
        const zbufrandi_cluster *c = &s->cluster[index];
        for (t = 0; t < c->triangle_count; t++) {
            const uint8_t *tri = s->triangle + 3 * ((size_t)c->first_triangle + t);
            const float *p[3];
            double normal[3], o = 0, d = 0, center;
            for (k = 0; k < 3; k++) p[k] = s->position + 3 * ((size_t)c->first_vertex + tri[k]);
            sum->area += oracle_normal(p[0], p[1], p[2], normal);
            sum->triangles++;
            if (seen != NULL) seen[c->first_triangle + t]++;
            for (k = 0; k < 3; k++) {
                double e = 0;
                for (a = 0; a < 3; a++) {
                    double x = (double)p[k][a] - (double)p[(k + 1) % 3][a];
                    e += x * x;
                    CHECK(p[k][a] >= lane->lo[a][li] && p[k][a] <= lane->hi[a][li]);
                }
                if ((float)sqrt(e) > sum->edge) sum->edge = (float)sqrt(e);
            }
            for (a = 0; a < 3; a++) {
                center = (double)((lane->lo[a][li] + lane->hi[a][li]) * 0.5f);
                o += normal[a] * ((double)p[0][a] - center);
                d += normal[a] * (double)lane->axis[a][li];
            }
            if ((c->flags & ZBUFRANDI_TWO_SIDED) && !(d >= (double)lane->cosine[li] && o >= (double)lane->o_lo[li] && o <= (double)lane->o_hi[li])) {
                o = -o; /* then its other side has to be in there */
                d = -d;
            }
            CHECK_MSG(d >= (double)lane->cosine[li], "normal at %g from the axis, cone %g", d, (double)lane->cosine[li]);
            CHECK_MSG(o >= (double)lane->o_lo[li] && o <= (double)lane->o_hi[li], "o %g not in %g..%g", o, (double)lane->o_lo[li], (double)lane->o_hi[li]);
        }
    }
}

static void check_structure(const zbufrandi_structure *s, uint32_t triangles) {
    uint8_t *seen = (uint8_t *)calloc(triangles + 1, 1);
    uint32_t i, k;
    REQUIRE(seen != NULL);
    CHECK_EQ_U64(s->triangle_count, triangles);
    for (i = 0; i < s->node_count; i++) {
        const zbufrandi_node8 *n = &s->node[i];
        CHECK(n->count >= 1 && n->count <= 8);
        for (k = 0; k < 8; k++) {
            if (k >= n->count) {
                CHECK(n->lo[0][k] > n->hi[0][k] && !(n->area[k] > 0.0f));
                CHECK_EQ_U64(ZBUFRANDI_CHILD_KIND(n->child[k]), ZBUFRANDI_CHILD_NONE);
                continue;
            }
            if (ZBUFRANDI_CHILD_KIND(n->child[k]) == ZBUFRANDI_CHILD_NODE) CHECK(ZBUFRANDI_CHILD_INDEX(n->child[k]) > i);
            if (s->triangle_count < 20000 || i < 40 || i + 40 > s->node_count) {
                below b;
                memset(&b, 0, sizeof b);
                check_child(s, n, k, i == 0 ? seen : NULL, &b, n, k);
                CHECK_EQ_U64(b.triangles, n->triangles[k]);
                CHECK_NEAR(b.area, (double)n->area[k], 1e-4 * b.area + 1e-30);
                CHECK(n->edge[k] >= b.edge * 0.99999f);
            }
        }
    }
    for (i = 0; i < triangles; i++) CHECK_EQ_U64(seen[i], 1); /* the root reaches each triangle once */
    for (i = 0; i < s->cluster_count; i++) {
        const zbufrandi_cluster *c = &s->cluster[i];
        CHECK(c->triangle_count >= 1 && c->triangle_count <= 128 && c->vertex_count >= 3 && c->vertex_count <= 256);
        for (k = 0; k < 3u * c->triangle_count; k++) CHECK(s->triangle[3 * (size_t)c->first_triangle + k] < c->vertex_count);
    }
    free(seen);
}

/* The triangles that are stored are those of the mesh: three corners each, by the ids. */
static void check_ids(const zbufrand_scene *scene, const zbufrand_mesh *m) {
    const zbufrandi_structure *s = &scene->structure[0];
    uint32_t i, t, k, a;
    for (i = 0; i < s->cluster_count; i++) {
        const zbufrandi_cluster *c = &s->cluster[i];
        for (t = 0; t < c->triangle_count; t++) {
            const uint8_t *tri = s->triangle + 3 * ((size_t)c->first_triangle + t);
            const uint32_t *v = m[c->mesh].indices + 3 * (size_t)s->triangle_id[c->first_triangle + t];
            for (k = 0; k < 3; k++) {
                const float *p = s->position + 3 * ((size_t)c->first_vertex + tri[k]);
                for (a = 0; a < 3; a++) {
                    double want = (double)m[c->mesh].positions[3 * (size_t)v[k] + a];
                    CHECK_NEAR((double)p[a] + s->origin[a], want, 2e-7 * (1 + fabs(want)));
                }
            }
        }
    }
}

TEST(structures) {
    test_rng r = test_rng_make(11);
    uint32_t k;
    for (k = 0; k < 6; k++) {
        shape s[2];
        zbufrand_mesh m[2];
        zbufrand_scene *scene;
        zbufrand_scene_info info;
        uint32_t count = 1;
        memset(s, 0, sizeof s);
        if (k == 0) shape_torus(&s[0], 0, 0, 0, 1, 0.4, 300, 160);
        if (k == 1) soup(&s[0], &r, 5000, 0.02, 0.5);
        if (k == 2) soup(&s[0], &r, 20000, 0.01, 4.0); /* sizes over 12 decades of area */
        if (k == 3) shape_box(&s[0], 100, 200, 300, 101, 202, 303);
        if (k == 4) shape_sphere(&s[0], 0, 0, 0, 1e-6, 40);
        if (k == 5) {
            shape_sphere(&s[0], 0, 0, 0, 1, 40);
            soup(&s[1], &r, 700, 0.3, 0.1);
            count = 2;
        }
        m[0] = mesh_of(&s[0]);
        m[1] = mesh_of(&s[1]);
        m[1].two_sided = 1;
        scene = build(m, count, 1, &info);
        check_structure(&scene->structure[0], (uint32_t)(s[0].triangles + s[1].triangles));
        check_ids(scene, m);
        zbufrand_scene_destroy(scene);
        shape_free(&s[0]);
        shape_free(&s[1]);
    }
}

TEST(two_sided_cones) { /* flat both ways: normals that point up and down make a narrow double cone */
    test_rng r = test_rng_make(12);
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    uint32_t i;
    memset(&s, 0, sizeof s);
    for (i = 0; i < 500; i++) {
        double x = test_rng_double(&r), y = test_rng_double(&r);
        uint32_t a = shape_vertex(&s, x, y, 0), b = shape_vertex(&s, x + 0.01, y, 0), c = shape_vertex(&s, x, y + 0.01, 0);
        if (i & 1) shape_triangle(&s, a, b, c);
        else shape_triangle(&s, a, c, b);
    }
    m = mesh_of(&s);
    m.two_sided = 1;
    scene = build(&m, 1, 1, NULL);
    check_structure(&scene->structure[0], 500);
    for (i = 0; i < scene->structure[0].node[0].count; i++) CHECK(scene->structure[0].node[0].cosine[i] > 0.999f);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

static uint64_t hash_scene(const zbufrand_scene *scene) {
    uint64_t h = 0;
    uint32_t i;
    for (i = 0; i < scene->structure_count; i++) {
        const zbufrandi_structure *s = &scene->structure[i];
        h = test_fnv1a(s->position, 12 * (size_t)s->vertex_count, h);
        h = test_fnv1a(s->triangle, 3 * (size_t)s->triangle_count, h);
        h = test_fnv1a(s->cluster, s->cluster_count * sizeof *s->cluster, h);
        h = test_fnv1a(s->node, s->node_count * sizeof *s->node, h);
        h = test_fnv1a(s->set, ((size_t)s->cluster_count + s->node_count) * 512, h);
        h = test_fnv1a(s->triangle_id, 4 * (size_t)s->triangle_count, h);
    }
    return h;
}

TEST(any_number_of_threads) {
    shape s;
    zbufrand_mesh m;
    uint64_t hash = 0;
    uint32_t threads;
    memset(&s, 0, sizeof s);
    shape_torus(&s, 0, 0, 0, 1, 0.4, test_quick() ? 100 : 500, 200);
    m = mesh_of(&s);
    for (threads = 1; threads <= 9; threads = 2 * threads + 1) {
        zbufrand_scene *scene = build(&m, 1, threads, NULL);
        uint64_t h = hash_scene(scene);
        if (hash == 0) hash = h;
        CHECK_EQ_U64(h, hash);
        zbufrand_scene_destroy(scene);
    }
    shape_free(&s);
}

TEST(memory_and_sharing) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_scene_info info;
    uint32_t i;
    memset(&s, 0, sizeof s);
    shape_torus(&s, 0, 0, 0, 1, 0.4, 400, 250);
    m = mesh_of(&s);
    scene = build(&m, 1, 1, &info);
    CHECK_MSG((double)(info.bytes - 4 * info.triangles) / (double)info.triangles < 24.0, "%g bytes a triangle",
              (double)(info.bytes - 4 * info.triangles) / (double)info.triangles);
    CHECK((double)info.stored_vertices / (double)info.triangles < 0.85);
    CHECK((double)info.triangles / (double)info.clusters > 96.0);
    zbufrand_scene_destroy(scene);
    /* the same as a soup without indices: vertices with the same place are found again */
    {
        shape t;
        memset(&t, 0, sizeof t);
        for (i = 0; i < 3 * s.triangles; i++) {
            const float *p = s.p + 3 * s.t[i];
            (void)shape_vertex(&t, (double)p[0], (double)p[1], (double)p[2]);
        }
        m = mesh_of(&t);
        m.indices = NULL;
        m.triangle_count = s.triangles;
        scene = build(&m, 1, 1, &info);
        CHECK((double)info.stored_vertices / (double)info.triangles < 0.85);
        check_structure(&scene->structure[0], (uint32_t)s.triangles);
        zbufrand_scene_destroy(scene);
        shape_free(&t);
    }
    shape_free(&s);
}

TEST(one_far_point) { /* a stray triangle 10^9 away costs the others no precision */
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 0, 0, 0, 1e-3, 30);
    shape_box(&s, 1e9, 1e9, 1e9, 1.1e9, 1.1e9, 1.1e9);
    m = mesh_of(&s);
    scene = build(&m, 1, 1, NULL);
    check_ids(scene, &m);
    check_structure(&scene->structure[0], (uint32_t)s.triangles);
    CHECK(fabs(scene->structure[0].origin[0]) < 0.01);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

TEST(all_the_same) { /* 3000 identical triangles, and 2000 of them in a row of doubling distances */
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    uint32_t i, k;
    for (k = 0; k < 2; k++) {
        double x = 1e-9;
        memset(&s, 0, sizeof s);
        for (i = 0; i < 3000; i++) {
            uint32_t a = shape_vertex(&s, x, 0, 0), b = shape_vertex(&s, x + 1, 0, 0), c = shape_vertex(&s, x, 1, 0);
            shape_triangle(&s, a, b, c);
            if (k == 1) x *= 1.005;
        }
        m = mesh_of(&s);
        scene = build(&m, 1, 1, NULL);
        check_structure(&scene->structure[0], 3000);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
}

/* ---- stored points ---- */

static double chi_square(const double *expected, const double *seen, uint32_t n, uint32_t *used) {
    double chi = 0;
    uint32_t i;
    *used = 0;
    for (i = 0; i < n; i++) {
        if (expected[i] < 5) continue;
        chi += (seen[i] - expected[i]) * (seen[i] - expected[i]) / expected[i];
        ++*used;
    }
    return chi;
}

/* Points of the sets lie on the surface; which triangle they are on follows the areas, over many seeds; so do those of
   nodes high up. Stratified points spread more evenly than chance, so chi-square may only be too small. */
TEST(sets_follow_areas) {
    test_rng r = test_rng_make(21);
    const uint32_t seeds = test_quick() ? 4 : 40;
    shape s;
    zbufrand_mesh m;
    zbufrand_scene_desc d;
    zbufrand_scene *scene = NULL;
    double total = 0, slab[20], slab_seen[20], chi;
    uint32_t seed, i, k, a, used, n = 0;
    memset(&s, 0, sizeof s);
    soup(&s, &r, 3000, 0.002, 1.5);
    m = mesh_of(&s);
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    CHECK_EQ_U64(zbufrand_scene_create(&d, &scene), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
    memset(slab, 0, sizeof slab);
    memset(slab_seen, 0, sizeof slab_seen);
    for (seed = 0; seed < seeds; seed++) {
        zbufrand_build_desc b;
        const zbufrandi_structure *st;
        memset(&b, 0, sizeof b);
        b.seed = seed;
        CHECK_EQ_U64(zbufrand_scene_build(scene, &b, NULL), ZBUFRAND_OK);
        st = &scene->structure[0];
        n = st->cluster_count;
        total = st->area;
        for (i = 0; i < n; i += seed == 0 ? 1 : n) { /* the points of clusters are on them */
            const zbufrandi_cluster *c = &st->cluster[i];
            uint32_t t;
            for (k = 0; k < 64; k++) {
                const uint32_t *word = st->set + zbufrandi_set_at((size_t)i * 64 + k);
                double p[3], best = 1e30, step2 = 0;
                float step[3], normal[3];
                zbufrandi_set_decode(word[0], c->box_lo, c->box_hi, p);
                zbufrandi_set_step(c->box_lo, c->box_hi, step);
                zbufrandi_oct32_decode(word[8], normal);
                for (a = 0; a < 3; a++) step2 += (double)step[a] * (double)step[a];
                for (t = 0; t < c->triangle_count; t++) { /* nearest triangle with that normal */
                    const uint8_t *tri = st->triangle + 3 * ((size_t)c->first_triangle + t);
                    const float *q[3];
                    double tn[3], off = 0, dot = 0, far = 0, w[3];
                    for (a = 0; a < 3; a++) q[a] = st->position + 3 * ((size_t)c->first_vertex + tri[a]);
                    (void)oracle_normal(q[0], q[1], q[2], tn);
                    for (a = 0; a < 3; a++) {
                        off += tn[a] * (p[a] - (double)q[0][a]);
                        dot += tn[a] * (double)normal[a];
                    }
                    if (dot < 0.9999) continue;
                    for (a = 0; a < 3; a++) { /* signed distances of the edges */
                        const float *u = q[a], *v = q[(a + 1) % 3];
                        double e[3], x[3], l;
                        int b2;
                        for (b2 = 0; b2 < 3; b2++) {
                            e[b2] = (double)v[b2] - (double)u[b2];
                            x[b2] = p[b2] - (double)u[b2];
                        }
                        l = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
                        w[a] = (tn[0] * (e[1] * x[2] - e[2] * x[1]) + tn[1] * (e[2] * x[0] - e[0] * x[2]) + tn[2] * (e[0] * x[1] - e[1] * x[0])) / l;
                        far = fmax(far, -w[a]);
                    }
                    far = fmax(far, fabs(off));
                    best = fmin(best, far);
                }
                CHECK_MSG(best <= sqrt(step2) + 1e-6, "a point is %g off the surface, the grid has %g", best, sqrt(step2));
            }
        }
        for (i = 0; i < 64; i++) { /* the root's points, by slabs */
            double p[3];
            zbufrandi_set_decode(st->set[zbufrandi_set_at((size_t)st->cluster_count * 64 + i)], st->box_lo, st->box_hi, p);
            p[0] = (p[0] + st->origin[0]) * 20;
            slab_seen[p[0] < 0 ? 0 : p[0] > 19 ? 19 : (int)p[0]] += 1;
        }
    }
    for (i = 0; i < s.triangles; i++) {
        const float *q[3];
        double c, tn[3];
        for (k = 0; k < 3; k++) q[k] = s.p + 3 * s.t[3 * i + k];
        c = ((double)q[0][0] + (double)q[1][0] + (double)q[2][0]) / 3 * 20;
        slab[c < 0 ? 0 : c > 19 ? 19 : (int)c] += oracle_normal(q[0], q[1], q[2], tn);
    }
    for (i = 0; i < 20; i++) slab[i] *= 64.0 * seeds / total;
    chi = chi_square(slab, slab_seen, 20, &used);
    CHECK_MSG(used == 20 && chi < 55, "chi-square %g of %u slabs", chi, used); /* 19 degrees of freedom: p = 2e-5 */
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* Two triangles side by side of areas 1 : 7, and every aligned run of a set: each run of 8 has 1 and 7 of them, +-1. */
/* Four of four of four ... with four materials at the end: stored points of what is above are as likely of each, however
   many times four there are; no number of bits is enough for all the choices on the way. */
TEST(points_of_powers_of_two) {
    static const float p[][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    static const uint32_t t[][3] = {{0, 1, 2}, {0, 2, 3}};
    static zbufrand_transform place[30][4];
    uint32_t levels, i, k;
    for (levels = 4; levels <= 30; levels += 13) {
        zbufrand_scene *s = NULL;
        const zbufrandi_structure *to;
        zbufrand_node lib, node, list;
        double step = 1;
        uint64_t count[4];
        size_t n, points;
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &s), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(s, lib, NULL, 0, &node), ZBUFRAND_OK);
        for (i = 0; i < 4; i++) {
            zbufrand_transform at = move_scale(i & 1, i >> 1, 0, 1);
            zbufrand_mesh m;
            memset(&m, 0, sizeof m);
            m.positions = p[0];
            m.vertex_count = 4;
            m.indices = t[0];
            m.triangle_count = 2;
            m.material = i;
            CHECK_EQ_U64(zbufrand_add_mesh(s, node, &at, ZBUFRAND_OWN_STRUCTURE, &m, NULL), ZBUFRAND_OK);
        }
        for (k = 0; k < levels; k++) {
            step *= 2;
            for (i = 0; i < 4; i++) place[k][i] = move_scale(step * (i & 1), step * (i >> 1), 0, 1);
            CHECK_EQ_U64(zbufrand_add_list(s, k + 1 == levels ? ZBUFRAND_ROOT : lib, NULL, 0, &list), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_add_references(s, list, place[k], 4, node, NULL), ZBUFRAND_OK);
            node = list;
        }
        CHECK_EQ_U64(zbufrand_scene_build(s, NULL, NULL), ZBUFRAND_OK);
        to = &s->structure[3]; /* there 64 times: it has more sets */
        CHECK(to->first_more != 0 && to->set_material != NULL);
        points = ((size_t)to->first_more + to->more + to->node[0].count * (to->more / ZBUFRANDI_MORE_PARTS)) * ZBUFRANDI_SET;
        memset(count, 0, sizeof count);
        for (n = 0; n < points; n++) count[to->set_material[n] & 3u]++;
        for (i = 0; i < 4; i++)
            CHECK_MSG(fabs((double)count[i] / (double)points - 0.25) < 0.03, "%u levels: %g of material %u",
                      (unsigned)levels, (double)count[i] / (double)points, (unsigned)i);
        zbufrand_scene_destroy(s);
    }
}

TEST(runs_are_spread) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    const zbufrandi_structure *st;
    uint32_t k, i, run;
    memset(&s, 0, sizeof s);
    shape_triangle(&s, shape_vertex(&s, 0, 0, 0), shape_vertex(&s, 1, 0, 0), shape_vertex(&s, 0, 1, 0));
    shape_triangle(&s, shape_vertex(&s, 10, 0, 0), shape_vertex(&s, 17, 0, 0), shape_vertex(&s, 10, 1, 0));
    m = mesh_of(&s);
    scene = build(&m, 1, 1, NULL);
    st = &scene->structure[0];
    for (run = 2; run <= 64; run *= 2) {
        for (k = 0; k < 64; k += run) {
            uint32_t set, left[2] = {0, 0};
            for (set = 0; set < 2; set++) { /* of the cluster, of the root */
                for (i = 0; i < run; i++) {
                    double p[3];
                    zbufrandi_set_decode(st->set[zbufrandi_set_at(64 * (size_t)set + k + i)], st->box_lo, st->box_hi, p);
                    left[set] += p[0] + st->origin[0] < 5;
                }
                CHECK_MSG(fabs((double)left[set] - run / 8.0) <= 1.0, "%u of a run of %u", left[set], run);
            }
        }
    }
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* Colours, normals and materials of stored points are those of the surface there; also through instances. */
TEST(attributes_of_points) {
    shape s;
    zbufrand_mesh m[2];
    zbufrand_scene *scene = NULL;
    zbufrand_node lib, mesh[2];
    uint8_t *rgb;
    zbufrand_transform t;
    uint32_t i, k, white = 0;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 0, 0, 0, 1, 24);
    rgb = (uint8_t *)malloc(3 * s.vertices);
    REQUIRE(rgb != NULL);
    for (i = 0; i < s.vertices; i++) {
        for (k = 0; k < 3; k++) rgb[3 * i + k] = (uint8_t)(127.5f + 127.0f * s.normal[3 * i + k]);
    }
    m[0] = m[1] = mesh_of(&s);
    m[0].vertex_rgb = rgb;
    m[0].normals = s.normal;
    m[0].material = 7;
    m[1].material = 9;
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m[0], &mesh[0]), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m[1], &mesh[1]), ZBUFRAND_OK);
    for (i = 0; i < 12; i++) {
        memset(&t, 0, sizeof t);
        t.m[0][0] = t.m[1][1] = t.m[2][2] = i % 3 == 1 ? -1.0 : 1.0; /* mirrored: outside stays outside */
        t.m[0][3] = 3.0 * i;
        CHECK_EQ_U64(zbufrand_add_reference(scene, 1, &t, mesh[i & 1], NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    {
        const zbufrandi_structure *st = &scene->structure[0];
        CHECK(st->set_rgb != NULL && st->set_normal != NULL && st->set_material != NULL);
        for (k = 0; k < 64; k++) {
            size_t at = (size_t)st->cluster_count * 64 + k;
            const uint32_t *word = st->set + zbufrandi_set_at(at);
            double p[3], c[3], ball, d = 0, e = 0;
            float n[3], sn[3];
            uint32_t which, a;
            zbufrandi_set_decode(word[0], st->box_lo, st->box_hi, p);
            zbufrandi_oct32_decode(word[8], n);
            zbufrandi_oct_decode(st->set_normal[at], sn);
            for (a = 0; a < 3; a++) p[a] += st->origin[a];
            ball = floor(p[0] / 3 + 0.5);
            which = (uint32_t)ball;
            c[0] = p[0] - 3 * ball;
            c[1] = p[1];
            c[2] = p[2];
            for (a = 0; a < 3; a++) {
                d += (double)n[a] * c[a];
                e += (double)sn[a] * c[a];
            }
            CHECK_MSG(d > 0.98 && e > 0.97, "point %u: outward %g, shading %g", k, d, e);
            CHECK_EQ_U64(st->set_material[at], which & 1 ? 9 : 7);
            if (which & 1) {
                CHECK_EQ_U64(st->set_rgb[at], 0xffffff);
                white++;
            } else {
                double sign = which % 3 == 1 ? -1.0 : 1.0;
                for (a = 0; a < 3; a++) CHECK_NEAR((double)(st->set_rgb[at] >> 8 * a & 255u), 127.5 + 127 * sign * c[a], 14);
            }
        }
        CHECK(white > 20 && white < 44);
    }
    zbufrand_scene_destroy(scene);
    free(rgb);
    shape_free(&s);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(hilbert_curve);
    RUN(codes_of_points);
    RUN(structures);
    RUN(two_sided_cones);
    RUN(any_number_of_threads);
    RUN(memory_and_sharing);
    RUN(one_far_point);
    RUN(all_the_same);
    RUN(sets_follow_areas);
    RUN(points_of_powers_of_two);
    RUN(runs_are_spread);
    RUN(attributes_of_points);
    return test_end();
}
