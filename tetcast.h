/* tetcast.h - v0.1.0 - volumes on tetrahedra: exact ray casting, isosurfaces - MIT OR Unlicense, see end of file
   SPDX-License-Identifier: MIT OR Unlicense

   CONTENTS
   The declarations come first. Sections of the implementation, to be found by searching for >>name:
   @platform       compiler, instruction sets, asserts, bytes
   @memory         every byte comes from here
   @threads        one parallel-for
   @math           small vectors, own polynomials (libm differs between platforms), Morton codes
   @core           the bytes of a mesh
   @optics         compiled transfer functions, sums along a ray, and how walkers use the integrators
   @mesh           cells of the caller -> tetrahedra in a good order -> neighbours -> hull
   @cells          compact forms for walking
   @strips         larger and older forms of cells: Tet20, Tet32, the list of 160 bytes, tetrahedral strips
   @walk           rays, where they meet the hull, and from cell to cell
   @hull           where rays enter the mesh
   @walk_avx2      eight rays side by side, each in its own cell
   @clusters       runs of 128 cells, which lie close together, with the ranges of their values and the
   @transfer       control points or tables -> sorted intervals with slopes, prefix integrals, maxima
   @integrate      segments of a ray -> colour and transmittance
   @tables         the integrators of the thesis and of its time: sampling rules, prefix integrals, the
   @optical        models (emission, absorption, maximum, isosurfaces, depth cueing), sums along rays
   @isosurface     marching tetrahedra with one vertex per edge
   @project        cells -> the pixels that they cover
   @order          fragments of a tile -> rays, in their order
   @render         camera -> rays -> tiles over the threads -> buffers
   @rbf            sums of radial basis functions: bytes, kernels, files
   @rbf_eval       values and derivatives at points, bounds, features of flows
   @rbf_fit        points -> coarse grid and functions, with a guaranteed error
   @rbf_render     functions -> tiles -> groups of eight rays -> sums along rays; traces of particles
   @misc           names and versions

   DO THIS
   In one C or C++ file, and only there:
       #define TETCAST_IMPLEMENTATION
       #include "tetcast.h"
   and #include "tetcast.h" without the macro wherever else you use it. Link with -lm -lpthread.
   -ffp-contract=off on the command line is a second guard for equal bits on all machines (see DETERMINISM).

   A PROGRAM (examples/minimal_tetcast.c; png.h beside it writes the picture)

    #include "support/png.h"
    #define TETCAST_IMPLEMENTATION
    #include "tetcast.h"

    enum { N = 64, WIDTH = 800, HEIGHT = 500 };
    static float value[N * N * N];
    static uint8_t pixels[WIDTH * HEIGHT][4];

    static void make_knot(void) {
        for (int i = 0; i < N * N * N; i++) {
            const float x = (float)(i % N) / 21.0f - 1.5f, y = (float)(i / N % N) / 21.0f - 1.5f;
            const float z = (float)(i / N / N) / 21.0f - 1.5f, a = 1.5f * atan2f(z, x), r = sqrtf(x * x + z * z) - 1.0f;
            const float u = 0.3f * cosf(a), v = 0.3f * sinf(a);
            value[i] = expf(-40.0f * ((r - u) * (r - u) + (y - v) * (y - v))) +
                       expf(-40.0f * ((r + u) * (r + u) + (y + v) * (y + v)));
        }
    }

    int main(int argc, char **argv) {
        const tetcast_field field = {.name = "knot", .values = {.data = value}};
        const tetcast_grid grid = {.dims = {N, N, N}, .fields = &field, .field_count = 1};
        const tetcast_control_point points[] = {{0.1f, {0.1f, 0.2f, 0.9f}, 0.0f},    // value, colour, extinction
                                                {0.4f, {0.1f, 0.7f, 0.9f}, 0.08f},
                                                {0.9f, {1.0f, 0.5f, 0.1f}, 0.6f}};
        const tetcast_transfer_desc colours = {.points = points, .point_count = 3};
        const tetcast_render_desc render = {.background = {0.02f, 0.02f, 0.03f, 1.0f}}; // the camera frames the volume
        const tetcast_image image = {.width = WIDTH, .height = HEIGHT, .rgba8 = pixels[0]};
        tetcast_mesh *mesh = NULL;
        tetcast_transfer *transfer = NULL;
        tetcast_optics *optics = NULL;
        sup_error err;

        make_knot();
        tetcast_result result = tetcast_mesh_create_grid(NULL, &grid, NULL, &mesh);
        if (result == TETCAST_OK) result = tetcast_transfer_create(&colours, &transfer);
        if (result == TETCAST_OK) result = tetcast_optics_create(transfer, NULL, &optics);
        if (result == TETCAST_OK) result = tetcast_render(&render, mesh, optics, &image, NULL);
        tetcast_optics_destroy(optics);
        tetcast_transfer_destroy(transfer);
        tetcast_mesh_destroy(mesh);

        if (result != TETCAST_OK) (void)sup_fail(&err, "%s", tetcast_result_string(result));
        else if (!sup_png_write8(argc > 1 ? argv[1] : "tetcast.png", pixels[0], WIDTH, HEIGHT, 4, &err)) return 0;
        fprintf(stderr, "%s\n", err.text);
        return 1;
    }

   WHAT IT DOES
   - Takes tetrahedra, hexahedra, prisms, pyramids and structured grids with any number of scalars, per vertex or per
     cell; cuts larger cells so that neighbours agree; finds neighbours; says what is wrong with a mesh and leaves out
     only what cannot be used.
   - Keeps a tetrahedron in 12 (Tet8) to 19 bytes (Tet16), vertices, scalar and all else that rays need included, in the
     order of a space-filling curve; or in the forms of the thesis that it comes from: a list of 160 bytes, tetrahedral
     strips. What projection, isosurface meshes, leaping over empty regions and the numbers of the input need besides
     is another 31 bytes, which options leave away.
   - Walks rays from cell to cell by exact signs: no epsilon, no failed ray, whatever the shape of the cells.
   - Projects cells onto the picture by the same signs, with exact order in every pixel, where cells are large.
   - Integrates light exactly for transfer functions that are piecewise linear: emission and absorption, either alone,
     maximum, isosurfaces in any number and translucent, both together; depth cueing. Tables of pre-integration and
     sampling rules for comparison. A changed transfer function costs microseconds.
   - Keeps colour errors below a tolerance in units of 1/255, and says what it did for that.
   - Extracts isosurfaces as triangle meshes.

   WHAT IT DOES NOT DO
   - No curved cells, no scattering, no shadows inside the volume.
   - No volume files, no picture files: examples/support has readers, a PNG writer and a command line.
   - Meshes are not edited and vertices do not move; another field or transfer function at any time.

   LIMITS
   tetrahedra, vertices       2^31 - 3 each
   knots of a transfer function 2^20
   threads                    64
   stack                      less than 16 KB in one function, less than 64 KB in all

   OPTIONS
   macro                       meaning                                                  default       same in all files?
   TETCAST_IMPLEMENTATION      emit the code, in exactly one file                       off           no
   TETCAST_STATIC              all functions static; only where the code is, too        off           yes
   TETCAST_DEF                 what stands before declarations                          extern/static yes
   TETCAST_MALLOC(size,user)   default allocator, 16-byte aligned; both or neither      malloc        code only
   TETCAST_FREE(ptr,size,user) its other half                                           free          code only
   TETCAST_ASSERT(cond)        what internal checks use                                 assert        code only
   TETCAST_NO_STDIO            no <stdio.h>                                             off           yes
   TETCAST_NO_THREADS          never start a thread; env.parallel still works           off, wasm: on code only
   TETCAST_NO_SIMD             scalar code only                                         off           code only
   TETCAST_NO_AVX2             no AVX2                                                  off           code only
   TETCAST_NO_RBF              no radial basis functions                                off           yes
   TETCAST_ALLOW_FAST_MATH     accept -ffast-math; nothing is promised then             #error        code only
   No macro changes a struct. The instruction set is chosen when the program runs; desc.isa can lower it.

   MEMORY
   All of it comes through desc.env: its allocator, else TETCAST_MALLOC, else malloc. An object keeps its allocator
   until it is destroyed. env.memory_limit bounds what one call and its results hold at once. When memory runs out a
   call frees what it had and returns TETCAST_ERR_NO_MEMORY.

   THREADS
   A call uses env.thread_count threads (0: one per core; 1: never more than the caller's), started and joined within
   the call, with stacks of 512 KB. env.parallel hands the work to the host's job system instead. Meshes, transfer
   functions and optics may be read by any number of threads at once. There is no global state.

   DETERMINISM
   The same input gives the same bits: for any number of threads, any instruction set, any form of the cells; with gcc
   or clang at any optimisation. Fused multiply-add is used where it is written down (fmaf and its instructions) and
   nowhere else (pragmas in this file). x87 code (-m32 without -mfpmath=sse), -std=c99 on s390x (without
   -fexcess-precision=fast) and -ffast-math break it.

   ERRORS
   Functions that can fail return a tetcast_result and set their outputs to NULL or 0 first. env.error receives the
   place (cell, vertex, control point) and a sentence. A desc has to be zeroed (memset, = {0} or = {} in C++);
   tetcast checks its first and last member. The library never prints, never exits.

   COORDINATES AND UNITS
   Right-handed world, any unit. Positions are kept relative to the middle of the mesh, in doubles where they come in.
   Row 0 of a picture is on top, pixel (i, j) has its centre at (i+0.5, j+0.5), fov_y is the vertical angle; depth is
   the distance along the viewing axis. Extinction is per world length. Colours: bytes are sRGB, floats are linear; rgba
   is premultiplied, rgba8 is not.

   REFERENCES
   M. Weiler: Hardware-beschleunigte Volumenvisualisierung auf adaptiven Datenstrukturen. Diss., Univ. Stuttgart, 2005
       (`the thesis': tetrahedral strips, cell projection, incremental pre-integration)
   A. Aman, S. Demirci, U. Gudukbay: Compact tetrahedralization-based acceleration structures for ray tracing.
       Journal of Visualization 25, 2022 (Tet32, Tet20, Tet16)
   S. Woop, C. Benthin, I. Wald: Watertight Ray/Triangle Intersection. JCGT 2(1), 2013 (shear of a ray)
   H. Edelsbrunner, E. P. Mucke: Simulation of Simplicity. ACM TOG 9(1), 1990 (ties)
   K. Moreland, E. Angel: A Fast High Accuracy Volume Renderer for Unstructured Data. IEEE VolVis 2004 (psi)
   E. Lum, B. Wilson, K.-L. Ma: High-Quality Lighting and Efficient Pre-Integration for Volume Rendering. VisSym 2004
   A. Doi, A. Koide: An efficient method of triangulating equivalued surfaces by using tetrahedral cells. IEICE 1991
   docs/algorithms.md says which equation is where, and what was corrected. */
#ifndef TETCAST_H_INCLUDED
#define TETCAST_H_INCLUDED
#include <stddef.h>
#include <stdint.h>

#define TETCAST_VERSION_MAJOR 0
#define TETCAST_VERSION_MINOR 1
#define TETCAST_VERSION_PATCH 0
#define TETCAST_VERSION (TETCAST_VERSION_MAJOR * 1000000 + TETCAST_VERSION_MINOR * 1000 + TETCAST_VERSION_PATCH)


#ifndef TETCAST_DEF
#  ifdef TETCAST_STATIC
#    if defined(__GNUC__) || defined(__clang__)
#      define TETCAST_DEF static __attribute__((unused))
#    else
#      define TETCAST_DEF static
#    endif
#  else
#    define TETCAST_DEF extern
#  endif
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* ---- results, memory, threads ---- */

#define TETCAST_RESULT_LIST(X) \
    X(OK, 0, "success") \
    X(ERR_INVALID_ARG, 1, "invalid argument") \
    X(ERR_UNINIT_DESC, 2, "desc struct was not zero-initialised") \
    X(ERR_NO_MEMORY, 3, "out of memory, or memory_limit reached") \
    X(ERR_TRUNCATED, 4, "data ends early") \
    X(ERR_FORMAT, 5, "malformed data") \
    X(ERR_VERSION, 6, "unknown format version") \
    X(ERR_IO, 7, "file could not be read or written") \
    X(ERR_CANCELLED, 8, "cancelled by the progress callback") \
    X(ERR_RANGE, 9, "a size is out of the supported range") \
    X(ERR_EMPTY, 10, "nothing to build: no usable cell") \
    X(ERR_CHECKSUM, 11, "checksum mismatch: the data is damaged")

typedef enum tetcast_result {
#define TETCASTI_X(name, value, text) TETCAST_##name = value,
    TETCAST_RESULT_LIST(TETCASTI_X)
#undef TETCASTI_X
    TETCAST_RESULT_FORCE_32BIT = 0x7fffffff
} tetcast_result;

/* What went wrong and where. `where` is a byte offset, a line, a cell or a vertex index, as `text` says. */
typedef struct tetcast_error {
    tetcast_result code;
    uint64_t where;
    char text[200];
} tetcast_error;

typedef struct tetcast_allocator {
    void *(*alloc_fn)(size_t size, void *user); /* 16-byte aligned, or NULL; any thread */
    void (*free_fn)(void *ptr, size_t size, void *user);
    void *user;
} tetcast_allocator;

typedef void tetcast_task_fn(void *task_ctx, uint32_t index);
typedef struct tetcast_parallel { /* run task(ctx, i) once for each i in [0, count), return when all are done */
    void (*for_fn)(tetcast_task_fn *task, void *task_ctx, uint32_t count, void *user);
    void *user;
} tetcast_parallel;

/* Where memory, threads and messages come from; part of every desc. All zero: malloc, one thread per core,
   no limit, silent. */
typedef struct tetcast_env {
    tetcast_allocator allocator;
    tetcast_parallel parallel;  /* set: the host's job system runs the work, no thread is started */
    uint32_t thread_count;    /* 0: one per core; 1: never start a thread */
    size_t memory_limit;      /* bytes that one call and its results may hold at once; 0: none */
    int (*progress_fn)(void *user, uint64_t done, uint64_t total); /* non-zero cancels; called by one thread */
    void *progress_user;
    tetcast_error *error;       /* receives the place and the reason of a failure; may be NULL */
} tetcast_env;

typedef enum tetcast_isa {
    TETCAST_ISA_AUTO = 0,
    TETCAST_ISA_SCALAR = 1,
    TETCAST_ISA_SSE = 2,
    TETCAST_ISA_AVX2 = 3,
    TETCAST_ISA_AVX512 = 4,
    TETCAST_ISA_FORCE_32BIT = 0x7fffffff
} tetcast_isa;

/* ---- meshes ---- */

#define TETCAST_MAX_CELLS 0x7ffffffdu    /* tetrahedra of a mesh, after cells were split */
#define TETCAST_MAX_VERTICES 0x7ffffffdu
#define TETCAST_NONE 0xffffffffu         /* no cell, no vertex */

/* Linear cells, with the numbers and the vertex orders of VTK files. */
typedef enum tetcast_shape {
    TETCAST_SHAPE_TETRA = 10,      /* 4 vertices, either orientation */
    TETCAST_SHAPE_VOXEL = 11,      /* 8: x fastest, z slowest */
    TETCAST_SHAPE_HEXAHEDRON = 12, /* 8: around the bottom, around the top */
    TETCAST_SHAPE_WEDGE = 13,      /* 6: a triangle and the one opposite to it (a prism) */
    TETCAST_SHAPE_PYRAMID = 14,    /* 5: around the base, the top */
    TETCAST_SHAPE_FORCE_32BIT = 0x7fffffff
} tetcast_shape;

typedef enum tetcast_type {
    TETCAST_TYPE_F32 = 0,
    TETCAST_TYPE_F64 = 1,
    TETCAST_TYPE_U8 = 2,
    TETCAST_TYPE_I8 = 3,
    TETCAST_TYPE_U16 = 4,
    TETCAST_TYPE_I16 = 5,
    TETCAST_TYPE_U32 = 6,
    TETCAST_TYPE_I32 = 7,
    TETCAST_TYPE_F16 = 8,   /* IEEE half */
    TETCAST_TYPE_FORCE_32BIT = 0x7fffffff
} tetcast_type;

/* Numbers somewhere in memory, in the byte order of the machine; need not be aligned. */
typedef struct tetcast_array {
    const void *data;
    tetcast_type type;
    size_t stride;      /* bytes from one element to the next; 0: they lie close together */
} tetcast_array;

/* One scalar per vertex (linear inside of tetrahedra) or per cell (constant inside of it). Kept as floats. */
typedef struct tetcast_field {
    const char *name;   /* may be NULL; 63 bytes are kept */
    tetcast_array values;
    uint32_t per_cell;  /* 1: one for each cell of the input */
} tetcast_field;

/* A mesh of the caller. Borrowed for the call. */
typedef struct tetcast_input {
    tetcast_array positions;   /* elements of three numbers: x y z */
    size_t vertex_count;
    const uint32_t *indices;   /* the cells' vertices one after the other */
    size_t index_count;        /* 4 per cell when shapes is NULL */
    const uint8_t *shapes;     /* tetcast_shape of each cell; NULL: all are tetrahedra */
    size_t cell_count;
    const uint8_t *masks;      /* per cell, not 0: imaginary: rays pass through it, it shows nothing; or NULL */
    const tetcast_field *fields;
    size_t field_count;
} tetcast_input;

/* A structured grid of the caller: dims[0]*dims[1]*dims[2] vertices, x fastest. Three kinds: curvilinear (positions of
   all vertices), rectilinear (axes), uniform (neither: origin + spacing). axes and uniform are placed by origin and
   matrix: world = origin + matrix * (i*spacing[0], j*spacing[1], k*spacing[2]) or of (axes[0][i], ...). */
typedef struct tetcast_grid {
    uint32_t dims[3];
    tetcast_array positions;
    tetcast_array axes[3];
    double origin[3];
    double spacing[3];         /* all 0: 1 */
    double matrix[9];          /* rows; all 0: unit matrix */
    const uint8_t *blanks;     /* per vertex, 0: cells that use it are left out (PLOT3D's iblank); or NULL */
    const tetcast_field *fields;
    size_t field_count;
    uint32_t alternate;        /* 1: five tetrahedra a cell, cells with odd i+j+k mirrored; 0: six */
} tetcast_grid;

/* How cells are stored for walking; all give the same picture. Bytes are per tetrahedron, without vertices. */
typedef enum tetcast_cells {
    TETCAST_CELLS_TET16 = 0,     /* 16 (default) */
    TETCAST_CELLS_TET8 = 1,      /* 8.5 to 10 */
    TETCAST_CELLS_TET20 = 2,     /* 20 */
    TETCAST_CELLS_TET32 = 3,     /* 32 */
    TETCAST_CELLS_LIST160 = 4,   /* 160: the list of the thesis */
    TETCAST_CELLS_STRIPS = 5,    /* sequential strips of the thesis */
    TETCAST_CELLS_STRIPS_GENERAL = 6, /* generalised strips */
    TETCAST_CELLS_COUNT = 7,
    TETCAST_CELLS_FORCE_32BIT = 0x7fffffff
} tetcast_cells;

typedef enum tetcast_order {
    TETCAST_ORDER_HILBERT = 0, /* cells and vertices along a Hilbert curve (default) */
    TETCAST_ORDER_MORTON = 1,
    TETCAST_ORDER_INPUT = 2,   /* as they come */
    TETCAST_ORDER_FORCE_32BIT = 0x7fffffff
} tetcast_order;

/* field           zero means
   cells           Tet16
   order           Hilbert curve
   weld            off. 1: vertices at the same place (as 32-bit floats) become one: for blocks that were exported apart
   drop_tets       keep 16 bytes a cell with the four vertices: needed by projection, isosurfaces, strips and checks
   drop_source     keep 4 bytes a cell and a vertex: numbers in the input
   keep_neighbours off. 1: keep 16 bytes a cell with the four neighbours; they are made again when something needs them
   disable_clusters keep the walls between clusters of cells that let rays leap over what the transfer function hides,
                   about 10 bytes a cell
   strict          off. 1: an index out of range, a NaN or a cell of unknown shape is an error, not left out and
                   counted */
typedef struct tetcast_mesh_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_cells cells;
    tetcast_order order;
    uint32_t weld;
    uint32_t drop_tets;
    uint32_t drop_source;
    uint32_t keep_neighbours;
    uint32_t disable_clusters;
    uint32_t strict;
    uint32_t _end_zero;
} tetcast_mesh_desc;

/* What an import found. first_* are numbers of the input, TETCAST_NONE when the count is 0. */
typedef struct tetcast_report {
    uint64_t input_cells, input_vertices;
    uint64_t cells;              /* tetrahedra of the mesh */
    uint64_t vertices;           /* that they use */
    uint64_t bad_indices;        /* cells with an index out of range: left out */
    uint64_t bad_positions;      /* cells with a vertex that is NaN or infinite: left out */
    uint64_t bad_shapes;         /* cells of unknown shape: left out (the rest of the list cannot be read) */
    uint64_t repeated;           /* tetrahedra with the same vertex twice: left out */
    uint64_t duplicates;         /* tetrahedra that are there already: left out */
    uint64_t zero_volume;        /* four vertices in a plane: kept, they are in nobody's way */
    uint64_t inverted;           /* volume of the wrong sign between well oriented neighbours: kept */
    uint64_t turned;             /* given in the other orientation: turned silently */
    uint64_t hull_faces;         /* faces with a cell on one side only */
    uint64_t nonmanifold_faces;  /* faces of three cells and more: all of them are treated as hull */
    uint64_t bad_values;         /* values that are NaN or infinite: the cells around them show nothing */
    uint64_t masked;             /* imaginary tetrahedra */
    uint64_t welded;             /* vertices that became one with another */
    uint64_t unused_vertices;
    uint32_t first_bad_index, first_bad_position, first_repeated, first_duplicate, first_zero_volume, first_inverted,
        first_nonmanifold, first_bad_value;
} tetcast_report;

/* What a closer look finds that an import does not need to know. */
typedef struct tetcast_check {
    uint64_t hanging_nodes;        /* vertices of the hull that lie on an edge of the hull without ending it */
    uint64_t coincident_vertices;  /* vertices at the place of another one */
    uint64_t components;           /* parts that share no face */
    uint32_t first_hanging, first_coincident; /* vertex of the input */
    double volume;                 /* sum of all cells, world units; inverted ones count negative */
    double smallest, largest;      /* volume of a cell */
    double aspect;                 /* largest ratio of a cell's longest edge to its smallest height; infinity if flat */
    double longest_edge;           /* world units */
} tetcast_check;

typedef struct tetcast_mesh tetcast_mesh;

typedef struct tetcast_mesh_info {
    uint64_t cell_count, vertex_count, hull_face_count;
    uint32_t field_count, active_field;
    tetcast_cells cells;
    double box_min[3], box_max[3]; /* world */
    uint64_t escapes;              /* Tet8: cells in the side table */
    uint64_t connectivity_bytes;   /* cells, as they are walked */
    uint64_t vertex_bytes;         /* positions and the active scalar */
    uint64_t hull_bytes;           /* faces of the hull and the tree over them */
    uint64_t field_bytes;          /* all scalars, where there are several, and those per cell */
    uint64_t cluster_bytes;        /* what disable_clusters is about: about 10 a cell, for leaping only */
    uint64_t optional_bytes;       /* what drop_* and keep_* are about */
    uint64_t total_bytes;
} tetcast_mesh_info;

/* Build a mesh.
   desc    NULL: all defaults
   input   borrowed
   report  out, may be NULL; filled as far as the import got
   Cells that cannot be used are left out and counted. Faces are matched by their three vertices; where that fails
   (hanging nodes, three cells at a face, blocks that do not share vertices) rays leave the mesh and enter it again.
   Larger cells are cut so that each quadrilateral face is cut at its vertex of the smallest number: neighbours agree.
   The same mesh for any number of threads. Cost: O(cells), about 0.1 s for 10^6 tetrahedra on one core; holds about
   100 bytes a cell at its peak. Errors: INVALID_ARG, UNINIT_DESC, EMPTY, RANGE, FORMAT (strict), NO_MEMORY,
   CANCELLED. */
TETCAST_DEF tetcast_result tetcast_mesh_create(const tetcast_mesh_desc *desc, const tetcast_input *input,
                                               tetcast_report *report, tetcast_mesh **out_mesh);

/* The same from a structured grid. A hexahedron that was cut into tetrahedra is linear in each of them, it has no
   longer the trilinear function of the grid: the difference is of second order in the size of the cells. */
TETCAST_DEF tetcast_result tetcast_mesh_create_grid(const tetcast_mesh_desc *desc, const tetcast_grid *grid,
                                                    tetcast_report *report, tetcast_mesh **out_mesh);

TETCAST_DEF void tetcast_mesh_destroy(tetcast_mesh *mesh); /* NULL is allowed */
TETCAST_DEF void tetcast_mesh_get_info(const tetcast_mesh *mesh, tetcast_mesh_info *info);
TETCAST_DEF void tetcast_mesh_get_report(const tetcast_mesh *mesh, tetcast_report *report);

/* Look closer at a mesh: see tetcast_check. Needs the tets. O(n log n). Errors: INVALID_ARG (tets dropped),
   NO_MEMORY. */
TETCAST_DEF tetcast_result tetcast_mesh_check(const tetcast_mesh *mesh, const tetcast_env *env, tetcast_check *check);

/* Name and range of a field; *lo > *hi when it has no value that is a number. Returns NULL when there is no such
   field. */
TETCAST_DEF const char *tetcast_mesh_field(const tetcast_mesh *mesh, uint32_t field, float *lo, float *hi);
/* Number of the field of that name, or TETCAST_NONE. */
TETCAST_DEF uint32_t tetcast_mesh_find_field(const tetcast_mesh *mesh, const char *name);

/* Choose the scalar that is seen; 0 at first. Not while another thread uses the mesh. O(vertices).
   Errors: INVALID_ARG, RANGE (no such field). */
TETCAST_DEF tetcast_result tetcast_mesh_set_field(tetcast_mesh *mesh, uint32_t field);

/* The mesh in its own order. positions: world. Numbers of the input through source_*, or TETCAST_NONE when dropped. */
TETCAST_DEF void tetcast_mesh_vertex(const tetcast_mesh *mesh, uint32_t vertex, double position[3], float *value,
                                     uint32_t *source_vertex);
/* Needs the tets, else RANGE. source_cell: the cell of the input that it was cut from. */
TETCAST_DEF tetcast_result tetcast_mesh_cell(const tetcast_mesh *mesh, uint32_t cell, uint32_t vertices[4],
                                             uint32_t *source_cell);
/* ---- transfer functions ---- */

/* Scalar value -> colour and extinction, piecewise linear between control points. Two points of equal value make a
   jump (the first is the limit from below, the last the limit from above; points between them are ignored). Outside
   the points the nearest one holds. Colours are linear light, not sRGB. Extinction is per unit of world length. */
typedef struct tetcast_control_point {
    float value;
    float rgb[3];
    float extinction;
} tetcast_control_point;

/* ASSOCIATED: particles of colour rgb that emit and absorb; emission per unit of length is rgb * extinction.
   INDEPENDENT: rgb is the emission per unit of length itself. */
typedef enum tetcast_color_mode {
    TETCAST_COLOR_ASSOCIATED = 0,
    TETCAST_COLOR_INDEPENDENT = 1,
    TETCAST_COLOR_FORCE_32BIT = 0x7fffffff
} tetcast_color_mode;

/* A surface of constant value: seen by the models with isosurfaces, in any number, in the order in which a ray meets
   them. The lit colour of one light is light * (rgb * (n . l) + specular * (n . h)^shininess), two-sided. */
typedef struct tetcast_isovalue {
    float value;
    float rgb[3];
    float opacity;      /* 0 invisible .. 1 opaque */
    float specular;     /* strength of the highlight */
    float shininess;    /* exponent of the highlight, 0: 32 */
} tetcast_isovalue;

/* field           zero means
   points          no control points: nothing is emitted or absorbed (isovalues may still be seen)
   table           none; else table_count samples {r, g, b, extinction}, the first at table_value[0], the last at
                   table_value[1], linear between them (table_steps = 1: constant, changing half way between samples)
   color_points,   none; colours and extinctions may also come as two lists with knots of their own
   extinction_points
   extinction_scale 1
   simplify        only knots go whose removal changes less than 1e-7 of the largest value */
typedef struct tetcast_transfer_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_color_mode color_mode;
    const tetcast_control_point *points;      /* ascending values; borrowed */
    size_t point_count;
    const float *table;                       /* 4 floats per sample; borrowed; not together with points */
    size_t table_count;
    float table_value[2];
    uint32_t table_steps;
    const tetcast_control_point *color_points;      /* only value and rgb are read; not with points or table */
    size_t color_count;
    const tetcast_control_point *extinction_points; /* only value and extinction are read */
    size_t extinction_count;
    const tetcast_isovalue *isovalues;        /* in any order, all different */
    size_t isovalue_count;
    float extinction_scale;                   /* multiplies every extinction (and independent colours) */
    float simplify;                           /* > 0: leave out knots while no value moves by more than this share of
                                                 the largest colour and the largest extinction */
    uint32_t _end_zero;
} tetcast_transfer_desc;

typedef struct tetcast_transfer tetcast_transfer; /* immutable: any number of threads may use it */

typedef struct tetcast_transfer_info {
    uint32_t knot_count;       /* values at which the function has a bend or a jump */
    uint32_t jump_count;
    uint32_t dropped_count;    /* knots left out: collinear, or by simplify */
    uint32_t isovalue_count;
    float value[2];            /* first and last knot */
    float largest_extinction;
    float largest_color;       /* largest component of rgb where anything is visible */
    float largest_emission;    /* largest component of rgb * extinction, or of rgb if independent */
    float simplify_color, simplify_extinction; /* largest change that leaving out knots made */
    size_t bytes;
} tetcast_transfer_info;

/* Compile a transfer function.
   desc    NULL: an empty function
   out     receives the object; free it with tetcast_transfer_destroy. NULL on failure
   Errors: INVALID_ARG (NaN, values not below 1e38, extinction or colour not in [0, 1e18], values not ascending, two
   isovalues equal, two sources at once; error->where is the index of the point), RANGE (more than 2^20 points),
   UNINIT_DESC, NO_MEMORY.
   Cost: O(n log n); about 250 bytes per knot. A change of a transfer function is a new object: microseconds. */
TETCAST_DEF tetcast_result tetcast_transfer_create(const tetcast_transfer_desc *desc, tetcast_transfer **out);
TETCAST_DEF void tetcast_transfer_destroy(tetcast_transfer *transfer); /* NULL is allowed */
TETCAST_DEF void tetcast_transfer_get_info(const tetcast_transfer *transfer, tetcast_transfer_info *info);

/* Colour and extinction at a value; at a jump the limit from above. rgba[3] is the extinction. */
TETCAST_DEF void tetcast_transfer_eval(const tetcast_transfer *transfer, float value, float rgba[4]);

/* 1 if a ray whose values stay in [lo, hi] sees nothing of the volume there: no extinction and, with independent
   colours, no emission. Isovalues do not count. NaN: 0. Cost: O(log n). */
TETCAST_DEF int tetcast_transfer_is_empty(const tetcast_transfer *transfer, float lo, float hi);

/* Least upper bounds over [lo, hi]. Cost: O(log n). */
TETCAST_DEF float tetcast_transfer_max_extinction(const tetcast_transfer *transfer, float lo, float hi);
TETCAST_DEF void tetcast_transfer_max_emission(const tetcast_transfer *transfer, float lo, float hi, float rgb[3]);

/* The range of values in which two functions differ: *lo > *hi if they are equal everywhere. For local updates of
   tables and for clusters whose picture may change. */
TETCAST_DEF void tetcast_transfer_difference(const tetcast_transfer *a, const tetcast_transfer *b, float *lo,
                                             float *hi);

/* ---- optics: what a ray adds up ---- */

typedef enum tetcast_model {
    TETCAST_MODEL_VOLUME = 0,     /* emission and absorption (default) */
    TETCAST_MODEL_EMISSION = 1,   /* emission only: order does not matter */
    TETCAST_MODEL_ABSORPTION = 2, /* absorption only of the background light: order does not matter */
    TETCAST_MODEL_MAXIMUM = 3,    /* largest emission along the ray, in units of the largest of the function */
    TETCAST_MODEL_ISOSURFACE = 4, /* isosurfaces only, translucent in the right order */
    TETCAST_MODEL_MIXED = 5,      /* volume and isosurfaces */
    TETCAST_MODEL_FORCE_32BIT = 0x7fffffff
} tetcast_model;

/* How the integral over one segment is computed, for TETCAST_MODEL_VOLUME and _MIXED (the volume part). All but EXACT
   are the methods of the thesis and of its time, for comparison. */
typedef enum tetcast_integrator {
    TETCAST_INTEGRATOR_EXACT = 0,       /* split at knots, then the integral itself (default) */
    TETCAST_INTEGRATOR_PSI_TABLE = 1,   /* split at knots, partial pre-integration with the 512 x 512 table of psi */
    TETCAST_INTEGRATOR_RIEMANN = 2,     /* post-classification at the front point of each of `samples` parts */
    TETCAST_INTEGRATOR_TRAPEZOID = 3,   /* mean of both ends of each of `samples` parts */
    TETCAST_INTEGRATOR_MIDPOINT = 4,    /* post-classification in the middle of each of `samples` parts */
    TETCAST_INTEGRATOR_PRE = 5,         /* pre-classification: colour and extinction linear between the ends */
    TETCAST_INTEGRATOR_PREFIX = 6,      /* prefix integrals, self-attenuation neglected */
    TETCAST_INTEGRATOR_TABLE_3D = 7,    /* table over (front, back, length), each entry integrated */
    TETCAST_INTEGRATOR_TABLE_INCREMENTAL = 8, /* the same table, each slice from the one before */
    TETCAST_INTEGRATOR_TABLE_SUBRANGE = 9,    /* the same table, shared partial sums along the diagonals */
    TETCAST_INTEGRATOR_TABLE_2D = 10,   /* equidistant steps across cells, table over (front, back) */
    TETCAST_INTEGRATOR_TABLE_PREFIX = 11, /* the 3D table from prefix integrals, self-attenuation neglected */
    TETCAST_INTEGRATOR_COUNT = 12,
    TETCAST_INTEGRATOR_FORCE_32BIT = 0x7fffffff
} tetcast_integrator;

typedef struct tetcast_light {
    float direction[3]; /* towards the light, need not be unit */
    float rgb[3];
} tetcast_light;

#define TETCAST_MAX_LIGHTS 8

/* field           zero means
   samples         1 part per segment (RIEMANN, TRAPEZOID, MIDPOINT)
   table_values    128 samples of the value axis; up to 2048
   table_lengths   64 slices (TABLE_3D and relatives); up to 1024
   longest         no table integrators; else the largest segment length that the table covers, longer ones are cut
   step            length of the steps of TABLE_2D; 0: longest / 4
   t_min           1/512: rays end when less light than this is left; < 0: never
   tolerance       0: exact; else the largest colour error in units of 1/255 that all shortcuts together may make; what
                   rounding does, about 0.005, is not less for smaller ones. With few knots only t_min depends on it
   path_length     longest way of a ray through the mesh, which tolerance needs; 0: tolerance only sets t_min
   light_count     one light from the eye
   cue             no depth cueing */
typedef struct tetcast_optics_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_model model;
    tetcast_integrator integrator;
    uint32_t samples;
    uint32_t table_values, table_lengths;
    float longest;
    float step;
    float t_min;
    float tolerance;
    float path_length;
    uint32_t cue;                  /* 1: depth cueing: colours times k(depth), and (1-k) of the fog colour */
    float cue_depth[2];            /* nearest and farthest depth, world units along the ray */
    float cue_scale[2];            /* k there, in [0, 1]; linear between, clamped outside */
    float fog[3];
    float ambient[3];              /* isosurfaces: light from everywhere */
    const tetcast_light *lights;   /* isosurfaces; up to TETCAST_MAX_LIGHTS; borrowed for the call */
    size_t light_count;
    uint32_t _end_zero;
} tetcast_optics_desc;

/* A transfer function, a model and an integrator, ready to use. Immutable. Keeps a copy of the transfer function. */
typedef struct tetcast_optics tetcast_optics;

typedef struct tetcast_optics_info {
    tetcast_model model;
    tetcast_integrator integrator;
    float t_min;                   /* < 0: rays never end early */
    uint32_t knot_count;           /* knots of the function that is integrated, after simplification */
    float bound;                   /* largest colour error in units of 1/255: the sum of the next three;
                                      < 0: nobody knows (sampling and tables) */
    float bound_integral;          /* the integral itself and the rounding of values and positions: an estimate */
    float bound_end, bound_knots;  /* ending early, knots left out: guaranteed */
    size_t table_bytes;
} tetcast_optics_info;

/* Prepare.
   transfer  may be destroyed afterwards
   desc      NULL: emission and absorption, exact
   Errors: INVALID_ARG (NaN, unknown enum, a table integrator without longest), RANGE (table too large), UNINIT_DESC,
   NO_MEMORY. Cost: microseconds; table integrators up to seconds and 16 bytes per entry. */
TETCAST_DEF tetcast_result tetcast_optics_create(const tetcast_transfer *transfer, const tetcast_optics_desc *desc,
                                                 tetcast_optics **out);
/* The same with another transfer function, as after an edit: table entries whose value range does not touch the
   difference are copied from `old`, the others are computed as tetcast_optics_create would. Same result, bit for
   bit. */
TETCAST_DEF tetcast_result tetcast_optics_update(const tetcast_optics *old, const tetcast_transfer *transfer,
                                                 const tetcast_optics_desc *desc, tetcast_optics **out);
TETCAST_DEF void tetcast_optics_destroy(tetcast_optics *optics); /* NULL is allowed */
TETCAST_DEF void tetcast_optics_get_info(const tetcast_optics *optics, tetcast_optics_info *info);

typedef struct tetcast_segment { /* a stretch of a ray on which the value is linear */
    float front, back; /* values; finite */
    float length;      /* >= 0, world units */
    float depth;       /* of the front point along the ray (depth cueing only) */
} tetcast_segment;

/* Integrate one ray given as segments from front to back: what the renderer does for each pixel.
   rgba    out: colour (associated) without background, and opacity. Background b shows as rgb + (1 - a) * b
   used    out: number of segments read before early termination; may be NULL
   Isosurfaces are shaded as if their normals pointed to the eye.
   Errors: INVALID_ARG. Thread safety: any number of threads. Allocates nothing. Cost: 3 to 10 ns per segment. */
TETCAST_DEF tetcast_result tetcast_optics_ray(const tetcast_optics *optics, const tetcast_segment *segments,
                                              size_t count, float rgba[4], size_t *used);

/* Integrate `count` segments, each by itself: rgba[i] is colour and opacity of segments[i]. Same bits as `count` calls
   of tetcast_optics_ray with one segment. isa AUTO: eight at a time where the processor can. */
TETCAST_DEF tetcast_result tetcast_optics_segments(const tetcast_optics *optics, const tetcast_segment *segments,
                                                   size_t count, tetcast_isa isa, float (*rgba)[4]);

/* ---- rays and pictures ---- */

/* A ray of the caller, in world units. */
typedef struct tetcast_ray {
    double org[3];
    double dir[3];        /* any length but 0; distances are in world units all the same */
    double t_min, t_max;  /* only what lies between these distances is seen; both 0: from 0 to infinity */
} tetcast_ray;

typedef struct tetcast_ray_result {
    float rgba[4];        /* colour, associated, and opacity */
    float length;         /* way inside of the mesh between t_min and t_max, as far as the ray went */
    float hit;            /* models with isosurfaces: distance to what is seen first (ISOSURFACE: the point on the
                             surface, MIXED: the cell); INFINITY: nothing, or no isosurfaces */
    uint32_t steps;       /* tetrahedra it passed */
    uint32_t walks;       /* times it entered the mesh */
} tetcast_ray_result;

/* One tetrahedron on a ray. The value is linear from front to back. */
typedef struct tetcast_crossing {
    uint32_t cell;
    double t_front, t_back;       /* distances from the ray's origin; t_front <= t_back */
    float front, back;            /* values */
} tetcast_crossing;

/* A pinhole, or parallel rays. Right-handed coordinates; `up` need not be at right angles to the view. */
typedef struct tetcast_camera {
    double eye[3], at[3];
    double up[3];         /* all zero: +y */
    float fov_y;          /* vertical angle in degrees, below 180; 0: 40 */
    float ortho_height;   /* > 0: parallel rays instead; height of the picture in world units */
} tetcast_camera;

/* How a picture is made. Both show the same: the same cells on every ray, the same integrals; depths and values differ
   by rounding. Walking costs for each cell on each ray, projection for each cell and, less, for each pixel of it; but
   pixels with isosurfaces, values per cell, masked cells or a depth are four times as slow in projection. */
typedef enum tetcast_method {
    TETCAST_METHOD_AUTO = 0,     /* what is faster for this many pixels per cell, as a rule */
    TETCAST_METHOD_WALK = 1,     /* each ray from cell to cell */
    TETCAST_METHOD_PROJECT = 2,  /* each cell onto the picture; fragments are put in order pixel by pixel */
    TETCAST_METHOD_FORCE_32BIT = 0x7fffffff
} tetcast_method;

/* field            zero means
   camera           (eye equals at) one that frames everything
   method           whatever is faster. PROJECT needs the tets, and pictures of at most 65536 pixels a side
   isa              the best that the machine has; all give the same bits
   clip_near        nothing is cut off in front of the eye; else world distance along the viewing axis
   clip_far         nothing is cut off behind
   background       transparent; linear RGB, premultiplied, and alpha
   smooth_normals   isosurfaces are shaded by the gradient of each cell. 1: by the gradients of the vertices,
                    interpolated (tetcast_mesh_make_gradients has to be called before)
   traverse_only    off. 1: walk through all cells without integrating, for measuring
   no_leaping       leap over clusters of cells that the transfer function hides, where that pays */
typedef struct tetcast_render_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_camera camera;
    tetcast_method method;
    tetcast_isa isa;
    float clip_near, clip_far;
    float background[4];
    uint32_t smooth_normals;
    uint32_t traverse_only;
    uint32_t no_leaping;
    uint32_t _end_zero;
} tetcast_render_desc;

/* Buffers of the caller, row 0 on top; any may be NULL. Strides in bytes, 0: rows lie close together. */
typedef struct tetcast_image {
    uint32_t width, height;
    uint8_t *rgba8;        /* sRGB, not premultiplied; alpha = opacity */
    float *rgba;           /* linear, premultiplied */
    /* along the viewing axis, of the first cell that is not empty; INFINITY where there is none */
    float *depth;
    float *length;         /* way inside of the mesh, world units */
    uint32_t *steps;       /* tetrahedra passed */
    size_t rgba8_stride, rgba_stride, depth_stride, length_stride, steps_stride;
} tetcast_image;

typedef struct tetcast_render_stats { /* added to */
    uint64_t rays;         /* of the picture */
    uint64_t hit_rays;     /* that met the mesh */
    uint64_t walks;        /* times a ray entered the mesh */
    uint64_t steps;        /* tetrahedra passed */
    uint64_t hull_tests;   /* pairs of hull face and pixel that were tested */
    uint64_t ended;        /* rays that ended early */
    uint64_t lanes;        /* places for a ray in all steps of the SIMD walker: steps / lanes is its occupancy */
    uint64_t leapt_faces;  /* faces of clusters that took part as hull */
    uint64_t cells;        /* projected: cells that can be in the picture */
    uint64_t pixel_tests;  /* projected: pairs of cell and pixel that were tested; steps: those that met */
    uint64_t exact_tests;  /* of these: decided by the walker's signs */
    float pixels_per_cell; /* as estimated for TETCAST_METHOD_AUTO, of cells in the picture; 0: not needed */
    tetcast_method method; /* what was used */
    tetcast_isa isa;       /* what was used */
} tetcast_render_stats;

/* Set eye and at so that the box fills the picture; keeps up, fov_y; with ortho_height > 0 sets that as well.
   view  from the object towards the eye, any length; NULL: from the front, a little from above and the right */
TETCAST_DEF tetcast_result tetcast_camera_fit(tetcast_camera *camera, const double box_min[3], const double box_max[3],
                                              const double view[3], uint32_t width, uint32_t height);

/* The ray through point (x, y) of the picture plane, in pixels from its upper left corner: (i+0.5, j+0.5) is the
   centre of pixel (i, j). dir is a unit vector. */
TETCAST_DEF tetcast_result tetcast_camera_ray(const tetcast_camera *camera, uint32_t width, uint32_t height, double x,
                                              double y, tetcast_ray *out_ray);

/* Draw.
   desc    NULL: all defaults
   optics  transfer function, model and integrator
   stats   may be NULL
   Rays walk through the mesh from cell to cell; every decision is the exact sign of a determinant of the vertices as
   the ray sees them, rounded once, so a ray can get lost nowhere: not in vertices, edges or faces, not in flat,
   inverted or tangled cells.
   The same bits for any number of threads and any isa. Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY, CANCELLED (then the
   picture is incomplete). Thread safety: any number of calls on one mesh. */
TETCAST_DEF tetcast_result tetcast_render(const tetcast_render_desc *desc, const tetcast_mesh *mesh,
                                          const tetcast_optics *optics, const tetcast_image *image,
                                          tetcast_render_stats *stats);

/* Follow single rays. desc: env, isa and smooth_normals count. optics NULL: only length, steps and walks.
   Rays that are not finite or have no direction give zeros and no hit. Cost: O(log(hull faces)) and the cells on the
   way. */
TETCAST_DEF tetcast_result tetcast_cast(const tetcast_render_desc *desc, const tetcast_mesh *mesh,
                                        const tetcast_optics *optics, const tetcast_ray *rays, size_t count,
                                        tetcast_ray_result *results, tetcast_render_stats *stats);

/* Call fn for every tetrahedron on a ray, front to back; fn returns non-zero to stop. Returns how many there were. */
TETCAST_DEF uint64_t tetcast_probe(const tetcast_mesh *mesh, const tetcast_ray *ray,
                                   int (*fn)(void *user, const tetcast_crossing *crossing), void *user);

/* Gradients at the vertices for smooth_normals, of the active field: means over the cells around, weighted by volume.
   12 bytes a vertex. Needs the tets. Not while another thread uses the mesh. */
TETCAST_DEF tetcast_result tetcast_mesh_make_gradients(tetcast_mesh *mesh, const tetcast_env *env);

/* ---- isosurfaces as triangles ---- */

/* field        zero means
   isovalue     0
   normals      off. 1: unit normals at the vertices, towards smaller values: interpolated gradients where
                tetcast_mesh_make_gradients was called, else the mean of the triangles around (among flat triangles
                only: the direction of the edge)
   cells        off. 1: the cell that each triangle lies in */
typedef struct tetcast_surface_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    float isovalue;
    uint32_t normals;
    uint32_t cells;
    uint32_t _end_zero;
} tetcast_surface_desc;

/* Triangles, counter-clockwise seen from the side of smaller values. One vertex for each edge of the mesh that crosses
   the isovalue: the surface is closed inside of the mesh, and its border lies in the hull. */
typedef struct tetcast_surface {
    double origin[3];           /* world position = origin + positions */
    float *positions;           /* xyz per vertex */
    float *normals;             /* NULL: not asked for */
    uint32_t *indices;          /* 3 per triangle */
    uint32_t *cells;            /* 1 per triangle; NULL: not asked for */
    uint32_t vertex_count, triangle_count;
    uint32_t flat_count;        /* triangles without area, where a vertex of the mesh has just the isovalue */
    tetcast_allocator _allocator;
} tetcast_surface;

/* Marching tetrahedra over the active field, which has to be one per vertex.
   mesh  needs its tets
   out   free with tetcast_surface_free; cleared on error. No triangle at all is no error
   A vertex counts as inside when its value is at least the isovalue, as for rays. Masked cells and cells with a value
   that is no number are left out. The same surface for any number of threads. Cost: about 10 ns a cell.
   Errors: INVALID_ARG (field per cell, isovalue not finite, tets dropped), RANGE (more than 2^32 vertices or
   triangles), UNINIT_DESC, NO_MEMORY, CANCELLED. Thread safety: any number of calls on one mesh. */
TETCAST_DEF tetcast_result tetcast_isosurface(const tetcast_surface_desc *desc, const tetcast_mesh *mesh,
                                              tetcast_surface *out);
TETCAST_DEF void tetcast_surface_free(tetcast_surface *surface); /* NULL and cleared ones are allowed */

/* ---- resampling: tetrahedra onto lattices, cuts (TETCAST_NO_BRICKS leaves out all from here to misc) ---- */
#ifndef TETCAST_NO_BRICKS

/* A regular lattice of nodes: node (i, j, k) stands at origin + (i*spacing[0], j*spacing[1], k*spacing[2]), world. */
typedef struct tetcast_lattice {
    uint32_t dims[3];      /* nodes, at most 2^20 a side */
    double origin[3];
    double spacing[3];     /* > 0 */
} tetcast_lattice;

/* field        zero means
   isa          the best that the machine has; all give the same bits
   axis         the rows of a cell run along the longest side of its box; 1, 2, 3: along x, y, z
   extend       nodes outside of the mesh are NaN. 1: those within one spacing of the mesh have the linear function of a
                cell nearby, so that trilinear interpolation is valid up to the hull
   fill         what nodes outside are instead of NaN, where use_fill is 1 */
typedef struct tetcast_resample_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_isa isa;
    uint32_t axis;
    uint32_t extend;
    uint32_t use_fill;
    float fill;
    uint32_t _end_zero;
} tetcast_resample_desc;

typedef struct tetcast_resample_stats { /* added to */
    uint64_t cells;        /* with a box that holds a node */
    uint64_t flat;         /* left out: no volume */
    uint64_t rows;         /* rows of nodes in the boxes of cells */
    uint64_t hit_rows;     /* of these: with a node inside of the cell */
    uint64_t writes;       /* nodes inside of cells; those between cells count for each */
    uint64_t covered;      /* nodes inside of the mesh */
    uint64_t extended;     /* nodes outside with a value */
} tetcast_resample_stats;

/* A lattice that holds a mesh: `longest` nodes along the longest side, cubes as cells, a node on the lower corner. */
TETCAST_DEF tetcast_result tetcast_lattice_fit(const tetcast_mesh *mesh, uint32_t longest, tetcast_lattice *out);

/* Evaluate the active field at the nodes of a lattice.
   desc    NULL: all defaults
   mesh    needs its tets
   out     dims[0] * dims[1] * dims[2] floats, x fastest
   stats   may be NULL
   A node is inside of a cell when it is on the inner side of its four faces, or nearer to them than 1e-13 of the cell's
   box: no node between cells is lost. Both cells at a face have the same numbers for it. Of several cells that hold a
   node the last one in the mesh's order counts. The same bits for any number of threads and any isa.
   Cost: about 0.1 us a cell, 5 ns a row of a cell's box, and the nodes. Errors: INVALID_ARG (tets dropped, lattice),
   RANGE, UNINIT_DESC, NO_MEMORY. Thread safety: any number of calls on one mesh.
   Source: the thesis, chapter 7 (scanlines along the longest side, spans from four half spaces). */
TETCAST_DEF tetcast_result tetcast_resample(const tetcast_resample_desc *desc, const tetcast_mesh *mesh,
                                            const tetcast_lattice *lattice, float *out, tetcast_resample_stats *stats);

/* A plane: points origin + x * u + y * v. u and v span it; they need not be at right angles nor unit. */
typedef struct tetcast_plane {
    double origin[3];
    double u[3], v[3];
} tetcast_plane;

/* The active field on a plane: value of point origin + (i+0.5)/width * u + (j+0.5)/height * v in out[j*width + i]; NaN
   outside of the mesh. The same rule for points between cells as tetcast_resample. Needs the tets. Serial.
   Cost: a distance for each vertex, then 0.1 us for each cell that the plane meets, and the points in them. */
TETCAST_DEF tetcast_result tetcast_plane_sample(const tetcast_env *env, const tetcast_mesh *mesh,
                                                const tetcast_plane *plane, uint32_t width, uint32_t height,
                                                float *out);

/* The polygons in which a plane cuts the cells. Free with tetcast_section_free. */
typedef struct tetcast_section {
    double (*points)[3];     /* world */
    float *values;           /* per point */
    uint32_t *first;         /* polygon i has the points first[i] .. first[i+1]-1, 3 or 4, in order around it */
    uint32_t *cells;         /* per polygon */
    uint32_t point_count, polygon_count;
    double area;             /* sum over all polygons */
    tetcast_allocator _allocator;
} tetcast_section;

/* Cut: all cells through which the plane goes, in the mesh's order. A vertex in the plane counts as behind it, so two
   cells at a face in the plane give one polygon. Field per vertex. Errors: INVALID_ARG, RANGE (2^31 points),
   NO_MEMORY. */
TETCAST_DEF tetcast_result tetcast_plane_section(const tetcast_env *env, const tetcast_mesh *mesh,
                                                 const tetcast_plane *plane, tetcast_section *out);
TETCAST_DEF void tetcast_section_free(tetcast_section *section); /* NULL and cleared ones are allowed */

/* ---- bricks: a volume as blocks of nodes on levels, each twice as coarse as the one before ---- */

#define TETCAST_BRICK_LEVELS 6

/* field        zero means
   log_cells    bricks of 2^4 cells a side, 17^3 nodes; 3, 4 or 5
   levels       as many as there can be: log_cells + 1
   storage      TETCAST_TYPE_F32, _F16, _U16 or _U8. Integers share one scale over the whole volume, so that neighbours
                agree in the nodes that they share; an integer is off by at most half a step of it
   max_error    everything is kept on all levels. > 0: in units of the values; a brick has no finer ones below it where
                it is nearer than this to the finest level
   nearest      coarser levels are made with the quadratic B-spline (1 4 6 4 1)/16; 1: every other node (always so with
                max_error, and from meshes: nodes of all levels then lie on the field itself)
   longest      from meshes: as fine as max_error asks for, up to longest_end nodes; else nodes along the longest side
   longest_end  4097
   checks       from meshes: random points at which the error is looked at, besides all vertices: 200000 */
typedef struct tetcast_bricks_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    uint32_t log_cells;
    uint32_t levels;
    tetcast_type storage;
    float max_error;
    uint32_t nearest;
    uint32_t longest, longest_end;
    uint32_t checks;
    uint32_t _end_zero;
} tetcast_bricks_desc;

typedef struct tetcast_bricks_report {
    uint64_t bad_values;       /* of a grid: no numbers, replaced by the smallest value */
    uint64_t checks;           /* of a mesh: places at which bricks and mesh were compared: vertices, random points */
    uint64_t above;            /* of these: farther apart than max_error */
    double error, mean_error;  /* largest and mean difference there */
    double worst[3];           /* where the largest is, world */
    uint32_t tries;            /* lattices that were tried */
} tetcast_bricks_report;

typedef struct tetcast_bricks tetcast_bricks; /* immutable: any number of threads may use it */

typedef struct tetcast_bricks_info {
    tetcast_lattice lattice;   /* of the finest level */
    uint32_t levels, cells;    /* cells: of a brick along a side */
    uint32_t slots[3];         /* bricks of the finest level along each side */
    tetcast_type storage;
    float value_min, value_max;
    float step;                /* of integers */
    uint64_t bricks, nodes;    /* stored, all levels */
    uint64_t leaves;           /* bricks without finer ones below */
    uint64_t level_bricks[TETCAST_BRICK_LEVELS];
    uint64_t hull_triangles;   /* of the mesh that it was made from */
    uint64_t bytes;
} tetcast_bricks_info;

/* Bricks from nodes of a lattice, x fastest. Errors: INVALID_ARG, RANGE, UNINIT_DESC, NO_MEMORY. Cost: about 10 ns a
   node, one core; holds the nodes twice. */
TETCAST_DEF tetcast_result tetcast_bricks_create_grid(const tetcast_bricks_desc *desc, const tetcast_lattice *lattice,
                                                      const tetcast_array *values, tetcast_bricks_report *report,
                                                      tetcast_bricks **out);
/* Bricks from the active field of a mesh. The hull goes along: pictures end where the mesh does. With max_error the
   result is compared with the mesh afterwards, at all vertices and at random points, and made on a lattice four times as
   fine as long as it fails and longest_end allows; report->above tells what is left. Needs the tets.
   Source: the thesis, chapter 7.0 (resampling as the core of an adaptive hierarchy); refinement and its check are ours. */
TETCAST_DEF tetcast_result tetcast_bricks_create_mesh(const tetcast_bricks_desc *desc, const tetcast_mesh *mesh,
                                                      tetcast_bricks_report *report, tetcast_bricks **out);
TETCAST_DEF void tetcast_bricks_destroy(tetcast_bricks *bricks); /* NULL is allowed */
TETCAST_DEF void tetcast_bricks_get_info(const tetcast_bricks *bricks, tetcast_bricks_info *info);

/* Bytes of a .brk file, and the file. data has room for tetcast_bricks_file_size bytes. */
TETCAST_DEF size_t tetcast_bricks_file_size(const tetcast_bricks *bricks);
TETCAST_DEF tetcast_result tetcast_bricks_write(const tetcast_bricks *bricks, void *data, size_t size);
/* From a file in memory, which is checked completely. Errors: TRUNCATED, FORMAT, VERSION, CHECKSUM, RANGE, NO_MEMORY;
   error->where is the byte. */
TETCAST_DEF tetcast_result tetcast_bricks_read(const tetcast_env *env, const void *data, size_t size,
                                               tetcast_bricks **out);

/* Which level is shown where, in slots: the places of the finest bricks.
   field        zero means
   level        the finest that there is; else no finer than this
   levels       none; else one level per slot, x fastest, clamped to what there is
   focus,       none; else (focus_radius > 0) the finest level within this distance of the point, world, and one level
   focus_radius coarser for each further radius: the rule of the thesis
   byte_budget  none; else start with the coarsest everywhere and refine where the error is largest while the bricks take
                no more bytes than this
   sample_budget none; else the same while a ray through everything takes no more than this share of the samples that
                the finest level takes
   max_error    0; else stop refining where the error is no larger
   max_jump     any. 1: neighbours differ by one level at most, as in the thesis; by refining
   optics       errors count as they are; else bricks whose values it does not show have none */
typedef struct tetcast_cut_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    uint32_t level;
    const uint8_t *levels;
    double focus[3];
    double focus_radius;
    uint64_t byte_budget;
    double sample_budget;
    float max_error;
    uint32_t max_jump;
    const tetcast_optics *optics;
    uint32_t _end_zero;
} tetcast_cut_desc;

typedef struct tetcast_cut_info {
    uint64_t bricks;           /* shown */
    uint64_t adapted;          /* of these: with nodes of their border moved onto a coarser neighbour */
    uint64_t bytes, full_bytes; /* of the bricks shown; of the finest everywhere */
    double samples;            /* share of the samples of the finest level */
    uint64_t level_slots[TETCAST_BRICK_LEVELS];
    float error;               /* largest error of a brick shown, as stored */
} tetcast_cut_info;

/* A choice of levels and the borders that make it continuous. Borrows the bricks; immutable. */
typedef struct tetcast_cut tetcast_cut;

/* Choose levels and adapt borders: a node at which a finer brick touches a coarser one takes the value that the coarser
   one has there; all 26 neighbours, coarse before fine, so any difference of levels is continuous to rounding. The
   bricks are not changed: those with adapted nodes are copied as floats.
   desc    NULL: the finest everywhere. Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY.
   Cost: about 10 us for each brick that is adapted. Source: the thesis, 8.1.2, which adapts to one level coarser. */
TETCAST_DEF tetcast_result tetcast_cut_create(const tetcast_cut_desc *desc, const tetcast_bricks *bricks,
                                              tetcast_cut **out);
TETCAST_DEF void tetcast_cut_destroy(tetcast_cut *cut); /* NULL is allowed */
TETCAST_DEF void tetcast_cut_get_info(const tetcast_cut *cut, tetcast_cut_info *info);
/* Level of each slot, x fastest: slots[0] * slots[1] * slots[2] bytes. */
TETCAST_DEF const uint8_t *tetcast_cut_levels(const tetcast_cut *cut);

/* Trilinear values at points of the finest lattice (node (i, j, k) is at x = i, y = j, z = k), clamped to it.
   isa AUTO: eight at a time where the machine can; the same bits. Any thread. About 3 ns a point. */
TETCAST_DEF void tetcast_cut_sample(const tetcast_cut *cut, const float *x, const float *y, const float *z, size_t count,
                                    tetcast_isa isa, float *out);
/* The same with the gradient of the trilinear function, per world unit. */
TETCAST_DEF void tetcast_cut_gradient(const tetcast_cut *cut, const float *x, const float *y, const float *z,
                                      size_t count, float *out, float (*gradient)[3]);

/* ---- clipping: planes and closed meshes ---- */

typedef struct tetcast_clip_plane { double normal[3], offset; } tetcast_clip_plane; /* kept: normal . p >= offset */

/* A closed triangle mesh; world. A ray is inside between its hits number 1 and 2, 3 and 4, ...; where the mesh is not
   closed and their number is odd the last one does not count. */
typedef struct tetcast_clip_body {
    const double (*points)[3];
    size_t point_count;
    const uint32_t *indices;   /* 3 per triangle */
    size_t triangle_count;
    uint32_t outside;          /* 0: what is inside is kept; 1: what is outside */
} tetcast_clip_body;

typedef struct tetcast_clip_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    const tetcast_clip_plane *planes;
    size_t plane_count;
    const tetcast_clip_body *bodies;  /* one after the other */
    size_t body_count;
    uint32_t _end_zero;
} tetcast_clip_desc;

#define TETCAST_CLIP_SPANS 32 /* parts of one ray; what is behind them is not seen */

typedef struct tetcast_clip tetcast_clip; /* immutable */

/* Errors: INVALID_ARG (index out of range, no number), NO_MEMORY. Cost: O(n log n). */
TETCAST_DEF tetcast_result tetcast_clip_create(const tetcast_clip_desc *desc, tetcast_clip **out);
TETCAST_DEF void tetcast_clip_destroy(tetcast_clip *clip); /* NULL is allowed */
/* The parts of a ray that are kept, in order: distances in world units. Returns how many. Signs of areas decide, from
   both sides of an edge the same: a ray between two triangles hits just one of them. */
TETCAST_DEF uint32_t tetcast_clip_spans(const tetcast_clip *clip, const tetcast_ray *ray,
                                        double spans[TETCAST_CLIP_SPANS][2]);

/* ---- shaders: what a stretch of a ray looks like, as a function of the caller ---- */

enum { /* what a shader asks for; front, back, length are always there */
    TETCAST_NEED_GRADIENT = 1, /* of the value, in the middle of the segment, per world unit */
    TETCAST_NEED_POSITION = 2, /* of its middle, world */
    TETCAST_NEED_DIRECTION = 4,
    TETCAST_NEED_DEPTH = 8     /* distance of its front from the ray's origin */
};

/* Eight segments of eight rays; those whose bit in mask is 0 hold nothing. Strangers in a packet change nothing. */
typedef struct tetcast_packet {
    uint32_t mask;
    float front[8], back[8], length[8], depth[8];
    float gradient[3][8], position[3][8], direction[3][8];
    uint8_t level[8];          /* of the brick; 0 in meshes */
} tetcast_packet;

/* Parameters by name: numbers of the caller, borrowed. */
typedef struct tetcast_param {
    const char *name;
    const float *values;
    size_t count;
} tetcast_param;

/* user      what the functions get
   needs     TETCAST_NEED_*
   params    for prepare_fn
   prepare_fn NULL, or called once before the picture, by one thread; what it returns ends the call if it is no
             TETCAST_OK. tetcast_params_find reports a parameter that is missing by its name
   shade_fn  colour, premultiplied, and opacity of each segment: rgba[0..2][lane], rgba[3][lane]. Called by several
             threads at once; what it does for a lane depends on that lane only
   empty_fn  NULL, or 1 if nothing is seen of values in [lo, hi]: such bricks are skipped */
typedef struct tetcast_shader {
    void *user;
    uint32_t needs;
    const tetcast_param *params;
    size_t param_count;
    tetcast_result (*prepare_fn)(void *user, const tetcast_param *params, size_t count, tetcast_error *error);
    void (*shade_fn)(void *user, const tetcast_packet *in, float rgba[4][8]);
    int (*empty_fn)(void *user, float lo, float hi);
} tetcast_shader;

/* A parameter with at least `least` numbers; NULL: it is not there, and *error says which. */
TETCAST_DEF const float *tetcast_params_find(const tetcast_param *params, size_t count, const char *name, size_t least,
                                             tetcast_error *error);

/* ---- pictures of bricks ---- */

/* field        zero means
   camera       (eye equals at) one that frames everything
   isa          the best that the machine has; all give the same bits
   clip_near, clip_far, background: as in tetcast_render_desc
   step         distance of samples in cells of the finest level: 1. A brick of level k has 2^k times that; samples lie at
                whole multiples of its step on every ray, and where the ray enters and leaves: lengths are exact
   fixed_step   0. 1: the same step on all levels
   clip         nothing; applies before the hull of the mesh
   no_hull      0. 1: do not end at the hull that came with the bricks
   shader       none: the optics. Else its functions instead, front to back, until less than 1/512 of the light is left
   frame        the picture is everything; else the image is the part of a frame of this size whose upper left pixel is
   part         `part`: the same bits as in the whole frame
   limit        none; else depths along the viewing axis, one per pixel of the image: nothing is seen behind them */
typedef struct tetcast_brick_render_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_camera camera;
    tetcast_isa isa;
    float clip_near, clip_far;
    float background[4];
    float step;
    uint32_t fixed_step;
    const tetcast_clip *clip;
    uint32_t no_hull;
    const tetcast_shader *shader;
    uint32_t frame[2], part[2];
    const float *limit;
    uint32_t _end_zero;
} tetcast_brick_render_desc;

/* Cast rays through a cut. optics may be NULL where there is a shader. In the image: steps counts samples, depth is where
   something is seen first. stats: rays, hit_rays, steps (samples), walks (bricks with samples), ended, lanes.
   The same bits for any number of threads and any isa. Errors: as tetcast_render; what a shader's prepare_fn returns.
   Source: the thesis, 8.2, draws slices 2^k apart and repairs the opacity of pieces that overlap or are missing at
   borders; here lengths are exact, so nothing has to be repaired. */
TETCAST_DEF tetcast_result tetcast_render_bricks(const tetcast_brick_render_desc *desc, const tetcast_cut *cut,
                                                 const tetcast_optics *optics, const tetcast_image *image,
                                                 tetcast_render_stats *stats);
#endif /* TETCAST_NO_BRICKS */

#ifndef TETCAST_NO_RBF
/* ---- radial basis functions ---- */

/* A field as a sum: f(x) = base(x) + sum over i of weight_i * phi(d_i), where d_i is the distance of x from centre_i and
   base a coarse grid of nodes with trilinear interpolation between them, or one constant. Distances are measured in
   kernel space: world coordinates divided axis by axis by a metric. There are up to four components, each with a weight
   of its own; they share centres and widths. Defined everywhere, meant for its box.
   GAUSS          (exp(-d^2 / 2 w^2) - e) / (1 - e) up to the radius cut * w, where it is 0: no jump there; e is what
                  the Gaussian is there. The default, and what the encoder fits
   GAUSS_CUT      the thesis' truncated Gaussian: exp(-d^2 / 2 w^2) where |weight| times that is above epsilon, else 0
   WENDLAND2, WENDLAND4   (1-q)^4 (4q+1) and (1-q)^6 (35q^2+18q+3)/3, q = d / R, with R = 3.70 w and 4.22 w: like a
                  Gaussian of that width, C2 and C4 everywhere
   POWER          (1 - d^2 / R^2)^8 with R = 4.21 w: like a Gaussian, needs neither root nor exponential */
typedef enum tetcast_kernel {
    TETCAST_KERNEL_GAUSS = 0,
    TETCAST_KERNEL_GAUSS_CUT = 1,
    TETCAST_KERNEL_WENDLAND2 = 2,
    TETCAST_KERNEL_WENDLAND4 = 3,
    TETCAST_KERNEL_POWER = 4,
    TETCAST_KERNEL_COUNT = 5,
    TETCAST_KERNEL_FORCE_32BIT = 0x7fffffff
} tetcast_kernel;

#define TETCAST_RBF_MAX_COMPONENTS 4
#define TETCAST_RBF_MAX_FUNCTIONS 0x4000000u /* 2^26 */
#define TETCAST_RBF_MAX_NODES 0x8000000u     /* of the base grid, 2^27 */

typedef struct tetcast_rbf_function {
    double centre[3];   /* world */
    double width;       /* in kernel space, > 0 */
    float weight[TETCAST_RBF_MAX_COMPONENTS];
} tetcast_rbf_function;

/* field           zero means
   box_min, box_max  have to be given
   metric          1 1 1: kernel space is the world
   components      1
   kernel          shifted Gaussian
   cut             3.5 widths (GAUSS); 1 .. 8
   epsilon         1e-3 of the largest weight (GAUSS_CUT)
   base_dims       no base grid: base is `offset`
   base            nodes of the base grid, x fastest, components of a node together, in the whole box */
typedef struct tetcast_rbf_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    double box_min[3], box_max[3];
    double metric[3];
    uint32_t components;
    tetcast_kernel kernel;
    float cut;
    float epsilon;
    float offset[TETCAST_RBF_MAX_COMPONENTS];
    const tetcast_rbf_function *functions; /* borrowed */
    size_t function_count;
    uint32_t base_dims[3];
    const float *base;                     /* borrowed */
    uint32_t _end_zero;
} tetcast_rbf_desc;

/* A sum of functions, immutable: any number of threads may use it. */
typedef struct tetcast_rbf tetcast_rbf;

typedef struct tetcast_rbf_info {
    uint32_t components, function_count;
    uint32_t base_dims[3];
    tetcast_kernel kernel;
    float cut, epsilon;
    double box_min[3], box_max[3], metric[3];
    double smallest_width, largest_width;     /* kernel space */
    float largest_weight;
    float range[2];            /* of the data it was fitted to (vectors: of their length); 0 0: not known */
    float max_error, mean_error; /* at that data, as shares of the range; -1: not known */
    uint64_t file_bytes;       /* what tetcast_rbf_save_memory writes */
    uint64_t memory_bytes;
    uint32_t cells;            /* leaves of the octree over the functions */
    uint32_t longest_list;     /* functions in a leaf */
    double mean_list;          /* of the leaves, weighted by volume inside of the box */
} tetcast_rbf_info;

/* Make a model from functions. Those with a weight that is 0 (or, cut off, at most epsilon) are kept and add nothing.
   out  free with tetcast_rbf_destroy; NULL on failure
   Errors: INVALID_ARG (box, metric, cut, a function or node that is not finite, a width outside of 1e-6 .. 1e6 times
   the box; error->where is its index), RANGE, UNINIT_DESC, NO_MEMORY. Cost: O(n log n). */
TETCAST_DEF tetcast_result tetcast_rbf_create(const tetcast_rbf_desc *desc, tetcast_rbf **out);
TETCAST_DEF void tetcast_rbf_destroy(tetcast_rbf *rbf); /* NULL is allowed */
TETCAST_DEF void tetcast_rbf_get_info(const tetcast_rbf *rbf, tetcast_rbf_info *info);
/* 0: there is no such function. Functions are in the order of a Morton curve through their centres. */
TETCAST_DEF int tetcast_rbf_get_function(const tetcast_rbf *rbf, uint32_t index, tetcast_rbf_function *out);

/* Files (docs/formats.md). Fitted models are written as they are kept: bits of positions, widths, weights and nodes by
   what the tolerance needs; others as 32-bit floats. Reading gives the same model, bit for bit.
   save: buffer NULL: only *out_size. Errors: INVALID_ARG, RANGE (capacity too small; *out_size is what is needed).
   load: everything is checked, whatever the bytes are. Errors: INVALID_ARG, TRUNCATED, FORMAT, VERSION, CHECKSUM,
   RANGE, NO_MEMORY, IO; env.error has the byte. env may be NULL. */
TETCAST_DEF tetcast_result tetcast_rbf_save_memory(const tetcast_rbf *rbf, void *buffer, size_t capacity,
                                                   size_t *out_size);
TETCAST_DEF tetcast_result tetcast_rbf_load_memory(const tetcast_env *env, const void *data, size_t size,
                                                   tetcast_rbf **out);
#ifndef TETCAST_NO_STDIO
TETCAST_DEF tetcast_result tetcast_rbf_save_file(const tetcast_rbf *rbf, const tetcast_env *env, const char *path);
TETCAST_DEF tetcast_result tetcast_rbf_load_file(const tetcast_env *env, const char *path, tetcast_rbf **out);
#endif

/* How to compute. field  zero means
   isa          the best that the machine has; all give the same bits
   all          off. 1: sum over all functions instead of those whose reach touches the cell; the same bits */
typedef struct tetcast_rbf_eval_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_isa isa;
    uint32_t all;
    uint32_t _end_zero;
} tetcast_rbf_eval_desc;

/* Values and derivatives at points.
   desc       NULL: all defaults
   positions  in, [count][3], world. One that is not finite gives NaN
   values     out, [count][components], or NULL
   jacobians  out, [count][components][3]: derivative of each component along x, y, z; or NULL
   Outside of the box the base is that of the nearest point of the box. Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY.
   Cost: 0.3 to 0.5 ns a point and function of its cell. */
TETCAST_DEF tetcast_result tetcast_rbf_eval(const tetcast_rbf_eval_desc *desc, const tetcast_rbf *rbf,
                                            const double *positions, size_t count, float *values, float *jacobians);

/* Values on a grid over the box, [dims[2]][dims[1]][dims[0]][components]; nodes on the faces of the box, in the middle
   where dims is 1. */
TETCAST_DEF tetcast_result tetcast_rbf_grid(const tetcast_rbf_eval_desc *desc, const tetcast_rbf *rbf,
                                            const uint32_t dims[3], float *values);

/* Bounds of a component in a box (world): *lo <= f <= *hi everywhere in it, and |gradient| <= *gradient, world units.
   Any of the three may be NULL. GAUSS_CUT has no bounded gradient: that of its smooth parts is given.
   Cost: O(functions). Errors: INVALID_ARG. */
TETCAST_DEF tetcast_result tetcast_rbf_bounds(const tetcast_rbf *rbf, uint32_t component, const double box_min[3],
                                              const double box_max[3], float *lo, float *hi, float *gradient);

/* What can be seen in the Jacobian of a flow. */
typedef struct tetcast_flow {
    float speed;
    float vorticity[3];
    float lambda2;     /* middle eigenvalue of S^2 + W^2 (symmetric and antisymmetric part): < 0 in the core of a vortex */
    float helicity;    /* velocity . vorticity */
} tetcast_flow;

/* velocity [3], jacobian [3][3] as tetcast_rbf_eval gives them. No NaN for finite input. */
TETCAST_DEF void tetcast_flow_features(const float velocity[3], const float jacobian[9], tetcast_flow *out);

/* Data to fit: values at points, scattered or vertices of a grid. Borrowed for the call. */
typedef struct tetcast_rbf_points {
    tetcast_array positions;   /* elements of three numbers; data NULL: a uniform grid, x fastest */
    tetcast_array values;      /* elements of `components` numbers */
    size_t count;              /* of points */
    uint32_t components;       /* 1 .. 4; several: a vector, its error is the length of the difference */
    uint32_t dims[3];          /* of the grid; count is their product */
    double origin[3], spacing[3]; /* of the grid; spacing all 0: 1 */
    const uint32_t *tets;      /* four points each: what lies between scattered points, for checking; or NULL */
    size_t tet_count;
} tetcast_rbf_points;

typedef enum tetcast_rbf_method {
    TETCAST_RBF_METHOD_HYBRID = 0,  /* coarse grid, then functions for what is left (default) */
    TETCAST_RBF_METHOD_PURE = 1,    /* functions only */
    TETCAST_RBF_METHOD_FORCE_32BIT = 0x7fffffff
} tetcast_rbf_method;

/* field          zero means
   max_error      0.05: largest error at the points, as a share of the range of the values (vectors: of the greatest
                  length)
   mean_error     whatever it comes to
   kernel         shifted Gaussian; not GAUSS_CUT
   cut            3.5
   metric         world for scattered points, the spacing (over the smallest one) for grids
   base_dims      chosen by trial
   sweeps         3 rounds in which functions are fitted again, one after the other, and dropped where they are not
                  needed; 0xffffffff: none
   max_functions  2^26
   compare        off. 1: report what plain grids need for the same error
   isa            the best; all give the same model */
typedef struct tetcast_rbf_fit_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_rbf_method method;
    float max_error, mean_error;
    tetcast_kernel kernel;
    float cut;
    double metric[3];
    uint32_t base_dims[3];
    uint32_t sweeps;
    uint32_t max_functions;
    uint32_t compare;
    tetcast_isa isa;
    uint32_t _end_zero;
} tetcast_rbf_fit_desc;

/* Errors are shares of the range, measured with the model as it is stored. */
typedef struct tetcast_rbf_report {
    uint64_t points;             /* used */
    uint64_t rejected;           /* not finite */
    uint64_t duplicates;         /* at the place of another one: their mean was fitted */
    double range;                /* of the values: what errors are shares of */
    uint32_t functions, base_dims[3];
    uint32_t rounds, inserted, dropped;
    double max_error, mean_error, rms_error, p999_error; /* at the points */
    uint64_t between_count;      /* random places in cells (of the grid, in tets) */
    double between_max, between_mean; /* against linear interpolation there */
    double direction_mean, direction_max; /* vectors: degrees, weighted by min(1, length / 5 % of the greatest) */
    double overshoot;            /* how far values leave the range of the data, there and at the points */
    double largest_weight;       /* over 100: the fit is ill-conditioned */
    uint64_t bytes, raw_bytes;   /* of the file; of the values as 32-bit floats, scattered: with positions */
    uint64_t grid_bytes;         /* compare: least bytes of a plain grid, or of the values alone, with quantised numbers,
                                    that keeps max_error */
    uint32_t grid_dims[3], grid_bits;
    double grid_max_error, grid_mean_error;
    uint32_t functions_win;      /* compare: 1 when bytes < grid_bytes */
} tetcast_rbf_report;

/* Encode data as a coarse grid and functions so that the error at every point is at most max_error.
   desc    NULL: all defaults
   report  out, may be NULL
   out     free with tetcast_rbf_destroy; NULL on failure
   Greedy: a function where the error is largest, of the width that takes most of it away, then moved and widened for the
   least sum of squares; later all are fitted again in turn, weighted so that large errors count most. Parameters are
   rounded as they will be stored before the error is taken, so storing adds none.
   The same model for any number of threads and any isa. Errors: INVALID_ARG, EMPTY (no usable point), RANGE
   (max_functions is not enough), UNINIT_DESC, NO_MEMORY, CANCELLED.
   Source: the thesis' loop of centres, widths, weights and error (its own steps are in bench/baseline). */
TETCAST_DEF tetcast_result tetcast_rbf_fit(const tetcast_rbf_fit_desc *desc, const tetcast_rbf_points *points,
                                           tetcast_rbf_report *report, tetcast_rbf **out);

/* Which scalar of a model is seen. Others than COMPONENT and LENGTH need derivatives at every sample: slow. */
typedef enum tetcast_rbf_channel {
    TETCAST_RBF_CHANNEL_AUTO = 0,      /* the component of models with one, else LENGTH */
    TETCAST_RBF_CHANNEL_COMPONENT = 1, /* see `component` */
    TETCAST_RBF_CHANNEL_LENGTH = 2,    /* of all components */
    TETCAST_RBF_CHANNEL_VORTICITY = 3, /* its length; three components */
    TETCAST_RBF_CHANNEL_LAMBDA2 = 4,   /* minus lambda2: > 0 in cores of vortices */
    TETCAST_RBF_CHANNEL_HELICITY = 5,
    TETCAST_RBF_CHANNEL_FORCE_32BIT = 0x7fffffff
} tetcast_rbf_channel;

/* field        zero means
   camera       (eye equals at) one that frames the box
   isa          the best that the machine has; all give the same bits
   background   transparent; linear RGB, premultiplied, and alpha
   step         distance of the samples on a ray, world units; 0: half of the width of narrow functions (of the tenth
                part of all), and of a cell of the base, between 1/64 and 1/1024 of the diagonal of the box
   epsilon      exact. > 0: leave out functions with weights up to this share of the largest: faster while moving
   gather       functions come to the rays tile by tile. 1: samples go to the leaf that they are in and ask its list */
typedef struct tetcast_rbf_render_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_camera camera;
    tetcast_isa isa;
    tetcast_rbf_channel channel;
    uint32_t component;
    float background[4];
    float step;
    float epsilon;
    uint32_t gather;
    uint32_t _end_zero;
} tetcast_rbf_render_desc;

typedef struct tetcast_rbf_render_stats { /* added to */
    uint64_t rays, hit_rays; /* of the picture; that met the box */
    uint64_t samples;        /* values on rays */
    uint64_t evaluations;    /* pairs of sample and function that were computed */
    uint64_t pairs;          /* functions and groups of eight rays that met */
    uint64_t tests;          /* that were tested */
    float step;              /* that was used, world units */
    tetcast_isa isa;
} tetcast_rbf_render_stats;

/* Draw a model inside its box.
   optics  as for meshes; its integrator gets segments between samples on which the value is taken as linear
   image   length: way inside of the box. depth: of the first sample that shows something, isosurfaces exactly
   Samples lie at multiples of the step from the eye, and where a ray enters and leaves the box; segments have their
   exact lengths. On a ray a Gaussian is one of a line: it is summed up with two multiplications a sample, begun at
   its middle. Isosurfaces are refined on the ray and have the analytic gradient as normal.
   The same bits for any number of threads and any isa. Errors: INVALID_ARG, RANGE (over 2^16 samples on a ray),
   UNINIT_DESC, NO_MEMORY, CANCELLED. */
TETCAST_DEF tetcast_result tetcast_rbf_render(const tetcast_rbf_render_desc *desc, const tetcast_rbf *rbf,
                                              const tetcast_optics *optics, const tetcast_image *image,
                                              tetcast_rbf_render_stats *stats);

/* ---- traces of particles ---- */

typedef enum tetcast_stepper {
    TETCAST_STEPPER_RK4 = 0,
    TETCAST_STEPPER_EULER = 1, /* as the thesis does */
    TETCAST_STEPPER_FORCE_32BIT = 0x7fffffff
} tetcast_stepper;

typedef enum tetcast_trace_end {
    TETCAST_TRACE_STEPS = 0,   /* all steps done */
    TETCAST_TRACE_LEFT = 1,    /* left the box */
    TETCAST_TRACE_SLOW = 2,    /* slower than min_speed */
    TETCAST_TRACE_BAD = 3,     /* began at no place in the box */
    TETCAST_TRACE_FORCE_32BIT = 0x7fffffff
} tetcast_trace_end;

/* field        zero means
   dt           time of a step; has to be given; < 0: backwards
   steps        has to be given
   min_speed    particles go on however slow they are */
typedef struct tetcast_rbf_trace_desc {
    uint32_t _begin_zero;
    tetcast_env env;
    tetcast_isa isa;
    tetcast_stepper stepper;
    double dt;
    uint32_t steps;
    float min_speed;
    uint32_t _end_zero;
} tetcast_rbf_trace_desc;

/* Follow particles in a model of three components.
   seeds   in, [count][3], world
   paths   out, [count][steps + 1][3]: the seed and the places after each step, as far as it got
   lengths out, [count]: places in each path, 1 .. steps + 1; or NULL
   ends    out, [count]; or NULL
   The same bits for any number of threads and any isa. Errors: INVALID_ARG, RANGE, UNINIT_DESC, NO_MEMORY. */
TETCAST_DEF tetcast_result tetcast_rbf_trace(const tetcast_rbf_trace_desc *desc, const tetcast_rbf *rbf,
                                             const double *seeds, size_t count, double *paths, uint32_t *lengths,
                                             tetcast_trace_end *ends);

#endif /* TETCAST_NO_RBF */


/* ---- misc ---- */

TETCAST_DEF const char *tetcast_result_string(tetcast_result result);
TETCAST_DEF uint32_t tetcast_version(void);
TETCAST_DEF const char *tetcast_isa_name(tetcast_isa isa);
TETCAST_DEF tetcast_isa tetcast_isa_best(void); /* what TETCAST_ISA_AUTO picks on this machine */

#ifdef __cplusplus
}
#endif
#endif /* TETCAST_H_INCLUDED */

/* End of API. Stop here if you only use the library. */

#if defined(__INTELLISENSE__) || defined(__JETBRAINS_IDE__)
#  define TETCAST_IMPLEMENTATION
#endif
#if defined(TETCAST_IMPLEMENTATION) && !defined(TETCAST_IMPLEMENTATION_DONE)
#define TETCAST_IMPLEMENTATION_DONE

/* ---------------------------------------------------------------------------
   platform: compiler, instruction sets, asserts, bytes.                        // >>platform
   Equal in all three headers but for the prefix, up to and including math.
   --------------------------------------------------------------------------- */
#include <string.h>
#include <math.h>
#if defined(TETCAST_MALLOC) != defined(TETCAST_FREE)
#  error "define both or neither of TETCAST_MALLOC(size,user) and TETCAST_FREE(ptr,size,user)"
#endif
#ifndef TETCAST_MALLOC
#  include <stdlib.h>
#  define TETCAST_MALLOC(size, user) ((void)(user), malloc(size))
#  define TETCAST_FREE(ptr, size, user) ((void)(user), (void)(size), free(ptr))
#endif
#ifndef TETCAST_ASSERT
#  include <assert.h>
#  define TETCAST_ASSERT(cond) assert(cond)
#endif
#if defined(__FAST_MATH__) && !defined(TETCAST_ALLOW_FAST_MATH)
#  error "tetcast.h needs NaN and infinity; build without -ffast-math or define TETCAST_ALLOW_FAST_MATH"
#endif
#if defined(__wasm__) && !defined(TETCAST_NO_THREADS)
#  define TETCAST_NO_THREADS
#endif
#ifndef TETCAST_NO_THREADS
#  include <pthread.h>
#  include <unistd.h>
#endif
#ifndef TETCAST_NO_STDIO
#  include <stdio.h>
#endif
#if !defined(TETCAST_NO_SIMD) && (defined(__x86_64__) || defined(_M_X64))
#  define TETCASTI_X64 1
#  include <immintrin.h>
#  if defined(_MSC_VER)
#    include <intrin.h>
#  endif
#  if defined(_MSC_VER) && defined(__clang__) && !defined(__AVX2__) /* clang-cl hides AVX behind __AVX__ */
#    include <tmmintrin.h>
#    include <smmintrin.h>
#    include <popcntintrin.h>
#    include <avxintrin.h>
#    include <avx2intrin.h>
#    include <fmaintrin.h>
#    include <bmi2intrin.h>
#  endif
#  if defined(_MSC_VER) && !defined(__clang__)
#    define TETCASTI_TARGET_AVX2
#  else
#    define TETCASTI_TARGET_AVX2 __attribute__((target("avx2,bmi,bmi2,lzcnt,popcnt"))) /* never "fma": same bits */
#  endif
#else
#  define TETCASTI_X64 0
#endif
#if TETCASTI_X64 && !defined(TETCAST_NO_AVX2)
#  define TETCASTI_AVX2 1
#else
#  define TETCASTI_AVX2 0
#endif
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC push_options
#  pragma GCC optimize("fp-contract=off")
#elif defined(__clang__)
#  pragma STDC FP_CONTRACT OFF
#endif
#if defined(__GNUC__) || defined(__clang__)
#  if defined(__OPTIMIZE__)
#    define TETCASTI_INLINE static inline __attribute__((always_inline, unused))
#  else /* each inlined copy would have stack of its own */
#    define TETCASTI_INLINE static inline __attribute__((unused))
#  endif
#  define TETCASTI_UNUSED __attribute__((unused))
#  define TETCASTI_NOINLINE __attribute__((noinline))
#  define TETCASTI_LIKELY(x) __builtin_expect(!!(x), 1)
#  define TETCASTI_UNLIKELY(x) __builtin_expect(!!(x), 0)
#  define TETCASTI_PREFETCH(p) __builtin_prefetch(p)
#else
#  define TETCASTI_INLINE static inline
#  define TETCASTI_UNUSED
#  define TETCASTI_NOINLINE
#  define TETCASTI_LIKELY(x) (x)
#  define TETCASTI_UNLIKELY(x) (x)
#  define TETCASTI_PREFETCH(p) ((void)(p))
#endif
#ifdef __cplusplus
extern "C" {
#endif

/* Levels: 1 scalar, 2 SSE 4.1 with POPCNT, 3 AVX2 with BMI2 and POPCNT. */
TETCASTI_UNUSED static int tetcasti_cpu_level(void) {
#if TETCASTI_X64 && !defined(_MSC_VER)
    int level = __builtin_cpu_supports("sse4.1") && __builtin_cpu_supports("popcnt") ? 2 : 1;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt")) level = 3;
    return level;
#elif TETCASTI_X64
    int r[4];
    __cpuid(r, 1);
    if ((r[2] & (1 << 19)) == 0 || (r[2] & (1 << 23)) == 0) return 1;
    if ((r[2] & (1 << 27)) == 0 || (_xgetbv(0) & 6) != 6) return 2;
    __cpuidex(r, 7, 0);
    return (r[1] >> 5) & 1 ? 3 : 2;
#else
    return 1;
#endif
}

/* gcc knows this pattern where the processor has the instruction; its builtin is a call into libgcc elsewhere. */
#if defined(__clang__) || (defined(__GNUC__) && (defined(__POPCNT__) || defined(__aarch64__)))
#  define tetcasti_popcount64(x) ((uint32_t)__builtin_popcountll(x))
#else
TETCASTI_INLINE uint32_t tetcasti_popcount64(uint64_t x) {
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fu;
    return (uint32_t)((x * 0x0101010101010101u) >> 56);
}
#endif
#if defined(__GNUC__) || defined(__clang__)
#  define tetcasti_ctz64(x) ((uint32_t)__builtin_ctzll(x)) /* x != 0 */
#  define tetcasti_clz32(x) ((uint32_t)__builtin_clz(x))   /* x != 0 */
#else
TETCASTI_INLINE uint32_t tetcasti_ctz64(uint64_t x) { return tetcasti_popcount64((x & (0u - x)) - 1u); }
TETCASTI_INLINE uint32_t tetcasti_clz32(uint32_t x) {
    x |= x >> 1; x |= x >> 2; x |= x >> 4; x |= x >> 8; x |= x >> 16;
    return 32u - tetcasti_popcount64(x);
}
#endif

TETCASTI_INLINE uint32_t tetcasti_load_u16(const uint8_t *p) { return (uint32_t)p[0] | (uint32_t)p[1] << 8; }
TETCASTI_INLINE uint32_t tetcasti_load_u32(const uint8_t *p) {
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}
TETCASTI_INLINE uint64_t tetcasti_load_u64(const uint8_t *p) {
    return (uint64_t)tetcasti_load_u32(p) | (uint64_t)tetcasti_load_u32(p + 4) << 32;
}
TETCASTI_INLINE void tetcasti_store_u16(uint8_t *p, uint32_t v) { p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); }
TETCASTI_INLINE void tetcasti_store_u32(uint8_t *p, uint32_t v) {
    p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); p[2] = (uint8_t)(v >> 16); p[3] = (uint8_t)(v >> 24);
}
TETCASTI_INLINE void tetcasti_store_u64(uint8_t *p, uint64_t v) {
    tetcasti_store_u32(p, (uint32_t)v);
    tetcasti_store_u32(p + 4, (uint32_t)(v >> 32));
}
TETCASTI_INLINE int tetcasti_little_endian(void) {
    const uint16_t one = 1;
    uint8_t b;
    memcpy(&b, &one, 1);
    return b;
}

/* ---------------------------------------------------------------------------
   memory: every byte comes from here; counted, limited, 64-byte aligned.       // >>memory
   --------------------------------------------------------------------------- */

typedef struct tetcasti_mem {
    tetcast_allocator allocator;
    size_t limit;          /* 0: none */
    size_t used, peak;     /* atomics */
} tetcasti_mem;

static void *tetcasti_default_alloc(size_t size, void *user) { return TETCAST_MALLOC(size, user); }
static void tetcasti_default_free(void *ptr, size_t size, void *user) { TETCAST_FREE(ptr, size, user); }

TETCASTI_INLINE int tetcasti_mul_size(size_t a, size_t b, size_t *out) {
    if (b != 0 && a > (size_t)-1 / b) return 0;
    *out = a * b;
    return 1;
}

#if defined(__GNUC__)
#  define tetcasti_atomic_add(p, v) __atomic_add_fetch(p, v, __ATOMIC_SEQ_CST)
#  define tetcasti_atomic_load(p) __atomic_load_n(p, __ATOMIC_SEQ_CST)
#  define tetcasti_atomic_store(p, v) __atomic_store_n(p, v, __ATOMIC_SEQ_CST)
#  define tetcasti_atomic_max_step(p, seen, v) \
       __atomic_compare_exchange_n(p, seen, v, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST)
#else /* no built-in threads there: the host's parallel-for has to be serial */
#  define tetcasti_atomic_add(p, v) (*(p) += (v))
#  define tetcasti_atomic_load(p) (*(p))
#  define tetcasti_atomic_store(p, v) (*(p) = (v))
#  define tetcasti_atomic_max_step(p, seen, v) (*(p) = (v), 1)
#endif

/* Not every machine has 64-bit atomics: what threads add to is a low and a high half. Read it after they ended. */
TETCASTI_INLINE void tetcasti_tally_add(uint32_t sum[2], uint64_t n) {
    uint32_t low = tetcasti_atomic_add(&sum[0], (uint32_t)n);
    (void)tetcasti_atomic_add(&sum[1], (uint32_t)(n >> 32) + (low < (uint32_t)n));
}
TETCASTI_INLINE uint64_t tetcasti_tally(const uint32_t sum[2]) { return (uint64_t)sum[1] << 32 | sum[0]; }

/* Before each block stand 64..127 bytes: the padding, then size and padding in the last 16. */
static TETCASTI_UNUSED void *tetcasti_alloc(tetcasti_mem *mem, size_t bytes) {
    size_t total, used, seen, skip;
    uint8_t *raw, *p;
    if (bytes > (size_t)-1 - 256) return NULL;
    total = bytes + 128;
    used = tetcasti_atomic_add(&mem->used, total);
    if (mem->limit != 0 && used > mem->limit) {
        (void)tetcasti_atomic_add(&mem->used, (size_t)0 - total);
        return NULL;
    }
    raw = (uint8_t *)mem->allocator.alloc_fn(total, mem->allocator.user);
    if (raw == NULL) {
        (void)tetcasti_atomic_add(&mem->used, (size_t)0 - total);
        return NULL;
    }
    seen = tetcasti_atomic_load(&mem->peak);
    while (seen < used && !tetcasti_atomic_max_step(&mem->peak, &seen, used)) { }
    skip = 128 - (size_t)((uintptr_t)raw & 63u);
    if (skip > 64 + 63) skip -= 64;
    p = raw + skip;
    memcpy(p - 8, &skip, sizeof skip);
    memcpy(p - 16, &total, sizeof total);
    return p;
}

static TETCASTI_UNUSED void *tetcasti_alloc_array(tetcasti_mem *mem, size_t count, size_t size) {
    size_t bytes;
    return tetcasti_mul_size(count, size, &bytes) ? tetcasti_alloc(mem, bytes) : NULL;
}

static TETCASTI_UNUSED void *tetcasti_alloc_zero(tetcasti_mem *mem, size_t count, size_t size) {
    size_t bytes;
    void *p = NULL;
    if (tetcasti_mul_size(count, size, &bytes)) p = tetcasti_alloc(mem, bytes);
    if (p != NULL) memset(p, 0, bytes);
    return p;
}

static TETCASTI_UNUSED void tetcasti_free(tetcasti_mem *mem, void *ptr) {
    size_t total = 0, skip = 0;
    uint8_t *p = (uint8_t *)ptr;
    if (p == NULL) return;
    memcpy(&skip, p - 8, sizeof skip);
    memcpy(&total, p - 16, sizeof total);
    (void)tetcasti_atomic_add(&mem->used, (size_t)0 - total);
    mem->allocator.free_fn(p - skip, total, mem->allocator.user);
}

/* Make room for `need` elements by doubling; keeps the old block when it fails. 1 on success. */
static TETCASTI_UNUSED int tetcasti_grow(tetcasti_mem *mem, void **array, size_t *capacity, size_t count,
                                           size_t need,
                                     size_t size) {
    size_t cap = *capacity;
    void *p;
    if (need <= cap) return 1;
    if (cap < 16) cap = 16;
    while (cap < need) {
        if (cap > (size_t)-1 / 2) return 0;
        cap *= 2;
    }
    p = tetcasti_alloc_array(mem, cap, size);
    if (p == NULL) return 0;
    if (count != 0) memcpy(p, *array, count * size);
    tetcasti_free(mem, *array);
    *array = p;
    *capacity = cap;
    return 1;
}

/* ---------------------------------------------------------------------------
   threads: one parallel-for; tasks are cut by a fixed rule, so results do not  // >>threads
   depend on how many threads run them. Error reports.
   --------------------------------------------------------------------------- */

typedef struct tetcasti_for {
    tetcast_task_fn *task;
    void *ctx;
    uint32_t count;
    uint32_t next; /* atomic */
} tetcasti_for;

static void tetcasti_for_drain(tetcasti_for *f) {
    for (;;) {
        uint32_t i = tetcasti_atomic_add(&f->next, 1u) - 1u;
        if (i >= f->count) return;
        f->task(f->ctx, i);
    }
}

#ifndef TETCAST_NO_THREADS
static void *tetcasti_for_thread(void *arg) {
    tetcasti_for_drain((tetcasti_for *)arg);
    return NULL;
}
#endif

static TETCASTI_UNUSED uint32_t tetcasti_thread_count(const tetcast_env *env) {
    uint32_t n = env->thread_count;
#ifndef TETCAST_NO_THREADS
#  ifdef _SC_NPROCESSORS_ONLN
    if (n == 0) {
        long cores = sysconf(_SC_NPROCESSORS_ONLN);
        n = cores > 0 ? (uint32_t)cores : 1u;
    }
#  endif
#endif
    if (n == 0) n = 1;
    return n > 64 ? 64 : n;
}

/* Run task(ctx, i) for i in [0, count) and return when all are done. count < 2^31. */
static TETCASTI_UNUSED void tetcasti_parallel_for(const tetcast_env *env, tetcast_task_fn *task, void *ctx,
                                                    uint32_t count) {
    tetcasti_for f;
    f.task = task;
    f.ctx = ctx;
    f.count = count;
    f.next = 0;
    if (count == 0) return;
    if (env->parallel.for_fn != NULL) {
        env->parallel.for_fn(task, ctx, count, env->parallel.user);
        return;
    }
#ifndef TETCAST_NO_THREADS
    {
        pthread_t thread[64];
        pthread_attr_t attr;
        uint32_t want = tetcasti_thread_count(env), started = 0, i;
        if (want > count) want = count;
        if (want > 1 && pthread_attr_init(&attr) == 0) {
            (void)pthread_attr_setstacksize(&attr, 512 * 1024);
            while (started + 1 < want && pthread_create(&thread[started], &attr, tetcasti_for_thread, &f) == 0)
                started++;
            (void)pthread_attr_destroy(&attr);
        }
        tetcasti_for_drain(&f);
        for (i = 0; i < started; i++) (void)pthread_join(thread[i], NULL);
    }
#else
    tetcasti_for_drain(&f);
#endif
}

/* Check a desc's env and take its allocator. */
static TETCASTI_UNUSED tetcast_result tetcasti_env_open(const tetcast_env *env, tetcasti_mem *mem) {
    if ((env->allocator.alloc_fn == NULL) != (env->allocator.free_fn == NULL)) return TETCAST_ERR_INVALID_ARG;
    memset(mem, 0, sizeof *mem);
    mem->allocator = env->allocator;
    mem->limit = env->memory_limit;
    if (mem->allocator.alloc_fn == NULL) {
        mem->allocator.alloc_fn = tetcasti_default_alloc;
        mem->allocator.free_fn = tetcasti_default_free;
    }
    return TETCAST_OK;
}

/* text may hold one "%": it is replaced by the number `where`. */
static TETCASTI_UNUSED tetcast_result tetcasti_fail(tetcast_error *error, tetcast_result code, uint64_t where,
                                                       const char *text) {
    if (error != NULL) {
        char digits[24];
        size_t n = 0, k = 0;
        uint64_t v = where;
        do { digits[n++] = (char)('0' + (char)(v % 10)); v /= 10; } while (v != 0);
        error->code = code;
        error->where = where;
        for (; *text != 0 && k + 1 < sizeof error->text; text++) {
            if (*text == '%') {
                while (n > 0 && k + 1 < sizeof error->text) error->text[k++] = digits[--n];
            } else {
                error->text[k++] = *text;
            }
        }
        error->text[k] = 0;
    }
    return code;
}

/* ---------------------------------------------------------------------------
   math: small vectors, own polynomials (libm differs between platforms),       // >>math
   Morton codes, octahedral normals, sRGB, hashes.
   --------------------------------------------------------------------------- */

TETCASTI_INLINE int tetcasti_finite_f(float x) { return x - x == 0.0f; }
TETCASTI_INLINE int tetcasti_finite(double x) { return x - x == 0.0; }
TETCASTI_INLINE double tetcasti_min(double a, double b) { return a < b ? a : b; }
TETCASTI_INLINE double tetcasti_max(double a, double b) { return a > b ? a : b; }
TETCASTI_INLINE double tetcasti_abs(double a) { return a < 0 ? -a : a; }
TETCASTI_INLINE float tetcasti_absf(float a) { return a < 0 ? -a : a; }
TETCASTI_INLINE float tetcasti_dot3(const float *a, const float *b) { return a[0] * b[0] + a[1] * b[1] + a[2] *
                                                                       b[2]; }

/* floor for |x| < 2^62 */
TETCASTI_INLINE int64_t tetcasti_floor(double x) {
    int64_t i = (int64_t)x;
    return i - ((double)i > x);
}

TETCASTI_INLINE int tetcasti_normalize(float v[3]) { /* 0: no direction, v unchanged */
    double x = (double)v[0], y = (double)v[1], z = (double)v[2], l = x * x + y * y + z * z;
    if (!(l > 0.0) || !tetcasti_finite(l)) return 0;
    l = 1.0 / sqrt(l);
    v[0] = (float)(x * l);
    v[1] = (float)(y * l);
    v[2] = (float)(z * l);
    return 1;
}

/* 2^x, |x| < 1000; relative error < 1e-13 */
static TETCASTI_UNUSED double tetcasti_exp2(double x) {
    int64_t n = tetcasti_floor(x + 0.5);
    double f = (x - (double)n) * 0.69314718055994530942, r = 1.0, p = 1.0, scale;
    uint64_t bits = (uint64_t)(n + 1023) << 52;
    int i;
    for (i = 1; i < 13; i++) {
        p = p * f / (double)i;
        r = r + p;
    }
    memcpy(&scale, &bits, sizeof scale);
    return r * scale;
}

/* log2(x) for normal x > 0; absolute error < 1e-13 */
static TETCASTI_UNUSED double tetcasti_log2(double x) {
    uint64_t bits;
    int64_t e;
    double m, s, s2, r = 0.0, p;
    int i;
    memcpy(&bits, &x, sizeof bits);
    e = (int64_t)((bits >> 52) & 2047u) - 1023;
    bits = (bits & 0xfffffffffffffu) | (uint64_t)1023 << 52;
    memcpy(&m, &bits, sizeof m);
    if (m > 1.41421356237309504880) {
        m *= 0.5;
        e++;
    }
    s = (m - 1.0) / (m + 1.0);
    s2 = s * s;
    p = s;
    for (i = 1; i < 24; i += 2) {
        r = r + p / (double)i;
        p = p * s2;
    }
    return (double)e + r * 2.88539008177792681472;
}

static TETCASTI_UNUSED double tetcasti_pow(double x, double y) {
    return x > 0.0 ? tetcasti_exp2(y * tetcasti_log2(x)) : 0.0;
}

/* sin and cos of |x| < 1e5; absolute error < 1e-15 */
static TETCASTI_UNUSED void tetcasti_sincos(double x, double *s, double *c) {
    int64_t q = tetcasti_floor(x * 0.63661977236758134308 + 0.5);
    double r = (x - (double)q * 1.5707963267948965580) - (double)q * 6.1232339957367660359e-17;
    double r2 = r * r, ps = r, pc = 1.0, ts = r, tc = 1.0, v;
    int i;
    for (i = 2; i < 18; i += 2) {
        tc = -tc * r2 / (double)((i - 1) * i);
        ts = -ts * r2 / (double)(i * (i + 1));
        pc = pc + tc;
        ps = ps + ts;
    }
    if (q & 1) {
        v = ps;
        ps = pc;
        pc = -v;
    }
    *s = (q & 2) ? -ps : ps;
    *c = (q & 2) ? -pc : pc;
}

TETCASTI_INLINE uint64_t tetcasti_spread3(uint64_t x) { /* 21 bits, two zeros between each */
    x &= 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffffu;
    x = (x | x << 16) & 0x1f0000ff0000ffu;
    x = (x | x << 8) & 0x100f00f00f00f00fu;
    x = (x | x << 4) & 0x10c30c30c30c30c3u;
    x = (x | x << 2) & 0x1249249249249249u;
    return x;
}
TETCASTI_INLINE uint32_t tetcasti_compact3(uint64_t x) {
    x &= 0x1249249249249249u;
    x = (x | x >> 2) & 0x10c30c30c30c30c3u;
    x = (x | x >> 4) & 0x100f00f00f00f00fu;
    x = (x | x >> 8) & 0x1f0000ff0000ffu;
    x = (x | x >> 16) & 0x1f00000000ffffu;
    x = (x | x >> 32) & 0x1fffffu;
    return (uint32_t)x;
}
TETCASTI_INLINE uint64_t tetcasti_morton(uint32_t x, uint32_t y, uint32_t z) {
    return tetcasti_spread3(x) | tetcasti_spread3(y) << 1 | tetcasti_spread3(z) << 2;
}

TETCASTI_INLINE uint64_t tetcasti_hash_mix(uint64_t h, uint64_t v) {
    h = (h ^ v) * 0x9e3779b97f4a7c15u;
    return h ^ (h >> 29);
}
/* counter-based random bits */
TETCASTI_INLINE uint32_t tetcasti_hash32(uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    return x ^ (x >> 16);
}
static TETCASTI_UNUSED uint64_t tetcasti_hash_bytes(uint64_t h, const void *data, size_t size) {
    const uint8_t *p = (const uint8_t *)data;
    for (; size >= 8; size -= 8, p += 8) h = tetcasti_hash_mix(h, tetcasti_load_u64(p));
    for (; size > 0; size--, p++) h = tetcasti_hash_mix(h, *p);
    return h;
}

/* sRGB byte <-> linear; IEC 61966-2-1 */
static TETCASTI_UNUSED double tetcasti_srgb_to_linear(double c) {
    return c <= 0.04045 ? c / 12.92 : tetcasti_pow((c + 0.055) / 1.055, 2.4);
}
static TETCASTI_UNUSED double tetcasti_linear_to_srgb(double c) {
    if (!(c > 0.0)) return 0.0;
    if (c >= 1.0) return 1.0;
    return c <= 0.0031308 ? c * 12.92 : 1.055 * tetcasti_pow(c, 1.0 / 2.4) - 0.055;
}
/* table[i] = linear light of sRGB byte i in units of 1/65535, rounded; strictly ascending */
static TETCASTI_UNUSED void tetcasti_srgb_table(uint32_t table[256]) {
    int i;
    for (i = 0; i < 256; i++) table[i] = (uint32_t)(tetcasti_srgb_to_linear((double)i / 255.0) * 65535.0 + 0.5);
}
/* nearest table entry in linear light: exact inverse of the table */
static TETCASTI_UNUSED uint32_t tetcasti_srgb_find(const uint32_t table[256], uint32_t linear) {
    uint32_t lo = 0, hi = 255;
    while (lo < hi) {
        uint32_t mid = (lo + hi + 1) / 2;
        if (table[mid] <= linear) lo = mid;
        else hi = mid - 1;
    }
    return lo < 255 && table[lo + 1] - linear < linear - table[lo] ? lo + 1 : lo;
}

/* Octahedral unit vectors in 8+8 bits (Cigolle et al. 2014), best of the four neighbours when encoding:
   mean error 0.315 degrees, largest 0.64. */
TETCASTI_INLINE void tetcasti_oct_decode(uint32_t code, float n[3]) {
    float x = (float)(code & 255u) * (2.0f / 255.0f) - 1.0f, y = (float)(code >> 8) * (2.0f / 255.0f) - 1.0f;
    float z = 1.0f - (x < 0 ? -x : x) - (y < 0 ? -y : y), l;
    if (z < 0) {
        float ox = x;
        x = (1.0f - (y < 0 ? -y : y)) * (x < 0 ? -1.0f : 1.0f);
        y = (1.0f - (ox < 0 ? -ox : ox)) * (y < 0 ? -1.0f : 1.0f);
    }
    l = 1.0f / sqrtf(x * x + y * y + z * z);
    n[0] = x * l;
    n[1] = y * l;
    n[2] = z * l;
}
/* Which of the codes (ix, iy), (ix+1, iy), (ix, iy+1), (ix+1, iy+1) decodes closest to m: largest squared cosine. The
   two forms do the same operations and give the same bits. */
#if TETCASTI_X64
TETCASTI_INLINE uint32_t tetcasti_oct_nearest(int ix, int iy, const float m[3]) {
    const __m128 sign = _mm_set1_ps(-0.0f), one = _mm_set1_ps(1.0f), zero = _mm_setzero_ps();
    __m128 x = _mm_min_ps(_mm_add_ps(_mm_set1_ps((float)ix), _mm_setr_ps(0, 1, 0, 1)), _mm_set1_ps(255.0f));
    __m128 y = _mm_min_ps(_mm_add_ps(_mm_set1_ps((float)iy), _mm_setr_ps(0, 0, 1, 1)), _mm_set1_ps(255.0f));
    __m128 z, ax, ay, fx, fy, fold;
    x = _mm_sub_ps(_mm_mul_ps(x, _mm_set1_ps(2.0f / 255.0f)), one);
    y = _mm_sub_ps(_mm_mul_ps(y, _mm_set1_ps(2.0f / 255.0f)), one);
    ax = _mm_andnot_ps(sign, x);
    ay = _mm_andnot_ps(sign, y);
    z = _mm_sub_ps(_mm_sub_ps(one, ax), ay);
    fold = _mm_cmplt_ps(z, zero);
    fx = _mm_mul_ps(_mm_sub_ps(one, ay), _mm_or_ps(one, _mm_and_ps(sign, _mm_cmplt_ps(x, zero))));
    fy = _mm_mul_ps(_mm_sub_ps(one, ax), _mm_or_ps(one, _mm_and_ps(sign, _mm_cmplt_ps(y, zero))));
    x = _mm_or_ps(_mm_and_ps(fold, fx), _mm_andnot_ps(fold, x));
    y = _mm_or_ps(_mm_and_ps(fold, fy), _mm_andnot_ps(fold, y));
    fx = _mm_add_ps(_mm_add_ps(_mm_mul_ps(x, _mm_set1_ps(m[0])), _mm_mul_ps(y, _mm_set1_ps(m[1]))),
                    _mm_mul_ps(z, _mm_set1_ps(m[2])));
    fy = _mm_add_ps(_mm_add_ps(_mm_mul_ps(x, x), _mm_mul_ps(y, y)), _mm_mul_ps(z, z));
    fx = _mm_div_ps(_mm_mul_ps(fx, _mm_max_ps(fx, zero)), fy);
    fy = _mm_max_ps(fx, _mm_shuffle_ps(fx, fx, 0x4e));
    fy = _mm_max_ps(fy, _mm_shuffle_ps(fy, fy, 0xb1));
    return tetcasti_ctz64((uint64_t)((uint32_t)_mm_movemask_ps(_mm_cmpeq_ps(fx, fy)) | 16u));
}
#else
TETCASTI_INLINE uint32_t tetcasti_oct_nearest(int ix, int iy, const float m[3]) {
    float best = -1.0f, dot;
    uint32_t k, nearest = 4;
    for (k = 0; k < 4; k++) {
        float x = (float)(ix + (int)(k & 1u)), y = (float)(iy + (int)(k >> 1)), z, ax, ay;
        x = (x > 255.0f ? 255.0f : x) * (2.0f / 255.0f) - 1.0f;
        y = (y > 255.0f ? 255.0f : y) * (2.0f / 255.0f) - 1.0f;
        ax = x < 0 ? -x : x;
        ay = y < 0 ? -y : y;
        z = 1.0f - ax - ay;
        if (z < 0) {
            x = (1.0f - ay) * (x < 0 ? -1.0f : 1.0f);
            y = (1.0f - ax) * (y < 0 ? -1.0f : 1.0f);
        }
        dot = x * m[0] + y * m[1] + z * m[2];
        dot = dot * (dot > 0 ? dot : 0.0f) / (x * x + y * y + z * z);
        if (dot > best) {
            best = dot;
            nearest = k;
        }
    }
    return nearest;
}
#endif

static TETCASTI_UNUSED uint32_t tetcasti_oct_encode(const float n[3]) {
    float ax = n[0] < 0 ? -n[0] : n[0], ay = n[1] < 0 ? -n[1] : n[1], az = n[2] < 0 ? -n[2] : n[2];
    float s = ax + ay + az, x, y, m[3];
    uint32_t k;
    int ix, iy;
    if (!(s > 0.0f)) return 0x8080u;
    s = 1.0f / s;
    m[0] = x = n[0] * s;
    m[1] = y = n[1] * s;
    m[2] = n[2] * s;
    if (n[2] < 0) {
        float ox = x;
        x = (1.0f - (y < 0 ? -y : y)) * (x < 0 ? -1.0f : 1.0f);
        y = (1.0f - (ox < 0 ? -ox : ox)) * (y < 0 ? -1.0f : 1.0f);
    }
    ix = (int)((x + 1.0f) * 127.5f);
    iy = (int)((y + 1.0f) * 127.5f);
    ix = ix < 0 ? 0 : ix > 255 ? 255 : ix;
    iy = iy < 0 ? 0 : iy > 255 ? 255 : iy;
    k = tetcasti_oct_nearest(ix, iy, m);
    if (k > 3) return 0x8080u; /* NaN */
    ix += (int)(k & 1u);
    iy += (int)(k >> 1);
    return (uint32_t)(ix > 255 ? 255 : ix) | (uint32_t)(iy > 255 ? 255 : iy) << 8;
}

/* ---------------------------------------------------------------------------
   core: the bytes of a mesh.                                                    // >>core

   Local coordinates  local = (world - origin) * 2^scale_log: origin is the middle of the box in double precision,
                      scale_log is chosen so that the longest side is in [2^29, 2^30). Positions are floats that are
                      multiples of 2^-18. The slopes of a ray are multiples of 2^-45, so what it sees are coordinates
                      that are multiples of 2^-63, below 2^33, and determinants of two of them are multiples of 2^-126:
                      nothing on the way to a sign can underflow, nothing after it can overflow.
                      world length = local length * mesh->unit, a power of two. Products of more than three local
                      coordinates do not fit into floats: use doubles there.
   vertex             {x, y, z, s}: position and the active scalar; 16 bytes
   tet                4 vertex numbers, face i lies opposite vertex i. Oriented: det(v1-v0, v2-v0, v3-v0) > 0 but for
                      cells that are inverted in the input
   neighbour          4 cell numbers, [i] behind face i; TETCASTI_NONE where the mesh ends
   face of the hull   {3 vertex numbers counter-clockwise seen from outside, cell}
   Numbers of cells and vertices are below 2^31 - 1.

   Compact forms, all walked in the same way. A walk is in `cell`, came through the face (a, b, c) out of `prev`:
       d    = the cell's other vertex
       next = the cell behind the face without x, where x is one of a, b, c
   Tet16  {a^b^c^d, n0^n3, n1^n3, n2^n3}: neighbours in the order of the vertices opposite to them, by number.
          With X = {those three, 0} and rank(v) = how many of the other three have smaller numbers:
          d = x^a^b^c, next = prev ^ X[rank d] ^ X[rank x], since prev lies opposite d. 16 bytes a cell.
   Tet8   The same with 16-bit numbers: the vertices' xor as it is, neighbours as differences to the cell's own
          number, 0x8000 for none. Where a number does not fit the first neighbour field is 0, which no other record
          has, and the other two hold the place of a Tet16 record in a side table.
   A. Aman, S. Demirci, U. Gudukbay: Compact tetrahedralization-based acceleration structures for ray tracing.
   Journal of Visualization 25, 2022 (Tet32, Tet20, Tet16).
   --------------------------------------------------------------------------- */

#define TETCASTI_NONE 0xffffffffu
#define TETCASTI_SIDE_LOG 30        /* the longest side in local units is below 2^this */
#define TETCASTI_SNAP 25769803776.0 /* 1.5 * 2^34: adding it to a double below 2^33 rounds to multiples of 2^-18 */
#define TETCASTI_SNAP_SLOPE 192.0   /* 1.5 * 2^7: the same for 2^-45 */
#define TETCASTI_BLUR 512.0         /* positions seen along a ray are off by less than this, 2^-21 of the mesh */
#define TETCASTI_CLUSTER_LOG 7      /* cells of a cluster: 128 that follow each other */
#define TETCASTI_INF ((float)INFINITY)

typedef struct tetcasti_vertex { float x, y, z, s; } tetcasti_vertex;
typedef struct tetcasti_face { uint32_t v[3], cell; } tetcasti_face;
typedef struct tetcasti_tet16 { uint32_t x, n[3]; } tetcasti_tet16;
typedef struct tetcasti_tet8 { uint16_t x, n[3]; } tetcasti_tet8;

/* Vertices of face i, counter-clockwise seen from outside of a tetrahedron with det(v1-v0, v2-v0, v3-v0) > 0. */
static const uint8_t tetcasti_face_of[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

/* A plain mesh: what import makes, and what all compact forms, strips, projection and isosurfaces are made from. */
typedef struct tetcasti_raw {
    const uint32_t (*tet)[4];
    const uint32_t (*neighbour)[4];
    const tetcasti_vertex *vertex;
    const tetcasti_face *face;      /* of the hull */
    uint32_t cell_count, vertex_count, face_count;
} tetcasti_raw;

/* A compact form. Cells have the numbers of the raw mesh unless `first` says otherwise. */
typedef struct tetcasti_cells {
    uint32_t kind;          /* tetcast_cells */
    uint32_t count;
    void *data;             /* count records */
    void *side;             /* Tet8: tetcasti_tet16 of the cells that do not fit; other forms: what they need */
    uint32_t *first;        /* NULL, or for each face of the hull what a walk starts with instead of face.cell */
    size_t data_bytes, side_bytes, first_bytes;
} tetcasti_cells;

/* Number of a cell in the mesh's own order. Strips call cells by columns; `side` says which cell is there. */
TETCASTI_INLINE uint32_t tetcasti_cell_number(const tetcasti_cells *cells, uint32_t cell) {
    return cells->first != NULL ? ((const uint32_t *)cells->side)[cell] : cell;
}

/* What a form reads of a cell on the way in and needs again on the way out. */
typedef struct tetcasti_node {
    uint32_t n[4];
    uint32_t flag;
} tetcasti_node;

/* Trees over lists of faces: faces in the order of their cells lie close together, so box k of level 0 is simply that
   of faces 8k..8k+7, box k of level l+1 that of boxes 8k..8k+7 of level l. */
typedef struct tetcasti_box { float lo[3], hi[3]; } tetcasti_box;
typedef struct tetcasti_hull {
    const tetcasti_face *face;
    tetcasti_box *box;
    uint32_t face_count, level_count;
    uint32_t level_start[12], level_size[12]; /* in box */
    size_t bytes;
} tetcasti_hull;

/* Values of one field in the mesh's own order. */
typedef struct tetcasti_field {
    float *value;           /* per vertex or per cell; NaN and infinities replaced by 0 */
    uint32_t *hidden;       /* NULL, or one bit a cell: masked, or has a value that is no number */
    float (*range)[2];      /* of each cluster: smallest and largest; NULL: there are no clusters */
    float value_min, value_max;
    uint32_t per_cell;
    char name[64];
} tetcasti_field;

struct tetcast_mesh {
    tetcasti_mem mem;
    double origin[3];       /* world */
    double unit;            /* world length of one local unit: 2^-scale_log */
    int32_t scale_log;
    tetcasti_box box;       /* local, of the cells */
    uint32_t vertex_count, cell_count, face_count;
    tetcasti_vertex *vertex;
    uint32_t (*tet)[4];       /* NULL when dropped */
    uint32_t (*neighbour)[4]; /* NULL when dropped */
    tetcasti_face *face;
    tetcasti_hull hull;
    tetcasti_cells cells;
    tetcasti_field *field;
    uint32_t field_count, active;
    const float *cell_value;    /* of the active field when it is one per cell; else NULL */
    const uint32_t *hidden;     /* of the active field, else mask */
    uint32_t *mask;             /* one bit a cell: imaginary; NULL: none */
    uint32_t *source_cell;      /* number of the input's cell, NULL when dropped */
    uint32_t *source_vertex;
    float (*gradient)[3];       /* per vertex, of the active field; NULL: not made */
    struct tetcasti_clusters *clusters; /* NULL when there are none */
    tetcast_report report;
};

TETCASTI_INLINE tetcasti_raw tetcasti_mesh_raw(const tetcast_mesh *mesh) { /* .tet, .neighbour: NULL when dropped */
    tetcasti_raw r;
    r.tet = (const uint32_t (*)[4])mesh->tet;
    r.neighbour = (const uint32_t (*)[4])mesh->neighbour;
    r.vertex = mesh->vertex;
    r.face = mesh->face;
    r.cell_count = mesh->cell_count;
    r.vertex_count = mesh->vertex_count;
    r.face_count = mesh->face_count;
    return r;
}

/* ---- the traversal interface ----
   A walker is an inline function with `kind` as a constant argument; it calls
       d    = tetcasti_enter(cells, kind, cell, prev, a, b, c, &node)          the fourth vertex
       next = tetcasti_leave(cells, kind, &node, cell, prev, a, b, c, d, x)    a, b, c, d: all four; x: the one that is
                                                                               not in the face through which it leaves
   Forms of other sections add a case to both. A cell number is whatever the form wants it to be (hull faces start with
   cells->first[face] then). */

/* v may be one of them */
TETCASTI_INLINE uint32_t tetcasti_rank(uint32_t v, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
    return (uint32_t)(a < v) + (uint32_t)(b < v) + (uint32_t)(c < v) + (uint32_t)(d < v);
}

TETCASTI_INLINE uint32_t tetcasti_enter_tet16(const tetcasti_tet16 *t, uint32_t abc, tetcasti_node *node) {
    node->n[0] = t->n[0];
    node->n[1] = t->n[1];
    node->n[2] = t->n[2];
    node->n[3] = 0;
    node->flag = 1;
    return t->x ^ abc;
}

TETCASTI_INLINE uint32_t tetcasti_enter_tet8(const tetcasti_cells *cells, uint32_t cell, uint32_t abc,
                                             tetcasti_node *node) {
    const tetcasti_tet8 *t = (const tetcasti_tet8 *)cells->data + cell;
    if (TETCASTI_UNLIKELY(t->n[0] == 0))
        return tetcasti_enter_tet16((const tetcasti_tet16 *)cells->side + (t->n[1] | (uint32_t)t->n[2] << 16), abc,
                                    node);
    node->n[0] = t->n[0];
    node->n[1] = t->n[1];
    node->n[2] = t->n[2];
    node->n[3] = 0;
    node->flag = 0; /* 1: it was in the side table */
    return t->x ^ abc;
}

TETCASTI_INLINE uint32_t tetcasti_enter_more(const tetcasti_cells *cells, uint32_t kind, uint32_t cell, uint32_t abc,
                                             tetcasti_node *node);
TETCASTI_INLINE uint32_t tetcasti_leave_more(const tetcasti_cells *cells, uint32_t kind, const tetcasti_node *node,
                                             uint32_t cell, uint32_t a, uint32_t b, uint32_t c, uint32_t d, uint32_t x);

TETCASTI_INLINE uint32_t tetcasti_enter(const tetcasti_cells *cells, uint32_t kind, uint32_t cell, uint32_t prev,
                                        uint32_t a, uint32_t b, uint32_t c, tetcasti_node *node) {
    (void)prev;
    switch (kind) {
    case TETCAST_CELLS_TET8: return tetcasti_enter_tet8(cells, cell, a ^ b ^ c, node);
    case TETCAST_CELLS_TET16: return tetcasti_enter_tet16((const tetcasti_tet16 *)cells->data + cell, a ^ b ^ c, node);
    default: return tetcasti_enter_more(cells, kind, cell, a ^ b ^ c, node);
    }
}

TETCASTI_INLINE uint32_t tetcasti_leave(const tetcasti_cells *cells, uint32_t kind, const tetcasti_node *node,
                                        uint32_t cell, uint32_t prev, uint32_t a, uint32_t b, uint32_t c, uint32_t d,
                                        uint32_t x) {
    uint32_t pick, delta;
    (void)cells;
    switch (kind) {
    case TETCAST_CELLS_TET8:
        pick = node->n[tetcasti_rank(d, a, b, c, d)] ^ node->n[tetcasti_rank(x, a, b, c, d)];
        if (TETCASTI_UNLIKELY(node->flag)) return prev ^ pick;
        delta = ((prev == TETCASTI_NONE ? 0x8000u : prev - cell) ^ pick) & 0xffffu;
        return delta == 0x8000u ? TETCASTI_NONE : cell + (delta ^ 0x8000u) - 0x8000u;
    case TETCAST_CELLS_TET16:
        return prev ^ node->n[tetcasti_rank(d, a, b, c, d)] ^ node->n[tetcasti_rank(x, a, b, c, d)];
    default:
        return tetcasti_leave_more(cells, kind, node, cell, a, b, c, d, x);
    }
}
/* ---------------------------------------------------------------------------
   optics core: compiled transfer functions, sums along a ray, and how walkers   // >>optics
   use the integrators (their code is further down).
   --------------------------------------------------------------------------- */

#define TETCASTI_VALUE_END 1e38f /* values of knots are smaller than this */
#define TETCASTI_EXTINCTION_END 1e18f /* and colours and extinctions at most this */
#define TETCASTI_LOWER 8 /* places in tetcasti_tf.coef */
#define TETCASTI_UPPER 9
#define TETCASTI_BASE 10
#define TETCASTI_CARRY 4
#define TETCASTI_ROW_SPLAT 176   /* offset of the splatted knots in tetcasti_tf.row */

/* A compiled transfer function: n intervals between n + 1 bounds. Interval k holds the values from knot[k] to
   knot[k + 1]; the first and the last reach to infinity and are constant. With u = value - base:
   extinction = coef[k][0] + coef[k][1] * u, red = coef[k][2] + coef[k][3] * u, green [4] [5], blue [6] [7].
   base, coef[k][10], is the end at which the extinction is smaller, so that ramps end in exactly nothing.
   No interval is empty: at a jump two intervals meet and each has its own limit there. */
typedef struct tetcasti_tf {
    uint32_t n;
    uint32_t independent;      /* 1: the colour is emission per length, 0: emission is colour * extinction */
    float *knot;               /* [n + 1] */
    float (*coef)[16];         /* [n]; the bounds again in 8 and 9, base in 10 */
    float *row;                /* n <= 16: the same as rows of 16: knot[k], knot[k + 1], base, coef[k][0..7]; the knots
                                  1 .. 15, each 8 times; else NULL */
    uint32_t *bucket;          /* [bucket_count + 1]: number of knots in lower buckets, see tetcasti_tf_find */
    uint32_t bucket_count;
    float bucket_scale;
    double (*prefix)[8];       /* [n]: integral of extinction, r, g, b emission up to base[k]; r, g, b, unused */
    float (*largest)[4];       /* [2n] tree of maxima: extinction, r, g, b emission; leaves at n .. 2n-1 */
    uint32_t *visible;         /* [n + 1]: first interval >= k with extinction or emission; n: none */
    float max_extinction, max_color, max_emission;
} tetcasti_tf;

/* How a walker uses the integrators. `o` is an optics object.

   Scalar:    tetcasti_ray_sum sum;
              tetcasti_ray_begin(o, &sum);
              for each segment, front to back:
                  o->segment(o, s_front, s_back, length, depth, &sum);      (lengths and depths in world units)
                  if (tetcasti_ray_ended(o, &sum)) break;
              between two segments that do not touch (a gap): tetcasti_ray_gap(o, &sum);
              tetcasti_ray_finish(o, &sum, rgba);

   8 lanes:   the same with tetcasti_ray_sum8 (rows of 8) and o->segment8(o, &seg8, lanes, &sum8), lanes a bit mask:
              a lane whose bit is 0 is left alone whatever its numbers are. Returns the mask of lanes that have ended
              (use it in a branch, not in arithmetic: then the next step need not wait for it).
              tetcasti_lane_begin / _gap / _finish (o, &sum8, lane, ...) for one lane.

   The same ray gives the same bits in either form. A ray that has ended ignores further segments, so segments may be
   queued and integrated later without changing the picture.

   Isosurfaces (o->iso_count != 0): the two forms above integrate the volume only. Lanes whose segment crosses an
   isovalue are tetcasti_iso_lanes(o, &seg8, lanes); for those call, instead of segment8 (scalar: always),
              tetcasti_segment_iso(o, s_front, s_back, length, depth, normal_fn, user, view, &sum)
   which cuts the segment at each isovalue in order. normal_fn(user, fraction, normal) gives the gradient of the
   scalar (any length) at front + fraction * (back - front); view is the unit direction of the ray.
   Lane form: tetcasti_lane_segment_iso(o, lane, &seg8, normal_fn, user, view, &sum8). */
typedef struct tetcasti_ray_sum {
    float c[3];      /* colour so far; MAXIMUM: largest so far */
    float t;         /* transmittance left; ABSORPTION: minus the optical depth */
    float carry[TETCASTI_CARRY]; /* equidistant steps: length since the last sample, value there, value now, depth */
    int32_t at;      /* interval in which the last segment ended: a guess for the next */
} tetcasti_ray_sum;
typedef struct tetcasti_ray_sum8 {
    float c[3][8];
    float t[8];
    float carry[TETCASTI_CARRY][8];
    int32_t at[8];
} tetcasti_ray_sum8;
typedef struct tetcasti_seg8 {
    float front[8], back[8], length[8], depth[8];
} tetcasti_seg8;
typedef void tetcasti_normal_fn(void *user, float fraction, float normal[3]);
typedef void tetcasti_segment_fn(const tetcast_optics *o, float s_front, float s_back, float length, float depth,
                                 tetcasti_ray_sum *sum);
typedef uint32_t tetcasti_segment8_fn(const tetcast_optics *o, const tetcasti_seg8 *seg, uint32_t lanes,
                                      tetcasti_ray_sum8 *sum);

typedef struct tetcasti_table { /* pre-integrated table; entry = {r, g, b, opacity}, colour associated */
    float (*entry)[4];          /* [lengths][values][values]: slice l is for length longest * (l + 1) / lengths */
    uint32_t values, lengths;
    float first, scale;         /* column of value s = (s - first) * scale */
    float longest, per_length;  /* slice of length d = d * per_length - 1; length 0 is no entry: all zero */
} tetcasti_table;

struct tetcast_optics {
    tetcasti_mem mem;
    tetcasti_tf tf;
    tetcast_model model;
    tetcast_integrator integrator;
    tetcasti_segment_fn *segment;
    tetcasti_segment8_fn *segment8;
    tetcasti_segment_fn *piece;     /* the exact form, whatever the integrator: tables are made of it, rests of steps */
    tetcasti_segment8_fn *piece8;
    float t_stop;                   /* a ray ends when t <= t_stop; -inf: never */
    uint32_t samples;
    uint32_t cue;
    float cue_scale, cue_offset, cue_lo, cue_hi; /* k = clamp(depth * cue_scale + cue_offset, cue_lo, cue_hi) */
    float fog[3];
    float max_scale;                /* MAXIMUM: 1 / largest emission */
    tetcasti_table table;
    float *psi;                     /* 512 x 512 */
    uint32_t iso_count;             /* 0 unless the model shows isosurfaces */
    tetcast_isovalue *iso;          /* ascending */
    float ambient[3];
    uint32_t light_count;           /* 0: one light from the eye */
    tetcast_light light[TETCAST_MAX_LIGHTS]; /* unit directions */
    tetcast_optics_info info;
};

static void tetcasti_ray_begin(const tetcast_optics *o, tetcasti_ray_sum *sum);
static int tetcasti_ray_ended(const tetcast_optics *o, const tetcasti_ray_sum *sum);
static void tetcasti_ray_gap(const tetcast_optics *o, tetcasti_ray_sum *sum);
static void tetcasti_ray_finish(const tetcast_optics *o, tetcasti_ray_sum *sum, float rgba[4]);
static void tetcasti_lane_begin(const tetcast_optics *o, tetcasti_ray_sum8 *sum, uint32_t lane);
static void tetcasti_lane_gap(const tetcast_optics *o, tetcasti_ray_sum8 *sum, uint32_t lane);
static void tetcasti_lane_finish(const tetcast_optics *o, tetcasti_ray_sum8 *sum, uint32_t lane, float rgba[4]);
static uint32_t tetcasti_iso_lanes(const tetcast_optics *o, const tetcasti_seg8 *seg, uint32_t lanes);
static void tetcasti_segment_iso(const tetcast_optics *o, float s_front, float s_back, float length, float depth,
                                 tetcasti_normal_fn *normal, void *user, const float view[3], tetcasti_ray_sum *sum);
static void tetcasti_lane_segment_iso(const tetcast_optics *o, uint32_t lane, const tetcasti_seg8 *seg,
                                      tetcasti_normal_fn *normal, void *user, const float view[3],
                                      tetcasti_ray_sum8 *sum);
/* ---------------------------------------------------------------------------
   mesh: cells of the caller -> tetrahedra in a good order -> neighbours -> hull. // >>mesh

   1  vertices that are used are put in the order of a space-filling curve,
   2  cells are cut into tetrahedra; each is written as v0 < v1 < min(v2, v3), where the order of v2 and v3 says how it
      is oriented, and sorted by v0,
   3  faces are matched vertex by vertex: those whose smallest vertex is v belong to the tetrahedra with v0 = v, three
      of their faces each, which lie next to each other by then, and to those with v1 = v, one face each. A small hash
      table on the two other vertices finds the pairs.
   All work is cut into tasks by ranges, each of which writes what is its own.
   --------------------------------------------------------------------------- */

#if defined(__GNUC__)
#  define tetcasti_relaxed_load(p) __atomic_load_n(p, __ATOMIC_RELAXED)
#  define tetcasti_relaxed_store(p, v) __atomic_store_n(p, v, __ATOMIC_RELAXED)
#else
#  define tetcasti_relaxed_load(p) (*(p))
#  define tetcasti_relaxed_store(p, v) (*(p) = (v))
#endif

#define TETCASTI_CHUNK 16384u  /* cells or vertices of one task */
#define TETCASTI_BAD 1u        /* vertex states */
#define TETCASTI_USED 2u

static size_t tetcasti_type_size(tetcast_type type) { /* 0: no such type */
    switch (type) {
    case TETCAST_TYPE_F32: case TETCAST_TYPE_U32: case TETCAST_TYPE_I32: return 4;
    case TETCAST_TYPE_F64: return 8;
    case TETCAST_TYPE_U8: case TETCAST_TYPE_I8: return 1;
    case TETCAST_TYPE_U16: case TETCAST_TYPE_I16: case TETCAST_TYPE_F16: return 2;
    case TETCAST_TYPE_FORCE_32BIT: break;
    }
    return 0;
}

static double tetcasti_half(uint32_t h) {
    uint32_t e = h >> 10 & 31u, m = h & 1023u;
    double v;
    if (e == 31) v = m != 0 ? (double)NAN : (double)INFINITY;
    else if (e == 0) v = (double)m * (1.0 / 16777216.0);
    else v = (double)(1024u + m) * (double)((uint64_t)1 << e) * (1.0 / 33554432.0);
    return (h & 0x8000u) != 0 ? -v : v;
}

/* Number k of element i. */
static double tetcasti_array_get(const tetcast_array *a, size_t stride, size_t i, size_t k) {
    const uint8_t *p = (const uint8_t *)a->data + i * stride;
    float f32;
    double f64;
    uint16_t u16;
    uint32_t u32;
    int16_t i16;
    int32_t i32;
    switch (a->type) {
    case TETCAST_TYPE_F32: memcpy(&f32, p + 4 * k, 4); return (double)f32;
    case TETCAST_TYPE_F64: memcpy(&f64, p + 8 * k, 8); return f64;
    case TETCAST_TYPE_U8: return (double)p[k];
    case TETCAST_TYPE_I8: return (double)(p[k] < 128 ? (int)p[k] : (int)p[k] - 256);
    case TETCAST_TYPE_U16: memcpy(&u16, p + 2 * k, 2); return (double)u16;
    case TETCAST_TYPE_I16: memcpy(&i16, p + 2 * k, 2); return (double)i16;
    case TETCAST_TYPE_U32: memcpy(&u32, p + 4 * k, 4); return (double)u32;
    case TETCAST_TYPE_I32: memcpy(&i32, p + 4 * k, 4); return (double)i32;
    case TETCAST_TYPE_F16: memcpy(&u16, p + 2 * k, 2); return tetcasti_half(u16);
    case TETCAST_TYPE_FORCE_32BIT: break;
    }
    return 0.0;
}

static size_t tetcasti_array_stride(const tetcast_array *a, size_t numbers) {
    return a->stride != 0 ? a->stride : numbers * tetcasti_type_size(a->type);
}

/* ---- orientation, exactly ---- */

typedef struct tetcasti_wide { uint32_t w[6]; } tetcasti_wide; /* 192 bits, two's complement */

/* acc += a * b * c for |a|, |b|, |c| < 2^52 */
static void tetcasti_wide_add(tetcasti_wide *acc, int64_t a, int64_t b, int64_t c) {
    uint32_t minus = (uint32_t)(a < 0) ^ (uint32_t)(b < 0) ^ (uint32_t)(c < 0), f[2], p[6], i, j, n = 2;
    uint64_t u = (uint64_t)(a < 0 ? -a : a), v[2], carry = 0;
    memset(p, 0, sizeof p);
    p[0] = (uint32_t)u;
    p[1] = (uint32_t)(u >> 32);
    v[0] = (uint64_t)(b < 0 ? -b : b);
    v[1] = (uint64_t)(c < 0 ? -c : c);
    for (i = 0; i < 2; i++, n += 2) {
        uint32_t q[6];
        memset(q, 0, sizeof q);
        f[0] = (uint32_t)v[i];
        f[1] = (uint32_t)(v[i] >> 32);
        for (j = 0; j < n; j++) {
            uint64_t t = (uint64_t)p[j] * f[0] + q[j];
            q[j] = (uint32_t)t;
            t = (t >> 32) + (uint64_t)p[j] * f[1] + q[j + 1];
            q[j + 1] = (uint32_t)t;
            if (j + 2 < 6) q[j + 2] += (uint32_t)(t >> 32);
        }
        memcpy(p, q, sizeof p);
    }
    for (i = 0; i < 6; i++) {
        uint64_t t = (uint64_t)acc->w[i] + (minus ? ~p[i] : p[i]) + (i == 0 ? minus : 0u) + carry;
        acc->w[i] = (uint32_t)t;
        carry = t >> 32;
    }
}

/* Six times the signed volume, local units; its sign and its being zero are exact. */
static double tetcasti_volume6(const tetcasti_vertex *a, const tetcasti_vertex *b, const tetcasti_vertex *c,
                               const tetcasti_vertex *d) {
    double u[3], v[3], w[3], m[6], det, size;
    int64_t p[3], q[3], r[3];
    tetcasti_wide sum;
    uint32_t i, any = 0;
    u[0] = (double)b->x - (double)a->x; u[1] = (double)b->y - (double)a->y; u[2] = (double)b->z - (double)a->z;
    v[0] = (double)c->x - (double)a->x; v[1] = (double)c->y - (double)a->y; v[2] = (double)c->z - (double)a->z;
    w[0] = (double)d->x - (double)a->x; w[1] = (double)d->y - (double)a->y; w[2] = (double)d->z - (double)a->z;
    m[0] = v[1] * w[2]; m[1] = v[2] * w[1];
    m[2] = v[2] * w[0]; m[3] = v[0] * w[2];
    m[4] = v[0] * w[1]; m[5] = v[1] * w[0];
    det = u[0] * (m[0] - m[1]) + u[1] * (m[2] - m[3]) + u[2] * (m[4] - m[5]);
    size = tetcasti_abs(u[0]) * (tetcasti_abs(m[0]) + tetcasti_abs(m[1])) +
           tetcasti_abs(u[1]) * (tetcasti_abs(m[2]) + tetcasti_abs(m[3])) +
           tetcasti_abs(u[2]) * (tetcasti_abs(m[4]) + tetcasti_abs(m[5]));
    if (tetcasti_abs(det) > 1e-15 * size) return det; /* the rounding of seven operations cannot change the sign */
    for (i = 0; i < 3; i++) { /* multiples of 2^-18 below 2^31: integers of 49 bits */
        p[i] = (int64_t)(u[i] * 262144.0);
        q[i] = (int64_t)(v[i] * 262144.0);
        r[i] = (int64_t)(w[i] * 262144.0);
    }
    memset(&sum, 0, sizeof sum);
    tetcasti_wide_add(&sum, p[0], q[1], r[2]);
    tetcasti_wide_add(&sum, -p[0], q[2], r[1]);
    tetcasti_wide_add(&sum, p[1], q[2], r[0]);
    tetcasti_wide_add(&sum, -p[1], q[0], r[2]);
    tetcasti_wide_add(&sum, p[2], q[0], r[1]);
    tetcasti_wide_add(&sum, -p[2], q[1], r[0]);
    for (i = 0; i < 6; i++) any |= sum.w[i];
    if (any == 0) return 0.0;
    det = tetcasti_max(tetcasti_abs(det), 1e-300);
    return sum.w[5] >> 31 ? -det : det;
}

/* ---- cutting larger cells ---- */

/* Faces of the shapes by place; a triangle repeats its last one. */
static const uint8_t tetcasti_hexahedron_face[6][4] = {{0, 1, 2, 3}, {4, 5, 6, 7}, {0, 1, 5, 4},
                                                       {1, 2, 6, 5}, {2, 3, 7, 6}, {3, 0, 4, 7}};
static const uint8_t tetcasti_voxel_face[6][4] = {{0, 1, 3, 2}, {4, 5, 7, 6}, {0, 1, 5, 4},
                                                  {1, 3, 7, 5}, {3, 2, 6, 7}, {2, 0, 4, 6}};
static const uint8_t tetcasti_wedge_face[5][4] = {{0, 1, 2, 2}, {3, 4, 5, 5}, {0, 1, 4, 3}, {1, 2, 5, 4}, {2, 0, 3, 5}};
static const uint8_t tetcasti_pyramid_face[5][4] = {{0, 1, 2, 3}, {0, 1, 4, 4}, {1, 2, 4, 4}, {2, 3, 4, 4},
                                                    {3, 0, 4, 4}};

static uint32_t tetcasti_shape_size(uint32_t shape) { /* vertices; 0: not a shape of ours */
    switch (shape) {
    case TETCAST_SHAPE_TETRA: return 4;
    case TETCAST_SHAPE_VOXEL: case TETCAST_SHAPE_HEXAHEDRON: return 8;
    case TETCAST_SHAPE_WEDGE: return 6;
    case TETCAST_SHAPE_PYRAMID: return 5;
    default: return 0;
    }
}

/* Cut a cell into tetrahedra so that every quadrilateral is cut at its vertex of the smallest number: join the cell's
   smallest vertex to the triangles of all faces that do not have it. What has a vertex twice is left out and counted.
   Returns how many, at most 6. Where the three far faces of a hexahedron are cut around the corner opposite to the
   smallest one, the three tetrahedra there become two. J. Dompierre et al.: How to subdivide pyramids, prisms and
   hexahedra into tetrahedra. 8th International Meshing Roundtable, 1999. */
static uint32_t tetcasti_cut(uint32_t shape, const uint32_t *v, uint32_t out[6][4], uint32_t *repeated) {
    const uint8_t (*face)[4] = shape == TETCAST_SHAPE_HEXAHEDRON ? tetcasti_hexahedron_face :
        shape == TETCAST_SHAPE_VOXEL ? tetcasti_voxel_face :
        shape == TETCAST_SHAPE_WEDGE ? tetcasti_wedge_face : tetcasti_pyramid_face;
    uint32_t size = tetcasti_shape_size(shape), faces = size == 8 ? 6 : 5, n = 0, k = 0, i, j, m = 0;
    if (shape == TETCAST_SHAPE_TETRA) {
        for (j = 0; j < 4; j++) out[0][j] = v[j];
        n = 1;
    } else {
        uint32_t far_corner = TETCASTI_NONE, around = 0;
        for (i = 1; i < size; i++) k = v[i] < v[k] ? i : k;
        if (shape == TETCAST_SHAPE_HEXAHEDRON) far_corner = k < 4 ? (k + 2) % 4 + 4 : (k - 2) % 4;
        if (shape == TETCAST_SHAPE_VOXEL) far_corner = 7 - k;
        for (i = 0; i < faces; i++) {
            const uint8_t *f = face[i];
            uint32_t a, b;
            if (f[0] == k || f[1] == k || f[2] == k || f[3] == k) continue;
            if (f[2] == f[3]) {
                for (j = 0; j < 3; j++) out[n][j + 1] = v[f[j]];
                out[n++][0] = v[k];
                continue;
            }
            a = v[f[0]] < v[f[2]] ? v[f[0]] : v[f[2]];
            b = v[f[1]] < v[f[3]] ? v[f[1]] : v[f[3]];
            j = a < b ? 0u : 1u; /* the diagonal from place j to j + 2 */
            around += f[j] != far_corner && f[j + 2] != far_corner;
            out[n][0] = out[n + 1][0] = v[k];
            out[n][1] = out[n + 1][1] = v[f[j]];
            out[n][2] = v[f[j + 1]];
            out[n][3] = out[n + 1][2] = v[f[j + 2]];
            out[n + 1][3] = v[f[(j + 3) & 3]];
            n += 2;
        }
        if (around == 3) { /* only a hexahedron has three such faces: the three with the far corner become two */
            static const uint8_t near_hexahedron[8][3] = {{1, 3, 4}, {0, 2, 5}, {1, 3, 6}, {0, 2, 7},
                                                          {0, 5, 7}, {1, 4, 6}, {2, 5, 7}, {3, 4, 6}};
            uint32_t kept[3][4], keep = 0;
            for (i = 0; i < n; i++) {
                const uint32_t *t = out[i];
                if (t[1] == v[far_corner] || t[2] == v[far_corner] || t[3] == v[far_corner]) continue;
                if (keep < 3) memcpy(kept[keep], t, sizeof kept[0]);
                keep++;
            }
            if (keep == 3) {
                memcpy(out, kept, sizeof kept);
                for (i = 0; i < 3; i++) {
                    uint32_t at = shape == TETCAST_SHAPE_VOXEL ? far_corner ^ 1u << i : near_hexahedron[far_corner][i];
                    out[3][i] = out[4][i] = v[at];
                }
                out[3][3] = v[k];
                out[4][3] = v[far_corner];
                n = 5;
            }
        }
    }
    for (i = 0; i < n; i++) {
        const uint32_t *t = out[i];
        if (t[0] == t[1] || t[0] == t[2] || t[0] == t[3] || t[1] == t[2] || t[1] == t[3] || t[2] == t[3]) {
            ++*repeated;
            continue;
        }
        if (m != i) memcpy(out[m], t, sizeof out[0]);
        m++;
    }
    return m;
}

/* ---- import ---- */

typedef struct tetcasti_import {
    const tetcast_mesh_desc *desc;
    const tetcast_input *in;    /* one of the two */
    const tetcast_grid *grid;
    tetcasti_mem *mem;
    tetcast_report *report;
    tetcast_mesh *mesh;
    size_t position_stride;
    double grid_axis[3][3];     /* columns of the matrix, times spacing for uniform grids */
    uint64_t source_count;      /* cells of the input */
    uint32_t input_vertices;
    uint32_t cell_chunks;
    uint8_t *state;             /* per vertex of the input */
    uint32_t *canon;            /* weld: the vertex that stands for it; NULL: itself */
    uint32_t *rank;             /* per vertex of the input: its new number */
    uint32_t *vertex_source;    /* the other way round */
    uint64_t *chunk_index;      /* mixed shapes: where a chunk of cells starts in indices */
    uint64_t *chunk_out;        /* where its tetrahedra go */
    tetcast_report *chunk_report;
    tetcast_report *turn_report; /* per chunk of tetrahedra */
    double (*chunk_box)[6];
    uint32_t (*temp_tet)[4];    /* as they come */
    uint32_t *temp_source;
    uint8_t *temp_flag;
    uint32_t failed;            /* atomic */
    uint32_t strict_code;       /* tetcast_result of the first cell that strict refuses */
    uint64_t strict_at;         /* its number */
} tetcasti_import;

/* Run a function over [0, count) in chunks of `size`. */
typedef struct tetcasti_pass {
    tetcasti_import *m;
    const void *in;
    void *a, *b, *c, *d;
    uint32_t n;
} tetcasti_pass;
static uint32_t tetcasti_chunks(uint64_t count) { return (uint32_t)((count + TETCASTI_CHUNK - 1) / TETCASTI_CHUNK); }
static void tetcasti_run(tetcasti_import *m, tetcast_task_fn *task, uint64_t count) {
    tetcasti_parallel_for(&m->desc->env, task, m, tetcasti_chunks(count));
}

static void tetcasti_run_pass(tetcasti_pass *pass, tetcast_task_fn *task, uint64_t count) {
    tetcasti_parallel_for(&pass->m->desc->env, task, pass, tetcasti_chunks(count));
}

static uint32_t tetcasti_chunk_end(uint32_t chunk, uint64_t count) {
    uint64_t end = ((uint64_t)chunk + 1) * TETCASTI_CHUNK;
    return (uint32_t)(end < count ? end : count);
}

/* World position of a vertex of the input. */
static void tetcasti_import_position(const tetcasti_import *m, uint32_t v, double p[3]) {
    const tetcast_grid *g = m->grid;
    uint32_t a;
    if (g == NULL || g->positions.data != NULL) {
        const tetcast_array *array = g == NULL ? &m->in->positions : &g->positions;
        for (a = 0; a < 3; a++) p[a] = tetcasti_array_get(array, m->position_stride, v, a);
    } else {
        uint32_t at[3];
        double c[3];
        at[0] = v % g->dims[0];
        at[1] = v / g->dims[0] % g->dims[1];
        at[2] = v / g->dims[0] / g->dims[1];
        for (a = 0; a < 3; a++) {
            const tetcast_array *axis = &g->axes[a];
            c[a] = axis->data == NULL ? (double)at[a] : tetcasti_array_get(axis, tetcasti_array_stride(axis, 1), at[a],
                                                                           0);
        }
        for (a = 0; a < 3; a++)
            p[a] = g->origin[a] + (m->grid_axis[0][a] * c[0] + m->grid_axis[1][a] * c[1] + m->grid_axis[2][a] * c[2]);
    }
}

/* The tetrahedra of one cell of the input, as numbers of its vertices. *at: where it starts in `indices` (mixed shapes
   only), moved on. Returns how many; what was wrong is counted in r, with the cell as the first one. */
static uint32_t tetcasti_import_cell(const tetcasti_import *m, uint64_t cell, uint64_t *at, uint32_t out[6][4],
                                     tetcast_report *r) {
    uint32_t v[8], shape = TETCAST_SHAPE_TETRA, size = 4, i, n, bad = 0, repeated = 0, number = (uint32_t)cell;
    if (m->grid != NULL) {
        const uint32_t *dims = m->grid->dims;
        uint64_t nx = dims[0] - 1, ny = dims[1] - 1, x = cell % nx, y = cell / nx % ny, z = cell / nx / ny;
        uint32_t corner = (uint32_t)((z * dims[1] + y) * dims[0] + x), odd = (uint32_t)(x + y + z) & 1u;
        for (i = 0; i < 8; i++)
            v[i] = corner + (i & 1u) + (i >> 1 & 1u) * dims[0] + (i >> 2) * (dims[0] * dims[1]);
        if (m->grid->blanks != NULL) {
            for (i = 0; i < 8; i++) bad |= m->grid->blanks[v[i]] == 0;
            if (bad) return 0;
        }
        shape = TETCAST_SHAPE_VOXEL;
        size = 8;
        if (m->grid->alternate) {
            static const uint8_t five[5][4] = {{0, 1, 2, 4}, {3, 1, 2, 7}, {5, 1, 4, 7}, {6, 2, 4, 7}, {1, 2, 4, 7}};
            for (i = 0; i < 8; i++) bad |= m->state[v[i]] & TETCASTI_BAD;
            for (n = 0; n < 5 && !bad; n++)
                for (i = 0; i < 4; i++) {
                    uint32_t u = v[five[n][i] ^ odd];
                    out[n][i] = m->canon != NULL ? m->canon[u] : u;
                }
            if (!bad) {
                uint32_t kept = 0;
                for (n = 0; n < 5; n++) {
                    uint32_t one[6][4];
                    if (tetcasti_cut(TETCAST_SHAPE_TETRA, out[n], one, &repeated)) memcpy(out[kept++], one[0], 16);
                }
                if (repeated && r->repeated == 0) r->first_repeated = number;
                r->repeated += repeated;
                return kept;
            }
        }
    } else {
        if (m->in->shapes != NULL) {
            shape = m->in->shapes[cell];
            size = tetcasti_shape_size(shape);
        } else {
            *at = cell * 4;
        }
        if (size == 0) return 0; /* counted before */
        for (i = 0; i < size; i++) {
            v[i] = m->in->indices[*at + i];
            bad |= (uint32_t)(v[i] >= m->input_vertices);
        }
        *at += size;
        if (bad) {
            if (r->bad_indices++ == 0) r->first_bad_index = number;
            return 0;
        }
    }
    bad = 0;
    for (i = 0; i < size; i++) {
        bad |= tetcasti_relaxed_load(&m->state[v[i]]) & TETCASTI_BAD;
        if (m->canon != NULL) v[i] = m->canon[v[i]];
    }
    if (bad) {
        if (r->bad_positions++ == 0) r->first_bad_position = number;
        return 0;
    }
    n = tetcasti_cut(shape, v, out, &repeated);
    if (repeated && r->repeated == 0) r->first_repeated = number;
    r->repeated += repeated;
    return n;
}

/* ---- import, step 1: which vertices and cells can be used ---- */

static void tetcasti_task_state(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    uint32_t v = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->input_vertices), a;
    for (; v < end; v++) {
        double p[3];
        uint8_t bad = 0;
        tetcasti_import_position(m, v, p);
        for (a = 0; a < 3; a++) bad |= !(tetcasti_abs(p[a]) <= 1e100);
        m->state[v] = bad ? TETCASTI_BAD : 0;
    }
}

/* Vertices at the same place, as floats: the one with the smallest number stands for all. */
static int tetcasti_weld(tetcasti_import *m) {
    uint32_t bits = 4, v, *table;
    while (bits < 31 && ((uint32_t)1 << bits) < 2 * (uint64_t)m->input_vertices) bits++;
    m->canon = (uint32_t *)tetcasti_alloc_array(m->mem, m->input_vertices, sizeof *m->canon);
    table = (uint32_t *)tetcasti_alloc_array(m->mem, (size_t)1 << bits, sizeof *table);
    if (m->canon == NULL || table == NULL) {
        tetcasti_free(m->mem, table);
        return 0;
    }
    memset(table, 0xff, sizeof *table << bits);
    for (v = 0; v < m->input_vertices; v++) {
        double p[3], q[3];
        float f[3];
        uint32_t a, h, key[3];
        m->canon[v] = v;
        if (m->state[v] & TETCASTI_BAD) continue;
        tetcasti_import_position(m, v, p);
        for (a = 0; a < 3; a++) f[a] = (float)p[a] + 0.0f; /* -0 is 0 */
        memcpy(key, f, sizeof key);
        h = (uint32_t)(tetcasti_hash_mix(tetcasti_hash_mix(key[0], key[1]), key[2]) *
                       0x9e3779b97f4a7c15u >> (64 - bits));
        for (;; h = (h + 1) & (((uint32_t)1 << bits) - 1u)) {
            uint32_t u = table[h];
            if (u == TETCASTI_NONE) {
                table[h] = v;
                break;
            }
            tetcasti_import_position(m, u, q);
            if ((float)q[0] == f[0] && (float)q[1] == f[1] && (float)q[2] == f[2]) {
                m->canon[v] = u;
                m->report->welded++;
                break;
            }
        }
    }
    tetcasti_free(m->mem, table);
    return 1;
}

/* Mixed shapes: how many indices a chunk of cells has; a shape that is none ends the list. */
static void tetcasti_task_sizes(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    uint64_t n = 0;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->source_count);
    for (; i < end; i++) {
        uint32_t size = tetcasti_shape_size(m->in->shapes[i]);
        n = size == 0 ? n | (uint64_t)1 << 63 : n + size;
    }
    m->chunk_index[chunk] = n;
}

static tetcast_result tetcasti_import_sizes(tetcasti_import *m) {
    uint64_t sum = 0, n;
    uint32_t chunk, i, end;
    if (m->in == NULL || m->in->shapes == NULL) {
        if (m->in != NULL && m->source_count * 4 > m->in->index_count)
            return tetcasti_fail(m->desc->env.error, TETCAST_ERR_TRUNCATED, m->in->index_count,
                                 "mesh: fewer indices than the cells need: %");
        return TETCAST_OK;
    }
    tetcasti_run(m, tetcasti_task_sizes, m->source_count);
    for (chunk = 0; chunk < m->cell_chunks; chunk++) {
        n = m->chunk_index[chunk];
        m->chunk_index[chunk] = sum;
        if (n >> 63) break;
        sum += n;
    }
    if (chunk < m->cell_chunks) { /* up to the cell that cannot be read */
        end = tetcasti_chunk_end(chunk, m->source_count);
        for (i = chunk * TETCASTI_CHUNK; i < end && tetcasti_shape_size(m->in->shapes[i]) != 0; i++)
            sum += tetcasti_shape_size(m->in->shapes[i]);
        if (m->desc->strict)
            return tetcasti_fail(m->desc->env.error, TETCAST_ERR_FORMAT, i, "mesh: cell % has an unknown shape");
        m->report->bad_shapes = m->source_count - i;
        m->source_count = i;
        m->cell_chunks = tetcasti_chunks(m->source_count);
    }
    if (sum > m->in->index_count)
        return tetcasti_fail(m->desc->env.error, TETCAST_ERR_TRUNCATED, m->in->index_count,
                             "mesh: fewer indices than the cells need: %");
    return TETCAST_OK;
}

static void tetcasti_report_open(tetcast_report *r) {
    memset(r, 0, sizeof *r);
    r->first_bad_index = r->first_bad_position = r->first_repeated = r->first_duplicate = TETCAST_NONE;
    r->first_zero_volume = r->first_inverted = r->first_nonmanifold = r->first_bad_value = TETCAST_NONE;
}

/* Add what a chunk found; chunks come in order. */
static void tetcasti_report_add(tetcast_report *to, const tetcast_report *r) {
    if (to->bad_indices == 0) to->first_bad_index = r->first_bad_index;
    if (to->bad_positions == 0) to->first_bad_position = r->first_bad_position;
    if (to->repeated == 0) to->first_repeated = r->first_repeated;
    if (r->first_zero_volume < to->first_zero_volume) to->first_zero_volume = r->first_zero_volume;
    if (to->nonmanifold_faces == 0) to->first_nonmanifold = r->first_nonmanifold;
    to->bad_indices += r->bad_indices;
    to->bad_positions += r->bad_positions;
    to->repeated += r->repeated;
    to->zero_volume += r->zero_volume;
    to->turned += r->turned;
    to->nonmanifold_faces += r->nonmanifold_faces;
    to->duplicates += r->duplicates;
    to->inverted += r->inverted;
}

TETCASTI_INLINE void tetcasti_mark_used(tetcasti_import *m, const uint32_t *v) {
    uint32_t k;
    for (k = 0; k < 4; k++)
        if (tetcasti_relaxed_load(&m->state[v[k]]) == 0) tetcasti_relaxed_store(&m->state[v[k]], TETCASTI_USED);
}

/* Is cell i of a list of tetrahedra, v, as it should be? The other ones take the way of all shapes. */
TETCASTI_INLINE int tetcasti_plain_tet(const tetcasti_import *m, const uint32_t *v) {
    uint32_t n = m->input_vertices;
    if (v[0] >= n || v[1] >= n || v[2] >= n || v[3] >= n) return 0;
    if (v[0] == v[1] || v[0] == v[2] || v[0] == v[3] || v[1] == v[2] || v[1] == v[3] || v[2] == v[3]) return 0;
    return ((tetcasti_relaxed_load(&m->state[v[0]]) | tetcasti_relaxed_load(&m->state[v[1]]) |
             tetcasti_relaxed_load(&m->state[v[2]]) | tetcasti_relaxed_load(&m->state[v[3]])) & TETCASTI_BAD) == 0;
}

/* Count the tetrahedra of a chunk of cells and mark their vertices. */
static void tetcasti_task_count(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    tetcast_report *r = &m->chunk_report[chunk];
    uint64_t at = m->chunk_index[chunk], sum = 0;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->source_count), out[6][4], n, j;
    int plain = m->grid == NULL && m->in->shapes == NULL && m->canon == NULL;
    tetcasti_report_open(r);
    for (; i < end; i++) {
        if (plain && tetcasti_plain_tet(m, m->in->indices + 4 * (size_t)i)) {
            tetcasti_mark_used(m, m->in->indices + 4 * (size_t)i);
            sum++;
            continue;
        }
        n = tetcasti_import_cell(m, i, &at, out, r);
        sum += n;
        for (j = 0; j < n; j++) tetcasti_mark_used(m, out[j]);
    }
    m->chunk_out[chunk] = sum;
}

static void tetcasti_task_box(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    double *box = m->chunk_box[chunk];
    uint32_t v = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->input_vertices), a;
    for (a = 0; a < 3; a++) {
        box[a] = (double)INFINITY;
        box[a + 3] = -(double)INFINITY;
    }
    for (; v < end; v++) {
        double p[3];
        if (m->state[v] != TETCASTI_USED) continue;
        tetcasti_import_position(m, v, p);
        for (a = 0; a < 3; a++) {
            box[a] = tetcasti_min(box[a], p[a]);
            box[a + 3] = tetcasti_max(box[a + 3], p[a]);
        }
    }
}

/* 2^e, |e| < 1000 */
static double tetcasti_power2(int32_t e) {
    uint64_t bits = (uint64_t)(e + 1023) << 52;
    double v;
    memcpy(&v, &bits, sizeof v);
    return v;
}

static void tetcasti_import_place(tetcasti_import *m) { /* origin and scale from the box of what is used */
    double lo[3], hi[3], side = 0.0;
    uint32_t chunk, a;
    for (a = 0; a < 3; a++) {
        lo[a] = (double)INFINITY;
        hi[a] = -(double)INFINITY;
        for (chunk = 0; chunk < tetcasti_chunks(m->input_vertices); chunk++) {
            lo[a] = tetcasti_min(lo[a], m->chunk_box[chunk][a]);
            hi[a] = tetcasti_max(hi[a], m->chunk_box[chunk][a + 3]);
        }
        m->mesh->origin[a] = 0.5 * (lo[a] + hi[a]);
        side = tetcasti_max(side, hi[a] - lo[a]);
    }
    m->mesh->scale_log = 0;
    if (side > 1e-100) {
        uint64_t bits;
        memcpy(&bits, &side, sizeof bits);
        m->mesh->scale_log = TETCASTI_SIDE_LOG - 1 - ((int32_t)(bits >> 52) - 1023); /* 2^e <= side < 2^(e+1) */
    }
    m->mesh->unit = tetcasti_power2(-m->mesh->scale_log);
}

/* Local coordinate of a world coordinate. */
TETCASTI_INLINE float tetcasti_local(double world, double origin, double scale) {
    double v = (world - origin) * scale;
    v = (v + TETCASTI_SNAP) - TETCASTI_SNAP;
    return (float)v;
}

/* ---- import, step 2: the order of vertices ---- */

/* Place on the Hilbert curve of 2^16 cells along an axis. J. Skilling: Programming the Hilbert curve. AIP 707, 2004. */
static uint64_t tetcasti_hilbert(uint32_t x, uint32_t y, uint32_t z) {
    uint32_t q, t, m;
    for (q = (uint32_t)1 << 15; q > 1; q >>= 1) { /* without branches: m is all ones where the bit is set */
        uint32_t p = q - 1;
        m = 0u - (uint32_t)((x & q) != 0);
        x ^= p & m;
        m = 0u - (uint32_t)((y & q) != 0);
        t = (x ^ y) & p & ~m;
        x ^= (p & m) | t;
        y ^= t;
        m = 0u - (uint32_t)((z & q) != 0);
        t = (x ^ z) & p & ~m;
        x ^= (p & m) | t;
        z ^= t;
    }
    y ^= x;
    z ^= y;
    t = 0;
    for (q = (uint32_t)1 << 15; q > 1; q >>= 1) t ^= (q - 1) & (0u - (uint32_t)((z & q) != 0));
    return tetcasti_spread3(z ^ t) | tetcasti_spread3(y ^ t) << 1 | tetcasti_spread3(x ^ t) << 2;
}

typedef struct tetcasti_keyed { uint64_t key; uint32_t index, pad; } tetcasti_keyed;

/* Sort by the lower 48 bits of the key, stable; `spare` is as large as `a`. The result is in a. */
static void tetcasti_sort48(tetcasti_keyed *a, tetcasti_keyed *spare, uint32_t n) {
    uint32_t pass, i, start[2048];
    tetcasti_keyed *from = a, *to = spare, *swap;
    for (pass = 0; pass < 5; pass++) {
        uint32_t shift = pass * 11, sum = 0;
        memset(start, 0, sizeof start);
        for (i = 0; i < n; i++) start[from[i].key >> shift & 2047u]++;
        if (n != 0 && start[from[0].key >> shift & 2047u] == n) continue; /* all the same */
        for (i = 0; i < 2048; i++) {
            uint32_t c = start[i];
            start[i] = sum;
            sum += c;
        }
        for (i = 0; i < n; i++) to[start[from[i].key >> shift & 2047u]++] = from[i];
        swap = from;
        from = to;
        to = swap;
    }
    if (from != a) memcpy(a, from, (size_t)n * sizeof *a);
}

static void tetcasti_task_key(void *ctx, uint32_t chunk) {
    tetcasti_pass *pass = (tetcasti_pass *)ctx;
    const tetcasti_import *m = pass->m;
    tetcasti_keyed *keyed = (tetcasti_keyed *)pass->a;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, pass->n), a;
    double scale = tetcasti_power2(m->mesh->scale_log);
    for (; i < end; i++) {
        uint32_t q[3];
        double p[3];
        tetcasti_import_position(m, keyed[i].index, p);
        for (a = 0; a < 3; a++) { /* [-2^29, 2^29] -> [0, 65535] */
            double v = ((p[a] - m->mesh->origin[a]) * scale + 536870912.0) * (1.0 / 16384.0);
            q[a] = v > 0.0 ? v < 65535.0 ? (uint32_t)v : 65535u : 0u;
        }
        keyed[i].key = m->desc->order == TETCAST_ORDER_HILBERT ? tetcasti_hilbert(q[0], q[1], q[2])
                                                                : tetcasti_morton(q[0], q[1], q[2]);
    }
}

static void tetcasti_task_vertex(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->mesh->vertex_count);
    double scale = tetcasti_power2(m->mesh->scale_log);
    for (; i < end; i++) {
        tetcasti_vertex *v = &m->mesh->vertex[i];
        double p[3];
        tetcasti_import_position(m, m->vertex_source[i], p);
        v->x = tetcasti_local(p[0], m->mesh->origin[0], scale);
        v->y = tetcasti_local(p[1], m->mesh->origin[1], scale);
        v->z = tetcasti_local(p[2], m->mesh->origin[2], scale);
        v->s = 0.0f;
    }
}

/* Number the used vertices and write them down in that order. */
static int tetcasti_import_vertices(tetcasti_import *m) {
    tetcast_mesh *mesh = m->mesh;
    tetcasti_keyed *keyed = NULL, *spare = NULL;
    tetcasti_pass pass;
    uint32_t v, n = 0, i;
    for (v = 0; v < m->input_vertices; v++) n += m->state[v] == TETCASTI_USED;
    mesh->vertex_count = n;
    m->report->vertices = n;
    m->report->unused_vertices = m->input_vertices - n - m->report->welded;
    m->rank = (uint32_t *)tetcasti_alloc_array(m->mem, m->input_vertices, sizeof *m->rank);
    m->vertex_source = (uint32_t *)tetcasti_alloc_array(m->mem, n, sizeof *m->vertex_source);
    mesh->vertex = (tetcasti_vertex *)tetcasti_alloc_array(m->mem, (size_t)n + 1, sizeof *mesh->vertex);
    if (m->rank == NULL || m->vertex_source == NULL || mesh->vertex == NULL) return 0;
    n = 0;
    for (v = 0; v < m->input_vertices; v++)
        if (m->state[v] == TETCASTI_USED) m->vertex_source[n++] = v;
    if (m->desc->order != TETCAST_ORDER_INPUT) {
        keyed = (tetcasti_keyed *)tetcasti_alloc_array(m->mem, n, sizeof *keyed);
        spare = (tetcasti_keyed *)tetcasti_alloc_array(m->mem, n, sizeof *spare);
        if (keyed == NULL || spare == NULL) {
            tetcasti_free(m->mem, keyed);
            tetcasti_free(m->mem, spare);
            return 0;
        }
        for (i = 0; i < n; i++) keyed[i].index = m->vertex_source[i];
        memset(&pass, 0, sizeof pass);
        pass.m = m;
        pass.a = keyed;
        pass.n = n;
        tetcasti_run_pass(&pass, tetcasti_task_key, n);
        tetcasti_sort48(keyed, spare, n);
        for (i = 0; i < n; i++) m->vertex_source[i] = keyed[i].index;
        tetcasti_free(m->mem, keyed);
        tetcasti_free(m->mem, spare);
    }
    for (i = 0; i < n; i++) m->rank[m->vertex_source[i]] = i;
    tetcasti_run(m, tetcasti_task_vertex, n);
    memset(&mesh->vertex[n], 0, sizeof mesh->vertex[n]);
    return 1;
}

/* ---- import, step 3: tetrahedra, sorted by their smallest vertex ---- */

/* The vertices of a tetrahedron by their new numbers: v0 < v1 < min(v2, v3), oriented as it was. */
TETCASTI_INLINE void tetcasti_canonical(const tetcasti_import *m, const uint32_t *v, uint32_t *tet) {
    uint32_t a = m->rank[v[0]], b = m->rank[v[1]], c = m->rank[v[2]], d = m->rank[v[3]], t, odd = 0;
#define TETCASTI_ORDER(p, q) t = p < q ? p : q; odd ^= (uint32_t)(q < p); q = p < q ? q : p; p = t
    TETCASTI_ORDER(a, b);
    TETCASTI_ORDER(c, d);
    TETCASTI_ORDER(a, c);
    TETCASTI_ORDER(b, d);
    TETCASTI_ORDER(b, c);
#undef TETCASTI_ORDER
    tet[0] = a;
    tet[1] = b;
    tet[2] = odd ? d : c;
    tet[3] = odd ? c : d;
}

static void tetcasti_task_tets(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    tetcast_report ignored;
    uint64_t at = m->chunk_index[chunk], to = m->chunk_out[chunk];
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->source_count), out[6][4], n, j;
    int plain = m->grid == NULL && m->in->shapes == NULL && m->canon == NULL;
    for (; i < end; i++) {
        if (plain && tetcasti_plain_tet(m, m->in->indices + 4 * (size_t)i)) {
            tetcasti_canonical(m, m->in->indices + 4 * (size_t)i, m->temp_tet[to]);
            m->temp_source[to++] = i;
            continue;
        }
        n = tetcasti_import_cell(m, i, &at, out, &ignored);
        for (j = 0; j < n; j++) {
            tetcasti_canonical(m, out[j], m->temp_tet[to]);
            m->temp_source[to++] = i;
        }
    }
}

/* Six times the volume where rounding cannot have changed its sign, else 0. Rounding moves it by less than 1e-15 times
   the sum of all products, and that is at most 3^1.5 times the product of the edges' lengths. Unlike absolute values
   these need no branches. */
TETCASTI_INLINE double tetcasti_volume6_clear(const tetcasti_vertex *a, const tetcasti_vertex *b,
                                              const tetcasti_vertex *c, const tetcasti_vertex *d) {
    double u0 = (double)b->x - (double)a->x, u1 = (double)b->y - (double)a->y, u2 = (double)b->z - (double)a->z;
    double v0 = (double)c->x - (double)a->x, v1 = (double)c->y - (double)a->y, v2 = (double)c->z - (double)a->z;
    double w0 = (double)d->x - (double)a->x, w1 = (double)d->y - (double)a->y, w2 = (double)d->z - (double)a->z;
    double det = u0 * (v1 * w2 - v2 * w1) + u1 * (v2 * w0 - v0 * w2) + u2 * (v0 * w1 - v1 * w0);
    double size = (u0 * u0 + u1 * u1 + u2 * u2) * (v0 * v0 + v1 * v1 + v2 * v2) * (w0 * w0 + w1 * w1 + w2 * w2);
    return det * det > 3e-29 * size ? det : 0.0;
}

/* Turn tetrahedra of negative volume over. Done when they are in order, and so are the vertices that they need. */
static void tetcasti_task_turn(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    const tetcasti_vertex *vertex = m->mesh->vertex;
    tetcast_report *r = &m->turn_report[chunk];
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->mesh->cell_count);
    tetcasti_report_open(r);
    for (; i < end; i++) {
        uint32_t *t = m->mesh->tet[i], x;
        double volume = tetcasti_volume6_clear(&vertex[t[0]], &vertex[t[1]], &vertex[t[2]], &vertex[t[3]]);
        if (volume == 0.0) volume = tetcasti_volume6(&vertex[t[0]], &vertex[t[1]], &vertex[t[2]], &vertex[t[3]]);
        if (volume > 0.0) continue;
        if (volume < 0.0) {
            x = t[2];
            t[2] = t[3];
            t[3] = x;
            r->turned++;
        } else {
            if (r->zero_volume++ == 0 || m->mesh->source_cell[i] < r->first_zero_volume)
                r->first_zero_volume = m->mesh->source_cell[i];
        }
    }
}

/* Sort numbers [0, n) by keys below key_count, stable: order[] gets the numbers, end[k] the place behind those with
   key k. Two steps: into ranges of keys by chunks, then each range by itself. */
typedef struct tetcasti_sorter {
    const uint32_t *key;        /* key[i * key_step] */
    size_t key_step;
    uint32_t n, key_count, shift, ranges, chunk_size, chunks;
    uint32_t *histogram;        /* [chunk][range], then where the chunk writes */
    uint32_t *range_start;      /* [ranges + 1] */
    uint32_t (*pair)[2];        /* key, number */
    uint32_t *order, *end;
    const uint32_t (*tet)[4];   /* with to_tet: also move records */
    uint32_t (*to_tet)[4];
    const uint32_t *source;
    uint32_t *to_source;
} tetcasti_sorter;

static void tetcasti_task_sort_count(void *ctx, uint32_t chunk) {
    tetcasti_sorter *s = (tetcasti_sorter *)ctx;
    uint32_t *h = s->histogram + (size_t)chunk * s->ranges, i = chunk * s->chunk_size, end;
    end = s->n - i < s->chunk_size ? s->n : i + s->chunk_size;
    memset(h, 0, s->ranges * sizeof *h);
    for (; i < end; i++) h[s->key[i * s->key_step] >> s->shift]++;
}

static void tetcasti_task_sort_scatter(void *ctx, uint32_t chunk) {
    tetcasti_sorter *s = (tetcasti_sorter *)ctx;
    uint32_t *h = s->histogram + (size_t)chunk * s->ranges, i = chunk * s->chunk_size, end;
    end = s->n - i < s->chunk_size ? s->n : i + s->chunk_size;
    for (; i < end; i++) {
        uint32_t key = s->key[i * s->key_step], *p = s->pair[h[key >> s->shift]++];
        p[0] = key;
        p[1] = i;
    }
}

static void tetcasti_task_sort_range(void *ctx, uint32_t range) {
    tetcasti_sorter *s = (tetcasti_sorter *)ctx;
    uint32_t first = s->range_start[range], last = s->range_start[range + 1], i, sum = first;
    uint32_t k = range << s->shift, k_end = (range + 1) << s->shift;
    if (k_end > s->key_count || range + 1 == s->ranges) k_end = s->key_count;
    for (i = k; i < k_end; i++) s->end[i] = 0;
    for (i = first; i < last; i++) s->end[s->pair[i][0]]++;
    for (i = k; i < k_end; i++) {
        uint32_t c = s->end[i];
        s->end[i] = sum;
        sum += c;
    }
    for (i = first; i < last; i++) {
        uint32_t to = s->end[s->pair[i][0]]++, from = s->pair[i][1];
        if (s->to_tet != NULL) {
            memcpy(s->to_tet[to], s->tet[from], sizeof s->tet[0]);
            s->to_source[to] = s->source[from];
        } else {
            s->order[to] = from;
        }
    }
}

static int tetcasti_sort(tetcasti_mem *mem, const tetcast_env *env, tetcasti_sorter *s) { /* 0: no memory */
    uint32_t range, chunk, sum = 0, bits = 0;
    while (bits < 31 && (s->key_count - 1) >> bits != 0) bits++;
    s->shift = bits > 16 ? bits - 10 : bits > 6 ? 6 : bits; /* up to 1024 ranges of 64 keys or more */
    s->ranges = ((s->key_count - 1) >> s->shift) + 1;
    s->chunk_size = s->n / 512 + 1 > TETCASTI_CHUNK ? s->n / 512 + 1 : TETCASTI_CHUNK;
    s->chunks = (s->n + s->chunk_size - 1) / s->chunk_size;
    s->histogram = (uint32_t *)tetcasti_alloc_array(mem, (size_t)s->chunks * s->ranges, sizeof *s->histogram);
    s->range_start = (uint32_t *)tetcasti_alloc_array(mem, (size_t)s->ranges + 1, sizeof *s->range_start);
    s->pair = (uint32_t (*)[2])tetcasti_alloc_array(mem, s->n, sizeof *s->pair);
    if (s->histogram != NULL && s->range_start != NULL && s->pair != NULL) {
        tetcasti_parallel_for(env, tetcasti_task_sort_count, s, s->chunks);
        for (range = 0; range < s->ranges; range++) {
            s->range_start[range] = sum;
            for (chunk = 0; chunk < s->chunks; chunk++) {
                uint32_t *h = &s->histogram[(size_t)chunk * s->ranges + range], c = *h;
                *h = sum;
                sum += c;
            }
        }
        s->range_start[s->ranges] = sum;
        tetcasti_parallel_for(env, tetcasti_task_sort_scatter, s, s->chunks);
        tetcasti_parallel_for(env, tetcasti_task_sort_range, s, s->ranges);
        range = 1;
    } else {
        range = 0;
    }
    tetcasti_free(mem, s->histogram);
    tetcasti_free(mem, s->range_start);
    tetcasti_free(mem, s->pair);
    return (int)range;
}

/* ---- import, step 4: neighbours ---- */

typedef struct tetcasti_matcher {
    tetcasti_mem *mem;
    const tetcast_env *env;
    uint32_t (*tet)[4];
    uint32_t (*neighbour)[4];
    uint32_t cell_count, vertex_count;
    uint32_t *own_list, *own_end;         /* tetrahedra by v0; own_list NULL: they are in that order themselves */
    uint32_t *foreign_list, *foreign_end; /* by v1 */
    uint32_t vertices_per_task;
    uint32_t failed, conflicts, duplicates, nonmanifold, first_nonmanifold; /* atomics; the last: a cell, smallest */
} tetcasti_matcher;

/* A face in the table of its smallest vertex. One that was seen once has two == NONE; three or more: one == NONE. */
typedef struct tetcasti_slot {
    uint64_t key;               /* the other two vertices; all ones: empty */
    uint32_t one, two;          /* cells */
    uint8_t one_face, two_face, one_sign, pad;
} tetcasti_slot;

typedef struct tetcasti_found { uint32_t conflicts, duplicates, nonmanifold, first_nonmanifold; } tetcasti_found;

static void tetcasti_match_face(const tetcasti_matcher *m, tetcasti_slot *table, uint32_t bits, uint32_t p, uint32_t q,
                                uint32_t cell, uint32_t face, uint32_t sign, tetcasti_found *found) {
    uint64_t key = (uint64_t)p << 32 | q;
    uint32_t h = (p * 0x9e3779b1u ^ q * 0x85ebca6bu) * 0x9e3779b1u >> (32 - bits);
    tetcasti_slot *s;
    for (;; h = (h + 1) & ((1u << bits) - 1u)) {
        s = &table[h];
        if (s->key == key) break;
        if (s->key == ~(uint64_t)0) {
            s->key = key;
            s->one = cell;
            s->two = TETCASTI_NONE;
            s->one_face = (uint8_t)face;
            s->one_sign = (uint8_t)sign;
            m->neighbour[cell][face] = TETCASTI_NONE;
            return;
        }
    }
    if (s->one == TETCASTI_NONE) { /* the fourth and so on */
        m->neighbour[cell][face] = TETCASTI_NONE;
        return;
    }
    found->duplicates += m->tet[cell][face] == m->tet[s->one][s->one_face];
    if (s->two == TETCASTI_NONE) {
        s->two = cell;
        s->two_face = (uint8_t)face;
        m->neighbour[cell][face] = s->one;
        m->neighbour[s->one][s->one_face] = cell;
        found->conflicts += s->one_sign == sign;
        return;
    }
    found->duplicates += m->tet[cell][face] == m->tet[s->two][s->two_face];
    found->nonmanifold++;
    if (s->one < found->first_nonmanifold) found->first_nonmanifold = s->one;
    m->neighbour[s->one][s->one_face] = TETCASTI_NONE;
    m->neighbour[s->two][s->two_face] = TETCASTI_NONE;
    m->neighbour[cell][face] = TETCASTI_NONE;
    s->one = TETCASTI_NONE;
}

static void tetcasti_task_match(void *ctx, uint32_t task) {
    tetcasti_matcher *m = (tetcasti_matcher *)ctx;
    uint32_t v = task * m->vertices_per_task, end, i, most = 0, bits = 4, n, lo, hi;
    tetcasti_slot *table;
    tetcasti_found found;
    end = m->vertex_count - v < m->vertices_per_task ? m->vertex_count : v + m->vertices_per_task;
    memset(&found, 0, sizeof found);
    found.first_nonmanifold = TETCASTI_NONE;
    for (i = v; i < end; i++) {
        uint32_t own = m->own_end[i] - (i != 0 ? m->own_end[i - 1] : 0);
        n = 3 * own + m->foreign_end[i] - (i != 0 ? m->foreign_end[i - 1] : 0);
        if (n > most) most = n;
    }
    while (bits < 31 && ((uint32_t)1 << bits) < 2 * most) bits++;
    table = (tetcasti_slot *)tetcasti_alloc_array(m->mem, (size_t)1 << bits, sizeof *table);
    if (table == NULL) {
        tetcasti_atomic_store(&m->failed, 1u);
        return;
    }
    for (; v < end; v++) {
        uint32_t own = v != 0 ? m->own_end[v - 1] : 0, own_end = m->own_end[v];
        uint32_t foreign = v != 0 ? m->foreign_end[v - 1] : 0, foreign_end = m->foreign_end[v];
        n = 3 * (own_end - own) + (foreign_end - foreign);
        if (n == 0) continue;
        bits = 4;
        while (((uint32_t)1 << bits) < n + n / 2) bits++;
        for (i = 0; i < (uint32_t)1 << bits; i++) table[i].key = ~(uint64_t)0;
        for (; own < own_end; own++) {
            uint32_t cell = m->own_list != NULL ? m->own_list[own] : own;
            const uint32_t *t = m->tet[cell];
            uint32_t odd = t[2] > t[3];
            lo = odd ? t[3] : t[2];
            hi = odd ? t[2] : t[3];
            /* the sign says on which side of the face, by its sorted vertices, the cell lies */
            tetcasti_match_face(m, table, bits, t[1], t[2], cell, 3, 1, &found);
            tetcasti_match_face(m, table, bits, t[1], t[3], cell, 2, 0, &found);
            tetcasti_match_face(m, table, bits, lo, hi, cell, 1, 1 ^ odd, &found);
        }
        for (; foreign < foreign_end; foreign++) {
            uint32_t cell = m->foreign_list[foreign];
            const uint32_t *t = m->tet[cell];
            uint32_t odd = t[2] > t[3];
            lo = odd ? t[3] : t[2];
            hi = odd ? t[2] : t[3];
            tetcasti_match_face(m, table, bits, lo, hi, cell, 0, odd, &found);
        }
    }
    tetcasti_free(m->mem, table);
    if (found.conflicts != 0) (void)tetcasti_atomic_add(&m->conflicts, found.conflicts);
    if (found.duplicates != 0) (void)tetcasti_atomic_add(&m->duplicates, found.duplicates);
    if (found.nonmanifold != 0) {
        uint32_t seen = tetcasti_atomic_load(&m->first_nonmanifold);
        (void)tetcasti_atomic_add(&m->nonmanifold, found.nonmanifold);
        while (found.first_nonmanifold < seen &&
               !tetcasti_atomic_max_step(&m->first_nonmanifold, &seen, found.first_nonmanifold)) { }
    }
}

/* Fill neighbour[] from tet[]: each written as v0 < v1 < min(v2, v3). sorted: they are in the order of v0 and own_end
   is known; else both lists are made. */
static int tetcasti_match(tetcasti_matcher *m, int sorted) { /* 0: no memory */
    tetcasti_sorter s;
    int ok = 1;
    m->foreign_list = (uint32_t *)tetcasti_alloc_array(m->mem, m->cell_count, sizeof *m->foreign_list);
    m->foreign_end = (uint32_t *)tetcasti_alloc_array(m->mem, m->vertex_count, sizeof *m->foreign_end);
    ok = m->foreign_list != NULL && m->foreign_end != NULL;
    memset(&s, 0, sizeof s);
    s.key_step = 4;
    s.n = m->cell_count;
    s.key_count = m->vertex_count;
    if (ok && !sorted) {
        m->own_list = (uint32_t *)tetcasti_alloc_array(m->mem, m->cell_count, sizeof *m->own_list);
        if (m->own_end == NULL)
            m->own_end = (uint32_t *)tetcasti_alloc_array(m->mem, m->vertex_count, sizeof *m->own_end);
        s.key = &m->tet[0][0];
        s.order = m->own_list;
        s.end = m->own_end;
        ok = m->own_list != NULL && m->own_end != NULL && tetcasti_sort(m->mem, m->env, &s);
    }
    if (ok) {
        s.key = &m->tet[0][1];
        s.order = m->foreign_list;
        s.end = m->foreign_end;
        ok = tetcasti_sort(m->mem, m->env, &s);
    }
    if (ok) {
        m->failed = m->conflicts = m->duplicates = m->nonmanifold = 0;
        m->first_nonmanifold = TETCASTI_NONE;
        m->vertices_per_task = m->vertex_count / 1024 + 64;
        tetcasti_parallel_for(m->env, tetcasti_task_match, m,
                              (m->vertex_count + m->vertices_per_task - 1) / m->vertices_per_task);
        ok = !m->failed;
    }
    tetcasti_free(m->mem, m->foreign_list);
    tetcasti_free(m->mem, m->foreign_end);
    m->foreign_list = m->foreign_end = NULL;
    return ok;
}

/* Take out tetrahedra that are there twice; the first one of the input stays. Rare, so it is done by one thread. */
static int tetcasti_drop_duplicates(tetcasti_import *m, uint32_t *count) { /* 0: no memory */
    tetcast_mesh *mesh = m->mesh;
    uint32_t bits = 4, i, kept = 0, n = mesh->cell_count, *table;
    while (bits < 31 && ((uint32_t)1 << bits) < 2 * (uint64_t)n) bits++;
    table = (uint32_t *)tetcasti_alloc_array(m->mem, (size_t)1 << bits, sizeof *table);
    if (table == NULL) return 0;
    memset(table, 0xff, sizeof *table << bits);
    for (i = 0; i < n; i++) {
        const uint32_t *t = mesh->tet[i];
        uint32_t lo = t[2] < t[3] ? t[2] : t[3], hi = t[2] ^ t[3] ^ lo, h, twice = 0;
        h = (uint32_t)(tetcasti_hash_mix(tetcasti_hash_mix((uint64_t)t[0] << 32 | t[1], lo), hi) *
                       0x9e3779b97f4a7c15u >> (64 - bits));
        for (;; h = (h + 1) & (((uint32_t)1 << bits) - 1u)) {
            const uint32_t *u;
            if (table[h] == TETCASTI_NONE) {
                table[h] = kept;
                break;
            }
            u = mesh->tet[table[h]];
            if (u[0] == t[0] && u[1] == t[1] && (u[2] == lo || u[3] == lo) && (u[2] == hi || u[3] == hi)) {
                twice = 1;
                break;
            }
        }
        if (twice) {
            if (m->report->duplicates++ == 0) m->report->first_duplicate = mesh->source_cell[i];
            continue;
        }
        if (kept != i) {
            memcpy(mesh->tet[kept], t, sizeof mesh->tet[0]);
            mesh->source_cell[kept] = mesh->source_cell[i];
        }
        kept++;
    }
    tetcasti_free(m->mem, table);
    *count = kept;
    return 1;
}

/* Where neighbours disagree about their orientation (some cell is inverted or flat), let the majority by volume decide
   for each part of the mesh: after this a hull face tells inside from outside even where cells are inverted. */
static int tetcasti_orient(tetcasti_import *m) { /* 0: no memory */
    tetcast_mesh *mesh = m->mesh;
    uint32_t n = mesh->cell_count, head = 0, tail = 0, seed, i, j;
    uint32_t *queue = (uint32_t *)tetcasti_alloc_array(m->mem, n, sizeof *queue);
    uint8_t *state = (uint8_t *)tetcasti_alloc_zero(m->mem, n, 1); /* 1: seen, 2: turned over */
    if (queue == NULL || state == NULL) {
        tetcasti_free(m->mem, queue);
        tetcasti_free(m->mem, state);
        return 0;
    }
    for (seed = 0; seed < n; seed++) {
        uint32_t first = tail;
        double kept = 0.0, turned = 0.0;
        if (state[seed] != 0) continue;
        state[seed] = 1;
        queue[tail++] = seed;
        while (head < tail) {
            uint32_t cell = queue[head++], odd, sign;
            const uint32_t *t = mesh->tet[cell];
            double volume = tetcasti_abs(tetcasti_volume6(&mesh->vertex[t[0]], &mesh->vertex[t[1]], &mesh->vertex[t[2]],
                                                          &mesh->vertex[t[3]]));
            if (state[cell] & 2u) turned += volume;
            else kept += volume;
            odd = t[2] > t[3];
            for (i = 0; i < 4; i++) {
                uint32_t other = mesh->neighbour[cell][i], other_odd, other_sign;
                const uint32_t *u;
                if (other == TETCASTI_NONE || state[other] != 0) continue;
                u = mesh->tet[other];
                for (j = 0; j < 4; j++) /* the vertex that is not in the face */
                    if (u[j] != t[(i + 1) & 3] && u[j] != t[(i + 2) & 3] && u[j] != t[(i + 3) & 3]) break;
                other_odd = u[2] > u[3];
                sign = i == 0 ? odd : i == 1 ? 1 ^ odd : i == 2 ? 0 : 1u;
                other_sign = j == 0 ? other_odd : j == 1 ? 1 ^ other_odd : j == 2 ? 0 : 1u;
                state[other] = (uint8_t)(1u | ((state[cell] & 2u) ^ (sign == other_sign ? 2u : 0u)));
                queue[tail++] = other;
            }
        }
        if (turned > kept)
            for (i = first; i < tail; i++) state[queue[i]] ^= 2u;
    }
    for (i = 0; i < n; i++) {
        uint32_t *t = mesh->tet[i], *u = mesh->neighbour[i], x;
        if ((state[i] & 2u) == 0) continue;
        if (tetcasti_volume6(&mesh->vertex[t[0]], &mesh->vertex[t[1]], &mesh->vertex[t[2]],
                             &mesh->vertex[t[3]]) != 0.0 &&
            (m->report->inverted++ == 0 || mesh->source_cell[i] < m->report->first_inverted))
            m->report->first_inverted = mesh->source_cell[i];
        x = t[2]; t[2] = t[3]; t[3] = x;
        x = u[2]; u[2] = u[3]; u[3] = x;
    }
    tetcasti_free(m->mem, queue);
    tetcasti_free(m->mem, state);
    return 1;
}

/* ---- import, step 5: the hull ---- */

static void tetcasti_task_hull_count(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->mesh->cell_count);
    uint64_t n = 0;
    for (; i < end; i++) {
        const uint32_t *u = m->mesh->neighbour[i];
        n += (uint64_t)(u[0] == TETCASTI_NONE) + (u[1] == TETCASTI_NONE) + (u[2] == TETCASTI_NONE) +
             (u[3] == TETCASTI_NONE);
    }
    m->chunk_out[chunk] = n;
}

static void tetcasti_task_hull_fill(void *ctx, uint32_t chunk) {
    tetcasti_import *m = (tetcasti_import *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, m->mesh->cell_count), f, k;
    uint64_t to = m->chunk_out[chunk];
    for (; i < end; i++)
        for (f = 0; f < 4; f++)
            if (m->mesh->neighbour[i][f] == TETCASTI_NONE) {
                tetcasti_face *face = &m->mesh->face[to++];
                for (k = 0; k < 3; k++) face->v[k] = m->mesh->tet[i][tetcasti_face_of[f][k]];
                face->cell = i;
            }
}

static uint64_t tetcasti_prefix_sum(uint64_t *count, uint32_t n) { /* counts -> where each begins; the sum */
    uint64_t sum = 0, c;
    uint32_t i;
    for (i = 0; i < n; i++) {
        c = count[i];
        count[i] = sum;
        sum += c;
    }
    return sum;
}

typedef struct tetcasti_hull_task {
    tetcasti_hull *hull;
    const tetcasti_vertex *vertex;
    uint32_t level;
} tetcasti_hull_task;

static void tetcasti_task_hull_box(void *ctx, uint32_t chunk) { /* 512 boxes */
    tetcasti_hull_task *t = (tetcasti_hull_task *)ctx;
    tetcasti_hull *h = t->hull;
    uint32_t i = chunk * 512, end = h->level_size[t->level], a, j, k, last;
    if (end - i > 512) end = i + 512;
    for (; i < end; i++) {
        tetcasti_box *box = &h->box[h->level_start[t->level] + i];
        for (a = 0; a < 3; a++) {
            box->lo[a] = TETCASTI_INF;
            box->hi[a] = -TETCASTI_INF;
        }
        if (t->level == 0) {
            last = h->face_count - 8 * i < 8 ? h->face_count : 8 * i + 8;
            for (j = 8 * i; j < last; j++)
                for (k = 0; k < 3; k++) {
                    const tetcasti_vertex *v = &t->vertex[h->face[j].v[k]];
                    float p[3];
                    p[0] = v->x; p[1] = v->y; p[2] = v->z;
                    for (a = 0; a < 3; a++) {
                        box->lo[a] = p[a] < box->lo[a] ? p[a] : box->lo[a];
                        box->hi[a] = p[a] > box->hi[a] ? p[a] : box->hi[a];
                    }
                }
        } else {
            uint32_t below = h->level_size[t->level - 1];
            last = below - 8 * i < 8 ? below : 8 * i + 8;
            for (j = 8 * i; j < last; j++) {
                const tetcasti_box *b = &h->box[h->level_start[t->level - 1] + j];
                for (a = 0; a < 3; a++) {
                    box->lo[a] = b->lo[a] < box->lo[a] ? b->lo[a] : box->lo[a];
                    box->hi[a] = b->hi[a] > box->hi[a] ? b->hi[a] : box->hi[a];
                }
            }
        }
    }
}

/* Boxes over a list of faces, which is borrowed. */
static int tetcasti_hull_build(tetcasti_mem *mem, const tetcast_env *env, const tetcasti_vertex *vertex,
                               const tetcasti_face *face, uint32_t count, tetcasti_hull *hull) { /* 0: no memory */
    tetcasti_hull_task t;
    uint32_t n = count, sum = 0, level = 0;
    memset(hull, 0, sizeof *hull);
    hull->face = face;
    hull->face_count = count;
    while (n != 0) {
        n = (n + 7) / 8;
        hull->level_start[level] = sum;
        hull->level_size[level++] = n;
        sum += n;
        if (n == 1) break;
    }
    hull->level_count = level;
    hull->bytes = (size_t)sum * sizeof *hull->box;
    hull->box = (tetcasti_box *)tetcasti_alloc_array(mem, (size_t)sum + 1, sizeof *hull->box);
    if (hull->box == NULL) return 0;
    t.hull = hull;
    t.vertex = vertex;
    for (t.level = 0; t.level < level; t.level++)
        tetcasti_parallel_for(env, tetcasti_task_hull_box, &t, (hull->level_size[t.level] + 511) / 512);
    return 1;
}

static int tetcasti_import_hull(tetcasti_import *m) { /* 0: no memory */
    tetcast_mesh *mesh = m->mesh;
    uint64_t n;
    tetcasti_run(m, tetcasti_task_hull_count, mesh->cell_count);
    n = tetcasti_prefix_sum(m->chunk_out, tetcasti_chunks(mesh->cell_count));
    mesh->face_count = (uint32_t)n; /* below 2^32: at most 4 * MAX_CELLS, and checked before */
    m->report->hull_faces = n;
    mesh->face = (tetcasti_face *)tetcasti_alloc_array(m->mem, (size_t)n + 1, sizeof *mesh->face);
    if (mesh->face == NULL) return 0;
    tetcasti_run(m, tetcasti_task_hull_fill, mesh->cell_count);
    return tetcasti_hull_build(m->mem, &m->desc->env, mesh->vertex, mesh->face, mesh->face_count, &mesh->hull);
}

/* ---- import, step 6: values ---- */

static void tetcasti_task_values(void *ctx, uint32_t chunk) {
    tetcasti_pass *p = (tetcasti_pass *)ctx;
    const tetcast_field *in = (const tetcast_field *)p->in;
    tetcasti_field *out = (tetcasti_field *)p->b;
    float (*range)[2] = (float (*)[2])p->c;
    uint64_t *bad = (uint64_t *)p->d;
    const uint32_t *source = in->per_cell ? p->m->mesh->source_cell : p->m->vertex_source;
    size_t stride = tetcasti_array_stride(&in->values, 1);
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, p->n);
    float lo = TETCASTI_INF, hi = -TETCASTI_INF;
    bad[chunk] = 0;
    for (; i < end; i++) {
        double d = tetcasti_array_get(&in->values, stride, source[i], 0);
        float v = d >= -3.4028234e38 && d <= 3.4028234e38 ? (float)d : (float)NAN;
        out->value[i] = v;
        if (tetcasti_finite_f(v)) {
            lo = v < lo ? v : lo;
            hi = v > hi ? v : hi;
        } else {
            bad[chunk]++;
        }
    }
    range[chunk][0] = lo;
    range[chunk][1] = hi;
}

static void tetcasti_task_hidden(void *ctx, uint32_t chunk) { /* a multiple of 32 cells: no word has two writers */
    tetcasti_pass *p = (tetcasti_pass *)ctx;
    const tetcast_mesh *mesh = p->m->mesh;
    const tetcasti_field *f = (const tetcasti_field *)p->b;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, mesh->cell_count), j;
    for (; i < end; i++) {
        uint32_t bad = 0;
        if (f->per_cell) {
            bad = !tetcasti_finite_f(f->value[i]);
        } else {
            for (j = 0; j < 4; j++) bad |= !tetcasti_finite_f(f->value[mesh->tet[i][j]]);
        }
        if (bad) f->hidden[i >> 5] |= 1u << (i & 31u);
    }
}

static tetcast_result tetcasti_import_field(tetcasti_import *m, const tetcast_field *in, tetcasti_field *out) {
    tetcast_mesh *mesh = m->mesh;
    uint32_t n = in->per_cell ? mesh->cell_count : mesh->vertex_count, chunks = tetcasti_chunks(n), i,
        first = TETCAST_NONE;
    size_t words = (size_t)mesh->cell_count / 32 + 1, k;
    tetcasti_pass pass;
    float (*range)[2] = (float (*)[2])tetcasti_alloc_array(m->mem, chunks, sizeof *range);
    uint64_t *bad = (uint64_t *)tetcasti_alloc_array(m->mem, chunks, sizeof *bad), bads = 0;
    out->value = (float *)tetcasti_alloc_array(m->mem, (size_t)n + 1, sizeof *out->value);
    out->per_cell = in->per_cell != 0;
    for (k = 0; in->name != NULL && in->name[k] != 0 && k + 1 < sizeof out->name; k++) out->name[k] = in->name[k];
    memset(&pass, 0, sizeof pass);
    pass.m = m;
    pass.in = in;
    pass.b = out;
    pass.c = range;
    pass.d = bad;
    pass.n = n;
    if (range != NULL && bad != NULL && out->value != NULL) {
        out->value[n] = 0.0f;
        out->value_min = TETCASTI_INF;
        out->value_max = -TETCASTI_INF;
        tetcasti_parallel_for(&m->desc->env, tetcasti_task_values, &pass, chunks);
        for (i = 0; i < chunks; i++) {
            if (range[i][0] < out->value_min) out->value_min = range[i][0];
            if (range[i][1] > out->value_max) out->value_max = range[i][1];
            bads += bad[i];
        }
    }
    tetcasti_free(m->mem, range);
    tetcasti_free(m->mem, bad);
    if (range == NULL || bad == NULL || out->value == NULL) return TETCAST_ERR_NO_MEMORY;
    if (bads == 0) return TETCAST_OK;
    out->hidden = (uint32_t *)tetcasti_alloc_zero(m->mem, words, sizeof *out->hidden);
    if (out->hidden == NULL) return TETCAST_ERR_NO_MEMORY;
    if (mesh->mask != NULL) memcpy(out->hidden, mesh->mask, words * sizeof *out->hidden);
    tetcasti_run_pass(&pass, tetcasti_task_hidden, mesh->cell_count);
    for (i = 0; i < n; i++) {
        if (tetcasti_finite_f(out->value[i])) continue;
        k = in->per_cell ? mesh->source_cell[i] : m->vertex_source[i];
        if ((uint32_t)k < first) first = (uint32_t)k;
        out->value[i] = 0.0f;
    }
    if (m->desc->strict)
        return tetcasti_fail(m->desc->env.error, TETCAST_ERR_FORMAT, first,
                             in->per_cell ? "mesh: the value of cell % is no number"
                                          : "mesh: the value of vertex % is no number");
    if (m->report->bad_values == 0) m->report->first_bad_value = first;
    m->report->bad_values += bads;
    return TETCAST_OK;
}

static tetcast_result tetcasti_import_values(tetcasti_import *m) {
    tetcast_mesh *mesh = m->mesh;
    const tetcast_field *fields = m->grid != NULL ? m->grid->fields : m->in->fields;
    size_t count = m->grid != NULL ? m->grid->field_count : m->in->field_count, i;
    const uint8_t *masks = m->grid != NULL ? NULL : m->in->masks;
    if (masks != NULL) {
        mesh->mask = (uint32_t *)tetcasti_alloc_zero(m->mem, (size_t)mesh->cell_count / 32 + 1, sizeof *mesh->mask);
        if (mesh->mask == NULL) return TETCAST_ERR_NO_MEMORY;
        for (i = 0; i < mesh->cell_count; i++)
            if (masks[mesh->source_cell[i]] != 0) {
                mesh->mask[i >> 5] |= 1u << (i & 31u);
                m->report->masked++;
            }
        if (m->report->masked == 0) {
            tetcasti_free(m->mem, mesh->mask);
            mesh->mask = NULL;
        }
    }
    if (count != 0) {
        mesh->field = (tetcasti_field *)tetcasti_alloc_zero(m->mem, count, sizeof *mesh->field);
        if (mesh->field == NULL) return TETCAST_ERR_NO_MEMORY;
    }
    for (i = 0; i < count; i++) {
        tetcast_result r;
        mesh->field_count = (uint32_t)i + 1;
        r = tetcasti_import_field(m, &fields[i], &mesh->field[i]);
        if (r != TETCAST_OK) return r;
    }
    return TETCAST_OK;
}

/* ---- import: the whole of it ---- */

static tetcast_result tetcasti_cells_build(tetcasti_mem *mem, const tetcast_env *env, tetcast_cells kind,
                                           const tetcast_mesh *mesh, tetcasti_cells *cells);
static tetcast_result tetcasti_mesh_finish(tetcast_mesh *mesh, const tetcast_mesh_desc *desc);

static void tetcasti_import_close(tetcasti_import *m) {
    tetcasti_free(m->mem, m->state);
    tetcasti_free(m->mem, m->canon);
    tetcasti_free(m->mem, m->rank);
    tetcasti_free(m->mem, m->vertex_source);
    tetcasti_free(m->mem, m->chunk_index);
    tetcasti_free(m->mem, m->chunk_out);
    tetcasti_free(m->mem, m->chunk_report);
    tetcasti_free(m->mem, m->turn_report);
    tetcasti_free(m->mem, m->chunk_box);
    tetcasti_free(m->mem, m->temp_tet);
    tetcasti_free(m->mem, m->temp_source);
    m->state = NULL;
    m->canon = m->rank = m->vertex_source = m->temp_source = NULL;
    m->chunk_index = m->chunk_out = NULL;
    m->chunk_report = m->turn_report = NULL;
    m->chunk_box = NULL;
    m->temp_tet = NULL;
}

static int tetcasti_progress(const tetcasti_import *m, uint64_t done) { /* 0: cancelled */
    const tetcast_env *env = &m->desc->env;
    return env->progress_fn == NULL || env->progress_fn(env->progress_user, done, 6) == 0;
}

/* Vertices and cells that can be used; where each chunk of cells writes. *tets: how many tetrahedra. */
static tetcast_result tetcasti_import_scan(tetcasti_import *m, uint64_t *tets) {
    tetcast_error *error = m->desc->env.error;
    uint32_t i, chunks = tetcasti_chunks(m->source_count), vertex_chunks = tetcasti_chunks(m->input_vertices);
    tetcast_report *r = m->report;
    tetcast_result result;
    m->cell_chunks = chunks;
    m->state = (uint8_t *)tetcasti_alloc(m->mem, (size_t)m->input_vertices + 1);
    m->chunk_index = (uint64_t *)tetcasti_alloc_zero(m->mem, (size_t)chunks + 1, sizeof *m->chunk_index);
    m->chunk_report = (tetcast_report *)tetcasti_alloc_array(m->mem, (size_t)chunks + 1, sizeof *m->chunk_report);
    m->chunk_box = (double (*)[6])tetcasti_alloc_array(m->mem, (size_t)vertex_chunks + 1, sizeof *m->chunk_box);
    /* also counts hull faces of tetrahedra later, up to 6 from a cell */
    m->chunk_out = (uint64_t *)tetcasti_alloc_zero(m->mem, (size_t)chunks * 6 + 7, sizeof *m->chunk_out);
    if (m->state == NULL || m->chunk_index == NULL || m->chunk_report == NULL || m->chunk_box == NULL ||
        m->chunk_out == NULL) return TETCAST_ERR_NO_MEMORY;
    tetcasti_run(m, tetcasti_task_state, m->input_vertices);
    if (m->desc->weld && !tetcasti_weld(m)) return TETCAST_ERR_NO_MEMORY;
    result = tetcasti_import_sizes(m);
    if (result != TETCAST_OK) return result;
    tetcasti_run(m, tetcasti_task_count, m->source_count);
    for (i = 0; i < m->cell_chunks; i++) tetcasti_report_add(r, &m->chunk_report[i]);
    *tets = tetcasti_prefix_sum(m->chunk_out, m->cell_chunks);
    if (m->desc->strict && r->bad_indices != 0)
        return tetcasti_fail(error, TETCAST_ERR_FORMAT, r->first_bad_index,
                             "mesh: cell % has a vertex that is not there");
    if (m->desc->strict && r->bad_positions != 0)
        return tetcasti_fail(error, TETCAST_ERR_FORMAT, r->first_bad_position,
                             "mesh: cell % has a vertex whose position is no number");
    if (*tets == 0) return tetcasti_fail(error, TETCAST_ERR_EMPTY, m->source_count, "mesh: no usable cell among %");
    if (*tets > TETCAST_MAX_CELLS)
        return tetcasti_fail(error, TETCAST_ERR_RANGE, *tets, "mesh: % tetrahedra are too many");
    tetcasti_run(m, tetcasti_task_box, m->input_vertices);
    tetcasti_import_place(m);
    return TETCAST_OK;
}

static tetcast_result tetcasti_import_tets(tetcasti_import *m, uint64_t tets) {
    tetcast_mesh *mesh = m->mesh;
    tetcasti_matcher match;
    tetcasti_sorter s;
    uint32_t i, n = (uint32_t)tets, again, sorted = m->desc->order != TETCAST_ORDER_INPUT;
    int ok = 1;
    memset(&match, 0, sizeof match);
    mesh->cell_count = n;
    m->temp_tet = (uint32_t (*)[4])tetcasti_alloc_array(m->mem, n, sizeof *m->temp_tet);
    m->temp_source = (uint32_t *)tetcasti_alloc_array(m->mem, n, sizeof *m->temp_source);
    if (m->temp_tet == NULL || m->temp_source == NULL) return TETCAST_ERR_NO_MEMORY;
    m->turn_report = (tetcast_report *)tetcasti_alloc_array(m->mem, tetcasti_chunks(n), sizeof *m->turn_report);
    if (m->turn_report == NULL) return TETCAST_ERR_NO_MEMORY;
    tetcasti_run(m, tetcasti_task_tets, m->source_count);
    if (sorted) {
        mesh->tet = (uint32_t (*)[4])tetcasti_alloc_array(m->mem, n, sizeof *mesh->tet);
        mesh->source_cell = (uint32_t *)tetcasti_alloc_array(m->mem, n, sizeof *mesh->source_cell);
        match.own_end = (uint32_t *)tetcasti_alloc_array(m->mem, mesh->vertex_count, sizeof *match.own_end);
        memset(&s, 0, sizeof s);
        s.key = &m->temp_tet[0][0];
        s.key_step = 4;
        s.n = n;
        s.key_count = mesh->vertex_count;
        s.end = match.own_end;
        s.tet = (const uint32_t (*)[4])m->temp_tet;
        s.to_tet = mesh->tet;
        s.source = m->temp_source;
        s.to_source = mesh->source_cell;
        ok = mesh->tet != NULL && mesh->source_cell != NULL && match.own_end != NULL &&
             tetcasti_sort(m->mem, &m->desc->env, &s);
        tetcasti_free(m->mem, m->temp_tet);
        tetcasti_free(m->mem, m->temp_source);
    } else {
        mesh->tet = m->temp_tet;
        mesh->source_cell = m->temp_source;
    }
    m->temp_tet = NULL;
    m->temp_source = NULL;
    if (ok) {
        tetcasti_run(m, tetcasti_task_turn, n);
        for (i = 0; i < tetcasti_chunks(n); i++) tetcasti_report_add(m->report, &m->turn_report[i]);
    }
    if (ok) mesh->neighbour = (uint32_t (*)[4])tetcasti_alloc_array(m->mem, n, sizeof *mesh->neighbour);
    match.mem = m->mem;
    match.env = &m->desc->env;
    match.tet = mesh->tet;
    match.neighbour = mesh->neighbour;
    match.vertex_count = mesh->vertex_count;
    for (again = 0; ok && mesh->neighbour != NULL && again < 2; again++) {
        match.cell_count = mesh->cell_count;
        ok = tetcasti_match(&match, (int)sorted);
        if (!ok || match.duplicates == 0 || again == 1) break;
        ok = tetcasti_drop_duplicates(m, &mesh->cell_count);
        sorted = 0;
        tetcasti_free(m->mem, match.own_list);
        match.own_list = NULL;
    }
    tetcasti_free(m->mem, match.own_list);
    tetcasti_free(m->mem, match.own_end);
    if (!ok || mesh->neighbour == NULL) return TETCAST_ERR_NO_MEMORY;
    m->report->nonmanifold_faces = match.nonmanifold;
    if (match.nonmanifold != 0) m->report->first_nonmanifold = mesh->source_cell[match.first_nonmanifold];
    if (match.conflicts != 0 && !tetcasti_orient(m)) return TETCAST_ERR_NO_MEMORY;
    m->report->cells = mesh->cell_count;
    return TETCAST_OK;
}

static tetcast_result tetcasti_import_run(tetcasti_import *m) {
    uint64_t tets = 0;
    tetcast_result r = tetcasti_import_scan(m, &tets);
    if (r != TETCAST_OK) return r;
    if (!tetcasti_progress(m, 1)) return TETCAST_ERR_CANCELLED;
    if (!tetcasti_import_vertices(m)) return TETCAST_ERR_NO_MEMORY;
    if (!tetcasti_progress(m, 2)) return TETCAST_ERR_CANCELLED;
    r = tetcasti_import_tets(m, tets);
    if (r != TETCAST_OK) return r;
    if (!tetcasti_progress(m, 3)) return TETCAST_ERR_CANCELLED;
    if (!tetcasti_import_hull(m)) return TETCAST_ERR_NO_MEMORY;
    r = tetcasti_import_values(m);
    if (r != TETCAST_OK) return r;
    if (!tetcasti_progress(m, 4)) return TETCAST_ERR_CANCELLED;
    r = tetcasti_cells_build(m->mem, &m->desc->env, m->desc->cells, m->mesh, &m->mesh->cells);
    if (r != TETCAST_OK) return r;
    if (!tetcasti_progress(m, 5)) return TETCAST_ERR_CANCELLED;
    m->mesh->source_vertex = m->vertex_source;
    m->vertex_source = NULL;
    return TETCAST_OK;
}

static int tetcasti_array_bad(const tetcast_array *a) { return a->data == NULL || tetcasti_type_size(a->type) == 0; }

/* Arguments that cannot be right. */
static tetcast_result tetcasti_import_check(tetcasti_import *m) {
    const tetcast_mesh_desc *d = m->desc;
    const tetcast_input *in = m->in;
    const tetcast_grid *g = m->grid;
    const tetcast_field *fields = g != NULL ? g->fields : in->fields;
    size_t count = g != NULL ? g->field_count : in->field_count, i;
    if ((uint32_t)d->cells >= TETCAST_CELLS_COUNT || (uint32_t)d->order > TETCAST_ORDER_INPUT)
        return TETCAST_ERR_INVALID_ARG;
    if (g != NULL) {
        uint64_t n = 1;
        uint32_t a;
        for (a = 0; a < 3; a++) {
            if (g->dims[a] < 2) return TETCAST_ERR_EMPTY;
            n *= g->dims[a];
            if (n > TETCAST_MAX_VERTICES) return TETCAST_ERR_RANGE;
            if (g->axes[a].data != NULL && tetcasti_array_bad(&g->axes[a])) return TETCAST_ERR_INVALID_ARG;
        }
        if (g->positions.data != NULL && tetcasti_array_bad(&g->positions)) return TETCAST_ERR_INVALID_ARG;
        m->position_stride = g->positions.data != NULL ? tetcasti_array_stride(&g->positions, 3) : 0;
        m->input_vertices = (uint32_t)n;
        m->source_count = (uint64_t)(g->dims[0] - 1) * (g->dims[1] - 1) * (g->dims[2] - 1);
    } else {
        if (in->cell_count == 0 || in->vertex_count == 0) return TETCAST_ERR_EMPTY;
        if (in->vertex_count > TETCAST_MAX_VERTICES || in->cell_count > TETCAST_MAX_CELLS) return TETCAST_ERR_RANGE;
        if (tetcasti_array_bad(&in->positions) || in->indices == NULL) return TETCAST_ERR_INVALID_ARG;
        m->position_stride = tetcasti_array_stride(&in->positions, 3);
        m->input_vertices = (uint32_t)in->vertex_count;
        m->source_count = in->cell_count;
    }
    if (count > 65536 || (count != 0 && fields == NULL)) return TETCAST_ERR_INVALID_ARG;
    for (i = 0; i < count; i++)
        if (tetcasti_array_bad(&fields[i].values)) return TETCAST_ERR_INVALID_ARG;
    return TETCAST_OK;
}

static void tetcasti_grid_axes(tetcasti_import *m) {
    const tetcast_grid *g = m->grid;
    double any_m = 0.0, any_s = 0.0;
    uint32_t a, c;
    for (a = 0; a < 9; a++) any_m += tetcasti_abs(g->matrix[a]);
    for (a = 0; a < 3; a++) any_s += tetcasti_abs(g->spacing[a]);
    for (a = 0; a < 3; a++)
        for (c = 0; c < 3; c++)
            m->grid_axis[a][c] = (any_m != 0.0 ? g->matrix[3 * c + a] : a == c ? 1.0 : 0.0) *
                                 (g->axes[a].data == NULL && any_s != 0.0 ? g->spacing[a] : 1.0);
}

static tetcast_result tetcasti_mesh_create(const tetcast_mesh_desc *desc, const tetcast_input *input,
                                           const tetcast_grid *grid, tetcast_report *report, tetcast_mesh **out_mesh) {
    tetcast_mesh_desc d;
    tetcast_report ignored;
    tetcasti_mem mem;
    tetcasti_import m;
    tetcast_result r;
    if (out_mesh == NULL) return TETCAST_ERR_INVALID_ARG;
    *out_mesh = NULL;
    if (report == NULL) report = &ignored;
    tetcasti_report_open(report);
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    if (input == NULL && grid == NULL) return TETCAST_ERR_INVALID_ARG;
    r = tetcasti_env_open(&d.env, &mem);
    if (r != TETCAST_OK) return r;
    memset(&m, 0, sizeof m);
    m.desc = &d;
    m.in = input;
    m.grid = grid;
    m.report = report;
    r = tetcasti_import_check(&m);
    if (r != TETCAST_OK)
        return tetcasti_fail(d.env.error, r, 0, r == TETCAST_ERR_EMPTY ? "mesh: no cells" : "mesh: bad argument");
    if (grid != NULL) tetcasti_grid_axes(&m);
    report->input_cells = m.source_count;
    report->input_vertices = m.input_vertices;
    m.mesh = (tetcast_mesh *)tetcasti_alloc_zero(&mem, 1, sizeof *m.mesh);
    if (m.mesh == NULL) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "mesh: out of memory");
    m.mesh->mem = mem;
    m.mem = &m.mesh->mem;
    r = tetcasti_import_run(&m);
    tetcasti_import_close(&m);
    if (r == TETCAST_OK) r = tetcasti_mesh_finish(m.mesh, &d);
    if (r != TETCAST_OK) {
        tetcast_mesh_destroy(m.mesh);
        if (r == TETCAST_ERR_NO_MEMORY || r == TETCAST_ERR_CANCELLED)
            (void)tetcasti_fail(d.env.error, r, 0,
                                r == TETCAST_ERR_CANCELLED ? "mesh: cancelled" : "mesh: out of memory");
        return r;
    }
    m.mesh->report = *report;
    *out_mesh = m.mesh;
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_mesh_create(const tetcast_mesh_desc *desc, const tetcast_input *input,
                                               tetcast_report *report, tetcast_mesh **out_mesh) {
    return tetcasti_mesh_create(desc, input, NULL, report, out_mesh);
}

TETCAST_DEF tetcast_result tetcast_mesh_create_grid(const tetcast_mesh_desc *desc, const tetcast_grid *grid,
                                                    tetcast_report *report, tetcast_mesh **out_mesh) {
    return tetcasti_mesh_create(desc, NULL, grid, report, out_mesh);
}
/* ---------------------------------------------------------------------------
   cells: compact forms for walking; the finished mesh and what it tells.        // >>cells
   --------------------------------------------------------------------------- */

typedef struct tetcasti_pack {
    const tetcast_mesh *mesh;
    tetcasti_cells *cells;
    uint64_t *escapes;          /* per chunk: how many, then where they go */
} tetcasti_pack;

/* The record of a cell: tet is v0 < v1 < min(v2, v3). */
TETCASTI_INLINE void tetcasti_pack16(const uint32_t *t, const uint32_t *n, tetcasti_tet16 *out) {
    uint32_t odd = t[2] > t[3], last = n[3 - odd];
    out->x = t[0] ^ t[1] ^ t[2] ^ t[3];
    out->n[0] = n[0] ^ last;
    out->n[1] = n[1] ^ last;
    out->n[2] = n[2 + odd] ^ last;
}

/* 0 when it does not fit. */
TETCASTI_INLINE int tetcasti_pack8(const uint32_t *t, const uint32_t *n, uint32_t cell, tetcasti_tet8 *out) {
    uint32_t odd = t[2] > t[3], x = t[0] ^ t[1] ^ t[2] ^ t[3], d[4], bad = x >> 16, i;
    for (i = 0; i < 4; i++) {
        uint32_t u = n[i < 2 ? i : i ^ odd], delta = u - cell;
        if (u == TETCASTI_NONE) {
            d[i] = 0x8000u;
        } else {
            bad |= delta + 0x7fffu > 0xfffeu; /* -32767..32767 */
            d[i] = delta & 0xffffu;
        }
    }
    bad |= d[0] == d[3];
    out->x = (uint16_t)x;
    for (i = 0; i < 3; i++) out->n[i] = (uint16_t)(d[i] ^ d[3]);
    return bad == 0;
}

static void tetcasti_task_pack16(void *ctx, uint32_t chunk) {
    tetcasti_pack *p = (tetcasti_pack *)ctx;
    tetcasti_tet16 *out = (tetcasti_tet16 *)p->cells->data;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, p->cells->count);
    for (; i < end; i++) tetcasti_pack16(p->mesh->tet[i], p->mesh->neighbour[i], &out[i]);
}

static void tetcasti_task_pack8_count(void *ctx, uint32_t chunk) {
    tetcasti_pack *p = (tetcasti_pack *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, p->cells->count);
    tetcasti_tet8 t;
    p->escapes[chunk] = 0;
    for (; i < end; i++) p->escapes[chunk] += !tetcasti_pack8(p->mesh->tet[i], p->mesh->neighbour[i], i, &t);
}

static void tetcasti_task_pack8(void *ctx, uint32_t chunk) {
    tetcasti_pack *p = (tetcasti_pack *)ctx;
    tetcasti_tet8 *out = (tetcasti_tet8 *)p->cells->data;
    tetcasti_tet16 *side = (tetcasti_tet16 *)p->cells->side;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, p->cells->count);
    uint32_t to = (uint32_t)p->escapes[chunk];
    for (; i < end; i++) {
        if (tetcasti_pack8(p->mesh->tet[i], p->mesh->neighbour[i], i, &out[i])) continue;
        tetcasti_pack16(p->mesh->tet[i], p->mesh->neighbour[i], &side[to]);
        out[i].x = out[i].n[0] = 0;
        out[i].n[1] = (uint16_t)to;
        out[i].n[2] = (uint16_t)(to >> 16);
        to++;
    }
}

static tetcast_result tetcasti_cells_build_more(tetcasti_mem *mem, const tetcast_env *env, tetcast_cells kind,
                                                const tetcast_mesh *mesh, tetcasti_cells *cells);

static void tetcasti_cells_field_changed(tetcast_mesh *mesh);

/* Make a compact form of a mesh that has its tets and neighbours. */
static tetcast_result tetcasti_cells_build(tetcasti_mem *mem, const tetcast_env *env, tetcast_cells kind,
                                           const tetcast_mesh *mesh, tetcasti_cells *cells) {
    tetcasti_pack p;
    uint32_t chunks = tetcasti_chunks(mesh->cell_count);
    uint64_t n;
    memset(cells, 0, sizeof *cells);
    cells->kind = (uint32_t)kind;
    cells->count = mesh->cell_count;
    p.mesh = mesh;
    p.cells = cells;
    p.escapes = NULL;
    if (kind == TETCAST_CELLS_TET8) {
        cells->data_bytes = (size_t)cells->count * sizeof(tetcasti_tet8);
        cells->data = tetcasti_alloc_array(mem, (size_t)cells->count + 1, sizeof(tetcasti_tet8));
        p.escapes = (uint64_t *)tetcasti_alloc_array(mem, chunks, sizeof *p.escapes);
        if (cells->data == NULL || p.escapes == NULL) {
            tetcasti_free(mem, p.escapes);
            return TETCAST_ERR_NO_MEMORY;
        }
        tetcasti_parallel_for(env, tetcasti_task_pack8_count, &p, chunks);
        n = tetcasti_prefix_sum(p.escapes, chunks);
        cells->side_bytes = (size_t)n * sizeof(tetcasti_tet16);
        cells->side = tetcasti_alloc_array(mem, (size_t)n + 1, sizeof(tetcasti_tet16));
        if (cells->side != NULL) tetcasti_parallel_for(env, tetcasti_task_pack8, &p, chunks);
        tetcasti_free(mem, p.escapes);
        return cells->side != NULL ? TETCAST_OK : TETCAST_ERR_NO_MEMORY;
    }
    if (kind != TETCAST_CELLS_TET16) return tetcasti_cells_build_more(mem, env, kind, mesh, cells);
    cells->data_bytes = (size_t)cells->count * sizeof(tetcasti_tet16);
    cells->data = tetcasti_alloc_array(mem, (size_t)cells->count + 1, sizeof(tetcasti_tet16));
    if (cells->data == NULL) return TETCAST_ERR_NO_MEMORY;
    tetcasti_parallel_for(env, tetcasti_task_pack16, &p, chunks);
    return TETCAST_OK;
}

static void tetcasti_cells_free(tetcasti_mem *mem, tetcasti_cells *cells) {
    tetcasti_free(mem, cells->data);
    tetcasti_free(mem, cells->side);
    tetcasti_free(mem, cells->first);
    memset(cells, 0, sizeof *cells);
}

/* ---- the finished mesh ---- */

static tetcast_result tetcasti_clusters_build(tetcast_mesh *mesh, const tetcast_env *env);
static void tetcasti_clusters_free(tetcasti_mem *mem, struct tetcasti_clusters *c);
static uint64_t tetcasti_clusters_bytes(const struct tetcasti_clusters *c);

static tetcast_result tetcasti_mesh_finish(tetcast_mesh *mesh, const tetcast_mesh_desc *desc) {
    uint32_t i, a;
    for (a = 0; a < 3; a++) {
        mesh->box.lo[a] = TETCASTI_INF;
        mesh->box.hi[a] = -TETCASTI_INF;
    }
    for (i = 0; i < mesh->vertex_count; i++) {
        const tetcasti_vertex *v = &mesh->vertex[i];
        float p[3];
        p[0] = v->x; p[1] = v->y; p[2] = v->z;
        for (a = 0; a < 3; a++) {
            mesh->box.lo[a] = p[a] < mesh->box.lo[a] ? p[a] : mesh->box.lo[a];
            mesh->box.hi[a] = p[a] > mesh->box.hi[a] ? p[a] : mesh->box.hi[a];
        }
    }
    if (!desc->disable_clusters) {
        tetcast_result r = tetcasti_clusters_build(mesh, &desc->env);
        if (r != TETCAST_OK) return r;
    }
    if (!desc->keep_neighbours) {
        tetcasti_free(&mesh->mem, mesh->neighbour);
        mesh->neighbour = NULL;
    }
    if (desc->drop_tets) {
        tetcasti_free(&mesh->mem, mesh->tet);
        mesh->tet = NULL;
    }
    if (desc->drop_source) {
        tetcasti_free(&mesh->mem, mesh->source_cell);
        tetcasti_free(&mesh->mem, mesh->source_vertex);
        mesh->source_cell = mesh->source_vertex = NULL;
    }
    mesh->hidden = mesh->mask;
    return mesh->field_count != 0 ? tetcast_mesh_set_field(mesh, 0) : TETCAST_OK;
}

TETCAST_DEF void tetcast_mesh_destroy(tetcast_mesh *mesh) {
    tetcasti_mem mem;
    uint32_t i;
    if (mesh == NULL) return;
    mem = mesh->mem;
    for (i = 0; i < mesh->field_count; i++) {
        tetcasti_free(&mem, mesh->field[i].value);
        tetcasti_free(&mem, mesh->field[i].hidden);
        tetcasti_free(&mem, mesh->field[i].range);
    }
    tetcasti_cells_free(&mem, &mesh->cells);
    tetcasti_clusters_free(&mem, mesh->clusters);
    tetcasti_free(&mem, mesh->field);
    tetcasti_free(&mem, mesh->vertex);
    tetcasti_free(&mem, mesh->tet);
    tetcasti_free(&mem, mesh->neighbour);
    tetcasti_free(&mem, mesh->face);
    tetcasti_free(&mem, mesh->hull.box);
    tetcasti_free(&mem, mesh->source_cell);
    tetcasti_free(&mem, mesh->source_vertex);
    tetcasti_free(&mem, mesh->mask);
    tetcasti_free(&mem, mesh->gradient);
    tetcasti_free(&mem, mesh);
}

TETCAST_DEF void tetcast_mesh_get_info(const tetcast_mesh *mesh, tetcast_mesh_info *info) {
    uint32_t i, a;
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (mesh == NULL) return;
    info->cell_count = mesh->cell_count;
    info->vertex_count = mesh->vertex_count;
    info->hull_face_count = mesh->face_count;
    info->field_count = mesh->field_count;
    info->active_field = mesh->active;
    info->cells = (tetcast_cells)mesh->cells.kind;
    for (a = 0; a < 3; a++) {
        info->box_min[a] = mesh->origin[a] + (double)mesh->box.lo[a] * mesh->unit;
        info->box_max[a] = mesh->origin[a] + (double)mesh->box.hi[a] * mesh->unit;
    }
    if (mesh->cells.kind == TETCAST_CELLS_TET8) info->escapes = mesh->cells.side_bytes / sizeof(tetcasti_tet16);
    info->connectivity_bytes = mesh->cells.data_bytes + mesh->cells.side_bytes + mesh->cells.first_bytes;
    info->vertex_bytes = (uint64_t)mesh->vertex_count * sizeof *mesh->vertex;
    info->hull_bytes = (uint64_t)mesh->face_count * sizeof *mesh->face + mesh->hull.bytes;
    for (i = 0; i < mesh->field_count; i++) {
        const tetcasti_field *f = &mesh->field[i];
        if (f->value != NULL)
            info->field_bytes += (uint64_t)(f->per_cell ? mesh->cell_count : mesh->vertex_count) * sizeof *f->value;
        if (f->hidden != NULL) info->field_bytes += ((uint64_t)mesh->cell_count / 32 + 1) * 4;
    }
    if (mesh->mask != NULL) info->field_bytes += ((uint64_t)mesh->cell_count / 32 + 1) * 4;
    info->cluster_bytes = tetcasti_clusters_bytes(mesh->clusters);
    if (mesh->tet != NULL) info->optional_bytes += (uint64_t)mesh->cell_count * sizeof *mesh->tet;
    if (mesh->neighbour != NULL) info->optional_bytes += (uint64_t)mesh->cell_count * sizeof *mesh->neighbour;
    if (mesh->gradient != NULL) info->optional_bytes += (uint64_t)mesh->vertex_count * sizeof *mesh->gradient;
    if (mesh->source_cell != NULL)
        info->optional_bytes += ((uint64_t)mesh->cell_count + mesh->vertex_count) * sizeof *mesh->source_cell;
    info->total_bytes = sizeof *mesh + info->connectivity_bytes + info->vertex_bytes + info->hull_bytes +
                        info->field_bytes + info->cluster_bytes + info->optional_bytes;
}

TETCAST_DEF void tetcast_mesh_get_report(const tetcast_mesh *mesh, tetcast_report *report) {
    if (report == NULL) return;
    if (mesh != NULL) *report = mesh->report;
    else tetcasti_report_open(report);
}

TETCAST_DEF const char *tetcast_mesh_field(const tetcast_mesh *mesh, uint32_t field, float *lo, float *hi) {
    if (mesh == NULL || field >= mesh->field_count) return NULL;
    if (lo != NULL) *lo = mesh->field[field].value_min;
    if (hi != NULL) *hi = mesh->field[field].value_max;
    return mesh->field[field].name;
}

TETCAST_DEF uint32_t tetcast_mesh_find_field(const tetcast_mesh *mesh, const char *name) {
    uint32_t i;
    for (i = 0; mesh != NULL && name != NULL && i < mesh->field_count; i++)
        if (strcmp(mesh->field[i].name, name) == 0) return i;
    return TETCAST_NONE;
}

TETCAST_DEF tetcast_result tetcast_mesh_set_field(tetcast_mesh *mesh, uint32_t field) {
    tetcasti_field *f;
    uint32_t i;
    if (mesh == NULL) return TETCAST_ERR_INVALID_ARG;
    if (field >= mesh->field_count) return TETCAST_ERR_RANGE;
    f = &mesh->field[field];
    if (field != mesh->active) {
        tetcasti_free(&mesh->mem, mesh->gradient);
        mesh->gradient = NULL;
    }
    mesh->active = field;
    mesh->cell_value = f->per_cell ? f->value : NULL;
    mesh->hidden = f->hidden != NULL ? f->hidden : mesh->mask;
    for (i = 0; i < mesh->vertex_count && (f->per_cell || f->value != NULL); i++)
        mesh->vertex[i].s = f->per_cell ? 0.0f : f->value[i];
    if (mesh->field_count == 1 && !f->per_cell) { /* now it is in the vertices, and no other will take its place */
        tetcasti_free(&mesh->mem, f->value);
        f->value = NULL;
    }
    tetcasti_cells_field_changed(mesh);
    return TETCAST_OK;
}

TETCAST_DEF void tetcast_mesh_vertex(const tetcast_mesh *mesh, uint32_t vertex, double position[3], float *value,
                                     uint32_t *source_vertex) {
    const tetcasti_vertex *v;
    if (position != NULL) position[0] = position[1] = position[2] = 0.0;
    if (value != NULL) *value = 0.0f;
    if (source_vertex != NULL) *source_vertex = TETCAST_NONE;
    if (mesh == NULL || vertex >= mesh->vertex_count) return;
    v = &mesh->vertex[vertex];
    if (position != NULL) {
        position[0] = mesh->origin[0] + (double)v->x * mesh->unit;
        position[1] = mesh->origin[1] + (double)v->y * mesh->unit;
        position[2] = mesh->origin[2] + (double)v->z * mesh->unit;
    }
    if (value != NULL) *value = v->s;
    if (source_vertex != NULL && mesh->source_vertex != NULL) *source_vertex = mesh->source_vertex[vertex];
}

TETCAST_DEF tetcast_result tetcast_mesh_cell(const tetcast_mesh *mesh, uint32_t cell, uint32_t vertices[4],
                                             uint32_t *source_cell) {
    uint32_t i;
    if (mesh == NULL) return TETCAST_ERR_INVALID_ARG;
    if (cell >= mesh->cell_count || mesh->tet == NULL) return TETCAST_ERR_RANGE;
    for (i = 0; vertices != NULL && i < 4; i++) vertices[i] = mesh->tet[cell][i];
    if (source_cell != NULL) *source_cell = mesh->source_cell != NULL ? mesh->source_cell[cell] : TETCAST_NONE;
    return TETCAST_OK;
}

/* Neighbours of a mesh that has its tets, made again: cell_count entries into `out`. */
static TETCASTI_UNUSED tetcast_result tetcasti_mesh_neighbours(const tetcast_mesh *mesh, tetcasti_mem *mem,
                                                               const tetcast_env *env,
                                                               uint32_t (*out)[4]) {
    tetcasti_matcher m;
    int ok;
    if (mesh->tet == NULL) return TETCAST_ERR_INVALID_ARG;
    if (mesh->neighbour != NULL) {
        memcpy(out, mesh->neighbour, (size_t)mesh->cell_count * sizeof *out);
        return TETCAST_OK;
    }
    memset(&m, 0, sizeof m);
    m.mem = mem;
    m.env = env;
    m.tet = mesh->tet;
    m.neighbour = out;
    m.cell_count = mesh->cell_count;
    m.vertex_count = mesh->vertex_count;
    ok = tetcasti_match(&m, 0);
    tetcasti_free(mem, m.own_list);
    tetcasti_free(mem, m.own_end);
    return ok ? TETCAST_OK : TETCAST_ERR_NO_MEMORY;
}

/* ---- a closer look ---- */

static uint32_t tetcasti_find_root(uint32_t *parent, uint32_t i) {
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

static double tetcasti_distance2(const double *p, const double *q) {
    return (p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) + (p[2] - q[2]) * (p[2] - q[2]);
}

static void tetcasti_vertex_place(const tetcasti_vertex *v, double p[3]) {
    p[0] = (double)v->x;
    p[1] = (double)v->y;
    p[2] = (double)v->z;
}

/* Does vertex v lie on an edge of a face of the hull without being one of its ends, or at the place of one? */
static int tetcasti_hangs(const tetcast_mesh *mesh, const uint32_t *face, uint32_t v) {
    double p[3], q[3][3];
    uint32_t i, a;
    tetcasti_vertex_place(&mesh->vertex[v], p);
    for (i = 0; i < 3; i++) {
        if (face[i] == v) return 0;
        tetcasti_vertex_place(&mesh->vertex[face[i]], q[i]);
        if (tetcasti_distance2(p, q[i]) == 0.0) return 0;
    }
    for (i = 0; i < 3; i++) {
        const double *b = q[i], *e = q[i == 2 ? 0 : i + 1];
        double l2 = tetcasti_distance2(b, e), t = 0.0, x[3];
        for (a = 0; a < 3; a++) t += (p[a] - b[a]) * (e[a] - b[a]);
        if (!(t > 0.0 && t < l2)) continue;
        for (a = 0; a < 3; a++) x[a] = b[a] + (e[a] - b[a]) * (t / l2);
        if (tetcasti_distance2(p, x) <= 1e-12 * l2 + 64.0 * 64.0) return 1; /* 64 local units: 2^-23 of the mesh */
    }
    return 0;
}

static void tetcasti_check_hanging(const tetcast_mesh *mesh, const uint8_t *on_hull, tetcast_check *check) {
    const tetcasti_hull *h = &mesh->hull;
    uint32_t v, source;
    for (v = 0; v < mesh->vertex_count; v++) {
        const tetcasti_vertex *p = &mesh->vertex[v];
        uint64_t todo[96];
        uint32_t top = 0, hangs = 0;
        if (!on_hull[v] || h->level_count == 0) continue;
        todo[top++] = (uint64_t)(h->level_count - 1) << 32;
        while (top != 0 && !hangs) {
            uint32_t level = (uint32_t)(todo[--top] >> 32), k = (uint32_t)todo[top], from = 8 * k, to, j;
            const tetcasti_box *box = &h->box[h->level_start[level] + k];
            if (p->x < box->lo[0] - 64.0f || p->x > box->hi[0] + 64.0f || p->y < box->lo[1] - 64.0f ||
                p->y > box->hi[1] + 64.0f || p->z < box->lo[2] - 64.0f || p->z > box->hi[2] + 64.0f) continue;
            to = level != 0 ? h->level_size[level - 1] : h->face_count;
            if (to - from > 8) to = from + 8;
            for (j = from; j < to; j++) {
                if (level != 0) todo[top++] = (uint64_t)(level - 1) << 32 | j;
                else hangs |= (uint32_t)tetcasti_hangs(mesh, h->face[j].v, v);
            }
        }
        if (!hangs) continue;
        source = mesh->source_vertex != NULL ? mesh->source_vertex[v] : v;
        if (check->hanging_nodes++ == 0 || source < check->first_hanging) check->first_hanging = source;
    }
}

static void tetcasti_check_coincident(const tetcast_mesh *mesh, uint32_t *table, uint32_t bits, tetcast_check *check) {
    uint32_t v, source;
    memset(table, 0xff, sizeof *table << bits);
    for (v = 0; v < mesh->vertex_count; v++) {
        const tetcasti_vertex *p = &mesh->vertex[v];
        float f[3];
        uint32_t key[3], h;
        f[0] = p->x + 0.0f;
        f[1] = p->y + 0.0f;
        f[2] = p->z + 0.0f;
        memcpy(key, f, sizeof key);
        h = (uint32_t)(tetcasti_hash_mix(tetcasti_hash_mix(key[0], key[1]), key[2]) *
                       0x9e3779b97f4a7c15u >> (64 - bits));
        for (; table[h] != TETCASTI_NONE; h = (h + 1) & (((uint32_t)1 << bits) - 1u)) {
            const tetcasti_vertex *q = &mesh->vertex[table[h]];
            if (q->x != p->x || q->y != p->y || q->z != p->z) continue;
            source = mesh->source_vertex != NULL ? mesh->source_vertex[v] : v;
            if (check->coincident_vertices++ == 0 || source < check->first_coincident) check->first_coincident = source;
            break;
        }
        if (table[h] == TETCASTI_NONE) table[h] = v;
    }
}

static void tetcasti_check_shapes(const tetcast_mesh *mesh, tetcast_check *check) {
    double unit = mesh->unit, smallest = (double)INFINITY, largest = -(double)INFINITY, sum = 0.0, aspect = 0.0,
        longest2 = 0.0;
    uint32_t i, j, k;
    for (i = 0; i < mesh->cell_count; i++) {
        const uint32_t *t = mesh->tet[i];
        double p[4][3], edge2 = 0.0, area2 = 0.0, v;
        for (j = 0; j < 4; j++) tetcasti_vertex_place(&mesh->vertex[t[j]], p[j]);
        v = tetcasti_volume6(&mesh->vertex[t[0]], &mesh->vertex[t[1]], &mesh->vertex[t[2]], &mesh->vertex[t[3]]);
        for (j = 0; j < 4; j++) {
            const double *a = p[(j + 1) & 3], *b = p[(j + 2) & 3], *c = p[(j + 3) & 3];
            double e[3], f[3], n[3];
            for (k = 0; k < 3; k++) {
                e[k] = b[k] - a[k];
                f[k] = c[k] - a[k];
            }
            n[0] = e[1] * f[2] - e[2] * f[1];
            n[1] = e[2] * f[0] - e[0] * f[2];
            n[2] = e[0] * f[1] - e[1] * f[0];
            area2 = tetcasti_max(area2, n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            edge2 = tetcasti_max(edge2, tetcasti_max(tetcasti_distance2(a, b), tetcasti_distance2(a, c)));
        }
        longest2 = tetcasti_max(longest2, edge2);
        sum += v;
        smallest = tetcasti_min(smallest, v);
        largest = tetcasti_max(largest, v);
        v = tetcasti_abs(v); /* height over a face: 6 volumes / twice its area */
        aspect = tetcasti_max(aspect, v > 0.0 ? sqrt(edge2) * sqrt(area2) / v : (double)INFINITY);
    }
    check->volume = sum / 6.0 * unit * unit * unit;
    check->smallest = smallest / 6.0 * unit * unit * unit;
    check->largest = largest / 6.0 * unit * unit * unit;
    check->aspect = aspect;
    check->longest_edge = sqrt(longest2) * unit;
}

TETCAST_DEF tetcast_result tetcast_mesh_check(const tetcast_mesh *mesh, const tetcast_env *env, tetcast_check *check) {
    tetcast_env none;
    tetcasti_mem mem;
    tetcast_result r;
    uint32_t (*neighbour)[4], *parent, *table, bits = 4, i, j;
    uint8_t *on_hull;
    if (check == NULL) return TETCAST_ERR_INVALID_ARG;
    memset(check, 0, sizeof *check);
    check->first_hanging = check->first_coincident = TETCAST_NONE;
    if (mesh == NULL || mesh->tet == NULL) return TETCAST_ERR_INVALID_ARG;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    r = tetcasti_env_open(env, &mem);
    if (r != TETCAST_OK) return r;
    while (bits < 31 && ((uint32_t)1 << bits) < 2 * (uint64_t)mesh->vertex_count) bits++;
    neighbour = (uint32_t (*)[4])tetcasti_alloc_array(&mem, mesh->cell_count, sizeof *neighbour);
    parent = (uint32_t *)tetcasti_alloc_array(&mem, mesh->cell_count, sizeof *parent);
    table = (uint32_t *)tetcasti_alloc_array(&mem, (size_t)1 << bits, sizeof *table);
    on_hull = (uint8_t *)tetcasti_alloc_zero(&mem, mesh->vertex_count, 1);
    r = neighbour != NULL && parent != NULL && table != NULL && on_hull != NULL ? TETCAST_OK : TETCAST_ERR_NO_MEMORY;
    if (r == TETCAST_OK) r = tetcasti_mesh_neighbours(mesh, &mem, env, neighbour);
    if (r == TETCAST_OK) {
        for (i = 0; i < mesh->cell_count; i++) parent[i] = i;
        for (i = 0; i < mesh->cell_count; i++)
            for (j = 0; j < 4; j++)
                if (neighbour[i][j] < i) {
                    uint32_t a = tetcasti_find_root(parent, i), b = tetcasti_find_root(parent, neighbour[i][j]);
                    if (a < b) parent[b] = a;
                    else parent[a] = b;
                }
        for (i = 0; i < mesh->cell_count; i++) check->components += parent[i] == i;
        for (i = 0; i < mesh->face_count; i++)
            for (j = 0; j < 3; j++) on_hull[mesh->face[i].v[j]] = 1;
        tetcasti_check_hanging(mesh, on_hull, check);
        tetcasti_check_coincident(mesh, table, bits, check);
        tetcasti_check_shapes(mesh, check);
    }
    tetcasti_free(&mem, neighbour);
    tetcasti_free(&mem, parent);
    tetcasti_free(&mem, table);
    tetcasti_free(&mem, on_hull);
    return r == TETCAST_ERR_NO_MEMORY ? tetcasti_fail(env->error, r, 0, "check: out of memory") : r;
}

/* Gradient of the value in a tetrahedron, times six times its volume (which may be 0); local units. */
static void tetcasti_cell_gradient(const tetcasti_vertex *a, const tetcasti_vertex *b, const tetcasti_vertex *c,
                                   const tetcasti_vertex *d, double g[3], double *volume6) {
    double u[3], v[3], w[3], su = (double)b->s - (double)a->s, sv = (double)c->s - (double)a->s,
        sw = (double)d->s - (double)a->s, det;
    uint32_t i;
    u[0] = (double)b->x - (double)a->x; u[1] = (double)b->y - (double)a->y; u[2] = (double)b->z - (double)a->z;
    v[0] = (double)c->x - (double)a->x; v[1] = (double)c->y - (double)a->y; v[2] = (double)c->z - (double)a->z;
    w[0] = (double)d->x - (double)a->x; w[1] = (double)d->y - (double)a->y; w[2] = (double)d->z - (double)a->z;
    for (i = 0; i < 3; i++) {
        uint32_t j = i == 2 ? 0 : i + 1, k = i == 0 ? 2 : i - 1;
        g[i] = su * (v[j] * w[k] - v[k] * w[j]) + sv * (w[j] * u[k] - w[k] * u[j]) + sw * (u[j] * v[k] - u[k] * v[j]);
    }
    det = u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0]);
    *volume6 = tetcasti_abs(det);
    if (det < 0.0)
        for (i = 0; i < 3; i++) g[i] = -g[i];
}

TETCAST_DEF tetcast_result tetcast_mesh_make_gradients(tetcast_mesh *mesh, const tetcast_env *env) {
    double (*sum)[4], g[3], volume;
    uint32_t i, j, a;
    if (mesh == NULL || mesh->tet == NULL || mesh->cell_value != NULL) return TETCAST_ERR_INVALID_ARG;
    if (mesh->gradient != NULL) return TETCAST_OK;
    sum = (double (*)[4])tetcasti_alloc_zero(&mesh->mem, mesh->vertex_count, sizeof *sum);
    mesh->gradient = (float (*)[3])tetcasti_alloc_array(&mesh->mem, mesh->vertex_count, sizeof *mesh->gradient);
    if (sum == NULL || mesh->gradient == NULL) {
        tetcasti_free(&mesh->mem, sum);
        tetcasti_free(&mesh->mem, mesh->gradient);
        mesh->gradient = NULL;
        return tetcasti_fail(env != NULL ? env->error : NULL, TETCAST_ERR_NO_MEMORY, 0, "gradients: out of memory");
    }
    for (i = 0; i < mesh->cell_count; i++) {
        const uint32_t *t = mesh->tet[i];
        tetcasti_cell_gradient(&mesh->vertex[t[0]], &mesh->vertex[t[1]], &mesh->vertex[t[2]], &mesh->vertex[t[3]], g,
                               &volume);
        for (j = 0; j < 4; j++) {
            for (a = 0; a < 3; a++) sum[t[j]][a] += g[a];
            sum[t[j]][3] += volume;
        }
    }
    for (i = 0; i < mesh->vertex_count; i++)
        for (a = 0; a < 3; a++) {
            double v = sum[i][3] > 0.0 ? sum[i][a] / sum[i][3] / mesh->unit : 0.0; /* per world unit */
            mesh->gradient[i][a] = v > -1e38 && v < 1e38 ? (float)v : 0.0f;
        }
    tetcasti_free(&mesh->mem, sum);
    return TETCAST_OK;
}
/* ---------------------------------------------------------------------------
   strips: larger and older forms of cells: Tet20, Tet32, the list of 160        // >>strips
   bytes, tetrahedral strips.

   Tet20   {a^b^c^d, neighbours in the order of the vertices opposite to them}; 20 bytes.
   Tet32   {three vertices, a^b^c^d, neighbours: [i] opposite vertex i, the fourth opposite the last one}; 32 bytes.
   List160 positions of the four vertices and in w the bits of their numbers; outward normals of the four faces (unit
           length) and in w the number that this face has in the neighbour; neighbours; gradient and offset of the
           scalar. What the thesis keeps, so that a cell needs nothing else. 160 bytes.
   Strip   a string of vertices: each window of 4 that follow each other is a cell. Of each place of the string
           (column) there is {vertex, n1, n2}; a cell is called by the column p of its first vertex.
           window p + 1, when it is a cell and lies behind face 0 of window p   -> bit 31 of n1[p + 1]
           window p - 1, when it is a cell and lies behind face 3 of window p   -> bit 31 of n2[p + 1]
           neighbours behind faces 1 and 2 (opposite the second and third vertex)  n1[p + 1], n2[p + 1]
           the one behind face 0, when bit 31 is not set                          n1[p + 2]
           the one behind face 3, when bit 31 is not set                          n2[p]
           A vertex may be there twice within 4 places: the window has the vertices of the one beside it then and is no
           cell; strips can turn like this, and what the cells beside it say in its columns is no conflict because it
           has nothing to say. 12 bytes a column; n cells in a strip have n + 3 columns and one more for each
           repetition.
   Strips are made greedily: they begin with cells that have few free neighbours, beside strips that are there already,
   try the 24 orders of the first four vertices, grow at both ends, and the longest (of those, the one with the fewest
   columns) is kept.
   --------------------------------------------------------------------------- */

#define TETCASTI_STRIP_CHUNK 65536u /* cells; strips do not cross their borders */
#define TETCASTI_STRIP_FLAG 0x80000000u
#define TETCASTI_STRIP_NONE 0x7fffffffu
#define TETCASTI_STRIP_CANDIDATE 4096u /* cells of a strip: keeps trying 24 orders from taking for ever */

typedef struct tetcasti_tet20 { uint32_t x, n[4]; } tetcasti_tet20;
typedef struct tetcasti_tet32 { uint32_t v[3], x, n[4]; } tetcasti_tet32;
typedef struct tetcasti_tet160 { float v[4][4], normal[4][4]; uint32_t n[4]; float gradient[4]; } tetcasti_tet160;
typedef struct tetcasti_column { uint32_t v, n1, n2; } tetcasti_column;

/* ---- walking ---- */

TETCASTI_INLINE uint32_t tetcasti_enter_more(const tetcasti_cells *cells, uint32_t kind, uint32_t cell, uint32_t abc,
                                             tetcasti_node *node) {
    node->flag = 0;
    switch (kind) {
    case TETCAST_CELLS_TET20: {
        const tetcasti_tet20 *t = (const tetcasti_tet20 *)cells->data + cell;
        memcpy(node->n, t->n, sizeof t->n);
        return t->x ^ abc;
    }
    case TETCAST_CELLS_TET32: return ((const tetcasti_tet32 *)cells->data)[cell].x ^ abc;
    case TETCAST_CELLS_LIST160: {
        const tetcasti_tet160 *t = (const tetcasti_tet160 *)cells->data + cell;
        uint32_t k;
        for (k = 0; k < 4; k++) memcpy(&node->n[k], &t->v[k][3], 4);
        return node->n[0] ^ node->n[1] ^ node->n[2] ^ node->n[3] ^ abc;
    }
    default: {
        const tetcasti_column *c = (const tetcasti_column *)cells->data + cell;
        uint32_t k;
        for (k = 0; k < 4; k++) node->n[k] = c[k].v;
        return c[0].v ^ c[1].v ^ c[2].v ^ c[3].v ^ abc;
    }
    }
}

TETCASTI_INLINE uint32_t tetcasti_strip_neighbour(const tetcasti_column *c, uint32_t cell, uint32_t face) {
    uint32_t n;
    switch (face) {
    case 0:
        if (c[1].n1 & TETCASTI_STRIP_FLAG) return cell + 1;
        n = c[2].n1;
        break;
    case 1: n = c[1].n1; break;
    case 2: n = c[1].n2; break;
    default:
        if (c[1].n2 & TETCASTI_STRIP_FLAG) return cell - 1;
        n = c[0].n2;
        break;
    }
    n &= ~TETCASTI_STRIP_FLAG;
    return n == TETCASTI_STRIP_NONE ? TETCASTI_NONE : n;
}

TETCASTI_INLINE uint32_t tetcasti_leave_more(const tetcasti_cells *cells, uint32_t kind, const tetcasti_node *node,
                                             uint32_t cell, uint32_t a, uint32_t b, uint32_t c, uint32_t d,
                                                 uint32_t x) {
    uint32_t face;
    switch (kind) {
    case TETCAST_CELLS_TET20: return node->n[tetcasti_rank(x, a, b, c, d)];
    case TETCAST_CELLS_TET32: {
        const tetcasti_tet32 *t = (const tetcasti_tet32 *)cells->data + cell;
        return t->n[t->v[0] == x ? 0 : t->v[1] == x ? 1 : t->v[2] == x ? 2 : 3];
    }
    default:
        face = node->n[0] == x ? 0 : node->n[1] == x ? 1 : node->n[2] == x ? 2 : 3;
        if (kind == TETCAST_CELLS_LIST160) return ((const tetcasti_tet160 *)cells->data)[cell].n[face];
        return tetcasti_strip_neighbour((const tetcasti_column *)cells->data + cell, cell, face);
    }
}

/* ---- Tet20, Tet32, List160 ---- */

typedef struct tetcasti_pack_more {
    const tetcast_mesh *mesh;
    tetcasti_cells *cells;
} tetcasti_pack_more;

/* v0 < v1 < min(v2, v3) in a mesh. */
static void tetcasti_task_pack_more(void *ctx, uint32_t chunk) {
    tetcasti_pack_more *p = (tetcasti_pack_more *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, p->mesh->cell_count), k;
    for (; i < end; i++) {
        const uint32_t *t = p->mesh->tet[i], *n = p->mesh->neighbour[i];
        uint32_t x = t[0] ^ t[1] ^ t[2] ^ t[3], odd = t[2] > t[3];
        if (p->cells->kind == TETCAST_CELLS_TET20) {
            tetcasti_tet20 *out = (tetcasti_tet20 *)p->cells->data + i;
            out->x = x;
            out->n[0] = n[0];
            out->n[1] = n[1];
            out->n[2] = n[2 + odd];
            out->n[3] = n[3 - odd];
        } else {
            tetcasti_tet32 *out = (tetcasti_tet32 *)p->cells->data + i;
            for (k = 0; k < 4; k++) {
                if (k < 3) out->v[k] = t[k];
                out->n[k] = n[k];
            }
            out->x = x;
        }
    }
}

static void tetcasti_task_pack_list(void *ctx, uint32_t chunk) {
    tetcasti_pack_more *p = (tetcasti_pack_more *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, p->mesh->cell_count), k, f, a;
    for (; i < end; i++) {
        const uint32_t *t = p->mesh->tet[i], *n = p->mesh->neighbour[i];
        tetcasti_tet160 *out = (tetcasti_tet160 *)p->cells->data + i;
        for (k = 0; k < 4; k++) {
            const tetcasti_vertex *v = &p->mesh->vertex[t[k]];
            uint32_t back = 4;
            out->v[k][0] = v->x;
            out->v[k][1] = v->y;
            out->v[k][2] = v->z;
            memcpy(&out->v[k][3], &t[k], 4);
            out->n[k] = n[k];
            for (f = 0; f < 4 && n[k] != TETCASTI_NONE; f++)
                if (p->mesh->neighbour[n[k]][f] == i) back = f;
            out->normal[k][3] = (float)back;
        }
        for (k = 0; k < 4; k++) { /* (v1 - v0) x (v2 - v0) of the face, seen from outside */
            const uint8_t *w = tetcasti_face_of[k];
            double u[3], v[3], m[3], l;
            for (a = 0; a < 3; a++) {
                u[a] = (double)out->v[w[1]][a] - (double)out->v[w[0]][a];
                v[a] = (double)out->v[w[2]][a] - (double)out->v[w[0]][a];
            }
            m[0] = u[1] * v[2] - u[2] * v[1];
            m[1] = u[2] * v[0] - u[0] * v[2];
            m[2] = u[0] * v[1] - u[1] * v[0];
            l = sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]);
            for (a = 0; a < 3; a++) out->normal[k][a] = l > 0.0 ? (float)(m[a] / l) : 0.0f;
        }
    }
}

/* Gradient and offset of the active scalar, by Cramer's rule. */
static void tetcasti_list_gradients(tetcast_mesh *mesh) {
    tetcasti_tet160 *t = (tetcasti_tet160 *)mesh->cells.data;
    uint32_t i, k, a;
    for (i = 0; i < mesh->cell_count; i++, t++) {
        double e[3][3], det, g[3] = {0.0, 0.0, 0.0}, s[4];
        for (k = 0; k < 4; k++) {
            uint32_t v;
            memcpy(&v, &t->v[k][3], 4);
            s[k] = (double)mesh->vertex[v].s;
            for (a = 0; a < 3 && k > 0; a++) e[k - 1][a] = (double)t->v[k][a] - (double)t->v[0][a];
        }
        det = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
              e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
        for (k = 0; k < 3 && det != 0.0; k++) {
            const double *u = e[(k + 1) % 3], *v = e[(k + 2) % 3], d = s[k + 1] - s[0];
            g[0] += d * (u[1] * v[2] - u[2] * v[1]) / det;
            g[1] += d * (u[2] * v[0] - u[0] * v[2]) / det;
            g[2] += d * (u[0] * v[1] - u[1] * v[0]) / det;
        }
        for (a = 0; a < 3; a++) {
            t->gradient[a] = (float)g[a];
            s[0] -= g[a] * (double)t->v[0][a];
        }
        t->gradient[3] = (float)s[0];
    }
}

/* After another field was chosen. */
static void tetcasti_cells_field_changed(tetcast_mesh *mesh) {
    if (mesh->cells.kind == TETCAST_CELLS_LIST160 && mesh->cells.data != NULL) tetcasti_list_gradients(mesh);
}

/* ---- making strips ---- */

typedef struct tetcasti_strip_maker { /* of one chunk of cells: numbers are relative to `begin` */
    const tetcast_mesh *mesh;
    uint32_t begin, count;
    int general;
    uint8_t *used;       /* per cell: in a strip */
    uint32_t *mark;      /* per cell: number of the try that has it */
    uint32_t try_number;
    uint32_t *queue[5];  /* cells by their free neighbours; rings of `count` */
    uint32_t head[5], tail[5];
    uint32_t next;       /* no cell below it is free */
    uint32_t *string[2]; /* what a try appends at each end */
    uint32_t *window[2]; /* of which cell the window is that ends with it; NONE: of none */
    uint32_t length[2];
    /* of the whole chunk: vertex of each column, cell of the window that begins there */
    uint32_t *out_vertex, *out_cell;
    size_t out_count, out_room;
    tetcasti_mem *mem;
    int failed;
} tetcasti_strip_maker;

TETCASTI_INLINE uint32_t tetcasti_opposite(const tetcast_mesh *mesh, uint32_t cell, uint32_t vertex) {
    const uint32_t *t = mesh->tet[cell];
    return mesh->neighbour[cell][t[0] == vertex ? 0 : t[1] == vertex ? 1 : t[2] == vertex ? 2 : 3];
}
TETCASTI_INLINE int tetcasti_strip_free(const tetcasti_strip_maker *m, uint32_t cell) { /* NONE is far outside */
    uint32_t at = cell - m->begin;
    return at < m->count && !m->used[at] && m->mark[at] != m->try_number;
}
static uint32_t tetcasti_strip_free_count(const tetcasti_strip_maker *m, uint32_t cell) {
    uint32_t k, n = 0;
    for (k = 0; k < 4; k++) n += (uint32_t)tetcasti_strip_free(m, m->mesh->neighbour[cell][k]);
    return n;
}

/* The window of a string moves on by one vertex. */
TETCASTI_INLINE void tetcasti_strip_shift(uint32_t w[4], uint32_t vertex) {
    w[0] = w[1];
    w[1] = w[2];
    w[2] = w[3];
    w[3] = vertex;
}

/* Append cells behind the window of `cell` until none is free. side 1 does it with the window turned round: what it
   appends stands before the strip in the end. Returns how many cells. */
static uint32_t tetcasti_strip_grow(tetcasti_strip_maker *m, uint32_t cell, const uint32_t first[4], uint32_t side) {
    uint32_t w[4], cells = 0, n = 0;
    uint32_t *string = m->string[side], *window = m->window[side];
    memcpy(w, first, sizeof w);
    while (cells < TETCASTI_STRIP_CANDIDATE) {
        uint32_t next = tetcasti_opposite(m->mesh, cell, w[0]), drop = 0;
        const uint32_t *t;
        while (!tetcasti_strip_free(m, next) && m->general && drop < 2) { /* fewer repetitions first */
            drop++;
            next = tetcasti_opposite(m->mesh, cell, w[drop]);
        }
        if (!tetcasti_strip_free(m, next)) break;
        for (; drop > 0; drop--) { /* b c d a */
            window[n] = TETCASTI_NONE;
            string[n++] = w[0];
            tetcasti_strip_shift(w, w[0]);
        }
        t = m->mesh->tet[next];
        window[n] = next;
        string[n] = t[0] ^ t[1] ^ t[2] ^ t[3] ^ w[1] ^ w[2] ^ w[3];
        tetcasti_strip_shift(w, string[n++]);
        m->mark[next - m->begin] = m->try_number;
        cell = next;
        cells++;
    }
    m->length[side] = n;
    return cells;
}

/* The strip that begins with `cell` in that order. Returns how many cells it has. */
static uint32_t tetcasti_strip_try(tetcasti_strip_maker *m, uint32_t cell, uint32_t order, uint32_t w[4]) {
    const uint32_t *t = m->mesh->tet[cell];
    uint32_t turned[4], left = 0xf, k, i, cells;
    for (k = 0; k < 4; k++) { /* order is a number in the factorial system */
        uint32_t skip = order % (4 - k);
        order /= 4 - k;
        for (i = 0; ; i++)
            if (left >> i & 1u && skip-- == 0) break;
        left &= ~(1u << i);
        w[k] = t[i];
    }
    m->try_number++;
    m->mark[cell - m->begin] = m->try_number;
    cells = 1 + tetcasti_strip_grow(m, cell, w, 0);
    for (k = 0; k < 4; k++) turned[k] = w[3 - k];
    return cells + tetcasti_strip_grow(m, cell, turned, 1);
}

static void tetcasti_strip_push(tetcasti_strip_maker *m, uint32_t cell) {
    uint32_t n = tetcasti_strip_free_count(m, cell);
    if (m->tail[n] - m->head[n] == m->count) return; /* full: the scan will find it */
    m->queue[n][m->tail[n]++ % m->count] = cell;
}

/* The free cell with the fewest free neighbours beside a strip, else the first one. NONE: there is none. */
static uint32_t tetcasti_strip_start(tetcasti_strip_maker *m) {
    uint32_t k;
    m->try_number++;
    for (k = 0; k < 5; k++)
        while (m->head[k] != m->tail[k]) {
            uint32_t cell = m->queue[k][m->head[k]++ % m->count];
            if (!m->used[cell - m->begin] && tetcasti_strip_free_count(m, cell) == k) return cell;
        }
    while (m->next < m->count && m->used[m->next]) m->next++;
    return m->next < m->count ? m->begin + m->next : TETCASTI_NONE;
}

static int tetcasti_strip_room(tetcasti_strip_maker *m, size_t need) {
    size_t room = m->out_room;
    void *v = m->out_vertex, *c = m->out_cell;
    if (need <= m->out_room) return 1;
    if (!tetcasti_grow(m->mem, &v, &room, m->out_count, need, sizeof(uint32_t))) return 0;
    m->out_vertex = (uint32_t *)v;
    room = m->out_room;
    if (!tetcasti_grow(m->mem, &c, &room, m->out_count, need, sizeof(uint32_t))) return 0;
    m->out_cell = (uint32_t *)c;
    m->out_room = room;
    return 1;
}

/* Keep the last try: what was appended at the second end comes first, turned round. A window is named by its first
   column: of a cell before the start that is the column of its own new vertex, behind it the one three before. */
static void tetcasti_strip_keep(tetcasti_strip_maker *m, uint32_t start, const uint32_t w[4]) {
    uint32_t n0 = m->length[0], n1 = m->length[1], total = n0 + n1 + 4, i, k;
    uint32_t *vertex, *cell;
    if (!tetcasti_strip_room(m, m->out_count + total)) {
        m->failed = 1;
        return;
    }
    vertex = m->out_vertex + m->out_count;
    cell = m->out_cell + m->out_count;
    for (i = 0; i < total; i++) cell[i] = TETCASTI_NONE;
    for (i = 0; i < n1; i++) {
        vertex[i] = m->string[1][n1 - 1 - i];
        cell[i] = m->window[1][n1 - 1 - i];
    }
    for (i = 0; i < 4; i++) vertex[n1 + i] = w[i];
    cell[n1] = start;
    for (i = 0; i < n0; i++) {
        vertex[n1 + 4 + i] = m->string[0][i];
        if (m->window[0][i] != TETCASTI_NONE) cell[n1 + 1 + i] = m->window[0][i];
    }
    m->out_count += total;
    for (i = 0; i < total; i++)
        if (cell[i] != TETCASTI_NONE) m->used[cell[i] - m->begin] = 1;
    m->try_number++;
    for (i = 0; i < total; i++) {
        if (cell[i] == TETCASTI_NONE) continue;
        for (k = 0; k < 4; k++) {
            uint32_t n = m->mesh->neighbour[cell[i]][k];
            if (tetcasti_strip_free(m, n)) tetcasti_strip_push(m, n);
        }
    }
}

static void tetcasti_strip_run(tetcasti_strip_maker *m) {
    for (;;) {
        uint32_t start = tetcasti_strip_start(m), best_cells = 0, best_columns = 0, best_order = 0, order, w[4], lone;
        if (start == TETCASTI_NONE || m->failed) return;
        lone = tetcasti_strip_free_count(m, start);
        if (lone == 1) { /* the order of the first cell is free: begin with its neighbour and come back */
            uint32_t k, n = TETCASTI_NONE;
            for (k = 0; k < 4; k++)
                if (tetcasti_strip_free(m, m->mesh->neighbour[start][k])) n = m->mesh->neighbour[start][k];
            for (order = 0; order < 24; order++) {
                uint32_t cells = tetcasti_strip_try(m, n, order, w), columns = m->length[0] + m->length[1];
                if (cells > best_cells || (cells == best_cells && columns < best_columns)) {
                    best_cells = cells;
                    best_columns = columns;
                    best_order = 24 + order;
                }
            }
        }
        for (order = 0; order < (lone == 0 ? 1u : 24u); order++) {
            uint32_t cells = tetcasti_strip_try(m, start, order, w), columns = m->length[0] + m->length[1];
            if (cells > best_cells || (cells == best_cells && columns < best_columns)) {
                best_cells = cells;
                best_columns = columns;
                best_order = order;
            }
        }
        if (best_order >= 24) {
            uint32_t k, n = TETCASTI_NONE;
            m->try_number++;
            for (k = 0; k < 4; k++)
                if (tetcasti_strip_free(m, m->mesh->neighbour[start][k])) n = m->mesh->neighbour[start][k];
            start = n;
            best_order -= 24;
        }
        (void)tetcasti_strip_try(m, start, best_order, w);
        tetcasti_strip_keep(m, start, w);
    }
}

typedef struct tetcasti_strips {
    const tetcast_mesh *mesh;
    tetcasti_mem *mem;
    int general;
    uint32_t **vertex, **cell;   /* per chunk: columns; owned */
    uint64_t *columns;           /* per chunk: how many, then where they begin */
    uint32_t *place;             /* per cell: its column */
    tetcasti_cells *cells;
    uint32_t *number;            /* per column: cell of the window that begins there */
    uint32_t failed;             /* atomic */
} tetcasti_strips;

static void tetcasti_task_strips(void *ctx, uint32_t chunk) {
    tetcasti_strips *s = (tetcasti_strips *)ctx;
    tetcasti_strip_maker m;
    uint32_t k, *block = NULL;
    const uint32_t room = 4 * TETCASTI_STRIP_CANDIDATE;
    memset(&m, 0, sizeof m);
    m.mesh = s->mesh;
    m.mem = s->mem;
    m.general = s->general;
    m.begin = chunk * TETCASTI_STRIP_CHUNK;
    m.count = s->mesh->cell_count - m.begin < TETCASTI_STRIP_CHUNK
        ? s->mesh->cell_count - m.begin : TETCASTI_STRIP_CHUNK;
    m.used = (uint8_t *)tetcasti_alloc_zero(s->mem, m.count, 1);
    block = (uint32_t *)tetcasti_alloc_zero(s->mem, 6 * (size_t)m.count + 4 * (size_t)room, sizeof *block);
    if (m.used != NULL && block != NULL) {
        m.mark = block;
        for (k = 0; k < 5; k++) m.queue[k] = block + (k + 1) * (size_t)m.count;
        for (k = 0; k < 2; k++) {
            m.string[k] = block + 6 * (size_t)m.count + 2 * k * (size_t)room;
            m.window[k] = m.string[k] + room;
        }
        tetcasti_strip_run(&m);
    } else {
        m.failed = 1;
    }
    tetcasti_free(s->mem, m.used);
    tetcasti_free(s->mem, block);
    s->vertex[chunk] = m.out_vertex;
    s->cell[chunk] = m.out_cell;
    s->columns[chunk] = m.out_count;
    if (m.failed) tetcasti_atomic_store(&s->failed, 1u);
}

/* Vertices and cells of the columns of a chunk to where they belong. */
static void tetcasti_task_strips_place(void *ctx, uint32_t chunk) {
    tetcasti_strips *s = (tetcasti_strips *)ctx;
    uint32_t c = (uint32_t)s->columns[chunk], end = (uint32_t)s->columns[chunk + 1], i;
    tetcasti_column *out = (tetcasti_column *)s->cells->data;
    for (i = 0; c < end; c++, i++) {
        out[c].v = s->vertex[chunk][i];
        out[c].n1 = out[c].n2 = TETCASTI_STRIP_NONE;
        s->number[c] = s->cell[chunk][i];
        if (s->number[c] != TETCASTI_NONE) s->place[s->number[c]] = c;
    }
}

static uint32_t tetcasti_strip_reference(const tetcasti_strips *s, uint32_t cell) {
    return cell == TETCASTI_NONE ? TETCASTI_STRIP_NONE : s->place[cell];
}

/* The links of the windows that begin in a chunk: they stay within its columns. */
static void tetcasti_task_strips_link(void *ctx, uint32_t chunk) {
    tetcasti_strips *s = (tetcasti_strips *)ctx;
    uint32_t c = (uint32_t)s->columns[chunk], first = c, end = (uint32_t)s->columns[chunk + 1];
    tetcasti_column *out = (tetcasti_column *)s->cells->data;
    for (; c < end; c++) {
        uint32_t cell = s->number[c], n[4], k;
        if (cell == TETCASTI_NONE) continue;
        for (k = 0; k < 4; k++) n[k] = tetcasti_opposite(s->mesh, cell, out[c + k].v);
        out[c + 1].n1 = tetcasti_strip_reference(s, n[1]);
        out[c + 1].n2 = tetcasti_strip_reference(s, n[2]);
        if (n[0] != TETCASTI_NONE && c + 1 < end && s->number[c + 1] == n[0]) out[c + 1].n1 |= TETCASTI_STRIP_FLAG;
        else out[c + 2].n1 = tetcasti_strip_reference(s, n[0]);
        if (n[3] != TETCASTI_NONE && c > first && s->number[c - 1] == n[3]) out[c + 1].n2 |= TETCASTI_STRIP_FLAG;
        else out[c].n2 = tetcasti_strip_reference(s, n[3]);
    }
}

static tetcast_result tetcasti_strips_run(tetcasti_strips *s, const tetcast_env *env, uint32_t chunks) {
    const tetcast_mesh *mesh = s->mesh;
    tetcasti_cells *cells = s->cells;
    uint64_t sum = 0;
    uint32_t c;
    s->vertex = (uint32_t **)tetcasti_alloc_zero(s->mem, chunks, sizeof *s->vertex);
    s->cell = (uint32_t **)tetcasti_alloc_zero(s->mem, chunks, sizeof *s->cell);
    s->columns = (uint64_t *)tetcasti_alloc_zero(s->mem, (size_t)chunks + 1, sizeof *s->columns);
    s->place = (uint32_t *)tetcasti_alloc_array(s->mem, mesh->cell_count, sizeof *s->place);
    cells->first = (uint32_t *)tetcasti_alloc_array(s->mem, mesh->face_count, sizeof *cells->first);
    if (!s->vertex || !s->cell || !s->columns || !s->place || !cells->first) return TETCAST_ERR_NO_MEMORY;
    tetcasti_parallel_for(env, tetcasti_task_strips, s, chunks);
    if (s->failed) return TETCAST_ERR_NO_MEMORY;
    for (c = 0; c <= chunks; c++) {
        uint64_t n = c < chunks ? s->columns[c] : 0;
        s->columns[c] = sum;
        sum += n;
    }
    if (sum >= TETCASTI_STRIP_NONE) return TETCAST_ERR_RANGE;
    cells->count = (uint32_t)sum;
    cells->data_bytes = (size_t)sum * sizeof(tetcasti_column);
    cells->data = tetcasti_alloc_array(s->mem, (size_t)sum + 4, sizeof(tetcasti_column));
    s->number = (uint32_t *)tetcasti_alloc_array(s->mem, (size_t)sum + 1, sizeof *s->number);
    cells->side = s->number;
    if (cells->data == NULL || s->number == NULL) return TETCAST_ERR_NO_MEMORY;
    tetcasti_parallel_for(env, tetcasti_task_strips_place, s, chunks);
    tetcasti_parallel_for(env, tetcasti_task_strips_link, s, chunks);
    for (c = 0; c < mesh->face_count; c++) cells->first[c] = s->place[mesh->face[c].cell];
    cells->first_bytes = (size_t)mesh->face_count * sizeof *cells->first;
    return TETCAST_OK;
}

/* Make one of the forms of this section; on failure the caller frees what is there. Of strips `side` says which cell
   begins in each column. */
static tetcast_result tetcasti_cells_build_more(tetcasti_mem *mem, const tetcast_env *env, tetcast_cells kind,
                                                const tetcast_mesh *mesh, tetcasti_cells *cells) {
    tetcasti_pack_more p;
    tetcasti_strips s;
    tetcast_result result;
    size_t size = kind == TETCAST_CELLS_TET20 ? sizeof(tetcasti_tet20)
                  : kind == TETCAST_CELLS_TET32 ? sizeof(tetcasti_tet32) : sizeof(tetcasti_tet160);
    uint32_t chunks, c;
    p.mesh = mesh;
    p.cells = cells;
    if (kind != TETCAST_CELLS_STRIPS && kind != TETCAST_CELLS_STRIPS_GENERAL) {
        cells->data_bytes = (size_t)cells->count * size;
        cells->data = tetcasti_alloc_array(mem, (size_t)cells->count + 1, size);
        if (cells->data == NULL) return TETCAST_ERR_NO_MEMORY;
        tetcasti_parallel_for(env, kind == TETCAST_CELLS_LIST160 ? tetcasti_task_pack_list : tetcasti_task_pack_more,
                              &p,
                              tetcasti_chunks(mesh->cell_count));
        return TETCAST_OK;
    }
    memset(&s, 0, sizeof s);
    s.mesh = mesh;
    s.mem = mem;
    s.cells = cells;
    s.general = kind == TETCAST_CELLS_STRIPS_GENERAL;
    chunks = (mesh->cell_count + TETCASTI_STRIP_CHUNK - 1) / TETCASTI_STRIP_CHUNK;
    result = tetcasti_strips_run(&s, env, chunks);
    for (c = 0; c < chunks; c++) {
        if (s.vertex != NULL) tetcasti_free(mem, s.vertex[c]);
        if (s.cell != NULL) tetcasti_free(mem, s.cell[c]);
    }
    tetcasti_free(mem, s.vertex);
    tetcasti_free(mem, s.cell);
    tetcasti_free(mem, s.columns);
    tetcasti_free(mem, s.place);
    return result;
}
/* ---------------------------------------------------------------------------
   walk: rays, where they meet the hull, and from cell to cell.                  // >>walk

   A ray looks along one of the axes, the one in which it is fastest. Seen along the ray a vertex v is
       dz = v.z - o.z,  x = (v.x - o.x) - sx * dz,  y = (v.y - o.y) - sy * dz,  distance = dz * iz
   with slopes sx, sy in [-1, 1]: the ray is the point (0, 0) of the plane and space is sheared, not turned. x and y are
   rounded once and from there on everything is exact: on which side of the edge a-b the ray passes is the sign of
   a.x*b.y - a.y*b.x, which Kahan's scheme with fma gives exactly; zero is decided as if the ray were moved by
   (eps, eps^2). So all signs belong to one real configuration of points in the plane and a point in general position,
   where every tetrahedron has 0 or 2 faces with the point inside. A walk over such faces cannot branch, cannot stop
   inside of the mesh and cannot come back, whatever shape the cells have: it leads from one face of the hull to
   another one. No epsilons, no limit of steps.
   The face (a, b, c) through which a cell was entered has all three signs positive. Of the fourth vertex d three more
   signs say which of its three faces is the way out; the determinants of a face are also the weights of its vertices
   at the point where the ray passes, so distance and value there are means of the vertices', and the next cell uses the
   same ones.
   S. Woop, C. Benthin, I. Wald: Watertight Ray/Triangle Intersection. JCGT 2(1), 2013 (shear). W. Kahan: On the cost of
   floating-point computation without extra-precise arithmetic, 2004 (determinant). H. Edelsbrunner, E. Muecke:
   Simulation of Simplicity. ACM TOG 9(1), 1990 (ties).
   --------------------------------------------------------------------------- */

#if TETCASTI_X64 && !(defined(_MSC_VER) && !defined(__clang__))
#  define TETCASTI_TARGET_FMA __attribute__((target("fma")))
#else
#  define TETCASTI_TARGET_FMA
#endif

TETCASTI_UNUSED static int tetcasti_has_fma(void) {
#if TETCASTI_X64 && !defined(_MSC_VER)
    return __builtin_cpu_supports("fma") != 0;
#elif TETCASTI_X64
    int r[4];
    __cpuid(r, 1);
    return (r[2] & (1 << 12)) != 0 && tetcasti_cpu_level() >= 3;
#else
    return 0;
#endif
}

#define TETCASTI_TILE 32u
#define TETCASTI_BATCH 1024u     /* rays that are followed together */
#define TETCASTI_NO_RAY 255u     /* group of a ray that cannot meet the mesh */
#define TETCASTI_STARTS 0x80000000u /* hits from here on are in batch->start */

/* A ray: origin in the order of its axes, a multiple of 2^-18; slopes are multiples of 2^-45. */
typedef struct tetcasti_ray {
    float ox, oy, oz, sx, sy, iz;
    uint32_t group;         /* 2 * axis + (1 if it looks down the axis) */
} tetcasti_ray;

typedef struct tetcasti_point { float x, y, z, s; } tetcasti_point; /* a vertex as the ray sees it */

/* The axes of a group, chosen so that a face of the hull through which rays enter is counter-clockwise. */
static const uint8_t tetcasti_axes[6][3] = {{2, 1, 0}, {1, 2, 0}, {0, 2, 1}, {2, 0, 1}, {1, 0, 2}, {0, 1, 2}};

TETCASTI_INLINE tetcasti_point tetcasti_project(const tetcasti_ray *r, const tetcasti_vertex *v) {
    const uint8_t *axes = tetcasti_axes[r->group];
    float p[3], dx, dy, dz;
    tetcasti_point q;
    p[0] = v->x;
    p[1] = v->y;
    p[2] = v->z;
    dx = p[axes[0]] - r->ox;
    dy = p[axes[1]] - r->oy;
    dz = p[axes[2]] - r->oz;
    q.x = fmaf(-r->sx, dz, dx);
    q.y = fmaf(-r->sy, dz, dy);
    q.z = dz * r->iz;
    q.s = v->s;
    return q;
}

/* a.x*b.y - a.y*b.x: sign and zero are exact, else at most 1.5 units in the last place off. */
TETCASTI_INLINE float tetcasti_det(const tetcasti_point *a, const tetcasti_point *b) {
    float w = a->y * b->x, e = fmaf(-a->y, b->x, w), f = fmaf(a->x, b->y, -w);
    return f + e;
}

/* Is the determinant, value v, positive when the ray is moved by (eps, eps^2)? Antisymmetric in a and b. */
TETCASTI_INLINE int tetcasti_positive(float v, const tetcasti_point *a, const tetcasti_point *b, uint32_t ia,
                                      uint32_t ib) {
    if (TETCASTI_LIKELY(v != 0.0f)) return v > 0.0f;
    if (a->y != b->y) return a->y > b->y;
    if (a->x != b->x) return b->x > a->x;
    return ia < ib;
}

/* The group of a direction, or NO_RAY when it is none. */
TETCASTI_INLINE uint32_t tetcasti_ray_group(const double d[3]) {
    uint32_t k = 0, a;
    for (a = 1; a < 3; a++) k = tetcasti_abs(d[a]) > tetcasti_abs(d[k]) ? a : k;
    if (!(tetcasti_abs(d[k]) > 0.0) || !tetcasti_finite(d[0]) || !tetcasti_finite(d[1]) || !tetcasti_finite(d[2]))
        return TETCASTI_NO_RAY;
    return 2 * k + (d[k] < 0.0);
}

/* Set up a ray in a mesh's coordinates, for a direction of r->group: local origin and direction. When it cannot meet
   the box the group becomes NO_RAY. Returns the local distance from the given origin to the ray's own, which is where
   it comes to the slab of its axis, so that distances in the mesh are small numbers however far away the eye is. */
TETCASTI_INLINE double tetcasti_ray_make(const tetcasti_box *box, const double o[3], const double d[3],
                                         tetcasti_ray *r) {
    const uint8_t *axes = tetcasti_axes[r->group];
    uint32_t k = axes[2], down = r->group & 1u;
    double rx = d[axes[0]] / d[k], ry = d[axes[1]] / d[k]; /* as given: the ray comes to the mesh where it should */
    double sx = (double)(float)((rx + TETCASTI_SNAP_SLOPE) - TETCASTI_SNAP_SLOPE);
    double sy = (double)(float)((ry + TETCASTI_SNAP_SLOPE) - TETCASTI_SNAP_SLOPE);
    double lo = (double)box->lo[k], hi = (double)box->hi[k], x = o[axes[0]], y = o[axes[1]], z = o[k], z0, length;
    length = sqrt((1.0 + sx * sx) + sy * sy);
    if (down) length = -length;
    z0 = (down ? hi : lo) - z;
    if (down ? z0 > 0.0 : z0 < 0.0) z0 = 0.0; /* it begins in the slab */
    x += rx * z0;
    y += ry * z0;
    if (down ? z < lo - TETCASTI_BLUR : z > hi + TETCASTI_BLUR) r->group = TETCASTI_NO_RAY; /* begins behind it */
    z += z0;
    /* with slopes up to 1 it does not come back from farther outside */
    if (!(x > (double)box->lo[axes[0]] - (hi - lo) - TETCASTI_BLUR &&
          x < (double)box->hi[axes[0]] + (hi - lo) + TETCASTI_BLUR &&
          y > (double)box->lo[axes[1]] - (hi - lo) - TETCASTI_BLUR &&
              y < (double)box->hi[axes[1]] + (hi - lo) + TETCASTI_BLUR))
        r->group = TETCASTI_NO_RAY;
    r->ox = (float)((x + TETCASTI_SNAP) - TETCASTI_SNAP);
    r->oy = (float)((y + TETCASTI_SNAP) - TETCASTI_SNAP);
    r->oz = (float)((z + TETCASTI_SNAP) - TETCASTI_SNAP);
    r->sx = (float)sx;
    r->sy = (float)sy;
    r->iz = (float)length;
    return tetcasti_abs(z0) * sqrt((1.0 + rx * rx) + ry * ry);
}

/* ---- faces that a ray enters ---- */

/* Does the ray pass through (a, b, c) so that it sees it counter-clockwise? Then *at is the distance. */
TETCASTI_INLINE int tetcasti_face_hit(const tetcasti_ray *r, const tetcasti_vertex *vertex, const uint32_t v[3],
                                      float *at) {
    tetcasti_point a = tetcasti_project(r, &vertex[v[0]]), b = tetcasti_project(r, &vertex[v[1]]), c;
    float ab = tetcasti_det(&a, &b), bc, ca;
    if (!tetcasti_positive(ab, &a, &b, v[0], v[1])) return 0;
    c = tetcasti_project(r, &vertex[v[2]]);
    bc = tetcasti_det(&b, &c);
    if (!tetcasti_positive(bc, &b, &c, v[1], v[2])) return 0;
    ca = tetcasti_det(&c, &a);
    if (!tetcasti_positive(ca, &c, &a, v[2], v[0])) return 0;
    *at = fmaf(bc, a.z, fmaf(ca, b.z, ab * c.z)) * (1.0f / ((ab + bc) + ca));
    return 1;
}

/* ---- walking ---- */

/* Value where the ray passes a face, from its weights. Rounding does not take it out of the range of the three values:
   so a face whose vertices have the isovalue has it, too, and faces above and below stay on their sides. */
TETCASTI_INLINE float tetcasti_face_value(const tetcasti_point *a, const tetcasti_point *b, const tetcasti_point *c,
                                          float ab,
                                          float bc, float ca, float inv) {
    float s = fmaf(bc, a->s, fmaf(ca, b->s, ab * c->s)) * inv;
    float lo = a->s < b->s ? a->s : b->s, hi = a->s > b->s ? a->s : b->s;
    lo = lo < c->s ? lo : c->s;
    hi = hi > c->s ? hi : c->s;
    s = s > lo ? s : lo;
    return s < hi ? s : hi;
}

/* enter cell through v, coming from prev */
typedef struct tetcasti_start { uint32_t v[3], cell, prev; } tetcasti_start;

/* A walk on its way: in `cell`, through the face (a, b, c), which it passed at distance at_face with value s_face. */
typedef struct tetcasti_walk {
    tetcasti_point pa, pb, pc;
    float ab, bc, ca;
    uint32_t a, b, c, cell, prev;
    float at_face, s_face;
    uint32_t d;             /* after a step: the fourth vertex of the cell that was passed */
    uint32_t dropped;       /* and the one that is not in the face of the way out */
} tetcasti_walk;

TETCASTI_INLINE void tetcasti_walk_begin(const tetcasti_ray *r, const tetcasti_vertex *vertex,
                                         const tetcasti_start *start,
                                         tetcasti_walk *w) {
    float inv;
    w->a = start->v[0];
    w->b = start->v[1];
    w->c = start->v[2];
    w->cell = start->cell;
    w->prev = start->prev;
    w->pa = tetcasti_project(r, &vertex[w->a]);
    w->pb = tetcasti_project(r, &vertex[w->b]);
    w->pc = tetcasti_project(r, &vertex[w->c]);
    w->ab = tetcasti_det(&w->pa, &w->pb);
    w->bc = tetcasti_det(&w->pb, &w->pc);
    w->ca = tetcasti_det(&w->pc, &w->pa);
    inv = 1.0f / ((w->ab + w->bc) + w->ca);
    w->at_face = fmaf(w->bc, w->pa.z, fmaf(w->ca, w->pb.z, w->ab * w->pc.z)) * inv;
    w->s_face = tetcasti_face_value(&w->pa, &w->pb, &w->pc, w->ab, w->bc, w->ca, inv);
}

/* Pass through the cell. *at, *s: where the ray leaves it; the walk's own at_face and s_face are left to the caller. */
TETCASTI_INLINE void tetcasti_walk_step(const tetcasti_cells *cells, uint32_t kind, const tetcasti_ray *r,
                                        const tetcasti_vertex *vertex, tetcasti_walk *w, float *at, float *s) {
    tetcasti_node node;
    uint32_t d = tetcasti_enter(cells, kind, w->cell, w->prev, w->a, w->b, w->c, &node), x, next;
    tetcasti_point pd = tetcasti_project(r, &vertex[d]);
    float da = tetcasti_det(&w->pa, &pd), db = tetcasti_det(&w->pb, &pd), dc = tetcasti_det(&w->pc, &pd), inv;
    int pa = tetcasti_positive(da, &w->pa, &pd, w->a, d);
    if (!pa && tetcasti_positive(db, &w->pb, &pd, w->b, d)) { /* out through (a, b, d) */
        x = w->c;
        next = tetcasti_leave(cells, kind, &node, w->cell, w->prev, w->a, w->b, w->c, d, x);
        w->c = d;
        w->pc = pd;
        w->bc = db;
        w->ca = -da;
    } else if (pa && !tetcasti_positive(dc, &w->pc, &pd, w->c, d)) { /* (a, d, c) */
        x = w->b;
        next = tetcasti_leave(cells, kind, &node, w->cell, w->prev, w->a, w->b, w->c, d, x);
        w->b = d;
        w->pb = pd;
        w->ab = da;
        w->bc = -dc;
    } else { /* (d, b, c) */
        x = w->a;
        next = tetcasti_leave(cells, kind, &node, w->cell, w->prev, w->a, w->b, w->c, d, x);
        w->a = d;
        w->pa = pd;
        w->ab = -db;
        w->ca = dc;
    }
    inv = 1.0f / ((w->ab + w->bc) + w->ca);
    *at = fmaf(w->bc, w->pa.z, fmaf(w->ca, w->pb.z, w->ab * w->pc.z)) * inv;
    *s = tetcasti_face_value(&w->pa, &w->pb, &w->pc, w->ab, w->bc, w->ca, inv);
    w->prev = w->cell;
    w->cell = next;
    w->d = d;
    w->dropped = x;
}

static void tetcasti_walk_step_any(const tetcasti_cells *cells, const tetcasti_ray *r, const tetcasti_vertex *vertex,
                                   tetcasti_walk *w, float *at, float *s) {
    tetcasti_walk_step(cells, cells->kind, r, vertex, w, at, s);
}

/* ---- batches of rays ---- */

typedef struct tetcasti_hit { uint32_t ray; float at; uint32_t face; } tetcasti_hit;

/* What all walks through one mesh need. */
typedef struct tetcasti_scene {
    const tetcast_mesh *mesh;
    const tetcasti_vertex *vertex;
    const tetcasti_cells *cells;
    const tetcasti_hull *hull;      /* faces where rays enter */
    const uint32_t *hull_prev;      /* cell that lies on the other side of them; NULL: none */
    const uint32_t *first;          /* what walks begin with at them, where that is not face.cell; else NULL */
    const uint32_t *stop;           /* NULL, or bit (cell >> stop_log) is set where walks end */
    uint32_t stop_log;
    const tetcast_optics *optics;   /* NULL: none */
    float unit;                     /* world length of a local one */
    uint32_t smooth_normals, fma;
    tetcast_isa isa;                /* never AUTO */
    uint32_t any;                   /* more than a volume of one value per vertex: isosurfaces, hidden cells, depths */
    float begin_t;                  /* transmittance of a sum that has seen nothing */
    tetcasti_segment8_fn *segment8; /* that of the optics, or the same code for AVX-512 */
} tetcasti_scene;

typedef struct tetcasti_batch {
    uint32_t count;
    uint32_t failed;                /* no memory for hits */
    tetcasti_mem *mem;
    uint8_t group[TETCASTI_BATCH];  /* NO_RAY: it meets nothing; what follows may be any numbers then */
    float ox[TETCASTI_BATCH], oy[TETCASTI_BATCH], oz[TETCASTI_BATCH], sx[TETCASTI_BATCH], sy[TETCASTI_BATCH],
        iz[TETCASTI_BATCH];
    float offset[TETCASTI_BATCH];   /* local distance from the eye to the ray's origin */
    /* up to here everything has been seen; first the near end, local, from the origin */
    float cursor[TETCASTI_BATCH];
    float last[TETCASTI_BATCH];     /* far end */
    float length[TETCASTI_BATCH];   /* way inside of the mesh, local */
    float depth[TETCASTI_BATCH];    /* of the first segment that is not empty; infinity */
    uint32_t steps[TETCASTI_BATCH], walks[TETCASTI_BATCH];
    tetcasti_ray_sum sum[TETCASTI_BATCH];
    uint8_t ended[TETCASTI_BATCH];
    tetcasti_hit *hit, *sorted;     /* hits as found; by ray, then by distance */
    size_t hit_count, hit_room, sorted_room;
    uint32_t hit_start[TETCASTI_BATCH + 1];
    uint16_t queue[TETCASTI_BATCH];       /* the order in which lanes take rays */
    uint32_t together;                    /* neighbours in the queue are neighbours in space: see lanes_next */
    tetcasti_start start[TETCASTI_BATCH]; /* of rays that begin inside of a cell */
    uint64_t hull_tests, lanes, ended_count;
} tetcasti_batch;

TETCASTI_INLINE tetcasti_ray tetcasti_batch_ray(const tetcasti_batch *b, uint32_t i) {
    tetcasti_ray r;
    r.ox = b->ox[i];
    r.oy = b->oy[i];
    r.oz = b->oz[i];
    r.sx = b->sx[i];
    r.sy = b->sy[i];
    r.iz = b->iz[i];
    r.group = b->group[i];
    return r;
}

static void tetcasti_batch_hit(tetcasti_batch *b, uint32_t ray, float at, uint32_t face) {
    tetcasti_hit *h;
    if (b->hit_count == b->hit_room &&
        !tetcasti_grow(b->mem, (void **)&b->hit, &b->hit_room, b->hit_count, b->hit_count + 1, sizeof *b->hit)) {
        b->failed = 1;
        return;
    }
    h = &b->hit[b->hit_count++];
    h->ray = ray;
    h->at = at;
    h->face = face;
}

/* Hits in the order of rays, those of a ray in the order of distance (then of faces, so that touching parts of a mesh,
   where distances are equal, come in an order that is always the same). */
static void tetcasti_batch_sort(tetcasti_batch *b) {
    uint32_t i, sum = 0;
    size_t k;
    if (b->hit_count > b->sorted_room &&
        !tetcasti_grow(b->mem, (void **)&b->sorted, &b->sorted_room, 0, b->hit_count, sizeof *b->sorted)) {
        b->failed = 1;
        b->hit_count = 0;
    }
    memset(b->hit_start, 0, sizeof b->hit_start);
    for (k = 0; k < b->hit_count; k++) b->hit_start[b->hit[k].ray + 1]++;
    for (i = 0; i < b->count; i++) b->hit_start[i + 1] += b->hit_start[i];
    for (k = 0; k < b->hit_count; k++) b->sorted[b->hit_start[b->hit[k].ray]++] = b->hit[k];
    for (i = b->count; i > 0; i--) b->hit_start[i] = b->hit_start[i - 1];
    b->hit_start[0] = 0;
    for (i = 0; i < b->count; i++) {
        uint32_t n = b->hit_start[i + 1] - b->hit_start[i], gap, j, m;
        tetcasti_hit *h = b->sorted + b->hit_start[i], x;
        if (n < 2) continue;
        for (gap = 1; gap < n / 3; gap = 3 * gap + 1) { }
        for (; gap > 0; gap /= 3)
            for (j = gap; j < n; j++) {
                x = h[j];
                for (m = j; m >= gap &&
                     (h[m - gap].at > x.at || (!(h[m - gap].at < x.at) && h[m - gap].face > x.face)); m -= gap)
                    h[m] = h[m - gap];
                h[m] = x;
            }
        sum += n;
    }
    (void)sum;
}

static tetcasti_start tetcasti_hit_start(const tetcasti_scene *scene, const tetcasti_batch *b, const tetcasti_hit *h) {
    tetcasti_start s;
    const tetcasti_face *f;
    uint32_t k;
    if (h->face >= TETCASTI_STARTS) return b->start[h->face - TETCASTI_STARTS];
    f = &scene->hull->face[h->face];
    for (k = 0; k < 3; k++) s.v[k] = f->v[k];
    s.cell = scene->first != NULL ? scene->first[h->face] : f->cell;
    s.prev = scene->hull_prev != NULL ? scene->hull_prev[h->face] : TETCASTI_NONE;
    return s;
}

/* ---- gradients for isosurfaces ---- */

typedef struct tetcasti_crossing_info { /* of one cell on one ray; the user data of tetcasti_normal */
    const tetcasti_scene *scene;
    uint32_t in[3], out[3], dropped;  /* faces of the way in and out, and the vertex that is not in the latter */
    float in_weight[3], out_weight[3];
    float begin, end;               /* share of the way through the cell where the segment begins and ends */
    float first;                    /* out: share of the segment at which a surface was met first; infinity */
} tetcasti_crossing_info;

static void tetcasti_normal(void *user, float fraction, float normal[3]) {
    tetcasti_crossing_info *x = (tetcasti_crossing_info *)user;
    const tetcasti_vertex *vertex = x->scene->vertex;
    const float (*gradient)[3] = (const float (*)[3])x->scene->mesh->gradient;
    double g[3], big, volume;
    uint32_t i, k;
    if (fraction < x->first) x->first = fraction;
    if (x->scene->smooth_normals && gradient != NULL) {
        double f = (double)x->begin + (double)fraction * ((double)x->end - (double)x->begin);
        for (i = 0; i < 3; i++) {
            g[i] = 0.0;
            for (k = 0; k < 3; k++)
                g[i] += (1.0 - f) * (double)x->in_weight[k] * (double)gradient[x->in[k]][i] +
                        f * (double)x->out_weight[k] * (double)gradient[x->out[k]][i];
        }
    } else {
        tetcasti_cell_gradient(&vertex[x->out[0]], &vertex[x->out[1]], &vertex[x->out[2]], &vertex[x->dropped], g,
                               &volume);
    }
    big = tetcasti_max(tetcasti_max(tetcasti_abs(g[0]), tetcasti_abs(g[1])), tetcasti_abs(g[2]));
    for (i = 0; i < 3; i++) normal[i] = big > 0.0 && tetcasti_finite(big) ? (float)(g[i] / big) : 0.0f;
}

/* Unit direction of a ray in the axes of the world. */
static void tetcasti_ray_direction(const tetcasti_ray *r, float d[3]) {
    const uint8_t *axes = tetcasti_axes[r->group];
    d[0] = d[1] = d[2] = 0.0f;
    d[axes[0]] = r->sx / r->iz;
    d[axes[1]] = r->sy / r->iz;
    d[axes[2]] = 1.0f / r->iz;
}

/* ---- one ray after the other ---- */

#define TETCASTI_SINK_NONE 0u   /* only lengths and steps */
#define TETCASTI_SINK_VOLUME 1u
#define TETCASTI_SINK_ANY 2u    /* isosurfaces, values per cell, hidden cells, depths */

TETCASTI_INLINE int tetcasti_bit(const uint32_t *bits, uint32_t i) { return (int)(bits[i >> 5] >> (i & 31u) & 1u); }

/* Fill in the way through a cell: weights of the faces of the way in and out, where on it the segment begins and
   ends. */
static void tetcasti_crossing_set(tetcasti_crossing_info *x, const float in[3], const float out[3], float at_in,
                                  float at_out,
                                  float begin, float end) {
    float inv = 1.0f / ((in[0] + in[1]) + in[2]), way = at_out - at_in;
    x->in_weight[0] = in[1] * inv;
    x->in_weight[1] = in[2] * inv;
    x->in_weight[2] = in[0] * inv;
    inv = 1.0f / ((out[0] + out[1]) + out[2]);
    x->out_weight[0] = out[1] * inv;
    x->out_weight[1] = out[2] * inv;
    x->out_weight[2] = out[0] * inv;
    x->begin = way > 0.0f ? (begin - at_in) / way : 0.0f;
    x->end = way > 0.0f ? (end - at_in) / way : 1.0f;
    x->first = TETCASTI_INF;
}

/* The segment of one cell goes into the sum of ray i. Its ends are clipped already; cursor is where it begins. */
static void tetcasti_batch_segment(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t i, const tetcasti_ray *r,
                                   const tetcasti_walk *before, const tetcasti_walk *w, float at, float front,
                                       float back,
                                   float cursor, float length) {
    const tetcast_optics *o = scene->optics;
    tetcasti_ray_sum *sum = &b->sum[i];
    float depth = (b->offset[i] + cursor) * scene->unit, way = length * scene->unit;
    uint32_t cell = tetcasti_cell_number(scene->cells, w->prev);
    if (scene->mesh->hidden != NULL && tetcasti_bit(scene->mesh->hidden, cell)) {
        tetcasti_ray_gap(o, sum);
        return;
    }
    if (scene->mesh->cell_value != NULL) front = back = scene->mesh->cell_value[cell];
    if (o->iso_count != 0) {
        tetcasti_crossing_info x;
        float view[3], in[3], out[3];
        x.scene = scene;
        x.in[0] = before->a; x.in[1] = before->b; x.in[2] = before->c;
        x.out[0] = w->a; x.out[1] = w->b; x.out[2] = w->c;
        x.dropped = w->dropped;
        in[0] = before->ab; in[1] = before->bc; in[2] = before->ca;
        out[0] = w->ab; out[1] = w->bc; out[2] = w->ca;
        tetcasti_crossing_set(&x, in, out, before->at_face, at, cursor, cursor + length);
        tetcasti_ray_direction(r, view);
        tetcasti_segment_iso(o, front, back, way, depth, tetcasti_normal, &x, view, sum);
        if (o->model == TETCAST_MODEL_ISOSURFACE && x.first < 1.0f) depth += x.first * way;
    } else {
        o->segment(o, front, back, way, depth, sum);
    }
    if (b->depth[i] == TETCASTI_INF && (sum->t != scene->begin_t || sum->c[0] != 0.0f || sum->c[1] != 0.0f ||
                                        sum->c[2] != 0.0f))
        b->depth[i] = depth;
}

/* All walks of ray i. */
TETCASTI_INLINE void tetcasti_batch_walk_ray(const tetcasti_scene *scene, uint32_t kind, uint32_t sink,
                                             tetcasti_batch *b,
                                             uint32_t i) {
    const tetcast_optics *o = scene->optics;
    const tetcasti_hit *h = b->sorted + b->hit_start[i], *h_end = b->sorted + b->hit_start[i + 1];
    const uint32_t *stop = scene->stop;
    tetcasti_ray r = tetcasti_batch_ray(b, i);
    float last = b->last[i], cursor = b->cursor[i];
    uint32_t steps = 0;
    int over = 0;
    for (; h < h_end && !over && h->at < last; h++) {
        tetcasti_start start = tetcasti_hit_start(scene, b, h);
        tetcasti_walk w, before;
        tetcasti_walk_begin(&r, scene->vertex, &start, &w);
        before = w;
        b->walks[i]++;
        if (w.at_face > cursor) {
            cursor = w.at_face;
            if (sink != TETCASTI_SINK_NONE) tetcasti_ray_gap(o, &b->sum[i]);
        }
        while (!over && w.cell != TETCASTI_NONE) {
            float at, s;
            if (stop != NULL && tetcasti_bit(stop, w.cell >> scene->stop_log)) break;
            if (sink == TETCASTI_SINK_ANY) before = w;
            tetcasti_walk_step(scene->cells, kind, &r, scene->vertex, &w, &at, &s);
            steps++;
            if (at >= cursor) { /* else it is before the near end, or seen already */
                float front = w.s_face, back = s, end = at, length;
                if (w.at_face < cursor) front += (s - w.s_face) * ((cursor - w.at_face) / (at - w.at_face));
                if (at > last) {
                    back = w.s_face + (s - w.s_face) * ((last - w.at_face) / (at - w.at_face));
                    end = last;
                    over = 1;
                }
                length = end - cursor;
                b->length[i] += length;
                if (sink == TETCASTI_SINK_VOLUME) {
                    o->segment(o, front, back, length * scene->unit, (b->offset[i] + cursor) * scene->unit, &b->sum[i]);
                } else if (sink == TETCASTI_SINK_ANY) {
                    tetcasti_batch_segment(scene, b, i, &r, &before, &w, at, front, back, cursor, length);
                }
                if (sink != TETCASTI_SINK_NONE && tetcasti_ray_ended(o, &b->sum[i])) {
                    b->ended[i] = 1;
                    over = 1;
                }
                cursor = end;
            }
            w.at_face = at;
            w.s_face = s;
        }
    }
    b->steps[i] += steps;
    b->lanes += steps;
}

#define TETCASTI_WALK_LOOP(kind, sink) for (i = 0; i < b->count; i++) tetcasti_batch_walk_ray(scene, kind, sink, b, i)
#define TETCASTI_WALK_KINDS(sink) \
    switch (scene->cells->kind) { \
    case TETCAST_CELLS_TET8: TETCASTI_WALK_LOOP(TETCAST_CELLS_TET8, sink); break; \
    case TETCAST_CELLS_TET20: TETCASTI_WALK_LOOP(TETCAST_CELLS_TET20, sink); break; \
    case TETCAST_CELLS_TET32: TETCASTI_WALK_LOOP(TETCAST_CELLS_TET32, sink); break; \
    case TETCAST_CELLS_LIST160: TETCASTI_WALK_LOOP(TETCAST_CELLS_LIST160, sink); break; \
    case TETCAST_CELLS_STRIPS: case TETCAST_CELLS_STRIPS_GENERAL: TETCASTI_WALK_LOOP(TETCAST_CELLS_STRIPS, sink); \
    break; \
    default: TETCASTI_WALK_LOOP(TETCAST_CELLS_TET16, sink); break; \
    }

/* The same code twice: where the machine has fma as an instruction it is one, elsewhere libm has it. Same bits. */
TETCASTI_TARGET_FMA static void tetcasti_batch_walk_fma(const tetcasti_scene *scene, tetcasti_batch *b) {
    uint32_t i;
    if (scene->optics == NULL) {
        TETCASTI_WALK_KINDS(TETCASTI_SINK_NONE)
    } else if (scene->any) {
        TETCASTI_WALK_KINDS(TETCASTI_SINK_ANY)
    } else {
        TETCASTI_WALK_KINDS(TETCASTI_SINK_VOLUME)
    }
}
/* the call of fmaf takes most of it */
static void tetcasti_batch_walk_plain(const tetcasti_scene *scene, tetcasti_batch *b) {
    uint32_t i, sink = scene->optics == NULL ? TETCASTI_SINK_NONE : scene->any
        ? TETCASTI_SINK_ANY : TETCASTI_SINK_VOLUME;
    TETCASTI_WALK_LOOP(scene->cells->kind, sink);
}

static void tetcasti_batch_walk(const tetcasti_scene *scene, tetcasti_batch *b) {
    if (scene->fma) tetcasti_batch_walk_fma(scene, b);
    else tetcasti_batch_walk_plain(scene, b);
}
/* ---------------------------------------------------------------------------
   hull: where rays enter the mesh.                                              // >>hull
   Boxes that no ray of a batch can meet are left out with a margin; what is left is decided by the signs that the walk
   goes by, so a ray that is said to enter a face is inside of the cell behind it.
   --------------------------------------------------------------------------- */

#define TETCASTI_MARGIN ((float)(8.0 * TETCASTI_BLUR))

/* ---- pictures ---- */

typedef struct tetcasti_frame {
    double eye[3], right[3], up[3], forward[3]; /* world; right and up times the size of a pixel (at distance 1) */
    uint32_t parallel, width, height;
} tetcasti_frame;

/* What the rays of a tile have in common; all of its arithmetic is the same in the forms for one and for four rays. */
typedef struct tetcasti_tile {
    const tetcasti_frame *frame;
    const tetcasti_box *box;
    double local_eye[3], scale;     /* of the picture */
    double near_end, far_end;       /* local, along the view */
    uint32_t x0, y0, width, height;
    uint32_t group;                 /* of all rays, or NO_RAY */
} tetcasti_tile;

/* ---- beams ---- */

/* Rays of one group of a batch, as ranges. */
typedef struct tetcasti_beam {
    uint32_t group;
    float o_lo[3], o_hi[3], s_lo[2], s_hi[2]; /* by the group's axes */
} tetcasti_beam;

static void tetcasti_beam_add(tetcasti_beam *m, const tetcasti_ray *r, int first) {
    float o[3], s[2];
    uint32_t a;
    o[0] = r->ox; o[1] = r->oy; o[2] = r->oz;
    s[0] = r->sx; s[1] = r->sy;
    m->group = r->group;
    for (a = 0; a < 3; a++) {
        if (first || o[a] < m->o_lo[a]) m->o_lo[a] = o[a];
        if (first || o[a] > m->o_hi[a]) m->o_hi[a] = o[a];
    }
    for (a = 0; a < 2; a++) {
        if (first || s[a] < m->s_lo[a]) m->s_lo[a] = s[a];
        if (first || s[a] > m->s_hi[a]) m->s_hi[a] = s[a];
    }
}

/* Can the line of one of the rays pass through the box? */
static int tetcasti_beam_meets(const tetcasti_beam *m, const float lo[3], const float hi[3]) {
    const uint8_t *axes = tetcasti_axes[m->group];
    float z_lo = lo[axes[2]] - m->o_hi[2], z_hi = hi[axes[2]] - m->o_lo[2];
    uint32_t a;
    for (a = 0; a < 2; a++) {
        float p = m->s_lo[a] * z_lo, q = m->s_lo[a] * z_hi, u = m->s_hi[a] * z_lo, v = m->s_hi[a] * z_hi;
        float least = p < q ? p : q, most = p < q ? q : p;
        least = u < least ? u : least;
        least = v < least ? v : least;
        most = u > most ? u : most;
        most = v > most ? v : most;
        if (lo[axes[a]] - m->o_hi[a] - most > TETCASTI_MARGIN || hi[axes[a]] - m->o_lo[a] - least < -TETCASTI_MARGIN)
            return 0;
    }
    return 1;
}

/* The picture that a batch is a tile of: local point -> pixel. */
typedef struct tetcasti_pixels {
    double eye[3], right[3], up[3], forward[3]; /* local eye; right and up divided by the size of a pixel */
    double center_x, center_y;                  /* of the picture, in pixels of the tile */
    uint32_t parallel;
    uint32_t width, height;                     /* of the tile; rays are in rows of TETCASTI_TILE */
    uint32_t group;                             /* of all rays that can meet the mesh; NO_RAY: there are several */
} tetcasti_pixels;

/* Pixels of the tile that a face can cover, [x0, x1) x [y0, y1); 0: none, or seen from behind. */
static int tetcasti_face_pixels(const tetcasti_pixels *m, const tetcasti_vertex *vertex, const uint32_t v[3],
                                uint32_t rect[4]) {
    double p[3][3], x[2] = {0.0, 0.0}, y[2] = {0.0, 0.0}, nearest, farthest, e[2][3], n[3], w[3], side, doubt, size,
        margin;
    uint32_t i, a;
    for (i = 0; i < 3; i++) {
        const tetcasti_vertex *q = &vertex[v[i]];
        p[i][0] = (double)q->x - m->eye[0];
        p[i][1] = (double)q->y - m->eye[1];
        p[i][2] = (double)q->z - m->eye[2];
    }
    for (a = 0; a < 3; a++) {
        e[0][a] = p[1][a] - p[0][a];
        e[1][a] = p[2][a] - p[0][a];
        w[a] = m->parallel ? m->forward[a] : p[0][a];
    }
    n[0] = e[0][1] * e[1][2] - e[0][2] * e[1][1];
    n[1] = e[0][2] * e[1][0] - e[0][0] * e[1][2];
    n[2] = e[0][0] * e[1][1] - e[0][1] * e[1][0];
    side = n[0] * w[0] + n[1] * w[1] + n[2] * w[2];
    size = tetcasti_abs(e[0][0]) + tetcasti_abs(e[0][1]) + tetcasti_abs(e[0][2]) + tetcasti_abs(e[1][0]) +
           tetcasti_abs(e[1][1]) + tetcasti_abs(e[1][2]) + TETCASTI_BLUR;
    doubt = size * (tetcasti_abs(w[0]) + tetcasti_abs(w[1]) + tetcasti_abs(w[2])) +
            (m->parallel ? 0.0 : tetcasti_abs(n[0]) + tetcasti_abs(n[1]) + tetcasti_abs(n[2]));
    if (side > doubt * TETCASTI_BLUR) return 0; /* from behind, even with every vertex moved by as much as they may */
    nearest = (double)INFINITY;
    farthest = -(double)INFINITY;
    for (i = 0; i < 3; i++) {
        double z = p[i][0] * m->forward[0] + p[i][1] * m->forward[1] + p[i][2] * m->forward[2], inv;
        double r = p[i][0] * m->right[0] + p[i][1] * m->right[1] + p[i][2] * m->right[2];
        double u = p[i][0] * m->up[0] + p[i][1] * m->up[1] + p[i][2] * m->up[2];
        nearest = tetcasti_min(nearest, z);
        farthest = tetcasti_max(farthest, z);
        inv = m->parallel ? 1.0 : 1.0 / z;
        r = m->center_x + r * inv;
        u = m->center_y - u * inv;
        if (i == 0 || r < x[0]) x[0] = r;
        if (i == 0 || r > x[1]) x[1] = r;
        if (i == 0 || u < y[0]) y[0] = u;
        if (i == 0 || u > y[1]) y[1] = u;
    }
    if (!m->parallel && farthest < -2.0 * (double)TETCASTI_MARGIN) return 0; /* behind the eye */
    rect[0] = rect[1] = 0;
    rect[2] = m->width;
    rect[3] = m->height;
    if (!m->parallel && !(nearest > 2.0 * (double)TETCASTI_MARGIN)) return 1; /* reaches to the eye's plane */
    margin = sqrt(m->right[0] * m->right[0] + m->right[1] * m->right[1] + m->right[2] * m->right[2]) *
             (double)TETCASTI_MARGIN * (m->parallel ? 1.0 : 1.0 / nearest) + 0.5;
    x[0] -= margin;
    y[0] -= margin;
    x[1] += margin;
    y[1] += margin;
    if (!(x[1] > 0.0 && y[1] > 0.0 && x[0] < (double)m->width && y[0] < (double)m->height)) return 0;
    if (x[0] > 0.0) rect[0] = (uint32_t)x[0];
    if (y[0] > 0.0) rect[1] = (uint32_t)y[0];
    if (x[1] < (double)m->width) rect[2] = (uint32_t)x[1] + 1;
    if (y[1] < (double)m->height) rect[3] = (uint32_t)y[1] + 1;
    if (rect[2] > m->width) rect[2] = m->width;
    if (rect[3] > m->height) rect[3] = m->height;
    return 1;
}

/* Which of the faces first .. first + count - 1 can a ray of the beam enter? A mask with nothing missing. */
typedef uint32_t tetcasti_faces_fn(const tetcasti_scene *scene, const tetcasti_beam *beam, uint32_t first,
                                   uint32_t count);
static uint32_t tetcasti_faces_all(const tetcasti_scene *scene, const tetcasti_beam *beam, uint32_t first,
                                   uint32_t count) {
    (void)scene;
    (void)beam;
    (void)first;
    return (1u << count) - 1u;
}

typedef void tetcasti_rect_fn(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t group, uint32_t face,
                              const uint32_t rect[4]);

#define TETCASTI_RECT_BODY \
    const uint32_t *v = scene->hull->face[face].v; \
    uint32_t x, y; \
    float at; \
    for (y = rect[1]; y < rect[3]; y++) \
        for (x = rect[0]; x < rect[2]; x++) { \
            uint32_t i = y * TETCASTI_TILE + x; \
            tetcasti_ray r; \
            if (b->group[i] != group) continue; \
            r = tetcasti_batch_ray(b, i); \
            b->hull_tests++; \
            if (tetcasti_face_hit(&r, scene->vertex, v, &at)) tetcasti_batch_hit(b, i, at, face); \
        }
TETCASTI_TARGET_FMA static void tetcasti_rect_fma(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t group,
                                                  uint32_t face, const uint32_t rect[4]) { TETCASTI_RECT_BODY }
static void tetcasti_rect_plain(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t group, uint32_t face,
                                const uint32_t rect[4]) { TETCASTI_RECT_BODY }

/* Visit the groups of faces [from, to) that the beam can meet. Boxes to look at are on a stack: level << 32 |
   number. */
#define TETCASTI_HULL_VISIT(hull, beam, FACES) { \
    uint64_t todo[96]; \
    uint32_t top = 0; \
    if ((hull)->level_count != 0) todo[top++] = (uint64_t)((hull)->level_count - 1) << 32; \
    while (top != 0) { \
        uint32_t level = (uint32_t)(todo[--top] >> 32), k = (uint32_t)todo[top], from = 8 * k, to, j; \
        const tetcasti_box *box = &(hull)->box[(hull)->level_start[level] + k]; \
        if (!tetcasti_beam_meets(beam, box->lo, box->hi)) continue; \
        to = level != 0 ? (hull)->level_size[level - 1] : (hull)->face_count; \
        if (to - from > 8) to = from + 8; \
        if (level == 0) { FACES } \
        else for (j = from; j < to; j++) todo[top++] = (uint64_t)(level - 1) << 32 | j; \
    } \
}

/* Hits of all rays of a tile. */
static void tetcasti_tile_hits(const tetcasti_scene *scene, tetcasti_batch *b, const tetcasti_pixels *m,
                               tetcasti_rect_fn *rect_fn, tetcasti_faces_fn *faces_fn) {
    tetcasti_beam beam[6];
    tetcasti_ray r;
    uint32_t group, i, rect[4], any = 0;
    memset(beam, 0, sizeof beam);
    if (m->group != TETCASTI_NO_RAY) { /* all slopes and origins lie between those of the corners */
        for (i = 0; i < 4; i++) {
            r = tetcasti_batch_ray(b, (i >> 1) * (m->height - 1) * TETCASTI_TILE + (i & 1u) * (m->width - 1));
            r.group = m->group;
            tetcasti_beam_add(&beam[r.group], &r, i == 0);
        }
        any = 1u << m->group;
    } else {
        for (i = 0; i < b->count; i++) {
            if (b->group[i] == TETCASTI_NO_RAY) continue;
            r = tetcasti_batch_ray(b, i);
            tetcasti_beam_add(&beam[r.group], &r, (any >> r.group & 1u) == 0);
            any |= 1u << r.group;
        }
    }
    for (group = 0; group < 6; group++) {
        if ((any >> group & 1u) == 0) continue;
        TETCASTI_HULL_VISIT(scene->hull, &beam[group],
            uint32_t todo_faces = faces_fn(scene, &beam[group], from, to - from);
            for (; todo_faces != 0; todo_faces &= todo_faces - 1) {
                j = from + tetcasti_ctz64(todo_faces);
                if (tetcasti_face_pixels(m, scene->vertex, scene->hull->face[j].v, rect))
                    rect_fn(scene, b, group, j, rect);
            })
    }
}

/* Hits of the whole line of ray i, also behind its origin. */
#define TETCASTI_LINE_BODY \
    tetcasti_ray r = tetcasti_batch_ray(b, i); \
    tetcasti_beam beam; \
    float at; \
    if (r.group == TETCASTI_NO_RAY) return; \
    memset(&beam, 0, sizeof beam); \
    tetcasti_beam_add(&beam, &r, 1); \
    TETCASTI_HULL_VISIT(scene->hull, &beam, \
        for (j = from; j < to; j++) { \
            b->hull_tests++; \
            if (tetcasti_face_hit(&r, scene->vertex, scene->hull->face[j].v, &at)) tetcasti_batch_hit(b, i, at, j); \
        })
TETCASTI_TARGET_FMA static void tetcasti_line_fma(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t i) {
    TETCASTI_LINE_BODY
}
static void tetcasti_line_plain(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t i) { TETCASTI_LINE_BODY }
static void tetcasti_line_hits(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t i) {
    if (scene->fma) tetcasti_line_fma(scene, b, i);
    else tetcasti_line_plain(scene, b, i);
}
/* ---------------------------------------------------------------------------
   walk_avx2: eight rays side by side, each in its own cell.                     // >>walk_avx2
   The operations of tetcasti_walk_step and tetcasti_batch_walk_ray in the same order, so the bits are the same. A lane
   whose ray is finished takes the next one of the batch; rays of a picture wait for their neighbours
   (tetcasti_lanes_next). Two packets take turns: while one waits for its cells and vertices the other one computes.
   Cells and vertices are loaded as 16 bytes each and transposed, which is faster than
   gathering them (measured on Zen 4: 2x).
   --------------------------------------------------------------------------- */
#if TETCASTI_AVX2

#if defined(_MSC_VER) && !defined(__clang__)
#  define TETCASTI_TARGET_WALK
#else
#  define TETCASTI_TARGET_WALK __attribute__((target("avx2,fma,bmi,bmi2,lzcnt,popcnt")))
#endif

#define TETCASTI_PACKETS 2

typedef struct tetcasti_points8 { __m256 x, y, z, s; __m256i id; } tetcasti_points8;

/* One row of 8 for everything that a walk has. Rows are moved between structs by their number: first those of the walk,
   then those of the ray. */
typedef struct tetcasti_lanes {
    float point[3][4][8];       /* a, b, c: x, y, z, s */
    uint32_t id[3][8];
    float weight[3][8];         /* ab, bc, ca */
    float at_face[8], s_face[8];
    uint32_t cell[8], prev[8];
    float cursor[8], last[8], offset[8], ox[8], oy[8], oz[8], sx[8], sy[8], iz[8];
    uint32_t ray[8], hit[8];    /* the next one */
    float length[8];
    uint32_t steps[8];
    uint32_t turn[4][8];        /* row k: for lanes k and k + 4, where x, y, z, s of the ray are in a vertex */
    tetcasti_ray_sum8 sum;
    uint32_t alive[8];          /* all ones where the lane has a ray; others stay in cell 0 and at vertex 0 */
    uint32_t live;              /* the same as bits */
    uint32_t dated;             /* lanes whose ray has a depth already */
} tetcasti_lanes;
#define TETCASTI_ROWS_WALK 22u
#define TETCASTI_ROWS_RAY 33u

/* Four rows of 8: lane i has the four words at base + stride * at[i]. turn: see tetcasti_lanes, or NULL. */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_load8x4(const void *base, const size_t stride, const uint32_t at[8],
                                                           const uint32_t (*turn)[8], __m256 out[4]) {
    const float *p = (const float *)base;
    __m256 r0, r1, r2, r3, t0, t1, t2, t3;
#define TETCASTI_PAIR(i) \
    _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p + stride * at[i])), \
                         _mm_loadu_ps(p + stride * at[i + 4]), 1)
    r0 = TETCASTI_PAIR(0);
    r1 = TETCASTI_PAIR(1);
    r2 = TETCASTI_PAIR(2);
    r3 = TETCASTI_PAIR(3);
#undef TETCASTI_PAIR
    if (turn != NULL) {
        r0 = _mm256_permutevar_ps(r0, _mm256_loadu_si256((const __m256i *)(const void *)turn[0]));
        r1 = _mm256_permutevar_ps(r1, _mm256_loadu_si256((const __m256i *)(const void *)turn[1]));
        r2 = _mm256_permutevar_ps(r2, _mm256_loadu_si256((const __m256i *)(const void *)turn[2]));
        r3 = _mm256_permutevar_ps(r3, _mm256_loadu_si256((const __m256i *)(const void *)turn[3]));
    }
    t0 = _mm256_unpacklo_ps(r0, r1);
    t1 = _mm256_unpackhi_ps(r0, r1);
    t2 = _mm256_unpacklo_ps(r2, r3);
    t3 = _mm256_unpackhi_ps(r2, r3);
    out[0] = _mm256_shuffle_ps(t0, t2, 0x44);
    out[1] = _mm256_shuffle_ps(t0, t2, 0xee);
    out[2] = _mm256_shuffle_ps(t1, t3, 0x44);
    out[3] = _mm256_shuffle_ps(t1, t3, 0xee);
}

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256 tetcasti_det8(const tetcasti_points8 *a, const tetcasti_points8 *b) {
    __m256 w = _mm256_mul_ps(a->y, b->x), e = _mm256_fnmadd_ps(a->y, b->x, w), f = _mm256_fmsub_ps(a->x, b->y, w);
    return _mm256_add_ps(f, e);
}

/* A number whose sign bit is that of the determinant v after the rule for ties. */
TETCASTI_TARGET_WALK TETCASTI_INLINE __m256 tetcasti_tie8(__m256 v, const tetcasti_points8 *a,
                                                          const tetcasti_points8 *b) {
    const __m256 minus = _mm256_set1_ps(-1.0f);
    __m256 zero = _mm256_cmp_ps(v, _mm256_setzero_ps(), _CMP_EQ_OQ), sign;
    sign = _mm256_castsi256_ps(_mm256_cmpgt_epi32(b->id, a->id));                       /* positive when a.id < b.id */
    sign = _mm256_blendv_ps(sign, _mm256_cmp_ps(b->x, a->x, _CMP_GT_OQ), _mm256_cmp_ps(b->x, a->x, _CMP_NEQ_OQ));
    sign = _mm256_blendv_ps(sign, _mm256_cmp_ps(a->y, b->y, _CMP_GT_OQ), _mm256_cmp_ps(a->y, b->y, _CMP_NEQ_OQ));
    return _mm256_blendv_ps(v, _mm256_andnot_ps(sign, minus), zero);
}

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_blend8i(__m256i a, __m256i b, __m256 mask) {
    return _mm256_castps_si256(_mm256_blendv_ps(_mm256_castsi256_ps(a), _mm256_castsi256_ps(b), mask));
}

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_blend8p(tetcasti_points8 *a, const tetcasti_points8 *b,
                                                           __m256 mask) {
    a->x = _mm256_blendv_ps(a->x, b->x, mask);
    a->y = _mm256_blendv_ps(a->y, b->y, mask);
    a->z = _mm256_blendv_ps(a->z, b->z, mask);
    a->s = _mm256_blendv_ps(a->s, b->s, mask);
    a->id = tetcasti_blend8i(a->id, b->id, mask);
}

/* n[rank of v]: bit 0 of the rank is the parity of how many of p, q, r are smaller, bit 1 the majority. */
TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_pick8(__m256i v, __m256i p, __m256i q, __m256i r, __m256i n0,
                                                            __m256i n1, __m256i n2, __m256i n3) {
    __m256i c = _mm256_cmpgt_epi32(v, p), d = _mm256_cmpgt_epi32(v, q), e = _mm256_cmpgt_epi32(v, r);
    __m256i differ = _mm256_xor_si256(c, d), odd = _mm256_xor_si256(differ, e);
    __m256i most = tetcasti_blend8i(c, e, _mm256_castsi256_ps(differ));
    return tetcasti_blend8i(tetcasti_blend8i(n0, n1, _mm256_castsi256_ps(odd)),
                            tetcasti_blend8i(n2, n3, _mm256_castsi256_ps(odd)), _mm256_castsi256_ps(most));
}

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256 tetcasti_face_value8(__m256 a, __m256 b, __m256 c, __m256 ab, __m256 bc,
                                                                 __m256 ca,
                                                                 __m256 inv) {
    __m256 s = _mm256_mul_ps(_mm256_fmadd_ps(bc, a, _mm256_fmadd_ps(ca, b, _mm256_mul_ps(ab, c))), inv);
    s = _mm256_max_ps(s, _mm256_min_ps(_mm256_min_ps(a, b), c));
    return _mm256_min_ps(s, _mm256_max_ps(_mm256_max_ps(a, b), c));
}

/* ---- rays of a tile, and the faces that they enter ---- */

/* tetcasti_tile_ray for all rays, which are of one group, four at a time. */
TETCASTI_TARGET_WALK static void tetcasti_tile_rays4(const tetcasti_tile *t, tetcasti_batch *b) {
    const tetcasti_frame *f = t->frame;
    const uint8_t *axes = tetcasti_axes[t->group];
    const __m256d one = _mm256_set1_pd(1.0), snap = _mm256_set1_pd(TETCASTI_SNAP),
        slope = _mm256_set1_pd(TETCASTI_SNAP_SLOPE);
    uint32_t k = axes[2], down = t->group & 1u, x, y, a, mask, i;
    double lo = (double)t->box->lo[k], hi = (double)t->box->hi[k];
    __m256d d[3], o[3], u, v, rx, ry, sx, sy, px, py, pz, z0, length, way, offset, good;
    __m128 cursor, last;
    for (y = 0; y < t->height; y++) {
        v = _mm256_set1_pd(0.5 * (double)f->height - ((double)(t->y0 + y) + 0.5));
        for (x = 0; x < TETCASTI_TILE; x += 4) {
            double x_first = ((double)(t->x0 + x) + 0.5) - 0.5 * (double)f->width;
            float *to = b->ox + y * TETCASTI_TILE + x;
            u = _mm256_add_pd(_mm256_set1_pd(x_first), _mm256_setr_pd(0.0, 1.0, 2.0, 3.0));
            for (a = 0; a < 3; a++) {
                __m256d shift = _mm256_add_pd(_mm256_mul_pd(u, _mm256_set1_pd(f->right[a])),
                                              _mm256_mul_pd(v, _mm256_set1_pd(f->up[a])));
                o[a] = _mm256_set1_pd(t->local_eye[a]);
                d[a] = _mm256_set1_pd(f->forward[a]);
                if (f->parallel) o[a] = _mm256_add_pd(o[a], _mm256_mul_pd(shift, _mm256_set1_pd(t->scale)));
                else d[a] = _mm256_add_pd(d[a], shift);
            }
            way = _mm256_sqrt_pd(_mm256_add_pd(_mm256_add_pd(_mm256_mul_pd(d[0], d[0]), _mm256_mul_pd(d[1], d[1])),
                                               _mm256_mul_pd(d[2], d[2])));
            rx = _mm256_div_pd(d[axes[0]], d[k]);
            ry = _mm256_div_pd(d[axes[1]], d[k]);
            sx = _mm256_sub_pd(_mm256_add_pd(rx, slope), slope);
            sy = _mm256_sub_pd(_mm256_add_pd(ry, slope), slope);
            sx = _mm256_cvtps_pd(_mm256_cvtpd_ps(sx));
            sy = _mm256_cvtps_pd(_mm256_cvtpd_ps(sy));
            px = o[axes[0]];
            py = o[axes[1]];
            pz = o[k];
            length = _mm256_sqrt_pd(_mm256_add_pd(_mm256_add_pd(one, _mm256_mul_pd(sx, sx)), _mm256_mul_pd(sy, sy)));
            if (down) length = _mm256_xor_pd(length, _mm256_set1_pd(-0.0));
            z0 = _mm256_sub_pd(_mm256_set1_pd(down ? hi : lo), pz);
            z0 = down ? _mm256_andnot_pd(_mm256_cmp_pd(z0, _mm256_setzero_pd(), _CMP_GT_OQ), z0)
                      : _mm256_andnot_pd(_mm256_cmp_pd(z0, _mm256_setzero_pd(), _CMP_LT_OQ), z0);
            px = _mm256_add_pd(px, _mm256_mul_pd(rx, z0));
            py = _mm256_add_pd(py, _mm256_mul_pd(ry, z0));
            good = down ? _mm256_cmp_pd(pz, _mm256_set1_pd(lo - TETCASTI_BLUR), _CMP_NLT_UQ)
                        : _mm256_cmp_pd(pz, _mm256_set1_pd(hi + TETCASTI_BLUR), _CMP_NGT_UQ);
            pz = _mm256_add_pd(pz, z0);
#define TETCASTI_INSIDE(p, axis) \
            good = _mm256_and_pd(good, \
                    _mm256_cmp_pd(p, _mm256_set1_pd((double)t->box->lo[axis] - (hi - lo) - TETCASTI_BLUR), \
                                  _CMP_GT_OQ)); \
            good = _mm256_and_pd(good, \
                    _mm256_cmp_pd(p, _mm256_set1_pd((double)t->box->hi[axis] + (hi - lo) + TETCASTI_BLUR), \
                                  _CMP_LT_OQ))
            TETCASTI_INSIDE(px, axes[0]);
            TETCASTI_INSIDE(py, axes[1]);
#undef TETCASTI_INSIDE
            offset = _mm256_sqrt_pd(_mm256_add_pd(_mm256_add_pd(one, _mm256_mul_pd(rx, rx)), _mm256_mul_pd(ry, ry)));
            offset = _mm256_mul_pd(_mm256_andnot_pd(_mm256_set1_pd(-0.0), z0), offset);
            i = y * TETCASTI_TILE + x;
            _mm_storeu_ps(to, _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_add_pd(px, snap), snap)));
            _mm_storeu_ps(b->oy + i, _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_add_pd(py, snap), snap)));
            _mm_storeu_ps(b->oz + i, _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_add_pd(pz, snap), snap)));
            _mm_storeu_ps(b->sx + i, _mm256_cvtpd_ps(sx));
            _mm_storeu_ps(b->sy + i, _mm256_cvtpd_ps(sy));
            _mm_storeu_ps(b->iz + i, _mm256_cvtpd_ps(length));
            _mm_storeu_ps(b->offset + i, _mm256_cvtpd_ps(offset));
            cursor = _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_mul_pd(_mm256_set1_pd(t->near_end), way), offset));
            last = _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_mul_pd(_mm256_set1_pd(t->far_end), way), offset));
            _mm_storeu_ps(b->cursor + i, cursor);
            _mm_storeu_ps(b->last + i, last);
            mask = (uint32_t)_mm256_movemask_pd(good) & (uint32_t)_mm_movemask_ps(_mm_cmpgt_ps(last, cursor));
            for (a = 0; a < 4; a++)
                b->group[i + a] = (uint8_t)((mask >> a & 1u) != 0 && x + a < t->width ? t->group : TETCASTI_NO_RAY);
        }
    }
}

/* tetcasti_faces_fn for up to eight faces: seen from the front by a ray, and with the point (0, 0) between their
   sides. */
TETCASTI_TARGET_WALK static uint32_t tetcasti_faces8(const tetcasti_scene *scene, const tetcasti_beam *m,
                                                     uint32_t first, uint32_t count) {
    const tetcasti_face *face = scene->hull->face + first;
    const uint8_t *axes = tetcasti_axes[m->group];
    const __m256 margin = _mm256_set1_ps(TETCASTI_MARGIN), sign = _mm256_set1_ps(-0.0f);
    __m256 p[3][3], x_lo, x_hi, y_lo, y_hi, e[2][3], c[3], most, size, out;
    uint32_t v[3][8], turn[4][8], i, k;
    for (i = 0; i < 8; i++) {
        const tetcasti_face *f = face + (i < count ? i : count - 1);
        for (k = 0; k < 3; k++) v[k][i] = f->v[k];
        for (k = 0; k < 4; k++) turn[i & 3][(i & 4) + k] = k < 3 ? axes[k] : 3;
    }
    x_lo = y_lo = _mm256_set1_ps(TETCASTI_INF);
    x_hi = y_hi = _mm256_set1_ps(-TETCASTI_INF);
    for (k = 0; k < 3; k++) {
        __m256 row[4], z[2], q[4];
        tetcasti_load8x4(scene->vertex, 4, v[k], (const uint32_t (*)[8])turn, row);
        p[k][0] = row[0];
        p[k][1] = row[1];
        p[k][2] = row[2];
        z[0] = _mm256_sub_ps(row[2], _mm256_set1_ps(m->o_hi[2]));
        z[1] = _mm256_sub_ps(row[2], _mm256_set1_ps(m->o_lo[2]));
#define TETCASTI_RANGE(a, lo, hi) \
        q[0] = _mm256_mul_ps(z[0], _mm256_set1_ps(m->s_lo[a])); \
        q[1] = _mm256_mul_ps(z[1], _mm256_set1_ps(m->s_lo[a])); \
        q[2] = _mm256_mul_ps(z[0], _mm256_set1_ps(m->s_hi[a])); \
        q[3] = _mm256_mul_ps(z[1], _mm256_set1_ps(m->s_hi[a])); \
        lo = _mm256_min_ps(lo, _mm256_sub_ps(_mm256_sub_ps(row[a], _mm256_set1_ps(m->o_hi[a])), \
                           _mm256_max_ps(_mm256_max_ps(q[0], q[1]), _mm256_max_ps(q[2], q[3])))); \
        hi = _mm256_max_ps(hi, _mm256_sub_ps(_mm256_sub_ps(row[a], _mm256_set1_ps(m->o_lo[a])), \
                           _mm256_min_ps(_mm256_min_ps(q[0], q[1]), _mm256_min_ps(q[2], q[3]))))
        TETCASTI_RANGE(0, x_lo, x_hi);
        TETCASTI_RANGE(1, y_lo, y_hi);
#undef TETCASTI_RANGE
    }
    out = _mm256_or_ps(_mm256_or_ps(_mm256_cmp_ps(x_lo, margin, _CMP_GT_OQ), _mm256_cmp_ps(y_lo, margin, _CMP_GT_OQ)),
                       _mm256_or_ps(_mm256_cmp_ps(x_hi, _mm256_xor_ps(margin, sign), _CMP_LT_OQ),
                                    _mm256_cmp_ps(y_hi, _mm256_xor_ps(margin, sign), _CMP_LT_OQ)));
    /* its area as a ray sees it is n . (sx, sy, 1) with the normal n: the largest over all slopes */
    size = _mm256_setzero_ps();
    for (k = 0; k < 3; k++) {
        e[0][k] = _mm256_sub_ps(p[1][k], p[0][k]);
        e[1][k] = _mm256_sub_ps(p[2][k], p[0][k]);
        size = _mm256_add_ps(size, _mm256_add_ps(_mm256_andnot_ps(sign, e[0][k]), _mm256_andnot_ps(sign, e[1][k])));
    }
    for (k = 0; k < 3; k++) {
        uint32_t a = (k + 1) % 3, b = (k + 2) % 3;
        c[k] = _mm256_sub_ps(_mm256_mul_ps(e[0][a], e[1][b]), _mm256_mul_ps(e[0][b], e[1][a]));
    }
    most = c[2];
    for (k = 0; k < 2; k++)
        most = _mm256_add_ps(most, _mm256_max_ps(_mm256_mul_ps(c[k], _mm256_set1_ps(m->s_lo[k])),
                                                 _mm256_mul_ps(c[k], _mm256_set1_ps(m->s_hi[k]))));
    /* every vertex may be off by BLUR, and the sum by its rounding */
    size = _mm256_mul_ps(_mm256_add_ps(size, _mm256_set1_ps((float)TETCASTI_BLUR)),
                         _mm256_add_ps(_mm256_set1_ps((float)(4.0 * TETCASTI_BLUR)),
                                       _mm256_mul_ps(size, _mm256_set1_ps(1e-6f))));
    out = _mm256_or_ps(out, _mm256_cmp_ps(_mm256_add_ps(most, size), _mm256_setzero_ps(), _CMP_LT_OQ));
    return ~(uint32_t)_mm256_movemask_ps(out) & ((1u << count) - 1u);
}

/* tetcasti_face_hit for the pixels of a rectangle, eight of a row at a time. */
TETCASTI_TARGET_WALK static void tetcasti_rect8(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t group,
                                                uint32_t face,
                                                const uint32_t rect[4]) {
    const uint32_t *v = scene->hull->face[face].v;
    const uint8_t *axes = tetcasti_axes[group];
    float corner[3][3], at8[8];
    uint32_t i, k, x, y, mask;
    for (k = 0; k < 3; k++) {
        const tetcasti_vertex *p = &scene->vertex[v[k]];
        float q[3];
        q[0] = p->x;
        q[1] = p->y;
        q[2] = p->z;
        for (i = 0; i < 3; i++) corner[k][i] = q[axes[i]];
    }
    for (y = rect[1]; y < rect[3]; y++)
        for (x = rect[0] & ~7u; x < rect[2]; x += 8) {
            tetcasti_points8 p[3];
            __m256 ab, bc, ca, out, inv, at, dz;
            i = y * TETCASTI_TILE + x;
            for (mask = 0, k = 0; k < 8; k++) mask |= (uint32_t)(b->group[i + k] == group) << k;
            if (mask == 0) continue;
            b->hull_tests += tetcasti_popcount64(mask);
            for (k = 0; k < 3; k++) {
                dz = _mm256_sub_ps(_mm256_set1_ps(corner[k][2]), _mm256_loadu_ps(b->oz + i));
                p[k].x = _mm256_fnmadd_ps(_mm256_loadu_ps(b->sx + i), dz,
                                          _mm256_sub_ps(_mm256_set1_ps(corner[k][0]), _mm256_loadu_ps(b->ox + i)));
                p[k].y = _mm256_fnmadd_ps(_mm256_loadu_ps(b->sy + i), dz,
                                          _mm256_sub_ps(_mm256_set1_ps(corner[k][1]), _mm256_loadu_ps(b->oy + i)));
                p[k].z = _mm256_mul_ps(dz, _mm256_loadu_ps(b->iz + i));
                p[k].id = _mm256_set1_epi32((int)v[k]);
            }
            ab = tetcasti_det8(&p[0], &p[1]);
            bc = tetcasti_det8(&p[1], &p[2]);
            ca = tetcasti_det8(&p[2], &p[0]);
            out = _mm256_or_ps(_mm256_or_ps(ab, bc), ca);
            if (TETCASTI_UNLIKELY(_mm256_movemask_ps(_mm256_or_ps(_mm256_or_ps(_mm256_cmp_ps(ab, _mm256_setzero_ps(),
                                                                                             _CMP_EQ_OQ),
                    _mm256_cmp_ps(bc, _mm256_setzero_ps(), _CMP_EQ_OQ)),
                        _mm256_cmp_ps(ca, _mm256_setzero_ps(), _CMP_EQ_OQ))) != 0))
                out = _mm256_or_ps(_mm256_or_ps(tetcasti_tie8(ab, &p[0], &p[1]), tetcasti_tie8(bc, &p[1], &p[2])),
                                   tetcasti_tie8(ca, &p[2], &p[0]));
            mask &= ~(uint32_t)_mm256_movemask_ps(out);
            if (mask == 0) continue;
            inv = _mm256_div_ps(_mm256_set1_ps(1.0f), _mm256_add_ps(_mm256_add_ps(ab, bc), ca));
            at = _mm256_mul_ps(_mm256_fmadd_ps(bc, p[0].z, _mm256_fmadd_ps(ca, p[1].z, _mm256_mul_ps(ab, p[2].z))),
                               inv);
            _mm256_storeu_ps(at8, at);
            for (; mask != 0; mask &= mask - 1) {
                k = tetcasti_ctz64(mask);
                tetcasti_batch_hit(b, i + k, at8[k], face);
            }
        }
}

/* ---- lanes and rays ---- */

static void tetcasti_lane_load(const tetcasti_ray_sum8 *sum, uint32_t lane, tetcasti_ray_sum *one);
static void tetcasti_lane_store(tetcasti_ray_sum8 *sum, uint32_t lane, const tetcasti_ray_sum *one);

/* Enter the mesh through the faces id[0..2] of all lanes; rays, cells and prev are there. */
TETCASTI_TARGET_WALK static void tetcasti_walk_begin8(const tetcasti_scene *scene, tetcasti_lanes *l) {
    tetcasti_points8 p[3];
    __m256 row[4], ab, bc, ca, inv, dz;
    uint32_t k;
    for (k = 0; k < 3; k++) {
        tetcasti_load8x4(scene->vertex, 4, l->id[k], (const uint32_t (*)[8])l->turn, row);
        dz = _mm256_sub_ps(row[2], _mm256_loadu_ps(l->oz));
        p[k].x = _mm256_fnmadd_ps(_mm256_loadu_ps(l->sx), dz, _mm256_sub_ps(row[0], _mm256_loadu_ps(l->ox)));
        p[k].y = _mm256_fnmadd_ps(_mm256_loadu_ps(l->sy), dz, _mm256_sub_ps(row[1], _mm256_loadu_ps(l->oy)));
        p[k].z = _mm256_mul_ps(dz, _mm256_loadu_ps(l->iz));
        p[k].s = row[3];
        _mm256_storeu_ps(l->point[k][0], p[k].x);
        _mm256_storeu_ps(l->point[k][1], p[k].y);
        _mm256_storeu_ps(l->point[k][2], p[k].z);
        _mm256_storeu_ps(l->point[k][3], p[k].s);
    }
    ab = tetcasti_det8(&p[0], &p[1]);
    bc = tetcasti_det8(&p[1], &p[2]);
    ca = tetcasti_det8(&p[2], &p[0]);
    inv = _mm256_div_ps(_mm256_set1_ps(1.0f), _mm256_add_ps(_mm256_add_ps(ab, bc), ca));
    _mm256_storeu_ps(l->weight[0], ab);
    _mm256_storeu_ps(l->weight[1], bc);
    _mm256_storeu_ps(l->weight[2], ca);
    _mm256_storeu_ps(l->at_face,
            _mm256_mul_ps(_mm256_fmadd_ps(bc, p[0].z, _mm256_fmadd_ps(ca, p[1].z, _mm256_mul_ps(ab, p[2].z))), inv));
    _mm256_storeu_ps(l->s_face, tetcasti_face_value8(p[0].s, p[1].s, p[2].s, ab, bc, ca, inv));
}

/* Rays that wait for a lane: their walks have begun, eight at a time. */
typedef struct tetcasti_ready {
    tetcasti_lanes l;
    uint32_t used, count;       /* lanes of l that are taken, that there are */
    uint32_t next;              /* in the batch's queue */
    tetcasti_lanes again;       /* walks that begin while their rays have lanes */
} tetcasti_ready;

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_lane_turn(const tetcasti_batch *b, tetcasti_lanes *l, uint32_t i,
                                                             uint32_t ray) {
    const uint8_t *axes = tetcasti_axes[b->group[ray]];
    uint32_t *turn = &l->turn[i & 3][i & 4];
    turn[0] = axes[0];
    turn[1] = axes[1];
    turn[2] = axes[2];
    turn[3] = 3;
}

/* Face of hit h and its ray into lane i; the rest is for tetcasti_walk_begin8. */
TETCASTI_TARGET_WALK static void tetcasti_lane_put(const tetcasti_scene *scene, const tetcasti_batch *b,
                                                   tetcasti_lanes *l, uint32_t i,
                                                   uint32_t ray, const tetcasti_hit *h) {
    tetcasti_start start = tetcasti_hit_start(scene, b, h);
    l->id[0][i] = start.v[0];
    l->id[1][i] = start.v[1];
    l->id[2][i] = start.v[2];
    l->cell[i] = start.cell;
    l->prev[i] = start.prev;
    l->ox[i] = b->ox[ray];
    l->oy[i] = b->oy[ray];
    l->oz[i] = b->oz[ray];
    l->sx[i] = b->sx[ray];
    l->sy[i] = b->sy[ray];
    l->iz[i] = b->iz[ray];
    l->ray[i] = ray;
    tetcasti_lane_turn(b, l, i, ray);
}

/* Rows [0, rows) of `from`, of lane place[i] for lane i, into the lanes of `to` whose mask is set. */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_rows_move(tetcasti_lanes *to, const tetcasti_lanes *from,
                                                             uint32_t rows,
                                                             __m256i place, __m256 mask) {
    float *p = &to->point[0][0][0];
    const float *q = &from->point[0][0][0];
    uint32_t k;
    for (k = 0; k < rows; k++) {
        __m256 x = _mm256_permutevar8x32_ps(_mm256_loadu_ps(q + 8 * k), place);
        _mm256_storeu_ps(p + 8 * k, _mm256_blendv_ps(_mm256_loadu_ps(p + 8 * k), x, mask));
    }
}

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256 tetcasti_mask8(uint32_t lanes) {
    const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    return _mm256_castsi256_ps(_mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32((int)lanes), bit), bit));
}

/* Begin the next walks of the rays of `lanes`; returns those that had none within reach. Only for hulls that are not
   convex. */
TETCASTI_TARGET_WALK static uint32_t tetcasti_lanes_again(const tetcasti_scene *scene, tetcasti_batch *b,
                                                          tetcasti_lanes *l,
                                                          uint32_t lanes, tetcasti_lanes *again) {
    uint32_t todo, i, none = 0;
    for (todo = lanes; todo != 0; todo &= todo - 1) {
        const tetcasti_hit *h;
        i = tetcasti_ctz64(todo);
        h = b->sorted + l->hit[i];
        if (l->hit[i] >= b->hit_start[l->ray[i] + 1] || !(h->at < l->last[i])) {
            none |= 1u << i;
            continue;
        }
        l->hit[i]++;
        tetcasti_lane_put(scene, b, again, i, l->ray[i], h);
    }
    lanes &= ~none;
    if (lanes == 0) return none;
    tetcasti_walk_begin8(scene, again);
    tetcasti_rows_move(l, again, TETCASTI_ROWS_WALK, _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7), tetcasti_mask8(lanes));
    for (todo = lanes; todo != 0; todo &= todo - 1) {
        i = tetcasti_ctz64(todo);
        b->walks[l->ray[i]]++;
        if (!(l->at_face[i] > l->cursor[i])) continue;
        l->cursor[i] = l->at_face[i];
        if (scene->optics != NULL) tetcasti_lane_gap(scene->optics, &l->sum, i);
    }
    return none;
}

TETCASTI_TARGET_WALK static void tetcasti_ready_fill(const tetcasti_scene *scene, tetcasti_batch *b,
                                                     tetcasti_ready *w) {
    uint32_t i;
    w->used = w->count = 0;
    while (w->count < 8 && w->next < TETCASTI_BATCH) {
        uint32_t ray = b->queue[w->next++], first;
        if (ray >= b->count) continue;
        first = b->hit_start[ray];
        if (first == b->hit_start[ray + 1] || !(b->sorted[first].at < b->last[ray])) continue;
        i = w->count++;
        tetcasti_lane_put(scene, b, &w->l, i, ray, &b->sorted[first]);
        w->l.hit[i] = first + 1;
        w->l.cursor[i] = b->cursor[ray];
        w->l.last[i] = b->last[ray];
        w->l.offset[i] = b->offset[ray];
        b->walks[ray]++;
    }
    if (w->count == 0) return;
    tetcasti_walk_begin8(scene, &w->l); /* unused lanes: what was there before */
    _mm256_storeu_ps(w->l.cursor, _mm256_max_ps(_mm256_loadu_ps(w->l.at_face), _mm256_loadu_ps(w->l.cursor)));
}

TETCASTI_INLINE void tetcasti_lanes_die(tetcasti_lanes *l, uint32_t lanes) {
    uint32_t i;
    l->live &= ~lanes;
    for (i = 0; i < 8; i++)
        if (lanes >> i & 1u) l->alive[i] = l->cell[i] = 0;
}

/* Write the rays of `lanes` back and give the lanes those that wait; lanes are dead when there are none. Rays of a
   block of pixels stay together: lanes wait until all of them are through. That leaves 4 % of the places empty, but
   neighbours meet the same cells, and cross knots of the transfer function at the same time: frames are 10 to 30 %
   faster. */
TETCASTI_TARGET_WALK static void tetcasti_lanes_next(const tetcasti_scene *scene, tetcasti_batch *b, tetcasti_lanes *l,
                                                     uint32_t lanes,
                                                     tetcasti_ready *w) {
    uint32_t todo, i, taken, place[8];
    l->dated &= ~lanes;
    for (todo = lanes & l->live; todo != 0; todo &= todo - 1) {
        uint32_t ray;
        i = tetcasti_ctz64(todo);
        ray = l->ray[i];
        b->length[ray] = l->length[i];
        b->steps[ray] = l->steps[i];
        if (scene->optics != NULL) tetcasti_lane_load(&l->sum, i, &b->sum[ray]);
    }
    if (b->together) {
        if ((l->live & ~lanes) != 0) {
            tetcasti_lanes_die(l, lanes);
            return;
        }
        lanes = 255u;
    }
    while (lanes != 0) {
        __m256 mask;
        if (w->used == w->count) tetcasti_ready_fill(scene, b, w);
        if (w->used == w->count) {
            tetcasti_lanes_die(l, lanes);
            return;
        }
        for (taken = 0, todo = lanes; todo != 0 && w->used < w->count; todo &= todo - 1) {
            i = tetcasti_ctz64(todo);
            place[i] = w->used++;
            taken |= 1u << i;
            if (memcmp(&l->turn[i & 3][i & 4], &w->l.turn[place[i] & 3][place[i] & 4], 16) != 0)
                tetcasti_lane_turn(b, l, i, w->l.ray[place[i]]);
        }
        mask = tetcasti_mask8(taken);
        for (i = 0; i < 8; i++) place[i] = (taken >> i & 1u) ? place[i] : 0;
        tetcasti_rows_move(l, &w->l, TETCASTI_ROWS_RAY, _mm256_loadu_si256((const __m256i *)(const void *)place), mask);
        _mm256_storeu_ps(l->length, _mm256_andnot_ps(mask, _mm256_loadu_ps(l->length)));
        _mm256_storeu_si256((__m256i *)(void *)l->steps,
                            _mm256_andnot_si256(_mm256_castps_si256(mask),
                                                _mm256_loadu_si256((const __m256i *)(const void *)l->steps)));
        _mm256_storeu_si256((__m256i *)(void *)l->alive,
                            _mm256_or_si256(_mm256_castps_si256(mask),
                                            _mm256_loadu_si256((const __m256i *)(const void *)l->alive)));
        for (i = 0; i < 3; i++) _mm256_storeu_ps(l->sum.c[i], _mm256_andnot_ps(mask, _mm256_loadu_ps(l->sum.c[i])));
        for (i = 0; i < TETCASTI_CARRY; i++)
            _mm256_storeu_ps(l->sum.carry[i], _mm256_andnot_ps(mask, _mm256_loadu_ps(l->sum.carry[i])));
        _mm256_storeu_ps(l->sum.t, _mm256_blendv_ps(_mm256_loadu_ps(l->sum.t), _mm256_set1_ps(scene->begin_t), mask));
        l->live |= taken;
        lanes &= ~taken;
    }
}

/* ---- one step of all lanes ---- */

/* What a step leaves for those who look at the way through the cells. */
typedef struct tetcasti_lanes_before {
    /* face of the way in, the cell, the vertex not in the face of the way out */
    uint32_t id[3][8], cell[8], dropped[8];
    float weight[3][8], at_face[8], cursor[8];  /* at the face of the way in */
} tetcasti_lanes_before;

/* Tet8 records as rows of 32-bit numbers x, n0, n1, n2; all ones where it is an escape and the rows are of Tet16. */
TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_load_tet8(const tetcasti_cells *cells, const uint32_t at[8],
                                                                __m256i n[4]) {
    const tetcasti_tet8 *p = (const tetcasti_tet8 *)cells->data;
    __m256i r0, r1, r2, r3, t0, t1, t2, t3, escape;
#define TETCASTI_PAIR(i) _mm256_cvtepu16_epi32(_mm_unpacklo_epi64( \
        _mm_loadl_epi64((const __m128i *)(const void *)(p + at[i])), \
            _mm_loadl_epi64((const __m128i *)(const void *)(p + at[i + 4]))))
    r0 = TETCASTI_PAIR(0);
    r1 = TETCASTI_PAIR(1);
    r2 = TETCASTI_PAIR(2);
    r3 = TETCASTI_PAIR(3);
#undef TETCASTI_PAIR
    t0 = _mm256_unpacklo_epi32(r0, r1);
    t1 = _mm256_unpackhi_epi32(r0, r1);
    t2 = _mm256_unpacklo_epi32(r2, r3);
    t3 = _mm256_unpackhi_epi32(r2, r3);
    n[0] = _mm256_unpacklo_epi64(t0, t2);
    n[1] = _mm256_unpackhi_epi64(t0, t2);
    n[2] = _mm256_unpacklo_epi64(t1, t3);
    n[3] = _mm256_unpackhi_epi64(t1, t3);
    escape = _mm256_cmpeq_epi32(n[1], _mm256_setzero_si256());
    if (_mm256_movemask_ps(_mm256_castsi256_ps(escape)) != 0) { /* other lanes load the first record */
        __m256i place = _mm256_and_si256(escape, _mm256_or_si256(n[2], _mm256_slli_epi32(n[3], 16)));
        uint32_t at_side[8], k;
        __m256 row[4];
        _mm256_storeu_si256((__m256i *)(void *)at_side, place);
        tetcasti_load8x4(cells->side, 4, at_side, NULL, row);
        for (k = 0; k < 4; k++)
            n[k] = tetcasti_blend8i(n[k], _mm256_castps_si256(row[k]), _mm256_castsi256_ps(escape));
    }
    return escape;
}

/* tetcasti_leave for Tet8: pick is the xor of the two fields. */
TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_next_tet8(__m256i cell, __m256i prev, __m256i pick,
                                                                __m256i escape) {
    const __m256i none = _mm256_set1_epi32(-1), mark = _mm256_set1_epi32(0x8000);
    __m256i from = tetcasti_blend8i(_mm256_sub_epi32(prev, cell), mark,
                                    _mm256_castsi256_ps(_mm256_cmpeq_epi32(prev, none)));
    __m256i delta = _mm256_and_si256(_mm256_xor_si256(from, pick), _mm256_set1_epi32(0xffff));
    __m256i to = _mm256_add_epi32(cell, _mm256_sub_epi32(_mm256_xor_si256(delta, mark), mark));
    to = tetcasti_blend8i(to, none, _mm256_castsi256_ps(_mm256_cmpeq_epi32(delta, mark)));
    return tetcasti_blend8i(to, _mm256_xor_si256(prev, pick), _mm256_castsi256_ps(escape));
}

/* What the forms of cells read on the way in, and need on the way out. */
typedef struct tetcasti_node8 {
    __m256i n[4];               /* Tet16, Tet8: xor of vertices and of neighbours; else neighbours */
    __m256i v[4];               /* vertices that they lie opposite to; Tet20: none, they are in order */
    __m256i escape;             /* Tet8: all ones where n is a Tet16 record */
} tetcasti_node8;

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_row8i(const __m256 *row) { return _mm256_castps_si256(*row); }

/* The numbers of the vertices of a List160 record, which are the last words of its first four quarters. */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_load_list(const tetcasti_cells *cells, const uint32_t at[8],
                                                             __m256i v[4]) {
    const float *p = (const float *)cells->data;
    __m256 r[4], t0, t1;
    uint32_t i;
    for (i = 0; i < 4; i++) {
        const float *lo = p + 40 * (size_t)at[i], *hi = p + 40 * (size_t)at[i + 4];
#define TETCASTI_PAIR(k) \
        _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(lo + 4 * (k))), _mm_loadu_ps(hi + 4 * (k)), 1)
        t0 = _mm256_unpackhi_ps(TETCASTI_PAIR(0), TETCASTI_PAIR(1));
        t1 = _mm256_unpackhi_ps(TETCASTI_PAIR(2), TETCASTI_PAIR(3));
#undef TETCASTI_PAIR
        r[i] = _mm256_shuffle_ps(t0, t1, 0xee);
    }
    t0 = _mm256_unpacklo_ps(r[0], r[1]);
    t1 = _mm256_unpacklo_ps(r[2], r[3]);
    v[0] = _mm256_castps_si256(_mm256_shuffle_ps(t0, t1, 0x44));
    v[1] = _mm256_castps_si256(_mm256_shuffle_ps(t0, t1, 0xee));
    t0 = _mm256_unpackhi_ps(r[0], r[1]);
    t1 = _mm256_unpackhi_ps(r[2], r[3]);
    v[2] = _mm256_castps_si256(_mm256_shuffle_ps(t0, t1, 0x44));
    v[3] = _mm256_castps_si256(_mm256_shuffle_ps(t0, t1, 0xee));
}

/* tetcasti_enter: the fourth vertices of cells whose other three have xor abc. */
TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_enter8(const tetcasti_cells *cells, const uint32_t kind,
                                                             const uint32_t at[8], __m256i abc, tetcasti_node8 *node) {
    const float *p = (const float *)cells->data;
    __m256 row[4];
    __m256i x;
    uint32_t i, word[8];
    switch (kind) {
    case TETCAST_CELLS_TET8:
        node->escape = tetcasti_load_tet8(cells, at, node->n);
        for (i = 0; i < 4; i++) node->v[i] = _mm256_setzero_si256();
        return _mm256_xor_si256(node->n[0], abc);
    case TETCAST_CELLS_TET20:
        tetcasti_load8x4(p + 1, 5, at, NULL, row);
        for (i = 0; i < 4; i++) node->n[i] = tetcasti_row8i(&row[i]);
        for (i = 0; i < 4; i++) node->v[i] = _mm256_setzero_si256();
        for (i = 0; i < 8; i++) word[i] = ((const tetcasti_tet20 *)cells->data)[at[i]].x;
        return _mm256_xor_si256(_mm256_loadu_si256((const __m256i *)(const void *)word), abc);
    case TETCAST_CELLS_TET32:
        tetcasti_load8x4(p, 8, at, NULL, row);
        for (i = 0; i < 4; i++) node->v[i] = tetcasti_row8i(&row[i]); /* the last is not needed */
        x = node->v[3];
        tetcasti_load8x4(p + 4, 8, at, NULL, row);
        for (i = 0; i < 4; i++) node->n[i] = tetcasti_row8i(&row[i]);
        return _mm256_xor_si256(x, abc);
    case TETCAST_CELLS_LIST160:
        tetcasti_load_list(cells, at, node->v);
        tetcasti_load8x4(p + 32, 40, at, NULL, row);
        for (i = 0; i < 4; i++) node->n[i] = tetcasti_row8i(&row[i]);
        break;
    case TETCAST_CELLS_STRIPS: case TETCAST_CELLS_STRIPS_GENERAL: {
        /* four columns {v, n1, n2} are three times four words */
        const __m256i one = _mm256_set1_epi32(1), low = _mm256_set1_epi32((int)~TETCASTI_STRIP_FLAG);
        const __m256i cell = _mm256_loadu_si256((const __m256i *)(const void *)at);
        __m256 end[4];
        __m256i n1, n2, none;
        tetcasti_load8x4(p, 3, at, NULL, row);
        node->v[0] = tetcasti_row8i(&row[0]);
        node->v[1] = tetcasti_row8i(&row[3]);
        node->n[3] = tetcasti_row8i(&row[2]);
        tetcasti_load8x4(p + 4, 3, at, NULL, row);
        n1 = tetcasti_row8i(&row[0]);
        n2 = tetcasti_row8i(&row[1]);
        node->v[2] = tetcasti_row8i(&row[2]);
        node->n[0] = tetcasti_row8i(&row[3]);
        tetcasti_load8x4(p + 8, 3, at, NULL, end);
        node->v[3] = tetcasti_row8i(&end[1]);
        node->n[0] = tetcasti_blend8i(node->n[0], _mm256_add_epi32(cell, one), row[0]);
        node->n[3] = tetcasti_blend8i(node->n[3], _mm256_sub_epi32(cell, one), row[1]);
        node->n[1] = n1;
        node->n[2] = n2;
        for (i = 0; i < 4; i++) {
            node->n[i] = _mm256_and_si256(node->n[i], low);
            none = _mm256_cmpeq_epi32(node->n[i], low);
            node->n[i] = _mm256_or_si256(node->n[i], none);
        }
        break;
    }
    default:
        tetcasti_load8x4(p, 4, at, NULL, row);
        for (i = 0; i < 4; i++) node->n[i] = tetcasti_row8i(&row[i]);
        for (i = 0; i < 4; i++) node->v[i] = _mm256_setzero_si256();
        return _mm256_xor_si256(node->n[0], abc);
    }
    x = _mm256_xor_si256(_mm256_xor_si256(node->v[0], node->v[1]), _mm256_xor_si256(node->v[2], node->v[3]));
    return _mm256_xor_si256(x, abc);
}

/* tetcasti_leave: x is the vertex not in the new face (a, b, c), of which d is one; (p, q, r): the old face. */
TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_leave8(const uint32_t kind, const tetcasti_node8 *node,
                                                             __m256i cell, __m256i prev, __m256i x, const __m256i f[3],
                                                             __m256i d, const __m256i old[3]) {
    const __m256i *n = node->n;
    __m256i next;
    if (kind == TETCAST_CELLS_TET16 || kind == TETCAST_CELLS_TET8) {
        next = _mm256_xor_si256(tetcasti_pick8(d, old[0], old[1], old[2], n[1], n[2], n[3], _mm256_setzero_si256()),
                                tetcasti_pick8(x, f[0], f[1], f[2], n[1], n[2], n[3], _mm256_setzero_si256()));
        if (kind == TETCAST_CELLS_TET8) return tetcasti_next_tet8(cell, prev, next, node->escape);
        return _mm256_xor_si256(next, prev);
    }
    if (kind == TETCAST_CELLS_TET20) return tetcasti_pick8(x, f[0], f[1], f[2], n[0], n[1], n[2], n[3]);
    next = tetcasti_blend8i(n[3], n[2], _mm256_castsi256_ps(_mm256_cmpeq_epi32(x, node->v[2])));
    next = tetcasti_blend8i(next, n[1], _mm256_castsi256_ps(_mm256_cmpeq_epi32(x, node->v[1])));
    return tetcasti_blend8i(next, n[0], _mm256_castsi256_ps(_mm256_cmpeq_epi32(x, node->v[0])));
}

/* All lanes pass through their cells. Returns the lanes that are through with their walk (or, with *ended, their
   ray). */
TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_step8(const tetcasti_scene *scene, const uint32_t kind,
                                                             const uint32_t sink,
                                                             tetcasti_lanes *l, tetcasti_seg8 *seg, uint32_t *emit_mask,
                                                             uint32_t *over_mask, tetcasti_lanes_before *before) {
    const __m256 sign = _mm256_set1_ps(-0.0f);
    __m256 row[4], da, db, dc, zero, to_c, to_b, keep_a, ab, bc, ca, inv, at, s, at_face, s_face, cursor, length, way,
        dz, emit;
    __m256i x, next, cell, prev, face[3], out[3];
    tetcasti_node8 node;
    tetcasti_points8 a, b, c, d;
    uint32_t id[8], i, emits, rare, over = 0;
    cell = _mm256_loadu_si256((const __m256i *)(const void *)l->cell);
#define TETCASTI_LOAD_POINT(p, k) \
    p.x = _mm256_loadu_ps(l->point[k][0]); p.y = _mm256_loadu_ps(l->point[k][1]); \
    p.z = _mm256_loadu_ps(l->point[k][2]); \
    p.s = _mm256_loadu_ps(l->point[k][3]); p.id = _mm256_loadu_si256((const __m256i *)(const void *)l->id[k])
    TETCASTI_LOAD_POINT(a, 0);
    TETCASTI_LOAD_POINT(b, 1);
    TETCASTI_LOAD_POINT(c, 2);
    face[0] = a.id;
    face[1] = b.id;
    face[2] = c.id;
    d.id = tetcasti_enter8(scene->cells, kind, l->cell, _mm256_xor_si256(_mm256_xor_si256(a.id, b.id), c.id), &node);
    d.id = _mm256_and_si256(d.id, _mm256_loadu_si256((const __m256i *)(const void *)l->alive));
    _mm256_storeu_si256((__m256i *)(void *)id, d.id);
    tetcasti_load8x4(scene->vertex, 4, id, (const uint32_t (*)[8])l->turn, row);
    dz = _mm256_sub_ps(row[2], _mm256_loadu_ps(l->oz));
    d.x = _mm256_fnmadd_ps(_mm256_loadu_ps(l->sx), dz, _mm256_sub_ps(row[0], _mm256_loadu_ps(l->ox)));
    d.y = _mm256_fnmadd_ps(_mm256_loadu_ps(l->sy), dz, _mm256_sub_ps(row[1], _mm256_loadu_ps(l->oy)));
    d.z = _mm256_mul_ps(dz, _mm256_loadu_ps(l->iz));
    d.s = row[3];
    da = tetcasti_det8(&a, &d);
    db = tetcasti_det8(&b, &d);
    dc = tetcasti_det8(&c, &d);
    /* the way out: through (a, b, d) if da < 0 and db > 0, (a, d, c) if da > 0 and dc < 0, else (d, b, c); by sign
       bits */
    zero = _mm256_or_ps(_mm256_or_ps(_mm256_cmp_ps(da, _mm256_setzero_ps(), _CMP_EQ_OQ),
                                     _mm256_cmp_ps(db, _mm256_setzero_ps(), _CMP_EQ_OQ)),
                        _mm256_cmp_ps(dc, _mm256_setzero_ps(), _CMP_EQ_OQ));
    if (TETCASTI_LIKELY(((uint32_t)_mm256_movemask_ps(zero) & l->live) == 0)) {
        to_c = _mm256_andnot_ps(db, da);
        to_b = _mm256_andnot_ps(da, dc);
    } else {
        __m256 ta = tetcasti_tie8(da, &a, &d), tb = tetcasti_tie8(db, &b, &d), tc = tetcasti_tie8(dc, &c, &d);
        to_c = _mm256_andnot_ps(tb, ta);
        to_b = _mm256_andnot_ps(ta, tc);
    }
    keep_a = _mm256_or_ps(to_b, to_c);
    ab = _mm256_loadu_ps(l->weight[0]);
    bc = _mm256_loadu_ps(l->weight[1]);
    ca = _mm256_loadu_ps(l->weight[2]);
    if (sink == TETCASTI_SINK_ANY) {
        memcpy(before->id, l->id, sizeof before->id);
        memcpy(before->weight, l->weight, sizeof before->weight);
        memcpy(before->at_face, l->at_face, sizeof before->at_face);
        memcpy(before->cursor, l->cursor, sizeof before->cursor);
        memcpy(before->cell, l->cell, sizeof before->cell);
    }
    ab = _mm256_blendv_ps(_mm256_blendv_ps(_mm256_xor_ps(db, sign), da, to_b), ab, to_c);
    bc = _mm256_blendv_ps(_mm256_blendv_ps(bc, _mm256_xor_ps(dc, sign), to_b), db, to_c);
    ca = _mm256_blendv_ps(_mm256_blendv_ps(dc, ca, to_b), _mm256_xor_ps(da, sign), to_c);
    x = tetcasti_blend8i(tetcasti_blend8i(a.id, b.id, to_b), c.id, to_c); /* what is not in the new face */
    prev = _mm256_loadu_si256((const __m256i *)(const void *)l->prev);
    {
        tetcasti_points8 old_a = a;
        a = d;
        tetcasti_blend8p(&a, &old_a, keep_a);
        tetcasti_blend8p(&b, &d, to_b);
        tetcasti_blend8p(&c, &d, to_c);
    }
    out[0] = a.id;
    out[1] = b.id;
    out[2] = c.id;
    next = tetcasti_leave8(kind, &node, cell, prev, x, out, d.id, face);
    inv = _mm256_div_ps(_mm256_set1_ps(1.0f), _mm256_add_ps(_mm256_add_ps(ab, bc), ca));
    at = _mm256_mul_ps(_mm256_fmadd_ps(bc, a.z, _mm256_fmadd_ps(ca, b.z, _mm256_mul_ps(ab, c.z))), inv);
    s = tetcasti_face_value8(a.s, b.s, c.s, ab, bc, ca, inv);
#define TETCASTI_STORE_POINT(p, k) \
    _mm256_storeu_ps(l->point[k][0], p.x); _mm256_storeu_ps(l->point[k][1], p.y); \
    _mm256_storeu_ps(l->point[k][2], p.z); \
    _mm256_storeu_ps(l->point[k][3], p.s); _mm256_storeu_si256((__m256i *)(void *)l->id[k], p.id)
    TETCASTI_STORE_POINT(a, 0);
    TETCASTI_STORE_POINT(b, 1);
    TETCASTI_STORE_POINT(c, 2);
    _mm256_storeu_ps(l->weight[0], ab);
    _mm256_storeu_ps(l->weight[1], bc);
    _mm256_storeu_ps(l->weight[2], ca);
    _mm256_storeu_si256((__m256i *)(void *)l->prev, cell);
    _mm256_storeu_si256((__m256i *)(void *)l->cell,
                        _mm256_and_si256(next, _mm256_loadu_si256((const __m256i *)(const void *)l->alive)));
    if (kind == TETCAST_CELLS_TET16 || kind == TETCAST_CELLS_TET8) { /* it is needed when the packet's turn comes again:
                                                                        a sixth of the time of large meshes */
        const char *records = (const char *)scene->cells->data;
        const size_t size = kind == TETCAST_CELLS_TET8 ? sizeof(tetcasti_tet8) : sizeof(tetcasti_tet16);
        for (i = 0; i < 8; i++) _mm_prefetch(records + size * l->cell[i], _MM_HINT_T0);
    }
    /* the segment */
    at_face = _mm256_loadu_ps(l->at_face);
    s_face = _mm256_loadu_ps(l->s_face);
    cursor = _mm256_loadu_ps(l->cursor);
    emit = _mm256_cmp_ps(at, cursor, _CMP_GE_OQ);
    emits = (uint32_t)_mm256_movemask_ps(emit) & l->live;
    rare = (uint32_t)_mm256_movemask_ps(_mm256_or_ps(_mm256_cmp_ps(at_face, cursor, _CMP_LT_OQ),
                                                     _mm256_cmp_ps(at, _mm256_loadu_ps(l->last), _CMP_GT_OQ))) & emits;
    _mm256_storeu_ps(l->at_face, at);
    _mm256_storeu_ps(l->s_face, s);
    length = _mm256_and_ps(_mm256_sub_ps(at, cursor), emit);
    if (sink == TETCASTI_SINK_ANY) _mm256_storeu_si256((__m256i *)(void *)before->dropped, x);
    if (sink != TETCASTI_SINK_NONE) {
        _mm256_storeu_ps(seg->front, s_face);
        _mm256_storeu_ps(seg->back, s);
        _mm256_storeu_ps(seg->length, _mm256_mul_ps(length, _mm256_set1_ps(scene->unit)));
        _mm256_storeu_ps(seg->depth, _mm256_mul_ps(_mm256_add_ps(_mm256_loadu_ps(l->offset), cursor),
                                                   _mm256_set1_ps(scene->unit)));
    }
    way = _mm256_loadu_ps(l->length);
    _mm256_storeu_ps(l->length, _mm256_add_ps(way, length));
    _mm256_storeu_ps(l->cursor, _mm256_blendv_ps(cursor, at, emit));
    if (TETCASTI_UNLIKELY(rare != 0)) {
        float f_at[8], f_face[8], f_s[8], f_sface[8], f_cursor[8], f_length[8], f_way[8];
        _mm256_storeu_ps(f_at, at);
        _mm256_storeu_ps(f_face, at_face);
        _mm256_storeu_ps(f_s, s);
        _mm256_storeu_ps(f_sface, s_face);
        _mm256_storeu_ps(f_cursor, cursor);
        _mm256_storeu_ps(f_length, length);
        _mm256_storeu_ps(f_way, way);
        for (i = 0; i < 8; i++) {
            float front = f_sface[i], back = f_s[i], len = f_length[i];
            if ((rare >> i & 1u) == 0) continue;
            if (f_face[i] < f_cursor[i])
                front += (f_s[i] - f_sface[i]) * ((f_cursor[i] - f_face[i]) / (f_at[i] - f_face[i]));
            if (f_at[i] > l->last[i]) {
                back = f_sface[i] + (f_s[i] - f_sface[i]) * ((l->last[i] - f_face[i]) / (f_at[i] - f_face[i]));
                len = l->last[i] - f_cursor[i];
                l->length[i] = f_way[i] + len;
                over |= 1u << i;
                l->cursor[i] = l->last[i];
            }
            if (sink != TETCASTI_SINK_NONE) {
                seg->front[i] = front;
                seg->back[i] = back;
                seg->length[i] = len * scene->unit;
            }
        }
    }
    *emit_mask = emits;
    *over_mask = over;
    return (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(next, _mm256_set1_epi32(-1)))) & l->live;
}

/* Which cells have their bit set? Lanes whose cell is none count as well. */
TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_stops8(const uint32_t *stop, uint32_t stop_log,
                                                              const uint32_t cell[8]) {
    __m256i c = _mm256_loadu_si256((const __m256i *)(const void *)cell),
        none = _mm256_cmpeq_epi32(c, _mm256_set1_epi32(-1)), word;
    c = _mm256_srl_epi32(_mm256_andnot_si256(none, c), _mm_cvtsi32_si128((int)stop_log));
    word = _mm256_i32gather_epi32((const int *)(const void *)stop, _mm256_srli_epi32(c, 5), 4);
    word = _mm256_sllv_epi32(word, _mm256_sub_epi32(_mm256_set1_epi32(31), _mm256_and_si256(c, _mm256_set1_epi32(31))));
    return (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_or_si256(word, none)));
}

/* Segments of all kinds; returns the lanes that have ended. */
TETCASTI_TARGET_WALK static uint32_t tetcasti_lanes_any(const tetcasti_scene *scene, tetcasti_batch *b,
                                                        tetcasti_lanes *l,
                                                        tetcasti_seg8 *seg, uint32_t emit,
                                                            const tetcasti_lanes_before *before) {
    const tetcast_optics *o = scene->optics;
    const float *value = scene->mesh->cell_value;
    const uint32_t *hidden = scene->mesh->hidden;
    uint32_t i, k, todo, iso = 0, ended;
    float depth[8];
    memcpy(depth, seg->depth, sizeof depth);
    for (todo = hidden != NULL || value != NULL ? emit : 0; todo != 0; todo &= todo - 1) {
        uint32_t cell;
        i = tetcasti_ctz64(todo);
        cell = tetcasti_cell_number(scene->cells, before->cell[i]);
        if (hidden != NULL && tetcasti_bit(hidden, cell)) {
            tetcasti_lane_gap(o, &l->sum, i);
            emit &= ~(1u << i);
        }
        if (value != NULL) seg->front[i] = seg->back[i] = value[cell];
    }
    if (o->iso_count != 0) { /* hardly any lane crosses one: look at all side by side first */
        const __m256 front = _mm256_loadu_ps(seg->front), back = _mm256_loadu_ps(seg->back);
        const __m256 least = _mm256_min_ps(front, back), most = _mm256_max_ps(front, back);
        __m256 near_it = _mm256_setzero_ps();
        for (k = 0; k < o->iso_count; k++) {
            const __m256 v = _mm256_set1_ps(o->iso[k].value);
            near_it = _mm256_or_ps(near_it, _mm256_and_ps(_mm256_cmp_ps(least, v, _CMP_LE_OQ),
                                                          _mm256_cmp_ps(most, v, _CMP_GE_OQ)));
        }
        iso = (uint32_t)_mm256_movemask_ps(near_it) & emit;
        if (iso != 0) iso = tetcasti_iso_lanes(o, seg, iso);
    }
    ended = o->segment8(o, seg, emit & ~iso, &l->sum) & emit & ~iso;
    for (todo = iso; todo != 0; todo &= todo - 1) {
        tetcasti_crossing_info x;
        tetcasti_ray r;
        float view[3], in[3], out[3];
        i = tetcasti_ctz64(todo);
        x.scene = scene;
        for (k = 0; k < 3; k++) {
            x.in[k] = before->id[k][i];
            x.out[k] = l->id[k][i];
            in[k] = before->weight[k][i];
            out[k] = l->weight[k][i];
        }
        x.dropped = before->dropped[i];
        tetcasti_crossing_set(&x, in, out, before->at_face[i], l->at_face[i], before->cursor[i], l->cursor[i]);
        r = tetcasti_batch_ray(b, l->ray[i]);
        tetcasti_ray_direction(&r, view);
        tetcasti_lane_segment_iso(o, i, seg, tetcasti_normal, &x, view, &l->sum);
        if (o->model == TETCAST_MODEL_ISOSURFACE && x.first < 1.0f) depth[i] += x.first * seg->length[i];
        ended |= (uint32_t)!(l->sum.t[i] > o->t_stop) << i;
    }
    {   /* the first segments that have shown something */
        const __m256 zero = _mm256_setzero_ps();
        __m256 seen = _mm256_cmp_ps(_mm256_loadu_ps(l->sum.t), _mm256_set1_ps(scene->begin_t), _CMP_NEQ_UQ);
        for (k = 0; k < 3; k++)
            seen = _mm256_or_ps(seen, _mm256_cmp_ps(_mm256_loadu_ps(l->sum.c[k]), zero, _CMP_NEQ_UQ));
        todo = (uint32_t)_mm256_movemask_ps(seen) & emit & ~l->dated;
        l->dated |= todo;
    }
    for (; todo != 0; todo &= todo - 1) {
        i = tetcasti_ctz64(todo);
        if (b->depth[l->ray[i]] == TETCASTI_INF) b->depth[l->ray[i]] = depth[i];
    }
    return ended;
}

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_batch_walk8_kind(const tetcasti_scene *scene, const uint32_t kind,
                                                                    const uint32_t sink, tetcasti_batch *b) {
    tetcasti_lanes lanes[TETCASTI_PACKETS];
    tetcasti_lanes_before before;
    tetcasti_seg8 seg[TETCASTI_PACKETS];
    tetcasti_ready ready;
    const tetcast_optics *o = scene->optics;
    uint32_t i, k, any = 0;
    memset(lanes, 0, sizeof lanes);
    memset(&ready, 0, sizeof ready);
    memset(seg, 0, sizeof seg);
    for (k = 0; k < TETCASTI_PACKETS; k++) {
        tetcasti_lanes_next(scene, b, &lanes[k], 255u, &ready);
        any |= lanes[k].live;
    }
    while (any != 0) {
        uint32_t emit[TETCASTI_PACKETS], over[TETCASTI_PACKETS], through[TETCASTI_PACKETS], ended[TETCASTI_PACKETS];
        for (k = 0; k < TETCASTI_PACKETS; k++) {
            tetcasti_lanes *l = &lanes[k];
            emit[k] = over[k] = through[k] = ended[k] = 0;
            if (l->live == 0) continue;
            through[k] = tetcasti_step8(scene, kind, sink, l, &seg[k], &emit[k], &over[k], &before);
            b->lanes += 8;
            _mm256_storeu_si256((__m256i *)(void *)l->steps,
                    _mm256_add_epi32(_mm256_loadu_si256((const __m256i *)(const void *)l->steps),
                                     _mm256_set1_epi32(1)));
            if (sink == TETCASTI_SINK_ANY) ended[k] = tetcasti_lanes_any(scene, b, l, &seg[k], emit[k], &before);
            if (scene->stop != NULL) through[k] |= tetcasti_stops8(scene->stop, scene->stop_log, l->cell) & l->live;
        }
        if (sink == TETCASTI_SINK_VOLUME) { /* one after the other: a twentieth faster than in turns with the steps */
            for (k = 0; k < TETCASTI_PACKETS; k++)
                if (emit[k] != 0) ended[k] = scene->segment8(o, &seg[k], emit[k], &lanes[k].sum) & emit[k];
        }
        any = 0;
        for (k = 0; k < TETCASTI_PACKETS; k++) {
            tetcasti_lanes *l = &lanes[k];
            uint32_t gone = ended[k] | over[k];
            if (TETCASTI_UNLIKELY((through[k] | gone) != 0)) {
                for (i = gone; i != 0; i &= i - 1)
                    b->ended[l->ray[tetcasti_ctz64(i)]] = (uint8_t)(ended[k] >> tetcasti_ctz64(i) & 1u);
                through[k] &= ~gone;
                if (through[k] != 0) gone |= tetcasti_lanes_again(scene, b, l, through[k], &ready.again);
                if (gone != 0) tetcasti_lanes_next(scene, b, l, gone, &ready);
            }
            any |= l->live;
        }
    }
}

#define TETCASTI_WALK8_SINKS(kind) \
    if (scene->optics == NULL) tetcasti_batch_walk8_kind(scene, kind, TETCASTI_SINK_NONE, b); \
    else if (scene->any) tetcasti_batch_walk8_kind(scene, kind, TETCASTI_SINK_ANY, b); \
    else tetcasti_batch_walk8_kind(scene, kind, TETCASTI_SINK_VOLUME, b)
#define TETCASTI_WALK8_BODY \
    if (scene->cells->kind == TETCAST_CELLS_TET16) { TETCASTI_WALK8_SINKS(TETCAST_CELLS_TET16); } \
    else { TETCASTI_WALK8_SINKS(TETCAST_CELLS_TET8); }

/* The larger forms share their code: which one it is, is asked at every step. */
TETCASTI_TARGET_WALK static void tetcasti_batch_walk8_more(const tetcasti_scene *scene, tetcasti_batch *b) {
    TETCASTI_WALK8_SINKS(scene->cells->kind);
}
TETCASTI_TARGET_WALK static void tetcasti_batch_walk8(const tetcasti_scene *scene,
                                                      tetcasti_batch *b) { TETCASTI_WALK8_BODY }

/* The same eight lanes, compiled for AVX-512: 32 registers instead of 16 keep the state of a packet in place, which is
   worth a seventh of the time. Sixteen lanes are not: Zen 4 takes two turns for them. */
#if defined(__GNUC__)
#define TETCASTI_TARGET_VL __attribute__((target("avx2,fma,bmi,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512bw,avx512dq")))
TETCASTI_TARGET_VL static void tetcasti_batch_walk8_vl(const tetcasti_scene *scene,
                                                       tetcasti_batch *b) { TETCASTI_WALK8_BODY }
static int tetcasti_has_avx512(void) {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq");
}
#else
static void tetcasti_batch_walk8_vl(const tetcasti_scene *scene, tetcasti_batch *b) { tetcasti_batch_walk8(scene, b); }
static int tetcasti_has_avx512(void) { return 0; }
#endif
#endif /* TETCASTI_AVX2 */
/* ---------------------------------------------------------------------------
   clusters: runs of 128 cells, which lie close together, with the ranges of     // >>clusters
   their values and the walls between them. Where a transfer function shows nothing of a cluster's range the cluster is
   taken out of the mesh for that picture: the walls to its neighbours become hull, rays stop at them and enter again
   behind it.
   --------------------------------------------------------------------------- */

typedef struct tetcasti_wall { uint32_t v[3], cell, other; } tetcasti_wall; /* counter-clockwise seen from `other` */

typedef struct tetcasti_clusters {
    tetcasti_wall *wall;
    uint32_t count, wall_count;
} tetcasti_clusters;

typedef struct tetcasti_cluster_task {
    tetcast_mesh *mesh;
    tetcasti_clusters *c;
    uint64_t *start;            /* per chunk: walls, then where they go */
    tetcasti_field *field;
} tetcasti_cluster_task;

TETCASTI_INLINE uint32_t tetcasti_cell_walls(const tetcast_mesh *mesh, uint32_t i, tetcasti_wall *out) {
    uint32_t f, k, n = 0;
    for (f = 0; f < 4; f++) {
        uint32_t other = mesh->neighbour[i][f];
        if (other == TETCASTI_NONE || other < i || other >> TETCASTI_CLUSTER_LOG == i >> TETCASTI_CLUSTER_LOG) continue;
        if (out != NULL) {
            for (k = 0; k < 3; k++) out[n].v[k] = mesh->tet[i][tetcasti_face_of[f][k]];
            out[n].cell = i;
            out[n].other = other;
        }
        n++;
    }
    return n;
}

static void tetcasti_task_walls_count(void *ctx, uint32_t chunk) {
    tetcasti_cluster_task *t = (tetcasti_cluster_task *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, t->mesh->cell_count);
    uint64_t n = 0;
    for (; i < end; i++) n += tetcasti_cell_walls(t->mesh, i, NULL);
    t->start[chunk] = n;
}

static void tetcasti_task_walls(void *ctx, uint32_t chunk) {
    tetcasti_cluster_task *t = (tetcasti_cluster_task *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, t->mesh->cell_count);
    tetcasti_wall *to = t->c->wall + t->start[chunk];
    for (; i < end; i++) to += tetcasti_cell_walls(t->mesh, i, to);
}

static void tetcasti_task_ranges(void *ctx, uint32_t chunk) { /* a chunk is a whole number of clusters */
    tetcasti_cluster_task *t = (tetcasti_cluster_task *)ctx;
    uint32_t i = chunk * TETCASTI_CHUNK, end = tetcasti_chunk_end(chunk, t->mesh->cell_count), k;
    for (; i < end; i++) {
        float *range = t->field->range[i >> TETCASTI_CLUSTER_LOG], v[4];
        uint32_t n = t->field->per_cell ? 1 : 4;
        for (k = 0; k < n; k++) v[k] = t->field->value[t->field->per_cell ? i : t->mesh->tet[i][k]];
        if ((i & ((1u << TETCASTI_CLUSTER_LOG) - 1u)) == 0) range[0] = range[1] = v[0];
        for (k = 0; k < n; k++) {
            range[0] = v[k] < range[0] ? v[k] : range[0];
            range[1] = v[k] > range[1] ? v[k] : range[1];
        }
    }
}

/* Walls, and ranges of all fields. The mesh has its tets and neighbours. */
static tetcast_result tetcasti_clusters_build(tetcast_mesh *mesh, const tetcast_env *env) {
    tetcasti_cluster_task t;
    uint32_t chunks = tetcasti_chunks(mesh->cell_count), i;
    uint64_t n;
    memset(&t, 0, sizeof t);
    t.mesh = mesh;
    t.c = mesh->clusters = (tetcasti_clusters *)tetcasti_alloc_zero(&mesh->mem, 1, sizeof *mesh->clusters);
    t.start = (uint64_t *)tetcasti_alloc_array(&mesh->mem, chunks, sizeof *t.start);
    if (t.c == NULL || t.start == NULL) {
        tetcasti_free(&mesh->mem, t.start);
        return TETCAST_ERR_NO_MEMORY;
    }
    tetcasti_parallel_for(env, tetcasti_task_walls_count, &t, chunks);
    n = tetcasti_prefix_sum(t.start, chunks);
    t.c->count = (mesh->cell_count - 1) / (1u << TETCASTI_CLUSTER_LOG) + 1;
    t.c->wall_count = (uint32_t)n;
    t.c->wall = n < 0x40000000u ? (tetcasti_wall *)tetcasti_alloc_array(&mesh->mem, (size_t)n + 1,
                                                                        sizeof *t.c->wall) : NULL;
    if (t.c->wall != NULL) tetcasti_parallel_for(env, tetcasti_task_walls, &t, chunks);
    tetcasti_free(&mesh->mem, t.start);
    if (t.c->wall == NULL) return n < 0x40000000u ? TETCAST_ERR_NO_MEMORY : TETCAST_ERR_RANGE;
    for (i = 0; i < mesh->field_count; i++) {
        t.field = &mesh->field[i];
        t.field->range = (float (*)[2])tetcasti_alloc_array(&mesh->mem, t.c->count, sizeof *t.field->range);
        if (t.field->range == NULL) return TETCAST_ERR_NO_MEMORY;
        tetcasti_parallel_for(env, tetcasti_task_ranges, &t, chunks);
    }
    return TETCAST_OK;
}

static void tetcasti_clusters_free(tetcasti_mem *mem, tetcasti_clusters *c) {
    if (c != NULL) tetcasti_free(mem, c->wall);
    tetcasti_free(mem, c);
}

static uint64_t tetcasti_clusters_bytes(const tetcasti_clusters *c) {
    return c != NULL ? (uint64_t)c->wall_count * sizeof *c->wall + (uint64_t)c->count * 8 : 0;
}

/* ---- for one picture ---- */

typedef struct tetcasti_leap {
    tetcasti_mem *mem;
    uint32_t *stop;             /* a bit for each cluster that shows nothing */
    uint32_t *column_stop;      /* strips: the same for each column */
    tetcasti_face *face;        /* hull of what is left */
    uint32_t *prev;             /* what lies on the other side */
    tetcasti_hull hull;
} tetcasti_leap;

static int tetcasti_tf_empty(const tetcasti_tf *tf, float lo, float hi);

/* Nothing to be seen where the values are in [lo, hi]? */
static int tetcasti_optics_empty(const tetcast_optics *o, float lo, float hi) {
    uint32_t i;
    for (i = 0; i < o->iso_count; i++)
        if (o->iso[i].value >= lo && o->iso[i].value <= hi) return 0;
    return o->model == TETCAST_MODEL_ISOSURFACE || tetcasti_tf_empty(&o->tf, lo, hi);
}

static void tetcasti_leap_close(tetcasti_leap *l) {
    tetcasti_free(l->mem, l->stop);
    tetcasti_free(l->mem, l->column_stop);
    tetcasti_free(l->mem, l->face);
    tetcasti_free(l->mem, l->prev);
    tetcasti_free(l->mem, l->hull.box);
    l->stop = l->column_stop = l->prev = NULL;
    l->face = NULL;
    l->hull.box = NULL;
}

/* Strips call cells by columns: those of faces and of the bits where walks stop. 0: no memory. */
static int tetcasti_leap_columns(const tetcasti_scene *scene, tetcasti_leap *l, uint32_t faces) {
    const tetcasti_cells *cells = scene->cells;
    const uint32_t *number = (const uint32_t *)cells->side;
    uint32_t *place = (uint32_t *)tetcasti_alloc_array(l->mem, scene->mesh->cell_count, sizeof *place), i;
    l->column_stop = (uint32_t *)tetcasti_alloc_zero(l->mem, (size_t)cells->count / 32 + 1, sizeof *l->column_stop);
    if (place != NULL && l->column_stop != NULL) {
        for (i = 0; i < cells->count; i++) {
            if (number[i] == TETCASTI_NONE) continue;
            place[number[i]] = i;
            if (tetcasti_bit(l->stop, number[i] >> TETCASTI_CLUSTER_LOG)) l->column_stop[i >> 5] |= 1u << (i & 31u);
        }
        for (i = 0; i < faces; i++) {
            l->face[i].cell = place[l->face[i].cell];
            if (l->prev[i] != TETCASTI_NONE) l->prev[i] = place[l->prev[i]];
        }
    }
    tetcasti_free(l->mem, place);
    return place != NULL && l->column_stop != NULL;
}

/* Take out the clusters that show nothing. 1: the scene's hull is now that of the rest; 0: it does not pay, or there
   was no memory (then the picture is drawn without). l->mem is set. */
static int tetcasti_leap_open(tetcasti_scene *scene, const tetcast_env *env, tetcasti_leap *l) {
    const tetcast_mesh *mesh = scene->mesh;
    const tetcasti_clusters *c = mesh->clusters;
    const tetcasti_field *f;
    uint32_t i, k, hidden = 0, n = 0;
    size_t room;
    if (c == NULL || mesh->field_count == 0 || scene->optics == NULL) return 0;
    f = &mesh->field[mesh->active];
    l->stop = (uint32_t *)tetcasti_alloc_zero(l->mem, (size_t)c->count / 32 + 1, sizeof *l->stop);
    if (l->stop == NULL) return 0;
    for (i = 0; i < c->count; i++)
        if (tetcasti_optics_empty(scene->optics, f->range[i][0], f->range[i][1])) {
            l->stop[i >> 5] |= 1u << (i & 31u);
            hidden++;
        }
    if (hidden == 0) return 0;
    for (i = 0; i < c->wall_count; i++)
        n += tetcasti_bit(l->stop, c->wall[i].cell >> TETCASTI_CLUSTER_LOG) !=
             tetcasti_bit(l->stop, c->wall[i].other >> TETCASTI_CLUSTER_LOG);
    /* Entering through a wall costs as much as walking through 48 cells that show nothing (measured). A ray passes
       faces in proportion to their number: 2 a cell, and half of those passed from the hidden side are entered. */
    if (((uint64_t)hidden << TETCASTI_CLUSTER_LOG) < (uint64_t)n * 12) return 0;
    room = (size_t)mesh->face_count + n + 1;
    n = 0;
    l->face = (tetcasti_face *)tetcasti_alloc_array(l->mem, room, sizeof *l->face);
    l->prev = (uint32_t *)tetcasti_alloc_array(l->mem, room, sizeof *l->prev);
    if (l->face == NULL || l->prev == NULL) return 0;
    for (i = 0; i < mesh->face_count; i++) {
        if (tetcasti_bit(l->stop, mesh->face[i].cell >> TETCASTI_CLUSTER_LOG)) continue;
        l->face[n] = mesh->face[i];
        l->prev[n++] = TETCASTI_NONE;
    }
    for (i = 0; i < c->wall_count; i++) {
        const tetcasti_wall *w = &c->wall[i];
        int a = tetcasti_bit(l->stop, w->cell >> TETCASTI_CLUSTER_LOG),
            b = tetcasti_bit(l->stop, w->other >> TETCASTI_CLUSTER_LOG);
        if (a == b) continue;
        for (k = 0; k < 3; k++) l->face[n].v[k] = w->v[b ? k : 2 - k];
        l->face[n].cell = b ? w->cell : w->other;
        l->prev[n++] = b ? w->other : w->cell;
    }
    if (!tetcasti_hull_build(l->mem, env, mesh->vertex, l->face, n, &l->hull)) return 0;
    if (mesh->cells.first != NULL && !tetcasti_leap_columns(scene, l, n)) return 0;
    scene->hull = &l->hull;
    scene->hull_prev = l->prev;
    scene->first = NULL;
    scene->stop = l->column_stop != NULL ? l->column_stop : l->stop;
    scene->stop_log = l->column_stop != NULL ? 0 : TETCASTI_CLUSTER_LOG;
    return 1;
}
/* ---------------------------------------------------------------------------
   transfer: control points or tables -> sorted intervals with slopes, prefix     // >>transfer
   integrals, maxima. Jumps are kept as one-sided limits.
   --------------------------------------------------------------------------- */

typedef struct tetcasti_knot {
    float value;
    float below[4], above[4]; /* limits: r, g, b, extinction */
} tetcasti_knot;

struct tetcast_transfer {
    tetcasti_mem mem;
    tetcasti_knot *knot;
    uint32_t knot_count;
    uint32_t independent;
    tetcasti_tf tf;
    tetcast_isovalue *iso; /* ascending */
    uint32_t iso_count;
    tetcast_transfer_info info;
};

/* ---- queries ---- */

/* Number of the last interval whose lower bound is <= s: the interval of s, seen from above. Buckets of equal width:
   the column of s rises with s, so knots in lower columns are surely <= s and those in higher ones surely > s. */
TETCASTI_INLINE uint32_t tetcasti_tf_column(const tetcasti_tf *tf, float s) {
    float x = (s - tf->knot[1]) * tf->bucket_scale;
    if (!(x > 0.0f)) return 0;
    return x < (float)tf->bucket_count ? (uint32_t)x : tf->bucket_count - 1;
}
TETCASTI_INLINE uint32_t tetcasti_tf_find(const tetcasti_tf *tf, float s) {
    uint32_t lo = 0, hi = tf->n - 1;
    if (tf->row != NULL) { /* few intervals: count */
        uint32_t i;
        for (i = 1; i < tf->n; i++) lo += tf->knot[i] <= s;
        return lo;
    }
    if (tf->bucket != NULL) {
        uint32_t c = tetcasti_tf_column(tf, s);
        lo = tf->bucket[c];
        hi = tf->bucket[c + 1];
    }
    while (lo < hi) {
        uint32_t mid = lo + (hi - lo + 1) / 2;
        if (tf->knot[mid] <= s) lo = mid;
        else hi = mid - 1;
    }
    return lo;
}

/* Value of the coefficient pair `at` of interval k at its lower (0) or upper (1) end. */
TETCASTI_INLINE float tetcasti_tf_limit(const tetcasti_tf *tf, uint32_t k, uint32_t end, uint32_t at) {
    const float u = tf->knot[k + end] - tf->coef[k][TETCASTI_BASE], v = tf->coef[k][at];
    return tetcasti_finite_f(u) ? v + tf->coef[k][at + 1] * u : v;
}

/* Largest extinction and emission of interval k for u from lo to hi; emission of two ramps has its top inside. */
static void tetcasti_tf_interval_max(const tetcasti_tf *tf, uint32_t k, float lo, float hi, float out[4]) {
    const float *c = tf->coef[k];
    float u[2], t[2];
    uint32_t i, j;
    u[0] = lo - tf->coef[k][TETCASTI_BASE];
    u[1] = hi - tf->coef[k][TETCASTI_BASE];
    for (j = 0; j < 2; j++) {
        if (!tetcasti_finite_f(u[j])) u[j] = 0.0f; /* constant there */
        t[j] = c[0] + c[1] * u[j];
        t[j] = t[j] > 0.0f ? t[j] : 0.0f;
    }
    out[0] = t[0] > t[1] ? t[0] : t[1];
    for (i = 0; i < 3; i++) {
        const float a = c[2 + 2 * i], b = c[3 + 2 * i];
        float e[2];
        for (j = 0; j < 2; j++) {
            e[j] = a + b * u[j];
            e[j] = (e[j] > 0.0f ? e[j] : 0.0f) * (tf->independent ? 1.0f : t[j]);
        }
        out[1 + i] = e[0] > e[1] ? e[0] : e[1];
        if (!tf->independent && b * c[1] < 0.0f) {
            double top = -((double)a * (double)c[1] + (double)b * (double)c[0]) / (2.0 * (double)b * (double)c[1]);
            if (top > (double)u[0] && top < (double)u[1]) {
                double v = ((double)a + (double)b * top) * ((double)c[0] + (double)c[1] * top);
                if (v > (double)out[1 + i]) out[1 + i] = (float)v;
            }
        }
    }
}

/* Largest extinction and emission of values from lo to hi, lo <= hi. At a jump at hi the limit from above counts. */
static void tetcasti_tf_range_max(const tetcasti_tf *tf, float lo, float hi, float out[4]) {
    uint32_t a = tetcasti_tf_find(tf, lo), b = tetcasti_tf_find(tf, hi), i, side;
    float part[4];
    if (a == b) {
        tetcasti_tf_interval_max(tf, a, lo, hi, out);
        return;
    }
    tetcasti_tf_interval_max(tf, a, lo, tf->knot[a + 1], out);
    tetcasti_tf_interval_max(tf, b, tf->knot[b], hi, part);
    for (i = 0; i < 4; i++) out[i] = out[i] > part[i] ? out[i] : part[i];
    for (a += 1 + tf->n, b += tf->n; a < b; a >>= 1, b >>= 1) { /* whole intervals between: maxima from the tree */
        for (side = 0; side < 2; side++) {
            const float *m;
            if (side == 0 && (a & 1u)) m = tf->largest[a++];
            else if (side == 1 && (b & 1u)) m = tf->largest[--b];
            else continue;
            for (i = 0; i < 4; i++) out[i] = out[i] > m[i] ? out[i] : m[i];
        }
    }
}

static int tetcasti_tf_empty(const tetcasti_tf *tf, float lo, float hi) {
    uint32_t a, b, i;
    if (!(lo <= hi)) return 0;
    a = tetcasti_tf_find(tf, lo);
    b = tetcasti_tf_find(tf, hi);
    if (tf->knot[b] == hi && (a < b || lo == hi)) { /* of interval b only the lower end is touched */
        for (i = 0; i < (tf->independent ? 8u : 2u); i += 2) if (tetcasti_tf_limit(tf, b, 0, i) != 0.0f) return 0;
        if (a == b) return 1;
        b--;
    }
    return tf->visible[a] > b;
}

/* Integral over interval k from its base to s: extinction, r, g, b emission, r, g, b colour. */
static void tetcasti_tf_part(const tetcasti_tf *tf, uint32_t k, float s, double out[7]) {
    const float *c = tf->coef[k];
    const double u = (double)s - (double)tf->coef[k][TETCASTI_BASE], u2 = 0.5 * u * u;
    const double t0 = (double)c[0], t1 = (double)c[1];
    uint32_t i;
    out[0] = t0 * u + t1 * u2;
    for (i = 0; i < 3; i++) {
        const double a = (double)c[2 + 2 * i], b = (double)c[3 + 2 * i];
        out[4 + i] = a * u + b * u2;
        out[1 + i] = tf->independent ? out[4 + i] : a * t0 * u + (a * t1 + b * t0) * u2 + b * t1 * u * u * u / 3.0;
    }
}

/* Integrals from the first knot to s. */
static void tetcasti_tf_integral(const tetcasti_tf *tf, float s, double out[7]) {
    const uint32_t k = tetcasti_tf_find(tf, s);
    uint32_t i;
    tetcasti_tf_part(tf, k, s, out);
    for (i = 0; i < 7; i++) out[i] += tf->prefix[k][i];
}

/* ---- compiling ---- */

static void tetcasti_tf_free(tetcasti_mem *mem, tetcasti_tf *tf) {
    tetcasti_free(mem, tf->knot);
    tetcasti_free(mem, tf->coef);
    tetcasti_free(mem, tf->row);
    tetcasti_free(mem, tf->bucket);
    tetcasti_free(mem, tf->prefix);
    tetcasti_free(mem, tf->largest);
    tetcasti_free(mem, tf->visible);
    memset(tf, 0, sizeof *tf);
}

static void tetcasti_tf_coefs(tetcasti_tf *tf, const tetcasti_knot *knot, uint32_t count) {
    uint32_t k, i;
    for (k = 0; k < tf->n; k++) {
        float *c = tf->coef[k];
        int top = k == 0; /* from the upper end */
        tf->knot[k] = k == 0 ? -INFINITY : knot[k - 1].value;
        if (k != 0 && k < count && knot[k].below[3] < knot[k - 1].above[3]) top = 1;
        memset(c, 0, sizeof tf->coef[k]);
        c[TETCASTI_LOWER] = tf->knot[k];
        c[TETCASTI_UPPER] = k < count ? knot[k].value : INFINITY;
        c[TETCASTI_BASE] = count == 0 ? 0.0f : knot[top ? k : k - 1].value;
        for (i = 0; i < 4; i++) { /* r, g, b, extinction -> slots 1, 2, 3, 0 */
            const uint32_t at = i == 3 ? 0 : 2 + 2 * i;
            double lo = 0.0, hi = 0.0, slope = 0.0;
            if (k != 0) lo = hi = (double)knot[k - 1].above[i];
            if (k != 0 && k < count) hi = (double)knot[k].below[i];
            if (k == 0 && count != 0) lo = hi = (double)knot[0].below[i];
            if (hi != lo) slope = (hi - lo) / ((double)knot[k].value - (double)knot[k - 1].value);
            if (!(tetcasti_abs(slope) < 1e30)) { /* knots a few denormal numbers apart */
                lo = 0.5 * (lo + hi);
                slope = 0.0;
            }
            c[at] = (float)(top ? hi : lo);
            c[at + 1] = (float)slope;
        }
    }
    tf->knot[tf->n] = INFINITY;
    tf->visible[tf->n] = tf->n;
    for (k = tf->n; k-- > 0;) {
        const float *c = tf->coef[k];
        int seen = c[0] != 0.0f || c[1] != 0.0f;
        if (tf->independent) for (i = 2; i < 8; i++) seen |= c[i] != 0.0f;
        tf->visible[k] = seen ? k : tf->visible[k + 1];
    }
}

static void tetcasti_tf_sums(tetcasti_tf *tf) {
    double sum[7], part[7];
    uint32_t k, i;
    memset(sum, 0, sizeof sum); /* up to the lower end of interval k */
    for (k = 0; k < tf->n; k++) { /* prefix: up to its base */
        memset(tf->prefix[k], 0, sizeof tf->prefix[k]);
        if (k == 0) continue;
        tetcasti_tf_part(tf, k, tf->knot[k], part);
        for (i = 0; i < 7; i++) tf->prefix[k][i] = sum[i] - part[i];
        if (k + 1 == tf->n) break;
        tetcasti_tf_part(tf, k, tf->knot[k + 1], part);
        for (i = 0; i < 7; i++) sum[i] = tf->prefix[k][i] + part[i];
    }
    for (k = 0; k < tf->n; k++) tetcasti_tf_interval_max(tf, k, tf->knot[k], tf->knot[k + 1], tf->largest[tf->n + k]);
    for (k = tf->n; k-- > 1;) {
        const float *a = tf->largest[2 * k], *b = tf->largest[2 * k + 1];
        for (i = 0; i < 4; i++) tf->largest[k][i] = a[i] > b[i] ? a[i] : b[i];
    }
    tf->max_extinction = tf->max_color = tf->max_emission = 0.0f;
    for (k = 0; k < tf->n; k++) {
        const float *m = tf->largest[tf->n + k];
        if (m[0] > tf->max_extinction) tf->max_extinction = m[0];
        for (i = 0; i < 3; i++) {
            if (m[1 + i] > tf->max_emission) tf->max_emission = m[1 + i];
        }
        if (tf->visible[k] != k) continue;
        for (i = 0; i < 6; i++) { /* both ends */
            const float v = tetcasti_tf_limit(tf, k, i & 1u, 2 + (i & 6u));
            if (v > tf->max_color) tf->max_color = v;
        }
    }
}

static void tetcasti_tf_rows(tetcasti_tf *tf) { /* the same numbers, one row per coefficient; unused columns: empty */
    uint32_t k, i;
    for (k = 0; k < 16; k++) {
        const int in = k < tf->n;
        tf->row[k] = in ? tf->knot[k] : INFINITY;
        tf->row[16 + k] = in ? tf->knot[k + 1] : INFINITY;
        tf->row[32 + k] = in ? tf->coef[k][TETCASTI_BASE] : 0.0f;
        for (i = 0; i < 8; i++) tf->row[48 + 16 * i + k] = in ? tf->coef[k][i] : 0.0f;
        for (i = 0; i < 8 && k > 0; i++) tf->row[TETCASTI_ROW_SPLAT + 8 * (k - 1) + i] = tf->row[k];
    }
}

static void tetcasti_tf_buckets(tetcasti_tf *tf) {
    uint32_t i, c;
    for (c = 0; c <= tf->bucket_count; c++) tf->bucket[c] = 0;
    for (i = 1; i < tf->n; i++) tf->bucket[tetcasti_tf_column(tf, tf->knot[i]) + 1]++;
    for (c = 0; c < tf->bucket_count; c++) tf->bucket[c + 1] += tf->bucket[c];
}

/* Compile knots with strictly ascending values. 0: no memory (nothing is left allocated). */
static int tetcasti_tf_build(tetcasti_mem *mem, const tetcasti_knot *knot, uint32_t count, uint32_t independent,
                             tetcasti_tf *tf) {
    const size_t n = (size_t)count + 1;
    int ok;
    memset(tf, 0, sizeof *tf);
    tf->n = (uint32_t)n;
    tf->independent = independent;
    tf->knot = (float *)tetcasti_alloc_array(mem, n + 1, sizeof *tf->knot);
    tf->coef = (float (*)[16])tetcasti_alloc_array(mem, n, sizeof *tf->coef);
    tf->prefix = (double (*)[8])tetcasti_alloc_array(mem, n, sizeof *tf->prefix);
    tf->largest = (float (*)[4])tetcasti_alloc_array(mem, 2 * n, sizeof *tf->largest);
    tf->visible = (uint32_t *)tetcasti_alloc_array(mem, n + 1, sizeof *tf->visible);
    ok = tf->knot != NULL && tf->coef != NULL && tf->prefix != NULL && tf->largest != NULL &&
         tf->visible != NULL;
    if (ok && n <= 16) {
        tf->row = (float *)tetcasti_alloc_array(mem, TETCASTI_ROW_SPLAT + 15 * 8, sizeof *tf->row);
        ok = tf->row != NULL;
    } else if (ok) {
        float width = knot[count - 1].value - knot[0].value, scale;
        tf->bucket_count = 64;
        while (tf->bucket_count < 4 * n) tf->bucket_count *= 2;
        scale = (float)tf->bucket_count / width;
        tf->bucket_scale = tetcasti_finite_f(scale) ? scale : 0.0f;
        tf->bucket = (uint32_t *)tetcasti_alloc_array(mem, (size_t)tf->bucket_count + 1, sizeof *tf->bucket);
        ok = tf->bucket != NULL;
    }
    if (!ok) {
        tetcasti_tf_free(mem, tf);
        return 0;
    }
    tetcasti_tf_coefs(tf, knot, count);
    if (tf->bucket != NULL) tetcasti_tf_buckets(tf);
    if (tf->row != NULL) tetcasti_tf_rows(tf);
    memset(tf->largest[0], 0, sizeof tf->largest[0]);
    tetcasti_tf_sums(tf);
    return 1;
}

/* How far a limit may move: eps + rel * itself, for colours [0] and extinction [1]. */
typedef struct tetcasti_slack {
    double eps[2], rel[2];
} tetcasti_slack;

/* Leave out knots where the straight line between those that stay is within the slack of every limit in between. From
   each kept knot the next one is the farthest reachable (a cone of allowed slopes narrows from knot to knot). Jumps
   stay, and so do the ends of empty intervals: what is transparent remains exactly transparent. In place; gives the new
   count and the largest changes, split into a part relative to the value, at most slack->rel, and the rest. */
static uint32_t tetcasti_knots_simplify(tetcasti_knot *knot, uint32_t count, uint32_t independent,
                                        const tetcasti_slack *slack, tetcasti_slack *change) {
    uint32_t from = 0, out = 0, i, j, c;
    memset(change, 0, sizeof *change);
    while (from < count) {
        double lo[4], hi[4];
        uint32_t last = from + 1; /* farthest knot that can be next */
        for (c = 0; c < 4; c++) {
            lo[c] = -1e300;
            hi[c] = 1e300;
        }
        for (j = from + 1; j < count; j++) {
            const double w = (double)knot[j].value - (double)knot[from].value;
            int within = 1, jump = 0, bend_of_empty = 0;
            for (c = 0; c < 4; c++) {
                const double v = (double)knot[j].below[c], slope = (v - (double)knot[from].above[c]) / w;
                const double room = (slack->eps[c == 3] + slack->rel[c == 3] * v) / w;
                within &= slope >= lo[c] && slope <= hi[c];
                jump |= knot[j].below[c] != knot[j].above[c];
                if (slope - room > lo[c]) lo[c] = slope - room;
                if (slope + room < hi[c]) hi[c] = slope + room;
            }
            if (within) last = j;
            if (j + 1 < count) { /* empty on one side only? */
                int left = knot[j - 1].above[3] == 0.0f && knot[j].below[3] == 0.0f;
                int right = knot[j].above[3] == 0.0f && knot[j + 1].below[3] == 0.0f;
                for (c = 0; c < 3 && independent; c++) {
                    left &= knot[j - 1].above[c] == 0.0f && knot[j].below[c] == 0.0f;
                    right &= knot[j].above[c] == 0.0f && knot[j + 1].below[c] == 0.0f;
                }
                bend_of_empty = left != right;
            }
            if (!within || jump || bend_of_empty) break;
        }
        knot[out++] = knot[from];
        for (i = from + 1; i < last && last < count; i++) {
            const double x = ((double)knot[i].value - (double)knot[from].value) /
                             ((double)knot[last].value - (double)knot[from].value);
            for (c = 0; c < 4; c++) {
                const double v = (double)knot[from].above[c] +
                    x * ((double)knot[last].below[c] - (double)knot[from].above[c]);
                const double was = (double)knot[i].below[c], d = tetcasti_abs(v - was);
                const double share = slack->rel[c == 3] * was;
                const uint32_t e = c == 3;
                change->eps[e] = tetcasti_max(change->eps[e], d - share);
                if (was > 0.0) change->rel[e] = tetcasti_max(change->rel[e], tetcasti_min(d, share) / was);
            }
        }
        from = last;
    }
    for (j = 0; j < 2 && out > 1; j++) { /* a flat end is part of what lies outside */
        for (;;) {
            const tetcasti_knot *a = j ? &knot[out - 1] : &knot[0], *b = j ? &knot[out - 2] : &knot[1];
            const float *inner = j ? b->above : b->below;
            if (out < 2 || memcmp(a->below, a->above, sizeof a->below) != 0 ||
                memcmp(inner, a->below, sizeof a->below) != 0) break;
            out--;
            if (!j) memmove(knot, knot + 1, out * sizeof *knot);
        }
    }
    if (out == 1 && memcmp(knot[0].below, knot[0].above, sizeof knot[0].below) == 0) { /* constant everywhere */
        float any = 0.0f;
        for (c = 0; c < 4; c++) any += knot[0].above[c];
        if (any == 0.0f) out = 0;
    }
    return out;
}

/* ---- from the desc ---- */

static tetcast_result tetcasti_transfer_check(const tetcast_control_point *p, size_t count, uint32_t use,
                                              tetcast_error *error) {
    size_t i;
    uint32_t c;
    if (count != 0 && p == NULL) return TETCAST_ERR_INVALID_ARG;
    if (count > (1u << 20)) return tetcasti_fail(error, TETCAST_ERR_RANGE, count, "% control points are too many");
    for (i = 0; i < count; i++) {
        if (!(tetcasti_absf(p[i].value) < TETCASTI_VALUE_END)) {
            return tetcasti_fail(error, TETCAST_ERR_INVALID_ARG, i, "control point %: value is not below 1e38");
        }
        if (i != 0 && p[i].value < p[i - 1].value) {
            return tetcasti_fail(error, TETCAST_ERR_INVALID_ARG, i, "control point %: values are not ascending");
        }
        for (c = 0; c < 4; c++) {
            const float v = c == 3 ? p[i].extinction : p[i].rgb[c];
            if (!(use & (1u << c)) || (v >= 0.0f && v <= TETCASTI_EXTINCTION_END)) continue;
            return tetcasti_fail(error, TETCAST_ERR_INVALID_ARG, i,
                                 c == 3 ? "control point %: extinction is not in [0, 1e18]"
                                        : "control point %: colour is not in [0, 1e18]");
        }
    }
    return TETCAST_OK;
}

/* Limits at `value` of a list of points (the channels in `use`); *next is the first point > value afterwards. */
static void tetcasti_points_limits(const tetcast_control_point *p, size_t count, size_t *next, float value,
                                   uint32_t use, tetcasti_knot *out) {
    const size_t first = *next;
    size_t last = first;
    uint32_t c;
    while (last < count && p[last].value == value) last++;
    *next = last;
    for (c = 0; c < 4; c++) {
        double v[2];
        uint32_t side;
        if (!(use & (1u << c)) || count == 0) continue;
        for (side = 0; side < 2; side++) {
            const size_t i = side ? last : first; /* between points a and b, or one of them */
            size_t a, b;
            double va, vb;
            if (last > first) a = b = side ? last - 1 : first;
            else {
                a = i == 0 ? 0 : i - 1;
                b = i == count ? count - 1 : i;
            }
            va = (double)(c == 3 ? p[a].extinction : p[a].rgb[c]);
            vb = (double)(c == 3 ? p[b].extinction : p[b].rgb[c]);
            v[side] = a == b ? va : va + (vb - va) * (((double)value - (double)p[a].value) /
                                                      ((double)p[b].value - (double)p[a].value));
        }
        out->below[c] = (float)v[0];
        out->above[c] = (float)v[1];
    }
    out->value = value;
}

static uint32_t tetcasti_knots_from_points(const tetcast_control_point *p, size_t count, uint32_t use,
                                           const tetcast_control_point *q, size_t q_count, uint32_t q_use,
                                           tetcasti_knot *out) {
    size_t i = 0, j = 0;
    uint32_t n = 0;
    while (i < count || j < q_count) {
        float value = i < count ? p[i].value : q[j].value;
        if (j < q_count && q[j].value < value) value = q[j].value;
        memset(&out[n], 0, sizeof out[n]);
        tetcasti_points_limits(p, count, &i, value, use, &out[n]);
        tetcasti_points_limits(q, q_count, &j, value, q_use, &out[n]);
        n++;
    }
    return n;
}

static tetcast_result tetcasti_knots_from_table(const tetcast_transfer_desc *d, tetcasti_knot *out, uint32_t *n_out,
                                                tetcast_error *error) {
    const double lo = (double)d->table_value[0], hi = (double)d->table_value[1];
    const size_t count = d->table_count, knots = count + (d->table_steps ? 1u : 0u);
    size_t i, c;
    uint32_t n = 0;
    for (i = 0; i < 4 * count; i++) {
        if (d->table[i] >= 0.0f && d->table[i] <= TETCASTI_EXTINCTION_END) continue;
        return tetcasti_fail(error, TETCAST_ERR_INVALID_ARG, i / 4, "table sample %: not in [0, 1e18]");
    }
    if (!(tetcasti_abs(lo) < (double)TETCASTI_VALUE_END && tetcasti_abs(hi) < (double)TETCASTI_VALUE_END) ||
        (count > 1 && !(lo < hi))) {
        return tetcasti_fail(error, TETCAST_ERR_INVALID_ARG, 0, "table_value is not an ascending pair of numbers");
    }
    for (i = 0; i < knots; i++) { /* steps: knots half way between samples, and both ends */
        const double at = d->table_steps ? (i == 0 ? 0.0 : i == count ? (double)count - 1.0 : (double)i - 0.5)
            : (double)i;
        const float value = (float)(count > 1 ? lo + (hi - lo) * (at / (double)(count - 1)) : lo);
        const size_t below = d->table_steps ? (i == 0 ? 0 : i - 1) : i;
        const size_t above = d->table_steps ? (i == count ? count - 1 : i) : i;
        if (n == 0 || value > out[n - 1].value) {
            out[n].value = value;
            for (c = 0; c < 4; c++) out[n].below[c] = d->table[4 * below + c];
            n++;
        }
        for (c = 0; c < 4; c++) out[n - 1].above[c] = d->table[4 * above + c];
    }
    *n_out = n;
    return TETCAST_OK;
}

static tetcast_result tetcasti_transfer_knots(const tetcast_transfer_desc *d, tetcast_transfer *t) {
    const int has_points = d->point_count != 0, has_table = d->table_count != 0;
    const int has_lists = d->color_count != 0 || d->extinction_count != 0;
    const uint32_t color = 7u, extinction = 8u;
    size_t count = d->point_count + d->color_count + d->extinction_count;
    uint32_t i, c;
    tetcast_result r;
    if (has_points + has_table + has_lists > 1 || (has_table && d->table == NULL)) {
        return tetcasti_fail(d->env.error, TETCAST_ERR_INVALID_ARG, 0,
                             "transfer function: two sources, or a NULL table");
    }
    r = tetcasti_transfer_check(d->points, d->point_count, color | extinction, d->env.error);
    if (r == TETCAST_OK) r = tetcasti_transfer_check(d->color_points, d->color_count, color, d->env.error);
    if (r == TETCAST_OK) r = tetcasti_transfer_check(d->extinction_points, d->extinction_count, extinction,
                                                     d->env.error);
    if (r != TETCAST_OK) return r;
    if (has_table) {
        if (d->table_count > (1u << 20)) {
            return tetcasti_fail(d->env.error, TETCAST_ERR_RANGE, d->table_count, "% table samples are too many");
        }
        count = d->table_count + 1;
    }
    t->knot = (tetcasti_knot *)tetcasti_alloc_array(&t->mem, count + 1, sizeof *t->knot);
    if (t->knot == NULL) return TETCAST_ERR_NO_MEMORY;
    if (has_table) r = tetcasti_knots_from_table(d, t->knot, &t->knot_count, d->env.error);
    else if (has_lists) {
        t->knot_count = tetcasti_knots_from_points(d->color_points, d->color_count, color, d->extinction_points,
                                                   d->extinction_count, extinction, t->knot);
    } else {
        t->knot_count = tetcasti_knots_from_points(d->points, d->point_count, color | extinction, d->points, 0, 0,
                                                   t->knot);
    }
    if (r != TETCAST_OK) return r;
    if (d->extinction_scale != 0.0f) {
        for (i = 0; i < t->knot_count; i++) {
            for (c = t->independent ? 0 : 3; c < 4; c++) {
                t->knot[i].below[c] *= d->extinction_scale;
                t->knot[i].above[c] *= d->extinction_scale;
                if (!(t->knot[i].below[c] <= TETCASTI_EXTINCTION_END &&
                      t->knot[i].above[c] <= TETCASTI_EXTINCTION_END)) {
                    return tetcasti_fail(d->env.error, TETCAST_ERR_INVALID_ARG, i, "knot %: extinction exceeds 1e18");
                }
            }
        }
    }
    return TETCAST_OK;
}

static tetcast_result tetcasti_transfer_isovalues(const tetcast_transfer_desc *d, tetcast_transfer *t) {
    size_t i, j;
    uint32_t c;
    if (d->isovalue_count == 0) return TETCAST_OK;
    if (d->isovalues == NULL) return TETCAST_ERR_INVALID_ARG;
    if (d->isovalue_count > (1u << 16)) {
        return tetcasti_fail(d->env.error, TETCAST_ERR_RANGE, d->isovalue_count, "% isovalues are too many");
    }
    t->iso = (tetcast_isovalue *)tetcasti_alloc_array(&t->mem, d->isovalue_count, sizeof *t->iso);
    if (t->iso == NULL) return TETCAST_ERR_NO_MEMORY;
    for (i = 0; i < d->isovalue_count; i++) {
        const tetcast_isovalue *v = &d->isovalues[i];
        int bad = !(tetcasti_absf(v->value) < TETCASTI_VALUE_END) || !(v->opacity >= 0.0f && v->opacity <= 1.0f);
        bad |= !(v->specular >= 0.0f && v->specular <= 1e30f) || !(v->shininess >= 0.0f && v->shininess <= 1e6f);
        for (c = 0; c < 3; c++) bad |= !(v->rgb[c] >= 0.0f && v->rgb[c] <= 1e30f);
        if (bad) return tetcasti_fail(d->env.error, TETCAST_ERR_INVALID_ARG, i, "isovalue %: a number is out of range");
        for (j = i; j > 0 && t->iso[j - 1].value > v->value; j--) t->iso[j] = t->iso[j - 1];
        t->iso[j] = *v;
        if (j > 0 && t->iso[j - 1].value == v->value) {
            return tetcasti_fail(d->env.error, TETCAST_ERR_INVALID_ARG, i,
                                 "isovalue %: there is another one of this value");
        }
    }
    t->iso_count = (uint32_t)d->isovalue_count;
    return TETCAST_OK;
}

/* Largest colour and extinction among the knots. */
static void tetcasti_knots_largest(const tetcasti_knot *knot, uint32_t count, double largest[2]) {
    uint32_t i, c;
    largest[0] = largest[1] = 0.0;
    for (i = 0; i < count; i++) {
        for (c = 0; c < 4; c++) {
            largest[c == 3] = tetcasti_max(largest[c == 3], (double)knot[i].below[c]);
            largest[c == 3] = tetcasti_max(largest[c == 3], (double)knot[i].above[c]);
        }
    }
}

static void tetcasti_transfer_describe(tetcast_transfer *t, uint32_t given) {
    uint32_t i;
    t->info.knot_count = t->knot_count;
    t->info.dropped_count = given - t->knot_count;
    t->info.isovalue_count = t->iso_count;
    for (i = 0; i < t->knot_count; i++) {
        t->info.jump_count += memcmp(t->knot[i].below, t->knot[i].above, sizeof t->knot[i].below) != 0;
    }
    if (t->knot_count != 0) {
        t->info.value[0] = t->knot[0].value;
        t->info.value[1] = t->knot[t->knot_count - 1].value;
    }
    t->info.largest_extinction = t->tf.max_extinction;
    t->info.largest_color = t->tf.max_color;
    t->info.largest_emission = t->tf.max_emission;
    t->info.bytes = t->mem.used;
}

TETCAST_DEF tetcast_result tetcast_transfer_create(const tetcast_transfer_desc *desc, tetcast_transfer **out) {
    tetcast_transfer_desc d;
    tetcasti_mem mem;
    tetcast_transfer *t;
    tetcast_result r;
    uint32_t given = 0;
    if (out == NULL) return TETCAST_ERR_INVALID_ARG;
    *out = NULL;
    if (desc != NULL) d = *desc;
    else memset(&d, 0, sizeof d);
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    r = tetcasti_env_open(&d.env, &mem);
    if (r != TETCAST_OK) return r;
    if ((d.color_mode != TETCAST_COLOR_ASSOCIATED && d.color_mode != TETCAST_COLOR_INDEPENDENT) ||
        !(d.extinction_scale >= 0.0f && d.extinction_scale <= 1e30f) || !(d.simplify >= 0.0f && d.simplify <= 1.0f)) {
        return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, 0,
                             "transfer function: color_mode, extinction_scale or simplify is out of range");
    }
    t = (tetcast_transfer *)tetcasti_alloc_zero(&mem, 1, sizeof *t);
    if (t == NULL) return TETCAST_ERR_NO_MEMORY;
    t->mem = mem;
    t->independent = d.color_mode == TETCAST_COLOR_INDEPENDENT;
    r = tetcasti_transfer_knots(&d, t);
    if (r == TETCAST_OK) r = tetcasti_transfer_isovalues(&d, t);
    if (r == TETCAST_OK) {
        /* 1e-7: bends that are only rounding of a straight line */
        double largest[2];
        const double share = d.simplify > 1e-7f ? (double)d.simplify : 1e-7;
        tetcasti_slack slack, change;
        given = t->knot_count;
        tetcasti_knots_largest(t->knot, t->knot_count, largest);
        slack.eps[0] = share * largest[0];
        slack.eps[1] = share * largest[1];
        slack.rel[0] = slack.rel[1] = 0.0;
        t->knot_count = tetcasti_knots_simplify(t->knot, t->knot_count, t->independent, &slack, &change);
        t->info.simplify_color = (float)change.eps[0];
        t->info.simplify_extinction = (float)change.eps[1];
        if (!tetcasti_tf_build(&t->mem, t->knot, t->knot_count, t->independent, &t->tf)) r = TETCAST_ERR_NO_MEMORY;
    }
    if (r != TETCAST_OK) {
        tetcast_transfer_destroy(t);
        return r;
    }
    tetcasti_transfer_describe(t, given);
    *out = t;
    return TETCAST_OK;
}

TETCAST_DEF void tetcast_transfer_destroy(tetcast_transfer *transfer) {
    tetcasti_mem mem;
    if (transfer == NULL) return;
    mem = transfer->mem;
    tetcasti_tf_free(&mem, &transfer->tf);
    tetcasti_free(&mem, transfer->knot);
    tetcasti_free(&mem, transfer->iso);
    tetcasti_free(&mem, transfer);
}

TETCAST_DEF void tetcast_transfer_get_info(const tetcast_transfer *transfer, tetcast_transfer_info *info) {
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (transfer != NULL) *info = transfer->info;
}

TETCAST_DEF void tetcast_transfer_eval(const tetcast_transfer *transfer, float value, float rgba[4]) {
    const float *c;
    float u;
    uint32_t k, i;
    memset(rgba, 0, 4 * sizeof *rgba);
    if (transfer == NULL || !(tetcasti_absf(value) < TETCASTI_VALUE_END)) return;
    k = tetcasti_tf_find(&transfer->tf, value);
    c = transfer->tf.coef[k];
    u = value - c[TETCASTI_BASE];
    for (i = 0; i < 4; i++) {
        const uint32_t at = i == 3 ? 0 : 2 + 2 * i;
        rgba[i] = c[at] + c[at + 1] * u;
        if (!(rgba[i] > 0.0f)) rgba[i] = 0.0f;
    }
}

/* Values outside the range that knots can have are as good as the ends. */
static int tetcasti_range_clamp(float *lo, float *hi) {
    const float end = 0.5f * TETCASTI_VALUE_END;
    if (!(*lo <= *hi)) return 0;
    *lo = *lo < -end ? -end : *lo > end ? end : *lo;
    *hi = *hi < -end ? -end : *hi > end ? end : *hi;
    return 1;
}

TETCAST_DEF int tetcast_transfer_is_empty(const tetcast_transfer *transfer, float lo, float hi) {
    if (transfer == NULL || !tetcasti_range_clamp(&lo, &hi)) return 0;
    return tetcasti_tf_empty(&transfer->tf, lo, hi);
}

TETCAST_DEF float tetcast_transfer_max_extinction(const tetcast_transfer *transfer, float lo, float hi) {
    float m[4];
    if (transfer == NULL || !tetcasti_range_clamp(&lo, &hi)) return 0.0f;
    tetcasti_tf_range_max(&transfer->tf, lo, hi, m);
    return m[0];
}

TETCAST_DEF void tetcast_transfer_max_emission(const tetcast_transfer *transfer, float lo, float hi, float rgb[3]) {
    float m[4];
    memset(rgb, 0, 3 * sizeof *rgb);
    if (transfer == NULL || !tetcasti_range_clamp(&lo, &hi)) return;
    tetcasti_tf_range_max(&transfer->tf, lo, hi, m);
    memcpy(rgb, m + 1, 3 * sizeof *rgb);
}

/* Equal intervals from both ends; what lies between may differ. */
static void tetcasti_tf_difference(const tetcasti_tf *a, const tetcasti_tf *b, float *lo, float *hi) {
    uint32_t i = 0, j = 0;
    *lo = -INFINITY;
    *hi = INFINITY;
    if (a->independent != b->independent) return;
    while (i < a->n && i < b->n && memcmp(a->coef[i], b->coef[i], sizeof a->coef[i]) == 0) i++;
    if (i == a->n && i == b->n) { /* equal */
        *lo = INFINITY;
        *hi = -INFINITY;
        return;
    }
    while (j < a->n && j < b->n && memcmp(a->coef[a->n - 1 - j], b->coef[b->n - 1 - j], sizeof a->coef[0]) == 0) j++;
    if (i < a->n && i < b->n) *lo = a->knot[i]; /* equal bounds up to here */
    if (j < a->n) *hi = a->knot[a->n - j];
}

TETCAST_DEF void tetcast_transfer_difference(const tetcast_transfer *a, const tetcast_transfer *b, float *lo,
                                             float *hi) {
    tetcasti_tf_difference(&a->tf, &b->tf, lo, hi);
}
/* ---------------------------------------------------------------------------
   integrate: segments of a ray -> colour and transmittance. Exact for piecewise  // >>integrate
   linear transfer functions; scalar and eight lanes with the same bits.
   The interface is in the section optics core.
   --------------------------------------------------------------------------- */

/* A piece is a part of a segment inside one interval of the transfer function: extinction and colour are linear along
   it. Let d be its length, m its optical depth, g = (extinction at its back - at its front) * d, x in [0, 1] the place
   along it, A(x) the optical depth up to x: quadratic, A(1) = m. With associated colours
       C = int_0^1 c(x) A'(x) e^-A(x) dx = alpha * (colour in the middle) - delta * (colour at the back - at the front)
       alpha = 1 - e^-m,   delta = int_0^1 (1/2 - x) A'(x) e^-A(x) dx = (1 + e^-m) / 2 - psi,   psi = int_0^1 e^-A(x) dx
   with psi as in Moreland and Angel (2004), whose form front * (1 - psi) + back * (psi - e^-m) loses digits when m is
   small; here nothing cancels. For m <= 1 both are polynomials, so no exponential is needed at all: with q = m^2,
       alpha = m Q(m),   delta = Q(m) S(q, g),   S = (q - g) B(q) - g^2 K(q, g),   q B = (m/2) coth(m/2) - 1
   (delta / Q is even in m for constant g). Minimax coefficients over |g| <= 2 m: alpha to 9e-8 of itself, delta to
   5e-7 of m. Deeper pieces are cut so that each part has m = 7/8; after 80 parts the light left is below e^-70 and is
   dropped. Independent colours: C = d * (psi * middle - alpha * (B + g K) * (back - front)).

   The colour is c0 + c1 u with u = value - base, so each piece adds w0 c0 + w1 c1 with two weights for all three
   channels. Multiplications and additions are fused as they are written here; the scalar forms are compiled once more
   for processors that have the instruction. */
enum {
    TETCASTI_KIND_ASSOCIATED = 0,
    TETCASTI_KIND_INDEPENDENT = 1,
    TETCASTI_KIND_EMISSION = 2,             /* associated colours */
    TETCASTI_KIND_EMISSION_INDEPENDENT = 3,
    TETCASTI_KIND_ABSORPTION = 4,
    TETCASTI_KIND_MAXIMUM = 5,
    TETCASTI_KIND_MAXIMUM_INDEPENDENT = 6
};
#define TETCASTI_CUT_DEPTH 1.75f /* twice the depth of a part */
#define TETCASTI_CUT_MAX 80
#define TETCASTI_Q0 0.99999994f
#define TETCASTI_Q1 -0.49999404f
#define TETCASTI_Q2 0.166600525f
#define TETCASTI_Q3 -0.041392263f
#define TETCASTI_Q4 0.00780597795f
#define TETCASTI_Q5 -0.000899531296f
#define TETCASTI_B0 0.083333306f
#define TETCASTI_B1 -0.00138681708f
#define TETCASTI_B2 2.98568666e-05f
#define TETCASTI_K0 0.00416612066f
#define TETCASTI_K1 0.00014838003f
#define TETCASTI_K2 4.06699337e-06f
#define TETCASTI_K3 -9.65771032e-05f
#define TETCASTI_K4 -3.16675869e-06f
#define TETCASTI_PER_MAX 3e38f /* length per value where two values are a denormal number apart */

/* ---- scalar ---- */

typedef struct tetcasti_weights {
    float w0, w1; /* weights of c0 and c1 */
    float drop;   /* what t loses */
} tetcasti_weights;

/* One piece with m <= 1: what it adds. um: u in the middle, ds: value at the back - at the front. */
TETCASTI_INLINE void tetcasti_weigh(const int kind, float t, float m, float g, float um, float ds, float d,
                                    tetcasti_weights *w) {
    if (kind == TETCASTI_KIND_EMISSION) {
        w->w0 = m;
        w->w1 = fmaf(m, um, (g * 0.0833333333f) * ds);
        w->drop = 0.0f;
    } else if (kind == TETCASTI_KIND_EMISSION_INDEPENDENT) {
        w->w0 = d;
        w->w1 = d * um;
        w->drop = 0.0f;
    } else if (kind == TETCASTI_KIND_ABSORPTION) {
        w->w0 = w->w1 = 0.0f;
        w->drop = m;
    } else {
        const float q = m * m;
        const float even = fmaf(q, fmaf(q, TETCASTI_Q4, TETCASTI_Q2), TETCASTI_Q0);
        const float odd = fmaf(q, fmaf(q, TETCASTI_Q5, TETCASTI_Q3), TETCASTI_Q1);
        const float qm = fmaf(m, odd, even);
        const float b = fmaf(q, fmaf(q, TETCASTI_B2, TETCASTI_B1), TETCASTI_B0);
        const float k = fmaf(q, fmaf(g, TETCASTI_K4, TETCASTI_K3), fmaf(g, fmaf(g, TETCASTI_K2, TETCASTI_K1),
                                                                        TETCASTI_K0));
        const float alpha = m * qm, delta = qm * fmaf(q - g, b, -((g * g) * k));
        w->drop = t * alpha;
        if (kind == TETCASTI_KIND_ASSOCIATED) {
            w->w0 = w->drop;
            w->w1 = fmaf(w->w0, um, -((t * delta) * ds));
        } else {
            const float td = t * d;
            w->w0 = td * (fmaf(-0.5f, alpha, 1.0f) - delta);
            w->w1 = fmaf(w->w0, um, -((td * (alpha * fmaf(g, k, b))) * ds));
        }
    }
}

TETCASTI_INLINE void tetcasti_add(const int kind, const int cue, const tetcast_optics *o, float k, const float *c,
                                  const tetcasti_weights *w, tetcasti_ray_sum *sum) {
    if (kind != TETCASTI_KIND_ABSORPTION) {
        const float w0 = cue ? k * w->w0 : w->w0, w1 = cue ? k * w->w1 : w->w1;
        const int fog = cue && kind <= TETCASTI_KIND_INDEPENDENT;
        const float wf = fog ? (1.0f - k) * w->drop : 0.0f;
        uint32_t i;
        for (i = 0; i < 3; i++) {
            float v = sum->c[i] + fmaf(w0, c[2 + 2 * i], w1 * c[3 + 2 * i]);
            if (fog) v = fmaf(wf, o->fog[i], v);
            sum->c[i] = v;
        }
    }
    sum->t = sum->t - w->drop;
}

/* Largest emission of a piece, times k: at its ends or, where a rising and a falling ramp meet, at the top between. */
TETCASTI_INLINE void tetcasti_piece_maximum(const int kind, float k, const float *c, float uf, float ds,
                                            float most[3]) {
    const float ub = uf + ds, tf = c[0] + c[1] * uf, tb = c[0] + c[1] * ub;
    uint32_t i;
    for (i = 0; i < 3; i++) {
        const float c0 = c[2 + 2 * i], c1 = c[3 + 2 * i];
        float f = c0 + c1 * uf, b = c0 + c1 * ub;
        if (kind == TETCASTI_KIND_MAXIMUM) {
            const float bend = c1 * c[1], slope = c0 * c[1] + c1 * c[0];
            const float sf = slope + (bend + bend) * uf, sb = slope + (bend + bend) * ub;
            f = f * tf;
            b = b * tb;
            if (bend < 0.0f && sf * sb < 0.0f) {
                const float top = c0 * c[0] - (slope * slope) / (4.0f * bend);
                f = f > top ? f : top;
            }
        }
        f = (f > b ? f : b) * k;
        most[i] = most[i] > f ? most[i] : f;
    }
}

/* A piece of interval coefficients c, from u = uf to uf + ds over the length d. */
TETCASTI_INLINE void tetcasti_piece(const int kind, const int cue, const tetcast_optics *o, float k, const float *c,
                                    float uf, float ds, float d, tetcasti_ray_sum *sum) {
    tetcasti_weights w;
    float um = fmaf(0.5f, ds, uf), tau = fmaf(c[1], um, c[0]), m, g;
    if (kind >= TETCASTI_KIND_MAXIMUM) {
        tetcasti_piece_maximum(kind, k, c, uf, ds, sum->c);
        return;
    }
    tau = tau > 0.0f ? tau : 0.0f;
    m = tau * d;
    g = (c[1] * ds) * d;
    if (kind <= TETCASTI_KIND_INDEPENDENT && TETCASTI_UNLIKELY(m > 1.0f)) {
        uint32_t cuts;
        for (cuts = 0; cuts < TETCASTI_CUT_MAX; cuts++) {
            float a, root, x, part_s, part_d;
            const int deep = m > 1.0f;
            if (m > 1e15f) d = d * (1e15f / m);
            a = fmaf(c[1], uf, c[0]) * d;
            a = a > 0.0f ? a : 0.0f;
            root = fmaf(a, a, TETCASTI_CUT_DEPTH * ((c[1] * ds) * d));
            x = TETCASTI_CUT_DEPTH / (a + sqrtf(root > 0.0f ? root : 0.0f));
            x = deep && x < 1.0f ? x : 1.0f;
            part_s = ds * x;
            part_d = d * x;
            um = fmaf(0.5f, part_s, uf);
            tau = fmaf(c[1], um, c[0]);
            tau = tau > 0.0f ? tau : 0.0f;
            m = tau * part_d;
            m = m < 1.0f ? m : 1.0f;
            g = (c[1] * part_s) * part_d;
            tetcasti_weigh(kind, sum->t, m, g, um, part_s, part_d, &w);
            tetcasti_add(kind, cue, o, k, c, &w, sum);
            if (x == 1.0f) return;
            uf = uf + part_s;
            ds = ds - part_s;
            d = d - part_d;
            tau = fmaf(c[1], fmaf(0.5f, ds, uf), c[0]);
            m = (tau > 0.0f ? tau : 0.0f) * d;
        }
        sum->t = 0.0f;
        return;
    }
    tetcasti_weigh(kind, sum->t, m, g, um, ds, d, &w);
    tetcasti_add(kind, cue, o, k, c, &w, sum);
}

TETCASTI_INLINE float tetcasti_cue(const tetcast_optics *o, float depth, float length) {
    float k = (depth + 0.5f * length) * o->cue_scale + o->cue_offset;
    k = k > o->cue_lo ? k : o->cue_lo;
    return k < o->cue_hi ? k : o->cue_hi;
}

/* Split at the knots between front and back, in the order of the ray. A piece that begins in the knot above or below it
   has no length and adds nothing, so one rule for both directions is enough. */
TETCASTI_INLINE void tetcasti_exact(const int kind, const int cue, const tetcast_optics *o, float front, float back,
                                    float length, float depth, tetcasti_ray_sum *sum) {
    const tetcasti_tf *tf = &o->tf;
    const float *c;
    uint32_t at;
    float per, k = 1.0f;
    if (!(sum->t > o->t_stop)) return;
    at = (uint32_t)sum->at;
    c = tf->coef[at];
    if (!(front >= c[TETCASTI_LOWER] && front < c[TETCASTI_UPPER])) {
        at = tetcasti_tf_find(tf, front);
        c = tf->coef[at];
        sum->at = (int32_t)at;
    }
    if (cue) k = tetcasti_cue(o, depth, length);
    if (kind >= TETCASTI_KIND_MAXIMUM) {
        if (!(length > 0.0f)) return;
        k = k * o->max_scale;
    }
    if (TETCASTI_LIKELY(!(back < c[TETCASTI_LOWER] || back > c[TETCASTI_UPPER]))) {
        tetcasti_piece(kind, cue, o, k, c, front - c[TETCASTI_BASE], back - front, length, sum);
        return;
    }
    per = length / (back - front);
    per = per < TETCASTI_PER_MAX ? per : TETCASTI_PER_MAX;
    per = per > -TETCASTI_PER_MAX ? per : -TETCASTI_PER_MAX;
    for (;;) {
        const float lo = c[TETCASTI_LOWER], hi = c[TETCASTI_UPPER], end = back < lo ? lo : back > hi ? hi : back;
        const float ds = end - front;
        tetcasti_piece(kind, cue, o, k, c, front - c[TETCASTI_BASE], ds, ds * per, sum);
        if (end == back) break;
        at = back > end ? at + 1 : at - 1;
        front = end;
        c = tf->coef[at];
    }
    sum->at = (int32_t)at;
}

#define TETCASTI_EXACT_FN(name, kind, cue) \
    static void name(const tetcast_optics *o, float front, float back, float length, float depth, \
                     tetcasti_ray_sum *sum) { \
        tetcasti_exact(kind, cue, o, front, back, length, depth, sum); \
    } \
    TETCASTI_TARGET_FMA static void name##_fma(const tetcast_optics *o, float front, float back, float length, \
                                               float depth, tetcasti_ray_sum *sum) { \
        tetcasti_exact(kind, cue, o, front, back, length, depth, sum); \
    }
TETCASTI_EXACT_FN(tetcasti_exact_associated, TETCASTI_KIND_ASSOCIATED, 0)
TETCASTI_EXACT_FN(tetcasti_exact_independent, TETCASTI_KIND_INDEPENDENT, 0)
TETCASTI_EXACT_FN(tetcasti_exact_emission, TETCASTI_KIND_EMISSION, 0)
TETCASTI_EXACT_FN(tetcasti_exact_emission_independent, TETCASTI_KIND_EMISSION_INDEPENDENT, 0)
TETCASTI_EXACT_FN(tetcasti_exact_absorption, TETCASTI_KIND_ABSORPTION, 0)
TETCASTI_EXACT_FN(tetcasti_exact_maximum, TETCASTI_KIND_MAXIMUM, 0)
TETCASTI_EXACT_FN(tetcasti_exact_maximum_independent, TETCASTI_KIND_MAXIMUM_INDEPENDENT, 0)
TETCASTI_EXACT_FN(tetcasti_exact_maximum_cue, TETCASTI_KIND_MAXIMUM, 1)
TETCASTI_EXACT_FN(tetcasti_exact_maximum_independent_cue, TETCASTI_KIND_MAXIMUM_INDEPENDENT, 1)
TETCASTI_EXACT_FN(tetcasti_exact_associated_cue, TETCASTI_KIND_ASSOCIATED, 1)
TETCASTI_EXACT_FN(tetcasti_exact_independent_cue, TETCASTI_KIND_INDEPENDENT, 1)
TETCASTI_EXACT_FN(tetcasti_exact_emission_cue, TETCASTI_KIND_EMISSION, 1)
TETCASTI_EXACT_FN(tetcasti_exact_emission_independent_cue, TETCASTI_KIND_EMISSION_INDEPENDENT, 1)
#undef TETCASTI_EXACT_FN

/* Eight lanes by the scalar form. */
TETCASTI_UNUSED static uint32_t tetcasti_lanes_by_one(tetcasti_segment_fn *fn, const tetcast_optics *o,
                                                      const tetcasti_seg8 *seg, uint32_t lanes,
                                                          tetcasti_ray_sum8 *sum) {
    uint32_t i, j, ended = 0;
    for (i = 0; i < 8; i++) {
        tetcasti_ray_sum one;
        if (!(lanes >> i & 1u)) continue;
        for (j = 0; j < 3; j++) one.c[j] = sum->c[j][i];
        for (j = 0; j < TETCASTI_CARRY; j++) one.carry[j] = sum->carry[j][i];
        one.t = sum->t[i];
        one.at = sum->at[i];
        fn(o, seg->front[i], seg->back[i], seg->length[i], seg->depth[i], &one);
        for (j = 0; j < 3; j++) sum->c[j][i] = one.c[j];
        for (j = 0; j < TETCASTI_CARRY; j++) sum->carry[j][i] = one.carry[j];
        sum->t[i] = one.t;
        sum->at[i] = one.at;
        ended |= (uint32_t)!(one.t > o->t_stop) << i;
    }
    return ended;
}
static uint32_t tetcasti_segment_lanes(const tetcast_optics *o, const tetcasti_seg8 *seg, uint32_t lanes,
                                       tetcasti_ray_sum8 *sum) {
    return tetcasti_lanes_by_one(o->segment, o, seg, lanes, sum);
}

/* ---- eight lanes, AVX2: the same operations in the same order ---- */

#if TETCASTI_AVX2

/* How the interval of each lane is found and its coefficients are fetched. */
enum {
    TETCASTI_TF_8 = 0,  /* up to 8 intervals: each row of coefficients is one register, permuted by the interval */
    TETCASTI_TF_16 = 1, /* up to 16: two registers */
    TETCASTI_TF_ANY = 2 /* more: one row of memory per lane, transposed; gathers are slower */
};

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256 tetcasti_row8(const int form, const float *row, __m256i at) {
    const __m256 a = _mm256_permutevar8x32_ps(_mm256_load_ps(row), at);
    if (form == TETCASTI_TF_8) return a;
    return _mm256_blendv_ps(a, _mm256_permutevar8x32_ps(_mm256_load_ps(row + 8), at),
                            _mm256_castsi256_ps(_mm256_slli_epi32(at, 28))); /* bit 3 of the interval */
}

typedef struct tetcasti_coef8 {
    __m256 lo, hi, base;
    __m256 c[8];
} tetcasti_coef8;

/* out[k] lane i = rec[at[i]][first + k], k < 4 */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_gather4(const float *const p[8], uint32_t first, __m256 out[4]) {
    const __m256 r0 = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(p[0] + first)),
                                           _mm_load_ps(p[4] + first), 1);
    const __m256 r1 = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(p[1] + first)),
                                           _mm_load_ps(p[5] + first), 1);
    const __m256 r2 = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(p[2] + first)),
                                           _mm_load_ps(p[6] + first), 1);
    const __m256 r3 = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(p[3] + first)),
                                           _mm_load_ps(p[7] + first), 1);
    const __m256 a = _mm256_unpacklo_ps(r0, r1), b = _mm256_unpacklo_ps(r2, r3);
    const __m256 c = _mm256_unpackhi_ps(r0, r1), d = _mm256_unpackhi_ps(r2, r3);
    out[0] = _mm256_shuffle_ps(a, b, 0x44);
    out[1] = _mm256_shuffle_ps(a, b, 0xee);
    out[2] = _mm256_shuffle_ps(c, d, 0x44);
    out[3] = _mm256_shuffle_ps(c, d, 0xee);
}

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256i tetcasti_find8(const int form, const tetcasti_tf *tf, __m256 s,
                                                             __m256i guess) {
    __m256i at = _mm256_setzero_si256();
    if (form != TETCASTI_TF_ANY) { /* as many knots as are <= s */
        const float *knot = tf->row + TETCASTI_ROW_SPLAT;
        __m256i more = at;
#define TETCASTI_LE(i) _mm256_castps_si256(_mm256_cmp_ps(_mm256_load_ps(knot + 8 * (i)), s, _CMP_LE_OQ))
        at = _mm256_sub_epi32(at, TETCASTI_LE(0));
        more = _mm256_sub_epi32(more, TETCASTI_LE(1));
        at = _mm256_sub_epi32(at, TETCASTI_LE(2));
        more = _mm256_sub_epi32(more, TETCASTI_LE(3));
        at = _mm256_sub_epi32(at, TETCASTI_LE(4));
        more = _mm256_sub_epi32(more, TETCASTI_LE(5));
        at = _mm256_sub_epi32(at, TETCASTI_LE(6));
        if (form == TETCASTI_TF_16) {
            more = _mm256_sub_epi32(more, TETCASTI_LE(7));
            at = _mm256_sub_epi32(at, TETCASTI_LE(8));
            more = _mm256_sub_epi32(more, TETCASTI_LE(9));
            at = _mm256_sub_epi32(at, TETCASTI_LE(10));
            more = _mm256_sub_epi32(more, TETCASTI_LE(11));
            at = _mm256_sub_epi32(at, TETCASTI_LE(12));
            more = _mm256_sub_epi32(more, TETCASTI_LE(13));
            at = _mm256_sub_epi32(at, TETCASTI_LE(14));
        }
        at = _mm256_add_epi32(at, more);
#undef TETCASTI_LE
    } else { /* the guess, where it is right */
        uint32_t i, wrong;
        float v[8];
        int32_t k[8];
        _mm256_storeu_si256((__m256i *)(void *)k, guess);
        _mm256_storeu_ps(v, s);
        for (i = 0, wrong = 0; i < 8; i++) {
            const float *c = tf->coef[k[i]];
            if (v[i] >= c[TETCASTI_LOWER] && v[i] < c[TETCASTI_UPPER]) continue;
            k[i] = (int32_t)tetcasti_tf_find(tf, v[i]);
            wrong = 1;
        }
        at = guess;
        if (wrong) at = _mm256_setr_epi32(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7]);
    }
    return at;
}

/* Bounds of the intervals `at`, and the two coefficients of extinction. */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_fetch_bounds8(const int form, const tetcasti_tf *tf, __m256i at,
                                                                 tetcasti_coef8 *c) {
    if (form != TETCASTI_TF_ANY) {
        c->lo = tetcasti_row8(form, tf->row, at);
        c->hi = tetcasti_row8(form, tf->row + 16, at);
        c->base = tetcasti_row8(form, tf->row + 32, at);
        c->c[0] = tetcasti_row8(form, tf->row + 48, at);
        c->c[1] = tetcasti_row8(form, tf->row + 64, at);
    } else {
        const char *rec = (const char *)tf->coef;
        const float *p[8];
        __m256 ends[4];
        const __m256i bytes = _mm256_slli_epi32(at, 6);
        const uint64_t a = (uint64_t)_mm_cvtsi128_si64(_mm256_castsi256_si128(bytes));
        const uint64_t b = (uint64_t)_mm_extract_epi64(_mm256_castsi256_si128(bytes), 1);
        const uint64_t d = (uint64_t)_mm_cvtsi128_si64(_mm256_extracti128_si256(bytes, 1));
        const uint64_t e = (uint64_t)_mm_extract_epi64(_mm256_extracti128_si256(bytes, 1), 1);
        p[0] = (const float *)(const void *)(rec + (uint32_t)a);
        p[1] = (const float *)(const void *)(rec + (a >> 32));
        p[2] = (const float *)(const void *)(rec + (uint32_t)b);
        p[3] = (const float *)(const void *)(rec + (b >> 32));
        p[4] = (const float *)(const void *)(rec + (uint32_t)d);
        p[5] = (const float *)(const void *)(rec + (d >> 32));
        p[6] = (const float *)(const void *)(rec + (uint32_t)e);
        p[7] = (const float *)(const void *)(rec + (e >> 32));
        tetcasti_gather4(p, 8, ends);
        tetcasti_gather4(p, 0, c->c);
        tetcasti_gather4(p, 4, c->c + 4);
        c->lo = ends[0];
        c->hi = ends[1];
        c->base = ends[2];
    }
}
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_fetch_colors8(const int form, const tetcasti_tf *tf, __m256i at,
                                                                 tetcasti_coef8 *c) {
    if (form == TETCASTI_TF_ANY) return; /* done */
    c->c[2] = tetcasti_row8(form, tf->row + 80, at);
    c->c[3] = tetcasti_row8(form, tf->row + 96, at);
    c->c[4] = tetcasti_row8(form, tf->row + 112, at);
    c->c[5] = tetcasti_row8(form, tf->row + 128, at);
    c->c[6] = tetcasti_row8(form, tf->row + 144, at);
    c->c[7] = tetcasti_row8(form, tf->row + 160, at);
}

#define TETCASTI_M(a, b) _mm256_mul_ps(a, b)
#define TETCASTI_A(a, b) _mm256_add_ps(a, b)
#define TETCASTI_S(a, b) _mm256_sub_ps(a, b)
#define TETCASTI_V(x) _mm256_set1_ps(x)
#define TETCASTI_F(a, b, c) _mm256_fmadd_ps(a, b, c)

typedef struct tetcasti_acc8 {
    __m256 c[3], t;
    __m256 live; /* lanes that have not ended */
    __m256i at;  /* intervals */
} tetcasti_acc8;

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_add8(const int kind, const int cue, const tetcast_optics *o,
                                                        __m256 k, const tetcasti_coef8 *c, __m256 m, __m256 g,
                                                        __m256 um, __m256 ds, __m256 d, tetcasti_acc8 *sum) {
    const __m256 t = _mm256_and_ps(sum->live, sum->t); /* late: the rest does not wait for the segment before */
    __m256 w0 = m, w1 = m, drop = m, wf = m;
    const int fog = cue && kind <= TETCASTI_KIND_INDEPENDENT;
    if (kind == TETCASTI_KIND_EMISSION) {
        w1 = TETCASTI_F(m, um, TETCASTI_M(TETCASTI_M(g, TETCASTI_V(0.0833333333f)), ds));
    } else if (kind == TETCASTI_KIND_EMISSION_INDEPENDENT) {
        w0 = d;
        w1 = TETCASTI_M(d, um);
    } else if (kind == TETCASTI_KIND_ABSORPTION) {
        drop = _mm256_and_ps(sum->live, m);
    } else {
        const __m256 q = TETCASTI_M(m, m);
        const __m256 even = TETCASTI_F(q, TETCASTI_F(q, TETCASTI_V(TETCASTI_Q4), TETCASTI_V(TETCASTI_Q2)),
                                       TETCASTI_V(TETCASTI_Q0));
        const __m256 odd = TETCASTI_F(q, TETCASTI_F(q, TETCASTI_V(TETCASTI_Q5), TETCASTI_V(TETCASTI_Q3)),
                                      TETCASTI_V(TETCASTI_Q1));
        const __m256 qm = TETCASTI_F(m, odd, even);
        const __m256 b = TETCASTI_F(q, TETCASTI_F(q, TETCASTI_V(TETCASTI_B2), TETCASTI_V(TETCASTI_B1)),
                                    TETCASTI_V(TETCASTI_B0));
        const __m256 kg = TETCASTI_F(q, TETCASTI_F(g, TETCASTI_V(TETCASTI_K4), TETCASTI_V(TETCASTI_K3)),
                                     TETCASTI_F(g, TETCASTI_F(g, TETCASTI_V(TETCASTI_K2), TETCASTI_V(TETCASTI_K1)),
                                                TETCASTI_V(TETCASTI_K0)));
        const __m256 alpha = TETCASTI_M(m, qm);
        const __m256 delta = TETCASTI_M(qm, _mm256_fmsub_ps(TETCASTI_S(q, g), b, TETCASTI_M(TETCASTI_M(g, g), kg)));
        drop = TETCASTI_M(t, alpha);
        if (kind == TETCASTI_KIND_ASSOCIATED) {
            w0 = drop;
            w1 = _mm256_fmsub_ps(w0, um, TETCASTI_M(TETCASTI_M(t, delta), ds));
        } else {
            const __m256 td = TETCASTI_M(t, d);
            w0 = TETCASTI_M(td, TETCASTI_S(TETCASTI_F(TETCASTI_V(-0.5f), alpha, TETCASTI_V(1.0f)), delta));
            w1 = _mm256_fmsub_ps(w0, um, TETCASTI_M(TETCASTI_M(td, TETCASTI_M(alpha, TETCASTI_F(g, kg, b))), ds));
        }
    }
    if (kind != TETCASTI_KIND_ABSORPTION) {
        if (cue) {
            w0 = TETCASTI_M(k, w0);
            w1 = TETCASTI_M(k, w1);
            if (fog) wf = TETCASTI_M(TETCASTI_S(TETCASTI_V(1.0f), k), drop);
        }
#define TETCASTI_CHANNEL(i) \
        sum->c[i] = TETCASTI_A(sum->c[i], TETCASTI_F(w0, c->c[2 + 2 * (i)], TETCASTI_M(w1, c->c[3 + 2 * (i)]))); \
        if (fog) sum->c[i] = TETCASTI_F(wf, TETCASTI_V(o->fog[i]), sum->c[i])
        TETCASTI_CHANNEL(0);
        TETCASTI_CHANNEL(1);
        TETCASTI_CHANNEL(2);
#undef TETCASTI_CHANNEL
    }
    if (kind <= TETCASTI_KIND_INDEPENDENT || kind == TETCASTI_KIND_ABSORPTION) sum->t = TETCASTI_S(sum->t, drop);
}

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_maximum8(const int kind, __m256 k, const tetcasti_coef8 *c,
                                                            __m256 uf, __m256 ds, tetcasti_acc8 *sum) {
    const __m256 ub = TETCASTI_A(uf, ds), zero = _mm256_setzero_ps();
    const __m256 tf = TETCASTI_A(c->c[0], TETCASTI_M(c->c[1], uf)), tb = TETCASTI_A(c->c[0], TETCASTI_M(c->c[1], ub));
    uint32_t i;
    for (i = 0; i < 3; i++) {
        const __m256 c0 = c->c[2 + 2 * i], c1 = c->c[3 + 2 * i];
        __m256 f = TETCASTI_A(c0, TETCASTI_M(c1, uf)), b = TETCASTI_A(c0, TETCASTI_M(c1, ub));
        if (kind == TETCASTI_KIND_MAXIMUM) {
            const __m256 bend = TETCASTI_M(c1, c->c[1]), twice = TETCASTI_A(bend, bend);
            const __m256 slope = TETCASTI_A(TETCASTI_M(c0, c->c[1]), TETCASTI_M(c1, c->c[0]));
            const __m256 turn = TETCASTI_M(TETCASTI_A(slope, TETCASTI_M(twice, uf)),
                                           TETCASTI_A(slope, TETCASTI_M(twice, ub)));
            const __m256 inside = _mm256_and_ps(_mm256_cmp_ps(bend, zero, _CMP_LT_OQ),
                                                _mm256_cmp_ps(turn, zero, _CMP_LT_OQ));
            f = TETCASTI_M(f, tf);
            b = TETCASTI_M(b, tb);
            if (_mm256_movemask_ps(inside) != 0) {
                const __m256 top = TETCASTI_S(TETCASTI_M(c0, c->c[0]), _mm256_div_ps(TETCASTI_M(slope, slope),
                                              TETCASTI_M(TETCASTI_V(4.0f), bend)));
                f = _mm256_blendv_ps(f, _mm256_max_ps(f, top), inside);
            }
        }
        f = TETCASTI_M(_mm256_max_ps(f, b), k);
        sum->c[i] = _mm256_max_ps(sum->c[i], f);
    }
}

TETCASTI_TARGET_WALK TETCASTI_INLINE __m256 tetcasti_tau8(const tetcasti_coef8 *c, __m256 u) {
    return _mm256_max_ps(TETCASTI_F(c->c[1], u, c->c[0]), _mm256_setzero_ps());
}

/* Lanes whose segment crosses knots or has pieces deeper than 1: all lanes in step, one part of a piece at a time,
   until the last lane is through; lanes that are done go on with length 0, which adds nothing. */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_exact8_parts(const int form, const int kind, const int cue,
                                                                const tetcast_optics *o, __m256 k, __m256 front,
                                                                __m256 back, __m256 length, tetcasti_coef8 *c,
                                                                tetcasti_acc8 *sum) {
    const __m256 one = TETCASTI_V(1.0f), cut_depth = TETCASTI_V(TETCASTI_CUT_DEPTH), zero = _mm256_setzero_ps();
    const __m256i step = _mm256_or_si256(_mm256_castps_si256(_mm256_cmp_ps(back, front, _CMP_LT_OQ)),
                                         _mm256_set1_epi32(1));
    __m256 end = _mm256_min_ps(_mm256_max_ps(back, c->lo), c->hi);
    __m256 cross = _mm256_or_ps(_mm256_cmp_ps(back, c->lo, _CMP_LT_OQ), _mm256_cmp_ps(back, c->hi, _CMP_GT_OQ));
    __m256 per = _mm256_div_ps(length, TETCASTI_S(back, front));
    __m256 uf = TETCASTI_S(front, c->base), ds, d;
    __m256i cuts = _mm256_setzero_si256(), at = sum->at;
    per = _mm256_max_ps(_mm256_min_ps(per, TETCASTI_V(TETCASTI_PER_MAX)), TETCASTI_V(-TETCASTI_PER_MAX));
    per = _mm256_and_ps(per, cross);
    end = _mm256_blendv_ps(back, end, cross);
    ds = TETCASTI_S(end, front);
    d = _mm256_blendv_ps(length, TETCASTI_M(ds, per), cross);
    for (;;) {
        __m256 um = TETCASTI_F(TETCASTI_V(0.5f), ds, uf), m = TETCASTI_M(tetcasti_tau8(c, um), d), g, deep;
        int any;
        tetcasti_fetch_colors8(form, &o->tf, at, c);
        deep = kind <= TETCASTI_KIND_INDEPENDENT ? _mm256_cmp_ps(m, one, _CMP_GT_OQ) : zero;
        if (kind <= TETCASTI_KIND_INDEPENDENT && _mm256_movemask_ps(deep) != 0) {
            const __m256 most = TETCASTI_V(1e15f);
            __m256 a, root, x, part_s, part_d, spent;
            d = _mm256_blendv_ps(d, TETCASTI_M(d, _mm256_div_ps(most, m)), _mm256_cmp_ps(m, most, _CMP_GT_OQ));
            a = _mm256_max_ps(TETCASTI_M(TETCASTI_F(c->c[1], uf, c->c[0]), d), zero);
            root = TETCASTI_F(a, a, TETCASTI_M(cut_depth, TETCASTI_M(TETCASTI_M(c->c[1], ds), d)));
            x = _mm256_div_ps(cut_depth, TETCASTI_A(a, _mm256_sqrt_ps(_mm256_max_ps(root, zero))));
            deep = _mm256_and_ps(deep, _mm256_cmp_ps(x, one, _CMP_LT_OQ));
            x = _mm256_blendv_ps(one, x, deep);
            part_s = TETCASTI_M(ds, x);
            part_d = TETCASTI_M(d, x);
            um = TETCASTI_F(TETCASTI_V(0.5f), part_s, uf);
            m = _mm256_min_ps(TETCASTI_M(tetcasti_tau8(c, um), part_d), one);
            g = TETCASTI_M(TETCASTI_M(c->c[1], part_s), part_d);
            tetcasti_add8(kind, cue, o, k, c, m, g, um, part_s, part_d, sum);
            cuts = _mm256_sub_epi32(_mm256_and_si256(cuts, _mm256_castps_si256(deep)), _mm256_castps_si256(deep));
            spent = _mm256_castsi256_ps(_mm256_cmpeq_epi32(cuts, _mm256_set1_epi32(TETCASTI_CUT_MAX)));
            sum->t = _mm256_andnot_ps(_mm256_and_ps(spent, sum->live), sum->t);
            deep = _mm256_andnot_ps(spent, deep);
            uf = TETCASTI_A(uf, part_s);
            ds = TETCASTI_S(ds, part_s);
            d = TETCASTI_S(d, part_d);
            any = _mm256_movemask_ps(_mm256_or_ps(deep, cross));
        } else {
            g = TETCASTI_M(TETCASTI_M(c->c[1], ds), d);
            if (kind >= TETCASTI_KIND_MAXIMUM) tetcasti_maximum8(kind, k, c, uf, ds, sum);
            else tetcasti_add8(kind, cue, o, k, c, m, g, um, ds, d, sum);
            deep = zero; /* known: so the next piece need not wait for the depth of this one */
            any = _mm256_movemask_ps(cross);
        }
        if (any == 0) {
            sum->at = at;
            return;
        }
        { /* lanes that are through with their interval go to the next one, or to a stretch of no length */
            const __m256 go = _mm256_andnot_ps(deep, cross);
            const __m256 from = end;
            at = _mm256_add_epi32(at, _mm256_and_si256(step, _mm256_castps_si256(go)));
            per = _mm256_and_ps(per, cross);
            tetcasti_fetch_bounds8(form, &o->tf, at, c);
            end = _mm256_blendv_ps(end, _mm256_min_ps(_mm256_max_ps(back, c->lo), c->hi), go);
            uf = _mm256_blendv_ps(uf, TETCASTI_S(from, c->base), go);
            ds = _mm256_blendv_ps(_mm256_and_ps(ds, deep), TETCASTI_S(end, from), go);
            d = _mm256_blendv_ps(_mm256_and_ps(d, deep), TETCASTI_M(ds, per), go);
            cuts = _mm256_andnot_si256(_mm256_castps_si256(go), cuts);
            cross = _mm256_and_ps(cross, _mm256_or_ps(deep, _mm256_cmp_ps(end, back, _CMP_NEQ_OQ)));
        }
    }
}

/* What both forms below begin with. Lanes that are off get values and length 0, which adds nothing. */
typedef struct tetcasti_start8 {
    __m256 front, back, length, k;
    tetcasti_coef8 c;
    tetcasti_acc8 acc;
} tetcasti_start8;

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_start8_of(const int form, const int kind, const int cue,
                                                             const int found, const tetcast_optics *o,
                                                             const tetcasti_seg8 *seg, uint32_t lanes,
                                                             const tetcasti_ray_sum8 *sum, tetcasti_start8 *s) {
    const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    const __m256 on = _mm256_castsi256_ps(_mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32((int32_t)lanes), bit),
                                                             bit));
    __m256i guess = _mm256_setzero_si256();
    s->front = _mm256_and_ps(on, _mm256_loadu_ps(seg->front));
    s->back = _mm256_and_ps(on, _mm256_loadu_ps(seg->back));
    s->length = _mm256_and_ps(on, _mm256_loadu_ps(seg->length));
    s->k = on;
    if (cue) {
        __m256 k = TETCASTI_A(_mm256_and_ps(on, _mm256_loadu_ps(seg->depth)), TETCASTI_M(TETCASTI_V(0.5f), s->length));
        k = TETCASTI_A(TETCASTI_M(k, TETCASTI_V(o->cue_scale)), TETCASTI_V(o->cue_offset));
        s->k = _mm256_min_ps(_mm256_max_ps(k, TETCASTI_V(o->cue_lo)), TETCASTI_V(o->cue_hi));
    }
    if (kind >= TETCASTI_KIND_MAXIMUM) {
        s->k = TETCASTI_M(cue ? s->k : TETCASTI_V(1.0f), TETCASTI_V(o->max_scale));
        s->k = _mm256_and_ps(s->k, _mm256_cmp_ps(s->length, _mm256_setzero_ps(), _CMP_GT_OQ));
    }
    if (form == TETCASTI_TF_ANY || found) {
        guess = _mm256_and_si256(_mm256_loadu_si256((const __m256i *)(const void *)sum->at), _mm256_castps_si256(on));
    }
    s->acc.at = found ? guess : tetcasti_find8(form, &o->tf, s->front, guess);
    tetcasti_fetch_bounds8(form, &o->tf, s->acc.at, &s->c);
    s->acc.c[0] = _mm256_loadu_ps(sum->c[0]);
    s->acc.c[1] = _mm256_loadu_ps(sum->c[1]);
    s->acc.c[2] = _mm256_loadu_ps(sum->c[2]);
    s->acc.t = _mm256_loadu_ps(sum->t);
    s->acc.live = _mm256_cmp_ps(s->acc.t, TETCASTI_V(o->t_stop), _CMP_GT_OQ);
}

TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_end8_of(const int form, const tetcast_optics *o, uint32_t lanes,
                                                               const tetcasti_acc8 *acc, tetcasti_ray_sum8 *sum) {
    _mm256_storeu_ps(sum->c[0], acc->c[0]);
    _mm256_storeu_ps(sum->c[1], acc->c[1]);
    _mm256_storeu_ps(sum->c[2], acc->c[2]);
    _mm256_storeu_ps(sum->t, acc->t);
    if (form == TETCASTI_TF_ANY) _mm256_storeu_si256((__m256i *)(void *)sum->at, acc->at);
    return ~(uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(acc->t, TETCASTI_V(o->t_stop), _CMP_GT_OQ)) & lanes;
}

TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_exact8_slow(const int form, const int kind, const int cue,
                                                                   const tetcast_optics *o, const tetcasti_seg8 *seg,
                                                                   uint32_t lanes, tetcasti_ray_sum8 *sum) {
    tetcasti_start8 s;
    tetcasti_start8_of(form, kind, cue, form != TETCASTI_TF_ANY, o, seg, lanes, sum, &s);
    tetcasti_exact8_parts(form, kind, cue, o, s.k, s.front, s.back, s.length, &s.c, &s.acc);
    return tetcasti_end8_of(form, o, lanes, &s.acc, sum);
}

/* One or two pieces, none deeper than 1: nearly all steps. With one lane in nine crossing a knot, half of the steps
   have a lane that does, so two pieces are done without a loop. The rest goes to `slow`, a function of its own that
   loads all again but for the intervals: with both in one the compiler keeps half of the registers in memory. */
TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_exact8(const int form, const int kind, const int cue,
                                                              tetcasti_segment8_fn *slow, const tetcast_optics *o,
                                                              const tetcasti_seg8 *seg, uint32_t lanes,
                                                              tetcasti_ray_sum8 *sum) {
    const __m256 one = TETCASTI_V(1.0f), half = TETCASTI_V(0.5f);
    tetcasti_start8 s;
    __m256 m, um, ds, d, cross;
    if (form == TETCASTI_TF_ANY) return slow(o, seg, lanes, sum); /* so many knots are nearly always in the way */
    tetcasti_start8_of(form, kind, cue, 0, o, seg, lanes, sum, &s);
    cross = _mm256_or_ps(_mm256_cmp_ps(s.back, s.c.lo, _CMP_LT_OQ), _mm256_cmp_ps(s.back, s.c.hi, _CMP_GT_OQ));
    ds = TETCASTI_S(s.back, s.front);
    d = s.length;
    if (_mm256_movemask_ps(cross) == 0) {
        um = TETCASTI_F(half, ds, TETCASTI_S(s.front, s.c.base));
        m = TETCASTI_M(tetcasti_tau8(&s.c, um), d);
        if (kind <= TETCASTI_KIND_INDEPENDENT && _mm256_movemask_ps(_mm256_cmp_ps(m, one, _CMP_GT_OQ)) != 0) {
            _mm256_storeu_si256((__m256i *)(void *)sum->at, s.acc.at);
            return slow(o, seg, lanes, sum);
        }
        if (kind >= TETCASTI_KIND_MAXIMUM) {
            tetcasti_fetch_colors8(form, &o->tf, s.acc.at, &s.c);
            tetcasti_maximum8(kind, s.k, &s.c, TETCASTI_S(s.front, s.c.base), ds, &s.acc);
        } else if (kind == TETCASTI_KIND_INDEPENDENT || kind == TETCASTI_KIND_EMISSION_INDEPENDENT ||
            !_mm256_testz_si256(_mm256_castps_si256(m), _mm256_castps_si256(m))) { /* else all are transparent */
            if (kind != TETCASTI_KIND_ABSORPTION) tetcasti_fetch_colors8(form, &o->tf, s.acc.at, &s.c);
            tetcasti_add8(kind, cue, o, s.k, &s.c, m, TETCASTI_M(TETCASTI_M(s.c.c[1], ds), d), um, ds, d, &s.acc);
        }
    } else {
        const __m256 end = _mm256_min_ps(_mm256_max_ps(s.back, s.c.lo), s.c.hi);
        const __m256i down = _mm256_castps_si256(_mm256_cmp_ps(s.back, s.front, _CMP_LT_OQ));
        const __m256i step = _mm256_and_si256(_mm256_or_si256(down, _mm256_set1_epi32(1)), _mm256_castps_si256(cross));
        const __m256i at = _mm256_add_epi32(s.acc.at, step);
        __m256 per = _mm256_div_ps(d, ds), um2, m2, ds2, d2, deep;
        tetcasti_coef8 c2;
        per = _mm256_max_ps(_mm256_min_ps(per, TETCASTI_V(TETCASTI_PER_MAX)), TETCASTI_V(-TETCASTI_PER_MAX));
        tetcasti_fetch_bounds8(form, &o->tf, at, &c2);
        ds2 = _mm256_and_ps(TETCASTI_S(s.back, end), cross);
        d2 = _mm256_and_ps(TETCASTI_M(ds2, per), cross);
        ds = _mm256_blendv_ps(ds, TETCASTI_S(end, s.front), cross);
        d = _mm256_blendv_ps(d, TETCASTI_M(ds, per), cross);
        um = TETCASTI_F(half, ds, TETCASTI_S(s.front, s.c.base));
        um2 = TETCASTI_F(half, ds2, TETCASTI_S(end, c2.base));
        m = TETCASTI_M(tetcasti_tau8(&s.c, um), d);
        m2 = TETCASTI_M(tetcasti_tau8(&c2, um2), d2);
        deep = _mm256_or_ps(_mm256_cmp_ps(s.back, c2.lo, _CMP_LT_OQ), _mm256_cmp_ps(s.back, c2.hi, _CMP_GT_OQ));
        deep = _mm256_and_ps(deep, cross);
        if (kind <= TETCASTI_KIND_INDEPENDENT) {
            deep = _mm256_or_ps(deep, _mm256_cmp_ps(_mm256_max_ps(m, m2), one, _CMP_GT_OQ));
        }
        if (kind >= TETCASTI_KIND_MAXIMUM || _mm256_movemask_ps(deep) != 0) {
            _mm256_storeu_si256((__m256i *)(void *)sum->at, s.acc.at);
            return slow(o, seg, lanes, sum);
        }
        if (kind != TETCASTI_KIND_ABSORPTION) {
            tetcasti_fetch_colors8(form, &o->tf, s.acc.at, &s.c);
            tetcasti_fetch_colors8(form, &o->tf, at, &c2);
        }
        tetcasti_add8(kind, cue, o, s.k, &s.c, m, TETCASTI_M(TETCASTI_M(s.c.c[1], ds), d), um, ds, d, &s.acc);
        tetcasti_add8(kind, cue, o, s.k, &c2, m2, TETCASTI_M(TETCASTI_M(c2.c[1], ds2), d2), um2, ds2, d2, &s.acc);
    }
    return tetcasti_end8_of(form, o, lanes, &s.acc, sum);
}

#define TETCASTI_EXACT8_FN(name, form, kind, cue) \
    TETCASTI_TARGET_WALK TETCASTI_NOINLINE static uint32_t name##_slow( \
        const tetcast_optics *o, const tetcasti_seg8 *seg, uint32_t lanes, tetcasti_ray_sum8 *sum) { \
        return tetcasti_exact8_slow(form, kind, cue, o, seg, lanes, sum); \
    } \
    TETCASTI_TARGET_WALK static uint32_t name(const tetcast_optics *o, const tetcasti_seg8 *seg, uint32_t lanes, \
                                              tetcasti_ray_sum8 *sum) { \
        return tetcasti_exact8(form, kind, cue, name##_slow, o, seg, lanes, sum); \
    }
TETCASTI_EXACT8_FN(tetcasti_exact8_associated_8, TETCASTI_TF_8, TETCASTI_KIND_ASSOCIATED, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_associated_16, TETCASTI_TF_16, TETCASTI_KIND_ASSOCIATED, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_associated_any, TETCASTI_TF_ANY, TETCASTI_KIND_ASSOCIATED, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_associated_cue, TETCASTI_TF_ANY, TETCASTI_KIND_ASSOCIATED, 1)
TETCASTI_EXACT8_FN(tetcasti_exact8_independent_16, TETCASTI_TF_16, TETCASTI_KIND_INDEPENDENT, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_independent_any, TETCASTI_TF_ANY, TETCASTI_KIND_INDEPENDENT, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_independent_cue, TETCASTI_TF_ANY, TETCASTI_KIND_INDEPENDENT, 1)
TETCASTI_EXACT8_FN(tetcasti_exact8_emission_16, TETCASTI_TF_16, TETCASTI_KIND_EMISSION, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_emission_any, TETCASTI_TF_ANY, TETCASTI_KIND_EMISSION, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_emission_cue, TETCASTI_TF_ANY, TETCASTI_KIND_EMISSION, 1)
TETCASTI_EXACT8_FN(tetcasti_exact8_emission_independent_any, TETCASTI_TF_ANY, TETCASTI_KIND_EMISSION_INDEPENDENT, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_emission_independent_cue, TETCASTI_TF_ANY, TETCASTI_KIND_EMISSION_INDEPENDENT, 1)
TETCASTI_EXACT8_FN(tetcasti_exact8_absorption_16, TETCASTI_TF_16, TETCASTI_KIND_ABSORPTION, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_maximum_16, TETCASTI_TF_16, TETCASTI_KIND_MAXIMUM, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_maximum_any, TETCASTI_TF_ANY, TETCASTI_KIND_MAXIMUM, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_maximum_cue, TETCASTI_TF_ANY, TETCASTI_KIND_MAXIMUM, 1)
TETCASTI_EXACT8_FN(tetcasti_exact8_maximum_independent_any, TETCASTI_TF_ANY, TETCASTI_KIND_MAXIMUM_INDEPENDENT, 0)
TETCASTI_EXACT8_FN(tetcasti_exact8_maximum_independent_cue, TETCASTI_TF_ANY, TETCASTI_KIND_MAXIMUM_INDEPENDENT, 1)
TETCASTI_EXACT8_FN(tetcasti_exact8_absorption_any, TETCASTI_TF_ANY, TETCASTI_KIND_ABSORPTION, 0)
#undef TETCASTI_EXACT8_FN
#undef TETCASTI_M
#undef TETCASTI_A
#undef TETCASTI_S
#undef TETCASTI_V
#undef TETCASTI_F

#endif /* TETCASTI_AVX2 */
/* ---------------------------------------------------------------------------
   tables: the integrators of the thesis and of its time: sampling rules,         // >>tables
   prefix integrals, the psi table, pre-integrated tables and how to build them.
   --------------------------------------------------------------------------- */

/* e^-x for x >= 0; relative error < 2e-7 */
TETCASTI_INLINE float tetcasti_exp_neg(float x) {
    float y, n, r, p;
    uint32_t bits;
    if (!(x < 87.0f)) return 0.0f;
    y = x * -1.44269504f;
    n = (float)(int32_t)(y - 0.5f); /* nearest, y <= 0 */
    r = x * -1.0f - n * 0.693145752f;
    r = r - n * 1.42860677e-6f;
    p = 1.0f + r * (1.0f + r * (0.5f + r * (0.166666667f + r * (0.0416666667f +
                                                                r * (0.00833333333f + r * 0.00138888889f)))));
    bits = (uint32_t)((int32_t)n + 127) << 23;
    memcpy(&r, &bits, sizeof r);
    return p * r;
}

/* Composite what one stretch gives: associated colour and opacity. */
TETCASTI_INLINE void tetcasti_over(const tetcast_optics *o, const float color[3], float alpha, float depth,
                                   float length, tetcasti_ray_sum *sum) {
    uint32_t i;
    if (o->cue) {
        const float k = tetcasti_cue(o, depth, length), wf = (1.0f - k) * (sum->t * alpha), w = k * sum->t;
        for (i = 0; i < 3; i++) sum->c[i] = sum->c[i] + (w * color[i] + wf * o->fog[i]);
    } else {
        for (i = 0; i < 3; i++) sum->c[i] = sum->c[i] + sum->t * color[i];
    }
    sum->t = sum->t - sum->t * alpha;
}

/* Extinction and colour at a value: out[0], out[1..3]. */
TETCASTI_INLINE void tetcasti_tf_at(const tetcasti_tf *tf, float s, float out[4]) {
    const uint32_t k = tetcasti_tf_find(tf, s);
    const float *c = tf->coef[k], u = s - c[TETCASTI_BASE];
    out[0] = c[0] + c[1] * u;
    out[0] = out[0] > 0.0f ? out[0] : 0.0f;
    out[1] = c[2] + c[3] * u;
    out[2] = c[4] + c[5] * u;
    out[3] = c[6] + c[7] * u;
}

/* ---- sampling ---- */

/* A stretch of length d with the mean extinction tau and the mean emission e (associated colour: attenuated as if both
   were constant; independent colour: self-attenuation neglected, as in the Riemann sum of the thesis). */
TETCASTI_INLINE float tetcasti_mean_alpha(const tetcast_optics *o, float tau, float d, float *color_scale) {
    const float m = tau * d, alpha = 1.0f - tetcasti_exp_neg(m);
    *color_scale = o->tf.independent || !(m > 1e-4f) ? d : alpha / tau;
    return alpha;
}

static void tetcasti_sample(const tetcast_optics *o, float front, float back, float length, float depth, float offset,
                            tetcasti_ray_sum *sum) {
    const float n = (float)o->samples, d = length / n;
    uint32_t i, j;
    for (i = 0; i < o->samples && sum->t > o->t_stop; i++) {
        float v[4], color[3], scale, alpha;
        tetcasti_tf_at(&o->tf, front + (back - front) * (((float)i + offset) / n), v);
        alpha = tetcasti_mean_alpha(o, v[0], d, &scale);
        for (j = 0; j < 3; j++) color[j] = (o->tf.independent ? v[1 + j] : v[0] * v[1 + j]) * scale;
        tetcasti_over(o, color, alpha, depth + d * (float)i, d, sum);
    }
}
static void tetcasti_segment_riemann(const tetcast_optics *o, float front, float back, float length, float depth,
                                     tetcasti_ray_sum *sum) {
    tetcasti_sample(o, front, back, length, depth, 0.0f, sum);
}
static void tetcasti_segment_midpoint(const tetcast_optics *o, float front, float back, float length, float depth,
                                      tetcasti_ray_sum *sum) {
    tetcasti_sample(o, front, back, length, depth, 0.5f, sum);
}
static void tetcasti_segment_trapezoid(const tetcast_optics *o, float front, float back, float length, float depth,
                                       tetcasti_ray_sum *sum) {
    const float n = (float)o->samples, d = length / n;
    float a[4], b[4];
    uint32_t i, j;
    tetcasti_tf_at(&o->tf, front, a);
    for (i = 0; i < o->samples && sum->t > o->t_stop; i++) {
        float color[3], scale, alpha;
        tetcasti_tf_at(&o->tf, i + 1 < o->samples ? front + (back - front) * ((float)(i + 1) / n) : back, b);
        alpha = tetcasti_mean_alpha(o, 0.5f * (a[0] + b[0]), d, &scale);
        for (j = 0; j < 3; j++) {
            const float e = o->tf.independent ? a[1 + j] + b[1 + j] : a[0] * a[1 + j] + b[0] * b[1 + j];
            color[j] = 0.5f * e * scale;
        }
        tetcasti_over(o, color, alpha, depth + d * (float)i, d, sum);
        memcpy(a, b, sizeof a);
    }
}

/* Colour and extinction linear between two ends: v[0] extinction, v[1..3] colour. Exact. */
TETCASTI_INLINE void tetcasti_segment_linear(const tetcast_optics *o, const float front[4], const float back[4],
                                             float length, float depth, tetcasti_ray_sum *sum) {
    float c[8], k = 1.0f;
    uint32_t i;
    if (!(sum->t > o->t_stop)) return;
    for (i = 0; i < 4; i++) {
        c[2 * i] = front[i];
        c[2 * i + 1] = back[i] - front[i];
    }
    if (o->cue) k = tetcasti_cue(o, depth, length);
    if (o->tf.independent) tetcasti_piece(TETCASTI_KIND_INDEPENDENT, 1, o, k, c, 0.0f, 1.0f, length, sum);
    else tetcasti_piece(TETCASTI_KIND_ASSOCIATED, 1, o, k, c, 0.0f, 1.0f, length, sum);
}
TETCASTI_INLINE void tetcasti_pre(const tetcast_optics *o, float front, float back, float length, float depth,
                                  tetcasti_ray_sum *sum) {
    float a[4], b[4];
    tetcasti_tf_at(&o->tf, front, a);
    tetcasti_tf_at(&o->tf, back, b);
    tetcasti_segment_linear(o, a, b, length, depth, sum);
}
static void tetcasti_segment_pre(const tetcast_optics *o, float front, float back, float length, float depth,
                                 tetcasti_ray_sum *sum) {
    tetcasti_pre(o, front, back, length, depth, sum);
}
TETCASTI_TARGET_FMA static void tetcasti_segment_pre_fma(const tetcast_optics *o, float front, float back,
                                                         float length, float depth, tetcasti_ray_sum *sum) {
    tetcasti_pre(o, front, back, length, depth, sum);
}

/* ---- prefix integrals: self-attenuation neglected (Engel et al., 2001) ---- */

/* Means between two values: extinction, r, g, b emission. */
static void tetcasti_prefix_mean(const tetcasti_tf *tf, float front, float back, double mean[4]) {
    const uint32_t a = tetcasti_tf_find(tf, front);
    uint32_t i;
    if (back >= tf->knot[a] && back <= tf->knot[a + 1]) { /* one interval, or equal values: no difference to divide */
        const float *c = tf->coef[a];
        const double u = 0.5 * ((double)front + (double)back) - (double)c[TETCASTI_BASE];
        const double w = (double)back - (double)front, tau = (double)c[0] + (double)c[1] * u;
        mean[0] = tau;
        for (i = 0; i < 3; i++) {
            const double v = (double)c[2 + 2 * i] + (double)c[3 + 2 * i] * u;
            mean[1 + i] = tf->independent ? v : v * tau + (double)c[3 + 2 * i] * (double)c[1] * w * w / 12.0;
        }
    } else {
        double p[7], q[7];
        tetcasti_tf_integral(tf, front, p);
        tetcasti_tf_integral(tf, back, q);
        for (i = 0; i < 4; i++) mean[i] = (q[i] - p[i]) / ((double)back - (double)front);
    }
}
TETCASTI_INLINE float tetcasti_prefix(const double mean[4], float length, float color[3]) {
    uint32_t i;
    for (i = 0; i < 3; i++) color[i] = (float)(mean[1 + i] * (double)length);
    return 1.0f - tetcasti_exp_neg((float)(mean[0] > 0.0 ? mean[0] * (double)length : 0.0));
}
static void tetcasti_segment_prefix(const tetcast_optics *o, float front, float back, float length, float depth,
                                    tetcasti_ray_sum *sum) {
    double mean[4];
    float color[3], alpha;
    if (!(sum->t > o->t_stop)) return;
    tetcasti_prefix_mean(&o->tf, front, back, mean);
    alpha = tetcasti_prefix(mean, length, color);
    tetcasti_over(o, color, alpha, depth, length, sum);
}

/* ---- partial pre-integration with a table of psi (Moreland and Angel, 2004) ---- */

#define TETCASTI_PSI_SIZE 512u

/* psi[i][j], front depth a = g / (1 - g) for g = i / 511, back depth likewise. 1 - psi is the weight of the front
   colour: what the exact integrator gives for a colour that falls from 1 to 0. */
static void tetcasti_psi_row(void *ctx, uint32_t i) {
    float *psi = (float *)ctx + (size_t)i * TETCASTI_PSI_SIZE;
    const double last = (double)(TETCASTI_PSI_SIZE - 1);
    uint32_t j;
    for (j = 0; j < TETCASTI_PSI_SIZE; j++) {
        tetcasti_ray_sum sum;
        float c[8];
        memset(&sum, 0, sizeof sum);
        memset(c, 0, sizeof c);
        sum.t = 1.0f;
        if (i + 1 == TETCASTI_PSI_SIZE || j + 1 == TETCASTI_PSI_SIZE) {
            psi[j] = 0.0f;
            continue;
        }
        c[0] = (float)((double)i / (last - (double)i));
        c[1] = (float)((double)j / (last - (double)j)) - c[0];
        c[2] = 1.0f;
        c[3] = -1.0f;
        tetcasti_piece(TETCASTI_KIND_ASSOCIATED, 0, NULL, 1.0f, c, 0.0f, 1.0f, 1.0f, &sum);
        psi[j] = 1.0f - sum.c[0];
    }
}

static float tetcasti_psi_lookup(const float *psi, float a, float b) {
    const float last = (float)(TETCASTI_PSI_SIZE - 1);
    float x = a / (1.0f + a) * last, y = b / (1.0f + b) * last, p, q;
    uint32_t i = (uint32_t)x, j = (uint32_t)y;
    i = i < TETCASTI_PSI_SIZE - 2 ? i : TETCASTI_PSI_SIZE - 2;
    j = j < TETCASTI_PSI_SIZE - 2 ? j : TETCASTI_PSI_SIZE - 2;
    x = x - (float)i;
    y = y - (float)j;
    psi += (size_t)i * TETCASTI_PSI_SIZE + j;
    p = psi[0] + (psi[1] - psi[0]) * y;
    q = psi[TETCASTI_PSI_SIZE] + (psi[TETCASTI_PSI_SIZE + 1] - psi[TETCASTI_PSI_SIZE]) * y;
    return p + (q - p) * x;
}

static void tetcasti_segment_psi(const tetcast_optics *o, float front, float back, float length, float depth,
                                 tetcasti_ray_sum *sum) {
    const tetcasti_tf *tf = &o->tf;
    uint32_t at = tetcasti_tf_find(tf, front), i;
    const float whole = back - front;
    float from = front;
    for (;;) {
        const float lo = tf->knot[at], hi = tf->knot[at + 1], end = back < lo ? lo : back > hi ? hi : back;
        const float *c = tf->coef[at];
        const float d = end == back && from == front ? length : length * ((end - from) / whole);
        const float u = from - c[TETCASTI_BASE], v = end - c[TETCASTI_BASE];
        float a = (c[0] + c[1] * u) * d, b = (c[0] + c[1] * v) * d, zeta, psi, color[3];
        if (!(sum->t > o->t_stop)) return;
        a = a > 0.0f ? a : 0.0f;
        b = b > 0.0f ? b : 0.0f;
        zeta = tetcasti_exp_neg(0.5f * (a + b));
        psi = tetcasti_psi_lookup(o->psi, a, b);
        for (i = 0; i < 3; i++) {
            const float f = c[2 + 2 * i] + c[3 + 2 * i] * u, g = c[2 + 2 * i] + c[3 + 2 * i] * v;
            color[i] = o->tf.independent ? 0.5f * (f + g) * psi * d : f * (1.0f - psi) + g * (psi - zeta);
        }
        tetcasti_over(o, color, 1.0f - zeta, depth, d, sum);
        if (end == back) return;
        at = back > end ? at + 1 : at - 1;
        from = end;
    }
}

/* ---- pre-integrated tables: lookup ---- */

TETCASTI_INLINE float tetcasti_table_column(const tetcasti_table *t, float s, uint32_t *i) {
    float x = (s - t->first) * t->scale;
    const float last = (float)(t->values - 1);
    x = x > 0.0f ? x : 0.0f;
    x = x < last ? x : last;
    *i = (uint32_t)x;
    if (*i + 1 >= t->values) *i = t->values - 2;
    return x - (float)*i;
}

TETCASTI_INLINE void tetcasti_table_bilinear(const tetcasti_table *t, size_t at, float x, float y, float out[4]) {
    const float *a = t->entry[at], *b = t->entry[at + 1];
    const float *c = t->entry[at + t->values], *d = t->entry[at + t->values + 1];
    uint32_t i;
    for (i = 0; i < 4; i++) {
        const float p = a[i] + (b[i] - a[i]) * y, q = c[i] + (d[i] - c[i]) * y;
        out[i] = p + (q - p) * x;
    }
}

static void tetcasti_table_lookup(const tetcasti_table *t, float front, float back, float length, float out[4]) {
    uint32_t i, j, l, c;
    const float x = tetcasti_table_column(t, front, &i), y = tetcasti_table_column(t, back, &j);
    const size_t slice = (size_t)t->values * t->values, at = (size_t)i * t->values + j;
    float z = length * t->per_length, near_end[4] = {0.0f, 0.0f, 0.0f, 0.0f}; /* slice 0 is length 0: nothing */
    l = z < (float)(t->lengths - 1) ? (uint32_t)z : t->lengths - 1;
    z = z - (float)l;
    z = z < 1.0f ? z : 1.0f;
    if (l != 0) tetcasti_table_bilinear(t, (l - 1) * slice + at, x, y, near_end);
    tetcasti_table_bilinear(t, l * slice + at, x, y, out);
    for (c = 0; c < 4; c++) out[c] = near_end[c] + (out[c] - near_end[c]) * z;
}

/* Longer segments than the table holds are cut into equal parts. */
static void tetcasti_segment_table(const tetcast_optics *o, float front, float back, float length, float depth,
                                   tetcasti_ray_sum *sum) {
    const float parts = length / o->table.longest;
    uint32_t n = parts <= 1.0f ? 1 : parts < 1e6f ? (uint32_t)parts + 1 : 1000000u, i;
    const float d = length / (float)n, step = (back - front) / (float)n;
    for (i = 0; i < n && sum->t > o->t_stop; i++) {
        float e[4];
        tetcasti_table_lookup(&o->table, front + step * (float)i, i + 1 < n ? front + step * (float)(i + 1) : back, d,
                              e);
        tetcasti_over(o, e, e[3], depth + d * (float)i, d, sum);
    }
}

/* Equidistant samples along the whole ray, one lookup between two of them; what is left at the end of the ray is
   integrated exactly. carry: length since the last sample, value there, value at the end, depth of the sample. */
static void tetcasti_segment_steps(const tetcast_optics *o, float front, float back, float length, float depth,
                                   tetcasti_ray_sum *sum) {
    const float h = o->table.longest;
    float gone = 0.0f;
    if (!(sum->carry[0] > 0.0f)) {
        sum->carry[1] = front;
        sum->carry[3] = depth;
    }
    while (sum->t > o->t_stop && length - gone >= h - sum->carry[0]) {
        float e[4], s, x, y;
        uint32_t i, j;
        gone = gone + (h - sum->carry[0]);
        s = front + (back - front) * (gone / length);
        x = tetcasti_table_column(&o->table, sum->carry[1], &i);
        y = tetcasti_table_column(&o->table, s, &j);
        tetcasti_table_bilinear(&o->table, (size_t)i * o->table.values + j, x, y, e);
        tetcasti_over(o, e, e[3], sum->carry[3], h, sum);
        sum->carry[0] = 0.0f;
        sum->carry[1] = s;
        sum->carry[3] = depth + gone;
    }
    sum->carry[0] = sum->carry[0] + (length - gone);
    sum->carry[2] = back;
}

/* ---- pre-integrated tables: building ---- */

/* Build, or build again what depends on values from column a to column b: entries (i, j) with min(i, j) <= b and
   max(i, j) >= a. In row i those are one stretch of columns. */
typedef struct tetcasti_table_job {
    const tetcast_optics *o; /* transfer function and the exact integrator */
    tetcasti_table *table;
    uint32_t a, b;
    uint32_t slice;          /* of the incremental and the sub-range builder */
    double *work;
} tetcasti_table_job;

TETCASTI_INLINE void tetcasti_table_stretch(const tetcasti_table_job *job, uint32_t i, uint32_t *from, uint32_t *to) {
    *from = i < job->a ? job->a : 0;
    *to = i > job->b ? job->b + 1 : job->table->values;
}

TETCASTI_INLINE float tetcasti_table_value(const tetcasti_table *t, uint32_t i) {
    return (float)((double)t->first + (double)i / (double)t->scale);
}
TETCASTI_INLINE float tetcasti_table_length(const tetcasti_table *t, uint32_t l) {
    return (float)((double)t->longest * (double)(l + 1) / (double)t->lengths);
}

/* Each entry by the exact integral. Task: one row (front value) of one slice. */
static void tetcasti_table_exact_row(void *ctx, uint32_t task) {
    const tetcasti_table_job *job = (const tetcasti_table_job *)ctx;
    tetcasti_table *t = job->table;
    const uint32_t l = task / t->values, i = task % t->values;
    float (*entry)[4] = t->entry + (size_t)task * t->values;
    const float length = tetcasti_table_length(t, l), front = tetcasti_table_value(t, i);
    uint32_t j, from, to, k, c;
    tetcasti_table_stretch(job, i, &from, &to);
    for (j = from; j < to; j += 8) {
        tetcasti_seg8 seg;
        tetcasti_ray_sum8 sum;
        memset(&sum, 0, sizeof sum);
        for (k = 0; k < 8; k++) {
            seg.front[k] = front;
            seg.back[k] = tetcasti_table_value(t, j + k < to ? j + k : to - 1);
            seg.length[k] = length;
            seg.depth[k] = 0.0f;
            sum.t[k] = 1.0f;
        }
        (void)job->o->piece8(job->o, &seg, 255, &sum);
        for (k = 0; k < 8 && j + k < to; k++) {
            for (c = 0; c < 3; c++) entry[j + k][c] = sum.c[c][k];
            entry[j + k][3] = 1.0f - sum.t[k];
        }
    }
}

/* Task: one front value in all slices, which share the means. */
static void tetcasti_table_prefix_row(void *ctx, uint32_t i) {
    const tetcasti_table_job *job = (const tetcasti_table_job *)ctx;
    tetcasti_table *t = job->table;
    const float front = tetcasti_table_value(t, i);
    double mean[128][4];
    uint32_t j, k, l, n;
    for (j = 0; j < t->values; j += n) {
        n = t->values - j < 128 ? t->values - j : 128;
        for (k = 0; k < n; k++) tetcasti_prefix_mean(&job->o->tf, front, tetcasti_table_value(t, j + k), mean[k]);
        for (l = 0; l < t->lengths; l++) {
            float (*entry)[4] = t->entry + ((size_t)l * t->values + i) * t->values + j;
            const float length = tetcasti_table_length(t, l);
            for (k = 0; k < n; k++) entry[k][3] = tetcasti_prefix(mean[k], length, entry[k]);
        }
    }
}

/* Incremental pre-integration: slice l is slice 0 in front of slice l - 1, cut at a value p between samples:
       C(f, b, d' + d0) = C(f, p, d0) + (1 - alpha(f, p, d0)) C(p, b, d'),   p = (l f + b) / (l + 1)
   The error of the lookup in slice 0 enters once, that of the lookup in slice l - 1 with each slice. */
static void tetcasti_table_increment_row(void *ctx, uint32_t i) {
    const tetcasti_table_job *job = (const tetcasti_table_job *)ctx;
    tetcasti_table *t = job->table;
    const uint32_t l = job->slice, n = t->values;
    const size_t slice = (size_t)n * n;
    float (*out)[4] = t->entry + l * slice + (size_t)i * n, (*first)[4] = t->entry + (size_t)i * n;
    float (*before)[4] = t->entry + (l - 1) * slice;
    uint32_t j, from, to, c;
    tetcasti_table_stretch(job, i, &from, &to);
    for (j = from; j < to; j++) {
        const uint32_t sum = l * i + j, whole = sum / (l + 1), q = whole < n - 1 ? whole : n - 2;
        const float u = (float)(sum - q * (l + 1)) / (float)(l + 1);
        const float *a = first[q], *b = first[q + 1];
        const float *p = before[(size_t)q * n + j], *r = before[(size_t)(q + 1) * n + j];
        const float left = 1.0f - (a[3] + (b[3] - a[3]) * u);
        for (c = 0; c < 4; c++) out[j][c] = (a[c] + (b[c] - a[c]) * u) + left * (p[c] + (r[c] - p[c]) * u);
    }
}

/* e = f over b, {r, g, b, transmittance} */
TETCASTI_INLINE void tetcasti_over4(const double *f, const double *b, double *e) {
    e[0] = f[0] + f[3] * b[0];
    e[1] = f[1] + f[3] * b[1];
    e[2] = f[2] + f[3] * b[2];
    e[3] = f[3] * b[3];
}

/* Sub-range integration (Lum et al., 2004): the function is a list of n samples; an entry (f, f + N) of length d
   consists of N steps of length d / N, and all entries with the same N share those steps. The steps are cut into blocks
   of N; with the composites from each block's start (prefix) and to each block's end (suffix), every window of N steps
   is one suffix over one prefix: the sliding window of van Herk, Gil and Werman for `over`. One task: one slice. */
static void tetcasti_table_subrange_slice(void *ctx, uint32_t task) {
    const tetcasti_table_job *job = (const tetcasti_table_job *)ctx;
    tetcasti_table *t = job->table;
    const uint32_t n = t->values, l = job->slice + task;
    float (*entry)[4] = t->entry + (size_t)l * n * n;
    double *value = job->work + (size_t)task * 16 * n, *step = value + 4 * (size_t)n;
    double *prefix = value + 8 * (size_t)n, *suffix = value + 12 * (size_t)n;
    const double length = (double)tetcasti_table_length(t, l);
    const int independent = job->o->tf.independent != 0;
    uint32_t i, c, run, way;
    for (i = 0; i < n; i++) { /* samples, and the diagonal: constant value */
        float v[4];
        double m, alpha, scale;
        tetcasti_tf_at(&job->o->tf, tetcasti_table_value(t, i), v);
        for (c = 0; c < 4; c++) value[4 * i + c] = (double)v[c];
        m = (double)v[0] * length;
        alpha = m < 700.0 ? 1.0 - tetcasti_exp2(m * -1.44269504088896340736) : 1.0;
        scale = m > 1e-9 ? alpha / m : 1.0;
        if (i < job->a || i > job->b) continue;
        for (c = 0; c < 3; c++) {
            entry[(size_t)i * n + i][c] = (float)((double)v[1 + c] * (independent ? length * scale : alpha));
        }
        entry[(size_t)i * n + i][3] = (float)alpha;
    }
    for (run = 1; run < n; run++) {
        const double d = length / (double)run;
        const uint32_t f0 = job->a > run ? job->a - run : 0;                     /* windows f0 .. f1 */
        const uint32_t f1 = job->b < n - 1 - run ? job->b : n - 1 - run;
        const uint32_t e0 = f0 / run * run, e1 = f1 + run;                       /* steps e0 .. e1 - 1 */
        for (i = e0; i < e1; i++) {
            const double *p = value + 4 * (size_t)i, *q = p + 4, m = 0.5 * (p[0] + q[0]) * d;
            const double left = m < 700.0 ? tetcasti_exp2(m * -1.44269504088896340736) : 0.0;
            const double scale = independent ? (m > 1e-9 ? (1.0 - left) / m : 1.0) * d : 1.0 - left;
            for (c = 0; c < 3; c++) step[4 * (size_t)i + c] = 0.5 * (p[1 + c] + q[1 + c]) * scale;
            step[4 * (size_t)i + 3] = left;
        }
        for (way = 0; way < 2; way++) { /* rising values; falling: the same steps in the other order */
            for (i = e0; i < e1; i++) { /* prefix[i]: steps from the block's start to i */
                double *at = prefix + 4 * (size_t)i;
                const double *e = step + 4 * (size_t)i;
                if (i % run == 0) memcpy(at, e, 4 * sizeof *at);
                else if (way == 0) tetcasti_over4(at - 4, e, at);
                else tetcasti_over4(e, at - 4, at);
            }
            for (i = e1; i-- > e0;) { /* suffix[i]: steps from i to the block's end */
                double *at = suffix + 4 * (size_t)i;
                const double *e = step + 4 * (size_t)i;
                if (i + 1 == e1 || (i + 1) % run == 0) memcpy(at, e, 4 * sizeof *at);
                else if (way == 0) tetcasti_over4(e, at + 4, at);
                else tetcasti_over4(at + 4, e, at);
            }
            for (i = f0; i <= f1; i++) {
                double r[4];
                float *out = way == 0 ? entry[(size_t)i * n + i + run] : entry[(size_t)(i + run) * n + i];
                if (i % run == 0) memcpy(r, suffix + 4 * (size_t)i, sizeof r);
                else if (way == 0) tetcasti_over4(suffix + 4 * (size_t)i, prefix + 4 * (size_t)(i + run - 1), r);
                else tetcasti_over4(prefix + 4 * (size_t)(i + run - 1), suffix + 4 * (size_t)i, r);
                for (c = 0; c < 3; c++) out[c] = (float)r[c];
                out[3] = (float)(1.0 - r[3]);
            }
        }
    }
}

static int tetcasti_has_table(tetcast_integrator integrator) {
    return integrator >= TETCAST_INTEGRATOR_TABLE_3D && integrator <= TETCAST_INTEGRATOR_TABLE_PREFIX;
}

static tetcast_result tetcasti_table_alloc(tetcast_optics *o, const tetcast_optics_desc *d) {
    tetcasti_table *t = &o->table;
    double first = 0.0, last = 1.0;
    size_t count;
    t->values = d->table_values != 0 ? d->table_values : 128;
    t->lengths = d->table_lengths != 0 ? d->table_lengths : 64;
    t->longest = d->longest;
    if (o->integrator == TETCAST_INTEGRATOR_TABLE_2D) {
        t->lengths = 1;
        t->longest = d->step > 0.0f ? d->step : 0.25f * d->longest;
    }
    if (t->values < 2 || t->values > 2048 || t->lengths > 1024) {
        return tetcasti_fail(d->env.error, TETCAST_ERR_RANGE, t->values, "optics: a table of % values is too large");
    }
    if (!(t->longest > 0.0f) || !tetcasti_finite_f((float)t->lengths / t->longest)) {
        return tetcasti_fail(d->env.error, TETCAST_ERR_INVALID_ARG, 0, "optics: a table needs the longest length");
    }
    if (o->tf.n > 2) {
        first = (double)o->tf.knot[1];
        last = (double)o->tf.knot[o->tf.n - 1];
    } else if (o->tf.n == 2) {
        first = (double)o->tf.knot[1] - 0.5;
        last = first + 1.0;
    }
    t->first = (float)first;
    t->scale = (float)((double)(t->values - 1) / (last - first));
    t->per_length = (float)((double)t->lengths / (double)t->longest);
    if (!tetcasti_finite_f(t->scale)) t->scale = 3e38f;
    if (!(t->scale > 0.0f)) t->scale = 1e-38f;
    if (!tetcasti_mul_size((size_t)t->values * t->values, t->lengths, &count)) return TETCAST_ERR_RANGE;
    t->entry = (float (*)[4])tetcasti_alloc_array(&o->mem, count, sizeof *t->entry);
    return t->entry != NULL ? TETCAST_OK : TETCAST_ERR_NO_MEMORY;
}

/* Columns a .. b (0 .. values - 1: all). The rest of the table is already right. */
static tetcast_result tetcasti_table_build(tetcast_optics *o, const tetcast_env *env, uint32_t a, uint32_t b) {
    tetcasti_table *t = &o->table;
    tetcasti_table_job job;
    uint32_t l;
    job.o = o;
    job.table = t;
    job.a = a;
    job.b = b;
    job.slice = 0;
    job.work = NULL;
    switch (o->integrator) {
    case TETCAST_INTEGRATOR_TABLE_PREFIX:
        tetcasti_parallel_for(env, tetcasti_table_prefix_row, &job, t->values);
        break;
    case TETCAST_INTEGRATOR_TABLE_INCREMENTAL:
        tetcasti_parallel_for(env, tetcasti_table_exact_row, &job, t->values);
        for (l = 1; l < t->lengths; l++) {
            job.slice = l;
            tetcasti_parallel_for(env, tetcasti_table_increment_row, &job, t->values);
        }
        break;
    case TETCAST_INTEGRATOR_TABLE_SUBRANGE: {
        const uint32_t at_once = t->lengths < 16 ? t->lengths : 16;
        job.work = (double *)tetcasti_alloc_array(&o->mem, (size_t)at_once * 16 * t->values, sizeof *job.work);
        if (job.work == NULL) return TETCAST_ERR_NO_MEMORY;
        for (l = 0; l < t->lengths; l += at_once) {
            const uint32_t left = t->lengths - l;
            job.slice = l;
            tetcasti_parallel_for(env, tetcasti_table_subrange_slice, &job, left < at_once ? left : at_once);
        }
        tetcasti_free(&o->mem, job.work);
        break;
    }
    default:
        tetcasti_parallel_for(env, tetcasti_table_exact_row, &job, t->lengths * t->values);
        break;
    }
    return TETCAST_OK;
}
/* ---------------------------------------------------------------------------
   optical: models (emission, absorption, maximum, isosurfaces, depth cueing),    // >>optical
   sums along rays, error bounds, the optics object.
   --------------------------------------------------------------------------- */

/* ---- sums along a ray ---- */

static TETCASTI_UNUSED void tetcasti_ray_begin(const tetcast_optics *o, tetcasti_ray_sum *sum) {
    memset(sum, 0, sizeof *sum);
    sum->t = o->model == TETCAST_MODEL_ABSORPTION ? 0.0f : 1.0f;
}

static TETCASTI_UNUSED int tetcasti_ray_ended(const tetcast_optics *o, const tetcasti_ray_sum *sum) {
    return !(sum->t > o->t_stop);
}

/* The ray leaves the mesh, or ends: what is pending is integrated. */
static TETCASTI_UNUSED void tetcasti_ray_gap(const tetcast_optics *o, tetcasti_ray_sum *sum) {
    if (sum->carry[0] > 0.0f) {
        const float length = sum->carry[0];
        sum->carry[0] = 0.0f;
        o->piece(o, sum->carry[1], sum->carry[2], length, sum->carry[3], sum);
    }
}

static TETCASTI_UNUSED void tetcasti_ray_finish(const tetcast_optics *o, tetcasti_ray_sum *sum, float rgba[4]) {
    tetcasti_ray_gap(o, sum);
    rgba[0] = sum->c[0];
    rgba[1] = sum->c[1];
    rgba[2] = sum->c[2];
    switch (o->model) {
    case TETCAST_MODEL_ABSORPTION: /* one exponential per ray, of the summed depth */
        rgba[3] = (float)(1.0 - (sum->t > -700.0f ? tetcasti_exp2((double)sum->t * 1.44269504088896340736) : 0.0));
        break;
    case TETCAST_MODEL_EMISSION:
        rgba[3] = 0.0f;
        break;
    case TETCAST_MODEL_MAXIMUM:
        rgba[3] = rgba[0] > rgba[1] ? rgba[0] : rgba[1];
        rgba[3] = rgba[3] > rgba[2] ? rgba[3] : rgba[2];
        rgba[3] = rgba[3] < 1.0f ? rgba[3] : 1.0f;
        break;
    default:
        rgba[3] = 1.0f - sum->t;
        break;
    }
}

static void tetcasti_lane_load(const tetcasti_ray_sum8 *sum, uint32_t lane, tetcasti_ray_sum *one) {
    uint32_t j;
    for (j = 0; j < 3; j++) one->c[j] = sum->c[j][lane];
    for (j = 0; j < TETCASTI_CARRY; j++) one->carry[j] = sum->carry[j][lane];
    one->t = sum->t[lane];
    one->at = sum->at[lane];
}
static void tetcasti_lane_store(tetcasti_ray_sum8 *sum, uint32_t lane, const tetcasti_ray_sum *one) {
    uint32_t j;
    for (j = 0; j < 3; j++) sum->c[j][lane] = one->c[j];
    for (j = 0; j < TETCASTI_CARRY; j++) sum->carry[j][lane] = one->carry[j];
    sum->t[lane] = one->t;
    sum->at[lane] = one->at;
}
static TETCASTI_UNUSED void tetcasti_lane_begin(const tetcast_optics *o, tetcasti_ray_sum8 *sum, uint32_t lane) {
    tetcasti_ray_sum one;
    tetcasti_ray_begin(o, &one);
    tetcasti_lane_store(sum, lane, &one);
}
static TETCASTI_UNUSED void tetcasti_lane_gap(const tetcast_optics *o, tetcasti_ray_sum8 *sum, uint32_t lane) {
    tetcasti_ray_sum one;
    if (!(sum->carry[0][lane] > 0.0f)) return;
    tetcasti_lane_load(sum, lane, &one);
    tetcasti_ray_gap(o, &one);
    tetcasti_lane_store(sum, lane, &one);
}
static TETCASTI_UNUSED void tetcasti_lane_finish(const tetcast_optics *o, tetcasti_ray_sum8 *sum, uint32_t lane,
                                                 float rgba[4]) {
    tetcasti_ray_sum one;
    tetcasti_lane_load(sum, lane, &one);
    tetcasti_ray_finish(o, &one, rgba);
    tetcasti_lane_store(sum, lane, &one);
}

/* ---- isosurfaces ---- */

static void tetcasti_segment_none(const tetcast_optics *o, float front, float back, float length, float depth,
                                  tetcasti_ray_sum *sum) {
    (void)o; (void)front; (void)back; (void)length; (void)depth; (void)sum;
}
static uint32_t tetcasti_segment8_none(const tetcast_optics *o, const tetcasti_seg8 *seg, uint32_t lanes,
                                       tetcasti_ray_sum8 *sum) {
    uint32_t i, ended = 0;
    (void)seg;
    for (i = 0; i < 8; i++) ended |= (uint32_t)!(sum->t[i] > o->t_stop) << i;
    return ended & lanes;
}

/* Lit colour of isosurface i for a ray in direction `view`; the surface is lit on the side that is seen. */
static void tetcasti_iso_shade(const tetcast_optics *o, const tetcast_isovalue *iso, const float gradient[3],
                               const float view[3], float rgb[3]) {
    float n[3], headlight[3], facing;
    const uint32_t count = o->light_count != 0 ? o->light_count : 1;
    const double shininess = iso->shininess > 0.0f ? (double)iso->shininess : 32.0;
    uint32_t i, j;
    memcpy(n, gradient, sizeof n);
    for (j = 0; j < 3; j++) headlight[j] = -view[j];
    if (!tetcasti_normalize(n)) memcpy(n, headlight, sizeof n);
    facing = tetcasti_dot3(n, view);
    for (j = 0; j < 3; j++) {
        if (facing > 0.0f) n[j] = -n[j];
        rgb[j] = o->ambient[j] * iso->rgb[j];
    }
    for (i = 0; i < count; i++) {
        const float white[3] = {1.0f, 1.0f, 1.0f};
        const float *l = o->light_count != 0 ? o->light[i].direction : headlight;
        const float *color = o->light_count != 0 ? o->light[i].rgb : white;
        float h[3], diffuse = tetcasti_dot3(n, l), shine = 0.0f;
        if (!(diffuse > 0.0f)) continue;
        for (j = 0; j < 3; j++) h[j] = l[j] - view[j];
        if (iso->specular > 0.0f && tetcasti_normalize(h)) {
            const double c = (double)tetcasti_dot3(n, h);
            if (c > 1e-30) shine = iso->specular * (float)tetcasti_pow(c < 1.0 ? c : 1.0, shininess);
        }
        for (j = 0; j < 3; j++) rgb[j] += color[j] * (iso->rgb[j] * diffuse + shine);
    }
}

/* Isovalues hit from front to back: a rising ray those with front < v <= back, a falling one those with
   front > v >= back. So a surface on a vertex or a face is hit once by a ray that goes through, in one of the two
   cells, and once by a ray that touches it. *first is the index of the nearest; returns how many. */
TETCASTI_INLINE uint32_t tetcasti_iso_hits(const tetcast_optics *o, float front, float back, uint32_t *first) {
    uint32_t i, from = 0, to = 0;
    if (front < back) {
        for (i = 0; i < o->iso_count; i++) {
            from += o->iso[i].value <= front;
            to += o->iso[i].value <= back;
        }
        *first = from;
        return to - from;
    }
    for (i = 0; i < o->iso_count; i++) {
        from += o->iso[i].value < front;
        to += o->iso[i].value < back;
    }
    *first = from - 1; /* not used when nothing is hit */
    return from - to;
}

static TETCASTI_UNUSED uint32_t tetcasti_iso_lanes(const tetcast_optics *o, const tetcasti_seg8 *seg, uint32_t lanes) {
    uint32_t i, j, hit = 0;
    for (i = 0; i < o->iso_count; i++) {
        const float v = o->iso[i].value;
        for (j = 0; j < 8; j++) {
            const float a = seg->front[j], b = seg->back[j];
            hit |= (uint32_t)(((v > a) & (v <= b)) | ((v < a) & (v >= b))) << j;
        }
    }
    return hit & lanes;
}

static TETCASTI_UNUSED void tetcasti_segment_iso(const tetcast_optics *o, float s_front, float s_back, float length,
                                                 float depth, tetcasti_normal_fn *normal, void *user,
                                                 const float view[3], tetcasti_ray_sum *sum) {
    uint32_t at, count = tetcasti_iso_hits(o, s_front, s_back, &at), j;
    const float whole = s_back - s_front, start = s_front;
    float gone = 0.0f;
    if (tetcasti_ray_ended(o, sum)) return;
    if (count == 0) {
        o->segment(o, s_front, s_back, length, depth, sum);
        return;
    }
    for (; count != 0; count--) {
        const tetcast_isovalue *iso = &o->iso[at];
        const float x = (iso->value - start) / whole, to = length * x;
        float n[3], rgb[3], w, k = 1.0f;
        o->segment(o, s_front, iso->value, to - gone, depth + gone, sum);
        tetcasti_ray_gap(o, sum); /* the surface is behind all that is pending */
        s_front = iso->value;
        gone = to;
        if (tetcasti_ray_ended(o, sum)) return;
        if (normal != NULL) normal(user, x, n);
        else for (j = 0; j < 3; j++) n[j] = -view[j];
        tetcasti_iso_shade(o, iso, n, view, rgb);
        if (o->cue) k = tetcasti_cue(o, depth + to, 0.0f);
        w = sum->t * iso->opacity;
        for (j = 0; j < 3; j++) {
            sum->c[j] += w * (k * rgb[j]);
            if (o->cue) sum->c[j] += w * ((1.0f - k) * o->fog[j]);
        }
        sum->t = sum->t - w;
        if (s_back > start) at++;
        else at--;
    }
    o->segment(o, s_front, s_back, length - gone, depth + gone, sum);
}

static TETCASTI_UNUSED void tetcasti_lane_segment_iso(const tetcast_optics *o, uint32_t lane, const tetcasti_seg8 *seg,
                                      tetcasti_normal_fn *normal, void *user, const float view[3],
                                      tetcasti_ray_sum8 *sum) {
    tetcasti_ray_sum one;
    tetcasti_lane_load(sum, lane, &one);
    tetcasti_segment_iso(o, seg->front[lane], seg->back[lane], seg->length[lane], seg->depth[lane], normal, user, view,
                         &one);
    tetcasti_lane_store(sum, lane, &one);
}

/* ---- choosing the functions ---- */

static tetcasti_segment_fn *tetcasti_exact_pick(const tetcast_optics *o) {
    const int cue = o->cue != 0, fma = tetcasti_has_fma();
#define TETCASTI_PICK(name) return fma ? name##_fma : name
    switch (o->model) {
    case TETCAST_MODEL_EMISSION:
        if (o->tf.independent && cue) TETCASTI_PICK(tetcasti_exact_emission_independent_cue);
        if (o->tf.independent) TETCASTI_PICK(tetcasti_exact_emission_independent);
        if (cue) TETCASTI_PICK(tetcasti_exact_emission_cue);
        TETCASTI_PICK(tetcasti_exact_emission);
    case TETCAST_MODEL_ABSORPTION: TETCASTI_PICK(tetcasti_exact_absorption);
    case TETCAST_MODEL_MAXIMUM:
        if (o->tf.independent && cue) TETCASTI_PICK(tetcasti_exact_maximum_independent_cue);
        if (o->tf.independent) TETCASTI_PICK(tetcasti_exact_maximum_independent);
        if (cue) TETCASTI_PICK(tetcasti_exact_maximum_cue);
        TETCASTI_PICK(tetcasti_exact_maximum);
    case TETCAST_MODEL_ISOSURFACE: return tetcasti_segment_none;
    default:
        if (o->tf.independent && cue) TETCASTI_PICK(tetcasti_exact_independent_cue);
        if (o->tf.independent) TETCASTI_PICK(tetcasti_exact_independent);
        if (cue) TETCASTI_PICK(tetcasti_exact_associated_cue);
        TETCASTI_PICK(tetcasti_exact_associated);
    }
#undef TETCASTI_PICK
}

/* What integrates a whole segment: the exact form, or one of the others where a volume is asked for. */
static tetcasti_segment_fn *tetcasti_segment_pick(const tetcast_optics *o) {
    if (o->model != TETCAST_MODEL_VOLUME && o->model != TETCAST_MODEL_MIXED) return tetcasti_exact_pick(o);
    switch (o->integrator) {
    case TETCAST_INTEGRATOR_PSI_TABLE: return tetcasti_segment_psi;
    case TETCAST_INTEGRATOR_RIEMANN: return tetcasti_segment_riemann;
    case TETCAST_INTEGRATOR_TRAPEZOID: return tetcasti_segment_trapezoid;
    case TETCAST_INTEGRATOR_MIDPOINT: return tetcasti_segment_midpoint;
    case TETCAST_INTEGRATOR_PRE: return tetcasti_has_fma() ? tetcasti_segment_pre_fma : tetcasti_segment_pre;
    case TETCAST_INTEGRATOR_PREFIX: return tetcasti_segment_prefix;
    case TETCAST_INTEGRATOR_TABLE_2D: return tetcasti_segment_steps;
    case TETCAST_INTEGRATOR_TABLE_3D:
    case TETCAST_INTEGRATOR_TABLE_INCREMENTAL:
    case TETCAST_INTEGRATOR_TABLE_SUBRANGE:
    case TETCAST_INTEGRATOR_TABLE_PREFIX: return tetcasti_segment_table;
    case TETCAST_INTEGRATOR_EXACT:
    case TETCAST_INTEGRATOR_COUNT:
    case TETCAST_INTEGRATOR_FORCE_32BIT: break;
    }
    return tetcasti_exact_pick(o);
}

static tetcasti_segment8_fn *tetcasti_exact8_pick(const tetcast_optics *o, tetcast_isa isa) {
    if (o->model == TETCAST_MODEL_ISOSURFACE) return tetcasti_segment8_none;
#if TETCASTI_AVX2
    if (isa >= TETCAST_ISA_AVX2 && tetcasti_has_fma()) {
        const int cue = o->cue != 0, few = o->tf.n <= 16;
        switch (o->model) {
        case TETCAST_MODEL_EMISSION:
            if (o->tf.independent) {
                return cue ? tetcasti_exact8_emission_independent_cue : tetcasti_exact8_emission_independent_any;
            }
            if (cue) return tetcasti_exact8_emission_cue;
            return few ? tetcasti_exact8_emission_16 : tetcasti_exact8_emission_any;
        case TETCAST_MODEL_MAXIMUM:
            if (o->tf.independent) {
                return cue ? tetcasti_exact8_maximum_independent_cue : tetcasti_exact8_maximum_independent_any;
            }
            return cue ? tetcasti_exact8_maximum_cue : few ? tetcasti_exact8_maximum_16 : tetcasti_exact8_maximum_any;
        case TETCAST_MODEL_ABSORPTION: return few ? tetcasti_exact8_absorption_16 : tetcasti_exact8_absorption_any;
        default:
            if (o->tf.independent) {
                return cue ? tetcasti_exact8_independent_cue
                           : few ? tetcasti_exact8_independent_16 : tetcasti_exact8_independent_any;
            }
            if (cue) return tetcasti_exact8_associated_cue;
            return o->tf.n <= 8 ? tetcasti_exact8_associated_8
                                : few ? tetcasti_exact8_associated_16 : tetcasti_exact8_associated_any;
        }
    }
#endif
    (void)isa;
    return tetcasti_segment_lanes;
}

/* The form for eight lanes of an instruction set; same bits in all. */
static tetcasti_segment8_fn *tetcasti_segment8_pick(const tetcast_optics *o, tetcast_isa isa) {
    return o->segment == o->piece ? tetcasti_exact8_pick(o, isa) : tetcasti_segment_lanes;
}

/* ---- the object ---- */

static tetcast_result tetcasti_optics_check(const tetcast_optics_desc *d) {
    const float *v[4];
    uint32_t i, j;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    if ((uint32_t)d->model > (uint32_t)TETCAST_MODEL_MIXED ||
        (uint32_t)d->integrator >= (uint32_t)TETCAST_INTEGRATOR_COUNT) return TETCAST_ERR_INVALID_ARG;
    if (!(d->tolerance >= 0.0f && d->tolerance < 1e30f) || !(d->path_length >= 0.0f && d->path_length < 1e30f) ||
        !(d->longest >= 0.0f && d->longest < 1e18f) || !(d->step >= 0.0f && d->step < 1e18f) ||
        !tetcasti_finite_f(d->t_min) || d->t_min >= 1.0f || d->samples > 1000000u) return TETCAST_ERR_INVALID_ARG;
    v[0] = d->cue_depth;
    v[1] = d->cue_scale;
    v[2] = d->fog;
    v[3] = d->ambient;
    for (i = 0; i < 4; i++) {
        for (j = 0; j < (i < 2 ? 2u : 3u); j++) if (!tetcasti_finite_f(v[i][j])) return TETCAST_ERR_INVALID_ARG;
    }
    for (j = 0; j < 3; j++) if (d->fog[j] < 0.0f || d->ambient[j] < 0.0f) return TETCAST_ERR_INVALID_ARG;
    if (d->cue) {
        for (j = 0; j < 2; j++) {
            if (!(d->cue_scale[j] >= 0.0f && d->cue_scale[j] <= 1.0f)) return TETCAST_ERR_INVALID_ARG;
        }
        if (!(d->cue_depth[1] > d->cue_depth[0])) return TETCAST_ERR_INVALID_ARG;
    }
    if (d->light_count > TETCAST_MAX_LIGHTS ||
        (d->light_count != 0 && d->lights == NULL)) return TETCAST_ERR_INVALID_ARG;
    for (i = 0; i < d->light_count; i++) {
        float n[3];
        memcpy(n, d->lights[i].direction, sizeof n);
        if (!tetcasti_normalize(n)) return TETCAST_ERR_INVALID_ARG;
        for (j = 0; j < 3; j++) {
            if (!(d->lights[i].rgb[j] >= 0.0f && d->lights[i].rgb[j] <= 1e30f)) return TETCAST_ERR_INVALID_ARG;
        }
    }
    return TETCAST_OK;
}

static void tetcasti_optics_plain(tetcast_optics *o, const tetcast_optics_desc *d) {
    const double far_k = (double)d->cue_scale[1], near_k = (double)d->cue_scale[0];
    uint32_t i;
    o->model = d->model;
    o->integrator = d->integrator;
    o->samples = d->samples != 0 ? d->samples : 1;
    if (d->cue) {
        const double slope = (far_k - near_k) / ((double)d->cue_depth[1] - (double)d->cue_depth[0]);
        o->cue_scale = (float)slope;
        o->cue_offset = (float)(near_k - slope * (double)d->cue_depth[0]);
        o->cue_lo = (float)tetcasti_min(far_k, near_k);
        o->cue_hi = (float)tetcasti_max(far_k, near_k);
    }
    memcpy(o->fog, d->fog, sizeof o->fog);
    memcpy(o->ambient, d->ambient, sizeof o->ambient);
    o->light_count = (uint32_t)d->light_count;
    for (i = 0; i < o->light_count; i++) {
        o->light[i] = d->lights[i];
        (void)tetcasti_normalize(o->light[i].direction);
    }
}

/* Largest colour that anything behind can add to a ray in full light, and the background (at most white). */
static double tetcasti_brightest(const tetcast_optics *o, double path) {
    double most = tetcasti_max(1.0, (double)o->tf.max_color * (o->tf.independent ? path : 1.0));
    uint32_t i, j, k;
    for (i = 0; i < o->iso_count; i++) {
        for (j = 0; j < 3; j++) {
            double lit = (double)o->ambient[j] * (double)o->iso[i].rgb[j];
            if (o->light_count == 0) lit += (double)o->iso[i].rgb[j] + (double)o->iso[i].specular;
            for (k = 0; k < o->light_count; k++) {
                lit += (double)o->light[k].rgb[j] * ((double)o->iso[i].rgb[j] + (double)o->iso[i].specular);
            }
            most = tetcasti_max(most, lit);
        }
    }
    for (j = 0; o->cue && j < 3; j++) most = tetcasti_max(most, (double)o->fog[j]);
    return most;
}

/* Distribute the allowed error E (colour, 1 = white). What each shortcut can do to a ray of length D with colours from
   0 to c, c >= 1 because opacity counts as well:
     ending when t <= t_min                    t_min c (independent colours: t_min c D)
     extinctions moved by at most e + r tau    c (e D + r): the two pictures differ by just
                                               int T1 (tau1 - tau0) (color - C0 behind it) dx, with T1, tau1 of one and
                                               C0, tau0 of the other function; T1 tau1 integrates to 1 at most
                                               (independent: (c D)(e D + r))
     colours moved by at most e                e (independent: e D)
     the integral itself, in float             2e-6 c (polynomials 6e-7, rounding of the sums the rest), and where the
                                               function is steep what the rounding of positions and values does: found
                                               on pictures to stay below 1e-7 D times the slope, and below 2e-5 c
   A function that has more knots than fit into registers costs up to ten times as much as one that has few, so part of
   E goes to leaving out knots: several parts are tried and the cheapest result stays. The rest goes to ending early.
   All sampling rules and tables are slower than the exact integral, so that is never exchanged. Merging segments on
   which the value is nearly linear was tried: on lattices of 32^3 and 100^3 cubes a tolerance of 1/255 left 0.7 and 0.6
   of the segments, but nearly all that went were transparent, which cost next to nothing anyway; where something is
   seen the bend in the middle of two segments makes an error of about 1/255 for each pair. */
/* About what a step along a ray costs, in nanoseconds. */
static double tetcasti_knots_cost(uint32_t intervals) {
    return intervals <= 8 ? 9.0 : intervals <= 16 ? 10.0 : 12.0 + 0.16 * (double)intervals;
}

/* Leave out knots so that colours, of at most c, change by at most `allowed`. Extinctions that are next to nothing
   become nothing, so that rays can leap over them. Gives the new count, *moved the largest change of a colour. */
static uint32_t tetcasti_knots_within(tetcasti_knot *knot, uint32_t count, uint32_t independent, double c,
                                      double path, double allowed, double *moved) {
    const double per_color = independent ? path : 1.0, snap = independent ? 0.0 : 0.05 * allowed / (c * path);
    tetcasti_slack slack, change;
    double snapped = 0.0;
    uint32_t k;
    slack.eps[0] = 0.3 * allowed / per_color;
    slack.rel[0] = 0.0;
    slack.eps[1] = 0.15 * allowed / (c * path);
    slack.rel[1] = 0.5 * allowed / c;
    for (k = 0; k < count; k++) {
        tetcasti_knot *q = &knot[k];
        if ((double)q->below[3] > snap || (double)q->above[3] > snap) continue;
        snapped = tetcasti_max(snapped, (double)(q->below[3] > q->above[3] ? q->below[3] : q->above[3]));
        q->below[3] = q->above[3] = 0.0f;
    }
    count = tetcasti_knots_simplify(knot, count, independent, &slack, &change);
    *moved = change.eps[0] * per_color + c * ((change.eps[1] + snapped) * path + change.rel[1]);
    return count;
}

static tetcast_result tetcasti_optics_knots(tetcast_optics *o, const tetcast_transfer *t,
                                            const tetcast_optics_desc *d) {
    static const double share[5] = {0.0, 0.3, 0.6, 0.8, 0.95};
    const double allowed = (double)d->tolerance / 255.0, path = (double)d->path_length;
    const int volume = d->model == TETCAST_MODEL_VOLUME || d->model == TETCAST_MODEL_MIXED;
    const tetcasti_knot *knot = t->knot;
    tetcasti_knot *fewer = NULL, *best = NULL;
    uint32_t count = t->knot_count, k, best_count = count;
    double moved = 0.0, best_moved = 0.0, best_cost = 1e300, most;
    int ok;
    o->tf.max_color = t->tf.max_color; /* what brightest looks at */
    o->tf.independent = t->independent;
    most = tetcasti_brightest(o, path > 0.0 ? path : 1.0);
    if (allowed > 0.0 && path > 0.0 && volume && d->integrator == TETCAST_INTEGRATOR_EXACT && count >= 8) {
        fewer = (tetcasti_knot *)tetcasti_alloc_array(&o->mem, count, 2 * sizeof *fewer);
        if (fewer == NULL) return TETCAST_ERR_NO_MEMORY;
        best = fewer + count;
        for (k = 0; k < 5; k++) { /* longer rays, for what ends early has to be darker */
            double cost;
            uint32_t n = count;
            memcpy(fewer, t->knot, count * sizeof *fewer);
            moved = 0.0;
            if (k != 0)
                n = tetcasti_knots_within(fewer, count, t->independent, most, path, share[k] * allowed, &moved);
            if (moved > 0.98 * allowed) continue;
            cost = tetcasti_knots_cost(n + 1) * (4.0 - tetcasti_log2(tetcasti_min(allowed - moved, 0.5)));
            if (cost >= best_cost) continue;
            best_cost = cost;
            best_count = n;
            best_moved = moved;
            memcpy(best, fewer, n * sizeof *fewer);
        }
        count = best_count;
        knot = best;
    }
    ok = tetcasti_tf_build(&o->mem, knot, count, t->independent, &o->tf);
    tetcasti_free(&o->mem, fewer);
    o->info.knot_count = count;
    o->info.bound_knots = (float)(best_moved * 255.0);
    return ok ? TETCAST_OK : TETCAST_ERR_NO_MEMORY;
}

/* What rounding can do: see above. */
static double tetcasti_rounding(const tetcast_optics *o, double path, double most) {
    double slope = 0.0;
    uint32_t k;
    for (k = 1; k < o->tf.n; k++) {
        const float *a = o->tf.coef[k - 1], *b = o->tf.coef[k];
        const double s = (double)o->tf.knot[k];
        const double below = (double)a[0] + (double)a[1] * (s - (double)a[TETCASTI_BASE]);
        const double above = (double)b[0] + (double)b[1] * (s - (double)b[TETCASTI_BASE]);
        slope = tetcasti_max(slope, tetcasti_abs((double)b[1]));
        if (tetcasti_abs(above - below) > 1e-5 * (double)o->tf.max_extinction) slope = 1e30;
    }
    if (o->tf.n > 1) slope *= (double)o->tf.knot[o->tf.n - 1] - (double)o->tf.knot[1]; /* in parts of the range */
    return most * (2e-6 + tetcasti_min(1e-7 * slope * path, 2e-5));
}

static void tetcasti_optics_bounds(tetcast_optics *o, const tetcast_optics_desc *d) {
    const double path = (double)d->path_length, most = tetcasti_brightest(o, path > 0.0 ? path : 1.0);
    const int volume = o->model == TETCAST_MODEL_VOLUME || o->model == TETCAST_MODEL_MIXED;
    double t_min = 1.0 / 512.0, room;
    o->info.bound_integral = (float)(tetcasti_rounding(o, path > 0.0 ? path : 1.0, most) * 255.0);
    room = (double)d->tolerance - (double)o->info.bound_integral - (double)o->info.bound_knots;
    if (d->t_min != 0.0f) t_min = (double)d->t_min;
    else if (d->tolerance > 0.0f) t_min = room > 0.0 ? tetcasti_min(room / 255.0 / most, 0.5) : -1.0;
    if (!volume && o->model != TETCAST_MODEL_ISOSURFACE) t_min = -1.0;
    o->t_stop = t_min < 0.0 ? -INFINITY : (float)t_min;
    o->info.t_min = t_min < 0.0 ? -1.0f : (float)t_min;
    o->info.bound_end = t_min < 0.0 ? 0.0f : (float)(t_min * most * 255.0);
    if (volume && o->integrator != TETCAST_INTEGRATOR_EXACT) o->info.bound_integral = -1.0f;
    o->info.bound = o->info.bound_integral < 0.0f ? -1.0f : o->info.bound_integral + o->info.bound_end +
        o->info.bound_knots;
}

static tetcast_result tetcasti_optics_tables(tetcast_optics *o, const tetcast_optics *old,
                                             const tetcast_optics_desc *d) {
    const int volume = o->model == TETCAST_MODEL_VOLUME || o->model == TETCAST_MODEL_MIXED;
    tetcasti_table *t = &o->table;
    uint32_t a = 0, b;
    tetcast_result r;
    if (!volume) return TETCAST_OK;
    if (o->integrator == TETCAST_INTEGRATOR_PSI_TABLE) {
        const size_t count = (size_t)TETCASTI_PSI_SIZE * TETCASTI_PSI_SIZE;
        o->psi = (float *)tetcasti_alloc_array(&o->mem, count, sizeof *o->psi);
        if (o->psi == NULL) return TETCAST_ERR_NO_MEMORY;
        o->info.table_bytes = count * sizeof *o->psi;
        if (old != NULL && old->psi != NULL) memcpy(o->psi, old->psi, o->info.table_bytes); /* of no function */
        else tetcasti_parallel_for(&d->env, tetcasti_psi_row, o->psi, TETCASTI_PSI_SIZE);
    }
    if (!tetcasti_has_table(o->integrator)) return TETCAST_OK;
    r = tetcasti_table_alloc(o, d);
    if (r != TETCAST_OK) return r;
    o->info.table_bytes = (size_t)t->values * t->values * t->lengths * sizeof *t->entry;
    b = t->values - 1;
    if (old != NULL && old->integrator == o->integrator && old->table.entry != NULL &&
        o->integrator != TETCAST_INTEGRATOR_TABLE_PREFIX && /* differences of sums over the whole range */
        old->table.values == t->values && old->table.lengths == t->lengths && old->table.longest == t->longest &&
        old->table.first == t->first && old->table.scale == t->scale) {
        float lo, hi;
        double x, y;
        tetcasti_tf_difference(&old->tf, &o->tf, &lo, &hi);
        memcpy(t->entry, old->table.entry, o->info.table_bytes);
        if (lo > hi) return TETCAST_OK;
        x = ((double)lo - (double)t->first) * (double)t->scale - 1.0; /* one column more on each side */
        y = ((double)hi - (double)t->first) * (double)t->scale + 2.0;
        a = x > 0.0 ? (x < (double)b ? (uint32_t)x : b) : 0;
        b = y > 0.0 ? (y < (double)b ? (uint32_t)y : b) : 0;
    }
    return tetcasti_table_build(o, &d->env, a, b);
}

static tetcast_result tetcasti_optics_make(const tetcast_optics *old, const tetcast_transfer *transfer,
                                           const tetcast_optics_desc *desc, tetcast_optics **out) {
    tetcast_optics_desc d;
    tetcasti_mem mem;
    tetcast_optics *o;
    tetcast_result r;
    if (out == NULL) return TETCAST_ERR_INVALID_ARG;
    *out = NULL;
    if (transfer == NULL) return TETCAST_ERR_INVALID_ARG;
    if (desc != NULL) d = *desc;
    else memset(&d, 0, sizeof d);
    r = tetcasti_optics_check(&d);
    if (r == TETCAST_ERR_UNINIT_DESC) return r;
    if (r == TETCAST_OK) r = tetcasti_env_open(&d.env, &mem);
    if (r != TETCAST_OK) return tetcasti_fail(d.env.error, r, 0, "optics: a number or an enum is out of range");
    o = (tetcast_optics *)tetcasti_alloc_zero(&mem, 1, sizeof *o);
    if (o == NULL) return TETCAST_ERR_NO_MEMORY;
    o->mem = mem;
    tetcasti_optics_plain(o, &d);
    if (transfer->iso_count != 0 && (d.model == TETCAST_MODEL_ISOSURFACE || d.model == TETCAST_MODEL_MIXED)) {
        o->iso = (tetcast_isovalue *)tetcasti_alloc_array(&o->mem, transfer->iso_count, sizeof *o->iso);
        if (o->iso == NULL) r = TETCAST_ERR_NO_MEMORY;
        else {
            memcpy(o->iso, transfer->iso, transfer->iso_count * sizeof *o->iso);
            o->iso_count = transfer->iso_count;
        }
    }
    o->cue = d.cue != 0;
    if (r == TETCAST_OK) r = tetcasti_optics_knots(o, transfer, &d);
    if (r == TETCAST_OK) {
        o->max_scale = o->tf.max_emission > 0.0f ? 1.0f / o->tf.max_emission : 0.0f;
        o->t_stop = -INFINITY; /* while tables are built */
        o->cue = 0;
        o->piece8 = tetcasti_exact8_pick(o, tetcast_isa_best());
        r = tetcasti_optics_tables(o, old, &d);
    }
    if (r != TETCAST_OK) {
        tetcast_optics_destroy(o);
        return r;
    }
    tetcasti_optics_bounds(o, &d);
    o->cue = d.cue != 0;
    o->piece = tetcasti_exact_pick(o);
    o->piece8 = tetcasti_exact8_pick(o, tetcast_isa_best());
    o->segment = tetcasti_segment_pick(o);
    o->segment8 = tetcasti_segment8_pick(o, tetcast_isa_best());
    o->info.model = o->model;
    o->info.integrator = o->integrator;
    *out = o;
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_optics_create(const tetcast_transfer *transfer, const tetcast_optics_desc *desc,
                                                 tetcast_optics **out) {
    return tetcasti_optics_make(NULL, transfer, desc, out);
}

TETCAST_DEF tetcast_result tetcast_optics_update(const tetcast_optics *old, const tetcast_transfer *transfer,
                                                 const tetcast_optics_desc *desc, tetcast_optics **out) {
    return tetcasti_optics_make(old, transfer, desc, out);
}

TETCAST_DEF void tetcast_optics_destroy(tetcast_optics *optics) {
    tetcasti_mem mem;
    if (optics == NULL) return;
    mem = optics->mem;
    tetcasti_tf_free(&mem, &optics->tf);
    tetcasti_free(&mem, optics->iso);
    tetcasti_free(&mem, optics->psi);
    tetcasti_free(&mem, optics->table.entry);
    tetcasti_free(&mem, optics);
}

TETCAST_DEF void tetcast_optics_get_info(const tetcast_optics *optics, tetcast_optics_info *info) {
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (optics != NULL) *info = optics->info;
}

static int tetcasti_segment_ok(const tetcast_segment *s) {
    return tetcasti_absf(s->front) < TETCASTI_VALUE_END && tetcasti_absf(s->back) < TETCASTI_VALUE_END &&
           s->length >= 0.0f && s->length < 1e18f && tetcasti_finite_f(s->depth);
}

TETCAST_DEF tetcast_result tetcast_optics_ray(const tetcast_optics *optics, const tetcast_segment *segments,
                                              size_t count, float rgba[4], size_t *used) {
    static const float view[3] = {0.0f, 0.0f, 1.0f};
    tetcasti_ray_sum sum;
    size_t i;
    if (used != NULL) *used = 0;
    if (optics == NULL || rgba == NULL || (count != 0 && segments == NULL)) return TETCAST_ERR_INVALID_ARG;
    memset(rgba, 0, 4 * sizeof *rgba);
    tetcasti_ray_begin(optics, &sum);
    for (i = 0; i < count; i++) {
        const tetcast_segment *s = &segments[i];
        if (!tetcasti_segment_ok(s)) return TETCAST_ERR_INVALID_ARG;
        if (tetcasti_ray_ended(optics, &sum)) break;
        if (i != 0 && s->front != s[-1].back) tetcasti_ray_gap(optics, &sum);
        if (optics->iso_count != 0) {
            tetcasti_segment_iso(optics, s->front, s->back, s->length, s->depth, NULL, NULL, view, &sum);
        } else {
            optics->segment(optics, s->front, s->back, s->length, s->depth, &sum);
        }
    }
    tetcasti_ray_finish(optics, &sum, rgba);
    if (used != NULL) *used = i;
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_optics_segments(const tetcast_optics *optics, const tetcast_segment *segments,
                                                   size_t count, tetcast_isa isa, float (*rgba)[4]) {
    tetcasti_segment8_fn *fn;
    size_t i;
    uint32_t k, n;
    if (optics == NULL || (count != 0 && (segments == NULL || rgba == NULL))) return TETCAST_ERR_INVALID_ARG;
    for (i = 0; i < count; i++) if (!tetcasti_segment_ok(&segments[i])) return TETCAST_ERR_INVALID_ARG;
    fn = tetcasti_segment8_pick(optics, isa == TETCAST_ISA_AUTO || isa > tetcast_isa_best() ? tetcast_isa_best() : isa);
    for (i = 0; i < count; i += 8) {
        tetcasti_seg8 seg;
        tetcasti_ray_sum8 sum;
        n = count - i < 8 ? (uint32_t)(count - i) : 8u;
        if (optics->iso_count != 0) {
            for (k = 0; k < n; k++) (void)tetcast_optics_ray(optics, &segments[i + k], 1, rgba[i + k], NULL);
            continue;
        }
        for (k = 0; k < 8; k++) {
            const tetcast_segment *s = &segments[i + (k < n ? k : 0)];
            seg.front[k] = s->front;
            seg.back[k] = s->back;
            seg.length[k] = s->length;
            seg.depth[k] = s->depth;
            tetcasti_lane_begin(optics, &sum, k);
        }
        (void)fn(optics, &seg, (1u << n) - 1u, &sum);
        for (k = 0; k < n; k++) tetcasti_lane_finish(optics, &sum, k, rgba[i + k]);
    }
    return TETCAST_OK;
}
/* ---------------------------------------------------------------------------
   isosurface: marching tetrahedra with one vertex per edge.                     // >>isosurface

   inside[v]  1 when the value of vertex v is at least the isovalue
   active     cells whose four vertices do not agree, in their order; kind: the 4 bits of their vertices
   edge       the edges that cross, {smaller vertex, larger}, those of one chunk of cells only once: a small hash table
              per chunk finds four in five of all repetitions
   use        the 3 or 4 edges of each active cell, in the order of tetcasti_iso_case
   Clusters of cells whose range does not hold the isovalue are not looked at. The edges of all chunks are put together
   by counting sort over the smaller vertex; the few edges of one vertex are compared with each other. Vertices of the
   surface are numbered by (smaller, larger) vertex of their edge: neighbours lie close together.
   A. Doi, A. Koide: An efficient method of triangulating equivalued surfaces by using tetrahedral cells. IEICE
   Transactions E74, 1991.
   --------------------------------------------------------------------------- */

/* Edges of a tetrahedron: 01 02 03 12 13 23. Of each case: how many edges, which ones; one triangle (0, 1, 2) or two
   (0, 1, 2), (0, 2, 3). For a positive tetrahedron they are counter-clockwise seen from the vertices outside. */
static const uint8_t tetcasti_edge_of[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
static const uint8_t tetcasti_iso_case[16][5] = {
    {0, 0, 0, 0, 0}, {3, 0, 1, 2, 0}, {3, 0, 4, 3, 0}, {4, 1, 2, 4, 3}, {3, 1, 3, 5, 0}, {4, 0, 3, 5, 2},
    {4, 0, 4, 5, 1}, {3, 2, 4, 5, 0}, {3, 2, 5, 4, 0}, {4, 0, 1, 5, 4}, {4, 0, 2, 5, 3}, {3, 1, 5, 3, 0},
    {4, 1, 3, 4, 2}, {3, 0, 3, 4, 0}, {3, 0, 2, 1, 0}, {0, 0, 0, 0, 0}};

#define TETCASTI_ISO_CHUNK 32768u

typedef struct tetcasti_iso_edge { uint32_t a, b; } tetcasti_iso_edge; /* a < b */

typedef struct tetcasti_iso {
    const tetcast_mesh *mesh;
    float isovalue;
    uint8_t *inside;         /* per vertex */
    uint32_t chunks;
    uint32_t (*first)[3];    /* per chunk: active cells, edges, triangles; then where its own begin. [chunks + 1] */
    uint32_t *active;        /* cell; each chunk has room for all of its cells, and fills the beginning */
    uint8_t *kind;           /* its case */
    uint32_t *use;           /* per edge of an active cell: its place in `edge` */
    tetcasti_iso_edge *edge; /* each chunk has as much room as it uses edges, and fills the beginning */
    uint32_t *filled;        /* per chunk: edges */
    uint32_t failed;         /* no memory for a table */
    tetcasti_mem *mem;
    const float (*range)[2]; /* of clusters; NULL: there are none */
    uint32_t *start;         /* per vertex of the mesh, + 1: its edges in `order` */
    uint32_t *order;         /* numbers of edges by their smaller vertex */
    uint32_t *vertex;        /* per edge: vertex of the surface */
    uint32_t vertex_chunks;
    uint32_t *unique;        /* per chunk of vertices: how many vertices of the surface, then the first one's number */
    tetcast_surface *out;
    uint32_t flat[2];        /* tally */
} tetcasti_iso;

TETCASTI_INLINE int tetcasti_iso_hidden(const tetcast_mesh *mesh, uint32_t cell) {
    return mesh->hidden != NULL && (mesh->hidden[cell >> 5] >> (cell & 31u) & 1u);
}

static void tetcasti_task_iso_inside(void *ctx, uint32_t chunk) {
    tetcasti_iso *p = (tetcasti_iso *)ctx;
    uint32_t i = chunk * TETCASTI_ISO_CHUNK, end = p->mesh->vertex_count - i;
    end = i + (end < TETCASTI_ISO_CHUNK ? end : TETCASTI_ISO_CHUNK);
    for (; i < end; i++) p->inside[i] = p->mesh->vertex[i].s >= p->isovalue;
}

TETCASTI_INLINE uint32_t tetcasti_iso_kind(const tetcasti_iso *p, uint32_t cell) {
    const uint32_t *t = p->mesh->tet[cell];
    return (uint32_t)p->inside[t[0]] | (uint32_t)p->inside[t[1]] << 1 | (uint32_t)p->inside[t[2]] << 2 |
           (uint32_t)p->inside[t[3]] << 3;
}

/* May cells from i on cross? *end: of the run that this is said of, a cluster or what is left of it. */
TETCASTI_INLINE int tetcasti_iso_crosses(const tetcasti_iso *p, uint32_t i, uint32_t limit, uint32_t *end) {
    const float *range;
    *end = limit;
    if (p->range == NULL) return 1;
    range = p->range[i >> TETCASTI_CLUSTER_LOG];
    *end = ((i >> TETCASTI_CLUSTER_LOG) + 1) << TETCASTI_CLUSTER_LOG;
    *end = *end < limit ? *end : limit;
    return !(range[1] < p->isovalue || range[0] >= p->isovalue);
}

/* The active cells of a chunk, written without a branch: which they are nobody can foresee. */
static void tetcasti_task_iso_cells(void *ctx, uint32_t chunk) {
    tetcasti_iso *p = (tetcasti_iso *)ctx;
    const uint32_t begin = chunk * TETCASTI_ISO_CHUNK, left = p->mesh->cell_count - begin;
    const uint32_t limit = begin + (left < TETCASTI_ISO_CHUNK ? left : TETCASTI_ISO_CHUNK);
    uint32_t *active = p->active + begin, i, end, n = 0, edges = 0;
    uint8_t *kinds = p->kind + begin;
    for (i = begin; i < limit; i = end) {
        if (!tetcasti_iso_crosses(p, i, limit, &end)) continue;
        for (; i < end; i++) {
            uint32_t kind = tetcasti_iso_kind(p, i), count;
            if (tetcasti_iso_hidden(p->mesh, i)) kind = 0;
            count = tetcasti_iso_case[kind][0];
            active[n] = i;
            kinds[n] = (uint8_t)kind;
            n += count != 0;
            edges += count;
        }
    }
    p->first[chunk][0] = n;
    p->first[chunk][1] = edges;
    p->first[chunk][2] = edges - 2 * n; /* triangles */
}

static void tetcasti_task_iso_edges(void *ctx, uint32_t chunk) {
    tetcasti_iso *p = (tetcasti_iso *)ctx;
    const uint32_t *active = p->active + (size_t)chunk * TETCASTI_ISO_CHUNK;
    const uint8_t *kinds = p->kind + (size_t)chunk * TETCASTI_ISO_CHUNK;
    uint32_t i, n = p->first[chunk + 1][0] - p->first[chunk][0], size = 64, k, *table;
    uint32_t e = p->first[chunk][1], fresh = e, most = p->first[chunk + 1][1] - e;
    p->filled[chunk] = 0;
    if (n == 0) return;
    while (size < most + most / 2) size *= 2; /* at most 2^18 */
    table = (uint32_t *)tetcasti_alloc_zero(p->mem, size, sizeof *table); /* place in `edge` + 1 */
    if (table == NULL) {
        tetcasti_atomic_store(&p->failed, 1u);
        return;
    }
    for (i = 0; i < n; i++) {
        const uint32_t *t = p->mesh->tet[active[i]];
        const uint8_t *row = tetcasti_iso_case[kinds[i]];
        for (k = 0; k < row[0]; k++, e++) {
            const uint8_t *ends = tetcasti_edge_of[row[1 + k]];
            uint32_t x = t[ends[0]], y = t[ends[1]], a = x < y ? x : y, b = x < y ? y : x;
            uint32_t h = (a * 0x9e3779b1u + b * 0x85ebca77u) >> 8 & (size - 1);
            while (table[h] != 0 && (p->edge[table[h] - 1].a != a || p->edge[table[h] - 1].b != b))
                h = (h + 1) & (size - 1);
            if (table[h] == 0) {
                p->edge[fresh].a = a;
                p->edge[fresh].b = b;
                table[h] = ++fresh;
            }
            p->use[e] = table[h] - 1;
        }
    }
    p->filled[chunk] = fresh - p->first[chunk][1];
    tetcasti_free(p->mem, table);
}

/* Edges by their smaller vertex. Serial: it is a pass over the edges alone, and they are few. */
static void tetcasti_iso_sort(tetcasti_iso *p) {
    uint32_t n = p->mesh->vertex_count, i, c, sum = 0;
    memset(p->start, 0, ((size_t)n + 1) * sizeof *p->start);
    for (c = 0; c < p->chunks; c++)
        for (i = 0; i < p->filled[c]; i++) p->start[p->edge[p->first[c][1] + i].a]++;
    for (i = 0; i < n; i++) {
        sum += p->start[i];
        p->start[i] = sum; /* the end, moved down by what follows */
    }
    p->start[n] = sum;
    for (c = p->chunks; c-- > 0;)
        for (i = p->first[c][1] + p->filled[c]; i-- > p->first[c][1];) p->order[--p->start[p->edge[i].a]] = i;
}

/* order[0 .. n) by larger vertex, equal ones in the order they are in. A handful as a rule; a fan has thousands. */
static void tetcasti_iso_order(const tetcasti_iso *p, uint32_t *order, uint32_t n) {
    uint32_t gap, i, j;
    for (gap = n > 32 ? n / 2 : 1; gap > 0; gap = gap == 2 ? 1 : (uint32_t)((uint64_t)gap * 5 / 11)) {
        for (i = gap; i < n; i++) {
            const uint64_t key = (uint64_t)p->edge[order[i]].b << 32 | order[i];
            for (j = i; j >= gap; j -= gap) {
                const uint32_t f = order[j - gap];
                if (((uint64_t)p->edge[f].b << 32 | f) < key) break;
                order[j] = f;
            }
            order[j] = (uint32_t)key;
        }
    }
}

/* Equal edges of each vertex get one number, local to the chunk first. */
static void tetcasti_task_iso_unique(void *ctx, uint32_t chunk) {
    tetcasti_iso *p = (tetcasti_iso *)ctx;
    uint32_t v = chunk * TETCASTI_ISO_CHUNK, end = p->mesh->vertex_count - v, count = 0;
    end = v + (end < TETCASTI_ISO_CHUNK ? end : TETCASTI_ISO_CHUNK);
    for (; v < end; v++) {
        uint32_t first = p->start[v], last = p->start[v + 1], i;
        tetcasti_iso_order(p, p->order + first, last - first);
        for (i = first; i < last; i++) {
            count += i == first || p->edge[p->order[i]].b != p->edge[p->order[i - 1]].b;
            p->vertex[p->order[i]] = count - 1;
        }
    }
    p->unique[chunk] = count;
}

static void tetcasti_task_iso_vertices(void *ctx, uint32_t chunk) {
    tetcasti_iso *p = (tetcasti_iso *)ctx;
    const tetcast_mesh *mesh = p->mesh;
    uint32_t v = chunk * TETCASTI_ISO_CHUNK, end = mesh->vertex_count - v, base = p->unique[chunk], i;
    end = v + (end < TETCASTI_ISO_CHUNK ? end : TETCASTI_ISO_CHUNK);
    for (i = p->start[v]; i < p->start[end]; i++) {
        uint32_t e = p->order[i], at = base + p->vertex[e];
        tetcasti_iso_edge edge = p->edge[e];
        const tetcasti_vertex *a = &mesh->vertex[edge.a], *b = &mesh->vertex[edge.b];
        double u = ((double)p->isovalue - (double)a->s) / ((double)b->s - (double)a->s);
        float *out = p->out->positions + 3 * (size_t)at;
        p->vertex[e] = at;
        if (i > p->start[v] && p->edge[p->order[i - 1]].a == edge.a && p->edge[p->order[i - 1]].b == edge.b) continue;
        out[0] = (float)(((double)a->x + u * ((double)b->x - (double)a->x)) * mesh->unit);
        out[1] = (float)(((double)a->y + u * ((double)b->y - (double)a->y)) * mesh->unit);
        out[2] = (float)(((double)a->z + u * ((double)b->z - (double)a->z)) * mesh->unit);
        if (p->out->normals != NULL) { /* along the edge, unless something better is known */
            float *normal = p->out->normals + 3 * (size_t)at, down = b->s < a->s ? 1.0f : -1.0f, smooth[3];
            int k;
            normal[0] = (b->x - a->x) * down;
            normal[1] = (b->y - a->y) * down;
            normal[2] = (b->z - a->z) * down;
            if (!tetcasti_normalize(normal)) normal[0] = normal[1] = normal[2] = 0.0f;
            if (mesh->gradient == NULL) continue;
            for (k = 0; k < 3; k++) {
                double g = (double)mesh->gradient[edge.a][k], h = (double)mesh->gradient[edge.b][k];
                smooth[k] = -(float)(g + u * (h - g));
            }
            if (tetcasti_normalize(smooth)) memcpy(normal, smooth, sizeof smooth);
        }
    }
}

static void tetcasti_task_iso_triangles(void *ctx, uint32_t chunk) {
    tetcasti_iso *p = (tetcasti_iso *)ctx;
    const uint32_t end = chunk * TETCASTI_ISO_CHUNK + (p->first[chunk + 1][0] - p->first[chunk][0]);
    uint32_t at = chunk * TETCASTI_ISO_CHUNK, e = p->first[chunk][1], triangle = p->first[chunk][2], k, flat = 0;
    for (; at < end; at++) {
        uint32_t edges = tetcasti_iso_case[p->kind[at]][0];
        for (k = 0; k + 2 < edges; k++, triangle++) {
            uint32_t *out = p->out->indices + 3 * (size_t)triangle;
            const float *a, *b, *c;
            out[0] = p->vertex[p->use[e]];
            out[1] = p->vertex[p->use[e + k + 1]];
            out[2] = p->vertex[p->use[e + k + 2]];
            a = p->out->positions + 3 * (size_t)out[0];
            b = p->out->positions + 3 * (size_t)out[1];
            c = p->out->positions + 3 * (size_t)out[2];
            flat += memcmp(a, b, 12) == 0 || memcmp(b, c, 12) == 0 || memcmp(a, c, 12) == 0;
            if (p->out->cells != NULL) p->out->cells[triangle] = p->active[at];
        }
        e += edges;
    }
    tetcasti_tally_add(p->flat, flat);
}

/* Without gradients: normals of the triangles around, weighted by their areas. In the order of the triangles. 0:
   memory. */
static int tetcasti_iso_flat_normals(tetcast_surface *s, tetcasti_mem *mem) {
    float *sum = (float *)tetcasti_alloc_zero(mem, s->vertex_count, 3 * sizeof(float));
    uint32_t i, k;
    if (sum == NULL) return 0;
    for (i = 0; i < s->triangle_count; i++) {
        const uint32_t *v = s->indices + 3 * (size_t)i;
        const float *a = s->positions + 3 * (size_t)v[0], *b = s->positions + 3 * (size_t)v[1];
        const float *c = s->positions + 3 * (size_t)v[2];
        float p[3], q[3], n[3];
        for (k = 0; k < 3; k++) {
            p[k] = b[k] - a[k];
            q[k] = c[k] - a[k];
        }
        n[0] = p[1] * q[2] - p[2] * q[1];
        n[1] = p[2] * q[0] - p[0] * q[2];
        n[2] = p[0] * q[1] - p[1] * q[0];
        /* no direction but noise */
        if (tetcasti_dot3(n, n) <= 1e-8f * tetcasti_dot3(p, p) * tetcasti_dot3(q, q)) continue;
        for (k = 0; k < 9; k++) sum[3 * (size_t)v[k / 3] + k % 3] += n[k % 3];
    }
    for (i = 0; i < s->vertex_count; i++) {
        float *n = sum + 3 * (size_t)i;
        if (tetcasti_normalize(n)) memcpy(s->normals + 3 * (size_t)i, n, 3 * sizeof(float));
    }
    tetcasti_free(mem, sum);
    return 1;
}

/* Counts per chunk -> where each begins; 0 when they do not fit into 32 bits. */
static int tetcasti_iso_sums(tetcasti_iso *p, uint32_t total[3]) {
    uint64_t sum[3] = {0, 0, 0};
    uint32_t c, k;
    for (c = 0; c <= p->chunks; c++)
        for (k = 0; k < 3; k++) {
            uint32_t n = c < p->chunks ? p->first[c][k] : 0;
            if (sum[k] > 0xfffffff0u) return 0;
            p->first[c][k] = (uint32_t)sum[k];
            sum[k] += n;
        }
    for (k = 0; k < 3; k++) total[k] = p->first[p->chunks][k];
    return 1;
}

static tetcast_result tetcasti_iso_run(tetcasti_iso *p, const tetcast_surface_desc *desc, tetcasti_mem *mem,
                                       tetcasti_mem *keep) {
    const tetcast_mesh *mesh = p->mesh;
    const tetcast_env *env = &desc->env;
    tetcast_surface *out = p->out;
    uint32_t total[3], c, sum = 0;
    p->chunks = mesh->cell_count / TETCASTI_ISO_CHUNK + 1;
    p->vertex_chunks = mesh->vertex_count / TETCASTI_ISO_CHUNK + 1;
    p->inside = (uint8_t *)tetcasti_alloc(mem, mesh->vertex_count);
    p->first = (uint32_t (*)[3])tetcasti_alloc_array(mem, (size_t)p->chunks + 1, sizeof *p->first);
    p->active = (uint32_t *)tetcasti_alloc_array(mem, mesh->cell_count, sizeof *p->active);
    p->kind = (uint8_t *)tetcasti_alloc(mem, mesh->cell_count);
    if (!p->inside || !p->first || !p->active || !p->kind) return TETCAST_ERR_NO_MEMORY;
    tetcasti_parallel_for(env, tetcasti_task_iso_inside, p, p->vertex_chunks);
    tetcasti_parallel_for(env, tetcasti_task_iso_cells, p, p->chunks);
    if (!tetcasti_iso_sums(p, total)) return tetcasti_fail(env->error, TETCAST_ERR_RANGE, 0, "too many triangles");
    if (total[0] == 0) return TETCAST_OK;
    p->edge = (tetcasti_iso_edge *)tetcasti_alloc_array(mem, total[1], sizeof *p->edge);
    p->use = (uint32_t *)tetcasti_alloc_array(mem, total[1], sizeof *p->use);
    p->filled = (uint32_t *)tetcasti_alloc_array(mem, p->chunks, sizeof *p->filled);
    p->start = (uint32_t *)tetcasti_alloc_array(mem, (size_t)mesh->vertex_count + 1, sizeof *p->start);
    p->order = (uint32_t *)tetcasti_alloc_array(mem, total[1], sizeof *p->order);
    p->vertex = (uint32_t *)tetcasti_alloc_array(mem, total[1], sizeof *p->vertex);
    p->unique = (uint32_t *)tetcasti_alloc_array(mem, p->vertex_chunks, sizeof *p->unique);
    if (!p->edge || !p->use || !p->filled || !p->start || !p->order || !p->vertex || !p->unique)
        return TETCAST_ERR_NO_MEMORY;
    tetcasti_parallel_for(env, tetcasti_task_iso_edges, p, p->chunks);
    if (p->failed) return TETCAST_ERR_NO_MEMORY;
    tetcasti_iso_sort(p);
    tetcasti_parallel_for(env, tetcasti_task_iso_unique, p, p->vertex_chunks);
    for (c = 0; c < p->vertex_chunks; c++) {
        uint32_t n = p->unique[c];
        p->unique[c] = sum;
        sum += n; /* at most all edges */
    }
    out->positions = (float *)tetcasti_alloc_array(keep, sum, 3 * sizeof(float));
    out->indices = (uint32_t *)tetcasti_alloc_array(keep, total[2], 3 * sizeof(uint32_t));
    if (desc->normals) out->normals = (float *)tetcasti_alloc_array(keep, sum, 3 * sizeof(float));
    if (desc->cells) out->cells = (uint32_t *)tetcasti_alloc_array(keep, total[2], sizeof(uint32_t));
    if (!out->positions || !out->indices || (desc->normals && !out->normals) || (desc->cells && !out->cells))
        return TETCAST_ERR_NO_MEMORY;
    out->vertex_count = sum;
    out->triangle_count = total[2];
    tetcasti_parallel_for(env, tetcasti_task_iso_vertices, p, p->vertex_chunks);
    tetcasti_parallel_for(env, tetcasti_task_iso_triangles, p, p->chunks);
    out->flat_count = (uint32_t)tetcasti_tally(p->flat);
    if (out->normals != NULL && mesh->gradient == NULL && !tetcasti_iso_flat_normals(out, mem))
        return TETCAST_ERR_NO_MEMORY;
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_isosurface(const tetcast_surface_desc *desc, const tetcast_mesh *mesh,
                                              tetcast_surface *out) {
    tetcast_surface_desc none;
    tetcasti_mem mem, keep;
    tetcasti_iso p;
    tetcast_result result;
    if (out == NULL) return TETCAST_ERR_INVALID_ARG;
    memset(out, 0, sizeof *out);
    memset(&none, 0, sizeof none);
    if (desc == NULL) desc = &none;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    if (mesh == NULL || !tetcasti_finite_f(desc->isovalue)) return TETCAST_ERR_INVALID_ARG;
    result = tetcasti_env_open(&desc->env, &mem);
    if (result != TETCAST_OK) return result;
    if (mesh->tet == NULL)
        return tetcasti_fail(desc->env.error, TETCAST_ERR_INVALID_ARG, 0, "the mesh has dropped its tetrahedra");
    if (mesh->cell_value != NULL)
        return tetcasti_fail(desc->env.error, TETCAST_ERR_INVALID_ARG, 0, "the active field is one per cell");
    if (mesh->field_count == 0) return TETCAST_OK;
    memset(&p, 0, sizeof p);
    p.mesh = mesh;
    p.isovalue = desc->isovalue;
    p.mem = &mem;
    p.range = (const float (*)[2])mesh->field[mesh->active].range;
    p.out = out;
    keep = mem; /* what the caller frees later has no counter to report to */
    out->_allocator = mem.allocator;
    memcpy(out->origin, mesh->origin, sizeof out->origin);
    result = tetcasti_iso_run(&p, desc, &mem, &keep);
    tetcasti_free(&mem, p.inside);
    tetcasti_free(&mem, p.first);
    tetcasti_free(&mem, p.active);
    tetcasti_free(&mem, p.kind);
    tetcasti_free(&mem, p.edge);
    tetcasti_free(&mem, p.use);
    tetcasti_free(&mem, p.filled);
    tetcasti_free(&mem, p.start);
    tetcasti_free(&mem, p.order);
    tetcasti_free(&mem, p.vertex);
    tetcasti_free(&mem, p.unique);
    if (result == TETCAST_OK) return TETCAST_OK;
    tetcast_surface_free(out);
    return result == TETCAST_ERR_NO_MEMORY
               ? tetcasti_fail(desc->env.error, result, 0, "out of memory for the isosurface") : result;
}

TETCAST_DEF void tetcast_surface_free(tetcast_surface *surface) {
    tetcasti_mem mem;
    if (surface == NULL) return;
    memset(&mem, 0, sizeof mem);
    mem.allocator = surface->_allocator;
    tetcasti_free(&mem, surface->positions);
    tetcasti_free(&mem, surface->normals);
    tetcasti_free(&mem, surface->indices);
    tetcasti_free(&mem, surface->cells);
    memset(surface, 0, sizeof *surface);
}
/* ---------------------------------------------------------------------------
   project: cells -> the pixels that they cover.                                 // >>project

   Seen from the eye a vertex is a place in the picture, a depth and w = 1/depth. Along a picture everything that is
   linear in space is linear once it is multiplied by w, so depth and value on a face follow from the weights of its
   vertices, which are the edge functions of the other two: E(a, b) = a x b with a and b relative to the pixel. A cell
   has six edges; their signs say which two of its faces a pixel lies in. Two forms are possible: one face in front of
   (or behind) three, or two in front of two. No silhouette is cut into triangles, no face is drawn twice.

   The signs are those of the walker: which pixels a cell covers, and through which faces, is decided by the same exact
   determinants. Edge functions are evaluated as floats, with a bound for everything that may be different between them
   and the walker's: its rounded positions, the places in the picture, the roundings here. Where an edge function is
   nearer to zero than its bound, and for cells with a face seen edge-on, behind the eye or far outside of the picture,
   the walker's own arithmetic is used. So a pixel is covered by exactly the cells that a ray would walk through.

   Cells are put into bins, one for each tile of the picture, and each tile draws what is in its bin (see order).
   Weiler's variants, which find the way out of a cell per vertex or per fragment of each front face, and the projected
   tetrahedra of Shirley and Tuchman (1990) are in bench/baseline.
   --------------------------------------------------------------------------- */

#define TETCASTI_PLACE_LOG 28      /* the picture's larger side in units of a place is at most 2^this */
#define TETCASTI_NEAR 65536.0      /* local depth from which on the picture's coordinates are used */
#define TETCASTI_WALK_SIZE 65536u  /* largest side of a picture that can be projected */
#define TETCASTI_SAMPLES 512u      /* cells that are looked at to find out how large they are */
#define TETCASTI_FEW_CELLS 65536u  /* with more cells, they are not large */
#define TETCASTI_PROJECT_FROM 16000.0f /* pixels per cell from which on projection is the faster way (measured) */

typedef struct tetcasti_seen {
    int32_t x, y;   /* multiples of 2^-log of a pixel; pixel k has its centre at k + 1/2 */
    float z;        /* local depth along the view, minus that of reference */
    float w;        /* reciprocal depth, 1 at w_scale; negative: x or y is clamped; -infinity: too near or behind */
} tetcasti_seen;

/* A cell on its way into a tile. */
typedef struct tetcasti_entry { uint32_t cell; float z, nearest; } tetcasti_entry; /* z: mean depth */

typedef struct tetcasti_view {
    const tetcasti_scene *scene;
    tetcasti_pixels pixels;     /* of the whole picture; center_x, center_y in pixels of it */
    uint32_t log;
    double reference, w_scale;
    double x_end[2], y_end[2];  /* places between which coordinates are used */
    float blur;                 /* pixels by which a vertex with w = 1 may be elsewhere for the walker */
    float place;                /* 2^-log */
    uint32_t tiles_x, tiles_y;
    tetcasti_seen *seen;        /* per vertex */
    uint32_t *cluster_hidden;   /* NULL, or one bit a cluster: not drawn */
    uint32_t chunk, chunks;     /* cells of a task of binning, number of tasks */
    uint32_t *start;            /* [tile * chunks + chunk]: first place in entry, [tiles * chunks] the end */
    tetcasti_entry *entry;
    const uint32_t *rank;       /* NULL, or order of the cells from front to back instead of by depth */
    uint32_t taken[2];          /* atomic: cells in bins */
} tetcasti_view;

/* How a cell is drawn: edge functions at pixel (x0 + x, y0 + y) are a x + (b y + c), scaled to be positive inside.
   form 0, 1: roles a b c: the single face, d: the vertex behind it (0: the face is in front, 1: at the back).
              edges ab bc ca | ad bd cd
   form 2     roles p q r s: front faces share pq, faces at the back share rs. edges pr rq qs sp | pq rs */
typedef struct tetcasti_splat {
    float a[8], b[8], c[8];     /* six are used */
    float w[4], wz[4], ws[4];   /* per vertex, by role: w, w times depth, w times value */
    float bound;                /* edge functions that are nearer to zero do not decide */
    float s_lo, s_hi;
    uint32_t form;
    int32_t x0, y0;
} tetcasti_splat;

/* What one pixel sees of one cell: depths as in tetcasti_seen, values. */
typedef struct tetcasti_fragment {
    float z0, z1, s0, s1;
    uint32_t cell;
} tetcasti_fragment;

/* ---- vertices ---- */

static tetcasti_seen tetcasti_see(const tetcasti_view *v, const tetcasti_vertex *p) {
    const tetcasti_pixels *m = &v->pixels;
    double q[3], z, x, y, inv, scale = 1.0 / (double)v->place;
    tetcasti_seen out;
    q[0] = (double)p->x - m->eye[0];
    q[1] = (double)p->y - m->eye[1];
    q[2] = (double)p->z - m->eye[2];
    z = q[0] * m->forward[0] + q[1] * m->forward[1] + q[2] * m->forward[2];
    out.x = out.y = 0;
    out.z = (float)(z - v->reference);
    out.w = -TETCASTI_INF;
    if (!m->parallel && !(z > TETCASTI_NEAR)) return out;
    inv = m->parallel ? 1.0 : 1.0 / z;
    x = (m->center_x + (q[0] * m->right[0] + q[1] * m->right[1] + q[2] * m->right[2]) * inv) * scale;
    y = (m->center_y - (q[0] * m->up[0] + q[1] * m->up[1] + q[2] * m->up[2]) * inv) * scale;
    out.w = m->parallel ? 1.0f : (float)(v->w_scale * inv);
    if (!(x > v->x_end[0] && x < v->x_end[1] && y > v->y_end[0] && y < v->y_end[1])) {
        out.w = -out.w;
        x = tetcasti_min(tetcasti_max(x, v->x_end[0]), v->x_end[1]);
        y = tetcasti_min(tetcasti_max(y, v->y_end[0]), v->y_end[1]);
    }
    out.x = (int32_t)tetcasti_floor(x + 0.5);
    out.y = (int32_t)tetcasti_floor(y + 0.5);
    return out;
}

static void tetcasti_task_see(void *ctx, uint32_t index) {
    tetcasti_view *v = (tetcasti_view *)ctx;
    uint32_t count = v->scene->mesh->vertex_count, i = index * TETCASTI_CHUNK, end = i + TETCASTI_CHUNK;
    if (end > count) end = count;
    for (; i < end; i++) v->seen[i] = tetcasti_see(v, &v->scene->vertex[i]);
}

/* ---- bins ---- */

TETCASTI_INLINE int32_t tetcasti_place_pixel(int32_t x, uint32_t log) { /* floor of a place in pixels */
    return (int32_t)(((uint32_t)x + 0x80000000u) >> log) - (int32_t)(0x80000000u >> log);
}

/* Pixels of the picture that a cell can cover, [x0, x1) x [y0, y1), its mean and its nearest depth; 0: none. */
static int tetcasti_cell_rect(const tetcasti_view *v, const uint32_t tet[4], int32_t rect[4], float z[2]) {
    const tetcasti_seen *p = &v->seen[tet[0]];
    int32_t lo[2], hi[2], half = (int32_t)(1u << v->log) / 2, margin;
    float near_z = p->z, far_z = p->z, sum_z = p->z, w = tetcasti_absf(p->w), wide;
    uint32_t i;
    lo[0] = hi[0] = p->x;
    lo[1] = hi[1] = p->y;
    for (i = 1; i < 4; i++) {
        p = &v->seen[tet[i]];
        if (p->x < lo[0]) lo[0] = p->x;
        if (p->x > hi[0]) hi[0] = p->x;
        if (p->y < lo[1]) lo[1] = p->y;
        if (p->y > hi[1]) hi[1] = p->y;
        sum_z += p->z;
        near_z = p->z < near_z ? p->z : near_z;
        far_z = p->z > far_z ? p->z : far_z;
        w = tetcasti_absf(p->w) > w ? tetcasti_absf(p->w) : w;
    }
    z[0] = 0.25f * sum_z;
    z[1] = near_z;
    rect[0] = rect[1] = 0;
    rect[2] = (int32_t)v->pixels.width;
    rect[3] = (int32_t)v->pixels.height;
    if (w == TETCASTI_INF) return (double)far_z + v->reference > -2.0 * (double)TETCASTI_MARGIN; /* not all behind */
    wide = v->blur * w / v->place + 2.0f;
    margin = wide < 268435456.0f ? (int32_t)wide : 268435456;
    for (i = 0; i < 2; i++) { /* pixels with their centre in [lo - margin, hi + margin] */
        int32_t from = tetcasti_place_pixel(lo[i] - margin + half - 1, v->log);
        int32_t to = tetcasti_place_pixel(hi[i] + margin - half, v->log) + 1;
        if (from > rect[i]) rect[i] = from;
        if (to < rect[i + 2]) rect[i + 2] = to;
    }
    return rect[0] < rect[2] && rect[1] < rect[3];
}

#if TETCASTI_AVX2
/* tetcasti_cell_rect of eight cells, at[i] the first: returns those that can be seen. */
TETCASTI_TARGET_WALK static uint32_t tetcasti_rects8(const tetcasti_view *v, uint32_t first, int32_t rect[4][8],
                                                     float z[2][8]) {
    static const uint32_t at[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    const __m256 sign = _mm256_set1_ps(-0.0f);
    const __m128i log = _mm_cvtsi32_si128((int)v->log);
    const __m256i flip = _mm256_set1_epi32((int)0x80000000u), base = _mm256_srl_epi32(flip, log);
    __m256i lo[2], hi[2], margin, half = _mm256_set1_epi32((int32_t)(1u << v->log) / 2), one = _mm256_set1_epi32(1);
    __m256i good = _mm256_set1_epi32(-1);
    __m256 ids[4], row[4], w = _mm256_setzero_ps(), sum = w, nearest = w, wide;
    uint32_t i, k, seen, behind, id[8];
    tetcasti_load8x4(v->scene->mesh->tet + first, 4, at, NULL, ids);
    lo[0] = lo[1] = hi[0] = hi[1] = good;
    for (k = 0; k < 4; k++) {
        _mm256_storeu_si256((__m256i *)(void *)id, _mm256_castps_si256(ids[k]));
        tetcasti_load8x4(v->seen, 4, id, NULL, row);
        for (i = 0; i < 2; i++) {
            __m256i c = _mm256_castps_si256(row[i]);
            lo[i] = k == 0 ? c : _mm256_min_epi32(lo[i], c);
            hi[i] = k == 0 ? c : _mm256_max_epi32(hi[i], c);
        }
        sum = k == 0 ? row[2] : _mm256_add_ps(sum, row[2]);
        nearest = k == 0 ? row[2] : _mm256_min_ps(row[2], nearest);
        row[3] = _mm256_andnot_ps(sign, row[3]);
        w = k == 0 ? row[3] : _mm256_max_ps(row[3], w);
    }
    _mm256_storeu_ps(z[0], _mm256_mul_ps(_mm256_set1_ps(0.25f), sum));
    _mm256_storeu_ps(z[1], nearest);
    behind = (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(w, _mm256_set1_ps(TETCASTI_INF), _CMP_EQ_OQ));
    wide = _mm256_add_ps(_mm256_div_ps(_mm256_mul_ps(_mm256_set1_ps(v->blur), w), _mm256_set1_ps(v->place)),
                         _mm256_set1_ps(2.0f));
    margin = _mm256_cvttps_epi32(_mm256_min_ps(wide, _mm256_set1_ps(268435456.0f)));
    for (i = 0; i < 2; i++) {
        __m256i from = _mm256_sub_epi32(_mm256_add_epi32(_mm256_sub_epi32(lo[i], margin), half), one);
        __m256i to = _mm256_sub_epi32(_mm256_add_epi32(hi[i], margin), half);
        from = _mm256_sub_epi32(_mm256_srl_epi32(_mm256_add_epi32(from, flip), log), base);
        to = _mm256_add_epi32(_mm256_sub_epi32(_mm256_srl_epi32(_mm256_add_epi32(to, flip), log), base), one);
        from = _mm256_max_epi32(from, _mm256_setzero_si256());
        to = _mm256_min_epi32(to, _mm256_set1_epi32((int32_t)(i == 0 ? v->pixels.width : v->pixels.height)));
        good = _mm256_and_si256(good, _mm256_cmpgt_epi32(to, from));
        _mm256_storeu_si256((__m256i *)(void *)rect[i], from);
        _mm256_storeu_si256((__m256i *)(void *)rect[i + 2], to);
    }
    seen = (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(good)) & ~behind;
    for (; TETCASTI_UNLIKELY(behind != 0); behind &= behind - 1) {
        int32_t one_rect[4];
        float one_z[2];
        i = tetcasti_ctz64(behind);
        if (!tetcasti_cell_rect(v, v->scene->mesh->tet[first + i], one_rect, one_z)) continue;
        seen |= 1u << i;
        for (k = 0; k < 4; k++) rect[k][i] = one_rect[k];
        z[0][i] = one_z[0];
        z[1][i] = one_z[1];
    }
    return seen;
}
#endif

/* Cells of one chunk into bins: how many go into each, or, once the starts are known, themselves. */
static void tetcasti_bin_chunk(tetcasti_view *v, uint32_t chunk, int fill) {
    const tetcast_mesh *mesh = v->scene->mesh;
    uint32_t i = chunk * v->chunk, end = mesh->cell_count - i < v->chunk ? mesh->cell_count : i + v->chunk, taken = 0;
    uint32_t seen, k;
    int32_t rect[4][8], x, y;
    float z[2][8];
    for (; i < end; i += 8) {
        if (v->cluster_hidden != NULL && tetcasti_bit(v->cluster_hidden, i >> TETCASTI_CLUSTER_LOG)) {
            i |= (1u << TETCASTI_CLUSTER_LOG) - 8u;
            continue;
        }
        seen = 0;
#if TETCASTI_AVX2
        if (v->scene->isa >= TETCAST_ISA_AVX2 && end - i >= 8) seen = tetcasti_rects8(v, i, rect, z);
        else
#endif
        for (k = 0; k < 8 && i + k < end; k++) {
            int32_t one[4], a;
            float depth[2];
            if (!tetcasti_cell_rect(v, mesh->tet[i + k], one, depth)) continue;
            seen |= 1u << k;
            for (a = 0; a < 4; a++) rect[a][k] = one[a];
            z[0][k] = depth[0];
            z[1][k] = depth[1];
        }
        taken += tetcasti_popcount64(seen);
        for (; seen != 0; seen &= seen - 1) {
            int32_t x_end, y_end;
            k = tetcasti_ctz64(seen);
            x_end = (rect[2][k] - 1) / (int32_t)TETCASTI_TILE;
            y_end = (rect[3][k] - 1) / (int32_t)TETCASTI_TILE;
            for (y = rect[1][k] / (int32_t)TETCASTI_TILE; y <= y_end; y++)
                for (x = rect[0][k] / (int32_t)TETCASTI_TILE; x <= x_end; x++) {
                    uint32_t *place = &v->start[((size_t)y * v->tiles_x + (size_t)x) * v->chunks + chunk];
                    if (fill) {
                        v->entry[*place].cell = i + k;
                        v->entry[*place].z = z[0][k];
                        v->entry[*place].nearest = z[1][k];
                    }
                    ++*place;
                }
        }
    }
    if (fill) tetcasti_tally_add(v->taken, taken);
}
static void tetcasti_task_bin_count(void *ctx, uint32_t i) { tetcasti_bin_chunk((tetcasti_view *)ctx, i, 0); }
static void tetcasti_task_bin_fill(void *ctx, uint32_t i) { tetcasti_bin_chunk((tetcasti_view *)ctx, i, 1); }

static void tetcasti_view_close(tetcasti_mem *mem, tetcasti_view *v) {
    tetcasti_free(mem, v->seen);
    tetcasti_free(mem, v->start);
    tetcasti_free(mem, v->entry);
    tetcasti_free(mem, v->cluster_hidden);
    v->seen = NULL;
    v->start = NULL;
    v->entry = NULL;
    v->cluster_hidden = NULL;
}

/* Clusters whose cells show nothing are not drawn; no memory for that: all are. */
static void tetcasti_view_hide(tetcasti_mem *mem, tetcasti_view *v) {
    const tetcast_mesh *mesh = v->scene->mesh;
    const tetcasti_clusters *c = mesh->clusters;
    uint32_t i;
    if (c == NULL || mesh->field_count == 0 || v->scene->optics == NULL) return;
    v->cluster_hidden = (uint32_t *)tetcasti_alloc_zero(mem, (size_t)c->count / 32 + 1, sizeof *v->cluster_hidden);
    if (v->cluster_hidden == NULL) return;
    for (i = 0; i < c->count; i++) {
        const float *range = mesh->field[mesh->active].range[i];
        if (tetcasti_optics_empty(v->scene->optics, range[0], range[1])) v->cluster_hidden[i >> 5] |= 1u << (i & 31u);
    }
}

/* Where the picture of a scene is. pixels: of the whole picture. */
static void tetcasti_view_set(const tetcasti_scene *scene, const tetcasti_pixels *pixels, tetcasti_view *v) {
    const tetcast_mesh *mesh = scene->mesh;
    uint32_t side = pixels->width > pixels->height ? pixels->width : pixels->height, i, k;
    double per_pixel, depth[2] = {0.0, 0.0}, spread;
    v->scene = scene;
    v->pixels = *pixels;
    for (v->log = 20; v->log > 0 && ((uint64_t)side << v->log) > ((uint64_t)1 << TETCASTI_PLACE_LOG); v->log--) { }
    v->place = 1.0f / (float)(1u << v->log);
    for (k = 0; k < 8; k++) { /* nearest and farthest corner of the mesh's box */
        double p[3], z = 0.0;
        for (i = 0; i < 3; i++) {
            p[i] = (double)(k >> i & 1u ? mesh->box.hi[i] : mesh->box.lo[i]) - pixels->eye[i];
            z += p[i] * pixels->forward[i];
        }
        if (k == 0 || z < depth[0]) depth[0] = z;
        if (k == 0 || z > depth[1]) depth[1] = z;
    }
    v->reference = pixels->parallel ? depth[0] : tetcasti_max(depth[0], 0.0);
    v->w_scale = tetcasti_max(depth[1], TETCASTI_NEAR);
    /* a vertex that is moved by d at depth z moves by up to d / z * sqrt(1 + tan^2) / (size of a pixel) in the picture;
       coordinates are used up to half a picture outside of it */
    spread = 0.5 * (double)side;
    v->x_end[0] = v->y_end[0] = -spread / (double)v->place;
    v->x_end[1] = (spread + (double)pixels->width) / (double)v->place;
    v->y_end[1] = (spread + (double)pixels->height) / (double)v->place;
    per_pixel = sqrt(pixels->right[0] * pixels->right[0] + pixels->right[1] * pixels->right[1] +
                     pixels->right[2] * pixels->right[2]);
    spread = pixels->parallel ? 0.0 : (double)side / per_pixel;
    v->blur = (float)(TETCASTI_BLUR * per_pixel * sqrt(1.0 + 2.0 * spread * spread) /
                      (pixels->parallel ? 1.0 : v->w_scale)) + v->place;
    v->tiles_x = (pixels->width + TETCASTI_TILE - 1) / TETCASTI_TILE;
    v->tiles_y = (pixels->height + TETCASTI_TILE - 1) / TETCASTI_TILE;
}

/* Pixels that a cell covers, on average over cells in the picture; v is set. Of at most TETCASTI_SAMPLES cells. */
static float tetcasti_view_measure(const tetcasti_view *v) {
    const tetcast_mesh *mesh = v->scene->mesh;
    uint32_t step = mesh->cell_count / TETCASTI_SAMPLES + 1, i, k, count = 0;
    double sum = 0.0, most = (double)v->pixels.width * (double)v->pixels.height;
    for (i = 0; i < mesh->cell_count; i += step) {
        double x[4], y[4], area = 0.0;
        for (k = 0; k < 4; k++) {
            tetcasti_seen q = tetcasti_see(v, &v->scene->vertex[mesh->tet[i][k]]);
            if (!(q.w > 0.0f)) break;
            x[k] = (double)q.x * (double)v->place;
            y[k] = (double)q.y * (double)v->place;
        }
        if (k < 4) continue;
        for (k = 0; k < 4; k++) { /* each pixel inside is covered by two faces */
            const uint8_t *f = tetcasti_face_of[k];
            area += 0.25 * tetcasti_abs((x[f[1]] - x[f[0]]) * (y[f[2]] - y[f[0]]) -
                                        (y[f[1]] - y[f[0]]) * (x[f[2]] - x[f[0]]));
        }
        sum += tetcasti_min(area, most);
        count++;
    }
    return count != 0 ? (float)(sum / (double)count) : 0.0f;
}

/* What lies where in the picture: all vertices, and bins of cells; v is set. 0: no memory. */
static int tetcasti_view_open(tetcasti_mem *mem, const tetcast_env *env, int hide, tetcasti_view *v) {
    const tetcast_mesh *mesh = v->scene->mesh;
    uint32_t tiles = v->tiles_x * v->tiles_y;
    size_t n, sum = 0, i;
    v->chunks = (1u << 24) / tiles < 256u ? (1u << 24) / tiles : 256u;
    if (v->chunks == 0) v->chunks = 1;
    v->chunk = mesh->cell_count / v->chunks + 1;
    if (v->chunk < TETCASTI_CHUNK) v->chunk = TETCASTI_CHUNK;
    v->chunk = (v->chunk + (1u << TETCASTI_CLUSTER_LOG) - 1u) >> TETCASTI_CLUSTER_LOG << TETCASTI_CLUSTER_LOG;
    v->chunks = (mesh->cell_count + v->chunk - 1) / v->chunk;
    n = (size_t)tiles * v->chunks;
    if (hide) tetcasti_view_hide(mem, v);
    v->seen = (tetcasti_seen *)tetcasti_alloc_array(mem, mesh->vertex_count, sizeof *v->seen);
    v->start = (uint32_t *)tetcasti_alloc_zero(mem, n + 1, sizeof *v->start);
    if (v->seen == NULL || v->start == NULL) return 0;
    tetcasti_parallel_for(env, tetcasti_task_see, v, (mesh->vertex_count + TETCASTI_CHUNK - 1) / TETCASTI_CHUNK);
    tetcasti_parallel_for(env, tetcasti_task_bin_count, v, v->chunks);
    for (i = 0; i < n; i++) {
        uint32_t count = v->start[i];
        v->start[i] = (uint32_t)sum;
        sum += count;
        if (sum > 0xffffffffu) return 0;
    }
    v->entry = (tetcasti_entry *)tetcasti_alloc_array(mem, sum + 1, sizeof *v->entry);
    if (v->entry == NULL) return 0;
    tetcasti_parallel_for(env, tetcasti_task_bin_fill, v, v->chunks);
    for (i = n; i > 0; i--) v->start[i] = v->start[i - 1]; /* filling moved each start to the next one */
    v->start[0] = 0;
    return 1;
}

/* ---- one cell ---- */

/* By which faces are in front (bit i: the one opposite to vertex i): the vertices' roles, so that what is positive
   inside is so, and the form. */
static const uint8_t tetcasti_roles[16][4] = {
    {0, 1, 2, 3}, {1, 3, 2, 0}, {0, 2, 3, 1}, {3, 2, 0, 1}, {0, 3, 1, 2}, {1, 3, 0, 2}, {3, 0, 1, 2}, {0, 2, 1, 3},
    {0, 1, 2, 3}, {2, 1, 0, 3}, {0, 2, 1, 3}, {0, 1, 3, 2}, {1, 0, 2, 3}, {0, 3, 2, 1}, {1, 2, 3, 0}, {0, 1, 2, 3}};
static const uint8_t tetcasti_forms[16] = {0, 0, 0, 2, 0, 2, 2, 1, 0, 2, 2, 1, 2, 1, 1, 0};
/* Ends of the edges of a splat, by role: with a single face, with two. */
static const uint8_t tetcasti_splat_edges[2][2][8] = {{{0, 1, 2, 0, 1, 2, 0, 0}, {1, 2, 0, 3, 3, 3, 0, 0}},
                                                  {{0, 2, 1, 3, 0, 2, 0, 0}, {2, 1, 3, 0, 1, 3, 0, 0}}};

/* Set up a cell; 0: only the exact signs can tell. */
static int tetcasti_splat_open(const tetcasti_view *v, const uint32_t tet[4], tetcasti_splat *s) {
    const tetcasti_vertex *vertex = v->scene->vertex;
    const tetcasti_seen *p[4];
    float x[4], y[4], area[4], wide, w = 0.0f;
    int32_t lo[2] = {0, 0}, hi[2] = {0, 0}, half = (int32_t)(1u << v->log) / 2;
    const uint8_t *role;
    uint32_t i, fronts = 0;
    for (i = 0; i < 4; i++) {
        p[i] = &v->seen[tet[i]];
        if (!(p[i]->w > 0.0f)) return 0;
        w = p[i]->w > w ? p[i]->w : w;
        if (i == 0 || p[i]->x < lo[0]) lo[0] = p[i]->x;
        if (i == 0 || p[i]->x > hi[0]) hi[0] = p[i]->x;
        if (i == 0 || p[i]->y < lo[1]) lo[1] = p[i]->y;
        if (i == 0 || p[i]->y > hi[1]) hi[1] = p[i]->y;
    }
    s->x0 = tetcasti_place_pixel(lo[0], v->log);
    s->y0 = tetcasti_place_pixel(lo[1], v->log);
    for (i = 0; i < 4; i++) {
        x[i] = (float)(p[i]->x - s->x0 * 2 * half - half) * v->place;
        y[i] = (float)(p[i]->y - s->y0 * 2 * half - half) * v->place;
    }
    /* Inside or outside of a face cannot be different while the pixel is farther from its edges than vertices may have
       moved: an edge function is that distance times the length of the edge. */
    wide = (float)(hi[0] - lo[0]) * v->place + (float)(hi[1] - lo[1]) * v->place + 2.0f;
    s->bound = v->blur * w * wide + 9.5367432e-7f * (wide * wide);
    for (i = 0; i < 4; i++) { /* twice the area, positive where rows go down and the face is seen from its back */
        const uint8_t *f = tetcasti_face_of[i];
        area[i] = (x[f[1]] - x[f[0]]) * (y[f[2]] - y[f[0]]) - (y[f[1]] - y[f[0]]) * (x[f[2]] - x[f[0]]);
        if (!(tetcasti_absf(area[i]) > 3.0f * s->bound)) return 0;
        fronts |= (uint32_t)(area[i] < 0.0f) << i;
    }
    if (fronts == 0 || fronts == 15) return 0;
    role = tetcasti_roles[fronts];
    s->form = tetcasti_forms[fronts];
    for (i = 0; i < 6; i++) {
        uint32_t from = role[tetcasti_splat_edges[s->form >> 1][0][i]];
        uint32_t to = role[tetcasti_splat_edges[s->form >> 1][1][i]];
        s->a[i] = y[from] - y[to];
        s->b[i] = x[to] - x[from];
        s->c[i] = -(s->a[i] * x[from] + s->b[i] * y[from]);
    }
    for (i = 6; i < 8; i++) s->a[i] = s->b[i] = s->c[i] = 0.0f;
    s->s_lo = s->s_hi = 0.0f;
    for (i = 0; i < 4; i++) {
        const tetcasti_seen *q = p[role[i]];
        float value = vertex[tet[role[i]]].s;
        s->w[i] = q->w;
        s->wz[i] = q->w * q->z;
        s->ws[i] = q->w * value;
        s->s_lo = i == 0 || value < s->s_lo ? value : s->s_lo;
        s->s_hi = i == 0 || value > s->s_hi ? value : s->s_hi;
    }
    return 1;
}

/* Depth and value at the place with these weights. */
TETCASTI_INLINE void tetcasti_splat_mean(const tetcasti_splat *s, uint32_t n, const uint32_t role[4], const float q[4],
                                         float *z, float *value) {
    float d = q[0] * s->w[role[0]], e = q[0] * s->wz[role[0]], f = q[0] * s->ws[role[0]];
    uint32_t i;
    for (i = 1; i < n; i++) {
        d = fmaf(q[i], s->w[role[i]], d);
        e = fmaf(q[i], s->wz[role[i]], e);
        f = fmaf(q[i], s->ws[role[i]], f);
    }
    d = 1.0f / d;
    *z = e * d;
    f = f * d;
    f = f > s->s_lo ? f : s->s_lo;
    *value = f < s->s_hi ? f : s->s_hi;
}

/* Pixel x of a row, whose edge functions begin with row[]: 0: outside, 1: inside, 2: too near to an edge. */
TETCASTI_INLINE uint32_t tetcasti_splat_pixel(const tetcasti_splat *s, const float row[8], float x,
                                              tetcasti_fragment *out) {
    static const uint32_t single[4] = {0, 1, 2, 0}, all[4] = {0, 1, 2, 3};
    float e[6], q[4], z[2], value[2], least = TETCASTI_INF, inside = TETCASTI_INF;
    uint32_t k, silhouette = s->form == 2 ? 4 : 3, role[4];
    for (k = 0; k < 6; k++) e[k] = fmaf(s->a[k], x, row[k]);
    for (k = 0; k < 6; k++) least = tetcasti_absf(e[k]) < least ? tetcasti_absf(e[k]) : least;
    for (k = 0; k < silhouette; k++) inside = e[k] < inside ? e[k] : inside;
    if (inside < -s->bound) return 0;
    if (!(least > s->bound)) return 2;
    if (!(inside > 0.0f)) return 0;
    if (s->form == 2) {
        int r_side = e[4] < 0.0f, p_side = e[5] > 0.0f;
        q[0] = r_side ? e[1] : e[2];
        q[1] = r_side ? e[0] : e[3];
        q[2] = tetcasti_absf(e[4]);
        role[0] = 0;
        role[1] = 1;
        role[2] = r_side ? 2 : 3;
        tetcasti_splat_mean(s, 3, role, q, &z[0], &value[0]);
        q[0] = p_side ? e[3] : e[2];
        q[1] = p_side ? e[0] : e[1];
        q[2] = tetcasti_absf(e[5]);
        role[0] = 2;
        role[1] = 3;
        role[2] = p_side ? 0 : 1;
        tetcasti_splat_mean(s, 3, role, q, &z[1], &value[1]);
    } else { /* of the faces with d: the one that does not have c, b or a */
        int no_c = e[3] < 0.0f && e[4] > 0.0f, no_b = e[3] > 0.0f && e[5] < 0.0f;
        uint32_t one = s->form;
        q[0] = e[1];
        q[1] = e[2];
        q[2] = e[0];
        tetcasti_splat_mean(s, 3, single, q, &z[one], &value[one]);
        q[0] = no_c ? tetcasti_absf(e[4]) : no_b ? tetcasti_absf(e[5]) : 0.0f;
        q[1] = no_b ? 0.0f : no_c ? tetcasti_absf(e[3]) : tetcasti_absf(e[5]);
        q[2] = no_c ? 0.0f : no_b ? tetcasti_absf(e[3]) : tetcasti_absf(e[4]);
        q[3] = no_c ? e[0] : no_b ? e[2] : e[1];
        tetcasti_splat_mean(s, 4, all, q, &z[!one], &value[!one]);
    }
    out->z0 = z[0];
    out->z1 = z[1];
    out->s0 = value[0];
    out->s1 = value[1];
    return 1;
}

/* A cell on one ray, by the walker's signs and means. */
typedef struct tetcasti_cell_hit {
    uint32_t face[2];       /* of the way in and out: the vertex opposite to it */
    uint32_t v[2][3];       /* their vertices, by place in the cell */
    float weight[2][3];
    float at[2], s[2];      /* local distance from the ray's origin, values */
} tetcasti_cell_hit;

TETCASTI_INLINE int tetcasti_cell_meet(const tetcasti_ray *r, const tetcasti_vertex *vertex, const uint32_t tet[4],
                                       tetcasti_cell_hit *out) {
    tetcasti_point p[4];
    float det[4][4];
    uint8_t left[4][4];
    uint32_t i, j, found = 0;
    for (i = 0; i < 4; i++) p[i] = tetcasti_project(r, &vertex[tet[i]]);
    for (i = 0; i < 4; i++)
        for (j = i + 1; j < 4; j++) {
            det[i][j] = tetcasti_det(&p[i], &p[j]);
            det[j][i] = -det[i][j];
            left[i][j] = (uint8_t)tetcasti_positive(det[i][j], &p[i], &p[j], tet[i], tet[j]);
            left[j][i] = (uint8_t)!left[i][j];
        }
    for (i = 0; i < 4; i++) {
        const uint8_t *f = tetcasti_face_of[i];
        uint32_t side = left[f[0]][f[1]], way = side ? 0 : 1;
        float inv, *w = out->weight[way];
        if (left[f[1]][f[2]] != side || left[f[2]][f[0]] != side) continue;
        w[0] = det[f[1]][f[2]];
        w[1] = det[f[2]][f[0]];
        w[2] = det[f[0]][f[1]];
        inv = 1.0f / ((w[2] + w[0]) + w[1]);
        out->face[way] = i;
        for (j = 0; j < 3; j++) out->v[way][j] = f[j];
        out->at[way] = fmaf(w[0], p[f[0]].z, fmaf(w[1], p[f[1]].z, w[2] * p[f[2]].z)) * inv;
        out->s[way] = tetcasti_face_value(&p[f[0]], &p[f[1]], &p[f[2]], w[2], w[0], w[1], inv);
        found |= 1u << way;
    }
    return found == 3;
}
/* ---------------------------------------------------------------------------
   order: fragments of a tile -> rays, in their order.                           // >>order

   The cells of a tile are drawn roughly in order of depth. Each pixel keeps what it has of them in a list by depth. Of
   everything that is still to come nothing lies before the nearest vertex of all cells to come, so when lists get full
   all that lies before it is in its final order and goes into the rays' sums, which makes room. That is exact
   for every mesh: no order of whole cells is needed, which does not exist where cells overlap in a cycle or around a
   hole, and lists stay short. A pixel whose ray has ended takes no more fragments, a tile without open pixels stops.

   Neighbours compute the depth of their common face in different orders of operations; fragments that touch but for
   that are joined, in depth and in value, so that a ray sees the same as on a walk.
   --------------------------------------------------------------------------- */

#define TETCASTI_LIST_ROOM 16u
#define TETCASTI_DEPTHS 2048u   /* steps of depth by which the cells of a tile are ordered */
#define TETCASTI_KEEP_ALL 0u    /* what happens to a fragment when it comes: it goes into a list by depth, */
#define TETCASTI_KEEP_NONE 1u   /* straight into the sum: the order is that of the cells (for comparisons), */
#define TETCASTI_KEEP_SOME 2u   /* into a list of keep_room, and the nearest one of a full list into the sum */

typedef struct tetcasti_painter { /* zeroed */
    const tetcasti_view *view;
    const tetcasti_scene *scene;
    tetcasti_mem *mem;
    tetcasti_batch *b;              /* rays of the tile, and their sums at the end */
    tetcasti_entry *entry;          /* cells of the tile, in order */
    size_t entry_room;
    tetcasti_fragment *list;        /* [pixel * room] */
    uint32_t room, fullest;         /* fullest: no list is longer */
    uint32_t mode, keep_room;
    uint32_t failed, open;          /* open: pixels whose rays go on */
    uint32_t live[TETCASTI_TILE];   /* one bit a pixel of a row */
    uint32_t x0, y0, width, height;
    float join_z, join_s;           /* differences that are rounding */
    float ahead[TETCASTI_DEPTHS + 1]; /* nearest depth of all cells from a step on */
    uint32_t groups;                /* of rays: one bit each */
    tetcasti_beam beam[6];
    /* tetcasti_paint_cell and tetcasti_lists_run, or what has the same bits */
    void (*paint)(struct tetcasti_painter *p, uint32_t cell);
    void (*run)(struct tetcasti_painter *p, float until);
    uint64_t tests, exact;          /* pixels that were looked at, and those by exact signs */
    uint64_t wrong;                 /* fragments that came too late (KEEP_NONE, KEEP_SOME) */
    uint16_t count[TETCASTI_BATCH]; /* of fragments in a list */
    float cursor[TETCASTI_BATCH];   /* as tetcasti_seen.z: up to here everything is in the sum */
    float value[TETCASTI_BATCH];    /* there */
    float last[TETCASTI_BATCH];     /* where the ray ends */
    float way[TETCASTI_BATCH];      /* distance on the ray per depth */
    tetcasti_ray_sum8 sum[TETCASTI_BATCH / 8];
} tetcasti_painter;

/* ---- fragments into sums ---- */

/* Where a fragment begins and ends on the ray of pixel i; 0: it is seen already. */
TETCASTI_INLINE int tetcasti_fragment_cut(tetcasti_painter *p, uint32_t i, const tetcasti_fragment *f, int *gap,
                                          float cut[4]) {
    float cursor = p->cursor[i], last = p->last[i], begin = cursor, front = f->s0, back = f->s1, end = f->z1;
    float apart = f->z0 - cursor;
    *gap = 0;
    if (!(end >= cursor)) return 0;
    if (tetcasti_absf(apart) <= p->join_z) { /* its face is that of the one before */
        if (tetcasti_absf(front - p->value[i]) <= p->join_s) front = p->value[i];
    } else if (apart > 0.0f) {
        if (!(end >= f->z0)) return 0; /* an inverted cell */
        *gap = 1;
        begin = f->z0;
    } else {
        front += (back - front) * ((cursor - f->z0) / (end - f->z0));
    }
    if (end > last) {
        back = f->s0 + (back - f->s0) * ((last - f->z0) / (end - f->z0));
        end = last;
    }
    cut[0] = begin;
    cut[1] = end;
    cut[2] = front;
    cut[3] = back;
    return 1;
}

/* The surface normals of a fragment need the faces that the ray passes. */
static void tetcasti_fragment_surface(tetcasti_painter *p, uint32_t i, const tetcasti_fragment *f, const float cut[4],
                                      float way, float depth, float *first) {
    const tetcasti_scene *scene = p->scene;
    const uint32_t *tet = scene->mesh->tet[f->cell];
    tetcasti_ray r = tetcasti_batch_ray(p->b, i);
    tetcasti_cell_hit hit;
    tetcasti_crossing_info x;
    float view[3], span = f->z1 - f->z0, inv;
    uint32_t k;
    x.scene = scene;
    memset(&hit, 0, sizeof hit);
    if (!tetcasti_cell_meet(&r, scene->vertex, tet, &hit)) { /* as it was met once, it is again */
        hit.v[0][1] = hit.v[1][1] = 1;
        hit.v[0][2] = hit.v[1][2] = 2;
        hit.weight[0][0] = hit.weight[1][0] = 1.0f;
        hit.face[1] = 3;
    }
    for (k = 0; k < 3; k++) {
        x.in[k] = tet[hit.v[0][k]];
        x.out[k] = tet[hit.v[1][k]];
    }
    x.dropped = tet[hit.face[1]];
    inv = 1.0f / ((hit.weight[0][2] + hit.weight[0][0]) + hit.weight[0][1]);
    for (k = 0; k < 3; k++) x.in_weight[k] = hit.weight[0][k] * inv;
    inv = 1.0f / ((hit.weight[1][2] + hit.weight[1][0]) + hit.weight[1][1]);
    for (k = 0; k < 3; k++) x.out_weight[k] = hit.weight[1][k] * inv;
    x.begin = span > 0.0f ? (cut[0] - f->z0) / span : 0.0f;
    x.end = span > 0.0f ? (cut[1] - f->z0) / span : 1.0f;
    x.first = TETCASTI_INF;
    tetcasti_ray_direction(&r, view);
    tetcasti_segment_iso(scene->optics, cut[2], cut[3], way, depth, tetcasti_normal, &x, view, &p->b->sum[i]);
    *first = x.first;
}

static void tetcasti_pixel_end(tetcasti_painter *p, uint32_t i) {
    uint32_t bit = 1u << (i % TETCASTI_TILE), *row = &p->live[i / TETCASTI_TILE];
    p->open -= (*row & bit) != 0;
    *row &= ~bit;
}

/* One fragment into the sum of pixel i. */
static void tetcasti_fragment_add(tetcasti_painter *p, uint32_t i, const tetcasti_fragment *f) {
    const tetcasti_scene *scene = p->scene;
    const tetcast_optics *o = scene->optics;
    tetcasti_batch *b = p->b;
    tetcasti_ray_sum *sum = &b->sum[i];
    float cut[4], way, depth;
    int gap;
    if (!(f->z1 >= -(float)p->view->reference)) return; /* behind the eye */
    if (f->z0 > p->last[i]) {
        tetcasti_pixel_end(p, i);
        return;
    }
    b->steps[i]++;
    if (p->mode != TETCASTI_KEEP_ALL && f->z1 > f->z0 && f->z0 < p->cursor[i] - p->join_z) {
        p->wrong++; /* drawn all the same */
        gap = 0;
        cut[0] = f->z0;
        cut[1] = f->z1;
        cut[2] = f->s0;
        cut[3] = f->s1;
    } else if (!tetcasti_fragment_cut(p, i, f, &gap, cut)) {
        return;
    }
    if (gap || p->value[i] != p->value[i]) {
        b->walks[i]++;
        if (o != NULL) tetcasti_ray_gap(o, sum);
    }
    way = (cut[1] - cut[0]) * p->way[i];
    depth = ((float)p->view->reference + cut[0]) * p->way[i] * scene->unit;
    b->length[i] += way;
    way *= scene->unit;
    if (!(cut[1] < p->cursor[i])) {
        p->cursor[i] = cut[1];
        p->value[i] = cut[3];
    }
    if (o != NULL && !scene->any) {
        o->segment(o, cut[2], cut[3], way, depth, sum);
    } else if (o != NULL && scene->mesh->hidden != NULL && tetcasti_bit(scene->mesh->hidden, f->cell)) {
        tetcasti_ray_gap(o, sum);
    } else if (o != NULL) {
        if (scene->mesh->cell_value != NULL) cut[2] = cut[3] = scene->mesh->cell_value[f->cell];
        if (o->iso_count != 0) {
            float first;
            tetcasti_fragment_surface(p, i, f, cut, way, depth, &first);
            if (o->model == TETCAST_MODEL_ISOSURFACE && first < 1.0f) depth += first * way;
        } else {
            o->segment(o, cut[2], cut[3], way, depth, sum);
        }
        if (b->depth[i] == TETCASTI_INF && (sum->t != scene->begin_t || sum->c[0] != 0.0f || sum->c[1] != 0.0f ||
                                            sum->c[2] != 0.0f))
            b->depth[i] = depth;
    }
    if (o != NULL && tetcasti_ray_ended(o, sum)) {
        b->ended[i] = 1;
        tetcasti_pixel_end(p, i);
    } else if (!(p->cursor[i] < p->last[i])) {
        tetcasti_pixel_end(p, i);
    }
}

TETCASTI_INLINE int tetcasti_pixel_live(const tetcasti_painter *p, uint32_t i) {
    return (int)(p->live[i / TETCASTI_TILE] >> (i % TETCASTI_TILE) & 1u);
}

/* All that lies before `until` goes into the sums. */
static void tetcasti_lists_run(tetcasti_painter *p, float until) {
    uint32_t i, end = TETCASTI_TILE * p->height;
    p->fullest = 0;
    for (i = 0; i < end; i++) {
        tetcasti_fragment *f = p->list + (size_t)i * p->room;
        uint32_t n = p->count[i], k = 0;
        if (n == 0) continue;
        while (k < n && f[k].z0 < until && tetcasti_pixel_live(p, i)) tetcasti_fragment_add(p, i, &f[k++]);
        n = tetcasti_pixel_live(p, i) ? n - k : 0;
        if (n != 0 && k != 0) memmove(f, f + k, n * sizeof *f);
        p->count[i] = (uint16_t)n;
        if (n > p->fullest) p->fullest = n;
    }
}

/* ---- fragments into lists ---- */

static int tetcasti_lists_grow(tetcasti_painter *p) {
    size_t room = (size_t)p->room * 2, i;
    tetcasti_fragment *list = (tetcasti_fragment *)tetcasti_alloc_zero(p->mem, room * TETCASTI_BATCH, sizeof *list);
    if (list == NULL || room > 0x8000u) {
        tetcasti_free(p->mem, list);
        p->failed = 1;
        return 0;
    }
    for (i = 0; i < TETCASTI_BATCH; i++)
        memcpy(list + i * room, p->list + i * p->room, p->count[i] * sizeof *list);
    tetcasti_free(p->mem, p->list);
    p->list = list;
    p->room = (uint32_t)room;
    return 1;
}

/* Pixel i is live and its list has room. */
TETCASTI_INLINE void tetcasti_list_put(tetcasti_painter *p, uint32_t i, float z0, float z1, float s0, float s1,
                                       uint32_t cell) {
    tetcasti_fragment *f = p->list + (size_t)i * p->room;
    uint32_t n = p->count[i];
    p->count[i] = (uint16_t)(n + 1);
    p->fullest = n + 1 > p->fullest ? n + 1 : p->fullest;
    for (; n > 0 && (f[n - 1].z0 > z0 || (f[n - 1].z0 == z0 && f[n - 1].z1 > z1)); n--) f[n] = f[n - 1];
    f[n].z0 = z0;
    f[n].z1 = z1;
    f[n].s0 = s0;
    f[n].s1 = s1;
    f[n].cell = cell;
}

/* The same for orders that are compared with: the nearest fragment goes when there are enough. */
static void tetcasti_list_put_some(tetcasti_painter *p, uint32_t i, const tetcasti_fragment *f) {
    tetcasti_fragment *list = p->list + (size_t)i * p->room;
    if (p->mode == TETCASTI_KEEP_SOME) {
        tetcasti_list_put(p, i, f->z0, f->z1, f->s0, f->s1, f->cell);
        if (p->count[i] < p->keep_room) return;
        f = list;
    }
    tetcasti_fragment_add(p, i, f);
    if (p->mode == TETCASTI_KEEP_SOME) {
        p->count[i]--;
        memmove(list, list + 1, p->count[i] * sizeof *list);
    }
}

TETCASTI_INLINE void tetcasti_paint_put(tetcasti_painter *p, uint32_t i, const tetcasti_fragment *f) {
    if (p->mode == TETCASTI_KEEP_ALL) tetcasti_list_put(p, i, f->z0, f->z1, f->s0, f->s1, f->cell);
    else tetcasti_list_put_some(p, i, f);
}

/* Pixel i by exact signs. */
TETCASTI_INLINE void tetcasti_paint_exact(tetcasti_painter *p, uint32_t i, const uint32_t tet[4], uint32_t cell) {
    const tetcasti_view *v = p->view;
    tetcasti_ray r = tetcasti_batch_ray(p->b, i);
    tetcasti_cell_hit hit;
    tetcasti_fragment f;
    const uint8_t *axes;
    double o[3], d[3], z = -v->reference, per = 0.0;
    uint32_t k;
    if (r.group == TETCASTI_NO_RAY) return;
    p->exact++;
    if (!tetcasti_cell_meet(&r, v->scene->vertex, tet, &hit)) return;
    axes = tetcasti_axes[r.group];
    o[0] = (double)r.ox;
    o[1] = (double)r.oy;
    o[2] = (double)r.oz;
    d[0] = (double)r.sx;
    d[1] = (double)r.sy;
    d[2] = 1.0;
    for (k = 0; k < 3; k++) {
        z += (o[k] - v->pixels.eye[axes[k]]) * v->pixels.forward[axes[k]];
        per += d[k] * v->pixels.forward[axes[k]];
    }
    per /= (double)r.iz; /* depth per distance */
    f.z0 = (float)(z + (double)hit.at[0] * per);
    f.z1 = (float)(z + (double)hit.at[1] * per);
    f.s0 = hit.s[0];
    f.s1 = hit.s[1];
    f.cell = cell;
    tetcasti_paint_put(p, i, &f);
}

/* Can one of the rays meet a cell that reaches to the plane of the eye? */
static int tetcasti_painter_meets(const tetcasti_painter *p, const uint32_t tet[4]) {
    const tetcasti_vertex *q = &p->scene->vertex[tet[0]];
    float lo[3], hi[3], c[3];
    uint32_t i, k;
    lo[0] = hi[0] = q->x;
    lo[1] = hi[1] = q->y;
    lo[2] = hi[2] = q->z;
    for (i = 1; i < 4; i++) {
        q = &p->scene->vertex[tet[i]];
        c[0] = q->x;
        c[1] = q->y;
        c[2] = q->z;
        for (k = 0; k < 3; k++) {
            lo[k] = c[k] < lo[k] ? c[k] : lo[k];
            hi[k] = c[k] > hi[k] ? c[k] : hi[k];
        }
    }
    for (i = 0; i < 6; i++)
        if ((p->groups >> i & 1u) && tetcasti_beam_meets(&p->beam[i], lo, hi)) return 1;
    return 0;
}

TETCASTI_INLINE void tetcasti_tile_clip(const tetcasti_painter *p, int32_t rect[4]) {
    rect[0] = rect[0] > (int32_t)p->x0 ? rect[0] - (int32_t)p->x0 : 0;
    rect[1] = rect[1] > (int32_t)p->y0 ? rect[1] - (int32_t)p->y0 : 0;
    rect[2] = rect[2] < (int32_t)(p->x0 + p->width) ? rect[2] - (int32_t)p->x0 : (int32_t)p->width;
    rect[3] = rect[3] < (int32_t)(p->y0 + p->height) ? rect[3] - (int32_t)p->y0 : (int32_t)p->height;
}

/* Pixels of the tile that a cell can cover; 0: none. */
static int tetcasti_tile_rect(const tetcasti_painter *p, const uint32_t tet[4], int32_t rect[4]) {
    const tetcasti_view *v = p->view;
    float z[2];
    if (!tetcasti_cell_rect(v, tet, rect, z)) return 0;
    tetcasti_tile_clip(p, rect);
    return (v->seen[tet[0]].w != -TETCASTI_INF && v->seen[tet[1]].w != -TETCASTI_INF &&
            v->seen[tet[2]].w != -TETCASTI_INF && v->seen[tet[3]].w != -TETCASTI_INF) || tetcasti_painter_meets(p, tet);
}

/* All pixels of rect, in the tile, of a cell that has no other form. */
TETCASTI_INLINE void tetcasti_paint_rect(tetcasti_painter *p, uint32_t cell, const int32_t rect[4]) {
    int32_t x, y;
    for (y = rect[1]; y < rect[3]; y++)
        for (x = rect[0]; x < rect[2]; x++) {
            if ((p->live[y] >> x & 1u) == 0) continue;
            p->tests++;
            tetcasti_paint_exact(p, (uint32_t)y * TETCASTI_TILE + (uint32_t)x, p->scene->mesh->tet[cell], cell);
        }
}

TETCASTI_INLINE void tetcasti_paint_cell(tetcasti_painter *p, uint32_t cell) {
    const uint32_t *tet = p->scene->mesh->tet[cell];
    tetcasti_splat s;
    int32_t x, y, rect[4];
    uint32_t k;
    if (!tetcasti_tile_rect(p, tet, rect)) return;
    if (!tetcasti_splat_open(p->view, tet, &s)) {
        tetcasti_paint_rect(p, cell, rect);
        return;
    }
    for (y = rect[1]; y < rect[3]; y++) {
        float row[8];
        for (k = 0; k < 6; k++) row[k] = fmaf(s.b[k], (float)((int32_t)p->y0 + y - s.y0), s.c[k]);
        for (x = rect[0]; x < rect[2]; x++) {
            uint32_t i = (uint32_t)y * TETCASTI_TILE + (uint32_t)x, found;
            tetcasti_fragment f;
            if ((p->live[y] >> x & 1u) == 0) continue;
            p->tests++;
            f.cell = cell;
            found = tetcasti_splat_pixel(&s, row, (float)((int32_t)p->x0 + x - s.x0), &f);
            if (found == 1) tetcasti_paint_put(p, i, &f);
            else if (found == 2) tetcasti_paint_exact(p, i, tet, cell);
        }
    }
}

TETCASTI_TARGET_FMA static void tetcasti_paint_fma(tetcasti_painter *p, uint32_t cell) {
    tetcasti_paint_cell(p, cell);
}
static void tetcasti_paint_plain(tetcasti_painter *p, uint32_t cell) { tetcasti_paint_cell(p, cell); }

#if TETCASTI_AVX2

/* ---- eight pixels of a cell ---- */

#define TETCASTI_ALL(x) _mm256_broadcast_ss(&(x))

/* Lanes whose pixels (x, y) are inside, and those for exact signs. Edge functions in e. */
TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_splat_lanes(const tetcasti_splat *s, const uint32_t silhouette,
                                                                   uint32_t lanes, __m256 x, __m256 y, __m256 e[6],
                                                                   uint32_t *exact) {
    const __m256 sign = _mm256_set1_ps(-0.0f), bound = TETCASTI_ALL(s->bound);
    __m256 least, inside;
    uint32_t k;
    for (k = 0; k < silhouette; k++)
        e[k] = _mm256_fmadd_ps(TETCASTI_ALL(s->a[k]), x,
                               _mm256_fmadd_ps(TETCASTI_ALL(s->b[k]), y, TETCASTI_ALL(s->c[k])));
    inside = _mm256_min_ps(_mm256_min_ps(e[0], e[1]), e[2]);
    if (silhouette == 4) inside = _mm256_min_ps(inside, e[3]);
    lanes &= ~(uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(inside, _mm256_xor_ps(bound, sign), _CMP_LT_OQ));
    *exact = 0;
    if (lanes == 0) return 0;
    for (k = silhouette; k < 6; k++)
        e[k] = _mm256_fmadd_ps(TETCASTI_ALL(s->a[k]), x,
                               _mm256_fmadd_ps(TETCASTI_ALL(s->b[k]), y, TETCASTI_ALL(s->c[k])));
    least = _mm256_andnot_ps(sign, inside);
    for (k = silhouette; k < 6; k++) least = _mm256_min_ps(least, _mm256_andnot_ps(sign, e[k]));
    *exact = lanes & ~(uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(least, bound, _CMP_GT_OQ));
    return lanes & ~*exact;
}

typedef struct tetcasti_sums8 { __m256 d, e, f; } tetcasti_sums8;

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_sums_add(tetcasti_sums8 *t, __m256 q, __m256 w, __m256 wz,
                                                            __m256 ws) {
    t->d = _mm256_fmadd_ps(q, w, t->d);
    t->e = _mm256_fmadd_ps(q, wz, t->e);
    t->f = _mm256_fmadd_ps(q, ws, t->f);
}

#define TETCASTI_SUMS_FIRST(t, q, i) \
    t.d = _mm256_mul_ps(q, TETCASTI_ALL(s->w[i])); t.e = _mm256_mul_ps(q, TETCASTI_ALL(s->wz[i])); \
    t.f = _mm256_mul_ps(q, TETCASTI_ALL(s->ws[i]))
#define TETCASTI_SUMS_ADD(t, q, i) \
    tetcasti_sums_add(&t, q, TETCASTI_ALL(s->w[i]), TETCASTI_ALL(s->wz[i]), TETCASTI_ALL(s->ws[i]))
#define TETCASTI_SUMS_EITHER(t, q, i, j, m) tetcasti_sums_add(&t, q, \
        _mm256_blendv_ps(TETCASTI_ALL(s->w[i]), TETCASTI_ALL(s->w[j]), m), \
        _mm256_blendv_ps(TETCASTI_ALL(s->wz[i]), TETCASTI_ALL(s->wz[j]), m), \
        _mm256_blendv_ps(TETCASTI_ALL(s->ws[i]), TETCASTI_ALL(s->ws[j]), m))

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_sums_end(const tetcasti_splat *s, const tetcasti_sums8 *t,
                                                            __m256 *z, __m256 *value) {
    __m256 inv = _mm256_div_ps(_mm256_set1_ps(1.0f), t->d);
    *z = _mm256_mul_ps(t->e, inv);
    *value = _mm256_min_ps(_mm256_max_ps(_mm256_mul_ps(t->f, inv), TETCASTI_ALL(s->s_lo)), TETCASTI_ALL(s->s_hi));
}

/* What the lanes see. out: z0, z1, s0, s1. The operations of tetcasti_splat_pixel. */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_splat_quad8(const tetcasti_splat *s, const __m256 e[6],
                                                               __m256 out[4]) {
    const __m256 sign = _mm256_set1_ps(-0.0f);
    tetcasti_sums8 t;
    __m256 q0, q1;
    q0 = _mm256_blendv_ps(e[2], e[1], e[4]);
    q1 = _mm256_blendv_ps(e[3], e[0], e[4]);
    TETCASTI_SUMS_FIRST(t, q0, 0);
    TETCASTI_SUMS_ADD(t, q1, 1);
    TETCASTI_SUMS_EITHER(t, _mm256_andnot_ps(sign, e[4]), 3, 2, e[4]);
    tetcasti_sums_end(s, &t, &out[0], &out[2]);
    q0 = _mm256_blendv_ps(e[3], e[2], e[5]);
    q1 = _mm256_blendv_ps(e[0], e[1], e[5]);
    TETCASTI_SUMS_FIRST(t, q0, 2);
    TETCASTI_SUMS_ADD(t, q1, 3);
    TETCASTI_SUMS_EITHER(t, _mm256_andnot_ps(sign, e[5]), 0, 1, e[5]);
    tetcasti_sums_end(s, &t, &out[1], &out[3]);
}

TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_splat_single8(const tetcasti_splat *s, const __m256 e[6],
                                                                 __m256 out[4]) {
    const __m256 sign = _mm256_set1_ps(-0.0f);
    tetcasti_sums8 t;
    __m256 z[2], value[2];
    __m256 no_c = _mm256_andnot_ps(e[4], e[3]), no_b = _mm256_andnot_ps(e[3], e[5]), no_a;
    __m256 a = _mm256_andnot_ps(sign, e[3]), b = _mm256_andnot_ps(sign, e[4]), c = _mm256_andnot_ps(sign, e[5]);
    TETCASTI_SUMS_FIRST(t, e[1], 0);
    TETCASTI_SUMS_ADD(t, e[2], 1);
    TETCASTI_SUMS_ADD(t, e[0], 2);
    tetcasti_sums_end(s, &t, &z[0], &value[0]);
    no_c = _mm256_castsi256_ps(_mm256_srai_epi32(_mm256_castps_si256(no_c), 31)); /* all bits */
    no_b = _mm256_castsi256_ps(_mm256_srai_epi32(_mm256_castps_si256(no_b), 31));
    no_a = _mm256_or_ps(no_c, no_b);
    TETCASTI_SUMS_FIRST(t, _mm256_and_ps(no_a, _mm256_blendv_ps(c, b, no_c)), 0);
    TETCASTI_SUMS_ADD(t, _mm256_andnot_ps(no_b, _mm256_blendv_ps(c, a, no_c)), 1);
    TETCASTI_SUMS_ADD(t, _mm256_andnot_ps(no_c, _mm256_blendv_ps(b, a, no_b)), 2);
    TETCASTI_SUMS_ADD(t, _mm256_blendv_ps(_mm256_blendv_ps(e[1], e[2], no_b), e[0], no_c), 3);
    tetcasti_sums_end(s, &t, &z[1], &value[1]);
    out[0] = z[s->form];
    out[1] = z[!s->form];
    out[2] = value[s->form];
    out[3] = value[!s->form];
}

/* Smallest and largest of four in all lanes. */
TETCASTI_TARGET_WALK TETCASTI_INLINE __m128i tetcasti_least4(__m128i x) {
    x = _mm_min_epi32(x, _mm_shuffle_epi32(x, 0x4e));
    return _mm_min_epi32(x, _mm_shuffle_epi32(x, 0xb1));
}
TETCASTI_TARGET_WALK TETCASTI_INLINE __m128i tetcasti_most4(__m128i x) {
    x = _mm_max_epi32(x, _mm_shuffle_epi32(x, 0x4e));
    return _mm_max_epi32(x, _mm_shuffle_epi32(x, 0xb1));
}

/* tetcasti_tile_rect and tetcasti_splat_open with the four vertices side by side: 0: no pixel, 1: ready, 2: only the
   exact signs can tell. */
TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_splat_open4(const tetcasti_painter *p, const uint32_t tet[4],
                                                                   tetcasti_splat *s, int32_t rect[4]) {
    const tetcasti_view *v = p->view;
    const tetcasti_vertex *vertex = v->scene->vertex;
    const __m128 sign = _mm_set1_ps(-0.0f), place = _mm_set1_ps(v->place);
    __m128 x, y, z, w, t0, t1, t2, t3, area, fx[3], fy[3], value, span;
    __m128i lo, hi, xi, yi, roles;
    __m256 xx, yy, x_from, x_to, y_from, y_to, a, b;
    __m256i from, to;
    int32_t half = (int32_t)(1u << v->log) / 2, margin;
    uint32_t k, fronts;
    float wide, most;
    t0 = _mm_loadu_ps((const float *)(const void *)&v->seen[tet[0]]);
    t1 = _mm_loadu_ps((const float *)(const void *)&v->seen[tet[1]]);
    t2 = _mm_loadu_ps((const float *)(const void *)&v->seen[tet[2]]);
    t3 = _mm_loadu_ps((const float *)(const void *)&v->seen[tet[3]]);
    _MM_TRANSPOSE4_PS(t0, t1, t2, t3);
    xi = _mm_castps_si128(t0);
    yi = _mm_castps_si128(t1);
    z = t2;
    w = t3;
    if (TETCASTI_UNLIKELY(_mm_movemask_ps(w) != 0)) return tetcasti_tile_rect(p, tet, rect) ? 2 : 0;
    lo = _mm_unpacklo_epi32(tetcasti_least4(xi), tetcasti_least4(yi)); /* x, y */
    hi = _mm_unpacklo_epi32(tetcasti_most4(xi), tetcasti_most4(yi));
    t0 = _mm_max_ps(w, _mm_shuffle_ps(w, w, 0x4e));
    most = _mm_cvtss_f32(_mm_max_ss(t0, _mm_shuffle_ps(t0, t0, 0xb1)));
    wide = v->blur * most / v->place + 2.0f;
    margin = wide < 268435456.0f ? (int32_t)wide : 268435456;
    for (k = 0; k < 2; k++) {
        int32_t l = k == 0 ? _mm_cvtsi128_si32(lo) : _mm_extract_epi32(lo, 1);
        int32_t h = k == 0 ? _mm_cvtsi128_si32(hi) : _mm_extract_epi32(hi, 1);
        int32_t size = (int32_t)(k == 0 ? v->pixels.width : v->pixels.height);
        rect[k] = tetcasti_place_pixel(l - margin + half - 1, v->log);
        rect[k + 2] = tetcasti_place_pixel(h + margin - half, v->log) + 1;
        rect[k] = rect[k] > 0 ? rect[k] : 0;
        rect[k + 2] = rect[k + 2] < size ? rect[k + 2] : size;
        if (k == 0) s->x0 = tetcasti_place_pixel(l, v->log);
        else s->y0 = tetcasti_place_pixel(l, v->log);
    }
    tetcasti_tile_clip(p, rect);
    if (rect[0] >= rect[2] || rect[1] >= rect[3]) return 0;
    x = _mm_mul_ps(_mm_cvtepi32_ps(_mm_sub_epi32(xi, _mm_set1_epi32(s->x0 * 2 * half + half))), place);
    y = _mm_mul_ps(_mm_cvtepi32_ps(_mm_sub_epi32(yi, _mm_set1_epi32(s->y0 * 2 * half + half))), place);
    span = _mm_mul_ps(_mm_cvtepi32_ps(_mm_sub_epi32(hi, lo)), place);
    wide = _mm_cvtss_f32(span) + _mm_cvtss_f32(_mm_shuffle_ps(span, span, 0x55)) + 2.0f;
    s->bound = v->blur * most * wide + 9.5367432e-7f * (wide * wide);
    /* faces {1,2,3} {0,3,2} {0,1,3} {0,2,1} */
    fx[0] = _mm_shuffle_ps(x, x, _MM_SHUFFLE(0, 0, 0, 1));
    fx[1] = _mm_shuffle_ps(x, x, _MM_SHUFFLE(2, 1, 3, 2));
    fx[2] = _mm_shuffle_ps(x, x, _MM_SHUFFLE(1, 3, 2, 3));
    fy[0] = _mm_shuffle_ps(y, y, _MM_SHUFFLE(0, 0, 0, 1));
    fy[1] = _mm_shuffle_ps(y, y, _MM_SHUFFLE(2, 1, 3, 2));
    fy[2] = _mm_shuffle_ps(y, y, _MM_SHUFFLE(1, 3, 2, 3));
    area = _mm_sub_ps(_mm_mul_ps(_mm_sub_ps(fx[1], fx[0]), _mm_sub_ps(fy[2], fy[0])),
                      _mm_mul_ps(_mm_sub_ps(fy[1], fy[0]), _mm_sub_ps(fx[2], fx[0])));
    fronts = (uint32_t)_mm_movemask_ps(area);
    if (TETCASTI_UNLIKELY(_mm_movemask_ps(_mm_cmpgt_ps(_mm_andnot_ps(sign, area),
                                                       _mm_set1_ps(3.0f * s->bound))) != 15 ||
                          fronts == 0 || fronts == 15)) return 2;
    s->form = tetcasti_forms[fronts];
    roles = _mm_cvtepu8_epi32(_mm_cvtsi32_si128((int)tetcasti_load_u32(tetcasti_roles[fronts])));
    value = _mm_setr_ps(vertex[tet[0]].s, vertex[tet[1]].s, vertex[tet[2]].s, vertex[tet[3]].s);
    x = _mm_permutevar_ps(x, roles);
    y = _mm_permutevar_ps(y, roles);
    xx = _mm256_castps128_ps256(x);
    yy = _mm256_castps128_ps256(y);
    from = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)tetcasti_splat_edges[s->form >> 1][0]));
    to = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)tetcasti_splat_edges[s->form >> 1][1]));
    x_from = _mm256_permutevar8x32_ps(xx, from);
    x_to = _mm256_permutevar8x32_ps(xx, to);
    y_from = _mm256_permutevar8x32_ps(yy, from);
    y_to = _mm256_permutevar8x32_ps(yy, to);
    a = _mm256_sub_ps(y_from, y_to);
    b = _mm256_sub_ps(x_to, x_from);
    _mm256_storeu_ps(s->a, a);
    _mm256_storeu_ps(s->b, b);
    _mm256_storeu_ps(s->c, _mm256_xor_ps(_mm256_set1_ps(-0.0f),
                                         _mm256_add_ps(_mm256_mul_ps(a, x_from), _mm256_mul_ps(b, y_from))));
    t0 = _mm_min_ps(value, _mm_shuffle_ps(value, value, 0x4e));
    t1 = _mm_max_ps(value, _mm_shuffle_ps(value, value, 0x4e));
    s->s_lo = _mm_cvtss_f32(_mm_min_ss(t0, _mm_shuffle_ps(t0, t0, 0xb1)));
    s->s_hi = _mm_cvtss_f32(_mm_max_ss(t1, _mm_shuffle_ps(t1, t1, 0xb1)));
    w = _mm_permutevar_ps(w, roles);
    _mm_storeu_ps(s->w, w);
    _mm_storeu_ps(s->wz, _mm_mul_ps(w, _mm_permutevar_ps(z, roles)));
    _mm_storeu_ps(s->ws, _mm_mul_ps(w, _mm_permutevar_ps(value, roles)));
    return 1;
}

/* tetcasti_list_put of z0, z1, s0, s1. */
TETCASTI_TARGET_WALK TETCASTI_INLINE void tetcasti_list_put4(tetcasti_painter *p, uint32_t i, const float rec[4],
                                                             uint32_t cell) {
    uint32_t n = p->count[i];
    tetcasti_fragment *f = p->list + (size_t)i * p->room + n;
    p->count[i] = (uint16_t)(n + 1);
    p->fullest = n + 1 > p->fullest ? n + 1 : p->fullest;
    for (; n > 0 && TETCASTI_UNLIKELY(f[-1].z0 >= rec[0]); n--, f--) {
        if (!(f[-1].z0 > rec[0] || f[-1].z1 > rec[1])) break;
        *f = f[-1];
    }
    _mm_storeu_ps(&f->z0, _mm_loadu_ps(rec));
    f->cell = cell;
}

/* tetcasti_paint_cell, eight pixels at a time: of a row, or four of two rows where cells are narrow. */
TETCASTI_TARGET_WALK static void tetcasti_paint8(tetcasti_painter *p, uint32_t cell) {
    const uint32_t *tet = p->scene->mesh->tet[cell];
    tetcasti_splat s;
    int32_t x, y, rect[4], step_x, step_y;
    uint32_t good = tetcasti_splat_open4(p, tet, &s, rect);
    __m256 lane_x, lane_y;
    int narrow;
    if (TETCASTI_UNLIKELY(good != 1)) {
        if (good != 0) tetcasti_paint_rect(p, cell, rect);
        return;
    }
    narrow = rect[2] - rect[0] <= 4;
    step_x = narrow ? 4 : 8;
    step_y = narrow ? 2 : 1;
    lane_x = narrow ? _mm256_setr_ps(0, 1, 2, 3, 0, 1, 2, 3) : _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7);
    lane_y = narrow ? _mm256_setr_ps(0, 0, 0, 0, 1, 1, 1, 1) : _mm256_setzero_ps();
    for (y = rect[1]; y < rect[3]; y += step_y) {
        __m256 vy = _mm256_add_ps(_mm256_set1_ps((float)((int32_t)p->y0 + y - s.y0)), lane_y);
        for (x = rect[0]; x < rect[2]; x += step_x) {
            __m256 e[6], vx = _mm256_add_ps(_mm256_set1_ps((float)((int32_t)p->x0 + x - s.x0)), lane_x);
            uint32_t wide = rect[2] - x < step_x ? (1u << (rect[2] - x)) - 1u : narrow ? 15u : 255u;
            uint32_t lanes = p->live[y] >> x & wide, exact, first = (uint32_t)y * TETCASTI_TILE + (uint32_t)x;
            __m256 out[4], t0, t1, t2, t3;
            float rec[8][4];
            if (narrow && y + 1 < rect[3]) lanes |= (p->live[y + 1] >> x & wide) << 4;
            if (lanes == 0) continue;
            p->tests += tetcasti_popcount64(lanes);
            if (s.form == 2) {
                lanes = tetcasti_splat_lanes(&s, 4, lanes, vx, vy, e, &exact);
                if (lanes != 0) tetcasti_splat_quad8(&s, e, out);
            } else {
                lanes = tetcasti_splat_lanes(&s, 3, lanes, vx, vy, e, &exact);
                if (lanes != 0) tetcasti_splat_single8(&s, e, out);
            }
            if (lanes != 0) { /* one record a lane */
                t0 = _mm256_unpacklo_ps(out[0], out[1]);
                t1 = _mm256_unpackhi_ps(out[0], out[1]);
                t2 = _mm256_unpacklo_ps(out[2], out[3]);
                t3 = _mm256_unpackhi_ps(out[2], out[3]);
#define TETCASTI_RECORDS(i, r) \
                _mm_storeu_ps(rec[i], _mm256_castps256_ps128(r)); _mm_storeu_ps(rec[i + 4], _mm256_extractf128_ps(r, 1))
                TETCASTI_RECORDS(0, _mm256_shuffle_ps(t0, t2, 0x44));
                TETCASTI_RECORDS(1, _mm256_shuffle_ps(t0, t2, 0xee));
                TETCASTI_RECORDS(2, _mm256_shuffle_ps(t1, t3, 0x44));
                TETCASTI_RECORDS(3, _mm256_shuffle_ps(t1, t3, 0xee));
#undef TETCASTI_RECORDS
            }
            for (; lanes != 0; lanes &= lanes - 1) {
                uint32_t k = tetcasti_ctz64(lanes);
                tetcasti_list_put4(p, first + (narrow ? (k & 4u) * (TETCASTI_TILE / 4 - 1) + k : k), rec[k], cell);
            }
            for (; TETCASTI_UNLIKELY(exact != 0); exact &= exact - 1) {
                uint32_t k = tetcasti_ctz64(exact);
                tetcasti_paint_exact(p, first + (narrow ? (k & 4u) * (TETCASTI_TILE / 4 - 1) + k : k), tet, cell);
            }
        }
    }
}
#undef TETCASTI_SUMS_FIRST
#undef TETCASTI_SUMS_ADD
#undef TETCASTI_SUMS_EITHER
#undef TETCASTI_ALL

/* ---- lists of eight pixels side by side ---- */

/* tetcasti_fragment_add for the lanes `act`; returns those whose rays end. */
TETCASTI_TARGET_WALK TETCASTI_INLINE uint32_t tetcasti_fragments_add8(tetcasti_painter *p, uint32_t i, uint32_t act,
                                                                      __m256 z0, __m256 z1, __m256 s0, __m256 s1) {
    const tetcasti_scene *scene = p->scene;
    const tetcast_optics *o = scene->optics;
    const __m256 sign = _mm256_set1_ps(-0.0f), eye = _mm256_set1_ps(-(float)p->view->reference);
    tetcasti_batch *b = p->b;
    __m256 cursor = _mm256_loadu_ps(p->cursor + i), last = _mm256_loadu_ps(p->last + i),
        value = _mm256_loadu_ps(p->value + i), ways = _mm256_loadu_ps(p->way + i);
    __m256 apart = _mm256_sub_ps(z0, cursor), joined, same, gap, begin, front = s0, back = s1, end = z1, take, way,
        mask;
    uint32_t ended, beyond, gaps, rare, fresh, k;
    tetcasti_seg8 seg;
    act &= (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(z1, eye, _CMP_GE_OQ));
    beyond = act & (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(z0, last, _CMP_GT_OQ));
    act &= ~beyond;
    mask = tetcasti_mask8(act);
    _mm256_storeu_si256((__m256i *)(void *)(b->steps + i),
                        _mm256_sub_epi32(_mm256_loadu_si256((const __m256i *)(const void *)(b->steps + i)),
                                         _mm256_castps_si256(mask)));
    joined = _mm256_cmp_ps(_mm256_andnot_ps(sign, apart), _mm256_set1_ps(p->join_z), _CMP_LE_OQ);
    gap = _mm256_andnot_ps(joined, _mm256_cmp_ps(apart, _mm256_setzero_ps(), _CMP_GT_OQ));
    take = _mm256_and_ps(mask, _mm256_cmp_ps(end, cursor, _CMP_GE_OQ));
    take = _mm256_and_ps(take, _mm256_or_ps(_mm256_xor_ps(gap, mask), _mm256_cmp_ps(end, z0, _CMP_GE_OQ)));
    act = (uint32_t)_mm256_movemask_ps(take);
    same = _mm256_cmp_ps(_mm256_andnot_ps(sign, _mm256_sub_ps(front, value)), _mm256_set1_ps(p->join_s), _CMP_LE_OQ);
    front = _mm256_blendv_ps(front, value, _mm256_and_ps(joined, same));
    begin = _mm256_blendv_ps(cursor, z0, gap);
    gaps = act & (uint32_t)_mm256_movemask_ps(gap);
    fresh = act & ((uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(value, value, _CMP_UNORD_Q)) | gaps);
    rare = act & ~gaps & ~(uint32_t)_mm256_movemask_ps(joined);
    if (TETCASTI_UNLIKELY(rare != 0)) /* begins before the cursor */
        front = _mm256_blendv_ps(front, _mm256_add_ps(s0, _mm256_mul_ps(_mm256_sub_ps(s1, s0),
            _mm256_div_ps(_mm256_sub_ps(cursor, z0), _mm256_sub_ps(end, z0)))), tetcasti_mask8(rare));
    mask = _mm256_cmp_ps(end, last, _CMP_GT_OQ);
    if (TETCASTI_UNLIKELY((act & (uint32_t)_mm256_movemask_ps(mask)) != 0)) {
        back = _mm256_blendv_ps(back, _mm256_add_ps(s0, _mm256_mul_ps(_mm256_sub_ps(s1, s0),
            _mm256_div_ps(_mm256_sub_ps(last, z0), _mm256_sub_ps(end, z0)))), mask);
        end = _mm256_blendv_ps(end, last, mask);
    }
    way = _mm256_mul_ps(_mm256_sub_ps(end, begin), ways);
    _mm256_storeu_ps(b->length + i, _mm256_add_ps(_mm256_loadu_ps(b->length + i), _mm256_and_ps(way, take)));
    _mm256_storeu_ps(seg.front, front);
    _mm256_storeu_ps(seg.back, back);
    _mm256_storeu_ps(seg.length, _mm256_mul_ps(way, _mm256_set1_ps(scene->unit)));
    _mm256_storeu_ps(seg.depth, _mm256_mul_ps(_mm256_mul_ps(_mm256_add_ps(_mm256_xor_ps(eye, sign), begin), ways),
                                              _mm256_set1_ps(scene->unit)));
    _mm256_storeu_ps(p->cursor + i, _mm256_blendv_ps(cursor, end, take));
    _mm256_storeu_ps(p->value + i, _mm256_blendv_ps(value, back, take));
    for (k = fresh; TETCASTI_UNLIKELY(k != 0); k &= k - 1) b->walks[i + tetcasti_ctz64(k)]++;
    ended = act & (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(end, last, _CMP_NLT_UQ));
    if (o != NULL) {
        uint32_t early;
        for (k = gaps; TETCASTI_UNLIKELY(k != 0); k &= k - 1) tetcasti_lane_gap(o, &p->sum[i / 8], tetcasti_ctz64(k));
        early = o->segment8(o, &seg, act, &p->sum[i / 8]) & act;
        for (k = early; TETCASTI_UNLIKELY(k != 0); k &= k - 1) b->ended[i + tetcasti_ctz64(k)] = 1;
        ended |= early;
    }
    return ended | beyond;
}

TETCASTI_TARGET_WALK static void tetcasti_lists_run8(tetcasti_painter *p, float until) {
    uint32_t i, k, j, end = TETCASTI_TILE * p->height, live;
    p->fullest = 0;
    for (i = 0; i < end; i += 8) {
        const tetcasti_fragment *f = p->list + (size_t)i * p->room;
        uint32_t n[8], most = 0, todo, used[8];
        for (j = 0; j < 8; j++) {
            n[j] = p->count[i + j];
            most = n[j] > most ? n[j] : most;
            used[j] = 0;
        }
        if (most == 0) continue;
        live = p->live[i / TETCASTI_TILE] >> (i % TETCASTI_TILE) & 255u;
        todo = live;
        for (k = 0; k < most && todo != 0; k++) {
            __m256 r0, r1, r2, r3, t0, t1, t2, t3, z0;
            __m256i count = _mm256_loadu_si256((const __m256i *)(const void *)n);
            uint32_t ended;
#define TETCASTI_PAIR(l) \
            _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(&f[(l) * (size_t)p->room + k].z0)), \
                                 _mm_loadu_ps(&f[((l) + 4) * (size_t)p->room + k].z0), 1)
            r0 = TETCASTI_PAIR(0);
            r1 = TETCASTI_PAIR(1);
            r2 = TETCASTI_PAIR(2);
            r3 = TETCASTI_PAIR(3);
#undef TETCASTI_PAIR
            t0 = _mm256_unpacklo_ps(r0, r1);
            t1 = _mm256_unpackhi_ps(r0, r1);
            t2 = _mm256_unpacklo_ps(r2, r3);
            t3 = _mm256_unpackhi_ps(r2, r3);
            z0 = _mm256_shuffle_ps(t0, t2, 0x44);
            todo &= (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpgt_epi32(count,
                        _mm256_set1_epi32((int)k)))) &
                    (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(z0, _mm256_set1_ps(until), _CMP_LT_OQ));
            if (todo == 0) break;
            _mm256_storeu_si256((__m256i *)(void *)used,
                                _mm256_sub_epi32(_mm256_loadu_si256((const __m256i *)(const void *)used),
                                                 _mm256_castps_si256(tetcasti_mask8(todo))));
            ended = tetcasti_fragments_add8(p, i, todo, z0, _mm256_shuffle_ps(t0, t2, 0xee),
                                            _mm256_shuffle_ps(t1, t3, 0x44), _mm256_shuffle_ps(t1, t3, 0xee));
            todo &= ~ended;
            for (; TETCASTI_UNLIKELY(ended != 0); ended &= ended - 1) tetcasti_pixel_end(p, i + tetcasti_ctz64(ended));
        }
        live = p->live[i / TETCASTI_TILE] >> (i % TETCASTI_TILE) & 255u;
        for (j = 0; j < 8; j++) {
            uint32_t left = live >> j & 1u ? n[j] - used[j] : 0;
            if (left != 0 && used[j] != 0)
                memmove(p->list + (i + j) * (size_t)p->room, p->list + (i + j) * (size_t)p->room + used[j],
                        left * sizeof *f);
            p->count[i + j] = (uint16_t)left;
            p->fullest = left > p->fullest ? left : p->fullest;
        }
    }
}
#endif /* TETCASTI_AVX2 */

/* ---- tiles ---- */

static void tetcasti_painter_close(tetcasti_painter *p) {
    if (p == NULL) return;
    tetcasti_free(p->mem, p->entry);
    tetcasti_free(p->mem, p->list);
    tetcasti_free(p->mem, p);
}

/* mode, keep: see TETCASTI_KEEP_ALL. */
static tetcasti_painter *tetcasti_painter_open(tetcasti_mem *mem, const tetcasti_view *v, tetcasti_batch *b,
                                               uint32_t mode, uint32_t keep) {
    tetcasti_painter *p = (tetcasti_painter *)tetcasti_alloc_zero(mem, 1, sizeof *p);
    const tetcasti_field *field;
    if (p == NULL) return NULL;
    p->mem = mem;
    p->view = v;
    p->scene = v->scene;
    p->b = b;
    p->mode = mode;
    p->keep_room = keep;
    p->room = keep + 1 > TETCASTI_LIST_ROOM ? keep + 1 : TETCASTI_LIST_ROOM;
    p->list = (tetcasti_fragment *)tetcasti_alloc_zero(mem, (size_t)p->room * TETCASTI_BATCH, sizeof *p->list);
    if (p->list == NULL) {
        tetcasti_painter_close(p);
        return NULL;
    }
    p->run = tetcasti_lists_run;
    p->paint = v->scene->fma ? tetcasti_paint_fma : tetcasti_paint_plain;
#if TETCASTI_AVX2
    if (v->scene->isa >= TETCAST_ISA_AVX2 && mode == TETCASTI_KEEP_ALL) p->paint = tetcasti_paint8;
    if (v->scene->isa >= TETCAST_ISA_AVX2 && mode == TETCASTI_KEEP_ALL && !v->scene->any) p->run = tetcasti_lists_run8;
#endif
    p->join_z = (float)(4.0 * TETCASTI_BLUR);
    if (v->scene->mesh->field_count != 0) {
        field = &v->scene->mesh->field[v->scene->mesh->active];
        if (field->value_max > field->value_min) p->join_s = 1e-6f * (field->value_max - field->value_min);
    }
    return p;
}

TETCASTI_INLINE uint32_t tetcasti_depth_step(float depth, float scale) { /* depth >= 0 */
    float x = depth * scale;
    return x < (float)(TETCASTI_DEPTHS - 1) ? (uint32_t)x : TETCASTI_DEPTHS - 1;
}

/* Cells of a tile in the order of their nearest depths, in TETCASTI_DEPTHS steps from *first on. With ranks: in just
   their order. */
static int tetcasti_tile_order(tetcasti_painter *p, uint32_t n, float *first, float *scale) {
    const uint32_t *rank = p->view->rank;
    uint32_t start[TETCASTI_DEPTHS + 1], i, pass;
    tetcasti_entry *from = p->entry, *to = p->entry + n;
    float lo = n != 0 ? from[0].z : 0.0f, hi = lo;
    for (i = 1; i < n; i++) {
        lo = from[i].z < lo ? from[i].z : lo;
        hi = from[i].z > hi ? from[i].z : hi;
    }
    *first = lo;
    *scale = hi > lo ? (float)TETCASTI_DEPTHS / (hi - lo) : 0.0f;
#define TETCASTI_STEP(e) \
    (rank != NULL ? rank[(e).cell] >> pass * 11u & (TETCASTI_DEPTHS - 1) : tetcasti_depth_step((e).z - lo, *scale))
    for (pass = 0; pass < (rank != NULL ? 3u : 1u); pass++) {
        uint32_t sum = 0;
        tetcasti_entry *swap = from;
        memset(start, 0, sizeof start);
        for (i = 0; i < n; i++) start[TETCASTI_STEP(from[i])]++;
        for (i = 0; i < TETCASTI_DEPTHS; i++) {
            uint32_t count = start[i];
            start[i] = sum;
            sum += count;
        }
        for (i = 0; i < n; i++) to[start[TETCASTI_STEP(from[i])]++] = from[i];
        from = to;
        to = swap;
    }
#undef TETCASTI_STEP
    return from != p->entry;
}

/* The rays of the tile have not begun. tile: number of the tile in the picture. */
static void tetcasti_painter_begin(tetcasti_painter *p, const double ends[2]) {
    const tetcasti_view *v = p->view;
    const tetcasti_pixels *m = &v->pixels;
    tetcasti_batch *b = p->b;
    double right = 0.0, up = 0.0, size[2];
    uint32_t i, k, x, y;
    memset(p->count, 0, sizeof p->count);
    memset(p->live, 0, sizeof p->live);
    if (p->scene->optics != NULL)
        for (i = 0; i < TETCASTI_BATCH; i++) tetcasti_lane_begin(p->scene->optics, &p->sum[i / 8], i % 8);
    p->fullest = p->open = p->groups = 0;
    for (k = 0; k < 3; k++) {
        right += m->right[k] * m->right[k];
        up += m->up[k] * m->up[k];
    }
    size[0] = m->parallel ? 0.0 : 1.0 / right; /* squared, of a pixel at distance 1 */
    size[1] = m->parallel ? 0.0 : 1.0 / up;
    for (y = 0; y < p->height; y++)
        for (x = 0; x < p->width; x++) {
            double u = (double)(p->x0 + x) + 0.5 - m->center_x, w = (double)(p->y0 + y) + 0.5 - m->center_y;
            tetcasti_ray r;
            i = y * TETCASTI_TILE + x;
            p->cursor[i] = (float)(ends[0] - v->reference);
            p->last[i] = (float)(ends[1] - v->reference);
            p->value[i] = (float)NAN;
            p->way[i] = (float)sqrt(1.0 + (u * u * size[0] + w * w * size[1]));
            if (b->group[i] == TETCASTI_NO_RAY) continue;
            p->live[y] |= 1u << x;
            p->open++;
            r = tetcasti_batch_ray(b, i);
            tetcasti_beam_add(&p->beam[r.group], &r, (p->groups >> r.group & 1u) == 0);
            p->groups |= 1u << r.group;
        }
}

/* Draw the cells of a tile into the sums of its rays. ends: depths where rays begin and end. */
static void tetcasti_tile_paint(tetcasti_painter *p, uint32_t tile, const double ends[2]) {
    const tetcasti_view *v = p->view;
    const uint32_t *start = v->start + (size_t)tile * v->chunks;
    uint32_t n = start[v->chunks] - start[0], k;
    const tetcasti_entry *e;
    float first, scale;
    tetcasti_painter_begin(p, ends);
    if (n == 0 || p->open == 0) return;
    if (!tetcasti_grow(p->mem, (void **)&p->entry, &p->entry_room, 0, 2 * (size_t)n, sizeof *p->entry)) {
        p->failed = 1;
        return;
    }
    memcpy(p->entry, v->entry + start[0], n * sizeof *p->entry);
    e = p->entry + (tetcasti_tile_order(p, n, &first, &scale) ? n : 0);
    for (k = 0; k <= TETCASTI_DEPTHS; k++) p->ahead[k] = TETCASTI_INF;
    for (k = 0; k < n; k++) {
        float *a = &p->ahead[tetcasti_depth_step(e[k].z - first, scale)];
        *a = e[k].nearest < *a ? e[k].nearest : *a;
    }
    for (k = TETCASTI_DEPTHS; k > 0; k--)
        p->ahead[k - 1] = p->ahead[k] < p->ahead[k - 1] ? p->ahead[k] : p->ahead[k - 1];
    for (k = 0; k < n && p->open != 0; k++, e++) {
        if (p->fullest == p->room) { /* the other cells lie behind this */
            if (p->mode == TETCASTI_KEEP_ALL)
                p->run(p, p->ahead[tetcasti_depth_step(e->z - first, scale)] - p->join_z);
            if (p->fullest == p->room && !tetcasti_lists_grow(p)) return;
        }
        if (n - k > 12) { /* cells of a tile are far from each other in memory: a fifth of the time */
            const uint32_t *tet = v->scene->mesh->tet[e[6].cell];
            uint32_t j;
            TETCASTI_PREFETCH(v->scene->mesh->tet[e[12].cell]);
            for (j = 0; j < 4; j++) {
                TETCASTI_PREFETCH(&v->seen[tet[j]]);
                TETCASTI_PREFETCH(&v->scene->vertex[tet[j]]);
            }
        }
        p->paint(p, e->cell);
    }
    p->run(p, TETCASTI_INF);
#if TETCASTI_AVX2
    if (p->run == tetcasti_lists_run8 && p->scene->optics != NULL)
        for (k = 0; k < TETCASTI_TILE * p->height; k++) tetcasti_lane_load(&p->sum[k / 8], k % 8, &p->b->sum[k]);
#endif
}
/* ---------------------------------------------------------------------------
   render: camera -> rays -> tiles over the threads -> buffers.                  // >>render
   --------------------------------------------------------------------------- */

/* ---- camera ---- */

static void tetcasti_cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static int tetcasti_unit(double v[3]) { /* 0: no direction */
    double big = tetcasti_max(tetcasti_max(tetcasti_abs(v[0]), tetcasti_abs(v[1])), tetcasti_abs(v[2])), l;
    uint32_t a;
    if (!(big > 0.0) || !tetcasti_finite(big)) return 0;
    for (a = 0; a < 3; a++) v[a] /= big;
    l = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (a = 0; a < 3; a++) v[a] /= l;
    return 1;
}

/* Right and up of a view. An `up` that says nothing (0, along the view) is replaced by the axis farthest from it. */
static void tetcasti_frame_axes(const double forward[3], const double up[3], double right[3], double above[3]) {
    uint32_t a, k = 0;
    for (a = 0; a < 3; a++) above[a] = up[a];
    if (up[0] == 0.0 && up[1] == 0.0 && up[2] == 0.0) above[1] = 1.0;
    if (tetcasti_unit(above)) {
        tetcasti_cross(forward, above, right);
        if (right[0] * right[0] + right[1] * right[1] + right[2] * right[2] > 1e-12) {
            (void)tetcasti_unit(right);
            tetcasti_cross(right, forward, above);
            return;
        }
    }
    for (a = 1; a < 3; a++) k = tetcasti_abs(forward[a]) < tetcasti_abs(forward[k]) ? a : k;
    for (a = 0; a < 3; a++) above[a] = a == k ? 1.0 : 0.0;
    tetcasti_cross(forward, above, right);
    (void)tetcasti_unit(right);
    tetcasti_cross(right, forward, above);
}

/* tan(fov_y/2), or 0 for an angle that is none */
static double tetcasti_camera_tangent(const tetcast_camera *camera) {
    double fov = camera->fov_y != 0.0f ? (double)camera->fov_y : 40.0, s, c;
    if (!(fov > 0.0 && fov < 180.0)) return 0.0;
    tetcasti_sincos(fov * (3.14159265358979323846 / 360.0), &s, &c);
    return s / c;
}

static tetcast_result tetcasti_frame_open(const tetcast_camera *camera, uint32_t width, uint32_t height,
                                          tetcasti_frame *f) {
    double tangent = tetcasti_camera_tangent(camera), pixel;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        if (!tetcasti_finite(camera->eye[a]) || !tetcasti_finite(camera->at[a]) || !tetcasti_finite(camera->up[a]))
            return TETCAST_ERR_INVALID_ARG;
        f->eye[a] = camera->eye[a];
        f->forward[a] = camera->at[a] - camera->eye[a];
    }
    f->parallel = camera->ortho_height != 0.0f;
    f->width = width;
    f->height = height;
    if (!(tangent > 0.0) || !(camera->ortho_height >= 0.0f) || !tetcasti_finite_f(camera->ortho_height) ||
        !tetcasti_unit(f->forward)) return TETCAST_ERR_INVALID_ARG;
    tetcasti_frame_axes(f->forward, camera->up, f->right, f->up);
    pixel = height != 0 ? (f->parallel ? (double)camera->ortho_height : 2.0 * tangent) / (double)height : 0.0;
    for (a = 0; a < 3; a++) {
        f->right[a] *= pixel;
        f->up[a] *= pixel;
    }
    return TETCAST_OK;
}

/* Origin and direction through a point of the picture; the direction is 1 along the view. */
TETCASTI_INLINE void tetcasti_frame_ray(const tetcasti_frame *f, double x, double y, double o[3], double d[3]) {
    double u = x - 0.5 * (double)f->width, v = 0.5 * (double)f->height - y;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        double shift = u * f->right[a] + v * f->up[a];
        o[a] = f->parallel ? f->eye[a] + shift : f->eye[a];
        d[a] = f->parallel ? f->forward[a] : f->forward[a] + shift;
    }
}

TETCAST_DEF tetcast_result tetcast_camera_ray(const tetcast_camera *camera, uint32_t width, uint32_t height, double x,
                                              double y, tetcast_ray *out_ray) {
    tetcasti_frame f;
    tetcast_result r;
    if (camera == NULL || out_ray == NULL || height == 0) return TETCAST_ERR_INVALID_ARG;
    memset(out_ray, 0, sizeof *out_ray);
    r = tetcasti_frame_open(camera, width, height, &f);
    if (r != TETCAST_OK) return r;
    tetcasti_frame_ray(&f, x, y, out_ray->org, out_ray->dir);
    (void)tetcasti_unit(out_ray->dir);
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_camera_fit(tetcast_camera *camera, const double box_min[3], const double box_max[3],
                                              const double view[3], uint32_t width, uint32_t height) {
    double back[3], forward[3], right[3], above[3], up[3], centre[3], most[4], x, y, distance, size = 0.0, tan_x, tan_y;
    uint32_t a, k;
    if (camera == NULL || box_min == NULL || box_max == NULL) return TETCAST_ERR_INVALID_ARG;
    tan_y = tetcasti_camera_tangent(camera);
    tan_x = width != 0 && height != 0 ? tan_y * (double)width / (double)height : tan_y;
    if (!(tan_y > 0.0)) return TETCAST_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++) {
        if (!tetcasti_finite(box_min[a]) || !tetcasti_finite(box_max[a]) || box_min[a] > box_max[a])
            return TETCAST_ERR_INVALID_ARG;
        centre[a] = 0.5 * (box_min[a] + box_max[a]);
        size = tetcasti_max(size, box_max[a] - box_min[a]);
        up[a] = camera->up[a];
        if (view != NULL) back[a] = view[a];
    }
    if (view == NULL) { /* `up` and the x axis say where the front is: +z with y up, -y with z up */
        double side[3], front[3];
        if (!tetcasti_unit(up)) {
            up[0] = up[2] = 0.0;
            up[1] = 1.0;
        }
        for (a = 0; a < 3; a++) side[a] = a == 0 ? 1.0 : 0.0;
        tetcasti_cross(side, up, front);
        if (front[0] * front[0] + front[1] * front[1] + front[2] * front[2] < 1e-3) {
            side[0] = 0.0;
            side[1] = 1.0;
            tetcasti_cross(side, up, front);
        }
        (void)tetcasti_unit(front);
        tetcasti_cross(up, front, side);
        for (a = 0; a < 3; a++) back[a] = 0.6 * side[a] + 0.42 * up[a] + front[a];
    }
    if (!tetcasti_unit(back)) return TETCAST_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++) forward[a] = -back[a];
    tetcasti_frame_axes(forward, camera->up, right, above);
    /* a corner at (x, y, z) (right, above, towards the eye) is in the picture when |x - cx| <= (distance - z) tan_x */
    for (k = 0; k < 4; k++) most[k] = 0.0;
    for (a = 0; a < 3; a++) {
        double half = 0.5 * (box_max[a] - box_min[a]), deep_x = tan_x, deep_y = tan_y;
        if (camera->ortho_height != 0.0f) deep_x = deep_y = 0.0;
        most[0] += half * tetcasti_abs(right[a] + deep_x * back[a]);
        most[1] += half * tetcasti_abs(-right[a] + deep_x * back[a]);
        most[2] += half * tetcasti_abs(above[a] + deep_y * back[a]);
        most[3] += half * tetcasti_abs(-above[a] + deep_y * back[a]);
    }
    distance = tetcasti_max((most[0] + most[1]) / (2.0 * tan_x), (most[2] + most[3]) / (2.0 * tan_y));
    x = 0.5 * (most[0] - most[1]);
    y = 0.5 * (most[2] - most[3]);
    distance = size > 0.0 ? 1.04 * distance + 0.01 * size : 1.0;
    if (camera->ortho_height != 0.0f) { /* from outside of the box */
        camera->ortho_height = (float)(2.0 * distance * tan_y);
        distance += 2.0 * size;
    }
    for (a = 0; a < 3; a++) {
        camera->at[a] = centre[a] + x * right[a] + y * above[a];
        camera->eye[a] = camera->at[a] + distance * back[a];
    }
    return TETCAST_OK;
}

/* ---- batches: memory, set-up ---- */

static tetcasti_batch *tetcasti_batch_open(tetcasti_mem *mem) {
    tetcasti_batch *b = (tetcasti_batch *)tetcasti_alloc(mem, sizeof *b);
    uint32_t i;
    if (b == NULL) return NULL;
    memset(b, 0, sizeof *b);
    for (i = 0; i < TETCASTI_BATCH; i++) b->queue[i] = (uint16_t)i;
    b->mem = mem;
    return b;
}

/* The rays will be the pixels of tiles: lanes take blocks of 4 x 2, and these along a Z curve. */
static void tetcasti_batch_blocks(tetcasti_batch *b) {
    uint32_t i, k;
    for (i = 0; i < TETCASTI_BATCH; i++) {
        uint32_t x = 0, y = 0;
        for (k = 0; k < 5; k++) {
            x |= (i >> (2 * k) & 1u) << k;
            y |= (i >> (2 * k + 1) & 1u) << k;
        }
        b->queue[i] = (uint16_t)(y * TETCASTI_TILE + x);
    }
    b->together = 1;
}

static void tetcasti_batch_close(tetcasti_batch *b) {
    if (b == NULL) return;
    tetcasti_free(b->mem, b->hit);
    tetcasti_free(b->mem, b->sorted);
    tetcasti_free(b->mem, b);
}

/* Put a ray, in local coordinates, into place i. near and far are local distances from o. */
static void tetcasti_batch_put(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t i, const double o[3],
                               const double d[3], double near_end, double far_end) {
    tetcasti_ray r;
    double offset = 0.0;
    memset(&r, 0, sizeof r);
    r.group = tetcasti_ray_group(d);
    if (r.group != TETCASTI_NO_RAY) offset = tetcasti_ray_make(&scene->mesh->box, o, d, &r);
    b->group[i] = (uint8_t)r.group;
    b->ox[i] = r.ox;
    b->oy[i] = r.oy;
    b->oz[i] = r.oz;
    b->sx[i] = r.sx;
    b->sy[i] = r.sy;
    b->iz[i] = r.iz;
    b->offset[i] = (float)offset;
    b->cursor[i] = (float)(near_end - offset);
    b->last[i] = (float)(far_end - offset);
    if (!(b->last[i] > b->cursor[i])) b->group[i] = TETCASTI_NO_RAY; /* it ends before it begins */
}

/* Nothing seen yet, on any ray. */
static void tetcasti_batch_begin(const tetcasti_scene *scene, tetcasti_batch *b) {
    uint32_t i;
    b->hit_count = 0;
    b->hull_tests = b->lanes = 0;
    memset(b->length, 0, sizeof b->length);
    memset(b->steps, 0, sizeof b->steps);
    memset(b->walks, 0, sizeof b->walks);
    memset(b->ended, 0, sizeof b->ended);
    for (i = 0; i < b->count; i++) b->depth[i] = TETCASTI_INF;
    if (scene->optics == NULL) return;
    for (i = 0; i < b->count; i++) tetcasti_ray_begin(scene->optics, &b->sum[i]);
}

/* The commonest integrators once more, with 32 registers: a twentieth of a frame. Sixteen lanes for two packets at once
   were 5 % slower than eight: Zen 4 has enough to do with them, and one of sixteen needs the slow way more often. */
#if TETCASTI_AVX2 && defined(__GNUC__)
TETCASTI_TARGET_VL static uint32_t tetcasti_exact8_vl_8(const tetcast_optics *o, const tetcasti_seg8 *seg,
                                                        uint32_t lanes, tetcasti_ray_sum8 *sum) {
    return tetcasti_exact8(TETCASTI_TF_8, TETCASTI_KIND_ASSOCIATED, 0, tetcasti_exact8_associated_8_slow, o, seg, lanes,
                           sum);
}
TETCASTI_TARGET_VL static uint32_t tetcasti_exact8_vl_16(const tetcast_optics *o, const tetcasti_seg8 *seg,
                                                         uint32_t lanes, tetcasti_ray_sum8 *sum) {
    return tetcasti_exact8(TETCASTI_TF_16, TETCASTI_KIND_ASSOCIATED, 0, tetcasti_exact8_associated_16_slow, o, seg,
                           lanes, sum);
}
#endif

/* What a frame needs of mesh and optics. */
static tetcast_result tetcasti_scene_open(const tetcast_render_desc *d, const tetcast_mesh *mesh,
                                          const tetcast_optics *optics, tetcasti_scene *s) {
    memset(s, 0, sizeof *s);
    s->mesh = mesh;
    s->vertex = mesh->vertex;
    s->cells = &mesh->cells;
    s->hull = &mesh->hull;
    s->first = mesh->cells.first;
    s->stop_log = TETCASTI_CLUSTER_LOG;
    s->optics = optics;
    s->unit = (float)mesh->unit;
    s->smooth_normals = d->smooth_normals;
    s->fma = (uint32_t)tetcasti_has_fma();
    s->any = optics != NULL && (optics->iso_count != 0 || mesh->hidden != NULL || mesh->cell_value != NULL);
    if (optics != NULL) {
        tetcasti_ray_sum none;
        tetcasti_ray_begin(optics, &none);
        s->begin_t = none.t;
    }
    s->isa = tetcast_isa_best();
#if TETCASTI_AVX2
    if (s->isa >= TETCAST_ISA_AVX2 && tetcasti_has_avx512()) s->isa = TETCAST_ISA_AVX512;
#endif
    if (s->isa >= TETCAST_ISA_AVX2 && !s->fma) s->isa = TETCAST_ISA_SSE;
    if (d->isa != TETCAST_ISA_AUTO && d->isa < s->isa) s->isa = d->isa;
    if (optics != NULL) s->segment8 = optics->segment8;
#if TETCASTI_AVX2 && defined(__GNUC__)
    if (s->isa >= TETCAST_ISA_AVX512 && s->segment8 == tetcasti_exact8_associated_8) s->segment8 = tetcasti_exact8_vl_8;
    if (s->isa >= TETCAST_ISA_AVX512 && s->segment8 == tetcasti_exact8_associated_16)
        s->segment8 = tetcasti_exact8_vl_16;
#endif
    if ((uint32_t)d->isa > TETCAST_ISA_AVX512 || (d->smooth_normals && mesh->gradient == NULL))
        return TETCAST_ERR_INVALID_ARG;
    return TETCAST_OK;
}

/* ---- the eye inside of the mesh ---- */

typedef struct tetcasti_inside {
    uint32_t known;             /* the eye is in a cell, which is entered through v from prev */
    tetcasti_start start;
} tetcasti_inside;

/* Find the cell at a local point: follow a line through it. The batch is used for scratch. */
static void tetcasti_locate(const tetcasti_scene *scene, tetcasti_batch *b, const double p[3], tetcasti_inside *out) {
    static const double direction[3] = {0.6188, 0.3512, 0.7026}; /* along nothing that meshes have many of */
    const tetcasti_box *box = &scene->mesh->box;
    uint32_t a, k;
    out->known = 0;
    for (a = 0; a < 3; a++)
        if (!(p[a] >= (double)box->lo[a] && p[a] <= (double)box->hi[a])) return;
    b->count = 1;
    b->hit_count = 0;
    tetcasti_batch_put(scene, b, 0, p, direction, 0.0, (double)TETCASTI_INF);
    tetcasti_line_hits(scene, b, 0);
    tetcasti_batch_sort(b);
    for (k = 0; k < b->hit_start[1] && b->sorted[k].at <= b->cursor[0]; k++) {
        tetcasti_start start = tetcasti_hit_start(scene, b, &b->sorted[k]);
        tetcasti_ray r = tetcasti_batch_ray(b, 0);
        tetcasti_walk w;
        float at, s;
        tetcasti_walk_begin(&r, scene->vertex, &start, &w);
        while (w.cell != TETCASTI_NONE) {
            out->start.v[0] = w.a;
            out->start.v[1] = w.b;
            out->start.v[2] = w.c;
            out->start.cell = w.cell;
            out->start.prev = w.prev;
            tetcasti_walk_step_any(scene->cells, &r, scene->vertex, &w, &at, &s);
            if (at > b->cursor[0]) {
                out->known = 1;
                return;
            }
        }
    }
}

/* Where ray i, which begins in the cell of the eye, enters that cell (behind the eye). When it sees no face of it, the
   eye is as good as on its surface: then all faces of the hull on the whole line are hits. */
static void tetcasti_inside_hit(const tetcasti_scene *scene, tetcasti_batch *b, uint32_t i, const tetcasti_inside *in) {
    tetcasti_ray r = tetcasti_batch_ray(b, i);
    const uint32_t *v = in->start.v;
    tetcasti_node node;
    uint32_t d, f;
    if (r.group == TETCASTI_NO_RAY) return;
    d = tetcasti_enter(scene->cells, scene->cells->kind, in->start.cell, in->start.prev, v[0], v[1], v[2], &node);
    for (f = 0; f < 4; f++) { /* the known face, and those with d in place of one of its vertices, turned over */
        tetcasti_start *s = &b->start[i];
        float at;
        *s = in->start;
        if (f != 0) {
            uint32_t p = f == 1 ? 1 : 0, q = f == 3 ? 1 : 2, swap;
            s->v[f - 1] = d;
            swap = s->v[p];
            s->v[p] = s->v[q];
            s->v[q] = swap;
        }
        if (!tetcasti_face_hit(&r, scene->vertex, s->v, &at)) continue;
        if (f != 0)
            s->prev = tetcasti_leave(scene->cells, scene->cells->kind, &node, in->start.cell, in->start.prev, v[0],
                                     v[1],
                                     v[2], d, v[f - 1]);
        tetcasti_batch_hit(b, i, at, TETCASTI_STARTS | i);
        return;
    }
    tetcasti_line_hits(scene, b, i);
}

/* ---- pictures ---- */

/* Linear light -> sRGB byte without powers: byte k begins at `from[k]`, the byte at i / 4096 is guess[i]. There is at
   most one such border between two guesses, so one comparison settles it. */
typedef struct tetcasti_encoder {
    float from[257];
    uint8_t guess[4097];
} tetcasti_encoder;

static void tetcasti_encoder_open(tetcasti_encoder *e) {
    uint32_t i, k = 0;
    for (i = 0; i < 257; i++) e->from[i] = (float)tetcasti_srgb_to_linear(((double)i - 0.5) / 255.0);
    e->from[0] = 0.0f;
    e->from[256] = TETCASTI_INF;
    for (i = 0; i < 4097; i++) {
        while ((float)i * (1.0f / 4096.0f) >= e->from[k + 1]) k++;
        e->guess[i] = (uint8_t)k;
    }
}

TETCASTI_INLINE uint8_t tetcasti_encode(const tetcasti_encoder *e, float x) {
    uint32_t k;
    if (!(x > 0.0f)) return 0;
    if (x >= 1.0f) return 255;
    k = e->guess[(uint32_t)(x * 4096.0f)];
    return (uint8_t)(k + (x >= e->from[k + 1]));
}

typedef struct tetcasti_render {
    const tetcast_render_desc *desc;
    const tetcast_image *image;
    tetcasti_scene scene;
    tetcasti_frame frame;
    tetcasti_mem mem;
    tetcasti_inside inside;
    tetcasti_leap leap;
    uint64_t leapt;
    tetcasti_encoder encoder;
    double local_eye[3], scale;  /* world -> local */
    uint32_t tiles_x, tiles;
    uint32_t next;               /* atomic: tiles taken */
    uint32_t done;               /* atomic: tiles finished */
    uint32_t failed, cancelled;  /* atomics */
    uint32_t tally[9][2];        /* atomics, see tetcasti_tally_add */
    tetcasti_view view;          /* projection only */
    uint32_t projected;
    float pixels_per_cell;
} tetcasti_render;

TETCASTI_INLINE void tetcasti_tile_ray(const tetcasti_scene *scene, const tetcasti_tile *t, tetcasti_batch *b,
                                       uint32_t x, uint32_t y) {
    const tetcasti_frame *f = t->frame;
    double u = ((double)(t->x0 + x) + 0.5) - 0.5 * (double)f->width,
        v = 0.5 * (double)f->height - ((double)(t->y0 + y) + 0.5);
    double o[3], d[3], way;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        double shift = u * f->right[a] + v * f->up[a];
        o[a] = f->parallel ? t->local_eye[a] + shift * t->scale : t->local_eye[a];
        d[a] = f->parallel ? f->forward[a] : f->forward[a] + shift;
    }
    way = sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2]);
    tetcasti_batch_put(scene, b, y * TETCASTI_TILE + x, o, d, t->near_end * way, t->far_end * way);
}

/* The group of all rays of a tile, or NO_RAY. Directions are affine in the pixel, so it is that of the corners when it
   is clearly the same in all of them. */
static uint32_t tetcasti_tile_group(const tetcasti_tile *t) {
    const tetcasti_frame *f = t->frame;
    uint32_t i, a, group = TETCASTI_NO_RAY;
    for (i = 0; i < 4; i++) {
        double u = (double)(t->x0 + (i & 1u) * t->width) - 0.5 * (double)f->width;
        double v = 0.5 * (double)f->height - (double)(t->y0 + (i >> 1) * t->height), d[3];
        uint32_t g;
        for (a = 0; a < 3; a++) d[a] = f->parallel ? f->forward[a] : f->forward[a] + (u * f->right[a] + v * f->up[a]);
        g = tetcasti_ray_group(d);
        if (g == TETCASTI_NO_RAY || (i != 0 && g != group)) return TETCASTI_NO_RAY;
        group = g;
        for (a = 0; a < 3; a++)
            if (a != g / 2 && !(tetcasti_abs(d[a]) < 0.999999 * tetcasti_abs(d[g / 2]))) return TETCASTI_NO_RAY;
    }
    return group;
}

static void tetcasti_tile_rays(const tetcasti_render *c, tetcasti_batch *b, uint32_t x0, uint32_t y0,
                               tetcasti_pixels *m) {
    const tetcasti_frame *f = &c->frame;
    tetcasti_tile t;
    double size = 0.0;
    uint32_t x, y, a;
    memset(&t, 0, sizeof t);
    t.frame = f;
    t.box = &c->scene.mesh->box;
    t.scale = c->scale;
    t.near_end = (double)c->desc->clip_near * c->scale;
    t.far_end = (double)c->desc->clip_far * c->scale;
    if (!(t.far_end > 0.0)) t.far_end = (double)TETCASTI_INF;
    t.x0 = x0;
    t.y0 = y0;
    t.width = m->width = f->width - x0 < TETCASTI_TILE ? f->width - x0 : TETCASTI_TILE;
    t.height = m->height = f->height - y0 < TETCASTI_TILE ? f->height - y0 : TETCASTI_TILE;
    for (a = 0; a < 3; a++) size += f->right[a] * f->right[a];
    if (f->parallel) size *= c->scale; /* p . right / size: pixels per local unit */
    for (a = 0; a < 3; a++) {
        t.local_eye[a] = m->eye[a] = c->local_eye[a];
        m->right[a] = size > 0.0 ? f->right[a] / size : 0.0;
        m->up[a] = size > 0.0 ? f->up[a] / size : 0.0;
        m->forward[a] = f->forward[a];
    }
    m->center_x = 0.5 * (double)f->width - (double)x0;
    m->center_y = 0.5 * (double)f->height - (double)y0;
    m->parallel = f->parallel;
    t.group = m->group = tetcasti_tile_group(&t);
    b->count = TETCASTI_TILE * m->height;
    tetcasti_batch_begin(&c->scene, b);
#if TETCASTI_AVX2
    if (c->scene.isa >= TETCAST_ISA_AVX2 && t.group != TETCASTI_NO_RAY) {
        tetcasti_tile_rays4(&t, b);
        return;
    }
#endif
    for (y = 0; y < m->height; y++) {
        memset(b->group + y * TETCASTI_TILE, (int)TETCASTI_NO_RAY, TETCASTI_TILE);
        for (x = 0; x < m->width; x++) tetcasti_tile_ray(&c->scene, &t, b, x, y);
    }
}

static void tetcasti_pixel_write(const tetcasti_render *c, tetcasti_batch *b, uint32_t i, uint32_t x, uint32_t y) {
    const tetcast_image *m = c->image;
    const float *back = c->desc->background;
    float rgba[4], t;
    uint32_t a;
    int ray = b->group[i] != TETCASTI_NO_RAY;
    rgba[0] = rgba[1] = rgba[2] = rgba[3] = 0.0f;
    if (ray && c->scene.optics != NULL) tetcasti_ray_finish(c->scene.optics, &b->sum[i], rgba);
    t = 1.0f - rgba[3];
    for (a = 0; a < 4; a++) rgba[a] += t * back[a];
    if (m->rgba != NULL)
        memcpy((uint8_t *)m->rgba + y * (m->rgba_stride != 0 ? m->rgba_stride : (size_t)m->width * 16) + x *
               (size_t)16, rgba, 16);
    if (m->rgba8 != NULL) {
        uint8_t *p = m->rgba8 + y * (m->rgba8_stride != 0 ? m->rgba8_stride : (size_t)m->width * 4) + x * (size_t)4;
        float inv = rgba[3] > 0.0f ? 1.0f / rgba[3] : 0.0f;
        for (a = 0; a < 3; a++) p[a] = tetcasti_encode(&c->encoder, rgba[a] * inv);
        p[3] = (uint8_t)((rgba[3] > 0.0f ? rgba[3] < 1.0f ? rgba[3] : 1.0f : 0.0f) * 255.0f + 0.5f);
    }
    if (m->depth != NULL) {
        float depth = TETCASTI_INF;
        if (ray && b->depth[i] < TETCASTI_INF) {
            float d[3];
            tetcasti_ray r = tetcasti_batch_ray(b, i);
            tetcasti_ray_direction(&r, d);
            depth = b->depth[i] * (d[0] * (float)c->frame.forward[0] + d[1] * (float)c->frame.forward[1] +
                                   d[2] * (float)c->frame.forward[2]);
        }
        memcpy((uint8_t *)m->depth + y * (m->depth_stride != 0 ? m->depth_stride : (size_t)m->width * 4) + x *
               (size_t)4, &depth, 4);
    }
    if (m->length != NULL) {
        float length = ray ? b->length[i] * c->scene.unit : 0.0f;
        memcpy((uint8_t *)m->length + y * (m->length_stride != 0 ? m->length_stride : (size_t)m->width * 4) + x *
               (size_t)4, &length, 4);
    }
    if (m->steps != NULL) {
        uint32_t steps = ray ? b->steps[i] : 0;
        memcpy((uint8_t *)m->steps + y * (m->steps_stride != 0 ? m->steps_stride : (size_t)m->width * 4) + x *
               (size_t)4, &steps, 4);
    }
}

/* rays, hit rays, walks, steps, hull tests, ended, lanes */
static void tetcasti_batch_tally(const tetcasti_batch *b, uint32_t (*tally)[2]) {
    uint64_t n[7];
    uint32_t i;
    memset(n, 0, sizeof n);
    for (i = 0; i < b->count; i++) {
        if (b->group[i] == TETCASTI_NO_RAY) continue;
        n[1] += b->walks[i] != 0;
        n[2] += b->walks[i];
        n[3] += b->steps[i];
        n[5] += b->ended[i];
    }
    n[4] = b->hull_tests;
    n[6] = b->lanes;
    for (i = 1; i < 7; i++) tetcasti_tally_add(tally[i], n[i]);
}

static tetcasti_rect_fn *tetcasti_rect_pick(const tetcasti_scene *scene, tetcasti_faces_fn **faces_fn) {
    *faces_fn = tetcasti_faces_all;
#if TETCASTI_AVX2
    if (scene->isa >= TETCAST_ISA_AVX2) {
        *faces_fn = tetcasti_faces8;
        return tetcasti_rect8;
    }
#endif
    return scene->fma ? tetcasti_rect_fma : tetcasti_rect_plain;
}

/* Follow all rays of a batch whose hits are found. */
static void tetcasti_batch_run(const tetcasti_scene *scene, tetcasti_batch *b) {
    tetcasti_batch_sort(b);
#if TETCASTI_AVX2
    if (scene->isa >= TETCAST_ISA_AVX2) {
        if (scene->cells->kind != TETCAST_CELLS_TET16 && scene->cells->kind != TETCAST_CELLS_TET8)
            tetcasti_batch_walk8_more(scene, b);
        else if (scene->isa >= TETCAST_ISA_AVX512) tetcasti_batch_walk8_vl(scene, b);
        else tetcasti_batch_walk8(scene, b);
        return;
    }
#endif
    tetcasti_batch_walk(scene, b);
}

static void tetcasti_task_tiles(void *ctx, uint32_t strand) {
    tetcasti_render *c = (tetcasti_render *)ctx;
    tetcasti_faces_fn *faces_fn;
    tetcasti_rect_fn *rect_fn = tetcasti_rect_pick(&c->scene, &faces_fn);
    tetcasti_batch *b = tetcasti_batch_open(&c->mem);
    if (b == NULL) {
        tetcasti_atomic_store(&c->failed, 1u);
        return;
    }
    tetcasti_batch_blocks(b);
    for (;;) {
        uint32_t tile = tetcasti_atomic_add(&c->next, 1u) - 1u, x0, y0, i;
        tetcasti_pixels m;
        if (tile >= c->tiles || tetcasti_atomic_load(&c->failed) || tetcasti_atomic_load(&c->cancelled)) break;
        x0 = tile % c->tiles_x * TETCASTI_TILE;
        y0 = tile / c->tiles_x * TETCASTI_TILE;
        tetcasti_tile_rays(c, b, x0, y0, &m);
        if (c->inside.known)
            for (i = 0; i < b->count; i++) tetcasti_inside_hit(&c->scene, b, i, &c->inside);
        tetcasti_tile_hits(&c->scene, b, &m, rect_fn, faces_fn);
        tetcasti_batch_run(&c->scene, b);
        if (b->failed) {
            tetcasti_atomic_store(&c->failed, 1u);
            break;
        }
        for (i = 0; i < b->count; i++)
            if (i % TETCASTI_TILE < m.width)
                tetcasti_pixel_write(c, b, i, x0 + i % TETCASTI_TILE, y0 + i / TETCASTI_TILE);
        tetcasti_tally_add(c->tally[0], (uint64_t)m.width * m.height);
        tetcasti_batch_tally(b, c->tally);
        i = tetcasti_atomic_add(&c->done, 1u);
        if (strand == 0 && c->desc->env.progress_fn != NULL &&
            c->desc->env.progress_fn(c->desc->env.progress_user, i, c->tiles) != 0)
                tetcasti_atomic_store(&c->cancelled, 1u);
    }
    tetcasti_batch_close(b);
}

/* The same by projection. */
static void tetcasti_task_paint(void *ctx, uint32_t strand) {
    tetcasti_render *c = (tetcasti_render *)ctx;
    tetcasti_batch *b = tetcasti_batch_open(&c->mem);
    tetcasti_painter *p = b != NULL ? tetcasti_painter_open(&c->mem, &c->view, b, TETCASTI_KEEP_ALL, 0) : NULL;
    double ends[2];
    if (p == NULL) {
        tetcasti_atomic_store(&c->failed, 1u);
        tetcasti_batch_close(b);
        return;
    }
    ends[0] = (double)c->desc->clip_near * c->scale;
    ends[1] = (double)c->desc->clip_far * c->scale;
    if (!(ends[1] > 0.0)) ends[1] = (double)TETCASTI_INF;
    for (;;) {
        uint32_t tile = tetcasti_atomic_add(&c->next, 1u) - 1u, i;
        tetcasti_pixels m;
        if (tile >= c->tiles || tetcasti_atomic_load(&c->failed) || tetcasti_atomic_load(&c->cancelled)) break;
        p->x0 = tile % c->tiles_x * TETCASTI_TILE;
        p->y0 = tile / c->tiles_x * TETCASTI_TILE;
        tetcasti_tile_rays(c, b, p->x0, p->y0, &m);
        p->width = m.width;
        p->height = m.height;
        tetcasti_tile_paint(p, tile, ends);
        if (p->failed) {
            tetcasti_atomic_store(&c->failed, 1u);
            break;
        }
        for (i = 0; i < b->count; i++)
            if (i % TETCASTI_TILE < m.width)
                tetcasti_pixel_write(c, b, i, p->x0 + i % TETCASTI_TILE, p->y0 + i / TETCASTI_TILE);
        tetcasti_tally_add(c->tally[0], (uint64_t)m.width * m.height);
        tetcasti_batch_tally(b, c->tally);
        i = tetcasti_atomic_add(&c->done, 1u);
        if (strand == 0 && c->desc->env.progress_fn != NULL &&
            c->desc->env.progress_fn(c->desc->env.progress_user, i, c->tiles) != 0)
                tetcasti_atomic_store(&c->cancelled, 1u);
    }
    tetcasti_tally_add(c->tally[7], p->tests);
    tetcasti_tally_add(c->tally[8], p->exact);
    tetcasti_painter_close(p);
    tetcasti_batch_close(b);
}

/* The picture as projection sees it. */
static void tetcasti_render_view(tetcasti_render *c) {
    const tetcasti_frame *f = &c->frame;
    tetcasti_pixels m;
    double size = 0.0;
    uint32_t a;
    memset(&m, 0, sizeof m);
    for (a = 0; a < 3; a++) size += f->right[a] * f->right[a];
    if (f->parallel) size *= c->scale;
    for (a = 0; a < 3; a++) {
        m.eye[a] = c->local_eye[a];
        m.right[a] = f->right[a] / size;
        m.up[a] = f->up[a] / size;
        m.forward[a] = f->forward[a];
    }
    m.center_x = 0.5 * (double)f->width;
    m.center_y = 0.5 * (double)f->height;
    m.parallel = f->parallel;
    m.width = f->width;
    m.height = f->height;
    tetcasti_view_set(&c->scene, &m, &c->view);
}

static void tetcasti_stats_add(tetcast_render_stats *stats, uint32_t tally[7][2], const tetcasti_scene *scene) {
    if (stats == NULL) return;
    stats->rays += tetcasti_tally(tally[0]);
    stats->hit_rays += tetcasti_tally(tally[1]);
    stats->walks += tetcasti_tally(tally[2]);
    stats->steps += tetcasti_tally(tally[3]);
    stats->hull_tests += tetcasti_tally(tally[4]);
    stats->ended += tetcasti_tally(tally[5]);
    stats->lanes += tetcasti_tally(tally[6]);
    stats->isa = scene->isa >= TETCAST_ISA_AVX2 ? scene->isa : TETCAST_ISA_SCALAR;
}

static tetcast_result tetcasti_desc_open(const tetcast_render_desc *desc, tetcast_render_desc *d, tetcasti_mem *mem) {
    uint32_t a;
    memset(d, 0, sizeof *d);
    if (desc != NULL) *d = *desc;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    for (a = 0; a < 4; a++)
        if (!tetcasti_finite_f(d->background[a])) return TETCAST_ERR_INVALID_ARG;
    if (!(d->clip_near >= 0.0f && d->clip_near < TETCASTI_INF && d->clip_far >= 0.0f)) return TETCAST_ERR_INVALID_ARG;
    return tetcasti_env_open(&d->env, mem);
}

static tetcast_result tetcasti_render_end(tetcasti_render *c, int ok, tetcast_render_stats *stats) {
    tetcast_error *error = c->desc->env.error;
    if (!ok) return tetcasti_fail(error, TETCAST_ERR_NO_MEMORY, 0, "render: out of memory");
    if (c->cancelled) return tetcasti_fail(error, TETCAST_ERR_CANCELLED, 0, "render: cancelled");
    tetcasti_stats_add(stats, c->tally, &c->scene);
    if (stats == NULL) return TETCAST_OK;
    stats->leapt_faces += c->leapt;
    stats->cells += tetcasti_tally(c->view.taken);
    stats->pixel_tests += tetcasti_tally(c->tally[7]);
    stats->exact_tests += tetcasti_tally(c->tally[8]);
    stats->method = c->projected ? TETCAST_METHOD_PROJECT : TETCAST_METHOD_WALK;
    stats->pixels_per_cell = c->pixels_per_cell;
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_render(const tetcast_render_desc *desc, const tetcast_mesh *mesh,
                                          const tetcast_optics *optics, const tetcast_image *image,
                                          tetcast_render_stats *stats) {
    tetcast_render_desc d;
    tetcasti_render c;
    tetcast_result r;
    uint32_t a, strands;
    memset(&c, 0, sizeof c);
    r = tetcasti_desc_open(desc, &d, &c.mem);
    if (r != TETCAST_OK) return r;
    if (mesh == NULL || image == NULL || (optics == NULL && !d.traverse_only) ||
        (uint32_t)d.method > TETCAST_METHOD_PROJECT) return TETCAST_ERR_INVALID_ARG;
    c.desc = &d;
    c.image = image;
    r = tetcasti_scene_open(&d, mesh, d.traverse_only ? NULL : optics, &c.scene);
    if (r == TETCAST_OK && d.camera.eye[0] == d.camera.at[0] && d.camera.eye[1] == d.camera.at[1] &&
        d.camera.eye[2] == d.camera.at[2]) {
        tetcast_mesh_info info;
        tetcast_mesh_get_info(mesh, &info);
        r = tetcast_camera_fit(&d.camera, info.box_min, info.box_max, NULL, image->width, image->height);
    }
    if (c.scene.optics != NULL && image->depth != NULL) c.scene.any = 1;
    if (r == TETCAST_OK) r = tetcasti_frame_open(&d.camera, image->width, image->height, &c.frame);
    if (r != TETCAST_OK) return tetcasti_fail(d.env.error, r, 0, "render: bad camera or option");
    if (image->width == 0 || image->height == 0) return TETCAST_OK;
    c.tiles_x = (image->width + TETCASTI_TILE - 1) / TETCASTI_TILE;
    if ((uint64_t)c.tiles_x * ((image->height + TETCASTI_TILE - 1) / TETCASTI_TILE) > 0x7fffffffu)
        return tetcasti_fail(d.env.error, TETCAST_ERR_RANGE, image->width, "render: the picture is too large");
    if (image->rgba8 != NULL) tetcasti_encoder_open(&c.encoder);
    c.scale = 1.0 / mesh->unit;
    for (a = 0; a < 3; a++) c.local_eye[a] = (c.frame.eye[a] - mesh->origin[a]) * c.scale;
    c.tiles = c.tiles_x * ((image->height + TETCASTI_TILE - 1) / TETCASTI_TILE);
    strands = tetcasti_thread_count(&d.env);
    if (strands > c.tiles) strands = c.tiles;
    if (d.method == TETCAST_METHOD_AUTO && mesh->tet != NULL && mesh->cell_count <= TETCASTI_FEW_CELLS &&
        image->width <= TETCASTI_WALK_SIZE && image->height <= TETCASTI_WALK_SIZE) {
        tetcasti_render_view(&c);
        c.pixels_per_cell = tetcasti_view_measure(&c.view);
        /* surfaces, values per cell, masks, depths: projection has no lanes for them and takes four times as long */
        if (c.pixels_per_cell > TETCASTI_PROJECT_FROM && !c.scene.any) d.method = TETCAST_METHOD_PROJECT;
    }
    if (d.method == TETCAST_METHOD_PROJECT) {
        int hide = !d.no_leaping && image->length == NULL && image->steps == NULL;
        if (mesh->tet == NULL)
            return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, 0, "render: projection needs the tets");
        if (image->width > TETCASTI_WALK_SIZE || image->height > TETCASTI_WALK_SIZE)
            return tetcasti_fail(d.env.error, TETCAST_ERR_RANGE, image->width, "render: too large for projection");
        c.projected = 1;
        tetcasti_render_view(&c);
        if (!tetcasti_view_open(&c.mem, &d.env, hide, &c.view)) c.failed = 1;
        else tetcasti_parallel_for(&d.env, tetcasti_task_paint, &c, strands);
        tetcasti_view_close(&c.mem, &c.view);
        return tetcasti_render_end(&c, !c.failed, stats);
    }
    if (!c.frame.parallel) {
        tetcasti_batch *b = tetcasti_batch_open(&c.mem);
        if (b == NULL) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "render: out of memory");
        tetcasti_locate(&c.scene, b, c.local_eye, &c.inside);
        c.failed = b->failed;
        tetcasti_batch_close(b);
    }
    c.leap.mem = &c.mem;
    if (!d.no_leaping && image->length == NULL && image->steps == NULL &&
        tetcasti_leap_open(&c.scene, &d.env, &c.leap)) {
        if (c.inside.known && tetcasti_bit(c.scene.stop, c.inside.start.cell >> c.scene.stop_log))
            c.inside.known = 0;
        c.leapt = c.leap.hull.face_count;
    }
    tetcasti_parallel_for(&d.env, tetcasti_task_tiles, &c, strands);
    tetcasti_leap_close(&c.leap);
    return tetcasti_render_end(&c, !c.failed, stats);
}

/* ---- single rays ---- */

/* A ray of the caller in local coordinates; 0 when it is none. */
static int tetcasti_ray_local(const tetcast_mesh *mesh, const tetcast_ray *ray, double o[3], double d[3],
                              double ends[2]) {
    double scale = 1.0 / mesh->unit;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        o[a] = (ray->org[a] - mesh->origin[a]) * scale;
        d[a] = ray->dir[a];
    }
    ends[0] = ray->t_min * scale;
    ends[1] = ray->t_max * scale;
    if (ray->t_min == 0.0 && ray->t_max == 0.0) ends[1] = (double)TETCASTI_INF;
    return tetcasti_unit(d) && tetcasti_finite(o[0] + o[1] + o[2]) && ends[0] == ends[0] && ends[1] == ends[1];
}

typedef struct tetcasti_cast {
    tetcasti_scene scene;
    tetcasti_mem mem;
    const tetcast_ray *rays;
    tetcast_ray_result *results;
    size_t count;
    uint32_t next, failed, batches;
    uint32_t tally[7][2];
} tetcasti_cast;

static void tetcasti_task_cast(void *ctx, uint32_t strand) {
    tetcasti_cast *c = (tetcasti_cast *)ctx;
    tetcasti_batch *b = tetcasti_batch_open(&c->mem);
    (void)strand;
    if (b == NULL) {
        tetcasti_atomic_store(&c->failed, 1u);
        return;
    }
    for (;;) {
        uint32_t k = tetcasti_atomic_add(&c->next, 1u) - 1u, i;
        size_t first = (size_t)k * TETCASTI_BATCH;
        if (k >= c->batches || tetcasti_atomic_load(&c->failed)) break;
        b->count = c->count - first < TETCASTI_BATCH ? (uint32_t)(c->count - first) : TETCASTI_BATCH;
        tetcasti_batch_begin(&c->scene, b);
        for (i = 0; i < b->count; i++) {
            double o[3], d[3], ends[2];
            if (!tetcasti_ray_local(c->scene.mesh, &c->rays[first + i], o, d, ends)) d[0] = d[1] = d[2] = 0.0;
            tetcasti_batch_put(&c->scene, b, i, o, d, ends[0], ends[1]);
            tetcasti_line_hits(&c->scene, b, i);
        }
        tetcasti_batch_run(&c->scene, b);
        if (b->failed) {
            tetcasti_atomic_store(&c->failed, 1u);
            break;
        }
        for (i = 0; i < b->count; i++) {
            tetcast_ray_result *out = &c->results[first + i];
            memset(out, 0, sizeof *out);
            out->hit = TETCASTI_INF;
            if (b->group[i] == TETCASTI_NO_RAY) continue;
            if (b->depth[i] < TETCASTI_INF) out->hit = b->depth[i];
            if (c->scene.optics != NULL) tetcasti_ray_finish(c->scene.optics, &b->sum[i], out->rgba);
            out->length = b->length[i] * c->scene.unit;
            out->steps = b->steps[i];
            out->walks = b->walks[i];
        }
        tetcasti_tally_add(c->tally[0], b->count);
        tetcasti_batch_tally(b, c->tally);
    }
    tetcasti_batch_close(b);
}

TETCAST_DEF tetcast_result tetcast_cast(const tetcast_render_desc *desc, const tetcast_mesh *mesh,
                                        const tetcast_optics *optics, const tetcast_ray *rays, size_t count,
                                        tetcast_ray_result *results, tetcast_render_stats *stats) {
    tetcast_render_desc d;
    tetcasti_cast c;
    tetcast_result r;
    uint32_t strands;
    memset(&c, 0, sizeof c);
    r = tetcasti_desc_open(desc, &d, &c.mem);
    if (r != TETCAST_OK) return r;
    if (mesh == NULL || (count != 0 && (rays == NULL || results == NULL))) return TETCAST_ERR_INVALID_ARG;
    if (count / TETCASTI_BATCH >= 0x7fffffffu) return TETCAST_ERR_RANGE;
    r = tetcasti_scene_open(&d, mesh, d.traverse_only ? NULL : optics, &c.scene);
    if (r != TETCAST_OK) return tetcasti_fail(d.env.error, r, 0, "cast: bad option");
    c.rays = rays;
    c.results = results;
    c.count = count;
    c.batches = (uint32_t)((count + TETCASTI_BATCH - 1) / TETCASTI_BATCH);
    strands = tetcasti_thread_count(&d.env);
    if (strands > c.batches) strands = c.batches;
    tetcasti_parallel_for(&d.env, tetcasti_task_cast, &c, strands);
    if (c.failed) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "cast: out of memory");
    tetcasti_stats_add(stats, c.tally, &c.scene);
    return TETCAST_OK;
}

TETCAST_DEF uint64_t tetcast_probe(const tetcast_mesh *mesh, const tetcast_ray *ray,
                                   int (*fn)(void *user, const tetcast_crossing *crossing), void *user) {
    tetcast_render_desc d;
    tetcasti_scene scene;
    tetcasti_mem mem;
    tetcasti_batch *b;
    tetcasti_ray r;
    double o[3], dir[3], ends[2], unit;
    uint64_t n = 0;
    uint32_t k;
    float cursor, last;
    int over = 0;
    if (mesh == NULL || ray == NULL || fn == NULL || !tetcasti_ray_local(mesh, ray, o, dir, ends)) return 0;
    if (tetcasti_desc_open(NULL, &d, &mem) != TETCAST_OK) return 0;
    mem.allocator = mesh->mem.allocator;
    (void)tetcasti_scene_open(&d, mesh, NULL, &scene);
    b = tetcasti_batch_open(&mem);
    if (b == NULL) return 0;
    b->count = 1;
    tetcasti_batch_begin(&scene, b);
    tetcasti_batch_put(&scene, b, 0, o, dir, ends[0], ends[1]);
    tetcasti_line_hits(&scene, b, 0);
    tetcasti_batch_sort(b);
    r = tetcasti_batch_ray(b, 0);
    cursor = b->cursor[0];
    last = b->last[0];
    unit = mesh->unit;
    for (k = 0; k < b->hit_start[1] && !over && b->sorted[k].at < last; k++) {
        tetcasti_start start = tetcasti_hit_start(&scene, b, &b->sorted[k]);
        tetcasti_walk w;
        tetcasti_walk_begin(&r, scene.vertex, &start, &w);
        if (w.at_face > cursor) cursor = w.at_face;
        while (!over && w.cell != TETCASTI_NONE) {
            float at, s;
            tetcasti_walk_step_any(scene.cells, &r, scene.vertex, &w, &at, &s);
            if (at >= cursor) {
                tetcast_crossing x;
                float end = at < last ? at : last;
                x.cell = tetcasti_cell_number(scene.cells, w.prev);
                x.front = w.s_face;
                x.back = s;
                if (w.at_face < cursor) x.front += (s - w.s_face) * ((cursor - w.at_face) / (at - w.at_face));
                if (at > last) x.back = w.s_face + (s - w.s_face) * ((last - w.at_face) / (at - w.at_face));
                if (mesh->cell_value != NULL) x.front = x.back = mesh->cell_value[x.cell];
                x.t_front = ((double)b->offset[0] + (double)cursor) * unit;
                x.t_back = ((double)b->offset[0] + (double)end) * unit;
                cursor = end;
                n++;
                over = fn(user, &x) != 0 || at > last;
            }
            w.at_face = at;
            w.s_face = s;
        }
    }
    tetcasti_batch_close(b);
    return n;
}
#ifndef TETCAST_NO_BRICKS
/* ---------------------------------------------------------------------------
   resample: tetrahedra -> nodes of a lattice; planes through the mesh.          // >>resample

   Everything about a cell is in lattice units, relative to the lowest node of its box (which the lattice clips, but no
   task does: so the bits do not depend on how the work is cut).
   row    the nodes of the box along one axis, the longest side: there are fewest of them then
   face   e(x) = n . (x - a) >= -eps is inside; n = (b - a) x (c - a) with a, b, c in the order of their numbers, so that
          both cells at a face have the same n but for the sign, which is exact
   span   along a row each face gives t = p . place: the row is inside between the largest t of faces that it enters
          through and the smallest of those that it leaves through. Four rows at a time.
   value  s = s0 + g . x, in double where a row begins, then one multiplication and one addition a node in float; never
          beyond the four values of the vertices, whatever the shape of the cell.
   The thesis (chapter 7, equations 7.3 to 7.5) corrects both ends of each row of the box by the barycentric coordinates
   there, and adds along rows and from row to row; sums drift, and three of its four divisions a row are multiplications
   here. Tried: planes in float with a second look at nodes near to faces: no faster, setting up is what takes the time.
   --------------------------------------------------------------------------- */

#define TETCASTI_LATTICE_END (1u << 20)
#define TETCASTI_SCAN_EPS 5.7e-14   /* 2^-44 */

typedef struct tetcasti_scan {
    const tetcast_mesh *mesh;
    double scale[3], shift[3];      /* lattice = local * scale + shift */
    int32_t dims[3];
    int32_t lo[3], hi[3];           /* the nodes that are filled, lo <= node < hi */
    float *out;                     /* of node lo */
    ptrdiff_t stride[3];
    uint32_t axis;                  /* 0, 1, 2; 3: the longest */
    double grow;                    /* > 0: cells reach that many spacings beyond their faces, and only NaNs change */
    const uint32_t *list;           /* cells; NULL: all */
    uint32_t count, wide;           /* wide: four rows at a time */
    uint64_t cells, flat, rows, hit_rows, writes;
} tetcasti_scan;

/* A cell that is ready to be painted. */
typedef struct tetcasti_scan_cell {
    double t[4][4];      /* of each face: t = t[0] + t[1] * first + t[2] * second; kind in t[3]: 1 enter, -1 leave,
                            0 the row is parallel to it: inside where t >= 0 */
    double s[4];         /* value at the lowest node, along first, second, the row */
    int32_t lo[3], size[3]; /* box of nodes */
    float least, most;
    uint32_t axis, first, second;
} tetcasti_scan_cell;

static int tetcasti_lattice_good(const tetcast_lattice *l) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        if (l->dims[a] == 0 || l->dims[a] > TETCASTI_LATTICE_END || !tetcasti_finite(l->origin[a])) return 0;
        if (!(l->spacing[a] > 0.0) || !tetcasti_finite(l->spacing[a])) return 0;
    }
    return 1;
}

/* Box of nodes of a cell, inside of the lattice; 0: there is none. The four vertices in the order of their numbers. */
TETCASTI_INLINE int tetcasti_scan_box(const tetcasti_scan *c, uint32_t cell, double p[4][3], float s[4],
                                      tetcasti_scan_cell *out) {
    uint32_t t[4], a, i;
    memcpy(t, c->mesh->tet[cell], sizeof t);
    for (i = 0; i < 3; i++) { /* a sorting network would do with five; three passes are clear and short */
        for (a = 0; a + 1 < 4 - i; a++) {
            const uint32_t lower = t[a] < t[a + 1] ? t[a] : t[a + 1], upper = t[a] < t[a + 1] ? t[a + 1] : t[a];
            t[a] = lower;
            t[a + 1] = upper;
        }
    }
    for (i = 0; i < 4; i++) {
        const tetcasti_vertex *v = &c->mesh->vertex[t[i]];
        p[i][0] = (double)v->x * c->scale[0] + c->shift[0];
        p[i][1] = (double)v->y * c->scale[1] + c->shift[1];
        p[i][2] = (double)v->z * c->scale[2] + c->shift[2];
        s[i] = v->s;
    }
    for (a = 0; a < 3; a++) {
        double lo = tetcasti_min(tetcasti_min(p[0][a], p[1][a]), tetcasti_min(p[2][a], p[3][a])) - c->grow;
        double hi = tetcasti_max(tetcasti_max(p[0][a], p[1][a]), tetcasti_max(p[2][a], p[3][a])) + c->grow;
        const double slack = (hi - lo) * TETCASTI_SCAN_EPS + 1e-12;
        int32_t first, last;
        lo -= slack;
        hi += slack;
        if (!(hi >= 0.0) || !(lo <= (double)(c->dims[a] - 1))) return 0;
        first = lo <= 0.0 ? 0 : (int32_t)lo + ((double)(int32_t)lo < lo);
        last = hi >= (double)(c->dims[a] - 1) ? c->dims[a] - 1 : (int32_t)hi;
        if (first > last || first >= c->hi[a] || last < c->lo[a]) return 0;
        out->lo[a] = first;
        out->size[a] = last - first + 1;
    }
    return 1;
}

/* Vertices of face i in order, opposite to vertex i. */
static const uint8_t tetcasti_scan_face[4][3] = {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}};

/* 0: the cell has no volume. */
TETCASTI_INLINE int tetcasti_scan_set(const tetcasti_scan *c, uint32_t cell, const double p[4][3], const float s[4],
                                      tetcasti_scan_cell *out) {
    double g[3] = {0.0, 0.0, 0.0};
    uint32_t i, a = c->axis, first, second;
    if (a > 2) {
        a = out->size[1] > out->size[0] ? 1 : 0;
        if (out->size[2] > out->size[a]) a = 2;
    }
    first = a == 0 ? 1 : 0;
    second = a == 2 ? 1 : 2;
    out->axis = a;
    out->first = first;
    out->second = second;
    for (i = 0; i < 4; i++) {
        const double *o = p[tetcasti_scan_face[i][0]], *q = p[tetcasti_scan_face[i][1]], *r = p[tetcasti_scan_face[i][2]];
        const double u0 = q[0] - o[0], u1 = q[1] - o[1], u2 = q[2] - o[2];
        const double v0 = r[0] - o[0], v1 = r[1] - o[1], v2 = r[2] - o[2];
        double n[3], d, side, eps, inv;
        n[0] = u1 * v2 - u2 * v1;
        n[1] = u2 * v0 - u0 * v2;
        n[2] = u0 * v1 - u1 * v0;
        side = (n[0] * (p[i][0] - o[0]) + n[1] * (p[i][1] - o[1])) + n[2] * (p[i][2] - o[2]);
        if (side == 0.0) return 0;
        if (side < 0.0) {
            n[0] = -n[0];
            n[1] = -n[1];
            n[2] = -n[2];
            side = -side;
        }
        d = (n[0] * ((double)out->lo[0] - o[0]) + n[1] * ((double)out->lo[1] - o[1])) +
            n[2] * ((double)out->lo[2] - o[2]);
        eps = ((tetcasti_abs(n[0]) * (double)(out->size[0] + 1) + tetcasti_abs(n[1]) * (double)(out->size[1] + 1)) +
               tetcasti_abs(n[2]) * (double)(out->size[2] + 1)) * TETCASTI_SCAN_EPS;
        if (c->grow > 0.0) eps += ((tetcasti_abs(n[0]) + tetcasti_abs(n[1])) + tetcasti_abs(n[2])) * c->grow;
        d += eps;
        if (i != 0) {
            const double w = ((double)s[i] - (double)s[0]) / side;
            g[0] += n[0] * w;
            g[1] += n[1] * w;
            g[2] += n[2] * w;
        }
        if (tetcasti_abs(n[a]) * (double)out->size[a] <= eps * 1e-3) { /* parallel */
            out->t[i][0] = d;
            out->t[i][1] = n[first];
            out->t[i][2] = n[second];
            out->t[i][3] = 0.0;
        } else {
            inv = -1.0 / n[a];
            out->t[i][0] = d * inv;
            out->t[i][1] = n[first] * inv;
            out->t[i][2] = n[second] * inv;
            out->t[i][3] = n[a] > 0.0 ? 1.0 : -1.0;
        }
    }
    out->least = s[0] < s[1] ? s[0] : s[1];
    out->most = s[0] > s[1] ? s[0] : s[1];
    for (i = 2; i < 4; i++) {
        out->least = s[i] < out->least ? s[i] : out->least;
        out->most = s[i] > out->most ? s[i] : out->most;
    }
    if (c->mesh->cell_value != NULL) {
        out->least = out->most = c->mesh->cell_value[cell];
        g[0] = g[1] = g[2] = 0.0;
    }
    if (c->grow > 0.0) { /* a cell of bad shape may have any gradient */
        const float range = 16.0f * (out->most - out->least);
        out->least -= range;
        out->most += range;
    }
    out->s[0] = (double)s[0] + ((g[0] * ((double)out->lo[0] - p[0][0]) + g[1] * ((double)out->lo[1] - p[0][1])) +
                                g[2] * ((double)out->lo[2] - p[0][2]));
    if (!tetcasti_finite(out->s[0]) || !tetcasti_finite(g[0] + g[1] + g[2])) {
        out->s[0] = 0.5 * ((double)out->least + (double)out->most);
        g[0] = g[1] = g[2] = 0.0;
    }
    out->s[1] = g[first];
    out->s[2] = g[second];
    out->s[3] = g[a];
    return 1;
}

/* Nodes from .. to of a row, as far as the task goes. */
TETCASTI_INLINE void tetcasti_scan_fill(const tetcasti_scan *c, const tetcasti_scan_cell *t, int32_t x, int32_t y,
                                        int32_t from, int32_t to, float *row) {
    const uint32_t a = t->axis;
    const float start = (float)(((t->s[0] + t->s[1] * (double)x) + t->s[2] * (double)y) + t->s[3] * (double)from);
    const float step = (float)t->s[3], least = t->least, most = t->most;
    const ptrdiff_t stride = c->stride[a];
    const int32_t base = t->lo[a] + from, low = c->lo[a] - base, high = c->hi[a] - base;
    int32_t k = low > 0 ? low : 0, n = to - from + 1;
    float *p;
    if (n > high) n = high;
    p = row + stride * ((ptrdiff_t)(base - c->lo[a]) + (ptrdiff_t)k);
    for (; k < n; k++, p += stride) {
        float v = start + (float)k * step;
        v = v > least ? v : least;
        v = v < most ? v : most;
        if (c->grow > 0.0 && *p == *p) continue;
        *p = v;
    }
}

/* The span of a row: 0 when it is empty. */
TETCASTI_INLINE int tetcasti_scan_span(const tetcasti_scan_cell *t, int32_t x, int32_t y, int32_t *from, int32_t *to) {
    double lo = 0.0, hi = (double)(t->size[t->axis] - 1);
    uint32_t i;
    for (i = 0; i < 4; i++) {
        const double at = (t->t[i][0] + t->t[i][2] * (double)y) + t->t[i][1] * (double)x;
        if (t->t[i][3] > 0.0) lo = at > lo ? at : lo;
        else if (t->t[i][3] < 0.0) hi = at < hi ? at : hi;
        else if (at < 0.0) return 0;
    }
    if (!(lo <= hi)) return 0;
    *from = (int32_t)lo;
    *from += (double)*from < lo;
    *to = (int32_t)hi;
    return *from <= *to;
}

/* First and one past the last row of a cell that the task has a share in. */
TETCASTI_INLINE void tetcasti_scan_rows(const tetcasti_scan *c, const tetcasti_scan_cell *t, uint32_t axis,
                                        int32_t *from, int32_t *to) {
    *from = c->lo[axis] > t->lo[axis] ? c->lo[axis] - t->lo[axis] : 0;
    *to = c->hi[axis] - t->lo[axis];
    if (*to > t->size[axis]) *to = t->size[axis];
}

static void tetcasti_scan_paint(tetcasti_scan *c, const tetcasti_scan_cell *t) {
    int32_t x0, x1, y0, y1, x, y, from, to;
    tetcasti_scan_rows(c, t, t->first, &x0, &x1);
    tetcasti_scan_rows(c, t, t->second, &y0, &y1);
    for (y = y0; y < y1; y++) {
        float *row = c->out + c->stride[t->second] * (ptrdiff_t)(t->lo[t->second] + y - c->lo[t->second]);
        for (x = x0; x < x1; x++) {
            if (!tetcasti_scan_span(t, x, y, &from, &to)) continue;
            c->hit_rows++;
            c->writes += (uint64_t)(to - from + 1);
            tetcasti_scan_fill(c, t, x, y, from, to,
                               row + c->stride[t->first] * (ptrdiff_t)(t->lo[t->first] + x - c->lo[t->first]));
        }
    }
    c->rows += (uint64_t)(x1 - x0) * (uint64_t)(y1 - y0);
}

#if TETCASTI_AVX2
/* Eight nodes at a time where they lie side by side; the same numbers as above. */
TETCASTI_TARGET_AVX2 static inline void tetcasti_scan_fill8(const tetcasti_scan *c, const tetcasti_scan_cell *t,
                                                            float start, int32_t from, int32_t to, float *row) {
    const __m256 step = _mm256_set1_ps((float)t->s[3]), first = _mm256_set1_ps(start);
    const __m256 least = _mm256_set1_ps(t->least), most = _mm256_set1_ps(t->most);
    const __m256i iota = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const int32_t base = t->lo[0] + from, low = c->lo[0] - base, high = c->hi[0] - base;
    int32_t k = low > 0 ? low : 0, n = to - from + 1;
    float *p;
    if (n > high) n = high;
    p = row + (base - c->lo[0]) + k;
    for (; k < n; k += 8, p += 8) {
        const __m256i place = _mm256_add_epi32(_mm256_set1_epi32(k), iota);
        __m256 v = _mm256_add_ps(first, _mm256_mul_ps(_mm256_cvtepi32_ps(place), step));
        v = _mm256_min_ps(_mm256_max_ps(v, least), most);
        if (k + 8 <= n) _mm256_storeu_ps(p, v);
        else _mm256_maskstore_ps(p, _mm256_cmpgt_epi32(_mm256_set1_epi32(n), place), v);
    }
}

TETCASTI_TARGET_AVX2 static void tetcasti_scan_paint4(tetcasti_scan *c, const tetcasti_scan_cell *t) {
    const uint32_t axis = t->axis;
    const __m256d zero = _mm256_setzero_pd(), most = _mm256_set1_pd((double)(t->size[axis] - 1));
    const __m256d slope = _mm256_set1_pd(t->s[1]), along = _mm256_set1_pd(t->s[3]);
    int32_t x0, x1, y0, y1, x, y, from[4], to[4];
    float start[4];
    tetcasti_scan_rows(c, t, t->first, &x0, &x1);
    tetcasti_scan_rows(c, t, t->second, &y0, &y1);
    for (y = y0; y < y1; y++) {
        float *row = c->out + c->stride[t->second] * (ptrdiff_t)(t->lo[t->second] + y - c->lo[t->second]);
        __m256d place = _mm256_add_pd(_mm256_set1_pd((double)x0), _mm256_setr_pd(0.0, 1.0, 2.0, 3.0));
        double at[4];
        uint32_t i;
        for (i = 0; i < 4; i++) at[i] = t->t[i][0] + t->t[i][2] * (double)y;
        for (x = x0; x < x1; x += 4, place = _mm256_add_pd(place, _mm256_set1_pd(4.0))) {
            __m256d lo = zero, hi = most, miss = zero;
            __m128i a, b;
            uint32_t live;
            for (i = 0; i < 4; i++) {
                const __m256d v = _mm256_add_pd(_mm256_set1_pd(at[i]), _mm256_mul_pd(_mm256_set1_pd(t->t[i][1]), place));
                if (t->t[i][3] > 0.0) lo = _mm256_max_pd(v, lo);
                else if (t->t[i][3] < 0.0) hi = _mm256_min_pd(v, hi);
                else miss = _mm256_or_pd(miss, _mm256_cmp_pd(v, zero, _CMP_LT_OQ));
            }
            lo = _mm256_ceil_pd(lo);
            hi = _mm256_floor_pd(hi);
            live = (uint32_t)_mm256_movemask_pd(_mm256_andnot_pd(miss, _mm256_cmp_pd(lo, hi, _CMP_LE_OQ)));
            if (x + 4 > x1) live &= (1u << (uint32_t)(x1 - x)) - 1u;
            if (live == 0) continue;
            lo = _mm256_min_pd(lo, most);
            hi = _mm256_max_pd(hi, zero);
            a = _mm256_cvttpd_epi32(lo);
            b = _mm256_cvttpd_epi32(hi);
            _mm_storeu_si128((__m128i *)(void *)from, a);
            _mm_storeu_si128((__m128i *)(void *)to, b);
            _mm_storeu_ps(start, _mm256_cvtpd_ps(_mm256_add_pd(
                _mm256_add_pd(_mm256_add_pd(_mm256_set1_pd(t->s[0]), _mm256_mul_pd(slope, place)),
                              _mm256_set1_pd(t->s[2] * (double)y)), _mm256_mul_pd(along, _mm256_cvtepi32_pd(a)))));
            for (; live != 0; live &= live - 1) {
                const uint32_t k = tetcasti_ctz64(live);
                float *p = row + c->stride[t->first] * (ptrdiff_t)(t->lo[t->first] + x + (int32_t)k - c->lo[t->first]);
                c->hit_rows++;
                c->writes += (uint64_t)(to[k] - from[k] + 1);
                if (axis == 0) tetcasti_scan_fill8(c, t, start[k], from[k], to[k], p);
                else tetcasti_scan_fill(c, t, x + (int32_t)k, y, from[k], to[k], p);
            }
        }
    }
    c->rows += (uint64_t)(x1 - x0) * (uint64_t)(y1 - y0);
}
#endif

/* Paint all cells of a scan. */
static void tetcasti_scan_run(tetcasti_scan *c) {
    uint32_t i;
    for (i = 0; i < c->count; i++) {
        const uint32_t cell = c->list != NULL ? c->list[i] : i;
        tetcasti_scan_cell t;
        double p[4][3];
        float s[4];
        if (c->mesh->hidden != NULL && (c->mesh->hidden[cell >> 5] >> (cell & 31u) & 1u)) continue;
        if (!tetcasti_scan_box(c, cell, p, s, &t)) continue;
        c->cells++;
        if (!tetcasti_scan_set(c, cell, (const double (*)[3])p, s, &t)) {
            c->flat++;
            continue;
        }
#if TETCASTI_AVX2
        if (c->wide && !(c->grow > 0.0)) {
            tetcasti_scan_paint4(c, &t);
            continue;
        }
#endif
        tetcasti_scan_paint(c, &t);
    }
}

/* ---- lattices over the threads ---- */

typedef struct tetcasti_resample {
    tetcasti_scan scan;             /* what tasks copy */
    uint32_t *first, *list;         /* cells of each slab of layers along z; NULL: one slab, all cells */
    uint32_t *hull, hull_count;     /* cells at the hull, for extending */
    int32_t layers;                 /* of a slab */
    uint32_t slabs, extend;
    float fill;
    tetcast_resample_stats *stats;  /* NULL: nobody counts */
    uint32_t tally[7][2];
} tetcasti_resample;

static void tetcasti_scan_open(tetcasti_scan *c, const tetcast_mesh *mesh, const tetcast_lattice *l) {
    uint32_t a;
    memset(c, 0, sizeof *c);
    c->mesh = mesh;
    c->axis = 3;
    c->count = mesh->cell_count;
    for (a = 0; a < 3; a++) {
        c->scale[a] = mesh->unit / l->spacing[a];
        c->shift[a] = (mesh->origin[a] - l->origin[a]) / l->spacing[a];
        c->dims[a] = c->hi[a] = (int32_t)l->dims[a];
        c->stride[a] = a == 0 ? 1 : c->stride[a - 1] * (ptrdiff_t)l->dims[a - 1];
    }
}

static void tetcasti_task_resample(void *ctx, uint32_t slab) {
    tetcasti_resample *r = (tetcasti_resample *)ctx;
    tetcasti_scan c = r->scan;
    const size_t layer = (size_t)c.stride[2];
    size_t i, n;
    uint64_t counts[7];
    uint32_t k;
    c.lo[2] = (int32_t)slab * r->layers;
    c.hi[2] = c.dims[2] - c.lo[2] < r->layers ? c.dims[2] : c.lo[2] + r->layers;
    c.out += layer * (size_t)c.lo[2];
    n = layer * (size_t)(c.hi[2] - c.lo[2]);
    for (i = 0; i < n; i++) c.out[i] = (float)NAN;
    if (r->list != NULL) {
        c.list = r->list + r->first[slab];
        c.count = r->first[slab + 1] - r->first[slab];
    }
    tetcasti_scan_run(&c);
    memset(counts, 0, sizeof counts);
    counts[0] = c.cells;
    counts[1] = c.flat;
    counts[2] = c.rows;
    counts[3] = c.hit_rows;
    counts[4] = c.writes;
    if (r->stats != NULL)
        for (i = 0; i < n; i++) counts[5] += c.out[i] == c.out[i];
    if (r->extend) { /* the nearer half of a spacing first: where cells disagree the nearer one counts */
        c.list = r->hull;
        c.count = r->hull_count;
        for (k = 1; k <= 2; k++) {
            c.grow = 0.5 * (double)k;
            tetcasti_scan_run(&c);
        }
        if (r->stats != NULL)
            for (i = 0; i < n; i++) counts[6] += c.out[i] == c.out[i];
        counts[6] -= counts[5];
    }
    if (r->fill == r->fill)
        for (i = 0; i < n; i++) c.out[i] = c.out[i] == c.out[i] ? c.out[i] : r->fill;
    if (r->stats != NULL)
        for (k = 0; k < 7; k++) tetcasti_tally_add(r->tally[k], counts[k]);
}

/* Cells at the hull: faces of the hull are in the order of their cells. NULL: no memory. */
static uint32_t *tetcasti_hull_cells(tetcasti_mem *mem, const tetcast_mesh *mesh, uint32_t *count) {
    uint32_t *list = (uint32_t *)tetcasti_alloc_array(mem, (size_t)mesh->face_count + 1, sizeof *list), i, n = 0;
    *count = 0;
    if (list == NULL) return NULL;
    for (i = 0; i < mesh->face_count; i++)
        if (n == 0 || mesh->face[i].cell != list[n - 1]) list[n++] = mesh->face[i].cell;
    *count = n;
    return list;
}

/* Cells of each slab, in order; a cell is in all slabs that its box touches. 0: no memory. */
static int tetcasti_resample_bin(tetcasti_mem *mem, tetcasti_resample *r) {
    const tetcasti_scan *c = &r->scan;
    const tetcast_mesh *mesh = c->mesh;
    const double per = 1.0 / (double)r->layers, last = (double)r->slabs - 1.0;
    uint32_t pass, i, k;
    r->first = (uint32_t *)tetcasti_alloc_zero(mem, (size_t)r->slabs + 2, sizeof *r->first);
    if (r->first == NULL) return 0;
    for (pass = 0; pass < 2; pass++) {
        for (i = 0; i < mesh->cell_count; i++) {
            const uint32_t *t = mesh->tet[i];
            double lo = (double)mesh->vertex[t[0]].z, hi = lo;
            uint32_t from, to;
            for (k = 1; k < 4; k++) {
                lo = tetcasti_min(lo, (double)mesh->vertex[t[k]].z);
                hi = tetcasti_max(hi, (double)mesh->vertex[t[k]].z);
            }
            lo = (lo * c->scale[2] + c->shift[2] - 0.001) * per;
            hi = (hi * c->scale[2] + c->shift[2] + 0.001) * per;
            if (!(hi >= 0.0) || !(lo < last + 1.0)) continue;
            from = lo > 0.0 ? (uint32_t)lo : 0;
            to = hi < last ? (uint32_t)hi : r->slabs - 1;
            for (k = from; k <= to; k++) {
                if (pass == 0) r->first[k + 2]++;
                else r->list[r->first[k + 1]++] = i;
            }
        }
        if (pass == 0) {
            for (k = 2; k <= r->slabs; k++) {
                if (r->first[k + 1] > 0xffffffffu - r->first[k]) return 0;
                r->first[k + 1] += r->first[k];
            }
            r->list = (uint32_t *)tetcasti_alloc_array(mem, (size_t)r->first[r->slabs + 1] + 1, sizeof *r->list);
            if (r->list == NULL) return 0;
        }
    }
    return 1;
}

TETCAST_DEF tetcast_result tetcast_lattice_fit(const tetcast_mesh *mesh, uint32_t longest, tetcast_lattice *out) {
    double size[3], most = 0.0;
    uint32_t a;
    if (out != NULL) memset(out, 0, sizeof *out);
    if (mesh == NULL || out == NULL || longest < 2 || longest > TETCASTI_LATTICE_END) return TETCAST_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++) {
        size[a] = ((double)mesh->box.hi[a] - (double)mesh->box.lo[a]) * mesh->unit;
        most = tetcasti_max(most, size[a]);
    }
    if (!(most > 0.0)) return TETCAST_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++) {
        const double cells = size[a] / most * (double)(longest - 1);
        out->spacing[a] = most / (double)(longest - 1);
        out->origin[a] = mesh->origin[a] + (double)mesh->box.lo[a] * mesh->unit;
        out->dims[a] = (uint32_t)(cells - 1e-6 > 0.0 ? cells - 1e-6 : 0.0) + 2;
        if (out->dims[a] > longest) out->dims[a] = longest;
    }
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_resample(const tetcast_resample_desc *desc, const tetcast_mesh *mesh,
                                            const tetcast_lattice *lattice, float *out, tetcast_resample_stats *stats) {
    tetcast_resample_desc d;
    tetcasti_resample r;
    tetcasti_mem mem;
    tetcast_result result;
    size_t nodes;
    uint32_t threads;
    memset(&d, 0, sizeof d);
    memset(&r, 0, sizeof r);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    result = tetcasti_env_open(&d.env, &mem);
    if (result != TETCAST_OK) return result;
    if (mesh == NULL || lattice == NULL || out == NULL || d.axis > 3 || (uint32_t)d.isa > TETCAST_ISA_AVX512)
        return TETCAST_ERR_INVALID_ARG;
    if (mesh->tet == NULL) return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, 0, "resample: needs the tets");
    if (!tetcasti_lattice_good(lattice))
        return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, 0, "resample: bad lattice");
    if (!tetcasti_mul_size(lattice->dims[0], lattice->dims[1], &nodes) ||
        !tetcasti_mul_size(nodes, lattice->dims[2], &nodes) || nodes > (size_t)-1 / 8)
        return tetcasti_fail(d.env.error, TETCAST_ERR_RANGE, 0, "resample: the lattice is too large");
    tetcasti_scan_open(&r.scan, mesh, lattice);
    r.scan.out = out;
    r.scan.axis = d.axis == 0 ? 3 : d.axis - 1;
    r.scan.wide = tetcast_isa_best() >= TETCAST_ISA_AVX2 && (d.isa == TETCAST_ISA_AUTO || d.isa >= TETCAST_ISA_AVX2);
    r.extend = d.extend;
    r.fill = d.use_fill ? d.fill : (float)NAN;
    r.stats = stats;
    threads = tetcasti_thread_count(&d.env);
    r.slabs = threads == 1 && d.env.parallel.for_fn == NULL ? 1 : 4 * threads;
    if (r.slabs > lattice->dims[2]) r.slabs = lattice->dims[2];
    r.layers = (int32_t)((lattice->dims[2] + r.slabs - 1) / r.slabs);
    r.slabs = (lattice->dims[2] + (uint32_t)r.layers - 1) / (uint32_t)r.layers;
    if (r.extend) r.hull = tetcasti_hull_cells(&mem, mesh, &r.hull_count);
    if ((r.extend && r.hull == NULL) || (r.slabs > 1 && !tetcasti_resample_bin(&mem, &r)))
        result = tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "resample: out of memory");
    if (result == TETCAST_OK) tetcasti_parallel_for(&d.env, tetcasti_task_resample, &r, r.slabs);
    tetcasti_free(&mem, r.first);
    tetcasti_free(&mem, r.list);
    tetcasti_free(&mem, r.hull);
    if (result == TETCAST_OK && stats != NULL) {
        stats->cells += tetcasti_tally(r.tally[0]);
        stats->flat += tetcasti_tally(r.tally[1]);
        stats->rows += tetcasti_tally(r.tally[2]);
        stats->hit_rows += tetcasti_tally(r.tally[3]);
        stats->writes += tetcasti_tally(r.tally[4]);
        stats->covered += tetcasti_tally(r.tally[5]);
        stats->extended += tetcasti_tally(r.tally[6]);
    }
    return result;
}

/* ---- planes ---- */

/* A plane in local coordinates: height(p) = normal . (p - origin), and the inverse of its frame. 0: it is none. */
typedef struct tetcasti_plane {
    double origin[3], normal[3], u[3], v[3]; /* place on the plane: x = u . (p - origin), y = v . (p - origin) */
} tetcasti_plane;

static int tetcasti_plane_open(const tetcast_mesh *mesh, const tetcast_plane *plane, tetcasti_plane *out) {
    double length;
    uint32_t a;
    double un[3], vn[3];
    for (a = 0; a < 3; a++)
        if (!tetcasti_finite(plane->origin[a]) || !tetcasti_finite(plane->u[a]) || !tetcasti_finite(plane->v[a])) return 0;
    for (a = 0; a < 3; a++) {
        out->origin[a] = (plane->origin[a] - mesh->origin[a]) / mesh->unit;
        un[a] = plane->u[a] / mesh->unit;
        vn[a] = plane->v[a] / mesh->unit;
    }
    tetcasti_cross(un, vn, out->normal);
    length = out->normal[0] * out->normal[0] + out->normal[1] * out->normal[1] + out->normal[2] * out->normal[2];
    if (!(length > 0.0) || !tetcasti_finite(length)) return 0;
    tetcasti_cross(vn, out->normal, out->u);
    tetcasti_cross(out->normal, un, out->v);
    for (a = 0; a < 3; a++) {
        out->u[a] /= length;
        out->v[a] /= length;
        out->normal[a] /= sqrt(length);
    }
    return 1;
}

TETCASTI_INLINE double tetcasti_plane_height(const tetcasti_plane *f, const tetcasti_vertex *v) {
    return (f->normal[0] * ((double)v->x - f->origin[0]) + f->normal[1] * ((double)v->y - f->origin[1])) +
           f->normal[2] * ((double)v->z - f->origin[2]);
}

/* A section is a polygon with a linear function: each of its triangles is painted like a cell, one dimension lower. */
static void tetcasti_plane_paint(const double (*p)[2], const double *s, uint32_t n, uint32_t width, uint32_t height,
                                 float *out) {
    double lo[2], hi[2], g[2] = {0.0, 0.0}, best = 0.0, least = s[0], most = s[0];
    int32_t y, y0, y1;
    uint32_t i, a;
    for (a = 0; a < 2; a++) {
        lo[a] = hi[a] = p[0][a];
        for (i = 1; i < n; i++) {
            lo[a] = tetcasti_min(lo[a], p[i][a]);
            hi[a] = tetcasti_max(hi[a], p[i][a]);
        }
    }
    for (i = 0; i < n; i++) {
        least = tetcasti_min(least, s[i]);
        most = tetcasti_max(most, s[i]);
    }
    if (!(hi[0] >= 0.0 && hi[1] >= 0.0 && lo[0] <= (double)width && lo[1] <= (double)height)) return;
    for (i = 1; i + 1 < n; i++) { /* the gradient from the largest triangle */
        const double ux = p[i][0] - p[0][0], uy = p[i][1] - p[0][1], vx = p[i + 1][0] - p[0][0], vy = p[i + 1][1] - p[0][1];
        const double det = ux * vy - uy * vx;
        if (!(tetcasti_abs(det) > best)) continue;
        best = tetcasti_abs(det);
        g[0] = ((s[i] - s[0]) * vy - (s[i + 1] - s[0]) * uy) / det;
        g[1] = ((s[i + 1] - s[0]) * ux - (s[i] - s[0]) * vx) / det;
    }
    if (!(best > 0.0)) return;
    y0 = lo[1] > 0.5 ? (int32_t)(lo[1] - 0.5) : 0;
    y1 = hi[1] < (double)height ? (int32_t)hi[1] : (int32_t)height - 1;
    for (y = y0; y <= y1; y++) {
        const double py = (double)y + 0.5;
        double from = 1e300, to = -1e300, slack;
        int32_t x, x0, x1;
        for (i = 0; i < n; i++) { /* where the row meets the sides */
            const double *q = p[i], *r = p[i + 1 < n ? i + 1 : 0];
            const double *below = q[1] <= r[1] ? q : r, *above = q[1] <= r[1] ? r : q;
            double x_at;
            if (below[1] > py || above[1] < py) continue;
            if (below[1] == above[1]) {
                from = tetcasti_min(from, tetcasti_min(q[0], r[0]));
                to = tetcasti_max(to, tetcasti_max(q[0], r[0]));
                continue;
            }
            x_at = below[0] + (above[0] - below[0]) * ((py - below[1]) / (above[1] - below[1]));
            from = tetcasti_min(from, x_at);
            to = tetcasti_max(to, x_at);
        }
        slack = (tetcasti_abs(from) + tetcasti_abs(to)) * TETCASTI_SCAN_EPS;
        from = from - 0.5 - slack;
        to = to - 0.5 + slack;
        if (!(to >= 0.0 && from <= (double)(width - 1) && from <= to)) continue;
        x0 = from > 0.0 ? (int32_t)from + ((double)(int32_t)from < from) : 0;
        x1 = to < (double)(width - 1) ? (int32_t)to : (int32_t)width - 1;
        for (x = x0; x <= x1; x++) {
            double v = s[0] + g[0] * ((double)x + 0.5 - p[0][0]) + g[1] * (py - p[0][1]);
            v = v > least ? v : least;
            out[(size_t)y * width + (size_t)x] = (float)(v < most ? v : most);
        }
    }
}

/* Points of the polygon in which a plane at these heights cuts a cell, in order around it: the edges. 0, 3 or 4. */
TETCASTI_INLINE uint32_t tetcasti_section_edges(const double h[4], uint8_t edge[4][2]) {
    static const uint8_t around[4][2] = {{0, 0}, {0, 1}, {1, 1}, {1, 0}};
    uint8_t front[4], back[4];
    uint32_t i, nf = 0, nb = 0;
    for (i = 0; i < 4; i++) {
        if (h[i] > 0.0) front[nf++] = (uint8_t)i;
        else back[nb++] = (uint8_t)i;
    }
    if (nf == 0 || nb == 0) return 0;
    if (nf == 2) { /* front a, b; back c, d: ac, ad, bd, bc */
        for (i = 0; i < 4; i++) {
            edge[i][0] = front[around[i][0]];
            edge[i][1] = back[around[i][1]];
        }
        return 4;
    }
    for (i = 0; i < 3; i++) {
        edge[i][0] = nf == 1 ? front[0] : front[i];
        edge[i][1] = nf == 1 ? back[i] : back[0];
    }
    return 3;
}

/* Heights of all vertices over the plane. */
static double *tetcasti_plane_heights(tetcasti_mem *mem, const tetcast_mesh *mesh, const tetcasti_plane *f) {
    double *h = (double *)tetcasti_alloc_array(mem, (size_t)mesh->vertex_count + 1, sizeof *h);
    uint32_t i;
    if (h == NULL) return NULL;
    for (i = 0; i < mesh->vertex_count; i++) h[i] = tetcasti_plane_height(f, &mesh->vertex[i]);
    return h;
}

/* The polygon of a cell: local points and values. From both sides of an edge the same bits. */
static uint32_t tetcasti_section_cell(const tetcast_mesh *mesh, uint32_t cell, const double *heights, double p[4][3],
                                      double s[4]) {
    const uint32_t *t = mesh->tet[cell];
    uint8_t edge[4][2];
    double h[4];
    uint32_t i, a, n;
    for (i = 0; i < 4; i++) h[i] = heights[t[i]];
    n = tetcasti_section_edges(h, edge);
    for (i = 0; i < n; i++) {
        uint32_t v = t[edge[i][0]], w = t[edge[i][1]];
        const tetcasti_vertex *q, *r;
        double x;
        if (v > w) { const uint32_t swap = v; v = w; w = swap; }
        q = &mesh->vertex[v];
        r = &mesh->vertex[w];
        x = heights[v] / (heights[v] - heights[w]);
        p[i][0] = (double)q->x + ((double)r->x - (double)q->x) * x;
        p[i][1] = (double)q->y + ((double)r->y - (double)q->y) * x;
        p[i][2] = (double)q->z + ((double)r->z - (double)q->z) * x;
        s[i] = (double)q->s + ((double)r->s - (double)q->s) * x;
        for (a = 0; a < 3; a++)
            if (!tetcasti_finite(p[i][a])) return 0;
        if (mesh->cell_value != NULL) s[i] = (double)mesh->cell_value[cell];
    }
    return n;
}

TETCAST_DEF tetcast_result tetcast_plane_sample(const tetcast_env *env, const tetcast_mesh *mesh,
                                                const tetcast_plane *plane, uint32_t width, uint32_t height,
                                                float *out) {
    tetcast_env none;
    tetcasti_plane f;
    tetcasti_mem mem;
    tetcast_result r;
    double *heights;
    size_t i, n;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    r = tetcasti_env_open(env, &mem);
    if (r != TETCAST_OK) return r;
    if (mesh == NULL || plane == NULL || out == NULL || mesh->tet == NULL || width > 0x7fffffffu ||
        height > 0x7fffffffu || !tetcasti_plane_open(mesh, plane, &f))
        return tetcasti_fail(env->error, TETCAST_ERR_INVALID_ARG, 0, "plane: no plane, or no tets");
    if (!tetcasti_mul_size(width, height, &n)) return TETCAST_ERR_RANGE;
    heights = tetcasti_plane_heights(&mem, mesh, &f);
    if (heights == NULL) return tetcasti_fail(env->error, TETCAST_ERR_NO_MEMORY, 0, "plane: out of memory");
    for (i = 0; i < n; i++) out[i] = (float)NAN;
    for (i = 0; i < mesh->cell_count; i++) {
        double p[4][3], s[4], place[4][2];
        uint32_t k, a, count;
        if (mesh->hidden != NULL && (mesh->hidden[i >> 5] >> (i & 31u) & 1u)) continue;
        count = tetcasti_section_cell(mesh, (uint32_t)i, heights, p, s);
        if (count == 0) continue;
        for (k = 0; k < count; k++) {
            place[k][0] = place[k][1] = 0.0;
            for (a = 0; a < 3; a++) {
                place[k][0] += f.u[a] * (p[k][a] - f.origin[a]);
                place[k][1] += f.v[a] * (p[k][a] - f.origin[a]);
            }
            place[k][0] *= (double)width;
            place[k][1] *= (double)height;
        }
        tetcasti_plane_paint((const double (*)[2])place, s, count, width, height, out);
    }
    tetcasti_free(&mem, heights);
    return TETCAST_OK;
}

TETCAST_DEF void tetcast_section_free(tetcast_section *section) {
    tetcasti_mem mem;
    if (section == NULL || section->_allocator.free_fn == NULL) return;
    memset(&mem, 0, sizeof mem);
    mem.allocator = section->_allocator;
    tetcasti_free(&mem, section->points);
    tetcasti_free(&mem, section->values);
    tetcasti_free(&mem, section->first);
    tetcasti_free(&mem, section->cells);
    memset(section, 0, sizeof *section);
}

TETCAST_DEF tetcast_result tetcast_plane_section(const tetcast_env *env, const tetcast_mesh *mesh,
                                                 const tetcast_plane *plane, tetcast_section *out) {
    tetcast_env none;
    tetcasti_plane f;
    tetcasti_mem mem;
    tetcast_result r;
    double *heights;
    size_t points = 0, polygons = 0, i;
    uint32_t pass;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    if (out != NULL) memset(out, 0, sizeof *out);
    r = tetcasti_env_open(env, &mem);
    if (r != TETCAST_OK) return r;
    if (mesh == NULL || plane == NULL || out == NULL || mesh->tet == NULL || mesh->cell_value != NULL ||
        !tetcasti_plane_open(mesh, plane, &f))
        return tetcasti_fail(env->error, TETCAST_ERR_INVALID_ARG, 0, "section: no plane, no tets, or a field per cell");
    out->_allocator = mem.allocator;
    heights = tetcasti_plane_heights(&mem, mesh, &f);
    if (heights == NULL) return tetcasti_fail(env->error, TETCAST_ERR_NO_MEMORY, 0, "section: out of memory");
    for (pass = 0; pass < 2 && r == TETCAST_OK; pass++) {
        points = polygons = 0;
        for (i = 0; i < mesh->cell_count; i++) {
            double p[4][3], s[4];
            uint32_t k, a, n;
            if (mesh->hidden != NULL && (mesh->hidden[i >> 5] >> (i & 31u) & 1u)) continue;
            n = tetcasti_section_cell(mesh, (uint32_t)i, heights, p, s);
            if (n == 0) continue;
            if (pass == 1) {
                out->first[polygons] = (uint32_t)points;
                out->cells[polygons] = (uint32_t)i;
                for (k = 0; k < n; k++) {
                    for (a = 0; a < 3; a++) out->points[points + k][a] = mesh->origin[a] + p[k][a] * mesh->unit;
                    out->values[points + k] = (float)s[k];
                }
                for (k = 1; k + 1 < n; k++) {
                    double u[3], v[3], w[3];
                    for (a = 0; a < 3; a++) {
                        u[a] = (p[k][a] - p[0][a]) * mesh->unit;
                        v[a] = (p[k + 1][a] - p[0][a]) * mesh->unit;
                    }
                    tetcasti_cross(u, v, w);
                    out->area += 0.5 * sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
                }
            }
            points += n;
            polygons++;
        }
        if (pass == 1) break;
        if (points > 0x7fffffffu) r = tetcasti_fail(env->error, TETCAST_ERR_RANGE, points, "section: too many points");
        out->points = (double (*)[3])tetcasti_alloc_array(&mem, points + 1, sizeof *out->points);
        out->values = (float *)tetcasti_alloc_array(&mem, points + 1, sizeof *out->values);
        out->first = (uint32_t *)tetcasti_alloc_array(&mem, polygons + 1, sizeof *out->first);
        out->cells = (uint32_t *)tetcasti_alloc_array(&mem, polygons + 1, sizeof *out->cells);
        if (r == TETCAST_OK && (out->points == NULL || out->values == NULL || out->first == NULL || out->cells == NULL))
            r = tetcasti_fail(env->error, TETCAST_ERR_NO_MEMORY, 0, "section: out of memory");
    }
    tetcasti_free(&mem, heights);
    if (r != TETCAST_OK) {
        tetcast_section_free(out);
        return r;
    }
    out->first[polygons] = (uint32_t)points;
    out->point_count = (uint32_t)points;
    out->polygon_count = (uint32_t)polygons;
    return TETCAST_OK;
}
/* ---------------------------------------------------------------------------
   bricks: nodes of a lattice in blocks, on levels; choices of levels.           // >>bricks

   lattice  the finest level; everything below is in its units: node (i, j, k) is at the point (i, j, k)
   slot     2^log cells of the lattice a side; slot (x, y, z) begins at node (x, y, z) << log
   brick    of level k: (2^log + 1)^3 nodes, 2^k apart, so 2^k slots a side; it begins at a slot that is a multiple of
            2^k. Neighbours share their nodes: borders lie on nodes on every level. Level k has the nodes of level k-1 with
            even numbers
   table    per level a number of a brick for each place, or NONE. A brick has a parent, always; it has all children or
            none (a leaf), but for those that begin beyond the lattice
   node     beyond the lattice, where its sides are no multiples: level k goes on linearly as far as a cell needs it
   error    of a brick: the largest difference to the finest nodes below it; an upper bound, since it is added up from
            level to level: the difference of two neighbouring levels is largest in a node of the finer one
   cut      per slot a level, and 32 bits: number of the brick, level, adapted or not. Adapted bricks are copies in
            floats. 2^level <= cells of a brick, so that a slot is not smaller than a cell of its own level: else
            adapting would move nodes that other slots need
   The thesis has 2^m nodes a brick (2^m - 1 cells), so its borders lie between nodes on coarser levels, two layers have
   to be adapted, and neighbours may differ by one level only.
   --------------------------------------------------------------------------- */

#define TETCASTI_BRICKS_END ((uint32_t)1 << 26)  /* bricks: a cut has 26 bits for the number */
#define TETCASTI_ADAPTED 0x80000000u
#define TETCASTI_LEVEL_SHIFT 27u
#define TETCASTI_SLOT_MASK (((uint32_t)1 << TETCASTI_LEVEL_SHIFT) - 1u)

typedef struct tetcasti_brick {
    uint32_t level, place[3];    /* place: in bricks of its level */
    float lo, hi, error;
} tetcasti_brick;

struct tetcast_bricks {
    tetcasti_mem mem;
    tetcast_lattice lattice;
    uint32_t log, levels, side;      /* side: nodes of a brick along a side */
    uint32_t slots[3];
    uint32_t grid[TETCAST_BRICK_LEVELS][3];
    size_t table_start[TETCAST_BRICK_LEVELS + 1];
    uint32_t *table;
    tetcasti_brick *brick;
    uint32_t count;
    tetcast_type type;
    uint32_t bytes;                  /* of a node */
    float bias, step;                /* value = bias + step * integer */
    size_t nodes;                    /* of a brick */
    uint8_t *data;                   /* count * nodes * bytes, and 64 more */
    float value_min, value_max;
    double (*hull)[3];               /* world */
    uint32_t (*face)[3];
    uint32_t hull_count, face_count;
};

struct tetcast_cut {
    tetcasti_mem mem;
    const tetcast_bricks *bricks;
    uint8_t *level;                  /* per slot */
    uint32_t *slot;                  /* per slot: what is there, see above */
    float (*range)[2];               /* per slot */
    float *adapted;                  /* blocks of bricks->nodes floats */
    uint32_t *source;                /* of each adapted block: its brick */
    uint32_t adapted_count;
    tetcast_cut_info info;
};

static void tetcasti_bricks_free(tetcast_bricks *b) {
    tetcasti_mem mem;
    if (b == NULL) return;
    mem = b->mem;
    tetcasti_free(&mem, b->table);
    tetcasti_free(&mem, b->brick);
    tetcasti_free(&mem, b->data);
    tetcasti_free(&mem, b->hull);
    tetcasti_free(&mem, b->face);
    tetcasti_free(&mem, b);
}
TETCAST_DEF void tetcast_bricks_destroy(tetcast_bricks *bricks) { tetcasti_bricks_free(bricks); }

/* Sizes of everything that follows from lattice, log and levels. 0: out of range. */
static int tetcasti_bricks_shape(tetcast_bricks *b) {
    uint32_t a, k;
    size_t n = 0;
    b->side = (1u << b->log) + 1;
    b->nodes = (size_t)b->side * b->side * b->side;
    for (a = 0; a < 3; a++) {
        b->slots[a] = (b->lattice.dims[a] - 1 + (1u << b->log) - 1) >> b->log;
        if (b->slots[a] == 0) b->slots[a] = 1;
    }
    for (k = 0; k < b->levels; k++) {
        size_t m = 1;
        for (a = 0; a < 3; a++) {
            b->grid[k][a] = (b->slots[a] + (1u << k) - 1) >> k;
            if (!tetcasti_mul_size(m, b->grid[k][a], &m)) return 0;
        }
        if (m >= TETCASTI_BRICKS_END) return 0;
        b->table_start[k] = n;
        n += m;
    }
    b->table_start[b->levels] = n;
    b->bytes = b->type == TETCAST_TYPE_U8 ? 1 : b->type == TETCAST_TYPE_F32 ? 4 : 2;
    return 1;
}

TETCASTI_INLINE uint32_t *tetcasti_bricks_at(const tetcast_bricks *b, uint32_t level, uint32_t x, uint32_t y,
                                             uint32_t z) {
    return b->table + b->table_start[level] + x + (size_t)b->grid[level][0] * (y + (size_t)b->grid[level][1] * z);
}

static int tetcasti_storage_good(tetcast_type t) {
    return t == TETCAST_TYPE_F32 || t == TETCAST_TYPE_F16 || t == TETCAST_TYPE_U16 || t == TETCAST_TYPE_U8;
}

static tetcast_bricks *tetcasti_bricks_open(const tetcast_env *env, const tetcast_lattice *lattice, uint32_t log,
                                            uint32_t levels, tetcast_type type, tetcast_result *r) {
    tetcasti_mem mem;
    tetcast_bricks *b;
    *r = tetcasti_env_open(env, &mem);
    if (*r != TETCAST_OK) return NULL;
    b = (tetcast_bricks *)tetcasti_alloc_zero(&mem, 1, sizeof *b);
    if (b == NULL) {
        *r = tetcasti_fail(env->error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
        return NULL;
    }
    b->mem = mem;
    b->lattice = *lattice;
    b->log = log;
    b->levels = levels;
    b->type = type;
    if (!tetcasti_bricks_shape(b)) {
        *r = tetcasti_fail(env->error, TETCAST_ERR_RANGE, 0, "bricks: too many");
        tetcasti_bricks_free(b);
        return NULL;
    }
    b->table = (uint32_t *)tetcasti_alloc_array(&b->mem, b->table_start[levels], sizeof *b->table);
    if (b->table == NULL) {
        *r = tetcasti_fail(env->error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
        tetcasti_bricks_free(b);
        return NULL;
    }
    memset(b->table, 255, b->table_start[levels] * sizeof *b->table);
    return b;
}

/* ---- numbers as they are stored ---- */

/* Nearest half, ties to even; beyond its range the largest. */
static uint16_t tetcasti_to_half(float x) {
    uint32_t u, e, m, s;
    memcpy(&u, &x, 4);
    s = u >> 16 & 0x8000u;
    u &= 0x7fffffffu;
    if (u >= 0x477ff000u) return (uint16_t)(s | (u > 0x7f800000u ? 0x7e00u : 0x7bffu));
    if (u < 0x33000001u) return (uint16_t)s;
    e = u >> 23;
    m = (u & 0x7fffffu) | 0x800000u;
    if (e >= 113) {
        u = (e - 112) << 10 | (m & 0x7fffffu) >> 13;
        u += (m & 0x1fffu) > 0x1000u || ((m & 0x1fffu) == 0x1000u && (u & 1u));
        return (uint16_t)(s | u);
    }
    e = 126 - e; /* 14 .. 24 */
    u = m >> e;
    m &= ((uint32_t)1 << e) - 1u;
    u += m > (uint32_t)1 << (e - 1) || (m == (uint32_t)1 << (e - 1) && (u & 1u));
    return (uint16_t)(s | u);
}
/* Exact, without branches for what is stored: no infinities, no NaN. */
TETCASTI_INLINE float tetcasti_from_half(uint32_t h) {
    uint32_t u = (h & 0x7fffu) << 13;
    float x;
    memcpy(&x, &u, 4);
    x *= 5.192296858534828e33f; /* 2^112 */
    memcpy(&u, &x, 4);
    u |= (h & 0x8000u) << 16;
    memcpy(&x, &u, 4);
    return x;
}

TETCASTI_INLINE float tetcasti_node_get(const tetcast_bricks *b, const uint8_t *block, size_t i) {
    float f;
    uint16_t u;
    switch (b->type) {
    case TETCAST_TYPE_F32: memcpy(&f, block + 4 * i, 4); return f;
    case TETCAST_TYPE_F16: memcpy(&u, block + 2 * i, 2); return tetcasti_from_half(u);
    case TETCAST_TYPE_U16: memcpy(&u, block + 2 * i, 2); return b->bias + b->step * (float)u;
    default: return b->bias + b->step * (float)block[i];
    }
}

TETCASTI_INLINE void tetcasti_node_put(const tetcast_bricks *b, uint8_t *block, size_t i, float v) {
    uint16_t u;
    float q;
    switch (b->type) {
    case TETCAST_TYPE_F32: memcpy(block + 4 * i, &v, 4); return;
    case TETCAST_TYPE_F16: u = tetcasti_to_half(v); memcpy(block + 2 * i, &u, 2); return;
    default:
        q = b->step > 0.0f ? (v - b->bias) / b->step + 0.5f : 0.0f;
        q = q > 0.0f ? q : 0.0f;
        if (b->type == TETCAST_TYPE_U16) {
            u = (uint16_t)(q < 65535.0f ? q : 65535.0f);
            memcpy(block + 2 * i, &u, 2);
        } else {
            block[i] = (uint8_t)(q < 255.0f ? q : 255.0f);
        }
        return;
    }
}

TETCASTI_INLINE const uint8_t *tetcasti_brick_block(const tetcast_bricks *b, uint32_t brick) {
    return b->data + (size_t)brick * b->nodes * b->bytes;
}

/* ---- building ---- */

/* The levels of a lattice as plain arrays. */
typedef struct tetcasti_pyramid {
    float *level[TETCAST_BRICK_LEVELS];
    size_t dims[TETCAST_BRICK_LEVELS][3];
    float *error[TETCAST_BRICK_LEVELS];  /* per brick of that level */
    const uint8_t *inside;               /* NULL, or per node of level 0: errors count here */
} tetcasti_pyramid;

static void tetcasti_pyramid_free(tetcasti_mem *mem, tetcasti_pyramid *p) {
    uint32_t k;
    for (k = 0; k < TETCAST_BRICK_LEVELS; k++) {
        if (k != 0) tetcasti_free(mem, p->level[k]);
        tetcasti_free(mem, p->error[k]);
    }
}

/* Node i of a row that goes on linearly beyond both ends. */
TETCASTI_INLINE float tetcasti_row_at(const float *row, ptrdiff_t stride, ptrdiff_t n, ptrdiff_t i) {
    if (i >= 0 && i < n) return row[i * stride];
    if (n == 1) return row[0];
    if (i < 0) {
        const ptrdiff_t j = -i < n ? -i : n - 1;
        return 2.0f * row[0] - row[j * stride];
    }
    {
        const ptrdiff_t j = i - (n - 1) < n ? i - (n - 1) : n - 1;
        return 2.0f * row[(n - 1) * stride] - row[(n - 1 - j) * stride];
    }
}

/* One axis of one level: in[n] -> out[m], m = ceil((n - 1) / 2) + 1. */
static void tetcasti_row_halve(const float *in, ptrdiff_t stride_in, size_t n, float *out, ptrdiff_t stride_out,
                               size_t m, int nearest) {
    size_t i;
    for (i = 0; i < m; i++) {
        const ptrdiff_t c = 2 * (ptrdiff_t)i, e = (ptrdiff_t)n;
        float v;
        if (nearest) v = tetcasti_row_at(in, stride_in, e, c);
        else if (c >= 2 && c + 2 < e) {
            const float *p = in + c * stride_in;
            v = 0.0625f * (p[-2 * stride_in] + p[2 * stride_in]) + 0.25f * (p[-stride_in] + p[stride_in]) + 0.375f * p[0];
        } else {
            v = 0.0625f * (tetcasti_row_at(in, stride_in, e, c - 2) + tetcasti_row_at(in, stride_in, e, c + 2)) +
                0.25f * (tetcasti_row_at(in, stride_in, e, c - 1) + tetcasti_row_at(in, stride_in, e, c + 1)) +
                0.375f * tetcasti_row_at(in, stride_in, e, c);
        }
        out[(ptrdiff_t)i * stride_out] = v;
    }
}

typedef struct tetcasti_halve {
    const float *in;
    float *out;
    const size_t *from, *to; /* dims */
    float *scratch;          /* per layer of the result: rows in x and y */
    int nearest;
    uint32_t axis;
} tetcasti_halve;

/* Axis 0 and 1: one task per layer z of the input; axis 2: one per row y of the result. */
static void tetcasti_task_halve(void *ctx, uint32_t task) {
    const tetcasti_halve *h = (const tetcasti_halve *)ctx;
    const size_t nx = h->from[0], ny = h->from[1], mx = h->to[0], my = h->to[1];
    size_t x, y;
    if (h->axis == 0) {
        for (y = 0; y < ny; y++)
            tetcasti_row_halve(h->in + nx * (y + ny * task), 1, nx, h->out + mx * (y + ny * task), 1, mx, h->nearest);
    } else if (h->axis == 1) {
        for (x = 0; x < mx; x++)
            tetcasti_row_halve(h->in + x + mx * ny * task, (ptrdiff_t)mx, ny, h->out + x + mx * my * task, (ptrdiff_t)mx,
                               my, h->nearest);
    } else {
        for (x = 0; x < mx; x++)
            tetcasti_row_halve(h->in + x + mx * task, (ptrdiff_t)(mx * my), h->from[2], h->out + x + mx * task,
                               (ptrdiff_t)(mx * my), h->to[2], h->nearest);
    }
}

/* The next coarser level. 0: no memory. */
static int tetcasti_pyramid_halve(const tetcast_env *env, tetcasti_mem *mem, tetcasti_pyramid *p, uint32_t level,
                                  int nearest) {
    tetcasti_halve h;
    float *one, *two;
    const size_t *from = p->dims[level - 1];
    size_t *to = p->dims[level];
    uint32_t a;
    for (a = 0; a < 3; a++) to[a] = from[a] / 2 + 1;
    one = (float *)tetcasti_alloc_array(mem, to[0] * from[1] * from[2], sizeof *one);
    two = (float *)tetcasti_alloc_array(mem, to[0] * to[1] * from[2], sizeof *two);
    p->level[level] = (float *)tetcasti_alloc_array(mem, to[0] * to[1] * to[2], sizeof *two);
    if (one != NULL && two != NULL && p->level[level] != NULL) {
        memset(&h, 0, sizeof h);
        h.from = from;
        h.to = to;
        h.nearest = nearest;
        for (a = 0; a < 3; a++) {
            h.axis = a;
            h.in = a == 0 ? p->level[level - 1] : a == 1 ? one : two;
            h.out = a == 0 ? one : a == 1 ? two : p->level[level];
            tetcasti_parallel_for(env, tetcasti_task_halve, &h, (uint32_t)(a == 2 ? to[1] : from[2]));
        }
    }
    tetcasti_free(mem, one);
    tetcasti_free(mem, two);
    return one != NULL && two != NULL && p->level[level] != NULL;
}

typedef struct tetcasti_errors {
    const tetcast_bricks *b;
    tetcasti_pyramid *p;
    uint32_t level;
} tetcasti_errors;

/* Is a node of level k - 1 of interest? Those outside of a mesh are not. */
TETCASTI_INLINE int tetcasti_inside_at(const tetcasti_pyramid *p, uint32_t level, size_t x, size_t y, size_t z) {
    const size_t *d = p->dims[0];
    x <<= level;
    y <<= level;
    z <<= level;
    if (x >= d[0] || y >= d[1] || z >= d[2]) return 0;
    return p->inside == NULL || p->inside[x + d[0] * (y + d[1] * z)];
}

/* Difference of a brick to the level below it, plus the largest error of its children. */
static void tetcasti_task_errors(void *ctx, uint32_t i) {
    const tetcasti_errors *e = (const tetcasti_errors *)ctx;
    const tetcast_bricks *b = e->b;
    const tetcasti_pyramid *p = e->p;
    const uint32_t k = e->level, *grid = b->grid[k], cells = 2u << b->log;
    const uint32_t at[3] = {i % grid[0], i / grid[0] % grid[1], i / grid[0] / grid[1]};
    const size_t *coarse = p->dims[k], *fine = p->dims[k - 1];
    const float *v = p->level[k], *w = p->level[k - 1];
    size_t lo[3], hi[3], x, y, z;
    float worst = 0.0f, below = 0.0f;
    uint32_t a, c;
    for (a = 0; a < 3; a++) {
        lo[a] = (size_t)at[a] * cells;
        hi[a] = lo[a] + cells < fine[a] - 1 ? lo[a] + cells : fine[a] - 1;
    }
    for (z = lo[2]; z <= hi[2]; z++)
        for (y = lo[1]; y <= hi[1]; y++) {
            /* means of two nodes where the number is odd: four rows of the coarser level, two of them the same if even */
            const size_t z0 = z / 2, z1 = z0 + (z & 1u), y0 = y / 2, y1 = y0 + (y & 1u);
            const float *r[4];
            r[0] = v + coarse[0] * (y0 + coarse[1] * z0);
            r[1] = v + coarse[0] * (y1 + coarse[1] * z0);
            r[2] = v + coarse[0] * (y0 + coarse[1] * z1);
            r[3] = v + coarse[0] * (y1 + coarse[1] * z1);
            for (x = lo[0]; x <= hi[0]; x++) {
                const size_t x0 = x / 2, x1 = x0 + (x & 1u);
                const float m = 0.125f * (((r[0][x0] + r[0][x1]) + (r[1][x0] + r[1][x1])) +
                                          ((r[2][x0] + r[2][x1]) + (r[3][x0] + r[3][x1])));
                const float d = tetcasti_absf(m - w[x + fine[0] * (y + fine[1] * z)]);
                if (d > worst && (p->inside == NULL || tetcasti_inside_at(p, k - 1, x, y, z))) worst = d;
            }
        }
    if (k > 1)
        for (c = 0; c < 8; c++) {
            const uint32_t *g = b->grid[k - 1], cx = 2 * at[0] + (c & 1u), cy = 2 * at[1] + (c >> 1 & 1u),
                cz = 2 * at[2] + (c >> 2);
            if (cx < g[0] && cy < g[1] && cz < g[2]) {
                const float d = p->error[k - 1][cx + (size_t)g[0] * (cy + (size_t)g[1] * cz)];
                below = d > below ? d : below;
            }
        }
    p->error[k][i] = worst + below;
}

typedef struct tetcasti_fill {
    tetcast_bricks *b;
    const tetcasti_pyramid *p;
} tetcasti_fill;

static void tetcasti_task_brick(void *ctx, uint32_t i) {
    const tetcasti_fill *f = (const tetcasti_fill *)ctx;
    tetcast_bricks *b = f->b;
    tetcasti_brick *brick = &b->brick[i];
    const size_t *d = f->p->dims[brick->level];
    const float *v = f->p->level[brick->level];
    uint8_t *block = b->data + (size_t)i * b->nodes * b->bytes;
    const uint32_t cells = 1u << b->log;
    size_t x, y, z, n = 0;
    float lo = TETCASTI_INF, hi = -TETCASTI_INF;
    for (z = 0; z <= cells; z++)
        for (y = 0; y <= cells; y++) {
            size_t gz = (size_t)brick->place[2] * cells + z, gy = (size_t)brick->place[1] * cells + y;
            const float *row;
            gz = gz < d[2] ? gz : d[2] - 1;
            gy = gy < d[1] ? gy : d[1] - 1;
            row = v + d[0] * (gy + d[1] * gz);
            for (x = 0; x <= cells; x++, n++) {
                size_t gx = (size_t)brick->place[0] * cells + x;
                float q;
                gx = gx < d[0] ? gx : d[0] - 1;
                tetcasti_node_put(b, block, n, row[gx]);
                q = tetcasti_node_get(b, block, n); /* as it will be seen */
                lo = q < lo ? q : lo;
                hi = q > hi ? q : hi;
            }
        }
    brick->lo = lo;
    brick->hi = hi;
}

/* Number the bricks that are kept: all, or with max_error those whose parent is not good enough. 0: no memory. */
static int tetcasti_bricks_keep(tetcast_bricks *b, const tetcasti_pyramid *p, float max_error) {
    uint32_t k, pass, n = 0;
    for (pass = 0; pass < 2; pass++) {
        n = 0;
        for (k = b->levels; k-- > 0;) {
            const uint32_t *g = b->grid[k];
            uint32_t x, y, z;
            for (z = 0; z < g[2]; z++)
                for (y = 0; y < g[1]; y++)
                    for (x = 0; x < g[0]; x++) {
                        const size_t i = x + (size_t)g[0] * (y + (size_t)g[1] * z);
                        if (k + 1 < b->levels) {
                            const uint32_t parent = *tetcasti_bricks_at(b, k + 1, x / 2, y / 2, z / 2);
                            const uint32_t *pg = b->grid[k + 1];
                            if (parent == TETCASTI_NONE) continue;
                            if (max_error > 0.0f &&
                                p->error[k + 1][x / 2 + (size_t)pg[0] * (y / 2 + (size_t)pg[1] * (z / 2))] <= max_error)
                                continue;
                        }
                        *tetcasti_bricks_at(b, k, x, y, z) = n;
                        if (pass == 1) {
                            tetcasti_brick *brick = &b->brick[n];
                            brick->level = k;
                            brick->place[0] = x;
                            brick->place[1] = y;
                            brick->place[2] = z;
                            brick->error = k == 0 ? 0.0f : p->error[k][i];
                        }
                        n++;
                    }
        }
        if (pass == 1) break;
        if (n >= TETCASTI_BRICKS_END) return 0;
        b->count = n;
        b->brick = (tetcasti_brick *)tetcasti_alloc_zero(&b->mem, n, sizeof *b->brick);
        if (b->brick == NULL) return 0;
    }
    return 1;
}

/* Bricks of nodes. values: level 0, changed nowhere; inside: see tetcasti_pyramid. */
static tetcast_result tetcasti_bricks_build(const tetcast_bricks_desc *d, const tetcast_lattice *lattice, float *values,
                                            const uint8_t *inside, tetcast_bricks **out) {
    const uint32_t log = d->log_cells != 0 ? d->log_cells : 4;
    tetcasti_pyramid p;
    tetcasti_fill f;
    tetcast_result r;
    uint32_t k, a, levels = d->levels != 0 ? d->levels : log + 1;
    size_t n, i, bytes;
    tetcast_bricks *b;
    int ok = 1;
    memset(&p, 0, sizeof p);
    b = tetcasti_bricks_open(&d->env, lattice, log, levels, d->storage, &r);
    if (b == NULL) return r;
    p.inside = inside;
    p.level[0] = values;
    n = 1;
    for (a = 0; a < 3; a++) n *= p.dims[0][a] = lattice->dims[a];
    b->value_min = TETCASTI_INF;
    b->value_max = -TETCASTI_INF;
    for (k = 0; k < levels && ok; k++) {
        if (k != 0) ok = tetcasti_pyramid_halve(&d->env, &b->mem, &p, k, d->nearest || d->max_error > 0.0f || inside != NULL);
        if (!ok) break;
        n = p.dims[k][0] * p.dims[k][1] * p.dims[k][2];
        for (i = 0; i < n && k == 0; i++) { /* integers clamp what goes beyond it on coarser levels */
            b->value_min = p.level[k][i] < b->value_min ? p.level[k][i] : b->value_min;
            b->value_max = p.level[k][i] > b->value_max ? p.level[k][i] : b->value_max;
        }
        if (k != 0) {
            tetcasti_errors e;
            const uint32_t count = b->grid[k][0] * b->grid[k][1] * b->grid[k][2];
            e.b = b;
            e.p = &p;
            e.level = k;
            p.error[k] = (float *)tetcasti_alloc_zero(&b->mem, count, sizeof *p.error[k]);
            ok = p.error[k] != NULL;
            if (ok) tetcasti_parallel_for(&d->env, tetcasti_task_errors, &e, count);
        }
    }
    if (ok) {
        b->bias = b->value_min;
        b->step = (b->value_max - b->value_min) / (d->storage == TETCAST_TYPE_U8 ? 255.0f : 65535.0f);
        ok = tetcasti_bricks_keep(b, &p, d->max_error) && tetcasti_mul_size(b->count, b->nodes, &bytes) &&
             tetcasti_mul_size(bytes, b->bytes, &bytes) && bytes <= (size_t)-1 - 64;
        if (ok) b->data = (uint8_t *)tetcasti_alloc(&b->mem, bytes + 64);
        ok = ok && b->data != NULL;
    }
    if (ok) {
        memset(b->data + bytes, 0, 64);
        f.b = b;
        f.p = &p;
        tetcasti_parallel_for(&d->env, tetcasti_task_brick, &f, b->count);
    }
    tetcasti_pyramid_free(&b->mem, &p);
    if (!ok) {
        tetcasti_bricks_free(b);
        return tetcasti_fail(d->env.error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
    }
    *out = b;
    return TETCAST_OK;
}

static tetcast_result tetcasti_bricks_desc_open(const tetcast_bricks_desc *desc, tetcast_bricks_desc *d,
                                                tetcast_bricks_report *report, tetcast_bricks **out) {
    memset(d, 0, sizeof *d);
    if (desc != NULL) *d = *desc;
    if (out != NULL) *out = NULL;
    if (report != NULL) memset(report, 0, sizeof *report);
    if (d->_begin_zero != 0 || d->_end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    if (out == NULL || !tetcasti_storage_good(d->storage) || !(d->max_error >= 0.0f) || d->max_error >= TETCASTI_INF ||
        (d->log_cells != 0 && (d->log_cells < 3 || d->log_cells > 5)) ||
        d->levels > (d->log_cells != 0 ? d->log_cells : 4) + 1)
        return tetcasti_fail(d->env.error, TETCAST_ERR_INVALID_ARG, 0, "bricks: bad option");
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_bricks_create_grid(const tetcast_bricks_desc *desc, const tetcast_lattice *lattice,
                                                      const tetcast_array *values, tetcast_bricks_report *report,
                                                      tetcast_bricks **out) {
    tetcast_bricks_desc d;
    tetcasti_mem mem;
    tetcast_result r = tetcasti_bricks_desc_open(desc, &d, report, out);
    size_t n, i, stride;
    float *v, least = TETCASTI_INF;
    uint64_t bad = 0;
    if (r != TETCAST_OK) return r;
    if (lattice == NULL || values == NULL || values->data == NULL || !tetcasti_lattice_good(lattice) ||
        tetcasti_type_size(values->type) == 0)
        return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, 0, "bricks: bad lattice or values");
    r = tetcasti_env_open(&d.env, &mem);
    if (r != TETCAST_OK) return r;
    if (!tetcasti_mul_size(lattice->dims[0], lattice->dims[1], &n) || !tetcasti_mul_size(n, lattice->dims[2], &n) ||
        n > (size_t)-1 / 64) return tetcasti_fail(d.env.error, TETCAST_ERR_RANGE, 0, "bricks: the lattice is too large");
    v = (float *)tetcasti_alloc_array(&mem, n, sizeof *v);
    if (v == NULL) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
    stride = tetcasti_array_stride(values, 1);
    for (i = 0; i < n; i++) {
        v[i] = (float)tetcasti_array_get(values, stride, i, 0);
        if (!(v[i] > -TETCASTI_VALUE_END && v[i] < TETCASTI_VALUE_END)) {
            v[i] = (float)NAN;
            bad++;
        } else if (v[i] < least) least = v[i];
    }
    if (bad == n) least = 0.0f;
    if (bad != 0)
        for (i = 0; i < n; i++) v[i] = v[i] == v[i] ? v[i] : least;
    if (report != NULL) report->bad_values = bad;
    r = tetcasti_bricks_build(&d, lattice, v, NULL, out);
    tetcasti_free(&mem, v);
    return r;
}

/* ---- sampling ---- */

/* Where a point lies: the eight nodes of its cell, and its place in it. */
typedef struct tetcasti_place {
    const uint8_t *block;    /* of the brick */
    uint32_t type;           /* tetcast_type of the block */
    size_t node;             /* the lowest of the eight */
    float f[3];
    uint32_t level;
} tetcasti_place;

TETCASTI_INLINE const uint8_t *tetcasti_slot_block(const tetcast_cut *cut, uint32_t word, uint32_t *type) {
    const tetcast_bricks *b = cut->bricks;
    const size_t number = word & TETCASTI_SLOT_MASK;
    if (word & TETCASTI_ADAPTED) {
        *type = TETCAST_TYPE_F32;
        return (const uint8_t *)(cut->adapted + number * b->nodes);
    }
    *type = (uint32_t)b->type;
    return b->data + number * b->nodes * b->bytes;
}

TETCASTI_INLINE float tetcasti_block_get(const tetcast_bricks *b, const uint8_t *block, uint32_t type, size_t i) {
    float f;
    uint16_t u;
    switch (type) {
    case TETCAST_TYPE_F32: memcpy(&f, block + 4 * i, 4); return f;
    case TETCAST_TYPE_F16: memcpy(&u, block + 2 * i, 2); return tetcasti_from_half(u);
    case TETCAST_TYPE_U16: memcpy(&u, block + 2 * i, 2); return b->bias + b->step * (float)u;
    default: return b->bias + b->step * (float)block[i];
    }
}

/* x: lattice units, inside of the lattice. */
TETCASTI_INLINE void tetcasti_place_at(const tetcast_cut *cut, const float x[3], tetcasti_place *p) {
    const tetcast_bricks *b = cut->bricks;
    const uint32_t cells = 1u << b->log;
    uint32_t s[3], word, a, k, i[3];
    for (a = 0; a < 3; a++) {
        s[a] = (uint32_t)(int32_t)x[a] >> b->log;
        s[a] = s[a] < b->slots[a] ? s[a] : b->slots[a] - 1;
    }
    word = cut->slot[s[0] + (size_t)b->slots[0] * (s[1] + (size_t)b->slots[1] * s[2])];
    k = word >> TETCASTI_LEVEL_SHIFT & 15u;
    p->level = k;
    p->block = tetcasti_slot_block(cut, word, &p->type);
    for (a = 0; a < 3; a++) {
        const float u = (x[a] - (float)(int32_t)(s[a] >> k << k << b->log)) * (1.0f / (float)(1u << k));
        i[a] = (uint32_t)(int32_t)u;
        i[a] = i[a] < cells ? i[a] : cells - 1;
        p->f[a] = u - (float)(int32_t)i[a];
    }
    p->node = i[0] + (size_t)b->side * (i[1] + (size_t)b->side * i[2]);
}

TETCASTI_INLINE void tetcasti_place_nodes(const tetcast_cut *cut, const tetcasti_place *p, float v[8]) {
    const tetcast_bricks *b = cut->bricks;
    uint32_t i;
    for (i = 0; i < 8; i++)
        v[i] = tetcasti_block_get(b, p->block, p->type,
                                  p->node + (i & 1u) + b->side * ((i >> 1 & 1u) + (size_t)b->side * (i >> 2)));
}

TETCASTI_INLINE float tetcasti_trilinear(const float v[8], const float f[3]) {
    const float a = v[0] + f[0] * (v[1] - v[0]), c = v[2] + f[0] * (v[3] - v[2]);
    const float d = v[4] + f[0] * (v[5] - v[4]), e = v[6] + f[0] * (v[7] - v[6]);
    const float g = a + f[1] * (c - a), h = d + f[1] * (e - d);
    return g + f[2] * (h - g);
}

TETCASTI_INLINE float tetcasti_cut_value(const tetcast_cut *cut, const float x[3]) {
    const tetcast_bricks *b = cut->bricks;
    tetcasti_place p;
    float v[8], r;
    uint16_t u;
    uint32_t i;
    tetcasti_place_at(cut, x, &p);
    if (p.type != TETCAST_TYPE_U16 && p.type != TETCAST_TYPE_U8) {
        tetcasti_place_nodes(cut, &p, v);
        return tetcasti_trilinear(v, p.f);
    }
    for (i = 0; i < 8; i++) { /* interpolate integers, scale once */
        const size_t n = p.node + (i & 1u) + b->side * ((i >> 1 & 1u) + (size_t)b->side * (i >> 2));
        if (p.type == TETCAST_TYPE_U8) {
            v[i] = (float)p.block[n];
        } else {
            memcpy(&u, p.block + 2 * n, 2);
            v[i] = (float)u;
        }
    }
    r = tetcasti_trilinear(v, p.f);
    return b->bias + b->step * r;
}

/* Gradient per lattice unit of the cell's trilinear function. */
TETCASTI_INLINE float tetcasti_cut_slope(const tetcast_cut *cut, const float x[3], float g[3]) {
    tetcasti_place p;
    float v[8], s;
    uint32_t a;
    tetcasti_place_at(cut, x, &p);
    tetcasti_place_nodes(cut, &p, v);
    for (a = 0; a < 3; a++) {
        float lo[3], hi[3];
        memcpy(lo, p.f, sizeof lo);
        memcpy(hi, p.f, sizeof hi);
        lo[a] = 0.0f;
        hi[a] = 1.0f;
        g[a] = tetcasti_trilinear(v, hi) - tetcasti_trilinear(v, lo);
    }
    s = tetcasti_trilinear(v, p.f);
    for (a = 0; a < 3; a++) g[a] = g[a] * (1.0f / (float)(1u << p.level));
    return s;
}

TETCASTI_INLINE void tetcasti_point_clamp(const tetcast_bricks *b, float x, float y, float z, float p[3]) {
    uint32_t a;
    p[0] = x;
    p[1] = y;
    p[2] = z;
    for (a = 0; a < 3; a++) {
        const float end = (float)(int32_t)(b->lattice.dims[a] - 1);
        p[a] = p[a] > 0.0f ? p[a] : 0.0f;
        p[a] = p[a] < end ? p[a] : end;
    }
}

#if TETCASTI_AVX2
/* Eight places side by side. `word` is what is in their slots, `node` the lowest node of their cells. */
TETCASTI_TARGET_AVX2 static inline __m256 tetcasti_mix8(__m256 a, __m256 b, __m256 f) {
    return _mm256_add_ps(a, _mm256_mul_ps(f, _mm256_sub_ps(b, a)));
}

/* A row of cells: nodes x and x + 1 of each lane. Loads of pairs and shuffles: gathers take twice the time on Zen 4. */
TETCASTI_TARGET_AVX2 static inline __m256 tetcasti_nodes8_f32(const uint8_t *const p[8], size_t offset, __m256 fx) {
    __m128 v[4];
    __m256 a, b;
    uint32_t i;
    for (i = 0; i < 4; i++) {
        v[i] = _mm_castsi128_ps(_mm_loadl_epi64((const __m128i *)(const void *)(p[2 * i] + offset)));
        v[i] = _mm_loadh_pi(v[i], (const __m64 *)(const void *)(p[2 * i + 1] + offset));
    }
    a = _mm256_insertf128_ps(_mm256_castps128_ps256(v[0]), v[2], 1);
    b = _mm256_insertf128_ps(_mm256_castps128_ps256(v[1]), v[3], 1);
    return tetcasti_mix8(_mm256_shuffle_ps(a, b, 0x88), _mm256_shuffle_ps(a, b, 0xdd), fx);
}
TETCASTI_TARGET_AVX2 static inline __m256i tetcasti_pairs8(const uint8_t *const p[8], size_t offset) {
    int32_t q[8];
    uint32_t i;
    for (i = 0; i < 8; i++) memcpy(&q[i], p[i] + offset, 4);
    return _mm256_setr_epi32(q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7]);
}
TETCASTI_TARGET_AVX2 static inline __m256 tetcasti_half8(__m256i h) { /* 16 bits in each lane */
    const __m256 v = _mm256_mul_ps(_mm256_castsi256_ps(_mm256_slli_epi32(_mm256_and_si256(h, _mm256_set1_epi32(0x7fff)), 13)),
                                   _mm256_set1_ps(5.192296858534828e33f));
    return _mm256_or_ps(v, _mm256_castsi256_ps(_mm256_slli_epi32(_mm256_and_si256(h, _mm256_set1_epi32(0x8000)), 16)));
}
TETCASTI_TARGET_AVX2 static inline __m256 tetcasti_nodes8(const uint32_t type, const uint8_t *const p[8], size_t node,
                                                        __m256 fx) {
    if (type == TETCAST_TYPE_F32) return tetcasti_nodes8_f32(p, 4 * node, fx);
    if (type == TETCAST_TYPE_U8) {
        const __m256i q = tetcasti_pairs8(p, node), low = _mm256_set1_epi32(255);
        return tetcasti_mix8(_mm256_cvtepi32_ps(_mm256_and_si256(q, low)),
                              _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32(q, 8), low)), fx);
    }
    {
        const __m256i q = tetcasti_pairs8(p, 2 * node), a = _mm256_and_si256(q, _mm256_set1_epi32(0xffff)),
            b = _mm256_srli_epi32(q, 16);
        if (type == TETCAST_TYPE_F16) return tetcasti_mix8(tetcasti_half8(a), tetcasti_half8(b), fx);
        return tetcasti_mix8(_mm256_cvtepi32_ps(a), _mm256_cvtepi32_ps(b), fx);
    }
}
TETCASTI_TARGET_AVX2 static inline __m256 tetcasti_place8(const uint32_t type, const tetcast_bricks *b,
                                                         const uint8_t *const p[8], const __m256 f[3]) {
    const size_t side = b->side;
    const __m256 r0 = tetcasti_nodes8(type, p, 0, f[0]), r1 = tetcasti_nodes8(type, p, side, f[0]);
    const __m256 r2 = tetcasti_nodes8(type, p, side * side, f[0]), r3 = tetcasti_nodes8(type, p, side * side + side, f[0]);
    const __m256 g = tetcasti_mix8(r0, r1, f[1]), h = tetcasti_mix8(r2, r3, f[1]), v = tetcasti_mix8(g, h, f[2]);
    if (type == TETCAST_TYPE_U8 || type == TETCAST_TYPE_U16)
        return _mm256_add_ps(_mm256_set1_ps(b->bias), _mm256_mul_ps(_mm256_set1_ps(b->step), v));
    return v;
}

/* Values of eight cells whose lowest nodes lie at p. adapted: lanes whose blocks are floats, as bits. */
TETCASTI_TARGET_AVX2 static inline __m256 tetcasti_places8(const tetcast_bricks *b, const uint8_t *const p[8],
                                                          uint32_t adapted, const __m256 f[3]) {
    const uint8_t *q[8];
    float v[8], w[8];
    uint32_t i, first;
    if (b->type == TETCAST_TYPE_F32 || adapted == 255u) return tetcasti_place8(TETCAST_TYPE_F32, b, p, f);
    if (adapted != 0) { /* both, each with addresses that are good */
        first = tetcasti_ctz64(adapted);
        for (i = 0; i < 8; i++) q[i] = adapted >> i & 1u ? p[i] : p[first];
        _mm256_storeu_ps(v, tetcasti_place8(TETCAST_TYPE_F32, b, q, f));
        first = tetcasti_ctz64(~adapted);
        for (i = 0; i < 8; i++) q[i] = adapted >> i & 1u ? p[first] : p[i];
    } else {
        memcpy(q, p, sizeof q);
        memset(v, 0, sizeof v);
    }
    if (b->type == TETCAST_TYPE_U8) _mm256_storeu_ps(w, tetcasti_place8(TETCAST_TYPE_U8, b, q, f));
    else if (b->type == TETCAST_TYPE_U16) _mm256_storeu_ps(w, tetcasti_place8(TETCAST_TYPE_U16, b, q, f));
    else _mm256_storeu_ps(w, tetcasti_place8(TETCAST_TYPE_F16, b, q, f));
    for (i = 0; i < 8; i++) w[i] = adapted >> i & 1u ? v[i] : w[i];
    return _mm256_loadu_ps(w);
}

TETCASTI_TARGET_AVX2 static void tetcasti_cut_value8(const tetcast_cut *cut, const float *x, const float *y,
                                                  const float *z, size_t count, float *out) {
    const tetcast_bricks *b = cut->bricks;
    const float *in[3];
    const __m256i cells = _mm256_set1_epi32((1 << b->log) - 1), side = _mm256_set1_epi32((int32_t)b->side);
    const __m128i log = _mm_cvtsi32_si128((int32_t)b->log);
    size_t i;
    in[0] = x;
    in[1] = y;
    in[2] = z;
    for (i = 0; i < count; i += 8) {
        __m256i s[3], slot, k, node = _mm256_setzero_si256();
        __m256 f[3], v[3], half;
        int32_t word[8], at[8];
        const uint8_t *p[8];
        uint32_t a, j, adapted;
        for (a = 0; a < 3; a++) {
            v[a] = _mm256_min_ps(_mm256_max_ps(_mm256_loadu_ps(in[a] + i), _mm256_setzero_ps()),
                                 _mm256_set1_ps((float)(int32_t)(b->lattice.dims[a] - 1)));
            s[a] = _mm256_min_epi32(_mm256_srl_epi32(_mm256_cvttps_epi32(v[a]), log),
                                    _mm256_set1_epi32((int32_t)b->slots[a] - 1));
        }
        slot = _mm256_add_epi32(s[0], _mm256_mullo_epi32(_mm256_set1_epi32((int32_t)b->slots[0]),
            _mm256_add_epi32(s[1], _mm256_mullo_epi32(_mm256_set1_epi32((int32_t)b->slots[1]), s[2]))));
        if (_mm256_movemask_epi8(_mm256_cmpeq_epi32(slot, _mm256_broadcastd_epi32(_mm256_castsi256_si128(slot)))) == -1) {
            /* all in one slot, as a rule: one block for all */
            const uint32_t one = cut->slot[(uint32_t)_mm256_cvtsi256_si32(slot)], level = one >> TETCASTI_LEVEL_SHIFT & 15u;
            const __m256 scale = _mm256_set1_ps(1.0f / (float)(1u << level));
            uint32_t type, bytes;
            const uint8_t *block = tetcasti_slot_block(cut, one, &type);
            for (a = 3; a-- > 0;) {
                const uint32_t start = (uint32_t)_mm256_cvtsi256_si32(s[a]) >> level << level << b->log;
                const __m256 u = _mm256_mul_ps(_mm256_sub_ps(v[a], _mm256_set1_ps((float)(int32_t)start)), scale);
                const __m256i n = _mm256_min_epi32(_mm256_cvttps_epi32(u), cells);
                f[a] = _mm256_sub_ps(u, _mm256_cvtepi32_ps(n));
                node = _mm256_add_epi32(_mm256_mullo_epi32(node, side), n);
            }
            bytes = one & TETCASTI_ADAPTED ? 4u : b->bytes;
            _mm256_storeu_si256((__m256i *)(void *)at, node);
            for (j = 0; j < 8; j++) p[j] = block + (size_t)(uint32_t)at[j] * bytes;
            _mm256_storeu_ps(out + i, tetcasti_places8(b, p, one & TETCASTI_ADAPTED ? 255u : 0u, (const __m256 *)f));
            continue;
        }
        slot = _mm256_i32gather_epi32((const int *)(const void *)cut->slot, slot, 4);
        k = _mm256_and_si256(_mm256_srli_epi32(slot, (int)TETCASTI_LEVEL_SHIFT), _mm256_set1_epi32(15));
        /* 2^-k as bits */
        half = _mm256_castsi256_ps(_mm256_slli_epi32(_mm256_sub_epi32(_mm256_set1_epi32(127), k), 23));
        for (a = 3; a-- > 0;) {
            const __m256i origin = _mm256_sll_epi32(_mm256_sllv_epi32(_mm256_srlv_epi32(s[a], k), k), log);
            const __m256 u = _mm256_mul_ps(_mm256_sub_ps(v[a], _mm256_cvtepi32_ps(origin)), half);
            const __m256i n = _mm256_min_epi32(_mm256_cvttps_epi32(u), cells);
            f[a] = _mm256_sub_ps(u, _mm256_cvtepi32_ps(n));
            node = _mm256_add_epi32(_mm256_mullo_epi32(node, side), n);
        }
        adapted = (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(slot));
        _mm256_storeu_si256((__m256i *)(void *)word, slot);
        _mm256_storeu_si256((__m256i *)(void *)at, node);
        for (j = 0; j < 8; j++) {
            uint32_t type;
            const uint8_t *block = tetcasti_slot_block(cut, (uint32_t)word[j], &type);
            p[j] = block + (size_t)(uint32_t)at[j] * (adapted >> j & 1u ? 4u : b->bytes);
        }
        _mm256_storeu_ps(out + i, tetcasti_places8(b, p, adapted, (const __m256 *)f));
    }
}
#endif

TETCAST_DEF void tetcast_cut_sample(const tetcast_cut *cut, const float *x, const float *y, const float *z, size_t count,
                                    tetcast_isa isa, float *out) {
    size_t i = 0;
#if TETCASTI_AVX2
    if (tetcast_isa_best() >= TETCAST_ISA_AVX2 && (isa == TETCAST_ISA_AUTO || isa >= TETCAST_ISA_AVX2)) {
        i = count & ~(size_t)7;
        tetcasti_cut_value8(cut, x, y, z, i, out);
    }
#endif
    (void)isa;
    for (; i < count; i++) {
        float p[3];
        tetcasti_point_clamp(cut->bricks, x[i], y[i], z[i], p);
        out[i] = tetcasti_cut_value(cut, p);
    }
}

TETCAST_DEF void tetcast_cut_gradient(const tetcast_cut *cut, const float *x, const float *y, const float *z,
                                      size_t count, float *out, float (*gradient)[3]) {
    size_t i;
    uint32_t a;
    for (i = 0; i < count; i++) {
        float p[3];
        tetcasti_point_clamp(cut->bricks, x[i], y[i], z[i], p);
        out[i] = tetcasti_cut_slope(cut, p, gradient[i]);
        for (a = 0; a < 3; a++) gradient[i][a] = (float)((double)gradient[i][a] / cut->bricks->lattice.spacing[a]);
    }
}

/* ---- cuts: choosing levels ---- */

TETCASTI_INLINE size_t tetcasti_slot_count(const tetcast_bricks *b) {
    return (size_t)b->slots[0] * b->slots[1] * b->slots[2];
}

/* The brick that a slot has on a level, or NONE. */
TETCASTI_INLINE uint32_t tetcasti_slot_brick(const tetcast_bricks *b, uint32_t level, uint32_t x, uint32_t y,
                                             uint32_t z) {
    return *tetcasti_bricks_at(b, level, x >> level, y >> level, z >> level);
}

static void tetcasti_cut_clamp(tetcast_cut *cut) { /* to what there is */
    const tetcast_bricks *b = cut->bricks;
    uint32_t x, y, z;
    size_t i = 0;
    for (z = 0; z < b->slots[2]; z++)
        for (y = 0; y < b->slots[1]; y++)
            for (x = 0; x < b->slots[0]; x++, i++) {
                uint32_t k = cut->level[i] < b->levels ? cut->level[i] : b->levels - 1;
                while (tetcasti_slot_brick(b, k, x, y, z) == TETCASTI_NONE) k++; /* the coarsest level is complete */
                cut->level[i] = (uint8_t)k;
            }
}

/* Neighbours no more than one level coarser: by refining, as far as there are finer bricks. */
static void tetcasti_cut_relax(tetcast_cut *cut, uint32_t jump) {
    const tetcast_bricks *b = cut->bricks;
    int changed = 1;
    while (changed) {
        uint32_t x, y, z, n;
        size_t i = 0;
        changed = 0;
        for (z = 0; z < b->slots[2]; z++)
            for (y = 0; y < b->slots[1]; y++)
                for (x = 0; x < b->slots[0]; x++, i++)
                    for (n = 0; n < 27; n++) {
                        const uint32_t nx = x + n % 3 - 1, ny = y + n / 3 % 3 - 1, nz = z + n / 9 - 1;
                        uint32_t most, k = cut->level[i];
                        if (nx >= b->slots[0] || ny >= b->slots[1] || nz >= b->slots[2]) continue;
                        most = cut->level[nx + (size_t)b->slots[0] * (ny + (size_t)b->slots[1] * nz)] + jump;
                        while (k > most && tetcasti_slot_brick(b, k - 1, x, y, z) != TETCASTI_NONE) k--;
                        if (k != cut->level[i]) {
                            cut->level[i] = (uint8_t)k;
                            changed = 1;
                        }
                    }
    }
}

typedef struct tetcasti_heap { uint32_t *brick; float *key; uint32_t count; } tetcasti_heap;

static void tetcasti_heap_push(tetcasti_heap *h, uint32_t brick, float key) {
    uint32_t i = h->count++;
    while (i > 0) {
        const uint32_t up = (i - 1) / 2;
        if (h->key[up] > key || (!(h->key[up] < key) && h->brick[up] < brick)) break;
        h->key[i] = h->key[up];
        h->brick[i] = h->brick[up];
        i = up;
    }
    h->key[i] = key;
    h->brick[i] = brick;
}

static uint32_t tetcasti_heap_pop(tetcasti_heap *h, float *key) {
    const uint32_t top = h->brick[0];
    uint32_t i = 0, last;
    float last_key;
    *key = h->key[0];
    last = h->brick[--h->count];
    last_key = h->key[h->count];
    for (;;) {
        uint32_t c = 2 * i + 1;
        if (c >= h->count) break;
        if (c + 1 < h->count && (h->key[c + 1] > h->key[c] || (!(h->key[c + 1] < h->key[c]) && h->brick[c + 1] < h->brick[c])))
            c++;
        if (last_key > h->key[c] || (!(last_key < h->key[c]) && last < h->brick[c])) break;
        h->brick[i] = h->brick[c];
        h->key[i] = h->key[c];
        i = c;
    }
    if (h->count != 0) {
        h->brick[i] = last;
        h->key[i] = last_key;
    }
    return top;
}

/* What a brick is refined for. */
static float tetcasti_cut_error(const tetcast_cut_desc *d, const tetcasti_brick *brick) {
    if (d->optics != NULL && tetcasti_optics_empty(d->optics, brick->lo - brick->error, brick->hi + brick->error))
        return 0.0f;
    return brick->error;
}

/* Slots of a brick that are in the lattice. */
static uint64_t tetcasti_brick_slots(const tetcast_bricks *b, const tetcasti_brick *brick) {
    uint64_t n = 1;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const uint32_t first = brick->place[a] << brick->level, size = 1u << brick->level;
        n *= b->slots[a] - first < size ? b->slots[a] - first : size;
    }
    return n;
}

static void tetcasti_brick_show(tetcast_cut *cut, const tetcasti_brick *brick) {
    const tetcast_bricks *b = cut->bricks;
    uint32_t lo[3], hi[3], y, z, a;
    for (a = 0; a < 3; a++) {
        lo[a] = brick->place[a] << brick->level;
        hi[a] = lo[a] + (1u << brick->level) < b->slots[a] ? lo[a] + (1u << brick->level) : b->slots[a];
    }
    for (z = lo[2]; z < hi[2]; z++)
        for (y = lo[1]; y < hi[1]; y++)
            memset(cut->level + lo[0] + (size_t)b->slots[0] * (y + (size_t)b->slots[1] * z), (int)brick->level, hi[0] - lo[0]);
}

/* Refine from the coarsest down where the error is largest. 0: no memory. */
static int tetcasti_cut_greedy(tetcast_cut *cut, const tetcast_cut_desc *d) {
    const tetcast_bricks *b = cut->bricks;
    const uint64_t brick_bytes = (uint64_t)b->nodes * b->bytes;
    const double all = (double)tetcasti_slot_count(b);
    tetcasti_heap h;
    uint64_t bytes = 0;
    double samples = 0.0;
    uint32_t i;
    memset(&h, 0, sizeof h);
    h.brick = (uint32_t *)tetcasti_alloc_array(&cut->mem, (size_t)b->count + 1, sizeof *h.brick);
    h.key = (float *)tetcasti_alloc_array(&cut->mem, (size_t)b->count + 1, sizeof *h.key);
    if (h.brick != NULL && h.key != NULL) {
        for (i = 0; i < b->count && b->brick[i].level == b->levels - 1; i++) { /* they come first */
            tetcasti_brick_show(cut, &b->brick[i]);
            bytes += brick_bytes;
            samples += (double)tetcasti_brick_slots(b, &b->brick[i]) / (double)(1u << b->brick[i].level) / all;
            tetcasti_heap_push(&h, i, tetcasti_cut_error(d, &b->brick[i]));
        }
        while (h.count != 0) {
            float error;
            const tetcasti_brick *brick = &b->brick[tetcasti_heap_pop(&h, &error)];
            uint32_t child[8], n = 0, c;
            double finer;
            if (!(error > d->max_error)) break;
            if (brick->level == 0) continue;
            for (c = 0; c < 8; c++) {
                const uint32_t x = 2 * brick->place[0] + (c & 1u), y = 2 * brick->place[1] + (c >> 1 & 1u),
                    z = 2 * brick->place[2] + (c >> 2), *g = b->grid[brick->level - 1];
                if (x >= g[0] || y >= g[1] || z >= g[2]) continue;
                child[n] = *tetcasti_bricks_at(b, brick->level - 1, x, y, z);
                if (child[n] != TETCASTI_NONE) n++;
            }
            if (n == 0) continue;
            finer = (double)tetcasti_brick_slots(b, brick) / (double)(1u << brick->level) / all;
            if (d->byte_budget != 0 && bytes + (n - 1) * brick_bytes > d->byte_budget) continue;
            if (d->sample_budget > 0.0 && samples + finer > d->sample_budget) continue;
            bytes += (n - 1) * brick_bytes;
            samples += finer;
            for (c = 0; c < n; c++) {
                tetcasti_brick_show(cut, &b->brick[child[c]]);
                tetcasti_heap_push(&h, child[c], tetcasti_cut_error(d, &b->brick[child[c]]));
            }
        }
    }
    tetcasti_free(&cut->mem, h.brick);
    tetcasti_free(&cut->mem, h.key);
    return h.brick != NULL && h.key != NULL;
}

static int tetcasti_cut_choose(tetcast_cut *cut, const tetcast_cut_desc *d) {
    const tetcast_bricks *b = cut->bricks;
    const size_t n = tetcasti_slot_count(b);
    uint32_t x, y, z, a;
    size_t i = 0;
    if (d->levels != NULL) memcpy(cut->level, d->levels, n);
    else if (d->byte_budget != 0 || d->sample_budget > 0.0 || d->max_error > 0.0f) {
        if (!tetcasti_cut_greedy(cut, d)) return 0;
    } else memset(cut->level, (int)(d->level < b->levels ? d->level : b->levels - 1), n);
    if (d->focus_radius > 0.0)
        for (z = 0; z < b->slots[2]; z++)
            for (y = 0; y < b->slots[1]; y++)
                for (x = 0; x < b->slots[0]; x++, i++) {
                    const uint32_t s[3] = {x, y, z};
                    double way = 0.0, far_off;
                    for (a = 0; a < 3; a++) {
                        const double c = b->lattice.origin[a] + ((double)s[a] + 0.5) * (double)(1u << b->log) *
                            b->lattice.spacing[a] - d->focus[a];
                        way += c * c;
                    }
                    far_off = sqrt(way) / d->focus_radius;
                    cut->level[i] = (uint8_t)(far_off < (double)b->levels ? (uint32_t)far_off : b->levels - 1);
                    if (cut->level[i] < d->level) cut->level[i] = (uint8_t)d->level;
                }
    tetcasti_cut_clamp(cut);
    if (d->max_jump != 0) tetcasti_cut_relax(cut, d->max_jump);
    return 1;
}

/* ---- cuts: borders ---- */

typedef struct tetcasti_adapt {
    tetcast_cut *cut;
    uint32_t *list;    /* adapted bricks of a level, by number of their copy */
} tetcasti_adapt;

/* Does a slot touch a coarser one? */
static int tetcasti_slot_touches(const tetcast_cut *cut, uint32_t x, uint32_t y, uint32_t z, uint32_t level) {
    const tetcast_bricks *b = cut->bricks;
    uint32_t lo[3], hi[3], i, j, k;
    lo[0] = x > 0 ? x - 1 : 0;
    lo[1] = y > 0 ? y - 1 : 0;
    lo[2] = z > 0 ? z - 1 : 0;
    hi[0] = x + 1 < b->slots[0] ? x + 1 : x;
    hi[1] = y + 1 < b->slots[1] ? y + 1 : y;
    hi[2] = z + 1 < b->slots[2] ? z + 1 : z;
    for (k = lo[2]; k <= hi[2]; k++)
        for (j = lo[1]; j <= hi[1]; j++) {
            const uint8_t *row = cut->level + (size_t)b->slots[0] * (j + (size_t)b->slots[1] * k);
            for (i = lo[0]; i <= hi[0]; i++)
                if (row[i] > level) return 1;
        }
    return 0;
}

/* Values of the coarser block along a line of its nodes, n of them, between four lines `up` and `ahead` apart. */
TETCASTI_INLINE void tetcasti_border_line(const tetcast_bricks *b, const uint8_t *block, const uint32_t type,
                                          size_t node, size_t step, size_t n, size_t up, float fz, size_t ahead,
                                          float fy, float *line) {
    size_t i;
    for (i = 0; i < n; i++, node += step) {
        float v = tetcasti_block_get(b, block, type, node);
        if (ahead != 0) v = v + fy * (tetcasti_block_get(b, block, type, node + ahead) - v);
        if (up != 0) {
            float w = tetcasti_block_get(b, block, type, node + up);
            if (ahead != 0) w = w + fy * (tetcasti_block_get(b, block, type, node + up + ahead) - w);
            v = v + fz * (w - v);
        }
        line[i] = v;
    }
}

/* Nodes of a finer brick from the coarser one in `word`: those from r0 to r1 (in the finer one's numbers) take its
   values. first: lattice coordinates of the finer brick's node 0, start: of the coarser one's; kf, ko: levels. Lines run
   along an axis of the face or edge that both share. */
static void tetcasti_border_copy(const tetcast_cut *cut, float *to, uint32_t word, const uint32_t r0[3],
                                 const uint32_t r1[3], const uint32_t first[3], uint32_t kf, const uint32_t start[3],
                                 uint32_t ko) {
    const tetcast_bricks *b = cut->bricks;
    const size_t stride[3] = {1, b->side, (size_t)b->side * b->side};
    const uint32_t cells = 1u << b->log, mask = (1u << ko) - 1u;
    const uint32_t p = r1[0] > r0[0] ? 0 : r1[1] > r0[1] ? 1 : 2, q = p == 0 ? 1 : 0, r = p == 2 ? 1 : 2;
    const float part = 1.0f / (float)(1u << ko);
    const uint32_t begin = first[p] + (r0[p] << kf) - start[p], end = first[p] + (r1[p] << kf) - start[p];
    const uint32_t i0 = begin >> ko, i1 = (end >> ko) + ((end & mask) != 0);
    float line[34];
    uint32_t type, x, y, z;
    const uint8_t *block = tetcasti_slot_block(cut, word, &type);
    for (z = r0[r]; z <= r1[r]; z++)
        for (y = r0[q]; y <= r1[q]; y++) {
            const uint32_t pz = first[r] + (z << kf) - start[r], py = first[q] + (y << kf) - start[q];
            const uint32_t sz = pz & mask, sy = py & mask;
            const float fz = (float)sz * part, fy = (float)sy * part;
            const size_t up = sz != 0 ? stride[r] : 0, ahead = sy != 0 ? stride[q] : 0;
            const size_t node = stride[r] * (pz >> ko) + stride[q] * (py >> ko) + stride[p] * i0, n = i1 - i0 + 1;
            float *out = to + stride[r] * z + stride[q] * y + stride[p] * r0[p];
            if (n > 33 || (pz >> ko) > cells || (py >> ko) > cells) return; /* cannot be */
            if (type == TETCAST_TYPE_F32)
                tetcasti_border_line(b, block, TETCAST_TYPE_F32, node, stride[p], n, up, fz, ahead, fy, line);
            else tetcasti_border_line(b, block, type, node, stride[p], n, up, fz, ahead, fy, line);
            line[n] = line[n - 1];
            for (x = begin; x <= end; x += 1u << kf, out += stride[p]) {
                const uint32_t i = (x >> ko) - i0;
                *out = line[i] + (float)(x & mask) * part * (line[i + 1] - line[i]);
            }
        }
}

/* Adapt one brick: all of its slots, all of their neighbours that are coarser. */
static void tetcasti_task_adapt(void *ctx, uint32_t task) {
    const tetcasti_adapt *t = (const tetcasti_adapt *)ctx;
    tetcast_cut *cut = t->cut;
    const tetcast_bricks *b = cut->bricks;
    const uint32_t number = t->list[task], log = b->log, cells = 1u << log;
    const uint32_t source = cut->source[number];
    const tetcasti_brick *brick = &b->brick[source];
    const uint8_t *block = tetcasti_brick_block(b, source);
    float *to = cut->adapted + (size_t)number * b->nodes, lo = brick->lo, hi = brick->hi;
    uint32_t first[3], k = brick->level, size = 1u << k, s[3], a, n;
    size_t i;
    if (b->type == TETCAST_TYPE_F32) memcpy(to, block, b->nodes * 4);
    else for (i = 0; i < b->nodes; i++) to[i] = tetcasti_node_get(b, block, i);
    for (a = 0; a < 3; a++) first[a] = brick->place[a] << k << log;
    for (i = 0; i < (size_t)size * size * size; i++) {
        size_t here;
        s[0] = (brick->place[0] << k) + (uint32_t)i % size;
        s[1] = (brick->place[1] << k) + (uint32_t)i / size % size;
        s[2] = (brick->place[2] << k) + (uint32_t)i / size / size;
        if (s[0] >= b->slots[0] || s[1] >= b->slots[1] || s[2] >= b->slots[2]) continue;
        here = s[0] + (size_t)b->slots[0] * (s[1] + (size_t)b->slots[1] * s[2]);
        if (cut->level[here] != k) continue;
        for (n = 0; n < 27; n++) {
            const uint32_t d[3] = {n % 3, n / 3 % 3, n / 9};
            uint32_t o[3], r0[3], r1[3], start[3], ko, word;
            size_t there;
            for (a = 0; a < 3; a++) o[a] = s[a] + d[a] - 1;
            if (o[0] >= b->slots[0] || o[1] >= b->slots[1] || o[2] >= b->slots[2]) continue;
            there = o[0] + (size_t)b->slots[0] * (o[1] + (size_t)b->slots[1] * o[2]);
            ko = cut->level[there];
            if (ko <= k) continue;
            word = cut->slot[there];
            for (a = 0; a < 3; a++) { /* the face, edge or corner that both have */
                uint32_t p0 = s[a] << log, p1 = p0 + cells;
                if (d[a] == 0) p1 = p0;
                if (d[a] == 2) p0 = p1;
                r0[a] = (p0 - first[a]) >> k;
                r1[a] = (p1 - first[a] + size - 1) >> k;
                start[a] = o[a] >> ko << ko << log;
            }
            tetcasti_border_copy(cut, to, word, r0, r1, first, k, start, ko);
            lo = cut->range[there][0] < lo ? cut->range[there][0] : lo;
            hi = cut->range[there][1] > hi ? cut->range[there][1] : hi;
        }
    }
    for (i = 0; i < (size_t)size * size * size; i++) {
        size_t here;
        s[0] = (brick->place[0] << k) + (uint32_t)i % size;
        s[1] = (brick->place[1] << k) + (uint32_t)i / size % size;
        s[2] = (brick->place[2] << k) + (uint32_t)i / size / size;
        if (s[0] >= b->slots[0] || s[1] >= b->slots[1] || s[2] >= b->slots[2]) continue;
        here = s[0] + (size_t)b->slots[0] * (s[1] + (size_t)b->slots[1] * s[2]);
        if (cut->level[here] != k) continue;
        cut->range[here][0] = lo;
        cut->range[here][1] = hi;
    }
}

/* Which bricks are shown, which have to be copied; then borders, coarse before fine. 0: no memory. */
static int tetcasti_cut_adapt(tetcast_cut *cut, const tetcast_env *env) {
    const tetcast_bricks *b = cut->bricks;
    uint32_t *copy = (uint32_t *)tetcasti_alloc_zero(&cut->mem, b->count, sizeof *copy); /* 1 shown, 2 touches */
    uint32_t first[TETCAST_BRICK_LEVELS + 2], x, y, z, k, n;
    tetcasti_adapt t;
    size_t i, all = tetcasti_slot_count(b);
    memset(&t, 0, sizeof t);
    memset(first, 0, sizeof first);
    if (copy == NULL) return 0;
    for (i = 0, z = 0; z < b->slots[2]; z++)
        for (y = 0; y < b->slots[1]; y++)
            for (x = 0; x < b->slots[0]; x++, i++) {
                const uint32_t level = cut->level[i], brick = tetcasti_slot_brick(b, level, x, y, z);
                cut->slot[i] = brick | level << TETCASTI_LEVEL_SHIFT;
                cut->range[i][0] = b->brick[brick].lo;
                cut->range[i][1] = b->brick[brick].hi;
                copy[brick] |= 1u;
                if (level + 1 < b->levels && !(copy[brick] & 2u) && tetcasti_slot_touches(cut, x, y, z, level))
                    copy[brick] |= 2u;
            }
    for (n = 0; n < b->count; n++) {
        cut->info.bricks += copy[n] & 1u;
        if (copy[n] & 2u) first[b->brick[n].level + 1]++;
        if ((copy[n] & 1u) && b->brick[n].error > cut->info.error) cut->info.error = b->brick[n].error;
    }
    for (k = 0; k <= TETCAST_BRICK_LEVELS; k++) first[k + 1] += first[k];
    cut->adapted_count = first[TETCAST_BRICK_LEVELS];
    cut->adapted = (float *)tetcasti_alloc_array(&cut->mem, (size_t)cut->adapted_count * b->nodes + 16, sizeof(float));
    cut->source = (uint32_t *)tetcasti_alloc_array(&cut->mem, (size_t)cut->adapted_count + 1, sizeof *cut->source);
    t.list = (uint32_t *)tetcasti_alloc_array(&cut->mem, (size_t)cut->adapted_count + 1, sizeof *t.list);
    if (cut->adapted == NULL || cut->source == NULL || t.list == NULL) {
        tetcasti_free(&cut->mem, copy);
        tetcasti_free(&cut->mem, t.list);
        return 0;
    }
    memset(cut->adapted + (size_t)cut->adapted_count * b->nodes, 0, 16 * sizeof(float));
    for (n = 0; n < b->count; n++) {
        if (!(copy[n] & 2u)) {
            copy[n] = TETCASTI_NONE;
            continue;
        }
        copy[n] = first[b->brick[n].level]++;
        cut->source[copy[n]] = n;
    }
    for (i = 0; i < all; i++) {
        const uint32_t brick = cut->slot[i] & TETCASTI_SLOT_MASK;
        if (copy[brick] != TETCASTI_NONE)
            cut->slot[i] = copy[brick] | (uint32_t)cut->level[i] << TETCASTI_LEVEL_SHIFT | TETCASTI_ADAPTED;
    }
    t.cut = cut;
    for (k = b->levels; k-- > 0;) {
        const uint32_t from = k == 0 ? 0 : first[k - 1], to = first[k];
        for (n = from; n < to; n++) t.list[n - from] = n;
        tetcasti_parallel_for(env, tetcasti_task_adapt, &t, to - from);
    }
    tetcasti_free(&cut->mem, copy);
    tetcasti_free(&cut->mem, t.list);
    return 1;
}

static void tetcasti_cut_measure(tetcast_cut *cut) {
    const tetcast_bricks *b = cut->bricks;
    const size_t n = tetcasti_slot_count(b);
    size_t i;
    cut->info.adapted = cut->adapted_count;
    cut->info.bytes = cut->info.bricks * b->nodes * b->bytes;
    cut->info.full_bytes = (uint64_t)n * b->nodes * b->bytes;
    for (i = 0; i < n; i++) {
        cut->info.level_slots[cut->level[i]]++;
        cut->info.samples += 1.0 / (double)(1u << cut->level[i]);
    }
    cut->info.samples /= (double)n;
}

TETCAST_DEF void tetcast_cut_destroy(tetcast_cut *cut) {
    tetcasti_mem mem;
    if (cut == NULL) return;
    mem = cut->mem;
    tetcasti_free(&mem, cut->level);
    tetcasti_free(&mem, cut->slot);
    tetcasti_free(&mem, cut->range);
    tetcasti_free(&mem, cut->adapted);
    tetcasti_free(&mem, cut->source);
    tetcasti_free(&mem, cut);
}

TETCAST_DEF tetcast_result tetcast_cut_create(const tetcast_cut_desc *desc, const tetcast_bricks *bricks,
                                              tetcast_cut **out) {
    tetcast_cut_desc d;
    tetcasti_mem mem;
    tetcast_result r;
    tetcast_cut *cut;
    uint32_t a;
    size_t n;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (out != NULL) *out = NULL;
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    r = tetcasti_env_open(&d.env, &mem);
    if (r != TETCAST_OK) return r;
    for (a = 0; a < 3; a++)
        if (!tetcasti_finite(d.focus[a])) r = TETCAST_ERR_INVALID_ARG;
    if (r != TETCAST_OK || bricks == NULL || out == NULL || !(d.focus_radius >= 0.0) || !(d.sample_budget >= 0.0) ||
        !(d.max_error >= 0.0f))
        return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, 0, "cut: bad option");
    cut = (tetcast_cut *)tetcasti_alloc_zero(&mem, 1, sizeof *cut);
    if (cut == NULL) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "cut: out of memory");
    cut->mem = mem;
    cut->bricks = bricks;
    n = tetcasti_slot_count(bricks);
    cut->level = (uint8_t *)tetcasti_alloc_zero(&cut->mem, n, 1);
    cut->slot = (uint32_t *)tetcasti_alloc_array(&cut->mem, n, sizeof *cut->slot);
    cut->range = (float (*)[2])tetcasti_alloc_array(&cut->mem, n, sizeof *cut->range);
    if (cut->level == NULL || cut->slot == NULL || cut->range == NULL || !tetcasti_cut_choose(cut, &d) ||
        !tetcasti_cut_adapt(cut, &d.env)) {
        tetcast_cut_destroy(cut);
        return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "cut: out of memory");
    }
    tetcasti_cut_measure(cut);
    *out = cut;
    return TETCAST_OK;
}

TETCAST_DEF void tetcast_cut_get_info(const tetcast_cut *cut, tetcast_cut_info *info) {
    if (info != NULL) memset(info, 0, sizeof *info);
    if (cut != NULL && info != NULL) *info = cut->info;
}
TETCAST_DEF const uint8_t *tetcast_cut_levels(const tetcast_cut *cut) { return cut != NULL ? cut->level : NULL; }

TETCAST_DEF void tetcast_bricks_get_info(const tetcast_bricks *b, tetcast_bricks_info *info) {
    uint32_t i;
    if (info != NULL) memset(info, 0, sizeof *info);
    if (b == NULL || info == NULL) return;
    info->lattice = b->lattice;
    info->levels = b->levels;
    info->cells = 1u << b->log;
    memcpy(info->slots, b->slots, sizeof info->slots);
    info->storage = b->type;
    info->value_min = b->value_min;
    info->value_max = b->value_max;
    info->step = b->type == TETCAST_TYPE_U8 || b->type == TETCAST_TYPE_U16 ? b->step : 0.0f;
    info->bricks = b->count;
    info->nodes = (uint64_t)b->count * b->nodes;
    for (i = 0; i < b->count; i++) {
        const tetcasti_brick *k = &b->brick[i];
        info->level_bricks[k->level]++;
        info->leaves += k->level == 0 ||
            *tetcasti_bricks_at(b, k->level - 1, 2 * k->place[0], 2 * k->place[1], 2 * k->place[2]) == TETCASTI_NONE;
    }
    info->hull_triangles = b->face_count;
    info->bytes = b->mem.used;
}

/* ---- bricks of a mesh ---- */

/* Nodes without a value take the nearest one of their row, then of their column. */
static void tetcasti_lattice_fill(const tetcast_lattice *l, float *v) {
    const size_t n[3] = {l->dims[0], l->dims[1], l->dims[2]}, step[3] = {1, n[0], n[0] * n[1]};
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const uint32_t p = a == 0 ? 1 : 0, q = a == 2 ? 1 : 2;
        size_t i, j, k;
        for (j = 0; j < n[q]; j++)
            for (i = 0; i < n[p]; i++) {
                float *row = v + i * step[p] + j * step[q];
                size_t last = n[a]; /* the last one with a value */
                for (k = 0; k < n[a]; k++) {
                    size_t m, from;
                    if (!(row[k * step[a]] == row[k * step[a]])) continue;
                    from = last == n[a] ? 0 : last + 1;
                    for (m = from; m < k; m++)
                        row[m * step[a]] = last != n[a] && m - last <= k - m ? row[last * step[a]] : row[k * step[a]];
                    last = k;
                }
                if (last == n[a]) continue;
                for (k = last + 1; k < n[a]; k++) row[k * step[a]] = row[last * step[a]];
            }
    }
}

/* The hull of a mesh, to clip pictures with. 0: no memory. */
static int tetcasti_bricks_hull(tetcast_bricks *b, const tetcast_mesh *mesh) {
    uint32_t *place = (uint32_t *)tetcasti_alloc_zero(&b->mem, (size_t)mesh->vertex_count + 1, sizeof *place), i, k;
    uint32_t n = 0;
    if (place == NULL) return 0;
    for (i = 0; i < mesh->face_count; i++)
        for (k = 0; k < 3; k++)
            if (place[mesh->face[i].v[k]] == 0) place[mesh->face[i].v[k]] = ++n;
    b->hull = (double (*)[3])tetcasti_alloc_array(&b->mem, (size_t)n + 1, sizeof *b->hull);
    b->face = (uint32_t (*)[3])tetcasti_alloc_array(&b->mem, (size_t)mesh->face_count + 1, sizeof *b->face);
    if (b->hull != NULL && b->face != NULL) {
        for (i = 0; i < mesh->face_count; i++)
            for (k = 0; k < 3; k++) {
                const uint32_t v = mesh->face[i].v[k];
                b->face[i][k] = place[v] - 1;
                tetcast_mesh_vertex(mesh, v, b->hull[place[v] - 1], NULL, NULL);
            }
        b->hull_count = n;
        b->face_count = mesh->face_count;
    }
    tetcasti_free(&b->mem, place);
    return b->hull != NULL && b->face != NULL;
}

/* How far bricks are from the mesh: at all vertices, and at random points of random cells. force: slots where it is too
   far and could be finer, *helps of them; may be NULL. */
static tetcast_result tetcasti_bricks_check(const tetcast_bricks_desc *d, const tetcast_mesh *mesh,
                                            const tetcast_bricks *b, uint8_t *force, uint32_t *helps,
                                            tetcast_bricks_report *report) {
    const uint32_t random = d->checks != 0 ? d->checks : 200000;
    const uint64_t all = (uint64_t)mesh->vertex_count + random;
    tetcast_cut_desc cd;
    tetcast_cut *cut;
    tetcast_result r;
    uint64_t i, seed = 1;
    double sum = 0.0;
    uint32_t a, k;
    memset(&cd, 0, sizeof cd);
    cd.env = d->env;
    r = tetcast_cut_create(&cd, b, &cut);
    if (r != TETCAST_OK) return r;
    report->checks = report->above = 0;
    report->error = 0.0;
    *helps = 0;
    for (i = 0; i < all; i++) {
        double p[3], v = 0.0, away;
        float x[3];
        if (i < mesh->vertex_count && mesh->cell_value == NULL) {
            const tetcasti_vertex *q = &mesh->vertex[i];
            p[0] = (double)q->x;
            p[1] = (double)q->y;
            p[2] = (double)q->z;
            v = (double)q->s;
        } else {
            double w[4], whole = 0.0;
            const uint32_t *t;
            uint32_t cell;
            seed = tetcasti_hash_mix(seed, i);
            cell = (uint32_t)((seed >> 32) * mesh->cell_count >> 32);
            t = mesh->tet[cell];
            if (mesh->hidden != NULL && (mesh->hidden[cell >> 5] >> (cell & 31u) & 1u)) continue;
            for (k = 0; k < 4; k++) { /* exponential numbers make even points of a simplex */
                seed = tetcasti_hash_mix(seed, k);
                w[k] = -tetcasti_log2(((double)(uint32_t)(seed >> 32) + 0.5) * (1.0 / 4294967296.0));
                whole += w[k];
            }
            p[0] = p[1] = p[2] = 0.0;
            for (k = 0; k < 4; k++) {
                const tetcasti_vertex *q = &mesh->vertex[t[k]];
                p[0] += w[k] / whole * (double)q->x;
                p[1] += w[k] / whole * (double)q->y;
                p[2] += w[k] / whole * (double)q->z;
                v += w[k] / whole * (double)q->s;
            }
            if (mesh->cell_value != NULL) v = (double)mesh->cell_value[cell];
        }
        for (a = 0; a < 3; a++)
            x[a] = (float)((mesh->origin[a] + p[a] * mesh->unit - b->lattice.origin[a]) / b->lattice.spacing[a]);
        tetcasti_point_clamp(b, x[0], x[1], x[2], x);
        away = tetcasti_abs((double)tetcasti_cut_value(cut, x) - v);
        report->checks++;
        if (d->max_error > 0.0f && away > (double)d->max_error) {
            const uint32_t *n = b->slots, sx = (uint32_t)(int32_t)x[0] >> b->log, sy = (uint32_t)(int32_t)x[1] >> b->log,
                sz = (uint32_t)(int32_t)x[2] >> b->log;
            const size_t slot = (sx < n[0] ? sx : n[0] - 1) + (size_t)n[0] * ((sy < n[1] ? sy : n[1] - 1) +
                                (size_t)n[1] * (sz < n[2] ? sz : n[2] - 1));
            report->above++;
            if (force != NULL && cut->level[slot] != 0) {
                force[slot] = 1;
                (*helps)++;
            }
        }
        sum += away;
        if (away > report->error) {
            report->error = away;
            for (a = 0; a < 3; a++) report->worst[a] = mesh->origin[a] + p[a] * mesh->unit;
        }
    }
    report->mean_error = report->checks != 0 ? sum / (double)report->checks : 0.0;
    tetcast_cut_destroy(cut);
    return TETCAST_OK;
}

/* ---- growing bricks: from the coarsest level down, where the mesh asks for it ---- */

/* What one brick of the coarsest level and all below it become. */
typedef struct tetcasti_grown {
    uint32_t (*brick)[4];           /* level, place */
    float *error, *nodes;
    size_t count, brick_room, error_room, node_room;
    uint32_t short_of;              /* bricks of level 0 that are not good enough */
} tetcasti_grown;

typedef struct tetcasti_grower {
    const tetcast_mesh *mesh;
    tetcast_bricks *b;
    tetcasti_mem *mem;
    tetcasti_grown *grown;          /* per brick of the coarsest level */
    uint32_t *first, *list;         /* cells of each; numbers of the mesh */
    uint8_t *force;                 /* per slot: refine down to level 0 */
    uint8_t *hull;                  /* per cell, bits: has a face at the hull */
    float max_error;
    uint32_t failed;
} tetcasti_grower;

/* Box of a cell in lattice units of the finest level. */
TETCASTI_INLINE void tetcasti_grow_box(const tetcasti_grower *g, uint32_t cell, double lo[3], double hi[3]) {
    const tetcast_mesh *mesh = g->mesh;
    const tetcast_lattice *l = &g->b->lattice;
    uint32_t a, k;
    for (k = 0; k < 4; k++) {
        const tetcasti_vertex *v = &mesh->vertex[mesh->tet[cell][k]];
        const double p[3] = {(double)v->x, (double)v->y, (double)v->z};
        for (a = 0; a < 3; a++) {
            const double x = (p[a] * mesh->unit + (mesh->origin[a] - l->origin[a])) / l->spacing[a];
            lo[a] = k == 0 ? x : tetcasti_min(lo[a], x);
            hi[a] = k == 0 ? x : tetcasti_max(hi[a], x);
        }
    }
}

/* Nodes of level k from `start`, side of them a side. inside: those in the mesh; the others go on from it. */
static void tetcasti_grow_nodes(const tetcasti_grower *g, uint32_t k, const uint32_t start[3], uint32_t side,
                                const uint32_t *list, uint32_t count, uint32_t *hull, float *out, uint8_t *inside) {
    const tetcast_bricks *b = g->b;
    tetcast_lattice l = b->lattice, box;
    tetcasti_scan c;
    size_t i, n = (size_t)side * side * side;
    uint32_t a, pass, hulls = 0;
    for (a = 0; a < 3; a++) {
        l.spacing[a] *= (double)(1u << k);
        l.dims[a] = (uint32_t)(((uint64_t)l.dims[a] - 1 + (1u << k) - 1) >> k) + 1;
    }
    tetcasti_scan_open(&c, g->mesh, &l);
    for (a = 0; a < 3; a++) {
        c.lo[a] = (int32_t)start[a];
        c.hi[a] = (int32_t)(start[a] + side < l.dims[a] ? start[a] + side : l.dims[a]);
        c.stride[a] = a == 0 ? 1 : c.stride[a - 1] * (ptrdiff_t)side;
        box.dims[a] = side;
    }
    for (i = 0; i < n; i++) out[i] = (float)NAN;
    c.out = out;
    c.list = list;
    c.count = count;
    c.wide = tetcast_isa_best() >= TETCAST_ISA_AVX2;
    tetcasti_scan_run(&c);
    for (i = 0; i < n; i++) inside[i] = out[i] == out[i];
    for (i = 0; i < count; i++)
        if (g->hull[list[i] >> 3] >> (list[i] & 7u) & 1u) hull[hulls++] = list[i];
    c.list = hull;
    c.count = hulls;
    for (pass = 1; pass <= 2 && hulls != 0; pass++) {
        c.grow = 0.5 * (double)pass;
        tetcasti_scan_run(&c);
    }
    tetcasti_lattice_fill(&box, out);
    for (i = 0; i < n; i++) out[i] = out[i] == out[i] ? out[i] : 0.0f;
}

/* The largest difference of a brick of level k to the mesh: in the nodes of level k - 1 (`fine`; NULL: not there) and
   in the vertices of the mesh. */
static float tetcasti_grow_error(const tetcasti_grower *g, uint32_t k, const uint32_t place[3], const float *nodes,
                                 const float *fine, const uint8_t *inside, const uint32_t *list, uint32_t count) {
    const tetcast_mesh *mesh = g->mesh;
    const tetcast_bricks *b = g->b;
    const size_t side = b->side, wide = 2 * (side - 1) + 1;
    const float cells = (float)(1u << b->log);
    float worst = 0.0f;
    uint32_t i, j, a;
    size_t x, y, z;
    for (z = 0; fine != NULL && z < wide; z++)
        for (y = 0; y < wide; y++) {
            const size_t z0 = z / 2, z1 = z0 + (z & 1u), y0 = y / 2, y1 = y0 + (y & 1u);
            const float *r0 = nodes + side * (y0 + side * z0), *r1 = nodes + side * (y1 + side * z0);
            const float *r2 = nodes + side * (y0 + side * z1), *r3 = nodes + side * (y1 + side * z1);
            for (x = 0; x < wide; x++) {
                const size_t x0 = x / 2, x1 = x0 + (x & 1u), n = x + wide * (y + wide * z);
                const float m = 0.125f * (((r0[x0] + r0[x1]) + (r1[x0] + r1[x1])) + ((r2[x0] + r2[x1]) + (r3[x0] + r3[x1])));
                const float d = tetcasti_absf(m - fine[n]);
                worst = inside[n] && d > worst ? d : worst;
            }
        }
    if (mesh->cell_value != NULL) return worst;
    for (i = 0; i < count; i++)
        for (j = 0; j < 4; j++) {
            const tetcasti_vertex *v = &mesh->vertex[mesh->tet[list[i]][j]];
            const double p[3] = {(double)v->x, (double)v->y, (double)v->z};
            float f[3], c[8], d;
            size_t n = 0;
            for (a = 3; a-- > 0;) {
                const double at = (p[a] * mesh->unit + (mesh->origin[a] - b->lattice.origin[a])) / b->lattice.spacing[a];
                const float u = (float)(at / (double)(1u << k) - (double)place[a] * (double)(1u << b->log));
                uint32_t m;
                if (!(u >= 0.0f && u <= cells)) break;
                m = (uint32_t)(int32_t)u;
                m = m < (1u << b->log) ? m : (1u << b->log) - 1;
                f[a] = u - (float)(int32_t)m;
                n = n * side + m;
            }
            if (a != 0xffffffffu) continue;
            for (a = 0; a < 8; a++) c[a] = nodes[n + (a & 1u) + side * ((a >> 1 & 1u) + side * (a >> 2))];
            d = tetcasti_absf(tetcasti_trilinear(c, f) - v->s);
            worst = d > worst ? d : worst;
        }
    return worst;
}

/* Add a brick. 0: no memory. */
static int tetcasti_grow_add(tetcasti_grower *g, tetcasti_grown *out, uint32_t level, const uint32_t place[3],
                             const float *nodes, size_t stride_y, size_t stride_z) {
    const tetcast_bricks *b = g->b;
    size_t i, x, y, z;
    float *to;
    if (!tetcasti_grow(g->mem, (void **)&out->brick, &out->brick_room, out->count, out->count + 1, sizeof *out->brick) ||
        !tetcasti_grow(g->mem, (void **)&out->error, &out->error_room, out->count, out->count + 1, sizeof *out->error) ||
        !tetcasti_grow(g->mem, (void **)&out->nodes, &out->node_room, out->count * b->nodes, (out->count + 1) * b->nodes,
                       sizeof *out->nodes)) return 0;
    i = out->count++;
    out->brick[i][0] = level;
    for (x = 0; x < 3; x++) out->brick[i][1 + x] = place[x];
    out->error[i] = 0.0f;
    to = out->nodes + i * b->nodes;
    for (z = 0; z < b->side; z++)
        for (y = 0; y < b->side; y++, to += b->side) memcpy(to, nodes + stride_y * y + stride_z * z, b->side * sizeof *to);
    return 1;
}

static int tetcasti_grow_forced(const tetcasti_grower *g, uint32_t level, const uint32_t place[3]) {
    const tetcast_bricks *b = g->b;
    uint32_t lo[3], hi[3], x, y, z, a;
    if (g->force == NULL) return 0;
    for (a = 0; a < 3; a++) {
        lo[a] = place[a] << level;
        hi[a] = lo[a] + (1u << level) < b->slots[a] ? lo[a] + (1u << level) : b->slots[a];
    }
    for (z = lo[2]; z < hi[2]; z++)
        for (y = lo[1]; y < hi[1]; y++)
            for (x = lo[0]; x < hi[0]; x++)
                if (g->force[x + (size_t)b->slots[0] * (y + (size_t)b->slots[1] * z)]) return 1;
    return 0;
}

/* Look at brick `i` of the list and put what it needs below it. 0: no memory. */
static int tetcasti_grow_brick(tetcasti_grower *g, tetcasti_grown *out, size_t i, const uint32_t *list, uint32_t count) {
    tetcast_bricks *b = g->b;
    const uint32_t level = out->brick[i][0], place[3] = {out->brick[i][1], out->brick[i][2], out->brick[i][3]};
    const uint32_t cells = 1u << b->log, wide = 2 * cells + 1;
    uint32_t start[3], *sub, c, k, a, ok = 1;
    float *fine, error;
    uint8_t *inside;
    if (level == 0) {
        error = tetcasti_grow_error(g, 0, place, out->nodes + i * b->nodes, NULL, NULL, list, count);
        out->error[i] = error;
        out->short_of += error > g->max_error;
        return 1;
    }
    fine = (float *)tetcasti_alloc_array(g->mem, (size_t)wide * wide * wide, sizeof *fine);
    inside = (uint8_t *)tetcasti_alloc(g->mem, (size_t)wide * wide * wide);
    sub = (uint32_t *)tetcasti_alloc_array(g->mem, (size_t)count + 1, sizeof *sub);
    if (fine != NULL && inside != NULL && sub != NULL) {
        for (a = 0; a < 3; a++) start[a] = place[a] * 2 * cells;
        tetcasti_grow_nodes(g, level - 1, start, wide, list, count, sub, fine, inside);
        error = tetcasti_grow_error(g, level, place, out->nodes + i * b->nodes, fine, inside, list, count);
        out->error[i] = error;
        for (c = 0; c < 8 && ok && (error > g->max_error || tetcasti_grow_forced(g, level, place)); c++) {
            const uint32_t child[3] = {2 * place[0] + (c & 1u), 2 * place[1] + (c >> 1 & 1u), 2 * place[2] + (c >> 2)};
            const size_t from = (size_t)cells * ((c & 1u) + (size_t)wide * ((c >> 1 & 1u) + (size_t)wide * (c >> 2)));
            const double size = (double)(1u << (level - 1)), far_off = size * 1.01;
            uint32_t n = 0;
            if (child[0] >= b->grid[level - 1][0] || child[1] >= b->grid[level - 1][1] || child[2] >= b->grid[level - 1][2])
                continue;
            for (k = 0; k < count; k++) { /* what reaches into it, and a cell around it */
                double lo[3], hi[3];
                tetcasti_grow_box(g, list[k], lo, hi);
                for (a = 0; a < 3; a++) {
                    const double x = (double)child[a] * (double)cells * size;
                    if (hi[a] < x - far_off || lo[a] > x + (double)cells * size + far_off) break;
                }
                if (a == 3) sub[n++] = list[k];
            }
            ok = tetcasti_grow_add(g, out, level - 1, child, fine + from, wide, (size_t)wide * wide) &&
                 tetcasti_grow_brick(g, out, out->count - 1, sub, n);
        }
    } else {
        ok = 0;
    }
    tetcasti_free(g->mem, fine);
    tetcasti_free(g->mem, inside);
    tetcasti_free(g->mem, sub);
    return (int)ok;
}

static void tetcasti_task_grow(void *ctx, uint32_t i) {
    tetcasti_grower *g = (tetcasti_grower *)ctx;
    tetcast_bricks *b = g->b;
    const uint32_t top = b->levels - 1, *grid = b->grid[top], count = g->first[i + 1] - g->first[i];
    const uint32_t place[3] = {i % grid[0], i / grid[0] % grid[1], i / grid[0] / grid[1]};
    const uint32_t start[3] = {place[0] << b->log, place[1] << b->log, place[2] << b->log};
    float *nodes = (float *)tetcasti_alloc_array(g->mem, b->nodes, sizeof *nodes);
    uint8_t *inside = (uint8_t *)tetcasti_alloc(g->mem, b->nodes);
    uint32_t *hull = (uint32_t *)tetcasti_alloc_array(g->mem, (size_t)count + 1, sizeof *hull);
    int ok = nodes != NULL && inside != NULL && hull != NULL;
    if (ok) {
        tetcasti_grow_nodes(g, top, start, b->side, g->list + g->first[i], count, hull, nodes, inside);
        ok = tetcasti_grow_add(g, &g->grown[i], top, place, nodes, b->side, (size_t)b->side * b->side) &&
             tetcasti_grow_brick(g, &g->grown[i], 0, g->list + g->first[i], count);
    }
    tetcasti_free(g->mem, nodes);
    tetcasti_free(g->mem, inside);
    tetcasti_free(g->mem, hull);
    if (!ok) tetcasti_atomic_store(&g->failed, 1u);
}

/* Cells of each brick of the coarsest level: in it or one of its spacings away. 0: no memory. */
static int tetcasti_grow_bin(tetcasti_grower *g) {
    const tetcast_bricks *b = g->b;
    const uint32_t top = b->levels - 1, *grid = b->grid[top];
    const size_t bricks = (size_t)grid[0] * grid[1] * grid[2];
    const double size = (double)((uint64_t)1 << (b->log + top)), far_off = 1.01 * (double)(1u << top);
    uint32_t pass, i, a;
    uint64_t total = 0;
    g->first = (uint32_t *)tetcasti_alloc_zero(g->mem, bricks + 2, sizeof *g->first);
    if (g->first == NULL) return 0;
    for (pass = 0; pass < 2; pass++) {
        for (i = 0; i < g->mesh->cell_count; i++) {
            double lo[3], hi[3];
            uint32_t from[3], to[3], x, y, z;
            tetcasti_grow_box(g, i, lo, hi);
            for (a = 0; a < 3; a++) {
                const double p = (lo[a] - far_off) / size, q = (hi[a] + far_off) / size;
                from[a] = p > 0.0 ? p < (double)grid[a] ? (uint32_t)p : grid[a] - 1 : 0;
                to[a] = q > 0.0 ? q < (double)grid[a] ? (uint32_t)q : grid[a] - 1 : 0;
            }
            for (z = from[2]; z <= to[2]; z++)
                for (y = from[1]; y <= to[1]; y++)
                    for (x = from[0]; x <= to[0]; x++) {
                        const size_t k = x + (size_t)grid[0] * (y + (size_t)grid[1] * z);
                        if (pass == 0) {
                            g->first[k + 2]++;
                            total++;
                        } else {
                            g->list[g->first[k + 1]++] = i;
                        }
                    }
        }
        if (pass == 0) {
            size_t k;
            if (total >= 0xffffffffu) return 0;
            for (k = 2; k <= bricks; k++) g->first[k + 1] += g->first[k];
            g->list = (uint32_t *)tetcasti_alloc_array(g->mem, (size_t)total + 1, sizeof *g->list);
            if (g->list == NULL) return 0;
        }
    }
    return 1;
}

/* Nodes that bricks of one level share are those of the first one: far outside of the mesh they could differ. */
static void tetcasti_grow_agree(tetcast_bricks *b, uint32_t brick, float *nodes, float *const *all) {
    const tetcasti_brick *k = &b->brick[brick];
    const uint32_t cells = 1u << b->log, *g = b->grid[k->level];
    uint32_t n, a, x, y, z;
    for (n = 0; n < 13; n++) { /* neighbours with smaller numbers */
        const uint32_t d[3] = {n % 3, n / 3 % 3, n / 9};
        uint32_t o[3], lo[3], hi[3], from[3], other;
        for (a = 0; a < 3; a++) {
            o[a] = k->place[a] + d[a] - 1;
            lo[a] = d[a] == 2 ? cells : 0;
            hi[a] = d[a] == 0 ? 0 : cells;
            from[a] = d[a] == 0 ? cells : 0;
        }
        if (o[0] >= g[0] || o[1] >= g[1] || o[2] >= g[2]) continue;
        other = *tetcasti_bricks_at(b, k->level, o[0], o[1], o[2]);
        if (other == TETCASTI_NONE) continue;
        for (z = lo[2]; z <= hi[2]; z++)
            for (y = lo[1]; y <= hi[1]; y++)
                for (x = lo[0]; x <= hi[0]; x++)
                    nodes[x + b->side * (y + (size_t)b->side * z)] =
                        all[other][(x - lo[0] + from[0]) + b->side * ((y - lo[1] + from[1]) + (size_t)b->side * (z - lo[2] + from[2]))];
    }
}

/* All that was grown -> bricks in order. 0: no memory. */
static int tetcasti_grow_finish(tetcasti_grower *g) {
    tetcast_bricks *b = g->b;
    const uint32_t *grid = b->grid[b->levels - 1], tops = grid[0] * grid[1] * grid[2];
    float **nodes;
    size_t n = 0, i, j, bytes;
    uint32_t k, t;
    for (t = 0; t < tops; t++) n += g->grown[t].count;
    if (n >= TETCASTI_BRICKS_END || !tetcasti_mul_size(n, b->nodes * b->bytes, &bytes)) return 0;
    b->count = (uint32_t)n;
    b->brick = (tetcasti_brick *)tetcasti_alloc_zero(&b->mem, n, sizeof *b->brick);
    b->data = (uint8_t *)tetcasti_alloc(&b->mem, bytes + 64);
    nodes = (float **)tetcasti_alloc_zero(&b->mem, n, sizeof *nodes);
    if (b->brick == NULL || b->data == NULL || nodes == NULL) {
        tetcasti_free(&b->mem, nodes);
        return 0;
    }
    memset(b->data + bytes, 0, 64);
    for (t = 0; t < tops; t++)
        for (i = 0; i < g->grown[t].count; i++) { /* mark, then number in order */
            const uint32_t *q = g->grown[t].brick[i];
            *tetcasti_bricks_at(b, q[0], q[1], q[2], q[3]) = 0;
        }
    for (k = b->levels, n = 0; k-- > 0;)
        for (i = b->table_start[k]; i < b->table_start[k + 1]; i++)
            if (b->table[i] != TETCASTI_NONE) b->table[i] = (uint32_t)n++;
    for (t = 0; t < tops; t++)
        for (i = 0; i < g->grown[t].count; i++) {
            const uint32_t *q = g->grown[t].brick[i], at = *tetcasti_bricks_at(b, q[0], q[1], q[2], q[3]);
            tetcasti_brick *brick = &b->brick[at];
            brick->level = q[0];
            memcpy(brick->place, q + 1, sizeof brick->place);
            brick->error = g->grown[t].error[i];
            nodes[at] = g->grown[t].nodes + i * b->nodes;
        }
    for (n = 0; n < b->count; n++) tetcasti_grow_agree(b, (uint32_t)n, nodes[n], nodes);
    b->value_min = g->mesh->field[g->mesh->active].value_min;
    b->value_max = g->mesh->field[g->mesh->active].value_max;
    if (!(b->value_min <= b->value_max)) b->value_min = b->value_max = 0.0f;
    b->bias = b->value_min; /* integers clamp what lies beyond the hull */
    b->step = (b->value_max - b->value_min) / (b->type == TETCAST_TYPE_U8 ? 255.0f : 65535.0f);
    for (n = 0; n < b->count; n++) {
        uint8_t *block = b->data + n * b->nodes * b->bytes;
        b->brick[n].lo = TETCASTI_INF;
        b->brick[n].hi = -TETCASTI_INF;
        for (j = 0; j < b->nodes; j++) {
            float v;
            tetcasti_node_put(b, block, j, nodes[n][j]);
            v = tetcasti_node_get(b, block, j);
            b->brick[n].lo = v < b->brick[n].lo ? v : b->brick[n].lo;
            b->brick[n].hi = v > b->brick[n].hi ? v : b->brick[n].hi;
        }
    }
    tetcasti_free(&b->mem, nodes);
    return 1;
}

/* One lattice: grow, number, hull. *short_of: bricks of level 0 that are not good enough. */
static tetcast_result tetcasti_bricks_try(const tetcast_bricks_desc *d, const tetcast_mesh *mesh, uint32_t longest,
                                          uint8_t *force, uint32_t *short_of, tetcast_bricks **out) {
    const uint32_t log = d->log_cells != 0 ? d->log_cells : 4, levels = d->levels != 0 ? d->levels : log + 1;
    tetcasti_grower g;
    tetcasti_mem mem;
    tetcast_lattice l;
    tetcast_result r = tetcast_lattice_fit(mesh, longest, &l);
    uint32_t i, tops;
    int ok;
    *short_of = 0;
    if (r != TETCAST_OK) return tetcasti_fail(d->env.error, r, 0, "bricks: the mesh has no extent");
    memset(&g, 0, sizeof g);
    g.b = tetcasti_bricks_open(&d->env, &l, log, levels, d->storage, &r);
    if (g.b == NULL) return r;
    (void)tetcasti_env_open(&d->env, &mem);
    g.mesh = mesh;
    g.mem = &mem;
    g.max_error = d->max_error;
    g.force = force;
    tops = g.b->grid[levels - 1][0] * g.b->grid[levels - 1][1] * g.b->grid[levels - 1][2];
    g.grown = (tetcasti_grown *)tetcasti_alloc_zero(&mem, tops, sizeof *g.grown);
    g.hull = (uint8_t *)tetcasti_alloc_zero(&mem, (size_t)mesh->cell_count / 8 + 1, 1);
    ok = g.grown != NULL && g.hull != NULL && tetcasti_grow_bin(&g);
    if (ok) {
        for (i = 0; i < mesh->face_count; i++) g.hull[mesh->face[i].cell >> 3] |= (uint8_t)(1u << (mesh->face[i].cell & 7u));
        tetcasti_parallel_for(&d->env, tetcasti_task_grow, &g, tops);
        ok = !g.failed && tetcasti_grow_finish(&g) && tetcasti_bricks_hull(g.b, mesh);
        for (i = 0; i < tops; i++) *short_of += g.grown[i].short_of;
    }
    for (i = 0; g.grown != NULL && i < tops; i++) {
        tetcasti_free(&mem, g.grown[i].brick);
        tetcasti_free(&mem, g.grown[i].error);
        tetcasti_free(&mem, g.grown[i].nodes);
    }
    tetcasti_free(&mem, g.grown);
    tetcasti_free(&mem, g.hull);
    tetcasti_free(&mem, g.first);
    tetcasti_free(&mem, g.list);
    if (!ok) {
        tetcasti_bricks_free(g.b);
        return tetcasti_fail(d->env.error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
    }
    *out = g.b;
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_bricks_create_mesh(const tetcast_bricks_desc *desc, const tetcast_mesh *mesh,
                                                      tetcast_bricks_report *report, tetcast_bricks **out) {
    tetcast_bricks_desc d;
    tetcast_bricks_report mine;
    tetcasti_mem mem;
    tetcast_result r = tetcasti_bricks_desc_open(desc, &d, report, out);
    uint32_t longest, end, short_of, again, helps = 0;
    uint8_t *force = NULL;
    if (r != TETCAST_OK) return r;
    if (report == NULL) report = &mine;
    memset(report, 0, sizeof *report);
    end = d.longest_end != 0 ? d.longest_end : 4097;
    longest = d.longest != 0 ? d.longest : end < 257 ? end : 257;
    if (mesh == NULL || mesh->tet == NULL || longest < 2 || (d.longest == 0 && !(d.max_error > 0.0f)) ||
        longest > 16385 || end > 16385)
        return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, 0, "bricks: needs tets, and max_error or longest");
    r = tetcasti_env_open(&d.env, &mem);
    while (r == TETCAST_OK) {
        for (again = 0; again < 4 && r == TETCAST_OK; again++) { /* random points find what vertices and nodes do not */
            tetcast_bricks *b = NULL;
            r = tetcasti_bricks_try(&d, mesh, longest, force, &short_of, &b);
            report->tries++;
            if (r != TETCAST_OK) break;
            if (force == NULL && d.max_error > 0.0f) {
                force = (uint8_t *)tetcasti_alloc_zero(&mem, tetcasti_slot_count(b), 1);
                if (force == NULL) r = tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
            }
            if (r == TETCAST_OK) r = tetcasti_bricks_check(&d, mesh, b, force, &helps, report);
            tetcasti_bricks_free(*out);
            *out = b;
            if (report->above == 0 || helps == 0 || (short_of != 0 && d.longest == 0 && longest < end)) break;
        }
        tetcasti_free(&mem, force);
        force = NULL;
        if (d.longest != 0 || report->above == 0 || longest >= end) break;
        longest = 4 * longest - 3 < end ? 4 * longest - 3 : end;
    }
    if (r != TETCAST_OK) {
        tetcasti_bricks_free(*out);
        *out = NULL;
    }
    return r;
}

/* ---- files ---- */

#define TETCASTI_BRK_HEADER 152u
#define TETCASTI_BRK_RECORD 28u

static const uint8_t tetcasti_brk_magic[8] = {0x89, 'B', 'R', 'K', '\r', '\n', 0x1a, '\n'};

static void tetcasti_store_f64(uint8_t *p, double v) {
    uint64_t u;
    memcpy(&u, &v, 8);
    tetcasti_store_u64(p, u);
}
static double tetcasti_load_f64(const uint8_t *p) {
    const uint64_t u = tetcasti_load_u64(p);
    double v;
    memcpy(&v, &u, 8);
    return v;
}
static void tetcasti_store_f32(uint8_t *p, float v) {
    uint32_t u;
    memcpy(&u, &v, 4);
    tetcasti_store_u32(p, u);
}
static float tetcasti_load_f32(const uint8_t *p) {
    const uint32_t u = tetcasti_load_u32(p);
    float v;
    memcpy(&v, &u, 4);
    return v;
}

TETCAST_DEF size_t tetcast_bricks_file_size(const tetcast_bricks *b) {
    if (b == NULL) return 0;
    return TETCASTI_BRK_HEADER + (size_t)b->count * TETCASTI_BRK_RECORD + (size_t)b->hull_count * 24 +
           (size_t)b->face_count * 12 + (size_t)b->count * b->nodes * b->bytes;
}

TETCAST_DEF tetcast_result tetcast_bricks_write(const tetcast_bricks *b, void *data, size_t size) {
    uint8_t *p = (uint8_t *)data, *q;
    size_t i, n;
    uint32_t a;
    if (b == NULL || data == NULL) return TETCAST_ERR_INVALID_ARG;
    if (size < tetcast_bricks_file_size(b)) return TETCAST_ERR_RANGE;
    memset(p, 0, TETCASTI_BRK_HEADER);
    memcpy(p, tetcasti_brk_magic, 8);
    tetcasti_store_u32(p + 8, 1);
    tetcasti_store_u32(p + 12, TETCASTI_BRK_HEADER);
    tetcasti_store_u32(p + 16, b->log);
    tetcasti_store_u32(p + 20, b->levels);
    tetcasti_store_u32(p + 24, (uint32_t)b->type);
    tetcasti_store_u32(p + 28, b->count);
    for (a = 0; a < 3; a++) {
        tetcasti_store_u32(p + 32 + 4 * a, b->lattice.dims[a]);
        tetcasti_store_f64(p + 48 + 8 * a, b->lattice.origin[a]);
        tetcasti_store_f64(p + 72 + 8 * a, b->lattice.spacing[a]);
    }
    tetcasti_store_u32(p + 44, b->hull_count);
    tetcasti_store_f32(p + 96, b->bias);
    tetcasti_store_f32(p + 100, b->step);
    tetcasti_store_f32(p + 104, b->value_min);
    tetcasti_store_f32(p + 108, b->value_max);
    tetcasti_store_u32(p + 112, b->face_count);
    tetcasti_store_u64(p + 120, tetcast_bricks_file_size(b));
    q = p + TETCASTI_BRK_HEADER;
    for (i = 0; i < b->count; i++, q += TETCASTI_BRK_RECORD) {
        const tetcasti_brick *k = &b->brick[i];
        tetcasti_store_u32(q, k->level);
        for (a = 0; a < 3; a++) tetcasti_store_u32(q + 4 + 4 * a, k->place[a]);
        tetcasti_store_f32(q + 16, k->lo);
        tetcasti_store_f32(q + 20, k->hi);
        tetcasti_store_f32(q + 24, k->error);
    }
    for (i = 0; i < b->hull_count; i++)
        for (a = 0; a < 3; a++, q += 8) tetcasti_store_f64(q, b->hull[i][a]);
    for (i = 0; i < b->face_count; i++)
        for (a = 0; a < 3; a++, q += 4) tetcasti_store_u32(q, b->face[i][a]);
    tetcasti_store_u64(p + 128, tetcasti_hash_bytes(1, p + TETCASTI_BRK_HEADER, (size_t)(q - p) - TETCASTI_BRK_HEADER));
    n = (size_t)b->count * b->nodes;
    if (b->bytes == 1) memcpy(q, b->data, n);
    for (i = 0; i < n && b->bytes == 2; i++) {
        uint16_t u;
        memcpy(&u, b->data + 2 * i, 2);
        tetcasti_store_u16(q + 2 * i, u);
    }
    for (i = 0; i < n && b->bytes == 4; i++) {
        float f;
        memcpy(&f, b->data + 4 * i, 4);
        tetcasti_store_f32(q + 4 * i, f);
    }
    tetcasti_store_u64(p + 136, tetcasti_hash_bytes(2, q, n * b->bytes));
    tetcasti_store_u64(p + 144, tetcasti_hash_bytes(3, p, 144));
    return TETCAST_OK;
}

/* What records say: every place once, parents before children, all children or none, coarsest level complete. */
static int tetcasti_brk_records(tetcast_bricks *b, const uint8_t *q, uint64_t *where) {
    uint32_t i, a, last = b->levels;
    size_t top;
    for (i = 0; i < b->count; i++, q += TETCASTI_BRK_RECORD) {
        tetcasti_brick *k = &b->brick[i];
        uint32_t *at;
        *where = TETCASTI_BRK_HEADER + (uint64_t)i * TETCASTI_BRK_RECORD;
        k->level = tetcasti_load_u32(q);
        if (k->level >= b->levels || k->level > last) return 0;
        last = k->level;
        for (a = 0; a < 3; a++) {
            k->place[a] = tetcasti_load_u32(q + 4 + 4 * a);
            if (k->place[a] >= b->grid[k->level][a]) return 0;
        }
        k->lo = tetcasti_load_f32(q + 16);
        k->hi = tetcasti_load_f32(q + 20);
        k->error = tetcasti_load_f32(q + 24);
        if (!(k->lo <= k->hi) || !tetcasti_finite_f(k->lo) || !tetcasti_finite_f(k->hi) || !(k->error >= 0.0f) ||
            !tetcasti_finite_f(k->error)) return 0;
        at = tetcasti_bricks_at(b, k->level, k->place[0], k->place[1], k->place[2]);
        if (*at != TETCASTI_NONE) return 0;
        if (k->level + 1 < b->levels && *tetcasti_bricks_at(b, k->level + 1, k->place[0] / 2, k->place[1] / 2,
                                                            k->place[2] / 2) == TETCASTI_NONE) return 0;
        *at = i;
    }
    for (top = b->table_start[b->levels - 1]; top < b->table_start[b->levels]; top++)
        if (b->table[top] == TETCASTI_NONE) return 0;
    for (i = 0; i < b->count; i++) {
        const tetcasti_brick *k = &b->brick[i];
        uint32_t c, have = 0, all = 0;
        *where = TETCASTI_BRK_HEADER + (uint64_t)i * TETCASTI_BRK_RECORD;
        if (k->level == 0) continue;
        for (c = 0; c < 8; c++) {
            const uint32_t x = 2 * k->place[0] + (c & 1u), y = 2 * k->place[1] + (c >> 1 & 1u),
                z = 2 * k->place[2] + (c >> 2), *g = b->grid[k->level - 1];
            if (x >= g[0] || y >= g[1] || z >= g[2]) continue;
            all++;
            have += *tetcasti_bricks_at(b, k->level - 1, x, y, z) != TETCASTI_NONE;
        }
        if (have != 0 && have != all) return 0;
    }
    return 1;
}

static tetcast_result tetcasti_brk_body(tetcast_bricks *b, const uint8_t *p, size_t size, uint64_t *where) {
    const uint8_t *q = p + TETCASTI_BRK_HEADER;
    size_t i, n = (size_t)b->count * b->nodes;
    uint32_t a;
    uint64_t bytes = (uint64_t)b->count * TETCASTI_BRK_RECORD + (uint64_t)b->hull_count * 24 + (uint64_t)b->face_count * 12;
    (void)size;
    *where = 128;
    if (tetcasti_load_u64(p + 128) != tetcasti_hash_bytes(1, q, (size_t)bytes) ||
        tetcasti_load_u64(p + 136) != tetcasti_hash_bytes(2, q + bytes, n * b->bytes)) return TETCAST_ERR_CHECKSUM;
    b->brick = (tetcasti_brick *)tetcasti_alloc_zero(&b->mem, b->count, sizeof *b->brick);
    b->hull = (double (*)[3])tetcasti_alloc_array(&b->mem, (size_t)b->hull_count + 1, sizeof *b->hull);
    b->face = (uint32_t (*)[3])tetcasti_alloc_array(&b->mem, (size_t)b->face_count + 1, sizeof *b->face);
    b->data = (uint8_t *)tetcasti_alloc(&b->mem, n * b->bytes + 64);
    if (b->brick == NULL || b->hull == NULL || b->face == NULL || b->data == NULL) return TETCAST_ERR_NO_MEMORY;
    memset(b->data + n * b->bytes, 0, 64);
    if (!tetcasti_brk_records(b, q, where)) return TETCAST_ERR_FORMAT;
    q += (size_t)b->count * TETCASTI_BRK_RECORD;
    for (i = 0; i < b->hull_count; i++)
        for (a = 0; a < 3; a++, q += 8) {
            *where = (uint64_t)(q - p);
            b->hull[i][a] = tetcasti_load_f64(q);
            if (!(tetcasti_abs(b->hull[i][a]) < 1e300)) return TETCAST_ERR_FORMAT;
        }
    for (i = 0; i < b->face_count; i++)
        for (a = 0; a < 3; a++, q += 4) {
            *where = (uint64_t)(q - p);
            b->face[i][a] = tetcasti_load_u32(q);
            if (b->face[i][a] >= b->hull_count) return TETCAST_ERR_FORMAT;
        }
    *where = (uint64_t)(q - p);
    if (b->bytes == 1) memcpy(b->data, q, n);
    for (i = 0; i < n && b->bytes == 2; i++) {
        const uint16_t u = (uint16_t)(q[2 * i] | q[2 * i + 1] << 8);
        if (b->type == TETCAST_TYPE_F16 && (u & 0x7c00u) == 0x7c00u) return TETCAST_ERR_FORMAT;
        memcpy(b->data + 2 * i, &u, 2);
    }
    for (i = 0; i < n && b->bytes == 4; i++) {
        const float f = tetcasti_load_f32(q + 4 * i);
        if (!tetcasti_finite_f(f)) return TETCAST_ERR_FORMAT;
        memcpy(b->data + 4 * i, &f, 4);
    }
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_bricks_read(const tetcast_env *env, const void *data, size_t size,
                                               tetcast_bricks **out) {
    const uint8_t *p = (const uint8_t *)data;
    tetcast_env none;
    tetcast_lattice l;
    tetcast_bricks *b;
    tetcast_result r;
    uint32_t log, levels, type, a;
    uint64_t where = 0, want;
    if (out != NULL) *out = NULL;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    if (data == NULL || out == NULL) return TETCAST_ERR_INVALID_ARG;
    if (size < 16) return tetcasti_fail(env->error, TETCAST_ERR_TRUNCATED, size, "brk: the header ends at byte %");
    if (memcmp(p, tetcasti_brk_magic, 8) != 0) return tetcasti_fail(env->error, TETCAST_ERR_FORMAT, 0, "brk: no brick file");
    if (tetcasti_load_u32(p + 8) != 1) return tetcasti_fail(env->error, TETCAST_ERR_VERSION, 8, "brk: unknown version");
    if (size < TETCASTI_BRK_HEADER)
        return tetcasti_fail(env->error, TETCAST_ERR_TRUNCATED, size, "brk: the header ends at byte %");
    if (tetcasti_load_u64(p + 144) != tetcasti_hash_bytes(3, p, 144))
        return tetcasti_fail(env->error, TETCAST_ERR_CHECKSUM, 144, "brk: the header is damaged");
    log = tetcasti_load_u32(p + 16);
    levels = tetcasti_load_u32(p + 20);
    type = tetcasti_load_u32(p + 24);
    for (a = 0; a < 3; a++) {
        l.dims[a] = tetcasti_load_u32(p + 32 + 4 * a);
        l.origin[a] = tetcasti_load_f64(p + 48 + 8 * a);
        l.spacing[a] = tetcasti_load_f64(p + 72 + 8 * a);
    }
    if (tetcasti_load_u32(p + 12) != TETCASTI_BRK_HEADER || log < 3 || log > 5 || levels == 0 || levels > log + 1 ||
        !tetcasti_storage_good((tetcast_type)(type < 9 ? type : 1)) || !tetcasti_lattice_good(&l))
        return tetcasti_fail(env->error, TETCAST_ERR_FORMAT, 16, "brk: impossible sizes at byte %");
    b = tetcasti_bricks_open(env, &l, log, levels, (tetcast_type)type, &r);
    if (b == NULL) return r;
    b->count = tetcasti_load_u32(p + 28);
    b->hull_count = tetcasti_load_u32(p + 44);
    b->face_count = tetcasti_load_u32(p + 112);
    b->bias = tetcasti_load_f32(p + 96);
    b->step = tetcasti_load_f32(p + 100);
    b->value_min = tetcasti_load_f32(p + 104);
    b->value_max = tetcasti_load_f32(p + 108);
    want = TETCASTI_BRK_HEADER + (uint64_t)b->count * (TETCASTI_BRK_RECORD + (uint64_t)b->nodes * b->bytes) +
           (uint64_t)b->hull_count * 24 + (uint64_t)b->face_count * 12;
    if (b->count == 0 || b->count >= TETCASTI_BRICKS_END || !tetcasti_finite_f(b->bias) || !(b->step >= 0.0f) ||
        !tetcasti_finite_f(b->step) || !(b->value_min <= b->value_max) || !tetcasti_finite_f(b->value_min) ||
        !tetcasti_finite_f(b->value_max) || b->hull_count > TETCAST_MAX_VERTICES || b->face_count > TETCAST_MAX_CELLS ||
        tetcasti_load_u64(p + 120) != want) {
        r = TETCAST_ERR_FORMAT;
        where = 28;
    } else if (want > size) {
        r = TETCAST_ERR_TRUNCATED;
        where = size;
    } else {
        r = tetcasti_brk_body(b, p, size, &where);
    }
    if (r != TETCAST_OK) {
        tetcasti_bricks_free(b);
        return tetcasti_fail(env->error, r, where, r == TETCAST_ERR_TRUNCATED ? "brk: ends at byte %" :
                             r == TETCAST_ERR_NO_MEMORY ? "brk: out of memory" :
                             r == TETCAST_ERR_CHECKSUM ? "brk: damaged, checksum at byte %" : "brk: impossible at byte %");
    }
    *out = b;
    return TETCAST_OK;
}
/* ---------------------------------------------------------------------------
   clip: planes and closed meshes as intervals on rays.                          // >>clip

   A body has its triangles along a space-filling curve, eight to a box, eight boxes to a box, and so on. A ray sees them
   sheared so that it runs along an axis; the doubled areas of the three triangles between the ray and two corners
   decide, each computed from the corner of the smaller number to that of the larger one, so that the neighbour behind an
   edge gets the same number with the other sign; a zero counts as positive before the sign is turned.
   --------------------------------------------------------------------------- */

typedef struct tetcasti_solid {
    const double (*point)[3];      /* own copies */
    uint32_t (*face)[3];
    uint32_t count, outside;
    double (*box)[6];              /* lo, hi */
    uint32_t level_count, level_start[16], level_size[16];
} tetcasti_solid;

struct tetcast_clip {
    tetcasti_mem mem;
    tetcast_clip_plane *plane;
    tetcasti_solid *solid;
    size_t plane_count, solid_count;
};

static void tetcasti_solid_free(tetcasti_mem *mem, tetcasti_solid *s) {
    tetcasti_free(mem, (void *)(uintptr_t)s->point);
    tetcasti_free(mem, s->face);
    tetcasti_free(mem, s->box);
    memset(s, 0, sizeof *s);
}

typedef struct tetcasti_solid_key { uint64_t key; uint32_t face, unused; } tetcasti_solid_key;

static void tetcasti_solid_sort(tetcasti_solid_key *a, tetcasti_solid_key *b, uint32_t n) { /* merge, from below */
    uint32_t width, i;
    tetcasti_solid_key *from = a, *to = b, *swap;
    for (width = 1; width < n; width *= 2) {
        for (i = 0; i < n; i += 2 * width) {
            uint32_t l = i, m = i + width < n ? i + width : n, r = m, e = n - i < 2 * width ? n : i + 2 * width, k;
            for (k = i; k < e; k++) to[k] = l < m && (r >= e || from[l].key <= from[r].key) ? from[l++] : from[r++];
        }
        swap = from;
        from = to;
        to = swap;
        if (width > n / 2) break;
    }
    if (from != a) memcpy(a, from, n * sizeof *a);
}

/* Copies a body and builds its boxes. 0: no memory. */
static int tetcasti_solid_open(tetcasti_mem *mem, const tetcast_clip_body *body, tetcasti_solid *s) {
    const uint32_t n = (uint32_t)body->triangle_count;
    double (*point)[3] = (double (*)[3])tetcasti_alloc_array(mem, body->point_count + 1, sizeof *point);
    tetcasti_solid_key *key = (tetcasti_solid_key *)tetcasti_alloc_array(mem, 2 * (size_t)n + 1, sizeof *key);
    double lo[3] = {1e300, 1e300, 1e300}, hi[3] = {-1e300, -1e300, -1e300};
    uint32_t i, a, k, level, boxes = 0, size = n;
    memset(s, 0, sizeof *s);
    s->point = (const double (*)[3])point;
    s->face = (uint32_t (*)[3])tetcasti_alloc_array(mem, (size_t)n + 1, sizeof *s->face);
    s->count = n;
    s->outside = body->outside;
    do { /* boxes of each level */
        size = (size + 7) / 8;
        s->level_start[s->level_count] = boxes;
        s->level_size[s->level_count++] = size;
        boxes += size;
    } while (size > 1);
    s->box = (double (*)[6])tetcasti_alloc_array(mem, (size_t)boxes + 1, sizeof *s->box);
    if (point == NULL || key == NULL || s->face == NULL || s->box == NULL) {
        tetcasti_free(mem, key);
        return 0;
    }
    if (body->point_count != 0) memcpy(point, body->points, body->point_count * sizeof *point);
    for (i = 0; i < 3 * n; i++)
        for (a = 0; a < 3; a++) {
            lo[a] = tetcasti_min(lo[a], point[body->indices[i]][a]);
            hi[a] = tetcasti_max(hi[a], point[body->indices[i]][a]);
        }
    for (i = 0; i < n; i++) {
        key[i].key = 0;
        key[i].face = i;
        key[i].unused = 0;
        for (a = 0; a < 3; a++) {
            const double c = (point[body->indices[3 * i]][a] / 3.0 + point[body->indices[3 * i + 1]][a] / 3.0) +
                             point[body->indices[3 * i + 2]][a] / 3.0;
            const double x = hi[a] > lo[a] ? (c - lo[a]) / (hi[a] - lo[a]) * 2097151.0 : 0.0;
            key[i].key |= tetcasti_spread3((uint64_t)(x > 0.0 ? x < 2097151.0 ? x : 2097151.0 : 0.0)) << a;
        }
    }
    tetcasti_solid_sort(key, key + n, n);
    for (i = 0; i < n; i++) memcpy(s->face[i], body->indices + 3 * (size_t)key[i].face, 12);
    tetcasti_free(mem, key);
    for (level = 0; level < s->level_count; level++)
        for (i = 0; i < s->level_size[level]; i++) {
            double *box = s->box[s->level_start[level] + i];
            const uint32_t last = level == 0 ? n : s->level_size[level - 1];
            for (a = 0; a < 3; a++) {
                box[a] = 1e300;
                box[3 + a] = -1e300;
            }
            for (k = 8 * i; k < 8 * i + 8 && k < last; k++)
                for (a = 0; a < 3; a++) {
                    if (level == 0) {
                        uint32_t c;
                        for (c = 0; c < 3; c++) {
                            box[a] = tetcasti_min(box[a], point[s->face[k][c]][a]);
                            box[3 + a] = tetcasti_max(box[3 + a], point[s->face[k][c]][a]);
                        }
                    } else {
                        box[a] = tetcasti_min(box[a], s->box[s->level_start[level - 1] + k][a]);
                        box[3 + a] = tetcasti_max(box[3 + a], s->box[s->level_start[level - 1] + k][3 + a]);
                    }
                }
        }
    return 1;
}

/* A ray as bodies see it. */
typedef struct tetcasti_shear {
    double o[3], d[3], sx, sy, inv;
    uint32_t x, y, z;
} tetcasti_shear;

static int tetcasti_shear_open(const double o[3], const double d[3], tetcasti_shear *r) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        r->o[a] = o[a];
        r->d[a] = d[a];
    }
    r->z = tetcasti_abs(d[1]) > tetcasti_abs(d[0]) ? 1 : 0;
    if (tetcasti_abs(d[2]) > tetcasti_abs(d[r->z])) r->z = 2;
    r->x = r->z == 2 ? 0 : r->z + 1;
    r->y = r->x == 2 ? 0 : r->x + 1;
    if (!(tetcasti_abs(d[r->z]) > 0.0)) return 0;
    r->inv = 1.0 / d[r->z];
    r->sx = d[r->x] * r->inv;
    r->sy = d[r->y] * r->inv;
    return 1;
}

/* > 0: the ray passes the edge from vertex a to b on the left. Same bits from both sides. */
TETCASTI_INLINE double tetcasti_shear_edge(const double p[2], const double q[2], uint32_t a, uint32_t b) {
    const double e = a < b ? p[0] * q[1] - p[1] * q[0] : q[0] * p[1] - q[1] * p[0];
    return (a < b) == (e >= 0.0) ? 1.0 : -1.0;
}

/* Hits of a ray with a body, any order; at most room. */
static uint32_t tetcasti_solid_hits(const tetcasti_solid *s, const tetcasti_shear *r, double *hit, uint32_t room) {
    uint64_t todo[8 * 16];
    uint32_t top = 0, n = 0, a;
    if (s->count == 0) return 0;
    todo[top++] = (uint64_t)(s->level_count - 1) << 32;
    while (top != 0) {
        const uint32_t level = (uint32_t)(todo[--top] >> 32), i = (uint32_t)todo[top];
        const double *box = s->box[s->level_start[level] + i];
        const uint32_t last = level == 0 ? s->count : s->level_size[level - 1];
        uint32_t k;
        /* the sheared box: the ray passes at (0, 0) */
        double z0 = box[r->z] - r->o[r->z], z1 = box[3 + r->z] - r->o[r->z];
        double lo, hi, slack;
        for (a = 0; a < 2; a++) {
            const uint32_t axis = a == 0 ? r->x : r->y;
            const double slope = a == 0 ? r->sx : r->sy, at0 = slope * z0, at1 = slope * z1;
            lo = box[axis] - r->o[axis] - tetcasti_max(at0, at1);
            hi = box[3 + axis] - r->o[axis] - tetcasti_min(at0, at1);
            slack = 1e-12 * (tetcasti_abs(box[axis]) + tetcasti_abs(box[3 + axis]) + tetcasti_abs(r->o[axis]) +
                             tetcasti_abs(at0) + tetcasti_abs(at1));
            if (lo > slack || hi < -slack) break;
        }
        if (a < 2) continue;
        if (level != 0) {
            for (k = 8 * i; k < 8 * i + 8 && k < last; k++) todo[top++] = (uint64_t)(level - 1) << 32 | k;
            continue;
        }
        for (k = 8 * i; k < 8 * i + 8 && k < last; k++) {
            const uint32_t *f = s->face[k];
            double p[3][2], z[3], u, v, w, e0, e1, e2;
            uint32_t c;
            for (c = 0; c < 3; c++) {
                const double *q = s->point[f[c]];
                z[c] = q[r->z] - r->o[r->z];
                p[c][0] = (q[r->x] - r->o[r->x]) - r->sx * z[c];
                p[c][1] = (q[r->y] - r->o[r->y]) - r->sy * z[c];
            }
            e0 = tetcasti_shear_edge(p[1], p[2], f[1], f[2]);
            e1 = tetcasti_shear_edge(p[2], p[0], f[2], f[0]);
            e2 = tetcasti_shear_edge(p[0], p[1], f[0], f[1]);
            if (!((e0 > 0.0 && e1 > 0.0 && e2 > 0.0) || (e0 < 0.0 && e1 < 0.0 && e2 < 0.0))) continue;
            u = tetcasti_abs(p[1][0] * p[2][1] - p[1][1] * p[2][0]);
            v = tetcasti_abs(p[2][0] * p[0][1] - p[2][1] * p[0][0]);
            w = tetcasti_abs(p[0][0] * p[1][1] - p[0][1] * p[1][0]);
            if (n == room) return n;
            hit[n++] = (u + v) + w > 0.0 ? ((u * z[0] + v * z[1]) + w * z[2]) / ((u + v) + w) * r->inv : z[0] * r->inv;
        }
    }
    return n;
}

/* spans := the part of them inside of (or outside of) pairs of hits. */
static uint32_t tetcasti_spans_cut(double (*span)[2], uint32_t n, double *hit, uint32_t hits, uint32_t outside) {
    double out[TETCAST_CLIP_SPANS][2];
    uint32_t i, j, m = 0;
    for (i = 1; i < hits; i++) { /* in order: insertion, they are few */
        const double x = hit[i];
        for (j = i; j > 0 && hit[j - 1] > x; j--) hit[j] = hit[j - 1];
        hit[j] = x;
    }
    hits &= ~(uint32_t)1;
    for (i = 0; i < n; i++) {
        double at = span[i][0];
        for (j = 0; j < hits && m < TETCAST_CLIP_SPANS; j += 2) {
            double lo = outside ? at : tetcasti_max(at, hit[j]), hi = outside ? tetcasti_min(hit[j], span[i][1])
                                                                             : tetcasti_min(hit[j + 1], span[i][1]);
            if (lo < hi) {
                out[m][0] = lo;
                out[m++][1] = hi;
            }
            if (outside) at = tetcasti_max(at, hit[j + 1]);
        }
        if (outside && at < span[i][1] && m < TETCAST_CLIP_SPANS) {
            out[m][0] = at;
            out[m++][1] = span[i][1];
        }
    }
    memcpy(span, out, m * sizeof *out);
    return m;
}

#define TETCASTI_CLIP_HITS 128

static uint32_t tetcasti_solid_spans(const tetcasti_solid *s, const double o[3], const double d[3], double (*span)[2],
                                     uint32_t n) {
    double hit[TETCASTI_CLIP_HITS];
    tetcasti_shear r;
    if (n == 0 || !tetcasti_shear_open(o, d, &r)) return 0;
    return tetcasti_spans_cut(span, n, hit, tetcasti_solid_hits(s, &r, hit, TETCASTI_CLIP_HITS), s->outside);
}

/* d: unit vector, world. */
static uint32_t tetcasti_clip_run(const tetcast_clip *clip, const double o[3], const double d[3], double (*span)[2],
                                  uint32_t n) {
    size_t i;
    for (i = 0; i < clip->plane_count; i++) {
        const tetcast_clip_plane *p = &clip->plane[i];
        const double along = p->normal[0] * d[0] + p->normal[1] * d[1] + p->normal[2] * d[2];
        const double height = p->normal[0] * o[0] + p->normal[1] * o[1] + p->normal[2] * o[2] - p->offset;
        uint32_t j, m = 0;
        for (j = 0; j < n; j++) {
            double lo = span[j][0], hi = span[j][1];
            if (along > 0.0) lo = tetcasti_max(lo, -height / along);
            else if (along < 0.0) hi = tetcasti_min(hi, -height / along);
            else if (height < 0.0) continue;
            if (!(lo < hi)) continue;
            span[m][0] = lo;
            span[m++][1] = hi;
        }
        n = m;
    }
    for (i = 0; i < clip->solid_count; i++) n = tetcasti_solid_spans(&clip->solid[i], o, d, span, n);
    return n;
}

TETCAST_DEF uint32_t tetcast_clip_spans(const tetcast_clip *clip, const tetcast_ray *ray,
                                        double spans[TETCAST_CLIP_SPANS][2]) {
    double d[3];
    uint32_t a;
    if (clip == NULL || ray == NULL) return 0;
    for (a = 0; a < 3; a++) d[a] = ray->dir[a];
    if (!tetcasti_unit(d) || !tetcasti_finite(ray->org[0] + ray->org[1] + ray->org[2])) return 0;
    spans[0][0] = ray->t_min;
    spans[0][1] = ray->t_min == 0.0 && ray->t_max == 0.0 ? 1e300 : ray->t_max;
    return spans[0][0] < spans[0][1] ? tetcasti_clip_run(clip, ray->org, d, spans, 1) : 0;
}

TETCAST_DEF void tetcast_clip_destroy(tetcast_clip *clip) {
    tetcasti_mem mem;
    size_t i;
    if (clip == NULL) return;
    mem = clip->mem;
    if (clip->solid != NULL)
        for (i = 0; i < clip->solid_count; i++) tetcasti_solid_free(&mem, &clip->solid[i]);
    tetcasti_free(&mem, clip->solid);
    tetcasti_free(&mem, clip->plane);
    tetcasti_free(&mem, clip);
}

static int tetcasti_body_good(const tetcast_clip_body *b) {
    size_t i;
    uint32_t a;
    if (b->triangle_count > 0x15555555u || b->point_count > TETCAST_MAX_VERTICES ||
        (b->triangle_count != 0 && (b->points == NULL || b->indices == NULL))) return 0;
    for (i = 0; i < 3 * b->triangle_count; i++)
        if (b->indices[i] >= b->point_count) return 0;
    for (i = 0; i < b->point_count && b->points != NULL; i++)
        for (a = 0; a < 3; a++)
            if (!(tetcasti_abs(b->points[i][a]) < 1e150)) return 0;
    return 1;
}

TETCAST_DEF tetcast_result tetcast_clip_create(const tetcast_clip_desc *desc, tetcast_clip **out) {
    tetcast_clip_desc d;
    tetcasti_mem mem;
    tetcast_clip *c;
    tetcast_result r;
    size_t i;
    uint32_t a;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (out != NULL) *out = NULL;
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    r = tetcasti_env_open(&d.env, &mem);
    if (r != TETCAST_OK) return r;
    if (out == NULL || (d.plane_count != 0 && d.planes == NULL) || (d.body_count != 0 && d.bodies == NULL))
        return TETCAST_ERR_INVALID_ARG;
    for (i = 0; i < d.plane_count; i++) {
        double sum = d.planes[i].offset;
        for (a = 0; a < 3; a++) sum += d.planes[i].normal[a];
        if (!tetcasti_finite(sum)) return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, i, "clip: plane % is none");
    }
    for (i = 0; i < d.body_count; i++)
        if (!tetcasti_body_good(&d.bodies[i]))
            return tetcasti_fail(d.env.error, TETCAST_ERR_INVALID_ARG, i, "clip: body % has a bad index or point");
    c = (tetcast_clip *)tetcasti_alloc_zero(&mem, 1, sizeof *c);
    if (c == NULL) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "clip: out of memory");
    c->mem = mem;
    c->plane = (tetcast_clip_plane *)tetcasti_alloc_array(&c->mem, d.plane_count + 1, sizeof *c->plane);
    c->solid = (tetcasti_solid *)tetcasti_alloc_zero(&c->mem, d.body_count + 1, sizeof *c->solid);
    if (c->plane != NULL && d.plane_count != 0) memcpy(c->plane, d.planes, d.plane_count * sizeof *c->plane);
    c->plane_count = c->plane != NULL ? d.plane_count : 0;
    for (i = 0; c->plane != NULL && c->solid != NULL && i < d.body_count; i++) {
        c->solid_count = i + 1;
        if (!tetcasti_solid_open(&c->mem, &d.bodies[i], &c->solid[i])) break;
    }
    if (c->plane == NULL || c->solid == NULL || i < d.body_count) {
        tetcast_clip_destroy(c);
        return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "clip: out of memory");
    }
    *out = c;
    return TETCAST_OK;
}

/* ---------------------------------------------------------------------------
   brick_render: rays through a cut, eight at a time.                            // >>brick_render

   A ray has spans (lattice, clipping, hull); in a span it goes from slot to slot by integers; a slot that shows nothing
   is passed in one step, together with as large a cube of slots around it as shows nothing either. In the others a
   segment ends at whole multiples of the step of its level and where the slot ends. The value there is that of both
   slots: the field is continuous. All lanes are in slots of their own; what differs between isa is how the next eight
   values are computed.
   --------------------------------------------------------------------------- */

/* One ray. t: world length along it; lattice coordinates o + t d. */
typedef struct tetcasti_brick_ray {
    double o[3], d[3], inv[3], world_o[3], world_d[3], t, end;
    double span[TETCAST_CLIP_SPANS][2];
    uint32_t spans, at;
    int32_t slot[3];
    uint32_t axis, in_span, last, front; /* axis: through whose border the slot ends; front: its front value is known */
    uint32_t pixel;
} tetcasti_brick_ray;

typedef struct tetcasti_octet {
    float tau[8], first[8], step[8], end[8], front[8], number[8], begin[8];
    float l0[3][8], dl[3][8];
    const uint8_t *block[8];
    uint32_t adapted;            /* bits: blocks of floats */
    uint8_t level[8];
    float depth[8], length[8];
    uint32_t steps[8], walks[8], live, ended;
    tetcasti_brick_ray ray[8];
    tetcasti_ray_sum8 sum;
    tetcasti_seg8 seg;
    tetcast_packet packet;
} tetcasti_octet;

typedef struct tetcasti_brick_frame {
    const tetcast_brick_render_desc *desc;
    const tetcast_cut *cut;
    const tetcast_optics *optics;    /* NULL: the shader */
    const tetcast_image *image;
    tetcasti_segment8_fn *segment8;
    tetcasti_frame frame;
    tetcasti_encoder encoder;
    tetcasti_mem mem;
    tetcasti_solid hull;
    uint8_t *skip;                   /* per slot: 0 visible, else 1 + log of the cube of slots that shows nothing */
    double step;                     /* world, of level 0 */
    float begin_t;
    uint32_t wide, tiles_x, tiles, next, done, failed, cancelled;
    uint32_t tally[6][2];
} tetcasti_brick_frame;

/* Set up a lane for the slot that its ray is in, from ray->t to ray->end. */
static void tetcasti_lane_slot(const tetcasti_brick_frame *c, tetcasti_octet *l, uint32_t i) {
    const tetcast_cut *cut = c->cut;
    const tetcast_bricks *b = cut->bricks;
    tetcasti_brick_ray *r = &l->ray[i];
    const uint32_t word = cut->slot[(size_t)r->slot[0] + (size_t)b->slots[0] * ((size_t)r->slot[1] + (size_t)b->slots[1] *
                                                                                 (size_t)r->slot[2])];
    const uint32_t k = word >> TETCASTI_LEVEL_SHIFT & 15u, bit = 1u << i;
    const double part = 1.0 / (double)(1u << k), step = c->desc->fixed_step ? c->step : c->step * (double)(1u << k);
    const double whole = step > 0.0 && r->t / step < 4e15 ? (double)tetcasti_floor(r->t / step) : 0.0;
    uint32_t a, type;
    l->block[i] = tetcasti_slot_block(cut, word, &type);
    l->adapted = word & TETCASTI_ADAPTED ? l->adapted | bit : l->adapted & ~bit;
    l->level[i] = (uint8_t)k;
    for (a = 0; a < 3; a++) {
        const double origin = (double)((uint32_t)r->slot[a] >> k << k << b->log);
        l->l0[a][i] = (float)(((r->o[a] + r->t * r->d[a]) - origin) * part);
        l->dl[a][i] = (float)(r->d[a] * part);
    }
    l->step[i] = (float)step;
    l->first[i] = (float)((whole + 1.0) * step - r->t);
    l->end[i] = (float)(r->end - r->t);
    l->tau[i] = 0.0f;
    l->number[i] = 0.0f;
    l->begin[i] = (float)r->t;
    l->walks[i]++;
    if (!r->front) {
        const float cells = (float)(1u << b->log);
        float x[3], v[8], f[3];
        size_t n = 0;
        for (a = 3; a-- > 0;) {
            uint32_t m;
            x[a] = l->l0[a][i] > 0.0f ? l->l0[a][i] : 0.0f;
            x[a] = x[a] < cells ? x[a] : cells;
            m = (uint32_t)(int32_t)x[a];
            m = m < (1u << b->log) ? m : (1u << b->log) - 1;
            f[a] = x[a] - (float)(int32_t)m;
            n = n * b->side + m;
        }
        for (a = 0; a < 8; a++)
            v[a] = tetcasti_block_get(b, l->block[i], type,
                                      n + (a & 1u) + b->side * ((a >> 1 & 1u) + (size_t)b->side * (a >> 2)));
        l->front[i] = tetcasti_trilinear(v, f);
        r->front = 1;
    }
}

/* Where the cube of 2^log slots at r->slot ends on the ray. */
TETCASTI_INLINE double tetcasti_brick_exit(const tetcast_bricks *b, const tetcasti_brick_ray *r, uint32_t log,
                                           uint32_t *axis) {
    double best = 1e300;
    uint32_t a;
    *axis = 3;
    for (a = 0; a < 3; a++) {
        const int32_t first = r->slot[a] >> log << log;
        double at;
        if (r->d[a] > 0.0) at = ((double)((int64_t)(first + ((int32_t)1 << log)) << b->log) - r->o[a]) * r->inv[a];
        else if (r->d[a] < 0.0) at = ((double)((int64_t)first << b->log) - r->o[a]) * r->inv[a];
        else continue;
        if (at < best) {
            best = at;
            *axis = a;
        }
    }
    return best;
}

/* The slot of the point at r->t, between lo and hi. On a border it is the one that the ray goes into. */
TETCASTI_INLINE void tetcasti_brick_find(const tetcast_bricks *b, tetcasti_brick_ray *r, uint32_t a, int32_t lo,
                                         int32_t hi) {
    const double x = (r->o[a] + r->t * r->d[a]) * (1.0 / (double)(1u << b->log));
    int64_t s = tetcasti_floor(x > -1.0 ? x < 4294967296.0 ? x : 4294967296.0 : -1.0);
    if (r->d[a] < 0.0 && (double)s == x) s--;
    r->slot[a] = s < lo ? lo : s > hi ? hi : (int32_t)s;
}

/* Leave the slot (or enter the first one): to the next one that shows something. 0: the ray is through. */
static int tetcasti_lane_next(const tetcasti_brick_frame *c, tetcasti_octet *l, uint32_t i) {
    const tetcast_bricks *b = c->cut->bricks;
    tetcasti_brick_ray *r = &l->ray[i];
    uint32_t a, log = 0;
    int leave = r->in_span != 0;
    for (;;) {
        uint8_t skip;
        if (leave) {
            r->t = r->end;
            if (r->last) {
                r->at++;
                r->in_span = 0;
            } else { /* through the border across r->axis */
                const int32_t first = r->slot[r->axis] >> log << log;
                const int32_t to = r->d[r->axis] > 0.0 ? first + ((int32_t)1 << log) : first - 1;
                if (to < 0 || to >= (int32_t)b->slots[r->axis]) return 0;
                for (a = 0; a < 3 && log != 0; a++) {
                    const int32_t lo = r->slot[a] >> log << log, hi = lo + ((int32_t)1 << log) - 1;
                    if (a != r->axis) tetcasti_brick_find(b, r, a, lo, hi < (int32_t)b->slots[a] ? hi :
                                                          (int32_t)b->slots[a] - 1);
                }
                r->slot[r->axis] = to;
            }
        }
        leave = 1;
        log = 0;
        if (!r->in_span) { /* a new span: nothing is known about what was before */
            if (r->at >= r->spans) return 0;
            r->t = r->span[r->at][0];
            r->in_span = 1;
            r->front = 0;
            if (c->optics != NULL) tetcasti_lane_gap(c->optics, &l->sum, i);
            for (a = 0; a < 3; a++) tetcasti_brick_find(b, r, a, 0, (int32_t)b->slots[a] - 1);
        }
        skip = c->skip[(size_t)r->slot[0] + (size_t)b->slots[0] * ((size_t)r->slot[1] + (size_t)b->slots[1] *
                                                                    (size_t)r->slot[2])];
        if (skip != 0) log = (uint32_t)skip - 1;
        r->end = tetcasti_brick_exit(b, r, log, &r->axis);
        r->last = r->axis == 3 || !(r->end < r->span[r->at][1]);
        if (r->last) r->end = r->span[r->at][1];
        if (!(r->end > r->t)) {
            r->end = r->t;
            continue;
        }
        if (skip == 0) {
            tetcasti_lane_slot(c, l, i);
            return 1;
        }
        if (r->front && c->optics != NULL) tetcasti_lane_gap(c->optics, &l->sum, i);
        r->front = 0;
    }
}

/* The next segment of all lanes: its ends and values. Returns lanes whose slot ends with it. */
static uint32_t tetcasti_octet_step(const tetcast_bricks *b, tetcasti_octet *l) {
    const float cells = (float)(1u << b->log);
    uint32_t i, a, over = 0;
    for (i = 0; i < 8; i++) {
        float tn = l->first[i] + l->number[i] * l->step[i], f[3], v[8], s;
        size_t n = 0;
        uint32_t type;
        if (!(l->live >> i & 1u)) continue;
        if (!(tn < l->end[i])) {
            tn = l->end[i];
            over |= 1u << i;
        }
        for (a = 3; a-- > 0;) {
            float x = l->l0[a][i] + tn * l->dl[a][i];
            uint32_t m;
            x = x > 0.0f ? x : 0.0f;
            x = x < cells ? x : cells;
            m = (uint32_t)(int32_t)x;
            m = m < (1u << b->log) ? m : (1u << b->log) - 1;
            f[a] = x - (float)(int32_t)m;
            n = n * b->side + m;
        }
        type = l->adapted >> i & 1u ? TETCAST_TYPE_F32 : (uint32_t)b->type;
        for (a = 0; a < 8; a++) {
            const size_t node = n + (a & 1u) + b->side * ((a >> 1 & 1u) + (size_t)b->side * (a >> 2));
            uint16_t u;
            if (type == TETCAST_TYPE_U8) {
                v[a] = (float)l->block[i][node];
            } else if (type == TETCAST_TYPE_U16) {
                memcpy(&u, l->block[i] + 2 * node, 2);
                v[a] = (float)u;
            } else {
                v[a] = tetcasti_block_get(b, l->block[i], type, node);
            }
        }
        s = tetcasti_trilinear(v, f);
        if (type == TETCAST_TYPE_U8 || type == TETCAST_TYPE_U16) s = b->bias + b->step * s;
        l->seg.front[i] = l->front[i];
        l->seg.back[i] = s;
        l->seg.length[i] = tn - l->tau[i];
        l->seg.depth[i] = l->begin[i] + l->tau[i];
        l->tau[i] = tn;
        l->front[i] = s;
        l->number[i] += 1.0f;
    }
    return over;
}

#if TETCASTI_AVX2
TETCASTI_TARGET_AVX2 static uint32_t tetcasti_octet_step8(const tetcast_bricks *b, tetcasti_octet *l) {
    const __m256 cells = _mm256_set1_ps((float)(1u << b->log)), zero = _mm256_setzero_ps();
    const __m256i top = _mm256_set1_epi32((1 << b->log) - 1), side = _mm256_set1_epi32((int32_t)b->side);
    const __m256 number = _mm256_loadu_ps(l->number), end = _mm256_loadu_ps(l->end), tau = _mm256_loadu_ps(l->tau);
    __m256 tn = _mm256_add_ps(_mm256_loadu_ps(l->first), _mm256_mul_ps(number, _mm256_loadu_ps(l->step)));
    const __m256 inner = _mm256_cmp_ps(tn, end, _CMP_LT_OQ);
    __m256 f[3], s;
    __m256i node = _mm256_setzero_si256();
    const uint8_t *p[8];
    int32_t at[8];
    uint32_t a, i;
    tn = _mm256_blendv_ps(end, tn, inner);
    for (a = 3; a-- > 0;) {
        __m256 x = _mm256_add_ps(_mm256_loadu_ps(l->l0[a]), _mm256_mul_ps(tn, _mm256_loadu_ps(l->dl[a])));
        __m256i m;
        x = _mm256_min_ps(_mm256_max_ps(x, zero), cells);
        m = _mm256_min_epi32(_mm256_cvttps_epi32(x), top);
        f[a] = _mm256_sub_ps(x, _mm256_cvtepi32_ps(m));
        node = _mm256_add_epi32(_mm256_mullo_epi32(node, side), m);
    }
    _mm256_storeu_si256((__m256i *)(void *)at, node);
    if (l->adapted == 0) for (i = 0; i < 8; i++) p[i] = l->block[i] + (size_t)(uint32_t)at[i] * b->bytes;
    else for (i = 0; i < 8; i++) p[i] = l->block[i] + (size_t)(uint32_t)at[i] * (l->adapted >> i & 1u ? 4u : b->bytes);
    s = tetcasti_places8(b, p, l->adapted, (const __m256 *)f);
    _mm256_storeu_ps(l->seg.front, _mm256_loadu_ps(l->front));
    _mm256_storeu_ps(l->seg.back, s);
    _mm256_storeu_ps(l->seg.length, _mm256_sub_ps(tn, tau));
    _mm256_storeu_ps(l->seg.depth, _mm256_add_ps(_mm256_loadu_ps(l->begin), tau));
    _mm256_storeu_ps(l->tau, tn);
    _mm256_storeu_ps(l->front, s);
    _mm256_storeu_ps(l->number, _mm256_add_ps(number, _mm256_set1_ps(1.0f)));
    return ~(uint32_t)_mm256_movemask_ps(inner) & l->live;
}
#endif

/* ---- what is done with segments ---- */

typedef struct tetcasti_lane_point {
    const tetcast_bricks *b;
    const tetcasti_octet *l;
    uint32_t lane;
} tetcasti_lane_point;

/* Gradient per world unit at that fraction of the lane's last segment. */
static void tetcasti_lane_gradient(void *user, float fraction, float normal[3]) {
    const tetcasti_lane_point *q = (const tetcasti_lane_point *)user;
    const tetcast_bricks *b = q->b;
    const tetcasti_octet *l = q->l;
    const uint32_t i = q->lane, type = l->adapted >> i & 1u ? TETCAST_TYPE_F32 : (uint32_t)b->type;
    const float cells = (float)(1u << b->log), at = l->tau[i] - (1.0f - fraction) * l->seg.length[i];
    float f[3], v[8];
    size_t n = 0;
    uint32_t a;
    for (a = 3; a-- > 0;) {
        float x = l->l0[a][i] + at * l->dl[a][i];
        uint32_t m;
        x = x > 0.0f ? x : 0.0f;
        x = x < cells ? x : cells;
        m = (uint32_t)(int32_t)x;
        m = m < (1u << b->log) ? m : (1u << b->log) - 1;
        f[a] = x - (float)(int32_t)m;
        n = n * b->side + m;
    }
    for (a = 0; a < 8; a++)
        v[a] = tetcasti_block_get(b, l->block[i], type,
                                  n + (a & 1u) + b->side * ((a >> 1 & 1u) + (size_t)b->side * (a >> 2)));
    for (a = 0; a < 3; a++) {
        float lo[3], hi[3];
        memcpy(lo, f, sizeof lo);
        memcpy(hi, f, sizeof hi);
        lo[a] = 0.0f;
        hi[a] = 1.0f;
        normal[a] = (float)((double)(tetcasti_trilinear(v, hi) - tetcasti_trilinear(v, lo)) /
                            (b->lattice.spacing[a] * (double)(1u << l->level[i])));
    }
}

/* Lanes that have ended. */
static uint32_t tetcasti_octet_shade(const tetcasti_brick_frame *c, tetcasti_octet *l) {
    const tetcast_bricks *b = c->cut->bricks;
    const tetcast_shader *s = c->desc->shader;
    tetcast_packet *p = &l->packet;
    float rgba[4][8];
    uint32_t i, a, ended = 0;
    p->mask = l->live;
    memset(rgba, 0, sizeof rgba);
    memcpy(p->front, l->seg.front, sizeof p->front);
    memcpy(p->back, l->seg.back, sizeof p->back);
    memcpy(p->length, l->seg.length, sizeof p->length);
    memcpy(p->depth, l->seg.depth, sizeof p->depth);
    memcpy(p->level, l->level, sizeof p->level);
    for (i = 0; i < 8; i++) {
        const tetcasti_brick_ray *r = &l->ray[i];
        if (!(l->live >> i & 1u)) continue;
        if (s->needs & TETCAST_NEED_GRADIENT) {
            tetcasti_lane_point q;
            float g[3];
            q.b = b;
            q.l = l;
            q.lane = i;
            tetcasti_lane_gradient(&q, 0.5f, g);
            for (a = 0; a < 3; a++) p->gradient[a][i] = g[a];
        }
        for (a = 0; a < 3; a++) {
            p->direction[a][i] = (float)r->world_d[a];
            if (s->needs & TETCAST_NEED_POSITION)
                p->position[a][i] = (float)(r->world_o[a] + r->world_d[a] * (double)(p->depth[i] + 0.5f * p->length[i]));
        }
    }
    s->shade_fn(s->user, p, rgba);
    for (i = 0; i < 8; i++) {
        const float t = l->sum.t[i];
        float alpha = rgba[3][i];
        if (!(l->live >> i & 1u)) continue;
        alpha = alpha > 0.0f ? alpha : 0.0f;
        alpha = alpha < 1.0f ? alpha : 1.0f;
        for (a = 0; a < 3; a++)
            if (tetcasti_finite_f(rgba[a][i])) l->sum.c[a][i] += t * rgba[a][i];
        l->sum.t[i] = t - t * alpha;
        if (alpha > 0.0f && l->depth[i] == TETCASTI_INF) l->depth[i] = p->depth[i];
        ended |= (uint32_t)!(l->sum.t[i] > 1.0f / 512.0f) << i;
    }
    return ended & l->live;
}

static uint32_t tetcasti_octet_integrate(const tetcasti_brick_frame *c, tetcasti_octet *l) {
    const tetcast_optics *o = c->optics;
    const uint32_t hit = o->iso_count != 0 ? tetcasti_iso_lanes(o, &l->seg, l->live) : 0, rest = l->live & ~hit;
    uint32_t i, ended = 0;
    if (rest != 0) ended = c->segment8(o, &l->seg, rest, &l->sum) & rest;
    for (i = 0; i < 8 && hit != 0; i++) {
        tetcasti_lane_point q;
        float view[3];
        uint32_t a;
        if (!(hit >> i & 1u)) continue;
        q.b = c->cut->bricks;
        q.l = l;
        q.lane = i;
        for (a = 0; a < 3; a++) view[a] = (float)l->ray[i].world_d[a];
        tetcasti_lane_segment_iso(o, i, &l->seg, tetcasti_lane_gradient, &q, view, &l->sum);
        if (!(l->sum.t[i] > o->t_stop)) ended |= 1u << i;
    }
    if (c->image->depth == NULL) return ended;
    for (i = 0; i < 8; i++) {
        const float f = l->seg.front[i], k = l->seg.back[i];
        uint32_t at = 0;
        if (!(l->live >> i & 1u) || l->depth[i] < TETCASTI_INF) continue;
        if (hit >> i & 1u) { /* the surface itself, unless something of the volume is before it */
            (void)tetcasti_iso_hits(o, f, k, &at);
            l->depth[i] = l->seg.depth[i];
            if (o->model == TETCAST_MODEL_ISOSURFACE)
                l->depth[i] += l->seg.length[i] * ((o->iso[at].value - f) / (k - f));
        } else if (o->model != TETCAST_MODEL_ISOSURFACE && !tetcasti_optics_empty(o, f < k ? f : k, f < k ? k : f)) {
            l->depth[i] = l->seg.depth[i];
        }
    }
    return ended;
}

/* Follow the rays of a packet to their ends. */
static void tetcasti_octet_run(const tetcasti_brick_frame *c, tetcasti_octet *l) {
    const tetcast_bricks *b = c->cut->bricks;
    uint32_t i, start = l->live;
    for (i = 0; i < 8; i++)
        if ((start >> i & 1u) && !tetcasti_lane_next(c, l, i)) l->live &= ~(1u << i);
    while (l->live != 0) {
        uint32_t over, ended;
#if TETCASTI_AVX2
        if (c->wide) over = tetcasti_octet_step8(b, l);
        else
#endif
        over = tetcasti_octet_step(b, l);
        for (i = 0; i < 8; i++) {
            if (!(l->live >> i & 1u)) continue;
            l->steps[i]++;
            l->length[i] += l->seg.length[i];
        }
        ended = c->optics != NULL ? tetcasti_octet_integrate(c, l) : tetcasti_octet_shade(c, l);
        l->ended |= ended;
        l->live &= ~ended;
        for (over &= l->live; over != 0; over &= over - 1) {
            i = tetcasti_ctz64(over);
            if (!tetcasti_lane_next(c, l, i)) l->live &= ~(1u << i);
        }
    }
}

/* The ray of a pixel: spans inside of the lattice, between the ends of the view, not clipped away, in the hull. */
static uint32_t tetcasti_brick_ray_open(const tetcasti_brick_frame *c, uint32_t x, uint32_t y, double limit,
                                        tetcasti_brick_ray *r) {
    const tetcast_brick_render_desc *d = c->desc;
    const tetcast_bricks *b = c->cut->bricks;
    const double px = (double)(d->part[0] + x) + 0.5, py = (double)(d->part[1] + y) + 0.5;
    double way, lo, hi;
    uint32_t a;
    tetcasti_frame_ray(&c->frame, px, py, r->world_o, r->world_d);
    way = sqrt(r->world_d[0] * r->world_d[0] + r->world_d[1] * r->world_d[1] + r->world_d[2] * r->world_d[2]);
    lo = (double)d->clip_near * way;
    hi = d->clip_far > 0.0f ? (double)d->clip_far * way : 1e300;
    hi = tetcasti_min(hi, limit * way);
    for (a = 0; a < 3; a++) {
        const double end = (double)(b->lattice.dims[a] - 1), thin = end > 0.0 ? 0.0 : 0.5;
        double t0, t1;
        r->world_d[a] /= way;
        r->o[a] = (r->world_o[a] - b->lattice.origin[a]) / b->lattice.spacing[a];
        r->d[a] = r->world_d[a] / b->lattice.spacing[a];
        if (tetcasti_abs(r->world_d[a]) < 1e-30) r->d[a] = 0.0;
        r->inv[a] = r->d[a] != 0.0 ? 1.0 / r->d[a] : 0.0;
        if (r->d[a] == 0.0) {
            if (!(r->o[a] >= -thin && r->o[a] <= end + thin)) return 0;
            continue;
        }
        t0 = (-thin - r->o[a]) * r->inv[a];
        t1 = (end + thin - r->o[a]) * r->inv[a];
        lo = tetcasti_max(lo, tetcasti_min(t0, t1));
        hi = tetcasti_min(hi, tetcasti_max(t0, t1));
    }
    r->at = r->in_span = r->front = r->last = 0;
    r->axis = 3;
    r->spans = 0;
    if (!(lo < hi) || !tetcasti_finite(lo)) return 0;
    r->span[0][0] = lo;
    r->span[0][1] = hi;
    r->spans = 1;
    if (d->clip != NULL) r->spans = tetcasti_clip_run(d->clip, r->world_o, r->world_d, r->span, r->spans);
    if (c->hull.count != 0) r->spans = tetcasti_solid_spans(&c->hull, r->world_o, r->world_d, r->span, r->spans);
    return r->spans;
}

static void tetcasti_brick_pixel(const tetcasti_brick_frame *c, tetcasti_octet *l, uint32_t i, uint32_t x, uint32_t y) {
    const tetcast_image *m = c->image;
    float rgba[4], t;
    uint32_t a;
    if (c->optics != NULL) tetcasti_lane_finish(c->optics, &l->sum, i, rgba);
    else {
        for (a = 0; a < 3; a++) rgba[a] = l->sum.c[a][i];
        rgba[3] = 1.0f - l->sum.t[i];
    }
    t = 1.0f - rgba[3];
    for (a = 0; a < 4; a++) rgba[a] += t * c->desc->background[a];
    if (m->rgba != NULL)
        memcpy((uint8_t *)m->rgba + y * (m->rgba_stride != 0 ? m->rgba_stride : (size_t)m->width * 16) + x * (size_t)16,
               rgba, 16);
    if (m->rgba8 != NULL) {
        uint8_t *p = m->rgba8 + y * (m->rgba8_stride != 0 ? m->rgba8_stride : (size_t)m->width * 4) + x * (size_t)4;
        const float inv = rgba[3] > 0.0f ? 1.0f / rgba[3] : 0.0f;
        for (a = 0; a < 3; a++) p[a] = tetcasti_encode(&c->encoder, rgba[a] * inv);
        p[3] = (uint8_t)((rgba[3] > 0.0f ? rgba[3] < 1.0f ? rgba[3] : 1.0f : 0.0f) * 255.0f + 0.5f);
    }
    if (m->depth != NULL) {
        const double *d = l->ray[i].world_d;
        float depth = l->depth[i];
        if (depth < TETCASTI_INF)
            depth *= (float)(d[0] * c->frame.forward[0] + d[1] * c->frame.forward[1] + d[2] * c->frame.forward[2]);
        memcpy((uint8_t *)m->depth + y * (m->depth_stride != 0 ? m->depth_stride : (size_t)m->width * 4) + x * (size_t)4,
               &depth, 4);
    }
    if (m->length != NULL)
        memcpy((uint8_t *)m->length + y * (m->length_stride != 0 ? m->length_stride : (size_t)m->width * 4) + x * (size_t)4,
               &l->length[i], 4);
    if (m->steps != NULL)
        memcpy((uint8_t *)m->steps + y * (m->steps_stride != 0 ? m->steps_stride : (size_t)m->width * 4) + x * (size_t)4,
               &l->steps[i], 4);
}

static void tetcasti_octet_begin(const tetcasti_brick_frame *c, tetcasti_octet *l) {
    uint32_t i;
    l->live = l->ended = l->adapted = 0;
    memset(&l->sum, 0, sizeof l->sum);
    memset(l->steps, 0, sizeof l->steps);
    memset(l->walks, 0, sizeof l->walks);
    for (i = 0; i < 8; i++) {
        if (c->optics != NULL) tetcasti_lane_begin(c->optics, &l->sum, i);
        else l->sum.t[i] = 1.0f;
        l->block[i] = c->cut->bricks->data;
        l->tau[i] = l->first[i] = l->step[i] = l->end[i] = l->front[i] = l->number[i] = l->begin[i] = l->length[i] = 0.0f;
        l->l0[0][i] = l->l0[1][i] = l->l0[2][i] = l->dl[0][i] = l->dl[1][i] = l->dl[2][i] = 0.0f;
        l->depth[i] = TETCASTI_INF;
        l->level[i] = 0;
    }
}

static void tetcasti_task_bricks(void *ctx, uint32_t strand) {
    tetcasti_brick_frame *c = (tetcasti_brick_frame *)ctx;
    const tetcast_image *m = c->image;
    tetcasti_octet *l = (tetcasti_octet *)tetcasti_alloc(&c->mem, sizeof *l);
    uint64_t n[6];
    if (l == NULL) {
        tetcasti_atomic_store(&c->failed, 1u);
        return;
    }
    memset(n, 0, sizeof n);
    memset(l, 0, sizeof *l);
    for (;;) {
        const uint32_t tile = tetcasti_atomic_add(&c->next, 1u) - 1u;
        uint32_t x0, y0, x, y, i;
        if (tile >= c->tiles || tetcasti_atomic_load(&c->cancelled)) break;
        x0 = tile % c->tiles_x * TETCASTI_TILE;
        y0 = tile / c->tiles_x * TETCASTI_TILE;
        for (y = y0; y < y0 + TETCASTI_TILE && y < m->height; y += 2)
            for (x = x0; x < x0 + TETCASTI_TILE && x < m->width; x += 4) {
                tetcasti_octet_begin(c, l);
                for (i = 0; i < 8; i++) {
                    const uint32_t px = x + (i & 3u), py = y + (i >> 2);
                    double limit = 1e300;
                    if (px >= m->width || py >= m->height) continue;
                    if (c->desc->limit != NULL && c->desc->limit[px + (size_t)m->width * py] >= 0.0f)
                        limit = (double)c->desc->limit[px + (size_t)m->width * py];
                    if (tetcasti_brick_ray_open(c, px, py, limit, &l->ray[i]) != 0) l->live |= 1u << i;
                }
                tetcasti_octet_run(c, l);
                for (i = 0; i < 8; i++) {
                    const uint32_t px = x + (i & 3u), py = y + (i >> 2);
                    if (px >= m->width || py >= m->height) continue;
                    tetcasti_brick_pixel(c, l, i, px, py);
                    n[0]++;
                    n[1] += l->steps[i] != 0;
                    n[2] += l->walks[i];
                    n[3] += l->steps[i];
                    n[4] += l->ended >> i & 1u;
                }
            }
        i = tetcasti_atomic_add(&c->done, 1u);
        if (strand == 0 && c->desc->env.progress_fn != NULL &&
            c->desc->env.progress_fn(c->desc->env.progress_user, i, c->tiles) != 0)
                tetcasti_atomic_store(&c->cancelled, 1u);
    }
    for (strand = 0; strand < 6; strand++) tetcasti_tally_add(c->tally[strand], n[strand]);
    tetcasti_free(&c->mem, l);
}

/* Which slots show something, and how large the cubes are around those that do not. 0: no memory. */
static int tetcasti_brick_skips(tetcasti_brick_frame *c) {
    const tetcast_cut *cut = c->cut;
    const tetcast_bricks *b = cut->bricks;
    const size_t n = tetcasti_slot_count(b);
    const tetcast_shader *s = c->desc->shader;
    float seen_lo = 1.0f, seen_hi = 0.0f;
    int known = -1;
    size_t i;
    uint32_t k;
    c->skip = (uint8_t *)tetcasti_alloc(&c->mem, n);
    if (c->skip == NULL) return 0;
    for (i = 0; i < n; i++) {
        const float lo = cut->range[i][0], hi = cut->range[i][1];
        if (known < 0 || !(lo == seen_lo && hi == seen_hi)) {
            if (c->optics != NULL) known = tetcasti_optics_empty(c->optics, lo, hi);
            else known = s->empty_fn != NULL && s->empty_fn(s->user, lo, hi);
            seen_lo = lo;
            seen_hi = hi;
        }
        c->skip[i] = (uint8_t)(known != 0);
    }
    for (k = 1; k < 12; k++) { /* cubes whose eight parts show nothing */
        const uint32_t size = 1u << k, half = size / 2;
        uint32_t x, y, z, any = 0;
        for (z = 0; z < b->slots[2]; z += size)
            for (y = 0; y < b->slots[1]; y += size)
                for (x = 0; x < b->slots[0]; x += size) {
                    uint32_t j, empty = 1, px, py, pz;
                    for (j = 0; j < 8; j++) {
                        px = x + (j & 1u) * half;
                        py = y + (j >> 1 & 1u) * half;
                        pz = z + (j >> 2) * half;
                        if (px < b->slots[0] && py < b->slots[1] && pz < b->slots[2])
                            empty &= c->skip[px + (size_t)b->slots[0] * (py + (size_t)b->slots[1] * pz)] == k;
                    }
                    if (!empty) continue;
                    any = 1;
                    for (pz = z; pz < z + size && pz < b->slots[2]; pz++)
                        for (py = y; py < y + size && py < b->slots[1]; py++)
                            for (px = x; px < x + size && px < b->slots[0]; px++)
                                c->skip[px + (size_t)b->slots[0] * (py + (size_t)b->slots[1] * pz)] = (uint8_t)(k + 1);
                }
        if (!any) break;
    }
    return 1;
}

static tetcast_result tetcasti_brick_frame_open(tetcasti_brick_frame *c, tetcast_brick_render_desc *d,
                                                const tetcast_image *image) {
    const tetcast_bricks *b = c->cut->bricks;
    double lo[3], hi[3], least = 1e300;
    const uint32_t width = d->frame[0] != 0 ? d->frame[0] : image->width;
    const uint32_t height = d->frame[0] != 0 ? d->frame[1] : image->height;
    tetcast_result r = TETCAST_OK;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        lo[a] = b->lattice.origin[a];
        hi[a] = lo[a] + (double)(b->lattice.dims[a] - 1) * b->lattice.spacing[a];
        if (b->lattice.dims[a] > 1) least = tetcasti_min(least, b->lattice.spacing[a]);
    }
    c->step = (least < 1e300 ? least : b->lattice.spacing[0]) * (d->step > 0.0f ? (double)d->step : 1.0);
    if (d->camera.eye[0] == d->camera.at[0] && d->camera.eye[1] == d->camera.at[1] && d->camera.eye[2] == d->camera.at[2])
        r = tetcast_camera_fit(&d->camera, lo, hi, NULL, width, height);
    if (r == TETCAST_OK) r = tetcasti_frame_open(&d->camera, width, height, &c->frame);
    if (r == TETCAST_OK && c->optics == NULL && d->shader->prepare_fn != NULL)
        return d->shader->prepare_fn(d->shader->user, d->shader->params, d->shader->param_count, d->env.error);
    if (r != TETCAST_OK) return tetcasti_fail(d->env.error, r, 0, "bricks: bad camera");
    if (b->face_count != 0 && !d->no_hull) {
        tetcast_clip_body body;
        memset(&body, 0, sizeof body);
        body.points = (const double (*)[3])b->hull;
        body.point_count = b->hull_count;
        body.indices = b->face[0];
        body.triangle_count = b->face_count;
        if (!tetcasti_solid_open(&c->mem, &body, &c->hull))
            return tetcasti_fail(d->env.error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
    }
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_render_bricks(const tetcast_brick_render_desc *desc, const tetcast_cut *cut,
                                                 const tetcast_optics *optics, const tetcast_image *image,
                                                 tetcast_render_stats *stats) {
    tetcast_brick_render_desc d;
    tetcasti_brick_frame c;
    tetcast_result r;
    uint32_t strands, a;
    memset(&d, 0, sizeof d);
    memset(&c, 0, sizeof c);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    r = tetcasti_env_open(&d.env, &c.mem);
    if (r != TETCAST_OK) return r;
    for (a = 0; a < 4; a++)
        if (!tetcasti_finite_f(d.background[a])) r = TETCAST_ERR_INVALID_ARG;
    if (cut == NULL || image == NULL || (optics == NULL && d.shader == NULL) || (uint32_t)d.isa > TETCAST_ISA_AVX512 ||
        !(d.step >= 0.0f && d.step < 1e6f) || !(d.clip_near >= 0.0f && d.clip_near < TETCASTI_INF) ||
        !(d.clip_far >= 0.0f) || (d.shader != NULL && d.shader->shade_fn == NULL) ||
        (d.frame[0] != 0 && (d.frame[1] == 0 || d.part[0] > d.frame[0] || d.part[1] > d.frame[1] ||
                             image->width > d.frame[0] - d.part[0] || image->height > d.frame[1] - d.part[1])))
        r = TETCAST_ERR_INVALID_ARG;
    if (r != TETCAST_OK) return tetcasti_fail(d.env.error, r, 0, "bricks: bad option");
    if (image->width == 0 || image->height == 0) return TETCAST_OK;
    if (d.frame[0] == 0) d.part[0] = d.part[1] = 0;
    c.desc = &d;
    c.cut = cut;
    c.optics = d.shader != NULL ? NULL : optics;
    c.image = image;
    c.wide = tetcast_isa_best() >= TETCAST_ISA_AVX2 && (d.isa == TETCAST_ISA_AUTO || d.isa >= TETCAST_ISA_AVX2);
    c.tiles_x = (image->width + TETCASTI_TILE - 1) / TETCASTI_TILE;
    if ((uint64_t)c.tiles_x * ((image->height + TETCASTI_TILE - 1) / TETCASTI_TILE) > 0x7fffffffu)
        return tetcasti_fail(d.env.error, TETCAST_ERR_RANGE, image->width, "bricks: the picture is too large");
    c.tiles = c.tiles_x * ((image->height + TETCASTI_TILE - 1) / TETCASTI_TILE);
    if (c.optics != NULL)
        c.segment8 = c.wide ? optics->segment8 : tetcasti_segment8_pick(optics, TETCAST_ISA_SCALAR);
    if (image->rgba8 != NULL) tetcasti_encoder_open(&c.encoder);
    r = tetcasti_brick_frame_open(&c, &d, image);
    if (r == TETCAST_OK && !tetcasti_brick_skips(&c))
        r = tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
    if (r == TETCAST_OK) {
        strands = tetcasti_thread_count(&d.env);
        tetcasti_parallel_for(&d.env, tetcasti_task_bricks, &c, strands < c.tiles ? strands : c.tiles);
        if (c.failed) r = tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "bricks: out of memory");
        else if (c.cancelled) r = tetcasti_fail(d.env.error, TETCAST_ERR_CANCELLED, 0, "bricks: cancelled");
    }
    tetcasti_solid_free(&c.mem, &c.hull);
    tetcasti_free(&c.mem, c.skip);
    if (r == TETCAST_OK && stats != NULL) {
        stats->rays += tetcasti_tally(c.tally[0]);
        stats->hit_rays += tetcasti_tally(c.tally[1]);
        stats->walks += tetcasti_tally(c.tally[2]);
        stats->steps += tetcasti_tally(c.tally[3]);
        stats->ended += tetcasti_tally(c.tally[4]);
        stats->isa = c.wide ? TETCAST_ISA_AVX2 : TETCAST_ISA_SCALAR;
    }
    return r;
}

TETCAST_DEF const float *tetcast_params_find(const tetcast_param *params, size_t count, const char *name, size_t least,
                                             tetcast_error *error) {
    static const char text[] = "missing shader parameter: ";
    size_t i, k;
    for (i = 0; i < count && params != NULL && name != NULL; i++)
        if (params[i].name != NULL && params[i].values != NULL && params[i].count >= least &&
            strcmp(params[i].name, name) == 0) return params[i].values;
    if (error == NULL || name == NULL) return NULL;
    error->code = TETCAST_ERR_INVALID_ARG;
    error->where = 0;
    memcpy(error->text, text, sizeof text);
    for (k = sizeof text - 1, i = 0; name[i] != 0 && k + 1 < sizeof error->text; i++) error->text[k++] = name[i];
    error->text[k] = 0;
    return NULL;
}
#endif /* TETCAST_NO_BRICKS */
#ifndef TETCAST_NO_RBF
/* ---------------------------------------------------------------------------
   rbf: sums of radial basis functions: bytes, kernels, files.                   // >>rbf

   Local coordinates: (world - origin) / scale, scale = metric * unit, unit the power of two for which the longest side of
   the box is in (0.5, 1]. The box is [0, size] there, distances are isotropic.
   --------------------------------------------------------------------------- */

#define TETCASTI_RBF_DEPTH 10u      /* of the octree */
#define TETCASTI_RBF_LEAF 16u       /* functions in a leaf that is not split */
#define TETCASTI_RBF_MAGIC 12582912.0f /* 1.5 * 2^23: adding it rounds to an integer */

/* One function as it is evaluated. With s = 1 + a d^2 (compact kernels) or g = 2^(a d^2) (Gaussians):
   GAUSS max(g - e, 0), GAUSS_CUT g where g > e, POWER max(s, 0)^8. w holds the weights times what the kernel is divided
   by. Functions never look at their radius: outside of it these forms give 0 by themselves. */
typedef struct tetcasti_rbf_record {
    float c[3], a, e, radius;
    float w[TETCAST_RBF_MAX_COMPONENTS];
    float most, unused;             /* largest |w| */
} tetcasti_rbf_record;

typedef struct tetcasti_rbf_node {
    uint32_t child;                 /* first of eight nodes, 0: a leaf */
    uint32_t first, count;          /* leaf: of index[] */
} tetcasti_rbf_node;

/* How many bits things have in a file; position[0] = 0: all are 32-bit floats */
typedef struct tetcasti_rbf_bits {
    uint32_t position[3], width, weight, node;
    float width_min;                /* width k is width_min * 2^(k / 8) */
    float weight_step, node_step;
} tetcasti_rbf_bits;

struct tetcast_rbf {
    tetcasti_mem mem;
    uint32_t components, count;
    tetcast_kernel kernel;
    float cut, epsilon;
    double box_min[3], box_max[3], metric[3], scale[3], unit;
    float size[3];                  /* of the box, local */
    float offset[TETCAST_RBF_MAX_COMPONENTS];
    uint32_t dims[3];               /* of the base grid; 0 0 0: none */
    float node_scale[3];            /* local -> nodes */
    float *node;                    /* [dims][components] */
    float (*centre)[3];             /* [count]: what is stored; Morton order */
    float *width;
    float *weight;                  /* [count][components] */
    tetcasti_rbf_record *record;    /* [count] */
    tetcasti_rbf_node *tree;        /* [0] is the root: the cube [0, 1]^3 */
    uint32_t *index;
    uint32_t tree_count, index_count, tree_depth;
    tetcasti_rbf_bits bits;
    float range[2], max_error, mean_error;
};

/* ---- kernels ---- */

/* Radius over width of the compact kernels: closest to a Gaussian. */
static float tetcasti_kernel_reach(tetcast_kernel kernel) {
    return kernel == TETCAST_KERNEL_WENDLAND2 ? 3.70f : kernel == TETCAST_KERNEL_WENDLAND4 ? 4.22f : 4.21f;
}

/* 2^x for x <= 0; 2^-120 below -120. Relative error 7.5e-8 by the polynomial, and rounding. */
TETCASTI_INLINE float tetcasti_exp2_fast(float x) {
    float t, f, p;
    uint32_t n, bits;
    x = x > -120.0f ? x : -120.0f;
    t = x + TETCASTI_RBF_MAGIC;
    memcpy(&n, &t, 4);
    f = x - (t - TETCASTI_RBF_MAGIC);
    p = 0.001327647198f * f + 0.009675541334f;
    p = p * f + 0.05550713274f;
    p = p * f + 0.2402211972f;
    p = p * f + 0.6931469671f;
    p = p * f + 1.000000072f;
    memcpy(&bits, &p, 4);
    bits += n << 23;
    memcpy(&p, &bits, 4);
    return p;
}

/* phi of a squared distance. *slope: derivative by the place = slope * (place - centre). */
TETCASTI_INLINE float tetcasti_rbf_phi(const tetcast_kernel kernel, const tetcasti_rbf_record *f, float d2,
                                       float *slope) {
    if (kernel == TETCAST_KERNEL_GAUSS || kernel == TETCAST_KERNEL_GAUSS_CUT) {
        const float g = tetcasti_exp2_fast(f->a * d2), m = g - f->e;
        if (slope != NULL) *slope = m > 0.0f ? (1.38629436f * f->a) * g : 0.0f;
        return kernel == TETCAST_KERNEL_GAUSS ? (m > 0.0f ? m : 0.0f) : m > 0.0f ? g : 0.0f;
    }
    if (kernel == TETCAST_KERNEL_POWER) {
        float s = 1.0f + f->a * d2, s2, s4;
        s = s > 0.0f ? s : 0.0f;
        s2 = s * s;
        s4 = s2 * s2;
        if (slope != NULL) *slope = (16.0f * f->a) * (s4 * (s2 * s));
        return s4 * s4;
    } else {
        const float q = sqrtf(0.0f - f->a * d2);
        float s = 1.0f - q, s2, s4;
        s = s > 0.0f ? s : 0.0f;
        s2 = s * s;
        s4 = s2 * s2;
        if (kernel == TETCAST_KERNEL_WENDLAND2) {
            if (slope != NULL) *slope = (20.0f * f->a) * (s2 * s);
            return s4 * (4.0f * q + 1.0f);
        }
        if (slope != NULL) *slope = (18.666667f * f->a) * ((5.0f * q + 1.0f) * (s4 * s));
        return (s4 * s2) * ((35.0f * q + 18.0f) * q + 3.0f) * 0.33333333f;
    }
}

/* Kernel, centre, width, weights -> record. */
static void tetcasti_rbf_prepare(const tetcast_rbf *m, uint32_t i, tetcasti_rbf_record *f) {
    const double w = (double)m->width[i], k = 0.72134752044448170368 / (w * w); /* log2(e) / 2 */
    double divide = 1.0;
    uint32_t c;
    memset(f, 0, sizeof *f);
    memcpy(f->c, m->centre[i], sizeof f->c);
    for (c = 0; c < m->components; c++) {
        const float a = tetcasti_absf(m->weight[(size_t)i * m->components + c]);
        f->most = a > f->most ? a : f->most;
    }
    if (m->kernel == TETCAST_KERNEL_GAUSS) {
        const double e = tetcasti_exp2(-0.72134752044448170368 * (double)m->cut * (double)m->cut);
        f->a = (float)-k;
        f->e = (float)e;
        f->radius = (float)((double)m->cut * w);
        divide = 1.0 - e;
    } else if (m->kernel == TETCAST_KERNEL_GAUSS_CUT) {
        f->a = (float)-k;
        f->e = 2.0f;
        if (f->most > m->epsilon) {
            f->e = m->epsilon / f->most;
            f->radius = (float)(w * sqrt(-1.38629436111989061883 * tetcasti_log2((double)f->e)));
        }
    } else {
        const double r = (double)tetcasti_kernel_reach(m->kernel) * w;
        f->a = (float)(-1.0 / (r * r));
        f->radius = (float)r;
    }
    for (c = 0; c < m->components; c++)
        f->w[c] = (float)((double)m->weight[(size_t)i * m->components + c] / divide);
    f->most = (float)((double)f->most / divide);
    if (f->most == 0.0f) f->radius = 0.0f;
    f->radius *= 1.00001f; /* lists are made by it: rounding shall leave nobody out */
}

/* ---- base ---- */

/* Cell and fraction of a place along one axis. */
TETCASTI_INLINE uint32_t tetcasti_rbf_cell(const tetcast_rbf *m, uint32_t axis, float x, float *u) {
    const uint32_t last = m->dims[axis] - 1;
    float t = x * m->node_scale[axis];
    uint32_t i;
    t = t > 0.0f ? t : 0.0f;
    t = t < (float)last ? t : (float)last;
    i = (uint32_t)t;
    if (i != 0 && i == last) i--;
    *u = t - (float)i;
    return i;
}

/* Trilinear base at a place; slope NULL or [components][3], local. */
static void tetcasti_rbf_base(const tetcast_rbf *m, const float p[3], float *value, float (*slope)[3]) {
    const uint32_t n = m->components;
    const float *v;
    float u[3];
    size_t step[3];
    uint32_t c, i[3], a;
    if (m->node == NULL) {
        for (c = 0; c < n; c++) {
            value[c] = m->offset[c];
            if (slope != NULL) slope[c][0] = slope[c][1] = slope[c][2] = 0.0f;
        }
        return;
    }
    for (a = 0; a < 3; a++) i[a] = tetcasti_rbf_cell(m, a, p[a], &u[a]);
    step[0] = m->dims[0] > 1 ? n : 0;
    step[1] = m->dims[1] > 1 ? (size_t)n * m->dims[0] : 0;
    step[2] = m->dims[2] > 1 ? (size_t)n * m->dims[0] * m->dims[1] : 0;
    v = m->node + (((size_t)i[2] * m->dims[1] + i[1]) * m->dims[0] + i[0]) * n;
    for (c = 0; c < n; c++, v++) {
        const float a0 = v[step[1]] - v[0], a1 = v[step[0] + step[1]] - v[step[0]];
        const float b0 = v[step[1] + step[2]] - v[step[2]];
        const float b1 = v[step[0] + step[1] + step[2]] - v[step[0] + step[2]];
        const float x0 = v[0] + u[1] * a0, x1 = v[step[0]] + u[1] * a1;                       /* z below */
        const float y0 = v[step[2]] + u[1] * b0, y1 = v[step[0] + step[2]] + u[1] * b1;       /* z above */
        const float z0 = x0 + u[2] * (y0 - x0), z1 = x1 + u[2] * (y1 - x1);
        value[c] = z0 + u[0] * (z1 - z0);
        if (slope != NULL) {
            const float s0 = a0 + u[2] * (b0 - a0), s1 = a1 + u[2] * (b1 - a1);
            slope[c][0] = (z1 - z0) * m->node_scale[0];
            slope[c][1] = (s0 + u[0] * (s1 - s0)) * m->node_scale[1];
            slope[c][2] = ((y0 - x0) + u[0] * ((y1 - x1) - (y0 - x0))) * m->node_scale[2];
        }
    }
}

/* ---- making a model ---- */

static void tetcasti_rbf_local(const tetcast_rbf *m, const double world[3], float out[3]) {
    uint32_t a;
    for (a = 0; a < 3; a++) out[a] = (float)((world[a] - m->box_min[a]) / m->scale[a]);
}

/* Box and metric -> scale, unit, size. 0: no box. */
static int tetcasti_rbf_place(tetcast_rbf *m) {
    double longest = 0.0;
    uint64_t bits;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const double side = (m->box_max[a] - m->box_min[a]) / m->metric[a];
        if (!tetcasti_finite(m->box_min[a]) || !tetcasti_finite(m->box_max[a]) || !(m->metric[a] > 0.0) ||
            !tetcasti_finite(m->metric[a]) || !(side >= 0.0) || !tetcasti_finite(side)) return 0;
        longest = tetcasti_max(longest, side);
    }
    m->unit = 1.0;
    if (longest > 0.0) {
        if (longest < 1e-280 || longest > 1e280) return 0;
        memcpy(&bits, &longest, sizeof bits);
        bits = (bits + 0xfffffffffffffu) & 0xfff0000000000000u; /* the next power of two */
        memcpy(&m->unit, &bits, sizeof bits);
    }
    for (a = 0; a < 3; a++) {
        m->scale[a] = m->metric[a] * m->unit;
        if (!(m->scale[a] > 1e-290 && m->scale[a] < 1e290)) return 0;
        m->size[a] = (float)((m->box_max[a] - m->box_min[a]) / m->scale[a]);
    }
    return 1;
}

static void tetcasti_rbf_node_scale(tetcast_rbf *m) {
    uint32_t a;
    for (a = 0; a < 3; a++)
        m->node_scale[a] = m->dims[a] > 1 && m->size[a] > 0.0f ? (float)(m->dims[a] - 1) / m->size[a] : 0.0f;
}

static int tetcasti_rbf_alloc(tetcast_rbf *m) { /* what count, dims and components say; 0: no memory */
    size_t nodes = (size_t)m->dims[0] * m->dims[1] * m->dims[2];
    m->centre = (float (*)[3])tetcasti_alloc_zero(&m->mem, m->count + 1u, sizeof *m->centre);
    m->width = (float *)tetcasti_alloc_zero(&m->mem, m->count + 1u, sizeof *m->width);
    m->weight = (float *)tetcasti_alloc_zero(&m->mem, ((size_t)m->count + 1u) * m->components, sizeof *m->weight);
    if (nodes != 0) m->node = (float *)tetcasti_alloc_zero(&m->mem, nodes * m->components, sizeof *m->node);
    return m->centre != NULL && m->width != NULL && m->weight != NULL && (nodes == 0 || m->node != NULL);
}

TETCAST_DEF void tetcast_rbf_destroy(tetcast_rbf *rbf) {
    tetcasti_mem mem;
    if (rbf == NULL) return;
    mem = rbf->mem;
    tetcasti_free(&mem, rbf->centre);
    tetcasti_free(&mem, rbf->width);
    tetcasti_free(&mem, rbf->weight);
    tetcasti_free(&mem, rbf->node);
    tetcasti_free(&mem, rbf->record);
    tetcasti_free(&mem, rbf->tree);
    tetcasti_free(&mem, rbf->index);
    tetcasti_free(&mem, rbf);
}

/* Does the ball of f touch the box? */
TETCASTI_INLINE int tetcasti_rbf_touches(const tetcasti_rbf_record *f, const float lo[3], const float hi[3]) {
    float d2 = 0.0f;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const float d = f->c[a] < lo[a] ? lo[a] - f->c[a] : f->c[a] > hi[a] ? f->c[a] - hi[a] : 0.0f;
        d2 += d * d;
    }
    return d2 <= f->radius * f->radius;
}

typedef struct tetcasti_rbf_grow { /* an octree in the making */
    tetcast_rbf *m;
    uint32_t *list;             /* a stack of the lists of the nodes on the way down */
    size_t tree_room, index_room, list_room;
    float margin;
    int failed;
} tetcasti_rbf_grow;

static void tetcasti_rbf_child_box(const float lo[3], float side, uint32_t k, float out_lo[3], float out_hi[3]) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        out_lo[a] = lo[a] + ((k >> a & 1u) != 0 ? side : 0.0f);
        out_hi[a] = out_lo[a] + side;
    }
}

static void tetcasti_rbf_leaf(tetcasti_rbf_grow *g, uint32_t node, size_t begin, size_t count) {
    tetcast_rbf *m = g->m;
    if ((uint64_t)m->index_count + count > 0xffffff00u ||
        !tetcasti_grow(&m->mem, (void **)&m->index, &g->index_room, m->index_count, m->index_count + count,
                       sizeof *m->index)) {
        g->failed = 1;
        return;
    }
    m->tree[node].first = m->index_count;
    m->tree[node].count = (uint32_t)count;
    memcpy(m->index + m->index_count, g->list + begin, count * sizeof *m->index);
    m->index_count += (uint32_t)count;
}

/* Node `node` has the functions list[begin .. begin + count). A node is split unless its children would have lists about
   as long as its own (the thesis' rule), or memory for lists runs out: 16 entries a function. */
static void tetcasti_rbf_split(tetcasti_rbf_grow *g, uint32_t node, const float lo[3], float side, uint32_t depth,
                               size_t begin, size_t count) {
    tetcast_rbf *m = g->m;
    size_t sum = 0, i;
    uint32_t k, child;
    float clo[8][3], chi[8][3];
    if (g->failed) return;
    if (depth > m->tree_depth) m->tree_depth = depth;
    side *= 0.5f;
    for (k = 0; k < 8; k++) tetcasti_rbf_child_box(lo, side, k, clo[k], chi[k]);
    if (count > TETCASTI_RBF_LEAF && depth < TETCASTI_RBF_DEPTH) {
        for (i = 0; i < count; i++)
            for (k = 0; k < 8; k++)
                sum += (size_t)tetcasti_rbf_touches(&m->record[g->list[begin + i]], clo[k], chi[k]);
    }
    if (sum == 0 || sum > 6 * count || (uint64_t)m->index_count + sum > 16u * (uint64_t)m->count + 65536u) {
        tetcasti_rbf_leaf(g, node, begin, count);
        return;
    }
    child = m->tree_count;
    if (!tetcasti_grow(&m->mem, (void **)&m->tree, &g->tree_room, m->tree_count, (size_t)m->tree_count + 8,
                       sizeof *m->tree)) {
        g->failed = 1;
        return;
    }
    m->tree_count += 8;
    m->tree[node].child = child;
    memset(m->tree + child, 0, 8 * sizeof *m->tree);
    for (k = 0; k < 8 && !g->failed; k++) {
        size_t n = 0;
        if (!tetcasti_grow(&m->mem, (void **)&g->list, &g->list_room, begin + count, begin + 2 * count,
                           sizeof *g->list)) {
            g->failed = 1;
            return;
        }
        for (i = 0; i < count; i++) {
            const uint32_t f = g->list[begin + i];
            if (tetcasti_rbf_touches(&m->record[f], clo[k], chi[k])) g->list[begin + count + n++] = f;
        }
        tetcasti_rbf_split(g, child + k, clo[k], side, depth + 1, begin + count, n);
    }
}

/* Records and octree of a model whose functions are there. */
static tetcast_result tetcasti_rbf_finish(tetcast_rbf *m) {
    static const float zero[3] = {0.0f, 0.0f, 0.0f};
    tetcasti_rbf_grow g;
    uint32_t i, n = 0;
    memset(&g, 0, sizeof g);
    g.m = m;
    tetcasti_rbf_node_scale(m);
    m->record = (tetcasti_rbf_record *)tetcasti_alloc_zero(&m->mem, m->count + 1u, sizeof *m->record);
    g.list_room = m->count + 1u;
    g.list = (uint32_t *)tetcasti_alloc_array(&m->mem, g.list_room, sizeof *g.list);
    g.failed = m->record == NULL || g.list == NULL ||
               !tetcasti_grow(&m->mem, (void **)&m->tree, &g.tree_room, 0, 16, sizeof *m->tree);
    if (!g.failed) {
        for (i = 0; i < m->count; i++) {
            tetcasti_rbf_prepare(m, i, &m->record[i]);
            if (m->record[i].radius > 0.0f) g.list[n++] = i;
        }
        memset(m->tree, 0, sizeof *m->tree);
        m->tree_count = 1;
        tetcasti_rbf_split(&g, 0, zero, 1.0f, 0, 0, n);
    }
    tetcasti_free(&m->mem, g.list);
    return g.failed ? TETCAST_ERR_NO_MEMORY : TETCAST_OK;
}

/* Put the functions in the order of a Morton curve. 0: no memory. */
typedef struct tetcasti_rbf_key { uint64_t key; uint32_t i; } tetcasti_rbf_key;

static void tetcasti_rbf_sift(tetcasti_rbf_key *k, size_t at, size_t n) {
    for (;;) {
        size_t c = 2 * at + 1;
        tetcasti_rbf_key t;
        if (c >= n) return;
        if (c + 1 < n && (k[c + 1].key > k[c].key || (k[c + 1].key == k[c].key && k[c + 1].i > k[c].i))) c++;
        if (k[at].key > k[c].key || (k[at].key == k[c].key && k[at].i > k[c].i)) return;
        t = k[at];
        k[at] = k[c];
        k[c] = t;
        at = c;
    }
}
static void tetcasti_rbf_sort(tetcasti_rbf_key *k, size_t n) { /* heap sort by (key, i) */
    size_t i;
    for (i = n / 2; i-- > 0;) tetcasti_rbf_sift(k, i, n);
    for (i = n; i-- > 1;) {
        tetcasti_rbf_key t = k[0];
        k[0] = k[i];
        k[i] = t;
        tetcasti_rbf_sift(k, 0, i);
    }
}

static int tetcasti_rbf_order(tetcast_rbf *m) {
    tetcasti_rbf_key *key = (tetcasti_rbf_key *)tetcasti_alloc_array(&m->mem, m->count + 1u, sizeof *key);
    float (*centre)[3] = (float (*)[3])tetcasti_alloc_array(&m->mem, m->count + 1u, sizeof *centre);
    float *width = (float *)tetcasti_alloc_array(&m->mem, m->count + 1u, sizeof *width);
    float *weight = (float *)tetcasti_alloc_array(&m->mem, ((size_t)m->count + 1u) * m->components, sizeof *weight);
    const int ok = key != NULL && centre != NULL && width != NULL && weight != NULL;
    uint32_t i, a;
    for (i = 0; ok && i < m->count; i++) {
        uint32_t p[3];
        for (a = 0; a < 3; a++) {
            const float x = m->centre[i][a];
            p[a] = !(x > 0.0f) ? 0u : x >= 1.0f ? 0x1fffffu : (uint32_t)(x * 2097152.0f);
        }
        key[i].key = tetcasti_morton(p[0], p[1], p[2]);
        key[i].i = i;
    }
    if (ok) {
        tetcasti_rbf_sort(key, m->count);
        for (i = 0; i < m->count; i++) {
            memcpy(centre[i], m->centre[key[i].i], sizeof *centre);
            width[i] = m->width[key[i].i];
            memcpy(weight + (size_t)i * m->components, m->weight + (size_t)key[i].i * m->components,
                   m->components * sizeof *weight);
        }
        memcpy(m->centre, centre, m->count * sizeof *centre);
        memcpy(m->width, width, m->count * sizeof *width);
        memcpy(m->weight, weight, (size_t)m->count * m->components * sizeof *weight);
    }
    tetcasti_free(&m->mem, key);
    tetcasti_free(&m->mem, centre);
    tetcasti_free(&m->mem, width);
    tetcasti_free(&m->mem, weight);
    return ok;
}

static tetcast_result tetcasti_rbf_check(const tetcast_rbf_desc *d) {
    uint32_t c;
    if (d->components > TETCAST_RBF_MAX_COMPONENTS || (uint32_t)d->kernel >= TETCAST_KERNEL_COUNT ||
        (d->cut != 0.0f && !(d->cut >= 1.0f && d->cut <= 8.0f)) || !(d->epsilon >= 0.0f && d->epsilon < 1e30f) ||
        (d->function_count != 0 && d->functions == NULL) ||
        ((d->base_dims[0] != 0) != (d->base != NULL))) return TETCAST_ERR_INVALID_ARG;
    for (c = 0; c < TETCAST_RBF_MAX_COMPONENTS; c++)
        if (!(tetcasti_absf(d->offset[c]) < TETCASTI_VALUE_END)) return TETCAST_ERR_INVALID_ARG;
    if (d->function_count > TETCAST_RBF_MAX_FUNCTIONS) return TETCAST_ERR_RANGE;
    return TETCAST_OK;
}

static int tetcasti_rbf_dims_ok(const uint32_t dims[3]) { /* all 0, or none and not too many */
    if (dims[0] == 0 && dims[1] == 0 && dims[2] == 0) return 1;
    if (dims[0] == 0 || dims[1] == 0 || dims[2] == 0) return 0;
    return dims[0] <= TETCAST_RBF_MAX_NODES && dims[1] <= TETCAST_RBF_MAX_NODES && dims[2] <= TETCAST_RBF_MAX_NODES &&
           (uint64_t)dims[0] * dims[1] <= TETCAST_RBF_MAX_NODES &&
           (uint64_t)dims[0] * dims[1] * dims[2] <= TETCAST_RBF_MAX_NODES;
}

static int tetcasti_rbf_function_ok(const tetcast_rbf *m, uint32_t i) {
    uint32_t a;
    int ok = m->width[i] >= 1e-6f && m->width[i] <= 1e6f;
    for (a = 0; a < 3; a++) ok = ok && tetcasti_absf(m->centre[i][a]) <= 1e6f;
    for (a = 0; a < m->components; a++)
        ok = ok && tetcasti_absf(m->weight[(size_t)i * m->components + a]) < TETCASTI_VALUE_END;
    return ok;
}

TETCAST_DEF tetcast_result tetcast_rbf_create(const tetcast_rbf_desc *desc, tetcast_rbf **out) {
    tetcasti_mem mem;
    tetcast_rbf *m;
    tetcast_result r;
    size_t i, nodes;
    uint32_t a;
    float most = 0.0f;
    if (out == NULL) return TETCAST_ERR_INVALID_ARG;
    *out = NULL;
    if (desc == NULL) return TETCAST_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    r = tetcasti_env_open(&desc->env, &mem);
    if (r == TETCAST_OK) r = tetcasti_rbf_check(desc);
    if (r == TETCAST_OK && !tetcasti_rbf_dims_ok(desc->base_dims)) r = TETCAST_ERR_RANGE;
    if (r != TETCAST_OK) return tetcasti_fail(desc->env.error, r, 0, "functions: an option is out of range");
    m = (tetcast_rbf *)tetcasti_alloc_zero(&mem, 1, sizeof *m);
    if (m == NULL) return tetcasti_fail(desc->env.error, TETCAST_ERR_NO_MEMORY, 0, "functions: out of memory");
    m->mem = mem;
    m->components = desc->components != 0 ? desc->components : 1;
    m->count = (uint32_t)desc->function_count;
    m->kernel = desc->kernel;
    m->cut = desc->cut != 0.0f ? desc->cut : 3.5f;
    m->max_error = m->mean_error = -1.0f;
    memcpy(m->offset, desc->offset, sizeof m->offset);
    memcpy(m->dims, desc->base_dims, sizeof m->dims);
    for (a = 0; a < 3; a++) {
        m->box_min[a] = desc->box_min[a];
        m->box_max[a] = desc->box_max[a];
        m->metric[a] = desc->metric[a] != 0.0 ? desc->metric[a] : 1.0;
    }
    if (!tetcasti_rbf_place(m)) {
        tetcast_rbf_destroy(m);
        return tetcasti_fail(desc->env.error, TETCAST_ERR_INVALID_ARG, 0, "functions: the box or the metric is none");
    }
    if (!tetcasti_rbf_alloc(m)) r = TETCAST_ERR_NO_MEMORY;
    for (i = 0; r == TETCAST_OK && i < m->count; i++) {
        const tetcast_rbf_function *f = &desc->functions[i];
        tetcasti_rbf_local(m, f->centre, m->centre[i]);
        m->width[i] = (float)(f->width / m->unit);
        memcpy(m->weight + i * m->components, f->weight, m->components * sizeof *m->weight);
        for (a = 0; a < m->components; a++)
            if (tetcasti_absf(f->weight[a]) > most) most = tetcasti_absf(f->weight[a]);
        if (!tetcasti_rbf_function_ok(m, (uint32_t)i))
            r = tetcasti_fail(desc->env.error, TETCAST_ERR_INVALID_ARG, i, "functions: number % is out of range");
    }
    nodes = (size_t)m->dims[0] * m->dims[1] * m->dims[2] * m->components;
    for (i = 0; r == TETCAST_OK && i < nodes; i++) {
        m->node[i] = desc->base[i];
        if (!(tetcasti_absf(m->node[i]) < TETCASTI_VALUE_END))
            r = tetcasti_fail(desc->env.error, TETCAST_ERR_INVALID_ARG, i / m->components,
                              "functions: node % of the base is not finite");
    }
    m->epsilon = desc->epsilon != 0.0f ? desc->epsilon : 1e-3f * most;
    if (r == TETCAST_OK && !tetcasti_rbf_order(m)) r = TETCAST_ERR_NO_MEMORY;
    if (r == TETCAST_OK) r = tetcasti_rbf_finish(m);
    if (r != TETCAST_OK) {
        tetcast_rbf_destroy(m);
        if (r == TETCAST_ERR_NO_MEMORY) (void)tetcasti_fail(desc->env.error, r, 0, "functions: out of memory");
        return r;
    }
    *out = m;
    return TETCAST_OK;
}

TETCAST_DEF int tetcast_rbf_get_function(const tetcast_rbf *rbf, uint32_t index, tetcast_rbf_function *out) {
    uint32_t a;
    if (rbf == NULL || out == NULL || index >= rbf->count) return 0;
    memset(out, 0, sizeof *out);
    for (a = 0; a < 3; a++) out->centre[a] = rbf->box_min[a] + (double)rbf->centre[index][a] * rbf->scale[a];
    out->width = (double)rbf->width[index] * rbf->unit;
    memcpy(out->weight, rbf->weight + (size_t)index * rbf->components, rbf->components * sizeof *out->weight);
    return 1;
}

/* ---- files ---- */

enum { TETCASTI_RBF_HEADER = 216 };
static const uint8_t tetcasti_rbf_magic[8] = {0x89, 0x52, 0x42, 0x46, 0x0d, 0x0a, 0x1a, 0x0a}; /* 89 R B F CR LF ^Z LF */

/* Bytes of the nodes and of the functions. */
static void tetcasti_rbf_sizes(const tetcast_rbf *m, uint64_t *nodes, uint64_t *functions) {
    const tetcasti_rbf_bits *b = &m->bits;
    const uint64_t n = (uint64_t)m->dims[0] * m->dims[1] * m->dims[2] * m->components;
    const uint32_t each = b->position[0] == 0 ? 32u * (4u + m->components)
        : b->position[0] + b->position[1] + b->position[2] + b->width + b->weight * m->components;
    *nodes = (n * (b->position[0] == 0 ? 32u : b->node) + 7u) / 8u;
    *functions = ((uint64_t)m->count * each + 7u) / 8u;
}

typedef struct tetcasti_bits { uint8_t *p; const uint8_t *from; uint64_t at; } tetcasti_bits; /* lowest bits first */

static void tetcasti_bits_put(tetcasti_bits *b, uint32_t bits, uint32_t value) {
    uint32_t i;
    for (i = 0; i < bits; i++, b->at++)
        if (value >> i & 1u) b->p[b->at >> 3] = (uint8_t)(b->p[b->at >> 3] | 1u << (b->at & 7u));
}
static uint32_t tetcasti_bits_get(tetcasti_bits *b, uint32_t bits) {
    uint32_t i, v = 0;
    for (i = 0; i < bits; i++, b->at++) v |= (uint32_t)(b->from[b->at >> 3] >> (b->at & 7u) & 1u) << i;
    return v;
}
static int32_t tetcasti_bits_signed(tetcasti_bits *b, uint32_t bits) {
    const uint32_t v = tetcasti_bits_get(b, bits);
    return bits == 0 ? 0 : (int32_t)v - (int32_t)((v >> (bits - 1)) << (bits - 1) << 1);
}
static uint32_t tetcasti_float_bits(float x) { uint32_t u; memcpy(&u, &x, 4); return u; }
static float tetcasti_bits_float(uint32_t u) { float x; memcpy(&x, &u, 4); return x; }
static void tetcasti_store_f64(uint8_t *p, double x) { uint64_t u; memcpy(&u, &x, 8); tetcasti_store_u64(p, u); }
static double tetcasti_load_f64(const uint8_t *p) {
    const uint64_t u = tetcasti_load_u64(p);
    double x;
    memcpy(&x, &u, 8);
    return x;
}

/* Numbers <-> what is stored of them. */
static float tetcasti_rbf_position(const tetcast_rbf *m, uint32_t axis, uint32_t q) {
    return (float)((double)m->size[axis] * (double)q / (double)(((uint32_t)1 << m->bits.position[axis]) - 1u));
}
static uint32_t tetcasti_rbf_position_code(const tetcast_rbf *m, uint32_t axis, double x) {
    const uint32_t last = ((uint32_t)1 << m->bits.position[axis]) - 1u;
    const double q = m->size[axis] > 0.0f ? x / (double)m->size[axis] * (double)last + 0.5 : 0.0;
    return !(q > 0.0) ? 0u : q >= (double)last ? last : (uint32_t)q;
}
static float tetcasti_rbf_width(const tetcast_rbf *m, uint32_t q) {
    return (float)((double)m->bits.width_min * tetcasti_exp2((double)q / 8.0));
}
static uint32_t tetcasti_rbf_width_code(const tetcast_rbf *m, double w) {
    const uint32_t last = ((uint32_t)1 << m->bits.width) - 1u;
    const double q = 8.0 * tetcasti_log2(w / (double)m->bits.width_min) + 0.5;
    return !(q > 0.0) ? 0u : q >= (double)last ? last : (uint32_t)q;
}
static int32_t tetcasti_rbf_code(double x, double step, uint32_t bits) { /* nearest multiple of step in `bits` bits */
    const double most = (double)(((uint32_t)1 << (bits - 1)) - 1u), q = x / step;
    if (!(q > -most)) return (int32_t)-most;
    if (q >= most) return (int32_t)most;
    return (int32_t)tetcasti_floor(q + 0.5);
}

static uint64_t tetcasti_rbf_checksum(const uint8_t *p, size_t size) {
    uint64_t h = tetcasti_hash_bytes(0x7262660d0a1a0a01u, p, 24);
    return tetcasti_hash_bytes(h, p + 32, size - 32);
}

static void tetcasti_rbf_write_header(const tetcast_rbf *m, uint8_t *p, uint64_t size) {
    const tetcasti_rbf_bits *b = &m->bits;
    uint32_t a;
    memcpy(p, tetcasti_rbf_magic, 8);
    tetcasti_store_u16(p + 8, 1);
    tetcasti_store_u16(p + 12, TETCASTI_RBF_HEADER);
    p[14] = (uint8_t)m->kernel;
    p[15] = (uint8_t)m->components;
    tetcasti_store_u64(p + 16, size);
    tetcasti_store_u32(p + 32, m->count);
    tetcasti_store_u32(p + 48, tetcasti_float_bits(m->cut));
    tetcasti_store_u32(p + 52, tetcasti_float_bits(m->epsilon));
    p[59] = (uint8_t)b->width;
    p[60] = (uint8_t)b->weight;
    p[61] = (uint8_t)b->node;
    tetcasti_store_u32(p + 64, tetcasti_float_bits(b->width_min));
    tetcasti_store_u32(p + 68, tetcasti_float_bits(b->weight_step));
    tetcasti_store_u32(p + 72, tetcasti_float_bits(b->node_step));
    tetcasti_store_u32(p + 76, tetcasti_float_bits(m->max_error));
    tetcasti_store_u32(p + 80, tetcasti_float_bits(m->mean_error));
    tetcasti_store_u32(p + 84, tetcasti_float_bits(m->range[0]));
    tetcasti_store_u32(p + 88, tetcasti_float_bits(m->range[1]));
    for (a = 0; a < 3; a++) {
        tetcasti_store_u32(p + 36 + 4 * a, m->dims[a]);
        p[56 + a] = (uint8_t)b->position[a];
        tetcasti_store_f64(p + 112 + 8 * a, m->box_min[a]);
        tetcasti_store_f64(p + 136 + 8 * a, m->box_max[a]);
        tetcasti_store_f64(p + 160 + 8 * a, m->metric[a]);
    }
    for (a = 0; a < TETCAST_RBF_MAX_COMPONENTS; a++) tetcasti_store_u32(p + 96 + 4 * a, tetcasti_float_bits(m->offset[a]));
}

TETCAST_DEF tetcast_result tetcast_rbf_save_memory(const tetcast_rbf *rbf, void *buffer, size_t capacity,
                                                   size_t *out_size) {
    const tetcast_rbf *m = rbf;
    uint64_t nodes, functions, size;
    uint8_t *p = (uint8_t *)buffer;
    tetcasti_bits b;
    size_t i, count;
    uint32_t a;
    if (out_size != NULL) *out_size = 0;
    if (rbf == NULL || out_size == NULL) return TETCAST_ERR_INVALID_ARG;
    tetcasti_rbf_sizes(m, &nodes, &functions);
    size = TETCASTI_RBF_HEADER + nodes + functions;
    if (size > (size_t)-1) return TETCAST_ERR_RANGE;
    *out_size = (size_t)size;
    if (buffer == NULL) return TETCAST_OK;
    if (capacity < size) return TETCAST_ERR_RANGE;
    memset(p, 0, (size_t)size);
    tetcasti_rbf_write_header(m, p, size);
    count = (size_t)m->dims[0] * m->dims[1] * m->dims[2] * m->components;
    b.p = p + TETCASTI_RBF_HEADER;
    b.at = 0;
    for (i = 0; i < count; i++) {
        if (m->bits.position[0] == 0) tetcasti_bits_put(&b, 32, tetcasti_float_bits(m->node[i]));
        else tetcasti_bits_put(&b, m->bits.node, (uint32_t)tetcasti_rbf_code(
            (double)m->node[i] - (double)m->offset[i % m->components], (double)m->bits.node_step, m->bits.node));
    }
    b.p += nodes;
    b.at = 0;
    for (i = 0; i < m->count; i++) {
        for (a = 0; a < 3; a++) {
            if (m->bits.position[0] == 0) tetcasti_bits_put(&b, 32, tetcasti_float_bits(m->centre[i][a]));
            else tetcasti_bits_put(&b, m->bits.position[a], tetcasti_rbf_position_code(m, a, (double)m->centre[i][a]));
        }
        if (m->bits.position[0] == 0) tetcasti_bits_put(&b, 32, tetcasti_float_bits(m->width[i]));
        else tetcasti_bits_put(&b, m->bits.width, tetcasti_rbf_width_code(m, (double)m->width[i]));
        for (a = 0; a < m->components; a++) {
            const float w = m->weight[i * m->components + a];
            if (m->bits.position[0] == 0) tetcasti_bits_put(&b, 32, tetcasti_float_bits(w));
            else tetcasti_bits_put(&b, m->bits.weight, (uint32_t)tetcasti_rbf_code(
                (double)w, (double)m->bits.weight_step, m->bits.weight));
        }
    }
    tetcasti_store_u64(p + 24, tetcasti_rbf_checksum(p, (size_t)size));
    return TETCAST_OK;
}

/* The header, checked. */
static tetcast_result tetcasti_rbf_read_header(const uint8_t *p, size_t size, tetcast_rbf *m, uint64_t *at) {
    tetcasti_rbf_bits *b = &m->bits;
    uint32_t a, raw;
    uint64_t nodes, functions;
    float f[12];
    *at = 0;
    if (size >= 8 && memcmp(p, tetcasti_rbf_magic, 8) != 0) return TETCAST_ERR_FORMAT;
    *at = size;
    if (size < TETCASTI_RBF_HEADER) return TETCAST_ERR_TRUNCATED;
    *at = 8;
    if (tetcasti_load_u16(p + 8) != 1) return TETCAST_ERR_VERSION;
    *at = 12;
    if (tetcasti_load_u16(p + 12) != TETCASTI_RBF_HEADER) return TETCAST_ERR_FORMAT;
    *at = 16;
    if (tetcasti_load_u64(p + 16) != size) return size < tetcasti_load_u64(p + 16) ? TETCAST_ERR_TRUNCATED : TETCAST_ERR_FORMAT;
    *at = 24;
    if (tetcasti_load_u64(p + 24) != tetcasti_rbf_checksum(p, size)) return TETCAST_ERR_CHECKSUM;
    m->kernel = (tetcast_kernel)p[14];
    m->components = p[15];
    m->count = tetcasti_load_u32(p + 32);
    *at = 14;
    if (p[14] >= TETCAST_KERNEL_COUNT || m->components < 1 || m->components > TETCAST_RBF_MAX_COMPONENTS)
        return TETCAST_ERR_FORMAT;
    for (a = 0; a < 3; a++) {
        m->dims[a] = tetcasti_load_u32(p + 36 + 4 * a);
        b->position[a] = p[56 + a];
        m->box_min[a] = tetcasti_load_f64(p + 112 + 8 * a);
        m->box_max[a] = tetcasti_load_f64(p + 136 + 8 * a);
        m->metric[a] = tetcasti_load_f64(p + 160 + 8 * a);
    }
    b->width = p[59];
    b->weight = p[60];
    b->node = p[61];
    for (a = 0; a < 12; a++) f[a] = tetcasti_bits_float(tetcasti_load_u32(p + (a < 2 ? 48 : 56) + 4 * a));
    m->cut = f[0];
    m->epsilon = f[1];
    b->width_min = f[2];
    b->weight_step = f[3];
    b->node_step = f[4];
    m->max_error = f[5];
    m->mean_error = f[6];
    m->range[0] = f[7];
    m->range[1] = f[8];
    for (a = 0; a < TETCAST_RBF_MAX_COMPONENTS; a++) {
        m->offset[a] = tetcasti_bits_float(tetcasti_load_u32(p + 96 + 4 * a));
        *at = 96;
        if (!(tetcasti_absf(m->offset[a]) < TETCASTI_VALUE_END)) return TETCAST_ERR_FORMAT;
    }
    *at = 32;
    if (m->count > TETCAST_RBF_MAX_FUNCTIONS || !tetcasti_rbf_dims_ok(m->dims)) return TETCAST_ERR_FORMAT;
    *at = 48;
    if (!(m->cut >= 1.0f && m->cut <= 8.0f) || !(m->epsilon >= 0.0f && m->epsilon < 1e30f)) return TETCAST_ERR_FORMAT;
    for (a = 5; a < 9; a++) if (!tetcasti_finite_f(f[a])) return TETCAST_ERR_FORMAT;
    *at = 56;
    raw = b->position[0] == 0;
    if (raw) {
        if (b->position[1] != 0 || b->position[2] != 0 || b->width != 0 || b->weight != 0 || b->node != 0)
            return TETCAST_ERR_FORMAT;
    } else {
        for (a = 0; a < 3; a++) if (b->position[a] < 1 || b->position[a] > 21) return TETCAST_ERR_FORMAT;
        if (b->width > 8 || b->weight < 2 || b->weight > 24 || b->node < 2 || b->node > 24) return TETCAST_ERR_FORMAT;
        if (!(b->width_min >= 1e-6f && b->width_min <= 1e-3f * 1e6f / 4.0f) || !(b->weight_step > 1e-37f) ||
            !(b->weight_step < 1e30f) || !(b->node_step > 1e-37f) || !(b->node_step < 1e30f)) return TETCAST_ERR_FORMAT;
        if (!(tetcasti_exp2((double)((1u << b->width) - 1u) / 8.0) * (double)b->width_min <= 1e6)) return TETCAST_ERR_FORMAT;
    }
    for (a = 62; a < 64; a++) if (p[a] != 0) return TETCAST_ERR_FORMAT;
    for (a = 184; a < TETCASTI_RBF_HEADER; a++) if (p[a] != 0) return TETCAST_ERR_FORMAT;
    *at = 112;
    if (!tetcasti_rbf_place(m)) return TETCAST_ERR_FORMAT;
    tetcasti_rbf_sizes(m, &nodes, &functions);
    *at = 16;
    return TETCASTI_RBF_HEADER + nodes + functions == size ? TETCAST_OK : TETCAST_ERR_FORMAT;
}

static tetcast_result tetcasti_rbf_read(const uint8_t *p, size_t size, tetcast_rbf *m, uint64_t *at) {
    tetcast_result r = tetcasti_rbf_read_header(p, size, m, at);
    uint64_t nodes, functions;
    tetcasti_bits b;
    size_t i, count;
    uint32_t a, raw;
    if (r != TETCAST_OK) return r;
    *at = 0;
    if (!tetcasti_rbf_alloc(m)) return TETCAST_ERR_NO_MEMORY;
    tetcasti_rbf_sizes(m, &nodes, &functions);
    raw = m->bits.position[0] == 0;
    count = (size_t)m->dims[0] * m->dims[1] * m->dims[2] * m->components;
    b.from = p + TETCASTI_RBF_HEADER;
    b.at = 0;
    for (i = 0; i < count; i++) {
        if (raw) m->node[i] = tetcasti_bits_float(tetcasti_bits_get(&b, 32));
        else m->node[i] = (float)((double)m->offset[i % m->components] +
                                  (double)tetcasti_bits_signed(&b, m->bits.node) * (double)m->bits.node_step);
        *at = TETCASTI_RBF_HEADER + (b.at >> 3);
        if (!(tetcasti_absf(m->node[i]) < TETCASTI_VALUE_END)) return TETCAST_ERR_FORMAT;
    }
    b.from += nodes;
    b.at = 0;
    for (i = 0; i < m->count; i++) {
        for (a = 0; a < 3; a++) {
            const uint32_t q = tetcasti_bits_get(&b, raw ? 32u : m->bits.position[a]);
            m->centre[i][a] = raw ? tetcasti_bits_float(q) : tetcasti_rbf_position(m, a, q);
        }
        a = tetcasti_bits_get(&b, raw ? 32u : m->bits.width);
        m->width[i] = raw ? tetcasti_bits_float(a) : tetcasti_rbf_width(m, a);
        for (a = 0; a < m->components; a++) {
            if (raw) m->weight[i * m->components + a] = tetcasti_bits_float(tetcasti_bits_get(&b, 32));
            else m->weight[i * m->components + a] =
                (float)((double)tetcasti_bits_signed(&b, m->bits.weight) * (double)m->bits.weight_step);
        }
        *at = TETCASTI_RBF_HEADER + nodes + (b.at >> 3);
        if (!tetcasti_rbf_function_ok(m, (uint32_t)i)) return TETCAST_ERR_FORMAT;
    }
    *at = 0;
    return tetcasti_rbf_finish(m);
}

TETCAST_DEF tetcast_result tetcast_rbf_load_memory(const tetcast_env *env, const void *data, size_t size,
                                                   tetcast_rbf **out) {
    tetcast_env none;
    tetcasti_mem mem;
    tetcast_rbf *m;
    tetcast_result r;
    uint64_t at = 0;
    if (out == NULL) return TETCAST_ERR_INVALID_ARG;
    *out = NULL;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    if (data == NULL && size != 0) return TETCAST_ERR_INVALID_ARG;
    r = tetcasti_env_open(env, &mem);
    if (r != TETCAST_OK) return r;
    m = (tetcast_rbf *)tetcasti_alloc_zero(&mem, 1, sizeof *m);
    if (m == NULL) return tetcasti_fail(env->error, TETCAST_ERR_NO_MEMORY, 0, "functions: out of memory");
    m->mem = mem;
    r = tetcasti_rbf_read((const uint8_t *)data, size, m, &at);
    if (r == TETCAST_OK) {
        *out = m;
        return TETCAST_OK;
    }
    tetcast_rbf_destroy(m);
    if (r == TETCAST_ERR_NO_MEMORY) return tetcasti_fail(env->error, r, 0, "functions: out of memory");
    return tetcasti_fail(env->error, r, at, "functions: the file is not right at byte %");
}

#ifndef TETCAST_NO_STDIO
TETCAST_DEF tetcast_result tetcast_rbf_save_file(const tetcast_rbf *rbf, const tetcast_env *env, const char *path) {
    tetcast_env none;
    tetcasti_mem mem;
    size_t size;
    void *p;
    FILE *file;
    int ok;
    tetcast_result r;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    if (path == NULL) return TETCAST_ERR_INVALID_ARG;
    r = tetcasti_env_open(env, &mem);
    if (r == TETCAST_OK) r = tetcast_rbf_save_memory(rbf, NULL, 0, &size);
    if (r != TETCAST_OK) return r;
    p = tetcasti_alloc(&mem, size);
    if (p == NULL) return tetcasti_fail(env->error, TETCAST_ERR_NO_MEMORY, 0, "functions: out of memory");
    (void)tetcast_rbf_save_memory(rbf, p, size, &size);
    file = fopen(path, "wb");
    ok = file != NULL && fwrite(p, 1, size, file) == size;
    if (file != NULL && fclose(file) != 0) ok = 0;
    tetcasti_free(&mem, p);
    return ok ? TETCAST_OK : tetcasti_fail(env->error, TETCAST_ERR_IO, 0, "functions: the file cannot be written");
}

TETCAST_DEF tetcast_result tetcast_rbf_load_file(const tetcast_env *env, const char *path, tetcast_rbf **out) {
    tetcast_env none;
    tetcasti_mem mem;
    tetcast_result r;
    FILE *file;
    long end = -1;
    uint8_t *p = NULL;
    if (out == NULL) return TETCAST_ERR_INVALID_ARG;
    *out = NULL;
    if (path == NULL) return TETCAST_ERR_INVALID_ARG;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    r = tetcasti_env_open(env, &mem);
    if (r != TETCAST_OK) return r;
    file = fopen(path, "rb");
    if (file != NULL && fseek(file, 0, SEEK_END) == 0) end = ftell(file);
    if (end >= 0 && fseek(file, 0, SEEK_SET) == 0) {
        p = (uint8_t *)tetcasti_alloc(&mem, (size_t)end + 1);
        r = p == NULL ? TETCAST_ERR_NO_MEMORY
            : fread(p, 1, (size_t)end, file) != (size_t)end ? TETCAST_ERR_IO : TETCAST_OK;
    } else r = TETCAST_ERR_IO;
    if (file != NULL) (void)fclose(file);
    if (r == TETCAST_OK) r = tetcast_rbf_load_memory(env, p, (size_t)end, out);
    else (void)tetcasti_fail(env->error, r, 0, "functions: the file cannot be read");
    tetcasti_free(&mem, p);
    return r;
}
#endif
/* ---------------------------------------------------------------------------
   rbf_eval: values and derivatives at points, bounds, features of flows.        // >>rbf_eval

   Up to eight points of one leaf go through its list together, one function after the other. A function that does not
   reach a point adds 0, so the sum over the list and the sum over all functions are the same bits, and nothing jumps
   between leaves.
   --------------------------------------------------------------------------- */

#define TETCASTI_RBF_CHUNK 256u /* points of a task */

typedef struct tetcasti_rbf_packet { /* eight points; sums per component and, where asked for, along x y z */
    float p[3][8];
    float sum[TETCAST_RBF_MAX_COMPONENTS][8];
    float slope[TETCAST_RBF_MAX_COMPONENTS][3][8];
} tetcasti_rbf_packet;

/* The leaf of a place, or TETCASTI_NONE outside of the root: there all functions are asked. */
static uint32_t tetcasti_rbf_find(const tetcast_rbf *m, const float p[3]) {
    uint32_t node = 0, k, a, bit;
    uint32_t q[3];
    for (a = 0; a < 3; a++) {
        if (!(p[a] >= 0.0f && p[a] < 1.0f)) return TETCAST_NONE;
        q[a] = (uint32_t)(p[a] * (float)(1u << TETCASTI_RBF_DEPTH));
    }
    for (bit = TETCASTI_RBF_DEPTH; m->tree[node].child != 0; node = m->tree[node].child + k) {
        bit--;
        k = (q[0] >> bit & 1u) | (q[1] >> bit & 1u) << 1 | (q[2] >> bit & 1u) << 2;
    }
    return node;
}

#define TETCASTI_RBF_ONE(kernel, want) do { \
    float sl, phi; \
    const float dx = v->p[0][l] - f->c[0], dy = v->p[1][l] - f->c[1], dz = v->p[2][l] - f->c[2]; \
    const float d2 = (dx * dx + dy * dy) + dz * dz; \
    phi = tetcasti_rbf_phi(kernel, f, d2, (want) ? &sl : NULL); \
    for (c = 0; c < n; c++) v->sum[c][l] += f->w[c] * phi; \
    if (want) for (c = 0; c < n; c++) { \
        const float s = f->w[c] * sl; \
        v->slope[c][0][l] += s * dx; \
        v->slope[c][1][l] += s * dy; \
        v->slope[c][2][l] += s * dz; \
    } } while (0)

TETCASTI_INLINE void tetcasti_rbf_add_kind(const tetcast_kernel kernel, const tetcast_rbf *m, const uint32_t *list,
                                           uint32_t count, int want, tetcasti_rbf_packet *v) {
    const uint32_t n = m->components;
    uint32_t i, l, c;
    for (i = 0; i < count; i++) {
        const tetcasti_rbf_record *f = &m->record[list != NULL ? list[i] : i];
        if (want) for (l = 0; l < 8; l++) TETCASTI_RBF_ONE(kernel, 1);
        else for (l = 0; l < 8; l++) TETCASTI_RBF_ONE(kernel, 0);
    }
}
static void tetcasti_rbf_add(const tetcast_rbf *m, const uint32_t *list, uint32_t count, int want,
                             tetcasti_rbf_packet *v) {
    switch (m->kernel) {
    case TETCAST_KERNEL_GAUSS: tetcasti_rbf_add_kind(TETCAST_KERNEL_GAUSS, m, list, count, want, v); break;
    case TETCAST_KERNEL_GAUSS_CUT: tetcasti_rbf_add_kind(TETCAST_KERNEL_GAUSS_CUT, m, list, count, want, v); break;
    case TETCAST_KERNEL_WENDLAND2: tetcasti_rbf_add_kind(TETCAST_KERNEL_WENDLAND2, m, list, count, want, v); break;
    case TETCAST_KERNEL_WENDLAND4: tetcasti_rbf_add_kind(TETCAST_KERNEL_WENDLAND4, m, list, count, want, v); break;
    default: tetcasti_rbf_add_kind(TETCAST_KERNEL_POWER, m, list, count, want, v); break;
    }
}

#if TETCASTI_AVX2
TETCASTI_TARGET_AVX2 TETCASTI_INLINE __m256 tetcasti_exp2_fast8(__m256 x) {
    const __m256 magic = _mm256_set1_ps(TETCASTI_RBF_MAGIC);
    __m256 t, f, p;
    x = _mm256_max_ps(x, _mm256_set1_ps(-120.0f));
    t = _mm256_add_ps(x, magic);
    f = _mm256_sub_ps(x, _mm256_sub_ps(t, magic));
    p = _mm256_add_ps(_mm256_mul_ps(_mm256_set1_ps(0.001327647198f), f), _mm256_set1_ps(0.009675541334f));
    p = _mm256_add_ps(_mm256_mul_ps(p, f), _mm256_set1_ps(0.05550713274f));
    p = _mm256_add_ps(_mm256_mul_ps(p, f), _mm256_set1_ps(0.2402211972f));
    p = _mm256_add_ps(_mm256_mul_ps(p, f), _mm256_set1_ps(0.6931469671f));
    p = _mm256_add_ps(_mm256_mul_ps(p, f), _mm256_set1_ps(1.000000072f));
    return _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p),
                                                _mm256_slli_epi32(_mm256_castps_si256(t), 23)));
}

/* phi of eight squared distances, as tetcasti_rbf_phi. */
TETCASTI_TARGET_AVX2 TETCASTI_INLINE __m256 tetcasti_rbf_phi8(const tetcast_kernel kernel,
                                                              const tetcasti_rbf_record *f, __m256 d2, const int want,
                                                              __m256 *slope) {
    const __m256 zero = _mm256_setzero_ps(), one = _mm256_set1_ps(1.0f), a = _mm256_set1_ps(f->a);
    const __m256 x = _mm256_mul_ps(a, d2);
    __m256 s, s2, s4, q;
    if (kernel == TETCAST_KERNEL_GAUSS || kernel == TETCAST_KERNEL_GAUSS_CUT) {
        const __m256 g = tetcasti_exp2_fast8(x), m = _mm256_sub_ps(g, _mm256_set1_ps(f->e));
        const __m256 in = _mm256_cmp_ps(m, zero, _CMP_GT_OQ);
        if (want) *slope = _mm256_and_ps(in, _mm256_mul_ps(_mm256_mul_ps(_mm256_set1_ps(1.38629436f), a), g));
        return _mm256_and_ps(in, kernel == TETCAST_KERNEL_GAUSS ? m : g);
    }
    if (kernel == TETCAST_KERNEL_POWER) {
        s = _mm256_max_ps(_mm256_add_ps(one, x), zero);
        s2 = _mm256_mul_ps(s, s);
        s4 = _mm256_mul_ps(s2, s2);
        if (want) *slope = _mm256_mul_ps(_mm256_mul_ps(_mm256_set1_ps(16.0f), a), _mm256_mul_ps(s4, _mm256_mul_ps(s2, s)));
        return _mm256_mul_ps(s4, s4);
    }
    q = _mm256_sqrt_ps(_mm256_sub_ps(zero, x));
    s = _mm256_max_ps(_mm256_sub_ps(one, q), zero);
    s2 = _mm256_mul_ps(s, s);
    s4 = _mm256_mul_ps(s2, s2);
    if (kernel == TETCAST_KERNEL_WENDLAND2) {
        if (want) *slope = _mm256_mul_ps(_mm256_mul_ps(_mm256_set1_ps(20.0f), a), _mm256_mul_ps(s2, s));
        return _mm256_mul_ps(s4, _mm256_add_ps(_mm256_mul_ps(_mm256_set1_ps(4.0f), q), one));
    }
    if (want) *slope = _mm256_mul_ps(_mm256_mul_ps(_mm256_set1_ps(18.666667f), a),
        _mm256_mul_ps(_mm256_add_ps(_mm256_mul_ps(_mm256_set1_ps(5.0f), q), one), _mm256_mul_ps(s4, s)));
    return _mm256_mul_ps(_mm256_mul_ps(_mm256_mul_ps(s4, s2),
        _mm256_add_ps(_mm256_mul_ps(_mm256_add_ps(_mm256_mul_ps(_mm256_set1_ps(35.0f), q), _mm256_set1_ps(18.0f)), q),
                      _mm256_set1_ps(3.0f))), _mm256_set1_ps(0.33333333f));
}

TETCASTI_TARGET_AVX2 TETCASTI_INLINE void tetcasti_rbf_add8_kind(const tetcast_kernel kernel, const uint32_t n,
        const int want, const tetcast_rbf *m, const uint32_t *list, uint32_t count, tetcasti_rbf_packet *v) {
    const __m256 px = _mm256_loadu_ps(v->p[0]), py = _mm256_loadu_ps(v->p[1]), pz = _mm256_loadu_ps(v->p[2]);
    __m256 sum[TETCAST_RBF_MAX_COMPONENTS], slope[TETCAST_RBF_MAX_COMPONENTS][3];
    uint32_t i, c, a;
    for (c = 0; c < n; c++) {
        sum[c] = _mm256_loadu_ps(v->sum[c]);
        if (want) for (a = 0; a < 3; a++) slope[c][a] = _mm256_loadu_ps(v->slope[c][a]);
    }
    for (i = 0; i < count; i++) {
        const tetcasti_rbf_record *f = &m->record[list != NULL ? list[i] : i];
        const __m256 dx = _mm256_sub_ps(px, _mm256_set1_ps(f->c[0])), dy = _mm256_sub_ps(py, _mm256_set1_ps(f->c[1]));
        const __m256 dz = _mm256_sub_ps(pz, _mm256_set1_ps(f->c[2]));
        const __m256 d2 = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)),
                                        _mm256_mul_ps(dz, dz));
        __m256 sl = _mm256_setzero_ps();
        const __m256 phi = tetcasti_rbf_phi8(kernel, f, d2, want, &sl);
        for (c = 0; c < n; c++) sum[c] = _mm256_add_ps(sum[c], _mm256_mul_ps(_mm256_set1_ps(f->w[c]), phi));
        if (want) for (c = 0; c < n; c++) {
            const __m256 s = _mm256_mul_ps(_mm256_set1_ps(f->w[c]), sl);
            slope[c][0] = _mm256_add_ps(slope[c][0], _mm256_mul_ps(s, dx));
            slope[c][1] = _mm256_add_ps(slope[c][1], _mm256_mul_ps(s, dy));
            slope[c][2] = _mm256_add_ps(slope[c][2], _mm256_mul_ps(s, dz));
        }
    }
    for (c = 0; c < n; c++) {
        _mm256_storeu_ps(v->sum[c], sum[c]);
        if (want) for (a = 0; a < 3; a++) _mm256_storeu_ps(v->slope[c][a], slope[c][a]);
    }
}

#define TETCASTI_RBF_ADD8(name, kernel) \
    TETCASTI_TARGET_AVX2 static void name(const tetcast_rbf *m, const uint32_t *list, uint32_t count, int want, \
                                          tetcasti_rbf_packet *v) { \
        if (m->components == 1 && !want) tetcasti_rbf_add8_kind(kernel, 1, 0, m, list, count, v); \
        else if (m->components == 1) tetcasti_rbf_add8_kind(kernel, 1, 1, m, list, count, v); \
        else if (m->components == 3 && want) tetcasti_rbf_add8_kind(kernel, 3, 1, m, list, count, v); \
        else if (m->components == 3) tetcasti_rbf_add8_kind(kernel, 3, 0, m, list, count, v); \
        else if (want) tetcasti_rbf_add8_kind(kernel, m->components, 1, m, list, count, v); \
        else tetcasti_rbf_add8_kind(kernel, m->components, 0, m, list, count, v); \
    }
TETCASTI_RBF_ADD8(tetcasti_rbf_add8_gauss, TETCAST_KERNEL_GAUSS)
TETCASTI_RBF_ADD8(tetcasti_rbf_add8_cut, TETCAST_KERNEL_GAUSS_CUT)
TETCASTI_RBF_ADD8(tetcasti_rbf_add8_wendland2, TETCAST_KERNEL_WENDLAND2)
TETCASTI_RBF_ADD8(tetcasti_rbf_add8_wendland4, TETCAST_KERNEL_WENDLAND4)
TETCASTI_RBF_ADD8(tetcasti_rbf_add8_power, TETCAST_KERNEL_POWER)
#endif

typedef void tetcasti_rbf_add_fn(const tetcast_rbf *m, const uint32_t *list, uint32_t count, int want,
                                 tetcasti_rbf_packet *v);

static tetcast_isa tetcasti_rbf_isa(tetcast_isa isa) { /* AVX2 or scalar */
    const tetcast_isa best = tetcast_isa_best();
    if (isa == TETCAST_ISA_AUTO || isa > best) isa = best;
    return isa >= TETCAST_ISA_AVX2 ? TETCAST_ISA_AVX2 : TETCAST_ISA_SCALAR;
}
static tetcasti_rbf_add_fn *tetcasti_rbf_add_pick(const tetcast_rbf *m, tetcast_isa isa) {
#if TETCASTI_AVX2
    if (isa >= TETCAST_ISA_AVX2) {
        switch (m->kernel) {
        case TETCAST_KERNEL_GAUSS: return tetcasti_rbf_add8_gauss;
        case TETCAST_KERNEL_GAUSS_CUT: return tetcasti_rbf_add8_cut;
        case TETCAST_KERNEL_WENDLAND2: return tetcasti_rbf_add8_wendland2;
        case TETCAST_KERNEL_WENDLAND4: return tetcasti_rbf_add8_wendland4;
        default: return tetcasti_rbf_add8_power;
        }
    }
#endif
    (void)m;
    (void)isa;
    return tetcasti_rbf_add;
}

/* Points of one leaf: base, then the functions. Lanes from `lanes` on are copies of lane 0. */
static void tetcasti_rbf_sum(const tetcast_rbf *m, tetcasti_rbf_add_fn *add, uint32_t leaf, int want, uint32_t lanes,
                             tetcasti_rbf_packet *v) {
    uint32_t l, c, a;
    for (l = 0; l < lanes; l++) {
        float p[3], value[TETCAST_RBF_MAX_COMPONENTS], slope[TETCAST_RBF_MAX_COMPONENTS][3];
        for (a = 0; a < 3; a++) p[a] = v->p[a][l];
        tetcasti_rbf_base(m, p, value, want ? slope : NULL);
        for (c = 0; c < m->components; c++) {
            v->sum[c][l] = value[c];
            if (want) for (a = 0; a < 3; a++) v->slope[c][a][l] = slope[c][a];
        }
    }
    for (; l < 8; l++) {
        for (a = 0; a < 3; a++) v->p[a][l] = v->p[a][0];
        for (c = 0; c < m->components; c++) {
            v->sum[c][l] = v->sum[c][0];
            if (want) for (a = 0; a < 3; a++) v->slope[c][a][l] = v->slope[c][a][0];
        }
    }
    if (leaf == TETCAST_NONE) add(m, NULL, m->count, want, v);
    else add(m, m->index + m->tree[leaf].first, m->tree[leaf].count, want, v);
}

/* Up to TETCASTI_RBF_CHUNK points, local coordinates. values [n][components], slopes [n][components][3] (local) or NULL. */
static void tetcasti_rbf_points(const tetcast_rbf *m, tetcasti_rbf_add_fn *add, int all, const float (*p)[3],
                                uint32_t n, float *values, float *slopes) {
    tetcasti_rbf_key key[TETCASTI_RBF_CHUNK];
    tetcasti_rbf_packet v;
    uint32_t i, j, l, c, a, sorted = 1, lanes;
    for (i = 0; i < n; i++) {
        key[i].key = all ? TETCAST_NONE : tetcasti_rbf_find(m, p[i]);
        key[i].i = i;
        if (i != 0 && key[i].key < key[i - 1].key) sorted = 0;
    }
    if (!sorted) tetcasti_rbf_sort(key, n);
    for (i = 0; i < n; i += lanes) {
        for (lanes = 1; lanes < 8 && i + lanes < n && key[i + lanes].key == key[i].key;) lanes++;
        for (l = 0; l < lanes; l++)
            for (a = 0; a < 3; a++) v.p[a][l] = p[key[i + l].i][a];
        tetcasti_rbf_sum(m, add, (uint32_t)key[i].key, slopes != NULL, lanes, &v);
        for (l = 0; l < lanes; l++) {
            j = key[i + l].i;
            for (c = 0; c < m->components; c++) {
                values[j * m->components + c] = v.sum[c][l];
                if (slopes != NULL)
                    for (a = 0; a < 3; a++) slopes[(j * m->components + c) * 3 + a] = v.slope[c][a][l];
            }
        }
    }
}

typedef struct tetcasti_rbf_job {
    const tetcast_rbf *m;
    tetcasti_rbf_add_fn *add;
    int all;
    const double *positions;   /* NULL: nodes of a grid */
    size_t count;
    uint32_t dims[3];
    float *values, *jacobians;
} tetcasti_rbf_job;

static void tetcasti_rbf_job_place(const tetcasti_rbf_job *t, size_t i, float p[3]) {
    uint32_t a, at[3];
    if (t->positions != NULL) {
        tetcasti_rbf_local(t->m, t->positions + 3 * i, p);
        return;
    }
    at[0] = (uint32_t)(i % t->dims[0]);
    at[1] = (uint32_t)(i / t->dims[0] % t->dims[1]);
    at[2] = (uint32_t)(i / t->dims[0] / t->dims[1]);
    for (a = 0; a < 3; a++)
        p[a] = t->dims[a] > 1 ? (float)((double)t->m->size[a] * (double)at[a] / (double)(t->dims[a] - 1))
                              : 0.5f * t->m->size[a];
}

static void tetcasti_task_rbf_points(void *ctx, uint32_t task) {
    const tetcasti_rbf_job *t = (const tetcasti_rbf_job *)ctx;
    const uint32_t n = t->m->components;
    const size_t first = (size_t)task * TETCASTI_RBF_CHUNK;
    const uint32_t count = t->count - first < TETCASTI_RBF_CHUNK ? (uint32_t)(t->count - first) : TETCASTI_RBF_CHUNK;
    float p[TETCASTI_RBF_CHUNK][3], value[TETCASTI_RBF_CHUNK / 4 * TETCAST_RBF_MAX_COMPONENTS];
    uint32_t i, k, c, a, part = TETCASTI_RBF_CHUNK / 4;
    for (i = 0; i < count; i++) tetcasti_rbf_job_place(t, first + i, p[i]);
    for (k = 0; k < count; k += part) { /* values may not be wanted; there is not that much stack */
        const uint32_t some = count - k < part ? count - k : part;
        float *values = t->values != NULL ? t->values + (first + k) * n : value;
        float *slopes = t->jacobians != NULL ? t->jacobians + (first + k) * n * 3 : NULL;
        tetcasti_rbf_points(t->m, t->add, t->all, (const float (*)[3])(p + k), some, values, slopes);
        for (i = 0; i < some; i++) {
            const float *q = p[k + i];
            const int bad = !tetcasti_finite_f((q[0] + q[1]) + q[2]);
            for (c = 0; c < n; c++) {
                if (bad) values[i * n + c] = NAN;
                if (slopes == NULL) continue;
                for (a = 0; a < 3; a++) {
                    float *s = &slopes[(i * n + c) * 3 + a];
                    *s = bad ? NAN : (float)((double)*s / t->m->scale[a]);
                }
            }
        }
    }
}

static tetcast_result tetcasti_rbf_eval_open(const tetcast_rbf_eval_desc *desc, const tetcast_rbf *m,
                                             tetcast_rbf_eval_desc *d, tetcasti_rbf_job *t) {
    tetcasti_mem mem;
    memset(d, 0, sizeof *d);
    memset(t, 0, sizeof *t);
    if (desc != NULL) *d = *desc;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    if (m == NULL) return TETCAST_ERR_INVALID_ARG;
    t->m = m;
    t->all = d->all != 0;
    t->add = tetcasti_rbf_add_pick(m, tetcasti_rbf_isa(d->isa));
    return tetcasti_env_open(&d->env, &mem);
}

static tetcast_result tetcasti_rbf_run(const tetcast_rbf_eval_desc *d, tetcasti_rbf_job *t) {
    if (t->count / TETCASTI_RBF_CHUNK >= 0x7fffffffu) return TETCAST_ERR_RANGE;
    tetcasti_parallel_for(&d->env, tetcasti_task_rbf_points, t,
                          (uint32_t)((t->count + TETCASTI_RBF_CHUNK - 1) / TETCASTI_RBF_CHUNK));
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_rbf_eval(const tetcast_rbf_eval_desc *desc, const tetcast_rbf *rbf,
                                            const double *positions, size_t count, float *values, float *jacobians) {
    tetcast_rbf_eval_desc d;
    tetcasti_rbf_job t;
    tetcast_result r = tetcasti_rbf_eval_open(desc, rbf, &d, &t);
    if (r != TETCAST_OK) return r;
    if (count != 0 && positions == NULL) return TETCAST_ERR_INVALID_ARG;
    t.positions = positions;
    t.count = count;
    t.values = values;
    t.jacobians = jacobians;
    return tetcasti_rbf_run(&d, &t);
}

TETCAST_DEF tetcast_result tetcast_rbf_grid(const tetcast_rbf_eval_desc *desc, const tetcast_rbf *rbf,
                                            const uint32_t dims[3], float *values) {
    tetcast_rbf_eval_desc d;
    tetcasti_rbf_job t;
    tetcast_result r = tetcasti_rbf_eval_open(desc, rbf, &d, &t);
    size_t count;
    if (r != TETCAST_OK) return r;
    if (dims == NULL || values == NULL || dims[0] == 0 || dims[1] == 0 || dims[2] == 0) return TETCAST_ERR_INVALID_ARG;
    if (!tetcasti_mul_size(dims[0], dims[1], &count) || !tetcasti_mul_size(count, dims[2], &count) ||
        !tetcasti_mul_size(count, rbf->components * sizeof(float), &t.count)) return TETCAST_ERR_RANGE;
    t.count = count;
    memcpy(t.dims, dims, sizeof t.dims);
    t.values = values;
    return tetcasti_rbf_run(&d, &t);
}

TETCAST_DEF void tetcast_rbf_get_info(const tetcast_rbf *rbf, tetcast_rbf_info *info) {
    const tetcast_rbf *m = rbf;
    uint64_t nodes, functions;
    uint32_t i, a;
    double lists = 0.0;
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (m == NULL) return;
    info->components = m->components;
    info->function_count = m->count;
    memcpy(info->base_dims, m->dims, sizeof m->dims);
    info->kernel = m->kernel;
    info->cut = m->cut;
    info->epsilon = m->epsilon;
    for (a = 0; a < 3; a++) {
        info->box_min[a] = m->box_min[a];
        info->box_max[a] = m->box_max[a];
        info->metric[a] = m->metric[a];
    }
    for (i = 0; i < m->count; i++) {
        const double w = (double)m->width[i] * m->unit;
        if (i == 0 || w < info->smallest_width) info->smallest_width = w;
        if (w > info->largest_width) info->largest_width = w;
        for (a = 0; a < m->components; a++) {
            const float x = tetcasti_absf(m->weight[(size_t)i * m->components + a]);
            if (x > info->largest_weight) info->largest_weight = x;
        }
    }
    memcpy(info->range, m->range, sizeof m->range);
    info->max_error = m->max_error;
    info->mean_error = m->mean_error;
    tetcasti_rbf_sizes(m, &nodes, &functions);
    info->file_bytes = TETCASTI_RBF_HEADER + nodes + functions;
    info->memory_bytes = m->mem.used;
    for (i = 0; i < m->tree_count; i++) {
        if (m->tree[i].child != 0) continue;
        info->cells++;
        if (m->tree[i].count > info->longest_list) info->longest_list = m->tree[i].count;
    }
    for (i = 0; i < 4096; i++) { /* places in the box instead of volumes */
        float p[3];
        uint32_t leaf;
        for (a = 0; a < 3; a++) p[a] = m->size[a] * ((float)(i >> 4 * a & 15u) + 0.5f) * (1.0f / 16.0f);
        leaf = tetcasti_rbf_find(m, p);
        if (leaf != TETCAST_NONE) lists += (double)m->tree[leaf].count;
    }
    info->mean_list = lists / 4096.0;
}

/* ---- bounds ---- */

/* Smallest and largest node, and differences of neighbours, in the cells that a box touches. */
static void tetcasti_rbf_base_bounds(const tetcast_rbf *m, uint32_t c, const float lo[3], const float hi[3],
                                     double range[2], double *slope) {
    uint32_t from[3], to[3], a, i, j, k;
    double steep[3] = {0.0, 0.0, 0.0};
    float u;
    if (m->node == NULL) {
        range[0] = range[1] = (double)m->offset[c];
        *slope = 0.0;
        return;
    }
    range[0] = 1e300;
    range[1] = -1e300;
    for (a = 0; a < 3; a++) {
        from[a] = tetcasti_rbf_cell(m, a, lo[a], &u);
        to[a] = tetcasti_rbf_cell(m, a, hi[a], &u) + (m->dims[a] > 1);
    }
    for (k = from[2]; k <= to[2]; k++)
        for (j = from[1]; j <= to[1]; j++)
            for (i = from[0]; i <= to[0]; i++) {
                const size_t n = m->components, row = n * m->dims[0];
                const float *v = m->node + (((size_t)k * m->dims[1] + j) * m->dims[0] + i) * n + c;
                range[0] = tetcasti_min(range[0], (double)*v);
                range[1] = tetcasti_max(range[1], (double)*v);
                if (i < to[0]) steep[0] = tetcasti_max(steep[0], tetcasti_abs((double)v[n] - (double)*v));
                if (j < to[1]) steep[1] = tetcasti_max(steep[1], tetcasti_abs((double)v[row] - (double)*v));
                if (k < to[2])
                    steep[2] = tetcasti_max(steep[2], tetcasti_abs((double)v[row * m->dims[1]] - (double)*v));
            }
    *slope = 0.0;
    for (a = 0; a < 3; a++) {
        const double s = steep[a] * (double)m->node_scale[a] / m->scale[a];
        *slope += s * s;
    }
    *slope = sqrt(*slope);
}

/* Largest slope of a kernel of width 1 and height 1. */
static double tetcasti_kernel_slope(const tetcast_rbf *m) {
    switch (m->kernel) {
    case TETCAST_KERNEL_WENDLAND2: return 2.109375 / 3.70; /* at q = 1/4 */
    case TETCAST_KERNEL_WENDLAND4: return 0.6075;          /* a little more than its largest */
    case TETCAST_KERNEL_POWER: return 0.6275;
    default: return 0.60653066; /* e^(-1/2), at one width; record.w has the factor of the shifted form */
    }
}

TETCAST_DEF tetcast_result tetcast_rbf_bounds(const tetcast_rbf *rbf, uint32_t component, const double box_min[3],
                                              const double box_max[3], float *lo, float *hi, float *gradient) {
    const tetcast_rbf *m = rbf;
    double range[2], slope, rounding = 0.0, least_scale;
    float from[3], to[3];
    uint32_t i, a;
    if (m == NULL || component >= m->components || box_min == NULL || box_max == NULL) return TETCAST_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++)
        if (!tetcasti_finite(box_min[a]) || !tetcasti_finite(box_max[a]) || box_min[a] > box_max[a])
            return TETCAST_ERR_INVALID_ARG;
    tetcasti_rbf_local(m, box_min, from);
    tetcasti_rbf_local(m, box_max, to);
    tetcasti_rbf_base_bounds(m, component, from, to, range, &slope);
    rounding = 1e-6 * tetcasti_max(tetcasti_abs(range[0]), tetcasti_abs(range[1]));
    least_scale = tetcasti_min(tetcasti_min(m->scale[0], m->scale[1]), m->scale[2]);
    for (i = 0; i < m->count; i++) {
        const tetcasti_rbf_record *f = &m->record[i];
        const double w = (double)f->w[component];
        float least = 0.0f, most = 0.0f, near_phi, far_phi;
        if (!tetcasti_rbf_touches(f, from, to)) continue;
        for (a = 0; a < 3; a++) {
            const float below = from[a] - f->c[a], above = f->c[a] - to[a];
            const float d = below > above ? below : above, e = below < above ? below : above;
            if (d > 0.0f) least += d * d;
            most += e * e;
        }
        near_phi = tetcasti_rbf_phi(m->kernel, f, least * 0.999998f, NULL);
        far_phi = tetcasti_rbf_phi(m->kernel, f, most * 1.000002f, NULL);
        range[w > 0.0 ? 1 : 0] += w * (double)near_phi;
        range[w > 0.0 ? 0 : 1] += w * (double)far_phi;
        rounding += 2e-6 * tetcasti_abs(w);
        slope += tetcasti_abs(w) * tetcasti_kernel_slope(m) / ((double)m->width[i] * least_scale);
    }
    if (lo != NULL) *lo = (float)(range[0] - rounding);
    if (hi != NULL) *hi = (float)(range[1] + rounding);
    if (gradient != NULL) *gradient = (float)(slope * 1.00001);
    return TETCAST_OK;
}

/* ---- flows ---- */

/* Middle eigenvalue of the symmetric matrix {xx, yy, zz, xy, xz, yz}: closed form with the angle's cosine found by
   Newton's iteration on 4 c^3 - 3 c = r instead of arc cosine and cosine. */
static double tetcasti_middle_eigenvalue(const double s[6]) {
    const double q = (s[0] + s[1] + s[2]) / 3.0, a = s[0] - q, b = s[1] - q, c = s[2] - q;
    const double p2 = (a * a + b * b + c * c + 2.0 * (s[3] * s[3] + s[4] * s[4] + s[5] * s[5])) / 6.0, p = sqrt(p2);
    double r, x, y, lo = 0.5, hi = 1.0;
    uint32_t i;
    if (!(p > 1e-300) || !(p2 > 1e-28 * q * q)) return q;
    r = (a * (b * c - s[5] * s[5]) - s[3] * (s[3] * c - s[5] * s[4]) + s[4] * (s[3] * s[5] - b * s[4])) / (p * p2 * 2.0);
    r = r < -1.0 ? -1.0 : r > 1.0 ? 1.0 : r;
    /* the largest is q + 2 p x with 4 x^3 - 3 x = r, x in [1/2, 1], where that rises from -1 to 1 */
    x = 0.75 + 0.25 * r;
    for (i = 0; i < 60; i++) {
        const double g = (4.0 * x * x - 3.0) * x - r, d = 12.0 * x * x - 3.0;
        double next;
        if (g > 0.0) hi = x;
        else lo = x;
        next = d > 1e-6 ? x - g / d : 0.5 * (lo + hi);
        if (!(next >= lo && next <= hi)) next = 0.5 * (lo + hi);
        if (next == x) break;
        x = next;
    }
    /* the others are q - p x -+ p sqrt(3 (1 - x^2)) */
    y = 1.0 - x * x;
    return q - p * x + p * sqrt(3.0 * (y > 0.0 ? y : 0.0));
}

TETCAST_DEF void tetcast_flow_features(const float velocity[3], const float jacobian[9], tetcast_flow *out) {
    double j[9], s[6], w[3], m[6], most = 0.0, scale;
    uint32_t i, k;
    if (out == NULL || velocity == NULL || jacobian == NULL) return;
    memset(out, 0, sizeof *out);
    for (i = 0; i < 9; i++) {
        j[i] = (double)jacobian[i];
        most = tetcasti_max(most, tetcasti_abs(j[i]));
    }
    scale = most > 0.0 ? most : 1.0; /* lambda2 goes with its square */
    out->vorticity[0] = jacobian[7] - jacobian[5];
    out->vorticity[1] = jacobian[2] - jacobian[6];
    out->vorticity[2] = jacobian[3] - jacobian[1];
    for (i = 0; i < 9; i++) j[i] /= scale;
    for (i = 0; i < 3; i++) s[i] = j[4 * i];
    s[3] = 0.5 * (j[1] + j[3]);
    s[4] = 0.5 * (j[2] + j[6]);
    s[5] = 0.5 * (j[5] + j[7]);
    w[0] = 0.5 * (j[7] - j[5]);
    w[1] = 0.5 * (j[2] - j[6]);
    w[2] = 0.5 * (j[3] - j[1]);
    /* W^2 = w w^T - |w|^2 */
    m[0] = s[0] * s[0] + s[3] * s[3] + s[4] * s[4] - w[1] * w[1] - w[2] * w[2];
    m[1] = s[3] * s[3] + s[1] * s[1] + s[5] * s[5] - w[0] * w[0] - w[2] * w[2];
    m[2] = s[4] * s[4] + s[5] * s[5] + s[2] * s[2] - w[0] * w[0] - w[1] * w[1];
    m[3] = s[0] * s[3] + s[3] * s[1] + s[4] * s[5] + w[0] * w[1];
    m[4] = s[0] * s[4] + s[3] * s[5] + s[4] * s[2] + w[0] * w[2];
    m[5] = s[3] * s[4] + s[1] * s[5] + s[5] * s[2] + w[1] * w[2];
    scale *= scale * tetcasti_middle_eigenvalue(m);
    out->lambda2 = scale > 3e38 ? 3e38f : scale < -3e38 ? -3e38f : (float)scale;
    scale = 0.0;
    for (k = 0; k < 3; k++) scale += (double)velocity[k] * (double)velocity[k];
    out->speed = (float)sqrt(scale);
    scale = 0.0;
    for (k = 0; k < 3; k++) scale += (double)velocity[k] * (double)out->vorticity[k];
    out->helicity = scale > 3e38 ? 3e38f : scale < -3e38 ? -3e38f : (float)scale;
}
/* ---------------------------------------------------------------------------
   rbf_fit: points -> coarse grid and functions, with a guaranteed error.        // >>rbf_fit

   1  points are put into bins of about eight, a row of bins along x is one run of points,
   2  the coarse grid is the least-squares fit of its nodes (normal equations with 27 entries a row, conjugate gradients),
   3  greedy: where the error is largest goes a function, of the width out of a ladder that takes most off the sum of
      squares in its reach, then five Gauss-Newton steps move and widen it,
   4  sweeps: each function in turn is taken out, left out if nothing exceeds the tolerance without it, else fitted
      again with weights that grow with the error, so that the largest errors sink,
   3 and 4 alternate while the threshold sinks to the tolerance. All parameters are rounded to what is stored before the
   error is updated.
   Threads: blocks of bins in eight colours (parities); functions of one block reach less than half a block beyond it, so
   blocks of one colour share no point.
   --------------------------------------------------------------------------- */

#define TETCASTI_FIT_BIN 8u          /* points in a bin, about */
#define TETCASTI_FIT_SPLIT 8         /* positions are stored in this part of the spacing */
#define TETCASTI_FIT_LADDER 24u

typedef struct tetcasti_fit_function {
    float c[3], width, w[TETCAST_RBF_MAX_COMPONENTS];
    uint32_t dead;
} tetcasti_fit_function;

typedef struct tetcasti_fit_block {
    uint32_t lo[3], hi[3];           /* bins, hi excluded */
    tetcasti_fit_function *f;
    size_t count, room;
    uint32_t dropped, inserted;
} tetcasti_fit_block;

typedef struct tetcasti_fit {
    tetcasti_mem *mem;
    const tetcast_env *env;
    tetcast_rbf *m;                  /* place, kernel, cut, components, bits */
    tetcast_isa isa;
    uint32_t n, count;
    float *x, *y, *z;                /* local */
    float *value[TETCAST_RBF_MAX_COMPONENTS], *res[TETCAST_RBF_MAX_COMPONENTS], *heed; /* heed: weight of a point */
    uint32_t *source;                /* number in the input */
    uint32_t bins[3];
    float bin_scale[3];
    uint32_t *start;                 /* [bins + 1] */
    float *peak;                     /* [bins]: largest squared error */
    double spacing;                  /* local */
    double range;
    float reach, e;                  /* radius / width; what the kernel is shifted by */
    float widest;
    float tolerance, threshold, heed_scale;
    uint32_t sharp, polish;          /* heed errors; move and widen */
    size_t cap;                      /* functions of all blocks, trials end there */
    tetcasti_fit_block *block;
    uint32_t blocks[3], color;
    uint32_t failed, full;           /* atomics */
    uint32_t inserted;               /* atomic */
    tetcast_rbf_report *report;
    uint64_t rejected, duplicates;
} tetcasti_fit;

/* Function -> record; weights are those of the model, the record's are divided as always. */
static void tetcasti_fit_record(const tetcasti_fit *t, const tetcasti_fit_function *f, tetcasti_rbf_record *r) {
    const double w = (double)f->width;
    const float divide = t->e;
    uint32_t c;
    memset(r, 0, sizeof *r);
    memcpy(r->c, f->c, sizeof r->c);
    if (t->m->kernel == TETCAST_KERNEL_GAUSS) {
        r->a = (float)(-0.72134752044448170368 / (w * w));
        r->e = divide;
    } else r->a = (float)(-1.0 / ((double)t->reach * (double)t->reach * w * w));
    r->radius = t->reach * f->width * 1.00001f;
    for (c = 0; c < t->n; c++) r->w[c] = (float)((double)f->w[c] / (1.0 - (double)divide));
}

typedef struct tetcasti_fit_rows { uint32_t lo[3], hi[3]; } tetcasti_fit_rows; /* bins in reach, both included */

TETCASTI_INLINE uint32_t tetcasti_fit_bin(const tetcasti_fit *t, uint32_t a, float x) {
    const float q = x * t->bin_scale[a];
    return !(q > 0.0f) ? 0u : q >= (float)t->bins[a] ? t->bins[a] - 1 : (uint32_t)q;
}
static void tetcasti_fit_reach(const tetcasti_fit *t, const tetcasti_rbf_record *r, tetcasti_fit_rows *rows) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        rows->lo[a] = tetcasti_fit_bin(t, a, r->c[a] - r->radius);
        rows->hi[a] = tetcasti_fit_bin(t, a, r->c[a] + r->radius);
    }
}

/* Weighted sums over the points in reach: phi^2, and phi times the error per component. Eight lanes, whatever the
   instruction set: point k of a row goes into lane k mod 8. */
typedef struct tetcasti_fit_sums { float gg[8], g[TETCAST_RBF_MAX_COMPONENTS][8]; } tetcasti_fit_sums;

TETCASTI_INLINE void tetcasti_fit_row_sums(const tetcast_kernel kernel, const tetcasti_fit *t,
                                           const tetcasti_rbf_record *r, uint32_t from, uint32_t to,
                                           tetcasti_fit_sums *s) {
    uint32_t i, c;
    for (i = from; i < to; i++) {
        const uint32_t l = (i - from) & 7u;
        const float dx = t->x[i] - r->c[0], dy = t->y[i] - r->c[1], dz = t->z[i] - r->c[2];
        const float phi = tetcasti_rbf_phi(kernel, r, (dx * dx + dy * dy) + dz * dz, NULL), h = phi * t->heed[i];
        s->gg[l] += h * phi;
        for (c = 0; c < t->n; c++) s->g[c][l] += h * t->res[c][i];
    }
}
TETCASTI_INLINE void tetcasti_fit_row_apply(const tetcast_kernel kernel, const tetcasti_fit *t,
                                            const tetcasti_rbf_record *r, uint32_t from, uint32_t to) {
    uint32_t i, c;
    for (i = from; i < to; i++) {
        const float dx = t->x[i] - r->c[0], dy = t->y[i] - r->c[1], dz = t->z[i] - r->c[2];
        const float phi = tetcasti_rbf_phi(kernel, r, (dx * dx + dy * dy) + dz * dz, NULL);
        for (c = 0; c < t->n; c++) t->res[c][i] -= r->w[c] * phi;
    }
}
#if TETCASTI_AVX2
TETCASTI_TARGET_AVX2 TETCASTI_INLINE void tetcasti_fit_row_sums8(const tetcast_kernel kernel, const tetcasti_fit *t,
        const tetcasti_rbf_record *r, uint32_t from, uint32_t to, tetcasti_fit_sums *s) {
    const __m256 cx = _mm256_set1_ps(r->c[0]), cy = _mm256_set1_ps(r->c[1]), cz = _mm256_set1_ps(r->c[2]);
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    __m256 gg = _mm256_loadu_ps(s->gg);
    uint32_t i, c;
    for (i = from; i < to; i += 8) {
        const __m256i k = _mm256_cmpgt_epi32(_mm256_set1_epi32((int32_t)(to - i)), lane);
        const __m256 dx = _mm256_sub_ps(_mm256_maskload_ps(t->x + i, k), cx);
        const __m256 dy = _mm256_sub_ps(_mm256_maskload_ps(t->y + i, k), cy);
        const __m256 dz = _mm256_sub_ps(_mm256_maskload_ps(t->z + i, k), cz);
        const __m256 d2 = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)),
                                        _mm256_mul_ps(dz, dz));
        const __m256 phi = tetcasti_rbf_phi8(kernel, r, d2, 0, NULL);
        const __m256 h = _mm256_mul_ps(phi, _mm256_maskload_ps(t->heed + i, k));
        gg = _mm256_add_ps(gg, _mm256_mul_ps(h, phi));
        for (c = 0; c < t->n; c++)
            _mm256_storeu_ps(s->g[c], _mm256_add_ps(_mm256_loadu_ps(s->g[c]),
                                                    _mm256_mul_ps(h, _mm256_maskload_ps(t->res[c] + i, k))));
    }
    _mm256_storeu_ps(s->gg, gg);
}
TETCASTI_TARGET_AVX2 TETCASTI_INLINE void tetcasti_fit_row_apply8(const tetcast_kernel kernel, const tetcasti_fit *t,
        const tetcasti_rbf_record *r, uint32_t from, uint32_t to) {
    const __m256 cx = _mm256_set1_ps(r->c[0]), cy = _mm256_set1_ps(r->c[1]), cz = _mm256_set1_ps(r->c[2]);
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    uint32_t i, c;
    for (i = from; i < to; i += 8) {
        const __m256i k = _mm256_cmpgt_epi32(_mm256_set1_epi32((int32_t)(to - i)), lane);
        const __m256 dx = _mm256_sub_ps(_mm256_maskload_ps(t->x + i, k), cx);
        const __m256 dy = _mm256_sub_ps(_mm256_maskload_ps(t->y + i, k), cy);
        const __m256 dz = _mm256_sub_ps(_mm256_maskload_ps(t->z + i, k), cz);
        const __m256 d2 = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)),
                                        _mm256_mul_ps(dz, dz));
        const __m256 phi = tetcasti_rbf_phi8(kernel, r, d2, 0, NULL);
        for (c = 0; c < t->n; c++)
            _mm256_maskstore_ps(t->res[c] + i, k, _mm256_sub_ps(_mm256_maskload_ps(t->res[c] + i, k),
                                                                _mm256_mul_ps(_mm256_set1_ps(r->w[c]), phi)));
    }
}
#endif

#define TETCASTI_FIT_EACH_ROW(row_fn, kernel, extra) do { \
    for (k = rows->lo[2]; k <= rows->hi[2]; k++) \
        for (j = rows->lo[1]; j <= rows->hi[1]; j++) { \
            const size_t row = ((size_t)k * t->bins[1] + j) * t->bins[0]; \
            const uint32_t from = t->start[row + rows->lo[0]], to = t->start[row + rows->hi[0] + 1]; \
            row_fn(kernel, t, r, from, to extra); \
        } } while (0)
#define TETCASTI_FIT_COMMA_S , s
#define TETCASTI_FIT_NOTHING
#define TETCASTI_FIT_LOOPS(suffix, target, sums, apply) \
    target static void tetcasti_fit_sums_##suffix(const tetcasti_fit *t, const tetcasti_rbf_record *r, \
                                                  const tetcasti_fit_rows *rows, tetcasti_fit_sums *s) { \
        uint32_t j, k; \
        switch (t->m->kernel) { \
        case TETCAST_KERNEL_GAUSS: TETCASTI_FIT_EACH_ROW(sums, TETCAST_KERNEL_GAUSS, TETCASTI_FIT_COMMA_S); break; \
        case TETCAST_KERNEL_WENDLAND2: \
            TETCASTI_FIT_EACH_ROW(sums, TETCAST_KERNEL_WENDLAND2, TETCASTI_FIT_COMMA_S); break; \
        case TETCAST_KERNEL_WENDLAND4: \
            TETCASTI_FIT_EACH_ROW(sums, TETCAST_KERNEL_WENDLAND4, TETCASTI_FIT_COMMA_S); break; \
        default: TETCASTI_FIT_EACH_ROW(sums, TETCAST_KERNEL_POWER, TETCASTI_FIT_COMMA_S); break; \
        } \
    } \
    target static void tetcasti_fit_apply_##suffix(const tetcasti_fit *t, const tetcasti_rbf_record *r, \
                                                   const tetcasti_fit_rows *rows) { \
        uint32_t j, k; \
        switch (t->m->kernel) { \
        case TETCAST_KERNEL_GAUSS: TETCASTI_FIT_EACH_ROW(apply, TETCAST_KERNEL_GAUSS, TETCASTI_FIT_NOTHING); break; \
        case TETCAST_KERNEL_WENDLAND2: \
            TETCASTI_FIT_EACH_ROW(apply, TETCAST_KERNEL_WENDLAND2, TETCASTI_FIT_NOTHING); break; \
        case TETCAST_KERNEL_WENDLAND4: \
            TETCASTI_FIT_EACH_ROW(apply, TETCAST_KERNEL_WENDLAND4, TETCASTI_FIT_NOTHING); break; \
        default: TETCASTI_FIT_EACH_ROW(apply, TETCAST_KERNEL_POWER, TETCASTI_FIT_NOTHING); break; \
        } \
    }
TETCASTI_FIT_LOOPS(scalar, TETCASTI_UNUSED, tetcasti_fit_row_sums, tetcasti_fit_row_apply)
#if TETCASTI_AVX2
TETCASTI_FIT_LOOPS(avx2, TETCASTI_TARGET_AVX2, tetcasti_fit_row_sums8, tetcasti_fit_row_apply8)
#endif

static double tetcasti_fit_total(const float v[8]) {
    return (((double)v[0] + (double)v[1]) + ((double)v[2] + (double)v[3])) +
           (((double)v[4] + (double)v[5]) + ((double)v[6] + (double)v[7]));
}

/* Best weights (not rounded) of a function that is not in the error yet, and by how much they lessen the sum. */
static double tetcasti_fit_weigh(const tetcasti_fit *t, const tetcasti_fit_function *f, double w[4], double *square) {
    tetcasti_rbf_record r;
    tetcasti_fit_rows rows;
    tetcasti_fit_sums s;
    double gg, gain = 0.0;
    uint32_t c;
    tetcasti_fit_record(t, f, &r);
    tetcasti_fit_reach(t, &r, &rows);
    memset(&s, 0, sizeof s);
#if TETCASTI_AVX2
    if (t->isa >= TETCAST_ISA_AVX2) tetcasti_fit_sums_avx2(t, &r, &rows, &s);
    else
#endif
    tetcasti_fit_sums_scalar(t, &r, &rows, &s);
    gg = tetcasti_fit_total(s.gg);
    *square = gg;
    for (c = 0; c < t->n; c++) {
        const double g = tetcasti_fit_total(s.g[c]);
        w[c] = gg > 1e-30 ? g / gg : 0.0;
        gain += w[c] * g;
    }
    return gain;
}

/* Largest errors of bins, and how much heed is paid to points. */
static void tetcasti_fit_look(tetcasti_fit *t, const tetcasti_fit_rows *rows) {
    uint32_t i, j, k, b, c;
    for (k = rows->lo[2]; k <= rows->hi[2]; k++)
        for (j = rows->lo[1]; j <= rows->hi[1]; j++) {
            const size_t row = ((size_t)k * t->bins[1] + j) * t->bins[0];
            for (b = rows->lo[0]; b <= rows->hi[0]; b++) {
                float most = 0.0f;
                for (i = t->start[row + b]; i < t->start[row + b + 1]; i++) {
                    float e = 0.0f;
                    for (c = 0; c < t->n; c++) e += t->res[c][i] * t->res[c][i];
                    most = e > most ? e : most;
                    if (t->sharp) {
                        float h = e * t->heed_scale;
                        h = h < 2.0f ? h : 2.0f;
                        t->heed[i] = 0.1f + h * h;
                    }
                }
                t->peak[row + b] = most;
            }
        }
}

/* Subtract a function from the error (sign 1), or take it back (sign -1; heed stays as it is). */
static void tetcasti_fit_apply(tetcasti_fit *t, const tetcasti_fit_function *f, int sign) {
    tetcasti_rbf_record r;
    tetcasti_fit_rows rows;
    uint32_t c;
    memset(&r, 0, sizeof r);
    tetcasti_fit_record(t, f, &r);
    if (sign < 0) for (c = 0; c < t->n; c++) r.w[c] = -r.w[c];
    tetcasti_fit_reach(t, &r, &rows);
#if TETCASTI_AVX2
    if (t->isa >= TETCAST_ISA_AVX2) tetcasti_fit_apply_avx2(t, &r, &rows);
    else
#endif
    tetcasti_fit_apply_scalar(t, &r, &rows);
    if (sign > 0) tetcasti_fit_look(t, &rows);
}

/* Largest squared error in reach: of the points, without looking at heed, or of the bins as they are known. */
static float tetcasti_fit_most(const tetcasti_fit *t, const tetcasti_fit_function *f, int known) {
    tetcasti_rbf_record r;
    tetcasti_fit_rows rows;
    uint32_t i, j, k, c;
    float most = 0.0f;
    tetcasti_fit_record(t, f, &r);
    tetcasti_fit_reach(t, &r, &rows);
    for (k = rows.lo[2]; k <= rows.hi[2]; k++)
        for (j = rows.lo[1]; j <= rows.hi[1]; j++) {
            const size_t row = ((size_t)k * t->bins[1] + j) * t->bins[0];
            if (known) {
                for (i = rows.lo[0]; i <= rows.hi[0]; i++) most = t->peak[row + i] > most ? t->peak[row + i] : most;
                continue;
            }
            for (i = t->start[row + rows.lo[0]]; i < t->start[row + rows.hi[0] + 1]; i++) {
                float e = 0.0f;
                for (c = 0; c < t->n; c++) e += t->res[c][i] * t->res[c][i];
                most = e > most ? e : most;
            }
        }
    return most;
}

/* Round to what is stored. */
static void tetcasti_fit_round_place(const tetcasti_fit *t, const tetcasti_fit_block *b, const double c[3],
                                     double width, tetcasti_fit_function *f) {
    uint32_t a;
    for (a = 0; a < 3; a++) { /* not far out of its block */
        const double side = t->bin_scale[a] > 0.0f ? 1.0 / (double)t->bin_scale[a] : 0.0;
        const double lo = side * b->lo[a] - t->spacing, hi = side * b->hi[a] + t->spacing;
        const double x = c[a] < lo ? lo : c[a] > hi ? hi : c[a];
        f->c[a] = tetcasti_rbf_position(t->m, a, tetcasti_rbf_position_code(t->m, a, x));
    }
    width = width < (double)t->widest ? width : (double)t->widest * 0.9999;
    f->width = tetcasti_rbf_width(t->m, tetcasti_rbf_width_code(t->m, width));
    while (f->width > t->widest && f->width > t->m->bits.width_min)
        f->width = tetcasti_rbf_width(t->m, tetcasti_rbf_width_code(t->m, (double)f->width * 0.917));
}
static double tetcasti_fit_round_weights(const tetcasti_fit *t, const double w[4], double square,
                                         tetcasti_fit_function *f) {
    /* record weights are what was fitted: the model's are them times what the kernel is divided by */
    const double e = 1.0 - (double)t->e;
    double gain = 0.0;
    uint32_t c;
    for (c = 0; c < t->n; c++) {
        f->w[c] = (float)((double)tetcasti_rbf_code(w[c] * e, (double)t->m->bits.weight_step, 24) *
                          (double)t->m->bits.weight_step);
        gain += (2.0 * w[c] - (double)f->w[c] / e) * ((double)f->w[c] / e) * square;
    }
    return gain;
}

/* Sums of Gauss-Newton's normal equations for place, logarithm of the width and height. */
static void tetcasti_fit_normal(const tetcasti_fit *t, const tetcasti_fit_function *f, double a[5][5], double b[5]) {
    tetcasti_rbf_record r;
    tetcasti_fit_rows rows;
    uint32_t i, j, k, c, p, q;
    double w2 = 0.0;
    tetcasti_fit_record(t, f, &r);
    tetcasti_fit_reach(t, &r, &rows);
    memset(a, 0, 25 * sizeof a[0][0]);
    memset(b, 0, 5 * sizeof b[0]);
    for (c = 0; c < t->n; c++) w2 += (double)r.w[c] * (double)r.w[c];
    for (k = rows.lo[2]; k <= rows.hi[2]; k++)
        for (j = rows.lo[1]; j <= rows.hi[1]; j++) {
            const size_t row = ((size_t)k * t->bins[1] + j) * t->bins[0];
            for (i = t->start[row + rows.lo[0]]; i < t->start[row + rows.hi[0] + 1]; i++) {
                const float dx = t->x[i] - r.c[0], dy = t->y[i] - r.c[1], dz = t->z[i] - r.c[2];
                const float d2 = (dx * dx + dy * dy) + dz * dz;
                float slope, phi;
                double u[5], e = 0.0;
                if (d2 >= r.radius * r.radius) continue;
                phi = tetcasti_rbf_phi(t->m->kernel, &r, d2, &slope);
                u[0] = (double)(-slope * dx);
                u[1] = (double)(-slope * dy);
                u[2] = (double)(-slope * dz);
                u[3] = (double)(-slope * d2);
                u[4] = (double)phi;
                for (c = 0; c < t->n; c++) e += (double)(r.w[c] * (t->res[c][i] - r.w[c] * phi));
                e *= (double)t->heed[i];
                for (p = 0; p < 5; p++) {
                    const double h = u[p] * (double)t->heed[i];
                    b[p] += u[p] * e;
                    for (q = p; q < 5; q++) a[p][q] += h * u[q];
                }
            }
        }
    for (p = 0; p < 5; p++)
        for (q = p; q < 5; q++) a[q][p] = a[p][q] *= w2;
}

/* Cholesky, n <= 5. 0: not positive. */
static int tetcasti_fit_solve(double a[5][5], double b[5]) {
    int i, j, k;
    for (i = 0; i < 5; i++)
        for (j = 0; j <= i; j++) {
            double s = a[i][j];
            for (k = 0; k < j; k++) s -= a[i][k] * a[j][k];
            if (i == j) {
                if (!(s > 0.0)) return 0;
                a[i][i] = sqrt(s);
            } else a[i][j] = s / a[j][j];
        }
    for (i = 0; i < 5; i++) {
        for (k = 0; k < i; k++) b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
    for (i = 4; i >= 0; i--) {
        for (k = i + 1; k < 5; k++) b[i] -= a[k][i] * b[k];
        b[i] /= a[i][i];
    }
    return 1;
}

/* Move and widen a function that is not in the error; *gain: what it lessens the sum by so far.
   Narrow ones stay on their points: between them nothing would hold them. */
static void tetcasti_fit_polish(const tetcasti_fit *t, const tetcasti_fit_block *block, uint32_t steps,
                                tetcasti_fit_function *f, double *gain) {
    const double narrow = 0.7 * t->spacing;
    uint32_t s, p;
    for (s = 0; s < steps && (double)f->width >= narrow; s++) {
        double a[5][5], b[5], c[3], w[4], square, step = 0.0, longest, got;
        tetcasti_fit_function g = *f;
        tetcasti_fit_normal(t, f, a, b);
        for (p = 0; p < 5; p++) a[p][p] = a[p][p] * 1.02 + 1e-12 * a[4][4];
        if (!tetcasti_fit_solve(a, b)) return;
        for (p = 0; p < 3; p++) step += b[p] * b[p];
        longest = 0.6 * (double)f->width;
        step = sqrt(step) > longest ? longest / sqrt(step) : 1.0;
        for (p = 0; p < 3; p++) c[p] = (double)f->c[p] + step * b[p];
        b[3] = b[3] < -0.5 ? -0.5 : b[3] > 0.5 ? 0.5 : b[3];
        tetcasti_fit_round_place(t, block, c, (double)f->width * tetcasti_exp2(b[3] * 1.44269504088896340736), &g);
        if ((double)g.width < narrow) return;
        if (g.c[0] == f->c[0] && g.c[1] == f->c[1] && g.c[2] == f->c[2] && g.width == f->width) return;
        (void)tetcasti_fit_weigh(t, &g, w, &square);
        got = tetcasti_fit_round_weights(t, w, square, &g);
        if (!(got > *gain * 1.001)) return;
        *gain = got;
        *f = g;
    }
}

static int tetcasti_fit_add(tetcasti_fit *t, tetcasti_fit_block *b, const tetcasti_fit_function *f) {
    if (!tetcasti_grow(t->mem, (void **)&b->f, &b->room, b->count, b->count + 1, sizeof *b->f)) {
        tetcasti_atomic_store(&t->failed, 1u);
        return 0;
    }
    b->f[b->count++] = *f;
    b->inserted++;
    tetcasti_fit_apply(t, f, 1);
    return 1;
}

/* A function for the error at point i. */
static int tetcasti_fit_insert(tetcasti_fit *t, tetcasti_fit_block *b, uint32_t i) {
    tetcasti_fit_function f, best;
    double c[3], w[4], square, gain, most = -1.0, width = (double)t->m->bits.width_min;
    uint32_t k, worse = 0, a;
    memset(&best, 0, sizeof best);
    c[0] = (double)t->x[i];
    c[1] = (double)t->y[i];
    c[2] = (double)t->z[i];
    for (k = 0; k < TETCASTI_FIT_LADDER && width <= (double)t->widest && worse < 2; k++, width *= 1.41421356237309504880) {
        memset(&f, 0, sizeof f);
        tetcasti_fit_round_place(t, b, c, width, &f);
        gain = tetcasti_fit_weigh(t, &f, w, &square);
        if (gain > most) {
            most = gain;
            best = f;
            worse = 0;
        } else worse++;
    }
    (void)tetcasti_fit_weigh(t, &best, w, &square);
    gain = tetcasti_fit_round_weights(t, w, square, &best);
    if (t->polish && gain > 0.0) tetcasti_fit_polish(t, b, 5, &best, &gain);
    if (!(gain > 0.0)) { /* between its neighbours' errors: this point alone */
        tetcasti_fit_round_place(t, b, c, (double)t->m->bits.width_min, &best);
        for (a = 0; a < t->n; a++) w[a] = (double)t->res[a][i];
        (void)tetcasti_fit_round_weights(t, w, 1.0, &best);
    }
    return tetcasti_fit_add(t, b, &best);
}

/* Insert functions in a block until no error exceeds the threshold. */
static void tetcasti_task_fit_greedy(void *ctx, uint32_t task) {
    tetcasti_fit *t = (tetcasti_fit *)ctx;
    tetcasti_fit_block *b;
    uint32_t at[3], a, i, j, k;
    const float limit = t->threshold * t->threshold;
    for (a = 0; a < 3; a++) { /* blocks of one colour */
        const uint32_t n = (t->blocks[a] + 1 - (t->color >> a & 1u)) / 2;
        at[a] = task % n * 2 + (t->color >> a & 1u);
        task /= n;
    }
    b = &t->block[((size_t)at[2] * t->blocks[1] + at[1]) * t->blocks[0] + at[0]];
    for (;;) {
        float most = limit;
        size_t where = (size_t)-1;
        uint32_t best = 0;
        float peak = -1.0f;
        if (tetcasti_atomic_load(&t->failed) || tetcasti_atomic_load(&t->full)) return;
        for (k = b->lo[2]; k < b->hi[2]; k++)
            for (j = b->lo[1]; j < b->hi[1]; j++) {
                const size_t row = ((size_t)k * t->bins[1] + j) * t->bins[0];
                for (i = b->lo[0]; i < b->hi[0]; i++)
                    if (t->peak[row + i] > most) {
                        most = t->peak[row + i];
                        where = row + i;
                    }
            }
        if (where == (size_t)-1) return;
        for (i = t->start[where]; i < t->start[where + 1]; i++) {
            float e = 0.0f;
            for (a = 0; a < t->n; a++) e += t->res[a][i] * t->res[a][i];
            if (e > peak) {
                peak = e;
                best = i;
            }
        }
        if (tetcasti_atomic_add(&t->inserted, 1u) > t->cap) {
            tetcasti_atomic_store(&t->full, 1u);
            return;
        }
        if (!tetcasti_fit_insert(t, b, best)) return;
    }
}

/* Fit the functions of a block again, one after the other; leave out what is not needed. */
static void tetcasti_task_fit_sweep(void *ctx, uint32_t task) {
    tetcasti_fit *t = (tetcasti_fit *)ctx;
    tetcasti_fit_block *b;
    uint32_t at[3], a;
    const float limit = t->tolerance * t->tolerance;
    size_t i, n;
    for (a = 0; a < 3; a++) {
        const uint32_t k = (t->blocks[a] + 1 - (t->color >> a & 1u)) / 2;
        at[a] = task % k * 2 + (t->color >> a & 1u);
        task /= k;
    }
    b = &t->block[((size_t)at[2] * t->blocks[1] + at[1]) * t->blocks[0] + at[0]];
    for (i = 0; i < b->count; i++) {
        tetcasti_fit_function *f = &b->f[i], old = *f;
        double w[4], square, gain, before = 0.0;
        float most;
        if (tetcasti_atomic_load(&t->failed)) return;
        most = tetcasti_fit_most(t, f, 1);
        most = most > limit ? most : limit;
        tetcasti_fit_apply(t, f, -1);
        if (tetcasti_fit_most(t, f, 0) <= limit) {
            tetcasti_rbf_record r;
            tetcasti_fit_rows rows;
            tetcasti_fit_record(t, f, &r);
            tetcasti_fit_reach(t, &r, &rows);
            tetcasti_fit_look(t, &rows);
            f->dead = 1;
            b->dropped++;
            continue;
        }
        (void)tetcasti_fit_weigh(t, f, w, &square);
        for (a = 0; a < t->n; a++) {
            const double v = (double)old.w[a] / (1.0 - (double)t->e);
            before += (2.0 * w[a] - v) * v * square;
        }
        gain = tetcasti_fit_round_weights(t, w, square, f);
        if (gain > 0.0) tetcasti_fit_polish(t, b, 2, f, &gain);
        if (!(gain > before)) *f = old;
        tetcasti_fit_apply(t, f, 1);
        if (gain > before && (tetcasti_fit_most(t, f, 1) > most || tetcasti_fit_most(t, &old, 1) > most)) {
            tetcasti_fit_apply(t, f, -1); /* the largest error may not grow */
            *f = old;
            tetcasti_fit_apply(t, f, 1);
        }
    }
    for (i = n = 0; i < b->count; i++)
        if (!b->f[i].dead) b->f[n++] = b->f[i];
    b->count = n;
}

static void tetcasti_fit_colors(tetcasti_fit *t, tetcast_task_fn *task) {
    uint32_t a;
    for (t->color = 0; t->color < 8; t->color++) {
        uint32_t n = 1;
        for (a = 0; a < 3; a++) n *= (t->blocks[a] + 1 - (t->color >> a & 1u)) / 2;
        tetcasti_parallel_for(t->env, task, t, n);
    }
}

/* ---- points ---- */

/* Number in the input -> world position and values. 0: something is not finite. */
static int tetcasti_fit_read(const tetcast_rbf_points *in, size_t i, double p[3], double v[4]) {
    const size_t vs = tetcasti_array_stride(&in->values, in->components);
    uint32_t a, ok = 1;
    if (in->positions.data == NULL) {
        const size_t at[3] = {i % in->dims[0], i / in->dims[0] % in->dims[1], i / in->dims[0] / in->dims[1]};
        const int unit = in->spacing[0] == 0.0 && in->spacing[1] == 0.0 && in->spacing[2] == 0.0;
        for (a = 0; a < 3; a++) p[a] = in->origin[a] + (unit ? 1.0 : in->spacing[a]) * (double)at[a];
    } else {
        const size_t ps = tetcasti_array_stride(&in->positions, 3);
        for (a = 0; a < 3; a++) p[a] = tetcasti_array_get(&in->positions, ps, i, a);
    }
    for (a = 0; a < in->components; a++) {
        v[a] = tetcasti_array_get(&in->values, vs, i, a);
        ok = ok && tetcasti_abs(v[a]) < 1e30;
    }
    for (a = 0; a < 3; a++) ok = ok && tetcasti_abs(p[a]) < 1e30;
    return (int)ok;
}

/* Box, range, mean: a first look at the points. */
static tetcast_result tetcasti_fit_survey(tetcasti_fit *t, const tetcast_rbf_fit_desc *d,
                                          const tetcast_rbf_points *in) {
    tetcast_rbf *m = t->m;
    double lo = 1e300, hi = -1e300, longest = 0.0, sum[4] = {0.0, 0.0, 0.0, 0.0}, step = 0.0;
    size_t i, used = 0;
    uint32_t a, c;
    for (i = 0; i < in->count; i++) {
        double p[3], v[4], l = 0.0;
        if (!tetcasti_fit_read(in, i, p, v)) {
            t->rejected++;
            continue;
        }
        for (a = 0; a < 3; a++) {
            if (used == 0 || p[a] < m->box_min[a]) m->box_min[a] = p[a];
            if (used == 0 || p[a] > m->box_max[a]) m->box_max[a] = p[a];
        }
        for (c = 0; c < t->n; c++) {
            sum[c] += v[c];
            l += v[c] * v[c];
        }
        lo = tetcasti_min(lo, v[0]);
        hi = tetcasti_max(hi, v[0]);
        longest = tetcasti_max(longest, l);
        used++;
    }
    if (used == 0) return TETCAST_ERR_EMPTY;
    if (used > 0x7ffffff0u) return TETCAST_ERR_RANGE;
    t->count = (uint32_t)used;
    t->range = t->n == 1 ? hi - lo : sqrt(longest);
    m->range[0] = t->n == 1 ? (float)lo : 0.0f;
    m->range[1] = t->n == 1 ? (float)hi : (float)sqrt(longest);
    for (c = 0; c < t->n; c++) m->offset[c] = (float)(sum[c] / (double)used);
    if (in->positions.data == NULL && d->metric[0] == 0.0 && d->metric[1] == 0.0 && d->metric[2] == 0.0)
        for (a = 0; a < 3; a++)
            if (in->dims[a] > 1 && in->spacing[a] != 0.0 && (step == 0.0 || tetcasti_abs(in->spacing[a]) < step))
                step = tetcasti_abs(in->spacing[a]);
    for (a = 0; a < 3; a++) {
        m->metric[a] = d->metric[a] != 0.0 ? d->metric[a] : 1.0;
        if (step > 0.0 && in->dims[a] > 1) m->metric[a] = tetcasti_abs(in->spacing[a]) / step;
    }
    return tetcasti_rbf_place(m) ? TETCAST_OK : TETCAST_ERR_INVALID_ARG;
}

/* Bins, and the points in their order; points at one place become one. */
static int tetcasti_fit_sort(tetcasti_fit *t, const tetcast_rbf_points *in) {
    const uint32_t n = t->count;
    tetcasti_rbf_key *key = (tetcasti_rbf_key *)tetcasti_alloc_array(t->mem, n, sizeof *key);
    float (*p)[3] = (float (*)[3])tetcasti_alloc_array(t->mem, n, sizeof *p);
    float (*v)[4] = (float (*)[4])tetcasti_alloc_array(t->mem, n, sizeof *v);
    uint32_t *number = (uint32_t *)tetcasti_alloc_array(t->mem, n, sizeof *number);
    size_t bins = (size_t)t->bins[0] * t->bins[1] * t->bins[2], i, b;
    uint32_t *start = t->start, k = 0, a, c, out = 0;
    const int ok = key != NULL && p != NULL && v != NULL && number != NULL;
    for (i = 0; ok && i < in->count; i++) {
        double w[3], value[4];
        if (!tetcasti_fit_read(in, i, w, value)) continue;
        tetcasti_rbf_local(t->m, w, p[k]);
        for (c = 0; c < t->n; c++) v[k][c] = (float)value[c];
        number[k++] = (uint32_t)i;
    }
    if (ok) {
        memset(start, 0, (bins + 1) * sizeof *start);
        for (i = 0; i < n; i++) {
            uint32_t at[3];
            for (a = 0; a < 3; a++) at[a] = tetcasti_fit_bin(t, a, p[i][a]);
            t->source[i] = (uint32_t)(((size_t)at[2] * t->bins[1] + at[1]) * t->bins[0] + at[0]);
            start[t->source[i]]++;
        }
        for (b = 0, k = 0; b <= bins; b++) { /* starts; then each moves to its end while the bin is filled */
            const uint32_t some = b < bins ? start[b] : 0;
            start[b] = k;
            k += some;
        }
        for (i = 0; i < n; i++) {
            const uint32_t to = start[t->source[i]]++;
            key[to].key = tetcasti_hash_bytes(1, p[i], sizeof p[i]);
            key[to].i = (uint32_t)i;
        }
        for (b = bins; b > 0; b--) start[b] = start[b - 1];
        start[0] = 0;
        for (b = 0; b < bins; b++) {
            const uint32_t from = start[b], to = start[b + 1];
            start[b] = out;
            tetcasti_rbf_sort(key + from, to - from);
            for (k = from; k < to;) {
                const uint32_t first = key[k].i;
                double sum[4] = {0.0, 0.0, 0.0, 0.0};
                uint32_t same = 0;
                for (; k < to && memcmp(p[key[k].i], p[first], sizeof p[0]) == 0; k++, same++)
                    for (c = 0; c < t->n; c++) sum[c] += (double)v[key[k].i][c];
                t->duplicates += same - 1;
                t->x[out] = p[first][0];
                t->y[out] = p[first][1];
                t->z[out] = p[first][2];
                for (c = 0; c < t->n; c++) t->value[c][out] = (float)(sum[c] / (double)same);
                out++;
            }
        }
        start[bins] = out;
        t->count = out;
    }
    tetcasti_free(t->mem, key);
    tetcasti_free(t->mem, p);
    tetcasti_free(t->mem, v);
    tetcasti_free(t->mem, number);
    return ok;
}

static void tetcasti_fit_close(tetcasti_fit *t) {
    uint32_t c;
    size_t i, blocks = (size_t)t->blocks[0] * t->blocks[1] * t->blocks[2];
    tetcasti_free(t->mem, t->x);
    tetcasti_free(t->mem, t->y);
    tetcasti_free(t->mem, t->z);
    for (c = 0; c < 4; c++) {
        tetcasti_free(t->mem, t->value[c]);
        tetcasti_free(t->mem, t->res[c]);
    }
    tetcasti_free(t->mem, t->heed);
    tetcasti_free(t->mem, t->source);
    tetcasti_free(t->mem, t->start);
    tetcasti_free(t->mem, t->peak);
    for (i = 0; t->block != NULL && i < blocks; i++) tetcasti_free(t->mem, t->block[i].f);
    tetcasti_free(t->mem, t->block);
}

/* Sizes of everything, arrays, bins, blocks. */
static tetcast_result tetcasti_fit_open(tetcasti_fit *t, const tetcast_rbf_fit_desc *d, const tetcast_rbf_points *in) {
    tetcast_rbf *m = t->m;
    double volume = 1.0, bin;
    uint32_t axes = 0, a, c;
    size_t bins = 1, blocks = 1, i;
    for (a = 0; a < 3; a++)
        if (m->size[a] > 0.0f) {
            volume *= (double)m->size[a];
            axes++;
        }
    t->spacing = axes != 0 ? tetcasti_exp2(tetcasti_log2(volume / (double)t->count) / (double)axes) : 1.0;
    if (in->positions.data == NULL)
        for (a = 0; a < 3; a++)
            if (in->dims[a] > 1) t->spacing = tetcasti_min(t->spacing, (double)m->size[a] / (double)(in->dims[a] - 1));
    t->spacing = tetcasti_max(t->spacing, 1e-5);
    bin = t->spacing * (axes == 3 ? 2.0 : axes == 2 ? 2.83 : 8.0) * (1.0 + 1e-9);
    /* where a coarse grid has the broad features, short reach is worth more than a few functions less */
    t->widest = d->method == TETCAST_RBF_METHOD_PURE ? 0.25f : 0.07f;
    for (a = 0; a < 3; a++) {
        double side = (double)m->size[a] / bin;
        t->bins[a] = side < 1.0 ? 1u : side > 1023.0 ? 1024u : (uint32_t)side + 1;
        t->bin_scale[a] = m->size[a] > 0.0f ? (float)((double)t->bins[a] / ((double)m->size[a] * 1.000001)) : 0.0f;
        bins *= t->bins[a];
        side = (double)m->size[a] / t->spacing / 40.0; /* blocks: 40 points a side */
        t->blocks[a] = side < 4.0 ? 1u : side > 64.0 ? 64u : (uint32_t)side;
        blocks *= t->blocks[a];
        if (t->blocks[a] > 1) {
            const double half = 0.5 * (double)m->size[a] / (double)t->blocks[a] - 2.0 * t->spacing - 2.0 * bin;
            t->widest = (float)tetcasti_min((double)t->widest, half / (double)t->reach);
        }
        c = 1;
        while (c < 16 && (double)(1u << c) < (double)m->size[a] / t->spacing * TETCASTI_FIT_SPLIT + 1.0) c++;
        m->bits.position[a] = c;
    }
    m->bits.width_min = (float)(0.35 * t->spacing);
    if (t->widest < m->bits.width_min) t->widest = m->bits.width_min;
    for (c = 1; c < 8 && tetcasti_exp2((double)((1u << c) - 1) / 8.0) * (double)m->bits.width_min < (double)t->widest;) c++;
    m->bits.width = c;
    m->bits.weight = m->bits.node = 24;
    m->bits.weight_step = m->bits.node_step = (float)(t->range * (double)d->max_error / 8.0);
    if (!(m->bits.weight_step > 1e-36f)) m->bits.weight_step = m->bits.node_step = 1e-36f;
    t->x = (float *)tetcasti_alloc_array(t->mem, t->count, sizeof(float));
    t->y = (float *)tetcasti_alloc_array(t->mem, t->count, sizeof(float));
    t->z = (float *)tetcasti_alloc_array(t->mem, t->count, sizeof(float));
    t->heed = (float *)tetcasti_alloc_array(t->mem, t->count, sizeof(float));
    t->source = (uint32_t *)tetcasti_alloc_array(t->mem, t->count, sizeof(uint32_t));
    t->start = (uint32_t *)tetcasti_alloc_array(t->mem, bins + 1, sizeof(uint32_t));
    t->peak = (float *)tetcasti_alloc_zero(t->mem, bins, sizeof(float));
    t->block = (tetcasti_fit_block *)tetcasti_alloc_zero(t->mem, blocks, sizeof *t->block);
    if (t->x == NULL || t->y == NULL || t->z == NULL || t->heed == NULL || t->source == NULL || t->start == NULL ||
        t->peak == NULL || t->block == NULL) return TETCAST_ERR_NO_MEMORY;
    for (c = 0; c < t->n; c++) {
        t->value[c] = (float *)tetcasti_alloc_array(t->mem, t->count, sizeof(float));
        t->res[c] = (float *)tetcasti_alloc_array(t->mem, t->count, sizeof(float));
        if (t->value[c] == NULL || t->res[c] == NULL) return TETCAST_ERR_NO_MEMORY;
    }
    for (i = 0; i < blocks; i++) {
        size_t at[3];
        at[0] = i % t->blocks[0];
        at[1] = i / t->blocks[0] % t->blocks[1];
        at[2] = i / t->blocks[0] / t->blocks[1];
        for (a = 0; a < 3; a++) {
            t->block[i].lo[a] = (uint32_t)(at[a] * t->bins[a] / t->blocks[a]);
            t->block[i].hi[a] = (uint32_t)((at[a] + 1) * t->bins[a] / t->blocks[a]);
        }
    }
    return tetcasti_fit_sort(t, in) ? TETCAST_OK : TETCAST_ERR_NO_MEMORY;
}

/* ---- base ---- */

/* y = M x for rows of 27 */
static void tetcasti_base_times(const uint32_t dims[3], const double (*matrix)[27], const double *x, double *y) {
    uint32_t i, j, k, o;
    size_t at = 0;
    for (k = 0; k < dims[2]; k++)
        for (j = 0; j < dims[1]; j++)
            for (i = 0; i < dims[0]; i++, at++) {
                double s = 0.0;
                for (o = 0; o < 27; o++) {
                    const uint32_t ni = i + o % 3, nj = j + o / 3 % 3, nk = k + o / 9; /* one more than the neighbour */
                    if (ni - 1u < dims[0] && nj - 1u < dims[1] && nk - 1u < dims[2])
                        s += matrix[at][o] * x[((size_t)(nk - 1) * dims[1] + (nj - 1)) * dims[0] + (ni - 1)];
                }
                y[at] = s;
            }
}

/* Normal equations of the nodes; rhs [components][nodes]. */
static void tetcasti_base_normal(const tetcasti_fit *t, const tetcast_rbf *m, double (*matrix)[27], double *rhs) {
    const size_t nodes = (size_t)m->dims[0] * m->dims[1] * m->dims[2];
    uint32_t i, a, b, c, cell[3];
    double mean = 0.0;
    size_t n, k;
    for (i = 0; i < t->count; i++) {
        const float p[3] = {t->x[i], t->y[i], t->z[i]};
        float u[3];
        for (a = 0; a < 3; a++) cell[a] = tetcasti_rbf_cell(m, a, p[a], &u[a]);
        for (a = 0; a < 8; a++) {
            double wa = 1.0, wb;
            size_t at = 0;
            for (c = 3; c-- > 0;) {
                const uint32_t up = a >> c & 1u;
                wa *= up ? (double)u[c] : 1.0 - (double)u[c];
                at = at * m->dims[c] + cell[c] + up;
            }
            if (wa == 0.0) continue; /* also keeps off nodes that are not there */
            for (c = 0; c < t->n; c++)
                rhs[c * nodes + at] += wa * ((double)t->value[c][i] - (double)m->offset[c]);
            for (b = 0; b < 8; b++) {
                uint32_t o = 0;
                wb = wa;
                for (c = 3; c-- > 0;) {
                    const uint32_t up = b >> c & 1u;
                    wb *= up ? (double)u[c] : 1.0 - (double)u[c];
                    o = o * 3 + 1 + up - (a >> c & 1u);
                }
                matrix[at][o] += wb;
            }
        }
    }
    for (n = 0; n < nodes; n++) mean += matrix[n][13];
    mean = 1e-4 * mean / (double)nodes;
    for (n = 0; n < nodes; n++) { /* a weak spring between neighbours: nodes without points get a value */
        const size_t at[3] = {n % m->dims[0], n / m->dims[0] % m->dims[1], n / m->dims[0] / m->dims[1]};
        for (a = 0, k = 1; a < 3; a++, k *= 3) {
            if (at[a] > 0) {
                matrix[n][13] += mean;
                matrix[n][13 - k] -= mean;
            }
            if (at[a] + 1 < m->dims[a]) {
                matrix[n][13] += mean;
                matrix[n][13 + k] -= mean;
            }
        }
        matrix[n][13] += 1e-3 * mean;
    }
}

/* Conjugate gradients with the diagonal for one component; work: 4 arrays of the number of nodes. */
static void tetcasti_base_solve(const uint32_t dims[3], const double (*matrix)[27], const double *rhs, double *x,
                                double *work) {
    const size_t nodes = (size_t)dims[0] * dims[1] * dims[2];
    double *r = work, *z = work + nodes, *p = work + 2 * nodes, *q = work + 3 * nodes, rz = 0.0, first, alpha, beta;
    uint32_t round;
    size_t i;
    for (i = 0; i < nodes; i++) {
        x[i] = 0.0;
        r[i] = rhs[i];
        p[i] = z[i] = r[i] / matrix[i][13];
        rz += r[i] * z[i];
    }
    first = rz;
    for (round = 0; round < 200 && rz > 1e-14 * first; round++) {
        double pq = 0.0, next = 0.0;
        tetcasti_base_times(dims, matrix, p, q);
        for (i = 0; i < nodes; i++) pq += p[i] * q[i];
        if (!(pq > 0.0)) return;
        alpha = rz / pq;
        for (i = 0; i < nodes; i++) {
            x[i] += alpha * p[i];
            r[i] -= alpha * q[i];
            z[i] = r[i] / matrix[i][13];
            next += r[i] * z[i];
        }
        beta = next / rz;
        rz = next;
        for (i = 0; i < nodes; i++) p[i] = z[i] + beta * p[i];
    }
}

static void tetcasti_fit_reset_heed(tetcasti_fit *t) { /* heed and peaks, from the errors */
    tetcasti_fit_rows all;
    uint32_t i, c;
    for (i = 0; i < t->count; i++) t->heed[i] = 1.0f;
    for (c = 0; c < 3; c++) {
        all.lo[c] = 0;
        all.hi[c] = t->bins[c] - 1;
    }
    tetcasti_fit_look(t, &all);
}

static void tetcasti_fit_reset(tetcasti_fit *t) { /* the error without functions */
    uint32_t i, c;
    float p[3], v[4];
    for (i = 0; i < t->count; i++) {
        p[0] = t->x[i];
        p[1] = t->y[i];
        p[2] = t->z[i];
        tetcasti_rbf_base(t->m, p, v, NULL);
        for (c = 0; c < t->n; c++) t->res[c][i] = t->value[c][i] - v[c];
    }
    tetcasti_fit_reset_heed(t);
}

/* The base of a size, rounded, and the error without functions. dims 0: a constant. 0: no memory. */
static int tetcasti_fit_base(tetcasti_fit *t, const uint32_t dims[3]) {
    tetcast_rbf *m = t->m;
    const size_t nodes = (size_t)dims[0] * dims[1] * dims[2];
    double (*matrix)[27] = NULL, *work = NULL;
    uint32_t c;
    size_t i;
    int ok;
    tetcasti_free(t->mem, m->node);
    m->node = NULL;
    memcpy(m->dims, dims, sizeof m->dims);
    tetcasti_rbf_node_scale(m);
    if (nodes != 0) {
        m->node = (float *)tetcasti_alloc_zero(t->mem, nodes * t->n, sizeof(float));
        matrix = (double (*)[27])tetcasti_alloc_zero(t->mem, nodes, sizeof *matrix);
        work = (double *)tetcasti_alloc_zero(t->mem, nodes * (5 + t->n), sizeof *work);
        ok = m->node != NULL && matrix != NULL && work != NULL;
        if (ok) {
            tetcasti_base_normal(t, m, matrix, work);
            for (c = 0; c < t->n; c++) {
                double *x = work + t->n * nodes;
                tetcasti_base_solve(dims, (const double (*)[27])matrix, work + c * nodes, x, x + nodes);
                for (i = 0; i < nodes; i++)
                    m->node[i * t->n + c] = (float)((double)m->offset[c] + (double)tetcasti_rbf_code(x[i],
                        (double)m->bits.node_step, 24) * (double)m->bits.node_step);
            }
        }
        tetcasti_free(t->mem, matrix);
        tetcasti_free(t->mem, work);
        if (!ok) return 0;
    }
    tetcasti_fit_reset(t);
    return 1;
}

/* Nodes of a base with `longest` of them along the longest side, as many a unit as the data has there. */
static void tetcasti_fit_dims(const tetcasti_fit *t, uint32_t longest, uint32_t dims[3]) {
    float most = 0.0f;
    uint32_t a;
    for (a = 0; a < 3; a++) most = t->m->size[a] > most ? t->m->size[a] : most;
    for (a = 0; a < 3; a++) {
        const double n = most > 0.0f ? (double)(longest - 1) * (double)t->m->size[a] / (double)most : 0.0;
        dims[a] = t->m->size[a] > 0.0f ? (uint32_t)(n + 0.5) + 1 : 1;
        if (dims[a] < 2 && t->m->size[a] > 0.0f) dims[a] = 2;
    }
}

/* ---- the loop ---- */

static size_t tetcasti_fit_count(const tetcasti_fit *t) {
    size_t i, n = 0, blocks = (size_t)t->blocks[0] * t->blocks[1] * t->blocks[2];
    for (i = 0; i < blocks; i++) n += t->block[i].count;
    return n;
}

static double tetcasti_fit_peak(const tetcasti_fit *t) {
    size_t i, bins = (size_t)t->bins[0] * t->bins[1] * t->bins[2];
    float most = 0.0f;
    for (i = 0; i < bins; i++) most = t->peak[i] > most ? t->peak[i] : most;
    return sqrt((double)most);
}

static int tetcasti_fit_bad(tetcasti_fit *t, uint64_t done, uint64_t total) { /* no memory, too many, cancelled */
    if (t->env->progress_fn != NULL && t->env->progress_fn(t->env->progress_user, done, total) != 0) t->full = 2;
    return t->failed || t->full;
}

static void tetcasti_fit_greedy(tetcasti_fit *t, double threshold) {
    t->threshold = (float)threshold;
    tetcasti_fit_colors(t, tetcasti_task_fit_greedy);
}

/* Bits of a function, and of all numbers of the base. */
static double tetcasti_fit_bits(const tetcasti_fit *t) {
    const tetcasti_rbf_bits *b = &t->m->bits;
    return (double)(b->position[0] + b->position[1] + b->position[2] + b->width) + 9.0 * (double)t->n;
}

/* Try sizes of the base with functions that are not polished: least bytes win. */
static int tetcasti_fit_trials(tetcasti_fit *t) {
    static const uint32_t sizes[] = {0, 3, 4, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48};
    uint32_t dims[3], best[3] = {0, 0, 0}, k, worse = 0;
    double least = 1e300;
    const size_t cap = t->cap;
    for (k = 0; k < sizeof sizes / sizeof sizes[0] && worse < 3; k++) {
        double nodes, bytes, room;
        size_t i, n, blocks = (size_t)t->blocks[0] * t->blocks[1] * t->blocks[2];
        tetcasti_fit_dims(t, sizes[k] != 0 ? sizes[k] : 2, dims);
        if (sizes[k] == 0) dims[0] = dims[1] = dims[2] = 0;
        nodes = (double)dims[0] * (double)dims[1] * (double)dims[2] * (double)t->n;
        room = (least - nodes) * 8.0 / tetcasti_fit_bits(t);
        if (nodes > 0.3 * (double)t->count * (double)t->n || room < 1.0) break;
        if (!tetcasti_fit_base(t, dims)) return 0;
        t->cap = room < (double)cap ? (size_t)room + 1 : cap;
        t->inserted = 0;
        tetcasti_fit_greedy(t, 2.0 * (double)t->tolerance);
        tetcasti_fit_greedy(t, (double)t->tolerance);
        if (t->failed) return 0;
        n = tetcasti_fit_count(t);
        bytes = nodes + (double)n * tetcasti_fit_bits(t) / 8.0;
        for (i = 0; i < blocks; i++) t->block[i].count = t->block[i].inserted = 0;
        if (!t->full && bytes < least) {
            least = bytes;
            memcpy(best, dims, sizeof best);
            worse = 0;
        } else worse++;
        t->full = 0;
    }
    t->cap = cap;
    return tetcasti_fit_base(t, best);
}

/* ---- the model, and how wrong it is ---- */

/* Functions of all blocks -> the model's arrays, with as few bits as they need. */
static tetcast_result tetcasti_fit_model(tetcasti_fit *t) {
    tetcast_rbf *m = t->m;
    const size_t blocks = (size_t)t->blocks[0] * t->blocks[1] * t->blocks[2];
    const size_t nodes = (size_t)m->dims[0] * m->dims[1] * m->dims[2] * t->n;
    size_t i, j, k = 0;
    uint32_t c, widest = 0;
    double most = 0.0;
    tetcasti_free(&m->mem, m->centre);
    tetcasti_free(&m->mem, m->width);
    tetcasti_free(&m->mem, m->weight);
    tetcasti_free(&m->mem, m->record);
    tetcasti_free(&m->mem, m->tree);
    tetcasti_free(&m->mem, m->index);
    m->centre = NULL;
    m->width = m->weight = NULL;
    m->record = NULL;
    m->tree = NULL;
    m->index = NULL;
    m->tree_count = m->index_count = m->tree_depth = 0;
    m->count = (uint32_t)tetcasti_fit_count(t);
    m->centre = (float (*)[3])tetcasti_alloc_zero(&m->mem, m->count + 1u, sizeof *m->centre);
    m->width = (float *)tetcasti_alloc_zero(&m->mem, m->count + 1u, sizeof *m->width);
    m->weight = (float *)tetcasti_alloc_zero(&m->mem, ((size_t)m->count + 1u) * t->n, sizeof *m->weight);
    if (m->centre == NULL || m->width == NULL || m->weight == NULL) return TETCAST_ERR_NO_MEMORY;
    m->bits.width = 8;
    for (i = 0; i < blocks; i++)
        for (j = 0; j < t->block[i].count; j++, k++) {
            const tetcasti_fit_function *f = &t->block[i].f[j];
            const uint32_t w = tetcasti_rbf_width_code(m, (double)f->width);
            memcpy(m->centre[k], f->c, sizeof f->c);
            m->width[k] = f->width;
            widest = w > widest ? w : widest;
            for (c = 0; c < t->n; c++) {
                m->weight[k * t->n + c] = f->w[c];
                most = tetcasti_max(most, tetcasti_abs((double)f->w[c]));
            }
        }
    for (c = 1; c < 8 && (1u << c) - 1 < widest;) c++;
    m->bits.width = c;
    for (c = 2; c < 24 && (double)((1u << (c - 1)) - 1) < most / (double)m->bits.weight_step;) c++;
    m->bits.weight = c;
    for (i = 0, most = 0.0; i < nodes; i++)
        most = tetcasti_max(most, tetcasti_abs((double)m->node[i] - (double)m->offset[i % t->n]));
    for (c = 2; c < 24 && (double)((1u << (c - 1)) - 1) < most / (double)m->bits.node_step;) c++;
    m->bits.node = c;
    if (!tetcasti_rbf_order(m)) return TETCAST_ERR_NO_MEMORY;
    return tetcasti_rbf_finish(m);
}

/* The error at the points, from the finished model. */
static void tetcasti_task_fit_measure(void *ctx, uint32_t task) {
    tetcasti_fit *t = (tetcasti_fit *)ctx;
    const uint32_t part = TETCASTI_RBF_CHUNK / 2, first = task * part;
    const uint32_t count = t->count - first < part ? t->count - first : part;
    float p[TETCASTI_RBF_CHUNK / 2][3], v[TETCASTI_RBF_CHUNK / 2 * TETCAST_RBF_MAX_COMPONENTS];
    uint32_t i, c;
    for (i = 0; i < count; i++) {
        p[i][0] = t->x[first + i];
        p[i][1] = t->y[first + i];
        p[i][2] = t->z[first + i];
    }
    tetcasti_rbf_points(t->m, tetcasti_rbf_add_pick(t->m, t->isa), 0, (const float (*)[3])p, count, v, NULL);
    for (i = 0; i < count; i++)
        for (c = 0; c < t->n; c++) t->res[c][first + i] = t->value[c][first + i] - v[i * t->n + c];
}

/* Angle between what is and what was fitted, degrees. */
static double tetcasti_fit_angle(const double *is, const double *fitted, uint32_t n) {
    double ab = 0.0, aa = 0.0, bb = 0.0, c, lo = 0.0, hi = 3.14159265358979323846;
    uint32_t i;
    for (i = 0; i < n; i++) {
        ab += is[i] * fitted[i];
        aa += is[i] * is[i];
        bb += fitted[i] * fitted[i];
    }
    if (!(aa > 0.0)) return 0.0;
    if (!(bb > 0.0)) return 90.0;
    c = ab / sqrt(aa * bb);
    for (i = 0; i < 40; i++) { /* arc cosine by halving */
        const double mid = 0.5 * (lo + hi);
        double s, k;
        tetcasti_sincos(mid, &s, &k);
        if (k > c) lo = mid;
        else hi = mid;
    }
    return lo * 57.295779513082320877;
}

static void tetcasti_fit_measure(tetcasti_fit *t, tetcast_rbf_report *report) {
    enum { BINS = 2048 };
    uint32_t histogram[BINS];
    double most = 0.0, sum = 0.0, squares = 0.0, weights = 0.0, angles = 0.0;
    uint32_t i, c, seen = 0;
    tetcasti_parallel_for(t->env, tetcasti_task_fit_measure, t,
                          (t->count + TETCASTI_RBF_CHUNK / 2 - 1) / (TETCASTI_RBF_CHUNK / 2));
    report->direction_max = report->overshoot = 0.0;
    for (i = 0; i < t->count; i++) {
        double e = 0.0, is[4], fitted[4], length = 0.0;
        for (c = 0; c < t->n; c++) {
            is[c] = (double)t->value[c][i];
            fitted[c] = is[c] - (double)t->res[c][i];
            e += (double)t->res[c][i] * (double)t->res[c][i];
            length += is[c] * is[c];
        }
        squares += e;
        e = sqrt(e);
        sum += e;
        most = tetcasti_max(most, e);
        t->heed[i] = (float)e;
        if (t->n == 1) {
            const double over = tetcasti_max(fitted[0] - (double)t->m->range[1], (double)t->m->range[0] - fitted[0]);
            report->overshoot = tetcasti_max(report->overshoot, over);
        } else {
            const double w = tetcasti_min(1.0, sqrt(length) / (0.05 * t->range));
            const double angle = w * tetcasti_fit_angle(is, fitted, t->n);
            weights += w;
            angles += angle;
            report->direction_max = tetcasti_max(report->direction_max, angle);
        }
    }
    memset(histogram, 0, sizeof histogram);
    for (i = 0; i < t->count; i++)
        histogram[most > 0.0 ? (uint32_t)((double)t->heed[i] / most * (BINS - 1)) : 0]++;
    for (c = BINS; c-- > 0 && (uint64_t)(seen + histogram[c]) * 1000u <= t->count;) seen += histogram[c];
    report->max_error = most / t->range;
    report->mean_error = sum / (double)t->count / t->range;
    report->rms_error = sqrt(squares / (double)t->count) / t->range;
    report->p999_error = tetcasti_min((double)(c < BINS ? c + 1 : 1) / (BINS - 1) * most, most) / t->range;
    report->direction_mean = weights > 0.0 ? angles / weights : 0.0;
    report->overshoot /= t->range;
}

/* Random places in cells, against linear interpolation of the data. */
static void tetcasti_fit_between(tetcasti_fit *t, const tetcast_rbf_points *in, tetcast_rbf_report *report) {
    const size_t want = in->positions.data == NULL || in->tets != NULL ? 65536 : 0;
    double sum = 0.0;
    size_t i;
    uint32_t h = 1, a, c, k;
    tetcasti_rbf_add_fn *add = tetcasti_rbf_add_pick(t->m, t->isa);
    for (i = 0; i < want; i++) {
        double p[3] = {0.0, 0.0, 0.0}, v[4] = {0.0, 0.0, 0.0, 0.0}, q[3], w[4], u[4], e = 0.0, over;
        float local[1][3], f[4];
        int ok = 1;
        for (a = 0; a < 4; a++) {
            h = tetcasti_hash32(h + 0x9e3779b9u);
            u[a] = (double)h * (1.0 / 4294967296.0);
        }
        if (in->positions.data == NULL) {
            size_t cell[3];
            for (a = 0; a < 3; a++) {
                const double x = in->dims[a] > 1 ? u[a] * (double)(in->dims[a] - 1) : 0.0;
                cell[a] = (size_t)x;
                u[a] = x - (double)cell[a];
            }
            for (k = 0; k < 8 && ok; k++) {
                size_t at = 0;
                double s = 1.0;
                for (a = 3; a-- > 0;) {
                    s *= (k >> a & 1u) != 0 ? u[a] : 1.0 - u[a];
                    at = at * in->dims[a] + cell[a] + (k >> a & 1u);
                }
                if (s == 0.0) continue;
                ok = tetcasti_fit_read(in, at, q, w);
                for (a = 0; a < 3; a++) p[a] += s * q[a];
                for (c = 0; c < t->n; c++) v[c] += s * w[c];
            }
        } else {
            const uint32_t *tet = in->tets + 4 * ((size_t)(u[3] * (double)in->tet_count) % in->tet_count);
            double s[4], left = 0.0;
            for (a = 0; a < 3; a++) s[a] = -tetcasti_log2(u[a] + 1e-12); /* uniform in the simplex */
            h = tetcasti_hash32(h + 0x9e3779b9u);
            s[3] = -tetcasti_log2((double)h * (1.0 / 4294967296.0) + 1e-12);
            for (a = 0; a < 4; a++) left += s[a];
            for (k = 0; k < 4 && ok; k++) {
                ok = tet[k] < in->count && left > 0.0 && tetcasti_fit_read(in, tet[k], q, w);
                for (a = 0; ok && a < 3; a++) p[a] += s[k] / left * q[a];
                for (c = 0; ok && c < t->n; c++) v[c] += s[k] / left * w[c];
            }
        }
        if (!ok) continue;
        tetcasti_rbf_local(t->m, p, local[0]);
        tetcasti_rbf_points(t->m, add, 0, (const float (*)[3])local, 1, f, NULL);
        for (c = 0; c < t->n; c++) e += ((double)f[c] - v[c]) * ((double)f[c] - v[c]);
        e = sqrt(e) / t->range;
        report->between_count++;
        report->between_max = tetcasti_max(report->between_max, e);
        sum += e;
        over = tetcasti_max((double)f[0] - (double)t->m->range[1], (double)t->m->range[0] - (double)f[0]) / t->range;
        if (t->n == 1) report->overshoot = tetcasti_max(report->overshoot, over);
    }
    if (report->between_count != 0) report->between_mean = sum / (double)report->between_count;
}

/* What plain grids need: the nodes of a least-squares grid, or the values themselves, in steps of the tolerance. */
static int tetcasti_fit_compare(tetcasti_fit *t, const tetcast_rbf_points *in, double tolerance,
                                tetcast_rbf_report *report) {
    static const uint32_t sizes[] = {4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128};
    const uint32_t grid = in->positions.data == NULL;
    const double step = 2.0 * tolerance / sqrt((double)t->n); /* values: half of it in each component */
    uint32_t k, c, bits = 1, dims[3];
    uint64_t bytes;
    while (bits < 24 && (double)(1u << bits) * step < 1.0 * (t->n == 1 ? 1.0 : 2.0)) bits++;
    bytes = ((uint64_t)t->count * t->n * bits + 7) / 8;
    if (!grid) bytes += (uint64_t)t->count * (t->m->bits.position[0] + t->m->bits.position[1] + t->m->bits.position[2]) / 8;
    report->grid_bytes = bytes;
    memcpy(report->grid_dims, in->dims, sizeof in->dims);
    report->grid_bits = bits;
    report->grid_max_error = tolerance;
    report->grid_mean_error = 0.5 * tolerance;
    for (k = 0; k < sizeof sizes / sizeof sizes[0]; k++) {
        double nodes, most, sum = 0.0;
        uint32_t i, need = 2;
        size_t j;
        tetcasti_fit_dims(t, sizes[k], dims);
        nodes = (double)dims[0] * (double)dims[1] * (double)dims[2] * (double)t->n;
        if (nodes * 4.0 / 8.0 > (double)report->grid_bytes || nodes > 4e6) break;
        if (!tetcasti_fit_base(t, dims)) return 0;
        most = tetcasti_fit_peak(t) / t->range;
        if (most > tolerance) continue;
        for (i = 0; i < t->count; i++) {
            double e = 0.0;
            for (c = 0; c < t->n; c++) e += (double)t->res[c][i] * (double)t->res[c][i];
            sum += sqrt(e);
        }
        for (j = 0; j < (size_t)nodes; j++) {
            const double q = tetcasti_abs((double)t->m->node[j] - (double)t->m->offset[j % t->n]);
            while (need < 24 && (double)((1u << (need - 1)) - 1) < q / (double)t->m->bits.node_step) need++;
        }
        bytes = (uint64_t)(nodes * (double)need / 8.0);
        if (bytes < report->grid_bytes) {
            report->grid_bytes = bytes;
            memcpy(report->grid_dims, dims, sizeof dims);
            report->grid_bits = need;
            report->grid_max_error = most;
            report->grid_mean_error = sum / (double)t->count / t->range;
        }
        break;
    }
    return 1;
}

/* Greedy and sweeps until every error is in the tolerance; then the model, measured. */
static tetcast_result tetcasti_fit_loop(tetcasti_fit *t, const tetcast_rbf_fit_desc *d, tetcast_rbf_report *report) {
    const uint32_t sweeps = d->sweeps == 0xffffffffu ? 0 : d->sweeps != 0 ? d->sweeps : 3;
    const double asked = (double)d->max_error * t->range;
    double tolerance = asked * (1.0 - 1e-4);
    tetcast_result r;
    uint32_t s, k, round;
    t->tolerance = (float)tolerance;
    t->heed_scale = (float)(1.0 / (tolerance * tolerance));
    t->polish = 1;
    for (s = 0; s <= sweeps; s++) {
        const double left = (double)(sweeps - s);
        t->sharp = 0;
        tetcasti_fit_reset_heed(t);
        tetcasti_fit_greedy(t, tolerance * (1.0 + 0.35 * left));
        report->rounds++;
        if (tetcasti_fit_bad(t, s, sweeps + 2)) return t->failed ? TETCAST_ERR_NO_MEMORY : TETCAST_ERR_RANGE;
        if (sweeps == 0) break;
        t->sharp = 1;
        tetcasti_fit_reset_heed(t);
        for (k = 0; k < (s == sweeps ? 2u : 1u); k++) {
            tetcasti_fit_colors(t, tetcasti_task_fit_sweep);
            report->rounds++;
            if (tetcasti_fit_bad(t, s, sweeps + 2)) return TETCAST_ERR_NO_MEMORY;
        }
    }
    for (round = 0; round < 8; round++) { /* what is stored decides: rounding of sums may need another function */
        if (round != 0 || sweeps != 0) {
            t->sharp = 0;
            tetcasti_fit_reset_heed(t);
            tetcasti_fit_greedy(t, tolerance);
            if (tetcasti_fit_bad(t, sweeps + 1, sweeps + 2)) return t->failed ? TETCAST_ERR_NO_MEMORY : TETCAST_ERR_RANGE;
        }
        r = tetcasti_fit_model(t);
        if (r != TETCAST_OK) return r;
        tetcasti_fit_measure(t, report);
        if (report->max_error <= (double)d->max_error &&
            (d->mean_error == 0.0f || report->mean_error <= (double)d->mean_error)) return TETCAST_OK;
        if (report->max_error <= (double)d->max_error) {
            tolerance *= 0.8;
            t->tolerance = (float)tolerance;
            if (round == 7) round = 6;
            if (!(tolerance > 1e-7 * t->range)) return TETCAST_ERR_RANGE;
        }
        tetcasti_fit_reset_heed(t); /* the errors are those of the model now */
    }
    return TETCAST_ERR_RANGE;
}

static tetcast_result tetcasti_fit_run(tetcasti_fit *t, const tetcast_rbf_fit_desc *d, const tetcast_rbf_points *in,
                                       tetcast_rbf_report *report) {
    const uint32_t none[3] = {0, 0, 0};
    tetcast_rbf *m = t->m;
    tetcast_result r = tetcasti_fit_survey(t, d, in);
    int ok = 1;
    if (r != TETCAST_OK) return r;
    t->tolerance = (float)((double)d->max_error * t->range * (1.0 - 1e-4));
    if (!(t->range > 1e-30)) t->range = 0.0;
    r = tetcasti_fit_open(t, d, in);
    report->points = t->count;
    report->rejected = t->rejected;
    report->duplicates = t->duplicates;
    report->range = t->range;
    report->raw_bytes = (uint64_t)t->count * (t->n + (in->positions.data == NULL ? 0u : 3u)) * 4u;
    if (r != TETCAST_OK) return r;
    if (t->range == 0.0) { /* one value everywhere */
        if (!tetcasti_fit_base(t, none)) return TETCAST_ERR_NO_MEMORY;
        t->range = 1.0;
        r = tetcasti_fit_model(t);
        if (r == TETCAST_OK) tetcasti_fit_measure(t, report);
    } else {
        if (d->compare) ok = tetcasti_fit_compare(t, in, (double)d->max_error, report);
        if (!ok) return TETCAST_ERR_NO_MEMORY;
        if (d->method == TETCAST_RBF_METHOD_PURE) ok = tetcasti_fit_base(t, none);
        else if (d->base_dims[0] != 0) ok = tetcasti_fit_base(t, d->base_dims);
        else ok = tetcasti_fit_trials(t);
        if (!ok) return TETCAST_ERR_NO_MEMORY;
        r = tetcasti_fit_loop(t, d, report);
    }
    if (r != TETCAST_OK) return r;
    tetcasti_fit_between(t, in, report);
    m->max_error = (float)report->max_error;
    m->mean_error = (float)report->mean_error;
    return TETCAST_OK;
}

static void tetcasti_fit_report(const tetcasti_fit *t, tetcast_rbf_report *report) {
    const size_t blocks = (size_t)t->blocks[0] * t->blocks[1] * t->blocks[2];
    tetcast_rbf_info info;
    size_t i;
    tetcast_rbf_get_info(t->m, &info);
    report->functions = info.function_count;
    memcpy(report->base_dims, info.base_dims, sizeof info.base_dims);
    report->bytes = info.file_bytes;
    report->largest_weight = t->range > 0.0 ? (double)info.largest_weight / t->range : 0.0;
    report->functions_win = report->bytes < report->grid_bytes;
    for (i = 0; i < blocks; i++) {
        report->inserted += t->block[i].inserted;
        report->dropped += t->block[i].dropped;
    }
}

static tetcast_result tetcasti_fit_check(const tetcast_rbf_fit_desc *d, const tetcast_rbf_points *in) {
    uint32_t a;
    size_t n = 1;
    if (in == NULL || in->values.data == NULL || in->components < 1 || in->components > TETCAST_RBF_MAX_COMPONENTS ||
        tetcasti_type_size(in->values.type) == 0 || tetcasti_type_size(in->positions.type) == 0 ||
        !(d->max_error >= 1e-6f && d->max_error <= 1.0f) || !(d->mean_error >= 0.0f && d->mean_error <= 1.0f) ||
        (uint32_t)d->kernel >= TETCAST_KERNEL_COUNT || d->kernel == TETCAST_KERNEL_GAUSS_CUT ||
        (uint32_t)d->method > TETCAST_RBF_METHOD_PURE || !(d->cut >= 1.0f && d->cut <= 8.0f) ||
        (in->tets != NULL && in->tet_count == 0)) return TETCAST_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++) if (!(d->metric[a] >= 0.0) || !tetcasti_finite(d->metric[a])) return TETCAST_ERR_INVALID_ARG;
    if (!tetcasti_rbf_dims_ok(d->base_dims)) return TETCAST_ERR_INVALID_ARG;
    if (in->positions.data == NULL) {
        for (a = 0; a < 3; a++) {
            if (in->dims[a] == 0 || !tetcasti_mul_size(n, in->dims[a], &n)) return TETCAST_ERR_INVALID_ARG;
            if (!tetcasti_finite(in->spacing[a]) || !tetcasti_finite(in->origin[a])) return TETCAST_ERR_INVALID_ARG;
        }
        if (n != in->count) return TETCAST_ERR_INVALID_ARG;
    }
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_rbf_fit(const tetcast_rbf_fit_desc *desc, const tetcast_rbf_points *points,
                                           tetcast_rbf_report *report, tetcast_rbf **out) {
    static const char *const why[] = {"", "fit: a number or an enum is out of range", "", "fit: out of memory"};
    tetcast_rbf_fit_desc d;
    tetcast_rbf_report own;
    tetcasti_mem mem;
    tetcasti_fit t;
    tetcast_rbf *m;
    tetcast_result r;
    if (report != NULL) memset(report, 0, sizeof *report);
    else report = &own;
    memset(report, 0, sizeof *report);
    if (out == NULL) return TETCAST_ERR_INVALID_ARG;
    *out = NULL;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    if (d.max_error == 0.0f) d.max_error = 0.05f;
    if (d.cut == 0.0f) d.cut = 3.5f;
    r = tetcasti_env_open(&d.env, &mem);
    if (r == TETCAST_OK) r = tetcasti_fit_check(&d, points);
    if (r != TETCAST_OK) return tetcasti_fail(d.env.error, r, 0, why[1]);
    m = (tetcast_rbf *)tetcasti_alloc_zero(&mem, 1, sizeof *m);
    if (m == NULL) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, why[3]);
    m->mem = mem;
    m->components = points->components;
    m->kernel = d.kernel;
    m->cut = d.cut;
    memset(&t, 0, sizeof t);
    t.mem = &m->mem;
    t.env = &d.env;
    t.m = m;
    t.isa = tetcasti_rbf_isa(d.isa);
    t.n = points->components;
    t.reach = d.kernel == TETCAST_KERNEL_GAUSS ? d.cut : tetcasti_kernel_reach(d.kernel);
    if (d.kernel == TETCAST_KERNEL_GAUSS)
        t.e = (float)tetcasti_exp2(-0.72134752044448170368 * (double)d.cut * (double)d.cut);
    t.cap = d.max_functions != 0 && d.max_functions < TETCAST_RBF_MAX_FUNCTIONS ? d.max_functions
                                                                                  : TETCAST_RBF_MAX_FUNCTIONS;
    r = tetcasti_fit_run(&t, &d, points, report);
    if (t.full == 2) r = TETCAST_ERR_CANCELLED;
    if (r == TETCAST_OK) tetcasti_fit_report(&t, report);
    tetcasti_fit_close(&t);
    if (r == TETCAST_OK) {
        *out = m;
        return r;
    }
    tetcast_rbf_destroy(m);
    return tetcasti_fail(d.env.error, r, 0, r == TETCAST_ERR_EMPTY ? "fit: no usable point"
                         : r == TETCAST_ERR_RANGE ? "fit: more functions than max_functions are needed"
                         : r == TETCAST_ERR_CANCELLED ? "fit: cancelled"
                         : r == TETCAST_ERR_NO_MEMORY ? why[3] : why[1]);
}
/* ---------------------------------------------------------------------------
   rbf_render: functions -> tiles -> groups of eight rays -> sums along rays.    // >>rbf_render

   All in local coordinates, where functions are round. Samples are at multiples of the step h from the eye. A group is
   4 x 2 pixels; the values of its samples are rows of eight. On a ray at distance e from a centre, with u the way to the
   nearest point, a Gaussian is 2^(a (e^2 + u^2)): from one sample to the next it is multiplied by q, and q by the
   constant c = 2^(2 a h^2). The error of that grows with the square of the steps, so it starts in the middle of the
   reach, goes outwards both ways, and starts anew every 32 samples: 2e-5 of the height.
   --------------------------------------------------------------------------- */

#define TETCASTI_RBF_TILE 16u
#define TETCASTI_RBF_RUN 32           /* samples from one start of the recurrence to the next */
#define TETCASTI_RBF_SAMPLES 65536u

typedef struct tetcasti_rbf_group {   /* eight rays; lanes without a ray are copies of one that has one */
    float o[3][8], d[3][8];           /* local place of sample 0, unit direction */
    float in[8], out[8];              /* way from there to where the ray enters and leaves the box */
    float world[8];                   /* world length of a local unit */
    float start[8];                   /* world distance of sample 0 from the eye */
    uint32_t lanes;                   /* that have a ray */
    int32_t n;                        /* samples */
    float h;
} tetcasti_rbf_group;

typedef struct tetcasti_rbf_reach { float tc[8], d2[8]; int32_t first, last, middle; } tetcasti_rbf_reach;

/* Where a function is on the rays; 0: on none of the samples. */
static int tetcasti_rbf_meet(const tetcasti_rbf_group *g, const tetcasti_rbf_record *f, tetcasti_rbf_reach *r) {
    float least = 1e30f, lo = 1e30f, hi = -1e30f, half, scale = 1.0f / g->h;
    uint32_t l;
    for (l = 0; l < 8; l++) {
        const float mx = f->c[0] - g->o[0][l], my = f->c[1] - g->o[1][l], mz = f->c[2] - g->o[2][l];
        const float tc = (mx * g->d[0][l] + my * g->d[1][l]) + mz * g->d[2][l];
        const float vx = mx - tc * g->d[0][l], vy = my - tc * g->d[1][l], vz = mz - tc * g->d[2][l];
        r->tc[l] = tc;
        r->d2[l] = (vx * vx + vy * vy) + vz * vz;
        least = r->d2[l] < least ? r->d2[l] : least;
        lo = tc < lo ? tc : lo;
        hi = tc > hi ? tc : hi;
    }
    half = f->radius * f->radius - least;
    if (!(half > 0.0f)) return 0;
    half = sqrtf(half);
    lo = (lo - half) * scale;
    hi = (hi + half) * scale;
    if (!(hi >= 0.0f) || !(lo <= (float)(g->n - 1))) return 0;
    r->first = lo > 0.0f ? (int32_t)lo : 0;
    r->last = hi < (float)(g->n - 1) ? (int32_t)hi : g->n - 1;
    half = 0.5f * (lo + hi);
    r->middle = half <= (float)r->first ? r->first : half >= (float)r->last ? r->last : (int32_t)(half + 0.5f);
    return 1;
}

/* Add a function to rows[component][sample][lane]; `stride` floats from one component to the next. */
TETCASTI_INLINE void tetcasti_rbf_run_kind(const tetcast_kernel kernel, const uint32_t n, const tetcasti_rbf_group *g,
                                           const tetcasti_rbf_record *f, const tetcasti_rbf_reach *r, float *rows,
                                           size_t stride) {
    const float h = g->h, c2 = tetcasti_exp2_fast(2.0f * f->a * h * h);
    uint32_t l, c;
    int32_t j, k, way;
    for (l = 0; l < 8; l++) {
        if (kernel != TETCAST_KERNEL_GAUSS && kernel != TETCAST_KERNEL_GAUSS_CUT) {
            for (j = r->first; j <= r->last; j++) {
                const float u = (float)j * h - r->tc[l], phi = tetcasti_rbf_phi(kernel, f, r->d2[l] + u * u, NULL);
                for (c = 0; c < n; c++) rows[c * stride + (size_t)j * 8 + l] += f->w[c] * phi;
            }
            continue;
        }
        for (way = 1; way >= -1; way -= 2) {
            j = way > 0 ? r->middle : r->middle - 1;
            while (way > 0 ? j <= r->last : j >= r->first) {
                const float u = (float)j * h - r->tc[l];
                float v = tetcasti_exp2_fast(f->a * (r->d2[l] + u * u));
                float q = tetcasti_exp2_fast((f->a * h) * (h + (way > 0 ? 2.0f : -2.0f) * u));
                int32_t left = way > 0 ? r->last - j + 1 : j - r->first + 1;
                left = left < TETCASTI_RBF_RUN ? left : TETCASTI_RBF_RUN;
                for (k = 0; k < left; k++, j += way) {
                    const float m = v - f->e;
                    const float phi = m > 0.0f ? (kernel == TETCAST_KERNEL_GAUSS ? m : v) : 0.0f;
                    for (c = 0; c < n; c++) rows[c * stride + (size_t)j * 8 + l] += f->w[c] * phi;
                    v = v * q;
                    q = q * c2;
                }
            }
        }
    }
}
static void tetcasti_rbf_run_scalar(tetcast_kernel kernel, uint32_t n, const tetcasti_rbf_group *g,
                                    const tetcasti_rbf_record *f, const tetcasti_rbf_reach *r, float *rows,
                                    size_t stride) {
    tetcasti_rbf_run_kind(kernel, n, g, f, r, rows, stride);
}

#if TETCASTI_AVX2
TETCASTI_TARGET_AVX2 static int tetcasti_rbf_meet8(const tetcasti_rbf_group *g, const tetcasti_rbf_record *f,
                                                   tetcasti_rbf_reach *r) {
    const __m256 gx = _mm256_loadu_ps(g->d[0]), gy = _mm256_loadu_ps(g->d[1]), gz = _mm256_loadu_ps(g->d[2]);
    const __m256 mx = _mm256_sub_ps(_mm256_set1_ps(f->c[0]), _mm256_loadu_ps(g->o[0]));
    const __m256 my = _mm256_sub_ps(_mm256_set1_ps(f->c[1]), _mm256_loadu_ps(g->o[1]));
    const __m256 mz = _mm256_sub_ps(_mm256_set1_ps(f->c[2]), _mm256_loadu_ps(g->o[2]));
    const __m256 tc = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(mx, gx), _mm256_mul_ps(my, gy)), _mm256_mul_ps(mz, gz));
    const __m256 vx = _mm256_sub_ps(mx, _mm256_mul_ps(tc, gx)), vy = _mm256_sub_ps(my, _mm256_mul_ps(tc, gy));
    const __m256 vz = _mm256_sub_ps(mz, _mm256_mul_ps(tc, gz));
    const __m256 d2 = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(vx, vx), _mm256_mul_ps(vy, vy)), _mm256_mul_ps(vz, vz));
    const float radius2 = f->radius * f->radius;
    __m128 a, b, e;
    float least, lo, hi, half, scale;
    if (_mm256_movemask_ps(_mm256_cmp_ps(d2, _mm256_set1_ps(radius2), _CMP_LT_OQ)) == 0) return 0;
    _mm256_storeu_ps(r->tc, tc);
    _mm256_storeu_ps(r->d2, d2);
    a = _mm_min_ps(_mm256_castps256_ps128(d2), _mm256_extractf128_ps(d2, 1));
    b = _mm_min_ps(_mm256_castps256_ps128(tc), _mm256_extractf128_ps(tc, 1));
    e = _mm_max_ps(_mm256_castps256_ps128(tc), _mm256_extractf128_ps(tc, 1));
    a = _mm_min_ps(a, _mm_movehl_ps(a, a));
    b = _mm_min_ps(b, _mm_movehl_ps(b, b));
    e = _mm_max_ps(e, _mm_movehl_ps(e, e));
    least = _mm_cvtss_f32(_mm_min_ss(a, _mm_shuffle_ps(a, a, 1)));
    lo = _mm_cvtss_f32(_mm_min_ss(b, _mm_shuffle_ps(b, b, 1)));
    hi = _mm_cvtss_f32(_mm_max_ss(e, _mm_shuffle_ps(e, e, 1)));
    scale = 1.0f / g->h;
    half = radius2 - least;
    if (!(half > 0.0f)) return 0;
    half = sqrtf(half);
    lo = (lo - half) * scale;
    hi = (hi + half) * scale;
    if (!(hi >= 0.0f) || !(lo <= (float)(g->n - 1))) return 0;
    r->first = lo > 0.0f ? (int32_t)lo : 0;
    r->last = hi < (float)(g->n - 1) ? (int32_t)hi : g->n - 1;
    half = 0.5f * (lo + hi);
    r->middle = half <= (float)r->first ? r->first : half >= (float)r->last ? r->last : (int32_t)(half + 0.5f);
    return 1;
}

TETCASTI_TARGET_AVX2 TETCASTI_INLINE void tetcasti_rbf_run8_kind(const tetcast_kernel kernel, const uint32_t n,
        const tetcasti_rbf_group *g, const tetcasti_rbf_record *f, const tetcasti_rbf_reach *r, float *rows,
        size_t stride) {
    const __m256 tc = _mm256_loadu_ps(r->tc), d2 = _mm256_loadu_ps(r->d2), zero = _mm256_setzero_ps();
    const float h = g->h;
    __m256 w[TETCAST_RBF_MAX_COMPONENTS];
    uint32_t c;
    int32_t j, k, way;
    for (c = 0; c < n; c++) w[c] = _mm256_set1_ps(f->w[c]);
    if (kernel != TETCAST_KERNEL_GAUSS && kernel != TETCAST_KERNEL_GAUSS_CUT) {
        for (j = r->first; j <= r->last; j++) {
            const __m256 u = _mm256_sub_ps(_mm256_set1_ps((float)j * h), tc);
            const __m256 phi = tetcasti_rbf_phi8(kernel, f, _mm256_add_ps(d2, _mm256_mul_ps(u, u)), 0, NULL);
            for (c = 0; c < n; c++) {
                float *at = rows + c * stride + (size_t)j * 8;
                _mm256_storeu_ps(at, _mm256_add_ps(_mm256_loadu_ps(at), _mm256_mul_ps(w[c], phi)));
            }
        }
        return;
    }
    {
        const __m256 c2 = _mm256_set1_ps(tetcasti_exp2_fast(2.0f * f->a * h * h)), e = _mm256_set1_ps(f->e);
        const __m256 a = _mm256_set1_ps(f->a), ah = _mm256_set1_ps(f->a * h), h8 = _mm256_set1_ps(h);
        for (way = 1; way >= -1; way -= 2) {
            const __m256 twice = _mm256_set1_ps(way > 0 ? 2.0f : -2.0f);
            j = way > 0 ? r->middle : r->middle - 1;
            while (way > 0 ? j <= r->last : j >= r->first) {
                const __m256 u = _mm256_sub_ps(_mm256_set1_ps((float)j * h), tc);
                __m256 v = tetcasti_exp2_fast8(_mm256_mul_ps(a, _mm256_add_ps(d2, _mm256_mul_ps(u, u))));
                __m256 q = tetcasti_exp2_fast8(_mm256_mul_ps(ah, _mm256_add_ps(h8, _mm256_mul_ps(twice, u))));
                int32_t left = way > 0 ? r->last - j + 1 : j - r->first + 1;
                float *at = rows + (size_t)j * 8;
                left = left < TETCASTI_RBF_RUN ? left : TETCASTI_RBF_RUN;
                for (k = 0; k < left; k++, at += 8 * way) {
                    const __m256 m = _mm256_sub_ps(v, e);
                    const __m256 phi = kernel == TETCAST_KERNEL_GAUSS
                        ? _mm256_max_ps(m, zero) : _mm256_and_ps(_mm256_cmp_ps(m, zero, _CMP_GT_OQ), v);
                    for (c = 0; c < n; c++)
                        _mm256_storeu_ps(at + c * stride, _mm256_add_ps(_mm256_loadu_ps(at + c * stride),
                                                                        _mm256_mul_ps(w[c], phi)));
                    v = _mm256_mul_ps(v, q);
                    q = _mm256_mul_ps(q, c2);
                }
                j += way * left;
            }
        }
    }
}
TETCASTI_TARGET_AVX2 static void tetcasti_rbf_run8(tetcast_kernel kernel, uint32_t n, const tetcasti_rbf_group *g,
        const tetcasti_rbf_record *f, const tetcasti_rbf_reach *r, float *rows, size_t stride) {
    if (kernel == TETCAST_KERNEL_GAUSS && n == 1)
        tetcasti_rbf_run8_kind(TETCAST_KERNEL_GAUSS, 1, g, f, r, rows, stride);
    else if (kernel == TETCAST_KERNEL_GAUSS && n == 3)
        tetcasti_rbf_run8_kind(TETCAST_KERNEL_GAUSS, 3, g, f, r, rows, stride);
    else if (kernel == TETCAST_KERNEL_GAUSS) tetcasti_rbf_run8_kind(TETCAST_KERNEL_GAUSS, n, g, f, r, rows, stride);
    else if (kernel == TETCAST_KERNEL_GAUSS_CUT)
        tetcasti_rbf_run8_kind(TETCAST_KERNEL_GAUSS_CUT, n, g, f, r, rows, stride);
    else if (kernel == TETCAST_KERNEL_WENDLAND2)
        tetcasti_rbf_run8_kind(TETCAST_KERNEL_WENDLAND2, n, g, f, r, rows, stride);
    else if (kernel == TETCAST_KERNEL_WENDLAND4)
        tetcasti_rbf_run8_kind(TETCAST_KERNEL_WENDLAND4, n, g, f, r, rows, stride);
    else tetcasti_rbf_run8_kind(TETCAST_KERNEL_POWER, n, g, f, r, rows, stride);
}

/* Base at a row of samples, as tetcasti_rbf_base. */
TETCASTI_TARGET_AVX2 static void tetcasti_rbf_base8(const tetcast_rbf *m, const tetcasti_rbf_group *g, int32_t j,
                                                    float *rows, size_t stride) {
    const __m256 s = _mm256_set1_ps((float)j * g->h), zero = _mm256_setzero_ps();
    const uint32_t n = m->components;
    __m256 u[3];
    __m256i cell[3], at;
    int32_t step[3];
    uint32_t a, c;
    for (a = 0; a < 3; a++) {
        const int32_t last = (int32_t)m->dims[a] - 1;
        __m256 t = _mm256_add_ps(_mm256_loadu_ps(g->o[a]), _mm256_mul_ps(s, _mm256_loadu_ps(g->d[a])));
        t = _mm256_mul_ps(t, _mm256_set1_ps(m->node_scale[a]));
        t = _mm256_min_ps(_mm256_max_ps(t, zero), _mm256_set1_ps((float)last));
        cell[a] = _mm256_cvttps_epi32(t);
        if (last > 0) cell[a] = _mm256_min_epi32(cell[a], _mm256_set1_epi32(last - 1));
        u[a] = _mm256_sub_ps(t, _mm256_cvtepi32_ps(cell[a]));
    }
    step[0] = m->dims[0] > 1 ? (int32_t)n : 0;
    step[1] = m->dims[1] > 1 ? (int32_t)(n * m->dims[0]) : 0;
    step[2] = m->dims[2] > 1 ? (int32_t)(n * m->dims[0] * m->dims[1]) : 0;
    at = _mm256_add_epi32(_mm256_mullo_epi32(cell[2], _mm256_set1_epi32((int32_t)m->dims[1])), cell[1]);
    at = _mm256_add_epi32(_mm256_mullo_epi32(at, _mm256_set1_epi32((int32_t)m->dims[0])), cell[0]);
    at = _mm256_mullo_epi32(at, _mm256_set1_epi32((int32_t)n));
    for (c = 0; c < n; c++) {
        const float *v = m->node + c;
        const __m256 v000 = _mm256_i32gather_ps(v, at, 4), v100 = _mm256_i32gather_ps(v + step[0], at, 4);
        const __m256 v010 = _mm256_i32gather_ps(v + step[1], at, 4);
        const __m256 v110 = _mm256_i32gather_ps(v + step[0] + step[1], at, 4);
        const __m256 v001 = _mm256_i32gather_ps(v + step[2], at, 4);
        const __m256 v101 = _mm256_i32gather_ps(v + step[0] + step[2], at, 4);
        const __m256 v011 = _mm256_i32gather_ps(v + step[1] + step[2], at, 4);
        const __m256 v111 = _mm256_i32gather_ps(v + step[0] + step[1] + step[2], at, 4);
        const __m256 x0 = _mm256_add_ps(v000, _mm256_mul_ps(u[1], _mm256_sub_ps(v010, v000)));
        const __m256 x1 = _mm256_add_ps(v100, _mm256_mul_ps(u[1], _mm256_sub_ps(v110, v100)));
        const __m256 y0 = _mm256_add_ps(v001, _mm256_mul_ps(u[1], _mm256_sub_ps(v011, v001)));
        const __m256 y1 = _mm256_add_ps(v101, _mm256_mul_ps(u[1], _mm256_sub_ps(v111, v101)));
        const __m256 z0 = _mm256_add_ps(x0, _mm256_mul_ps(u[2], _mm256_sub_ps(y0, x0)));
        const __m256 z1 = _mm256_add_ps(x1, _mm256_mul_ps(u[2], _mm256_sub_ps(y1, x1)));
        _mm256_storeu_ps(rows + c * stride + (size_t)j * 8, _mm256_add_ps(z0, _mm256_mul_ps(u[0], _mm256_sub_ps(z1, z0))));
    }
}
#endif

typedef struct tetcasti_rbf_plane { double n[3], at; } tetcasti_rbf_plane; /* n . p - at */

typedef struct tetcasti_rbf_picture {
    const tetcast_rbf_render_desc *desc;
    const tetcast_rbf *m;
    const tetcast_optics *optics;
    const tetcast_image *image;
    tetcasti_mem mem;
    tetcasti_frame frame;
    tetcasti_encoder encoder;
    double eye[3], right[3], up[3], forward[3]; /* local; not at right angles when the metric is not even */
    tetcast_isa isa;
    tetcast_rbf_channel channel;
    uint32_t component;
    float h, step, seen[2];       /* step local, world; values outside of seen[] show nothing */
    uint32_t rows;                /* most samples of a ray */
    uint32_t tiles_x, tiles_y, tiles;
    size_t *first;                /* [tiles + 1] */
    uint32_t *list;
    tetcasti_rbf_add_fn *add;
    uint32_t next, done, failed, cancelled;
    uint32_t tally[6][2];
} tetcasti_rbf_picture;

/* One ray of a group. 0: it misses the box. ends: local distances. */
static int tetcasti_rbf_ray(const tetcasti_rbf_picture *t, uint32_t x, uint32_t y, double o[3], double d[3],
                            double ends[2], double *world) {
    const double u = ((double)x + 0.5) - 0.5 * (double)t->frame.width, v = 0.5 * (double)t->frame.height - ((double)y + 0.5);
    double l = 0.0, w = 0.0;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const double shift = u * t->right[a] + v * t->up[a];
        o[a] = t->frame.parallel ? t->eye[a] + shift : t->eye[a];
        d[a] = t->frame.parallel ? t->forward[a] : t->forward[a] + shift;
        l += d[a] * d[a];
        w += d[a] * t->m->scale[a] * (d[a] * t->m->scale[a]);
    }
    l = sqrt(l);
    *world = sqrt(w) / l;
    ends[0] = 0.0;
    ends[1] = 1e30;
    for (a = 0; a < 3; a++) {
        const double hi = (double)t->m->size[a];
        d[a] /= l;
        if (d[a] == 0.0) {
            if (!(o[a] >= 0.0 && o[a] <= hi)) return 0;
        } else {
            const double p = -o[a] / d[a], q = (hi - o[a]) / d[a];
            ends[0] = tetcasti_max(ends[0], tetcasti_min(p, q));
            ends[1] = tetcasti_min(ends[1], tetcasti_max(p, q));
        }
    }
    return ends[1] > ends[0];
}

/* The rays of a group at pixel (x, y), 4 x 2. 0: none meets the box. */
static int tetcasti_rbf_group_open(const tetcasti_rbf_picture *t, uint32_t x, uint32_t y, tetcasti_rbf_group *g) {
    double o[8][3], d[8][3], ends[8][2], world[8], from = 1e30, to = 0.0, at;
    const double h = (double)t->h;
    uint32_t l, a, one = 8;
    g->lanes = 0;
    for (l = 0; l < 8; l++) {
        const uint32_t px = x + (l & 3u), py = y + (l >> 2);
        if (px >= t->frame.width || py >= t->frame.height || !tetcasti_rbf_ray(t, px, py, o[l], d[l], ends[l], &world[l]))
            continue;
        g->lanes |= 1u << l;
        one = l;
        from = tetcasti_min(from, ends[l][0]);
        to = tetcasti_max(to, ends[l][1]);
    }
    if (g->lanes == 0) return 0;
    at = (double)tetcasti_floor(from / h) * h;
    for (l = 0; l < 8; l++) {
        const uint32_t k = (g->lanes >> l & 1u) != 0 ? l : one;
        for (a = 0; a < 3; a++) {
            g->o[a][l] = (float)(o[k][a] + at * d[k][a]);
            g->d[a][l] = (float)d[k][a];
        }
        g->in[l] = (float)(ends[k][0] - at);
        g->out[l] = (float)(ends[k][1] - at);
        g->world[l] = (float)world[k];
        g->start[l] = (float)(at * world[k]);
    }
    g->h = t->h;
    g->n = (int32_t)tetcasti_min((double)tetcasti_floor((to - at) / h) + 2.0, (double)t->rows);
    return 1;
}

static void tetcasti_rbf_base_rows(const tetcasti_rbf_picture *t, const tetcasti_rbf_group *g, float *rows,
                                   size_t stride) {
    const tetcast_rbf *m = t->m;
    uint32_t l, c, a;
    int32_t j;
    for (j = 0; j < g->n; j++) {
        if (m->node == NULL) {
            for (c = 0; c < m->components; c++)
                for (l = 0; l < 8; l++) rows[c * stride + (size_t)j * 8 + l] = m->offset[c];
            continue;
        }
#if TETCASTI_AVX2
        if (t->isa >= TETCAST_ISA_AVX2) {
            tetcasti_rbf_base8(m, g, j, rows, stride);
            continue;
        }
#endif
        for (l = 0; l < 8; l++) {
            float p[3], v[TETCAST_RBF_MAX_COMPONENTS];
            for (a = 0; a < 3; a++) p[a] = g->o[a][l] + (float)j * g->h * g->d[a][l];
            tetcasti_rbf_base(m, p, v, NULL);
            for (c = 0; c < m->components; c++) rows[c * stride + (size_t)j * 8 + l] = v[c];
        }
    }
}

/* What is seen of the components and their local slopes. */
static float tetcasti_rbf_scalar(const tetcasti_rbf_picture *t, const float *v, const float *slope) {
    const tetcast_rbf *m = t->m;
    tetcast_flow flow;
    float jacobian[9], s = 0.0f;
    uint32_t c;
    if (t->channel == TETCAST_RBF_CHANNEL_COMPONENT) return v[t->component];
    if (t->channel == TETCAST_RBF_CHANNEL_LENGTH) {
        for (c = 0; c < m->components; c++) s += v[c] * v[c];
        return sqrtf(s);
    }
    for (c = 0; c < 9; c++) jacobian[c] = (float)((double)slope[c] / m->scale[c % 3]);
    tetcast_flow_features(v, jacobian, &flow);
    if (t->channel == TETCAST_RBF_CHANNEL_LAMBDA2) return -flow.lambda2;
    if (t->channel == TETCAST_RBF_CHANNEL_HELICITY) return flow.helicity;
    return (float)sqrt((double)flow.vorticity[0] * (double)flow.vorticity[0] + (double)flow.vorticity[1] *
                       (double)flow.vorticity[1] + (double)flow.vorticity[2] * (double)flow.vorticity[2]);
}

/* Samples one by one: rows[0] gets what is seen. */
static void tetcasti_rbf_gather_rows(const tetcasti_rbf_picture *t, const tetcasti_rbf_group *g, float *rows) {
    const uint32_t n = t->m->components;
    const int slopes = t->channel > TETCAST_RBF_CHANNEL_LENGTH;
    float p[8][3], v[8 * TETCAST_RBF_MAX_COMPONENTS], s[8 * TETCAST_RBF_MAX_COMPONENTS * 3];
    uint32_t l, a;
    int32_t j;
    for (j = 0; j < g->n; j++) {
        for (l = 0; l < 8; l++)
            for (a = 0; a < 3; a++) p[l][a] = g->o[a][l] + (float)j * g->h * g->d[a][l];
        tetcasti_rbf_points(t->m, t->add, 0, (const float (*)[3])p, 8, v, slopes ? s : NULL);
        for (l = 0; l < 8; l++) rows[(size_t)j * 8 + l] = tetcasti_rbf_scalar(t, v + l * n, s + l * n * 3);
    }
}

/* Values of all samples of a group: rows[0 ..]. */
static void tetcasti_rbf_group_values(tetcasti_rbf_picture *t, const tetcasti_rbf_group *g, uint32_t tile, float *rows,
                                      size_t stride, uint64_t count[3]) {
    const tetcast_rbf *m = t->m;
    tetcasti_rbf_reach r;
    size_t i;
    uint32_t c, n = m->components;
    memset(&r, 0, sizeof r);
    if (t->desc->gather || t->channel > TETCAST_RBF_CHANNEL_LENGTH) {
        tetcasti_rbf_gather_rows(t, g, rows);
        return;
    }
    tetcasti_rbf_base_rows(t, g, rows, stride);
    for (i = t->first[tile]; i < t->first[tile + 1]; i++) {
        const tetcasti_rbf_record *f = &m->record[t->list[i]];
        count[0]++;
#if TETCASTI_AVX2
        if (t->isa >= TETCAST_ISA_AVX2) {
            if (!tetcasti_rbf_meet8(g, f, &r)) continue;
            tetcasti_rbf_run8(m->kernel, n, g, f, &r, rows, stride);
        } else
#endif
        {
            if (!tetcasti_rbf_meet(g, f, &r)) continue;
            tetcasti_rbf_run_scalar(m->kernel, n, g, f, &r, rows, stride);
        }
        count[1]++;
        count[2] += 8u * (uint64_t)(r.last - r.first + 1);
    }
    if (t->channel == TETCAST_RBF_CHANNEL_LENGTH) {
        for (i = 0; i < 8 * (size_t)g->n; i++) {
            float s = 0.0f;
            for (c = 0; c < n; c++) s += rows[c * stride + i] * rows[c * stride + i];
            rows[i] = sqrtf(s);
        }
    } else if (t->component != 0) memcpy(rows, rows + t->component * stride, 8 * (size_t)g->n * sizeof *rows);
}

/* ---- along the rays ---- */

typedef struct tetcasti_rbf_hit { /* a crossing of an isovalue */
    const tetcasti_rbf_picture *t;
    const tetcasti_rbf_group *g;
    uint32_t lane;
    float from, to, front, back;  /* way and value at both ends */
    float *hit;                   /* the first crossing's way */
} tetcasti_rbf_hit;

static float tetcasti_rbf_probe(const tetcasti_rbf_hit *x, float s, float slope[3]) {
    const tetcasti_rbf_picture *t = x->t;
    const uint32_t n = t->m->components;
    float p[1][3], v[TETCAST_RBF_MAX_COMPONENTS], d[TETCAST_RBF_MAX_COMPONENTS * 3], value;
    uint32_t a, c;
    for (a = 0; a < 3; a++) p[0][a] = x->g->o[a][x->lane] + s * x->g->d[a][x->lane];
    tetcasti_rbf_points(t->m, t->add, 0, (const float (*)[3])p, 1, v, d);
    value = tetcasti_rbf_scalar(t, v, d);
    for (a = 0; a < 3; a++) {
        double sum = 0.0;
        if (t->channel == TETCAST_RBF_CHANNEL_COMPONENT) sum = (double)d[t->component * 3 + a];
        else for (c = 0; c < n; c++) sum += (double)v[c] * (double)d[c * 3 + a];
        slope[a] = (float)(sum / t->m->scale[a]);
    }
    return value;
}

/* The surface between two samples: false position on the function itself, then its gradient. Features of flows have no
   gradient here: differences are taken. */
static void tetcasti_rbf_normal(void *user, float fraction, float normal[3]) {
    tetcasti_rbf_hit *x = (tetcasti_rbf_hit *)user;
    const float want = x->front + fraction * (x->back - x->front), width = x->to - x->from;
    float a = x->from, b = x->to, fa = x->front - want, fb = x->back - want, s = x->from + fraction * width, f;
    uint32_t i, k;
    f = tetcasti_rbf_probe(x, s, normal) - want;
    for (i = 0; i < 6 && tetcasti_absf(b - a) > 1e-4f * width && f != 0.0f; i++) {
        if ((f > 0.0f) == (fa > 0.0f)) {
            a = s;
            fa = f;
            fb *= 0.5f; /* Illinois */
        } else {
            b = s;
            fb = f;
            fa *= 0.5f;
        }
        if (!(tetcasti_absf(fb - fa) > 0.0f)) break;
        s = a - fa * ((b - a) / (fb - fa));
        if (!(s >= (a < b ? a : b) && s <= (a < b ? b : a))) s = 0.5f * (a + b);
        f = tetcasti_rbf_probe(x, s, normal) - want;
    }
    if (x->t->channel > TETCAST_RBF_CHANNEL_LENGTH) {
        const float e = 0.02f * x->t->h;
        for (k = 0; k < 3; k++) {
            float p[1][3], v[TETCAST_RBF_MAX_COMPONENTS], d[TETCAST_RBF_MAX_COMPONENTS * 3], value[2];
            for (i = 0; i < 2; i++) {
                uint32_t c;
                for (c = 0; c < 3; c++)
                    p[0][c] = x->g->o[c][x->lane] + s * x->g->d[c][x->lane] + (c == k ? (i != 0 ? e : -e) : 0.0f);
                tetcasti_rbf_points(x->t->m, x->t->add, 0, (const float (*)[3])p, 1, v, d);
                value[i] = tetcasti_rbf_scalar(x->t, v, d);
            }
            normal[k] = (float)(((double)value[1] - (double)value[0]) / x->t->m->scale[k]);
        }
    }
    if (*x->hit == TETCASTI_INF) *x->hit = s;
}

/* The segment of one lane between samples j and j + 1, cut by the box. 0: there is none. */
static int tetcasti_rbf_cut(const tetcasti_rbf_group *g, const float *rows, int32_t j, uint32_t l, tetcasti_seg8 *seg,
                            float *from, float *to) {
    const float a = (float)j * g->h, b = (float)(j + 1) * g->h, v = rows[(size_t)j * 8 + l], w = rows[(size_t)j * 8 + 8 + l];
    *from = a > g->in[l] ? a : g->in[l];
    *to = b < g->out[l] ? b : g->out[l];
    if ((g->lanes >> l & 1u) == 0 || !(*to > *from)) return 0;
    seg->front[l] = *from > a ? v + (w - v) * ((*from - a) / g->h) : v;
    seg->back[l] = *to < b ? v + (w - v) * ((*to - a) / g->h) : w;
    seg->length[l] = (*to - *from) * g->world[l];
    seg->depth[l] = g->start[l] + *from * g->world[l];
    return 1;
}

/* Integrate the rows of a group. depth: local way to the first sample that shows something. */
static void tetcasti_rbf_march(const tetcasti_rbf_picture *t, const tetcasti_rbf_group *g, const float *rows,
                               tetcasti_ray_sum8 *sum, float depth[8]) {
    const tetcast_optics *o = t->optics;
    tetcasti_seg8 seg;
    uint32_t l, ended = 0;
    int32_t j;
    const int want_depth = t->image->depth != NULL;
    for (l = 0; l < 8; l++) {
        tetcasti_lane_begin(o, sum, l);
        depth[l] = TETCASTI_INF;
    }
    memset(&seg, 0, sizeof seg);
    for (j = 0; j + 1 < g->n; j++) {
        const float *v = rows + (size_t)j * 8;
        float from[8], to[8];
        uint32_t lanes = 0, below = 0, above = 0, hits;
        for (l = 0; l < 8; l++) {
            below |= (uint32_t)!((v[l] < t->seen[0]) & (v[l + 8] < t->seen[0])) << l;
            above |= (uint32_t)!((v[l] > t->seen[1]) & (v[l + 8] > t->seen[1])) << l;
        }
        if ((below & above & g->lanes & ~ended) == 0) continue;
        for (l = 0; l < 8; l++)
            if ((below & above & ~ended) >> l & 1u)
                lanes |= (uint32_t)tetcasti_rbf_cut(g, rows, j, l, &seg, &from[l], &to[l]) << l;
        if (lanes == 0) continue;
        hits = o->iso_count != 0 ? tetcasti_iso_lanes(o, &seg, lanes) : 0;
        for (l = 0; l < 8; l++) {
            if ((lanes >> l & 1u) == 0) continue;
            if (want_depth && depth[l] == TETCASTI_INF && (hits >> l & 1u) == 0 &&
                !tetcasti_optics_empty(o, seg.front[l] < seg.back[l] ? seg.front[l] : seg.back[l],
                                       seg.front[l] < seg.back[l] ? seg.back[l] : seg.front[l])) depth[l] = from[l];
            if (hits >> l & 1u) {
                tetcasti_rbf_hit x;
                float view[3];
                double way = 0.0;
                uint32_t a;
                for (a = 0; a < 3; a++) {
                    const double w = (double)g->d[a][l] * t->m->scale[a];
                    way += w * w;
                }
                for (a = 0; a < 3; a++) view[a] = (float)((double)g->d[a][l] * t->m->scale[a] / sqrt(way));
                x.t = t;
                x.g = g;
                x.lane = l;
                x.from = from[l];
                x.to = to[l];
                x.front = seg.front[l];
                x.back = seg.back[l];
                x.hit = &depth[l];
                tetcasti_lane_segment_iso(o, l, &seg, tetcasti_rbf_normal, &x, view, sum);
                if (!(sum->t[l] > o->t_stop)) ended |= 1u << l;
            }
        }
        if (lanes & ~hits) ended |= o->segment8(o, &seg, lanes & ~hits, sum);
        if ((g->lanes & ~ended) == 0) break;
    }
}

static void tetcasti_rbf_pixel(const tetcasti_rbf_picture *t, uint32_t x, uint32_t y, const float rgba[4], float depth,
                               float length) {
    const tetcast_image *m = t->image;
    const float *back = t->desc->background;
    float out[4];
    uint32_t c;
    for (c = 0; c < 4; c++) out[c] = rgba[c] + (1.0f - rgba[3]) * back[c];
    if (m->rgba != NULL) {
        const size_t stride = m->rgba_stride != 0 ? m->rgba_stride : (size_t)m->width * 16;
        memcpy((uint8_t *)m->rgba + y * stride + (size_t)x * 16, out, 16);
    }
    if (m->rgba8 != NULL) {
        uint8_t *p = m->rgba8 + y * (m->rgba8_stride != 0 ? m->rgba8_stride : (size_t)m->width * 4) + (size_t)x * 4;
        const float a = out[3] < 1.0f ? out[3] : 1.0f;
        for (c = 0; c < 3; c++) p[c] = tetcasti_encode(&t->encoder, a > 0.0f ? out[c] / a : out[c]);
        p[3] = (uint8_t)(a > 0.0f ? a * 255.0f + 0.5f : 0.0f);
    }
    if (m->depth != NULL) {
        const size_t stride = m->depth_stride != 0 ? m->depth_stride : (size_t)m->width * 4;
        memcpy((uint8_t *)m->depth + y * stride + (size_t)x * 4, &depth, 4);
    }
    if (m->length != NULL) {
        const size_t stride = m->length_stride != 0 ? m->length_stride : (size_t)m->width * 4;
        memcpy((uint8_t *)m->length + y * stride + (size_t)x * 4, &length, 4);
    }
    if (m->steps != NULL) {
        const uint32_t none = 0;
        const size_t stride = m->steps_stride != 0 ? m->steps_stride : (size_t)m->width * 4;
        memcpy((uint8_t *)m->steps + y * stride + (size_t)x * 4, &none, 4);
    }
}

static void tetcasti_rbf_group_draw(tetcasti_rbf_picture *t, uint32_t tile, uint32_t x, uint32_t y, float *rows,
                                    size_t stride, uint64_t count[5]) {
    static const float nothing[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    tetcasti_rbf_group g;
    tetcasti_ray_sum8 sum;
    float depth[8], rgba[4];
    uint32_t l;
    const int met = tetcasti_rbf_group_open(t, x, y, &g);
    if (met) {
        tetcasti_rbf_group_values(t, &g, tile, rows, stride, count + 2);
        tetcasti_rbf_march(t, &g, rows, &sum, depth);
    } else g.lanes = 0;
    for (l = 0; l < 8; l++) {
        const uint32_t px = x + (l & 3u), py = y + (l >> 2);
        if (px >= t->frame.width || py >= t->frame.height) continue;
        if ((g.lanes >> l & 1u) == 0) {
            tetcasti_rbf_pixel(t, px, py, nothing, TETCASTI_INF, 0.0f);
            continue;
        }
        tetcasti_lane_finish(t->optics, &sum, l, rgba);
        if (depth[l] < TETCASTI_INF) { /* along the viewing axis */
            double z = 0.0;
            uint32_t a;
            for (a = 0; a < 3; a++)
                z += (double)g.d[a][l] * t->m->scale[a] * t->frame.forward[a];
            depth[l] = (float)(((double)g.start[l] / (double)g.world[l] + (double)depth[l]) * z);
        }
        tetcasti_rbf_pixel(t, px, py, rgba, depth[l], (g.out[l] - g.in[l]) * g.world[l]);
        count[0]++;
        count[1] += (uint64_t)((g.out[l] - g.in[l]) / g.h) + 2;
    }
}

static void tetcasti_task_rbf_tiles(void *ctx, uint32_t strand) {
    tetcasti_rbf_picture *t = (tetcasti_rbf_picture *)ctx;
    const size_t stride = 8 * (size_t)t->rows;
    float *rows = (float *)tetcasti_alloc_array(&t->mem, stride * t->m->components, sizeof(float));
    uint64_t count[5] = {0, 0, 0, 0, 0};
    uint32_t i;
    if (rows == NULL) tetcasti_atomic_store(&t->failed, 1u);
    while (rows != NULL) {
        const uint32_t tile = tetcasti_atomic_add(&t->next, 1u) - 1u;
        uint32_t x0, y0, x, y;
        if (tile >= t->tiles || tetcasti_atomic_load(&t->failed) || tetcasti_atomic_load(&t->cancelled)) break;
        x0 = tile % t->tiles_x * TETCASTI_RBF_TILE;
        y0 = tile / t->tiles_x * TETCASTI_RBF_TILE;
        for (y = y0; y < y0 + TETCASTI_RBF_TILE && y < t->frame.height; y += 2)
            for (x = x0; x < x0 + TETCASTI_RBF_TILE && x < t->frame.width; x += 4)
                tetcasti_rbf_group_draw(t, tile, x, y, rows, stride, count);
        i = tetcasti_atomic_add(&t->done, 1u);
        if (strand == 0 && t->desc->env.progress_fn != NULL &&
            t->desc->env.progress_fn(t->desc->env.progress_user, i, t->tiles) != 0)
                tetcasti_atomic_store(&t->cancelled, 1u);
    }
    for (i = 0; i < 5; i++) tetcasti_tally_add(t->tally[i], count[i]);
    tetcasti_free(&t->mem, rows);
}

/* ---- functions -> tiles ---- */

/* The plane through a line of the picture, x = at (axis 0) or y = at: positive on the side of larger x or y. */
static void tetcasti_rbf_line_plane(const tetcasti_rbf_picture *t, uint32_t axis, double at, tetcasti_rbf_plane *p) {
    const double k = axis == 0 ? at - 0.5 * (double)t->frame.width : 0.5 * (double)t->frame.height - at;
    const double *across = axis == 0 ? t->right : t->up, *along = axis == 0 ? t->up : t->right;
    double d[3], o[3], side = 0.0, l = 0.0;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        d[a] = t->frame.parallel ? t->forward[a] : t->forward[a] + k * across[a];
        o[a] = t->frame.parallel ? t->eye[a] + k * across[a] : t->eye[a];
    }
    tetcasti_cross(along, d, p->n);
    for (a = 0; a < 3; a++) {
        l += p->n[a] * p->n[a];
        side += p->n[a] * across[a];
    }
    l = sqrt(l) * ((side > 0.0) == (axis == 0) ? 1.0 : -1.0);
    p->at = 0.0;
    for (a = 0; a < 3; a++) {
        p->n[a] /= l;
        p->at += p->n[a] * o[a];
    }
}

/* Tiles [from, to) that a ball touches in one direction. */
static void tetcasti_rbf_tile_range(const tetcasti_rbf_plane *p, uint32_t tiles, const tetcasti_rbf_record *f,
                                    uint32_t *from, uint32_t *to) {
    const double r = (double)f->radius * 1.0001 + 1e-7;
    uint32_t i;
    double before;
    *from = tiles;
    *to = 0;
    before = p[0].n[0] * (double)f->c[0] + p[0].n[1] * (double)f->c[1] + p[0].n[2] * (double)f->c[2] - p[0].at;
    for (i = 0; i < tiles; i++) {
        const tetcasti_rbf_plane *q = &p[i + 1];
        const double after = q->n[0] * (double)f->c[0] + q->n[1] * (double)f->c[1] + q->n[2] * (double)f->c[2] - q->at;
        if (before > -r && after < r) {
            if (*from == tiles) *from = i;
            *to = i + 1;
        }
        before = after;
    }
}

static int tetcasti_rbf_bin(tetcasti_rbf_picture *t, float least) { /* 0: no memory */
    const tetcast_rbf *m = t->m;
    tetcasti_rbf_plane *plane =
        (tetcasti_rbf_plane *)tetcasti_alloc_array(&t->mem, (size_t)t->tiles_x + t->tiles_y + 2, sizeof *plane);
    uint32_t (*range)[4] = (uint32_t (*)[4])tetcasti_alloc_array(&t->mem, (size_t)m->count + 1, sizeof *range);
    uint32_t i, x, y;
    size_t k, sum = 0;
    int ok;
    t->first = (size_t *)tetcasti_alloc_zero(&t->mem, (size_t)t->tiles + 1, sizeof *t->first);
    ok = plane != NULL && range != NULL && t->first != NULL;
    if (ok) {
        for (i = 0; i <= t->tiles_x; i++) tetcasti_rbf_line_plane(t, 0, (double)i * TETCASTI_RBF_TILE, &plane[i]);
        for (i = 0; i <= t->tiles_y; i++)
            tetcasti_rbf_line_plane(t, 1, (double)i * TETCASTI_RBF_TILE, &plane[t->tiles_x + 1 + i]);
        for (i = 0; i < m->count; i++) {
            uint32_t *r = range[i];
            memset(r, 0, sizeof range[i]);
            if (!(m->record[i].radius > 0.0f) || m->record[i].most <= least) continue;
            tetcasti_rbf_tile_range(plane, t->tiles_x, &m->record[i], &r[0], &r[1]);
            tetcasti_rbf_tile_range(plane + t->tiles_x + 1, t->tiles_y, &m->record[i], &r[2], &r[3]);
            for (y = r[2]; y < r[3]; y++)
                for (x = r[0]; x < r[1]; x++) t->first[y * t->tiles_x + x]++;
        }
        for (k = 0; k <= t->tiles; k++) {
            const size_t some = k < t->tiles ? t->first[k] : 0;
            t->first[k] = sum;
            sum += some;
        }
        t->list = (uint32_t *)tetcasti_alloc_array(&t->mem, sum + 1, sizeof *t->list);
        ok = t->list != NULL;
        for (i = 0; ok && i < m->count; i++)
            for (y = range[i][2]; y < range[i][3]; y++)
                for (x = range[i][0]; x < range[i][1]; x++) t->list[t->first[y * t->tiles_x + x]++] = i;
        for (k = t->tiles; k > 0; k--) t->first[k] = t->first[k - 1];
        t->first[0] = 0;
    }
    tetcasti_free(&t->mem, plane);
    tetcasti_free(&t->mem, range);
    return ok;
}

/* Values between which something may be seen. */
static void tetcasti_rbf_seen(const tetcast_optics *o, float seen[2]) {
    const tetcasti_tf *tf = &o->tf;
    uint32_t i, last;
    seen[0] = TETCASTI_INF;
    seen[1] = -TETCASTI_INF;
    if (o->model != TETCAST_MODEL_ISOSURFACE && tf->visible[0] < tf->n) {
        for (last = tf->n - 1; tf->visible[last] != last;) last--;
        seen[0] = tf->visible[0] == 0 ? -TETCASTI_INF : tf->knot[tf->visible[0]];
        seen[1] = last == tf->n - 1 ? TETCASTI_INF : tf->knot[last + 1];
    }
    for (i = 0; i < o->iso_count; i++) {
        seen[0] = o->iso[i].value < seen[0] ? o->iso[i].value : seen[0];
        seen[1] = o->iso[i].value > seen[1] ? o->iso[i].value : seen[1];
    }
}

/* The step that nothing was said about. */
static double tetcasti_rbf_step(const tetcasti_rbf_picture *t) {
    const tetcast_rbf *m = t->m;
    double diagonal = 0.0, step = 1e30;
    uint32_t histogram[128], i, a, seen = 0;
    memset(histogram, 0, sizeof histogram);
    for (a = 0; a < 3; a++) diagonal += (double)m->size[a] * (double)m->size[a];
    diagonal = sqrt(diagonal);
    for (i = 0; i < m->count; i++) {
        const double k = 4.0 * (tetcasti_log2((double)m->width[i]) + 24.0);
        histogram[k < 0.0 ? 0 : k > 127.0 ? 127 : (uint32_t)k]++;
    }
    for (i = 0; i < 128; i++) {
        seen += histogram[i];
        if (m->count != 0 && (uint64_t)seen * 10u >= m->count) {
            step = 0.5 * tetcasti_exp2((double)i / 4.0 - 24.0);
            break;
        }
    }
    for (a = 0; a < 3; a++)
        if (m->dims[a] > 1) step = tetcasti_min(step, 0.5 * (double)m->size[a] / (double)(m->dims[a] - 1));
    return tetcasti_max(tetcasti_min(step, diagonal / 64.0), diagonal / 1024.0);
}

static tetcast_result tetcasti_rbf_picture_open(tetcasti_rbf_picture *t, tetcast_rbf_render_desc *d) {
    const tetcast_rbf *m = t->m;
    double diagonal = 0.0, least = 1e300;
    tetcast_result r = TETCAST_OK;
    uint32_t a;
    if (d->camera.eye[0] == d->camera.at[0] && d->camera.eye[1] == d->camera.at[1] && d->camera.eye[2] == d->camera.at[2])
        r = tetcast_camera_fit(&d->camera, m->box_min, m->box_max, NULL, t->image->width, t->image->height);
    if (r == TETCAST_OK) r = tetcasti_frame_open(&d->camera, t->image->width, t->image->height, &t->frame);
    if (r != TETCAST_OK) return r;
    for (a = 0; a < 3; a++) {
        t->eye[a] = (t->frame.eye[a] - m->box_min[a]) / m->scale[a];
        t->right[a] = t->frame.right[a] / m->scale[a];
        t->up[a] = t->frame.up[a] / m->scale[a];
        t->forward[a] = t->frame.forward[a] / m->scale[a];
        diagonal += (double)m->size[a] * (double)m->size[a];
        least = tetcasti_min(least, m->scale[a]);
    }
    t->isa = tetcasti_rbf_isa(d->isa);
    t->add = tetcasti_rbf_add_pick(m, t->isa);
    t->h = (float)(d->step > 0.0f ? (double)d->step / least : tetcasti_rbf_step(t));
    t->step = (float)((double)t->h * least);
    if (!(t->h > 0.0f)) t->h = 1.0f; /* a box that is a point */
    if (sqrt(diagonal) / (double)t->h > (double)(TETCASTI_RBF_SAMPLES - 4)) return TETCAST_ERR_RANGE;
    t->rows = (uint32_t)(sqrt(diagonal) / (double)t->h) + 4;
    t->tiles_x = (t->image->width + TETCASTI_RBF_TILE - 1) / TETCASTI_RBF_TILE;
    t->tiles_y = (t->image->height + TETCASTI_RBF_TILE - 1) / TETCASTI_RBF_TILE;
    if ((uint64_t)t->tiles_x * t->tiles_y > 0x7fffffffu) return TETCAST_ERR_RANGE;
    t->tiles = t->tiles_x * t->tiles_y;
    tetcasti_rbf_seen(t->optics, t->seen);
    if (t->image->rgba8 != NULL) tetcasti_encoder_open(&t->encoder);
    return TETCAST_OK;
}

static tetcast_result tetcasti_rbf_render_check(const tetcast_rbf_render_desc *d, const tetcast_rbf *m) {
    uint32_t a;
    if ((uint32_t)d->channel > TETCAST_RBF_CHANNEL_HELICITY || d->component >= m->components ||
        (d->channel > TETCAST_RBF_CHANNEL_LENGTH && m->components != 3) ||
        !(d->step >= 0.0f && d->step < 1e30f) || !(d->epsilon >= 0.0f && d->epsilon <= 1.0f))
        return TETCAST_ERR_INVALID_ARG;
    for (a = 0; a < 4; a++) if (!tetcasti_finite_f(d->background[a])) return TETCAST_ERR_INVALID_ARG;
    return TETCAST_OK;
}

TETCAST_DEF tetcast_result tetcast_rbf_render(const tetcast_rbf_render_desc *desc, const tetcast_rbf *rbf,
                                              const tetcast_optics *optics, const tetcast_image *image,
                                              tetcast_rbf_render_stats *stats) {
    tetcast_rbf_render_desc d;
    tetcasti_rbf_picture t;
    tetcast_result r;
    uint32_t strands, i;
    float most = 0.0f;
    memset(&t, 0, sizeof t);
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    if (rbf == NULL || optics == NULL || image == NULL) return TETCAST_ERR_INVALID_ARG;
    t.desc = &d;
    t.m = rbf;
    t.optics = optics;
    t.image = image;
    t.component = d.component;
    t.channel = d.channel != TETCAST_RBF_CHANNEL_AUTO ? d.channel
        : rbf->components == 1 ? TETCAST_RBF_CHANNEL_COMPONENT : TETCAST_RBF_CHANNEL_LENGTH;
    r = tetcasti_env_open(&d.env, &t.mem);
    if (r == TETCAST_OK) r = tetcasti_rbf_render_check(&d, rbf);
    if (r == TETCAST_OK && (image->width == 0 || image->height == 0)) return TETCAST_OK;
    if (r == TETCAST_OK) r = tetcasti_rbf_picture_open(&t, &d);
    if (r != TETCAST_OK) return tetcasti_fail(d.env.error, r, 0, "render: bad camera or option, or too many samples");
    for (i = 0; i < rbf->count; i++) most = rbf->record[i].most > most ? rbf->record[i].most : most;
    if (!tetcasti_rbf_bin(&t, d.epsilon > 0.0f ? d.epsilon * most : -1.0f)) t.failed = 1;
    else {
        strands = tetcasti_thread_count(&d.env);
        if (strands > t.tiles) strands = t.tiles;
        tetcasti_parallel_for(&d.env, tetcasti_task_rbf_tiles, &t, strands);
    }
    tetcasti_free(&t.mem, t.first);
    tetcasti_free(&t.mem, t.list);
    if (t.failed) return tetcasti_fail(d.env.error, TETCAST_ERR_NO_MEMORY, 0, "render: out of memory");
    if (t.cancelled) return tetcasti_fail(d.env.error, TETCAST_ERR_CANCELLED, 0, "render: cancelled");
    if (stats != NULL) {
        stats->rays += (uint64_t)image->width * image->height;
        stats->hit_rays += tetcasti_tally(t.tally[0]);
        stats->samples += tetcasti_tally(t.tally[1]);
        stats->tests += tetcasti_tally(t.tally[2]);
        stats->pairs += tetcasti_tally(t.tally[3]);
        stats->evaluations += tetcasti_tally(t.tally[4]);
        stats->step = t.step;
        stats->isa = t.isa;
    }
    return TETCAST_OK;
}

/* ---- traces ---- */

typedef struct tetcasti_rbf_traces {
    const tetcast_rbf_trace_desc *d;
    const tetcast_rbf *m;
    tetcasti_rbf_add_fn *add;
    const double *seeds;
    size_t count;
    double *paths;
    uint32_t *lengths;
    tetcast_trace_end *ends;
} tetcasti_rbf_traces;

static void tetcasti_rbf_velocity(const tetcasti_rbf_traces *t, const double (*p)[3], uint32_t n, double (*v)[3]) {
    float local[8][3], value[24];
    uint32_t i, a;
    for (i = 0; i < n; i++) tetcasti_rbf_local(t->m, p[i], local[i]);
    tetcasti_rbf_points(t->m, t->add, 0, (const float (*)[3])local, n, value, NULL);
    for (i = 0; i < n; i++) for (a = 0; a < 3; a++) v[i][a] = (double)value[3 * i + a];
}

static int tetcasti_rbf_inside(const tetcast_rbf *m, const double p[3]) {
    uint32_t a;
    int in = 1;
    for (a = 0; a < 3; a++) in = in && p[a] >= m->box_min[a] && p[a] <= m->box_max[a];
    return in;
}

/* Eight particles at a time. */
static void tetcasti_task_rbf_trace(void *ctx, uint32_t task) {
    const tetcasti_rbf_traces *t = (const tetcasti_rbf_traces *)ctx;
    const size_t first = (size_t)task * 8, row = 3 * ((size_t)t->d->steps + 1);
    const double dt = t->d->dt;
    double p[8][3], q[8][3], k[4][8][3];
    uint32_t number[8], length[8], end[8], n = 0, i, a, s, stage;
    const uint32_t some = t->count - first < 8 ? (uint32_t)(t->count - first) : 8u;
    for (i = 0; i < some; i++) {
        const double *seed = t->seeds + 3 * (first + i);
        memcpy(t->paths + (first + i) * row, seed, 3 * sizeof *seed);
        length[i] = 1;
        end[i] = TETCAST_TRACE_STEPS;
        if (tetcasti_rbf_inside(t->m, seed)) {
            memcpy(p[n], seed, sizeof p[n]);
            number[n++] = i;
        } else end[i] = TETCAST_TRACE_BAD;
    }
    for (s = 0; s < t->d->steps && n != 0; s++) {
        uint32_t left = 0;
        tetcasti_rbf_velocity(t, (const double (*)[3])p, n, k[0]);
        for (stage = 1; stage < 4 && t->d->stepper == TETCAST_STEPPER_RK4; stage++) {
            const double part = stage < 3 ? 0.5 * dt : dt;
            for (i = 0; i < n; i++) for (a = 0; a < 3; a++) q[i][a] = p[i][a] + part * k[stage - 1][i][a];
            tetcasti_rbf_velocity(t, (const double (*)[3])q, n, k[stage]);
        }
        for (i = 0; i < n; i++) {
            const uint32_t who = number[i];
            const double *v = k[0][i];
            const double speed = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
            if (!(speed >= (double)t->d->min_speed * (double)t->d->min_speed)) {
                end[who] = TETCAST_TRACE_SLOW;
                continue;
            }
            for (a = 0; a < 3; a++)
                p[i][a] += t->d->stepper == TETCAST_STEPPER_EULER ? dt * v[a]
                    : dt / 6.0 * ((k[0][i][a] + k[3][i][a]) + 2.0 * (k[1][i][a] + k[2][i][a]));
            memcpy(t->paths + (first + who) * row + 3 * ((size_t)s + 1), p[i], sizeof p[i]);
            length[who] = s + 2;
            if (!tetcasti_rbf_inside(t->m, p[i])) {
                end[who] = TETCAST_TRACE_LEFT;
                continue;
            }
            if (left != i) memcpy(p[left], p[i], sizeof p[i]);
            number[left++] = who;
        }
        n = left;
    }
    for (i = 0; i < some; i++) {
        if (t->lengths != NULL) t->lengths[first + i] = length[i];
        if (t->ends != NULL) t->ends[first + i] = (tetcast_trace_end)end[i];
    }
}

TETCAST_DEF tetcast_result tetcast_rbf_trace(const tetcast_rbf_trace_desc *desc, const tetcast_rbf *rbf,
                                             const double *seeds, size_t count, double *paths, uint32_t *lengths,
                                             tetcast_trace_end *ends) {
    tetcasti_rbf_traces t;
    tetcasti_mem mem;
    tetcast_result r;
    size_t size;
    if (desc == NULL || rbf == NULL || (count != 0 && (seeds == NULL || paths == NULL))) return TETCAST_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return TETCAST_ERR_UNINIT_DESC;
    r = tetcasti_env_open(&desc->env, &mem);
    if (r != TETCAST_OK) return r;
    if (rbf->components != 3 || desc->dt == 0.0 || !tetcasti_finite(desc->dt) || desc->steps == 0 ||
        desc->steps > 0x7fffffffu || !(desc->min_speed >= 0.0f) || (uint32_t)desc->stepper > TETCAST_STEPPER_EULER)
        return tetcasti_fail(desc->env.error, TETCAST_ERR_INVALID_ARG, 0, "trace: a number or an enum is out of range");
    if (!tetcasti_mul_size(count, 24, &size) || !tetcasti_mul_size(size, (size_t)desc->steps + 1, &size) ||
        count / 8 >= 0x7fffffffu) return TETCAST_ERR_RANGE;
    t.d = desc;
    t.m = rbf;
    t.add = tetcasti_rbf_add_pick(rbf, tetcasti_rbf_isa(desc->isa));
    t.seeds = seeds;
    t.count = count;
    t.paths = paths;
    t.lengths = lengths;
    t.ends = ends;
    tetcasti_parallel_for(&desc->env, tetcasti_task_rbf_trace, &t, (uint32_t)((count + 7) / 8));
    return TETCAST_OK;
}
#endif /* TETCAST_NO_RBF */
/* ---------------------------------------------------------------------------
   misc: names and versions.                                                     // >>misc
   --------------------------------------------------------------------------- */

TETCAST_DEF const char *tetcast_result_string(tetcast_result result) {
    switch (result) {
#define TETCASTI_X(name, value, text) case TETCAST_##name: return text;
    TETCAST_RESULT_LIST(TETCASTI_X)
#undef TETCASTI_X
    case TETCAST_RESULT_FORCE_32BIT: break;
    }
    return "unknown result";
}

TETCAST_DEF uint32_t tetcast_version(void) { return TETCAST_VERSION; }

TETCAST_DEF const char *tetcast_isa_name(tetcast_isa isa) {
    switch (isa) {
    case TETCAST_ISA_AUTO: return "auto";
    case TETCAST_ISA_SCALAR: return "scalar";
    case TETCAST_ISA_SSE: return "sse";
    case TETCAST_ISA_AVX2: return "avx2";
    case TETCAST_ISA_AVX512: return "avx512";
    case TETCAST_ISA_FORCE_32BIT: break;
    }
    return "unknown";
}

TETCAST_DEF tetcast_isa tetcast_isa_best(void) {
    int level = tetcasti_cpu_level();
    if (level >= 3 && TETCASTI_AVX2) return TETCAST_ISA_AVX2;
    return level >= 2 ? TETCAST_ISA_SSE : TETCAST_ISA_SCALAR;
}

#ifdef __cplusplus
}
#endif
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC pop_options
#endif
#endif /* TETCAST_IMPLEMENTATION */

/*
Choose either licence.

MIT License

Copyright (c) 2026 the tetcast authors

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.

Unlicense: This is free and unencumbered software released into the public domain. Anyone is free to copy, modify,
publish, use, compile, sell, or distribute this software, either in source code form or as a compiled binary, for any
purpose, commercial or non-commercial, and by any means. For more information, see https://unlicense.org
*/
