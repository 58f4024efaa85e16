/* volume_look.h - what the programs for volumes have in common: a volume becomes a mesh, a transfer function fits its
   values, a camera frames it, a picture is written - MIT OR Unlicense, see LICENSE

   Include it after tetcast.h. */
#ifndef SUP_VOLUME_LOOK_H
#define SUP_VOLUME_LOOK_H
#ifndef TETCAST_VERSION_MAJOR
#error "include tetcast.h before this header"
#endif

#include "picture.h"
#include "transfer.h"
#include "volume.h"

/* --tf names a file, not one of SUP_TRANSFER_NAMES. */
SUP_FN int sup_transfer_is_file(const char *tf) { return tf && (strchr(tf, '.') || strchr(tf, '/')); }

/* Text of what the library refused. Returns 1. */
SUP_FN int sup_fail_result(sup_error *err, const char *what, tetcast_result result, const tetcast_error *error) {
    return sup_fail(err, "%s: %s", what, error && error->text[0] ? error->text : tetcast_result_string(result));
}

/* ---- volume -> mesh ----------------------------------------------------------------------------------------- */

/* The field that was asked for (NULL: the first) as one float per point or cell: a scalar, of a vector its length or
   NAME_x, NAME_y, NAME_z; x, y, z: the coordinates. label (room bytes): its name. *made: values that have to be freed.
   Returns 1 if there is no such field. */
SUP_FN int sup_choose_field(const sup_volume *v, const char *want, const char *in, tetcast_field *out, float **made,
                            char *label, size_t room, sup_error *err) {
    memset(out, 0, sizeof *out);
    *made = NULL;
    out->name = label;
    for (size_t i = 0; i < v->field_count; i++) {
        const sup_field *f = v->fields + i;
        const size_t length = strlen(f->name);
        int component = -1;
        if (want && strncmp(want, f->name, length) == 0 && want[length] == '_' && want[length + 1] >= 'x' &&
            want[length + 1] <= 'z' && want[length + 2] == '\0' && f->components > (uint32_t)(want[length + 1] - 'x'))
            component = want[length + 1] - 'x';
        else if (want && strcmp(want, f->name) != 0) continue;
        out->per_cell = (uint32_t)f->per_cell;
        out->values.data = f->values;
        out->values.stride = f->components * sizeof(float);
        (void)snprintf(label, room, "%s", want ? want : f->name);
        if (component >= 0) {
            out->values.data = f->values + component;
        } else if (f->components > 1) {
            float *length_of = (float *)sup_alloc(f->count, sizeof(float));
            if (!length_of) return sup_fail(err, "out of memory");
            for (size_t k = 0; k < f->count; k++) {
                double sum = 0.0;
                for (size_t c = 0; c < f->components; c++) {
                    const double x = (double)f->values[k * f->components + c];
                    sum += x * x;
                }
                length_of[k] = (float)sqrt(sum);
            }
            *made = length_of;
            out->values.data = length_of;
            out->values.stride = 0;
        }
        return 0;
    }
    if (want && want[0] >= 'x' && want[0] <= 'z' && want[1] == '\0' && v->points) {
        out->values.data = v->points + (want[0] - 'x');
        out->values.type = TETCAST_TYPE_F64;
        out->values.stride = 3 * sizeof(double);
        (void)snprintf(label, room, "%s", want);
        return 0;
    }
    if (!want) return sup_fail(err, "%s: there is no field in it; --field x, y or z shows coordinates", in);
    (void)sup_fail(err, "%s: there is no field \"%s\"; there are:", in, want);
    for (size_t i = 0; i < v->field_count; i++) {
        const size_t used = strlen(err->text);
        (void)snprintf(err->text + used, sizeof err->text - used, " %s", v->fields[i].name);
    }
    return 1;
}

/* A mesh of the cells or of the grid. */
SUP_FN tetcast_result sup_volume_mesh(const sup_volume *v, const tetcast_field *field, const tetcast_mesh_desc *desc,
                                      tetcast_report *report, tetcast_mesh **out) {
    tetcast_input input;
    if (v->dims[0]) {
        tetcast_grid grid;
        memset(&grid, 0, sizeof grid);
        memcpy(grid.dims, v->dims, sizeof grid.dims);
        grid.positions.data = v->points;
        grid.positions.type = TETCAST_TYPE_F64;
        for (int k = 0; k < 3; k++) {
            grid.axes[k].data = v->axes[k];
            grid.axes[k].type = TETCAST_TYPE_F64;
            grid.origin[k] = v->origin[k];
            grid.spacing[k] = v->spacing[k];
        }
        grid.blanks = v->blanks;
        grid.alternate = (uint32_t)v->five;
        grid.fields = field;
        grid.field_count = 1;
        return tetcast_mesh_create_grid(desc, &grid, report, out);
    }
    memset(&input, 0, sizeof input);
    input.positions.data = v->points;
    input.positions.type = TETCAST_TYPE_F64;
    input.vertex_count = v->point_count;
    input.indices = v->indices;
    input.index_count = v->index_count;
    input.shapes = v->shapes;
    input.cell_count = v->cell_count;
    input.masks = v->masks;
    input.fields = field;
    input.field_count = 1;
    return tetcast_mesh_create(desc, &input, report, out);
}

/* ---- colours ------------------------------------------------------------------------------------------------ */

/* Control points for the library, which sup_transfer_points hands to it. Returns 1: no memory. */
SUP_FN int sup_control_points(const sup_transfer *tf, tetcast_control_point **out, sup_error *err) {
    *out = (tetcast_control_point *)sup_alloc(tf->count, sizeof **out);
    if (!*out) return sup_fail(err, "out of memory");
    for (size_t i = 0; i < tf->count; i++) {
        (*out)[i].value = tf->points[i].value;
        memcpy((*out)[i].rgb, tf->points[i].rgb, sizeof (*out)[i].rgb);
        (*out)[i].extinction = tf->points[i].extinction;
    }
    return 0;
}

SUP_FN int sup_compare_floats(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

SUP_FN void sup_transfer_points(const sup_transfer *tf, const tetcast_control_point *points, tetcast_transfer_desc *desc) {
    if (tf->colors) {
        desc->color_points = points;
        desc->color_count = tf->colors;
        desc->extinction_points = points + tf->colors;
        desc->extinction_count = tf->count - tf->colors;
    } else {
        desc->points = points;
        desc->point_count = tf->count;
    }
}

enum { SUP_SHARE_BINS = 256 };
/* How much of a volume has values up to lo + (hi - lo) i / SUP_SHARE_BINS. */
typedef struct sup_shares {
    double lo, hi, total, below[SUP_SHARE_BINS + 1];
} sup_shares;

SUP_FN void sup_shares_add(sup_shares *s, double value, double amount) {
    const double at = (value - s->lo) / (s->hi - s->lo) * SUP_SHARE_BINS;
    if (at >= 0.0 && at < SUP_SHARE_BINS) s->below[1 + (int)at] += amount;
}

/* After the last sup_shares_add. total: of all that there is; 0: of what lies between lo and hi. */
SUP_FN void sup_shares_end(sup_shares *s, double total) {
    for (int i = 0; i < SUP_SHARE_BINS; i++) s->below[i + 1] += s->below[i];
    s->total = total > 0.0 ? total : s->below[SUP_SHARE_BINS] > 0.0 ? s->below[SUP_SHARE_BINS] : 1.0;
}

/* The rainbow, but what is common is thin and what is rare is dense: the air around a body hides nothing. */
SUP_FN int sup_rare_transfer(const sup_shares *s, double diagonal, sup_transfer *tf, sup_error *err) {
    enum { POINTS = 33 };
    sup_transfer rainbow;
    if (sup_transfer_named("rainbow", s->lo, s->hi, diagonal, &rainbow, err)) return 1;
    memset(tf, 0, sizeof *tf);
    for (size_t i = 0, k = 0; i < POINTS; i++) {
        const double v = s->lo + (s->hi - s->lo) * (double)i / (POINTS - 1);
        const size_t at = i * SUP_SHARE_BINS / (POINTS - 1);
        const double share = (s->below[at + 8 < SUP_SHARE_BINS ? at + 8 : SUP_SHARE_BINS] - s->below[at > 8 ? at - 8 : 0]) / s->total;
        const sup_control *p, *q;
        double number[5], x;
        while (k + 2 < rainbow.count && (double)rainbow.points[k + 1].value <= v) k++;
        p = rainbow.points + k;
        q = p + 1;
        x = (v - (double)p->value) / ((double)q->value - (double)p->value);
        number[0] = v;
        for (int c = 0; c < 3; c++) number[1 + c] = (double)p->rgb[c] + x * (double)(q->rgb[c] - p->rgb[c]);
        number[4] = ((double)p->extinction + x * (double)(q->extinction - p->extinction)) / pow(0.01 + share, 0.8);
        if (supi_transfer_add(tf, number)) {
            sup_transfer_free(&rainbow);
            sup_transfer_free(tf);
            return sup_fail(err, "out of memory");
        }
    }
    sup_transfer_free(&rainbow);
    return 0;
}

/* Draws a small picture; what it is of is known to ctx. */
typedef tetcast_result sup_draw_fn(void *ctx, const tetcast_optics *optics, const tetcast_image *image);

/* By what the extinctions of a named function have to be multiplied so that the thicker fifth of a small picture has
   that optical depth (2.3: a tenth of the light comes through): volumes are thin and thick, and fields have much of one
   value. */
SUP_FN double sup_extinction_scale(const tetcast_transfer *transfer, uint32_t width, uint32_t height, double want,
                                   sup_draw_fn *draw, void *ctx) {
    const size_t pixels = (size_t)width * height;
    float *rgba = (float *)sup_alloc(pixels, 4 * sizeof *rgba);
    tetcast_optics_desc absorb;
    tetcast_optics *optics = NULL;
    tetcast_image image;
    double scale = 1.0;
    size_t n = 0;
    memset(&image, 0, sizeof image);
    memset(&absorb, 0, sizeof absorb);
    image.width = width;
    image.height = height;
    image.rgba = rgba;
    absorb.model = TETCAST_MODEL_ABSORPTION;
    if (rgba && tetcast_optics_create(transfer, &absorb, &optics) == TETCAST_OK && draw(ctx, optics, &image) == TETCAST_OK) {
        for (size_t i = 0; i < pixels; i++) { /* depths take the place of pixels that have been read */
            const float a = rgba[4 * i + 3];
            if (a > 1e-4f) rgba[n++] = -logf(1.0f - (a < 0.999999f ? a : 0.999999f));
        }
        qsort(rgba, n, sizeof *rgba, sup_compare_floats);
        if (n > 0) scale = want / (double)rgba[n - 1 - n / 5];
    }
    tetcast_optics_destroy(optics);
    SUP_FREE(rgba);
    return scale < 1e-4 ? 1e-4 : scale > 1e4 ? 1e4 : scale;
}

/* ---- a shader of the programs' own, clipping ----------------------------------------------------------------- */

enum { SUP_SHADER_OPTICS, SUP_SHADER_LIT, SUP_SHADER_SHADOW };
#define SUP_SHADERS "optics|lit"
#define SUP_MESH_SHADERS SUP_SHADERS "|shadow"

/* The transfer function, lit where the gradient is strong. */
typedef struct sup_lit {
    const tetcast_transfer *transfer;
    float strong;           /* a gradient that counts as a surface */
    float wanted;           /* what it is set to */
    tetcast_param param;
    tetcast_shader shader;
} sup_lit;

SUP_FN tetcast_result sup_lit_prepare(void *user, const tetcast_param *params, size_t count, tetcast_error *error) {
    const float *strong = tetcast_params_find(params, count, "strong", 1, error);
    if (!strong) return TETCAST_ERR_INVALID_ARG;
    ((sup_lit *)user)->strong = strong[0];
    return TETCAST_OK;
}

SUP_FN void sup_lit_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    const sup_lit *l = (const sup_lit *)user;
    for (int i = 0; i < 8; i++) {
        float c[4], g = 0.0f, facing = 0.0f, light, a;
        if (!(in->mask >> i & 1u)) continue;
        tetcast_transfer_eval(l->transfer, 0.5f * (in->front[i] + in->back[i]), c);
        for (int k = 0; k < 3; k++) {
            g += in->gradient[k][i] * in->gradient[k][i];
            facing += in->gradient[k][i] * in->direction[k][i];
        }
        g = sqrtf(g);
        light = g > 0.0f ? fabsf(facing) / g : 1.0f;
        g = g < l->strong ? g / l->strong : 1.0f;
        light = 0.15f + 0.85f * (1.0f - g + g * light);
        a = 1.0f - expf(-c[3] * (0.1f + 0.9f * g) * in->length[i]);
        for (int k = 0; k < 3; k++) rgba[k][i] = a * light * c[k];
        rgba[3][i] = a;
    }
}

SUP_FN int sup_lit_empty(void *user, float lo, float hi) {
    return tetcast_transfer_is_empty(((const sup_lit *)user)->transfer, lo, hi);
}

SUP_FN void sup_lit_open(sup_lit *l, const tetcast_transfer *transfer, double strong) {
    memset(l, 0, sizeof *l);
    l->transfer = transfer;
    l->wanted = (float)strong;
    l->param.name = "strong";
    l->param.values = &l->wanted;
    l->param.count = 1;
    l->shader.user = l;
    l->shader.needs = TETCAST_NEED_GRADIENT | TETCAST_NEED_DIRECTION;
    l->shader.params = &l->param;
    l->shader.param_count = 1;
    l->shader.prepare_fn = sup_lit_prepare;
    l->shader.shade_fn = sup_lit_shade;
    l->shader.empty_fn = sup_lit_empty;
}

/* Single scattering: what a particle sends to the eye is what reaches it of a light far away, weakened on its way
   through the volume, and of light from everywhere. One ray a segment: some hundred times the time. */
typedef struct sup_shadow {
    const tetcast_mesh *mesh;
    const tetcast_optics *optics;
    tetcast_optics *absorb;
    double to_light[3];
    float ambient;          /* share of the light that comes from everywhere */
    tetcast_shader shader;
} sup_shadow;

typedef struct sup_shadow_ray {
    const tetcast_optics *absorb;
    tetcast_segment segment[16];
    size_t count;
    float passes;
} sup_shadow_ray;

SUP_FN void sup_shadow_flush(sup_shadow_ray *r) {
    float c[16][4];
    if (tetcast_optics_segments(r->absorb, r->segment, r->count, TETCAST_ISA_AUTO, c) != TETCAST_OK) r->count = 0;
    for (size_t i = 0; i < r->count; i++) r->passes *= 1.0f - c[i][3];
    r->count = 0;
}

SUP_FN int sup_shadow_crossing(void *user, const tetcast_crossing *x) {
    sup_shadow_ray *r = (sup_shadow_ray *)user;
    tetcast_segment *s = &r->segment[r->count++];
    s->front = x->front;
    s->back = x->back;
    s->length = (float)(x->t_back - x->t_front);
    s->depth = 0.0f;
    if (r->count == 16) sup_shadow_flush(r);
    return r->passes < 1.0f / 1024.0f;
}

SUP_FN void sup_shadow_shade(void *user, const tetcast_packet *in, float rgba[4][8]) {
    const sup_shadow *s = (const sup_shadow *)user;
    for (int i = 0; i < 8; i++) {
        tetcast_segment segment;
        tetcast_ray ray;
        sup_shadow_ray shadow;
        float c[1][4], light = 1.0f;
        if (!(in->mask >> i & 1u)) continue;
        segment.front = in->front[i];
        segment.back = in->back[i];
        segment.length = in->length[i];
        segment.depth = 0.0f;
        if (tetcast_optics_segments(s->optics, &segment, 1, TETCAST_ISA_AUTO, c) != TETCAST_OK) memset(c, 0, sizeof c);
        if (c[0][0] > 0.0f || c[0][1] > 0.0f || c[0][2] > 0.0f) {
            memset(&ray, 0, sizeof ray);
            for (int k = 0; k < 3; k++) {
                ray.org[k] = (double)in->position[k][i];
                ray.dir[k] = s->to_light[k];
            }
            shadow.absorb = s->absorb;
            shadow.count = 0;
            shadow.passes = 1.0f;
            (void)tetcast_probe(s->mesh, &ray, sup_shadow_crossing, &shadow);
            sup_shadow_flush(&shadow);
            light = s->ambient + (1.0f - s->ambient) * shadow.passes;
        }
        for (int k = 0; k < 3; k++) rgba[k][i] = c[0][k] * light;
        rgba[3][i] = c[0][3];
    }
}

/* All but s has to stay there while it is used. Close it in any case. */
SUP_FN tetcast_result sup_shadow_open(sup_shadow *s, const tetcast_mesh *mesh, const tetcast_transfer *transfer,
                                      const tetcast_optics *optics, const float to_light[3], float ambient) {
    tetcast_optics_desc desc;
    memset(s, 0, sizeof *s);
    memset(&desc, 0, sizeof desc);
    desc.model = TETCAST_MODEL_ABSORPTION;
    s->mesh = mesh;
    s->optics = optics;
    for (int k = 0; k < 3; k++) s->to_light[k] = (double)to_light[k];
    s->ambient = ambient;
    s->shader.user = s;
    s->shader.needs = TETCAST_NEED_POSITION;
    s->shader.shade_fn = sup_shadow_shade;
    return tetcast_optics_create(transfer, &desc, &s->absorb);
}
SUP_FN void sup_shadow_close(sup_shadow *s) { tetcast_optics_destroy(s->absorb); }

/* --cut: what lies this way from the middle of the box is kept. */
SUP_FN tetcast_result sup_cut(const tetcast_env *env, const float way[3], const double lo[3], const double hi[3],
                              tetcast_clip **out) {
    tetcast_clip_plane plane;
    tetcast_clip_desc desc;
    memset(&desc, 0, sizeof desc);
    memset(&plane, 0, sizeof plane);
    for (int k = 0; k < 3; k++) {
        plane.normal[k] = (double)way[k];
        plane.offset += plane.normal[k] * (lo[k] + 0.5 * (hi[k] - lo[k]));
    }
    desc.env = *env;
    desc.planes = &plane;
    desc.plane_count = 1;
    return tetcast_clip_create(&desc, out);
}

/* --inside: what lies within a mesh is kept. */
SUP_FN tetcast_result sup_keep_inside(const tetcast_env *env, const tetcast_mesh *mesh, tetcast_clip **out) {
    tetcast_mesh_info info;
    tetcast_clip_body body;
    tetcast_clip_desc desc;
    tetcast_result result = TETCAST_ERR_NO_MEMORY;
    double (*points)[3];
    uint32_t *indices;
    tetcast_mesh_get_info(mesh, &info);
    points = (double (*)[3])sup_alloc((size_t)info.vertex_count, sizeof *points);
    indices = (uint32_t *)sup_alloc((size_t)info.hull_face_count, 3 * sizeof *indices);
    if (points && indices) {
        for (uint32_t i = 0; i < info.vertex_count; i++) tetcast_mesh_vertex(mesh, i, points[i], NULL, NULL);
        for (uint32_t i = 0; i < info.hull_face_count; i++) tetcast_mesh_hull_face(mesh, i, indices + 3 * (size_t)i);
        memset(&desc, 0, sizeof desc);
        memset(&body, 0, sizeof body);
        body.points = (const double (*)[3])points;
        body.point_count = (size_t)info.vertex_count;
        body.indices = indices;
        body.triangle_count = (size_t)info.hull_face_count;
        desc.env = *env;
        desc.bodies = &body;
        desc.body_count = 1;
        result = tetcast_clip_create(&desc, out);
    }
    SUP_FREE(points);
    SUP_FREE(indices);
    return result;
}

/* ---- camera and picture ------------------------------------------------------------------------------------- */

SUP_FN double sup_box_diagonal(const double lo[3], const double hi[3]) {
    double sum = 0.0;
    for (int k = 0; k < 3; k++) sum += (hi[k] - lo[k]) * (hi[k] - lo[k]);
    sum = sqrt(sum);
    return sum > 0.0 ? sum : 1.0;
}

/* The camera of the common options; without one it frames the box. ortho > 0: parallel rays, height of the picture.
   Returns 1 if the box was framed. */
SUP_FN int sup_volume_camera(const sup_common *common, const double lo[3], const double hi[3], double ortho,
                             tetcast_camera *camera) {
    sup_camera framed;
    float flo[3], fhi[3];
    if (!common->has_eye && !common->has_at) { /* as large as it fits */
        tetcast_result result;
        for (int k = 0; k < 3; k++) camera->up[k] = common->has_up ? (double)common->camera.up[k] : k == 1;
        camera->fov_y = (float)common->fov;
        camera->ortho_height = (float)ortho;
        result = tetcast_camera_fit(camera, lo, hi, NULL, common->size[0], common->size[1]);
        camera->ortho_height = (float)ortho;
        if (result == TETCAST_OK) return 1;
    }
    for (int k = 0; k < 3; k++) {
        flo[k] = (float)lo[k];
        fhi[k] = (float)hi[k];
    }
    sup_common_camera(common, flo, fhi, &framed);
    for (int k = 0; k < 3; k++) {
        camera->eye[k] = (double)framed.eye[k];
        camera->at[k] = (double)framed.at[k];
        camera->up[k] = (double)framed.up[k];
    }
    camera->fov_y = framed.fov;
    camera->ortho_height = (float)ortho;
    return 0;
}

/* --depth and --out. rgba is used up by a .pfm. */
SUP_FN int sup_write_image(const sup_common *common, tetcast_image *image, sup_error *err) {
    return sup_out_write(common, image->rgba8, image->rgba, image->depth, image->width, image->height, err);
}

#endif
