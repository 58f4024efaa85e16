/* fuzz_rbf.c - any bytes as a file of radial basis functions. What is accepted is asked, drawn, and is the same after it was
   saved and loaded. The checksum is made right first, otherwise only it would be tested. */
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    uint8_t *copy = (uint8_t *)malloc(size + 1), *again;
    tetcast_env env;
    tetcast_rbf *m = NULL, *n = NULL;
    tetcast_rbf_info info;
    double p[3 * 9];
    float v[4 * 9], j[12 * 9];
    size_t bytes = 0, i;
    if (copy == NULL) return 0;
    if (size != 0) memcpy(copy, data, size);
    if (size >= TETCASTI_RBF_HEADER) {
        tetcasti_store_u64(copy + 16, size);
        tetcasti_store_u64(copy + 24, tetcasti_rbf_checksum(copy, size));
    }
    memset(&env, 0, sizeof env);
    env.memory_limit = (size_t)1 << 26;
    env.thread_count = 1;
    if (tetcast_rbf_load_memory(&env, copy, size, &m) == TETCAST_OK) {
        tetcast_rbf_get_info(m, &info);
        for (i = 0; i < 27; i++) p[i] = info.box_min[i % 3] + (info.box_max[i % 3] - info.box_min[i % 3]) * (double)(i % 7) / 5.0;
        if (tetcast_rbf_eval(NULL, m, p, 9, v, j) != TETCAST_OK) abort();
        if (tetcast_rbf_save_memory(m, NULL, 0, &bytes) != TETCAST_OK || bytes != size) abort();
        again = (uint8_t *)malloc(bytes);
        if (again != NULL) {
            if (tetcast_rbf_save_memory(m, again, bytes, &bytes) != TETCAST_OK) abort();
            if (tetcast_rbf_load_memory(&env, again, bytes, &n) != TETCAST_OK) abort();
            if (n->count != m->count || memcmp(n->record, m->record, m->count * sizeof *m->record) != 0) abort();
        }
        tetcast_rbf_destroy(n);
        free(again);
    }
    tetcast_rbf_destroy(m);
    free(copy);
    return 0;
}
