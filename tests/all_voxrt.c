/* All tests of voxrt.h in one program, as the header takes longer to compile than they do; each file compiles alone, too.
   The program is linked to all their names and runs the one it is called by. No two files may define the same name. The
   first one says what an assertion of the header does. */
#include "test.h"
#undef TEST_FILE
#define TEST_FILE voxrt_trace
#define main TEST_MAIN
#include "test_voxrt_trace.c"
#undef TEST_FILE
#define TEST_FILE voxrt_columns
#include "test_voxrt_columns.c"
#undef TEST_FILE
#define TEST_FILE voxrt_format
#include "test_voxrt_format.c"
#undef TEST_FILE
#define TEST_FILE voxrt_gi
#include "test_voxrt_gi.c"
#undef TEST_FILE
#define TEST_FILE voxrt_light
#include "test_voxrt_light.c"
#undef TEST_FILE
#define TEST_FILE voxrt_materials
#include "test_voxrt_materials.c"
#undef TEST_FILE
#define TEST_FILE voxrt_memory
#include "test_voxrt_memory.c"
#undef TEST_FILE
#define TEST_FILE voxrt_model
#include "test_voxrt_model.c"
#undef TEST_FILE
#define TEST_FILE voxrt_octree
#include "test_voxrt_octree.c"
#undef TEST_FILE
#define TEST_FILE voxrt_paging
#include "test_voxrt_paging.c"
#undef TEST_FILE
#define TEST_FILE voxrt_palette
#include "test_voxrt_palette.c"
#undef TEST_FILE
#define TEST_FILE voxrt_planes
#include "test_voxrt_planes.c"
#undef TEST_FILE
#define TEST_FILE voxrt_quality
#include "test_voxrt_quality.c"
#undef TEST_FILE
#define TEST_FILE voxrt_render
#include "test_voxrt_render.c"
#undef TEST_FILE
#define TEST_FILE voxrt_scene
#include "test_voxrt_scene.c"
#undef TEST_FILE
#define TEST_FILE voxrt_share
#include "test_voxrt_share.c"
#undef TEST_FILE
#define TEST_FILE voxrt_tree
#include "test_voxrt_tree.c"
#undef TEST_FILE
#define TEST_FILE voxrt_voxelize
#include "test_voxrt_voxelize.c"
#undef main

int main(int argc, char **argv) {
    static const test_file files[] = {
        {"test_voxrt_trace", voxrt_trace_main},
        {"test_voxrt_columns", voxrt_columns_main},
        {"test_voxrt_format", voxrt_format_main},
        {"test_voxrt_gi", voxrt_gi_main},
        {"test_voxrt_light", voxrt_light_main},
        {"test_voxrt_materials", voxrt_materials_main},
        {"test_voxrt_memory", voxrt_memory_main},
        {"test_voxrt_model", voxrt_model_main},
        {"test_voxrt_octree", voxrt_octree_main},
        {"test_voxrt_paging", voxrt_paging_main},
        {"test_voxrt_palette", voxrt_palette_main},
        {"test_voxrt_planes", voxrt_planes_main},
        {"test_voxrt_quality", voxrt_quality_main},
        {"test_voxrt_render", voxrt_render_main},
        {"test_voxrt_scene", voxrt_scene_main},
        {"test_voxrt_share", voxrt_share_main},
        {"test_voxrt_tree", voxrt_tree_main},
        {"test_voxrt_voxelize", voxrt_voxelize_main},
        {NULL, NULL}
    };
    return test_run_file(files, argc, argv);
}
