/* fuzz_vox.c - any bytes as a voxel file. What is accepted must be safe to use and come back unchanged when it is saved
   and loaded. Checksums are made right first: otherwise only they would be tested. */
#include <stdlib.h>
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void use(const voxrt_tree *t, int encoding) {
    voxrt_tree_info f;
    voxrt_ray r;
    voxrt_hit hit;
    voxrt_save_desc d;
    voxrt_tree *again = NULL;
    uint8_t *p = NULL;
    size_t size = 0, k, a;
    memset(&d, 0, sizeof d);
    voxrt_tree_get_info(t, &f);
    for (k = 0; k < 4; k++) {
        memset(&r, 0, sizeof r);
        for (a = 0; a < 3; a++) r.org[a] = (float)(f.world_origin[a] + f.voxel_size * ((k + a) % 3 ? -1.0 : f.cell_max[a]));
        for (a = 0; a < 3; a++) r.dir[a] = (float)(f.world_origin[a] + f.voxel_size * f.cell_min[a]) - r.org[a];
        r.t_max = 1e30f;
        if (voxrt_trace1(t, &r, &hit)) voxrt_hit_color(t, &hit, (uint8_t *)&a);
    }
    (void)voxrt_tree_get(t, f.depth, f.cell_min[0], f.cell_min[1], f.cell_min[2], NULL);
    d.encoding = (voxrt_encoding)encoding;
    if (voxrt_tree_save_memory(t, &d, NULL, 0, &size) == VOXRT_OK) p = (uint8_t *)malloc(size);
    if (p == NULL || voxrt_tree_save_memory(t, &d, p, size, &size) != VOXRT_OK) abort();
    if (voxrt_tree_load_memory(NULL, p, size, &again) != VOXRT_OK || voxrt_tree_hash(again) != voxrt_tree_hash(t)) abort();
    voxrt_tree_destroy(again);
    free(p);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    uint8_t *p = (uint8_t *)malloc(size + 64), *q = p + (64 - ((uintptr_t)p & 63u)) % 64;
    voxrt_load_desc d;
    voxrt_tree *t = NULL;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.env.memory_limit = (size_t)1 << 26;
    if (size != 0) memcpy(q, data, size);
    if (voxrt_file_kind(q, size) == 5) voxrti_v5_seal(q, size);
    if (voxrt_tree_load_memory(&d, q, size, &t) == VOXRT_OK) use(t, 0);
    voxrt_tree_destroy(t);
    if (voxrt_tree_map_memory(&d, q, size, &t) == VOXRT_OK) use(t, 1);
    voxrt_tree_destroy(t);
    free(p);
    return 0;
}
