/* cell_projection.h - ways to project cells that exist only to be compared with - MIT OR Unlicense, see LICENSE

   It uses private functions and brings tetcast.h with its implementation where that is not there yet. Camera, tiles,
   integrators and pictures are those of tetcast_render; what is different is how a cell becomes fragments, or in which
   order these are added up. One thread.

   How a cell becomes fragments
   PROJECTION_SIGNS      as tetcast_render does
   PROJECTION_VERTEX     thesis 4.2, for parallel rays only: each front face is drawn; at a vertex the way to the plane
                       opposite to it is known, it is interpolated over the face, and the smallest of three counts.
                       repair 0: ways into the cell (negative ones) are made large at the vertex: along an edge to
                       another front face its weight is 0 all the same, which leaves lines of no thickness (4.2.4)
                       repair 1: as the thesis: the channel of that face is made large at the start of the edge, too
                       repair 2: planes of front faces are left out, which is known once per face: nothing to repair
                       table n: the smallest of three by nearest look-up in n^3 entries of 8 bits, as in the texture
                       of the thesis, ways in units of the longest edge of the cell
   PROJECTION_FRAGMENT   thesis 4.3: each front face is drawn, each fragment meets the planes of the other three faces.
                       planes 2: the third is not tested, as on the hardware of the thesis: wrong where the drawn face
                       is not the only one in front
   PROJECTION_PT         projected tetrahedra (Shirley, Tuchman 1990): the outline is cut into three or four triangles
                       around the thickest point; depths and values are interpolated on them, linearly in the picture
                       (correction 0: wrong in perspective) or divided by depth (1; Kraus, Qiao, Ebert 2004)
   PROJECTION_PT_COLORS  colour and opacity themselves are linear between the thickest point and the outline, as in the
                       original; goes into the picture in the order of drawing

   In which order
   PROJECTION_LISTS      as tetcast_render does: by depth, pixel by pixel
   PROJECTION_CENTROID   cells by the depth of their middles
   PROJECTION_MPVO       Williams (1992): cells that hide a neighbour come before it; where several come into question,
                       as for meshes that are not convex, the nearest middle first; a cycle is cut at its nearest
                       middle and counted
   PROJECTION_RANDOM     any order
   keep k: each pixel keeps the k nearest fragments (k-buffer; Callahan et al. 2005); 0 or 1: none */
#ifndef BASELINE_CELL_PROJECTION_H_INCLUDED
#define BASELINE_CELL_PROJECTION_H_INCLUDED
#ifndef TETCAST_IMPLEMENTATION
#  define TETCAST_IMPLEMENTATION
#endif
#include "../../tetcast.h"

typedef enum projection_form {
    PROJECTION_SIGNS, PROJECTION_VERTEX, PROJECTION_FRAGMENT, PROJECTION_PT, PROJECTION_PT_COLORS
} projection_form;
typedef enum projection_order {
    PROJECTION_LISTS, PROJECTION_CENTROID, PROJECTION_MPVO, PROJECTION_RANDOM
} projection_order;

typedef struct projection_way {
    projection_form form;
    projection_order order;
    uint32_t keep;          /* 0 to 255 */
    uint32_t repair, table, planes, correction;
} projection_way;

typedef struct projection_report {
    uint64_t fragments;     /* that went into sums */
    uint64_t violations;    /* of these: came after one that lies behind them */
    uint64_t cycles;        /* PROJECTION_MPVO: cells that were taken although another one hides them */
    uint64_t exact_tests;
} projection_report;

/* ---- orders ---- */

typedef struct projection_heap { uint32_t *cell; const float *key; uint32_t count; } projection_heap;

static int projection_before(const projection_heap *h, uint32_t a, uint32_t b) {
    return h->key[a] < h->key[b] || (h->key[a] == h->key[b] && a < b);
}

static void projection_push(projection_heap *h, uint32_t cell) {
    uint32_t i = h->count++;
    while (i > 0 && projection_before(h, cell, h->cell[(i - 1) / 2])) {
        h->cell[i] = h->cell[(i - 1) / 2];
        i = (i - 1) / 2;
    }
    h->cell[i] = cell;
}

static uint32_t projection_pop(projection_heap *h) {
    uint32_t top = h->cell[0], last = h->cell[--h->count], i = 0;
    for (;;) {
        uint32_t k = 2 * i + 1;
        if (k >= h->count) break;
        if (k + 1 < h->count && projection_before(h, h->cell[k + 1], h->cell[k])) k++;
        if (!projection_before(h, h->cell[k], last)) break;
        h->cell[i] = h->cell[k];
        i = k;
    }
    if (h->count != 0) h->cell[i] = last;
    return top;
}

/* 1: `other`, behind face i of the cell, hides the cell; -1: the other way round; 0: the face is seen edge-on. */
static int projection_hides(const tetcasti_pixels *m, const tetcasti_vertex *vertex, const uint32_t tet[4],
                            uint32_t i) {
    double p[3][3], n[3], side = 0.0, w[3], e[2][3];
    uint32_t k, a;
    for (k = 0; k < 3; k++) {
        const tetcasti_vertex *q = &vertex[tet[tetcasti_face_of[i][k]]];
        p[k][0] = (double)q->x;
        p[k][1] = (double)q->y;
        p[k][2] = (double)q->z;
    }
    for (a = 0; a < 3; a++) {
        e[0][a] = p[1][a] - p[0][a];
        e[1][a] = p[2][a] - p[0][a];
        w[a] = m->parallel ? -m->forward[a] : m->eye[a] - p[0][a];
    }
    tetcasti_cross(e[0], e[1], n);
    for (a = 0; a < 3; a++) side += n[a] * w[a];
    return side > 0.0 ? 1 : side < 0.0 ? -1 : 0;
}

/* Ranks of all cells, front to back. Needs the neighbours for PROJECTION_MPVO. */
static tetcast_result projection_rank(tetcasti_mem *mem, const tetcast_mesh *mesh, const tetcasti_pixels *m,
                                    projection_order order, uint32_t *rank, uint64_t *cycles) {
    const uint32_t n = mesh->cell_count;
    float *depth = (float *)tetcasti_alloc_array(mem, n, sizeof *depth);
    uint32_t *heap = (uint32_t *)tetcasti_alloc_array(mem, n, sizeof *heap);
    uint32_t *hidden = (uint32_t *)tetcasti_alloc_zero(mem, n, sizeof *hidden);
    uint32_t *sorted = (uint32_t *)tetcasti_alloc_array(mem, n, sizeof *sorted);
    projection_heap h;
    tetcast_result r = TETCAST_OK;
    uint32_t i, k, at = 0, left = 0;
    if (depth == NULL || heap == NULL || hidden == NULL || sorted == NULL) r = TETCAST_ERR_NO_MEMORY;
    else if (order == PROJECTION_MPVO && mesh->neighbour == NULL) r = TETCAST_ERR_INVALID_ARG;
    for (i = 0; r == TETCAST_OK && i < n; i++) {
        double z = 0.0;
        for (k = 0; k < 4; k++) {
            const tetcasti_vertex *v = &mesh->vertex[mesh->tet[i][k]];
            z += (double)v->x * m->forward[0] + (double)v->y * m->forward[1] + (double)v->z * m->forward[2];
        }
        depth[i] = (float)z;
        if (order == PROJECTION_RANDOM) depth[i] = (float)(tetcasti_hash32(i) >> 8);
    }
    h.cell = heap;
    h.key = depth;
    h.count = 0;
    for (i = 0; r == TETCAST_OK && i < n; i++) projection_push(&h, i);
    for (i = 0; r == TETCAST_OK && i < n; i++) sorted[i] = projection_pop(&h);
    if (r == TETCAST_OK && order != PROJECTION_MPVO)
        for (i = 0; i < n; i++) rank[sorted[i]] = i;
    if (r == TETCAST_OK && order == PROJECTION_MPVO) {
        for (i = 0; i < n; i++) {
            for (k = 0; k < 4; k++)
                hidden[i] += mesh->neighbour[i][k] != TETCASTI_NONE &&
                             projection_hides(m, mesh->vertex, mesh->tet[i], k) > 0;
            rank[i] = TETCASTI_NONE;
        }
        for (i = 0; i < n; i++)
            if (hidden[i] == 0) projection_push(&h, i);
        while (left < n) {
            uint32_t cell;
            if (h.count == 0) { /* all that are left are hidden by others */
                while (rank[sorted[at]] != TETCASTI_NONE) at++;
                projection_push(&h, sorted[at]);
                ++*cycles;
            }
            cell = projection_pop(&h);
            if (rank[cell] != TETCASTI_NONE) continue;
            rank[cell] = left++;
            for (k = 0; k < 4; k++) {
                uint32_t other = mesh->neighbour[cell][k];
                if (other == TETCASTI_NONE || rank[other] != TETCASTI_NONE ||
                    projection_hides(m, mesh->vertex, mesh->tet[cell], k) >= 0) continue;
                if (--hidden[other] == 0) projection_push(&h, other);
            }
        }
    }
    tetcasti_free(mem, depth);
    tetcasti_free(mem, heap);
    tetcasti_free(mem, hidden);
    tetcasti_free(mem, sorted);
    return r;
}

/* ---- cells ---- */

static const projection_way *projection_of(const tetcasti_painter *p);

typedef struct projection_painter { /* what paint functions find behind the painter's view */
    tetcasti_view view;
    const projection_way *how;
} projection_painter;

static const projection_way *projection_of(const tetcasti_painter *p) {
    return ((const projection_painter *)(const void *)p->view)->how;
}

/* A cell in the picture, in doubles: x, y in pixels of the tile (centres of pixels are whole numbers), depth, value. */
typedef struct projection_cell {
    double x[4], y[4], z[4], w[4], s[4], p[4][3];
    double area[4];             /* of its faces, negative: in front */
    int32_t rect[4];
} projection_cell;

static double projection_cross(const projection_cell *c, uint32_t i, uint32_t j, double x, double y) {
    return (c->x[i] - x) * (c->y[j] - y) - (c->y[i] - y) * (c->x[j] - x);
}

static int projection_cell_open(const tetcasti_painter *p, uint32_t cell, projection_cell *c) {
    const uint32_t *tet = p->scene->mesh->tet[cell];
    const tetcasti_view *v = p->view;
    uint32_t i;
    if (!tetcasti_tile_rect(p, tet, c->rect)) return 0;
    for (i = 0; i < 4; i++) {
        const tetcasti_seen *q = &v->seen[tet[i]];
        const tetcasti_vertex *g = &p->scene->vertex[tet[i]];
        if (!(q->w > 0.0f)) return 0; /* these forms draw what is in front of the eye and near the picture */
        c->x[i] = (double)q->x * (double)v->place - 0.5 - (double)p->x0;
        c->y[i] = (double)q->y * (double)v->place - 0.5 - (double)p->y0;
        c->z[i] = (double)q->z;
        c->w[i] = (double)q->w;
        c->s[i] = (double)g->s;
        c->p[i][0] = (double)g->x;
        c->p[i][1] = (double)g->y;
        c->p[i][2] = (double)g->z;
    }
    for (i = 0; i < 4; i++) {
        const uint8_t *f = tetcasti_face_of[i];
        c->area[i] = projection_cross(c, f[1], f[2], c->x[f[0]], c->y[f[0]]);
    }
    return 1;
}

/* Weights of the triangle at a pixel, which add up to 1; 0: outside. Edges belong to one of the two sides. */
static int projection_inside(const double x[3], const double y[3], double px, double py, double weight[3]) {
    double sum = 0.0;
    uint32_t i;
    for (i = 0; i < 3; i++) {
        uint32_t j = (i + 1) % 3, k = (i + 2) % 3;
        double dx = x[k] - x[j], dy = y[k] - y[j], e = dx * (py - y[j]) - dy * (px - x[j]);
        if (e < 0.0 || (e == 0.0 && !(dy < 0.0 || (dy == 0.0 && dx > 0.0)))) return 0;
        weight[i] = e;
        sum += e;
    }
    for (i = 0; i < 3; i++) weight[i] /= sum;
    return sum > 0.0;
}

static void projection_put(tetcasti_painter *p, int32_t x, int32_t y, double z0, double z1, double s0, double s1,
                         uint32_t cell) {
    uint32_t i = (uint32_t)y * TETCASTI_TILE + (uint32_t)x;
    tetcasti_fragment f;
    f.z0 = (float)z0;
    f.z1 = (float)z1;
    f.s0 = (float)s0;
    f.s1 = (float)s1;
    f.cell = cell;
    p->tests++;
    if (!tetcasti_pixel_live(p, i)) return;
    if (p->count[i] == p->room && !tetcasti_lists_grow(p)) return; /* faces of a cell may overlap by rounding */
    tetcasti_paint_put(p, i, &f);
}

/* Outward normal of face i and the gradient of the value. */
static void projection_planes(const projection_cell *c, double n[4][3], double gradient[3]) {
    uint32_t i, k;
    gradient[0] = gradient[1] = gradient[2] = 0.0;
    for (i = 0; i < 4; i++) {
        const uint8_t *f = tetcasti_face_of[i];
        double e[2][3], height = 0.0;
        for (k = 0; k < 3; k++) {
            e[0][k] = c->p[f[1]][k] - c->p[f[0]][k];
            e[1][k] = c->p[f[2]][k] - c->p[f[0]][k];
        }
        tetcasti_cross(e[0], e[1], n[i]);
        for (k = 0; k < 3; k++) height += n[i][k] * (c->p[i][k] - c->p[f[0]][k]);
        for (k = 0; k < 3; k++) gradient[k] += height != 0.0 ? c->s[i] * n[i][k] / height : 0.0;
    }
}

/* Front face i in the order that is positive in the picture. */
static void projection_face(const projection_cell *c, uint32_t i, uint32_t v[3], double x[3], double y[3]) {
    uint32_t k;
    for (k = 0; k < 3; k++) {
        v[k] = tetcasti_face_of[i][k == 0 ? 0 : 3 - k];
        x[k] = c->x[v[k]];
        y[k] = c->y[v[k]];
    }
}

static double projection_min_table(const double way[3], double unit, uint32_t n) {
    double least = 1.0;
    uint32_t k;
    if (n == 0) return tetcasti_min(tetcasti_min(way[0], way[1]), way[2]);
    for (k = 0; k < 3; k++) { /* nearest of n entries in [0, 1] on each axis, clamped */
        double at = tetcasti_min(tetcasti_max(way[k] / unit, 0.0), 1.0) * (double)n - 0.5;
        at = tetcasti_min(tetcasti_max((double)tetcasti_floor(at + 0.5), 0.0), (double)(n - 1));
        least = tetcasti_min(least, (at + 0.5) / (double)n);
    }
    return (double)tetcasti_floor(least * 255.0 + 0.5) / 255.0 * unit;
}

static void projection_paint_vertex(tetcasti_painter *p, uint32_t cell) {
    const projection_way *how = projection_of(p);
    const double *forward = p->view->pixels.forward;
    projection_cell c;
    double n[4][3], gradient[3], along = 0.0, unit = 0.0, way[4], edge;
    uint32_t i, j, k;
    int32_t px, py;
    if (!projection_cell_open(p, cell, &c)) return;
    projection_planes(&c, n, gradient);
    for (k = 0; k < 3; k++) along += gradient[k] * forward[k];
    for (i = 0; i < 4; i++)
        for (j = 0; j < i; j++) {
            for (edge = 0.0, k = 0; k < 3; k++) edge += (c.p[i][k] - c.p[j][k]) * (c.p[i][k] - c.p[j][k]);
            unit = tetcasti_max(unit, sqrt(edge));
        }
    for (i = 0; i < 4; i++) { /* from vertex i to the plane opposite to it */
        const double *q = c.p[tetcasti_face_of[i][0]];
        double a = 0.0, b = 0.0;
        for (k = 0; k < 3; k++) {
            a += n[i][k] * (q[k] - c.p[i][k]);
            b += n[i][k] * forward[k];
        }
        way[i] = b != 0.0 ? a / b : -1.0;
        if (!(way[i] > 0.0)) way[i] = 500.0 * unit;
    }
    for (i = 0; i < 4; i++) {
        uint32_t v[3];
        double x[3], y[3], weight[3], channel[3];
        if (!(c.area[i] < 0.0)) continue;
        projection_face(&c, i, v, x, y);
        for (py = c.rect[1]; py < c.rect[3]; py++)
            for (px = c.rect[0]; px < c.rect[2]; px++) {
                double z = 0.0, s = 0.0, l;
                if (!projection_inside(x, y, (double)px, (double)py, weight)) continue;
                for (k = 0; k < 3; k++) {
                    z += weight[k] * c.z[v[k]];
                    s += weight[k] * c.s[v[k]];
                    channel[k] = weight[k] * way[v[k]];
                    if (how->repair == 2 && c.area[v[k]] < 0.0) channel[k] = 500.0 * unit;
                }
                /* the edge that begins at vertex k ends at the next one: beyond it lies the face opposite to the third */
                if (how->repair == 1)
                    for (k = 0; k < 3; k++)
                        if (c.area[v[(k + 2) % 3]] < 0.0) channel[(k + 2) % 3] += weight[k] * 1000.0 * unit;
                l = projection_min_table(channel, unit, how->table);
                projection_put(p, px, py, z, z + l, s, s + along * l, cell);
            }
    }
}

static void projection_paint_fragment(tetcasti_painter *p, uint32_t cell) {
    const projection_way *how = projection_of(p);
    const tetcasti_pixels *m = &p->view->pixels;
    projection_cell c;
    double n[4][3], gradient[3];
    uint32_t i, j, k;
    int32_t px, py;
    if (!projection_cell_open(p, cell, &c)) return;
    projection_planes(&c, n, gradient);
    for (i = 0; i < 4; i++) {
        uint32_t v[3], planes = how->planes != 0 ? how->planes : 3;
        double x[3], y[3], weight[3];
        if (!(c.area[i] < 0.0)) continue;
        projection_face(&c, i, v, x, y);
        for (py = c.rect[1]; py < c.rect[3]; py++)
            for (px = c.rect[0]; px < c.rect[2]; px++) {
                double at[3] = {0.0, 0.0, 0.0}, dir[3], sum = 0.0, s = 0.0, l = 1e300, z = -p->view->reference, deep = 0.0;
                if (!projection_inside(x, y, (double)px, (double)py, weight)) continue;
                for (k = 0; k < 3; k++) sum += weight[k] * c.w[v[k]]; /* as hardware interpolates in perspective */
                for (k = 0; k < 3; k++) {
                    double q = weight[k] * c.w[v[k]] / sum;
                    s += q * c.s[v[k]];
                    for (j = 0; j < 3; j++) at[j] += q * c.p[v[k]][j];
                }
                for (k = 0; k < 3; k++) {
                    dir[k] = m->parallel ? m->forward[k] : at[k] - m->eye[k];
                    z += (at[k] - m->eye[k]) * m->forward[k];
                    deep += dir[k] * m->forward[k];
                }
                for (j = 0; j < planes; j++) {
                    double a = 0.0, b = 0.0;
                    for (k = 0; k < 3; k++) {
                        a += n[v[j]][k] * (c.p[i][k] - at[k]); /* vertex i lies in all three planes */
                        b += n[v[j]][k] * dir[k];
                    }
                    if (b > 0.0) l = tetcasti_min(l, a / b);
                }
                if (l > 1e299) continue;
                for (sum = 0.0, k = 0; k < 3; k++) sum += gradient[k] * dir[k];
                projection_put(p, px, py, z, z + l * deep, s, s + sum * l, cell);
            }
    }
}

/* One triangle of a projected tetrahedron: two corners of the outline and the thickest point. */
typedef struct projection_corner { double x, y, w, z[2], s[2], rgba[4]; } projection_corner;

static void projection_paint_triangle(tetcasti_painter *p, uint32_t cell, const int32_t rect[4],
                                    const projection_corner *a, const projection_corner *b, const projection_corner *c) {
    const projection_way *how = projection_of(p);
    const projection_corner *corner[3];
    double x[3], y[3], weight[3];
    uint32_t k, j;
    int32_t px, py;
    corner[0] = a;
    corner[1] = b;
    corner[2] = c;
    if ((b->x - a->x) * (c->y - a->y) - (b->y - a->y) * (c->x - a->x) < 0.0) {
        corner[1] = c;
        corner[2] = b;
    }
    for (k = 0; k < 3; k++) {
        x[k] = corner[k]->x;
        y[k] = corner[k]->y;
    }
    for (py = rect[1]; py < rect[3]; py++)
        for (px = rect[0]; px < rect[2]; px++) {
            uint32_t i = (uint32_t)py * TETCASTI_TILE + (uint32_t)px;
            double z[2] = {0.0, 0.0}, s[2] = {0.0, 0.0}, rgba[4] = {0.0, 0.0, 0.0, 0.0};
            if (!projection_inside(x, y, (double)px, (double)py, weight)) continue;
            if (how->form == PROJECTION_PT_COLORS) {
                tetcasti_ray_sum *sum = &p->b->sum[i];
                for (k = 0; k < 3; k++)
                    for (j = 0; j < 4; j++) rgba[j] += weight[k] * corner[k]->rgba[j];
                if (!tetcasti_pixel_live(p, i)) continue;
                p->tests++;
                for (j = 0; j < 3; j++) sum->c[j] += sum->t * (float)rgba[j];
                sum->t *= (float)(1.0 - rgba[3]);
                continue;
            }
            for (j = 0; j < 2; j++) { /* front, back */
                double per = 0.0;
                for (k = 0; k < 3; k++) {
                    /* at the outline w is that of the vertex on both sides, at the thickest point it follows from z */
                    double w = 1.0;
                    if (how->correction && !p->view->pixels.parallel)
                        w = p->view->w_scale / (corner[k]->z[j] + p->view->reference);
                    z[j] += weight[k] * w * corner[k]->z[j];
                    s[j] += weight[k] * w * corner[k]->s[j];
                    per += weight[k] * w;
                }
                z[j] /= per;
                s[j] /= per;
            }
            projection_put(p, px, py, z[0], z[1], s[0], s[1], cell);
        }
}

/* Depth and value of the line (two corners) or face (three) at a place of the picture. */
static void projection_meet(const projection_cell *c, uint32_t count, const uint32_t *v, double x, double y, double *z,
                          double *s) {
    double weight[3], w = 0.0;
    uint32_t k;
    if (count == 2) {
        double dx = c->x[v[1]] - c->x[v[0]], dy = c->y[v[1]] - c->y[v[0]];
        weight[1] = ((x - c->x[v[0]]) * dx + (y - c->y[v[0]]) * dy) / (dx * dx + dy * dy);
        weight[0] = 1.0 - weight[1];
    } else {
        for (k = 0; k < 3; k++) weight[k] = projection_cross(c, v[(k + 1) % 3], v[(k + 2) % 3], x, y);
    }
    *z = *s = 0.0;
    for (k = 0; k < count; k++) {
        double q = weight[k] * c->w[v[k]];
        *z += q * c->z[v[k]];
        *s += q * c->s[v[k]];
        w += q;
    }
    *z /= w;
    *s /= w;
}

static void projection_paint_pt(tetcasti_painter *p, uint32_t cell) {
    const tetcast_optics *o = p->scene->optics;
    projection_cell c;
    projection_corner outline[4], thick;
    uint32_t fronts = 0, i, count, k, role[4];
    if (!projection_cell_open(p, cell, &c)) return;
    for (i = 0; i < 4; i++) fronts |= (uint32_t)(c.area[i] < 0.0) << i;
    if (fronts == 0 || fronts == 15) return;
    memset(&thick, 0, sizeof thick);
    memset(outline, 0, sizeof outline);
    for (i = 0; i < 4; i++) role[i] = tetcasti_roles[i][fronts];
    for (i = 0; i < 4; i++) {
        static const uint8_t around[4] = {0, 2, 1, 3}; /* p r q s */
        uint32_t v = role[tetcasti_forms[fronts] == 2 ? around[i] : i];
        outline[i].x = c.x[v];
        outline[i].y = c.y[v];
        outline[i].z[0] = outline[i].z[1] = c.z[v];
        outline[i].s[0] = outline[i].s[1] = c.s[v];
    }
    if (tetcasti_forms[fronts] == 2) {
        double ax = c.x[role[0]], ay = c.y[role[0]], bx = c.x[role[1]] - ax, by = c.y[role[1]] - ay;
        double cx = c.x[role[2]], cy = c.y[role[2]], dx = c.x[role[3]] - cx, dy = c.y[role[3]] - cy;
        double det = bx * dy - by * dx, t = det != 0.0 ? ((cx - ax) * dy - (cy - ay) * dx) / det : 0.5;
        uint32_t v[4];
        for (k = 0; k < 4; k++) v[k] = role[k];
        thick.x = ax + t * bx;
        thick.y = ay + t * by;
        projection_meet(&c, 2, v, thick.x, thick.y, &thick.z[0], &thick.s[0]);
        projection_meet(&c, 2, v + 2, thick.x, thick.y, &thick.z[1], &thick.s[1]);
        count = 4;
    } else {
        uint32_t v[3], one = tetcasti_forms[fronts], d = role[3];
        for (k = 0; k < 3; k++) v[k] = role[k];
        thick.x = c.x[d];
        thick.y = c.y[d];
        thick.z[!one] = c.z[d];
        thick.s[!one] = c.s[d];
        projection_meet(&c, 3, v, thick.x, thick.y, &thick.z[one], &thick.s[one]);
        count = 3;
    }
    if (o != NULL) {
        tetcasti_ray_sum sum;
        float rgba[4], way = (float)tetcasti_max(thick.z[1] - thick.z[0], 0.0);
        int32_t x = (int32_t)tetcasti_min(tetcasti_max(thick.x, 0.0), (double)(p->width - 1));
        int32_t y = (int32_t)tetcasti_min(tetcasti_max(thick.y, 0.0), (double)(p->height - 1));
        tetcasti_ray_begin(o, &sum);
        o->segment(o, (float)thick.s[0], (float)thick.s[1],
                   way * p->way[(uint32_t)y * TETCASTI_TILE + (uint32_t)x] * p->scene->unit, 0.0f, &sum);
        tetcasti_ray_finish(o, &sum, rgba);
        for (k = 0; k < 4; k++) thick.rgba[k] = (double)rgba[k];
    }
    for (i = 0; i < count; i++)
        projection_paint_triangle(p, cell, c.rect, &outline[i], &outline[(i + 1) % count], &thick);
}

/* ---- fragments into sums in the order of the cells ---- */

/* The nearest of `keep` goes into the sum. */
static void projection_keep(tetcasti_painter *p, uint32_t i, const tetcasti_fragment *f) {
    tetcasti_fragment first;
    tetcasti_list_put(p, i, f);
    if (p->count[i] < projection_of(p)->keep) return;
    first = tetcasti_list_get(p, i);
    tetcasti_fragment_add(p, i, &first);
    tetcasti_list_drop(p, i, 1, p->count[i] - 1u);
}

/* What does without lists, or with short ones: one fragment after the other. 0: no memory. */
static int projection_in_order(tetcasti_painter *p) {
    const uint32_t keep = projection_of(p)->keep;
    p->put = keep > 1 ? projection_keep : tetcasti_fragment_add;
    p->run = tetcasti_lists_run;
    p->open_cells = NULL;
    p->paint = p->scene->fma ? tetcasti_paint_fma : tetcasti_paint_plain;
    while (p->room <= keep)
        if (!tetcasti_lists_grow(p)) return 0;
    return 1;
}

/* ---- pictures ---- */

/* As tetcast_render, with one thread. Errors: INVALID_ARG as well for PROJECTION_VERTEX with a perspective camera, for
   PROJECTION_PT_COLORS without an order of the cells or with another model than emission and absorption, for
   PROJECTION_MPVO without neighbours. */
static tetcast_result projection_project(const projection_way *how, const tetcast_render_desc *desc,
                                       const tetcast_mesh *mesh, const tetcast_optics *optics,
                                       const tetcast_image *image, projection_report *report) {
    tetcast_render_desc d;
    static const projection_report none = {0, 0, 0, 0};
    tetcasti_render c;
    projection_painter bp;
    tetcasti_batch *b = NULL;
    tetcasti_painter *p = NULL;
    tetcast_result r;
    uint32_t *rank = NULL, a, i;
    double ends[2];
    *report = none;
    memset(&c, 0, sizeof c);
    r = tetcasti_desc_open(desc, &d, &c.mem);
    if (r != TETCAST_OK) return r;
    d.env.thread_count = 1;
    c.desc = &d;
    c.image = image;
    r = tetcasti_scene_open(&d, mesh, optics, &c.scene);
    if (r == TETCAST_OK) r = tetcasti_frame_open(&d.camera, image->width, image->height, &c.frame);
    if (r != TETCAST_OK) return r;
    if (mesh->tet == NULL || (how->form == PROJECTION_VERTEX && !c.frame.parallel)) return TETCAST_ERR_INVALID_ARG;
    if (how->form == PROJECTION_PT_COLORS &&
        (how->order == PROJECTION_LISTS || how->keep > 1 || optics == NULL || optics->model != TETCAST_MODEL_VOLUME))
        return TETCAST_ERR_INVALID_ARG;
    if (image->rgba8 != NULL) tetcasti_encoder_open(&c.encoder);
    c.scale = 1.0 / mesh->unit;
    for (a = 0; a < 3; a++) c.local_eye[a] = (c.frame.eye[a] - mesh->origin[a]) * c.scale;
    c.tiles_x = (image->width + TETCASTI_TILE - 1) / TETCASTI_TILE;
    c.tiles = c.tiles_x * ((image->height + TETCASTI_TILE - 1) / TETCASTI_TILE);
    tetcasti_render_view(&c);
    if (!tetcasti_view_open(&c.mem, &d.env, 0, &c.view)) r = TETCAST_ERR_NO_MEMORY;
    if (r == TETCAST_OK && how->order != PROJECTION_LISTS) {
        rank = (uint32_t *)tetcasti_alloc_array(&c.mem, mesh->cell_count, sizeof *rank);
        r = rank != NULL ? projection_rank(&c.mem, mesh, &c.view.pixels, how->order, rank, &report->cycles)
                         : TETCAST_ERR_NO_MEMORY;
        c.view.rank = rank;
    }
    bp.view = c.view;
    bp.how = how;
    if (r == TETCAST_OK) {
        b = tetcasti_batch_open(&c.mem);
        p = b != NULL ? tetcasti_painter_open(&c.mem, &bp.view, b) : NULL;
        if (p == NULL || (how->order != PROJECTION_LISTS && !projection_in_order(p))) r = TETCAST_ERR_NO_MEMORY;
    }
    if (r == TETCAST_OK) {
        if (how->form != PROJECTION_SIGNS) p->open_cells = NULL; /* nothing for them */
        if (how->form == PROJECTION_VERTEX) p->paint = projection_paint_vertex;
        if (how->form == PROJECTION_FRAGMENT) p->paint = projection_paint_fragment;
        if (how->form == PROJECTION_PT || how->form == PROJECTION_PT_COLORS) p->paint = projection_paint_pt;
        ends[0] = (double)d.clip_near * c.scale;
        ends[1] = d.clip_far > 0.0f ? (double)d.clip_far * c.scale : (double)TETCASTI_INF;
        for (a = 0; a < c.tiles; a++) {
            tetcasti_pixels m;
            p->x0 = a % c.tiles_x * TETCASTI_TILE;
            p->y0 = a / c.tiles_x * TETCASTI_TILE;
            tetcasti_tile_rays(&c, b, p->x0, p->y0, &m);
            p->width = m.width;
            p->height = m.height;
            tetcasti_tile_paint(p, a, ends);
            for (i = 0; i < b->count; i++) {
                if (i % TETCASTI_TILE >= m.width) continue;
                report->fragments += how->form == PROJECTION_PT_COLORS ? 0 : b->steps[i];
                tetcasti_pixel_write(&c, b, i, p->x0 + i % TETCASTI_TILE, p->y0 + i / TETCASTI_TILE);
            }
        }
        if (how->form == PROJECTION_PT_COLORS) report->fragments = p->tests;
        report->violations = p->wrong;
        report->exact_tests = p->exact;
        if (p->failed) r = TETCAST_ERR_NO_MEMORY;
    }
    tetcasti_painter_close(p);
    tetcasti_batch_close(b);
    tetcasti_free(&c.mem, rank);
    tetcasti_view_close(&c.mem, &c.view);
    return r;
}

#endif /* BASELINE_CELL_PROJECTION_H_INCLUDED */
