/* fuzz_edit.c - bytes as what changes voxels: edits of models, by calls and as the text that voxrt_convert --edit reads; leaves of octrees;
   triangles and points in columns. What comes out agrees with itself: a model with its tree, copies with what they were, an octree with what
   was put in, rays by every isa with each other. The first byte says what, then 16 of options, then 16-bit numbers, odd: a multiple of 1/64,
   even: the upper half of a float. */
#define _POSIX_C_SOURCE 200809L
int convert_main(int argc, char **argv);
#define main convert_main /* what reads the text is in there */
#include "../../examples/voxrt_convert.c"
#undef main

enum { OPTIONS = 16, NUMBERS = 160, RAYS = 24, LIMIT = 1 << 26 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(int ok) {
    if (!ok) abort();
}
static int is_number(float x) { return x - x == 0.0f; }

static voxrt_env env_of(uint32_t threads) {
    voxrt_env e;
    memset(&e, 0, sizeof e);
    e.thread_count = threads;
    e.memory_limit = LIMIT;
    return e;
}

static void rays_of(const float *f, voxrt_ray rays[RAYS]) {
    uint32_t i, k;
    for (i = 0; i < RAYS; i++) {
        for (k = 0; k < 3; k++) {
            rays[i].org[k] = f[(7 * i + k) % NUMBERS];
            rays[i].dir[k] = f[(7 * i + k + 3) % NUMBERS];
        }
        rays[i].t_min = i & 1 ? 0.0f : f[(7 * i + 6) % NUMBERS];
        rays[i].t_max = i & 2 ? INFINITY : f[(7 * i + 8) % NUMBERS];
    }
}

/* ---- models ---- */

typedef struct pair { const voxrt_model *model; uint32_t depth; } pair;

static int same_cell(void *user, const voxrt_voxel *v, uint32_t index) {
    const pair *p = (const pair *)user;
    voxrt_voxel got;
    (void)index;
    must(voxrt_model_get(p->model, p->depth, v->x, v->y, v->z, &got) == 1);
    must(memcmp(got.rgb, v->rgb, 3) == 0 && got.has_normal == v->has_normal);
    return 0;
}

/* A model beside its tree; a picture of it, in places of its own, in a group. */
static void look_at_model(const voxrt_model *m, const uint8_t *o, const float *f) {
    enum { WIDE = 8, HIGH = 6, MANY = 1 << 18 }; /* trees of 2^24 voxels are right, but not soon */
    voxrt_build_desc bd;
    voxrt_model_info info;
    voxrt_tree_info of_tree;
    voxrt_tree *t = NULL;
    voxrt_geometry g[2], all;
    voxrt_instance instance;
    voxrt_group *group = NULL;
    voxrt_env env = env_of(1);
    uint32_t i, k;
    memset(&bd, 0, sizeof bd);
    bd.env = env_of(1 + (o[1] & 1));
    bd.palette_size = 1u << 20;
    voxrt_model_get_info(m, &info);
    if (info.voxel_count <= MANY && voxrt_tree_from_model(&bd, m, &t) == VOXRT_OK) {
        pair p;
        p.model = m;
        p.depth = info.depth;
        voxrt_tree_get_info(t, &of_tree);
        must(of_tree.voxel_count == info.voxel_count && of_tree.depth == info.depth);
        must(voxrt_tree_each(t, info.depth, same_cell, &p) == 0);
    }
    voxrt_tree_destroy(t);
    if (info.voxel_count == 0) return;
    memset(&instance, 0, sizeof instance);
    voxrt_model_geometry(m, &g[0]);
    instance.geometry = g[0];
    for (i = 0; i < 12; i++) instance.to_world[i] = o[2] & 1 ? (double)f[20 + i] : i % 5 == 0 ? 1 : i % 4 == 3 ? 3 : 0;
    k = voxrt_instance_geometry(&instance, &g[1]) == VOXRT_OK ? 2 : 1;
    if (voxrt_group_create(&env, g, k, &group) == VOXRT_OK) {
        static float rgba[2][HIGH * WIDE * 4], depth[2][HIGH * WIDE];
        voxrt_result r[2];
        voxrt_group_geometry(group, &all);
        memset(rgba, 0, sizeof rgba);
        memset(depth, 0, sizeof depth);
        for (k = 0; k < 2; k++) {
            voxrt_render_desc d;
            voxrt_image image;
            memset(&d, 0, sizeof d);
            memset(&image, 0, sizeof image);
            d.env = env_of(1 + k);
            d.isa = k ? VOXRT_ISA_AUTO : VOXRT_ISA_SCALAR;
            d.geometry = &all;
            d.geometry_count = 1;
            d.shadows = o[2] >> 1 & 1;
            d.tolerance = o[2] & 4 ? f[33] : 0;
            for (i = 0; i < 3 && (o[2] & 8); i++) {
                d.camera.eye[i] = f[34 + i];
                d.camera.at[i] = f[37 + i];
            }
            image.width = WIDE;
            image.height = HIGH;
            image.rgba = rgba[k];
            image.depth = depth[k];
            r[k] = voxrt_render(&d, NULL, &image, NULL);
        }
        must(r[0] == r[1] && memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0 && memcmp(depth[0], depth[1], sizeof depth[0]) == 0);
        for (i = 0; r[0] == VOXRT_OK && i < HIGH * WIDE * 4; i++) must(is_number(rgba[0][i]));
    }
    voxrt_group_destroy(group);
}

static voxrt_result one_edit(voxrt_model *m, const uint8_t *q, const float *f) {
    voxrt_edit_desc d;
    voxrt_edit_stats stats;
    voxrt_finish finish;
    double v[6];
    uint32_t k;
    memset(&d, 0, sizeof d);
    memset(&finish, 0, sizeof finish);
    d.env = env_of(1 + (q[0] >> 7));
    d.op = (voxrt_edit_op)(q[0] & 3);
    for (k = 0; k < 3; k++) d.rgb[k] = (uint8_t)(q[1] * (k + 1));
    finish.diffuse = 1;
    finish.mirror[q[1] % 3] = q[0] & 64 ? f[0] : 0.5f;
    if (q[0] & 32) d.finish = &finish;
    for (k = 0; k < 6; k++) v[k] = (double)f[k];
    switch (q[0] >> 2 & 3) {
    case 0: return voxrt_model_box(m, &d, v, v + 3, &stats);
    case 1: return voxrt_model_sphere(m, &d, v, v[3], &stats);
    case 2: {
        voxrt_mesh mesh;
        memset(&mesh, 0, sizeof mesh);
        mesh.positions = f;
        mesh.vertex_count = 9;
        mesh.triangle_count = 1 + q[1] % 3;
        return voxrt_model_mesh(m, &d, &mesh, &stats);
    }
    default: {
        voxrt_voxel voxel[4];
        memset(voxel, 0, sizeof voxel);
        for (k = 0; k < 4; k++) {
            voxel[k].x = q[1] % (7 + k);
            voxel[k].y = q[1] % (3 + k);
            voxel[k].z = q[0] & 16 ? q[1] : k;
            voxel[k].has_normal = (uint8_t)(k & 1);
            voxel[k].normal[k % 3] = f[k];
        }
        return voxrt_model_voxels(m, &d, voxel, 4, &stats);
    }
    }
}

static void models(const uint8_t *o, const float *f) {
    voxrt_model_desc d;
    voxrt_model *m = NULL, *copy = NULL;
    voxrt_model_info before, info;
    voxrt_env env = env_of(1);
    uint32_t i;
    memset(&d, 0, sizeof d);
    d.env = env;
    d.depth = 1 + o[0] % 8;
    d.disable_colors = o[0] >> 3 & 1;
    d.disable_normals = o[0] >> 4 & 1;
    d.box_size = o[0] & 32 ? (double)f[10] : 0;
    if (voxrt_model_create(&d, &m) != VOXRT_OK) return;
    for (i = 0; i < 6; i++) {
        voxrt_model_get_info(m, &before);
        must(voxrt_model_copy(&env, m, &copy) == VOXRT_OK);
        if (one_edit(m, o + 4 + 2 * i, f + 11 * i) != VOXRT_OK) { /* nothing was done */
            voxrt_model_get_info(m, &info);
            must(info.voxel_count == before.voxel_count);
        }
        voxrt_model_get_info(copy, &info);
        must(info.voxel_count == before.voxel_count && info.block_count == before.block_count);
        if (i == (o[3] & 7)) look_at_model(copy, o, f);
        voxrt_model_destroy(copy);
    }
    look_at_model(m, o, f);
    voxrt_model_destroy(m);
}

/* Lines of --edit; those that would read a file are left out. */
static void text(const uint8_t *p, size_t size) {
    voxrt_model_desc d;
    voxrt_env env = env_of(1);
    editing e;
    char line[200], reason[sizeof(((sup_error *)0)->text)];
    size_t at = 0, n;
    int lines;
    memset(&d, 0, sizeof d);
    memset(&e, 0, sizeof e);
    d.env = env;
    d.depth = 5;
    if (voxrt_model_create(&d, &e.model) != VOXRT_OK) return;
    for (lines = 0; at < size && lines < 20; lines++, at++) {
        voxrt_edit_stats stats;
        for (n = 0; at < size && p[at] != '\n' && p[at] != '\0' && n + 1 < sizeof line; at++, n++) line[n] = (char)p[at];
        while (n != 0 && supi_is_blank(line[n - 1])) n--; /* as edit() does */
        line[n] = '\0';
        if (strstr(line, "mesh") == NULL && edit_line(line, &env, &e, &stats, reason) != NULL) break;
    }
    voxrt_model_destroy(e.model);
    voxrt_model_destroy(e.before);
}

/* ---- octrees ---- */

static void octrees(const uint8_t *o, const uint8_t *p, size_t size, const float *f) {
    static const uint8_t palette[12] = {1, 2, 3, 200, 0, 0, 0, 200, 0, 9, 9, 9};
    voxrt_octree_desc d;
    voxrt_octree_info info;
    voxrt_octree *t = NULL, *again = NULL;
    voxrt_tree *tree = NULL;
    voxrt_ray rays[RAYS];
    voxrt_hit hit[2][RAYS];
    voxrt_env env = env_of(1);
    const uint32_t depth = o[0] % 6, side = 1u << depth;
    size_t i, bytes = 0, count;
    uint32_t k, level;
    uint8_t *file;
    memset(&d, 0, sizeof d);
    d.env = env;
    d.disable_grid = o[1] & 1;
    d.grid_level = o[1] >> 1 & 7;
    if (voxrt_octree_create(&d, depth, palette, 4, &t) != VOXRT_OK) return;
    for (i = 0; i + 4 <= size && i < 4 * 64; i += 4) {
        const uint32_t x = p[i] % side, y = p[i + 1] % side, z = p[i + 2] % side, index = p[i + 3] % 5u;
        if (voxrt_octree_insert(t, x, y, z, index, p[i + 3] & 64 ? f + i % 100 : NULL) != VOXRT_OK) break;
        must(voxrt_octree_get(t, depth, x, y, z, &level).index == index && level == depth);
    }
    (void)voxrt_octree_build_lod(t);
    if (o[2] & 1) (void)voxrt_octree_collapse(t);
    (void)voxrt_octree_build_grid(t, o[2] >> 1 & 7);
    rays_of(f, rays);
    for (k = 0; k < 2; k++) {
        voxrt_octree_trace_desc td;
        memset(&td, 0, sizeof td);
        memset(hit[k], 0, sizeof hit[k]);
        td.isa = k ? VOXRT_ISA_AUTO : VOXRT_ISA_SCALAR;
        td.max_level_plus_1 = o[3] & 7;
        td.offset = o[3] & 8 ? f[50] : 0;
        td.disable_grid = o[3] >> 4 & 1;
        if (voxrt_octree_trace(t, &td, rays, hit[k], RAYS) != VOXRT_OK) break;
    }
    if (k == 2) must(memcmp(hit[0], hit[1], sizeof hit[0]) == 0);
    for (i = 0; k == 2 && i < RAYS; i++) {
        uint8_t rgb[3];
        float normal[3];
        if (hit[0][i].node == VOXRT_NO_NODE) continue;
        voxrt_octree_hit_color(t, &hit[0][i], rgb);
        voxrt_octree_hit_normal(t, &hit[0][i], normal);
        must(is_number(normal[0]) && is_number(normal[1]) && is_number(normal[2]));
    }
    (void)voxrt_octree_voxels(t, &count);
    voxrt_octree_get_info(t, &info);
    must(info.voxel_count <= count);
    if (voxrt_octree_save_memory(t, &env, NULL, 0, &bytes) == VOXRT_OK && (file = (uint8_t *)malloc(bytes)) != NULL) {
        must(voxrt_octree_save_memory(t, &env, file, bytes, &bytes) == VOXRT_OK);
        must(voxrt_file_kind(file, bytes) == 4 && voxrt_octree_load_memory(&d, file, bytes, &again) == VOXRT_OK);
        free(file);
    }
    voxrt_octree_destroy(again);
    again = NULL;
    if (voxrt_tree_from_octree(&d, t, &tree) == VOXRT_OK && voxrt_octree_from_tree(&d, tree, &again) == VOXRT_OK) {
        for (i = 0; i < 64; i++) { /* the same cells */
            const uint32_t x = (uint32_t)i % side, y = (uint32_t)i / 4 % side, z = (uint32_t)i / 16 % side;
            const voxrt_octree_voxel a = voxrt_octree_get(t, depth, x, y, z, NULL), b = voxrt_octree_get(again, depth, x, y, z, NULL);
            must((a.index != 0) == (b.index != 0) && (a.index != 0) == voxrt_tree_get(tree, depth, x, y, z, NULL));
        }
    }
    voxrt_octree_destroy(again);
    voxrt_tree_destroy(tree);
    voxrt_octree_destroy(t);
}

/* ---- columns ---- */

static void columns(const uint8_t *o, const float *f) {
    voxrt_columns_desc d;
    voxrt_columns *c = NULL;
    voxrt_columns_info info;
    voxrt_ray rays[RAYS];
    voxrt_column_hit hit[2][RAYS], one;
    uint8_t occluded[RAYS];
    float normals[RAYS][3];
    uint32_t i, k;
    memset(&d, 0, sizeof d);
    d.env = env_of(1);
    d.size_x = 4u << (o[0] & 3);
    d.size_y = 4u << (o[0] >> 2 & 3);
    d.size_z = 64u << (o[0] >> 4 & 1);
    d.depth_axis_plus_1 = o[0] >> 6;
    for (k = 0; k < 3; k++) {
        d.box_min[k] = o[1] & 1 ? (double)f[k] : -2;
        d.box_max[k] = o[1] & 2 ? (double)f[3 + k] : 3;
    }
    if (voxrt_columns_create(&d, &c) != VOXRT_OK) return;
    for (i = 0; i < 3; i++) {
        voxrt_columns_insert_desc in;
        voxrt_mesh mesh;
        memset(&in, 0, sizeof in);
        memset(&mesh, 0, sizeof mesh);
        in.env = env_of(1 + (o[2] & 1));
        in.mode = (voxrt_columns_mode)(o[3 + i] & 7);
        in.still = o[3 + i] >> 3 & 1;
        in.spacing = o[3 + i] & 16 ? f[6] : 0;
        for (k = 0; k < 12 && (o[3 + i] & 32); k++) in.to_world[k] = (double)f[7 + 12 * i + k];
        mesh.positions = f + 40 * i;
        mesh.vertex_count = 12;
        mesh.triangle_count = 4;
        if (o[3 + i] & 64) (void)voxrt_columns_insert_points(c, &in, f + 40 * i, 0, 12, NULL);
        else (void)voxrt_columns_insert(c, &in, &mesh, NULL);
        if (o[3 + i] & 128) voxrt_columns_clear(c, (int)(o[2] >> 1 & 1));
    }
    voxrt_columns_update(c);
    voxrt_columns_get_info(c, &info);
    rays_of(f, rays);
    for (i = 0; i < RAYS; i++)
        for (k = 0; k < 3; k++) normals[i][k] = k == i % 3 ? 1.0f : 0.0f;
    for (k = 0; k < 2; k++) {
        voxrt_columns_trace_desc td;
        memset(&td, 0, sizeof td);
        memset(hit[k], 0, sizeof hit[k]);
        td.isa = k ? VOXRT_ISA_AUTO : VOXRT_ISA_SCALAR;
        td.normals = o[6] & 1 ? normals[0] : NULL;
        td.end_normals = o[6] & 2 ? normals[0] : NULL;
        td.self_radius = o[6] & 4 ? f[60] : 0;
        td.start_level_plus_1 = k ? 0 : o[6] >> 3 & 7;
        if (voxrt_columns_trace(c, &td, rays, hit[k], RAYS) != VOXRT_OK) break;
        must(voxrt_columns_occluded(c, &td, rays, occluded, RAYS) == VOXRT_OK);
        for (i = 0; i < RAYS; i++) must(occluded[i] == (hit[k][i].t < INFINITY));
        for (i = 0; i < 4 && (o[6] & 3) == 0; i++) {
            voxrt_column_step step[8];
            if (voxrt_columns_explain(c, &td, &rays[i], step, 8, &one) != 0) must(memcmp(&one, &hit[k][i], sizeof one) == 0);
        }
    }
    if (k == 2) must(memcmp(hit[0], hit[1], sizeof hit[0]) == 0);
    for (i = 0; k == 2 && i < RAYS; i++)
        if (hit[0][i].t < INFINITY) must(voxrt_columns_get(c, 0, hit[0][i].cell[0], hit[0][i].cell[1], hit[0][i].cell[2]) == 1);
    voxrt_columns_destroy(c);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    float f[NUMBERS];
    const uint8_t *at = data + 1 + OPTIONS;
    size_t i;
    if (size < OPTIONS + 3) return 0;
    if ((data[0] & 3) == 3) {
        text(data + 1, size - 1);
        return 0;
    }
    for (i = 0; i < NUMBERS; i++) { /* those that are missing repeat the others */
        const size_t j = i % ((size - 1 - OPTIONS) / 2);
        uint32_t u = (uint32_t)at[2 * j] << 8 | at[2 * j + 1], w = u << 16;
        memcpy(&f[i], &w, sizeof w);
        if (u & 1) f[i] = ((float)(u >> 1) - 16384.0f) / 64.0f;
    }
    if ((data[0] & 3) == 0) models(data + 1, f);
    else if ((data[0] & 3) == 1) octrees(data + 1, at, size - 1 - OPTIONS, f);
    else columns(data + 1, f);
    return 0;
}
