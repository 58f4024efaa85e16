/* neighbour.h - ways through the thesis' octree that exist only to be compared with - MIT OR Unlicense, see LICENSE

   It uses private functions and brings voxrt.h with its implementation where that is not there yet. All of them trace
   single rays in single precision, take the same offset and count what they do; where a ray needs no help by a growing
   offset they give the same hits as voxrt_octree_trace.

   BASELINE_RESTART     thesis listing 5 (corrected) to the letter: from the root for each leaf, boxes halved by
                        comparisons with the middle
   BASELINE_GRID_LEAF   from the start grid, box of the leaf that covers the grid's cell
   BASELINE_GRID_CELL   from the start grid, box of the cell, as if the grid held bare pointers: large empty leaves are
                        crossed cell by cell
   BASELINE_NEIGHBOUR   thesis 3.5.3, fig. 29: a stack of the ancestors; up until the box contains the next point, then
                        down again. Rejected there: as many steps up as are saved going down
   BASELINE_XOR         the same stack, but the level to return to is the highest bit in which the old and the new cell
                        differ: no steps up */
#ifndef BASELINE_NEIGHBOUR_H_INCLUDED
#define BASELINE_NEIGHBOUR_H_INCLUDED
#ifndef VOXRT_IMPLEMENTATION
#  define VOXRT_IMPLEMENTATION
#endif
#include "../../voxrt.h"

typedef enum baseline_mode {
    BASELINE_RESTART, BASELINE_GRID_LEAF, BASELINE_GRID_CELL, BASELINE_NEIGHBOUR, BASELINE_XOR
} baseline_mode;

typedef struct baseline_stats {
    uint64_t outer, inner; /* points, steps down */
    uint64_t up;           /* steps up the stack, neighbour search only */
    uint64_t hits, stuck;
} baseline_stats;

/* along_ray: the offset is added to lambda instead of to each axis (the other way thesis 3.5.1 can be read).
   far_origin: keep the ray's own origin instead of moving it to the box, as a plain reading does. */
typedef struct baseline_desc {
    baseline_mode mode;
    float offset;      /* leaf edges */
    int along_ray, far_origin;
} baseline_desc;

typedef struct baseline_box { uint32_t voxel; float lo[3], edge; } baseline_box;

/* Go down from b to the leaf around p; push what is passed. */
static void baseline_descend(const voxrti_voxel *voxels, const float p[3], baseline_box *b, baseline_box *stack,
                             uint32_t *sp, uint64_t *inner) {
    uint32_t a, children = voxels[b->voxel].children;
    while (children != 0) {
        uint32_t i = 0;
        if (stack != NULL) stack[(*sp)++] = *b;
        b->edge = b->edge * 0.5f;
        for (a = 0; a < 3; a++) {
            float mid = b->lo[a] + b->edge;
            if (p[a] >= mid) {
                i |= 1u << a;
                b->lo[a] = mid;
            }
        }
        b->voxel = 8 * children + i;
        children = voxels[b->voxel].children;
        ++*inner;
    }
}

static uint32_t baseline_cell(float p, uint32_t last) {
    uint32_t i = p > 0.0f ? (uint32_t)(int32_t)p : 0;
    return i < last ? i : last;
}

/* Where the grid says to start. */
static void baseline_from_grid(const voxrti_octrace *c, const float p[3], int cell_box, baseline_box *b) {
    uint32_t a, cell[3], last = (uint32_t)c->full - 1u, sh = c->t->depth - c->grid_log, l, level = c->grid_log;
    uint32_t g;
    for (a = 0; a < 3; a++) cell[a] = baseline_cell(p[a], last);
    g = c->grid[(size_t)((cell[2] >> sh) << c->grid_log | cell[1] >> sh) << c->grid_log | cell[0] >> sh];
    if ((g & 1u) == 0)
        for (level = 0; ((1u << (c->t->depth - level)) - 1u) != g >> 2; level++) { }
    for (b->voxel = 0, l = 0; l < level; l++) /* a real grid of pointers holds it; not counted */
        b->voxel = 8 * c->t->voxel[b->voxel].children + voxrti_child(cell[0], cell[1], cell[2], c->t->depth - 1 - l);
    if (cell_box) level = c->grid_log;
    b->edge = (float)(1u << (c->t->depth - level));
    for (a = 0; a < 3; a++) b->lo[a] = (float)(cell[a] >> (c->t->depth - level) << (c->t->depth - level));
}

static int baseline_inside(const baseline_box *b, const float p[3]) {
    uint32_t a, in = 1;
    for (a = 0; a < 3; a++) in &= p[a] >= b->lo[a] && p[a] < b->lo[a] + b->edge;
    return (int)in;
}

static void baseline_one(const voxrti_octrace *c, const baseline_desc *d, const voxrt_ray *ray, voxrt_hit *hit,
                         baseline_stats *stats) {
    const voxrti_voxel *voxels = c->t->voxel;
    baseline_box stack[VOXRT_MAX_DEPTH + 1], b;
    voxrti_octray r;
    uint32_t a, sp = 0, old[3] = {0, 0, 0}, last = (uint32_t)c->full - 1u, left = c->max_outer;
    float lambda = 0;
    voxrti_octray_miss(hit);
    if (voxrti_octray_setup(c, ray, &r) <= 0) return;
    if (d->far_origin) { /* back to where it was */
        lambda = (float)r.base;
        for (a = 0; a < 3; a++) r.o[a] = (float)(((double)ray->org[a] - c->t->origin[a]) * c->scale);
        r.end = r.end + lambda;
        r.base = 0;
    }
    memset(&b, 0, sizeof b);
    b.edge = c->full;
    while (left-- != 0) {
        float p[3], exit = 0;
        for (a = 0; a < 3; a++) {
            if (d->along_ray) p[a] = r.o[a] + (lambda + d->offset) * r.d[a];
            else p[a] = (r.o[a] + (r.d[a] < 0 ? -d->offset : d->offset)) + lambda * r.d[a];
            if (p[a] < 0.0f) p[a] = 0.0f; /* the thesis' relaxed test of the end */
            if (p[a] >= c->full) p[a] = (float)last;
        }
        stats->outer++;
        if (d->mode == BASELINE_NEIGHBOUR) {
            while (sp > 0 && !baseline_inside(&b, p)) {
                b = stack[--sp];
                stats->up++;
            }
            baseline_descend(voxels, p, &b, stack, &sp, &stats->inner);
        } else if (d->mode == BASELINE_XOR) {
            uint32_t cell[3], x = 0, common;
            for (a = 0; a < 3; a++) {
                cell[a] = baseline_cell(p[a], last);
                x |= cell[a] ^ old[a];
                old[a] = cell[a];
            }
            common = x != 0 ? c->t->depth - 32u + voxrti_clz32(x) : c->t->depth; /* level of the common ancestor */
            if (common < sp) {
                sp = common;
                b = stack[sp];
            }
            baseline_descend(voxels, p, &b, stack, &sp, &stats->inner);
        } else {
            memset(&b, 0, sizeof b);
            b.edge = c->full;
            if (d->mode != BASELINE_RESTART) baseline_from_grid(c, p, d->mode == BASELINE_GRID_CELL, &b);
            baseline_descend(voxels, p, &b, NULL, NULL, &stats->inner);
        }
        if (voxels[b.voxel].index != 0) {
            uint32_t cell[3];
            for (a = 0; a < 3; a++) cell[a] = (uint32_t)b.lo[a];
            stats->hits += (uint64_t)voxrti_octray_hit(c, &r, ray, lambda, b.voxel, cell, (uint32_t)b.edge - 1u, hit);
            return;
        }
        for (a = 0; a < 3; a++) {
            float t = ((r.d[a] < 0 ? b.lo[a] : b.lo[a] + b.edge) - r.o[a]) * r.inv[a];
            exit = a == 0 || t < exit ? t : exit;
        }
        if (!(exit > lambda)) {
            stats->stuck++;
            return;
        }
        lambda = exit;
        if (!(lambda < r.end)) return;
    }
    stats->stuck++;
}

/* stats are added to. The grid modes need an octree with a start grid. */
static void baseline_octree_trace(const voxrt_octree *t, const baseline_desc *d, const voxrt_ray *rays, voxrt_hit *hits,
                                  size_t count, baseline_stats *stats) {
    voxrti_octrace c;
    size_t i;
    memset(&c, 0, sizeof c);
    c.t = t;
    c.full = (float)(1u << t->depth);
    c.offset = d->offset;
    c.max_outer = 6u << t->depth;
    c.scale = 1.0 / t->voxel_size;
    if (t->grid != NULL) {
        c.grid_log = t->grid_level - 1;
        c.grid = t->grid + voxrti_grid_first(c.grid_log);
    }
    for (i = 0; i < count; i++) baseline_one(&c, d, &rays[i], &hits[i], stats);
}

#endif /* BASELINE_NEIGHBOUR_H_INCLUDED */
