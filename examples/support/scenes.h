/* scenes.h - generated scenes for examples, tests and benchmarks: nothing has to be downloaded
   SPDX-License-Identifier: MIT OR Unlicense

   | name    | detail (0: default)          | triangles by default | closed | colours      | normals |
   | ------- | ---------------------------- | -------------------- | ------ | ------------ | ------- |
   | sphere  | rows (64)                    |               16,128 | yes    |              | yes     |
   | torus   | segments of the tube (48)    |               13,824 | yes    |              | yes     |
   | gyroid  | cells along an edge (64)     |              328,968 | yes    |              | yes     |
   | terrain | cells along an edge (256)    |              131,072 | no     | per vertex   | yes     |
   | menger  | level + 1 (4: level 3)       |               36,096 | yes    |              |         |
   | cornell | -                            |                   32 | no     | per triangle |         |
   | pillars | segments of a column (80)    |              115,984 | no     | per triangle |         |
   | blob    | rows (512)                   |            1,048,576 | yes    |              |         |
   | hall    | cells along an edge (512)    |            1,048,576 | no     |              |         |
   | balls   | rows of a ball (64)          |              100,352 | no     | per triangle | yes     |

   balls has materials: a mirror, glass, a lamp, and pictures that sup_scene_open gives.

   (blob is closed by the places of its vertices: each pole has a ring of them.)
   y is up in all of them; triangles are counter-clockwise seen from outside, of cornell and pillars from inside the
   room, of blob and hall as the programs have them that these two are compared with. */
#ifndef SUP_SCENES_H
#define SUP_SCENES_H

#include "base.h"
#include "mesh.h"

/* a * b + c must not become one operation: the scenes are the same bits elsewhere */
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC push_options
#  pragma GCC optimize("fp-contract=off")
#elif defined(__clang__)
#  pragma STDC FP_CONTRACT OFF
#endif

#define SUPI_PI 3.14159265358979323846f

/* ---- mesh under construction -------------------------------------------------------------------------------- */

typedef struct supi_make {
    sup_mesh mesh;
    size_t position_capacity, normal_capacity, vertex_rgb_capacity, index_capacity, triangle_rgb_capacity;
    size_t texcoord_capacity, material_capacity;
    uint8_t colour[3]; /* of the triangles that follow, when triangle_rgb is used */
    uint32_t material; /* of the triangles that follow; 0: there are no materials */
    int use_triangle_rgb, failed;
} supi_make;

/* Add a vertex; normal and rgb may be NULL, but the same ones for all vertices. Returns its index. */
SUP_FN uint32_t supi_make_vertex(supi_make *make, const float *p, const float *normal, const uint8_t *rgb) {
    sup_mesh *m = &make->mesh;
    const size_t n = m->vertex_count;
    void *a, *b, *c;
    if (make->failed) return 0;
    a = sup_grow(m->positions, &make->position_capacity, 3 * n + 3, sizeof(float));
    b = normal ? sup_grow(m->normals, &make->normal_capacity, 3 * n + 3, sizeof(float)) : NULL;
    c = rgb ? sup_grow(m->vertex_rgb, &make->vertex_rgb_capacity, 3 * n + 3, 1) : NULL;
    if (a) m->positions = (float *)a;
    if (b) m->normals = (float *)b;
    if (c) m->vertex_rgb = (uint8_t *)c;
    if (!a || (normal && !b) || (rgb && !c) || n >= 0xfffffffeu) {
        make->failed = 1;
        return 0;
    }
    memcpy(m->positions + 3 * n, p, 3 * sizeof(float));
    if (normal) memcpy(m->normals + 3 * n, normal, 3 * sizeof(float));
    if (rgb) memcpy(m->vertex_rgb + 3 * n, rgb, 3);
    m->vertex_count = n + 1;
    return (uint32_t)n;
}

SUP_FN uint32_t supi_make_point(supi_make *make, float x, float y, float z) {
    float p[3];
    p[0] = x;
    p[1] = y;
    p[2] = z;
    return supi_make_vertex(make, p, NULL, NULL);
}

SUP_FN void supi_make_triangle(supi_make *make, uint32_t a, uint32_t b, uint32_t c) {
    sup_mesh *m = &make->mesh;
    const size_t n = m->triangle_count;
    void *p, *q = NULL;
    if (make->failed) return;
    p = sup_grow(m->indices, &make->index_capacity, 3 * n + 3, sizeof(uint32_t));
    if (make->use_triangle_rgb) q = sup_grow(m->triangle_rgb, &make->triangle_rgb_capacity, 3 * n + 3, 1);
    if (p) m->indices = (uint32_t *)p;
    if (q) m->triangle_rgb = (uint8_t *)q;
    if (!p || (make->use_triangle_rgb && !q)) {
        make->failed = 1;
        return;
    }
    m->indices[3 * n] = a;
    m->indices[3 * n + 1] = b;
    m->indices[3 * n + 2] = c;
    if (q) memcpy(m->triangle_rgb + 3 * n, make->colour, 3);
    m->triangle_count = n + 1;
}

/* a, b, c, d counter-clockwise. */
SUP_FN void supi_make_quad(supi_make *make, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
    supi_make_triangle(make, a, b, c);
    supi_make_triangle(make, a, c, d);
}

SUP_FN void supi_make_colour(supi_make *make, int red, int green, int blue) {
    make->use_triangle_rgb = 1;
    make->colour[0] = (uint8_t)red;
    make->colour[1] = (uint8_t)green;
    make->colour[2] = (uint8_t)blue;
}

/* A quad of four points of its own, counter-clockwise. */
SUP_FN void supi_make_patch(supi_make *make, const float *a, const float *b, const float *c, const float *d) {
    const uint32_t i = supi_make_vertex(make, a, NULL, NULL), j = supi_make_vertex(make, b, NULL, NULL);
    const uint32_t k = supi_make_vertex(make, c, NULL, NULL), l = supi_make_vertex(make, d, NULL, NULL);
    supi_make_quad(make, i, j, k, l);
}

/* An axis-aligned box with its six sides; inside: seen from inside. */
SUP_FN void supi_make_box(supi_make *make, const float lo[3], const float hi[3], int inside) {
    static const uint8_t sides[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                        {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
    uint32_t v[8], i;
    for (i = 0; i < 8; i++)
        v[i] = supi_make_point(make, i & 1 ? hi[0] : lo[0], i & 2 ? hi[1] : lo[1], i & 4 ? hi[2] : lo[2]);
    for (i = 0; i < 6; i++) {
        const uint8_t *s = sides[i];
        if (inside) supi_make_quad(make, v[s[3]], v[s[2]], v[s[1]], v[s[0]]);
        else supi_make_quad(make, v[s[0]], v[s[1]], v[s[2]], v[s[3]]);
    }
}

/* ---- noise, as the comparison programs have it -------------------------------------------------------------- */

SUP_FN uint32_t supi_hash32(uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    x ^= x >> 16;
    return x;
}

SUP_FN float supi_unit_float(uint32_t hash) { return (float)(hash >> 8) * (1.0f / 16777216.0f); }

SUP_FN float supi_lattice(int x, int y, int z) {
    return supi_unit_float(supi_hash32((uint32_t)x * 73856093u ^ (uint32_t)y * 19349663u ^ (uint32_t)z * 83492791u)) *
               2.0f -
           1.0f;
}

SUP_FN float supi_lerp(float a, float b, float t) { return a + (b - a) * t; }

/* Value noise in -1..1. Every float operation and its order is fixed: the meshes must be the same bits elsewhere. */
SUP_FN float supi_noise(float x, float y, float z) {
    const int ix = (int)floorf(x), iy = (int)floorf(y), iz = (int)floorf(z);
    float fx = x - (float)ix, fy = y - (float)iy, fz = z - (float)iz, c00, c10, c01, c11;
    fx = fx * fx * (3.0f - 2.0f * fx);
    fy = fy * fy * (3.0f - 2.0f * fy);
    fz = fz * fz * (3.0f - 2.0f * fz);
    c00 = supi_lerp(supi_lattice(ix, iy, iz), supi_lattice(ix + 1, iy, iz), fx);
    c10 = supi_lerp(supi_lattice(ix, iy + 1, iz), supi_lattice(ix + 1, iy + 1, iz), fx);
    c01 = supi_lerp(supi_lattice(ix, iy, iz + 1), supi_lattice(ix + 1, iy, iz + 1), fx);
    c11 = supi_lerp(supi_lattice(ix, iy + 1, iz + 1), supi_lattice(ix + 1, iy + 1, iz + 1), fx);
    return supi_lerp(supi_lerp(c00, c10, fy), supi_lerp(c01, c11, fy), fz);
}

SUP_FN float supi_fbm(float x, float y, float z, int octaves) {
    float a = 0.5f, sum = 0.0f;
    int i;
    for (i = 0; i < octaves; i++) {
        sum += a * supi_noise(x, y, z);
        x *= 2.03f;
        y *= 2.03f;
        z *= 2.03f;
        a *= 0.5f;
    }
    return sum;
}

typedef struct supi_rng {
    uint64_t state;
} supi_rng;

SUP_FN float supi_random(supi_rng *rng) {
    rng->state = rng->state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return supi_unit_float(supi_hash32((uint32_t)(rng->state >> 33) ^ (uint32_t)(rng->state >> 13)));
}

/* ---- blob and hall: the same vertices and triangles, bit by bit, as the comparison programs trace ----------- */

SUP_FN void supi_add_blob(supi_make *make, float cx, float cy, float cz, float r, int columns, int rows,
                          float amplitude, float frequency, int octaves, float seed) {
    const uint32_t base = (uint32_t)make->mesh.vertex_count;
    int i, j;
    for (j = 0; j <= rows; j++) {
        for (i = 0; i < columns; i++) {
            const float th = SUPI_PI * (float)j / (float)rows, ph = 2.0f * SUPI_PI * (float)i / (float)columns;
            const float x = sinf(th) * cosf(ph), y = cosf(th), z = sinf(th) * sinf(ph);
            const float d = 1.0f + amplitude * supi_fbm(x * frequency + seed, y * frequency + seed * 1.7f,
                                                        z * frequency - seed, octaves);
            (void)supi_make_point(make, cx + r * d * x, cy + r * d * y, cz + r * d * z);
        }
    }
    for (j = 0; j < rows; j++) {
        for (i = 0; i < columns; i++) {
            const uint32_t a = base + (uint32_t)(j * columns + i),
                           b = base + (uint32_t)(j * columns + (i + 1) % columns);
            const uint32_t c = a + (uint32_t)columns, d = b + (uint32_t)columns;
            supi_make_triangle(make, a, b, c);
            supi_make_triangle(make, b, d, c);
        }
    }
}

SUP_FN void supi_make_hall(supi_make *make, int n) {
    supi_rng rng;
    int i, j, k;
    for (j = 0; j <= n; j++) {
        for (i = 0; i <= n; i++) {
            const float x = -8.0f + 16.0f * (float)i / (float)n, z = -8.0f + 16.0f * (float)j / (float)n;
            (void)supi_make_point(make, x, 1.6f * supi_fbm(x * 0.6f, 7.5f, z * 0.6f, 9) - 1.0f, z);
        }
    }
    for (j = 0; j < n; j++) {
        for (i = 0; i < n; i++) {
            const uint32_t a = (uint32_t)(j * (n + 1) + i), b = a + 1, c = a + (uint32_t)n + 1, d = c + 1;
            supi_make_triangle(make, a, c, b);
            supi_make_triangle(make, b, c, d);
        }
    }
    rng.state = 12345 * UINT64_C(0x9E3779B97F4A7C15) + 1;
    for (k = 0; k < 128; k++) {
        const float x = -7.0f + 14.0f * supi_random(&rng);
        const float y = -0.6f + 2.2f * supi_random(&rng);
        const float z = -7.0f + 14.0f * supi_random(&rng);
        const float radius = 0.15f + 0.35f * supi_random(&rng);
        supi_add_blob(make, x, y, z, radius, n / 8, n / 16, 0.7f, 2.0f, 5, 10.0f * supi_random(&rng));
    }
}

SUP_FN void supi_unit3f(float *a) {
    const float l = 1.0f / sqrtf(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
    a[0] *= l;
    a[1] *= l;
    a[2] *= l;
}

SUP_FN void supi_cross3f(const float *a, const float *b, float *r) {
    r[0] = a[1] * b[2] - a[2] * b[1];
    r[1] = a[2] * b[0] - a[0] * b[2];
    r[2] = a[0] * b[1] - a[1] * b[0];
}

/* The camera rays that the comparison programs trace through "blob" or "hall": unit directions, in 8x8 tiles.
   width, height  pixels; the comparison has 1024x768
   rays           out: origin and direction, 6 floats per ray, [width * height]; free with SUP_FREE. NULL on error
   Returns 0, 1 for another name or no pixels, 2 when memory is short. */
SUP_FN int sup_scene_rays_primary(const char *name, uint32_t width, uint32_t height, float **rays) {
    const int hall = strcmp(name, "hall") == 0;
    const float eye[3] = {hall ? -7.7f : 0.9f, hall ? 0.9f : 0.8f, hall ? -7.4f : 2.4f};
    const float at[3] = {hall ? 0.5f : 0.0f, hall ? -0.4f : 0.0f, hall ? 0.7f : 0.0f};
    const float up[3] = {0.0f, 1.0f, 0.0f};
    /* tanf of half the angle as the C library there computes it: compilers and libraries differ in the last bit. */
    const float th = hall ? 0.577350318f : 0.466307670f, aspect = (float)width / (float)height;
    float f[3], right[3], u[3], *out;
    uint32_t tx, ty, x, y, k;
    size_t count;
    *rays = NULL;
    if ((!hall && strcmp(name, "blob") != 0) || width == 0 || height == 0 || width > 65536 || height > 65536) return 1;
    if (sup_mul_size(width, height, &count)) return 2;
    *rays = out = (float *)sup_alloc(count, 6 * sizeof(float));
    if (!out) return 2;
    for (k = 0; k < 3; k++) f[k] = at[k] - eye[k];
    supi_unit3f(f);
    supi_cross3f(f, up, right);
    supi_unit3f(right);
    supi_cross3f(right, f, u);
    for (ty = 0; ty < height; ty += 8) {
        for (tx = 0; tx < width; tx += 8) {
            for (y = ty; y < ty + 8 && y < height; y++) {
                for (x = tx; x < tx + 8 && x < width; x++) {
                    const float a = (2.0f * ((float)x + 0.5f) / (float)width - 1.0f) * th * aspect;
                    const float b = (1.0f - 2.0f * ((float)y + 0.5f) / (float)height) * th;
                    for (k = 0; k < 3; k++) {
                        out[k] = eye[k];
                        out[3 + k] = f[k] + a * right[k] + b * u[k];
                    }
                    supi_unit3f(out + 3);
                    out += 6;
                }
            }
        }
    }
    return 0;
}

/* ---- simple shapes ------------------------------------------------------------------------------------------ */

/* Unit sphere; one vertex at each pole, so that no triangle is degenerate. */
SUP_FN void supi_make_sphere(supi_make *make, int rows) {
    const int columns = 2 * rows;
    const float top[3] = {0.0f, 1.0f, 0.0f}, bottom[3] = {0.0f, -1.0f, 0.0f};
    uint32_t first, last, i, j, n = (uint32_t)columns;
    first = supi_make_vertex(make, top, top, NULL);
    for (j = 1; j < (uint32_t)rows; j++) {
        for (i = 0; i < n; i++) {
            const float th = SUPI_PI * (float)j / (float)rows, ph = 2.0f * SUPI_PI * (float)i / (float)columns;
            float p[3];
            p[0] = sinf(th) * cosf(ph);
            p[1] = cosf(th);
            p[2] = -sinf(th) * sinf(ph);
            (void)supi_make_vertex(make, p, p, NULL);
        }
    }
    last = supi_make_vertex(make, bottom, bottom, NULL);
    for (i = 0; i < n; i++) {
        const uint32_t k = (i + 1) % n;
        supi_make_triangle(make, first, 1 + i, 1 + k);
        for (j = 0; j + 2 < (uint32_t)rows; j++)
            supi_make_quad(make, 1 + j * n + i, 1 + (j + 1) * n + i, 1 + (j + 1) * n + k, 1 + j * n + k);
        supi_make_triangle(make, last, last - n + k, last - n + i);
    }
}

/* Ring of radius 1 around y, tube of radius 0.4. */
SUP_FN void supi_make_torus(supi_make *make, int tube) {
    const uint32_t m = (uint32_t)tube, n = 3 * m;
    uint32_t i, j;
    for (i = 0; i < n; i++) {
        for (j = 0; j < m; j++) {
            const float u = 2.0f * SUPI_PI * (float)i / (float)n, v = 2.0f * SUPI_PI * (float)j / (float)m;
            float p[3], normal[3];
            normal[0] = cosf(u) * cosf(v);
            normal[1] = sinf(v);
            normal[2] = -sinf(u) * cosf(v);
            p[0] = cosf(u) + 0.4f * normal[0];
            p[1] = 0.4f * normal[1];
            p[2] = -sinf(u) + 0.4f * normal[2];
            (void)supi_make_vertex(make, p, normal, NULL);
        }
    }
    for (i = 0; i < n; i++) {
        for (j = 0; j < m; j++) {
            const uint32_t k = (i + 1) % n, l = (j + 1) % m;
            supi_make_quad(make, i * m + j, k * m + j, k * m + l, i * m + l);
        }
    }
}

/* ---- gyroid ------------------------------------------------------------------------------------------------- */

/* A sheet of constant thickness along the gyroid, cut by a ball: negative inside. Also its gradient. */
SUP_FN float supi_gyroid(const float p[3], float gradient[3]) {
    const float k = 2.0f * SUPI_PI / 0.62f;
    const float sx = sinf(k * p[0]), cx = cosf(k * p[0]), sy = sinf(k * p[1]), cy = cosf(k * p[1]);
    const float sz = sinf(k * p[2]), cz = cosf(k * p[2]);
    const float g = sx * cy + sy * cz + sz * cx, side = g < 0.0f ? -1.0f : 1.0f;
    const float sheet = side * g - 0.45f;
    const float radius = sqrtf(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), ball = (radius - 0.95f) * k;
    const float scale = radius > 0.0f ? 1.0f / radius : 0.0f;
    /* The larger of the two, rounded where they meet: a sharp edge would come out of the grid as a saw. */
    float h = 0.5f + (ball - sheet) * (0.5f / 0.4f);
    h = h < 0.0f ? 0.0f : h > 1.0f ? 1.0f : h;
    gradient[0] = supi_lerp(side * (cx * cy - sz * sx), p[0] * scale, h);
    gradient[1] = supi_lerp(side * (cy * cz - sx * sy), p[1] * scale, h);
    gradient[2] = supi_lerp(side * (cz * cx - sy * sz), p[2] * scale, h);
    return supi_lerp(sheet, ball, h) + 0.4f * h * (1.0f - h);
}

typedef struct supi_tetra {
    supi_make *make;
    supi_map map; /* grid edge -> vertex */
    float *field; /* at the grid points */
    uint32_t n;   /* points along an edge */
} supi_tetra;

SUP_FN void supi_grid_point(uint32_t n, uint32_t at, float p[3]) {
    const float scale = 2.0f / (float)(n - 1);
    p[0] = (float)(at % n) * scale - 1.0f;
    p[1] = (float)(at / n % n) * scale - 1.0f;
    p[2] = (float)(at / n / n) * scale - 1.0f;
}

/* The vertex where the surface crosses the edge between two grid points, made when it is met first. */
SUP_FN uint32_t supi_edge_vertex(supi_tetra *t, uint32_t a, uint32_t b) {
    const uint32_t from = a < b ? a : b, to = a < b ? b : a;
    uint32_t *slot = t->make->failed ? NULL : supi_map_at(&t->map, ((uint64_t)from << 32) | to);
    float p[3], q[3], gradient[3], s;
    int k;
    if (!slot) {
        t->make->failed = 1;
        return 0;
    }
    if (*slot != SUPI_MAP_EMPTY) return *slot;
    s = t->field[from] / (t->field[from] - t->field[to]);
    supi_grid_point(t->n, from, p);
    supi_grid_point(t->n, to, q);
    for (k = 0; k < 3; k++) p[k] = supi_lerp(p[k], q[k], s);
    (void)supi_gyroid(p, gradient);
    if (gradient[0] == 0.0f && gradient[1] == 0.0f && gradient[2] == 0.0f) gradient[1] = 1.0f;
    supi_unit3f(gradient);
    *slot = supi_make_vertex(t->make, p, gradient, NULL);
    return *slot;
}

/* One tetrahedron with corners of positive orientation. Moving the odd corner to the front by an even permutation keeps
   the orientation, so the triangles always face the positive side. */
SUP_FN void supi_march_tetra(supi_tetra *t, const uint32_t v[4]) {
    static const uint8_t front[4][4] = {{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 0, 1, 3}, {3, 0, 2, 1}};
    static const uint8_t pairs[16][4] = {{0},          {0}, {0}, {0, 1, 2, 3}, {0},          {0, 2, 3, 1},
                                         {1, 2, 0, 3}, {0}, {0}, {0, 3, 1, 2}, {1, 3, 2, 0}, {0},
                                         {2, 3, 0, 1}, {0}, {0}, {0}};
    uint32_t inside = 0, count = 0, k;
    for (k = 0; k < 4; k++) {
        const uint32_t in = t->field[v[k]] < 0.0f;
        inside |= in << k;
        count += in;
    }
    if (count == 1 || count == 3) {
        const uint32_t odd = count == 1 ? inside : 15u - inside;
        const uint8_t *f = front[odd == 1 ? 0 : odd == 2 ? 1 : odd == 4 ? 2 : 3];
        const uint32_t a = supi_edge_vertex(t, v[f[0]], v[f[1]]), b = supi_edge_vertex(t, v[f[0]], v[f[2]]);
        const uint32_t c = supi_edge_vertex(t, v[f[0]], v[f[3]]);
        if (count == 1) supi_make_triangle(t->make, a, b, c);
        else supi_make_triangle(t->make, a, c, b);
    } else if (count == 2) {
        const uint8_t *f = pairs[inside]; /* the two inside, then the two outside */
        const uint32_t a = supi_edge_vertex(t, v[f[0]], v[f[2]]), b = supi_edge_vertex(t, v[f[0]], v[f[3]]);
        const uint32_t c = supi_edge_vertex(t, v[f[1]], v[f[3]]), d = supi_edge_vertex(t, v[f[1]], v[f[2]]);
        supi_make_quad(t->make, a, b, c, d);
    }
}

/* Marching tetrahedra, six to a cell, all along the same diagonal so that neighbours fit. */
SUP_FN void supi_make_gyroid(supi_make *make, int cells) {
    static const uint8_t paths[6][2] = {{1, 3}, {2, 6}, {4, 5}, {5, 1}, {3, 2}, {6, 4}};
    supi_tetra t;
    uint32_t x, y, z, k;
    const uint32_t n = (uint32_t)cells + 1;
    float p[3], unused[3];
    t.make = make;
    t.n = n;
    memset(&t.map, 0, sizeof t.map);
    t.field = (float *)sup_alloc((size_t)n * n * n, sizeof(float));
    if (!t.field) make->failed = 1;
    for (k = 0; t.field && k < n * n * n; k++) {
        supi_grid_point(n, k, p);
        t.field[k] = supi_gyroid(p, unused);
    }
    for (z = 0; z + 1 < n && !make->failed; z++) {
        for (y = 0; y + 1 < n; y++) {
            for (x = 0; x + 1 < n; x++) {
                uint32_t c[8];
                for (k = 0; k < 8; k++) c[k] = x + (k & 1) + n * (y + (k >> 1 & 1) + n * (z + (k >> 2)));
                for (k = 0; k < 6; k++) {
                    uint32_t v[4];
                    v[0] = c[0];
                    v[1] = c[paths[k][0]];
                    v[2] = c[paths[k][1]];
                    v[3] = c[7];
                    supi_march_tetra(&t, v);
                }
            }
        }
    }
    SUP_FREE(t.field);
    supi_map_free(&t.map);
}

/* ---- terrain ------------------------------------------------------------------------------------------------ */

SUP_FN float supi_terrain_height(float x, float z) {
    const float hills = supi_fbm(x * 1.3f + 4.1f, 2.5f, z * 1.3f - 1.7f, 9);
    const float ridge = 1.0f - fabsf(supi_noise(x * 1.1f - 8.3f, 5.5f, z * 1.1f + 3.9f));
    return 0.55f * hills + 0.5f * ridge * ridge - 0.25f;
}

/* Four units wide; water, sand, grass, rock and snow by height and slope. */
SUP_FN void supi_make_terrain(supi_make *make, int n) {
    static const float heights[6] = {-0.12f, -0.07f, -0.03f, 0.14f, 0.26f, 0.36f};
    static const float colours[6][3] = {{58.0f, 96.0f, 130.0f}, {196.0f, 182.0f, 140.0f}, {96.0f, 124.0f, 62.0f},
                                        {72.0f, 98.0f, 54.0f},  {118.0f, 106.0f, 94.0f},  {238.0f, 240.0f, 244.0f}};
    const float step = 4.0f / (float)n;
    int i, j, k, band;
    for (j = 0; j <= n; j++) {
        for (i = 0; i <= n; i++) {
            float p[3], normal[3], t, slope;
            uint8_t rgb[3];
            p[0] = -2.0f + step * (float)i;
            p[2] = -2.0f + step * (float)j;
            p[1] = supi_terrain_height(p[0], p[2]);
            normal[0] = supi_terrain_height(p[0] - step, p[2]) - supi_terrain_height(p[0] + step, p[2]);
            normal[1] = 2.0f * step;
            normal[2] = supi_terrain_height(p[0], p[2] - step) - supi_terrain_height(p[0], p[2] + step);
            if (p[1] < heights[0]) { /* a lake is flat */
                p[1] = heights[0];
                normal[0] = normal[2] = 0.0f;
            }
            supi_unit3f(normal);
            for (band = 0; band < 4 && p[1] > heights[band + 1]; band++) {}
            t = (p[1] - heights[band]) / (heights[band + 1] - heights[band]);
            t = t < 0.0f ? 0.0f : t > 1.0f ? 1.0f : t;
            slope = p[1] > heights[2] ? (1.0f - normal[1]) * 2.5f : 0.0f; /* steep ground is bare rock */
            slope = slope > 1.0f ? 1.0f : slope;
            for (k = 0; k < 3; k++)
                rgb[k] = (uint8_t)supi_lerp(supi_lerp(colours[band][k], colours[band + 1][k], t), colours[4][k], slope);
            (void)supi_make_vertex(make, p, normal, rgb);
        }
    }
    for (j = 0; j < n; j++) {
        for (i = 0; i < n; i++) {
            const uint32_t a = (uint32_t)(j * (n + 1) + i), c = a + (uint32_t)n + 1;
            supi_make_quad(make, a, c, c + 1, a + 1);
        }
    }
}

/* ---- Menger sponge ------------------------------------------------------------------------------------------ */

SUP_FN int supi_menger_solid(uint32_t size, uint32_t x, uint32_t y, uint32_t z) {
    if (x >= size || y >= size || z >= size) return 0; /* below zero wraps round to large */
    for (; x || y || z; x /= 3, y /= 3, z /= 3) {
        if ((x % 3 == 1) + (y % 3 == 1) + (z % 3 == 1) >= 2) return 0;
    }
    return 1;
}

SUP_FN void supi_make_menger(supi_make *make, int level) {
    static const uint8_t sides[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                        {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
    uint32_t size = 1, x, y, z, k, side, *ids;
    size_t points;
    float scale;
    for (; level > 0; level--) size *= 3;
    points = (size_t)(size + 1) * (size + 1) * (size + 1);
    ids = (uint32_t *)sup_alloc(points, sizeof *ids);
    if (!ids) {
        make->failed = 1;
        return;
    }
    memset(ids, 255, points * sizeof *ids);
    scale = 2.0f / (float)size;
    for (z = 0; z < size; z++) {
        for (y = 0; y < size; y++) {
            for (x = 0; x < size; x++) {
                if (!supi_menger_solid(size, x, y, z)) continue;
                for (side = 0; side < 6; side++) {
                    const uint32_t step = side & 1 ? 1u : 0xffffffffu;
                    uint32_t v[4];
                    if (supi_menger_solid(size, x + (side / 2 == 0 ? step : 0), y + (side / 2 == 1 ? step : 0),
                                          z + (side / 2 == 2 ? step : 0)))
                        continue;
                    for (k = 0; k < 4; k++) {
                        const uint32_t c = sides[side][k], px = x + (c & 1), py = y + (c >> 1 & 1), pz = z + (c >> 2);
                        uint32_t *id = ids + px + (size_t)(size + 1) * (py + (size_t)(size + 1) * pz);
                        if (*id == 0xffffffffu)
                            *id = supi_make_point(make, (float)px * scale - 1.0f, (float)py * scale - 1.0f,
                                                  (float)pz * scale - 1.0f);
                        v[k] = *id;
                    }
                    supi_make_quad(make, v[0], v[1], v[2], v[3]);
                }
            }
        }
    }
    SUP_FREE(ids);
}

/* ---- Cornell box -------------------------------------------------------------------------------------------- */

/* A block on the floor from the four corners of its top, given clockwise seen from above as in the published data. */
SUP_FN void supi_cornell_block(supi_make *make, float height, const float corner[4][2]) {
    float v[8][3];
    int k;
    for (k = 0; k < 4; k++) {
        v[k][0] = v[k + 4][0] = corner[k][0];
        v[k][2] = v[k + 4][2] = corner[k][1];
        v[k][1] = height;
        v[k + 4][1] = 0.0f;
    }
    supi_make_patch(make, v[0], v[1], v[2], v[3]);
    for (k = 0; k < 4; k++) supi_make_patch(make, v[k], v[k + 4], v[(k + 1) % 4 + 4], v[(k + 1) % 4]);
}

/* The box of C. Goral et al. (1984) with the measured sizes of Cornell University, in metres, the open side towards +z.
   The lamp is the white square just below the ceiling; it is the first two triangles. */
SUP_FN void supi_make_cornell(supi_make *make) {
    static const float lamp[4][3] = {
        {2.13f, 5.487f, -2.27f}, {3.43f, 5.487f, -2.27f}, {3.43f, 5.487f, -3.32f}, {2.13f, 5.487f, -3.32f}};
    static const float v[8][3] = {{0.0f, 0.0f, 0.0f},       {5.56f, 0.0f, 0.0f},    {5.56f, 0.0f, -5.592f},
                                  {0.0f, 0.0f, -5.592f},    {0.0f, 5.488f, 0.0f},   {5.56f, 5.488f, 0.0f},
                                  {5.56f, 5.488f, -5.592f}, {0.0f, 5.488f, -5.592f}};
    static const float low_block[4][2] = {{4.26f, -0.65f}, {4.74f, -2.25f}, {3.16f, -2.72f}, {2.66f, -1.14f}};
    static const float tall_block[4][2] = {{1.33f, -2.47f}, {2.91f, -2.96f}, {2.42f, -4.56f}, {0.84f, -4.06f}};
    supi_make_colour(make, 255, 255, 255);
    supi_make_patch(make, lamp[3], lamp[2], lamp[1], lamp[0]);
    supi_make_colour(make, 224, 219, 209);
    supi_make_patch(make, v[0], v[1], v[2], v[3]); /* floor */
    supi_make_patch(make, v[4], v[7], v[6], v[5]); /* ceiling */
    supi_make_patch(make, v[3], v[2], v[6], v[7]); /* back */
    supi_make_colour(make, 186, 39, 34);
    supi_make_patch(make, v[0], v[3], v[7], v[4]); /* left */
    supi_make_colour(make, 72, 152, 64);
    supi_make_patch(make, v[1], v[5], v[6], v[2]); /* right */
    supi_make_colour(make, 224, 219, 209);
    supi_cornell_block(make, 1.65f, low_block);
    supi_cornell_block(make, 3.30f, tall_block);
}

/* ---- hall of pillars ---------------------------------------------------------------------------------------- */

/* A column around (cx, cz): profile points {height, radius, depth of the flutes}, turned round the vertical axis. */
SUP_FN void supi_make_column(supi_make *make, float cx, float cz, int segments) {
    static const float profile[20][3] = {
        {0.30f, 0.62f, 0.0f},  {0.36f, 0.66f, 0.0f}, {0.44f, 0.66f, 0.0f}, {0.50f, 0.60f, 0.0f}, {0.55f, 0.55f, 0.0f},
        {0.60f, 0.57f, 0.0f},  {0.66f, 0.57f, 0.0f}, {0.72f, 0.50f, 0.0f}, {0.80f, 0.47f, 0.0f}, {0.95f, 0.46f, 1.0f},
        {2.20f, 0.455f, 1.0f}, {3.60f, 0.44f, 1.0f}, {5.00f, 0.41f, 1.0f}, {6.30f, 0.38f, 1.0f}, {6.45f, 0.38f, 0.0f},
        {6.52f, 0.42f, 0.0f},  {6.58f, 0.40f, 0.0f}, {6.75f, 0.46f, 0.0f}, {6.92f, 0.58f, 0.0f}, {7.00f, 0.64f, 0.0f}};
    const uint32_t base = (uint32_t)make->mesh.vertex_count, n = (uint32_t)segments;
    float lo[3], hi[3];
    uint32_t i, j;
    for (j = 0; j < 20; j++) {
        for (i = 0; i < n; i++) {
            const float a = 2.0f * SUPI_PI * (float)i / (float)n, s = sinf(10.0f * a);
            const float r = profile[j][1] - 0.035f * profile[j][2] * (1.0f - s * s);
            (void)supi_make_point(make, cx + r * cosf(a), profile[j][0], cz - r * sinf(a));
        }
    }
    for (j = 0; j < 19; j++) {
        for (i = 0; i < n; i++) {
            const uint32_t a = base + j * n + i, b = base + j * n + (i + 1) % n;
            supi_make_quad(make, a, b, b + n, a + n);
        }
    }
    for (i = 0; i < 2; i++) { /* plinth and abacus */
        const float half = i == 0 ? 0.75f : 0.70f;
        lo[0] = cx - half;
        hi[0] = cx + half;
        lo[1] = i == 0 ? 0.0f : 7.0f;
        hi[1] = i == 0 ? 0.30f : 7.25f;
        lo[2] = cz - half;
        hi[2] = cz + half;
        supi_make_box(make, lo, hi, 0);
    }
}

/* 16 x 36 m, 8.2 m high, four rows of nine columns under beams; chequered floor, walls of blocks. */
SUP_FN void supi_make_pillars(supi_make *make, int segments) {
    static const uint8_t stones[5][3] = {
        {206, 196, 178}, {190, 172, 148}, {176, 158, 140}, {214, 206, 194}, {168, 140, 120}};
    const float lo[3] = {-8.0f, 0.0f, -18.0f}, hi[3] = {8.0f, 8.2f, 18.0f};
    int i, j, side;
    for (j = 0; j < 36; j++) {
        for (i = 0; i < 16; i++) {
            float v[4][3];
            const float x = lo[0] + (float)i, z = lo[2] + (float)j;
            const int shade = (int)(supi_hash32((uint32_t)(i * 64 + j)) & 15u);
            int k;
            for (k = 0; k < 4; k++) {
                v[k][0] = x + (k == 1 || k == 2 ? 1.0f : 0.0f);
                v[k][1] = 0.0f;
                v[k][2] = z + (k >= 2 ? 1.0f : 0.0f);
            }
            if ((i + j) % 2) supi_make_colour(make, 196 + shade, 188 + shade, 172 + shade);
            else supi_make_colour(make, 84 + shade, 64 + shade, 58 + shade);
            supi_make_patch(make, v[3], v[2], v[1], v[0]);
            for (k = 0; k < 4; k++) v[k][1] = hi[1];
            supi_make_colour(make, 172 + shade, 164 + shade, 150 + shade);
            supi_make_patch(make, v[0], v[1], v[2], v[3]);
        }
    }
    for (side = 0; side < 4; side++) { /* walls of blocks, half a metre high and one wide */
        const int wide = side < 2 ? 36 : 16;
        for (j = 0; j < 16; j++) {
            for (i = 0; i < wide; i++) {
                float v[4][3];
                const uint8_t *stone = stones[supi_hash32((uint32_t)(side * 4096 + j * 64 + i)) % 5u];
                int k;
                for (k = 0; k < 4; k++) {
                    const float along = (float)(i + (k == 1 || k == 2 ? 1 : 0));
                    v[k][1] = hi[1] * (float)(j + (k >= 2 ? 1 : 0)) / 16.0f;
                    v[k][0] = side < 2 ? (side == 0 ? lo[0] : hi[0]) : lo[0] + along;
                    v[k][2] = side < 2 ? lo[2] + along : (side == 2 ? lo[2] : hi[2]);
                }
                supi_make_colour(make, stone[0], stone[1], stone[2]);
                if (side == 0 || side == 3) supi_make_patch(make, v[3], v[2], v[1], v[0]);
                else supi_make_patch(make, v[0], v[1], v[2], v[3]);
            }
        }
    }
    for (i = 0; i < 4; i++) {
        const float x = -6.0f + 4.0f * (float)i;
        float beam_lo[3], beam_hi[3];
        for (j = 0; j < 9; j++) {
            const uint8_t *stone = stones[(i * 7 + j * 3) % 5];
            supi_make_colour(make, stone[0], stone[1], stone[2]);
            supi_make_column(make, x, -16.0f + 4.0f * (float)j, segments);
        }
        beam_lo[0] = x - 0.6f;
        beam_hi[0] = x + 0.6f;
        beam_lo[1] = 7.25f;
        beam_hi[1] = 7.95f;
        beam_lo[2] = lo[2];
        beam_hi[2] = hi[2];
        supi_make_colour(make, 150, 116, 86);
        supi_make_box(make, beam_lo, beam_hi, 0);
    }
}

/* ---- a mirror, glass and a lamp on tiles -------------------------------------------------------------------- */

/* A triangle with texture coordinates and the material in work. */
SUP_FN void supi_make_textured(supi_make *make, const uint32_t v[3], const float uv[3][2]) {
    sup_mesh *m = &make->mesh;
    const size_t n = m->triangle_count;
    void *p = sup_grow(m->texcoords, &make->texcoord_capacity, 6 * n + 6, sizeof(float));
    void *q = sup_grow(m->triangle_material, &make->material_capacity, n + 1, sizeof(uint32_t));
    if (p) m->texcoords = (float *)p;
    if (q) m->triangle_material = (uint32_t *)q;
    if (!p || !q) {
        make->failed = 1;
        return;
    }
    memcpy(m->texcoords + 6 * n, uv, 6 * sizeof(float));
    m->triangle_material[n] = make->material;
    supi_make_triangle(make, v[0], v[1], v[2]);
}

/* A ball, with a picture that goes around it once. */
SUP_FN void supi_make_ball(supi_make *make, float cx, float cy, float cz, float r, uint32_t rows) {
    const uint32_t columns = 2 * rows, base = (uint32_t)make->mesh.vertex_count;
    uint32_t i, j, k;
    for (j = 0; j <= rows; j++) {
        for (i = 0; i <= columns; i++) {
            const float th = SUPI_PI * (float)j / (float)rows, ph = 2.0f * SUPI_PI * (float)i / (float)columns;
            float n[3], p[3];
            n[0] = sinf(th) * cosf(ph);
            n[1] = cosf(th);
            n[2] = -sinf(th) * sinf(ph);
            p[0] = cx + r * n[0];
            p[1] = cy + r * n[1];
            p[2] = cz + r * n[2];
            (void)supi_make_vertex(make, p, n, NULL);
        }
    }
    for (j = 0; j < rows; j++) {
        for (i = 0; i < columns; i++) {
            uint32_t v[4], t[3];
            float uv[4][2], w[3][2];
            for (k = 0; k < 4; k++) { /* upper left, lower left, lower right, upper right */
                const uint32_t down = k == 1 || k == 2, right = k > 1;
                v[k] = base + (j + down) * (columns + 1) + i + right;
                uv[k][0] = (float)(i + right) / (float)columns;
                uv[k][1] = 1.0f - (float)(j + down) / (float)rows;
            }
            for (k = 0; k < 2 && !make->failed; k++) {
                const uint32_t second = k == 0 ? 1 : 2, third = second + 1;
                if ((k == 0 && j + 1 == rows) || (k == 1 && j == 0)) continue; /* no area */
                t[0] = v[0];
                t[1] = v[second];
                t[2] = v[third];
                memcpy(w[0], uv[0], sizeof w[0]);
                memcpy(w[1], uv[second], sizeof w[1]);
                memcpy(w[2], uv[third], sizeof w[2]);
                supi_make_textured(make, t, (const float (*)[2])w);
            }
        }
    }
}

SUP_FN sup_material *supi_make_material(supi_make *make, uint32_t number, int red, int green, int blue) {
    sup_material *m = make->mesh.materials + number;
    m->transmit[0] = m->transmit[1] = m->transmit[2] = m->ni = m->opacity = 1.0f;
    m->illum = 2;
    make->material = number + 1;
    supi_make_colour(make, red, green, blue);
    return m;
}

SUP_FN void supi_make_picture(supi_make *make, sup_map *map, const char *name, float scale, float strength) {
    const size_t length = strlen(name);
    map->name = (char *)sup_alloc(length + 1, 1);
    if (map->name) memcpy(map->name, name, length + 1);
    else make->failed = 1;
    map->scale[0] = map->scale[1] = scale;
    map->strength = strength;
}

SUP_FN void supi_make_balls(supi_make *make, uint32_t rows) {
    static const float corner[4][3] = {{-4.0f, 0.0f, 3.0f}, {4.0f, 0.0f, 3.0f}, {4.0f, 0.0f, -4.0f}, {-4.0f, 0.0f, -4.0f}};
    static const uint32_t half[2][3] = {{0, 1, 2}, {0, 2, 3}};
    static const float up[3] = {0.0f, 1.0f, 0.0f};
    sup_material *m;
    uint32_t i, k;
    make->mesh.materials = (sup_material *)sup_alloc(7, sizeof *make->mesh.materials);
    if (!make->mesh.materials) {
        make->failed = 1;
        return;
    }
    memset(make->mesh.materials, 0, 7 * sizeof *make->mesh.materials);
    make->mesh.material_count = 7;
    m = supi_make_material(make, 0, 255, 255, 255); /* floor */
    supi_make_picture(make, &m->color_map, "tiles.ppm", 1.0f, 1.0f);
    supi_make_picture(make, &m->bump_map, "tiles.pgm", 1.0f, 0.02f);
    m->specular[0] = m->specular[1] = m->specular[2] = 0.06f;
    m->illum = 3;
    m->shininess = 60.0f;
    for (i = 0; i < 4; i++) (void)supi_make_vertex(make, corner[i], up, NULL);
    for (i = 0; i < 2 && !make->failed; i++) {
        float uv[3][2];
        for (k = 0; k < 3; k++) {
            uv[k][0] = corner[half[i][k]][0];
            uv[k][1] = -corner[half[i][k]][2];
        }
        supi_make_textured(make, half[i], (const float (*)[2])uv);
    }
    m = supi_make_material(make, 1, 20, 20, 20); /* mirror */
    m->specular[0] = m->specular[1] = m->specular[2] = 0.9f;
    m->illum = 3;
    m->shininess = 400.0f;
    supi_make_ball(make, -0.95f, 0.82f, -0.35f, 0.8f, rows);
    m = supi_make_material(make, 2, 255, 255, 255); /* glass */
    m->opacity = 0.0f;
    m->has_opacity = m->has_transmit = 1;
    m->transmit[0] = 0.93f;
    m->transmit[1] = 0.98f;
    m->transmit[2] = 0.96f;
    m->specular[0] = m->specular[1] = m->specular[2] = 0.8f;
    m->illum = 7;
    m->ni = 1.5f;
    m->shininess = 400.0f;
    supi_make_ball(make, 0.72f, 0.67f, 0.5f, 0.65f, rows);
    (void)supi_make_material(make, 3, 255, 240, 215); /* lamp */
    make->mesh.materials[3].emission[0] = 1.6f;
    make->mesh.materials[3].emission[1] = 1.4f;
    make->mesh.materials[3].emission[2] = 1.0f;
    supi_make_ball(make, 0.55f, 2.15f, -0.9f, 0.22f, rows);
    m = supi_make_material(make, 4, 205, 95, 45); /* displaced */
    supi_make_picture(make, &m->displace_map, "knobs.pgm", 1.0f, 0.07f);
    m->displace_map.scale[0] = 12.0f;
    m->displace_map.scale[1] = 6.0f;
    supi_make_ball(make, 0.75f, 0.5f, -1.5f, 0.44f, rows);
    m = supi_make_material(make, 5, 30, 70, 180); /* shiny */
    m->specular[0] = m->specular[1] = m->specular[2] = 0.7f;
    m->shininess = 50.0f;
    supi_make_ball(make, -0.12f, 0.29f, 1.0f, 0.28f, rows);
    m = supi_make_material(make, 6, 235, 170, 80); /* gold */
    m->specular[0] = 0.85f;
    m->specular[1] = 0.6f;
    m->specular[2] = 0.28f;
    m->illum = 3;
    m->shininess = 80.0f;
    supi_make_ball(make, -0.35f, 0.36f, -1.75f, 0.35f, rows);
}

/* The pictures of generated scenes, as a sup_open_fn: 256 x 256 pixels of tiles, with their heights, and of knobs. */
SUP_FN int sup_scene_open(void *user, const char *name, char **data, size_t *size) {
    enum { SIDE = 256 };
    const int colour = strcmp(name, "tiles.ppm") == 0, tiles = colour || strcmp(name, "tiles.pgm") == 0;
    const size_t channels = colour ? 3 : 1;
    size_t head, c;
    int x, y;
    uint8_t *out;
    (void)user;
    if (!tiles && strcmp(name, "knobs.pgm") != 0) return 1;
    *data = (char *)sup_alloc(SIDE * SIDE * channels + 32, 1);
    if (!*data) return 1;
    head = (size_t)snprintf(*data, 32, "P%d %d %d 255\n", colour ? 6 : 5, (int)SIDE, (int)SIDE);
    *size = head + SIDE * SIDE * channels;
    out = (uint8_t *)*data + head;
    for (y = 0; y < SIDE; y++) {
        for (x = 0; x < SIDE; x++) {
            const int odd = (x >= SIDE / 2) != (y >= SIDE / 2), half = SIDE / 2, joint = SIDE / 64;
            const int edge_x = x % half < half - x % half ? x % half : half - x % half;
            const int edge_y = y % half < half - y % half ? y % half : half - y % half;
            const int edge = edge_x < edge_y ? edge_x : edge_y, grain = (int)(supi_fbm((float)x * 0.06f, (float)y * 0.02f, odd ? 3.0f : 9.0f, 4) * 46.0f);
            const float dx = (float)(x - half) / (float)half, dy = (float)(y - half) / (float)half;
            const float r = dx * dx + dy * dy, high = r < 0.64f ? sqrtf(1.0f - r / 0.64f) : 0.0f;
            static const int paint[3][3] = {{196, 186, 170}, {92, 44, 34}, {60, 58, 56}};
            for (c = 0; c < channels; c++) {
                int v = !tiles ? (int)(255.0f * high) : edge < joint ? 0 : edge < 2 * joint ? 255 * (edge - joint) / joint : 255;
                if (colour) v = paint[edge < joint ? 2 : odd][c] + (edge < joint ? 0 : grain);
                *out++ = (uint8_t)(v < 0 ? 0 : v > 255 ? 255 : v);
            }
        }
    }
    return 0;
}

/* ---- by name ------------------------------------------------------------------------------------------------ */

#define SUP_SCENE_NAMES "sphere|torus|gyroid|terrain|menger|cornell|pillars|blob|hall|balls"
enum { SUP_SCENE_COUNT = 10 };

/* Make a scene by its name (one of SUP_SCENE_NAMES); the table above says what `detail` means, 0 is its default.
   The same bits everywhere but for what sinf and cosf of the C library differ in.
   out  out: the mesh; free with sup_mesh_free. Cleared on error
   Returns 0, 1 for an unknown name or a detail out of range, 2 when memory is short. */
SUP_FN int sup_scene_make(const char *name, int detail, sup_mesh *out) {
    static const struct {
        char name[8];
        int usual, least, most;
    } scenes[SUP_SCENE_COUNT] = {{"sphere", 64, 2, 8192},   {"torus", 48, 3, 4096}, {"gyroid", 64, 2, 512},
                                 {"terrain", 256, 1, 8192}, {"menger", 4, 1, 6},    {"cornell", 1, 1, 1},
                                 {"pillars", 80, 3, 4096},  {"blob", 512, 2, 8192}, {"hall", 512, 32, 8192},
                                 {"balls", 64, 4, 1024}};
    supi_make make;
    int k;
    memset(out, 0, sizeof *out);
    memset(&make, 0, sizeof make);
    for (k = 0; k < SUP_SCENE_COUNT && strcmp(name, scenes[k].name) != 0; k++) {}
    if (k == SUP_SCENE_COUNT) return 1;
    if (detail == 0) detail = scenes[k].usual;
    if (detail < scenes[k].least || detail > scenes[k].most) return 1;
    switch (k) {
    case 0: supi_make_sphere(&make, detail); break;
    case 1: supi_make_torus(&make, detail); break;
    case 2: supi_make_gyroid(&make, detail); break;
    case 3: supi_make_terrain(&make, detail); break;
    case 4: supi_make_menger(&make, detail - 1); break;
    case 5: supi_make_cornell(&make); break;
    case 6: supi_make_pillars(&make, detail); break;
    case 7: supi_add_blob(&make, 0.0f, 0.0f, 0.0f, 1.0f, 2 * detail, detail, 0.6f, 2.5f, 8, 3.1f); break;
    case 8: supi_make_hall(&make, detail); break;
    default: supi_make_balls(&make, (uint32_t)detail); break;
    }
    if (make.failed) {
        sup_mesh_free(&make.mesh);
        return 2;
    }
    *out = make.mesh;
    return 0;
}

#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC pop_options
#endif

#endif
