/* voxel_list.h - lists of voxels that trees are made of, for tests - C99 and C++11 - MIT OR Unlicense, see LICENSE.
   Comes after test.h and voxrt.h. */
#ifndef VOXEL_LIST_H_INCLUDED
#define VOXEL_LIST_H_INCLUDED
#ifndef VOXRT_IMPLEMENTATION
#error "include test.h and voxrt.h with its implementation before this header"
#endif
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct cells { voxrt_voxel *v; size_t n, room; } cells; /* all zero: none */

/* rgb: 0xBBGGRR. Without a normal. */
TEST_FN voxrt_voxel *cells_add(cells *c, uint32_t x, uint32_t y, uint32_t z, uint32_t rgb) {
    voxrt_voxel *v;
    if (c->n == c->room) {
        c->room = 2 * c->room + 64;
        c->v = (voxrt_voxel *)realloc(c->v, c->room * sizeof *c->v);
        if (c->v == NULL) abort();
    }
    v = &c->v[c->n++];
    memset(v, 0, sizeof *v);
    v->x = x;
    v->y = y;
    v->z = z;
    v->rgb[0] = (uint8_t)rgb;
    v->rgb[1] = (uint8_t)(rgb >> 8);
    v->rgb[2] = (uint8_t)(rgb >> 16);
    return v;
}

TEST_FN void cells_normal(cells *c, double x, double y, double z) { /* of the last one */
    voxrt_voxel *v = &c->v[c->n - 1];
    v->has_normal = 1;
    v->normal[0] = (float)x;
    v->normal[1] = (float)y;
    v->normal[2] = (float)z;
}

TEST_FN void cells_free(cells *c) {
    free(c->v);
    memset(c, 0, sizeof *c);
}

/* The sphere around the middle of n*n*n cells, white, with its exact normals: cells whose centre is within half a cell
   of it along the normal's longest axis, which is the thinnest closed (6-separating) shell. */
TEST_FN void cells_sphere(cells *c, uint32_t n, double radius) {
    const double h = n / 2.0;
    uint32_t x, y;
    for (y = 0; y < n; y++)
        for (x = 0; x < n; x++) {
            const double px = x + 0.5 - h, py = y + 0.5 - h, q = px * px + py * py;
            const double high = (radius + 1) * (radius + 1) - q, low = (radius - 1) * (radius - 1) - q;
            int side;
            if (high <= 0) continue;
            for (side = -1; side <= 1; side += 2) { /* only near the surface */
                const double z0 = low > 0 ? sqrt(low) : 0, z1 = sqrt(high);
                int64_t from = (int64_t)floor((side < 0 ? h - z1 : h + z0) - 1), z;
                int64_t to = (int64_t)ceil((side < 0 ? h - z0 : h + z1) + 1);
                if (side > 0 && low <= 0) from = (int64_t)h;
                if (side < 0 && low <= 0) to = (int64_t)h - 1;
                for (z = from < 0 ? 0 : from; z <= to && z < (int64_t)n; z++) {
                    const double pz = (double)z + 0.5 - h, r = sqrt(q + pz * pz);
                    double most = fabs(px) > fabs(py) ? fabs(px) : fabs(py);
                    most = (fabs(pz) > most ? fabs(pz) : most) / r;
                    if ((pz < 0) != (side < 0) || fabs(r - radius) > 0.5 * most) continue;
                    (void)cells_add(c, x, y, (uint32_t)z, 0xffffff);
                    cells_normal(c, px / r, py / r, pz / r);
                }
            }
        }
}

/* The tree of all of them; the list is empty afterwards. */
TEST_FN voxrt_tree *cells_tree(cells *c, const voxrt_build_desc *d, uint32_t depth) {
    voxrt_tree *t = NULL;
    CHECK(voxrt_tree_from_voxels(d, c->v, c->n, depth, &t) == VOXRT_OK);
    cells_free(c);
    return t;
}

#endif
