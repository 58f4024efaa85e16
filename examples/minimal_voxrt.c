/* minimal_voxrt.c - the shortest useful program: a mesh becomes voxels, the voxels become a picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/png.h"
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"

enum { RING = 128, TUBE = 64, WIDTH = 800, HEIGHT = 600 };

static float position[RING * TUBE][3];
static uint8_t color[RING * TUBE][3];
static uint32_t triangle[RING * TUBE * 2][3];
static uint8_t pixels[WIDTH * HEIGHT * 4];

static void make_torus(void) {
    for (uint32_t i = 0; i < RING; i++) {
        for (uint32_t j = 0; j < TUBE; j++) {
            const float a = 6.2831853f * (float)i / RING, b = 6.2831853f * (float)j / TUBE, r = 1.0f + 0.4f * cosf(b);
            const uint32_t at = i * TUBE + j, right = (i + 1) % RING * TUBE + j;
            const uint32_t above = i * TUBE + (j + 1) % TUBE, both = (i + 1) % RING * TUBE + (j + 1) % TUBE;
            const uint32_t corner[6] = {at, above, both, at, both, right};
            position[at][0] = r * cosf(a);
            position[at][1] = 0.4f * sinf(b);
            position[at][2] = r * sinf(a);
            for (uint32_t k = 0; k < 3; k++) color[at][k] = (uint8_t)(160.0f + 90.0f * sinf(a + 2.0f * (float)k));
            memcpy(triangle[2 * at], corner, sizeof corner);
        }
    }
}

int main(int argc, char **argv) {
    voxrt_build_desc build = {0}; /* all zero: the defaults */
    voxrt_render_desc render = {0};
    voxrt_mesh mesh = {0};
    voxrt_image image = {0};
    voxrt_tree *tree = NULL;
    voxrt_result result;
    sup_error err;

    make_torus();
    mesh.positions = position[0];
    mesh.vertex_count = RING * TUBE;
    mesh.indices = triangle[0];
    mesh.triangle_count = RING * TUBE * 2;
    mesh.vertex_rgb = color[0];
    build.resolution = 512; /* voxels along the longest side */
    result = voxrt_tree_build(&build, &mesh, NULL, &tree);

    image.width = WIDTH;
    image.height = HEIGHT;
    image.rgba8 = pixels;
    render.shadows = 1;
    render.samples = 16;     /* rays per pixel */
    render.tolerance = 0.5f; /* pixels: how coarse the voxels may be that a ray stops at */
    if (result == VOXRT_OK) result = voxrt_render(&render, tree, &image, NULL);
    voxrt_tree_destroy(tree);

    if (result != VOXRT_OK) return fprintf(stderr, "%s\n", voxrt_result_string(result)), 1;
    if (sup_png_write8(argc > 1 ? argv[1] : "voxrt.png", pixels, WIDTH, HEIGHT, 4, &err)) return fprintf(stderr, "%s\n", err.text), 1;
    return 0;
}
