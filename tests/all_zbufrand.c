/* All tests of zbufrand.h in one program, as the header takes longer to compile than they do; each file compiles alone, too.
   The program is linked to all their names and runs the one it is called by. No two files may define the same name. */
#include "test.h"
#undef TEST_FILE
#define TEST_FILE zbufrand_accumulate
#define main TEST_MAIN
#include "test_zbufrand_accumulate.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_cluster
#include "test_zbufrand_cluster.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_edit
#include "test_zbufrand_edit.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_light
#include "test_zbufrand_light.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_lists
#include "test_zbufrand_lists.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_occlusion
#include "test_zbufrand_occlusion.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_raster
#include "test_zbufrand_raster.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_rays
#include "test_zbufrand_rays.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_reconstruct
#include "test_zbufrand_reconstruct.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_render
#include "test_zbufrand_render.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_sample
#include "test_zbufrand_sample.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_scene
#include "test_zbufrand_scene.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_select
#include "test_zbufrand_select.c"
#undef TEST_FILE
#define TEST_FILE zbufrand_theory
#include "test_zbufrand_theory.c"
#undef main

int main(int argc, char **argv) {
    static const test_file files[] = {
        {"test_zbufrand_accumulate", zbufrand_accumulate_main},
        {"test_zbufrand_cluster", zbufrand_cluster_main},
        {"test_zbufrand_edit", zbufrand_edit_main},
        {"test_zbufrand_light", zbufrand_light_main},
        {"test_zbufrand_lists", zbufrand_lists_main},
        {"test_zbufrand_occlusion", zbufrand_occlusion_main},
        {"test_zbufrand_raster", zbufrand_raster_main},
        {"test_zbufrand_rays", zbufrand_rays_main},
        {"test_zbufrand_reconstruct", zbufrand_reconstruct_main},
        {"test_zbufrand_render", zbufrand_render_main},
        {"test_zbufrand_sample", zbufrand_sample_main},
        {"test_zbufrand_scene", zbufrand_scene_main},
        {"test_zbufrand_select", zbufrand_select_main},
        {"test_zbufrand_theory", zbufrand_theory_main},
        {NULL, NULL}
    };
    return test_run_file(files, argc, argv);
}
