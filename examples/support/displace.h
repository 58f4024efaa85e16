/* displace.h - displacement maps: triangles cut to a size and moved along their normals
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_DISPLACE_H
#define SUP_DISPLACE_H

#include "texture.h"

enum { SUPI_CUTS_MOST = 32768 }; /* pieces of an edge */

/* Number of the texture that displaces a triangle, + 1; 0: none does. */
SUP_FN uint32_t supi_displaced(const sup_textured *t, size_t triangle) {
    const uint32_t material = t->mesh->triangle_material && t->map && t->mesh->texcoords ? t->mesh->triangle_material[triangle] : 0;
    return material ? t->map[(size_t)(material - 1) * SUP_MAPS + SUP_MAP_DISPLACE] : 0;
}

/* Pieces of its edges: none longer than `size`. 1 for triangles that stay. */
SUP_FN uint32_t supi_cuts(const sup_textured *t, size_t triangle, double size) {
    const sup_mesh *m = t->mesh;
    double longest = 0.0;
    int k, a;
    if (!supi_displaced(t, triangle)) return 1;
    for (k = 0; k < 3; k++) {
        const float *p = m->positions + 3 * (size_t)m->indices[3 * triangle + (size_t)k];
        const float *q = m->positions + 3 * (size_t)m->indices[3 * triangle + (size_t)(k + 1) % 3];
        double l = 0.0;
        for (a = 0; a < 3; a++) l += ((double)p[a] - (double)q[a]) * ((double)p[a] - (double)q[a]);
        longest = l > longest ? l : longest;
    }
    if (!(longest <= DBL_MAX)) return 1; /* a corner that is nowhere: such triangles are left out later */
    longest = sqrt(longest) / size;
    return longest > 1.0 ? longest < (double)SUPI_CUTS_MOST ? (uint32_t)ceil(longest) : (uint32_t)SUPI_CUTS_MOST : 1u;
}

/* Corner (i, k) of a triangle cut into n rows: moved, with its normal and texture coordinates. */
SUP_FN void supi_displaced_corner(const sup_textured *t, size_t triangle, const float face[3], uint32_t n, uint32_t i, uint32_t k,
                                  double size, float p[3], float normal[3], float uv[2]) {
    const sup_mesh *m = t->mesh;
    const uint32_t number = supi_displaced(t, triangle);
    const float weight[3] = {(float)(n - i - k) / (float)n, (float)i / (float)n, (float)k / (float)n};
    double length = 0.0, high[3];
    supi_place at;
    int a, c;
    for (a = 0; a < 3; a++) p[a] = normal[a] = 0.0f;
    uv[0] = uv[1] = 0.0f;
    for (c = 0; c < 3; c++) {
        const size_t v = 3 * (size_t)m->indices[3 * triangle + (size_t)c];
        for (a = 0; a < 3; a++) {
            p[a] += weight[c] * m->positions[v + (size_t)a];
            normal[a] += weight[c] * (m->normals ? m->normals[v + (size_t)a] : face[a]);
        }
        for (a = 0; a < 2; a++) uv[a] += weight[c] * m->texcoords[6 * triangle + (size_t)(2 * c + a)];
    }
    for (a = 0; a < 3; a++) length += (double)normal[a] * (double)normal[a];
    for (a = 0; a < 3; a++) normal[a] = length > 0.0 ? (float)((double)normal[a] / sqrt(length)) : face[a];
    if (number) {
        const sup_map *map = &m->materials[m->triangle_material[triangle] - 1].displace_map;
        const sup_texture *picture = t->textures + number - 1;
        supi_place_of(m, triangle, weight, size, map, picture, &at);
        sup_texture_look(picture, at.u, at.v, at.texels, map->clamp, high);
        for (a = 0; a < 3; a++) p[a] += (float)((double)normal[a] * ((double)map->base + (double)map->strength * high[0]));
        supi_bump(picture, map, &at, size, normal);
    }
}

SUP_FN void supi_displaced_face(const sup_mesh *m, size_t triangle, float out[3]) {
    const float *p = m->positions + 3 * (size_t)m->indices[3 * triangle], *q = m->positions + 3 * (size_t)m->indices[3 * triangle + 1];
    const float *r = m->positions + 3 * (size_t)m->indices[3 * triangle + 2];
    double n[3], length = 0.0;
    int a;
    for (a = 0; a < 3; a++) {
        const int b = (a + 1) % 3, c = (a + 2) % 3;
        n[a] = ((double)q[b] - (double)p[b]) * ((double)r[c] - (double)p[c]) - ((double)q[c] - (double)p[c]) * ((double)r[b] - (double)p[b]);
        length += n[a] * n[a];
    }
    for (a = 0; a < 3; a++) out[a] = length > 0.0 && length <= DBL_MAX ? (float)(n[a] / sqrt(length)) : 0.0f;
}

/* Arrays of the cut mesh; returns 1 when memory is short. */
SUP_FN int supi_displaced_room(const sup_mesh *m, size_t triangles, size_t vertices, sup_mesh *out) {
    if (triangles > SIZE_MAX / 48 || vertices > SIZE_MAX / 24) return 1;
    out->positions = (float *)sup_alloc(vertices, 3 * sizeof(float));
    out->normals = (float *)sup_alloc(vertices, 3 * sizeof(float));
    out->indices = (uint32_t *)sup_alloc(triangles, 3 * sizeof(uint32_t));
    out->texcoords = (float *)sup_alloc(triangles, 6 * sizeof(float));
    out->triangle_material = (uint32_t *)sup_alloc(triangles, sizeof(uint32_t));
    if (m->triangle_rgb) out->triangle_rgb = (uint8_t *)sup_alloc(triangles, 3);
    if (m->vertex_rgb) out->vertex_rgb = (uint8_t *)sup_alloc(vertices, 3);
    return !out->positions || !out->normals || !out->indices || !out->texcoords || !out->triangle_material ||
           (m->triangle_rgb && !out->triangle_rgb) || (m->vertex_rgb && !out->vertex_rgb);
}

/* The pieces of one triangle, behind what `out` has. */
SUP_FN void supi_displaced_pieces(const sup_textured *t, size_t triangle, uint32_t n, double size, sup_mesh *out) {
    const sup_mesh *m = t->mesh;
    const size_t base = out->vertex_count;
    float face[3];
    uint32_t i, k, c, a;
    size_t v = base;
    supi_displaced_face(m, triangle, face);
    for (k = 0; k <= n; k++) {
        for (i = 0; i + k <= n; i++, v++) {
            float at[2];
            supi_displaced_corner(t, triangle, face, n, i, k, size, out->positions + 3 * v, out->normals + 3 * v, at);
            for (a = 0; m->vertex_rgb && a < 3; a++) {
                double sum = 0.5;
                for (c = 0; c < 3; c++)
                    sum += (double)(c == 0 ? n - i - k : c == 1 ? i : k) / (double)n *
                           (double)m->vertex_rgb[3 * (size_t)m->indices[3 * triangle + c] + a];
                out->vertex_rgb[3 * v + a] = (uint8_t)(sum < 255.0 ? sum : 255.0);
            }
        }
    }
    out->vertex_count = v;
    for (k = 0, v = base; k < n; v += n - k + 1, k++) { /* rows of n - k + 1 vertices */
        for (i = 0; i + k < n; i++) {
            for (c = 0; c < 2; c++) {
                const size_t o = out->triangle_count;
                const uint32_t corner[2][3] = {{i, i + 1, n - k + 1 + i}, {i + 1, n - k + 2 + i, n - k + 1 + i}};
                if (c == 1 && i + k + 1 == n) continue;
                for (a = 0; a < 3; a++) out->indices[3 * o + a] = (uint32_t)(v + corner[c][a]);
                for (a = 0; a < 3; a++) { /* texture coordinates of the corners, linear on the triangle */
                    const uint32_t row = corner[c][a] > n - k ? k + 1 : k, column = row == k ? corner[c][a] : corner[c][a] - (n - k + 1);
                    const float *p = m->texcoords + 6 * triangle;
                    const float w1 = (float)column / (float)n, w2 = (float)row / (float)n, w0 = (float)(n - column - row) / (float)n;
                    out->texcoords[6 * o + 2 * a] = w0 * p[0] + w1 * p[2] + w2 * p[4];
                    out->texcoords[6 * o + 2 * a + 1] = w0 * p[1] + w1 * p[3] + w2 * p[5];
                }
                out->triangle_material[o] = m->triangle_material[triangle];
                if (m->triangle_rgb) memcpy(out->triangle_rgb + 3 * o, m->triangle_rgb + 3 * triangle, 3);
                out->triangle_count++;
            }
        }
    }
}

/* Cut the triangles whose material has a displacement map to edges of at most `size` (about a voxel), and move their
   corners along their normals. Neighbours are cut in different ways, which leaves gaps narrower than `size`; where
   normals of neighbours differ (creases) a gap as wide as the displacement makes it opens.
   t     in, its mesh; all indices must be in range
   most  triangles at most; 0: 2^31
   out   out: the new mesh, without materials: those of the old one count. Free with sup_mesh_free
   Returns 0, or 1 with err->text set. */
SUP_FN int sup_mesh_displace(const sup_textured *t, double size, size_t most, sup_mesh *out, sup_error *err) {
    const sup_mesh *m = t->mesh;
    size_t triangles = 0, vertices = 0, i;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    if (!(size > 0.0) || !(size <= DBL_MAX)) return sup_fail(err, "displacement: no size");
    if (most == 0 || most > 0x7fffffffu) most = 0x7fffffffu;
    for (i = 0; i < m->triangle_count; i++) {
        const uint64_t n = supi_cuts(t, i, size);
        if (n * n > most - triangles || (n + 1) * (n + 2) / 2 > 0xfffffff0u - vertices)
            return sup_fail(err, "displacement: more than %lu triangles at this resolution", (unsigned long)most);
        triangles += (size_t)(n * n);
        vertices += (size_t)((n + 1) * (n + 2) / 2);
    }
    if (supi_displaced_room(m, triangles, vertices, out)) {
        sup_mesh_free(out);
        return sup_fail(err, "out of memory for %lu displaced triangles", (unsigned long)triangles);
    }
    for (i = 0; i < m->triangle_count; i++) supi_displaced_pieces(t, i, supi_cuts(t, i, size), size, out);
    return 0;
}

#endif
