/* fuzz_image.c - readers of pictures: PNG, PPM, PGM. The first byte says whether the sums of chunks are made right, so that
   what is behind them is reached */
#include "../../examples/support/texture.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    sup_image image;
    sup_texture texture;
    sup_error err;
    uint8_t *copy;
    double color[3];
    size_t at;
    if (size == 0 || size > 1 << 20) return 0;
    copy = (uint8_t *)malloc(size);
    if (!copy) return 0;
    memcpy(copy, data + 1, size - 1);
    for (at = 8; (data[0] & 1) && size - 1 > at && size - 1 - at >= 12;) {
        const uint32_t n = supi_load_big32(copy + at);
        if (n > size - 1 - at - 12) break;
        supi_big32(copy + at + 8 + n, supi_crc32(copy + at + 4, (size_t)n + 4));
        at += 12 + (size_t)n;
    }
    if (!sup_image_decode(copy, size - 1, "x", &image, &err)) {
        if ((uint64_t)image.width * image.height <= 1 << 20 && !sup_texture_make(&image, data[0] >> 1 & 1, &texture)) {
            sup_texture_look(&texture, (double)data[0], 0.3, (double)size, data[0] >> 2 & 1, color);
            sup_texture_free(&texture);
        }
        sup_image_free(&image);
    }
    free(copy);
    return 0;
}
