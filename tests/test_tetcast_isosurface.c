/* test_tetcast_isosurface.c - marching tetrahedra */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"

static tetcast_result run(const tetcast_mesh *mesh, float iso, uint32_t normals, uint32_t threads, tetcast_surface *out) {
    tetcast_surface_desc d;
    memset(&d, 0, sizeof d);
    d.isovalue = iso;
    d.normals = normals;
    d.cells = 1;
    d.env.thread_count = threads;
    return tetcast_isosurface(&d, mesh, out);
}

typedef struct half_edge { uint32_t a, b; } half_edge;
static int half_edge_compare(const void *x, const void *y) {
    const half_edge *p = (const half_edge *)x, *q = (const half_edge *)y;
    return p->a != q->a ? (p->a < q->a ? -1 : 1) : p->b != q->b ? (p->b < q->b ? -1 : 1) : 0;
}
/* Directed edges that are there more than once, and those without their opposite. */
static void count_edges(const tetcast_surface *s, uint64_t *twice, uint64_t *open) {
    size_t n = 3 * (size_t)s->triangle_count, i;
    half_edge *e = (half_edge *)malloc((n + 1) * sizeof *e);
    *twice = *open = 0;
    for (i = 0; i < n; i++) {
        e[i].a = s->indices[i];
        e[i].b = s->indices[i / 3 * 3 + (i + 1) % 3];
    }
    qsort(e, n, sizeof *e, half_edge_compare);
    for (i = 0; i < n; i++) {
        half_edge back;
        back.a = e[i].b;
        back.b = e[i].a;
        *twice += i > 0 && half_edge_compare(&e[i], &e[i - 1]) == 0;
        *open += bsearch(&back, e, n, sizeof *e, half_edge_compare) == NULL;
    }
    free(e);
}

static double volume_of(const tetcast_surface *s) {
    double sum = 0;
    uint32_t i;
    for (i = 0; i < s->triangle_count; i++) {
        const uint32_t *v = s->indices + 3 * (size_t)i;
        const float *a = s->positions + 3 * (size_t)v[0], *b = s->positions + 3 * (size_t)v[1];
        const float *c = s->positions + 3 * (size_t)v[2];
        sum += (double)a[0] * ((double)b[1] * (double)c[2] - (double)b[2] * (double)c[1]) +
               (double)a[1] * ((double)b[2] * (double)c[0] - (double)b[0] * (double)c[2]) +
               (double)a[2] * ((double)b[0] * (double)c[1] - (double)b[1] * (double)c[0]);
    }
    return sum / 6;
}

static double area_of(const tetcast_surface *s) {
    double sum = 0;
    uint32_t i, k;
    for (i = 0; i < s->triangle_count; i++) {
        const uint32_t *v = s->indices + 3 * (size_t)i;
        double p[3], q[3], n[3];
        for (k = 0; k < 3; k++) {
            double o = (double)s->positions[3 * (size_t)v[0] + k];
            p[k] = (double)s->positions[3 * (size_t)v[1] + k] - o;
            q[k] = (double)s->positions[3 * (size_t)v[2] + k] - o;
        }
        n[0] = p[1] * q[2] - p[2] * q[1];
        n[1] = p[2] * q[0] - p[0] * q[2];
        n[2] = p[0] * q[1] - p[1] * q[0];
        sum += 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    }
    return sum;
}

/* A ball in a lattice, values falling from the middle: inside is where it is high. */
static void make_ball(tets *m, uint32_t n, int kind, double jitter) {
    size_t i;
    memset(m, 0, sizeof *m);
    tets_lattice(m, n, n, n, kind, NULL);
    if (jitter > 0) tets_jitter(m, n, n, n, jitter, 7);
    for (i = 0; i < m->nv; i++) {
        const double *p = m->p + 3 * i, c = 0.5 * (n - 1);
        m->s[i] = (float)(n - sqrt((p[0] - c) * (p[0] - c) + (p[1] - c) * (p[1] - c) + (p[2] - c) * (p[2] - c)));
    }
}

TEST(closed) {
    static const double radii[] = {2.0, 4.3, 7.0, 9.0};
    int kind, k, j;
    for (kind = 5; kind <= 6; kind++)
        for (j = 0; j < 2; j++) {
            tets m;
            tetcast_mesh *mesh;
            make_ball(&m, 21, kind, j ? 0.3 : 0.0);
            mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
            REQUIRE(mesh != NULL);
            for (k = 0; k < 4; k++) {
                tetcast_surface s;
                uint64_t twice, open;
                double r = radii[k], ball = 4.0 / 3.0 * 3.14159265358979 * r * r * r;
                uint32_t i;
                CHECK(run(mesh, (float)(21 - r), 1, 0, &s) == TETCAST_OK);
                count_edges(&s, &twice, &open);
                CHECK_MSG(twice == 0 && open == 0, "radius %g: %d edges twice, %d open", r, (int)twice, (int)open);
                CHECK_EQ_I64((int64_t)s.vertex_count - (int64_t)s.triangle_count / 2, 2); /* a sphere: V - E + F = 2 */
                CHECK_MSG(volume_of(&s) > 0.85 * ball && volume_of(&s) < 1.02 * ball, "radius %g: volume %g of %g", r,
                          volume_of(&s), ball);
                for (i = 0; i < s.vertex_count; i++) { /* normals away from the middle */
                    const float *p = s.positions + 3 * (size_t)i, *n = s.normals + 3 * (size_t)i;
                    double q[3], l = 0, dot = 0;
                    int c;
                    for (c = 0; c < 3; c++) {
                        q[c] = (double)p[c] + s.origin[c] - 10.0;
                        l += q[c] * q[c];
                        dot += q[c] * (double)n[c];
                    }
                    CHECK_MSG(fabs(sqrt(l) - r) < 0.35, "vertex %d is %g from the middle, not %g", (int)i, sqrt(l), r);
                    CHECK(dot > (r == 4.3 ? 0.6 : -1e-6) * sqrt(l)); /* among flat triangles it is the direction of an edge */
                }
                tetcast_surface_free(&s);
            }
            tetcast_mesh_destroy(mesh);
            tets_free(&m);
        }
}

/* The area of the part of a plane s = iso inside of one tetrahedron, by clipping its polygon of crossings in order of angle. */
static double plane_area(const double p[4][3], const double s[4], double iso) {
    double q[4][3], centre[3] = {0, 0, 0}, area = 0;
    int n = 0, i, j, k;
    for (i = 0; i < 4; i++)
        for (j = i + 1; j < 4; j++)
            if ((s[i] >= iso) != (s[j] >= iso)) {
                double u = (iso - s[i]) / (s[j] - s[i]);
                for (k = 0; k < 3; k++) q[n][k] = p[i][k] + u * (p[j][k] - p[i][k]);
                n++;
            }
    if (n < 3) return 0;
    for (i = 0; i < n; i++)
        for (k = 0; k < 3; k++) centre[k] += q[i][k] / n;
    for (i = 0; i < n; i++) /* all triangles (i, j, k) of a convex quadrilateral: each point is in two of the four */
        for (j = i + 1; j < n; j++)
            for (k = j + 1; k < n; k++) {
                double a[3], b[3], c[3];
                int d;
                for (d = 0; d < 3; d++) {
                    a[d] = q[j][d] - q[i][d];
                    b[d] = q[k][d] - q[i][d];
                }
                c[0] = a[1] * b[2] - a[2] * b[1];
                c[1] = a[2] * b[0] - a[0] * b[2];
                c[2] = a[0] * b[1] - a[1] * b[0];
                area += 0.5 * sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]) / (n == 4 ? 2 : 1);
            }
    return area;
}

TEST(areas) { /* of random fields: each cell's share against clipping in doubles */
    test_rng rng = test_rng_make(3);
    int round;
    for (round = 0; round < 6; round++) {
        tets m;
        tetcast_mesh *mesh;
        tetcast_surface s;
        double want = 0;
        size_t i;
        uint64_t crossed = 0;
        memset(&m, 0, sizeof m);
        tets_lattice(&m, 9, 8, 7, 5 + round % 2, NULL);
        tets_jitter(&m, 9, 8, 7, 0.2, (uint64_t)round);
        tets_round(&m);
        for (i = 0; i < m.nv; i++) m.s[i] = round < 3 ? (float)test_rng_double(&rng) : (float)test_rng_below(&rng, 3) * 0.5f;
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        CHECK(run(mesh, 0.5f, 0, 0, &s) == TETCAST_OK);
        for (i = 0; i < m.nt; i++) {
            double p[4][3], v[4];
            int in = 0;
            size_t k;
            for (k = 0; k < 4; k++) {
                memcpy(p[k], m.p + 3 * m.t[4 * i + k], sizeof p[k]);
                v[k] = (double)m.s[m.t[4 * i + k]];
                in += v[k] >= 0.5;
            }
            crossed += in == 1 || in == 3 ? 1u : in == 2 ? 2u : 0u;
            want += plane_area((const double (*)[3])p, v, 0.5);
        }
        CHECK_EQ_U64(s.triangle_count, crossed);
        CHECK_NEAR(area_of(&s), want, 1e-4 * want);
        CHECK(round < 3 ? s.flat_count == 0 : s.flat_count > 0);
        for (i = 0; i < s.triangle_count; i++) CHECK(s.cells[i] < m.nt);
        {
            uint64_t twice, open;
            count_edges(&s, &twice, &open);
            CHECK(twice == 0); /* oriented; open only in the hull */
        }
        tetcast_surface_free(&s);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

TEST(same_for_all_threads) {
    tets m;
    tetcast_mesh *mesh;
    tetcast_surface a, b;
    const uint32_t n = test_quick() ? 24 : 40;
    const float value = 0.6f * (float)n;
    uint32_t t;
    make_ball(&m, n, 6, 0.2);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL && run(mesh, value, 1, 1, &a) == TETCAST_OK && a.triangle_count > 0);
    for (t = 2; t <= 5; t++) {
        REQUIRE(run(mesh, value, 1, t, &b) == TETCAST_OK);
        REQUIRE(a.vertex_count == b.vertex_count && a.triangle_count == b.triangle_count);
        CHECK(memcmp(a.positions, b.positions, 12 * (size_t)a.vertex_count) == 0);
        CHECK(memcmp(a.normals, b.normals, 12 * (size_t)a.vertex_count) == 0);
        CHECK(memcmp(a.indices, b.indices, 12 * (size_t)a.triangle_count) == 0);
        CHECK(memcmp(a.cells, b.cells, 4 * (size_t)a.triangle_count) == 0);
        tetcast_surface_free(&b);
    }
    tetcast_surface_free(&a);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

TEST(fan) { /* one vertex with thousands of edges */
    tets m;
    tetcast_mesh *mesh;
    tetcast_surface s;
    uint32_t i, n = test_quick() ? 500 : 20000, top, low;
    uint64_t twice, open;
    memset(&m, 0, sizeof m);
    top = tets_vertex(&m, 0, 0, 1, 1);
    low = tets_vertex(&m, 0, 0, -1, 0);
    for (i = 0; i < n; i++) {
        double a = 6.283185307179586 * i / n;
        tets_vertex(&m, cos(a), sin(a), 0, 0);
    }
    for (i = 0; i < n; i++) tets_tet(&m, top, low, 2 + i, 2 + (i + 1) % n);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL && run(mesh, 0.5f, 0, 0, &s) == TETCAST_OK);
    CHECK_EQ_U64(s.vertex_count, n + 1);
    CHECK_EQ_U64(s.triangle_count, n);
    count_edges(&s, &twice, &open);
    CHECK(twice == 0 && open == n);
    tetcast_surface_free(&s);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

TEST(edges_of_values) { /* plateaus, values equal to the isovalue, out of range, NaN */
    tets m;
    tetcast_mesh *mesh;
    tetcast_surface s;
    tetcast_surface_desc d;
    test_alloc ta;
    int64_t n;
    make_ball(&m, 9, 5, 0.0);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    CHECK(run(mesh, 1000.0f, 1, 0, &s) == TETCAST_OK && s.triangle_count == 0 && s.positions == NULL);
    CHECK(run(mesh, -1000.0f, 1, 0, &s) == TETCAST_OK && s.triangle_count == 0);
    CHECK(run(mesh, (float)INFINITY, 1, 0, &s) == TETCAST_ERR_INVALID_ARG);
    CHECK(run(NULL, 0.0f, 1, 0, &s) == TETCAST_ERR_INVALID_ARG);
    CHECK(run(mesh, 5.0f, 1, 0, NULL) == TETCAST_ERR_INVALID_ARG);
    memset(&d, 0, sizeof d);
    d._end_zero = 1;
    CHECK(tetcast_isosurface(&d, mesh, &s) == TETCAST_ERR_UNINIT_DESC);
    memset(&d, 0, sizeof d);
    d.isovalue = 6.0f;
    d.normals = d.cells = 1;
    for (n = 0; n < 40; n++) {
        tetcast_result result;
        test_alloc_init(&ta);
        ta.fail_at = n;
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        result = tetcast_isosurface(&d, mesh, &s);
        CHECK(result == TETCAST_OK || (result == TETCAST_ERR_NO_MEMORY && s.positions == NULL));
        tetcast_surface_free(&s);
        test_alloc_check(&ta);
        if (result == TETCAST_OK) break;
    }
    CHECK(n > 5 && n < 40);
    tetcast_surface_free(NULL);
    tetcast_mesh_destroy(mesh);
    m.s[m.nv / 2] = (float)NAN; /* the cells around it show nothing */
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL && run(mesh, 8.5f, 1, 0, &s) == TETCAST_OK);
    CHECK(s.triangle_count == 0); /* the small sphere lies in just these */
    tetcast_surface_free(&s);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
    for (n = 0; n < 2; n++) { /* the largest mesh whose positions are floats, and a larger one */
        size_t i;
        make_ball(&m, 9, 5, 0.0);
        for (i = 0; i < 3 * m.nv; i++) m.p[i] *= n ? 5e38 : 2e37;
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        CHECK_EQ_U64(run(mesh, 6.0f, 1, 0, &s), n ? TETCAST_ERR_RANGE : TETCAST_OK);
        for (i = 0; i < 3 * (size_t)s.vertex_count; i++) CHECK(fabs((double)s.positions[i]) < 3.4e38);
        CHECK((s.triangle_count == 0) == (n == 1));
        tetcast_surface_free(&s);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

TEST(normals_of_any_units) { /* as of a mesh of ordinary ones; by triangles and by gradients */
    static const int units[5][2] = {{0, 0}, {45, 0}, {-50, 0}, {90, -100}, {-90, 110}}; /* lengths, values: powers of 2 */
    tetcast_surface s[5][2];
    int u, k, a;
    uint32_t i;
    for (u = 0; u < 5; u++) {
        const double size = ldexp(1, units[u][0]), value = ldexp(1, units[u][1]);
        const double scale[3] = {size, size, size}, offset[3] = {0, 0, 0};
        tets t;
        tetcast_mesh *m;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, 7, 7, 7, 5, NULL);
        tets_place(&t, scale, offset);
        for (i = 0; i < t.nv; i++) t.s[i] = (float)((double)t.s[i] * value);
        m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
        REQUIRE(m != NULL);
        for (k = 0; k < 2; k++) {
            CHECK_EQ_U64(run(m, (float)(0.3 * value), 1, 1, &s[u][k]), TETCAST_OK);
            CHECK(s[u][k].vertex_count == s[0][k].vertex_count && s[u][k].vertex_count > 50);
            for (i = 0; i < s[0][k].vertex_count; i++)
                for (a = 0; a < 3; a++)
                    CHECK_NEAR(s[u][k].normals[3 * i + (uint32_t)a], s[0][k].normals[3 * i + (uint32_t)a], 1e-6);
            CHECK_EQ_U64(tetcast_mesh_make_gradients(m, NULL), TETCAST_OK);
        }
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
    for (u = 0; u < 5; u++)
        for (k = 0; k < 2; k++) tetcast_surface_free(&s[u][k]);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(closed);
    RUN(areas);
    RUN(same_for_all_threads);
    RUN(fan);
    RUN(edges_of_values);
    RUN(normals_of_any_units);
    return test_end();
}
