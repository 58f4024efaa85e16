/* tetcast_mpi.c - a frame of bricks drawn by several machines - MIT OR Unlicense, see LICENSE

   Optional: needs MPI (Debian: libopenmpi-dev). From the folder of tetcast.h:
       mpicc -O2 -ffp-contract=off -I. -Iexamples -o build/tetcast_mpi examples/mpi/tetcast_mpi.c -lm -lpthread
       mpirun -n 4 build/tetcast_mpi head.brk head.png [WIDTHxHEIGHT] [cells|alpha|lossless] [FRAMES]

   Sort first: process 0 reads the file and sends it to all; the frame is cut into tiles, which processes ask for one by
   one, so that fast ones draw more of them; each tile comes back coded. The picture has the bits of one that is drawn at
   once where the code is without loss. With one process it draws alone. FRAMES: the camera goes around, and half way the
   colours change; before each frame process 0 sends the parameters that changed, and tables are made anew only where one
   of theirs did. Pictures are OUT.png, OUT-2.png, ... */
#include <mpi.h>
#include "support/png.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "support/cli.h"
#include "support/tile_file.h"

enum { TILE = 128, TAG_READY = 1, TAG_DRAW = 2, TAG_HEAD = 3, TAG_DATA = 4 };

typedef struct job {
    tetcast_bricks *bricks;
    tetcast_cut *cut;
    tetcast_transfer *transfer;
    tetcast_optics *optics;
    tetcast_params *params;
    uint64_t sent, built; /* numbers of changes: the last one sent; of the colours when optics were made */
    tetcast_camera camera;
    uint32_t size[2], tiles[2];
    int codec;
} job;

static int open_job(job *j, const void *data, size_t size) {
    return tetcast_bricks_read(NULL, data, size, &j->bricks) != TETCAST_OK || tetcast_params_create(NULL, &j->params) != TETCAST_OK ||
           tetcast_cut_create(NULL, j->bricks, &j->cut) != TETCAST_OK;
}

/* Process 0: what frame i of n looks like. Five numbers a control point; from where. */
static int set_frame(job *j, int i, int n) {
    static const float colors[3][3] = {{0.1f, 0.2f, 0.9f}, {0.2f, 0.9f, 0.4f}, {1.0f, 0.4f, 0.1f}};
    const double angle = 6.283185307179586 * i / n;
    const float view[3] = {(float)sin(0.5 + angle), 0.5f, (float)cos(0.5 + angle)};
    float points[15];
    tetcast_bricks_info info;
    double side = 0.0;
    tetcast_bricks_get_info(j->bricks, &info);
    for (int k = 0; k < 3; k++) side = fmax(side, (info.lattice.dims[k] - 1) * info.lattice.spacing[k]);
    for (int k = 0; k < 3; k++) {
        points[5 * k] = info.value_min + (info.value_max - info.value_min) * (0.1f + 0.4f * (float)k);
        memcpy(points + 5 * k + 1, colors[2 * i < n ? k : 2 - k], sizeof colors[k]);
        points[5 * k + 4] = (float)(k * 8.0 / (side > 0.0 ? side : 1.0));
    }
    return tetcast_params_set(j->params, "points", points, 15) != TETCAST_OK || tetcast_params_set(j->params, "view", view, 3) != TETCAST_OK;
}

/* Everybody: what changed goes round, and what depends on it is made anew. */
static int share_frame(job *j, int rank) {
    unsigned long long bytes = rank == 0 ? tetcast_params_changes(j->params, j->sent, NULL, 0) : 0;
    double lo[3], hi[3], view[3];
    tetcast_bricks_info info;
    const float *v;
    size_t count;
    const tetcast_param *list;
    uint8_t *data;
    int failed;
    MPI_Bcast(&bytes, 1, MPI_UNSIGNED_LONG_LONG, 0, MPI_COMM_WORLD);
    data = (uint8_t *)sup_alloc((size_t)bytes, 1);
    if (!data || bytes > 0x7fffffffu) MPI_Abort(MPI_COMM_WORLD, 1);
    if (rank == 0) (void)tetcast_params_changes(j->params, j->sent, data, (size_t)bytes);
    MPI_Bcast(data, (int)bytes, MPI_BYTE, 0, MPI_COMM_WORLD);
    failed = rank != 0 && tetcast_params_apply(j->params, data, (size_t)bytes) != TETCAST_OK;
    SUP_FREE(data);
    j->sent = tetcast_params_changed(j->params, NULL);
    list = tetcast_params_list(j->params, &count);
    if (!failed && tetcast_params_changed(j->params, "points") > j->built) {
        tetcast_control_point points[3];
        tetcast_transfer_desc desc;
        v = tetcast_params_find(list, count, "points", 15, NULL);
        memset(points, 0, sizeof points);
        memset(&desc, 0, sizeof desc);
        for (int k = 0; k < 3 && v; k++) {
            points[k].value = v[5 * k];
            memcpy(points[k].rgb, v + 5 * k + 1, sizeof points[k].rgb);
            points[k].extinction = v[5 * k + 4];
        }
        desc.points = points;
        desc.point_count = 3;
        tetcast_optics_destroy(j->optics);
        tetcast_transfer_destroy(j->transfer);
        j->optics = NULL;
        j->transfer = NULL;
        failed = !v || tetcast_transfer_create(&desc, &j->transfer) != TETCAST_OK ||
                 tetcast_optics_create(j->transfer, NULL, &j->optics) != TETCAST_OK;
        j->built = tetcast_params_changed(j->params, "points");
    }
    v = tetcast_params_find(list, count, "view", 3, NULL);
    tetcast_bricks_get_info(j->bricks, &info);
    for (int k = 0; k < 3; k++) {
        lo[k] = info.lattice.origin[k];
        hi[k] = lo[k] + (info.lattice.dims[k] - 1) * info.lattice.spacing[k];
        view[k] = v ? (double)v[k] : 1.0;
    }
    return failed || !v || tetcast_camera_fit(&j->camera, lo, hi, view, j->size[0], j->size[1]) != TETCAST_OK;
}

static void tile_box(const job *j, int tile, uint32_t box[4]) {
    box[0] = (uint32_t)tile % j->tiles[0] * TILE;
    box[1] = (uint32_t)tile / j->tiles[0] * TILE;
    box[2] = j->size[0] - box[0] < TILE ? j->size[0] - box[0] : TILE;
    box[3] = j->size[1] - box[1] < TILE ? j->size[1] - box[1] : TILE;
}

/* One tile -> coded bytes; NULL: it failed. */
static uint8_t *draw_tile(const job *j, int tile, size_t *size) {
    tetcast_brick_render_desc d;
    tetcast_image image;
    uint32_t box[4];
    uint8_t *data = NULL;
    tile_box(j, tile, box);
    memset(&d, 0, sizeof d);
    memset(&image, 0, sizeof image);
    d.camera = j->camera;
    d.frame[0] = j->size[0];
    d.frame[1] = j->size[1];
    d.part[0] = box[0];
    d.part[1] = box[1];
    image.width = box[2];
    image.height = box[3];
    image.rgba8 = (uint8_t *)sup_alloc((size_t)box[2] * box[3], 4);
    if (image.rgba8 && tetcast_render_bricks(&d, j->cut, j->optics, &image, NULL) == TETCAST_OK)
        (void)sup_tile_encode(j->codec, image.rgba8, box[2], box[3], &data, size);
    SUP_FREE(image.rgba8);
    return data;
}

static int put_tile(const job *j, int tile, const uint8_t *data, size_t size, uint8_t *picture, sup_error *err) {
    uint8_t *pixels;
    uint32_t box[4], width = 0, height = 0;
    tile_box(j, tile, box);
    if (sup_tile_decode(data, size, &pixels, &width, &height, err)) return 1;
    if (width == box[2] && height == box[3])
        for (uint32_t y = 0; y < height; y++)
            memcpy(picture + 4 * ((size_t)(box[1] + y) * j->size[0] + box[0]), pixels + 4 * (size_t)y * width, 4 * (size_t)width);
    SUP_FREE(pixels);
    return 0;
}

/* Process 0 hands out tiles and puts them together. */
static int collect(const job *j, int processes, uint8_t *picture, sup_error *err) {
    const int tiles = (int)(j->tiles[0] * j->tiles[1]);
    int next = 0, waiting = processes - 1, failed = 0;
    for (; processes == 1 && next < tiles && !failed; next++) {
        size_t size;
        uint8_t *data = draw_tile(j, next, &size);
        failed = data ? put_tile(j, next, data, size, picture, err) : sup_fail(err, "a tile could not be drawn");
        SUP_FREE(data);
    }
    while (waiting > 0) { /* a process that is ready brings the tile before, if there was one */
        int head[2], from, tile;
        MPI_Status status;
        MPI_Recv(head, 2, MPI_INT, MPI_ANY_SOURCE, TAG_READY, MPI_COMM_WORLD, &status);
        from = status.MPI_SOURCE;
        if (head[0] >= 0) {
            uint8_t *data = (uint8_t *)sup_alloc((size_t)head[1], 1);
            if (!data) MPI_Abort(MPI_COMM_WORLD, 1);
            MPI_Recv(data, head[1], MPI_BYTE, from, TAG_DATA, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
            if (!failed) failed = head[1] ? put_tile(j, head[0], data, (size_t)head[1], picture, err) : sup_fail(err, "a tile could not be drawn");
            SUP_FREE(data);
        }
        tile = next < tiles ? next++ : -1;
        waiting -= tile < 0;
        MPI_Send(&tile, 1, MPI_INT, from, TAG_DRAW, MPI_COMM_WORLD);
    }
    return failed;
}

static void work(const job *j) {
    int head[2] = {-1, 0}, tile;
    uint8_t *data = NULL;
    for (;;) {
        size_t size = 0;
        MPI_Send(head, 2, MPI_INT, 0, TAG_READY, MPI_COMM_WORLD);
        if (head[0] >= 0) MPI_Send(data ? data : (uint8_t *)head, head[1], MPI_BYTE, 0, TAG_DATA, MPI_COMM_WORLD);
        SUP_FREE(data);
        data = NULL;
        MPI_Recv(&tile, 1, MPI_INT, 0, TAG_DRAW, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
        if (tile < 0) return;
        data = draw_tile(j, tile, &size);
        head[0] = tile;
        head[1] = data ? (int)size : 0;
    }
}

int main(int argc, char **argv) {
    job j;
    char *data = NULL;
    size_t size = 0;
    unsigned long long bytes = 0;
    int rank = 0, processes = 1, failed = 0, frames = 1;
    uint8_t *picture = NULL;
    sup_error err;
    memset(&j, 0, sizeof j);
    sup_error_clear(&err);
    j.size[0] = j.size[1] = 512;
    MPI_Init(&argc, &argv);
    MPI_Comm_rank(MPI_COMM_WORLD, &rank);
    MPI_Comm_size(MPI_COMM_WORLD, &processes);
    if (argc < 3 || (argc > 3 && sscanf(argv[3], "%ux%u", &j.size[0], &j.size[1]) != 2) || j.size[0] - 1u >= 16384u ||
        j.size[1] - 1u >= 16384u || (argc > 4 && (j.codec = sup_parse_choice(argv[4], SUP_TILE_CODECS)) < 0) ||
        (argc > 5 && (sscanf(argv[5], "%d", &frames) != 1 || frames < 1 || frames > 100000))) {
        if (rank == 0) fprintf(stderr, "usage: %s IN.brk OUT.png [WIDTHxHEIGHT] [" SUP_TILE_CODECS "] [FRAMES]\n", argv[0]);
        MPI_Finalize();
        return 2;
    }
    if (argc <= 4) j.codec = SUP_TILE_LOSSLESS;
    j.tiles[0] = (j.size[0] + TILE - 1) / TILE;
    j.tiles[1] = (j.size[1] + TILE - 1) / TILE;
    if (rank == 0) failed = sup_read_file(argv[1], &data, &size, &err);
    bytes = failed ? 0 : size;
    MPI_Bcast(&bytes, 1, MPI_UNSIGNED_LONG_LONG, 0, MPI_COMM_WORLD);
    if (bytes == 0 || bytes > 0x7fffffffu) failed = failed ? failed : sup_fail(&err, "%s: empty, or too large for one message", argv[1]);
    else {
        if (rank != 0) data = (char *)sup_alloc((size_t)bytes, 1);
        if (!data) MPI_Abort(MPI_COMM_WORLD, 1);
        MPI_Bcast(data, (int)bytes, MPI_BYTE, 0, MPI_COMM_WORLD);
        failed = open_job(&j, data, (size_t)bytes) ? sup_fail(&err, "%s: no brick file", argv[1]) : 0; /* the same everywhere */
    }
    SUP_FREE(data);
    if (!failed && rank == 0) picture = (uint8_t *)sup_alloc((size_t)j.size[0] * j.size[1], 4);
    if (!failed && rank == 0 && !picture) MPI_Abort(MPI_COMM_WORLD, 1);
    for (int i = 0; i < frames && (i != 0 || !failed); i++) { /* a frame that failed ends all processes at the next one */
        char name[4096];
        const int length = (int)strlen(argv[2]), stem = length > 4 && strcmp(argv[2] + length - 4, ".png") == 0 ? length - 4 : length;
        int all;
        if (rank == 0 && !failed) failed = set_frame(&j, i, frames) ? sup_fail(&err, "out of memory") : 0;
        MPI_Allreduce(&failed, &all, 1, MPI_INT, MPI_MAX, MPI_COMM_WORLD);
        failed = all;
        if (!failed) failed = share_frame(&j, rank) ? sup_fail(&err, "parameters did not arrive") : 0;
        MPI_Allreduce(&failed, &all, 1, MPI_INT, MPI_MAX, MPI_COMM_WORLD);
        failed = all;
        if (failed) break;
        if (rank != 0) work(&j);
        else {
            memset(picture, 0, (size_t)j.size[0] * j.size[1] * 4);
            failed = collect(&j, processes, picture, &err);
            if (i == 0) (void)snprintf(name, sizeof name, "%s", argv[2]);
            else (void)snprintf(name, sizeof name, "%.*s-%d.png", stem, argv[2], i + 1);
            if (!failed) failed = sup_png_write8(name, picture, j.size[0], j.size[1], 4, &err);
        }
    }
    if (failed && rank == 0) fprintf(stderr, "%s: %s\n", argv[0], err.text);
    SUP_FREE(picture);
    tetcast_optics_destroy(j.optics);
    tetcast_transfer_destroy(j.transfer);
    tetcast_cut_destroy(j.cut);
    tetcast_params_destroy(j.params);
    tetcast_bricks_destroy(j.bricks);
    MPI_Finalize();
    return failed != 0;
}
