/* png_read.h - a slow, plain PNG reader for tests: the oracle for the writer in examples/support/png.h

   Written from the specifications (ISO/IEC 15948, RFC 1950, RFC 1951), bit by bit and without tables; every check sum
   and every length is verified. Gray, gray and alpha, RGB, RGBA; 8 and 16 bits; not interlaced. */
#ifndef PNG_READ_H
#define PNG_READ_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#define PNG_READ_FN static __attribute__((unused))
#else
#define PNG_READ_FN static
#endif

typedef struct png_picture {
    uint8_t *bytes; /* rows from the top; 16-bit values big-endian, as in the file; free() */
    uint32_t width, height, channels, bits;
    size_t row_bytes;
    uint32_t filters[5];     /* how many rows use each filter */
    uint32_t block_kinds[3]; /* how many deflate blocks are stored, fixed, dynamic */
} png_picture;

typedef struct png_bits {
    const uint8_t *at, *end;
    unsigned bit;
    int failed;
} png_bits;

PNG_READ_FN unsigned png_bit(png_bits *b) {
    unsigned value;
    if (b->at == b->end) {
        b->failed = 1;
        return 0;
    }
    value = (unsigned)(*b->at >> b->bit) & 1u;
    if (++b->bit == 8) {
        b->bit = 0;
        b->at++;
    }
    return value;
}

PNG_READ_FN unsigned png_number(png_bits *b, unsigned count) {
    unsigned value = 0, i;
    for (i = 0; i < count; i++) value |= png_bit(b) << i;
    return value;
}

/* Read one symbol: compare the bits read so far with the canonical code of every length. -1: no such code. */
PNG_READ_FN int png_symbol(png_bits *b, const uint8_t *lengths, int count) {
    unsigned code = 0, first = 0, length;
    for (length = 1; length <= 15 && !b->failed; length++) {
        unsigned here = 0;
        int i;
        code = code << 1 | png_bit(b);
        first <<= 1;
        for (i = 0; i < count; i++) {
            if (lengths[i] != length) continue;
            if (code == first + here) return i;
            here++;
        }
        first += here;
    }
    b->failed = 1;
    return -1;
}

/* Codes must be complete: the sum of 2^-length is 1. */
PNG_READ_FN int png_complete(const uint8_t *lengths, int count) {
    unsigned sum = 0;
    int i;
    for (i = 0; i < count; i++) sum += lengths[i] ? 1u << (15 - lengths[i]) : 0;
    return sum == 1u << 15;
}

PNG_READ_FN int png_codes(png_bits *b, uint8_t *literals, uint8_t *distances) {
    static const uint8_t order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    uint8_t lengths[19], all[320];
    unsigned n = png_number(b, 5) + 257, m = png_number(b, 5) + 1, k = png_number(b, 4) + 4, i;
    memset(lengths, 0, sizeof lengths);
    memset(all, 0, sizeof all);
    if (n > 286 || m > 30) return 1;
    for (i = 0; i < k; i++) lengths[order[i]] = (uint8_t)png_number(b, 3);
    for (i = 0; i < 19; i++) {
        if (lengths[i] > 7) return 1;
    }
    if (!png_complete(lengths, 19)) return 1;
    for (i = 0; i < n + m && !b->failed;) {
        const int s = png_symbol(b, lengths, 19);
        unsigned run = 1;
        uint8_t value = (uint8_t)s;
        if (s < 0) return 1;
        if (s == 16) {
            if (i == 0) return 1;
            value = all[i - 1];
            run = 3 + png_number(b, 2);
        } else if (s >= 17) {
            value = 0;
            run = s == 17 ? 3 + png_number(b, 3) : 11 + png_number(b, 7);
        }
        if (i + run > n + m) return 1;
        for (; run > 0; run--) all[i++] = value;
    }
    memset(literals, 0, 288);
    memset(distances, 0, 32);
    memcpy(literals, all, n);
    memcpy(distances, all + n, m);
    return b->failed || literals[256] == 0 || !png_complete(literals, 288) || !png_complete(distances, 32);
}

/* Inflate a zlib stream of exactly `size` bytes. Returns 0, or the number of the check that failed. */
PNG_READ_FN int png_inflate(const uint8_t *in, size_t in_size, uint8_t *out, size_t size, uint32_t kinds[3]) {
    png_bits b;
    size_t done = 0, i;
    uint32_t a1 = 1, a2 = 0;
    unsigned last;
    if (in_size < 6 || (in[0] & 15) != 8 || (in[0] * 256 + in[1]) % 31 != 0 || (in[1] & 32)) return 1;
    b.at = in + 2;
    b.end = in + in_size - 4;
    b.bit = 0;
    b.failed = 0;
    do {
        uint8_t literals[288], distances[32];
        unsigned kind;
        last = png_bit(&b);
        kind = png_number(&b, 2);
        if (b.failed || kind == 3) return 2;
        kinds[kind]++;
        if (kind == 0) {
            unsigned length;
            if (b.bit) {
                b.bit = 0;
                b.at++;
            }
            length = png_number(&b, 16);
            if (png_number(&b, 16) != (length ^ 0xffffu) || b.failed) return 3;
            if ((size_t)(b.end - b.at) < length || size - done < length) return 4;
            if (length) memcpy(out + done, b.at, length);
            b.at += length;
            done += length;
            continue;
        }
        if (kind == 1) {
            for (i = 0; i < 288; i++) literals[i] = i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8;
            memset(distances, 5, 32);
        } else if (png_codes(&b, literals, distances)) {
            return 5;
        }
        for (;;) {
            int s = png_symbol(&b, literals, 288);
            unsigned length, distance, base, k;
            if (s < 0 || s > 285) return 6;
            if (s == 256) break;
            if (s < 256) {
                if (done == size) return 7;
                out[done++] = (uint8_t)s;
                continue;
            }
            /* lengths: four symbols to each number of extra bits; distances: two */
            for (length = 3, k = 257; k < (unsigned)s; k++) length += k < 265 ? 1u : 1u << ((k - 261) / 4);
            if (s == 285) length = 258;
            else if (s >= 265) length += png_number(&b, ((unsigned)s - 261) / 4);
            s = png_symbol(&b, distances, 32);
            if (s < 0 || s > 29) return 8;
            for (base = 1, k = 0; k < (unsigned)s; k++) base += k < 4 ? 1u : 1u << (k / 2 - 1);
            distance = base + (s >= 4 ? png_number(&b, (unsigned)s / 2 - 1) : 0);
            if (b.failed || distance > done || length > size - done) return 9;
            for (; length > 0; length--, done++) out[done] = out[done - distance];
        }
    } while (!last);
    if (b.bit) b.at++;
    if (b.at != b.end || done != size) return 10;
    for (i = 0; i < size; i++) {
        a1 = (a1 + out[i]) % 65521;
        a2 = (a2 + a1) % 65521;
    }
    return (a2 << 16 | a1) == ((uint32_t)b.at[0] << 24 | (uint32_t)b.at[1] << 16 | (uint32_t)b.at[2] << 8 | b.at[3])
               ? 0
               : 11;
}

PNG_READ_FN uint32_t png_big32(const uint8_t *p) {
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

PNG_READ_FN uint32_t png_crc(const uint8_t *p, size_t size) {
    uint32_t crc = 0xffffffffu;
    int k;
    for (; size > 0; size--) {
        crc ^= *p++;
        for (k = 0; k < 8; k++) crc = crc & 1 ? crc >> 1 ^ 0xedb88320u : crc >> 1;
    }
    return ~crc;
}

PNG_READ_FN int png_unfilter(png_picture *p, const uint8_t *raw) {
    const size_t n = p->row_bytes, step = p->channels * (p->bits / 8);
    size_t x, y;
    for (y = 0; y < p->height; y++) {
        const uint8_t *from = raw + y * (n + 1);
        uint8_t *to = p->bytes + y * n;
        if (from[0] > 4) return 1;
        p->filters[from[0]]++;
        for (x = 0; x < n; x++) {
            const int a = x >= step ? to[x - step] : 0, b = y ? (to - n)[x] : 0,
                      c = y && x >= step ? (to - n)[x - step] : 0;
            const int guess = a + b - c, da = abs(guess - a), db = abs(guess - b), dc = abs(guess - c);
            int add = 0;
            switch (from[0]) {
            case 1: add = a; break;
            case 2: add = b; break;
            case 3: add = (a + b) / 2; break;
            case 4: add = da <= db && da <= dc ? a : db <= dc ? b : c; break;
            default: break;
            }
            to[x] = (uint8_t)(from[x + 1] + add);
        }
    }
    return 0;
}

/* Read a PNG file. Returns NULL, or what is wrong with it; then out->bytes is NULL. */
PNG_READ_FN const char *png_read(const uint8_t *file, size_t size, png_picture *out) {
    static const uint8_t signature[8] = {0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a};
    uint8_t *packed = NULL, *raw = NULL;
    size_t at = 8, packed_size = 0;
    const char *wrong = NULL;
    int ended = 0, type = -1;
    memset(out, 0, sizeof *out);
    if (size < 8 || memcmp(file, signature, 8) != 0) return "signature";
    packed = (uint8_t *)malloc(size);
    if (!packed) return "memory";
    while (!wrong && !ended) {
        const uint8_t *chunk = file + at;
        uint32_t n;
        if (size - at < 12) {
            wrong = "the last chunk is cut off";
            break;
        }
        n = png_big32(chunk);
        if (n > size - at - 12) wrong = "a chunk is longer than the file";
        else if (png_big32(chunk + 8 + n) != png_crc(chunk + 4, n + 4)) wrong = "CRC";
        else if ((at == 8) != (memcmp(chunk + 4, "IHDR", 4) == 0)) wrong = "IHDR is not the first chunk";
        else if (at == 8) {
            if (n != 13 || chunk[18] || chunk[19] || chunk[20]) wrong = "IHDR";
            out->width = png_big32(chunk + 8);
            out->height = png_big32(chunk + 12);
            out->bits = chunk[16];
            type = chunk[17];
            out->channels = type == 0 ? 1 : type == 2 ? 3 : type == 4 ? 2 : type == 6 ? 4 : 0;
            if (!out->channels || (out->bits != 8 && out->bits != 16) || !out->width || !out->height)
                wrong = "IHDR values";
        } else if (memcmp(chunk + 4, "IDAT", 4) == 0) {
            memcpy(packed + packed_size, chunk + 8, n);
            packed_size += n;
        } else if (memcmp(chunk + 4, "IEND", 4) == 0) {
            ended = 1;
            if (n != 0 || at + 12 != size) wrong = "IEND is not the end";
        } else if (!(chunk[4] & 32)) {
            wrong = "unknown critical chunk";
        }
        at += 12 + (size_t)n;
    }
    if (!wrong) {
        size_t total;
        out->row_bytes = (size_t)out->width * out->channels * (out->bits / 8);
        total = (out->row_bytes + 1) * out->height;
        raw = (uint8_t *)malloc(total);
        out->bytes = (uint8_t *)malloc(out->row_bytes * out->height);
        if (!raw || !out->bytes) wrong = "memory";
        else if (png_inflate(packed, packed_size, raw, total, out->block_kinds)) wrong = "deflate stream";
        else if (png_unfilter(out, raw)) wrong = "filter";
    }
    free(packed);
    free(raw);
    if (wrong) {
        free(out->bytes);
        out->bytes = NULL;
    }
    return wrong;
}

#endif
