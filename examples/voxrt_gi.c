/* voxrt_gi.c - a scene that may move -> pictures with the light that bounces between its surfaces
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/camera.h"
#include "support/cli.h"
#include "support/mesh.h"
#include "support/mesh_obj.h"
#include "support/mesh_off.h"
#include "support/mesh_ply.h"
#include "support/mesh_stl.h"
#include "support/png.h"
#include "support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"

enum { MAX_PIECES = 16, MAX_LIGHTS = 8 };
enum { METHOD_DEFAULT, METHOD_GATHER, METHOD_PATH, METHOD_AO, METHOD_NONE };
enum { VIEW_PICTURE, VIEW_DIRECT, VIEW_INDIRECT, VIEW_VOXELS };

typedef struct gi_options {
    sup_common common;
    const char *scene;
    int method, tone, view;
    int64_t frames, rays, bounces, grid, res, filter, aa;
    double radius, exposure;
} gi_options;

typedef struct piece { /* an object: its triangles for the light that bounces, its voxels for what the camera sees */
    sup_mesh mesh;
    voxrt_tree *tree;
    voxrt_instance instance;
    voxrt_gi_object object;
    uint32_t id;
} piece;

typedef struct world {
    piece pieces[MAX_PIECES];
    size_t piece_count;
    voxrt_gi_light lights[MAX_LIGHTS];
    size_t light_count;
    voxrt_gi *gi;
    voxrt_group *group;
    voxrt_geometry geometry;
    sup_camera camera;
    float lo[3], hi[3], most; /* box; what is shown white */
    double lift;
    const char *name;
} world;

typedef struct buffers {
    voxrt_gbuffer g;
    float *direct, *indirect;
    uint8_t *rgba;
} buffers;

typedef struct timing { double update, gbuffer, light, all; uint64_t rays; } timing;

static int parse(int argc, char **argv, gi_options *o) {
    sup_option table[SUP_COMMON_OPTIONS + 16];
    size_t n;
    int status;
    memset(o, 0, sizeof *o);
    o->scene = "cornell";
    o->frames = 1;
    o->rays = 64;
    o->bounces = 3;
    o->grid = 256;
    o->res = 0;
    o->filter = 3;
    o->aa = 4;
    o->exposure = 1.0;
    n = sup_common_options(&o->common, table);
    o->common.size[0] = 768;
    o->common.size[1] = 512;
    table[n++] = sup_opt_text("scene", &o->scene, "cornell|atrium|FILE", "generated, or a mesh file, which stands on a plane (cornell)");
    table[n++] = sup_opt_choice("method", &o->method, "default|gather|path|ao|none",
                                "how indirect light is found; default: gather, with light on cells that has bounced before");
    table[n++] = sup_opt_int("frames", &o->frames, 1, 100000, "N", "pictures of the scene as it moves; FILE of --out has a %d for the number");
    table[n++] = sup_opt_int("rays", &o->rays, 1, 65536, "N", "rays over the hemisphere of a pixel (64)");
    table[n++] = sup_opt_int("bounces", &o->bounces, 1, 64, "N", "how often light is followed (3)");
    table[n++] = sup_opt_real("radius", &o->radius, 0.0, 1e9, "R", "length of the rays, world units (all)");
    table[n++] = sup_opt_int("filter", &o->filter, 0, 64, "R", "radius of the filter of indirect light in pixels, 0: none (3)");
    table[n++] = sup_opt_int("aa", &o->aa, 1, 16, "N", "samples a pixel: 1, 4, 9 or 16 (4)");
    table[n++] = sup_opt_int("grid", &o->grid, 16, 2048, "N", "columns along each side, a power of two (256)");
    table[n++] = sup_opt_int("res", &o->res, 16, 8192, "N", "voxels along the longest side of an object that the camera sees (1024; atrium 2048)");
    table[n++] = sup_opt_choice("tone", &o->tone, "linear|log|drago", "tone mapping");
    table[n++] = sup_opt_real("exposure", &o->exposure, 1e-6, 1e6, "E", "brightness, times the scene's own (1)");
    table[n++] = sup_opt_choice("view", &o->view, "picture|direct|indirect|voxels", "parts of the picture; what the rays of indirect light see");
    status = sup_cli_parse(argc, argv, "Draws a scene with global illumination.", table, n);
    if (status >= 0) return status;
    if (o->common.out == NULL && !o->common.stats) return sup_bad_usage(argv[0], "--out FILE is missing");
    if ((o->grid & (o->grid - 1)) != 0) return sup_bad_usage(argv[0], "--grid: %d is no power of two", (int)o->grid);
    if (o->aa != 1 && o->aa != 4 && o->aa != 9 && o->aa != 16) return sup_bad_usage(argv[0], "--aa: %d is not 1, 4, 9 or 16", (int)o->aa);
    return -1;
}

static void to_world(double m[12], double scale, double turn, double x, double y, double z) { /* turned about y */
    const double c = cos(turn) * scale, s = sin(turn) * scale, rows[12] = {c, 0, s, x, 0, scale, 0, y, -s, 0, c, z};
    memcpy(m, rows, sizeof rows);
}

/* One colour for a mesh that has none, or instead of its own. */
static int paint(sup_mesh *mesh, const uint8_t rgb[3]) {
    SUP_FREE(mesh->triangle_rgb);
    mesh->triangle_rgb = NULL;
    if (mesh->vertex_rgb == NULL) mesh->vertex_rgb = (uint8_t *)sup_alloc(mesh->vertex_count, 3);
    if (mesh->vertex_rgb == NULL) return 1;
    for (size_t i = 0; i < mesh->vertex_count; i++) memcpy(mesh->vertex_rgb + 3 * i, rgb, 3);
    return 0;
}

/* Add a mesh, which goes over to the world, and voxelise it for the camera. rgb NULL: it keeps its colours. */
static int add_piece(world *w, const gi_options *o, sup_mesh *mesh, int still, const uint8_t *rgb, sup_error *err) {
    piece *p = &w->pieces[w->piece_count];
    voxrt_build_desc build;
    voxrt_error error;
    voxrt_mesh *m = &p->object.mesh;
    memset(p, 0, sizeof *p);
    memset(&build, 0, sizeof build);
    memset(&error, 0, sizeof error);
    p->mesh = *mesh;
    memset(mesh, 0, sizeof *mesh);
    w->piece_count++;
    if (rgb != NULL && paint(&p->mesh, rgb)) return sup_fail(err, "%s: out of memory", w->name);
    m->positions = p->mesh.positions;
    m->vertex_count = p->mesh.vertex_count;
    m->indices = p->mesh.indices;
    m->triangle_count = p->mesh.triangle_count;
    m->normals = p->mesh.normals;
    m->vertex_rgb = p->mesh.vertex_rgb;
    m->triangle_rgb = p->mesh.triangle_rgb;
    p->object.still = still != 0;
    to_world(p->object.to_world, 1.0, 0.0, 0.0, 0.0, 0.0);
    build.resolution = o->res != 0 ? (uint32_t)o->res : !still ? 512 : strcmp(w->name, "atrium") == 0 ? 2048 : 1024;
    build.env.thread_count = (uint32_t)o->common.threads;
    build.env.error = &error;
    if (voxrt_tree_build(&build, m, NULL, &p->tree) != VOXRT_OK)
        return sup_fail(err, "%s: %s", w->name, error.text[0] ? error.text : "nothing to draw");
    return 0;
}

static void free_world(world *w) {
    voxrt_group_destroy(w->group);
    voxrt_gi_destroy(w->gi);
    for (size_t i = 0; i < w->piece_count; i++) {
        voxrt_tree_destroy(w->pieces[i].tree);
        sup_mesh_free(&w->pieces[i].mesh);
    }
}

static int add_scene(world *w, const gi_options *o, const char *name, int detail, int still, const uint8_t *rgb, sup_error *err) {
    sup_mesh mesh;
    if (sup_scene_make(name, detail, &mesh)) return sup_fail(err, "%s: out of memory", name);
    return add_piece(w, o, &mesh, still, rgb, err);
}

static void area_light(world *w, float x, float y, float z, float half, float power) {
    voxrt_gi_light *l = &w->lights[w->light_count++];
    memset(l, 0, sizeof *l);
    l->kind = VOXRT_GI_AREA;
    l->position[0] = x;
    l->position[1] = y;
    l->position[2] = z;
    l->edge_u[0] = l->edge_v[2] = half;
    l->color[0] = power;
    l->color[1] = power * 0.85f;
    l->color[2] = power * 0.6f;
}

static int make_cornell(world *w, const gi_options *o, sup_error *err) {
    static const uint8_t blue[3] = {110, 150, 225};
    const float eye[3] = {2.78f, 2.73f, 8.0f}, at[3] = {2.78f, 2.73f, -2.8f};
    if (add_scene(w, o, "cornell", 0, 1, NULL, err)) return 1;
    if (o->frames > 1 && add_scene(w, o, "sphere", 32, 0, blue, err)) return 1;
    area_light(w, 2.78f, 5.44f, -2.795f, 0.55f, 22.0f);
    memcpy(w->camera.eye, eye, sizeof eye);
    memcpy(w->camera.at, at, sizeof at);
    w->camera.fov = 38.0f;
    w->most = 1.1f;
    return 0;
}

static int make_atrium(world *w, const gi_options *o, sup_error *err) {
    static const uint8_t red[3] = {214, 70, 48}, gold[3] = {226, 178, 72};
    const float eye[3] = {-0.2f, 2.2f, 16.0f}, at[3] = {-0.6f, 2.9f, 0.0f};
    if (add_scene(w, o, "pillars", 0, 1, NULL, err) || add_scene(w, o, "torus", 0, 0, red, err) ||
        add_scene(w, o, "sphere", 32, 0, gold, err)) return 1;
    w->light_count = 2;
    memset(w->lights, 0, 2 * sizeof w->lights[0]);
    memcpy(w->camera.eye, eye, sizeof eye);
    memcpy(w->camera.at, at, sizeof at);
    w->camera.fov = 62.0f;
    w->most = 1.0f;
    return 0;
}

static int make_file(world *w, const gi_options *o, sup_error *err) {
    static const uint8_t grey[3] = {190, 190, 196};
    static const float view[3] = {0.55f, 0.35f, 1.0f};
    static const uint32_t corners[6] = {0, 2, 1, 0, 3, 2};
    sup_mesh mesh, plane;
    float lo[3], hi[3], size = 0.0f;
    voxrt_camera camera;
    double box[2][3];
    if (sup_mesh_read(o->scene, &mesh, err)) return 1;
    if (sup_mesh_bounds(&mesh, lo, hi)) {
        sup_mesh_free(&mesh);
        return sup_fail(err, "%s: no triangles", o->scene);
    }
    for (int a = 0; a < 3; a++) size = hi[a] - lo[a] > size ? hi[a] - lo[a] : size;
    if (add_piece(w, o, &mesh, 1, NULL, err)) return 1;
    memset(&plane, 0, sizeof plane);
    plane.positions = (float *)sup_alloc(12, sizeof(float));
    plane.indices = (uint32_t *)sup_alloc(6, sizeof(uint32_t));
    if (plane.positions == NULL || plane.indices == NULL) {
        sup_mesh_free(&plane);
        return sup_fail(err, "out of memory");
    }
    for (int k = 0; k < 4; k++) {
        plane.positions[3 * k] = 0.5f * (lo[0] + hi[0]) + (k == 0 || k == 3 ? -1.5f : 1.5f) * size;
        plane.positions[3 * k + 1] = lo[1];
        plane.positions[3 * k + 2] = 0.5f * (lo[2] + hi[2]) + (k < 2 ? -1.5f : 1.5f) * size;
    }
    memcpy(plane.indices, corners, sizeof corners);
    plane.vertex_count = 4;
    plane.triangle_count = 2;
    if (add_piece(w, o, &plane, 1, grey, err)) return 1;
    area_light(w, lo[0] - 0.6f * size, hi[1] + size, hi[2] + 0.5f * size, 0.4f * size, 14.0f);
    memset(&camera, 0, sizeof camera);
    for (int a = 0; a < 3; a++) {
        box[0][a] = (double)lo[a];
        box[1][a] = (double)hi[a];
    }
    (void)voxrt_camera_fit(&camera, box[0], box[1], view, o->common.size[0], o->common.size[1]);
    memcpy(w->camera.eye, camera.eye, sizeof camera.eye);
    memcpy(w->camera.at, camera.at, sizeof camera.at);
    w->camera.fov = 40.0f;
    w->most = 1.0f;
    return 0;
}

/* Where everything is at time t in 0..1 of the sequence. */
static void pose(world *w, double t) {
    const double turn = 6.283185307179586 * t;
    if (strcmp(w->name, "cornell") == 0 && w->piece_count > 1)
        to_world(w->pieces[1].object.to_world, 0.55, 0.0, 2.8 + 1.7 * cos(turn), 3.9 + 0.4 * sin(2.0 * turn), -2.6 + 1.3 * sin(turn));
    if (strcmp(w->name, "atrium") == 0) {
        voxrt_gi_light *l = w->lights;
        to_world(w->pieces[1].object.to_world, 1.0, 2.0 * turn, -2.0 + 0.6 * sin(turn), 1.1, 8.0);
        to_world(w->pieces[2].object.to_world, 0.8, 0.0, 1.6 + 0.8 * cos(turn), 0.8, 9.0 + 1.5 * sin(turn));
        for (int i = 0; i < 2; i++) {
            static const float colour[2][3] = {{60.0f, 46.0f, 26.0f}, {26.0f, 36.0f, 60.0f}};
            l[i].kind = VOXRT_GI_POINT;
            l[i].position[0] = (float)((i ? -4.0 : 3.2) + 0.8 * cos(turn));
            l[i].position[1] = 5.2f;
            l[i].position[2] = (float)((i ? 0.0 : 8.0) + 3.0 * sin(turn + i));
            memcpy(l[i].color, colour[i], sizeof colour[i]);
        }
    }
}

static int make_world(world *w, const gi_options *o, sup_error *err) {
    const int still = strcmp(o->scene, "cornell") == 0 ? make_cornell(w, o, err)
        : strcmp(o->scene, "atrium") == 0 ? make_atrium(w, o, err) : make_file(w, o, err);
    voxrt_gi_desc d;
    voxrt_error error;
    if (still) return 1;
    memset(&d, 0, sizeof d);
    memset(&error, 0, sizeof error);
    (void)sup_mesh_bounds(&w->pieces[0].mesh, w->lo, w->hi);
    if (w->piece_count == 2 && strcmp(w->name, "cornell") != 0) { /* a file: the plane, too */
        float lo[3], hi[3];
        (void)sup_mesh_bounds(&w->pieces[1].mesh, lo, hi);
        for (int a = 0; a < 3; a++) {
            w->lo[a] = lo[a] < w->lo[a] ? lo[a] : w->lo[a];
            w->hi[a] = hi[a] > w->hi[a] ? hi[a] : w->hi[a];
        }
    }
    for (int a = 0; a < 3; a++) {
        const double pad = 0.012 * ((double)w->hi[a] - (double)w->lo[a]) + 1e-6;
        d.columns.box_min[a] = (double)w->lo[a] - pad;
        d.columns.box_max[a] = (double)w->hi[a] + pad;
    }
    d.columns.size_x = d.columns.size_y = (uint32_t)o->grid;
    d.columns.size_z = o->grid > 256 ? 256 : o->grid < 64 ? 64 : 128;
    d.env.thread_count = (uint32_t)o->common.threads;
    d.env.error = &error;
    if (voxrt_gi_create(&d, &w->gi) != VOXRT_OK) return sup_fail(err, "%s", error.text[0] ? error.text : "the scene has no box");
    pose(w, 0.0);
    for (size_t i = 0; i < w->piece_count; i++)
        if (voxrt_gi_add(w->gi, &w->pieces[i].object, &w->pieces[i].id) != VOXRT_OK) return sup_fail(err, "out of memory");
    w->camera.up[1] = 1.0f;
    if (o->common.has_eye) memcpy(w->camera.eye, o->common.camera.eye, sizeof w->camera.eye);
    if (o->common.has_at) memcpy(w->camera.at, o->common.camera.at, sizeof w->camera.at);
    if (o->common.has_up) memcpy(w->camera.up, o->common.camera.up, sizeof w->camera.up);
    if (o->common.fov != 40.0) w->camera.fov = (float)o->common.fov;
    return 0;
}

/* Put everything in its place for the camera and for the light. */
static int place(world *w, const gi_options *o, double t, sup_error *err) {
    voxrt_geometry geometry[MAX_PIECES];
    pose(w, t);
    w->lift = 0.0;
    for (size_t i = 0; i < w->piece_count; i++) {
        piece *p = &w->pieces[i];
        voxrt_tree_info info;
        double scale = sqrt(p->object.to_world[0] * p->object.to_world[0] + p->object.to_world[8] * p->object.to_world[8]);
        voxrt_tree_get_info(p->tree, &info);
        if (1.5 * info.voxel_size * scale > w->lift) w->lift = 1.5 * info.voxel_size * scale;
        voxrt_tree_geometry(p->tree, &p->instance.geometry);
        memcpy(p->instance.to_world, p->object.to_world, sizeof p->instance.to_world);
        if (voxrt_instance_geometry(&p->instance, &geometry[i]) != VOXRT_OK) return sup_fail(err, "a matrix has no inverse");
        if (!p->object.still && voxrt_gi_set(w->gi, p->id, &p->object) != VOXRT_OK) return sup_fail(err, "an object is lost");
    }
    voxrt_group_destroy(w->group);
    w->group = NULL;
    if (voxrt_group_create(NULL, geometry, w->piece_count, &w->group) != VOXRT_OK) return sup_fail(err, "out of memory");
    voxrt_group_geometry(w->group, &w->geometry);
    if (voxrt_gi_set_lights(w->gi, w->lights, w->light_count) != VOXRT_OK) return sup_fail(err, "a light is none");
    if (voxrt_gi_update(w->gi, NULL) != VOXRT_OK) return sup_fail(err, "out of memory for voxels");
    for (int64_t b = 1; b < o->bounces && (o->method == METHOD_DEFAULT || o->method == METHOD_GATHER); b++) {
        voxrt_env env;
        memset(&env, 0, sizeof env);
        env.thread_count = (uint32_t)o->common.threads;
        if (voxrt_gi_bounce(w->gi, &env, 16, 0.0f, (uint32_t)o->common.seed + (uint32_t)b) != VOXRT_OK) return sup_fail(err, "out of memory for light");
    }
    return 0;
}

static void free_buffers(buffers *b) {
    SUP_FREE(b->g.position);
    SUP_FREE(b->g.normal);
    SUP_FREE(b->g.albedo);
    SUP_FREE(b->g.emission);
    SUP_FREE(b->direct);
    SUP_FREE(b->indirect);
    SUP_FREE(b->rgba);
}

static int make_buffers(const gi_options *o, uint32_t side, buffers *b) {
    size_t n;
    memset(b, 0, sizeof *b);
    b->g.width = o->common.size[0] * side;
    b->g.height = o->common.size[1] * side;
    n = (size_t)b->g.width * b->g.height;
    b->g.position = (float *)sup_alloc(n, 12);
    b->g.normal = (float *)sup_alloc(n, 12);
    b->g.albedo = (float *)sup_alloc(n, 12);
    b->g.emission = (float *)sup_alloc(n, 12);
    b->direct = (float *)sup_alloc(n, 12);
    b->indirect = (float *)sup_alloc(n, 12);
    b->rgba = (uint8_t *)sup_alloc(n, 4);
    return b->g.width > 65535 || b->g.height > 65535 || b->g.position == NULL || b->g.normal == NULL || b->g.albedo == NULL ||
        b->g.emission == NULL || b->direct == NULL || b->indirect == NULL || b->rgba == NULL;
}

static int draw(world *w, const gi_options *o, buffers *b, double t, timing *spent, sup_error *err) {
    static const voxrt_gi_method method[5] = {VOXRT_GI_GATHER, VOXRT_GI_GATHER, VOXRT_GI_PATH, VOXRT_GI_AO, VOXRT_GI_NONE};
    voxrt_gi_render_desc d;
    voxrt_camera camera;
    voxrt_stats stats;
    voxrt_result r;
    const size_t n = (size_t)b->g.width * b->g.height;
    const double start = sup_now();
    double now;
    memset(&d, 0, sizeof d);
    memset(&stats, 0, sizeof stats);
    memset(&camera, 0, sizeof camera);
    if (place(w, o, t, err)) return 1;
    now = sup_now();
    spent->update += now - start;
    memcpy(camera.eye, w->camera.eye, sizeof camera.eye);
    memcpy(camera.at, w->camera.at, sizeof camera.at);
    memcpy(camera.up, w->camera.up, sizeof camera.up);
    camera.fov_y = w->camera.fov;
    d.env.thread_count = (uint32_t)o->common.threads;
    r = o->view == VIEW_VOXELS ? voxrt_gbuffer_from_gi(&d.env, &camera, w->gi, &b->g)
                               : voxrt_gbuffer_from_geometry(&d.env, &camera, &w->geometry, &b->g);
    if (r != VOXRT_OK) return sup_fail(err, "no camera: eye and at are the same, or the angle is out of range");
    spent->gbuffer += sup_now() - now;
    now = sup_now();
    d.isa = (voxrt_isa)o->common.isa;
    d.method = method[o->method];
    d.camera = camera;
    d.rays = (uint32_t)((o->rays + o->aa - 1) / o->aa);
    d.bounces = (uint32_t)o->bounces;
    d.radius = (float)o->radius;
    d.filter = (uint32_t)o->filter;
    d.first_ray = (uint32_t)o->common.seed * d.rays;
    if (o->view != VIEW_VOXELS) d.shadow = &w->geometry;
    d.shadow_lift = (float)w->lift;
    r = voxrt_gi_render(&d, w->gi, &b->g, b->direct, b->indirect, &stats);
    if (r != VOXRT_OK) return sup_fail(err, "%s", voxrt_result_string(r));
    spent->light += sup_now() - now;
    spent->all += sup_now() - start;
    spent->rays += stats.rays;
    for (size_t i = 0; i < 3 * n; i++) {
        if (o->view == VIEW_DIRECT || o->method == METHOD_NONE) b->indirect[i] = 0.0f;
        if (o->view == VIEW_INDIRECT || o->method == METHOD_AO) b->direct[i] = 0.0f;
        b->direct[i] += b->indirect[i];
    }
    return voxrt_tone_map((voxrt_tone)o->tone, o->method == METHOD_AO ? 1.0f : (float)((double)w->most / o->exposure), b->direct, b->direct, n) != VOXRT_OK;
}

/* Means of side x side samples: bytes in sRGB, or floats. */
static int write_frame(const gi_options *o, const buffers *b, uint32_t side, const char *path, sup_error *err) {
    const uint32_t width = o->common.size[0], height = o->common.size[1];
    const size_t tail = strlen(path);
    const int linear = tail > 4 && strcmp(path + tail - 4, ".pfm") == 0;
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

/* The name of a frame: its number in place of %d, %3d or %03d. Without one all frames would go to one file. */
static int frame_path(const char *pattern, int64_t frame, int64_t frames, char *out, size_t size) {
    const char *at = strchr(pattern, '%'), *end = at;
    int digits = 0;
    if (at == NULL) return frames > 1 || (size_t)snprintf(out, size, "%s", pattern) >= size;
    end++;
    while (*end >= '0' && *end <= '9' && digits < 100) digits = 10 * digits + (*end++ - '0');
    if (*end != 'd' || digits > 20 || strchr(end, '%') != NULL) return 1;
    return (size_t)snprintf(out, size, "%.*s%0*d%s", (int)(at - pattern), pattern, digits, (int)frame, end + 1) >= size;
}

int main(int argc, char **argv) {
    gi_options o;
    world w;
    buffers b;
    timing spent;
    sup_error err;
    char path[4096];
    uint32_t side = 1;
    int status = parse(argc, argv, &o);
    if (status >= 0) return status;
    while ((int64_t)side * side < o.aa) side++;
    if (o.common.out != NULL && frame_path(o.common.out, 0, o.frames, path, sizeof path))
        return sup_bad_usage(argv[0], "--out: \"%s\" needs one %%d or %%03d for the number of the frame", o.common.out);
    memset(&w, 0, sizeof w);
    memset(&spent, 0, sizeof spent);
    w.name = o.scene;
    status = make_buffers(&o, side, &b) ? sup_fail(&err, "out of memory for the picture") : make_world(&w, &o, &err);
    for (int64_t f = 0; f < o.frames && !status; f++) {
        status = draw(&w, &o, &b, (double)f / (double)o.frames, &spent, &err);
        if (status || o.common.out == NULL) continue;
        (void)frame_path(o.common.out, f, o.frames, path, sizeof path);
        status = write_frame(&o, &b, side, path, &err);
    }
    if (status) (void)sup_bad_input(argv[0], err.text);
    if (!status && o.common.stats) {
        voxrt_columns_info info;
        voxrt_columns_get_info(voxrt_gi_columns(w.gi), &info);
        printf("{\"program\":\"voxrt_gi\",\"in\":");
        sup_json_string(stdout, o.scene);
        printf(",\"width\":%u,\"height\":%u,\"samples\":%u,\"frames\":%d,\"grid\":[%u,%u,%u],\"cells\":%llu,\"rays\":%llu", o.common.size[0],
               o.common.size[1], side * side, (int)o.frames, info.size[0], info.size[1], info.size[2], (unsigned long long)info.cells,
               (unsigned long long)spent.rays);
        printf(",\"update_seconds\":%.6f,\"gbuffer_seconds\":%.6f,\"light_seconds\":%.6f,\"seconds\":%.6f}\n", spent.update, spent.gbuffer,
               spent.light, spent.all);
    }
    free_buffers(&b);
    free_world(&w);
    return status;
}
