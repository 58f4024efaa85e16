/* fuzz_coded.c - any bytes as what tetcast.h and its programs take from elsewhere beside files of bricks and functions: pictures that were
   coded, changes of parameters, plotfiles of AMReX. The first byte says as which, and whether checksums are made right first, otherwise only
   they would be tested. What is accepted is the same after it was written and read. */
#define _POSIX_C_SOURCE 200809L
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"
#include "../../examples/support/amr_file.h"
#include "../../examples/support/tile_file.h"
#include <sys/stat.h>
#include <unistd.h>

enum { SIDE = 64 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(int ok) {
    if (!ok) abort();
}

static tetcast_env env_of(void) {
    tetcast_env e;
    memset(&e, 0, sizeof e);
    e.thread_count = 1;
    e.memory_limit = (size_t)1 << 26;
    return e;
}

/* A file of a coded picture; sizes that are too large for this are left out. */
static void tile(const uint8_t *p, size_t size) {
    uint8_t *rgba = NULL, *again = NULL, *coded = NULL;
    uint32_t w, h, w2, h2;
    size_t bytes;
    sup_error err;
    if (size >= SUP_TILE_HEAD && supi_tile_get(p + 12) * supi_tile_get(p + 16) > (size_t)1 << 20) return;
    if (sup_tile_decode(p, size, &rgba, &w, &h, &err)) return;
    must(sup_tile_encode(SUP_TILE_LOSSLESS, rgba, w, h, &coded, &bytes) == 0);
    must(sup_tile_decode(coded, bytes, &again, &w2, &h2, &err) == 0 && w2 == w && h2 == h && memcmp(again, rgba, (size_t)w * h * 4) == 0);
    SUP_FREE(again);
    SUP_FREE(coded);
    SUP_FREE(rgba);
}

/* The bytes behind two for the size: as a packed picture, as colour cells, and as pixels that are coded in all ways. */
static void picture(const uint8_t *p, size_t size) {
    static uint8_t out[SIDE * SIDE * 4], again[SIDE * SIDE * 4];
    const uint32_t w = 1 + p[0] % SIDE, h = 1 + p[1] % SIDE;
    const size_t pixels = (size_t)w * h;
    uint8_t *coded;
    uint32_t alpha;
    p += 2;
    size -= 2;
    if (tetcast_unpack(p, size, w, h, 0, out) == TETCAST_OK) {
        const size_t bound = tetcast_pack_bound(w, h);
        size_t bytes;
        coded = (uint8_t *)malloc(bound);
        if (coded == NULL) return;
        bytes = tetcast_pack(out, w, h, 0, coded);
        must(bytes <= bound && tetcast_unpack(coded, bytes, w, h, 0, again) == TETCAST_OK && memcmp(out, again, 4 * pixels) == 0);
        free(coded);
    }
    for (alpha = 0; alpha < 2; alpha++) {
        const size_t bytes = tetcast_ccc_size(w, h, (int)alpha);
        size_t i;
        if (bytes <= size) tetcast_ccc_decode(p, w, h, 0, (int)alpha, out);
        for (i = 0; i < 4 * pixels; i++) out[i] = size != 0 ? p[i % size] : 0;
        coded = (uint8_t *)malloc(bytes);
        if (coded == NULL) return;
        tetcast_ccc_encode(out, w, h, 0, (int)alpha, coded);
        tetcast_ccc_decode(coded, w, h, 0, (int)alpha, again);
        tetcast_ccc_encode_fitted(out, w, h, 0, (int)alpha, coded);
        tetcast_ccc_decode(coded, w, h, 0, (int)alpha, again);
        free(coded);
    }
}

static void parameters(uint8_t *p, size_t size, int right) {
    tetcast_env env = env_of();
    tetcast_params *a = NULL, *b = NULL;
    if (right && size >= TETCASTI_PARAMS_HEAD) {
        tetcasti_store_u32(p + 8, (uint32_t)size);
        tetcasti_store_u32(p + 12, tetcasti_params_sum(p + TETCASTI_PARAMS_HEAD, size - TETCASTI_PARAMS_HEAD));
    }
    if (tetcast_params_create(&env, &a) == TETCAST_OK && tetcast_params_create(&env, &b) == TETCAST_OK) {
        const tetcast_result r = tetcast_params_apply(a, p, size);
        size_t count = 0, i, k, bytes;
        const tetcast_param *list = tetcast_params_list(a, &count), *other;
        uint8_t *text;
        if (r != TETCAST_OK && r != TETCAST_ERR_NO_MEMORY) must(count == 0);
        if (size > 6) { /* one more, of bytes of the change: its name up to a zero, its numbers from the front */
            float numbers[16];
            char name[300];
            const uint64_t before = tetcast_params_changed(a, NULL);
            const size_t n = 1 + p[0] % 16u, length = size - 1 < sizeof name - 1 ? size - 1 : sizeof name - 1;
            memcpy(name, p + 1, length);
            name[length] = '\0';
            for (i = 0; i < n; i++) {
                uint8_t four[4];
                for (k = 0; k < 4; k++) four[k] = p[(4 * i + k) % size];
                memcpy(&numbers[i], four, 4);
            }
            if (tetcast_params_set(a, name, numbers, n) == TETCAST_OK) {
                const float *found;
                list = tetcast_params_list(a, &count);
                found = tetcast_params_find(list, count, name, n, NULL);
                must(found != NULL && memcmp(found, numbers, n * sizeof *found) == 0 && tetcast_params_find(list, count, name, n + 1, NULL) == NULL);
                must(tetcast_params_changed(a, NULL) <= before + 1 && tetcast_params_changed(a, name) != 0);
            } else must(name[0] == '\0' || strlen(name) > 255);
        }
        bytes = tetcast_params_changes(a, 0, NULL, 0);
        text = (uint8_t *)malloc(bytes);
        if (text != NULL) {
            must(tetcast_params_changes(a, 0, text, bytes) == bytes && tetcast_params_apply(b, text, bytes) == TETCAST_OK);
            other = tetcast_params_list(b, &k);
            must(k == count);
            for (i = 0; i < count; i++) {
                must(strcmp(list[i].name, other[i].name) == 0 && list[i].count == other[i].count);
                must(memcmp(list[i].values, other[i].values, list[i].count * sizeof(float)) == 0);
            }
        }
        free(text);
    }
    tetcast_params_destroy(a);
    tetcast_params_destroy(b);
}

static int put(const char *folder, const char *name, const uint8_t *p, size_t size) {
    char path[200];
    FILE *f;
    int ok;
    (void)snprintf(path, sizeof path, "%s/%s", folder, name);
    f = fopen(path, "wb");
    if (f == NULL) return 0;
    ok = fwrite(p, 1, size, f) == size;
    return (fclose(f) == 0) & ok;
}

/* A folder: Header, Level_0/Cell_H, Level_0/Cell_D; two 16-bit numbers say how long the first two are. */
static void plotfile(const uint8_t *p, size_t size) {
    static char folder[64];
    char inner[80];
    size_t n[2];
    sup_amr amr;
    sup_error err;
    if (size < 4) return;
    if (folder[0] == '\0') {
        (void)snprintf(folder, sizeof folder, "/tmp/fuzz_coded.%ld", (long)getpid());
        (void)mkdir(folder, 0700);
        (void)snprintf(inner, sizeof inner, "%s/Level_0", folder);
        (void)mkdir(inner, 0700);
    }
    n[0] = (size_t)p[0] | (size_t)p[1] << 8;
    n[1] = (size_t)p[2] | (size_t)p[3] << 8;
    p += 4;
    size -= 4;
    if (n[0] > size) n[0] = size;
    if (n[1] > size - n[0]) n[1] = size - n[0];
    if (!put(folder, "Header", p, n[0]) || !put(folder, "Level_0/Cell_H", p + n[0], n[1]) ||
        !put(folder, "Level_0/Cell_D", p + n[0] + n[1], size - n[0] - n[1])) return;
    if (sup_amr_read(folder, NULL, &amr, &err) == 0) {
        tetcast_amr_desc d;
        tetcast_amr *a = NULL;
        sup_amr_desc(&amr, &d);
        d.env = env_of();
        if (tetcast_amr_create(&d, &a) == TETCAST_OK) {
            double at[3][3];
            float v[3];
            int i, k;
            for (i = 0; i < 3; i++)
                for (k = 0; k < 3; k++) at[i][k] = d.origin[k] + d.spacing[k] * (double)d.cells[k] * 0.4 * i;
            for (k = 0; k < 5; k++) must(tetcast_amr_sample(a, (tetcast_amr_method)k, (const double (*)[3])at, 3, v) == TETCAST_OK);
            must(tetcast_amr_level(a, at[1]) < TETCAST_AMR_LEVELS);
        }
        tetcast_amr_destroy(a);
        sup_amr_free(&amr);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    uint8_t *copy;
    if (size < 4 || size > 1 << 16) return 0;
    copy = (uint8_t *)malloc(size - 1); /* the sanitizer knows its end */
    if (copy == NULL) return 0;
    memcpy(copy, data + 1, size - 1);
    switch (data[0] & 3) {
    case 0: tile(copy, size - 1); break;
    case 1: picture(copy, size - 1); break;
    case 2: parameters(copy, size - 1, data[0] >> 2 & 1); break;
    default: plotfile(copy, size - 1); break;
    }
    free(copy);
    return 0;
}
