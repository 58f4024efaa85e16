/* test_tetcast_bricks.c - resampling, planes, bricks with level of detail, shaders, clipping, tiles, codecs
   SPDX-License-Identifier: MIT OR Unlicense */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"

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
                b = resample(mesh, &l, TETCAST_ISA_AUTO, axis, threads, extend, NULL);
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
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
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
        memset(plane.v, 0, sizeof plane.v);
        CHECK_EQ_U64(tetcast_plane_section(NULL, mesh, &plane, &cut), TETCAST_ERR_INVALID_ARG);
    }
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/*>>TESTS*/

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(resample_against_brute_force);
    RUN(resample_on_vertices);
    RUN(resample_same_bits);
    RUN(resample_extends);
    RUN(resample_keeps_the_integral);
    RUN(resample_bad_cells);
    RUN(planes_and_sections);
    return test_end();
}
