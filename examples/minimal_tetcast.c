/* minimal_tetcast.c - a volume from a formula, cut into tetrahedra, as a picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/png.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"

enum { N = 64, WIDTH = 800, HEIGHT = 500 };
static float value[N * N * N];
static uint8_t pixels[WIDTH * HEIGHT][4];

static void make_knot(void) {
    for (int i = 0; i < N * N * N; i++) {
        const float x = (float)(i % N) / 21.0f - 1.5f, y = (float)(i / N % N) / 21.0f - 1.5f;
        const float z = (float)(i / N / N) / 21.0f - 1.5f, a = 1.5f * atan2f(z, x), r = sqrtf(x * x + z * z) - 1.0f;
        const float u = 0.3f * cosf(a), v = 0.3f * sinf(a);
        value[i] = expf(-40.0f * ((r - u) * (r - u) + (y - v) * (y - v))) +
                   expf(-40.0f * ((r + u) * (r + u) + (y + v) * (y + v)));
    }
}

int main(int argc, char **argv) {
    const tetcast_field field = {.name = "knot", .values = {.data = value}};
    const tetcast_grid grid = {.dims = {N, N, N}, .fields = &field, .field_count = 1};
    const tetcast_control_point points[] = {{0.1f, {0.1f, 0.2f, 0.9f}, 0.0f},    // value, colour, extinction
                                            {0.4f, {0.1f, 0.7f, 0.9f}, 0.08f},
                                            {0.9f, {1.0f, 0.5f, 0.1f}, 0.6f}};
    const tetcast_transfer_desc colours = {.points = points, .point_count = 3};
    const tetcast_render_desc render = {.background = {0.02f, 0.02f, 0.03f, 1.0f}}; // the camera frames the volume
    const tetcast_image image = {.width = WIDTH, .height = HEIGHT, .rgba8 = pixels[0]};
    tetcast_mesh *mesh = NULL;
    tetcast_transfer *transfer = NULL;
    tetcast_optics *optics = NULL;
    sup_error err;

    make_knot();
    tetcast_result result = tetcast_mesh_create_grid(NULL, &grid, NULL, &mesh);
    if (result == TETCAST_OK) result = tetcast_transfer_create(&colours, &transfer);
    if (result == TETCAST_OK) result = tetcast_optics_create(transfer, NULL, &optics);
    if (result == TETCAST_OK) result = tetcast_render(&render, mesh, optics, &image, NULL);
    tetcast_optics_destroy(optics);
    tetcast_transfer_destroy(transfer);
    tetcast_mesh_destroy(mesh);

    if (result != TETCAST_OK) (void)sup_fail(&err, "%s", tetcast_result_string(result));
    else if (!sup_png_write8(argc > 1 ? argv[1] : "tetcast.png", pixels[0], WIDTH, HEIGHT, 4, &err)) return 0;
    fprintf(stderr, "%s\n", err.text);
    return 1;
}
