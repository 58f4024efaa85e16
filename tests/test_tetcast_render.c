/* Pictures: the same bits for any number of threads and any instruction set; every pixel shows what its ray meets; eye
   anywhere; clipping, depth, isosurfaces, background; leaping over what is empty; arguments and memory. */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"
#include "../examples/support/volume.h"
#include "ray_oracle.h"

enum { RENDER_W = 70, RENDER_H = 45 };

typedef struct render_scene {
    tets t;
    tetcast_mesh *mesh;
    tetcast_transfer *transfer;
    tetcast_optics *optics;
} render_scene;

/* A transfer function with a peak, a jump and an empty stretch, and optionally an isovalue. */
static int g_more_points; /* 12 control points instead of 6 */
static void render_scene_optics(render_scene *s, tetcast_model model, float iso, float t_min) {
    static const float points[6][5] = {{0.0f, 1, 0.2f, 0, 0.3f}, {0.3f, 1, 0.8f, 0.1f, 0}, {0.5f, 0, 0, 1, 0},
                                       {0.5f, 0.1f, 0.4f, 1, 0.8f}, {0.6f, 0, 1, 0.3f, 0.1f}, {1, 0.9f, 0.9f, 0.9f, 0.4f}};
    tetcast_control_point p[12];
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_isovalue v;
    uint32_t i, n = g_more_points ? 12 : 6;
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    memset(&v, 0, sizeof v);
    for (i = 0; i < n; i++) {
        p[i].value = n == 6 ? points[i][0] : (float)i / 11.0f;
        memcpy(p[i].rgb, points[i % 6] + 1, 12);
        p[i].extinction = points[i % 6][4];
    }
    td.points = p;
    td.point_count = n;
    v.value = iso;
    v.rgb[0] = v.rgb[1] = 0.8f;
    v.rgb[2] = 0.3f;
    v.opacity = model == TETCAST_MODEL_ISOSURFACE ? 1.0f : 0.5f;
    v.specular = 0.3f;
    if (iso >= 0) {
        td.isovalues = &v;
        td.isovalue_count = 1;
    }
    od.model = model;
    od.t_min = t_min;
    tetcast_optics_destroy(s->optics);
    tetcast_transfer_destroy(s->transfer);
    s->optics = NULL;
    s->transfer = NULL;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &s->transfer), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(s->transfer, &od, &s->optics), TETCAST_OK);
}

static void render_scene_free(render_scene *s) {
    tetcast_optics_destroy(s->optics);
    tetcast_transfer_destroy(s->transfer);
    tetcast_mesh_destroy(s->mesh);
    tets_free(&s->t);
    memset(s, 0, sizeof *s);
}

static int keep_hole(uint32_t x, uint32_t y, uint32_t z) { return x < 3 || x > 6 || y < 3 || y > 6 || z < 2; }

static void render_scene_make(render_scene *s, uint32_t n, int holes, tetcast_cells cells) {
    memset(s, 0, sizeof *s);
    tets_lattice(&s->t, n, n, n, 5, holes ? keep_hole : NULL);
    tets_jitter(&s->t, n, n, n, 0.5, 3);
    s->mesh = tets_build(&s->t, cells, NULL);
}

typedef struct render_picture {
    float rgba[RENDER_H][RENDER_W][4], depth[RENDER_H][RENDER_W], length[RENDER_H][RENDER_W];
    uint32_t steps[RENDER_H][RENDER_W];
    uint8_t rgba8[RENDER_H][RENDER_W][4];
} render_picture;

static tetcast_result render_draw(const tetcast_render_desc *d, const render_scene *s, uint32_t width, uint32_t height, int aovs, render_picture *p,
                           tetcast_render_stats *stats) {
    tetcast_image im;
    memset(&im, 0, sizeof im);
    memset(p, 0xcd, sizeof *p);
    im.width = width;
    im.height = height;
    im.rgba = p->rgba[0][0];
    im.rgba8 = p->rgba8[0][0];
    im.rgba_stride = sizeof p->rgba[0];
    im.rgba8_stride = sizeof p->rgba8[0];
    if (aovs) {
        im.depth = p->depth[0];
        im.length = p->length[0];
        im.steps = p->steps[0];
        im.depth_stride = sizeof p->depth[0];
        im.length_stride = sizeof p->length[0];
        im.steps_stride = sizeof p->steps[0];
    }
    return tetcast_render(d, s->mesh, s->optics, &im, stats);
}

static void render_look(tetcast_render_desc *d, double ex, double ey, double ez, double ax, double ay, double az) {
    d->camera.eye[0] = ex;
    d->camera.eye[1] = ey;
    d->camera.eye[2] = ez;
    d->camera.at[0] = ax;
    d->camera.at[1] = ay;
    d->camera.at[2] = az;
}

static tetcast_render_desc render_defaults(void) {
    tetcast_render_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    return d;
}

static render_picture render_pic[2];

/* ---- the same bits ---- */

TEST(same_bits) {
    static const uint32_t threads[4] = {2, 3, 7, 16};
    uint32_t k, i, quick = (uint32_t)test_quick();
    for (k = 0; k < (quick ? 9u : 36u); k++) {
        render_scene s;
        tetcast_render_desc d = render_defaults();
        uint32_t model = k % 6, cells = k % TETCAST_CELLS_COUNT, place = k / 12 % 3;
        render_scene_make(&s, 11, k & 1, (tetcast_cells)cells);
        REQUIRE(s.mesh != NULL);
        render_scene_optics(&s, (tetcast_model)model, model >= 4 ? 0.45f : -1.0f, 0);
        if (place == 0) render_look(&d, 21, 17, -9, 5, 5, 5);
        if (place == 1) render_look(&d, 3.2, 1.1, 4.7, 9, 8, 3); /* inside */
        if (place == 2) {
            render_look(&d, -20, 9, 31, 5, 5, 5);
            d.camera.ortho_height = 14;
        }
        if (k % 5 == 0) d.clip_near = 6.5f;
        if (k % 7 == 0) d.clip_far = 25;
        if (k % 4 == 1 && model >= 4) {
            CHECK_EQ_U64(tetcast_mesh_make_gradients(s.mesh, NULL), TETCAST_OK);
            d.smooth_normals = 1;
        }
        d.background[2] = d.background[3] = 0.5f;
        d.isa = TETCAST_ISA_SCALAR;
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, k % 3 != 2, &render_pic[0], NULL), TETCAST_OK);
        for (i = 0; i < 5; i++) {
            d.isa = i == 4 ? TETCAST_ISA_SSE : TETCAST_ISA_AUTO;
            d.env.thread_count = i == 4 ? 1 : threads[i];
            CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, k % 3 != 2, &render_pic[1], NULL), TETCAST_OK);
            CHECK_MSG(memcmp(&render_pic[0], &render_pic[1], sizeof render_pic[0]) == 0, "case %u, %u", k, i);
        }
        render_scene_free(&s);
    }
}

/* ---- all forms, with all that a picture can have ---- */

static int keep_odd(uint32_t x, uint32_t y, uint32_t z) { return (x * 5 + y * 3 + z * 7) % 11 != 0; }

TEST(forms) { /* values per cell, masks, holes, clipping, leaping, isosurfaces: the picture of one form is that of all */
    uint32_t k, i, kind, isa, n, cases = test_quick() ? 8 : 16;
    for (k = 0; k < cases; k++) {
        static const tetcast_isa isas[4] = {TETCAST_ISA_SCALAR, TETCAST_ISA_SSE, TETCAST_ISA_AVX2, TETCAST_ISA_AVX512};
        render_scene s;
        tetcast_input in;
        tetcast_field f[2];
        tetcast_mesh_desc md;
        float *value;
        uint8_t *mask;
        tetcast_render_desc d = render_defaults();
        tetcast_render_stats stats;
        uint64_t leapt = 0;
        memset(&s, 0, sizeof s);
        memset(&md, 0, sizeof md);
        n = k == 7 ? 22 : 11;
        tets_lattice(&s.t, n, n, n, 5 + (int)(k & 1), k % 4 == 1 ? keep_odd : NULL);
        tets_jitter(&s.t, n, n, n, k % 3 == 0 ? 0 : 0.9, k); /* regular, or with cells turned inside out */
        tets_input(&s.t, &in, f);
        value = (float *)malloc(s.t.nt * sizeof *value);
        mask = (uint8_t *)calloc(s.t.nt, 1);
        REQUIRE(value != NULL && mask != NULL);
        for (i = 0; i < s.t.nt; i++) {
            value[i] = (float)(i * 7919 % 1000) / 999.0f;
            mask[i] = i % 5 == 0;
            if (k == 7) value[i] = i < s.t.nt / 2 ? 0.3f : 0.9f; /* whole clusters that show nothing */
        }
        memset(&f[1], 0, sizeof f[1]);
        f[1].values.data = value;
        f[1].per_cell = 1;
        in.fields = f;
        in.field_count = 2;
        if (k % 4 >= 2) in.masks = mask;
        g_more_points = k % 3 == 1 && k % 8 != 7;
        render_scene_optics(&s, k % 5 == 4 ? TETCAST_MODEL_MIXED : k % 5 == 3 ? TETCAST_MODEL_ISOSURFACE : TETCAST_MODEL_VOLUME,
                     k % 5 >= 3 ? 0.45f : -1.0f, 0);
        if (k % 3 == 2) render_look(&d, 3.2, 1.1, 4.7, 9, 8, 3); /* inside */
        else render_look(&d, k % 3 == 0 ? 6 : 21, 6, -17, 6, 6, 6); /* in a plane of symmetry, and not */
        if (k % 4 == 3) {
            d.clip_near = 4.5f;
            d.clip_far = 19.25f;
        }
        md.env.thread_count = 1;
        for (kind = 0; kind < TETCAST_CELLS_COUNT; kind++) {
            md.cells = (tetcast_cells)kind;
            CHECK_EQ_U64(tetcast_mesh_create(&md, &in, NULL, &s.mesh), TETCAST_OK);
            REQUIRE(s.mesh != NULL);
            if (k % 2 == 1) CHECK_EQ_U64(tetcast_mesh_set_field(s.mesh, 1), TETCAST_OK);
            for (isa = 0; isa < 4; isa++) {
                d.isa = isas[isa];
                memset(&stats, 0, sizeof stats);
                CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, k % 8 < 4, &render_pic[kind != 0 || isa != 0], &stats), TETCAST_OK);
                if (kind == 0 && isa == 0) leapt = stats.leapt_faces;
                else CHECK_MSG(memcmp(&render_pic[0], &render_pic[1], sizeof render_pic[0]) == 0, "case %u, form %u, instruction set %u", k, kind, isa);
                CHECK_EQ_U64(stats.leapt_faces, leapt);
            }
            tetcast_mesh_destroy(s.mesh);
            s.mesh = NULL;
        }
        if (k == 7) CHECK(leapt > 0);
        g_more_points = 0;
        free(value);
        free(mask);
        render_scene_free(&s);
    }
}

/* ---- pixels and rays ---- */

TEST(pixels_are_rays) { /* each pixel is what tetcast_cast finds for the camera's ray */
    uint32_t k, x, y, a, wrong = 0;
    for (k = 0; k < 4; k++) {
        render_scene s;
        tetcast_render_desc d = render_defaults();
        render_scene_make(&s, 9, k == 3, TETCAST_CELLS_TET16);
        REQUIRE(s.mesh != NULL);
        render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 0);
        render_look(&d, 14, 11 + k, -9, 4, 4, 4);
        d.camera.up[0] = k == 1;
        d.camera.fov_y = 30 + 20 * (float)k;
        if (k == 2) d.camera.ortho_height = 10;
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 1, &render_pic[0], NULL), TETCAST_OK);
        for (y = 0; y < RENDER_H; y++)
            for (x = 0; x < RENDER_W; x++) {
                tetcast_ray r;
                tetcast_ray_result got;
                CHECK_EQ_U64(tetcast_camera_ray(&d.camera, RENDER_W, RENDER_H, x + 0.5, y + 0.5, &r), TETCAST_OK);
                CHECK_EQ_U64(tetcast_cast(&d, s.mesh, s.optics, &r, 1, &got, NULL), TETCAST_OK);
                for (a = 0; a < 4; a++) wrong += !(fabsf(got.rgba[a] - render_pic[0].rgba[y][x][a]) < 2e-5f);
                wrong += !(fabsf(got.length - render_pic[0].length[y][x]) < 2e-5f * 9);
            }
        CHECK_EQ_U64(wrong, 0);
        render_scene_free(&s);
    }
}

/* Lengths of all pixels between those in boxes a little smaller and larger. */
static void check_box_lengths(const tetcast_camera *camera, const render_picture *p, uint32_t width, uint32_t height, double n, double near_end,
                              double far_end, const char *what) {
    uint32_t x, y, a, wrong = 0, hits = 0;
    double worst = 0;
    for (y = 0; y < height; y++)
        for (x = 0; x < width; x++) {
            tetcast_ray r;
            double lo[3], hi[3], forward[3], least, most, cosine = 0, blur = 2.5e-6 * n, got = (double)p->length[y][x], error;
            tetcast_camera_ray(camera, width, height, x + 0.5, y + 0.5, &r);
            for (a = 0; a < 3; a++) forward[a] = camera->at[a] - camera->eye[a];
            ref_unit(forward);
            for (a = 0; a < 3; a++) {
                cosine += forward[a] * r.dir[a];
                lo[a] = blur;
                hi[a] = n - 1 - blur;
            }
            least = ref_box(r.org, r.dir, lo, hi, near_end / cosine + blur, far_end / cosine - blur);
            for (a = 0; a < 3; a++) {
                lo[a] = -blur;
                hi[a] = n - 1 + blur;
            }
            most = ref_box(r.org, r.dir, lo, hi, near_end / cosine - blur, far_end / cosine + blur);
            error = fmax(least - got, got - most);
            worst = fmax(worst, error);
            wrong += !(error <= 2e-5 * n);
            hits += most > 0.01;
        }
    CHECK_MSG(wrong == 0, "%s: %u of %u pixels wrong, worst %g", what, wrong, width * height, worst);
    CHECK(hits > 0);
}

TEST(million_rays) { /* the way through a box of jittered cells is that through the box */
    enum { SIDE = 1000 };
    uint32_t n = 12, side = test_quick() ? 200 : SIDE, x, y, a, wrong = 0, met = 0;
    render_scene s;
    tetcast_render_desc d = render_defaults();
    tetcast_image im;
    float *length = (float *)malloc(SIDE * SIDE * sizeof *length);
    REQUIRE(length != NULL);
    memset(&s, 0, sizeof s);
    memset(&im, 0, sizeof im);
    tets_lattice(&s.t, n, n, n, 5, NULL);
    tets_jitter(&s.t, n, n, n, 0.6, 11);
    s.mesh = tets_build(&s.t, TETCAST_CELLS_TET8, NULL);
    REQUIRE(s.mesh != NULL);
    render_look(&d, 19, 14, 23, 5.5, 5.5, 5.5);
    d.camera.fov_y = 32;
    d.traverse_only = 1;
    im.width = im.height = side;
    im.length = length;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, NULL, &im, NULL), TETCAST_OK);
    for (y = 0; y < side; y++)
        for (x = 0; x < side; x++) {
            double lo[3], hi[3], range[2], got = (double)length[y * side + x];
            tetcast_ray r;
            uint32_t k;
            (void)tetcast_camera_ray(&d.camera, side, side, x + 0.5, y + 0.5, &r);
            for (k = 0; k < 2; k++) { /* a box that is a little smaller, and one that is a little larger */
                for (a = 0; a < 3; a++) {
                    lo[a] = k ? -2e-6 : 2e-6;
                    hi[a] = n - 1 - lo[a];
                }
                range[k] = ref_box(r.org, r.dir, lo, hi, 0, 1e300);
            }
            wrong += !(got >= range[0] - 1e-5 && got <= range[1] + 1e-5);
            met += got > 0;
        }
    CHECK_MSG(wrong == 0, "%u of %u rays", wrong, met);
    CHECK(met > side * side / 2);
    free(length);
    render_scene_free(&s);
}

TEST(symmetric_views) { /* a regular lattice from planes of symmetry, through vertices and edges: no pixel is lost */
    uint32_t k, n = 9;
    for (k = 0; k < 12; k++) {
        render_scene s;
        tetcast_render_desc d = render_defaults();
        char what[32];
        double c = 0.5 * (n - 1);
        memset(&s, 0, sizeof s);
        tets_lattice(&s.t, n, n, n, k & 1 ? 5 : 6, NULL);
        s.mesh = tets_build(&s.t, TETCAST_CELLS_TET16, NULL);
        REQUIRE(s.mesh != NULL);
        render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, -1);
        switch (k / 2) {
        case 0: render_look(&d, c, c, -2.0 * n, c, c, c); break;
        case 1: render_look(&d, -2.0 * n, c, -2.0 * n, c, c, c); break;
        case 2: render_look(&d, -2.0 * n, -2.0 * n, -2.0 * n, c, c, c); break;
        case 3: render_look(&d, c, c, 3.0 * n, c, c, 0); d.camera.ortho_height = (float)n; break;
        case 4: render_look(&d, c, c, 1e6 * n, c, c, 0); d.camera.fov_y = 6e-5f; break;
        default: render_look(&d, -2.0 * n, 3, 3, c, 3, 3); d.camera.up[1] = d.camera.up[2] = 1; break;
        }
        CHECK_EQ_U64(render_draw(&d, &s, 45, 45, 1, &render_pic[0], NULL), TETCAST_OK);
        snprintf(what, sizeof what, "view %u", k);
        check_box_lengths(&d.camera, &render_pic[0], 45, 45, n, 0, 1e300, what);
        render_scene_free(&s);
    }
}

TEST(eye_inside) { /* in cells, on faces, edges, vertices, on the hull and a hair's breadth off it */
    uint32_t k, a, n = 8, isa;
    for (k = 0; k < 40; k++) {
        render_scene s;
        test_rng rng = test_rng_make(k);
        double eye[3], at[3];
        char what[32];
        memset(&s, 0, sizeof s);
        tets_lattice(&s.t, n, n, n, k & 1 ? 5 : 6, NULL);
        if (k % 4 == 3) tets_jitter(&s.t, n, n, n, 0.6, k);
        s.mesh = tets_build(&s.t, k & 2 ? TETCAST_CELLS_TET8 : TETCAST_CELLS_TET16, NULL);
        REQUIRE(s.mesh != NULL);
        render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, -1);
        for (a = 0; a < 3; a++) {
            eye[a] = k % 5 == 0 ? 1 + test_rng_below(&rng, n - 2) : (n - 1) * test_rng_double(&rng);
            at[a] = (n - 1) * test_rng_double(&rng);
        }
        if (k % 5 == 1) eye[k % 3] = floor(eye[k % 3]);
        if (k % 5 == 2) eye[k % 3] = k & 4 ? 0 : n - 1;                 /* on the hull */
        if (k % 5 == 3) eye[k % 3] = (k & 4 ? 0 : n - 1) + (k & 8 ? 1e-7 : -1e-7) * (k & 4 ? 1 : -1);
        if (k == 35) eye[0] = eye[1] = eye[2] = 0;
        for (isa = 1; isa <= 3; isa++) {
            tetcast_render_desc d = render_defaults();
            render_look(&d, eye[0], eye[1], eye[2], at[0], at[1], at[2]);
            d.camera.fov_y = 90;
            d.isa = (tetcast_isa)isa;
            CHECK_EQ_U64(render_draw(&d, &s, 33, 33, 1, &render_pic[0], NULL), TETCAST_OK);
            snprintf(what, sizeof what, "eye %u isa %u", k, isa);
            check_box_lengths(&d.camera, &render_pic[0], 33, 33, n, 0, 1e300, what);
            d.clip_near = 1.25f;
            d.clip_far = 4;
            CHECK_EQ_U64(render_draw(&d, &s, 33, 33, 1, &render_pic[0], NULL), TETCAST_OK);
            check_box_lengths(&d.camera, &render_pic[0], 33, 33, n, 1.25, 4, what);
        }
        render_scene_free(&s);
    }
}

TEST(eye_in_tangled_cells) { /* rays begin in rings of cells that no ray from outside enters: they end all the same, equally */
    uint32_t k, i, a;
    for (k = 0; k < (test_quick() ? 60u : 200u); k++) {
        render_scene s;
        test_rng rng = test_rng_make(k);
        tetcast_render_desc d = render_defaults();
        double eye[3], at[3];
        memset(&s, 0, sizeof s);
        if (k % 4 == 3) { /* few places, so that cells are flat, too */
            for (i = 0; i < 40; i++)
                tets_vertex(&s.t, test_rng_below(&rng, 4), test_rng_below(&rng, 4), test_rng_below(&rng, 1 + k % 3), test_rng_double(&rng));
            for (i = 0; i < 120; i++)
                tets_tet(&s.t, test_rng_below(&rng, 40), test_rng_below(&rng, 40), test_rng_below(&rng, 40), test_rng_below(&rng, 40));
        } else {
            tets_lattice(&s.t, 7, 7, 7, k & 1 ? 5 : 6, NULL);
            tets_jitter(&s.t, 7, 7, 7, 2.5, k);
        }
        s.mesh = tets_build(&s.t, TETCAST_CELLS_TET16, NULL);
        REQUIRE(s.mesh != NULL);
        render_scene_optics(&s, k & 2 ? TETCAST_MODEL_ISOSURFACE : TETCAST_MODEL_VOLUME, k & 2 ? 0.5f : -1, -1);
        for (a = 0; a < 3; a++) {
            eye[a] = k % 4 == 3 ? test_rng_below(&rng, 4) : 1 + 4 * test_rng_double(&rng);
            at[a] = 6 * test_rng_double(&rng) + 0.1;
        }
        render_look(&d, eye[0], eye[1], eye[2], at[0], at[1], at[2]);
        d.camera.fov_y = 90;
        d.method = TETCAST_METHOD_WALK;
        d.isa = TETCAST_ISA_SCALAR;
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 1, &render_pic[0], NULL), TETCAST_OK);
        d.isa = TETCAST_ISA_AUTO;
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 1, &render_pic[1], NULL), TETCAST_OK);
        CHECK_MSG(memcmp(&render_pic[0], &render_pic[1], sizeof render_pic[0]) == 0, "mesh %u: other bits with another instruction set", k);
        render_scene_free(&s);
    }
}

TEST(wide_angles) { /* 170 degrees: rays of one tile look along different axes */
    render_scene s;
    tetcast_render_desc d = render_defaults();
    uint32_t n = 9;
    memset(&s, 0, sizeof s);
    tets_lattice(&s.t, n, n, n, 6, NULL);
    s.mesh = tets_build(&s.t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(s.mesh != NULL);
    render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, -1);
    render_look(&d, 3.3, 4.1, 5.2, 4, 7, 1);
    d.camera.fov_y = 170;
    CHECK_EQ_U64(render_draw(&d, &s, 31, 31, 1, &render_pic[0], NULL), TETCAST_OK);
    check_box_lengths(&d.camera, &render_pic[0], 31, 31, n, 0, 1e300, "inside");
    render_look(&d, -1, 4, 4, 4, 4.2, 4.1);
    CHECK_EQ_U64(render_draw(&d, &s, 31, 31, 1, &render_pic[0], NULL), TETCAST_OK);
    check_box_lengths(&d.camera, &render_pic[0], 31, 31, n, 0, 1e300, "outside");
    render_scene_free(&s);
}

TEST(narrow_views) { /* from so far that doubles do not tell pixels apart: the same picture for every isa, and something in it */
    uint32_t k, i, seen;
    for (k = 0; k < 24; k++) {
        render_scene s;
        tetcast_render_desc d = render_defaults();
        memset(&s, 0, sizeof s);
        tets_lattice(&s.t, 5, 5, 5, 6, NULL);
        s.mesh = tets_build(&s.t, TETCAST_CELLS_TET16, NULL);
        REQUIRE(s.mesh != NULL);
        render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, -1);
        d.camera.fov_y = d.camera.ortho_height = 0;
        if (k % 2 == 0) d.camera.fov_y = (float)pow(10, -3.0 * (k / 2 + 1)); /* eye equals at: it is put where all is seen */
        else { /* parallel, and the eye as far away */
            d.camera.ortho_height = 6;
            render_look(&d, 2, 2, 2 - pow(10, 3.0 * (k / 2 + 1)), 2, 2, 2);
            d.camera.eye[0] += 0.3 * d.camera.eye[2];
        }
        d.isa = TETCAST_ISA_SCALAR;
        if (k % 2 == 0) memset(d.camera.eye, 0, sizeof d.camera.eye);
        if (k % 2 == 0) memset(d.camera.at, 0, sizeof d.camera.at);
        CHECK_EQ_U64(render_draw(&d, &s, 31, 31, 1, &render_pic[0], NULL), TETCAST_OK);
        d.isa = TETCAST_ISA_AUTO;
        CHECK_EQ_U64(render_draw(&d, &s, 31, 31, 1, &render_pic[1], NULL), TETCAST_OK);
        for (i = seen = 0; i < 31 * 31; i++) {
            const uint32_t x = i % 31, y = i / 31;
            seen += render_pic[0].length[y][x] > 0;
            CHECK_MSG(render_pic[0].length[y][x] == render_pic[1].length[y][x] && memcmp(render_pic[0].rgba[y][x], render_pic[1].rgba[y][x], 16) == 0,
                      "view %u: pixel %u %u", k, x, y);
        }
        CHECK_MSG(seen > 200 || k / 2 > 3, "view %u: %u pixels", k, seen);
        render_scene_free(&s);
    }
}

/* ---- sizes, buffers, background ---- */

TEST(sizes) {
    static const uint32_t size[7][2] = {{1, 1}, {33, 17}, {32, 32}, {64, 1}, {1, 40}, {70, 45}, {31, 33}};
    uint32_t k, x, y;
    render_scene s;
    render_scene_make(&s, 6, 0, TETCAST_CELLS_TET16);
    REQUIRE(s.mesh != NULL);
    render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 0);
    for (k = 0; k < 7; k++) {
        tetcast_render_desc d = render_defaults();
        tetcast_render_stats stats;
        uint32_t wrong = 0;
        memset(&stats, 0, sizeof stats);
        render_look(&d, 12, 9, -8, 2.5, 2.5, 2.5);
        d.background[0] = 0.25f;
        d.background[3] = 0.5f;
        CHECK_EQ_U64(render_draw(&d, &s, size[k][0], size[k][1], 1, &render_pic[0], &stats), TETCAST_OK);
        CHECK_EQ_U64(stats.rays, size[k][0] * size[k][1]);
        for (y = 0; y < RENDER_H; y++)
            for (x = 0; x < RENDER_W; x++) {
                uint32_t bits;
                memcpy(&bits, &render_pic[0].rgba[y][x][3], 4);
                wrong += (x < size[k][0] && y < size[k][1]) == (bits == 0xcdcdcdcdu); /* all of it, and no more */
            }
        CHECK_EQ_U64(wrong, 0);
    }
    {
        tetcast_render_desc d = render_defaults();
        CHECK_EQ_U64(render_draw(&d, &s, 0, 10, 1, &render_pic[0], NULL), TETCAST_OK);
        CHECK_EQ_U64(render_draw(&d, &s, 10, 0, 1, &render_pic[0], NULL), TETCAST_OK);
    }
    render_scene_free(&s);
}

TEST(background_and_bytes) {
    render_scene s;
    tetcast_render_desc d = render_defaults();
    uint32_t x, y, a, wrong = 0, empty = 0;
    render_scene_make(&s, 7, 0, TETCAST_CELLS_TET16);
    REQUIRE(s.mesh != NULL);
    render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 0);
    render_look(&d, 14, 9, -11, 3, 3, 3);
    CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 1, &render_pic[0], NULL), TETCAST_OK);
    d.background[0] = 0.1f;
    d.background[1] = 0.2f;
    d.background[2] = 0.4f;
    d.background[3] = 0.8f;
    CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 1, &render_pic[1], NULL), TETCAST_OK);
    for (y = 0; y < RENDER_H; y++)
        for (x = 0; x < RENDER_W; x++) {
            const float *p = render_pic[0].rgba[y][x], *q = render_pic[1].rgba[y][x];
            for (a = 0; a < 4; a++) wrong += q[a] != p[a] + (1.0f - p[3]) * d.background[a];
            for (a = 0; a < 3; a++) {
                double want = q[3] > 0 ? tetcasti_linear_to_srgb((double)q[a] / (double)q[3]) * 255 : 0;
                wrong += !(fabs((double)render_pic[1].rgba8[y][x][a] - want) <= 0.5001);
            }
            wrong += !(fabs((double)render_pic[1].rgba8[y][x][3] - (double)q[3] * 255) <= 0.5001);
            if (render_pic[0].steps[y][x] == 0) {
                empty++;
                wrong += p[3] != 0 || render_pic[0].depth[y][x] != INFINITY || render_pic[0].length[y][x] != 0;
            } else {
                wrong += !(render_pic[0].depth[y][x] > 5) || !(render_pic[0].depth[y][x] < 30);
            }
        }
    CHECK_EQ_U64(wrong, 0);
    CHECK(empty > 100);
    render_scene_free(&s);
}

TEST(encoder) { /* sRGB bytes by table against the function */
    tetcasti_encoder e;
    uint32_t i, wrong = 0;
    tetcasti_encoder_open(&e);
    for (i = 0; i < 4096; i++) wrong += e.guess[i + 1] - e.guess[i] > 1;
    for (i = 0; i <= 300000; i++) {
        double x = i / 300000.0, y = tetcasti_linear_to_srgb(x) * 255;
        wrong += !(fabs(tetcasti_encode(&e, (float)x) - y) <= 0.5 + 1e-4);
    }
    CHECK_EQ_U64(wrong, 0);
    CHECK(tetcasti_encode(&e, -1) == 0 && tetcasti_encode(&e, 7) == 255 && tetcasti_encode(&e, NAN) == 0);
}

/* ---- isosurfaces ---- */

TEST(isosurface_of_a_plane) { /* a linear field: depth and colour of a plane, once per pixel, with either kind of normals */
    render_scene s;
    tetcast_mesh_info info;
    uint32_t k, x, y, i, wrong = 0, hits = 0;
    memset(&s, 0, sizeof s);
    tets_lattice(&s.t, 9, 9, 9, 6, NULL);
    tets_jitter(&s.t, 9, 9, 9, 0.4, 3);
    for (i = 0; i < s.t.nv; i++) s.t.s[i] = (float)(0.05 * s.t.p[3 * i] + 0.07 * s.t.p[3 * i + 1] + 0.02);
    s.mesh = tets_build(&s.t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(s.mesh != NULL);
    tetcast_mesh_get_info(s.mesh, &info);
    CHECK_EQ_U64(tetcast_mesh_make_gradients(s.mesh, NULL), TETCAST_OK);
    render_scene_optics(&s, TETCAST_MODEL_ISOSURFACE, 0.5f, 0);
    for (k = 0; k < 4; k++) {
        tetcast_render_desc d = render_defaults();
        d.isa = k & 1 ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        d.smooth_normals = k >> 1;
        render_look(&d, 16, 13, -12, 4, 4, 4);
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 1, &render_pic[k & 1], NULL), TETCAST_OK);
        if (k & 1) CHECK(memcmp(&render_pic[0], &render_pic[1], sizeof render_pic[0]) == 0);
        for (y = 0; y < RENDER_H; y++)
            for (x = 0; x < RENDER_W; x++) {
                tetcast_ray r;
                double t, p[3], forward[3], z = 0, inside = 1e300, n[3];
                uint32_t a;
                tetcast_camera_ray(&d.camera, RENDER_W, RENDER_H, x + 0.5, y + 0.5, &r);
                t = (0.48 - 0.05 * r.org[0] - 0.07 * r.org[1]) / (0.05 * r.dir[0] + 0.07 * r.dir[1]);
                for (a = 0; a < 3; a++) {
                    p[a] = r.org[a] + t * r.dir[a];
                    inside = fmin(inside, fmin(p[a], 8 - p[a]));
                    forward[a] = d.camera.at[a] - d.camera.eye[a];
                }
                ref_unit(forward);
                for (a = 0; a < 3; a++) z += t * r.dir[a] * forward[a];
                if (inside > 1e-4) {
                    hits++;
                    wrong += !(fabs((double)render_pic[k & 1].depth[y][x] - z) < 1e-4); /* values are floats: 3e-8 / 0.086 */
                    wrong += render_pic[k & 1].rgba[y][x][3] != 1.0f;
                    n[0] = 0.05 / sqrt(0.0074);
                    n[1] = 0.07 / sqrt(0.0074);
                    {   /* one light from the eye, highlight included */
                        double c = fabs(n[0] * r.dir[0] + n[1] * r.dir[1]);
                        wrong += !(fabs((double)render_pic[k & 1].rgba[y][x][0] - (0.8 * c + 0.3 * pow(c, 32))) < 3e-3);
                    }
                } else if (inside < -1e-4) {
                    wrong += render_pic[k & 1].rgba[y][x][3] != 0.0f || render_pic[k & 1].depth[y][x] != INFINITY;
                }
            }
    }
    CHECK_EQ_U64(wrong, 0);
    CHECK(hits > 500);
    render_scene_free(&s);
}

TEST(isovalue_of_vertices) { /* the value of whole planes of vertices: every pixel meets the surface once */
    render_scene s;
    tetcast_render_desc d = render_defaults();
    uint32_t i, x, y, k, wrong = 0;
    memset(&s, 0, sizeof s);
    tets_lattice(&s.t, 9, 9, 9, 5, NULL);
    for (i = 0; i < s.t.nv; i++) s.t.s[i] = (float)(s.t.p[3 * i + 2] / 8);
    s.mesh = tets_build(&s.t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(s.mesh != NULL);
    render_scene_optics(&s, TETCAST_MODEL_MIXED, 0.5f, 0); /* opacity 0.5; the volume: take it away */
    {
        tetcast_transfer_desc td;
        tetcast_isovalue v;
        tetcast_optics_desc od;
        memset(&td, 0, sizeof td);
        memset(&od, 0, sizeof od);
        memset(&v, 0, sizeof v);
        v.value = 0.5f;
        v.opacity = 0.5f;
        td.isovalues = &v;
        td.isovalue_count = 1;
        od.model = TETCAST_MODEL_ISOSURFACE;
        tetcast_optics_destroy(s.optics);
        tetcast_transfer_destroy(s.transfer);
        CHECK_EQ_U64(tetcast_transfer_create(&td, &s.transfer), TETCAST_OK);
        CHECK_EQ_U64(tetcast_optics_create(s.transfer, &od, &s.optics), TETCAST_OK);
    }
    for (k = 0; k < 4; k++) {
        render_look(&d, k == 0 ? 4 : 4.37, k < 2 ? 4 : 3.21, k == 3 ? -11 : 19, 4, 4, 4);
        d.camera.fov_y = 20;
        CHECK_EQ_U64(render_draw(&d, &s, 45, 45, 1, &render_pic[0], NULL), TETCAST_OK);
        for (y = 0; y < 45; y++)
            for (x = 0; x < 45; x++) wrong += render_pic[0].rgba[y][x][3] != 0.5f; /* not 0, not 0.75 */
    }
    CHECK_EQ_U64(wrong, 0);
    render_scene_free(&s);
}

/* ---- leaping ---- */

TEST(leaping) { /* clusters that show nothing are left out: the same picture but for rounding, fewer steps */
    uint32_t k, x, y, a, wrong = 0, n = test_quick() ? 16 : 28;
    for (k = 0; k < 8; k++) {
        render_scene s;
        tetcast_render_desc d = render_defaults();
        tetcast_render_stats with, without;
        tetcast_control_point p[6];
        tetcast_transfer_desc td;
        tetcast_optics_desc od;
        tetcast_isovalue v;
        double worst = 0;
        memset(&s, 0, sizeof s);
        memset(&with, 0, sizeof with);
        memset(&without, 0, sizeof without);
        memset(p, 0, sizeof p);
        memset(&td, 0, sizeof td);
        memset(&od, 0, sizeof od);
        memset(&v, 0, sizeof v);
        tets_lattice(&s.t, n, n, n, 6, NULL);
        tets_jitter(&s.t, n, n, n, 0.3, 4);
        s.mesh = tets_build(&s.t, (tetcast_cells)(k % TETCAST_CELLS_COUNT), NULL);
        REQUIRE(s.mesh != NULL);
        for (a = 0; a < 6; a++) {
            p[a].rgb[a % 3] = 1;
            p[a].extinction = 0.4f;
        }
        /* seen: values up to 0.15 and from 0.85 on */
        p[1].value = 0.15f;
        p[2].value = 0.2f;
        p[3].value = 0.8f;
        p[4].value = 0.85f;
        p[5].value = 1;
        p[2].extinction = p[3].extinction = 0;
        td.points = p;
        td.point_count = 6;
        v.value = 0.5f;
        v.opacity = 0.6f;
        v.rgb[1] = 1;
        if (k >= 6) {
            td.isovalues = &v;
            td.isovalue_count = 1;
            od.model = TETCAST_MODEL_MIXED;
        }
        CHECK_EQ_U64(tetcast_transfer_create(&td, &s.transfer), TETCAST_OK);
        CHECK_EQ_U64(tetcast_optics_create(s.transfer, &od, &s.optics), TETCAST_OK);
        if (k % 3 == 0) render_look(&d, 2.2 * n, 1.6 * n, -1.2 * n, n / 2.0, n / 2.0, n / 2.0);
        else if (k % 3 == 1) render_look(&d, n / 2.0, n / 2.0, n / 2.0, 0, 1, 2);            /* in the core, which is seen */
        else render_look(&d, n / 2.0 + 0.4 * n, n / 2.0, n / 2.0, 0.2 * n, 0.4 * n, 0.6 * n); /* in what is hidden */
        d.no_leaping = 1;
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 0, &render_pic[0], &without), TETCAST_OK);
        d.no_leaping = 0;
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 0, &render_pic[1], &with), TETCAST_OK);
        for (y = 0; y < RENDER_H; y++)
            for (x = 0; x < RENDER_W; x++)
                for (a = 0; a < 4; a++) {
                    double e = fabs((double)render_pic[0].rgba[y][x][a] - (double)render_pic[1].rgba[y][x][a]);
                    worst = fmax(worst, e);
                    wrong += !(e < 2e-5);
                }
        CHECK_MSG(wrong == 0, "case %u: %g", k, worst);
        CHECK_EQ_U64(without.leapt_faces, 0);
        if (n > 20 && k < 6) CHECK_MSG(with.leapt_faces > 0 && with.steps < without.steps * 9 / 10, "case %u: steps %llu, %llu", k,
                              (unsigned long long)with.steps, (unsigned long long)without.steps);
        d.isa = TETCAST_ISA_SCALAR;
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 0, &render_pic[0], NULL), TETCAST_OK);
        CHECK(memcmp(&render_pic[0], &render_pic[1], sizeof render_pic[0]) == 0);
        render_scene_free(&s);
    }
}

/* ---- early end ---- */

TEST(early_end) { /* never off by more than the light that is left; fewer steps the sooner it may end */
    static const float ends[5] = {-1, 0.001f, 0.01f, 0.1f, 0.4f};
    uint32_t k, x, y, a, wrong = 0;
    uint64_t last = 0;
    render_scene s;
    render_scene_make(&s, 12, 0, TETCAST_CELLS_TET16);
    REQUIRE(s.mesh != NULL);
    for (k = 0; k < 5; k++) {
        tetcast_render_desc d = render_defaults();
        tetcast_render_stats stats;
        memset(&stats, 0, sizeof stats);
        render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, ends[k]);
        render_look(&d, 24, 17, -13, 5, 5, 5);
        CHECK_EQ_U64(render_draw(&d, &s, RENDER_W, RENDER_H, 0, &render_pic[k != 0], &stats), TETCAST_OK);
        if (k == 0) CHECK_EQ_U64(stats.ended, 0);
        else
            for (y = 0; y < RENDER_H; y++)
                for (x = 0; x < RENDER_W; x++)
                    for (a = 0; a < 3; a++) wrong += !(fabsf(render_pic[0].rgba[y][x][a] - render_pic[1].rgba[y][x][a]) <= ends[k] * 1.0001f + 1e-6f);
        if (k >= 3) CHECK(stats.ended > 0 && stats.steps < last);
        last = stats.steps;
    }
    CHECK_EQ_U64(wrong, 0);
    render_scene_free(&s);
}

/* ---- camera ---- */

TEST(camera) {
    test_rng rng = test_rng_make(2);
    uint32_t k, i, a;
    for (k = 0; k < 200; k++) {
        tetcast_camera c;
        double lo[3], hi[3], view[3], forward[3];
        uint32_t w = 1 + test_rng_below(&rng, 900), h = 1 + test_rng_below(&rng, 900);
        memset(&c, 0, sizeof c);
        for (a = 0; a < 3; a++) {
            lo[a] = 100 * (test_rng_double(&rng) - 0.5);
            hi[a] = lo[a] + (k % 9 == a ? 0 : 30 * test_rng_double(&rng));
            view[a] = test_rng_double(&rng) - 0.5;
            c.up[a] = k & 1 ? test_rng_double(&rng) - 0.5 : 0;
        }
        if (k % 4 == 1) c.fov_y = 10 + 100 * test_rng_float(&rng);
        if (k % 4 == 2) c.ortho_height = 1;
        CHECK_EQ_U64(tetcast_camera_fit(&c, lo, hi, k & 2 ? view : NULL, w, h), TETCAST_OK);
        for (a = 0; a < 3; a++) forward[a] = c.at[a] - c.eye[a];
        ref_unit(forward);
        for (i = 0; i < 8; i++) { /* every corner is in the picture: between the rays of its sides */
            tetcast_ray mid, side, above;
            double p[3], z = 0, x = 0, y = 0, r[3], u[3], rr = 0, uu = 0;
            tetcast_camera_ray(&c, w, h, 0.5 * w, 0.5 * h, &mid);
            tetcast_camera_ray(&c, w, h, w, 0.5 * h, &side);
            tetcast_camera_ray(&c, w, h, 0.5 * w, 0, &above);
            for (a = 0; a < 3; a++) {
                p[a] = (i >> a & 1u ? hi[a] : lo[a]) - c.eye[a];
                z += p[a] * forward[a];
            }
            if (c.ortho_height > 0) {
                for (a = 0; a < 3; a++) {
                    r[a] = side.org[a] - mid.org[a];
                    u[a] = above.org[a] - mid.org[a];
                }
                CHECK(z > 0); /* in front of the eye */
                z = 1;
            } else {
                double s = 0, t = 0;
                for (a = 0; a < 3; a++) {
                    s += side.dir[a] * forward[a];
                    t += above.dir[a] * forward[a];
                }
                for (a = 0; a < 3; a++) {
                    r[a] = side.dir[a] / s - forward[a];
                    u[a] = above.dir[a] / t - forward[a];
                }
            }
            for (a = 0; a < 3; a++) {
                x += p[a] * r[a];
                y += p[a] * u[a];
                rr += r[a] * r[a];
                uu += u[a] * u[a];
            }
            CHECK(z > 0);
            CHECK(fabs(x / rr / z) < 1 && fabs(y / uu / z) < 1);
        }
    }
}

TEST(camera_refusals) {
    tetcast_camera c;
    tetcast_ray r;
    double lo[3] = {0, 0, 0}, hi[3] = {1, 1, 1};
    uint32_t k, a;
    memset(&c, 0, sizeof c);
    CHECK_EQ_U64(tetcast_camera_ray(&c, 10, 10, 0, 0, &r), TETCAST_ERR_INVALID_ARG);
    c.fov_y = 180;
    CHECK_EQ_U64(tetcast_camera_fit(&c, lo, hi, NULL, 10, 10), TETCAST_ERR_INVALID_ARG);
    c.fov_y = 40;
    lo[0] = (double)NAN;
    CHECK_EQ_U64(tetcast_camera_fit(&c, lo, hi, NULL, 10, 10), TETCAST_ERR_INVALID_ARG);
    lo[0] = 2;
    CHECK_EQ_U64(tetcast_camera_fit(&c, lo, hi, NULL, 10, 10), TETCAST_ERR_INVALID_ARG);
    lo[0] = 0;
    c.ortho_height = -1;
    CHECK_EQ_U64(tetcast_camera_fit(&c, lo, hi, NULL, 10, 10), TETCAST_ERR_INVALID_ARG);
    c.ortho_height = NAN;
    CHECK_EQ_U64(tetcast_camera_fit(&c, lo, hi, NULL, 10, 10), TETCAST_ERR_INVALID_ARG);
    c.ortho_height = 0;
    CHECK_EQ_U64(tetcast_camera_fit(&c, lo, hi, NULL, 10, 10), TETCAST_OK);
    for (k = 0; k < 5; k++) { /* boxes that numbers hold, but not the camera that would see them: it stays as it was */
        static const double half[5] = {1e307, 1e305, 1e39, 1e-50, 1};
        tetcast_camera was = c, tried = c;
        double from[3], to[3];
        for (a = 0; a < 3; a++) {
            from[a] = -half[k];
            to[a] = half[k];
        }
        was.fov_y = k == 0 ? 1.0f : k == 1 ? 0.01f : 0.0f;
        was.ortho_height = k == 2 || k == 3 ? 1.0f : 0.0f;
        was.up[0] = k == 4 ? (double)NAN : 0;
        tried = was;
        CHECK_EQ_U64(tetcast_camera_fit(&tried, from, to, NULL, 10, 10), TETCAST_ERR_INVALID_ARG);
        CHECK(memcmp(&tried, &was, sizeof was) == 0);
        tried.fov_y = 40; /* what is too far or too large for one view is not for another */
        tried.ortho_height = 0;
        tried.up[0] = 0;
        CHECK_EQ_U64(tetcast_camera_fit(&tried, from, to, NULL, 10, 10), TETCAST_OK);
        CHECK_EQ_U64(tetcast_camera_ray(&tried, 10, 10, 5, 5, &r), TETCAST_OK);
    }
    r.dir[0] = 7;
    CHECK_EQ_U64(tetcast_camera_ray(&c, 10, 0, 0, 0, &r), TETCAST_ERR_INVALID_ARG);
    CHECK(r.dir[0] == 0);
    CHECK_EQ_U64(tetcast_camera_ray(&c, 10, 10, (double)NAN, 0, &r), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_camera_ray(&c, 10, 10, 0, (double)INFINITY, &r), TETCAST_ERR_INVALID_ARG);
    c.ortho_height = 6; /* finite, but where the ray begins is not */
    CHECK_EQ_U64(tetcast_camera_ray(&c, 1, 1, 1.7e308, 0, &r), TETCAST_ERR_INVALID_ARG);
    CHECK(r.org[0] == 0 && r.dir[0] == 0);
    c.ortho_height = 0;
    c.fov_y = 170;
    CHECK_EQ_U64(tetcast_camera_ray(&c, 1, 1, 1.7e308, 0, &r), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_camera_ray(&c, 1, 1, 1e300, 0, &r), TETCAST_OK);
    CHECK_NEAR(r.dir[0] * r.dir[0] + r.dir[1] * r.dir[1] + r.dir[2] * r.dir[2], 1, 1e-12);
}

/* ---- arguments, memory ---- */

static int render_cancel(void *user, uint64_t done, uint64_t total) {
    (void)total;
    return done >= *(uint64_t *)user;
}

TEST(arguments) {
    render_scene s;
    tetcast_render_desc d = render_defaults();
    tetcast_image im;
    uint64_t at = 1;
    render_scene_make(&s, 5, 0, TETCAST_CELLS_TET16);
    REQUIRE(s.mesh != NULL);
    render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 0);
    memset(&im, 0, sizeof im);
    im.width = im.height = 40;
    CHECK_EQ_U64(tetcast_render(&d, NULL, s.optics, &im, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, NULL, &im, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, NULL, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_render(NULL, s.mesh, s.optics, &im, NULL), TETCAST_OK);
    d.traverse_only = 1;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, NULL, &im, NULL), TETCAST_OK);
    d = render_defaults();
    d._end_zero = 3;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_UNINIT_DESC);
    d = render_defaults();
    d.smooth_normals = 1; /* without gradients */
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_INVALID_ARG);
    d = render_defaults();
    d.background[1] = NAN;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_INVALID_ARG);
    d = render_defaults();
    d.clip_near = -1;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_INVALID_ARG);
    d = render_defaults();
    d.camera.eye[0] = (double)INFINITY;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_INVALID_ARG);
    d = render_defaults();
    d.isa = (tetcast_isa)9;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_INVALID_ARG);
    d = render_defaults();
    im.width = 200;
    d.env.progress_fn = render_cancel;
    d.env.progress_user = &at;
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_ERR_CANCELLED);
    render_scene_free(&s);
}

TEST(memory) { /* each allocation fails once */
    render_scene s;
    int64_t k;
    render_scene_make(&s, 14, 1, TETCAST_CELLS_TET16);
    REQUIRE(s.mesh != NULL);
    render_scene_optics(&s, TETCAST_MODEL_VOLUME, -1, 0);
    for (k = 0;; k++) {
        test_alloc ta;
        tetcast_render_desc d = render_defaults();
        tetcast_result r;
        test_alloc_init(&ta);
        ta.fail_at = k;
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        render_look(&d, 24, 17, -13, 5, 5, 5);
        r = render_draw(&d, &s, RENDER_W, RENDER_H, 0, &render_pic[0], NULL);
        test_alloc_check(&ta);
        if (ta.failed == 0) {
            CHECK_EQ_U64(r, TETCAST_OK);
            break;
        }
        CHECK(r == TETCAST_ERR_NO_MEMORY || r == TETCAST_OK); /* without leaping it is only slower */
    }
    CHECK(k >= 4);
    for (k = 0;; k++) {
        test_alloc ta;
        tetcast_render_desc d = render_defaults();
        tetcast_ray ray;
        tetcast_ray_result got;
        tetcast_result r;
        test_alloc_init(&ta);
        ta.fail_at = k;
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        memset(&ray, 0, sizeof ray);
        ray.org[0] = ray.org[1] = 4.5;
        ray.org[2] = -3;
        ray.dir[2] = 1;
        r = tetcast_cast(&d, s.mesh, s.optics, &ray, 1, &got, NULL);
        test_alloc_check(&ta);
        if (r == TETCAST_OK) break;
        CHECK_EQ_U64(r, TETCAST_ERR_NO_MEMORY);
    }
    CHECK(k >= 2);
    render_scene_free(&s);
}

/* ---- real meshes ---- */

/* A stretch of a pixel's ray inside of a tetrahedron. */
typedef struct brute_part { uint32_t pixel; float front, back; double t0, t1; } brute_part;

static int brute_compare(const void *a, const void *b) {
    const brute_part *x = (const brute_part *)a, *y = (const brute_part *)b;
    if (x->pixel != y->pixel) return x->pixel < y->pixel ? -1 : 1;
    return (x->t0 > y->t0) - (x->t0 < y->t0);
}

typedef struct brute_list { brute_part *part; size_t count, room; } brute_list;

/* The rays of rows [y0, y1) through one tetrahedron, p and s: every pixel of its box by four half spaces. */
static void brute_tet(brute_list *l, const tetcast_camera *c, uint32_t width, uint32_t height, uint32_t y0, uint32_t y1, double p[4][3],
                      const double s[4]) {
    double forward[3], right[3], up[3] = {0, 1, 0}, n[4][3], at[4], g[3], e[3][3], det, lo[2] = {1e300, 1e300}, hi[2] = {-1e300, -1e300};
    double half = tan((double)c->fov_y * 3.14159265358979323846 / 360), behind = 0;
    uint32_t i, k, x, y;
    for (k = 0; k < 3; k++) forward[k] = c->at[k] - c->eye[k];
    ref_unit(forward);
    for (k = 0; k < 3; k++) right[k] = forward[(k + 1) % 3] * up[(k + 2) % 3] - forward[(k + 2) % 3] * up[(k + 1) % 3];
    ref_unit(right);
    for (k = 0; k < 3; k++) up[k] = right[(k + 1) % 3] * forward[(k + 2) % 3] - right[(k + 2) % 3] * forward[(k + 1) % 3];
    for (i = 0; i < 4; i++) {
        double q[3] = {0, 0, 0};
        for (k = 0; k < 3; k++) {
            double v = p[i][k] - c->eye[k];
            q[0] += v * right[k];
            q[1] += v * up[k];
            q[2] += v * forward[k];
        }
        if (!(q[2] > 1e-9)) behind = 1;
        q[0] = 0.5 * width + q[0] / q[2] / half * 0.5 * height;
        q[1] = 0.5 * height - q[1] / q[2] / half * 0.5 * height;
        for (k = 0; k < 2; k++) {
            lo[k] = fmin(lo[k], q[k] - 1);
            hi[k] = fmax(hi[k], q[k] + 1);
        }
    }
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++) e[i][k] = p[i + 1][k] - p[0][k];
    det = 0;
    for (k = 0; k < 3; k++) det += e[0][k] * (e[1][(k + 1) % 3] * e[2][(k + 2) % 3] - e[1][(k + 2) % 3] * e[2][(k + 1) % 3]);
    if (det == 0 || behind != 0) return;
    for (k = 0; k < 3; k++) {
        g[k] = 0;
        for (i = 0; i < 3; i++) {
            const double *a = e[(i + 1) % 3], *b = e[(i + 2) % 3];
            g[k] += (s[i + 1] - s[0]) * (a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]) / det;
        }
    }
    for (i = 0; i < 4; i++) { /* inside is n . x >= at, from the eye */
        const double *a = p[(i + 1) & 3], *b = p[(i + 2) & 3], *d = p[(i + 3) & 3];
        double side = 0;
        at[i] = 0;
        for (k = 0; k < 3; k++) {
            uint32_t u = (k + 1) % 3, v = (k + 2) % 3;
            n[i][k] = (b[u] - a[u]) * (d[v] - a[v]) - (b[v] - a[v]) * (d[u] - a[u]);
            side += n[i][k] * (p[i][k] - a[k]);
        }
        for (k = 0; k < 3; k++) {
            if (side < 0) n[i][k] = -n[i][k];
            at[i] += n[i][k] * (a[k] - c->eye[k]);
        }
    }
    for (y = lo[1] > y0 ? (uint32_t)lo[1] : y0; y < y1 && y < hi[1]; y++)
        for (x = lo[0] > 0 ? (uint32_t)lo[0] : 0; x < width && x < hi[0]; x++) {
            double t0 = 0, t1 = 1e300, d[3], value[2];
            double u = (x + 0.5 - 0.5 * width) / (0.5 * height) * half, v = (0.5 * height - (y + 0.5)) / (0.5 * height) * half;
            for (k = 0; k < 3; k++) d[k] = forward[k] + u * right[k] + v * up[k];
            ref_unit(d);
            for (i = 0; i < 4 && t0 < t1; i++) {
                double dn = n[i][0] * d[0] + n[i][1] * d[1] + n[i][2] * d[2];
                if (dn > 0) t0 = fmax(t0, at[i] / dn);
                else if (dn < 0) t1 = fmin(t1, at[i] / dn);
                else if (at[i] > 0) t1 = -1;
            }
            if (!(t0 < t1)) continue;
            for (i = 0; i < 2; i++) {
                double t = i ? t1 : t0;
                value[i] = s[0];
                for (k = 0; k < 3; k++) value[i] += g[k] * (c->eye[k] + t * d[k] - p[0][k]);
            }
            if (l->count == l->room) {
                l->room = 2 * l->room + 4096;
                l->part = (brute_part *)realloc(l->part, l->room * sizeof *l->part);
                if (l->part == NULL) abort();
            }
            l->part[l->count].pixel = y * width + x;
            l->part[l->count].t0 = t0;
            l->part[l->count].t1 = t1;
            l->part[l->count].front = (float)value[0];
            l->part[l->count++].back = (float)value[1];
        }
}

/* Rows [y0, y1) of the picture of a mesh with the eye outside: all tetrahedra, in no order, then every pixel sorted by
   distance. rgba and length are of the whole picture. */
static void brute_rows(const tetcast_mesh *m, const tetcast_camera *c, uint32_t width, uint32_t height, uint32_t y0, uint32_t y1,
                       const tetcast_optics *o, float *rgba, float *length) {
    brute_list l;
    tetcast_segment *segment = (tetcast_segment *)calloc(100000, sizeof *segment);
    uint32_t i, k;
    size_t from, to;
    memset(&l, 0, sizeof l);
    REQUIRE(segment != NULL);
    memset(rgba + (size_t)y0 * width * 4, 0, (size_t)(y1 - y0) * width * 16);
    memset(length + (size_t)y0 * width, 0, (size_t)(y1 - y0) * width * 4);
    for (i = 0; i < m->cell_count; i++) {
        double p[4][3], s[4];
        uint32_t v[4];
        CHECK_EQ_U64(tetcast_mesh_cell(m, i, v, NULL), TETCAST_OK);
        for (k = 0; k < 4; k++) {
            float value;
            tetcast_mesh_vertex(m, v[k], p[k], &value, NULL);
            s[k] = (double)value;
        }
        brute_tet(&l, c, width, height, y0, y1, p, s);
    }
    qsort(l.part, l.count, sizeof *l.part, brute_compare);
    for (from = 0; from < l.count; from = to) {
        double sum = 0;
        uint32_t n = 0;
        for (to = from; to < l.count && l.part[to].pixel == l.part[from].pixel && n < 100000; to++, n++) {
            segment[n].front = l.part[to].front;
            segment[n].back = l.part[to].back;
            segment[n].length = (float)(l.part[to].t1 - l.part[to].t0);
            segment[n].depth = (float)l.part[to].t0;
            sum += l.part[to].t1 - l.part[to].t0;
        }
        length[l.part[from].pixel] = (float)sum;
        CHECK_EQ_U64(tetcast_optics_ray(o, segment, n, rgba + 4 * (size_t)l.part[from].pixel, NULL), TETCAST_OK);
    }
    free(l.part);
    free(segment);
}

static tetcast_mesh *real_build(const sup_volume *v, tetcast_cells cells, float *lo, float *hi) {
    tetcast_mesh_desc d;
    tetcast_field f;
    tetcast_mesh *m = NULL;
    memset(&d, 0, sizeof d);
    memset(&f, 0, sizeof f);
    d.cells = cells;
    f.values.data = v->fields[0].values;
    f.values.stride = v->fields[0].components * sizeof(float);
    if (v->dims[0] != 0) {
        tetcast_grid g;
        memset(&g, 0, sizeof g);
        memcpy(g.dims, v->dims, sizeof g.dims);
        g.positions.data = v->points;
        g.positions.type = TETCAST_TYPE_F64;
        g.fields = &f;
        g.field_count = 1;
        CHECK_EQ_U64(tetcast_mesh_create_grid(&d, &g, NULL, &m), TETCAST_OK);
    } else {
        tetcast_input in;
        memset(&in, 0, sizeof in);
        in.positions.data = v->points;
        in.positions.type = TETCAST_TYPE_F64;
        in.vertex_count = v->point_count;
        in.indices = v->indices;
        in.index_count = v->index_count;
        in.shapes = v->shapes;
        in.cell_count = v->cell_count;
        in.fields = &f;
        in.field_count = 1;
        CHECK_EQ_U64(tetcast_mesh_create(&d, &in, NULL, &m), TETCAST_OK);
    }
    if (m != NULL) (void)tetcast_mesh_field(m, 0, lo, hi);
    return m;
}

/* A picture of size x size pixels against the brute one, and all forms against each other. */
static void check_real(const char *name, uint32_t size, uint64_t least_cells) {
    char file[64];
    const char *path;
    sup_volume volume;
    sup_error err;
    render_scene s;
    tetcast_render_desc d = render_defaults();
    tetcast_image im;
    tetcast_mesh_info info;
    tetcast_control_point p[5];
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    float lo = 0, hi = 1, *got[3], *length[3];
    double big = 0, worst = 0, worst_length = 0;
    uint32_t i, k, kind, wrong = 0, hits = 0, band = size < 256 ? size : 32;
    (void)snprintf(file, sizeof file, "tets/%s", name);
    path = test_data_path(file);
    memset(&volume, 0, sizeof volume);
    memset(&s, 0, sizeof s);
    if (path == NULL || sup_volume_read(path, &volume, &err)) {
        CHECK_MSG(path == NULL, "%s cannot be read", name);
        return;
    }
    for (k = 0; k < 3; k++) {
        got[k] = (float *)malloc((size_t)size * size * 16);
        length[k] = (float *)malloc((size_t)size * size * 4);
        REQUIRE(got[k] != NULL && length[k] != NULL);
    }
    s.mesh = real_build(&volume, TETCAST_CELLS_TET16, &lo, &hi);
    REQUIRE(s.mesh != NULL);
    tetcast_mesh_get_info(s.mesh, &info);
    CHECK(info.cell_count >= least_cells);
    for (k = 0; k < 3; k++) big += info.box_max[k] - info.box_min[k];
    memset(p, 0, sizeof p);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    for (k = 0; k < 5; k++) {
        p[k].value = lo + 0.25f * (float)k * (hi - lo);
        p[k].rgb[k % 3] = p[k].rgb[(k / 2) % 3] = 1;
        p[k].extinction = (float)(8 / big * (k & 1 ? 0.2 : 1));
    }
    td.points = p;
    td.point_count = 5;
    od.t_min = -1; /* to the end */
    CHECK_EQ_U64(tetcast_transfer_create(&td, &s.transfer), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(s.transfer, &od, &s.optics), TETCAST_OK);
    CHECK_EQ_U64(tetcast_camera_fit(&d.camera, info.box_min, info.box_max, NULL, size, size), TETCAST_OK);
    if (d.camera.fov_y == 0.0f) d.camera.fov_y = 40;
    memset(&im, 0, sizeof im);
    im.width = im.height = size;
    im.rgba = got[0];
    im.length = length[0];
    CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_OK);
    for (i = 0; i < size; i += band)
        brute_rows(s.mesh, &d.camera, size, size, i, i + band < size ? i + band : size, s.optics, got[1], length[1]);
    for (i = 0; i < size * size; i++) {
        double e = 0;
        for (k = 0; k < 4; k++) e = fmax(e, fabs((double)got[0][4 * i + k] - (double)got[1][4 * i + k]));
        hits += length[1][i] > 0;
        /* a face of the hull edge-on: how long the ray is inside depends on the last bit of the vertices */
        wrong += e > 1e-4 || fabs((double)length[0][i] - (double)length[1][i]) > 1e-4 * big;
        worst = fmax(worst, e);
        worst_length = fmax(worst_length, fabs((double)length[0][i] - (double)length[1][i]) / big);
    }
    CHECK_MSG(wrong == 0, "%s: %u of %u pixels differ, by up to %g, lengths by %g", name, wrong, hits, worst, worst_length);
    CHECK(hits > size * size / 10);
    for (kind = 0; kind < TETCAST_CELLS_COUNT; kind++) {
        tetcast_mesh_destroy(s.mesh);
        s.mesh = real_build(&volume, (tetcast_cells)kind, &lo, &hi);
        REQUIRE(s.mesh != NULL);
        im.rgba = got[2];
        im.length = length[2];
        for (k = 0; k < 2; k++) {
            d.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
            if (k == 0 && kind % 3 != 1) continue;
            CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &im, NULL), TETCAST_OK);
            CHECK_MSG(memcmp(got[0], got[2], (size_t)size * size * 16) == 0 && memcmp(length[0], length[2], (size_t)size * size * 4) == 0,
                      "%s, form %u", name, kind);
        }
    }
    if (test_g.verbose) printf("  %s: %u pixels, worst %g, lengths %g\n", name, hits, worst, worst_length);
    for (k = 0; k < 3; k++) {
        free(got[k]);
        free(length[k]);
    }
    sup_volume_free(&volume);
    render_scene_free(&s);
}

#ifndef REAL_SIZE
#  define REAL_SIZE (test_quick() ? 24u : 60u)
#endif

TEST(real_meshes) { /* Blunt fin, SPX, 208,000 cells between random points: all pixels against all tetrahedra, in all forms */
    if (test_data_path("tets/bluntfinxyz.bin") == NULL) SKIP("no data");
    check_real("bluntfinxyz.bin", REAL_SIZE, 224000);
    check_real("spx.inp", REAL_SIZE, 12000);
    check_real("delaunay_208k.vtk", REAL_SIZE, 207788);
}

/* ---- tolerance ---- */

/* A transfer function of 2 to 200 points: ramps, waves, peaks, jumps; colours up to 1. */
static size_t random_function(test_rng *r, tetcast_control_point *p) {
    const uint32_t kind = test_rng_below(r, 4), n = kind == 0 ? 2 + test_rng_below(r, 6) : 20 + test_rng_below(r, 180);
    const float strength = 0.2f * powf(200.0f, test_rng_float(r)), wave = 3 + 20 * test_rng_float(r);
    const float at = test_rng_float(r), width = 0.03f + 0.2f * test_rng_float(r);
    float level = 0;
    uint32_t i, c;
    for (i = 0; i < n; i++) {
        const float x = (float)i / (float)(n - 1), u = (x - at) / width;
        p[i].value = x;
        for (c = 0; c < 3; c++)
            p[i].rgb[c] = kind == 0 ? test_rng_float(r) : 0.5f + 0.5f * sinf(wave * x + 2.1f * (float)c);
        switch (kind) {
        case 0: p[i].extinction = test_rng_below(r, 3) == 0 ? 0 : strength * test_rng_float(r); break;
        case 1: p[i].extinction = strength * expf(-u * u); break;
        case 2: p[i].extinction = strength * (0.5f + 0.5f * cosf(wave * x)) * x; break;
        default:
            if (test_rng_below(r, 20) == 0) level = test_rng_float(r);
            p[i].extinction = strength * level * x;
            break;
        }
        if (i > 0 && i + 2 < n && kind == 0 && test_rng_below(r, 4) == 0) { /* a jump: the same value twice */
            p[i + 1] = p[i];
            p[i + 1].extinction = strength * test_rng_float(r);
            i++;
        }
    }
    return n;
}

/* Leaves out two cells of five at random: holes, gaps, parts on their own. */
static void few_cells(tets *t, test_rng *r) {
    size_t i, n = 0;
    for (i = 0; i < t->nt; i++) {
        if (test_rng_below(r, 5) < 2) continue;
        memmove(t->t + 4 * n, t->t + 4 * i, 4 * sizeof *t->t);
        n++;
    }
    t->nt = n;
}

TEST(tolerance_of_pictures) { /* random meshes, fields, functions, cameras, ways: no pixel is off by more than allowed */
    enum { SIDE = 11 };
    static tetcast_control_point p[256];
    static float rgba[SIDE * SIDE * 4];
    static const float allowed[6] = {0.1f, 0.3f, 1, 3, 8, 20};
    test_rng r = test_rng_make(4711);
    const int count = test_quick() ? 24 : 240;
    oracle_cells list;
    int k, tight = 0, shorter = 0;
    memset(&list, 0, sizeof list);
    for (k = 0; k < count; k++) {
        const uint32_t n = 4 + test_rng_below(&r, 5);
        const double middle = 0.5 * (n - 1);
        double worst = 0, wave = 1 + 4 * test_rng_double(&r);
        tetcast_transfer_desc td;
        tetcast_optics_desc od;
        tetcast_optics_info info;
        tetcast_image image;
        tetcast_mesh_info about;
        render_scene s;
        tetcast_render_desc d = render_defaults();
        size_t i, points = random_function(&r, p);
        uint32_t x, y, c, a;
        memset(&s, 0, sizeof s);
        memset(&td, 0, sizeof td);
        memset(&od, 0, sizeof od);
        memset(&image, 0, sizeof image);
        tets_lattice(&s.t, n, n, n, test_rng_below(&r, 2) ? 5 : 6, NULL);
        tets_jitter(&s.t, n - 1, n - 1, n - 1, 0.3, 100 + (uint64_t)k);
        tets_round(&s.t);
        if (k % 4 == 3) few_cells(&s.t, &r);
        for (i = 0; i < s.t.nv; i++) {
            const double *q = s.t.p + 3 * i;
            s.t.s[i] = (float)(0.5 + 0.3 * sin(wave * q[0] / middle + q[1]) + 0.2 * cos(2 * q[2] / middle) +
                               0.1 * (test_rng_double(&r) - 0.5));
        }
        s.mesh = tets_build(&s.t, (tetcast_cells)(k % 7), NULL);
        REQUIRE(s.mesh != NULL);
        td.points = p;
        td.point_count = points;
        td.color_mode = k / 6 % 4 == 3 ? TETCAST_COLOR_INDEPENDENT : TETCAST_COLOR_ASSOCIATED;
        td.extinction_scale = (float)(1.0 / middle);
        od.tolerance = allowed[k % 6] * (0.5f + test_rng_float(&r));
        od.path_length = 0;
        tetcast_mesh_get_info(s.mesh, &about);
        for (a = 0; a < 3; a++) od.path_length += (float)pow(about.box_max[a] - about.box_min[a], 2);
        od.path_length = sqrtf(od.path_length);
        CHECK_EQ_U64(tetcast_transfer_create(&td, &s.transfer), TETCAST_OK);
        CHECK_EQ_U64(tetcast_optics_create(s.transfer, &od, &s.optics), TETCAST_OK);
        tetcast_optics_get_info(s.optics, &info);
        for (i = 0; i < points; i++) {
            p[i].extinction *= td.extinction_scale;
            for (c = 0; c < 3 && td.color_mode == TETCAST_COLOR_INDEPENDENT; c++) p[i].rgb[c] *= td.extinction_scale;
        }
        CHECK(info.bound > 0 && info.bound <= od.tolerance * 1.0001f);
        CHECK(info.knot_count <= points);
        render_look(&d, middle * (4 * test_rng_double(&r) - 1), middle * (4 * test_rng_double(&r) - 1), /* on any side, or inside */
             middle * (4 * test_rng_double(&r) - 1), middle * (0.5 + test_rng_double(&r)), middle * (0.5 + test_rng_double(&r)),
             middle * (0.5 + test_rng_double(&r)));
        d.camera.fov_y = 20 + 70 * test_rng_float(&r);
        if (k % 5 == 4) d.camera.ortho_height = (float)(2.5 * middle);
        d.method = (tetcast_method)(k % 3);
        image.width = image.height = SIDE;
        image.rgba = rgba;
        CHECK_EQ_U64(tetcast_render(&d, s.mesh, s.optics, &image, NULL), TETCAST_OK);
        for (y = 0; y < SIDE; y++)
            for (x = 0; x < SIDE; x++) {
                tetcast_ray ray;
                double want[4];
                CHECK_EQ_U64(tetcast_camera_ray(&d.camera, SIDE, SIDE, x + 0.5, y + 0.5, &ray), TETCAST_OK);
                oracle_ray(NULL, &s.t, p, points, td.color_mode == TETCAST_COLOR_INDEPENDENT, &ray, &list, want);
                for (c = 0; c < 4; c++) worst = fmax(worst, 255 * fabs((double)rgba[4 * (SIDE * y + x) + c] - want[c]));
            }
        CHECK_MSG(worst <= (double)info.bound, "scene %d: tolerance %g, bound %g, error %g", k, (double)od.tolerance,
                  (double)info.bound, worst);
        tight += worst > 0.1 * (double)od.tolerance;
        shorter += info.knot_count < points;
        if (getenv("TEST_PRINT") != NULL)
            printf("tolerance %5.2f bound %.4f error %.5f knots %u of %u t_min %.2g\n", (double)od.tolerance,
                   (double)info.bound, worst, info.knot_count, (uint32_t)points, (double)info.t_min);
        render_scene_free(&s);
    }
    free(list.visit);
    CHECK(tight * 5 > count && shorter * 5 > count); /* it does use what it is allowed */
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(same_bits);
    RUN(forms);
    RUN(pixels_are_rays);
    RUN(million_rays);
    RUN(symmetric_views);
    RUN(eye_inside);
    RUN(eye_in_tangled_cells);
    RUN(wide_angles);
    RUN(narrow_views);
    RUN(sizes);
    RUN(background_and_bytes);
    RUN(encoder);
    RUN(isosurface_of_a_plane);
    RUN(isovalue_of_vertices);
    RUN(leaping);
    RUN(early_end);
    RUN(camera);
    RUN(camera_refusals);
    RUN(arguments);
    RUN(memory);
    RUN(real_meshes);
    RUN(tolerance_of_pictures);
    return test_end();
}
