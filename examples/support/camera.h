/* camera.h - camera of the example programs, how it frames an object, and the options that all programs share
   SPDX-License-Identifier: MIT OR Unlicense

   Right-handed, y up unless told otherwise; fov is the vertical angle; the ray of pixel (i, j) goes through its
   centre (i + 0.5, j + 0.5), row 0 on top.

       sup_common common;
       sup_option options[SUP_COMMON_OPTIONS + 2];
       size_t n = sup_common_options(&common, options);
       options[n++] = sup_opt_positional("IN.obj", &in, 1, "mesh to show");
       status = sup_cli_parse(argc, argv, "Shows a mesh.", options, n);
       ...
       sup_common_camera(&common, lo, hi, &camera); */
#ifndef SUP_CAMERA_H
#define SUP_CAMERA_H

#include "base.h"
#include "cli.h"

typedef struct sup_camera {
    float eye[3], at[3], up[3]; /* up need not be a unit vector nor square to the view */
    float fov;                  /* vertical, degrees */
} sup_camera;

/* Unit vectors of a camera: where it looks, to the right in the picture, up in the picture. */
typedef struct sup_view {
    double forward[3], right[3], up[3];
    double tangent; /* of half the vertical angle */
} sup_view;

SUP_FN double supi_dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

SUP_FN void supi_cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Make `v` a unit vector; returns 1 and leaves it when it has no usable length. */
SUP_FN int supi_unit(double *v) {
    const double length = sqrt(supi_dot(v, v));
    int k;
    if (!(length > 1e-30) || !(length <= DBL_MAX)) return 1;
    for (k = 0; k < 3; k++) v[k] /= length;
    return 0;
}

/* Unit vectors that go with a direction and an up vector. Any input gives a right-handed, square frame: where up says
   nothing (zero, or along the view), the axis farthest from the view takes its place. */
SUP_FN void supi_frame(const double direction[3], const double up[3], double forward[3], double right[3],
                       double above[3]) {
    int k, axis = 0;
    for (k = 0; k < 3; k++) forward[k] = direction[k];
    if (supi_unit(forward)) {
        forward[0] = forward[1] = 0.0;
        forward[2] = -1.0;
    }
    for (k = 0; k < 3; k++) above[k] = up[k];
    if (!supi_unit(above)) {
        supi_cross(forward, above, right);
        if (supi_dot(right, right) > 1e-12 && !supi_unit(right)) {
            supi_cross(right, forward, above);
            return;
        }
    }
    for (k = 1; k < 3; k++) {
        if (fabs(forward[k]) < fabs(forward[axis])) axis = k;
    }
    for (k = 0; k < 3; k++) above[k] = k == axis ? 1.0 : 0.0;
    supi_cross(forward, above, right);
    (void)supi_unit(right);
    supi_cross(right, forward, above);
}

/* The unit vectors of a camera; always valid, whatever the camera holds. */
SUP_FN void sup_camera_view(const sup_camera *camera, sup_view *out) {
    double direction[3], up[3];
    int k;
    for (k = 0; k < 3; k++) {
        direction[k] = (double)camera->at[k] - (double)camera->eye[k];
        up[k] = (double)camera->up[k];
    }
    supi_frame(direction, up, out->forward, out->right, out->up);
    out->tangent = tan((double)camera->fov * (3.14159265358979323846 / 360.0));
}

/* The ray through the point (x, y) of a picture of width * height pixels; pixel centres are at i + 0.5.
   org, dir   out, [3]; dir reaches from the eye to the plane at distance 1: depth along the viewing axis is t itself */
SUP_FN void sup_camera_ray(const sup_camera *camera, const sup_view *view, uint32_t width, uint32_t height, double x,
                           double y, float org[3], float dir[3]) {
    const double a = (2.0 * x - (double)width) / (double)height * view->tangent;
    const double b = (1.0 - 2.0 * y / (double)height) * view->tangent;
    int k;
    for (k = 0; k < 3; k++) {
        org[k] = camera->eye[k];
        dir[k] = (float)(view->forward[k] + a * view->right[k] + b * view->up[k]);
    }
}

/* Place the eye so that the whole box lo..hi is in a picture of the given aspect (width / height): a three-quarter
   view, slightly from above. Uses camera->up and camera->fov; sets eye and at. An empty or infinite box counts as a
   unit box. */
SUP_FN void sup_camera_frame(sup_camera *camera, const float lo[3], const float hi[3], double aspect) {
    static const double sideways[3] = {1.0, 0.0, 0.0}, upwards[3] = {0.0, 1.0, 0.0};
    double low[3], high[3], centre[3], up[3], side[3], front[3], direction[3], back[3], view[3], right[3], above[3];
    double distance = 0.0, size = 0.0, tangent[2];
    int k, corner, bad = 0;
    for (k = 0; k < 3; k++) {
        low[k] = (double)lo[k];
        high[k] = (double)hi[k];
        bad |= !(high[k] >= low[k]) || !(fabs(low[k]) <= (double)FLT_MAX && fabs(high[k]) <= (double)FLT_MAX);
    }
    for (k = 0; k < 3; k++) {
        if (bad) {
            low[k] = -0.5;
            high[k] = 0.5;
        }
        centre[k] = 0.5 * (low[k] + high[k]);
        size = high[k] - low[k] > size ? high[k] - low[k] : size;
        up[k] = (double)camera->up[k];
    }
    if (!(size > 0.0)) size = 1.0;
    /* With y up the eye is in front (+z), to the right and above; with z up in front means -y. */
    if (supi_unit(up)) memcpy(up, upwards, sizeof up);
    supi_cross(sideways, up, front);
    if (supi_dot(front, front) < 1e-3) supi_cross(upwards, up, front);
    (void)supi_unit(front);
    supi_cross(up, front, side);
    for (k = 0; k < 3; k++) {
        direction[k] = 0.6 * side[k] + 0.42 * up[k] + front[k];
        back[k] = 0.0;
    }
    (void)supi_unit(direction);
    for (k = 0; k < 3; k++) back[k] = -direction[k];
    supi_frame(back, up, view, right, above);
    tangent[1] = tan((double)camera->fov * (3.14159265358979323846 / 360.0));
    if (!(tangent[1] > 1e-6)) tangent[1] = 1e-6;
    tangent[0] = tangent[1] * (aspect > 1e-6 ? aspect : 1.0);
    for (corner = 0; corner < 8; corner++) {
        double p[3], x, y, need;
        for (k = 0; k < 3; k++) p[k] = ((corner >> k) & 1 ? high[k] : low[k]) - centre[k];
        x = fabs(supi_dot(p, right)) / tangent[0];
        y = fabs(supi_dot(p, above)) / tangent[1];
        need = supi_dot(p, direction) + (x > y ? x : y);
        distance = need > distance ? need : distance;
    }
    distance = 1.04 * distance + 0.01 * size; /* a margin, and never inside of a flat box */
    for (k = 0; k < 3; k++) {
        camera->at[k] = sup_to_float(centre[k]);
        camera->eye[k] = sup_to_float(centre[k] + distance * direction[k]);
    }
}

/* ---- options that all programs share ------------------------------------------------------------------------ */

enum { SUP_ISA_AUTO = 0, SUP_ISA_SCALAR, SUP_ISA_SSE, SUP_ISA_AVX2, SUP_ISA_AVX512 };
enum { SUP_COMMON_OPTIONS = 14 };

typedef struct sup_common {
    sup_camera camera;
    int has_eye, has_at, has_up, has_fov, has_size, has_tolerance, has_seed;
    const char *out;   /* NULL: not given */
    const char *depth; /* NULL: not given */
    uint32_t size[2];
    double fov;      /* vertical, degrees; sup_common_camera puts it into the camera */
    int64_t threads; /* 0: one per core */
    int64_t seed;
    double tolerance;
    int isa; /* SUP_ISA_ */
    int stats, quiet, unlit;
} sup_common;

/* Fill `common` with defaults (1312x640, 40 degrees, y up, tolerance 0.5) and write the options that all programs share
   into `options`, which has room for SUP_COMMON_OPTIONS; returns how many. A program may change the defaults between
   this call and sup_cli_parse. */
SUP_FN size_t sup_common_options(sup_common *common, sup_option *options) {
    size_t n = 0;
    memset(common, 0, sizeof *common);
    common->camera.up[1] = 1.0f;
    common->fov = 40.0;
    common->size[0] = 1312;
    common->size[1] = 640;
    common->tolerance = 0.5;
    options[n++] = sup_opt_text("out", &common->out, "FILE", "picture to write: .png (sRGB) or .pfm (linear)");
    options[n++] = sup_opt_text("depth", &common->depth, "FILE.pfm", "distances along the viewing axis");
    options[n++] = sup_opt_given(sup_opt_size("size", common->size, "pixels of the picture"), &common->has_size);
    options[n++] = sup_opt_given(
        sup_opt_vec3("eye", common->camera.eye, "where the camera is; without it the object is framed"),
        &common->has_eye);
    options[n++] = sup_opt_given(sup_opt_vec3("at", common->camera.at, "where it looks"), &common->has_at);
    options[n++] = sup_opt_given(sup_opt_vec3("up", common->camera.up, "what is up (0,1,0)"), &common->has_up);
    options[n++] = sup_opt_given(
        sup_opt_real("fov", &common->fov, 0.01, 179.0, "DEG", "vertical angle of view, degrees (40)"), &common->has_fov);
    options[n++] = sup_opt_int("threads", &common->threads, 0, 1024, "N",
                               "threads, 0: one per core; the picture is the same");
    options[n++] = sup_opt_given(sup_opt_int("seed", &common->seed, 0, INT64_C(4294967295), "N", "random seed"),
                                 &common->has_seed);
    options[n++] = sup_opt_given(
        sup_opt_real("tolerance", &common->tolerance, 0.0, 1e9, "E", "how wrong the picture may be"),
        &common->has_tolerance);
    options[n++] = sup_opt_choice("isa", &common->isa, "auto|scalar|sse|avx2|avx512",
                                  "instructions to use; the picture is the same");
    options[n++] = sup_opt_flag("stats", &common->stats, "one JSON object on stdout");
    options[n++] = sup_opt_flag("quiet", &common->quiet, "no progress");
    options[n++] = sup_opt_flag("unlit", &common->unlit, "plain surface colours");
    return n;
}

/* What one of n options means to a program, where that is not what it means to most. */
SUP_FN void sup_option_help(sup_option *options, size_t n, const char *name, const char *help) {
    size_t i;
    for (i = 0; i < n; i++)
        if (strcmp(options[i].name, name) == 0) options[i].help = help;
}

/* The camera for an object in the box lo..hi: by --eye, --at, --up, --fov; what is not given frames the box. */
SUP_FN void sup_common_camera(const sup_common *common, const float lo[3], const float hi[3], sup_camera *out) {
    sup_camera framed = common->camera;
    int k;
    framed.fov = (float)common->fov;
    *out = framed;
    sup_camera_frame(&framed, lo, hi, (double)common->size[0] / (double)common->size[1]);
    for (k = 0; k < 3; k++) {
        if (!common->has_at) out->at[k] = framed.at[k];
        /* Looking at another point: keep direction and distance. */
        if (!common->has_eye)
            out->eye[k] = framed.eye[k] + (common->has_at ? common->camera.at[k] - framed.at[k] : 0.0f);
    }
}

#endif
