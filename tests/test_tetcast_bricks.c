/* test_tetcast_bricks.c - resampling, planes, bricks with level of detail, shaders, clipping, tiles, codecs
   SPDX-License-Identifier: MIT OR Unlicense */
#include "test.h"
#include <float.h>
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"
#include "../examples/support/amr_file.h"
#include "../examples/support/tile_file.h"
#include "../bench/baseline/slices.h"
#include "../bench/baseline/opacity_slices.h"
#if !defined(_WIN32)
#include <sys/stat.h>
#include <unistd.h>
#endif

/* ---- resampling ---------------------------------------------------------------------------------------------- */

static double linear_at(const double *p) { return 0.3 * p[0] - 0.7 * p[1] + 0.45 * p[2] + 0.2; }

static void make_linear(tets *m) {
    size_t i;
    for (i = 0; i < m->nv; i++) m->s[i] = (float)linear_at(m->p + 3 * i);
}

/* Smallest barycentric coordinate of a point in a tetrahedron, and the value there; -1e9: flat. */
static double inside(const tets *m, size_t cell, const double *x, double *value) {
    const uint32_t *t = m->t + 4 * cell;
    double e[3][3], r[3], det, b[4], least;
    int i, k;
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++) e[i][k] = m->p[3 * (size_t)t[i + 1] + (size_t)k] - m->p[3 * (size_t)t[0] + (size_t)k];
    for (k = 0; k < 3; k++) r[k] = x[k] - m->p[3 * (size_t)t[0] + (size_t)k];
    det = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
          e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
    if (det == 0.0) return -1e9;
    b[1] = (r[0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - r[1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
            r[2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0])) / det;
    b[2] = (e[0][0] * (r[1] * e[2][2] - r[2] * e[2][1]) - e[0][1] * (r[0] * e[2][2] - r[2] * e[2][0]) +
            e[0][2] * (r[0] * e[2][1] - r[1] * e[2][0])) / det;
    b[3] = (e[0][0] * (e[1][1] * r[2] - e[1][2] * r[1]) - e[0][1] * (e[1][0] * r[2] - e[1][2] * r[0]) +
            e[0][2] * (e[1][0] * r[1] - e[1][1] * r[0])) / det;
    b[0] = 1 - b[1] - b[2] - b[3];
    *value = 0;
    least = b[0];
    for (i = 0; i < 4; i++) {
        *value += b[i] * (double)m->s[t[i]];
        least = b[i] < least ? b[i] : least;
    }
    return least;
}

static size_t node_count(const tetcast_lattice *l) { return (size_t)l->dims[0] * l->dims[1] * l->dims[2]; }

static void node_at(const tetcast_lattice *l, size_t i, double *p) {
    const size_t nx = l->dims[0], ny = l->dims[1];
    p[0] = l->origin[0] + (double)(i % nx) * l->spacing[0];
    p[1] = l->origin[1] + (double)(i / nx % ny) * l->spacing[1];
    p[2] = l->origin[2] + (double)(i / nx / ny) * l->spacing[2];
}

static float *resample(const tetcast_mesh *mesh, const tetcast_lattice *l, tetcast_isa isa, uint32_t axis,
                       uint32_t threads, uint32_t extend, tetcast_resample_stats *stats) {
    tetcast_resample_desc d;
    float *out = (float *)malloc(node_count(l) * 4);
    memset(&d, 0, sizeof d);
    if (stats != NULL) memset(stats, 0, sizeof *stats);
    d.env.thread_count = threads;
    d.isa = isa;
    d.axis = axis;
    d.extend = extend;
    CHECK_EQ_U64(tetcast_resample(&d, mesh, l, out, stats), TETCAST_OK);
    return out;
}

/* Nodes inside by brute force: 1 inside, 0 outside, 2 too near to a face to tell. */
static void check_nodes(const tets *m, const tetcast_lattice *l, const float *got, double tolerance) {
    size_t i, c, wrong = 0, far_off = 0;
    for (i = 0; i < node_count(l); i++) {
        double p[3], v, least = -1e9, value = 0;
        node_at(l, i, p);
        for (c = 0; c < m->nt; c++) {
            const double at = inside(m, c, p, &v);
            if (at > least) {
                least = at;
                value = v;
            }
        }
        if (least > -1e-7 && least < -1e-12) continue;
        wrong += (least >= -1e-12) != (got[i] == got[i]);
        if (least > 0 && got[i] == got[i]) far_off += fabs((double)got[i] - value) > tolerance;
    }
    CHECK_EQ_U64(wrong, 0);
    CHECK_EQ_U64(far_off, 0);
}

TEST(resample_against_brute_force) {
    static const double scale[3] = {1.7, 0.9, 2.3}, offset[3] = {-3.1, 100.5, 0.25};
    int round;
    for (round = 0; round < (test_quick() ? 2 : 4); round++) {
        tets m;
        tetcast_mesh *mesh;
        tetcast_lattice l;
        float *a;
        int k;
        memset(&m, 0, sizeof m);
        tets_lattice(&m, 5, 4, 6, round % 2 ? 5 : 6, NULL);
        tets_jitter(&m, 5, 4, 6, 0.7, (uint64_t)round + 1);
        tets_place(&m, scale, offset);
        tets_round(&m);
        make_linear(&m);
        tets_shuffle(&m, 77);
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        memset(&l, 0, sizeof l);
        for (k = 0; k < 3; k++) {
            l.dims[k] = (uint32_t)(11 + 3 * k + round);
            l.spacing[k] = scale[k] * (k == 0 ? 4.9 : k == 1 ? 3.7 : 5.6) / (l.dims[k] - 2);
            l.origin[k] = offset[k] - 0.3 * l.spacing[k];
        }
        a = resample(mesh, &l, TETCAST_ISA_SCALAR, 0, 1, 0, NULL);
        check_nodes(&m, &l, a, 1.6e-5); /* values reach 70 */
        free(a);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

/* Nodes just on vertices, edges and faces, of cells whose corners are whole numbers: none may be lost, and the value is
   that of the vertex. */
TEST(resample_on_vertices) {
    int kind, fine;
    for (kind = 5; kind <= 6; kind++)
        for (fine = 1; fine <= 4; fine++) {
            tets m;
            tetcast_mesh *mesh;
            tetcast_lattice l;
            tetcast_resample_stats stats;
            size_t i;
            float *a;
            int k;
            double worst = 0;
            memset(&m, 0, sizeof m);
            tets_lattice(&m, 7, 5, 6, kind, NULL);
            make_linear(&m);
            mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
            REQUIRE(mesh != NULL);
            memset(&l, 0, sizeof l);
            for (k = 0; k < 3; k++) {
                l.dims[k] = (uint32_t)(fine * (k == 0 ? 6 : k == 1 ? 4 : 5) + 1);
                l.spacing[k] = 1.0 / fine;
            }
            a = resample(mesh, &l, TETCAST_ISA_AUTO, 0, 1, 0, &stats);
            CHECK_EQ_U64(stats.covered, node_count(&l));
            CHECK(stats.writes >= stats.covered);
            for (i = 0; i < node_count(&l); i++) {
                double p[3], e;
                node_at(&l, i, p);
                e = fabs((double)a[i] - linear_at(p));
                worst = e > worst || e != e ? e : worst;
            }
            CHECK_MSG(worst < 2e-6, "%g", worst);
            free(a);
            tetcast_mesh_destroy(mesh);
            tets_free(&m);
        }
}

TEST(resample_same_bits) {
    tets m;
    tetcast_mesh *mesh;
    tetcast_lattice l;
    float *a, *b;
    uint32_t axis, threads, extend;
    size_t i, sets = 0, off = 0;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 9, 8, 7, 6, NULL);
    tets_jitter(&m, 9, 8, 7, 0.8, 5);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    CHECK_EQ_U64(tetcast_lattice_fit(mesh, 61, &l), TETCAST_OK);
    l.dims[2] += 3;
    for (extend = 0; extend < 2; extend++)
        for (axis = 0; axis < 4; axis++) {
            a = resample(mesh, &l, TETCAST_ISA_SCALAR, axis, 1, extend, NULL);
            for (threads = 1; threads < 8; threads += 3) {
                b = resample(mesh, &l, threads == 4 ? TETCAST_ISA_AVX2 : TETCAST_ISA_AUTO, axis, threads, extend, NULL);
                CHECK(memcmp(a, b, node_count(&l) * 4) == 0);
                free(b);
            }
            if (!extend) { /* other rows: the same nodes, the same values but for rounding */
                b = resample(mesh, &l, TETCAST_ISA_AUTO, 1, 1, 0, NULL);
                for (i = 0; i < node_count(&l); i++) {
                    sets += (a[i] == a[i]) != (b[i] == b[i]);
                    off += fabs((double)a[i] - (double)b[i]) > 2.4e-7;
                }
                free(b);
            }
            free(a);
        }
    CHECK_EQ_U64(sets, 0);
    CHECK_EQ_U64(off, 0);
    { /* 64 threads; cells and vertices in any other order: the same nodes, the same values but for rounding */
        tets q; /* not tangled: where cells overlap the order counts */
        tetcast_mesh *one, *other;
        memset(&q, 0, sizeof q);
        tets_lattice(&q, 9, 8, 7, 6, NULL);
        tets_jitter(&q, 9, 8, 7, 0.3, 6);
        one = tets_build(&q, TETCAST_CELLS_TET16, NULL);
        tets_shuffle(&q, 12);
        other = tets_build(&q, TETCAST_CELLS_TET16, NULL);
        REQUIRE(one != NULL && other != NULL);
        a = resample(one, &l, TETCAST_ISA_AUTO, 0, 64, 0, NULL);
        b = resample(one, &l, TETCAST_ISA_AUTO, 0, 1, 0, NULL);
        CHECK(memcmp(a, b, node_count(&l) * 4) == 0);
        free(b);
        b = resample(other, &l, TETCAST_ISA_AUTO, 0, 1, 0, NULL);
        for (i = sets = off = 0; i < node_count(&l); i++) {
            sets += (a[i] == a[i]) != (b[i] == b[i]);
            off += fabs((double)a[i] - (double)b[i]) > 2.4e-7;
        }
        CHECK_EQ_U64(sets, 0);
        CHECK_EQ_U64(off, 0);
        free(a);
        free(b);
        tetcast_mesh_destroy(one);
        tetcast_mesh_destroy(other);
        tets_free(&q);
    }
    CHECK_EQ_U64(tetcast_lattice_fit(mesh, 131, &l), TETCAST_OK);
    for (axis = 0; axis < 2; axis++) { /* rows of cells up to 32 nodes long; of more */
        tetcast_resample_stats want, got;
        memset(&want, 0, sizeof want);
        memset(&got, 0, sizeof got);
        a = resample(mesh, &l, TETCAST_ISA_SCALAR, 0, 1, 0, &want);
        b = resample(mesh, &l, TETCAST_ISA_AUTO, 0, 1, 0, &got);
        CHECK(memcmp(a, b, node_count(&l) * 4) == 0);
        CHECK(memcmp(&want, &got, sizeof want) == 0);
        free(b);
        b = resample(mesh, &l, TETCAST_ISA_AVX2, 0, 1, 0, NULL);
        CHECK(memcmp(a, b, node_count(&l) * 4) == 0);
        free(b);
        free(a);
        l.dims[0] = 2 * l.dims[0] - 1;
        l.spacing[0] *= 0.5;
    }
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* What is counted is the same for any number of threads, though several tasks meet a cell. Where a cell is too large in
   units of the lattice for doubles there is no value, not that of another cell. */
TEST(resample_counts) {
    tets m;
    tetcast_mesh *mesh;
    tetcast_lattice l;
    tetcast_resample_stats one, more;
    uint32_t axis, threads, k;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 5, 5, 5, 6, NULL);
    tets_jitter(&m, 5, 5, 5, 0.6, 3);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    memset(&l, 0, sizeof l);
    for (k = 0; k < 3; k++) {
        l.dims[k] = k == 2 ? 90 : 21;
        l.spacing[k] = 4.0 / (l.dims[k] - 1);
    }
    for (axis = 0; axis < 4; axis++) {
        free(resample(mesh, &l, TETCAST_ISA_AUTO, axis, 1, 1, &one));
        CHECK_EQ_U64(one.cells, m.nt);
        for (threads = 2; threads < 9; threads += 3) {
            free(resample(mesh, &l, threads == 5 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO, axis, threads, 1, &more));
            CHECK(memcmp(&one, &more, sizeof one) == 0);
        }
    }
    for (k = 0; k < 3; k++) {
        l.dims[k] = 2;
        l.origin[k] = 1.3 + 0.1 * k;
    }
    for (k = 0; k < 8; k++) {
        const float want = 0.257981f;
        float *v;
        l.spacing[0] = l.spacing[1] = l.spacing[2] = pow(10.0, -10.0 - 35.0 * k);
        v = resample(mesh, &l, k % 2 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO, 0, 1, 0, NULL);
        CHECK_MSG(!(v[0] == v[0]) || fabsf(v[0] - want) < 1e-5f, "%g", (double)v[0]);
        CHECK(k > 2 || v[0] == v[0]);
        free(v);
    }
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* One cell alone, of any shape, anywhere about the lattice: its nodes by brute force. Long rows: values stay right to the end. */
TEST(lone_cells) {
    const int rounds = test_quick() ? 6000 : 20000;
    test_rng r = test_rng_make(91);
    int round, k;
    for (round = 0; round < rounds; round++) {
        tets m;
        tetcast_mesh *mesh;
        tetcast_lattice l;
        float *a;
        const double size = pow(10.0, 2.0 * test_rng_double(&r) - 0.9), kind = test_rng_double(&r);
        uint32_t v[4], i;
        memset(&m, 0, sizeof m);
        memset(&l, 0, sizeof l);
        for (i = 0; i < 4; i++) {
            double p[3];
            for (k = 0; k < 3; k++) {
                p[k] = 4.0 + size * (test_rng_double(&r) - 0.5);
                if (kind < 0.3) p[k] = (double)(int)(p[k] * 2.0) / 2.0; /* rows along edges, nodes in faces */
                if (kind > 0.8 && k == round % 3) p[k] = 4.0 + 1e-3 * (p[k] - 4.0);
            }
            v[i] = tets_vertex(&m, p[0], p[1], p[2], 0.0);
        }
        tets_tet(&m, v[0], v[1], v[2], v[3]);
        tets_round(&m);
        make_linear(&m);
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        if (mesh != NULL) { /* flat ones make none */
            for (k = 0; k < 3; k++) {
                l.dims[k] = (uint32_t)(9 + k);
                l.spacing[k] = kind < 0.3 ? 0.5 * (1 + k) : 0.9 + 0.05 * k;
                l.origin[k] = kind < 0.3 ? 0.0 : 0.1 * k;
            }
            a = resample(mesh, &l, TETCAST_ISA_AUTO, (uint32_t)round % 4, 1, 0, NULL);
            if (kind <= 0.8) check_nodes(&m, &l, a, 4e-5); /* values reach 50 */
            else
                for (i = 0; i < node_count(&l); i++) CHECK(!(fabsf(a[i]) > 50.0f));
            free(a);
        }
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
    for (k = -6; k <= 6; k += 2) {
        static const double corner[4][3] = {{-2000, -9, -9}, {6000, -9, -9}, {2000, 40, -9}, {2000, 0, 60}};
        const double slope = pow(10.0, k);
        double worst = 0.0;
        tets m;
        tetcast_mesh *mesh;
        tetcast_lattice l;
        float *a;
        uint32_t i, seen = 0;
        memset(&m, 0, sizeof m);
        memset(&l, 0, sizeof l);
        for (i = 0; i < 4; i++) (void)tets_vertex(&m, corner[i][0], corner[i][1], corner[i][2], slope * corner[i][0]);
        tets_tet(&m, 0, 1, 2, 3);
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        l.dims[0] = 4096;
        l.dims[1] = l.dims[2] = 2;
        for (i = 0; i < 3; i++) l.spacing[i] = 1.0;
        a = resample(mesh, &l, TETCAST_ISA_AUTO, 1, 1, 0, NULL);
        for (i = 0; i < node_count(&l); i++) {
            if (!(a[i] == a[i])) continue;
            seen++;
            worst = fmax(worst, fabs((double)a[i] - slope * (double)(i % 4096)) / (8000.0 * slope));
        }
        CHECK_MSG(seen > 12000 && worst < 1.3e-7, "slope %g: %u nodes, %g", slope, seen, worst);
        free(a);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

/* With the band around the mesh trilinear interpolation of a linear field is right up to the hull. */
TEST(resample_extends) {
    tets m;
    tetcast_mesh *mesh;
    tetcast_lattice l;
    tetcast_resample_stats stats;
    float *a;
    size_t i, off = 0, lonely = 0;
    uint32_t n[3], x, y, z, k;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 6, 6, 6, 5, NULL);
    make_linear(&m);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    memset(&l, 0, sizeof l);
    for (k = 0; k < 3; k++) {
        l.dims[k] = n[k] = 19;
        l.spacing[k] = 0.37;
        l.origin[k] = -0.81;
    }
    a = resample(mesh, &l, TETCAST_ISA_AUTO, 0, 2, 1, &stats);
    CHECK(stats.extended > 0);
    for (i = 0; i < node_count(&l); i++) {
        double p[3];
        node_at(&l, i, p);
        /* cells at the hull clamp to their own range widened: a linear field stays within it */
        if (a[i] == a[i]) off += fabs((double)a[i] - linear_at(p)) > 1e-5;
    }
    CHECK_EQ_U64(off, 0);
    for (z = 0; z + 1 < n[2]; z++)
        for (y = 0; y + 1 < n[1]; y++)
            for (x = 0; x + 1 < n[0]; x++) { /* a lattice cell that meets the inside of the mesh has all its nodes */
                int meets = 1, whole = 1;
                const uint32_t c[3] = {x, y, z};
                for (k = 0; k < 3; k++)
                    meets &= -0.81 + (c[k] + 1) * 0.37 > 1e-9 && -0.81 + c[k] * 0.37 < 5 - 1e-9;
                for (k = 0; k < 8; k++) {
                    const float v = a[(z + (k >> 2)) * n[0] * n[1] + (y + (k >> 1 & 1u)) * n[0] + x + (k & 1u)];
                    whole &= v == v;
                }
                lonely += meets && !whole;
            }
    CHECK_EQ_U64(lonely, 0);
    free(a);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* ---- exact clipping: the integral of a linear function over the part of a tetrahedron in a box ---- */

typedef struct part { double p[4][3], s[4]; } part;

static double part_volume(const part *t) {
    double e[3][3];
    int i, k;
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++) e[i][k] = t->p[i + 1][k] - t->p[0][k];
    return fabs(e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
                e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0])) / 6;
}

static void part_cut(const part *t, int a, int b, double at, int axis, double p[3], double *s) {
    const double x = (at - t->p[a][axis]) / (t->p[b][axis] - t->p[a][axis]);
    int k;
    for (k = 0; k < 3; k++) p[k] = t->p[a][k] + (t->p[b][k] - t->p[a][k]) * x;
    *s = t->s[a] + (t->s[b] - t->s[a]) * x;
}

/* Cut by six half spaces, one after the other; parts stay tetrahedra. */
static double part_integral(const part *t, const double lo[3], const double hi[3], int plane, double *volume) {
    int in[4], out[4], ni = 0, no = 0, i, k, j;
    double sum = 0;
    if (plane == 6) {
        const double v = part_volume(t);
        *volume += v;
        return v * 0.25 * (t->s[0] + t->s[1] + t->s[2] + t->s[3]);
    }
    {
        const int axis = plane / 2;
        const double at = plane % 2 ? hi[axis] : lo[axis];
        part q;
        double p[4][3], s[4];
        for (i = 0; i < 4; i++) {
            const int inner = plane % 2 ? t->p[i][axis] <= at : t->p[i][axis] >= at;
            if (inner) in[ni++] = i;
            else out[no++] = i;
        }
        if (ni == 0) return 0;
        if (no == 0) return part_integral(t, lo, hi, plane + 1, volume);
        q = *t;
        if (ni == 1) {
            for (k = 0; k < 3; k++) part_cut(t, in[0], out[k], at, axis, q.p[out[k]], &q.s[out[k]]);
            return part_integral(&q, lo, hi, plane + 1, volume);
        }
        if (ni == 3) { /* a prism: in 0 1 2 and the cuts c0 c1 c2 */
            for (k = 0; k < 3; k++) part_cut(t, in[k], out[0], at, axis, p[k], &s[k]);
            for (j = 0; j < 3; j++) { /* (i0..ij, cj..c2) */
                for (k = 0; k < 4; k++) {
                    const double *from = k <= j ? t->p[in[k]] : p[k - 1];
                    memcpy(q.p[k], from, sizeof q.p[k]);
                    q.s[k] = k <= j ? t->s[in[k]] : s[k - 1];
                }
                sum += part_integral(&q, lo, hi, plane + 1, volume);
            }
            return sum;
        }
        /* in a, b; cuts ac, ad, bc, bd: a prism of the triangles a ac ad and b bc bd */
        for (k = 0; k < 4; k++) part_cut(t, in[k / 2], out[k % 2], at, axis, p[k], &s[k]);
        for (j = 0; j < 3; j++) {
            const double *one[3], *two[3];
            double so[3], st[3];
            one[0] = t->p[in[0]]; one[1] = p[0]; one[2] = p[1];
            two[0] = t->p[in[1]]; two[1] = p[2]; two[2] = p[3];
            so[0] = t->s[in[0]]; so[1] = s[0]; so[2] = s[1];
            st[0] = t->s[in[1]]; st[1] = s[2]; st[2] = s[3];
            for (k = 0; k < 4; k++) {
                memcpy(q.p[k], k <= j ? one[k] : two[k - 1], sizeof q.p[k]);
                q.s[k] = k <= j ? so[k] : st[k - 1];
            }
            sum += part_integral(&q, lo, hi, plane + 1, volume);
        }
        return sum;
    }
}

/* Averages over the boxes around the nodes by exact clipping keep the integral; values at the nodes come near to it. */
TEST(resample_keeps_the_integral) {
    tets m;
    tetcast_mesh *mesh;
    tetcast_lattice l;
    float *a;
    size_t c, i;
    double whole = 0, boxes = 0, volume = 0, sampled = 0, cell;
    uint32_t k;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 5, 5, 5, 6, NULL);
    tets_jitter(&m, 5, 5, 5, 0.3, 9);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    memset(&l, 0, sizeof l);
    for (k = 0; k < 3; k++) {
        l.dims[k] = 16;
        l.spacing[k] = 0.25;
        l.origin[k] = 0.125;
    }
    cell = 0.25 * 0.25 * 0.25;
    for (c = 0; c < m.nt; c++) {
        part t;
        uint32_t v;
        double none = 0;
        for (v = 0; v < 4; v++) {
            memcpy(t.p[v], m.p + 3 * (size_t)m.t[4 * c + v], sizeof t.p[v]);
            t.s[v] = (double)m.s[m.t[4 * c + v]];
        }
        whole += part_volume(&t) * 0.25 * (t.s[0] + t.s[1] + t.s[2] + t.s[3]);
        for (i = 0; i < node_count(&l); i++) {
            double p[3], lo[3], hi[3];
            int apart = 0, axis;
            node_at(&l, i, p);
            for (axis = 0; axis < 3; axis++) {
                double least = 1e9, most = -1e9;
                lo[axis] = p[axis] - 0.125;
                hi[axis] = p[axis] + 0.125;
                for (v = 0; v < 4; v++) {
                    least = t.p[v][axis] < least ? t.p[v][axis] : least;
                    most = t.p[v][axis] > most ? t.p[v][axis] : most;
                }
                apart |= least >= hi[axis] || most <= lo[axis];
            }
            if (!apart) boxes += part_integral(&t, lo, hi, 0, &none);
        }
        volume += none;
    }
    CHECK_NEAR(volume, 64.0, 64e-9);
    CHECK_NEAR(boxes, whole, 1e-6 * whole);
    a = resample(mesh, &l, TETCAST_ISA_AUTO, 0, 1, 0, NULL);
    for (i = 0; i < node_count(&l); i++) sampled += (double)a[i] * cell;
    CHECK_NEAR(sampled, whole, 2e-3 * whole);
    free(a);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* The library's means over boxes: box by box those of the oracle, least and most at corners of the cut cells, the integral;
   boxes that are larger and smaller than cells, lattices that hold only a part, any number of threads. */
TEST(means_of_boxes) {
    static const double spacings[4] = {0.21, 0.47, 1.3, 6.0};
    int round;
    for (round = 0; round < 4; round++) {
        tets m;
        tetcast_mesh *mesh;
        tetcast_lattice l;
        tetcast_means out;
        tetcast_env env;
        size_t i, n, c, wrong = 0, empty = 0;
        double whole = 0, sum = 0, off = 0, rough = 0;
        float *v, *w;
        uint32_t k;
        memset(&m, 0, sizeof m);
        memset(&l, 0, sizeof l);
        memset(&env, 0, sizeof env);
        tets_lattice(&m, 4, 3, 4, 6, NULL);
        tets_jitter(&m, 4, 3, 4, 0.6, (uint64_t)round + 40);
        for (i = 0; i < m.nv; i++) m.s[i] = (float)sin(3.0 * (double)i);
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        for (k = 0; k < 3; k++) {
            l.spacing[k] = spacings[round] * (1.0 + 0.1 * k);
            l.dims[k] = round == 3 ? 1 : (uint32_t)(5.0 / l.spacing[k]) + 1;
            l.origin[k] = round == 1 ? 0.9 : round == 3 ? 1.7 : -0.37; /* 1: the mesh goes on beyond the lattice */
        }
        n = node_count(&l);
        v = (float *)malloc(8 * n * sizeof *v);
        REQUIRE(v != NULL);
        w = v + 4 * n;
        memset(v, 0, 8 * n * sizeof *v);
        for (k = 0; k < 2; k++) {
            float *to = k == 0 ? v : w;
            out.mean = to;
            out.least = to + n;
            out.most = to + 2 * n;
            out.share = to + 3 * n;
            env.thread_count = k == 0 ? 1 : 3;
            CHECK_EQ_U64(tetcast_resample_mean(&env, mesh, &l, &out), TETCAST_OK);
        }
        CHECK_MSG(memcmp(v, w, 4 * n * sizeof *v) == 0, "threads change bits");
        for (i = 0; i < n; i++) {
            double p[3], lo[3], hi[3], filled = 0, integral = 0;
            float least = 1e9f, most = -1e9f;
            node_at(&l, i, p);
            for (k = 0; k < 3; k++) {
                lo[k] = p[k] - 0.5 * l.spacing[k];
                hi[k] = p[k] + 0.5 * l.spacing[k];
            }
            for (c = 0; c < m.nt; c++) {
                part t;
                double had = filled;
                uint32_t q;
                for (q = 0; q < 4; q++) {
                    memcpy(t.p[q], m.p + 3 * (size_t)m.t[4 * c + q], sizeof t.p[q]);
                    t.s[q] = (double)m.s[m.t[4 * c + q]];
                }
                integral += part_integral(&t, lo, hi, 0, &filled);
                for (q = 0; q < 4 && filled > had; q++) { /* no more than the cells have */
                    least = (float)t.s[q] < least ? (float)t.s[q] : least;
                    most = (float)t.s[q] > most ? (float)t.s[q] : most;
                }
            }
            whole += integral;
            filled /= l.spacing[0] * l.spacing[1] * l.spacing[2];
            if (v[i] == v[i]) sum += (double)v[i] * (double)v[3 * n + i] * l.spacing[0] * l.spacing[1] * l.spacing[2];
            off = fmax(off, fabs(filled - (double)v[3 * n + i]));
            if (!(filled > 1e-9)) {
                empty += filled == 0.0;
                continue;
            }
            wrong += !(v[i] == v[i]) || !(v[n + i] <= v[i] && v[i] <= v[2 * n + i]) || !(v[n + i] >= least && v[2 * n + i] <= most);
            rough = fmax(rough, fabs(integral / (filled * l.spacing[0] * l.spacing[1] * l.spacing[2]) - (double)v[i]));
        }
        CHECK_EQ_U64(wrong, 0);
        CHECK_MSG(off < 1e-6, "share off by %g", off);
        CHECK_MSG(rough < 1e-5, "mean off by %g", rough);
        CHECK_NEAR(sum, whole, 1e-6 * (fabs(whole) + 1.0));
        if (round == 0) CHECK(empty > 0);
        if (round == 3) CHECK_NEAR((double)v[3], 18.0 / (6.0 * 6.6 * 7.2), 1e-6); /* one box around everything */
        out.mean = NULL;
        CHECK_EQ_U64(tetcast_resample_mean(&env, mesh, &l, &out), TETCAST_ERR_INVALID_ARG);
        free(v);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

TEST(resample_bad_cells) { /* slivers, flat and turned cells, repeated vertices, a hole, a value that is no number */
    tets m;
    tetcast_mesh *mesh;
    tetcast_lattice l;
    tetcast_resample_stats stats;
    tetcast_report report;
    float *a, *b;
    size_t i, bad = 0;
    uint32_t k;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 4, 4, 4, 6, NULL);
    k = tets_vertex(&m, 1.5, 1.5, 1.5 + 1e-9, 0.5);
    tets_tet(&m, 0, 5, 10, k);
    tets_tet(&m, 0, 1, 2, 3);       /* on a line */
    tets_tet(&m, 0, 1, 4, 5);       /* in a plane */
    tets_tet(&m, 0, 21, 42, 42);
    m.s[63] = (float)NAN;
    mesh = tets_build(&m, TETCAST_CELLS_TET16, &report);
    REQUIRE(mesh != NULL);
    CHECK(report.repeated >= 1);
    CHECK_EQ_U64(tetcast_lattice_fit(mesh, 40, &l), TETCAST_OK);
    a = resample(mesh, &l, TETCAST_ISA_SCALAR, 0, 1, 1, &stats);
    b = resample(mesh, &l, TETCAST_ISA_AUTO, 0, 3, 1, NULL);
    CHECK(memcmp(a, b, node_count(&l) * 4) == 0);
    CHECK(stats.flat >= 2);
    for (i = 0; i < node_count(&l); i++) bad += a[i] == a[i] && !(fabsf(a[i]) <= 3.0f);
    CHECK_EQ_U64(bad, 0);
    free(a);
    free(b);
    /* errors */
    l.spacing[1] = 0;
    CHECK_EQ_U64(tetcast_resample(NULL, mesh, &l, m.s, NULL), TETCAST_ERR_INVALID_ARG);
    l.spacing[1] = (double)NAN;
    CHECK_EQ_U64(tetcast_resample(NULL, mesh, &l, m.s, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_lattice_fit(mesh, 1, &l), TETCAST_ERR_INVALID_ARG);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* Planes: samples, section polygons and brute force agree; the area is that of the cut cube. */
/* The baselines slice by slice: the nodes of the scanline resampler but for those that lie in faces, and its values. */
TEST(slice_by_slice) {
    int method, kind;
    for (kind = 0; kind < 3; kind++) {
        tets t;
        tetcast_mesh *mesh;
        tetcast_lattice l;
        float *want, *got;
        size_t n, i, differ = 0, covered = 0;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, 4, kind == 0 ? 5 : 4, 3, kind == 2 ? 5 : 6, NULL);
        if (kind != 0) tets_jitter(&t, 4, 4, 3, 0.2, 4);
        make_linear(&t);
        mesh = tets_build(&t, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL && tetcast_lattice_fit(mesh, kind == 2 ? 40 : 23, &l) == TETCAST_OK);
        if (kind != 0) for (i = 0; i < 3; i++) l.origin[i] += 0.37 * l.spacing[i]; /* no node in a face */
        n = node_count(&l);
        want = resample(mesh, &l, TETCAST_ISA_SCALAR, 0, 1, 0, NULL);
        got = (float *)malloc(n * 4);
        for (method = 0; method < 2; method++) {
            slices_stats st;
            double worst = 0.0;
            CHECK(slices_resample(mesh, &l, (slices_method)method, got, &st));
            for (i = differ = covered = 0; i < n; i++) {
                covered += want[i] == want[i];
                if ((want[i] == want[i]) != (got[i] == got[i])) differ++;
                else if (want[i] == want[i]) worst = fmax(worst, fabs((double)want[i] - (double)got[i]));
            }
            CHECK_MSG(worst < 2e-6, "%d %d: %g", kind, method, worst);
            /* nodes on the hull: the lowest layer has cells only above it */
            CHECK_MSG(kind == 0 ? differ * 8 < covered : differ == 0, "%d %d: %lu of %lu", kind, method, (unsigned long)differ,
                      (unsigned long)covered);
            CHECK(st.pieces > 0 && st.written >= covered - differ && (method == 1 || st.scanned > st.written));
        }
        free(want);
        free(got);
        tetcast_mesh_destroy(mesh);
        tets_free(&t);
    }
}

/* Slices of different distance: what they count for along a ray. */
TEST(slices_of_levels) {
    enum { N = 4096 };
    static uint8_t level[N];
    static uint32_t ways[N];
    test_rng r = test_rng_make(9);
    double off[4] = {0, 0, 0, 0};
    int pass, rule;
    size_t i;
    for (pass = 0; pass < 40; pass++) {
        uint32_t k = test_rng_below(&r, 3), left = 0;
        for (i = 0; i < N; i++) { /* bricks of 4 and more slots, levels up to 2, the ends on the finest */
            if (left == 0) {
                left = 4 + test_rng_below(&r, 30);
                k = k == 1 ? 2 * test_rng_below(&r, 2) : 1;
            }
            left--;
            level[i] = (uint8_t)(i < 8 || i >= N - 8 ? 0 : i < 16 || i >= N - 16 ? (k < 1 ? k : 1) : k);
        }
        for (i = 1; i < N; i++) if (level[i] > level[i - 1] + 1) level[i] = (uint8_t)(level[i - 1] + 1);
        for (rule = 0; rule < 4; rule++) {
            long sum = -(long)N;
            opacity_slots((opacity_rule)rule, level, N, ways);
            for (i = 0; i < N; i++) sum += (long)ways[i];
            off[rule] += fabs((double)sum) / 40.0;
        }
    }
    CHECK_MSG(off[OPACITY_REPAIRED] == 0.0 && off[OPACITY_EXACT] == 0.0, "repaired: %g slots", off[OPACITY_REPAIRED]);
    CHECK_MSG(off[OPACITY_NAIVE] > 2.0 && off[OPACITY_MISPRINT] > 2.0 * off[OPACITY_NAIVE], "%g, misprint %g", off[OPACITY_NAIVE],
              off[OPACITY_MISPRINT]);
}

TEST(planes_and_sections) {
    tets m;
    tetcast_mesh *mesh;
    test_rng r = test_rng_make(3);
    int round;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 4, 4, 4, 5, NULL);
    tets_jitter(&m, 4, 4, 4, 0.7, 8);
    make_linear(&m);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    for (round = 0; round < 6; round++) {
        enum { W = 24, H = 20 };
        static float out[W * H];
        tetcast_plane plane;
        tetcast_section cut;
        size_t i, wrong = 0, c;
        double off = 0;
        int k;
        for (k = 0; k < 3; k++) {
            plane.u[k] = 4 * (test_rng_double(&r) - 0.5);
            plane.v[k] = 4 * (test_rng_double(&r) - 0.5);
            plane.origin[k] = 1.5 + 0.3 * test_rng_double(&r) - 0.5 * plane.u[k] - 0.5 * plane.v[k];
        }
        if (round == 0) { /* through the vertices of a side of cells, parallel to the axes */
            memset(&plane, 0, sizeof plane);
            plane.u[0] = plane.v[1] = 3;
        }
        CHECK_EQ_U64(tetcast_plane_sample(NULL, mesh, &plane, W, H, out), TETCAST_OK);
        for (i = 0; i < W * H; i++) {
            double p[3], v, least = -1e9;
            for (k = 0; k < 3; k++)
                p[k] = plane.origin[k] + ((double)(i % W) + 0.5) / W * plane.u[k] + ((double)(i / W) + 0.5) / H * plane.v[k];
            for (c = 0; c < m.nt; c++) {
                const double at = inside(&m, c, p, &v);
                least = at > least ? at : least;
            }
            if (least > -1e-7 && least < 1e-9 && round != 0) continue;
            wrong += (least >= -1e-9) != (out[i] == out[i]);
            if (out[i] == out[i] && fabs((double)out[i] - linear_at(p)) > off) off = fabs((double)out[i] - linear_at(p));
        }
        CHECK_EQ_U64(wrong, 0);
        CHECK_MSG(off < 3e-5, "%g", off);
        CHECK_EQ_U64(tetcast_plane_section(NULL, mesh, &plane, &cut), TETCAST_OK);
        if (round == 0) CHECK_NEAR(cut.area, 9.0, 1e-9);
        for (i = 0; i < cut.point_count; i++)
            if (fabs((double)cut.values[i] - linear_at(cut.points[i])) > off)
                off = fabs((double)cut.values[i] - linear_at(cut.points[i]));
        CHECK_MSG(off < 3e-5, "%g", off);
        CHECK_EQ_U64(cut.first[cut.polygon_count], cut.point_count);
        tetcast_section_free(&cut);
        tetcast_section_free(&cut);
    }
    { /* a slanted plane through the whole cube: x + y + z = 4.5 cuts [0,3]^3 in a regular hexagon of side 1.5 sqrt 2 */
        tetcast_plane plane;
        tetcast_section cut;
        memset(&plane, 0, sizeof plane);
        plane.origin[0] = 4.5;
        plane.u[0] = -1; plane.u[1] = 1;
        plane.v[0] = -1; plane.v[2] = 1;
        CHECK_EQ_U64(tetcast_plane_section(NULL, mesh, &plane, &cut), TETCAST_OK);
        CHECK_NEAR(cut.area, 1.5 * sqrt(3.0) * 4.5, 1e-5);
        tetcast_section_free(&cut);
        {
            tetcast_section cleared;
            tetcast_env env;
            memset(&cleared, 0, sizeof cleared);
            memset(&env, 0, sizeof env);
            for (env.memory_limit = 1; env.memory_limit < 4000; env.memory_limit += 600) { /* nothing of it is left */
                CHECK_EQ_U64(tetcast_plane_section(&env, mesh, &plane, &cut), TETCAST_ERR_NO_MEMORY);
                CHECK(memcmp(&cut, &cleared, sizeof cut) == 0);
            }
        }
        memset(plane.v, 0, sizeof plane.v);
        CHECK_EQ_U64(tetcast_plane_section(NULL, mesh, &plane, &cut), TETCAST_ERR_INVALID_ARG);
    }
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

enum { VIEW_W = 40, VIEW_H = 30 };

/* A picture of a plane in the mesh against rays that meet it: what is in no tetrahedron is not seen. */
static void check_plane_view(const tets *m, const tetcast_plane *plane, const tetcast_camera *cam, const float *out, const float *depth, int round) {
    size_t i, c, wrong = 0, seen = 0;
    double off = 0, deep = 0, n[3], forward[3], length = 0;
    int k;
    for (k = 0; k < 3; k++) {
        n[k] = plane->u[(k + 1) % 3] * plane->v[(k + 2) % 3] - plane->u[(k + 2) % 3] * plane->v[(k + 1) % 3];
        forward[k] = cam->at[k] - cam->eye[k];
        length += forward[k] * forward[k];
    }
    for (i = 0; i < VIEW_W * VIEW_H; i++) {
        tetcast_ray ray;
        double p[3], v, least = -1e9, t, up = 0, along = 0, z = 0;
        CHECK(tetcast_camera_ray(cam, VIEW_W, VIEW_H, (double)(i % VIEW_W) + 0.5, (double)(i / VIEW_W) + 0.5, &ray) == TETCAST_OK);
        for (k = 0; k < 3; k++) {
            up += n[k] * (plane->origin[k] - ray.org[k]);
            along += n[k] * ray.dir[k];
            z += ray.dir[k] * forward[k] / sqrt(length);
        }
        t = up / along;
        for (k = 0; k < 3; k++) p[k] = ray.org[k] + t * ray.dir[k];
        for (c = 0; c < m->nt && (t > 0 || cam->ortho_height > 0); c++) {
            const double at = inside(m, c, p, &v);
            least = at > least ? at : least;
        }
        if (least > -1e-6 && least < 1e-9) continue;
        wrong += (least >= -1e-9) != (out[i] == out[i]) || (out[i] == out[i]) != (depth[i] < 1e30f);
        if (!(out[i] == out[i])) continue;
        seen++;
        off = fmax(off, fabs((double)out[i] - linear_at(p)));
        deep = fmax(deep, fabs((double)depth[i] - t * z));
    }
    CHECK_MSG(wrong == 0, "round %d: %lu wrong", round, (unsigned long)wrong);
    CHECK_MSG(off < 3e-5 && deep < 3e-5, "round %d: %g %g", round, off, deep);
    if (round % 3 == 1) CHECK_MSG(seen > 0, "round %d", round);
}

/* A plane as a camera sees it: each pixel is what a ray finds in the cells where it meets the plane; and how deep. */
TEST(planes_in_perspective) {
    static float out[VIEW_W * VIEW_H], depth[VIEW_W * VIEW_H];
    tets m;
    tetcast_mesh *mesh;
    test_rng r = test_rng_make(31);
    int round;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 4, 4, 4, 5, NULL);
    tets_jitter(&m, 4, 4, 4, 0.7, 8);
    make_linear(&m);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    for (round = 0; round < 12; round++) {
        tetcast_plane plane;
        tetcast_camera cam;
        int k;
        memset(&cam, 0, sizeof cam);
        for (k = 0; k < 3; k++) {
            plane.u[k] = 4 * (test_rng_double(&r) - 0.5);
            plane.v[k] = 4 * (test_rng_double(&r) - 0.5);
            plane.origin[k] = 2.0 + 0.3 * test_rng_double(&r);
            cam.eye[k] = round % 3 == 0 ? 1.7 + test_rng_double(&r) : 12 * (test_rng_double(&r) - 0.5); /* 0, 3, ..: inside */
            cam.at[k] = 2.0 + test_rng_double(&r);
        }
        cam.fov_y = round % 2 ? 100.0f : 40.0f;
        if (round % 4 == 2) cam.ortho_height = 5.0f;
        CHECK_EQ_U64(tetcast_plane_view(NULL, mesh, &plane, &cam, VIEW_W, VIEW_H, out, depth), TETCAST_OK);
        check_plane_view(&m, &plane, &cam, out, depth, round);
    }
    for (round = 0; round < 2000; round++) { /* just above the plane: what is seen is in the mesh, also at the horizon */
        tetcast_plane plane;
        tetcast_camera cam;
        size_t i, wrong = 0;
        uint32_t k;
        memset(&plane, 0, sizeof plane);
        memset(&cam, 0, sizeof cam);
        for (k = 0; k < 3; k++) {
            cam.at[k] = 4 * test_rng_double(&r);
            cam.eye[k] = 4 * test_rng_double(&r);
            plane.v[k] = test_rng_double(&r) - 0.5;
        }
        for (k = 0; k < 3; k++) {
            plane.u[k] = cam.at[k] - cam.eye[k];
            plane.origin[k] = cam.eye[k] + pow(0.1, 14 + round % 6) * (test_rng_double(&r) - 0.5);
        }
        CHECK_EQ_U64(tetcast_plane_view(NULL, mesh, &plane, &cam, 9, 7, out, depth), TETCAST_OK);
        for (i = 0; i < 63; i++) wrong += (out[i] == out[i]) != (depth[i] > 0 && depth[i] < 9);
        CHECK_MSG(wrong == 0, "round %d: %lu wrong", round, (unsigned long)wrong);
    }
    { /* along the plane nothing is seen; bad arguments */
        tetcast_plane plane;
        tetcast_camera cam;
        size_t i, seen = 0;
        memset(&plane, 0, sizeof plane);
        memset(&cam, 0, sizeof cam);
        plane.u[0] = plane.v[1] = 1;
        plane.origin[2] = 1;
        cam.eye[2] = 1;
        cam.eye[0] = -3;
        cam.at[0] = cam.at[2] = 1;
        CHECK_EQ_U64(tetcast_plane_view(NULL, mesh, &plane, &cam, VIEW_W, VIEW_H, out, NULL), TETCAST_OK);
        for (i = 0; i < VIEW_W * VIEW_H; i++) seen += out[i] == out[i];
        CHECK_EQ_U64(seen, 0);
        cam.fov_y = 190;
        CHECK_EQ_U64(tetcast_plane_view(NULL, mesh, &plane, &cam, VIEW_W, VIEW_H, out, NULL), TETCAST_ERR_INVALID_ARG);
    }
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* ---- bricks -------------------------------------------------------------------------------------------------- */

static const tetcast_type g_types[4] = {TETCAST_TYPE_F32, TETCAST_TYPE_F16, TETCAST_TYPE_U16, TETCAST_TYPE_U8};

static float *random_grid(const tetcast_lattice *l, uint64_t seed) {
    test_rng r = test_rng_make(seed);
    float *v = (float *)malloc(node_count(l) * 4);
    size_t i;
    for (i = 0; i < node_count(l); i++) v[i] = test_rng_float(&r);
    return v;
}

static tetcast_lattice cube_lattice(uint32_t nx, uint32_t ny, uint32_t nz) {
    tetcast_lattice l;
    uint32_t k;
    memset(&l, 0, sizeof l);
    l.dims[0] = nx;
    l.dims[1] = ny;
    l.dims[2] = nz;
    for (k = 0; k < 3; k++) l.spacing[k] = 1.0;
    return l;
}

static tetcast_bricks *make_bricks(const tetcast_lattice *l, const float *v, tetcast_type type, uint32_t log,
                                   float max_error) {
    tetcast_bricks_desc d;
    tetcast_bricks *b = NULL;
    tetcast_array a;
    memset(&d, 0, sizeof d);
    memset(&a, 0, sizeof a);
    a.data = v;
    d.env.thread_count = 2;
    d.storage = type;
    d.log_cells = log;
    d.max_error = max_error;
    CHECK_EQ_U64(tetcast_bricks_create_grid(&d, l, &a, NULL, &b), TETCAST_OK);
    return b;
}

static tetcast_cut *make_cut(const tetcast_bricks *b, const uint8_t *levels, uint32_t jump) {
    tetcast_cut_desc d;
    tetcast_cut *c = NULL;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 2;
    d.levels = levels;
    d.max_jump = jump;
    CHECK_EQ_U64(tetcast_cut_create(&d, b, &c), TETCAST_OK);
    return c;
}

/* Trilinear in the nodes, in double. */
static double grid_at(const tetcast_lattice *l, const float *v, double x, double y, double z) {
    const double p[3] = {x, y, z};
    uint32_t n[3], k;
    double f[3], sum = 0;
    for (k = 0; k < 3; k++) {
        n[k] = (uint32_t)p[k];
        if (n[k] > 0 && n[k] + 1 >= l->dims[k]) n[k] = l->dims[k] - 2;
        f[k] = p[k] - n[k];
    }
    for (k = 0; k < 8; k++) {
        const uint32_t i = n[0] + (k & 1u), j = n[1] + (k >> 1 & 1u), m = n[2] + (k >> 2);
        const double w = ((k & 1u) ? f[0] : 1 - f[0]) * ((k >> 1 & 1u) ? f[1] : 1 - f[1]) * ((k >> 2) ? f[2] : 1 - f[2]);
        if (w > 0) sum += w * (double)v[i + (size_t)l->dims[0] * (j + (size_t)l->dims[1] * m)];
    }
    return sum;
}

TEST(bricks_sample_the_grid) {
    static const uint32_t dims[5][3] = {{40, 33, 17}, {1, 40, 20}, {2, 2, 2}, {1, 1, 1}, {65, 9, 18}};
    int shape, type;
    for (shape = 0; shape < 5; shape++)
        for (type = 0; type < 4; type++) {
            enum { N = 500 };
            static float x[N], y[N], z[N], a[N], b[N], slope[N][3];
            const tetcast_lattice l = cube_lattice(dims[shape][0], dims[shape][1], dims[shape][2]);
            float *v = random_grid(&l, 3);
            tetcast_bricks *k = make_bricks(&l, v, g_types[type], 3, 0);
            tetcast_cut *c = make_cut(k, NULL, 0);
            test_rng r = test_rng_make(4);
            double worst = 0;
            size_t i;
            for (i = 0; i < N; i++) {
                x[i] = test_rng_float(&r) * (float)(dims[shape][0] - 1);
                y[i] = test_rng_float(&r) * (float)(dims[shape][1] - 1);
                z[i] = test_rng_float(&r) * (float)(dims[shape][2] - 1);
                if (i % 5 == 0) x[i] = (float)(int)x[i];
                if (i % 7 == 0) y[i] = (float)(dims[shape][1] - 1);
            }
            tetcast_cut_sample(c, x, y, z, N, TETCAST_ISA_SCALAR, a);
            tetcast_cut_sample(c, x, y, z, N, TETCAST_ISA_AUTO, b);
            CHECK(memcmp(a, b, sizeof a) == 0);
            tetcast_cut_gradient(c, x, y, z, N, b, slope);
            CHECK(memcmp(a, b, sizeof a) == 0);
            for (i = 0; i < N; i++) {
                const double e = fabs((double)a[i] - grid_at(&l, v, (double)x[i], (double)y[i], (double)z[i]));
                worst = e > worst || e != e ? e : worst;
            }
            CHECK_MSG(worst < (type == 0 ? 1e-5 : type == 1 ? 3e-4 : type == 2 ? 2e-5 : 2.1e-3), "%d %d %g", shape, type, worst);
            tetcast_cut_destroy(c);
            tetcast_bricks_destroy(k);
            free(v);
        }
}

/* Nodes that are no numbers are counted and become the smallest value, alone or all of them. */
TEST(bad_grids) {
    const tetcast_lattice l = cube_lattice(20, 11, 9);
    float *v = random_grid(&l, 8);
    int kind;
    for (kind = 0; kind < 3; kind++) { /* 1: some, 2: all */
        tetcast_bricks_desc d;
        tetcast_bricks_report report;
        tetcast_bricks_info info;
        tetcast_bricks *b = NULL;
        tetcast_cut *c;
        tetcast_array a;
        float least = 1e9f;
        size_t i, bad = 0, wrong = 0;
        memset(&d, 0, sizeof d);
        memset(&a, 0, sizeof a);
        d.storage = TETCAST_TYPE_F32;
        d.log_cells = 3;
        for (i = 0; i < node_count(&l); i++) {
            if (kind == 2 || (kind == 1 && i % 37 == 5)) v[i] = i % 3 == 0 ? (float)NAN : i % 3 == 1 ? INFINITY : -INFINITY;
            if (v[i] - v[i] == 0.0f) least = v[i] < least ? v[i] : least;
            else bad++;
        }
        a.data = v;
        CHECK_EQ_U64(tetcast_bricks_create_grid(&d, &l, &a, &report, &b), TETCAST_OK);
        REQUIRE(b != NULL);
        CHECK_EQ_U64(report.bad_values, bad);
        CHECK(kind == 0 ? bad == 0 : bad > 50);
        tetcast_bricks_get_info(b, &info);
        c = make_cut(b, NULL, 0);
        for (i = 0; i < node_count(&l); i++) {
            const float x = (float)(i % 20), y = (float)(i / 20 % 11), z = (float)(i / 220);
            float got;
            tetcast_cut_sample(c, &x, &y, &z, 1, TETCAST_ISA_AUTO, &got);
            wrong += got != (v[i] - v[i] == 0.0f ? v[i] : kind == 2 ? info.value_min : least);
        }
        CHECK_EQ_U64(wrong, 0);
        CHECK(info.value_min - info.value_min == 0.0f && info.value_max >= info.value_min);
        tetcast_cut_destroy(c);
        tetcast_bricks_destroy(b);
    }
    free(v);
}

/* The largest jump over the borders between slots: values on both sides of each face, a little away from it, and on
   edges and corners. */
static double largest_jump(const tetcast_bricks *b, const tetcast_cut *c, uint64_t seed, int count) {
    tetcast_bricks_info info;
    test_rng r = test_rng_make(seed);
    double worst = 0;
    int i;
    tetcast_bricks_get_info(b, &info);
    for (i = 0; i < count; i++) {
        const float gap = 1.0f / 8192.0f;
        float p[3], x[8], y[8], z[8], v[8];
        int k, j, on = 0;
        double lo = 1e9, hi = -1e9;
        for (k = 0; k < 3; k++) {
            const uint32_t slots = info.slots[k];
            p[k] = test_rng_float(&r) * (float)(info.lattice.dims[k] - 1);
            if (slots > 1 && (test_rng_below(&r, 3) == 0 || (k == 2 && on == 0))) {
                p[k] = (float)((1 + test_rng_below(&r, slots - 1)) * info.cells);
                on |= 1 << k;
            }
        }
        for (j = 0; j < 8; j++) {
            x[j] = p[0] + (on & 1 ? (j & 1 ? gap : -gap) : 0.0f);
            y[j] = p[1] + (on & 2 ? (j & 2 ? gap : -gap) : 0.0f);
            z[j] = p[2] + (on & 4 ? (j & 4 ? gap : -gap) : 0.0f);
        }
        tetcast_cut_sample(c, x, y, z, 8, TETCAST_ISA_AUTO, v);
        for (j = 0; j < 8; j++) {
            lo = (double)v[j] < lo ? (double)v[j] : lo;
            hi = (double)v[j] > hi ? (double)v[j] : hi;
        }
        worst = hi - lo > worst ? hi - lo : worst;
    }
    return worst;
}

/* Exactly on the border from both sides: the nodes of the brick below it, and what is sampled there (which is of the one
   above). Values a step of 2^-13 away differ by the slope, at most 1 a cell on level 0: so the gap bounds the jump. */
TEST(bricks_are_continuous) {
    int log, type, round;
    for (log = 3; log <= 5; log++)
        for (type = 0; type < (log == 3 ? 4 : 1); type++) {
            const uint32_t n = log == 3 ? 64 : log == 4 ? 128 : 96;
            const tetcast_lattice l = cube_lattice(n + 1, n / 2 + 1, n / 2 + 3);
            float *v = random_grid(&l, 5);
            tetcast_bricks *b = make_bricks(&l, v, g_types[type], (uint32_t)log, 0);
            tetcast_bricks_info info;
            tetcast_bricks_get_info(b, &info);
            for (round = 0; round < (test_quick() ? 2 : 5); round++) {
                const size_t slots = (size_t)info.slots[0] * info.slots[1] * info.slots[2];
                uint8_t *levels = (uint8_t *)malloc(slots);
                test_rng r = test_rng_make((uint64_t)(10 * log + round));
                tetcast_cut *c;
                tetcast_cut_info ci;
                double jump;
                size_t i;
                for (i = 0; i < slots; i++) levels[i] = (uint8_t)test_rng_below(&r, round == 0 ? 2 : info.levels);
                c = make_cut(b, levels, 0);
                tetcast_cut_get_info(c, &ci);
                CHECK(ci.adapted > 0);
                CHECK(memcmp(tetcast_cut_levels(c), levels, slots) == 0);
                jump = largest_jump(b, c, (uint64_t)round, 3000);
                CHECK_MSG(jump < 6.0 / 8192.0, "log %d type %d round %d: %g", log, type, round, jump);
                tetcast_cut_destroy(c);
                free(levels);
            }
            tetcast_bricks_destroy(b);
            free(v);
        }
}

/* The same without the slope: nodes of the border from both sides. Both bricks' own interpolants, read by hand, in single
   precision: 1e-6 of the range. Without the edge and corner neighbours, or fine before coarse, this has to fail. */
static double border_gap(const tetcast_cut *cut, uint64_t seed, int count) {
    const tetcast_bricks *b = cut->bricks;
    test_rng r = test_rng_make(seed);
    double worst = 0;
    int i;
    for (i = 0; i < count; i++) {
        float first = 0.0f;
        uint32_t s[3], on = 0, k, n, seen = 0;
        float p[3];
        for (k = 0; k < 3; k++) {
            s[k] = test_rng_below(&r, b->slots[k]);
            p[k] = ((float)s[k] + test_rng_float(&r)) * (float)(1u << b->log);
            if (s[k] + 1 < b->slots[k] && (test_rng_u32(&r) & 1u)) {
                p[k] = (float)((s[k] + 1) << b->log);
                on |= 1u << k;
            }
            if (p[k] > (float)(b->lattice.dims[k] - 1)) p[k] = (float)(b->lattice.dims[k] - 1);
        }
        for (n = 0; n < 8; n++) { /* the same point in all slots that it belongs to */
            uint32_t word, level, type, m[3], a, ok = 1;
            const uint8_t *block;
            float f[3], v[8], x;
            size_t node = 0;
            if ((n & ~on) != 0) continue;
            word = cut->slot[(s[0] + (n & 1u)) + (size_t)b->slots[0] * ((s[1] + (n >> 1 & 1u)) + (size_t)b->slots[1] * (s[2] + (n >> 2)))];
            level = word >> TETCASTI_LEVEL_SHIFT & 15u;
            block = tetcasti_slot_block(cut, word, &type);
            for (a = 3; a-- > 0;) {
                const uint32_t slot = s[a] + (n >> a & 1u);
                const float u = (p[a] - (float)(slot >> level << level << b->log)) / (float)(1u << level);
                m[a] = (uint32_t)u;
                if (m[a] >= (1u << b->log)) m[a] = (1u << b->log) - 1;
                f[a] = u - (float)m[a];
                ok &= f[a] >= 0.0f && f[a] <= 1.0f;
                node = node * b->side + m[a];
            }
            CHECK(ok);
            for (a = 0; a < 8; a++)
                v[a] = tetcasti_block_get(b, block, type, node + (a & 1u) + b->side * ((a >> 1 & 1u) + (size_t)b->side * (a >> 2)));
            x = tetcasti_trilinear(v, f);
            if (!seen) first = x;
            seen = 1;
            if (fabs((double)x - (double)first) > worst) worst = fabs((double)x - (double)first);
        }
    }
    return worst;
}

/* Borders once more, in a way that is wrong: 0 fine before coarse, 1 only from the six neighbours at faces, coarse before fine. */
static void adapt_wrongly(tetcast_cut *cut, int kind) {
    static const uint8_t faces[6] = {4, 10, 12, 14, 16, 22};
    const tetcast_bricks *b = cut->bricks;
    const uint32_t cells = 1u << b->log;
    uint32_t i;
    for (i = 0; i < cut->adapted_count; i++) memcpy(cut->adapted + i * b->nodes, tetcasti_brick_block(b, cut->source[i]), b->nodes * 4);
    for (i = 0; i < cut->adapted_count; i++) { /* their numbers go up with the level */
        uint32_t number = kind == 0 ? i : cut->adapted_count - 1 - i;
        const tetcasti_brick *brick = &b->brick[cut->source[number]];
        const uint32_t k = brick->level, size = 1u << k;
        uint32_t j, n, a, first[3];
        if (kind == 0) {
            tetcasti_adapt t;
            memset(&t, 0, sizeof t);
            t.cut = cut;
            t.list = &number;
            tetcasti_task_adapt(&t, 0);
            continue;
        }
        for (a = 0; a < 3; a++) first[a] = brick->place[a] << k << b->log;
        for (j = 0; j < size * size * size; j++)
            for (n = 0; n < 6; n++) {
                const uint32_t s[3] = {(brick->place[0] << k) + j % size, (brick->place[1] << k) + j / size % size, (brick->place[2] << k) + j / size / size};
                const uint32_t d[3] = {faces[n] % 3u, faces[n] / 3u % 3u, faces[n] / 9u};
                uint32_t o[3], r0[3], r1[3], start[3], ko;
                size_t there;
                for (a = 0; a < 3; a++) o[a] = s[a] + d[a] - 1;
                for (a = 0; a < 3; a++) if (s[a] >= b->slots[a] || o[a] >= b->slots[a]) break;
                if (a < 3 || cut->level[s[0] + (size_t)b->slots[0] * (s[1] + (size_t)b->slots[1] * s[2])] != k) continue;
                there = o[0] + (size_t)b->slots[0] * (o[1] + (size_t)b->slots[1] * o[2]);
                ko = cut->level[there];
                if (ko <= k) continue;
                for (a = 0; a < 3; a++) {
                    const uint32_t p0 = (s[a] << b->log) + (d[a] == 2 ? cells : 0), p1 = (s[a] << b->log) + (d[a] == 0 ? 0 : cells);
                    r0[a] = (p0 - first[a]) >> k;
                    r1[a] = (p1 - first[a] + size - 1) >> k;
                    start[a] = o[a] >> ko << ko << b->log;
                }
                tetcasti_border_copy(cut, cut->adapted + (size_t)number * b->nodes, cut->slot[there], r0, r1, first, k, start, ko);
            }
    }
}

TEST(borders_agree) {
    int log, type, round;
    for (log = 3; log <= 5; log++)
        for (type = 0; type < 4; type++) {
            const uint32_t n = log == 5 ? 128 : 100;
            const tetcast_lattice l = cube_lattice(n + 1, n / 2 + 1, n / 2 + 4);
            float *v = random_grid(&l, 6);
            tetcast_bricks *b = make_bricks(&l, v, g_types[type], (uint32_t)log, 0);
            tetcast_bricks_info info;
            tetcast_bricks_get_info(b, &info);
            for (round = 0; round < (test_quick() ? 2 : 4); round++) {
                const size_t slots = (size_t)info.slots[0] * info.slots[1] * info.slots[2];
                uint8_t *levels = (uint8_t *)malloc(slots);
                test_rng r = test_rng_make((uint64_t)(20 * log + round));
                tetcast_cut *c;
                double gap;
                size_t i;
                for (i = 0; i < slots; i++) levels[i] = (uint8_t)test_rng_below(&r, round == 0 ? 2 : info.levels);
                c = make_cut(b, levels, 0);
                gap = border_gap(c, (uint64_t)round, 4000);
                CHECK_MSG(gap < 4.9e-7, "log %d type %d round %d: %g", log, type, round, gap); /* 4 units in the last place of 1 */
                if (round == 1 && type == 0 && log == 3) { /* controls: what is left out or done in another order is seen */
                    adapt_wrongly(c, 0);
                    CHECK(border_gap(c, 1, 4000) > 0.1);
                    adapt_wrongly(c, 1);
                    CHECK(border_gap(c, 1, 4000) > 0.1);
                }
                if (round == 1) { /* control: with the bricks as they are it is large */
                    for (i = 0; i < slots; i++)
                        c->slot[i] = (c->slot[i] & TETCASTI_ADAPTED ? c->source[c->slot[i] & TETCASTI_SLOT_MASK]
                                                                    : c->slot[i] & TETCASTI_SLOT_MASK) |
                                     (uint32_t)levels[i] << TETCASTI_LEVEL_SHIFT;
                    CHECK(border_gap(c, 1, 4000) > 0.1);
                }
                tetcast_cut_destroy(c);
                free(levels);
            }
            tetcast_bricks_destroy(b);
            free(v);
        }
}

/* A linear field is the same on all levels; a constant one too; the filter keeps both up to the sides of the lattice. */
/* What a slot may show is what it can show: no more, or empty space is walked through; no less, or something is left out. */
/* Largest jump of the gradient at borders of slots, as a share of what it changes by in a cell of the coarser level there,
   corner to corner; only where levels differ, or do not. *count: how many were seen. */
static double gradient_jump(const tetcast_bricks *b, const uint8_t *levels, double bend, int differ, size_t *count) {
    tetcast_cut *cut = make_cut(b, levels, 0);
    const uint8_t *shown = tetcast_cut_levels(cut);
    test_rng r = test_rng_make(77);
    double worst = 0;
    int i;
    for (i = 0; i < 6000; i++) {
        const uint32_t a = test_rng_u32(&r) % 3, slot[3] = {test_rng_u32(&r) % 7, test_rng_u32(&r) % 7, test_rng_u32(&r) % 7};
        float x[3], got[2], g[2][3];
        uint32_t k, level[2], size;
        for (k = 0; k < 3; k++) x[k] = (float)(8 * slot[k]) + 0.3f + 7.4f * test_rng_float(&r);
        for (k = 0; k < 2; k++) {
            uint32_t at[3] = {slot[0], slot[1], slot[2]};
            at[a] += k;
            x[a] = (float)(8 * slot[a] + 8) + (k == 0 ? -1e-3f : 1e-3f);
            level[k] = shown[at[0] + 8 * (at[1] + 8 * at[2])];
            tetcast_cut_gradient(cut, x, x + 1, x + 2, 1, &got[k], &g[k]);
        }
        if ((level[0] != level[1]) != differ) continue;
        size = 1u << (level[0] > level[1] ? level[0] : level[1]);
        for (k = 0; k < 3; k++) worst = fmax(worst, fabs((double)g[0][k] - (double)g[1][k]) / (bend * size));
        ++*count;
    }
    tetcast_cut_destroy(cut);
    return worst;
}

/* Gradients jump where levels meet, since one layer of nodes moved: by no more than they change in a cell of the coarser
   level where all levels lie on the field; where coarser levels are smoothed what that takes away comes on top, three halves. */
TEST(gradients_at_borders) {
    const tetcast_lattice l = cube_lattice(65, 65, 65);
    float *v = (float *)malloc(node_count(&l) * sizeof *v);
    const double bend = 0.11 * 0.11 + 0.11 * 0.09; /* second derivatives in x and xy; those in z are smaller */
    uint8_t levels[512], same[512];
    size_t i;
    uint32_t nearest;
    REQUIRE(v != NULL);
    for (i = 0; i < node_count(&l); i++) {
        const double x = (double)(i % 65), y = (double)(i / 65 % 65), z = (double)(i / 65 / 65);
        v[i] = (float)(sin(0.11 * x) * cos(0.09 * y) + sin(0.13 * z));
    }
    for (i = 0; i < 512; i++) {
        levels[i] = (uint8_t)((i & 1) != 0 ? 0 : (i >> 4 & 1) != 0 ? 2 : 1);
        same[i] = 1;
    }
    for (nearest = 0; nearest < 2; nearest++) {
        tetcast_bricks_desc d;
        tetcast_bricks *b = NULL;
        tetcast_array a;
        tetcast_lattice unit = l;
        size_t count[2] = {0, 0};
        double inner, border;
        uint32_t k;
        memset(&d, 0, sizeof d);
        memset(&a, 0, sizeof a);
        for (k = 0; k < 3; k++) unit.spacing[k] = 1;
        a.data = v;
        d.storage = TETCAST_TYPE_F32;
        d.log_cells = 3;
        d.nearest = nearest;
        CHECK_EQ_U64(tetcast_bricks_create_grid(&d, &unit, &a, NULL, &b), TETCAST_OK);
        REQUIRE(b != NULL);
        inner = gradient_jump(b, same, bend, 0, &count[0]);
        border = gradient_jump(b, levels, bend, 1, &count[1]);
        CHECK(count[0] == 6000 && count[1] > 1500);
        CHECK_MSG(inner > 0.1 && inner <= 1.0, "inside of a level %g", inner);
        CHECK_MSG(border > inner && border <= (nearest ? 1.0 : 1.5), "at borders %g, inside of a level %g", border, inner);
        tetcast_bricks_destroy(b);
    }
    free(v);
}

/* A moving focus, frame after frame: nothing leaks, and a cut is what it would be without the frames before. */
TEST(moving_focus) {
    const int frames = test_quick() ? 2000 : 100000;
    const tetcast_lattice l = cube_lattice(33, 25, 17);
    float *v = random_grid(&l, 5);
    tetcast_bricks *b;
    tetcast_bricks_info info;
    test_alloc ta;
    test_rng r = test_rng_make(8);
    uint64_t bits[16] = {0}, jumps = 0;
    int frame;
    test_alloc_init(&ta);
    b = make_bricks(&l, v, TETCAST_TYPE_U8, 3, 0);
    tetcast_bricks_get_info(b, &info);
    for (frame = 0; frame < frames; frame++) {
        enum { P = 24 };
        tetcast_cut_desc d;
        tetcast_cut *cut = NULL;
        float x[P], y[P], z[P], out[P];
        const uint32_t place = test_rng_u32(&r) % 16;
        size_t i;
        uint32_t k;
        uint64_t sum;
        memset(&d, 0, sizeof d);
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        d.env.thread_count = 1;
        for (k = 0; k < 3; k++) d.focus[k] = l.spacing[k] * (double)((place * (3 + 4 * k)) % 16) / 15.0 * (double)(l.dims[k] - 1);
        d.focus_radius = 4 + place % 5;
        d.max_jump = place % 2;
        CHECK_EQ_U64(tetcast_cut_create(&d, b, &cut), TETCAST_OK);
        REQUIRE(cut != NULL);
        for (i = 0; i < P; i += 2) { /* both sides of borders of slots, the same places each time */
            const uint32_t a = (uint32_t)(i / 2) % 3;
            x[i] = 1.7f + 1.1f * (float)i;
            y[i] = 2.3f + 0.8f * (float)i;
            z[i] = 0.9f + 0.6f * (float)i;
            (a == 0 ? x : a == 1 ? y : z)[i] = 8.0f;
            x[i + 1] = x[i];
            y[i + 1] = y[i];
            z[i + 1] = z[i];
            (a == 0 ? x : a == 1 ? y : z)[i] -= 1e-5f;
        }
        tetcast_cut_sample(cut, x, y, z, P, TETCAST_ISA_AUTO, out);
        for (i = 0; i < P; i += 2) jumps += fabs((double)out[i] - (double)out[i + 1]) > 1e-4;
        sum = test_fnv1a(out, sizeof out, test_fnv1a(tetcast_cut_levels(cut), (size_t)info.slots[0] * info.slots[1] * info.slots[2], 0));
        if (bits[place] == 0) bits[place] = sum;
        if (bits[place] != sum) {
            CHECK_MSG(0, "frame %d differs from the first at place %u", frame, place);
            tetcast_cut_destroy(cut);
            break;
        }
        tetcast_cut_destroy(cut);
    }
    CHECK_EQ_U64(jumps, 0);
    CHECK(bits[0] != bits[1]);
    test_alloc_check(&ta);
    tetcast_bricks_destroy(b);
    free(v);
}

TEST(levels_beyond) { /* no finer than a level that is not there: the coarsest, with a focus as well */
    static const uint32_t levels[6] = {4, 5, 255, 256, 257, 0xffffff00u};
    tetcast_lattice l = cube_lattice(65, 33, 33);
    float *v = random_grid(&l, 4);
    tetcast_bricks *b = make_bricks(&l, v, TETCAST_TYPE_F32, 4, 0);
    int k;
    for (k = 0; k < 12; k++) {
        tetcast_cut_desc d;
        tetcast_cut_info info;
        tetcast_cut *cut = NULL;
        memset(&d, 0, sizeof d);
        d.level = levels[k / 2];
        d.focus_radius = k % 2 ? 1e9 : 0.0;
        REQUIRE(tetcast_cut_create(&d, b, &cut) == TETCAST_OK);
        tetcast_cut_get_info(cut, &info);
        CHECK_EQ_U64(info.level_slots[4], 4 * 2 * 2);
        tetcast_cut_destroy(cut);
    }
    tetcast_bricks_destroy(b);
    free(v);
}

TEST(ranges_of_slots) {
    enum { SIDE = 65 };
    static const tetcast_type types[3] = {TETCAST_TYPE_F32, TETCAST_TYPE_F16, TETCAST_TYPE_U8};
    static float v[SIDE * SIDE * SIDE];
    test_rng r = test_rng_make(44);
    int t, pass;
    size_t i;
    for (i = 0; i < sizeof v / sizeof v[0]; i++) v[i] = i % SIDE < 40 ? 0.0f : test_rng_float(&r);
    for (t = 0; t < 3; t++) {
        tetcast_bricks_desc d;
        tetcast_bricks *b = NULL;
        tetcast_lattice l;
        tetcast_array a;
        memset(&d, 0, sizeof d);
        memset(&l, 0, sizeof l);
        memset(&a, 0, sizeof a);
        for (i = 0; i < 3; i++) {
            l.dims[i] = SIDE;
            l.spacing[i] = 1.0;
        }
        a.data = v;
        d.storage = types[t];
        d.log_cells = 3;
        REQUIRE(tetcast_bricks_create_grid(&d, &l, &a, NULL, &b) == TETCAST_OK);
        for (pass = 0; pass < 4; pass++) {
            uint8_t levels[512];
            tetcast_cut_desc cd;
            tetcast_cut *cut = NULL;
            uint32_t slot, k, empty = 0;
            memset(&cd, 0, sizeof cd);
            for (slot = 0; slot < 512; slot++)
                levels[slot] = pass == 0 ? 2 : pass == 1 ? (uint8_t)(slot % 8 < 4) : (uint8_t)test_rng_below(&r, 4);
            cd.levels = levels;
            REQUIRE(tetcast_cut_create(&cd, b, &cut) == TETCAST_OK);
            for (slot = 0; slot < 512; slot++) {
                float lo = 1e30f, hi = -1e30f;
                for (k = 0; k < 60 + 729; k++) { /* random places, and all nodes of the finest level */
                    float x[3], got;
                    const uint32_t n = k - 60;
                    for (i = 0; i < 3; i++) {
                        const uint32_t base = 8 * (i == 0 ? slot % 8 : i == 1 ? slot / 8 % 8 : slot / 64);
                        x[i] = (float)base + (k < 60 ? 8.0f * test_rng_float(&r) : (float)(i == 0 ? n % 9 : i == 1 ? n / 9 % 9 : n / 81));
                    }
                    tetcast_cut_sample(cut, x, x + 1, x + 2, 1, TETCAST_ISA_SCALAR, &got);
                    lo = got < lo ? got : lo;
                    hi = got > hi ? got : hi;
                }
                CHECK_MSG(lo >= cut->range[slot][0] - 1e-6f && hi <= cut->range[slot][1] + 1e-6f, "slot %u: %g %g in %g %g", slot, (double)lo,
                          (double)hi, (double)cut->range[slot][0], (double)cut->range[slot][1]);
                /* nodes of all levels are nodes of the finest; a border node may only be seen by the neighbour */
                CHECK_MSG(lo <= cut->range[slot][0] + 1e-5f && hi >= cut->range[slot][1] - 1e-5f, "slot %u of level %u: %g %g is less than %g %g",
                          slot, levels[slot], (double)lo, (double)hi, (double)cut->range[slot][0], (double)cut->range[slot][1]);
                empty += cut->range[slot][1] < 1e-6f;
            }
            if (pass == 1) CHECK_MSG(empty == 256, "%u", empty); /* the four columns left of x = 32, below coarse ones or not */
            tetcast_cut_destroy(cut);
        }
        tetcast_bricks_destroy(b);
    }
}

/* The budget that a time asks for: a model of frames that take 20 ms and 300 ms for all samples. */
TEST(pace) {
    tetcast_cut_info info;
    double target;
    int k;
    memset(&info, 0, sizeof info);
    CHECK(tetcast_cut_pace(NULL, 1.0, 1.0) == 1.0 && tetcast_cut_pace(&info, 1.0, 1.0) == 1.0);
    for (target = 0.05; target < 0.5; target *= 1.3) {
        double seconds = 0.0, next = 1.0;
        for (k = 0; k < 12; k++) {
            info.samples = next;
            seconds = 0.02 + 0.3 * info.samples;
            next = tetcast_cut_pace(&info, seconds, target);
            CHECK(next > 0.0 && next <= 1.0);
            if (next == info.samples) break;
        }
        CHECK_MSG(k < 12 && seconds <= target && (seconds >= 0.85 * target || info.samples == 1.0), "%g: %g after %d", target, seconds, k);
    }
    info.samples = 0.5;
    CHECK(tetcast_cut_pace(&info, 1e9, 1e-9) == 0.125); /* one step at most by four */
    CHECK(tetcast_cut_pace(&info, 0.0, 1.0) == 1.0 && tetcast_cut_pace(&info, 1.0, -1.0) == 1.0);
    for (k = 0; k < 4; k++) { /* no cut has these, and a budget comes out all the same */
        static const double samples[4] = {7.0, (double)INFINITY, 1e-300, (double)NAN};
        info.samples = samples[k];
        CHECK(tetcast_cut_pace(&info, 0.95, 1.0) == (k == 2 ? 1.0 / 32.0 : 1.0));
        CHECK(tetcast_cut_pace(&info, 1.0, 1.0) == (k == 2 ? 1.0 / 32.0 : 1.0));
    }
    info.samples = 0.5;
    CHECK(tetcast_cut_pace(&info, (double)INFINITY, (double)INFINITY) == 1.0);
}

TEST(levels_keep_linear_fields) {
    const tetcast_lattice l = cube_lattice(37, 50, 23);
    float *v = (float *)malloc(node_count(&l) * 4);
    uint32_t nearest, level;
    size_t i;
    for (i = 0; i < node_count(&l); i++) {
        double p[3];
        node_at(&l, i, p);
        v[i] = (float)linear_at(p);
    }
    for (nearest = 0; nearest < 2; nearest++) {
        tetcast_bricks_desc d;
        tetcast_bricks *b = NULL;
        tetcast_array a;
        memset(&d, 0, sizeof d);
        memset(&a, 0, sizeof a);
        a.data = v;
        d.nearest = nearest;
        REQUIRE(tetcast_bricks_create_grid(&d, &l, &a, NULL, &b) == TETCAST_OK);
        for (level = 0; level < 5; level++) {
            tetcast_cut_desc cd;
            tetcast_cut *c = NULL;
            tetcast_cut_info ci;
            test_rng r = test_rng_make(level);
            double worst = 0, slope = 0;
            memset(&cd, 0, sizeof cd);
            cd.level = level;
            REQUIRE(tetcast_cut_create(&cd, b, &c) == TETCAST_OK);
            tetcast_cut_get_info(c, &ci);
            CHECK_NEAR(ci.error, 0, 6e-5); /* values reach 40 */
            CHECK_NEAR(ci.samples, 1.0 / (1 << level), 1e-12);
            for (i = 0; i < 400; i++) {
                const float x = 36 * test_rng_float(&r), y = 49 * test_rng_float(&r), z = 22 * test_rng_float(&r);
                const double p[3] = {(double)x, (double)y, (double)z};
                float s, g[3];
                tetcast_cut_gradient(c, &x, &y, &z, 1, &s, &g);
                worst = fabs((double)s - linear_at(p)) > worst ? fabs((double)s - linear_at(p)) : worst;
                slope = fabs((double)g[1] + 0.7) > slope ? fabs((double)g[1] + 0.7) : slope;
            }
            CHECK_MSG(worst < 2e-5, "level %u: %g", level, worst);
            CHECK_MSG(slope < 4e-5, "level %u: %g", level, slope);
            tetcast_cut_destroy(c);
        }
        tetcast_bricks_destroy(b);
    }
    free(v);
}

/* What is stored as the error of a brick is no less than what is found; with max_error nothing is above it. */
TEST(errors_are_bounds) {
    const tetcast_lattice l = cube_lattice(65, 65, 65);
    float *v = (float *)malloc(node_count(&l) * 4);
    size_t i;
    int round;
    for (i = 0; i < node_count(&l); i++) {
        double p[3];
        node_at(&l, i, p);
        v[i] = (float)(tanh((p[0] - 30) / 3) + 0.3 * sin(p[1] / 9) * cos(p[2] / 7));
    }
    for (round = 0; round < 3; round++) {
        tetcast_bricks *b = make_bricks(&l, v, TETCAST_TYPE_F32, 3, round == 0 ? 0.0f : 0.02f * (float)round);
        tetcast_bricks_info info;
        tetcast_cut_desc d;
        tetcast_cut *c = NULL;
        tetcast_cut_info ci;
        double worst = 0;
        tetcast_bricks_get_info(b, &info);
        memset(&d, 0, sizeof d);
        if (round == 0) d.byte_budget = 9 * 9 * 9 * 4 * 60;
        REQUIRE(tetcast_cut_create(&d, b, &c) == TETCAST_OK);
        tetcast_cut_get_info(c, &ci);
        if (round == 0) CHECK(ci.bytes <= d.byte_budget);
        if (round != 0) CHECK_MSG(info.bricks < 480, "%d", (int)info.bricks); /* of 585 */
        for (i = 0; i < node_count(&l); i++) {
            const float x = (float)(i % 65), y = (float)(i / 65 % 65), z = (float)(i / 65 / 65);
            float s;
            tetcast_cut_sample(c, &x, &y, &z, 1, TETCAST_ISA_SCALAR, &s);
            worst = fabs((double)s - (double)v[i]) > worst ? fabs((double)s - (double)v[i]) : worst;
        }
        CHECK_MSG(worst <= (double)ci.error + 1e-6, "%g above %g", worst, (double)ci.error);
        if (round != 0) CHECK_MSG(worst <= 0.02 * round + 1e-6, "%g", worst);
        tetcast_cut_destroy(c);
        /* levels by distance, neighbours by at most one */
        memset(&d, 0, sizeof d);
        d.focus_radius = 9;
        d.max_jump = 1;
        REQUIRE(tetcast_cut_create(&d, b, &c) == TETCAST_OK);
        if (round == 0) {
            const uint8_t *level = tetcast_cut_levels(c);
            uint32_t x, y, z, wide = 0;
            for (z = 0; z + 1 < 8; z++)
                for (y = 0; y < 8; y++)
                    for (x = 0; x + 1 < 8; x++) wide += abs((int)level[x + 8 * (y + 8 * z)] - (int)level[x + 1 + 8 * (y + 8 * (z + 1))]) > 1;
            CHECK_EQ_U64(wide, 0);
            CHECK_EQ_U64(level[0], 0);
            CHECK(level[511] >= 2);
        }
        CHECK(border_gap(c, 3, 3000) < 2e-6);
        tetcast_cut_destroy(c);
        tetcast_bricks_destroy(b);
    }
    free(v);
}

TEST(bricks_of_a_mesh) {
    tets m;
    tetcast_mesh *mesh;
    tetcast_bricks_desc d;
    tetcast_bricks_report report;
    tetcast_bricks *b = NULL;
    tetcast_bricks *two = NULL;
    size_t i;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 9, 8, 10, 6, NULL);
    tets_jitter(&m, 9, 8, 10, 0.4, 3);
    for (i = 0; i < m.nv; i++) m.s[i] = (float)sin(0.6 * m.p[3 * i]) + (float)cos(0.5 * m.p[3 * i + 1]);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    memset(&d, 0, sizeof d);
    d.max_error = 0.05f;
    d.checks = 20000;
    d.log_cells = 3;
    d.env.thread_count = 1;
    REQUIRE(tetcast_bricks_create_mesh(&d, mesh, &report, &b) == TETCAST_OK);
    CHECK_EQ_U64(report.above, 0);
    CHECK(report.error <= 0.05 && report.error > 0);
    d.env.thread_count = 3;
    REQUIRE(tetcast_bricks_create_mesh(&d, mesh, NULL, &two) == TETCAST_OK);
    {
        const size_t size = tetcast_bricks_file_size(b);
        uint8_t *p = (uint8_t *)malloc(size), *q = (uint8_t *)malloc(size);
        REQUIRE(tetcast_bricks_file_size(two) == size);
        CHECK_EQ_U64(tetcast_bricks_write(b, p, size), TETCAST_OK);
        CHECK_EQ_U64(tetcast_bricks_write(two, q, size), TETCAST_OK);
        CHECK(memcmp(p, q, size) == 0);
        free(p);
        free(q);
    }
    tetcast_bricks_destroy(two);
    tetcast_bricks_destroy(b);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* A layer of cells thinner than any spacing: the promise cannot be kept, and the report says so. Where a lattice would have too
   many bricks, the finest that has not is kept. */
TEST(layers_too_thin) {
    int round;
    for (round = 0; round < (test_quick() ? 1 : 2); round++) {
        tets m;
        tetcast_mesh *mesh;
        tetcast_bricks_desc d;
        tetcast_bricks_report report;
        tetcast_bricks_info info;
        tetcast_error error;
        tetcast_bricks *b = NULL;
        size_t i;
        memset(&m, 0, sizeof m);
        memset(&d, 0, sizeof d);
        memset(&error, 0, sizeof error);
        tets_lattice(&m, 9, 9, 9, 6, NULL);
        for (i = 0; i < m.nv; i++) {
            m.s[i] = 0.0f;
            if (m.p[3 * i] == 1.0) m.p[3 * i] = 1e-4;
        }
        m.s[0] = 1.0f; /* at the origin */
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        d.log_cells = 3;
        d.max_error = 0.01f;
        d.checks = 60000;
        d.longest_end = round == 0 ? 65 : 0;
        d.env.error = &error;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_OK);
        REQUIRE(b != NULL);
        tetcast_bricks_get_info(b, &info);
        CHECK_MSG(report.above > 0 && report.above == report.above_finest, "%lu, finest %lu", (unsigned long)report.above,
                  (unsigned long)report.above_finest);
        CHECK(report.error > 0.01 && report.worst[0] < 0.2 && report.worst[1] < 1.01 && report.worst[2] < 1.01);
        CHECK_MSG(info.lattice.dims[0] == (round == 0 ? 65 : 2049), "%u", info.lattice.dims[0]); /* 4097: 2^27 slots */
        CHECK(error.code == TETCAST_OK && error.text[0] == 0);
        tetcast_bricks_destroy(b);
        b = NULL;
        m.s[0] = 0.005f; /* less than what is asked for: nothing to say */
        tetcast_mesh_destroy(mesh);
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        d.longest_end = 65;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_OK);
        CHECK(report.above == 0 && report.above_finest == 0 && report.error <= 0.01);
        tetcast_bricks_destroy(b);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

TEST(meshes_without_values) { /* fields may be missing: all is 0, for lattices, planes and bricks made in both ways */
    tets m;
    tetcast_input in;
    tetcast_field field;
    tetcast_mesh *mesh = NULL;
    tetcast_lattice lattice;
    tetcast_plane plane;
    tetcast_section section;
    tetcast_bricks_desc d;
    float node[9 * 9 * 9], x[3] = {1, 4, 7}, v[3];
    size_t i;
    int way;
    memset(&m, 0, sizeof m);
    memset(&plane, 0, sizeof plane);
    memset(&d, 0, sizeof d);
    tets_lattice(&m, 5, 5, 5, 6, NULL);
    tets_input(&m, &in, &field);
    in.fields = NULL;
    in.field_count = 0;
    REQUIRE(tetcast_mesh_create(NULL, &in, NULL, &mesh) == TETCAST_OK);
    REQUIRE(tetcast_lattice_fit(mesh, 9, &lattice) == TETCAST_OK && lattice.dims[0] == 9);
    CHECK_EQ_U64(tetcast_resample(NULL, mesh, &lattice, node, NULL), TETCAST_OK);
    for (i = 0; i < 9 * 9 * 9; i++) CHECK(node[i] == 0.0f);
    plane.origin[2] = 1.5;
    plane.u[0] = plane.v[1] = 4;
    CHECK_EQ_U64(tetcast_plane_section(NULL, mesh, &plane, &section), TETCAST_OK);
    CHECK(section.polygon_count > 16 && section.values[3] == 0.0f);
    tetcast_section_free(&section);
    for (way = 0; way < 3; way++) {
        tetcast_bricks *b = NULL;
        tetcast_bricks_info info;
        tetcast_bricks_report report;
        tetcast_cut *cut = NULL;
        d.log_cells = 3;
        d.longest = way == 0 ? 9 : 0;
        d.max_error = 0.1f;
        d.longest_end = 17;
        d.storage = way == 2 ? TETCAST_TYPE_U8 : TETCAST_TYPE_F32;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_OK);
        REQUIRE(b != NULL);
        tetcast_bricks_get_info(b, &info);
        CHECK(info.value_min == 0.0f && info.value_max == 0.0f && report.error == 0 && report.above == 0);
        REQUIRE(tetcast_cut_create(NULL, b, &cut) == TETCAST_OK);
        tetcast_cut_sample(cut, x, x, x, 3, TETCAST_ISA_AUTO, v);
        for (i = 0; i < 3; i++) CHECK(v[i] == 0.0f);
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(b);
    }
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* Bricks on demand: fine only around a point, there as good as bricks that are fine everywhere; means instead of values. */
/* What shows nothing has no value to be off from: a vertex without a value, or of masked cells only. */
TEST(bricks_around_bad_values) {
    int k;
    for (k = 0; k < 3; k++) {
        tets m;
        tetcast_mesh *mesh = NULL;
        tetcast_mesh_desc md;
        tetcast_input in;
        tetcast_field field;
        tetcast_bricks_desc d;
        tetcast_bricks_report report;
        tetcast_bricks_info info;
        tetcast_bricks *b = NULL;
        uint8_t masks[6 * 512];
        size_t i;
        memset(&m, 0, sizeof m);
        memset(&md, 0, sizeof md);
        memset(&in, 0, sizeof in);
        memset(&field, 0, sizeof field);
        memset(&d, 0, sizeof d);
        memset(masks, 0, sizeof masks);
        tets_lattice(&m, 9, 9, 9, 6, NULL);
        for (i = 0; i < m.nv; i++) m.s[i] = 5.0f + 0.1f * (float)m.p[3 * i];
        if (k == 1) m.s[4 * 81 + 4 * 9 + 4] = (float)NAN;
        if (k == 2) { /* a value that no cell shows */
            m.s[4 * 81 + 4 * 9 + 4] = 1000.0f;
            for (i = 0; i < m.nt; i++) {
                const uint32_t *t = m.t + 4 * i, at = 4 * 81 + 4 * 9 + 4;
                masks[i] = t[0] == at || t[1] == at || t[2] == at || t[3] == at;
            }
        }
        field.values.data = m.s;
        in.positions.data = m.p;
        in.positions.type = TETCAST_TYPE_F64;
        in.vertex_count = m.nv;
        in.indices = m.t;
        in.index_count = 4 * m.nt;
        in.cell_count = m.nt;
        in.masks = masks;
        in.fields = &field;
        in.field_count = 1;
        REQUIRE(m.nt == sizeof masks && tetcast_mesh_create(&md, &in, NULL, &mesh) == TETCAST_OK);
        d.max_error = 0.05f;
        d.longest_end = 129;
        d.checks = 20000;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_OK);
        tetcast_bricks_get_info(b, &info);
        CHECK_EQ_U64(report.above, 0);
        CHECK_MSG(report.error <= 0.05, "%g", report.error);
        CHECK_EQ_U64(report.tries, 1);
        CHECK(info.bricks < 10);
        tetcast_bricks_destroy(b);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

TEST(bricks_on_demand) {
    enum { N = 4000 };
    static const double points[2][3] = {{1.0, 1.2, 1.1}, {3.1, 2.9, 3.0}};
    tets m;
    tetcast_mesh *mesh;
    tetcast_bricks_desc d;
    tetcast_bricks_report report;
    tetcast_bricks *all = NULL;
    tetcast_bricks_info whole;
    size_t i;
    int round, k;
    memset(&m, 0, sizeof m);
    memset(&d, 0, sizeof d);
    tets_lattice(&m, 5, 5, 5, 6, NULL);
    tets_jitter(&m, 5, 5, 5, 0.4, 12);
    for (i = 0; i < m.nv; i++) m.s[i] = (float)sin(1.7 * (double)(i % 11) + 0.1 * (double)i);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    d.storage = TETCAST_TYPE_F32;
    d.log_cells = 3;
    d.longest = 129;
    d.max_error = 0.01f;
    d.checks = 4000;
    CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &all), TETCAST_OK);
    REQUIRE(all != NULL);
    tetcast_bricks_get_info(all, &whole);
    for (round = 0; round < 2; round++) {
        tetcast_bricks *b = NULL, *again = NULL;
        tetcast_bricks_info info;
        tetcast_cut_desc cd;
        tetcast_cut *cut = NULL;
        test_rng r = test_rng_make((uint64_t)round + 5);
        double worst = 0, beyond = 0;
        memset(&cd, 0, sizeof cd);
        d.focus_radius = cd.focus_radius = 0.4;
        for (k = 0; k < 3; k++) d.focus[k] = cd.focus[k] = points[round][k];
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_OK);
        d.env.thread_count = 3;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &again), TETCAST_OK);
        d.env.thread_count = 0;
        REQUIRE(b != NULL && again != NULL);
        tetcast_bricks_get_info(b, &info);
        CHECK_MSG(info.bricks * 2 < whole.bricks, "%lu of %lu", (unsigned long)info.bricks, (unsigned long)whole.bricks);
        CHECK(info.level_bricks[0] > 0);
        CHECK_EQ_U64(tetcast_bricks_file_size(b), tetcast_bricks_file_size(again));
        CHECK_MSG(report.checks > 0 && report.checks < 4000 + m.nv, "%lu of %lu", (unsigned long)report.checks, 4000 + (unsigned long)m.nv);
        CHECK_EQ_U64(tetcast_cut_create(&cd, b, &cut), TETCAST_OK);
        REQUIRE(cut != NULL);
        for (i = 0; i < N; i++) { /* as far as the finest level reaches, less a brick's diagonal: right; elsewhere not */
            const size_t cell = test_rng_u32(&r) % m.nt;
            double w[4], p[3] = {0, 0, 0}, v = 0, sum = 0, way = 0;
            float x[3], got;
            for (k = 0; k < 4; k++) sum += w[k] = -log(test_rng_double(&r) + 1e-9);
            for (k = 0; k < 4; k++) {
                int a;
                for (a = 0; a < 3; a++) p[a] += w[k] / sum * m.p[3 * (size_t)m.t[4 * cell + (size_t)k] + (size_t)a];
                v += w[k] / sum * (double)m.s[m.t[4 * cell + (size_t)k]];
            }
            for (k = 0; k < 3; k++) {
                x[k] = (float)((p[k] - info.lattice.origin[k]) / info.lattice.spacing[k]);
                way += (p[k] - points[round][k]) * (p[k] - points[round][k]);
            }
            tetcast_cut_sample(cut, x, x + 1, x + 2, 1, TETCAST_ISA_SCALAR, &got);
            if (sqrt(way) < 0.4 - 0.22) worst = fmax(worst, fabs((double)got - v));
            else if (sqrt(way) > 1.6) beyond = fmax(beyond, fabs((double)got - v));
        }
        CHECK_MSG(worst < 0.06, "near the point off by %g", worst); /* what 1/128 of the side can do; all: 0.05 */
        CHECK_MSG(beyond > 0.1, "far from it only %g", beyond);
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(b);
        tetcast_bricks_destroy(again);
    }
    { /* means: a lattice of 9 nodes a side, boxes of half a cell; a constant stays one */
        tetcast_bricks *b = NULL;
        tetcast_bricks_info info;
        d.focus_radius = 0;
        d.average = 1;
        d.longest = 9;
        d.max_error = 0;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_OK);
        REQUIRE(b != NULL);
        tetcast_bricks_get_info(b, &info);
        CHECK(info.value_min > whole.value_min && info.value_max < whole.value_max); /* peaks are smoothed */
        CHECK(info.hull_triangles > 0 && report.checks > 0);
        tetcast_bricks_destroy(b);
        b = NULL;
        d.focus_radius = 1;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_ERR_INVALID_ARG);
        d.focus_radius = 0;
        d.longest = 0;
        CHECK_EQ_U64(tetcast_bricks_create_mesh(&d, mesh, &report, &b), TETCAST_ERR_INVALID_ARG);
    }
    tetcast_bricks_destroy(all);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

TEST(brick_files) {
    const tetcast_lattice l = cube_lattice(20, 11, 9);
    float *v = random_grid(&l, 8);
    int type;
    for (type = 0; type < 4; type++) {
        tetcast_bricks *b = make_bricks(&l, v, g_types[type], 3, 0), *c = NULL;
        const size_t size = tetcast_bricks_file_size(b);
        uint8_t *p = (uint8_t *)malloc(size), *q = (uint8_t *)malloc(size);
        test_rng r = test_rng_make(5);
        tetcast_error error;
        tetcast_env env;
        size_t i;
        memset(&env, 0, sizeof env);
        env.error = &error;
        CHECK_EQ_U64(tetcast_bricks_write(b, p, size - 1), TETCAST_ERR_RANGE);
        CHECK_EQ_U64(tetcast_bricks_write(b, p, size), TETCAST_OK);
        REQUIRE(tetcast_bricks_read(&env, p, size, &c) == TETCAST_OK);
        CHECK_EQ_U64(tetcast_bricks_write(c, q, size), TETCAST_OK);
        CHECK(memcmp(p, q, size) == 0);
        tetcast_bricks_destroy(c);
        for (i = 0; i < size; i += 1 + i / 20) {
            CHECK(tetcast_bricks_read(&env, p, i, &c) != TETCAST_OK);
            CHECK(c == NULL);
        }
        CHECK_EQ_U64(tetcast_bricks_read(&env, p, size - 1, &c), TETCAST_ERR_TRUNCATED);
        for (i = 0; i < 300; i++) { /* any changed bit is found */
            const size_t at = i < 152 ? i : test_rng_below(&r, (uint32_t)size);
            const uint8_t bit = (uint8_t)(1u << test_rng_below(&r, 8));
            if (at >= 116 && at < 120) continue; /* reserved, but under the checksum: still found */
            p[at] ^= bit;
            CHECK(tetcast_bricks_read(&env, p, size, &c) != TETCAST_OK);
            p[at] ^= bit;
        }
        { /* damage with good checksums: refused or harmless, never a crash */
            int n;
            for (n = 0; n < 400; n++) {
                const uint32_t records = 152 + 28 * tetcasti_load_u32(p + 28);
                memcpy(q, p, size);
                q[n % 2 ? 16 + test_rng_below(&r, 100) : 152 + test_rng_below(&r, records - 152)] ^= (uint8_t)(1u << test_rng_below(&r, 8));
                tetcasti_store_u64(q + 128, tetcasti_hash_bytes(1, q + 152, records - 152));
                tetcasti_store_u64(q + 144, tetcasti_hash_bytes(3, q, 144));
                if (tetcast_bricks_read(&env, q, size, &c) == TETCAST_OK) {
                    tetcast_cut *cut = make_cut(c, NULL, 0);
                    const float x = 3.5f;
                    float s;
                    tetcast_cut_sample(cut, &x, &x, &x, 1, TETCAST_ISA_AUTO, &s);
                    tetcast_cut_destroy(cut);
                    tetcast_bricks_destroy(c);
                }
            }
        }
        free(p);
        free(q);
        tetcast_bricks_destroy(b);
    }
    free(v);
}

/* ---- pictures ------------------------------------------------------------------------------------------------ */

static tetcast_optics *flat_optics(float extinction, tetcast_model model) {
    tetcast_control_point p[2];
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    memset(p, 0, sizeof p);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    p[0].value = -10;
    p[1].value = 10;
    p[0].extinction = p[1].extinction = extinction;
    p[0].rgb[0] = p[1].rgb[0] = 1.0f;
    p[0].rgb[2] = 0.5f;
    td.points = p;
    td.point_count = 2;
    od.model = model;
    od.t_min = -1;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &t), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(t, &od, &o), TETCAST_OK);
    tetcast_transfer_destroy(t);
    return o;
}

static void box_view(tetcast_brick_render_desc *d, const tetcast_lattice *l, int kind) {
    double lo[3], hi[3];
    static const double views[4][3] = {{0, 0, 1}, {1, 0.6, 0.4}, {-1, 0.2, -0.3}, {1, 1, 1}};
    int k;
    memset(d, 0, sizeof *d);
    for (k = 0; k < 3; k++) {
        lo[k] = l->origin[k];
        hi[k] = lo[k] + (l->dims[k] - 1) * l->spacing[k];
    }
    d->camera.ortho_height = kind % 2 ? 0.0f : 1.0f;
    CHECK_EQ_U64(tetcast_camera_fit(&d->camera, lo, hi, views[kind % 4], 48, 40), TETCAST_OK);
}

TEST(largest_values) { /* next to 1e38 coarser levels go on beyond the ends, and sums are infinite: what is written can be read all the same */
    static const tetcast_type storage[4] = {TETCAST_TYPE_F32, TETCAST_TYPE_F16, TETCAST_TYPE_U16, TETCAST_TYPE_U8};
    float v[7 * 5 * 4];
    test_rng r = test_rng_make(38);
    int k;
    for (k = 0; k < 40; k++) {
        tetcast_lattice l = {{7, 5, 4}, {0, 0, 0}, {1, 1, 1}};
        tetcast_array values = {v, TETCAST_TYPE_F32, 0};
        tetcast_bricks_desc d;
        tetcast_bricks *b = NULL, *again = NULL;
        tetcast_cut *cut = NULL;
        float x[3][20], s[20];
        uint8_t *p;
        size_t i, size;
        memset(&d, 0, sizeof d);
        d.log_cells = 3 + (uint32_t)k % 2;
        d.storage = storage[k / 2 % 4];
        d.max_error = k % 3 == 0 ? 1e30f : 0;
        for (i = 0; i < sizeof v / sizeof v[0]; i++) v[i] = (test_rng_below(&r, 2) ? 9.99e37f : -9.99e37f) * (k & 8 ? 1.0f : test_rng_float(&r));
        REQUIRE(tetcast_bricks_create_grid(&d, &l, &values, NULL, &b) == TETCAST_OK);
        size = tetcast_bricks_file_size(b);
        p = (uint8_t *)malloc(size);
        REQUIRE(p != NULL);
        CHECK_EQ_U64(tetcast_bricks_write(b, p, size), TETCAST_OK);
        CHECK_EQ_U64(tetcast_bricks_read(NULL, p, size, &again), TETCAST_OK);
        free(p);
        tetcast_bricks_destroy(b);
        REQUIRE(again != NULL && tetcast_cut_create(NULL, again, &cut) == TETCAST_OK);
        for (i = 0; i < 60; i++) x[i / 20][i % 20] = 6 * test_rng_float(&r);
        tetcast_cut_sample(cut, x[0], x[1], x[2], 20, TETCAST_ISA_AUTO, s);
        for (i = 0; i < 20; i++) CHECK(s[i] - s[i] == 0.0f);
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(again);
    }
}

TEST(errors_of_largest_values) { /* sums of eight are beyond floats; errors are not */
    tetcast_lattice l = cube_lattice(33, 33, 33);
    float *v = random_grid(&l, 1);
    int k;
    for (k = 0; k < 2; k++) {
        tetcast_array values = {v, TETCAST_TYPE_F32, 0};
        tetcast_bricks_desc d;
        tetcast_bricks_info info;
        tetcast_bricks *b = NULL;
        size_t i;
        memset(&d, 0, sizeof d);
        d.max_error = 1e30f;
        for (i = 0; i < node_count(&l); i++) v[i] = k == 0 || i < node_count(&l) / 2 ? 9e37f : -9e37f;
        REQUIRE(tetcast_bricks_create_grid(&d, &l, &values, NULL, &b) == TETCAST_OK);
        tetcast_bricks_get_info(b, &info);
        CHECK_EQ_U64(info.bricks, k == 0 ? 1 : 12);
        for (i = 0; i < b->count; i++) CHECK(b->brick[i].level > 1 || b->brick[i].error <= 1.85e38f); /* the jump */
        tetcast_bricks_destroy(b);
    }
    free(v);
}

TEST(values_beyond_in_files) { /* values whose differences are no floats are refused, whatever the checksums say */
    tetcast_lattice l = cube_lattice(9, 9, 9);
    float *v = random_grid(&l, 2);
    int type, k;
    for (type = 0; type < 4; type++)
        for (k = 0; k < 3; k++) {
            tetcast_bricks *b = make_bricks(&l, v, g_types[type], 3, 0), *c = NULL;
            const size_t size = tetcast_bricks_file_size(b);
            const uint32_t end = 152 + 28 * b->count;
            uint8_t *p = (uint8_t *)malloc(size);
            tetcast_error error;
            tetcast_env env;
            memset(&env, 0, sizeof env);
            env.error = &error;
            CHECK_EQ_U64(tetcast_bricks_write(b, p, size), TETCAST_OK);
            tetcast_bricks_destroy(b);
            if (g_types[type] == TETCAST_TYPE_F32) tetcasti_store_f32(p + end + 4 * 77, k == 0 ? 1e38f : k == 1 ? -1.1e38f : 3e38f);
            else if (g_types[type] != TETCAST_TYPE_F16)
                tetcasti_store_f32(p + 100, k == 0 ? 0.0f : (k == 1 ? 1.1e38f : 3e38f) / (g_types[type] == TETCAST_TYPE_U8 ? 255.0f : 65535.0f));
            tetcasti_store_u64(p + 136, tetcasti_hash_bytes(2, p + end, size - end));
            tetcasti_store_u64(p + 144, tetcasti_hash_bytes(3, p, 144));
            if (k == 0 || g_types[type] == TETCAST_TYPE_F16) CHECK_EQ_U64(tetcast_bricks_read(&env, p, size, &c), TETCAST_OK);
            else {
                CHECK_EQ_U64(tetcast_bricks_read(&env, p, size, &c), TETCAST_ERR_FORMAT);
                if (g_types[type] == TETCAST_TYPE_F32) CHECK_EQ_U64(error.where, end + 4 * 77);
            }
            tetcast_bricks_destroy(c);
            free(p);
        }
    free(v);
}

TEST(largest_values_of_meshes) { /* vertices may have any float: bricks of them end at 1e38, and their files can be read */
    static const tetcast_type storage[4] = {TETCAST_TYPE_F32, TETCAST_TYPE_F16, TETCAST_TYPE_U16, TETCAST_TYPE_U8};
    test_rng r = test_rng_make(39);
    int k;
    for (k = 0; k < 24; k++) {
        tets m;
        tetcast_mesh *mesh;
        tetcast_bricks_desc d;
        tetcast_bricks_info info;
        tetcast_bricks *b = NULL, *again = NULL;
        uint8_t *p;
        size_t i, size;
        memset(&m, 0, sizeof m);
        memset(&d, 0, sizeof d);
        tets_lattice(&m, 4, 3, 3, 6, NULL);
        for (i = 0; i < m.nv; i++) m.s[i] = (test_rng_below(&r, 2) ? 3.4e38f : -3.4e38f) * (k & 8 ? test_rng_float(&r) : 1.0f);
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        d.log_cells = 3;
        d.storage = storage[k % 4];
        d.longest = k & 4 ? 9 : 21;
        d.average = k >= 16;
        d.checks = 100;
        REQUIRE(tetcast_bricks_create_mesh(&d, mesh, NULL, &b) == TETCAST_OK);
        tetcast_bricks_get_info(b, &info);
        CHECK(info.value_min >= -1e38f && info.value_max <= 1e38f && info.value_min < info.value_max);
        size = tetcast_bricks_file_size(b);
        p = (uint8_t *)malloc(size);
        REQUIRE(p != NULL && tetcast_bricks_write(b, p, size) == TETCAST_OK);
        CHECK_EQ_U64(tetcast_bricks_read(NULL, p, size, &again), TETCAST_OK);
        free(p);
        tetcast_bricks_destroy(again);
        tetcast_bricks_destroy(b);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
}

/* In a constant medium opacity depends on the length of the way through the box only, whatever the levels are. */
TEST(constant_medium) {
    tetcast_lattice l = cube_lattice(33, 25, 41);
    float *v = random_grid(&l, 2);
    tetcast_bricks *b;
    tetcast_optics *o = flat_optics(0.04f, TETCAST_MODEL_VOLUME);
    tetcast_bricks_info info;
    int round;
    l.spacing[1] = 1.7;
    l.origin[2] = -9;
    b = make_bricks(&l, v, TETCAST_TYPE_F32, 3, 0);
    tetcast_bricks_get_info(b, &info);
    for (round = 0; round < 8; round++) {
        enum { W = 48, H = 40 };
        static float rgba[W * H * 4], length[W * H];
        uint8_t levels[512];
        test_rng r = test_rng_make((uint64_t)round);
        tetcast_brick_render_desc d;
        tetcast_image image;
        tetcast_cut *c;
        double worst = 0, worst_length = 0;
        uint32_t i;
        for (i = 0; i < info.slots[0] * info.slots[1] * info.slots[2]; i++) levels[i] = (uint8_t)test_rng_below(&r, 4);
        c = make_cut(b, levels, 0);
        box_view(&d, &l, round);
        d.step = round < 4 ? 1.0f : 2.7f;
        memset(&image, 0, sizeof image);
        image.width = W;
        image.height = H;
        image.rgba = rgba;
        image.length = length;
        CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_OK);
        for (i = 0; i < W * H; i++) {
            tetcast_ray ray;
            double t0 = 0, t1 = 1e30, way;
            int k;
            (void)tetcast_camera_ray(&d.camera, W, H, i % W + 0.5, i / W + 0.5, &ray);
            for (k = 0; k < 3; k++) {
                const double lo = l.origin[k], hi = lo + (l.dims[k] - 1) * l.spacing[k];
                const double a = (lo - ray.org[k]) / ray.dir[k], e = (hi - ray.org[k]) / ray.dir[k];
                if (fabs(ray.dir[k]) < 1e-14) {
                    if (ray.org[k] < lo || ray.org[k] > hi) t1 = -1;
                    continue;
                }
                t0 = t0 > (a < e ? a : e) ? t0 : (a < e ? a : e);
                t1 = t1 < (a < e ? e : a) ? t1 : (a < e ? e : a);
            }
            way = t1 > t0 ? t1 - t0 : 0;
            worst = fabs((double)rgba[4 * i + 3] - (1 - exp(-(double)0.04f * way))) > worst
                        ? fabs((double)rgba[4 * i + 3] - (1 - exp(-(double)0.04f * way))) : worst;
            worst_length = fabs((double)length[i] - way) > worst_length ? fabs((double)length[i] - way) : worst_length;
        }
        CHECK_MSG(worst <= 1e-5, "round %d: %g", round, worst);
        CHECK_MSG(worst_length <= 1e-4, "round %d: %g", round, worst_length);
        tetcast_cut_destroy(c);
    }
    tetcast_optics_destroy(o);
    tetcast_bricks_destroy(b);
    free(v);
}

static uint64_t picture(const tetcast_brick_render_desc *d, const tetcast_cut *c, const tetcast_optics *o, uint32_t w,
                        uint32_t h, float *rgba) {
    tetcast_image image;
    memset(&image, 0, sizeof image);
    image.width = w;
    image.height = h;
    image.rgba = rgba;
    CHECK_EQ_U64(tetcast_render_bricks(d, c, o, &image, NULL), TETCAST_OK);
    return test_fnv1a(rgba, (size_t)w * h * 16, 0);
}

/* Levels by a share of the samples, by an error, by what is shown: budgets are kept and used, what is hidden stays coarse, and pictures of as
   many bytes come nearer by it. */
TEST(budgets) {
    enum { W = 40, H = 32, SIDE = 65 };
    static float full[W * H * 4], plain[W * H * 4], shown[W * H * 4];
    const tetcast_lattice l = cube_lattice(SIDE, SIDE, SIDE);
    float *v = (float *)malloc(node_count(&l) * 4);
    tetcast_control_point p[3] = {{0.9f, {1, 1, 1}, 0}, {1.1f, {1, 0.5f, 0.2f}, 0.2f}, {3.0f, {0.2f, 0.5f, 1}, 0.4f}};
    tetcast_transfer_desc td;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    tetcast_brick_render_desc rd;
    tetcast_bricks *b;
    tetcast_cut_desc d;
    tetcast_cut *c = NULL;
    tetcast_cut_info info, before;
    double off[2] = {0, 0}, last = 2;
    uint32_t k, slot;
    size_t i;
    REQUIRE(v != NULL);
    for (i = 0; i < node_count(&l); i++) { /* waves: weak ones up to x = 32 are seen, strong ones beyond are below what is shown */
        const double x = (double)(i % SIDE), y = (double)(i / SIDE % SIDE), z = (double)(i / SIDE / SIDE);
        v[i] = (float)(x <= 32 ? 1.5 + 0.3 * sin(0.9 * y) * sin(0.8 * z + 0.2 * x) : -20.0 + 4.0 * sin(1.1 * x) * cos(0.9 * y + z));
    }
    b = make_bricks(&l, v, TETCAST_TYPE_F32, 3, 0);
    memset(&td, 0, sizeof td);
    td.points = p;
    td.point_count = 3;
    REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, NULL, &o) == TETCAST_OK);
    for (k = 0; k < 5; k++) { /* shares of the samples */
        memset(&d, 0, sizeof d);
        d.sample_budget = 1.0 - 0.17 * k;
        REQUIRE(tetcast_cut_create(&d, b, &c) == TETCAST_OK);
        tetcast_cut_get_info(c, &info);
        CHECK_MSG(info.samples <= d.sample_budget + 1e-9 && info.samples > d.sample_budget - 0.05 && info.samples < last, "%g of %g", info.samples,
                  d.sample_budget);
        last = info.samples;
        tetcast_cut_destroy(c);
    }
    memset(&d, 0, sizeof d);
    memset(&before, 0, sizeof before);
    for (k = 0; k < 4; k++) { /* errors: kept where the finest level can, with fewer bytes the larger they are */
        d.byte_budget = UINT64_MAX;
        d.max_error = k == 0 ? 1e-6f : k == 1 ? 0.4f : k == 2 ? 7.0f : 30.0f;
        REQUIRE(tetcast_cut_create(&d, b, &c) == TETCAST_OK);
        tetcast_cut_get_info(c, &info);
        CHECK_MSG(info.error <= d.max_error && (k == 0 || info.bytes < before.bytes), "error %g: %g, %u bytes", (double)d.max_error,
                  (double)info.error, (unsigned)info.bytes);
        before = info;
        tetcast_cut_destroy(c);
    }
    box_view(&rd, &l, 3);
    c = make_cut(b, NULL, 0);
    (void)picture(&rd, c, o, W, H, full);
    tetcast_cut_destroy(c);
    for (k = 0; k < 2; k++) { /* as many bytes without and with what is shown */
        const uint8_t *level;
        memset(&d, 0, sizeof d);
        d.byte_budget = 729 * 4 * 400;
        d.optics = k ? o : NULL;
        REQUIRE(tetcast_cut_create(&d, b, &c) == TETCAST_OK);
        tetcast_cut_get_info(c, &info);
        CHECK(info.bytes <= d.byte_budget);
        level = tetcast_cut_levels(c);
        for (slot = 0; slot < 512 && k; slot++) if (slot % 8 > 5) CHECK(level[slot] > 0); /* cubes of two slots share a brick */
        (void)picture(&rd, c, o, W, H, k ? shown : plain);
        for (i = 0; i < W * H * 4; i++) off[k] += fabs((double)(k ? shown : plain)[i] - (double)full[i]) / (W * H * 4);
        tetcast_cut_destroy(c);
    }
    CHECK_MSG(off[1] < 0.5 * off[0] && off[0] > 1e-4, "%g with what is shown, %g without", off[1], off[0]);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
    free(v);
}

/* Half of a cube: the picture ends at the hull, or goes on to the sides of the lattice. */
TEST(hull_left_out) {
    static float full[256];
    tetcast_brick_render_desc rd;
    tetcast_bricks *b;
    tetcast_cut *c;
    tetcast_optics *o;
    uint32_t k;
    size_t i;
    tets m;
    tetcast_mesh *mesh;
    tetcast_bricks_desc bd;
    double way[2] = {0, 0};
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 5, 5, 5, 6, NULL);
    for (i = 0, k = 0; i < m.nt; i++) { /* cells with a corner in x + y + z <= 6 */
        const uint32_t *q = m.t + 4 * i;
        double least = 99;
        uint32_t j;
        for (j = 0; j < 4; j++) least = fmin(least, m.p[3 * q[j]] + m.p[3 * q[j] + 1] + m.p[3 * q[j] + 2]);
        if (least < 6) {
            memmove(m.t + 4 * k, q, 16);
            k++;
        }
    }
    m.nt = k;
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    memset(&bd, 0, sizeof bd);
    bd.log_cells = 3;
    bd.longest = 17;
    b = NULL;
    REQUIRE(tetcast_bricks_create_mesh(&bd, mesh, NULL, &b) == TETCAST_OK);
    c = make_cut(b, NULL, 0);
    o = flat_optics(0.1f, TETCAST_MODEL_VOLUME);
    for (k = 0; k < 2; k++) {
        tetcast_image image;
        memset(&rd, 0, sizeof rd);
        memset(&image, 0, sizeof image);
        rd.no_hull = k;
        rd.camera.ortho_height = 4.0f;
        rd.camera.eye[0] = rd.camera.at[0] = rd.camera.eye[1] = rd.camera.at[1] = 2;
        rd.camera.eye[2] = 20;
        image.width = image.height = 16;
        image.length = full;
        CHECK_EQ_U64(tetcast_render_bricks(&rd, c, o, &image, NULL), TETCAST_OK);
        for (i = 0; i < 256; i++) way[k] += (double)full[i] * (16.0 / 256.0);
    }
    CHECK_NEAR(way[1], 64.0, 1e-3); /* volumes: of the lattice, of the cells */
    {
        tetcast_check check;
        CHECK_EQ_U64(tetcast_mesh_check(mesh, NULL, &check), TETCAST_OK);
        CHECK_MSG(check.volume < 50.0 && fabs(way[0] - check.volume) < 0.02 * check.volume, "%g seen, %g there", way[0], check.volume);
    }
    tetcast_cut_destroy(c);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* Eyes so far off that a step is less than the rounding of distances: pictures end, with lengths and opacities that agree. */
TEST(far_eyes) {
    enum { W = 12, H = 10 };
    static float rgba[W * H * 4], length[W * H];
    const tetcast_lattice l = cube_lattice(21, 17, 25);
    float *v = random_grid(&l, 7);
    tetcast_bricks *b = make_bricks(&l, v, TETCAST_TYPE_F16, 3, 0);
    tetcast_optics *o = flat_optics(0.05f, TETCAST_MODEL_VOLUME);
    tetcast_cut *c = make_cut(b, NULL, 0);
    int power, isa, i, k, hits = 0;
    for (power = 3; power <= 18; power++)
        for (isa = 0; isa < 4; isa++) {
            tetcast_brick_render_desc d;
            tetcast_image image;
            memset(&d, 0, sizeof d);
            memset(&image, 0, sizeof image);
            d.isa = isa & 1 ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
            d.camera.ortho_height = 20.0f;
            if (isa & 2) d.fixed_step = 1;
            for (k = 0; k < 3; k++) d.camera.at[k] = d.camera.eye[k] = 8.0 + k;
            d.camera.eye[power % 2 ? 0 : 2] = pow(10.0, power) * (isa & 2 ? -1.0 : 1.0);
            image.width = W;
            image.height = H;
            image.rgba = rgba;
            image.length = length;
            CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_OK);
            for (i = 0; i < W * H; i++) {
                hits += length[i] > 0.0f;
                CHECK_MSG(length[i] >= 0.0f && (power > 12 || length[i] < 24.01f), "eye at 1e%d: length %g", power, (double)length[i]);
                CHECK_NEAR(rgba[4 * i + 3], 1.0 - exp(-0.05 * (double)length[i]), 1e-4);
            }
        }
    CHECK(hits > 1000);
    tetcast_cut_destroy(c);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    free(v);
}

/* Rays along the axes exactly in nodes, edges and faces of bricks, with directions of 0 and -0, eyes in them: what rays a millionth of a
   cell beside them see. The same volume in any units is the same picture. */
TEST(rays_in_borders) {
    enum { W = 17, H = 17 };
    static float rgba[2][W * H * 4];
    const tetcast_lattice l = cube_lattice(17, 17, 17);
    float *v = random_grid(&l, 21);
    uint8_t levels[8] = {0, 1, 2, 0, 1, 0, 0, 2};
    int axis, way, scale, k;
    size_t i;
    for (i = 0; i < node_count(&l); i++) v[i] = 0.3f * v[i] + (float)sin(0.4 * (double)(i % 17)) + (float)cos(0.3 * (double)(i / 17));
    for (scale = -15; scale <= 15; scale += 15) {
        const double unit = pow(10.0, scale);
        tetcast_lattice placed = l;
        tetcast_bricks *b;
        tetcast_cut *c;
        tetcast_optics *o;
        tetcast_control_point p[2];
        tetcast_transfer_desc td;
        tetcast_transfer *t = NULL;
        for (k = 0; k < 3; k++) placed.spacing[k] = unit;
        b = make_bricks(&placed, v, TETCAST_TYPE_F32, 3, 0);
        c = make_cut(b, levels, 0);
        memset(p, 0, sizeof p);
        memset(&td, 0, sizeof td);
        p[0].value = -1;
        p[1].value = 2;
        p[1].extinction = (float)(0.1 / unit);
        p[1].rgb[0] = 1;
        td.points = p;
        td.point_count = 2;
        o = NULL;
        REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, NULL, &o) == TETCAST_OK);
        for (axis = 0; axis < 3; axis++)
            for (way = 0; way < 4; way++) { /* from either side, from a face of bricks */
                double sum = 0, most = 0;
                int beside;
                for (beside = 0; beside < 2; beside++) {
                    tetcast_brick_render_desc d;
                    memset(&d, 0, sizeof d);
                    d.camera.ortho_height = (float)(17 * unit);
                    for (k = 0; k < 3; k++) d.camera.at[k] = d.camera.eye[k] = (8 + (beside ? 1e-6 * (k + 1) : 0)) * unit;
                    d.camera.eye[axis] = (way == 0 ? 40 : way == 1 ? -40 : 8) * unit;
                    d.camera.at[axis] = (way == 2 ? 9 : way == 3 ? -9 : 8) * unit;
                    d.camera.up[(axis + 1) % 3] = way & 1 ? -1.0 : 1.0;
                    d.camera.up[axis] = d.camera.up[(axis + 2) % 3] = -0.0;
                    (void)picture(&d, c, o, W, H, rgba[beside]);
                }
                for (i = 0; i < W * H * 4; i++) {
                    const double e = (double)rgba[0][i] - (double)rgba[1][i];
                    const uint32_t x = (uint32_t)(i / 4 % W), y = (uint32_t)(i / 4 / W);
                    if (x == 0 || y == 0 || x == W - 1 || y == H - 1) continue; /* at the sides of the volume one goes beside it */
                    CHECK(rgba[0][i] - rgba[0][i] == 0.0f);
                    sum += e * e / ((W - 2) * (H - 2) * 4);
                    most = fmax(most, (double)rgba[0][i]);
                }
                CHECK_MSG(most > 0.1 && 10 * log10(most * most / fmax(sum, 1e-30)) >= 60, "unit %g, axis %d, way %d: %g dB", unit, axis, way,
                          10 * log10(most * most / fmax(sum, 1e-30)));
            }
        tetcast_cut_destroy(c);
        tetcast_bricks_destroy(b);
        tetcast_optics_destroy(o);
        tetcast_transfer_destroy(t);
    }
    free(v);
}

/* A single layer is as thick as its spacing, which has to be of the size of the others; files too. */
TEST(thick_layers) {
    static const double thick[4] = {1e-20, 4096, 4097, 1e20};
    float v[3 * 9], rgba[6 * 4 * 4];
    int k, axis;
    size_t i;
    for (i = 0; i < 27; i++) v[i] = (float)i / 27.0f;
    for (axis = 0; axis < 3; axis++)
        for (k = 0; k < 4; k++) {
            tetcast_lattice l = cube_lattice(axis == 0 ? 1 : 3, axis == 1 ? 1 : 9, axis == 2 ? 1 : axis == 0 ? 3 : 9);
            tetcast_bricks_desc d;
            tetcast_brick_render_desc rd;
            tetcast_array a;
            tetcast_bricks *b = NULL;
            tetcast_cut *c;
            tetcast_optics *o;
            memset(&d, 0, sizeof d);
            memset(&rd, 0, sizeof rd);
            memset(&a, 0, sizeof a);
            l.spacing[axis] = thick[k];
            a.data = v;
            d.log_cells = 3;
            CHECK_EQ_U64(tetcast_bricks_create_grid(&d, &l, &a, NULL, &b), k < 2 ? TETCAST_OK : TETCAST_ERR_RANGE);
            CHECK((b != NULL) == (k < 2));
            if (b == NULL) continue;
            o = flat_optics(0.05f, TETCAST_MODEL_VOLUME);
            c = make_cut(b, NULL, 0);
            for (i = 0; i < 3; i++) rd.camera.eye[i] = rd.camera.at[i] = (double)(l.dims[i] - 1) / 2;
            rd.camera.eye[axis] = 6e3; /* right through it */
            rd.camera.up[(axis + 1) % 3] = 1;
            rd.camera.ortho_height = 1.0f;
            (void)picture(&rd, c, o, 6, 4, rgba);
            for (i = 0; i < 24; i++) CHECK_NEAR(rgba[4 * i + 3], 1.0 - exp(-0.05 * thick[k]), 1e-5);
            tetcast_cut_destroy(c);
            tetcast_bricks_destroy(b);
            tetcast_optics_destroy(o);
        }
}

/* A ball in nothing, about a place in the lattice. */
static void put_ball(const tetcast_lattice *l, float *v, test_rng *rng) {
    double blob[3];
    size_t i;
    uint32_t a;
    for (a = 0; a < 3; a++) blob[a] = test_rng_double(rng) * (l->dims[a] - 1);
    for (i = 0; i < node_count(l); i++) {
        const double q[3] = {(double)(i % l->dims[0]) - blob[0], (double)(i / l->dims[0] % l->dims[1]) - blob[1],
                             (double)(i / l->dims[0] / l->dims[1]) - blob[2]};
        v[i] = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] < 40 ? 1.0f : 0.0f;
    }
}

/* A camera of the kind that is this round's turn: every third eye may be in the lattice. */
static void look_about(tetcast_brick_render_desc *d, const double lo[3], const double hi[3], double wide, int round, test_rng *rng) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const double far_off = round % 3 == 0 ? 0.3 : 2.0;
        d->camera.eye[a] = 0.5 * (lo[a] + hi[a]) + far_off * wide * (2 * test_rng_double(rng) - 1);
        d->camera.at[a] = lo[a] + (hi[a] - lo[a]) * test_rng_double(rng) + 1e-3;
    }
    d->camera.fov_y = (float)(10 + 120 * test_rng_double(rng));
    if (round % 4 == 1) d->camera.ortho_height = (float)wide;
    if (round % 7 == 2) {
        d->frame[0] = 100;
        d->frame[1] = 80;
        d->part[0] = 33;
        d->part[1] = 20;
    }
}

/* The slot of bricks that a place is in, or 0 outside of the lattice. */
static int slot_at(const tetcast_lattice *l, const tetcast_bricks *b, const double p[3], size_t *slot) {
    uint32_t a;
    *slot = 0;
    for (a = 3; a-- > 0;) {
        const double q = (p[a] - l->origin[a]) / l->spacing[a];
        const double thin = l->dims[a] > 1 ? 0 : 0.5;
        uint32_t s;
        if (!(q >= -thin && q <= l->dims[a] - 1 + thin)) return 0;
        s = q > 0 ? (uint32_t)q >> b->log : 0;
        *slot = *slot * b->slots[a] + (s < b->slots[a] ? s : b->slots[a] - 1);
    }
    return 1;
}

/* Whatever is in a slot that is seen lies within the reach of its pixel's bin, and bins are not all of the picture: cameras
   outside and inside, parallel, parts of a frame, flat lattices, uneven spacing, more slots than there may be boxes. */
TEST(reach_of_bins) {
    static const tetcast_lattice lattices[6] = {{{50, 34, 41}, {0, 0, 0}, {1, 1, 1}},
                                                {{40, 1, 37}, {-3, 5, 1}, {0.5, 1, 0.25}},
                                                {{20, 60, 30}, {100, 0, -7}, {1, 0.01, 3}},
                                                {{90, 90, 90}, {0, 0, 0}, {1, 1, 1}},
                                                {{1, 1, 70}, {0, 0, 0}, {2, 2, 0.1}},
                                                {{401, 401, 130}, {0, 0, 0}, {1, 1, 1}}}; /* 44,217 slots */
    test_rng rng = test_rng_make(811);
    int round;
    uint64_t looked = 0, seen = 0, bins = 0, empty = 0;
    for (round = 0; round < (test_quick() ? 15 : 200); round++) {
        const tetcast_lattice *l = &lattices[round % 100 == 99 ? 5 : round % 5];
        const size_t nodes = node_count(l);
        float *v = (float *)malloc(nodes * 4);
        tetcast_control_point p[3] = {{0.5f, {1, 1, 1}, 0}, {0.6f, {1, 1, 1}, 3}, {2.0f, {1, 1, 1}, 3}};
        tetcast_transfer_desc td;
        tetcast_transfer *t = NULL;
        tetcast_optics *o = NULL;
        tetcast_bricks *b;
        tetcast_cut *cut;
        tetcast_brick_render_desc d;
        tetcast_image image;
        tetcasti_brick_frame c;
        double lo[3], hi[3], wide = 0;
        uint32_t x, y, a, k;
        size_t i;
        REQUIRE(v != NULL);
        for (a = 0; a < 3; a++) {
            lo[a] = l->origin[a];
            hi[a] = lo[a] + (l->dims[a] - 1) * l->spacing[a];
            wide = fmax(wide, hi[a] - lo[a]);
        }
        put_ball(l, v, &rng);
        b = make_bricks(l, v, TETCAST_TYPE_F32, 3, 0);
        cut = make_cut(b, NULL, 0);
        memset(&td, 0, sizeof td);
        memset(&d, 0, sizeof d);
        memset(&c, 0, sizeof c);
        memset(&image, 0, sizeof image);
        td.points = p;
        td.point_count = 3;
        REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, NULL, &o) == TETCAST_OK);
        image.width = 61;
        image.height = 45;
        look_about(&d, lo, hi, wide, round, &rng);
        c.desc = &d;
        c.cut = cut;
        c.optics = o;
        c.image = &image;
        REQUIRE(tetcasti_env_open(&d.env, &c.mem) == TETCAST_OK);
        REQUIRE(tetcasti_brick_frame_open(&c, &d, &image) == TETCAST_OK && tetcasti_brick_skips(&c) && tetcasti_brick_reach(&c));
        for (y = 0; y < image.height; y++)
            for (x = 0; x < image.width; x++) {
                const double *reach = c.reach[x / 8 + (size_t)c.bins_x * (y / 8)];
                double from[3], way[3], length;
                tetcasti_frame_ray(&c.frame, d.part[0] + x + 0.5, d.part[1] + y + 0.5, from, way);
                length = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
                for (k = 0; k < 60; k++) {
                    const double at = test_rng_double(&rng) * 5 * wide;
                    double place[3];
                    size_t slot;
                    for (a = 0; a < 3; a++) place[a] = from[a] + at * way[a] / length;
                    if (!slot_at(l, b, place, &slot)) continue;
                    looked++;
                    if (!(c.skip[slot] & TETCASTI_SEEN)) continue;
                    seen++;
                    CHECK_MSG(at >= reach[0] && at <= reach[1], "round %d pixel %u %u: %g not in %g to %g", round, x, y, at, reach[0], reach[1]);
                }
            }
        for (i = 0; i < (size_t)8 * 6; i++) {
            bins++;
            empty += c.reach[i][1] < c.reach[i][0];
        }
        tetcasti_free(&c.mem, c.reach);
        tetcasti_free(&c.mem, c.skip);
        tetcast_cut_destroy(cut);
        tetcast_bricks_destroy(b);
        tetcast_optics_destroy(o);
        tetcast_transfer_destroy(t);
        free(v);
    }
    CHECK_MSG(looked > 10000 && seen > looked / 50, "%u of %u", (unsigned)seen, (unsigned)looked);
    CHECK_MSG(empty > bins / 4 && empty < bins, "%u of %u bins are empty", (unsigned)empty, (unsigned)bins);
}

/* Any isa, any number of threads, any parts: the same bits. For all ways to store, with levels mixed. */
TEST(brick_pictures_same_bits) {
    enum { W = 70, H = 50 };
    static float a[W * H * 4], piece[W * H * 4];
    const tetcast_lattice l = cube_lattice(50, 34, 41);
    float *v = random_grid(&l, 2);
    int type;
    for (type = 0; type < 4; type++) {
        tetcast_bricks *b = make_bricks(&l, v, g_types[type], 3, 0);
        tetcast_control_point p[3] = {{0.3f, {1, 0, 0}, 0}, {0.5f, {0, 1, 0}, 0.1f}, {0.9f, {0, 0, 1}, 0.3f}};
        tetcast_isovalue iso = {0.6f, {1, 1, 1}, 0.4f, 0.2f, 0};
        tetcast_transfer_desc td;
        tetcast_optics_desc od;
        tetcast_transfer *t = NULL;
        tetcast_optics *o = NULL;
        tetcast_cut_desc cd;
        tetcast_cut *c = NULL;
        tetcast_brick_render_desc d;
        uint64_t want;
        uint32_t x, y, row;
        memset(&td, 0, sizeof td);
        memset(&od, 0, sizeof od);
        memset(&cd, 0, sizeof cd);
        td.points = p;
        td.point_count = 3;
        td.isovalues = &iso;
        td.isovalue_count = 1;
        od.model = type % 2 ? TETCAST_MODEL_MIXED : TETCAST_MODEL_VOLUME;
        REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, &od, &o) == TETCAST_OK);
        cd.focus_radius = 14;
        REQUIRE(tetcast_cut_create(&cd, b, &c) == TETCAST_OK);
        box_view(&d, &l, 1);
        d.isa = TETCAST_ISA_SCALAR;
        d.env.thread_count = 1;
        want = picture(&d, c, o, W, H, a);
        d.isa = TETCAST_ISA_AUTO;
        d.env.thread_count = 3;
        CHECK_EQ_U64(picture(&d, c, o, W, H, piece), want);
        d.frame[0] = W;
        d.frame[1] = H;
        for (y = 0; y < H; y += 21)
            for (x = 0; x < W; x += 33) {
                const uint32_t w = W - x < 33 ? W - x : 33, h = H - y < 21 ? H - y : 21;
                d.part[0] = x;
                d.part[1] = y;
                (void)picture(&d, c, o, w, h, piece);
                for (row = 0; row < h; row++) CHECK(memcmp(piece + 4 * row * w, a + 4 * ((y + row) * W + x), 16 * w) == 0);
            }
        d.part[0] = W;
        {
            tetcast_image image;
            memset(&image, 0, sizeof image);
            image.width = image.height = 1;
            CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_ERR_INVALID_ARG);
            d.part[0] = 0;
            d.step = 1e-4f; /* 735,000 samples on the diagonal, and more than there may be */
            CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_OK);
            d.step = 5e-5f;
            CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_ERR_RANGE);
        }
        tetcast_cut_destroy(c);
        tetcast_bricks_destroy(b);
        tetcast_optics_destroy(o);
        tetcast_transfer_destroy(t);
    }
    free(v);
}

/* A side with one node is a layer, whose thickness counts where steps are too many. */
TEST(steps_in_layers) {
    static const uint32_t dims[3][3] = {{1, 1, 1}, {1, 5, 1}, {4, 1, 3}};
    static float v[12], rgba[8 * 8 * 4];
    tetcast_optics *o = flat_optics(2, TETCAST_MODEL_VOLUME);
    uint32_t i, k, a;
    for (i = 0; i < 12; i++) v[i] = 0.5f;
    for (k = 0; k < 3; k++) {
        tetcast_bricks_desc bd;
        tetcast_brick_render_desc d;
        tetcast_lattice l;
        tetcast_array in;
        tetcast_bricks *b = NULL;
        tetcast_cut *c = NULL;
        tetcast_image image;
        memset(&bd, 0, sizeof bd);
        memset(&l, 0, sizeof l);
        memset(&in, 0, sizeof in);
        memset(&image, 0, sizeof image);
        for (a = 0; a < 3; a++) {
            l.dims[a] = dims[k][a];
            l.spacing[a] = 1.0;
        }
        in.data = v;
        REQUIRE(tetcast_bricks_create_grid(&bd, &l, &in, NULL, &b) == TETCAST_OK && tetcast_cut_create(NULL, b, &c) == TETCAST_OK);
        image.width = image.height = 8;
        image.rgba = rgba;
        memset(&d, 0, sizeof d);
        d.step = 1e-3f;
        CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_OK);
        d.step = 1e-7f;
        CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_ERR_RANGE);
        d.step = 1e-38f;
        CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_ERR_RANGE);
        tetcast_cut_destroy(c);
        tetcast_bricks_destroy(b);
    }
    tetcast_optics_destroy(o);
}

/* Tetrahedra and bricks of the same field: the hull is the same to the pixel, pictures come nearer with the step. */
TEST(bricks_look_like_tetrahedra) {
    enum { W = 60, H = 60 };
    static float a[W * H * 4], b[W * H * 4];
    tets m;
    tetcast_mesh *mesh;
    tetcast_bricks_desc bd;
    tetcast_bricks *bricks = NULL;
    tetcast_cut *cut;
    tetcast_optics *o = flat_optics(0.3f, TETCAST_MODEL_VOLUME);
    tetcast_brick_render_desc d;
    tetcast_render_desc rd;
    tetcast_image image;
    tetcast_lattice l;
    double worst = 0;
    size_t i, outline = 0;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 6, 6, 6, 5, NULL);
    tets_jitter(&m, 6, 6, 6, 0.5, 3);
    make_linear(&m);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    memset(&bd, 0, sizeof bd);
    bd.longest = 33;
    bd.log_cells = 3;
    REQUIRE(tetcast_bricks_create_mesh(&bd, mesh, NULL, &bricks) == TETCAST_OK);
    cut = make_cut(bricks, NULL, 0);
    (void)tetcast_lattice_fit(mesh, 33, &l);
    box_view(&d, &l, 1);
    memset(&rd, 0, sizeof rd);
    memset(&image, 0, sizeof image);
    rd.camera = d.camera;
    image.width = W;
    image.height = H;
    image.rgba = a;
    CHECK_EQ_U64(tetcast_render(&rd, mesh, o, &image, NULL), TETCAST_OK);
    (void)picture(&d, cut, o, W, H, b);
    for (i = 0; i < W * H * 4; i++) {
        const double e = fabs((double)a[i] - (double)b[i]);
        worst = e > worst || e != e ? e : worst;
        if (i % 4 == 3) outline += (a[i] > 0) != (b[i] > 0);
    }
    CHECK_EQ_U64(outline, 0);
    CHECK_MSG(worst < 2e-4, "%g", worst);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(bricks);
    tetcast_mesh_destroy(mesh);
    tetcast_optics_destroy(o);
    tets_free(&m);
}


/* ---- clipping, shaders, parts -------------------------------------------------------------------------------- */

/* A cube of 12 triangles. */
static const uint32_t g_cube[36] = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};

static void cube_points(double p[8][3], double lo, double hi) {
    int i, k;
    for (i = 0; i < 8; i++)
        for (k = 0; k < 3; k++) p[i][k] = i >> k & 1 ? hi : lo;
}

/* How much of a ray is in the box of 0 to 4, above 0.25 in z, but not in that of 1 to 3. */
static double length_by_boxes(const tetcast_ray *ray) {
    const double length = sqrt(ray->dir[0] * ray->dir[0] + ray->dir[1] * ray->dir[1] + ray->dir[2] * ray->dir[2]);
    double ends[2][2], want;
    int i, k;
    for (i = 0; i < 2; i++) {
        ends[i][0] = -20;
        ends[i][1] = 20;
        for (k = 0; k < 3; k++) {
            const double lo = i == 0 ? (k == 2 ? 0.25 : 0) : 1, hi = i == 0 ? 4 : 3, dir = ray->dir[k] / length;
            if (dir == 0) {
                if (ray->org[k] < lo || ray->org[k] > hi) ends[i][1] = ends[i][0];
                continue;
            }
            ends[i][0] = fmax(ends[i][0], fmin((lo - ray->org[k]) / dir, (hi - ray->org[k]) / dir));
            ends[i][1] = fmin(ends[i][1], fmax((lo - ray->org[k]) / dir, (hi - ray->org[k]) / dir));
        }
    }
    want = ends[0][1] > ends[0][0] ? ends[0][1] - ends[0][0] : 0;
    if (ends[1][1] > ends[1][0]) want -= ends[1][1] - ends[1][0];
    return want;
}

TEST(clip_spans) {
    double outer[8][3], inner[8][3];
    tetcast_clip_body body[2];
    tetcast_clip_plane plane = {{0, 0, 1}, 0.25};
    tetcast_clip_desc d;
    tetcast_error error;
    tetcast_clip *c = NULL;
    test_rng r = test_rng_make(1);
    int i, n;
    cube_points(outer, 0, 4);
    cube_points(inner, 1, 3);
    memset(body, 0, sizeof body);
    memset(&d, 0, sizeof d);
    body[0].points = (const double (*)[3])outer;
    body[1].points = (const double (*)[3])inner;
    for (i = 0; i < 2; i++) {
        body[i].point_count = 8;
        body[i].indices = g_cube;
        body[i].triangle_count = 12;
    }
    body[1].outside = 1;
    d.bodies = body;
    d.body_count = 2;
    d.planes = &plane;
    d.plane_count = 1;
    REQUIRE(tetcast_clip_create(&d, &c) == TETCAST_OK);
    for (n = 0; n < 3000; n++) {
        tetcast_ray ray;
        double spans[8][2], got = 0;
        uint32_t count, j;
        int k;
        memset(&ray, 0, sizeof ray);
        for (k = 0; k < 3; k++) {
            ray.org[k] = n % 3 == 0 ? (double)test_rng_below(&r, 5) : 4 * test_rng_double(&r); /* often on edges and corners */
            ray.dir[k] = n % 2 ? test_rng_double(&r) - 0.5 : (k == n / 2 % 3 ? 1.0 : 0.0);
        }
        ray.t_min = -20;
        ray.t_max = 20;
        count = tetcast_clip_spans(c, &ray, spans, 8);
        REQUIRE(count <= 8);
        for (j = 0; j < count; j++) {
            CHECK(spans[j][0] < spans[j][1] && (j == 0 || spans[j][0] >= spans[j - 1][1]));
            got += spans[j][1] - spans[j][0];
        }
        if (n % 3 == 0) continue; /* on a side both answers are right: only order and ends are looked at */
        CHECK_NEAR(got, length_by_boxes(&ray), 1e-9);
    }
    tetcast_clip_destroy(c);
    d.body_count = 0; /* without an end: 1e300, however the ray says so */
    d.plane_count = 0;
    REQUIRE(tetcast_clip_create(&d, &c) == TETCAST_OK);
    for (n = 0; n < 4; n++) {
        double spans[8][2];
        tetcast_ray ray;
        memset(&ray, 0, sizeof ray);
        ray.dir[1] = 1;
        ray.t_min = n == 0 ? 0.0 : n == 3 ? (double)NAN : -(double)INFINITY;
        ray.t_max = n == 1 ? 7.0 : n == 0 ? 0.0 : (double)INFINITY;
        CHECK_EQ_U64(tetcast_clip_spans(c, &ray, spans, 8), n != 3);
        if (n == 3) continue;
        CHECK(spans[0][0] == (n == 0 ? 0.0 : -1e300) && spans[0][1] == (n == 1 ? 7.0 : 1e300));
    }
    tetcast_clip_destroy(c);
    d.body_count = 2;
    d.plane_count = 1;
    body[0].triangle_count = 11; /* open: no crash, ordered */
    REQUIRE(tetcast_clip_create(&d, &c) == TETCAST_OK);
    tetcast_clip_destroy(c);
    inner[3][1] = (double)NAN;
    CHECK_EQ_U64(tetcast_clip_create(&d, &c), TETCAST_ERR_INVALID_ARG);
    body[0].triangle_count = 0; /* points that are not there */
    body[0].points = NULL;
    CHECK_EQ_U64(tetcast_clip_create(&d, &c), TETCAST_ERR_INVALID_ARG);
    CHECK(c == NULL);
    memset(&error, 0, sizeof error);
    d.env.error = &error;
    d.plane_count = SIZE_MAX; /* too many: none of them is read */
    CHECK_EQ_U64(tetcast_clip_create(&d, &c), TETCAST_ERR_INVALID_ARG);
    CHECK(c == NULL && error.where == 0xffffff);
    d.plane_count = 0;
    d.body_count = SIZE_MAX;
    CHECK_EQ_U64(tetcast_clip_create(&d, &c), TETCAST_ERR_INVALID_ARG);
    CHECK(c == NULL && error.where == 0xffffff);
}

/* The function of Marschner and Lobb with three waves. */
static void put_waves(const tetcast_lattice *l, float *values) {
    size_t i;
    for (i = 0; i < node_count(l); i++) {
        double p[3];
        int k;
        for (k = 0; k < 3; k++)
            p[k] = 2.0 * (double)(k == 0 ? i % l->dims[0] : k == 1 ? i / l->dims[0] % l->dims[1] : i / l->dims[0] / l->dims[1]) /
                   (double)(l->dims[k] - 1) - 1.0;
        values[i] = (float)((1.0 - sin(1.5708 * p[2]) + 0.25 * (1.0 + cos(9.4248 * cos(1.5708 * hypot(p[0], p[1]))))) / 2.5);
    }
}

/* Where a ray is in the box of a lattice, in ends, which hold how far it is looked at. */
static int box_span(const tetcast_lattice *l, const tetcast_ray *ray, double ends[2]) {
    int k;
    for (k = 0; k < 3; k++) {
        const double near_side = (l->origin[k] - ray->org[k]) / ray->dir[k];
        const double far_side = (l->origin[k] + (l->dims[k] - 1) * l->spacing[k] - ray->org[k]) / ray->dir[k];
        if (fabs(ray->dir[k]) < 1e-12) {
            if (ray->org[k] < l->origin[k] || ray->org[k] > l->origin[k] + (l->dims[k] - 1) * l->spacing[k]) ends[1] = -1.0;
            continue;
        }
        ends[0] = fmax(ends[0], fmin(near_side, far_side));
        ends[1] = fmin(ends[1], fmax(near_side, far_side));
    }
    return ends[1] > ends[0];
}

/* The colour of a ray by many short segments, each linear between samples. */
static void integrate_cut(const tetcast_cut *c, const tetcast_lattice *l, const tetcast_optics *o, const tetcast_ray *ray, const double ends[2],
                          float want[4]) {
    enum { N = 4000 };
    static float x[3][N + 1], v[N + 1];
    static tetcast_segment segment[N];
    int j, k;
    for (j = 0; j <= N; j++)
        for (k = 0; k < 3; k++)
            x[k][j] = (float)((ray->org[k] + ray->dir[k] * (ends[0] + (ends[1] - ends[0]) * j / N) - l->origin[k]) / l->spacing[k]);
    tetcast_cut_sample(c, x[0], x[1], x[2], N + 1, TETCAST_ISA_AUTO, v);
    for (j = 0; j < N; j++) {
        segment[j].front = v[j];
        segment[j].back = v[j + 1];
        segment[j].length = (float)((ends[1] - ends[0]) / N);
        segment[j].depth = 0.0f;
    }
    CHECK_EQ_U64(tetcast_optics_ray(o, segment, N, want, NULL), TETCAST_OK);
}

/* All models against rays in 4000 pieces of the same field; uneven spacings, a thin slab, along the axes and not. */
TEST(pictures_against_rays) {
    enum { W = 32, H = 24 };
    static float rgba[W * H * 4];
    static const uint32_t dims[3][3] = {{33, 33, 33}, {17, 21, 9}, {2, 18, 25}};
    static const tetcast_model models[5] = {TETCAST_MODEL_VOLUME, TETCAST_MODEL_EMISSION, TETCAST_MODEL_ABSORPTION,
                                            TETCAST_MODEL_MAXIMUM, TETCAST_MODEL_ISOSURFACE};
    int shape, model;
    for (shape = 0; shape < 3; shape++) {
        tetcast_lattice l = cube_lattice(dims[shape][0], dims[shape][1], dims[shape][2]);
        float *values = (float *)malloc(node_count(&l) * 4);
        tetcast_bricks *b;
        tetcast_cut *c;
        double depth = 0.0;
        size_t i;
        if (shape == 1) l.spacing[2] = 1000.0;
        put_waves(&l, values);
        b = make_bricks(&l, values, TETCAST_TYPE_F32, 3, 0);
        c = make_cut(b, NULL, 0);
        for (i = 0; i < 3; i++) depth += (l.dims[i] - 1) * (shape == 1 ? 1.0 : l.spacing[i]) / 3.0;
        for (model = 0; model < 5; model++) {
            const float thick = (float)(4.0 / depth);
            const tetcast_control_point p[4] = {{0.1f, {1, 0, 0}, 0}, {0.35f, {0, 1, 0}, 0.3f * thick}, {0.5f, {0, 0.4f, 1}, 0.1f * thick},
                                                {0.9f, {1, 1, 0}, thick}};
            const tetcast_isovalue iso = {0.45f, {1, 1, 1}, 0.4f, 0.2f, 0};
            tetcast_transfer_desc td;
            tetcast_optics_desc od;
            tetcast_transfer *t = NULL;
            tetcast_optics *o = NULL;
            tetcast_brick_render_desc d;
            double sum = 0.0, most = 0.0, psnr;
            uint32_t pixel, count = 0, seen = 0;
            memset(&td, 0, sizeof td);
            memset(&od, 0, sizeof od);
            td.points = p;
            td.point_count = 4;
            td.isovalues = &iso;
            td.isovalue_count = 1;
            od.model = models[model];
            od.t_min = -1;
            REQUIRE(tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, &od, &o) == TETCAST_OK);
            box_view(&d, &l, model);
            if (shape == 1) { /* much longer than wide: a part of it, across and along */
                static const double views[5][3] = {{1, 0, 0}, {1, 0.3, 0.2}, {0, 0, 1}, {0.003, 0.001, 1}, {1, 1, 1}};
                int k;
                for (k = 0; k < 3; k++) {
                    d.camera.at[k] = 0.5 * (l.dims[k] - 1) * l.spacing[k];
                    d.camera.eye[k] = d.camera.at[k] + 9000.0 * views[model][k];
                    d.camera.up[k] = k == 1;
                }
                d.camera.ortho_height = 30.0f;
            }
            d.step = shape == 0 ? 1.0f : 0.125f; /* fewer nodes for the same waves */
            (void)picture(&d, c, o, W, H, rgba);
            for (pixel = 0; pixel < W * H; pixel += 5) {
                tetcast_ray ray;
                double ends[2] = {0.0, 1e30};
                float want[4];
                int k;
                (void)tetcast_camera_ray(&d.camera, W, H, pixel % W + 0.5, pixel / W + 0.5, &ray);
                memset(want, 0, sizeof want);
                if (box_span(&l, &ray, ends)) {
                    integrate_cut(c, &l, o, &ray, ends, want);
                    seen++;
                }
                for (k = models[model] == TETCAST_MODEL_ISOSURFACE ? 3 : 0; k < 4; k++) { /* light on surfaces: test sphere */
                    const double e = (double)rgba[4 * pixel + (uint32_t)k] - (double)want[k];
                    sum += e * e;
                    most = fmax(most, (double)want[k]);
                    count++;
                }
            }
            psnr = 10.0 * log10(most * most * (double)count / fmax(sum, 1e-30));
            CHECK_MSG(seen > 8 && most > 0.05 && psnr >= 50.0, "shape %d, model %d: %g dB, most %g, %u rays", shape, model, psnr, most, seen);
            tetcast_optics_destroy(o);
            tetcast_transfer_destroy(t);
        }
        tetcast_cut_destroy(c);
        tetcast_bricks_destroy(b);
        free(values);
    }
}

/* What stands before the volume hides all of it, what is behind nothing, what is within the rest: pixel by pixel. */
TEST(depth_limits) {
    enum { W = 40, H = 30 };
    static float rgba[4][W * H * 4], limit[W * H];
    const tetcast_lattice l = cube_lattice(26, 21, 23);
    float *v = random_grid(&l, 5);
    tetcast_bricks *b = make_bricks(&l, v, TETCAST_TYPE_F32, 3, 0);
    tetcast_optics *o = flat_optics(0.05f, TETCAST_MODEL_VOLUME);
    tetcast_cut *c = make_cut(b, NULL, 0);
    tetcast_brick_render_desc d;
    uint32_t i, cut = 0, open = 0;
    double middle = 0.0, wrong = 0.0;
    box_view(&d, &l, 1);
    for (i = 0; i < 3; i++) middle += (d.camera.at[i] - d.camera.eye[i]) * (d.camera.at[i] - d.camera.eye[i]);
    middle = sqrt(middle);
    (void)picture(&d, c, o, W, H, rgba[0]);
    for (i = 0; i < W * H; i++) limit[i] = i % 3 == 0 ? 1e-3f : i % 3 == 1 ? 1e9f : (float)middle;
    d.limit = limit;
    (void)picture(&d, c, o, W, H, rgba[1]);
    d.limit = NULL;
    d.clip_far = (float)middle;
    (void)picture(&d, c, o, W, H, rgba[2]);
    for (i = 0; i < W * H; i++) {
        const float *got = rgba[1] + 4 * i;
        if (i % 3 == 0) CHECK(got[0] == 0.0f && got[3] == 0.0f);
        else if (i % 3 == 1) CHECK(memcmp(got, rgba[0] + 4 * i, 16) == 0);
        else wrong = fmax(wrong, fabs((double)got[3] - (double)rgba[2][4 * i + 3]));
        cut += i % 3 == 2 && got[3] > 0.0f && got[3] < 0.99f * rgba[0][4 * i + 3];
        open += rgba[0][4 * i + 3] > 0.0f;
    }
    CHECK_MSG(wrong < 1e-6 && cut > open / 6, "%g, %u of %u", wrong, cut, open);
    { /* tetrahedra, by the walk that shaders use */
        tets m;
        tetcast_mesh *mesh;
        tetcast_shade_desc sd;
        tetcast_image image;
        static const double scale[3] = {5.0, 5.0, 4.4}, origin[3] = {0, 0, 0};
        uint32_t k;
        memset(&m, 0, sizeof m);
        memset(&sd, 0, sizeof sd);
        memset(&image, 0, sizeof image);
        tets_lattice(&m, 6, 5, 6, 5, NULL);
        tets_place(&m, scale, origin);
        mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        sd.camera = d.camera;
        image.width = W;
        image.height = H;
        for (k = 0; k < 3; k++) {
            sd.limit = k == 1 ? limit : NULL;
            sd.clip_far = k == 2 ? (float)middle : 0.0f;
            image.rgba = rgba[k];
            CHECK_EQ_U64(tetcast_render_shaded(&sd, mesh, o, &image, NULL), TETCAST_OK);
        }
        for (i = cut = open = 0, wrong = 0.0; i < W * H; i++) {
            const float *got = rgba[1] + 4 * i;
            if (i % 3 == 0) CHECK(got[0] == 0.0f && got[3] == 0.0f);
            else if (i % 3 == 1) CHECK(memcmp(got, rgba[0] + 4 * i, 16) == 0);
            else wrong = fmax(wrong, fabs((double)got[3] - (double)rgba[2][4 * i + 3]));
            cut += i % 3 == 2 && got[3] > 0.0f && got[3] < 0.99f * rgba[0][4 * i + 3];
            open += rgba[0][4 * i + 3] > 0.0f;
        }
        CHECK_MSG(wrong < 1e-6 && cut > open / 6, "tetrahedra: %g, %u of %u", wrong, cut, open);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
    tetcast_cut_destroy(c);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    free(v);
}

/* Bodies that lie in the sides of bricks, cross themselves, are open, or hold the eye: of the length that is left, or none that
   is no number. */
TEST(odd_clip_bodies) {
    enum { W = 30, H = 24 };
    static float rgba[W * H * 4], length[W * H];
    const tetcast_lattice l = cube_lattice(25, 25, 25);
    float *v = random_grid(&l, 5);
    tetcast_bricks *b = make_bricks(&l, v, TETCAST_TYPE_F32, 3, 0);
    tetcast_optics *o = flat_optics(0.05f, TETCAST_MODEL_VOLUME);
    tetcast_cut *c = make_cut(b, NULL, 0);
    int kind, view;
    for (kind = 0; kind < 3; kind++) /* 0: one box of bricks; 1: two that overlap; 2: without two of its sides */
        for (view = 0; view < 4; view++) { /* 3: the eye within */
            double p[16][3];
            uint32_t t[72], i;
            tetcast_clip_body body;
            tetcast_clip_desc cd;
            tetcast_clip *clip = NULL;
            tetcast_brick_render_desc d;
            tetcast_image image;
            double worst = 0.0;
            int hits = 0;
            cube_points(p, kind == 1 ? 4.0 : 8.0, kind == 1 ? 12.0 : 16.0);
            cube_points(p + 8, 8.0, 16.0);
            for (i = 0; i < 72; i++) t[i] = g_cube[i % 36] + (i < 36 ? 0 : 8);
            memset(&body, 0, sizeof body);
            memset(&cd, 0, sizeof cd);
            memset(&image, 0, sizeof image);
            body.points = (const double (*)[3])p;
            body.point_count = 16;
            body.indices = t;
            body.triangle_count = kind == 0 ? 12 : kind == 1 ? 24 : 8;
            cd.bodies = &body;
            cd.body_count = 1;
            REQUIRE(tetcast_clip_create(&cd, &clip) == TETCAST_OK);
            box_view(&d, &l, view);
            if (view == 3) {
                d.camera.ortho_height = 0.0f;
                d.camera.fov_y = 80.0f;
                for (i = 0; i < 3; i++) d.camera.eye[i] = 9.5 + 0.1 * i;
                d.camera.at[0] = 15.0;
                d.camera.at[1] = d.camera.at[2] = 12.0;
            }
            d.clip = clip;
            image.width = W;
            image.height = H;
            image.rgba = rgba;
            image.length = length;
            CHECK_EQ_U64(tetcast_render_bricks(&d, c, o, &image, NULL), TETCAST_OK);
            for (i = 0; i < W * H; i++) {
                tetcast_ray ray;
                double ends[2][2], way = 0.0;
                int box, k;
                (void)tetcast_camera_ray(&d.camera, W, H, i % W + 0.5, i / W + 0.5, &ray);
                for (box = 0; box < 2; box++) {
                    ends[box][0] = 0.0;
                    ends[box][1] = 1e30;
                    for (k = 0; k < 3; k++) {
                        const double lo = (p[8 * box][k] - ray.org[k]) / ray.dir[k], hi = (p[8 * box + 7][k] - ray.org[k]) / ray.dir[k];
                        if (fabs(ray.dir[k]) < 1e-12) {
                            if (ray.org[k] < p[8 * box][k] || ray.org[k] > p[8 * box + 7][k]) ends[box][1] = -1.0;
                            continue;
                        }
                        ends[box][0] = fmax(ends[box][0], fmin(lo, hi));
                        ends[box][1] = fmin(ends[box][1], fmax(lo, hi));
                    }
                    if (ends[box][1] > ends[box][0]) way += ends[box][1] - ends[box][0];
                }
                if (kind != 1) way *= 0.5; /* both are the same */
                else way -= 2.0 * fmax(0.0, fmin(ends[0][1], ends[1][1]) - fmax(ends[0][0], ends[1][0])); /* hits 1 to 2 and 3 to 4 */
                CHECK(length[i] >= 0.0f && length[i] < 100.0f && rgba[4 * i + 3] >= 0.0f && rgba[4 * i + 3] <= 1.0f);
                CHECK_NEAR(rgba[4 * i + 3], 1.0 - exp(-0.05 * (double)length[i]), 1e-5);
                worst = fmax(worst, fabs((double)length[i] - way));
                hits += length[i] > 0.0f;
            }
            CHECK_MSG(hits > 0 && (kind == 2 || worst < 1e-3), "kind %d, view %d: off by %g, %d hits", kind, view, worst, hits);
            tetcast_clip_destroy(clip);
        }
    tetcast_cut_destroy(c);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    free(v);
}

/* Tetrahedra, bricks and functions of one field: the more nodes, or the smaller the tolerance, the nearer. */
TEST(nearer_with_bytes) {
    enum { W = 48, H = 40, N = 7 };
    static float want[W * H * 4], got[W * H * 4];
    tets m;
    tetcast_mesh *mesh;
    tetcast_optics *o;
    tetcast_transfer *t = NULL;
    const tetcast_control_point p[3] = {{-1.0f, {1, 0, 0}, 0}, {0.2f, {0, 1, 0}, 0.2f}, {1.2f, {0, 0, 1}, 0.9f}};
    tetcast_transfer_desc td;
    tetcast_image image;
    tetcast_render_desc rd;
    double rms[2] = {1e9, 1e9}, first[2] = {0.0, 0.0};
    uint64_t bytes[2] = {0, 0};
    int step, kind;
    size_t i;
    memset(&m, 0, sizeof m);
    memset(&td, 0, sizeof td);
    memset(&rd, 0, sizeof rd);
    memset(&image, 0, sizeof image);
    tets_lattice(&m, N, N, N, 6, NULL);
    for (i = 0; i < m.nv; i++) m.s[i] = (float)(sin(1.1 * m.p[3 * i]) * cos(0.9 * m.p[3 * i + 1]) + 0.3 * sin(0.8 * m.p[3 * i + 2]));
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    td.points = p;
    td.point_count = 3;
    REQUIRE(mesh != NULL && tetcast_transfer_create(&td, &t) == TETCAST_OK && tetcast_optics_create(t, NULL, &o) == TETCAST_OK);
    rd.camera.eye[0] = 14.0;
    rd.camera.eye[1] = 11.0;
    rd.camera.eye[2] = 9.0;
    for (i = 0; i < 3; i++) rd.camera.at[i] = 0.5 * (N - 1);
    rd.camera.up[1] = 1.0;
    rd.camera.fov_y = 40.0f;
    image.width = W;
    image.height = H;
    image.rgba = want;
    CHECK_EQ_U64(tetcast_render(&rd, mesh, o, &image, NULL), TETCAST_OK);
    image.rgba = got;
    for (step = 0; step < 4; step++)
        for (kind = 0; kind < 2; kind++) {
            double sum = 0.0;
            uint64_t size;
            if (kind == 0) {
                tetcast_bricks_desc d;
                tetcast_brick_render_desc q;
                tetcast_bricks *b = NULL;
                tetcast_cut *c;
                memset(&d, 0, sizeof d);
                memset(&q, 0, sizeof q);
                d.longest = (8u << step) + 1;
                d.log_cells = 3;
                d.storage = TETCAST_TYPE_F32;
                REQUIRE(tetcast_bricks_create_mesh(&d, mesh, NULL, &b) == TETCAST_OK);
                c = make_cut(b, NULL, 0);
                q.camera = rd.camera;
                q.step = 0.5f;
                CHECK_EQ_U64(tetcast_render_bricks(&q, c, o, &image, NULL), TETCAST_OK);
                size = tetcast_bricks_file_size(b);
                tetcast_cut_destroy(c);
                tetcast_bricks_destroy(b);
            } else {
                static const float asked[4] = {0.3f, 0.1f, 0.03f, 0.01f};
                tetcast_rbf_points points;
                tetcast_rbf_fit_desc d;
                tetcast_rbf_report report;
                tetcast_rbf_render_desc q;
                tetcast_rbf *f = NULL;
                memset(&points, 0, sizeof points);
                memset(&d, 0, sizeof d);
                memset(&q, 0, sizeof q);
                points.positions.data = m.p;
                points.positions.type = TETCAST_TYPE_F64;
                points.values.data = m.s;
                points.components = 1;
                points.count = m.nv;
                points.tets = m.t;
                points.tet_count = m.nt;
                d.max_error = asked[step];
                d.between = 1;
                REQUIRE(tetcast_rbf_fit(&d, &points, &report, &f) == TETCAST_OK);
                q.camera = rd.camera;
                q.step = 0.05f;
                CHECK_EQ_U64(tetcast_rbf_render(&q, f, o, &image, NULL), TETCAST_OK);
                size = report.bytes;
                tetcast_rbf_destroy(f);
            }
            for (i = 0; i < W * H * 4; i++) sum += ((double)got[i] - (double)want[i]) * ((double)got[i] - (double)want[i]);
            sum = sqrt(sum / (W * H * 4));
            if (getenv("TEST_PRINT") != NULL) printf("%s %d: %lu bytes, rms %g\n", kind ? "functions" : "bricks", step, (unsigned long)size, sum);
            CHECK_MSG(sum < rms[kind] && size > bytes[kind], "kind %d, step %d: %g after %g, %lu bytes", kind, step, sum, rms[kind],
                      (unsigned long)size);
            if (step == 0) first[kind] = sum;
            if (step == 3) CHECK_MSG(sum < first[kind] / 5.0 && sum < 0.01, "kind %d: %g at last, %g at first", kind, sum, first[kind]);
            rms[kind] = sum;
            bytes[kind] = size;
        }
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

typedef struct probe_shader { int prepared; float density; } probe_shader;

static tetcast_result probe_prepare(void *user, const tetcast_param *params, size_t count, tetcast_error *error) {
    const float *v = tetcast_params_find(params, count, "density", 1, error);
    if (v == NULL) return TETCAST_ERR_INVALID_ARG;
    ((probe_shader *)user)->density = v[0];
    ((probe_shader *)user)->prepared++;
    return TETCAST_OK;
}

/* Absorbs evenly where what it was given fits together: linear field, its gradient, its position. */
static void probe_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    const probe_shader *p = (const probe_shader *)user;
    int i, k;
    for (i = 0; i < 8; i++) {
        double q[3], along = 0;
        int fits;
        if (!(in->mask >> i & 1u)) continue;
        for (k = 0; k < 3; k++) {
            q[k] = (double)in->position[k][i];
            along += (double)in->gradient[k][i] * (double)in->direction[k][i];
        }
        fits = fabs(linear_at(q) - 0.5 * ((double)in->front[i] + (double)in->back[i])) < 1e-4 &&
               fabs((double)in->gradient[0][i] - 0.3) < 1e-4 &&
               fabs(along * (double)in->length[i] - ((double)in->back[i] - (double)in->front[i])) < 1e-4;
        rgba[3][i] = 1.0f - expf(-p->density * in->length[i]);
        rgba[0][i] = rgba[3][i] * (fits ? 1.0f : 0.0f);
    }
}

TEST(shaders) {
    enum { W = 48, H = 40 };
    static float a[W * H * 4], b[W * H * 4];
    const tetcast_lattice l = cube_lattice(30, 22, 19);
    float *v = (float *)malloc(node_count(&l) * 4), density = 0.03f;
    tetcast_bricks *k;
    tetcast_cut *c;
    tetcast_optics *o = flat_optics(0.03f, TETCAST_MODEL_VOLUME);
    tetcast_brick_render_desc d;
    tetcast_shader s;
    tetcast_param param = {"density", NULL, 1};
    tetcast_error error;
    tetcast_image image;
    probe_shader probe = {0, 0};
    double worst = 0;
    size_t i;
    for (i = 0; i < node_count(&l); i++) {
        double p[3];
        node_at(&l, i, p);
        v[i] = (float)linear_at(p);
    }
    k = make_bricks(&l, v, TETCAST_TYPE_F32, 3, 0);
    c = make_cut(k, NULL, 0);
    box_view(&d, &l, 1);
    (void)picture(&d, c, o, W, H, a);
    memset(&s, 0, sizeof s);
    memset(&image, 0, sizeof image);
    image.width = W;
    image.height = H;
    image.rgba = b;
    s.user = &probe;
    s.needs = TETCAST_NEED_GRADIENT | TETCAST_NEED_POSITION | TETCAST_NEED_DIRECTION;
    s.prepare_fn = probe_prepare;
    s.shade_fn = probe_shade;
    s.params = &param;
    s.param_count = 1;
    d.shader = &s;
    d.env.error = &error;
    CHECK_EQ_U64(tetcast_render_bricks(&d, c, NULL, &image, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_STR(error.text, "missing shader parameter: density");
    param.values = &density;
    CHECK_EQ_U64(tetcast_render_bricks(&d, c, NULL, &image, NULL), TETCAST_OK);
    CHECK_EQ_U64((uint64_t)probe.prepared, 1);
    for (i = 0; i < W * H; i++) { /* colour and opacity of the optics: white there is red here */
        const double e = fabs((double)a[4 * i + 3] - (double)b[4 * i + 3]), f = fabs((double)b[4 * i] - (double)b[4 * i + 3]);
        worst = e > worst ? e : worst;
        worst = f > worst ? f : worst;
    }
    CHECK_MSG(worst < 1e-4, "%g", worst);
    tetcast_cut_destroy(c);
    tetcast_bricks_destroy(k);
    tetcast_optics_destroy(o);
    free(v);
}

/* Other fields along rays: linear ones come exact, whatever is drawn and wherever their lattices lie. */
typedef struct channel_probe { uint32_t seen, bad, same; } channel_probe; /* same: what is drawn is linear as well */

/* Two machines: one sets parameters and sends what changed, the other rebuilds what is old, and nothing else. */
static tetcast_result prepare_nothing(void *user, const tetcast_param *params, size_t count, tetcast_error *error) {
    (void)user;
    (void)params;
    (void)count;
    (void)error;
    return TETCAST_OK;
}
static void shade_length(void *user, const tetcast_packet *in, float rgba[4][8]) {
    uint32_t i, k;
    (void)user;
    for (i = 0; i < 8; i++)
        for (k = 0; k < 4; k++) rgba[k][i] = in->mask >> i & 1u ? fminf(0.1f * in->length[i], 1.0f) : 0.0f;
}
static int keep_corner(uint32_t x, uint32_t y, uint32_t z) { return x + y + z < 6; }

TEST(shaders_end_at_the_hull) { /* with a prepare_fn as without it */
    enum { W = 40, H = 32 };
    static float rgba[3][W * H * 4];
    tets m;
    tetcast_mesh *mesh;
    tetcast_bricks_desc bd;
    tetcast_bricks *b = NULL;
    tetcast_cut *cut = NULL;
    int k;
    memset(&m, 0, sizeof m);
    memset(&bd, 0, sizeof bd);
    tets_lattice(&m, 7, 7, 7, 6, keep_corner);
    mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    bd.longest = 17;
    bd.checks = 1;
    REQUIRE(tetcast_bricks_create_mesh(&bd, mesh, NULL, &b) == TETCAST_OK && tetcast_cut_create(NULL, b, &cut) == TETCAST_OK);
    for (k = 0; k < 3; k++) {
        tetcast_brick_render_desc d;
        tetcast_shader s;
        tetcast_image image;
        memset(&d, 0, sizeof d);
        memset(&s, 0, sizeof s);
        memset(&image, 0, sizeof image);
        s.shade_fn = shade_length;
        if (k != 0) s.prepare_fn = prepare_nothing;
        d.shader = &s;
        d.no_hull = k == 2;
        image.width = W;
        image.height = H;
        image.rgba = rgba[k];
        CHECK_EQ_U64(tetcast_render_bricks(&d, cut, NULL, &image, NULL), TETCAST_OK);
    }
    CHECK(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
    CHECK(memcmp(rgba[0], rgba[2], sizeof rgba[0]) != 0);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

TEST(parameters) {
    test_alloc ta;
    tetcast_env env;
    tetcast_params *a = NULL, *b = NULL;
    uint8_t data[4096], bad[4096];
    float eye[3] = {1, 2, 3}, table[256], nan_bits = (float)NAN;
    uint64_t sent = 0, built = 0;
    uint32_t rebuilt = 0;
    size_t n, i, count;
    int frame;
    memset(&env, 0, sizeof env);
    test_alloc_init(&ta);
    env.allocator.alloc_fn = test_alloc_fn;
    env.allocator.free_fn = test_free_fn;
    env.allocator.user = &ta;
    for (i = 0; i < 256; i++) table[i] = (float)i;
    CHECK_EQ_U64(tetcast_params_create(&env, &a), TETCAST_OK);
    CHECK_EQ_U64(tetcast_params_create(&env, &b), TETCAST_OK);
    REQUIRE(a != NULL && b != NULL);
    CHECK_EQ_U64(tetcast_params_changed(a, NULL), 0);
    for (frame = 0; frame < 20; frame++) {
        eye[0] = (float)frame;
        if (frame == 7 || frame == 15) table[3] += 0.5f;
        CHECK_EQ_U64(tetcast_params_set(a, "eye", eye, 3), TETCAST_OK);
        CHECK_EQ_U64(tetcast_params_set(a, "table", table, 256), TETCAST_OK); /* the same as a rule: no change */
        n = tetcast_params_changes(a, sent, data, sizeof data);
        CHECK(n <= sizeof data);
        CHECK_EQ_U64(n, 16 + (5 + 3 + 12) + (frame == 0 || frame == 7 || frame == 15 ? 5 + 5 + 1024 : 0));
        sent = tetcast_params_changed(a, NULL);
        CHECK_EQ_U64(tetcast_params_apply(b, data, n), TETCAST_OK);
        if (tetcast_params_changed(b, "table") > built) {
            rebuilt++;
            built = tetcast_params_changed(b, "table");
        }
        CHECK(memcmp(tetcast_params_find(tetcast_params_list(b, NULL), 2, "eye", 3, NULL), eye, sizeof eye) == 0);
        CHECK(memcmp(tetcast_params_find(tetcast_params_list(b, NULL), 2, "table", 256, NULL), table, sizeof table) == 0);
    }
    CHECK_EQ_U64(rebuilt, 3);
    CHECK_EQ_U64(tetcast_params_changed(b, "nothing"), 0);
    CHECK_EQ_U64(tetcast_params_changes(a, sent, NULL, 0), 16); /* nothing is new */
    n = tetcast_params_changes(a, 0, data, sizeof data);
    built = tetcast_params_changed(b, NULL);
    CHECK_EQ_U64(tetcast_params_apply(b, data, n), TETCAST_OK);
    CHECK_EQ_U64(tetcast_params_changed(b, NULL), built); /* all of it was known */
    for (i = 0; i < n; i++) { /* cut short, a bit turned: refused, and nothing is taken over */
        CHECK(tetcast_params_apply(b, data, i) != TETCAST_OK);
        memcpy(bad, data, n);
        bad[i] ^= (uint8_t)(1u << i % 8);
        CHECK(tetcast_params_apply(b, bad, n) != TETCAST_OK);
    }
    CHECK_EQ_U64(tetcast_params_changed(b, NULL), built);
    (void)tetcast_params_list(b, &count);
    CHECK_EQ_U64(count, 2);
    CHECK_EQ_U64(tetcast_params_set(a, "x", &nan_bits, 1), TETCAST_OK);
    CHECK_EQ_U64(tetcast_params_changed(a, "x"), sent + 1);
    CHECK_EQ_U64(tetcast_params_set(a, "x", &nan_bits, 1), TETCAST_OK); /* bits are compared, not numbers */
    CHECK_EQ_U64(tetcast_params_changed(a, "x"), sent + 1);
    for (i = 0; i < 40; i++) {
        char name[8];
        snprintf(name, sizeof name, "n%d", (int)i);
        CHECK_EQ_U64(tetcast_params_set(a, name, eye, 1 + i % 3), TETCAST_OK);
    }
    CHECK_EQ_U64(tetcast_params_set(a, "", eye, 1), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_params_set(a, "x", eye, 0), TETCAST_ERR_INVALID_ARG);
    tetcast_params_destroy(a);
    tetcast_params_destroy(b);
    tetcast_params_destroy(NULL);
    test_alloc_check(&ta);
}

static void channel_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    channel_probe *p = (channel_probe *)user;
    int i, k;
    for (i = 0; i < 8; i++) {
        double q[3];
        if (!(in->mask >> i & 1u)) continue;
        for (k = 0; k < 3; k++) q[k] = (double)in->position[k][i];
        p->seen++;
        if (p->same) p->bad += !(fabs(0.5 * (double)(in->front[i] + in->back[i]) - (double)in->channel[0][i]) < 5e-3);
        else p->bad += !(fabs(linear_at(q) - (double)in->channel[0][i]) < 2e-4);
        p->bad += !(fabs(7.0 - (double)in->channel[1][i]) < 1e-5);
        rgba[3][i] = 0.01f;
    }
}

static tetcast_cut *channel_of(const tetcast_lattice *l, tetcast_type type, int flat, tetcast_bricks **bricks) {
    float *v = (float *)malloc(node_count(l) * 4);
    size_t i;
    for (i = 0; i < node_count(l); i++) {
        double p[3];
        node_at(l, i, p);
        v[i] = flat ? 7.0f : (float)linear_at(p);
    }
    *bricks = make_bricks(l, v, type, 3, 0);
    free(v);
    return make_cut(*bricks, NULL, 0);
}

TEST(channels) {
    enum { W = 24, H = 20 };
    static float rgba[W * H * 4];
    tetcast_lattice l[3];
    tetcast_bricks *b[3] = {NULL, NULL, NULL};
    tetcast_cut *c[3];
    const tetcast_cut *channels[2];
    tetcast_brick_render_desc d;
    tetcast_shade_desc sd;
    tetcast_rbf_render_desc rd;
    tetcast_rbf_desc fd;
    tetcast_rbf_function f;
    tetcast_rbf *m = NULL;
    tetcast_image image;
    tetcast_shader s;
    channel_probe probe = {0, 0, 0};
    tets t;
    tetcast_mesh *mesh;
    tetcast_mesh_info info;
    uint32_t a, way;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 4, 4, 4, 5, NULL);
    make_linear(&t);
    mesh = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(mesh != NULL);
    tetcast_mesh_get_info(mesh, &info);
    for (a = 0; a < 3; a++) { /* what is drawn; finer and wider; coarser, uneven and wider */
        uint32_t k;
        for (k = 0; k < 3; k++) {
            const double side = info.box_max[k] - info.box_min[k];
            l[a].dims[k] = a == 0 ? 12 : a == 1 ? 37 : 9 + 2 * k;
            l[a].origin[k] = info.box_min[k] - (a == 0 ? 0.0 : 0.25 * side);
            l[a].spacing[k] = side * (a == 0 ? 1.0 : 1.5) / (l[a].dims[k] - 1);
        }
        c[a] = channel_of(&l[a], a == 1 ? TETCAST_TYPE_F32 : TETCAST_TYPE_F16, a == 2, &b[a]);
    }
    channels[0] = c[1];
    channels[1] = c[2];
    memset(&s, 0, sizeof s);
    memset(&image, 0, sizeof image);
    image.width = W;
    image.height = H;
    image.rgba = rgba;
    s.user = &probe;
    s.needs = TETCAST_NEED_POSITION;
    s.shade_fn = channel_shade;
    s.channels = channels;
    s.channel_count = 2;
    memset(&fd, 0, sizeof fd);
    memset(&f, 0, sizeof f);
    for (a = 0; a < 3; a++) {
        fd.box_min[a] = info.box_min[a];
        fd.box_max[a] = info.box_max[a];
        f.centre[a] = 0.5 * (info.box_min[a] + info.box_max[a]);
    }
    f.width = 0.2 * (info.box_max[0] - info.box_min[0]);
    f.weight[0] = 1.0f;
    fd.functions = &f;
    fd.function_count = 1;
    CHECK_EQ_U64(tetcast_rbf_create(&fd, &m), TETCAST_OK);
    for (way = 0; way < 4; way++) {
        memset(&d, 0, sizeof d);
        memset(&sd, 0, sizeof sd);
        memset(&rd, 0, sizeof rd);
        d.env.thread_count = sd.env.thread_count = rd.env.thread_count = 1;
        d.isa = way == 1 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO;
        d.shader = sd.shader = rd.shader = &s;
        probe.seen = 0;
        probe.same = way == 1 || way == 2;
        if (way < 2) CHECK_EQ_U64(tetcast_render_bricks(&d, c[0], NULL, &image, NULL), TETCAST_OK);
        if (way == 2) CHECK_EQ_U64(tetcast_render_shaded(&sd, mesh, NULL, &image, NULL), TETCAST_OK);
        if (way == 3) CHECK_EQ_U64(tetcast_rbf_render(&rd, m, NULL, &image, NULL), TETCAST_OK);
        CHECK_MSG(probe.seen > 200 && probe.bad == 0, "way %u: %u of %u", way, probe.bad, probe.seen);
    }
    s.needs = 0; /* bricks: positions are made for channels alone */
    probe.bad = 0;
    probe.same = 1;
    CHECK_EQ_U64(tetcast_render_bricks(&d, c[0], NULL, &image, NULL), TETCAST_OK);
    CHECK_EQ_U64(probe.bad, 0);
    for (way = 0; way < 3; way++) {
        s.channels = way == 0 ? NULL : channels;
        s.channel_count = way == 1 ? TETCAST_MAX_CHANNELS + 1 : 2;
        if (way == 2) channels[1] = NULL;
        CHECK_EQ_U64(tetcast_render_bricks(&d, c[0], NULL, &image, NULL), TETCAST_ERR_INVALID_ARG);
        CHECK_EQ_U64(tetcast_render_shaded(&sd, mesh, NULL, &image, NULL), TETCAST_ERR_INVALID_ARG);
        CHECK_EQ_U64(tetcast_rbf_render(&rd, m, NULL, &image, NULL), TETCAST_ERR_INVALID_ARG);
    }
    for (a = 0; a < 3; a++) {
        tetcast_cut_destroy(c[a]);
        tetcast_bricks_destroy(b[a]);
    }
    tetcast_rbf_destroy(m);
    tetcast_mesh_destroy(mesh);
    tets_free(&t);
}

/* A body of 100 boxes: each ray has as many parts, in bricks, tetrahedra and functions; how many is not limited. */
TEST(many_parts) {
    enum { BOXES = 100, SIDE = 8 };
    static double p[BOXES * 8][3], spans[BOXES][2];
    static uint32_t t[BOXES * 36];
    const tetcast_lattice l = cube_lattice(105, 9, 9);
    float *v = (float *)calloc(node_count(&l), 4), length[SIDE * SIDE];
    tetcast_clip_body body;
    tetcast_clip_desc d;
    tetcast_clip *c = NULL;
    tetcast_bricks *b;
    tetcast_cut *cut;
    tetcast_optics *o = flat_optics(1e-3f, TETCAST_MODEL_VOLUME);
    tetcast_brick_render_desc bd;
    tetcast_rbf_render_desc fd;
    tetcast_rbf_desc rd;
    tetcast_rbf *f = NULL;
    tetcast_image image;
    tetcast_ray ray;
    float rgba[SIDE * SIDE * 4];
    int i, k, outside;
    REQUIRE(v != NULL);
    for (i = 0; i < BOXES * 8; i++) { /* from 1/4 to 1/2 behind each whole number */
        const double side = i >> 1 & 1 ? 20.0 : -20.0, up = i >> 2 & 1 ? 20.0 : -20.0;
        p[i][0] = i / 8 + (i & 1 ? 0.5 : 0.25);
        p[i][1] = side;
        p[i][2] = up;
    }
    for (i = 0; i < BOXES; i++) for (k = 0; k < 36; k++) t[36 * i + k] = g_cube[k] + 8 * (uint32_t)i;
    b = make_bricks(&l, v, TETCAST_TYPE_F32, 3, 0);
    cut = make_cut(b, NULL, 0);
    memset(&rd, 0, sizeof rd);
    rd.box_max[0] = 104.0;
    rd.box_max[1] = rd.box_max[2] = 8.0;
    REQUIRE(tetcast_rbf_create(&rd, &f) == TETCAST_OK);
    for (outside = 0; outside < 2; outside++) {
        memset(&body, 0, sizeof body);
        memset(&d, 0, sizeof d);
        memset(&ray, 0, sizeof ray);
        body.points = (const double (*)[3])p;
        body.point_count = BOXES * 8;
        body.indices = t;
        body.triangle_count = BOXES * 12;
        body.outside = (uint32_t)outside;
        d.bodies = &body;
        d.body_count = 1;
        REQUIRE(tetcast_clip_create(&d, &c) == TETCAST_OK);
        ray.org[0] = -5.0;
        ray.org[1] = 0.3;
        ray.dir[0] = 2.0;
        ray.t_max = 1e6;
        CHECK_EQ_U64(tetcast_clip_spans(c, &ray, spans, BOXES), BOXES + (uint32_t)outside);
        for (i = 0; i < BOXES; i++) {
            CHECK_NEAR(spans[i][0], outside ? (i ? 4.5 + i : 0.0) : 5.25 + i, 1e-12);
            CHECK_NEAR(spans[i][1], outside ? 5.25 + i : 5.5 + i, 1e-12);
        }
        spans[3][0] = -1.0;
        CHECK_EQ_U64(tetcast_clip_spans(c, &ray, spans, 3), BOXES + (uint32_t)outside); /* no more than there is room for */
        CHECK(spans[3][0] < 0.0);
        memset(&bd, 0, sizeof bd);
        memset(&fd, 0, sizeof fd);
        memset(&image, 0, sizeof image);
        bd.camera.eye[0] = -20.0;
        bd.camera.eye[1] = bd.camera.eye[2] = bd.camera.at[1] = bd.camera.at[2] = 4.0;
        bd.camera.up[1] = 1.0;
        bd.camera.ortho_height = 6.0f;
        bd.clip = fd.clip = c;
        fd.camera = bd.camera;
        fd.step = 0.4f;
        image.width = image.height = SIDE;
        image.rgba = rgba;
        image.length = length;
        CHECK_EQ_U64(tetcast_render_bricks(&bd, cut, o, &image, NULL), TETCAST_OK);
        for (i = 0; i < SIDE * SIDE; i++) CHECK_NEAR(length[i], outside ? 79.0 : 25.0, 1e-3);
        for (i = 0; i < SIDE * SIDE; i++) CHECK_NEAR(rgba[4 * i + 3], 1.0 - exp(outside ? -0.079 : -0.025), 1e-5);
        image.length = NULL;
        CHECK_EQ_U64(tetcast_rbf_render(&fd, f, o, &image, NULL), TETCAST_OK);
        for (i = 0; i < SIDE * SIDE; i++) CHECK_NEAR(rgba[4 * i + 3], 1.0 - exp(outside ? -0.079 : -0.025), 1e-5);
        tetcast_clip_destroy(c);
    }
    tetcast_rbf_destroy(f);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    free(v);
}

/* Gradients as colours, of every third lane none that is a number. */
static void gradient_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    uint32_t i, a;
    for (i = 0; i < 8; i++) {
        if (!(in->mask >> i & 1u)) continue;
        for (a = 0; a < 3; a++) rgba[a][i] = i % 3 == 2 ? (float)(a == 0 ? NAN : INFINITY) : in->gradient[a][i] * in->length[i];
        rgba[3][i] = i == 5 ? (float)NAN : i == 6 ? -1.0f : 0.02f * in->length[i];
    }
    (void)user;
}

/* Eight lanes and one by one: the same bits for all kinds of storage, with levels that differ. */
TEST(shaders_same_bits) {
    enum { W = 44, H = 33 };
    static const tetcast_type types[4] = {TETCAST_TYPE_F32, TETCAST_TYPE_F16, TETCAST_TYPE_U16, TETCAST_TYPE_U8};
    static float a[2][W * H * 4], depth[2][W * H];
    const tetcast_lattice l = cube_lattice(40, 33, 26);
    float *v = (float *)malloc(node_count(&l) * 4);
    test_rng r = test_rng_make(12);
    size_t i;
    int t, k, adapted;
    REQUIRE(v != NULL);
    for (i = 0; i < node_count(&l); i++) v[i] = test_rng_float(&r);
    for (t = 0; t < 4; t++)
        for (adapted = 0; adapted < 2; adapted++) {
            tetcast_bricks *b = make_bricks(&l, v, types[t], 3, 0);
            tetcast_cut_desc cd;
            tetcast_cut *c = NULL;
            tetcast_brick_render_desc d;
            tetcast_shader s;
            uint8_t levels[5 * 4 * 4];
            for (i = 0; i < sizeof levels; i++) levels[i] = (uint8_t)(adapted ? test_rng_below(&r, 3) : 0);
            memset(&cd, 0, sizeof cd);
            memset(&s, 0, sizeof s);
            cd.levels = levels;
            REQUIRE(tetcast_cut_create(&cd, b, &c) == TETCAST_OK);
            box_view(&d, &l, 1);
            s.needs = TETCAST_NEED_GRADIENT;
            s.shade_fn = gradient_shade;
            d.shader = &s;
            for (k = 0; k < 2; k++) {
                tetcast_image image;
                memset(&image, 0, sizeof image);
                image.width = W;
                image.height = H;
                image.rgba = a[k];
                image.depth = depth[k];
                d.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
                CHECK_EQ_U64(tetcast_render_bricks(&d, c, NULL, &image, NULL), TETCAST_OK);
            }
            CHECK_MSG(memcmp(a[0], a[1], sizeof a[0]) == 0 && memcmp(depth[0], depth[1], sizeof depth[0]) == 0, "%d %d", t, adapted);
            for (i = 0; i < W * H * 4; i++) CHECK(isfinite(a[0][i]));
            CHECK(a[0][4 * (H / 2 * W + W / 2) + 3] > 0.0f);
            tetcast_cut_destroy(c);
            tetcast_bricks_destroy(b);
        }
    free(v);
}

/* Where a ray is inside of a tetrahedron. */
static int ray_in_tet(const tets *m, size_t cell, const tetcast_ray *ray, double ends[2]) {
    int i, a;
    ends[0] = 0.0;
    ends[1] = 1e300;
    for (i = 0; i < 4; i++) {
        const double *p = m->p + 3 * m->t[4 * cell + (size_t)((i + 1) & 3)], *q = m->p + 3 * m->t[4 * cell + (size_t)((i + 2) & 3)];
        const double *r = m->p + 3 * m->t[4 * cell + (size_t)((i + 3) & 3)], *o = m->p + 3 * m->t[4 * cell + (size_t)i];
        double u[3], v[3], n[3], side = 0, height = 0, along = 0;
        for (a = 0; a < 3; a++) {
            u[a] = q[a] - p[a];
            v[a] = r[a] - p[a];
        }
        for (a = 0; a < 3; a++) n[a] = u[(a + 1) % 3] * v[(a + 2) % 3] - u[(a + 2) % 3] * v[(a + 1) % 3];
        for (a = 0; a < 3; a++) {
            side += n[a] * (o[a] - p[a]);
            height += n[a] * (ray->org[a] - p[a]);
            along += n[a] * ray->dir[a];
        }
        if (side < 0) {
            height = -height;
            along = -along;
        }
        if (along > 0) ends[0] = fmax(ends[0], -height / along);
        else if (along < 0) ends[1] = fmin(ends[1], -height / along);
        else if (height < 0) return 0;
    }
    return ends[1] > ends[0];
}

enum { SHADED_W = 48, SHADED_H = 40, SHADED_N = SHADED_W * SHADED_H };
typedef struct shaded_tets { /* a mesh of linear values, two pictures of it, the second with the way and the depth of each pixel */
    tets m;
    tetcast_mesh *mesh;
    tetcast_mesh_info info;
    tetcast_optics *o;
    tetcast_shade_desc d;
    tetcast_image image;
    float a[4 * SHADED_N], b[4 * SHADED_N], length[SHADED_N], depth[SHADED_N];
} shaded_tets;

static int shaded_tets_make(shaded_tets *s) {
    memset(s, 0, sizeof *s);
    s->o = flat_optics(0.3f, TETCAST_MODEL_VOLUME);
    tets_lattice(&s->m, 6, 6, 6, 5, NULL);
    tets_jitter(&s->m, 6, 6, 6, 0.5, 3);
    make_linear(&s->m);
    s->mesh = tets_build(&s->m, TETCAST_CELLS_TET16, NULL);
    if (s->mesh == NULL) return 0;
    tetcast_mesh_get_info(s->mesh, &s->info);
    s->d.camera.fov_y = 50.0f;
    CHECK_EQ_U64(tetcast_camera_fit(&s->d.camera, s->info.box_min, s->info.box_max, NULL, SHADED_W, SHADED_H), TETCAST_OK);
    s->image.width = SHADED_W;
    s->image.height = SHADED_H;
    s->image.rgba = s->b;
    s->image.length = s->length;
    s->image.depth = s->depth;
    return 1;
}

/* Without a shader the picture is the walker's, which is left in a. */
static void shaded_as_walked(shaded_tets *s) {
    static float length[SHADED_N], depth[SHADED_N];
    tetcast_render_desc rd;
    tetcast_image image = s->image;
    double worst = 0, worst_length = 0;
    uint32_t i, k;
    memset(&rd, 0, sizeof rd);
    rd.camera = s->d.camera;
    image.rgba = s->a;
    image.length = length;
    image.depth = depth;
    CHECK_EQ_U64(tetcast_render(&rd, s->mesh, s->o, &image, NULL), TETCAST_OK);
    CHECK_EQ_U64(tetcast_render_shaded(&s->d, s->mesh, s->o, &s->image, NULL), TETCAST_OK);
    for (i = 0; i < SHADED_N; i++) {
        for (k = 0; k < 4; k++) worst = fmax(worst, fabs((double)s->a[4 * i + k] - (double)s->b[4 * i + k]));
        worst_length = fmax(worst_length, fabs((double)length[i] - (double)s->length[i]));
        CHECK((depth[i] < INFINITY) == (s->depth[i] < INFINITY));
        if (depth[i] < INFINITY) CHECK_NEAR((double)depth[i], (double)s->depth[i], 1e-4);
    }
    CHECK_MSG(worst < 1e-5 && worst_length < 1e-4, "%g %g", worst, worst_length);
}

/* What a shader is told of the mesh; it makes the same picture as the optics did. */
static void shaded_by_probe(shaded_tets *s) {
    probe_shader probe = {0, 0};
    tetcast_param param = {"density", NULL, 1};
    tetcast_shader shader;
    float density = 0.3f;
    double worst = 0;
    uint32_t i;
    memset(&shader, 0, sizeof shader);
    shader.user = &probe;
    shader.needs = TETCAST_NEED_GRADIENT | TETCAST_NEED_POSITION | TETCAST_NEED_DIRECTION;
    shader.prepare_fn = probe_prepare;
    shader.shade_fn = probe_shade;
    shader.params = &param;
    shader.param_count = 1;
    s->d.shader = &shader;
    CHECK_EQ_U64(tetcast_render_shaded(&s->d, s->mesh, NULL, &s->image, NULL), TETCAST_ERR_INVALID_ARG);
    param.values = &density;
    CHECK_EQ_U64(tetcast_render_shaded(&s->d, s->mesh, NULL, &s->image, NULL), TETCAST_OK);
    for (i = 0; i < SHADED_N; i++) {
        worst = fmax(worst, fabs((double)s->a[4 * i + 3] - (double)s->b[4 * i + 3]));
        worst = fmax(worst, fabs((double)s->b[4 * i] - (double)s->b[4 * i + 3])); /* all of it fitted */
    }
    CHECK_MSG(worst < 3e-3, "%g", worst); /* a ray ends with 1/512 */
    s->d.shader = NULL;
}

/* Half of the mesh is cut away by a plane, and a hole is in it. */
static tetcast_clip *clip_with_hole(const tetcast_mesh_info *info) {
    double corner[8][3];
    tetcast_clip_desc cd;
    tetcast_clip_plane plane;
    tetcast_clip_body body;
    tetcast_clip *clip = NULL;
    memset(&cd, 0, sizeof cd);
    memset(&plane, 0, sizeof plane);
    memset(&body, 0, sizeof body);
    plane.normal[0] = 1.0;
    plane.offset = 0.5 * (info->box_min[0] + info->box_max[0]);
    cube_points(corner, 1.0, 3.5);
    body.points = (const double (*)[3])corner;
    body.point_count = 8;
    body.indices = g_cube;
    body.triangle_count = 12;
    body.outside = 1;
    cd.planes = &plane;
    cd.plane_count = 1;
    cd.bodies = &body;
    cd.body_count = 1;
    CHECK_EQ_U64(tetcast_clip_create(&cd, &clip), TETCAST_OK);
    return clip;
}

/* Ways through what is left, against spans of the clip and the mesh, which is convex. */
static void clipped_lengths(shaded_tets *s) {
    double worst = 0, worst_length = 0;
    uint32_t i;
    CHECK_EQ_U64(tetcast_render_shaded(&s->d, s->mesh, s->o, &s->image, NULL), TETCAST_OK);
    for (i = 0; i < SHADED_N; i++) {
        tetcast_ray ray;
        double span[8][2], want = 0, ends[2] = {0, 0}, enter = 1e300, leave = 0;
        uint32_t n, q;
        CHECK_EQ_U64(tetcast_camera_ray(&s->d.camera, SHADED_W, SHADED_H, i % SHADED_W + 0.5, i / SHADED_W + 0.5, &ray), TETCAST_OK);
        n = tetcast_clip_spans(s->d.clip, &ray, span, 8);
        REQUIRE(n <= 8);
        for (q = 0; q < s->m.nt; q++) { /* where the ray is in any tetrahedron */
            if (!ray_in_tet(&s->m, q, &ray, ends)) continue;
            enter = fmin(enter, ends[0]);
            leave = fmax(leave, ends[1]);
        }
        for (q = 0; q < n; q++)
            if (fmin(span[q][1], leave) > fmax(span[q][0], enter)) want += fmin(span[q][1], leave) - fmax(span[q][0], enter);
        worst_length = fmax(worst_length, fabs(want - (double)s->length[i]));
        worst = fmax(worst, fabs(1.0 - exp(-0.3 * want) - (double)s->b[4 * i + 3]));
    }
    CHECK_MSG(worst_length < 1e-4 && worst < 1e-4, "%g %g", worst_length, worst);
}

/* In four parts, by three threads: the same bits. */
static void shaded_in_parts(shaded_tets *s) {
    uint32_t k;
    s->d.env.thread_count = 3;
    s->d.frame[0] = SHADED_W;
    s->d.frame[1] = SHADED_H;
    for (k = 0; k < 4; k++) {
        tetcast_image quarter = s->image;
        s->d.part[0] = k & 1u ? 20 : 0;
        s->d.part[1] = k >> 1 ? 9 : 0;
        quarter.width = k & 1u ? SHADED_W - 20 : 20;
        quarter.height = k >> 1 ? SHADED_H - 9 : 9;
        quarter.rgba = s->a + 4 * (s->d.part[1] * SHADED_W + s->d.part[0]);
        quarter.rgba_stride = SHADED_W * 16;
        quarter.length = quarter.depth = NULL;
        CHECK_EQ_U64(tetcast_render_shaded(&s->d, s->mesh, s->o, &quarter, NULL), TETCAST_OK);
    }
    CHECK(memcmp(s->a, s->b, sizeof s->a) == 0);
    memset(s->d.frame, 0, sizeof s->d.frame);
    memset(s->d.part, 0, sizeof s->d.part);
}

/* What is before a plane of the view over what is behind it: the picture of both. */
static void shaded_before_and_behind(shaded_tets *s) {
    static float whole[4 * SHADED_N];
    double worst = 0;
    uint32_t i;
    memcpy(whole, s->b, sizeof whole);
    s->d.clip_far = 7.0f;
    CHECK_EQ_U64(tetcast_render_shaded(&s->d, s->mesh, s->o, &s->image, NULL), TETCAST_OK);
    memcpy(s->a, s->b, sizeof s->a);
    s->d.clip_near = 7.0f;
    s->d.clip_far = 0.0f;
    CHECK_EQ_U64(tetcast_render_shaded(&s->d, s->mesh, s->o, &s->image, NULL), TETCAST_OK);
    tetcast_over(s->a, s->b, SHADED_N);
    for (i = 0; i < 4 * SHADED_N; i++) worst = fmax(worst, fabs((double)s->a[i] - (double)whole[i]));
    CHECK_MSG(worst < 1e-5, "%g", worst);
}

/* Tetrahedra ray by ray: the picture of the walker, what a shader is told, half of a body cut away, parts of a frame. */
TEST(shaded_tetrahedra) {
    static shaded_tets s;
    tetcast_clip *clip;
    REQUIRE(shaded_tets_make(&s));
    shaded_as_walked(&s);
    shaded_by_probe(&s);
    clip = clip_with_hole(&s.info);
    REQUIRE(clip != NULL);
    s.d.clip = clip;
    s.d.env.thread_count = 1;
    clipped_lengths(&s);
    shaded_in_parts(&s);
    shaded_before_and_behind(&s);
    tetcast_clip_destroy(clip);
    tetcast_mesh_destroy(s.mesh);
    tetcast_optics_destroy(s.o);
    tets_free(&s.m);
}

static void half_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    uint32_t i, a;
    (void)user;
    for (i = 0; i < 8; i++)
        for (a = 0; a < 4 && (in->mask >> i & 1u) != 0; a++) rgba[a][i] = 0.5f;
}

/* Cells that are masked, or have a value that is no number, show nothing: as in the walker's picture. */
TEST(shaded_without_hidden_cells) {
    enum { W = 40, H = 32 };
    static float rgba[3][W * H * 4], length[2][W * H];
    static uint8_t masks[6 * 6 * 6 * 8];
    tetcast_optics *o = flat_optics(0.6f, TETCAST_MODEL_VOLUME);
    uint32_t kind, i, c;
    REQUIRE(o != NULL);
    for (kind = 0; kind < 3; kind++) { /* masked; NaN at some vertices; all masked */
        tets m;
        tetcast_field f;
        tetcast_input in;
        tetcast_mesh *mesh = NULL;
        tetcast_mesh_info info;
        tetcast_shade_desc d;
        tetcast_render_desc rd;
        tetcast_shader s;
        tetcast_image image;
        double worst = 0, worst_length = 0, seen = 0;
        memset(&m, 0, sizeof m);
        memset(&f, 0, sizeof f);
        memset(&in, 0, sizeof in);
        memset(&d, 0, sizeof d);
        memset(&rd, 0, sizeof rd);
        memset(&s, 0, sizeof s);
        memset(&image, 0, sizeof image);
        tets_lattice(&m, 6, 6, 6, 5, NULL);
        make_linear(&m);
        REQUIRE(m.nt <= sizeof masks);
        for (i = 0; i < m.nt; i++) masks[i] = (uint8_t)(kind == 2 || i * 7 % 11 < 4);
        for (i = 0; kind == 1 && i < m.nv; i += 23) m.s[i] = (float)NAN;
        f.values.data = m.s;
        in.positions.data = m.p;
        in.positions.type = TETCAST_TYPE_F64;
        in.vertex_count = m.nv;
        in.indices = m.t;
        in.index_count = 4 * m.nt;
        in.cell_count = m.nt;
        in.masks = kind == 1 ? NULL : masks;
        in.fields = &f;
        in.field_count = 1;
        CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &mesh), TETCAST_OK);
        REQUIRE(mesh != NULL);
        tetcast_mesh_get_info(mesh, &info);
        d.camera.fov_y = 50.0f;
        CHECK_EQ_U64(tetcast_camera_fit(&d.camera, info.box_min, info.box_max, NULL, W, H), TETCAST_OK);
        rd.camera = d.camera;
        image.width = W;
        image.height = H;
        image.rgba = rgba[0];
        image.length = length[0];
        CHECK_EQ_U64(tetcast_render(&rd, mesh, o, &image, NULL), TETCAST_OK);
        image.rgba = rgba[1];
        image.length = length[1];
        CHECK_EQ_U64(tetcast_render_shaded(&d, mesh, o, &image, NULL), TETCAST_OK);
        s.shade_fn = half_shade;
        d.shader = &s;
        image.rgba = rgba[2];
        image.length = NULL;
        CHECK_EQ_U64(tetcast_render_shaded(&d, mesh, NULL, &image, NULL), TETCAST_OK);
        for (i = 0; i < W * H; i++) {
            for (c = 0; c < 4; c++)
                worst = fmax(worst, fabs((double)rgba[0][4 * i + c] - (double)rgba[1][4 * i + c]));
            worst_length = fmax(worst_length, fabs((double)length[0][i] - (double)length[1][i]));
            CHECK((rgba[2][4 * i + 3] > 0.0f) == (rgba[0][4 * i + 3] > 0.0f));
            seen = fmax(seen, (double)rgba[0][4 * i + 3]);
        }
        CHECK_MSG(worst < 1e-5 && worst_length < 1e-4, "%u: %g %g", kind, worst, worst_length);
        CHECK(kind == 2 ? seen == 0.0 : seen > 0.5);
        tetcast_mesh_destroy(mesh);
        tets_free(&m);
    }
    tetcast_optics_destroy(o);
}

/* A square, cut along one diagonal by the tetrahedra before it and along the other one by those behind: the values jump
   in the flat tetrahedron between, and the surface is nowhere else in half of the picture. */
TEST(shaded_surface_in_a_flat_cell) {
    enum { W = 32 };
    static const float position[6][3] = {{0, 0, 0}, {0, 1, 0}, {0, 1, 1}, {0, 0, 1}, {-1, 0.5f, 0.5f}, {1, 0.5f, 0.5f}};
    static const float value[6] = {1, 0, 1, 0, 1, 0};
    static const uint32_t index[5][4] = {{0, 1, 2, 4}, {0, 2, 3, 4}, {0, 1, 2, 3}, {0, 1, 3, 5}, {1, 2, 3, 5}};
    static float rgba[2][W * W * 4], depth[2][W * W];
    tetcast_field f;
    tetcast_input in;
    tetcast_mesh *mesh = NULL;
    tetcast_isovalue iso;
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    tetcast_shade_desc d;
    tetcast_render_desc rd;
    tetcast_image image;
    uint32_t i, seen = 0;
    memset(&f, 0, sizeof f);
    memset(&in, 0, sizeof in);
    memset(&iso, 0, sizeof iso);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    memset(&d, 0, sizeof d);
    memset(&rd, 0, sizeof rd);
    memset(&image, 0, sizeof image);
    f.values.data = value;
    in.positions.data = position;
    in.vertex_count = 6;
    in.indices = index[0];
    in.index_count = 20;
    in.cell_count = 5;
    in.fields = &f;
    in.field_count = 1;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &mesh), TETCAST_OK);
    REQUIRE(mesh != NULL);
    iso.value = 0.5f;
    iso.rgb[0] = iso.rgb[1] = iso.rgb[2] = iso.opacity = 1.0f;
    td.isovalues = &iso;
    td.isovalue_count = 1;
    od.model = TETCAST_MODEL_ISOSURFACE;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &t), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(t, &od, &o), TETCAST_OK);
    REQUIRE(o != NULL);
    d.camera.eye[0] = -5;
    d.camera.eye[1] = d.camera.eye[2] = d.camera.at[1] = d.camera.at[2] = 0.5;
    d.camera.ortho_height = 1.0f;
    rd.camera = d.camera;
    image.width = image.height = W;
    image.rgba = rgba[0];
    image.depth = depth[0];
    CHECK_EQ_U64(tetcast_render(&rd, mesh, o, &image, NULL), TETCAST_OK);
    image.rgba = rgba[1];
    image.depth = depth[1];
    CHECK_EQ_U64(tetcast_render_shaded(&d, mesh, o, &image, NULL), TETCAST_OK);
    for (i = 0; i < 4 * W * W; i++) CHECK_NEAR((double)rgba[0][i], (double)rgba[1][i], 1e-5);
    for (i = 0; i < W * W; i++) {
        seen += rgba[0][4 * i + 3] > 0.5f;
        CHECK((depth[0][i] < INFINITY) == (depth[1][i] < INFINITY));
        if (depth[0][i] < INFINITY) CHECK_NEAR((double)depth[0][i], (double)depth[1][i], 1e-4);
    }
    CHECK(seen >= W * W / 2);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
    tetcast_mesh_destroy(mesh);
}

/* A flat tetrahedron in which no isovalue lies shows nothing, and has no depth: that of the one behind it, or none. */
TEST(shaded_depth_of_flat_cells) {
    static const float position[8][3] = {{-1, -1, 1}, {1, -1, 1}, {1, 1, 1}, {-1, 1, 1}, {-1, -1, 0}, {1, -1, 0}, {0, 1, 0}, {0, 0, -1}};
    static const float value[8] = {0.7f, 0.8f, 0.9f, 0.75f, 0.7f, 0.7f, 0.7f, 0.8f};
    static const uint32_t index[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    const tetcast_control_point points[2] = {{0.0f, {1, 1, 1}, 0.5f}, {1.0f, {1, 1, 1}, 0.5f}};
    tetcast_field f;
    tetcast_input in;
    tetcast_isovalue iso;
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_mesh *mesh = NULL;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    uint32_t k;
    memset(&f, 0, sizeof f);
    memset(&in, 0, sizeof in);
    memset(&iso, 0, sizeof iso);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    f.values.data = value;
    in.positions.data = position;
    in.vertex_count = 8;
    in.indices = index;
    in.index_count = 8;
    in.cell_count = 2;
    in.fields = &f;
    in.field_count = 1;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &mesh), TETCAST_OK);
    iso.opacity = 0.5f;
    td.points = points;
    td.point_count = 2;
    td.isovalues = &iso;
    td.isovalue_count = 1;
    od.model = TETCAST_MODEL_MIXED;
    for (k = 0; k < 6; k++) { /* at the tetrahedron, and beside it; a surface in neither, in both, in the flat one only */
        const float want = k < 3 ? 5.0f : (float)INFINITY;
        float rgba[2][4], depth[2];
        tetcast_shade_desc d;
        tetcast_render_desc rd;
        tetcast_image image;
        memset(&d, 0, sizeof d);
        memset(&rd, 0, sizeof rd);
        memset(&image, 0, sizeof image);
        iso.value = k % 3 == 0 ? 0.3f : k % 3 == 1 ? 0.78f : 0.87f;
        CHECK_EQ_U64(tetcast_transfer_create(&td, &t), TETCAST_OK);
        CHECK_EQ_U64(tetcast_optics_create(t, &od, &o), TETCAST_OK);
        REQUIRE(mesh != NULL && o != NULL);
        d.camera.eye[0] = d.camera.at[0] = k < 3 ? 0.05 : 0.9;
        d.camera.eye[1] = d.camera.at[1] = k < 3 ? -0.1 : 0.85;
        d.camera.eye[2] = 5.0;
        d.camera.fov_y = 10.0f;
        rd.camera = d.camera;
        image.width = image.height = 1;
        image.rgba = rgba[0];
        image.depth = &depth[0];
        CHECK_EQ_U64(tetcast_render(&rd, mesh, o, &image, NULL), TETCAST_OK);
        image.rgba = rgba[1];
        image.depth = &depth[1];
        CHECK_EQ_U64(tetcast_render_shaded(&d, mesh, o, &image, NULL), TETCAST_OK);
        CHECK_NEAR((double)rgba[0][3], (double)rgba[1][3], 1e-6);
        if (k % 3 == 0) CHECK(rgba[0][3] > 0.0f ? fabsf(depth[1] - want) < 1e-5f : depth[1] == want);
        CHECK((depth[0] < (float)INFINITY) == (depth[1] < (float)INFINITY));
        if (depth[0] < (float)INFINITY) CHECK_NEAR((double)depth[0], (double)depth[1], 1e-5);
        tetcast_optics_destroy(o);
        tetcast_transfer_destroy(t);
    }
    tetcast_mesh_destroy(mesh);
}

static int first_front(void *user, const tetcast_crossing *x) {
    *(double *)user = x->t_front;
    return 1;
}

/* A cube of eight, its middle in the origin. */
static tetcast_mesh *cube_of_size(double size) {
    static float value[27];
    tetcast_grid g;
    tetcast_field f;
    tetcast_mesh *mesh = NULL;
    uint32_t i;
    memset(&g, 0, sizeof g);
    memset(&f, 0, sizeof f);
    for (i = 0; i < 27; i++) value[i] = 0.5f + 0.01f * (float)i;
    for (i = 0; i < 3; i++) {
        g.dims[i] = 3;
        g.origin[i] = -0.5 * size;
        g.spacing[i] = 0.5 * size;
    }
    f.values.data = value;
    g.fields = &f;
    g.field_count = 1;
    CHECK_EQ_U64(tetcast_mesh_create_grid(NULL, &g, NULL, &mesh), TETCAST_OK);
    return mesh;
}

/* The distances of a ray to tetrahedra are right from far away, and so is what clip_far leaves. */
TEST(shaded_from_far_away) {
    enum { W = 5, H = 5 };
    static float rgba[W * H * 4], length[W * H], depth[W * H];
    tetcast_mesh *mesh = cube_of_size(1.0);
    tetcast_optics *o = flat_optics(0.3f, TETCAST_MODEL_VOLUME);
    test_rng r = test_rng_make(34);
    double far;
    uint32_t i;
    REQUIRE(mesh != NULL && o != NULL);
    for (far = 10.0; far < 2e10; far *= 10.0) { /* each is a float */
        tetcast_shade_desc d;
        tetcast_image image;
        for (i = 0; i < 50; i++) {
            tetcast_ray ray;
            double front = -1.0;
            memset(&ray, 0, sizeof ray);
            ray.org[0] = 0.011;
            ray.org[1] = 0.023;
            ray.org[2] = far * (1.0 + (double)test_rng_float(&r));
            ray.dir[2] = -1.0;
            CHECK(tetcast_probe(mesh, &ray, first_front, &front) == 1);
            CHECK_NEAR(front, ray.org[2] - 0.5, 1e-6 + 4e-16 * ray.org[2]);
        }
        memset(&d, 0, sizeof d);
        memset(&image, 0, sizeof image);
        d.camera.eye[0] = d.camera.at[0] = 0.011; /* on no face */
        d.camera.eye[1] = d.camera.at[1] = 0.023;
        d.camera.eye[2] = far;
        d.camera.ortho_height = 0.5f;
        d.clip_far = (float)far;
        image.width = W;
        image.height = H;
        image.rgba = rgba;
        image.length = length;
        image.depth = depth;
        CHECK_EQ_U64(tetcast_render_shaded(&d, mesh, o, &image, NULL), TETCAST_OK);
        for (i = 0; i < W * H; i++) {
            const double want = fmin(fmax((double)d.clip_far - (far - 0.5), 0.0), 1.0);
            CHECK_NEAR((double)length[i], want, 1e-5 + 4e-16 * far);
            CHECK_NEAR((double)rgba[4 * i + 3], 1.0 - exp(-(double)0.3f * want), 1e-5 + 4e-16 * far);
        }
    }
    tetcast_optics_destroy(o);
    tetcast_mesh_destroy(mesh);
}

/* Lengths that no float holds: no NaN, and the same as tetcast_render. */
TEST(shaded_meshes_of_any_size) {
    enum { W = 5, H = 4 };
    static float rgba[2][W * H * 4], length[2][W * H], depth[2][W * H];
    static const float extinction[3] = {0.0f, 1e-30f, 1.0f};
    double size;
    uint32_t i, k, q;
    for (size = 1e20; size < 2e95; size *= 1e15)
        for (q = 0; q < 6; q++) {
            tetcast_mesh *mesh = cube_of_size(size);
            tetcast_optics *o = flat_optics(extinction[q % 3], q < 3 ? TETCAST_MODEL_VOLUME : TETCAST_MODEL_ABSORPTION);
            tetcast_shade_desc d;
            tetcast_render_desc rd;
            tetcast_image image;
            REQUIRE(mesh != NULL && o != NULL);
            memset(&d, 0, sizeof d);
            memset(&rd, 0, sizeof rd);
            memset(&image, 0, sizeof image);
            d.background[0] = d.background[3] = rd.background[0] = rd.background[3] = 1.0f;
            image.width = W;
            image.height = H;
            for (k = 0; k < 2; k++) {
                image.rgba = rgba[k];
                image.length = length[k];
                image.depth = depth[k];
                CHECK_EQ_U64(k ? tetcast_render_shaded(&d, mesh, o, &image, NULL) : tetcast_render(&rd, mesh, o, &image, NULL), TETCAST_OK);
            }
            for (i = 0; i < 4 * W * H; i++) CHECK_NEAR((double)rgba[0][i], (double)rgba[1][i], 1e-5);
            for (i = 0; i < W * H; i++) {
                CHECK((depth[0][i] < INFINITY) == (depth[1][i] < INFINITY));
                if (length[0][i] < INFINITY) CHECK_NEAR((double)length[0][i], (double)length[1][i], 1e-5 * (double)length[0][i]);
                if (depth[0][i] < INFINITY) CHECK_NEAR((double)depth[0][i], (double)depth[1][i], 1e-5 * (double)depth[0][i]);
            }
            tetcast_optics_destroy(o);
            tetcast_mesh_destroy(mesh);
        }
}

/* A lattice of ones with a side of one node: as thick as its spacing there, whatever side it is seen from, and framed with that. */
TEST(thin_layers) {
    enum { W = 7, H = 5 };
    static const float one[81] = {
        1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
        1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    static float rgba[2][W * H * 4], length[2][W * H];
    uint32_t axis, side, isa, i, a;
    for (axis = 0; axis < 3; axis++)
        for (side = 0; side < 4; side++) { /* two with rays along the axis, two at an angle */
            tetcast_bricks_desc bd;
            tetcast_brick_render_desc d;
            tetcast_lattice l;
            tetcast_array values;
            tetcast_bricks *b = NULL;
            tetcast_cut *cut = NULL;
            tetcast_optics *o = flat_optics(1.0f, TETCAST_MODEL_VOLUME);
            tetcast_image image;
            const double slant = side < 2 ? 0.0 : 0.75;
            memset(&bd, 0, sizeof bd); memset(&d, 0, sizeof d); memset(&l, 0, sizeof l);
            memset(&values, 0, sizeof values); memset(&image, 0, sizeof image);
            for (a = 0; a < 3; a++) {
                l.dims[a] = a == axis ? 1 : 9;
                l.spacing[a] = a == axis ? 0.3 : 1.0;
                d.camera.eye[a] = d.camera.at[a] = a == axis ? 0.0 : 4.1;
            }
            d.camera.eye[axis] = side & 1 ? -8.0 : 8.0;
            d.camera.eye[(axis + 1) % 3] += 8.0 * slant;
            d.camera.ortho_height = 1.0f;
            values.data = one;
            bd.log_cells = 3;
            CHECK_EQ_U64(tetcast_bricks_create_grid(&bd, &l, &values, NULL, &b), TETCAST_OK);
            CHECK_EQ_U64(tetcast_cut_create(NULL, b, &cut), TETCAST_OK);
            image.width = W;
            image.height = H;
            for (isa = 0; isa < 2; isa++) {
                image.rgba = rgba[isa];
                image.length = length[isa];
                d.isa = isa ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
                CHECK_EQ_U64(tetcast_render_bricks(&d, cut, o, &image, NULL), TETCAST_OK);
            }
            CHECK(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0 && memcmp(length[0], length[1], sizeof length[0]) == 0);
            for (i = 0; i < W * H; i++) {
                const double want = 0.3 * sqrt(1.0 + slant * slant);
                CHECK_NEAR((double)length[0][i], want, 1e-6);
                CHECK_NEAR((double)rgba[0][4 * i + 3], 1.0 - exp(-want), 1e-5);
            }
            tetcast_cut_destroy(cut);
            tetcast_bricks_destroy(b);
            for (a = 0; a < 3; a++) { /* one node: the camera has it in the middle, whatever its size */
                l.dims[a] = 1;
                l.spacing[a] = side == 0 ? 1.0 : side == 1 ? 1e-12 : 1e12;
            }
            CHECK_EQ_U64(tetcast_bricks_create_grid(&bd, &l, &values, NULL, &b), TETCAST_OK);
            CHECK_EQ_U64(tetcast_cut_create(NULL, b, &cut), TETCAST_OK);
            memset(&d, 0, sizeof d);
            CHECK_EQ_U64(tetcast_render_bricks(&d, cut, o, &image, NULL), TETCAST_OK);
            CHECK((double)length[1][W * H / 2] > 0.9 * l.spacing[0] && length[1][0] == 0.0f && length[1][W * H - 1] == 0.0f);
            tetcast_cut_destroy(cut);
            tetcast_bricks_destroy(b);
            tetcast_optics_destroy(o);
        }
}

static void place_shade(void *user, const tetcast_packet *in, float rgba[4][8]) { /* the field is x */
    double *worst = (double *)user;
    int i;
    (void)rgba;
    for (i = 0; i < 8; i++)
        if (in->mask >> i & 1u) {
            worst[0] = fmax(worst[0], fabs((double)in->position[0][i] - 0.5 * ((double)in->front[i] + (double)in->back[i])));
            worst[1] += 1.0;
        }
}

TEST(places_for_shaders_from_far_away) {
    enum { N = 9, W = 6, H = 6 };
    static float v[N * N * N], rgba[W * H * 4];
    tetcast_bricks_desc bd;
    tetcast_lattice l;
    tetcast_array values;
    tetcast_bricks *b = NULL;
    tetcast_cut *cut = NULL;
    tetcast_shader s;
    double worst[2] = {0.0, 0.0}, away;
    uint32_t i, isa;
    memset(&bd, 0, sizeof bd); memset(&l, 0, sizeof l); memset(&values, 0, sizeof values); memset(&s, 0, sizeof s);
    for (i = 0; i < N * N * N; i++) v[i] = 0.125f * (float)(i % N);
    for (i = 0; i < 3; i++) {
        l.dims[i] = N;
        l.spacing[i] = 0.125;
    }
    values.data = v;
    bd.log_cells = 3;
    CHECK_EQ_U64(tetcast_bricks_create_grid(&bd, &l, &values, NULL, &b), TETCAST_OK);
    CHECK_EQ_U64(tetcast_cut_create(NULL, b, &cut), TETCAST_OK);
    s.user = worst;
    s.needs = TETCAST_NEED_POSITION;
    s.shade_fn = place_shade;
    for (away = 1e2; away < 2e8; away *= 1e2)
        for (isa = 0; isa < 2; isa++) {
            tetcast_brick_render_desc d;
            tetcast_image image;
            memset(&d, 0, sizeof d); memset(&image, 0, sizeof image);
            for (i = 0; i < 3; i++) {
                d.camera.at[i] = 0.5;
                d.camera.eye[i] = 0.5 + away * (i == 0 ? 1.0 : 0.3 * i);
            }
            d.camera.ortho_height = 1.0f;
            d.env.thread_count = 1;
            d.isa = isa ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
            d.shader = &s;
            image.width = W;
            image.height = H;
            image.rgba = rgba;
            CHECK_EQ_U64(tetcast_render_bricks(&d, cut, NULL, &image, NULL), TETCAST_OK);
        }
    CHECK_MSG(worst[0] < 2e-6 && worst[1] > 1000.0, "%g, %g segments", worst[0], worst[1]);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
}

/* What lies within the radius is of the finest level, down to radii less than a brick. */
TEST(levels_near_the_focus) {
    enum { N = 65 };
    static float v[N * N * N];
    tetcast_bricks_desc bd;
    tetcast_bricks_info info;
    tetcast_lattice l;
    tetcast_array values;
    tetcast_bricks *b = NULL;
    test_rng r = test_rng_make(8);
    uint32_t t, i, k;
    memset(&bd, 0, sizeof bd); memset(&l, 0, sizeof l); memset(&values, 0, sizeof values);
    for (i = 0; i < N * N * N; i++) v[i] = test_rng_float(&r);
    for (k = 0; k < 3; k++) {
        l.dims[k] = N;
        l.spacing[k] = 1.0 / 64.0;
    }
    values.data = v;
    bd.log_cells = 3;
    CHECK_EQ_U64(tetcast_bricks_create_grid(&bd, &l, &values, NULL, &b), TETCAST_OK);
    tetcast_bricks_get_info(b, &info);
    for (t = 0; t < 20; t++) {
        tetcast_cut_desc cd;
        tetcast_cut *cut = NULL;
        const uint8_t *level;
        memset(&cd, 0, sizeof cd);
        for (k = 0; k < 3; k++) cd.focus[k] = test_rng_double(&r);
        cd.focus_radius = 0.01 + 0.02 * t;
        CHECK_EQ_U64(tetcast_cut_create(&cd, b, &cut), TETCAST_OK);
        level = tetcast_cut_levels(cut);
        for (i = 0; i < info.slots[0] * info.slots[1] * info.slots[2]; i++) {
            double way = 0.0;
            const uint32_t at[3] = {i % info.slots[0], i / info.slots[0] % info.slots[1], i / info.slots[0] / info.slots[1]};
            for (k = 0; k < 3; k++) way += pow(fmax(fmax(0.125 * at[k] - cd.focus[k], cd.focus[k] - 0.125 * (at[k] + 1)), 0.0), 2.0);
            CHECK_EQ_U64(level[i], (uint32_t)fmin(sqrt(way) / cd.focus_radius, (double)info.levels - 1.0));
        }
        tetcast_cut_destroy(cut);
    }
    tetcast_bricks_destroy(b);
}

TEST(planes_of_any_size) {
    double size;
    for (size = 1e-90; size < 2e90; size *= 1e10) {
        tetcast_mesh *mesh = cube_of_size(size);
        tetcast_plane plane;
        tetcast_section cut;
        float out[16];
        uint32_t k, i;
        REQUIRE(mesh != NULL);
        for (k = 0; k < 3; k++) { /* directions as long as the mesh, or units */
            memset(&plane, 0, sizeof plane);
            plane.u[0] = k ? 1.0 : size;
            plane.v[1] = k > 1 ? 1.0 : size;
            plane.origin[0] = plane.origin[1] = -0.5 * size;
            plane.origin[2] = 0.1 * size;
            CHECK_EQ_U64(tetcast_plane_section(NULL, mesh, &plane, &cut), TETCAST_OK);
            CHECK_NEAR(cut.area / size / size, 1.0, 1e-6);
            tetcast_section_free(&cut);
            CHECK_EQ_U64(tetcast_plane_sample(NULL, mesh, &plane, 4, 4, out), TETCAST_OK);
            for (i = 0; i < 16 && k == 0; i++) /* 0.5 + 0.01 (x + 3 y + 9 z), nodes apart by half of the size */
                CHECK_NEAR((double)out[i], 0.5 + 0.02 * ((i % 4 + 0.5) / 4.0 + 3.0 * (i / 4 + 0.5) / 4.0 + 9.0 * 0.6), 1e-5);
        }
        CHECK_EQ_U64(tetcast_plane_sample(NULL, mesh, &plane, 0, 5, NULL), TETCAST_OK);
        CHECK_EQ_U64(tetcast_plane_sample(NULL, mesh, &plane, 1, 5, NULL), TETCAST_ERR_INVALID_ARG);
        tetcast_mesh_destroy(mesh);
    }
}

/* Bodies as large as they may be, and planes whose normals are: as those of size 1. */
TEST(clips_of_any_size) {
    static const double sizes[] = {1.0, 1e90, 1e110, 1e149};
    double p[8][3], span[2][2];
    tetcast_clip_body body;
    tetcast_clip_plane plane;
    tetcast_clip_desc d;
    tetcast_clip *c = NULL;
    tetcast_ray ray;
    uint32_t i;
    memset(&body, 0, sizeof body);
    memset(&d, 0, sizeof d);
    body.points = (const double (*)[3])p;
    body.point_count = 8;
    body.indices = g_cube;
    body.triangle_count = 12;
    d.bodies = &body;
    d.body_count = 1;
    for (i = 0; i < 4; i++) {
        cube_points(p, -0.7 * sizes[i], sizes[i]);
        memset(&ray, 0, sizeof ray);
        ray.org[0] = 0.1 * sizes[i];
        ray.org[1] = 0.02 * sizes[i];
        ray.dir[0] = 1.0;
        ray.dir[1] = 0.1;
        ray.dir[2] = 0.2;
        REQUIRE(tetcast_clip_create(&d, &c) == TETCAST_OK);
        CHECK_EQ_U64(tetcast_clip_spans(c, &ray, span, 2), 1);
        CHECK(span[0][0] == 0.0);
        CHECK_NEAR(span[0][1] / sizes[i], 0.9 * sqrt(1.05), 1e-9);
        tetcast_clip_destroy(c);
    }
    d.body_count = 0;
    d.planes = &plane;
    d.plane_count = 1;
    for (i = 0; i < 5; i++) { /* x >= y + 1 */
        const double n = i == 0 ? 1.0 : i == 1 ? 1e30 : i == 2 ? 1e300 : i == 3 ? 1e-300 : ldexp(1.0, -1070);
        plane.normal[0] = n;
        plane.normal[1] = -n;
        plane.normal[2] = 0.0;
        plane.offset = n;
        memset(&ray, 0, sizeof ray);
        ray.org[0] = i == 4 ? 0.3 : 1e10;
        ray.org[1] = i == 4 ? 4.3 : 1e10 + 4.0;
        ray.dir[0] = 1.0;
        REQUIRE(tetcast_clip_create(&d, &c) == TETCAST_OK);
        CHECK_EQ_U64(tetcast_clip_spans(c, &ray, span, 2), 1);
        CHECK_NEAR(span[0][0], 5.0, i == 4 ? 1e-14 : 1e-4);
        CHECK(span[0][1] == 1e300);
        tetcast_clip_destroy(c);
    }
}

/* ---- grids with local refinement ---- */

enum { AMR_PATCHES = 64 };
typedef struct amr_case {
    tetcast_patch patch[AMR_PATCHES];
    float value[AMR_PATCHES][8 * 8 * 8];
    tetcast_amr_desc d;
} amr_case;

/* Level 0: 4^3 cells in a patch; finer patches at random, levels skipped as well, so that neighbours differ by up to
   three. kind 0: random values; 1: a linear field. */
static void amr_random(amr_case *c, uint64_t seed, int kind, uint32_t ratio_log) {
    test_rng r = test_rng_make(seed);
    uint32_t i, k, a;
    memset(c, 0, sizeof *c);
    for (i = 0; i < 40; i++) {
        tetcast_patch *p = &c->patch[i];
        const uint32_t level = i == 0 ? 0 : kind == 1 ? 1 + (i > 5) : 1 + test_rng_below(&r, ratio_log == 1 ? 3 : 2);
        const uint32_t per = 1u << (ratio_log * level);
        const double size = 1.0 / (double)per;
        p->level = level;
        p->values = c->value[i];
        for (a = 0; a < 3; a++) {
            p->dims[a] = i == 0 ? 4 : level == 1 ? 2u << (ratio_log - 1) : 8; /* whole cells of the level before */
            p->lo[a] = i == 0 ? 0 : (int32_t)(test_rng_below(&r, (4 * per - p->dims[a]) / (1u << ratio_log) + 1) << ratio_log);
            if (kind == 1 && level == 2) { /* inside of a patch of the level before */
                const tetcast_patch *q = &c->patch[1 + i % 5];
                p->dims[a] = 1u << ratio_log;
                p->lo[a] = (q->lo[a] + (int32_t)test_rng_below(&r, q->dims[a])) << ratio_log;
            }
        }
        for (k = 0; k < p->dims[0] * p->dims[1] * p->dims[2]; k++) {
            double x[3];
            x[0] = ((double)p->lo[0] + k % p->dims[0] + 0.5) * size;
            x[1] = ((double)p->lo[1] + k / p->dims[0] % p->dims[1] + 0.5) * size;
            x[2] = ((double)p->lo[2] + k / p->dims[0] / p->dims[1] + 0.5) * size;
            c->value[i][k] = kind == 1 ? (float)linear_at(x) : test_rng_float(&r);
        }
    }
    c->d.patches = c->patch;
    c->d.patch_count = 40;
    c->d.ratio_log = ratio_log;
    for (a = 0; a < 3; a++) c->d.cells[a] = 4;
}

TEST(refined_grids) {
    static const double limit[5] = {2e-5, 2e-5, 0, 0, 2e-5}, control[5] = {0, 0, 0.1, 0.1, 0};
    static amr_case c;
    test_rng r = test_rng_make(8);
    uint32_t seed, method, i, a, ratio;
    double jump[5] = {0, 0, 0, 0, 0}, differ = 0;
    for (seed = 0; seed < (test_quick() ? 3u : 12u); seed++) {
        tetcast_amr *m = NULL;
        ratio = 1 + seed % 2;
        amr_random(&c, 50 + seed, 0, ratio);
        REQUIRE(tetcast_amr_create(&c.d, &m) == TETCAST_OK);
        for (i = 0; i < 600; i++) { /* both sides of a plane of the finest cells, or of half of them */
            const double finest = 1.0 / (double)(1u << (ratio * (ratio == 1 ? 3 : 2)));
            const uint32_t axis = test_rng_below(&r, 3);
            double p[2][3];
            float v[2], octant = 0.0f;
            for (a = 0; a < 3; a++) p[0][a] = 4.0 * test_rng_double(&r);
            if (i % 3 == 0) p[0][(axis + 1) % 3] = (double)test_rng_below(&r, 8) * 0.5; /* on edges */
            p[0][axis] = (double)test_rng_below(&r, (uint32_t)(8.0 / finest)) * 0.5 * finest;
            memcpy(p[1], p[0], sizeof p[0]);
            p[0][axis] -= 1e-7;
            p[1][axis] += 1e-7;
            for (method = 0; method < 5; method++) {
                REQUIRE(tetcast_amr_sample(m, (tetcast_amr_method)method, (const double (*)[3])p, 2, v) == TETCAST_OK);
                jump[method] = fmax(jump[method], fabs((double)v[0] - (double)v[1]));
                if (method == TETCAST_AMR_OCTANT) octant = v[0];
                if (method == TETCAST_AMR_GTI) differ = fmax(differ, fabs((double)v[0] - (double)octant));
            }
        }
        for (i = 0; i < 40; i++) { /* centres of cells that no finer patch covers */
            const tetcast_patch *p = &c.patch[i];
            const double size = 1.0 / (double)(1u << (ratio * p->level));
            const uint32_t k = test_rng_below(&r, p->dims[0] * p->dims[1] * p->dims[2]);
            double x[1][3], want = -1;
            uint32_t j;
            float v;
            x[0][0] = ((double)p->lo[0] + k % p->dims[0] + 0.5) * size;
            x[0][1] = ((double)p->lo[1] + k / p->dims[0] % p->dims[1] + 0.5) * size;
            x[0][2] = ((double)p->lo[2] + k / p->dims[0] / p->dims[1] + 0.5) * size;
            if (tetcast_amr_level(m, x[0]) != p->level) continue;
            for (j = 0; j < 40; j++) { /* the last patch of that level that has the place */
                const tetcast_patch *q = &c.patch[j];
                uint32_t at[3];
                if (q->level != p->level) continue;
                for (a = 0; a < 3; a++) at[a] = (uint32_t)((int32_t)(x[0][a] / size) - q->lo[a]);
                if (at[0] < q->dims[0] && at[1] < q->dims[1] && at[2] < q->dims[2])
                    want = (double)q->values[at[0] + q->dims[0] * (at[1] + q->dims[1] * at[2])];
            }
            for (method = 0; method < 5; method++) {
                if (method == TETCAST_AMR_BASIS) continue;
                REQUIRE(tetcast_amr_sample(m, (tetcast_amr_method)method, (const double (*)[3])x, 1, &v) == TETCAST_OK);
                CHECK_NEAR((double)v, want, 1e-6);
            }
        }
        tetcast_amr_destroy(m);
        amr_random(&c, 50 + seed, 1, ratio); /* a linear field, away from the border of the domain */
        REQUIRE(tetcast_amr_create(&c.d, &m) == TETCAST_OK);
        for (i = 0; i < 300; i++) {
            double p[1][3];
            float v;
            for (a = 0; a < 3; a++) p[0][a] = 0.5 + 3.0 * test_rng_double(&r);
            REQUIRE(tetcast_amr_sample(m, TETCAST_AMR_OCTANT, (const double (*)[3])p, 1, &v) == TETCAST_OK);
            CHECK_NEAR((double)v, linear_at(p[0]), 2e-6);
            REQUIRE(tetcast_amr_sample(m, TETCAST_AMR_GTI, (const double (*)[3])p, 1, &v) == TETCAST_OK);
            CHECK_NEAR((double)v, linear_at(p[0]), 2e-6);
        }
        tetcast_amr_destroy(m);
    }
    CHECK_MSG(differ > 0.05, "%g", differ);
    for (method = 0; method < 5; method++) {
        if (limit[method] > 0) CHECK_MSG(jump[method] < limit[method], "method %u jumps by %g", method, jump[method]);
        if (control[method] > 0) CHECK_MSG(jump[method] > control[method], "method %u: %g", method, jump[method]);
    }
}

/* A ratio of its own for each level: 2, then 4, then 2; a linear field. Where a side of a coarse cell meets a finer one the
   value at its middle is known: a third of the coarse cell, two thirds of the four fine ones. */
TEST(refinement_ratios) {
    enum { MOST = 16 * 16 * 16 };
    static float value[4][MOST];
    tetcast_patch patch[4];
    tetcast_amr_desc d;
    tetcast_amr *m = NULL;
    double p[2][3] = {{2.0, 2.5, 2.5}, {2.0, 2.5, 2.5}};
    static const uint32_t dims[4] = {4, 4, 8, 4}, scale[4] = {1, 2, 8, 16};
    static const int32_t lo[4] = {0, 4, 16, 40};
    test_rng r = test_rng_make(5);
    uint32_t i, k, a;
    float v[2];
    memset(patch, 0, sizeof patch);
    memset(&d, 0, sizeof d);
    for (k = 0; k < 4; k++) {
        patch[k].level = k;
        patch[k].values = value[k];
        for (a = 0; a < 3; a++) {
            patch[k].lo[a] = lo[k];
            patch[k].dims[a] = dims[k];
            d.cells[a] = 4;
        }
        for (i = 0; i < dims[k] * dims[k] * dims[k]; i++) {
            double x[3];
            x[0] = (lo[k] + (double)(i % dims[k]) + 0.5) / scale[k];
            x[1] = (lo[k] + (double)(i / dims[k] % dims[k]) + 0.5) / scale[k];
            x[2] = (lo[k] + (double)(i / dims[k] / dims[k]) + 0.5) / scale[k];
            value[k][i] = (float)linear_at(x);
        }
    }
    d.patches = patch;
    d.patch_count = 4;
    d.ratio_logs[0] = 1;
    d.ratio_logs[1] = 2; /* the last one by ratio_log */
    REQUIRE(tetcast_amr_create(&d, &m) == TETCAST_OK);
    for (i = 0; i < 1000; i++) {
        uint32_t want = 0;
        for (a = 0; a < 3; a++) p[1][a] = 0.5 + 3.0 * test_rng_double(&r);
        for (k = 1; k < 4; k++)
            if (p[1][0] * scale[k] >= lo[k] && p[1][0] * scale[k] < lo[k] + (int)dims[k] && p[1][1] * scale[k] >= lo[k] &&
                p[1][1] * scale[k] < lo[k] + (int)dims[k] && p[1][2] * scale[k] >= lo[k] && p[1][2] * scale[k] < lo[k] + (int)dims[k])
                want = k;
        CHECK_EQ_U64(tetcast_amr_level(m, p[1]), want);
        for (k = 0; k < 5; k += 4) {
            CHECK_EQ_U64(tetcast_amr_sample(m, (tetcast_amr_method)k, (const double (*)[3])(p + 1), 1, v), TETCAST_OK);
            CHECK_NEAR((double)v[0], linear_at(p[1]), 1e-5);
        }
    }
    tetcast_amr_destroy(m);
    patch[0].dims[2] = 4; /* two levels: the middle of a side */
    d.patch_count = 2;
    for (i = 0; i < 64; i++) value[0][i] = value[1][i] = 0.0f;
    value[0][1 + 4 * (2 + 4 * 2)] = 3.0f;                    /* cell (1, 2, 2): its side at x = 2 */
    for (i = 0; i < 4; i++) value[1][0 + 4 * (i % 2 + 4 * (i / 2))] = 6.0f;
    REQUIRE(tetcast_amr_create(&d, &m) == TETCAST_OK);
    CHECK_EQ_U64(tetcast_amr_sample(m, TETCAST_AMR_GTI, (const double (*)[3])p, 1, v), TETCAST_OK);
    CHECK_NEAR((double)v[0], 5.0, 1e-6);
    tetcast_amr_destroy(m);
    d.ratio_logs[0] = 5;
    CHECK_EQ_U64(tetcast_amr_create(&d, &m), TETCAST_ERR_RANGE);
}

/* Beyond the domain as on its border, however far; only what is not finite has no value, whatever the sum of the three is. */
TEST(refined_grids_far_away) {
    static const double far_out[5][3] = {{-DBL_MAX, -DBL_MAX, -1e200}, {-1e308, 0, -1e308}, {DBL_MAX, DBL_MAX, DBL_MAX},
                                         {DBL_MAX, 1, 1e308}, {0.5, 1, 1.5}};
    static const double border[5][3] = {{0, 0, 0}, {0, 0, 0}, {2, 2, 2}, {2, 1, 2}, {0.5, 1, 1.5}};
    float coarse[8], fine[8], v[2];
    tetcast_amr_desc d;
    tetcast_patch patch[2];
    tetcast_amr *m = NULL;
    uint32_t i, k;
    memset(&d, 0, sizeof d);
    memset(patch, 0, sizeof patch);
    for (i = 0; i < 8; i++) {
        coarse[i] = (float)i;
        fine[i] = 10.0f + (float)i;
    }
    for (i = 0; i < 3; i++) d.cells[i] = patch[0].dims[i] = patch[1].dims[i] = 2;
    patch[1].level = 1; /* the cell at the origin */
    patch[0].values = coarse;
    patch[1].values = fine;
    d.patches = patch;
    d.patch_count = 2;
    REQUIRE(tetcast_amr_create(&d, &m) == TETCAST_OK);
    for (i = 0; i < 5; i++) {
        for (k = 0; k <= TETCAST_AMR_GTI; k++) {
            CHECK_EQ_U64(tetcast_amr_sample(m, (tetcast_amr_method)k, &far_out[i], 1, &v[0]), TETCAST_OK);
            CHECK_EQ_U64(tetcast_amr_sample(m, (tetcast_amr_method)k, &border[i], 1, &v[1]), TETCAST_OK);
            CHECK_MSG(v[0] == v[1], "point %u, method %u: %g, at the border %g", i, k, (double)v[0], (double)v[1]);
        }
        CHECK_EQ_U64(tetcast_amr_level(m, far_out[i]), tetcast_amr_level(m, border[i]));
    }
    CHECK_EQ_U64(tetcast_amr_level(m, far_out[0]), 1);
    for (i = 0; i < 9; i++) {
        double p[1][3] = {{0, 0, 0}};
        p[0][i % 3] = i < 3 ? (double)NAN : i < 6 ? (double)INFINITY : -(double)INFINITY;
        CHECK_EQ_U64(tetcast_amr_sample(m, TETCAST_AMR_NEAREST, (const double (*)[3])p, 1, v), TETCAST_OK);
        CHECK(v[0] != v[0] && tetcast_amr_level(m, p[0]) == 0);
    }
    tetcast_amr_destroy(m);
}

TEST(refined_grids_as_bricks) {
    static amr_case c;
    tetcast_amr *m = NULL;
    tetcast_bricks_desc d;
    tetcast_bricks *b = NULL;
    tetcast_cut *cut;
    tetcast_error error;
    uint32_t i, a;
    amr_random(&c, 3, 0, 1);
    c.d.origin[1] = 5.0;
    c.d.spacing[0] = 2.0;
    REQUIRE(tetcast_amr_create(&c.d, &m) == TETCAST_OK);
    memset(&d, 0, sizeof d);
    d.storage = TETCAST_TYPE_F32;
    d.env.thread_count = 3;
    REQUIRE(tetcast_bricks_create_amr(&d, m, TETCAST_AMR_OCTANT, NULL, &b) == TETCAST_OK);
    cut = make_cut(b, NULL, 0);
    for (i = 0; i < 500; i++) { /* at the corners of finest cells, 8 of which are one of level 0 */
        const float x = (float)(i * 7 % 33), y = (float)(i * 13 % 33), z = (float)(i * 29 % 33);
        double p[1][3];
        float v, w;
        p[0][0] = 2.0 * (double)x / 8.0;
        p[0][1] = 5.0 + (double)y / 8.0;
        p[0][2] = (double)z / 8.0;
        tetcast_cut_sample(cut, &x, &y, &z, 1, TETCAST_ISA_AUTO, &v);
        CHECK_EQ_U64(tetcast_amr_sample(m, TETCAST_AMR_OCTANT, (const double (*)[3])p, 1, &w), TETCAST_OK);
        CHECK(v == w);
    }
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
    tetcast_amr_destroy(m);
    /* what cannot be */
    c.d.env.error = &error;
    c.patch[5].lo[1] = 1000;
    CHECK_EQ_U64(tetcast_amr_create(&c.d, &m), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(error.where, 5);
    c.patch[5].lo[1] = 0;
    c.value[9][3] = (float)NAN;
    CHECK_EQ_U64(tetcast_amr_create(&c.d, &m), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(error.where, 9);
    c.value[9][3] = 0;
    c.patch[0].dims[2] = 3; /* a layer of the domain that nobody fills */
    CHECK_EQ_U64(tetcast_amr_create(&c.d, &m), TETCAST_ERR_EMPTY);
    c.patch[0].dims[2] = 4;
    c.patch[1].level = 16;
    CHECK_EQ_U64(tetcast_amr_create(&c.d, &m), TETCAST_ERR_RANGE);
    CHECK(m == NULL);
    amr_random(&c, 3, 0, 1);
    for (i = 0; ; i++) { /* memory that ends */
        test_alloc ta;
        test_alloc_init(&ta);
        ta.fail_at = (int64_t)i;
        c.d.env.allocator.alloc_fn = test_alloc_fn;
        c.d.env.allocator.free_fn = test_free_fn;
        c.d.env.allocator.user = &ta;
        a = (uint32_t)tetcast_amr_create(&c.d, &m);
        tetcast_amr_destroy(m);
        test_alloc_check(&ta);
        if (a == TETCAST_OK) break;
        CHECK_EQ_U64(a, TETCAST_ERR_NO_MEMORY);
    }
    CHECK(i > 4);
}

#if !defined(_WIN32)
static void write_text(const char *folder, const char *name, const void *text, size_t size) {
    char path[600];
    sup_error err;
    (void)snprintf(path, sizeof path, "%s/%s", folder, name);
    CHECK(sup_write_file(path, text, size, &err) == 0);
}

/* Values of a box of cells, components one after the other: 1 + field of the cell's middle; in doubles, or floats with the
   most significant byte first. */
static size_t put_box(uint8_t *out, const char *box, const int lo[3], const int hi[3], int cells, int wide) {
    size_t n = (size_t)sprintf((char *)out, wide ? "FAB ((8, (64 11 52 0 1 12 0 1023)),(8, (8 7 6 5 4 3 2 1)))%s 2\n"
                                                 : "FAB ((8, (32 8 23 0 1 9 0 127)),(4, (1 2 3 4)))%s 2\n", box);
    int c, i, j, k, a;
    for (c = 0; c < 2; c++)
        for (k = lo[2]; k <= hi[2]; k++)
            for (j = lo[1]; j <= hi[1]; j++)
                for (i = lo[0]; i <= hi[0]; i++) {
                    const double p[3] = {(i + 0.5) / cells, (j + 0.5) / cells, (k + 0.5) / cells}, v = linear_at(p) + 10.0 * c;
                    uint64_t u;
                    uint32_t w;
                    float f = (float)v;
                    memcpy(&u, &v, 8);
                    memcpy(&w, &f, 4);
                    for (a = 0; a < (wide ? 8 : 4); a++) out[n++] = (uint8_t)(wide ? u >> (8 * a) : (uint64_t)(w >> (24 - 8 * a)));
                }
    return n;
}

TEST(plotfiles) {
    static const char header[] = "HyperCLaw-V1.1\n2\nfirst one\nsecond\n3\n0.5\n1\n0 0 0\n1 1 1\n2\n((0,0,0) (7,7,7) (0,0,0)) "
                                 "((0,0,0) (15,15,15) (0,0,0))\n3 3\n0.125 0.125 0.125\n0.0625 0.0625 0.0625\n0\n0\n"
                                 "0 2 0.5\n3\n0 0.5\n0 1\n0 1\n0.5 1\n0 1\n0 1\nLevel_0/Cell\n"
                                 "1 1 0.5\n3\n0.25 0.75\n0.25 0.75\n0.25 0.75\nLevel_1/Cell\n";
    static uint8_t data[2][40000];
    const int lo[3][3] = {{0, 0, 0}, {4, 0, 0}, {3, 3, 3}}, hi[3][3] = {{3, 7, 7}, {7, 7, 7}, {12, 12, 12}}; /* ghost cells around the last */
    char folder[512], cells[2][400], name[600];
    size_t size[2], first;
    sup_amr amr;
    sup_error err;
    tetcast_amr_desc d;
    tetcast_amr *m = NULL;
    int k;
    size_t i;
    (void)snprintf(folder, sizeof folder, "%s/tetcast_plt_%ld", getenv("TMPDIR") != NULL ? getenv("TMPDIR") : "/tmp", (long)getpid());
    (void)mkdir(folder, 0700);
    for (k = 0; k < 2; k++) {
        (void)snprintf(name, sizeof name, "%s/Level_%d", folder, k);
        (void)mkdir(name, 0700);
    }
    first = put_box(data[0], "((0,0,0) (3,7,7) (0,0,0))", lo[0], hi[0], 8, 1);
    size[0] = first + put_box(data[0] + first, "((4,0,0) (7,7,7) (0,0,0))", lo[1], hi[1], 8, 1);
    size[1] = put_box(data[1], "((3,3,3) (12,12,12) (0,0,0))", lo[2], hi[2], 16, 0);
    (void)snprintf(cells[0], sizeof cells[0], "1\n1\n2\n0\n(2 0\n((0,0,0) (3,7,7) (0,0,0))\n((4,0,0) (7,7,7) (0,0,0))\n)\n2\n"
                   "FabOnDisk: Cell_D_00000 0\nFabOnDisk: Cell_D_00000 %lu\n\n", (unsigned long)first);
    (void)snprintf(cells[1], sizeof cells[1], "1\n1\n2\n(1,1,1)\n(1 0\n((4,4,4) (11,11,11) (0,0,0))\n)\n1\nFabOnDisk: Cell_D_00000 0\n");
    write_text(folder, "Header", header, sizeof header - 1);
    write_text(folder, "Level_0/Cell_H", cells[0], strlen(cells[0]));
    write_text(folder, "Level_1/Cell_H", cells[1], strlen(cells[1]));
    write_text(folder, "Level_0/Cell_D_00000", data[0], size[0]);
    write_text(folder, "Level_1/Cell_D_00000", data[1], size[1]);
    CHECK(sup_amr_is(folder) && !sup_amr_is("/tmp/nothing/here"));
    for (k = 0; k < 2; k++) {
        CHECK_MSG(sup_amr_read(folder, k ? "second" : NULL, &amr, &err) == 0, "%s", err.text);
        CHECK(amr.count == 3 && amr.levels == 2 && amr.ratio_log[0] == 1 && amr.cells[2] == 8 && amr.spacing[1] == 0.125);
        CHECK(strcmp(amr.field, k ? "second" : "first one") == 0);
        sup_amr_desc(&amr, &d);
        REQUIRE(tetcast_amr_create(&d, &m) == TETCAST_OK);
        for (i = 0; i < 3; i++) {
            const double p[1][3] = {{i == 0 ? 0.1875 : i == 1 ? 0.8125 : 0.46875, 0.53125, 0.40625}};
            float v;
            CHECK(tetcast_amr_sample(m, TETCAST_AMR_OCTANT, p, 1, &v) == TETCAST_OK && tetcast_amr_level(m, p[0]) == (i == 2));
            CHECK_NEAR((double)v, linear_at(p[0]) + 10.0 * k, 0.08); /* away from middles of coarse cells: near */
            if (i == 2) CHECK_NEAR((double)v, linear_at(p[0]) + 10.0 * k, 1e-5);
        }
        tetcast_amr_destroy(m);
        sup_amr_free(&amr);
    }
    CHECK(sup_amr_read(folder, "third", &amr, &err) == 1 && strstr(err.text, "third") != NULL && amr.patches == NULL);
    for (i = 0; i < sizeof header - 1; i++) { /* every text cut short fails, or says the same */
        write_text(folder, "Header", header, i);
        if (sup_amr_read(folder, NULL, &amr, &err) == 0) CHECK(i + 1 >= sizeof header - 1 && amr.count == 3);
        sup_amr_free(&amr);
        if (test_quick()) i += 6;
    }
    write_text(folder, "Header", header, sizeof header - 1);
    for (i = 0; i < strlen(cells[1]) - 1; i++) {
        write_text(folder, "Level_1/Cell_H", cells[1], i);
        CHECK_MSG(sup_amr_read(folder, NULL, &amr, &err) == 1, "%lu", (unsigned long)i);
    }
    write_text(folder, "Level_1/Cell_H", "1\n1\n2\n0\n(1 0\n((4,4,4) (11,11,16) (0,0,0))\n)\n1\nFabOnDisk: Cell_D_00000 0\n", 66);
    CHECK(sup_amr_read(folder, NULL, &amr, &err) == 1); /* beyond the domain */
    write_text(folder, "Level_1/Cell_H", "1\n1\n2\n0\n(1 0\n((4,4,4) (11,11,11) (0,0,0))\n)\n1\nFabOnDisk: ../Level_0/Cell_D_00000 0\n", 79);
    CHECK(sup_amr_read(folder, NULL, &amr, &err) == 1); /* elsewhere */
    write_text(folder, "Level_1/Cell_H", cells[1], strlen(cells[1]));
    for (i = 0; i < 90; i++) { /* values that end early, or whose head does */
        const size_t n = i < 80 ? i : size[1] / 2 - (90 - i) * 40;
        write_text(folder, "Level_1/Cell_D_00000", data[1], n);
        CHECK_MSG(sup_amr_read(folder, NULL, &amr, &err) == 1, "%lu", (unsigned long)i);
    }
    write_text(folder, "Level_1/Cell_D_00000", data[1], size[1]);
    CHECK(sup_amr_read(folder, NULL, &amr, &err) == 0);
    sup_amr_free(&amr);
    for (k = 0; k < 2; k++) {
        (void)snprintf(name, sizeof name, "%s/Level_%d/Cell_H", folder, k);
        (void)remove(name);
        (void)snprintf(name, sizeof name, "%s/Level_%d/Cell_D_00000", folder, k);
        (void)remove(name);
        (void)snprintf(name, sizeof name, "%s/Level_%d", folder, k);
        (void)remove(name);
    }
    (void)snprintf(name, sizeof name, "%s/Header", folder);
    (void)remove(name);
    (void)remove(folder);
}
#endif

TEST(tiles_in_files) {
    enum { W = 37, H = 21 };
    static uint8_t p[W * H * 4];
    test_rng r = test_rng_make(3);
    sup_error err;
    int codec;
    size_t i;
    for (i = 0; i < sizeof p; i++) p[i] = (uint8_t)(i / 64 % 3 ? 40 : test_rng_below(&r, 256));
    for (codec = 0; codec < 3; codec++) {
        uint8_t *data = NULL, *back = NULL;
        uint32_t w, h;
        size_t size = 0;
        CHECK(sup_tile_encode(codec, p, W, H, &data, &size) == 0);
        CHECK(sup_tile_decode(data, size, &back, &w, &h, &err) == 0 && w == W && h == H);
        CHECK((memcmp(back, p, sizeof p) == 0) == (codec == SUP_TILE_LOSSLESS));
        SUP_FREE(back);
        for (i = 0; i < size; i++) {
            uint8_t *copy = (uint8_t *)malloc(i ? i : 1);
            memcpy(copy, data, i);
            CHECK(sup_tile_decode(copy, i, &back, &w, &h, &err) == 1 && back == NULL);
            free(copy);
        }
        for (i = 0; i < SUP_TILE_HEAD; i++) {
            data[i] ^= 0x21;
            if (sup_tile_decode(data, size, &back, &w, &h, &err) == 0) SUP_FREE(back);
            data[i] ^= 0x21;
        }
        SUP_FREE(data);
    }
}

/* Red beside green, equally bright: one colour by brightness, both when fitted. */
TEST(codecs_fitted) {
    enum { N = 32 };
    static const uint8_t color[2][3] = {{148, 0, 33}, {0, 73, 49}}; /* 6119 and 6210 of brightness / 128 */
    uint8_t p[N * N * 4], q[2][N * N * 4], code[6 * N * N / 16];
    uint32_t i, a;
    double off[2] = {0, 0};
    for (i = 0; i < N * N; i++) {
        for (a = 0; a < 3; a++) p[4 * i + a] = i % 5 == 0 ? (uint8_t)(color[i & 1u][a] + 3) : color[i & 1u][a];
        p[4 * i + 3] = 255;
    }
    tetcast_ccc_encode(p, N, N, 0, 0, code);
    tetcast_ccc_decode(code, N, N, 0, 0, q[0]);
    tetcast_ccc_encode_fitted(p, N, N, 0, 0, code);
    tetcast_ccc_decode(code, N, N, 0, 0, q[1]);
    for (i = 0; i < N * N * 4; i++)
        for (a = 0; a < 2; a++) off[a] = fmax(off[a], fabs((double)q[a][i] - (double)p[i]));
    CHECK_MSG(off[0] > 30 && off[1] <= 8, "%g %g", off[0], off[1]);
}

TEST(codecs) {
    static const uint32_t sizes[5][2] = {{64, 64}, {1, 1}, {5, 7}, {33, 2}, {16, 130}};
    test_rng r = test_rng_make(6);
    int n, kind;
    CHECK_EQ_U64(tetcast_ccc_size(512, 512, 0) * 8, 512 * 512 * 3);
    for (n = 0; n < 5; n++)
        for (kind = 0; kind < 4; kind++) {
            const uint32_t w = sizes[n][0], h = sizes[n][1];
            uint8_t *p = (uint8_t *)malloc((size_t)w * h * 4), *q = (uint8_t *)malloc((size_t)w * h * 4);
            uint8_t *code = (uint8_t *)malloc(tetcast_ccc_size(w, h, 1)), *pack = (uint8_t *)malloc(tetcast_pack_bound(w, h));
            size_t i, size;
            uint32_t x, y;
            for (y = 0; y < h; y++)
                for (x = 0; x < w; x++) {
                    uint8_t *c = p + 4 * ((size_t)y * w + x);
                    /* 0: one colour a cell, 1: two colours a cell, those that 16 bits hold, 2: noise, 3: mostly empty */
                    const uint32_t cell = x / 4 * 7 + y / 4 * 13, odd = kind == 1 ? (x ^ y) & 1u : 0, level = (cell * 8 + odd * 99) & 31u;
                    c[0] = (uint8_t)(level << 3 | level >> 2);
                    c[1] = (uint8_t)(odd ? 255 : 0);
                    c[2] = c[0];
                    c[3] = (uint8_t)(odd ? 255 : 128);
                    if (kind == 2) tetcasti_store_u32(c, test_rng_u32(&r));
                    if (kind == 3) tetcasti_store_u32(c, test_rng_below(&r, 40) == 0 ? test_rng_u32(&r) : 0u);
                }
            tetcast_ccc_encode(p, w, h, 0, 1, code);
            tetcast_ccc_decode(code, w, h, 0, 1, q);
            if (kind < 2) CHECK(memcmp(p, q, (size_t)w * h * 4) == 0);
            { /* cell by cell: what wide instructions have to give */
                uint8_t *cell = (uint8_t *)malloc(tetcast_ccc_size(w, h, 1)), *back = (uint8_t *)malloc((size_t)w * h * 4);
                tetcasti_ccc k;
                tetcasti_ccc_open(&k, w, h, 0, 1);
                for (i = 0; i < k.cells; i++) {
                    tetcasti_ccc_encode_cell(&k, p, (uint32_t)(i % k.cx), (uint32_t)(i / k.cx), cell);
                    tetcasti_ccc_decode_cell(&k, code, (uint32_t)(i % k.cx), (uint32_t)(i / k.cx), back);
                }
                CHECK(memcmp(cell, code, tetcast_ccc_size(w, h, 1)) == 0);
                CHECK(memcmp(back, q, (size_t)w * h * 4) == 0);
                free(cell);
                free(back);
            }
            { /* fitted: what two colours can do exactly is exact, nothing is worse but for rounding to 16 bits */
                double worse = 0, plain = 0, d;
                uint8_t *fitted = (uint8_t *)malloc((size_t)w * h * 4);
                tetcast_ccc_encode_fitted(p, w, h, 0, 1, code);
                tetcast_ccc_decode(code, w, h, 0, 1, fitted);
                for (i = 0; i < (size_t)w * h * 4; i++) {
                    if (i % 4 == 3) continue;
                    d = (double)fitted[i] - (double)p[i];
                    worse += d * d;
                    d = (double)q[i] - (double)p[i];
                    plain += d * d;
                }
                if (kind < 2) CHECK(memcmp(p, fitted, (size_t)w * h * 4) == 0);
                CHECK_MSG(worse <= plain + 4.0 * w * h, "%d %d: %g %g", n, kind, worse, plain);
                if (kind == 2 && n == 0) CHECK(worse < 0.95 * plain);
                free(fitted);
            }
            size = tetcast_pack(p, w, h, 0, pack);
            CHECK(size <= tetcast_pack_bound(w, h));
            memset(q, 7, (size_t)w * h * 4);
            CHECK_EQ_U64(tetcast_unpack(pack, size, w, h, 0, q), TETCAST_OK);
            CHECK(memcmp(p, q, (size_t)w * h * 4) == 0);
            if (kind == 3 && n == 0) CHECK(size < (size_t)w * h);
            for (i = 0; i < size; i += 1 + size / 50) CHECK(tetcast_unpack(pack, i, w, h, 0, q) != TETCAST_OK);
            CHECK_EQ_U64(tetcast_unpack(NULL, size, w, h, 0, q), TETCAST_ERR_INVALID_ARG);
            CHECK_EQ_U64(tetcast_unpack(pack, size, w, h, 0, NULL), TETCAST_ERR_INVALID_ARG);
            for (i = 0; i < 50; i++) {
                pack[test_rng_below(&r, (uint32_t)size)] ^= (uint8_t)test_rng_u32(&r);
                (void)tetcast_unpack(pack, size, w, h, 0, q);
            }
            free(p);
            free(q);
            free(code);
            free(pack);
        }
}

/* Parts that share pixels, faded there: their light adds up to that of the frame. */
TEST(edges_add_up) {
    enum { W = 50, H = 40, N = 13 };
    static float whole[W * H * 4], sum[W * H * 4], rgba[W * H * 4], one[4] = {1, 2, 3, 4};
    static const uint32_t x0[3] = {0, 9, 28}, x1[3] = {22, 41, W}, y0[2] = {0, 15}, y1[2] = {15 + N, H};
    const tetcast_lattice l = cube_lattice(26, 21, 23);
    float *v = random_grid(&l, 5);
    tetcast_bricks *b = make_bricks(&l, v, TETCAST_TYPE_F32, 3, 0);
    tetcast_optics *o = flat_optics(0.05f, TETCAST_MODEL_VOLUME);
    tetcast_brick_render_desc d;
    tetcast_cut *c = make_cut(b, NULL, 0);
    uint32_t px, py, x, y, k, bad[4] = {2, 0, 0, 0};
    double worst = 0;
    box_view(&d, &l, 1);
    (void)picture(&d, c, o, W, H, whole);
    memset(sum, 0, sizeof sum);
    for (py = 0; py < 2; py++)
        for (px = 0; px < 3; px++) {
            const uint32_t w = x1[px] - x0[px], h = y1[py] - y0[py];
            const uint32_t overlap[4] = {px ? 13u : 0u, px < 2 ? 13u : 0u, py ? N : 0u, py ? 0u : N};
            d.frame[0] = W;
            d.frame[1] = H;
            d.part[0] = x0[px];
            d.part[1] = y0[py];
            (void)picture(&d, c, o, w, h, rgba);
            CHECK_EQ_U64(tetcast_edge_blend(rgba, w, h, overlap), TETCAST_OK);
            for (y = 0; y < h; y++)
                for (x = 0; x < w; x++)
                    for (k = 0; k < 4; k++) sum[4 * ((y0[py] + y) * W + x0[px] + x) + k] += rgba[4 * (y * w + x) + k];
        }
    for (k = 0; k < W * H * 4; k++) worst = fmax(worst, fabs((double)sum[k] - (double)whole[k]));
    CHECK_MSG(worst < 2e-6, "%g", worst);
    CHECK_EQ_U64(tetcast_edge_blend(one, 1, 1, bad), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_edge_blend(NULL, 1, 1, bad), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_edge_blend(one, 1, 1, NULL), TETCAST_ERR_INVALID_ARG);
    bad[0] = 1; /* one pixel, half of it */
    CHECK_EQ_U64(tetcast_edge_blend(one, 1, 1, bad), TETCAST_OK);
    CHECK(one[0] == 0.5f && one[3] == 2.0f);
    tetcast_cut_destroy(c);
    tetcast_bricks_destroy(b);
    tetcast_optics_destroy(o);
    free(v);
}

/* Ranges of depth, one over the other, are the whole; memory that runs out anywhere is reported and given back. */
TEST(depth_ranges_and_memory) {
    enum { W = 40, H = 30 };
    static float whole[W * H * 4], near_part[W * H * 4], far_part[W * H * 4];
    const tetcast_lattice l = cube_lattice(26, 21, 23);
    float *v = random_grid(&l, 2);
    tetcast_bricks *b = make_bricks(&l, v, TETCAST_TYPE_U16, 3, 0);
    tetcast_optics *o = flat_optics(0.05f, TETCAST_MODEL_VOLUME);
    tetcast_brick_render_desc d;
    tetcast_cut *c = make_cut(b, NULL, 0);
    test_alloc ta;
    double worst = 0;
    uint32_t fail;
    size_t i;
    box_view(&d, &l, 1);
    (void)picture(&d, c, o, W, H, whole);
    d.clip_far = 40;
    (void)picture(&d, c, o, W, H, near_part);
    d.clip_far = 0;
    d.clip_near = 40;
    (void)picture(&d, c, o, W, H, far_part);
    tetcast_over(near_part, far_part, W * H);
    for (i = 0; i < W * H * 4; i++) {
        const double e = fabs((double)whole[i] - (double)near_part[i]);
        worst = i % 4 == 3 && e > worst ? e : worst;
        CHECK(e < 1e-3); /* colours: a segment is cut in two, and the field is not linear along it */
    }
    CHECK_MSG(worst < 1e-5, "%g", worst);
    for (i = 0; i < 4; i++) near_part[i] = far_part[i] = i < 3 ? FLT_MAX : 0.5f; /* nothing becomes infinite, or NaN after that */
    tetcast_over(near_part, far_part, 1);
    CHECK(near_part[0] == FLT_MAX && near_part[1] == FLT_MAX && near_part[2] == FLT_MAX && near_part[3] == 0.75f);
    for (i = 0; i < 4; i++) near_part[i] = far_part[i] = i < 3 ? -FLT_MAX : 0.5f;
    tetcast_over(near_part, far_part, 1);
    CHECK(near_part[0] == -FLT_MAX && near_part[1] == -FLT_MAX && near_part[2] == -FLT_MAX && near_part[3] == 0.75f);
    tetcast_cut_destroy(c);
    test_alloc_init(&ta);
    for (fail = 1; fail < 200; fail++) {
        tetcast_bricks_desc bd;
        tetcast_cut_desc cd;
        tetcast_array a;
        tetcast_bricks *k = NULL;
        tetcast_result r;
        memset(&bd, 0, sizeof bd);
        memset(&cd, 0, sizeof cd);
        memset(&a, 0, sizeof a);
        a.data = v;
        bd.env.memory_limit = (size_t)fail * 4000;
        bd.env.allocator.alloc_fn = test_alloc_fn;
        bd.env.allocator.free_fn = test_free_fn;
        bd.env.allocator.user = &ta;
        bd.env.thread_count = 1;
        cd.env = bd.env;
        cd.byte_budget = 100000;
        r = tetcast_bricks_create_grid(&bd, &l, &a, NULL, &k);
        CHECK(r == TETCAST_OK || (r == TETCAST_ERR_NO_MEMORY && k == NULL));
        if (r == TETCAST_OK) {
            r = tetcast_cut_create(&cd, k, &c);
            CHECK(r == TETCAST_OK || (r == TETCAST_ERR_NO_MEMORY && c == NULL));
            if (r == TETCAST_OK) tetcast_cut_destroy(c);
        }
        tetcast_bricks_destroy(k);
    }
    test_alloc_check(&ta);
    tetcast_optics_destroy(o);
    tetcast_bricks_destroy(b);
    free(v);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(resample_against_brute_force);
    RUN(resample_on_vertices);
    RUN(resample_same_bits);
    RUN(resample_counts);
    RUN(lone_cells);
    RUN(resample_extends);
    RUN(resample_keeps_the_integral);
    RUN(means_of_boxes);
    RUN(resample_bad_cells);
    RUN(slice_by_slice);
    RUN(slices_of_levels);
    RUN(planes_and_sections);
    RUN(planes_in_perspective);
    RUN(bricks_sample_the_grid);
    RUN(bad_grids);
    RUN(bricks_are_continuous);
    RUN(borders_agree);
    RUN(gradients_at_borders);
    RUN(moving_focus);
    RUN(levels_beyond);
    RUN(ranges_of_slots);
    RUN(pace);
    RUN(levels_keep_linear_fields);
    RUN(errors_are_bounds);
    RUN(bricks_of_a_mesh);
    RUN(layers_too_thin);
    RUN(meshes_without_values);
    RUN(bricks_around_bad_values);
    RUN(bricks_on_demand);
    RUN(brick_files);
    RUN(largest_values);
    RUN(errors_of_largest_values);
    RUN(values_beyond_in_files);
    RUN(largest_values_of_meshes);
    RUN(constant_medium);
    RUN(budgets);
    RUN(hull_left_out);
    RUN(far_eyes);
    RUN(rays_in_borders);
    RUN(thick_layers);
    RUN(reach_of_bins);
    RUN(brick_pictures_same_bits);
    RUN(steps_in_layers);
    RUN(bricks_look_like_tetrahedra);
    RUN(clip_spans);
    RUN(pictures_against_rays);
    RUN(depth_limits);
    RUN(odd_clip_bodies);
    RUN(nearer_with_bytes);
    RUN(many_parts);
    RUN(shaders);
    RUN(shaders_same_bits);
    RUN(shaders_end_at_the_hull);
    RUN(parameters);
    RUN(channels);
    RUN(shaded_tetrahedra);
    RUN(shaded_without_hidden_cells);
    RUN(shaded_surface_in_a_flat_cell);
    RUN(shaded_depth_of_flat_cells);
    RUN(shaded_from_far_away);
    RUN(shaded_meshes_of_any_size);
    RUN(thin_layers);
    RUN(places_for_shaders_from_far_away);
    RUN(levels_near_the_focus);
    RUN(planes_of_any_size);
    RUN(clips_of_any_size);
    RUN(refined_grids);
    RUN(refinement_ratios);
    RUN(refined_grids_far_away);
    RUN(refined_grids_as_bricks);
#if !defined(_WIN32)
    RUN(plotfiles);
#endif
    RUN(tiles_in_files);
    RUN(codecs);
    RUN(codecs_fitted);
    RUN(edges_add_up);
    RUN(depth_ranges_and_memory);
    return test_end();
}
