/* web.c - what the page in this folder draws: one scene for each of the three libraries, made by formulas
   SPDX-License-Identifier: MIT OR Unlicense

   A view is drawn twice. While it moves: the quick picture, at 1/step of the width and height, with the tolerance that
   the slider sets. While it rests: the reference, one sample a pixel after the other at full detail, averaged in linear
   light. web_error() compares the bytes of the two on the screen. One thing is drawn at a time, by one thread of the
   program; with -pthread a pool of others takes part in each call of a library, through env.parallel: threads of a
   browser start too slowly to start them anew in each call. worker.js calls all this. */
#include "../support/base.h"
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
#define ZBUFRAND_IMPLEMENTATION
#include "../../zbufrand.h"
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"
#include "../support/scenes.h"
#include "../support/voxel_mesh.h"
#include "../support/worlds.h"
#if defined(_REENTRANT)
#include <pthread.h>
#define WEB_THREADS 1
#else
#define WEB_THREADS 0
#endif

enum { DEMO_VOXRT, DEMO_ZBUFRAND, DEMO_TETCAST, DEMO_COUNT };
enum { MAX_THREADS = 16, MAX_SIDE = 4096, KNOT = 56, BAND = 16, VOXELS = 512, SUM_SAMPLES = 64 };

/* ---- threads that wait for work --------------------------------------------------------------------------------- */

typedef void task_fn(void *ctx, uint32_t index);

typedef struct pool {
    uint32_t threads; /* the caller's among them */
#if WEB_THREADS
    pthread_mutex_t lock;
    pthread_cond_t work, done;
    task_fn *task;
    void *ctx;
    uint32_t count, next, busy; /* next: atomic */
#endif
} pool;

static pool the_pool;

#if WEB_THREADS
static void pool_drain(pool *p) {
    for (;;) {
        const uint32_t i = __atomic_fetch_add(&p->next, 1u, __ATOMIC_SEQ_CST);
        if (i >= p->count) return;
        p->task(p->ctx, i);
    }
}

static void *pool_thread(void *user) {
    pool *p = (pool *)user;
    pthread_mutex_lock(&p->lock);
    for (;;) {
        while (p->task == NULL || __atomic_load_n(&p->next, __ATOMIC_SEQ_CST) >= p->count) pthread_cond_wait(&p->work, &p->lock);
        p->busy++;
        pthread_mutex_unlock(&p->lock);
        pool_drain(p);
        pthread_mutex_lock(&p->lock);
        if (--p->busy == 0) pthread_cond_signal(&p->done);
    }
    return NULL;
}

/* for_fn of the three libraries' env.parallel */
static void pool_for(task_fn *task, void *ctx, uint32_t count, void *user) {
    pool *p = (pool *)user;
    pthread_mutex_lock(&p->lock);
    p->task = task;
    p->ctx = ctx;
    p->count = count;
    __atomic_store_n(&p->next, 0u, __ATOMIC_SEQ_CST);
    if (count > 1) pthread_cond_broadcast(&p->work);
    pthread_mutex_unlock(&p->lock);
    pool_drain(p);
    pthread_mutex_lock(&p->lock);
    while (p->busy != 0) pthread_cond_wait(&p->done, &p->lock); /* those that took a task; the others find none */
    p->task = NULL;
    pthread_mutex_unlock(&p->lock);
}
#endif

/* Use up to `threads` threads. Returns how many there are. Once, before anything else. */
uint32_t web_start(uint32_t threads);
uint32_t web_start(uint32_t threads) {
    the_pool.threads = 1;
#if WEB_THREADS
    if (threads > MAX_THREADS) threads = MAX_THREADS;
    if (pthread_mutex_init(&the_pool.lock, NULL) != 0 || pthread_cond_init(&the_pool.work, NULL) != 0 ||
        pthread_cond_init(&the_pool.done, NULL) != 0) return 1;
    while (the_pool.threads < threads) {
        pthread_t thread;
        if (pthread_create(&thread, NULL, pool_thread, &the_pool) != 0) break;
        the_pool.threads++;
    }
#else
    (void)threads;
#endif
    return the_pool.threads;
}

#if WEB_THREADS
#define SET_ENV(env) ((env).thread_count = the_pool.threads, (env).parallel.for_fn = pool_for, (env).parallel.user = &the_pool)
#else
#define SET_ENV(env) ((env).thread_count = 1)
#endif

/* ---- the scenes ------------------------------------------------------------------------------------------------- */

typedef struct view {
    double eye[3], at[3];
} view;

typedef struct scenes {
    voxrt_tree *tree;
    sup_world world;
    zbufrand_frame *frame;
    tetcast_mesh *mesh;
    tetcast_transfer *transfer;
    tetcast_optics *optics, *exact;
    double optics_tolerance;
    int open[DEMO_COUNT];
    char text[DEMO_COUNT][160];
} scenes;

static scenes all;

static const char *open_voxrt(void) {
    static const float low[3] = {255.0f, 186.0f, 128.0f}, high[3] = {120.0f, 205.0f, 228.0f};
    voxrt_build_desc desc;
    voxrt_mesh mesh;
    voxrt_tree_info info;
    voxrt_result r;
    sup_mesh made;
    if (sup_scene_make("gyroid", 96, &made)) return "out of memory";
    made.vertex_rgb = (uint8_t *)sup_alloc(made.vertex_count, 3);
    for (size_t i = 0; i < made.vertex_count && made.vertex_rgb; i++) /* from sand to sea, from below to above */
        for (int k = 0; k < 3; k++) {
            const float p = 0.5f + 0.5f * made.positions[3 * i + 1];
            const float t = p < 0.0f ? 0.0f : p > 1.0f ? 1.0f : p;
            made.vertex_rgb[3 * i + (size_t)k] = (uint8_t)(low[k] + (high[k] - low[k]) * t);
        }
    memset(&desc, 0, sizeof desc);
    SET_ENV(desc.env);
    desc.resolution = VOXELS;
    mesh = sup_voxel_mesh(&made);
    r = voxrt_tree_build(&desc, &mesh, NULL, &all.tree);
    if (r == VOXRT_OK) {
        voxrt_tree_get_info(all.tree, &info);
        (void)snprintf(all.text[DEMO_VOXRT], sizeof all.text[0],
                       "A gyroid: %.2f million triangles, built into %.2f million voxels of %d along an edge, %.1f MB.",
                       1e-6 * (double)made.triangle_count, 1e-6 * (double)info.voxel_count, VOXELS, 1e-6 * (double)info.total_bytes);
    }
    sup_mesh_free(&made);
    return r == VOXRT_OK ? NULL : voxrt_result_string(r);
}

static const char *open_zbufrand(void) {
    static sup_error err;
    zbufrand_scene_desc desc;
    zbufrand_frame_desc frame;
    zbufrand_scene_info info;
    zbufrand_result r;
    memset(&desc, 0, sizeof desc);
    memset(&frame, 0, sizeof frame);
    SET_ENV(desc.env);
    SET_ENV(frame.env);
    if (sup_world_make("forest", &desc, NULL, &all.world, &info, &err)) return err.text;
    r = zbufrand_frame_create(&frame, &all.frame);
    if (r != ZBUFRAND_OK) {
        sup_world_free(&all.world);
        return zbufrand_result_string(r);
    }
    (void)snprintf(all.text[DEMO_ZBUFRAND], sizeof all.text[0], "A forest of %.0f thousand million triangles, of which %.0f thousand are stored, in %.1f MB.",
                   1e-9 * (double)info.triangles, 1e-3 * (double)info.stored_triangles, 1e-6 * (double)info.bytes);
    return NULL;
}

static tetcast_result make_optics(double tolerance, tetcast_optics **out) {
    tetcast_optics_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.tolerance = (float)tolerance;
    desc.path_length = (float)tolerance > 0 ? 3.0f * KNOT : 0.0f;
    if (!(tolerance > 0)) desc.t_min = -1.0f;
    return tetcast_optics_create(all.transfer, &desc, out);
}

static const char *open_tetcast(void) {
    static const tetcast_control_point points[] = {{0.08f, {0.05f, 0.10f, 0.70f}, 0.0f},  {0.25f, {0.10f, 0.35f, 0.95f}, 0.03f},
                                                   {0.45f, {0.10f, 0.80f, 0.85f}, 0.09f}, {0.70f, {0.95f, 0.65f, 0.15f}, 0.30f},
                                                   {0.95f, {1.00f, 0.30f, 0.05f}, 0.80f}};
    tetcast_field field;
    tetcast_grid grid;
    tetcast_mesh_desc desc;
    tetcast_transfer_desc colours;
    tetcast_result r;
    float *value = (float *)sup_alloc((size_t)KNOT * KNOT * KNOT, sizeof(float));
    const double cell = 3.0 / (KNOT - 1);
    if (value == NULL) return "out of memory";
    for (int i = 0; i < KNOT * KNOT * KNOT; i++) { /* a trefoil: two strands around a ring, one and a half turns each */
        const double x = cell * (i % KNOT) - 1.5, y = cell * (i / KNOT % KNOT) - 1.5, z = cell * (i / KNOT / KNOT) - 1.5;
        const double a = 1.5 * atan2(z, x), q = sqrt(x * x + z * z) - 1.0, u = 0.3 * cos(a), v = 0.3 * sin(a);
        value[i] = (float)(exp(-40.0 * ((q - u) * (q - u) + (y - v) * (y - v))) +
                           exp(-40.0 * ((q + u) * (q + u) + (y + v) * (y + v))));
    }
    memset(&field, 0, sizeof field);
    memset(&grid, 0, sizeof grid);
    memset(&desc, 0, sizeof desc);
    memset(&colours, 0, sizeof colours);
    SET_ENV(desc.env);
    field.name = "knot";
    field.values.data = value;
    for (int k = 0; k < 3; k++) {
        grid.dims[k] = KNOT;
        grid.origin[k] = -0.5 * (KNOT - 1);
    }
    grid.fields = &field;
    grid.field_count = 1;
    colours.points = points;
    colours.point_count = sizeof points / sizeof points[0];
    r = tetcast_mesh_create_grid(&desc, &grid, NULL, &all.mesh);
    SUP_FREE(value);
    if (r == TETCAST_OK) r = tetcast_transfer_create(&colours, &all.transfer);
    if (r == TETCAST_OK) r = make_optics(0.0, &all.exact);
    if (r != TETCAST_OK) {
        tetcast_transfer_destroy(all.transfer);
        tetcast_mesh_destroy(all.mesh);
        all.transfer = NULL;
        all.mesh = NULL;
        return tetcast_result_string(r);
    }
    all.optics_tolerance = -1.0;
    (void)snprintf(all.text[DEMO_TETCAST], sizeof all.text[0], "A trefoil of hot gas: values at the corners of %.2f million tetrahedra.",
                   6e-6 * (KNOT - 1) * (KNOT - 1) * (KNOT - 1));
    return NULL;
}

/* Make the scene of demo 0, 1 or 2, if it is not there yet. NULL, or what went wrong. */
const char *web_open(int demo);
const char *web_open(int demo) {
    const char *error;
    if (demo < 0 || demo >= DEMO_COUNT) return "no such scene";
    if (all.open[demo]) return NULL;
    error = demo == DEMO_VOXRT ? open_voxrt() : demo == DEMO_ZBUFRAND ? open_zbufrand() : open_tetcast();
    all.open[demo] = error == NULL;
    return error;
}

/* A sentence about the scene; empty until it is there. */
const char *web_text(int demo);
const char *web_text(int demo) { return demo >= 0 && demo < DEMO_COUNT ? all.text[demo] : ""; }

/* ---- pictures --------------------------------------------------------------------------------------------------- */

typedef struct shot {
    int demo;
    view v;
    uint32_t width, height, step, samples; /* samples: of the reference so far */
    size_t room;                           /* pixels that fit into the buffers */
    uint8_t *quick, *shown;                /* 4 bytes a pixel; quick: width/step x height/step */
    float *sum, *sample;                   /* linear, premultiplied */
    tetcast_ray *ray;
    tetcast_ray_result *result;
    size_t rays;
    uint8_t to_srgb[4097]; /* of a linear value times 4096 */
} shot;

static shot pic;

static const float sky[DEMO_COUNT][4] = {{0.55f, 0.66f, 0.80f, 1.0f}, {0.50f, 0.62f, 0.78f, 1.0f}, {0.010f, 0.011f, 0.016f, 1.0f}};

static uint32_t part(uint32_t side, uint32_t step) { return (side + step - 1) / step; }

static int picture_open(int demo, uint32_t width, uint32_t height, uint32_t step) {
    const size_t n = (size_t)width * height;
    if (demo < 0 || demo >= DEMO_COUNT || !all.open[demo] || width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE ||
        step == 0 || step > 16) return 0;
    if (n > pic.room || (size_t)width * BAND > pic.rays) {
        SUP_FREE(pic.quick);
        SUP_FREE(pic.shown);
        SUP_FREE(pic.sum);
        SUP_FREE(pic.sample);
        SUP_FREE(pic.ray);
        SUP_FREE(pic.result);
        pic.room = 0;
        pic.quick = (uint8_t *)sup_alloc(n, 4);
        pic.shown = (uint8_t *)sup_alloc(n, 4);
        pic.sum = (float *)sup_alloc(n, 4 * sizeof(float));
        pic.sample = (float *)sup_alloc(n, 4 * sizeof(float));
        pic.rays = (size_t)width * BAND;
        pic.ray = (tetcast_ray *)sup_alloc(pic.rays, sizeof *pic.ray);
        pic.result = (tetcast_ray_result *)sup_alloc(pic.rays, sizeof *pic.result);
        if (!pic.quick || !pic.shown || !pic.sum || !pic.sample || !pic.ray || !pic.result) return 0;
        pic.room = n;
    }
    if (pic.to_srgb[4096] == 0)
        for (int i = 0; i <= 4096; i++) {
            const double x = i / 4096.0;
            pic.to_srgb[i] = (uint8_t)(255.0 * (x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055) + 0.5);
        }
    pic.demo = demo;
    pic.width = width;
    pic.height = height;
    pic.step = step;
    pic.samples = 0;
    return 1;
}

/* The same view for all: the vertical angle is 40 degrees. */
static const char *draw_voxrt(uint32_t width, uint32_t height, double tolerance, uint8_t *rgba8) {
    voxrt_render_desc d;
    voxrt_image image;
    voxrt_result r;
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    SET_ENV(d.env);
    for (int k = 0; k < 3; k++) {
        d.camera.eye[k] = (float)pic.v.eye[k];
        d.camera.at[k] = (float)pic.v.at[k];
    }
    d.shadows = 1;
    d.samples = 1;
    d.tolerance = (float)tolerance;
    memcpy(d.background, sky[DEMO_VOXRT], sizeof d.background);
    image.width = width;
    image.height = height;
    image.rgba8 = rgba8;
    if (rgba8 == pic.shown) { /* the reference: the next point of the pixel */
        d.first_sample = pic.samples;
        image.sum = pic.sum;
    }
    r = voxrt_render(&d, all.tree, &image, NULL);
    return r == VOXRT_OK ? NULL : voxrt_result_string(r);
}

static const char *draw_zbufrand(uint32_t width, uint32_t height, double tolerance, uint8_t *rgba8) {
    zbufrand_render_desc d;
    zbufrand_image image;
    zbufrand_result r;
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    memcpy(d.camera.eye, pic.v.eye, sizeof d.camera.eye);
    memcpy(d.camera.at, pic.v.at, sizeof d.camera.at);
    memcpy(d.background, sky[DEMO_ZBUFRAND], sizeof d.background);
    for (int k = 0; k < 3; k++) d.ambient[k] = 0.5f * sky[DEMO_ZBUFRAND][k];
    d.tolerance = tolerance;
    image.width = width;
    image.height = height;
    image.rgba8 = rgba8;
    if (rgba8 == NULL) {
        d.frame = pic.samples;
        d.spread = SUM_SAMPLES;
        image.rgba = pic.sample;
    }
    r = zbufrand_render(all.frame, &d, all.world.scene, &image, NULL);
    return r == ZBUFRAND_OK ? NULL : zbufrand_result_string(r);
}

static void tetcast_open_view(tetcast_render_desc *d) {
    memset(d, 0, sizeof *d);
    SET_ENV(d->env);
    memcpy(d->camera.eye, pic.v.eye, sizeof d->camera.eye);
    memcpy(d->camera.at, pic.v.at, sizeof d->camera.at);
    memcpy(d->background, sky[DEMO_TETCAST], sizeof d->background);
}

static const char *draw_tetcast(uint32_t width, uint32_t height, double tolerance, uint8_t *rgba8) {
    tetcast_render_desc d;
    tetcast_image image;
    tetcast_result r = TETCAST_OK;
    tetcast_open_view(&d);
    memset(&image, 0, sizeof image);
    image.width = width;
    image.height = height;
    image.rgba8 = rgba8;
    if (tolerance < all.optics_tolerance || tolerance > all.optics_tolerance) {
        tetcast_optics_destroy(all.optics);
        all.optics = NULL;
        all.optics_tolerance = -1.0;
        r = make_optics(tolerance, &all.optics);
        if (r == TETCAST_OK) all.optics_tolerance = tolerance;
    }
    if (r == TETCAST_OK) r = tetcast_render(&d, all.mesh, all.optics, &image, NULL);
    return r == TETCAST_OK ? NULL : tetcast_result_string(r);
}

/* One ray for each pixel, through point (dx, dy) of it, into pic.sample. */
static const char *cast_tetcast(double dx, double dy) {
    tetcast_render_desc d;
    tetcast_result r = TETCAST_OK;
    tetcast_open_view(&d);
    for (uint32_t y = 0; y < pic.height && r == TETCAST_OK; y += BAND) {
        const uint32_t rows = pic.height - y < BAND ? pic.height - y : BAND;
        const size_t n = (size_t)rows * pic.width;
        for (size_t i = 0; i < n && r == TETCAST_OK; i++)
            r = tetcast_camera_ray(&d.camera, pic.width, pic.height, (double)(i % pic.width) + dx, (double)(y + i / pic.width) + dy,
                                   &pic.ray[i]);
        if (r == TETCAST_OK) r = tetcast_cast(&d, all.mesh, all.exact, pic.ray, n, pic.result, NULL);
        for (size_t i = 0; i < n; i++) {
            const float *c = pic.result[i].rgba;
            float *to = pic.sample + 4 * ((size_t)y * pic.width + i);
            for (int k = 0; k < 4; k++) to[k] = c[k] + (1.0f - c[3]) * d.background[k];
        }
    }
    return r == TETCAST_OK ? NULL : tetcast_result_string(r);
}

/* Draw the quick picture, of (width/step) x (height/step) pixels, rounded up.
   view       eye and point looked at, 6 numbers; y is up
   tolerance  what the slider of the demo sets. 0: of demo 0, cells of any size; 1: probability of a flaw, 0.05; 2: exact
   NULL, or what went wrong. */
const char *web_quick(int demo, const double *eye_at, uint32_t width, uint32_t height, uint32_t step, double tolerance);
const char *web_quick(int demo, const double *eye_at, uint32_t width, uint32_t height, uint32_t step, double tolerance) {
    uint32_t w, h;
    if (!picture_open(demo, width, height, step)) return "out of memory, or no such picture";
    memcpy(&pic.v, eye_at, sizeof pic.v);
    w = part(width, step);
    h = part(height, step);
    if (demo == DEMO_VOXRT) return draw_voxrt(w, h, tolerance, pic.quick);
    return demo == DEMO_ZBUFRAND ? draw_zbufrand(w, h, tolerance, pic.quick) : draw_tetcast(w, h, tolerance, pic.quick);
}

/* Add a sample for each pixel to the reference of the view that web_quick drew last. NULL, or what went wrong. */
const char *web_refine(void);
const char *web_refine(void) {
    const size_t n = 4 * (size_t)pic.width * pic.height;
    const char *error;
    double x = 0.5 + 0.7548776662466927 * pic.samples, y = 0.5 + 0.5698402909980532 * pic.samples; /* Roberts 2018 */
    float scale;
    if (pic.room == 0 || !all.open[pic.demo]) return "no picture to refine";
    if (pic.demo == DEMO_VOXRT) {
        if (pic.samples == 0) memset(pic.sum, 0, n * sizeof(float));
        error = draw_voxrt(pic.width, pic.height, 0.0, pic.shown);
        pic.samples += error == NULL;
        return error;
    }
    error = pic.demo == DEMO_ZBUFRAND ? draw_zbufrand(pic.width, pic.height, 0.0, NULL) : cast_tetcast(x - floor(x), y - floor(y));
    if (error != NULL) return error;
    if (pic.samples == 0) memcpy(pic.sum, pic.sample, n * sizeof(float));
    else
        for (size_t i = 0; i < n; i++) pic.sum[i] += pic.sample[i];
    pic.samples++;
    scale = 4096.0f / (float)pic.samples;
    for (size_t i = 0; i < n; i++) {
        const float v = pic.sum[i] * scale;
        pic.shown[i] = (i & 3u) == 3 ? 255 : pic.to_srgb[v > 0 ? v < 4096.0f ? (int)(v + 0.5f) : 4096 : 0];
    }
    return NULL;
}

/* Root of the mean squared difference of the quick picture, each pixel of which stands for step x step, and the
   reference, over red, green and blue of all pixels, in bytes of sRGB. -1: there is no reference yet. */
double web_error(void);
double web_error(void) {
    const uint32_t w = part(pic.width, pic.step);
    double sum = 0.0;
    if (pic.room == 0 || pic.samples == 0) return -1.0;
    for (uint32_t y = 0; y < pic.height; y++) {
        const uint8_t *a = pic.quick + 4 * ((size_t)(y / pic.step) * w), *b = pic.shown + 4 * ((size_t)y * pic.width);
        for (uint32_t x = 0; x < pic.width; x++)
            for (int k = 0; k < 3; k++) {
                const int d = (int)a[4 * (x / pic.step) + (uint32_t)k] - (int)b[4 * x + (uint32_t)k];
                sum += (double)(d * d);
            }
    }
    return sqrt(sum / (3.0 * pic.width * pic.height));
}

/* 4 bytes a pixel, row 0 on top, until the next call. which: 0 the quick picture, 1 the reference, 2 their difference,
   ten times, in the place of the reference, which the next web_refine writes anew. */
const uint8_t *web_pixels(int which);
const uint8_t *web_pixels(int which) {
    const uint32_t w = part(pic.width, pic.step);
    if (pic.room == 0) return NULL;
    if (which == 2)
        for (uint32_t y = 0; y < pic.height; y++)
            for (uint32_t x = 0; x < pic.width; x++)
                for (uint32_t k = 0; k < 3; k++) {
                    uint8_t *p = &pic.shown[4 * ((size_t)y * pic.width + x) + k];
                    const int d = 10 * ((int)*p - (int)pic.quick[4 * ((size_t)(y / pic.step) * w + x / pic.step) + k]);
                    *p = (uint8_t)(d < -255 || d > 255 ? 255 : d < 0 ? -d : d);
                }
    return which == 0 ? pic.quick : pic.shown;
}
