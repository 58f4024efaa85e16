/* planes.h - rays through tetrahedra by planes, and depth peeling, only to be compared with - MIT OR Unlicense

   What the thesis does on graphics processors, on one core and as well as it can be done: a cell keeps outward unit
   normals of its faces, a vertex of each, the neighbours behind them with the face's number there, and its value as
   gradient and offset. A ray leaves a cell through the face with the least distance of those that it sees from behind.
   The four faces are computed side by side (rows of 4, which compilers turn into SSE). All in world coordinates and
   32-bit floats, as it was.

   baseline_list_make   the cells of a mesh that has its tets
   baseline_walk        one walk, from a face of the hull to another one, it is hoped
   baseline_picture     a picture; meshes that are not convex by peeling: each turn draws the faces of the hull into a
                        depth buffer, nearest first, but only those behind the layer before, and rays go on from there

   BASELINE_VERTEX      distance to face i is n . (v - e) / n . d with a vertex v of the face; the face of the way in is
                        left out by its number
   BASELINE_SIGN        the same, and it is left out only because it is seen from the front: nothing to remember
   BASELINE_OFFSET      (o - n . e) / n . d with stored offsets o
   BASELINE_EPSILON     as SIGN, but only distances that are larger than the last one by epsilon count: the usual remedy

   None of them is safe, so what goes wrong is counted: walks that find no way out, walks that do not end. Rays that get
   out where they should not are found by comparing lengths. */
#ifndef BASELINE_PLANES_H_INCLUDED
#define BASELINE_PLANES_H_INCLUDED
#ifndef TETCAST_IMPLEMENTATION
#  define TETCAST_IMPLEMENTATION
#endif
#include "../../tetcast.h"

typedef enum baseline_form { BASELINE_VERTEX, BASELINE_SIGN, BASELINE_OFFSET, BASELINE_EPSILON } baseline_form;

typedef struct baseline_cell { /* 160 bytes, and 16 for the offsets */
    float nx[4], ny[4], nz[4]; /* face i: opposite vertex i, outward */
    float vx[4], vy[4], vz[4]; /* a vertex of it: number 3 - i */
    float o[4];
    float g[4];                /* value = g[0..2] . x + g[3] */
    uint32_t a[4];             /* neighbours, TETCASTI_NONE */
    uint8_t f[4];              /* number of the face in the neighbour */
    uint32_t imaginary;        /* passed through, shows nothing */
    uint32_t unused[2];
} baseline_cell;

typedef struct baseline_face { uint32_t cell, f; float v[3][3]; } baseline_face;

typedef struct baseline_list {
    baseline_cell *cell;
    baseline_face *face;       /* of the hull */
    uint32_t count, face_count;
} baseline_list;

typedef struct baseline_stats {
    uint64_t rays;             /* that met the mesh */
    uint64_t walks, steps;
    uint64_t no_exit;          /* walks that found no face to leave through */
    uint64_t endless;          /* walks that were stopped because they went on and on */
    uint64_t layers;           /* times that the hull was drawn */
} baseline_stats;

typedef struct baseline_desc {
    baseline_form form;
    float epsilon;             /* world */
    uint32_t depth_bits;       /* depth buffer of the peeling; 0: 32-bit floats */
    float depth_range;         /* what its bits are spread over */
} baseline_desc;

static void baseline_list_free(baseline_list *l) {
    free(l->cell);
    free(l->face);
    memset(l, 0, sizeof *l);
}

/* Normals, vertices, offsets and value of a cell from its four corners. */
static void baseline_cell_set(baseline_cell *c, double p[4][3], const double s[4]) {
    double volume, gradient[3] = {0, 0, 0}, at = s[0];
    double e[3][3];
    uint32_t f, k;
    for (f = 0; f < 4; f++) {
        const double *a = p[(f + 1) & 3], *b = p[(f + 2) & 3], *d = p[(f + 3) & 3];
        double u[3], w[3], n[3], l2, side = 0, o = 0;
        for (k = 0; k < 3; k++) {
            u[k] = b[k] - a[k];
            w[k] = d[k] - a[k];
        }
        n[0] = u[1] * w[2] - u[2] * w[1];
        n[1] = u[2] * w[0] - u[0] * w[2];
        n[2] = u[0] * w[1] - u[1] * w[0];
        l2 = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (k = 0; k < 3; k++) {
            n[k] = l2 > 0 ? n[k] / l2 : 0;
            side += n[k] * (p[f][k] - a[k]);
        }
        for (k = 0; k < 3; k++) {
            n[k] = side > 0 ? -n[k] : n[k];
            o += n[k] * a[k];
        }
        c->nx[f] = (float)n[0];
        c->ny[f] = (float)n[1];
        c->nz[f] = (float)n[2];
        c->o[f] = (float)o;
        c->vx[f] = (float)p[3 - f][0];
        c->vy[f] = (float)p[3 - f][1];
        c->vz[f] = (float)p[3 - f][2];
    }
    for (f = 0; f < 3; f++)
        for (k = 0; k < 3; k++) e[f][k] = p[f + 1][k] - p[0][k];
    volume = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
             e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
    for (k = 0; k < 3 && volume != 0; k++) { /* Cramer */
        const double *u = e[(k + 1) % 3], *w = e[(k + 2) % 3];
        gradient[0] += (s[k + 1] - s[0]) * (u[1] * w[2] - u[2] * w[1]) / volume;
        gradient[1] += (s[k + 1] - s[0]) * (u[2] * w[0] - u[0] * w[2]) / volume;
        gradient[2] += (s[k + 1] - s[0]) * (u[0] * w[1] - u[1] * w[0]) / volume;
    }
    for (k = 0; k < 3; k++) {
        c->g[k] = (float)gradient[k];
        at -= gradient[k] * p[0][k];
    }
    c->g[3] = (float)at;
}

/* 0: no memory, or the mesh has no tets. */
static int baseline_list_make(const tetcast_mesh *m, baseline_list *l) {
    tetcasti_mem mem;
    tetcast_env env;
    uint32_t (*neighbour)[4] = (uint32_t (*)[4])malloc((m->cell_count + (size_t)1) * sizeof *neighbour);
    uint32_t i, f, k;
    memset(l, 0, sizeof *l);
    memset(&env, 0, sizeof env);
    l->cell = (baseline_cell *)calloc(m->cell_count + (size_t)1, sizeof *l->cell);
    l->face = (baseline_face *)malloc((m->face_count + (size_t)1) * sizeof *l->face);
    if (l->cell == NULL || l->face == NULL || neighbour == NULL || tetcasti_env_open(&env, &mem) != TETCAST_OK ||
        tetcasti_mesh_neighbours(m, &mem, &env, neighbour) != TETCAST_OK) {
        baseline_list_free(l);
        free(neighbour);
        return 0;
    }
    l->count = m->cell_count;
    for (i = 0; i < m->cell_count; i++) {
        baseline_cell *c = &l->cell[i];
        double p[4][3], s[4];
        for (k = 0; k < 4; k++) {
            tetcast_mesh_vertex(m, m->tet[i][k], p[k], NULL, NULL);
            s[k] = (double)m->vertex[m->tet[i][k]].s;
            for (f = 0; f < 3; f++) p[k][f] = (double)(float)p[k][f];
            c->a[k] = neighbour[i][k];
            for (f = 0; f < 4 && c->a[k] != TETCASTI_NONE; f++)
                if (neighbour[c->a[k]][f] == i) c->f[k] = (uint8_t)f;
        }
        if (m->cell_value != NULL) s[0] = s[1] = s[2] = s[3] = (double)m->cell_value[i];
        c->imaginary = m->hidden != NULL && tetcasti_bit(m->hidden, i);
        baseline_cell_set(c, p, s);
        for (f = 0; f < 4; f++) {
            baseline_face *h = &l->face[l->face_count];
            if (c->a[f] != TETCASTI_NONE) continue;
            h->cell = i;
            h->f = f;
            for (k = 0; k < 3; k++) {
                uint32_t v = (f + 1 + k) & 3, x;
                for (x = 0; x < 3; x++) h->v[k][x] = (float)p[v][x];
            }
            l->face_count++;
        }
    }
    free(neighbour);
    return 1;
}

/* Distances to the four planes, and n . d. */
TETCASTI_INLINE void baseline_distances(const baseline_cell *c, baseline_form form, const float e[3], const float d[3],
                                        float at[4], float along[4]) {
    uint32_t i;
    for (i = 0; i < 4; i++) {
        float num;
        along[i] = c->nx[i] * d[0] + c->ny[i] * d[1] + c->nz[i] * d[2];
        if (form == BASELINE_OFFSET) num = c->o[i] - (c->nx[i] * e[0] + c->ny[i] * e[1] + c->nz[i] * e[2]);
        else num = c->nx[i] * (c->vx[i] - e[0]) + c->ny[i] * (c->vy[i] - e[1]) + c->nz[i] * (c->vz[i] - e[2]);
        at[i] = num / along[i];
    }
}

TETCASTI_INLINE float baseline_value(const baseline_cell *c, const float e[3], const float d[3], float t) {
    return c->g[0] * (e[0] + t * d[0]) + c->g[1] * (e[1] + t * d[1]) + (c->g[2] * (e[2] + t * d[2]) + c->g[3]);
}

/* Walk from face `entry` of `cell`, which the ray (unit d) meets at distance `at`. Adds to *length; sum: NULL, or what
   o collects. Returns the distance at which it left the mesh. */
TETCASTI_INLINE float baseline_walk_form(const baseline_list *l, const baseline_form form, float epsilon,
                                         const float e[3], const float d[3], uint32_t cell, uint32_t entry, float at,
                                         const tetcast_optics *o, tetcasti_ray_sum *sum, double *length,
                                         baseline_stats *stats) {
    uint32_t step, limit = 4 * l->count + 100;
    for (step = 0; step < limit; step++) {
        const baseline_cell *c = &l->cell[cell];
        float t[4], along[4], best = 3e38f;
        uint32_t k, out = 4;
        baseline_distances(c, form, e, d, t, along);
        for (k = 0; k < 4; k++) {
            int take = along[k] > 0 && t[k] < best;
            if (form == BASELINE_VERTEX || form == BASELINE_OFFSET) take = take && k != entry;
            if (form == BASELINE_EPSILON) take = take && t[k] > at + epsilon;
            best = take ? t[k] : best;
            out = take ? k : out;
        }
        if (out == 4) {
            stats->no_exit++;
            break;
        }
        if (best > at) {
            *length += (double)(best - at);
            if (sum != NULL && !c->imaginary) {
                o->segment(o, baseline_value(c, e, d, at), baseline_value(c, e, d, best), best - at, at, sum);
                if (tetcasti_ray_ended(o, sum)) {
                    stats->steps += step + 1;
                    return 3e38f;
                }
            }
            at = best;
        }
        entry = c->f[out];
        cell = c->a[out];
        if (cell == TETCASTI_NONE) break;
    }
    stats->endless += step == limit;
    stats->steps += step < limit ? step + 1 : step;
    stats->walks++;
    return at;
}

static float baseline_walk(const baseline_list *l, const baseline_desc *desc, const float e[3], const float d[3],
                           uint32_t cell, uint32_t entry, float at, const tetcast_optics *o, tetcasti_ray_sum *sum,
                           double *length, baseline_stats *stats) {
    switch (desc->form) { /* the form is a constant in each */
    case BASELINE_VERTEX:
        return baseline_walk_form(l, BASELINE_VERTEX, 0, e, d, cell, entry, at, o, sum, length, stats);
    case BASELINE_SIGN: return baseline_walk_form(l, BASELINE_SIGN, 0, e, d, cell, entry, at, o, sum, length, stats);
    case BASELINE_OFFSET:
        return baseline_walk_form(l, BASELINE_OFFSET, 0, e, d, cell, entry, at, o, sum, length, stats);
    default:
        return baseline_walk_form(l, BASELINE_EPSILON, desc->epsilon, e, d, cell, entry, at, o, sum, length, stats);
    }
}

/* All of a ray, one layer of the hull after the other, each found among all faces: slow, but for any ray. tolerance: by
   how much the point on the face may be outside of it, by the other three planes, and layers have to be apart.
   Distances are from org, dir is unit. */
static void baseline_ray(const baseline_list *l, const baseline_desc *desc, const double org[3], const double dir[3],
                         float tolerance, double *length, baseline_stats *stats) {
    float e[3], d[3], layer = -1;
    uint32_t k;
    *length = 0;
    for (k = 0; k < 3; k++) {
        e[k] = (float)org[k];
        d[k] = (float)dir[k];
    }
    for (;;) {
        float best = 3e38f;
        uint32_t i, found = TETCASTI_NONE;
        for (i = 0; i < l->face_count; i++) {
            const baseline_cell *c = &l->cell[l->face[i].cell];
            float t[4], along[4], at;
            int inside = 1;
            baseline_distances(c, desc->form, e, d, t, along);
            at = t[l->face[i].f];
            if (!(along[l->face[i].f] < 0) || !(at > layer + tolerance) || !(at < best)) continue;
            for (k = 0; k < 4; k++)
                if (k != l->face[i].f)
                    inside &= c->nx[k] * (e[0] + at * d[0] - c->vx[k]) + c->ny[k] * (e[1] + at * d[1] - c->vy[k]) +
                              c->nz[k] * (e[2] + at * d[2] - c->vz[k]) <= tolerance;
            if (!inside) continue;
            best = at;
            found = i;
        }
        if (found == TETCASTI_NONE) return;
        stats->rays += layer == -1;
        layer = best;
        (void)baseline_walk(l, desc, e, d, l->face[found].cell, l->face[found].f, best, NULL, NULL, length, stats);
    }
}

/* ---- pictures ---- */

typedef struct baseline_pixel { /* of one ray, between the turns */
    float e[3], d[3];
    float layer;               /* depth of the last layer */
    float next;                /* of this one */
    uint32_t face;             /* through which it comes in, TETCASTI_NONE */
    double length;
    tetcasti_ray_sum sum;
} baseline_pixel;

static float baseline_depth(const baseline_desc *desc, float t) {
    double steps;
    if (desc->depth_bits == 0) return t;
    steps = (double)((uint64_t)1 << desc->depth_bits);
    return (float)(floor((double)t / (double)desc->depth_range * steps) / steps * (double)desc->depth_range);
}

/* Draw one face into the depth buffer where it is behind the last layer: edges as the picture plane has them, depth
   from the plane of the face. */
static void baseline_draw(const baseline_list *l, const baseline_desc *desc, const tetcasti_frame *frame, uint32_t face,
                          baseline_pixel *pixels) {
    const baseline_face *h = &l->face[face];
    const baseline_cell *c = &l->cell[h->cell];
    double xy[3][2], lo[2] = {1e300, 1e300}, hi[2] = {-1e300, -1e300}, size = 0, area;
    uint32_t k, a, x, y, x1, y1;
    for (a = 0; a < 3; a++) size += frame->right[a] * frame->right[a];
    for (k = 0; k < 3; k++) {
        double p[3], u = 0, v = 0, z = 0;
        for (a = 0; a < 3; a++) {
            p[a] = (double)h->v[k][a] - frame->eye[a];
            u += p[a] * frame->right[a] / size;
            v += p[a] * frame->up[a] / size;
            z += p[a] * frame->forward[a];
        }
        if (!frame->parallel && !(z > 0)) return; /* behind the eye: such meshes are not for this baseline */
        xy[k][0] = 0.5 * frame->width + (frame->parallel ? u : u / z);
        xy[k][1] = 0.5 * frame->height - (frame->parallel ? v : v / z);
        for (a = 0; a < 2; a++) {
            lo[a] = xy[k][a] < lo[a] ? xy[k][a] : lo[a];
            hi[a] = xy[k][a] > hi[a] ? xy[k][a] : hi[a];
        }
    }
    area = (xy[1][0] - xy[0][0]) * (xy[2][1] - xy[0][1]) - (xy[1][1] - xy[0][1]) * (xy[2][0] - xy[0][0]);
    if (area == 0 || hi[0] < 0 || hi[1] < 0 || lo[0] > frame->width || lo[1] > frame->height) return;
    x1 = hi[0] < frame->width ? (uint32_t)hi[0] + 1 : frame->width;
    y1 = hi[1] < frame->height ? (uint32_t)hi[1] + 1 : frame->height;
    for (y = lo[1] > 0.5 ? (uint32_t)(lo[1] - 0.5) : 0; y < y1; y++)
        for (x = lo[0] > 0.5 ? (uint32_t)(lo[0] - 0.5) : 0; x < x1; x++) {
            baseline_pixel *p = &pixels[(size_t)y * frame->width + x];
            float t[4], along[4], z;
            int inside = 1;
            for (k = 0; k < 3 && inside; k++) {
                const double *q = xy[k], *r = xy[(k + 1) % 3];
                double side = (r[0] - q[0]) * (y + 0.5 - q[1]) - (r[1] - q[1]) * (x + 0.5 - q[0]);
                inside = area > 0 ? side >= 0 : side <= 0;
            }
            if (!inside) continue;
            baseline_distances(c, desc->form, p->e, p->d, t, along);
            if (!(along[h->f] < 0)) continue; /* not seen from the front */
            z = baseline_depth(desc, t[h->f]);
            if (!(z > p->layer && t[h->f] > 0) || !(z < p->next)) continue;
            p->next = z;
            p->face = face;
        }
}

/* A picture of what `camera` sees. rgba: 4 floats a pixel, or NULL (then o may be NULL, too); length: way inside of the
   mesh, or NULL. The eye has to be outside of the mesh. 0: no memory, or a bad camera. */
static int baseline_picture(const baseline_list *l, const baseline_desc *desc, const tetcast_camera *camera,
                            uint32_t width, uint32_t height, const tetcast_optics *o, float *rgba, float *length,
                            baseline_stats *stats) {
    tetcasti_frame frame;
    size_t i, count = (size_t)width * height;
    baseline_pixel *pixels = (baseline_pixel *)calloc(count + 1, sizeof *pixels);
    uint32_t f, k, again = 1, turn;
    if (pixels == NULL || tetcasti_frame_open(camera, width, height, &frame) != TETCAST_OK) {
        free(pixels);
        return 0;
    }
    for (i = 0; i < count; i++) {
        tetcast_ray r;
        (void)tetcast_camera_ray(camera, width, height, (double)(i % width) + 0.5, (double)(i / width) + 0.5, &r);
        for (k = 0; k < 3; k++) {
            pixels[i].e[k] = (float)r.org[k];
            pixels[i].d[k] = (float)r.dir[k];
        }
        pixels[i].layer = -1;
        if (o != NULL) tetcasti_ray_begin(o, &pixels[i].sum);
    }
    for (turn = 0; again != 0 && turn < 10000; turn++) {
        for (i = 0; i < count; i++) {
            pixels[i].next = 3e38f;
            pixels[i].face = TETCASTI_NONE;
        }
        for (f = 0; f < l->face_count; f++) baseline_draw(l, desc, &frame, f, pixels);
        stats->layers++;
        for (again = 0, i = 0; i < count; i++) {
            baseline_pixel *p = &pixels[i];
            const baseline_face *h;
            float t[4], along[4];
            if (p->face == TETCASTI_NONE) continue;
            again = 1;
            h = &l->face[p->face];
            stats->rays += turn == 0;
            p->layer = p->next;
            baseline_distances(&l->cell[h->cell], desc->form, p->e, p->d, t, along);
            if (o != NULL && turn != 0) tetcasti_ray_gap(o, &p->sum);
            if (baseline_walk(l, desc, p->e, p->d, h->cell, h->f, t[h->f], o, o != NULL ? &p->sum : NULL, &p->length,
                              stats) >= 3e38f) p->layer = 3e38f; /* it ended early */
        }
    }
    for (i = 0; i < count; i++) {
        if (o != NULL && rgba != NULL) tetcasti_ray_finish(o, &pixels[i].sum, rgba + 4 * i);
        if (length != NULL) length[i] = (float)pixels[i].length;
    }
    free(pixels);
    return 1;
}

#endif
