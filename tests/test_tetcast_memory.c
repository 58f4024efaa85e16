/* test_tetcast_memory.c - every function that asks for memory, with each request refused once and with all from one on:
   NO_MEMORY, nothing leaks, what the caller had is as before; and outputs that no other test asks for.
   SPDX-License-Identifier: MIT OR Unlicense */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"

enum { SIDE = 24, POINTS = 20, GRID = 5, FILE_ROOM = 1 << 16 };

/* What the calls work on, made before with memory enough. */
typedef struct world {
    tets t, large;             /* the second is long, in no order, and half of it shows nothing */
    uint8_t *masks;            /* of the second */
    tetcast_mesh *mesh;
    tetcast_transfer *transfer, *other;
    tetcast_optics *optics, *table, *surface;
    tetcast_lattice lattice;
    tetcast_bricks *bricks, *hull_bricks;
    tetcast_cut *cut;
    tetcast_amr *amr;
    tetcast_rbf *rbf;
    float grid[GRID * GRID * GRID], patch[64], out[4 * SIDE * SIDE * SIDE];
    double points[POINTS][3];
    uint8_t rgba8[SIDE * SIDE * 4], file[FILE_ROOM];
    float rgba[SIDE * SIDE * 4], depth[SIDE * SIDE], length[SIDE * SIDE], limit[SIDE * SIDE];
    uint32_t steps[SIDE * SIDE];
    tetcast_image image;
} world;

static void colours(tetcast_control_point p[3], float extinction) {
    int i;
    memset(p, 0, 3 * sizeof *p);
    for (i = 0; i < 3; i++) {
        p[i].value = 0.5f * (float)i;
        p[i].rgb[i] = 1.0f;
        p[i].extinction = (float)i * extinction;
    }
}

static tetcast_rbf_desc functions_desc(tetcast_rbf_function f[40], uint32_t components) {
    tetcast_rbf_desc d;
    test_rng r = test_rng_make(5);
    int i, a;
    memset(&d, 0, sizeof d);
    memset(f, 0, 40 * sizeof *f);
    for (i = 0; i < 40; i++) {
        for (a = 0; a < 3; a++) {
            f[i].centre[a] = test_rng_double(&r);
            f[i].weight[a] = test_rng_float(&r) - 0.3f;
            f[i].axis[a] = i % 3 == 0 ? test_rng_double(&r) + 0.1 : 0;
        }
        f[i].width = 0.05 + 0.1 * test_rng_double(&r);
        f[i].stretch = i % 3 == 0 ? 0.5 : 0;
    }
    for (a = 0; a < 3; a++) d.box_max[a] = 1;
    d.components = components;
    d.offset[0] = 0.2f;
    d.functions = f;
    d.function_count = 40;
    return d;
}

static tetcast_amr_desc amr_desc(world *w, tetcast_patch patch[2]) {
    tetcast_amr_desc d;
    int a;
    memset(&d, 0, sizeof d);
    memset(patch, 0, 2 * sizeof *patch);
    for (a = 0; a < 3; a++) {
        d.cells[a] = 4;
        patch[0].dims[a] = 4;
        patch[1].dims[a] = 2;
        patch[1].lo[a] = 2;
    }
    patch[1].level = 1;
    patch[0].values = patch[1].values = w->patch;
    d.patches = patch;
    d.patch_count = 2;
    return d;
}

static void world_open(world *w) {
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_bricks_desc bd;
    tetcast_isovalue iso;
    tetcast_array values;
    tetcast_control_point p[3];
    tetcast_rbf_function f[40];
    tetcast_rbf_desc rd;
    tetcast_amr_desc ad;
    tetcast_patch patch[2];
    test_rng r = test_rng_make(77);
    size_t i;
    int a;
    memset(w, 0, sizeof *w);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    memset(&bd, 0, sizeof bd);
    memset(&iso, 0, sizeof iso);
    memset(&values, 0, sizeof values);
    tets_lattice(&w->t, 4, 4, 4, 6, NULL);
    tets_jitter(&w->t, 3, 3, 3, 0.2, 3);
    for (i = 0; i < w->t.nv; i++) w->t.s[i] = test_rng_float(&r);
    for (i = 0; i < GRID * GRID * GRID; i++) w->grid[i] = test_rng_float(&r);
    for (i = 0; i < 64; i++) w->patch[i] = test_rng_float(&r);
    for (i = 0; i < POINTS; i++)
        for (a = 0; a < 3; a++) w->points[i][a] = 0.1 + 0.8 * test_rng_double(&r);
    for (i = 0; i < SIDE * SIDE; i++) w->limit[i] = INFINITY;
    w->mesh = tets_build(&w->t, TETCAST_CELLS_TET16, NULL);
    tets_lattice(&w->large, 100, 2, 2, 6, NULL);
    for (i = 0; i < w->large.nv; i++) w->large.s[i] = w->large.p[3 * i] < 60.5 ? 0.0f : test_rng_float(&r);
    tets_shuffle(&w->large, 9);
    w->masks = (uint8_t *)calloc(w->large.nt, 1);
    for (i = 0; i < w->large.nt && w->masks != NULL; i += 3) w->masks[i] = 1;
    colours(p, 2.0f);
    td.points = p;
    td.point_count = 3;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &w->transfer), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(w->transfer, NULL, &w->optics), TETCAST_OK);
    od.integrator = TETCAST_INTEGRATOR_TABLE_3D;
    od.table_values = 16;
    od.table_lengths = 8;
    od.longest = 2;
    CHECK_EQ_U64(tetcast_optics_create(w->transfer, &od, &w->table), TETCAST_OK);
    p[1].extinction = 1.5f;
    iso.value = 0.5f;
    iso.opacity = 0.5f;
    td.isovalues = &iso;
    td.isovalue_count = 1;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &w->other), TETCAST_OK);
    memset(&od, 0, sizeof od);
    od.model = TETCAST_MODEL_ISOSURFACE;
    CHECK_EQ_U64(tetcast_optics_create(w->other, &od, &w->surface), TETCAST_OK);
    for (a = 0; a < 3; a++) {
        w->lattice.dims[a] = GRID;
        w->lattice.spacing[a] = 1;
    }
    values.data = w->grid;
    bd.log_cells = 3;
    CHECK_EQ_U64(tetcast_bricks_create_grid(&bd, &w->lattice, &values, NULL, &w->bricks), TETCAST_OK);
    CHECK_EQ_U64(tetcast_cut_create(NULL, w->bricks, &w->cut), TETCAST_OK);
    bd.longest = 9;
    CHECK_EQ_U64(tetcast_bricks_create_mesh(&bd, w->mesh, NULL, &w->hull_bricks), TETCAST_OK);
    ad = amr_desc(w, patch);
    CHECK_EQ_U64(tetcast_amr_create(&ad, &w->amr), TETCAST_OK);
    rd = functions_desc(f, 1);
    CHECK_EQ_U64(tetcast_rbf_create(&rd, &w->rbf), TETCAST_OK);
    w->image.width = w->image.height = SIDE;
    w->image.rgba8 = w->rgba8;
    w->image.rgba = w->rgba;
    w->image.depth = w->depth;
    w->image.length = w->length;
    w->image.steps = w->steps;
}

static void world_close(world *w) {
    tetcast_rbf_destroy(w->rbf);
    tetcast_amr_destroy(w->amr);
    tetcast_cut_destroy(w->cut);
    tetcast_bricks_destroy(w->bricks);
    tetcast_bricks_destroy(w->hull_bricks);
    tetcast_optics_destroy(w->optics);
    tetcast_optics_destroy(w->table);
    tetcast_optics_destroy(w->surface);
    tetcast_transfer_destroy(w->transfer);
    tetcast_transfer_destroy(w->other);
    tetcast_mesh_destroy(w->mesh);
    tets_free(&w->t);
    tets_free(&w->large);
    free(w->masks);
}

/* ---- the calls ---- */

static tetcast_result grid_mesh(world *w, const tetcast_env *env) {
    tetcast_mesh_desc d;
    tetcast_grid g;
    tetcast_field f[2];
    tetcast_mesh *m = NULL;
    tetcast_result r;
    int a;
    memset(&d, 0, sizeof d);
    memset(&g, 0, sizeof g);
    memset(f, 0, sizeof f);
    d.env = *env;
    for (a = 0; a < 3; a++) g.dims[a] = 4;
    f[0].values.data = w->grid;
    f[1].values.data = w->grid + 4;
    g.fields = f;
    g.field_count = 2;
    r = tetcast_mesh_create_grid(&d, &g, NULL, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    if (m == NULL) return r;
    r = tetcast_mesh_make_gradients(m, env);
    if (r == TETCAST_OK) {
        r = tetcast_mesh_set_field(m, 1);
        if (r == TETCAST_OK) { /* gradients are of the field before: made again */
            tetcast_check check;
            r = tetcast_mesh_make_gradients(m, env);
            if (r == TETCAST_OK) r = tetcast_mesh_check(m, env, &check);
            if (r == TETCAST_OK) CHECK(check.components == 1 && fabs(check.volume - 27) < 1e-9);
        }
    }
    tetcast_mesh_destroy(m);
    return r;
}

/* A mesh that comes in no order, with cells that show nothing, in one of the ways to keep cells. */
static tetcast_result large_mesh(world *w, const tetcast_env *env, tetcast_cells cells, int masked, tetcast_mesh **m) {
    tetcast_mesh_desc d;
    tetcast_input in;
    tetcast_field f;
    tetcast_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.cells = cells;
    d.drop_tets = d.disable_clusters = cells == TETCAST_CELLS_TET8; /* these are made in the place of what is dropped */
    if (masked) d.order = TETCAST_ORDER_INPUT;
    tets_input(&w->large, &in, &f);
    if (masked) in.masks = w->masks;
    *m = NULL;
    r = tetcast_mesh_create(&d, &in, NULL, m);
    CHECK((r == TETCAST_OK) == (*m != NULL));
    return r;
}

/* Pictures of it: rays leap over the half that shows nothing, or it is not projected. Both may do without. */
static tetcast_result kind_of_cells(world *w, const tetcast_env *env, tetcast_cells cells, tetcast_method method) {
    tetcast_render_desc d;
    tetcast_image image = w->image;
    tetcast_mesh *m;
    tetcast_result r = large_mesh(w, env, cells, 0, &m);
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.method = method;
    image.length = NULL; /* these two ask for every cell */
    image.steps = NULL;
    if (r == TETCAST_OK) r = tetcast_render(&d, m, w->optics, &image, NULL);
    tetcast_mesh_destroy(m);
    return r;
}
static tetcast_result cells_tet8(world *w, const tetcast_env *env) { return kind_of_cells(w, env, TETCAST_CELLS_TET8, TETCAST_METHOD_WALK); }
static tetcast_result cells_tet16(world *w, const tetcast_env *env) { return kind_of_cells(w, env, TETCAST_CELLS_TET16, TETCAST_METHOD_PROJECT); }
static tetcast_result cells_tet20(world *w, const tetcast_env *env) { return kind_of_cells(w, env, TETCAST_CELLS_TET20, TETCAST_METHOD_WALK); }
static tetcast_result cells_strips(world *w, const tetcast_env *env) { return kind_of_cells(w, env, TETCAST_CELLS_STRIPS, TETCAST_METHOD_WALK); }

/* Bricks of a mesh with masks leave the masked cells out. */
static tetcast_result bricks_of_masked(world *w, const tetcast_env *env) {
    tetcast_bricks_desc d;
    tetcast_bricks *b = NULL;
    tetcast_mesh *m;
    tetcast_result r = large_mesh(w, env, TETCAST_CELLS_TET16, 1, &m);
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.log_cells = 3;
    d.max_error = 0.4f;
    d.longest = 9;
    if (r == TETCAST_OK) {
        r = tetcast_bricks_create_mesh(&d, m, NULL, &b);
        CHECK((r == TETCAST_OK) == (b != NULL));
    }
    tetcast_bricks_destroy(b);
    tetcast_mesh_destroy(m);
    return r;
}

/* A function with knots to spare, isosurfaces within a volume, a table that no function changes. */
static tetcast_result kinds_of_optics(world *w, const tetcast_env *env) {
    tetcast_control_point p[12];
    tetcast_transfer_desc td;
    tetcast_transfer *t = NULL;
    tetcast_result r;
    int k;
    (void)w;
    memset(&td, 0, sizeof td);
    memset(p, 0, sizeof p);
    for (k = 0; k < 12; k++) {
        p[k].value = (float)k / 11.0f;
        p[k].rgb[0] = 1.0f;
        p[k].extinction = 1.0f + 1e-4f * (float)(k % 3);
    }
    td.env = *env;
    td.points = p;
    td.point_count = 12;
    r = tetcast_transfer_create(&td, &t);
    for (k = 0; k < 3 && r == TETCAST_OK; k++) {
        tetcast_optics_desc d;
        tetcast_optics *o = NULL;
        memset(&d, 0, sizeof d);
        d.env = *env;
        if (k == 0) d.tolerance = d.path_length = 1.0f;
        if (k == 1) d.model = TETCAST_MODEL_MIXED;
        if (k == 2) d.integrator = TETCAST_INTEGRATOR_PSI_TABLE; /* last: it takes long to fill */
        r = tetcast_optics_create(k == 1 ? w->other : t, &d, &o);
        CHECK((r == TETCAST_OK) == (o != NULL));
        tetcast_optics_destroy(o);
    }
    tetcast_transfer_destroy(t);
    return r;
}

static int pass_by(void *user, const tetcast_crossing *c) {
    (void)c;
    ++*(uint32_t *)user;
    return 0;
}

/* All cells on a ray, with memory of the mesh: none where there is not enough. */
static tetcast_result probed(world *w, const tetcast_env *env) {
    tetcast_mesh_desc d;
    tetcast_grid g;
    tetcast_field f;
    tetcast_mesh *m = NULL;
    tetcast_ray ray;
    tetcast_result r;
    uint32_t seen = 0;
    uint64_t n;
    int a;
    memset(&d, 0, sizeof d);
    memset(&g, 0, sizeof g);
    memset(&f, 0, sizeof f);
    memset(&ray, 0, sizeof ray);
    d.env = *env;
    for (a = 0; a < 3; a++) g.dims[a] = 4;
    f.values.data = w->grid;
    g.fields = &f;
    g.field_count = 1;
    r = tetcast_mesh_create_grid(&d, &g, NULL, &m);
    if (m == NULL) return r;
    ray.org[0] = -1;
    ray.org[1] = 1.3;
    ray.org[2] = 1.6;
    ray.dir[0] = 1;
    n = tetcast_probe(m, &ray, pass_by, &seen);
    CHECK(n == seen && (n == 0 || n > 5));
    tetcast_mesh_destroy(m);
    return n != 0 ? TETCAST_OK : TETCAST_ERR_NO_MEMORY;
}

static tetcast_result update(world *w, const tetcast_env *env) {
    tetcast_transfer_desc td;
    tetcast_optics_desc d;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    tetcast_control_point p[3];
    tetcast_result r;
    memset(&td, 0, sizeof td);
    memset(&d, 0, sizeof d);
    colours(p, 1.0f);
    td.env = d.env = *env;
    td.points = p;
    td.point_count = 3;
    r = tetcast_transfer_create(&td, &t);
    if (r == TETCAST_OK) {
        d.integrator = TETCAST_INTEGRATOR_TABLE_3D;
        d.table_values = 16;
        d.table_lengths = 8;
        d.longest = 2;
        r = tetcast_optics_update(w->table, t, &d, &o);
        CHECK((r == TETCAST_OK) == (o != NULL));
    } else CHECK(t == NULL);
    tetcast_optics_destroy(o);
    tetcast_transfer_destroy(t);
    return r;
}

static tetcast_result surface(world *w, const tetcast_env *env) {
    tetcast_surface_desc d;
    tetcast_surface s;
    tetcast_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.isovalue = 0.5f;
    d.normals = d.cells = 1;
    r = tetcast_isosurface(&d, w->mesh, &s);
    CHECK(r == TETCAST_OK ? s.triangle_count > 100 && s.normals != NULL && s.cells != NULL : s.positions == NULL && s.indices == NULL);
    tetcast_surface_free(&s);
    return r;
}

static tetcast_result resampled(world *w, const tetcast_env *env) {
    tetcast_resample_desc d;
    tetcast_lattice l;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.extend = 1;
    CHECK_EQ_U64(tetcast_lattice_fit(w->mesh, 9, &l), TETCAST_OK);
    return tetcast_resample(&d, w->mesh, &l, w->out, NULL);
}

static tetcast_plane middle_plane(void) {
    tetcast_plane p;
    memset(&p, 0, sizeof p);
    p.origin[2] = 1.37;
    p.u[0] = p.v[1] = 3;
    p.u[2] = 0.2;
    return p;
}

static tetcast_result plane_values(world *w, const tetcast_env *env) {
    const tetcast_plane p = middle_plane();
    return tetcast_plane_sample(env, w->mesh, &p, SIDE, SIDE, w->out);
}

static tetcast_result plane_seen(world *w, const tetcast_env *env) {
    const tetcast_plane p = middle_plane();
    tetcast_camera c;
    memset(&c, 0, sizeof c);
    c.eye[2] = 6;
    return tetcast_plane_view(env, w->mesh, &p, &c, SIDE, SIDE, w->out, w->depth);
}

static tetcast_result means(world *w, const tetcast_env *env) {
    tetcast_means m;
    memset(&m, 0, sizeof m);
    m.mean = w->out;
    return tetcast_resample_mean(env, w->mesh, &w->lattice, &m);
}

/* Two sets; the second takes over what changed in the first. */
static tetcast_result parameters(world *w, const tetcast_env *env) {
    tetcast_params *a = NULL, *b = NULL;
    tetcast_result r = tetcast_params_create(env, &a);
    char name[8];
    int i;
    if (r == TETCAST_OK) r = tetcast_params_create(env, &b);
    for (i = 0; i < 20 && r == TETCAST_OK; i++) {
        const uint64_t before = tetcast_params_changed(a, NULL);
        snprintf(name, sizeof name, "n%d", i % 18);
        r = tetcast_params_set(a, name, w->grid + i, 1 + (size_t)i);
        CHECK_EQ_U64(tetcast_params_changed(a, NULL), before + (r == TETCAST_OK));
    }
    if (r == TETCAST_OK) {
        const size_t size = tetcast_params_changes(a, 0, w->file, sizeof w->file);
        CHECK(size <= sizeof w->file);
        r = tetcast_params_apply(b, w->file, size);
    }
    tetcast_params_destroy(a);
    tetcast_params_destroy(b);
    return r;
}

static tetcast_result section(world *w, const tetcast_env *env) {
    const tetcast_plane p = middle_plane();
    tetcast_section s;
    const tetcast_result r = tetcast_plane_section(env, w->mesh, &p, &s);
    CHECK(r == TETCAST_OK ? s.polygon_count > 20 : s.points == NULL && s.polygon_count == 0);
    tetcast_section_free(&s);
    return r;
}

static tetcast_result bricks(world *w, const tetcast_env *env, int of) {
    tetcast_bricks_desc d;
    tetcast_array a;
    tetcast_bricks *b = NULL;
    tetcast_result r;
    memset(&d, 0, sizeof d);
    memset(&a, 0, sizeof a);
    d.env = *env;
    d.log_cells = 3;
    d.max_error = of == 0 ? 0.05f : 0.4f;
    d.longest_end = 17;
    d.checks = 50;
    if (of >= 4) d.longest = 9;
    d.average = of == 4;
    if (of == 5) d.focus_radius = 0.5;
    a.data = w->grid;
    r = of == 0 ? tetcast_bricks_create_grid(&d, &w->lattice, &a, NULL, &b) :
        of == 1 || of >= 4 ? tetcast_bricks_create_mesh(&d, w->mesh, NULL, &b) :
        of == 2 ? tetcast_bricks_create_amr(&d, w->amr, TETCAST_AMR_OCTANT, NULL, &b) :
                  tetcast_bricks_create_rbf(&d, w->rbf, TETCAST_RBF_CHANNEL_AUTO, 0, NULL, &b);
    CHECK((r == TETCAST_OK) == (b != NULL));
    tetcast_bricks_destroy(b);
    return r;
}
static tetcast_result bricks_of_grid(world *w, const tetcast_env *env) { return bricks(w, env, 0); }
static tetcast_result bricks_of_mesh(world *w, const tetcast_env *env) { return bricks(w, env, 1); }
static tetcast_result bricks_of_amr(world *w, const tetcast_env *env) { return bricks(w, env, 2); }
static tetcast_result bricks_of_rbf(world *w, const tetcast_env *env) { return bricks(w, env, 3); }
static tetcast_result bricks_of_means(world *w, const tetcast_env *env) { return bricks(w, env, 4); }
static tetcast_result bricks_on_demand(world *w, const tetcast_env *env) { return bricks(w, env, 5); }

static tetcast_result amr(world *w, const tetcast_env *env) {
    tetcast_patch patch[2];
    tetcast_amr_desc d = amr_desc(w, patch);
    tetcast_amr *m = NULL;
    tetcast_result r;
    d.env = *env;
    r = tetcast_amr_create(&d, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    tetcast_amr_destroy(m);
    return r;
}

static tetcast_result read_bricks(world *w, const tetcast_env *env) {
    const size_t size = tetcast_bricks_file_size(w->hull_bricks);
    tetcast_bricks *b = NULL;
    tetcast_result r;
    CHECK(size <= FILE_ROOM);
    if (size > FILE_ROOM) return TETCAST_OK;
    CHECK_EQ_U64(tetcast_bricks_write(w->hull_bricks, w->file, size), TETCAST_OK);
    r = tetcast_bricks_read(env, w->file, size, &b);
    CHECK((r == TETCAST_OK) == (b != NULL));
    tetcast_bricks_destroy(b);
    return r;
}

static tetcast_result cut(world *w, const tetcast_env *env) {
    tetcast_cut_desc d;
    tetcast_cut *c = NULL;
    tetcast_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.byte_budget = 1 << 20;
    d.max_jump = 1;
    d.optics = w->optics;
    r = tetcast_cut_create(&d, w->hull_bricks, &c);
    CHECK((r == TETCAST_OK) == (c != NULL));
    tetcast_cut_destroy(c);
    return r;
}

/* A plane and a closed body, made with env's memory; NULL where there is none. */
static tetcast_clip *make_clip(const tetcast_env *env, tetcast_result *r) {
    static const double corner[4][3] = {{0.5, 0.5, 0.5}, {4, 0.5, 0.5}, {0.5, 4, 0.5}, {0.5, 0.5, 4}};
    static const uint32_t index[12] = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};
    const tetcast_clip_plane plane = {{1, 0, 0}, 0.7};
    tetcast_clip_body body;
    tetcast_clip_desc d;
    tetcast_clip *c = NULL;
    memset(&d, 0, sizeof d);
    memset(&body, 0, sizeof body);
    body.points = corner;
    body.point_count = 4;
    body.indices = index;
    body.triangle_count = 4;
    d.env = *env;
    d.planes = &plane;
    d.plane_count = d.body_count = 1;
    d.bodies = &body;
    *r = tetcast_clip_create(&d, &c);
    CHECK((*r == TETCAST_OK) == (c != NULL));
    return c;
}

static tetcast_result clip(world *w, const tetcast_env *env) {
    tetcast_result r;
    tetcast_clip *c = make_clip(env, &r);
    (void)w;
    if (c != NULL) {
        tetcast_ray ray;
        double span[4][2];
        uint32_t n;
        memset(&ray, 0, sizeof ray);
        ray.org[1] = ray.org[2] = 1.0;
        ray.dir[0] = 1;
        ray.t_max = 1e9;
        n = tetcast_clip_spans(c, &ray, span, 4);
        if (n == TETCAST_NONE) r = TETCAST_ERR_NO_MEMORY;
        else CHECK(n == 1 && fabs(span[0][0] - 0.7) < 1e-9 && fabs(span[0][1] - 3) < 1e-9);
    }
    tetcast_clip_destroy(c);
    return r;
}

static void shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    int i, c;
    (void)user;
    for (i = 0; i < 8; i++) {
        const float a = in->mask >> i & 1u ? 0.3f * in->length[i] / (1 + in->length[i]) : 0;
        for (c = 0; c < 3; c++) rgba[c][i] = a * 0.5f;
        rgba[3][i] = a;
    }
}

static tetcast_result shaded_picture(world *w, const tetcast_env *env, int of) {
    tetcast_shader s;
    tetcast_result r;
    tetcast_clip *c = make_clip(env, &r);
    memset(&s, 0, sizeof s);
    s.needs = TETCAST_NEED_GRADIENT | TETCAST_NEED_POSITION;
    s.shade_fn = shade;
    if (c == NULL) return r;
    if (of == 0) {
        tetcast_shade_desc d;
        memset(&d, 0, sizeof d);
        d.env = *env;
        d.clip = c;
        d.shader = &s;
        r = tetcast_render_shaded(&d, w->mesh, NULL, &w->image, NULL);
    } else {
        tetcast_brick_render_desc d;
        memset(&d, 0, sizeof d);
        d.env = *env;
        d.clip = c;
        d.shader = of == 1 ? &s : NULL;
        r = tetcast_render_bricks(&d, w->cut, w->optics, &w->image, NULL);
    }
    tetcast_clip_destroy(c);
    return r;
}
static tetcast_result shaded_mesh(world *w, const tetcast_env *env) { return shaded_picture(w, env, 0); }
static tetcast_result shaded_bricks(world *w, const tetcast_env *env) { return shaded_picture(w, env, 1); }
static tetcast_result brick_picture(world *w, const tetcast_env *env) { return shaded_picture(w, env, 2); }

static tetcast_result memory_picture(world *w, const tetcast_env *env, tetcast_method method, int rays) {
    tetcast_render_desc d;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.method = method;
    if (rays) {
        static tetcast_ray_result result[SIDE];
        tetcast_ray ray[SIDE];
        tetcast_camera camera;
        double box[2][3] = {{0, 0, 0}, {3, 3, 3}};
        uint32_t i;
        memset(&camera, 0, sizeof camera);
        memset(ray, 0, sizeof ray);
        CHECK_EQ_U64(tetcast_camera_fit(&camera, box[0], box[1], NULL, SIDE, SIDE), TETCAST_OK);
        for (i = 0; i < SIDE; i++) CHECK_EQ_U64(tetcast_camera_ray(&camera, SIDE, SIDE, i + 0.5, SIDE / 2, &ray[i]), TETCAST_OK);
        return tetcast_cast(&d, w->mesh, w->optics, ray, SIDE, result, NULL);
    }
    return tetcast_render(&d, w->mesh, w->optics, &w->image, NULL);
}
static tetcast_result walked(world *w, const tetcast_env *env) { return memory_picture(w, env, TETCAST_METHOD_WALK, 0); }
static tetcast_result projected(world *w, const tetcast_env *env) { return memory_picture(w, env, TETCAST_METHOD_PROJECT, 0); }
static tetcast_result rays(world *w, const tetcast_env *env) { return memory_picture(w, env, TETCAST_METHOD_WALK, 1); }

static tetcast_result rbf(world *w, const tetcast_env *env) {
    tetcast_rbf_function f[40];
    tetcast_rbf_desc d = functions_desc(f, 1);
    tetcast_rbf_eval_desc e;
    tetcast_rbf *m = NULL;
    tetcast_result r;
    float slope[POINTS * 3];
    static const uint32_t dims[3] = {3, 4, 5};
    memset(&e, 0, sizeof e);
    d.env = e.env = *env;
    r = tetcast_rbf_create(&d, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    if (r == TETCAST_OK) r = tetcast_rbf_eval(&e, m, w->points[0], POINTS, w->out, slope);
    if (r == TETCAST_OK) r = tetcast_rbf_grid(&e, m, dims, w->out);
    tetcast_rbf_destroy(m);
    return r;
}

static tetcast_result rbf_picture(world *w, const tetcast_env *env) {
    tetcast_rbf_render_desc d;
    memset(&d, 0, sizeof d);
    d.env = *env;
    return tetcast_rbf_render(&d, w->rbf, w->optics, &w->image, NULL);
}

/* A file is there as a whole or not at all; what is read from it is the model. */
static tetcast_result rbf_files(world *w, const tetcast_env *env) {
    const char *path = test_temp_path(".rbf");
    tetcast_rbf *m = NULL;
    tetcast_result r = tetcast_rbf_save_file(w->rbf, env, path);
    size_t size = 0;
    uint8_t *p = test_read_file(path, &size);
    CHECK((r == TETCAST_OK) == (p != NULL));
    free(p);
    if (r == TETCAST_OK) r = tetcast_rbf_load_file(env, path, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    if (m != NULL) {
        tetcast_rbf_info a, b;
        tetcast_rbf_get_info(w->rbf, &a);
        tetcast_rbf_get_info(m, &b);
        CHECK(a.function_count == b.function_count && a.file_bytes == b.file_bytes);
    }
    tetcast_rbf_destroy(m);
    (void)remove(path);
    return r;
}

/* Functions upon a lattice of values. */
static tetcast_result rbf_base(world *w, const tetcast_env *env) {
    tetcast_rbf_function f[40];
    tetcast_rbf_desc d = functions_desc(f, 1);
    tetcast_rbf *m = NULL;
    tetcast_result r;
    int a;
    d.env = *env;
    for (a = 0; a < 3; a++) d.base_dims[a] = GRID;
    d.base = w->grid;
    r = tetcast_rbf_create(&d, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    tetcast_rbf_destroy(m);
    return r;
}

/* A sum of some functions, which is found as such. */
static tetcast_result fit_of_few(world *w, const tetcast_env *env) {
    enum { N = 9 };
    static float value[N * N * N];
    tetcast_rbf_fit_desc d;
    tetcast_rbf_points p;
    tetcast_rbf *m = NULL;
    tetcast_result r;
    int i, k;
    (void)w;
    for (i = 0; i < N * N * N; i++) {
        value[i] = 0;
        for (k = 0; k < 3; k++) {
            const double x = i % N - 2.0 - 2 * k, y = i / N % N - 6.0 + k, z = i / (N * N) - 3.0 - k, width = 1.5 + 0.2 * k;
            value[i] += (float)exp(-(x * x + y * y + z * z) / (2 * width * width));
        }
    }
    memset(&d, 0, sizeof d);
    memset(&p, 0, sizeof p);
    d.env = *env;
    d.max_error = 0.02f;
    d.method = TETCAST_RBF_METHOD_PURE; /* of the others a lattice may take less */
    p.values.data = value;
    p.components = 1;
    p.dims[0] = p.dims[1] = p.dims[2] = N;
    p.count = N * N * N;
    r = tetcast_rbf_fit(&d, &p, NULL, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    tetcast_rbf_destroy(m);
    return r;
}

#ifdef __linux__
/* A file whose size nobody knows. */
static tetcast_result rbf_pipe(world *w, const tetcast_env *env) {
    tetcast_rbf *m = NULL;
    tetcast_result r;
    size_t size = 0;
    char path[32];
    int end[2];
    CHECK_EQ_U64(tetcast_rbf_save_memory(w->rbf, w->file, sizeof w->file, &size), TETCAST_OK);
    if (pipe(end) != 0) return TETCAST_OK;
    CHECK(size < 60000 && write(end[1], w->file, size) == (ssize_t)size);
    (void)close(end[1]);
    snprintf(path, sizeof path, "/dev/fd/%d", end[0]);
    r = tetcast_rbf_load_file(env, path, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    (void)close(end[0]);
    tetcast_rbf_destroy(m);
    return r;
}
#endif

static tetcast_result traces(world *w, const tetcast_env *env) {
    tetcast_rbf_function f[40];
    tetcast_rbf_desc d = functions_desc(f, 3);
    tetcast_rbf_trace_desc td;
    tetcast_rbf *m = NULL;
    tetcast_result r;
    static double paths[POINTS * 9 * 3];
    memset(&td, 0, sizeof td);
    d.env = td.env = *env;
    td.dt = 0.01;
    td.steps = 8;
    r = tetcast_rbf_create(&d, &m);
    if (r == TETCAST_OK) r = tetcast_rbf_trace(&td, m, w->points[0], POINTS, paths, NULL, NULL);
    tetcast_rbf_destroy(m);
    return r;
}

/* Points in a box, and one in the middle of many: its cell has more walls and corners than are made room for. */
static tetcast_result foam(world *w, const tetcast_env *env) {
    enum { SITES = 150, ROUND = 90 };
    static tetcast_site site[SITES];
    test_rng g = test_rng_make(3);
    tetcast_foam_desc d;
    tetcast_render_desc rd;
    tetcast_foam *f = NULL;
    tetcast_result r;
    uint32_t i, a;
    memset(&d, 0, sizeof d);
    memset(&rd, 0, sizeof rd);
    d.env = rd.env = *env;
    for (i = 0; i < SITES; i++) {
        double v[3], square = 0;
        for (a = 0; a < 3; a++) v[a] = test_rng_double(&g) - 0.5;
        for (a = 0; a < 3; a++) square += v[a] * v[a];
        for (a = 0; a < 3; a++) site[i].position[a] = i == 0 ? 4 : i <= ROUND ? 4 + v[a] / sqrt(square) : v[a] + 0.5;
        site[i].extinction = site[i].rgb[i % 3] = 1;
    }
    r = tetcast_foam_create(&d, site, SITES, &f);
    CHECK((r == TETCAST_OK) == (f != NULL));
    if (r == TETCAST_OK) r = tetcast_foam_render(&rd, f, &w->image, NULL);
    tetcast_foam_destroy(f);
    return r;
}

/* ---- all of them ---- */

static const struct call { const char *name; tetcast_result (*run)(world *w, const tetcast_env *env); uint32_t least; } call[] = {
    {"mesh of a grid", grid_mesh, 10}, {"cells on a ray", probed, 10}, {"optics", update, 3}, {"isosurface", surface, 3}, {"resample", resampled, 1},
    {"plane", plane_values, 1},
    {"plane in perspective", plane_seen, 1}, {"means", means, 3}, {"parameters", parameters, 30}, {"bricks of means", bricks_of_means, 5},
    {"bricks on demand", bricks_on_demand, 5}, {"section", section, 3},
    {"bricks of a grid", bricks_of_grid, 3}, {"bricks of a mesh", bricks_of_mesh, 5},
    {"bricks of refined cells", bricks_of_amr, 3},
    {"bricks of functions", bricks_of_rbf, 3}, {"refined cells", amr, 3}, {"file of bricks", read_bricks, 3}, {"cut", cut, 3}, {"clip", clip, 2},
    {"shaded mesh", shaded_mesh, 2}, {"shaded bricks", shaded_bricks, 2}, {"picture of bricks", brick_picture, 2}, {"picture by walking", walked, 1},
    {"picture by projecting", projected, 3}, {"rays", rays, 1}, {"functions", rbf, 3}, {"picture of functions", rbf_picture, 1},
    {"files of functions", rbf_files, 3}, {"traces", traces, 4}, {"foam", foam, 12}, {"cells of 8 bytes", cells_tet8, 10},
    {"cells of 16 bytes", cells_tet16, 10}, {"cells of 20 bytes", cells_tet20, 10}, {"cells in strips", cells_strips, 15},
    {"bricks of a masked mesh", bricks_of_masked, 20}, {"kinds of optics", kinds_of_optics, 6}, {"functions upon a lattice", rbf_base, 3},
    {"fit of few", fit_of_few, 20},
#ifdef __linux__
    {"functions from a pipe", rbf_pipe, 2},
#endif
};

typedef struct one_call { world *w; uint32_t which; } one_call;

static int run_call(void *user, test_alloc *ta, unsigned threads) {
    const one_call *c = (const one_call *)user;
    tetcast_env env;
    tetcast_error error;
    memset(&env, 0, sizeof env);
    memset(&error, 0, sizeof error);
    env.allocator.alloc_fn = test_alloc_fn;
    env.allocator.free_fn = test_free_fn;
    env.allocator.user = ta;
    env.thread_count = threads;
    env.error = &error;
    return (int)call[c->which].run(c->w, &env);
}

TEST(every_request_refused) {
    static world w;
    one_call c;
    unsigned threads;
    world_open(&w);
    c.w = &w;
    for (c.which = 0; c.which < sizeof call / sizeof call[0]; c.which++)
        for (threads = 1; threads <= 2; threads++) {
            if (test_quick() && (threads == 2) != (c.which % 2 == 1)) continue; /* one of them */
            test_refuse_requests(call[c.which].name, run_call, &c, threads, (int)TETCAST_ERR_NO_MEMORY, call[c.which].least, 0);
        }
    world_close(&w);
}

/* Makes several objects, each with a limit of its own. */
static int several(tetcast_result (*run)(world *w, const tetcast_env *env)) {
    return run == update || run == parameters || run == grid_mesh || run == clip || run == shaded_mesh || run == shaded_bricks ||
           run == brick_picture || run == probed || run == foam || run == cells_tet8 || run == cells_tet16 || run == cells_tet20 ||
           run == cells_strips || run == bricks_of_masked || run == kinds_of_optics;
}

/* memory_limit holds for all that a call and its results have at once. */
TEST(limits_hold) {
    static world w;
    uint32_t which;
    world_open(&w);
    for (which = 0; which < sizeof call / sizeof call[0]; which++) {
        tetcast_result (*const run)(world *, const tetcast_env *) = call[which].run;
        tetcast_result r = TETCAST_ERR_NO_MEMORY;
        size_t limit;
        if (several(run)) continue;
        for (limit = 1000; r != TETCAST_OK && limit < ((size_t)1 << 30); limit += limit / 16) {
            tetcast_env env;
            test_alloc ta;
            memset(&env, 0, sizeof env);
            test_alloc_init(&ta);
            env.allocator.alloc_fn = test_alloc_fn;
            env.allocator.free_fn = test_free_fn;
            env.allocator.user = &ta;
            env.thread_count = 1;
            env.memory_limit = limit;
            r = run(&w, &env);
            test_alloc_check(&ta);
            CHECK_MSG(ta.peak_bytes <= limit, "%s: %u bytes at once, limit %u", call[which].name, (unsigned)ta.peak_bytes,
                      (unsigned)limit);
            CHECK_MSG(r == TETCAST_OK || r == TETCAST_ERR_NO_MEMORY, "%s: result %d", call[which].name, (int)r);
        }
        CHECK(r == TETCAST_OK);
    }
    world_close(&w);
}

/* ---- cancelled ---- */

typedef struct stopper { uint64_t calls, stop_at, done, total; uint32_t backwards; } stopper;

static int stop(void *user, uint64_t done, uint64_t total) {
    stopper *s = (stopper *)user;
    s->backwards += total == s->total && done < s->done;
    s->done = done;
    s->total = total;
    CHECK(done <= total);
    return ++s->calls == s->stop_at;
}

static tetcast_result fitted(world *w, const tetcast_env *env) {
    tetcast_rbf_fit_desc d;
    tetcast_rbf_points p;
    tetcast_rbf *m = NULL;
    tetcast_result r;
    int a;
    memset(&d, 0, sizeof d);
    memset(&p, 0, sizeof p);
    d.env = *env;
    d.max_error = 0.1f;
    p.values.data = w->grid;
    p.components = 1;
    p.count = GRID * GRID * GRID;
    for (a = 0; a < 3; a++) p.dims[a] = GRID;
    r = tetcast_rbf_fit(&d, &p, NULL, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    tetcast_rbf_destroy(m);
    return r;
}

/* Points for which several sizes of a base are tried, and a base so large that each round of its solution asks. */
static tetcast_result fitted_points(const tetcast_env *env, uint32_t base) {
    enum { SIDE_OF = 12, COUNT = SIDE_OF * SIDE_OF * SIDE_OF };
    static float value[COUNT];
    tetcast_rbf_fit_desc d;
    tetcast_rbf_points p;
    tetcast_rbf *m = NULL;
    tetcast_result r;
    int i;
    memset(&d, 0, sizeof d);
    memset(&p, 0, sizeof p);
    for (i = 0; i < COUNT; i++) {
        const double x = i % SIDE_OF / 11.0, y = i / SIDE_OF % SIDE_OF / 11.0, z = i / SIDE_OF / SIDE_OF / 11.0;
        value[i] = (float)(exp(-20 * ((x - 0.3) * (x - 0.3) + (y - 0.4) * (y - 0.4) + (z - 0.5) * (z - 0.5))) + 0.3 * sin(9 * x * y) + z);
    }
    d.env = *env;
    d.max_error = base != 0 ? 0.5f : 0.05f;
    d.base_dims[0] = d.base_dims[1] = d.base_dims[2] = base;
    p.values.data = value;
    p.components = 1;
    p.count = COUNT;
    for (i = 0; i < 3; i++) p.dims[i] = SIDE_OF;
    r = tetcast_rbf_fit(&d, &p, NULL, &m);
    CHECK((r == TETCAST_OK) == (m != NULL));
    tetcast_rbf_destroy(m);
    return r;
}
static tetcast_result fit_by_trial(world *w, const tetcast_env *env) { (void)w; return fitted_points(env, 0); }
static tetcast_result fit_large_base(world *w, const tetcast_env *env) { (void)w; return fitted_points(env, 41); }

/* All tables there are: slices one after another, in parts, all rows at once. */
static tetcast_result tables(world *w, const tetcast_env *env) {
    uint32_t which;
    tetcast_result r = TETCAST_OK;
    for (which = TETCAST_INTEGRATOR_TABLE_3D; which <= TETCAST_INTEGRATOR_TABLE_PREFIX && r == TETCAST_OK; which++) {
        tetcast_optics_desc d;
        tetcast_optics *o = NULL;
        memset(&d, 0, sizeof d);
        d.env = *env;
        d.integrator = (tetcast_integrator)which;
        d.table_values = 4 + which; /* another total for each */
        d.table_lengths = 3;
        d.longest = 2;
        r = tetcast_optics_create(w->transfer, &d, &o);
        CHECK((r == TETCAST_OK) == (o != NULL));
        tetcast_optics_destroy(o);
    }
    return r;
}

static tetcast_result long_traces(world *w, const tetcast_env *env) { /* one group asks several times */
    tetcast_rbf_function f[40];
    tetcast_rbf_desc d = functions_desc(f, 3);
    tetcast_rbf_trace_desc td;
    tetcast_rbf *m = NULL;
    tetcast_result r;
    static double paths[8 * 1001 * 3];
    memset(&td, 0, sizeof td);
    td.env = *env;
    td.dt = 1e-9;
    td.steps = 1000;
    CHECK_EQ_U64(tetcast_rbf_create(&d, &m), TETCAST_OK);
    r = tetcast_rbf_trace(&td, m, w->points[0], 8, paths, NULL, NULL);
    tetcast_rbf_destroy(m);
    return r;
}

static tetcast_result many_checks(world *w, const tetcast_env *env) { /* 2^16 places from question to question */
    tetcast_bricks_desc d;
    tetcast_bricks_report report;
    tetcast_bricks *b = NULL;
    tetcast_result r;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.longest = 5;
    d.checks = 150000;
    r = tetcast_bricks_create_mesh(&d, w->mesh, &report, &b);
    CHECK((r == TETCAST_OK) == (b != NULL));
    tetcast_bricks_destroy(b);
    return r;
}

/* Every call that asks whether to go on is cancelled at each of its questions: that is what it says, and nothing is left. */
TEST(cancelled) {
    static const struct { const char *name; tetcast_result (*run)(world *, const tetcast_env *); uint32_t least; } ask[] = {
        {"fit", fitted, 10}, {"means", means, 1}, {"bricks of a mesh", bricks_of_mesh, 1}, {"bricks of refined cells", bricks_of_amr, 1},
        {"bricks of functions", bricks_of_rbf, 1}, {"shaded mesh", shaded_mesh, 1}, {"picture of bricks", brick_picture, 1},
        {"picture of functions", rbf_picture, 1}, {"resample", resampled, 1}, {"tables", tables, 30}, {"update", update, 1},
        {"traces", traces, 1}, {"long traces", long_traces, 4}, {"mesh of a grid", grid_mesh, 5}, {"picture by walking", walked, 1},
        {"checks", many_checks, 4}, {"picture by projecting", projected, 1}, {"fit with bases by trial", fit_by_trial, 100},
        {"fit with a large base", fit_large_base, 60}, {"foam", foam, 2}};
    static world w;
    size_t i;
    unsigned threads;
    world_open(&w);
    for (i = 0; i < sizeof ask / sizeof ask[0]; i++)
        for (threads = 1; threads <= 3; threads += 2) {
            const uint64_t most = ask[i].run == fit_large_base ? 1 : test_quick() ? 4 : 100;
            uint64_t at;
            if (test_quick() && (threads == 3) != (i % 2 == 1)) continue;
            for (at = 0;; at += at < 8 ? 1 : 1 + at / 2) { /* 0: never, to count the questions */
                tetcast_env env;
                tetcast_error error;
                test_alloc ta;
                stopper s;
                tetcast_result r;
                memset(&env, 0, sizeof env);
                memset(&error, 0, sizeof error);
                memset(&s, 0, sizeof s);
                test_alloc_init(&ta);
                env.allocator.alloc_fn = test_alloc_fn;
                env.allocator.free_fn = test_free_fn;
                env.allocator.user = &ta;
                env.thread_count = threads;
                env.error = &error;
                env.progress_fn = stop;
                env.progress_user = &s;
                s.stop_at = at;
                r = ask[i].run(&w, &env);
                test_alloc_check(&ta);
                if (at == 0)
                    CHECK_MSG(r == TETCAST_OK && s.calls >= (threads == 1 ? ask[i].least : 1), "%s asks %u times, result %d",
                              ask[i].name, (unsigned)s.calls, (int)r);
                else if (s.calls >= at)
                    CHECK_MSG(r == TETCAST_ERR_CANCELLED && error.code == r, "%s, question %u: result %d", ask[i].name, (unsigned)at, (int)r);
                CHECK_MSG(threads > 1 || s.backwards == 0, "%s: %u steps back", ask[i].name, s.backwards);
                if (at != 0 && (s.calls < at || at > most)) break;
            }
        }
    world_close(&w);
}

/* Sizes up to 2^32 - 1 are refused where there are too many tiles, not taken for small ones. */
TEST(pictures_too_large) {
    static world w;
    static const uint32_t size[3] = {0xffffffffu, 0xffffffe1u, 0x80000000u};
    tetcast_env env;
    uint32_t i;
    world_open(&w);
    memset(&env, 0, sizeof env);
    env.thread_count = 1;
    for (i = 0; i < 3; i++) {
        memset(&w.image, 0, sizeof w.image);
        w.image.width = w.image.height = size[i];
        CHECK_EQ_U64(walked(&w, &env), TETCAST_ERR_RANGE);
        CHECK_EQ_U64(projected(&w, &env), TETCAST_ERR_RANGE);
        CHECK_EQ_U64(shaded_mesh(&w, &env), TETCAST_ERR_RANGE);
        CHECK_EQ_U64(brick_picture(&w, &env), TETCAST_ERR_RANGE);
        CHECK_EQ_U64(rbf_picture(&w, &env), TETCAST_ERR_RANGE);
        CHECK_EQ_U64(foam(&w, &env), TETCAST_ERR_RANGE);
    }
    world_close(&w);
}

/* A table that rays would be cut into more than 65,536 parts for is refused by all that draws with it, and for segments. */
TEST(tables_too_short) {
    static world w;
    uint32_t which;
    world_open(&w);
    for (which = TETCAST_INTEGRATOR_TABLE_3D; which <= TETCAST_INTEGRATOR_TABLE_PREFIX; which++) {
        static const float longest[3] = {1e-30f, 5e-5f, 1e-3f}; /* the mesh is 4 wide, boxes of bricks and functions 4 and 1 */
        uint32_t k;
        for (k = 0; k < 3; k++) {
            const tetcast_ray ray = {{-1, 2, 2}, {1, 0, 0}, 0, 0};
            const tetcast_segment segment = {0.1f, 0.9f, 7.0f, 0.0f};
            tetcast_optics_desc d;
            tetcast_rbf_render_desc rd;
            tetcast_optics *o = NULL;
            tetcast_ray_result hit;
            tetcast_image small = w.image;
            float rgba[4];
            tetcast_result want = k < 2 ? TETCAST_ERR_RANGE : TETCAST_OK;
            memset(&d, 0, sizeof d);
            memset(&rd, 0, sizeof rd);
            small.width = small.height = 2;
            d.integrator = (tetcast_integrator)which;
            d.table_values = 4;
            d.table_lengths = 2;
            if (which == TETCAST_INTEGRATOR_TABLE_2D) d.step = longest[k];
            d.longest = which == TETCAST_INTEGRATOR_TABLE_2D ? 4.0f : longest[k];
            CHECK_EQ_U64(tetcast_optics_create(w.transfer, &d, &o), TETCAST_OK);
            REQUIRE(o != NULL);
            CHECK_EQ_U64(tetcast_render(NULL, w.mesh, o, &small, NULL), want);
            CHECK_EQ_U64(tetcast_cast(NULL, w.mesh, o, &ray, 1, &hit, NULL), want);
            CHECK_EQ_U64(tetcast_render_bricks(NULL, w.cut, o, &small, NULL), want);
            CHECK_EQ_U64(tetcast_render_shaded(NULL, w.mesh, o, &small, NULL), want);
            CHECK_EQ_U64(tetcast_rbf_render(&rd, w.rbf, o, &small, NULL), k == 0 ? TETCAST_ERR_RANGE : TETCAST_OK);
            CHECK_EQ_U64(tetcast_optics_ray(o, &segment, 1, rgba, NULL), k < 2 ? TETCAST_ERR_INVALID_ARG : TETCAST_OK);
            CHECK_EQ_U64(tetcast_optics_segments(o, &segment, 1, TETCAST_ISA_AUTO, &rgba), k < 2 ? TETCAST_ERR_INVALID_ARG : TETCAST_OK);
            tetcast_optics_destroy(o);
        }
    }
    world_close(&w);
}

/* ---- outputs ---- */

TEST(functions_come_back) { /* values on a grid are those at its nodes; functions are those that were given, in another order */
    static const uint32_t dims[2][3] = {{5, 4, 7}, {1, 3, 2}};
    tetcast_rbf_function f[40], got;
    int seen[40];
    uint32_t components, g, i, j, k, n;
    for (components = 1; components <= 3; components += 2) {
        tetcast_rbf_desc d = functions_desc(f, components);
        tetcast_rbf *m = NULL;
        CHECK_EQ_U64(tetcast_rbf_create(&d, &m), TETCAST_OK);
        REQUIRE(m != NULL);
        for (g = 0; g < 2; g++) {
            float grid[5 * 4 * 7 * 3], one[3];
            CHECK_EQ_U64(tetcast_rbf_grid(NULL, m, dims[g], grid), TETCAST_OK);
            for (n = k = 0; k < dims[g][2]; k++)
                for (j = 0; j < dims[g][1]; j++)
                    for (i = 0; i < dims[g][0]; i++, n += components) {
                        const uint32_t at[3] = {i, j, k};
                        double p[3];
                        int a;
                        for (a = 0; a < 3; a++) p[a] = dims[g][a] > 1 ? at[a] / (dims[g][a] - 1.0) : 0.5;
                        CHECK_EQ_U64(tetcast_rbf_eval(NULL, m, p, 1, one, NULL), TETCAST_OK);
                        for (a = 0; a < (int)components; a++) CHECK_NEAR(grid[n + (uint32_t)a], one[a], 1e-5);
                    }
        }
        memset(seen, 0, sizeof seen);
        for (i = 0; i < 40; i++) {
            CHECK(tetcast_rbf_get_function(m, i, &got));
            for (j = 0; j < 40; j++) {
                double off = fabs(got.width - f[j].width);
                int a;
                for (a = 0; a < 3; a++) off += fabs(got.centre[a] - f[j].centre[a]);
                if (off > 1e-5) continue;
                seen[j]++;
                for (a = 0; a < (int)components; a++) CHECK(got.weight[a] == f[j].weight[a]);
                CHECK_NEAR(got.stretch, f[j].stretch > 0 ? f[j].stretch : 1, 1e-6);
                if (f[j].stretch > 0) { /* the same line */
                    double dot = 0, u = 0, v = 0;
                    for (a = 0; a < 3; a++) {
                        dot += got.axis[a] * f[j].axis[a];
                        u += got.axis[a] * got.axis[a];
                        v += f[j].axis[a] * f[j].axis[a];
                    }
                    CHECK_NEAR(dot * dot, u * v, 1e-5 * u * v);
                }
            }
        }
        for (j = 0; j < 40; j++) CHECK(seen[j] == 1);
        CHECK(!tetcast_rbf_get_function(m, 40, &got) && !tetcast_rbf_get_function(NULL, 0, &got) && !tetcast_rbf_get_function(m, 0, NULL));
        tetcast_rbf_destroy(m);
    }
}

/* Every buffer of a picture against its floats, what is counted against the picture, and limits at which nothing or all is seen. */
TEST(pictures_in_all_buffers) {
    static world w;
    uint32_t way, i;
    world_open(&w);
    for (way = 0; way < 4; way++) { /* bricks, functions, tetrahedra by a shader, by optics that are a surface */
        uint32_t pass;
        static uint8_t all8[SIDE * SIDE * 4];
        static float all[SIDE * SIDE * 4];
        for (pass = 0; pass < 3; pass++) { /* no limit; one behind everything; one before it */
            tetcast_render_stats stats;
            uint64_t hits = 0, steps = 0, sum = 0;
            for (i = 0; i < SIDE * SIDE; i++) w.limit[i] = pass == 2 ? 1e-3f : 1e6f;
            memset(&stats, 0, sizeof stats);
            memset(w.rgba8, 1, sizeof w.rgba8);
            if (way == 0) {
                tetcast_brick_render_desc d;
                memset(&d, 0, sizeof d);
                d.limit = pass > 0 ? w.limit : NULL;
                CHECK_EQ_U64(tetcast_render_bricks(&d, w.cut, w.optics, &w.image, &stats), TETCAST_OK);
            } else if (way == 1) {
                tetcast_rbf_render_desc d;
                tetcast_rbf_render_stats rs;
                if (pass > 0) break;
                memset(&d, 0, sizeof d);
                memset(&rs, 0, sizeof rs);
                CHECK_EQ_U64(tetcast_rbf_render(&d, w.rbf, w.optics, &w.image, &rs), TETCAST_OK);
                stats.rays = rs.rays;
                stats.hit_rays = rs.hit_rays;
                CHECK(rs.samples > 0 && rs.evaluations > 0 && rs.step > 0);
            } else {
                tetcast_shade_desc d;
                memset(&d, 0, sizeof d);
                d.limit = pass > 0 ? w.limit : NULL;
                CHECK_EQ_U64(tetcast_render_shaded(&d, w.mesh, way == 2 ? w.optics : w.surface, &w.image, &stats), TETCAST_OK);
            }
            for (i = 0; i < SIDE * SIDE; i++) {
                const float *c = w.rgba + 4 * i;
                const uint8_t *b = w.rgba8 + 4 * i;
                int a;
                hits += w.steps[i] != 0;
                steps += w.steps[i];
                CHECK(c[3] >= 0 && c[3] <= 1.00001f && (w.depth[i] < INFINITY) == (c[3] > 0));
                CHECK(fabs((double)b[3] - 255 * (double)c[3]) < 0.51);
                for (a = 0; a < 3 && c[3] > 0; a++) { /* sRGB of the colour without its opacity */
                    const double x = fmin(1, (double)c[a] / (double)c[3]);
                    const double want = 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1 / 2.4) - 0.055);
                    CHECK_MSG(fabs((double)b[a] - want) < 0.6, "way %u pass %u: byte %u for %g", way, pass, b[a], want);
                }
                sum += b[3];
            }
            CHECK_EQ_U64(stats.rays, SIDE * SIDE);
            if (way != 1) CHECK_EQ_U64(stats.steps, steps);
            if (pass < 2) CHECK_MSG(stats.hit_rays > SIDE * SIDE / 8 && (way == 1 || hits <= stats.hit_rays) && sum > 1000, "way %u: %u rays, sum %u", way,
                                    (uint32_t)stats.hit_rays, (uint32_t)sum);
            if (pass == 0) {
                memcpy(all8, w.rgba8, sizeof all8);
                memcpy(all, w.rgba, sizeof all);
            } else if (pass == 1) CHECK(memcmp(all8, w.rgba8, sizeof all8) == 0 && memcmp(all, w.rgba, sizeof all) == 0);
            else CHECK_EQ_U64(sum, 0);
        }
    }
    world_close(&w);
}

TEST(names) {
    tetcast_report report;
    static world w;
    int i, k;
#define NAME(id, value, text) CHECK(strcmp(tetcast_result_string((tetcast_result)value), text) == 0);
    TETCAST_RESULT_LIST(NAME)
#undef NAME
    CHECK(strcmp(tetcast_result_string((tetcast_result)1234), "unknown result") == 0);
    for (i = 0; i <= TETCAST_ISA_AVX512; i++)
        for (k = 0; k < i; k++) CHECK(strcmp(tetcast_isa_name((tetcast_isa)i), tetcast_isa_name((tetcast_isa)k)) != 0);
    CHECK(strcmp(tetcast_isa_name((tetcast_isa)99), "unknown") == 0);
    CHECK_EQ_U64(tetcast_version(), TETCAST_VERSION);
    world_open(&w);
    tetcast_mesh_get_report(w.mesh, &report);
    CHECK(report.hull_faces == 6 * 9 * 2 && report.first_bad_index == TETCAST_NONE);
    tetcast_mesh_get_report(NULL, &report);
    CHECK(report.hull_faces == 0 && report.first_bad_index == TETCAST_NONE);
    world_close(&w);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(every_request_refused);
    RUN(limits_hold);
    RUN(cancelled);
    RUN(pictures_too_large);
    RUN(tables_too_short);
    RUN(functions_come_back);
    RUN(pictures_in_all_buffers);
    RUN(names);
    return test_end();
}
