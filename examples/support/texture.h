/* texture.h - pictures on triangles: mip-mapped look-up at the size of a voxel, normal maps, bump maps, displacement
   SPDX-License-Identifier: MIT OR Unlicense

   The program hands a sup_textured to voxrt_mesh.sample_user and a function that calls sup_textured_sample to
   sample_fn. Texture coordinates are those of OBJ: (0, 0) is the lower left corner of a picture. */
#ifndef SUP_TEXTURE_H
#define SUP_TEXTURE_H

#include "image.h"
#include "mesh.h"

enum { SUP_TEXTURE_LEVELS = 17 };

/* A picture with means of 2 x 2, 4 x 4 ... of its pixels; numbers are linear, 0 to 65535. */
typedef struct sup_texture {
    uint16_t *level[SUP_TEXTURE_LEVELS]; /* [0] the picture; all in one block */
    uint32_t width[SUP_TEXTURE_LEVELS], height[SUP_TEXTURE_LEVELS];
    uint32_t level_count, channels; /* channels: 1 or 3; alpha is left out */
} sup_texture;

SUP_FN void sup_texture_free(sup_texture *t) {
    SUP_FREE(t->level[0]);
    memset(t, 0, sizeof *t);
}

/* Make a texture of a picture. srgb: 1 for colours, 0 for normals and heights, whose numbers are linear.
   Returns 0, or 1 when memory is short: then there is nothing to free. A third more than the picture. */
SUP_FN int sup_texture_make(const sup_image *image, int srgb, sup_texture *out) {
    size_t total = 0, n, i;
    uint32_t w = image->width, h = image->height, k, c, x, y;
    uint16_t *block;
    memset(out, 0, sizeof *out);
    out->channels = image->channels < 3 ? 1 : 3;
    for (k = 0; k < SUP_TEXTURE_LEVELS; k++) {
        out->width[k] = w;
        out->height[k] = h;
        if (sup_mul_size((size_t)w * out->channels, h, &n) || n > SIZE_MAX / 4 - total) return 1;
        total += n;
        out->level_count++;
        if (w == 1 && h == 1) break;
        w = w > 1 ? w / 2 : 1;
        h = h > 1 ? h / 2 : 1;
    }
    block = (uint16_t *)sup_alloc(total, 2);
    if (!block) {
        memset(out, 0, sizeof *out);
        return 1;
    }
    n = (size_t)image->width * image->height;
    for (i = 0; i < n; i++) {
        for (c = 0; c < out->channels; c++) {
            const uint16_t v = image->pixels[i * image->channels + c];
            const double u = (double)v / 65535.0;
            block[i * out->channels + c] =
                !srgb ? v : (uint16_t)(65535.0 * (u <= 0.04045 ? u / 12.92 : pow((u + 0.055) / 1.055, 2.4)) + 0.5);
        }
    }
    for (k = 0, n = 0; k < out->level_count; k++) {
        out->level[k] = block + n;
        n += (size_t)out->width[k] * out->height[k] * out->channels;
    }
    for (k = 1; k < out->level_count; k++) { /* means; of an odd side the last pixel has part in the last one, too */
        const uint16_t *from = out->level[k - 1];
        const uint32_t fw = out->width[k - 1], fh = out->height[k - 1];
        for (y = 0; y < out->height[k]; y++) {
            const uint32_t y0 = 2 * y < fh ? 2 * y : fh - 1, y1 = y + 1 == out->height[k] ? fh : 2 * y + 2;
            for (x = 0; x < out->width[k]; x++) {
                const uint32_t x0 = 2 * x < fw ? 2 * x : fw - 1, x1 = x + 1 == out->width[k] ? fw : 2 * x + 2;
                for (c = 0; c < out->channels; c++) {
                    uint64_t sum = 0, count = (uint64_t)(x1 - x0) * (y1 - y0);
                    uint32_t u, v;
                    for (v = y0; v < y1; v++) {
                        for (u = x0; u < x1; u++) sum += from[((size_t)v * fw + u) * out->channels + c];
                    }
                    out->level[k][((size_t)y * out->width[k] + x) * out->channels + c] = (uint16_t)((sum + count / 2) / count);
                }
            }
        }
    }
    return 0;
}

/* Pixel (x, y) of a level, which goes on without end; clamp: its border does. */
SUP_FN const uint16_t *supi_texel(const sup_texture *t, uint32_t k, double x, double y, int clamp) {
    const double w = (double)t->width[k], h = (double)t->height[k];
    if (clamp) {
        x = x < 0.0 ? 0.0 : x > w - 1.0 ? w - 1.0 : x;
        y = y < 0.0 ? 0.0 : y > h - 1.0 ? h - 1.0 : y;
    } else {
        x -= floor(x / w) * w;
        y -= floor(y / h) * h;
    }
    x = x >= 0.0 && x < w ? x : 0.0; /* rounded up, or not a number */
    y = y >= 0.0 && y < h ? y : 0.0;
    return t->level[k] + ((size_t)y * t->width[k] + (size_t)x) * t->channels;
}

SUP_FN void supi_bilinear(const sup_texture *t, uint32_t k, double u, double v, int clamp, double out[3]) {
    const double x = u * (double)t->width[k] - 0.5, y = (1.0 - v) * (double)t->height[k] - 0.5;
    const double fx = x - floor(x), fy = y - floor(y);
    const uint16_t *p = supi_texel(t, k, floor(x), floor(y), clamp), *q = supi_texel(t, k, floor(x) + 1.0, floor(y), clamp);
    const uint16_t *r = supi_texel(t, k, floor(x), floor(y) + 1.0, clamp), *s = supi_texel(t, k, floor(x) + 1.0, floor(y) + 1.0, clamp);
    uint32_t c;
    for (c = 0; c < 3; c++) {
        const uint32_t i = c < t->channels ? c : 0;
        const double top = (double)p[i] + fx * ((double)q[i] - (double)p[i]), low = (double)r[i] + fx * ((double)s[i] - (double)r[i]);
        out[c] = (top + fy * (low - top)) / 65535.0;
    }
}

/* The mean over about `texels` pixels along each axis around (u, v): three numbers from 0 to 1. */
SUP_FN void sup_texture_look(const sup_texture *t, double u, double v, double texels, int clamp, double out[3]) {
    double level = texels > 1.0 ? log2(texels) : 0.0, part, next[3];
    uint32_t k, c;
    if (!(fabs(u) < 1e9) || !(fabs(v) < 1e9)) u = v = 0.0;
    if (!(level < (double)(t->level_count - 1))) level = (double)(t->level_count - 1);
    k = (uint32_t)level;
    part = level - (double)k;
    supi_bilinear(t, k, u, v, clamp, out);
    if (part > 0.0 && k + 1 < t->level_count) {
        supi_bilinear(t, k + 1, u, v, clamp, next);
        for (c = 0; c < 3; c++) out[c] += part * (next[c] - out[c]);
    }
}

/* ---- textures of a mesh ------------------------------------------------------------------------------------- */

enum { SUP_MAP_COLOR, SUP_MAP_BUMP, SUP_MAP_DISPLACE, SUP_MAPS };

/* Pictures of the materials of a mesh, each once. */
typedef struct sup_textured {
    const sup_mesh *mesh; /* borrowed */
    sup_texture *textures;
    size_t texture_count;
    uint32_t *map; /* [material_count][SUP_MAPS] 1 + number of a texture; 0: none */
    size_t skipped; /* pictures that could not be read; the last one's reason is in the warning */
} sup_textured;

SUP_FN void sup_textured_free(sup_textured *t) {
    size_t i;
    for (i = 0; i < t->texture_count; i++) sup_texture_free(t->textures + i);
    SUP_FREE(t->textures);
    SUP_FREE(t->map);
    memset(t, 0, sizeof *t);
}

SUP_FN const sup_map *supi_material_map(const sup_material *m, uint32_t kind) {
    return kind == SUP_MAP_COLOR ? &m->color_map : kind == SUP_MAP_BUMP ? &m->bump_map : &m->displace_map;
}

/* Read the pictures that the materials of a mesh name.
   open_fn  gives the files; NULL: all are missing
   err      out: a warning when a picture cannot be read (its material goes without), or the error
   Returns 0, or 1 when memory is short. The mesh must not change while `out` is used. */
SUP_FN int sup_textured_open(const sup_mesh *mesh, sup_open_fn open_fn, void *user, sup_textured *out, sup_error *err) {
    size_t i, k;
    uint32_t kind, other;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    out->mesh = mesh;
    if (mesh->material_count == 0) return 0;
    out->map = (uint32_t *)sup_alloc(mesh->material_count, SUP_MAPS * sizeof *out->map);
    out->textures = (sup_texture *)sup_alloc(mesh->material_count, SUP_MAPS * sizeof *out->textures);
    if (!out->map || !out->textures) {
        sup_textured_free(out);
        return sup_fail(err, "out of memory for textures");
    }
    memset(out->map, 0, mesh->material_count * SUP_MAPS * sizeof *out->map);
    for (i = 0; i < mesh->material_count; i++) {
        for (kind = 0; kind < SUP_MAPS; kind++) {
            const sup_map *map = supi_material_map(mesh->materials + i, kind);
            sup_image image;
            char *data = NULL;
            size_t size = 0;
            int failed;
            if (!map->name) continue;
            for (k = 0; k < i * SUP_MAPS + kind; k++) { /* the same picture, taken in the same way */
                other = (uint32_t)(k % SUP_MAPS);
                if (out->map[k] != 0 && (other == SUP_MAP_COLOR) == (kind == SUP_MAP_COLOR) &&
                    strcmp(supi_material_map(mesh->materials + k / SUP_MAPS, other)->name, map->name) == 0) {
                    out->map[i * SUP_MAPS + kind] = out->map[k];
                }
            }
            if (out->map[i * SUP_MAPS + kind]) continue;
            if (!open_fn || open_fn(user, map->name, &data, &size)) {
                (void)sup_fail(err, "picture %.128s cannot be read: left out", map->name);
                out->skipped++;
                continue;
            }
            failed = sup_image_decode(data, size, map->name, &image, err);
            SUP_FREE(data);
            if (failed) {
                out->skipped++;
                continue;
            }
            failed = sup_texture_make(&image, kind == SUP_MAP_COLOR, out->textures + out->texture_count);
            sup_image_free(&image);
            if (failed) {
                sup_textured_free(out);
                return sup_fail(err, "out of memory for textures");
            }
            out->map[i * SUP_MAPS + kind] = (uint32_t)++out->texture_count;
        }
    }
    return 0;
}

/* Something to look up? 0: sup_textured_sample would change nothing. */
SUP_FN int sup_textured_any(const sup_textured *t) { return t->texture_count != 0 && t->mesh->texcoords != NULL; }

/* Where a point of a triangle is in a picture, and how the picture lies on the triangle. */
typedef struct supi_place {
    double u, v, texels;        /* texels: pixels along a footprint, in the direction where they are most */
    double du[3], dv[3];        /* gradients of u and v on the triangle's plane; 0: it has none */
} supi_place;

SUP_FN void supi_place_of(const sup_mesh *m, size_t triangle, const float weight[3], double footprint, const sup_map *map,
                          const sup_texture *t, supi_place *out) {
    const float *uv = m->texcoords + 6 * triangle, *p[3];
    double e1[3], e2[3], n[3], area = 0.0, u[3], v[3], lu = 0.0, lv = 0.0;
    int a, k;
    memset(out, 0, sizeof *out);
    for (k = 0; k < 3; k++) {
        p[k] = m->positions + 3 * (size_t)m->indices[3 * triangle + (size_t)k];
        u[k] = (double)uv[2 * k] * (double)map->scale[0] + (double)map->offset[0];
        v[k] = (double)uv[2 * k + 1] * (double)map->scale[1] + (double)map->offset[1];
        out->u += (double)weight[k] * u[k];
        out->v += (double)weight[k] * v[k];
    }
    for (a = 0; a < 3; a++) {
        e1[a] = (double)p[1][a] - (double)p[0][a];
        e2[a] = (double)p[2][a] - (double)p[0][a];
    }
    for (a = 0; a < 3; a++) {
        n[a] = e1[(a + 1) % 3] * e2[(a + 2) % 3] - e1[(a + 2) % 3] * e2[(a + 1) % 3];
        area += n[a] * n[a];
    }
    if (!(area > 0.0) || !(area <= DBL_MAX)) return;
    for (a = 0; a < 3; a++) { /* gradient of a linear function: (f1 (e2 x n) + f2 (n x e1)) / |n|^2 */
        const int b = (a + 1) % 3, c = (a + 2) % 3;
        const double g1 = (e2[b] * n[c] - e2[c] * n[b]) / area, g2 = (n[b] * e1[c] - n[c] * e1[b]) / area;
        out->du[a] = (u[1] - u[0]) * g1 + (u[2] - u[0]) * g2;
        out->dv[a] = (v[1] - v[0]) * g1 + (v[2] - v[0]) * g2;
        lu += out->du[a] * out->du[a];
        lv += out->dv[a] * out->dv[a];
    }
    lu = sqrt(lu) * (double)t->width[0];
    lv = sqrt(lv) * (double)t->height[0];
    out->texels = footprint * (lu > lv ? lu : lv);
    if (!(out->texels <= DBL_MAX)) memset(out, 0, sizeof *out);
}

/* Tilt a unit normal by a bump map (heights) or a normal map. Slopes of heights are taken over a footprint. */
SUP_FN void supi_bump(const sup_texture *t, const sup_map *map, const supi_place *at, double footprint, float normal[3]) {
    double side[3], up[3], n[3], d[3], look[3], x = 0.0, y = 0.0, length = 0.0, across;
    int a;
    for (a = 0; a < 3; a++) n[a] = (double)normal[a];
    /* u and v along the surface: at right angles to the normal */
    for (a = 0, across = 0.0; a < 3; a++) across += at->du[a] * n[a];
    for (a = 0; a < 3; a++) side[a] = at->du[a] - across * n[a];
    for (a = 0, across = 0.0; a < 3; a++) across += at->dv[a] * n[a];
    for (a = 0; a < 3; a++) up[a] = at->dv[a] - across * n[a];
    if (map->is_normal) {
        double lu = 0.0, lv = 0.0;
        for (a = 0; a < 3; a++) {
            lu += side[a] * side[a];
            lv += up[a] * up[a];
        }
        if (!(lu > 0.0) || !(lv > 0.0)) return;
        sup_texture_look(t, at->u, at->v, at->texels, map->clamp, d);
        x = (2.0 * d[0] - 1.0) * (double)map->strength / sqrt(lu);
        y = (2.0 * d[1] - 1.0) * (double)map->strength / sqrt(lv);
        for (a = 0; a < 3; a++) n[a] = n[a] * (2.0 * d[2] - 1.0) + x * side[a] + y * up[a];
    } else {
        const double texels = at->texels > 1.0 ? at->texels : 1.0;
        const double hu = 0.5 * texels / (double)t->width[0], hv = 0.5 * texels / (double)t->height[0];
        (void)footprint;
        sup_texture_look(t, at->u + hu, at->v, at->texels, map->clamp, d);
        sup_texture_look(t, at->u - hu, at->v, at->texels, map->clamp, look);
        x = (double)map->strength * (d[0] - look[0]) / (2.0 * hu); /* height by u; times du: by length */
        sup_texture_look(t, at->u, at->v + hv, at->texels, map->clamp, d);
        sup_texture_look(t, at->u, at->v - hv, at->texels, map->clamp, look);
        y = (double)map->strength * (d[0] - look[0]) / (2.0 * hv);
        for (a = 0; a < 3; a++) n[a] -= x * side[a] + y * up[a];
    }
    for (a = 0; a < 3; a++) length += n[a] * n[a];
    if (!(length > 0.0) || !(length <= DBL_MAX)) return;
    for (a = 0; a < 3; a++) normal[a] = (float)(n[a] / sqrt(length));
}

/* What the textures make of colour and normal at a point of a triangle; see voxrt_sample for the arguments. */
SUP_FN void sup_textured_sample(const sup_textured *t, size_t triangle, const float weight[3], float footprint,
                                float color[3], float normal[3]) {
    const sup_mesh *m = t->mesh;
    const uint32_t material = m->triangle_material ? m->triangle_material[triangle] : 0;
    const uint32_t *map;
    supi_place at;
    double look[3];
    int a;
    if (material == 0 || !m->texcoords || !t->map) return;
    map = t->map + (size_t)(material - 1) * SUP_MAPS;
    if (map[SUP_MAP_COLOR] != 0) {
        const sup_map *how = &m->materials[material - 1].color_map;
        const sup_texture *picture = t->textures + map[SUP_MAP_COLOR] - 1;
        supi_place_of(m, triangle, weight, (double)footprint, how, picture, &at);
        sup_texture_look(picture, at.u, at.v, at.texels, how->clamp, look);
        for (a = 0; a < 3; a++) color[a] *= (float)look[a];
    }
    if (map[SUP_MAP_BUMP] != 0 && (normal[0] != 0.0f || normal[1] != 0.0f || normal[2] != 0.0f)) {
        const sup_map *how = &m->materials[material - 1].bump_map;
        const sup_texture *picture = t->textures + map[SUP_MAP_BUMP] - 1;
        supi_place_of(m, triangle, weight, (double)footprint, how, picture, &at);
        supi_bump(picture, how, &at, (double)footprint, normal);
    }
}

#endif
