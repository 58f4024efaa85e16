/* Palettes and streams of palette indices, against slow oracles written from the definitions. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"

typedef struct palette_built {
    uint32_t *index; /* [n] */
    uint8_t *palette;
    uint32_t count;
    uint64_t colors_in;
    size_t n;
    voxrt_result result;
} palette_built;

static voxrt_env env_of(uint32_t threads) {
    voxrt_env env;
    memset(&env, 0, sizeof env);
    env.thread_count = threads;
    return env;
}

static palette_built build_with(const voxrt_env *env, voxrti_mem *mem, const uint32_t *rgb, size_t n, size_t census, uint32_t k,
                        voxrt_palette_method method) {
    palette_built b;
    memset(&b, 0, sizeof b);
    b.n = n;
    b.index = (uint32_t *)malloc((n + 1) * sizeof(uint32_t));
    if (n != 0) memcpy(b.index, rgb, n * sizeof(uint32_t));
    b.result = voxrti_palette_build(mem, env, b.index, n, census, k, method, &b.palette, &b.count, &b.colors_in);
    return b;
}

static voxrti_mem mem_g;

static palette_built build(const uint32_t *rgb, size_t n, size_t census, uint32_t k, voxrt_palette_method method) {
    voxrt_env env = env_of(2);
    return build_with(&env, &mem_g, rgb, n, census, k, method);
}

static void drop(palette_built *b) {
    free(b->index);
    voxrti_free(&mem_g, b->palette);
}

static uint32_t palette_entry(const palette_built *b, uint32_t i) {
    return (uint32_t)b->palette[3 * i] | (uint32_t)b->palette[3 * i + 1] << 8 | (uint32_t)b->palette[3 * i + 2] << 16;
}

static int entries_differ(const palette_built *b) {
    uint32_t i, j;
    for (i = 0; i < b->count; i++)
        for (j = 0; j < i; j++)
            if (palette_entry(b, i) == palette_entry(b, j)) return 0;
    return 1;
}

/* Oklab with the C library's functions */
static void oracle_oklab(uint32_t rgb, double c[3]) {
    double lin[3], l, m, s;
    int k;
    for (k = 0; k < 3; k++) {
        double x = (double)(rgb >> (8 * k) & 255u) / 255.0;
        lin[k] = x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4);
    }
    l = cbrt(0.4122214708 * lin[0] + 0.5363325363 * lin[1] + 0.0514459929 * lin[2]);
    m = cbrt(0.2119034982 * lin[0] + 0.6806995451 * lin[1] + 0.1073969566 * lin[2]);
    s = cbrt(0.0883024619 * lin[0] + 0.2817188376 * lin[1] + 0.6299787005 * lin[2]);
    c[0] = 0.2104542553 * l + 0.7936177850 * m - 0.0040720468 * s;
    c[1] = 1.9779984951 * l - 2.4285922050 * m + 0.4505937099 * s;
    c[2] = 0.0259040371 * l + 0.7827717662 * m - 0.8086757660 * s;
}

static double delta_e(uint32_t a, uint32_t b) {
    double p[3], q[3];
    oracle_oklab(a, p);
    oracle_oklab(b, q);
    return sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2]));
}

static int compare_u32(const void *a, const void *b) {
    uint32_t x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return x < y ? -1 : x > y;
}

/* noise: any colour. photo: smooth gradients with shading and a little grain */
static uint32_t *make_colors(size_t n, int photo, uint64_t seed) {
    uint32_t *rgb = (uint32_t *)malloc(n * sizeof(uint32_t));
    test_rng r = test_rng_make(seed);
    size_t i;
    for (i = 0; i < n; i++) {
        if (photo) {
            double x = test_rng_double(&r), y = test_rng_double(&r), grain = test_rng_double(&r) * 16.0;
            double red = 230.0 * x * (0.4 + 0.6 * y) + grain, green = 40.0 + 170.0 * y * (1.0 - 0.3 * x) + grain;
            double blue = 225.0 * (1.0 - x) * (0.3 + 0.7 * y) + grain;
            rgb[i] = (uint32_t)red | (uint32_t)green << 8 | (uint32_t)blue << 16;
        } else rgb[i] = test_rng_u32(&r) >> 8;
    }
    return rgb;
}

/* ---- index streams ---- */

static void check_codec(const uint32_t *v, size_t n, uint32_t palette_count) {
    voxrt_env env = env_of(2), one = env_of(1);
    voxrti_colors c, d;
    uint32_t *out = (uint32_t *)malloc((n + 1) * sizeof(uint32_t));
    size_t i, bad = 0, top = 0;
    REQUIRE(voxrti_colors_encode(&mem_g, &env, v, n, &c) == VOXRT_OK);
    REQUIRE(voxrti_colors_encode(&mem_g, &one, v, n, &d) == VOXRT_OK);
    CHECK(voxrti_colors_valid(&c, n, palette_count));
    CHECK(c.block_count == d.block_count && c.data_bytes == d.data_bytes);
    for (i = 0; i < n; i++) top |= v[i];
    CHECK((c.block == NULL) == (top == 0));
    if (c.block != NULL) {
        CHECK(c.block_count == (n + 63) / 64);
        CHECK(memcmp(c.block, d.block, c.block_count * sizeof(uint32_t)) == 0);
        CHECK(c.data_bytes == 0 || memcmp(c.data, d.data, c.data_bytes + 8) == 0);
        for (i = 0; i < n; i++) bad += voxrti_colors_get(&c, i) != v[i];
        CHECK_EQ_U64(bad, 0);
    }
    out[n] = 0xabcdefu;
    voxrti_colors_decode(&c, 0, n, out);
    CHECK(memcmp(out, v, n * sizeof(uint32_t)) == 0);
    for (i = 0; i < n; i += 37) { /* a part */
        size_t m = n - i < 100 ? n - i : 100;
        out[m] = 0xabcdefu;
        voxrti_colors_decode(&c, i, m, out);
        bad += memcmp(out, v + i, m * sizeof(uint32_t)) != 0 || out[m] != 0xabcdefu;
    }
    CHECK_EQ_U64(bad, 0);
    free(out);
    voxrti_free(&mem_g, c.block);
    voxrti_free(&mem_g, c.data);
    voxrti_free(&mem_g, d.block);
    voxrti_free(&mem_g, d.data);
}

enum { PATTERNS = 12 };
static void fill_pattern(uint32_t *v, size_t n, int pattern, uint64_t seed) {
    test_rng r = test_rng_make(seed + (uint64_t)pattern * 77u);
    uint32_t few[40], run = 0;
    size_t i;
    for (i = 0; i < 40; i++) few[i] = test_rng_u32(&r) >> (pattern & 1 ? 8 : 17);
    for (i = 0; i < n; i++) {
        uint32_t x = test_rng_u32(&r);
        switch (pattern) {
        case 0: v[i] = 0; break;
        case 1: v[i] = 0xffffffu; break;
        case 2: v[i] = x >> 24; break;
        case 3: v[i] = x >> 16; break;
        case 4: v[i] = x >> 8; break;
        case 5: case 6: v[i] = few[x % (1 + (i / 64) % 40)]; break;
        case 7: case 8:
            if (x % 50 == 0) run = test_rng_u32(&r) >> (pattern == 7 ? 8 : 17);
            v[i] = run;
            break;
        case 9: v[i] = (uint32_t)(i / 3) & 0xffffffu; break;
        case 10: v[i] = 0xffff00u + (x & 127u); break;
        default: v[i] = (x >> 7) & ((1u << ((i / 64) % 25)) - 1u); break; /* every width */
        }
    }
}

TEST(codec_round_trip) {
    static const size_t sizes[] = { 0, 1, 2, 63, 64, 65, 1000, 5000, 70000 };
    uint32_t *v = (uint32_t *)malloc(70000 * sizeof(uint32_t));
    size_t s;
    int pattern;
    for (s = 0; s < sizeof sizes / sizeof sizes[0]; s++) {
        for (pattern = 0; pattern < PATTERNS; pattern++) {
            fill_pattern(v, sizes[s], pattern, s);
            check_codec(v, sizes[s], 0x1000000u);
        }
    }
    free(v);
}

static size_t encoded_bytes(const uint32_t *v, size_t n) {
    voxrt_env env = env_of(1);
    voxrti_colors c;
    size_t bytes;
    CHECK(voxrti_colors_encode(&mem_g, &env, v, n, &c) == VOXRT_OK);
    bytes = c.data_bytes + 4 * c.block_count;
    voxrti_free(&mem_g, c.block);
    voxrti_free(&mem_g, c.data);
    return bytes;
}

TEST(codec_size) { /* what a block of 64 costs, word included */
    uint32_t v[128], i;
    for (i = 0; i < 128; i++) v[i] = 5;
    CHECK_EQ_U64(encoded_bytes(v, 128), 8); /* constant: the words */
    v[70] = 6;
    CHECK_EQ_U64(encoded_bytes(v, 128), 8 + 12); /* base and 1 bit each */
    v[70] = 30000;
    CHECK_EQ_U64(encoded_bytes(v, 128), 8 + 12); /* 1 bit each, two u16 */
    v[71] = 20000;
    CHECK_EQ_U64(encoded_bytes(v, 128), 8 + 24); /* 16 + 3*2, rounded up */
    v[71] = 0x123456u;
    CHECK_EQ_U64(encoded_bytes(v, 128), 8 + 28); /* 16 + 3*3, rounded up */
    for (i = 0; i < 128; i++) v[i] = i * 500;
    CHECK_EQ_U64(encoded_bytes(v, 128), 8 + 2 * (4 + 8 * 15)); /* 63 * 500 needs 15 bits */
    for (i = 0; i < 128; i++) v[i] = 0;
    CHECK_EQ_U64(encoded_bytes(v, 128), 0);
}

TEST(codec_errors) {
    test_alloc ta;
    voxrti_mem mem;
    voxrt_env env = env_of(1);
    voxrt_error error;
    voxrti_colors c;
    uint32_t v[200];
    int64_t k;
    test_alloc_init(&ta);
    env.allocator.alloc_fn = test_alloc_fn;
    env.allocator.free_fn = test_free_fn;
    env.allocator.user = &ta;
    env.error = &error;
    REQUIRE(voxrti_env_open(&env, &mem) == VOXRT_OK);
    fill_pattern(v, 200, 4, 1);
    v[130] = 0x1000000u;
    CHECK(voxrti_colors_encode(&mem, &env, v, 200, &c) == VOXRT_ERR_RANGE);
    CHECK(c.block == NULL && c.data == NULL && c.block_count == 0 && c.data_bytes == 0);
    CHECK_EQ_U64(error.where, 0x1000000u);
    v[130] = 0xffffffu;
    for (k = 0;; k++) {
        voxrt_result r;
        ta.count = 0;
        ta.fail_at = k;
        r = voxrti_colors_encode(&mem, &env, v, 200, &c);
        if (r == VOXRT_OK) break;
        CHECK(r == VOXRT_ERR_NO_MEMORY && c.block == NULL && c.data == NULL);
        test_alloc_check(&ta);
    }
    CHECK(k == 4);
    voxrti_free(&mem, c.block);
    voxrti_free(&mem, c.data);
    test_alloc_check(&ta);
}

/* Damaged streams: either refused, or everything in range. The data stands in a block of its exact size, so that a
   sanitizer sees any read past it. */
TEST(codec_untrusted) {
    voxrt_env env = env_of(1);
    test_rng r = test_rng_make(99);
    int rounds = test_quick() ? 3000 : 20000, round, pattern, refused = 0;
    uint32_t v[300], out[300], top = 0, i;
    for (pattern = 2; pattern < PATTERNS; pattern++) {
        voxrti_colors c, d;
        fill_pattern(v, 300, pattern, 3);
        for (i = 0, top = 0; i < 300; i++) top = v[i] > top ? v[i] : top;
        REQUIRE(voxrti_colors_encode(&mem_g, &env, v, 300, &c) == VOXRT_OK);
        CHECK(voxrti_colors_valid(&c, 300, top + 1));
        CHECK(!voxrti_colors_valid(&c, 300, top));
        CHECK(!voxrti_colors_valid(&c, 300, 0));
        CHECK(!voxrti_colors_valid(&c, 321, top + 1));
        CHECK(!voxrti_colors_valid(&c, 256, top + 1));
        for (round = 0; round < rounds / PATTERNS; round++) {
            uint32_t flips = 1 + test_rng_below(&r, 3), bad = 0;
            size_t cut = round % 4 == 0 ? test_rng_below(&r, (uint32_t)c.data_bytes + 1) : c.data_bytes;
            d.block_count = c.block_count;
            d.data_bytes = cut;
            d.block = (uint32_t *)malloc(c.block_count * sizeof(uint32_t));
            d.data = (uint8_t *)malloc(cut + 8);
            memcpy(d.block, c.block, c.block_count * sizeof(uint32_t));
            if (cut != 0) memcpy(d.data, c.data, cut);
            memset(d.data + cut, (int)(test_rng_u32(&r) & 255u), 8);
            while (flips-- > 0) {
                uint32_t bit = 1u << test_rng_below(&r, 32), at = test_rng_below(&r, (uint32_t)c.block_count + 4);
                if (at < c.block_count) d.block[at] ^= bit;
                else if (cut != 0) d.data[test_rng_below(&r, (uint32_t)cut)] ^= (uint8_t)(1u << (at + flips) % 8u);
            }
            if (!voxrti_colors_valid(&d, 300, top + 1)) refused++;
            else {
                voxrti_colors_decode(&d, 0, 300, out);
                for (i = 0; i < 300; i++) bad += out[i] > top || out[i] != voxrti_colors_get(&d, i);
                CHECK_EQ_U64(bad, 0);
            }
            free(d.block);
            free(d.data);
        }
        voxrti_free(&mem_g, c.block);
        voxrti_free(&mem_g, c.data);
    }
    CHECK(refused > rounds / 10);
}

/* ---- palettes ---- */

TEST(oklab_exact) { /* every byte colour survives the way to Oklab and back; the own cube root is good */
    voxrti_oklab o;
    uint32_t c, bad = 0, step = test_quick() ? 1009 : 17;
    double worst = 0.0;
    voxrti_oklab_init(&o);
    for (c = 0; c < 0x1000000u; c += step) {
        double p[3], q[3];
        int k;
        voxrti_oklab_from(&o, c, p);
        bad += voxrti_oklab_to(&o, p) != c;
        if (c % (step * 16) != 0) continue;
        oracle_oklab(c, q);
        for (k = 0; k < 3; k++) worst = fabs(p[k] - q[k]) > worst ? fabs(p[k] - q[k]) : worst;
    }
    CHECK_EQ_U64(bad, 0);
    CHECK_MSG(worst < 1e-11, "worst difference %g", worst);
}

TEST(edges) {
    static const uint32_t two[5] = { 0x0000ffu, 0xff0000u, 0x0000ffu, 0x0000ffu, 0xff0000u };
    int method;
    for (method = 0; method < 2; method++) {
        voxrt_palette_method m = (voxrt_palette_method)method;
        palette_built b = build(NULL, 0, 0, 5, m);
        CHECK(b.result == VOXRT_OK && b.count == 1 && b.colors_in == 0 && palette_entry(&b, 0) == 0xffffffu);
        drop(&b);
        b = build(two, 1, 1, 1, m);
        CHECK(b.result == VOXRT_OK && b.count == 1 && b.colors_in == 1 && palette_entry(&b, 0) == 0xffu && b.index[0] == 0);
        drop(&b);
        b = build(two, 5, 5, 2, m);
        CHECK(b.result == VOXRT_OK && b.count == 2 && b.colors_in == 2);
        CHECK(palette_entry(&b, b.index[0]) == 0xffu && palette_entry(&b, b.index[1]) == 0xff0000u);
        CHECK(b.index[4] == b.index[1] && b.index[2] == b.index[0] && b.index[3] == b.index[0]);
        drop(&b);
        b = build(two, 5, 5, 1, m);
        CHECK(b.result == VOXRT_OK && b.count == 1 && b.colors_in == 2);
        if (m == VOXRT_PALETTE_THESIS) CHECK_EQ_U64(palette_entry(&b, 0), 153u | 102u << 16); /* eq. 3: 3/5, 2/5 */
        drop(&b);
        b = build(two, 5, 5, 0, m);
        CHECK(b.result == VOXRT_ERR_INVALID_ARG && b.palette == NULL);
        drop(&b);
    }
}

TEST(lossless) {
    static const size_t sizes[] = { 2, 100, 5000, 300000 };
    size_t s, i;
    for (s = 0; s < 4; s++) {
        size_t n = sizes[s], bad = 0, census = n - n / 3;
        uint32_t *rgb = make_colors(n, 0, s), *sorted = (uint32_t *)malloc(n * sizeof(uint32_t));
        uint32_t distinct = 1, leaf = 1;
        palette_built b;
        for (i = 0; i < n; i++) rgb[i] &= 0x3f3f3fu;
        memcpy(sorted, rgb, census * sizeof(uint32_t));
        qsort(sorted, census, sizeof(uint32_t), compare_u32);
        for (i = 1; i < census; i++) leaf += sorted[i] != sorted[i - 1];
        memcpy(sorted, rgb, n * sizeof(uint32_t));
        qsort(sorted, n, sizeof(uint32_t), compare_u32);
        for (i = 1; i < n; i++) distinct += sorted[i] != sorted[i - 1];
        b = build(rgb, n, census, distinct, s & 1 ? VOXRT_PALETTE_THESIS : VOXRT_PALETTE_OKLAB);
        CHECK(b.result == VOXRT_OK);
        CHECK_EQ_U64(b.count, distinct);
        CHECK_EQ_U64(b.colors_in, leaf);
        for (i = 0; i < n; i++) bad += b.index[i] >= b.count || palette_entry(&b, b.index[i]) != rgb[i];
        CHECK_EQ_U64(bad, 0);
        drop(&b);
        b = build(rgb, n, n, 0x1000000u, VOXRT_PALETTE_OKLAB);
        CHECK_EQ_U64(b.count, distinct);
        drop(&b);
        free(rgb);
        free(sorted);
    }
}

/* Leaves' colours are kept although those of the level-of-detail cells do not fit; these go to the nearest entry. */
TEST(lod_colors) {
    int method;
    for (method = 0; method < 2; method++) {
        size_t n = 3000, census = 1000, i;
        uint32_t *rgb = make_colors(n, 0, 7), k, room, j;
        for (room = 0; room < 120; room += 40) {
            palette_built b;
            size_t bad = 0, not_nearest = 0;
            for (i = 0; i < census; i++) rgb[i] = rgb[i % 500];
            k = 500 + room;
            b = build(rgb, n, census, k, (voxrt_palette_method)method);
            CHECK(b.result == VOXRT_OK && b.count <= k && b.count + 4 >= k);
            CHECK_EQ_U64(b.colors_in, 500);
            for (i = 0; i < census; i++) bad += palette_entry(&b, b.index[i]) != rgb[i];
            CHECK_EQ_U64(bad, 0);
            for (i = census; i < n && method == 0; i += 11) {
                double best = 1e9, got = delta_e(rgb[i], palette_entry(&b, b.index[i]));
                for (j = 0; j < b.count; j++) {
                    double d = delta_e(rgb[i], palette_entry(&b, j));
                    best = d < best ? d : best;
                }
                not_nearest += got > best + 1e-9;
            }
            CHECK_EQ_U64(not_nearest, 0);
            CHECK(entries_differ(&b));
            drop(&b);
        }
        free(rgb);
    }
}

/* The room that the leaves' colours leave goes to the colours that only level-of-detail cells have. */
TEST(lod_room) {
    uint32_t rgb[4000], n = 0, i, j;
    int method;
    for (i = 0; i < 200; i++) rgb[n++] = 0x40u + i % 20 + ((i / 20) << 8); /* reds */
    for (j = 0; j < 10; j++)
        for (i = 0; i < 200; i++) rgb[n++] = rgb[i];
    rgb[n++] = 0x00d000u;
    rgb[n++] = 0xd00000u;
    rgb[n++] = 0xd20000u;
    for (method = 0; method < 2; method++) {
        palette_built b = build(rgb, n, 200, 202, (voxrt_palette_method)method);
        REQUIRE(b.result == VOXRT_OK);
        CHECK_EQ_U64(b.count, 202);
        CHECK_EQ_U64(palette_entry(&b, b.index[n - 3]), 0x00d000u);
        CHECK_EQ_U64(palette_entry(&b, b.index[n - 1]), 0xd10000u);
        CHECK_EQ_U64(b.index[n - 1], b.index[n - 2]);
        drop(&b);
    }
}

/* Usage counts, with counters for each task (few colours) and shared ones (many). */
TEST(usage_counts) {
    int many;
    for (many = 0; many < 2; many++) {
        size_t n = 300000, i, j;
        uint32_t *rgb = make_colors(n, 0, 13), *use = NULL, bad = 0, rank = 0;
        voxrt_env env = env_of(4);
        voxrti_cset set;
        voxrti_pal_pass pass;
        for (i = 0; i < n; i++) {
            if (!many) rgb[i] &= 0x070f07u;
            if (i % 1000 > 600) rgb[i] = rgb[i - 1]; /* runs */
        }
        REQUIRE(voxrti_cset_open(&mem_g, &set, many ? n : 2048));
        voxrti_pal_pass_open(&pass, rgb, n, &set);
        for (i = 0; i < n; i++) voxrti_cset_add(&set, voxrti_pal_code(pass.spread, rgb[i]));
        voxrti_cset_rank(&set);
        REQUIRE(voxrti_pal_count(&mem_g, &env, rgb, n, &set, &use) == VOXRT_OK);
        CHECK(many ? set.count > 65536 : set.count <= 1024);
        for (i = 0; i < n; i++) rgb[i] = voxrti_pal_code(pass.spread, rgb[i]);
        qsort(rgb, n, sizeof(uint32_t), compare_u32);
        for (i = 0; i < n; i = j, rank++) {
            for (j = i; j < n && rgb[j] == rgb[i]; j++) { }
            bad += voxrti_cset_index(&set, rgb[i]) != rank || use[rank] != j - i;
        }
        CHECK_EQ_U64(bad, 0);
        CHECK_EQ_U64(rank, set.count);
        voxrti_free(&mem_g, use);
        voxrti_cset_close(&mem_g, &set);
        free(rgb);
    }
}

/* The nearest entry for colours of a reduced palette, by brute force. */
TEST(nearest) {
    size_t n = 20000, i, bad = 0;
    uint32_t *rgb = make_colors(n, 1, 21), j;
    palette_built b = build(rgb, n, n / 2, 700, VOXRT_PALETTE_OKLAB);
    REQUIRE(b.result == VOXRT_OK);
    CHECK(b.count <= 700 && b.count > 690);
    for (i = 0; i < n; i += 23) {
        double best = 1e9, got = delta_e(rgb[i], palette_entry(&b, b.index[i]));
        for (j = 0; j < b.count; j++) {
            double d = delta_e(rgb[i], palette_entry(&b, j));
            best = d < best ? d : best;
        }
        bad += got > best + 1e-9;
    }
    CHECK_EQ_U64(bad, 0);
    drop(&b);
    free(rgb);
}

/* The thesis' merging, literally: try all pairs, merge the best, again. */
typedef struct oracle_color { double c[3], v, g; } oracle_color;

static uint32_t oracle_thesis(const uint32_t *color, const uint32_t *use, uint32_t n, uint32_t k, uint32_t *merged) {
    oracle_color *list = (oracle_color *)malloc(n * sizeof(oracle_color));
    uint32_t *of = (uint32_t *)malloc(n * sizeof(uint32_t)), i, j, t, count = n;
    for (i = 0; i < n; i++) {
        for (t = 0; t < 3; t++) list[i].c[t] = (double)(color[i] >> (8 * t) & 255u);
        list[i].v = (double)use[i];
        list[i].g = 0.0;
        of[i] = i;
    }
    while (count > k) {
        double best = 1e300;
        uint32_t bi = 0, bj = 0;
        oracle_color *a, *b;
        for (i = 0; i < count; i++) {
            for (j = i + 1; j < count; j++) {
                double x = list[i].c[0] - list[j].c[0], y = list[i].c[1] - list[j].c[1];
                double z = list[i].c[2] - list[j].c[2];
                double s = (x * x + y * y + z * z) * (1.0 + list[i].g + list[j].g);
                if (s < best) {
                    best = s;
                    bi = i;
                    bj = j;
                }
            }
        }
        a = &list[bi];
        b = &list[bj];
        for (t = 0; t < 3; t++) a->c[t] = (a->c[t] * a->v + b->c[t] * b->v) / (a->v + b->v);
        a->v += b->v;
        a->g = a->g + b->g + 1.0;
        for (i = 0; i < n; i++) of[i] = of[i] == bj ? bi : of[i] > bj ? of[i] - 1 : of[i];
        memmove(&list[bj], &list[bj + 1], (count - bj - 1) * sizeof(oracle_color));
        count--;
    }
    for (i = 0; i < n; i++) {
        const double *c = list[of[i]].c;
        merged[i] = (uint32_t)floor(c[0] + 0.5) | (uint32_t)floor(c[1] + 0.5) << 8 | (uint32_t)floor(c[2] + 0.5) << 16;
    }
    free(list);
    free(of);
    return count;
}

/* Compare with the oracle for n distinct ascending colours. */
static void check_thesis(const uint32_t *color, const uint32_t *use, uint32_t n, uint32_t k, test_rng *r) {
    uint32_t merged[60], rgb[60 * 9], total = 0, bad = 0, i, j, t;
    palette_built b;
    for (i = 0; i < n; i++)
        for (j = 0; j < use[i]; j++) rgb[total++] = color[i];
    for (i = total; i > 1; i--) { /* any order */
        j = test_rng_below(r, i);
        t = rgb[i - 1];
        rgb[i - 1] = rgb[j];
        rgb[j] = t;
    }
    oracle_thesis(color, use, n, k, merged);
    b = build(rgb, total, total, k, VOXRT_PALETTE_THESIS);
    REQUIRE(b.result == VOXRT_OK);
    CHECK(b.count <= k);
    for (i = 0; i < total; i++) {
        uint32_t want = 0, kept = 0;
        for (j = 0; j < n; j++)
            if (color[j] == rgb[i]) want = merged[j];
        for (j = 0; j < b.count; j++) kept |= palette_entry(&b, j) == rgb[i];
        if (kept) want = rgb[i]; /* a colour that is in the palette is exact */
        bad += b.index[i] >= b.count || palette_entry(&b, b.index[i]) != want;
    }
    CHECK_MSG(bad == 0, "%u colours to %u: %u of %u differ", n, k, bad, total);
    for (j = 0; j < b.count; j++) { /* and the palette has no other entries */
        for (i = 0; i < n && merged[i] != palette_entry(&b, j); i++) { }
        CHECK(i < n);
    }
    CHECK(entries_differ(&b));
    drop(&b);
}

TEST(thesis_oracle) {
    /* on a line many merged colours meet again and costs are often equal */
    static const uint32_t masks[5] = { 0x070707u, 0x3f003fu, 0xffffffu, 0x0000ffu, 0x00003fu };
    int rounds = test_quick() ? 60 : 300, round;
    test_rng r = test_rng_make(4);
    for (round = 0; round < rounds; round++) {
        uint32_t color[60], use[60], n = 2 + test_rng_below(&r, 59), k = 1 + test_rng_below(&r, n), i, m = 0;
        for (i = 0; i < n; i++) color[i] = test_rng_u32(&r) & masks[round % 5];
        qsort(color, n, sizeof color[0], compare_u32);
        for (i = 0; i < n; i++)
            if (i == 0 || color[i] != color[i - 1]) color[m++] = color[i];
        for (i = 0; i < m; i++) use[i] = round % 2 ? 1 : 1 + test_rng_below(&r, 9);
        check_thesis(color, use, m, k > m ? m : k, &r);
    }
}

#define RGB(r, g, b) ((uint32_t)(r) | (uint32_t)(g) << 8 | (uint32_t)(b) << 16)

/* A pair (i, j) merges around a colour x of high drift, so that the new one is nearer to x than both were: x, whose
   partner is another one, y, has to notice. First nearer than y, then as near as y with a lower index. */
TEST(thesis_rare) {
    uint32_t color[12], use[12], n = 0, i;
    test_rng r = test_rng_make(1);
    for (i = 0; i < 12; i++) use[i] = 1;
    for (i = 0; i < 5; i++) color[n++] = RGB(100, 0, i);      /* x: drift 4 */
    for (i = 0; i < 3; i++) color[n++] = RGB(100, 30 + i, 2); /* y: drift 2, S(x, y) = 7 * 31^2 = 6727 */
    color[n++] = RGB(60, 0, 2);                               /* i, j: S = 80^2 = 6400, S(x, i) = 5 * 40^2 = 8000 */
    color[n++] = RGB(140, 0, 2);
    color[n++] = RGB(0, 255, 2);                              /* next if x does not notice: 81^2 = 6561 */
    color[n++] = RGB(81, 255, 2);
    qsort(color, n, sizeof color[0], compare_u32);
    check_thesis(color, use, n, 4, &r);
    n = 0;
    for (i = 0; i < 5; i++) color[n++] = RGB(100, 100, i);    /* x */
    color[n++] = RGB(99, 133, 2);                             /* y: drift 1, S(x, y) = 6 * 33^2 */
    color[n++] = RGB(101, 133, 2);
    color[n++] = RGB(60, 67, 2);                              /* i, j: merged they cost 6 * 33^2 with x, too */
    color[n++] = RGB(140, 67, 2);
    qsort(color, n, sizeof color[0], compare_u32);
    check_thesis(color, use, n, 2, &r);
}

/* Oklab, clusters far from each other: entries are the weighted means, and Ward's cost decides what is kept apart. */
TEST(oklab_means) {
    static const uint32_t center[4] = { 0x202020u, 0x2030d0u, 0x30d040u, 0xe0d0d0u };
    uint32_t rgb[4 * 60], n = 0, i, j, k;
    palette_built b;
    for (i = 0; i < 4; i++)
        for (j = 0; j < 60; j++) rgb[n++] = center[i] + (j % 3) + ((j / 3 % 3) << 8) + ((j % 5) << 16);
    b = build(rgb, n, n, 4, VOXRT_PALETTE_OKLAB);
    REQUIRE(b.result == VOXRT_OK && b.count == 4);
    for (i = 0; i < 4; i++) {
        double mean[3] = { 0, 0, 0 }, c[3], got[3];
        for (j = 0; j < 60; j++) {
            CHECK(b.index[i * 60 + j] == b.index[i * 60]);
            oracle_oklab(rgb[i * 60 + j], c);
            for (k = 0; k < 3; k++) mean[k] += c[k] / 60.0;
        }
        oracle_oklab(palette_entry(&b, b.index[i * 60]), got);
        for (k = 0; k < 3; k++) CHECK_NEAR(got[k], mean[k], 0.004); /* half a step of a byte */
    }
    drop(&b);
    /* Near but frequent stays apart, far but rare is merged: 25 * 0.035^2 against 0.5 * 0.092^2. */
    for (i = 0, n = 0; i < 102; i++) rgb[n++] = (i < 50 ? 100u : i < 100 ? 110u : i == 100 ? 200u : 230u) * 0x010101u;
    b = build(rgb, n, n, 3, VOXRT_PALETTE_OKLAB);
    REQUIRE(b.result == VOXRT_OK && b.count == 3);
    CHECK(palette_entry(&b, b.index[0]) == 100 * 0x010101u && palette_entry(&b, b.index[n - 3]) == 110 * 0x010101u);
    CHECK(b.index[n - 2] == b.index[n - 1]);
    drop(&b);
}

TEST(determinism) {
    static const uint32_t threads[] = { 1, 2, 7 };
    int method, photo, t;
    for (method = 0; method < 2; method++) {
        for (photo = 0; photo < 2; photo++) {
            size_t n = test_quick() ? 5000 : 24000, i;
            uint32_t k = method == 0 ? 300 : test_quick() ? 4400 : 21000;
            uint32_t *rgb = make_colors(n, photo, 5), *mixed = (uint32_t *)malloc(n * sizeof(uint32_t)), bad = 0;
            test_rng r = test_rng_make(1);
            palette_built a, b;
            voxrt_env env = env_of(1);
            a = build_with(&env, &mem_g, rgb, n, n, k, (voxrt_palette_method)method);
            REQUIRE(a.result == VOXRT_OK);
            for (t = test_quick() ? 2 : 1; t < 3; t++) {
                env = env_of(threads[t]);
                b = build_with(&env, &mem_g, rgb, n, n, k, (voxrt_palette_method)method);
                CHECK(a.count == b.count && memcmp(a.palette, b.palette, 3 * (size_t)a.count) == 0);
                CHECK(memcmp(a.index, b.index, n * sizeof(uint32_t)) == 0);
                drop(&b);
            }
            memcpy(mixed, rgb, n * sizeof(uint32_t));
            for (i = n; i > 1; i--) {
                size_t j = test_rng_below(&r, (uint32_t)i);
                uint32_t x = mixed[i - 1];
                mixed[i - 1] = mixed[j];
                mixed[j] = x;
            }
            b = build_with(&env, &mem_g, mixed, n, n, k, (voxrt_palette_method)method);
            CHECK(a.count == b.count && memcmp(a.palette, b.palette, 3 * (size_t)a.count) == 0);
            r = test_rng_make(1); /* mix the first result likewise: the same index goes with the same colour */
            for (i = n; i > 1; i--) {
                size_t j = test_rng_below(&r, (uint32_t)i);
                uint32_t x = a.index[i - 1];
                a.index[i - 1] = a.index[j];
                a.index[j] = x;
            }
            for (i = 0; i < n; i++) bad += a.index[i] != b.index[i];
            CHECK_EQ_U64(bad, 0);
            drop(&a);
            drop(&b);
            free(rgb);
            free(mixed);
        }
    }
}

/* ---- quality: Oklab against the thesis' method and against median cut ---- */

static int cut_axis;
static int compare_axis(const void *a, const void *b) {
    uint32_t x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    if ((x >> cut_axis & 255u) == (y >> cut_axis & 255u)) return x < y ? -1 : x > y;
    return (x >> cut_axis & 255u) < (y >> cut_axis & 255u) ? -1 : 1;
}

/* Sum of the error of colours[0..n) with k boxes, Heckbert 1982: split at the median of the longest side. */
static double median_cut(uint32_t *c, size_t n, uint32_t k) {
    uint32_t lo, hi, widest = 0, axis;
    size_t i, half = n / 2;
    for (axis = 0; axis < 24; axis += 8) {
        for (i = 0, lo = 255, hi = 0; i < n; i++) {
            uint32_t x = c[i] >> axis & 255u;
            lo = x < lo ? x : lo;
            hi = x > hi ? x : hi;
        }
        if (hi - lo > widest) {
            widest = hi - lo;
            cut_axis = (int)axis;
        }
    }
    if (k == 1 || n < 2 || widest == 0) {
        double mean[3] = { 0, 0, 0 }, error = 0.0;
        uint32_t m;
        for (i = 0; i < n; i++)
            for (axis = 0; axis < 3; axis++) mean[axis] += (double)(c[i] >> (8 * axis) & 255u) / (double)n;
        m = (uint32_t)(mean[0] + 0.5) | (uint32_t)(mean[1] + 0.5) << 8 | (uint32_t)(mean[2] + 0.5) << 16;
        for (i = 0; i < n; i++) error += delta_e(c[i], m);
        return error;
    }
    qsort(c, n, sizeof *c, compare_axis);
    return median_cut(c, half, k / 2) + median_cut(c + half, n - half, k - k / 2);
}

static double mean_error(const uint32_t *rgb, const palette_built *b) {
    double sum = 0.0;
    size_t i;
    for (i = 0; i < b->n; i++) sum += delta_e(rgb[i], palette_entry(b, b->index[i]));
    return sum / (double)b->n;
}

TEST(quality) {
    static const uint32_t sizes[] = { 2, 16, 127, 32767 };
    int photo, s;
    for (photo = 0; photo < 2; photo++) {
        for (s = 0; s < (test_quick() ? 3 : 4); s++) {
            size_t n = s == 3 ? 60000 : test_quick() ? 2000 : 6000;
            uint32_t *rgb = make_colors(n, photo, 11), *copy = (uint32_t *)malloc(n * sizeof(uint32_t));
            palette_built a = build(rgb, n, n, sizes[s], VOXRT_PALETTE_OKLAB);
            palette_built b = build(rgb, n, n, sizes[s], VOXRT_PALETTE_THESIS);
            double ea, eb, ec;
            REQUIRE(a.result == VOXRT_OK && b.result == VOXRT_OK);
            CHECK(a.count <= sizes[s] && a.count + 8 >= sizes[s] && b.count <= sizes[s]);
            CHECK(a.colors_in > sizes[s]);
            memcpy(copy, rgb, n * sizeof(uint32_t));
            ea = mean_error(rgb, &a);
            eb = mean_error(rgb, &b);
            ec = median_cut(copy, n, sizes[s]) / (double)n;
            if (test_g.verbose)
                printf("  %s K %u: Oklab %.5f thesis %.5f median cut %.5f\n", photo ? "photo" : "noise", sizes[s], ea,
                       eb, ec);
            CHECK_MSG(ea < eb, "photo %d K %u: Oklab %g, thesis %g", photo, sizes[s], ea, eb);
            CHECK_MSG(ea < ec, "photo %d K %u: Oklab %g, median cut %g", photo, sizes[s], ea, ec);
            drop(&a);
            drop(&b);
            free(rgb);
            free(copy);
        }
    }
}

/* More colours than points: they share cells first; and more than 65536, where counters are shared. */
TEST(many_colors) {
    size_t n = 400000, i, bad = 0;
    uint32_t *rgb, *copy;
    voxrt_env env = env_of(1);
    palette_built a, b;
    double ea = 0.0;
    if (TEST_SANITIZED) SKIP("slow under a sanitizer");
    rgb = make_colors(n, 0, 3);
    for (i = 0; i < n; i++) rgb[i] &= 0x1f3fffu;
    copy = (uint32_t *)malloc(n * sizeof(uint32_t));
    memcpy(copy, rgb, n * sizeof(uint32_t));
    a = build(rgb, n, n, 4096, VOXRT_PALETTE_OKLAB);
    b = build_with(&env, &mem_g, rgb, n, n, 4096, VOXRT_PALETTE_OKLAB);
    REQUIRE(a.result == VOXRT_OK && b.result == VOXRT_OK);
    CHECK(a.count <= 4096 && a.count > 4080 && a.colors_in > 262144);
    CHECK(a.count == b.count && memcmp(a.palette, b.palette, 3 * (size_t)a.count) == 0);
    CHECK(memcmp(a.index, b.index, n * sizeof(uint32_t)) == 0);
    for (i = 0; i < n; i++) bad += a.index[i] >= a.count;
    CHECK_EQ_U64(bad, 0);
    for (i = 0; i < n; i += 10) ea += delta_e(rgb[i], palette_entry(&a, a.index[i]));
    ea /= (double)(n / 10);
    CHECK(ea < median_cut(copy, n / 4, 4096) / (double)(n / 4)); /* a part of the colours is easier */
    drop(&a);
    drop(&b);
    free(rgb);
    free(copy);
}

TEST(allocation_failures) {
    int setup;
    for (setup = 0; setup < 6; setup++) { /* lossless, Oklab in rounds, thesis in rounds, room for LOD, more than are hashed, none */
        size_t n = setup == 2 ? 24000 : setup == 4 ? VOXRTI_CSET_HASHED + 1u : setup == 5 ? 0 : 6000;
        uint32_t *rgb = make_colors(n, 0, 8);
        uint32_t k = setup == 0 ? 6000u : setup == 1 ? 4000u : setup == 2 ? 23000u : setup == 4 ? (uint32_t)n : 5500u, i;
        int64_t f;
        test_alloc ta;
        for (i = 0; i < n && setup == 4; i++) rgb[i] = i * 251u & 0xffffffu; /* all differ */
        test_alloc_init(&ta);
        for (f = 0; f < 1000; f++) {
            voxrti_mem mem;
            voxrt_env env = env_of(1);
            palette_built b;
            ta.count = 0;
            ta.fail_at = f;
            env.allocator.alloc_fn = test_alloc_fn;
            env.allocator.free_fn = test_free_fn;
            env.allocator.user = &ta;
            REQUIRE(voxrti_env_open(&env, &mem) == VOXRT_OK);
            b = build_with(&env, &mem, rgb, n, setup == 3 ? 5000 : n, k,
                           setup == 2 ? VOXRT_PALETTE_THESIS : VOXRT_PALETTE_OKLAB);
            if (b.result == VOXRT_OK) {
                CHECK(b.palette != NULL && b.count <= k);
                voxrti_free(&mem, b.palette);
                free(b.index);
                break;
            }
            CHECK(b.result == VOXRT_ERR_NO_MEMORY && b.palette == NULL && b.count == 0);
            CHECK(memcmp(b.index, rgb, n * sizeof(uint32_t)) == 0);
            test_alloc_check(&ta);
            free(b.index);
        }
        CHECK(f >= (setup == 5 ? 1 : 5) && f < 1000);
        test_alloc_check(&ta);
        free(rgb);
    }
}

int main(int argc, char **argv) {
    voxrt_env env = env_of(1);
    test_begin(argc, argv);
    if (voxrti_env_open(&env, &mem_g) != VOXRT_OK) return 1;
    RUN(codec_round_trip);
    RUN(codec_size);
    RUN(codec_errors);
    RUN(codec_untrusted);
    RUN(oklab_exact);
    RUN(edges);
    RUN(lossless);
    RUN(lod_colors);
    RUN(lod_room);
    RUN(usage_counts);
    RUN(nearest);
    RUN(thesis_oracle);
    RUN(thesis_rare);
    RUN(oklab_means);
    RUN(determinism);
    RUN(quality);
    RUN(many_colors);
    RUN(allocation_failures);
    if (mem_g.used != 0) printf("leak of %lu bytes\n", (unsigned long)mem_g.used);
    return test_end() | (mem_g.used != 0);
}
