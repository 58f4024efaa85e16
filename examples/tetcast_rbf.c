/* tetcast_rbf.c - volumes as sums of radial basis functions: fit, draw, follow particles
   SPDX-License-Identifier: MIT OR Unlicense

   tetcast_rbf fit IN OUT.rbf --max-error 0.05     grid, tetrahedra or other points -> functions
   tetcast_rbf fit tornado OUT.rbf                 a generated flow; or a scene of volume_scenes.h
   tetcast_rbf decode IN.rbf OUT.brk               functions -> bricks, for tetcast_bricks
   tetcast_rbf render IN.rbf --out P.png           picture of the field
   tetcast_rbf trace IN.rbf --out P.png            paths of particles in a field of vectors */
#include "support/cli.h"
#include "support/volume_scenes.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "support/volume_look.h"

#define COMMANDS "fit|render|trace|decode"
enum { COMMAND_FIT, COMMAND_RENDER, COMMAND_TRACE, COMMAND_DECODE };
enum { LOOK = 40 }; /* a grid of so many places a side tells what values there are */

typedef struct options {
    sup_common common;
    const char *in, *out, *field, *tf, *slice, *inside, *first;
    int command, method, kernel, model, channel, gather, stepper, has_model, euler, between, storage, round;
    int64_t detail, sweeps, component, samples, seeds, steps, base, longest, longest_end;
    double max_error, mean_error, cut, scale, iso, opacity, dt, ortho, epsilon, step;
    int has_iso, has_cut, shader;
    float background[3], cut_way[3];
    int has_background;
} options;

static int parse(int argc, char **argv, options *o) {
    sup_option t[SUP_COMMON_OPTIONS + 48];
    const char *command = NULL;
    size_t n;
    int status;
    memset(o, 0, sizeof *o);
    o->max_error = 0.05;
    o->scale = 1.0;
    o->opacity = 1.0;
    o->sweeps = 3;
    o->seeds = 110;
    o->steps = 400;
    n = sup_common_options(&o->common, t);
    o->common.size[0] = 1024;
    o->common.size[1] = 768;
    t[n++] = sup_opt_positional(COMMANDS, &command, 1, "what to do");
    t[n++] = sup_opt_positional("IN", &o->in, 1, "fit: a volume (.vtk, .inp, .msh, .node, PLOT3D), \"tornado\" or one of "
                                SUP_VOLUME_SCENES "; else an .rbf file");
    t[n++] = sup_opt_positional("OUT", &o->out, 0, "fit: the .rbf, decode: the .brk file");
    t[n++] = sup_opt_real("max-error", &o->max_error, 1e-6, 1.0, "E", "fit: largest error at the points; decode: of the bricks; share of the range (0.05)");
    t[n++] = sup_opt_real("mean-error", &o->mean_error, 0.0, 1.0, "E", "fit: mean error (any)");
    t[n++] = sup_opt_text("field", &o->field, "NAME", "fit: the field (the first one)");
    t[n++] = sup_opt_int("detail", &o->detail, 0, 512, "N", "fit: how fine a generated volume is (32; ball and ring 48, fins 24)");
    t[n++] = sup_opt_choice("method", &o->method, "hybrid|pure", "fit: with a coarse grid, or functions only");
    t[n++] = sup_opt_int("base", &o->base, 2, 512, "N", "fit: nodes of the coarse grid along each side (by trial)");
    t[n++] = sup_opt_flag("between", &o->between, "fit: keep the error in the middles of cells as well");
    t[n++] = sup_opt_flag("round", &o->round, "fit: no ellipsoids");
    t[n++] = sup_opt_choice("kernel", &o->kernel, "gauss|cut|wendland2|wendland4|power", "fit: the kernel (gauss); cut, the thesis' own, jumps: refused");
    t[n++] = sup_opt_real("cut", &o->cut, 1.0, 8.0, "K", "fit: where Gaussians end, in widths (3.5)");
    t[n++] = sup_opt_int("sweeps", &o->sweeps, 0, 100, "N", "fit: how often functions are fitted again (3)");
    t[n++] = sup_opt_text("start", &o->first, "FILE.rbf", "fit: begin with the functions of this one, the step before in a series");
    t[n++] = sup_opt_text("tf", &o->tf, "FILE|" SUP_TRANSFER_NAMES, "transfer function (a rainbow that shows what is rare)");
    t[n++] = sup_opt_real("extinction", &o->scale, 1e-9, 1e9, "F", "multiplies all extinctions");
    t[n++] = sup_opt_given(sup_opt_choice("model", &o->model, "volume|emission|absorption|maximum|iso|mixed",
                                          "what light does in it (volume; with --iso: iso, with --iso and --tf: mixed)"), &o->has_model);
    t[n++] = sup_opt_given(sup_opt_real("iso", &o->iso, -1e38, 1e38, "V", "show the surface of this value"), &o->has_iso);
    t[n++] = sup_opt_real("iso-opacity", &o->opacity, 0.0, 1.0, "A", "of the surface (1)");
    t[n++] = sup_opt_choice("channel", &o->channel, "auto|component|length|vorticity|lambda2|helicity",
                            "what is seen of a vector (its length; lambda2: minus it)");
    t[n++] = sup_opt_int("component", &o->component, 0, 3, "N", "which component");
    t[n++] = sup_opt_int("samples", &o->samples, 0, 65000, "N", "samples along the diagonal (by the functions)");
    t[n++] = sup_opt_real("epsilon", &o->epsilon, 0.0, 1.0, "E", "leave out functions below this share of the largest");
    t[n++] = sup_opt_choice("shader", &o->shader, SUP_SHADERS, "lit: a shader of this program, lit by gradients");
    t[n++] = sup_opt_given(sup_opt_vec3("half", o->cut_way, "keep what lies this way from the middle"), &o->has_cut);
    t[n++] = sup_opt_text("inside", &o->inside, "VOLUME", "keep what lies within this one, as IN of fit");
    t[n++] = sup_opt_flag("gather", &o->gather, "ask the cell of each sample instead of sorting functions into tiles");
    t[n++] = sup_opt_text("slice", &o->slice, "x|y|z=F", "a plane instead, F of the way through the box");
    t[n++] = sup_opt_real("ortho", &o->ortho, 0.0, 1e30, "H", "parallel rays; height of the picture");
    t[n++] = sup_opt_given(sup_opt_vec3("background", o->background, "linear r,g,b instead of transparent"), &o->has_background);
    t[n++] = sup_opt_int("longest", &o->longest, 2, 16385, "N", "decode: nodes along the longest side (what the error needs)");
    t[n++] = sup_opt_int("longest-end", &o->longest_end, 2, 16385, "N", "decode: no more than that (513)");
    t[n++] = sup_opt_choice("storage", &o->storage, "f16|f32|u16|u8", "decode: how values are stored (f16)");
    t[n++] = sup_opt_int("seeds", &o->seeds, 1, 1000000, "N", "trace: particles (110)");
    t[n++] = sup_opt_int("steps", &o->steps, 1, 1000000, "N", "trace: steps of each (400)");
    t[n++] = sup_opt_real("dt", &o->dt, -1e30, 1e30, "T", "trace: time of a step (1/200 of the box at the greatest speed)");
    t[n++] = sup_opt_choice("stepper", &o->stepper, "rk4|euler|dopri5",
                            "trace: Runge-Kutta, the thesis' way, or as many steps within dt as --tolerance asks for");
    sup_option_help(t, n, "size", "pixels of the picture (1024x768)");
    sup_option_help(t, n, "seed", "trace: random seed");
    sup_option_help(t, n, "tolerance", "render: colour error in units of 1/255 (0); trace: of a step of dopri5, a length (1e-6 of the diagonal)");
    sup_option_help(t, n, "quiet", "no progress and no warnings");
    sup_option_help(t, n, "unlit", "changes nothing: volumes have no lights");
    status = sup_cli_parse(argc, argv, "Encodes volumes as radial basis functions and looks at them.", t, n);
    if (status >= 0) return status;
    o->command = sup_parse_choice(command, COMMANDS);
    if (o->command < 0) return sup_bad_usage(argv[0], "\"%s\" is none of fit, render, trace, decode", command);
    if ((o->command == COMMAND_FIT || o->command == COMMAND_DECODE) && !o->out)
        return sup_bad_usage(argv[0], "the file to write is missing");
    if (o->first && o->command != COMMAND_FIT) return sup_bad_usage(argv[0], "--start is for fit");
    if (o->command == COMMAND_FIT && o->kernel == TETCAST_KERNEL_GAUSS_CUT)
        return sup_bad_usage(argv[0], "--kernel cut: that one jumps, no error could be guaranteed");
    if (o->command != COMMAND_FIT && o->command != COMMAND_DECODE) status = sup_out_check(argv[0], &o->common);
    if (status >= 0) return status;
    if (o->slice && !(o->slice[0] >= 'x' && o->slice[0] <= 'z' && o->slice[1] == '='))
        return sup_bad_usage(argv[0], "--slice: x=, y= or z= and a number from 0 to 1");
    if (o->inside && o->has_cut) return sup_bad_usage(argv[0], "--inside and --half: one of them");
    if (!o->has_model && o->has_iso) o->model = o->tf ? TETCAST_MODEL_MIXED : TETCAST_MODEL_ISOSURFACE;
    return -1;
}

static int fail(const options *o, const tetcast_error *error, tetcast_result result, sup_error *err) {
    return sup_fail_result(err, o->in, result, error);
}

/* ---- fit ---------------------------------------------------------------------------------------------------- */

/* R. Crawfis' tornado at time 0 on n^3 points of the unit cube. */
static int make_tornado(uint32_t n, sup_volume *v, sup_error *err) {
    float *out;
    memset(v, 0, sizeof *v);
    out = sup_volume_add_field(v, "velocity", 8, 3, 0, (size_t)n * n * n);
    if (!out) return sup_fail(err, "out of memory");
    for (int k = 0; k < 3; k++) {
        v->dims[k] = n;
        v->spacing[k] = 1.0 / (n - 1);
    }
    v->point_count = (size_t)n * n * n;
    for (size_t i = 0; i < v->point_count; i++, out += 3) {
        const double x = (double)(i % n) / (n - 1), y = (double)(i / n % n) / (n - 1), z = (double)(i / n / n) / (n - 1);
        const double xc = 0.5 + 0.1 * sin(10.0 * z), yc = 0.5 + 0.1 * cos(3.0 * z), r = 0.1 + 0.4 * z * z + 0.1 * z * sin(8.0 * z);
        const double r2 = 0.2 + 0.1 * z;
        double t = sqrt((x - xc) * (x - xc) + (y - yc) * (y - yc)), s = fabs(r - t), up = fmax(0.0, 0.1 * (0.1 - t * z));
        s = s > r2 ? 0.8 - s : 1.0;
        t = sqrt(t * t + up * up);
        s = (r + r2 - t) * s / ((t + 1e-11) * (1.0 + z));
        out[0] = (float)(s * (y - yc) + 0.1 * (x - xc));
        out[1] = (float)(0.1 * (y - yc) - s * (x - xc));
        out[2] = (float)(s * up);
    }
    return 0;
}

static int read_volume(const options *o, const char *in, sup_volume *v, sup_error *err) {
    if (strcmp(in, "tornado") == 0) return make_tornado(o->detail > 1 ? (uint32_t)o->detail : 32, v, err);
    if (sup_parse_choice(in, SUP_VOLUME_SCENES) >= 0) return sup_volume_make(in, (uint32_t)o->detail, v, err);
    return sup_volume_read(in, v, err);
}

static void print_fit(const options *o, const sup_field *field, const tetcast_rbf_report *r, double seconds) {
    static const char *const methods[] = {"hybrid", "pure"};
    printf("{\"program\":\"tetcast_rbf\",\"command\":\"fit\",\"in\":");
    sup_json_string(stdout, o->in);
    printf(",\"field\":");
    sup_json_string(stdout, field->name);
    printf(",\"components\":%u,\"points\":%llu,\"rejected\":%llu,\"duplicates\":%llu,\"range\":%.9g,\"method\":\"%s\"", field->components,
           (unsigned long long)r->points, (unsigned long long)r->rejected, (unsigned long long)r->duplicates, r->range, methods[o->method]);
    printf(",\"functions\":%u,\"ellipsoids\":%u,\"base\":[%u,%u,%u],\"started\":%u,\"inserted\":%u,\"dropped\":%u,\"rounds\":%u", r->functions,
           r->ellipsoids, r->base_dims[0], r->base_dims[1], r->base_dims[2], r->started, r->inserted, r->dropped, r->rounds);
    printf(",\"tolerance\":%.6g,\"max_error\":%.6g,\"mean_error\":%.6g,\"rms_error\":%.6g,\"p999_error\":%.6g", o->max_error,
           r->max_error, r->mean_error, r->rms_error, r->p999_error);
    printf(",\"between\":%llu,\"between_max\":%.6g,\"between_mean\":%.6g,\"overshoot\":%.6g,\"largest_weight\":%.6g",
           (unsigned long long)r->between_count, r->between_max, r->between_mean, r->overshoot, r->largest_weight);
    if (field->components > 1) printf(",\"direction_mean\":%.4g,\"direction_max\":%.4g", r->direction_mean, r->direction_max);
    printf(",\"bytes\":%llu,\"raw_bytes\":%llu,\"grid_bytes\":%llu,\"grid\":[%u,%u,%u],\"grid_bits\":%u,\"grid_max_error\":%.6g,"
           "\"grid_mean_error\":%.6g", (unsigned long long)r->bytes, (unsigned long long)r->raw_bytes, (unsigned long long)r->grid_bytes,
           r->grid_dims[0], r->grid_dims[1], r->grid_dims[2], r->grid_bits, r->grid_max_error, r->grid_mean_error);
    printf(",\"verdict\":\"%s\",\"seconds\":%.6f,\"threads\":%d}\n", r->functions_win ? "functions" : "grid", seconds,
           sup_threads(o->common.threads));
}

/* Where the values of a field are, as the encoder takes them: vertices, or middles of cells where values are those of
   cells. *made: positions that had to be made, free with SUP_FREE. 1: no memory. */
static int fit_points(const sup_volume *v, const sup_field *field, tetcast_rbf_points *p, double **made) {
    const int grid = v->dims[0] && !v->points, lattice = grid && !v->axes[0] && !v->axes[1] && !v->axes[2];
    size_t n[3], at = 0;
    int tets = 1;
    *made = NULL;
    memset(p, 0, sizeof *p);
    p->values.data = field->values;
    p->components = field->components;
    p->count = field->count;
    for (int k = 0; k < 3; k++) n[k] = v->dims[k] > 1 && field->per_cell ? v->dims[k] - 1 : v->dims[k];
    if (lattice) {
        for (int k = 0; k < 3; k++) {
            p->dims[k] = (uint32_t)n[k];
            p->spacing[k] = v->spacing[k];
            p->origin[k] = v->origin[k] + (field->per_cell && v->dims[k] > 1 ? 0.5 * v->spacing[k] : 0.0);
        }
        return 0;
    }
    p->positions.data = v->points;
    p->positions.type = TETCAST_TYPE_F64;
    for (size_t i = 0; i < v->cell_count; i++) tets = tets && v->shapes[i] == SUP_TETRA;
    if (v->points && !field->per_cell && tets && v->cell_count) {
        p->tets = v->indices;
        p->tet_count = v->cell_count;
    }
    if (v->points && !field->per_cell) return 0;
    *made = (double *)sup_alloc(field->count, 24);
    if (!*made) return 1;
    p->positions.data = *made;
    for (size_t i = 0; i < field->count; i++) {
        double *q = *made + 3 * i;
        q[0] = q[1] = q[2] = 0.0;
        if (grid) { /* rectilinear: lines of nodes along each axis, or the middles between them */
            const size_t c[3] = {i % n[0], i / n[0] % n[1], i / n[0] / n[1]};
            for (int k = 0; k < 3; k++) {
                const double a = v->axes[k] ? v->axes[k][c[k]] : v->origin[k] + v->spacing[k] * (double)c[k];
                const double b = v->dims[k] < 2 ? a : v->axes[k] ? v->axes[k][c[k] + (field->per_cell ? 1 : 0)]
                    : a + (field->per_cell ? v->spacing[k] : 0.0);
                q[k] = 0.5 * (a + b);
            }
            continue;
        }
        if (v->dims[0]) { /* curvilinear: eight corners */
            const size_t c[3] = {i % n[0], i / n[0] % n[1], i / n[0] / n[1]};
            for (int j = 0; j < 8; j++) {
                size_t point = 0;
                for (int k = 3; k-- > 0;) point = point * v->dims[k] + c[k] + (v->dims[k] > 1 ? (size_t)(j >> k & 1) : 0);
                for (int k = 0; k < 3; k++) q[k] += v->points[3 * point + (size_t)k] / 8.0;
            }
            continue;
        }
        {
            const size_t corners = (size_t)sup_shape_corners(v->shapes[i]);
            for (size_t j = 0; j < corners; j++)
                for (int k = 0; k < 3; k++) q[k] += v->points[3 * (size_t)v->indices[at + j] + (size_t)k] / (double)corners;
            at += corners;
        }
    }
    return 0;
}

static int load(const char *path, const tetcast_env *env, tetcast_rbf **out, sup_error *err) {
    char *data = NULL;
    size_t size = 0;
    tetcast_result result;
    if (sup_read_file(path, &data, &size, err)) return 1;
    result = tetcast_rbf_load_memory(env, data, size, out);
    SUP_FREE(data);
    return result != TETCAST_OK ? sup_fail_result(err, path, result, env->error) : 0;
}

static int fit(const options *o, tetcast_env *env, sup_error *err) {
    tetcast_rbf_fit_desc d;
    tetcast_rbf_points p;
    tetcast_rbf_report report;
    tetcast_rbf *rbf = NULL, *first = NULL;
    sup_volume v;
    sup_progress progress;
    const sup_field *field = NULL;
    tetcast_result result;
    void *bytes = NULL;
    size_t size = 0;
    double start, *points = NULL;
    int failed;
    if (read_volume(o, o->in, &v, err)) return 1;
    if (err->text[0] && !o->common.quiet) sup_warn("tetcast_rbf", err->text);
    for (size_t i = 0; i < v.field_count && !field; i++)
        if (!o->field || strcmp(v.fields[i].name, o->field) == 0) field = v.fields + i;
    if (!field || field->components > TETCAST_RBF_MAX_COMPONENTS) {
        failed = !field ? sup_fail(err, "%s: there is no field%s%s", o->in, o->field ? " " : "", o->field ? o->field : "")
            : sup_fail(err, "%s: field %s: too many components", o->in, field->name);
        sup_volume_free(&v);
        return failed;
    }
    memset(&d, 0, sizeof d);
    if (o->first && load(o->first, env, &first, err)) {
        sup_volume_free(&v);
        return 1;
    }
    if (fit_points(&v, field, &p, &points)) {
        tetcast_rbf_destroy(first);
        sup_volume_free(&v);
        return sup_fail(err, "out of memory");
    }
    sup_progress_begin(&progress, "fitting", o->common.quiet);
    d.env = *env;
    if (!progress.quiet) {
        d.env.progress_fn = sup_progress_fn;
        d.env.progress_user = &progress;
    }
    d.isa = (tetcast_isa)o->common.isa;
    d.method = (tetcast_rbf_method)o->method;
    d.kernel = (tetcast_kernel)o->kernel;
    d.max_error = (float)o->max_error;
    d.mean_error = (float)o->mean_error;
    d.cut = (float)o->cut;
    d.sweeps = o->sweeps ? (uint32_t)o->sweeps : 0xffffffffu;
    for (int k = 0; k < 3; k++) d.base_dims[k] = (uint32_t)o->base;
    d.compare = 1;
    d.start = first;
    d.between = (uint32_t)o->between;
    d.round = (uint32_t)o->round;
    start = sup_now();
    result = tetcast_rbf_fit(&d, &p, &report, &rbf);
    start = sup_now() - start;
    sup_progress_end(&progress);
    failed = result != TETCAST_OK ? fail(o, env->error, result, err) : 0;
    if (!failed) {
        (void)tetcast_rbf_save_memory(rbf, NULL, 0, &size);
        bytes = sup_alloc(size, 1);
        if (!bytes) failed = sup_fail(err, "out of memory");
        else {
            (void)tetcast_rbf_save_memory(rbf, bytes, size, &size);
            failed = sup_write_file(o->out, bytes, size, err);
        }
    }
    if (!failed && o->common.stats) print_fit(o, field, &report, start);
    else if (!failed && !o->common.quiet) {
        fprintf(stderr, "%u functions (%u ellipsoids) and a base of %u x %u x %u: %llu bytes, error %.3g at most and %.3g on average at the points",
                report.functions, report.ellipsoids, report.base_dims[0], report.base_dims[1], report.base_dims[2], (unsigned long long)report.bytes,
                report.max_error, report.mean_error);
        if (!report.between_count) fprintf(stderr, "; between them nothing is known");
        else fprintf(stderr, ", %.3g and %.3g between them", report.between_max, report.between_mean);
        if (report.between_max > 3.0 * report.max_error) /* the promise is for the points: say what it is not for */
            fprintf(stderr, "\nbetween the points, against linear interpolation, the error is up to %.1f times as large%s",
                    report.between_max / report.max_error,
                    o->between ? "" : o->round ? "; --between keeps it in the middles of cells as well"
                                               : "; --between keeps it in the middles of cells as well, --round is gentler");
        if (!report.functions_win)
            fprintf(stderr, "\nfunctions are the wrong choice: a plain grid or plain values need %llu bytes", (unsigned long long)report.grid_bytes);
        fprintf(stderr, "\n");
    }
    SUP_FREE(bytes);
    SUP_FREE(points);
    tetcast_rbf_destroy(rbf);
    tetcast_rbf_destroy(first);
    sup_volume_free(&v);
    return failed;
}

/* ---- what is in it ------------------------------------------------------------------------------------------- */

typedef struct model {
    tetcast_rbf *rbf;
    tetcast_rbf_info info;
    double diagonal, lo, hi;    /* of the middle 99 % of the values */
    float *value;               /* LOOK^3 of what is seen */
} model;

/* What the channel shows of values and derivatives. */
static float channel_value(const options *o, const model *m, const float *v, const float *jacobian) {
    const uint32_t n = m->info.components;
    const int channel = o->channel ? o->channel : n == 1 ? TETCAST_RBF_CHANNEL_COMPONENT : TETCAST_RBF_CHANNEL_LENGTH;
    tetcast_flow flow;
    double sum = 0.0;
    if (channel == TETCAST_RBF_CHANNEL_COMPONENT) return v[o->component];
    if (channel == TETCAST_RBF_CHANNEL_LENGTH) {
        for (uint32_t c = 0; c < n; c++) sum += (double)v[c] * (double)v[c];
        return (float)sqrt(sum);
    }
    tetcast_flow_features(v, jacobian, &flow);
    if (channel == TETCAST_RBF_CHANNEL_LAMBDA2) return -flow.lambda2;
    if (channel == TETCAST_RBF_CHANNEL_HELICITY) return flow.helicity;
    for (int k = 0; k < 3; k++) sum += (double)flow.vorticity[k] * (double)flow.vorticity[k];
    return (float)sqrt(sum);
}

static int evaluate(const options *o, const model *m, const tetcast_env *env, const double *points, size_t count, float *out,
                    sup_error *err) {
    tetcast_rbf_eval_desc d;
    const size_t n = m->info.components;
    const int slopes = o->channel > TETCAST_RBF_CHANNEL_LENGTH;
    float *v = (float *)sup_alloc(count, n * sizeof *v), *j = slopes ? (float *)sup_alloc(count, 3 * n * sizeof *j) : NULL;
    tetcast_result result = TETCAST_ERR_NO_MEMORY;
    memset(&d, 0, sizeof d);
    d.env = *env;
    d.isa = (tetcast_isa)o->common.isa;
    if (v && (j || !slopes)) result = tetcast_rbf_eval(&d, m->rbf, points, count, v, j);
    for (size_t i = 0; result == TETCAST_OK && i < count; i++) out[i] = channel_value(o, m, v + i * n, j ? j + i * 3 * n : NULL);
    SUP_FREE(v);
    SUP_FREE(j);
    return result == TETCAST_OK ? 0 : fail(o, env->error, result, err);
}

static int open_model(const options *o, const tetcast_env *env, model *m, sup_error *err) {
    double *points;
    float *sorted;
    int failed;
    memset(m, 0, sizeof *m);
    if (load(o->in, env, &m->rbf, err)) return 1;
    tetcast_rbf_get_info(m->rbf, &m->info);
    if (o->component >= m->info.components) return sup_fail(err, "%s: there are %u components", o->in, m->info.components);
    if (o->channel > TETCAST_RBF_CHANNEL_LENGTH && m->info.components != 3)
        return sup_fail(err, "%s: this channel needs three components", o->in);
    m->diagonal = sup_box_diagonal(m->info.box_min, m->info.box_max);
    points = (double *)sup_alloc((size_t)LOOK * LOOK * LOOK, 3 * sizeof *points);
    sorted = (float *)sup_alloc((size_t)LOOK * LOOK * LOOK, sizeof *sorted);
    m->value = (float *)sup_alloc((size_t)LOOK * LOOK * LOOK, sizeof *m->value);
    failed = points && sorted && m->value ? 0 : sup_fail(err, "out of memory");
    for (size_t i = 0; !failed && i < (size_t)LOOK * LOOK * LOOK; i++) {
        const size_t at[3] = {i % LOOK, i / LOOK % LOOK, i / LOOK / LOOK};
        for (int k = 0; k < 3; k++)
            points[3 * i + (size_t)k] = m->info.box_min[k] + (m->info.box_max[k] - m->info.box_min[k]) * ((double)at[k] + 0.5) / LOOK;
    }
    if (!failed) failed = evaluate(o, m, env, points, (size_t)LOOK * LOOK * LOOK, m->value, err);
    if (!failed) {
        const size_t n = (size_t)LOOK * LOOK * LOOK;
        memcpy(sorted, m->value, n * sizeof *sorted);
        qsort(sorted, n, sizeof *sorted, sup_compare_floats);
        m->lo = (double)sorted[n / 200];
        m->hi = (double)sorted[n - 1 - n / 200];
        if (!(m->hi > m->lo)) {
            m->lo = (double)sorted[0];
            m->hi = (double)sorted[n - 1];
        }
        if (!(m->hi > m->lo)) m->hi = m->lo + 1.0;
    }
    SUP_FREE(points);
    SUP_FREE(sorted);
    return failed;
}

/* ---- decode -------------------------------------------------------------------------------------------------- */

static int decode(const options *o, const tetcast_env *env, const model *m, sup_error *err) {
    static const tetcast_type storages[4] = {TETCAST_TYPE_F16, TETCAST_TYPE_F32, TETCAST_TYPE_U16, TETCAST_TYPE_U8};
    const double range = o->channel == TETCAST_RBF_CHANNEL_AUTO && m->info.range[1] > m->info.range[0]
        ? (double)m->info.range[1] - (double)m->info.range[0] : m->hi - m->lo;
    tetcast_bricks_desc d;
    tetcast_bricks_report report;
    tetcast_bricks_info info;
    tetcast_bricks *bricks = NULL;
    tetcast_result result;
    double start = sup_now();
    int failed;
    memset(&d, 0, sizeof d);
    memset(&report, 0, sizeof report);
    d.env = *env;
    d.storage = storages[o->storage];
    d.max_error = (float)(o->max_error * range);
    d.longest = (uint32_t)o->longest;
    d.longest_end = (uint32_t)o->longest_end;
    result = tetcast_bricks_create_rbf(&d, m->rbf, (tetcast_rbf_channel)o->channel, (uint32_t)o->component, &report, &bricks);
    failed = result != TETCAST_OK ? fail(o, env->error, result, err) : 0;
    start = sup_now() - start;
    if (!failed) {
        const size_t size = tetcast_bricks_file_size(bricks);
        void *data = sup_alloc(size, 1);
        failed = !data ? sup_fail(err, "out of memory") :
                 tetcast_bricks_write(bricks, data, size) != TETCAST_OK ? sup_fail(err, "%s: too large", o->out) :
                 sup_write_file(o->out, data, size, err);
        SUP_FREE(data);
    }
    if (!failed && report.above && !o->common.quiet)
        fprintf(stderr, "warning: %s: %llu of %llu points are farther off than %g of the range, the worst %g; --longest-end allows "
                "more nodes\n", o->out, (unsigned long long)report.above, (unsigned long long)report.checks, o->max_error,
                report.error / range);
    if (!failed && o->common.stats) {
        tetcast_bricks_get_info(bricks, &info);
        printf("{\"program\":\"tetcast_rbf\",\"command\":\"decode\",\"in\":");
        sup_json_string(stdout, o->in);
        printf(",\"dims\":[%u,%u,%u],\"bricks\":%llu,\"bytes\":%llu,\"file_bytes\":%llu,\"rbf_bytes\":%llu,\"max_error\":%.6g,\"error\":%.6g,"
               "\"mean_error\":%.6g,\"checks\":%llu,\"above\":%llu,\"tries\":%u,\"seconds\":%.6f}\n", info.lattice.dims[0],
               info.lattice.dims[1], info.lattice.dims[2], (unsigned long long)info.bricks, (unsigned long long)info.bytes,
               (unsigned long long)tetcast_bricks_file_size(bricks), (unsigned long long)m->info.file_bytes, o->max_error,
               report.error / range, report.mean_error / range, (unsigned long long)report.checks, (unsigned long long)report.above,
               report.tries, start);
    }
    tetcast_bricks_destroy(bricks);
    return failed;
}

/* ---- optics -------------------------------------------------------------------------------------------------- */

/* The rainbow by how much of the box has which value. */
static int rare_transfer(const model *m, sup_transfer *tf, sup_error *err) {
    const size_t n = (size_t)LOOK * LOOK * LOOK;
    sup_shares s;
    memset(&s, 0, sizeof s);
    s.lo = m->lo;
    s.hi = m->hi;
    for (size_t i = 0; i < n; i++) sup_shares_add(&s, (double)m->value[i], 1.0);
    sup_shares_end(&s, (double)n);
    return sup_rare_transfer(&s, m->diagonal, tf, err);
}

typedef struct small_picture {
    tetcast_rbf_render_desc desc;
    const tetcast_rbf *rbf;
} small_picture;

static tetcast_result draw_small(void *ctx, const tetcast_optics *optics, const tetcast_image *image) {
    const small_picture *p = (const small_picture *)ctx;
    return tetcast_rbf_render(&p->desc, p->rbf, optics, image, NULL);
}

static double choose_extinction(const tetcast_rbf_render_desc *desc, const model *m, const tetcast_transfer *transfer) {
    small_picture p;
    p.desc = *desc;
    p.rbf = m->rbf;
    memset(p.desc.background, 0, sizeof p.desc.background);
    return sup_extinction_scale(transfer, 48, 36, 2.3, draw_small, &p);
}

static int make_optics(const options *o, const model *m, const tetcast_rbf_render_desc *render, tetcast_optics **out,
                       tetcast_transfer **colours, double *extinction, sup_error *err) {
    const int from_file = sup_transfer_is_file(o->tf);
    tetcast_control_point *points;
    tetcast_isovalue iso;
    tetcast_transfer_desc desc;
    tetcast_optics_desc optics;
    tetcast_transfer *transfer = NULL;
    tetcast_result result;
    sup_transfer tf;
    if (from_file ? sup_transfer_read(o->tf, &tf, err)
                  : o->tf ? sup_transfer_named(o->tf, m->lo, m->hi, m->diagonal, &tf, err) : rare_transfer(m, &tf, err)) return 1;
    if (sup_control_points(&tf, &points, err)) {
        sup_transfer_free(&tf);
        return 1;
    }
    memset(&iso, 0, sizeof iso);
    iso.value = (float)o->iso;
    iso.rgb[0] = 0.85f;
    iso.rgb[1] = 0.45f;
    iso.rgb[2] = 0.12f;
    iso.opacity = (float)o->opacity;
    iso.specular = 0.25f;
    memset(&desc, 0, sizeof desc);
    memset(&optics, 0, sizeof optics);
    desc.env = render->env;
    sup_transfer_points(&tf, points, &desc);
    desc.isovalues = &iso;
    desc.isovalue_count = o->has_iso ? 1 : 0;
    optics.env = render->env;
    optics.model = (tetcast_model)o->model;
    optics.tolerance = o->common.has_tolerance ? (float)o->common.tolerance : 0.0f;
    optics.path_length = (float)m->diagonal;
    optics.ambient[0] = optics.ambient[1] = optics.ambient[2] = 0.1f;
    *extinction = o->scale;
    result = tetcast_transfer_create(&desc, &transfer);
    if (result == TETCAST_OK && !from_file && o->model != TETCAST_MODEL_ISOSURFACE && o->model != TETCAST_MODEL_MAXIMUM)
        *extinction *= choose_extinction(render, m, transfer);
    if (result == TETCAST_OK && *extinction != 1.0) {
        tetcast_transfer_destroy(transfer);
        desc.extinction_scale = (float)*extinction;
        result = tetcast_transfer_create(&desc, &transfer);
    }
    if (result == TETCAST_OK) result = tetcast_optics_create(transfer, &optics, out);
    *colours = transfer;
    SUP_FREE(points);
    sup_transfer_free(&tf);
    if (result == TETCAST_OK) return 0;
    return sup_fail_result(err, o->tf ? o->tf : "transfer function", result, render->env.error);
}

/* ---- pictures ------------------------------------------------------------------------------------------------ */

static int make_image(const options *o, tetcast_image *image) {
    const size_t pixels = (size_t)o->common.size[0] * o->common.size[1];
    memset(image, 0, sizeof *image);
    image->width = o->common.size[0];
    image->height = o->common.size[1];
    image->rgba = (float *)sup_alloc(pixels, 16);
    image->rgba8 = (uint8_t *)sup_alloc(pixels, 4);
    image->depth = (float *)sup_alloc(pixels, 4);
    return !image->rgba || !image->rgba8 || !image->depth;
}

static void rainbow(double x, float rgb[3]) {
    x = x < 0.0 ? 0.0 : x > 1.0 ? 1.0 : x;
    for (int c = 0; c < 3; c++) { /* blue, cyan, green, yellow, red */
        const double d = 1.5 - fabs(4.0 * x - (double)(3 - c));
        rgb[c] = (float)(d < 0.0 ? 0.0 : d > 1.0 ? 1.0 : d);
    }
}

static void to_bytes(tetcast_image *image) {
    for (size_t i = 0; i < (size_t)image->width * image->height; i++) {
        float *p = image->rgba + 4 * i, straight[4];
        const float a = p[3] > 1.0f ? 1.0f : p[3];
        for (int c = 0; c < 3; c++) straight[c] = a > 0.0f ? p[c] / a : p[c];
        straight[3] = a;
        for (int c = 0; c < 3; c++) {
            const float s = sup_srgb_from_linear(straight[c]);
            image->rgba8[4 * i + (size_t)c] = (uint8_t)((s < 0.0f ? 0.0f : s > 1.0f ? 1.0f : s) * 255.0f + 0.5f);
        }
        image->rgba8[4 * i + 3] = (uint8_t)(a * 255.0f + 0.5f);
    }
}

/* A plane through the box, seen along its axis, as large as it fits. */
static int draw_slice(const options *o, const model *m, const tetcast_env *env, tetcast_image *image, sup_error *err) {
    const int axis = o->slice[0] - 'x', u = axis == 0 ? 2 : 0, v = axis == 1 ? 2 : 1;
    const double at = atof(o->slice + 2), wide = m->info.box_max[u] - m->info.box_min[u], high = m->info.box_max[v] - m->info.box_min[v];
    const double pixel = fmax(wide / image->width, high / image->height);
    double *points = (double *)sup_alloc(image->width, 3 * sizeof *points);
    float *values = (float *)sup_alloc(image->width, sizeof *values);
    int failed = points && values ? 0 : sup_fail(err, "out of memory");
    for (uint32_t y = 0; y < image->height && !failed; y++) {
        for (uint32_t x = 0; x < image->width; x++) {
            double *p = points + 3 * x;
            p[axis] = m->info.box_min[axis] + at * (m->info.box_max[axis] - m->info.box_min[axis]);
            p[u] = 0.5 * (m->info.box_min[u] + m->info.box_max[u]) + ((double)x + 0.5 - 0.5 * image->width) * pixel;
            p[v] = 0.5 * (m->info.box_min[v] + m->info.box_max[v]) - ((double)y + 0.5 - 0.5 * image->height) * pixel;
        }
        failed = evaluate(o, m, env, points, image->width, values, err);
        for (uint32_t x = 0; x < image->width; x++) {
            float *rgba = image->rgba + 4 * ((size_t)y * image->width + x);
            const double *p = points + 3 * x;
            const int in = p[u] >= m->info.box_min[u] && p[u] <= m->info.box_max[u] && p[v] >= m->info.box_min[v] &&
                           p[v] <= m->info.box_max[v];
            memset(rgba, 0, 16);
            if (!in) continue;
            rainbow(((double)values[x] - m->lo) / (m->hi - m->lo), rgba);
            rgba[3] = 1.0f;
        }
    }
    if (!failed) to_bytes(image);
    SUP_FREE(points);
    SUP_FREE(values);
    return failed;
}

/* The part of --inside. */
static int open_inside(const options *o, const tetcast_env *env, tetcast_clip **out, sup_error *err) {
    sup_volume v;
    tetcast_mesh_desc desc;
    tetcast_field field;
    tetcast_mesh *mesh = NULL;
    tetcast_result result;
    float *made = NULL;
    char label[64];
    int failed;
    if (read_volume(o, o->inside, &v, err)) return 1;
    memset(&desc, 0, sizeof desc);
    desc.env = *env;
    failed = sup_choose_field(&v, NULL, o->inside, &field, &made, label, sizeof label, err);
    if (!failed) {
        result = sup_volume_mesh(&v, &field, &desc, NULL, &mesh);
        if (result == TETCAST_OK) result = sup_keep_inside(env, mesh, out);
        if (result != TETCAST_OK) failed = sup_fail_result(err, o->inside, result, env->error);
    }
    tetcast_mesh_destroy(mesh);
    SUP_FREE(made);
    sup_volume_free(&v);
    return failed;
}

static int render(const options *o, const tetcast_env *env, const model *m, sup_error *err) {
    tetcast_rbf_render_desc d;
    tetcast_rbf_render_stats stats;
    tetcast_optics *optics = NULL;
    tetcast_transfer *transfer = NULL;
    tetcast_clip *clip = NULL;
    tetcast_image image;
    tetcast_result result;
    sup_progress progress;
    sup_lit lit;
    double start, extinction = 1.0;
    int failed;
    memset(&d, 0, sizeof d);
    memset(&stats, 0, sizeof stats);
    d.env = *env;
    d.isa = (tetcast_isa)o->common.isa;
    d.channel = (tetcast_rbf_channel)o->channel;
    d.component = (uint32_t)o->component;
    d.gather = (uint32_t)o->gather;
    d.epsilon = (float)o->epsilon;
    d.step = o->samples ? (float)(m->diagonal / (double)o->samples) : 0.0f;
    if (o->has_background) {
        memcpy(d.background, o->background, sizeof o->background);
        d.background[3] = 1.0f;
    }
    (void)sup_volume_camera(&o->common, m->info.box_min, m->info.box_max, o->ortho, &d.camera);
    failed = make_image(o, &image) ? sup_fail(err, "out of memory for the picture") : 0;
    if (!failed && o->slice) failed = draw_slice(o, m, env, &image, err);
    else if (!failed) {
        failed = make_optics(o, m, &d, &optics, &transfer, &extinction, err);
        sup_lit_open(&lit, transfer, 4.0 * (m->hi - m->lo) / m->diagonal);
        if (o->shader == SUP_SHADER_LIT) d.shader = &lit.shader;
        if (!failed && o->has_cut) {
            result = sup_cut(env, o->cut_way, m->info.box_min, m->info.box_max, &clip);
            if (result != TETCAST_OK) failed = fail(o, env->error, result, err);
        }
        if (!failed && o->inside) failed = open_inside(o, env, &clip, err);
        d.clip = clip;
        sup_progress_begin(&progress, "drawing", o->common.quiet);
        if (!progress.quiet) {
            d.env.progress_fn = sup_progress_fn;
            d.env.progress_user = &progress;
        }
        start = sup_now();
        if (!failed) {
            result = tetcast_rbf_render(&d, m->rbf, optics, &image, &stats);
            if (result != TETCAST_OK) failed = fail(o, env->error, result, err);
        }
        start = sup_now() - start;
        sup_progress_end(&progress);
        if (!failed && o->common.stats) {
            printf("{\"program\":\"tetcast_rbf\",\"command\":\"render\",\"in\":");
            sup_json_string(stdout, o->in);
            printf(",\"width\":%u,\"height\":%u,\"functions\":%u,\"base\":[%u,%u,%u],\"cells\":%u,\"mean_list\":%.1f,\"file_bytes\":%llu,"
                   "\"memory_bytes\":%llu", image.width, image.height, m->info.function_count, m->info.base_dims[0], m->info.base_dims[1],
                   m->info.base_dims[2], m->info.cells, m->info.mean_list, (unsigned long long)m->info.file_bytes,
                   (unsigned long long)m->info.memory_bytes);
            printf(",\"step\":%.6g,\"rays\":%llu,\"hits\":%llu,\"samples\":%llu,\"evaluations\":%llu,\"pairs\":%llu,\"tests\":%llu",
                   (double)stats.step, (unsigned long long)stats.rays, (unsigned long long)stats.hit_rays,
                   (unsigned long long)stats.samples, (unsigned long long)stats.evaluations, (unsigned long long)stats.pairs,
                   (unsigned long long)stats.tests);
            printf(",\"extinction\":%.6g,\"seconds\":%.6f,\"evaluations_per_second\":%.4g,\"isa\":\"%s\",\"threads\":%d}\n", extinction,
                   start, start > 0.0 ? (double)stats.evaluations / start : 0.0, tetcast_isa_name(stats.isa),
                   sup_threads(o->common.threads));
        }
    }
    if (!failed) failed = sup_write_image(&o->common, &image, err);
    tetcast_optics_destroy(optics);
    tetcast_transfer_destroy(transfer);
    tetcast_clip_destroy(clip);
    SUP_FREE(image.rgba);
    SUP_FREE(image.rgba8);
    SUP_FREE(image.depth);
    return failed;
}

/* ---- traces -------------------------------------------------------------------------------------------------- */

/* Where a point is in the picture; 0: behind the eye. */
typedef struct eye { double at[3], forward[3], right[3], up[3], half; } eye;

static int project(const eye *e, const tetcast_image *image, const double p[3], double out[3]) {
    double x = 0.0, y = 0.0, z = 0.0, pixel;
    for (int k = 0; k < 3; k++) {
        x += (p[k] - e->at[k]) * e->right[k];
        y += (p[k] - e->at[k]) * e->up[k];
        z += (p[k] - e->at[k]) * e->forward[k];
    }
    if (!(z > 1e-9)) return 0;
    pixel = e->half * z / (0.5 * image->height);
    out[0] = 0.5 * image->width + x / pixel;
    out[1] = 0.5 * image->height - y / pixel;
    out[2] = z;
    return 1;
}

/* A line of one and a half pixels, nearer over farther. */
static void draw_line(const eye *e, tetcast_image *image, const double a[3], const double b[3], const float rgb[3], double width) {
    double p[3], q[3], length;
    int steps;
    if (!project(e, image, a, p) || !project(e, image, b, q)) return;
    length = hypot(q[0] - p[0], q[1] - p[1]);
    if (!(length < 1e5)) return;
    steps = 1 + (int)(2.0 * length);
    for (int i = 0; i <= steps; i++) {
        const double t = (double)i / steps, x = p[0] + t * (q[0] - p[0]), y = p[1] + t * (q[1] - p[1]), z = p[2] + t * (q[2] - p[2]);
        for (int dy = -2; dy <= 2; dy++)
            for (int dx = -2; dx <= 2; dx++) {
                const int px = (int)floor(x) + dx, py = (int)floor(y) + dy;
                const double d = hypot((double)px + 0.5 - x, (double)py + 0.5 - y), cover = fmin(1.0, width - d);
                float *rgba, *depth;
                if (px < 0 || py < 0 || px >= (int)image->width || py >= (int)image->height || !(cover > 0.0)) continue;
                rgba = image->rgba + 4 * ((size_t)py * image->width + (size_t)px);
                depth = image->depth + (size_t)py * image->width + (size_t)px;
                if (z > (double)*depth * 1.002 || cover <= (double)rgba[3] - (z < (double)*depth * 0.998 ? 1.0 : 0.0)) continue;
                for (int c = 0; c < 3; c++) rgba[c] = (float)(cover * (double)rgb[c] + (1.0 - cover) * (double)rgba[c]);
                rgba[3] = (float)(cover + (1.0 - cover) * (double)rgba[3]);
                *depth = (float)z;
            }
    }
}

static void draw_traces(const options *o, const model *m, const tetcast_camera *camera, const double *paths, const uint32_t *lengths,
                        tetcast_image *image) {
    const float gray[3] = {0.35f, 0.35f, 0.4f};
    tetcast_ray centre, beside, above;
    double corner[2][3], most = 1e-30;
    eye e;
    const size_t row = 3 * ((size_t)o->steps + 1);
    /* the frame of the camera from its rays */
    (void)tetcast_camera_ray(camera, image->width, image->height, 0.5 * image->width, 0.5 * image->height, &centre);
    (void)tetcast_camera_ray(camera, image->width, image->height, image->width, 0.5 * image->height, &beside);
    (void)tetcast_camera_ray(camera, image->width, image->height, 0.5 * image->width, 0.0, &above);
    memcpy(e.at, centre.org, sizeof e.at);
    memcpy(e.forward, centre.dir, sizeof e.forward);
    for (int i = 0; i < 2; i++) {
        const tetcast_ray *r = i ? &above : &beside;
        double *axis = i ? e.up : e.right, cosine = 0.0, length = 0.0;
        for (int k = 0; k < 3; k++) cosine += r->dir[k] * centre.dir[k];
        for (int k = 0; k < 3; k++) {
            axis[k] = r->dir[k] / cosine - centre.dir[k];
            length += axis[k] * axis[k];
        }
        length = sqrt(length);
        if (i) e.half = length;
        for (int k = 0; k < 3; k++) axis[k] /= length;
    }
    for (size_t i = 0; i < (size_t)image->width * image->height; i++) image->depth[i] = INFINITY;
    for (int i = 0; i < 12; i++) { /* edges of the box */
        const int axis = i / 4;
        for (int end = 0; end < 2; end++)
            for (int k = 0; k < 3; k++) {
                const int up = k == axis ? end : k == (axis + 1) % 3 ? i & 1 : i >> 1 & 1;
                corner[end][k] = up ? m->info.box_max[k] : m->info.box_min[k];
            }
        draw_line(&e, image, corner[0], corner[1], gray, 1.0);
    }
    for (int pass = 0; pass < 2; pass++)
        for (size_t i = 0; i < (size_t)o->seeds; i++)
            for (uint32_t s = 0; s + 1 < lengths[i]; s++) {
                const double *a = paths + i * row + 3 * (size_t)s, *b = a + 3;
                const double speed = sqrt((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]) + (b[2] - a[2]) * (b[2] - a[2]));
                float rgb[3];
                if (pass == 0) most = fmax(most, speed);
                rainbow(speed / most, rgb);
                if (pass == 1) draw_line(&e, image, a, b, rgb, 1.4);
            }
    to_bytes(image);
}

static int trace(const options *o, const tetcast_env *env, const model *m, sup_error *err) {
    const size_t count = (size_t)o->seeds;
    double *seeds = (double *)sup_alloc(count, 3 * sizeof *seeds), *paths = NULL, start;
    uint32_t *lengths = (uint32_t *)sup_alloc(count, sizeof *lengths), left = 0, h = (uint32_t)o->common.seed + 1;
    tetcast_trace_end *ends = (tetcast_trace_end *)sup_alloc(count, sizeof *ends);
    uint64_t moved = 0;
    tetcast_rbf_trace_desc d;
    tetcast_camera camera;
    tetcast_image image;
    tetcast_result result;
    size_t numbers = 0;
    int failed = 0;
    memset(&image, 0, sizeof image);
    memset(&camera, 0, sizeof camera);
    memset(&d, 0, sizeof d);
    if (!sup_mul_size(count, 3 * ((size_t)o->steps + 1), &numbers)) paths = (double *)sup_alloc(numbers, sizeof *paths);
    if (m->info.components != 3) failed = sup_fail(err, "%s: particles need three components", o->in);
    else if (!seeds || !paths || !lengths || !ends || make_image(o, &image)) failed = sup_fail(err, "out of memory");
    if (!failed) {
        for (size_t i = 0; i < 3 * count; i++) {
            h = h * 1664525u + 1013904223u;
            seeds[i] = m->info.box_min[i % 3] + (m->info.box_max[i % 3] - m->info.box_min[i % 3]) * ((double)(h >> 8) / 16777216.0);
        }
        memset(image.rgba, 0, (size_t)image.width * image.height * 16);
        d.env = *env;
        d.isa = (tetcast_isa)o->common.isa;
        d.stepper = (tetcast_stepper)o->stepper;
        d.tolerance = o->common.has_tolerance ? o->common.tolerance : 0.0;
        d.steps = (uint32_t)o->steps;
        d.dt = o->dt != 0.0 ? o->dt : m->diagonal / 200.0 / fmax(m->hi, 1e-30);
        start = sup_now();
        result = tetcast_rbf_trace(&d, m->rbf, seeds, count, paths, lengths, ends);
        start = sup_now() - start;
        if (result != TETCAST_OK) failed = fail(o, env->error, result, err);
        for (size_t i = 0; i < count && !failed; i++) {
            moved += lengths[i] - 1;
            left += ends[i] == TETCAST_TRACE_LEFT;
        }
        if (!failed) {
            (void)sup_volume_camera(&o->common, m->info.box_min, m->info.box_max, o->ortho, &camera);
            draw_traces(o, m, &camera, paths, lengths, &image);
            failed = sup_write_image(&o->common, &image, err);
        }
        if (!failed && o->common.stats) {
            printf("{\"program\":\"tetcast_rbf\",\"command\":\"trace\",\"in\":");
            sup_json_string(stdout, o->in);
            printf(",\"particles\":%llu,\"steps\":%llu,\"left\":%u,\"dt\":%.6g,\"stepper\":\"%s\",\"seconds\":%.6f,\"steps_per_second\":%.4g,"
                   "\"threads\":%d}\n", (unsigned long long)count, (unsigned long long)moved, left, d.dt,
                   o->stepper == 0 ? "rk4" : o->stepper == 1 ? "euler" : "dopri5",
                   start, start > 0.0 ? (double)moved / start : 0.0, sup_threads(o->common.threads));
        }
    }
    SUP_FREE(image.rgba);
    SUP_FREE(image.rgba8);
    SUP_FREE(image.depth);
    SUP_FREE(seeds);
    SUP_FREE(paths);
    SUP_FREE(lengths);
    SUP_FREE(ends);
    return failed;
}

int main(int argc, char **argv) {
    options o;
    tetcast_error error = {TETCAST_OK, 0, ""};
    tetcast_env env;
    model m;
    sup_error err;
    int status = parse(argc, argv, &o);
    if (status >= 0) return status;
    memset(&env, 0, sizeof env);
    memset(&m, 0, sizeof m);
    sup_error_clear(&err);
    env.thread_count = (uint32_t)o.common.threads;
    env.error = &error;
    if (o.command == COMMAND_FIT) status = fit(&o, &env, &err);
    else {
        status = open_model(&o, &env, &m, &err);
        if (!status) status = o.command == COMMAND_RENDER ? render(&o, &env, &m, &err)
            : o.command == COMMAND_TRACE ? trace(&o, &env, &m, &err) : decode(&o, &env, &m, &err);
        tetcast_rbf_destroy(m.rbf);
        SUP_FREE(m.value);
    }
    if (status) (void)sup_bad_input(argv[0], err.text);
    return status;
}
