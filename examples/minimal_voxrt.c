/* minimal_voxrt.c - the shortest useful program: a mesh becomes voxels, the voxels become a picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/png.h"
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"

enum { RING = 128, TUBE = 64, WIDTH = 800, HEIGHT = 500 };

static float position[RING * TUBE][3], normal[RING * TUBE][3];
static uint8_t color[RING * TUBE][3], pixels[WIDTH * HEIGHT * 4];
static uint32_t triangle[RING * TUBE * 2][3];

static void make_torus(void) {
    for (uint32_t i = 0; i < RING * TUBE; i++) {
        const uint32_t ring = i / TUBE, up = ring * TUBE + (i + 1) % TUBE, next = TUBE * ((ring + 1) % RING);
        const uint32_t corner[6] = {i, up, next + up % TUBE, i, next + up % TUBE, next + i % TUBE};
        const float a = 6.2831853f * (float)ring / RING, b = 6.2831853f * (float)(i % TUBE) / TUBE;
        const float n[3] = {cosf(a) * cosf(b), sinf(b), sinf(a) * cosf(b)};
        const float p[3] = {cosf(a) + 0.4f * n[0], 0.4f * n[1], sinf(a) + 0.4f * n[2]};
        memcpy(normal[i], n, sizeof n);
        memcpy(position[i], p, sizeof p);
        memcpy(triangle[2 * i], corner, sizeof corner);
        for (uint32_t k = 0; k < 3; k++) color[i][k] = (uint8_t)(160.0f + 90.0f * sinf(a + 2.0f * (float)k));
    }
}

int main(int argc, char **argv) {
    voxrt_mesh mesh = {0};
    voxrt_build_desc build = {0}; /* all zero: the defaults */
    voxrt_render_desc render = {0};
    voxrt_image image = {0};
    voxrt_tree *tree = NULL;
    voxrt_result result;
    sup_error err;

    make_torus();
    mesh.positions = position[0];
    mesh.normals = normal[0];
    mesh.vertex_rgb = color[0];
    mesh.vertex_count = RING * TUBE;
    mesh.indices = triangle[0];
    mesh.triangle_count = 2 * RING * TUBE;
    build.resolution = 512; /* voxels along the longest side */
    result = voxrt_tree_build(&build, &mesh, NULL, &tree);

    image.width = WIDTH;
    image.height = HEIGHT;
    image.rgba8 = pixels;
    render.shadows = 1;
    render.samples = 16;     /* rays per pixel */
    render.tolerance = 0.5f; /* how wide a voxel may be, in pixels, for a ray to stop there */
    if (result == VOXRT_OK) result = voxrt_render(&render, tree, &image, NULL);
    voxrt_tree_destroy(tree);

    if (result != VOXRT_OK) (void)sup_fail(&err, "%s", voxrt_result_string(result));
    if (result == VOXRT_OK && !sup_png_write8(argc > 1 ? argv[1] : "voxrt.png", pixels, WIDTH, HEIGHT, 4, &err)) return 0;
    fprintf(stderr, "%s\n", err.text);
    return 1;
}
