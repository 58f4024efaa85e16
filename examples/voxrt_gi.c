/* voxrt_gi.c - a scene that may move -> pictures with the light that bounces between its surfaces
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/gi_scene.h"
#include "support/mesh.h"
#include "support/mesh_obj.h"
#include "support/mesh_off.h"
#include "support/mesh_ply.h"
#include "support/mesh_stl.h"
#include "support/picture.h"
#include "support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"
#include "support/voxel_mesh.h"

enum { METHOD_DEFAULT, METHOD_GATHER, METHOD_PATH, METHOD_VPL, METHOD_AO, METHOD_NONE };
enum { VIEW_PICTURE, VIEW_DIRECT, VIEW_INDIRECT, VIEW_VOXELS, VIEW_CUBES, VIEW_LIGHTS, VIEW_LOOKUP, VIEW_STEPS };

typedef struct gi_options {
    sup_common common;
    const char *scene, *camera, *save, *export_to, *pixel;
    int method, tone, view, lookup, voxels;
    int64_t at[2], steps;
    int64_t frames, rays, bounces, grid, depth, res, filter, shadow_filter, aa, coarse, pattern, keep, nested, first, still;
    double radius, exposure, budget, d_min, relief;
    int has_rays, has_voxels;
} gi_options;

typedef struct piece { /* an object: its triangles for the light that bounces, its voxels for what the camera sees */
    sup_mesh mesh;
    voxrt_tree *tree;
    voxrt_instance instance;
    voxrt_gi_object object;
    uint32_t id;
    double placed[12]; /* where the light has it */
    int frame;         /* of a sequence; -1: none yet */
    int fresh;         /* the light does not know its mesh yet */
} piece;

typedef struct world {
    sup_gi_scene scene;
    sup_mesh first; /* a mesh that is read already */
    piece *pieces;  /* one for each object of the scene */
    size_t piece_count;
    voxrt_gi_light *lights;
    voxrt_geometry *parts;
    voxrt_gi *gi;
    voxrt_gi_history *history;
    voxrt_group *group;
    voxrt_geometry geometry;
    voxrt_camera camera;
    size_t which; /* camera */
    voxrt_gi_budget budget;
    double lift, box[6];
    int shine, glow;   /* is there an object with a lobe, that emits light? */
    int of_mesh;       /* the file is no scene but a mesh: object "mesh" */
    const char *name;
    sup_mesh *stale;   /* meshes of sequences that the light still uses until the next update */
} world;

typedef struct buffers {
    voxrt_gbuffer g;
    float *direct, *indirect;
    uint8_t *rgba;
} buffers;

typedef struct timing { double update, gbuffer, light, all; uint64_t rays; double shaded, noise, kept, per_pixel, brightest; } timing;

static const char cornell_text[] =
    "voxrt_gi 1\nwhite 0.6\nseconds 4\n"
    "camera front eye 2.78 2.73 8 at 2.78 2.73 -2.8 fov 38\n"
    "object scene:cornell\n"
    "light area position 2.78 5.44 -2.795 u 0.55 0 0 v 0 0 0.55 color 22 18.7 13.2\n";
static const char cornell_ball_text[] =
    "path round loop\n knot 0 1.7 0 0\n knot 0.5 1.2 0.4 0.92\n knot 1 0 0 1.3\n knot 1.5 -1.2 -0.4 0.92\n knot 2 -1.7 0 0\n"
    " knot 2.5 -1.2 0.4 -0.92\n knot 3 0 0 -1.3\n knot 3.5 1.2 -0.4 -0.92\n knot 4 1.7 0 0\n"
    "object scene:sphere:32 scale 0.55 position 2.8 3.9 -2.6 color 0.16 0.31 0.75 path round\n";
static const char atrium_text[] =
    "voxrt_gi 1\nwhite 1\nseconds 4\n"
    "path swing loop\n knot 0 0 0 0\n knot 1 0.6 0 0\n knot 2 0 0 0\n knot 3 -0.6 0 0\n knot 4 0 0 0\n"
    "path round loop\n knot 0 0.8 0 0\n knot 1 0 0 1.5\n knot 2 -0.8 0 0\n knot 3 0 0 -1.5\n knot 4 0.8 0 0\n"
    "path warm loop\n knot 0 0.8 0 0\n knot 1 0 0 3\n knot 2 -0.8 0 0\n knot 3 0 0 -3\n knot 4 0.8 0 0\n"
    "path cold loop\n knot 0 0.8 0 2.5\n knot 1 0 0 1.6\n knot 2 -0.8 0 -2.5\n knot 3 0 0 -1.6\n knot 4 0.8 0 2.5\n"
    "camera nave eye -0.2 2.2 16 at -0.6 2.9 0 fov 62\n"
    "camera aisle eye 3.4 1.8 6 at -1.5 2.2 -2 fov 60\n"
    "object scene:pillars\n"
    "object scene:torus position -2 1.1 8 spin 0 180 0 color 0.67 0.061 0.03 path swing\n"
    "object scene:sphere:32 scale 0.8 position 1.6 0.8 9 color 0.76 0.445 0.065 path round\n"
    "light point position 3.2 5.2 8 color 60 46 26 path warm\n"
    "light point position -4 5.2 0 color 26 36 60 path cold\n";

static int parse(int argc, char **argv, gi_options *o) {
    sup_option table[SUP_COMMON_OPTIONS + 40];
    size_t n;
    int status;
    memset(o, 0, sizeof *o);
    o->scene = "cornell";
    o->frames = 1;
    o->rays = 64;
    o->bounces = 3;
    o->grid = 256;
    o->filter = 3;
    o->aa = 4;
    o->coarse = 1;
    o->pattern = 4;
    o->nested = 1;
    o->keep = -1;
    o->exposure = 1.0;
    n = sup_common_options(&o->common, table);
    sup_option_help(table, n, "size", "pixels of the picture (768x512)");
    sup_option_help(table, n, "eye", "where the camera is (the scene's)");
    sup_option_help(table, n, "at", "where it looks (the scene's)");
    sup_option_help(table, n, "up", "what is up (the scene's)");
    sup_option_help(table, n, "fov", "vertical angle of view, degrees (the scene's)");
    sup_option_help(table, n, "tolerance", "noise of indirect light as a share of it; --rays, if given, are the most");
    o->common.size[0] = 768;
    o->common.size[1] = 512;
    table[n++] = sup_opt_text("scene", &o->scene, "cornell|atrium|FILE", "generated; a scene file; or a mesh file, which stands on a plane (cornell)");
    table[n++] = sup_opt_text("camera", &o->camera, "NAME", "which camera of the scene (the first)");
    table[n++] = sup_opt_choice("method", &o->method, "default|gather|path|vpl|ao|none",
                                "how indirect light is found; default: gather, with light on cells that has bounced before");
    table[n++] = sup_opt_choice("lookup", &o->lookup, "cache|rays|volume|maps",
                                "direct light where a ray hits: of the cell, by shadow rays, of all cells, by maps");
    table[n++] = sup_opt_int("frames", &o->frames, 1, 100000, "N", "pictures of the scene as it moves; FILE of --out has a %d for the number");
    table[n++] = sup_opt_int("first", &o->first, 0, 100000, "N", "draw picture N of --frames and those after it (0)");
    table[n++] = sup_opt_int("repeat", &o->still, 1, 100000, "N", "draw each picture N times, all of which count with --keep (1)");
    table[n++] = sup_opt_given(sup_opt_int("rays", &o->rays, 1, 65536, "N", "rays over the hemisphere of a pixel, or virtual lights (64)"), &o->has_rays);
    table[n++] = sup_opt_int("bounces", &o->bounces, 1, 64, "N", "how often light is followed (3)");
    table[n++] = sup_opt_real("radius", &o->radius, 0.0, 1e9, "R", "length of the rays, world units (all)");
    table[n++] = sup_opt_int("filter", &o->filter, 0, 64, "R",
                             "radius of the filter of indirect light in samples, of which --aa says how many a pixel has; 0: none (3)");
    table[n++] = sup_opt_real("relief", &o->relief, 0.0, 1.0, "A", "indirect light darker where surfaces lean away, for strong filters (0)");
    table[n++] = sup_opt_int("shadow-filter", &o->shadow_filter, 0, 64, "R", "the same for direct light: soft shadows (0)");
    table[n++] = sup_opt_int("coarse", &o->coarse, 1, 16, "N", "one of N x N samples sends rays where light is smooth: 1, 2, 4, 8 or 16 (1)");
    table[n++] = sup_opt_int("keep", &o->keep, 0, 1000, "N", "pictures that each one remembers, 0: none (0; 16 if frames move)");
    table[n++] = sup_opt_real("budget", &o->budget, 0.0, 1e6, "MS", "time for a frame: rays and --coarse are chosen, --rays are the most");
    table[n++] = sup_opt_int("pattern", &o->pattern, 1, 16, "N", "vpl: N x N samples share the lights (4)");
    table[n++] = sup_opt_real("d-min", &o->d_min, 0.0, 1e9, "A", "vpl: the thesis' bound, an area; 0: bound and compensation (0)");
    table[n++] = sup_opt_int("aa", &o->aa, 1, 16, "N", "samples a pixel: 1, 4, 9 or 16 (4)");
    table[n++] = sup_opt_int("grid", &o->grid, 16, 2048, "N", "columns along each side, a power of two (256)");
    table[n++] = sup_opt_int("depth-cells", &o->depth, 64, 256, "N", "cells of a column: 64, 128 or 256 (128; 256 if --grid is more than 256)");
    table[n++] = sup_opt_int("nested", &o->nested, 1, 8, "N", "volumes around the camera, each twice as wide (1: one around the scene)");
    table[n++] = sup_opt_int("res", &o->res, 16, 8192, "N",
                             "voxels along the longest side of an object that the camera sees (1024; what moves 512; the hall of the atrium 4096)");
    table[n++] = sup_opt_choice("tone", &o->tone, "linear|log|drago", "tone mapping");
    table[n++] = sup_opt_real("exposure", &o->exposure, 1e-6, 1e6, "E", "brightness, times the scene's own (1)");
    table[n++] = sup_opt_choice("view", &o->view, "picture|direct|indirect|voxels|cubes|lights|lookup|steps",
                                "parts of the picture; what rays see, plain or as cubes; virtual lights; where maps let light through (red) or hold it (blue); "
                                "the columns that a ray from --pixel looks at: empty (green), not empty (red), hit (yellow)");
    table[n++] = sup_opt_text("pixel", &o->pixel, "X,Y", "steps: the ray that a mirror at this pixel would send (the middle)");
    table[n++] = sup_opt_int("steps", &o->steps, 1, 100000, "N", "steps: the first N of them (all)");
    table[n++] = sup_opt_given(sup_opt_choice("voxels", &o->voxels, "thin|fat|raster|solid|samples|body",
                                              "how objects become voxels that do not say it themselves (thin)"), &o->has_voxels);
    table[n++] = sup_opt_text("save", &o->save, "FILE", "write the scene, with the camera of --eye and the like, as a scene file");
    table[n++] = sup_opt_text("export", &o->export_to, "FILE", "write what there is to see at picture --first: a scene file where nothing moves, "
                              "and a PLY file in world coordinates for each object");
    status = sup_cli_parse(argc, argv, "Draws a scene with global illumination.", table, n);
    if (status >= 0) return status;
    if (o->common.out != NULL || o->common.depth != NULL || (o->save == NULL && o->export_to == NULL)) status = sup_out_check(argv[0], &o->common);
    if (status >= 0) return status;
    o->at[0] = o->common.size[0] / 2;
    o->at[1] = o->common.size[1] / 2;
    if (o->pixel != NULL) {
        const char *p = o->pixel, *end = p + strlen(p);
        int bad = sup_parse_int(&p, end, &o->at[0]) || p == end || *p++ != ',' || sup_parse_int(&p, end, &o->at[1]) || p != end;
        for (int a = 0; a < 2 && !bad; a++) bad = o->at[a] < 0 || o->at[a] >= (int64_t)o->common.size[a];
        if (bad) return sup_bad_usage(argv[0], "--pixel: \"%s\" is no X,Y in the picture", o->pixel);
        if (o->view != VIEW_STEPS) return sup_bad_usage(argv[0], "--pixel goes with --view steps");
    }
    if (o->steps != 0 && o->view != VIEW_STEPS) return sup_bad_usage(argv[0], "--steps goes with --view steps");
    if ((o->grid & (o->grid - 1)) != 0) return sup_bad_usage(argv[0], "--grid: %d is no power of two", (int)o->grid);
    if (o->coarse & (o->coarse - 1)) return sup_bad_usage(argv[0], "--coarse: %d is no power of two", (int)o->coarse);
    if (o->depth != 0 && o->depth != 64 && o->depth != 128 && o->depth != 256)
        return sup_bad_usage(argv[0], "--depth-cells: %d is not 64, 128 or 256", (int)o->depth);
    if (o->aa != 1 && o->aa != 4 && o->aa != 9 && o->aa != 16) return sup_bad_usage(argv[0], "--aa: %d is not 1, 4, 9 or 16", (int)o->aa);
    if (o->first >= o->frames) return sup_bad_usage(argv[0], "--first: there is no picture %d of %d", (int)o->first, (int)o->frames);
    if (o->still == 0) o->still = 1;
    if (o->keep < 0) o->keep = o->frames > 1 ? 16 : 0;
    if (o->view == VIEW_LIGHTS) o->method = METHOD_VPL;
    return -1;
}

/* ---- scenes ---------------------------------------------------------------------------------------------------- */

/* A body that is seen from outside: if its triangles face inwards, turn them. Light is on the side they face. */
static void turn_outwards(sup_mesh *m) {
    double volume = 0.0, box = 1.0;
    float lo[3], hi[3];
    if (sup_mesh_bounds(m, lo, hi)) return;
    for (int a = 0; a < 3; a++) box *= (double)hi[a] - (double)lo[a];
    for (size_t i = 0; i < m->triangle_count; i++) {
        double p[3][3];
        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++)
                p[k][a] = (double)m->positions[3 * (size_t)m->indices[3 * i + (size_t)k] + (size_t)a] - 0.5 * ((double)lo[a] + (double)hi[a]);
        for (int a = 0; a < 3; a++)
            volume += p[0][a] * (p[1][(a + 1) % 3] * p[2][(a + 2) % 3] - p[1][(a + 2) % 3] * p[2][(a + 1) % 3]) / 6.0;
    }
    if (volume > -0.001 * box) return;
    for (size_t i = 0; i < m->triangle_count; i++) {
        const uint32_t corner = m->indices[3 * i + 1];
        m->indices[3 * i + 1] = m->indices[3 * i + 2];
        m->indices[3 * i + 2] = corner;
    }
}

/* A mesh on a plane, a lamp above it. */
static int scene_of_mesh(world *w, const gi_options *o, sup_error *err) {
    static const float view[3] = {0.55f, 0.35f, 1.0f};
    char text[2048];
    float lo[3], hi[3], size = 0.0f;
    double box[2][3];
    voxrt_camera c;
    if (sup_mesh_read(o->scene, &w->first, err)) return 1;
    if (sup_mesh_bounds(&w->first, lo, hi)) return sup_fail(err, "%s: no triangles", o->scene);
    for (int a = 0; a < 3; a++) {
        size = hi[a] - lo[a] > size ? hi[a] - lo[a] : size;
        box[0][a] = (double)lo[a];
        box[1][a] = (double)hi[a];
    }
    if (!(size > 1e-15f && size < 1e15f)) return sup_fail(err, "%s: its size, %g, is too small or too large to be lit", o->scene, (double)size);
    memset(&c, 0, sizeof c);
    (void)voxrt_camera_fit(&c, box[0], box[1], view, o->common.size[0], o->common.size[1]);
    (void)snprintf(text, sizeof text,
                   "voxrt_gi 1\ncamera fit eye %.9g %.9g %.9g at %.9g %.9g %.9g\nobject mesh outwards\n"
                   "object plane scale %.9g position %.9g %.9g %.9g color 0.51 0.51 0.55\n"
                   "light area position %.9g %.9g %.9g u %.9g 0 0 v 0 0 %.9g color 14 11.9 8.4\n",
                   (double)c.eye[0], (double)c.eye[1], (double)c.eye[2], (double)c.at[0], (double)c.at[1], (double)c.at[2], 1.5 * (double)size,
                   0.5 * ((double)lo[0] + (double)hi[0]), (double)lo[1], 0.5 * ((double)lo[2] + (double)hi[2]),
                   (double)lo[0] - 0.6 * (double)size, (double)hi[1] + (double)size, (double)hi[2] + 0.5 * (double)size,
                   0.4 * (double)size, 0.4 * (double)size);
    w->of_mesh = 1;
    return sup_gi_scene_parse(text, strlen(text), o->scene, &w->scene, err);
}

static int read_scene(world *w, const gi_options *o, sup_error *err) {
    char text[4096], *data = NULL;
    size_t size, at;
    int status;
    if (strcmp(o->scene, "cornell") == 0) {
        (void)snprintf(text, sizeof text, "%s%s", cornell_text, o->frames > 1 ? cornell_ball_text : "");
        return sup_gi_scene_parse(text, strlen(text), o->scene, &w->scene, err);
    }
    if (strcmp(o->scene, "atrium") == 0) return sup_gi_scene_parse(atrium_text, sizeof atrium_text - 1, o->scene, &w->scene, err);
    if (sup_read_file(o->scene, &data, &size, err)) return 1;
    for (at = 0; at < size && (data[at] == ' ' || data[at] == '\t'); at++) { } /* indented as the other lines may be */
    if (size - at >= 8 && memcmp(data + at, "voxrt_gi", 8) == 0) status = sup_gi_scene_parse(data, size, o->scene, &w->scene, err);
    else status = scene_of_mesh(w, o, err);
    SUP_FREE(data);
    return status;
}

static int make_plane(sup_mesh *mesh) {
    static const float p[12] = {-1, 0, -1, 1, 0, -1, 1, 0, 1, -1, 0, 1};
    static const uint32_t corners[6] = {0, 2, 1, 0, 3, 2};
    memset(mesh, 0, sizeof *mesh);
    mesh->positions = (float *)sup_alloc(12, sizeof(float));
    mesh->indices = (uint32_t *)sup_alloc(6, sizeof(uint32_t));
    if (mesh->positions == NULL || mesh->indices == NULL) {
        sup_mesh_free(mesh);
        return 1;
    }
    memcpy(mesh->positions, p, sizeof p);
    memcpy(mesh->indices, corners, sizeof corners);
    mesh->vertex_count = 4;
    mesh->triangle_count = 2;
    return 0;
}

/* The mesh of an object: generated, or a file beside the scene. frame: of a sequence. */
static int read_mesh(world *w, const sup_gi_thing *t, int frame, sup_mesh *mesh, sup_error *err) {
    char path[4096], name[SUP_GI_NAME];
    const char *slash = strrchr(w->name, '/');
    if (strcmp(t->file, "mesh") == 0 && w->first.triangle_count != 0) {
        *mesh = w->first;
        memset(&w->first, 0, sizeof w->first);
        return 0;
    }
    if (strcmp(t->file, "plane") == 0) return make_plane(mesh) ? sup_fail(err, "out of memory") : 0;
    if (strncmp(t->file, "scene:", 6) == 0) {
        const char *colon = strchr(t->file + 6, ':');
        const size_t length = colon ? (size_t)(colon - t->file - 6) : strlen(t->file + 6);
        int64_t detail = 0;
        if (length >= sizeof name) return sup_fail(err, "%s: no such scene", t->file);
        memcpy(name, t->file + 6, length);
        name[length] = 0;
        if (colon++) {
            const char *end = colon + strlen(colon);
            if (sup_parse_int(&colon, end, &detail) || colon != end || detail < 0 || detail > 4096) return sup_fail(err, "%s: no detail", t->file);
        }
        return sup_scene_make(name, (int)detail, mesh) ? sup_fail(err, "%s: no such scene, or out of memory", t->file) : 0;
    }
    if (t->has_frames ? sup_frame_name(t->file, frame, path, sizeof path) : (size_t)snprintf(path, sizeof path, "%s", t->file) >= sizeof path)
        return sup_fail(err, "%s: needs one %%d or %%03d for the number of the frame, or is too long", t->file);
    if (path[0] != '/' && slash != NULL) { /* beside the scene */
        char whole[4096];
        if ((size_t)snprintf(whole, sizeof whole, "%.*s%s", (int)(slash + 1 - w->name), w->name, path) >= sizeof whole)
            return sup_fail(err, "%s: the name is too long", path);
        memcpy(path, whole, sizeof path);
    }
    return sup_mesh_read(path, mesh, err);
}

/* One colour for a mesh that has none, or instead of its own; times the albedo of its material. Linear. */
static int paint(sup_mesh *mesh, const double color[3], const double albedo[3]) {
    uint8_t byte[3];
    if (color != NULL) {
        SUP_FREE(mesh->triangle_rgb);
        mesh->triangle_rgb = NULL;
    }
    if (mesh->triangle_rgb == NULL && mesh->vertex_rgb == NULL) {
        mesh->vertex_rgb = (uint8_t *)sup_alloc(mesh->vertex_count, 3);
        if (mesh->vertex_rgb == NULL) return 1;
        memset(mesh->vertex_rgb, 255, 3 * mesh->vertex_count);
    }
    for (int a = 0; a < 3; a++)
        byte[a] = sup_unit_to_byte(voxrti_linear_to_srgb((color != NULL ? color[a] : 1.0) * (albedo != NULL ? albedo[a] : 1.0)));
    if (color != NULL) {
        for (size_t i = 0; i < mesh->vertex_count; i++) memcpy(mesh->vertex_rgb + 3 * i, byte, 3);
    } else if (albedo != NULL) {
        uint8_t *c = mesh->triangle_rgb != NULL ? mesh->triangle_rgb : mesh->vertex_rgb;
        const size_t n = mesh->triangle_rgb != NULL ? mesh->triangle_count : mesh->vertex_count;
        for (size_t i = 0; i < 3 * n; i++) c[i] = sup_unit_to_byte(voxrti_linear_to_srgb(voxrti_srgb_to_linear(c[i] / 255.0) * albedo[i % 3]));
    }
    return 0;
}

/* Read an object's mesh and voxelise it for the camera. */
static int load_piece(world *w, const gi_options *o, size_t i, int frame, sup_error *err) {
    const sup_gi_thing *t = &w->scene.things[i];
    const sup_gi_material *material = t->material >= 0 ? &w->scene.materials[t->material] : NULL;
    piece *p = &w->pieces[i];
    sup_mesh mesh;
    voxrt_tree *tree = NULL;
    voxrt_build_desc build;
    voxrt_error error;
    voxrt_mesh *m = &p->object.mesh;
    if (read_mesh(w, t, frame, &mesh, err)) return 1;
    if (t->outwards) turn_outwards(&mesh);
    if (paint(&mesh, t->has_color ? t->color : NULL, material ? material->albedo : NULL)) {
        sup_mesh_free(&mesh);
        return sup_fail(err, "%s: out of memory", t->file);
    }
    memset(&build, 0, sizeof build);
    memset(&error, 0, sizeof error);
    *m = sup_voxel_mesh(&mesh);
    build.resolution = o->res != 0 ? (uint32_t)o->res : t->moving ? 512 : strcmp(t->file, "scene:pillars") == 0 ? 4096 : 1024;
    build.env.thread_count = (uint32_t)o->common.threads;
    build.env.error = &error;
    if (voxrt_tree_build(&build, m, NULL, &tree) != VOXRT_OK) {
        sup_mesh_free(&mesh);
        memset(m, 0, sizeof *m);
        return sup_fail(err, "%s: %s", t->file, error.text[0] ? error.text : "nothing to draw");
    }
    voxrt_tree_destroy(p->tree);
    sup_mesh_free(&w->stale[i]);
    w->stale[i] = p->mesh; /* the light looks at it until it gets the new one */
    p->mesh = mesh;
    p->tree = tree;
    p->frame = frame;
    p->fresh = 1;
    return 0;
}

static void free_world(world *w) {
    voxrt_group_destroy(w->group);
    voxrt_gi_history_destroy(w->history);
    voxrt_gi_destroy(w->gi);
    for (size_t i = 0; i < w->piece_count; i++) {
        voxrt_tree_destroy(w->pieces[i].tree);
        sup_mesh_free(&w->pieces[i].mesh);
        sup_mesh_free(&w->stale[i]);
    }
    sup_mesh_free(&w->first);
    SUP_FREE(w->pieces);
    SUP_FREE(w->stale);
    SUP_FREE(w->lights);
    SUP_FREE(w->parts);
    sup_gi_scene_free(&w->scene);
}

/* Lamps, objects and the camera at time t. changed: objects that are elsewhere. */
static int pose(world *w, const gi_options *o, double t, sup_error *err) {
    const sup_gi_scene *s = &w->scene;
    const sup_gi_camera *c = &s->cameras[w->which];
    for (size_t i = 0; i < s->thing_count; i++) {
        const sup_gi_thing *thing = &s->things[i];
        const int frame = thing->has_frames ? sup_gi_frame(thing, t) : 0;
        if (w->pieces[i].frame != frame && load_piece(w, o, i, frame, err)) return 1;
        sup_gi_matrix(s, thing, t, w->pieces[i].object.to_world);
    }
    for (size_t i = 0; i < s->lamp_count; i++) {
        const sup_gi_lamp *from = &s->lamps[i];
        voxrt_gi_light *l = &w->lights[i];
        memset(l, 0, sizeof *l);
        l->kind = (voxrt_gi_light_kind)from->kind;
        sup_gi_place(s, from->position, from->path, t, l->position);
        l->angle = (float)from->angle;
        for (int a = 0; a < 3; a++) {
            l->direction[a] = (float)from->direction[a];
            l->edge_u[a] = (float)from->u[a];
            l->edge_v[a] = (float)from->v[a];
            l->color[a] = (float)from->color[a];
        }
    }
    sup_gi_place(s, c->eye, c->path, t, w->camera.eye);
    sup_gi_place(s, c->at, c->at_path, t, w->camera.at);
    for (int a = 0; a < 3; a++) w->camera.up[a] = (float)c->up[a];
    w->camera.fov_y = (float)c->fov;
    if (o->common.has_eye) memcpy(w->camera.eye, o->common.camera.eye, sizeof w->camera.eye);
    if (o->common.has_at) memcpy(w->camera.at, o->common.camera.at, sizeof w->camera.at);
    if (o->common.has_up) memcpy(w->camera.up, o->common.camera.up, sizeof w->camera.up);
    if (o->common.has_fov) w->camera.fov_y = (float)o->common.fov;
    return 0;
}

/* Box of all objects wherever they go. */
static int world_box(world *w, double lo[3], double hi[3]) {
    const sup_gi_scene *s = &w->scene;
    for (int a = 0; a < 3; a++) {
        lo[a] = s->has_box ? s->box[a] : 1e300;
        hi[a] = s->has_box ? s->box[3 + a] : -1e300;
    }
    for (size_t i = 0; i < s->thing_count && !s->has_box; i++) {
        float from[2][3];
        if (sup_mesh_bounds(&w->pieces[i].mesh, from[0], from[1])) continue;
        for (int step = 0; step <= (s->things[i].moving ? 64 : 0); step++) {
            double m[12];
            sup_gi_matrix(s, &s->things[i], s->seconds * step / 64.0, m);
            for (int k = 0; k < 8; k++)
                for (int a = 0; a < 3; a++) {
                    double v = m[4 * a + 3];
                    for (int b = 0; b < 3; b++) v += m[4 * a + b] * (double)from[k >> b & 1][b];
                    lo[a] = v < lo[a] ? v : lo[a];
                    hi[a] = v > hi[a] ? v : hi[a];
                }
        }
    }
    return lo[0] > hi[0];
}

static int make_world(world *w, const gi_options *o, sup_error *err) {
    const sup_gi_scene *s = &w->scene;
    voxrt_gi_desc d;
    voxrt_error error;
    double lo[3], hi[3], largest = 0.0;
    if (read_scene(w, o, err)) return 1;
    w->pieces = (piece *)sup_alloc(s->thing_count, sizeof *w->pieces);
    w->stale = (sup_mesh *)sup_alloc(s->thing_count, sizeof *w->stale);
    w->lights = (voxrt_gi_light *)sup_alloc(s->lamp_count + 1, sizeof *w->lights);
    w->parts = (voxrt_geometry *)sup_alloc(s->thing_count, sizeof *w->parts);
    if (!w->pieces || !w->stale || !w->lights || !w->parts) return sup_fail(err, "out of memory");
    memset(w->pieces, 0, s->thing_count * sizeof *w->pieces);
    memset(w->stale, 0, s->thing_count * sizeof *w->stale);
    w->piece_count = s->thing_count;
    for (size_t i = 0; i < s->thing_count; i++) {
        const sup_gi_thing *t = &s->things[i];
        voxrt_gi_object *object = &w->pieces[i].object;
        w->pieces[i].frame = -1;
        object->still = !t->moving;
        object->mode = (voxrt_columns_mode)(t->voxels ? t->voxels - 1 : o->voxels);
        object->spacing = (float)t->spacing;
        if (t->material < 0) continue;
        for (int a = 0; a < 3; a++) {
            object->material.specular[a] = (float)s->materials[t->material].specular[a];
            object->material.emission[a] = (float)s->materials[t->material].emission[a];
            w->glow |= object->material.emission[a] > 0.0f;
        }
        object->material.exponent = (float)s->materials[t->material].exponent;
        w->shine |= object->material.exponent > 0.0f;
    }
    while (o->camera != NULL && w->which < s->camera_count && strcmp(s->cameras[w->which].name, o->camera) != 0) w->which++;
    if (w->which == s->camera_count) return sup_fail(err, "%s: there is no camera %s", w->name, o->camera);
    if (pose(w, o, 0.0, err)) return 1;
    if (world_box(w, lo, hi)) return sup_fail(err, "%s: no triangles", w->name);
    memset(&d, 0, sizeof d);
    memset(&error, 0, sizeof error);
    for (int a = 0; a < 3; a++) largest = fmax(largest, hi[a] - lo[a]);
    for (int a = 0; a < 3; a++) {
        /* what is flat needs room, too: voxels that the camera sees lie a little beside it */
        const double pad = fmax(0.012 * (hi[a] - lo[a]), 0.5 * (0.125 * largest - (hi[a] - lo[a]))) + 1e-6, part = ldexp(1.0, 1 - (int)o->nested);
        const double middle = 0.5 * (lo[a] + hi[a]), half = (0.5 * (hi[a] - lo[a]) + pad) * (o->nested > 1 ? 1.25 * part : 1.0);
        w->box[a] = lo[a];
        w->box[3 + a] = hi[a];
        d.columns.box_min[a] = middle - half;
        d.columns.box_max[a] = middle + half;
    }
    d.columns.size_x = d.columns.size_y = (uint32_t)o->grid;
    d.columns.size_z = o->depth != 0 ? (uint32_t)o->depth : o->grid > 256 ? 256 : o->grid < 64 ? 64 : 128;
    d.nested = (uint32_t)o->nested;
    d.env.thread_count = (uint32_t)o->common.threads;
    d.env.error = &error;
    if (voxrt_gi_create(&d, &w->gi) != VOXRT_OK) return sup_fail(err, "%s", error.text[0] ? error.text : "the scene has no box");
    if (o->keep > 0 && voxrt_gi_history_create(NULL, &w->history) != VOXRT_OK) return sup_fail(err, "out of memory");
    for (size_t i = 0; i < w->piece_count; i++)
        if (voxrt_gi_add(w->gi, &w->pieces[i].object, &w->pieces[i].id) != VOXRT_OK)
            return sup_fail(err, "%s: %s", s->things[i].file, error.text[0] ? error.text : "out of memory");
    return 0;
}

/* --save, --export */
static int write_scene(world *w, const gi_options *o, sup_error *err) {
    sup_gi_scene *s = &w->scene;
    if (o->save != NULL) {
        sup_gi_camera *c = &s->cameras[w->which];
        const char *slash = strrchr(w->name, '/'), *to = strrchr(o->save, '/');
        const size_t from_length = slash ? (size_t)(slash - w->name) : 0, to_length = to ? (size_t)(to - o->save) : 0;
        char folder[4096] = "", here[2048] = "";
        for (int a = 0; a < 3; a++) {
            if (o->common.has_eye) c->eye[a] = (double)o->common.camera.eye[a];
            if (o->common.has_at) c->at[a] = (double)o->common.camera.at[a];
            if (o->common.has_up) c->up[a] = (double)o->common.camera.up[a];
        }
        if (o->common.has_eye) c->path = -1;
        if (o->common.has_at) c->at_path = -1;
        if (o->common.has_fov) c->fov = o->common.fov;
        for (size_t i = 0; i < s->thing_count; i++) {
            sup_gi_thing *t = &s->things[i];
            if (o->has_voxels && !t->voxels) t->voxels = o->voxels + 1;
            if (w->of_mesh && strcmp(t->file, "mesh") == 0) {
                const char *name = slash ? slash + 1 : w->name;
                char *copy = (char *)sup_alloc(strlen(name) + 1, 1);
                if (copy == NULL) return sup_fail(err, "out of memory");
                memcpy(copy, name, strlen(name) + 1);
                SUP_FREE(t->file);
                t->file = copy;
            }
        }
        if (from_length != to_length || strncmp(w->name, o->save, from_length) != 0) { /* files are looked for beside the scene */
#if !defined(_WIN32)
            if (w->name[0] != '/' && getcwd(here, sizeof here) == NULL) return sup_fail(err, "%s: no folder", w->name);
#endif
            (void)snprintf(folder, sizeof folder, "%s%s%.*s", here, here[0] != 0 && from_length != 0 ? "/" : "", (int)from_length, w->name);
        }
        if (sup_gi_scene_write(s, o->save, folder, err)) return 1;
    }
    if (o->export_to != NULL) {
        const double time = s->seconds * (double)o->first / (double)o->frames;
        const sup_mesh **mesh = (const sup_mesh **)sup_alloc(w->piece_count, sizeof *mesh);
        int status;
        if (mesh == NULL) return sup_fail(err, "out of memory");
        status = pose(w, o, time, err);
        for (size_t i = 0; i < w->piece_count; i++) mesh[i] = &w->pieces[i].mesh;
        if (!status) status = sup_gi_export(s, time, mesh, w->box, o->export_to, err);
        SUP_FREE(mesh);
        return status;
    }
    return 0;
}

/* Put everything in its place for the camera and for the light. */
static int place(world *w, const gi_options *o, double t, int first, sup_error *err) {
    int64_t bounces = (o->method == METHOD_DEFAULT || o->method == METHOD_GATHER) ? o->bounces - 1 : 0;
    voxrt_env env;
    if (pose(w, o, t, err)) return 1;
    w->lift = 0.0;
    for (size_t i = 0; i < w->piece_count; i++) {
        piece *p = &w->pieces[i];
        voxrt_tree_info info;
        const double *m = p->object.to_world, scale = sqrt(m[0] * m[0] + m[4] * m[4] + m[8] * m[8]);
        voxrt_tree_get_info(p->tree, &info);
        if (1.5 * info.voxel_size * scale > w->lift) w->lift = 1.5 * info.voxel_size * scale;
        voxrt_tree_geometry(p->tree, &p->instance.geometry);
        memcpy(p->instance.to_world, m, sizeof p->instance.to_world);
        if (voxrt_instance_geometry(&p->instance, &w->parts[i]) != VOXRT_OK) return sup_fail(err, "a matrix has no inverse");
        if (!p->object.still && (p->fresh || memcmp(p->placed, m, sizeof p->placed) != 0) &&
            voxrt_gi_set(w->gi, p->id, &p->object) != VOXRT_OK) return sup_fail(err, "an object is lost");
        memcpy(p->placed, m, sizeof p->placed);
        p->fresh = 0;
        sup_mesh_free(&w->stale[i]);
    }
    voxrt_group_destroy(w->group);
    w->group = NULL;
    if (voxrt_group_create(NULL, w->parts, w->piece_count, &w->group) != VOXRT_OK) return sup_fail(err, "out of memory");
    voxrt_group_geometry(w->group, &w->geometry);
    if (o->nested > 1) {
        double centre[3];
        for (int a = 0; a < 3; a++) centre[a] = (double)w->camera.eye[a] + 0.25 * ((double)w->camera.at[a] - (double)w->camera.eye[a]);
        (void)voxrt_gi_follow(w->gi, centre, NULL);
    }
    if (voxrt_gi_set_lights(w->gi, w->lights, w->scene.lamp_count) != VOXRT_OK)
        return sup_fail(err, "%s: a light has no direction, no area or a wrong angle", w->name);
    if (voxrt_gi_update(w->gi, NULL) != VOXRT_OK) return sup_fail(err, "out of memory for voxels");
    memset(&env, 0, sizeof env);
    env.thread_count = (uint32_t)o->common.threads;
    if (!first && bounces > 0 && o->keep > 0) { /* light goes on from where it was */
        const uint32_t seed = (uint32_t)o->common.seed + 100;
        return voxrt_gi_bounce(w->gi, &env, 16, 0.25f, seed) != VOXRT_OK ? sup_fail(err, "out of memory for light") : 0;
    }
    for (int64_t b = 1; b <= bounces; b++)
        if (voxrt_gi_bounce(w->gi, &env, 16, 0.0f, (uint32_t)o->common.seed + (uint32_t)b) != VOXRT_OK) return sup_fail(err, "out of memory for light");
    return 0;
}

/* ---- pictures -------------------------------------------------------------------------------------------------- */

static void free_buffers(buffers *b) {
    SUP_FREE(b->g.position);
    SUP_FREE(b->g.normal);
    SUP_FREE(b->g.albedo);
    SUP_FREE(b->g.emission);
    SUP_FREE(b->g.specular);
    SUP_FREE(b->g.before);
    SUP_FREE(b->direct);
    SUP_FREE(b->indirect);
    SUP_FREE(b->rgba);
}

static int make_buffers(const gi_options *o, const world *w, uint32_t side, buffers *b) {
    size_t n;
    int ok;
    memset(b, 0, sizeof *b);
    b->g.width = o->common.size[0] * side;
    b->g.height = o->common.size[1] * side;
    n = (size_t)b->g.width * b->g.height;
    b->g.position = (float *)sup_alloc(n, 12);
    b->g.normal = (float *)sup_alloc(n, 12);
    b->g.albedo = (float *)sup_alloc(n, 12);
    if (w->glow) b->g.emission = (float *)sup_alloc(n, 12);
    if (w->shine) b->g.specular = (float *)sup_alloc(n, 16);
    if (o->keep > 0) b->g.before = (float *)sup_alloc(n, 12);
    b->direct = (float *)sup_alloc(n, 12);
    b->indirect = (float *)sup_alloc(n, 12);
    b->rgba = (uint8_t *)sup_alloc(n, 4);
    ok = b->g.width <= 65535 && b->g.height <= 65535 && b->g.position && b->g.normal && b->g.albedo && b->direct && b->indirect && b->rgba;
    return !(ok && (b->g.emission || !w->glow) && (b->g.specular || !w->shine) && (b->g.before || o->keep == 0));
}

/* Cells as cubes: each pixel the face of the cell that its ray enters, its edges dark. */
static void see_cubes(const world *w, const gi_options *o, voxrt_gbuffer *g) {
    const voxrt_columns *columns = voxrt_gi_columns(w->gi);
    voxrt_columns_info info;
    voxrt_columns_get_info(columns, &info);
    (void)o;
    for (uint32_t y = 0; y < g->height; y++)
        for (uint32_t x = 0; x < g->width; x++) {
            const size_t at = (size_t)y * g->width + x;
            voxrt_ray ray;
            voxrt_column_hit hit;
            voxrt_gi_surface s;
            double edge = 1.0;
            memset(g->normal + 3 * at, 0, 12);
            memset(g->position + 3 * at, 0, 12);
            memset(g->albedo + 3 * at, 0, 12);
            if (voxrt_camera_ray(&w->camera, g->width, g->height, x + 0.5, y + 0.5, &ray) != VOXRT_OK) return;
            (void)voxrt_columns_trace(columns, NULL, &ray, &hit, 1);
            if (!(hit.t < INFINITY) || hit.face == 6) continue;
            for (int a = 0; a < 3; a++) g->position[3 * at + (size_t)a] = ray.org[a] + hit.t * ray.dir[a];
            g->normal[3 * at + (hit.face >> 1)] = (hit.face & 1) ? 1.0f : -1.0f;
            for (int a = 0; a < 3; a++) { /* how far from the next edge of the cell, in cells */
                const double q = ((double)g->position[3 * at + info.axis[a]] - columns->origin[a]) / info.cell[a];
                const double f = q - floor(q), d = f < 0.5 ? f : 1.0 - f;
                if (info.axis[a] != hit.face >> 1 && d < edge) edge = d;
            }
            for (int a = 0; a < 3; a++) g->albedo[3 * at + (size_t)a] = 0.5f;
            if (voxrt_gi_get(w->gi, &hit, ray.dir, &s)) memcpy(g->albedo + 3 * at, s.albedo, 12);
            if (edge < 0.06) for (int a = 0; a < 3; a++) g->albedo[3 * at + (size_t)a] *= 0.35f;
        }
}

typedef struct screen { /* where points are in the picture */
    float eye[3], f[3], u[3], d[3], ff, uu, dd;
} screen;

static void open_screen(const world *w, const buffers *b, screen *s) {
    voxrt_ray mid, right, down;
    (void)voxrt_camera_ray(&w->camera, b->g.width, b->g.height, 0.5 * b->g.width, 0.5 * b->g.height, &mid);
    (void)voxrt_camera_ray(&w->camera, b->g.width, b->g.height, 0.5 * b->g.width + 1.0, 0.5 * b->g.height, &right);
    (void)voxrt_camera_ray(&w->camera, b->g.width, b->g.height, 0.5 * b->g.width, 0.5 * b->g.height + 1.0, &down);
    for (int a = 0; a < 3; a++) {
        s->eye[a] = w->camera.eye[a];
        s->f[a] = mid.dir[a];
        s->u[a] = right.dir[a] - mid.dir[a];
        s->d[a] = down.dir[a] - mid.dir[a];
    }
    s->ff = voxrti_dot3(s->f, s->f);
    s->uu = voxrti_dot3(s->u, s->u);
    s->dd = voxrti_dot3(s->d, s->d);
}

/* A dot of (2 r + 1)^2 pixels at a point; as much of it as `hidden` where something is in front. */
static void draw_dot(const screen *s, buffers *b, const float p[3], int r, const float rgb[3], float hidden) {
    float q[3], z, x, y;
    for (int a = 0; a < 3; a++) q[a] = p[a] - s->eye[a];
    z = voxrti_dot3(q, s->f) / s->ff;
    if (!(z > 0.0f)) return;
    x = voxrti_dot3(q, s->u) / (s->uu * z) + 0.5f * (float)b->g.width;
    y = voxrti_dot3(q, s->d) / (s->dd * z) + 0.5f * (float)b->g.height;
    if (!(x > -10.0f && y > -10.0f && x < 1e6f && y < 1e6f)) return;
    for (int j = -r; j <= r; j++)
        for (int k = -r; k <= r; k++) {
            const int px = (int)floorf(x) + k, py = (int)floorf(y) + j;
            size_t at;
            float e[3], part = 1.0f;
            if (px < 0 || py < 0 || px >= (int)b->g.width || py >= (int)b->g.height) continue;
            at = (size_t)py * b->g.width + (size_t)px;
            for (int a = 0; a < 3; a++) e[a] = b->g.position[3 * at + (size_t)a] - s->eye[a];
            if (voxrti_dot3(e, s->f) / s->ff < z * 0.97f && voxrti_dot3(b->g.normal + 3 * at, b->g.normal + 3 * at) > 0.5f) part = hidden;
            for (int a = 0; a < 3; a++) {
                float *to = &b->direct[3 * at + (size_t)a];
                *to += part * (rgb[a] - *to);
            }
        }
}

/* Virtual lights as dots of their colour, where nothing hides them, and a line along their normal. */
static void show_lights(const world *w, buffers *b) {
    const size_t n = voxrt_gi_virtual_lights(w->gi, NULL, 0);
    float *v = (float *)sup_alloc(n + 1, 9 * sizeof(float)), most = 1e-20f;
    screen s;
    if (v == NULL) return;
    (void)voxrt_gi_virtual_lights(w->gi, v, n);
    for (size_t i = 0; i < n; i++) for (int a = 6; a < 9; a++) most = v[9 * i + (size_t)a] > most ? v[9 * i + (size_t)a] : most;
    open_screen(w, b, &s);
    for (size_t i = 0; i < n; i++)
        for (int step = 0; step < 12; step++) {
            const float *p = v + 9 * i, along = 0.02f * (float)step * (float)w->lift * 10.0f;
            float q[3], rgb[3];
            if (p[6] + p[7] + p[8] <= 0.0f) break;
            for (int a = 0; a < 3; a++) {
                q[a] = p[a] + along * p[3 + a];
                rgb[a] = 0.15f + 0.85f * p[6 + a] / most;
            }
            draw_dot(&s, b, q, step == 0 ? 2 : 0, rgb, 0.0f);
        }
    SUP_FREE(v);
}

static void draw_line(const screen *s, buffers *b, const float p[3], const float q[3], int r, const float rgb[3]) {
    enum { DOTS = 1500 };
    for (int i = 0; i <= DOTS; i++) {
        float at[3];
        for (int a = 0; a < 3; a++) at[a] = p[a] + (q[a] - p[a]) * (float)i / (float)DOTS;
        draw_dot(s, b, at, r, rgb, 0.25f);
    }
}

/* What the ray that a mirror at a pixel would send looks at, column by column. */
static int show_steps(const world *w, const gi_options *o, buffers *b, uint32_t side, sup_error *err) {
    static const float colour[3][3] = {{0.05f, 0.7f, 0.1f}, {0.9f, 0.06f, 0.04f}, {1.0f, 0.8f, 0.05f}}, line[3] = {0.1f, 0.3f, 1.0f};
    const voxrt_columns *columns = voxrt_gi_columns(w->gi);
    const size_t at = ((size_t)o->at[1] * side + side / 2) * b->g.width + (size_t)o->at[0] * side + side / 2;
    const int r = (int)side / 2;
    voxrt_columns_trace_desc d;
    voxrt_columns_info info;
    voxrt_column_step *step;
    voxrt_column_hit hit;
    voxrt_ray ray;
    screen s;
    float to[3], twice = 0.0f;
    size_t n;
    open_screen(w, b, &s);
    if (!(voxrti_dot3(b->g.normal + 3 * at, b->g.normal + 3 * at) > 0.5f)) return sup_fail(err, "--pixel: there is no surface");
    memset(&ray, 0, sizeof ray);
    for (int a = 0; a < 3; a++) {
        ray.org[a] = b->g.position[3 * at + (size_t)a];
        ray.dir[a] = ray.org[a] - w->camera.eye[a];
        twice += 2.0f * ray.dir[a] * b->g.normal[3 * at + (size_t)a];
    }
    for (int a = 0; a < 3; a++) ray.dir[a] -= twice * b->g.normal[3 * at + (size_t)a];
    ray.t_max = o->radius > 0.0 ? (float)o->radius / sqrtf(voxrti_dot3(ray.dir, ray.dir)) : INFINITY;
    memset(&d, 0, sizeof d);
    d.normals = b->g.normal + 3 * at;
    n = voxrt_columns_explain(columns, &d, &ray, NULL, 0, &hit);
    step = (voxrt_column_step *)sup_alloc(n + 1, sizeof *step);
    if (step == NULL) return sup_fail(err, "out of memory");
    (void)voxrt_columns_explain(columns, &d, &ray, step, n, &hit);
    if (o->steps != 0 && (size_t)o->steps < n) n = (size_t)o->steps;
    voxrt_columns_get_info(columns, &info);
    for (size_t i = 0; i < n; i++) { /* the edges of what it looks at */
        const voxrt_column_step *q = &step[i];
        float lo[3], hi[3];
        for (int a = 0; a < 3; a++) {
            const double from = a < 2 ? (double)(q->column[a] << q->level) : (double)q->depth[0];
            const double end = a < 2 ? (double)((q->column[a] + 1) << q->level) : (double)q->depth[1] + 1.0;
            lo[info.axis[a]] = (float)(columns->origin[a] + from * info.cell[a]);
            hi[info.axis[a]] = (float)(columns->origin[a] + end * info.cell[a]);
        }
        for (int e = 0; e < 12; e++) {
            float p[2][3];
            for (int k = 0; k < 2; k++)
                for (int a = 0; a < 3; a++) {
                    const int bit = a == e % 3 ? k : a == (e + 1) % 3 ? (e / 3) & 1 : e / 6;
                    p[k][a] = bit ? hi[a] : lo[a];
                }
            draw_line(&s, b, p[0], p[1], r, colour[q->found]);
        }
    }
    for (int a = 0; a < 3; a++) to[a] = ray.org[a] + (n != 0 ? step[n - 1].t_out : 0.0f) * ray.dir[a];
    if (n != 0 && step[n - 1].found == 2) for (int a = 0; a < 3; a++) to[a] = ray.org[a] + hit.t * ray.dir[a];
    draw_line(&s, b, ray.org, to, r, line);
    SUP_FREE(step);
    return 0;
}

static int light_picture(world *w, const gi_options *o, buffers *b, voxrt_gi_render_desc *d, timing *spent, sup_error *err) {
    voxrt_gi_report report;
    voxrt_stats stats;
    voxrt_result r;
    sup_progress progress;
    const size_t n = (size_t)b->g.width * b->g.height;
    memset(&stats, 0, sizeof stats);
    d->report = &report;
    if (o->budget > 0.0) {
        (void)voxrt_gi_budget_update(&w->budget, NULL, 0.0f, 0.0f, 0.0f);
        d->rays = w->budget.rays;
        d->coarse = w->budget.coarse;
    }
    sup_progress_begin(&progress, "light", o->common.quiet);
    if (!progress.quiet) {
        d->env.progress_fn = sup_progress_fn;
        d->env.progress_user = &progress;
    }
    r = voxrt_gi_render(d, w->gi, &b->g, b->direct, b->indirect, &stats);
    sup_progress_end(&progress);
    d->env.progress_fn = NULL;
    if (r != VOXRT_OK) return sup_fail(err, "%s", voxrt_result_string(r));
    if (o->view == VIEW_LOOKUP) { /* maps, then rays */
        voxrt_gi_render_desc plain = *d;
        float *other = b->indirect;
        plain.lookup = VOXRT_GI_LOOKUP_RAYS;
        plain.history = NULL;
        (void)voxrt_gi_render(&plain, w->gi, &b->g, other, NULL, NULL);
        for (size_t i = 0; i < n; i++) {
            const float lit = b->direct[3 * i + 1], should = other[3 * i + 1];
            const float grey = 0.15f + 0.5f * (lit < should ? lit : should);
            b->direct[3 * i] = grey + (lit > should * 1.02f + 1e-4f ? 0.8f : 0.0f);
            b->direct[3 * i + 1] = grey;
            b->direct[3 * i + 2] = grey + (lit < should * 0.98f - 1e-4f ? 0.8f : 0.0f);
            other[3 * i] = other[3 * i + 1] = other[3 * i + 2] = 0.0f;
        }
    }
    spent->rays += stats.rays;
    spent->shaded += report.pixels != 0 ? (double)report.shaded / (double)report.pixels : 0.0;
    spent->noise += (double)report.noise;
    spent->kept += (double)report.kept;
    spent->per_pixel += (double)report.rays;
    return 0;
}

/* Lamps with an area are seen: they are no meshes, and so not in the G-buffer. */
static void show_lamps(const world *w, buffers *b) {
    for (size_t i = 0; i < w->scene.lamp_count; i++) {
        const voxrt_gi_light *l = &w->lights[i];
        const float *u = l->edge_u, *v = l->edge_v;
        const float n[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
        if (l->kind != VOXRT_GI_AREA) continue;
        for (uint32_t y = 0; y < b->g.height; y++)
            for (uint32_t x = 0; x < b->g.width; x++) {
                const size_t at = 3 * ((size_t)y * b->g.width + x);
                voxrt_ray ray;
                float side = 0.0f, down = 0.0f, along[2] = {0, 0}, size[2] = {0, 0}, depth = 0.0f, t;
                if (voxrt_camera_ray(&w->camera, b->g.width, b->g.height, x + 0.5, y + 0.5, &ray) != VOXRT_OK) return;
                for (int a = 0; a < 3; a++) {
                    side += n[a] * (l->position[a] - ray.org[a]);
                    down += n[a] * ray.dir[a];
                    depth += ray.dir[a] * ray.dir[a];
                }
                t = side / down;
                if (!(down < 0.0f && t > 0.0f)) continue;
                if (b->g.normal[at] != 0.0f || b->g.normal[at + 1] != 0.0f || b->g.normal[at + 2] != 0.0f) {
                    float surface = 0.0f;
                    for (int a = 0; a < 3; a++) surface += ray.dir[a] * (b->g.position[at + (size_t)a] - ray.org[a]) / depth;
                    if (t > surface) continue;
                }
                for (int a = 0; a < 3; a++) {
                    const float p = ray.org[a] + t * ray.dir[a] - l->position[a];
                    along[0] += p * u[a];
                    along[1] += p * v[a];
                    size[0] += u[a] * u[a];
                    size[1] += v[a] * v[a];
                }
                if (fabsf(along[0]) > size[0] || fabsf(along[1]) > size[1]) continue;
                memcpy(b->direct + at, l->color, sizeof l->color);
            }
    }
}

static int draw(world *w, const gi_options *o, buffers *b, double t, int first, timing *spent, sup_error *err) {
    static const voxrt_gi_method method[6] = {VOXRT_GI_GATHER, VOXRT_GI_GATHER, VOXRT_GI_PATH, VOXRT_GI_VPL, VOXRT_GI_AO, VOXRT_GI_NONE};
    voxrt_gi_render_desc d;
    voxrt_result r;
    const size_t n = (size_t)b->g.width * b->g.height;
    const double start = sup_now();
    double now, light;
    const int voxels = o->view == VIEW_VOXELS || o->view == VIEW_CUBES || o->view == VIEW_LOOKUP || o->view == VIEW_STEPS;
    memset(&d, 0, sizeof d);
    if (place(w, o, t, first, err)) return 1;
    now = sup_now();
    spent->update += now - start;
    d.env.thread_count = (uint32_t)o->common.threads;
    r = voxels ? voxrt_gbuffer_from_gi(&d.env, &w->camera, w->gi, &b->g) : voxrt_gbuffer_from_geometry(&d.env, &w->camera, &w->geometry, &b->g);
    if (r != VOXRT_OK) return sup_fail(err, "no camera: eye and at are the same, or the angle is out of range");
    if (!voxels) (void)voxrt_gbuffer_edges(&d.env, &w->camera, w->gi, &b->g);
    if (o->view == VIEW_CUBES) see_cubes(w, o, &b->g);
    if (w->shine || w->glow || b->g.before != NULL) (void)voxrt_gbuffer_materials(&d.env, w->gi, &b->g);
    light = sup_now();
    spent->gbuffer += light - now;
    d.isa = (voxrt_isa)o->common.isa;
    d.method = method[o->method];
    d.lookup = (voxrt_gi_lookup)o->lookup;
    if (o->view == VIEW_LOOKUP) d.lookup = VOXRT_GI_LOOKUP_MAPS;
    d.camera = w->camera;
    d.rays = (uint32_t)((o->rays + o->aa - 1) / o->aa);
    d.bounces = (uint32_t)o->bounces;
    d.radius = (float)o->radius;
    d.filter = (uint32_t)o->filter;
    d.direct_filter = (uint32_t)o->shadow_filter;
    d.coarse = (uint32_t)o->coarse;
    d.pattern = (uint32_t)o->pattern;
    d.d_min = (float)o->d_min;
    d.relief = (float)o->relief;
    if (o->common.has_tolerance && o->budget == 0.0) {
        d.tolerance = (float)o->common.tolerance;
        if (!o->has_rays) d.rays = 0;
    }
    d.first_ray = (uint32_t)o->common.seed * d.rays;
    d.history = w->history;
    d.keep = (float)o->keep;
    if (!voxels) d.shadow = &w->geometry;
    d.shadow_lift = (float)w->lift;
    w->budget.most = d.rays;
    if (light_picture(w, o, b, &d, spent, err)) return 1;
    now = sup_now();
    spent->light += now - light;
    spent->all += now - start;
    if (o->budget > 0.0)
        (void)voxrt_gi_budget_update(&w->budget, d.report, (float)(1e3 * (now - start)), (float)(1e3 * (now - light)), (float)o->budget);
    for (size_t i = 0; i < 3 * n; i++) {
        if (o->view == VIEW_DIRECT) b->indirect[i] = 0.0f;
        if (o->view == VIEW_INDIRECT || o->method == METHOD_AO) b->direct[i] = 0.0f;
        b->direct[i] += b->indirect[i];
        if (b->direct[i] > (float)spent->brightest) spent->brightest = (double)b->direct[i];
        if (o->common.unlit) b->direct[i] = b->g.albedo[i] * (float)w->scene.white;
        if (o->view == VIEW_LIGHTS || o->view == VIEW_STEPS) b->direct[i] *= 0.4f;
    }
    if (!voxels && o->view != VIEW_INDIRECT && o->method != METHOD_AO) show_lamps(w, b);
    r = voxrt_tone_map((voxrt_tone)o->tone, o->method == METHOD_AO ? 1.0f : (float)(w->scene.white / o->exposure), b->direct, b->direct, n);
    if (o->view == VIEW_LIGHTS) show_lights(w, b);
    if (o->view == VIEW_STEPS && show_steps(w, o, b, b->g.width / o->common.size[0], err)) return 1;
    return r != VOXRT_OK;
}

/* Means of side x side samples: bytes in sRGB, or floats. */
static int write_frame(const gi_options *o, const buffers *b, uint32_t side, const char *path, sup_error *err) {
    const uint32_t width = o->common.size[0], height = o->common.size[1];
    const int linear = sup_out_is_linear(&o->common);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            double rgb[3] = {0.0, 0.0, 0.0}, seen = 0.0;
            const size_t to = (size_t)y * width + x;
            for (uint32_t j = 0; j < side; j++)
                for (uint32_t i = 0; i < side; i++) {
                    const size_t at = ((size_t)y * side + j) * b->g.width + x * side + i;
                    const float *n = b->g.normal + 3 * at;
                    if (!(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] > 0.5f)) continue;
                    for (int a = 0; a < 3; a++) rgb[a] += (double)b->direct[3 * at + (size_t)a];
                    seen += 1.0;
                }
            for (int a = 0; a < 3; a++) {
                if (linear) b->indirect[3 * to + (size_t)a] = (float)(rgb[a] / (double)(side * side));
                b->rgba[4 * to + (size_t)a] = (uint8_t)(255.0 * voxrti_linear_to_srgb(seen > 0.0 ? rgb[a] / seen : 0.0) + 0.5);
            }
            b->rgba[4 * to + 3] = (uint8_t)(255.0 * seen / (double)(side * side) + 0.5);
        }
    if (linear) return sup_pfm_write(path, b->indirect, width, height, 3, err);
    return sup_png_write8(path, b->rgba, width, height, 4, err);
}

/* Distance along the viewing axis of the first sample of each pixel; infinite where there is nothing. */
static int write_depth(const gi_options *o, const world *w, buffers *b, uint32_t side, const char *path, sup_error *err) {
    const uint32_t width = o->common.size[0], height = o->common.size[1];
    voxrt_ray mid;
    (void)voxrt_camera_ray(&w->camera, 2, 2, 1.0, 1.0, &mid);
    (void)voxrti_normalize(mid.dir);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            const size_t at = ((size_t)y * side + side / 2) * b->g.width + x * side + side / 2;
            float d[3];
            for (int a = 0; a < 3; a++) d[a] = b->g.position[3 * at + (size_t)a] - w->camera.eye[a];
            b->indirect[(size_t)y * width + x] = voxrti_dot3(b->g.normal + 3 * at, b->g.normal + 3 * at) > 0.5f ? voxrti_dot3(d, mid.dir) : INFINITY;
        }
    return sup_pfm_write(path, b->indirect, width, height, 1, err);
}

static void print_stats(const gi_options *o, const world *w, uint32_t side, const timing *spent) {
    const double n = (double)((o->frames - o->first) * o->still);
    voxrt_columns_info info;
    voxrt_columns_get_info(voxrt_gi_columns(w->gi), &info);
    printf("{\"program\":\"voxrt_gi\",\"in\":");
    sup_json_string(stdout, o->scene);
    printf(",\"width\":%u,\"height\":%u,\"samples\":%u,\"frames\":%d,\"grid\":[%u,%u,%u],\"cells\":%llu,\"rays\":%llu", o->common.size[0],
           o->common.size[1], side * side, (int)(o->frames - o->first), info.size[0], info.size[1], info.size[2], (unsigned long long)info.cells,
           (unsigned long long)spent->rays);
    printf(",\"brightest\":%.6g", spent->brightest); /* shown only: a white that follows it would make pictures pump */
    printf(",\"rays_per_sample\":%.2f,\"shaded\":%.4f,\"noise\":%.6f,\"kept\":%.4f",
           spent->per_pixel / n, spent->shaded / n, spent->noise / n, spent->kept / n);
    printf(",\"update_seconds\":%.6f,\"gbuffer_seconds\":%.6f,\"light_seconds\":%.6f,\"seconds\":%.6f}\n",
           spent->update, spent->gbuffer, spent->light, spent->all);
}

int main(int argc, char **argv) {
    gi_options o;
    world w;
    buffers b;
    timing spent;
    sup_error err;
    char path[4096];
    uint32_t side = 1;
    int draws, status = parse(argc, argv, &o);
    if (status >= 0) return status;
    while ((int64_t)side * side < o.aa) side++;
    if (o.common.out != NULL && sup_frame_path(o.common.out, 0, o.frames - o.first, path, sizeof path))
        return sup_bad_usage(argv[0], "--out: \"%s\" needs one %%d or %%03d for the number of the frame", o.common.out);
    memset(&w, 0, sizeof w);
    memset(&b, 0, sizeof b);
    memset(&spent, 0, sizeof spent);
    w.name = o.scene;
    status = make_world(&w, &o, &err);
    if (!status) status = write_scene(&w, &o, &err);
    draws = o.common.out != NULL || o.common.depth != NULL || o.common.stats;
    if (!status && draws && make_buffers(&o, &w, side, &b)) status = sup_fail(&err, "out of memory for the picture");
    for (int64_t f = o.first; f < o.frames && draws && !status; f++) {
        for (int64_t k = 0; k < o.still && !status; k++)
            status = draw(&w, &o, &b, w.scene.seconds * (double)f / (double)o.frames, f == o.first && k == 0, &spent, &err);
        if (!status && o.common.out != NULL) {
            (void)sup_frame_path(o.common.out, f, o.frames - o.first, path, sizeof path);
            status = write_frame(&o, &b, side, path, &err);
        }
        if (!status && o.common.depth != NULL && f + 1 == o.frames) status = write_depth(&o, &w, &b, side, o.common.depth, &err);
    }
    if (status) (void)sup_bad_input(argv[0], err.text);
    if (!status && o.common.stats) print_stats(&o, &w, side, &spent);
    free_buffers(&b);
    free_world(&w);
    return status;
}
