/* slices.h - the thesis' other two resamplers, slice by slice, to be compared with - MIT OR Unlicense, see LICENSE

   SLICES_MASK     each slice of a cell: the barycentric coordinates of the four vertices are linear on the slice plane;
                   the box of the section is scanned and nodes with a coordinate below 0 are left out. On the graphics
                   card of the time: one or two triangles with two border textures and an alpha test
   SLICES_SECTION  marching tetrahedra: signed distances of the vertices give the section, a triangle or a quadrilateral,
                   with values at its corners; its rows are filled by linear interpolation, as Gouraud shading would
   Both sweep along z and keep a list of the cells that the slice meets: a cell is in the bucket of its lowest and of its
   highest layer; it is taken up when the sweep enters the first and dropped when it leaves the last.
   Same lattice, same field as tetcast_resample; nodes outside are NaN. They bring tetcast.h with its implementation. */
#ifndef SLICES_H_INCLUDED
#define SLICES_H_INCLUDED
#ifndef TETCAST_IMPLEMENTATION
#  define TETCAST_IMPLEMENTATION
#endif
#include "../../tetcast.h"

typedef enum slices_method { SLICES_MASK, SLICES_SECTION } slices_method;
typedef struct slices_stats { uint64_t pieces, scanned, written; } slices_stats; /* sections, nodes looked at, nodes inside */

/* A cell in lattice units. */
typedef struct slices_cell {
    double p[4][3], s[4];
    double b[4][4];            /* coordinate i = b[i][0] + b[i][1] x + b[i][2] y + b[i][3] z */
    int32_t lo, hi;            /* layers */
    uint32_t next;             /* in the list of active cells */
} slices_cell;

/* 0: flat, or between layers. */
static int slices_open(const tetcast_mesh *mesh, const tetcast_lattice *l, uint32_t cell, slices_cell *c) {
    double m[3][3], det, lo = 1e300, hi = -1e300;
    uint32_t i, a;
    for (i = 0; i < 4; i++) {
        const tetcasti_vertex *v = &mesh->vertex[mesh->tet[cell][i]];
        const double q[3] = {(double)v->x, (double)v->y, (double)v->z};
        for (a = 0; a < 3; a++) c->p[i][a] = (mesh->origin[a] + q[a] * mesh->unit - l->origin[a]) / l->spacing[a];
        c->s[i] = (double)v->s;
        lo = c->p[i][2] < lo ? c->p[i][2] : lo;
        hi = c->p[i][2] > hi ? c->p[i][2] : hi;
    }
    lo -= 1e-9;
    hi += 1e-9;
    if (!(hi >= 0.0) || !(lo <= (double)(l->dims[2] - 1))) return 0;
    c->lo = lo <= 0.0 ? 0 : (int32_t)lo + ((double)(int32_t)lo < lo);
    c->hi = hi >= (double)(l->dims[2] - 1) ? (int32_t)l->dims[2] - 1 : (int32_t)hi;
    if (c->lo > c->hi) return 0;
    for (i = 0; i < 3; i++)
        for (a = 0; a < 3; a++) m[i][a] = c->p[i + 1][a] - c->p[0][a];
    det = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
          m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
    if (!(det > 1e-30 || det < -1e-30)) return 0;
    for (i = 0; i < 3; i++) { /* rows of the inverse */
        const double *u = m[(i + 1) % 3], *v = m[(i + 2) % 3];
        c->b[i + 1][1] = (u[1] * v[2] - u[2] * v[1]) / det;
        c->b[i + 1][2] = (u[2] * v[0] - u[0] * v[2]) / det;
        c->b[i + 1][3] = (u[0] * v[1] - u[1] * v[0]) / det;
        c->b[i + 1][0] = -(c->b[i + 1][1] * c->p[0][0] + c->b[i + 1][2] * c->p[0][1] + c->b[i + 1][3] * c->p[0][2]);
    }
    for (a = 0; a < 4; a++) c->b[0][a] = (a == 0 ? 1.0 : 0.0) - c->b[1][a] - c->b[2][a] - c->b[3][a];
    return 1;
}

/* Section of a cell with the plane z: corners {x, y, value} in order around it. Returns how many, 0, 3 or 4. */
static uint32_t slices_section(const slices_cell *c, double z, double out[4][3]) {
    uint32_t above[4], below[4], na = 0, nb = 0, n = 0, i, k, order[4][2];
    for (i = 0; i < 4; i++) {
        if (c->p[i][2] >= z) above[na++] = i;
        else below[nb++] = i;
    }
    if (na == 0 || nb == 0) return 0;
    if (na == 2) { /* ac, ad, bd, bc */
        for (i = 0; i < 4; i++) {
            order[i][0] = above[i >> 1];
            order[i][1] = below[(i == 1 || i == 2) ? 1 : 0];
        }
        n = 4;
    } else {
        for (i = 0; i < 3; i++) {
            order[i][0] = na == 1 ? above[0] : above[i];
            order[i][1] = na == 1 ? below[i] : below[0];
        }
        n = 3;
    }
    for (i = 0; i < n; i++) {
        const double *p = c->p[order[i][0]], *q = c->p[order[i][1]], w = (p[2] - z) / (p[2] - q[2]);
        for (k = 0; k < 2; k++) out[i][k] = p[k] + w * (q[k] - p[k]);
        out[i][2] = c->s[order[i][0]] + w * (c->s[order[i][1]] - c->s[order[i][0]]);
    }
    return n;
}

static int32_t slices_clamp(double x, int32_t end, int up) {
    const int32_t i = x <= 0.0 ? 0 : x >= (double)end ? end : (int32_t)x;
    return up && (double)i < x && i < end ? i + 1 : i;
}

/* One cell in one slice. */
static void slices_mask(const slices_cell *c, const tetcast_lattice *l, int32_t layer, float *out, slices_stats *t) {
    double corner[4][3], lo[2] = {1e300, 1e300}, hi[2] = {-1e300, -1e300}, s[3];
    const uint32_t n = slices_section(c, (double)layer, corner);
    int32_t x0, x1, y0, y1, x, y;
    uint32_t i, a;
    for (i = 0; i < n; i++)
        for (a = 0; a < 2; a++) {
            lo[a] = corner[i][a] < lo[a] ? corner[i][a] : lo[a];
            hi[a] = corner[i][a] > hi[a] ? corner[i][a] : hi[a];
        }
    for (i = 0; n == 0 && i < 4; i++) /* only touches it: vertices of which some lie in the plane */
        if (c->p[i][2] >= (double)layer - 1e-9 && c->p[i][2] <= (double)layer + 1e-9)
            for (a = 0; a < 2; a++) {
                lo[a] = c->p[i][a] < lo[a] ? c->p[i][a] : lo[a];
                hi[a] = c->p[i][a] > hi[a] ? c->p[i][a] : hi[a];
            }
    if (!(hi[0] >= -1e-9 && hi[1] >= -1e-9) || !(lo[0] <= (double)l->dims[0]) || !(lo[1] <= (double)l->dims[1])) return;
    t->pieces++;
    x0 = slices_clamp(lo[0] - 1e-9, (int32_t)l->dims[0] - 1, 1);
    x1 = slices_clamp(hi[0] + 1e-9, (int32_t)l->dims[0] - 1, 0);
    y0 = slices_clamp(lo[1] - 1e-9, (int32_t)l->dims[1] - 1, 1);
    y1 = slices_clamp(hi[1] + 1e-9, (int32_t)l->dims[1] - 1, 0);
    for (a = 0; a < 3; a++) s[a] = 0.0;
    for (i = 0; i < 4; i++) {
        s[0] += c->s[i] * (c->b[i][0] + c->b[i][3] * (double)layer);
        s[1] += c->s[i] * c->b[i][1];
        s[2] += c->s[i] * c->b[i][2];
    }
    for (y = y0; y <= y1; y++) {
        double b[4];
        float *row = out + (size_t)l->dims[0] * ((size_t)y + (size_t)l->dims[1] * (size_t)layer);
        for (i = 0; i < 4; i++) b[i] = (c->b[i][0] + c->b[i][3] * (double)layer) + c->b[i][2] * (double)y;
        for (x = x0; x <= x1; x++) {
            const double fx = (double)x;
            t->scanned++;
            if (b[0] + c->b[0][1] * fx < -1e-12 || b[1] + c->b[1][1] * fx < -1e-12 || b[2] + c->b[2][1] * fx < -1e-12 ||
                b[3] + c->b[3][1] * fx < -1e-12) continue;
            t->written++;
            row[x] = (float)(s[0] + s[1] * fx + s[2] * (double)y);
        }
    }
}

/* A triangle of the section, row by row. */
static void slices_triangle(const double *a, const double *b, const double *c, const tetcast_lattice *l, float *slice, slices_stats *t) {
    const double *v[3], *swap;
    int32_t y0, y1, y, x0, x1, x;
    uint32_t i, k;
    v[0] = a;
    v[1] = b;
    v[2] = c;
    for (i = 0; i < 2; i++)
        for (k = 0; k + 1 < 3 - i; k++)
            if (v[k][1] > v[k + 1][1]) {
                swap = v[k];
                v[k] = v[k + 1];
                v[k + 1] = swap;
            }
    if (v[2][1] < -1e-9 || v[0][1] > (double)(l->dims[1] - 1) + 1e-9) return;
    y0 = slices_clamp(v[0][1] - 1e-9, (int32_t)l->dims[1] - 1, 1);
    y1 = slices_clamp(v[2][1] + 1e-9, (int32_t)l->dims[1] - 1, 0);
    for (y = y0; y <= y1; y++) {
        double e[2][2], w; /* both ends: x, value */
        const double fy = (double)y < v[0][1] ? v[0][1] : (double)y > v[2][1] ? v[2][1] : (double)y;
        const double *p = fy < v[1][1] ? v[0] : v[1], *q = fy < v[1][1] ? v[1] : v[2];
        w = v[2][1] > v[0][1] ? (fy - v[0][1]) / (v[2][1] - v[0][1]) : 0.0;
        e[0][0] = v[0][0] + w * (v[2][0] - v[0][0]);
        e[0][1] = v[0][2] + w * (v[2][2] - v[0][2]);
        w = q[1] > p[1] ? (fy - p[1]) / (q[1] - p[1]) : 0.0;
        e[1][0] = p[0] + w * (q[0] - p[0]);
        e[1][1] = p[2] + w * (q[2] - p[2]);
        i = e[0][0] > e[1][0];
        if (e[1 - i][0] < -1e-9 || e[i][0] > (double)(l->dims[0] - 1) + 1e-9) continue;
        x0 = slices_clamp(e[i][0] - 1e-9, (int32_t)l->dims[0] - 1, 1);
        x1 = slices_clamp(e[1 - i][0] + 1e-9, (int32_t)l->dims[0] - 1, 0);
        for (x = x0; x <= x1; x++) {
            const double width = e[1 - i][0] - e[i][0];
            w = width > 1e-12 ? ((double)x - e[i][0]) / width : 0.0;
            w = w < 0.0 ? 0.0 : w > 1.0 ? 1.0 : w;
            t->scanned++;
            t->written++;
            slice[(size_t)l->dims[0] * (size_t)y + (size_t)x] = (float)(e[i][1] + w * (e[1 - i][1] - e[i][1]));
        }
    }
}

static void slices_fill(const slices_cell *c, const tetcast_lattice *l, int32_t layer, float *out, slices_stats *t) {
    double corner[4][3];
    const uint32_t n = slices_section(c, (double)layer, corner);
    float *slice = out + (size_t)l->dims[0] * l->dims[1] * (size_t)layer;
    if (n == 0) return;
    t->pieces++;
    slices_triangle(corner[0], corner[1], corner[2], l, slice, t);
    if (n == 4) slices_triangle(corner[0], corner[2], corner[3], l, slice, t);
}

/* Resample the mesh's field. Needs the tets; field per vertex. 0: no memory. */
static int slices_resample(const tetcast_mesh *mesh, const tetcast_lattice *l, slices_method method, float *out, slices_stats *stats) {
    const size_t nodes = (size_t)l->dims[0] * l->dims[1] * l->dims[2];
    const uint32_t none = 0xffffffffu;
    slices_cell *cell = (slices_cell *)malloc(((size_t)mesh->cell_count + 1) * sizeof *cell);
    uint32_t *bucket = (uint32_t *)malloc((size_t)l->dims[2] * sizeof *bucket), *link, active = none, count = 0, i;
    int32_t layer;
    size_t k;
    memset(stats, 0, sizeof *stats);
    if (cell == NULL || bucket == NULL) {
        free(cell);
        free(bucket);
        return 0;
    }
    for (k = 0; k < nodes; k++) out[k] = (float)NAN;
    for (i = 0; i < l->dims[2]; i++) bucket[i] = none;
    for (i = 0; i < mesh->cell_count; i++) {
        if (mesh->hidden != NULL && (mesh->hidden[i >> 5] >> (i & 31u) & 1u)) continue;
        if (!slices_open(mesh, l, i, &cell[count])) continue;
        cell[count].next = bucket[cell[count].lo];
        bucket[cell[count].lo] = count;
        count++;
    }
    for (layer = 0; layer < (int32_t)l->dims[2]; layer++) {
        while (bucket[layer] != none) { /* taken up */
            slices_cell *c = &cell[i = bucket[layer]];
            bucket[layer] = c->next;
            c->next = active;
            active = i;
        }
        for (link = &active; *link != none;) {
            slices_cell *c = &cell[*link];
            if (method == SLICES_MASK) slices_mask(c, l, layer, out, stats);
            else slices_fill(c, l, layer, out, stats);
            if (c->hi == layer) *link = c->next; /* dropped */
            else link = &c->next;
        }
    }
    free(cell);
    free(bucket);
    return 1;
}

#endif
