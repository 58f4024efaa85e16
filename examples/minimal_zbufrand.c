/* minimal_zbufrand.c - a ring of 18,432 triangles, 10^8 times, as a picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/png.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"

enum { N = 96, WIDTH = 800, HEIGHT = 500 };
static float position[N * N][3];
static uint8_t color[N * N][3], pixels[WIDTH * HEIGHT][4];
static uint32_t triangle[N * N * 2][3];
static zbufrand_transform places[4][100]; // of each level of 10 x 10: borrowed until the scene is built

static void make_torus(void) {
    for (uint32_t i = 0; i < N * N; i++) {
        const uint32_t up = i / N * N + (i + 1) % N, right = (i + N) % (N * N), both = (up + N) % (N * N);
        const uint32_t corners[6] = {i, up, both, i, both, right};
        const float a = 6.2831853f / N * (float)(i / N), b = 6.2831853f / N * (float)(i % N);
        const float r = 1.0f + 0.4f * cosf(b), p[3] = {r * cosf(a), 1.4f + r * sinf(a), 0.4f * sinf(b)};
        memcpy(position[i], p, sizeof p);
        memcpy(triangle[2 * i], corners, sizeof corners);
        for (int k = 0; k < 3; k++) color[i][k] = (uint8_t)(160.0f + 90.0f * sinf(a + 2.0f * (float)k));
    }
}

int main(int argc, char **argv) {
    const zbufrand_mesh mesh = {.positions = position[0], .vertex_count = N * N, .vertex_rgb = color[0],
                                .indices = triangle[0], .triangle_count = 2 * N * N};
    const zbufrand_render_desc render = {.camera = {.eye = {9, 14, 40}, .at = {0, 0, -5}},
                                         .background = {0.5f, 0.6f, 0.75f, 1.0f}};
    const zbufrand_image image = {.width = WIDTH, .height = HEIGHT, .rgba8 = pixels[0]};
    zbufrand_scene *scene = NULL;
    zbufrand_frame *frame = NULL;
    zbufrand_node node = 0;
    sup_error err;

    make_torus();
    zbufrand_result result = zbufrand_scene_create(NULL, &scene);
    if (result == ZBUFRAND_OK)
        result = zbufrand_add_mesh(scene, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &mesh, &node);
    for (int level = 0; level < 4 && result == ZBUFRAND_OK; level++) { // a list of 100 references to what is there
        const zbufrand_node target = node;
        const double step = 4.0 * pow(10.0, level);
        for (int i = 0; i < 100; i++) {
            const double x = step * (i % 10 - 4.5), z = step * (i / 10 - 4.5);
            const zbufrand_transform move = {{{1, 0, 0, x}, {0, 1, 0, 0}, {0, 0, 1, z}}};
            places[level][i] = move;
        }
        result = zbufrand_add_list(scene, ZBUFRAND_ROOT, NULL, level < 3 ? ZBUFRAND_HIDDEN : 0, &node);
        if (result == ZBUFRAND_OK) result = zbufrand_add_references(scene, node, places[level], 100, target, NULL);
    }
    if (result == ZBUFRAND_OK) result = zbufrand_scene_build(scene, NULL, NULL);
    if (result == ZBUFRAND_OK) result = zbufrand_frame_create(NULL, &frame);
    if (result == ZBUFRAND_OK) result = zbufrand_render(frame, &render, scene, &image, NULL);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);

    if (result != ZBUFRAND_OK) (void)sup_fail(&err, "%s", zbufrand_result_string(result));
    else if (!sup_png_write8(argc > 1 ? argv[1] : "zbufrand.png", pixels[0], WIDTH, HEIGHT, 4, &err)) return 0;
    fprintf(stderr, "%s\n", err.text);
    return 1;
}
