/* fuzz_tets.c - bytes as a mesh of cells or a grid, a transfer function and a camera of tetcast.h: a refusal, or a mesh that is the same for
   any number of threads, rays that end, pictures that are the same for every isa, a surface, nodes of a lattice, a cut by a plane, bricks.
   Bytes: 32 of options; then 16-bit numbers, odd: a multiple of 1/64, even: the upper half of a float; indices are their low bytes. */
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"

enum { WIDE = 9, HIGH = 7, NUMBERS = 256, OPTIONS = 32, VERTICES = 40, CELLS = 32, KNOTS = 8, SIDE = 5, ROOM = 1 << 26 };
typedef struct picture {
    float rgba[HIGH * WIDE][4], depth[HIGH * WIDE], length[HIGH * WIDE];
    uint8_t rgba8[HIGH * WIDE][4];
    uint32_t steps[HIGH * WIDE];
} picture;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(int ok) {
    if (!ok) abort();
}
static int is_finite(float x) { return x - x == 0.0f; }

static tetcast_env env_of(uint32_t threads) {
    tetcast_env e;
    memset(&e, 0, sizeof e);
    e.thread_count = threads;
    e.memory_limit = ROOM;
    return e;
}

/* A mesh by one thread and by two: the same one, or the same refusal. */
static tetcast_mesh *build(const uint8_t *o, const float *f, const uint8_t *low) {
    static const uint8_t shapes[8] = {10, 10, 10, 11, 12, 13, 14, 99}, corners[8] = {4, 4, 4, 8, 8, 6, 5, 4};
    uint32_t index[CELLS * 8], at = 0, i, k;
    uint8_t shape[CELLS], mask[CELLS];
    float values[2][VERTICES * 2];
    tetcast_mesh_desc d;
    tetcast_input in;
    tetcast_grid g;
    tetcast_field field[2];
    tetcast_report report[2];
    tetcast_mesh *mesh[2] = {NULL, NULL};
    tetcast_result r[2];
    memset(&d, 0, sizeof d); memset(&in, 0, sizeof in); memset(&g, 0, sizeof g); memset(field, 0, sizeof field); memset(report, 0, sizeof report);
    for (i = 0; i < 2 * VERTICES; i++) {
        values[0][i] = f[(100 + i) % NUMBERS];
        values[1][i] = f[(180 + i) % NUMBERS];
    }
    for (i = 0; i < 2; i++) field[i].values.data = values[i];
    field[0].name = "a";
    field[1].per_cell = 1;
    d.cells = (tetcast_cells)(o[0] % 8); d.order = (tetcast_order)(o[0] >> 3 & 3); d.weld = o[0] >> 5 & 1; d.drop_tets = o[1] & 1;
    d.drop_source = o[1] >> 1 & 1; d.keep_neighbours = o[1] >> 2 & 1; d.disable_clusters = o[1] >> 3 & 1; d.strict = o[1] >> 4 & 1;
    if (o[1] & 32) {
        for (k = 0; k < 3; k++) {
            g.dims[k] = (o[2] >> (2 * k) & 3u) + 1u;
            g.axes[k].data = o[3] & 1 ? f + 20 * k : NULL;
            g.origin[k] = o[3] & 2 ? (double)f[60 + k] : 0;
            g.spacing[k] = o[3] & 4 ? (double)f[63 + k] : 0;
        }
        for (k = 0; k < 9 && o[3] & 8; k++) g.matrix[k] = (double)f[66 + k];
        if (o[3] & 16) g.positions.data = f;
        if (o[3] & 32) g.blanks = low;
        g.alternate = o[3] >> 6 & 1;
        g.fields = field;
        g.field_count = 1;
    } else {
        in.positions.data = f;
        in.vertex_count = 1u + o[2] % VERTICES;
        in.indices = index;
        in.cell_count = o[3] % (CELLS + 1u);
        for (i = 0; i < in.cell_count; i++) {
            const uint8_t what = o[1] & 64 ? low[i] >> 5 : 0;
            shape[i] = shapes[what];
            mask[i] = low[i] >> 4 & 1;
            for (k = 0; k < corners[what]; k++) {
                const uint8_t v = low[(37 * i + 5 * k + o[4]) % NUMBERS];
                index[at++] = v == 255 ? 0xffffffffu : v % (uint32_t)in.vertex_count;
            }
        }
        in.index_count = at;
        if (o[1] & 64) in.shapes = shape;
        if (o[1] & 128) in.masks = mask;
        in.fields = field;
        in.field_count = o[4] & 3 ? (o[4] & 1) + 1u : 0;
        if ((o[4] & 3) == 2) in.fields = field + 1, in.field_count = 1;
    }
    for (k = 0; k < 2; k++) {
        d.env = env_of(k != 0 && (o[16] & 8) ? 2 : 1);
        r[k] = o[1] & 32 ? tetcast_mesh_create_grid(&d, &g, &report[k], &mesh[k]) : tetcast_mesh_create(&d, &in, &report[k], &mesh[k]);
        must((r[k] == TETCAST_OK) == (mesh[k] != NULL));
    }
    must(r[0] == r[1] && memcmp(&report[0], &report[1], sizeof report[0]) == 0);
    if (mesh[1] != NULL) {
        tetcast_mesh_info a, b;
        tetcast_report kept;
        memset(&kept, 0, sizeof kept);
        tetcast_mesh_get_report(mesh[1], &kept);
        must(memcmp(&kept, &report[0], sizeof kept) == 0);
        memset(&a, 0, sizeof a); memset(&b, 0, sizeof b);
        tetcast_mesh_get_info(mesh[0], &a);
        tetcast_mesh_get_info(mesh[1], &b);
        must(memcmp(&a, &b, sizeof a) == 0 && a.cell_count == report[0].cells && a.cell_count != 0);
        for (i = 0; i < a.vertex_count; i++) {
            double p[2][3];
            float v[2] = {0, 0};
            uint32_t source[2] = {0, 0};
            for (k = 0; k < 2; k++) tetcast_mesh_vertex(mesh[k], i, p[k], &v[k], &source[k]);
            must(memcmp(p[0], p[1], sizeof p[0]) == 0 && memcmp(&v[0], &v[1], 4) == 0 && source[0] == source[1]);
        }
    }
    tetcast_mesh_destroy(mesh[1]);
    return mesh[0];
}

static int seen(void *user, const tetcast_crossing *c) {
    must(c->t_front <= c->t_back);
    return ++*(uint32_t *)user >= 100;
}

/* All that a mesh can be asked: its parts, rays, a surface, nodes, a plane. */
static void ask(tetcast_mesh *mesh, const uint8_t *o, const float *f) {
    tetcast_mesh_info info;
    tetcast_check check;
    tetcast_surface_desc sd;
    tetcast_surface surface;
    tetcast_lattice lattice;
    tetcast_plane plane;
    tetcast_section section;
    float node[SIDE * SIDE * SIDE], again[SIDE * SIDE * SIDE];
    tetcast_means means;
    tetcast_env env = env_of(1 + (o[5] & 1));
    uint32_t i, k, count = 0;
    tetcast_mesh_get_info(mesh, &info);
    for (i = 0; i < info.field_count; i++) {
        float lo, hi;
        must(tetcast_mesh_find_field(mesh, tetcast_mesh_field(mesh, i, &lo, &hi)) <= i);
    }
    if (tetcast_mesh_check(mesh, &env, &check) == TETCAST_OK) must(check.components >= 1 && check.components <= info.cell_count);
    for (i = 0; i < info.cell_count; i++) {
        uint32_t v[4], source;
        if (tetcast_mesh_cell(mesh, i, v, &source) == TETCAST_OK)
            for (k = 0; k < 4; k++) must(v[k] < info.vertex_count);
    }
    for (i = 0; i < info.hull_face_count; i++) {
        uint32_t v[3];
        tetcast_mesh_hull_face(mesh, i, v);
        for (k = 0; k < 3; k++) must(v[k] < info.vertex_count);
    }
    for (i = 0; i < 4; i++) {
        tetcast_ray ray;
        memset(&ray, 0, sizeof ray);
        for (k = 0; k < 3; k++) {
            ray.org[k] = (double)f[(200 + 7 * i + k) % NUMBERS];
            ray.dir[k] = (double)f[(203 + 7 * i + k) % NUMBERS];
        }
        if (o[5] & 2) ray.t_min = (double)f[230], ray.t_max = (double)f[231];
        (void)tetcast_probe(mesh, &ray, seen, &count);
    }
    if (o[5] & 4) (void)tetcast_mesh_make_gradients(mesh, &env);
    memset(&sd, 0, sizeof sd);
    sd.env = env;
    sd.isovalue = f[232];
    sd.normals = o[5] >> 3 & 1;
    sd.cells = 1;
    if (tetcast_isosurface(&sd, mesh, &surface) == TETCAST_OK) {
        for (i = 0; i < 3 * surface.triangle_count; i++) must(surface.indices[i] < surface.vertex_count);
        for (i = 0; i < surface.triangle_count; i++) must(surface.cells[i] < info.cell_count);
        for (i = 0; i < 3 * surface.vertex_count; i++) must(is_finite(surface.positions[i]) && (surface.normals == NULL || is_finite(surface.normals[i])));
        tetcast_surface_free(&surface);
    }
    if (tetcast_lattice_fit(mesh, SIDE, &lattice) == TETCAST_OK) {
        tetcast_resample_desc d[2];
        memset(d, 0, sizeof d);
        for (k = 0; k < 2; k++) {
            d[k].env = env;
            d[k].axis = o[6] & 3;
            d[k].extend = o[6] >> 2 & 1;
            d[k].use_fill = o[6] >> 3 & 1;
            d[k].isa = k != 0 ? TETCAST_ISA_SCALAR : TETCAST_ISA_AUTO;
        }
        memset(node, 0, sizeof node); memset(again, 0, sizeof again);
        if (lattice.dims[0] <= SIDE && lattice.dims[1] <= SIDE && lattice.dims[2] <= SIDE) {
            must(tetcast_resample(&d[0], mesh, &lattice, node, NULL) == tetcast_resample(&d[1], mesh, &lattice, again, NULL));
            must(memcmp(node, again, sizeof node) == 0);
            memset(&means, 0, sizeof means);
            means.mean = node;
            means.share = again;
            (void)tetcast_resample_mean(&env, mesh, &lattice, &means);
        }
    }
    for (k = 0; k < 3; k++) {
        plane.origin[k] = (double)f[240 + k];
        plane.u[k] = (double)f[243 + k];
        plane.v[k] = (double)f[246 + k];
    }
    (void)tetcast_plane_sample(&env, mesh, &plane, SIDE, SIDE, node);
    {
        tetcast_camera camera;
        memset(&camera, 0, sizeof camera);
        for (k = 0; k < 3; k++) {
            camera.eye[k] = o[17] & 32 ? (double)f[90 + k] : info.box_min[k] - 2 * (k + 1.0);
            camera.at[k] = o[17] & 32 ? (double)f[93 + k] : info.box_max[k];
        }
        camera.ortho_height = o[17] & 64 ? f[100] : 0;
        if (tetcast_plane_view(&env, mesh, &plane, &camera, SIDE, SIDE, node, again) == TETCAST_OK)
            for (i = 0; i < SIDE * SIDE; i++) must(again[i] == again[i] && (node[i] != node[i] || again[i] < INFINITY));
    }
    if (tetcast_plane_section(&env, mesh, &plane, &section) == TETCAST_OK) {
        for (i = 0; i < section.polygon_count; i++) {
            must(section.first[i + 1] > section.first[i] + 2 && section.first[i + 1] <= section.first[i] + 4 && section.cells[i] < info.cell_count);
        }
        must(section.polygon_count == 0 || section.first[section.polygon_count] == section.point_count);
        tetcast_section_free(&section);
    }
}

static void shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    int i;
    (void)user;
    for (i = 0; i < 8; i++) {
        const float a = in->mask >> i & 1u ? 0.25f : 0.0f;
        rgba[0][i] = rgba[1][i] = rgba[2][i] = 0.5f * a;
        rgba[3][i] = a;
    }
}

/* A transfer function, asked at ends and middles of its knots: bounds hold; another one, and where the two differ. */
static void ask_transfer(const tetcast_transfer *a, const tetcast_transfer *b, const tetcast_control_point *knot, uint32_t count) {
    float lo, hi;
    uint32_t i, k;
    tetcast_transfer_difference(a, b, &lo, &hi);
    for (i = 0; i + 1 < count; i++) {
        const float from = knot[i].value, to = knot[i + 1].value, middle = from + 0.5f * (to - from), at[3] = {from, middle, to};
        const float most = tetcast_transfer_max_extinction(a, from, to);
        const int empty = tetcast_transfer_is_empty(a, from, to);
        float emission[3], rgba[2][4];
        tetcast_transfer_max_emission(a, from, to, emission);
        for (k = 0; k < 3; k++) {
            tetcast_transfer_eval(a, at[k], rgba[0]);
            tetcast_transfer_eval(b, at[k], rgba[1]);
            must(is_finite(rgba[0][0]) && is_finite(rgba[0][3]));
            if (!(at[k] < 1e38f && at[k] > -1e38f)) continue;
            must(rgba[0][3] <= most * 1.0001f || k == 2); /* at a jump eval gives what lies above */
            must(!empty || rgba[0][3] == 0.0f || k == 2);
            if (at[k] < lo || at[k] > hi || lo > hi) must(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
        }
        for (k = 0; k < 3; k++) must(is_finite(emission[k]) && emission[k] >= 0.0f);
    }
}

/* Rays given as segments; optics made anew from others are those that would be made from nothing. */
static void ask_optics(const tetcast_optics *optics, const tetcast_transfer *other, const tetcast_optics_desc *od, const float *f) {
    tetcast_optics *anew[2] = {NULL, NULL};
    tetcast_segment s[16];
    tetcast_result r[3];
    float rgba[3][16][4], sum[4];
    size_t used = 99;
    uint32_t i, k;
    for (i = 0; i < 16; i++) {
        s[i].front = i & 1 ? s[i - 1].back : f[(3 * i + 110) % NUMBERS];
        s[i].back = f[(3 * i + 111) % NUMBERS];
        s[i].length = f[(3 * i + 112) % NUMBERS];
        s[i].depth = f[i];
        if (s[i].length < 0.0f) s[i].length = 0.0f - s[i].length;
    }
    memset(rgba, 0, sizeof rgba);
    (void)tetcast_optics_ray(optics, s, 16, sum, &used);
    must(used <= 16 && is_finite(sum[0]) && is_finite(sum[3]));
    r[0] = tetcast_optics_segments(optics, s, 16, TETCAST_ISA_SCALAR, rgba[0]);
    r[1] = tetcast_optics_segments(optics, s, 16, TETCAST_ISA_AUTO, rgba[1]);
    must(r[0] == r[1] && memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
    for (i = 0; i < 16 && r[0] == TETCAST_OK; i++) {
        must(tetcast_optics_ray(optics, &s[i], 1, sum, NULL) == TETCAST_OK && memcmp(sum, rgba[0][i], sizeof sum) == 0);
    }
    for (k = 0; k < 2; k++) r[k] = k ? tetcast_optics_update(optics, other, od, &anew[k]) : tetcast_optics_create(other, od, &anew[k]);
    must(r[0] == r[1]);
    memset(rgba, 0, sizeof rgba);
    for (k = 0; k < 2 && r[0] == TETCAST_OK; k++) r[2] = tetcast_optics_segments(anew[k], s, 16, TETCAST_ISA_AUTO, rgba[k]);
    must(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
    tetcast_optics_destroy(anew[0]);
    tetcast_optics_destroy(anew[1]);
}

/* Single rays, by all instruction sets and numbers of threads. */
static void cast(const tetcast_render_desc *desc, const tetcast_mesh *mesh, const tetcast_optics *optics, const uint8_t *o, const float *f) {
    enum { RAYS = 12 };
    tetcast_render_desc d = *desc;
    tetcast_ray ray[RAYS];
    tetcast_ray_result got[2][RAYS];
    tetcast_result r[2];
    tetcast_mesh_info info;
    uint32_t i, k;
    memset(ray, 0, sizeof ray);
    memset(got, 0, sizeof got);
    tetcast_mesh_get_info(mesh, &info);
    for (i = 0; i < RAYS; i++) {
        if (i & 1) {
            tetcast_camera c = d.camera;
            if (tetcast_camera_fit(&c, info.box_min, info.box_max, i & 2 ? ray[i - 1].dir : NULL, RAYS, 1) != TETCAST_OK) continue;
            (void)tetcast_camera_ray(&c, RAYS, RAYS, (double)i, 0.5 * RAYS, &ray[i]);
            continue;
        }
        for (k = 0; k < 3; k++) {
            ray[i].org[k] = (double)f[(150 + 5 * i + k) % NUMBERS];
            ray[i].dir[k] = (double)f[(153 + 7 * i + k) % NUMBERS];
        }
        if (o[17] & 1) ray[i].t_min = (double)f[200 + i], ray[i].t_max = (double)f[212 + i];
    }
    for (k = 0; k < 2; k++) {
        d.env = env_of(k != 0 && (o[16] & 8) ? 2 : 1);
        d.isa = k != 0 ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        r[k] = tetcast_cast(&d, mesh, o[17] & 2 ? NULL : optics, ray, RAYS, got[k], NULL);
    }
    must(r[0] == r[1]);
    if (r[0] != TETCAST_OK) return;
    must(memcmp(got[0], got[1], sizeof got[0]) == 0);
    for (i = 0; i < RAYS; i++) must(is_finite(got[0][i].rgba[0]) && is_finite(got[0][i].rgba[3]) && got[0][i].length >= 0.0f);
}

static void transfer_of(tetcast_transfer_desc *td, tetcast_control_point knot[KNOTS], tetcast_isovalue iso[2], const uint8_t *o, const float *f) {
    uint32_t i, k;
    memset(td, 0, sizeof *td); memset(knot, 0, KNOTS * sizeof *knot); memset(iso, 0, 2 * sizeof *iso);
    for (i = 0; i < KNOTS; i++) { /* values ascend, the others are any */
        knot[i].value = (i != 0 ? knot[i - 1].value : f[250]) + (f[20 + i] > 0.0f ? f[20 + i] : 0.0f);
        for (k = 0; k < 3; k++) knot[i].rgb[k] = o[7] & 1 ? f[30 + 3 * i + k] : (float)((i + k) % 4) / 4;
        knot[i].extinction = o[7] & 2 ? f[60 + i] : (float)(i % 3);
    }
    for (i = 0; i < 2; i++) {
        iso[i].value = f[70 + i];
        iso[i].opacity = o[7] & 4 ? f[72 + i] : 0.5f;
        iso[i].rgb[i] = 1;
        iso[i].specular = o[7] & 8 ? f[74] : 0.2f;
    }
    td->env = env_of(1);
    td->points = knot;
    td->point_count = o[8] % (KNOTS + 1u);
    td->color_mode = (tetcast_color_mode)(o[7] >> 4 & 1);
    td->isovalues = iso;
    td->isovalue_count = o[7] >> 5 & 1 ? 2 : 0;
    td->simplify = o[7] & 64 ? f[76] : 0;
    td->extinction_scale = o[7] & 128 ? f[77] : 0;
}

static void optics_of(tetcast_optics_desc *od, tetcast_light *light, const uint8_t *o, const float *f) {
    memset(od, 0, sizeof *od); memset(light, 0, sizeof *light);
    od->env = env_of(1);
    od->model = (tetcast_model)(o[9] & 7);
    od->integrator = (tetcast_integrator)(o[9] >> 3 & 15);
    od->samples = o[10] & 3;
    od->table_values = 2u + (o[10] >> 2 & 7);
    od->table_lengths = 2u + (o[10] >> 5);
    od->longest = o[11] & 1 ? f[78] : 2;
    od->step = o[11] & 2 ? f[79] : 0;
    od->t_min = o[11] & 4 ? f[80] : 0;
    od->tolerance = o[11] & 8 ? f[81] : 0;
    od->path_length = o[11] & 16 ? f[82] : 0;
    od->cue = o[11] >> 5 & 1;
    od->cue_depth[1] = f[83];
    od->cue_scale[0] = 1;
    light->direction[0] = f[84];
    light->direction[1] = light->rgb[0] = 1;
    od->lights = light;
    od->light_count = o[11] >> 6 & 1;
}

/* A picture by the scalar code and by the best, on one thread and perhaps two, by the method or shaded, `every` without a shader of
   its own. Then over itself. */
static void draw_both_ways(const tetcast_render_desc *desc, const tetcast_mesh *mesh, const tetcast_optics *optics, const uint8_t *o,
                           int by_method, int every) {
    static picture p[2];
    const uint32_t overlap[4] = {o[18] & 15u, o[18] >> 4, o[19] & 15u, o[19] >> 4}; /* borders that fade */
    const int fits = overlap[0] <= WIDE && overlap[1] <= WIDE && overlap[2] <= HIGH && overlap[3] <= HIGH;
    tetcast_render_desc d = *desc;
    tetcast_result r[2];
    uint32_t k;
    memset(p, 0, sizeof p);
    for (k = 0; k < 2; k++) {
        tetcast_image m;
        memset(&m, 0, sizeof m);
        m.width = WIDE;
        m.height = HIGH;
        m.rgba = p[k].rgba[0];
        m.rgba8 = p[k].rgba8[0];
        m.length = p[k].length;
        if (o[13] & 2) m.depth = p[k].depth;
        if (o[13] & 4) m.steps = p[k].steps;
        d.env = env_of(k != 0 && (o[16] & 8) ? 2 : 1);
        d.isa = k != 0 ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        if (by_method) r[k] = tetcast_render(&d, mesh, optics, &m, NULL);
        else {
            tetcast_shader s;
            tetcast_shade_desc sd;
            memset(&s, 0, sizeof s); memset(&sd, 0, sizeof sd);
            s.shade_fn = shade;
            s.needs = o[13] >> 3 & 15;
            sd.env = d.env;
            sd.camera = d.camera;
            sd.clip_near = d.clip_near;
            sd.shader = every ? NULL : &s;
            r[k] = tetcast_render_shaded(&sd, mesh, optics, &m, NULL);
        }
    }
    must(r[0] == r[1]);
    if (r[0] != TETCAST_OK) return;
    must(memcmp(&p[0], &p[1], sizeof p[0]) == 0);
    for (k = 0; k < HIGH * WIDE; k++) must(is_finite(p[0].rgba[k][3]) && is_finite(p[0].rgba[k][0]) && p[0].length[k] >= 0.0f);
    tetcast_over(p[0].rgba[0], p[1].rgba[0], WIDE * HIGH); /* in front of itself */
    must((tetcast_edge_blend(p[1].rgba[0], WIDE, HIGH, overlap) == TETCAST_OK) == fits);
    for (k = 0; k < HIGH * WIDE; k++) must(is_finite(p[0].rgba[k][0]) && is_finite(p[1].rgba[k][0]));
}

/* A picture of the mesh, walked, projected or with a shader, by all instruction sets. */
static void draw(const tetcast_mesh *mesh, const uint8_t *o, const float *f) {
    tetcast_control_point knot[KNOTS];
    tetcast_isovalue iso[2];
    tetcast_light light;
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_render_desc d;
    tetcast_transfer *transfer = NULL, *other = NULL;
    tetcast_optics *optics = NULL;
    tetcast_transfer_info ti;
    tetcast_optics_info oi;
    uint32_t i, k;
    memset(&d, 0, sizeof d);
    transfer_of(&td, knot, iso, o, f);
    optics_of(&od, &light, o, f);
    if (tetcast_transfer_create(&td, &transfer) != TETCAST_OK) return;
    tetcast_transfer_get_info(transfer, &ti);
    must(ti.knot_count + ti.dropped_count >= ti.jump_count && ti.value[0] <= ti.value[1] && ti.isovalue_count <= td.isovalue_count);
    must(is_finite(ti.largest_extinction) && is_finite(ti.largest_color) && ti.largest_extinction >= 0.0f && ti.largest_color >= 0.0f);
    if (td.point_count != 0) { /* one knot is another one */
        tetcast_control_point was = knot[o[17] >> 2 & 7];
        knot[o[17] >> 2 & 7].extinction = 3;
        knot[o[17] >> 2 & 7].rgb[1] = 1;
        if (tetcast_transfer_create(&td, &other) != TETCAST_OK) other = NULL;
        knot[o[17] >> 2 & 7] = was;
        if (other != NULL) ask_transfer(transfer, other, knot, (uint32_t)td.point_count);
    }
    if (tetcast_optics_create(transfer, &od, &optics) == TETCAST_OK) {
        tetcast_optics_get_info(optics, &oi);
        must(oi.model == od.model && oi.bound == oi.bound && (oi.bound < 0.0f || (oi.bound_end >= 0.0f && oi.bound_knots >= 0.0f)));
        for (k = 0; k < 3; k++) {
            d.camera.eye[k] = o[12] & 2 ? (double)f[90 + k] : 0;
            d.camera.at[k] = o[12] & 4 ? (double)f[93 + k] : 0;
            d.camera.up[k] = o[12] & 8 ? (double)f[96 + k] : 0;
        }
        d.camera.fov_y = o[12] & 16 ? f[99] : 0;
        d.camera.ortho_height = o[12] & 32 ? f[100] : 0;
        d.clip_near = o[12] & 64 ? f[101] : 0;
        d.clip_far = o[12] & 128 ? f[102] : 0;
        d.smooth_normals = o[5] >> 2 & 1;
        d.traverse_only = o[13] >> 7;
        d.no_leaping = o[13] & 1;
        for (i = o[16] & 3; i < 3; i += 3) {
            d.method = (tetcast_method)(i & 1 ? TETCAST_METHOD_PROJECT : TETCAST_METHOD_WALK);
            draw_both_ways(&d, mesh, optics, o, i < 2, od.cue == 0 && (o[12] & 1) == 0);
        }
        cast(&d, mesh, optics, o, f);
        if (other != NULL) ask_optics(optics, other, &od, f);
    }
    tetcast_optics_destroy(optics);
    tetcast_transfer_destroy(transfer);
    tetcast_transfer_destroy(other);
}

static void bricks(const tetcast_mesh *mesh, const uint8_t *o, const float *f) {
    static const tetcast_type storage[4] = {TETCAST_TYPE_F32, TETCAST_TYPE_U8, TETCAST_TYPE_U16, TETCAST_TYPE_F16};
    tetcast_bricks_desc d;
    tetcast_bricks_report report;
    tetcast_bricks *b = NULL;
    tetcast_cut_desc cd;
    tetcast_cut *cut = NULL;
    uint32_t i;
    memset(&d, 0, sizeof d); memset(&cd, 0, sizeof cd); memset(&report, 0, sizeof report);
    d.env = env_of(1 + (o[14] & 1));
    d.log_cells = 3;
    d.storage = storage[o[14] >> 1 & 3];
    d.max_error = o[14] & 8 ? f[110] : 0;
    d.longest = o[14] & 16 ? 2u + o[15] % 20u : 0;
    d.longest_end = 17;
    d.checks = 20;
    d.average = o[14] >> 5 & 1;
    d.focus_radius = o[14] & 64 ? (double)f[111] : 0;
    if (tetcast_bricks_create_mesh(&d, mesh, &report, &b) != TETCAST_OK) return;
    must(report.above <= report.checks);
    cd.env = env_of(1);
    cd.max_jump = o[14] >> 7;
    cd.max_error = f[112] > 0 ? f[112] : 0;
    cd.byte_budget = o[15] & 32 ? 1u << 14 : 0;
    if (tetcast_cut_create(&cd, b, &cut) == TETCAST_OK) {
        float x[3][9], v[9], g[9][3];
        const uint8_t *level = tetcast_cut_levels(cut);
        uint64_t slots[TETCAST_BRICK_LEVELS] = {0};
        tetcast_bricks_info info;
        tetcast_cut_info ci;
        double pace;
        tetcast_bricks_get_info(b, &info);
        tetcast_cut_get_info(cut, &ci);
        for (i = 0; i < info.slots[0] * info.slots[1] * info.slots[2]; i++) {
            must(level[i] < info.levels);
            slots[level[i]]++;
        }
        must(memcmp(slots, ci.level_slots, sizeof slots) == 0 && ci.samples >= 1.0 / 32.0 && ci.samples <= 1.0);
        pace = tetcast_cut_pace(&ci, (double)f[140], (double)f[141]);
        must(pace >= 1.0 / 32.0 && pace <= 1.0);
        for (i = 0; i < 27; i++) x[i / 9][i % 9] = f[113 + i];
        tetcast_cut_sample(cut, x[0], x[1], x[2], 9, TETCAST_ISA_AUTO, v);
        tetcast_cut_gradient(cut, x[0], x[1], x[2], 9, v, g);
    }
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(b);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    float f[NUMBERS];
    uint8_t low[NUMBERS];
    tetcast_mesh *mesh;
    size_t i;
    if (size < OPTIONS + 2) return 0;
    for (i = 0; i < NUMBERS; i++) { /* those that are missing repeat the others */
        const uint8_t *q = data + OPTIONS + 2 * (i % ((size - OPTIONS) / 2));
        uint32_t u = (uint32_t)q[0] << 8 | q[1], w = u << 16;
        memcpy(&f[i], &w, sizeof w);
        if (u & 1) f[i] = ((float)(u >> 1) - 16384.0f) / 64.0f;
        low[i] = (uint8_t)(q[0] ^ q[1]);
    }
    mesh = build(data, f, low);
    if (mesh == NULL) return 0;
    if (data[4] & 4) (void)tetcast_mesh_set_field(mesh, data[4] >> 3 & 3);
    ask(mesh, data, f);
    draw(mesh, data, f);
    if (data[16] & 4) bricks(mesh, data, f);
    tetcast_mesh_destroy(mesh);
    return 0;
}
