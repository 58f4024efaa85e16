/* fuzz_rbf.c - any bytes as a file of radial basis functions. What is accepted is asked, drawn, and is the same after it was
   saved and loaded. The checksum is made right first, otherwise only it would be tested. */
#define _POSIX_C_SOURCE 200809L
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"
#include <unistd.h>
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Each function is one that could be given, and there are no more than are said. */
static void functions(const tetcast_rbf *m, const tetcast_rbf_info *info) {
    tetcast_rbf_function f;
    uint32_t i, a, shaped = 0;
    double all = 0;
    for (i = 0; i < info->function_count; i++) {
        if (!tetcast_rbf_get_function(m, i, &f) || !(f.width > 0.0) || !(f.stretch >= 1.0 / 64.0 && f.stretch <= 64.0)) abort();
        for (a = 0; a < 3; a++) all += (f.centre[a] - f.centre[a]) + (f.axis[a] - f.axis[a]);
        for (a = 0; a < 4; a++) {
            all += (double)(f.weight[a] - f.weight[a]);
            if (a >= info->components && f.weight[a] != 0.0f) abort();
        }
        shaped += f.stretch != 1.0;
    }
    if (all + (f.width - f.width) != 0.0 || shaped > info->ellipsoids) abort();
    if (tetcast_rbf_get_function(m, info->function_count, &f)) abort();
}

/* Bounds hold for values on a grid; what is seen in a flow there, and a picture, is of finite numbers. */
static void look(const tetcast_rbf *m, const tetcast_rbf_info *info, uint8_t how) {
    static const tetcast_control_point points[2] = {{0.0f, {1.0f, 0.5f, 0.25f}, 0.5f}, {1.0f, {0.25f, 0.5f, 1.0f}, 4.0f}};
    const uint32_t dims[3] = {1u + (how & 3u), 1u + (how >> 2 & 3u), 1u + (how >> 4 & 3u)};
    float grid[4 * 64], v[4 * 64], j[12 * 64], rgba[6 * 6 * 4];
    double at[64][3];
    uint32_t n = 0, x[3], a, i;
    tetcast_transfer_desc td;
    tetcast_transfer *transfer = NULL;
    tetcast_optics *optics = NULL;
    if (tetcast_rbf_grid(NULL, m, dims, grid) != TETCAST_OK) abort();
    for (x[2] = 0; x[2] < dims[2]; x[2]++)
        for (x[1] = 0; x[1] < dims[1]; x[1]++)
            for (x[0] = 0; x[0] < dims[0]; x[0]++, n++)
                for (a = 0; a < 3; a++)
                    at[n][a] = dims[a] == 1 ? 0.5 * (info->box_min[a] + info->box_max[a]) :
                        x[a] == dims[a] - 1 ? info->box_max[a] : info->box_min[a] + (info->box_max[a] - info->box_min[a]) * x[a] / (dims[a] - 1);
    if (tetcast_rbf_eval(NULL, m, at[0], n, v, j) != TETCAST_OK) abort();
    for (i = 0; i < info->components; i++) {
        float lo, hi;
        if (tetcast_rbf_bounds(m, i, info->box_min, info->box_max, &lo, &hi, NULL) != TETCAST_OK) continue;
        for (a = 0; a < n; a++) if (grid[a * info->components + i] < lo || grid[a * info->components + i] > hi) abort();
    }
    for (i = 0; info->components >= 3 && i < n; i++) {
        tetcast_flow flow;
        const float *u = v + i * info->components, *du = j + 3 * i * info->components;
        float all = u[0] - u[0] + (u[1] - u[1]) + (u[2] - u[2]);
        tetcast_flow_features(u, du, &flow);
        for (a = 0; a < 9; a++) all += du[a] - du[a];
        if (all != 0.0f) continue; /* not finite */
        for (a = 0; a < 3; a++) all += flow.vorticity[a] - flow.vorticity[a];
        all += flow.speed - flow.speed + (flow.lambda2 - flow.lambda2) + (flow.helicity - flow.helicity);
        if (all != 0.0f) abort();
    }
    memset(&td, 0, sizeof td);
    td.points = points;
    td.point_count = 2;
    if (tetcast_transfer_create(&td, &transfer) == TETCAST_OK && tetcast_optics_create(transfer, NULL, &optics) == TETCAST_OK) {
        tetcast_rbf_render_desc d;
        tetcast_image image;
        memset(&d, 0, sizeof d);
        memset(&image, 0, sizeof image);
        d.env.memory_limit = (size_t)1 << 26;
        d.env.thread_count = 1;
        d.step = (float)((info->box_max[0] - info->box_min[0]) / 8);
        image.width = image.height = 6;
        image.rgba = rgba;
        if (tetcast_rbf_render(&d, m, optics, &image, NULL) == TETCAST_OK)
            for (i = 0; i < sizeof rgba / sizeof rgba[0]; i++) if (!(rgba[i] - rgba[i] == 0.0f)) abort();
    }
    tetcast_optics_destroy(optics);
    tetcast_transfer_destroy(transfer);
}

/* The same by way of a file that has a name. */
static void by_name(const tetcast_rbf *m, const uint8_t *data, size_t size) {
    char path[64];
    tetcast_rbf *n = NULL;
    FILE *in;
    size_t i;
    (void)snprintf(path, sizeof path, "/tmp/fuzz_rbf.%ld.rbf", (long)getpid());
    if (tetcast_rbf_save_file(m, NULL, path) == TETCAST_OK) {
        if (tetcast_rbf_load_file(NULL, path, &n) != TETCAST_OK || n->count != m->count || (in = fopen(path, "rb")) == NULL) abort();
        for (i = 0; i < size && fgetc(in) == data[i]; i++) {}
        if (i != size || fgetc(in) != EOF || fclose(in) != 0) abort();
    }
    tetcast_rbf_destroy(n);
    (void)remove(path);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    uint8_t *copy = (uint8_t *)malloc(size + 1), *again;
    tetcast_env env;
    tetcast_rbf *m = NULL, *n = NULL;
    tetcast_rbf_info info;
    double p[3 * 9];
    float v[4 * 9], j[12 * 9];
    size_t bytes = 0, i;
    if (copy == NULL) return 0;
    if (size != 0) memcpy(copy, data, size);
    if (size >= TETCASTI_RBF_HEADER) {
        tetcasti_store_u64(copy + 16, size);
        tetcasti_store_u64(copy + 24, tetcasti_rbf_checksum(copy, size));
    }
    memset(&env, 0, sizeof env);
    env.memory_limit = (size_t)1 << 26;
    env.thread_count = 1;
    if (tetcast_rbf_load_memory(&env, copy, size, &m) == TETCAST_OK) {
        tetcast_rbf_get_info(m, &info);
        for (i = 0; i < 27; i++) p[i] = info.box_min[i % 3] + (info.box_max[i % 3] - info.box_min[i % 3]) * (double)(i % 7) / 5.0;
        if (tetcast_rbf_eval(NULL, m, p, 9, v, j) != TETCAST_OK) abort();
        functions(m, &info);
        look(m, &info, copy[size - 1]);
        if (tetcast_rbf_save_memory(m, NULL, 0, &bytes) != TETCAST_OK || bytes != size) abort();
        again = (uint8_t *)malloc(bytes);
        if (again != NULL) {
            if (tetcast_rbf_save_memory(m, again, bytes, &bytes) != TETCAST_OK) abort();
            if (tetcast_rbf_load_memory(&env, again, bytes, &n) != TETCAST_OK) abort();
            if ((again[24] ^ again[size - 1]) % 64 == 0) by_name(m, again, bytes); /* now and then: files are slow */
            if (n->count != m->count || memcmp(n->record, m->record, m->count * sizeof *m->record) != 0) abort();
        }
        tetcast_rbf_destroy(n);
        free(again);
    }
    tetcast_rbf_destroy(m);
    free(copy);
    return 0;
}
