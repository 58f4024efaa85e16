/* png.h - PNG and PFM writers: real deflate, all row filters, 8 and 16 bits, gray to RGBA
   SPDX-License-Identifier: MIT OR Unlicense

       sup_picture picture = {0};
       picture.pixels = rgba; picture.width = 640; picture.height = 480; picture.channels = 4; picture.bits = 8;
       if (sup_png_write("out.png", &picture, &err)) ...

   References: PNG (Second Edition), ISO/IEC 15948; P. Deutsch, RFC 1950 and RFC 1951. The bytes written depend on the
   pixels only. */
#ifndef SUP_PNG_H
#define SUP_PNG_H

#include "base.h"
#include <math.h>

/* A picture in memory, rows from top to bottom, components interleaved, sRGB, alpha not premultiplied. */
typedef struct sup_picture {
    const void *pixels; /* uint8_t for 8 bits; uint16_t in the order of this machine for 16 bits */
    uint32_t width, height;
    uint32_t channels; /* 1 gray, 2 gray and alpha, 3 RGB, 4 RGBA */
    uint32_t bits;     /* 8 or 16 */
    size_t stride;     /* bytes from one row to the next; 0: rows lie close together */
} sup_picture;

/* ---- deflate ------------------------------------------------------------------------------------------------ */

enum {
    SUPI_WINDOW = 32768,
    SUPI_HASH_BITS = 15,
    SUPI_BLOCK_TOKENS = 32768, /* a Huffman code for each so many literals and matches */
    SUPI_CHAIN = 8,       /* candidates looked at for a match: more is slower and hardly smaller on filtered rows */
    SUPI_CHAIN_LATER = 2, /* the same for a match one byte later that would have to be longer */
    SUPI_MATCH_GOOD = 32, /* no search for a better match behind one of this length */
    SUPI_MATCH_MIN = 4,
    SUPI_MATCH_MAX = 258
};

typedef struct supi_deflate {
    uint8_t *out;
    size_t size, capacity;
    uint64_t hold; /* bits not written yet */
    unsigned held;
    uint32_t head[1 << SUPI_HASH_BITS]; /* last position of a hash, + 1 */
    uint32_t chain[SUPI_WINDOW];        /* the position before with the same hash, + 1 */
    uint32_t tokens[SUPI_BLOCK_TOKENS]; /* literal; or 1 << 31 | (length - 3) << 16 | (distance - 1) */
    size_t token_count;
    uint32_t literal_freq[288], distance_freq[32];
    uint8_t literal_length[288], distance_length[32];
    uint16_t literal_code[288], distance_code[32];
    uint8_t length_symbol[256]; /* of a length - 3, without 257 */
    uint16_t length_base[29];
    uint8_t length_extra[29];
    uint8_t near_symbol[256], far_symbol[256]; /* of a distance - 1 below 256; of (distance - 1) >> 7 */
    uint32_t distance_base[30];
    uint8_t distance_extra[30];
} supi_deflate;

SUP_FN int supi_deflate_reserve(supi_deflate *d, size_t more) {
    void *grown = more <= SIZE_MAX - d->size ? sup_grow(d->out, &d->capacity, d->size + more, 1) : NULL;
    if (!grown) return 1;
    d->out = (uint8_t *)grown;
    return 0;
}

/* Append bits, lowest first; the caller has reserved the room. */
SUP_FN void supi_put(supi_deflate *d, uint32_t bits, unsigned count) {
    d->hold |= (uint64_t)bits << d->held;
    d->held += count;
    while (d->held >= 8) {
        d->out[d->size++] = (uint8_t)d->hold;
        d->hold >>= 8;
        d->held -= 8;
    }
}

/* The tables of RFC 1951, 3.2.5, made by their rule: symbols come in groups whose extra bits grow by one. */
SUP_FN void supi_deflate_tables(supi_deflate *d) {
    uint32_t base = 0, i, k;
    for (i = 0; i < 28; i++) {
        d->length_extra[i] = (uint8_t)(i < 8 ? 0 : i / 4 - 1);
        d->length_base[i] = (uint16_t)base;
        for (k = 0; k < (1u << d->length_extra[i]) && base < 256; k++) d->length_symbol[base++] = (uint8_t)i;
    }
    d->length_symbol[255] = 28; /* length 258 has a symbol of its own, without extra bits */
    d->length_base[28] = 255;
    d->length_extra[28] = 0;
    base = 0;
    for (i = 0; i < 30; i++) {
        d->distance_extra[i] = (uint8_t)(i < 4 ? 0 : i / 2 - 1);
        d->distance_base[i] = base;
        for (k = 0; k < (1u << d->distance_extra[i]); k++, base++) {
            if (base < 256) d->near_symbol[base] = (uint8_t)i;
            else d->far_symbol[base >> 7] = (uint8_t)i;
        }
    }
}

SUP_FN unsigned supi_distance_symbol(const supi_deflate *d, uint32_t distance) {
    return distance < 256 ? d->near_symbol[distance] : d->far_symbol[distance >> 7];
}

/* Heap of symbols, the most frequent first, of two alike the later one: makes the part below `at` one again. */
SUP_FN void supi_sift(uint16_t *symbol, size_t at, size_t count, const uint32_t *freq) {
    for (;;) {
        size_t child = 2 * at + 1;
        uint16_t t;
        if (child >= count) return;
        if (child + 1 < count && (freq[symbol[child]] < freq[symbol[child + 1]] ||
                                  (freq[symbol[child]] == freq[symbol[child + 1]] && symbol[child] < symbol[child + 1])))
            child++;
        if (freq[symbol[at]] > freq[symbol[child]] || (freq[symbol[at]] == freq[symbol[child]] && symbol[at] > symbol[child])) return;
        t = symbol[at];
        symbol[at] = symbol[child];
        symbol[child] = t;
        at = child;
    }
}

/* Code lengths of at most `limit` bits from frequencies. The tree is built from two queues over the sorted symbols;
   what grows too deep is cut at the limit and paid for by lengthening the deepest codes that are shorter.
   At least two symbols get a code: some decoders want a complete one. */
SUP_FN void supi_code_lengths(uint32_t *freq, size_t count, unsigned limit, uint8_t *lengths) {
    uint64_t weight[576];
    uint16_t sorted[288], parent[576], depth[576];
    uint32_t per_length[64];
    size_t used = 0, i, k, leaf, node, made;
    uint32_t total;
    for (i = 0; i < count; i++) used += freq[i] != 0;
    for (i = 0; used < 2; i++) {
        if (freq[i] == 0) {
            freq[i] = 1;
            used++;
        }
    }
    for (i = 0, k = 0; i < count; i++) {
        if (freq[i]) sorted[k++] = (uint16_t)i;
    }
    for (i = used / 2; i-- > 0;) supi_sift(sorted, i, used, freq); /* heap sort by frequency, then symbol */
    for (k = used; k-- > 1;) {
        uint16_t t = sorted[0];
        sorted[0] = sorted[k];
        sorted[k] = t;
        supi_sift(sorted, 0, k, freq);
    }
    for (i = 0; i < used; i++) weight[i] = freq[sorted[i]];
    leaf = 0;
    node = used;
    for (made = used; made < 2 * used - 1; made++) {
        weight[made] = 0;
        for (k = 0; k < 2; k++) {
            const size_t pick = leaf < used && (node >= made || weight[leaf] <= weight[node]) ? leaf++ : node++;
            weight[made] += weight[pick];
            parent[pick] = (uint16_t)made;
        }
    }
    memset(per_length, 0, sizeof per_length);
    depth[2 * used - 2] = 0;
    for (i = 2 * used - 2; i-- > 0;) {
        depth[i] = (uint16_t)(depth[parent[i]] + 1);
        if (i < used) per_length[depth[i] < limit ? depth[i] : limit]++;
    }
    total = 0;
    for (i = 1; i <= limit; i++) total += per_length[i] << (limit - i);
    while (total > 1u << limit) {
        per_length[limit]--;
        for (i = limit - 1; per_length[i] == 0; i--) {}
        per_length[i]--;
        per_length[i + 1] += 2;
        total--;
    }
    memset(lengths, 0, count);
    for (i = 1, k = used; i <= limit; i++) {
        uint32_t n;
        for (n = per_length[i]; n > 0; n--) lengths[sorted[--k]] = (uint8_t)i;
    }
}

/* Canonical codes for the lengths, RFC 1951, 3.2.2, with their bits turned round: the first bit goes out first. */
SUP_FN void supi_codes(const uint8_t *lengths, size_t count, uint16_t *codes) {
    uint32_t next[16], per_length[16], code = 0;
    size_t i;
    memset(per_length, 0, sizeof per_length);
    for (i = 0; i < count; i++) per_length[lengths[i]]++;
    per_length[0] = 0;
    next[0] = 0;
    for (i = 1; i < 16; i++) {
        code = (code + per_length[i - 1]) << 1;
        next[i] = code;
    }
    for (i = 0; i < count; i++) {
        uint32_t turned = 0, bit, value = lengths[i] ? next[lengths[i]]++ : 0;
        for (bit = 0; bit < lengths[i]; bit++) turned |= ((value >> bit) & 1u) << (lengths[i] - 1u - bit);
        codes[i] = (uint16_t)turned;
    }
}

/* Code lengths written with the run symbols 16 to 18 of RFC 1951, 3.2.7: symbol, and the value of its extra bits. */
SUP_FN size_t supi_run_lengths(const uint8_t *lengths, size_t count, uint8_t *symbols, uint8_t *extras) {
    size_t made = 0, i = 0;
    while (i < count) {
        size_t run = 1;
        while (i + run < count && lengths[i + run] == lengths[i]) run++;
        i += run;
        if (lengths[i - 1] == 0) {
            while (run >= 3) {
                const size_t take = run < 138 ? run : 138;
                symbols[made] = take < 11 ? 17 : 18;
                extras[made++] = (uint8_t)(take < 11 ? take - 3 : take - 11);
                run -= take;
            }
        } else if (run > 3) {
            symbols[made] = lengths[i - 1];
            extras[made++] = 0;
            run--;
            while (run >= 3) {
                const size_t take = run < 6 ? run : 6;
                symbols[made] = 16;
                extras[made++] = (uint8_t)(take - 3);
                run -= take;
            }
        }
        for (; run > 0; run--) {
            symbols[made] = lengths[i - 1];
            extras[made++] = 0;
        }
    }
    return made;
}

SUP_FN uint64_t supi_block_bits(const supi_deflate *d, const uint8_t *literal_length, const uint8_t *distance_length) {
    uint64_t bits = 0;
    size_t i;
    for (i = 0; i < 286; i++)
        bits += (uint64_t)d->literal_freq[i] * (literal_length[i] + (i < 257 ? 0u : d->length_extra[i - 257]));
    for (i = 0; i < 30; i++)
        bits += (uint64_t)d->distance_freq[i] * ((unsigned)distance_length[i] + d->distance_extra[i]);
    return bits;
}

SUP_FN void supi_put_tokens(supi_deflate *d) {
    size_t i;
    for (i = 0; i < d->token_count; i++) {
        const uint32_t token = d->tokens[i];
        if (token < 256) {
            supi_put(d, d->literal_code[token], d->literal_length[token]);
        } else {
            const uint32_t length = (token >> 16) & 255u, distance = token & 32767u;
            const unsigned s = d->length_symbol[length], t = supi_distance_symbol(d, distance);
            supi_put(d, d->literal_code[257 + s], d->literal_length[257 + s]);
            supi_put(d, length - d->length_base[s], d->length_extra[s]);
            supi_put(d, d->distance_code[t], d->distance_length[t]);
            supi_put(d, distance - d->distance_base[t], d->distance_extra[t]);
        }
    }
    supi_put(d, d->literal_code[256], d->literal_length[256]);
}

SUP_FN int supi_put_stored(supi_deflate *d, const uint8_t *data, size_t size, int last) {
    do {
        const size_t take = size < 65535 ? size : 65535;
        if (supi_deflate_reserve(d, take + 16)) return 1;
        size -= take;
        supi_put(d, last && size == 0, 1);
        supi_put(d, 0, 2);
        if (d->held) supi_put(d, 0, 8 - d->held);
        supi_put(d, (uint32_t)take, 16);
        supi_put(d, (uint32_t)take ^ 65535u, 16);
        if (take) memcpy(d->out + d->size, data, take);
        d->size += take;
        data += take;
    } while (size > 0);
    return 0;
}

/* Write the collected tokens, which stand for `size` bytes at `data`, in the shortest of the three forms. */
SUP_FN int supi_end_block(supi_deflate *d, const uint8_t *data, size_t size, int last) {
    static const uint8_t order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    uint8_t fixed_literal[288], fixed_distance[32], lengths[320], symbols[320], extras[320], run_length[19];
    uint32_t run_freq[19];
    uint16_t run_code[19];
    size_t literals = 286, distances = 30, runs, sent = 19, i;
    uint64_t dynamic_bits, fixed_bits, stored_bits;
    d->literal_freq[256]++;
    for (i = 0; i < 288; i++) fixed_literal[i] = i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8;
    for (i = 0; i < 32; i++) fixed_distance[i] = 5;
    fixed_bits = 3 + supi_block_bits(d, fixed_literal, fixed_distance);
    supi_code_lengths(d->literal_freq, 286, 15, d->literal_length);
    supi_code_lengths(d->distance_freq, 30, 15, d->distance_length);
    while (literals > 257 && d->literal_length[literals - 1] == 0) literals--;
    while (distances > 1 && d->distance_length[distances - 1] == 0) distances--;
    memcpy(lengths, d->literal_length, literals);
    memcpy(lengths + literals, d->distance_length, distances);
    runs = supi_run_lengths(lengths, literals + distances, symbols, extras);
    memset(run_freq, 0, sizeof run_freq);
    for (i = 0; i < runs; i++) run_freq[symbols[i]]++;
    supi_code_lengths(run_freq, 19, 7, run_length);
    while (sent > 4 && run_length[order[sent - 1]] == 0) sent--;
    dynamic_bits = 3 + 14 + 3 * sent + supi_block_bits(d, d->literal_length, d->distance_length);
    for (i = 0; i < runs; i++) {
        dynamic_bits += run_length[symbols[i]] + (symbols[i] < 16    ? 0u
                                                  : symbols[i] == 16 ? 2u
                                                  : symbols[i] == 17 ? 3u
                                                                     : 7u);
    }
    stored_bits = 8 * (uint64_t)size + 40 * ((uint64_t)size / 65535 + 1);
    if (stored_bits <= dynamic_bits && stored_bits <= fixed_bits) {
        if (supi_put_stored(d, data, size, last)) return 1;
    } else {
        const int fixed = fixed_bits <= dynamic_bits;
        if (supi_deflate_reserve(d, (size_t)((fixed ? fixed_bits : dynamic_bits) / 8) + 32)) return 1;
        supi_put(d, last != 0, 1);
        supi_put(d, fixed ? 1 : 2, 2);
        if (fixed) {
            memcpy(d->literal_length, fixed_literal, 288);
            memcpy(d->distance_length, fixed_distance, 30);
            supi_codes(d->literal_length, 288, d->literal_code);
            supi_codes(fixed_distance, 32, d->distance_code);
        } else {
            supi_put(d, (uint32_t)literals - 257, 5);
            supi_put(d, (uint32_t)distances - 1, 5);
            supi_put(d, (uint32_t)sent - 4, 4);
            for (i = 0; i < sent; i++) supi_put(d, run_length[order[i]], 3);
            supi_codes(run_length, 19, run_code);
            for (i = 0; i < runs; i++) {
                supi_put(d, run_code[symbols[i]], run_length[symbols[i]]);
                if (symbols[i] >= 16) supi_put(d, extras[i], symbols[i] == 16 ? 2 : symbols[i] == 17 ? 3 : 7);
            }
            supi_codes(d->literal_length, 286, d->literal_code);
            supi_codes(d->distance_length, 30, d->distance_code);
        }
        supi_put_tokens(d);
    }
    memset(d->literal_freq, 0, sizeof d->literal_freq);
    memset(d->distance_freq, 0, sizeof d->distance_freq);
    d->token_count = 0;
    return 0;
}

SUP_FN uint32_t supi_load32(const uint8_t *p) {
    uint32_t value;
    memcpy(&value, p, sizeof value);
    return value;
}

/* The hash decides only which match is found; it must not depend on the byte order, so that files do not. */
SUP_FN uint32_t supi_hash4(const uint8_t *p) {
    const uint32_t value = (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
    return (value * 2654435761u) >> (32 - SUPI_HASH_BITS);
}

SUP_FN void supi_insert(supi_deflate *d, const uint8_t *data, size_t at) {
    const uint32_t hash = supi_hash4(data + at);
    d->chain[at % SUPI_WINDOW] = d->head[hash];
    d->head[hash] = (uint32_t)at + 1;
}

/* The longest match for the bytes at `at` that is longer than `best`, among at most `tries` candidates; returns its
   length, or `best`. */
SUP_FN size_t supi_find(const supi_deflate *d, const uint8_t *data, size_t at, size_t end, size_t best, int tries,
                        size_t *distance) {
    const size_t limit = end - at < SUPI_MATCH_MAX ? end - at : (size_t)SUPI_MATCH_MAX;
    uint32_t candidate = d->head[supi_hash4(data + at)];
    const uint32_t first = supi_load32(data + at);
    while (candidate && tries-- > 0) {
        const size_t from = candidate - 1;
        size_t length;
        if (at - from > SUPI_WINDOW || best >= limit) break;
        if (data[from + best] == data[at + best] && supi_load32(data + from) == first) {
            for (length = 4; length + 8 <= limit; length += 8) {
                if (memcmp(data + from + length, data + at + length, 8) != 0) break;
            }
            while (length < limit && data[from + length] == data[at + length]) length++;
            if (length > best) {
                best = length;
                *distance = at - from;
                if (length >= SUPI_MATCH_GOOD) break;
            }
        }
        candidate = d->chain[from % SUPI_WINDOW];
    }
    return best;
}

SUP_FN void supi_token_match(supi_deflate *d, size_t length, size_t distance) {
    d->tokens[d->token_count++] = 0x80000000u | (uint32_t)(length - 3) << 16 | (uint32_t)(distance - 1);
    d->literal_freq[257u + d->length_symbol[length - 3]]++;
    d->distance_freq[supi_distance_symbol(d, (uint32_t)(distance - 1))]++;
}

/* Compress all of `data` into d->out as a sequence of blocks, the last one marked. Returns 1 when memory is short. */
SUP_FN int supi_deflate_run(supi_deflate *d, const uint8_t *data, size_t size) {
    size_t at = 0, block = 0, misses = 0, known = 0, known_distance = 0;
    while (at < size) {
        size_t length = known, distance = known_distance; /* found already when the literal before was preferred */
        if (size - at > SUPI_MATCH_MIN) {
            if (!known) length = supi_find(d, data, at, size, SUPI_MATCH_MIN - 1, SUPI_CHAIN, &distance);
            known = 0;
            supi_insert(d, data, at);
            if (length >= SUPI_MATCH_MIN && length < SUPI_MATCH_GOOD && size - at - 1 > SUPI_MATCH_MIN) {
                /* A literal now and a longer match behind it may be shorter. */
                const size_t later = supi_find(d, data, at + 1, size, length, SUPI_CHAIN_LATER, &known_distance);
                if (later > length) {
                    known = later;
                    length = 0;
                }
            }
        }
        if (length >= SUPI_MATCH_MIN) {
            size_t k;
            supi_token_match(d, length, distance);
            /* Inside a long match a few positions are enough to be found again. */
            for (k = 1; k < length && size - at - k > SUPI_MATCH_MIN; k += length > SUPI_MATCH_GOOD ? 8 : 1)
                supi_insert(d, data, at + k);
            at += length;
            misses = 0;
        } else {
            /* Where nothing repeats, look less often: noise costs then little more than a copy. */
            size_t skip = 1 + (distance ? 0 : misses++ / 64);
            if (skip > 8) skip = 8;
            for (; skip > 0 && at < size && d->token_count < SUPI_BLOCK_TOKENS; skip--, at++) {
                d->tokens[d->token_count++] = data[at];
                d->literal_freq[data[at]]++;
            }
        }
        if (d->token_count == SUPI_BLOCK_TOKENS && at < size) {
            if (supi_end_block(d, data + block, at - block, 0)) return 1;
            block = at;
        }
    }
    if (supi_end_block(d, data + block, size - block, 1)) return 1;
    if (supi_deflate_reserve(d, 16)) return 1;
    if (d->held) supi_put(d, 0, 8 - d->held);
    return 0;
}

SUP_FN uint32_t supi_adler32(const uint8_t *data, size_t size) {
    uint32_t a = 1, b = 0;
    while (size > 0) { /* 5552 bytes are the most before b could overflow */
        size_t n = size < 5552 ? size : 5552;
        size -= n;
        for (; n > 0; n--) {
            a += *data++;
            b += a;
        }
        a %= 65521;
        b %= 65521;
    }
    return b << 16 | a;
}

/* ---- rows and chunks ---------------------------------------------------------------------------------------- */

SUP_FN uint32_t supi_magnitude(uint8_t value) { return value < 128 ? value : 256u - value; }

/* Filter one row in all five ways and keep the one with the smallest sum of magnitudes, the measure that the PNG
   specification suggests. row, above: n bytes behind `step` bytes of zero, and 16 bytes of room; candidates: five rows
   of n + 17 bytes. Work goes in pieces of 16 through local arrays: compilers make vector code of that. */
SUP_FN void supi_filter_row(const uint8_t *row, const uint8_t *above, size_t n, size_t step, uint8_t *candidates,
                            uint8_t *out) {
    uint32_t sums[5] = {0, 0, 0, 0, 0};
    size_t at, i, k, best = 0;
    if (memcmp(row, above, n) == 0) { /* all zero by the second filter: nothing beats that */
        out[0] = 2;
        memset(out + 1, 0, n);
        return;
    }
    for (at = 0; at < n; at += 16) {
        uint8_t x[16], a[16], b[16], c[16], made[5][16];
        memcpy(x, row + at, 16);
        memcpy(a, row + at - step, 16);
        memcpy(b, above + at, 16);
        memcpy(c, above + at - step, 16);
        for (i = 0; i < 16; i++) made[0][i] = x[i];
        for (i = 0; i < 16; i++) made[1][i] = (uint8_t)(x[i] - a[i]);
        for (i = 0; i < 16; i++) made[2][i] = (uint8_t)(x[i] - b[i]);
        for (i = 0; i < 16; i++) made[3][i] = (uint8_t)(x[i] - ((a[i] + b[i]) >> 1));
        for (i = 0; i < 16; i++) {
            const int16_t to_a = (int16_t)abs(b[i] - c[i]), to_b = (int16_t)abs(a[i] - c[i]);
            const int16_t to_c = (int16_t)abs(a[i] + b[i] - 2 * c[i]);
            const uint8_t pick = to_b <= to_c ? b[i] : c[i];
            made[4][i] = (uint8_t)(x[i] - (to_a <= to_b && to_a <= to_c ? a[i] : pick));
        }
        for (k = 0; k < 5; k++) {
            const size_t used = n - at < 16 ? n - at : 16;
            uint32_t sum = 0;
            memcpy(candidates + k * (n + 17) + 1 + at, made[k], 16);
            memset(made[k] + used, 0, 16 - used);
            for (i = 0; i < 16; i++) sum += supi_magnitude(made[k][i]);
            sums[k] += sum; /* one that wraps round, beyond 2^25 bytes, makes a poorer choice but no wrong picture */
        }
    }
    for (k = 1; k < 5; k++) {
        if (sums[k] < sums[best]) best = k;
    }
    candidates[best * (n + 17)] = (uint8_t)best;
    memcpy(out, candidates + best * (n + 17), n + 1);
}

SUP_FN void supi_big32(uint8_t *p, uint32_t value) {
    p[0] = (uint8_t)(value >> 24);
    p[1] = (uint8_t)(value >> 16);
    p[2] = (uint8_t)(value >> 8);
    p[3] = (uint8_t)value;
}

/* CRC-32 of ISO 3309. One table is enough: only what has been compressed goes through it. */
SUP_FN uint32_t supi_crc32(const uint8_t *data, size_t size) {
    uint32_t table[256], crc = 0xffffffffu, i, k;
    for (i = 0; i < 256; i++) {
        table[i] = i;
        for (k = 0; k < 8; k++) table[i] = (table[i] >> 1) ^ (0xedb88320u & (0u - (table[i] & 1u)));
    }
    for (; size > 0; size--) crc = table[(crc ^ *data++) & 255u] ^ (crc >> 8);
    return ~crc;
}

/* Write length and CRC of the chunk that begins at `start` and ends at d->size; room for 4 bytes is reserved. */
SUP_FN void supi_end_chunk(supi_deflate *d, size_t start) {
    supi_big32(d->out + start, (uint32_t)(d->size - start - 8));
    supi_big32(d->out + d->size, supi_crc32(d->out + start + 4, d->size - start - 4));
    d->size += 4;
}

SUP_FN size_t supi_begin_chunk(supi_deflate *d, const char *type) {
    const size_t start = d->size;
    memcpy(d->out + start + 4, type, 4);
    d->size += 8;
    return start;
}

/* Filter all rows into `out`, height rows of n + 1 bytes. scratch: two rows behind `step` zeros and with 16 bytes of
   room behind them, five candidates. */
SUP_FN void supi_png_rows(const sup_picture *picture, size_t n, size_t step, size_t stride, uint8_t *scratch,
                          uint8_t *out) {
    uint8_t *row = scratch + step, *above = row + n + 16 + step, *candidates = above + n + 16;
    const uint8_t *from = (const uint8_t *)picture->pixels;
    size_t y, i;
    memset(scratch, 0, 2 * (step + n + 16));
    for (y = 0; y < picture->height; y++) {
        uint8_t *swap;
        if (picture->bits == 8) {
            memcpy(row, from + y * stride, n);
        } else {
            for (i = 0; i < n; i += 2) {
                uint16_t value;
                memcpy(&value, from + y * stride + i, 2);
                row[i] = (uint8_t)(value >> 8);
                row[i + 1] = (uint8_t)value;
            }
        }
        supi_filter_row(row, above, n, step, candidates, out + y * (n + 1));
        swap = row;
        row = above;
        above = swap;
    }
}

/* Encode a picture as a PNG file in memory.
   data, size  out: the file; free with SUP_FREE. NULL and 0 on error
   Returns 0, or 1 with err->text set: no rows or columns, other channels or bits, more than 2 GB of pixels, memory.
   Memory: about the picture twice. Speed: 50 to 150 MB of pixels a second. */
SUP_FN int sup_png_encode(const sup_picture *picture, uint8_t **data, size_t *size, sup_error *err) {
    static const uint8_t signature[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
    static const uint8_t colour_type[5] = {0, 0, 4, 2, 6};
    const uint64_t limit = UINT64_C(2000000000);
    size_t n, raw, step, stride, start;
    uint8_t *scratch, *rows;
    supi_deflate *d;
    int failed;
    sup_error_clear(err);
    *data = NULL;
    *size = 0;
    if (!picture->pixels || picture->width == 0 || picture->height == 0)
        return sup_fail(err, "a PNG picture needs at least one pixel");
    if (picture->channels < 1 || picture->channels > 4)
        return sup_fail(err, "a PNG picture has 1 to 4 channels, not %lu", (unsigned long)picture->channels);
    if (picture->bits != 8 && picture->bits != 16)
        return sup_fail(err, "a PNG picture has 8 or 16 bits, not %lu", (unsigned long)picture->bits);
    step = (size_t)picture->channels * (picture->bits / 8);
    if (picture->width > limit / step || picture->height > limit / ((uint64_t)picture->width * step + 1)) {
        return sup_fail(err, "a picture of %lux%lu is too large for this PNG writer", (unsigned long)picture->width,
                        (unsigned long)picture->height);
    }
    n = picture->width * step;
    raw = picture->height * (n + 1);
    stride = picture->stride ? picture->stride : n;
    if (stride < n)
        return sup_fail(err, "the rows of a picture overlap: stride %lu, row %lu bytes", (unsigned long)stride,
                        (unsigned long)n);
    scratch = (uint8_t *)sup_alloc(n + 32, 8); /* covers 2 * (step + n + 16) + 5 * (n + 17) */
    rows = (uint8_t *)sup_alloc(raw, 1);
    d = (supi_deflate *)sup_alloc(1, sizeof *d);
    failed = !scratch || !rows || !d;
    if (!failed) {
        supi_png_rows(picture, n, step, stride, scratch, rows);
        memset(d, 0, sizeof *d);
        supi_deflate_tables(d);
        failed = supi_deflate_reserve(d, 256);
    }
    if (!failed) {
        memcpy(d->out, signature, 8);
        d->size = 8;
        start = supi_begin_chunk(d, "IHDR");
        supi_big32(d->out + d->size, picture->width);
        supi_big32(d->out + d->size + 4, picture->height);
        d->out[d->size + 8] = (uint8_t)picture->bits;
        d->out[d->size + 9] = colour_type[picture->channels];
        memset(d->out + d->size + 10, 0, 3);
        d->size += 13;
        supi_end_chunk(d, start);
        start = supi_begin_chunk(d, "sRGB");
        d->out[d->size++] = 0;
        supi_end_chunk(d, start);
        start = supi_begin_chunk(d, "IDAT");
        d->out[d->size++] = 0x78; /* zlib: deflate, window of 32 KB, check bits */
        d->out[d->size++] = 0x9c;
        failed = supi_deflate_run(d, rows, raw) || supi_deflate_reserve(d, 64);
        if (!failed) {
            supi_big32(d->out + d->size, supi_adler32(rows, raw));
            d->size += 4;
            supi_end_chunk(d, start);
            start = supi_begin_chunk(d, "IEND");
            supi_end_chunk(d, start);
            *data = d->out;
            *size = d->size;
        }
    }
    if (failed && d) SUP_FREE(scratch && rows ? d->out : NULL);
    SUP_FREE(scratch);
    SUP_FREE(rows);
    SUP_FREE(d);
    return failed ? sup_fail(err, "out of memory for a picture of %lux%lu", (unsigned long)picture->width,
                             (unsigned long)picture->height)
                  : 0;
}

/* Write a picture as the PNG file `path`, whole or not at all. Returns 0, or 1 with err->text set. */
SUP_FN int sup_png_write(const char *path, const sup_picture *picture, sup_error *err) {
    uint8_t *data;
    size_t size;
    int failed;
    if (sup_png_encode(picture, &data, &size, err)) {
        sup_error inner;
        if (err) {
            inner = *err;
            (void)sup_fail(err, "%s: %s", path, inner.text);
        }
        return 1;
    }
    failed = sup_write_file(path, data, size, err);
    SUP_FREE(data);
    return failed;
}

/* The common case: 8 bits, rows close together. pixels: in, [width * height * channels]. */
SUP_FN int sup_png_write8(const char *path, const uint8_t *pixels, uint32_t width, uint32_t height, uint32_t channels,
                          sup_error *err) {
    sup_picture picture;
    memset(&picture, 0, sizeof picture);
    picture.pixels = pixels;
    picture.width = width;
    picture.height = height;
    picture.channels = channels;
    picture.bits = 8;
    return sup_png_write(path, &picture, err);
}

/* Write floats as the PFM file `path`, whole or not at all: little-endian, rows from bottom to top as that format has.
   pixels    in, [width * height * channels], rows from top to bottom, linear
   channels  1 or 3
   Returns 0, or 1 with err->text set. */
SUP_FN int sup_pfm_write(const char *path, const float *pixels, uint32_t width, uint32_t height, uint32_t channels,
                         sup_error *err) {
    sup_file file;
    uint8_t *row;
    size_t n, total, i, y;
    sup_error_clear(err);
    if (width == 0 || height == 0) return sup_fail(err, "%s: a PFM picture needs at least one pixel", path);
    if (channels != 1 && channels != 3)
        return sup_fail(err, "%s: a PFM picture has 1 or 3 channels, not %lu", path, (unsigned long)channels);
    if (sup_mul_size(width, channels * sizeof(float), &n) || sup_mul_size(n, height, &total))
        return sup_fail(err, "%s: the picture is too large", path);
    row = (uint8_t *)sup_alloc(n, 1);
    if (!row) return sup_fail(err, "%s: out of memory", path);
    if (sup_file_open(path, &file, err)) {
        SUP_FREE(row);
        return 1;
    }
    (void)fprintf(file.stream, "%s\n%lu %lu\n-1.0\n", channels == 1 ? "Pf" : "PF", (unsigned long)width,
                  (unsigned long)height);
    for (y = height; y-- > 0;) {
        for (i = 0; i < n / sizeof(float); i++) {
            uint32_t bits;
            memcpy(&bits, pixels + y * (n / sizeof(float)) + i, sizeof bits);
            row[4 * i] = (uint8_t)bits;
            row[4 * i + 1] = (uint8_t)(bits >> 8);
            row[4 * i + 2] = (uint8_t)(bits >> 16);
            row[4 * i + 3] = (uint8_t)(bits >> 24);
        }
        if (fwrite(row, 1, n, file.stream) != n) break; /* commit sees the error of the stream */
    }
    SUP_FREE(row);
    return sup_file_commit(&file, err);
}

/* ---- colours ------------------------------------------------------------------------------------------------ */

/* One linear component to sRGB, both 0..1, IEC 61966-2-1; clamps, and what is not a number becomes 0. */
SUP_FN float sup_srgb_from_linear(float value) {
    if (!(value > 0.0f)) return 0.0f;
    if (value >= 1.0f) return 1.0f;
    return value <= 0.0031308f ? 12.92f * value : 1.055f * powf(value, 1.0f / 2.4f) - 0.055f;
}

/* One sRGB byte to linear 0..1. */
SUP_FN float sup_linear_from_srgb(uint8_t byte) {
    const float value = (float)byte * (1.0f / 255.0f);
    return value <= 0.04045f ? value * (1.0f / 12.92f) : powf((value + 0.055f) * (1.0f / 1.055f), 2.4f);
}

/* Linear premultiplied RGBA floats to sRGB bytes with plain alpha, what a PNG file holds.
   linear  in, [4 * count]; bytes  out, [4 * count]; must not overlap */
SUP_FN void sup_rgba8_from_linear(const float *linear, uint8_t *bytes, size_t count) {
    size_t i, k;
    for (i = 0; i < count; i++) {
        const float alpha = linear[4 * i + 3], scale = alpha > 0.0f ? 1.0f / alpha : 0.0f;
        for (k = 0; k < 3; k++)
            bytes[4 * i + k] = (uint8_t)(sup_srgb_from_linear(linear[4 * i + k] * scale) * 255.0f + 0.5f);
        bytes[4 * i + 3] = (uint8_t)((alpha > 0.0f ? (alpha < 1.0f ? alpha : 1.0f) : 0.0f) * 255.0f + 0.5f);
    }
}

#endif
