/* voxel_file.h - voxel files for programs: any format, a message that says what is wrong
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_VOXEL_FILE_H
#define SUP_VOXEL_FILE_H
#include "base.h"
#include "voxrt.h"

/* Load a file of format 5 or 4.
   how      in, NULL: as we write them. Else how a file of format 4 from elsewhere has to be turned; its env is not used
   octree   out, or NULL when it is not wanted
   Returns 0 and what the caller destroys, or 1 with err->text set and nothing to destroy. */
SUP_FN int sup_voxels_load(const char *path, uint32_t threads, const voxrt_octree_desc *how, voxrt_tree **tree,
                           voxrt_octree **octree, sup_error *err) {
    voxrt_load_desc desc;
    voxrt_octree_desc old;
    voxrt_octree *o = NULL;
    voxrt_error error;
    voxrt_result result;
    const char *text;
    char *data;
    size_t size;
    uint32_t kind;
    *tree = NULL;
    if (octree) *octree = NULL;
    if (sup_read_file(path, &data, &size, err)) return 1;
    memset(&desc, 0, sizeof desc);
    memset(&old, 0, sizeof old);
    if (how) old = *how;
    memset(&error, 0, sizeof error);
    desc.env.thread_count = threads;
    desc.env.memory_limit = sup_memory_limit();
    desc.env.error = &error;
    old.env = desc.env;
    old.disable_grid = octree == NULL;
    /* files of versions to come go to the loader whose mark they bear: it says what is wrong */
    kind = voxrt_file_kind(data, size);
    if (kind == 0 && size >= 12 && memcmp(data, "\211VOX\r\n\032\n", 8) == 0) kind = 5;
    if (kind == 0 && size >= 4 && memcmp(data, "MB", 2) == 0) kind = 4;
    if (kind == 5 && (old.flip_y || old.flip_z || old.swap_angles)) {
        SUP_FREE(data);
        return sup_fail(err, "%s: only files of format 4 can be turned", path);
    }
    if (kind == 5) {
        result = voxrt_tree_load_memory(&desc, data, size, tree);
        if (result == VOXRT_OK && octree) result = voxrt_octree_from_tree(&old, *tree, &o);
    } else if (kind == 4) {
        result = voxrt_octree_load_memory(&old, data, size, &o);
        if (result == VOXRT_OK) result = voxrt_tree_from_octree(&old, o, tree);
    } else {
        SUP_FREE(data);
        return sup_fail(err, kind == 6 ? "%s: a file in pages is drawn, not loaded" : "%s: not a voxel file", path);
    }
    SUP_FREE(data);
    if (result == VOXRT_OK && octree) *octree = o;
    else voxrt_octree_destroy(o);
    if (result == VOXRT_OK) return 0;
    voxrt_tree_destroy(*tree);
    *tree = NULL;
    text = error.text[0] ? error.text : voxrt_result_string(result);
    if (result == VOXRT_ERR_VERSION || result == VOXRT_ERR_NO_MEMORY || strstr(text, "byte") != NULL)
        return sup_fail(err, "%s: %s", path, text);
    return sup_fail(err, "%s: byte %llu: %s", path, (unsigned long long)error.where, text);
}

/* Open a file in pages. memory: bytes for what is loaded; wait: as in voxrt_paged_desc.
   Returns 0 and what the caller destroys, or NULL if it is no such file; or 1 with err->text set. */
SUP_FN int sup_voxels_paged(const char *path, uint64_t memory, uint32_t wait, voxrt_paged **paged, sup_error *err) {
    voxrt_paged_desc desc;
    voxrt_error error;
    voxrt_result result;
    unsigned char head[64];
    size_t have;
    FILE *file = fopen(path, "rb");
    *paged = NULL;
    if (!file) return 0; /* whoever loads it will say why */
    have = fread(head, 1, sizeof head, file);
    (void)fclose(file);
    if (voxrt_file_kind(head, have) != 6) return 0;
    memset(&desc, 0, sizeof desc);
    memset(&error, 0, sizeof error);
    desc.env.error = &error;
    desc.memory = memory < (size_t)-1 ? (size_t)memory : (size_t)-1;
    desc.wait = wait;
    result = voxrt_paged_open_file(&desc, path, paged);
    if (result == VOXRT_OK) return 0;
    return sup_fail(err, "%s: %s", path, error.text[0] ? error.text : voxrt_result_string(result));
}

#endif
