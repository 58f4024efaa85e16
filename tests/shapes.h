/* shapes.h - closed meshes for tests: boxes, spheres, tori, soups; turned, moved, mirrored - C99 and C++11 - MIT OR
   Unlicense, see LICENSE. Neighbouring triangles share their vertices, so what is closed has no cracks. */
#ifndef SHAPES_H_INCLUDED
#define SHAPES_H_INCLUDED
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#  define SHAPE_FN static __attribute__((unused))
#else
#  define SHAPE_FN static
#endif

typedef struct shape {
    float *p;            /* xyz */
    float *normal;       /* xyz, of spheres and tori; valid for all vertices or none */
    uint32_t *t;         /* three a triangle, outward winding */
    size_t vertices, triangles, vertex_room, triangle_room;
} shape;

SHAPE_FN uint32_t shape_vertex(shape *s, double x, double y, double z) {
    if (s->vertices == s->vertex_room) {
        s->vertex_room = s->vertex_room * 2 + 64;
        s->p = (float *)realloc(s->p, s->vertex_room * 12);
        s->normal = (float *)realloc(s->normal, s->vertex_room * 12);
        if (s->p == NULL || s->normal == NULL) abort();
    }
    s->p[3 * s->vertices] = (float)x;
    s->p[3 * s->vertices + 1] = (float)y;
    s->p[3 * s->vertices + 2] = (float)z;
    memset(s->normal + 3 * s->vertices, 0, 12);
    return (uint32_t)s->vertices++;
}

SHAPE_FN void shape_triangle(shape *s, uint32_t a, uint32_t b, uint32_t c) {
    if (s->triangles == s->triangle_room) {
        s->triangle_room = s->triangle_room * 2 + 64;
        s->t = (uint32_t *)realloc(s->t, s->triangle_room * 12);
        if (s->t == NULL) abort();
    }
    s->t[3 * s->triangles] = a;
    s->t[3 * s->triangles + 1] = b;
    s->t[3 * s->triangles + 2] = c;
    s->triangles++;
}

SHAPE_FN void shape_free(shape *s) {
    free(s->p);
    free(s->normal);
    free(s->t);
    memset(s, 0, sizeof *s);
}

SHAPE_FN void shape_set_normal(shape *s, uint32_t v, double x, double y, double z) {
    s->normal[3 * v] = (float)x;
    s->normal[3 * v + 1] = (float)y;
    s->normal[3 * v + 2] = (float)z;
}

SHAPE_FN void shape_box(shape *s, double x0, double y0, double z0, double x1, double y1, double z1) {
    static const uint8_t quad[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
    uint32_t v[8];
    int i;
    for (i = 0; i < 8; i++) v[i] = shape_vertex(s, i & 1 ? x1 : x0, i & 2 ? y1 : y0, i & 4 ? z1 : z0);
    for (i = 0; i < 6; i++) {
        shape_triangle(s, v[quad[i][0]], v[quad[i][1]], v[quad[i][2]]);
        shape_triangle(s, v[quad[i][0]], v[quad[i][2]], v[quad[i][3]]);
    }
}

SHAPE_FN void shape_sphere(shape *s, double x, double y, double z, double r, uint32_t rings) {
    const double pi = 3.14159265358979323846;
    uint32_t top = shape_vertex(s, x, y, z + r), bottom = shape_vertex(s, x, y, z - r), first = (uint32_t)s->vertices;
    uint32_t n = 2 * rings, i, j;
    shape_set_normal(s, top, 0, 0, 1);
    shape_set_normal(s, bottom, 0, 0, -1);
    for (i = 1; i < rings; i++) {
        for (j = 0; j < n; j++) {
            double a = pi * i / rings, b = 2 * pi * j / n, nx = sin(a) * cos(b), ny = sin(a) * sin(b), nz = cos(a);
            shape_set_normal(s, shape_vertex(s, x + r * nx, y + r * ny, z + r * nz), nx, ny, nz);
        }
    }
    for (j = 0; j < n; j++) {
        uint32_t k = (j + 1) % n;
        shape_triangle(s, top, first + j, first + k);
        shape_triangle(s, bottom, first + (rings - 2) * n + k, first + (rings - 2) * n + j);
        for (i = 0; i + 2 < rings; i++) {
            uint32_t a = first + i * n + j, b = first + i * n + k;
            shape_triangle(s, a, a + n, b + n);
            shape_triangle(s, a, b + n, b);
        }
    }
}

SHAPE_FN void shape_torus(shape *s, double x, double y, double z, double ring, double tube, uint32_t n, uint32_t m) {
    const double pi = 3.14159265358979323846;
    uint32_t first = (uint32_t)s->vertices, i, j;
    for (i = 0; i < n; i++) {
        for (j = 0; j < m; j++) {
            double a = 2 * pi * i / n, b = 2 * pi * j / m, d = ring + tube * cos(b);
            uint32_t v = shape_vertex(s, x + d * cos(a), y + d * sin(a), z + tube * sin(b));
            shape_set_normal(s, v, cos(a) * cos(b), sin(a) * cos(b), sin(b));
        }
    }
    for (i = 0; i < n; i++) {
        for (j = 0; j < m; j++) {
            uint32_t i1 = (i + 1) % n, j1 = (j + 1) % m;
            shape_triangle(s, first + i * m + j, first + i1 * m + j, first + i1 * m + j1);
            shape_triangle(s, first + i * m + j, first + i1 * m + j1, first + i * m + j1);
        }
    }
}

/* Rotation by the unit quaternion of three numbers in [0,1) (Shoemake 1992): rows of m. */
SHAPE_FN void shape_rotation(double u, double v, double w, double m[9]) {
    const double pi = 3.14159265358979323846;
    double a = sqrt(1 - u), b = sqrt(u), q0 = a * sin(2 * pi * v), q1 = a * cos(2 * pi * v), q2 = b * sin(2 * pi * w);
    double q3 = b * cos(2 * pi * w);
    m[0] = 1 - 2 * (q1 * q1 + q2 * q2);
    m[1] = 2 * (q0 * q1 - q2 * q3);
    m[2] = 2 * (q0 * q2 + q1 * q3);
    m[3] = 2 * (q0 * q1 + q2 * q3);
    m[4] = 1 - 2 * (q0 * q0 + q2 * q2);
    m[5] = 2 * (q1 * q2 - q0 * q3);
    m[6] = 2 * (q0 * q2 - q1 * q3);
    m[7] = 2 * (q1 * q2 + q0 * q3);
    m[8] = 1 - 2 * (q0 * q0 + q1 * q1);
}

/* p = c + m * p: shapes that are made around the origin are turned and put in place. */
SHAPE_FN void shape_place(shape *s, const double m[9], double x, double y, double z) {
    size_t i;
    for (i = 0; i < s->vertices; i++) {
        double a = (double)s->p[3 * i], b = (double)s->p[3 * i + 1], c = (double)s->p[3 * i + 2];
        s->p[3 * i] = (float)(x + m[0] * a + m[1] * b + m[2] * c);
        s->p[3 * i + 1] = (float)(y + m[3] * a + m[4] * b + m[5] * c);
        s->p[3 * i + 2] = (float)(z + m[6] * a + m[7] * b + m[8] * c);
        a = (double)s->normal[3 * i], b = (double)s->normal[3 * i + 1], c = (double)s->normal[3 * i + 2];
        shape_set_normal(s, (uint32_t)i, m[0] * a + m[1] * b + m[2] * c, m[3] * a + m[4] * b + m[5] * c,
                         m[6] * a + m[7] * b + m[8] * c);
    }
}

#endif /* SHAPES_H_INCLUDED */
