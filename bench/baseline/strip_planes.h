/* strip_planes.h - rays by planes through strips, only to be compared with - MIT OR Unlicense

   What the thesis keeps beside its strips decides what a step costs. Memory is least when nothing is kept: the planes of
   a cell are cross products of its four vertices, its value is that of barycentric coordinates. Speed is best with the
   normal and offset of each face, kept once for the two cells that share it and turned round by a bit in the number
   that the other cell has of it, and with the gradient of each cell; then a step reads no vertices. Both can be had one
   without the other.

   strips_planes_make   from a mesh with strips as its form of cells, its tets and its neighbours
   strips_planes_enter  where a ray comes in
   strips_planes_walk   one walk from there
   strips_planes_bytes  what is kept, all of it: columns, vertices, numbers of faces, faces, gradients
   strips_rows_make     strips into the rows of a texture, which they may not be broken over: the longest first, each into
                        the row where the least is left. What is left over and counted, here columns just follow each other */
#ifndef BASELINE_STRIP_PLANES_H_INCLUDED
#define BASELINE_STRIP_PLANES_H_INCLUDED
#include "planes.h"

#define STRIPS_PLANES_NORMALS 1u   /* a pool of faces and four numbers a column */
#define STRIPS_PLANES_GRADIENTS 2u /* value = g . x + g[3], a column */
#define STRIPS_PLANES_TURNED 0x80000000u

typedef struct strips_planes {
    const tetcasti_column *column;
    float (*vertex)[4];      /* world x, y, z, value */
    uint32_t (*number)[4];   /* of face k in the pool, TURNED: it points the other way; NULL */
    float (*plane)[4];       /* unit normal, offset; NULL */
    float (*gradient)[4];    /* NULL */
    uint32_t *first;         /* face of the hull -> column, as the mesh has it */
    uint32_t columns, cells, vertices, planes, faces;
} strips_planes;

static void strips_planes_free(strips_planes *s) {
    free(s->vertex);
    free(s->number);
    free(s->plane);
    free(s->gradient);
    memset(s, 0, sizeof *s);
}

static double strips_planes_bytes(const strips_planes *s) {
    return 12.0 * s->columns + 16.0 * s->vertices + (s->number != NULL ? 16.0 * s->columns + 16.0 * s->planes : 0.0) +
           (s->gradient != NULL ? 16.0 * s->columns : 0.0);
}

/* keep: what of STRIPS_PLANES_NORMALS, GRADIENTS. The mesh has to live longer. 0: no memory, or another form of cells. */
static int strips_planes_make(const tetcast_mesh *m, uint32_t keep, strips_planes *s) {
    const uint32_t *cell_of = (const uint32_t *)m->cells.side;
    uint32_t *place, i, k, a;
    baseline_list l;
    memset(s, 0, sizeof *s);
    if (m->cells.kind != TETCAST_CELLS_STRIPS && m->cells.kind != TETCAST_CELLS_STRIPS_GENERAL) return 0;
    if (!baseline_list_make(m, &l)) return 0;
    s->column = (const tetcasti_column *)m->cells.data;
    s->first = (uint32_t *)m->cells.first;
    s->columns = m->cells.count;
    s->cells = m->cell_count;
    s->vertices = m->vertex_count;
    s->faces = m->face_count;
    s->vertex = (float (*)[4])malloc(((size_t)s->vertices + 1) * sizeof *s->vertex);
    place = (uint32_t *)malloc(((size_t)s->cells + 1) * sizeof *place);
    if (keep & STRIPS_PLANES_NORMALS) {
        s->number = (uint32_t (*)[4])calloc((size_t)s->columns + 1, sizeof *s->number);
        s->plane = (float (*)[4])malloc(((size_t)4 * s->cells + 1) * sizeof *s->plane);
    }
    if (keep & STRIPS_PLANES_GRADIENTS) s->gradient = (float (*)[4])calloc((size_t)s->columns + 1, sizeof *s->gradient);
    if (s->vertex == NULL || place == NULL || ((keep & STRIPS_PLANES_NORMALS) && (s->number == NULL || s->plane == NULL)) ||
        ((keep & STRIPS_PLANES_GRADIENTS) && s->gradient == NULL)) {
        strips_planes_free(s);
        free(place);
        baseline_list_free(&l);
        return 0;
    }
    for (i = 0; i < s->vertices; i++) {
        double p[3];
        tetcast_mesh_vertex(m, i, p, NULL, NULL);
        for (a = 0; a < 3; a++) s->vertex[i][a] = (float)p[a];
        s->vertex[i][3] = m->vertex[i].s;
    }
    for (i = 0; i < s->columns; i++)
        if (cell_of[i] != TETCASTI_NONE) place[cell_of[i]] = i;
    for (i = 0; i < s->cells; i++) {
        const baseline_cell *c = &l.cell[i];
        const uint32_t to = place[i];
        if (s->gradient != NULL) memcpy(s->gradient[to], c->g, sizeof c->g);
        for (k = 0; k < 4 && s->number != NULL; k++) { /* face k of the list is opposite tet[k]; of the column: v */
            const uint32_t v = m->tet[i][k], n = c->a[k];
            uint32_t f = 0;
            while (s->column[to + f].v != v) f++;
            if (n == TETCASTI_NONE || n > i) { /* the first of the two cells brings the face */
                float *p = s->plane[s->planes];
                p[0] = c->nx[k];
                p[1] = c->ny[k];
                p[2] = c->nz[k];
                p[3] = c->o[k];
                s->number[to][f] = s->planes++;
            } else {
                const uint32_t w = m->tet[n][c->f[k]];
                uint32_t g = 0;
                const float *p;
                while (s->column[place[n] + g].v != w) g++;
                s->number[to][f] = s->number[place[n]][g] & ~STRIPS_PLANES_TURNED;
                p = s->plane[s->number[to][f]];
                if (p[0] * c->nx[k] + p[1] * c->ny[k] + p[2] * c->nz[k] < 0) s->number[to][f] |= STRIPS_PLANES_TURNED;
            }
        }
    }
    free(place);
    baseline_list_free(&l);
    return 1;
}

/* Outward plane of face k of the cell at a column, not of unit length: (a - x) . n for the ray's x = e, and n . d. */
TETCASTI_INLINE void strips_planes_face(const strips_planes *s, uint32_t column, uint32_t k, const float e[3],
                                        const float d[3], float n[3], float *num, float *along) {
    uint32_t i;
    if (s->number != NULL) {
        const uint32_t number = s->number[column][k];
        const float *p = s->plane[number & ~STRIPS_PLANES_TURNED], sign = number & STRIPS_PLANES_TURNED ? -1.0f : 1.0f;
        for (i = 0; i < 3; i++) n[i] = sign * p[i];
        *num = sign * p[3] - (n[0] * e[0] + n[1] * e[1] + n[2] * e[2]);
    } else {
        const float *a = s->vertex[s->column[column + ((k + 1) & 3)].v], *b = s->vertex[s->column[column + ((k + 2) & 3)].v];
        const float *c = s->vertex[s->column[column + ((k + 3) & 3)].v], *o = s->vertex[s->column[column + k].v];
        float u[3], w[3], side = 0;
        for (i = 0; i < 3; i++) {
            u[i] = b[i] - a[i];
            w[i] = c[i] - a[i];
        }
        n[0] = u[1] * w[2] - u[2] * w[1];
        n[1] = u[2] * w[0] - u[0] * w[2];
        n[2] = u[0] * w[1] - u[1] * w[0];
        for (i = 0; i < 3; i++) side += n[i] * (o[i] - a[i]);
        for (i = 0; i < 3 && side > 0; i++) n[i] = -n[i];
        *num = n[0] * (a[0] - e[0]) + n[1] * (a[1] - e[1]) + n[2] * (a[2] - e[2]);
    }
    *along = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
}

/* Value at x: by the gradient, or the mean of the vertices, weighted with their distances to the faces opposite. */
TETCASTI_INLINE float strips_planes_value(const strips_planes *s, uint32_t column, const float x[3]) {
    float sum = 0;
    uint32_t k, i;
    if (s->gradient != NULL) {
        const float *g = s->gradient[column];
        return g[0] * x[0] + g[1] * x[1] + (g[2] * x[2] + g[3]);
    }
    for (k = 0; k < 4; k++) {
        const float *a = s->vertex[s->column[column + 3 - k].v], *b = s->vertex[s->column[column + k].v];
        const float zero[3] = {0, 0, 0};
        float n[3], at = 0, whole = 0, num, along;
        strips_planes_face(s, column, k, zero, zero, n, &num, &along);
        for (i = 0; i < 3; i++) {
            at += n[i] * (x[i] - a[i]);
            whole += n[i] * (b[i] - a[i]);
        }
        if (whole != 0) sum += at / whole * b[3];
    }
    return sum;
}

/* From a column on, which the ray (unit d) enters at distance `at`. Adds to *length; sum: NULL, or what o collects. */
static void strips_planes_walk(const strips_planes *s, const float e[3], const float d[3], uint32_t column, float at,
                               const tetcast_optics *o, tetcasti_ray_sum *sum, double *length, baseline_stats *stats) {
    const uint32_t limit = 4 * s->cells + 100;
    float value = 0, x[3];
    uint32_t step, k, i;
    for (step = 0; step < limit && column != TETCASTI_NONE; step++) {
        float best = 3e38f;
        uint32_t out = 4;
        for (k = 0; k < 4; k++) {
            float n[3], num, along;
            strips_planes_face(s, column, k, e, d, n, &num, &along);
            if (along > 0 && num / along < best) {
                best = num / along;
                out = k;
            }
        }
        if (out == 4) {
            stats->no_exit++;
            break;
        }
        if (sum != NULL) {
            float back;
            for (i = 0; i < 3 && step == 0; i++) x[i] = e[i] + at * d[i];
            if (step == 0) value = strips_planes_value(s, column, x);
            for (i = 0; i < 3; i++) x[i] = e[i] + best * d[i];
            back = strips_planes_value(s, column, x);
            if (best > at) o->segment(o, value, back, best - at, at, sum);
            value = back;
        }
        if (best > at) {
            *length += (double)(best - at);
            at = best;
        }
        column = tetcasti_strip_neighbour(s->column + column, column, out);
    }
    stats->endless += step == limit;
    stats->steps += step;
    stats->walks++;
}

/* Where a ray comes into the mesh: the column, NONE for none, and the distance. Looks at all faces of the hull. */
static uint32_t strips_planes_enter(const strips_planes *s, const tetcast_mesh *m, const tetcast_ray *ray, float *at) {
    double local[3], t;
    uint32_t k, f, found = TETCASTI_NONE;
    tetcasti_ray r;
    for (k = 0; k < 3; k++) local[k] = (ray->org[k] - m->origin[k]) / m->unit;
    r.group = tetcasti_ray_group(ray->dir);
    *at = 3e38f;
    if (r.group == TETCASTI_NO_RAY) return found;
    t = tetcasti_ray_make(&m->box, local, ray->dir, &r);
    if (r.group == TETCASTI_NO_RAY) return found;
    for (f = 0; f < s->faces; f++) {
        float z;
        if (!tetcasti_face_hit(0, &r, m->vertex, m->face[f].v, &z) || !((float)((t + (double)z) * m->unit) < *at)) continue;
        *at = (float)((t + (double)z) * m->unit);
        found = s->first[f];
    }
    return found;
}

/* ---- rows ---- */

typedef struct strips_rows {
    uint32_t *first, *length, *row, *offset; /* per strip: its columns, its place */
    uint32_t strips, rows, width;
    uint32_t repeated;       /* columns of vertices that are there again so that a strip can turn */
} strips_rows;

static void strips_rows_free(strips_rows *r) {
    free(r->first);
    memset(r, 0, sizeof *r);
}

/* width: columns of a row; 0: no memory, another form of cells, or a strip is longer than a row. */
static int strips_rows_make(const tetcast_mesh *m, uint32_t width, strips_rows *r) {
    const uint32_t *cell_of = (const uint32_t *)m->cells.side;
    uint32_t *start, *order, *head, *next, i, k, none = 0;
    memset(r, 0, sizeof *r);
    if (m->cells.kind != TETCAST_CELLS_STRIPS && m->cells.kind != TETCAST_CELLS_STRIPS_GENERAL) return 0;
    for (i = 0; i < m->cells.count; i++) { /* a strip ends with three columns without a cell, within it there are fewer */
        none = cell_of[i] == TETCASTI_NONE ? none + 1 : 0;
        if (none == 3) {
            r->strips++;
            none = 0;
        }
    }
    r->repeated = m->cells.count - m->cell_count - 3 * r->strips;
    r->width = width;
    r->first = (uint32_t *)malloc(((size_t)6 * r->strips + 2 * (size_t)width + 4) * sizeof *r->first);
    if (r->first == NULL) return 0;
    r->length = r->first + r->strips;
    r->row = r->length + r->strips;
    r->offset = r->row + r->strips;
    order = r->offset + r->strips;
    next = order + r->strips;  /* of a row: the next one with as much left */
    head = next + r->strips;   /* [columns left] */
    start = head + width + 1;  /* [length] */
    memset(start, 0, ((size_t)width + 2) * sizeof *start);
    for (i = k = none = 0; i < m->cells.count; i++) {
        if (i == 0 || none == 3) {
            r->first[k] = i;
            none = 0;
        }
        none = cell_of[i] == TETCASTI_NONE ? none + 1 : 0;
        if (none != 3) continue;
        r->length[k] = i + 1 - r->first[k];
        if (r->length[k] > width) {
            strips_rows_free(r);
            return 0;
        }
        start[width - r->length[k] + 1]++;
        k++;
    }
    for (i = 0; i <= width; i++) start[i + 1] += start[i];
    for (i = 0; i < r->strips; i++) order[start[width - r->length[i]]++] = i;
    for (i = 0; i <= width; i++) head[i] = TETCASTI_NONE;
    for (i = 0; i < r->strips; i++) {
        const uint32_t strip = order[i];
        uint32_t left = r->length[strip], row;
        while (left <= width && head[left] == TETCASTI_NONE) left++;
        if (left > width) {
            left = width;
            row = r->rows++;
        } else {
            row = head[left];
            head[left] = next[row];
        }
        r->row[strip] = row;
        r->offset[strip] = width - left;
        left -= r->length[strip];
        next[row] = head[left];
        head[left] = row;
    }
    return 1;
}

#endif
