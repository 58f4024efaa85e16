/* fuzz_bricks.c - any bytes as a file of bricks. What is accepted is cut, asked, drawn, and is the same after it was written and
   read. The checksums are made right first, otherwise only they would be tested. */
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Levels of slots are those that are counted; a budget lies between the share of the coarsest level and all. */
static void count_levels(const tetcast_cut *cut, const tetcast_bricks_info *info) {
    const uint8_t *level = tetcast_cut_levels(cut);
    const size_t slots = (size_t)info->slots[0] * info->slots[1] * info->slots[2];
    uint64_t count[TETCAST_BRICK_LEVELS] = {0};
    tetcast_cut_info ci;
    double seconds;
    size_t i;
    tetcast_cut_get_info(cut, &ci);
    for (i = 0; i < slots; i++) {
        if (level[i] >= info->levels) abort();
        count[level[i]]++;
    }
    if (memcmp(count, ci.level_slots, sizeof count) != 0 || !(ci.samples >= 1.0 / 32.0 && ci.samples <= 1.0)) abort();
    for (seconds = 0.25; seconds < 8.0; seconds *= 1.25) {
        const double pace = tetcast_cut_pace(&ci, seconds, 1.0);
        if (!(pace >= 1.0 / 32.0 && pace <= 1.0)) abort();
    }
}

static void draw(const tetcast_bricks *b, uint8_t way) {
    static const tetcast_control_point points[2] = {{0.0f, {1.0f, 0.5f, 0.25f}, 0.5f}, {1.0f, {0.25f, 0.5f, 1.0f}, 4.0f}};
    float rgba[8 * 8 * 4], x[3][9], v[9];
    tetcast_bricks_info info;
    tetcast_cut_desc cd;
    tetcast_cut *cut = NULL;
    tetcast_transfer_desc td;
    tetcast_transfer *transfer = NULL;
    tetcast_optics *optics = NULL;
    tetcast_image image;
    size_t i;
    tetcast_bricks_get_info(b, &info);
    memset(&cd, 0, sizeof cd);
    cd.env.memory_limit = (size_t)1 << 26;
    cd.env.thread_count = 1;
    cd.level = way & 3u;
    cd.max_jump = way >> 2 & 1u;
    if (tetcast_cut_create(&cd, b, &cut) != TETCAST_OK) return;
    count_levels(cut, &info);
    for (i = 0; i < 27; i++) x[i / 9][i % 9] = (float)(i % 7) * 5.5f - 3.0f;
    tetcast_cut_sample(cut, x[0], x[1], x[2], 9, TETCAST_ISA_AUTO, v);
    for (i = 0; i < 9; i++)
        if (!(v[i] - v[i] == 0.0f)) abort();
    memset(&td, 0, sizeof td);
    td.points = points;
    td.point_count = 2;
    memset(&image, 0, sizeof image);
    image.width = image.height = 8;
    image.rgba = rgba;
    if (tetcast_transfer_create(&td, &transfer) == TETCAST_OK && tetcast_optics_create(transfer, NULL, &optics) == TETCAST_OK) {
        tetcast_brick_render_desc rd;
        memset(&rd, 0, sizeof rd);
        rd.env = cd.env;
        if (tetcast_render_bricks(&rd, cut, optics, &image, NULL) == TETCAST_OK)
            for (i = 0; i < sizeof rgba / sizeof rgba[0]; i++)
                if (!(rgba[i] - rgba[i] == 0.0f)) abort();
    }
    tetcast_optics_destroy(optics);
    tetcast_transfer_destroy(transfer);
    tetcast_cut_destroy(cut);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    uint8_t *copy = (uint8_t *)malloc(size + 1), *again;
    tetcast_env env;
    tetcast_bricks *b = NULL, *c = NULL;
    if (copy == NULL) return 0;
    if (size != 0) memcpy(copy, data, size);
    if (size >= TETCASTI_BRK_HEADER) {
        const uint64_t lists = (uint64_t)tetcasti_load_u32(copy + 28) * TETCASTI_BRK_RECORD +
            (uint64_t)tetcasti_load_u32(copy + 44) * 24 + (uint64_t)tetcasti_load_u32(copy + 112) * 12;
        const size_t rest = size - TETCASTI_BRK_HEADER;
        tetcasti_store_u64(copy + 120, size);
        if (lists <= rest) {
            tetcasti_store_u64(copy + 128, tetcasti_hash_bytes(1, copy + TETCASTI_BRK_HEADER, (size_t)lists));
            tetcasti_store_u64(copy + 136, tetcasti_hash_bytes(2, copy + TETCASTI_BRK_HEADER + lists, rest - (size_t)lists));
        }
        tetcasti_store_u64(copy + 144, tetcasti_hash_bytes(3, copy, 144));
    }
    memset(&env, 0, sizeof env);
    env.memory_limit = (size_t)1 << 26;
    env.thread_count = 1;
    if (tetcast_bricks_read(&env, copy, size, &b) == TETCAST_OK) {
        if (tetcast_bricks_file_size(b) != size) abort();
        again = (uint8_t *)malloc(size);
        if (again != NULL) {
            if (tetcast_bricks_write(b, again, size) != TETCAST_OK) abort();
            if (tetcast_bricks_read(&env, again, size, &c) != TETCAST_OK) abort();
        }
        draw(b, size != 0 ? copy[size - 1] : 0);
        tetcast_bricks_destroy(c);
        free(again);
    }
    tetcast_bricks_destroy(b);
    free(copy);
    return 0;
}
