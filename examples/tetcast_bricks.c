/* tetcast_bricks.c - tetrahedra or a grid -> bricks with level of detail -> picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/cli.h"
#include "support/volume_scenes.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "support/volume_look.h"
#include "support/amr_scenes.h"
#include "support/amr_file.h"
#include "support/tile_file.h"

typedef struct options {
    sup_common common;
    const char *in, *out, *scene, *field, *tf, *reference, *data_type, *coded, *section, *functions, *paint;
    double max_error, opacity, iso, scale, step, radius, share, samples, lod_error, seconds;
    int64_t detail, longest, longest_end, cells, level, jump, overlap;
    int between;
    int storage, model, has_iso, has_focus, has_cut, has_dims, has_background, shader, weld, tile, codec, has_through, average, view;
    float focus[3], cut[3], dims[3], spacing[3], background[3], normal[3], through[3];
} options;

static const tetcast_type storages[4] = {TETCAST_TYPE_F16, TETCAST_TYPE_F32, TETCAST_TYPE_U16, TETCAST_TYPE_U8};
static const char *const storage_names[4] = {"f16", "f32", "u16", "u8"};

/* ---- input -------------------------------------------------------------------------------------------------- */

/* Bytes without a header: --dims says what they are. */
static int read_raw(const options *o, sup_volume *v, sup_error *err) {
    char *data;
    size_t size, count;
    float *values;
    if (sup_read_file(o->in, &data, &size, err)) return 1;
    memset(v, 0, sizeof *v);
    for (int k = 0; k < 3; k++) {
        v->dims[k] = (uint32_t)o->dims[k];
        v->spacing[k] = o->spacing[k] > 0.0f ? (double)o->spacing[k] : 1.0;
    }
    count = (size_t)v->dims[0] * v->dims[1] * v->dims[2];
    if (size != count && size != 2 * count) {
        SUP_FREE(data);
        return sup_fail(err, "%s: %lu bytes are not --dims %ux%ux%u with one or two bytes each", o->in, (unsigned long)size,
                        v->dims[0], v->dims[1], v->dims[2]);
    }
    values = sup_volume_add_field(v, "data", 4, 1, 0, count);
    for (size_t i = 0; values && i < count; i++) {
        const uint8_t *p = (const uint8_t *)data + i * (size / count);
        values[i] = size == count ? (float)p[0] : (float)(p[0] | p[1] << 8);
    }
    SUP_FREE(data);
    return values ? 0 : sup_fail(err, "out of memory");
}

static int load_volume(const options *o, const char *path, sup_volume *v, sup_error *err) {
    if (path && sup_parse_choice(path, SUP_VOLUME_SCENES) >= 0 && !sup_is_plain_file(path))
        return sup_volume_make(path, (uint32_t)o->detail, v, err);
    if (!path) return sup_volume_make(o->scene, (uint32_t)o->detail, v, err);
    if (o->has_dims && !sup_name_ends(path, ".vtk")) return read_raw(o, v, err);
    return sup_volume_read(path, v, err);
}

static tetcast_result make_mesh(const options *o, const sup_volume *v, const tetcast_field *field,
                                const tetcast_env *env, tetcast_mesh **out) {
    tetcast_mesh_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.env = *env;
    desc.weld = (uint32_t)o->weld;
    return sup_volume_mesh(v, field, &desc, NULL, out);
}

static int load_mesh(const options *o, const char *path, const tetcast_env *env, tetcast_mesh **mesh, sup_error *err) {
    sup_volume volume;
    tetcast_field field;
    float *made = NULL;
    char label[80] = "";
    tetcast_result r;
    int failed = load_volume(o, path, &volume, err);
    if (failed) return 1;
    failed = sup_choose_field(&volume, o->field, path ? path : o->scene, &field, &made, label, sizeof label, err);
    if (!failed) {
        r = make_mesh(o, &volume, &field, env, mesh);
        if (r != TETCAST_OK) failed = sup_fail_result(err, path ? path : o->scene, r, env->error);
    }
    SUP_FREE(made);
    sup_volume_free(&volume);
    return failed;
}

/* Bricks from the cells of a locally refined grid: a plotfile, or the generated blast. */
static int make_amr_bricks(const options *o, tetcast_bricks_desc *d, tetcast_bricks_report *report, tetcast_bricks **out,
                           sup_error *err) {
    tetcast_amr_desc desc;
    tetcast_amr *amr = NULL;
    tetcast_patch *patches = NULL;
    sup_amr file;
    float *values = NULL, lo = INFINITY, hi = -INFINITY;
    tetcast_result r;
    size_t count = 0;
    uint32_t levels = o->detail > 0 ? (uint32_t)o->detail : 4;
    memset(&file, 0, sizeof file);
    memset(&desc, 0, sizeof desc);
    if (o->in) {
        if (sup_amr_read(o->in, o->field, &file, err)) return 1;
        sup_amr_desc(&file, &desc);
    } else {
        if (levels > 6) levels = 6;
        if (sup_blast_patches(levels, 16, &patches, &count, &values)) return sup_fail(err, "out of memory");
        desc.patches = patches;
        desc.patch_count = count;
        for (int k = 0; k < 3; k++) {
            desc.cells[k] = 16;
            desc.spacing[k] = 1.0 / 16.0;
        }
    }
    for (size_t i = 0; i < desc.patch_count; i++) {
        const tetcast_patch *p = &desc.patches[i];
        for (size_t k = 0; k < (size_t)p->dims[0] * p->dims[1] * p->dims[2]; k++) {
            lo = p->values[k] < lo ? p->values[k] : lo;
            hi = p->values[k] > hi ? p->values[k] : hi;
        }
    }
    desc.env = d->env;
    r = tetcast_amr_create(&desc, &amr);
    d->max_error = hi > lo ? (float)(o->max_error * ((double)hi - (double)lo)) : 0.0f;
    if (r == TETCAST_OK) r = tetcast_bricks_create_amr(d, amr, (tetcast_amr_method)o->between, report, out);
    tetcast_amr_destroy(amr);
    SUP_FREE(patches);
    SUP_FREE(values);
    sup_amr_free(&file);
    return r == TETCAST_OK ? 0 : sup_fail_result(err, o->in ? o->in : o->scene, r, d->env.error);
}

/* Bricks from whatever the input is: a uniform grid as it is, other things through tetrahedra. */
static int make_bricks(const options *o, const tetcast_env *env, tetcast_bricks_report *report, tetcast_bricks **out,
                       sup_error *err) {
    sup_volume v;
    tetcast_field field;
    tetcast_bricks_desc d;
    tetcast_mesh *mesh = NULL;
    tetcast_result r = TETCAST_OK;
    float *made = NULL;
    char label[80] = "";
    int failed;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.storage = storages[o->storage];
    d.log_cells = o->cells == 8 ? 3 : o->cells == 32 ? 5 : 4;
    d.longest = (uint32_t)o->longest;
    d.longest_end = (uint32_t)o->longest_end;
    d.average = (uint32_t)o->average;
    if (o->has_focus) {
        d.focus_radius = o->radius;
        for (int k = 0; k < 3; k++) d.focus[k] = (double)o->focus[k];
    }
    if (o->in ? sup_amr_is(o->in) : strcmp(o->scene, "blast") == 0) return make_amr_bricks(o, &d, report, out, err);
    if (load_volume(o, o->in, &v, err)) return 1;
    failed = sup_choose_field(&v, o->field, o->in ? o->in : o->scene, &field, &made, label, sizeof label, err);
    if (!failed && v.dims[0] && !v.points && !v.axes[0] && !v.blanks && !field.per_cell && !d.average && !(d.focus_radius > 0.0)) {
        tetcast_lattice l;
        float lo = INFINITY, hi = -INFINITY;
        memset(&l, 0, sizeof l);
        memcpy(l.dims, v.dims, sizeof l.dims);
        for (int k = 0; k < 3; k++) {
            l.origin[k] = v.origin[k];
            l.spacing[k] = v.spacing[k] > 0.0 ? v.spacing[k] : 1.0;
        }
        for (size_t i = 0; i < (size_t)l.dims[0] * l.dims[1] * l.dims[2]; i++) {
            const float x = ((const float *)field.values.data)[i * (field.values.stride ? field.values.stride / sizeof(float) : 1)];
            lo = x < lo ? x : lo;
            hi = x > hi ? x : hi;
        }
        d.max_error = hi > lo ? (float)(o->max_error * ((double)hi - (double)lo)) : 0.0f;
        r = tetcast_bricks_create_grid(&d, &l, &field.values, report, out);
    } else if (!failed) {
        r = make_mesh(o, &v, &field, env, &mesh);
        if (r == TETCAST_OK) {
            float lo = 0.0f, hi = 0.0f;
            (void)tetcast_mesh_field(mesh, 0, &lo, &hi);
            d.max_error = hi > lo ? (float)(o->max_error * ((double)hi - (double)lo)) : 1e-6f;
            if (!(d.max_error > 0.0f) && d.longest == 0) d.longest = 257;
            r = tetcast_bricks_create_mesh(&d, mesh, report, out);
        }
    }
    if (r != TETCAST_OK) failed = sup_fail_result(err, o->in ? o->in : o->scene, r, env->error);
    tetcast_mesh_destroy(mesh);
    SUP_FREE(made);
    sup_volume_free(&v);
    return failed;
}

static int read_bricks(const char *path, const tetcast_env *env, tetcast_bricks **out, sup_error *err) {
    tetcast_result r;
    char *data;
    size_t size;
    if (sup_read_file(path, &data, &size, err)) return 1;
    r = tetcast_bricks_read(env, data, size, out);
    SUP_FREE(data);
    return r == TETCAST_OK ? 0 : sup_fail_result(err, path, r, env->error);
}

/* ---- optics ------------------------------------------------------------------------------------------------- */

typedef struct look {
    tetcast_transfer *transfer;
    tetcast_optics *optics;
    double extinction;
} look;

typedef struct small_picture {
    tetcast_brick_render_desc desc;
    const tetcast_cut *cut;
} small_picture;

static tetcast_result draw_small(void *ctx, const tetcast_optics *optics, const tetcast_image *image) {
    const small_picture *p = (const small_picture *)ctx;
    return tetcast_render_bricks(&p->desc, p->cut, optics, image, NULL);
}

static double choose_extinction(const tetcast_brick_render_desc *desc, const tetcast_cut *cut, const tetcast_transfer *t) {
    small_picture p;
    p.desc = *desc;
    p.desc.shader = NULL;
    p.cut = cut;
    memset(p.desc.background, 0, sizeof p.desc.background);
    return sup_extinction_scale(t, 64, 48, 2.3, draw_small, &p);
}

static void brick_box(const tetcast_bricks_info *info, double lo[3], double hi[3]) {
    for (int k = 0; k < 3; k++) {
        lo[k] = info->lattice.origin[k];
        hi[k] = lo[k] + (double)(info->lattice.dims[k] - 1) * info->lattice.spacing[k];
    }
}

static int make_look(const options *o, const tetcast_brick_render_desc *render, const tetcast_bricks_info *info,
                     const tetcast_cut *cut, look *out, sup_error *err) {
    const int named = !sup_transfer_is_file(o->tf);
    tetcast_control_point *points;
    tetcast_transfer_desc desc;
    tetcast_optics_desc optics;
    tetcast_isovalue iso;
    tetcast_result r;
    sup_transfer tf;
    double diagonal, lo[3], hi[3];
    brick_box(info, lo, hi);
    diagonal = sup_box_diagonal(lo, hi);
    memset(out, 0, sizeof *out);
    if (!named) {
        if (sup_transfer_read(o->tf, &tf, err)) return 1;
    } else if (sup_transfer_named(o->tf ? o->tf : "rainbow", (double)info->value_min, (double)info->value_max, diagonal, &tf,
                                  err)) return 1;
    if (sup_control_points(&tf, &points, err)) {
        sup_transfer_free(&tf);
        return 1;
    }
    memset(&desc, 0, sizeof desc);
    memset(&optics, 0, sizeof optics);
    memset(&iso, 0, sizeof iso);
    iso.value = (float)o->iso;
    iso.rgb[0] = 0.85f;
    iso.rgb[1] = 0.6f;
    iso.rgb[2] = 0.4f;
    iso.opacity = (float)o->opacity;
    iso.specular = 0.25f;
    desc.env = render->env;
    sup_transfer_points(&tf, points, &desc);
    desc.isovalues = &iso;
    desc.isovalue_count = (size_t)o->has_iso;
    optics.env = render->env;
    optics.model = (tetcast_model)o->model;
    if (o->has_iso && o->model == 0) optics.model = o->tf ? TETCAST_MODEL_MIXED : TETCAST_MODEL_ISOSURFACE;
    optics.tolerance = o->common.has_tolerance ? (float)o->common.tolerance : 0.0f;
    optics.path_length = (float)diagonal;
    optics.ambient[0] = optics.ambient[1] = optics.ambient[2] = 0.1f;
    out->extinction = o->scale;
    r = tetcast_transfer_create(&desc, &out->transfer);
    if (r == TETCAST_OK && named && optics.model != TETCAST_MODEL_ISOSURFACE && optics.model != TETCAST_MODEL_MAXIMUM) {
        out->extinction *= choose_extinction(render, cut, out->transfer);
        tetcast_transfer_destroy(out->transfer);
        desc.extinction_scale = (float)out->extinction;
        r = tetcast_transfer_create(&desc, &out->transfer);
    }
    if (r == TETCAST_OK) r = tetcast_optics_create(out->transfer, &optics, &out->optics);
    SUP_FREE(points);
    sup_transfer_free(&tf);
    return r == TETCAST_OK ? 0 : sup_fail_result(err, "optics", r, render->env.error);
}

/* ---- resample ----------------------------------------------------------------------------------------------- */

static void set_defaults(options *o) {
    memset(o, 0, sizeof *o);
    o->scale = 1.0;
    o->opacity = 1.0;
    o->max_error = 0.01;
    o->cells = 16;
    o->longest_end = 4097;
}

static size_t input_options(options *o, sup_option *table) {
    size_t n = 0;
    table[n++] = sup_opt_text("scene", &o->scene, SUP_VOLUME_SCENES "|blast", "a generated volume instead of IN");
    table[n++] = sup_opt_int("detail", &o->detail, 0, 512, "N", "how fine --scene is");
    table[n++] = sup_opt_text("field", &o->field, "NAME", "the scalar (the first one); of a vector its length");
    table[n++] = sup_opt_given(sup_opt_vec3("dims", o->dims, "x,y,z: IN is so many numbers of 1 or 2 bytes"), &o->has_dims);
    table[n++] = sup_opt_vec3("spacing", o->spacing, "x,y,z between them (1)");
    table[n++] = sup_opt_choice("storage", &o->storage, "f16|f32|u16|u8", "how values are stored (f16)");
    table[n++] = sup_opt_choice("between", &o->between, "octant|basis|current|nearest|gti",
                                "AMReX plotfiles, --scene blast: grids refined locally: what lies between the centres of cells (octant)");
    table[n++] = sup_opt_int("brick", &o->cells, 8, 32, "N", "cells along a brick: 8, 16, 32 (16)");
    return n;
}

static void print_bricks(const char *command, const options *o, const tetcast_bricks *bricks) {
    tetcast_bricks_info info;
    tetcast_bricks_get_info(bricks, &info);
    printf("{\"program\":\"tetcast_bricks\",\"command\":\"%s\",\"in\":", command);
    sup_json_string(stdout, o->in ? o->in : o->scene);
    printf(",\"dims\":[%u,%u,%u],\"levels\":%u,\"bricks\":%llu,\"nodes\":%llu,\"bytes\":%llu,\"file_bytes\":%llu,"
           "\"range\":[%.9g,%.9g]", info.lattice.dims[0], info.lattice.dims[1], info.lattice.dims[2], info.levels,
           (unsigned long long)info.bricks, (unsigned long long)info.nodes, (unsigned long long)info.bytes,
           (unsigned long long)tetcast_bricks_file_size(bricks), (double)info.value_min, (double)info.value_max);
    printf(",\"level_bricks\":[");
    for (uint32_t k = 0; k < info.levels; k++) printf("%s%llu", k ? "," : "", (unsigned long long)info.level_bricks[k]);
    printf("]");
}

static int resample(int argc, char **argv) {
    sup_option table[28];
    tetcast_env env;
    tetcast_error error = {TETCAST_OK, 0, ""};
    tetcast_bricks_report report;
    tetcast_bricks_info info;
    tetcast_bricks *bricks = NULL;
    const char *first = NULL, *second = NULL;
    sup_error err;
    options o;
    int64_t threads = 0;
    int stats = 0, quiet = 0, status;
    double start, seconds;
    size_t n;
    set_defaults(&o);
    sup_error_clear(&err);
    n = input_options(&o, table);
    table[n++] = sup_opt_positional("IN", &first, 1, "volume mesh, grid or AMReX plotfile (its folder); with --scene left out");
    table[n++] = sup_opt_positional("OUT.brk", &second, 0, "brick file");
    table[n++] = sup_opt_real("max-error", &o.max_error, 0.0, 1.0, "E", "largest error, as a share of the data range (0.01)");
    table[n++] = sup_opt_int("longest", &o.longest, 2, 16385, "N", "nodes along the longest side (what the error needs)");
    table[n++] = sup_opt_int("longest-end", &o.longest_end, 2, 16385, "N", "no more than that (4097)");
    table[n++] = sup_opt_flag("average", &o.average, "with --longest: means over boxes around nodes instead of values at nodes");
    table[n++] = sup_opt_given(sup_opt_vec3("focus", o.focus, "on demand: fine bricks are made around this point only"), &o.has_focus);
    table[n++] = sup_opt_real("radius", &o.radius, 1e-30, 1e30, "R", "of the finest level around --focus; one coarser for each more");
    table[n++] = sup_opt_flag("weld", &o.weld, "points at the same place become one");
    table[n++] = sup_opt_int("threads", &threads, 0, 64, "N", "0: one per core");
    table[n++] = sup_opt_flag("stats", &stats, "one JSON object on stdout");
    table[n++] = sup_opt_flag("quiet", &quiet, "no warnings");
    status = sup_cli_parse(argc, argv, "Makes bricks with level of detail from tetrahedra, other cells or a grid.", table, n);
    if (status >= 0) return status;
    o.in = o.scene ? NULL : first;
    o.out = o.scene ? first : second;
    if (!o.out || (o.scene && second)) return sup_bad_usage(argv[0], "IN (or --scene) and OUT.brk have to be given");
    if (o.cells != 8 && o.cells != 16 && o.cells != 32) return sup_bad_usage(argv[0], "--brick: 8, 16 or 32");
    if (o.average && !o.longest) return sup_bad_usage(argv[0], "--average needs --longest");
    if (o.has_focus != (o.radius > 0.0) || (o.has_focus && o.average))
        return sup_bad_usage(argv[0], "--focus and --radius go together, and without --average");
    memset(&env, 0, sizeof env);
    memset(&report, 0, sizeof report);
    env.thread_count = (uint32_t)threads;
    env.error = &error;
    start = sup_now();
    status = make_bricks(&o, &env, &report, &bricks, &err);
    seconds = sup_now() - start;
    if (!status) {
        const size_t size = tetcast_bricks_file_size(bricks);
        void *data = sup_alloc(size, 1);
        status = !data ? sup_fail(&err, "out of memory") :
                 tetcast_bricks_write(bricks, data, size) != TETCAST_OK ? sup_fail(&err, "%s: too large", o.out) :
                 sup_write_file(o.out, data, size, &err);
        SUP_FREE(data);
    }
    if (!status) {
        double range;
        tetcast_bricks_get_info(bricks, &info);
        range = (double)info.value_max - (double)info.value_min;
        range = range > 0.0 ? range : 1.0;
        if (report.above && !quiet && !o.average)
            fprintf(stderr, "warning: %s: --max-error %g is NOT kept: %llu of %llu points are farther off, the worst, %g, at %g,%g,%g; "
                    "%llu of them where bricks are of the finest level, nodes %g apart: --longest-end allows more nodes\n",
                    o.out, o.max_error, (unsigned long long)report.above, (unsigned long long)report.checks, report.error / range,
                    report.worst[0], report.worst[1], report.worst[2], (unsigned long long)report.above_finest,
                    info.lattice.spacing[0]);
        if (stats) {
            print_bricks("resample", &o, bricks);
            printf(",\"max_error\":%.6g,\"error\":%.6g,\"mean_error\":%.6g,\"checks\":%llu,\"above\":%llu,\"above_finest\":%llu,\"tries\":%u,"
                   "\"hull_triangles\":%llu,\"seconds\":%.6f}\n", o.max_error, report.error / range, report.mean_error / range,
                   (unsigned long long)report.checks, (unsigned long long)report.above, (unsigned long long)report.above_finest, report.tries,
                   (unsigned long long)info.hull_triangles, seconds);
        }
    }
    if (status) (void)sup_bad_input(argv[0], err.text);
    tetcast_bricks_destroy(bricks);
    return status;
}

/* ---- render ------------------------------------------------------------------------------------------------- */

static int parse_render(int argc, char **argv, options *o, tetcast_brick_render_desc *desc) {
    sup_option table[SUP_COMMON_OPTIONS + 36];
    size_t n;
    int status;
    set_defaults(o);
    o->max_error = 0.0;
    n = sup_common_options(&o->common, table);
    sup_option_help(table, n, "size", "pixels of the picture (1024x768)");
    sup_option_help(table, n, "seed", "changes nothing: no ray is random");
    sup_option_help(table, n, "tolerance", "largest error of a colour in units of 1/255 (exact)");
    sup_option_help(table, n, "unlit", "changes nothing: volumes have no lights, but --shader lit");
    o->common.size[0] = 1024;
    o->common.size[1] = 768;
    table[n++] = sup_opt_positional("IN", &o->in, 0, ".brk, a grid (VTK, or bytes with --dims), a mesh, or a plotfile");
    n += input_options(o, table + n);
    table[n++] = sup_opt_text("tf", &o->tf, "FILE|" SUP_TRANSFER_NAMES, "transfer function (rainbow)");
    table[n++] = sup_opt_real("extinction", &o->scale, 1e-9, 1e9, "F", "multiplies all extinctions");
    table[n++] = sup_opt_choice("model", &o->model, "volume|emission|absorption|maximum",
                                "what light does in it (volume; with --iso: iso, with --iso and --tf: mixed)");
    table[n++] = sup_opt_given(sup_opt_real("iso", &o->iso, -1e38, 1e38, "V", "show the surface of this value"), &o->has_iso);
    table[n++] = sup_opt_real("iso-opacity", &o->opacity, 0.0, 1.0, "A", "of it (1)");
    table[n++] = sup_opt_choice("shader", &o->shader, SUP_SHADERS, "lit: a shader of this program, lit by gradients");
    table[n++] = sup_opt_text("paint", &o->paint, "FILE.brk", "colours from these bricks of another field, opacity from IN");
    table[n++] = sup_opt_real("step", &o->step, 0.01, 100.0, "S", "distance of samples in cells (1)");
    table[n++] = sup_opt_int("level", &o->level, 0, 5, "N", "no finer than this level");
    table[n++] = sup_opt_given(sup_opt_vec3("focus", o->focus, "finest around this point"), &o->has_focus);
    table[n++] = sup_opt_real("radius", &o->radius, 1e-30, 1e30, "R", "of the finest level; one coarser for each more");
    table[n++] = sup_opt_real("budget", &o->share, 0.0, 1.0, "F", "no more than this share of the finest level's bytes");
    table[n++] = sup_opt_real("samples", &o->samples, 0.0, 1.0, "F", "no more than this share of its samples");
    table[n++] = sup_opt_real("lod-error", &o->lod_error, 0.0, 1.0, "E", "coarse where that is right to this share of the range");
    table[n++] = sup_opt_int("jump", &o->jump, 0, 5, "N", "largest difference of neighbours' levels (any)");
    table[n++] = sup_opt_given(sup_opt_vec3("cut", o->cut, "keep what lies this way from the middle"), &o->has_cut);
    table[n++] = sup_opt_text("reference", &o->reference, "MESH", "a mesh or scene: show it beside the picture, and measure the difference (1/255)");
    table[n++] = sup_opt_text("functions", &o->functions, "FILE.rbf", "and these beside both, inside of the mesh");
    table[n++] = sup_opt_real("seconds", &o->seconds, 1e-6, 1e6, "T", "levels such that a picture takes no longer than that: draws some");
    table[n++] = sup_opt_text("coded", &o->coded, "FILE.tile", "also write the picture as --codec codes it");
    table[n++] = sup_opt_choice("codec", &o->codec, SUP_TILE_CODECS, "colour cells (6 bytes for 16 pixels), with alpha (8), without loss, better cells");
    table[n++] = sup_opt_flag("tiles", &o->tile, "draw in four parts, as several machines would");
    table[n++] = sup_opt_int("overlap", &o->overlap, 0, 4096, "N", "--tiles share N rows and columns, fade there, and add up");
    table[n++] = sup_opt_given(sup_opt_vec3("background", o->background, "linear r,g,b instead of transparent"),
                               &o->has_background);
    status = sup_cli_parse(argc, argv, "Draws bricks.", table, n);
    if (status >= 0) return status;
    if (!o->in == !o->scene) return sup_bad_usage(argv[0], "IN or --scene has to be given");
    status = sup_out_check(argv[0], &o->common);
    if (status >= 0) return status;
    if (o->paint && (o->shader || o->model || o->has_iso || o->reference))
        return sup_bad_usage(argv[0], "--paint goes without --shader, --model, --iso and --reference");
    if (o->reference && sup_out_is_linear(&o->common)) return sup_bad_usage(argv[0], "--reference: pictures side by side are .png");
    if (o->overlap && (!o->tile || o->common.depth || 2 * o->overlap > (int64_t)o->common.size[0] ||
                       2 * o->overlap > (int64_t)o->common.size[1]))
        return sup_bad_usage(argv[0], "--overlap: at most half of the picture, with --tiles, without --depth");
    if (o->functions && !o->reference) return sup_bad_usage(argv[0], "--functions needs --reference");
    if (o->has_focus && !(o->radius > 0.0)) return sup_bad_usage(argv[0], "--focus needs --radius");
    if (o->has_dims && !(o->dims[0] >= 1.0f && o->dims[1] >= 1.0f && o->dims[2] >= 1.0f))
        return sup_bad_usage(argv[0], "--dims: at least 1");
    memset(desc, 0, sizeof *desc);
    desc->env.thread_count = (uint32_t)o->common.threads;
    desc->isa = (tetcast_isa)o->common.isa;
    desc->step = (float)o->step;
    if (o->has_background) {
        memcpy(desc->background, o->background, sizeof o->background);
        desc->background[3] = 1.0f;
    }
    return -1;
}

/* samples: share of the samples of the finest level, 0: as the options say. */
static int make_cut(const options *o, const tetcast_env *env, const tetcast_bricks *bricks, double samples, tetcast_cut **cut,
                    sup_error *err) {
    tetcast_bricks_info info;
    tetcast_cut_desc d;
    tetcast_result r;
    memset(&d, 0, sizeof d);
    tetcast_bricks_get_info(bricks, &info);
    d.env = *env;
    d.level = (uint32_t)o->level;
    d.focus_radius = o->has_focus ? o->radius : 0.0;
    for (int k = 0; k < 3; k++) d.focus[k] = (double)o->focus[k];
    d.sample_budget = samples > 0.0 ? samples : o->samples;
    d.max_error = (float)(o->lod_error * ((double)info.value_max - (double)info.value_min));
    d.max_jump = (uint32_t)o->jump;
    if (o->share > 0.0) {
        const double side = (double)info.cells + 1.0, bytes = info.storage == TETCAST_TYPE_F32 ? 4.0 : info.storage == TETCAST_TYPE_U8 ? 1.0 : 2.0;
        d.byte_budget = (uint64_t)(o->share * (double)info.slots[0] * info.slots[1] * info.slots[2] * side * side * side * bytes);
    }
    r = tetcast_cut_create(&d, bricks, cut);
    return r == TETCAST_OK ? 0 : sup_fail_result(err, "levels", r, env->error);
}

/* ---- one field seen in the colours of another ---------------------------------------------------------------- */

static void rainbow(double x, uint8_t rgb[3]) {
    for (int c = 0; c < 3; c++) { /* blue, cyan, green, yellow, red */
        const double d = 1.5 - fabs(4.0 * (x < 0.0 ? 0.0 : x > 1.0 ? 1.0 : x) - (double)(3 - c));
        rgb[c] = (uint8_t)(255.0 * (d < 0.0 ? 0.0 : d > 1.0 ? 1.0 : d) + 0.5);
    }
}

/* Opacity as the transfer function says, colour from the other field. */
typedef struct painter {
    const tetcast_transfer *transfer;
    tetcast_bricks *bricks;
    tetcast_cut *cut;
    const tetcast_cut *channel;
    float lo, range;
    tetcast_shader shader;
} painter;

static void paint_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    const painter *p = (const painter *)user;
    for (int i = 0; i < 8; i++) {
        float c[4], a;
        uint8_t rgb[3];
        if (!(in->mask >> i & 1u)) continue;
        tetcast_transfer_eval(p->transfer, 0.5f * (in->front[i] + in->back[i]), c);
        a = 1.0f - expf(-c[3] * in->length[i]);
        rainbow((double)((in->channel[0][i] - p->lo) / p->range), rgb);
        for (int k = 0; k < 3; k++) rgba[k][i] = a * powf((float)rgb[k] / 255.0f, 2.2f);
        rgba[3][i] = a;
    }
}

static int paint_empty(void *user, float lo, float hi) {
    return tetcast_transfer_is_empty(((const painter *)user)->transfer, lo, hi);
}

static int paint_open(painter *p, const options *o, const tetcast_env *env, const tetcast_transfer *transfer, sup_error *err) {
    tetcast_bricks_info info;
    tetcast_cut_desc d;
    tetcast_result r;
    if (read_bricks(o->paint, env, &p->bricks, err)) return 1;
    memset(&d, 0, sizeof d);
    d.env = *env;
    r = tetcast_cut_create(&d, p->bricks, &p->cut);
    if (r != TETCAST_OK) return sup_fail_result(err, o->paint, r, env->error);
    tetcast_bricks_get_info(p->bricks, &info);
    p->lo = info.value_min;
    p->range = info.value_max > info.value_min ? info.value_max - info.value_min : 1.0f;
    p->transfer = transfer;
    p->channel = p->cut;
    p->shader.user = p;
    p->shader.shade_fn = paint_shade;
    p->shader.empty_fn = paint_empty;
    p->shader.channels = &p->channel;
    p->shader.channel_count = 1;
    return 0;
}

/* In four parts that share `overlap` rows and columns, as projectors side by side show them: their light adds up. */
static tetcast_result draw_overlapping(uint32_t n, tetcast_brick_render_desc *desc, const tetcast_cut *cut,
                                       const tetcast_optics *optics, const tetcast_image *image, tetcast_render_stats *stats) {
    tetcast_result r = TETCAST_OK;
    float *rgba = (float *)sup_alloc((size_t)image->width * image->height, 16);
    if (!rgba) return TETCAST_ERR_NO_MEMORY;
    memset(image->rgba, 0, (size_t)image->width * image->height * 16);
    for (uint32_t i = 0; i < 4 && r == TETCAST_OK; i++) {
        const uint32_t right = i & 1u, lower = i >> 1, middle[2] = {image->width / 2 - n / 2, image->height / 2 - n / 2};
        const uint32_t shared[4] = {right ? n : 0, right ? 0 : n, lower ? n : 0, lower ? 0 : n};
        tetcast_image part;
        memset(&part, 0, sizeof part);
        part.width = right ? image->width - middle[0] : middle[0] + n;
        part.height = lower ? image->height - middle[1] : middle[1] + n;
        part.rgba = rgba;
        desc->frame[0] = image->width;
        desc->frame[1] = image->height;
        desc->part[0] = right ? middle[0] : 0;
        desc->part[1] = lower ? middle[1] : 0;
        r = tetcast_render_bricks(desc, cut, optics, &part, stats);
        if (r == TETCAST_OK) r = tetcast_edge_blend(rgba, part.width, part.height, shared);
        for (uint32_t y = 0; y < part.height && r == TETCAST_OK; y++)
            for (uint32_t x = 0; x < 4 * part.width; x++)
                image->rgba[4 * ((size_t)(desc->part[1] + y) * image->width + desc->part[0]) + x] += rgba[4 * (size_t)y * part.width + x];
    }
    if (r == TETCAST_OK && image->rgba8) sup_rgba8_from_linear(image->rgba, image->rgba8, (size_t)image->width * image->height);
    SUP_FREE(rgba);
    return r;
}

/* In one call, or in four parts that are put side by side: the same bits. */
static tetcast_result draw(const options *o, tetcast_brick_render_desc *desc, const tetcast_cut *cut,
                           const tetcast_optics *optics, const tetcast_image *image, tetcast_render_stats *stats) {
    tetcast_result r = TETCAST_OK;
    if (!o->tile) return tetcast_render_bricks(desc, cut, optics, image, stats);
    if (o->overlap) return draw_overlapping((uint32_t)o->overlap, desc, cut, optics, image, stats);
    for (uint32_t i = 0; i < 4 && r == TETCAST_OK; i++) {
        tetcast_image part = *image;
        const uint32_t x = (i & 1u) * (image->width / 2), y = (i >> 1) * (image->height / 2);
        part.width = i & 1u ? image->width - x : image->width / 2;
        part.height = i >> 1 ? image->height - y : image->height / 2;
        if (image->rgba8) part.rgba8 += 4 * ((size_t)y * image->width + x);
        if (image->rgba) part.rgba += 4 * ((size_t)y * image->width + x);
        if (image->depth) part.depth += (size_t)y * image->width + x;
        part.rgba8_stride = (size_t)image->width * 4;
        part.rgba_stride = (size_t)image->width * 16;
        part.depth_stride = (size_t)image->width * 4;
        desc->frame[0] = image->width;
        desc->frame[1] = image->height;
        desc->part[0] = x;
        desc->part[1] = y;
        r = tetcast_render_bricks(desc, cut, optics, &part, stats);
    }
    return r;
}

typedef struct difference { double most, rms; } difference;

static void compare_pictures(const float *a, const float *b, size_t n, difference *out) {
    out->most = out->rms = 0.0;
    for (size_t i = 0; i < 4 * n; i++) {
        const double e = fabs((double)a[i] - (double)b[i]);
        out->most = e > out->most ? e : out->most;
        out->rms += e * e;
    }
    out->rms = sqrt(out->rms / (4.0 * (double)n));
}

/* The functions of --functions inside of the mesh, as the bricks are drawn. */
static int draw_functions(const options *o, const tetcast_brick_render_desc *desc, const tetcast_optics *optics, const tetcast_mesh *mesh,
                          const tetcast_image *image, sup_error *err) {
    tetcast_rbf_render_desc d;
    tetcast_rbf *rbf = NULL;
    tetcast_clip *clip = NULL;
    tetcast_result r;
    char *data;
    size_t size;
    if (sup_read_file(o->functions, &data, &size, err)) return 1;
    memset(&d, 0, sizeof d);
    d.env = desc->env;
    d.camera = desc->camera;
    memcpy(d.background, desc->background, sizeof d.background);
    r = tetcast_rbf_load_memory(&desc->env, data, size, &rbf);
    SUP_FREE(data);
    if (r == TETCAST_OK) r = sup_keep_inside(&desc->env, mesh, &clip);
    d.clip = clip;
    if (r == TETCAST_OK) r = tetcast_rbf_render(&d, rbf, optics, image, NULL);
    tetcast_clip_destroy(clip);
    tetcast_rbf_destroy(rbf);
    return r == TETCAST_OK ? 0 : sup_fail_result(err, o->functions, r, desc->env.error);
}

/* Pictures side by side: tetrahedra left, bricks, functions. diff: bricks and functions against tetrahedra. */
static int draw_reference(const options *o, const tetcast_brick_render_desc *desc, const tetcast_optics *optics,
                          const tetcast_image *image, uint8_t **both, difference diff[2], sup_error *err) {
    const size_t n = (size_t)image->width * image->height, panels = o->functions ? 3 : 2, row = 4 * (size_t)image->width;
    tetcast_render_desc d;
    tetcast_image other[2];
    tetcast_mesh *mesh = NULL;
    tetcast_result r;
    int failed = load_mesh(o, o->reference, &desc->env, &mesh, err);
    if (failed) return 1;
    memset(&d, 0, sizeof d);
    memset(other, 0, sizeof other);
    d.env = desc->env;
    d.camera = desc->camera;
    memcpy(d.background, desc->background, sizeof d.background);
    for (size_t k = 0; k + 1 < panels; k++) {
        other[k].width = image->width;
        other[k].height = image->height;
        other[k].rgba = (float *)sup_alloc(n, 16);
        other[k].rgba8 = (uint8_t *)sup_alloc(n, 4);
        if (!other[k].rgba || !other[k].rgba8) failed = sup_fail(err, "out of memory");
    }
    *both = (uint8_t *)sup_alloc(n, 4 * panels);
    if (!*both) failed = sup_fail(err, "out of memory");
    if (!failed) {
        r = tetcast_render(&d, mesh, optics, &other[0], NULL);
        if (r != TETCAST_OK) failed = sup_fail_result(err, o->reference, r, desc->env.error);
    }
    if (!failed && o->functions) failed = draw_functions(o, desc, optics, mesh, &other[1], err);
    if (!failed) {
        compare_pictures(image->rgba, other[0].rgba, n, &diff[0]);
        if (o->functions) compare_pictures(other[1].rgba, other[0].rgba, n, &diff[1]);
        for (size_t y = 0; y < image->height; y++) {
            uint8_t *to = *both + y * panels * row;
            memcpy(to, other[0].rgba8 + y * row, row);
            memcpy(to + row, image->rgba8 + y * row, row);
            if (o->functions) memcpy(to + 2 * row, other[1].rgba8 + y * row, row);
        }
    }
    for (int k = 0; k < 2; k++) {
        SUP_FREE(other[k].rgba);
        SUP_FREE(other[k].rgba8);
    }
    tetcast_mesh_destroy(mesh);
    return failed;
}

static int write_pictures(const options *o, tetcast_image *image, const uint8_t *both, sup_error *err) {
    const tetcast_image *m = image;
    if (!both || !o->common.out) return sup_write_image(&o->common, image, err);
    if (o->common.depth && sup_pfm_write(o->common.depth, m->depth, m->width, m->height, 1, err)) return 1;
    return sup_png_write8(o->common.out, both, (o->functions ? 3 : 2) * m->width, m->height, 4, err);
}

static void print_stats(const options *o, const tetcast_bricks *bricks, const tetcast_cut *cut, const look *l,
                        const tetcast_render_stats *s, const tetcast_camera *camera, const difference *diff,
                        const uint8_t *both, double build, double seconds) {
    tetcast_cut_info info;
    tetcast_cut_get_info(cut, &info);
    print_bricks("render", o, bricks);
    printf(",\"storage\":\"%s\",\"shown_bricks\":%llu,\"adapted\":%llu,\"shown_bytes\":%llu,\"full_bytes\":%llu,\"sample_share\":%.6g,"
           "\"shown_error\":%.6g", storage_names[o->storage], (unsigned long long)info.bricks, (unsigned long long)info.adapted,
           (unsigned long long)info.bytes, (unsigned long long)info.full_bytes, info.samples, (double)info.error);
    printf(",\"width\":%u,\"height\":%u,\"rays\":%llu,\"hits\":%llu,\"samples\":%llu,\"slots\":%llu,\"ended\":%llu,"
           "\"extinction\":%.6g", o->common.size[0], o->common.size[1], (unsigned long long)s->rays,
           (unsigned long long)s->hit_rays, (unsigned long long)s->steps, (unsigned long long)s->walks,
           (unsigned long long)s->ended, l->extinction);
    if (both) printf(",\"difference\":%.6g,\"difference_rms\":%.6g", 255.0 * diff->most, 255.0 * diff->rms);
    if (both && o->functions) printf(",\"functions_difference\":%.6g,\"functions_difference_rms\":%.6g", 255.0 * diff[1].most, 255.0 * diff[1].rms);
    printf(",\"eye\":[%.9g,%.9g,%.9g],\"at\":[%.9g,%.9g,%.9g]", camera->eye[0], camera->eye[1], camera->eye[2],
           camera->at[0], camera->at[1], camera->at[2]);
    printf(",\"level_seconds\":%.6f,\"seconds\":%.6f,\"isa\":\"%s\",\"threads\":%d}\n", build, seconds,
           tetcast_isa_name(s->isa), sup_threads(o->common.threads));
}

static int render(int argc, char **argv) {
    tetcast_brick_render_desc desc;
    tetcast_bricks_report report;
    tetcast_bricks_info info;
    tetcast_render_stats stats;
    tetcast_error error = {TETCAST_OK, 0, ""};
    tetcast_bricks *bricks = NULL;
    tetcast_cut *cut = NULL;
    tetcast_clip *clip = NULL;
    tetcast_image image;
    tetcast_result r = TETCAST_OK;
    difference diff[2] = {{0.0, 0.0}, {0.0, 0.0}};
    uint8_t *both = NULL;
    sup_error err;
    options o;
    look l;
    sup_lit lit;
    painter paint;
    double start, build = 0.0, seconds = 0.0, lo[3], hi[3];
    int status = parse_render(argc, argv, &o, &desc);
    if (status >= 0) return status;
    memset(&stats, 0, sizeof stats);
    memset(&image, 0, sizeof image);
    memset(&l, 0, sizeof l);
    memset(&paint, 0, sizeof paint);
    sup_error_clear(&err);
    desc.env.error = &error;
    if (o.in && sup_name_ends(o.in, ".brk")) status = read_bricks(o.in, &desc.env, &bricks, &err);
    else status = make_bricks(&o, &desc.env, &report, &bricks, &err);
    if (!status) {
        start = sup_now();
        status = make_cut(&o, &desc.env, bricks, o.seconds > 0.0 ? 1.0 : 0.0, &cut, &err);
        build = sup_now() - start;
    }
    if (!status) {
        tetcast_bricks_get_info(bricks, &info);
        brick_box(&info, lo, hi);
        (void)sup_volume_camera(&o.common, lo, hi, 0.0, &desc.camera);
        if (o.has_cut) {
            r = sup_cut(&desc.env, o.cut, lo, hi, &clip);
            if (r != TETCAST_OK) status = sup_fail_result(&err, "--cut", r, &error);
            desc.clip = clip;
        }
    }
    if (!status) status = make_look(&o, &desc, &info, cut, &l, &err);
    if (!status && o.paint) {
        status = paint_open(&paint, &o, &desc.env, l.transfer, &err);
        desc.shader = &paint.shader;
    }
    if (!status) {
        const size_t n = (size_t)o.common.size[0] * o.common.size[1];
        image.width = o.common.size[0];
        image.height = o.common.size[1];
        image.rgba8 = (uint8_t *)sup_alloc(n, 4);
        image.rgba = (float *)sup_alloc(n, 16);
        if (o.common.depth) image.depth = (float *)sup_alloc(n, 4);
        if (!image.rgba8 || !image.rgba || (o.common.depth && !image.depth)) status = sup_fail(&err, "out of memory for the picture");
    }
    if (!status) {
        sup_lit_open(&lit, l.transfer, 0.05 * ((double)info.value_max - (double)info.value_min) / info.lattice.spacing[0]);
        if (o.shader == SUP_SHADER_LIT) desc.shader = &lit.shader;
        for (int frame = 0; frame < 12 && !status; frame++) { /* --seconds: as many as it takes to fit */
            tetcast_cut_info shown;
            double samples;
            memset(&stats, 0, sizeof stats);
            start = sup_now();
            r = draw(&o, &desc, cut, l.optics, &image, &stats);
            seconds = sup_now() - start;
            if (r != TETCAST_OK) status = sup_fail_result(&err, o.in ? o.in : o.scene, r, &error);
            if (status || !(o.seconds > 0.0)) break;
            tetcast_cut_get_info(cut, &shown);
            samples = tetcast_cut_pace(&shown, seconds, o.seconds);
            if (samples == shown.samples || (samples >= 1.0 && shown.samples >= 1.0)) break;
            tetcast_cut_destroy(cut);
            cut = NULL;
            start = sup_now();
            status = make_cut(&o, &desc.env, bricks, samples, &cut, &err);
            build = sup_now() - start;
        }
    }
    if (!status && o.coded) status = sup_tile_write(o.coded, o.codec, image.rgba8, image.width, image.height, &err);
    if (!status && o.reference) status = draw_reference(&o, &desc, l.optics, &image, &both, diff, &err);
    if (!status) status = write_pictures(&o, &image, both, &err);
    if (!status && o.common.stats)
        print_stats(&o, bricks, cut, &l, &stats, &desc.camera, diff, both, build, seconds);
    if (status) (void)sup_bad_input(argv[0], err.text);
    SUP_FREE(image.rgba8);
    SUP_FREE(image.rgba);
    SUP_FREE(image.depth);
    SUP_FREE(both);
    tetcast_clip_destroy(clip);
    tetcast_optics_destroy(l.optics);
    tetcast_transfer_destroy(l.transfer);
    tetcast_cut_destroy(paint.cut);
    tetcast_bricks_destroy(paint.bricks);
    tetcast_cut_destroy(cut);
    tetcast_bricks_destroy(bricks);
    return status;
}

/* ---- slice: a plane through cells or bricks ----------------------------------------------------------------- */

/* The plane through a point at right angles to a direction, as large as the box. */
static void plane_of(const float normal[3], const double through[3], double side, uint32_t width, uint32_t height, tetcast_plane *out) {
    double n[3], u[3], v[3], length = 0.0;
    int k, least = 0;
    for (k = 0; k < 3; k++) length += (double)normal[k] * (double)normal[k];
    for (k = 0; k < 3; k++) n[k] = (double)normal[k] / sqrt(length);
    for (k = 1; k < 3; k++) if (fabs(n[k]) < fabs(n[least])) least = k;
    for (k = 0; k < 3; k++) u[k] = (k == least ? 1.0 : 0.0) - n[least] * n[k];
    length = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]);
    for (k = 0; k < 3; k++) u[k] /= length;
    for (k = 0; k < 3; k++) v[k] = n[(k + 1) % 3] * u[(k + 2) % 3] - n[(k + 2) % 3] * u[(k + 1) % 3];
    for (k = 0; k < 3; k++) {
        out->u[k] = u[k] * side * (width > height ? 1.0 : (double)width / height);
        out->v[k] = v[k] * side * (width > height ? (double)height / width : 1.0);
        out->origin[k] = through[k] - 0.5 * (out->u[k] + out->v[k]);
    }
}

/* Polygons of a section as an OBJ file. */
static int write_section(const char *path, const tetcast_section *s, sup_error *err) {
    sup_file file;
    if (sup_file_open(path, &file, err)) return 1;
    for (uint32_t i = 0; i < s->point_count; i++)
        fprintf(file.stream, "v %.9g %.9g %.9g %.9g\n", s->points[i][0], s->points[i][1], s->points[i][2], (double)s->values[i]);
    for (uint32_t i = 0; i < s->polygon_count; i++) {
        fputs("f", file.stream);
        for (uint32_t k = s->first[i]; k < s->first[i + 1]; k++) fprintf(file.stream, " %u", k + 1);
        fputs("\n", file.stream);
    }
    return sup_file_commit(&file, err);
}

/* Where the ray of a pixel meets a plane; not in front of the eye: 0. */
static int view_point(const tetcast_camera *camera, const tetcast_plane *plane, uint32_t width, uint32_t height, uint32_t i, uint32_t j,
                      double p[3]) {
    tetcast_ray ray;
    double up = 0.0, along = 0.0;
    if (tetcast_camera_ray(camera, width, height, (double)i + 0.5, (double)j + 0.5, &ray) != TETCAST_OK) return 0;
    for (int k = 0; k < 3; k++) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        const double n = plane->u[a] * plane->v[b] - plane->u[b] * plane->v[a];
        up += n * (plane->origin[k] - ray.org[k]);
        along += n * ray.dir[k];
    }
    if (!(up * along > 0.0)) return 0;
    for (int k = 0; k < 3; k++) p[k] = ray.org[k] + up / along * ray.dir[k];
    return 1;
}

/* camera: NULL, or it sees the plane. */
static int slice_bricks(const options *o, const tetcast_env *env, const tetcast_bricks *bricks, const tetcast_plane *plane,
                        const tetcast_camera *camera, uint32_t width, uint32_t height, float *out, sup_error *err) {
    tetcast_bricks_info info;
    tetcast_cut *cut = NULL;
    float *x = (float *)sup_alloc(width, 4), *y = (float *)sup_alloc(width, 4), *z = (float *)sup_alloc(width, 4), *row[3];
    int failed = x && y && z ? make_cut(o, env, bricks, 0.0, &cut, err) : sup_fail(err, "out of memory");
    tetcast_bricks_get_info(bricks, &info);
    row[0] = x;
    row[1] = y;
    row[2] = z;
    for (uint32_t j = 0; j < height && !failed; j++) {
        for (uint32_t i = 0; i < width; i++) {
            double p[3];
            const int met = camera && view_point(camera, plane, width, height, i, j, p);
            for (int k = 0; k < 3; k++) {
                const double at = met ? p[k] : plane->origin[k] + ((double)i + 0.5) / width * plane->u[k] + ((double)j + 0.5) / height * plane->v[k];
                row[k][i] = camera && !met ? -1.0f : (float)((at - info.lattice.origin[k]) / info.lattice.spacing[k]);
            }
        }
        tetcast_cut_sample(cut, x, y, z, width, TETCAST_ISA_AUTO, out + (size_t)j * width);
        for (uint32_t i = 0; i < width; i++)
            for (int k = 0; k < 3; k++)
                if (!(row[k][i] >= -1e-4f && row[k][i] <= (float)(info.lattice.dims[k] - 1) + 1e-4f)) out[(size_t)j * width + i] = NAN;
    }
    tetcast_cut_destroy(cut);
    SUP_FREE(x);
    SUP_FREE(y);
    SUP_FREE(z);
    return failed;
}

/* Values as colours, clear where there is none; gives how many there are. */
static double paint_values(const float *values, size_t count, float least, float most, uint8_t *pixels) {
    double covered = 0.0;
    for (size_t i = 0; i < count; i++) {
        memset(pixels + 4 * i, 0, 4);
        if (!(values[i] == values[i])) continue;
        covered += 1.0;
        rainbow(most > least ? ((double)values[i] - (double)least) / ((double)most - (double)least) : 0.5, pixels + 4 * i);
        pixels[4 * i + 3] = 255;
    }
    return covered;
}

static size_t slice_options(options *o, sup_option *table) {
    static const char *const unused[] = {"seed", "tolerance", "isa", "quiet", "unlit"};
    size_t n = sup_common_options(&o->common, table);
    sup_option_help(table, n, "out", "picture to write: .png (a rainbow) or .pfm (the values, NaN where there is none)");
    sup_option_help(table, n, "depth", "a plane has none");
    sup_option_help(table, n, "size", "pixels of the picture (1024x768)");
    for (size_t k = 0; k < sizeof unused / sizeof unused[0]; k++) sup_option_help(table, n, unused[k], "changes nothing here");
    o->common.size[0] = 1024;
    o->common.size[1] = 768;
    o->normal[2] = 1.0f;
    table[n++] = sup_opt_positional("IN", &o->in, 0, "volume mesh or grid, or .brk");
    n += input_options(o, table + n);
    table[n++] = sup_opt_vec3("normal", o->normal, "x,y,z: direction at right angles to the plane (0,0,1)");
    table[n++] = sup_opt_given(sup_opt_vec3("through", o->through, "x,y,z: a point of it (the middle)"), &o->has_through);
    table[n++] = sup_opt_text("section", &o->section, "FILE.obj", "of meshes: the polygons in which it cuts the cells; a value after each x y z");
    table[n++] = sup_opt_flag("view", &o->view, "the plane as --eye, --at, --fov see it, in perspective");
    table[n++] = sup_opt_int("level", &o->level, 0, 5, "N", "of bricks: no finer than this level");
    return n;
}

/* What the plane goes through: bricks or a mesh. */
typedef struct sliced {
    int is_bricks;
    tetcast_bricks *bricks;
    tetcast_mesh *mesh;
    double lo[3], hi[3];
    float least, most;
} sliced;

static int sliced_load(sliced *s, const options *o, const tetcast_env *env, sup_error *err) {
    tetcast_bricks_report report;
    int status;
    if (!s->is_bricks) status = load_mesh(o, o->in, env, &s->mesh, err);
    else if (o->in && sup_name_ends(o->in, ".brk")) status = read_bricks(o->in, env, &s->bricks, err);
    else status = make_bricks(o, env, &report, &s->bricks, err);
    if (status > 0) return 1;
    if (s->is_bricks) {
        tetcast_bricks_info info;
        tetcast_bricks_get_info(s->bricks, &info);
        brick_box(&info, s->lo, s->hi);
        s->least = info.value_min;
        s->most = info.value_max;
    } else {
        tetcast_mesh_info info;
        tetcast_mesh_get_info(s->mesh, &info);
        memcpy(s->lo, info.box_min, sizeof s->lo);
        memcpy(s->hi, info.box_max, sizeof s->hi);
        (void)tetcast_mesh_field(s->mesh, 0, &s->least, &s->most);
    }
    return 0;
}

static int slice(int argc, char **argv) {
    sup_option table[SUP_COMMON_OPTIONS + 20];
    tetcast_error error = {TETCAST_OK, 0, ""};
    tetcast_env env;
    sliced s;
    tetcast_section section;
    tetcast_plane plane;
    tetcast_camera camera;
    tetcast_result r = TETCAST_OK;
    sup_error err;
    options o;
    float *values = NULL;
    uint8_t *pixels = NULL;
    double through[3], side, start, seconds, covered = 0.0;
    size_t pixel_count;
    int status;
    set_defaults(&o);
    sup_error_clear(&err);
    memset(&env, 0, sizeof env);
    memset(&section, 0, sizeof section);
    memset(&camera, 0, sizeof camera);
    memset(&s, 0, sizeof s);
    status = sup_cli_parse(argc, argv, "Values on a plane through cells or bricks.", table, slice_options(&o, table));
    if (status >= 0) return status;
    if (!o.in == !o.scene) return sup_bad_usage(argv[0], "IN or --scene has to be given");
    if (!(fabsf(o.normal[0]) + fabsf(o.normal[1]) + fabsf(o.normal[2]) > 0.0f)) return sup_bad_usage(argv[0], "--normal: no direction");
    if (o.common.depth) return sup_bad_usage(argv[0], "--depth: a plane has none");
    if (!o.common.out && !o.section) return sup_bad_usage(argv[0], "--out or --section has to be given");
    if (o.common.out) status = sup_out_check(argv[0], &o.common);
    if (status >= 0) return status;
    s.is_bricks = o.in ? sup_name_ends(o.in, ".brk") || sup_amr_is(o.in) : strcmp(o.scene, "blast") == 0;
    if (s.is_bricks && o.section) return sup_bad_usage(argv[0], "--section: of meshes");
    env.thread_count = (uint32_t)o.common.threads;
    env.error = &error;
    status = sliced_load(&s, &o, &env, &err);
    pixel_count = (size_t)o.common.size[0] * o.common.size[1];
    values = (float *)sup_alloc(pixel_count, 4);
    pixels = (uint8_t *)sup_alloc(pixel_count, 4);
    if (!status && (!values || !pixels)) status = sup_fail(&err, "out of memory for the picture");
    start = sup_now();
    if (!status) {
        side = 1.1 * sup_box_diagonal(s.lo, s.hi) / sqrt(2.0);
        for (int k = 0; k < 3; k++) through[k] = o.has_through ? (double)o.through[k] : 0.5 * (s.lo[k] + s.hi[k]);
        plane_of(o.normal, through, side, o.common.size[0], o.common.size[1], &plane);
        if (o.view) (void)sup_volume_camera(&o.common, s.lo, s.hi, 0.0, &camera);
        if (s.is_bricks) status = slice_bricks(&o, &env, s.bricks, &plane, o.view ? &camera : NULL, o.common.size[0], o.common.size[1], values, &err);
        else if (o.view) r = tetcast_plane_view(&env, s.mesh, &plane, &camera, o.common.size[0], o.common.size[1], values, NULL);
        else r = tetcast_plane_sample(&env, s.mesh, &plane, o.common.size[0], o.common.size[1], values);
        if (r == TETCAST_OK && o.section) r = tetcast_plane_section(&env, s.mesh, &plane, &section);
        if (r != TETCAST_OK) status = sup_fail_result(&err, o.in ? o.in : o.scene, r, &error);
    }
    seconds = sup_now() - start;
    if (!status) covered = paint_values(values, pixel_count, s.least, s.most, pixels);
    if (!status && o.section) status = write_section(o.section, &section, &err);
    if (!status && o.common.out && sup_out_is_linear(&o.common))
        status = sup_pfm_write(o.common.out, values, o.common.size[0], o.common.size[1], 1, &err);
    else if (!status && o.common.out) status = sup_png_write8(o.common.out, pixels, o.common.size[0], o.common.size[1], 4, &err);
    if (!status && o.common.stats) {
        printf("{\"program\":\"tetcast_bricks\",\"command\":\"slice\",\"in\":");
        sup_json_string(stdout, o.in ? o.in : o.scene);
        printf(",\"width\":%u,\"height\":%u,\"covered\":%.0f,\"polygons\":%u,\"area\":%.9g,\"range\":[%.9g,%.9g],\"seconds\":%.6f}\n",
               o.common.size[0], o.common.size[1], covered, section.polygon_count, section.area, (double)s.least, (double)s.most, seconds);
    }
    if (status) (void)sup_bad_input(argv[0], err.text);
    tetcast_section_free(&section);
    tetcast_bricks_destroy(s.bricks);
    tetcast_mesh_destroy(s.mesh);
    SUP_FREE(values);
    SUP_FREE(pixels);
    return status;
}

/* ---- tile: a coded picture back ----------------------------------------------------------------------------- */

static int tile(int argc, char **argv) {
    sup_option table[8];
    const char *in = NULL, *out = NULL;
    uint8_t *pixels = NULL;
    uint32_t width = 0, height = 0;
    sup_error err;
    size_t n = 0;
    int status;
    sup_error_clear(&err);
    table[n++] = sup_opt_positional("IN.tile", &in, 1, "what --coded wrote");
    table[n++] = sup_opt_text("out", &out, "P.png", "the picture");
    status = sup_cli_parse(argc, argv, "Decodes a picture of colour cells, or without loss.", table, n);
    if (status >= 0) return status;
    if (!out) return sup_bad_usage(argv[0], "--out has to be given");
    status = sup_tile_read(in, &pixels, &width, &height, &err);
    if (!status) status = sup_png_write8(out, pixels, width, height, 4, &err);
    if (status) (void)sup_bad_input(argv[0], err.text);
    SUP_FREE(pixels);
    return status;
}

int main(int argc, char **argv) {
    static const struct { const char *name; int (*run)(int, char **); } commands[] = {
        {"resample", resample}, {"render", render}, {"slice", slice}, {"tile", tile}
    };
    static char name[64]; /* help and messages begin with it */
    for (size_t k = 0; argc > 1 && k < sizeof commands / sizeof commands[0]; k++) {
        if (strcmp(argv[1], commands[k].name) != 0) continue;
        snprintf(name, sizeof name, "tetcast_bricks %s", commands[k].name);
        argv[1] = name;
        return commands[k].run(argc - 1, argv + 1);
    }
    if (argc > 1 && strcmp(argv[1], "--help") == 0) {
        printf("usage: tetcast_bricks resample IN OUT.brk [--max-error E] ...\n"
               "       tetcast_bricks render IN --out P.png ...\n"
               "       tetcast_bricks slice IN --normal x,y,z --out P.png ...\n"
               "       tetcast_bricks tile IN.tile --out P.png\n"
               "Bricks with level of detail: made from tetrahedra or a grid, and drawn. Each command has --help.\n");
        return 0;
    }
    return sup_bad_usage(argv[0], "the first word is resample, render, slice or tile");
}
