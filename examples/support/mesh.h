/* mesh.h - triangle meshes: readers for OBJ, PLY, STL and OFF, vertex normals, bounds
   SPDX-License-Identifier: MIT OR Unlicense

       sup_mesh mesh;
       sup_error err;
       if (sup_mesh_read("bunny.obj", &mesh, &err)) { fprintf(stderr, "%s\n", err.text); return 1; }
       if (err.text[0]) fprintf(stderr, "warning: %s\n", err.text);
       ...
       sup_mesh_free(&mesh);

   All readers: the file is read whole; every size that a file claims is checked against the bytes it has before
   memory is taken for it (memory stays proportional to the file, at most some tens of bytes per byte); indices are
   checked; NaN and infinite coordinates are kept; triangles with repeated corners are kept; faces with fewer than
   three corners are skipped and counted; convex polygons become fans, concave ones are cut by ear clipping.
   Coordinates keep the axes of the file. */
#ifndef SUP_MESH_H
#define SUP_MESH_H

#include "base.h"
#include "text.h"

/* A picture that a material names, and how it lies on triangles: it is looked up at scale * (u, v) + offset. */
typedef struct sup_map {
    char *name;        /* as in the file; NULL: no picture */
    float scale[2], offset[2];
    float strength;    /* of bumps and displacement, in units of positions for a height of 1 */
    float base;        /* height of black: heights are base + strength * value */
    int clamp;         /* 1: it does not repeat */
    int is_normal;     /* 1: a normal map, not heights */
} sup_map;

/* A material of an MTL file; what it does not say is 0, but for transmit (1), ni (1), opacity (1). */
typedef struct sup_material {
    float specular[3], emission[3], transmit[3]; /* Ks, Ke, Tf */
    float shininess, ni, opacity;                /* Ns, Ni, d */
    int illum;                                   /* -1: not given */
    int has_opacity, has_transmit;
    sup_map color_map, bump_map, displace_map;
} sup_material;

/* A triangle mesh. Arrays come from SUP_MALLOC and belong to the mesh; NULL where the file has no such data. */
typedef struct sup_mesh {
    float *positions;      /* 3 per vertex */
    float *normals;        /* 3 per vertex, as in the file (not always unit length), or NULL */
    uint8_t *vertex_rgb;   /* 3 per vertex, sRGB, or NULL */
    uint32_t *indices;     /* 3 per triangle, counter-clockwise seen from outside if the file is well made */
    uint8_t *triangle_rgb; /* 3 per triangle, sRGB, or NULL; white where the file gives none */
    float *texcoords;      /* u, v of each corner: 6 per triangle; NULL: no material has a picture */
    uint32_t *triangle_material; /* per triangle 1 + number of a material, 0: none; NULL: materials are colours only */
    sup_material *materials;
    size_t vertex_count, triangle_count, material_count;
    size_t skipped_faces; /* faces with fewer than three corners */
} sup_mesh;

typedef enum sup_format {
    SUP_FORMAT_AUTO = 0,
    SUP_FORMAT_OBJ,
    SUP_FORMAT_PLY,
    SUP_FORMAT_STL,
    SUP_FORMAT_OFF
} sup_format;

/* Gives a reader a second file (the materials of an OBJ): name as it stands in the first file; *data from SUP_MALLOC,
   freed by the reader. Returns 0, or 1 when there is no such file, which is only a warning. */
typedef int (*sup_open_fn)(void *user, const char *name, char **data, size_t *size);

/* Free the arrays of `mesh` and clear it; a cleared mesh may be freed again. */
SUP_FN void sup_mesh_free(sup_mesh *mesh) {
    size_t i;
    for (i = 0; i < mesh->material_count; i++) {
        SUP_FREE(mesh->materials[i].color_map.name);
        SUP_FREE(mesh->materials[i].bump_map.name);
        SUP_FREE(mesh->materials[i].displace_map.name);
    }
    SUP_FREE(mesh->materials);
    SUP_FREE(mesh->triangle_material);
    SUP_FREE(mesh->texcoords);
    SUP_FREE(mesh->positions);
    SUP_FREE(mesh->normals);
    SUP_FREE(mesh->vertex_rgb);
    SUP_FREE(mesh->indices);
    SUP_FREE(mesh->triangle_rgb);
    memset(mesh, 0, sizeof *mesh);
}

/* ---- polygons to triangles ---------------------------------------------------------------------------------- */

enum { SUPI_CLIP_MAX = 4096 }; /* polygons with more corners are not tested for being concave: the cost is quadratic */
enum { SUPI_CLIP_WORK = 1 << 29 }; /* tests of corners in all polygons of a file (a second or two); then all become fans */

typedef struct supi_faces {
    uint32_t *indices; /* 3 per triangle */
    uint8_t *rgb;      /* 3 per triangle, NULL until a face has a colour */
    uint32_t *place;   /* which corners of their polygon triangles have, 3 per triangle; only with keep_places */
    int keep_places;
    size_t count, index_capacity, rgb_capacity, place_capacity;
    size_t skipped;
    double *plane;  /* scratch: 2 per corner */
    uint32_t *ring; /* scratch: previous and next corner */
    size_t plane_capacity, ring_capacity;
    size_t work; /* tests of corners so far */
} supi_faces;

SUP_FN void supi_faces_free(supi_faces *faces) {
    SUP_FREE(faces->indices);
    SUP_FREE(faces->rgb);
    SUP_FREE(faces->place);
    SUP_FREE(faces->plane);
    SUP_FREE(faces->ring);
    memset(faces, 0, sizeof *faces);
}

SUP_FN double supi_turn(const double *a, const double *b, const double *c) {
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/* Corners a, b, c of a polygon. */
SUP_FN void supi_emit(supi_faces *faces, const uint32_t *corner, size_t a, size_t b, size_t c) {
    uint32_t *t = faces->indices + 3 * faces->count;
    t[0] = corner[a];
    t[1] = corner[b];
    t[2] = corner[c];
    if (faces->keep_places) {
        t = faces->place + 3 * faces->count;
        t[0] = (uint32_t)a;
        t[1] = (uint32_t)b;
        t[2] = (uint32_t)c;
    }
    faces->count++;
}

/* Project the corners along the larger axis of the polygon's normal (Newell's method) so that the area is positive.
   Returns 1 when the polygon has no area, or no finite one. */
SUP_FN int supi_flatten(const float *positions, const uint32_t *corner, size_t n, double *plane) {
    double normal[3] = {0, 0, 0};
    size_t i, axis = 2, u, v;
    for (i = 0; i < n; i++) {
        const float *a = positions + 3 * (size_t)corner[i], *b = positions + 3 * (size_t)corner[i + 1 < n ? i + 1 : 0];
        const double ax = (double)a[0], ay = (double)a[1], az = (double)a[2];
        const double bx = (double)b[0], by = (double)b[1], bz = (double)b[2];
        normal[0] += (ay - by) * (az + bz);
        normal[1] += (az - bz) * (ax + bx);
        normal[2] += (ax - bx) * (ay + by);
    }
    if (fabs(normal[0]) > fabs(normal[1]) && fabs(normal[0]) > fabs(normal[2])) axis = 0;
    else if (fabs(normal[1]) > fabs(normal[2])) axis = 1;
    if (!(fabs(normal[axis]) > 0.0) || !(fabs(normal[axis]) <= DBL_MAX)) return 1;
    u = (axis + 1) % 3;
    v = (axis + 2) % 3;
    if (normal[axis] < 0.0) {
        const size_t t = u;
        u = v;
        v = t;
    }
    for (i = 0; i < n; i++) {
        plane[2 * i] = (double)positions[3 * (size_t)corner[i] + u];
        plane[2 * i + 1] = (double)positions[3 * (size_t)corner[i] + v];
    }
    return 0;
}

/* 1 when no other corner of the ring lies in the triangle prev, at, next. */
SUP_FN int supi_is_ear(const double *plane, const uint32_t *prev, const uint32_t *next, uint32_t at, size_t *budget) {
    const double *a = plane + 2 * (size_t)prev[at], *b = plane + 2 * (size_t)at, *c = plane + 2 * (size_t)next[at];
    uint32_t k;
    if (!(supi_turn(a, b, c) > 0.0)) return 0;
    for (k = next[next[at]]; k != prev[at]; k = next[k]) {
        const double *p = plane + 2 * (size_t)k;
        if (*budget == 0) return 0;
        --*budget;
        if (supi_turn(a, b, p) < 0.0 || supi_turn(b, c, p) < 0.0 || supi_turn(c, a, p) < 0.0) continue;
        /* A hole joined to the outline by a bridge has corners in the same place: they do not block each other. */
        if ((p[0] == a[0] && p[1] == a[1]) || (p[0] == b[0] && p[1] == b[1]) || (p[0] == c[0] && p[1] == c[1]))
            continue;
        return 0;
    }
    return 1;
}

SUP_FN void supi_clip_ears(supi_faces *faces, const uint32_t *corner, size_t n, const double *plane, uint32_t *ring) {
    uint32_t *prev = ring, *next = ring + n;
    uint32_t at = 0, i;
    const size_t most = 8 * n * n + 64; /* ends in time even on outlines that cross themselves */
    size_t left = n, stalled = 0, budget = most;
    for (i = 0; i < (uint32_t)n; i++) {
        prev[i] = i == 0 ? (uint32_t)n - 1 : i - 1;
        next[i] = i + 1 == (uint32_t)n ? 0 : i + 1;
    }
    while (left > 3 && stalled < left) {
        if (supi_is_ear(plane, prev, next, at, &budget)) {
            supi_emit(faces, corner, prev[at], at, next[at]);
            next[prev[at]] = next[at];
            prev[next[at]] = prev[at];
            left--;
            stalled = 0;
        } else {
            stalled++;
        }
        at = next[at];
    }
    for (i = next[at]; left > 2; left--, i = next[i]) supi_emit(faces, corner, at, i, next[i]);
    faces->work += most - budget;
}

/* Append a polygon of n corners as n - 2 triangles. positions: of all vertices, indices already checked.
   Returns 0, or 1 when memory is short. */
SUP_FN int supi_add_polygon(supi_faces *faces, const float *positions, const uint32_t *corner, size_t n) {
    size_t i, needed, before = faces->count;
    void *grown;
    int concave = 0;
    if (n < 3) {
        faces->skipped++;
        return 0;
    }
    if (n - 2 > SIZE_MAX / 6 - faces->count) return 1;
    needed = 3 * (faces->count + n - 2);
    if (needed > faces->index_capacity) {
        grown = sup_grow(faces->indices, &faces->index_capacity, needed, sizeof(uint32_t));
        if (!grown) return 1;
        faces->indices = (uint32_t *)grown;
    }
    if (faces->keep_places) {
        grown = sup_grow(faces->place, &faces->place_capacity, needed, sizeof(uint32_t));
        if (!grown) return 1;
        faces->place = (uint32_t *)grown;
    }
    if (n > 3 && n <= (size_t)SUPI_CLIP_MAX && faces->work < (size_t)SUPI_CLIP_WORK) {
        grown = sup_grow(faces->plane, &faces->plane_capacity, 2 * n, sizeof(double));
        if (!grown) return 1;
        faces->plane = (double *)grown;
        if (!supi_flatten(positions, corner, n, faces->plane)) {
            for (i = 0; i < n; i++) {
                const double *a = faces->plane + 2 * i, *b = faces->plane + 2 * ((i + 1) % n),
                             *c = faces->plane + 2 * ((i + 2) % n);
                concave |= supi_turn(a, b, c) < 0.0;
            }
        }
    }
    if (concave) {
        grown = sup_grow(faces->ring, &faces->ring_capacity, 2 * n, sizeof(uint32_t));
        if (!grown) return 1;
        faces->ring = (uint32_t *)grown;
        supi_clip_ears(faces, corner, n, faces->plane, faces->ring);
    } else {
        for (i = 1; i + 1 < n; i++) supi_emit(faces, corner, 0, i, i + 1);
    }
    if (faces->rgb) {
        grown = sup_grow(faces->rgb, &faces->rgb_capacity, 3 * faces->count, 1);
        if (!grown) return 1;
        faces->rgb = (uint8_t *)grown;
        memset(faces->rgb + 3 * before, 255, 3 * (faces->count - before));
    }
    return 0;
}

/* Colour the triangles from `first` on; the first colour of a file makes all earlier triangles white. */
SUP_FN int supi_paint(supi_faces *faces, size_t first, const uint8_t rgb[3]) {
    size_t i;
    if (!faces->rgb) {
        faces->rgb = (uint8_t *)sup_grow(NULL, &faces->rgb_capacity, 3 * faces->count, 1);
        if (!faces->rgb) return 1;
        memset(faces->rgb, 255, 3 * faces->count);
    }
    for (i = first; i < faces->count; i++) memcpy(faces->rgb + 3 * i, rgb, 3);
    return 0;
}

/* Hand the triangles over to the mesh. */
SUP_FN void supi_faces_finish(supi_faces *faces, sup_mesh *mesh) {
    mesh->indices = faces->indices;
    mesh->triangle_rgb = faces->rgb;
    mesh->triangle_count = faces->count;
    mesh->skipped_faces = faces->skipped;
    faces->indices = NULL;
    faces->rgb = NULL;
    supi_faces_free(faces);
}

/* ---- hash map from 64-bit keys to 32-bit values ------------------------------------------------------------- */

#define SUPI_MAP_EMPTY 0xffffffffu

typedef struct supi_map {
    uint64_t *keys;
    uint32_t *values; /* SUPI_MAP_EMPTY: free slot */
    size_t mask, used;
} supi_map;

SUP_FN void supi_map_free(supi_map *map) {
    SUP_FREE(map->keys);
    SUP_FREE(map->values);
    memset(map, 0, sizeof *map);
}

SUP_FN uint64_t supi_mix(uint64_t x) {
    x ^= x >> 32;
    x *= UINT64_C(0xd6e8feb86659fd93);
    x ^= x >> 32;
    x *= UINT64_C(0xd6e8feb86659fd93);
    return x ^ (x >> 32);
}

/* The slot of `key`, added with SUPI_MAP_EMPTY as its value when it is new; NULL when memory is short.
   The pointer is good until the next call. A caller that sees SUPI_MAP_EMPTY must store a value. */
SUP_FN uint32_t *supi_map_at(supi_map *map, uint64_t key) {
    size_t slot, i;
    if (!map->values || map->used * 2 > map->mask) {
        supi_map bigger;
        const size_t slots = map->values ? (map->mask + 1) * 2 : 1024;
        memset(&bigger, 0, sizeof bigger);
        bigger.keys = (uint64_t *)sup_alloc(slots, sizeof *bigger.keys);
        bigger.values = (uint32_t *)sup_alloc(slots, sizeof *bigger.values);
        if (!bigger.keys || !bigger.values) {
            supi_map_free(&bigger);
            return NULL;
        }
        memset(bigger.values, 255, slots * sizeof *bigger.values);
        bigger.mask = slots - 1;
        for (i = 0; map->values && i <= map->mask; i++) {
            if (map->values[i] == SUPI_MAP_EMPTY) continue;
            slot = (size_t)supi_mix(map->keys[i]) & bigger.mask;
            while (bigger.values[slot] != SUPI_MAP_EMPTY) slot = (slot + 1) & bigger.mask;
            bigger.keys[slot] = map->keys[i];
            bigger.values[slot] = map->values[i];
        }
        bigger.used = map->used;
        supi_map_free(map);
        *map = bigger;
    }
    slot = (size_t)supi_mix(key) & map->mask;
    while (map->values[slot] != SUPI_MAP_EMPTY && map->keys[slot] != key) slot = (slot + 1) & map->mask;
    if (map->values[slot] == SUPI_MAP_EMPTY) {
        map->keys[slot] = key;
        map->used++;
    }
    return map->values + slot;
}

/* ---- normals and bounds ------------------------------------------------------------------------------------- */

#include "mesh_normals.h"

/* The smallest axis-aligned box around all finite vertices: lo and hi, out, [3]. Vertices that no triangle uses count.
   Returns 0, or 1 and the box (0,0,0)..(0,0,0) when there is no finite vertex. */
SUP_FN int sup_mesh_bounds(const sup_mesh *mesh, float lo[3], float hi[3]) {
    size_t i, k;
    int any = 0;
    for (k = 0; k < 3; k++) lo[k] = hi[k] = 0.0f;
    for (i = 0; i < mesh->vertex_count; i++) {
        const float *p = mesh->positions + 3 * i;
        if (!(fabsf(p[0]) <= FLT_MAX && fabsf(p[1]) <= FLT_MAX && fabsf(p[2]) <= FLT_MAX)) continue;
        for (k = 0; k < 3; k++) {
            if (!any || p[k] < lo[k]) lo[k] = p[k];
            if (!any || p[k] > hi[k]) hi[k] = p[k];
        }
        any = 1;
    }
    return any ? 0 : 1;
}

/* ---- readers ------------------------------------------------------------------------------------------------ */

#include "mesh_obj.h"
#include "mesh_off.h"
#include "mesh_ply.h"
#include "mesh_stl.h"

/* The format by content, or by the end of the name where the content does not tell; AUTO when neither does. */
SUP_FN sup_format supi_guess_format(const char *data, size_t size, const char *name) {
    const char *end = data + size, *dot = strrchr(name, '.');
    sup_text text;
    if (size >= 4 && memcmp(data, "ply", 3) == 0 && supi_is_space(data[3])) return SUP_FORMAT_PLY;
    if (supi_stl_is_binary(data, size) || sup_text_is_word(data, end, "solid")) return SUP_FORMAT_STL;
    if (supi_off_is_header(data, end)) return SUP_FORMAT_OFF;
    if (dot) {
        if (sup_text_is_word(dot, dot + strlen(dot), ".obj")) return SUP_FORMAT_OBJ;
        if (sup_text_is_word(dot, dot + strlen(dot), ".ply")) return SUP_FORMAT_PLY;
        if (sup_text_is_word(dot, dot + strlen(dot), ".stl")) return SUP_FORMAT_STL;
        if (sup_text_is_word(dot, dot + strlen(dot), ".off")) return SUP_FORMAT_OFF;
    }
    text.begin = text.at = data;
    text.end = end;
    while (text.at < end) { /* an OBJ is a text in which some line begins with "v" */
        sup_text_skip_space(&text);
        if (sup_text_is_word(text.at, end, "v")) return SUP_FORMAT_OBJ;
        if (text.at < end && (*text.at < '\t' || *text.at == 127)) break;
        sup_text_skip_line(&text);
    }
    return SUP_FORMAT_AUTO;
}

/* Read a mesh from `size` bytes at `data`.
   data      in, need not end with a zero byte; may be NULL when size is 0
   format    AUTO: guess from content, then from the end of `name`
   name      how messages name the file
   open_fn   gives the materials of an OBJ; NULL: they are left out without a warning
   out       out: the mesh; free with sup_mesh_free. Cleared on error
   err       out: the error, or after success a warning or an empty text; may be NULL
   Returns 0, or 1 with err->text set. */
SUP_FN int sup_mesh_read_memory(const void *data, size_t size, sup_format format, const char *name, sup_open_fn open_fn,
                                void *open_user, sup_mesh *out, sup_error *err) {
    sup_error unused;
    sup_text text;
    int failed;
    if (!err) err = &unused;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    text.begin = text.at = size ? (const char *)data : "";
    text.end = text.begin + size;
    if (size == 0) return sup_fail(err, "%s: the file is empty", name);
    if (format == SUP_FORMAT_AUTO) format = supi_guess_format(text.begin, size, name);
    switch (format) {
    case SUP_FORMAT_OBJ: failed = supi_read_obj(&text, name, open_fn, open_user, out, err); break;
    case SUP_FORMAT_PLY: failed = supi_read_ply(&text, name, out, err); break;
    case SUP_FORMAT_STL: failed = supi_read_stl(&text, name, out, err); break;
    case SUP_FORMAT_OFF: failed = supi_read_off(&text, name, out, err); break;
    case SUP_FORMAT_AUTO:
    default: failed = sup_fail(err, "%s: not a mesh in OBJ, PLY, STL or OFF format", name); break;
    }
    if (failed) sup_mesh_free(out);
    return failed;
}

/* Materials lie beside the mesh. Names written on Windows have backslashes, and often a folder of another machine. */
SUP_FN int supi_open_beside(void *user, const char *name, char **data, size_t *size) {
    const char *mesh_path = (const char *)user;
    const char *slash = strrchr(mesh_path, '/');
    const size_t folder = slash ? (size_t)(slash - mesh_path) + 1 : 0;
    const size_t length = strlen(name);
    char *path = (char *)sup_alloc(folder + length + 1, 1);
    char *base;
    size_t i;
    int failed;
    if (!path) return 1;
    memcpy(path, mesh_path, folder);
    memcpy(path + folder, name, length + 1);
    for (i = folder; path[i]; i++) {
        if (path[i] == '\\') path[i] = '/';
    }
    failed = !sup_is_plain_file(path) || sup_read_file(path, data, size, NULL);
    base = strrchr(path + folder, '/');
    if (failed && base) {
        memmove(path + folder, base + 1, strlen(base));
        failed = !sup_is_plain_file(path) || sup_read_file(path, data, size, NULL);
    }
    SUP_FREE(path);
    return failed;
}

/* Read a mesh file: OBJ (with its MTL files), PLY, STL or OFF, told by content, then by the end of the name.
   out   out: the mesh; free with sup_mesh_free. Cleared on error
   err   out: the error ("file.ply: line 12: ..."), or after success a warning or an empty text; may be NULL
   Returns 0, or 1 with err->text set. Reads about 100 MB of text a second. */
SUP_FN int sup_mesh_read(const char *path, sup_mesh *out, sup_error *err) {
    char *data, *user;
    size_t size, length = strlen(path);
    int failed;
    memset(out, 0, sizeof *out);
    if (sup_read_file(path, &data, &size, err)) return 1;
    user = (char *)sup_alloc(length + 1, 1); /* a callback's user pointer is not const */
    if (!user) {
        SUP_FREE(data);
        return sup_fail(err, "%s: out of memory", path);
    }
    memcpy(user, path, length + 1);
    failed = sup_mesh_read_memory(data, size, SUP_FORMAT_AUTO, path, supi_open_beside, user, out, err);
    SUP_FREE(user);
    SUP_FREE(data);
    return failed;
}

#endif
