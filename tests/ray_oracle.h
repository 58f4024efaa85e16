/* ray_oracle.h - what a ray through tetrahedra looks like, all in double, slow and plain: for tests and benchmarks
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef RAY_ORACLE_H_INCLUDED
#define RAY_ORACLE_H_INCLUDED
#ifndef TETCAST_H_INCLUDED
#  error "include tetcast.h first"
#endif
#include "tets.h"
#include "transfer_oracle.h"

/* Add a stretch of length d between two values to sum = {r, g, b, transmittance}: split at every point between. */
TEST_FN void oracle_interval(const tetcast_control_point *p, size_t n, int independent, double front, double back,
                             double d, double sum[4]) {
    double from = front;
    size_t k;
    if (front == back) {
        double v[4];
        oracle_eval(p, n, front, 1, v);
        oracle_stretch(v, v, d, independent, sum);
        return;
    }
    for (k = 0; k <= n; k++) {
        const size_t i = back > front ? k : n - 1 - k; /* k == n: the end */
        const double to = k == n ? back : (double)p[i].value;
        double f[4], b[4];
        if (k < n && !(back > front ? to > from && to < back : to < from && to > back)) continue;
        oracle_eval(p, n, from, back > front, f);
        oracle_eval(p, n, to, back <= front, b);
        if (f[3] > 0 || b[3] > 0 || independent) oracle_stretch(f, b, d * ((to - from) / (back - front)), independent, sum);
        from = to;
    }
}

typedef struct oracle_visit { double t0, t1; uint32_t tet; } oracle_visit;
typedef struct oracle_cells { oracle_visit *visit; size_t count, room; } oracle_cells; /* keeps memory from ray to ray */

TEST_FN void oracle_visit_add(oracle_cells *list, const tets *m, uint32_t tet, const tetcast_ray *ray) {
    const uint32_t *v = m->t + 4 * (size_t)tet;
    oracle_visit at;
    at.tet = tet;
    if (!ref_tet(m->p + 3 * v[0], m->p + 3 * v[1], m->p + 3 * v[2], m->p + 3 * v[3], ray->org, ray->dir, &at.t0, &at.t1)) return;
    at.t0 = fmax(at.t0, ray->t_min);
    if (ray->t_max > 0) at.t1 = fmin(at.t1, ray->t_max);
    if (!(at.t1 > at.t0)) return;
    if (list->count == list->room) {
        list->room = 2 * list->room + 256;
        list->visit = (oracle_visit *)realloc(list->visit, list->room * sizeof *list->visit);
        if (list->visit == NULL) abort();
    }
    list->visit[list->count++] = at;
}

typedef struct oracle_asked { oracle_cells *list; const tetcast_mesh *mesh; const tets *m; const tetcast_ray *ray; } oracle_asked;

TEST_FN int oracle_collect(void *user, const tetcast_crossing *c) {
    const oracle_asked *k = (const oracle_asked *)user;
    uint32_t own[4], source;
    if (tetcast_mesh_cell(k->mesh, c->cell, own, &source) == TETCAST_OK) oracle_visit_add(k->list, k->m, source, k->ray);
    return 0;
}

TEST_FN int oracle_nearer(const void *a, const void *b) {
    const oracle_visit *x = (const oracle_visit *)a, *y = (const oracle_visit *)b;
    const double p = x->t0 + x->t1, q = y->t0 + y->t1;
    return p < q ? -1 : p > q;
}

/* The tetrahedra that a ray with a unit direction meets, front to back. mesh: made of `m`, for many tetrahedra: it is
   asked which ones; NULL: all are looked at. */
TEST_FN void oracle_meet(const tetcast_mesh *mesh, const tets *m, const tetcast_ray *ray, oracle_cells *list) {
    list->count = 0;
    if (mesh != NULL) {
        oracle_asked k;
        k.list = list;
        k.mesh = mesh;
        k.m = m;
        k.ray = ray;
        (void)tetcast_probe(mesh, ray, oracle_collect, &k);
    } else {
        uint32_t i;
        for (i = 0; i < m->nt; i++) oracle_visit_add(list, m, i, ray);
        if (list->count > 0) qsort(list->visit, list->count, sizeof *list->visit, oracle_nearer);
    }
}

/* The value at distance t in a cell: from volumes. */
TEST_FN double oracle_value(const tets *m, const uint32_t *v, const double o[3], const double d[3], double t) {
    double q[4][3], whole = 0, sum = 0;
    uint32_t i, k;
    for (i = 0; i < 4; i++)
        for (k = 0; k < 3; k++) q[i][k] = m->p[3 * v[i] + k] - (o[k] + t * d[k]);
    for (i = 0; i < 4; i++) {
        const double *a = q[(i + 1) & 3], *b = q[(i + 2) & 3], *c = q[(i + 3) & 3];
        double det = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
                     a[2] * (b[0] * c[1] - b[1] * c[0]);
        if (i & 1) det = -det;
        whole += det;
        sum += det * (double)m->s[v[i]];
    }
    return sum / whole;
}

/* Colour and opacity of a ray; mesh as for oracle_meet. */
TEST_FN void oracle_ray(const tetcast_mesh *mesh, const tets *m, const tetcast_control_point *p, size_t n,
                        int independent, const tetcast_ray *ray, oracle_cells *list, double rgba[4]) {
    double sum[4] = {0, 0, 0, 1};
    size_t i;
    int c;
    oracle_meet(mesh, m, ray, list);
    for (i = 0; i < list->count && sum[3] > 1e-12; i++) {
        const oracle_visit *at = &list->visit[i];
        const uint32_t *v = m->t + 4 * (size_t)at->tet;
        oracle_interval(p, n, independent, oracle_value(m, v, ray->org, ray->dir, at->t0),
                        oracle_value(m, v, ray->org, ray->dir, at->t1), at->t1 - at->t0, sum);
    }
    for (c = 0; c < 3; c++) rgba[c] = sum[c];
    rgba[3] = 1 - sum[3];
}

/* Distance to where the value is `iso` for the first time; INFINITY: nowhere. mesh as for oracle_meet. */
TEST_FN double oracle_hit(const tetcast_mesh *mesh, const tets *m, double iso, const tetcast_ray *ray, oracle_cells *list) {
    size_t i;
    oracle_meet(mesh, m, ray, list);
    for (i = 0; i < list->count; i++) {
        const oracle_visit *at = &list->visit[i];
        const uint32_t *v = m->t + 4 * (size_t)at->tet;
        const double a = oracle_value(m, v, ray->org, ray->dir, at->t0), b = oracle_value(m, v, ray->org, ray->dir, at->t1);
        if ((a < iso && iso <= b) || (a > iso && iso >= b)) return at->t0 + (at->t1 - at->t0) * ((iso - a) / (b - a));
    }
    return (double)INFINITY;
}

#endif
