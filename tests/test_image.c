/* Pictures and textures of the programs: every kind of PNG against what was packed, PPM and PGM; damaged and hostile
   files; inflate against a slow one; mip maps, normal and bump maps, displacement; materials of OBJ files. */
#include "support_memory.h"
#include "../examples/support/displace.h"
#include "../examples/support/finish.h"
#include "../examples/support/scenes.h"
#include "png_read.h"

/* ---- PNG files made here -------------------------------------------------------------------------------------- */

typedef struct bytes { uint8_t *p; size_t n, room; } bytes;

static void put(bytes *b, const void *p, size_t n) {
    if (b->n + n > b->room) {
        b->room = 2 * (b->n + n);
        b->p = (uint8_t *)realloc(b->p, b->room);
    }
    if (n != 0) memcpy(b->p + b->n, p, n);
    b->n += n;
}
static void put32(bytes *b, uint32_t v) {
    uint8_t p[4];
    supi_big32(p, v);
    put(b, p, 4);
}
static void chunk(bytes *b, const char *type, const void *data, size_t n) {
    const size_t at = b->n + 4;
    put32(b, (uint32_t)n);
    put(b, type, 4);
    put(b, data, n);
    put32(b, png_crc(b->p + at, n + 4));
}

typedef struct kind { uint32_t width, height, bits, type; int interlaced; } kind;

static uint32_t samples_of(const kind *k) { return k->type == 0 || k->type == 3 ? 1 : k->type == 2 ? 3 : k->type == 4 ? 2 : 4; }
static uint32_t value_at(const kind *k, uint32_t x, uint32_t y, uint32_t s) { /* what the pixel holds in the file */
    const uint32_t h = (x * 73856093u ^ y * 19349663u ^ s * 83492791u) * 2654435761u;
    return (h >> 12) & ((1u << k->bits) - 1u);
}

/* Rows of one pass, with filter 0 to 4 in turn; filters are undone by the reader, so they are done here, slowly. */
static void put_rows(bytes *raw, const kind *k, uint32_t x0, uint32_t dx, uint32_t y0, uint32_t dy) {
    const uint32_t w = k->width > x0 ? (k->width - x0 + dx - 1) / dx : 0, n = samples_of(k);
    const size_t row = ((size_t)w * n * k->bits + 7) / 8, step = (n * k->bits + 7) / 8;
    uint8_t *now = (uint8_t *)calloc(row + 1, 1), *before = (uint8_t *)calloc(row + 1, 1);
    uint32_t x, y, s, filter = 0;
    size_t i;
    for (y = y0; w != 0 && y < k->height; y += dy, filter = (filter + 1) % 5) {
        uint8_t *swap, f = (uint8_t)filter;
        memset(now, 0, row);
        for (x = 0; x < w; x++) {
            for (s = 0; s < n; s++) {
                const uint32_t v = value_at(k, x0 + x * dx, y, s);
                const size_t bit = ((size_t)x * n + s) * k->bits;
                if (k->bits == 16) {
                    now[bit / 8] = (uint8_t)(v >> 8);
                    now[bit / 8 + 1] = (uint8_t)v;
                } else {
                    now[bit / 8] = (uint8_t)(now[bit / 8] | v << (8 - k->bits - bit % 8));
                }
            }
        }
        put(raw, &f, 1);
        for (i = 0; i < row; i++) {
            const int a = i >= step ? now[i - step] : 0, b = before[i], c = i >= step ? before[i - step] : 0;
            const int p = a + b - c, pa = abs(p - a), pb = abs(p - b), pc = abs(p - c);
            const uint8_t v = (uint8_t)(now[i] - (f == 0 ? 0 : f == 1 ? a : f == 2 ? b : f == 3 ? (a + b) / 2 : pa <= pb && pa <= pc ? a : pb <= pc ? b : c));
            put(raw, &v, 1);
        }
        swap = now;
        now = before;
        before = swap;
    }
    free(now);
    free(before);
}

static void zip(bytes *out, const bytes *raw) { /* stored blocks */
    static const uint8_t head[2] = {0x78, 0x01};
    size_t at = 0;
    uint32_t a = 1, b = 0;
    put(out, head, 2);
    do {
        const size_t n = raw->n - at < 60000 ? raw->n - at : 60000;
        uint8_t p[5] = {(uint8_t)(at + n == raw->n), (uint8_t)n, (uint8_t)(n >> 8), (uint8_t)~n, (uint8_t)(~n >> 8)};
        put(out, p, 5);
        put(out, raw->p + at, n);
        at += n;
    } while (at < raw->n);
    for (at = 0; at < raw->n; at++) {
        a = (a + raw->p[at]) % 65521;
        b = (b + a) % 65521;
    }
    put32(out, b << 16 | a);
}

/* palette entry i is (i, 255 - i, 3 i), its alpha 7 i; the transparent colour is that of pixel (0, 0) */
static bytes make_png(const kind *k, int key) {
    static const uint8_t x0[7] = {0, 4, 0, 2, 0, 1, 0}, dx[7] = {8, 8, 4, 4, 2, 2, 1}, y0[7] = {0, 0, 4, 0, 2, 0, 1}, dy[7] = {8, 8, 8, 4, 4, 2, 2};
    bytes out = {0}, raw = {0}, packed = {0};
    uint8_t head[13], palette[768], alpha[256];
    uint32_t i;
    put(&out, "\x89PNG\r\n\x1a\n", 8);
    supi_big32(head, k->width);
    supi_big32(head + 4, k->height);
    head[8] = (uint8_t)k->bits;
    head[9] = (uint8_t)k->type;
    head[10] = head[11] = 0;
    head[12] = (uint8_t)k->interlaced;
    chunk(&out, "IHDR", head, 13);
    chunk(&out, "tEXt", "a\0b", 3);
    for (i = 0; i < 256; i++) {
        palette[3 * i] = (uint8_t)i;
        palette[3 * i + 1] = (uint8_t)(255 - i);
        palette[3 * i + 2] = (uint8_t)(3 * i);
        alpha[i] = (uint8_t)(7 * i);
    }
    if (k->type == 3) chunk(&out, "PLTE", palette, 3u << k->bits);
    if (key && k->type == 3) chunk(&out, "tRNS", alpha, (size_t)1 << k->bits);
    if (key && k->type != 3) {
        uint8_t t[6];
        for (i = 0; i < samples_of(k); i++) {
            t[2 * i] = (uint8_t)(value_at(k, 0, 0, i) >> 8);
            t[2 * i + 1] = (uint8_t)value_at(k, 0, 0, i);
        }
        chunk(&out, "tRNS", t, 2 * samples_of(k));
    }
    for (i = 0; i < 7 && k->interlaced; i++) put_rows(&raw, k, x0[i], dx[i], y0[i], dy[i]);
    if (!k->interlaced) put_rows(&raw, k, 0, 1, 0, 1);
    zip(&packed, &raw);
    chunk(&out, "IDAT", packed.p, packed.n / 2);
    chunk(&out, "IDAT", packed.p + packed.n / 2, packed.n - packed.n / 2);
    chunk(&out, "IEND", NULL, 0);
    free(raw.p);
    free(packed.p);
    return out;
}

TEST(png_of_every_kind) {
    static const uint8_t bits[5] = {1, 2, 4, 8, 16}, types[5] = {0, 2, 3, 4, 6};
    static const uint32_t sides[5][2] = {{1, 1}, {7, 5}, {33, 9}, {2, 3}, {4, 1}};
    uint32_t b, t, s, x, y, c, files = 0;
    int interlaced, key;
    for (b = 0; b < 5; b++) for (t = 0; t < 5; t++) for (s = 0; s < 5; s++) for (interlaced = 0; interlaced < 2; interlaced++) for (key = 0; key < 2; key++) {
        kind k = {sides[s][0], sides[s][1], bits[b], types[t], interlaced};
        const uint32_t n = samples_of(&k), most = (1u << k.bits) - 1u;
        bytes file;
        sup_image got;
        sup_error err;
        if ((k.bits < 8 && t != 0 && t != 2) || (k.bits == 16 && t == 2) || (key && t > 2)) continue;
        file = make_png(&k, key);
        CHECK_MSG(!sup_image_decode(file.p, file.n, "x.png", &got, &err), "%s: %u bits, type %u", err.text, k.bits, k.type);
        free(file.p);
        if (got.pixels == NULL) continue;
        CHECK(got.width == k.width && got.height == k.height && got.bits == k.bits);
        CHECK_EQ_U64(got.channels, (k.type == 3 ? 3u : n) + (key ? 1u : 0u));
        for (y = 0; y < k.height; y++) {
            for (x = 0; x < k.width; x++) {
                const uint16_t *p = got.pixels + ((size_t)y * k.width + x) * got.channels;
                uint32_t match = 1, v = value_at(&k, x, y, 0);
                if (k.type == 3) {
                    CHECK(p[0] == 257 * v && p[1] == 257 * (255 - v) && p[2] == 257 * (3 * v & 255));
                    if (key) CHECK(p[3] == 257 * (7 * v & 255));
                    continue;
                }
                for (c = 0; c < n; c++) {
                    v = value_at(&k, x, y, c);
                    match &= v == value_at(&k, 0, 0, c);
                    CHECK(p[c] == (uint16_t)((uint64_t)v * 65535 / most));
                }
                if (key) CHECK(p[n] == (match ? 0 : 65535));
            }
        }
        files++;
        sup_image_free(&got);
    }
    CHECK_MSG(files > 150, "%u files", files);
    CHECK_EQ_I64(g_memory.live, 0);
}

/* What our writer makes comes back, with all its kinds of blocks. */
TEST(png_round_trip) {
    uint32_t k, i;
    for (k = 0; k < 40; k++) {
        const uint32_t w = 1 + k * 7 % 90, h = 1 + k * 13 % 70, channels = 1 + k % 4, wide = k / 4 % 2, n = w * h * channels;
        uint16_t *pixels = (uint16_t *)calloc(n, 2);
        uint8_t *narrow = (uint8_t *)calloc(n, 1), *file = NULL;
        size_t size = 0;
        sup_picture p;
        sup_image got;
        sup_error err;
        for (i = 0; i < n; i++) {
            pixels[i] = (uint16_t)(k % 3 == 0 ? i * 40503u >> 3 : k % 3 == 1 ? i / 7 * 257 : i % 5);
            narrow[i] = (uint8_t)pixels[i];
        }
        memset(&p, 0, sizeof p);
        p.pixels = wide ? (const void *)pixels : (const void *)narrow;
        p.width = w;
        p.height = h;
        p.channels = channels;
        p.bits = wide ? 16 : 8;
        REQUIRE(!sup_png_encode(&p, &file, &size, &err));
        CHECK_MSG(!sup_png_decode(file, size, "x", &got, &err), "%s", err.text);
        CHECK(got.width == w && got.height == h && got.channels == channels);
        for (i = 0; got.pixels != NULL && i < n; i++) CHECK(got.pixels[i] == (wide ? pixels[i] : (uint16_t)(257 * narrow[i])));
        sup_image_free(&got);
        SUP_FREE(file);
        free(pixels);
        free(narrow);
    }
    CHECK_EQ_I64(g_memory.live, 0);
}

/* Streams of all kinds of blocks, also damaged ones: what the slow reader takes this one takes, with the same bytes. */
TEST(inflate_against_a_slow_one) {
    static uint8_t raw[20000], want[20000], got[20000], stream[40000];
    uint32_t k, i, kinds[3] = {0, 0, 0}, good = 0, seed = 3;
    for (k = 0; k < (test_quick() ? 300u : 3000u); k++) {
        sup_picture p;
        uint8_t *file = NULL;
        size_t size = 0, n = 0, at = 8;
        const uint32_t w = 10 + k % 60, h = 5 + k % 37;
        sup_error err;
        supi_inflate state;
        int slow, fast;
        for (i = 0; i < w * h; i++) {
            seed = seed * 1664525u + 1013904223u;
            raw[i] = (uint8_t)(k % 5 == 0 ? seed >> 24 : k % 5 == 1 ? i / 9 : k % 5 == 2 ? (seed >> 24) % 3 : k % 5 == 3 ? i % w : 0);
        }
        memset(&p, 0, sizeof p);
        p.pixels = raw;
        p.width = w;
        p.height = h;
        p.channels = 1;
        p.bits = 8;
        REQUIRE(!sup_png_encode(&p, &file, &size, &err));
        while (at + 12 <= size) {
            const uint32_t length = png_big32(file + at);
            if (memcmp(file + at + 4, "IDAT", 4) == 0) {
                memcpy(stream + n, file + at + 8, length);
                n += length;
            }
            at += 12 + (size_t)length;
        }
        SUP_FREE(file);
        if (k % 2) { /* damage, but for the sum at the end */
            seed = seed * 1664525u + 1013904223u;
            stream[2 + (seed >> 8) % (n - 6)] ^= (uint8_t)(1u << (seed >> 28) % 8);
        }
        slow = png_inflate(stream, n, want, (size_t)(w + 1) * h, kinds);
        fast = supi_unzip(&state, stream, n, got, (size_t)(w + 1) * h);
        CHECK_MSG(slow != 0 || (fast == 0 && memcmp(want, got, (size_t)(w + 1) * h) == 0), "stream %u", k);
        CHECK(k % 2 || fast == 0);
        good += fast == 0;
    }
    CHECK(kinds[0] > 5 && kinds[1] > 5 && kinds[2] > 5);
    CHECK_MSG(good < k, "damage is never seen");
}

TEST(pnm) {
    static const struct { const char *text; size_t n; uint32_t w, h, c; uint16_t last; } good[] = {
        {"P2 # a comment\n2 1\n#more\n3 0 2", 30, 2, 1, 1, 43690}, {"P5 2 1 255 \x01\xff", 13, 2, 1, 1, 65535},
        {"P6\n1 1\n65535\n\x01\x02\x03\x04\x05\x06", 19, 1, 1, 3, 0x506}, {"P3 1 1 255 1 2 51", 17, 1, 1, 3, 13107}};
    static const char *bad[] = {"P2", "P2 2", "P2 0 1 3 0", "P2 2 1 3 0", "P2 2 1 3 0 4", "P2 1 1 0 0", "P2 1 1 70000 0", "P7 1 1 3 0", "P5 2 2 255 abc",
                                "P2 65536 65536 3 0", "P2 -1 1 3 0", "P2 99999999999999999999 1 3 0", "P6 1 1 65535 abcde", "P3 1 1 255 1 2 x"};
    size_t i;
    sup_image got;
    sup_error err;
    for (i = 0; i < sizeof good / sizeof *good; i++) {
        CHECK_MSG(!sup_image_decode(good[i].text, good[i].n, "x", &got, &err), "%s", err.text);
        REQUIRE(got.pixels != NULL);
        CHECK(got.width == good[i].w && got.height == good[i].h && got.channels == good[i].c);
        CHECK_EQ_U64(got.pixels[got.width * got.height * got.channels - 1], good[i].last);
        sup_image_free(&got);
    }
    for (i = 0; i < sizeof bad / sizeof *bad; i++)
        CHECK_MSG(sup_image_decode(bad[i], strlen(bad[i]), "x", &got, &err) && got.pixels == NULL && err.text[0], "%s", bad[i]);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(hostile_png) {
    kind k = {20, 11, 4, 3, 1};
    bytes file = make_png(&k, 1);
    uint8_t *copy = (uint8_t *)malloc(file.n);
    size_t i, n, at;
    uint32_t b, taken = 0;
    sup_image got;
    sup_error err;
    for (n = 0; n < file.n; n++) { /* cut off; nothing is read behind the end */
        uint8_t *part = (uint8_t *)malloc(n + (n == 0));
        memcpy(part, file.p, n);
        CHECK(sup_image_decode(part, n, "x", &got, &err) && got.pixels == NULL);
        free(part);
    }
    for (i = 0; i < file.n; i++) { /* any change, with and without sums that fit */
        for (b = 0; b < 16; b++) {
            memcpy(copy, file.p, file.n);
            copy[i] ^= (uint8_t)(1u << (b & 7));
            for (at = 8; b > 7 && file.n - at >= 12; at += 12 + (size_t)png_big32(copy + at)) {
                const uint32_t length = png_big32(copy + at);
                if (length > file.n - at - 12) break;
                supi_big32(copy + at + 8 + length, png_crc(copy + at + 4, length + 4));
            }
            if (sup_image_decode(copy, file.n, "x", &got, &err)) continue;
            taken++;
            sup_image_free(&got);
        }
    }
    CHECK_MSG(taken > 100, "%u", taken); /* palettes, texts */
    for (n = 0; n < 12; n++) { /* memory runs out */
        memory_reset((int64_t)n);
        if (!sup_image_decode(file.p, file.n, "x", &got, &err)) break;
        CHECK(got.pixels == NULL);
    }
    memory_reset(-1);
    CHECK(n > 2 && n < 12);
    sup_image_free(&got);
    k.width = k.height = 60000; /* a small file must not ask for much */
    k.interlaced = 0;
    free(file.p);
    k.width = 20;
    k.height = 11;
    file = make_png(&k, 0);
    supi_big32(file.p + 16, 60000);
    supi_big32(file.p + 20, 60000);
    supi_big32(file.p + 29, png_crc(file.p + 12, 17));
    memory_reset(-1);
    CHECK(sup_image_decode(file.p, file.n, "x", &got, &err) == 1);
    CHECK_MSG(strstr(err.text, "cut off") != NULL, "%s", err.text);
    free(file.p);
    free(copy);
    CHECK_EQ_I64(g_memory.live, 0);
}

/* ---- textures ------------------------------------------------------------------------------------------------- */

TEST(textures_at_a_size) {
    enum { W = 64, H = 32 };
    static uint16_t pixels[W * H * 3];
    sup_image image;
    sup_texture t;
    double c[3], sum = 0;
    uint32_t x, y;
    memset(&image, 0, sizeof image);
    image.pixels = pixels;
    image.width = W;
    image.height = H;
    image.channels = 3;
    for (y = 0; y < H; y++) {
        for (x = 0; x < W; x++) {
            pixels[3 * (y * W + x)] = (uint16_t)(x * 1000);
            pixels[3 * (y * W + x) + 1] = (uint16_t)(y * 2000);
            pixels[3 * (y * W + x) + 2] = (x ^ y) & 1 ? 65535 : 0;
        }
    }
    REQUIRE(!sup_texture_make(&image, 0, &t));
    CHECK(t.level_count == 7 && t.width[6] == 1 && t.height[6] == 1);
    for (y = 0; y < H; y++) { /* centres of pixels; v goes up */
        for (x = 0; x < W; x++) {
            sup_texture_look(&t, (x + 0.5) / W, 1 - (y + 0.5) / H, 0, 0, c);
            CHECK_NEAR(c[0], x * 1000 / 65535.0, 1e-9);
            CHECK_NEAR(c[1], y * 2000 / 65535.0, 1e-9);
        }
    }
    sup_texture_look(&t, 10.0 / W, 0.5, 0, 0, c); /* between two of them */
    CHECK_NEAR(c[0], 9.5 * 1000 / 65535.0, 1e-9);
    sup_texture_look(&t, 10.5 / W + 3, 0.5 - 7, 0, 0, c); /* repeats */
    CHECK_NEAR(c[0], 10 * 1000 / 65535.0, 1e-6);
    sup_texture_look(&t, 3, 0.5, 0, 1, c); /* or not */
    CHECK_NEAR(c[0], 63 * 1000 / 65535.0, 1e-9);
    for (x = 0; x < 50; x++) { /* at the size of some pixels a chessboard is gray */
        sup_texture_look(&t, x * 0.0137, x * 0.031, 2 + x * 0.1, 0, c);
        CHECK_NEAR(c[2], 0.5, 1e-4);
    }
    sup_texture_look(&t, 0.3, 0.3, 1e9, 0, c);
    for (x = 0; x < W; x++) sum += x * 1000 / 65535.0 / W;
    CHECK_NEAR(c[0], sum, 1e-4);
    sup_texture_look(&t, (double)NAN, (double)INFINITY, (double)NAN, 0, c);
    CHECK(c[0] >= 0 && c[0] <= 1);
    sup_texture_free(&t);
    REQUIRE(!sup_texture_make(&image, 1, &t)); /* sRGB becomes linear before it is averaged */
    sup_texture_look(&t, 12.5 / W, 0.5, 0, 0, c);
    CHECK_NEAR(c[0], pow((12000 / 65535.0 + 0.055) / 1.055, 2.4), 2e-5);
    sup_texture_free(&t);
    CHECK_EQ_I64(g_memory.live, 0);
}

typedef struct file { const char *name; const void *data; size_t size; } file;

static int open_files(void *user, const char *name, char **data, size_t *size) {
    const file *f = (const file *)user;
    for (; f->name != NULL; f++) {
        if (strcmp(f->name, name) != 0) continue;
        *data = (char *)SUP_MALLOC(f->size + 1);
        if (*data == NULL) return 1;
        memcpy(*data, f->data, f->size);
        *size = f->size;
        return 0;
    }
    return 1;
}

static const char obj_text[] = "mtllib a.mtl\nv 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
                               "usemtl wood\nf 1/1/1 2/2/1 3/3/1 4/4/1\nusemtl glass\nf 1//1 2//1 3//1\nusemtl none\nf 1/9/1 2/-1/1 3/0/1\n";
static const char mtl_text[] = "newmtl wood\nKd 0.5 0.5 0.5\nKs 0.25\nNs 40\nillum 3\nmap_Kd -s 2 3 1 -o 0.5 0 0 -clamp on a file.pgm\n"
                               "map_Bump -bm 0.1 h.pgm\ndisp -mm 0.1 2 -bm 0.25 h.pgm\nKe 1 2 3\nnewmtl glass\nd 0.25\nTf 0.5 0.75 2\nNi 1.5\nillum 7\n"
                               "norm n.ppm\nKs nan -1 x\nNs bad\nTr\n";

TEST(materials_of_obj_files) {
    file files[] = {{"a.mtl", mtl_text, sizeof mtl_text - 1}, {NULL, NULL, 0}};
    sup_mesh m;
    sup_error err;
    const sup_material *w, *g;
    int64_t k;
    REQUIRE(!sup_mesh_read_memory(obj_text, sizeof obj_text - 1, SUP_FORMAT_OBJ, "x.obj", open_files, files, &m, &err));
    REQUIRE(m.material_count == 3 && m.triangle_count == 4 && m.texcoords != NULL && m.triangle_material != NULL);
    w = m.materials;
    g = m.materials + 1;
    CHECK(m.triangle_material[0] == 1 && m.triangle_material[1] == 1 && m.triangle_material[2] == 2 && m.triangle_material[3] == 3);
    CHECK(w->illum == 3 && w->shininess == 40 && w->specular[1] == 0.25f && w->emission[2] == 3 && w->opacity == 1 && !w->has_opacity);
    CHECK_STR(w->color_map.name, "a file.pgm");
    CHECK(w->color_map.scale[0] == 2 && w->color_map.scale[1] == 3 && w->color_map.offset[0] == 0.5f && w->color_map.clamp);
    CHECK_STR(w->bump_map.name, "h.pgm");
    CHECK(w->bump_map.strength == 0.1f && !w->bump_map.is_normal);
    CHECK(w->displace_map.base == 0.1f && w->displace_map.strength == 0.25f); /* -bm is the last word */
    CHECK(g->opacity == 0.25f && g->has_opacity && g->transmit[0] == 0.5f && g->transmit[2] == 1 && g->ni == 1.5f && g->illum == 7);
    CHECK(g->bump_map.is_normal && g->specular[0] == 0 && g->shininess == 0);
    CHECK(m.materials[2].opacity == 1 && m.materials[2].illum == -1);
    for (k = 0; k < 6; k++) { /* a corner's coordinates are those that stand beside its place */
        const float *p = m.positions + 3 * m.indices[k], *uv = m.texcoords + 2 * k;
        CHECK(uv[0] == p[0] / 2 && uv[1] == p[1] / 2);
    }
    CHECK(m.texcoords[18] == 0 && m.texcoords[20] == 0 && m.texcoords[21] == 1 && m.texcoords[22] == 0); /* not there, the last, none */
    sup_mesh_free(&m);
    for (k = 0; k < 200; k++) {
        int failed;
        memory_reset(k);
        failed = sup_mesh_read_memory(obj_text, sizeof obj_text - 1, SUP_FORMAT_OBJ, "x.obj", open_files, files, &m, &err);
        if (!failed) sup_mesh_free(&m); /* a library that cannot be read is a warning */
        CHECK_EQ_I64(g_memory.live, 0);
        if (g_memory.count <= k) break;
    }
    memory_reset(-1);
    CHECK(k > 20 && k < 200);
}

/* What is written for opaque things by programs that turn transparency round must not vanish. */
TEST(finishes_of_materials) {
    static const struct { const char *mtl; int any; float through, index, mirror; } cases[] = {
        {"Kd 1 1 1\nillum 2\n", 0, 0, 0, 0},
        {"Ks 0.5\nNs 20\n", 1, 0, 0, 0},
        {"Ks 0.5\nillum 1\n", 0, 0, 0, 0},
        {"Ks 3 0.5 0\nillum 3\n", 1, 0, 0, 1},
        {"d 0.25\n", 1, 0.75f, 0, 0},
        {"Tr 0.25\nillum 4\nNi 1.5\n", 1, 0.25f, 1.5f, 0},
        {"Tf 0.5\nillum 7\nNi 1.5\n", 1, 0.5f, 1.5f, 0},
        {"Tf 1\nillum 6\nNi 1.3\n", 1, 1, 1.3f, 0},
        {"illum 6\nNi 1.3\n", 0, 0, 1.3f, 0},
        {"illum 4\nKd 0.5 0.5 0.5\nKa 0 0 0\nTf 1.00 1.00 1.00\nNi 1.00\n", 0, 0, 0, 0},
        {"illum 4\nTf 1 1 1\nNi 1.00\nKs 0.5\nNs 18\n", 1, 0, 0, 0},
        {"Tr 1\nillum 2\nNs 0\n", 0, 0, 0, 0},
        {"Tr 1\nTf 1 0.5 1\n", 1, 1, 0, 0}, /* a colour can be seen */
        {"Tr 1\nKe 0 0 1\n", 1, 1, 0, 0},
        {"d 0.5\nillum 9\nNi 0.01\n", 1, 0.5f, 0, 0},
    };
    static const char text[] = "mtllib a.mtl\nusemtl x\nv 0 0 0\nv 4 0 0\nv 4 4 0\nf 1 2 3\n";
    size_t i;
    for (i = 0; i < sizeof cases / sizeof *cases; i++) {
        char mtl[200];
        file files[] = {{"a.mtl", mtl, 0}, {NULL, NULL, 0}};
        sup_mesh m;
        sup_error err;
        voxrt_finish f;
        files[0].size = (size_t)snprintf(mtl, sizeof mtl, "newmtl x\nKd 1 1 1\nKe 0\nmap_Kd none\n%s", cases[i].mtl);
        REQUIRE(!sup_mesh_read_memory(text, sizeof text - 1, SUP_FORMAT_OBJ, "x.obj", open_files, files, &m, &err) && m.material_count == 1);
        CHECK_MSG(sup_finish_of(m.materials, &f) == cases[i].any, "material %lu", (unsigned long)i);
        CHECK_MSG(f.transparency[0] == cases[i].through && f.refraction == cases[i].index && f.mirror[0] == cases[i].mirror, "material %lu",
                  (unsigned long)i);
        sup_mesh_free(&m);
    }
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(concave_polygons_keep_their_coordinates) {
    static const char text[] = "mtllib a.mtl\nusemtl wood\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\n"
                               "vt 0 0\nvt 4 0\nvt 4 4\nvt 2 1\nvt 0 4\nf 1/1 2/2 3/3 4/4 5/5\n";
    file files[] = {{"a.mtl", mtl_text, sizeof mtl_text - 1}, {NULL, NULL, 0}};
    sup_mesh m;
    sup_error err;
    size_t k;
    REQUIRE(!sup_mesh_read_memory(text, sizeof text - 1, SUP_FORMAT_OBJ, "x.obj", open_files, files, &m, &err));
    CHECK(m.triangle_count == 3);
    for (k = 0; k < 9; k++) CHECK(m.texcoords[2 * k] == m.positions[3 * m.indices[k]] && m.texcoords[2 * k + 1] == m.positions[3 * m.indices[k] + 1]);
    sup_mesh_free(&m);
}

/* A height that rises along u by 1 over the picture: bumps tilt normals by that slope, displacement moves by it. */
TEST(bumps_and_displacement) {
    static const char text[] = "mtllib b.mtl\nusemtl hill\nv 0 0 0\nv 8 0 0\nv 8 4 0\nv 0 4 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";
    static const char mtl[] = "newmtl hill\nmap_Bump -clamp on -bm 2 ramp.pgm\ndisp -clamp on -bm 2 ramp.pgm\n";
    static const char tilted[] = "newmtl hill\nnorm n.ppm\n";
    static uint8_t ramp[32 + 256 * 4], normals[32 + 3];
    file files[5] = {{"b.mtl", mtl, sizeof mtl - 1}, {"ramp.pgm", ramp, 0}, {"n.ppm", normals, 0}, {NULL, NULL, 0}, {NULL, NULL, 0}};
    const float middle[3] = {0.25f, 0.25f, 0.5f};
    float color[3] = {1, 1, 1}, normal[3] = {0, 0, 1};
    sup_mesh m, cut;
    sup_textured t;
    sup_error err;
    size_t i, n = (size_t)snprintf((char *)ramp, 32, "P5 256 4 255\n");
    for (i = 0; i < 1024; i++) ramp[n + i] = (uint8_t)(i % 256);
    files[1].size = n + 1024;
    n = (size_t)snprintf((char *)normals, 32, "P6 1 1 255\n");
    normals[n] = 204; /* x = 0.6, z = 0.8 */
    normals[n + 1] = 128;
    normals[n + 2] = 230;
    files[2].size = n + 3;
    REQUIRE(!sup_mesh_read_memory(text, sizeof text - 1, SUP_FORMAT_OBJ, "x.obj", open_files, files, &m, &err));
    REQUIRE(!sup_textured_open(&m, open_files, files, &t, &err));
    CHECK(t.texture_count == 1 && t.skipped == 0 && sup_textured_any(&t)); /* both maps are one picture */
    sup_textured_sample(&t, 0, middle, 0.25f, color, normal);
    CHECK(color[0] == 1); /* slope 2 / 8 */
    CHECK_NEAR(normal[0], -0.25 / sqrt(1 + 0.0625), 0.01);
    CHECK_NEAR(normal[2], 1 / sqrt(1 + 0.0625), 0.01);
    REQUIRE(!sup_mesh_displace(&t, 0.25, 0, &cut, &err));
    CHECK(cut.triangle_count == 2 * 36 * 36); /* 8.94 / 0.25 */
    for (i = 0; i < cut.vertex_count; i++) {
        const float *p = cut.positions + 3 * i;
        CHECK_NEAR(p[2], 2 * p[0] / 8, 0.03);
        if (p[0] > 0.5f && p[0] < 7.5f) CHECK_NEAR(cut.normals[3 * i], -0.25 / sqrt(1 + 0.0625), 0.02);
    }
    for (i = 0; i < 3 * cut.triangle_count; i++) CHECK_NEAR(cut.texcoords[2 * i], cut.positions[3 * (size_t)cut.indices[i]] / 8, 1e-5);
    sup_mesh_free(&cut);
    CHECK(sup_mesh_displace(&t, 0.25, 1000, &cut, &err) == 1 && cut.positions == NULL && err.text[0]);
    CHECK(sup_mesh_displace(&t, 1e-300, 0, &cut, &err) == 1 && sup_mesh_displace(&t, 0, 0, &cut, &err) == 1);
    CHECK(sup_mesh_displace(&t, (double)NAN, 0, &cut, &err) == 1);
    m.positions[0] = INFINITY; /* of both triangles: they stay whole */
    REQUIRE(!sup_mesh_displace(&t, 0.25, 0, &cut, &err));
    CHECK(cut.triangle_count == 2);
    sup_mesh_free(&cut);
    m.positions[0] = 0;
    sup_textured_free(&t);
    sup_mesh_free(&m);

    files[0].data = tilted;
    files[0].size = sizeof tilted - 1;
    REQUIRE(!sup_mesh_read_memory(text, sizeof text - 1, SUP_FORMAT_OBJ, "x.obj", open_files, files, &m, &err));
    REQUIRE(!sup_textured_open(&m, open_files, files, &t, &err));
    normal[0] = normal[1] = 0;
    normal[2] = 1;
    sup_textured_sample(&t, 1, middle, 0.25f, color, normal);
    CHECK_NEAR(normal[0], 0.6, 0.01);
    CHECK_NEAR(normal[1], 0, 0.01);
    CHECK_NEAR(normal[2], 0.8, 0.01);
    sup_textured_free(&t);
    files[2].name = "other";
    REQUIRE(!sup_textured_open(&m, open_files, files, &t, &err)); /* missing pictures are a warning */
    CHECK(t.skipped == 1 && strstr(err.text, "n.ppm") != NULL && !sup_textured_any(&t));
    sup_textured_free(&t);
    sup_mesh_free(&m);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(scene_of_balls) {
    sup_mesh m;
    sup_textured t;
    sup_error err;
    REQUIRE(!sup_scene_make("balls", 8, &m));
    CHECK(m.material_count == 7 && m.normals != NULL);
    REQUIRE(!sup_textured_open(&m, sup_scene_open, NULL, &t, &err));
    CHECK(t.texture_count == 3 && t.skipped == 0);
    sup_textured_free(&t);
    sup_mesh_free(&m);
    CHECK_EQ_I64(g_memory.live, 0);
}

int main(int argc, char **argv) {
    memory_reset(-1);
    test_begin(argc, argv);
    RUN(png_of_every_kind);
    RUN(png_round_trip);
    RUN(inflate_against_a_slow_one);
    RUN(pnm);
    RUN(hostile_png);
    RUN(textures_at_a_size);
    RUN(materials_of_obj_files);
    RUN(finishes_of_materials);
    RUN(concave_polygons_keep_their_coordinates);
    RUN(bumps_and_displacement);
    RUN(scene_of_balls);
    return test_end();
}
