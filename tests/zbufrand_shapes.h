/* zbufrand_shapes.h - what the tests of zbufrand.h build their scenes from; include zbufrand.h first
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef ZBUFRAND_SHAPES_H_INCLUDED
#define ZBUFRAND_SHAPES_H_INCLUDED
#ifndef ZBUFRAND_H_INCLUDED
#  error "include zbufrand.h first"
#endif
#include "shapes.h"
#include "test.h"

SHAPE_FN zbufrand_mesh mesh_of(const shape *s) {
    zbufrand_mesh m;
    memset(&m, 0, sizeof m);
    m.positions = s->p;
    m.vertex_count = s->vertices;
    m.indices = s->t;
    m.triangle_count = s->triangles;
    return m;
}

SHAPE_FN void soup(shape *s, test_rng *r, uint32_t n, double size, double spread) {
    uint32_t i;
    for (i = 0; i < n; i++) {
        double c[3], e = size * exp(spread * (2 * test_rng_double(r) - 1));
        uint32_t v[3], k, a;
        for (a = 0; a < 3; a++) c[a] = test_rng_double(r);
        for (k = 0; k < 3; k++) {
            v[k] = shape_vertex(s, c[0] + e * (test_rng_double(r) - 0.5), c[1] + e * (test_rng_double(r) - 0.5), c[2] + e * (test_rng_double(r) - 0.5));
        }
        shape_triangle(s, v[0], v[1], v[2]);
    }
}

SHAPE_FN zbufrand_transform move_scale(double x, double y, double z, double scale) {
    zbufrand_transform t;
    memset(&t, 0, sizeof t);
    t.m[0][0] = t.m[1][1] = t.m[2][2] = scale;
    t.m[0][3] = x;
    t.m[1][3] = y;
    t.m[2][3] = z;
    return t;
}

SHAPE_FN void random_transform(test_rng *r, double scale, int mirror, zbufrand_transform *t) {
    double q[9];
    uint32_t a, b;
    shape_rotation(test_rng_double(r), test_rng_double(r), test_rng_double(r), q);
    for (a = 0; a < 3; a++) {
        for (b = 0; b < 3; b++) t->m[a][b] = q[3 * a + b] * scale * (mirror ? -1 : 1);
        t->m[a][3] = 4 * test_rng_double(r) - 2;
    }
}

#endif
