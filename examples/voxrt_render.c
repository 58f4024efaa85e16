/* voxrt_render.c - voxel file -> picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/picture.h"
#ifndef _WIN32
#include <sys/resource.h>
#endif
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"
#include "support/voxel_file.h"

enum { MAX_LIGHTS = 64 };
enum { PATH_FAST, PATH_THESIS };

typedef struct render_options {
    sup_common common;
    const char *in, *light, *lod;
    int shadows, path, heat, has_heat, has_heat_max, split, normals, cubes, compose, one_sided, blend, has_background;
    int64_t samples, lod_split, scatter, frames, bounces, memory;
    int finer;
    double blur, heat_max, budget;
    int has_blur, smooth, has_material, panorama;
    double diffuse, specular, shininess;
    float background[3];
    voxrt_light lights[MAX_LIGHTS];
    size_t light_count;
} render_options;

typedef struct scene { /* what is to be drawn, and what the file held */
    voxrt_tree *tree;
    voxrt_paged *paged; /* instead of it */
    voxrt_octree *octree;
    voxrt_geometry geometry;
    voxrt_instance *instances; /* --scatter: copies of the tree, and all of them as one */
    voxrt_group *group;
    voxrt_material material;
    voxrt_states states; /* of a panorama, with the camera and its axes */
    sup_camera camera;
    sup_view axes;
    double size[2];
} scene;

/* "[dir:]x,y,z[:r,g,b]"; returns 1 if it is not that. */
static int parse_light(const char *text, voxrt_light *light) {
    char part[2][64];
    const char *colon;
    size_t n;
    memset(light, 0, sizeof *light);
    if (strncmp(text, "dir:", 4) == 0) {
        light->directional = 1;
        text += 4;
    }
    colon = strchr(text, ':');
    n = colon != NULL ? (size_t)(colon - text) : strlen(text);
    if (n >= sizeof part[0] || (colon != NULL && strlen(colon + 1) >= sizeof part[1])) return 1;
    memcpy(part[0], text, n);
    part[0][n] = '\0';
    (void)snprintf(part[1], sizeof part[1], "%s", colon != NULL ? colon + 1 : "1,1,1");
    return sup_parse_vec3(part[0], light->position) || sup_parse_vec3(part[1], light->color);
}

/* --light may be given several times; the table keeps only the last. */
static int collect_lights(int argc, char **argv, render_options *o) {
    for (int i = 1; i < argc && strcmp(argv[i], "--") != 0; i++) {
        const char *value = strcmp(argv[i], "--light") == 0 && i + 1 < argc ? argv[++i] :
                            strncmp(argv[i], "--light=", 8) == 0 ? argv[i] + 8 : NULL;
        if (value == NULL) continue;
        if (o->light_count == MAX_LIGHTS)
            return sup_bad_usage(argv[0], "--light: more than %d lights", (int)MAX_LIGHTS);
        if (parse_light(value, &o->lights[o->light_count]))
            return sup_bad_usage(argv[0], "--light: \"%s\" is not [dir:]x,y,z[:r,g,b]", value);
        o->light_count++;
    }
    return -1;
}

/* Writes the options into a table of room for all, and what they are if nobody says so; returns how many there are. */
static size_t option_table(render_options *o, sup_option *table) {
    size_t n = sup_common_options(&o->common, table);
    sup_option_help(table, n, "size", "pixels of the picture (1312x640)");
    sup_option_help(table, n, "seed", "changes nothing: no ray is random");
    sup_option_help(table, n, "tolerance", "how wide a voxel may be, in pixels (0.5; with --lod object 1)");
    sup_option_help(table, n, "quiet", "no progress and no warnings");
    o->samples = 1;
    o->frames = 1;
    o->bounces = 8;
    o->memory = 1024;
    o->blur = 4.0;
    o->heat_max = 64.0;
    o->lod_split = -1;
    o->diffuse = 1.0;
    o->shininess = 32.0;
    table[n++] = sup_opt_positional("IN.vox", &o->in, 1, "voxel file, format 5 or 4");
    table[n++] = sup_opt_text("light", &o->light, "[dir:]x,y,z[:r,g,b]",
                              "a point light, or the direction towards a distant one; may be repeated");
    table[n++] = sup_opt_flag("shadows", &o->shadows, "trace shadow rays");
    table[n++] = sup_opt_given(sup_opt_real("diffuse", &o->diffuse, 0.0, 1e6, "D",
                                            "how much of the light the colours send back (1; thesis 0.5)"), &o->has_material);
    table[n++] = sup_opt_given(sup_opt_real("specular", &o->specular, 0.0, 1e6, "S", "how bright highlights are (0)"),
                               &o->has_material);
    table[n++] = sup_opt_given(sup_opt_real("shininess", &o->shininess, 1.0, 1e6, "N", "how small they are (32)"),
                               &o->has_material);
    table[n++] = sup_opt_int("bounces", &o->bounces, 0, 32, "N", "how often a ray goes on in mirrors and glass (8); 0: these are opaque");
    table[n++] = sup_opt_flag("panorama", &o->panorama, "all directions from the eye, 360 by 180 degrees");
    table[n++] = sup_opt_int("aa", &o->samples, 1, 65536, "N", "rays per pixel (1)");
    table[n++] = sup_opt_text("lod", &o->lod, "off|object|LEVEL",
                              "level of detail: full; one level for all by --tolerance; octree level LEVEL (0: one "
                              "cube). Without it each pixel stops at cells of --tolerance pixels");
    table[n++] = sup_opt_int("lod-split", &o->lod_split, 0, VOXRT_MAX_DEPTH, "LEVEL",
                             "left half of the picture at this octree level");
    table[n++] = sup_opt_choice("path", &o->path, "fast|thesis", "wide tree, or the octree of 2009");
    table[n++] = sup_opt_given(sup_opt_choice("heat", &o->heat, "outer|inner", "cells left, or nodes entered, per ray"),
                               &o->has_heat);
    table[n++] = sup_opt_given(sup_opt_real("heat-max", &o->heat_max, 1.0, 1e6, "N", "cells that are fully red (64)"),
                               &o->has_heat_max);
    table[n++] = sup_opt_flag("split", &o->split, "left third colours, middle the picture, right third brightness");
    table[n++] =
        sup_opt_choice("normals", &o->normals, "stored|face", "shade by stored normals or by the faces of the cubes");
    table[n++] = sup_opt_int("scatter", &o->scatter, 0, 100000000, "N", "N copies of it, turned and of different sizes, on the ground");
    table[n++] = sup_opt_int("frames", &o->frames, 1, 1000000, "N", "N pictures, once around --at; FILE of --out has a %d for the number");
    table[n++] = sup_opt_real("budget", &o->budget, 0.0, 1e6, "MS", "time for each of --frames: detail is lowered first where it shows least");
    table[n++] = sup_opt_int("memory", &o->memory, 1, 1048576, "MIB", "of a file in pages (voxrt_convert --paged): for what is loaded (1024)");
    table[n++] = sup_opt_flag("finer", &o->finer, "of a file in pages: up to --frames pictures from one place, with what is loaded so far, until "
                              "nothing is missing; the last one waits for what is");
    table[n++] = sup_opt_flag("blend", &o->blend, "colours and normals go over from one level of detail to the next: no popping in motion");
    table[n++] = sup_opt_flag("cubes", &o->cubes, "voxels with planes (voxrt_convert --planes) as cubes");
    table[n++] = sup_opt_flag("one-sided", &o->one_sided, "surfaces seen from behind stay dark instead of turning their normals");
    table[n++] = sup_opt_choice("compose", &o->compose, "linear|thesis", "linear light, or bytes times brightness");
    table[n++] = sup_opt_given(sup_opt_vec3("background", o->background, "linear r,g,b instead of transparent"),
                               &o->has_background);
    table[n++] = sup_opt_given(
        sup_opt_real("blur", &o->blur, 0.1, 64.0, "R", "Gauss over the finished picture, radius in pixels"),
        &o->has_blur);
    table[n++] =
        sup_opt_flag("smooth", &o->smooth, "with --blur: only where voxels are larger than pixels, not over edges");
    return n;
}

/* Options that are nothing without another one, or exclude each other. Returns what parse returns. */
static int check_options(const char *program, const render_options *o) {
    if (o->common.unlit + o->split + o->has_heat > 1)
        return sup_bad_usage(program, "--unlit, --split and --heat are three different pictures");
    if (o->panorama && !o->common.has_eye) return sup_bad_usage(program, "--panorama goes with --eye");
    if (o->has_heat_max && !o->has_heat) return sup_bad_usage(program, "--heat-max goes with --heat");
    if (o->smooth && o->path == PATH_THESIS) return sup_bad_usage(program, "--smooth goes with --path fast");
    if (o->budget > 0.0 && (o->frames < 2 || o->path == PATH_THESIS || o->has_blur))
        return sup_bad_usage(program, "--budget goes with --frames, and neither with --path thesis nor with --blur");
    if (o->scatter != 0 && (o->path == PATH_THESIS || o->smooth))
        return sup_bad_usage(program, "--scatter goes neither with --path thesis nor with --smooth");
    if (o->smooth && !o->has_blur) return sup_bad_usage(program, "--smooth goes with --blur");
    return -1;
}

/* What the options say, into desc; --lod is still to come. */
static void describe(const render_options *o, voxrt_render_desc *desc) {
    memset(desc, 0, sizeof *desc);
    desc->isa = (voxrt_isa)o->common.isa;
    desc->env.thread_count = (uint32_t)o->common.threads;
    desc->lights = o->light_count != 0 ? o->lights : NULL;
    desc->light_count = o->light_count;
    desc->shadows = (uint32_t)o->shadows;
    desc->samples = (uint32_t)o->samples;
    desc->bounces_plus_1 = (uint32_t)o->bounces + 1;
    desc->tolerance = (float)o->common.tolerance;
    desc->face_normals = o->normals == 1;
    desc->cubes = (uint32_t)o->cubes;
    desc->blend = (uint32_t)o->blend;
    desc->one_sided = (uint32_t)o->one_sided;
    desc->thesis_compose = o->compose == 1;
    desc->heat_max = (float)o->heat_max;
    desc->lod_split = (uint32_t)(o->lod_split + 1);
    if (o->has_background) {
        memcpy(desc->background, o->background, sizeof o->background);
        desc->background[3] = 1.0f;
    }
    if (o->common.unlit) desc->view = VOXRT_VIEW_UNLIT;
    if (o->split) desc->view = VOXRT_VIEW_SPLIT;
    if (o->has_heat) desc->view = o->heat == 0 ? VOXRT_VIEW_HEAT_OUTER : VOXRT_VIEW_HEAT_INNER;
}

/* --lod off|object|LEVEL. Returns what parse returns. */
static int set_lod(const char *program, const render_options *o, voxrt_render_desc *desc) {
    const char *at = o->lod, *end = at + strlen(at);
    int64_t level;
    desc->tolerance = o->common.has_tolerance ? desc->tolerance : 0.0f;
    if (strcmp(o->lod, "object") == 0) desc->object_lod = 1;
    else if (strcmp(o->lod, "off") == 0) desc->tolerance = 0.0f;
    else if (!sup_parse_int(&at, end, &level) && at == end && level >= 0 && level <= VOXRT_MAX_DEPTH)
        desc->max_level_plus_1 = (uint32_t)level + 1;
    else
        return sup_bad_usage(program, "--lod: \"%s\" is not off, object or a level from 0 to %d", o->lod, VOXRT_MAX_DEPTH);
    return -1;
}

/* Reads the command line. Returns -1 to go on, or the exit status. */
static int parse(int argc, char **argv, render_options *o, voxrt_render_desc *desc) {
    sup_option table[SUP_COMMON_OPTIONS + 32];
    int status;
    memset(o, 0, sizeof *o);
    status = sup_cli_parse(argc, argv, "Draws a voxel file.", table, option_table(o, table));
    if (status >= 0) return status;
    status = check_options(argv[0], o);
    if (status < 0) status = sup_out_check(argv[0], &o->common);
    if (status < 0) status = collect_lights(argc, argv, o);
    if (status >= 0) return status;
    describe(o, desc);
    return o->lod != NULL ? set_lod(argv[0], o, desc) : -1;
}

static int load(const char *program, const render_options *o, scene *s) {
    sup_error err;
    if (sup_voxels_paged(o->in, (uint64_t)o->memory << 20, !o->finer, &s->paged, &err)) return sup_bad_input(program, err.text);
    if (s->paged && (o->path == PATH_THESIS || o->smooth || o->scatter != 0))
        return sup_bad_usage(program, "a file in pages goes neither with --path thesis nor with --smooth nor with --scatter");
    if (!s->paged && o->finer) return sup_bad_usage(program, "--finer goes with a file in pages");
    if (s->paged) return 0;
    return sup_voxels_load(o->in, (uint32_t)o->common.threads, NULL, &s->tree, o->path == PATH_THESIS ? &s->octree : NULL, &err) ?
           sup_bad_input(program, err.text) : 0;
}

/* 0 to 1, from a number */
static double noise(uint64_t x) {
    x = (x + 1) * 0x9e3779b97f4a7c15u;
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return (double)((x ^ x >> 31) >> 11) / 9007199254740992.0;
}

/* Copies of the tree in a square on the ground, one of them to each field of a chessboard: turned about the vertical
   axis, 0.7 to 1.3 times as large, a little out of place. */
static int scatter(const render_options *o, scene *s, voxrt_render_desc *desc, voxrt_error *error) {
    const size_t count = (size_t)o->scatter, side = (size_t)ceil(sqrt((double)count));
    voxrt_geometry *all = (voxrt_geometry *)sup_alloc(count, sizeof *all);
    double lo[3], hi[3], middle[3], wide;
    int bad;
    s->instances = (voxrt_instance *)sup_alloc(count, sizeof *s->instances);
    if (all == NULL || s->instances == NULL) {
        SUP_FREE(all);
        error->code = VOXRT_ERR_NO_MEMORY;
        (void)snprintf(error->text, sizeof error->text, "out of memory for the copies");
        return 1;
    }
    voxrt_tree_bounds(s->tree, lo, hi);
    for (int a = 0; a < 3; a++) middle[a] = 0.5 * (lo[a] + hi[a]);
    wide = hypot(hi[0] - lo[0], hi[2] - lo[2]);
    bad = 0;
    for (size_t i = 0; i < count && !bad; i++) {
        voxrt_instance *p = &s->instances[i];
        const double turn = 6.283185307179586 * noise(4 * i), size = 0.7 + 0.6 * noise(4 * i + 1);
        const double c = size * cos(turn), d = size * sin(turn);
        const double x = ((double)(i % side) - 0.5 * (double)(side - 1) + 0.4 * (noise(4 * i + 2) - 0.5)) * wide;
        const double z = (0.5 * (double)(side - 1) - (double)(i / side) + 0.4 * (noise(4 * i + 3) - 0.5)) * wide;
        const double m[12] = {c, 0.0, d, x - c * middle[0] - d * middle[2], 0.0, size, 0.0, lo[1] - size * lo[1],
                              -d, 0.0, c, z + d * middle[0] - c * middle[2]};
        memset(p, 0, sizeof *p);
        voxrt_tree_geometry(s->tree, &p->geometry);
        memcpy(p->to_world, m, sizeof m);
        bad = voxrt_instance_geometry(p, &all[i]) != VOXRT_OK;
    }
    if (bad) (void)snprintf(error->text, sizeof error->text, "the tree cannot be copied");
    desc->env.error = error;
    bad = bad || voxrt_group_create(&desc->env, all, count, &s->group) != VOXRT_OK;
    SUP_FREE(all);
    if (bad) return 1;
    voxrt_group_geometry(s->group, &s->geometry);
    desc->geometry = &s->geometry;
    desc->geometry_count = 1;
    return 0;
}

static void set_camera(const render_options *o, scene *s, voxrt_camera *camera) {
    double box_min[3], box_max[3];
    float lo[3], hi[3];
    if (s->tree != NULL) voxrt_tree_bounds(s->tree, box_min, box_max);
    if (s->tree == NULL || s->group != NULL) {
        memcpy(box_min, s->geometry.box_min, sizeof box_min);
        memcpy(box_max, s->geometry.box_max, sizeof box_max);
    }
    for (int a = 0; a < 3; a++) {
        lo[a] = (float)box_min[a];
        hi[a] = (float)box_max[a];
    }
    sup_common_camera(&o->common, lo, hi, &s->camera);
    memcpy(camera->eye, s->camera.eye, sizeof camera->eye);
    memcpy(camera->at, s->camera.at, sizeof camera->at);
    memcpy(camera->up, s->camera.up, sizeof camera->up);
    camera->fov_y = s->camera.fov;
    if (!o->common.has_eye && !o->common.has_at && (s->tree == NULL || s->group != NULL))
        (void)voxrt_camera_fit(camera, box_min, box_max, NULL, o->common.size[0], o->common.size[1]);
    else if (!o->common.has_eye && !o->common.has_at)
        (void)voxrt_camera_fit_tree(camera, s->tree, NULL, o->common.size[0], o->common.size[1]);
}

/* The ray through a point of a picture of all directions: longitude to the right, latitude upwards. */
static void panorama_ray(void *user, double x, double y, voxrt_ray *ray) {
    const scene *s = (const scene *)user;
    const double turn = (x / s->size[0] - 0.5) * 6.283185307179586, rise = (0.5 - y / s->size[1]) * 3.141592653589793;
    for (int a = 0; a < 3; a++)
        ray->dir[a] = (float)(cos(rise) * (cos(turn) * s->axes.forward[a] + sin(turn) * s->axes.right[a]) +
                              sin(rise) * s->axes.up[a]);
}

static void set_panorama(scene *s, voxrt_render_desc *desc, const voxrt_image *image) {
    sup_camera_view(&s->camera, &s->axes);
    s->size[0] = (double)image->width;
    s->size[1] = (double)image->height;
    s->states.ray_fn = panorama_ray;
    s->states.user = s;
    desc->states = &s->states;
    desc->camera.fov_y = 115.0372f; /* whose pixels in the middle are as wide */
}

/* Draw the octree in place of the tree; its level of detail is one level for all. */
static void use_octree(scene *s, voxrt_render_desc *desc, uint32_t height) {
    const double spread = 2.0 * tan((double)desc->camera.fov_y * (3.14159265358979323846 / 360.0)) / (double)height;
    voxrt_octree_geometry(s->octree, &s->geometry);
    desc->geometry = &s->geometry;
    desc->geometry_count = 1;
    if (desc->object_lod) {
        const float pixels = desc->tolerance > 0.0f ? desc->tolerance : 1.0f;
        desc->max_level_plus_1 = voxrt_octree_lod_level(s->octree, desc->camera.eye, (float)spread, pixels) + 1;
    }
}

static void free_scene(scene *s) {
    voxrt_tree_destroy(s->tree);
    voxrt_paged_destroy(s->paged);
    voxrt_octree_destroy(s->octree);
    voxrt_group_destroy(s->group);
    SUP_FREE(s->instances);
}

static int blur(const render_options *o, const voxrt_render_desc *desc, const scene *s, const voxrt_image *image,
                voxrt_error *error) {
    voxrt_blur_desc b = {0};
    b.env = desc->env;
    b.env.error = error;
    b.radius = (float)o->blur;
    if (o->smooth) {
        voxrt_tree_info info;
        voxrt_tree_get_info(s->tree, &info);
        b.footprint =
            (float)(2.0 * tan((double)desc->camera.fov_y * (3.14159265358979323846 / 360.0)) / (double)image->height);
        b.voxel_size = (float)info.voxel_size;
        b.depth = info.depth;
    }
    return voxrt_blur(&b, image) != VOXRT_OK;
}

/* Of pictures, in seconds, and how many took too long; of a file in pages the first one, and all with what was loaded. */
typedef struct timing { double last, sum, most, first, exact; int64_t over; } timing;

static void add_time(timing *t, double seconds, double budget_ms) {
    t->last = seconds;
    t->sum += seconds;
    t->most = seconds > t->most ? seconds : t->most;
    t->over += 1e3 * seconds > budget_ms;
}

/* The eye on its way around what it looks at, about a vertical axis. */
static void turn_camera(const float from[3], const float at[3], double angle, float eye[3]) {
    const double x = (double)from[0] - (double)at[0], z = (double)from[2] - (double)at[2];
    eye[0] = angle == 0.0 ? from[0] : (float)((double)at[0] + cos(angle) * x + sin(angle) * z);
    eye[1] = from[1];
    eye[2] = angle == 0.0 ? from[2] : (float)((double)at[2] - sin(angle) * x + cos(angle) * z);
}

/* Bytes of memory that the program has had at most, mapped files and all; 0: not known here. */
static double peak_memory(void) {
#ifdef _WIN32
    return 0.0;
#else
    struct rusage u;
    return getrusage(RUSAGE_SELF, &u) == 0 ? 1024.0 * (double)u.ru_maxrss : 0.0;
#endif
}

static void print_paged(const voxrt_paged *paged, double coarse_seconds, double exact_seconds) {
    voxrt_paged_info info;
    voxrt_paged_get_info(paged, &info);
    printf(",\"pages\":%u,\"loaded_pages\":%u,\"reads\":%llu,\"read_bytes\":%llu,\"evictions\":%llu,\"memory\":%llu,\"loaded_bytes\":%llu",
           info.page_count, info.loaded_pages, (unsigned long long)info.reads, (unsigned long long)info.read_bytes,
           (unsigned long long)info.evictions, (unsigned long long)info.memory, (unsigned long long)info.loaded_bytes);
    printf(",\"coarse_rays\":%llu,\"coarse_seconds\":%.6f,\"exact_seconds\":%.6f", (unsigned long long)info.coarse_rays,
           coarse_seconds, exact_seconds);
}

/* Counts of the first picture; times of all. */
static void print_stats(const render_options *o, const scene *s, const voxrt_render_desc *desc, const voxrt_image *image,
                        const voxrt_render_stats *stats, const timing *spent) {
    const voxrt_camera *camera = &desc->camera;
    const double seconds = spent->sum / (double)o->frames;
    const voxrt_isa best = voxrt_isa_best(), wanted = (voxrt_isa)o->common.isa;
    const uint64_t rays = stats->primary.rays + stats->shadow.rays + stats->bounce.rays;
    voxrt_tree_info info = {0};
    if (s->paged != NULL) {
        voxrt_paged_info paged;
        voxrt_paged_get_info(s->paged, &paged);
        info.voxel_count = paged.voxel_count;
        info.depth = paged.depth;
        info.total_bytes = paged.file_bytes;
    } else {
        voxrt_tree_get_info(s->tree, &info);
    }
    printf("{\"program\":\"voxrt_render\",\"in\":");
    sup_json_string(stdout, o->in);
    printf(",\"path\":\"%s\",\"width\":%u,\"height\":%u,\"voxels\":%llu,\"depth\":%u,\"bytes\":%llu",
           o->path == PATH_THESIS ? "thesis" : "fast", image->width, image->height,
           (unsigned long long)info.voxel_count, info.depth, (unsigned long long)info.total_bytes);
    printf(",\"rays\":%llu,\"hits\":%llu,\"shadow_rays\":%llu,\"shadow_hits\":%llu,\"steps\":%llu,\"descents\":%llu",
           (unsigned long long)stats->primary.rays, (unsigned long long)stats->primary.hits,
           (unsigned long long)stats->shadow.rays, (unsigned long long)stats->shadow.hits,
           (unsigned long long)stats->primary.steps, (unsigned long long)stats->primary.descents);
    if (stats->bounce.rays != 0)
        printf(",\"bounce_rays\":%llu,\"bounce_hits\":%llu", (unsigned long long)stats->bounce.rays, (unsigned long long)stats->bounce.hits);
    printf(",\"eye\":[%.9g,%.9g,%.9g],\"at\":[%.9g,%.9g,%.9g]", (double)camera->eye[0], (double)camera->eye[1],
           (double)camera->eye[2], (double)camera->at[0], (double)camera->at[1], (double)camera->at[2]);
    if (o->frames > 1)
        printf(",\"frames\":%d,\"most_seconds\":%.6f", (int)o->frames, spent->most);
    if (o->budget > 0.0)
        printf(",\"budget_ms\":%.9g,\"over_budget\":%d,\"tolerance\":%.6g,\"pixel_step\":%u", o->budget, (int)spent->over,
               (double)desc->tolerance, desc->pixel_step < 1 ? 1 : desc->pixel_step);
    if (s->paged != NULL) print_paged(s->paged, spent->first, spent->exact);
    printf(",\"peak_bytes\":%.0f", peak_memory());
    printf(",\"seconds\":%.6f,\"mrays_per_second\":%.3f,\"isa\":\"%s\",\"threads\":%d}\n", seconds,
           seconds > 0.0 ? 1e-6 * (double)rays / seconds : 0.0,
           voxrt_isa_name(wanted == VOXRT_ISA_AUTO || wanted > best ? best : wanted), sup_threads(o->common.threads));
}

static void free_image(voxrt_image *image) {
    SUP_FREE(image->rgba8);
    SUP_FREE(image->rgba);
    SUP_FREE(image->depth);
    SUP_FREE(image->normal);
    SUP_FREE(image->hit);
    memset(image, 0, sizeof *image);
}

/* Buffers for what is asked for; returns 1 when memory is short. */
static int make_image(const render_options *o, voxrt_image *image) {
    const size_t pixels = (size_t)o->common.size[0] * o->common.size[1];
    const int linear = o->has_blur || sup_out_is_linear(&o->common);
    const double bytes = (double)pixels * (4.0 + (linear ? 16.0 : 0.0) + (o->has_blur ? 16.0 : 0.0) +
                                           (o->common.depth != NULL || o->smooth ? 4.0 : 0.0) +
                                           (o->smooth ? 12.0 + (double)sizeof(voxrt_hit) : 0.0));
    memset(image, 0, sizeof *image);
    if (sup_memory_limit() != 0 && bytes > (double)sup_memory_limit()) return 1;
    image->width = o->common.size[0];
    image->height = o->common.size[1];
    image->rgba8 = (uint8_t *)sup_alloc(pixels, 4);
    if (linear) image->rgba = (float *)sup_alloc(pixels, 16);
    if (o->common.depth != NULL || o->smooth) image->depth = (float *)sup_alloc(pixels, 4);
    if (o->smooth) {
        image->normal = (float *)sup_alloc(pixels, 12);
        image->hit = (voxrt_hit *)sup_alloc(pixels, sizeof(voxrt_hit));
    }
    if (image->rgba8 != NULL && (!linear || image->rgba != NULL) &&
        ((o->common.depth == NULL && !o->smooth) || image->depth != NULL) &&
        (!o->smooth || (image->normal != NULL && image->hit != NULL))) {
        return 0;
    }
    free_image(image);
    return 1;
}

/* Load what picture f lacked. With --finer it is the last one when that is nothing; when there is no room for all of it the next
   one is, which waits, as the last of --frames does. Returns 1 with err->text set when the file cannot be read. */
static int next_pages(const render_options *o, voxrt_paged *paged, int64_t *frames, int64_t f, int *exact, sup_error *err) {
    voxrt_paged_update_stats stats = {0};
    voxrt_paged_info info;
    if (o->finer) {
        (void)voxrt_paged_update(paged, 0, &stats);
        if (stats.wanted == 0) {
            *frames = f + 1;
        } else if (f + 2 == *frames || (f + 2 < *frames && stats.no_room != 0)) {
            voxrt_paged_wait(paged, 1);
            *frames = f + 2;
        }
    }
    voxrt_paged_get_info(paged, &info);
    *exact = stats.wanted == 0 && info.coarse_rays == 0;
    return info.bad_pages != 0 ? sup_fail(err, "%s: %s", o->in, info.error.text) : 0;
}

int main(int argc, char **argv) {
    render_options o;
    voxrt_render_desc desc;
    voxrt_render_stats stats = {0};
    voxrt_error error = {VOXRT_OK, 0, ""};
    voxrt_image image;
    sup_progress progress;
    sup_error err;
    scene s = {0};
    const voxrt_tree *drawn;
    timing spent = {0};
    voxrt_budget budget = {0};
    float start_eye[3];
    char path[1024];
    const char *pattern;
    double start, began;
    int exact = 1;
    int status = parse(argc, argv, &o, &desc);
    if (status >= 0) return status;
    pattern = o.common.out;
    if (pattern != NULL) {
        if (sup_frame_path(pattern, 0, o.frames, path, sizeof path))
            return sup_bad_usage(argv[0], "--out: with --frames the name needs one %%d for the number, and less than 1024 letters");
        o.common.out = path;
    }
    status = load(argv[0], &o, &s);
    if (!status && o.scatter != 0 && scatter(&o, &s, &desc, &error)) status = sup_bad_input(argv[0], error.text);
    if (status || make_image(&o, &image)) {
        free_scene(&s);
        return status ? status : sup_bad_input(argv[0], "out of memory for the picture");
    }
    if (s.paged != NULL) {
        voxrt_paged_geometry(s.paged, &s.geometry);
        desc.geometry = &s.geometry;
        desc.geometry_count = 1;
    }
    set_camera(&o, &s, &desc.camera);
    memcpy(start_eye, desc.camera.eye, sizeof start_eye);
    if (o.panorama) set_panorama(&s, &desc, &image);
    if (o.path == PATH_THESIS) use_octree(&s, &desc, image.height);
    if (o.has_material) {
        s.material.ambient[0] = s.material.ambient[1] = s.material.ambient[2] = 0.05f; /* as without a material */
        s.material.diffuse = (float)o.diffuse;
        s.material.specular = (float)o.specular;
        s.material.shininess = (float)o.shininess;
        desc.material = &s.material;
    }
    drawn = o.path == PATH_THESIS || s.group != NULL ? NULL : s.tree;
    began = sup_now();
    sup_progress_begin(&progress, "drawing", o.common.quiet);
    if (!progress.quiet) {
        desc.env.progress_fn = sup_progress_fn;
        desc.env.progress_user = &progress;
    }
    desc.env.error = &error;
    status = 0;
    for (int64_t f = 0; f < o.frames && !status; f++) {
        if (!o.finer) turn_camera(start_eye, desc.camera.at, 6.283185307179586 * (double)f / (double)o.frames, desc.camera.eye);
        if (o.common.stats && f == 0 && s.paged == NULL) /* counting costs time: not measured */
            status = voxrt_render(&desc, drawn, &image, &stats) != VOXRT_OK;
        start = sup_now();
        if (!status) status = voxrt_render(&desc, drawn, &image, s.paged != NULL && o.common.stats && f == 0 ? &stats : NULL) != VOXRT_OK;
        add_time(&spent, sup_now() - start, o.budget);
        if (f == 0) spent.first = sup_now() - began;
        if (!status && o.has_blur) status = blur(&o, &desc, &s, &image, &error);
        if (status) {
            (void)sup_fail(&err, "%s: %s", o.in, error.text[0] ? error.text : "cannot be drawn");
        } else {
            if (o.common.out != NULL) (void)sup_frame_path(pattern, f, o.frames, path, sizeof path);
            status = sup_out_write(&o.common, image.rgba8, image.rgba, image.depth, image.width, image.height, &err);
        }
        if (o.budget > 0.0) {
            desc.tolerance = voxrt_budget_update(&budget, (float)(1e3 * spent.last), (float)o.budget, (float)o.common.tolerance);
            desc.pixel_step = budget.pixel_step;
        }
        spent.exact = sup_now() - began;
        if (!status && s.paged != NULL) status = next_pages(&o, s.paged, &o.frames, f, &exact, &err);
    }
    sup_progress_end(&progress);
    if (!status && !exact && !o.common.quiet)
        sup_warn(argv[0], o.finer ? "the picture is not exact: it takes more --frames, the last of which waits" :
                                    "there is not enough --memory for some rays: they met cells that are too coarse");
    if (status) (void)sup_bad_input(argv[0], err.text);
    else if (o.common.stats) print_stats(&o, &s, &desc, &image, &stats, &spent);
    free_image(&image);
    free_scene(&s);
    return status;
}
