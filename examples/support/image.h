/* image.h - PNG, PPM and PGM readers: own inflate, all bit depths, palettes, alpha, interlaced; safe for any bytes
   SPDX-License-Identifier: MIT OR Unlicense

       sup_image image;
       if (sup_image_read("wood.png", &image, &err)) ...
       ... sup_image_free(&image);

   References: PNG (Second Edition), ISO/IEC 15948; P. Deutsch, RFC 1950 and RFC 1951; Netpbm, ppm(5) and pgm(5).
   Check sums are verified; gamma, colour profiles and background colours are passed over: values are taken for sRGB. */
#ifndef SUP_IMAGE_H
#define SUP_IMAGE_H

#include "png.h"
#include "text.h"

/* A picture in memory, rows from top to bottom, components interleaved, 16 bits in the order of this machine. */
typedef struct sup_image {
    uint16_t *pixels;  /* [width * height * channels], 0 to 65535 */
    uint32_t width, height;
    uint32_t channels; /* 1 gray, 2 gray and alpha, 3 RGB, 4 RGBA */
    uint32_t bits;     /* of the file: 1 to 16 */
} sup_image;

enum { SUP_IMAGE_MOST = 65536 }; /* pixels along a side; larger ones are refused */

SUP_FN void sup_image_free(sup_image *image) {
    SUP_FREE(image->pixels);
    memset(image, 0, sizeof *image);
}

/* ---- inflate ------------------------------------------------------------------------------------------------ */

/* A canonical code: symbols in the order of their codes, and how many there are of each length. */
typedef struct supi_huffman {
    uint16_t count[16], symbol[288];
    uint16_t quick[512]; /* by the next 9 bits: symbol << 4 | length; 0: longer, or none */
} supi_huffman;

typedef struct supi_inflate {
    const uint8_t *at, *end;
    uint64_t hold; /* bits read from the stream and not used yet, the next one lowest */
    unsigned held;
    unsigned past; /* bits behind the end that were taken for 0 */
    supi_huffman literal, distance;
} supi_inflate;

SUP_FN void supi_inflate_fill(supi_inflate *s) {
    while (s->held <= 56) {
        if (s->at < s->end) s->hold |= (uint64_t)*s->at++ << s->held;
        else s->past += 8;
        s->held += 8;
    }
}

SUP_FN uint32_t supi_inflate_bits(supi_inflate *s, unsigned count) { /* up to 16 */
    uint32_t value;
    supi_inflate_fill(s);
    value = (uint32_t)s->hold & ((1u << count) - 1u);
    s->hold >>= count;
    s->held -= count;
    return value;
}

/* More bits were used than there are. */
SUP_FN int supi_inflate_short(const supi_inflate *s) { return s->past > s->held; }

/* Returns 1 when the lengths are those of no code. A code of one symbol, or of none, may be incomplete. */
SUP_FN int supi_huffman_make(supi_huffman *h, const uint8_t *lengths, unsigned count) {
    uint16_t first[16];
    unsigned i, k, used = 0;
    int left = 1;
    memset(h, 0, sizeof *h);
    for (i = 0; i < count; i++) h->count[lengths[i]]++;
    used = count - h->count[0];
    h->count[0] = 0;
    for (i = 1; i < 16; i++) {
        left = 2 * left - (int)h->count[i];
        if (left < 0) return 1;
    }
    if (left > 0 && used > 1) return 1;
    first[1] = 0;
    for (i = 1; i < 15; i++) first[i + 1] = (uint16_t)(first[i] + h->count[i]);
    for (i = 0; i < count; i++) {
        if (lengths[i]) h->symbol[first[lengths[i]]++] = (uint16_t)i;
    }
    for (i = 1, k = 0, left = 0; i < 10; i++, left <<= 1) { /* left: the next code of this length */
        unsigned n;
        for (n = 0; n < h->count[i]; n++, k++, left++) {
            unsigned turned = 0, bit;
            for (bit = 0; bit < i; bit++) turned |= ((unsigned)left >> bit & 1u) << (i - 1 - bit);
            for (; turned < 512; turned += 1u << i) h->quick[turned] = (uint16_t)((unsigned)h->symbol[k] << 4 | i);
        }
    }
    return 0;
}

SUP_FN int supi_inflate_symbol(supi_inflate *s, const supi_huffman *h) { /* -1: no such code */
    unsigned code = 0, first = 0, index = 0, length;
    supi_inflate_fill(s);
    if (h->quick[s->hold & 511]) {
        length = h->quick[s->hold & 511] & 15u;
        code = h->quick[s->hold & 511] >> 4;
        s->hold >>= length;
        s->held -= length;
        return (int)code;
    }
    for (length = 1; length < 16; length++) {
        code |= (unsigned)(s->hold >> (length - 1)) & 1u;
        if (code < first + h->count[length]) {
            s->hold >>= length;
            s->held -= length;
            return h->symbol[index + code - first];
        }
        index += h->count[length];
        first = (first + h->count[length]) << 1;
        code <<= 1;
    }
    return -1;
}

/* The two codes of a dynamic block. */
SUP_FN int supi_inflate_codes(supi_inflate *s) {
    static const uint8_t order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    uint8_t lengths[320];
    const unsigned n = supi_inflate_bits(s, 5) + 257, m = supi_inflate_bits(s, 5) + 1, k = supi_inflate_bits(s, 4) + 4;
    unsigned i;
    memset(lengths, 0, sizeof lengths);
    for (i = 0; i < k; i++) lengths[order[i]] = (uint8_t)supi_inflate_bits(s, 3);
    if (n > 286 || m > 30 || supi_huffman_make(&s->literal, lengths, 19)) return 1;
    memset(lengths, 0, sizeof lengths);
    for (i = 0; i < n + m;) {
        const int symbol = supi_inflate_symbol(s, &s->literal);
        unsigned run = 1;
        uint8_t value = (uint8_t)symbol;
        if (symbol < 0 || supi_inflate_short(s)) return 1;
        if (symbol == 16) {
            if (i == 0) return 1;
            value = lengths[i - 1];
            run = 3 + supi_inflate_bits(s, 2);
        } else if (symbol >= 17) {
            value = 0;
            run = symbol == 17 ? 3 + supi_inflate_bits(s, 3) : 11 + supi_inflate_bits(s, 7);
        }
        if (i + run > n + m) return 1;
        for (; run > 0; run--) lengths[i++] = value;
    }
    if (lengths[256] == 0) return 1;
    return supi_huffman_make(&s->distance, lengths + n, m) || supi_huffman_make(&s->literal, lengths, n);
}

SUP_FN void supi_inflate_fixed(supi_inflate *s) {
    uint8_t lengths[288];
    unsigned i;
    for (i = 0; i < 288; i++) lengths[i] = i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8;
    (void)supi_huffman_make(&s->literal, lengths, 288);
    memset(lengths, 5, 30); /* codes 30 and 31 are none */
    memset(&s->distance, 0, sizeof s->distance);
    s->distance.count[5] = 30;
    for (i = 0; i < 30; i++) s->distance.symbol[i] = (uint16_t)i;
}

SUP_FN int supi_inflate_stored(supi_inflate *s, uint8_t *out, size_t size, size_t *done) {
    uint32_t length, check;
    (void)supi_inflate_bits(s, s->held & 7u);
    length = supi_inflate_bits(s, 16);
    check = supi_inflate_bits(s, 16);
    if (supi_inflate_short(s) || check != (length ^ 0xffffu) || length > size - *done) return 1;
    s->at -= (s->held - s->past) / 8; /* whole bytes that are held */
    s->hold = 0;
    s->held = s->past = 0;
    if ((size_t)(s->end - s->at) < length) return 1;
    if (length) memcpy(out + *done, s->at, length);
    s->at += length;
    *done += length;
    return 0;
}

SUP_FN int supi_inflate_block(supi_inflate *s, uint8_t *out, size_t size, size_t *done) {
    for (;;) {
        int symbol = supi_inflate_symbol(s, &s->literal);
        size_t length, distance, from;
        unsigned extra;
        if (symbol < 0 || symbol > 285 || supi_inflate_short(s)) return 1;
        if (symbol == 256) return 0;
        if (symbol < 256) {
            if (*done == size) return 1;
            out[(*done)++] = (uint8_t)symbol;
            continue;
        }
        symbol -= 257; /* four symbols for each number of extra bits from 265 on */
        extra = symbol < 8 || symbol == 28 ? 0 : (unsigned)symbol / 4 - 1;
        length = symbol == 28 ? 258u : symbol < 8 ? 3u + (size_t)symbol : 3u + ((4u + (size_t)symbol % 4) << extra);
        length += supi_inflate_bits(s, extra);
        symbol = supi_inflate_symbol(s, &s->distance);
        if (symbol < 0 || symbol > 29) return 1;
        extra = symbol < 4 ? 0 : (unsigned)symbol / 2 - 1;
        distance = symbol < 4 ? 1u + (size_t)symbol : 1u + ((2u + (size_t)symbol % 2) << extra);
        distance += supi_inflate_bits(s, extra);
        if (supi_inflate_short(s) || distance > *done || length > size - *done) return 1;
        for (from = *done - distance; length > 0; length--) out[(*done)++] = out[from++];
    }
}

/* Unpack a zlib stream of exactly `size` bytes. scratch: cleared state. Returns 0, or 1 when it is none. */
SUP_FN int supi_unzip(supi_inflate *s, const uint8_t *in, size_t in_size, uint8_t *out, size_t size) {
    size_t done = 0;
    uint32_t last, sum;
    memset(s, 0, sizeof *s);
    if (in_size < 6 || (in[0] & 15) != 8 || in[0] >> 4 > 7 || (in[0] * 256 + in[1]) % 31 != 0 || (in[1] & 32)) return 1;
    s->at = in + 2;
    s->end = in + in_size - 4;
    do {
        uint32_t kind;
        last = supi_inflate_bits(s, 1);
        kind = supi_inflate_bits(s, 2);
        if (supi_inflate_short(s) || kind == 3) return 1;
        if (kind == 0) {
            if (supi_inflate_stored(s, out, size, &done)) return 1;
            continue;
        }
        if (kind == 1) supi_inflate_fixed(s);
        else if (supi_inflate_codes(s)) return 1;
        if (supi_inflate_block(s, out, size, &done)) return 1;
    } while (!last);
    if (done != size || s->held < s->past || (size_t)(s->end - s->at) + (s->held - s->past) / 8 != 0) return 1;
    sum = supi_adler32(out, size);
    in += in_size - 4;
    return sum != ((uint32_t)in[0] << 24 | (uint32_t)in[1] << 16 | (uint32_t)in[2] << 8 | in[3]);
}

/* ---- PNG ---------------------------------------------------------------------------------------------------- */

typedef struct supi_png {
    const char *name;
    sup_error *err;
    uint32_t width, height, bits, type, samples; /* samples: numbers for a pixel in the file */
    int interlaced, has_key;
    uint32_t key[4];         /* the colour that is transparent */
    uint8_t palette[256][4]; /* RGBA */
    uint32_t palette_count;
    uint8_t *packed;         /* IDAT, all of it */
    size_t packed_size;
} supi_png;

SUP_FN uint32_t supi_load_big32(const uint8_t *p) {
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

SUP_FN int supi_png_head(supi_png *p, const uint8_t *data, uint32_t size) {
    static const uint8_t samples[7] = {1, 0, 3, 1, 2, 0, 4};
    if (size != 13 || data[10] || data[11] || data[12] > 1)
        return sup_fail(p->err, "%s: a PNG with a header that is not known", p->name);
    p->width = supi_load_big32(data);
    p->height = supi_load_big32(data + 4);
    p->bits = data[8];
    p->type = data[9];
    p->interlaced = data[12];
    p->samples = p->type < 7 ? samples[p->type] : 0;
    if (p->samples == 0 || (p->bits != 8 && p->bits != 16 && (p->bits > 4 || (p->bits & (p->bits - 1)) != 0 || p->bits == 0)) ||
        (p->bits < 8 && p->type != 0 && p->type != 3) || (p->bits == 16 && p->type == 3))
        return sup_fail(p->err, "%s: a PNG with %lu bits of kind %lu", p->name, (unsigned long)p->bits, (unsigned long)p->type);
    if (p->width == 0 || p->height == 0 || p->width > SUP_IMAGE_MOST || p->height > SUP_IMAGE_MOST)
        return sup_fail(p->err, "%s: %lu x %lu pixels are none or too many", p->name, (unsigned long)p->width,
                        (unsigned long)p->height);
    return 0;
}

SUP_FN int supi_png_chunk(supi_png *p, const uint8_t *type, const uint8_t *data, uint32_t size) {
    uint32_t i;
    if (memcmp(type, "PLTE", 4) == 0) {
        if (size % 3 != 0 || size == 0 || size > 768 || p->palette_count != 0 || p->packed_size != 0)
            return sup_fail(p->err, "%s: bad palette", p->name);
        p->palette_count = size / 3;
        for (i = 0; i < size; i++) p->palette[i / 3][i % 3] = data[i];
    } else if (memcmp(type, "tRNS", 4) == 0) {
        if (p->packed_size != 0) return sup_fail(p->err, "%s: tRNS behind the picture", p->name);
        if (p->type == 3) {
            if (size > p->palette_count) return sup_fail(p->err, "%s: tRNS is larger than the palette", p->name);
            for (i = 0; i < size; i++) p->palette[i][3] = data[i];
            p->has_key = 1;
        } else if (p->type == 0 || p->type == 2) {
            if (size != 2 * p->samples) return sup_fail(p->err, "%s: bad tRNS", p->name);
            for (i = 0; i < p->samples; i++) p->key[i] = (uint32_t)data[2 * i] << 8 | data[2 * i + 1];
            p->has_key = 1;
        } else {
            return sup_fail(p->err, "%s: tRNS beside alpha", p->name);
        }
    } else if (memcmp(type, "IDAT", 4) == 0) {
        if (p->type == 3 && p->palette_count == 0) return sup_fail(p->err, "%s: no palette", p->name);
        if (size) memcpy(p->packed + p->packed_size, data, size);
        p->packed_size += size;
    } else if (!(type[0] & 32)) {
        return sup_fail(p->err, "%s: a chunk that is needed and not known", p->name);
    }
    return 0;
}

/* All chunks. p->packed has room for the whole file. */
SUP_FN int supi_png_chunks(supi_png *p, const uint8_t *file, size_t size) {
    size_t at = 8;
    int in_data = 0, had_data = 0;
    for (;;) {
        const uint8_t *chunk = file + at;
        uint32_t n;
        int is_data;
        if (size - at < 12) return sup_fail(p->err, "%s: cut off at byte %lu", p->name, (unsigned long)size);
        n = supi_load_big32(chunk);
        if (n > size - at - 12) return sup_fail(p->err, "%s: cut off in the chunk at byte %lu", p->name, (unsigned long)at);
        if (supi_load_big32(chunk + 8 + n) != supi_crc32(chunk + 4, (size_t)n + 4))
            return sup_fail(p->err, "%s: damaged in the chunk at byte %lu", p->name, (unsigned long)at);
        is_data = memcmp(chunk + 4, "IDAT", 4) == 0;
        if ((at == 8) != (memcmp(chunk + 4, "IHDR", 4) == 0) || (is_data && had_data && !in_data))
            return sup_fail(p->err, "%s: chunks in the wrong order", p->name);
        if (memcmp(chunk + 4, "IEND", 4) == 0) {
            if (n != 0 || !had_data) return sup_fail(p->err, "%s: no picture in it", p->name);
            return 0; /* what follows does not matter */
        }
        if (at == 8 ? supi_png_head(p, chunk + 8, n) : supi_png_chunk(p, chunk + 4, chunk + 8, n)) return 1;
        in_data = is_data;
        had_data |= is_data;
        at += 12 + (size_t)n;
    }
}

/* Size and place of the pixels of pass k of 7; k = 7: all. */
SUP_FN void supi_png_pass(const supi_png *p, unsigned k, uint32_t start[2], uint32_t step[2], uint32_t size[2]) {
    static const uint8_t x0[8] = {0, 4, 0, 2, 0, 1, 0, 0}, dx[8] = {8, 8, 4, 4, 2, 2, 1, 1};
    static const uint8_t y0[8] = {0, 0, 4, 0, 2, 0, 1, 0}, dy[8] = {8, 8, 8, 4, 4, 2, 2, 1};
    start[0] = x0[k];
    start[1] = y0[k];
    step[0] = dx[k];
    step[1] = dy[k];
    size[0] = p->width > x0[k] ? (p->width - x0[k] + dx[k] - 1) / dx[k] : 0;
    size[1] = p->height > y0[k] ? (p->height - y0[k] + dy[k] - 1) / dy[k] : 0;
    if (size[0] == 0 || size[1] == 0) size[0] = size[1] = 0;
}

SUP_FN int supi_unfilter(uint8_t *row, const uint8_t *above, size_t n, size_t step) {
    const uint8_t filter = row[0];
    size_t x;
    row++;
    if (above) above++;
    if (filter > 4) return 1;
    for (x = 0; filter != 0 && x < n; x++) {
        const int a = x >= step ? row[x - step] : 0, b = above ? above[x] : 0, c = above && x >= step ? above[x - step] : 0;
        const int da = abs(b - c), db = abs(a - c), dc = abs(a + b - 2 * c);
        row[x] = (uint8_t)(row[x] + (filter == 1 ? a : filter == 2 ? b : filter == 3 ? (a + b) / 2 :
                                     da <= db && da <= dc ? a : db <= dc ? b : c));
    }
    return 0;
}

/* One pixel of a row, from the file's numbers to 16 bits. */
SUP_FN int supi_png_pixel(const supi_png *p, const uint8_t *row, uint32_t x, uint32_t channels, uint16_t *out) {
    uint32_t value[4], i, most = (1u << p->bits) - 1u, match = 1;
    for (i = 0; i < p->samples; i++) {
        const size_t at = (size_t)x * p->samples + i, bit = at * p->bits;
        if (p->bits == 16) value[i] = (uint32_t)row[2 * at] << 8 | row[2 * at + 1];
        else value[i] = (uint32_t)row[bit >> 3] >> (8 - p->bits - (bit & 7)) & most;
    }
    if (p->type == 3) {
        if (value[0] >= p->palette_count) return 1;
        for (i = 0; i < channels; i++) out[i] = (uint16_t)(p->palette[value[0]][i] * 257u);
        return 0;
    }
    for (i = 0; i < p->samples; i++) {
        match &= value[i] == p->key[i];
        out[i] = (uint16_t)(value[i] * (65535u / most)); /* most divides it */
    }
    if (channels > p->samples) out[p->samples] = match ? 0 : 65535;
    return 0;
}

/* Read a PNG file in memory.
   name  how messages name the file
   out   out: the picture; free with sup_image_free. Cleared on error
   Returns 0, or 1 with err->text set. A file of n bytes has at most 1032 n unpacked bytes, which may be eight pixels
   each; the 2 to 8 bytes of a pixel are taken when all is unpacked and its sum is right. */
SUP_FN int sup_png_decode(const void *data, size_t size, const char *name, sup_image *out, sup_error *err) {
    static const uint8_t signature[8] = {0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a};
    supi_png p;
    supi_inflate *state = NULL;
    uint8_t *raw = NULL;
    size_t total = 0, at = 0, pixels = 0, i;
    uint32_t start[2], step[2], extent[2], y, x;
    unsigned k, first, end;
    int failed = 0;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    memset(&p, 0, sizeof p);
    p.name = name;
    p.err = err;
    for (i = 0; i < 256; i++) p.palette[i][3] = 255;
    if (size < 8 || memcmp(data, signature, 8) != 0) return sup_fail(err, "%s: not a PNG file", name);
    p.packed = (uint8_t *)sup_alloc(size, 1);
    if (!p.packed) return sup_fail(err, "%s: out of memory", name);
    failed = supi_png_chunks(&p, (const uint8_t *)data, size);
    first = p.interlaced ? 0 : 7;
    end = p.interlaced ? 7 : 8;
    for (k = first; k < end && !failed; k++) { /* at most 2^16 rows of 2^19 bytes: no overflow of 64 bits */
        supi_png_pass(&p, k, start, step, extent);
        if (extent[0] != 0 && sup_mul_size(((size_t)extent[0] * p.samples * p.bits + 7) / 8 + 1, extent[1], &pixels)) failed = 1;
        else if (extent[0] != 0 && pixels > SIZE_MAX - total) failed = 1;
        else if (extent[0] != 0) total += pixels;
    }
    /* deflate makes at most 1032 bytes of one: a small file must not ask for much */
    if (!failed && total / 1032 > p.packed_size) failed = sup_fail(err, "%s: cut off", name);
    if (!failed) {
        out->width = p.width;
        out->height = p.height;
        out->bits = p.bits;
        out->channels = (p.type == 3 ? 3u : p.samples) + (p.has_key ? 1u : 0u);
        raw = (uint8_t *)sup_alloc(total, 1);
        state = (supi_inflate *)sup_alloc(1, sizeof *state);
        if (!raw || !state) failed = sup_fail(err, "%s: out of memory", name);
        else if (supi_unzip(state, p.packed, p.packed_size, raw, total)) failed = sup_fail(err, "%s: the picture is damaged", name);
    }
    if (!failed) {
        if (!sup_mul_size((size_t)p.width * out->channels, p.height, &pixels)) out->pixels = (uint16_t *)sup_alloc(pixels, 2);
        if (!out->pixels) failed = sup_fail(err, "%s: out of memory", name);
    }
    for (k = first; k < end && !failed; k++) {
        size_t bytes;
        supi_png_pass(&p, k, start, step, extent);
        bytes = ((size_t)extent[0] * p.samples * p.bits + 7) / 8;
        for (y = 0; y < extent[1] && !failed; y++, at += bytes + 1) {
            uint16_t *to = out->pixels + ((size_t)(start[1] + y * step[1]) * p.width + start[0]) * out->channels;
            failed = supi_unfilter(raw + at, y ? raw + at - bytes - 1 : NULL, bytes, (p.samples * p.bits + 7) / 8);
            for (x = 0; x < extent[0] && !failed; x++)
                failed = supi_png_pixel(&p, raw + at + 1, x, out->channels, to + (size_t)x * step[0] * out->channels);
        }
        if (failed) (void)sup_fail(err, "%s: a row filter or a palette entry that is none", name);
    }
    SUP_FREE(p.packed);
    SUP_FREE(raw);
    SUP_FREE(state);
    if (failed) sup_image_free(out);
    return failed;
}

/* ---- PPM and PGM -------------------------------------------------------------------------------------------- */

/* A number of the header, past blanks and comments. */
SUP_FN int supi_pnm_number(sup_text *text, uint32_t *out) {
    int64_t value;
    for (;;) {
        sup_text_skip_space(text);
        if (text->at == text->end || *text->at != '#') break;
        sup_text_skip_line(text);
    }
    if (text->at == text->end || *text->at < '0' || *text->at > '9') return 1;
    if (sup_parse_int(&text->at, text->end, &value) || value < 0 || value > 65536) return 1;
    *out = (uint32_t)value;
    return 0;
}

/* Read a PPM or PGM file in memory: P2, P3, P5 or P6, 8 or 16 bits. As sup_png_decode. */
SUP_FN int sup_pnm_decode(const void *data, size_t size, const char *name, sup_image *out, sup_error *err) {
    sup_text text;
    uint32_t most = 0, value = 0;
    size_t count = 0, i;
    char kind;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    text.begin = text.at = size ? (const char *)data : "";
    text.end = text.begin + size;
    kind = size > 2 && text.at[0] == 'P' ? text.at[1] : '0';
    if (kind != '2' && kind != '3' && kind != '5' && kind != '6') return sup_fail(err, "%s: not a PPM or PGM file", name);
    text.at += 2;
    out->channels = kind == '2' || kind == '5' ? 1 : 3;
    if (supi_pnm_number(&text, &out->width) || supi_pnm_number(&text, &out->height) || supi_pnm_number(&text, &most) ||
        out->width == 0 || out->height == 0 || most == 0 || most > 65535 ||
        sup_mul_size((size_t)out->width * out->channels, out->height, &count)) {
        memset(out, 0, sizeof *out);
        return sup_fail(err, "%s: bad header", name);
    }
    out->bits = most > 255 ? 16 : 8;
    if (kind >= '5' && text.at < text.end) text.at++; /* one blank */
    if ((size_t)(text.end - text.at) / (kind >= '5' ? out->bits / 8 : 2) + 1 < count) { /* text: a digit and a blank */
        memset(out, 0, sizeof *out);
        return sup_fail(err, "%s: cut off", name);
    }
    out->pixels = (uint16_t *)sup_alloc(count, 2);
    if (!out->pixels) {
        memset(out, 0, sizeof *out);
        return sup_fail(err, "%s: out of memory", name);
    }
    for (i = 0; i < count; i++) {
        if (kind < '5') {
            if (supi_pnm_number(&text, &value)) break;
        } else {
            const uint8_t *p = (const uint8_t *)text.at;
            if ((size_t)(text.end - text.at) < out->bits / 8) break;
            value = out->bits == 16 ? (uint32_t)p[0] << 8 | p[1] : p[0];
            text.at += out->bits / 8;
        }
        if (value > most) break;
        out->pixels[i] = (uint16_t)((value * 65535u + most / 2) / most);
    }
    if (i < count) {
        sup_image_free(out);
        return sup_fail(err, "%s: cut off, or a value is too large", name);
    }
    return 0;
}

/* ---- either ------------------------------------------------------------------------------------------------- */

/* Read a picture in memory, told by its first bytes. As sup_png_decode. */
SUP_FN int sup_image_decode(const void *data, size_t size, const char *name, sup_image *out, sup_error *err) {
    if (size > 2 && ((const char *)data)[0] == 'P') return sup_pnm_decode(data, size, name, out, err);
    memset(out, 0, sizeof *out);
    if (size < 8 || ((const uint8_t *)data)[0] != 0x89) return sup_fail(err, "%s: not a PNG, PPM or PGM file", name);
    return sup_png_decode(data, size, name, out, err);
}

/* Read a picture file: PNG, PPM or PGM. As sup_png_decode. */
SUP_FN int sup_image_read(const char *path, sup_image *out, sup_error *err) {
    char *data;
    size_t size;
    int failed;
    memset(out, 0, sizeof *out);
    if (sup_read_file(path, &data, &size, err)) return 1;
    failed = sup_image_decode(data, size, path, out, err);
    SUP_FREE(data);
    return failed;
}

#endif
