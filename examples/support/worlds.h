/* worlds.h - large scenes made by formulas and instances, for zbufrand.h
   SPDX-License-Identifier: MIT OR Unlicense

   Include zbufrand.h first.

   | name      | triangles       | stored  | what                                                                        |
   | --------- | --------------- | ------- | --------------------------------------------------------------------------- |
   | forest    | 678,905,000,000 |  62,153 | 10^6 tiles in three levels of 10 x 10; a tile has 11 trees of 3 models and  |
   |           |                 |         | a bush, a ground, and 1,152 clumps of grass of 8 models                     |
   | city      |   3,434,780,000 | 343,478 | 10^4 tiles in two levels of 10 x 10: houses, towers, streets, cars, trees   |
   | chess     |       3,276,800 |      -  | board of 1280 x 1280 fields                                                 |
   | landscape |         131,072 |      -  | fractal mountains, a lake with ripples                                      |

   The numbers are those of the scenes that the thesis measured; what they look like is ours: it gives no coordinates. */
#ifndef SUP_WORLDS_H
#define SUP_WORLDS_H

#ifndef ZBUFRAND_H_INCLUDED
#error "include zbufrand.h first"
#endif

#include "scenes.h"

#define SUP_WORLD_NAMES "forest|city|chess|landscape"

typedef struct sup_world_view {
    float eye[3], at[3], fov;
} sup_world_view;

enum { SUP_WORLD_MESHES = 32, SUP_WORLD_ARRAYS = 16, SUP_WORLD_VIEWS = 4 };

/* A scene with what it borrows while it is built. sup_world_free frees the scene, too. */
typedef struct sup_world {
    zbufrand_scene *scene;
    sup_mesh meshes[SUP_WORLD_MESHES];
    size_t mesh_count;
    zbufrand_transform *arrays[SUP_WORLD_ARRAYS];
    size_t array_count;
    sup_world_view views[SUP_WORLD_VIEWS]; /* views[0] is the overview */
    size_t view_count;
    int failed; /* 1: out of memory, 2: the library refused */
} sup_world;

SUP_FN void sup_world_free(sup_world *world) {
    size_t i;
    zbufrand_scene_destroy(world->scene);
    for (i = 0; i < world->mesh_count; i++) sup_mesh_free(&world->meshes[i]);
    for (i = 0; i < world->array_count; i++) SUP_FREE(world->arrays[i]);
    memset(world, 0, sizeof *world);
}

/* ---- putting scenes together -------------------------------------------------------------------------------- */

/* Give a finished mesh to the scene. Returns its node, 0 on failure. */
SUP_FN zbufrand_node supi_world_mesh(sup_world *w, supi_make *make, zbufrand_node parent, int two_sided, uint32_t material,
                                     uint32_t flags) {
    zbufrand_mesh mesh;
    zbufrand_node node = 0;
    sup_mesh *m;
    if (make->failed || w->mesh_count == SUP_WORLD_MESHES) {
        sup_mesh_free(&make->mesh);
        w->failed = 1;
        return 0;
    }
    m = &w->meshes[w->mesh_count++];
    *m = make->mesh;
    memset(make, 0, sizeof *make);
    memset(&mesh, 0, sizeof mesh);
    mesh.positions = m->positions;
    mesh.vertex_count = m->vertex_count;
    mesh.indices = m->indices;
    mesh.triangle_count = m->triangle_count;
    mesh.normals = m->normals;
    mesh.vertex_rgb = m->vertex_rgb;
    mesh.triangle_rgb = m->triangle_rgb;
    mesh.two_sided = (uint32_t)two_sided;
    mesh.material = material;
    if (!w->failed && zbufrand_add_mesh(w->scene, parent, NULL, flags, &mesh, &node) != ZBUFRAND_OK) w->failed = 2;
    return node;
}

SUP_FN zbufrand_node supi_world_list(sup_world *w, zbufrand_node parent, uint32_t flags) {
    zbufrand_node node = 0;
    if (!w->failed && zbufrand_add_list(w->scene, parent, NULL, flags, &node) != ZBUFRAND_OK) w->failed = 2;
    return node;
}

/* Turn by `angle` about y, scale, then move. */
SUP_FN zbufrand_transform supi_world_place(double x, double y, double z, double angle, double scale) {
    zbufrand_transform t;
    const double c = scale * cos(angle), s = scale * sin(angle);
    memset(&t, 0, sizeof t);
    t.m[0][0] = c;
    t.m[0][2] = s;
    t.m[0][3] = x;
    t.m[1][1] = scale;
    t.m[1][3] = y;
    t.m[2][0] = -s;
    t.m[2][2] = c;
    t.m[2][3] = z;
    return t;
}

SUP_FN zbufrand_transform *supi_world_array(sup_world *w, size_t count) {
    zbufrand_transform *t = w->array_count < SUP_WORLD_ARRAYS
                                ? (zbufrand_transform *)sup_alloc(count, sizeof(zbufrand_transform)) : NULL;
    if (t) w->arrays[w->array_count++] = t;
    else w->failed = 1;
    return t;
}

/* A list with n x n references to `target`, `step` apart, about the origin. */
SUP_FN zbufrand_node supi_world_grid(sup_world *w, zbufrand_node parent, uint32_t flags, zbufrand_node target, int n,
                                     double step, double scale) {
    zbufrand_node list = supi_world_list(w, parent, flags);
    zbufrand_transform *t = supi_world_array(w, (size_t)n * (size_t)n);
    int i, j;
    if (w->failed) return 0;
    for (j = 0; j < n; j++)
        for (i = 0; i < n; i++)
            t[j * n + i] = supi_world_place(((double)i - 0.5 * (double)(n - 1)) * step, 0.0,
                                            ((double)j - 0.5 * (double)(n - 1)) * step, 0.0, scale);
    if (zbufrand_add_references(w->scene, list, t, (size_t)n * (size_t)n, target, NULL) != ZBUFRAND_OK) w->failed = 2;
    return list;
}

SUP_FN void supi_world_view(sup_world *w, float ex, float ey, float ez, float ax, float ay, float az, float fov) {
    sup_world_view *v = &w->views[w->view_count++];
    v->eye[0] = ex;
    v->eye[1] = ey;
    v->eye[2] = ez;
    v->at[0] = ax;
    v->at[1] = ay;
    v->at[2] = az;
    v->fov = fov;
}

SUP_FN void supi_add3(float *out, const float *a, const float *d, float s) {
    size_t k;
    for (k = 0; k < 3; k++) out[k] = a[k] + s * d[k];
}

/* Any two directions at right angles to d and to each other. */
SUP_FN void supi_frame3(const float *d, float *u, float *v) {
    const float x[3] = {1.0f, 0.0f, 0.0f}, y[3] = {0.0f, 1.0f, 0.0f};
    supi_cross3f(d, fabsf(d[1]) > 0.9f ? x : y, u);
    supi_unit3f(u);
    supi_cross3f(d, u, v);
}

/* ---- forest ------------------------------------------------------------------------------------------------- */

enum { SUPI_TREE_SIDES = 6 };

/* A tapering tube of `segments` pieces that bends up a little; ends in a point. `path` receives segments + 1 points. */
SUP_FN void supi_make_branch(supi_make *make, supi_rng *rng, const float *from, const float *along, float length,
                             float radius, int segments, float (*path)[3]) {
    float p[3], d[3], u[3], v[3];
    uint32_t ring[SUPI_TREE_SIDES] = {0}, next[SUPI_TREE_SIDES] = {0};
    int s, k;
    memcpy(p, from, sizeof p);
    memcpy(d, along, sizeof d);
    supi_unit3f(d);
    for (s = 0; s <= segments; s++) {
        const float r = radius * (1.0f - 0.85f * (float)s / (float)segments);
        memcpy(path[s], p, sizeof p);
        supi_frame3(d, u, v);
        if (s == segments) {
            const uint32_t tip = supi_make_point(make, p[0], p[1], p[2]);
            for (k = 0; k < SUPI_TREE_SIDES; k++)
                supi_make_triangle(make, ring[k], ring[(k + 1) % SUPI_TREE_SIDES], tip);
            break;
        }
        for (k = 0; k < SUPI_TREE_SIDES; k++) {
            const float a = 2.0f * SUPI_PI * (float)k / (float)SUPI_TREE_SIDES;
            float q[3];
            supi_add3(q, p, u, r * cosf(a));
            supi_add3(q, q, v, r * sinf(a));
            next[k] = supi_make_point(make, q[0], q[1], q[2]);
        }
        for (k = 0; s > 0 && k < SUPI_TREE_SIDES; k++)
            supi_make_quad(make, ring[k], ring[(k + 1) % SUPI_TREE_SIDES], next[(k + 1) % SUPI_TREE_SIDES], next[k]);
        memcpy(ring, next, sizeof ring);
        supi_add3(p, p, d, length / (float)segments);
        for (k = 0; k < 3; k++) d[k] += 0.22f * (supi_random(rng) - 0.5f);
        d[1] += 0.06f;
        supi_unit3f(d);
    }
}

/* A leaf of one or two triangles; its normals lean outward from the crown, as a canopy looks from afar. */
SUP_FN void supi_make_leaf(supi_make *make, supi_rng *rng, const float *at, const float *centre, float size,
                           int triangles) {
    float u[3], v[3], normal[3], corner[4][3];
    uint32_t number[4];
    int k;
    for (k = 0; k < 3; k++) {
        u[k] = supi_random(rng) - 0.5f;
        v[k] = supi_random(rng) - 0.5f;
        normal[k] = at[k] - centre[k];
    }
    v[1] *= 0.4f;
    u[1] *= 0.4f;
    supi_unit3f(u);
    supi_unit3f(v);
    supi_unit3f(normal);
    normal[1] += 0.7f;
    for (k = 0; k < 3; k++) normal[k] += 0.5f * (supi_random(rng) - 0.5f);
    supi_unit3f(normal);
    memcpy(corner[0], at, sizeof corner[0]);
    supi_add3(corner[1], at, u, size);
    supi_add3(corner[2], corner[1], v, size);
    supi_add3(corner[3], at, v, size);
    for (k = 0; k < (triangles == 2 ? 4 : 3); k++) number[k] = supi_make_vertex(make, corner[k], normal, NULL);
    supi_make_triangle(make, number[0], number[1], number[2]);
    if (triangles == 2) supi_make_triangle(make, number[0], number[2], number[3]);
}

/* A tree with exactly `triangles` triangles, as a hidden list of its wood and its leaves. */
SUP_FN zbufrand_node supi_world_tree(sup_world *w, uint32_t seed, float height, float spread, int boughs, int twigs,
                                     const int leaf[3], size_t triangles) {
    enum { TIPS = 1024 };
    supi_make wood, leaves;
    supi_rng rng;
    zbufrand_node list;
    float trunk[12][3], path[8][3], fine[8][3], (*tips)[3];
    const float up[3] = {0.02f, 1.0f, 0.01f}, origin[3] = {0.0f, 0.0f, 0.0f};
    float centre[3] = {0.0f, 0.0f, 0.0f};
    size_t count = 0, k;
    int i, j;
    memset(&wood, 0, sizeof wood);
    memset(&leaves, 0, sizeof leaves);
    rng.state = seed * UINT64_C(0x9E3779B97F4A7C15) + 1;
    tips = (float (*)[3])sup_alloc(TIPS, sizeof *tips);
    if (!tips) {
        w->failed = 1;
        return 0;
    }
    supi_make_colour(&wood, 92, 74, 54);
    supi_make_branch(&wood, &rng, origin, up, height * 0.82f, height * 0.028f, 10, trunk);
    for (i = 0; i < boughs; i++) {
        const int at = 3 + i * 7 / boughs;
        const float a = 2.4f * (float)i + supi_random(&rng), reach = spread * (1.15f - 0.09f * (float)at);
        const float d[3] = {cosf(a), 0.35f + 0.3f * supi_random(&rng), sinf(a)};
        supi_make_branch(&wood, &rng, trunk[at], d, reach, height * 0.010f, 5, path);
        for (j = 0; j < twigs; j++) {
            const int from = 1 + j * 4 / twigs;
            float e[3];
            for (k = 0; k < 3; k++) e[k] = d[k] + 1.8f * (supi_random(&rng) - 0.5f);
            supi_make_branch(&wood, &rng, path[from], e, reach * 0.42f, height * 0.004f, 3, fine);
            for (k = 1; k <= 3 && count < TIPS; k++) memcpy(tips[count++], fine[k], sizeof tips[0]);
        }
        for (k = 3; k <= 5 && count < TIPS; k++) memcpy(tips[count++], path[k], sizeof tips[0]);
    }
    centre[1] = height * 0.5f;
    while (!leaves.failed && wood.mesh.triangle_count + leaves.mesh.triangle_count < triangles) {
        const size_t left = triangles - wood.mesh.triangle_count - leaves.mesh.triangle_count;
        const float *tip = tips[(size_t)(supi_random(&rng) * (float)count)];
        const int light = (int)(40.0f * supi_random(&rng));
        float p[3];
        for (k = 0; k < 3; k++) p[k] = tip[k] + spread * 0.2f * (supi_random(&rng) + supi_random(&rng) - 1.0f);
        supi_make_colour(&leaves, leaf[0] + light, leaf[1] + light, leaf[2] + light / 2);
        supi_make_leaf(&leaves, &rng, p, centre, height * 0.016f + height * 0.012f * supi_random(&rng),
                       left >= 2 ? 2 : 1);
    }
    SUP_FREE(tips);
    list = supi_world_list(w, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    (void)supi_world_mesh(w, &wood, list, 0, 0, 0);
    (void)supi_world_mesh(w, &leaves, list, 1, 0, 0);
    return list;
}

SUP_FN float supi_forest_height(float x, float z) { /* repeats every 16 */
    const float f = 2.0f * SUPI_PI / 16.0f;
    return 0.35f * sinf(f * x) * cosf(f * z) + 0.12f * sinf(2.0f * f * x + 1.0f) + 0.1f * cosf(3.0f * f * z) +
           0.05f * sinf(5.0f * f * x) * sinf(4.0f * f * z);
}

SUP_FN zbufrand_node supi_world_ground(sup_world *w, zbufrand_node parent) { /* 128 x 128 fields of two triangles */
    supi_make make;
    uint32_t i, j;
    memset(&make, 0, sizeof make);
    for (j = 0; j <= 128; j++)
        for (i = 0; i <= 128; i++) {
            const float x = 0.125f * (float)i - 8.0f, z = 0.125f * (float)j - 8.0f;
            (void)supi_make_point(&make, x, supi_forest_height(x, z), z);
        }
    for (j = 0; j < 128; j++)
        for (i = 0; i < 128; i++) {
            const uint32_t a = j * 129 + i;
            const int shade = (int)(supi_unit_float(supi_hash32(a * 2u + 1u)) * 34.0f);
            supi_make_colour(&make, 72 + shade, 66 + shade, 40 + shade / 2);
            supi_make_quad(&make, a, a + 129, a + 130, a + 1);
        }
    return supi_world_mesh(w, &make, parent, 0, 0, 0);
}

SUP_FN zbufrand_node supi_world_grass(sup_world *w, uint32_t seed, int blades) { /* two triangles a blade */
    supi_make make;
    supi_rng rng;
    int i, k;
    memset(&make, 0, sizeof make);
    rng.state = seed * UINT64_C(0x9E3779B97F4A7C15) + 77;
    for (i = 0; i < blades; i++) {
        const float a = 2.0f * SUPI_PI * supi_random(&rng), r = 0.34f * sqrtf(supi_random(&rng));
        const float t = 2.0f * SUPI_PI * supi_random(&rng), h = 0.12f + 0.16f * supi_random(&rng);
        const float x = r * cosf(a), z = r * sinf(a), wx = 0.009f * cosf(t), wz = 0.009f * sinf(t);
        const float lx = 0.35f * h * sinf(t), lz = -0.35f * h * cosf(t);
        const float normal[3] = {0.25f * lx / h, 0.97f, 0.25f * lz / h};
        const int light = (int)(46.0f * supi_random(&rng));
        float p[4][3];
        uint32_t v[4];
        p[0][0] = x - wx; p[0][1] = -0.03f; p[0][2] = z - wz;
        p[1][0] = x + wx; p[1][1] = -0.03f; p[1][2] = z + wz;
        p[2][0] = x + 0.5f * lx + wx; p[2][1] = 0.6f * h; p[2][2] = z + 0.5f * lz + wz;
        p[3][0] = x + lx; p[3][1] = h; p[3][2] = z + lz;
        for (k = 0; k < 4; k++) v[k] = supi_make_vertex(&make, p[k], normal, NULL);
        supi_make_colour(&make, 78 + light, 104 + light, 38 + light / 3);
        supi_make_triangle(&make, v[0], v[1], v[2]);
        supi_make_triangle(&make, v[0], v[2], v[3]);
    }
    return supi_world_mesh(w, &make, ZBUFRAND_ROOT, 1, 0, ZBUFRAND_HIDDEN);
}

SUP_FN void supi_world_forest(sup_world *w) {
    /* per tile: 4 * 8542 + 4 * 8000 + 3 * 9003 = 93,177 triangles of trees; 32,768 of ground;
       1,152 * 480 = 552,960 of grass: 678,905 in all */
    static const float trees[11][4] = {{-5.5f, -5.2f, 0.3f, 1.0f}, {-1.2f, -6.1f, 1.9f, 0.85f}, {4.4f, -4.6f, 4.1f, 1.1f},
                                       {6.9f, -0.4f, 2.2f, 0.8f},  {-6.6f, 0.9f, 5.0f, 0.95f},  {-2.5f, -1.3f, 0.9f, 1.15f},
                                       {2.1f, 0.6f, 3.3f, 0.9f},   {5.3f, 4.9f, 1.2f, 1.05f},   {0.4f, 5.6f, 2.8f, 1.0f},
                                       {-4.4f, 5.3f, 5.7f, 0.9f},  {-7.3f, 7.0f, 3.9f, 0.75f}};
    static const int leaf[3][3] = {{52, 84, 30}, {70, 92, 34}, {88, 96, 30}};
    zbufrand_node model[3], grass[8], tile, block, region;
    zbufrand_transform *t;
    supi_rng rng;
    int i, k;
    model[0] = supi_world_tree(w, 11, 6.4f, 2.4f, 16, 5, leaf[0], 8542);
    model[1] = supi_world_tree(w, 12, 5.2f, 2.1f, 14, 5, leaf[1], 8000);
    model[2] = supi_world_tree(w, 13, 7.4f, 2.2f, 18, 4, leaf[2], 9003);
    for (i = 0; i < 8; i++) grass[i] = supi_world_grass(w, 20u + (uint32_t)i, 240);
    tile = supi_world_list(w, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN);
    (void)supi_world_ground(w, tile);
    for (k = 0; k < 3; k++) {
        const int first = k == 0 ? 0 : k == 1 ? 4 : 8, count = k == 2 ? 3 : 4;
        t = supi_world_array(w, (size_t)count);
        for (i = 0; i < count && t; i++) {
            const float *p = trees[first + i];
            t[i] = supi_world_place((double)p[0], (double)supi_forest_height(p[0], p[1]) - 0.1, (double)p[1],
                                    (double)p[2], (double)p[3]);
        }
        if (!w->failed && zbufrand_add_references(w->scene, tile, t, (size_t)count, model[k], NULL) != ZBUFRAND_OK)
            w->failed = 2;
    }
    rng.state = 4711;
    for (k = 0; k < 8; k++) { /* 144 clumps of each model, one in each cell of 34 x 34 but four */
        t = supi_world_array(w, 144);
        for (i = 0; i < 144 && t; i++) {
            const int cell = 8 * i + k;
            const float x = 16.0f * ((float)(cell % 34) + supi_random(&rng)) / 34.0f - 8.0f;
            const float z = 16.0f * ((float)(cell / 34) + supi_random(&rng)) / 34.0f - 8.0f;
            t[i] = supi_world_place((double)x, (double)supi_forest_height(x, z), (double)z,
                                    6.2831853 * (double)supi_random(&rng), 0.8 + 0.5 * (double)supi_random(&rng));
        }
        if (!w->failed && zbufrand_add_references(w->scene, tile, t, 144, grass[k], NULL) != ZBUFRAND_OK) w->failed = 2;
    }
    block = supi_world_grid(w, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN, tile, 10, 16.0, 1.0);
    region = supi_world_grid(w, ZBUFRAND_ROOT, ZBUFRAND_HIDDEN, block, 10, 160.0, 1.0);
    (void)supi_world_grid(w, ZBUFRAND_ROOT, 0, region, 10, 1600.0, 1.0);
    supi_world_view(w, 0.0f, 900.0f, 8600.0f, 0.0f, 0.0f, 3500.0f, 45.0f); /* all of it */
    supi_world_view(w, 3.0f, 17.0f, 40.0f, 0.0f, 3.0f, 0.0f, 45.0f);      /* over the crowns */
    supi_world_view(w, 8.0f, 2.0f, 15.6f, 2.0f, 2.4f, 0.0f, 50.0f);       /* among the trees */
    supi_world_view(w, 0.6f, 0.7f, 3.4f, -0.6f, 0.45f, -2.0f, 50.0f);     /* in the grass */
}

/* ---- city --------------------------------------------------------------------------------------------------- */

SUP_FN void supi_city_box(supi_make *make, float x0, float y0, float z0, float x1, float y1, float z1) {
    const float lo[3] = {x0, y0, z0}, hi[3] = {x1, y1, z1};
    supi_make_box(make, lo, hi, 0);
}

/* Windows on the four walls of a box, a millimetre before them: the decals that samples like to mix up. */
SUP_FN void supi_city_windows(supi_make *make, supi_rng *rng, float x0, float z0, float x1, float z1, float base,
                              float storey, int storeys, int across) {
    const float gap = 0.05f; /* 1/2000 of a tile */
    int side, s, k;
    for (side = 0; side < 4; side++)
        for (s = 0; s < storeys; s++)
            for (k = 0; k < across; k++) {
                const float u0 = ((float)k + 0.22f) / (float)across, u1 = ((float)k + 0.78f) / (float)across;
                const float y0 = base + storey * ((float)s + 0.3f), y1 = base + storey * ((float)s + 0.8f);
                const int lit = supi_random(rng) < 0.12f;
                float a[3], b[3], c[3], d[3];
                a[1] = b[1] = y0;
                c[1] = d[1] = y1;
                if (side < 2) {
                    const float z = side == 0 ? z1 + gap : z0 - gap;
                    const float p = side == 0 ? x0 + (x1 - x0) * u0 : x0 + (x1 - x0) * u1;
                    const float q = side == 0 ? x0 + (x1 - x0) * u1 : x0 + (x1 - x0) * u0;
                    a[0] = d[0] = p;
                    b[0] = c[0] = q;
                    a[2] = b[2] = c[2] = d[2] = z;
                } else {
                    const float x = side == 2 ? x1 + gap : x0 - gap;
                    const float p = side == 2 ? z0 + (z1 - z0) * u1 : z0 + (z1 - z0) * u0;
                    const float q = side == 2 ? z0 + (z1 - z0) * u0 : z0 + (z1 - z0) * u1;
                    a[2] = d[2] = p;
                    b[2] = c[2] = q;
                    a[0] = b[0] = c[0] = d[0] = x;
                }
                if (lit) supi_make_colour(make, 214, 190, 120);
                else supi_make_colour(make, 52, 66, 84);
                supi_make_patch(make, a, b, c, d);
            }
}

SUP_FN void supi_city_house(supi_make *make, supi_rng *rng, float x, float z, float w, float d) {
    static const uint8_t walls[5][3] = {{226, 220, 206}, {208, 188, 160}, {190, 176, 168}, {222, 206, 170}, {176, 142, 120}};
    const uint8_t *wall = walls[(int)(supi_random(rng) * 4.99f)];
    const int storeys = 2 + (int)(2.9f * supi_random(rng));
    const float h = 3.0f * (float)storeys, ridge = h + 0.45f * d, over = 0.5f;
    uint32_t v[6];
    supi_make_colour(make, wall[0], wall[1], wall[2]);
    supi_city_box(make, x, 0.0f, z, x + w, h, z + d);
    v[0] = supi_make_point(make, x, h, z + 0.01f);
    v[1] = supi_make_point(make, x, h, z + d - 0.01f);
    v[2] = supi_make_point(make, x, ridge, z + 0.5f * d);
    v[3] = supi_make_point(make, x + w, h, z + 0.01f);
    v[4] = supi_make_point(make, x + w, h, z + d - 0.01f);
    v[5] = supi_make_point(make, x + w, ridge, z + 0.5f * d);
    supi_make_triangle(make, v[0], v[1], v[2]);
    supi_make_triangle(make, v[3], v[5], v[4]);
    supi_make_colour(make, 150, 62, 46);
    {
        const float a[3] = {x - over, h - over * 0.9f, z + d + over}, b[3] = {x + w + over, h - over * 0.9f, z + d + over};
        const float c[3] = {x + w + over, ridge, z + 0.5f * d}, e[3] = {x - over, ridge, z + 0.5f * d};
        const float f[3] = {x + w + over, h - over * 0.9f, z - over}, g[3] = {x - over, h - over * 0.9f, z - over};
        supi_make_patch(make, a, b, c, e);
        supi_make_patch(make, f, g, e, c);
    }
    supi_city_windows(make, rng, x, z, x + w, z + d, 0.0f, 3.0f, storeys, 4);
}

SUP_FN void supi_city_tower(supi_make *make, supi_rng *rng, float x, float z, float w, float d) {
    const int storeys = 12 + (int)(22.0f * supi_random(rng));
    const float h = 3.4f * (float)storeys;
    const int light = (int)(50.0f * supi_random(rng));
    int k;
    supi_make_colour(make, 150 + light, 154 + light, 160 + light);
    supi_city_box(make, x, 0.0f, z, x + w, h, z + d);
    supi_make_colour(make, 110, 112, 116);
    for (k = 0; k <= 12; k++) { /* thin columns in front of the walls */
        const float u = (float)k / 12.0f, px = x + u * (w - 0.3f), pz = z + u * (d - 0.3f);
        supi_city_box(make, px, 0.0f, z - 0.3f, px + 0.3f, h + 1.0f, z);
        supi_city_box(make, px, 0.0f, z + d, px + 0.3f, h + 1.0f, z + d + 0.3f);
        supi_city_box(make, x - 0.3f, 0.0f, pz, x, h + 1.0f, pz + 0.3f);
        supi_city_box(make, x + w, 0.0f, pz, x + w + 0.3f, h + 1.0f, pz + 0.3f);
    }
    supi_city_windows(make, rng, x, z, x + w, z + d, 0.0f, 3.4f, storeys, 12);
}

SUP_FN void supi_city_car(supi_make *make, supi_rng *rng, float x, float z, int along_x) {
    const int paint = (int)(supi_random(rng) * 3.99f);
    const float l = along_x ? 4.2f : 1.7f, d = along_x ? 1.7f : 4.2f;
    supi_make_colour(make, paint == 0 ? 170 : 40 + 40 * paint, paint == 1 ? 60 : 50, paint == 2 ? 160 : 60);
    supi_city_box(make, x, 0.35f, z, x + l, 0.95f, z + d);
    supi_make_colour(make, 60, 70, 80);
    supi_city_box(make, x + 0.2f * l, 0.95f, z + 0.2f * d, x + 0.75f * l, 1.5f, z + 0.75f * d);
}

/* Trunk of a box and two crossed cones of leaves. 12 + 2 * 2 * sides triangles. */
SUP_FN void supi_city_tree(supi_make *make, supi_rng *rng, float x, float z) {
    const float h = 4.0f + 3.0f * supi_random(rng), r = 0.3f * h;
    const int light = (int)(40.0f * supi_random(rng));
    uint32_t ring[12], top, bottom, k;
    int layer;
    supi_make_colour(make, 90, 70, 50);
    supi_city_box(make, x - 0.12f, 0.0f, z - 0.12f, x + 0.12f, 0.45f * h, z + 0.12f);
    supi_make_colour(make, 50 + light, 92 + light, 40 + light / 2);
    for (layer = 0; layer < 2; layer++) {
        const float y = h * (0.3f + 0.28f * (float)layer), s = r * (1.0f - 0.3f * (float)layer);
        for (k = 0; k < 12; k++) {
            const float a = 2.0f * SUPI_PI * (float)k / 12.0f, q = s * (0.85f + 0.3f * supi_random(rng));
            ring[k] = supi_make_point(make, x + q * cosf(a), y + 0.2f * supi_random(rng), z + q * sinf(a));
        }
        top = supi_make_point(make, x, y + 0.48f * h, z);
        bottom = supi_make_point(make, x, y - 0.05f * h, z);
        for (k = 0; k < 12; k++) {
            supi_make_triangle(make, ring[(k + 1) % 12], ring[k], top);
            supi_make_triangle(make, ring[k], ring[(k + 1) % 12], bottom);
        }
    }
}

/* One tile of 100 x 100 with exactly `triangles` triangles: streets around 3 x 3 blocks of four lots each. */
SUP_FN void supi_make_city(supi_make *make, size_t triangles, int towers) {
    supi_rng rng;
    int bx, bz, i, lot;
    rng.state = 815;
    supi_make_colour(make, 96, 110, 72);
    {
        const float a[3] = {-50.0f, 0.0f, 50.0f}, b[3] = {50.0f, 0.0f, 50.0f}, c[3] = {50.0f, 0.0f, -50.0f};
        const float d[3] = {-50.0f, 0.0f, -50.0f};
        supi_make_patch(make, a, b, c, d);
    }
    for (i = 0; i < 4; i++) { /* streets, and white dashes on them: decals again */
        const float s = -46.665f + 33.333f * (float)(i < 3 ? i : 0);
        int k;
        if (i == 3) break;
        supi_make_colour(make, 62, 62, 66);
        {
            const float a[3] = {s - 3.3f, 0.04f, 50.0f}, b[3] = {s + 3.3f, 0.04f, 50.0f};
            const float c[3] = {s + 3.3f, 0.04f, -50.0f}, d[3] = {s - 3.3f, 0.04f, -50.0f};
            const float e[3] = {-50.0f, 0.05f, s + 3.3f}, f[3] = {50.0f, 0.05f, s + 3.3f};
            const float g[3] = {50.0f, 0.05f, s - 3.3f}, h[3] = {-50.0f, 0.05f, s - 3.3f};
            supi_make_patch(make, a, b, c, d);
            supi_make_patch(make, e, f, g, h);
        }
        supi_make_colour(make, 215, 215, 210);
        for (k = 0; k < 25; k++) {
            const float u = -49.0f + 4.0f * (float)k;
            const float a[3] = {s - 0.12f, 0.1f, u + 2.0f}, b[3] = {s + 0.12f, 0.1f, u + 2.0f};
            const float c[3] = {s + 0.12f, 0.1f, u}, d[3] = {s - 0.12f, 0.1f, u};
            const float e[3] = {u, 0.1f, s + 0.12f}, f[3] = {u + 2.0f, 0.1f, s + 0.12f};
            const float g[3] = {u + 2.0f, 0.1f, s - 0.12f}, h[3] = {u, 0.1f, s - 0.12f};
            supi_make_patch(make, a, b, c, d);
            supi_make_patch(make, e, f, g, h);
        }
        for (k = 0; k < 10; k++) {
            supi_city_car(make, &rng, s + (k & 1 ? 0.9f : -2.6f), -48.0f + 9.7f * (float)k + supi_random(&rng), 0);
            supi_city_car(make, &rng, -48.0f + 9.7f * (float)k + supi_random(&rng), s + (k & 1 ? 0.9f : -2.6f), 1);
        }
    }
    for (bz = 0; bz < 3; bz++)
        for (bx = 0; bx < 3; bx++)
            for (lot = 0; lot < 4; lot++) {
                const float x = -42.6f + 33.333f * (float)bx + 12.8f * (float)(lot & 1);
                const float z = -42.6f + 33.333f * (float)bz + 12.8f * (float)(lot >> 1);
                if (towers && (bx * 7 + bz * 5 + lot) % 3 == 0) supi_city_tower(make, &rng, x + 1.5f, z + 1.5f, 9.5f, 9.5f);
                else supi_city_house(make, &rng, x + 1.5f, z + 2.0f, 9.0f, 8.0f);
            }
    while (!make->failed && make->mesh.triangle_count + 60 <= triangles) { /* trees along the streets and in the yards */
        const float u = 96.0f * supi_random(&rng) - 48.0f;
        const float s = -46.665f + 33.333f * (float)(int)(3.0f * supi_random(&rng)) + (supi_random(&rng) < 0.5f ? 4.0f : -4.0f);
        if (supi_random(&rng) < 0.5f) supi_city_tree(make, &rng, u, s + 0.4f * supi_random(&rng));
        else supi_city_tree(make, &rng, s + 0.4f * supi_random(&rng), u);
    }
    while (!make->failed && make->mesh.triangle_count < triangles) { /* what is missing: stones */
        const float x = 90.0f * supi_random(&rng) - 45.0f, z = 90.0f * supi_random(&rng) - 45.0f;
        const uint32_t a = supi_make_point(make, x, 0.12f, z), b = supi_make_point(make, x, 0.12f, z + 0.2f);
        const uint32_t c = supi_make_point(make, x + 0.2f, 0.12f, z);
        supi_make_colour(make, 130, 126, 120);
        supi_make_triangle(make, a, b, c);
    }
}

/* levels 10 x 10 of tiles of `triangles` triangles. */
SUP_FN void supi_world_city(sup_world *w, size_t triangles, int levels) {
    supi_make make;
    zbufrand_node node;
    double step = 100.0;
    memset(&make, 0, sizeof make);
    supi_make_city(&make, triangles, triangles > 100000);
    node = supi_world_mesh(w, &make, ZBUFRAND_ROOT, 0, 0, levels > 0 ? ZBUFRAND_HIDDEN : 0);
    for (; levels > 0; levels--, step *= 10.0)
        node = supi_world_grid(w, ZBUFRAND_ROOT, levels > 1 ? ZBUFRAND_HIDDEN : 0, node, 10, step, 1.0);
    supi_world_view(w, 0.0f, 420.0f, 1500.0f, 0.0f, 0.0f, 500.0f, 45.0f);
    supi_world_view(w, 330.0f, 95.0f, 460.0f, 150.0f, 15.0f, 200.0f, 45.0f);
    supi_world_view(w, 53.3f, 1.8f, 190.0f, 53.0f, 9.0f, 60.0f, 60.0f);
    supi_world_view(w, 20.0f, 60.0f, 130.0f, 60.0f, 10.0f, 20.0f, 50.0f);
}

/* ---- chess, landscape --------------------------------------------------------------------------------------- */

/* fields x fields over [-1, 1]^2; n x n copies of it, scaled by 1/n, `levels` times: 2 * fields^2 * n^(2 levels)
   triangles. */
SUP_FN void supi_world_chess(sup_world *w, int fields, int n, int levels) {
    supi_make make;
    zbufrand_node node;
    int i, j, k;
    memset(&make, 0, sizeof make);
    for (j = 0; j <= fields; j++)
        for (i = 0; i <= fields; i++)
            (void)supi_make_point(&make, 2.0f * (float)i / (float)fields - 1.0f, 0.0f,
                                  2.0f * (float)j / (float)fields - 1.0f);
    for (j = 0; j < fields; j++)
        for (i = 0; i < fields; i++) {
            const uint32_t a = (uint32_t)(j * (fields + 1) + i), m = (uint32_t)fields + 1;
            if ((i + j) & 1) supi_make_colour(&make, 20, 20, 20);
            else supi_make_colour(&make, 240, 240, 240);
            supi_make_quad(&make, a, a + m, a + m + 1, a + 1);
        }
    node = supi_world_mesh(w, &make, ZBUFRAND_ROOT, 0, 0, levels > 0 ? ZBUFRAND_HIDDEN : 0);
    for (k = 0; k < levels; k++)
        node = supi_world_grid(w, ZBUFRAND_ROOT, k + 1 < levels ? ZBUFRAND_HIDDEN : 0, node, n, 2.0 / (double)n,
                               1.0 / (double)n);
    supi_world_view(w, 0.0f, 0.02f, 1.05f, 0.0f, -0.05f, 0.8f, 45.0f);
    supi_world_view(w, 0.0f, 3.0f, 6.0f, 0.0f, 0.0f, 0.0f, 45.0f);
}

/* Ripples by a wind that comes from one side, more or less. */
SUP_FN float supi_ripples(float x, float z) {
    static const float wave[5][3] = {{92, 31, 0.0011f}, {61, -47, 0.001f}, {118, 74, 0.0006f}, {37, 83, 0.0008f}, {143, -12, 0.0004f}};
    float sum = 0.0f;
    int i;
    for (i = 0; i < 5; i++) sum += wave[i][2] * sinf(wave[i][0] * x + wave[i][1] * z + (float)i);
    return sum;
}

/* 256 x 256 fields: land on one grid, the water is the same grid where the land would lie lower. */
SUP_FN void supi_world_landscape(sup_world *w) {
    supi_make make;
    int i, j;
    uint32_t k;
    memset(&make, 0, sizeof make);
    for (j = 0; j <= 256; j++)
        for (i = 0; i <= 256; i++) {
            float p[3] = {0.0f, 0.0f, 0.0f}, q[2][3], normal[3], h[3];
            uint8_t rgb[3] = {0, 0, 0};
            for (k = 0; k < 3; k++) { /* here, and a step along x and z for the normal */
                const float x = -1.0f + ((float)i + (k == 1 ? 0.5f : 0.0f)) / 128.0f;
                const float z = -1.0f + ((float)j + (k == 2 ? 0.5f : 0.0f)) / 128.0f;
                const float land = 0.75f * supi_fbm(2.3f * x + 5.1f, 3.7f, 2.3f * z + 1.3f, 9);
                const float water = -0.05f + supi_ripples(x, z);
                h[k] = land > water ? land : water;
                if (k == 0) {
                    const float snow = land > 0.16f ? 1.0f : land > 0.1f ? (land - 0.1f) / 0.06f : 0.0f;
                    const float n = supi_noise(40.0f * x, 1.0f, 40.0f * z);
                    rgb[0] = (uint8_t)(land <= water ? 36.0f : 96.0f + 14.0f * n + 130.0f * snow);
                    rgb[1] = (uint8_t)(land <= water ? 74.0f : 104.0f + 16.0f * n + 124.0f * snow);
                    rgb[2] = (uint8_t)(land <= water ? 118.0f : 66.0f + 10.0f * n + 172.0f * snow);
                    p[0] = x;
                    p[2] = z;
                } else {
                    q[k - 1][0] = x;
                    q[k - 1][2] = z;
                }
            }
            p[1] = h[0];
            for (k = 0; k < 2; k++) {
                q[k][1] = h[1 + k];
                supi_add3(q[k], q[k], p, -1.0f);
            }
            supi_cross3f(q[1], q[0], normal);
            supi_unit3f(normal);
            (void)supi_make_vertex(&make, p, normal, rgb);
        }
    for (j = 0; j < 256; j++)
        for (i = 0; i < 256; i++) {
            const uint32_t a = (uint32_t)(j * 257 + i);
            supi_make_quad(&make, a, a + 257, a + 258, a + 1);
        }
    (void)supi_world_mesh(w, &make, ZBUFRAND_ROOT, 1, 1, 0); /* whole from below, too */
    /* above the land, and no near border in sight */
    supi_world_view(w, -0.5f, 0.5f, 0.9f, 0.1f, -0.1f, -0.1f, 45.0f);
    supi_world_view(w, 0.35f, 0.2f, 0.45f, -0.05f, 0.0f, -0.3f, 50.0f);
    supi_world_view(w, 0.3f, 0.48f, 0.95f, 0.02f, -0.08f, -0.1f, 45.0f);
}

/* Make a world by name, one of SUP_WORLD_NAMES, and build it.
   scene  NULL: all defaults
   out    free with sup_world_free; cleared on error
   Returns 0, or 1 with err->text set. */
SUP_FN int sup_world_make(const char *name, const zbufrand_scene_desc *scene, const zbufrand_build_desc *build,
                          sup_world *out, zbufrand_scene_info *info, sup_error *err) {
    zbufrand_result result;
    int known = 1;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    result = zbufrand_scene_create(scene, &out->scene);
    if (result != ZBUFRAND_OK) return sup_fail(err, "%s", zbufrand_result_string(result));
    if (strcmp(name, "forest") == 0) supi_world_forest(out);
    else if (strcmp(name, "city") == 0) supi_world_city(out, 343478, 2);
    else if (strcmp(name, "city-small") == 0) supi_world_city(out, 177315, 1);
    else if (strcmp(name, "city-low") == 0) supi_world_city(out, 18946, 1);
    else if (strcmp(name, "chess") == 0) supi_world_chess(out, 1280, 1, 0);
    else if (strcmp(name, "landscape") == 0) supi_world_landscape(out);
    else known = 0;
    if (known && !out->failed) {
        result = zbufrand_scene_build(out->scene, build, info);
        if (result == ZBUFRAND_OK) return 0;
        sup_world_free(out);
        return sup_fail(err, "%s: %s", name, zbufrand_result_string(result));
    }
    known = known ? out->failed : 0;
    sup_world_free(out);
    return known == 0 ? sup_fail(err, "\"%s\" is none of %s", name, SUP_WORLD_NAMES)
                      : sup_fail(err, known == 1 ? "%s: out of memory" : "%s: a node was refused", name);
}

#endif
