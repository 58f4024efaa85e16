/* minimal_voxrt.c - the shortest useful program: a mesh becomes voxels, the voxels become a picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/png.h"
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"

enum { N = 192, WIDTH = 800, HEIGHT = 500 };
static float position[N * N][3];
static uint8_t color[N * N][3], pixels[WIDTH * HEIGHT][4];
static uint32_t triangle[N * N * 2][3];

static void make_torus(void) {
    for (uint32_t i = 0; i < N * N; i++) {
        const uint32_t up = i / N * N + (i + 1) % N, right = (i + N) % (N * N), both = (up + N) % (N * N);
        const uint32_t corners[6] = {i, up, both, i, both, right};
        const float a = 6.2831853f / N * (float)(i / N), b = 6.2831853f / N * (float)(i % N);
        const float r = 1.0f + 0.4f * cosf(b), p[3] = {r * cosf(a), 0.4f * sinf(b), r * sinf(a)};
        memcpy(position[i], p, sizeof p);
        memcpy(triangle[2 * i], corners, sizeof corners);
        for (int k = 0; k < 3; k++) color[i][k] = (uint8_t)(160.0f + 90.0f * sinf(a + 2.0f * (float)k));
    }
}

int main(int argc, char **argv) {
    const voxrt_mesh mesh = {.positions = position[0], .vertex_count = N * N, .vertex_rgb = color[0],
                             .indices = triangle[0], .triangle_count = 2 * N * N};
    const voxrt_build_desc build = {.resolution = 512};               // voxels along the longest side
    const voxrt_render_desc render = {.samples = 16, .shadows = 1};   // the camera frames the torus
    const voxrt_image image = {.width = WIDTH, .height = HEIGHT, .rgba8 = pixels[0]};
    voxrt_tree *tree = NULL;
    sup_error err;

    make_torus();
    voxrt_result result = voxrt_tree_build(&build, &mesh, NULL, &tree);
    if (result == VOXRT_OK) result = voxrt_render(&render, tree, &image, NULL);
    voxrt_tree_destroy(tree);

    if (result != VOXRT_OK) (void)sup_fail(&err, "%s", voxrt_result_string(result));
    else if (!sup_png_write8(argc > 1 ? argv[1] : "voxrt.png", pixels[0], WIDTH, HEIGHT, 4, &err)) return 0;
    fprintf(stderr, "%s\n", err.text);
    return 1;
}
