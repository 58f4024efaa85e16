/* tile_file.h - pictures as tetcast.h codes them, with a head that says how - MIT OR Unlicense, see LICENSE

   byte 0  8 bytes: 0x89 "TIL" CR LF 0x1a LF
   byte 8  four 32-bit numbers, least significant byte first: codec (0 colour cells, 1 the same with alpha, 2 without
           loss), width, height, bytes that follow
   byte 24 the bytes
   Include it after tetcast.h. */
#ifndef SUP_TILE_FILE_H
#define SUP_TILE_FILE_H
#ifndef TETCAST_VERSION_MAJOR
#error "include tetcast.h before this header"
#endif

#include "base.h"

#define SUP_TILE_CODECS "cells|alpha|lossless|fitted" /* fitted: colour cells with better colours, the same in a file */
enum { SUP_TILE_CELLS, SUP_TILE_ALPHA, SUP_TILE_LOSSLESS, SUP_TILE_FITTED, SUP_TILE_HEAD = 24, SUP_TILE_SIDE = 65536 };

SUP_FN void supi_tile_put(uint8_t *p, size_t v) {
    for (int i = 0; i < 4; i++) p[i] = (uint8_t)(v >> (8 * i));
}
SUP_FN size_t supi_tile_get(const uint8_t *p) { return (size_t)p[0] | (size_t)p[1] << 8 | (size_t)p[2] << 16 | (size_t)p[3] << 24; }

/* rgba: 4 bytes a pixel -> *data (free with SUP_FREE), *size. Returns 0, or 1: no memory, or too large. */
SUP_FN int sup_tile_encode(int codec, const uint8_t *rgba, uint32_t width, uint32_t height, uint8_t **data, size_t *size) {
    static const uint8_t magic[8] = {0x89, 'T', 'I', 'L', '\r', '\n', 0x1a, '\n'};
    const size_t room = codec == SUP_TILE_LOSSLESS ? tetcast_pack_bound(width, height) : tetcast_ccc_size(width, height, codec == SUP_TILE_ALPHA);
    *data = NULL;
    *size = 0;
    if (!room || width > SUP_TILE_SIDE || height > SUP_TILE_SIDE || room > 0xffffffffu) return 1;
    *data = (uint8_t *)sup_alloc(room + SUP_TILE_HEAD, 1);
    if (!*data) return 1;
    *size = room;
    if (codec == SUP_TILE_LOSSLESS) *size = tetcast_pack(rgba, width, height, 0, *data + SUP_TILE_HEAD);
    else if (codec == SUP_TILE_FITTED) tetcast_ccc_encode_fitted(rgba, width, height, 0, 0, *data + SUP_TILE_HEAD);
    else tetcast_ccc_encode(rgba, width, height, 0, codec == SUP_TILE_ALPHA, *data + SUP_TILE_HEAD);
    memcpy(*data, magic, 8);
    supi_tile_put(*data + 8, codec == SUP_TILE_FITTED ? 0 : (size_t)codec);
    supi_tile_put(*data + 12, width);
    supi_tile_put(*data + 16, height);
    supi_tile_put(*data + 20, *size);
    *size += SUP_TILE_HEAD;
    return 0;
}

/* Bytes of sup_tile_encode -> *rgba (free with SUP_FREE). Everything is checked. Returns 0, or 1 with err->text set. */
SUP_FN int sup_tile_decode(const uint8_t *data, size_t size, uint8_t **rgba, uint32_t *width, uint32_t *height, sup_error *err) {
    size_t codec, bytes, pixels;
    *rgba = NULL;
    if (size < SUP_TILE_HEAD || memcmp(data, "\x89TIL\r\n\x1a\n", 8) != 0) return sup_fail(err, "no tile file");
    codec = supi_tile_get(data + 8);
    *width = (uint32_t)supi_tile_get(data + 12);
    *height = (uint32_t)supi_tile_get(data + 16);
    bytes = supi_tile_get(data + 20);
    if (codec > SUP_TILE_LOSSLESS || *width == 0 || *height == 0 || *width > SUP_TILE_SIDE || *height > SUP_TILE_SIDE ||
        bytes != size - SUP_TILE_HEAD ||
        (codec != SUP_TILE_LOSSLESS && bytes != tetcast_ccc_size(*width, *height, codec == SUP_TILE_ALPHA)))
        return sup_fail(err, "impossible sizes, or the end is missing");
    if (sup_mul_size(*width, *height, &pixels)) return sup_fail(err, "too large");
    *rgba = (uint8_t *)sup_alloc(pixels, 4);
    if (!*rgba) return sup_fail(err, "out of memory");
    if (codec != SUP_TILE_LOSSLESS) tetcast_ccc_decode(data + SUP_TILE_HEAD, *width, *height, 0, codec == SUP_TILE_ALPHA, *rgba);
    else if (tetcast_unpack(data + SUP_TILE_HEAD, bytes, *width, *height, 0, *rgba) != TETCAST_OK) {
        SUP_FREE(*rgba);
        *rgba = NULL;
        return sup_fail(err, "damaged");
    }
    return 0;
}

SUP_FN int sup_tile_write(const char *path, int codec, const uint8_t *rgba, uint32_t width, uint32_t height, sup_error *err) {
    uint8_t *data;
    size_t size;
    int failed;
    if (sup_tile_encode(codec, rgba, width, height, &data, &size)) return sup_fail(err, "%s: out of memory", path);
    failed = sup_write_file(path, data, size, err);
    SUP_FREE(data);
    return failed;
}

SUP_FN int sup_tile_read(const char *path, uint8_t **rgba, uint32_t *width, uint32_t *height, sup_error *err) {
    char *data;
    size_t size;
    sup_error inner;
    int failed;
    *rgba = NULL;
    if (sup_read_file(path, &data, &size, err)) return 1;
    sup_error_clear(&inner);
    failed = sup_tile_decode((const uint8_t *)data, size, rgba, width, height, &inner);
    if (failed) (void)sup_fail(err, "%s: %s", path, inner.text);
    SUP_FREE(data);
    return failed;
}

#endif
