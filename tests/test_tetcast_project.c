/* Projection: the same cells on every ray as a walk, the same bits for any number of threads and any instruction set, the
   same picture as a brute force in doubles; cycles, holes, overlaps, the eye inside; the forms and orders that it is
   compared with. */
#include "test.h"
#include "../bench/baseline/cell_projection.h"
#include "tets.h"

enum { PROJECT_W = 60, PROJECT_H = 44 };

typedef struct scene {
    tets t;
    tetcast_mesh *mesh;
    tetcast_transfer *transfer;
    tetcast_optics *optics;
} scene;

typedef struct project_picture {
    float rgba[PROJECT_H][PROJECT_W][4], depth[PROJECT_H][PROJECT_W], length[PROJECT_H][PROJECT_W];
    uint32_t steps[PROJECT_H][PROJECT_W];
} project_picture;

static project_picture pic[3];

static void scene_optics(scene *s, tetcast_model model, float iso, float strength) {
    static const float points[6][5] = {{0.0f, 1, 0.2f, 0, 0.3f}, {0.3f, 1, 0.8f, 0.1f, 0}, {0.5f, 0, 0, 1, 0},
                                       {0.5f, 0.1f, 0.4f, 1, 0.8f}, {0.6f, 0, 1, 0.3f, 0.1f}, {1, 0.9f, 0.9f, 0.9f, 0.4f}};
    tetcast_control_point p[6];
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_isovalue v;
    uint32_t i;
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    memset(&v, 0, sizeof v);
    for (i = 0; i < 6; i++) {
        p[i].value = points[i][0];
        memcpy(p[i].rgb, points[i] + 1, 12);
        p[i].extinction = points[i][4];
    }
    td.points = p;
    td.point_count = 6;
    td.extinction_scale = strength;
    v.value = iso;
    v.rgb[0] = v.rgb[1] = 0.8f;
    v.rgb[2] = 0.3f;
    v.opacity = 0.5f;
    v.specular = 0.3f;
    if (iso >= 0) {
        td.isovalues = &v;
        td.isovalue_count = 1;
    }
    od.model = model;
    od.t_min = -1.0f;
    tetcast_optics_destroy(s->optics);
    tetcast_transfer_destroy(s->transfer);
    s->optics = NULL;
    s->transfer = NULL;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &s->transfer), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(s->transfer, &od, &s->optics), TETCAST_OK);
}

static void scene_build(scene *s) {
    tetcast_mesh_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.keep_neighbours = 1;
    s->mesh = tets_build_desc(&s->t, &d, NULL);
}

static void scene_free(scene *s) {
    tetcast_optics_destroy(s->optics);
    tetcast_transfer_destroy(s->transfer);
    tetcast_mesh_destroy(s->mesh);
    tets_free(&s->t);
    memset(s, 0, sizeof *s);
}

static int keep_shell(uint32_t x, uint32_t y, uint32_t z) {
    return x < 2 || x > 4 || y < 2 || y > 4 || z < 1 || ((x + y + z) % 5 == 0);
}

enum { LATTICE5, LATTICE6, JITTERED, TANGLED, FLAT, FAR_AWAY, HOLES, SINGLE, RANDOM_SOUP, SCENES };

static void scene_make(scene *s, int kind) {
    static const double flat[3] = {1, 1, 1e-5}, one[3] = {1, 1, 1}, none[3] = {0, 0, 0}, away[3] = {8e3, -8e3, 8e3};
    memset(s, 0, sizeof *s);
    if (kind == SINGLE) {
        tets_vertex(&s->t, 1, 1, 1, 0.1);
        tets_vertex(&s->t, 7, 2, 1, 0.9);
        tets_vertex(&s->t, 2, 7, 1.5, 0.4);
        tets_vertex(&s->t, 3, 3, 7, 0.6);
        tets_tet(&s->t, 0, 1, 2, 3);
    } else if (kind == RANDOM_SOUP) { /* cells that share nothing and overlap */
        test_rng r = test_rng_make(5);
        uint32_t i, k;
        for (i = 0; i < 60; i++) {
            double c[3];
            for (k = 0; k < 3; k++) c[k] = 1 + 5 * test_rng_double(&r);
            for (k = 0; k < 4; k++)
                tets_vertex(&s->t, c[0] + test_rng_double(&r), c[1] + test_rng_double(&r), c[2] + test_rng_double(&r),
                            test_rng_double(&r));
            tets_tet(&s->t, 4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3);
        }
    } else {
        tets_lattice(&s->t, 8, 8, 8, kind == LATTICE6 ? 6 : 5, kind == HOLES ? keep_shell : NULL);
        if (kind == JITTERED || kind == HOLES || kind == FAR_AWAY) tets_jitter(&s->t, 8, 8, 8, 0.5, 3);
        if (kind == TANGLED) tets_jitter(&s->t, 8, 8, 8, 1.3, 3);
        tets_place(&s->t, kind == FLAT ? flat : one, kind == FAR_AWAY ? away : none);
        if (kind == FAR_AWAY) tets_round(&s->t);
    }
    scene_build(s);
    scene_optics(s, TETCAST_MODEL_VOLUME, -1, 0.5f);
}

static int g_no_depth; /* pictures without depths, surfaces and values per cell are added up eight rays at a time */

static tetcast_image image_of(project_picture *p) {
    tetcast_image im;
    memset(&im, 0, sizeof im);
    im.width = PROJECT_W;
    im.height = PROJECT_H;
    im.rgba = p->rgba[0][0];
    im.depth = g_no_depth ? NULL : p->depth[0];
    im.length = p->length[0];
    im.steps = p->steps[0];
    return im;
}

static tetcast_result draw(const tetcast_render_desc *d, tetcast_method method, const scene *s, project_picture *p,
                           tetcast_render_stats *stats) {
    tetcast_image im = image_of(p);
    tetcast_render_desc c = *d;
    c.method = method;
    memset(p, 0xcd, sizeof *p);
    return tetcast_render(&c, s->mesh, s->optics, &im, stats);
}

static void look(tetcast_render_desc *d, double ex, double ey, double ez, double ax, double ay, double az) {
    d->camera.eye[0] = ex;
    d->camera.eye[1] = ey;
    d->camera.eye[2] = ez;
    d->camera.at[0] = ax;
    d->camera.at[1] = ay;
    d->camera.at[2] = az;
}

enum { SLANTED, AXIS, DIAGONAL, VERTEX_ON, PARALLEL, PARALLEL_AXIS, PARALLEL_TILTED, INSIDE, ZOOMED, DISTANT, CLIPPED, VIEWS };

static tetcast_render_desc view_of(int view, const scene *s) {
    tetcast_render_desc d;
    tetcast_mesh_info info;
    double c[3], size;
    int k;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    tetcast_mesh_get_info(s->mesh, &info);
    for (k = 0; k < 3; k++) c[k] = 0.5 * (info.box_min[k] + info.box_max[k]);
    size = info.box_max[0] - info.box_min[0];
    look(&d, c[0] - 1.3 * size, c[1] + 0.9 * size, c[2] + 1.7 * size, c[0], c[1], c[2]);
    d.camera.fov_y = 36;
    if (view == AXIS || view == PARALLEL_AXIS) look(&d, c[0], c[1], c[2] + 3 * size, c[0], c[1], c[2]);
    if (view == DIAGONAL) look(&d, c[0] + 2 * size, c[1] + 2 * size, c[2] + 2 * size, c[0], c[1], c[2]);
    if (view == VERTEX_ON) look(&d, c[0] + 0.5 * size, c[1] + 0.5 * size, c[2] + 3 * size, c[0] + 0.5 * size, c[1] + 0.5 * size, c[2]);
    if (view == PARALLEL_TILTED) look(&d, c[0] + 1e-6 * size, c[1] - 3e-8 * size, c[2] + 3 * size, c[0], c[1], c[2]);
    if (view == PARALLEL) d.camera.ortho_height = (float)(1.6 * size);
    if (view == PARALLEL_AXIS || view == PARALLEL_TILTED) d.camera.ortho_height = (float)(size * PROJECT_H / 28.0); /* rays along faces and edges */
    if (view == INSIDE) look(&d, c[0] + 0.06 * size, c[1] + 0.04 * size, c[2] + 0.05 * size, c[0] + size, c[1], c[2] - 0.3 * size);
    if (view == ZOOMED) d.camera.fov_y = 1.5f;
    if (view == DISTANT) {
        look(&d, c[0] - 1.3e5 * size, c[1] + 0.9e5 * size, c[2] + 1.7e5 * size, c[0], c[1], c[2]);
        d.camera.fov_y = 0.0004f;
    }
    if (view == CLIPPED) {
        d.clip_near = (float)(2.1 * size);
        d.clip_far = (float)(2.6 * size);
    }
    return d;
}

/* Largest difference of colours; lengths against the size of the mesh. */
static double differ(const project_picture *a, const project_picture *b, double *length, uint32_t *steps) {
    double most = 0;
    int x, y, k;
    *length = 0;
    *steps = 0;
    for (y = 0; y < PROJECT_H; y++)
        for (x = 0; x < PROJECT_W; x++) {
            double e = fabs((double)a->length[y][x] - (double)b->length[y][x]);
            if (!(e <= *length)) *length = e;
            *steps += a->steps[y][x] != b->steps[y][x];
            for (k = 0; k < 4; k++) {
                e = fabs((double)a->rgba[y][x][k] - (double)b->rgba[y][x][k]);
                if (!(e <= most)) most = e;
            }
        }
    return most;
}

static uint32_t fewer(const project_picture *a, const project_picture *b) {
    uint32_t n = 0;
    int x, y;
    for (y = 0; y < PROJECT_H; y++)
        for (x = 0; x < PROJECT_W; x++) n += a->steps[y][x] < b->steps[y][x];
    return n;
}

/* ---- against the walker ---- */

/* Every pixel passes the same number of cells: no seam, no pixel drawn twice, in any mesh and any view. */
TEST(same_cells_as_a_walk) {
    scene s;
    int kind, view;
    for (kind = 0; kind < SCENES; kind++) {
        scene_make(&s, kind);
        for (view = 0; view < VIEWS; view++) {
            tetcast_render_desc d = view_of(view, &s);
            double length, color;
            uint32_t steps;
            tetcast_render_stats stats;
            memset(&stats, 0, sizeof stats);
            CHECK_EQ_U64(draw(&d, TETCAST_METHOD_WALK, &s, &pic[0], NULL), TETCAST_OK);
            CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[1], &stats), TETCAST_OK);
            color = differ(&pic[0], &pic[1], &length, &steps);
            if (view == INSIDE || view == CLIPPED) /* a walk begins at the eye's cell or counts what it passes before */
                CHECK_MSG(steps < PROJECT_W * PROJECT_H / 4 || kind == TANGLED || kind == FLAT || kind == RANDOM_SOUP,
                          "mesh %d view %d: %u pixels with other cells", kind, view, steps);
            else if (kind == TANGLED) /* rings of cells that no walk comes to */
                CHECK_MSG(fewer(&pic[1], &pic[0]) == 0, "view %d: %u pixels with fewer cells", view, fewer(&pic[1], &pic[0]));
            else CHECK_MSG(steps == 0, "mesh %d view %d: %u pixels with other cells", kind, view, steps);
            /* where cells overlap, a walk follows its path and projection the depths */
            if (kind == TANGLED || kind == RANDOM_SOUP) CHECK_MSG(length < 0.2, "mesh %d view %d: length %g", kind, view, length);
            else CHECK_MSG(color < 2e-5 && length < 5e-5, "mesh %d view %d: colour %g length %g", kind, view, color, length);
            CHECK(stats.method == TETCAST_METHOD_PROJECT && stats.steps <= stats.pixel_tests);
            if (view == SLANTED && kind == JITTERED)
                CHECK_MSG(stats.exact_tests * 50 < stats.pixel_tests, "exact: %llu of %llu",
                          (unsigned long long)stats.exact_tests, (unsigned long long)stats.pixel_tests);
        }
        scene_free(&s);
    }
}

TEST(same_bits) {
    static const tetcast_model models[6] = {TETCAST_MODEL_VOLUME, TETCAST_MODEL_EMISSION, TETCAST_MODEL_ABSORPTION,
                                            TETCAST_MODEL_MAXIMUM, TETCAST_MODEL_ISOSURFACE, TETCAST_MODEL_MIXED};
    scene s;
    int kind, view, m;
    for (kind = 0; kind < SCENES; kind += test_quick() ? 4 : 2) {
        scene_make(&s, kind);
        for (view = 0; view < VIEWS; view++)
            for (m = view % 3; m < 6; m += 3) {
                tetcast_render_desc d = view_of(view, &s);
                tetcast_render_stats a, b;
                memset(&a, 0, sizeof a);
                memset(&b, 0, sizeof b);
                scene_optics(&s, models[m], m >= 4 ? 0.4f : -1.0f, 0.5f);
                g_no_depth = (view + m) & 1;
                CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], &a), TETCAST_OK);
                d.isa = TETCAST_ISA_SCALAR;
                CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[1], &b), TETCAST_OK);
                CHECK_MSG(memcmp(&pic[0], &pic[1], sizeof pic[0]) == 0, "mesh %d view %d model %d: isa", kind, view, m);
                CHECK_EQ_U64(a.pixel_tests, b.pixel_tests);
                CHECK_EQ_U64(a.exact_tests, b.exact_tests);
                CHECK_EQ_U64(a.cells, b.cells);
                CHECK_EQ_U64(a.walks, b.walks);
                d.isa = TETCAST_ISA_AUTO;
                d.env.thread_count = 3;
                CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[1], NULL), TETCAST_OK);
                CHECK_MSG(memcmp(&pic[0], &pic[1], sizeof pic[0]) == 0, "mesh %d view %d model %d: threads", kind, view, m);
            }
        scene_free(&s);
    }
    g_no_depth = 0;
}

/* All models; surfaces with flat and smooth normals; values per cell; masked cells; ending early; hidden clusters. */
TEST(models) {
    static const tetcast_model models[6] = {TETCAST_MODEL_VOLUME, TETCAST_MODEL_EMISSION, TETCAST_MODEL_ABSORPTION,
                                            TETCAST_MODEL_MAXIMUM, TETCAST_MODEL_ISOSURFACE, TETCAST_MODEL_MIXED};
    scene s;
    int m;
    double length;
    uint32_t steps;
    scene_make(&s, HOLES);
    REQUIRE(s.mesh != NULL);
    CHECK_EQ_U64(tetcast_mesh_make_gradients(s.mesh, NULL), TETCAST_OK);
    for (m = 0; m < 12; m++) {
        tetcast_render_desc d = view_of(SLANTED, &s);
        d.smooth_normals = m >= 6;
        scene_optics(&s, models[m % 6], m % 6 >= 4 ? 0.4f : -1.0f, 0.3f);
        CHECK_EQ_U64(draw(&d, TETCAST_METHOD_WALK, &s, &pic[0], NULL), TETCAST_OK);
        CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[1], NULL), TETCAST_OK);
        CHECK_MSG(differ(&pic[0], &pic[1], &length, &steps) < 3e-5, "model %d", m);
        CHECK_EQ_U64(steps, 0);
    }
    scene_free(&s);
    for (m = 0; m < 2; m++) { /* per cell, with masked cells and values that are no numbers */
        tetcast_input in;
        tetcast_field f;
        tetcast_mesh_desc md;
        tetcast_render_desc d;
        float *values;
        uint8_t *masks;
        size_t i;
        memset(&s, 0, sizeof s);
        memset(&in, 0, sizeof in);
        memset(&f, 0, sizeof f);
        memset(&md, 0, sizeof md);
        tets_lattice(&s.t, 7, 7, 7, 5, NULL);
        values = (float *)malloc(s.t.nt * sizeof *values);
        masks = (uint8_t *)malloc(s.t.nt);
        REQUIRE(values != NULL && masks != NULL);
        for (i = 0; i < s.t.nt; i++) {
            values[i] = (float)(i % 17) / 17.0f;
            masks[i] = m == 1 && i % 3 == 0;
        }
        values[5] = (float)NAN;
        in.positions.data = s.t.p;
        in.positions.type = TETCAST_TYPE_F64;
        in.vertex_count = s.t.nv;
        in.indices = s.t.t;
        in.index_count = 4 * s.t.nt;
        in.cell_count = s.t.nt;
        in.masks = masks;
        f.values.data = values;
        f.per_cell = 1;
        in.fields = &f;
        in.field_count = 1;
        CHECK_EQ_U64(tetcast_mesh_create(&md, &in, NULL, &s.mesh), TETCAST_OK);
        REQUIRE(s.mesh != NULL);
        scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 0.3f);
        d = view_of(SLANTED, &s);
        CHECK_EQ_U64(draw(&d, TETCAST_METHOD_WALK, &s, &pic[0], NULL), TETCAST_OK);
        CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[1], NULL), TETCAST_OK);
        CHECK(differ(&pic[0], &pic[1], &length, &steps) < 3e-5);
        CHECK_EQ_U64(steps, 0);
        free(values);
        free(masks);
        scene_free(&s);
    }
}

/* Rays that end early end where they do on a walk; clusters that show nothing are left out without a trace. */
TEST(shortcuts) {
    scene s;
    tetcast_render_desc d;
    tetcast_control_point p[4];
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_render_stats stats[2];
    tetcast_image im;
    int x, y, k;
    memset(&s, 0, sizeof s);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    memset(p, 0, sizeof p);
    memset(stats, 0, sizeof stats);
    tets_lattice(&s.t, 16, 16, 16, 5, NULL);
    scene_build(&s);
    for (k = 0; k < 4; k++) {
        p[k].value = k == 0 ? 0.0f : k == 1 ? 0.7f : k == 2 ? 0.75f : 1.0f;
        p[k].rgb[k % 3] = 1.0f;
        p[k].extinction = k < 2 ? 0.0f : 9.0f;
    }
    td.points = p;
    td.point_count = 4;
    od.t_min = 0.01f;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &s.transfer), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(s.transfer, &od, &s.optics), TETCAST_OK);
    d = view_of(SLANTED, &s);
    for (k = 0; k < 2; k++) {
        im = image_of(&pic[k]);
        im.length = NULL;
        im.steps = NULL;
        im.depth = NULL;
        d.method = TETCAST_METHOD_PROJECT;
        d.no_leaping = (uint32_t)k;
        CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, &stats[k]), TETCAST_OK);
    }
    CHECK(memcmp(pic[0].rgba, pic[1].rgba, sizeof pic[0].rgba) == 0);
    CHECK_MSG(stats[0].cells < stats[1].cells, "cells drawn: %llu of %llu", (unsigned long long)stats[0].cells,
              (unsigned long long)stats[1].cells);
    CHECK(stats[1].ended > 0);
    d.method = TETCAST_METHOD_WALK;
    im = image_of(&pic[0]);
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_OK);
    for (y = 0; y < PROJECT_H; y++)
        for (x = 0; x < PROJECT_W; x++)
            for (k = 0; k < 4; k++) CHECK_NEAR(pic[0].rgba[y][x][k], pic[1].rgba[y][x][k], 2e-5);
    scene_free(&s);
}

/* ---- against brute force ---- */

typedef struct span { double t0, t1; float s0, s1; } span;

static int span_order(const void *a, const void *b) {
    double x = ((const span *)a)->t0, y = ((const span *)b)->t0;
    return x < y ? -1 : x > y;
}

/* Value in a tetrahedron: as a mean of its corners by volumes. */
static double ref_value(const double *v[4], const float s[4], const double x[3]) {
    double sum = 0, all = 0;
    int i, k;
    for (i = 0; i < 4; i++) {
        const double *q[3];
        double e[3][3], volume, from = 0;
        int n = 0, pass;
        for (k = 0; k < 4; k++)
            if (k != i) q[n++] = v[k];
        for (pass = 0; pass < 2; pass++) {
            const double *o = pass == 0 ? v[i] : x;
            for (n = 0; n < 3; n++)
                for (k = 0; k < 3; k++) e[n][k] = q[n][k] - o[k];
            volume = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
                     e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
            if (pass == 0) from = volume;
            else sum += (double)s[i] * volume / from, all += volume / from;
        }
    }
    return sum / all;
}

/* Every step-th pixel of p. */
static void oracle(const tetcast_render_desc *d, const scene *s, int step, project_picture *p) {
    span *list = (span *)malloc((s->t.nt + 1) * sizeof *list);
    tetcast_segment *seg = (tetcast_segment *)malloc((s->t.nt + 1) * sizeof *seg);
    int x, y;
    if (list == NULL || seg == NULL) abort();
    for (y = 0; y < PROJECT_H; y++)
        for (x = 0; x < PROJECT_W; x++) {
            tetcast_ray r;
            size_t i, n = 0;
            double length = 0;
            if ((x + 7 * y) % step != 0) continue;
            CHECK_EQ_U64(tetcast_camera_ray(&d->camera, PROJECT_W, PROJECT_H, x + 0.5, y + 0.5, &r), TETCAST_OK);
            for (i = 0; i < s->t.nt; i++) {
                const uint32_t *t = s->t.t + 4 * i;
                const double *v[4];
                float value[4];
                double at[2][3], t0, t1;
                int j;
                for (j = 0; j < 4; j++) {
                    v[j] = s->t.p + 3 * t[j];
                    value[j] = s->t.s[t[j]];
                }
                if (!ref_tet(v[0], v[1], v[2], v[3], r.org, r.dir, &t0, &t1)) continue;
                t0 = fmax(t0, 0);
                if (!(t1 > t0)) continue;
                for (j = 0; j < 3; j++) {
                    at[0][j] = r.org[j] + t0 * r.dir[j];
                    at[1][j] = r.org[j] + t1 * r.dir[j];
                }
                list[n].t0 = t0;
                list[n].t1 = t1;
                list[n].s0 = (float)ref_value(v, value, at[0]);
                list[n++].s1 = (float)ref_value(v, value, at[1]);
            }
            qsort(list, n, sizeof *list, span_order);
            for (i = 0; i < n; i++) {
                seg[i].front = list[i].s0;
                seg[i].back = list[i].s1;
                seg[i].length = (float)(list[i].t1 - list[i].t0);
                seg[i].depth = (float)list[i].t0;
                length += list[i].t1 - list[i].t0;
            }
            CHECK_EQ_U64(tetcast_optics_ray(s->optics, seg, n, p->rgba[y][x], NULL), TETCAST_OK);
            p->length[y][x] = (float)length;
            p->steps[y][x] = (uint32_t)n;
        }
    free(list);
    free(seg);
}

/* A ring of bricks with a twist: seen along its axis each brick hides the next one, all the way round. */
static void make_ring(scene *s, uint32_t n) {
    static const uint8_t six[6][4] = {{0, 1, 3, 7}, {0, 1, 5, 7}, {0, 2, 3, 7}, {0, 2, 6, 7}, {0, 4, 5, 7}, {0, 4, 6, 7}};
    uint32_t i, k, j;
    memset(s, 0, sizeof *s);
    for (i = 0; i < n; i++)
        for (k = 0; k < 4; k++) { /* inner, outer below; inner, outer above and turned */
            double a = 6.283185307179586 * i / n + (k >= 2 ? 0.7 : 0.0), r = (k & 1u) ? 3.0 : 0.8;
            tets_vertex(&s->t, r * cos(a), r * sin(a), k >= 2 ? 1.5 : 0.0, (double)((i * 4 + k) % 7) / 7.0);
        }
    for (i = 0; i < n; i++)
        for (j = 0; j < 6; j++) {
            uint32_t q[4];
            for (k = 0; k < 4; k++) { /* bit 0: along the ring, bit 1: outwards, bit 2: up */
                uint32_t c = six[j][k];
                q[k] = ((i + (c & 1u)) % n) * 4 + (c >> 1 & 1u) + 2 * (c >> 2);
            }
            tets_tet(&s->t, q[0], q[1], q[2], q[3]);
        }
    scene_build(s);
    scene_optics(s, TETCAST_MODEL_VOLUME, -1, 2.0f);
}

TEST(oracle_pictures) {
    scene s;
    tetcast_render_desc d;
    double length;
    uint32_t steps;
    int k;
    for (k = 0; k < 6; k++) {
        int view = k == 1 ? PARALLEL : k == 3 ? INSIDE : SLANTED;
        if (k == 0 || k == 1) make_ring(&s, 7);
        else scene_make(&s, k == 2 ? SINGLE : k == 3 ? JITTERED : k == 4 ? HOLES : FAR_AWAY);
        d = view_of(view, &s);
        if (k <= 1) look(&d, 0.3, 0.2, 9, 0, 0, 0);
        CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[1], NULL), TETCAST_OK);
        pic[0] = pic[1];
        oracle(&d, &s, k <= 2 ? 1 : test_quick() ? 23 : 5, &pic[0]);
        CHECK_MSG(differ(&pic[0], &pic[1], &length, &steps) < 1e-4, "scene %d: colour off by %g", k,
                  differ(&pic[0], &pic[1], &length, &steps));
        CHECK_MSG(length < 1e-4, "scene %d: length off by %g", k, length);
        scene_free(&s);
    }
}

/* ---- arguments, memory, sizes ---- */

TEST(units) { /* lengths and values of any size: the picture is that of ordinary ones, walked and projected, by any instruction set */
    static const int units[6][2] = {{0, 0}, {80, -90}, {-55, 70}, {0, 90}, {0, 120}, {60, -115}}; /* lengths, values: powers of 2 */
    static project_picture want[2], got, other;
    uint32_t u, k, x, y, c, isa, seen = 0;
    for (u = 0; u < 6; u++)
        for (k = 0; k < 2; k++) { /* a volume; with a surface that is shaded smoothly */
            const double size = ldexp(1, units[u][0]), value = ldexp(1, units[u][1]);
            const double scale[3] = {size, size, size}, offset[3] = {0, 0, 0};
            tetcast_control_point p[3];
            tetcast_transfer_desc td;
            tetcast_optics_desc od;
            tetcast_isovalue iso;
            tetcast_render_desc d;
            scene s;
            memset(&s, 0, sizeof s);
            memset(&td, 0, sizeof td);
            memset(&od, 0, sizeof od);
            memset(&iso, 0, sizeof iso);
            memset(&d, 0, sizeof d);
            memset(p, 0, sizeof p);
            tets_lattice(&s.t, 8, 8, 8, 5, NULL);
            tets_jitter(&s.t, 8, 8, 8, 0.5, 3);
            tets_place(&s.t, scale, offset);
            for (x = 0; x < s.t.nv; x++) s.t.s[x] = (float)((double)s.t.s[x] * value);
            scene_build(&s);
            for (c = 0; c < 3; c++) {
                p[c].value = (float)(0.35 * c * value);
                p[c].rgb[c] = 1.0f;
                p[c].extinction = (float)(0.1 * c / size);
            }
            iso.value = (float)(0.4 * value);
            iso.rgb[0] = iso.rgb[1] = iso.rgb[2] = iso.opacity = 0.5f;
            td.points = p;
            td.point_count = 3;
            td.isovalues = &iso;
            td.isovalue_count = k;
            od.model = k ? TETCAST_MODEL_MIXED : TETCAST_MODEL_VOLUME;
            CHECK_EQ_U64(tetcast_transfer_create(&td, &s.transfer), TETCAST_OK);
            CHECK_EQ_U64(tetcast_optics_create(s.transfer, &od, &s.optics), TETCAST_OK);
            if (k) CHECK_EQ_U64(tetcast_mesh_make_gradients(s.mesh, NULL), TETCAST_OK);
            d.smooth_normals = k;
            d.env.thread_count = 1;
            d.no_leaping = 1;
            d.isa = TETCAST_ISA_SCALAR;
            g_no_depth = !k;
            CHECK_EQ_U64(draw(&d, TETCAST_METHOD_WALK, &s, &got, NULL), TETCAST_OK);
            if (u == 0) want[k] = got;
            for (y = 0; y < PROJECT_H; y++)
                for (x = 0; x < PROJECT_W; x++)
                    for (c = 0; c < 4; c++) {
                        seen += want[k].rgba[y][x][c] > 0.1f;
                        CHECK_NEAR(got.rgba[y][x][c], want[k].rgba[y][x][c], 2e-5);
                    }
            for (isa = TETCAST_ISA_SSE; isa <= TETCAST_ISA_AVX512; isa++) {
                d.isa = (tetcast_isa)isa;
                CHECK_EQ_U64(draw(&d, TETCAST_METHOD_WALK, &s, &other, NULL), TETCAST_OK);
                CHECK_MSG(memcmp(got.rgba, other.rgba, sizeof got.rgba) == 0, "units %u, model %u, instruction set %u: other bits", u, k, isa);
            }
            for (isa = TETCAST_ISA_SCALAR; isa <= TETCAST_ISA_AVX2; isa++) {
                d.isa = (tetcast_isa)isa;
                CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, isa == TETCAST_ISA_SCALAR ? &got : &other, NULL), TETCAST_OK);
                if (isa != TETCAST_ISA_SCALAR)
                    CHECK_MSG(memcmp(got.rgba, other.rgba, sizeof got.rgba) == 0, "units %u, model %u, instruction set %u: other bits, projected", u, k, isa);
            }
            for (y = 0; y < PROJECT_H; y++)
                for (x = 0; x < PROJECT_W; x++)
                    for (c = 0; c < 4; c++) CHECK_NEAR(got.rgba[y][x][c], want[k].rgba[y][x][c], 2e-4);
            g_no_depth = 0;
            scene_free(&s);
        }
    CHECK(seen > 2000);
}

TEST(arguments) {
    scene s;
    tetcast_render_desc d;
    tetcast_mesh_desc md;
    tetcast_render_stats stats;
    tetcast_image im;
    static float big[512 * 512 * 4];
    uint32_t w, h;
    memset(&stats, 0, sizeof stats);
    scene_make(&s, SINGLE);
    d = view_of(SLANTED, &s);
    d.method = (tetcast_method)3;
    im = image_of(&pic[0]);
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_INVALID_ARG);
    d.method = TETCAST_METHOD_PROJECT;
    im.height = 1;
    im.width = 100000;
    im.rgba = im.length = im.depth = NULL;
    im.steps = NULL;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_RANGE);
    for (w = 1; w < 70; w += 31) /* sizes that are no multiples of anything */
        for (h = 1; h < 70; h += 33) {
            im.width = w;
            im.height = h;
            im.rgba = big;
            CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_OK);
        }
    /* a cell that fills the picture is projected unless one says otherwise, many small ones are not */
    d.method = TETCAST_METHOD_AUTO;
    im.width = im.height = 512;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, &stats), TETCAST_OK);
    CHECK(stats.method == TETCAST_METHOD_PROJECT);
    CHECK_MSG(fabs((double)stats.pixels_per_cell - (double)stats.steps) < 0.02 * (double)stats.steps,
              "%g pixels a cell, measured %llu", (double)stats.pixels_per_cell, (unsigned long long)stats.steps);
    scene_optics(&s, TETCAST_MODEL_ISOSURFACE, 0.4f, 1); /* projection is slow for surfaces */
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, &stats), TETCAST_OK);
    CHECK(stats.method == TETCAST_METHOD_WALK && stats.pixels_per_cell > 16000);
    scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 1);
    im = image_of(&pic[0]);
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, &stats), TETCAST_OK);
    CHECK(stats.method == TETCAST_METHOD_WALK);
    scene_free(&s);
    memset(&s, 0, sizeof s);
    memset(&md, 0, sizeof md);
    tets_lattice(&s.t, 4, 4, 4, 5, NULL);
    md.drop_tets = 1;
    s.mesh = tets_build_desc(&s.t, &md, NULL);
    scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 1);
    d = view_of(SLANTED, &s);
    CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(draw(&d, TETCAST_METHOD_AUTO, &s, &pic[0], NULL), TETCAST_OK);
    scene_free(&s);
}

static int cancel(void *user, uint64_t done, uint64_t total) {
    (void)user;
    (void)total;
    return done > 0;
}

TEST(memory) {
    scene s;
    tetcast_render_desc d;
    test_alloc ta;
    int64_t k, few = 0;
    int kind;
    for (kind = 0; kind < 4; kind++) { /* bit 0: lists know the cells; bit 1: so many overlap that lists grow */
        const int grow = kind & 2;
        tetcast_result r = TETCAST_ERR_NO_MEMORY;
        g_no_depth = !(kind & 1);
        scene_make(&s, grow ? TANGLED : JITTERED);
        if (grow) scene_optics(&s, TETCAST_MODEL_EMISSION, -1.0f, 0.5f); /* no ray ends */
        d = view_of(SLANTED, &s);
        for (k = 0; k < 200 && r != TETCAST_OK; k++) {
            test_alloc_init(&ta);
            ta.fail_at = k;
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            r = draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL);
            CHECK(r == TETCAST_OK || r == TETCAST_ERR_NO_MEMORY);
            CHECK((r == TETCAST_OK) == (ta.failed == 0));
            test_alloc_check(&ta);
        }
        if (kind == 0) few = k;
        CHECK_MSG(k > 6 && r == TETCAST_OK && (kind == 0 || k > few), "kind %d: %lld allocations of %lld", kind,
                  (long long)k, (long long)few);
        if (kind < 3) scene_free(&s);
    }
    memset(&d.env.allocator, 0, sizeof d.env.allocator);
    d.env.progress_fn = cancel;
    CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL), TETCAST_ERR_CANCELLED);
    scene_free(&s);
}

/* Any bits as positions: no crash, no number that is none. */
TEST(any_bits) {
    test_rng r = test_rng_make(9);
    int round, k;
    for (round = 0; round < 40; round++) {
        scene s;
        tetcast_render_desc d;
        uint32_t i;
        int x, y, bad = 0;
        memset(&s, 0, sizeof s);
        for (i = 0; i < 12; i++) {
            double p[3];
            for (k = 0; k < 3; k++) p[k] = round % 2 ? (double)test_rng_below(&r, 3) : (double)test_rng_bits(&r) * 1e-3;
            tets_vertex(&s.t, p[0], p[1], p[2], test_rng_double(&r));
        }
        for (i = 0; i < 12; i++)
            tets_tet(&s.t, test_rng_below(&r, 12), test_rng_below(&r, 12), test_rng_below(&r, 12), test_rng_below(&r, 12));
        {
            tetcast_input in;
            memset(&in, 0, sizeof in);
            in.positions.data = s.t.p;
            in.positions.type = TETCAST_TYPE_F64;
            in.vertex_count = s.t.nv;
            in.indices = s.t.t;
            in.index_count = 4 * s.t.nt;
            in.cell_count = s.t.nt;
            if (tetcast_mesh_create(NULL, &in, NULL, &s.mesh) != TETCAST_OK) {
                scene_free(&s);
                continue;
            }
        }
        scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 1);
        d = view_of(round % VIEWS == CLIPPED ? SLANTED : round % VIEWS, &s);
        if (draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL) == TETCAST_OK)
            for (y = 0; y < PROJECT_H; y++)
                for (x = 0; x < PROJECT_W; x++)
                    for (k = 0; k < 4; k++) bad += !(fabsf(pic[0].rgba[y][x][k]) <= 1e6f) || !(pic[0].length[y][x] >= 0);
        CHECK_MSG(bad == 0, "round %d: %d", round, bad);
        scene_free(&s);
    }
}

/* ---- forms and orders that are compared with ---- */

static double projection_differ(const projection_way *how, const tetcast_render_desc *d, const scene *s,
                              const project_picture *right, projection_report *report, uint32_t *wrong) {
    tetcast_image im = image_of(&pic[2]);
    double most = 0;
    int x, y, k;
    memset(&pic[2], 0, sizeof pic[2]);
    CHECK_EQ_U64(projection_project(how, d, s->mesh, s->optics, &im, report), TETCAST_OK);
    *wrong = 0;
    for (y = 0; y < PROJECT_H; y++)
        for (x = 0; x < PROJECT_W; x++) {
            double worst = 0;
            for (k = 0; k < 4; k++) worst = fmax(worst, fabs((double)pic[2].rgba[y][x][k] - (double)right->rgba[y][x][k]));
            *wrong += worst > 1e-3;
            most = fmax(most, worst);
        }
    return most;
}

TEST(orders) {
    scene s;
    tetcast_render_desc d;
    projection_way how;
    projection_report report, last;
    uint32_t wrong, k;
    double e;
    memset(&how, 0, sizeof how);
    scene_make(&s, JITTERED);
    for (k = 0; k < 2; k++) {
        d = view_of(k ? PARALLEL : SLANTED, &s);
        CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL), TETCAST_OK);
        how.order = PROJECTION_LISTS;
        CHECK(projection_differ(&how, &d, &s, &pic[0], &report, &wrong) == 0 && report.violations == 0);
        how.order = PROJECTION_MPVO; /* a convex mesh without cycles */
        e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
        CHECK_MSG(e < 2e-5 && report.violations == 0 && report.cycles == 0, "MPVO: %g, %llu late, %llu cycles", e,
                  (unsigned long long)report.violations, (unsigned long long)report.cycles);
        how.order = PROJECTION_CENTROID;
        e = projection_differ(&how, &d, &s, &pic[0], &last, &wrong);
        CHECK_MSG(last.violations > 0 && last.violations * 5 < last.fragments && e > 1e-4, "centroids: %llu of %llu, %g",
                  (unsigned long long)last.violations, (unsigned long long)last.fragments, e);
        how.order = PROJECTION_RANDOM;
        (void)projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
        CHECK(report.violations > 3 * last.violations && report.fragments == last.fragments);
        for (how.order = PROJECTION_CENTROID, how.keep = 2; how.keep <= 16; how.keep *= 2) { /* fewer with every step */
            e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
            CHECK(report.violations <= last.violations && report.fragments == last.fragments);
            last = report;
        }
        CHECK_MSG(report.violations == 0 && e < 2e-5, "16 fragments: %llu late, %g", (unsigned long long)report.violations, e);
        how.keep = 0;
    }
    scene_free(&s);
    make_ring(&s, 7); /* each hides the next: no order of cells is right, lists of pixels are */
    d = view_of(SLANTED, &s);
    look(&d, 0.3, 0.2, 9, 0, 0, 0);
    oracle(&d, &s, 1, &pic[0]);
    how.order = PROJECTION_MPVO;
    e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(report.cycles > 0 && report.violations > 0 && e > 1e-2, "ring: %llu cycles, %llu late, %g",
              (unsigned long long)report.cycles, (unsigned long long)report.violations, e);
    how.order = PROJECTION_LISTS;
    CHECK(projection_differ(&how, &d, &s, &pic[0], &report, &wrong) < 1e-4);
    scene_free(&s);
    scene_make(&s, HOLES); /* not convex: nearest middles first goes a long way, not all the way */
    d = view_of(SLANTED, &s);
    CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL), TETCAST_OK);
    how.order = PROJECTION_MPVO;
    (void)projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    how.order = PROJECTION_RANDOM;
    (void)projection_differ(&how, &d, &s, &pic[0], &last, &wrong);
    CHECK_MSG(report.violations * 10 < last.violations, "MPVO %llu, any order %llu late", (unsigned long long)report.violations,
              (unsigned long long)last.violations);
    scene_free(&s);
}

TEST(forms) {
    static const uint32_t sizes[3] = {32, 64, 128};
    scene s;
    tetcast_render_desc d;
    tetcast_image im = image_of(&pic[2]);
    projection_way how;
    projection_report report;
    uint32_t wrong, naive, repaired, k;
    double e, linear, colors, before = 1e9;
    memset(&how, 0, sizeof how);
    scene_make(&s, JITTERED);
    d = view_of(PARALLEL, &s);
    CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL), TETCAST_OK);
    how.form = PROJECTION_FRAGMENT;
    e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(e < 1e-4, "fragment-oriented, parallel: %g", e);
    how.planes = 2;
    e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(wrong > PROJECT_W * PROJECT_H / 10, "two planes: %u wrong pixels", wrong);
    how.form = PROJECTION_VERTEX;
    how.repair = 2;
    e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(e < 1e-4, "vertex-oriented, planes of front faces left out: %g", e);
    for (k = 0; k < 3; k++) { /* the table of the thesis: errors get smaller with its size */
        double sum = 0;
        int x, y;
        how.table = sizes[k];
        (void)projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
        for (y = 0; y < PROJECT_H; y++)
            for (x = 0; x < PROJECT_W; x++) sum += fabs((double)pic[2].length[y][x] - (double)pic[0].length[y][x]);
        CHECK_MSG(sum < before && sum > 1e-2, "table of %u: %g after %g", sizes[k], sum, before);
        before = sum;
    }
    how.table = 0;
    d = view_of(SLANTED, &s);
    CHECK_EQ_U64(projection_project(&how, &d, s.mesh, s.optics, &im, &report), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL), TETCAST_OK);
    how.form = PROJECTION_FRAGMENT;
    how.planes = 0;
    e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(e < 1e-4, "fragment-oriented, perspective: %g", e);
    how.form = PROJECTION_PT;
    how.correction = 1;
    e = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(e < 1e-4, "projected tetrahedra, homogeneous: %g", e);
    how.correction = 0;
    linear = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    how.form = PROJECTION_PT_COLORS;
    how.order = PROJECTION_MPVO;
    colors = projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(linear > 2 * e && colors > 2 * linear, "projected tetrahedra: colours %g, linear %g, homogeneous %g", colors,
              linear, e);
    scene_free(&s);
    /* the edge artefact: rays just through edges between two front faces */
    scene_make(&s, LATTICE5);
    d = view_of(PARALLEL_AXIS, &s);
    look(&d, 3.5, 3.5, 30, 3.5 - 1e-7, 3.5 + 3e-7, 3.5);
    CHECK_EQ_U64(draw(&d, TETCAST_METHOD_PROJECT, &s, &pic[0], NULL), TETCAST_OK);
    memset(&how, 0, sizeof how);
    how.form = PROJECTION_VERTEX;
    (void)projection_differ(&how, &d, &s, &pic[0], &report, &naive);
    how.repair = 1;
    (void)projection_differ(&how, &d, &s, &pic[0], &report, &repaired);
    how.repair = 2;
    (void)projection_differ(&how, &d, &s, &pic[0], &report, &wrong);
    CHECK_MSG(naive > 2 * repaired && repaired >= wrong, "edges: %u pixels wrong, repaired %u, planes left out %u", naive,
              repaired, wrong);
    scene_free(&s);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(same_cells_as_a_walk);
    RUN(same_bits);
    RUN(models);
    RUN(shortcuts);
    RUN(oracle_pictures);
    RUN(units);
    RUN(arguments);
    RUN(memory);
    RUN(any_bits);
    RUN(orders);
    RUN(forms);
    return test_end();
}
