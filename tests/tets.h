/* tets.h - tetrahedral meshes for tests, and references that are slow and obviously right
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef TETS_H
#define TETS_H
#include "test.h"

typedef struct tets {
    double *p;          /* xyz */
    float *s;           /* one value a vertex */
    uint32_t *t;        /* 4 a tetrahedron */
    size_t nv, nt, room_v, room_t;
} tets;

TEST_FN void tets_free(tets *m) {
    free(m->p);
    free(m->s);
    free(m->t);
    memset(m, 0, sizeof *m);
}

TEST_FN uint32_t tets_vertex(tets *m, double x, double y, double z, double s) {
    if (m->nv == m->room_v) {
        m->room_v = 2 * m->room_v + 64;
        m->p = (double *)realloc(m->p, m->room_v * 3 * sizeof *m->p);
        m->s = (float *)realloc(m->s, m->room_v * sizeof *m->s);
        if (m->p == NULL || m->s == NULL) abort();
    }
    m->p[3 * m->nv] = x;
    m->p[3 * m->nv + 1] = y;
    m->p[3 * m->nv + 2] = z;
    m->s[m->nv] = (float)s;
    return (uint32_t)m->nv++;
}

TEST_FN void tets_tet(tets *m, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
    if (m->nt == m->room_t) {
        m->room_t = 2 * m->room_t + 64;
        m->t = (uint32_t *)realloc(m->t, m->room_t * 4 * sizeof *m->t);
        if (m->t == NULL) abort();
    }
    m->t[4 * m->nt] = a;
    m->t[4 * m->nt + 1] = b;
    m->t[4 * m->nt + 2] = c;
    m->t[4 * m->nt + 3] = d;
    m->nt++;
}

/* A lattice of nx * ny * nz vertices at integer places, `kind` (5 or 6) tetrahedra a cube. Where keep(x, y, z) is 0
   the cube is left out; NULL: all are there. Vertices are all made. */
TEST_FN void tets_lattice(tets *m, uint32_t nx, uint32_t ny, uint32_t nz, int kind, int (*keep)(uint32_t, uint32_t, uint32_t)) {
    static const uint8_t five[5][4] = {{0, 1, 2, 4}, {3, 1, 2, 7}, {5, 1, 4, 7}, {6, 2, 4, 7}, {1, 2, 4, 7}};
    static const uint8_t six[6][4] = {{0, 1, 3, 7}, {0, 1, 5, 7}, {0, 2, 3, 7}, {0, 2, 6, 7}, {0, 4, 5, 7}, {0, 4, 6, 7}};
    uint32_t x, y, z, i, j, base = (uint32_t)m->nv;
    for (z = 0; z < nz; z++)
        for (y = 0; y < ny; y++)
            for (x = 0; x < nx; x++) {
                double cx = x - 0.5 * (nx - 1), cy = y - 0.5 * (ny - 1), cz = z - 0.5 * (nz - 1);
                tets_vertex(m, x, y, z, sqrt(cx * cx + cy * cy + cz * cz) / (0.87 * nx));
            }
    for (z = 0; z + 1 < nz; z++)
        for (y = 0; y + 1 < ny; y++)
            for (x = 0; x + 1 < nx; x++) {
                uint32_t c[8], odd = (x + y + z) & 1u;
                if (keep != NULL && !keep(x, y, z)) continue;
                for (i = 0; i < 8; i++)
                    c[i] = base + ((z + (i >> 2)) * ny + y + (i >> 1 & 1u)) * nx + x + (i & 1u);
                for (i = 0; i < (uint32_t)kind; i++) {
                    uint32_t q[4];
                    for (j = 0; j < 4; j++) q[j] = c[kind == 5 ? five[i][j] ^ odd : six[i][j]];
                    tets_tet(m, q[0], q[1], q[2], q[3]);
                }
            }
}

/* Move the vertices inside of a box at random; those on its sides stay. */
TEST_FN void tets_jitter(tets *m, double nx, double ny, double nz, double amount, uint64_t seed) {
    test_rng r = test_rng_make(seed);
    size_t i, a;
    for (i = 0; i < m->nv; i++)
        for (a = 0; a < 3; a++) {
            double top = a == 0 ? nx : a == 1 ? ny : nz, *p = &m->p[3 * i + a];
            if (*p > 0 && *p < top - 1) *p += amount * (test_rng_double(&r) - 0.5);
        }
}

TEST_FN void tets_place(tets *m, const double scale[3], const double offset[3]) {
    size_t i, a;
    for (i = 0; i < m->nv; i++)
        for (a = 0; a < 3; a++) m->p[3 * i + a] = m->p[3 * i + a] * scale[a] + offset[a];
}

/* Round positions to floats. */
TEST_FN void tets_round(tets *m) {
    size_t i;
    for (i = 0; i < 3 * m->nv; i++) m->p[i] = (double)(float)m->p[i];
}

/* Any order of cells, of vertices and of the vertices of a cell. */
TEST_FN void tets_shuffle(tets *m, uint64_t seed) {
    test_rng r = test_rng_make(seed);
    uint32_t *perm = (uint32_t *)malloc((m->nv + 1) * sizeof *perm), k;
    double *p = (double *)malloc((m->nv + 1) * 3 * sizeof *p);
    float *s = (float *)malloc((m->nv + 1) * sizeof *s);
    size_t i;
    if (perm == NULL || p == NULL || s == NULL) abort();
    for (i = 0; i < m->nv; i++) perm[i] = (uint32_t)i;
    for (i = m->nv; i > 1; i--) {
        uint32_t j = test_rng_below(&r, (uint32_t)i), x = perm[i - 1];
        perm[i - 1] = perm[j];
        perm[j] = x;
    }
    for (i = 0; i < m->nv; i++) {
        memcpy(p + 3 * perm[i], m->p + 3 * i, 3 * sizeof *p);
        s[perm[i]] = m->s[i];
    }
    memcpy(m->p, p, m->nv * 3 * sizeof *p);
    memcpy(m->s, s, m->nv * sizeof *s);
    for (i = 0; i < 4 * m->nt; i++) m->t[i] = perm[m->t[i]];
    for (i = m->nt; i > 1; i--) {
        uint32_t j = test_rng_below(&r, (uint32_t)i), q[4];
        memcpy(q, m->t + 4 * (i - 1), 16);
        memcpy(m->t + 4 * (i - 1), m->t + 4 * j, 16);
        memcpy(m->t + 4 * j, q, 16);
    }
    for (i = 0; i < m->nt; i++)
        for (k = 3; k > 0; k--) {
            uint32_t j = test_rng_below(&r, k + 1), x = m->t[4 * i + k];
            m->t[4 * i + k] = m->t[4 * i + j];
            m->t[4 * i + j] = x;
        }
    free(perm);
    free(p);
    free(s);
}

#ifdef TETCAST_H_INCLUDED
TEST_FN void tets_input(const tets *m, tetcast_input *in, tetcast_field *f) {
    memset(in, 0, sizeof *in);
    memset(f, 0, sizeof *f);
    in->positions.data = m->p;
    in->positions.type = TETCAST_TYPE_F64;
    in->vertex_count = m->nv;
    in->indices = m->t;
    in->index_count = 4 * m->nt;
    in->cell_count = m->nt;
    f->name = "s";
    f->values.data = m->s;
    in->fields = f;
    in->field_count = 1;
}

TEST_FN tetcast_mesh *tets_build_desc(const tets *m, const tetcast_mesh_desc *d, tetcast_report *report) {
    tetcast_input in;
    tetcast_field f;
    tetcast_mesh *mesh = NULL;
    tetcast_result r;
    tets_input(m, &in, &f);
    r = tetcast_mesh_create(d, &in, report, &mesh);
    CHECK_EQ_U64(r, TETCAST_OK);
    CHECK((r == TETCAST_OK) == (mesh != NULL));
    return mesh;
}

TEST_FN tetcast_mesh *tets_build(const tets *m, tetcast_cells cells, tetcast_report *report) {
    tetcast_mesh_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.cells = cells;
    return tets_build_desc(m, &d, report);
}
#endif

/* ---- references ---- */

/* The part of a ray (o + t d, t in [t0, t1]) inside of a box; 0 when there is none. */
TEST_FN double ref_box(const double o[3], const double d[3], const double lo[3], const double hi[3], double t0, double t1) {
    int a;
    for (a = 0; a < 3; a++) {
        double u, v;
        if (d[a] == 0) {
            if (o[a] < lo[a] || o[a] > hi[a]) return 0;
            continue;
        }
        u = (lo[a] - o[a]) / d[a];
        v = (hi[a] - o[a]) / d[a];
        t0 = fmax(t0, fmin(u, v));
        t1 = fmin(t1, fmax(u, v));
    }
    return t1 > t0 ? t1 - t0 : 0;
}

/* The part of a ray inside of a tetrahedron: four half spaces. 1 and [*t0, *t1], or 0. */
TEST_FN int ref_tet(const double *a, const double *b, const double *c, const double *d, const double o[3], const double dir[3],
                    double *t0, double *t1) {
    const double *v[4];
    int i, k;
    double lo = -1e300, hi = 1e300;
    v[0] = a; v[1] = b; v[2] = c; v[3] = d;
    for (i = 0; i < 4; i++) {
        const double *p = v[(i + 1) & 3], *q = v[(i + 2) & 3], *r = v[(i + 3) & 3], *in = v[i];
        double e[3], f[3], n[3], at = 0, dn = 0, side = 0;
        for (k = 0; k < 3; k++) {
            e[k] = q[k] - p[k];
            f[k] = r[k] - p[k];
        }
        n[0] = e[1] * f[2] - e[2] * f[1];
        n[1] = e[2] * f[0] - e[0] * f[2];
        n[2] = e[0] * f[1] - e[1] * f[0];
        for (k = 0; k < 3; k++) {
            at += n[k] * (p[k] - o[k]);
            dn += n[k] * dir[k];
            side += n[k] * (in[k] - p[k]);
        }
        if (side == 0) return 0;
        if (side > 0) { /* inside is where n . (x - p) >= 0 */
            at = -at;
            dn = -dn;
        }
        /* outside where dn * t > at */
        if (dn == 0) {
            if (at < 0) return 0;
        } else if (dn > 0) {
            hi = fmin(hi, at / dn);
        } else {
            lo = fmax(lo, at / dn);
        }
    }
    *t0 = lo;
    *t1 = hi;
    return hi > lo;
}

/* Length of a ray inside of all tetrahedra, t >= 0; overlaps count as often as they are there. */
TEST_FN double ref_length(const tets *m, const double o[3], const double dir[3], double t_min, double t_max) {
    double sum = 0, u, v;
    size_t i;
    for (i = 0; i < m->nt; i++) {
        const uint32_t *t = m->t + 4 * i;
        if (!ref_tet(m->p + 3 * t[0], m->p + 3 * t[1], m->p + 3 * t[2], m->p + 3 * t[3], o, dir, &u, &v)) continue;
        u = fmax(u, t_min);
        v = fmin(v, t_max);
        if (v > u) sum += v - u;
    }
    return sum;
}

TEST_FN void ref_unit(double d[3]) {
    double l = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    int a;
    for (a = 0; a < 3; a++) d[a] /= l;
}

#endif
