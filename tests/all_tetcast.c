/* All tests of tetcast.h in one program, as the header takes longer to compile than they do; each file compiles alone, too.
   The program is linked to all their names and runs the one it is called by. No two files may define the same name. */
#include "test.h"
#undef TEST_FILE
#define TEST_FILE tetcast_bricks
#define main TEST_MAIN
#include "test_tetcast_bricks.c"
#undef TEST_FILE
#define TEST_FILE tetcast_cells
#include "test_tetcast_cells.c"
#undef TEST_FILE
#define TEST_FILE tetcast_foam
#include "test_tetcast_foam.c"
#undef TEST_FILE
#define TEST_FILE tetcast_integrate
#include "test_tetcast_integrate.c"
#undef TEST_FILE
#define TEST_FILE tetcast_isosurface
#include "test_tetcast_isosurface.c"
#undef TEST_FILE
#define TEST_FILE tetcast_memory
#include "test_tetcast_memory.c"
#undef TEST_FILE
#define TEST_FILE tetcast_mesh
#include "test_tetcast_mesh.c"
#undef TEST_FILE
#define TEST_FILE tetcast_optical
#include "test_tetcast_optical.c"
#undef TEST_FILE
#define TEST_FILE tetcast_project
#include "test_tetcast_project.c"
#undef TEST_FILE
#define TEST_FILE tetcast_rbf
#include "test_tetcast_rbf.c"
#undef TEST_FILE
#define TEST_FILE tetcast_render
#include "test_tetcast_render.c"
#undef TEST_FILE
#define TEST_FILE tetcast_strips
#include "test_tetcast_strips.c"
#undef TEST_FILE
#define TEST_FILE tetcast_tables
#include "test_tetcast_tables.c"
#undef TEST_FILE
#define TEST_FILE tetcast_transfer
#include "test_tetcast_transfer.c"
#undef TEST_FILE
#define TEST_FILE tetcast_walk
#include "test_tetcast_walk.c"
#undef main

int main(int argc, char **argv) {
    static const test_file files[] = {
        {"test_tetcast_bricks", tetcast_bricks_main},
        {"test_tetcast_cells", tetcast_cells_main},
        {"test_tetcast_foam", tetcast_foam_main},
        {"test_tetcast_integrate", tetcast_integrate_main},
        {"test_tetcast_isosurface", tetcast_isosurface_main},
        {"test_tetcast_memory", tetcast_memory_main},
        {"test_tetcast_mesh", tetcast_mesh_main},
        {"test_tetcast_optical", tetcast_optical_main},
        {"test_tetcast_project", tetcast_project_main},
        {"test_tetcast_rbf", tetcast_rbf_main},
        {"test_tetcast_render", tetcast_render_main},
        {"test_tetcast_strips", tetcast_strips_main},
        {"test_tetcast_tables", tetcast_tables_main},
        {"test_tetcast_transfer", tetcast_transfer_main},
        {"test_tetcast_walk", tetcast_walk_main},
        {NULL, NULL}
    };
    return test_run_file(files, argc, argv);
}
