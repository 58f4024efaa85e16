/* tetcast_render.c - volume mesh or grid -> picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/cli.h"
#include "support/volume_scenes.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "support/volume_look.h"

enum { MAX_ISOVALUES = 16 };
enum { METHOD_AUTO, METHOD_MARCH, METHOD_STRIPS, METHOD_PROJECT, METHOD_FOAM };

typedef struct options {
    sup_common common;
    const char *in, *scene, *field, *tf, *mask, *surface;
    int method, model, integrator, cells, order, has_model, has_cells, has_opacity, smooth, weld, has_background, cue;
    int check, colors, constant, strict, five;
    int64_t detail, table;
    double opacity, scale, ortho, samples, simplify;
    int shader, has_cut, has_light;
    float background[3], cut[3], light[3];
    float isovalues[MAX_ISOVALUES];
    size_t isovalue_count;
} options;

/* --iso may be given several times; the table keeps only the last. */
static int collect_isovalues(int argc, char **argv, options *o) {
    for (int i = 1; i < argc && strcmp(argv[i], "--") != 0; i++) {
        const char *value = strcmp(argv[i], "--iso") == 0 && i + 1 < argc ? argv[++i] :
                            strncmp(argv[i], "--iso=", 6) == 0 ? argv[i] + 6 : NULL;
        const char *end;
        double number = 0.0;
        if (!value) continue;
        end = value + strlen(value);
        if (o->isovalue_count == MAX_ISOVALUES)
            return sup_bad_usage(argv[0], "--iso: more than %d values", (int)MAX_ISOVALUES);
        if (sup_parse_double(&value, end, &number) || value != end || !(fabs(number) <= 1e38))
            return sup_bad_usage(argv[0], "--iso: not a number");
        o->isovalues[o->isovalue_count++] = (float)number;
    }
    return -1;
}

/* Options that cannot both be meant. */
static int contradictions(const char *program, const options *o) {
    const int surfaces = o->model == TETCAST_MODEL_ISOSURFACE || o->model == TETCAST_MODEL_MIXED;
    if (surfaces && !o->isovalue_count) return sup_bad_usage(program, "--model iso and mixed need --iso");
    if (!surfaces && o->isovalue_count) return sup_bad_usage(program, "--iso is for --model iso and mixed");
    if (o->surface && !o->isovalue_count) return sup_bad_usage(program, "--surface needs --iso");
    if (o->method == METHOD_STRIPS && o->has_cells && o->cells != TETCAST_CELLS_STRIPS &&
        o->cells != TETCAST_CELLS_STRIPS_GENERAL) return sup_bad_usage(program, "--method strips: --cells are others");
    if (o->method == METHOD_PROJECT && (o->shader || o->has_cut))
        return sup_bad_usage(program, "--shader and --cut walk, they do not project");
    if (o->method == METHOD_FOAM && (o->shader || o->has_cut || o->model != TETCAST_MODEL_VOLUME || o->colors || o->cue ||
                                     o->common.has_tolerance || o->integrator))
        return sup_bad_usage(program, "--method foam: only --model volume with associated colours, without --shader, --cut, --cue, "
                                      "--tolerance and --integrator");
    if (o->has_light && o->shader != SUP_SHADER_SHADOW) return sup_bad_usage(program, "--light is for --shader shadow");
    if (o->light[0] == 0.0f && o->light[1] == 0.0f && o->light[2] == 0.0f)
        return sup_bad_usage(program, "--light: 0,0,0 is no direction");
    if (o->shader == SUP_SHADER_SHADOW && o->model != TETCAST_MODEL_VOLUME)
        return sup_bad_usage(program, "--shader shadow is for --model volume");
    if (o->constant && !o->table) return sup_bad_usage(program, "--constant is for --table");
    if (o->has_cut && o->cut[0] == 0.0f && o->cut[1] == 0.0f && o->cut[2] == 0.0f)
        return sup_bad_usage(program, "--cut: 0,0,0 is no direction");
    if (o->common.has_eye && o->common.has_at &&
        memcmp(o->common.camera.eye, o->common.camera.at, sizeof o->common.camera.eye) == 0)
        return sup_bad_usage(program, "--eye and --at are the same place");
    if (o->common.has_tolerance && o->integrator != TETCAST_INTEGRATOR_EXACT)
        return sup_bad_usage(program, "--tolerance: only the exact integrator knows its error");
    return -1;
}

static int parse(int argc, char **argv, options *o, tetcast_render_desc *desc) {
    sup_option table[SUP_COMMON_OPTIONS + 38];
    double iso = 0.0;
    float clip[3] = {0.0f, 0.0f, 0.0f};
    size_t n;
    int status, has_clip = 0;
    memset(o, 0, sizeof *o);
    o->opacity = 0.6;
    o->light[0] = 0.4f;
    o->light[1] = 1.0f;
    o->light[2] = 0.3f;
    o->scale = 1.0;
    n = sup_common_options(&o->common, table);
    sup_option_help(table, n, "size", "pixels of the picture (1024x768)");
    sup_option_help(table, n, "seed", "changes nothing: no ray is random");
    sup_option_help(table, n, "tolerance", "largest error of a colour in units of 1/255 (exact)");
    sup_option_help(table, n, "quiet", "no progress and no warnings");
    sup_option_help(table, n, "unlit", "changes nothing: volumes have no lights");
    o->common.size[0] = 1024;
    o->common.size[1] = 768;
    table[n++] = sup_opt_positional("MESH", &o->in, 0, ".vtk, .inp, .msh, .node, .ele, or PLOT3D with its Q file");
    table[n++] = sup_opt_text("scene", &o->scene, SUP_VOLUME_SCENES, "a generated volume instead of MESH");
    table[n++] = sup_opt_int("detail", &o->detail, 0, 512, "N", "how fine --scene is");
    table[n++] = sup_opt_text("field", &o->field, "NAME", "the scalar to show (the first one); of a vector its length, "
                              "or NAME_x, NAME_y, NAME_z; x, y, z: the coordinates");
    table[n++] = sup_opt_text("tf", &o->tf, "FILE|" SUP_TRANSFER_NAMES, "transfer function (a rainbow that shows what is rare)");
    table[n++] = sup_opt_int("table", &o->table, 2, 1 << 20, "N", "the transfer function as a table of N samples, as other programs "
                             "have it, instead of control points");
    table[n++] = sup_opt_flag("constant", &o->constant, "between the samples of --table values do not change, but half way");
    table[n++] = sup_opt_real("simplify", &o->simplify, 0.0, 1.0, "S", "leave out knots of the transfer function that move no value by "
                              "more than this share of the largest");
    table[n++] = sup_opt_choice("colors", &o->colors, "associated|independent", "colours are of what absorbs, or are the "
                                "emission per length themselves (associated)");
    table[n++] = sup_opt_real("extinction", &o->scale, 1e-9, 1e9, "F", "multiplies all extinctions (a named function has them so that"
                              " most of the volume is seen)");
    table[n++] = sup_opt_choice("method", &o->method, "auto|march|strips|project|foam", "walk from cell to cell; "
                                "through strips; project the cells (auto: the faster of the first and the last); foam: all that is nearest to"
                                " a vertex has its colour");
    table[n++] = sup_opt_real("iso", &iso, -1e38, 1e38, "V", "show the surface of this value; may be repeated");
    table[n++] = sup_opt_given(
        sup_opt_real("iso-opacity", &o->opacity, 0.0, 1.0, "A", "of the surfaces (one: 1, several: 0.6)"), &o->has_opacity);
    table[n++] = sup_opt_flag("smooth", &o->smooth, "smooth normals on the surfaces");
    table[n++] = sup_opt_given(sup_opt_choice("model", &o->model, "volume|emission|absorption|maximum|iso|mixed",
                                              "what light does in it (volume; with --iso: iso, with --iso and --tf: mixed)"), &o->has_model);
    table[n++] = sup_opt_choice("integrator", &o->integrator,
                                "exact|psi|riemann|trapezoid|midpoint|pre|prefix|table|incremental|subrange|table2d|"
                                "table-prefix", "how a segment is integrated (exact)");
    table[n++] = sup_opt_real("samples", &o->samples, 1, 4096, "N", "parts of a segment, where it is cut");
    table[n++] = sup_opt_given(sup_opt_choice("cells", &o->cells, "tet16|tet8|tet20|tet32|list|strips|strips-general",
                                              "how cells are stored (tet16)"), &o->has_cells);
    table[n++] = sup_opt_choice("order", &o->order, "hilbert|morton|input", "order of the cells in memory (hilbert)");
    table[n++] = sup_opt_text("mask", &o->mask, "NAME", "cells whose value of this field is not 0 show nothing");
    table[n++] = sup_opt_text("surface", &o->surface, "FILE.obj", "the first --iso as triangles as well");
    table[n++] = sup_opt_flag("check", &o->check, "all that is wrong with the mesh, in --stats, which it implies");
    table[n++] = sup_opt_flag("strict", &o->strict, "an index out of range, a NaN, a cell of unknown shape is an error");
    table[n++] = sup_opt_flag("five", &o->five, "five tetrahedra for each cell of a grid instead of six");
    table[n++] = sup_opt_flag("weld", &o->weld, "points at the same place become one");
    table[n++] = sup_opt_given(sup_opt_vec3("clip", clip, "near,far,0: show only these distances along the view"),
                               &has_clip);
    table[n++] = sup_opt_given(sup_opt_vec3("cut", o->cut, "keep what lies this way from the middle"), &o->has_cut);
    table[n++] = sup_opt_choice("shader", &o->shader, SUP_MESH_SHADERS, "shaders of this program; lit: by gradients, "
                             "shadow: by --light through the volume, slow");
    table[n++] = sup_opt_given(sup_opt_vec3("light", o->light, "direction towards the light of --shader shadow (0.4,1,0.3)"),
                               &o->has_light);
    table[n++] = sup_opt_real("ortho", &o->ortho, 0.0, 1e30, "H", "parallel rays; height of the picture in the volume");
    table[n++] = sup_opt_flag("cue", &o->cue, "what is farther away is darker");
    table[n++] = sup_opt_given(sup_opt_vec3("background", o->background, "linear r,g,b instead of transparent"),
                               &o->has_background);
    status = sup_cli_parse(argc, argv, "Draws a volume of tetrahedra and other cells.", table, n);
    if (status >= 0) return status;
    status = collect_isovalues(argc, argv, o);
    if (status >= 0) return status;
    if (!o->in == !o->scene) return sup_bad_usage(argv[0], "MESH or --scene has to be given");
    o->common.stats |= o->check;
    status = sup_out_check(argv[0], &o->common);
    if (status >= 0) return status;
    if (!o->has_model && o->isovalue_count) o->model = o->tf ? TETCAST_MODEL_MIXED : TETCAST_MODEL_ISOSURFACE;
    status = contradictions(argv[0], o);
    if (status >= 0) return status;
    if (has_clip && !(clip[0] >= 0.0f && (clip[1] > clip[0] || clip[1] == 0.0f)))
        return sup_bad_usage(argv[0], "--clip: near and far have to ascend");
    memset(desc, 0, sizeof *desc);
    desc->env.thread_count = (uint32_t)o->common.threads;
    desc->isa = (tetcast_isa)o->common.isa;
    desc->clip_near = clip[0];
    desc->clip_far = clip[1];
    desc->smooth_normals = (uint32_t)o->smooth;
    desc->camera.ortho_height = (float)o->ortho;
    if (o->has_background) {
        memcpy(desc->background, o->background, sizeof o->background);
        desc->background[3] = 1.0f;
    }
    if (o->method == METHOD_STRIPS && !o->has_cells) o->cells = TETCAST_CELLS_STRIPS;
    desc->method = o->method == METHOD_AUTO ? TETCAST_METHOD_AUTO :
                   o->method == METHOD_PROJECT ? TETCAST_METHOD_PROJECT : TETCAST_METHOD_WALK;
    return -1;
}

/* ---- optics ------------------------------------------------------------------------------------------------- */

static int see(void *user, const tetcast_crossing *x) {
    sup_shares_add((sup_shares *)user, 0.5 * ((double)x->front + (double)x->back), x->t_back - x->t_front);
    return 0;
}

/* The rainbow by how much of the rays' way through the volume has which value. */
static int rare_transfer(const tetcast_camera *camera, const tetcast_mesh *mesh, double lo, double hi, double diagonal,
                         sup_transfer *tf, sup_error *err) {
    enum { W = 32, H = 24 };
    sup_shares s;
    memset(&s, 0, sizeof s);
    s.lo = lo;
    s.hi = hi;
    for (int i = 0; i < W * H; i++) {
        tetcast_ray ray;
        if (tetcast_camera_ray(camera, W, H, i % W + 0.5, i / W + 0.5, &ray) == TETCAST_OK)
            (void)tetcast_probe(mesh, &ray, see, &s);
    }
    sup_shares_end(&s, 0.0);
    return sup_rare_transfer(&s, diagonal, tf, err);
}

/* What --tf says. A named function lies over the middle 99 % of the values, so that a few odd ones do not take it away
   from the rest. */
static int read_transfer(const options *o, const tetcast_camera *camera, const tetcast_mesh *mesh, double diagonal,
                         sup_transfer *tf, sup_error *err) {
    tetcast_mesh_info info;
    float lo = 0.0f, hi = 1.0f, *values;
    size_t n = 0;
    int failed;
    if (sup_transfer_is_file(o->tf)) return sup_transfer_read(o->tf, tf, err);
    (void)tetcast_mesh_field(mesh, 0, &lo, &hi);
    tetcast_mesh_get_info(mesh, &info);
    values = (float *)sup_alloc((size_t)info.vertex_count, sizeof *values);
    if (!values) return sup_fail(err, "out of memory");
    for (uint64_t i = 0; i < info.vertex_count; i++) {
        double p[3];
        float v = 0.0f;
        tetcast_mesh_vertex(mesh, (uint32_t)i, p, &v, NULL);
        if (v >= lo && v <= hi) values[n++] = v;
    }
    qsort(values, n, sizeof *values, sup_compare_floats);
    if (n >= 1000 && values[n - 1 - n / 200] > values[n / 200]) { /* a field per cell has no values here */
        lo = values[n / 200];
        hi = values[n - 1 - n / 200];
    }
    if (!o->tf && n >= 100 && hi > lo) failed = rare_transfer(camera, mesh, (double)lo, (double)hi, diagonal, tf, err);
    else failed = sup_transfer_named(o->tf ? o->tf : "rainbow", (double)lo, (double)hi, diagonal, tf, err);
    SUP_FREE(values);
    return failed;
}

typedef struct small_picture {
    tetcast_render_desc desc;
    const tetcast_mesh *mesh;
} small_picture;

static tetcast_result draw_small(void *ctx, const tetcast_optics *optics, const tetcast_image *image) {
    const small_picture *p = (const small_picture *)ctx;
    return tetcast_render(&p->desc, p->mesh, optics, image, NULL);
}

static double choose_extinction(const options *o, const tetcast_render_desc *desc, const tetcast_mesh *mesh,
                                const tetcast_transfer *transfer) {
    const double want = o->model == TETCAST_MODEL_EMISSION ? 0.7 : o->model == TETCAST_MODEL_ABSORPTION ? 1.2 : 2.3;
    small_picture p;
    p.desc = *desc;
    p.mesh = mesh;
    memset(p.desc.background, 0, sizeof p.desc.background);
    return sup_extinction_scale(transfer, 64, 48, want, draw_small, &p);
}

/* The points as `count` samples from the first value to the last: jumps become ramps. Freed by the caller. */
static float *sample_points(const tetcast_control_point *p, size_t points, size_t count) {
    float *table = (float *)sup_alloc(count, 4 * sizeof *table);
    for (size_t i = 0, k = 0; table && i < count; i++) {
        const double x = (double)p[0].value + ((double)p[points - 1].value - (double)p[0].value) * (double)i / (double)(count - 1);
        double at;
        while (k + 2 < points && (double)p[k + 1].value <= x) k++;
        at = p[k + 1].value > p[k].value ? (x - (double)p[k].value) / ((double)p[k + 1].value - (double)p[k].value) : 1.0;
        at = at < 1.0 ? at : 1.0;
        for (int c = 0; c < 3; c++)
            table[4 * i + (size_t)c] = (float)((double)p[k].rgb[c] + at * ((double)p[k + 1].rgb[c] - (double)p[k].rgb[c]));
        table[4 * i + 3] = (float)((double)p[k].extinction + at * ((double)p[k + 1].extinction - (double)p[k].extinction));
    }
    return table;
}

static int make_optics(const options *o, const char *in, const tetcast_mesh *mesh, const tetcast_render_desc *render,
                       tetcast_optics **out, tetcast_transfer **colours, double *extinction, sup_error *err) {
    static const float palette[4][3] = {{0.85f, 0.45f, 0.12f}, {0.15f, 0.45f, 0.85f}, {0.3f, 0.75f, 0.25f},
                                        {0.8f, 0.2f, 0.35f}};
    const tetcast_env *env = &render->env;
    tetcast_control_point *points;
    tetcast_isovalue isovalues[MAX_ISOVALUES];
    tetcast_transfer_desc desc;
    tetcast_optics_desc optics;
    tetcast_transfer *transfer = NULL;
    tetcast_mesh_info info;
    tetcast_result result;
    sup_transfer tf;
    const int named = !sup_transfer_is_file(o->tf);
    double diagonal;
    float lo = 0.0f, hi = 0.0f, *table = NULL;
    tetcast_mesh_get_info(mesh, &info);
    diagonal = sup_box_diagonal(info.box_min, info.box_max);
    (void)tetcast_mesh_field(mesh, 0, &lo, &hi);
    if (lo > hi) return sup_fail(err, "%s: all values of the field are NaN or infinite", in);
    if (!(diagonal > 1e-15 && diagonal < 1e17)) /* lengths and what is per length are floats of such a size */
        return sup_fail(err, "%s: the volume is %.3g long, 1e-15 to 1e17 can be shown", in, diagonal);
    if (read_transfer(o, &render->camera, mesh, diagonal, &tf, err)) return 1;
    if (sup_control_points(&tf, &points, err)) {
        sup_transfer_free(&tf);
        return 1;
    }
    memset(isovalues, 0, sizeof isovalues);
    for (size_t i = 0; i < o->isovalue_count; i++) {
        isovalues[i].value = o->isovalues[i];
        memcpy(isovalues[i].rgb, palette[i % 4], sizeof palette[0]);
        isovalues[i].opacity = o->isovalue_count > 1 || o->has_opacity ? (float)o->opacity : 1.0f;
        isovalues[i].specular = 0.25f;
    }
    memset(&desc, 0, sizeof desc);
    memset(&optics, 0, sizeof optics);
    desc.env = *env;
    if (o->table && tf.colors) {
        SUP_FREE(points);
        sup_transfer_free(&tf);
        return sup_fail(err, "%s: --table samples one list of control points, there are two in it", o->tf);
    }
    if (o->table && tf.count > 1) {
        desc.table_steps = (uint32_t)o->constant;
        table = sample_points(points, tf.count, (size_t)o->table);
        desc.table = table;
        desc.table_count = table ? (size_t)o->table : 0;
        desc.table_value[0] = points[0].value;
        desc.table_value[1] = points[tf.count - 1].value;
    } else {
        sup_transfer_points(&tf, points, &desc);
    }
    desc.simplify = (float)o->simplify;
    desc.color_mode = o->colors ? TETCAST_COLOR_INDEPENDENT : TETCAST_COLOR_ASSOCIATED;
    desc.isovalues = isovalues;
    desc.isovalue_count = o->isovalue_count;
    optics.env = *env;
    optics.model = (tetcast_model)o->model;
    optics.integrator = (tetcast_integrator)o->integrator;
    optics.samples = (uint32_t)o->samples;
    if (o->integrator >= TETCAST_INTEGRATOR_TABLE_3D) { /* how long segments can get */
        tetcast_check check;
        optics.longest = tetcast_mesh_check(mesh, env, &check) == TETCAST_OK ? (float)check.longest_edge : (float)diagonal;
    }
    optics.tolerance = o->common.has_tolerance ? fmaxf((float)o->common.tolerance, 1e-9f) : 0.0f; /* 0: its default */
    optics.path_length = (float)diagonal; /* no ray is longer inside of the box */
    optics.ambient[0] = optics.ambient[1] = optics.ambient[2] = 0.1f;
    if (o->cue) {
        optics.cue = 1;
        optics.cue_depth[0] = (float)(0.8 * diagonal);
        optics.cue_depth[1] = (float)(2.4 * diagonal);
        optics.cue_scale[0] = 1.0f;
        optics.cue_scale[1] = 0.25f;
    }
    *extinction = o->scale;
    result = o->table && tf.count > 1 && !table ? TETCAST_ERR_NO_MEMORY : tetcast_transfer_create(&desc, &transfer);
    if (result == TETCAST_OK && named && o->model != TETCAST_MODEL_ISOSURFACE && o->model != TETCAST_MODEL_MAXIMUM)
        *extinction *= choose_extinction(o, render, mesh, transfer);
    if (result == TETCAST_OK && *extinction != 1.0) {
        tetcast_transfer_destroy(transfer);
        desc.extinction_scale = (float)*extinction;
        result = tetcast_transfer_create(&desc, &transfer);
    }
    if (result == TETCAST_OK) result = tetcast_optics_create(transfer, &optics, out);
    *colours = transfer;
    SUP_FREE(table);
    SUP_FREE(points);
    sup_transfer_free(&tf);
    if (result == TETCAST_OK) return 0;
    return sup_fail_result(err, o->tf ? o->tf : "transfer function", result, env->error);
}

/* Move the camera along its view so that all vertices just fit: the box of a bent body is much larger than the body. */
static void fit_vertices(const options *o, const tetcast_mesh *mesh, tetcast_camera *camera) {
    tetcast_mesh_info info;
    double back[3], right[3], up[3], most[4] = {-1e300, -1e300, -1e300, -1e300}, tangent[2], length = 0.0, distance;
    tetcast_mesh_get_info(mesh, &info);
    tangent[1] = tan(o->common.fov * (3.14159265358979 / 360.0));
    tangent[0] = tangent[1] * (double)o->common.size[0] / (double)o->common.size[1];
    for (int k = 0; k < 3; k++) back[k] = camera->eye[k] - camera->at[k];
    for (int k = 0; k < 3; k++) length += back[k] * back[k];
    for (int k = 0; k < 3; k++) back[k] /= sqrt(length);
    for (int k = 0; k < 3; k++) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        right[k] = camera->up[a] * back[b] - camera->up[b] * back[a];
    }
    length = sqrt(right[0] * right[0] + right[1] * right[1] + right[2] * right[2]);
    if (!(length > 1e-6) || info.vertex_count == 0) return;
    for (int k = 0; k < 3; k++) right[k] /= length;
    for (int k = 0; k < 3; k++) up[k] = back[(k + 1) % 3] * right[(k + 2) % 3] - back[(k + 2) % 3] * right[(k + 1) % 3];
    for (uint64_t i = 0; i < info.vertex_count; i++) {
        double p[3], x = 0.0, y = 0.0, z = 0.0;
        tetcast_mesh_vertex(mesh, (uint32_t)i, p, NULL, NULL);
        for (int k = 0; k < 3; k++) {
            x += (p[k] - camera->at[k]) * right[k];
            y += (p[k] - camera->at[k]) * up[k];
            z += (p[k] - camera->at[k]) * back[k];
        }
        most[0] = fmax(most[0], x + z * tangent[0]);
        most[1] = fmax(most[1], -x + z * tangent[0]);
        most[2] = fmax(most[2], y + z * tangent[1]);
        most[3] = fmax(most[3], -y + z * tangent[1]);
    }
    distance = 1.03 * fmax((most[0] + most[1]) / (2.0 * tangent[0]), (most[2] + most[3]) / (2.0 * tangent[1]));
    if (!(distance > 0.0) || !(distance < 1e300)) return;
    for (int k = 0; k < 3; k++) {
        camera->at[k] += 0.5 * (most[0] - most[1]) * right[k] + 0.5 * (most[2] - most[3]) * up[k];
        camera->eye[k] = camera->at[k] + distance * back[k];
    }
}

static void set_camera(const options *o, const tetcast_mesh *mesh, tetcast_camera *camera) {
    tetcast_mesh_info info;
    tetcast_mesh_get_info(mesh, &info);
    if (sup_volume_camera(&o->common, info.box_min, info.box_max, o->ortho, camera) && !(o->ortho > 0.0) &&
        o->method != METHOD_FOAM) /* its cells fill the box */
        fit_vertices(o, mesh, camera);
}

/* ---- output ------------------------------------------------------------------------------------------------- */

/* All that an import counts, and a closer look. */
static void print_check(const tetcast_mesh *mesh, const tetcast_env *env, const tetcast_report *r) {
    tetcast_check c;
    printf(",\"check\":{\"bad_indices\":%llu,\"bad_positions\":%llu,\"bad_shapes\":%llu,\"repeated\":%llu,\"duplicates\":%llu",
           (unsigned long long)r->bad_indices, (unsigned long long)r->bad_positions, (unsigned long long)r->bad_shapes,
           (unsigned long long)r->repeated, (unsigned long long)r->duplicates);
    printf(",\"nonmanifold_faces\":%llu,\"hull_faces\":%llu,\"bad_values\":%llu,\"masked\":%llu,\"welded\":%llu,\"unused_vertices\":%llu",
           (unsigned long long)r->nonmanifold_faces, (unsigned long long)r->hull_faces, (unsigned long long)r->bad_values,
           (unsigned long long)r->masked, (unsigned long long)r->welded, (unsigned long long)r->unused_vertices);
    if (tetcast_mesh_check(mesh, env, &c) == TETCAST_OK)
        printf(",\"hanging_nodes\":%llu,\"coincident_vertices\":%llu,\"components\":%llu,\"volume\":%.9g,\"smallest\":%.6g,"
               "\"largest\":%.6g,\"longest_edge\":%.6g", (unsigned long long)c.hanging_nodes,
               (unsigned long long)c.coincident_vertices, (unsigned long long)c.components, c.volume, c.smallest, c.largest,
               c.longest_edge);
    printf("}");
}

/* The first isosurface as an .obj file. */
static int write_surface(const options *o, const tetcast_env *env, const tetcast_mesh *mesh, sup_error *err) {
    tetcast_surface_desc desc;
    tetcast_surface s;
    tetcast_result result;
    sup_file file;
    memset(&desc, 0, sizeof desc);
    desc.env = *env;
    desc.env.progress_fn = NULL;
    desc.isovalue = o->isovalues[0];
    desc.normals = 1;
    result = tetcast_isosurface(&desc, mesh, &s);
    if (result != TETCAST_OK) return sup_fail_result(err, o->surface, result, env->error);
    if (sup_file_open(o->surface, &file, err)) {
        tetcast_surface_free(&s);
        return 1;
    }
    for (size_t i = 0; i < s.vertex_count; i++) {
        const float *p = s.positions + 3 * i, *n = s.normals + 3 * i;
        fprintf(file.stream, "v %.9g %.9g %.9g\nvn %.4g %.4g %.4g\n", s.origin[0] + (double)p[0], s.origin[1] + (double)p[1],
                s.origin[2] + (double)p[2], (double)n[0], (double)n[1], (double)n[2]);
    }
    for (size_t i = 0; i < s.triangle_count; i++) {
        const unsigned a = s.indices[3 * i] + 1, b = s.indices[3 * i + 1] + 1, c = s.indices[3 * i + 2] + 1;
        fprintf(file.stream, "f %u//%u %u//%u %u//%u\n", a, a, b, b, c, c);
    }
    tetcast_surface_free(&s);
    return sup_file_commit(&file, err);
}

static void print_stats(const options *o, const tetcast_env *env, const char *field, const tetcast_mesh *mesh, const tetcast_report *report,
                        const tetcast_optics *optics, const tetcast_image *image, const tetcast_camera *camera,
                        const tetcast_render_stats *s, double seconds, double extinction) {
    static const char *const integrators[TETCAST_INTEGRATOR_COUNT] = {
        "exact", "psi", "riemann", "trapezoid", "midpoint", "pre", "prefix", "table", "incremental", "subrange", "table2d",
        "table-prefix"};
    tetcast_mesh_info info;
    tetcast_optics_info how;
    float lo = 0.0f, hi = 0.0f;
    tetcast_mesh_get_info(mesh, &info);
    tetcast_optics_get_info(optics, &how);
    (void)tetcast_mesh_field(mesh, 0, &lo, &hi);
    printf("{\"program\":\"tetcast_render\",\"in\":");
    sup_json_string(stdout, o->in ? o->in : o->scene);
    printf(",\"field\":");
    sup_json_string(stdout, field);
    printf(",\"range\":[%.9g,%.9g],\"width\":%u,\"height\":%u,\"cells\":%llu,\"vertices\":%llu,\"bytes\":%llu",
           (double)lo, (double)hi, image->width, image->height, (unsigned long long)info.cell_count,
           (unsigned long long)info.vertex_count, (unsigned long long)info.total_bytes);
    printf(",\"connectivity_bytes\":%llu,\"bytes_per_cell\":%.3f,\"left_out\":%llu,\"inverted\":%llu,\"zero_volume\":%llu",
           (unsigned long long)info.connectivity_bytes,
           info.cell_count ? (double)(info.connectivity_bytes + info.vertex_bytes + info.hull_bytes) /
                                 (double)info.cell_count : 0.0,
           (unsigned long long)(report->bad_indices + report->bad_positions + report->bad_shapes + report->repeated +
                                report->duplicates),
           (unsigned long long)report->inverted, (unsigned long long)report->zero_volume);
    if (o->check) print_check(mesh, env, report);
    printf(",\"rays\":%llu,\"hits\":%llu,\"walks\":%llu,\"steps\":%llu,\"ended\":%llu",
           (unsigned long long)s->rays, (unsigned long long)s->hit_rays, (unsigned long long)s->walks,
           (unsigned long long)s->steps, (unsigned long long)s->ended);
    printf(",\"method\":\"%s\"", s->method == TETCAST_METHOD_PROJECT ? "project" :
                                    o->method == METHOD_STRIPS ? "strips" :
                                    o->method == METHOD_FOAM ? "foam" : "march");
    if (s->method == TETCAST_METHOD_PROJECT)
        printf(",\"projected_cells\":%llu,\"pixel_tests\":%llu,\"exact_tests\":%llu", (unsigned long long)s->cells,
               (unsigned long long)s->pixel_tests, (unsigned long long)s->exact_tests);
    printf(",\"integrator\":\"%s\",\"extinction\":%.6g,\"knots\":%u,\"t_min\":%.6g", integrators[how.integrator], extinction,
           how.knot_count, (double)how.t_min);
    printf(",\"tolerance\":%.6g,\"error_bound\":%.6g,\"bound_integral\":%.6g,\"bound_end\":%.6g,\"bound_knots\":%.6g",
           o->common.has_tolerance ? o->common.tolerance : 0.0, (double)how.bound, (double)how.bound_integral,
           (double)how.bound_end, (double)how.bound_knots);
    printf(",\"eye\":[%.9g,%.9g,%.9g],\"at\":[%.9g,%.9g,%.9g]", camera->eye[0], camera->eye[1], camera->eye[2],
           camera->at[0], camera->at[1], camera->at[2]);
    printf(",\"seconds\":%.6f,\"msteps_per_second\":%.3f,\"isa\":\"%s\",\"threads\":%d}\n", seconds,
           seconds > 0.0 ? 1e-6 * (double)s->steps / seconds : 0.0, tetcast_isa_name(s->isa),
           sup_threads(o->common.threads));
}

static int make_image(const options *o, tetcast_image *image) {
    const size_t pixels = (size_t)o->common.size[0] * o->common.size[1];
    const int linear = sup_out_is_linear(&o->common);
    memset(image, 0, sizeof *image);
    image->width = o->common.size[0];
    image->height = o->common.size[1];
    image->rgba8 = (uint8_t *)sup_alloc(pixels, 4);
    if (linear) image->rgba = (float *)sup_alloc(pixels, 16);
    if (o->common.depth) image->depth = (float *)sup_alloc(pixels, 4);
    return !image->rgba8 || (linear && !image->rgba) || (o->common.depth && !image->depth);
}

/* Cells whose value of a field is not 0 are hidden. */
static int mask_cells(sup_volume *v, const char *name, const char *in, sup_error *err) {
    for (size_t i = 0; i < v->field_count; i++) {
        const sup_field *f = v->fields + i;
        if (strcmp(f->name, name) != 0 || !f->per_cell || f->components != 1 || v->dims[0]) continue;
        v->masks = (uint8_t *)sup_alloc(f->count, 1);
        if (!v->masks) return sup_fail(err, "out of memory");
        for (size_t k = 0; k < f->count; k++) v->masks[k] = f->values[k] != 0.0f;
        return 0;
    }
    return sup_fail(err, "%s: no listed cells with one value each of a field \"%s\"", in, name);
}

static int load(const options *o, const tetcast_env *env, char *field_name, size_t room, tetcast_report *report,
                tetcast_mesh **mesh, sup_error *err) {
    const char *in = o->in ? o->in : o->scene;
    sup_volume volume;
    tetcast_mesh_desc desc;
    tetcast_field field;
    float *made = NULL;
    tetcast_result result = TETCAST_OK;
    int failed = o->in ? sup_volume_read(o->in, &volume, err)
                       : sup_volume_make(o->scene, (uint32_t)o->detail, &volume, err);
    if (failed) return 1;
    if (err->text[0] && !o->common.quiet) fprintf(stderr, "warning: %s\n", err->text);
    memset(&desc, 0, sizeof desc);
    desc.env = *env;
    desc.cells = (tetcast_cells)o->cells;
    desc.order = (tetcast_order)o->order;
    desc.weld = (uint32_t)o->weld;
    desc.strict = (uint32_t)o->strict;
    volume.five = o->five;
    failed = sup_choose_field(&volume, o->field, in, &field, &made, field_name, room, err);
    if (!failed && o->mask) failed = mask_cells(&volume, o->mask, in, err);
    if (!failed) result = sup_volume_mesh(&volume, &field, &desc, report, mesh);
    if (result != TETCAST_OK) failed = sup_fail_result(err, in, result, env->error);
    SUP_FREE(made);
    sup_volume_free(&volume);
    return failed;
}

/* With a shader or clipping. */
static tetcast_result draw_shaded(const options *o, const tetcast_render_desc *desc, const tetcast_mesh *mesh,
                                  const tetcast_transfer *transfer, const tetcast_optics *optics, const tetcast_image *image,
                                  tetcast_render_stats *stats) {
    tetcast_mesh_info info;
    tetcast_shade_desc d;
    tetcast_clip *clip = NULL;
    tetcast_result result = TETCAST_OK;
    sup_lit lit;
    sup_shadow shadow;
    float lo = 0.0f, hi = 1.0f;
    tetcast_mesh_get_info(mesh, &info);
    (void)tetcast_mesh_field(mesh, 0, &lo, &hi);
    memset(&d, 0, sizeof d);
    d.env = desc->env;
    d.camera = desc->camera;
    d.clip_near = desc->clip_near;
    d.clip_far = desc->clip_far;
    memcpy(d.background, desc->background, sizeof d.background);
    sup_lit_open(&lit, transfer, 4.0 * ((double)hi - (double)lo) / sup_box_diagonal(info.box_min, info.box_max));
    memset(&shadow, 0, sizeof shadow);
    if (o->shader == SUP_SHADER_LIT) d.shader = &lit.shader;
    if (o->shader == SUP_SHADER_SHADOW) {
        result = sup_shadow_open(&shadow, mesh, transfer, optics, o->light, 0.25f);
        d.shader = &shadow.shader;
    }
    if (result == TETCAST_OK && o->has_cut) result = sup_cut(&desc->env, o->cut, info.box_min, info.box_max, &clip);
    d.clip = clip;
    if (result == TETCAST_OK) result = tetcast_render_shaded(&d, mesh, optics, image, stats);
    tetcast_clip_destroy(clip);
    sup_shadow_close(&shadow);
    return result;
}

/* Cells of the vertices, each with one colour. start: when drawing begins. */
static tetcast_result draw_foam(const tetcast_render_desc *desc, const tetcast_mesh *mesh, const tetcast_transfer *transfer,
                                const tetcast_image *image, tetcast_render_stats *stats, double *start) {
    tetcast_mesh_info info;
    tetcast_foam_desc d;
    tetcast_foam *foam = NULL;
    tetcast_site *sites;
    tetcast_result result;
    tetcast_mesh_get_info(mesh, &info);
    sites = (tetcast_site *)sup_alloc((size_t)info.vertex_count, sizeof *sites);
    if (!sites) return TETCAST_ERR_NO_MEMORY;
    for (uint64_t i = 0; i < info.vertex_count; i++) {
        float value = 0.0f, rgba[4];
        tetcast_mesh_vertex(mesh, (uint32_t)i, sites[i].position, &value, NULL);
        tetcast_transfer_eval(transfer, value, rgba);
        memcpy(sites[i].rgb, rgba, sizeof sites[i].rgb);
        sites[i].extinction = rgba[3];
    }
    memset(&d, 0, sizeof d);
    d.env = desc->env;
    result = tetcast_foam_create(&d, sites, (size_t)info.vertex_count, &foam);
    SUP_FREE(sites);
    *start = sup_now();
    if (result == TETCAST_OK) result = tetcast_foam_render(desc, foam, image, stats);
    tetcast_foam_destroy(foam);
    return result;
}

int main(int argc, char **argv) {
    options o;
    tetcast_render_desc desc;
    tetcast_render_stats stats;
    tetcast_report report;
    tetcast_error error = {TETCAST_OK, 0, ""};
    tetcast_mesh *mesh = NULL;
    tetcast_optics *optics = NULL;
    tetcast_transfer *transfer = NULL;
    tetcast_image image;
    tetcast_result result = TETCAST_OK;
    sup_progress progress;
    sup_error err;
    char field[80] = "";
    double start, seconds = 0.0, extinction = 1.0;
    int status = parse(argc, argv, &o, &desc);
    if (status >= 0) return status;
    memset(&stats, 0, sizeof stats);
    memset(&report, 0, sizeof report);
    desc.env.error = &error;
    sup_progress_begin(&progress, "drawing", o.common.quiet);
    status = load(&o, &desc.env, field, sizeof field, &report, &mesh, &err);
    if (!status) {
        set_camera(&o, mesh, &desc.camera);
        status = make_optics(&o, o.in ? o.in : o.scene, mesh, &desc, &optics, &transfer, &extinction, &err);
    }
    if (!status && make_image(&o, &image)) status = sup_fail(&err, "out of memory for the picture");
    if (!status) {
        if (o.smooth) result = tetcast_mesh_make_gradients(mesh, &desc.env);
        if (!progress.quiet) {
            desc.env.progress_fn = sup_progress_fn;
            desc.env.progress_user = &progress;
        }
        start = sup_now();
        if (result == TETCAST_OK && o.method == METHOD_FOAM) result = draw_foam(&desc, mesh, transfer, &image, &stats, &start);
        else if (result == TETCAST_OK && !o.shader && !o.has_cut) result = tetcast_render(&desc, mesh, optics, &image, &stats);
        else if (result == TETCAST_OK) result = draw_shaded(&o, &desc, mesh, transfer, optics, &image, &stats);
        seconds = sup_now() - start;
        sup_progress_end(&progress);
        if (result != TETCAST_OK)
            status = sup_fail_result(&err, o.in ? o.in : o.scene, result, &error);
        else if (o.surface && write_surface(&o, &desc.env, mesh, &err)) status = 1;
        else status = sup_write_image(&o.common, &image, &err);
        if (!status && o.common.stats)
            print_stats(&o, &desc.env, field, mesh, &report, optics, &image, &desc.camera, &stats, seconds, extinction);
        SUP_FREE(image.rgba8);
        SUP_FREE(image.rgba);
        SUP_FREE(image.depth);
    }
    if (!status && o.common.has_tolerance && !o.common.quiet) {
        tetcast_optics_info how;
        tetcast_optics_get_info(optics, &how);
        if ((double)how.bound > o.common.tolerance * 1.0001)
            fprintf(stderr, "warning: rounding alone can make errors of %.3g, which is more than --tolerance\n", (double)how.bound);
    }
    if (status) (void)sup_bad_input(argv[0], err.text);
    tetcast_optics_destroy(optics);
    tetcast_transfer_destroy(transfer);
    tetcast_mesh_destroy(mesh);
    return status;
}
