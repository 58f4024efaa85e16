/* fuzz_vox.c - any bytes as a voxel file: what is accepted is used, and is the same after it was saved and loaded.
   Checksums are made right first, otherwise only they would be tested. */
#define _POSIX_C_SOURCE 200112L
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void use(voxrt_tree *t) {
    voxrt_tree *again = NULL;
    voxrt_hit hit;
    size_t size = 0, i, a;
    uint8_t *file;
    for (i = 0; i < 4; i++) {
        voxrt_ray r = {{0, 0, 0}, 0, {0, 0, 0}, 1e30f};
        for (a = 0; a < 3; a++) {
            double from = (i + a) % 3 == 0 ? -3.0 : (double)t->cell_max[a];
            r.org[a] = (float)(t->origin[a] + t->voxel_size * from);
            r.dir[a] = (float)(t->voxel_size * (t->cell_min[a] - from));
        }
        if (voxrt_trace1(t, &r, &hit)) voxrt_hit_normal(t, &hit, r.dir);
    }
    (void)voxrt_tree_get(t, t->depth, t->cell_min[0], t->cell_min[1], t->cell_min[2], NULL);
    if (voxrt_tree_save_memory(t, NULL, NULL, 0, &size) || (file = (uint8_t *)malloc(size)) == NULL) abort();
    if (voxrt_tree_save_memory(t, NULL, file, size, &size)) abort();
    if (voxrt_tree_load_memory(NULL, file, size, &again) || voxrt_tree_hash(again) != voxrt_tree_hash(t)) abort();
    free(file);
    voxrt_tree_destroy(again);
    voxrt_tree_destroy(t);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    void *copy = NULL;
    voxrt_load_desc d;
    voxrt_octree_desc od;
    voxrt_tree *t;
    voxrt_octree *o;
    memset(&d, 0, sizeof d);
    memset(&od, 0, sizeof od);
    d.env.thread_count = 1;
    d.env.memory_limit = (size_t)1 << 26;
    od.env = d.env;
    if (posix_memalign(&copy, 64, size + !size) != 0) return 0;
    if (size != 0) memcpy(copy, data, size);
    if (voxrt_file_kind(copy, size) == 5) voxrti_v5_seal((uint8_t *)copy, size);
    if (voxrt_tree_load_memory(&d, copy, size, &t) == VOXRT_OK) use(t);
    if (voxrt_tree_map_memory(&d, copy, size, &t) == VOXRT_OK) use(t);
    if (!voxrt_octree_load_memory(&od, copy, size, &o) && !voxrt_tree_from_octree(&od, o, &t)) use(t);
    voxrt_octree_destroy(o);
    free(copy);
    return 0;
}
