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

/* A scene with four meshes: a torus, a soup, a flat patch, a box, two-sided as bits 0 to 3 of `two_sided` say; all of
   them in a hidden list `lib`, the first three drawn where they are as well. */
SHAPE_FN zbufrand_scene *mixed_meshes(test_rng *r, shape s[4], uint32_t around, uint32_t triangles, uint32_t two_sided, zbufrand_node *lib,
                                      zbufrand_node node[4]) {
    zbufrand_scene *scene = NULL;
    uint32_t i, k;
    memset(s, 0, 4 * sizeof *s);
    shape_torus(&s[0], 0, 0, 0, 1, 0.4, around, around / 2);
    soup(&s[1], r, triangles, 0.05, 1.5);
    for (i = 0; i < 20; i++) {
        for (k = 0; k < 20; k++) {
            uint32_t a = shape_vertex(&s[2], i * 0.1, k * 0.1, 0.01 * i), b = shape_vertex(&s[2], i * 0.1 + 0.1, k * 0.1, 0.01 * i + 0.01);
            uint32_t c = shape_vertex(&s[2], i * 0.1, k * 0.1 + 0.1, 0.01 * i);
            shape_triangle(&s[2], a, b, c);
        }
    }
    shape_box(&s[3], -0.5, -0.5, -0.5, 0.5, 0.5, 0.5);
    if (zbufrand_scene_create(NULL, &scene) != ZBUFRAND_OK) abort();
    CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, lib), ZBUFRAND_OK);
    for (i = 0; i < 4; i++) {
        zbufrand_mesh m = mesh_of(&s[i]);
        m.two_sided = two_sided >> i & 1u;
        CHECK_EQ_U64(zbufrand_add_mesh(scene, *lib, NULL, 0, &m, &node[i]), ZBUFRAND_OK);
        if (i != 3) CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, NULL, 0, &m, NULL), ZBUFRAND_OK);
    }
    return scene;
}
SHAPE_FN void free_shapes(shape s[4]) {
    int i;
    for (i = 0; i < 4; i++) shape_free(&s[i]);
}

#endif
