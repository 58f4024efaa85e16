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

typedef struct oracle_cells { uint32_t *cell; size_t count, room; } oracle_cells;

TEST_FN int oracle_collect(void *user, const tetcast_crossing *c) {
    oracle_cells *list = (oracle_cells *)user;
    if (list->count == list->room) {
        list->room = 2 * list->room + 256;
        list->cell = (uint32_t *)realloc(list->cell, list->room * sizeof *list->cell);
        if (list->cell == NULL) abort();
    }
    list->cell[list->count++] = c->cell;
    return 0;
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

/* Colour and opacity of a ray with a unit direction through the mesh made of `m`. Which cells it meets is asked of the
   library, where it enters and leaves them and with what values is not. `list` keeps memory from call to call. */
TEST_FN void oracle_ray(const tetcast_mesh *mesh, const tets *m, const tetcast_control_point *p, size_t n,
                        int independent, const tetcast_ray *ray, oracle_cells *list, double rgba[4]) {
    double sum[4] = {0, 0, 0, 1};
    size_t i;
    int c;
    list->count = 0;
    (void)tetcast_probe(mesh, ray, oracle_collect, list);
    for (i = 0; i < list->count && sum[3] > 1e-12; i++) {
        uint32_t own[4], source;
        const uint32_t *v;
        double t0, t1;
        if (tetcast_mesh_cell(mesh, list->cell[i], own, &source) != TETCAST_OK) continue;
        v = m->t + 4 * (size_t)source;
        if (!ref_tet(m->p + 3 * v[0], m->p + 3 * v[1], m->p + 3 * v[2], m->p + 3 * v[3], ray->org, ray->dir, &t0, &t1))
            continue;
        t0 = fmax(t0, ray->t_min);
        if (ray->t_max > 0) t1 = fmin(t1, ray->t_max);
        if (!(t1 > t0)) continue;
        oracle_interval(p, n, independent, oracle_value(m, v, ray->org, ray->dir, t0),
                        oracle_value(m, v, ray->org, ray->dir, t1), t1 - t0, sum);
    }
    for (c = 0; c < 3; c++) rgba[c] = sum[c];
    rgba[3] = 1 - sum[3];
}

/* Distance to where the value is `iso` for the first time; INFINITY: nowhere. */
TEST_FN double oracle_hit(const tetcast_mesh *mesh, const tets *m, double iso, const tetcast_ray *ray, oracle_cells *list) {
    size_t i;
    list->count = 0;
    (void)tetcast_probe(mesh, ray, oracle_collect, list);
    for (i = 0; i < list->count; i++) {
        uint32_t own[4], source;
        const uint32_t *v;
        double t0, t1, a, b;
        if (tetcast_mesh_cell(mesh, list->cell[i], own, &source) != TETCAST_OK) continue;
        v = m->t + 4 * (size_t)source;
        if (!ref_tet(m->p + 3 * v[0], m->p + 3 * v[1], m->p + 3 * v[2], m->p + 3 * v[3], ray->org, ray->dir, &t0, &t1))
            continue;
        if (!(t1 > t0) || t1 < ray->t_min) continue;
        a = oracle_value(m, v, ray->org, ray->dir, t0);
        b = oracle_value(m, v, ray->org, ray->dir, t1);
        if ((a < iso && iso <= b) || (a > iso && iso >= b)) return t0 + (t1 - t0) * ((iso - a) / (b - a));
    }
    return (double)INFINITY;
}

#endif
