/* fuzz_scene.c - bytes as a scene graph, a camera and options of zbufrand.h: a picture of finite numbers, the same for every
   isa and number of threads, or a refusal; then edits, and a picture again. Bytes: 20 of options; a byte for each node (kind,
   parent) and three more; then 16-bit numbers, odd: a multiple of 1/64, even: the upper half of a float. */
#define ZBUFRAND_IMPLEMENTATION
#include "../../zbufrand.h"

enum { WIDE = 13, HIGH = 9, NUMBERS = 200, NODES = 10, OPTIONS = 20, MANY = 40 };
typedef struct picture {
    float rgba[HIGH * WIDE][4], depth[HIGH * WIDE];
    uint8_t rgba8[HIGH * WIDE][4];
    uint32_t node[HIGH * WIDE];
} picture;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Turned by quarters about an axis, mirrored or not, scaled, moved; or twelve numbers as they come. */
static zbufrand_transform place(uint32_t how, const float *f) {
    zbufrand_transform t;
    uint32_t i, k;
    double scale = how & 8 ? (double)f[0] : 1.0;
    memset(&t, 0, sizeof t);
    for (i = 0; i < 3; i++) {
        for (k = 0; k < 3 && (how & 7) == 7; k++) t.m[i][k] = (double)f[3 * i + k];
        if ((how & 7) != 7) t.m[i][(i + how) % 3] = how & 4 && i == 0 ? -scale : scale;
        t.m[i][3] = (double)f[9 + i];
    }
    return t;
}

static void draw(const zbufrand_scene *scene, const zbufrand_render_desc *desc, int threads, picture p[2]) {
    zbufrand_result r[2];
    zbufrand_render_desc d = *desc;
    uint32_t k, i, a;
    memset(p, 0, 2 * sizeof *p);
    for (k = 0; k < 2; k++) {
        zbufrand_frame_desc fd;
        zbufrand_frame *frame = NULL;
        zbufrand_image m;
        memset(&fd, 0, sizeof fd);
        memset(&m, 0, sizeof m);
        fd.isa = k ? ZBUFRAND_ISA_AUTO : ZBUFRAND_ISA_SCALAR;
        fd.env.thread_count = (uint32_t)(k && threads ? 2 : 1);
        fd.env.memory_limit = 1u << 28;
        if (zbufrand_frame_create(&fd, &frame) != ZBUFRAND_OK) abort();
        m.width = WIDE;
        m.height = HIGH;
        m.rgba = p[k].rgba[0];
        m.rgba8 = p[k].rgba8[0];
        m.depth = p[k].depth;
        m.node = p[k].node;
        r[k] = zbufrand_render(frame, &d, scene, &m, NULL);
        zbufrand_frame_destroy(frame);
    }
    if (r[0] != r[1] || (r[0] == ZBUFRAND_OK && memcmp(&p[0], &p[1], sizeof p[0]) != 0)) abort();
    for (i = 0; r[0] == ZBUFRAND_OK && i < HIGH * WIDE; i++) {
        for (a = 0; a < 4; a++) if (!zbufrandi_finite_f(p[0].rgba[i][a])) abort();
        if (!(p[0].depth[i] > 0.0f)) abort();
    }
}

static int look(void *user, const zbufrand_sample *s, const uint32_t *numbers, size_t count) {
    size_t i;
    (void)numbers;
    for (i = 0; i < count; i++) {
        if (!(s[i].z > 0.0f && zbufrandi_absf(s[i].x) < 999.0f && zbufrandi_absf(s[i].y) < 999.0f)) abort(); /* guard bands are in it */
        if (!zbufrandi_finite_f(s[i].rgb[0]) || s[i].slope_x != s[i].slope_x || s[i].slope_y != s[i].slope_y) abort();
    }
    return (*(size_t *)user += count) > 5000;
}

/* What updates keep is given back, and trees have room for all their nodes. */
static void trees(const zbufrand_scene *scene) {
    size_t i;
    for (i = 0; scene->live != NULL && i < scene->structure_count; i++) {
        const zbufrandi_live_structure *s = &scene->live->s[i];
        if (s->promised != 0 || s->spare != 0 || (s->at != NULL && scene->structure[i].node_count > s->node_capacity)) abort();
    }
}

/* What the scene is, without a picture: points of its surface, the cut for a view, samples of it. */
static void ask(const zbufrand_scene *scene, const zbufrand_render_desc *desc) {
    float position[30][3], normal[30][3];
    zbufrand_surface_points_desc pd;
    zbufrand_frame_desc fd;
    zbufrand_frame *frame = NULL;
    zbufrand_group group[8];
    size_t count = 0, i, a;
    memset(&pd, 0, sizeof pd);
    memset(&fd, 0, sizeof fd);
    pd.independent = desc->independent;
    pd.seed = desc->seed;
    if (zbufrand_surface_points(scene, &pd, 30, position[0], normal[0], NULL, NULL) == ZBUFRAND_OK)
        for (i = 0; i < 30; i++)
            for (a = 0; a < 3; a++) if (!zbufrandi_finite_f(position[i][a]) || !(normal[i][a] >= -1.001f && normal[i][a] <= 1.001f)) abort();
    fd.env.thread_count = 1;
    fd.env.memory_limit = 1u << 28;
    if (zbufrand_frame_create(&fd, &frame) != ZBUFRAND_OK) abort();
    if (zbufrand_select(frame, desc, scene, WIDE, HIGH, group, 8, &count, NULL) == ZBUFRAND_OK)
        for (i = 0; i < count && i < 8; i++) if (!(group[i].z_min <= group[i].z_max) || group[i].area != group[i].area) abort();
    count = 0;
    (void)zbufrand_sample_scene(frame, desc, scene, WIDE, HIGH, look, &count, NULL);
    zbufrand_frame_destroy(frame);
}

/* Cameras that frame a box, the scene, or are what they are, as views. */
static void cameras(const zbufrand_scene *scene, const zbufrand_camera *camera, const float *f) {
    zbufrand_points points;
    uint32_t k, a;
    memset(&points, 0, sizeof points);
    points.positions = f;
    points.count = 10;
    for (k = 0; k < 5; k++) {
        zbufrand_camera c = *camera;
        zbufrand_view view;
        zbufrand_sample sample[10];
        double way[3], lo[3], hi[3];
        zbufrand_result r = ZBUFRAND_OK;
        for (a = 0; a < 3; a++) {
            way[a] = (double)f[60 + a];
            lo[a] = (double)f[63 + a];
            hi[a] = lo[a] + (double)f[66 + a];
        }
        if (k == 1 || k == 2) r = zbufrand_camera_fit(&c, lo, hi, k == 1 ? way : NULL, WIDE, k == 1 ? HIGH : 0);
        if (k > 2) r = zbufrand_camera_fit_scene(&c, k == 3 ? scene : NULL, f[69] > 0 ? way : NULL, WIDE, HIGH);
        if (r != ZBUFRAND_OK && memcmp(&c, camera, sizeof c) != 0) abort();
        r = zbufrand_camera_view(&c, scene, WIDE, HIGH, &view);
        if (r == ZBUFRAND_OK && zbufrand_project(&view, &points, 0, 10, sample) != ZBUFRAND_OK) abort();
        if (r != ZBUFRAND_OK && view.focal != 0.0) abort();
    }
}

/* What nodes are made of; it stays while the scene does, which borrows it. */
typedef struct world {
    float f[NUMBERS], position[NODES][18];
    zbufrand_transform many[MANY];
    zbufrand_node node[NODES + 1];
} world;

static void world_numbers(world *g, const uint8_t *at, size_t bytes) { /* those that are missing repeat the others */
    const size_t have = bytes / 2;
    size_t i;
    for (i = 0; i < NUMBERS; i++) {
        const size_t j = have != 0 ? i % have : 0;
        uint32_t u = have != 0 ? (uint32_t)at[2 * j] << 8 | at[2 * j + 1] : 513, w = u << 16;
        memcpy(&g->f[i], &w, sizeof w);
        if (u & 1) g->f[i] = ((float)(u >> 1) - 16384.0f) / 64.0f;
    }
}

/* Meshes, lists and references as bytes say, four each. */
static void world_nodes(world *g, zbufrand_scene *scene, const uint8_t *data, size_t n) {
    static const uint8_t rgb[18] = {255, 0, 0, 0, 255, 0, 0, 0, 255, 90, 90, 90, 255, 255, 0, 0, 255, 255};
    size_t i, k;
    for (i = 0; i < n; i++) {
        const uint8_t *q = data + 4 * i;
        const zbufrand_node parent = q[1] & 64 ? 0 : g->node[q[1] % (i + 1)], target = g->node[q[2] % (i + 1)];
        const zbufrand_transform t = place(q[3], g->f + q[2] % (NUMBERS - 12));
        g->node[i + 1] = ZBUFRAND_ROOT;
        if (q[0] % 4 < 2) {
            zbufrand_mesh m;
            memset(&m, 0, sizeof m);
            for (k = 0; k < 18; k++) g->position[i][k] = g->f[(q[2] + k * (1u + q[3] % 5u)) % NUMBERS] * (q[1] & 128 ? 1.0f / 64 : 1.0f);
            m.positions = g->position[i];
            m.vertex_count = 6;
            m.triangle_count = 2;
            m.two_sided = q[1] >> 5 & 1;
            m.material = q[3] >> 6;
            if (q[0] & 4) m.vertex_rgb = rgb;
            if (q[0] & 8) m.triangle_rgb = rgb;
            if (q[0] & 16) m.normals = g->position[i];
            (void)zbufrand_add_mesh(scene, parent, &t, q[0] >> 6, &m, &g->node[i + 1]);
        } else if (q[0] % 4 == 2) {
            (void)zbufrand_add_list(scene, parent, &t, q[0] >> 6, &g->node[i + 1]);
        } else if (q[0] & 4) {
            const size_t count = q[0] & 8 ? MANY : 4;
            for (k = 0; k < count; k++) g->many[k] = place(q[3] + (uint32_t)k, g->f + (q[2] + 7 * k) % (NUMBERS - 12));
            if (zbufrand_add_references(scene, parent, g->many, count, target, &g->node[i + 1]) == ZBUFRAND_OK) break; /* borrowed */
        } else {
            (void)zbufrand_add_reference(scene, parent, &t, target, &g->node[i + 1]);
        }
        if (g->node[i + 1] == 0) g->node[i + 1] = ZBUFRAND_ROOT;
        if (q[1] & 64) (void)zbufrand_list_append(scene, target, g->node[i + 1]);
    }
}

static void options_of(zbufrand_build_desc *b, zbufrand_render_desc *d, zbufrand_light *light, const uint8_t *o, const float *f) {
    size_t k;
    memset(b, 0, sizeof *b); memset(d, 0, sizeof *d); memset(light, 0, sizeof *light);
    b->seed = o[0]; b->ids = o[1] & 1; b->strict = o[1] >> 1 & 1; b->structure = (zbufrand_structure)(o[1] >> 2 & 7);
    b->leaf_objects = o[2]; b->normal_depth = o[3] & 15; b->normal_grid = o[3] & 128 ? o[3] >> 4 & 7 : 0;
    b->leaf_ratio = o[1] & 64 ? f[0] : 0; b->tolerance_zone = o[1] & 128 ? f[1] : 0;
    d->camera.near_z = o[4] & 1 ? (double)f[2] : 0; d->camera.far_z = o[4] & 2 ? (double)f[3] : 0;
    d->camera.fov_y = o[4] & 4 ? (double)f[4] : 0;
    for (k = 0; k < 3; k++) {
        d->camera.eye[k] = (double)f[5 + k]; d->camera.at[k] = o[4] & 8 ? (double)f[8 + k] : 0;
        d->camera.up[k] = o[4] & 16 ? (double)f[11 + k] : 0;
        light->position[k] = (double)f[14 + k]; light->color[k] = f[17 + k];
        d->ambient[k] = o[4] & 32 ? f[20 + k] : 0;
    }
    light->directional = o[4] >> 6 & 1;
    if (o[4] & 128) { d->lights = light; d->light_count = 1; }
    d->tolerance = o[5] & 1 ? (double)f[24] : 0; d->density = o[5] & 2 ? zbufrandi_min((double)f[25], 20) : o[5] & 4 ? 3 : 0;
    d->noise = o[5] & 8 ? (double)f[26] : 0; d->max_frames = 5; d->spread = o[5] & 16 ? 1u << (o[6] & 7) : 0;
    d->frame = o[6]; d->seed = o[7]; d->independent = o[5] >> 5 & 1; d->round_up = o[5] >> 6 & 1; d->no_lists = o[5] >> 7;
    d->hybrid = (zbufrand_hybrid)(o[8] & 7); d->hybrid_radius = o[8] & 8 ? (double)f[27] : 0;
    d->no_occlusion = o[8] >> 4 & 1; d->no_repair = o[8] >> 5 & 1; d->no_plane_depth = o[8] >> 6 & 1; d->no_thinning = o[8] >> 7;
    d->depth_ratio = o[9] & 1 ? (double)f[28] : 0; d->angle_ratio = o[9] & 2 ? (double)f[29] : 0; d->clip_ratio = o[9] & 4 ? (double)f[30] : 0;
    d->unlit = o[9] >> 3 & 1;
    if (o[9] & 16) { d->opacity = f + 31; d->opacity_count = 2 + (o[9] >> 5 & 1); }
    if (o[9] & 64) memcpy(d->background, f + 35, sizeof d->background);
    if (o[9] & 128) memcpy(&d->costs, f + 40, sizeof d->costs);
    d->reconstruct.block = o[10] & 15; d->reconstruct.fill = (zbufrand_fill)(o[10] >> 4 & 7);
    d->reconstruct.occlusion = (zbufrand_occlusion)(o[11] & 7); d->reconstruct.reach = o[11] >> 3 & 7;
    d->reconstruct.plane_depth = o[11] >> 6 & 1; d->reconstruct.repair = o[11] >> 7;
    d->reconstruct.gauss_radius = o[12] & 1 ? f[50] : 0; d->reconstruct.gauss_support = o[12] & 2 ? f[51] : 0;
    if (o[12] & 64) memcpy(&d->reconstruct.tolerance, f + 52, 5 * sizeof(float));
    d->reconstruct.drop_back = o[12] >> 7;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static picture p[2]; /* 6 KB */
    world g;
    const uint8_t *o = data + 1;
    zbufrand_scene_desc sd;
    zbufrand_build_desc b;
    zbufrand_render_desc d;
    zbufrand_light light;
    zbufrand_scene *scene = NULL;
    size_t i, n = size > OPTIONS + 1 ? data[0] % (NODES + 1u) : 0;
    if (n == 0 || size < OPTIONS + 1 + 4 * n) return 0;
    memset(&g, 0, sizeof g); memset(&sd, 0, sizeof sd);
    g.node[0] = ZBUFRAND_ROOT;
    world_numbers(&g, data + OPTIONS + 1 + 4 * n, size - (OPTIONS + 1 + 4 * n));
    sd.env.thread_count = 1;
    sd.env.memory_limit = 1u << 28;
    if (zbufrand_scene_create(&sd, &scene) != ZBUFRAND_OK) abort();
    world_nodes(&g, scene, data + OPTIONS + 1, n);
    options_of(&b, &d, &light, o, g.f);
    if (zbufrand_scene_build(scene, &b, NULL) == ZBUFRAND_OK) {
        draw(scene, &d, o[12] & 4, p);
        ask(scene, &d);
        cameras(scene, &d.camera, g.f);
        for (i = 0; i < (o[19] & 128 ? MANY : 3); i++) { /* edits, as many as there are bytes for, or one after the other of a row */
            const zbufrand_transform t = place(o[13 + 2 * (i % 3)], g.f + (o[13 + 2 * (i % 3)] + i / 3) % (NUMBERS - 12));
            const zbufrand_node which = g.node[1 + o[14 + 2 * (i % 3)] % n];
            if (o[19] & 1) (void)zbufrand_set_reference(scene, which, i < 3 ? o[19] >> 1 & 7 : i, o[19] & 16 ? NULL : &t);
            if (o[12] & 8) (void)zbufrand_move(scene, which, &t);
            else if (o[12] & 16) (void)zbufrand_remove(scene, which);
            else if (o[12] & 32) (void)zbufrand_add_reference(scene, ZBUFRAND_ROOT, &t, which, NULL);
        }
        if (((o[12] & 56) != 0 || (o[19] & 1)) && zbufrand_scene_update(scene, NULL) == ZBUFRAND_OK) {
            trees(scene);
            draw(scene, &d, o[12] & 4, p);
        }
    }
    zbufrand_scene_destroy(scene);
    return 0;
}
