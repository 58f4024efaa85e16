/* zbufrand.h - v0.2.0 - randomized z-buffer: pictures of 1 to 10^13 triangles - MIT OR Unlicense, see end of file
   SPDX-License-Identifier: MIT OR Unlicense

   CONTENTS
   The declarations come first. Sections of the implementation, to be found by searching for >>name:
   @platform       compiler, instruction sets, asserts, bytes
   @memory         every byte comes from here
   @threads        one parallel-for
   @math           small vectors, own polynomials (libm differs between platforms), Morton codes
   @core           camera, key buffer, random numbers
   @scene          the graph as the caller made it, its checks, and how it is cut into structures
   @cluster        triangles -> clusters -> tree -> stored points
   @lists          the thesis' trees: fair-split tree, octree, classes of normals, tree over normals
   @veil           transparency: what of a material a pixel does not show in a frame
   @raster         exact z-buffer rasteriser for the triangles of a cluster
   @occlusion      largest depth per tile of the key buffer
   @rays           closest hit of a ray through structures and their instances
   @select         the cut through the trees of a view
   @sample         draws -> keys
   @listed         the cut through the thesis' trees by its rules; draws from distribution lists
   @zbuffer        every triangle of a scene through the rasteriser
   @reconstruct    from keys to a picture
   @accumulate     means of frames, smoothing, noise, reprojection
   @theory         sample counts, success probabilities, the law of a pixel
   @shade          numbers of samples that are seen -> surfaces -> colours
   @render         cameras
   @costs          what raster and samples take on this machine
   @query          what a picture would be made of: the cut as a list, samples as a stream
   @points         any number of random points of a surface, in random order
   @edit           nodes are added, removed and moved in a scene that is built
   @misc           names and versions

   DO THIS
   In one C or C++ file, and only there:
       #define ZBUFRAND_IMPLEMENTATION
       #include "zbufrand.h"
   and #include "zbufrand.h" without the macro wherever else you use it. Link with -lm -lpthread.
   -ffp-contract=off on the command line is a second guard for equal bits on all machines (see DETERMINISM).

   A PROGRAM (examples/minimal_zbufrand.c; png.h beside it writes the picture)

    #include "support/png.h"
    #define ZBUFRAND_IMPLEMENTATION
    #include "zbufrand.h"

    enum { N = 96, WIDTH = 800, HEIGHT = 500 };
    static float position[N * N][3];
    static uint8_t color[N * N][3], pixels[WIDTH * HEIGHT][4];
    static uint32_t triangle[N * N * 2][3];
    static zbufrand_transform places[4][100]; // of each level of 10 x 10: borrowed until the scene is built

    static void make_torus(void) {
        for (uint32_t i = 0; i < N * N; i++) {
            const uint32_t up = i / N * N + (i + 1) % N, right = (i + N) % (N * N), both = (up + N) % (N * N);
            const uint32_t corners[6] = {i, up, both, i, both, right};
            const float a = 6.2831853f / N * (float)(i / N), b = 6.2831853f / N * (float)(i % N);
            const float r = 1.0f + 0.4f * cosf(b), p[3] = {r * cosf(a), 1.4f + r * sinf(a), 0.4f * sinf(b)};
            memcpy(position[i], p, sizeof p);
            memcpy(triangle[2 * i], corners, sizeof corners);
            for (int k = 0; k < 3; k++) color[i][k] = (uint8_t)(160.0f + 90.0f * sinf(a + 2.0f * (float)k));
        }
    }

    int main(int argc, char **argv) {
        const zbufrand_mesh mesh = {.positions = position[0], .vertex_count = N * N, .vertex_rgb = color[0],
                                    .indices = triangle[0], .triangle_count = 2 * N * N};
        const zbufrand_render_desc render = {.camera = {.eye = {9, 14, 40}, .at = {0, 0, -5}},
                                             .background = {0.5f, 0.6f, 0.75f, 1.0f}};
        const zbufrand_image image = {.width = WIDTH, .height = HEIGHT, .rgba8 = pixels[0]};
        zbufrand_scene *scene = NULL;
        zbufrand_frame *frame = NULL;
        zbufrand_node node = 0;
        sup_error err;

        make_torus();
        zbufrand_result result = zbufrand_scene_create(NULL, &scene);
        if (result == ZBUFRAND_OK)
            result = zbufrand_add_mesh(scene, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &mesh, &node);
        for (int level = 0; level < 4 && result == ZBUFRAND_OK; level++) { // a list of 100 references to what is there
            const zbufrand_node target = node;
            const double step = 4.0 * pow(10.0, level);
            for (int i = 0; i < 100; i++) {
                const double x = step * (i % 10 - 4.5), z = step * (i / 10 - 4.5);
                const zbufrand_transform move = {{{1, 0, 0, x}, {0, 1, 0, 0}, {0, 0, 1, z}}};
                places[level][i] = move;
            }
            result = zbufrand_add_list(scene, ZBUFRAND_ROOT, NULL, level < 3 ? ZBUFRAND_HIDDEN : 0, &node);
            if (result == ZBUFRAND_OK) result = zbufrand_add_references(scene, node, places[level], 100, target, NULL);
        }
        if (result == ZBUFRAND_OK) result = zbufrand_scene_build(scene, NULL, NULL);
        if (result == ZBUFRAND_OK) result = zbufrand_frame_create(NULL, &frame);
        if (result == ZBUFRAND_OK) result = zbufrand_render(frame, &render, scene, &image, NULL);
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);

        if (result != ZBUFRAND_OK) (void)sup_fail(&err, "%s", zbufrand_result_string(result));
        else if (!sup_png_write8(argc > 1 ? argv[1] : "zbufrand.png", pixels[0], WIDTH, HEIGHT, 4, &err)) return 0;
        fprintf(stderr, "%s\n", err.text);
        return 1;
    }

   WHAT IT DOES
   - Draws scenes of any number of triangles in time that hardly depends on the number: random points of their surfaces,
     as dense in the picture as it takes, compete in a z-buffer.
   - Scenes are graphs of meshes, lists and references with similarity transforms; references may nest, so that some
     megabytes stand for 10^13 triangles.
   - Says with which probability the picture is complete, and keeps it: `tolerance`. Averages frames until the noise is
     below a given error: `noise`. Draws pictures larger and averages their pixels: `oversample`.
   - Rasterises exactly what is cheaper to rasterise, culls what lies behind, repairs empty and wrong pixels by rays.
   - Reconstructs pictures from points as the thesis that it comes from does: pixels, colour blocks of any size,
     Gaussian, Voronoi regions, without depth buffer; and by pull-push, layered coverage, buckets against bleeding.
   - Draws point clouds; gives random points of surfaces; has the theory of sample counts as functions.
   - Has the thesis' own trees and rules beside its own: fair-split tree, octree, classes of normals, tree over normals.

   WHAT FOR WHAT
   a scene                    zbufrand_scene_create, zbufrand_add_*; then zbufrand_scene_build
   a picture of it            zbufrand_frame_create once, then zbufrand_render for each picture
   no hole in the picture     zbufrand_render_desc.tolerance; what was reached: zbufrand_stats.incomplete
   less noise, smooth edges   noise (a mean of frames), oversample
   own colours                zbufrand_render_desc.shade_fn; transparency: opacity
   a scene that changes       zbufrand_move, zbufrand_set_reference, zbufrand_remove; then zbufrand_scene_update
   own samples, point clouds  zbufrand_canvas_*, zbufrand_layers_*; zbufrand_render_desc.points
   what a picture is made of  zbufrand_select, zbufrand_sample_scene
   means of own frames        zbufrand_accumulator_*
   random points of surfaces  zbufrand_surface_points
   how many samples it takes  zbufrand_samples, zbufrand_density, zbufrand_success and what follows them
   the thesis' way to draw    zbufrand_build_desc.structure, zbufrand_preset_thesis

   WHAT IT DOES NOT DO
   - No refraction, no shadows, no textures: colours come per vertex, per triangle or from a callback. Transparency is
     by chance, per material and pixel: one frame is speckled, the mean of frames blends.
   - No mesh files, no picture files: examples/support has readers, a PNG writer and a command line.
   - Of one scanned statue or a big wall it makes what a rasteriser makes, by rasterising: samples gain nothing there.

   LIMITS
   triangles of a scene       2^64 - 1 drawn; stored as many as memory holds, 2^28 in a mesh
   nodes of a scene           2^30
   levels of references       64
   size                       corners up to 1e15 from the middle of their structure (see ACCURACY), others are left out;
                              surfaces of 1e-34 to 3e38 square units, as areas are floats
   samples of a frame         2^32
   picture                    of a scene 32000 a side; of samples 65535 a side and 2^31 pixels
   threads                    64
   stack                      less than 16 KB in one function, less than 64 KB in all; 2 KB more for each level of
                              references beyond 8

   OPTIONS
   macro                       meaning                                                  default       same in all files?
   ZBUFRAND_IMPLEMENTATION     emit the code, in exactly one file                       off           no
   ZBUFRAND_STATIC             all functions static; only where the code is             off           no
   ZBUFRAND_DEF                what stands before declarations                          extern/static yes
   ZBUFRAND_MALLOC(size,user)  default allocator, 16-byte aligned; both or neither      malloc        code only
   ZBUFRAND_FREE(ptr,size,user) its other half                                           free          code only
   ZBUFRAND_ASSERT(cond)       internal checks; there are none in this version          assert        code only
   ZBUFRAND_NO_STDIO           no <stdio.h>; there are no functions with file names     off           yes
   ZBUFRAND_NO_THREADS         never start a thread; env.parallel still works           off, wasm: on code only
   ZBUFRAND_NO_SIMD            scalar code only                                         off           code only
   ZBUFRAND_NO_AVX2            no AVX2                                                  off           code only
   ZBUFRAND_ALLOW_FAST_MATH    accept -ffast-math; nothing is promised then             #error        code only
   No macro changes a struct. The instruction set is chosen when the program runs; desc.isa can lower it.

   MEMORY
   All of it comes through desc.env: its allocator, else ZBUFRAND_MALLOC, else malloc. An object keeps its allocator
   until it is destroyed. env.memory_limit bounds what one call and its results hold at once, that of a scene or a frame
   all that it ever holds. When memory runs out a call frees what it had and returns ZBUFRAND_ERR_NO_MEMORY.

   THREADS
   A call uses env.thread_count threads (0: one per core; 1: never more than the caller's), started and joined within
   the call, with stacks of 512 KB. env.parallel hands the work to the host's job system instead. A built scene may
   be drawn by any number of threads at once, each with a frame of its own. There is no global state. WebAssembly
   has threads with -pthread only. Where there is no <pthread.h> (MSVC's cl and clang-cl) define ZBUFRAND_NO_THREADS.
   clang-cl can use all cores by env.parallel. This file has no atomics for compilers that are neither gcc nor clang,
   as cl is: with those an env.parallel has to run one task after the other, and samples of a canvas or of layers come
   from one thread at a time.

   DETERMINISM
   The same input gives the same bits: for any number of threads, any instruction set; with gcc or clang at any
   optimisation. Random numbers are functions of (seed, frame, place), minima do not depend on an order, sums have a
   fixed one; fused multiply-add is switched off (by pragmas in this file). x87 code (-m32 without -mfpmath=sse),
   -std=c99 on s390x (without -fexcess-precision=fast) and -ffast-math break it.

   ERRORS
   Functions that can fail return a zbufrand_result. When they fail, objects, sizes and numbers that they would have
   given are NULL or 0; arrays and pictures may be half written. env.error (of the scene, frame or canvas) receives the
   place (node, triangle) and a sentence; it is not written when a desc was not zeroed, when a pointer is NULL, nor by
   functions that many threads may call at once for one object. Degenerate and non-finite triangles are left out and
   counted. A desc has to be zeroed (memset, = {0} or = {} in C++); zbufrand checks its first and last member. The
   library never prints, never exits.

   CONTRACTS
   The comment of a function says what is special about it. Where it is silent: a pointer may be NULL only if that is
   said; arrays are borrowed for the call and do not overlap; what is handed out by pointer belongs to the object and
   lasts until that is changed or destroyed; what a create, build, load or copy function gives is freed by the destroy
   function of its type. Wrong arguments are INVALID_ARG, a desc that was not zeroed UNINIT_DESC; functions that return
   no result cannot fail. A call may use an object that it takes as const at the same time as any number of others; one
   that is not const is for one call at a time, alone. Calls without a common object are independent. Time is in
   proportion to what is read and written, outputs that are not arrays of the caller are the only memory that stays.
   What names no source is ours.

   COORDINATES AND UNITS
   Right-handed world, any unit, in doubles. Triangles are counter-clockwise seen from outside. Row 0 of a picture is on
   top, pixel (i, j) covers [i, i+1) x [j, j+1); fov_y is the vertical angle; depth is the distance along the viewing
   axis. Colours: bytes are sRGB, floats are linear; rgba is premultiplied, rgba8 is not.

   ACCURACY
   Places       Transforms are doubles. Each structure keeps its corners as floats relative to an origin of its own, so
                that nothing is lost far away from 0; a vertex has the same three floats in all of its triangles.
   Complete     With probability 1 - tolerance no pixel is empty, or 1 % deeper than it should be, where surfaces cover
                it and those around it as a whole. zbufrand_stats.incomplete is the bound for what was drawn; both hold
                for opaque surfaces, without `comb`, and while rays may repair. What is rastered misses nothing.
   Noise        A pixel of one frame shows one surface, by chance among those that are in it. zbufrand_stats.rmse of a
                mean of frames is an estimate, not a bound.
   From afar    What is small in the picture is shown by stored points, which lie on a lattice of 2048 x 1024 x 1024
                places in their box; their normals are off by less than 7e-5.
   Theory       The functions compute in double; each says how exact its formula is.

   REFERENCES
   M. Wand: Das randomisierte z-Buffer-Verfahren. Diplomarbeit, Univ. Paderborn, 2000 (`the thesis')
   M. Wand et al.: The Randomized z-Buffer Algorithm: Interactive Rendering of Highly Complex Scenes. SIGGRAPH 2001
   N. Greene, M. Kass, G. Miller: Hierarchical Z-Buffer Visibility. SIGGRAPH 1993
   M. van Herk: A fast algorithm for local minimum and maximum filters. Pattern Recognition Letters 13, 1992
   P. Felzenszwalb, D. Huttenlocher: Distance Transforms of Sampled Functions. Theory of Computing 8, 2012
   R. Motwani, P. Raghavan: Randomized Algorithms. Cambridge, 1995 (occupancy)
   G. Steele, D. Lea, C. Flood: Fast Splittable Pseudorandom Number Generators. OOPSLA 2014 (hash of 64 bits)
   docs/algorithms.md says which equation is where, and what was corrected. */
#ifndef ZBUFRAND_H_INCLUDED
#define ZBUFRAND_H_INCLUDED
#include <stddef.h>
#include <stdint.h>

#define ZBUFRAND_VERSION_MAJOR 0
#define ZBUFRAND_VERSION_MINOR 2
#define ZBUFRAND_VERSION_PATCH 0
#define ZBUFRAND_VERSION (ZBUFRAND_VERSION_MAJOR * 1000000 + ZBUFRAND_VERSION_MINOR * 1000 + ZBUFRAND_VERSION_PATCH)


#ifndef ZBUFRAND_DEF
#  ifdef ZBUFRAND_STATIC
#    if defined(__GNUC__) || defined(__clang__)
#      define ZBUFRAND_DEF static __attribute__((unused))
#    else
#      define ZBUFRAND_DEF static
#    endif
#  else
#    define ZBUFRAND_DEF extern
#  endif
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* ---- results, memory, threads ---- */

#define ZBUFRAND_RESULT_LIST(X) \
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
    X(ERR_EMPTY, 10, "nothing to build: no usable triangle") \
    X(ERR_CHECKSUM, 11, "checksum mismatch: the data is damaged")

typedef enum zbufrand_result {
#define ZBUFRANDI_X(name, value, text) ZBUFRAND_##name = value,
    ZBUFRAND_RESULT_LIST(ZBUFRANDI_X)
#undef ZBUFRANDI_X
    ZBUFRAND_RESULT_FORCE_32BIT = 0x7fffffff
} zbufrand_result;

/* What went wrong and where. `where` is a node, a triangle or another number, as `text` says, 0 where there is none. Of
   use after a failure only: calls that succeed leave it as it was. */
typedef struct zbufrand_error {
    zbufrand_result code;
    uint64_t where;
    char text[200];
} zbufrand_error;

typedef struct zbufrand_allocator { /* both functions or none of them */
    void *(*alloc_fn)(size_t size, void *user); /* 16-byte aligned, or NULL; any thread */
    void (*free_fn)(void *ptr, size_t size, void *user);
    void *user;
} zbufrand_allocator;

typedef void zbufrand_task_fn(void *task_ctx, uint32_t index);
typedef struct zbufrand_parallel { /* run task(ctx, i) once for each i in [0, count), return when all are done */
    void (*for_fn)(zbufrand_task_fn *task, void *task_ctx, uint32_t count, void *user);
    void *user;
} zbufrand_parallel;

/* Where memory, threads and messages come from; part of every desc. All zero: malloc, one thread per core,
   no limit, silent. Objects that are made with it keep it: what it points to has to live as long as they do. */
typedef struct zbufrand_env {
    zbufrand_allocator allocator;
    zbufrand_parallel parallel;  /* set: the host's job system runs the work, no thread is started */
    uint32_t thread_count;    /* 0: one per core; 1: never start a thread */
    size_t memory_limit;      /* bytes that one call and its results may hold at once; 0: none */
    /* non-zero cancels. Called by the functions that return CANCELLED; by any thread of the call, never two at once */
    int (*progress_fn)(void *user, uint64_t done, uint64_t total);
    void *progress_user;
    zbufrand_error *error;       /* receives the place and the reason of a failure; may be NULL */
} zbufrand_env;

typedef enum zbufrand_isa {
    ZBUFRAND_ISA_AUTO = 0,
    ZBUFRAND_ISA_SCALAR = 1,
    ZBUFRAND_ISA_SSE = 2,
    ZBUFRAND_ISA_AVX2 = 3,
    ZBUFRAND_ISA_AVX512 = 4,
    ZBUFRAND_ISA_FORCE_32BIT = 0x7fffffff
} zbufrand_isa;

/* ---- scenes ---- */

/* Triangles of a base object. Borrowed until the zbufrand_scene_build or zbufrand_scene_update that takes it in has
   returned; another zbufrand_scene_build reads it again. */
typedef struct zbufrand_mesh {
    const float *positions;        /* xyz per vertex, any unit */
    size_t vertex_count;
    size_t position_stride;        /* bytes, 0: 12 */
    /* 3 per triangle, counter-clockwise seen from outside; NULL: vertices 3i, 3i+1, 3i+2 */
    const uint32_t *indices;
    size_t triangle_count;
    const float *normals;          /* xyz per vertex for shading, need not be unit; NULL: the triangle's own normal */
    size_t normal_stride;          /* bytes, 0: 12 */
    const uint8_t *vertex_rgb;     /* sRGB bytes per vertex, interpolated in linear light; or NULL */
    size_t vertex_rgb_stride;      /* bytes, 0: 3 */
    const uint8_t *triangle_rgb;   /* sRGB bytes, 3 per triangle, wins over vertex_rgb; or NULL */
    uint32_t two_sided;            /* 1: seen from both sides (leaves, open meshes); 0: back faces are not drawn */
    uint32_t material;             /* handed to the shading callback */
} zbufrand_mesh;

/* A node of the scene graph: a list of nodes, a mesh, or references to a node. 0 is no node. */
typedef uint32_t zbufrand_node;
#define ZBUFRAND_ROOT 1u           /* the list that every scene starts with: what is drawn */

/* Node to parent: p' = m * (p, 1). A similarity: rotation, mirror, translation, uniform scale other than 0. */
typedef struct zbufrand_transform {
    double m[3][4];
} zbufrand_transform;

enum { /* flags of a node */
    ZBUFRAND_HIDDEN = 1,           /* not drawn where it stands, only through references: a prototype */
    ZBUFRAND_OWN_STRUCTURE = 2     /* a structure of its own, as if it were referenced: its coordinates keep their
                                      precision however large the scene is */
};

typedef struct zbufrand_scene zbufrand_scene;

typedef struct zbufrand_scene_desc {
    uint32_t _begin_zero;
    zbufrand_env env;              /* for all calls on this scene; what it points to has to live as long as the scene */
    uint32_t _end_zero;
} zbufrand_scene_desc;

/* An empty scene: the root list and nothing in it.
   desc       in, NULL: all defaults
   out_scene  receives the scene; zbufrand_scene_destroy frees it
   Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY. O(1). */
ZBUFRAND_DEF zbufrand_result zbufrand_scene_create(const zbufrand_scene_desc *desc, zbufrand_scene **out_scene);
ZBUFRAND_DEF void zbufrand_scene_destroy(zbufrand_scene *scene); /* NULL is fine */

/* Add a node and put it into the list `parent`. With parent 0 it is in no list yet: zbufrand_list_append does that.
   transform  NULL: identity. Copied
   flags      ZBUFRAND_HIDDEN, ZBUFRAND_OWN_STRUCTURE
   mesh       the struct is copied, its arrays are borrowed until zbufrand_scene_build has returned
   target     a list, a mesh or references; has to be in a list when the scene is built, need not be drawn there. What
              the reference stands for is the target in its own coordinates: the transform of the reference takes the
              place of the target's
   out_node   may be NULL; set to 0 on failure
   A node is in at most one list; no path of lists and references may lead back to where it started. What a node is
   added to may already have been built: the next zbufrand_scene_build takes it in.
   Errors: INVALID_ARG (no such node, parent is not a list, no similarity: columns of equal length and at right angles
   within 1e-5, numbers below 1e150; unknown flags; a NULL array, a stride below the size of its element, triangles
   without indices and with too few vertices; env.error names the node), RANGE (more than 2^30 nodes; a mesh of more
   than 2^28 triangles or 2^32 - 1 vertices), NO_MEMORY. O(1) amortised. Thread safety: one thread at a time per
   scene. */
ZBUFRAND_DEF zbufrand_result zbufrand_add_list(zbufrand_scene *scene, zbufrand_node parent,
                                               const zbufrand_transform *transform, uint32_t flags,
                                               zbufrand_node *out_node);
ZBUFRAND_DEF zbufrand_result zbufrand_add_mesh(zbufrand_scene *scene, zbufrand_node parent,
                                               const zbufrand_transform *transform, uint32_t flags,
                                               const zbufrand_mesh *mesh, zbufrand_node *out_node);
ZBUFRAND_DEF zbufrand_result zbufrand_add_reference(zbufrand_scene *scene, zbufrand_node parent,
                                                    const zbufrand_transform *transform, zbufrand_node target,
                                                    zbufrand_node *out_node);

/* One node that refers to `target` count times, with the transforms [count], which are borrowed until
   zbufrand_scene_build has returned. The same result as count calls of zbufrand_add_reference, with less memory. A
   transform that is no similarity is found by the build. Errors: as above. */
ZBUFRAND_DEF zbufrand_result zbufrand_add_references(zbufrand_scene *scene, zbufrand_node parent,
                                                     const zbufrand_transform *transforms, size_t count,
                                                     zbufrand_node target, zbufrand_node *out_node);

/* Put a node that is in no list into one. O(1). Errors: INVALID_ARG (no such list or node; it is in a list already, or
   is the root; env.error names it), NO_MEMORY. */
ZBUFRAND_DEF zbufrand_result zbufrand_list_append(zbufrand_scene *scene, zbufrand_node list, zbufrand_node node);

/* By which tree the surface is sampled. The default is a tree of nodes of eight with cones of normals over clusters of
   triangles. The others stand beside it and are those of the thesis: distribution lists, from which a triangle is drawn
   by its area below any node. The default is faster; they take less for granted (no stored points, any rule of
   selection), and reproduce the thesis. */
typedef enum zbufrand_structure {
    ZBUFRAND_STRUCTURE_DEFAULT = 0,
    ZBUFRAND_STRUCTURE_FAIR_SPLIT = 1, /* binary: boxes halved at the middle of their longest side (its program) */
    ZBUFRAND_STRUCTURE_OCTREE = 2,     /* with shortcuts; triangles stay in cells of their size (its analysis) */
    ZBUFRAND_STRUCTURE_CLASSES = 3,    /* a fair-split tree for each class of normals (its program) */
    ZBUFRAND_STRUCTURE_NORMALS = 4,    /* quadtree over normals, an octree in each node (only analysed there) */
    ZBUFRAND_STRUCTURE_FORCE_32BIT = 0x7fffffff
} zbufrand_structure;

/* field          zero means
   seed           0 is a seed like any other: of the points that are stored with the structures
   strict         0: triangles that are degenerate, not finite or have bad indices are left out and counted;
                  1: they are an error, env.error says which
   ids            0: which triangle of its mesh a stored triangle was is forgotten; 1: kept, 4 bytes per triangle
   structure      the default tree. Others: about 16 bytes per triangle more; normals: about 24 times its levels
   leaf_objects   64: most objects of a leaf of the thesis' trees, 1..1024
   leaf_ratio     the root of that: a leaf may be so much wider than its largest object
   tolerance_zone 1.5: a cell takes what lies within it enlarged by this, 1..2; larger objects stay above
   normal_depth   classes 4: so many fair splits of longitude and colatitude, 16 classes; normals 4: levels of their
                  tree; the others 0: no classes; 1..8
   normal_grid    none. k: a regular grid of k x 2k classes instead, k <= 64; not for normals */
typedef struct zbufrand_build_desc {
    uint32_t _begin_zero;
    uint32_t seed;
    uint32_t strict;
    uint32_t ids;
    zbufrand_structure structure;
    uint32_t leaf_objects;
    float leaf_ratio;
    float tolerance_zone;
    uint32_t normal_depth, normal_grid;
    uint32_t _end_zero;
} zbufrand_build_desc;

typedef struct zbufrand_scene_info {
    uint64_t triangles;            /* drawn: instances counted as often as they occur */
    uint64_t stored_triangles;
    uint64_t stored_vertices;      /* as the clusters hold them */
    uint64_t instances;            /* stored; drawn ones are not counted */
    uint64_t clusters, tree_nodes;
    uint32_t structures;
    uint32_t levels;               /* of instances: 0: none */
    uint64_t skipped_triangles;    /* degenerate, not finite or bad indices */
    double area;                   /* of all drawn triangles, in world units */
    double box_min[3], box_max[3]; /* world; min > max when the scene is empty */
    uint64_t list_objects, list_nodes, list_classes; /* of the thesis' trees; 0: none */
    size_t list_bytes;             /* of `bytes`: what those trees hold */
    size_t bytes;                  /* held by the structures */
    size_t peak_bytes;             /* while they were built */
} zbufrand_scene_info;

/* Build the structures: everything that zbufrand_render and its relatives read.
   desc   in, NULL: all defaults
   info   out, may be NULL
   A scene may be built again after nodes were added. An empty scene is fine; it draws nothing.
   Errors: UNINIT_DESC, NO_MEMORY, CANCELLED (env.progress_fn is asked behind each structure), RANGE (more than
   2^64 - 1 triangles, 2^28 clusters and instances, 2^32 - 1 triangles or vertices in a structure, or 64 levels of
   instances; an instance further than 1e15 from the middle of what it is in, or that with all lists around it is no
   similarity within 1e-4, or has a scale outside of 1e-150 to 1e150; for the thesis' trees 2^29 objects or 2^24
   clusters in a structure),
   INVALID_ARG: a field of those is wrong, or env.error names the node that closes a cycle, the reference whose target
   is in no list, or with `strict` the bad triangle. On failure (but UNINIT_DESC) the scene is as if never built.
   Cost: O(n log n), about 0.15 us per stored triangle and 0.5 us per instance; about 20 bytes per stored triangle, 400
   per instance, and 60 to 600 KB for what is drawn 32 times and more, in all at most 64 MB and what stored points
   take. The thesis' trees take 0.2 us per triangle more, the tree over normals 1 us.
   Thread safety: one thread at a time per scene. The same structures for any number of threads. */
ZBUFRAND_DEF zbufrand_result zbufrand_scene_build(zbufrand_scene *scene, const zbufrand_build_desc *desc,
                                                  zbufrand_scene_info *info);

/* What the last build or update made; all zero if there was none, or no scene. O(1). */
ZBUFRAND_DEF void zbufrand_scene_get_info(const zbufrand_scene *scene, zbufrand_scene_info *info);

/* ---- editing a scene that is built ----

   Nodes are added (zbufrand_add_*, zbufrand_list_append), moved and removed; zbufrand_scene_update takes all that was
   done since the last build or update into the structures. Pictures show the scene as it was until then.

       zbufrand_move(scene, car, &there);
       zbufrand_remove(scene, tree);
       zbufrand_add_reference(scene, ZBUFRAND_ROOT, &here, model, &another);
       zbufrand_scene_update(scene, NULL);

   One thread at a time per scene. */

/* Give a list, a mesh or a reference another place. Of several references (zbufrand_add_references) all move together.
   transform  node to parent, in place of the one that it has; NULL: identity. Copied
   Errors: INVALID_ARG (no such node, the root, no similarity), NO_MEMORY. O(1). */
ZBUFRAND_DEF zbufrand_result zbufrand_move(zbufrand_scene *scene, zbufrand_node node,
                                           const zbufrand_transform *transform);

/* Give one of the references of a zbufrand_add_references another transform.
   node       is part of what was built
   index      below the count of the node
   transform  NULL: this reference is not drawn until it gets another transform
   The array of the caller is not written to: a new zbufrand_scene_build reads it as it is then.
   Errors: INVALID_ARG (also a node that is not yet built, or is one of zbufrand_add_reference), NO_MEMORY. O(1). */
ZBUFRAND_DEF zbufrand_result zbufrand_set_reference(zbufrand_scene *scene, zbufrand_node node, size_t index,
                                                    const zbufrand_transform *transform);

/* Take a node out of its list, with everything in it. Its number, and those of all nodes in it, are errors from now on
   (until they are given to new nodes, at the earliest after a thousand others).
   Errors: INVALID_ARG (no such node, the root, something that stays refers to it: env.error names what to),
   NO_MEMORY. O(nodes removed). */
ZBUFRAND_DEF zbufrand_result zbufrand_remove(zbufrand_scene *scene, zbufrand_node node);

/* Take edits into the structures without building them anew.
   info  out, may be NULL; only written on success
   What is added becomes a structure of its own, as if it had ZBUFRAND_OWN_STRUCTURE: put small meshes that come
   together into one list. The arrays of its meshes are borrowed until this has returned. A list or mesh that is moved
   for the first time becomes a structure, too; the picture stays the same but for chance.
   Errors: EMPTY (the scene was never built), INVALID_ARG (env.error names what closes a cycle, a reference whose target
   is in no list, a bad triangle with `strict`), RANGE (levels of instances, places), NO_MEMORY. On failure the scene is
   drawn as before; the edits are kept, so that the call can be made again. Counts of triangles stop at 2^64 - 1. The
   trees of the thesis, if there are any, are dropped, also by some of the failures: the default tree is used until the
   next build.
   Cost: moving, removing or adding a reference: O(depth of the trees above), some 10 us; a structure used by many
   instances costs as many of them. New triangles: as in a build. The first update after a build looks at all nodes and
   instances once and holds 20 to 30 bytes for each of them from then on. Trees are made anew in parts where they got
   worse. The memory of melted triangles that are removed is given back by the next build.
   The same structures for any number of threads. */
ZBUFRAND_DEF zbufrand_result zbufrand_scene_update(zbufrand_scene *scene, zbufrand_scene_info *info);

/* ---- points of the surface ---- */

/* field          zero means
   seed           0 is a seed like any other
   first          index of the first point: (first 0, count 100) and then (100, 50) give what (0, 150) gives
   independent    0: stratified: every prefix is spread over the surface better than chance; 1: independent points
   vertex_normals 0: normals of the triangles; 1: interpolated vertex normals where a mesh has them */
typedef struct zbufrand_surface_points_desc {
    uint32_t _begin_zero;
    uint32_t seed;
    uint64_t first;
    uint32_t independent;
    uint32_t vertex_normals;
    uint32_t _end_zero;
} zbufrand_surface_points_desc;

/* `count` random points of the whole surface, as many as asked for: density proportional to area, in random order, so
   that any prefix is a fair sample. All arrays are outputs of the caller; all but positions may be NULL.
   positions  xyz, world
   normals    xyz, unit, outward
   rgb        sRGB
   triangles  node of the mesh and index of the triangle within it, 2 numbers per point; the scene has to be built
              with ids
   Errors: INVALID_ARG (also triangles of a scene without ids, and first + count of 2^64), UNINIT_DESC, NO_MEMORY, EMPTY
   (nothing built, or no area), RANGE (areas or places beyond 3e38).
   Cost: O(1) per point and level of references; many points at once are cheapest, 2^20 and more take about 10 ns each,
   0.6 us where each is in another instance. Runs on the calling thread; any number of calls on one scene at once. The
   same points on any machine. */
ZBUFRAND_DEF zbufrand_result zbufrand_surface_points(const zbufrand_scene *scene,
                                                     const zbufrand_surface_points_desc *desc, size_t count,
                                                     float *positions, float *normals, uint8_t *rgb,
                                                     uint32_t *triangles);

/* ---- samples of surfaces ---- */

/* A sample where it falls into the picture, 36 bytes. Samples are told apart by their number: colours are asked for by
   number, and only for samples that are seen. */
typedef struct zbufrand_sample {
    float x, y;             /* pixels from the upper left corner; pixel (i, j) covers [i, i+1) x [j, j+1) */
    float z;                /* depth along the viewing axis, > 0 */
    float slope_x, slope_y; /* how 1/z of its surface changes per pixel to the right and downwards; 0, 0: not known */
    float rgb[3];           /* linear */
    uint32_t flags;         /* ZBUFRAND_SAMPLE_* */
} zbufrand_sample;
enum { ZBUFRAND_SAMPLE_BACK = 1 }; /* its surface is seen from behind */

/* Points in space. Borrowed. */
typedef struct zbufrand_points {
    const float *positions;   /* xyz */
    const float *normals;     /* xyz, any length: give slopes and which side is seen; or NULL */
    const uint8_t *rgb;       /* sRGB; NULL: white */
    size_t position_stride;   /* bytes, 0: 12 */
    size_t normal_stride;     /* bytes, 0: 12 */
    size_t rgb_stride;        /* bytes, 0: 3 */
    size_t count;
} zbufrand_points;

/* Where a picture is taken from. Camera space is x right, y up, z along the view; point (x, y, z) of it is seen at
   center_x + focal x / z, center_y - focal y / z. */
typedef struct zbufrand_view {
    double world_to_camera[3][4]; /* orthonormal rows and a translation */
    double focal;                 /* pixels */
    double center_x, center_y;    /* pixels; the middle of the picture as a rule */
    double near_z, far_z;         /* nothing outside is seen; near_z > 0, far_z 0: no limit */
} zbufrand_view;

/* Project points[first .. first+count). What cannot be seen (depth out of range, not finite) gets z = 0.
   samples  out, [count]
   Any thread. O(count). INVALID_ARG: a range outside the points, no positions, or a view that is not finite, with a
   focal or near_z that is not above 0, or a far_z below 0. */
ZBUFRAND_DEF zbufrand_result zbufrand_project(const zbufrand_view *view, const zbufrand_points *points, size_t first,
                                              size_t count, zbufrand_sample *samples);

/* ---- reconstruction: from samples to a picture ---- */

typedef enum zbufrand_occlusion { /* which samples count as seen */
    ZBUFRAND_OCCLUSION_BLOCKS = 0,      /* each sample covers a block of d x d pixels, the nearest is shown (default) */
    ZBUFRAND_OCCLUSION_CELLS = 1,       /* fixed cells of d x d pixels keep their nearest samples */
    ZBUFRAND_OCCLUSION_SQUARES = 2,     /* a sample is dropped when its own square holds a nearer one */
    ZBUFRAND_OCCLUSION_SQUARES_ALL = 3, /* ... when any sample's square that holds it holds a nearer one, too */
    ZBUFRAND_OCCLUSION_FORCE_32BIT = 0x7fffffff
} zbufrand_occlusion;

typedef enum zbufrand_fill { /* what the pixels between samples show */
    ZBUFRAND_FILL_NONE = 0,       /* nothing more */
    ZBUFRAND_FILL_GAUSS = 1,      /* mean of the samples around, weighted by a Gaussian; smooths all pixels */
    ZBUFRAND_FILL_VORONOI_L1 = 2, /* the nearest sample, |dx| + |dy|: the thesis' growing regions */
    ZBUFRAND_FILL_VORONOI = 3,    /* the nearest sample, exactly Euclidean */
    ZBUFRAND_FILL_PULL_PUSH = 4,  /* smooth interpolation over a pyramid; pixels with samples keep their colour */
    /* as GAUSS, but a sample counts for the area of its Euclidean Voronoi region: an integral instead of a mean. Less
       noise of smooth surfaces, as chance in how densely samples lie is none; more at edges and of fine textures */
    ZBUFRAND_FILL_REGIONS = 5,
    ZBUFRAND_FILL_FORCE_32BIT = 0x7fffffff
} zbufrand_fill;

/* How samples become a picture. The thesis' ways: Algorithm 2: all zero; large colour blocks: block; Algorithm 3:
   cells; Algorithm 4: squares, as its introduction has it, squares_all as it is printed; 5: squares and Gauss; 6:
   squares and Voronoi L1; all of them with tolerance_slope -1.
   field                zero means
   block                1: d, edge of blocks, cells or squares in pixels, 1..1024. Even blocks reach one pixel further
                        to the right and downwards; squares reach floor(d/2) to all sides
   occlusion            blocks
   fill                 none
   reach                pictures of scenes: 2 block; others: fills go as far as they can. r: not further than about r
                        pixels from a sample
   gauss_radius         2, or block if that is more: c of exp(-(1.5 r / c)^2), a standard deviation of 0.471 c; pixels,
                        at most 256
   gauss_support        1: cut off at |dx|, |dy| >= support * c; the Gaussian is 0.105 at 1 and 0.006 at 1.5
   tolerance            cells and squares keep only the nearest. t: also samples up to (1 + t) times as deep
   tolerance_projected  the same on f z / (f + z), f = focal, as in the thesis: up to this value deeper
   focal                1, for tolerance_projected
   tolerance_slope      the same by the sample's slope: up to this times |grad z| d deeper; what any of the three
                        tolerates is kept. 1.5 if none of them is given, or of a surface that is seen at an angle only
                        one edge of each cell or square would be left; below 0: none, as the thesis has it
   tolerance_color      none. t: also samples, however deep, whose linear red, green and blue differ by at most t from
                        those of the nearest in their cell or square: they may be wrong, but one does not see it. Of
                        scenes colours are those of the library's lights, without shade_fn. Up to (2 d)^2 pixels are
                        looked at for each sample that would be dropped
   drop_back            1: samples that are seen from behind do not take part in the fill, though they still hide others
                        (closed surfaces: what a tolerance lets through at silhouettes)
   plane_depth          1: the depth of a pixel is that of the sample's surface at the centre of the pixel, along its
                        slope, instead of the sample's own: parallel surfaces cannot bleed through each other; d <= 32
   repair               1: holes and pixels that show something hidden are found and mended from their neighbours */
typedef struct zbufrand_reconstruct {
    uint32_t block;
    zbufrand_occlusion occlusion;
    zbufrand_fill fill;
    uint32_t reach;
    float gauss_radius, gauss_support;
    float tolerance, tolerance_projected, focal, tolerance_slope, tolerance_color;
    uint32_t drop_back;
    uint32_t plane_depth;
    uint32_t repair;
} zbufrand_reconstruct;

/* What samples look like. Called with numbers of samples that are seen, by several threads at once. */
typedef struct zbufrand_source {
    void (*shade_fn)(void *user, const uint32_t *numbers, size_t count, float *rgba); /* out: linear, premultiplied */
    /* slopes: 2 per sample, as in zbufrand_sample; back: 1 if seen from behind. May be NULL: 0 everywhere */
    void (*surface_fn)(void *user, const uint32_t *numbers, size_t count, float *slopes, uint8_t *back);
    void *user;
} zbufrand_source;

/* Sources of the two kinds of samples there are here: user is an array of zbufrand_sample, or a zbufrand_points (shade
   only); numbers are indices, and whoever submits has to see to it that they are in range. */
ZBUFRAND_DEF void zbufrand_samples_shade(void *user, const uint32_t *numbers, size_t count, float *rgba);
ZBUFRAND_DEF void zbufrand_samples_surface(void *user, const uint32_t *numbers, size_t count, float *slopes,
                                           uint8_t *back);
ZBUFRAND_DEF void zbufrand_points_shade(void *user, const uint32_t *numbers, size_t count, float *rgba);

/* field        zero means
   width,height pixels, 1..65535 each
   reconstruct  one pixel per sample, nothing filled
   bucket_bits  depths are compared exactly. b in 1..22: depths in one bucket of a width of 2^-b to 2^-(b+1) of the
                depth are equal, one sample of the nearest bucket is picked at random: no z-dominance within a bucket.
                Depths of the picture are then off by up to a bucket. Blocks with plane_depth compare exactly */
typedef struct zbufrand_canvas_desc {
    uint32_t _begin_zero;
    zbufrand_env env;
    zbufrand_isa isa;
    uint32_t width, height;
    zbufrand_reconstruct reconstruct;
    uint32_t bucket_bits;
    uint32_t _end_zero;
} zbufrand_canvas_desc;

/* A picture in the making: takes samples from anywhere, in any order. */
typedef struct zbufrand_canvas zbufrand_canvas;

typedef struct zbufrand_submit_stats { /* added to */
    uint64_t accepted;
    uint64_t outside; /* beyond the picture and its guard band */
    uint64_t bad;     /* z not positive and finite, or a position that is not finite */
} zbufrand_submit_stats;

/* Buffers of the caller, width * height, row 0 on top; any may be NULL. */
typedef struct zbufrand_picture {
    float *rgba;      /* linear, premultiplied; alpha 0 where nothing is shown */
    float *depth;     /* INFINITY where nothing is shown */
    uint32_t *number; /* of the sample shown; ~0: none, or a mixture of several */
} zbufrand_picture;

typedef struct zbufrand_resolve_stats {
    uint64_t covered;  /* pixels that show something, before repair */
    uint64_t shaded;   /* samples whose colour was asked for */
    uint64_t holes, wrong; /* pixels repaired; only with reconstruct.repair */
} zbufrand_resolve_stats;

/* desc is needed. All memory is allocated here: 8 to 90 bytes a pixel of the picture and its guard band.
   Errors: INVALID_ARG, UNINIT_DESC, RANGE (also 2^31 pixels with the guard band), NO_MEMORY. O(pixels). */
ZBUFRAND_DEF zbufrand_result zbufrand_canvas_create(const zbufrand_canvas_desc *desc, zbufrand_canvas **out_canvas);
ZBUFRAND_DEF void zbufrand_canvas_destroy(zbufrand_canvas *canvas); /* NULL is allowed */

/* Empty it. seed: another one breaks ties differently and moves the borders of depth buckets. Needs the canvas for
   itself. O(pixels). */
ZBUFRAND_DEF void zbufrand_canvas_clear(zbufrand_canvas *canvas, uint32_t seed);

/* Pixels around the picture in which samples still count (their blocks or filters reach into it): sample the view
   enlarged by that much on each side. O(1). */
ZBUFRAND_DEF uint32_t zbufrand_canvas_guard(const zbufrand_canvas *canvas);

/* Take samples[0..count) with the numbers first_number + i (modulo 2^32; give each sample its own).
   stats  may be NULL; of one thread
   Any number of threads at once; the picture does not depend on the order. Runs on the calling thread, allocates
   nothing. O(count). Errors: INVALID_ARG (also while a picture is being made: callbacks of zbufrand_canvas_resolve
   cannot submit to their own canvas). */
ZBUFRAND_DEF zbufrand_result zbufrand_canvas_submit(zbufrand_canvas *canvas, const zbufrand_sample *samples,
                                                    size_t count, uint32_t first_number,
                                                    zbufrand_submit_stats *stats);

/* The same for points seen from `view`, projected on the way; numbers are first_number + index. */
ZBUFRAND_DEF zbufrand_result zbufrand_canvas_submit_points(zbufrand_canvas *canvas, const zbufrand_view *view,
                                                           const zbufrand_points *points, uint32_t first_number,
                                                           zbufrand_submit_stats *stats);

/* Make the picture. The samples stay: more may be submitted and the picture made again.
   source  shade_fn is needed if picture->rgba or tolerance_color is; surface_fn serves drop_back, tolerance_slope, and
           plane_depth of blocks larger than 1; may be NULL if nothing of that is asked for
   stats   out, may be NULL
   The same bits for any number of threads and any isa. Needs the canvas for itself; allocates only for a repair. If the
   progress_fn of the canvas cancels, the picture is incomplete; the samples stay. O(pixels), with a Gauss or
   tolerances times their size.
   Errors: INVALID_ARG (also while another call makes a picture of this canvas), NO_MEMORY, CANCELLED. */
ZBUFRAND_DEF zbufrand_result zbufrand_canvas_resolve(zbufrand_canvas *canvas, const zbufrand_source *source,
                                                     const zbufrand_picture *picture, zbufrand_resolve_stats *stats);

/* ---- suspicious pixels ---- */

enum {
    ZBUFRAND_SUSPECT_HOLE = 1, /* empty among covered pixels */
    ZBUFRAND_SUSPECT_WRONG = 2 /* shows something clearly behind what its neighbours show on both sides */
};
typedef struct zbufrand_suspect {
    uint32_t pixel; /* y * width + x */
    uint32_t kind;  /* ZBUFRAND_SUSPECT_* */
} zbufrand_suspect;

/* field         zero means
   width,height  1..65535 each
   tolerance     0.01: as deep as the neighbours is what is less than this share deeper; below 1
   hole_count    4: covered pixels of the eight around that make a hole, 1..8
   wrong_count   5: nearer pixels of the eight around, an opposite pair among them, that make a pixel wrong, 2..8;
                 9: off
   hole_rounds   2: holes count as covered in the next round, which finds holes of several pixels; 1..8 */
typedef struct zbufrand_suspect_desc {
    uint32_t _begin_zero;
    zbufrand_env env;
    zbufrand_isa isa;
    uint32_t width, height;
    float tolerance;
    uint32_t hole_count, wrong_count, hole_rounds;
    uint32_t _end_zero;
} zbufrand_suspect_desc;

/* Find pixels that are likely wrong, from a depth picture alone. Background is not suspected, nor what is seen through
   gaps of two pixels and more (but in their corners); gaps of one pixel are.
   depth      in, width * height, INFINITY where nothing is shown
   suspects   out, in the order of pixels; NULL with capacity 0: only count
   out_count  all there are, even if more than capacity, of which only the first are written then
   O(pixels), holds 1 byte a pixel. Errors: INVALID_ARG, UNINIT_DESC, RANGE, NO_MEMORY. */
ZBUFRAND_DEF zbufrand_result zbufrand_find_suspects(const zbufrand_suspect_desc *desc, const float *depth,
                                                    zbufrand_suspect *suspects, size_t capacity, size_t *out_count);

/* Give suspects the mean colour (and 1/z) of those of their eight neighbours that are in front and no suspects; a pixel
   without any stays as it is. Rays do it better.
   rgba    in and out, linear, premultiplied, may be NULL
   depth   in and out
   O(pixels + count), holds 4 bytes a pixel and 40 a suspect. Errors (nothing is changed): INVALID_ARG (also a pixel
   outside, or more suspects than pixels), UNINIT_DESC, RANGE, NO_MEMORY. */
ZBUFRAND_DEF zbufrand_result zbufrand_mend(const zbufrand_suspect_desc *desc, float *rgba, float *depth,
                                           const zbufrand_suspect *suspects, size_t count);

/* ---- layered coverage ----

   Nearest wins shows a front that covers half of a pixel in nearly all frames. Here the samples of a pixel are counted
   by layers of depth instead: since their density is known, the count says which share of the pixel a layer covers;
   the layers are composed front to back. Each colour is the mean of all samples of its layer. The samples have to be
   submitted layers + 1 times:
       do { submit everything } while (zbufrand_layers_next(l)); zbufrand_layers_resolve(l, rgba); */

/* field         zero means
   width,height  1..65535 each
   layers        2; 1..4
   density       (no default) samples per square pixel of projected surface, above 0
   tolerance     0.002: samples up to this share deeper than the nearest belong to its layer (with slopes given their
                 depth at the centre of the pixel is meant); below 1
   dispersion    1: variance over mean of counts, 1 for independent samples, 0.2 to 0.4 for stratified ones */
typedef struct zbufrand_layers_desc {
    uint32_t _begin_zero;
    zbufrand_env env;
    uint32_t width, height;
    uint32_t layers;
    float density;
    float tolerance;
    float dispersion;
    uint32_t _end_zero;
} zbufrand_layers_desc;

typedef struct zbufrand_layers zbufrand_layers;

/* desc is needed. 32 bytes a layer for each pixel. Errors: INVALID_ARG, UNINIT_DESC, RANGE, NO_MEMORY. O(pixels). */
ZBUFRAND_DEF zbufrand_result zbufrand_layers_create(const zbufrand_layers_desc *desc, zbufrand_layers **out_layers);
ZBUFRAND_DEF void zbufrand_layers_destroy(zbufrand_layers *layers); /* NULL is allowed */
ZBUFRAND_DEF void zbufrand_layers_clear(zbufrand_layers *layers);   /* for the next frame */

/* Any number of threads at once, any order; the same samples in each round. Colours are clamped to 0..16 (they are
   summed in units of 2^-16). Samples outside of the picture, or with a z that is not positive and finite, are left out,
   as are all after the last round. Allocates nothing. O(count). Errors: INVALID_ARG. */
ZBUFRAND_DEF zbufrand_result zbufrand_layers_submit(zbufrand_layers *layers, const zbufrand_sample *samples,
                                                    size_t count);

/* End a round. 1: all samples are needed once more; 0: it is done. Not while samples are submitted. O(1). */
ZBUFRAND_DEF int zbufrand_layers_next(zbufrand_layers *layers);

/* Compose. A layer's coverage is pooled over the 3 x 3 pixels where it lies at the same depth, and taken for full when
   it is within two standard deviations of that: edges softer than that are lost, walls have no holes.
   rgba      out, width * height, linear, premultiplied
   coverage  out, `layers` per pixel, front first; may be NULL
   Behind the last round; allocates nothing. O(pixels). Errors: INVALID_ARG. */
ZBUFRAND_DEF zbufrand_result zbufrand_layers_resolve(const zbufrand_layers *layers, float *rgba, float *coverage);

/* ---- several frames ---- */

typedef enum zbufrand_accumulation {
    ZBUFRAND_ACCUMULATE_MEAN = 0,     /* plain mean of all frames (default): the noise falls with their square root */
    ZBUFRAND_ACCUMULATE_SMOOTH = 1,   /* out = (1 - epsilon) out + epsilon frame */
    ZBUFRAND_ACCUMULATE_ADAPTIVE = 2, /* mean of the frames a pixel has been seen for: moved along with the camera,
                                         started anew where the picture changed by more than its noise */
    ZBUFRAND_ACCUMULATE_FORCE_32BIT = 0x7fffffff
} zbufrand_accumulation;

/* field         zero means
   width,height  1..65535 each
   mode          plain mean
   epsilon       0.1: weight of a new frame (smooth), its least weight while the camera moves (adaptive); at most 1
   blur          no limit. b: with views and depths given epsilon is raised so that the trail is at most b pixels long
                 (smooth)
   Adaptive history is kept while depths differ by at most 2 % and colours by at most 4.5 standard deviations. */
typedef struct zbufrand_accumulator_desc {
    uint32_t _begin_zero;
    zbufrand_env env;
    uint32_t width, height;
    zbufrand_accumulation mode;
    float epsilon, blur;
    uint32_t _end_zero;
} zbufrand_accumulator_desc;

typedef struct zbufrand_accumulator zbufrand_accumulator;

/* desc is needed. 32 bytes a pixel, adaptive 72. Errors: INVALID_ARG, UNINIT_DESC, RANGE, NO_MEMORY. O(pixels). */
ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_create(const zbufrand_accumulator_desc *desc,
                                                         zbufrand_accumulator **out_accumulator);
ZBUFRAND_DEF void zbufrand_accumulator_destroy(zbufrand_accumulator *accumulator); /* NULL is allowed */
ZBUFRAND_DEF void zbufrand_accumulator_clear(zbufrand_accumulator *accumulator);   /* forget all frames */

/* Take a frame. Pixels that are not finite, or above 1e15, are left out.
   rgba   in, width * height, linear, premultiplied
   depth  in, INFINITY where empty; NULL: no `blur`, and not for the adaptive mode
   view   in, as depth
   O(pixels). Errors: INVALID_ARG. One thread at a time; uses env's threads inside, allocates nothing; the same bits for
   any number of them. */
ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_add(zbufrand_accumulator *accumulator, const float *rgba,
                                                      const float *depth, const zbufrand_view *view);

typedef struct zbufrand_noise {
    double rmse;        /* estimated root of the mean squared error of red, green and blue that more frames would still
                           remove; linear light. INFINITY before the second frame */
    double frames;      /* that a plain mean as quiet as this would need, on average over the pixels */
    double more_frames; /* estimated number still needed to get to `target`; 0: it is reached */
} zbufrand_noise;

/* How noisy the result is, and how far from `target` (an RMSE; 0: just measure). Frames have to be independent (frames
   that share out a point set among them are quieter than estimated). Smooth mode cannot get below the noise of
   (2 - epsilon) / epsilon frames: more_frames is INFINITY then. O(pixels) on the calling thread. INVALID_ARG also:
   target is below 0 or NaN. */
ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_noise(const zbufrand_accumulator *accumulator, double target,
                                                        zbufrand_noise *out_noise);

/* The result.
   contrast  0: as it is. g > 0: colours and alpha times g, cut at alpha 1: makes up for sparse frames, in which most
             pixels are empty (g = 1 / (1 - exp(-density)) restores the brightness). Below 0: each pixel divided by the
             share of frames that hit it, alpha 1 where any did
   rgba      out, width * height, linear, premultiplied; 0 where no frame had anything
   O(pixels). Errors: INVALID_ARG (also a contrast that is NaN). */
ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_get(const zbufrand_accumulator *accumulator, float contrast,
                                                      float *rgba);

/* ---- how many samples: theory ----

   Samples fall on the surfaces with `density` samples per square pixel of projected area, hidden parts included. area
   is the projected area of everything, visible and hidden, in pixels; visible the part that is seen; block the edge d
   of the colour blocks (1: pixels). A pixel is right when a sample of its visible surface falls into its d x d window,
   with probability 1 - exp(-density d^2) if independent samples are drawn.
   Pure functions of doubles, any thread, O(1) unless stated. An argument that is NaN or outside the stated range gives
   NaN; what is said for one of them holds for an argument of the same name in those that follow. Areas, numbers and
   edges are finite; a density of INFINITY gives the limit or NaN. Numbers of samples are not rounded and may be far
   above 2^64. Relative errors are below 1e-12 unless stated. */

typedef enum zbufrand_bound { /* how the number of samples for a wanted probability is found */
    ZBUFRAND_BOUND_UNION = 0,    /* (a/d^2) ln(v / (1-s)): any shapes, independent or stratified samples (default) */
    ZBUFRAND_BOUND_DIRECT = 1,   /* -(a/d^2) ln(1 - s^(1/v)): exact for d = 1; independent samples (Poisson counts) */
    ZBUFRAND_BOUND_LEMMA2 = 2,   /* thesis, Lemma 2, all a cells: ln(1 - s^(1/a)) / ln(1 - 1/a); Theorem 4 if a > v */
    ZBUFRAND_BOUND_LEMMA3 = 3,   /* thesis, Lemma 3: -a ln(1 - s^(1/a)) */
    ZBUFRAND_BOUND_THEOREM1 = 4, /* thesis, Theorem 1: expected number that fills all a cells, a H_a; s is not used */
    ZBUFRAND_BOUND_THEOREM2 = 5, /* thesis, Theorem 2: a ln a + c a with s = exp(-exp(-c)) */
    ZBUFRAND_BOUND_LEMMA4 = 6,   /* thesis, Lemma 4: visible cells among all, the quadratic of the normal law solved */
    ZBUFRAND_BOUND_THEOREM5 = 7, /* thesis, Theorem 5 with its sign put right: (a/v) (m_v + quantile sqrt(m_v)) */
    ZBUFRAND_BOUND_FORCE_32BIT = 0x7fffffff
} zbufrand_bound;

/* Samples over the whole area so that no visible pixel is wrong, with probability s = `probability`.
   area >= visible > 0, block >= 1, 0 < probability < 1.
   The bounds of the thesis count cells: for blocks they are taken with cells of edge ceil(block / 2), the largest that
   a block around any of their points covers. Other cells: divide area and visible by their area, block = 1.
   UNION never asks for too little. DIRECT is the exact number for pixels; for blocks the windows overlap, and as
   hitting them is positively correlated it is a safe one. */
ZBUFRAND_DEF double zbufrand_samples(zbufrand_bound bound, double area, double visible, double block,
                                     double probability);

/* Samples per square pixel that UNION asks for: ln(visible / (1 - probability)) / block^2, at least 0. */
ZBUFRAND_DEF double zbufrand_density(double visible, double block, double probability);

/* Samples so that on average the share `share` of the visible pixels stays wrong: (a/d^2) ln(1/share).
   0 < share <= 1. */
ZBUFRAND_DEF double zbufrand_samples_for_share(double area, double block, double share);

/* Samples so that at most `tolerated` of `visible` cells stay empty, with probability s. area >= visible >= 1,
   0 <= tolerated < visible, 0 < probability < 1, visible <= 1e12. Solves the binomial law of the number of empty cells
   for independent samples; relative error below 1e-9. O(sqrt(visible)). */
ZBUFRAND_DEF double zbufrand_samples_tolerant(double area, double visible, double tolerated, double probability);

/* The thesis' Lemma 2 as printed: ln(1 - s^(1/(n-k))) / ln(1 - 1/n). Right for k = tolerated = 0; for more it fixes
   which cells may stay empty and asks for far too much. cells >= 1, 0 <= tolerated < cells, 0 < probability < 1. */
ZBUFRAND_DEF double zbufrand_samples_lemma2(double cells, double tolerated, double probability);

/* Probability that no visible pixel is wrong. SUCCESS: (1 - exp(-density d^2))^v, exact for d = 1, a lower bound for
   blocks; independent samples. BOUND: max(0, 1 - v exp(-density d^2)), stratified samples too.
   density >= 0, visible >= 0, block >= 1. */
ZBUFRAND_DEF double zbufrand_success(double density, double visible, double block);
ZBUFRAND_DEF double zbufrand_success_bound(double density, double visible, double block);

/* Expected number of wrong visible pixels: v exp(-density d^2). */
ZBUFRAND_DEF double zbufrand_expected_holes(double density, double visible, double block);

/* Variance of the number of empty cells after exactly `samples` independent ones, for large n = cells:
   n (e^-u - (1+u) e^-2u), u = samples/n. cells > 0, samples >= 0. */
ZBUFRAND_DEF double zbufrand_holes_variance(double samples, double cells);

/* Probability that this number is off its mean E = n (1 - 1/n)^m by `deviation` or more: at most
   2 exp(-deviation^2 (n - 1/2) / (n^2 - E^2)), cut at 1. cells >= 1, deviation >= 0. Thesis, Theorem 3. */
ZBUFRAND_DEF double zbufrand_holes_tail(double samples, double cells, double deviation);

/* Edge of the cells for blocks of edge d: THESIS floor(d/2) (0 for d = 1, and needlessly small for odd d), EXACT
   ceil(d/2), PRACTICE d (the thesis' rule of thumb: leaves about d^2 ln(1/s) wrong pixels). 1 <= block < 1e15. */
typedef enum zbufrand_cells {
    ZBUFRAND_CELLS_EXACT = 0,
    ZBUFRAND_CELLS_THESIS = 1,
    ZBUFRAND_CELLS_PRACTICE = 2,
    ZBUFRAND_CELLS_FORCE_32BIT = 0x7fffffff
} zbufrand_cells;
ZBUFRAND_DEF double zbufrand_cell_edge(zbufrand_cells rule, double block);

/* The law of a pixel. Its fragments from front to back cover areas (in cells) area[0..count), hidden parts included;
   `density` samples fall on a cell on average. probability[i] = exp(-density S_{i-1}) (1 - exp(-density area[i])) that
   it shows fragment i, S the running sum; returns the probability that it stays empty. This is volume rendering with
   extinction `density` through the profile of area over depth.
   probability  out, [count], may be NULL or area itself. density >= 0, areas >= 0 (else all NaN). O(count). */
ZBUFRAND_DEF double zbufrand_pixel_law(const double *area, size_t count, double density, double *probability);

/* Expected value of a pixel whose fragments have the values value[0..count), `background` where nothing is hit.
   out_variance: of one frame, may be NULL; frames averaged over M have variance / M. */
ZBUFRAND_DEF double zbufrand_expected_pixel(const double *area, const double *value, size_t count, double density,
                                            double background, double *out_variance);

/* z-dominance: probability that a front covering the share `coverage` of a pixel over a full background is shown,
   given that anything is: (1 - exp(-coverage density)) / (1 - exp(-density)); `coverage` itself for density 0.
   0 <= coverage <= 1. */
ZBUFRAND_DEF double zbufrand_front_share(double coverage, double density);

/* Bleeding: probability that a cell covered by one surface shows one of `layers` coincident ones a distance `gap`
   behind it, when each spans a depth of `range` within the cell, evenly. About K/(K+1) exp(-density gap/range); the
   exact sum. gap >= 0, range >= 0 (0: flat, bleeds only where no front sample fell), layers >= 0.
   Uneven spans: zbufrand_pixel_law. */
ZBUFRAND_DEF double zbufrand_bleed(double density, double gap, double range, double layers);

/* Probability that a block of the front is shown at `distance` pixels outside a straight edge of it:
   1 - exp(-density d (d/2 - distance)), 0 from d/2 on. distance >= 0. */
ZBUFRAND_DEF double zbufrand_block_spill(double density, double block, double distance);

/* Share of `pixels` that two or more of `samples` hit: 1 - (1-p)^k - k p (1-p)^(k-1), p = 1/pixels. pixels >= 1. */
ZBUFRAND_DEF double zbufrand_multi_hit(double samples, double pixels);

/* Largest probability that a cell stays empty which expects `expected` samples from `strata` strata with one
   independent sample each: (1 - expected/strata)^strata <= exp(-expected). strata INFINITY: independent samples.
   0 <= expected <= strata. */
ZBUFRAND_DEF double zbufrand_empty_bound(double expected, double strata);

/* Variance over mean of counts after thinning: accepted F + 1 - accepted. F >= 0, 0 <= accepted <= 1. */
ZBUFRAND_DEF double zbufrand_thinned_dispersion(double dispersion, double accepted);

/* Frames whose plain mean is as noisy as exponential smoothing with 0 < epsilon <= 1: (2 - epsilon) / epsilon. */
ZBUFRAND_DEF double zbufrand_smoothing_frames(double epsilon);

/* The thesis' time model of painted blocks: project (a/d^2) ln(v/d^2) + paint a ln(v/d^2); seconds per sample and per
   painted pixel, not below 0. visible > block^2. */
ZBUFRAND_DEF double zbufrand_block_time(double project, double paint, double area, double visible, double block);

/* Harmonic number H_n, also between the integers (digamma(n + 1) + Euler's constant); n >= 0. Below n = 1 it is the
   absolute error that is below 1e-14. */
ZBUFRAND_DEF double zbufrand_harmonic(double n);

/* x with probability p below it under the standard normal law, 0 < p < 1; absolute error below 1e-13 (1 + |x|). */
ZBUFRAND_DEF double zbufrand_normal_quantile(double p);


/* ---- pictures of scenes ---- */

/* A pinhole. Right-handed coordinates; `up` need not be at right angles to the view. */
typedef struct zbufrand_camera {
    double eye[3], at[3];
    double up[3];          /* all zero: +y */
    double fov_y;          /* vertical angle in degrees, below 180; 0: 40 */
    double near_z, far_z;  /* depths along the view that are drawn; 0: 1e-7 of the scene's diagonal, and no limit */
} zbufrand_camera;

/* color is what a white surface facing the light shows, linear; no falloff with distance. */
typedef struct zbufrand_light {
    double position[3];    /* of a point light; directional: the direction towards the light, any length */
    uint32_t directional;
    float color[3];
} zbufrand_light;

/* What is seen in one pixel. */
typedef struct zbufrand_surface {
    double position[3];    /* world */
    float normal[3];       /* world, unit, of the side that is seen */
    float rgb[3];          /* linear */
    float depth;           /* along the viewing axis */
    uint32_t pixel;        /* y * width + x */
    uint32_t material;     /* of the mesh */
    uint32_t node;         /* of the mesh, if a triangle was drawn; 0: a stored point stands for it */
    uint32_t triangle;     /* index within the mesh; ~0: a stored point, or the scene was built without ids */
} zbufrand_surface;

/* Own shading: rgba[4 * i] receives linear, premultiplied colour and opacity of surfaces[i]. Called for what is seen
   only, up to 64 at once, by several threads. The same colours for the same surfaces, or pictures are not
   repeatable. */
typedef void zbufrand_shade_fn(void *user, const zbufrand_surface *surfaces, size_t count, float *rgba);

typedef enum zbufrand_hybrid { /* which clusters of triangles are rasterised exactly instead of sampled */
    ZBUFRAND_HYBRID_AUTO = 0,  /* where it is cheaper by zbufrand_costs (default) */
    ZBUFRAND_HYBRID_OFF = 1,   /* only what crosses the near plane, or is 64 times as large as the picture */
    ZBUFRAND_HYBRID_ALL = 2,   /* all: an ordinary z-buffer picture */
    ZBUFRAND_HYBRID_CUBE = 3,  /* the thesis: what touches the cube of edge 2 * hybrid_radius around the eye */
    ZBUFRAND_HYBRID_LARGE = 4, /* the thesis: triangles too large for depth_ratio; with the default tree as OFF */
    ZBUFRAND_HYBRID_FORCE_32BIT = 0x7fffffff
} zbufrand_hybrid;

/* What things cost, in any unit; 0: the default, nanoseconds on the machine this was written on. Together they decide
   between raster and samples, so pictures are equal only with equal costs. */
typedef struct zbufrand_costs {
    float triangle;        /* a triangle rasterised: 4 */
    float edge;            /* per pixel of the longest edge of its cluster, up to 12 of them: 1.5 */
    float pixel;           /* a pixel filled by that: 1.5 */
    float cluster;         /* a cluster made ready for sampling, per triangle: 5.5 */
    float sample;          /* a sample drawn from a cluster: 6.5 */
    float set;             /* a set of stored samples made ready: 60 */
    float stored;          /* a stored sample drawn: 3.5 */
    float ray;             /* a ray for the repair: 2000 */
    float listed;          /* a sample drawn from a distribution list: 200 */
} zbufrand_costs;

/* field           zero means
   camera          (eye equals at) one that frames the scene; a cube of edge 2 around the origin without a scene
   tolerance       0.05: probability that the picture is incomplete, at most, below 1: that somewhere a pixel is empty,
                   or more than 1 % deeper than all that is visible in it and in the pixels around it (in blocks of
                   d x d: up to 3 d / 2 pixels away), where these are covered as a whole. Holds for what is sampled;
                   what is rastered misses nothing. With `noise` and without a tolerance frames have half as many
                   samples, and what is reported is about all of them: that somewhere none is right
   density         as `tolerance` needs it. L: samples per square pixel of projected surface, visible or hidden; below
                   10^6
   noise           one frame. E: frames are averaged until the estimated RMSE of the mean (linear light) is below E
   max_frames      256: for `noise`
   frame           0: number of the frame: other frames use other random numbers (and with `spread` other points)
   seed            0 is a seed like any other
   spread          1: frames that will be averaged: the stored points are shared out among that many frames in a row,
                   so that their mean converges, and centres of pixels move; a power of two
   oversample      1. K: the picture is drawn K times as wide and high, and each pixel is the mean of its K x K parts;
                   K up to 16. Edges are antialiased as a mean of frames cannot do it, in each of which the nearest
                   wins however little of a pixel it covers. `tolerance` and what is reported are about pixels of which
                   no part is right, so that each part needs fewer samples. Depth and node are those of the nearest
                   part; what else is counted in pixels (stats, density, reconstruct, surface.pixel) is about the
                   larger picture. 24 bytes more for each part. Only for zbufrand_render
   reconstruct     one pixel per sample; no fill; see there. Its `repair` is screen-space mending; for rays see
                   no_repair
   hybrid          by cost
   hybrid_radius   HYBRID_CUBE: only what touches the eye; not below 0
   costs           the defaults
   independent     0: stratified samples; 1: independent points in Poisson numbers, as the theory has it; slower, and of
                   the default tree only as far as 4 million clusters are in view (else RANGE)
   comb            0: each sample has a random place in its stratum; 1: all of a draw have the same one, a comb through
                   the areas. More even yet, but no bound holds: where the surface repeats itself as often as the comb
                   has teeth whole patterns are missed. Stored samples stay as they are
   round_up        0; 1: expected numbers of samples of a run are rounded up instead of at random; with `independent`
                   the thesis' Algorithm 11. Only for scenes built with one of its trees, as the next three
   depth_ratio     1.5: epsilon, by how much the factor 1/z^2 may vary over what is drawn as a whole; more than 1, as
                   the next; below 10^6, as the next two
   angle_ratio     no rule for normals (tree over normals: as depth_ratio). e: the same for the cosine of the angle of
                   view, as far as classes are fine enough to tell
   clip_ratio      no rule. c: what is partly outside of the view and wider than c times its depth is divided
   corners         0; 1: of triangles up to half a pixel wide one of the corners is drawn instead of a point in them.
                   Only for scenes built with one of the thesis' trees
   opacity         all is opaque. In each frame a pixel shows surfaces of a material or does not, with that
                   probability, whether by samples, rasterised or by rays, and all of a material alike: what is
                   behind shows through as through one layer, however many there are. Frames differ, so that the
                   mean of frames (`noise`) tends to opacity * in front + (1 - opacity) * behind. With blocks
                   neighbouring pixels decide, too, and less shows through. What shines through is not part of
                   `tolerance`
   no_lists        1: the default tree, though the scene was built with another
   no_*            the thing is on */
typedef struct zbufrand_render_desc {
    uint32_t _begin_zero;
    zbufrand_camera camera;
    double tolerance;
    double density;
    double noise;
    uint32_t max_frames;
    uint32_t frame, seed, spread;
    uint32_t oversample;
    zbufrand_reconstruct reconstruct;
    zbufrand_hybrid hybrid;
    double hybrid_radius;
    zbufrand_costs costs;
    uint32_t independent;
    uint32_t comb;
    uint32_t round_up;
    double depth_ratio, angle_ratio, clip_ratio;
    uint32_t corners;
    uint32_t no_lists;
    uint32_t no_occlusion;     /* 1: what is hidden is drawn too; the picture is the same but for chance */
    uint32_t no_repair;        /* 1: no rays for empty and suspicious pixels */
    /* 1: a pixel gets the depth of its sample, not that of the sample's plane at its centre */
    uint32_t no_plane_depth;
    uint32_t no_thinning;      /* 1: samples in excess of the density are kept; for measuring */
    const zbufrand_points *points; /* drawn along with the scene: a point cloud, one sample each */
    size_t points_count;       /* how many clouds */
    zbufrand_shade_fn *shade_fn;   /* NULL: lights and the colours of the meshes */
    void *shade_user;
    const float *opacity;      /* of materials 0, 1, ..., 0..1; NULL: all are opaque, as others and clouds are */
    size_t opacity_count;
    /* at most 65535; NULL: a key light from the upper left behind the camera, a weak fill light */
    const zbufrand_light *lights;
    size_t light_count;
    float ambient[3];          /* all zero: 0.05 each, of light from everywhere */
    uint32_t unlit;            /* 1: plain surface colours */
    float background[4];       /* linear, premultiplied; zero: transparent */
    double (*clock_fn)(void *user); /* seconds; NULL: no times in the stats */
    void *clock_user;
    uint32_t _end_zero;
} zbufrand_render_desc;

/* Buffers of the caller, row 0 on top; any may be NULL. Strides in bytes, 0: rows lie close together. */
typedef struct zbufrand_image {
    uint32_t width, height;
    uint8_t *rgba8;            /* sRGB, not premultiplied; alpha 0 where nothing is seen */
    float *rgba;               /* linear, premultiplied */
    float *depth;              /* along the viewing axis; INFINITY where nothing is seen */
    uint32_t *node;            /* of the mesh seen, if a triangle was drawn, else 0 */
    size_t rgba8_stride, rgba_stride, depth_stride, node_stride;
} zbufrand_image;

typedef enum zbufrand_stage {
    ZBUFRAND_STAGE_SELECT = 0, /* the cut through the trees */
    ZBUFRAND_STAGE_DRAW = 1,   /* samples and triangles into the key buffer */
    ZBUFRAND_STAGE_OCCLUSION = 2,
    ZBUFRAND_STAGE_REPAIR = 3,
    ZBUFRAND_STAGE_SHADE = 4,  /* colours of what is seen, reconstruction */
    ZBUFRAND_STAGE_COUNT = 5,
    ZBUFRAND_STAGE_FORCE_32BIT = 0x7fffffff
} zbufrand_stage;

typedef struct zbufrand_stats {
    uint64_t triangles;        /* of the scene, instances counted as often as they occur */
    uint64_t nodes;            /* of the tree opened */
    uint64_t tested;           /* children tested */
    uint64_t outside, facing_away, hidden; /* children dropped: by the view, by their normals, by what is before them */
    uint64_t instances;        /* entered */
    uint64_t draws[3];         /* of stored samples, of clusters sampled, of clusters rasterised */
    uint64_t samples[2];       /* drawn from stored ones, from clusters */
    /* of both: left after thinning, back faces, the borders of the picture and what is nearer by then; the last depends
       on the order in which threads draw */
    uint64_t accepted;
    uint64_t rastered;         /* triangles handed to the rasteriser */
    uint64_t points;           /* of own clouds */
    double density;            /* samples per square pixel of projected surface that was aimed at */
    double projected_area;     /* estimated: of all surfaces that were drawn, hidden ones too, square pixels */
    uint64_t covered;          /* pixels that show something */
    /* pixels that rays were cast for, because they were empty, because of their neighbours */
    uint64_t holes, wrong;
    uint64_t repaired;         /* of both: pixels that were changed by their ray */
    /* bound of the probability that the picture is incomplete, see `tolerance`; from the density, or from how many
       pixels had to be repaired, if these were more. Without repair pixels where rastered and sampled surfaces meet are
       not part of it */
    double incomplete;
    uint32_t frames;           /* averaged */
    double rmse;               /* estimated error of their mean, linear light; 0: not measured */
    double seconds[5];         /* by zbufrand_stage */
    size_t bytes;              /* held by the frame */
} zbufrand_stats;

/* Holds all memory of drawing, so that a frame like the one before allocates nothing. */
typedef struct zbufrand_frame zbufrand_frame;
typedef struct zbufrand_frame_desc {
    uint32_t _begin_zero;
    zbufrand_env env;          /* memory_limit is for all that the frame holds */
    zbufrand_isa isa;
    uint32_t _end_zero;
} zbufrand_frame_desc;

/* desc may be NULL. A frame draws one picture at a time; buffers come with the first. Errors: INVALID_ARG, UNINIT_DESC,
   NO_MEMORY. O(1). */
ZBUFRAND_DEF zbufrand_result zbufrand_frame_create(const zbufrand_frame_desc *desc, zbufrand_frame **out_frame);
ZBUFRAND_DEF void zbufrand_frame_destroy(zbufrand_frame *frame); /* NULL is fine */

/* Measure the costs on this machine, by pictures of a plane of 64,800 triangles: what zbufrand_render_desc.costs takes.
   Store them and hand over the same ones wherever pictures have to be equal. The defaults are good where the machine is
   like the one they were measured on, whatever its speed: only ratios count.
   desc       in, of the frames that will draw; NULL: defaults. One thread is used
   clock_fn   seconds, monotonic; needed
   out_costs  out, all above 0; all 0 on failure. ray and listed, which depend more on scenes than on machines, are the
              defaults times what stored samples take here, over what they take by default
   About 0.2 s and 20 MB. Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY. */
ZBUFRAND_DEF zbufrand_result zbufrand_measure_costs(const zbufrand_frame_desc *desc, double (*clock_fn)(void *user),
                                                    void *clock_user, zbufrand_costs *out_costs);

/* Draw.
   frame   one picture at a time
   desc    in, NULL: all defaults
   scene   in; NULL, or not built: only desc->points
   image   buffers in and out; a width or height of 0 is allowed
   stats   out, may be NULL; on failure of what was done until then
   The same bits for any number of threads and any isa, but for stats->accepted. Any number of frames may draw one scene
   at once. O(samples + pixels + nodes of the trees that are opened).
   Errors: INVALID_ARG, UNINIT_DESC, RANGE (a picture larger than 32000 a side, more than 2^32 samples or 65535 lights,
   a block too large), NO_MEMORY, CANCELLED (the picture is incomplete then). Source: thesis; Wand et al. 2001;
   occlusion after Greene et al. 1993. */
ZBUFRAND_DEF zbufrand_result zbufrand_render(zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                             const zbufrand_scene *scene, const zbufrand_image *image,
                                             zbufrand_stats *stats);

/* What the thesis' program did, to the letter: fair-split tree without classes, leaves of 64, epsilon 1.5, independent
   draws in numbers rounded up, nothing thinned out but what is turned away, colour blocks of 2 x 2, samples as dense
   as its theorems ask, large triangles rasterised; no culling of what is hidden, no rays, no planes. Sets those fields
   and leaves the others alone; either may be NULL. */
ZBUFRAND_DEF void zbufrand_preset_thesis(zbufrand_build_desc *build, zbufrand_render_desc *render);

/* Set eye and at so that the box fills the picture; keeps up and fov_y.
   camera  in and out; left as it is on failure
   view    from the object towards the eye, any length; NULL: from the front, a little from above and the right
   width, height  of the picture; one of them 0: as for a square
   INVALID_ARG: the box or view is not finite, a side of the box is below 0, view is 0, or the angle is not in (0, 180),
   or the place of the camera would not be finite. Any thread. O(1). */
ZBUFRAND_DEF zbufrand_result zbufrand_camera_fit(zbufrand_camera *camera, const double box_min[3],
                                                 const double box_max[3], const double view[3], uint32_t width,
                                                 uint32_t height);

/* The same for a scene: closer than its box allows, as the boxes of some hundred parts of it are looked at. scene may
   be NULL, not built or empty: a cube of edge 2 around the origin. */
ZBUFRAND_DEF zbufrand_result zbufrand_camera_fit_scene(zbufrand_camera *camera, const zbufrand_scene *scene,
                                                       const double view[3], uint32_t width, uint32_t height);

/* The camera as zbufrand_project and the accumulators take it. scene gives the default near plane, and what is framed
   if eye equals at; it may be NULL. O(1). INVALID_ARG, out_view all 0 then: a number is not finite, the angle is not in
   (0, 180), or near_z and far_z are below 0 or in the wrong order. */
ZBUFRAND_DEF zbufrand_result zbufrand_camera_view(const zbufrand_camera *camera, const zbufrand_scene *scene,
                                                  uint32_t width, uint32_t height, zbufrand_view *out_view);

/* ---- what a picture is made of ---- */

typedef enum zbufrand_draw_kind {
    ZBUFRAND_DRAW_STORED = 0,  /* a prefix of stored samples */
    ZBUFRAND_DRAW_SAMPLED = 1, /* samples drawn from a cluster */
    ZBUFRAND_DRAW_RASTERED = 2,
    ZBUFRAND_DRAW_KIND_FORCE_32BIT = 0x7fffffff
} zbufrand_draw_kind;

/* One entry of the cut: a node, a cluster or an instance that is drawn as a whole. */
typedef struct zbufrand_group {
    zbufrand_draw_kind kind;
    uint32_t structure;
    /* 2 bits: 0 node, 1 cluster, 2 instance (whole), 3 run of a distribution list; 30 bits: its index in the structure,
       or of the first object */
    uint32_t child;
    uint64_t triangles;        /* below it */
    double area;               /* world */
    double z_min, z_max;       /* depths that it may have */
    double factor_max, factor_min; /* bounds of the projection factor, square pixels per square unit: never exceeded */
    /* samples wanted before thinning: density * area * factor_max, or less if there are points for the direction of
       view */
    double expected;
    uint32_t count;            /* samples drawn; triangles if rastered */
} zbufrand_group;

/* The cut for a picture, without drawing it: hidden groups are in it, as occlusion is known only while drawing.
   width, height  of the picture, not 0
   groups     out, [capacity]; may be NULL with capacity 0
   out_count  all there are, even if more than capacity; desc->points are not among them
   stats      out, may be NULL
   Errors: as zbufrand_render. The frame is used as for a picture: one call at a time. */
ZBUFRAND_DEF zbufrand_result zbufrand_select(zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                             const zbufrand_scene *scene, uint32_t width, uint32_t height,
                                             zbufrand_group *groups, size_t capacity, size_t *out_count,
                                             zbufrand_stats *stats);

/* The samples of a picture as a stream: what zbufrand_render would put into its key buffer, hidden ones too, but for
   rastered clusters, which are not in it. sample_fn is called by one thread at a time, up to 64 samples at once, in a
   fixed order; another result than 0 ends it. numbers tell the samples of a frame apart. The arrays last for the call
   of sample_fn; desc->points are not in the stream. stats out, may be NULL.
   Errors: as zbufrand_select; CANCELLED also: sample_fn ended it. */
typedef int zbufrand_sample_fn(void *user, const zbufrand_sample *samples, const uint32_t *numbers, size_t count);
ZBUFRAND_DEF zbufrand_result zbufrand_sample_scene(zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                                   const zbufrand_scene *scene, uint32_t width, uint32_t height,
                                                   zbufrand_sample_fn *sample_fn, void *user, zbufrand_stats *stats);

/* ---- misc ---- */

/* Texts for messages, constant and never NULL ("unknown result" and "unknown" for what is no value of the enum); the
   version of the code, to compare with ZBUFRAND_VERSION of the declarations. Any thread. O(1). */
ZBUFRAND_DEF const char *zbufrand_result_string(zbufrand_result result);
ZBUFRAND_DEF uint32_t zbufrand_version(void);
ZBUFRAND_DEF const char *zbufrand_isa_name(zbufrand_isa isa);
ZBUFRAND_DEF zbufrand_isa zbufrand_isa_best(void); /* what ZBUFRAND_ISA_AUTO picks on this machine */

#ifdef __cplusplus
}
#endif
#endif /* ZBUFRAND_H_INCLUDED */

/* End of API. Stop here if you only use the library. */

#if defined(__INTELLISENSE__) || defined(__JETBRAINS_IDE__)
#  define ZBUFRAND_IMPLEMENTATION
#endif
#if defined(ZBUFRAND_IMPLEMENTATION) && !defined(ZBUFRAND_IMPLEMENTATION_DONE)
#define ZBUFRAND_IMPLEMENTATION_DONE

/* ---------------------------------------------------------------------------
   platform: compiler, instruction sets, asserts, bytes.                        // >>platform
   Equal in all three headers but for the prefix, up to and including math.
   --------------------------------------------------------------------------- */
#include <string.h>
#include <math.h>
#if defined(ZBUFRAND_MALLOC) != defined(ZBUFRAND_FREE)
#  error "define both or neither of ZBUFRAND_MALLOC(size,user) and ZBUFRAND_FREE(ptr,size,user)"
#endif
#ifndef ZBUFRAND_MALLOC
#  include <stdlib.h>
#  define ZBUFRAND_MALLOC(size, user) ((void)(user), malloc(size))
#  define ZBUFRAND_FREE(ptr, size, user) ((void)(user), (void)(size), free(ptr))
#endif
#ifndef ZBUFRAND_ASSERT
#  include <assert.h>
#  define ZBUFRAND_ASSERT(cond) assert(cond)
#endif
#if defined(__FAST_MATH__) && !defined(ZBUFRAND_ALLOW_FAST_MATH)
#  error "zbufrand.h needs NaN and infinity; build without -ffast-math or define ZBUFRAND_ALLOW_FAST_MATH"
#endif
#if defined(__wasm__) && !defined(_REENTRANT) && !defined(ZBUFRAND_NO_THREADS) /* -pthread defines it */
#  define ZBUFRAND_NO_THREADS
#endif
#ifndef ZBUFRAND_NO_THREADS
#  include <pthread.h>
#  include <unistd.h>
#endif
#ifndef ZBUFRAND_NO_STDIO
#  include <stdio.h>
#endif
#if !defined(ZBUFRAND_NO_SIMD) && (defined(__x86_64__) || defined(_M_X64))
#  define ZBUFRANDI_X64 1
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
#    define ZBUFRANDI_TARGET_AVX2
#  else
#    define ZBUFRANDI_TARGET_AVX2 __attribute__((target("avx2,bmi,bmi2,lzcnt,popcnt"))) /* never "fma": same bits */
#  endif
#else
#  define ZBUFRANDI_X64 0
#endif
#if ZBUFRANDI_X64 && !defined(ZBUFRAND_NO_AVX2)
#  define ZBUFRANDI_AVX2 1
#else
#  define ZBUFRANDI_AVX2 0
#endif
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC push_options
#  pragma GCC optimize("fp-contract=off")
#elif defined(__clang__)
#  pragma STDC FP_CONTRACT OFF
#endif
#if defined(__GNUC__) || defined(__clang__)
#  if defined(__OPTIMIZE__)
#    define ZBUFRANDI_INLINE static inline __attribute__((always_inline, unused))
#  else /* each inlined copy would have stack of its own */
#    define ZBUFRANDI_INLINE static inline __attribute__((unused))
#  endif
#  define ZBUFRANDI_UNUSED __attribute__((unused))
#  define ZBUFRANDI_NOINLINE __attribute__((noinline))
#  define ZBUFRANDI_LIKELY(x) __builtin_expect(!!(x), 1)
#  define ZBUFRANDI_UNLIKELY(x) __builtin_expect(!!(x), 0)
#  define ZBUFRANDI_PREFETCH(p) __builtin_prefetch(p)
#else
#  define ZBUFRANDI_INLINE static inline
#  define ZBUFRANDI_UNUSED
#  define ZBUFRANDI_NOINLINE
#  define ZBUFRANDI_LIKELY(x) (x)
#  define ZBUFRANDI_UNLIKELY(x) (x)
#  define ZBUFRANDI_PREFETCH(p) ((void)(p))
#endif
#ifdef __cplusplus
extern "C" {
#endif

/* Levels: 1 scalar, 2 SSE 4.1 with POPCNT, 3 AVX2 with BMI2 and POPCNT. */
ZBUFRANDI_UNUSED static int zbufrandi_cpu_level(void) {
#if ZBUFRANDI_X64 && !defined(_MSC_VER)
    int level = __builtin_cpu_supports("sse4.1") && __builtin_cpu_supports("popcnt") ? 2 : 1;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt")) level = 3;
    return level;
#elif ZBUFRANDI_X64
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
#  define zbufrandi_popcount64(x) ((uint32_t)__builtin_popcountll(x))
#else
ZBUFRANDI_INLINE uint32_t zbufrandi_popcount64(uint64_t x) {
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fu;
    return (uint32_t)((x * 0x0101010101010101u) >> 56);
}
#endif
#if defined(__GNUC__) || defined(__clang__)
#  define zbufrandi_ctz64(x) ((uint32_t)__builtin_ctzll(x)) /* x != 0 */
#  define zbufrandi_clz32(x) ((uint32_t)__builtin_clz(x))   /* x != 0 */
#else
ZBUFRANDI_INLINE uint32_t zbufrandi_ctz64(uint64_t x) { return zbufrandi_popcount64((x & (0u - x)) - 1u); }
ZBUFRANDI_INLINE uint32_t zbufrandi_clz32(uint32_t x) {
    x |= x >> 1; x |= x >> 2; x |= x >> 4; x |= x >> 8; x |= x >> 16;
    return 32u - zbufrandi_popcount64(x);
}
#endif

ZBUFRANDI_INLINE uint32_t zbufrandi_load_u16(const uint8_t *p) { return (uint32_t)p[0] | (uint32_t)p[1] << 8; }
ZBUFRANDI_INLINE uint32_t zbufrandi_load_u32(const uint8_t *p) {
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}
ZBUFRANDI_INLINE uint64_t zbufrandi_load_u64(const uint8_t *p) {
    return (uint64_t)zbufrandi_load_u32(p) | (uint64_t)zbufrandi_load_u32(p + 4) << 32;
}
ZBUFRANDI_INLINE void zbufrandi_store_u16(uint8_t *p, uint32_t v) { p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); }
ZBUFRANDI_INLINE void zbufrandi_store_u32(uint8_t *p, uint32_t v) {
    p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); p[2] = (uint8_t)(v >> 16); p[3] = (uint8_t)(v >> 24);
}
ZBUFRANDI_INLINE void zbufrandi_store_u64(uint8_t *p, uint64_t v) {
    zbufrandi_store_u32(p, (uint32_t)v);
    zbufrandi_store_u32(p + 4, (uint32_t)(v >> 32));
}
ZBUFRANDI_INLINE int zbufrandi_little_endian(void) {
    const uint16_t one = 1;
    uint8_t b;
    memcpy(&b, &one, 1);
    return b;
}

/* ---------------------------------------------------------------------------
   memory: every byte comes from here; counted, limited, 64-byte aligned.       // >>memory
   --------------------------------------------------------------------------- */

typedef struct zbufrandi_mem {
    zbufrand_allocator allocator;
    size_t limit;          /* 0: none */
    size_t used, peak;     /* atomics */
} zbufrandi_mem;

static void *zbufrandi_default_alloc(size_t size, void *user) { return ZBUFRAND_MALLOC(size, user); }
static void zbufrandi_default_free(void *ptr, size_t size, void *user) { ZBUFRAND_FREE(ptr, size, user); }

ZBUFRANDI_INLINE int zbufrandi_mul_size(size_t a, size_t b, size_t *out) {
    if (b != 0 && a > (size_t)-1 / b) return 0;
    *out = a * b;
    return 1;
}

#if defined(__GNUC__) || defined(__clang__)
#  define zbufrandi_atomic_add(p, v) __atomic_add_fetch(p, v, __ATOMIC_SEQ_CST)
#  define zbufrandi_atomic_load(p) __atomic_load_n(p, __ATOMIC_SEQ_CST)
#  define zbufrandi_atomic_store(p, v) __atomic_store_n(p, v, __ATOMIC_SEQ_CST)
#  define zbufrandi_atomic_swap_if(p, seen, v) \
       __atomic_compare_exchange_n(p, seen, v, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST)
#else /* no threads there, and the host's parallel-for has to be serial */
#  define zbufrandi_atomic_add(p, v) (*(p) += (v))
#  define zbufrandi_atomic_load(p) (*(p))
#  define zbufrandi_atomic_store(p, v) (*(p) = (v))
#  define zbufrandi_atomic_swap_if(p, seen, v) (*(p) == *(seen) ? (*(p) = (v), 1) : (*(seen) = *(p), 0))
#endif

/* Not every machine has 64-bit atomics: what threads add to is a low and a high half. Read it after they ended. */
ZBUFRANDI_INLINE void zbufrandi_tally_add(uint32_t sum[2], uint64_t n) {
    uint32_t low = zbufrandi_atomic_add(&sum[0], (uint32_t)n);
    (void)zbufrandi_atomic_add(&sum[1], (uint32_t)(n >> 32) + (low < (uint32_t)n));
}
ZBUFRANDI_INLINE uint64_t zbufrandi_tally(const uint32_t sum[2]) { return (uint64_t)sum[1] << 32 | sum[0]; }

/* Before each block stand 64..127 bytes: the padding, then size and padding in the last 16. */
static ZBUFRANDI_UNUSED void *zbufrandi_alloc(zbufrandi_mem *mem, size_t bytes) {
    size_t total, used, seen, skip;
    uint8_t *raw, *p;
    if (bytes > (size_t)-1 - 256) return NULL;
    total = bytes + 128;
    used = zbufrandi_atomic_add(&mem->used, total);
    if (mem->limit != 0 && used > mem->limit) {
        (void)zbufrandi_atomic_add(&mem->used, (size_t)0 - total);
        return NULL;
    }
    raw = (uint8_t *)mem->allocator.alloc_fn(total, mem->allocator.user);
    if (raw == NULL) {
        (void)zbufrandi_atomic_add(&mem->used, (size_t)0 - total);
        return NULL;
    }
    seen = zbufrandi_atomic_load(&mem->peak);
    while (seen < used && !zbufrandi_atomic_swap_if(&mem->peak, &seen, used)) { }
    skip = 128 - (size_t)((uintptr_t)raw & 63u);
    if (skip > 64 + 63) skip -= 64;
    p = raw + skip;
    memcpy(p - 8, &skip, sizeof skip);
    memcpy(p - 16, &total, sizeof total);
    return p;
}

static ZBUFRANDI_UNUSED void *zbufrandi_alloc_array(zbufrandi_mem *mem, size_t count, size_t size) {
    size_t bytes;
    return zbufrandi_mul_size(count, size, &bytes) ? zbufrandi_alloc(mem, bytes) : NULL;
}

static ZBUFRANDI_UNUSED void *zbufrandi_alloc_zero(zbufrandi_mem *mem, size_t count, size_t size) {
    size_t bytes;
    void *p = NULL;
    if (zbufrandi_mul_size(count, size, &bytes)) p = zbufrandi_alloc(mem, bytes);
    if (p != NULL) memset(p, 0, bytes);
    return p;
}

static ZBUFRANDI_UNUSED void zbufrandi_free(zbufrandi_mem *mem, void *ptr) {
    size_t total = 0, skip = 0;
    uint8_t *p = (uint8_t *)ptr;
    if (p == NULL) return;
    memcpy(&skip, p - 8, sizeof skip);
    memcpy(&total, p - 16, sizeof total);
    mem->allocator.free_fn(p - skip, total, mem->allocator.user);
    (void)zbufrandi_atomic_add(&mem->used, (size_t)0 - total); /* only now: threads keep limits together */
}

/* Make room for `need` elements by doubling; keeps the old block when it fails. 1 on success. */
static ZBUFRANDI_UNUSED int zbufrandi_grow(zbufrandi_mem *mem, void **array, size_t *capacity, size_t count,
                                     size_t need, size_t size) {
    size_t cap = *capacity;
    void *p;
    if (need <= cap) return 1;
    if (cap < 16) cap = 16;
    while (cap < need) {
        if (cap > (size_t)-1 / 2) return 0;
        cap *= 2;
    }
    p = zbufrandi_alloc_array(mem, cap, size);
    if (p == NULL) return 0;
    if (count != 0) memcpy(p, *array, count * size);
    zbufrandi_free(mem, *array);
    *array = p;
    *capacity = cap;
    return 1;
}

/* ---------------------------------------------------------------------------
   threads: one parallel-for; tasks are cut by a fixed rule, so results do not  // >>threads
   depend on how many threads run them. Error reports.
   --------------------------------------------------------------------------- */

typedef struct zbufrandi_for {
    zbufrand_task_fn *task;
    void *ctx;
    uint32_t count;
    uint32_t next; /* atomic */
} zbufrandi_for;

static void zbufrandi_for_drain(zbufrandi_for *f) {
    for (;;) {
        uint32_t i = zbufrandi_atomic_add(&f->next, 1u) - 1u;
        if (i >= f->count) return;
        f->task(f->ctx, i);
    }
}

#ifndef ZBUFRAND_NO_THREADS
static void *zbufrandi_for_thread(void *arg) {
    zbufrandi_for_drain((zbufrandi_for *)arg);
    return NULL;
}
#endif

static ZBUFRANDI_UNUSED uint32_t zbufrandi_thread_count(const zbufrand_env *env) {
    uint32_t n = env->thread_count;
#ifndef ZBUFRAND_NO_THREADS
#  ifdef _SC_NPROCESSORS_ONLN
    if (n == 0) {
        long cores = sysconf(_SC_NPROCESSORS_ONLN);
        n = cores > 0 ? (uint32_t)cores : 1u;
    }
#  elif defined(__MINGW32__)
    if (n == 0) n = (uint32_t)pthread_num_processors_np();
#  endif
#endif
    if (n == 0) n = 1;
    return n > 64 ? 64 : n;
}

/* Run task(ctx, i) for i in [0, count) and return when all are done. count < 2^31. */
static ZBUFRANDI_UNUSED void zbufrandi_parallel_for(const zbufrand_env *env, zbufrand_task_fn *task, void *ctx,
                                                    uint32_t count) {
    zbufrandi_for f;
    f.task = task;
    f.ctx = ctx;
    f.count = count;
    f.next = 0;
    if (count == 0) return;
    if (env->parallel.for_fn != NULL) {
        env->parallel.for_fn(task, ctx, count, env->parallel.user);
        return;
    }
#ifndef ZBUFRAND_NO_THREADS
    {
        pthread_t thread[64];
        pthread_attr_t attr;
        uint32_t want = zbufrandi_thread_count(env), started = 0, i;
        if (want > count) want = count;
        if (want > 1 && pthread_attr_init(&attr) == 0) {
            (void)pthread_attr_setstacksize(&attr, 512 * 1024);
            while (started + 1 < want && pthread_create(&thread[started], &attr, zbufrandi_for_thread, &f) == 0)
                started++;
            (void)pthread_attr_destroy(&attr);
        }
        zbufrandi_for_drain(&f);
        for (i = 0; i < started; i++) (void)pthread_join(thread[i], NULL);
    }
#else
    zbufrandi_for_drain(&f);
#endif
}

/* text may hold one "%": it is replaced by the number `where`. */
static ZBUFRANDI_UNUSED zbufrand_result zbufrandi_fail(zbufrand_error *error, zbufrand_result code, uint64_t where,
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

/* Check a desc's env and take its allocator. */
static ZBUFRANDI_UNUSED zbufrand_result zbufrandi_env_open(const zbufrand_env *env, zbufrandi_mem *mem) {
    memset(mem, 0, sizeof *mem);
    if ((env->allocator.alloc_fn == NULL) != (env->allocator.free_fn == NULL)) {
        (void)zbufrandi_fail(env->error, ZBUFRAND_ERR_INVALID_ARG, 0, "env: alloc_fn and free_fn go together");
        return ZBUFRAND_ERR_INVALID_ARG;
    }
    mem->allocator = env->allocator;
    mem->limit = env->memory_limit;
    if (mem->allocator.alloc_fn == NULL) {
        mem->allocator.alloc_fn = zbufrandi_default_alloc;
        mem->allocator.free_fn = zbufrandi_default_free;
    }
    return ZBUFRAND_OK;
}

/* ---------------------------------------------------------------------------
   math: small vectors, own polynomials (libm differs between platforms),       // >>math
   Morton codes, octahedral normals, sRGB, hashes.
   --------------------------------------------------------------------------- */

ZBUFRANDI_INLINE int zbufrandi_finite_f(float x) { return x - x == 0.0f; }
ZBUFRANDI_INLINE int zbufrandi_finite(double x) { return x - x == 0.0; }
ZBUFRANDI_INLINE double zbufrandi_min(double a, double b) { return a < b ? a : b; }
ZBUFRANDI_INLINE double zbufrandi_max(double a, double b) { return a > b ? a : b; }
ZBUFRANDI_INLINE double zbufrandi_abs(double a) { return a < 0 ? -a : a; }
ZBUFRANDI_INLINE float zbufrandi_absf(float a) { return a < 0 ? -a : a; }
ZBUFRANDI_INLINE float zbufrandi_dot3(const float *a, const float *b) { return a[0] * b[0] + a[1] * b[1] + a[2] *
                                                                       b[2]; }

/* floor for |x| < 2^62 */
ZBUFRANDI_INLINE int64_t zbufrandi_floor(double x) {
    int64_t i = (int64_t)x;
    return i - ((double)i > x);
}

ZBUFRANDI_INLINE int zbufrandi_normalize(float v[3]) { /* 0: no direction, v unchanged */
    double x = (double)v[0], y = (double)v[1], z = (double)v[2], l = x * x + y * y + z * z;
    if (!(l > 0.0) || !zbufrandi_finite(l)) return 0;
    l = 1.0 / sqrt(l);
    v[0] = (float)(x * l);
    v[1] = (float)(y * l);
    v[2] = (float)(z * l);
    return 1;
}

/* 2^x, relative error < 1e-13; 0 below -1000 and for NaN, 2^1000 above 1000 */
static ZBUFRANDI_UNUSED double zbufrandi_exp2(double x) {
    double f, r = 1.0, p = 1.0, scale;
    uint64_t bits;
    int64_t n;
    int i;
    if (!(x >= -1000.0)) return 0.0;
    x = x < 1000.0 ? x : 1000.0;
    n = zbufrandi_floor(x + 0.5);
    f = (x - (double)n) * 0.69314718055994530942;
    bits = (uint64_t)(n + 1023) << 52;
    for (i = 1; i < 13; i++) {
        p = p * f / (double)i;
        r = r + p;
    }
    memcpy(&scale, &bits, sizeof scale);
    return r * scale;
}

/* log2(x) for normal x > 0; absolute error < 1e-13 */
static ZBUFRANDI_UNUSED double zbufrandi_log2(double x) {
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

static ZBUFRANDI_UNUSED double zbufrandi_pow(double x, double y) {
    return x > 0.0 ? zbufrandi_exp2(y * zbufrandi_log2(x)) : 0.0;
}

/* sin and cos of |x| < 1e5; absolute error below 1e-15 up to 10, 1e-11 up to 1e5 */
static ZBUFRANDI_UNUSED void zbufrandi_sincos(double x, double *s, double *c) {
    int64_t q = zbufrandi_floor(x * 0.63661977236758134308 + 0.5);
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

ZBUFRANDI_INLINE uint64_t zbufrandi_spread3(uint64_t x) { /* 21 bits, two zeros between each */
    x &= 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffffu;
    x = (x | x << 16) & 0x1f0000ff0000ffu;
    x = (x | x << 8) & 0x100f00f00f00f00fu;
    x = (x | x << 4) & 0x10c30c30c30c30c3u;
    x = (x | x << 2) & 0x1249249249249249u;
    return x;
}
ZBUFRANDI_INLINE uint32_t zbufrandi_compact3(uint64_t x) {
    x &= 0x1249249249249249u;
    x = (x | x >> 2) & 0x10c30c30c30c30c3u;
    x = (x | x >> 4) & 0x100f00f00f00f00fu;
    x = (x | x >> 8) & 0x1f0000ff0000ffu;
    x = (x | x >> 16) & 0x1f00000000ffffu;
    x = (x | x >> 32) & 0x1fffffu;
    return (uint32_t)x;
}
ZBUFRANDI_INLINE uint64_t zbufrandi_morton(uint32_t x, uint32_t y, uint32_t z) {
    return zbufrandi_spread3(x) | zbufrandi_spread3(y) << 1 | zbufrandi_spread3(z) << 2;
}

ZBUFRANDI_INLINE uint64_t zbufrandi_hash_mix(uint64_t h, uint64_t v) {
    h = (h ^ v) * 0x9e3779b97f4a7c15u;
    return h ^ (h >> 29);
}
/* counter-based random bits */
ZBUFRANDI_INLINE uint32_t zbufrandi_hash32(uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    return x ^ (x >> 16);
}
static ZBUFRANDI_UNUSED uint64_t zbufrandi_hash_bytes(uint64_t h, const void *data, size_t size) {
    const uint8_t *p = (const uint8_t *)data;
    for (; size >= 8; size -= 8, p += 8) h = zbufrandi_hash_mix(h, zbufrandi_load_u64(p));
    for (; size > 0; size--, p++) h = zbufrandi_hash_mix(h, *p);
    return h;
}

/* sRGB byte <-> linear; IEC 61966-2-1 */
static ZBUFRANDI_UNUSED double zbufrandi_srgb_to_linear(double c) {
    return c <= 0.04045 ? c / 12.92 : zbufrandi_pow((c + 0.055) / 1.055, 2.4);
}
static ZBUFRANDI_UNUSED double zbufrandi_linear_to_srgb(double c) {
    if (!(c > 0.0)) return 0.0;
    if (c >= 1.0) return 1.0;
    return c <= 0.0031308 ? c * 12.92 : 1.055 * zbufrandi_pow(c, 1.0 / 2.4) - 0.055;
}
/* table[i] = linear light of sRGB byte i in units of 1/65535, rounded; strictly ascending */
static ZBUFRANDI_UNUSED void zbufrandi_srgb_table(uint32_t table[256]) {
    int i;
    for (i = 0; i < 256; i++) table[i] = (uint32_t)(zbufrandi_srgb_to_linear((double)i / 255.0) * 65535.0 + 0.5);
}
/* nearest table entry in linear light: exact inverse of the table */
static ZBUFRANDI_UNUSED uint32_t zbufrandi_srgb_find(const uint32_t table[256], uint32_t linear) {
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
ZBUFRANDI_INLINE void zbufrandi_oct_decode(uint32_t code, float n[3]) {
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
#if ZBUFRANDI_X64
ZBUFRANDI_INLINE uint32_t zbufrandi_oct_nearest(int ix, int iy, const float m[3]) {
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
    return zbufrandi_ctz64((uint64_t)((uint32_t)_mm_movemask_ps(_mm_cmpeq_ps(fx, fy)) | 16u));
}
#else
ZBUFRANDI_INLINE uint32_t zbufrandi_oct_nearest(int ix, int iy, const float m[3]) {
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

static ZBUFRANDI_UNUSED uint32_t zbufrandi_oct_encode(const float n[3]) {
    float ax = n[0] < 0 ? -n[0] : n[0], ay = n[1] < 0 ? -n[1] : n[1], az = n[2] < 0 ? -n[2] : n[2];
    float s = ax + ay + az, x, y, m[3];
    uint32_t k;
    int ix, iy;
    if (!(s > 1e-38f && s <= 3.402823466e38f)) return 0x8080u; /* no direction */
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
    k = zbufrandi_oct_nearest(ix, iy, m);
    if (k > 3) return 0x8080u; /* NaN */
    ix += (int)(k & 1u);
    iy += (int)(k >> 1);
    return (uint32_t)(ix > 255 ? 255 : ix) | (uint32_t)(iy > 255 ? 255 : iy) << 8;
}


/* ---------------------------------------------------------------------------
   core: camera, key buffer, random numbers. What the sections share.           // >>core

   A picture is decided by one 64-bit key per pixel, smallest wins:
       bits 63..32  depth along the viewing axis, the bits of a positive float
       bits 31..0   a bijective hash of the number of the sample: ties are broken at random, not by order
   ZBUFRANDI_EMPTY (all ones) is an empty pixel. Taking minima is commutative, so the picture does not depend on
   the order of samples or threads. Each draw of a frame (a run of a cached sample set, of samples of a cluster, or the
   triangles of a rastered cluster) owns a range of numbers; colour and normal of the winners are found from the
   number afterwards, because random numbers are a function of (seed, draw, counter).
   --------------------------------------------------------------------------- */

/* ---- work that can be cancelled ---- */

/* Where a call is, as its progress_fn hears it: at `done` of `total`, and each parallel-for takes it `step` further. */
typedef struct zbufrandi_asker {
    uint64_t done, step, total;
    uint32_t cancelled; /* atomic */
} zbufrandi_asker;

/* 0: cancelled. more: done since the step before. */
static ZBUFRANDI_UNUSED int zbufrandi_ask(const zbufrand_env *env, zbufrandi_asker *a, uint64_t more) {
    if (env->progress_fn != NULL && zbufrandi_atomic_load(&a->cancelled) == 0 &&
        env->progress_fn(env->progress_user, a->done + more, a->total) != 0)
            zbufrandi_atomic_store(&a->cancelled, 1u);
    return zbufrandi_atomic_load(&a->cancelled) == 0;
}

/* A parallel-for that asks. Strands are as many tasks as there are threads, each takes piece after piece of the work,
   and the first one asks. */
typedef struct zbufrandi_asking {
    const zbufrand_env *env;
    zbufrandi_asker *asker;
    zbufrand_task_fn *task;
    void *ctx;
    uint32_t count, next; /* atomic: next */
} zbufrandi_asking;

static ZBUFRANDI_UNUSED void zbufrandi_task_asking(void *ctx, uint32_t strand) {
    zbufrandi_asking *k = (zbufrandi_asking *)ctx;
    for (;;) {
        const uint32_t i = zbufrandi_atomic_add(&k->next, 1u) - 1u;
        if (i >= k->count || zbufrandi_atomic_load(&k->asker->cancelled) != 0) return;
        if (strand == 0 && !zbufrandi_ask(k->env, k->asker, k->asker->step * i / k->count)) return;
        k->task(k->ctx, i);
    }
}

/* 0: cancelled, and only a part is done, or nothing if that was so before. asker: NULL to ask nobody. */
static ZBUFRANDI_UNUSED int zbufrandi_parallel_ask(const zbufrand_env *env, zbufrandi_asker *asker,
                                                   zbufrand_task_fn *task, void *ctx, uint32_t count) {
    const uint32_t strands = zbufrandi_thread_count(env);
    zbufrandi_asking k;
    if (asker == NULL || env->progress_fn == NULL) {
        zbufrandi_parallel_for(env, task, ctx, count);
        return 1;
    }
    if (asker->cancelled) return 0;
    k.env = env;
    k.asker = asker;
    k.task = task;
    k.ctx = ctx;
    k.count = count;
    k.next = 0;
    zbufrandi_parallel_for(env, zbufrandi_task_asking, &k, strands < count ? strands : count);
    asker->done += asker->step;
    return !asker->cancelled;
}

#define ZBUFRANDI_EMPTY (~(uint64_t)0)

typedef struct zbufrandi_camera {
    double eye[3];
    double right[3], up[3], dir[3];  /* orthonormal; dir along the view */
    double focal;                    /* pixels */
    double center_x, center_y;       /* width / 2, height / 2 */
    double near_z, far_z;            /* > 0; far_z may be INFINITY */
    uint32_t width, height;
    double side[4][2];               /* left, right, top, bottom of the picture: x, x, y, y and z of a unit normal that
                                        points inwards; zbufrandi_camera_sides fills them in */
} zbufrandi_camera;
/* Camera space (x right, y up, z along dir) to picture: px = center_x + focal * x / z, py = center_y - focal * y / z;
   pixel (i, j) = (floor px, floor py), row 0 on top. */

typedef struct zbufrandi_keys {
    uint32_t width, height;
    uint64_t *key;                   /* width * height, row 0 on top */
} zbufrandi_keys;

/* The inverse of zbufrandi_hash32, which is a bijection (lowbias32 constants). */
ZBUFRANDI_INLINE uint32_t zbufrandi_unmix(uint32_t x) {
    x ^= x >> 16;
    x *= 0x43021123u;
    x ^= x >> 15 ^ x >> 30;
    x *= 0x1d69e2a5u;
    return x ^ (x >> 16);
}
#if ZBUFRANDI_AVX2
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256i zbufrandi_mix8(__m256i x) {
    x = _mm256_xor_si256(x, _mm256_srli_epi32(x, 16));
    x = _mm256_mullo_epi32(x, _mm256_set1_epi32(0x7feb352d));
    x = _mm256_xor_si256(x, _mm256_srli_epi32(x, 15));
    x = _mm256_mullo_epi32(x, _mm256_set1_epi32((int)0x846ca68bu));
    return _mm256_xor_si256(x, _mm256_srli_epi32(x, 16));
}
#endif
ZBUFRANDI_INLINE uint64_t zbufrandi_key(float z, uint32_t number) { /* z > 0 */
    uint32_t bits;
    memcpy(&bits, &z, sizeof bits);
    return (uint64_t)bits << 32 | zbufrandi_hash32(number);
}
ZBUFRANDI_INLINE float zbufrandi_key_depth(uint64_t key) {
    uint32_t bits = (uint32_t)(key >> 32);
    float z;
    memcpy(&z, &bits, sizeof z);
    return z;
}
ZBUFRANDI_INLINE uint32_t zbufrandi_key_number(uint64_t key) { return zbufrandi_unmix((uint32_t)key); }

/* Smallest key wins; any number of threads. Success is rare (the n-th sample of a pixel wins once in n times), so a
   plain load and compare comes first. */
#if defined(__GNUC__) || defined(__clang__)
typedef uint64_t zbufrandi_key64 __attribute__((aligned(8))); /* key buffers are; 32-bit machines do not know */
ZBUFRANDI_INLINE void zbufrandi_key_min(uint64_t *to, uint64_t key) {
    zbufrandi_key64 *at = (zbufrandi_key64 *)(void *)to;
    uint64_t seen = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (key < seen) {
        zbufrandi_key64 old = seen;
        if (__atomic_compare_exchange_n(at, &old, key, 1, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) return;
        seen = old;
    }
}
#else
ZBUFRANDI_INLINE void zbufrandi_key_min(uint64_t *at, uint64_t key) { if (key < *at) *at = key; }
#endif

/* ---- the bytes of a structure ----

   A structure is a prototype in its own coordinates: triangles in clusters, instances of other structures, one tree
   over both. Structure 0 is the scene itself. Positions are floats relative to `origin`, so that a structure far away
   from zero loses nothing; the same vertex has the same three floats in every cluster (no cracks).

   cluster   1..128 triangles of one mesh, at most 256 vertices. Vertex k of the cluster is
             position[3 * (first_vertex + k) ..]; triangle t has the corners triangle[3 * (first_triangle + t) ..], each
             a local vertex index; outward normal = (p1 - p0) x (p2 - p0).
   node8     up to 8 children, one lane each. Lanes >= count hold empty boxes (lo = INFINITY, hi = -INFINITY), area 0.
   child     two bits of kind, 30 bits of index (below 2^29): node, cluster or instance.
   local     the camera as seen from a structure, one per path of instances that a frame entered.
   set       64 points of the surface under a child, area-uniform, in an order in which every aligned run of a power of
             two is spread over all of it: 8 bytes a point.
                 word 0   bits 0..10 x, 11..20 y, 21..30 z in the box of the set, bit 31: seen from both sides
                 word 1   bits 0..15, 16..31: octahedral geometric normal
             Set of cluster i: i. Set of node i: cluster_count + i. An instance uses the set of its structure's node
             0.
   views     what many instances share is mostly seen from afar, where half of its area and more faces away: four more
             sets for each of 96 directions of view v, in which a point with normal n is as likely as
             min(1, n . v + reach) makes it (seen from both sides: |n . v|). Sets of direction i: first_view + 4 i.
   more      what is made of instances and drawn many times shows the same 64 points wherever it is far away; m = 64 or
             256 sets of the whole, first_more + v, and m / 8 of each child i of node 0, first_more + m + m / 8 i + v,
             of which each instance takes one, make the mean colour there right. */

#define ZBUFRANDI_CLUSTER_TRIANGLES 128
#define ZBUFRANDI_CLUSTER_VERTICES 256
#define ZBUFRANDI_SET 64
#define ZBUFRANDI_VIEWS 96       /* directions: 4 x 4 cells on each side of a cube */
#define ZBUFRANDI_VIEW_SETS 4
#define ZBUFRANDI_MORE_SETS 64   /* powers of two */
#define ZBUFRANDI_MORE_SETS_MANY 256
#define ZBUFRANDI_MORE_PARTS 8   /* as many less of each part */
#define ZBUFRANDI_MORE_ALL 131072 /* in all: so many, and as many as there are without them; 64 MB and as much */

enum { ZBUFRANDI_CHILD_NODE = 0, ZBUFRANDI_CHILD_CLUSTER = 1, ZBUFRANDI_CHILD_INSTANCE = 2, ZBUFRANDI_CHILD_NONE = 3 };
#define ZBUFRANDI_CHILD(kind, index) ((uint32_t)(kind) << 30 | (uint32_t)(index))
#define ZBUFRANDI_CHILD_KIND(c) ((c) >> 30)
#define ZBUFRANDI_CHILD_INDEX(c) ((c) & 0x3fffffffu)

enum { /* flags of clusters; children of nodes have only the first: some triangle below is seen from both sides */
    ZBUFRANDI_TWO_SIDED = 1, ZBUFRANDI_HAS_NORMALS = 2, ZBUFRANDI_HAS_VERTEX_RGB = 4, ZBUFRANDI_HAS_TRIANGLE_RGB = 8
};

typedef struct zbufrandi_cluster {
    uint32_t first_vertex, first_triangle;
    uint16_t vertex_count;      /* 1..256 */
    uint8_t triangle_count;     /* 1..128 */
    uint8_t flags;
    uint32_t mesh;              /* index into scene->mesh: attributes, material, node for messages */
    float box_lo[3], box_hi[3]; /* exact: the box of the vertices */
} zbufrandi_cluster;

typedef struct zbufrandi_node8 {
    float lo[3][8], hi[3][8];   /* boxes, rounded outwards */
    float axis[3][8];           /* cone of the geometric normals: unit axis, cosine of the half angle (rounded down) */
    float cosine[8];            /* -1: all directions */
    float o_lo[8], o_hi[8];     /* bounds of n . (s - centre of the box) over the surface points s, n their normal */
    float area[8];              /* of the surface under the child, in units of the structure */
    float edge[8];              /* longest edge of a triangle under the child; INFINITY never occurs */
    uint64_t triangles[8];      /* under the child, instances counted as often as they occur */
    uint32_t child[8];          /* ZBUFRANDI_CHILD(kind, index) */
    uint8_t flags[8];
    uint32_t count;             /* children 0..count-1 are used */
    uint32_t _pad;
} zbufrandi_node8;

typedef struct zbufrandi_instance {
    double to_parent[3][4];     /* p_parent - origin_parent = to_parent * (p - origin, 1) */
    double scale;               /* > 0: length in the parent per length here */
    uint32_t structure;
    uint32_t mirrored;          /* determinant < 0 */
    uint32_t node;              /* of the scene graph, for messages */
    uint32_t hidden;            /* 1: not drawn: in no tree */
} zbufrandi_instance;

typedef struct zbufrandi_view { /* a direction of view: from the structure to the eye */
    float axis[3];                  /* unit, middle of the cell */
    float reach;                    /* no direction of the cell, nor that of a point as seen from another, is further */
    float area;                     /* of the structure, each point times min(1, n . axis + reach) */
} zbufrandi_view;

typedef struct zbufrandi_structure {
    double origin[3];
    float *position;                /* [3 * vertex_count], and 96 bytes more that may be read */
    uint8_t *triangle;              /* [3 * triangle_count], and 48 bytes more that may be read */
    zbufrandi_cluster *cluster;
    zbufrandi_node8 *node;          /* node 0 is the root; children come after their parent; none: node_count 0 */
    zbufrandi_instance *instance;
    uint32_t *set;                  /* [(cluster_count + node_count) * 64 * 2], and views */
    zbufrandi_view *view;           /* [ZBUFRANDI_VIEWS]; NULL: none */
    uint16_t *vertex_normal;        /* octahedral 8+8 per vertex; NULL: no mesh of the structure has normals */
    uint8_t *vertex_rgb;            /* sRGB, 3 per vertex; NULL: no mesh has any */
    uint8_t *triangle_rgb;          /* sRGB, 3 per triangle; NULL: no mesh has any */
    uint32_t *triangle_id;          /* index within its mesh; NULL: not kept */
    uint32_t *set_rgb;              /* per point of the sets: sRGB, red lowest; NULL: everything is white */
    uint16_t *set_normal;           /* octahedral 8+8 shading normals; NULL: the geometric ones */
    uint32_t *set_material;         /* NULL: all as `material` */
    uint32_t vertex_count, triangle_count, cluster_count, node_count, instance_count;
    uint32_t first_view;            /* set of the first direction of view; 0: there are none, or an edit spoilt them */
    uint32_t first_more;            /* first of more sets of the whole, then of the children of node 0; 0: as above */
    uint32_t more;                  /* how many of the whole */
    uint32_t material;
    float box_lo[3], box_hi[3];     /* of everything, rounded outwards */
    float radius;                   /* of a ball around the middle of that box that holds it all, stored points, too */
    struct zbufrandi_lists *lists;  /* the thesis' trees; NULL: not asked for */
    double *item_sum;               /* [cluster_count + instance_count + 1] areas added up: clusters, then instances */
    double area;                    /* all triangles, instances included, in units of the structure */
    uint64_t virtual_triangles;     /* all triangles, instances included */
    uint32_t depth;                 /* levels of instances below, 0: none */
    uint32_t sum_stale;             /* 1: item_sum is from before an edit */
} zbufrandi_structure;

/* Camera coordinates (world units) of point p of the structure: m * (p - eye) + rest. Subtracting eye first is exact
   for what is near, so that nothing trembles however large the structure is. */
typedef struct zbufrandi_local { /* 192 bytes, there are 10^5 of them: the first 64 are what colours read */
    float m[3][3];              /* rows: right, up, dir; times scale */
    float eye[3];               /* the eye in coordinates of the structure */
    float eye_low[3];           /* what rounding it to float lost: the eye is eye + eye_low */
    uint32_t structure;
    float rest[3];              /* eye_low in camera coordinates */
    float scale;                /* world length per length of the structure */
    uint32_t mirrored;          /* the path has an odd number of mirrors: screen orientation of triangles is reversed */
    uint32_t hash;              /* of the path, for random numbers */
    uint32_t parent, instance;  /* local this one was entered from, and by which instance; ~0: the root */
    double to_camera[3][4];     /* the same in double: camera coordinates = to_camera * (p, 1) */
} zbufrandi_local;

typedef struct zbufrandi_sides { /* of a local: what tests of boxes take */
    float side[4][3], side_e[4][3]; /* planes left, right, top, bottom of the picture in the structure's directions:
                                   side . (p - eye) >= 0 inside; what half extents of a box add */
    float z_e[3], xy_e[2][3];   /* what half extents add to a depth, to x and y */
} zbufrandi_sides;

/* ---- colours ---- */

typedef struct zbufrandi_srgb {
    float linear[256];    /* of a byte */
    float from[257];      /* byte b is what values in [from[b], from[b+1]) are written as */
    uint8_t start[4097];  /* byte of the value i/4096: at most one border lies between two of them */
} zbufrandi_srgb;

static ZBUFRANDI_UNUSED void zbufrandi_srgb_open(zbufrandi_srgb *s) {
    uint32_t i, b = 0;
    for (i = 0; i < 256; i++) {
        s->linear[i] = (float)zbufrandi_srgb_to_linear((double)i / 255.0);
        s->from[i] = i == 0 ? 0.0f : (float)zbufrandi_srgb_to_linear(((double)i - 0.5) / 255.0);
    }
    s->from[256] = INFINITY;
    for (i = 0; i <= 4096; i++) {
        while ((float)i * (1.0f / 4096.0f) >= s->from[b + 1]) b++;
        s->start[i] = (uint8_t)b;
    }
}

/* linear value -> nearest sRGB byte */
ZBUFRANDI_INLINE uint8_t zbufrandi_srgb_byte(const zbufrandi_srgb *s, float v) {
    uint32_t b;
    if (!(v > 0.0f)) return 0;
    if (v >= 1.0f) return 255;
    b = s->start[(uint32_t)(int32_t)(v * 4096.0f)];
    return (uint8_t)(b + (v >= s->from[b + 1]));
}

/* ---------------------------------------------------------------------------
   scene: the graph as the caller made it, its checks, and how it is cut into   // >>scene
   structures.

   A node that is the target of a reference, or is flagged as own structure, becomes a structure; everything else melts
   into the structure that encloses it: its meshes become pieces (mesh, transform), what refers to structures becomes
   instances. Structure 0 is the root; a structure comes before those that it has instances of.
   --------------------------------------------------------------------------- */

enum { ZBUFRANDI_LIST = 0, ZBUFRANDI_MESH = 1, ZBUFRANDI_REFERENCES = 2, ZBUFRANDI_DEAD = 3 /* removed */ };
enum { ZBUFRANDI_MAX_LEVELS = 64, ZBUFRANDI_MESH_TRIANGLES = 1 << 28 };
enum { ZBUFRANDI_STRUCTURE_ITEMS = 1 << 28 }; /* clusters and instances of a structure are fewer */

typedef struct zbufrandi_graph {     /* one node of the scene graph */
    double m[3][4];                  /* node to parent */
    const zbufrand_transform *transforms; /* of references, borrowed; NULL: one, m */
    size_t count;                    /* of transforms */
    uint32_t kind, flags;
    uint32_t parent;                 /* the list it is in; 0: none */
    uint32_t next, prev;             /* in that list; 0: none. Dead nodes: the next one to be given out again */
    uint32_t first, last;            /* of a list's members; 0: none */
    uint32_t target;                 /* of references: a node; of a mesh: its index */
    uint32_t state;                  /* while a build walks: 0 not seen, 1 on the path, 2 done */
    uint32_t structure;              /* index + 1; 0: melts, or was not built */
    uint32_t levels;                 /* of instances below a structure */
    uint32_t refs;                   /* nodes that refer to it */
    /* What stands for it in the structure that it is part of (index + 1; 0: nothing was built): clusters of a mesh that
       melted, else instances. */
    uint32_t home, item, item_count;
    uint32_t pending;                /* index + 1 of what waits for zbufrand_scene_update; 0: nothing */
} zbufrandi_graph;

typedef struct zbufrandi_mesh {
    zbufrand_mesh m;
    uint32_t node;                   /* of the graph; not in use: index + 1 of the next that is not */
} zbufrandi_mesh;

typedef struct zbufrandi_pending {   /* a node that is new or was moved since the last update */
    double old[3][4];                /* node to parent, as it was built */
    uint32_t node;
    uint32_t moved;                  /* 0: new */
} zbufrandi_pending;

typedef struct zbufrandi_gone {      /* what stood for a node that was removed */
    uint32_t node;                   /* to be given out again */
    uint32_t home, item, item_count, clusters; /* as in the graph; clusters: 1, instances: 0 */
    uint32_t structure;              /* its own, index + 1; 0: none */
    uint32_t mesh;                   /* index + 1; 0: none */
} zbufrandi_gone;

typedef struct zbufrandi_set {       /* one reference out of many, changed */
    double m[3][4];
    uint32_t node, index;
    uint32_t drawn, _pad;
} zbufrandi_set;

struct zbufrand_scene {
    zbufrandi_mem mem;
    zbufrand_env env;
    zbufrandi_graph *graph;          /* [0] is no node */
    size_t graph_count, graph_capacity;
    zbufrandi_mesh *mesh;
    size_t mesh_count, mesh_capacity;
    zbufrandi_structure *structure;  /* what was built */
    uint32_t structure_count;
    uint32_t seed;
    struct zbufrandi_rays *rays;     /* what rays through the structures need besides */
    zbufrand_scene_info info;
    zbufrand_build_desc built;       /* how it was built */
    size_t before;                   /* bytes held before that */
    uint64_t skipped;
    struct zbufrandi_live *live;     /* what edits need to know of the structures; made by the first update */
    zbufrandi_pending *pending;      /* edits since the last build or update */
    zbufrandi_gone *gone;
    zbufrandi_set *set;
    size_t pending_count, pending_capacity, gone_count, gone_capacity, set_count, set_capacity;
    uint32_t free_first, free_last, free_count; /* dead nodes */
    uint32_t free_mesh;              /* index + 1 */
    uint32_t stamp;                  /* of walks that mark nodes by their state */
};

static int zbufrandi_scene_rays(zbufrand_scene *scene); /* make rays ready; 0: no memory */
static void zbufrandi_scene_rays_free(zbufrand_scene *scene);
static zbufrand_result zbufrandi_scene_lists(zbufrand_scene *scene, const zbufrand_build_desc *desc);
static void zbufrandi_lists_free(zbufrandi_mem *mem, struct zbufrandi_lists *lists);
static void zbufrandi_scene_lists_free(zbufrand_scene *scene);
static void zbufrandi_list_totals(const zbufrand_scene *scene, zbufrand_scene_info *info);

/* ---- small matrices, 3x4, double ---- */

#define ZBUFRANDI_M34(m) ((const double (*)[4])(m)) /* C wants to be told that the rows become const */

static void zbufrandi_m34_identity(double m[3][4]) {
    memset(m, 0, 12 * sizeof(double));
    m[0][0] = m[1][1] = m[2][2] = 1.0;
}

static void zbufrandi_m34_mul(const double a[3][4], const double b[3][4], double out[3][4]) { /* out = a after b */
    double r[3][4];
    int i, j;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 4; j++) {
            r[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j] + (j == 3 ? a[i][3] : 0.0);
        }
    }
    memcpy(out, r, sizeof r);
}

ZBUFRANDI_INLINE void zbufrandi_m34_point(const double m[3][4], const double p[3], double out[3]) {
    double x = p[0], y = p[1], z = p[2];
    int i;
    for (i = 0; i < 3; i++) out[i] = m[i][0] * x + m[i][1] * y + m[i][2] * z + m[i][3];
}

ZBUFRANDI_INLINE double zbufrandi_m34_det(const double m[3][4]) {
    return m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
           m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

/* What columns of a similarity may differ by in their lengths, and be off right angles: those of the caller's, and what
   these amount to when lists are in lists. */
#define ZBUFRANDI_SIMILAR 1e-5
#define ZBUFRANDI_SIMILAR_PRODUCT 1e-4

/* Scale of a similarity; 0 if m is none: columns of equal length and at right angles within `tolerance`, all finite. */
static double zbufrandi_m34_scale(const double m[3][4], double tolerance) {
    double g[3][3], mean, largest = 0.0;
    int i, j, k;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 4; j++) if (!(zbufrandi_abs(m[i][j]) < 1e150)) return 0.0;
        for (j = 0; j < 3; j++) largest = zbufrandi_max(largest, zbufrandi_abs(m[i][j]));
    }
    if (!(largest > 1e-150)) return 0.0;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) {
            g[i][j] = 0.0;
            for (k = 0; k < 3; k++) g[i][j] += (m[k][i] / largest) * (m[k][j] / largest);
        }
    }
    mean = (g[0][0] + g[1][1] + g[2][2]) / 3.0;
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) if (!(zbufrandi_abs(g[i][j] - (i == j ? mean : 0.0)) <= tolerance * mean)) return 0.0;
    }
    return largest * sqrt(mean);
}

/* ---- the graph ---- */

ZBUFRAND_DEF zbufrand_result zbufrand_scene_create(const zbufrand_scene_desc *desc, zbufrand_scene **out_scene) {
    zbufrand_scene_desc d;
    zbufrandi_mem mem;
    zbufrand_scene *scene;
    zbufrand_result r;
    if (out_scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    *out_scene = NULL;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    r = zbufrandi_env_open(&d.env, &mem);
    if (r != ZBUFRAND_OK) return r;
    scene = (zbufrand_scene *)zbufrandi_alloc_zero(&mem, 1, sizeof *scene);
    if (scene != NULL) {
        scene->mem = mem;
        scene->env = d.env;
        if (zbufrandi_grow(&scene->mem, (void **)&scene->graph, &scene->graph_capacity, 0, 16, sizeof *scene->graph)) {
            memset(scene->graph, 0, 2 * sizeof *scene->graph);
            scene->graph_count = 2;
            zbufrandi_m34_identity(scene->graph[1].m);
            *out_scene = scene;
            return ZBUFRAND_OK;
        }
        mem = scene->mem;
        zbufrandi_free(&mem, scene);
    }
    return zbufrandi_fail(d.env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "no memory for a scene");
}

static void zbufrandi_structures_free(zbufrand_scene *scene);
static void zbufrandi_live_free(zbufrand_scene *scene);

ZBUFRAND_DEF void zbufrand_scene_destroy(zbufrand_scene *scene) {
    zbufrandi_mem mem;
    if (scene == NULL) return;
    zbufrandi_structures_free(scene);
    zbufrandi_free(&scene->mem, scene->pending);
    zbufrandi_free(&scene->mem, scene->gone);
    zbufrandi_free(&scene->mem, scene->set);
    zbufrandi_free(&scene->mem, scene->graph);
    zbufrandi_free(&scene->mem, scene->mesh);
    mem = scene->mem;
    zbufrandi_free(&mem, scene);
}

enum { ZBUFRANDI_DEAD_NODES = 1024 }; /* so many removed nodes keep their numbers, so that old handles are noticed */

/* Room in the list of edits for a node. 0: no memory. */
static int zbufrandi_pending_room(zbufrand_scene *scene) {
    return scene->structure_count == 0 ||
           zbufrandi_grow(&scene->mem, (void **)&scene->pending, &scene->pending_capacity, scene->pending_count,
                          scene->pending_count + 1, sizeof *scene->pending);
}

/* There is room. A node that waits already stays as it is: its first old place is what was built. */
static void zbufrandi_pending_add(zbufrand_scene *scene, uint32_t node, uint32_t moved, const double old[3][4]) {
    zbufrandi_pending *p;
    if (scene->structure_count == 0 || scene->graph[node].pending != 0) return;
    p = &scene->pending[scene->pending_count++];
    memcpy(p->old, old, sizeof p->old);
    p->node = node;
    p->moved = moved;
    scene->graph[node].pending = (uint32_t)scene->pending_count;
}

/* Room for one more node, unlisted. 0 and *r on failure. */
static uint32_t zbufrandi_node_new(zbufrand_scene *scene, uint32_t kind, uint32_t parent,
                                   const zbufrand_transform *transform, uint32_t flags, zbufrand_result *r) {
    zbufrand_error *e = scene->env.error;
    zbufrandi_graph *n;
    uint32_t node, after;
    *r = ZBUFRAND_OK;
    if (parent >= scene->graph_count || (parent != 0 && scene->graph[parent].kind != ZBUFRANDI_LIST)) {
        *r = zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, parent, "parent %: not a list of this scene");
    } else if (transform != NULL && zbufrandi_m34_scale(ZBUFRANDI_M34(transform->m), ZBUFRANDI_SIMILAR) == 0.0) {
        *r = zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, scene->graph_count, "node %: the transform is no similarity");
    } else if (flags > (ZBUFRAND_HIDDEN | ZBUFRAND_OWN_STRUCTURE)) {
        *r = zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, scene->graph_count, "node %: unknown flags");
    } else if (scene->free_count <= ZBUFRANDI_DEAD_NODES && scene->graph_count >= ((size_t)1 << 30)) {
        *r = zbufrandi_fail(e, ZBUFRAND_ERR_RANGE, scene->graph_count, "node %: too many nodes");
    } else if (!zbufrandi_grow(&scene->mem, (void **)&scene->graph, &scene->graph_capacity, scene->graph_count,
                               scene->graph_count + 1, sizeof *scene->graph) || !zbufrandi_pending_room(scene)) {
        *r = zbufrandi_fail(e, ZBUFRAND_ERR_NO_MEMORY, scene->graph_count, "node %: out of memory");
    }
    if (*r != ZBUFRAND_OK) return 0;
    node = scene->free_count > ZBUFRANDI_DEAD_NODES ? scene->free_first : (uint32_t)scene->graph_count;
    n = &scene->graph[node];
    after = node == scene->graph_count ? 0 : n->next;
    memset(n, 0, sizeof *n);
    n->next = after;
    n->kind = node == scene->graph_count ? kind : (uint32_t)ZBUFRANDI_DEAD;
    n->flags = flags;
    if (transform != NULL) memcpy(n->m, transform->m, sizeof n->m);
    else zbufrandi_m34_identity(n->m);
    return node;
}

/* The new node becomes visible: it is counted and put at the end of its list. */
static void zbufrandi_node_enter(zbufrand_scene *scene, uint32_t parent, uint32_t node) {
    zbufrandi_graph *g = scene->graph;
    g[node].parent = parent;
    if (parent == 0) return;
    g[node].prev = g[parent].last;
    if (g[parent].last != 0) g[g[parent].last].next = node;
    else g[parent].first = node;
    g[parent].last = node;
    zbufrandi_pending_add(scene, node, 0, ZBUFRANDI_M34(g[node].m));
}

/* What zbufrandi_node_new found room for is a node from now on. */
static void zbufrandi_node_take(zbufrand_scene *scene, uint32_t kind, uint32_t node) {
    zbufrandi_graph *n = &scene->graph[node];
    n->kind = kind;
    if (node == scene->graph_count) {
        scene->graph_count++;
        return;
    }
    scene->free_first = n->next;
    scene->free_count--;
    n->next = 0;
}

ZBUFRAND_DEF zbufrand_result zbufrand_add_list(zbufrand_scene *scene, zbufrand_node parent,
                                               const zbufrand_transform *transform, uint32_t flags,
                                               zbufrand_node *out_node) {
    zbufrand_result r;
    uint32_t n;
    if (out_node != NULL) *out_node = 0;
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    n = zbufrandi_node_new(scene, ZBUFRANDI_LIST, parent, transform, flags, &r);
    if (n == 0) return r;
    zbufrandi_node_take(scene, ZBUFRANDI_LIST, n);
    zbufrandi_node_enter(scene, parent, n);
    if (out_node != NULL) *out_node = n;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_add_mesh(zbufrand_scene *scene, zbufrand_node parent,
                                               const zbufrand_transform *transform, uint32_t flags,
                                               const zbufrand_mesh *mesh, zbufrand_node *out_node) {
    zbufrand_result r;
    zbufrand_mesh m;
    uint32_t n, at;
    if (out_node != NULL) *out_node = 0;
    if (scene == NULL || mesh == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    n = zbufrandi_node_new(scene, ZBUFRANDI_MESH, parent, transform, flags, &r);
    if (n == 0) return r;
    m = *mesh;
    if (m.position_stride == 0) m.position_stride = 3 * sizeof(float);
    if (m.normal_stride == 0) m.normal_stride = 3 * sizeof(float);
    if (m.vertex_rgb_stride == 0) m.vertex_rgb_stride = 3;
    if (m.triangle_count != 0 &&
        (m.positions == NULL || (m.indices == NULL && m.triangle_count > m.vertex_count / 3))) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, n, "mesh %: triangles without vertices");
    }
    if (m.position_stride < 12 || m.normal_stride < 12 || m.vertex_rgb_stride < 3 || m.two_sided > 1) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, n, "mesh %: a stride or a flag is wrong");
    }
    if (m.triangle_count > ZBUFRANDI_MESH_TRIANGLES || m.vertex_count > 0xffffffffu) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, n,
                              "mesh %: more than 2^28 triangles or 2^32 vertices");
    }
    if (!zbufrandi_grow(&scene->mem, (void **)&scene->mesh, &scene->mesh_capacity, scene->mesh_count,
                        scene->mesh_count + 1, sizeof *scene->mesh)) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, n, "mesh %: out of memory");
    }
    at = scene->free_mesh != 0 ? scene->free_mesh - 1 : (uint32_t)scene->mesh_count++;
    if (scene->free_mesh != 0) scene->free_mesh = scene->mesh[at].node;
    scene->mesh[at].m = m;
    scene->mesh[at].node = n;
    scene->graph[n].target = at;
    zbufrandi_node_take(scene, ZBUFRANDI_MESH, n);
    zbufrandi_node_enter(scene, parent, n);
    if (out_node != NULL) *out_node = n;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_add_reference(zbufrand_scene *scene, zbufrand_node parent,
                                                    const zbufrand_transform *transform, zbufrand_node target,
                                                    zbufrand_node *out_node) {
    zbufrand_result r;
    uint32_t n;
    if (out_node != NULL) *out_node = 0;
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    n = zbufrandi_node_new(scene, ZBUFRANDI_REFERENCES, parent, transform, 0, &r);
    if (n == 0) return r;
    if (target == 0 || target == n || target >= scene->graph_count || scene->graph[target].kind == ZBUFRANDI_DEAD) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, n, "reference %: no such target");
    }
    scene->graph[n].target = target;
    scene->graph[n].count = 1;
    scene->graph[target].refs++;
    zbufrandi_node_take(scene, ZBUFRANDI_REFERENCES, n);
    zbufrandi_node_enter(scene, parent, n);
    if (out_node != NULL) *out_node = n;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_add_references(zbufrand_scene *scene, zbufrand_node parent,
                                                     const zbufrand_transform *transforms, size_t count,
                                                     zbufrand_node target, zbufrand_node *out_node) {
    zbufrand_result r;
    uint32_t n;
    if (out_node != NULL) *out_node = 0;
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (transforms == NULL && count != 0) return ZBUFRAND_ERR_INVALID_ARG;
    r = zbufrand_add_reference(scene, parent, NULL, target, &n);
    if (r != ZBUFRAND_OK) return r;
    scene->graph[n].transforms = transforms;
    scene->graph[n].count = count;
    if (out_node != NULL) *out_node = n;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_list_append(zbufrand_scene *scene, zbufrand_node list, zbufrand_node node) {
    zbufrandi_graph *g;
    zbufrand_error *e;
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    g = scene->graph;
    e = scene->env.error;
    if (list == 0 || list >= scene->graph_count || g[list].kind != ZBUFRANDI_LIST) {
        return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, list, "node %: not a list of this scene");
    }
    if (node == 0 || node >= scene->graph_count || g[node].kind == ZBUFRANDI_DEAD) {
        return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, node, "node %: no such node");
    }
    if (node == ZBUFRAND_ROOT)
        return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, node, "node %: the root is in no list");
    if (g[node].parent != 0) return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, node, "node %: already in a list");
    if (!zbufrandi_pending_room(scene)) return zbufrandi_fail(e, ZBUFRAND_ERR_NO_MEMORY, node, "node %: out of memory");
    zbufrandi_node_enter(scene, list, node);
    return ZBUFRAND_OK;
}

/* ---- the graph becomes structures ---- */

typedef struct zbufrandi_piece { /* a mesh melted into a structure */
    double m[3][4];              /* mesh to structure, before the origin is subtracted */
    uint32_t mesh;
} zbufrandi_piece;

typedef struct zbufrandi_gather { /* what a structure consists of; instances hold plain transforms, no origins yet */
    zbufrandi_piece *piece;
    size_t piece_count, piece_capacity;
    zbufrandi_instance *instance;
    size_t instance_count, instance_capacity;
} zbufrandi_gather;

typedef struct zbufrandi_walk { /* stack entry: a node on the path and which of its edges comes next */
    uint32_t node, edge;
} zbufrandi_walk;

/* Next node below `node` after `edge` (0: the first); 0: no more. Hidden members are not walked into. */
static uint32_t zbufrandi_walk_next(const zbufrandi_graph *g, uint32_t node, uint32_t edge) {
    if (g[node].kind == ZBUFRANDI_REFERENCES) return edge == 0 && g[node].count != 0 ? g[node].target : 0;
    if (g[node].kind == ZBUFRANDI_MESH) return 0;
    edge = edge == 0 ? g[node].first : g[edge].next;
    while (edge != 0 && (g[edge].flags & ZBUFRAND_HIDDEN)) edge = g[edge].next;
    return edge;
}

/* Walk everything that is drawn, depth first: finds cycles, marks structures, numbers them so that the root is 0 and
   users come before what they use. *out_order: node of structure i. */
static zbufrand_result zbufrandi_graph_check(zbufrand_scene *scene, uint32_t **out_order, uint32_t *out_count) {
    zbufrandi_graph *g = scene->graph;
    zbufrandi_walk *stack = NULL;
    size_t capacity = 0, depth = 0, i;
    uint32_t *order = NULL, count = 0, k;
    zbufrand_result r = ZBUFRAND_OK;
    for (i = 0; i < scene->graph_count; i++) {
        g[i].state = g[i].levels = g[i].home = g[i].pending = 0;
        g[i].structure = i == ZBUFRAND_ROOT || (g[i].flags & ZBUFRAND_OWN_STRUCTURE) != 0;
    }
    for (i = 1; i < scene->graph_count; i++) {
        if (g[i].kind == ZBUFRANDI_REFERENCES) g[g[i].target].structure = 1;
    }
    order = (uint32_t *)zbufrandi_alloc_array(&scene->mem, scene->graph_count, sizeof *order);
    if (order == NULL || !zbufrandi_grow(&scene->mem, (void **)&stack, &capacity, 0, 64, sizeof *stack)) {
        zbufrandi_free(&scene->mem, order);
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "no memory for the walk through the graph");
    }
    stack[0].node = ZBUFRAND_ROOT;
    stack[0].edge = 0;
    g[ZBUFRAND_ROOT].state = 1;
    depth = 1;
    while (depth > 0 && r == ZBUFRAND_OK) {
        zbufrandi_walk *top = &stack[depth - 1];
        uint32_t node = top->node, below = zbufrandi_walk_next(g, node, top->edge), levels;
        if (below == 0) { /* all below is done */
            g[node].state = 2;
            if (g[node].structure != 0) order[count++] = node;
            levels = g[node].levels + (g[node].structure != 0);
            if (depth > 1 && levels > g[stack[depth - 2].node].levels) g[stack[depth - 2].node].levels = levels;
            depth--;
            continue;
        }
        top->edge = below;
        if (g[node].kind == ZBUFRANDI_REFERENCES && g[below].parent == 0 && below != ZBUFRAND_ROOT) {
            r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, node,
                               "reference %: its target is in no list");
            break;
        }
        if (g[below].state == 1) {
            r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, node, "node %: closes a cycle");
            break;
        }
        if (g[below].state == 2) {
            levels = g[below].levels + (g[below].structure != 0);
            if (levels > g[node].levels) g[node].levels = levels;
            continue;
        }
        if (!zbufrandi_grow(&scene->mem, (void **)&stack, &capacity, depth, depth + 1, sizeof *stack)) {
            r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "no memory for the walk through the graph");
            break;
        }
        g[below].state = 1;
        stack[depth].node = below;
        stack[depth].edge = 0;
        depth++;
    }
    zbufrandi_free(&scene->mem, stack);
    if (r == ZBUFRAND_OK && g[ZBUFRAND_ROOT].levels > ZBUFRANDI_MAX_LEVELS) {
        r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, g[ZBUFRAND_ROOT].levels,
                           "% levels of instances are too many");
    }
    if (r != ZBUFRAND_OK) {
        zbufrandi_free(&scene->mem, order);
        return r;
    }
    for (k = 0; k < count / 2; k++) { /* post-order turned round */
        uint32_t swap = order[k];
        order[k] = order[count - 1 - k];
        order[count - 1 - k] = swap;
    }
    for (i = 1; i < scene->graph_count; i++) g[i].structure = 0; /* of what nobody draws */
    for (k = 0; k < count; k++) g[order[k]].structure = k + 1;
    *out_order = order;
    *out_count = count;
    return ZBUFRAND_OK;
}

static void zbufrandi_gather_free(zbufrandi_mem *mem, zbufrandi_gather *a) {
    zbufrandi_free(mem, a->piece);
    zbufrandi_free(mem, a->instance);
    memset(a, 0, sizeof *a);
}

/* An instance of a structure for `node`, at m. */
static zbufrand_result zbufrandi_gather_instance(zbufrand_scene *scene, zbufrandi_gather *a, const double m[3][4],
                                                 uint32_t structure, uint32_t node) {
    zbufrandi_instance *it;
    const double scale = zbufrandi_m34_scale(m, ZBUFRANDI_SIMILAR_PRODUCT);
    if (scale == 0.0) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, node,
                              "node %: with the lists around it its scale is out of range, or it is no similarity");
    }
    if (a->instance_count >= ZBUFRANDI_STRUCTURE_ITEMS) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, node,
                              "node %: more than 2^28 instances in one structure");
    }
    if (!zbufrandi_grow(&scene->mem, (void **)&a->instance, &a->instance_capacity, a->instance_count,
                        a->instance_count + 1, sizeof *a->instance)) return ZBUFRAND_ERR_NO_MEMORY;
    it = &a->instance[a->instance_count++];
    memset(it, 0, sizeof *it);
    memcpy(it->to_parent, m, sizeof it->to_parent);
    it->scale = scale;
    it->structure = structure;
    it->mirrored = zbufrandi_m34_det(m) < 0.0;
    it->node = node;
    return ZBUFRAND_OK;
}

/* The references of `node`, which stands at `m`. */
static zbufrand_result zbufrandi_gather_references(zbufrand_scene *scene, zbufrandi_gather *a, uint32_t node,
                                                   const double m[3][4]) {
    const zbufrandi_graph *n = &scene->graph[node];
    uint32_t structure = scene->graph[n->target].structure - 1;
    zbufrand_result r = ZBUFRAND_OK;
    double t[3][4];
    size_t i;
    for (i = 0; i < n->count && r == ZBUFRAND_OK; i++) {
        memcpy(t, m, sizeof t);
        if (n->transforms != NULL) {
            if (zbufrandi_m34_scale(ZBUFRANDI_M34(n->transforms[i].m), ZBUFRANDI_SIMILAR) == 0.0) {
                return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, node,
                                      "references %: a transform is no similarity");
            }
            zbufrandi_m34_mul(m, ZBUFRANDI_M34(n->transforms[i].m), t);
        }
        r = zbufrandi_gather_instance(scene, a, ZBUFRANDI_M34(t), structure, node);
    }
    return r;
}

typedef struct zbufrandi_place {
    double m[3][4];
    uint32_t node;
} zbufrandi_place;

/* Everything that melts into the structure of graph node `root`, and its instances, in the order of the lists. */
static zbufrand_result zbufrandi_gather_structure(zbufrand_scene *scene, uint32_t root, zbufrandi_gather *a) {
    const zbufrandi_graph *g = scene->graph;
    zbufrandi_place *stack = NULL, at;
    size_t capacity = 0, depth = 0;
    zbufrand_result r = ZBUFRAND_OK;
    uint32_t k;
    memset(&at, 0, sizeof at);
    at.node = root;
    zbufrandi_m34_identity(at.m);
    for (;;) {
        const zbufrandi_graph *n = &g[at.node];
        if (at.node != root && n->structure != 0) {
            r = zbufrandi_gather_instance(scene, a, ZBUFRANDI_M34(at.m), n->structure - 1, at.node);
        } else if (n->kind == ZBUFRANDI_MESH) {
            if (!zbufrandi_grow(&scene->mem, (void **)&a->piece, &a->piece_capacity, a->piece_count, a->piece_count + 1,
                                sizeof *a->piece)) {
                r = ZBUFRAND_ERR_NO_MEMORY;
            } else {
                memcpy(a->piece[a->piece_count].m, at.m, sizeof at.m);
                a->piece[a->piece_count++].mesh = n->target;
            }
        } else if (n->kind == ZBUFRANDI_REFERENCES) {
            r = zbufrandi_gather_references(scene, a, at.node, ZBUFRANDI_M34(at.m));
        } else {
            size_t first = depth;
            for (k = n->first; k != 0 && r == ZBUFRAND_OK; k = g[k].next) {
                if (g[k].flags & ZBUFRAND_HIDDEN) continue;
                if (!zbufrandi_grow(&scene->mem, (void **)&stack, &capacity, depth, depth + 1, sizeof *stack)) {
                    r = ZBUFRAND_ERR_NO_MEMORY;
                    break;
                }
                zbufrandi_m34_mul(ZBUFRANDI_M34(at.m), ZBUFRANDI_M34(g[k].m), stack[depth].m);
                stack[depth++].node = k;
            }
            for (k = 0; first + k + 1 < depth - k; k++) { /* the first member on top */
                zbufrandi_place swap = stack[first + k];
                stack[first + k] = stack[depth - 1 - k];
                stack[depth - 1 - k] = swap;
            }
        }
        if (r != ZBUFRAND_OK || depth == 0) break;
        at = stack[--depth];
    }
    zbufrandi_free(&scene->mem, stack);
    if (r == ZBUFRAND_ERR_NO_MEMORY) r = zbufrandi_fail(scene->env.error, r, at.node, "node %: out of memory");
    if (r != ZBUFRAND_OK) zbufrandi_gather_free(&scene->mem, a);
    return r;
}

/* ---------------------------------------------------------------------------
   cluster: triangles -> clusters -> tree -> stored points; building a scene.    // >>cluster

   Pieces (mesh, transform) one after the other: vertices are brought into the coordinates of the structure, triangles
   are sorted along a Hilbert curve, large ones apart from small ones, and cut into runs of up to 128: the clusters.
   A binned SAH tree over clusters and instances gives nodes of 8. Boxes, normal cones and areas go up from the leaves,
   and so do the stored points: those of a node are chosen among those of its children.
   Work is cut into tasks by counts, sums are made in a fixed order: the same bytes for any number of threads.
   --------------------------------------------------------------------------- */

enum {
    ZBUFRANDI_TASK_VERTICES = 1 << 16, ZBUFRANDI_TASK_TRIANGLES = 1 << 15, ZBUFRANDI_SEGMENT = 1 << 13,
    ZBUFRANDI_KEY_INDEX = 28, ZBUFRANDI_RADIX = 12
};

/* Three-dimensional Hilbert curve (C. Hamilton's construction): entry [state][octant] = rank of the octant in this
   state, and 8 * state of what is inside it. */
static const uint8_t zbufrandi_hilbert_table[96] = {
    8, 23, 25, 38, 43, 44, 26, 37, 24, 51, 63, 52, 1, 2, 70, 69, 76, 39, 75, 80, 5, 6, 66, 65, 0, 9, 83, 10, 95, 78, 84,
    77, 22, 7, 21, 60, 49, 88, 50, 59, 58, 85, 3, 4, 57, 86, 72, 55, 90, 89, 45, 46, 11, 32, 12, 87, 36, 13, 71, 14, 35,
    74, 40, 73, 62, 81, 15, 16, 61, 82, 92, 91, 94, 93, 41, 42, 31, 20, 56, 19, 18, 27, 17, 64, 53, 28, 54, 47, 68, 67,
    29, 34, 79, 48, 30, 33
};

/* Rank of the cell (x, y, z) of a grid of 2^bits cells a side along the curve. */
ZBUFRANDI_INLINE uint64_t zbufrandi_hilbert(uint32_t x, uint32_t y, uint32_t z, uint32_t bits) {
    uint64_t key = 0;
    uint32_t state = 0, v;
    while (bits-- > 0) {
        v = zbufrandi_hilbert_table[state + (((x >> bits) & 1u) | ((y >> bits) & 1u) << 1 | ((z >> bits) & 1u) << 2)];
        key = key << 3 | (v & 7u);
        state = v & 0x78u;
    }
    return key;
}

/* ---- octahedral normals in 16+16 bits: error below 7e-5 ---- */

ZBUFRANDI_INLINE uint32_t zbufrandi_oct32_encode(const float n[3]) {
    float s = zbufrandi_absf(n[0]) + zbufrandi_absf(n[1]) + zbufrandi_absf(n[2]), x, y;
    int32_t ix, iy;
    if (!(s > 0.0f)) return 0x80008000u;
    x = n[0] / s;
    y = n[1] / s;
    if (n[2] < 0.0f) {
        float ox = x;
        x = (1.0f - zbufrandi_absf(y)) * (x < 0.0f ? -1.0f : 1.0f);
        y = (1.0f - zbufrandi_absf(ox)) * (y < 0.0f ? -1.0f : 1.0f);
    }
    ix = (int32_t)((x + 1.0f) * 32767.5f + 0.5f);
    iy = (int32_t)((y + 1.0f) * 32767.5f + 0.5f);
    ix = ix < 0 ? 0 : ix > 65535 ? 65535 : ix;
    iy = iy < 0 ? 0 : iy > 65535 ? 65535 : iy;
    return (uint32_t)ix | (uint32_t)iy << 16;
}

/* Not unit: |x| + |y| + |z| = 1. The drawing kernels repeat these operations one by one. */
ZBUFRANDI_INLINE void zbufrandi_oct32_vector(uint32_t code, float n[3]) {
    float x = (float)(int32_t)(code & 65535u) * (2.0f / 65535.0f) - 1.0f;
    float y = (float)(int32_t)(code >> 16) * (2.0f / 65535.0f) - 1.0f;
    float z = 1.0f - zbufrandi_absf(x) - zbufrandi_absf(y), t = z < 0.0f ? z : 0.0f;
    n[0] = x < 0.0f ? x - t : x + t; /* below the equator: fold, x +- t with t = -(excess) */
    n[1] = y < 0.0f ? y - t : y + t;
    n[2] = z;
}

ZBUFRANDI_INLINE void zbufrandi_oct32_decode(uint32_t code, float n[3]) {
    float l;
    zbufrandi_oct32_vector(code, n);
    l = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    n[0] = n[0] / l;
    n[1] = n[1] / l;
    n[2] = n[2] / l;
}

/* ---- stored points ---- */

/* Where word 0 of point i of all sets stands; word 1 is 8 further. */
ZBUFRANDI_INLINE size_t zbufrandi_set_at(size_t i) { return (i >> 3) * 16 + (i & 7u); }

/* the order of a set: point i comes from stratum reverse6(i) */
ZBUFRANDI_INLINE uint32_t zbufrandi_reverse6(uint32_t i) {
    i = (i & 0x15u) << 1 | (i >> 1 & 0x15u);                 /* swap neighbours: 543210 -> 452301 */
    return (i & 0x03u) << 4 | (i & 0x0cu) | (i >> 4 & 0x03u); /* swap pairs: 452301 -> 012345 */
}

/* step of the grid of a set along each axis: point = lo + (q + 0.5) * step */
ZBUFRANDI_INLINE void zbufrandi_set_step(const float lo[3], const float hi[3], float step[3]) {
    step[0] = (hi[0] - lo[0]) * (1.0f / 2048.0f);
    step[1] = (hi[1] - lo[1]) * (1.0f / 1024.0f);
    step[2] = (hi[2] - lo[2]) * (1.0f / 1024.0f);
}

ZBUFRANDI_INLINE uint32_t zbufrandi_set_encode(const double p[3], const float lo[3], const float hi[3], int two_sided) {
    static const double cells[3] = {2048.0, 1024.0, 1024.0};
    uint32_t q[3], a;
    for (a = 0; a < 3; a++) {
        double e = (double)hi[a] - (double)lo[a], t = e > 0.0 ? (p[a] - (double)lo[a]) / e * cells[a] : 0.0;
        q[a] = !(t > 0.0) ? 0u : t >= cells[a] - 1.0 ? (uint32_t)cells[a] - 1u : (uint32_t)t;
    }
    return q[0] | q[1] << 11 | q[2] << 21 | (uint32_t)two_sided << 31;
}

ZBUFRANDI_INLINE void zbufrandi_set_decode(uint32_t code, const float lo[3], const float hi[3], double p[3]) {
    float step[3];
    zbufrandi_set_step(lo, hi, step);
    p[0] = (double)lo[0] + ((double)(code & 2047u) + 0.5) * (double)step[0];
    p[1] = (double)lo[1] + ((double)(code >> 11 & 1023u) + 0.5) * (double)step[1];
    p[2] = (double)lo[2] + ((double)(code >> 21 & 1023u) + 0.5) * (double)step[2];
}

/* Square -> triangle with little distortion (E. Heitz 2019): barycentrics of corners 1 and 2. */
ZBUFRANDI_INLINE void zbufrandi_square_to_triangle(float *u, float *v) {
    if (*v > *u) {
        *u = *u * 0.5f;
        *v = *v - *u;
    } else {
        *v = *v * 0.5f;
        *u = *u - *v;
    }
}
/* [0,1) */
ZBUFRANDI_INLINE float zbufrandi_unit24(uint32_t bits) { return (float)(int32_t)(bits >> 8) * (1.0f / 16777216.0f); }

/* ---- build: from pieces to sorted triangles ---- */

typedef struct zbufrandi_piece_job {
    zbufrand_scene *scene;
    const zbufrandi_piece *piece;
    const zbufrand_mesh *mesh;
    const double *origin;
    int identity, mirrored;
    float *vertex;             /* 3 per vertex of the mesh, in the structure; NaN: not usable */
    uint64_t *key, *other;     /* sorting: bits 61..63 size class, 28..60 place on the curve, 0..27 triangle */
    uint32_t task_count, pass;
    uint32_t *task_valid;      /* per task: usable triangles, then where they go */
    float (*task_box)[6];      /* per task: of the centroids */
    int64_t *task_exponent;    /* per task: sum of exponents of squared longest edges */
    uint32_t *histogram;       /* [task][4096] */
    float lo[3], scale[3];
    int32_t typical;           /* mean of those exponents */
    size_t valid;
} zbufrandi_piece_job;

static void zbufrandi_vertex_task(void *ctx, uint32_t task) {
    zbufrandi_piece_job *j = (zbufrandi_piece_job *)ctx;
    const zbufrand_mesh *m = j->mesh;
    size_t i = (size_t)task * ZBUFRANDI_TASK_VERTICES, end = i + ZBUFRANDI_TASK_VERTICES;
    const uint8_t *at = (const uint8_t *)m->positions + i * m->position_stride;
    if (end > m->vertex_count) end = m->vertex_count;
    for (; i < end; i++, at += m->position_stride) {
        float *out = j->vertex + 3 * i, f[3];
        double p[3];
        int a;
        memcpy(f, at, sizeof f);
        for (a = 0; a < 3; a++) p[a] = (double)f[a];
        if (!j->identity) zbufrandi_m34_point(ZBUFRANDI_M34(j->piece->m), p, p);
        for (a = 0; a < 3; a++) p[a] -= j->origin[a];
        if (zbufrandi_abs(p[0]) <= 1e15 && zbufrandi_abs(p[1]) <= 1e15 && zbufrandi_abs(p[2]) <= 1e15) {
            for (a = 0; a < 3; a++) out[a] = (float)p[a];
        } else {
            out[0] = out[1] = out[2] = NAN;
        }
    }
}

/* Corners of triangle t of a piece as vertex indices. 0: an index is out of range. */
ZBUFRANDI_INLINE int zbufrandi_corners(const zbufrand_mesh *m, size_t t, uint32_t v[3]) {
    if (m->indices == NULL) {
        v[0] = (uint32_t)(3 * t);
        v[1] = v[0] + 1;
        v[2] = v[0] + 2;
        return 1;
    }
    memcpy(v, m->indices + 3 * t, 3 * sizeof *v);
    return v[0] < m->vertex_count && v[1] < m->vertex_count && v[2] < m->vertex_count;
}

/* Twice the area as a vector, from floats whose differences are exact in double. */
ZBUFRANDI_INLINE void zbufrandi_cross(const float *a, const float *b, const float *c, double n[3]) {
    double ux = (double)b[0] - (double)a[0], uy = (double)b[1] - (double)a[1], uz = (double)b[2] - (double)a[2];
    double vx = (double)c[0] - (double)a[0], vy = (double)c[1] - (double)a[1], vz = (double)c[2] - (double)a[2];
    n[0] = uy * vz - uz * vy;
    n[1] = uz * vx - ux * vz;
    n[2] = ux * vy - uy * vx;
}

ZBUFRANDI_INLINE double zbufrandi_edge2(const float *a, const float *b) { /* squared length of an edge */
    double x = (double)b[0] - (double)a[0], y = (double)b[1] - (double)a[1], z = (double)b[2] - (double)a[2];
    return x * x + y * y + z * z;
}
ZBUFRANDI_INLINE double zbufrandi_longest2(const float *a, const float *b, const float *c) {
    return zbufrandi_max(zbufrandi_max(zbufrandi_edge2(a, b), zbufrandi_edge2(b, c)), zbufrandi_edge2(c, a));
}
ZBUFRANDI_INLINE int32_t zbufrandi_exponent(double x) { /* of a normal number */
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (int32_t)((bits >> 52) & 2047u) - 1023;
}

/* A triangle can be used: indices in range, all finite, an area that is not zero. */
ZBUFRANDI_INLINE int zbufrandi_usable(const zbufrandi_piece_job *j, size_t t, uint32_t v[3]) {
    const float *a, *b, *c;
    double n[3], l;
    if (!zbufrandi_corners(j->mesh, t, v)) return 0;
    a = j->vertex + 3 * (size_t)v[0];
    b = j->vertex + 3 * (size_t)v[1];
    c = j->vertex + 3 * (size_t)v[2];
    zbufrandi_cross(a, b, c, n);
    l = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    return l > 1e-290; /* false for NaN */
}

static void zbufrandi_measure_task(void *ctx, uint32_t task) { /* usable triangles, box of centroids, sizes */
    zbufrandi_piece_job *j = (zbufrandi_piece_job *)ctx;
    size_t t = (size_t)task * ZBUFRANDI_TASK_TRIANGLES, end = t + ZBUFRANDI_TASK_TRIANGLES;
    float *box = j->task_box[task];
    uint32_t v[3], valid = 0, a;
    int64_t exponent = 0;
    if (end > j->mesh->triangle_count) end = j->mesh->triangle_count;
    for (a = 0; a < 3; a++) {
        box[a] = INFINITY;
        box[3 + a] = -INFINITY;
    }
    for (; t < end; t++) {
        const float *p, *q, *s;
        if (!zbufrandi_usable(j, t, v)) continue;
        p = j->vertex + 3 * (size_t)v[0];
        q = j->vertex + 3 * (size_t)v[1];
        s = j->vertex + 3 * (size_t)v[2];
        for (a = 0; a < 3; a++) {
            float c = p[a] + q[a] + s[a];
            box[a] = c < box[a] ? c : box[a];
            box[3 + a] = c > box[3 + a] ? c : box[3 + a];
        }
        exponent += zbufrandi_exponent(zbufrandi_longest2(p, q, s));
        valid++;
    }
    j->task_valid[task] = valid;
    j->task_exponent[task] = exponent;
}

static void zbufrandi_key_task(void *ctx, uint32_t task) {
    zbufrandi_piece_job *j = (zbufrandi_piece_job *)ctx;
    size_t t = (size_t)task * ZBUFRANDI_TASK_TRIANGLES, end = t + ZBUFRANDI_TASK_TRIANGLES;
    uint64_t *out = j->key + j->task_valid[task];
    uint32_t v[3], q[3], a;
    if (end > j->mesh->triangle_count) end = j->mesh->triangle_count;
    for (; t < end; t++) {
        const float *p[3];
        int32_t larger;
        uint64_t size_class;
        if (!zbufrandi_usable(j, t, v)) continue;
        for (a = 0; a < 3; a++) p[a] = j->vertex + 3 * (size_t)v[a];
        for (a = 0; a < 3; a++) {
            float c = (p[0][a] + p[1][a] + p[2][a] - j->lo[a]) * j->scale[a];
            q[a] = !(c > 0.0f) ? 0u : c >= 2047.0f ? 2047u : (uint32_t)c;
        }
        /* eight times the typical length and more: a class of its own for each further factor of eight */
        larger = zbufrandi_exponent(zbufrandi_longest2(p[0], p[1], p[2])) - j->typical;
        size_class = larger < 6 ? 0u : larger >= 42 ? 7u : (uint64_t)(larger / 6);
        *out++ = size_class << 61 | zbufrandi_hilbert(q[0], q[1], q[2], 11) << ZBUFRANDI_KEY_INDEX | (uint64_t)t;
    }
}

/* One pass of a stable radix sort: count, then move. Tasks are runs of the input. */
static void zbufrandi_radix_count_task(void *ctx, uint32_t task) {
    zbufrandi_piece_job *j = (zbufrandi_piece_job *)ctx;
    size_t i = (size_t)task * ZBUFRANDI_TASK_TRIANGLES, end = i + ZBUFRANDI_TASK_TRIANGLES;
    uint32_t *h = j->histogram + ((size_t)task << ZBUFRANDI_RADIX);
    uint32_t shift = ZBUFRANDI_KEY_INDEX + ZBUFRANDI_RADIX * j->pass;
    if (end > j->valid) end = j->valid;
    memset(h, 0, sizeof *h << ZBUFRANDI_RADIX);
    for (; i < end; i++) h[(j->key[i] >> shift) & ((1u << ZBUFRANDI_RADIX) - 1u)]++;
}
static void zbufrandi_radix_move_task(void *ctx, uint32_t task) {
    zbufrandi_piece_job *j = (zbufrandi_piece_job *)ctx;
    size_t i = (size_t)task * ZBUFRANDI_TASK_TRIANGLES, end = i + ZBUFRANDI_TASK_TRIANGLES;
    uint32_t *h = j->histogram + ((size_t)task << ZBUFRANDI_RADIX);
    uint32_t shift = ZBUFRANDI_KEY_INDEX + ZBUFRANDI_RADIX * j->pass;
    if (end > j->valid) end = j->valid;
    for (; i < end; i++) {
        uint64_t k = j->key[i];
        j->other[h[(k >> shift) & ((1u << ZBUFRANDI_RADIX) - 1u)]++] = k;
    }
}

static void zbufrandi_radix_sort(zbufrandi_piece_job *j) {
    uint32_t tasks = (uint32_t)((j->valid + ZBUFRANDI_TASK_TRIANGLES - 1) / ZBUFRANDI_TASK_TRIANGLES), task, digit, sum;
    uint64_t *swap;
    for (j->pass = 0; j->pass < 3; j->pass++) {
        zbufrandi_parallel_for(&j->scene->env, zbufrandi_radix_count_task, j, tasks);
        for (digit = 0, sum = 0; digit < 1u << ZBUFRANDI_RADIX; digit++) {
            for (task = 0; task < tasks; task++) {
                uint32_t *h = &j->histogram[((size_t)task << ZBUFRANDI_RADIX) + digit], n = *h;
                *h = sum;
                sum += n;
            }
        }
        zbufrandi_parallel_for(&j->scene->env, zbufrandi_radix_move_task, j, tasks);
        swap = j->key;
        j->key = j->other;
        j->other = swap;
    }
}

/* ---- build: from sorted triangles to clusters ---- */

typedef struct zbufrandi_weld { /* the vertices of one cluster */
    const zbufrand_mesh *mesh;
    const float *vertex;
    uint32_t stamp[1024];       /* entry is in use if it equals now */
    uint8_t local[1024];
    uint32_t now, count;
    uint32_t *id;               /* [count] vertex of the mesh */
} zbufrandi_weld;

static int zbufrandi_weld_same(const zbufrandi_weld *w, uint32_t a, uint32_t b) { /* of meshes without indices */
    const zbufrand_mesh *m = w->mesh;
    if (memcmp(w->vertex + 3 * (size_t)a, w->vertex + 3 * (size_t)b, 12) != 0) return 0;
    if (m->normals != NULL && memcmp((const uint8_t *)m->normals + a * m->normal_stride,
                                     (const uint8_t *)m->normals + b * m->normal_stride, 12) != 0) return 0;
    return m->vertex_rgb == NULL || memcmp(m->vertex_rgb + a * m->vertex_rgb_stride,
                                           m->vertex_rgb + b * m->vertex_rgb_stride, 3) == 0;
}

/* Local index of a vertex of the mesh; 256: the cluster is full. */
ZBUFRANDI_INLINE uint32_t zbufrandi_weld_vertex(zbufrandi_weld *w, uint32_t v) {
    uint32_t h = v;
    if (w->mesh->indices == NULL) {
        uint32_t bits[3];
        memcpy(bits, w->vertex + 3 * (size_t)v, sizeof bits);
        h = zbufrandi_hash32(bits[0] ^ zbufrandi_hash32(bits[1] ^ zbufrandi_hash32(bits[2])));
    }
    h = h * 0x9e3779b1u >> 22;
    for (; w->stamp[h] == w->now; h = (h + 1) & 1023u) {
        uint32_t at = w->local[h];
        if (w->id[at] == v || (w->mesh->indices == NULL && zbufrandi_weld_same(w, w->id[at], v))) return at;
    }
    if (w->count == ZBUFRANDI_CLUSTER_VERTICES) return ZBUFRANDI_CLUSTER_VERTICES;
    w->stamp[h] = w->now;
    w->local[h] = (uint8_t)w->count;
    w->id[w->count] = v;
    return w->count++;
}

enum { ZBUFRANDI_SEGMENT_CLUSTERS = 192 }; /* a cluster that is not the last of its segment has at least 63 triangles */

typedef struct zbufrandi_cluster_job {
    zbufrandi_piece_job *piece;
    zbufrandi_structure *s;
    uint32_t first_triangle, first_vertex, first_cluster; /* of the piece in the structure */
    uint32_t *id;                         /* vertices of the mesh, 3 * ZBUFRANDI_SEGMENT per segment */
    zbufrandi_cluster *cluster;           /* ZBUFRANDI_SEGMENT_CLUSTERS per segment, first_vertex within it */
    uint32_t *clusters, *vertices;        /* per segment: how many, then where they begin in the piece */
    int keep_ids;
} zbufrandi_cluster_job;

static void zbufrandi_segment_task(void *ctx, uint32_t task) {
    zbufrandi_cluster_job *j = (zbufrandi_cluster_job *)ctx;
    const zbufrandi_piece_job *pj = j->piece;
    size_t at = (size_t)task * ZBUFRANDI_SEGMENT, end = at + ZBUFRANDI_SEGMENT, k;
    zbufrandi_cluster *out = j->cluster + (size_t)task * ZBUFRANDI_SEGMENT_CLUSTERS;
    uint16_t vertices_after[ZBUFRANDI_CLUSTER_TRIANGLES];
    zbufrandi_weld w;
    uint32_t first_vertex = 0, clusters = 0, a;
    memset(&w, 0, sizeof w);
    w.mesh = pj->mesh;
    w.vertex = pj->vertex;
    if (end > pj->valid) end = pj->valid;
    while (at < end) {
        uint8_t *tri = j->s->triangle + 3 * ((size_t)j->first_triangle + at);
        uint32_t n = 0, cut, used = 0; /* vertices of the triangles up to the cut */
        uint64_t highest = 0;
        w.id = j->id + 3 * (size_t)task * ZBUFRANDI_SEGMENT + first_vertex;
        w.now++;
        w.count = 0;
        for (; n < ZBUFRANDI_CLUSTER_TRIANGLES && at + n < end; n++) {
            uint32_t v[3], local[3], before = w.count;
            (void)zbufrandi_corners(pj->mesh, (size_t)(pj->key[at + n] & ((1u << ZBUFRANDI_KEY_INDEX) - 1u)), v);
            for (a = 0; a < 3; a++) local[a] = zbufrandi_weld_vertex(&w, v[a]);
            if (local[0] == 256 || local[1] == 256 || local[2] == 256) {
                w.count = before;
                break;
            }
            tri[3 * n] = (uint8_t)local[0];
            tri[3 * n + 1] = (uint8_t)local[pj->mirrored ? 2 : 1]; /* outside stays outside */
            tri[3 * n + 2] = (uint8_t)local[pj->mirrored ? 1 : 2];
            vertices_after[n] = (uint16_t)w.count;
            used = w.count;
        }
        cut = n;
        if (at + n < end) { /* cut where the curve leaves the largest cell: rounder clusters */
            for (k = n - n / 4; k <= n; k++) {
                uint64_t step = (pj->key[at + k - 1] ^ pj->key[at + k]) >> ZBUFRANDI_KEY_INDEX;
                if (step >= highest) {
                    highest = step;
                    cut = (uint32_t)k;
                }
            }
            if (cut < n) used = vertices_after[cut - 1];
        }
        memset(&out[clusters], 0, sizeof out[clusters]);
        out[clusters].first_vertex = first_vertex;
        out[clusters].first_triangle = j->first_triangle + (uint32_t)at;
        out[clusters].vertex_count = (uint16_t)used;
        out[clusters].triangle_count = (uint8_t)cut;
        first_vertex += used;
        clusters++;
        at += cut;
    }
    j->clusters[task] = clusters;
    j->vertices[task] = first_vertex;
}

/* x as a float holds it. (double)(float)x is x itself to gcc 12 where it makes vectors of two of them, and pictures
   would differ between compilers. */
ZBUFRANDI_INLINE double zbufrandi_rounded(double x) {
    volatile float f = (float)x;
    return (double)f;
}

/* Vertex normal -> code of the structure's coordinates. */
static uint16_t zbufrandi_vertex_normal(const zbufrandi_piece_job *j, uint32_t v) {
    double n[3], r[3];
    float f[3];
    int a;
    memcpy(f, (const uint8_t *)j->mesh->normals + (size_t)v * j->mesh->normal_stride, sizeof f);
    for (a = 0; a < 3; a++) n[a] = (double)f[a];
    for (a = 0; a < 3; a++) {
        r[a] = j->piece->m[a][0] * n[0] + j->piece->m[a][1] * n[1] + j->piece->m[a][2] * n[2];
        f[a] = (float)zbufrandi_rounded(r[a]);
    }
    if (!zbufrandi_normalize(f)) f[0] = f[1] = f[2] = 0.0f;
    return (uint16_t)zbufrandi_oct_encode(f);
}

static void zbufrandi_cluster_task(void *ctx, uint32_t task) { /* copy what the clusters of a segment refer to */
    zbufrandi_cluster_job *j = (zbufrandi_cluster_job *)ctx;
    const zbufrandi_piece_job *pj = j->piece;
    const zbufrand_mesh *m = pj->mesh;
    zbufrandi_structure *s = j->s;
    const zbufrandi_cluster *in = j->cluster + (size_t)task * ZBUFRANDI_SEGMENT_CLUSTERS;
    size_t first_triangle = (size_t)task * ZBUFRANDI_SEGMENT, end = first_triangle + ZBUFRANDI_SEGMENT;
    const uint32_t *id = j->id + 3 * first_triangle;
    uint32_t first_vertex = j->first_vertex + j->vertices[task], first = j->first_cluster + j->clusters[task], i, a, k;
    uint32_t count = 0, covered = 0;
    if (end > pj->valid) end = pj->valid;
    while (first_triangle + covered < end) covered += in[count++].triangle_count;
    for (i = 0; i < count; i++) {
        zbufrandi_cluster *c = &s->cluster[first + i];
        *c = in[i];
        c->first_vertex += first_vertex;
        c->flags = (uint8_t)((m->two_sided ? ZBUFRANDI_TWO_SIDED : 0) |
                             (m->normals != NULL ? ZBUFRANDI_HAS_NORMALS : 0) |
                             (m->triangle_rgb != NULL ? ZBUFRANDI_HAS_TRIANGLE_RGB :
                              m->vertex_rgb != NULL ? ZBUFRANDI_HAS_VERTEX_RGB : 0));
        c->mesh = pj->piece->mesh;
        for (a = 0; a < 3; a++) {
            c->box_lo[a] = INFINITY;
            c->box_hi[a] = -INFINITY;
        }
        for (k = 0; k < c->vertex_count; k++) {
            const float *p = pj->vertex + 3 * (size_t)id[in[i].first_vertex + k];
            float *q = s->position + 3 * (size_t)(c->first_vertex + k);
            for (a = 0; a < 3; a++) {
                q[a] = p[a];
                c->box_lo[a] = p[a] < c->box_lo[a] ? p[a] : c->box_lo[a];
                c->box_hi[a] = p[a] > c->box_hi[a] ? p[a] : c->box_hi[a];
            }
        }
        for (k = 0; k < c->vertex_count && m->normals != NULL; k++) {
            s->vertex_normal[c->first_vertex + k] = zbufrandi_vertex_normal(pj, id[in[i].first_vertex + k]);
        }
        for (k = 0; k < c->vertex_count && (c->flags & ZBUFRANDI_HAS_VERTEX_RGB); k++) {
            memcpy(s->vertex_rgb + 3 * (size_t)(c->first_vertex + k),
                   m->vertex_rgb + (size_t)id[in[i].first_vertex + k] * m->vertex_rgb_stride, 3);
        }
    }
    for (; first_triangle < end; first_triangle++) {
        size_t t = (size_t)(pj->key[first_triangle] & ((1u << ZBUFRANDI_KEY_INDEX) - 1u));
        size_t to = j->first_triangle + first_triangle;
        if (m->triangle_rgb != NULL) memcpy(s->triangle_rgb + 3 * to, m->triangle_rgb + 3 * t, 3);
        if (j->keep_ids) s->triangle_id[to] = (uint32_t)t;
    }
}

typedef struct zbufrandi_build { /* one structure in the making */
    zbufrand_scene *scene;
    const zbufrand_build_desc *desc;
    zbufrandi_structure *s;
    zbufrandi_gather *gather;
    size_t vertex_capacity, triangle_capacity, cluster_capacity;
    uint32_t *parent;            /* of cluster i, instance i: 8 * node + lane */
    uint64_t skipped;
    uint32_t index;              /* of the structure */
} zbufrandi_build;

/* Where a node went, for edits. The node that the structure is made of has its items elsewhere: where it is drawn. */
static void zbufrandi_build_home(zbufrandi_build *b, uint32_t node, uint32_t first, uint32_t count) {
    zbufrandi_graph *n = &b->scene->graph[node];
    if (n->structure == b->index + 1) return;
    n->home = b->index + 1;
    n->item = first;
    n->item_count = count;
}

/* Room for exactly what is needed, or half as much again when it grew before. */
static int zbufrandi_reserve(zbufrandi_mem *mem, void **array, size_t used, size_t capacity, size_t size, size_t pad) {
    void *p;
    size_t bytes;
    if (!zbufrandi_mul_size(capacity, size, &bytes) || bytes > (size_t)-1 - pad) return 0;
    p = zbufrandi_alloc(mem, bytes + pad);
    if (p == NULL) return 0;
    if (used != 0) memcpy(p, *array, used * size);
    memset((uint8_t *)p + used * size, 0, bytes + pad - used * size);
    zbufrandi_free(mem, *array);
    *array = p;
    return 1;
}
static size_t zbufrandi_next_capacity(size_t used, size_t need) { return used == 0 ? need : need + need / 2; }

static int zbufrandi_resize_triangles(zbufrandi_build *b, size_t cap) {
    zbufrandi_mem *mem = &b->scene->mem;
    zbufrandi_structure *s = b->s;
    if (!zbufrandi_reserve(mem, (void **)&s->triangle, s->triangle_count, cap, 3, 48)) return 0;
    if (s->triangle_rgb != NULL && !zbufrandi_reserve(mem, (void **)&s->triangle_rgb, s->triangle_count, cap, 3, 16))
        return 0;
    if (s->triangle_id != NULL && !zbufrandi_reserve(mem, (void **)&s->triangle_id, s->triangle_count, cap, 4, 0))
        return 0;
    b->triangle_capacity = cap;
    return 1;
}
static int zbufrandi_reserve_triangles(zbufrandi_build *b, size_t need) {
    return need <= b->triangle_capacity ||
           zbufrandi_resize_triangles(b, zbufrandi_next_capacity(b->s->triangle_count, need));
}
static int zbufrandi_resize_vertices(zbufrandi_build *b, size_t cap) {
    zbufrandi_mem *mem = &b->scene->mem;
    zbufrandi_structure *s = b->s;
    if (!zbufrandi_reserve(mem, (void **)&s->position, s->vertex_count, cap, 12, 96)) return 0;
    if (s->vertex_normal != NULL && !zbufrandi_reserve(mem, (void **)&s->vertex_normal, s->vertex_count, cap, 2, 16))
        return 0;
    if (s->vertex_rgb != NULL && !zbufrandi_reserve(mem, (void **)&s->vertex_rgb, s->vertex_count, cap, 3, 16))
        return 0;
    b->vertex_capacity = cap;
    return 1;
}
static int zbufrandi_reserve_vertices(zbufrandi_build *b, size_t need) {
    return need <= b->vertex_capacity ||
           zbufrandi_resize_vertices(b, zbufrandi_next_capacity(b->s->vertex_count, need));
}

/* Attribute arrays exist once a mesh of the structure has them. */
static int zbufrandi_reserve_attributes(zbufrandi_build *b, const zbufrand_mesh *m) {
    zbufrandi_mem *mem = &b->scene->mem;
    zbufrandi_structure *s = b->s;
    if (m->normals != NULL && s->vertex_normal == NULL &&
        !zbufrandi_reserve(mem, (void **)&s->vertex_normal, 0, b->vertex_capacity, 2, 16)) return 0;
    if (m->triangle_rgb != NULL) {
        return s->triangle_rgb != NULL || zbufrandi_reserve(mem, (void **)&s->triangle_rgb, 0, b->triangle_capacity, 3,
                                                            16);
    }
    return m->vertex_rgb == NULL || s->vertex_rgb != NULL ||
           zbufrandi_reserve(mem, (void **)&s->vertex_rgb, 0, b->vertex_capacity, 3, 16);
}

static int zbufrandi_piece_sort(zbufrandi_piece_job *j) { /* keys of all usable triangles, sorted; 0: no memory */
    zbufrandi_mem *mem = &j->scene->mem;
    const zbufrand_env *env = &j->scene->env;
    size_t count = j->mesh->triangle_count, valid = 0;
    uint32_t tasks = (uint32_t)((count + ZBUFRANDI_TASK_TRIANGLES - 1) / ZBUFRANDI_TASK_TRIANGLES), i, a;
    int64_t exponent = 0;
    float hi[3];
    j->task_valid = (uint32_t *)zbufrandi_alloc_array(mem, tasks, sizeof *j->task_valid);
    j->task_box = (float (*)[6])zbufrandi_alloc_array(mem, tasks, sizeof *j->task_box);
    j->task_exponent = (int64_t *)zbufrandi_alloc_array(mem, tasks, sizeof *j->task_exponent);
    j->histogram = (uint32_t *)zbufrandi_alloc_array(mem, (size_t)tasks << ZBUFRANDI_RADIX, sizeof *j->histogram);
    if (j->task_valid == NULL || j->task_box == NULL || j->task_exponent == NULL || j->histogram == NULL) return 0;
    zbufrandi_parallel_for(env, zbufrandi_measure_task, j, tasks);
    for (a = 0; a < 3; a++) {
        j->lo[a] = INFINITY;
        hi[a] = -INFINITY;
    }
    for (i = 0; i < tasks; i++) {
        for (a = 0; a < 3; a++) {
            j->lo[a] = j->task_box[i][a] < j->lo[a] ? j->task_box[i][a] : j->lo[a];
            hi[a] = j->task_box[i][3 + a] > hi[a] ? j->task_box[i][3 + a] : hi[a];
        }
        exponent += j->task_exponent[i];
        a = j->task_valid[i];
        j->task_valid[i] = (uint32_t)valid;
        valid += a;
    }
    j->valid = valid;
    if (valid == 0) return 1;
    j->typical = (int32_t)zbufrandi_floor((double)exponent / (double)valid);
    for (a = 0; a < 3; a++) { /* one cell size for the three axes: a curve through cubes, not through slabs */
        if (hi[a] - j->lo[a] > j->scale[0]) j->scale[0] = hi[a] - j->lo[a];
    }
    j->scale[0] = j->scale[0] > 1e-30f ? 2048.0f / j->scale[0] : 0.0f;
    j->scale[1] = j->scale[2] = j->scale[0];
    j->key = (uint64_t *)zbufrandi_alloc_array(mem, valid, sizeof *j->key);
    j->other = (uint64_t *)zbufrandi_alloc_array(mem, valid, sizeof *j->other);
    if (j->key == NULL || j->other == NULL) return 0;
    zbufrandi_parallel_for(env, zbufrandi_key_task, j, tasks);
    zbufrandi_radix_sort(j);
    zbufrandi_free(mem, j->other);
    j->other = NULL;
    return 1;
}

/* The clusters of a mesh go to the others. RANGE: too many triangles or vertices; NO_MEMORY. */
static zbufrand_result zbufrandi_piece_clusters(zbufrandi_build *b, zbufrandi_piece_job *pj) {
    zbufrandi_mem *mem = &b->scene->mem;
    zbufrandi_structure *s = b->s;
    uint32_t segments = (uint32_t)((pj->valid + ZBUFRANDI_SEGMENT - 1) / ZBUFRANDI_SEGMENT), i, n, clusters = 0;
    uint64_t vertices = 0;
    zbufrandi_cluster_job j;
    zbufrand_result r = ZBUFRAND_OK;
    int ok;
    if ((uint64_t)s->triangle_count + pj->valid > 0xffffffffu) return ZBUFRAND_ERR_RANGE;
    memset(&j, 0, sizeof j);
    j.piece = pj;
    j.s = s;
    j.first_triangle = s->triangle_count;
    j.first_vertex = s->vertex_count;
    j.first_cluster = s->cluster_count;
    j.keep_ids = b->desc->ids != 0;
    if (!zbufrandi_reserve_triangles(b, (size_t)s->triangle_count + pj->valid)) return ZBUFRAND_ERR_NO_MEMORY;
    if (j.keep_ids && s->triangle_id == NULL &&
        !zbufrandi_reserve(mem, (void **)&s->triangle_id, 0, b->triangle_capacity, 4, 0)) return ZBUFRAND_ERR_NO_MEMORY;
    n = pj->valid < ZBUFRANDI_SEGMENT ? (uint32_t)pj->valid : (uint32_t)ZBUFRANDI_SEGMENT;
    j.id = (uint32_t *)zbufrandi_alloc_array(mem, pj->valid, 3 * sizeof *j.id);
    j.cluster = (zbufrandi_cluster *)zbufrandi_alloc_array(mem,
            segments == 1 ? n / 63 + 2 : (size_t)segments * ZBUFRANDI_SEGMENT_CLUSTERS,
                                                           sizeof *j.cluster);
    j.clusters = (uint32_t *)zbufrandi_alloc_array(mem, segments, sizeof *j.clusters);
    j.vertices = (uint32_t *)zbufrandi_alloc_array(mem, segments, sizeof *j.vertices);
    ok = j.id != NULL && j.cluster != NULL && j.clusters != NULL && j.vertices != NULL;
    if (ok) {
        zbufrandi_parallel_for(&b->scene->env, zbufrandi_segment_task, &j, segments);
        for (i = 0; i < segments; i++) {
            n = j.clusters[i];
            j.clusters[i] = clusters;
            clusters += n;
            n = j.vertices[i];
            j.vertices[i] = (uint32_t)vertices;
            vertices += n;
        }
        if (s->vertex_count + vertices > 0xffffffffu) r = ZBUFRAND_ERR_RANGE;
        ok = r == ZBUFRAND_OK && zbufrandi_reserve_vertices(b, s->vertex_count + (size_t)vertices) &&
             zbufrandi_reserve_attributes(b, pj->mesh);
        if (ok && s->cluster_count + (size_t)clusters > b->cluster_capacity) {
            b->cluster_capacity = zbufrandi_next_capacity(s->cluster_count, s->cluster_count + (size_t)clusters);
            ok = zbufrandi_reserve(mem, (void **)&s->cluster, s->cluster_count, b->cluster_capacity,
                                   sizeof *s->cluster, 0);
        }
    }
    if (ok) {
        zbufrandi_parallel_for(&b->scene->env, zbufrandi_cluster_task, &j, segments);
        s->triangle_count += (uint32_t)pj->valid;
        s->vertex_count += (uint32_t)vertices;
        s->cluster_count += clusters;
    }
    zbufrandi_free(mem, j.id);
    zbufrandi_free(mem, j.cluster);
    zbufrandi_free(mem, j.clusters);
    zbufrandi_free(mem, j.vertices);
    return ok || r != ZBUFRAND_OK ? r : ZBUFRAND_ERR_NO_MEMORY;
}

/* A triangle that `strict` does not let pass. */
static zbufrand_result zbufrandi_bad_triangle(zbufrand_error *error, uint32_t node, size_t triangle) {
    zbufrand_error of;
    char text[sizeof of.text + 16] = "triangle %";
    (void)zbufrandi_fail(&of, ZBUFRAND_ERR_INVALID_ARG, node,
                         " of mesh %: degenerate, not finite, or an index is out of range");
    memcpy(text + strlen(text), of.text, strlen(of.text) + 1);
    return zbufrandi_fail(error, ZBUFRAND_ERR_INVALID_ARG, triangle, text);
}

/* Melt one mesh into the structure. */
static zbufrand_result zbufrandi_build_piece(zbufrandi_build *b, const zbufrandi_piece *piece) {
    zbufrand_scene *scene = b->scene;
    zbufrandi_mem *mem = &scene->mem;
    zbufrand_error *e = scene->env.error;
    const uint32_t node = scene->mesh[piece->mesh].node;
    zbufrandi_piece_job j;
    static const double unit[3][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}};
    uint32_t tasks, v[3];
    size_t t;
    zbufrand_result r = ZBUFRAND_ERR_NO_MEMORY;
    memset(&j, 0, sizeof j);
    j.scene = scene;
    j.piece = piece;
    j.mesh = &scene->mesh[piece->mesh].m;
    j.origin = b->s->origin;
    j.identity = memcmp(piece->m, unit, sizeof unit) == 0;
    j.mirrored = zbufrandi_m34_det(ZBUFRANDI_M34(piece->m)) < 0.0;
    if (j.mesh->triangle_count == 0) return ZBUFRAND_OK;
    j.vertex = (float *)zbufrandi_alloc_array(mem, j.mesh->vertex_count, 3 * sizeof *j.vertex);
    if (j.vertex != NULL) {
        r = ZBUFRAND_OK;
        tasks = (uint32_t)((j.mesh->vertex_count + ZBUFRANDI_TASK_VERTICES - 1) / ZBUFRANDI_TASK_VERTICES);
        zbufrandi_parallel_for(&scene->env, zbufrandi_vertex_task, &j, tasks);
        for (t = 0; b->desc->strict && t < j.mesh->triangle_count && r == ZBUFRAND_OK; t++)
            if (!zbufrandi_usable(&j, t, v)) r = zbufrandi_bad_triangle(e, node, t);
        if (r == ZBUFRAND_OK && !zbufrandi_piece_sort(&j)) r = ZBUFRAND_ERR_NO_MEMORY;
        if (r == ZBUFRAND_OK) {
            const uint32_t first = b->s->cluster_count;
            b->skipped += j.mesh->triangle_count - j.valid;
            if (j.valid != 0) r = zbufrandi_piece_clusters(b, &j);
            zbufrandi_build_home(b, node, first, b->s->cluster_count - first);
        }
    }
    zbufrandi_free(mem, j.vertex);
    zbufrandi_free(mem, j.key);
    zbufrandi_free(mem, j.other);
    zbufrandi_free(mem, j.task_valid);
    zbufrandi_free(mem, j.task_box);
    zbufrandi_free(mem, j.task_exponent);
    zbufrandi_free(mem, j.histogram);
    if (r == ZBUFRAND_ERR_NO_MEMORY) r = zbufrandi_fail(e, r, node, "mesh %: out of memory");
    if (r == ZBUFRAND_ERR_RANGE)
        r = zbufrandi_fail(e, r, node, "mesh %: more than 2^32 - 1 triangles or vertices in its structure");
    return r;
}

/* ---- build: the tree ---- */

ZBUFRANDI_INLINE float zbufrandi_step_float(float f, int up) { /* the next float; f is finite */
    int32_t bits;
    memcpy(&bits, &f, sizeof bits);
    if (f == 0.0f) bits = up ? 1 : (int32_t)0x80000001u;
    else bits += (f > 0.0f) == (up != 0) ? 1 : -1;
    memcpy(&f, &bits, sizeof f);
    return f;
}
ZBUFRANDI_INLINE float zbufrandi_float_down(double x) {
    float f = (float)x;
    return (double)f > x ? zbufrandi_step_float(f, 0) : f;
}
ZBUFRANDI_INLINE float zbufrandi_float_up(double x) {
    float f = (float)x;
    return (double)f < x ? zbufrandi_step_float(f, 1) : f;
}

typedef struct zbufrandi_item { /* a leaf of the tree: a cluster or an instance */
    float lo[3], hi[3];
    uint32_t child;
    uint32_t _pad;
} zbufrandi_item;

typedef struct zbufrandi_range { /* items that become one child; of the stack: one node */
    uint32_t begin, end, node, level;
    float area; /* half the surface of the box */
} zbufrandi_range;

ZBUFRANDI_INLINE float zbufrandi_half_surface(const float lo[3], const float hi[3]) {
    float x = hi[0] - lo[0], y = hi[1] - lo[1], z = hi[2] - lo[2];
    return x >= 0.0f ? x * y + y * z + z * x : 0.0f;
}
ZBUFRANDI_INLINE void zbufrandi_box_empty(float lo[3], float hi[3]) {
    lo[0] = lo[1] = lo[2] = INFINITY;
    hi[0] = hi[1] = hi[2] = -INFINITY;
}
ZBUFRANDI_INLINE void zbufrandi_box_add(float lo[3], float hi[3], const float lo2[3], const float hi2[3]) {
    int a;
    for (a = 0; a < 3; a++) {
        lo[a] = lo2[a] < lo[a] ? lo2[a] : lo[a];
        hi[a] = hi2[a] > hi[a] ? hi2[a] : hi[a];
    }
}

enum { ZBUFRANDI_BINS = 16 };

typedef struct zbufrandi_bin {
    float lo[3], hi[3];
    uint32_t count;
} zbufrandi_bin;

/* Best border of one axis: items whose bin is below *cut go left. Cost is area times count of both sides. */
static float zbufrandi_best_cut(const zbufrandi_bin *bin, uint32_t *cut) {
    float left[ZBUFRANDI_BINS], lo[3], hi[3], best = INFINITY;
    uint32_t i, n = 0;
    zbufrandi_box_empty(lo, hi);
    for (i = 0; i + 1 < ZBUFRANDI_BINS; i++) {
        n += bin[i].count;
        if (bin[i].count != 0) zbufrandi_box_add(lo, hi, bin[i].lo, bin[i].hi);
        left[i] = n != 0 ? zbufrandi_half_surface(lo, hi) * (float)n : 0.0f;
    }
    zbufrandi_box_empty(lo, hi);
    for (i = ZBUFRANDI_BINS - 1, n = 0; i > 0; i--) {
        float cost;
        n += bin[i].count;
        if (bin[i].count != 0) zbufrandi_box_add(lo, hi, bin[i].lo, bin[i].hi);
        cost = left[i - 1] + (n != 0 ? zbufrandi_half_surface(lo, hi) * (float)n : 0.0f);
        if (cost < best) {
            best = cost;
            *cut = i;
        }
    }
    return best;
}

/* Move the items of a range so that [begin, mid) and [mid, end) are two good halves. */
static uint32_t zbufrandi_split(zbufrandi_item *item, uint32_t begin, uint32_t end, uint32_t level) {
    zbufrandi_bin bin[3][ZBUFRANDI_BINS];
    float lo[3], hi[3], scale[3], best = INFINITY, cost;
    uint32_t i, k, axis = 3, cut = 0, at = 0, mid = begin;
    int a;
    zbufrandi_box_empty(lo, hi);
    for (i = begin; i < end; i++) {
        float c[3];
        for (a = 0; a < 3; a++) c[a] = item[i].lo[a] + item[i].hi[a];
        zbufrandi_box_add(lo, hi, c, c);
    }
    for (a = 0; a < 3; a++) {
        scale[a] = (float)ZBUFRANDI_BINS * 0.9999f / (hi[a] - lo[a]);
        if (!(scale[a] < 1e30f)) scale[a] = 0.0f;
        for (k = 0; k < ZBUFRANDI_BINS; k++) {
            zbufrandi_box_empty(bin[a][k].lo, bin[a][k].hi);
            bin[a][k].count = 0;
        }
    }
    for (i = begin; i < end; i++) {
        for (a = 0; a < 3; a++) {
            k = (uint32_t)((item[i].lo[a] + item[i].hi[a] - lo[a]) * scale[a]);
            zbufrandi_box_add(bin[a][k].lo, bin[a][k].hi, item[i].lo, item[i].hi);
            bin[a][k].count++;
        }
    }
    for (a = 0; a < 3; a++) {
        if (!(scale[a] > 0.0f)) continue;
        cost = zbufrandi_best_cut(bin[a], &at);
        if (cost < best) {
            best = cost;
            axis = (uint32_t)a;
            cut = at;
        }
    }
    if (axis < 3) {
        uint32_t j = end;
        while (mid < j) {
            k = (uint32_t)((item[mid].lo[axis] + item[mid].hi[axis] - lo[axis]) * scale[axis]);
            if (k < cut) {
                mid++;
            } else {
                zbufrandi_item swap = item[mid];
                item[mid] = item[--j];
                item[j] = swap;
            }
        }
    }
    /* all centres equal, or deeper than a sound tree gets: halves of the order as it is */
    if (mid == begin || mid == end || level > 40) mid = begin + (end - begin) / 2;
    return mid;
}

static float zbufrandi_range_area(const zbufrandi_item *item, uint32_t begin, uint32_t end, float lo[3], float hi[3]) {
    uint32_t i;
    zbufrandi_box_empty(lo, hi);
    for (i = begin; i < end; i++) zbufrandi_box_add(lo, hi, item[i].lo, item[i].hi);
    return zbufrandi_half_surface(lo, hi);
}

/* Cut a range of items into up to eight: open the largest until there are eight; what fits into one node stays
   together. */
static uint32_t zbufrandi_open_range(zbufrandi_item *item, zbufrandi_range at, zbufrandi_range range[8], float lo[8][3],
                                     float hi[8][3]) {
    uint32_t n = 1, i;
    range[0] = at;
    range[0].area = zbufrandi_range_area(item, at.begin, at.end, lo[0], hi[0]);
    while (n < 8) {
        uint32_t widest = 8, mid;
        for (i = 0; i < n; i++) {
            if (range[i].end - range[i].begin < (at.end - at.begin > 8 ? 9u : 2u)) continue;
            if (widest == 8 || range[i].area > range[widest].area) widest = i;
        }
        if (widest == 8) break;
        mid = zbufrandi_split(item, range[widest].begin, range[widest].end, at.level);
        for (i = n; i > widest + 1; i--) { /* keeps the order of the items */
            range[i] = range[i - 1];
            memcpy(lo[i], lo[i - 1], sizeof lo[i]);
            memcpy(hi[i], hi[i - 1], sizeof hi[i]);
        }
        range[widest + 1] = range[widest];
        range[widest + 1].begin = range[widest].end = mid;
        range[widest].area = zbufrandi_range_area(item, range[widest].begin, mid, lo[widest], hi[widest]);
        range[widest + 1].area = zbufrandi_range_area(item, mid, range[widest + 1].end, lo[widest + 1],
                                                      hi[widest + 1]);
        n++;
    }
    return n;
}

/* Nodes over the items; boxes, children and counts of the lanes are set. 0: no memory. */
static int zbufrandi_build_tree(zbufrandi_build *b, zbufrandi_item *item, uint32_t count) {
    zbufrandi_mem *mem = &b->scene->mem;
    zbufrandi_structure *s = b->s;
    zbufrandi_range *stack = NULL, range[8];
    size_t stack_capacity = 0, node_capacity = 0, depth = 0;
    uint32_t n, i, a, k;
    int ok = zbufrandi_grow(mem, (void **)&stack, &stack_capacity, 0, 64, sizeof *stack) &&
             zbufrandi_grow(mem, (void **)&s->node, &node_capacity, 0, 1 + count / 6, sizeof *s->node);
    if (ok) {
        memset(&stack[0], 0, sizeof stack[0]);
        stack[0].end = count;
        s->node_count = 1;
        depth = 1;
    }
    while (ok && depth > 0) {
        zbufrandi_range at = stack[--depth];
        zbufrandi_node8 *node = &s->node[at.node];
        float lo[8][3], hi[8][3];
        memset(node, 0, sizeof *node);
        n = zbufrandi_open_range(item, at, range, lo, hi);
        node->count = n;
        ok = zbufrandi_grow(mem, (void **)&s->node, &node_capacity, s->node_count, (size_t)s->node_count + 8,
                            sizeof *s->node) &&
             zbufrandi_grow(mem, (void **)&stack, &stack_capacity, depth, depth + 8, sizeof *stack);
        if (!ok) break;
        node = &s->node[at.node];
        for (i = 0; i < 8; i++) {
            for (a = 0; a < 3; a++) {
                node->lo[a][i] = i < n ? lo[i][a] : INFINITY;
                node->hi[a][i] = i < n ? hi[i][a] : -INFINITY;
            }
            node->cosine[i] = 1.0f;
            node->child[i] = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NONE, 0);
            if (i < n && range[i].end - range[i].begin == 1) {
                uint32_t child = item[range[i].begin].child, at_item = ZBUFRANDI_CHILD_INDEX(child);
                node->child[i] = child;
                if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_INSTANCE) at_item += s->cluster_count;
                b->parent[at_item] = 8 * at.node + i;
            } else if (i < n) {
                node->child[i] = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, s->node_count++);
            }
        }
        for (k = n; k > 0; k--) { /* the first child is the next to be made */
            i = k - 1;
            if (ZBUFRANDI_CHILD_KIND(node->child[i]) != ZBUFRANDI_CHILD_NODE) continue;
            stack[depth] = range[i];
            stack[depth].node = ZBUFRANDI_CHILD_INDEX(node->child[i]);
            stack[depth++].level = at.level + 1;
        }
    }
    zbufrandi_free(mem, stack);
    if (ok) ok = zbufrandi_reserve(mem, (void **)&s->node, s->node_count, s->node_count, sizeof *s->node, 0);
    return ok;
}

/* ---- build: leaves: what a lane says about a cluster, and the stored points of clusters ---- */

typedef struct zbufrandi_lane { /* a lane of a node, on its own */
    float lo[3], hi[3], axis[3], cosine, o_lo, o_hi, area, edge;
    uint64_t triangles;
    uint8_t flags;
} zbufrandi_lane;

static void zbufrandi_lane_get(const zbufrandi_node8 *n, uint32_t i, zbufrandi_lane *l) {
    int a;
    for (a = 0; a < 3; a++) {
        l->lo[a] = n->lo[a][i];
        l->hi[a] = n->hi[a][i];
        l->axis[a] = n->axis[a][i];
    }
    l->cosine = n->cosine[i];
    l->o_lo = n->o_lo[i];
    l->o_hi = n->o_hi[i];
    l->area = n->area[i];
    l->edge = n->edge[i];
    l->triangles = n->triangles[i];
    l->flags = n->flags[i];
}
static void zbufrandi_lane_put(zbufrandi_node8 *n, uint32_t i, const zbufrandi_lane *l) {
    int a;
    for (a = 0; a < 3; a++) {
        n->lo[a][i] = l->lo[a];
        n->hi[a][i] = l->hi[a];
        n->axis[a][i] = l->axis[a];
    }
    n->cosine[i] = l->cosine;
    n->o_lo[i] = l->o_lo;
    n->o_hi[i] = l->o_hi;
    n->area[i] = l->area;
    n->edge[i] = l->edge;
    n->triangles[i] = l->triangles;
    n->flags[i] = l->flags;
}

/* Stored points lie up to half a step of their grid off the surface, their normals are rounded: the cone and the
   bounds of o are opened by that much, so that they hold for what is drawn. */
static void zbufrandi_lane_widen(zbufrandi_lane *l) {
    double e, step2 = 0.0, radius2 = 0.0, margin, s;
    static const double cells[3] = {2048.0, 1024.0, 1024.0};
    int a;
    for (a = 0; a < 3; a++) {
        e = (double)l->hi[a] - (double)l->lo[a];
        step2 += e / cells[a] * e / cells[a];
        radius2 += e * e;
    }
    margin = 0.5 * sqrt(step2) + 1e-4 * sqrt(radius2);
    l->o_lo = zbufrandi_float_down((double)l->o_lo - margin);
    l->o_hi = zbufrandi_float_up((double)l->o_hi + margin);
    s = sqrt(zbufrandi_max(0.0, 1.0 - (double)l->cosine * (double)l->cosine));
    l->cosine = zbufrandi_float_down(zbufrandi_max(-1.0, (double)l->cosine - 1e-4 * s - 1e-6));
}

typedef struct zbufrandi_shape { /* a cluster measured */
    float normal[ZBUFRANDI_CLUSTER_TRIANGLES][3];
    double sum[ZBUFRANDI_CLUSTER_TRIANGLES + 1]; /* areas added up */
    int8_t sign[ZBUFRANDI_CLUSTER_TRIANGLES];    /* of the side that the cone is about */
} zbufrandi_shape;

static void zbufrandi_measure_cluster(const zbufrandi_structure *s, uint32_t index, zbufrandi_shape *shape,
                                      zbufrandi_lane *l) {
    const zbufrandi_cluster *c = &s->cluster[index];
    const float *position = s->position + 3 * (size_t)c->first_vertex;
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    double axis[3] = {0, 0, 0}, edge2 = 0.0, cosine = 1.0, o_lo = 1e300, o_hi = -1e300, length;
    float center[3];
    uint32_t t, a;
    memset(l, 0, sizeof *l);
    l->flags = (uint8_t)(c->flags & ZBUFRANDI_TWO_SIDED);
    l->triangles = c->triangle_count;
    for (a = 0; a < 3; a++) {
        l->lo[a] = c->box_lo[a];
        l->hi[a] = c->box_hi[a];
        center[a] = (l->lo[a] + l->hi[a]) * 0.5f;
    }
    shape->sum[0] = 0.0;
    t = 0;
    do { /* a cluster has a triangle at least */
        const float *p = position + 3 * tri[3 * t], *q = position + 3 * tri[3 * t + 1],
            *r = position + 3 * tri[3 * t + 2];
        double n[3], len, o, sign = 1.0, e;
        zbufrandi_cross(p, q, r, n);
        len = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        shape->sum[t + 1] = shape->sum[t] + 0.5 * len;
        e = zbufrandi_longest2(p, q, r);
        edge2 = e > edge2 ? e : edge2;
        for (a = 0; a < 3; a++) {
            n[a] /= len;
            shape->normal[t][a] = (float)n[a];
        }
        /* both sides are seen: take the one that narrows the cone */
        if (l->flags && n[0] * axis[0] + n[1] * axis[1] + n[2] * axis[2] < 0.0) sign = -1.0;
        shape->sign[t] = (int8_t)sign;
        o = 0.0;
        for (a = 0; a < 3; a++) {
            n[a] *= sign;
            axis[a] += n[a];
            o += n[a] * ((double)p[a] - (double)center[a]);
        }
        o_lo = o < o_lo ? o : o_lo;
        o_hi = o > o_hi ? o : o_hi;
    } while (++t < c->triangle_count);
    length = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    if (length > 1e-6 * (double)c->triangle_count) {
        for (a = 0; a < 3; a++) {
            axis[a] = zbufrandi_rounded(axis[a] / length);
            l->axis[a] = (float)axis[a];
        }
        for (t = 0; t < c->triangle_count; t++) {
            double d = 0.0;
            for (a = 0; a < 3; a++) d += (double)shape->sign[t] * (double)shape->normal[t][a] * axis[a];
            cosine = d < cosine ? d : cosine;
        }
    } else {
        l->axis[2] = 1.0f;
        cosine = -1.0;
    }
    l->cosine = (float)cosine;
    l->o_lo = (float)o_lo;
    l->o_hi = (float)o_hi;
    l->area = (float)shape->sum[c->triangle_count];
    l->edge = (float)sqrt(edge2);
    zbufrandi_lane_widen(l);
}

typedef struct zbufrandi_leaf_job {
    zbufrandi_build *b;
    const zbufrandi_srgb *srgb;
    const uint32_t *order;       /* nodes of one level */
    uint32_t count;
} zbufrandi_leaf_job;

/* Colour and shading normal of a point of a cluster, as the sets store them. */
static uint32_t zbufrandi_point_rgb(const zbufrandi_structure *s, const zbufrandi_cluster *c, uint32_t t,
                                    const float bary[3],
                                    const zbufrandi_srgb *srgb) {
    const uint8_t *tri = s->triangle + 3 * ((size_t)c->first_triangle + t), *rgb[3];
    uint32_t a, k, out = 0;
    if (c->flags & ZBUFRANDI_HAS_TRIANGLE_RGB) {
        const uint8_t *p = s->triangle_rgb + 3 * ((size_t)c->first_triangle + t);
        return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16;
    }
    if (!(c->flags & ZBUFRANDI_HAS_VERTEX_RGB)) return 0xffffffu;
    for (k = 0; k < 3; k++) rgb[k] = s->vertex_rgb + 3 * ((size_t)c->first_vertex + tri[k]);
    for (a = 0; a < 3; a++) {
        uint32_t byte = rgb[0][a];
        if (byte != rgb[1][a] || byte != rgb[2][a]) {
            byte = zbufrandi_srgb_byte(srgb, srgb->linear[rgb[0][a]] * bary[0] + srgb->linear[rgb[1][a]] * bary[1] +
                                             srgb->linear[rgb[2][a]] * bary[2]);
        }
        out |= byte << 8 * a;
    }
    return out;
}
static void zbufrandi_point_normal(const zbufrandi_structure *s, const zbufrandi_cluster *c, uint32_t t,
                                   const float bary[3],
                                   float n[3]) {
    const uint8_t *tri = s->triangle + 3 * ((size_t)c->first_triangle + t);
    float v[3];
    uint32_t k, a;
    n[0] = n[1] = n[2] = 0.0f;
    for (k = 0; k < 3; k++) {
        zbufrandi_oct_decode(s->vertex_normal[c->first_vertex + tri[k]], v);
        for (a = 0; a < 3; a++) n[a] += v[a] * bary[k];
    }
}

/* 64 points of a cluster: one in each 64th of its area along the curve; those of one triangle follow the R2
   sequence. */
static void zbufrandi_cluster_set(zbufrandi_build *b, uint32_t index, const zbufrandi_shape *shape,
                                  const zbufrandi_srgb *srgb) {
    zbufrandi_structure *s = b->s;
    const zbufrandi_cluster *c = &s->cluster[index];
    const float *position = s->position + 3 * (size_t)c->first_vertex;
    uint32_t seed = zbufrandi_hash32(b->scene->seed ^ zbufrandi_hash32(b->index ^ zbufrandi_hash32(index)));
    uint32_t k, t = 0, at_u = zbufrandi_hash32(seed), at_v = zbufrandi_hash32(at_u), a;
    double area = shape->sum[c->triangle_count];
    for (k = 0; k < ZBUFRANDI_SET; k++) {
        size_t to = (size_t)index * ZBUFRANDI_SET + zbufrandi_reverse6(k);
        double y = ((double)k + (double)zbufrandi_unit24(zbufrandi_hash32(seed + 0x9e3779b9u * (k + 1))))
            / ZBUFRANDI_SET * area;
        const uint8_t *tri;
        const float *p[3];
        double q[3];
        float bary[3], u, v;
        uint32_t *word;
        while (t + 1 < c->triangle_count && shape->sum[t + 1] <= y) t++;
        at_u += 3242174889u; /* plastic number: 1/g and 1/g^2 of 2^32 */
        at_v += 2447445414u;
        u = zbufrandi_unit24(at_u);
        v = zbufrandi_unit24(at_v);
        zbufrandi_square_to_triangle(&u, &v);
        bary[0] = 1.0f - u - v;
        bary[1] = u;
        bary[2] = v;
        tri = s->triangle + 3 * ((size_t)c->first_triangle + t);
        for (a = 0; a < 3; a++) p[a] = position + 3 * tri[a];
        for (a = 0; a < 3; a++) q[a] = (double)(p[0][a] * bary[0] + p[1][a] * bary[1] + p[2][a] * bary[2]);
        word = s->set + zbufrandi_set_at(to);
        word[0] = zbufrandi_set_encode(q, c->box_lo, c->box_hi, (c->flags & ZBUFRANDI_TWO_SIDED) != 0);
        word[8] = zbufrandi_oct32_encode(shape->normal[t]);
        if (s->set_rgb != NULL) s->set_rgb[to] = zbufrandi_point_rgb(s, c, t, bary, srgb);
        if (s->set_normal != NULL) {
            float n[3];
            memcpy(n, shape->normal[t], sizeof n);
            if (c->flags & ZBUFRANDI_HAS_NORMALS) zbufrandi_point_normal(s, c, t, bary, n);
            s->set_normal[to] = (uint16_t)zbufrandi_oct_encode(n);
        }
        if (s->set_material != NULL) s->set_material[to] = b->scene->mesh[c->mesh].m.material;
    }
}

enum { ZBUFRANDI_TASK_CLUSTERS = 64, ZBUFRANDI_TASK_NODES = 32 };

static void zbufrandi_leaf_task(void *ctx, uint32_t task) {
    zbufrandi_leaf_job *j = (zbufrandi_leaf_job *)ctx;
    zbufrandi_build *b = j->b;
    uint32_t i = task * ZBUFRANDI_TASK_CLUSTERS, end = i + ZBUFRANDI_TASK_CLUSTERS;
    zbufrandi_shape shape;
    zbufrandi_lane lane;
    if (end > b->s->cluster_count) end = b->s->cluster_count;
    for (; i < end; i++) {
        zbufrandi_measure_cluster(b->s, i, &shape, &lane);
        zbufrandi_lane_put(&b->s->node[b->parent[i] >> 3], b->parent[i] & 7u, &lane);
        zbufrandi_cluster_set(b, i, &shape, j->srgb);
    }
}

/* ---- build: nodes, from the leaves up ---- */

/* Cone of lane l turned towards `axis`: cosine of the widest angle between axis and a normal of the lane. */
static double zbufrandi_cone_reach(const double axis[3], const zbufrandi_lane *l, double sign) {
    double ca = 0.0, ct = (double)l->cosine, sa, st;
    int a;
    for (a = 0; a < 3; a++) ca += axis[a] * sign * (double)l->axis[a];
    if (ca > 1.0) ca = 1.0;
    if (ca <= -ct + 1e-6) return -1.0; /* angles add up to more than a half turn */
    sa = sqrt(zbufrandi_max(0.0, 1.0 - ca * ca));
    st = sqrt(zbufrandi_max(0.0, 1.0 - ct * ct));
    return ca * ct - sa * st;
}

/* Largest n . d over the normals of the cone of a lane. */
static double zbufrandi_cone_support(const zbufrandi_lane *l, double sign, const double d[3]) {
    double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), ca = 0.0, ct = (double)l->cosine;
    int a;
    if (!(length > 0.0)) return 0.0;
    for (a = 0; a < 3; a++) ca += d[a] * sign * (double)l->axis[a];
    ca /= length;
    if (ca >= ct) return length;
    return length * (ca * ct + sqrt(zbufrandi_max(0.0, 1.0 - ca * ca)) * sqrt(zbufrandi_max(0.0, 1.0 - ct * ct)) +
                     1e-7);
}

/* What all lanes of a node are together. */
static void zbufrandi_node_lane(const zbufrandi_node8 *n, zbufrandi_lane *out) {
    zbufrandi_lane lane[8];
    double axis[3] = {0, 0, 0}, length, cosine = 1.0, area = 0.0, o_lo = 1e300, o_hi = -1e300, sign[8];
    float center[3];
    uint32_t i, a;
    memset(out, 0, sizeof *out);
    zbufrandi_box_empty(out->lo, out->hi);
    for (i = 0; i < n->count; i++) {
        double dot = 0.0, w;
        zbufrandi_lane_get(n, i, &lane[i]);
        zbufrandi_box_add(out->lo, out->hi, lane[i].lo, lane[i].hi);
        area += (double)lane[i].area;
        out->triangles = lane[i].triangles > UINT64_MAX - out->triangles
            ? UINT64_MAX : out->triangles + lane[i].triangles; /* edits may get there */
        out->flags = (uint8_t)(out->flags | lane[i].flags);
        if (lane[i].edge > out->edge) out->edge = lane[i].edge;
        for (a = 0; a < 3; a++) dot += axis[a] * (double)lane[i].axis[a];
        sign[i] = lane[i].flags && dot < 0.0 ? -1.0 : 1.0;
        w = (double)lane[i].area * sign[i];
        for (a = 0; a < 3; a++) axis[a] += (double)lane[i].axis[a] * w;
    }
    out->area = (float)area;
    length = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    if (length > 1e-6 * area && length > 0.0) {
        for (a = 0; a < 3; a++) {
            axis[a] = zbufrandi_rounded(axis[a] / length);
            out->axis[a] = (float)axis[a];
        }
        for (i = 0; i < n->count; i++)
            cosine = zbufrandi_min(cosine, zbufrandi_cone_reach(axis, &lane[i], sign[i]) - 1e-6);
        cosine = zbufrandi_max(cosine, -1.0);
    } else {
        out->axis[2] = 1.0f;
        cosine = -1.0;
    }
    out->cosine = zbufrandi_float_down(cosine);
    for (a = 0; a < 3; a++) center[a] = (out->lo[a] + out->hi[a]) * 0.5f;
    for (i = 0; i < n->count; i++) {
        double d[3], e[3], lo, hi;
        for (a = 0; a < 3; a++) {
            d[a] = (double)((lane[i].lo[a] + lane[i].hi[a]) * 0.5f) - (double)center[a];
            e[a] = -d[a];
        }
        lo = (sign[i] > 0.0 ? (double)lane[i].o_lo : -(double)lane[i].o_hi) - zbufrandi_cone_support(&lane[i], sign[i],
                                                                                                     e);
        hi = (sign[i] > 0.0 ? (double)lane[i].o_hi : -(double)lane[i].o_lo) + zbufrandi_cone_support(&lane[i], sign[i],
                                                                                                     d);
        o_lo = zbufrandi_min(o_lo, lo);
        o_hi = zbufrandi_max(o_hi, hi);
    }
    out->o_lo = (float)o_lo;
    out->o_hi = (float)o_hi;
    zbufrandi_lane_widen(out);
}

/* What the lane of an instance says: the root of its structure, moved. The box is already there. */
static void zbufrandi_instance_lane(const zbufrand_scene *scene, const zbufrandi_instance *it, zbufrandi_lane *l) {
    const zbufrandi_structure *to = &scene->structure[it->structure];
    zbufrandi_lane root;
    double c[3], moved[3], shift[3], margin;
    int a, k;
    zbufrandi_node_lane(&to->node[0], &root);
    for (a = 0; a < 3; a++) {
        double v = 0.0;
        for (k = 0; k < 3; k++) v += it->to_parent[a][k] * (double)root.axis[k];
        l->axis[a] = (float)(v / it->scale);
        c[a] = (double)((root.lo[a] + root.hi[a]) * 0.5f);
    }
    zbufrandi_m34_point(ZBUFRANDI_M34(it->to_parent), c, moved);
    /* of the centre, by rounding */
    for (a = 0; a < 3; a++) shift[a] = moved[a] - (double)((l->lo[a] + l->hi[a]) * 0.5f);
    margin = sqrt(shift[0] * shift[0] + shift[1] * shift[1] + shift[2] * shift[2]);
    l->cosine = zbufrandi_float_down(zbufrandi_max(-1.0, (double)root.cosine - 1e-6));
    l->o_lo = zbufrandi_float_down((double)root.o_lo * it->scale - margin);
    l->o_hi = zbufrandi_float_up((double)root.o_hi * it->scale + margin);
    l->area = (float)(to->area * it->scale * it->scale);
    l->edge = zbufrandi_float_up((double)root.edge * it->scale);
    l->triangles = to->virtual_triangles;
    l->flags = root.flags;
}

/* a direction into the parent, same length */
static void zbufrandi_instance_rotate(const zbufrandi_instance *it, float v[3]) {
    double r[3];
    int a;
    for (a = 0; a < 3; a++) {
        r[a] = (it->to_parent[a][0] * (double)v[0] + it->to_parent[a][1] * (double)v[1] + it->to_parent[a][2] *
                (double)v[2]) /
               it->scale;
    }
    for (a = 0; a < 3; a++) v[a] = (float)r[a];
}

typedef struct zbufrandi_deep_point { /* a stored point of a cluster, seen from a structure above it */
    double p[3];
    float normal[3], shading[3];   /* unit; of the triangle and for shading */
    uint32_t rgb, material, two_sided;
} zbufrandi_deep_point;

typedef struct zbufrandi_deep_at { /* where such a point is stored, and from where it is seen */
    const zbufrandi_structure *s;
    const zbufrandi_node8 *n;
    double m[3][4];
    size_t at;                     /* in the sets of s */
    uint32_t lane;                 /* of n; 8: nowhere */
    int moved;                     /* m is not the identity */
} zbufrandi_deep_at;

/* The point of a structure, of what its instances show too, at which a share y of the area, 0 to 1, comes before it in
   the order of the trees: as likely as its area makes it, of all points of all clusters. What is shared by many would
   else hand the same 64 points up, level by level, and whatever is far away would have the colour of the few of them
   that hide the others. y is a multiple of 2^-30, and each choice between children spends of that: where little is left
   it gets 24 bits more, of h. Of more than 2^30 things below it would else be the first one, everywhere. */
static void zbufrandi_deep_find(const zbufrand_scene *scene, const zbufrandi_structure *s, double y, uint32_t h,
                                zbufrandi_deep_at *out) {
    const zbufrandi_node8 *n = s->node;
    double step = 1.0 / 1073741824.0; /* of y */
    uint32_t i, k, child, stratum;
    memset(out, 0, sizeof *out);
    zbufrandi_m34_identity(out->m);
    out->lane = 8;
    for (;;) {
        double sum[9], area;
        if (s->node_count == 0 || n->count == 0) return; /* edits may leave nothing; then no area leads here */
        sum[0] = 0.0;
        for (i = 0; i < n->count; i++) sum[i + 1] = sum[i] + (double)n->area[i];
        y *= sum[n->count];
        for (i = 0, k = 1; k < n->count; k++) i += sum[k] <= y; /* no branch to guess */
        while (i > 0 && !(n->area[i] > 0.0f)) i--; /* rounding */
        area = (double)n->area[i];
        y = area > 0.0 ? (y - sum[i]) / area : 0.0;
        step = area > 0.0 ? step * sum[n->count] / area : step;
        if (step > 1.0 / 65536.0) {
            h = zbufrandi_hash32(h + 0x9e3779b9u);
            y = step < 1.0 ? y + step * (double)zbufrandi_unit24(h) : (double)zbufrandi_unit24(h);
            step = zbufrandi_min(step, 1.0) * (1.0 / 16777216.0);
        }
        y = y > 0.0 ? (y < 1.0 ? y : 1.0) : 0.0;
        child = n->child[i];
        if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_CLUSTER) break;
        if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_INSTANCE) {
            const zbufrandi_instance *it = &s->instance[ZBUFRANDI_CHILD_INDEX(child)];
            zbufrandi_m34_mul(ZBUFRANDI_M34(out->m), ZBUFRANDI_M34(it->to_parent), out->m);
            s = &scene->structure[it->structure];
            n = s->node;
            out->moved = 1;
        } else {
            n = &s->node[ZBUFRANDI_CHILD_INDEX(child)];
        }
    }
    stratum = y * ZBUFRANDI_SET >= 63.0 ? 63u : (uint32_t)(y * ZBUFRANDI_SET);
    out->s = s;
    out->n = n;
    out->lane = i;
    out->at = (size_t)ZBUFRANDI_CHILD_INDEX(child) * ZBUFRANDI_SET + zbufrandi_reverse6(stratum);
    ZBUFRANDI_PREFETCH(s->set + zbufrandi_set_at(out->at));
    if (s->set_rgb != NULL) ZBUFRANDI_PREFETCH(&s->set_rgb[out->at]);
}

static void zbufrandi_deep_read(const zbufrandi_deep_at *from, zbufrandi_deep_point *out) {
    const zbufrandi_structure *s = from->s;
    const size_t at = from->at;
    const uint32_t *word;
    float lo[3], hi[3];
    uint32_t a, k;
    memset(out, 0, sizeof *out);
    out->normal[2] = out->shading[2] = 1.0f;
    if (from->lane == 8) return;
    word = s->set + zbufrandi_set_at(at);
    for (a = 0; a < 3; a++) {
        lo[a] = from->n->lo[a][from->lane];
        hi[a] = from->n->hi[a][from->lane];
    }
    zbufrandi_set_decode(word[0], lo, hi, out->p);
    zbufrandi_oct32_decode(word[8], out->normal);
    if (s->set_normal != NULL) zbufrandi_oct_decode(s->set_normal[at], out->shading);
    else memcpy(out->shading, out->normal, sizeof out->shading);
    out->two_sided = word[0] >> 31;
    out->rgb = s->set_rgb != NULL ? s->set_rgb[at] : 0xffffffu;
    out->material = s->set_material != NULL ? s->set_material[at] : s->material;
    if (!from->moved) return;
    zbufrandi_m34_point(ZBUFRANDI_M34(from->m), out->p, out->p);
    for (k = 0; k < 2; k++) {
        float *v = k == 0 ? out->normal : out->shading;
        double r[3], length = 0.0;
        for (a = 0; a < 3; a++) {
            r[a] = from->m[a][0] * (double)v[0] + from->m[a][1] * (double)v[1] + from->m[a][2] * (double)v[2];
            length += r[a] * r[a];
        }
        length = length > 0.0 ? 1.0 / sqrt(length) : 0.0;
        for (a = 0; a < 3; a++) v[a] = (float)(r[a] * length);
    }
}

/* ... as point `to` of a set of the box lo, hi. */
static void zbufrandi_deep_put(zbufrandi_structure *s, const zbufrandi_deep_point *d, const float lo[3],
                               const float hi[3], size_t to) {
    s->set[zbufrandi_set_at(to)] = zbufrandi_set_encode(d->p, lo, hi, (int)d->two_sided);
    s->set[zbufrandi_set_at(to) + 8] = zbufrandi_oct32_encode(d->normal);
    if (s->set_rgb != NULL) s->set_rgb[to] = d->rgb;
    if (s->set_material != NULL) s->set_material[to] = d->material;
    if (s->set_normal != NULL) s->set_normal[to] = (uint16_t)zbufrandi_oct_encode(d->shading);
}

/* A point of stratum j, of 64, of instance `it`, for point `to` of a set of the structure that it is in. */
static void zbufrandi_set_find(const zbufrandi_build *b, const zbufrandi_instance *it, uint32_t j, size_t to,
                               zbufrandi_deep_at *out) {
    const uint32_t h = zbufrandi_hash32(b->scene->seed ^ zbufrandi_hash32(b->index ^
                                                                       zbufrandi_hash32((uint32_t)to + 0x3c6ef372u)));
    zbufrandi_deep_find(b->scene, &b->scene->structure[it->structure],
                        ((double)zbufrandi_reverse6(j) + (double)zbufrandi_unit24(h)) / ZBUFRANDI_SET, h, out);
}

static void zbufrandi_set_deep(zbufrandi_build *b, const zbufrandi_instance *it, const zbufrandi_deep_at *from,
                               const float lo[3], const float hi[3], size_t to) {
    zbufrandi_deep_point d;
    zbufrandi_deep_read(from, &d);
    zbufrandi_m34_point(ZBUFRANDI_M34(it->to_parent), d.p, d.p);
    zbufrandi_instance_rotate(it, d.normal);
    zbufrandi_instance_rotate(it, d.shading);
    zbufrandi_deep_put(b->s, &d, lo, hi, to);
}

/* Stored point j of the set of child `i` of a node, no instance, appended as point `to` of another set of the same
   structure. */
static void zbufrandi_set_copy(zbufrandi_build *b, const zbufrandi_node8 *n, uint32_t i, uint32_t j, const float lo[3],
                               const float hi[3], size_t to) {
    zbufrandi_structure *s = b->s;
    const uint32_t kind = ZBUFRANDI_CHILD_KIND(n->child[i]);
    uint32_t index = ZBUFRANDI_CHILD_INDEX(n->child[i]), a;
    float child_lo[3], child_hi[3];
    double p[3];
    size_t at;
    const uint32_t *word;
    for (a = 0; a < 3; a++) {
        child_lo[a] = n->lo[a][i];
        child_hi[a] = n->hi[a][i];
    }
    if (kind == ZBUFRANDI_CHILD_NODE) index += s->cluster_count;
    at = (size_t)index * ZBUFRANDI_SET + j;
    word = s->set + zbufrandi_set_at(at);
    zbufrandi_set_decode(word[0], child_lo, child_hi, p);
    s->set[zbufrandi_set_at(to)] = zbufrandi_set_encode(p, lo, hi, (int)(word[0] >> 31));
    s->set[zbufrandi_set_at(to) + 8] = word[8];
    if (s->set_rgb != NULL) s->set_rgb[to] = s->set_rgb[at];
    if (s->set_material != NULL) s->set_material[to] = s->set_material[at];
    if (s->set_normal != NULL) s->set_normal[to] = s->set_normal[at];
}

/* The lanes of a node that stand for nodes and instances, then the node's own stored points: children get their share
   of the 64 by area, in order; equal steps with one random start, so that no point of a child is taken twice. */
static void zbufrandi_node_finish(zbufrandi_build *b, uint32_t index) {
    zbufrandi_structure *s = b->s;
    zbufrandi_node8 *n = &s->node[index];
    zbufrandi_lane lane, own;
    double sum[9], y, start;
    enum { AHEAD = 16 };
    zbufrandi_deep_at deep[AHEAD];
    uint32_t from[AHEAD];
    uint32_t i, k, seed = zbufrandi_hash32(b->scene->seed ^ zbufrandi_hash32(~b->index ^ zbufrandi_hash32(index)));
    size_t first = ((size_t)s->cluster_count + index) * ZBUFRANDI_SET;
    memset(sum, 0, sizeof sum);
    for (i = 0; i < n->count; i++) {
        uint32_t kind = ZBUFRANDI_CHILD_KIND(n->child[i]), at = ZBUFRANDI_CHILD_INDEX(n->child[i]);
        if (kind == ZBUFRANDI_CHILD_NODE) {
            zbufrandi_node_lane(&s->node[at], &lane);
            zbufrandi_lane_put(n, i, &lane);
        } else if (kind == ZBUFRANDI_CHILD_INSTANCE) {
            zbufrandi_lane_get(n, i, &lane);
            zbufrandi_instance_lane(b->scene, &s->instance[at], &lane);
            zbufrandi_lane_put(n, i, &lane);
        }
        sum[i + 1] = sum[i] + (double)n->area[i];
    }
    zbufrandi_node_lane(n, &own);
    start = (double)zbufrandi_unit24(seed);
    for (i = 0, k = 0; k < ZBUFRANDI_SET; k++) {
        double f;
        uint32_t stratum, at;
        y = ((double)k + start) / ZBUFRANDI_SET * sum[n->count];
        while (i + 1 < n->count && sum[i + 1] <= y) i++;
        f = (y - sum[i]) / (sum[i + 1] - sum[i]) * ZBUFRANDI_SET;
        stratum = !(f > 0.0) ? 0u : f >= 63.0 ? 63u : (uint32_t)f;
        from[k % AHEAD] = i;
        if (ZBUFRANDI_CHILD_KIND(n->child[i]) == ZBUFRANDI_CHILD_INSTANCE)
            zbufrandi_set_find(b, &s->instance[ZBUFRANDI_CHILD_INDEX(n->child[i])], zbufrandi_reverse6(stratum),
                               first + zbufrandi_reverse6(k), &deep[k % AHEAD]);
        else
            zbufrandi_set_copy(b, n, i, zbufrandi_reverse6(stratum), own.lo, own.hi, first + zbufrandi_reverse6(k));
        if (k % AHEAD != AHEAD - 1) continue;
        for (at = 0; at < AHEAD; at++) { /* what instances show is far away in memory */
            const uint32_t child = n->child[from[at]];
            if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_INSTANCE)
                zbufrandi_set_deep(b, &s->instance[ZBUFRANDI_CHILD_INDEX(child)], &deep[at], own.lo, own.hi,
                                   first + zbufrandi_reverse6(k - (AHEAD - 1) + at));
        }
    }
}

static void zbufrandi_node_task(void *ctx, uint32_t task) {
    zbufrandi_leaf_job *j = (zbufrandi_leaf_job *)ctx;
    uint32_t i = task * ZBUFRANDI_TASK_NODES, end = i + ZBUFRANDI_TASK_NODES;
    if (end > j->count) end = j->count;
    for (; i < end; i++) zbufrandi_node_finish(j->b, j->order[i]);
}

/* ---- build: one structure ---- */

static void zbufrandi_structure_free(zbufrandi_mem *mem, zbufrandi_structure *s) {
    zbufrandi_free(mem, s->position);
    zbufrandi_free(mem, s->triangle);
    zbufrandi_free(mem, s->cluster);
    zbufrandi_free(mem, s->node);
    zbufrandi_free(mem, s->instance);
    zbufrandi_free(mem, s->set);
    zbufrandi_free(mem, s->view);
    zbufrandi_free(mem, s->vertex_normal);
    zbufrandi_free(mem, s->vertex_rgb);
    zbufrandi_free(mem, s->triangle_rgb);
    zbufrandi_free(mem, s->triangle_id);
    zbufrandi_free(mem, s->set_rgb);
    zbufrandi_free(mem, s->set_normal);
    zbufrandi_free(mem, s->set_material);
    zbufrandi_free(mem, s->item_sum);
    zbufrandi_lists_free(mem, s->lists);
    memset(s, 0, sizeof *s);
}

static void zbufrandi_structures_free(zbufrand_scene *scene) {
    uint32_t i;
    zbufrandi_live_free(scene);
    zbufrandi_scene_rays_free(scene);
    for (i = 0; i < scene->structure_count; i++) zbufrandi_structure_free(&scene->mem, &scene->structure[i]);
    zbufrandi_free(&scene->mem, scene->structure);
    scene->structure = NULL;
    scene->structure_count = 0;
    memset(&scene->info, 0, sizeof scene->info);
}

static void zbufrandi_sort_doubles(double *v, size_t n) { /* Shell sort: a thousand of them */
    size_t gap, i, j;
    for (gap = n / 2; gap > 0; gap = gap == 2 ? 1 : gap * 5 / 11) {
        for (i = gap; i < n; i++) {
            double x = v[i];
            for (j = i; j >= gap && v[j - gap] > x; j -= gap) v[j] = v[j - gap];
            v[j] = x;
        }
    }
}

enum { ZBUFRANDI_PROBES = 511 };

/* Where most of the structure is: the median of up to 511 corners and 511 instances. A stray point far out costs the
   rest no precision, as it would if the middle of the box were taken. */
static int zbufrandi_find_origin(zbufrandi_build *b) { /* 0: no memory */
    zbufrand_scene *scene = b->scene;
    const zbufrandi_gather *g = b->gather;
    double (*probe)[2 * ZBUFRANDI_PROBES] = (double (*)[2 * ZBUFRANDI_PROBES])zbufrandi_alloc(&scene->mem,
                                                                                              3 * sizeof *probe);
    uint64_t total = 0, before = 0, next = 0, step;
    size_t i, n = 0;
    uint32_t a, v[3];
    if (probe == NULL) return 0;
    for (i = 0; i < g->piece_count; i++) total += scene->mesh[g->piece[i].mesh].m.triangle_count;
    step = total / ZBUFRANDI_PROBES + 1;
    for (i = 0; i < g->piece_count; i++) {
        const zbufrand_mesh *m = &scene->mesh[g->piece[i].mesh].m;
        for (; next < before + m->triangle_count; next += step) {
            float f[3];
            double p[3];
            if (!zbufrandi_corners(m, (size_t)(next - before), v)) continue;
            memcpy(f, (const uint8_t *)m->positions + (size_t)v[0] * m->position_stride, sizeof f);
            for (a = 0; a < 3; a++) p[a] = (double)f[a];
            zbufrandi_m34_point(ZBUFRANDI_M34(g->piece[i].m), p, p);
            if (!zbufrandi_finite(p[0]) || !zbufrandi_finite(p[1]) || !zbufrandi_finite(p[2])) continue;
            for (a = 0; a < 3; a++) probe[a][n] = p[a];
            n++;
        }
        before += m->triangle_count;
    }
    for (i = 0; i < g->instance_count; i += g->instance_count / ZBUFRANDI_PROBES + 1) {
        double p[3];
        zbufrandi_m34_point(ZBUFRANDI_M34(g->instance[i].to_parent), scene->structure[g->instance[i].structure].origin,
                            p);
        for (a = 0; a < 3; a++) probe[a][n] = p[a];
        n++;
    }
    for (a = 0; a < 3; a++) {
        zbufrandi_sort_doubles(probe[a], n);
        b->s->origin[a] = n != 0 ? probe[a][n / 2] : 0.0;
    }
    zbufrandi_free(&scene->mem, probe);
    return 1;
}

/* Transforms refer to origins from now on. */
static void zbufrandi_place_instances(zbufrandi_build *b) {
    zbufrandi_structure *s = b->s;
    zbufrandi_gather *g = b->gather;
    size_t i, first = 0;
    int a;
    for (i = 0; i < g->instance_count; i++) {
        zbufrandi_instance *it = &g->instance[i];
        double p[3];
        zbufrandi_m34_point(ZBUFRANDI_M34(it->to_parent), b->scene->structure[it->structure].origin, p);
        for (a = 0; a < 3; a++) it->to_parent[a][3] = p[a] - s->origin[a];
        if (it->node != g->instance[first].node) first = i;
        zbufrandi_build_home(b, it->node, (uint32_t)first, (uint32_t)(i - first + 1));
    }
    s->instance = g->instance;
    s->instance_count = (uint32_t)g->instance_count;
    g->instance = NULL;
}

/* The box of an instance in its parent. 0: out of range. */
static int zbufrandi_instance_box(const zbufrandi_instance *it, const zbufrandi_structure *to, float lo[3],
                                  float hi[3]) {
    int a, k, ok = 1;
    for (a = 0; a < 3; a++) {
        double c = it->to_parent[a][3], e = 0.0;
        for (k = 0; k < 3; k++) {
            c += it->to_parent[a][k] * (0.5 * ((double)to->box_lo[k] + (double)to->box_hi[k]));
            e += zbufrandi_abs(it->to_parent[a][k]) * (0.5 * ((double)to->box_hi[k] - (double)to->box_lo[k]));
        }
        /* boxes that are turned grow, balls do not */
        e = zbufrandi_min(e, (double)to->radius * it->scale * (1.0 + 1e-12));
        e += 1e-15 * (zbufrandi_abs(c) + e);
        ok &= zbufrandi_abs(c) + e <= 1e15;
        lo[a] = zbufrandi_float_down(zbufrandi_max(c - e, -1e15));
        hi[a] = zbufrandi_float_up(zbufrandi_min(c + e, 1e15));
    }
    return ok;
}

/* Instances of structures without triangles are left out. *count: of items. Returns the node of an instance whose place
   is out of range; 0: there is none. */
static uint32_t zbufrandi_make_items(zbufrandi_build *b, zbufrandi_item *item, uint32_t *count) {
    const zbufrandi_structure *s = b->s;
    uint32_t i, n = 0;
    for (i = 0; i < s->cluster_count; i++) {
        memcpy(item[n].lo, s->cluster[i].box_lo, sizeof item[n].lo);
        memcpy(item[n].hi, s->cluster[i].box_hi, sizeof item[n].hi);
        item[n++].child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_CLUSTER, i);
    }
    for (i = 0; i < s->instance_count; i++) {
        const zbufrandi_structure *to = &b->scene->structure[s->instance[i].structure];
        if (to->node_count == 0 || s->instance[i].hidden) continue;
        if (!zbufrandi_instance_box(&s->instance[i], to, item[n].lo, item[n].hi)) return s->instance[i].node;
        item[n++].child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_INSTANCE, i);
    }
    *count = n;
    return 0;
}

/* Which attributes the stored points need. 0: no memory. */
static int zbufrandi_alloc_sets(zbufrandi_build *b) {
    zbufrandi_mem *mem = &b->scene->mem;
    zbufrandi_structure *s = b->s;
    size_t count = ((size_t)s->cluster_count + s->node_count) * ZBUFRANDI_SET;
    uint32_t i, first = 1, mixed = 0;
    int rgb = s->vertex_rgb != NULL || s->triangle_rgb != NULL, normal = s->vertex_normal != NULL;
    for (i = 0; i < s->cluster_count; i++) {
        uint32_t m = b->scene->mesh[s->cluster[i].mesh].m.material;
        if (first) s->material = m;
        mixed |= m != s->material;
        first = 0;
    }
    for (i = 0; i < s->instance_count; i++) {
        const zbufrandi_structure *to = &b->scene->structure[s->instance[i].structure];
        rgb |= to->set_rgb != NULL;
        normal |= to->set_normal != NULL;
        if (first) s->material = to->material;
        mixed |= to->material != s->material || to->set_material != NULL;
        first = 0;
    }
    s->set = (uint32_t *)zbufrandi_alloc_array(mem, count, 2 * sizeof *s->set);
    s->item_sum = (double *)zbufrandi_alloc_array(mem, (size_t)s->cluster_count + s->instance_count + 1,
                                                  sizeof *s->item_sum);
    if (rgb) s->set_rgb = (uint32_t *)zbufrandi_alloc_array(mem, count, sizeof *s->set_rgb);
    if (normal) s->set_normal = (uint16_t *)zbufrandi_alloc_array(mem, count, sizeof *s->set_normal);
    if (mixed) s->set_material = (uint32_t *)zbufrandi_alloc_array(mem, count, sizeof *s->set_material);
    return s->set != NULL && s->item_sum != NULL && (!rgb || s->set_rgb != NULL) &&
        (!normal || s->set_normal != NULL) &&
           (!mixed || s->set_material != NULL);
}

/* Fill in the lanes and the stored points, deepest nodes first. 0: no memory. */
static int zbufrandi_finish_tree(zbufrandi_build *b) {
    zbufrandi_mem *mem = &b->scene->mem;
    zbufrandi_structure *s = b->s;
    zbufrandi_srgb *srgb = (zbufrandi_srgb *)zbufrandi_alloc(mem, sizeof *srgb);
    uint32_t *level = (uint32_t *)zbufrandi_alloc_zero(mem, s->node_count, sizeof *level);
    uint32_t *order = (uint32_t *)zbufrandi_alloc_array(mem, s->node_count, sizeof *order);
    uint32_t i, k, deepest = 0, at;
    zbufrandi_leaf_job j;
    int ok = srgb != NULL && level != NULL && order != NULL;
    if (ok) {
        zbufrandi_srgb_open(srgb);
        j.b = b;
        j.srgb = srgb;
        j.order = order;
        j.count = 0;
        zbufrandi_parallel_for(&b->scene->env, zbufrandi_leaf_task, &j,
                               (s->cluster_count + ZBUFRANDI_TASK_CLUSTERS - 1) / ZBUFRANDI_TASK_CLUSTERS);
        for (i = 0; i < s->node_count; i++) {
            for (k = 0; k < s->node[i].count; k++) {
                if (ZBUFRANDI_CHILD_KIND(s->node[i].child[k]) != ZBUFRANDI_CHILD_NODE) continue;
                level[ZBUFRANDI_CHILD_INDEX(s->node[i].child[k])] = level[i] + 1;
            }
            deepest = level[i] > deepest ? level[i] : deepest;
        }
        for (at = deepest + 1; at > 0; at--) {
            j.count = 0;
            for (i = 0; i < s->node_count; i++) if (level[i] == at - 1) order[j.count++] = i;
            zbufrandi_parallel_for(&b->scene->env, zbufrandi_node_task, &j,
                                   (j.count + ZBUFRANDI_TASK_NODES - 1) / ZBUFRANDI_TASK_NODES);
        }
    }
    zbufrandi_free(mem, srgb);
    zbufrandi_free(mem, level);
    zbufrandi_free(mem, order);
    return ok;
}

/* The ball around the middle of the box. Stored points are off by up to half a step of their grid. */
static void zbufrandi_structure_radius(const zbufrand_scene *scene, zbufrandi_structure *s) {
    double c[3], p[3], diagonal = 0.0, most = 0.0, r;
    size_t i;
    uint32_t k;
    int a;
    for (a = 0; a < 3; a++) {
        c[a] = 0.5 * ((double)s->box_lo[a] + (double)s->box_hi[a]);
        diagonal += ((double)s->box_hi[a] - c[a]) * ((double)s->box_hi[a] - c[a]);
    }
    for (i = 0; i < s->vertex_count; i++) {
        for (a = 0, r = 0.0; a < 3; a++) {
            p[a] = (double)s->position[3 * i + (size_t)a] - c[a];
            r += p[a] * p[a];
        }
        most = zbufrandi_max(most, r);
    }
    most = sqrt(most);
    for (i = 0; i < s->instance_count; i++) {
        const zbufrandi_instance *it = &s->instance[i];
        const zbufrandi_structure *to = &scene->structure[it->structure];
        if (to->node_count == 0 || it->hidden) continue;
        for (k = 0; k < 3; k++) p[k] = 0.5 * ((double)to->box_lo[k] + (double)to->box_hi[k]);
        zbufrandi_m34_point(ZBUFRANDI_M34(it->to_parent), p, p);
        for (a = 0, r = 0.0; a < 3; a++) r += (p[a] - c[a]) * (p[a] - c[a]);
        most = zbufrandi_max(most, sqrt(r) + (double)to->radius * it->scale);
    }
    diagonal = sqrt(diagonal);
    s->radius = zbufrandi_float_up(zbufrandi_min(most + 0.001 * diagonal, diagonal) * (1.0 + 1e-6));
}

/* Areas and counts of the whole structure. 0: more than 2^64 - 1 triangles. */
static int zbufrandi_structure_totals(zbufrandi_build *b) {
    zbufrandi_structure *s = b->s;
    zbufrandi_lane root;
    uint32_t i, items = s->cluster_count + s->instance_count;
    s->virtual_triangles = s->triangle_count;
    zbufrandi_node_lane(&s->node[0], &root);
    memcpy(s->box_lo, root.lo, sizeof s->box_lo);
    memcpy(s->box_hi, root.hi, sizeof s->box_hi);
    zbufrandi_structure_radius(b->scene, s);
    s->item_sum[0] = 0.0;
    for (i = 0; i < items; i++) {
        s->item_sum[i + 1] = s->item_sum[i];
        if (b->parent[i] != ~0u) s->item_sum[i + 1] += (double)s->node[b->parent[i] >> 3].area[b->parent[i] & 7u];
    }
    s->area = s->item_sum[items];
    for (i = 0; i < s->instance_count; i++) {
        const zbufrandi_structure *to = &b->scene->structure[s->instance[i].structure];
        if (s->instance[i].hidden) continue;
        if (to->virtual_triangles > UINT64_MAX - s->virtual_triangles) return 0;
        s->virtual_triangles += to->virtual_triangles;
        if (to->node_count != 0 && to->depth + 1 > s->depth) s->depth = to->depth + 1;
    }
    return 1;
}

/* Tree and stored points over the clusters and instances that the structure has by now. */
static zbufrand_result zbufrandi_build_over(zbufrandi_build *b) {
    zbufrand_scene *scene = b->scene;
    zbufrandi_mem *mem = &scene->mem;
    zbufrandi_structure *s = b->s;
    zbufrandi_item *item = NULL;
    const size_t items = (size_t)s->cluster_count + s->instance_count;
    uint32_t count = 0, far_off = 0;
    int ok = 1, fits = 1;
    if (items >= ZBUFRANDI_STRUCTURE_ITEMS) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, items,
                              "% clusters and instances in one structure are too many");
    }
    if (items != 0) {
        item = (zbufrandi_item *)zbufrandi_alloc_array(mem, items, sizeof *item);
        b->parent = (uint32_t *)zbufrandi_alloc_array(mem, items, sizeof *b->parent);
        ok = item != NULL && b->parent != NULL;
        if (ok) memset(b->parent, 0xff, items * sizeof *b->parent);
        if (ok) far_off = zbufrandi_make_items(b, item, &count);
        if (count != 0) {
            ok = zbufrandi_build_tree(b, item, count);
            zbufrandi_free(mem, item);
            item = NULL;
            ok = ok && zbufrandi_alloc_sets(b) && zbufrandi_finish_tree(b);
            if (ok) fits = zbufrandi_structure_totals(b);
        }
        zbufrandi_free(mem, item);
        zbufrandi_free(mem, b->parent);
        b->parent = NULL;
    }
    if (far_off != 0) return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, far_off,
                                            "node %: further than 1e15 from the middle of what it is in");
    if (!fits) return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, b->index,
                                     "structure %: more than 2^64 - 1 triangles");
    if (!ok) return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, b->index, "structure %: out of memory");
    return ZBUFRAND_OK;
}

static zbufrand_result zbufrandi_build_structure(zbufrandi_build *b) {
    zbufrand_scene *scene = b->scene;
    zbufrandi_mem *mem = &scene->mem;
    zbufrandi_structure *s = b->s;
    zbufrand_result r = ZBUFRAND_OK;
    size_t i;
    int ok = zbufrandi_find_origin(b);
    for (i = 0; ok && i < b->gather->piece_count && r == ZBUFRAND_OK; i++)
        r = zbufrandi_build_piece(b, &b->gather->piece[i]);
    if (r != ZBUFRAND_OK) return r;
    if (ok && s->triangle_count != 0) { /* give back what growing took too much */
        ok = (b->triangle_capacity == s->triangle_count || zbufrandi_resize_triangles(b, s->triangle_count)) &&
             (b->vertex_capacity == s->vertex_count || zbufrandi_resize_vertices(b, s->vertex_count)) &&
             (b->cluster_capacity == s->cluster_count ||
              zbufrandi_reserve(mem, (void **)&s->cluster, s->cluster_count, s->cluster_count, sizeof *s->cluster, 0));
    }
    if (ok) {
        zbufrandi_place_instances(b);
        ok = b->gather->instance_capacity == s->instance_count ||
             zbufrandi_reserve(mem, (void **)&s->instance, s->instance_count, s->instance_count, sizeof *s->instance,
                               0);
    }
    if (!ok) return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, b->index, "structure %: out of memory");
    return zbufrandi_build_over(b);
}

/* ---- build: stored points for directions of view ---- */

enum {
    ZBUFRANDI_VIEW_LANES = 64,     /* children that the points of views are taken from, 64 of each */
    ZBUFRANDI_VIEW_LANES_LEAST = 8,
    ZBUFRANDI_VIEW_INSTANCES = 32, /* fewer of them are not worth the memory */
    ZBUFRANDI_MORE_INSTANCES = 512 /* as many may fill a picture: their mean colour is seen */
};
/* Views are for an eye at least this many times as far away as the corners of the box from its middle; directions to it
   then differ by less than 1/16 over the structure. */
#define ZBUFRANDI_VIEW_DISTANCE 17.0f
#define ZBUFRANDI_VIEW_PARALLAX 0.0625

/* Cell of a direction: the side of the cube, and which quarter of its right angle along both other axes. */
ZBUFRANDI_INLINE uint32_t zbufrandi_view_cell(const float v[3]) {
    const float x = zbufrandi_absf(v[0]), y = zbufrandi_absf(v[1]), z = zbufrandi_absf(v[2]);
    const uint32_t side = x >= y && x >= z ? 0u : y >= z ? 1u : 2u, next = side == 2 ? 0u : side + 1u;
    const float a = v[next], b = v[3u - side - next], most = side == 0 ? x : side == 1 ? y : z;
    const float part = most * 0.41421356f;
    return (2 * side + (v[side] < 0.0f)) * 16u + (uint32_t)(a > 0.0f - part) + (uint32_t)(a > 0.0f) +
        (uint32_t)(a > part) + 4u * ((uint32_t)(b > 0.0f - part) + (uint32_t)(b > 0.0f) + (uint32_t)(b > part));
}

/* The direction at a corner of a cell, 0, 0 to 1, 1, or in its middle: 1/2. */
static void zbufrandi_view_at(uint32_t cell, double i, double j, double v[3]) {
    const uint32_t side = cell / 32u, next = side == 2 ? 0u : side + 1u;
    const double quarter = 0.25 * 1.57079632679489662;
    double s, c;
    zbufrandi_sincos(((double)(cell & 3u) + i - 2.0) * quarter, &s, &c);
    v[next] = s / c;
    zbufrandi_sincos(((double)(cell >> 2 & 3u) + j - 2.0) * quarter, &s, &c);
    v[3u - side - next] = s / c;
    v[side] = (cell & 16u) != 0 ? -1.0 : 1.0;
    c = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (cell = 0; cell < 3; cell++) v[cell] /= c;
}

static void zbufrandi_view_open(uint32_t cell, zbufrandi_view *view) {
    double c[3], v[3], most = 0.0;
    int k, a;
    zbufrandi_view_at(cell, 0.5, 0.5, c);
    for (k = 0; k < 4; k++) { /* the corners are furthest */
        double d = 0.0;
        zbufrandi_view_at(cell, (double)(k & 1), (double)(k >> 1), v);
        for (a = 0; a < 3; a++) d += (v[a] - c[a]) * (v[a] - c[a]);
        most = zbufrandi_max(most, d);
    }
    for (a = 0; a < 3; a++) view->axis[a] = (float)c[a];
    view->reach = (float)(sqrt(most) + ZBUFRANDI_VIEW_PARALLAX + 1e-4);
}

/* How likely a point with this normal (of any length) is among those of a view. */
ZBUFRANDI_INLINE float zbufrandi_view_weight(const zbufrandi_view *view, const float n[3], float length,
                                             int two_sided) {
    float d = view->axis[0] * n[0] + view->axis[1] * n[1] + view->axis[2] * n[2];
    if (two_sided && d < 0.0f) d = 0.0f - d;
    d = d + view->reach * length;
    return d < length ? d : length;
}

typedef struct zbufrandi_view_job {
    zbufrandi_build *b;
    struct { uint32_t node, lane; } from[ZBUFRANDI_VIEW_LANES + 8];
    double sum[ZBUFRANDI_VIEW_LANES * ZBUFRANDI_SET + 1];
    float normal[ZBUFRANDI_VIEW_LANES * ZBUFRANDI_SET][4]; /* unit; seen from both sides */
    uint32_t count;
} zbufrandi_view_job;

/* Lanes that cover the structure: the largest node is opened, until there are enough. In the order of the tree. */
static void zbufrandi_view_lanes(zbufrandi_view_job *j) {
    const zbufrandi_structure *s = j->b->s;
    uint32_t i, k, most;
    for (j->count = 0; j->count < s->node[0].count; j->count++) {
        j->from[j->count].node = 0;
        j->from[j->count].lane = j->count;
    }
    for (;;) {
        float area = -1.0f;
        const zbufrandi_node8 *n;
        for (i = 0, most = 0; i < j->count; i++) {
            n = &s->node[j->from[i].node];
            if (ZBUFRANDI_CHILD_KIND(n->child[j->from[i].lane]) != ZBUFRANDI_CHILD_NODE) continue;
            if (n->area[j->from[i].lane] > area) {
                area = n->area[j->from[i].lane];
                most = i;
            }
        }
        if (area < 0.0f) return;
        i = ZBUFRANDI_CHILD_INDEX(s->node[j->from[most].node].child[j->from[most].lane]);
        n = &s->node[i];
        if (j->count + n->count - 1 > ZBUFRANDI_VIEW_LANES) return;
        memmove(&j->from[most + n->count], &j->from[most + 1], (j->count - most - 1) * sizeof j->from[0]);
        for (k = 0; k < n->count; k++) {
            j->from[most + k].node = i;
            j->from[most + k].lane = k;
        }
        j->count += n->count - 1;
    }
}

/* Normals of the points of all lanes, in the order of their strata. */
static void zbufrandi_view_normals(zbufrandi_view_job *j) {
    const zbufrandi_structure *s = j->b->s;
    uint32_t i, k;
    for (i = 0; i < j->count; i++) {
        const uint32_t child = s->node[j->from[i].node].child[j->from[i].lane]; /* no instance: there are none */
        size_t set = ZBUFRANDI_CHILD_INDEX(child);
        if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_NODE) set += s->cluster_count;
        for (k = 0; k < ZBUFRANDI_SET; k++) {
            const uint32_t *word = s->set + zbufrandi_set_at(set * ZBUFRANDI_SET + zbufrandi_reverse6(k));
            float *n = j->normal[i * ZBUFRANDI_SET + k];
            zbufrandi_oct32_decode(word[8], n);
            n[3] = word[0] >> 31 != 0 ? 1.0f : 0.0f;
        }
    }
}

/* Room for `sets` more behind those of clusters and nodes. 0: no memory. */
static int zbufrandi_more_room(zbufrandi_mem *mem, zbufrandi_structure *s, uint32_t sets) {
    const size_t used = ((size_t)s->cluster_count + s->node_count) * ZBUFRANDI_SET,
                 need = used + (size_t)sets * ZBUFRANDI_SET;
    return zbufrandi_reserve(mem, (void **)&s->set, used, need, 2 * sizeof *s->set, 0) &&
        (s->set_rgb == NULL || zbufrandi_reserve(mem, (void **)&s->set_rgb, used, need, sizeof *s->set_rgb, 0)) &&
        (s->set_normal == NULL ||
         zbufrandi_reserve(mem, (void **)&s->set_normal, used, need, sizeof *s->set_normal, 0)) &&
        (s->set_material == NULL ||
         zbufrandi_reserve(mem, (void **)&s->set_material, used, need, sizeof *s->set_material, 0));
}

/* The points of one view: equal steps over the weights of all points of the lanes. */
static void zbufrandi_view_make(zbufrandi_view_job *j, uint32_t cell) {
    zbufrandi_structure *s = j->b->s;
    zbufrandi_view *view = &s->view[cell];
    const uint32_t points = j->count * ZBUFRANDI_SET;
    const size_t sets = (size_t)s->cluster_count + s->node_count + (size_t)cell * ZBUFRANDI_VIEW_SETS,
                 first = sets * ZBUFRANDI_SET;
    const float start = zbufrandi_unit24(zbufrandi_hash32(j->b->scene->seed ^ zbufrandi_hash32(
        j->b->index ^ zbufrandi_hash32(cell + 0x7f4a7c15u))));
    uint32_t i, k;
    zbufrandi_view_open(cell, view);
    j->sum[0] = 0.0;
    for (i = 0; i < points; i++) {
        const uint32_t lane = i / ZBUFRANDI_SET;
        const float w = zbufrandi_view_weight(view, j->normal[i], 1.0f, j->normal[i][3] != 0.0f);
        j->sum[i + 1] = j->sum[i] + (w > 0.0f ? (double)w : 0.0) *
            (double)s->node[j->from[lane].node].area[j->from[lane].lane] / ZBUFRANDI_SET;
    }
    view->area = zbufrandi_float_up(j->sum[points]);
    for (i = 0, k = 0; k < ZBUFRANDI_VIEW_SETS * ZBUFRANDI_SET; k++) {
        const double y = ((double)k + (double)start) / (ZBUFRANDI_VIEW_SETS * ZBUFRANDI_SET) * j->sum[points];
        const size_t to = first + k % ZBUFRANDI_VIEW_SETS * ZBUFRANDI_SET + zbufrandi_reverse6(k / ZBUFRANDI_VIEW_SETS);
        while (i + 1 < points && j->sum[i + 1] <= y) i++;
        zbufrandi_set_copy(j->b, &s->node[j->from[i / ZBUFRANDI_SET].node], j->from[i / ZBUFRANDI_SET].lane,
                           zbufrandi_reverse6(i % ZBUFRANDI_SET), s->box_lo, s->box_hi, to);
    }
}

/* `more` sets for what is made of instances and drawn many times: of the whole, and an eighth as many of each node
   below the first. Deeper nodes are so many that they share out the points already. 0: no memory. */
static int zbufrandi_more_make(zbufrandi_build *b, uint32_t more) {
    zbufrandi_structure *s = b->s;
    const zbufrandi_node8 *root = &s->node[0];
    const uint32_t first = s->cluster_count + s->node_count;
    uint32_t i, v, k, a;
    enum { AHEAD = 16 };
    zbufrandi_deep_at from[AHEAD];
    if (!zbufrandi_more_room(&b->scene->mem, s, more + 8 * (more / ZBUFRANDI_MORE_PARTS))) return 0;
    for (i = 0; i <= root->count; i++) { /* the whole last: its points are drawn from nothing that is written here */
        const int whole = i == root->count;
        const uint32_t sets = whole ? more : more / ZBUFRANDI_MORE_PARTS, to = first + (whole ? 0u : more + sets * i);
        double before = 0.0, sum = 0.0;
        float lo[3], hi[3];
        for (k = 0; k < root->count; k++) {
            if (k < i) before += (double)root->area[k];
            sum += (double)root->area[k];
        }
        for (a = 0; a < 3; a++) {
            lo[a] = whole ? s->box_lo[a] : root->lo[a][i];
            hi[a] = whole ? s->box_hi[a] : root->hi[a][i];
        }
        for (v = 0; v < sets; v++) {
            for (k = 0; k < ZBUFRANDI_SET; k++) {
                const size_t at = ((size_t)to + v) * ZBUFRANDI_SET + zbufrandi_reverse6(k);
                const uint32_t h = zbufrandi_hash32(b->scene->seed ^
                                                    zbufrandi_hash32(b->index ^ zbufrandi_hash32((uint32_t)at)));
                double y = ((double)k + (double)zbufrandi_unit24(h)) / ZBUFRANDI_SET;
                uint32_t j;
                if (!whole) y = sum > 0.0 ? (before + y * (double)root->area[i]) / sum : 0.0;
                zbufrandi_deep_find(b->scene, s, y, h, &from[k % AHEAD]);
                if (k % AHEAD != AHEAD - 1) continue;
                for (j = 0; j < AHEAD; j++) { /* what instances show is far away in memory */
                    zbufrandi_deep_point d;
                    zbufrandi_deep_read(&from[j], &d);
                    zbufrandi_deep_put(s, &d, lo, hi, ((size_t)to + v) * ZBUFRANDI_SET +
                                       zbufrandi_reverse6(k - (AHEAD - 1) + j));
                }
            }
        }
    }
    s->more = more;
    s->first_more = first;
    return 1;
}

/* More sets for structures with many instances. 0: no memory. */
static int zbufrandi_scene_views(zbufrand_scene *scene) {
    uint64_t *drawn = (uint64_t *)zbufrandi_alloc_zero(&scene->mem, scene->structure_count, sizeof *drawn);
    uint32_t *uses = (uint32_t *)zbufrandi_alloc_zero(&scene->mem, scene->structure_count, sizeof *uses), i, k;
    uint64_t left = ZBUFRANDI_MORE_ALL; /* sets */
    zbufrandi_view_job *j = NULL;
    zbufrandi_build b;
    int ok = uses != NULL && drawn != NULL;
    memset(&b, 0, sizeof b);
    b.scene = scene;
    if (ok && scene->structure_count != 0) drawn[0] = 1;
    for (i = 0; ok && i < scene->structure_count; i++) { /* prototypes come after what they are in */
        const zbufrandi_structure *s = &scene->structure[i];
        left += (uint64_t)s->cluster_count + s->node_count;
        for (k = 0; k < s->instance_count; k++) {
            uint64_t *d = &drawn[s->instance[k].structure];
            uses[s->instance[k].structure]++;
            *d = drawn[i] > UINT64_MAX - *d ? UINT64_MAX : *d + drawn[i];
        }
    }
    for (i = 0; ok && i < scene->structure_count; i++) {
        b.s = &scene->structure[i];
        b.index = i;
        /* What is made of instances has thousands of different things in it, of which the 256 points of a view are no
           fair sample: all that is far away in one direction would have the colour of the few that hide the others. */
        if (drawn[i] >= ZBUFRANDI_VIEW_INSTANCES && b.s->node_count != 0 && b.s->instance_count != 0) {
            const uint32_t more = drawn[i] < ZBUFRANDI_MORE_INSTANCES ? ZBUFRANDI_MORE_SETS : ZBUFRANDI_MORE_SETS_MANY;
            if (left < 2 * more) continue;
            left -= 2 * more;
            ok = zbufrandi_more_make(&b, more);
        }
        if (!ok) break;
        if (uses[i] < ZBUFRANDI_VIEW_INSTANCES || b.s->node_count == 0 || b.s->instance_count != 0) continue;
        if (left < ZBUFRANDI_VIEWS * ZBUFRANDI_VIEW_SETS) continue;
        if (j == NULL) j = (zbufrandi_view_job *)zbufrandi_alloc(&scene->mem, sizeof *j);
        ok = j != NULL;
        if (!ok) break;
        j->b = &b;
        zbufrandi_view_lanes(j);
        if (j->count < ZBUFRANDI_VIEW_LANES_LEAST) continue;
        left -= ZBUFRANDI_VIEWS * ZBUFRANDI_VIEW_SETS;
        b.s->view = (zbufrandi_view *)zbufrandi_alloc_zero(&scene->mem, ZBUFRANDI_VIEWS, sizeof *b.s->view);
        ok = b.s->view != NULL && zbufrandi_more_room(&scene->mem, b.s, ZBUFRANDI_VIEWS * ZBUFRANDI_VIEW_SETS);
        if (!ok) break;
        zbufrandi_view_normals(j);
        for (k = 0; k < ZBUFRANDI_VIEWS; k++) zbufrandi_view_make(j, k);
        b.s->first_view = b.s->cluster_count + b.s->node_count;
    }
    zbufrandi_free(&scene->mem, j);
    zbufrandi_free(&scene->mem, uses);
    zbufrandi_free(&scene->mem, drawn);
    return ok;
}

static void zbufrandi_live_totals(const zbufrand_scene *scene, zbufrand_scene_info *info);

/* A removed node may be given out again. */
static void zbufrandi_node_free(zbufrand_scene *scene, uint32_t node) {
    scene->graph[node].next = 0;
    if (scene->free_count != 0) scene->graph[scene->free_last].next = node;
    else scene->free_first = node;
    scene->free_last = node;
    scene->free_count++;
}

/* All edits are done with, or a build makes them pointless. */
static void zbufrandi_edits_forget(zbufrand_scene *scene) {
    size_t i;
    for (i = 0; i < scene->gone_count; i++) {
        const uint32_t mesh = scene->gone[i].mesh;
        zbufrandi_node_free(scene, scene->gone[i].node);
        if (mesh == 0) continue;
        memset(&scene->mesh[mesh - 1], 0, sizeof scene->mesh[mesh - 1]);
        scene->mesh[mesh - 1].node = scene->free_mesh;
        scene->free_mesh = mesh;
    }
    for (i = 0; i < scene->pending_count; i++) scene->graph[scene->pending[i].node].pending = 0;
    scene->pending_count = scene->gone_count = scene->set_count = 0;
}

static void zbufrandi_scene_totals(zbufrand_scene *scene) {
    zbufrand_scene_info *info = &scene->info;
    const zbufrandi_structure *root = &scene->structure[0];
    uint32_t i, a;
    memset(info, 0, sizeof *info);
    for (i = 0; i < scene->structure_count; i++) {
        const zbufrandi_structure *s = &scene->structure[i];
        info->stored_triangles += s->triangle_count;
        info->stored_vertices += s->vertex_count;
        info->instances += s->instance_count;
        info->clusters += s->cluster_count;
        info->tree_nodes += s->node_count;
    }
    info->triangles = root->virtual_triangles;
    info->structures = scene->structure_count;
    info->levels = root->depth;
    info->skipped_triangles = scene->skipped;
    zbufrandi_live_totals(scene, info);
    zbufrandi_list_totals(scene, info);
    info->area = root->area;
    for (a = 0; a < 3; a++) {
        info->box_min[a] = root->node_count != 0 ? (double)root->box_lo[a] + root->origin[a] : (double)INFINITY;
        info->box_max[a] = root->node_count != 0 ? (double)root->box_hi[a] + root->origin[a] : -(double)INFINITY;
    }
    info->bytes = zbufrandi_atomic_load(&scene->mem.used) - scene->before;
    info->peak_bytes = zbufrandi_atomic_load(&scene->mem.peak) - scene->before;
}

ZBUFRAND_DEF zbufrand_result zbufrand_scene_build(zbufrand_scene *scene, const zbufrand_build_desc *desc,
                                                  zbufrand_scene_info *info) {
    zbufrand_build_desc d;
    zbufrandi_gather gather;
    zbufrandi_build b;
    uint32_t *order = NULL, count = 0, i;
    uint64_t done = 0, total = 0, skipped = 0;
    size_t before, k;
    zbufrand_result r;
    if (info != NULL) memset(info, 0, sizeof *info);
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    zbufrandi_structures_free(scene);
    zbufrandi_edits_forget(scene);
    scene->built = d;
    scene->seed = zbufrandi_hash32(d.seed + 0x9e3779b9u);
    before = zbufrandi_atomic_load(&scene->mem.used);
    zbufrandi_atomic_store(&scene->mem.peak, before);
    r = zbufrandi_graph_check(scene, &order, &count);
    if (r != ZBUFRAND_OK) return r;
    scene->structure = (zbufrandi_structure *)zbufrandi_alloc_zero(&scene->mem, count, sizeof *scene->structure);
    if (scene->structure == NULL)
        r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, count, "no memory for % structures");
    else scene->structure_count = count;
    for (k = 0; k < scene->mesh_count; k++) total += scene->mesh[k].m.triangle_count;
    memset(&gather, 0, sizeof gather);
    for (i = count; i > 0 && r == ZBUFRAND_OK; i--) { /* prototypes first */
        r = zbufrandi_gather_structure(scene, order[i - 1], &gather);
        if (r != ZBUFRAND_OK) break;
        memset(&b, 0, sizeof b);
        b.scene = scene;
        b.desc = &d;
        b.s = &scene->structure[i - 1];
        b.gather = &gather;
        b.index = i - 1;
        r = zbufrandi_build_structure(&b);
        skipped += b.skipped;
        done += b.s->triangle_count;
        zbufrandi_gather_free(&scene->mem, &gather);
        if (r == ZBUFRAND_OK && scene->env.progress_fn != NULL &&
            scene->env.progress_fn(scene->env.progress_user, done, total) != 0) {
            r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_CANCELLED, i - 1, "cancelled before structure %");
        }
    }
    zbufrandi_free(&scene->mem, order);
    if (r == ZBUFRAND_OK && !zbufrandi_scene_views(scene)) {
        r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "no memory for stored points");
    }
    if (r == ZBUFRAND_OK && !zbufrandi_scene_rays(scene)) {
        r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "no memory for rays");
    }
    if (r == ZBUFRAND_OK) r = zbufrandi_scene_lists(scene, &d);
    if (r != ZBUFRAND_OK) {
        zbufrandi_structures_free(scene);
        return r;
    }
    scene->before = before;
    scene->skipped = skipped;
    zbufrandi_scene_totals(scene);
    if (info != NULL) *info = scene->info;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF void zbufrand_scene_get_info(const zbufrand_scene *scene, zbufrand_scene_info *info) {
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (scene != NULL) *info = scene->info;
}
/* ---------------------------------------------------------------------------
   lists: the thesis' trees over the triangles of a structure: fair-split tree,  // >>lists
   octree, classes of normals, tree over normals.

   They stand beside the tree of clusters and refer to its triangles. The objects of a tree, triangles and dummies (a
   class of a structure that is referred to, with a transform), stand in one array, depth first: what is below a node is
   a run of it. sum[] adds up their areas, so that a run knows its area, and an object is drawn by it with one binary
   search below any node, which a table of as many entries as half of the objects makes short as a rule. Areas are
   integers of 2^-61 of the whole: differences are exact wherever they are taken,
   however unequal the areas are, and every object has a share.
   --------------------------------------------------------------------------- */

enum {
    ZBUFRANDI_LIST_LEVELS = 19,       /* of an octree: 57 bits of a cell, 5 of its level */
    ZBUFRANDI_LIST_JOB = 1 << 15,     /* objects of a task of the build */
    ZBUFRANDI_LIST_LEAF = 1024        /* most objects that may be asked for in a leaf */
};
#define ZBUFRANDI_LIST_DUMMY 0x80000000u
#define ZBUFRANDI_LIST_OBJECTS (1u << 29)

typedef struct zbufrandi_list_node { /* its children follow it: k + 1, node[k + 1].end, and so on below node[k].end */
    float lo[3], hi[3];        /* box of all objects below */
    uint32_t first, own, last; /* objects: [first, own) its own, [first, last) all below */
    uint32_t end;
    uint64_t key;              /* octree: its cell << 5 | its level */
    uint32_t dummies;          /* 1: there are some below */
    uint32_t _pad;
} zbufrandi_list_node;

typedef struct zbufrandi_list_class { /* objects of like normals, and their tree */
    float axis[3], cosine;     /* cone of the normals; cosine -1: all directions */
    uint32_t root;             /* node */
    uint32_t first, last;      /* objects */
    uint32_t child, children;  /* finer classes of the same objects; none: 0 */
    uint32_t two_sided;        /* some are seen from both sides */
    uint64_t triangles;        /* instances counted as often as they occur */
} zbufrandi_list_class;

typedef struct zbufrandi_dummy {
    uint32_t instance, list_class; /* class: of the structure that the instance stands for */
} zbufrandi_dummy;

typedef struct zbufrandi_lists {
    uint32_t *object;          /* [object_count] cluster << 7 | triangle, or ZBUFRANDI_LIST_DUMMY | dummy */
    uint64_t *sum;             /* [object_count + 1] areas added up, in units of `unit` */
    uint64_t *key;             /* [object_count] of a tree over normals: cell << 5 | level; NULL */
    uint32_t *guide;           /* entry y >> shift: the object at that place of the sums: where a search begins */
    zbufrandi_list_node *node;
    zbufrandi_list_class *list_class;
    zbufrandi_dummy *dummy;
    double unit;
    uint32_t shift;
    uint32_t object_count, node_count, class_count, dummy_count;
    uint32_t roots;            /* classes 0 .. roots - 1 are all there is; the others are finer ones */
} zbufrandi_lists;

typedef struct zbufrandi_list_object { /* while a tree is made */
    float lo[3], hi[3];
    uint64_t key;              /* octree: cell << 5 | level */
    uint32_t item;             /* as in object[] */
    uint32_t normal;           /* octahedral 16+16; of a dummy: the axis of its class */
} zbufrandi_list_object;

typedef struct zbufrandi_list_nodes { /* nodes that grow, depth first */
    zbufrandi_list_node *node;
    size_t count, capacity;
    uint32_t first, last;      /* of a job: its objects */
    int failed;
} zbufrandi_list_nodes;

typedef struct zbufrandi_list_build {
    zbufrand_scene *scene;
    zbufrandi_mem *mem;
    const zbufrandi_structure *s;
    zbufrandi_lists *l;
    zbufrandi_list_object *object, *other; /* [room] */
    float (*polar)[2];         /* per object: longitude, colatitude */
    uint32_t *order;           /* objects sorted by class */
    size_t count, room;
    int octree, too_many;
    uint32_t leaf;             /* most objects of a leaf */
    double ratio2;             /* square of the most that a leaf may be wider than its largest object */
    float zone;                /* a cell takes what lies in it enlarged by this */
    double cube_lo[3], cube;
    zbufrandi_list_nodes top, *job;
    size_t job_count, job_capacity, class_capacity;
} zbufrandi_list_build;

static void zbufrandi_lists_free(zbufrandi_mem *mem, zbufrandi_lists *l) {
    if (l == NULL) return;
    zbufrandi_free(mem, l->object);
    zbufrandi_free(mem, l->sum);
    zbufrandi_free(mem, l->key);
    zbufrandi_free(mem, l->guide);
    zbufrandi_free(mem, l->node);
    zbufrandi_free(mem, l->list_class);
    zbufrandi_free(mem, l->dummy);
    zbufrandi_free(mem, l);
}

static void zbufrandi_scene_lists_free(zbufrand_scene *scene) { /* back to the tree of clusters */
    uint32_t i;
    for (i = 0; i < scene->structure_count; i++) {
        zbufrandi_lists_free(&scene->mem, scene->structure[i].lists);
        scene->structure[i].lists = NULL;
    }
}

/* ---- integers and angles ---- */

ZBUFRANDI_INLINE uint64_t zbufrandi_mul_high(uint64_t a, uint64_t b) { /* upper half of the product */
    const uint64_t al = a & 0xffffffffu, ah = a >> 32, bl = b & 0xffffffffu, bh = b >> 32;
    const uint64_t low = al * bl, m = ah * bl + (low >> 32), n = al * bh + (m & 0xffffffffu);
    return ah * bh + (m >> 32) + (n >> 32);
}

/* The object of [first, last) that holds place y of the sums: the last one that begins at or before it. Objects are
   never empty. */
ZBUFRANDI_INLINE uint32_t zbufrandi_list_search(const zbufrandi_lists *l, uint32_t first, uint32_t last, uint64_t y) {
    const uint64_t *sum = l->sum;
    const uint32_t low = l->guide[y >> l->shift], high = l->guide[(y >> l->shift) + 1] + 1;
    uint32_t n;
    first = low > first ? low : first;
    n = (high < last ? high : last) - first;
    while (n > 1) {
        const uint32_t half = n / 2;
        first = sum[first + half] <= y ? first + half : first;
        n -= half;
    }
    return first;
}

/* atan2(y, x) in (-pi, pi]; absolute error < 1e-14. Halves the angle twice, then the series. */
static double zbufrandi_atan2(double y, double x) {
    double ay = zbufrandi_abs(y), ax = zbufrandi_abs(x), t, t2, p, r = 0.0;
    int i, turned = ay > ax;
    if (!(ax + ay > 0.0)) return 0.0;
    t = turned ? ax / ay : ay / ax;
    for (i = 0; i < 2; i++) t = t / (1.0 + sqrt(1.0 + t * t));
    t2 = t * t;
    p = t;
    for (i = 1; i < 25; i += 2) {
        r += p / (double)i;
        p = 0.0 - p * t2;
    }
    r *= 4.0;
    if (turned) r = 1.57079632679489661923 - r;
    if (x < 0.0) r = 3.14159265358979323846 - r;
    return y < 0.0 ? 0.0 - r : r;
}

/* Longitude in [0, 2 pi) and colatitude in [0, pi] of a direction. */
static void zbufrandi_polar(const float n[3], float polar[2]) {
    const double x = (double)n[0], y = (double)n[1], z = (double)n[2];
    double a = zbufrandi_atan2(y, x);
    if (a < 0.0) a += 6.28318530717958647693;
    polar[0] = (float)a;
    if (polar[0] >= 6.2831853f) polar[0] = 0.0f;
    polar[1] = (float)zbufrandi_atan2(sqrt(x * x + y * y), z);
}

/* ---- objects ---- */

/* Corners of triangle `item` of a structure. */
ZBUFRANDI_INLINE const zbufrandi_cluster *zbufrandi_list_triangle(const zbufrandi_structure *s, uint32_t item,
                                                                  const float *p[3]) {
    const zbufrandi_cluster *c = &s->cluster[item >> 7];
    const uint8_t *tri = s->triangle + 3 * ((size_t)c->first_triangle + (item & 127u));
    uint32_t k;
    for (k = 0; k < 3; k++) p[k] = s->position + 3 * ((size_t)c->first_vertex + tri[k]);
    return c;
}

/* Unit normal of a triangle; returns its area. */
static double zbufrandi_list_normal(const zbufrandi_structure *s, uint32_t item, float n[3]) {
    const float *p[3];
    double v[3], length;
    int a;
    (void)zbufrandi_list_triangle(s, item, p);
    zbufrandi_cross(p[0], p[1], p[2], v);
    length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (a = 0; a < 3; a++) n[a] = (float)(v[a] / length);
    return 0.5 * length;
}

/* Enlarged by the zone, does the cell of level `level` around the middle of an object hold it? */
static int zbufrandi_list_fits(const zbufrandi_list_build *b, const zbufrandi_list_object *o, const uint32_t q[3],
                               uint32_t level) {
    const double side = b->cube / (double)((uint32_t)1 << level), reach = 0.5 * (double)b->zone * side;
    int a;
    for (a = 0; a < 3; a++) {
        const double middle = b->cube_lo[a] + ((double)(q[a] >> (ZBUFRANDI_LIST_LEVELS - level)) + 0.5) * side;
        if ((double)o->lo[a] < middle - reach || (double)o->hi[a] > middle + reach) return 0;
    }
    return 1;
}

/* The smallest cell that takes an object: cells around its middle hold it up to some level, and from there on not. */
static uint64_t zbufrandi_list_key(const zbufrandi_list_build *b, const zbufrandi_list_object *o) {
    const double cells = (double)((uint32_t)1 << ZBUFRANDI_LIST_LEVELS);
    uint32_t q[3], low = 0, high = ZBUFRANDI_LIST_LEVELS, shift;
    int a;
    for (a = 0; a < 3; a++) {
        const double t = (0.5 * ((double)o->lo[a] + (double)o->hi[a]) - b->cube_lo[a]) / b->cube * cells;
        q[a] = !(t > 0.0) ? 0u : t >= cells - 1.0 ? (uint32_t)cells - 1u : (uint32_t)t;
    }
    while (low < high) {
        const uint32_t level = (low + high + 1) / 2;
        if (zbufrandi_list_fits(b, o, q, level)) low = level;
        else high = level - 1;
    }
    shift = 3 * (ZBUFRANDI_LIST_LEVELS - low);
    return zbufrandi_morton(q[0], q[1], q[2]) >> shift << shift << 5 | low;
}

static void zbufrandi_list_triangle_task(void *ctx, uint32_t task) {
    const zbufrandi_list_build *b = (const zbufrandi_list_build *)ctx;
    uint32_t i = task * ZBUFRANDI_TASK_CLUSTERS, end = i + ZBUFRANDI_TASK_CLUSTERS, t, k;
    if (end > b->s->cluster_count) end = b->s->cluster_count;
    for (; i < end; i++) {
        const zbufrandi_cluster *c = &b->s->cluster[i];
        for (t = 0; t < c->triangle_count; t++) {
            zbufrandi_list_object *o = &b->object[(size_t)c->first_triangle + t];
            const float *p[3];
            float n[3];
            o->item = i << 7 | t;
            (void)zbufrandi_list_triangle(b->s, o->item, p);
            zbufrandi_box_empty(o->lo, o->hi);
            for (k = 0; k < 3; k++) zbufrandi_box_add(o->lo, o->hi, p[k], p[k]);
            (void)zbufrandi_list_normal(b->s, o->item, n);
            o->normal = zbufrandi_oct32_encode(n);
            if (b->polar != NULL) zbufrandi_polar(n, b->polar[(size_t)c->first_triangle + t]);
            o->key = b->octree ? zbufrandi_list_key(b, o) : 0;
        }
    }
}

/* Dummies for the classes of instances; they come after the triangles. A class of all directions (of a structure
   without classes) has an axis that says nothing, which is as good as any. */
static void zbufrandi_list_dummies(zbufrandi_list_build *b) {
    const zbufrandi_structure *s = b->s;
    uint32_t i, c, n = 0, a, k;
    for (i = 0; i < s->instance_count; i++) {
        const zbufrandi_instance *it = &s->instance[i];
        const zbufrandi_lists *to = b->scene->structure[it->structure].lists;
        for (c = 0; c < to->class_count; c++) {
            const zbufrandi_list_class *from = &to->list_class[c];
            const zbufrandi_list_node *root = &to->node[from->root];
            zbufrandi_list_object *o = &b->object[(size_t)s->triangle_count + n];
            float axis[3];
            if (from->children != 0) continue;
            b->l->dummy[n].instance = i;
            b->l->dummy[n].list_class = c;
            o->item = ZBUFRANDI_LIST_DUMMY | n;
            for (a = 0; a < 3; a++) {
                double m = it->to_parent[a][3], e = 0.0;
                for (k = 0; k < 3; k++) {
                    m += it->to_parent[a][k] * (0.5 * ((double)root->lo[k] + (double)root->hi[k]));
                    e += zbufrandi_abs(it->to_parent[a][k]) * (0.5 * ((double)root->hi[k] - (double)root->lo[k]));
                }
                e += 1e-14 * (zbufrandi_abs(m) + zbufrandi_abs(it->to_parent[a][3]) + e);
                o->lo[a] = zbufrandi_float_down(m - e);
                o->hi[a] = zbufrandi_float_up(m + e);
            }
            memcpy(axis, from->axis, sizeof axis);
            zbufrandi_instance_rotate(it, axis);
            o->normal = zbufrandi_oct32_encode(axis);
            if (b->polar != NULL) zbufrandi_polar(axis, b->polar[(size_t)s->triangle_count + n]);
            o->key = b->octree ? zbufrandi_list_key(b, o) : 0;
            n++;
        }
    }
}

/* ---- classes ---- */

static zbufrandi_list_class *zbufrandi_list_class_add(zbufrandi_list_build *b, uint32_t first, uint32_t last) {
    zbufrandi_lists *l = b->l;
    zbufrandi_list_class *c;
    if (!zbufrandi_grow(b->mem, (void **)&l->list_class, &b->class_capacity, l->class_count,
                        (size_t)l->class_count + 1, sizeof *l->list_class)) return NULL;
    c = &l->list_class[l->class_count++];
    memset(c, 0, sizeof *c);
    c->axis[2] = 1.0f;
    c->cosine = -1.0f;
    c->first = first;
    c->last = last;
    return c;
}

/* Sort order[] by cell of a grid: which[] < bins; start[] receives where each begins. */
static int zbufrandi_list_sort_cells(zbufrandi_list_build *b, const uint16_t *which, uint32_t bins) {
    uint32_t *start = (uint32_t *)zbufrandi_alloc_zero(b->mem, (size_t)bins + 1, sizeof *start);
    size_t i;
    uint32_t k;
    if (start == NULL) return 0;
    for (i = 0; i < b->count; i++) start[which[i] + 1u]++;
    for (k = 0; k < bins; k++) start[k + 1] += start[k];
    for (i = 0; i < b->count; i++) b->order[start[which[i]]++] = (uint32_t)i;
    zbufrandi_free(b->mem, start);
    return 1;
}

/* A grid of k x 2k cells of equal angles, those that hold something. */
static int zbufrandi_list_grid(zbufrandi_list_build *b, uint32_t k) { /* 0: no memory */
    const float step = (float)k * 0.31830989f;
    uint16_t *which = (uint16_t *)zbufrandi_alloc_array(b->mem, b->count + 1, sizeof *which);
    size_t i, first;
    int ok = which != NULL;
    for (i = 0; ok && i < b->count; i++) {
        uint32_t x = (uint32_t)(b->polar[i][0] * step), y = (uint32_t)(b->polar[i][1] * step);
        x = x < 2 * k ? x : 2 * k - 1;
        y = y < k ? y : k - 1;
        which[i] = (uint16_t)(y * 2 * k + x);
    }
    ok = ok && zbufrandi_list_sort_cells(b, which, 2 * k * k);
    for (i = first = 0; ok && i < b->count; i++) {
        if (i + 1 < b->count && which[b->order[i + 1]] == which[b->order[i]]) continue;
        ok = zbufrandi_list_class_add(b, (uint32_t)first, (uint32_t)i + 1) != NULL;
        first = i + 1;
    }
    zbufrandi_free(b->mem, which);
    return ok;
}

/* Fair splits of longitude and colatitude: the box of the normals of a class is halved at its longer side. */
static int zbufrandi_list_polar_split(zbufrandi_list_build *b, uint32_t depth) { /* 0: no memory */
    zbufrandi_lists *l = b->l;
    uint32_t level, c, count, i, a;
    uint32_t *other = (uint32_t *)zbufrandi_alloc_array(b->mem, b->count + 1, sizeof *other);
    if (other == NULL || zbufrandi_list_class_add(b, 0, (uint32_t)b->count) == NULL) {
        zbufrandi_free(b->mem, other);
        return 0;
    }
    for (level = 0; level < depth; level++) {
        for (c = 0, count = l->class_count; c < count; c++) {
            const uint32_t first = l->list_class[c].first, last = l->list_class[c].last;
            float lo[2], hi[2], middle;
            uint32_t axis, left = first, right = 0;
            lo[0] = lo[1] = INFINITY;
            hi[0] = hi[1] = -INFINITY;
            for (i = first; i < last; i++) {
                for (a = 0; a < 2; a++) {
                    const float v = b->polar[b->order[i]][a];
                    lo[a] = v < lo[a] ? v : lo[a];
                    hi[a] = v > hi[a] ? v : hi[a];
                }
            }
            axis = hi[1] - lo[1] > hi[0] - lo[0];
            if (!(hi[axis] - lo[axis] > 1e-3f)) continue; /* all alike */
            middle = 0.5f * (lo[axis] + hi[axis]);
            for (i = first; i < last; i++) {
                if (b->polar[b->order[i]][axis] < middle) b->order[left++] = b->order[i];
                else other[right++] = b->order[i];
            }
            memcpy(b->order + left, other, right * sizeof *other);
            l->list_class[c].last = left;
            if (zbufrandi_list_class_add(b, left, last) == NULL) {
                zbufrandi_free(b->mem, other);
                return 0;
            }
        }
    }
    zbufrandi_free(b->mem, other);
    return 1;
}

/* A quadtree of `levels` levels over longitude and colatitude. Classes are runs of order[] here; those with children
   and their children have the same objects, which become runs of their own of the list. */
static int zbufrandi_list_quadtree(zbufrandi_list_build *b, uint32_t levels) { /* 0: no memory */
    const uint32_t deepest = levels - 1;
    const float step = (float)((uint32_t)1 << deepest) * 0.31830989f;
    uint16_t *which = (uint16_t *)zbufrandi_alloc_array(b->mem, b->count + 1, sizeof *which);
    zbufrandi_lists *l = b->l;
    uint32_t c, i;
    int ok = which != NULL;
    for (i = 0; ok && i < b->count; i++) {
        uint32_t x = (uint32_t)(b->polar[i][0] * (0.5f * step)), y = (uint32_t)(b->polar[i][1] * step), k, code = 0;
        const uint32_t most = ((uint32_t)1 << deepest) - 1;
        x = x < most ? x : most;
        y = y < most ? y : most;
        for (k = deepest; k > 0; k--) code = code << 2 | (x >> (k - 1) & 1u) | (y >> (k - 1) & 1u) << 1;
        which[i] = (uint16_t)code;
    }
    ok = ok && zbufrandi_list_sort_cells(b, which, (uint32_t)1 << 2 * deepest) &&
         zbufrandi_list_class_add(b, 0, (uint32_t)b->count) != NULL;
    for (c = 0; ok && c < l->class_count; c++) { /* `root` is the level until there are trees */
        uint32_t level = l->list_class[c].root, first = l->list_class[c].first, last = l->list_class[c].last, begin;
        const uint32_t same = b->object[b->order[first]].normal;
        for (i = first; i < last && b->object[b->order[i]].normal == same; i++) { }
        if (i == last) continue; /* one normal only */
        /* a cell with one cell in it that is not empty is left out */
        while (level < deepest && which[b->order[first]] >> 2 * (deepest - level - 1) ==
                                      which[b->order[last - 1]] >> 2 * (deepest - level - 1)) level++;
        if (level >= deepest) continue;
        l->list_class[c].child = l->class_count;
        for (begin = i = first; ok && i < last; i++) {
            const uint32_t shift = 2 * (deepest - level - 1);
            if (i + 1 < last && which[b->order[i + 1]] >> shift == which[b->order[i]] >> shift) continue;
            ok = zbufrandi_list_class_add(b, begin, i + 1) != NULL;
            if (!ok) break;
            l->list_class[l->class_count - 1].root = level + 1;
            l->list_class[c].children++;
            begin = i + 1;
        }
    }
    zbufrandi_free(b->mem, which);
    return ok;
}

/* Objects in the order of the classes; a tree over normals has them once for each level. 0: no memory, or too many. */
static int zbufrandi_list_arrange(zbufrandi_list_build *b) {
    zbufrandi_lists *l = b->l;
    uint64_t room = 0;
    uint32_t c, i, at = 0;
    for (c = 0; c < l->class_count; c++) room += l->list_class[c].last - l->list_class[c].first;
    b->too_many = room >= ZBUFRANDI_LIST_OBJECTS;
    if (b->too_many) return 0;
    b->room = (size_t)room;
    b->other = (zbufrandi_list_object *)zbufrandi_alloc_array(b->mem, b->room, sizeof *b->other);
    if (b->other == NULL) return 0;
    if (b->order == NULL) return 1; /* one class, as they are */
    for (c = 0; c < l->class_count; c++) {
        zbufrandi_list_class *k = &l->list_class[c];
        const uint32_t first = at;
        for (i = k->first; i < k->last; i++) b->other[at++] = b->object[b->order[i]];
        k->first = first;
        k->last = at;
    }
    zbufrandi_free(b->mem, b->object);
    b->object = b->other;
    b->other = (zbufrandi_list_object *)zbufrandi_alloc_array(b->mem, b->room, sizeof *b->other);
    return b->other != NULL;
}

/* ---- trees ---- */

typedef struct zbufrandi_list_cut { /* how the objects of a node are shared out: 0 stays, 1..8 child */
    uint32_t axis, shift;
    float sum, reach_lo, reach_hi; /* fair split */
    uint32_t level;
    int octree;
} zbufrandi_list_cut;

ZBUFRANDI_INLINE uint32_t zbufrandi_list_side(const zbufrandi_list_cut *c, const zbufrandi_list_object *o) {
    if (c->octree) return (o->key & 31u) == c->level ? 0u : 1u + (uint32_t)(o->key >> c->shift & 7u);
    if (o->lo[c->axis] + o->hi[c->axis] < c->sum) return o->hi[c->axis] <= c->reach_hi ? 1u : 0u;
    return o->lo[c->axis] >= c->reach_lo ? 2u : 0u;
}

/* Share out objects first..last-1 in place, in their order. end[0]: of those that stay, end[k]: of child k. */
static void zbufrandi_list_share(const zbufrandi_list_build *b, const zbufrandi_list_cut *cut, uint32_t first,
                                 uint32_t last, uint32_t end[9]) {
    uint32_t at[9], i, k;
    memset(at, 0, sizeof at);
    for (i = first; i < last; i++) at[zbufrandi_list_side(cut, &b->object[i])]++;
    for (k = 0, i = first; k < 9; k++) {
        const uint32_t n = at[k];
        at[k] = i;
        i += n;
        end[k] = i;
    }
    for (i = first; i < last; i++) b->other[at[zbufrandi_list_side(cut, &b->object[i])]++] = b->object[i];
    memcpy(b->object + first, b->other + first, (size_t)(last - first) * sizeof *b->object);
}

/* Make a node of objects first..last-1. 1: end[] says what its children are; 0: it is a leaf.
   A leaf has few objects and is not much wider than the largest of them (the thesis: a bound of diameters, so that few
   far apart do not become one), or cannot be divided. An octree goes at once to the smallest cell that holds all: the
   thesis' shortcut. */
static int zbufrandi_list_divide(const zbufrandi_list_build *b, uint32_t first, uint32_t last,
                                 zbufrandi_list_node *n, uint32_t end[9]) {
    double largest = 0.0, wide = 0.0;
    uint64_t differ = 0, least = 31;
    zbufrandi_list_cut cut;
    uint32_t i, k;
    int a;
    memset(n, 0, sizeof *n);
    memset(&cut, 0, sizeof cut);
    zbufrandi_box_empty(n->lo, n->hi);
    n->first = first;
    n->own = n->last = last;
    for (i = first; i < last; i++) {
        const zbufrandi_list_object *o = &b->object[i];
        double d = 0.0;
        zbufrandi_box_add(n->lo, n->hi, o->lo, o->hi);
        for (a = 0; a < 3; a++) d += ((double)o->hi[a] - (double)o->lo[a]) * ((double)o->hi[a] - (double)o->lo[a]);
        largest = d > largest ? d : largest;
        differ |= o->key ^ b->object[first].key;
        least = (o->key & 31u) < least ? o->key & 31u : least;
        n->dummies |= o->item >> 31;
    }
    for (a = 0; a < 3; a++) {
        wide += ((double)n->hi[a] - (double)n->lo[a]) * ((double)n->hi[a] - (double)n->lo[a]);
        if (n->hi[a] - n->lo[a] > n->hi[cut.axis] - n->lo[cut.axis]) cut.axis = (uint32_t)a;
    }
    if (b->octree) { /* the cell that all have in common */
        for (k = 0; k < least && differ >> 5 >> (3 * (ZBUFRANDI_LIST_LEVELS - k - 1)) == 0; k++) { }
        i = 3 * (ZBUFRANDI_LIST_LEVELS - k);
        n->key = b->object[first].key >> 5 >> i << i << 5 | k;
        cut.octree = 1;
        cut.level = k;
        cut.shift = 5 + (k < ZBUFRANDI_LIST_LEVELS ? i - 3 : 0);
        if (differ >> 5 == 0 && least == (uint64_t)k && k == ZBUFRANDI_LIST_LEVELS) return 0;
    } else {
        const float side = n->hi[cut.axis] - n->lo[cut.axis], zone = (b->zone - 1.0f) * 0.25f * side;
        cut.sum = n->lo[cut.axis] + n->hi[cut.axis];
        cut.reach_hi = 0.5f * cut.sum + zone;
        cut.reach_lo = 0.5f * cut.sum - zone;
    }
    if (last - first <= b->leaf && wide <= b->ratio2 * largest) return 0;
    zbufrandi_list_share(b, &cut, first, last, end);
    if (end[0] == last) return 0;
    for (k = 1; k < 9; k++) if (end[k] - end[k - 1] == last - first) return 0;
    n->own = end[0];
    return 1;
}

/* Leaves of a tree over normals are runs along the curve, so that a cell is one, too. */
static void zbufrandi_list_sort_leaf(const zbufrandi_list_build *b, uint32_t first, uint32_t last) {
    uint32_t i, k;
    for (i = first + 1; i < last; i++) {
        const zbufrandi_list_object o = b->object[i];
        for (k = i; k > first && b->object[k - 1].key > o.key; k--) b->object[k] = b->object[k - 1];
        b->object[k] = o;
    }
}

typedef struct zbufrandi_list_todo {
    uint32_t first, last;      /* last 0: node `first` is complete */
} zbufrandi_list_todo;

/* The tree of objects first..last-1, appended to `out`. job: ranges of at most that many objects are left to tasks; a
   node with own == ~0 stands for the tree, and the job's number is its `end`. */
static void zbufrandi_list_grow(zbufrandi_list_build *b, uint32_t first, uint32_t last, uint32_t job,
                                zbufrandi_list_nodes *out) {
    zbufrandi_list_todo *stack = NULL;
    size_t capacity = 0, depth = 0;
    uint32_t end[9], k;
    if (!zbufrandi_grow(b->mem, (void **)&stack, &capacity, 0, 64, sizeof *stack)) {
        out->failed = 1;
        return;
    }
    stack[depth].first = first;
    stack[depth++].last = last;
    while (depth > 0 && !out->failed) {
        const zbufrandi_list_todo at = stack[--depth];
        zbufrandi_list_node *n;
        if (at.last == 0) {
            out->node[at.first].end = (uint32_t)out->count;
            continue;
        }
        if (!zbufrandi_grow(b->mem, (void **)&out->node, &out->capacity, out->count, out->count + 1,
                            sizeof *out->node) ||
            !zbufrandi_grow(b->mem, (void **)&stack, &capacity, depth, depth + 9, sizeof *stack)) {
            out->failed = 1;
            break;
        }
        n = &out->node[out->count];
        if (at.last - at.first <= job) {
            memset(n, 0, sizeof *n);
            n->own = ~0u;
            n->end = (uint32_t)b->job_count;
            if (!zbufrandi_grow(b->mem, (void **)&b->job, &b->job_capacity, b->job_count, b->job_count + 1,
                                sizeof *b->job)) {
                out->failed = 1;
                break;
            }
            memset(&b->job[b->job_count], 0, sizeof *b->job);
            b->job[b->job_count].first = at.first;
            b->job[b->job_count++].last = at.last;
            out->count++;
            continue;
        }
        stack[depth].first = (uint32_t)out->count++;
        stack[depth++].last = 0;
        if (!zbufrandi_list_divide(b, at.first, at.last, n, end)) {
            if (b->l->key != NULL) zbufrandi_list_sort_leaf(b, at.first, at.last);
            continue;
        }
        for (k = 8; k > 0; k--) {
            if (end[k] == end[k - 1]) continue;
            stack[depth].first = end[k - 1];
            stack[depth++].last = end[k];
        }
    }
    zbufrandi_free(b->mem, stack);
}

static void zbufrandi_list_job_task(void *ctx, uint32_t task) {
    zbufrandi_list_build *b = (zbufrandi_list_build *)ctx;
    zbufrandi_list_nodes *j = &b->job[task];
    zbufrandi_list_grow(b, j->first, j->last, 0, j);
}

/* One tree per class, all in one array. 0: no memory. */
static int zbufrandi_list_trees(zbufrandi_list_build *b) {
    zbufrandi_lists *l = b->l;
    size_t total = 0, i, at = 0;
    uint32_t c, k, *place;
    int ok = 1;
    for (c = 0; c < l->class_count && !b->top.failed; c++) {
        l->list_class[c].root = (uint32_t)b->top.count;
        zbufrandi_list_grow(b, l->list_class[c].first, l->list_class[c].last, ZBUFRANDI_LIST_JOB, &b->top);
    }
    if (b->top.failed) return 0;
    zbufrandi_parallel_for(&b->scene->env, zbufrandi_list_job_task, b, (uint32_t)b->job_count);
    for (i = 0; i < b->job_count; i++) ok &= !b->job[i].failed;
    if (!ok) return 0;
    place = (uint32_t *)zbufrandi_alloc_array(b->mem, b->top.count + 1, sizeof *place);
    if (place == NULL) return 0;
    for (i = 0; i < b->top.count; i++) { /* where each will stand */
        place[i] = (uint32_t)total;
        total += b->top.node[i].own == ~0u ? b->job[b->top.node[i].end].count : 1;
    }
    place[b->top.count] = (uint32_t)total;
    l->node = (zbufrandi_list_node *)zbufrandi_alloc_array(b->mem, total, sizeof *l->node);
    l->node_count = (uint32_t)total;
    for (i = 0; l->node != NULL && i < b->top.count; i++) {
        const zbufrandi_list_node *n = &b->top.node[i];
        if (n->own == ~0u) {
            const zbufrandi_list_nodes *j = &b->job[n->end];
            for (k = 0; k < j->count; k++) {
                l->node[at + k] = j->node[k];
                l->node[at + k].end += (uint32_t)at;
            }
            at += j->count;
        } else {
            l->node[at] = *n;
            l->node[at++].end = place[n->end];
        }
    }
    for (c = 0; c < l->class_count; c++) l->list_class[c].root = place[l->list_class[c].root];
    zbufrandi_free(b->mem, place);
    return l->node != NULL;
}

/* Triangles of a run of objects, instances counted as often as they occur. */
static uint64_t zbufrandi_list_triangles(const zbufrand_scene *scene, const zbufrandi_structure *s, uint32_t first,
                                         uint32_t last) {
    const zbufrandi_lists *l = s->lists;
    uint64_t n = 0;
    uint32_t i;
    for (i = first; i < last; i++) {
        if (l->object[i] & ZBUFRANDI_LIST_DUMMY) {
            const zbufrandi_dummy *d = &l->dummy[l->object[i] & ~ZBUFRANDI_LIST_DUMMY];
            n += scene->structure[s->instance[d->instance].structure].lists->list_class[d->list_class].triangles;
        } else {
            n++;
        }
    }
    return n;
}

/* Area of an object, in units of the structure. */
static double zbufrandi_list_area(const zbufrand_scene *scene, const zbufrandi_structure *s, const zbufrandi_lists *l,
                                  uint32_t item) {
    float n[3];
    if (item & ZBUFRANDI_LIST_DUMMY) {
        const zbufrandi_dummy *d = &l->dummy[item & ~ZBUFRANDI_LIST_DUMMY];
        const zbufrandi_instance *it = &s->instance[d->instance];
        const zbufrandi_lists *to = scene->structure[it->structure].lists;
        const zbufrandi_list_class *c = &to->list_class[d->list_class];
        return (double)(to->sum[c->last] - to->sum[c->first]) * to->unit * it->scale * it->scale;
    }
    return zbufrandi_list_normal(s, item, n);
}

/* Objects, their keys, and their areas where the sums will be. */
static void zbufrandi_list_fill_task(void *ctx, uint32_t task) {
    const zbufrandi_list_build *b = (const zbufrandi_list_build *)ctx;
    zbufrandi_lists *l = b->l;
    size_t i = (size_t)task * ZBUFRANDI_TASK_TRIANGLES, end = i + ZBUFRANDI_TASK_TRIANGLES;
    if (end > b->room) end = b->room;
    for (; i < end; i++) {
        const zbufrandi_list_object *o = &b->object[i];
        double area = zbufrandi_list_area(b->scene, b->s, l, o->item);
        if (!(area < 1e200)) area = 1e200; /* out of the range of floats long before */
        l->object[i] = o->item;
        memcpy(&l->sum[i + 1], &area, sizeof area);
        if (l->key != NULL) l->key[i] = o->key;
    }
}

/* unit and sum[], for areas that are there. levels: how often a triangle is in them. */
static void zbufrandi_list_sums(zbufrandi_list_build *b, double levels) {
    zbufrandi_lists *l = b->l;
    double area, all = 0.0;
    size_t i;
    for (i = 0; i < b->room; i++) {
        memcpy(&area, &l->sum[i + 1], sizeof area);
        all += area;
    }
    /* the structure's own area is a sum of floats, and 0 where those underflow */
    all = all > 1.5 * levels * b->s->area ? all : b->s->area * levels;
    l->unit = zbufrandi_max(all, 1e-290) * (1.0 / 2305843009213693952.0); /* 2^61: room for rounding up */
    l->sum[0] = 0;
    for (i = 0; i < b->room; i++) {
        memcpy(&area, &l->sum[i + 1], sizeof area);
        l->sum[i + 1] = l->sum[i] + (uint64_t)(area / l->unit) + 1;
    }
}

/* guide[], for sums that are there. 0: no memory. */
static int zbufrandi_list_guide(zbufrandi_list_build *b) {
    zbufrandi_lists *l = b->l;
    const uint64_t all = l->sum[l->object_count];
    uint32_t g, count, i = 0;
    while (l->shift < 63 && all >> l->shift > l->object_count / 2) l->shift++;
    count = (uint32_t)(all >> l->shift) + 2; /* one more, for the object after the last place */
    l->guide = (uint32_t *)zbufrandi_alloc_array(b->mem, count, sizeof *l->guide);
    if (l->guide == NULL) return 0;
    for (g = 0; g < count; g++) {
        while (i + 1 < l->object_count && l->sum[i + 1] <= (uint64_t)g << l->shift) i++;
        l->guide[g] = i;
    }
    return 1;
}

/* Cone of the normals of a class, from the normals themselves: corners of polar cells say nothing near the poles. */
static void zbufrandi_list_cone_task(void *ctx, uint32_t task) {
    const zbufrandi_list_build *b = (const zbufrandi_list_build *)ctx;
    zbufrandi_lists *l = b->l;
    zbufrandi_list_class *c = &l->list_class[task];
    double axis[3] = {0.0, 0.0, 0.0}, length, cosine = 1.0;
    uint32_t i, a, pass;
    zbufrandi_lane lane;
    memset(&lane, 0, sizeof lane);
    for (pass = 0; pass < 2; pass++) {
        for (i = c->first; i < c->last; i++) {
            const uint32_t item = l->object[i];
            lane.cosine = 1.0f;
            if (item & ZBUFRANDI_LIST_DUMMY) {
                const zbufrandi_dummy *d = &l->dummy[item & ~ZBUFRANDI_LIST_DUMMY];
                const zbufrandi_instance *it = &b->s->instance[d->instance];
                const zbufrandi_list_class *k = &b->scene->structure[it->structure].lists->list_class[d->list_class];
                memcpy(lane.axis, k->axis, sizeof lane.axis);
                zbufrandi_instance_rotate(it, lane.axis);
                lane.cosine = k->cosine;
                c->two_sided |= k->two_sided;
            } else {
                (void)zbufrandi_list_normal(b->s, item, lane.axis);
                c->two_sided |= b->s->cluster[item >> 7].flags & ZBUFRANDI_TWO_SIDED;
            }
            if (pass == 0) {
                for (a = 0; a < 3; a++) axis[a] += (double)lane.axis[a];
            } else {
                cosine = zbufrandi_min(cosine, zbufrandi_cone_reach(axis, &lane, 1.0) - 1e-6);
            }
        }
        if (pass == 1) break;
        length = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
        if (!(length > 1e-6 * (double)(c->last - c->first))) return; /* all directions */
        for (a = 0; a < 3; a++) {
            axis[a] = zbufrandi_rounded(axis[a] / length);
            c->axis[a] = (float)axis[a];
        }
    }
    c->cosine = zbufrandi_float_down(zbufrandi_max(cosine, -1.0));
}

/* ---- one structure ---- */

static void zbufrandi_list_build_free(zbufrandi_list_build *b) {
    size_t i;
    zbufrandi_free(b->mem, b->object);
    zbufrandi_free(b->mem, b->other);
    zbufrandi_free(b->mem, b->polar);
    zbufrandi_free(b->mem, b->order);
    zbufrandi_free(b->mem, b->top.node);
    for (i = 0; i < b->job_count; i++) zbufrandi_free(b->mem, b->job[i].node);
    zbufrandi_free(b->mem, b->job);
}

/* Boxes, areas and dummies are there; classes, trees and sums follow. 0: no memory, or 2^29 objects. */
static int zbufrandi_list_finish(zbufrandi_list_build *b, const zbufrand_build_desc *d, uint32_t depth) {
    zbufrandi_lists *l = b->l;
    const int tree = d->structure == ZBUFRAND_STRUCTURE_NORMALS;
    size_t i;
    int ok = 1;
    if (b->order != NULL) {
        for (i = 0; i < b->count; i++) b->order[i] = (uint32_t)i;
        ok = tree ? zbufrandi_list_quadtree(b, depth) : d->normal_grid != 0
            ? zbufrandi_list_grid(b, d->normal_grid) : zbufrandi_list_polar_split(b, depth);
    } else {
        ok = zbufrandi_list_class_add(b, 0, (uint32_t)b->count) != NULL;
    }
    if (!ok || !zbufrandi_list_arrange(b)) return 0;
    l->roots = tree ? 1 : l->class_count;
    l->object_count = (uint32_t)b->room;
    l->object = (uint32_t *)zbufrandi_alloc_array(b->mem, b->room, sizeof *l->object);
    l->sum = (uint64_t *)zbufrandi_alloc_array(b->mem, b->room + 1, sizeof *l->sum);
    if (tree) l->key = (uint64_t *)zbufrandi_alloc_array(b->mem, b->room, sizeof *l->key);
    if (l->object == NULL || l->sum == NULL || (tree && l->key == NULL) || !zbufrandi_list_trees(b)) return 0;
    zbufrandi_parallel_for(&b->scene->env, zbufrandi_list_fill_task, b,
                           (uint32_t)((b->room + ZBUFRANDI_TASK_TRIANGLES - 1) / ZBUFRANDI_TASK_TRIANGLES));
    zbufrandi_list_sums(b, tree ? (double)depth : 1.0);
    if (!zbufrandi_list_guide(b)) return 0;
    for (i = 0; i < l->class_count; i++) {
        zbufrandi_list_class *c = &l->list_class[i];
        c->triangles = zbufrandi_list_triangles(b->scene, b->s, c->first, c->last);
    }
    if (b->order != NULL) zbufrandi_parallel_for(&b->scene->env, zbufrandi_list_cone_task, b, l->class_count);
    return 1;
}

static zbufrand_result zbufrandi_list_structure(zbufrand_scene *scene, uint32_t index, const zbufrand_build_desc *d) {
    zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_list_build b;
    uint64_t dummies = 0;
    uint32_t depth, i, c, a;
    int ok, classes;
    memset(&b, 0, sizeof b);
    b.scene = scene;
    b.mem = &scene->mem;
    b.s = s;
    b.l = s->lists = (zbufrandi_lists *)zbufrandi_alloc_zero(b.mem, 1, sizeof *b.l);
    if (b.l == NULL) return ZBUFRAND_ERR_NO_MEMORY;
    for (i = 0; i < s->instance_count; i++) {
        const zbufrandi_lists *to = scene->structure[s->instance[i].structure].lists;
        for (c = 0; c < to->class_count; c++) dummies += to->list_class[c].children == 0;
    }
    if (dummies + s->triangle_count >= ZBUFRANDI_LIST_OBJECTS || s->cluster_count >= 1u << 24)
        return ZBUFRAND_ERR_RANGE;
    b.count = b.room = (size_t)dummies + s->triangle_count;
    b.l->dummy_count = (uint32_t)dummies;
    if (b.count == 0) return ZBUFRAND_OK;
    depth = d->normal_depth != 0 ? d->normal_depth : d->structure >= ZBUFRAND_STRUCTURE_CLASSES ? 4u : 0u;
    classes = depth != 0 || d->normal_grid != 0;
    b.octree = d->structure == ZBUFRAND_STRUCTURE_OCTREE || d->structure == ZBUFRAND_STRUCTURE_NORMALS;
    b.leaf = d->leaf_objects != 0 ? d->leaf_objects : 64u;
    b.ratio2 = d->leaf_ratio > 0.0f ? (double)d->leaf_ratio * (double)d->leaf_ratio : (double)b.leaf;
    b.zone = d->tolerance_zone > 0.0f ? d->tolerance_zone : 1.5f;
    for (a = 0; a < 3; a++) {
        b.cube_lo[a] = (double)s->box_lo[a];
        b.cube = zbufrandi_max(b.cube, (double)s->box_hi[a] - (double)s->box_lo[a]);
    }
    b.cube = zbufrandi_max(b.cube * 1.000001, 1e-30);
    b.object = (zbufrandi_list_object *)zbufrandi_alloc_array(b.mem, b.count, sizeof *b.object);
    if (dummies != 0) b.l->dummy = (zbufrandi_dummy *)zbufrandi_alloc_array(b.mem, (size_t)dummies, sizeof *b.l->dummy);
    if (classes) {
        b.polar = (float (*)[2])zbufrandi_alloc_array(b.mem, b.count, sizeof *b.polar);
        b.order = (uint32_t *)zbufrandi_alloc_array(b.mem, b.count, sizeof *b.order);
    }
    ok = b.object != NULL && (dummies == 0 || b.l->dummy != NULL) &&
         (!classes || (b.polar != NULL && b.order != NULL));
    if (ok) {
        zbufrandi_parallel_for(&scene->env, zbufrandi_list_triangle_task, &b,
                               (s->cluster_count + ZBUFRANDI_TASK_CLUSTERS - 1) / ZBUFRANDI_TASK_CLUSTERS);
        zbufrandi_list_dummies(&b);
        ok = zbufrandi_list_finish(&b, d, depth);
    }
    zbufrandi_list_build_free(&b);
    return ok ? ZBUFRAND_OK : b.too_many ? ZBUFRAND_ERR_RANGE : ZBUFRAND_ERR_NO_MEMORY;
}

/* Trees for all structures; prototypes first. On failure there are none. */
static zbufrand_result zbufrandi_scene_lists(zbufrand_scene *scene, const zbufrand_build_desc *d) {
    uint32_t i;
    if ((uint32_t)d->structure > ZBUFRAND_STRUCTURE_NORMALS || d->leaf_objects > ZBUFRANDI_LIST_LEAF ||
        d->normal_depth > 8 || d->normal_grid > 64 || !(d->leaf_ratio >= 0.0f) || !(d->leaf_ratio <= 1e6f) ||
        !(d->tolerance_zone == 0.0f || (d->tolerance_zone >= 1.0f && d->tolerance_zone <= 2.0f))) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, 0, "build: a field of the trees is wrong");
    }
    if (d->structure == ZBUFRAND_STRUCTURE_DEFAULT) return ZBUFRAND_OK;
    for (i = scene->structure_count; i > 0; i--) {
        const zbufrand_result r = zbufrandi_list_structure(scene, i - 1, d);
        if (r == ZBUFRAND_OK) continue;
        return zbufrandi_fail(scene->env.error, r, i - 1, r == ZBUFRAND_ERR_RANGE
                              ? "structure %: more than 2^29 objects, or 2^24 clusters, for its lists"
                              : "structure %: no memory for its lists");
    }
    return ZBUFRAND_OK;
}

static void zbufrandi_list_totals(const zbufrand_scene *scene, zbufrand_scene_info *info) {
    uint32_t i;
    for (i = 0; i < scene->structure_count; i++) {
        const zbufrandi_lists *l = scene->structure[i].lists;
        if (l == NULL) continue;
        info->list_objects += l->object_count;
        info->list_nodes += l->node_count;
        info->list_classes += l->class_count;
        info->list_bytes += sizeof *l + l->node_count * sizeof *l->node + l->class_count * sizeof *l->list_class +
                            l->dummy_count * sizeof *l->dummy;
        if (l->object_count == 0) continue;
        info->list_bytes += l->object_count * (sizeof *l->object + sizeof *l->sum +
                                               (l->key != NULL ? sizeof *l->key : 0));
        info->list_bytes += ((size_t)(l->sum[l->object_count] >> l->shift) + 2) * sizeof *l->guide;
    }
}

/* ---------------------------------------------------------------------------
   veil: transparency: what of a material a pixel does not show in a frame.     // >>veil

   A random mask of the pixels for each material and frame, the same for samples, rastered pixels and rays, so that they
   agree pixel by pixel. A decision for each sample would not do: of several samples in a pixel one is kept nearly
   always, and surfaces look the more opaque the more samples there are.
   --------------------------------------------------------------------------- */

typedef struct zbufrandi_veil {
    const zbufrand_scene *scene;
    const float *opacity;      /* NULL: all is opaque */
    uint32_t count, seed;
} zbufrandi_veil;

typedef struct zbufrandi_mask { /* of a material */
    float opacity;
    uint32_t hash;
} zbufrandi_mask;

static zbufrandi_mask zbufrandi_veil_mask(const zbufrandi_veil *v, uint32_t material) {
    zbufrandi_mask m;
    m.opacity = 1.0f;
    m.hash = 0;
    if (v->opacity == NULL || material >= v->count || !(v->opacity[material] < 1.0f)) return m;
    m.opacity = v->opacity[material];
    m.hash = zbufrandi_hash32(v->seed ^ zbufrandi_hash32(material + 0x9e3779b9u));
    return m;
}

static zbufrandi_mask zbufrandi_veil_cluster(const zbufrandi_veil *v, const zbufrandi_cluster *c) {
    return zbufrandi_veil_mask(v, v->opacity != NULL ? v->scene->mesh[c->mesh].m.material : 0);
}

/* Does a pixel (its index in the keys) show what has the material? */
ZBUFRANDI_INLINE int zbufrandi_mask_shows(const zbufrandi_mask *m, size_t pixel) {
    return m->opacity >= 1.0f ||
        zbufrandi_unit24(zbufrandi_hash32(m->hash ^ (uint32_t)pixel * 0x9e3779b1u)) < m->opacity;
}

/* ---------------------------------------------------------------------------
   raster: exact z-buffer rasteriser for the triangles of a cluster.            // >>raster

   A vertex is a pure function of its position and the matrix: 1/z in float, the picture position in units of 1/4096
   pixel as integers. Everything after that is integers: a pixel is covered when its centre is inside, or on a top or
   left edge. So triangles that share vertices (the same three floats, also in other clusters and after clipping)
   neither overlap nor leave gaps. Vertices nearer than the near plane, or more than 16384 pixels from the middle of the
   picture, send their triangle through a clipper; a new vertex depends on the cut edge alone.
   Depth: 1/z is affine in the picture, so 1/z at a pixel centre is the mean of 1/z of the vertices by the areas of
   the three part triangles: the depth of the plane at the centre, up to the 1/8192 pixel that rounding moved vertices.
   Three ways by size, all with the same coverage, the scalar and the AVX2 form with the same bits:
       small   at most 7 x 7 pixels: areas fit into 32 bits. One with at most 2 x 2 centres in its box is done eight
               at a time (most triangles of a fine mesh have no centre in their box and are dropped before that).
       large   8 x 8 blocks of pixels, 64-bit areas for a block, 32-bit within.
   Masked stores lose (a row of 8 keys is loaded, mixed and stored whole, or keys are stored one by one), and so do
   branches on whether a pixel of a tiny triangle wins.
   Seen from outside a triangle is counter-clockwise; `mirrored` says that the matrix of the instance turns that round.
   --------------------------------------------------------------------------- */

enum {
    ZBUFRANDI_RASTER_BITS = 12,
    ZBUFRANDI_RASTER_UNIT = 1 << ZBUFRANDI_RASTER_BITS,       /* one pixel */
    ZBUFRANDI_RASTER_GUARD = 16384 * ZBUFRANDI_RASTER_UNIT,   /* 2^26 */
    ZBUFRANDI_RASTER_SMALL = 7 * ZBUFRANDI_RASTER_UNIT,
    ZBUFRANDI_RASTER_MIDDLE = 256 * ZBUFRANDI_RASTER_UNIT,    /* edge functions in whole pixels fit into 31 bits */
    ZBUFRANDI_RASTER_BEHIND = 1,                              /* codes of vertices; 0 is a good one */
    ZBUFRANDI_RASTER_OUTSIDE = 2,
    ZBUFRANDI_RASTER_CORNERS = 24                             /* of a clipped triangle: 8, more only by rounding */
};
/* Largest width and height: the guard band must contain the picture. Larger differences of coordinates than 2^27 would
   not fit into the 32 bits of an 8 x 8 block. */
#define ZBUFRANDI_RASTER_MAX_SIZE 32000u

typedef struct zbufrandi_raster {
    float m[3][3], eye[3], rest[3]; /* m (p - eye) + rest: (x, y, z); x / z, y / z: units from the middle, y downward */
    int32_t center_x, center_y;    /* units */
    float near_z, far_z;
    int32_t x0, y0, x1, y1;        /* pixels that may be written: x0 <= x < x1, y0 <= y < y1 */
    uint32_t width;
    uint64_t *key;
    zbufrandi_mask mask;           /* of the material at work */
    double scale;                  /* units per tangent */
    int mirrored;
    int exclusive;                 /* nobody else writes these pixels meanwhile: plain stores do */
    int level;                     /* 1 scalar, 3 AVX2 */
} zbufrandi_raster;

typedef struct zbufrandi_raster_vertex {
    int32_t x, y;   /* units from the upper left corner of the picture */
    float iz;       /* 1 / z */
    uint32_t code;
} zbufrandi_raster_vertex;

/* For a frame; then _local for an instance, then _cluster. level 0: the best here. */
static ZBUFRANDI_UNUSED void zbufrandi_raster_begin(zbufrandi_raster *r, const zbufrandi_camera *camera,
                                                    const zbufrandi_keys *keys, int exclusive, int level) {
    memset(r, 0, sizeof *r);
    if (level == 0) level = zbufrandi_cpu_level();
    r->level = level >= 3 && ZBUFRANDI_AVX2 ? 3 : 1;
    r->exclusive = exclusive;
    r->scale = camera->focal * (double)ZBUFRANDI_RASTER_UNIT;
    r->center_x = (int32_t)zbufrandi_floor(camera->center_x * (double)ZBUFRANDI_RASTER_UNIT + 0.5);
    r->center_y = (int32_t)zbufrandi_floor(camera->center_y * (double)ZBUFRANDI_RASTER_UNIT + 0.5);
    r->near_z = (float)zbufrandi_max(camera->near_z, 1e-37);
    r->far_z = (float)zbufrandi_min(camera->far_z, 1e37);
    r->x1 = (int32_t)keys->width;
    r->y1 = (int32_t)keys->height;
    r->width = keys->width;
    r->key = keys->key;
    r->mask.opacity = 1.0f;
}

static ZBUFRANDI_UNUSED void zbufrandi_raster_local(zbufrandi_raster *r, const zbufrandi_local *local) {
    int k;
    for (k = 0; k < 3; k++) {
        r->m[0][k] = (float)((double)local->m[0][k] * r->scale);
        r->m[1][k] = (float)((double)local->m[1][k] * -r->scale);
        r->m[2][k] = local->m[2][k];
        r->eye[k] = local->eye[k];
    }
    r->rest[0] = (float)((double)local->rest[0] * r->scale);
    r->rest[1] = (float)((double)local->rest[1] * -r->scale);
    r->rest[2] = local->rest[2];
    r->mirrored = local->mirrored != 0;
}

/* Nearest integer, ties to even, |v| < 2^31: what the vector conversion does. */
ZBUFRANDI_INLINE int32_t zbufrandi_raster_round(float v) {
    int32_t i = (int32_t)v;
    float d = v - (float)i;
    if (d > 0.5f || (d == 0.5f && (i & 1))) i++;
    if (d < -0.5f || (d == -0.5f && (i & 1))) i--;
    return i;
}

ZBUFRANDI_INLINE void zbufrandi_raster_transform(const zbufrandi_raster *r, const float *p, float q[3]) {
    const float x = p[0] - r->eye[0], y = p[1] - r->eye[1], z = p[2] - r->eye[2];
    int k;
    for (k = 0; k < 3; k++) q[k] = x * r->m[k][0] + y * r->m[k][1] + z * r->m[k][2] + r->rest[k];
}

/* Comparisons are written so that NaN is never inside. */
static uint32_t zbufrandi_raster_project(const zbufrandi_raster *r, const float *position, uint32_t count,
                                         zbufrandi_raster_vertex *out) {
    const float guard = (float)ZBUFRANDI_RASTER_GUARD;
    uint32_t i, codes = 0;
    for (i = 0; i < count; i++) {
        float q[3], x, y, iz;
        zbufrandi_raster_transform(r, position + 3 * i, q);
        iz = 1.0f / q[2];
        x = q[0] * iz;
        y = q[1] * iz;
        memset(&out[i], 0, sizeof out[i]);
        if (!(q[2] >= r->near_z)) out[i].code = ZBUFRANDI_RASTER_BEHIND;
        if (!(x >= -guard && x <= guard && y >= -guard && y <= guard && q[2] <= 1e37f))
            out[i].code |= ZBUFRANDI_RASTER_OUTSIDE;
        codes |= out[i].code;
        if (out[i].code != 0) continue;
        out[i].x = r->center_x + zbufrandi_raster_round(x);
        out[i].y = r->center_y + zbufrandi_raster_round(y);
        out[i].iz = iz;
    }
    return codes;
}

ZBUFRANDI_INLINE void zbufrandi_raster_put(const zbufrandi_raster *r, size_t at, float z, uint32_t low) {
    uint32_t bits;
    uint64_t key;
    if (!zbufrandi_mask_shows(&r->mask, at)) return;
    memcpy(&bits, &z, sizeof bits);
    key = (uint64_t)bits << 32 | low;
    if (!r->exclusive) zbufrandi_key_min(&r->key[at], key);
    else if (key < r->key[at]) r->key[at] = key;
}

/* Centres are at half units. First pixel whose centre is at v or later, last one whose centre is at v or before. */
ZBUFRANDI_INLINE int32_t zbufrandi_raster_first(int32_t v) {
    return (v + (ZBUFRANDI_RASTER_UNIT / 2 - 1)) >> ZBUFRANDI_RASTER_BITS;
}
ZBUFRANDI_INLINE int32_t zbufrandi_raster_last(int32_t v) {
    return (v - ZBUFRANDI_RASTER_UNIT / 2) >> ZBUFRANDI_RASTER_BITS;
}

/* With positive area inside is to the right of each edge (rows count downward), so an edge is a left one when it runs
   upward and a top one when it runs to the right. 0 if its points belong to the triangle, -1 if not. */
ZBUFRANDI_INLINE int32_t zbufrandi_raster_bias(const zbufrandi_raster_vertex *from, const zbufrandi_raster_vertex *to) {
    return to->y < from->y || (to->y == from->y && to->x > from->x) ? 0 : -1;
}

/* ---- small triangles ---- */

/* Twice the area of (p, a, b) and so on for each centre p of the box i0..i1, j0..j1. Sides are at most 7 pixels, so
   is the distance of a centre from its first: below 2^31. */
static uint32_t zbufrandi_raster_small(const zbufrandi_raster *r, const zbufrandi_raster_vertex *a,
                                       const zbufrandi_raster_vertex *b, const zbufrandi_raster_vertex *c,
                                       const int32_t box[4], uint32_t low) {
    const int32_t bias_a = zbufrandi_raster_bias(b, c), bias_b = zbufrandi_raster_bias(c, a),
                  bias_c = zbufrandi_raster_bias(a, b);
    const int32_t area = (b->x - a->x) * (c->y - a->y) - (b->y - a->y) * (c->x - a->x);
    uint32_t covered = 0;
    int32_t i, j;
    for (j = box[1]; j <= box[3]; j++) {
        for (i = box[0]; i <= box[2]; i++) {
            int32_t px = i * ZBUFRANDI_RASTER_UNIT + ZBUFRANDI_RASTER_UNIT / 2,
                    py = j * ZBUFRANDI_RASTER_UNIT + ZBUFRANDI_RASTER_UNIT / 2;
            int32_t ax = a->x - px, ay = a->y - py, bx = b->x - px, by = b->y - py, cx = c->x - px, cy = c->y - py;
            int32_t wa = bx * cy - by * cx, wb = cx * ay - cy * ax, wc = ax * by - ay * bx;
            float z;
            if (((wa + bias_a) | (wb + bias_b) | (wc + bias_c)) < 0) continue;
            z = (float)area / ((float)wa * a->iz + (float)wb * b->iz + (float)wc * c->iz);
            if (!(z <= r->far_z)) continue;
            zbufrandi_raster_put(r, (size_t)j * r->width + (size_t)i, z, low);
            covered++;
        }
    }
    return covered;
}

/* ---- large triangles ---- */

/* Edge functions in steps of whole pixels: w(i, j) = w0 + dx * i + dy * j with the fill rule in w0, counted from the
   block of 8 x 8 pixels at (i0, j0). Dividing by the unit and rounding down keeps the sign exact. */
typedef struct zbufrandi_raster_large {
    int64_t w0[3];
    int32_t dx[3], dy[3];
    int32_t i0, j0;              /* box[0], box[1]: the fewest blocks, and one column of them if it is narrow */
    int32_t box[4];              /* pixels, inclusive */
    int64_t w[3];                /* edge functions at the first pixel in units, without the fill rule */
    double iz, iz_dx, iz_dy;     /* 1 / z at pixel (i0, j0) and its steps */
    float iz_min, iz_max;
    uint32_t low;
} zbufrandi_raster_large;

/* rounds down, b > 0 */
ZBUFRANDI_INLINE int64_t zbufrandi_raster_div(int64_t a, int64_t b) { return a / b - (a % b < 0); }

/* Edge functions alone: enough to know what is covered. */
ZBUFRANDI_INLINE void zbufrandi_raster_large_edges(zbufrandi_raster_large *t, const zbufrandi_raster_vertex *const v[3],
                                                   const int32_t box[4], uint32_t low) {
    int k;
    t->i0 = box[0];
    t->j0 = box[1];
    memcpy(t->box, box, sizeof t->box);
    t->low = low;
    for (k = 0; k < 3; k++) {
        const zbufrandi_raster_vertex *p = v[k == 2 ? 0 : k + 1], *q = v[k == 0 ? 2 : k - 1]; /* the edge opposite */
        int64_t px = (int64_t)t->i0 * ZBUFRANDI_RASTER_UNIT + ZBUFRANDI_RASTER_UNIT / 2 - p->x;
        int64_t py = (int64_t)t->j0 * ZBUFRANDI_RASTER_UNIT + ZBUFRANDI_RASTER_UNIT / 2 - p->y, w;
        t->dx[k] = p->y - q->y;
        t->dy[k] = q->x - p->x;
        w = t->dx[k] * px + t->dy[k] * py;
        t->w[k] = w;
        t->w0[k] = (w + zbufrandi_raster_bias(p, q)) >> ZBUFRANDI_RASTER_BITS;
    }
}

static void zbufrandi_raster_large_depth(zbufrandi_raster_large *t, const zbufrandi_raster_vertex *const v[3]) {
    double area = 0, iz = 0, dx = 0, dy = 0;
    int k;
    t->iz_min = t->iz_max = v[0]->iz;
    for (k = 0; k < 3; k++) {
        area += (double)t->w[k];
        iz += (double)t->w[k] * (double)v[k]->iz;
        dx += (double)t->dx[k] * (double)v[k]->iz;
        dy += (double)t->dy[k] * (double)v[k]->iz;
        if (v[k]->iz < t->iz_min) t->iz_min = v[k]->iz;
        if (v[k]->iz > t->iz_max) t->iz_max = v[k]->iz;
    }
    t->iz = iz / area;
    t->iz_dx = dx * (double)ZBUFRANDI_RASTER_UNIT / area;
    t->iz_dy = dy * (double)ZBUFRANDI_RASTER_UNIT / area;
}

/* A block at (i, j), edge functions w at its first pixel; an edge that the block lies inside of has w = dx = dy = 0. */
static uint32_t zbufrandi_raster_block(const zbufrandi_raster *r, const zbufrandi_raster_large *t, int32_t i, int32_t j,
                                       const int32_t w[3], const int32_t dx[3], const int32_t dy[3]) {
    uint32_t covered = 0;
    int32_t x, y;
    for (y = 0; y < 8; y++) {
        double row = t->iz + t->iz_dx * (double)(i - t->i0) + t->iz_dy * (double)(j + y - t->j0);
        if (j + y < t->box[1] || j + y > t->box[3]) continue;
        for (x = 0; x < 8; x++) {
            float iz = (float)(row + t->iz_dx * (double)x), z;
            if (i + x < t->box[0] || i + x > t->box[2]) continue;
            if (((w[0] + x * dx[0] + y * dy[0]) | (w[1] + x * dx[1] + y * dy[1]) | (w[2] + x * dx[2] + y * dy[2])) < 0)
                continue;
            iz = iz < t->iz_min ? t->iz_min : iz;
            iz = iz > t->iz_max ? t->iz_max : iz;
            z = 1.0f / iz;
            if (!(z <= r->far_z)) continue;
            zbufrandi_raster_put(r, (size_t)(j + y) * r->width + (size_t)(i + x), z, t->low);
            covered++;
        }
    }
    return covered;
}

#if ZBUFRANDI_AVX2
/* The same, a row of the block at a time. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_raster_block_avx2(const zbufrandi_raster *r,
                                                                  const zbufrandi_raster_large *t, int32_t i, int32_t j,
                                                                  const int32_t w[3], const int32_t dx[3],
                                                                  const int32_t dy[3]) {
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7),
                  top = _mm256_set1_epi64x((int64_t)((uint64_t)1 << 63));
    const __m256i low = _mm256_set1_epi32((int32_t)t->low);
    const __m256 iz_min = _mm256_set1_ps(t->iz_min), iz_max = _mm256_set1_ps(t->iz_max),
                 far_z = _mm256_set1_ps(r->far_z);
    const __m256d d = _mm256_set1_pd(t->iz_dx);
    const __m256d d03 = _mm256_mul_pd(d, _mm256_setr_pd(0, 1, 2, 3)),
                  d47 = _mm256_mul_pd(d, _mm256_setr_pd(4, 5, 6, 7));
    const __m256i column = _mm256_add_epi32(lane, _mm256_set1_epi32(i));
    const __m256i beside = _mm256_or_si256(_mm256_cmpgt_epi32(_mm256_set1_epi32(t->box[0]), column),
                                           _mm256_cmpgt_epi32(column, _mm256_set1_epi32(t->box[2])));
    __m256i w0 = _mm256_add_epi32(_mm256_set1_epi32(w[0]), _mm256_mullo_epi32(lane, _mm256_set1_epi32(dx[0])));
    __m256i w1 = _mm256_add_epi32(_mm256_set1_epi32(w[1]), _mm256_mullo_epi32(lane, _mm256_set1_epi32(dx[1])));
    __m256i w2 = _mm256_add_epi32(_mm256_set1_epi32(w[2]), _mm256_mullo_epi32(lane, _mm256_set1_epi32(dx[2])));
    const int32_t y0 = t->box[1] > j ? t->box[1] - j : 0, y1 = t->box[3] < j + 7 ? t->box[3] - j : 7;
    const int whole = r->exclusive && i >= r->x0 && i + 8 <= r->x1; /* masked stores are slow */
    uint32_t covered = 0;
    int32_t y;
    w0 = _mm256_add_epi32(w0, _mm256_set1_epi32(y0 * dy[0]));
    w1 = _mm256_add_epi32(w1, _mm256_set1_epi32(y0 * dy[1]));
    w2 = _mm256_add_epi32(w2, _mm256_set1_epi32(y0 * dy[2]));
    for (y = y0; y <= y1; y++) {
        __m256i outside = _mm256_or_si256(_mm256_or_si256(w0, w1), _mm256_or_si256(w2, beside));
        w0 = _mm256_add_epi32(w0, _mm256_set1_epi32(dy[0]));
        w1 = _mm256_add_epi32(w1, _mm256_set1_epi32(dy[1]));
        w2 = _mm256_add_epi32(w2, _mm256_set1_epi32(dy[2]));
        if (_mm256_movemask_ps(_mm256_castsi256_ps(outside)) != 255) {
            const __m256d row = _mm256_set1_pd(t->iz + t->iz_dx * (double)(i - t->i0) +
                                               t->iz_dy * (double)(j + y - t->j0));
            const __m256 iz = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm256_cvtpd_ps(_mm256_add_pd(row, d03))),
                                                   _mm256_cvtpd_ps(_mm256_add_pd(row, d47)), 1);
            const __m256 z = _mm256_div_ps(_mm256_set1_ps(1.0f), _mm256_min_ps(_mm256_max_ps(iz, iz_min), iz_max));
            const __m256i inside = _mm256_andnot_si256(_mm256_srai_epi32(outside, 31),
                                                       _mm256_castps_si256(_mm256_cmp_ps(z, far_z, _CMP_LE_OQ)));
            const __m256i keys_a = _mm256_unpacklo_epi32(low, _mm256_castps_si256(z)); /* pixels 0 1 4 5 */
            const __m256i keys_b = _mm256_unpackhi_epi32(low, _mm256_castps_si256(z)); /* 2 3 6 7 */
            const __m256i in_a = _mm256_unpacklo_epi32(inside, inside), in_b = _mm256_unpackhi_epi32(inside, inside);
            const __m256i k03 = _mm256_permute2x128_si256(keys_a, keys_b, 0x20),
                          k47 = _mm256_permute2x128_si256(keys_a, keys_b, 0x31);
            const __m256i in03 = _mm256_permute2x128_si256(in_a, in_b, 0x20),
                          in47 = _mm256_permute2x128_si256(in_a, in_b, 0x31);
            uint64_t *at = r->key + (size_t)(j + y) * r->width + (size_t)i;
            __m256i old03, old47, win03, win47;
            uint32_t win;
            if (whole) {
                old03 = _mm256_loadu_si256((const __m256i *)(const void *)at);
                old47 = _mm256_loadu_si256((const __m256i *)(const void *)(at + 4));
            } else {
                old03 = _mm256_maskload_epi64((const long long *)(const void *)at, in03);
                old47 = _mm256_maskload_epi64((const long long *)(const void *)(at + 4), in47);
            }
            win03 = _mm256_and_si256(in03,
                                     _mm256_cmpgt_epi64(_mm256_xor_si256(old03, top), _mm256_xor_si256(k03, top)));
            win47 = _mm256_and_si256(in47,
                                     _mm256_cmpgt_epi64(_mm256_xor_si256(old47, top), _mm256_xor_si256(k47, top)));
            covered += (uint32_t)__builtin_popcount((uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(inside)));
            win = (uint32_t)_mm256_movemask_pd(_mm256_castsi256_pd(win03)) |
                  (uint32_t)_mm256_movemask_pd(_mm256_castsi256_pd(win47)) << 4;
            if (win == 0) continue;
            if (whole) {
                _mm256_storeu_si256((__m256i *)(void *)at, _mm256_blendv_epi8(old03, k03, win03));
                _mm256_storeu_si256((__m256i *)(void *)(at + 4), _mm256_blendv_epi8(old47, k47, win47));
            } else {
                uint64_t key[8];
                _mm256_storeu_si256((__m256i *)(void *)key, k03);
                _mm256_storeu_si256((__m256i *)(void *)(key + 4), k47);
                for (; win != 0; win &= win - 1) {
                    uint32_t x = zbufrandi_ctz64(win);
                    if (!r->exclusive) zbufrandi_key_min(at + x, key[x]);
                    else at[x] = key[x];
                }
            }
        }
    }
    return covered;
}
#endif

#if ZBUFRANDI_AVX2
/* A triangle at most 4 pixels wide and 256 high: eight rows of a column at a time; most have few centres or none. What
   is covered gets the depth that a block would give it. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_raster_narrow_avx2(const zbufrandi_raster *r, zbufrandi_raster_large *t,
                                                                   const zbufrandi_raster_vertex *const v[3]) {
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const int32_t wide = t->box[2] - t->box[0], high = t->box[3] - t->box[1];
    uint32_t covered = 0;
    int32_t x, y;
    int depth = 0; /* known */
    __m256i w0 = _mm256_add_epi32(_mm256_set1_epi32((int32_t)t->w0[0]),
                                  _mm256_mullo_epi32(lane, _mm256_set1_epi32(t->dy[0])));
    __m256i w1 = _mm256_add_epi32(_mm256_set1_epi32((int32_t)t->w0[1]),
                                  _mm256_mullo_epi32(lane, _mm256_set1_epi32(t->dy[1])));
    __m256i w2 = _mm256_add_epi32(_mm256_set1_epi32((int32_t)t->w0[2]),
                                  _mm256_mullo_epi32(lane, _mm256_set1_epi32(t->dy[2])));
    for (y = 0; y <= high; y += 8) {
        __m256i u0 = w0, u1 = w1, u2 = w2;
        const uint32_t rows = high - y < 7 ? (2u << (high - y)) - 1u : 255u;
        for (x = 0; x <= wide; x++) {
            const __m256i outside = _mm256_or_si256(_mm256_or_si256(u0, u1), u2);
            uint32_t hit = rows & ~(uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(outside));
            if (hit != 0 && !depth) {
                zbufrandi_raster_large_depth(t, v);
                depth = 1;
            }
            for (; hit != 0; hit &= hit - 1) {
                const int32_t j = y + (int32_t)zbufrandi_ctz64(hit);
                float iz = (float)(t->iz + t->iz_dy * (double)j + t->iz_dx * (double)x), z;
                iz = iz < t->iz_min ? t->iz_min : iz;
                iz = iz > t->iz_max ? t->iz_max : iz;
                z = 1.0f / iz;
                if (!(z <= r->far_z)) continue;
                covered++;
                zbufrandi_raster_put(r, (size_t)(t->j0 + j) * r->width + (size_t)(t->i0 + x), z, t->low);
            }
            u0 = _mm256_add_epi32(u0, _mm256_set1_epi32(t->dx[0]));
            u1 = _mm256_add_epi32(u1, _mm256_set1_epi32(t->dx[1]));
            u2 = _mm256_add_epi32(u2, _mm256_set1_epi32(t->dx[2]));
        }
        w0 = _mm256_add_epi32(w0, _mm256_set1_epi32(8 * t->dy[0]));
        w1 = _mm256_add_epi32(w1, _mm256_set1_epi32(8 * t->dy[1]));
        w2 = _mm256_add_epi32(w2, _mm256_set1_epi32(8 * t->dy[2]));
    }
    return covered;
}
#endif

/* Rows of blocks; in each the range of blocks that no edge excludes comes from one division per edge. */
static uint32_t zbufrandi_raster_blocks(const zbufrandi_raster *r, const zbufrandi_raster_large *t) {
    const int32_t columns = ((t->box[2] - t->i0) >> 3) + 1, rows = ((t->box[3] - t->j0) >> 3) + 1;
    int64_t most[3], least[3]; /* over a block, from its first pixel */
    uint32_t covered = 0;
    int32_t row, k, n;
    for (k = 0; k < 3; k++) {
        int64_t dx = 7 * (int64_t)t->dx[k], dy = 7 * (int64_t)t->dy[k];
        most[k] = (dx > 0 ? dx : 0) + (dy > 0 ? dy : 0);
        least[k] = (dx < 0 ? dx : 0) + (dy < 0 ? dy : 0);
    }
    for (row = 0; row < rows; row++) {
        int64_t first = 0, last = columns - 1, w[3];
        for (k = 0; k < 3; k++) {
            int64_t m, step = 8 * (int64_t)t->dx[k];
            w[k] = t->w0[k] + 8 * (int64_t)row * t->dy[k];
            m = w[k] + most[k];
            if (step > 0) {
                if (m + first * step < 0) first = zbufrandi_raster_div(step - 1 - m, step);
            } else if (m + last * step < 0) {
                last = step < 0 && m >= 0 ? m / -step : -1;
            }
        }
        for (n = (int32_t)first; n <= (int32_t)last; n++) {
            int32_t v[3], dx[3], dy[3];
            for (k = 0; k < 3; k++) {
                int64_t at = w[k] + 8 * (int64_t)n * t->dx[k];
                int whole = at + least[k] >= 0;
                v[k] = whole ? 0 : (int32_t)at;
                dx[k] = whole ? 0 : t->dx[k];
                dy[k] = whole ? 0 : t->dy[k];
            }
#if ZBUFRANDI_AVX2
            if (r->level >= 3) {
                covered += zbufrandi_raster_block_avx2(r, t, t->i0 + 8 * n, t->j0 + 8 * row, v, dx, dy);
                continue;
            }
#endif
            covered += zbufrandi_raster_block(r, t, t->i0 + 8 * n, t->j0 + 8 * row, v, dx, dy);
        }
    }
    return covered;
}

/* ---- a triangle ---- */

/* Three good vertices. two_sided: drawn whichever way it turns. */
static uint32_t zbufrandi_raster_triangle(const zbufrandi_raster *r, const zbufrandi_raster_vertex *a,
                                          const zbufrandi_raster_vertex *b, const zbufrandi_raster_vertex *c,
                                          int two_sided, uint32_t low) {
    const int64_t area = (int64_t)(b->x - a->x) * (c->y - a->y) - (int64_t)(b->y - a->y) * (c->x - a->x);
    int32_t x0, x1, y0, y1, box[4];
    const zbufrandi_raster_vertex *v[3];
    zbufrandi_raster_large t;
    /* counter-clockwise with rows counted downward: negative */
    if (area == 0) return 0;
    if (r->mirrored ? area < 0 : area > 0) {
        if (!two_sided) return 0;
    }
    if (area < 0) {
        const zbufrandi_raster_vertex *swap = b;
        b = c;
        c = swap;
    }
    x0 = a->x < b->x ? a->x : b->x;
    x1 = a->x > b->x ? a->x : b->x;
    y0 = a->y < b->y ? a->y : b->y;
    y1 = a->y > b->y ? a->y : b->y;
    if (c->x < x0) x0 = c->x;
    if (c->x > x1) x1 = c->x;
    if (c->y < y0) y0 = c->y;
    if (c->y > y1) y1 = c->y;
    box[0] = zbufrandi_raster_first(x0);
    box[1] = zbufrandi_raster_first(y0);
    box[2] = zbufrandi_raster_last(x1);
    box[3] = zbufrandi_raster_last(y1);
    if (box[0] < r->x0) box[0] = r->x0;
    if (box[1] < r->y0) box[1] = r->y0;
    if (box[2] >= r->x1) box[2] = r->x1 - 1;
    if (box[3] >= r->y1) box[3] = r->y1 - 1;
    if (box[0] > box[2] || box[1] > box[3]) return 0;
    if (x1 - x0 <= ZBUFRANDI_RASTER_SMALL && y1 - y0 <= ZBUFRANDI_RASTER_SMALL)
        return zbufrandi_raster_small(r, a, b, c, box, low);
    v[0] = a;
    v[1] = b;
    v[2] = c;
    zbufrandi_raster_large_edges(&t, v, box, low);
#if ZBUFRANDI_AVX2
    if (r->level >= 3 && box[2] - box[0] < 4 && x1 - x0 <= ZBUFRANDI_RASTER_MIDDLE &&
        y1 - y0 <= ZBUFRANDI_RASTER_MIDDLE)
            return zbufrandi_raster_narrow_avx2(r, &t, v);
#endif
    zbufrandi_raster_large_depth(&t, v);
    return zbufrandi_raster_blocks(r, &t);
}

/* ---- clipping ---- */

typedef struct zbufrandi_raster_corner {
    double q[3];                  /* x, y, z before the division */
    int inside;                   /* a vertex that needs no clipping: v is set and all planes accept it */
    zbufrandi_raster_vertex v;
} zbufrandi_raster_corner;

/* Signed distances to near plane and guard band. */
static double zbufrandi_raster_distance(const zbufrandi_raster *r, const zbufrandi_raster_corner *c, int plane) {
    const double guard = (double)ZBUFRANDI_RASTER_GUARD * c->q[2];
    double d;
    switch (plane) {
    case 0: d = c->q[2] - (double)r->near_z; break;
    case 1: d = guard - c->q[0]; break;
    case 2: d = guard + c->q[0]; break;
    case 3: d = guard - c->q[1]; break;
    default: d = guard + c->q[1]; break;
    }
    return c->inside && d < 0 ? 0.0 : d;
}

/* A new corner is computed from the inner to the outer end of its edge: the neighbour across the edge gets the same. */
static uint32_t zbufrandi_raster_clip_plane(const zbufrandi_raster *r, const zbufrandi_raster_corner *in,
                                            uint32_t count, zbufrandi_raster_corner *out, int plane) {
    uint32_t i, n = 0;
    for (i = 0; i < count && n + 2 <= ZBUFRANDI_RASTER_CORNERS; i++) {
        const zbufrandi_raster_corner *a = &in[i], *b = &in[i + 1 == count ? 0 : i + 1];
        double da = zbufrandi_raster_distance(r, a, plane), db = zbufrandi_raster_distance(r, b, plane);
        if (da >= 0) out[n++] = *a;
        if ((da >= 0) != (db >= 0)) {
            const zbufrandi_raster_corner *in_end = da >= 0 ? a : b, *out_end = da >= 0 ? b : a;
            const double d_in = da >= 0 ? da : db, d_out = da >= 0 ? -db : -da; /* weights: z loses no digits */
            int k;
            memset(&out[n], 0, sizeof out[n]);
            for (k = 0; k < 3; k++) out[n].q[k] = (in_end->q[k] * d_out + out_end->q[k] * d_in) / (d_in + d_out);
            if (plane == 0) out[n].q[2] = (double)r->near_z; /* ends far before and behind would cancel */
            n++;
        }
    }
    return n;
}

static int32_t zbufrandi_raster_clamped(double v) { /* what was clipped is out of range by rounding at most */
    const double guard = (double)ZBUFRANDI_RASTER_GUARD;
    return (int32_t)zbufrandi_floor((v > guard ? guard : v >= -guard ? v : -guard) + 0.5);
}

static uint32_t zbufrandi_raster_clip(const zbufrandi_raster *r, const float *position[3],
                                      const zbufrandi_raster_vertex *vertex[3], int two_sided, uint32_t low) {
    zbufrandi_raster_corner polygon[2][ZBUFRANDI_RASTER_CORNERS];
    uint32_t k, n = 3, covered = 0;
    int plane, side = 0;
    if ((vertex[0]->code & vertex[1]->code & vertex[2]->code & ZBUFRANDI_RASTER_BEHIND) != 0) return 0;
    for (k = 0; k < 3; k++) {
        zbufrandi_raster_corner *c = &polygon[0][k];
        float q[3];
        zbufrandi_raster_transform(r, position[k], q);
        if (!zbufrandi_finite_f(q[0]) || !zbufrandi_finite_f(q[1]) || !zbufrandi_finite_f(q[2])) return 0;
        c->q[0] = (double)q[0];
        c->q[1] = (double)q[1];
        c->q[2] = (double)q[2];
        c->inside = vertex[k]->code == 0;
        c->v = *vertex[k];
    }
    for (plane = 0; plane < 5 && n >= 3; plane++) {
        n = zbufrandi_raster_clip_plane(r, polygon[side], n, polygon[1 - side], plane);
        side = 1 - side;
    }
    if (n < 3) return 0;
    for (k = 0; k < n; k++) {
        zbufrandi_raster_corner *c = &polygon[side][k];
        if (c->inside) continue;
        c->v.x = r->center_x + zbufrandi_raster_clamped(c->q[0] / c->q[2]);
        c->v.y = r->center_y + zbufrandi_raster_clamped(c->q[1] / c->q[2]);
        c->v.iz = (float)(1.0 / c->q[2]);
        c->v.code = 0;
    }
    for (k = 2; k < n; k++) {
        covered += zbufrandi_raster_triangle(r, &polygon[side][0].v, &polygon[side][k - 1].v, &polygon[side][k].v,
                                             two_sided, low);
    }
    return covered;
}

/* ---- clusters ---- */

static uint32_t zbufrandi_raster_cluster_scalar(const zbufrandi_raster *r, const float *position,
                                                const zbufrandi_raster_vertex *vertex, const uint8_t *triangle,
                                                uint32_t triangle_count, int two_sided, uint32_t first_number) {
    uint32_t i, k, covered = 0;
    for (i = 0; i < triangle_count; i++) {
        const uint8_t *t = triangle + 3 * i;
        const zbufrandi_raster_vertex *v[3];
        const float *p[3];
        uint32_t low = zbufrandi_hash32(first_number + i);
        for (k = 0; k < 3; k++) {
            v[k] = &vertex[t[k]];
            p[k] = position + 3 * (size_t)t[k];
        }
        if ((v[0]->code | v[1]->code | v[2]->code) != 0) covered += zbufrandi_raster_clip(r, p, v, two_sided, low);
        else covered += zbufrandi_raster_triangle(r, v[0], v[1], v[2], two_sided, low);
    }
    return covered;
}

#if ZBUFRANDI_AVX2
/* Eight positions at once, the same operations; out has room for a multiple of 8. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_raster_project_avx2(const zbufrandi_raster *r, const float *position,
                                                                    uint32_t count, zbufrandi_raster_vertex *out) {
    const __m256 guard = _mm256_set1_ps((float)ZBUFRANDI_RASTER_GUARD), sign = _mm256_set1_ps(-0.0f);
    const __m256 near_z = _mm256_set1_ps(r->near_z), most_z = _mm256_set1_ps(1e37f);
    __m256 bad = _mm256_setzero_ps(), far_off = _mm256_setzero_ps();
    uint32_t i, k;
    for (i = 0; i < count; i += 8) {
        const float *p = position + 3 * (size_t)i;
        float tail[24];
        __m256 a, b, c, xy, yz, x, y, z, q[3], iz, px, py, behind, outside;
        __m256i ix, iy, code, t0, t1, t2, t3;
        if (count - i < 8) {
            memset(tail, 0, sizeof tail);
            memcpy(tail, p, (size_t)(count - i) * 3 * sizeof(float));
            for (k = count - i; k < 8; k++) memcpy(tail + 3 * k, p, 3 * sizeof(float));
            p = tail;
        }
        a = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p)), _mm_loadu_ps(p + 12), 1);
        b = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p + 4)), _mm_loadu_ps(p + 16), 1);
        c = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p + 8)), _mm_loadu_ps(p + 20), 1);
        xy = _mm256_shuffle_ps(b, c, _MM_SHUFFLE(2, 1, 3, 2)); /* x2 y2 x3 y3 */
        yz = _mm256_shuffle_ps(a, b, _MM_SHUFFLE(1, 0, 2, 1)); /* y0 z0 y1 z1 */
        x = _mm256_shuffle_ps(a, xy, _MM_SHUFFLE(2, 0, 3, 0));
        y = _mm256_shuffle_ps(yz, xy, _MM_SHUFFLE(3, 1, 2, 0));
        z = _mm256_shuffle_ps(yz, c, _MM_SHUFFLE(3, 0, 3, 1));
        x = _mm256_sub_ps(x, _mm256_set1_ps(r->eye[0]));
        y = _mm256_sub_ps(y, _mm256_set1_ps(r->eye[1]));
        z = _mm256_sub_ps(z, _mm256_set1_ps(r->eye[2]));
        for (k = 0; k < 3; k++) {
            const float *row = r->m[k];
            q[k] = _mm256_add_ps(_mm256_mul_ps(x, _mm256_set1_ps(row[0])), _mm256_mul_ps(y, _mm256_set1_ps(row[1])));
            q[k] = _mm256_add_ps(_mm256_add_ps(q[k], _mm256_mul_ps(z, _mm256_set1_ps(row[2]))),
                                 _mm256_set1_ps(r->rest[k]));
        }
        iz = _mm256_div_ps(_mm256_set1_ps(1.0f), q[2]);
        px = _mm256_mul_ps(q[0], iz);
        py = _mm256_mul_ps(q[1], iz);
        behind = _mm256_cmp_ps(q[2], near_z, _CMP_NGE_UQ);
        outside = _mm256_or_ps(_mm256_cmp_ps(_mm256_andnot_ps(sign, px), guard, _CMP_NLE_UQ),
                               _mm256_cmp_ps(_mm256_andnot_ps(sign, py), guard, _CMP_NLE_UQ));
        outside = _mm256_or_ps(outside, _mm256_cmp_ps(q[2], most_z, _CMP_NLE_UQ));
        bad = _mm256_or_ps(bad, behind);
        far_off = _mm256_or_ps(far_off, outside);
        code = _mm256_sub_epi32(_mm256_srli_epi32(_mm256_castps_si256(behind), 31),
                                _mm256_slli_epi32(_mm256_castps_si256(outside), 1));
        code = _mm256_and_si256(code, _mm256_set1_epi32(3));
        ix = _mm256_add_epi32(_mm256_cvtps_epi32(px), _mm256_set1_epi32(r->center_x));
        iy = _mm256_add_epi32(_mm256_cvtps_epi32(py), _mm256_set1_epi32(r->center_y));
        t0 = _mm256_unpacklo_epi32(ix, iy);
        t1 = _mm256_unpackhi_epi32(ix, iy);
        t2 = _mm256_unpacklo_epi32(_mm256_castps_si256(iz), code);
        t3 = _mm256_unpackhi_epi32(_mm256_castps_si256(iz), code);
        ix = _mm256_unpacklo_epi64(t0, t2); /* vertices 0 and 4 */
        iy = _mm256_unpackhi_epi64(t0, t2); /* 1 and 5 */
        t0 = _mm256_unpacklo_epi64(t1, t3); /* 2 and 6 */
        t1 = _mm256_unpackhi_epi64(t1, t3); /* 3 and 7 */
        _mm256_storeu_si256((__m256i *)(void *)&out[i], _mm256_permute2x128_si256(ix, iy, 0x20));
        _mm256_storeu_si256((__m256i *)(void *)&out[i + 2], _mm256_permute2x128_si256(t0, t1, 0x20));
        _mm256_storeu_si256((__m256i *)(void *)&out[i + 4], _mm256_permute2x128_si256(ix, iy, 0x31));
        _mm256_storeu_si256((__m256i *)(void *)&out[i + 6], _mm256_permute2x128_si256(t0, t1, 0x31));
    }
    return (_mm256_movemask_ps(bad) != 0 ? (uint32_t)ZBUFRANDI_RASTER_BEHIND : 0u) |
           (_mm256_movemask_ps(far_off) != 0 ? (uint32_t)ZBUFRANDI_RASTER_OUTSIDE : 0u);
}

typedef struct zbufrandi_raster_corner8 { __m256i x, y; __m256 iz; } zbufrandi_raster_corner8;

/* Vertices t[0], t[3], ... of eight triangles given by where their index bytes stand. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE zbufrandi_raster_corner8 zbufrandi_raster_fetch(const zbufrandi_raster_vertex *v,
                                                                                       const uint8_t *const t[8],
                                                                                       uint32_t corner) {
    zbufrandi_raster_corner8 c;
#define ZBUFRANDI_RASTER_LOAD(k) _mm_loadu_si128((const __m128i *)(const void *)&v[t[k][corner]])
#define ZBUFRANDI_RASTER_PAIR(k) \
    _mm256_inserti128_si256(_mm256_castsi128_si256(ZBUFRANDI_RASTER_LOAD(k)), ZBUFRANDI_RASTER_LOAD((k) + 4), 1)
    const __m256i r0 = ZBUFRANDI_RASTER_PAIR(0), r1 = ZBUFRANDI_RASTER_PAIR(1), r2 = ZBUFRANDI_RASTER_PAIR(2),
                  r3 = ZBUFRANDI_RASTER_PAIR(3);
    const __m256i t0 = _mm256_unpacklo_epi32(r0, r1), t1 = _mm256_unpackhi_epi32(r0, r1);
    const __m256i t2 = _mm256_unpacklo_epi32(r2, r3), t3 = _mm256_unpackhi_epi32(r2, r3);
#undef ZBUFRANDI_RASTER_LOAD
#undef ZBUFRANDI_RASTER_PAIR
    c.x = _mm256_unpacklo_epi64(t0, t2);
    c.y = _mm256_unpackhi_epi64(t0, t2);
    c.iz = _mm256_castsi256_ps(_mm256_unpacklo_epi64(t1, t3));
    return c;
}

/* Twice the area of (p, b, c), the relative positions of b and c given. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256i zbufrandi_raster_cross(__m256i bx, __m256i by, __m256i cx, __m256i cy) {
    return _mm256_sub_epi32(_mm256_mullo_epi32(bx, cy), _mm256_mullo_epi32(by, cx));
}

/* All ones where points of the edge from a to b do not belong to the triangle. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256i zbufrandi_raster_bias8(__m256i ax, __m256i ay, __m256i bx, __m256i by) {
    const __m256i top = _mm256_and_si256(_mm256_cmpeq_epi32(ay, by), _mm256_cmpgt_epi32(bx, ax));
    return _mm256_xor_si256(_mm256_or_si256(_mm256_cmpgt_epi32(ay, by), top), _mm256_set1_epi32(-1));
}

/* First and last pixel with a centre in the box of each triangle, within the part of the picture that is drawn. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_raster_box8(__m256i lo, __m256i hi, int32_t first, int32_t end,
                                                                  __m256i *p0, __m256i *p1) {
    const __m256i half = _mm256_set1_epi32(ZBUFRANDI_RASTER_UNIT / 2);
    *p0 = _mm256_srai_epi32(_mm256_add_epi32(lo, _mm256_set1_epi32(ZBUFRANDI_RASTER_UNIT / 2 - 1)),
                            ZBUFRANDI_RASTER_BITS);
    *p1 = _mm256_srai_epi32(_mm256_sub_epi32(hi, half), ZBUFRANDI_RASTER_BITS);
    *p0 = _mm256_max_epi32(*p0, _mm256_set1_epi32(first));
    *p1 = _mm256_min_epi32(*p1, _mm256_set1_epi32(end - 1));
}

#define ZBUFRANDI_RASTER_MIN3(a, b, c) _mm256_min_epi32(_mm256_min_epi32(a, b), c)
#define ZBUFRANDI_RASTER_MAX3(a, b, c) _mm256_max_epi32(_mm256_max_epi32(a, b), c)

/* Covered pixels on their way to the keys. They are listed without a branch and then put there in one loop: whether a
   centre is inside, and how many of eight are, cannot be predicted. */
enum { ZBUFRANDI_RASTER_FOUND = 768, ZBUFRANDI_RASTER_FOUND_EIGHT = 8 * 64 }; /* more than eight triangles have */
typedef struct zbufrandi_raster_found {
    uint32_t low[ZBUFRANDI_RASTER_FOUND], z[ZBUFRANDI_RASTER_FOUND], at[ZBUFRANDI_RASTER_FOUND];
    uint32_t count;
} zbufrandi_raster_found;

static void zbufrandi_raster_put_found(const zbufrandi_raster *r, zbufrandi_raster_found *f) {
    uint32_t i;
    for (i = 0; i < f->count; i++) {
        const uint64_t key = (uint64_t)f->z[i] << 32 | f->low[i];
        uint64_t *to = &r->key[f->at[i]];
        if (!r->exclusive) zbufrandi_key_min(to, key);
        else *to = key < *to ? key : *to;
    }
    f->count = 0;
}

/* Corners change places in the lanes of `swap`. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_raster_swap8(__m256i swap, zbufrandi_raster_corner8 *b,
                                                                   zbufrandi_raster_corner8 *c) {
    const __m256i x = _mm256_and_si256(_mm256_xor_si256(b->x, c->x), swap);
    const __m256i y = _mm256_and_si256(_mm256_xor_si256(b->y, c->y), swap);
    const __m256i iz = _mm256_and_si256(_mm256_xor_si256(_mm256_castps_si256(b->iz), _mm256_castps_si256(c->iz)), swap);
    b->x = _mm256_xor_si256(b->x, x);
    c->x = _mm256_xor_si256(c->x, x);
    b->y = _mm256_xor_si256(b->y, y);
    c->y = _mm256_xor_si256(c->y, y);
    b->iz = _mm256_castsi256_ps(_mm256_xor_si256(_mm256_castps_si256(b->iz), iz));
    c->iz = _mm256_castsi256_ps(_mm256_xor_si256(_mm256_castps_si256(c->iz), iz));
}

/* Eight triangles that are not large: one centre after the other of all their boxes, what is covered goes to `found`,
   which has room for it and eight more. ids: their numbers within the cluster, of which `count` are meant. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_raster_eight(const zbufrandi_raster *r,
                                                             const zbufrandi_raster_vertex *vertex,
                                                             const uint8_t *triangle, const uint8_t *ids,
                                                             uint32_t count, uint32_t first_number,
                                                             zbufrandi_raster_found *found) {
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const uint8_t *t[8];
    zbufrandi_raster_corner8 a, b, c;
    __m256i area, i0, i1, j0, j1, px, py, wa, wb, wc, bias_a, bias_b, bias_c, low, at, rows, dxa, dxb, dxc, dya,
        dyb, dyc;
    __m256 area_f;
    uint32_t k, n = found->count, row, column;
    for (k = 0; k < 8; k++) t[k] = triangle + 3 * (size_t)ids[k];
    a = zbufrandi_raster_fetch(vertex, t, 0);
    b = zbufrandi_raster_fetch(vertex, t, 1);
    c = zbufrandi_raster_fetch(vertex, t, 2);
    area = zbufrandi_raster_cross(_mm256_sub_epi32(b.x, a.x), _mm256_sub_epi32(b.y, a.y), _mm256_sub_epi32(c.x, a.x),
                                  _mm256_sub_epi32(c.y, a.y));
    zbufrandi_raster_swap8(_mm256_srai_epi32(area, 31), &b, &c);
    area_f = _mm256_cvtepi32_ps(_mm256_abs_epi32(area));
    zbufrandi_raster_box8(ZBUFRANDI_RASTER_MIN3(a.x, b.x, c.x), ZBUFRANDI_RASTER_MAX3(a.x, b.x, c.x), r->x0, r->x1, &i0,
                          &i1);
    zbufrandi_raster_box8(ZBUFRANDI_RASTER_MIN3(a.y, b.y, c.y), ZBUFRANDI_RASTER_MAX3(a.y, b.y, c.y), r->y0, r->y1, &j0,
                          &j1);
    px = _mm256_add_epi32(_mm256_slli_epi32(i0, ZBUFRANDI_RASTER_BITS), _mm256_set1_epi32(ZBUFRANDI_RASTER_UNIT / 2));
    py = _mm256_add_epi32(_mm256_slli_epi32(j0, ZBUFRANDI_RASTER_BITS), _mm256_set1_epi32(ZBUFRANDI_RASTER_UNIT / 2));
    bias_a = zbufrandi_raster_bias8(b.x, b.y, c.x, c.y);
    bias_b = zbufrandi_raster_bias8(c.x, c.y, a.x, a.y);
    bias_c = zbufrandi_raster_bias8(a.x, a.y, b.x, b.y);
    a.x = _mm256_sub_epi32(a.x, px);
    a.y = _mm256_sub_epi32(a.y, py);
    b.x = _mm256_sub_epi32(b.x, px);
    b.y = _mm256_sub_epi32(b.y, py);
    c.x = _mm256_sub_epi32(c.x, px);
    c.y = _mm256_sub_epi32(c.y, py);
    wa = zbufrandi_raster_cross(b.x, b.y, c.x, c.y);
    wb = zbufrandi_raster_cross(c.x, c.y, a.x, a.y);
    wc = zbufrandi_raster_cross(a.x, a.y, b.x, b.y);
    dxa = _mm256_slli_epi32(_mm256_sub_epi32(b.y, c.y), ZBUFRANDI_RASTER_BITS); /* one pixel to the right */
    dxb = _mm256_slli_epi32(_mm256_sub_epi32(c.y, a.y), ZBUFRANDI_RASTER_BITS);
    dxc = _mm256_slli_epi32(_mm256_sub_epi32(a.y, b.y), ZBUFRANDI_RASTER_BITS);
    dya = _mm256_slli_epi32(_mm256_sub_epi32(c.x, b.x), ZBUFRANDI_RASTER_BITS); /* one pixel down */
    dyb = _mm256_slli_epi32(_mm256_sub_epi32(a.x, c.x), ZBUFRANDI_RASTER_BITS);
    dyc = _mm256_slli_epi32(_mm256_sub_epi32(b.x, a.x), ZBUFRANDI_RASTER_BITS);
    low = _mm256_add_epi32(_mm256_setr_epi32(ids[0], ids[1], ids[2], ids[3], ids[4], ids[5], ids[6], ids[7]),
                           _mm256_set1_epi32((int32_t)first_number));
    low = zbufrandi_mix8(low);
    at = _mm256_add_epi32(_mm256_mullo_epi32(j0, _mm256_set1_epi32((int32_t)r->width)), i0);
    i1 = _mm256_sub_epi32(i1, i0); /* columns and rows that follow the first */
    j1 = _mm256_sub_epi32(j1, j0);
    rows = _mm256_cmpgt_epi32(_mm256_set1_epi32((int32_t)count), lane);
    for (row = 0; _mm256_movemask_ps(_mm256_castsi256_ps(rows)) != 0; row++) {
        __m256i ua = wa, ub = wb, uc = wc, columns = rows;
        for (column = 0; _mm256_movemask_ps(_mm256_castsi256_ps(columns)) != 0; column++) {
            const __m256i u = _mm256_or_si256(
                _mm256_or_si256(_mm256_add_epi32(ua, bias_a), _mm256_add_epi32(ub, bias_b)),
                _mm256_add_epi32(uc, bias_c));
            const __m256 sum = _mm256_add_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(ua), a.iz),
                                             _mm256_mul_ps(_mm256_cvtepi32_ps(ub), b.iz));
            const __m256 z = _mm256_div_ps(area_f, _mm256_add_ps(sum, _mm256_mul_ps(_mm256_cvtepi32_ps(uc), c.iz)));
            const __m256 seen = _mm256_cmp_ps(z, _mm256_set1_ps(r->far_z), _CMP_LE_OQ);
            const uint32_t hit = (uint32_t)_mm256_movemask_ps(_mm256_and_ps(
                _mm256_castsi256_ps(_mm256_andnot_si256(u, columns)), seen));
            const uint64_t lanes = _pext_u64(0x0706050403020100u, _pdep_u64(hit, 0x0101010101010101u) * 255u);
            const __m256i to = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((int64_t)lanes));
            const __m256i pixels = _mm256_add_epi32(at, _mm256_set1_epi32((int32_t)(row * r->width + column)));
            _mm256_storeu_si256((__m256i *)(void *)(found->low + n), _mm256_permutevar8x32_epi32(low, to));
            _mm256_storeu_si256((__m256i *)(void *)(found->z + n),
                                _mm256_permutevar8x32_epi32(_mm256_castps_si256(z), to));
            _mm256_storeu_si256((__m256i *)(void *)(found->at + n), _mm256_permutevar8x32_epi32(pixels, to));
            n += (uint32_t)__builtin_popcount(hit);
            columns = _mm256_and_si256(columns, _mm256_cmpgt_epi32(i1, _mm256_set1_epi32((int32_t)column)));
            ua = _mm256_add_epi32(ua, dxa);
            ub = _mm256_add_epi32(ub, dxb);
            uc = _mm256_add_epi32(uc, dxc);
        }
        rows = _mm256_and_si256(rows, _mm256_cmpgt_epi32(j1, _mm256_set1_epi32((int32_t)row)));
        wa = _mm256_add_epi32(wa, dya);
        wb = _mm256_add_epi32(wb, dyb);
        wc = _mm256_add_epi32(wc, dyc);
    }
    k = n - found->count;
    found->count = n;
    return k;
}

/* Append the numbers base + lane of the lanes of a mask; 8 bytes are written. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE uint32_t zbufrandi_raster_append(uint8_t *list, uint32_t count, uint32_t base,
                                                                        uint32_t mask) {
    const uint64_t bytes = _pdep_u64(mask, 0x0101010101010101u) * 255u;
    const uint64_t packed = _pext_u64(0x0706050403020100u + base * 0x0101010101010101u, bytes);
    memcpy(list + count, &packed, 8);
    return count + (uint32_t)__builtin_popcount(mask);
}

/* Good vertices only. Triangles are sorted into lists first: most of a fine mesh need no more than that. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_raster_cluster_avx2(const zbufrandi_raster *r,
                                                                    const zbufrandi_raster_vertex *vertex,
                                                                    const uint8_t *triangle, uint32_t triangle_count,
                                                                    int two_sided, uint32_t first_number) {
    const __m256i most = _mm256_set1_epi32(ZBUFRANDI_RASTER_SMALL), zero = _mm256_setzero_si256();
    const __m256i front = r->mirrored ? zero
                                      : _mm256_set1_epi32(-1); /* what an area is xored with to be positive in front */
    uint8_t list[3][256 + 16]; /* boxes of at most 2 x 2 pixels, other small ones, large ones */
    uint32_t in_list[3] = {0, 0, 0}, i, k, n, covered = 0;
    zbufrandi_raster_found found;
    found.count = 0;
    for (i = 0; i < triangle_count; i += 8) {
        const uint8_t *t[8];
        zbufrandi_raster_corner8 a, b, c;
        __m256i x0, x1, y0, y1, i0, i1, j0, j1, area, empty, large, not_small, drawn, two;
        uint32_t valid = triangle_count - i < 8 ? (1u << (triangle_count - i)) - 1u : 255u, in_tiny, in_large;
        for (k = 0; k < 8; k++) t[k] = triangle + 3 * (size_t)(i + k < triangle_count ? i + k : triangle_count - 1);
        a = zbufrandi_raster_fetch(vertex, t, 0);
        b = zbufrandi_raster_fetch(vertex, t, 1);
        c = zbufrandi_raster_fetch(vertex, t, 2);
        x0 = ZBUFRANDI_RASTER_MIN3(a.x, b.x, c.x);
        x1 = ZBUFRANDI_RASTER_MAX3(a.x, b.x, c.x);
        y0 = ZBUFRANDI_RASTER_MIN3(a.y, b.y, c.y);
        y1 = ZBUFRANDI_RASTER_MAX3(a.y, b.y, c.y);
        zbufrandi_raster_box8(x0, x1, r->x0, r->x1, &i0, &i1);
        zbufrandi_raster_box8(y0, y1, r->y0, r->y1, &j0, &j1);
        i1 = _mm256_sub_epi32(i1, i0);
        j1 = _mm256_sub_epi32(j1, j0);
        empty = _mm256_or_si256(i1, j1); /* sign */
        not_small = large =
            _mm256_cmpgt_epi32(_mm256_max_epi32(_mm256_sub_epi32(x1, x0), _mm256_sub_epi32(y1, y0)), most);
        area = zbufrandi_raster_cross(_mm256_sub_epi32(b.x, a.x), _mm256_sub_epi32(b.y, a.y),
                                      _mm256_sub_epi32(c.x, a.x), _mm256_sub_epi32(c.y, a.y));
        drawn = two_sided ? _mm256_xor_si256(_mm256_cmpeq_epi32(area, zero), _mm256_set1_epi32(-1))
                          : _mm256_cmpgt_epi32(_mm256_sub_epi32(_mm256_xor_si256(area, front), front), zero);
        two = _mm256_cmpgt_epi32(_mm256_set1_epi32(2), _mm256_max_epi32(i1, j1));
        if (_mm256_movemask_epi8(large) != 0) { /* areas need more bits: what certainly faces away goes now */
            const __m256 p = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_sub_epi32(b.x, a.x)),
                                           _mm256_cvtepi32_ps(_mm256_sub_epi32(c.y, a.y)));
            const __m256 q = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_sub_epi32(b.y, a.y)),
                                           _mm256_cvtepi32_ps(_mm256_sub_epi32(c.x, a.x)));
            const __m256 sign = _mm256_set1_ps(-0.0f), turned = _mm256_and_ps(sign, _mm256_castsi256_ps(front));
            const __m256 error = _mm256_mul_ps(_mm256_add_ps(_mm256_andnot_ps(sign, p), _mm256_andnot_ps(sign, q)),
                                               _mm256_set1_ps(1e-6f));
            const __m256 away = _mm256_cmp_ps(_mm256_add_ps(_mm256_xor_ps(_mm256_sub_ps(p, q), turned), error),
                                              _mm256_setzero_ps(), _CMP_LT_OQ);
            if (!two_sided) large = _mm256_andnot_si256(_mm256_castps_si256(away), large);
            empty = _mm256_or_si256(empty, two_sided ? zero : _mm256_and_si256(_mm256_castps_si256(away), not_small));
        }
        drawn = _mm256_andnot_si256(empty,
                                    _mm256_or_si256(drawn, large)); /* sign; exact areas of large ones come later */
        two = _mm256_andnot_si256(not_small, two);
        valid &= (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(drawn));
        in_tiny = valid & (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(two));
        in_large = valid & (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(large));
        in_list[0] = zbufrandi_raster_append(list[0], in_list[0], i, in_tiny);
        if (valid == in_tiny) continue;
        in_list[1] = zbufrandi_raster_append(list[1], in_list[1], i, valid & ~in_tiny & ~in_large);
        in_list[2] = zbufrandi_raster_append(list[2], in_list[2], i, in_large);
    }
    for (n = 0; n < 2; n++) {
        for (i = 0; i < in_list[n]; i += 8) {
            for (k = in_list[n]; k < i + 8; k++) list[n][k] = list[n][i];
            if (found.count + ZBUFRANDI_RASTER_FOUND_EIGHT + 8 > ZBUFRANDI_RASTER_FOUND)
                zbufrandi_raster_put_found(r, &found);
            covered += zbufrandi_raster_eight(r, vertex, triangle, list[n] + i, in_list[n] - i < 8 ? in_list[n] - i : 8,
                                              first_number, &found);
        }
    }
    zbufrandi_raster_put_found(r, &found);
    for (i = 0; i < in_list[2]; i++) {
        const uint8_t *t = triangle + 3 * (size_t)list[2][i];
        covered += zbufrandi_raster_triangle(r, &vertex[t[0]], &vertex[t[1]], &vertex[t[2]], two_sided,
                                             zbufrandi_hash32(first_number + list[2][i]));
    }
    return covered;
}
#endif

/* Draw the triangles of a cluster: triangle i has the number first_number + i.
   position  xyz of vertex_count <= 256 vertices; triangle: 3 indices each, triangle_count <= 256
   Returns the number of covered pixels (hidden ones count). Any number of threads at once unless r->exclusive. */
static ZBUFRANDI_UNUSED uint32_t zbufrandi_raster_cluster(const zbufrandi_raster *r, const float *position,
                                                          uint32_t vertex_count, const uint8_t *triangle,
                                                          uint32_t triangle_count, int two_sided,
                                                          uint32_t first_number) {
    zbufrandi_raster_vertex vertex[256];
    if (triangle_count == 0 || r->x0 >= r->x1 || r->y0 >= r->y1) return 0;
#if ZBUFRANDI_AVX2
    if (r->mask.opacity < 1.0f && r->level >= 3) { /* pixel by pixel */
        zbufrandi_raster scalar = *r;
        scalar.level = 1;
        (void)zbufrandi_raster_project(r, position, vertex_count, vertex);
        return zbufrandi_raster_cluster_scalar(&scalar, position, vertex, triangle, triangle_count, two_sided,
                                               first_number);
    }
    if (r->level >= 3) {
        if (zbufrandi_raster_project_avx2(r, position, vertex_count, vertex) == 0) {
            return zbufrandi_raster_cluster_avx2(r, vertex, triangle, triangle_count, two_sided, first_number);
        }
        return zbufrandi_raster_cluster_scalar(r, position, vertex, triangle, triangle_count, two_sided, first_number);
    }
#endif
    (void)zbufrandi_raster_project(r, position, vertex_count, vertex);
    return zbufrandi_raster_cluster_scalar(r, position, vertex, triangle, triangle_count, two_sided, first_number);
}
/* ---------------------------------------------------------------------------
   occlusion: largest depth per tile of the key buffer; boxes behind it.         // >>occlusion

   A pixel shows the smallest key of the d x d pixels whose samples reach it (colour blocks; d = 1: itself) and of its
   own in the buffer `exact`, of the same size, whose keys are not painted as blocks (NULL: there is none). So its depth
   is the smallest of those, infinite when there is none. A tile of 8 x 8 pixels holds the largest depth of its pixels,
   a cell of a coarser level the largest of 2 x 2 cells. Keys only ever get smaller: a pyramid that is out of date hides
   less, never too much. Something whose every possible pixel lies in cells nearer than its own nearest point cannot be
   seen, and changes no key that is shown.
   --------------------------------------------------------------------------- */

#define ZBUFRANDI_PYRAMID_LEVELS 13  /* tiles up to 32768 x 32768 pixels */
#define ZBUFRANDI_PYRAMID_FILTER 16  /* widest window that is looked at; a wider one covers what this one covers */
#define ZBUFRANDI_PYRAMID_SLACK 0.015625f /* pixels that a projected box grows on each side: far above any rounding */

typedef struct zbufrandi_pyramid {
    uint32_t width, height;                              /* pixels */
    uint32_t reach_lo, reach_hi; /* pixels before and after a sample that it paints: (d - 1) / 2, d / 2 */
    uint32_t levels;
    uint32_t columns[ZBUFRANDI_PYRAMID_LEVELS], rows[ZBUFRANDI_PYRAMID_LEVELS];
    float *depth[ZBUFRANDI_PYRAMID_LEVELS];              /* [rows][columns]; 8 more floats follow each level */
} zbufrandi_pyramid;

/* Fill in the sizes; returns the bytes that zbufrandi_pyramid_begin needs, 0 when they do not fit into a size_t. */
static size_t zbufrandi_pyramid_layout(zbufrandi_pyramid *p, uint32_t width, uint32_t height, uint32_t d) {
    size_t floats = 0, n;
    memset(p, 0, sizeof *p);
    if (width == 0 || height == 0 || width > 32768 || height > 32768 || d == 0) return 0;
    p->width = width;
    p->height = height;
    p->reach_lo = (d - 1) / 2;
    p->reach_hi = d / 2;
    do {
        uint32_t l = p->levels++;
        p->columns[l] = l == 0 ? (width + 7) / 8 : (p->columns[l - 1] + 1) / 2;
        p->rows[l] = l == 0 ? (height + 7) / 8 : (p->rows[l - 1] + 1) / 2;
        if (!zbufrandi_mul_size(p->columns[l], p->rows[l], &n)) return 0;
        floats += n + 8;
    } while (p->columns[p->levels - 1] > 1 || p->rows[p->levels - 1] > 1);
    return floats * sizeof(float);
}

static ZBUFRANDI_UNUSED size_t zbufrandi_pyramid_bytes(uint32_t width, uint32_t height) {
    zbufrandi_pyramid p;
    return zbufrandi_pyramid_layout(&p, width, height, 1);
}

/* An empty pyramid, which hides nothing. d: width of the colour blocks, 1 for none. */
static ZBUFRANDI_UNUSED void zbufrandi_pyramid_begin(zbufrandi_pyramid *p, void *memory, uint32_t width,
                                                     uint32_t height, uint32_t d) {
    float *f = (float *)memory;
    size_t floats = zbufrandi_pyramid_layout(p, width, height, d) / sizeof(float), i;
    uint32_t l;
    for (i = 0; i < floats; i++) f[i] = INFINITY;
    for (l = 0; l < p->levels; l++) {
        p->depth[l] = f;
        f += (size_t)p->columns[l] * p->rows[l] + 8;
    }
}

/* ---- tiles ---- */

ZBUFRANDI_INLINE float zbufrandi_pyramid_value(uint32_t bits) { /* of a tile with an empty pixel: infinite */
    float z;
    if (bits > 0x7f800000u) bits = 0x7f800000u;
    memcpy(&z, &bits, sizeof z);
    return z;
}

/* Pixels before and after a pixel that the samples which reach it stand in; the window is cut to what is looked at. */
ZBUFRANDI_INLINE void zbufrandi_pyramid_window(const zbufrandi_pyramid *p, int32_t *before, int32_t *after) {
    const uint32_t most = ZBUFRANDI_PYRAMID_FILTER - 1,
                   reach = p->reach_lo + p->reach_hi < most ? p->reach_lo + p->reach_hi : most;
    *before = (int32_t)((reach + 1) / 2);
    *after = (int32_t)(reach / 2);
}

/* Tile (column, row): straight from the definition. */
static void zbufrandi_pyramid_tile(zbufrandi_pyramid *p, const zbufrandi_keys *keys, const zbufrandi_keys *exact,
                                   uint32_t column, uint32_t row) {
    const int32_t w = (int32_t)keys->width, h = (int32_t)keys->height, x0 = (int32_t)column * 8, y0 = (int32_t)row * 8;
    uint32_t most = 0, across[8 + ZBUFRANDI_PYRAMID_FILTER - 1][8];
    int32_t before, after, x, y, k;
    zbufrandi_pyramid_window(p, &before, &after);
    memset(across, 255, sizeof across);
    for (y = -before; y < 8 + after; y++) {
        uint32_t *line = across[y + before];
        const uint64_t *key;
        if (y0 + y < 0 || y0 + y >= h) continue;
        key = keys->key + (size_t)(y0 + y) * keys->width;
        for (x = 0; x < 8; x++) {
            for (k = x0 + x - before; k <= x0 + x + after; k++) {
                uint32_t z = k >= 0 && k < w ? (uint32_t)(key[k] >> 32) : ~(uint32_t)0;
                if (z < line[x]) line[x] = z;
            }
        }
    }
    for (y = 0; y < 8 && y0 + y < h; y++) {
        for (x = 0; x < 8 && x0 + x < w; x++) {
            uint32_t z = across[y][x];
            for (k = 1; k <= before + after; k++) z = across[y + k][x] < z ? across[y + k][x] : z;
            if (exact != NULL) {
                uint32_t e = (uint32_t)(exact->key[(size_t)(y0 + y) * exact->width + (size_t)(x0 + x)] >> 32);
                z = e < z ? e : z;
            }
            if (z > most) most = z;
        }
    }
    p->depth[0][(size_t)row * p->columns[0] + column] = zbufrandi_pyramid_value(most);
}

#if ZBUFRANDI_AVX2
/* Depths of 8 pixels, left to right. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256i zbufrandi_pyramid_load(const uint64_t *key) {
    const __m256 a = _mm256_castsi256_ps(_mm256_loadu_si256((const __m256i *)(const void *)key));
    const __m256 b = _mm256_castsi256_ps(_mm256_loadu_si256((const __m256i *)(const void *)(key + 4)));
    return _mm256_permute4x64_epi64(_mm256_castps_si256(_mm256_shuffle_ps(a, b, _MM_SHUFFLE(3, 1, 3, 1))),
                                    _MM_SHUFFLE(3, 1, 2, 0));
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE float zbufrandi_pyramid_most(__m256i v) { /* largest lane */
    __m128i m = _mm_max_epu32(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1));
    m = _mm_max_epu32(m, _mm_shuffle_epi32(m, 0x4e));
    m = _mm_max_epu32(m, _mm_shuffle_epi32(m, 0xb1));
    return zbufrandi_pyramid_value((uint32_t)_mm_cvtsi128_si32(m));
}

/* The same for a tile whose pixels and windows lie within the picture. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_pyramid_tile_avx2(zbufrandi_pyramid *p, const zbufrandi_keys *keys,
                                                              const zbufrandi_keys *exact, uint32_t column,
                                                              uint32_t row, int32_t before, int32_t after) {
    const uint64_t *key = keys->key + (size_t)row * 8 * keys->width + (size_t)column * 8;
    const uint64_t *at = exact == NULL ? NULL : exact->key + (key - keys->key);
    __m256i across[8 + ZBUFRANDI_PYRAMID_FILTER - 1], most = _mm256_setzero_si256();
    int32_t y, k;
    if (before + after == 0) {
        for (y = 0; y < 8; y++) {
            __m256i z = zbufrandi_pyramid_load(key + (size_t)y * keys->width);
            if (at != NULL) z = _mm256_min_epu32(z, zbufrandi_pyramid_load(at + (size_t)y * keys->width));
            most = _mm256_max_epu32(most, z);
        }
    } else {
        y = 0;
        do {
            const uint64_t *line = y < before ? key - (size_t)(before - y) * keys->width
                                              : key + (size_t)(y - before) * keys->width;
            __m256i z = zbufrandi_pyramid_load(line);
            for (k = 1; k <= before; k++) z = _mm256_min_epu32(z, zbufrandi_pyramid_load(line - k));
            for (k = 1; k <= after; k++) z = _mm256_min_epu32(z, zbufrandi_pyramid_load(line + k));
            across[y] = z;
        } while (++y < 8 + before + after);
        for (y = 0; y < 8; y++) {
            __m256i z = across[y];
            for (k = 1; k <= before + after; k++) z = _mm256_min_epu32(z, across[y + k]);
            if (at != NULL) z = _mm256_min_epu32(z, zbufrandi_pyramid_load(at + (size_t)y * keys->width));
            most = _mm256_max_epu32(most, z);
        }
    }
    p->depth[0][(size_t)row * p->columns[0] + column] = zbufrandi_pyramid_most(most);
}
#endif

/* Level 0, tiles column0 <= column < column1 of the rows row0 <= row < row1. Different rows may be done by different
   threads; zbufrandi_pyramid_reduce follows. level 0: the best here. */
static ZBUFRANDI_UNUSED void zbufrandi_pyramid_tiles(zbufrandi_pyramid *p, const zbufrandi_keys *keys,
                                                     const zbufrandi_keys *exact, uint32_t column0, uint32_t column1,
                                                     uint32_t row0, uint32_t row1, int level) {
    uint32_t column, row;
#if ZBUFRANDI_AVX2
    int32_t before, after;
    zbufrandi_pyramid_window(p, &before, &after);
    if (level == 0) level = zbufrandi_cpu_level();
#endif
    for (row = row0; row < row1; row++) {
        for (column = column0; column < column1; column++) {
#if ZBUFRANDI_AVX2
            if (level >= 3 && 8 * column >= (uint32_t)before && 8 * row >= (uint32_t)before &&
                8 * column + 8 + (uint32_t)after <= p->width && 8 * row + 8 + (uint32_t)after <= p->height) {
                zbufrandi_pyramid_tile_avx2(p, keys, exact, column, row, before, after);
                continue;
            }
#endif
            zbufrandi_pyramid_tile(p, keys, exact, column, row);
        }
    }
    (void)level;
}

/* Coarser levels above those tiles. */
static ZBUFRANDI_UNUSED void zbufrandi_pyramid_reduce(zbufrandi_pyramid *p, uint32_t column0, uint32_t column1,
                                                      uint32_t row0, uint32_t row1) {
    uint32_t l, x, y;
    if (column0 >= column1 || row0 >= row1) return;
    column1--;
    row1--;
    for (l = 1; l < p->levels; l++) {
        column0 /= 2;
        column1 /= 2;
        row0 /= 2;
        row1 /= 2;
        for (y = row0; y <= row1; y++) {
            const float *a = p->depth[l - 1] + (size_t)(2 * y) * p->columns[l - 1];
            const float *b = 2 * y + 1 < p->rows[l - 1] ? a + p->columns[l - 1] : a;
            float *out = p->depth[l] + (size_t)y * p->columns[l];
            for (x = column0; x <= column1; x++) {
                const uint32_t i = 2 * x, j = i + 1 < p->columns[l - 1] ? i + 1 : i;
                const float m = a[i] > a[j] ? a[i] : a[j], n = b[i] > b[j] ? b[i] : b[j];
                out[x] = m > n ? m : n;
            }
        }
    }
}

/* Everything that keys within the pixels x0 <= x < x1, y0 <= y < y1 may have changed. Cost: 0.15 ns per pixel with
   d = 1, 0.5 with d = 2 (AVX2). */
static ZBUFRANDI_UNUSED void zbufrandi_pyramid_refresh(zbufrandi_pyramid *p, const zbufrandi_keys *keys,
                                                       const zbufrandi_keys *exact, uint32_t x0, uint32_t y0,
                                                       uint32_t x1, uint32_t y1, int level) {
    if (x1 > p->width) x1 = p->width;
    if (y1 > p->height) y1 = p->height;
    if (x0 >= x1 || y0 >= y1) return;
    x0 = x0 > p->reach_lo ? (x0 - p->reach_lo) / 8 : 0;
    y0 = y0 > p->reach_lo ? (y0 - p->reach_lo) / 8 : 0;
    x1 = (x1 - 1 + p->reach_hi) / 8 + 1;
    y1 = (y1 - 1 + p->reach_hi) / 8 + 1;
    if (x1 > p->columns[0]) x1 = p->columns[0];
    if (y1 > p->rows[0]) y1 = p->rows[0];
    zbufrandi_pyramid_tiles(p, keys, exact, x0, x1, y0, y1, level);
    zbufrandi_pyramid_reduce(p, x0, x1, y0, y1);
}

typedef struct zbufrandi_pyramid_job {
    zbufrandi_pyramid *p;
    const zbufrandi_keys *keys, *exact;
    int level;
} zbufrandi_pyramid_job;

static void zbufrandi_pyramid_task(void *ctx, uint32_t task) {
    const zbufrandi_pyramid_job *j = (const zbufrandi_pyramid_job *)ctx;
    uint32_t row0 = 8 * task, row1 = row0 + 8 < j->p->rows[0] ? row0 + 8 : j->p->rows[0];
    zbufrandi_pyramid_tiles(j->p, j->keys, j->exact, 0, j->p->columns[0], row0, row1, j->level);
}

/* All of it, by the threads of env. */
static ZBUFRANDI_UNUSED void zbufrandi_pyramid_refresh_all(const zbufrand_env *env, zbufrandi_pyramid *p,
                                                           const zbufrandi_keys *keys, const zbufrandi_keys *exact,
                                                           int level) {
    zbufrandi_pyramid_job j;
    j.p = p;
    j.keys = keys;
    j.exact = exact;
    j.level = level == 0 ? zbufrandi_cpu_level() : level;
    zbufrandi_parallel_for(env, zbufrandi_pyramid_task, &j, (p->rows[0] + 7) / 8);
    zbufrandi_pyramid_reduce(p, 0, p->columns[0], 0, p->rows[0]);
}

/* ---- boxes ---- */

typedef struct zbufrandi_pyramid_cells { /* of level l: x0 <= x <= x1, y0 <= y <= y1 */
    uint32_t x0, y0, x1, y1, l;
} zbufrandi_pyramid_cells;

/* The cells that samples at the picture positions rect[0] <= x <= rect[2], rect[1] <= y <= rect[3] paint, of the finest
   level at which that is 8 x 8 or fewer. 0: *hidden says whether they are certainly not seen, as they paint no pixel of
   the picture; NaN is never hidden. */
ZBUFRANDI_INLINE int zbufrandi_pyramid_find(const zbufrandi_pyramid *p, const float rect[4], zbufrandi_pyramid_cells *c,
                                            int *hidden) {
    const float w = (float)p->width, h = (float)p->height, lo = (float)p->reach_lo, hi = (float)p->reach_hi;
    uint32_t x0, y0, x1, y1, l = 0;
    *hidden = rect[2] < -hi || rect[3] < -hi || rect[0] >= w + lo || rect[1] >= h + lo;
    if (*hidden || !(rect[0] <= rect[2] && rect[1] <= rect[3])) return 0;
    x0 = rect[0] - lo > 0.0f ? (uint32_t)(rect[0] - lo) / 8 : 0; /* below the width: converts */
    y0 = rect[1] - lo > 0.0f ? (uint32_t)(rect[1] - lo) / 8 : 0;
    x1 = rect[2] + hi < w - 1.0f ? (uint32_t)(rect[2] + hi > 0.0f ? rect[2] + hi : 0.0f) / 8 : (p->width - 1) / 8;
    y1 = rect[3] + hi < h - 1.0f ? (uint32_t)(rect[3] + hi > 0.0f ? rect[3] + hi : 0.0f) / 8 : (p->height - 1) / 8;
    if (x0 > x1) x0 = x1;
    if (y0 > y1) y0 = y1;
    while ((((x1 >> l) - (x0 >> l)) | ((y1 >> l) - (y0 >> l))) > 7) l++;
    c->x0 = x0 >> l;
    c->y0 = y0 >> l;
    c->x1 = x1 >> l;
    c->y1 = y1 >> l;
    c->l = l;
    return 1;
}

/* Whether those samples are certainly not seen if they are no nearer than z_min. */
static ZBUFRANDI_UNUSED int zbufrandi_pyramid_hidden(const zbufrandi_pyramid *p, const float rect[4], float z_min) {
    zbufrandi_pyramid_cells c;
    uint32_t x, y;
    int hidden;
    if (!zbufrandi_pyramid_find(p, rect, &c, &hidden)) return hidden;
    for (y = c.y0; y <= c.y1; y++) {
        const float *row = p->depth[c.l] + (size_t)y * p->columns[c.l];
        for (x = c.x0; x <= c.x1; x++) {
            if (!(row[x] < z_min)) return 0;
        }
    }
    return 1;
}

#if ZBUFRANDI_AVX2
/* The same answer, a row of cells at a time. */
ZBUFRANDI_TARGET_AVX2 static int zbufrandi_pyramid_hidden_avx2(const zbufrandi_pyramid *p, const float rect[4],
                                                               float z_min) {
    zbufrandi_pyramid_cells c;
    uint32_t y, cells;
    int hidden;
    if (!zbufrandi_pyramid_find(p, rect, &c, &hidden)) return hidden;
    cells = (1u << (c.x1 - c.x0 + 1)) - 1u;
    for (y = c.y0; y <= c.y1; y++) {
        const __m256 row = _mm256_loadu_ps(p->depth[c.l] + (size_t)y * p->columns[c.l] + c.x0);
        if (((uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(row, _mm256_set1_ps(z_min), _CMP_LT_OQ)) & cells) != cells)
            return 0;
    }
    return 1;
}
#endif

/* ---------------------------------------------------------------------------
   rays: closest hit of a ray through structures and their instances.            // >>rays

   Used where the samples left a hole or show the wrong surface. A structure is entered with the ray in its own
   coordinates; the direction is not normalised there, so that the parameter t is the same on all levels (for a pixel's
   ray: the depth).
   Within a structure floats do: the origin is moved along the ray to shortly before the box of the structure, and what
   rounding it loses is kept in a second float, so neither a far camera nor a large structure costs digits.
   Triangles: S. Woop, C. Benthin, I. Wald, Watertight Ray/Triangle Intersection, JCGT 2013, without the recomputation
   in double: rounding may turn the sign of an edge function into zero, never into its opposite, and zero counts as
   inside. So nothing slips between triangles that share vertices; an edge may be hit twice.
   Boxes are tested with margins above the rounding errors. A cluster is too much to test whole: its triangles come in
   groups of eight, neighbours on the curve, whose boxes are kept in bytes relative to the cluster's (zbufrandi_rays).
   One ray is a chain of dependent steps, 3 to 4 M rays/s; eight neighbours at once get twice that. Keeping triangles
   ready-made for rays would double it again, for four times the memory.
   Faces seen from behind are invisible, except those of two-sided clusters. Mirrors do not change that: inside a
   structure the ray is as mirrored as the surface is.
   --------------------------------------------------------------------------- */

enum { ZBUFRANDI_RAY_STACK = 64, ZBUFRANDI_RAY_GROUPS = 16 };

/* Boxes of the groups of a cluster, in steps from `zero`: 250 steps are the box of the cluster, which begins at 2. A
   group that is not there has lo 255 and hi 0. All that a ray that misses needs is in these 128 bytes: what is known of
   the cluster besides stands in the lowest 8 bits of step, which counts as a number with them. */
typedef struct zbufrandi_ray_box {
    uint8_t lo[3][16], hi[3][16];
    float zero[3], step[3];                /* step[0]: triangle_count, step[1]: flags, step[2]: vertex_count - 1 */
    uint32_t first_vertex, first_triangle; /* of the cluster */
} zbufrandi_ray_box;

typedef struct zbufrandi_rays {
    const zbufrandi_structure *structure;
    uint32_t structure_count;
    int level;               /* 1 scalar, 3 AVX2 */
    zbufrandi_ray_box **box; /* per structure: [cluster_count] */
    zbufrandi_ray_box *boxes;
} zbufrandi_rays;

typedef struct zbufrandi_ray { /* in coordinates of structure 0: world - origin */
    double o[3], d[3];
    double t_min, t_max;       /* 0 <= t_min <= t <= t_max; t_max may be INFINITY */
} zbufrandi_ray;

typedef struct zbufrandi_ray_hit {
    double t;
    float u, v;                /* weights of corners 1 and 2; corner 0 has 1 - u - v */
    uint32_t structure, cluster;
    uint32_t triangle;         /* of the structure: cluster.first_triangle + its number there */
    uint32_t back;             /* 1: seen from behind */
    uint32_t levels;           /* of instances */
    uint32_t path[ZBUFRANDI_MAX_LEVELS]; /* path[k]: index of the instance within the structure of level k */
} zbufrandi_ray_hit;

/* ---- boxes of groups ---- */

typedef struct zbufrandi_rays_job {
    const zbufrandi_structure *s;
    zbufrandi_ray_box *box;
} zbufrandi_rays_job;

enum { ZBUFRANDI_RAYS_TASK = 256 }; /* clusters */

ZBUFRANDI_INLINE float zbufrandi_ray_tagged(float v, uint32_t tag) {
    uint32_t bits;
    memcpy(&bits, &v, sizeof bits);
    bits = (bits & ~255u) | tag;
    memcpy(&v, &bits, sizeof v);
    return v;
}
ZBUFRANDI_INLINE uint32_t zbufrandi_ray_tag(float v) {
    uint32_t bits;
    memcpy(&bits, &v, sizeof bits);
    return bits & 255u;
}
ZBUFRANDI_INLINE uint8_t zbufrandi_rays_quantum(float v) { return (uint8_t)(v < 0.0f ? 0 : v > 255.0f ? 255 : (int)v); }

static void zbufrandi_rays_task(void *ctx, uint32_t task) {
    const zbufrandi_rays_job *j = (const zbufrandi_rays_job *)ctx;
    const zbufrandi_structure *s = j->s;
    uint32_t c = task * ZBUFRANDI_RAYS_TASK, end = c + ZBUFRANDI_RAYS_TASK, g, t, k, a;
    if (end > s->cluster_count) end = s->cluster_count;
    for (; c < end; c++) {
        const zbufrandi_cluster *cluster = &s->cluster[c];
        const float *position = s->position + 3 * (size_t)cluster->first_vertex;
        zbufrandi_ray_box *out = &j->box[c];
        uint32_t tag[3];
        tag[0] = cluster->triangle_count;
        tag[1] = cluster->flags;
        tag[2] = (uint32_t)cluster->vertex_count - 1;
        out->first_vertex = cluster->first_vertex;
        out->first_triangle = cluster->first_triangle;
        for (a = 0; a < 3; a++) {
            const float e = (cluster->box_hi[a] - cluster->box_lo[a]) * (1.0f / 250.0f);
            out->step[a] = zbufrandi_ray_tagged(e > 1e-30f ? e : 1e-30f, tag[a]);
            out->zero[a] = cluster->box_lo[a] - 2.0f * out->step[a];
        }
        for (g = 0; g < ZBUFRANDI_RAY_GROUPS; g++) {
            float lo[3], hi[3];
            for (a = 0; a < 3; a++) {
                out->lo[a][g] = 255;
                out->hi[a][g] = 0;
                lo[a] = INFINITY;
                hi[a] = -INFINITY;
            }
            for (t = 8 * g; t < 8 * g + 8 && t < cluster->triangle_count; t++) {
                const uint8_t *index = s->triangle + 3 * ((size_t)cluster->first_triangle + t);
                for (k = 0; k < 3; k++) {
                    const float *p = position + 3 * (size_t)index[k];
                    for (a = 0; a < 3; a++) {
                        lo[a] = p[a] < lo[a] ? p[a] : lo[a];
                        hi[a] = p[a] > hi[a] ? p[a] : hi[a];
                    }
                }
            }
            if (t == 8 * g) continue;
            for (a = 0; a < 3; a++) { /* a 16th of a step and more to spare */
                const float scale = cluster->box_hi[a] > cluster->box_lo[a] ? 1.0f / out->step[a] : 0.0f;
                out->lo[a][g] = zbufrandi_rays_quantum((lo[a] - cluster->box_lo[a]) * scale + 2.0f - 0.0625f);
                out->hi[a][g] = zbufrandi_rays_quantum((hi[a] - cluster->box_lo[a]) * scale + 2.0f + 1.0625f);
            }
        }
    }
}

static ZBUFRANDI_UNUSED void zbufrandi_rays_end(zbufrandi_rays *r, zbufrandi_mem *mem) {
    zbufrandi_free(mem, r->box);
    zbufrandi_free(mem, r->boxes);
    memset(r, 0, sizeof *r);
}

/* Make ready for rays through `count` structures, which have to stay as they are. level 0: the best here.
   Cost: 10 ns and 1 byte per triangle. 0: no memory. */
static ZBUFRANDI_UNUSED int zbufrandi_rays_begin(zbufrandi_rays *r, zbufrandi_mem *mem, const zbufrand_env *env,
                                                 const zbufrandi_structure *structure, uint32_t count, int level) {
    size_t clusters = 0;
    uint32_t i;
    memset(r, 0, sizeof *r);
    if (level == 0) level = zbufrandi_cpu_level();
    r->level = level >= 3 && ZBUFRANDI_AVX2 ? 3 : 1;
    r->structure = structure;
    r->structure_count = count;
    for (i = 0; i < count; i++) {
        if (clusters > (size_t)-1 - structure[i].cluster_count) return 0;
        clusters += structure[i].cluster_count;
    }
    r->box = (zbufrandi_ray_box **)zbufrandi_alloc_array(mem, (size_t)count + 1, sizeof *r->box);
    r->boxes = (zbufrandi_ray_box *)zbufrandi_alloc_array(mem, clusters + 1, sizeof *r->boxes);
    if (r->box == NULL || r->boxes == NULL) {
        zbufrandi_rays_end(r, mem);
        return 0;
    }
    for (i = 0, clusters = 0; i < count; i++) {
        zbufrandi_rays_job j;
        j.s = &structure[i];
        j.box = r->box[i] = r->boxes + clusters;
        zbufrandi_parallel_for(env, zbufrandi_rays_task, &j,
                               (structure[i].cluster_count + ZBUFRANDI_RAYS_TASK - 1) / ZBUFRANDI_RAYS_TASK);
        clusters += structure[i].cluster_count;
    }
    return 1;
}

/* ---- a ray within a structure ---- */

#define ZBUFRANDI_RAY_EIGHT(v) ((const double (*)[3])(v)) /* C wants to be told that the rows become const */
#define ZBUFRANDI_RAY_HUGE 7.9228163e28f /* 2^96 for the reciprocal of zero: finite, so that 0 times it is 0 */
#define ZBUFRANDI_RAY_MORE 1.000002f     /* margins of the comparisons of boxes */
#define ZBUFRANDI_RAY_LESS 0.999998f

typedef struct zbufrandi_ray_local {
    float o[3], rest[3];     /* origin = o + rest */
    float before[3], after[3]; /* rest for the near and the far planes of boxes */
    float inverse[3];        /* of the direction */
    uint32_t negative[3];    /* direction < 0 */
    uint32_t kx, ky, kz;     /* kz: longest component; looking along it, kx, ky, kz are right-handed */
    float sx, sy, sz;        /* shear: x - sx z, y - sy z */
    float t_min, t_max;      /* relative to the moved origin; t_max shrinks with every hit */
    double shift;            /* t of the moved origin */
} zbufrandi_ray_local;

typedef struct zbufrandi_ray_walk { /* one ray through all levels */
    const zbufrandi_rays *r;
    double t_min;
    double best;             /* closest hit so far, or t_max */
    const zbufrandi_veil *veil; /* NULL: all is opaque */
    uint32_t pixel;          /* for that */
    uint32_t levels;         /* where the walk is */
    uint32_t path[ZBUFRANDI_MAX_LEVELS];
    zbufrandi_ray_hit *hit;
} zbufrandi_ray_walk;

typedef struct zbufrandi_ray_eight { /* hits among eight triangles */
    float t[8], u[8], v[8];
    uint32_t mask, back;
} zbufrandi_ray_eight;

/* Upper bound of best in the parameter of the moved origin. */
ZBUFRANDI_INLINE float zbufrandi_ray_bound(double best, double shift) {
    double t = best - shift;
    if (!(t < 3e38)) return 3e38f;
    return (float)(t + zbufrandi_abs(t) * 1e-7);
}

/* Does the ray miss the ball around a structure between t_min and best? Of rays that meet the box of a round thing
   every second one misses the ball, and most rays are cast along outlines. Far away rounding makes it larger. */
static int zbufrandi_ray_misses(const zbufrandi_structure *s, const double o[3], const double d[3], double t_min,
                                double best) {
    double q[3], length = 0.0, along = 0.0, size = 0.0, r = 0.0, t;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        q[a] = 0.5 * ((double)s->box_lo[a] + (double)s->box_hi[a]) - o[a];
        length += d[a] * d[a];
        along += q[a] * d[a];
    }
    t = along / length;
    t = t > t_min ? t : t_min;
    t = t < best ? t : best;
    for (a = 0; a < 3; a++) {
        const double e = q[a] - d[a] * t;
        r += e * e;
        size += zbufrandi_abs(q[a]) + zbufrandi_abs(o[a]) + zbufrandi_abs(d[a] * t);
    }
    size = (double)s->radius + 1e-12 * size;
    return r > size * size; /* not of NaN */
}

/* 0: the ray does not touch the box of the structure between t_min and best. */
static int zbufrandi_ray_enter(zbufrandi_ray_local *l, const zbufrandi_structure *s, const double o[3],
                               const double d[3], double t_min, double best) {
    double enter = t_min, leave = best, most = 0.0;
    uint32_t a, inside = 1;
    if (zbufrandi_ray_misses(s, o, d, t_min, best)) return 0;
    l->kz = 0;
    for (a = 0; a < 3; a++) {
        const double lo = (double)s->box_lo[a], hi = (double)s->box_hi[a];
        if (!(zbufrandi_abs(d[a]) <= 1e30 && zbufrandi_abs(o[a]) <= 1e30 && lo <= hi)) return 0;
        if (zbufrandi_abs(d[a]) > most) {
            most = zbufrandi_abs(d[a]);
            l->kz = a;
        }
        inside &= o[a] >= lo && o[a] <= hi;
    }
    for (a = 0; a < 3 && !inside; a++) {
        const double lo = (double)s->box_lo[a], hi = (double)s->box_hi[a];
        if (d[a] != 0.0) {
            const double k = 1.0 / d[a], t0 = (lo - o[a]) * k, t1 = (hi - o[a]) * k;
            enter = zbufrandi_max(enter, (t0 < t1 ? t0 : t1) * (t0 > 0 && t1 > 0 ? 1.0 - 1e-12 : 1.0));
            leave = zbufrandi_min(leave, (t0 > t1 ? t0 : t1) * (1.0 + 1e-12));
        } else if (!(o[a] >= lo && o[a] <= hi)) {
            return 0;
        }
    }
    if (!(enter <= leave) || !(most > 1e-30)) return 0;
    l->shift = t_min;
    if (enter > t_min) {
        double leave_box = (double)INFINITY; /* how far through the box, whatever was hit before */
        for (a = 0; a < 3; a++) {
            if (d[a] != 0.0)
                leave_box = zbufrandi_min(leave_box,
                                          ((d[a] > 0 ? (double)s->box_hi[a] : (double)s->box_lo[a]) - o[a]) / d[a]);
        }
        l->shift = zbufrandi_max(t_min, enter - 0.01 * zbufrandi_max(leave_box - enter, 0.0) - 1e-14 * enter);
    }
    l->kx = l->kz == 2 ? 0 : l->kz + 1;
    l->ky = l->kx == 2 ? 0 : l->kx + 1;
    if (d[l->kz] < 0) {
        a = l->kx;
        l->kx = l->ky;
        l->ky = a;
    }
    for (a = 0; a < 3; a++) {
        const double at = o[a] + d[a] * l->shift;
        const float df = (float)d[a];
        l->o[a] = (float)at;
        l->rest[a] = l->before[a] = l->after[a] = (float)(at - (double)l->o[a]);
        l->negative[a] = df < 0.0f;
        if (zbufrandi_absf(df) >= 1.0f / ZBUFRANDI_RAY_HUGE) {
            l->inverse[a] = 1.0f / df;
        } else { /* at right angles: inside all the way, also if it runs along a face of the box */
            const float pad = 1e-7f * (zbufrandi_absf(l->o[a]) + (s->box_hi[a] - s->box_lo[a]));
            l->inverse[a] = ZBUFRANDI_RAY_HUGE;
            l->negative[a] = 0;
            l->before[a] += pad;
            l->after[a] -= pad;
        }
    }
    l->sx = (float)(d[l->kx] / d[l->kz]);
    l->sy = (float)(d[l->ky] / d[l->kz]);
    l->sz = (float)(1.0 / d[l->kz]);
    l->t_min = (float)(t_min - l->shift);
    l->t_max = zbufrandi_ray_bound(best, l->shift);
    return 1;
}

/* ---- the three tests, scalar ---- */

/* Children whose boxes the ray meets; t: where it enters them. */
static uint32_t zbufrandi_ray_node(const zbufrandi_ray_local *l, const zbufrandi_node8 *node, float t[8]) {
    uint32_t mask = 0, c, a;
    for (c = 0; c < 8; c++) {
        float enter = l->t_min, leave = l->t_max;
        for (a = 0; a < 3; a++) {
            const float n = ((l->negative[a] ? node->hi[a][c] : node->lo[a][c]) - l->o[a] - l->before[a]) *
                            l->inverse[a];
            const float f = ((l->negative[a] ? node->lo[a][c] : node->hi[a][c]) - l->o[a] - l->after[a]) *
                            l->inverse[a];
            enter = n > enter ? n : enter;
            leave = f < leave ? f : leave;
        }
        t[c] = enter * ZBUFRANDI_RAY_LESS;
        if (t[c] <= leave * ZBUFRANDI_RAY_MORE) mask |= 1u << c;
    }
    return mask & ((1u << node->count) - 1u);
}

/* Groups of a cluster whose boxes the ray meets. */
static uint32_t zbufrandi_ray_groups(const zbufrandi_ray_local *l, const zbufrandi_ray_box *box, float t[16]) {
    uint32_t mask = 0, g, a;
    for (g = 0; g < ZBUFRANDI_RAY_GROUPS; g++) {
        float enter = l->t_min, leave = l->t_max;
        for (a = 0; a < 3; a++) {
            const float zero = box->zero[a] - l->o[a], scale = box->step[a] * l->inverse[a];
            const float n = (zero - l->before[a]) * l->inverse[a] +
                            (float)(l->negative[a] ? box->hi : box->lo)[a][g] * scale;
            const float f = (zero - l->after[a]) * l->inverse[a] +
                            (float)(l->negative[a] ? box->lo : box->hi)[a][g] * scale;
            enter = n > enter ? n : enter;
            leave = f < leave ? f : leave;
        }
        t[g] = enter * ZBUFRANDI_RAY_LESS;
        if (t[g] <= leave * ZBUFRANDI_RAY_MORE && box->lo[0][g] <= box->hi[0][g]) mask |= 1u << g;
    }
    return mask;
}

/* Triangles first .. first+7 of a cluster. */
static void zbufrandi_ray_triangles(const zbufrandi_ray_local *l, const float *position, const uint8_t *index,
                                    uint32_t count, int two_sided, zbufrandi_ray_eight *out) {
    uint32_t i, k, a;
    out->mask = out->back = 0;
    for (i = 0; i < count; i++) {
        float x[3], y[3], z[3], u, v, w, det, t;
        for (k = 0; k < 3; k++) {
            const float *p = position + 3 * (size_t)index[3 * i + k];
            float q[3];
            for (a = 0; a < 3; a++) q[a] = p[a] - l->o[a] - l->rest[a];
            x[k] = q[l->kx] - l->sx * q[l->kz];
            y[k] = q[l->ky] - l->sy * q[l->kz];
            z[k] = l->sz * q[l->kz];
        }
        u = x[2] * y[1] - y[2] * x[1];
        v = x[0] * y[2] - y[0] * x[2];
        w = x[1] * y[0] - y[1] * x[0];
        det = u + v + w;
        if (!(u >= 0 && v >= 0 && w >= 0 && det > 0) && !(two_sided && u <= 0 && v <= 0 && w <= 0 && det < 0)) continue;
        t = (u * z[0] + v * z[1] + w * z[2]) / det;
        out->t[i] = t;
        out->u[i] = v / det;
        out->v[i] = w / det;
        if (t >= l->t_min && t <= l->t_max) {
            out->mask |= 1u << i;
            if (det < 0) out->back |= 1u << i;
        }
    }
}

#if ZBUFRANDI_AVX2
/* ---- and eight at a time, the same operations ---- */

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE uint32_t zbufrandi_ray_node_avx2(const zbufrandi_ray_local *l,
                                                                        const zbufrandi_node8 *node, __m256 *t) {
    __m256 enter = _mm256_set1_ps(l->t_min), leave = _mm256_set1_ps(l->t_max);
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const __m256 o = _mm256_set1_ps(l->o[a]), inverse = _mm256_set1_ps(l->inverse[a]);
        const __m256 before = _mm256_set1_ps(l->before[a]), after = _mm256_set1_ps(l->after[a]);
        const __m256 first = _mm256_loadu_ps(l->negative[a] ? node->hi[a] : node->lo[a]);
        const __m256 last = _mm256_loadu_ps(l->negative[a] ? node->lo[a] : node->hi[a]);
        enter = _mm256_max_ps(_mm256_mul_ps(_mm256_sub_ps(_mm256_sub_ps(first, o), before), inverse), enter);
        leave = _mm256_min_ps(_mm256_mul_ps(_mm256_sub_ps(_mm256_sub_ps(last, o), after), inverse), leave);
    }
    *t = _mm256_mul_ps(enter, _mm256_set1_ps(ZBUFRANDI_RAY_LESS));
    leave = _mm256_mul_ps(leave, _mm256_set1_ps(ZBUFRANDI_RAY_MORE));
    return (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(*t, leave, _CMP_LE_OQ)) & ((1u << node->count) - 1u);
}

/* Bit g: group g is there. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE uint32_t zbufrandi_ray_there(const zbufrandi_ray_box *box) {
    const __m128i lo = _mm_loadu_si128((const __m128i *)(const void *)box->lo[0]),
                  hi = _mm_loadu_si128((const __m128i *)(const void *)box->hi[0]);
    return (uint32_t)_mm_movemask_epi8(_mm_cmpeq_epi8(_mm_max_epu8(lo, hi), hi));
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_ray_bytes(const uint8_t *p) {
    return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)(const void *)p)));
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE uint32_t zbufrandi_ray_groups_avx2(const zbufrandi_ray_local *l,
                                                                          const zbufrandi_ray_box *box, float t[16]) {
    __m256 enter[2], leave[2];
    uint32_t a, h;
    enter[0] = enter[1] = _mm256_set1_ps(l->t_min);
    leave[0] = leave[1] = _mm256_set1_ps(l->t_max);
    for (a = 0; a < 3; a++) {
        const float zero = box->zero[a] - l->o[a];
        const __m256 scale = _mm256_set1_ps(box->step[a] * l->inverse[a]);
        const __m256 near0 = _mm256_set1_ps((zero - l->before[a]) * l->inverse[a]),
                     far0 = _mm256_set1_ps((zero - l->after[a]) * l->inverse[a]);
        const uint8_t *first = (l->negative[a] ? box->hi : box->lo)[a], *last = (l->negative[a] ? box->lo : box->hi)[a];
        for (h = 0; h < 2; h++) {
            enter[h] = _mm256_max_ps(_mm256_add_ps(near0, _mm256_mul_ps(zbufrandi_ray_bytes(first + 8 * h), scale)),
                                     enter[h]);
            leave[h] = _mm256_min_ps(_mm256_add_ps(far0, _mm256_mul_ps(zbufrandi_ray_bytes(last + 8 * h), scale)),
                                     leave[h]);
        }
    }
    for (h = 0; h < 2; h++) {
        enter[h] = _mm256_mul_ps(enter[h], _mm256_set1_ps(ZBUFRANDI_RAY_LESS));
        leave[h] = _mm256_mul_ps(leave[h], _mm256_set1_ps(ZBUFRANDI_RAY_MORE));
    }
    _mm256_storeu_ps(t, enter[0]);
    _mm256_storeu_ps(t + 8, enter[1]);
    return ((uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(enter[0], leave[0], _CMP_LE_OQ)) |
            (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(enter[1], leave[1], _CMP_LE_OQ)) << 8) &
           zbufrandi_ray_there(box);
}

/* Corner k of eight triangles, relative to the origin of the ray; 16 bytes after the last vertex may be read. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_ray_corner(const zbufrandi_ray_local *l, const float *position,
                                                                 const uint8_t index[24], uint32_t k, __m256 out[3]) {
#define ZBUFRANDI_RAY_LOAD(i) _mm_loadu_ps(position + 3 * (size_t)index[3 * (i) + k])
#define ZBUFRANDI_RAY_PAIR(i)                                                                                          \
    _mm256_insertf128_ps(_mm256_castps128_ps256(ZBUFRANDI_RAY_LOAD(i)), ZBUFRANDI_RAY_LOAD((i) + 4), 1)
    const __m256 r0 = ZBUFRANDI_RAY_PAIR(0), r1 = ZBUFRANDI_RAY_PAIR(1), r2 = ZBUFRANDI_RAY_PAIR(2),
                 r3 = ZBUFRANDI_RAY_PAIR(3);
    const __m256 xy01 = _mm256_unpacklo_ps(r0, r1), xy23 = _mm256_unpacklo_ps(r2, r3);
    const __m256 z01 = _mm256_unpackhi_ps(r0, r1), z23 = _mm256_unpackhi_ps(r2, r3);
    const __m256 x = _mm256_shuffle_ps(xy01, xy23, 0x44), y = _mm256_shuffle_ps(xy01, xy23, 0xee),
                 z = _mm256_shuffle_ps(z01, z23, 0x44);
    out[0] = _mm256_sub_ps(_mm256_sub_ps(x, _mm256_set1_ps(l->o[0])), _mm256_set1_ps(l->rest[0]));
    out[1] = _mm256_sub_ps(_mm256_sub_ps(y, _mm256_set1_ps(l->o[1])), _mm256_set1_ps(l->rest[1]));
    out[2] = _mm256_sub_ps(_mm256_sub_ps(z, _mm256_set1_ps(l->o[2])), _mm256_set1_ps(l->rest[2]));
#undef ZBUFRANDI_RAY_LOAD
#undef ZBUFRANDI_RAY_PAIR
}

/* Edge functions of eight triangles sheared so that their rays run along z (Woop et al. 2013), and their sum: shares of
   the corners 0, 1, 2 times det. */
typedef struct zbufrandi_ray_edges { __m256 u, v, w, det; } zbufrandi_ray_edges;

/* Lanes whose ray is inside of its triangle: no edge function is below zero, for backs none above. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_ray_inside(const __m256 x[3], const __m256 y[3], int two_sided,
                                                                   zbufrandi_ray_edges *e) {
    const __m256 zero = _mm256_setzero_ps();
    const __m256 u = _mm256_sub_ps(_mm256_mul_ps(x[2], y[1]), _mm256_mul_ps(y[2], x[1])),
                 v = _mm256_sub_ps(_mm256_mul_ps(x[0], y[2]), _mm256_mul_ps(y[0], x[2])),
                 w = _mm256_sub_ps(_mm256_mul_ps(x[1], y[0]), _mm256_mul_ps(y[1], x[0])),
                 det = _mm256_add_ps(_mm256_add_ps(u, v), w);
    __m256 in = _mm256_and_ps(_mm256_and_ps(_mm256_cmp_ps(u, zero, _CMP_GE_OQ), _mm256_cmp_ps(v, zero, _CMP_GE_OQ)),
                              _mm256_and_ps(_mm256_cmp_ps(w, zero, _CMP_GE_OQ), _mm256_cmp_ps(det, zero, _CMP_GT_OQ)));
    if (two_sided) {
        in = _mm256_or_ps(
            in, _mm256_and_ps(_mm256_and_ps(_mm256_cmp_ps(u, zero, _CMP_LE_OQ), _mm256_cmp_ps(v, zero, _CMP_LE_OQ)),
                              _mm256_and_ps(_mm256_cmp_ps(w, zero, _CMP_LE_OQ), _mm256_cmp_ps(det, zero, _CMP_LT_OQ))));
    }
    e->u = u;
    e->v = v;
    e->w = w;
    e->det = det;
    return in;
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_ray_distance(const zbufrandi_ray_edges *e, const __m256 z[3]) {
    return _mm256_div_ps(_mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(e->u, z[0]), _mm256_mul_ps(e->v, z[1])),
                                       _mm256_mul_ps(e->w, z[2])), e->det);
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_ray_triangles_avx2(const zbufrandi_ray_local *l,
                                                                         const float *position, const uint8_t *index,
                                                                         uint32_t count, int two_sided,
                                                                         zbufrandi_ray_eight *out) {
    const __m256 zero = _mm256_setzero_ps();
    __m256 x[3], y[3], z[3], t, in;
    zbufrandi_ray_edges e;
    uint8_t tail[24];
    uint32_t k;
    if (count < 8) { /* what follows is another cluster or nothing */
        memset(tail, index[0], sizeof tail);
        memcpy(tail, index, 3 * (size_t)count);
        index = tail;
    }
    for (k = 0; k < 3; k++) {
        __m256 q[3], along;
        zbufrandi_ray_corner(l, position, index, k, q);
        along = q[l->kz];
        x[k] = _mm256_sub_ps(q[l->kx], _mm256_mul_ps(_mm256_set1_ps(l->sx), along));
        y[k] = _mm256_sub_ps(q[l->ky], _mm256_mul_ps(_mm256_set1_ps(l->sy), along));
        z[k] = _mm256_mul_ps(_mm256_set1_ps(l->sz), along);
    }
    in = zbufrandi_ray_inside(x, y, two_sided, &e);
    out->mask = out->back = 0;
    if (_mm256_movemask_ps(in) == 0) return;
    t = zbufrandi_ray_distance(&e, z);
    in = _mm256_and_ps(in, _mm256_and_ps(_mm256_cmp_ps(t, _mm256_set1_ps(l->t_min), _CMP_GE_OQ),
                                         _mm256_cmp_ps(t, _mm256_set1_ps(l->t_max), _CMP_LE_OQ)));
    out->mask = (uint32_t)_mm256_movemask_ps(in) & ((1u << count) - 1u);
    if (out->mask == 0) return;
    out->back = (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(e.det, zero, _CMP_LT_OQ)) & out->mask;
    _mm256_storeu_ps(out->t, t);
    _mm256_storeu_ps(out->u, _mm256_div_ps(e.v, e.det));
    _mm256_storeu_ps(out->v, _mm256_div_ps(e.w, e.det));
}
#endif

/* ---- the walk ---- */

/* Which of two hits at the same t is kept: does not depend on the order in which they are found. */
static int zbufrandi_ray_before(const zbufrandi_ray_walk *walk, uint32_t structure, uint32_t triangle) {
    const zbufrandi_ray_hit *hit = walk->hit;
    uint32_t k;
    if (hit->t == (double)INFINITY) return 1; /* at t_max */
    if (walk->levels != hit->levels) return walk->levels < hit->levels;
    for (k = 0; k < hit->levels; k++) {
        if (walk->path[k] != hit->path[k]) return walk->path[k] < hit->path[k];
    }
    return structure == hit->structure && triangle < hit->triangle;
}

static void zbufrandi_ray_take(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l, float t, float u, float v,
                               uint32_t back, uint32_t structure, uint32_t cluster, uint32_t triangle) {
    const double at = l->shift + (double)t;
    zbufrandi_ray_hit *hit = walk->hit;
    if (walk->veil != NULL) {
        const zbufrandi_mask m = zbufrandi_veil_cluster(walk->veil, &walk->r->structure[structure].cluster[cluster]);
        if (!zbufrandi_mask_shows(&m, walk->pixel)) return;
    }
    if (!(at < walk->best) && !(at == walk->best && zbufrandi_ray_before(walk, structure, triangle))) return;
    walk->best = hit->t = at;
    l->t_max = zbufrandi_ray_bound(at, l->shift);
    hit->u = u;
    hit->v = v;
    hit->structure = structure;
    hit->cluster = cluster;
    hit->triangle = triangle;
    hit->back = back;
    hit->levels = walk->levels;
    memcpy(hit->path, walk->path, walk->levels * sizeof *hit->path);
}

static void zbufrandi_ray_take_eight(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l, const zbufrandi_ray_eight *e,
                                     uint32_t structure, uint32_t cluster, uint32_t first) {
    uint32_t mask;
    for (mask = e->mask; mask != 0; mask &= mask - 1) {
        const uint32_t i = zbufrandi_ctz64(mask);
        zbufrandi_ray_take(walk, l, e->t[i], e->u[i], e->v[i], e->back >> i & 1u, structure, cluster, first + i);
    }
}

static void zbufrandi_ray_cluster(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l, uint32_t structure,
                                  uint32_t index) {
    const zbufrandi_structure *s = &walk->r->structure[structure];
    const zbufrandi_ray_box *box = &walk->r->box[structure][index];
    const float *position = s->position + 3 * (size_t)box->first_vertex;
    const uint32_t triangles = zbufrandi_ray_tag(box->step[0]);
    const int two_sided = (zbufrandi_ray_tag(box->step[1]) & ZBUFRANDI_TWO_SIDED) != 0;
    float t[16];
    uint32_t mask = zbufrandi_ray_groups(l, box, t);
    for (; mask != 0; mask &= mask - 1) {
        const uint32_t g = zbufrandi_ctz64(mask), count = triangles - 8 * g < 8 ? triangles - 8 * g : 8;
        const uint32_t first = box->first_triangle + 8 * g;
        zbufrandi_ray_eight e;
        if (t[g] > l->t_max) continue;
        zbufrandi_ray_triangles(l, position, s->triangle + 3 * (size_t)first, count, two_sided, &e);
        zbufrandi_ray_take_eight(walk, l, &e, structure, index, first);
    }
}

static void zbufrandi_ray_structure(zbufrandi_ray_walk *walk, uint32_t structure, const double o[3], const double d[3]);

/* A ray in the coordinates of an instance's structure. The inverse of a similarity: transpose / scale^2. */
static void zbufrandi_ray_into(const zbufrandi_instance *in, const double o[3], const double d[3], double out_o[3],
                               double out_d[3]) {
    const double k = 1.0 / (in->scale * in->scale), x = o[0] - in->to_parent[0][3], y = o[1] - in->to_parent[1][3],
                 z = o[2] - in->to_parent[2][3];
    int a;
    for (a = 0; a < 3; a++) {
        out_o[a] = (in->to_parent[0][a] * x + in->to_parent[1][a] * y + in->to_parent[2][a] * z) * k;
        out_d[a] = (in->to_parent[0][a] * d[0] + in->to_parent[1][a] * d[1] + in->to_parent[2][a] * d[2]) * k;
    }
}

static void zbufrandi_ray_instance(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l, const zbufrandi_structure *s,
                                   uint32_t index, const double o[3], const double d[3]) {
    double p[3], q[3];
    if (walk->levels >= ZBUFRANDI_MAX_LEVELS) return;
    zbufrandi_ray_into(&s->instance[index], o, d, p, q);
    walk->path[walk->levels++] = index;
    zbufrandi_ray_structure(walk, s->instance[index].structure, p, q);
    walk->levels--;
    l->t_max = zbufrandi_ray_bound(walk->best, l->shift);
}

typedef struct zbufrandi_ray_entry { uint32_t child; float t; } zbufrandi_ray_entry;

/* Nearer boxes first. The upper half of the bits of t decides, then the lane: 16 bits because the processor finds the
   smallest of eight such numbers in one instruction. */
ZBUFRANDI_INLINE uint32_t zbufrandi_ray_order(float t) {
    uint32_t bits;
    memcpy(&bits, &t, sizeof bits);
    return bits >> 16;
}

/* Everything under a child. */
static void zbufrandi_ray_subtree(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l, uint32_t structure, uint32_t child,
                                  const double o[3], const double d[3]) {
    const zbufrandi_structure *s = &walk->r->structure[structure];
    zbufrandi_ray_entry stack[ZBUFRANDI_RAY_STACK];
    uint32_t count = 1;
    stack[0].child = child;
    stack[0].t = l->t_min;
    while (count != 0) {
        const zbufrandi_ray_entry e = stack[--count];
        const uint32_t index = ZBUFRANDI_CHILD_INDEX(e.child), base = count;
        float enter[8];
        uint32_t mask, k;
        if (e.t > l->t_max) continue;
        if (ZBUFRANDI_CHILD_KIND(e.child) == ZBUFRANDI_CHILD_CLUSTER) {
            zbufrandi_ray_cluster(walk, l, structure, index);
        } else if (ZBUFRANDI_CHILD_KIND(e.child) == ZBUFRANDI_CHILD_INSTANCE) {
            zbufrandi_ray_instance(walk, l, s, index, o, d);
        } else {
            const zbufrandi_node8 *node = &s->node[index];
            mask = zbufrandi_ray_node(l, node, enter);
            if (count > ZBUFRANDI_RAY_STACK - 8) { /* not in trees that are anything like balanced */
                for (; mask != 0; mask &= mask - 1)
                    zbufrandi_ray_subtree(walk, l, structure, node->child[zbufrandi_ctz64(mask)], o, d);
            }
            for (; mask != 0; mask &= mask - 1) {
                const uint32_t c = zbufrandi_ctz64(mask);
                for (k = count++; k > base && zbufrandi_ray_order(stack[k - 1].t) <= zbufrandi_ray_order(enter[c]); k--)
                    stack[k] = stack[k - 1];
                stack[k].child = node->child[c];
                stack[k].t = enter[c];
            }
        }
    }
}

#if ZBUFRANDI_AVX2
/* Ask for what the groups of the mask need: indices, and vertices, which a cluster holds in the order of first use. */
ZBUFRANDI_INLINE void zbufrandi_ray_fetch(const zbufrandi_structure *s, const zbufrandi_ray_box *box, uint32_t mask) {
    const uint32_t triangles = zbufrandi_ray_tag(box->step[0]), vertices = zbufrandi_ray_tag(box->step[2]) + 1;
    for (; mask != 0; mask &= mask - 1) {
        const uint32_t g = zbufrandi_ctz64(mask);
        const float *p = s->position + 3 * ((size_t)box->first_vertex + vertices * 8 * g / triangles);
        ZBUFRANDI_PREFETCH(s->triangle + 3 * ((size_t)box->first_triangle + 8 * g));
        ZBUFRANDI_PREFETCH(p);
        ZBUFRANDI_PREFETCH(p + 16);
        ZBUFRANDI_PREFETCH(p + 32);
    }
}

/* Ask for what a child that waits is looked at for first: boxes and children of a node, the boxes of a cluster's
   groups, the transform of an instance, of which there may be more than any cache holds. */
ZBUFRANDI_INLINE void zbufrandi_ray_child_fetch(const zbufrandi_rays *r, const zbufrandi_structure *s,
                                                uint32_t structure, uint32_t child) {
    const uint32_t index = ZBUFRANDI_CHILD_INDEX(child);
    if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_NODE) {
        const zbufrandi_node8 *node = &s->node[index];
        ZBUFRANDI_PREFETCH(node->lo[0]);
        ZBUFRANDI_PREFETCH(node->lo[2]);
        ZBUFRANDI_PREFETCH(node->hi[1]);
        ZBUFRANDI_PREFETCH(node->child);
    } else if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_INSTANCE) {
        const uint8_t *in = (const uint8_t *)&s->instance[index];
        ZBUFRANDI_PREFETCH(in);
        ZBUFRANDI_PREFETCH(in + 64);
        ZBUFRANDI_PREFETCH(in + sizeof *s->instance - 1);
    } else {
        ZBUFRANDI_PREFETCH(&r->box[structure][index]);
    }
}

ZBUFRANDI_TARGET_AVX2 static void zbufrandi_ray_cluster_avx2(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l,
                                                             uint32_t structure, uint32_t index) {
    const zbufrandi_structure *s = &walk->r->structure[structure];
    const zbufrandi_ray_box *box = &walk->r->box[structure][index];
    const float *position = s->position + 3 * (size_t)box->first_vertex;
    const uint32_t triangles = zbufrandi_ray_tag(box->step[0]);
    const int two_sided = (zbufrandi_ray_tag(box->step[1]) & ZBUFRANDI_TWO_SIDED) != 0;
    float t[16];
    uint32_t mask = zbufrandi_ray_groups_avx2(l, box, t);
    zbufrandi_ray_fetch(s, box, mask);
    for (; mask != 0; mask &= mask - 1) {
        const uint32_t g = zbufrandi_ctz64(mask), count = triangles - 8 * g < 8 ? triangles - 8 * g : 8;
        const uint32_t first = box->first_triangle + 8 * g;
        zbufrandi_ray_eight e;
        if (t[g] > l->t_max) continue;
        zbufrandi_ray_triangles_avx2(l, position, s->triangle + 3 * (size_t)first, count, two_sided, &e);
        if (e.mask != 0) zbufrandi_ray_take_eight(walk, l, &e, structure, index, first);
    }
}

/* The same walk in the same order; the nearest child is gone on with at once. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_ray_subtree_avx2(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l,
                                                             uint32_t structure, uint32_t child, const double o[3],
                                                             const double d[3]) {
    static const uint16_t used[15] = {0, 0, 0, 0, 0, 0, 0, 0xffff, 0, 0, 0, 0, 0, 0, 0};
    const zbufrandi_structure *s = &walk->r->structure[structure];
    zbufrandi_ray_entry stack[ZBUFRANDI_RAY_STACK];
    uint32_t count = 0;
    memset(stack, 0, sizeof stack[0]);
    for (;;) {
        const uint32_t index = ZBUFRANDI_CHILD_INDEX(child);
        if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_NODE) {
            const zbufrandi_node8 *node = &s->node[index];
            __m256 t;
            uint32_t mask = zbufrandi_ray_node_avx2(l, node, &t), hits = (uint32_t)__builtin_popcount(mask);
            if (count > ZBUFRANDI_RAY_STACK - 8) {
                for (; mask != 0; mask &= mask - 1)
                    zbufrandi_ray_subtree_avx2(walk, l, structure, node->child[zbufrandi_ctz64(mask)], o, d);
                hits = 0;
            }
            if (hits != 0) {
                float enter[8];
                const __m256i lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128),
                              m = _mm256_set1_epi32((int32_t)mask);
                const __m256i out = _mm256_cmpeq_epi32(_mm256_and_si256(m, lanes), _mm256_setzero_si256());
                const __m256i high = _mm256_or_si256(_mm256_srli_epi32(_mm256_castps_si256(t), 16),
                                                     _mm256_srli_epi32(out, 16));
                __m128i order = _mm_packus_epi32(_mm256_castsi256_si128(high), _mm256_extracti128_si256(high, 1)),
                        least = _mm_minpos_epu16(order);
                uint32_t c = (uint32_t)_mm_extract_epi16(least, 1), k = count + hits - 1;
                _mm256_storeu_ps(enter, t);
                child = node->child[c];
                count = k;
                while (--hits != 0) {
                    order = _mm_or_si128(order, _mm_loadu_si128((const __m128i *)(const void *)(used + 7 - c)));
                    least = _mm_minpos_epu16(order);
                    c = (uint32_t)_mm_extract_epi16(least, 1);
                    k--;
                    stack[k].child = node->child[c];
                    stack[k].t = enter[c];
                    zbufrandi_ray_child_fetch(walk->r, s, structure, node->child[c]);
                }
                continue;
            }
        } else if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_CLUSTER) {
            zbufrandi_ray_cluster_avx2(walk, l, structure, index);
        } else {
            zbufrandi_ray_instance(walk, l, s, index, o, d);
        }
        do {
            if (count == 0) return;
            count--;
        } while (stack[count].t > l->t_max);
        child = stack[count].child;
    }
}
#endif

static void zbufrandi_ray_subtree_any(zbufrandi_ray_walk *walk, zbufrandi_ray_local *l, uint32_t structure,
                                      uint32_t child, const double o[3], const double d[3]) {
#if ZBUFRANDI_AVX2
    if (walk->r->level >= 3) {
        zbufrandi_ray_subtree_avx2(walk, l, structure, child, o, d);
        return;
    }
#endif
    zbufrandi_ray_subtree(walk, l, structure, child, o, d);
}

static void zbufrandi_ray_structure(zbufrandi_ray_walk *walk, uint32_t structure, const double o[3],
                                    const double d[3]) {
    const zbufrandi_structure *s = &walk->r->structure[structure];
    zbufrandi_ray_local l;
    if (s->node_count == 0 || !zbufrandi_ray_enter(&l, s, o, d, walk->t_min, walk->best)) return;
    zbufrandi_ray_subtree_any(walk, &l, structure, ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, 0), o, d);
}

static void zbufrandi_ray_open(zbufrandi_ray_walk *walk, const zbufrandi_rays *r, const zbufrandi_ray *ray,
                               zbufrandi_ray_hit *hit) {
    walk->r = r;
    walk->t_min = ray->t_min > 0.0 ? ray->t_min : 0.0;
    walk->best = ray->t_max;
    walk->levels = 0;
    walk->hit = hit;
    walk->veil = NULL;
    walk->pixel = 0;
    hit->t = (double)INFINITY;
    hit->levels = 0;
}

/* Closest hit; of several at the same t always the same. 0: none, hit->t is INFINITY then. Rays that are not
   finite or have no direction hit nothing. Any number of threads at once. */
static ZBUFRANDI_UNUSED int zbufrandi_ray_cast(const zbufrandi_rays *r, const zbufrandi_ray *ray,
                                               zbufrandi_ray_hit *hit) {
    zbufrandi_ray_walk walk;
    zbufrandi_ray_open(&walk, r, ray, hit);
    if (r->structure_count == 0 || !(walk.t_min <= walk.best)) return 0;
    zbufrandi_ray_structure(&walk, 0, ray->o, ray->d);
    return hit->t < (double)INFINITY;
}

#if ZBUFRANDI_AVX2
/* ---- eight rays at once ----

   Rays that stay together go down the tree together, a ray per lane, so that the long chain of dependent steps of one
   ray is paid for once. What only one or two of them meet is left to the walk of a single ray, and so is a structure in
   which they do not look along the same axes, or that is many levels down: a packet takes 5 KB of the stack for each,
   a ray 1.5 KB. Each ray gets the hit that it gets alone. */

enum { ZBUFRANDI_RAY_PACKET_LEVELS = 8 };

typedef struct zbufrandi_ray_packet {
    zbufrandi_ray_local l[8];
    float o[3][8], before[3][8], after[3][8], inverse[3][8], rest[3][8], sx[8], sy[8], sz[8], t_min[8], t_max[8];
} zbufrandi_ray_packet;

typedef struct zbufrandi_ray_bundle { /* what a packet has in common on all levels */
    zbufrandi_ray_walk walk[8];
} zbufrandi_ray_bundle;

typedef struct zbufrandi_ray_pending {
    float t[8];
    uint32_t child, mask;
    float first;
    uint32_t pad;
} zbufrandi_ray_pending;

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_ray_lanes(uint32_t mask) { /* bits -> lanes */
    const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    return _mm256_castsi256_ps(_mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32((int32_t)mask), bit), bit));
}

/* One by one. */
static void zbufrandi_ray_alone(zbufrandi_ray_bundle *b, zbufrandi_ray_packet *p, uint32_t mask, uint32_t structure,
                                uint32_t child, const double o[8][3], const double d[8][3]) {
    for (; mask != 0; mask &= mask - 1) {
        const uint32_t i = zbufrandi_ctz64(mask);
        zbufrandi_ray_subtree_avx2(&b->walk[i], &p->l[i], structure, child, o[i], d[i]);
        p->t_max[i] = p->l[i].t_max;
    }
}

/* The children of a node that some ray of the mask meets go onto the stack, the nearest on top. The new count. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_ray_node8(const zbufrandi_ray_packet *p, const zbufrandi_node8 *node,
                                                          uint32_t mask, zbufrandi_ray_pending *stack, uint32_t count) {
    const uint32_t base = count;
    uint32_t c, a, k, order[8], found = 0;
    zbufrandi_ray_pending hit[8];
    for (c = 0; c < node->count; c++) {
        __m256 enter = _mm256_loadu_ps(p->t_min), leave = _mm256_loadu_ps(p->t_max), least;
        __m128 m;
        uint32_t in;
        for (a = 0; a < 3; a++) {
            const __m256 first = _mm256_set1_ps(p->l[0].negative[a] ? node->hi[a][c] : node->lo[a][c]),
                         o = _mm256_loadu_ps(p->o[a]);
            const __m256 last = _mm256_set1_ps(p->l[0].negative[a] ? node->lo[a][c] : node->hi[a][c]),
                         inverse = _mm256_loadu_ps(p->inverse[a]);
            enter = _mm256_max_ps(
                _mm256_mul_ps(_mm256_sub_ps(_mm256_sub_ps(first, o), _mm256_loadu_ps(p->before[a])), inverse), enter);
            leave = _mm256_min_ps(
                _mm256_mul_ps(_mm256_sub_ps(_mm256_sub_ps(last, o), _mm256_loadu_ps(p->after[a])), inverse), leave);
        }
        enter = _mm256_mul_ps(enter, _mm256_set1_ps(ZBUFRANDI_RAY_LESS));
        leave = _mm256_cmp_ps(enter, _mm256_mul_ps(leave, _mm256_set1_ps(ZBUFRANDI_RAY_MORE)), _CMP_LE_OQ);
        in = (uint32_t)_mm256_movemask_ps(leave) & mask;
        if (in == 0) continue;
        least = _mm256_blendv_ps(_mm256_set1_ps(3e38f), enter, _mm256_and_ps(leave, zbufrandi_ray_lanes(mask)));
        m = _mm_min_ps(_mm256_castps256_ps128(least), _mm256_extractf128_ps(least, 1));
        m = _mm_min_ps(m, _mm_movehl_ps(m, m));
        m = _mm_min_ss(m, _mm_shuffle_ps(m, m, 1));
        _mm256_storeu_ps(hit[found].t, enter);
        hit[found].child = node->child[c];
        hit[found].mask = in;
        hit[found].first = _mm_cvtss_f32(m);
        for (k = found++; k > 0 && hit[order[k - 1]].first <= hit[found - 1].first; k--) order[k] = order[k - 1];
        order[k] = found - 1;
    }
    for (k = 0; k < found; k++) stack[base + k] = hit[order[k]];
    return base + found;
}

/* Triangle of a group against the rays of the mask. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_ray_triangle8(zbufrandi_ray_bundle *b, zbufrandi_ray_packet *p,
                                                          uint32_t mask, const float *position, const uint8_t *index,
                                                          int two_sided, uint32_t structure, uint32_t cluster,
                                                          uint32_t triangle) {
    const __m256 zero = _mm256_setzero_ps();
    const uint32_t kx = p->l[0].kx, ky = p->l[0].ky, kz = p->l[0].kz;
    __m256 x[3], y[3], z[3], t, in;
    zbufrandi_ray_edges e;
    float at[8], bu[8], bv[8];
    uint32_t k, back;
    for (k = 0; k < 3; k++) {
        const float *q = position + 3 * (size_t)index[k];
        const __m256 along = _mm256_sub_ps(_mm256_sub_ps(_mm256_set1_ps(q[kz]), _mm256_loadu_ps(p->o[kz])),
                                           _mm256_loadu_ps(p->rest[kz]));
        x[k] = _mm256_sub_ps(_mm256_sub_ps(_mm256_set1_ps(q[kx]), _mm256_loadu_ps(p->o[kx])),
                             _mm256_loadu_ps(p->rest[kx]));
        y[k] = _mm256_sub_ps(_mm256_sub_ps(_mm256_set1_ps(q[ky]), _mm256_loadu_ps(p->o[ky])),
                             _mm256_loadu_ps(p->rest[ky]));
        x[k] = _mm256_sub_ps(x[k], _mm256_mul_ps(_mm256_loadu_ps(p->sx), along));
        y[k] = _mm256_sub_ps(y[k], _mm256_mul_ps(_mm256_loadu_ps(p->sy), along));
        z[k] = _mm256_mul_ps(_mm256_loadu_ps(p->sz), along);
    }
    in = zbufrandi_ray_inside(x, y, two_sided, &e);
    mask &= (uint32_t)_mm256_movemask_ps(in);
    if (mask == 0) return;
    t = zbufrandi_ray_distance(&e, z);
    mask &= (uint32_t)_mm256_movemask_ps(_mm256_and_ps(_mm256_cmp_ps(t, _mm256_loadu_ps(p->t_min), _CMP_GE_OQ),
                                                       _mm256_cmp_ps(t, _mm256_loadu_ps(p->t_max), _CMP_LE_OQ)));
    if (mask == 0) return;
    back = (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(e.det, zero, _CMP_LT_OQ));
    _mm256_storeu_ps(at, t);
    _mm256_storeu_ps(bu, _mm256_div_ps(e.v, e.det));
    _mm256_storeu_ps(bv, _mm256_div_ps(e.w, e.det));
    for (; mask != 0; mask &= mask - 1) {
        const uint32_t i = zbufrandi_ctz64(mask);
        zbufrandi_ray_take(&b->walk[i], &p->l[i], at[i], bu[i], bv[i], back >> i & 1u, structure, cluster, triangle);
        p->t_max[i] = p->l[i].t_max;
    }
}

ZBUFRANDI_TARGET_AVX2 static void zbufrandi_ray_cluster8(zbufrandi_ray_bundle *b, zbufrandi_ray_packet *p,
                                                         uint32_t mask, uint32_t structure, uint32_t index) {
    const zbufrandi_rays *r = b->walk[0].r;
    const zbufrandi_structure *s = &r->structure[structure];
    const zbufrandi_ray_box *box = &r->box[structure][index];
    const float *position = s->position + 3 * (size_t)box->first_vertex;
    const uint32_t triangles = zbufrandi_ray_tag(box->step[0]);
    const int two_sided = (zbufrandi_ray_tag(box->step[1]) & ZBUFRANDI_TWO_SIDED) != 0;
    const uint32_t there = zbufrandi_ray_there(box);
    float t[8][16], first0[3][8], last0[3][8];
    uint32_t groups[8], any = 0, rays, i, a, h;
    __m256 first[3][2], last[3][2];
    for (a = 0; a < 3; a++) { /* what all rays share */
        const __m256 step = _mm256_set1_ps(box->step[a]),
                     zero = _mm256_sub_ps(_mm256_set1_ps(box->zero[a]), _mm256_loadu_ps(p->o[a]));
        const __m256 inverse = _mm256_loadu_ps(p->inverse[a]);
        for (h = 0; h < 2; h++) {
            first[a][h] = _mm256_mul_ps(zbufrandi_ray_bytes((p->l[0].negative[a] ? box->hi : box->lo)[a] + 8 * h),
                                        step);
            last[a][h] = _mm256_mul_ps(zbufrandi_ray_bytes((p->l[0].negative[a] ? box->lo : box->hi)[a] + 8 * h), step);
        }
        _mm256_storeu_ps(first0[a], _mm256_mul_ps(_mm256_sub_ps(zero, _mm256_loadu_ps(p->before[a])), inverse));
        _mm256_storeu_ps(last0[a], _mm256_mul_ps(_mm256_sub_ps(zero, _mm256_loadu_ps(p->after[a])), inverse));
    }
    memset(groups, 0, sizeof groups);
    for (rays = mask; rays != 0; rays &= rays - 1) {
        i = zbufrandi_ctz64(rays);
        for (h = 0; h < 2; h++) {
            __m256 enter = _mm256_set1_ps(p->t_min[i]), leave = _mm256_set1_ps(p->t_max[i]);
            for (a = 0; a < 3; a++) {
                const __m256 inverse = _mm256_set1_ps(p->inverse[a][i]);
                enter = _mm256_max_ps(_mm256_add_ps(_mm256_set1_ps(first0[a][i]), _mm256_mul_ps(first[a][h], inverse)),
                                      enter);
                leave = _mm256_min_ps(_mm256_add_ps(_mm256_set1_ps(last0[a][i]), _mm256_mul_ps(last[a][h], inverse)),
                                      leave);
            }
            enter = _mm256_mul_ps(enter, _mm256_set1_ps(ZBUFRANDI_RAY_LESS));
            leave = _mm256_mul_ps(leave, _mm256_set1_ps(ZBUFRANDI_RAY_MORE));
            _mm256_storeu_ps(t[i] + 8 * h, enter);
            groups[i] |= (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(enter, leave, _CMP_LE_OQ)) << 8 * h;
        }
        groups[i] &= there;
        any |= groups[i];
    }
    for (; any != 0; any &= any - 1) {
        const uint32_t g = zbufrandi_ctz64(any), count = triangles - 8 * g < 8 ? triangles - 8 * g : 8;
        const uint32_t triangle0 = box->first_triangle + 8 * g;
        const uint8_t *triangle = s->triangle + 3 * (size_t)triangle0;
        uint32_t meets = 0, k;
        for (rays = mask; rays != 0; rays &= rays - 1) {
            i = zbufrandi_ctz64(rays);
            if ((groups[i] >> g & 1) != 0 && t[i][g] <= p->l[i].t_max) meets |= 1u << i;
        }
        if (__builtin_popcount(meets) > 2) {
            for (k = 0; k < count; k++)
                zbufrandi_ray_triangle8(b, p, meets, position, triangle + 3 * k, two_sided, structure, index,
                                        triangle0 + k);
        } else {
            for (; meets != 0; meets &= meets - 1) {
                zbufrandi_ray_eight e;
                i = zbufrandi_ctz64(meets);
                zbufrandi_ray_triangles_avx2(&p->l[i], position, triangle, count, two_sided, &e);
                if (e.mask != 0) zbufrandi_ray_take_eight(&b->walk[i], &p->l[i], &e, structure, index, triangle0);
                p->t_max[i] = p->l[i].t_max;
            }
        }
    }
}

static void zbufrandi_ray_structure8(zbufrandi_ray_bundle *b, uint32_t mask, uint32_t structure, const double o[8][3],
                                     const double d[8][3]);

static void zbufrandi_ray_instance8(zbufrandi_ray_bundle *b, zbufrandi_ray_packet *p, uint32_t mask,
                                    const zbufrandi_structure *s, uint32_t index, const double o[8][3],
                                    const double d[8][3]) {
    double q[8][3], e[8][3];
    uint32_t rays, i;
    for (i = 0; i < 8; i++) b->walk[i].path[b->walk[i].levels++] = index;
    for (rays = mask; rays != 0; rays &= rays - 1) {
        i = zbufrandi_ctz64(rays);
        zbufrandi_ray_into(&s->instance[index], o[i], d[i], q[i], e[i]);
    }
    zbufrandi_ray_structure8(b, mask, s->instance[index].structure, ZBUFRANDI_RAY_EIGHT(q), ZBUFRANDI_RAY_EIGHT(e));
    for (i = 0; i < 8; i++) b->walk[i].levels--;
    for (rays = mask; rays != 0; rays &= rays - 1) {
        i = zbufrandi_ctz64(rays);
        p->t_max[i] = p->l[i].t_max = zbufrandi_ray_bound(b->walk[i].best, p->l[i].shift);
    }
}

static void zbufrandi_ray_structure8(zbufrandi_ray_bundle *b, uint32_t mask, uint32_t structure, const double o[8][3],
                                     const double d[8][3]) {
    const zbufrandi_structure *s = &b->walk[0].r->structure[structure];
    zbufrandi_ray_packet p;
    zbufrandi_ray_pending stack[ZBUFRANDI_RAY_STACK];
    uint32_t rays, i, a, count = 1, same = 1, lead = 8;
    if (s->node_count == 0) return;
    memset(p.l, 0, sizeof p.l);
    for (rays = mask; rays != 0; rays &= rays - 1) {
        i = zbufrandi_ctz64(rays);
        if (!zbufrandi_ray_enter(&p.l[i], s, o[i], d[i], b->walk[i].t_min, b->walk[i].best)) {
            mask &= ~(1u << i);
            continue;
        }
        if (lead == 8) lead = i;
        same &= p.l[i].kx == p.l[lead].kx && p.l[i].ky == p.l[lead].ky &&
                memcmp(p.l[i].negative, p.l[lead].negative, sizeof p.l[i].negative) == 0;
    }
    if (mask == 0) return;
    if (!same || (mask & (mask - 1)) == 0) {
        zbufrandi_ray_alone(b, &p, mask, structure, ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, 0), o, d);
        return;
    }
    for (i = 0; i < 8; i++) { /* lanes that are not there repeat the first one */
        if ((mask >> i & 1) == 0) p.l[i] = p.l[lead];
        for (a = 0; a < 3; a++) {
            p.o[a][i] = p.l[i].o[a];
            p.before[a][i] = p.l[i].before[a];
            p.after[a][i] = p.l[i].after[a];
            p.rest[a][i] = p.l[i].rest[a];
            p.inverse[a][i] = p.l[i].inverse[a];
        }
        p.sx[i] = p.l[i].sx;
        p.sy[i] = p.l[i].sy;
        p.sz[i] = p.l[i].sz;
        p.t_min[i] = stack[0].t[i] = p.l[i].t_min;
        p.t_max[i] = p.l[i].t_max;
    }
    stack[0].child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, 0);
    stack[0].mask = mask;
    while (count != 0) {
        const zbufrandi_ray_pending *e = &stack[--count];
        const uint32_t child = e->child, index = ZBUFRANDI_CHILD_INDEX(child), kind = ZBUFRANDI_CHILD_KIND(child);
        uint32_t active = 0, third;
        for (i = 0; i < 8; i++) active |= (uint32_t)(e->t[i] <= p.t_max[i]) << i;
        active &= e->mask;
        if (active == 0) continue;
        third = active & (active - 1);
        third &= third - (third != 0); /* 0: there are at most two */
        if (third == 0 || count > ZBUFRANDI_RAY_STACK - 8 ||
            (kind == ZBUFRANDI_CHILD_INSTANCE && b->walk[0].levels >= ZBUFRANDI_RAY_PACKET_LEVELS))
            zbufrandi_ray_alone(b, &p, active, structure, child, o, d);
        else if (kind == ZBUFRANDI_CHILD_CLUSTER) zbufrandi_ray_cluster8(b, &p, active, structure, index);
        else if (kind == ZBUFRANDI_CHILD_INSTANCE) zbufrandi_ray_instance8(b, &p, active, s, index, o, d);
        else {
            i = count;
            count = zbufrandi_ray_node8(&p, &s->node[index], active, stack, count);
            for (; i < count; i++) zbufrandi_ray_child_fetch(b->walk[0].r, s, structure, stack[i].child);
        }
    }
}
#endif

/* As zbufrandi_ray_cast for each of `count` rays, with the same hits; faster if neighbours in the array are neighbours
   in space: rays through the pixels of small tiles one after the other. Returns how many hit something. With a veil the
   rays pass through what pixel[i] does not show. */
static size_t zbufrandi_ray_cast_veiled(const zbufrandi_rays *r, const zbufrandi_ray *ray, size_t count,
                                        zbufrandi_ray_hit *hit, const zbufrandi_veil *veil, const uint32_t *pixel) {
    size_t i = 0, hits = 0;
#if ZBUFRANDI_AVX2
    if (r->level >= 3 && r->structure_count != 0) {
        zbufrandi_ray_bundle b;
        double o[8][3], d[8][3];
        for (; i + 2 <= count; i += 8) {
            const uint32_t n = count - i < 8 ? (uint32_t)(count - i) : 8;
            uint32_t k, mask = 0;
            for (k = 0; k < 8; k++) {
                const uint32_t from = k < n ? k : 0;
                zbufrandi_ray_open(&b.walk[k], r, &ray[i + from], &hit[i + from]);
                b.walk[k].veil = veil;
                if (veil != NULL) b.walk[k].pixel = pixel[i + from];
                memcpy(o[k], ray[i + from].o, sizeof o[k]);
                memcpy(d[k], ray[i + from].d, sizeof d[k]);
                if (k < n && b.walk[k].t_min <= b.walk[k].best) mask |= 1u << k;
            }
            zbufrandi_ray_structure8(&b, mask, 0, ZBUFRANDI_RAY_EIGHT(o), ZBUFRANDI_RAY_EIGHT(d));
            for (k = 0; k < n; k++) hits += hit[i + k].t < (double)INFINITY;
        }
    }
#endif
    for (; i < count; i++) {
        zbufrandi_ray_walk walk;
        zbufrandi_ray_open(&walk, r, &ray[i], &hit[i]);
        walk.veil = veil;
        if (veil != NULL) walk.pixel = pixel[i];
        if (r->structure_count == 0 || !(walk.t_min <= walk.best)) continue;
        zbufrandi_ray_structure(&walk, 0, ray[i].o, ray[i].d);
        hits += hit[i].t < (double)INFINITY;
    }
    return hits;
}

static ZBUFRANDI_UNUSED size_t zbufrandi_ray_cast_many(const zbufrandi_rays *r, const zbufrandi_ray *ray, size_t count,
                                                       zbufrandi_ray_hit *hit) {
    return zbufrandi_ray_cast_veiled(r, ray, count, hit, NULL, NULL);
}

/* Coordinates of the structure that was hit to those of structure 0. */
static ZBUFRANDI_UNUSED void zbufrandi_ray_matrix(const zbufrandi_rays *r, const zbufrandi_ray_hit *hit,
                                                  double out[3][4]) {
    uint32_t structure = 0, k;
    zbufrandi_m34_identity(out);
    for (k = 0; k < hit->levels; k++) {
        const zbufrandi_instance *in = &r->structure[structure].instance[hit->path[k]];
        zbufrandi_m34_mul(ZBUFRANDI_M34(out), in->to_parent, out);
        structure = in->structure;
    }
}

/* ---------------------------------------------------------------------------
   select: the cut through the trees of a view.                                  // >>select

   The projection factor of a surface point s with normal n is f^2 H / z^3, H = n . (eye - s) and z its depth: square
   pixels per unit of area. For a child of a node it is bounded by the largest H (from the cone of normals and the
   bounds of n . (s - centre), without regard to where in the box s is) and the smallest z; expected = density * area *
   that bound is never less than the number of samples wanted of what is below the child.
       expected <= 64          drawn from the 64 stored samples of the child
       node, instance          opened, entered
       cluster                 sampled from its triangles, or rastered, as is cheaper; rastered if it crosses the near
                               plane
   Trees are walked front to back in rounds. The nearest subtrees of the frontier are walked by one task each until it
   has opened a number of nodes; what then is left goes back to the frontier. Between rounds what was found is
   drawn, and hides what comes later. Which nodes a round opens depends on counts only, never on threads.
   --------------------------------------------------------------------------- */

enum {
    ZBUFRANDI_DRAW_STORED = 0, ZBUFRANDI_DRAW_SAMPLED = 1, ZBUFRANDI_DRAW_RASTERED = 2, ZBUFRANDI_DRAW_RAYS = 3,
    ZBUFRANDI_DRAW_POINTS = 4, ZBUFRANDI_DRAW_LISTED = 5, ZBUFRANDI_DRAW_LISTED_RASTER = 6, ZBUFRANDI_DRAW_SHIFT = 29,
    ZBUFRANDI_ROUND_TASKS = 64,   /* subtrees of a round */
    ZBUFRANDI_ROUND_NODES = 24    /* nodes a task opens */
};

typedef struct zbufrandi_draw { /* 64 bytes */
    float lo[3], step[3];      /* stored: point = lo + (q + 0.5) * step */
    float h_ref, iz_ref;       /* stored: bounds of H (times the scale of the local) and of 1/z, for thinning */
    float z_lo, z_hi;          /* depths that the surface may have */
    uint32_t local;
    uint32_t item;             /* kind << 29 | set, cluster, first ray hit, cloud, first object of a list */
    uint32_t count;            /* samples wanted; sampled: the most there can be; rastered: triangles */
    uint32_t hash;             /* random numbers of this draw */
    uint32_t block;            /* first of its blocks of 64 numbers */
    /* sampled: first of its blocks of 64 bytes that say which triangle; stored: ZBUFRANDI_STORED_* */
    uint32_t aux;
} zbufrandi_draw;
/* flat: normals within 60 degrees, planes tell depths */
/* view: points for a direction of view; more: goes on with what the draw before it began */
enum {
    ZBUFRANDI_STORED_TWO_SIDED = 1, ZBUFRANDI_STORED_FLAT = 2, ZBUFRANDI_STORED_VIEW = 4, ZBUFRANDI_STORED_MORE = 8
};

typedef struct zbufrandi_cut { /* what is the same for all of a frame's selection */
    const zbufrand_scene *scene;
    zbufrandi_camera camera;
    double density;
    float density_f2;          /* density * focal^2 */
    float stored;              /* most samples that stored ones may stand for: 64 / spread */
    float most;                /* what expects more is rastered: it is far larger than the picture */
    uint32_t run, runs;        /* which share of the stored samples this frame takes, of how many; 0 of 1: any */
    float near_z, far_z;
    float triangle, edge, pixel, cluster, sample, set_cost, stored_cost; /* costs; pixel: per expected sample */
    zbufrand_hybrid hybrid;
    float cube;
    int independent;
    const zbufrandi_pyramid *pyramid; /* NULL: nothing is hidden */
    const zbufrandi_keys *keys;       /* for small boxes, what has been drawn: NULL: not looked at */
    const uint64_t *exact;            /* of the same size, or NULL */
    uint32_t block;                   /* 1 or 2, for keys */
    float focal, center_x, center_y;
    uint32_t seed;
    int level;                 /* instruction set */
    zbufrandi_veil veil;
    int bounds;                /* remember bounds, and draws without samples */
    float depth_ratio, angle_ratio, clip_ratio, list_sample; /* for the thesis' trees; depths may differ by the first */
    int round_up;
    int comb, corners;
} zbufrandi_cut;

typedef struct zbufrandi_open_node { /* a node still to be opened */
    float z;
    uint32_t node, local, _pad;
} zbufrandi_open_node;

typedef struct zbufrandi_counts {
    uint64_t nodes, tested, outside, away, hidden, entered;
} zbufrandi_counts;

typedef struct zbufrandi_bounds { /* what was known of a draw's surface; only if asked for */
    uint64_t triangles;
    float area, h, h_min;      /* world */
    float expected;
} zbufrandi_bounds;

typedef struct zbufrandi_pick { /* one task's memory, kept from frame to frame */
    zbufrandi_open_node *stack;
    zbufrandi_draw *draw;
    zbufrandi_bounds *bounds;  /* of the draws */
    zbufrandi_local *local;    /* entered in this round; numbers from ZBUFRANDI_NEW_LOCAL on */
    size_t stack_capacity, draw_capacity, bounds_capacity, local_capacity;
    uint32_t stack_count, draw_count, local_count;
    uint64_t samples;          /* of the thesis' trees: of the draws */
    zbufrandi_counts counts;
    int failed;                /* out of memory, cancelled, or too many samples */
} zbufrandi_pick;
#define ZBUFRANDI_NEW_LOCAL 0x80000000u

/* ---- the camera in a structure ---- */

/* The sides of the picture as planes through the eye: px = cx + f x / z >= 0 and <= w; py = cy - f y / z likewise. */
static void zbufrandi_camera_sides(zbufrandi_camera *c) {
    double w = (double)c->width, h = (double)c->height;
    int p;
    c->side[0][0] = c->side[3][0] = c->focal;
    c->side[1][0] = c->side[2][0] = -c->focal;
    c->side[0][1] = c->center_x;
    c->side[1][1] = w - c->center_x;
    c->side[2][1] = c->center_y;
    c->side[3][1] = h - c->center_y;
    for (p = 0; p < 4; p++) {
        double length = sqrt(c->side[p][0] * c->side[p][0] + c->side[p][1] * c->side[p][1]);
        c->side[p][0] /= length;
        c->side[p][1] /= length;
    }
}

/* to_camera, scale, structure and so on are there; the rest follows. */
static void zbufrandi_local_finish(zbufrandi_local *l) {
    const double inverse = 1.0 / ((double)l->scale * (double)l->scale);
    int a, k;
    for (a = 0; a < 3; a++) {
        double eye = 0.0;
        for (k = 0; k < 3; k++) eye -= l->to_camera[k][a] * l->to_camera[k][3];
        eye *= inverse;
        l->eye[a] = (float)eye;
        l->eye_low[a] = (float)(eye - (double)l->eye[a]);
    }
    for (a = 0; a < 3; a++) {
        double rest = l->to_camera[a][3];
        for (k = 0; k < 3; k++) {
            l->m[a][k] = (float)l->to_camera[a][k];
            rest += l->to_camera[a][k] * (double)l->eye[k];
        }
        l->rest[a] = (float)rest;
    }
}

static void zbufrandi_sides_of(const zbufrandi_camera *camera, const zbufrandi_local *l, zbufrandi_sides *out) {
    int a, p;
    for (p = 0; p < 4; p++) { /* the sides lie along x (left, right) or y (top, bottom), and z */
        const double *side = l->to_camera[p >> 1];
        for (a = 0; a < 3; a++) {
            out->side[p][a] = (float)(camera->side[p][0] * side[a] + camera->side[p][1] * l->to_camera[2][a]);
            out->side_e[p][a] = zbufrandi_absf(out->side[p][a]) * 1.000001f;
        }
    }
    for (a = 0; a < 3; a++) {
        out->z_e[a] = zbufrandi_absf(l->m[2][a]) * 1.000001f;
        out->xy_e[0][a] = zbufrandi_absf(l->m[0][a]) * 1.000001f;
        out->xy_e[1][a] = zbufrandi_absf(l->m[1][a]) * 1.000001f;
    }
}

static void zbufrandi_local_root(const zbufrandi_camera *c, const zbufrandi_structure *s, uint32_t seed,
                                 zbufrandi_local *l) {
    const double *row[3];
    int a, k;
    memset(l, 0, sizeof *l);
    row[0] = c->right;
    row[1] = c->up;
    row[2] = c->dir;
    for (a = 0; a < 3; a++) {
        for (k = 0; k < 3; k++) {
            l->to_camera[a][k] = row[a][k];
            l->to_camera[a][3] += row[a][k] * (s->origin[k] - c->eye[k]);
        }
    }
    l->scale = 1.0f;
    l->hash = zbufrandi_hash32(seed);
    l->parent = l->instance = ~0u;
    zbufrandi_local_finish(l);
}

static void zbufrandi_local_enter(const zbufrandi_cut *cut, const zbufrandi_local *from, uint32_t from_index,
                                  uint32_t instance, zbufrandi_local *l) {
    const zbufrandi_instance *it = &cut->scene->structure[from->structure].instance[instance];
    zbufrandi_m34_mul(ZBUFRANDI_M34(from->to_camera), ZBUFRANDI_M34(it->to_parent), l->to_camera);
    l->scale = (float)((double)from->scale * it->scale);
    l->structure = it->structure;
    l->mirrored = from->mirrored ^ it->mirrored;
    l->hash = zbufrandi_hash32(from->hash ^ zbufrandi_hash32(instance + 0x9e3779b9u));
    l->parent = from_index;
    l->instance = instance;
    zbufrandi_local_finish(l);
}

/* ---- the children of a node ---- */

typedef struct zbufrandi_tested {
    float z_min[8], z_max[8];  /* world; z_min may be below the near plane */
    float h[8], h_min[8];      /* bounds of H, world */
    float expected[8];         /* INFINITY: crosses the near plane */
    float x0[8], x1[8], y0[8], y1[8]; /* rectangle in the picture, if it does not cross the near plane */
    uint32_t outside, away;    /* masks */
} zbufrandi_tested;

/* One lane; the vector form does the same operations in the same order. Rounding: `e` takes in what the sums of the box
   lose, `slack` what happens to lengths of the size of the distance. */
static void zbufrandi_test_lane(const zbufrandi_cut *cut, const zbufrandi_local *l, const zbufrandi_sides *s,
                                const zbufrandi_node8 *n, uint32_t i, zbufrandi_tested *t) {
    float q[3], e[3], l2, length, slack, d, z, ze, cg, sg, ct, st, front, back, front_min, back_min, h, h_min, r;
    uint32_t a, p;
    for (a = 0; a < 3; a++) {
        const float lo = n->lo[a][i], hi = n->hi[a][i];
        e[a] = (hi - lo) * 0.5f + (zbufrandi_absf(lo) + zbufrandi_absf(hi)) * 1.2e-7f;
        q[a] = (lo + hi) * 0.5f - l->eye[a];
    }
    l2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
    length = sqrtf(l2);
    slack = length * (l->scale * 1e-6f);
    for (p = 0; p < 4; p++) {
        d = (q[0] * s->side[p][0] + q[1] * s->side[p][1] + q[2] * s->side[p][2]) +
            (e[0] * s->side_e[p][0] + e[1] * s->side_e[p][1] + e[2] * s->side_e[p][2]);
        if (d < 0.0f - slack) t->outside |= 1u << i;
    }
    z = (q[0] * l->m[2][0] + q[1] * l->m[2][1] + q[2] * l->m[2][2]) + l->rest[2];
    ze = (e[0] * s->z_e[0] + e[1] * s->z_e[1] + e[2] * s->z_e[2]) + slack;
    t->z_min[i] = z - ze;
    t->z_max[i] = z + ze;
    if (t->z_max[i] < cut->near_z || t->z_min[i] > cut->far_z) t->outside |= 1u << i;
    /* from the centre and the reach along x and y of the camera, at both ends of the depths */
    for (a = 0; a < 2; a++) {
        const float focal = a == 0 ? cut->focal : 0.0f - cut->focal, center = a == 0 ? cut->center_x : cut->center_y;
        const float c = ((q[0] * l->m[a][0] + q[1] * l->m[a][1] + q[2] * l->m[a][2]) + l->rest[a]) * focal;
        const float reach = ((e[0] * s->xy_e[a][0] + e[1] * s->xy_e[a][1] + e[2] * s->xy_e[a][2]) + slack) * cut->focal;
        const float lo = c - reach, hi = c + reach, near_i = 1.0f / t->z_min[i], far_i = 1.0f / t->z_max[i];
        const float lo_a = lo * near_i, lo_b = lo * far_i, hi_a = hi * near_i, hi_b = hi * far_i;
        (a == 0 ? t->x0 : t->y0)[i] = (lo_a < lo_b ? lo_a : lo_b) + (center - ZBUFRANDI_PYRAMID_SLACK);
        (a == 0 ? t->x1 : t->y1)[i] = (hi_a > hi_b ? hi_a : hi_b) + (center + ZBUFRANDI_PYRAMID_SLACK);
    }
    /* the cone: angles between its normals and the direction to the eye lie between that of the axis -+ its opening */
    ct = n->cosine[i];
    st = sqrtf(1.0f - ct * ct);
    r = length > 1e-30f ? length : 1e-30f;
    cg = 0.0f - (n->axis[0][i] * q[0] + n->axis[1][i] * q[1] + n->axis[2][i] * q[2]) / r;
    sg = 1.0f - cg * cg;
    sg = sqrtf((sg > 0.0f ? sg : 0.0f) + 3e-7f);
    d = cg * ct;
    h = sg * st;
    front = cg >= ct ? 1.0f : d + h;
    back = 0.0f - cg >= ct ? 1.0f : h - d;
    front_min = 0.0f - cg >= ct ? -1.0f : d - h;
    back_min = cg >= ct ? -1.0f : (0.0f - d) - h;
    slack = length * 3e-6f;
    front = length * front - n->o_lo[i] + slack;
    back = length * back + n->o_hi[i] + slack;
    front_min = length * front_min - n->o_hi[i] - slack;
    back_min = length * back_min + n->o_lo[i] - slack;
    h = front;
    h_min = front_min;
    if (n->flags[i] & ZBUFRANDI_TWO_SIDED) {
        h = back > front ? back : front;
        h_min = back_min > front_min ? back_min : front_min;
    }
    h = h * (l->scale * 1.00001f);
    h_min = h_min * l->scale;
    t->h[i] = h;
    t->h_min[i] = h_min > 0.0f ? h_min : 0.0f;
    if (!(h > 0.0f)) t->away |= 1u << i;
    d = n->area[i] * (l->scale * l->scale) * cut->density_f2;
    z = t->z_min[i];
    t->expected[i] = z >= cut->near_z ? d / (z * z) * (h / z) : INFINITY;
}

#if ZBUFRANDI_AVX2
#define ZBUFRANDI_DOT(a, x, y, z) \
    _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(x, _mm256_set1_ps((a)[0])), _mm256_mul_ps(y, _mm256_set1_ps((a)[1]))), \
                  _mm256_mul_ps(z, _mm256_set1_ps((a)[2])))
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_test_node_avx2(const zbufrandi_cut *cut, const zbufrandi_local *l,
                                                           const zbufrandi_sides *s, const zbufrandi_node8 *n,
                                                           zbufrandi_tested *t) {
    const __m256 sign = _mm256_set1_ps(-0.0f), zero = _mm256_setzero_ps(), one = _mm256_set1_ps(1.0f),
        half = _mm256_set1_ps(0.5f);
    const __m256 minus = _mm256_set1_ps(-1.0f), scale = _mm256_set1_ps(l->scale);
    __m256 q[3], e[3], length, slack, d, z, ze, cg, ng, sg, ct, st, front, back, front_min, back_min, h, h_min,
        outside, olo, ohi, two;
    uint32_t a, p;
    for (a = 0; a < 3; a++) {
        const __m256 lo = _mm256_loadu_ps(n->lo[a]), hi = _mm256_loadu_ps(n->hi[a]);
        e[a] = _mm256_mul_ps(_mm256_add_ps(_mm256_andnot_ps(sign, lo), _mm256_andnot_ps(sign, hi)),
                             _mm256_set1_ps(1.2e-7f));
        e[a] = _mm256_add_ps(_mm256_mul_ps(_mm256_sub_ps(hi, lo), half), e[a]);
        q[a] = _mm256_sub_ps(_mm256_mul_ps(_mm256_add_ps(lo, hi), half), _mm256_set1_ps(l->eye[a]));
    }
    length = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(q[0], q[0]), _mm256_mul_ps(q[1], q[1])),
                           _mm256_mul_ps(q[2], q[2]));
    length = _mm256_sqrt_ps(length);
    slack = _mm256_mul_ps(length, _mm256_set1_ps(l->scale * 1e-6f));
    outside = zero;
    for (p = 0; p < 4; p++) {
        d = _mm256_add_ps(ZBUFRANDI_DOT(s->side[p], q[0], q[1], q[2]), ZBUFRANDI_DOT(s->side_e[p], e[0], e[1], e[2]));
        outside = _mm256_or_ps(outside, _mm256_cmp_ps(d, _mm256_sub_ps(zero, slack), _CMP_LT_OQ));
    }
    z = _mm256_add_ps(ZBUFRANDI_DOT(l->m[2], q[0], q[1], q[2]), _mm256_set1_ps(l->rest[2]));
    ze = _mm256_add_ps(ZBUFRANDI_DOT(s->z_e, e[0], e[1], e[2]), slack);
    d = _mm256_add_ps(z, ze);
    z = _mm256_sub_ps(z, ze);
    _mm256_storeu_ps(t->z_min, z);
    _mm256_storeu_ps(t->z_max, d);
    for (a = 0; a < 2; a++) {
        const float center = a == 0 ? cut->center_x : cut->center_y;
        const __m256 focal = _mm256_set1_ps(a == 0 ? cut->focal : 0.0f - cut->focal);
        const __m256 c = _mm256_mul_ps(_mm256_add_ps(ZBUFRANDI_DOT(l->m[a], q[0], q[1], q[2]),
                                                     _mm256_set1_ps(l->rest[a])), focal);
        const __m256 reach = _mm256_mul_ps(_mm256_add_ps(ZBUFRANDI_DOT(s->xy_e[a], e[0], e[1], e[2]), slack),
                                           _mm256_set1_ps(cut->focal));
        const __m256 lo = _mm256_sub_ps(c, reach), hi = _mm256_add_ps(c, reach);
        const __m256 near_i = _mm256_div_ps(one, z), far_i = _mm256_div_ps(one, d);
        _mm256_storeu_ps(a == 0 ? t->x0 : t->y0,
                         _mm256_add_ps(_mm256_min_ps(_mm256_mul_ps(lo, near_i), _mm256_mul_ps(lo, far_i)),
                                       _mm256_set1_ps(center - ZBUFRANDI_PYRAMID_SLACK)));
        _mm256_storeu_ps(a == 0 ? t->x1 : t->y1,
                         _mm256_add_ps(_mm256_max_ps(_mm256_mul_ps(hi, near_i), _mm256_mul_ps(hi, far_i)),
                                       _mm256_set1_ps(center + ZBUFRANDI_PYRAMID_SLACK)));
    }
    outside = _mm256_or_ps(outside, _mm256_cmp_ps(d, _mm256_set1_ps(cut->near_z), _CMP_LT_OQ));
    outside = _mm256_or_ps(outside, _mm256_cmp_ps(z, _mm256_set1_ps(cut->far_z), _CMP_GT_OQ));
    ct = _mm256_loadu_ps(n->cosine);
    st = _mm256_sqrt_ps(_mm256_sub_ps(one, _mm256_mul_ps(ct, ct)));
    d = _mm256_max_ps(length, _mm256_set1_ps(1e-30f));
    cg = _mm256_add_ps(_mm256_mul_ps(_mm256_loadu_ps(n->axis[0]), q[0]),
                       _mm256_mul_ps(_mm256_loadu_ps(n->axis[1]), q[1]));
    cg = _mm256_add_ps(cg, _mm256_mul_ps(_mm256_loadu_ps(n->axis[2]), q[2]));
    cg = _mm256_sub_ps(zero, _mm256_div_ps(cg, d));
    ng = _mm256_sub_ps(zero, cg);
    sg = _mm256_max_ps(_mm256_sub_ps(one, _mm256_mul_ps(cg, cg)), zero);
    sg = _mm256_sqrt_ps(_mm256_add_ps(sg, _mm256_set1_ps(3e-7f)));
    d = _mm256_mul_ps(cg, ct);
    h = _mm256_mul_ps(sg, st);
    front = _mm256_blendv_ps(_mm256_add_ps(d, h), one, _mm256_cmp_ps(cg, ct, _CMP_GE_OQ));
    back = _mm256_blendv_ps(_mm256_sub_ps(h, d), one, _mm256_cmp_ps(ng, ct, _CMP_GE_OQ));
    front_min = _mm256_blendv_ps(_mm256_sub_ps(d, h), minus, _mm256_cmp_ps(ng, ct, _CMP_GE_OQ));
    back_min = _mm256_blendv_ps(_mm256_sub_ps(_mm256_sub_ps(zero, d), h), minus, _mm256_cmp_ps(cg, ct, _CMP_GE_OQ));
    slack = _mm256_mul_ps(length, _mm256_set1_ps(3e-6f));
    olo = _mm256_loadu_ps(n->o_lo);
    ohi = _mm256_loadu_ps(n->o_hi);
    h = _mm256_add_ps(_mm256_sub_ps(_mm256_mul_ps(length, front), olo), slack);
    back = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(length, back), ohi), slack);
    h_min = _mm256_sub_ps(_mm256_sub_ps(_mm256_mul_ps(length, front_min), ohi), slack);
    back_min = _mm256_sub_ps(_mm256_add_ps(_mm256_mul_ps(length, back_min), olo), slack);
    two = _mm256_castsi256_ps(_mm256_slli_epi32(_mm256_cvtepu8_epi32(
            _mm_loadl_epi64((const __m128i *)(const void *)n->flags)), 31));
    h = _mm256_blendv_ps(h, _mm256_blendv_ps(h, back, _mm256_cmp_ps(back, h, _CMP_GT_OQ)), two);
    h_min = _mm256_blendv_ps(h_min, _mm256_blendv_ps(h_min, back_min, _mm256_cmp_ps(back_min, h_min, _CMP_GT_OQ)), two);
    h = _mm256_mul_ps(h, _mm256_set1_ps(l->scale * 1.00001f));
    _mm256_storeu_ps(t->h, h);
    _mm256_storeu_ps(t->h_min, _mm256_max_ps(_mm256_mul_ps(h_min, scale), zero));
    d = _mm256_mul_ps(_mm256_mul_ps(_mm256_loadu_ps(n->area), _mm256_set1_ps(l->scale * l->scale)),
                      _mm256_set1_ps(cut->density_f2));
    d = _mm256_mul_ps(_mm256_div_ps(d, _mm256_mul_ps(z, z)), _mm256_div_ps(h, z));
    _mm256_storeu_ps(t->expected,
            _mm256_blendv_ps(_mm256_set1_ps(INFINITY), d, _mm256_cmp_ps(z, _mm256_set1_ps(cut->near_z), _CMP_GE_OQ)));
    t->outside = (uint32_t)_mm256_movemask_ps(outside) & ((1u << n->count) - 1u);
    t->away = ~(uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(h, zero, _CMP_GT_OQ)) & ((1u << n->count) - 1u);
}
#undef ZBUFRANDI_DOT
#endif

static void zbufrandi_test_node(const zbufrandi_cut *cut, const zbufrandi_local *l, const zbufrandi_sides *s,
                                const zbufrandi_node8 *n, zbufrandi_tested *t) {
    uint32_t i;
#if ZBUFRANDI_AVX2
    if (cut->level >= 3) {
        zbufrandi_test_node_avx2(cut, l, s, n, t);
        return;
    }
#endif
    t->outside = t->away = 0;
    for (i = 0; i < n->count; i++) zbufrandi_test_lane(cut, l, s, n, i, t);
}

/* ---- what is before a child ---- */

#define ZBUFRANDI_HIDDEN_PIXELS 31.0f /* larger boxes are left to the pyramid alone */

/* Do all pixels of a small rectangle show something nearer than z? A sample paints its own pixel, in blocks of 2 the
   next ones to the right and below, too; keys of cut->exact paint one pixel. Nobody writes to them meanwhile. */
static int zbufrandi_behind_pixels(const zbufrandi_cut *cut, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1,
                                   float z) {
    const uint64_t limit = zbufrandi_key(z, 0) >> 32 << 32, *key = cut->keys->key, *exact = cut->exact;
    const size_t w = cut->keys->width;
    uint32_t x, y;
    for (y = y0; y <= y1; y++) {
        for (x = x0; x <= x1; x++) {
            const size_t at = (size_t)y * w + x;
            if (key[at] < limit || (exact != NULL && exact[at] < limit)) continue;
            if (cut->block == 2 && ((x > 0 && key[at - 1] < limit) || (y > 0 && key[at - w] < limit) ||
                                    (x > 0 && y > 0 && key[at - w - 1] < limit))) continue;
            return 0;
        }
    }
    return 1;
}

#if ZBUFRANDI_AVX2
/* Which of eight keys are nearer than a limit? Upper halves compare as signed numbers; an empty pixel is negative. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE uint32_t zbufrandi_nearer_eight(const uint64_t *key, __m256i limit) {
    const __m256i a = _mm256_loadu_si256((const __m256i *)(const void *)key);
    const __m256i b = _mm256_loadu_si256((const __m256i *)(const void *)(key + 4));
    return (uint32_t)_mm256_movemask_pd(_mm256_castsi256_pd(_mm256_andnot_si256(a, _mm256_cmpgt_epi32(limit, a)))) |
        (uint32_t)_mm256_movemask_pd(_mm256_castsi256_pd(_mm256_andnot_si256(b, _mm256_cmpgt_epi32(limit, b)))) << 4;
}

/* x1 + 8 <= width */
ZBUFRANDI_TARGET_AVX2 static int zbufrandi_behind_pixels_avx2(const zbufrandi_cut *cut, uint32_t x0, uint32_t y0,
                                                              uint32_t x1, uint32_t y1, float z) {
    const uint64_t bits = zbufrandi_key(z, 0) >> 32 << 32, *exact = cut->exact;
    const __m256i limit = _mm256_set1_epi64x((long long)bits);
    const size_t w = cut->keys->width;
    uint32_t x, y;
    for (x = x0; x <= x1; x += 8) {
        const uint32_t mask = x1 - x < 7 ? (2u << (x1 - x)) - 1u : 255u;
        const uint64_t *key = cut->keys->key + (size_t)y0 * w + x;
        uint32_t above = 0;
        if (cut->block == 2 && y0 > 0) {
            above = zbufrandi_nearer_eight(key - w, limit);
            above |= above << 1 | (uint32_t)(x > 0 && key[0 - (ptrdiff_t)w - 1] < bits);
        }
        for (y = y0; y <= y1; y++, key += w) {
            uint32_t seen = zbufrandi_nearer_eight(key, limit), here;
            if (cut->block == 2) {
                here = seen | seen << 1 | (uint32_t)(x > 0 && key[-1] < bits);
                seen = here | above;
                above = here;
            }
            if (exact != NULL) seen |= zbufrandi_nearer_eight(exact + (size_t)y * w + x, limit);
            if ((~seen & mask) != 0) return 0;
        }
    }
    return 1;
}
#endif

/* Is child i certainly not seen? Small ones are looked at pixel by pixel, others by the pyramid. */
static int zbufrandi_hidden_child(const zbufrandi_cut *cut, const zbufrandi_tested *t, uint32_t i) {
    const float w = (float)(int32_t)cut->camera.width, h = (float)(int32_t)cut->camera.height;
    float rect[4];
    int behind = 0;
    if (!(t->expected[i] < INFINITY)) return 0; /* crosses the near plane */
    rect[0] = t->x0[i] > 0.0f ? t->x0[i] : 0.0f;
    rect[1] = t->y0[i] > 0.0f ? t->y0[i] : 0.0f;
    rect[2] = t->x1[i] < w - 1.0f ? t->x1[i] : w - 1.0f;
    rect[3] = t->y1[i] < h - 1.0f ? t->y1[i] : h - 1.0f;
    if (!(rect[0] <= rect[2] && rect[1] <= rect[3])) return 0;
    if (cut->pyramid != NULL && (cut->keys == NULL || rect[2] - rect[0] >= 7.0f || rect[3] - rect[1] >= 7.0f)) {
#if ZBUFRANDI_AVX2
        if (cut->level >= 3) behind = zbufrandi_pyramid_hidden_avx2(cut->pyramid, rect, t->z_min[i]);
        else
#endif
            behind = zbufrandi_pyramid_hidden(cut->pyramid, rect, t->z_min[i]);
    }
    if (!behind && cut->keys != NULL && rect[2] - rect[0] < ZBUFRANDI_HIDDEN_PIXELS &&
        rect[3] - rect[1] < ZBUFRANDI_HIDDEN_PIXELS) {
        const uint32_t x0 = (uint32_t)(int32_t)rect[0], y0 = (uint32_t)(int32_t)rect[1];
        uint32_t x1 = (uint32_t)(int32_t)rect[2], y1 = (uint32_t)(int32_t)rect[3];
        if (cut->block == 2) { /* what samples there paint */
            x1 += x1 + 1 < cut->keys->width;
            y1 += y1 + 1 < cut->keys->height;
        }
#if ZBUFRANDI_AVX2
        if (cut->level >= 3 && x1 + 8 <= cut->keys->width)
            behind = zbufrandi_behind_pixels_avx2(cut, x0, y0, x1, y1, t->z_min[i]);
        else
#endif
            behind = zbufrandi_behind_pixels(cut, x0, y0, x1, y1, t->z_min[i]);
    }
    return behind;
}

/* Which of the children in `mask` are certainly not seen. */
static uint32_t zbufrandi_hidden_children(const zbufrandi_cut *cut, const zbufrandi_tested *t, uint32_t mask) {
    uint32_t hidden = 0;
    for (; mask != 0; mask &= mask - 1) {
        const uint32_t i = zbufrandi_ctz64(mask);
        hidden |= (uint32_t)zbufrandi_hidden_child(cut, t, i) << i;
    }
    return hidden;
}

/* A whole instance, seen from its own structure: the box there and the ball in it are narrower than the box around them
   in the parent. Narrows what is known of child i. 0: outside of the picture. */
static int zbufrandi_narrow(const zbufrandi_cut *cut, const zbufrandi_local *l, zbufrandi_tested *t, uint32_t i) {
    const zbufrandi_structure *s = &cut->scene->structure[l->structure];
    const float ball = s->radius * l->scale;
    float q[3], e[3], reach[3], c[3], slack, near_i, far_i;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        e[a] = (s->box_hi[a] - s->box_lo[a]) * 0.5f +
            (zbufrandi_absf(s->box_lo[a]) + zbufrandi_absf(s->box_hi[a])) * 1.2e-7f;
        q[a] = (s->box_lo[a] + s->box_hi[a]) * 0.5f - l->eye[a];
    }
    slack = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]) * (l->scale * 1e-6f);
    for (a = 0; a < 3; a++) {
        c[a] = (q[0] * l->m[a][0] + q[1] * l->m[a][1] + q[2] * l->m[a][2]) + l->rest[a];
        reach[a] = (e[0] * zbufrandi_absf(l->m[a][0]) + e[1] * zbufrandi_absf(l->m[a][1]) +
                    e[2] * zbufrandi_absf(l->m[a][2])) * 1.000001f;
        reach[a] = (reach[a] < ball ? reach[a] : ball) + slack;
    }
    if (c[2] - reach[2] > t->z_min[i]) t->z_min[i] = c[2] - reach[2];
    if (c[2] + reach[2] < t->z_max[i]) t->z_max[i] = c[2] + reach[2];
    if (!(t->z_min[i] <= t->z_max[i])) return 1; /* rounding: nothing gained */
    near_i = 1.0f / t->z_min[i];
    far_i = 1.0f / t->z_max[i];
    for (a = 0; a < 2; a++) {
        const float focal = a == 0 ? cut->focal : 0.0f - cut->focal, center = a == 0 ? cut->center_x : cut->center_y;
        const float lo = c[a] * focal - reach[a] * cut->focal, hi = c[a] * focal + reach[a] * cut->focal;
        const float first = (lo * near_i < lo * far_i ? lo * near_i : lo * far_i) +
            (center - ZBUFRANDI_PYRAMID_SLACK);
        const float last = (hi * near_i > hi * far_i ? hi * near_i : hi * far_i) + (center + ZBUFRANDI_PYRAMID_SLACK);
        float *x0 = a == 0 ? &t->x0[i] : &t->y0[i], *x1 = a == 0 ? &t->x1[i] : &t->y1[i];
        if (first > *x0) *x0 = first;
        if (last < *x1) *x1 = last;
        if (!(*x1 >= 0.0f && *x0 <= (a == 0 ? (float)(int32_t)cut->camera.width
                                            : (float)(int32_t)cut->camera.height))) return 0;
    }
    return 1;
}

/* ---- what is done with a child ---- */

static int zbufrandi_pick_room(zbufrandi_mem *mem, zbufrandi_pick *p, int bounds) {
    if (zbufrandi_grow(mem, (void **)&p->stack, &p->stack_capacity, p->stack_count, (size_t)p->stack_count + 16,
                       sizeof *p->stack) &&
        zbufrandi_grow(mem, (void **)&p->draw, &p->draw_capacity, p->draw_count,
                       (size_t)p->draw_count + 8 * ZBUFRANDI_VIEW_SETS, sizeof *p->draw) &&
        zbufrandi_grow(mem, (void **)&p->local, &p->local_capacity, p->local_count, (size_t)p->local_count + 16,
                       sizeof *p->local) &&
        (!bounds || zbufrandi_grow(mem, (void **)&p->bounds, &p->bounds_capacity, p->draw_count,
                                   (size_t)p->draw_count + 8 * ZBUFRANDI_VIEW_SETS, sizeof *p->bounds))) {
        return 1;
    }
    p->failed = 1;
    return 0;
}

/* Does the box of a lane touch the cube around the eye (axes of the structure)? */
static int zbufrandi_in_cube(const zbufrandi_cut *cut, const zbufrandi_local *l, const zbufrandi_node8 *n, uint32_t i) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        float reach = cut->cube / l->scale;
        if (n->lo[a][i] > l->eye[a] + reach || n->hi[a][i] < l->eye[a] - reach) return 0;
    }
    return 1;
}

ZBUFRANDI_INLINE uint32_t zbufrandi_child_hash(const zbufrandi_local *l, uint32_t child) {
    return zbufrandi_hash32(l->hash ^ child * 0x9e3779b1u);
}

/* Which of several sets: any; of frames that will be averaged the same one at the same place. */
ZBUFRANDI_INLINE uint32_t zbufrandi_more_of(const zbufrandi_cut *cut, const zbufrandi_local *l, uint32_t hash) {
    return zbufrandi_hash32(cut->runs == 1 ? hash + 0x6a09e667u : l->instance * 0x9e3779b1u + 0x6a09e667u);
}

static void zbufrandi_emit_stored(const zbufrandi_cut *cut, zbufrandi_pick *p, const zbufrandi_local *l,
                                  uint32_t local, uint32_t hash, uint32_t set,
                                  const float lo[3], const float hi[3], const zbufrandi_node8 *n,
                                      const zbufrandi_tested *t, uint32_t i) {
    zbufrandi_draw *d;
    uint32_t count = (uint32_t)(t->expected[i] + zbufrandi_unit24(hash));
    if (count == 0 && !cut->bounds) return;
    d = &p->draw[p->draw_count++];
    memset(d, 0, sizeof *d);
    memcpy(d->lo, lo, sizeof d->lo);
    zbufrandi_set_step(lo, hi, d->step);
    d->h_ref = t->h[i] * l->scale;
    d->iz_ref = 1.0f / t->z_min[i];
    d->z_lo = t->z_min[i];
    d->z_hi = t->z_max[i];
    d->local = local;
    d->item = (uint32_t)ZBUFRANDI_DRAW_STORED << ZBUFRANDI_DRAW_SHIFT | set;
    d->count = count > ZBUFRANDI_SET ? ZBUFRANDI_SET : count;
    d->hash = hash;
    d->aux = (n->flags[i] & ZBUFRANDI_TWO_SIDED ? (uint32_t)ZBUFRANDI_STORED_TWO_SIDED : 0u) |
             (n->cosine[i] > 0.5f ? (uint32_t)ZBUFRANDI_STORED_FLAT : 0u);
}

static void zbufrandi_emit_cluster(const zbufrandi_cut *cut, zbufrandi_pick *p, uint32_t triangles, uint32_t local,
                                   uint32_t hash, uint32_t cluster, const zbufrandi_tested *t, uint32_t i, int raster) {
    zbufrandi_draw *d = &p->draw[p->draw_count++];
    memset(d, 0, sizeof *d);
    d->z_lo = t->z_min[i];
    d->z_hi = t->z_max[i];
    d->local = local;
    d->hash = hash;
    if (raster) {
        d->item = (uint32_t)ZBUFRANDI_DRAW_RASTERED << ZBUFRANDI_DRAW_SHIFT | cluster;
        d->count = triangles;
    } else {
        d->item = (uint32_t)ZBUFRANDI_DRAW_SAMPLED << ZBUFRANDI_DRAW_SHIFT | cluster;
        d->count = (uint32_t)(t->expected[i] * (cut->independent ? 1.5f : 1.0001f) + (cut->independent ? 64.0f : 2.0f));
        d->h_ref = t->expected[i] / (float)cut->density; /* bound of the area in the picture */
    }
}

/* Stored points of an instance for the direction that it is seen from, if that takes fewer of them than those for all
   directions, and no more than there are. *expected: what that would be; changed if so. */
static int zbufrandi_emit_view(const zbufrandi_cut *cut, zbufrandi_pick *p, const zbufrandi_local *l,
                               uint32_t local, uint32_t hash, const zbufrandi_node8 *n, const zbufrandi_tested *t,
                               uint32_t i, float *expected) {
    const zbufrandi_structure *s = &cut->scene->structure[l->structure];
    const zbufrandi_view *view;
    float v[3], r2 = 0.0f, d2 = 0.0f, furthest, e;
    const float z = t->z_min[i];
    uint32_t cell, count, a, part, most;
    zbufrandi_draw *d;
    if (s->first_view == 0 || !(t->expected[i] < INFINITY)) return 0;
    for (a = 0; a < 3; a++) {
        const float half = (s->box_hi[a] - s->box_lo[a]) * 0.5f;
        v[a] = l->eye[a] - (s->box_lo[a] + half);
        r2 += half * half;
        d2 += v[a] * v[a];
    }
    if (!(d2 > r2 * (ZBUFRANDI_VIEW_DISTANCE * ZBUFRANDI_VIEW_DISTANCE))) return 0;
    cell = zbufrandi_view_cell(v);
    view = &s->view[cell];
    furthest = (sqrtf(d2) + sqrtf(r2)) * (l->scale * 1.00001f);
    e = view->area * (l->scale * l->scale) * cut->density_f2 / (z * z) * (furthest / z);
    if (!(e <= cut->stored * ZBUFRANDI_VIEW_SETS && e < t->expected[i])) return 0;
    *expected = e;
    count = (uint32_t)(e + zbufrandi_unit24(hash));
    /* one set after the other, from any one on; of frames that will be averaged, from the same one on */
    part = zbufrandi_hash32(cut->runs == 1 ? hash + 0x6a09e667u : l->instance * 0x9e3779b1u + cell);
    most = ZBUFRANDI_SET / cut->runs;
    for (a = 0; a < ZBUFRANDI_VIEW_SETS && (count > 0 || (a == 0 && cut->bounds)); a++) {
        d = &p->draw[p->draw_count++];
        memset(d, 0, sizeof *d);
        memcpy(d->lo, s->box_lo, sizeof d->lo);
        zbufrandi_set_step(s->box_lo, s->box_hi, d->step);
        d->h_ref = furthest * l->scale;
        d->iz_ref = 1.0f / z;
        d->z_lo = z;
        d->z_hi = t->z_max[i];
        d->local = local;
        d->item = (uint32_t)ZBUFRANDI_DRAW_STORED << ZBUFRANDI_DRAW_SHIFT |
            (s->first_view + cell * ZBUFRANDI_VIEW_SETS + (part + a) % ZBUFRANDI_VIEW_SETS);
        d->count = count > most ? most : count;
        d->hash = zbufrandi_hash32(hash + a);
        d->aux = (n->flags[i] & ZBUFRANDI_TWO_SIDED ? (uint32_t)ZBUFRANDI_STORED_TWO_SIDED : 0u) |
                 (n->cosine[i] > 0.5f ? (uint32_t)ZBUFRANDI_STORED_FLAT : 0u) | (uint32_t)ZBUFRANDI_STORED_VIEW |
                 (a > 0 ? (uint32_t)ZBUFRANDI_STORED_MORE : 0u);
        count -= d->count;
    }
    return 1;
}

ZBUFRANDI_INLINE void zbufrandi_prefetch_node(const zbufrandi_node8 *n) {
    const uint8_t *p = (const uint8_t *)n;
    uint32_t k;
    for (k = 0; k < sizeof *n; k += 64) ZBUFRANDI_PREFETCH(p + k);
}

/* Draw child i of a node, or open it, or enter it. */
static void zbufrandi_pick_child(const zbufrandi_cut *cut, const zbufrandi_local *locals, zbufrandi_pick *p,
                                 uint32_t local,
                                 const zbufrandi_node8 *n, zbufrandi_tested *t, uint32_t i, float *expected) {
    const zbufrandi_local *l = local >= ZBUFRANDI_NEW_LOCAL ? &p->local[local - ZBUFRANDI_NEW_LOCAL] : &locals[local];
    const zbufrandi_structure *s = &cut->scene->structure[l->structure];
    uint32_t child = n->child[i], kind = ZBUFRANDI_CHILD_KIND(child), index = ZBUFRANDI_CHILD_INDEX(child), a;
    uint32_t hash = zbufrandi_child_hash(l, child);
    float e = t->expected[i], lo[3], hi[3];
    int cube = cut->hybrid == ZBUFRAND_HYBRID_CUBE && zbufrandi_in_cube(cut, l, n, i);
    const int samples = !cube && !cut->independent && cut->hybrid != ZBUFRAND_HYBRID_ALL;
    int stored = e <= cut->stored && samples;
    for (a = 0; a < 3; a++) {
        lo[a] = n->lo[a][i];
        hi[a] = n->hi[a][i];
    }
    if (kind == ZBUFRANDI_CHILD_CLUSTER) {
        const uint32_t count = (uint32_t)n->triangles[i];
        const float edge = n->edge[i] * l->scale * cut->focal, widest = 12.0f * t->z_min[i]; /* times z_min */
        float triangles = (float)count, raster, sampled, prefix;
        int exact = cut->hybrid == ZBUFRAND_HYBRID_ALL || cube || !(e < cut->most);
        raster = triangles * (cut->triangle + cut->edge * (edge < widest ? edge / t->z_min[i] : 12.0f)) +
            e * cut->pixel;
        if (cut->hybrid != ZBUFRAND_HYBRID_AUTO) raster = INFINITY;
        sampled = triangles * cut->cluster + e * cut->sample;
        prefix = stored ? cut->set_cost + e * cut->stored_cost : INFINITY;
        if (exact || (raster <= sampled && raster <= prefix)) {
            zbufrandi_emit_cluster(cut, p, count, local, hash, index, t, i, 1);
        } else if (prefix <= sampled) {
            zbufrandi_emit_stored(cut, p, l, local, hash, index, lo, hi, n, t, i);
        } else {
            zbufrandi_emit_cluster(cut, p, count, local, hash, index, t, i, 0);
        }
    } else if (kind == ZBUFRANDI_CHILD_NODE) {
        if (stored) {
            uint32_t set = s->cluster_count + index;
            if (s->first_more != 0 && n == &s->node[0])
                set = s->first_more + s->more + s->more / ZBUFRANDI_MORE_PARTS * i +
                    zbufrandi_more_of(cut, l, hash) % (s->more / ZBUFRANDI_MORE_PARTS);
            zbufrandi_emit_stored(cut, p, l, local, hash, set, lo, hi, n, t, i);
        } else {
            zbufrandi_open_node *f = &p->stack[p->stack_count++];
            f->z = t->z_min[i];
            f->node = index;
            f->local = local;
            f->_pad = 0;
            zbufrandi_prefetch_node(&s->node[index]);
        }
    } else {
        const zbufrandi_structure *to;
        uint32_t entered = ZBUFRANDI_NEW_LOCAL + p->local_count;
        zbufrandi_local *k = &p->local[p->local_count++];
        zbufrandi_local_enter(cut, l, local, index, k);
        to = &cut->scene->structure[k->structure];
        if (e < INFINITY) {
            const float z = t->z_min[i], wide = (t->x1[i] - t->x0[i] + 1.0f) * (t->y1[i] - t->y0[i] + 1.0f);
            if (!zbufrandi_narrow(cut, k, t, i)) {
                p->local_count--;
                p->counts.outside++;
                return;
            }
            if ((cut->pyramid != NULL || cut->keys != NULL) &&
                (t->x1[i] - t->x0[i] + 1.0f) * (t->y1[i] - t->y0[i] + 1.0f) < 0.7f * wide &&
                zbufrandi_hidden_child(cut, t, i)) {
                p->local_count--;
                p->counts.hidden++;
                return;
            }
            if (t->z_min[i] > z) {
                const float nearer = z / t->z_min[i];
                t->expected[i] = e = e * (nearer * nearer * nearer * 1.000001f);
                *expected = e;
                stored = e <= cut->stored && samples;
            }
        }
        if (samples) {
            const uint32_t draws = p->draw_count;
            if (zbufrandi_emit_view(cut, p, k, entered, hash, n, t, i, expected)) stored = 1;
            else if (stored)
                zbufrandi_emit_stored(cut, p, k, entered, hash, to->first_more == 0 ? to->cluster_count
                                      : to->first_more + zbufrandi_more_of(cut, k, hash) % to->more,
                                      to->box_lo, to->box_hi, n, t, i);
            if (stored && p->draw_count == draws) p->local_count--; /* nobody needs it */
        }
        if (!stored) {
            zbufrandi_open_node *f = &p->stack[p->stack_count++];
            f->z = t->z_min[i];
            f->node = 0;
            f->local = entered;
            f->_pad = 0;
            p->counts.entered++;
        }
    }
}

/* Walk from the entries of p->stack, nearest first, until `nodes` are opened; the rest stays there. */
static void zbufrandi_pick_run(const zbufrandi_cut *cut, zbufrandi_mem *mem, const zbufrandi_local *locals,
                               zbufrandi_pick *p, uint32_t nodes) {
    zbufrandi_sides sides;
    uint32_t sides_of = ~0u; /* whose they are */
    memset(&sides, 0, sizeof sides);
    while (p->stack_count > 0 && nodes-- > 0) {
        zbufrandi_open_node at = p->stack[p->stack_count - 1];
        const zbufrandi_local *l;
        const zbufrandi_node8 *n;
        zbufrandi_tested t;
        uint32_t i, k, alive, hidden = 0, order[8], count = 0, first;
        if (!zbufrandi_pick_room(mem, p, cut->bounds)) return;
        p->stack_count--;
        l = at.local >= ZBUFRANDI_NEW_LOCAL ? &p->local[at.local - ZBUFRANDI_NEW_LOCAL] : &locals[at.local];
        n = &cut->scene->structure[l->structure].node[at.node];
        if (sides_of != at.local) zbufrandi_sides_of(&cut->camera, l, &sides);
        sides_of = at.local;
        zbufrandi_test_node(cut, l, &sides, n, &t);
        alive = ((1u << n->count) - 1u) & ~(t.outside | t.away);
        for (k = alive; k != 0; k &= k - 1) { /* instances are far away in memory */
            const uint32_t child = n->child[zbufrandi_ctz64(k)];
            if (ZBUFRANDI_CHILD_KIND(child) == ZBUFRANDI_CHILD_INSTANCE) {
                const zbufrandi_structure *s = &cut->scene->structure[l->structure];
                const uint8_t *in = (const uint8_t *)&s->instance[ZBUFRANDI_CHILD_INDEX(child)];
                ZBUFRANDI_PREFETCH(in);
                ZBUFRANDI_PREFETCH(in + 64);
                ZBUFRANDI_PREFETCH(in + sizeof *s->instance - 1);
            }
        }
        if ((cut->pyramid != NULL || cut->keys != NULL) && alive != 0) {
            hidden = zbufrandi_hidden_children(cut, &t, alive);
            alive &= ~hidden;
        }
        if (p->stack_count > 0) { /* the next one, unless a child comes before it */
            const zbufrandi_open_node *next = &p->stack[p->stack_count - 1];
            const zbufrandi_local *nl = next->local >= ZBUFRANDI_NEW_LOCAL
                ? &p->local[next->local - ZBUFRANDI_NEW_LOCAL] : &locals[next->local];
            zbufrandi_prefetch_node(&cut->scene->structure[nl->structure].node[next->node]);
        }
        p->counts.nodes++;
        p->counts.tested += n->count;
        p->counts.outside += zbufrandi_popcount64(t.outside);
        p->counts.away += zbufrandi_popcount64(t.away & ~t.outside);
        p->counts.hidden += zbufrandi_popcount64(hidden);
        for (; alive != 0; alive &= alive - 1) { /* nearest first */
            i = zbufrandi_ctz64(alive);
            for (k = count++; k > 0 && t.z_min[order[k - 1]] > t.z_min[i]; k--) order[k] = order[k - 1];
            order[k] = i;
        }
        first = p->stack_count;
        for (k = 0; k < count; k++) {
            uint32_t draws = p->draw_count;
            float expected;
            i = order[k];
            expected = t.expected[i];
            zbufrandi_pick_child(cut, locals, p, at.local, n, &t, i, &expected);
            for (; cut->bounds && draws < p->draw_count; draws++) {
                zbufrandi_bounds *b = &p->bounds[draws];
                b->triangles = n->triangles[i];
                b->area = n->area[i] * l->scale * l->scale;
                b->h = t.h[i];
                b->h_min = t.h_min[i];
                b->expected = expected;
            }
        }
        for (i = first, k = p->stack_count; i + 1 < k; i++) { /* the nearest on top */
            zbufrandi_open_node swap = p->stack[i];
            p->stack[i] = p->stack[--k];
            p->stack[k] = swap;
        }
    }
}

/* ---------------------------------------------------------------------------
   sample: draws -> keys. Stored samples, and clusters sampled triangle by       // >>sample
   triangle; scalar and eight at a time, with the same bits.

   Stored: point, normal and depth of a sample are decoded and seen from the local camera; it is kept with probability
   prj / bound, so that what is kept has exactly the density that was asked for. The random number for that is a second
   dimension of the sequence that orders the set: any aligned run of samples is spread over place and number both.
   Clusters: vertices are projected once; the triangles' areas in the picture, added up along the curve, are cut into as
   many equal strata as there are samples. A point uniform on a triangle of the picture has exactly the right density;
   its depth follows from 1/z being affine there. No sample is lost to thinning or to faces turned away.
   --------------------------------------------------------------------------- */

/* Random number of stored sample i (upper 8 bits of 32): the second dimension of Sobol's sequence. */
static const uint8_t zbufrandi_accept_table[ZBUFRANDI_SET] = {
    0x00, 0x80, 0xc0, 0x40, 0xa0, 0x20, 0x60, 0xe0, 0xf0, 0x70, 0x30, 0xb0, 0x50, 0xd0, 0x90, 0x10,
    0x88, 0x08, 0x48, 0xc8, 0x28, 0xa8, 0xe8, 0x68, 0x78, 0xf8, 0xb8, 0x38, 0xd8, 0x58, 0x18, 0x98,
    0xcc, 0x4c, 0x0c, 0x8c, 0x6c, 0xec, 0xac, 0x2c, 0x3c, 0xbc, 0xfc, 0x7c, 0x9c, 0x1c, 0x5c, 0xdc,
    0x44, 0xc4, 0x84, 0x04, 0xe4, 0x64, 0x24, 0xa4, 0xb4, 0x34, 0x74, 0xf4, 0x14, 0x94, 0xd4, 0x54
};

typedef struct zbufrandi_target { /* where samples go */
    const zbufrandi_cut *cut;
    zbufrandi_keys keys;       /* one more key follows the last: what is thrown away goes there */
    uint8_t *aux;              /* triangles of samples of clusters */
    float width, height, center_x, center_y, far_z, inverse_focal;
    double focal;
    int plane, thin, exclusive, level;
    /* samples behind their pixel may be left out: the number of accepted ones is of no use then */
    int early;
} zbufrandi_target;

/* ---- stored samples ---- */

typedef struct zbufrandi_stored { /* constants of a draw, for points as grid numbers */
    float a[3][3], t[3];       /* f x, -f y, z = a q + t */
    float n[3][3];             /* rows x / f, -y / f, z of the camera: normal for these coordinates */
    float ih_ref, iz_ref, z_lo, iz_hi;
    const zbufrandi_view *view; /* NULL: points as likely as area makes them */
    const uint32_t *material;   /* of the points; NULL: all as `mask`, or nobody asks */
    zbufrandi_mask mask;
    int plane;
    uint32_t first, shift;     /* samples are taken in the order i ^ first; added to their random numbers */
} zbufrandi_stored;

/* Stored samples are taken in the order i ^ first. Frames that will be averaged take runs in turn that have none in
   common; what stands at one place begins with one of its own, the same in all frames. */
ZBUFRANDI_INLINE uint32_t zbufrandi_stored_first(const zbufrandi_cut *cut, const zbufrandi_draw *d,
                                                 const zbufrandi_local *l) {
    const uint32_t h = zbufrandi_hash32(d->hash + 0x85ebca6bu);
    if (cut->runs == 1) return h & (ZBUFRANDI_SET - 1u);
    return ((cut->run ^ zbufrandi_hash32(d->item ^ l->instance * 0x9e3779b1u)) & (cut->runs - 1u)) *
        (ZBUFRANDI_SET / cut->runs) + (h & (ZBUFRANDI_SET / cut->runs - 1u));
}

static void zbufrandi_stored_begin(const zbufrandi_target *target, const zbufrandi_draw *d, const zbufrandi_local *l,
                                   const zbufrandi_structure *structure, zbufrandi_stored *s) {
    float scale[3], inverse[3];
    int r, a;
    uint32_t h = zbufrandi_hash32(d->hash + 0x85ebca6bu);
    scale[0] = (float)target->focal;
    scale[1] = 0.0f - scale[0];
    scale[2] = inverse[2] = 1.0f;
    inverse[0] = target->inverse_focal;
    inverse[1] = 0.0f - inverse[0];
    for (r = 0; r < 3; r++) {
        double t = l->to_camera[r][3];
        for (a = 0; a < 3; a++) {
            t += l->to_camera[r][a] * ((double)d->lo[a] + 0.5 * (double)d->step[a]);
            s->a[r][a] = l->m[r][a] * d->step[a] * scale[r];
            s->n[r][a] = l->m[r][a] * inverse[r];
        }
        s->t[r] = (float)t * scale[r];
    }
    s->view = d->aux & ZBUFRANDI_STORED_VIEW
        ? &structure->view[((d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)) - structure->first_view) /
                           ZBUFRANDI_VIEW_SETS] : NULL;
    s->material = NULL;
    s->mask = zbufrandi_veil_mask(&target->cut->veil, structure->material);
    if (target->cut->veil.opacity != NULL && structure->set_material != NULL)
        s->material = structure->set_material + (size_t)(d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)) * ZBUFRANDI_SET;
    s->ih_ref = 1.0f / d->h_ref;
    s->plane = target->plane && (d->aux & ZBUFRANDI_STORED_FLAT) != 0;
    s->iz_ref = d->iz_ref;
    s->z_lo = d->z_lo;
    s->iz_hi = 1.0f / (d->z_hi < target->far_z ? d->z_hi : target->far_z);
    s->first = zbufrandi_stored_first(target->cut, d, l);
    s->shift = zbufrandi_hash32(h);
}

/* Is point i of the set one that a pixel shows? */
ZBUFRANDI_INLINE int zbufrandi_stored_shows(const zbufrandi_target *g, const zbufrandi_stored *s, uint32_t i,
                                            size_t pixel) {
    zbufrandi_mask m = s->mask;
    if (s->material != NULL) m = zbufrandi_veil_mask(&g->cut->veil, s->material[i]);
    return zbufrandi_mask_shows(&m, pixel);
}

typedef struct zbufrandi_spot { /* a sample in the picture */
    float x, y, z;             /* z: its own depth */
    float shown;               /* the depth its pixel gets */
    float slope[2];            /* of 1/z per pixel, to the right and downwards */
    uint32_t ix, iy;
} zbufrandi_spot;

/* Sample i of a set; word points at its words. 0: not seen. */
ZBUFRANDI_INLINE int zbufrandi_stored_sample(const zbufrandi_target *g, const zbufrandi_stored *s, const uint32_t *word,
                                             uint32_t i, zbufrandi_spot *out) {
    const float q0 = (float)(int32_t)(word[0] & 2047u), q1 = (float)(int32_t)(word[0] >> 11 & 1023u);
    const float q2 = (float)(int32_t)(word[0] >> 21 & 1023u);
    float v[3], p[3], n[3], h, iz, k, length, u;
    int r;
    zbufrandi_oct32_vector(word[8], v);
    for (r = 0; r < 3; r++) {
        p[r] = s->a[r][0] * q0 + s->a[r][1] * q1 + s->a[r][2] * q2 + s->t[r];
        n[r] = s->n[r][0] * v[0] + s->n[r][1] * v[1] + s->n[r][2] * v[2];
    }
    h = 0.0f - (n[0] * p[0] + n[1] * p[1] + n[2] * p[2]);
    if ((word[0] >> 31) != 0 && h < 0.0f) {
        h = 0.0f - h;
        for (r = 0; r < 3; r++) n[r] = 0.0f - n[r];
    }
    iz = 1.0f / p[2];
    out->x = p[0] * iz + g->center_x;
    out->y = p[1] * iz + g->center_y;
    if (!(h > 0.0f && p[2] > 0.0f && p[2] <= g->far_z && out->x >= 0.0f && out->x < g->width && out->y >= 0.0f &&
          out->y < g->height)) return 0;
    if (g->thin) {
        length = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; /* squared, as both sides are */
        k = p[2] * s->iz_ref;
        u = zbufrandi_unit24(((uint32_t)zbufrandi_accept_table[i] << 24) + s->shift) * (k * k * k);
        k = h * s->ih_ref;
        if (s->view != NULL) { /* some were more likely than others */
            length = zbufrandi_view_weight(s->view, v, sqrtf(length), word[0] >> 31 != 0);
            length = length * length;
        }
        if (!(u * u * length < k * k)) return 0;
    }
    out->ix = (uint32_t)(int32_t)out->x;
    out->iy = (uint32_t)(int32_t)out->y;
    if (g->cut->veil.opacity != NULL &&
        !zbufrandi_stored_shows(g, s, i, (size_t)out->iy * g->keys.width + out->ix)) return 0;
    out->z = p[2];
    out->shown = p[2];
    if (s->plane) { /* 1/z of the plane at the centre of the pixel */
        const float dx = (float)(int32_t)out->ix + 0.5f - out->x, dy = (float)(int32_t)out->iy + 0.5f - out->y;
        float den = h * iz - (n[0] * dx + n[1] * dy), least = h * s->iz_hi, z;
        den = den > least ? den : least;
        z = h / den;
        out->shown = z > s->z_lo ? z : s->z_lo;
    }
    out->slope[0] = 0.0f - n[0] / h; /* used where there is no hurry */
    out->slope[1] = 0.0f - n[1] / h;
    return 1;
}

ZBUFRANDI_INLINE void zbufrandi_target_put(const zbufrandi_target *g, size_t at, uint64_t key) {
    if (!g->exclusive) zbufrandi_key_min(&g->keys.key[at], key);
    else if (key < g->keys.key[at]) g->keys.key[at] = key;
}

/* Samples wait here until there are enough of them, with their pixels on the way from memory meanwhile. */
enum { ZBUFRANDI_WAIT = 192 };
typedef struct zbufrandi_waiting {
    uint32_t pixel[ZBUFRANDI_WAIT + 8], low[ZBUFRANDI_WAIT + 8], high[ZBUFRANDI_WAIT + 8];
    uint32_t count;
    uint32_t inside, tried;    /* stored samples in the picture; of those, not left out early: for the statistics */
} zbufrandi_waiting;

static void zbufrandi_waiting_put(const zbufrandi_target *g, zbufrandi_waiting *w) {
    uint32_t k;
    if (g->exclusive) {
        for (k = 0; k < w->count; k++) {
            uint64_t *to = &g->keys.key[w->pixel[k]];
            const uint64_t key = (uint64_t)w->high[k] << 32 | w->low[k], old = *to;
            /* no branch: which way it would go nobody can tell */
            *to = old ^ ((old ^ key) & (0u - (uint64_t)(key < old)));
        }
    } else {
        for (k = 0; k < w->count; k++)
            zbufrandi_key_min(&g->keys.key[w->pixel[k]], (uint64_t)w->high[k] << 32 | w->low[k]);
    }
    w->count = 0;
}

/* ---- eight stored samples at a time: the operations of zbufrandi_stored_sample, one for one ---- */

#if ZBUFRANDI_AVX2
/* Lanes of a mask into the list. fetch: their pixels have not been looked at yet. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_put8(const zbufrandi_target *g, zbufrandi_waiting *w, __m256i at,
                                                           __m256 z,
                                                           __m256i number, uint32_t mask, const int fetch) {
    const uint64_t lanes = _pext_u64(0x0706050403020100u, _pdep_u64(mask, 0x0101010101010101u) * 255u);
    const __m256i order = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)lanes));
    uint32_t k, n = (uint32_t)__builtin_popcount(mask);
    _mm256_storeu_si256((__m256i *)(void *)(w->pixel + w->count), _mm256_permutevar8x32_epi32(at, order));
    _mm256_storeu_si256((__m256i *)(void *)(w->low + w->count),
                        _mm256_permutevar8x32_epi32(zbufrandi_mix8(number), order));
    _mm256_storeu_si256((__m256i *)(void *)(w->high + w->count),
                        _mm256_permutevar8x32_epi32(_mm256_castps_si256(z), order));
    if (fetch) {
        for (k = 0; k < n; k++) ZBUFRANDI_PREFETCH(&g->keys.key[w->pixel[w->count + k]]);
    }
    w->count += n;
    if (w->count >= ZBUFRANDI_WAIT) zbufrandi_waiting_put(g, w);
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_dot8(const float a[3], __m256 x, __m256 y, __m256 z) {
    return _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(_mm256_set1_ps(a[0]), x), _mm256_mul_ps(_mm256_set1_ps(a[1]), y)),
                         _mm256_mul_ps(_mm256_set1_ps(a[2]), z));
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_stored_inside8(const zbufrandi_target *g, __m256 x, __m256 y,
                                                                       __m256 z) {
    const __m256 zero = _mm256_setzero_ps();
    __m256 ok = _mm256_and_ps(_mm256_cmp_ps(z, zero, _CMP_GT_OQ),
                              _mm256_cmp_ps(z, _mm256_set1_ps(g->far_z), _CMP_LE_OQ));
    ok = _mm256_and_ps(ok, _mm256_and_ps(_mm256_cmp_ps(x, zero, _CMP_GE_OQ),
                                         _mm256_cmp_ps(x, _mm256_set1_ps(g->width), _CMP_LT_OQ)));
    return _mm256_and_ps(ok, _mm256_and_ps(_mm256_cmp_ps(y, zero, _CMP_GE_OQ),
                                           _mm256_cmp_ps(y, _mm256_set1_ps(g->height), _CMP_LT_OQ)));
}

/* Normals as they are stored, of any length. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_stored_normals8(__m256i w, __m256 *x, __m256 *y, __m256 *z) {
    const __m256 sign = _mm256_set1_ps(-0.0f), one = _mm256_set1_ps(1.0f), zero = _mm256_setzero_ps();
    __m256 vx = _mm256_cvtepi32_ps(_mm256_and_si256(w, _mm256_set1_epi32(65535)));
    __m256 vy = _mm256_cvtepi32_ps(_mm256_srli_epi32(w, 16)), t;
    vx = _mm256_sub_ps(_mm256_mul_ps(vx, _mm256_set1_ps(2.0f / 65535.0f)), one);
    vy = _mm256_sub_ps(_mm256_mul_ps(vy, _mm256_set1_ps(2.0f / 65535.0f)), one);
    *z = _mm256_sub_ps(_mm256_sub_ps(one, _mm256_andnot_ps(sign, vx)), _mm256_andnot_ps(sign, vy));
    t = _mm256_min_ps(*z, zero); /* folded: x < 0 ? x - t : x + t */
    *x = _mm256_add_ps(vx, _mm256_xor_ps(t, _mm256_and_ps(sign, _mm256_cmp_ps(vx, zero, _CMP_LT_OQ))));
    *y = _mm256_add_ps(vy, _mm256_xor_ps(t, _mm256_and_ps(sign, _mm256_cmp_ps(vy, zero, _CMP_LT_OQ))));
}

/* Which of samples first..first+7 thinning keeps, all squared to be spared the root of the length of v. w: their first
   words, z: depths, h: how much their normals v are turned to the eye. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_stored_keeps8(const zbufrandi_stored *s, uint32_t first,
                                                                      __m256i w, __m256 z, __m256 h, __m256 vx,
                                                                      __m256 vy, __m256 vz, const int two_sided,
                                                                      const int viewed) {
    const __m256 zero = _mm256_setzero_ps();
    const __m128i *table = (const __m128i *)(const void *)(zbufrandi_accept_table + first);
    __m256 length = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(vx, vx), _mm256_mul_ps(vy, vy)), _mm256_mul_ps(vz, vz));
    __m256i bits = _mm256_cvtepu8_epi32(_mm_loadl_epi64(table));
    __m256 u;
    z = _mm256_mul_ps(z, _mm256_set1_ps(s->iz_ref));
    bits = _mm256_add_epi32(_mm256_slli_epi32(bits, 24), _mm256_set1_epi32((int)s->shift));
    u = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(bits, 8)), _mm256_set1_ps(1.0f / 16777216.0f));
    u = _mm256_mul_ps(u, _mm256_mul_ps(_mm256_mul_ps(z, z), z));
    z = _mm256_mul_ps(h, _mm256_set1_ps(s->ih_ref));
    if (viewed) {
        __m256 c = zbufrandi_dot8(s->view->axis, vx, vy, vz);
        length = _mm256_sqrt_ps(length);
        if (two_sided) {
            c = _mm256_blendv_ps(c, _mm256_sub_ps(zero, c), _mm256_and_ps(
                _mm256_castsi256_ps(_mm256_srai_epi32(w, 31)), _mm256_cmp_ps(c, zero, _CMP_LT_OQ)));
        }
        c = _mm256_add_ps(c, _mm256_mul_ps(_mm256_set1_ps(s->view->reach), length));
        c = _mm256_min_ps(c, length);
        length = _mm256_mul_ps(c, c);
    }
    return _mm256_cmp_ps(_mm256_mul_ps(_mm256_mul_ps(u, u), length), _mm256_mul_ps(z, z), _CMP_LT_OQ);
}

/* early: leave out at once what is behind its pixel; only where a sample's own depth is what is shown. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE uint32_t zbufrandi_stored_eights(const zbufrandi_target *g,
        const zbufrandi_draw *d, const zbufrandi_local *l,
                                                               const zbufrandi_structure *structure,
                                                               const uint32_t *set, zbufrandi_waiting *wait,
                                                               const int plane, const int two_sided, const int early,
                                                               const int viewed) {
    const __m256 one = _mm256_set1_ps(1.0f), zero = _mm256_setzero_ps(), half = _mm256_set1_ps(0.5f);
    const __m256i lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    zbufrandi_stored s;
    uint32_t k, accepted = 0, inside = 0, tried = 0;
    zbufrandi_stored_begin(g, d, l, structure, &s);
    for (k = 0; k < d->count; k += 8) { /* samples k..k+7 of the order are some eight that stand together */
        const uint32_t first = (k ^ s.first) & ~7u;
        const __m256i w0 = _mm256_loadu_si256((const __m256i *)(const void *)(set + 2 * first));
        const __m256i w1 = _mm256_loadu_si256((const __m256i *)(const void *)(set + 2 * first + 8));
        __m256 q0, q1, q2, vx, vy, vz, px, py, pz, nx, ny, nz, h, iz, x, y, ok;
        __m256i ix, iy, at;
        uint32_t mask;
        q0 = _mm256_cvtepi32_ps(_mm256_and_si256(w0, _mm256_set1_epi32(2047)));
        q1 = _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32(w0, 11), _mm256_set1_epi32(1023)));
        q2 = _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32(w0, 21), _mm256_set1_epi32(1023)));
        pz = _mm256_add_ps(zbufrandi_dot8(s.a[2], q0, q1, q2), _mm256_set1_ps(s.t[2]));
        iz = _mm256_div_ps(one, pz);
        px = _mm256_add_ps(zbufrandi_dot8(s.a[0], q0, q1, q2), _mm256_set1_ps(s.t[0]));
        py = _mm256_add_ps(zbufrandi_dot8(s.a[1], q0, q1, q2), _mm256_set1_ps(s.t[1]));
        x = _mm256_add_ps(_mm256_mul_ps(px, iz), _mm256_set1_ps(g->center_x));
        y = _mm256_add_ps(_mm256_mul_ps(py, iz), _mm256_set1_ps(g->center_y));
        ok = zbufrandi_stored_inside8(g, x, y, pz);
        if (d->count - k < 8) { /* the last ones of the order, wherever they stand */
            const __m256i order = _mm256_xor_si256(lanes, _mm256_set1_epi32((int)(s.first & 7u)));
            ok = _mm256_and_ps(ok,
                               _mm256_castsi256_ps(_mm256_cmpgt_epi32(_mm256_set1_epi32((int)(d->count - k)), order)));
        }
        ix = _mm256_cvttps_epi32(x);
        iy = _mm256_cvttps_epi32(y);
        at = _mm256_add_epi32(_mm256_mullo_epi32(iy, _mm256_set1_epi32((int)g->keys.width)), ix);
        inside += (uint32_t)__builtin_popcount((uint32_t)_mm256_movemask_ps(ok));
        if (early) { /* depths of finite keys are positive: bits compare like numbers */
            const __m256i depth = _mm256_mask_i32gather_epi32(_mm256_setzero_si256(),
                                                              (const int *)(const void *)g->keys.key + 1, at,
                                                              _mm256_castps_si256(ok), 8);
            ok = _mm256_andnot_ps(_mm256_castsi256_ps(_mm256_andnot_si256(_mm256_srai_epi32(depth, 31),
                                                                          _mm256_cmpgt_epi32(_mm256_castps_si256(pz),
                                                                                             depth))), ok);
            mask = (uint32_t)_mm256_movemask_ps(ok);
            if (mask == 0) continue;
            tried += (uint32_t)__builtin_popcount(mask);
        }
        zbufrandi_stored_normals8(w1, &vx, &vy, &vz);
        nx = zbufrandi_dot8(s.n[0], vx, vy, vz);
        ny = zbufrandi_dot8(s.n[1], vx, vy, vz);
        nz = zbufrandi_dot8(s.n[2], vx, vy, vz);
        h = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(nx, px), _mm256_mul_ps(ny, py)), _mm256_mul_ps(nz, pz));
        h = _mm256_sub_ps(zero, h);
        if (two_sided) { /* turn to the eye. Subtracting from 0 is what the scalar form does, too */
            const __m256 two = _mm256_and_ps(_mm256_castsi256_ps(_mm256_srai_epi32(w0, 31)),
                                             _mm256_cmp_ps(h, zero, _CMP_LT_OQ));
            h = _mm256_blendv_ps(h, _mm256_sub_ps(zero, h), two);
            nx = _mm256_blendv_ps(nx, _mm256_sub_ps(zero, nx), two);
            ny = _mm256_blendv_ps(ny, _mm256_sub_ps(zero, ny), two);
        }
        ok = _mm256_and_ps(ok, _mm256_cmp_ps(h, zero, _CMP_GT_OQ));
        if (g->thin)
            ok = _mm256_and_ps(ok, zbufrandi_stored_keeps8(&s, first, w0, pz, h, vx, vy, vz, two_sided, viewed));
        mask = (uint32_t)_mm256_movemask_ps(ok);
        if (g->cut->veil.opacity != NULL) {
            uint32_t pixel[8], lane;
            _mm256_storeu_si256((__m256i *)(void *)pixel, at);
            for (lane = 0; lane < 8; lane++) {
                if ((mask >> lane & 1u) != 0 && !zbufrandi_stored_shows(g, &s, first + lane, pixel[lane]))
                    mask &= ~(1u << lane);
            }
        }
        if (mask == 0) continue;
        if (plane) {
            const __m256 dx = _mm256_sub_ps(_mm256_add_ps(_mm256_cvtepi32_ps(ix), half), x);
            const __m256 dy = _mm256_sub_ps(_mm256_add_ps(_mm256_cvtepi32_ps(iy), half), y);
            const __m256 least = _mm256_mul_ps(h, _mm256_set1_ps(s.iz_hi));
            __m256 den = _mm256_sub_ps(_mm256_mul_ps(h, iz),
                                       _mm256_add_ps(_mm256_mul_ps(nx, dx), _mm256_mul_ps(ny, dy)));
            den = _mm256_max_ps(den, least);
            pz = _mm256_max_ps(_mm256_div_ps(h, den), _mm256_set1_ps(s.z_lo));
        }
        zbufrandi_put8(g, wait, at, pz,
                _mm256_add_epi32(lanes, _mm256_set1_epi32((int)(d->block * ZBUFRANDI_SET + first))), mask, !early);
        accepted += (uint32_t)__builtin_popcount(mask);
    }
    wait->inside += inside;
    wait->tried += early ? tried : inside;
    return accepted;
}

ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_draw_stored_avx2(const zbufrandi_target *g, const zbufrandi_draw *d,
                                                                 const zbufrandi_local *l,
                                                                 const zbufrandi_structure *structure,
                                                                 const uint32_t *set, zbufrandi_waiting *wait) {
    const int two = (d->aux & ZBUFRANDI_STORED_TWO_SIDED) != 0, viewed = (d->aux & ZBUFRANDI_STORED_VIEW) != 0;
    if (g->plane && (d->aux & ZBUFRANDI_STORED_FLAT) != 0) {
        if (viewed) return zbufrandi_stored_eights(g, d, l, structure, set, wait, 1, 1, 0, 1);
        return two ? zbufrandi_stored_eights(g, d, l, structure, set, wait, 1, 1, 0, 0)
                   : zbufrandi_stored_eights(g, d, l, structure, set, wait, 1, 0, 0, 0);
    }
    if (viewed) return g->early ? zbufrandi_stored_eights(g, d, l, structure, set, wait, 0, 1, 1, 1)
                                : zbufrandi_stored_eights(g, d, l, structure, set, wait, 0, 1, 0, 1);
    if (g->early) return two ? zbufrandi_stored_eights(g, d, l, structure, set, wait, 0, 1, 1, 0)
                             : zbufrandi_stored_eights(g, d, l, structure, set, wait, 0, 0, 1, 0);
    return two ? zbufrandi_stored_eights(g, d, l, structure, set, wait, 0, 1, 0, 0)
               : zbufrandi_stored_eights(g, d, l, structure, set, wait, 0, 0, 0, 0);
}
#endif

static uint32_t zbufrandi_draw_stored(const zbufrandi_target *g, const zbufrandi_draw *d, const zbufrandi_local *l,
                                      const zbufrandi_structure *structure, zbufrandi_waiting *wait) {
    const uint32_t *set = structure->set + (size_t)(d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)) *
        (2 * ZBUFRANDI_SET);
    zbufrandi_stored s;
    zbufrandi_spot seen;
    uint32_t k, accepted = 0;
#if ZBUFRANDI_AVX2
    if (g->level >= 3) return zbufrandi_draw_stored_avx2(g, d, l, structure, set, wait);
#endif
    wait->inside += d->count;
    wait->tried += d->count;
    zbufrandi_stored_begin(g, d, l, structure, &s);
    for (k = 0; k < d->count; k++) {
        uint32_t i = k ^ s.first;
        if (!zbufrandi_stored_sample(g, &s, set + zbufrandi_set_at(i), i, &seen)) continue;
        zbufrandi_target_put(g, (size_t)seen.iy * g->keys.width + seen.ix,
                             zbufrandi_key(seen.shown, d->block * ZBUFRANDI_SET + i));
        accepted++;
    }
    return accepted;
}

/* ---- samples of clusters ---- */

enum { ZBUFRANDI_FLAT_CHUNK = 512 };

typedef struct zbufrandi_flat { /* a cluster in the picture */
    float v[ZBUFRANDI_CLUSTER_VERTICES + 8][4];      /* x, y, 1/z, nothing */
    uint32_t sum[ZBUFRANDI_CLUSTER_TRIANGLES + 8];   /* areas added up, in units of `unit` */
    zbufrandi_mask mask;                             /* of the material */
    uint8_t triangle[ZBUFRANDI_FLAT_CHUNK + 32];     /* of the samples at work */
    float unit;                                      /* twice the area in pixels is sum / unit */
    uint32_t total;
    float step;                                      /* strata for each unit of sum */
    uint32_t hash, each;                             /* place of sample j in its stratum: of hash + each * j */
} zbufrandi_flat;

typedef struct zbufrandi_flatten { /* constants of a draw */
    float m[3][3], rest[3], eye[3], turn;
} zbufrandi_flatten;

static void zbufrandi_flatten_begin(const zbufrandi_target *g, const zbufrandi_draw *d, const zbufrandi_local *l,
                                    zbufrandi_flatten *c, zbufrandi_flat *f) {
    const float fx = (float)g->focal;
    const zbufrandi_structure *s = &g->cut->scene->structure[l->structure];
    uint32_t i;
    f->mask = zbufrandi_veil_cluster(&g->cut->veil, &s->cluster[d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)]);
    for (i = 0; i < 3; i++) {
        c->m[0][i] = l->m[0][i] * fx;
        c->m[1][i] = l->m[1][i] * (0.0f - fx);
        c->m[2][i] = l->m[2][i];
        c->eye[i] = l->eye[i];
    }
    c->rest[0] = l->rest[0] * fx;
    c->rest[1] = l->rest[1] * (0.0f - fx);
    c->rest[2] = l->rest[2];
    c->turn = l->mirrored ? 1.0f : -1.0f;
    /* 2^29 over the bound: twice the area is at most 2^30 */
    f->unit = 536870912.0f / (d->h_ref > 1e-25f ? d->h_ref : 1e-25f);
}

static void zbufrandi_flatten_cluster(const zbufrandi_target *g, const zbufrandi_flatten *k,
                                      const zbufrandi_structure *s,
                                      const zbufrandi_cluster *c, zbufrandi_flat *f) {
    const float *p = s->position + 3 * (size_t)c->first_vertex;
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    uint32_t i, sum = 0;
    for (i = 0; i < c->vertex_count; i++) {
        const float x = p[3 * i] - k->eye[0], y = p[3 * i + 1] - k->eye[1], z = p[3 * i + 2] - k->eye[2];
        const float iz = 1.0f / (k->m[2][0] * x + k->m[2][1] * y + k->m[2][2] * z + k->rest[2]);
        f->v[i][0] = (k->m[0][0] * x + k->m[0][1] * y + k->m[0][2] * z + k->rest[0]) * iz + g->center_x;
        f->v[i][1] = (k->m[1][0] * x + k->m[1][1] * y + k->m[1][2] * z + k->rest[1]) * iz + g->center_y;
        f->v[i][2] = iz;
    }
    for (i = 0; i < c->triangle_count; i++) {
        const float *a = f->v[tri[3 * i]], *b = f->v[tri[3 * i + 1]], *e = f->v[tri[3 * i + 2]];
        float w = ((b[0] - a[0]) * (e[1] - a[1]) - (b[1] - a[1]) * (e[0] - a[0])) * k->turn;
        if (c->flags & ZBUFRANDI_TWO_SIDED) w = zbufrandi_absf(w);
        w = w * f->unit;
        w = w > 0.0f ? w : 0.0f; /* NaN, too */
        w = w < 1073741824.0f ? w : 1073741824.0f;
        sum += (uint32_t)(int32_t)w;
        sum = sum < 1073741824u ? sum : 1073741824u; /* areas that are rounding errors may be above the bound */
        f->sum[i] = sum;
    }
    f->total = sum;
}

/* Number of samples: floor(expected + u), or a Poisson number. */
static uint32_t zbufrandi_flat_count(const zbufrandi_target *g, const zbufrandi_draw *d, const zbufrandi_flat *f) {
    float expected = (float)g->cut->density * 0.5f * ((float)f->total / f->unit);
    uint32_t k = 0, h = d->hash;
    if (f->total == 0) return 0;
    if (!g->cut->independent) {
        k = (uint32_t)(expected + zbufrandi_unit24(d->hash));
    } else {
        double left = (double)expected, product;
        while (left > 0.0) { /* sums of Poisson numbers are Poisson numbers */
            double part = left > 16.0 ? 16.0 : left, floor_at = zbufrandi_exp2(-part * 1.4426950408889634);
            product = 1.0;
            for (;;) {
                h = zbufrandi_hash32(h + 0x9e3779b9u);
                product *= ((double)h + 0.5) * (1.0 / 4294967296.0);
                if (product < floor_at) break;
                k++;
            }
            left -= part;
        }
    }
    return k > d->count ? d->count : k;
}

/* The strata of k samples, before one of them is looked at. */
static void zbufrandi_flat_begin(const zbufrandi_draw *d, uint32_t k, int comb, zbufrandi_flat *f) {
    f->step = (float)(int32_t)k / (float)(int32_t)(f->total > 0 ? f->total : 1u);
    f->hash = d->hash + 0x7f4a7c15u;
    f->each = comb ? 0u : 0x9e3779b1u;
}

ZBUFRANDI_INLINE float zbufrandi_jitter(const zbufrandi_flat *f, uint32_t j) { /* place of sample j in its stratum */
    return zbufrandi_unit24(zbufrandi_hash32(f->hash + j * f->each));
}

/* Triangles of the samples begin <= j < end of k independent ones. */
static void zbufrandi_flat_independent(const zbufrandi_draw *d, zbufrandi_flat *f, uint32_t triangles, uint32_t begin,
                                       uint32_t end) {
    uint32_t j, t;
    for (j = begin; j < end; j++) {
        const double u = (double)zbufrandi_hash32(d->hash ^ zbufrandi_hash32(j + 1)) * (1.0 / 4294967296.0);
        const uint32_t y = (uint32_t)(u * (double)f->total);
        uint32_t lo = 0, hi = triangles - 1;
        while (lo < hi) { /* first with sum > y */
            t = (lo + hi) / 2;
            if (f->sum[t] > y) hi = t;
            else lo = t + 1;
        }
        f->triangle[j - begin] = (uint8_t)lo;
    }
}

/* The same for stratified ones. Samples before the end of a triangle: the whole strata, and that of the stratum in
   which it ends if it lies before the end. */
static void zbufrandi_flat_strata(zbufrandi_flat *f, uint32_t triangles, uint32_t k, uint32_t begin, uint32_t end) {
    uint32_t t, j, before = 0;
    for (t = 0; t < triangles; t++) {
        const float at = (float)(int32_t)f->sum[t] * f->step;
        const uint32_t whole = (uint32_t)(int32_t)at;
        uint32_t after = whole + (zbufrandi_jitter(f, whole) < at - (float)(int32_t)whole ? 1u : 0u);
        if (f->sum[t] == f->total || after > k) after = k;
        for (j = before > begin ? before : begin; j < after && j < end; j++) f->triangle[j - begin] = (uint8_t)t;
        before = after;
    }
}

/* Place on its triangle of sample j of a page of points: weights of its corners. */
ZBUFRANDI_INLINE void zbufrandi_flat_weights(uint32_t at_u, uint32_t at_v, uint32_t j, int independent, float *u,
                                             float *v) {
    uint32_t a, b;
    if (independent) {
        a = zbufrandi_hash32(at_u + j * 0x9e3779b1u);
        b = zbufrandi_hash32(a + 0x85ebca6bu);
    } else { /* R2 */
        a = at_u + j * 3242174889u;
        b = at_v + j * 2447445414u;
    }
    *u = zbufrandi_unit24(a);
    *v = zbufrandi_unit24(b);
    zbufrandi_square_to_triangle(u, v);
}

/* The same in the picture for sample j of triangle t of a cluster. Stratified: how far along the triangle's area the
   sample is says how far from its third corner, a golden sequence where between the other two: all that fall on a
   triangle, few or many, are spread as those of a lattice are, and go on where those before the triangle ended. */
ZBUFRANDI_INLINE void zbufrandi_flat_place(const zbufrandi_flat *f, uint32_t at_u, uint32_t at_v, uint32_t j,
                                           uint32_t t, int independent, float *u, float *v) {
    float lo, hi, r;
    if (independent) {
        zbufrandi_flat_weights(at_u, at_v, j, 1, u, v);
        return;
    }
    lo = t > 0 ? (float)(int32_t)f->sum[t - 1] * f->step : 0.0f;
    hi = (float)(int32_t)f->sum[t] * f->step;
    r = (((float)(int32_t)j + zbufrandi_jitter(f, j)) - lo) / (hi - lo);
    r = r > 0.0f ? r : 0.0f; /* NaN, too */
    r = sqrtf(r < 1.0f ? r : 1.0f);
    *u = r * zbufrandi_unit24(at_v + j * 2654435769u);
    *v = 1.0f - r;
}

/* Sample j of triangle t. 0: not in the picture. */
ZBUFRANDI_INLINE int zbufrandi_flat_sample(const zbufrandi_target *g, const zbufrandi_flat *f, const uint8_t *tri,
                                           uint32_t at_u,
                                           uint32_t at_v, uint32_t j, uint32_t t, zbufrandi_spot *out) {
    const float *a = f->v[tri[3 * t]], *b = f->v[tri[3 * t + 1]], *c = f->v[tri[3 * t + 2]];
    float u, v, w, iz;
    zbufrandi_flat_place(f, at_u, at_v, j, t, g->cut->independent, &u, &v);
    w = 1.0f - u - v;
    out->x = a[0] * w + b[0] * u + c[0] * v;
    out->y = a[1] * w + b[1] * u + c[1] * v;
    iz = a[2] * w + b[2] * u + c[2] * v;
    if (!(out->x >= 0.0f && out->x < g->width && out->y >= 0.0f && out->y < g->height)) return 0;
    out->ix = (uint32_t)(int32_t)out->x;
    out->iy = (uint32_t)(int32_t)out->y;
    if (!zbufrandi_mask_shows(&f->mask, (size_t)out->iy * g->keys.width + out->ix)) return 0;
    out->z = 1.0f / iz;
    out->slope[0] = out->slope[1] = 0.0f;
    if (g->plane) { /* 1/z of the plane at the centre of the pixel, within that of the corners */
        const float dx = (float)(int32_t)out->ix + 0.5f - out->x, dy = (float)(int32_t)out->iy + 0.5f - out->y;
        const float bx = b[0] - a[0], by = b[1] - a[1], bz = b[2] - a[2], cx = c[0] - a[0], cy = c[1] - a[1],
            cz = c[2] - a[2];
        const float area = bx * cy - by * cx;
        float lo = b[2] < a[2] ? b[2] : a[2], hi = b[2] > a[2] ? b[2] : a[2];
        lo = c[2] < lo ? c[2] : lo;
        hi = c[2] > hi ? c[2] : hi;
        out->slope[0] = (bz * cy - cz * by) / area;
        out->slope[1] = (cz * bx - bz * cx) / area;
        iz = iz + (out->slope[0] * dx + out->slope[1] * dy);
        iz = iz > lo ? iz : lo; /* lo if the slope is NaN */
        iz = iz < hi ? iz : hi;
    }
    out->shown = 1.0f / iz;
    return out->shown <= g->far_z;
}

#if ZBUFRANDI_AVX2
/* The first three floats of corner k of the triangles t[0..7]: vertex v is at p + stride * v, followed by at least one
   float more that may be read. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_fetch8(const float *p, uint32_t stride, const uint8_t *tri,
                                                             const uint32_t t[8], uint32_t k,
                                                             __m256 *x, __m256 *y, __m256 *z) {
    __m256 r[4], a, b;
    uint32_t i;
    for (i = 0; i < 4; i++) {
        r[i] = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p + stride * tri[3 * t[i] + k])),
                                    _mm_loadu_ps(p + stride * tri[3 * t[i + 4] + k]), 1);
    }
    a = _mm256_unpacklo_ps(r[0], r[1]);
    b = _mm256_unpacklo_ps(r[2], r[3]);
    *x = _mm256_shuffle_ps(a, b, 0x44);
    *y = _mm256_shuffle_ps(a, b, 0xee);
    a = _mm256_unpackhi_ps(r[0], r[1]);
    b = _mm256_unpackhi_ps(r[2], r[3]);
    *z = _mm256_shuffle_ps(a, b, 0x44);
}

ZBUFRANDI_TARGET_AVX2 static void zbufrandi_flatten_cluster_avx2(const zbufrandi_target *g, const zbufrandi_flatten *k,
                                                                 const zbufrandi_structure *s,
                                                                     const zbufrandi_cluster *c, zbufrandi_flat *f) {
    const float *p = s->position + 3 * (size_t)c->first_vertex;
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    const __m256 keep = _mm256_castsi256_ps(_mm256_set1_epi32(c->flags & ZBUFRANDI_TWO_SIDED ? 0x7fffffff : -1));
    uint32_t i, j, sum = 0;
    for (i = 0; i < c->vertex_count; i += 8) { /* three floats each: they are followed by enough that may be read */
        const float *q = p + 3 * (size_t)i;
        __m256 a = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(q)), _mm_loadu_ps(q + 12), 1);
        __m256 b = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(q + 4)), _mm_loadu_ps(q + 16), 1);
        __m256 e = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(q + 8)), _mm_loadu_ps(q + 20), 1);
        __m256 xy = _mm256_shuffle_ps(b, e, _MM_SHUFFLE(2, 1, 3, 2)),
            yz = _mm256_shuffle_ps(a, b, _MM_SHUFFLE(1, 0, 2, 1));
        __m256 x = _mm256_shuffle_ps(a, xy, _MM_SHUFFLE(2, 0, 3, 0)),
            y = _mm256_shuffle_ps(yz, xy, _MM_SHUFFLE(3, 1, 2, 0));
        __m256 z = _mm256_shuffle_ps(yz, e, _MM_SHUFFLE(3, 0, 3, 1)), iz, px, py;
        x = _mm256_sub_ps(x, _mm256_set1_ps(k->eye[0]));
        y = _mm256_sub_ps(y, _mm256_set1_ps(k->eye[1]));
        z = _mm256_sub_ps(z, _mm256_set1_ps(k->eye[2]));
        iz = _mm256_div_ps(_mm256_set1_ps(1.0f),
                           _mm256_add_ps(zbufrandi_dot8(k->m[2], x, y, z), _mm256_set1_ps(k->rest[2])));
        px = _mm256_mul_ps(_mm256_add_ps(zbufrandi_dot8(k->m[0], x, y, z), _mm256_set1_ps(k->rest[0])), iz);
        py = _mm256_mul_ps(_mm256_add_ps(zbufrandi_dot8(k->m[1], x, y, z), _mm256_set1_ps(k->rest[1])), iz);
        px = _mm256_add_ps(px, _mm256_set1_ps(g->center_x));
        py = _mm256_add_ps(py, _mm256_set1_ps(g->center_y));
        a = _mm256_unpacklo_ps(px, py);
        b = _mm256_unpackhi_ps(px, py);
        xy = _mm256_unpacklo_ps(iz, iz);
        yz = _mm256_unpackhi_ps(iz, iz);
        x = _mm256_shuffle_ps(a, xy, 0x44); /* vertices 0 and 4 */
        y = _mm256_shuffle_ps(a, xy, 0xee); /* 1 and 5 */
        z = _mm256_shuffle_ps(b, yz, 0x44);
        e = _mm256_shuffle_ps(b, yz, 0xee);
        _mm256_storeu_ps(f->v[i], _mm256_permute2f128_ps(x, y, 0x20));
        _mm256_storeu_ps(f->v[i + 2], _mm256_permute2f128_ps(z, e, 0x20));
        _mm256_storeu_ps(f->v[i + 4], _mm256_permute2f128_ps(x, y, 0x31));
        _mm256_storeu_ps(f->v[i + 6], _mm256_permute2f128_ps(z, e, 0x31));
    }
    for (i = 0; i < c->triangle_count; i += 8) {
        __m256 ax, ay, bx, by, ex, ey, z, w;
        uint32_t t[8];
        for (j = 0; j < 8; j++) t[j] = i + j < c->triangle_count ? i + j : c->triangle_count - 1u;
        zbufrandi_fetch8(f->v[0], 4, tri, t, 0, &ax, &ay, &z);
        zbufrandi_fetch8(f->v[0], 4, tri, t, 1, &bx, &by, &z);
        zbufrandi_fetch8(f->v[0], 4, tri, t, 2, &ex, &ey, &z);
        w = _mm256_sub_ps(_mm256_mul_ps(_mm256_sub_ps(bx, ax), _mm256_sub_ps(ey, ay)),
                          _mm256_mul_ps(_mm256_sub_ps(by, ay), _mm256_sub_ps(ex, ax)));
        w = _mm256_and_ps(_mm256_mul_ps(w, _mm256_set1_ps(k->turn)), keep);
        w = _mm256_mul_ps(w, _mm256_set1_ps(f->unit));
        w = _mm256_min_ps(_mm256_max_ps(w, _mm256_setzero_ps()), _mm256_set1_ps(1073741824.0f));
        _mm256_storeu_si256((__m256i *)(void *)(f->sum + i), _mm256_cvttps_epi32(w));
    }
    for (i = 0; i < c->triangle_count; i++) {
        sum += f->sum[i];
        sum = sum < 1073741824u ? sum : 1073741824u;
        f->sum[i] = sum;
    }
    f->total = sum;
}

ZBUFRANDI_TARGET_AVX2 static void zbufrandi_flat_strata_avx2(zbufrandi_flat *f, uint32_t triangles, uint32_t k) {
    const __m256i each = _mm256_set1_epi32((int)f->each);
    const __m256 step = _mm256_set1_ps(f->step);
    const __m256i most = _mm256_set1_epi32((int)k), total = _mm256_set1_epi32((int)f->total);
    uint32_t after[ZBUFRANDI_CLUSTER_TRIANGLES], t, before = 0;
    for (t = 0; t < triangles; t += 8) {
        const __m256i sum = _mm256_loadu_si256((const __m256i *)(const void *)(f->sum + t));
        const __m256 at = _mm256_mul_ps(_mm256_cvtepi32_ps(sum), step);
        const __m256i whole = _mm256_cvttps_epi32(at);
        __m256i h = _mm256_add_epi32(_mm256_mullo_epi32(whole, each), _mm256_set1_epi32((int)f->hash));
        __m256 u = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(zbufrandi_mix8(h), 8)),
                                 _mm256_set1_ps(1.0f / 16777216.0f));
        u = _mm256_cmp_ps(u, _mm256_sub_ps(at, _mm256_cvtepi32_ps(whole)), _CMP_LT_OQ);
        h = _mm256_sub_epi32(whole, _mm256_castps_si256(u));
        h = _mm256_min_epi32(_mm256_blendv_epi8(h, most, _mm256_cmpeq_epi32(sum, total)), most);
        _mm256_storeu_si256((__m256i *)(void *)(after + t), h);
    }
    for (t = 0; t < triangles; t++) { /* sixteen bytes, of which those behind are written again */
        const __m128i byte = _mm_set1_epi8((char)t);
        do {
            _mm_storeu_si128((__m128i *)(void *)(f->triangle + before), byte);
            before = after[t] - before > 16 ? before + 16 : after[t];
        } while (before < after[t]);
    }
}

/* Samples begin..end-1 of k, whose triangles are in f->triangle. Returns how many are in the picture. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_flat_put_avx2(const zbufrandi_target *g, const zbufrandi_flat *f,
                                                              const uint8_t *tri,
                                                              uint32_t at_u, uint32_t at_v, uint32_t first_number,
                                                                  uint32_t begin, uint32_t end,
                                                              zbufrandi_waiting *wait) {
    const __m256 zero = _mm256_setzero_ps(), one = _mm256_set1_ps(1.0f), half = _mm256_set1_ps(0.5f);
    const __m256 unit = _mm256_set1_ps(1.0f / 16777216.0f);
    const __m256i lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    uint32_t j, i, mask, accepted = 0;
    for (j = begin; j < end; j += 8) {
        const __m256i number = _mm256_add_epi32(lanes, _mm256_set1_epi32((int)j));
        __m256 ax, ay, az, bx, by, bz, cx, cy, cz, u, v, w, x, y, iz, less, ok;
        __m256i a, b, ix, iy;
        uint32_t t[8], before[8], after[8];
        for (i = 0; i < 8; i++) {
            t[i] = f->triangle[(j + i < end ? j + i : end - 1) - begin];
            before[i] = t[i] > 0 ? f->sum[t[i] - 1] : 0;
            after[i] = f->sum[t[i]];
        }
        zbufrandi_fetch8(f->v[0], 4, tri, t, 0, &ax, &ay, &az);
        zbufrandi_fetch8(f->v[0], 4, tri, t, 1, &bx, &by, &bz);
        zbufrandi_fetch8(f->v[0], 4, tri, t, 2, &cx, &cy, &cz);
        if (g->cut->independent) {
            a = zbufrandi_mix8(_mm256_add_epi32(_mm256_set1_epi32((int)at_u),
                                                _mm256_mullo_epi32(number, _mm256_set1_epi32((int)0x9e3779b1u))));
            b = zbufrandi_mix8(_mm256_add_epi32(a, _mm256_set1_epi32((int)0x85ebca6bu)));
            u = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(a, 8)), unit);
            v = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(b, 8)), unit);
            less = _mm256_cmp_ps(v, u, _CMP_GT_OQ); /* square to triangle */
            x = _mm256_mul_ps(u, half);
            y = _mm256_mul_ps(v, half);
            w = _mm256_blendv_ps(_mm256_sub_ps(u, y), x, less);
            v = _mm256_blendv_ps(y, _mm256_sub_ps(v, x), less);
            u = w;
        } else { /* zbufrandi_flat_place */
            a = zbufrandi_mix8(_mm256_add_epi32(_mm256_set1_epi32((int)f->hash),
                                                _mm256_mullo_epi32(number, _mm256_set1_epi32((int)f->each))));
            b = _mm256_add_epi32(_mm256_set1_epi32((int)at_v),
                                 _mm256_mullo_epi32(number, _mm256_set1_epi32((int)2654435769u)));
            x = _mm256_cvtepi32_ps(_mm256_loadu_si256((const __m256i *)(const void *)before));
            y = _mm256_cvtepi32_ps(_mm256_loadu_si256((const __m256i *)(const void *)after));
            x = _mm256_mul_ps(x, _mm256_set1_ps(f->step));
            y = _mm256_sub_ps(_mm256_mul_ps(y, _mm256_set1_ps(f->step)), x);
            w = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(a, 8)), unit);
            w = _mm256_div_ps(_mm256_sub_ps(_mm256_add_ps(_mm256_cvtepi32_ps(number), w), x), y);
            w = _mm256_sqrt_ps(_mm256_min_ps(_mm256_max_ps(w, zero), one));
            u = _mm256_mul_ps(w, _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(b, 8)), unit));
            v = _mm256_sub_ps(one, w);
        }
        w = _mm256_sub_ps(_mm256_sub_ps(one, u), v);
        x = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(ax, w), _mm256_mul_ps(bx, u)), _mm256_mul_ps(cx, v));
        y = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(ay, w), _mm256_mul_ps(by, u)), _mm256_mul_ps(cy, v));
        iz = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(az, w), _mm256_mul_ps(bz, u)), _mm256_mul_ps(cz, v));
        ok = _mm256_and_ps(_mm256_cmp_ps(x, zero, _CMP_GE_OQ), _mm256_cmp_ps(x, _mm256_set1_ps(g->width), _CMP_LT_OQ));
        ok = _mm256_and_ps(ok,
                _mm256_and_ps(_mm256_cmp_ps(y, zero, _CMP_GE_OQ),
                              _mm256_cmp_ps(y, _mm256_set1_ps(g->height), _CMP_LT_OQ)));
        ix = _mm256_cvttps_epi32(x);
        iy = _mm256_cvttps_epi32(y);
        if (g->plane) {
            const __m256 dx = _mm256_sub_ps(_mm256_add_ps(_mm256_cvtepi32_ps(ix), half), x);
            const __m256 dy = _mm256_sub_ps(_mm256_add_ps(_mm256_cvtepi32_ps(iy), half), y);
            const __m256 lo = _mm256_min_ps(cz, _mm256_min_ps(bz, az)), hi = _mm256_max_ps(cz, _mm256_max_ps(bz, az));
            __m256 area, sx, sy;
            bx = _mm256_sub_ps(bx, ax);
            by = _mm256_sub_ps(by, ay);
            bz = _mm256_sub_ps(bz, az);
            cx = _mm256_sub_ps(cx, ax);
            cy = _mm256_sub_ps(cy, ay);
            cz = _mm256_sub_ps(cz, az);
            area = _mm256_sub_ps(_mm256_mul_ps(bx, cy), _mm256_mul_ps(by, cx));
            sx = _mm256_div_ps(_mm256_sub_ps(_mm256_mul_ps(bz, cy), _mm256_mul_ps(cz, by)), area);
            sy = _mm256_div_ps(_mm256_sub_ps(_mm256_mul_ps(cz, bx), _mm256_mul_ps(bz, cx)), area);
            iz = _mm256_add_ps(iz, _mm256_add_ps(_mm256_mul_ps(sx, dx), _mm256_mul_ps(sy, dy)));
            iz = _mm256_min_ps(_mm256_max_ps(iz, lo), hi);
        }
        iz = _mm256_div_ps(one, iz);
        mask = (uint32_t)_mm256_movemask_ps(_mm256_and_ps(ok, _mm256_cmp_ps(iz, _mm256_set1_ps(g->far_z), _CMP_LE_OQ)));
        if (end - j < 8) mask &= (1u << (end - j)) - 1u;
        if (f->mask.opacity < 1.0f) {
            uint32_t pixel[8];
            _mm256_storeu_si256((__m256i *)(void *)pixel,
                                _mm256_add_epi32(_mm256_mullo_epi32(iy, _mm256_set1_epi32((int)g->keys.width)), ix));
            for (i = 0; i < 8; i++)
                if ((mask >> i & 1u) != 0 && !zbufrandi_mask_shows(&f->mask, pixel[i])) mask &= ~(1u << i);
        }
        if (mask == 0) continue;
        zbufrandi_put8(g, wait, _mm256_add_epi32(_mm256_mullo_epi32(iy, _mm256_set1_epi32((int)g->keys.width)), ix), iz,
                       _mm256_add_epi32(number, _mm256_set1_epi32((int)first_number)), mask, 1);
        accepted += (uint32_t)__builtin_popcount(mask);
    }
    return accepted;
}
#endif

/* Samples first..last-1 of a draw, if it has so many. *samples: how many were drawn. Returns how many are in the
   picture. */
static uint32_t zbufrandi_draw_sampled(const zbufrandi_target *g, const zbufrandi_draw *d, uint32_t first,
                                       uint32_t last, const zbufrandi_local *l, const zbufrandi_structure *s,
                                       zbufrandi_waiting *wait, uint32_t *samples) {
    const zbufrandi_cluster *c = &s->cluster[d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)];
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    const uint32_t at_u = zbufrandi_hash32(d->hash + 0x3c6ef372u), at_v = zbufrandi_hash32(at_u);
    uint8_t *aux = g->aux + (size_t)d->aux * ZBUFRANDI_SET;
    zbufrandi_flatten constants;
    zbufrandi_flat f;
    zbufrandi_spot seen;
    uint32_t k, begin, end, j, accepted = 0;
    (void)wait;
    zbufrandi_flatten_begin(g, d, l, &constants, &f);
#if ZBUFRANDI_AVX2
    if (g->level >= 3) zbufrandi_flatten_cluster_avx2(g, &constants, s, c, &f);
    else
#endif
        zbufrandi_flatten_cluster(g, &constants, s, c, &f);
    k = zbufrandi_flat_count(g, d, &f);
    if (last > k) last = k;
    *samples = last > first ? last - first : 0;
    zbufrandi_flat_begin(d, k, g->cut->comb, &f);
    for (begin = first; begin < last; begin = end) {
        end = last - begin > ZBUFRANDI_FLAT_CHUNK ? begin + ZBUFRANDI_FLAT_CHUNK : last;
        if (g->cut->independent) zbufrandi_flat_independent(d, &f, c->triangle_count, begin, end);
#if ZBUFRANDI_AVX2
        else if (g->level >= 3 && k <= ZBUFRANDI_FLAT_CHUNK) zbufrandi_flat_strata_avx2(&f, c->triangle_count, k);
#endif
        else zbufrandi_flat_strata(&f, c->triangle_count, k, begin, end);
        memcpy(aux + begin, f.triangle, end - begin);
#if ZBUFRANDI_AVX2
        if (g->level >= 3) {
            accepted += zbufrandi_flat_put_avx2(g, &f, tri, at_u, at_v, d->block * ZBUFRANDI_SET, begin, end, wait);
            continue;
        }
#endif
        for (j = begin; j < end; j++) {
            if (!zbufrandi_flat_sample(g, &f, tri, at_u, at_v, j, f.triangle[j - begin], &seen)) continue;
            zbufrandi_target_put(g, (size_t)seen.iy * g->keys.width + seen.ix,
                                 zbufrandi_key(seen.shown, d->block * ZBUFRANDI_SET + j));
            accepted++;
        }
    }
    return accepted;
}

/* ---- points of the caller ---- */

/* Points d->hash .. d->hash + d->count of a cloud, one sample each. */
static uint32_t zbufrandi_draw_points(const zbufrandi_target *g, const zbufrandi_draw *d,
                                      const zbufrand_points *points) {
    const zbufrandi_camera *c = &g->cut->camera;
    const size_t stride = points->position_stride != 0 ? points->position_stride : 12;
    uint32_t i, accepted = 0;
    for (i = 0; i < d->count; i++) {
        float f[3], z, x, y;
        double p[3];
        int a;
        memcpy(f, (const uint8_t *)points->positions + ((size_t)d->hash + i) * stride, sizeof f);
        for (a = 0; a < 3; a++) p[a] = (double)f[a] - c->eye[a];
        z = (float)(p[0] * c->dir[0] + p[1] * c->dir[1] + p[2] * c->dir[2]);
        if (!(z >= g->cut->near_z && z <= g->far_z)) continue; /* not NaN either */
        x = (float)((p[0] * c->right[0] + p[1] * c->right[1] + p[2] * c->right[2]) * g->focal) / z + g->center_x;
        y = g->center_y - (float)((p[0] * c->up[0] + p[1] * c->up[1] + p[2] * c->up[2]) * g->focal) / z;
        if (!(x >= 0.0f && x < g->width && y >= 0.0f && y < g->height)) continue;
        zbufrandi_target_put(g, (size_t)(int32_t)y * g->keys.width + (size_t)(int32_t)x,
                             zbufrandi_key(z, d->block * ZBUFRANDI_SET + i));
        accepted++;
    }
    return accepted;
}
/* ---------------------------------------------------------------------------
   listed: the cut through the thesis' trees by its rules, and samples drawn     // >>listed
   from their distribution lists.

   A node is drawn from as a whole (chosen) when its box is in front of the near plane and
       depth    z_max <= sqrt(epsilon) z_min: the factor 1/z^2 varies by at most epsilon,
       normals  the cosines of its angles of view vary by at most epsilon_n, or cannot be told apart better,
       view     the box is inside of the view, or not wider than c z_min.
   The bound of the projection factor is f^2 cos(b) (|v| / z) / z_min^2, where b is the smallest angle that the cone of
   its class and the cone of directions towards its box leave. Other nodes are divided. What stays at a node that is
   divided, and the triangles of leaves that cannot be, are looked at one by one: sampled with their exact bound if the
   depth rule holds for the triangle, rasterised otherwise. Nothing is lost: a leaf that crosses the plane of the eye
   goes to the rasteriser triangle by triangle.
   A chosen node may have dummies below: drawing enters them, one after the other, for each sample.
   --------------------------------------------------------------------------- */

#define ZBUFRANDI_LISTED_INDEPENDENT 0x80000000u /* of a draw's aux, beside the end of its run */
#define ZBUFRANDI_LISTED_COMB 0x40000000u
#define ZBUFRANDI_LISTED_LAST 0x3fffffffu

typedef struct zbufrandi_list_open { /* a node to be looked at, seen from a local */
    uint32_t node, list_class, local;
    uint32_t first, last;      /* of its objects those that are meant: all, or a run of a leaf */
    uint32_t _pad;
    uint64_t key;              /* octree: the cell whose objects these are */
} zbufrandi_list_open;

typedef struct zbufrandi_list_bound {
    double z_min, z_max;       /* world */
    double diameter;           /* of the sphere around the box, world */
    double h;                  /* bound of H, for the factor f^2 h / z_min^3; only with z_min >= near */
    double cos_hi, cos_lo;     /* cosines of the least and the largest angle of view */
    int inside;                /* within the view */
    int wide;                  /* its place counts for more than the cone of its class */
} zbufrandi_list_bound;

/* The rules of a picture. 0: a field is wrong. */
static int zbufrandi_list_rules(const zbufrand_render_desc *d, const zbufrand_scene *scene, zbufrandi_cut *cut) {
    const double depth = d->depth_ratio > 0.0 ? d->depth_ratio : 1.5;
    double angle = d->angle_ratio;
    if (!(depth > 1.0 && depth < 1e6) || !(d->angle_ratio >= 0.0 && d->angle_ratio < 1e6) ||
        !(d->depth_ratio >= 0.0) || !(d->clip_ratio >= 0.0 && d->clip_ratio < 1e6)) return 0;
    if (angle > 0.0 && !(angle > 1.0)) return 0;
    if (angle <= 0.0 && scene != NULL && scene->structure_count != 0 && scene->structure[0].lists != NULL &&
        scene->structure[0].lists->key != NULL) angle = depth;
    cut->depth_ratio = (float)sqrt(depth);
    cut->angle_ratio = (float)angle;
    cut->clip_ratio = (float)d->clip_ratio;
    return 1;
}

ZBUFRAND_DEF void zbufrand_preset_thesis(zbufrand_build_desc *build, zbufrand_render_desc *render) {
    if (build != NULL) {
        build->structure = ZBUFRAND_STRUCTURE_FAIR_SPLIT;
        build->leaf_objects = 64;
        build->leaf_ratio = 8.0f;
        build->tolerance_zone = 1.5f;
        build->normal_depth = build->normal_grid = 0;
    }
    if (render != NULL) {
        render->hybrid = ZBUFRAND_HYBRID_LARGE;
        render->independent = render->round_up = 1;
        render->depth_ratio = 1.5;
        render->angle_ratio = render->clip_ratio = 0.0;
        render->no_lists = 0;
        render->no_occlusion = render->no_repair = render->no_plane_depth = render->no_thinning = 1;
        memset(&render->reconstruct, 0, sizeof render->reconstruct);
        render->reconstruct.block = 2;
        render->reconstruct.tolerance_slope = -1.0f;
    }
}

/* ---- bounds ---- */

/* cos(max(0, g - s)) and cos(min(pi, g + s)) for angles given by cosine and sine. */
static void zbufrandi_list_angles(double cg, double sg, double cs, double ss, double *high, double *low) {
    *high = cg >= cs ? 1.0 : cg * cs + sg * ss;
    *low = cg <= 0.0 - cs ? -1.0 : cg * cs - sg * ss;
}

static double zbufrandi_list_sine(double c) { return sqrt(zbufrandi_max(0.0, 1.0 - c * c)); }

/* What the box and the class of a node say. 0: outside of the view, 1: turned away, 2: it counts. */
static int zbufrandi_list_test(const zbufrandi_cut *cut, const zbufrandi_local *l, const float lo[3],
                               const float hi[3], const zbufrandi_list_class *k, zbufrandi_list_bound *b) {
    const zbufrandi_camera *v = &cut->camera;
    const double f = v->focal, w = (double)v->width, h = (double)v->height, scale = (double)l->scale;
    double plane[4][3], q[3], e[3], m[3], length2 = 0.0, radius2 = 0.0, reach, slack, length, cg, cs, ss, cr, sr, ct;
    int a, p, r;
    memset(b, 0, sizeof *b);
    for (a = 0; a < 3; a++) {
        m[a] = 0.5 * ((double)lo[a] + (double)hi[a]);
        e[a] = 0.5 * ((double)hi[a] - (double)lo[a]);
        radius2 += e[a] * e[a];
    }
    slack = 0.0;
    for (r = 0; r < 3; r++) {
        q[r] = l->to_camera[r][3];
        for (a = 0; a < 3; a++) q[r] += l->to_camera[r][a] * m[a];
        slack += zbufrandi_abs(l->to_camera[r][3]) + zbufrandi_abs(q[r]);
        length2 += q[r] * q[r];
    }
    slack *= 1e-14;
    reach = slack;
    for (a = 0; a < 3; a++) reach += zbufrandi_abs(l->to_camera[2][a]) * e[a];
    b->z_min = q[2] - reach;
    b->z_max = q[2] + reach;
    if (b->z_max < v->near_z || b->z_min > v->far_z) return 0;
    b->inside = b->z_min >= v->near_z && b->z_max <= v->far_z;
    memset(plane, 0, sizeof plane); /* inwards: px >= 0, px <= w, py >= 0, py <= h */
    plane[0][0] = f;
    plane[0][2] = v->center_x;
    plane[1][0] = 0.0 - f;
    plane[1][2] = w - v->center_x;
    plane[2][1] = 0.0 - f;
    plane[2][2] = v->center_y;
    plane[3][1] = f;
    plane[3][2] = h - v->center_y;
    for (p = 0; p < 4; p++) {
        const double at = plane[p][0] * q[0] + plane[p][1] * q[1] + plane[p][2] * q[2];
        reach = slack * (f + w + h);
        for (a = 0; a < 3; a++) {
            reach += e[a] * zbufrandi_abs(plane[p][0] * l->to_camera[0][a] + plane[p][1] * l->to_camera[1][a] +
                                          plane[p][2] * l->to_camera[2][a]);
        }
        if (at + reach < 0.0) return 0;
        b->inside &= at - reach >= 0.0;
    }
    reach = sqrt(radius2) * scale * 1.000001 + slack;
    length = sqrt(length2);
    b->diameter = 2.0 * reach;
    /* the directions towards the eye: a cone around that of the middle, with sine reach / length */
    b->cos_hi = 1.0;
    b->cos_lo = -1.0;
    b->wide = 1;
    ct = (double)k->cosine;
    if (length > reach && ct > -1.0) {
        sr = reach / length;
        cr = sqrt(1.0 - sr * sr);
        ss = zbufrandi_list_sine(ct);
        cs = ct * cr - ss * sr;
        ss = ss * cr + ct * sr;
        b->wide = cr < ct;
        if (ss > 0.0 && !(cs <= -1.0)) { /* together less than a half turn */
            cg = 0.0;
            for (r = 0; r < 3; r++) {
                double n = 0.0;
                for (a = 0; a < 3; a++) n += l->to_camera[r][a] * (double)k->axis[a];
                cg -= n * q[r];
            }
            cg = zbufrandi_max(-1.0, zbufrandi_min(1.0, cg / (scale * length)));
            zbufrandi_list_angles(cg, zbufrandi_list_sine(cg), cs, ss, &b->cos_hi, &b->cos_lo);
            b->cos_hi = zbufrandi_min(1.0, b->cos_hi + 1e-6);
            b->cos_lo = zbufrandi_max(-1.0, b->cos_lo - 1e-6);
            if (k->two_sided) { /* the side that is seen: both angles count by their cosines' sizes */
                const double high = zbufrandi_max(b->cos_hi, 0.0 - b->cos_lo);
                b->cos_lo = b->cos_lo > 0.0 ? b->cos_lo : b->cos_hi < 0.0 ? 0.0 - b->cos_hi : 0.0;
                b->cos_hi = high;
            }
        }
    }
    if (!(b->cos_hi > 0.0)) return 1;
    if (b->z_min >= v->near_z) { /* |v| / z: not more than in the corner of the picture */
        const double x = zbufrandi_max(v->center_x, w - v->center_x), y = zbufrandi_max(v->center_y, h - v->center_y);
        double secant = (length + reach) / b->z_min;
        secant = zbufrandi_min(secant, sqrt(1.0 + (x * x + y * y) / (f * f)));
        b->h = b->cos_hi * secant * b->z_min;
    }
    return 2;
}

/* ---- what is chosen ---- */

ZBUFRANDI_INLINE const zbufrandi_local *zbufrandi_list_local(const zbufrandi_local *locals, const zbufrandi_pick *p,
                                                             uint32_t local) {
    return local >= ZBUFRANDI_NEW_LOCAL ? &p->local[local - ZBUFRANDI_NEW_LOCAL] : &locals[local];
}

/* A Poisson number. */
static uint32_t zbufrandi_list_poisson(double mean, uint32_t h) {
    uint32_t k = 0;
    while (mean > 0.0) { /* sums of Poisson numbers are Poisson numbers */
        const double part = mean > 16.0 ? 16.0 : mean, floor_at = zbufrandi_exp2(-part * 1.4426950408889634);
        double product = 1.0;
        for (;;) {
            h = zbufrandi_hash32(h + 0x9e3779b9u);
            product *= ((double)h + 0.5) * (1.0 / 4294967296.0);
            if (product < floor_at) break;
            k++;
        }
        mean -= part;
    }
    return k;
}

/* Of a run of objects, in world units. */
static double zbufrandi_run_area(const zbufrandi_local *l, const zbufrandi_structure *s, uint32_t first,
                                 uint32_t last) {
    return (double)(s->lists->sum[last] - s->lists->sum[first]) * s->lists->unit * (double)l->scale *
           (double)l->scale;
}

/* Samples of that area. */
static double zbufrandi_run_expected(const zbufrandi_cut *cut, double area, double z_min, double h) {
    return cut->density * area * cut->camera.focal * cut->camera.focal * h / (z_min * z_min * z_min);
}

/* Draw a run of objects: samples if the bound is known, the triangles themselves with raster. */
static void zbufrandi_list_emit(const zbufrandi_cut *cut, const zbufrandi_local *locals, zbufrandi_pick *p,
                                uint32_t local, uint32_t first, uint32_t last, double z_min, double z_max, double h,
                                int raster) {
    const zbufrandi_local *l = zbufrandi_list_local(locals, p, local);
    const zbufrandi_structure *s = &cut->scene->structure[l->structure];
    const double area = zbufrandi_run_area(l, s, first, last);
    double expected = zbufrandi_run_expected(cut, area, z_min, h);
    zbufrandi_draw d;
    memset(&d, 0, sizeof d);
    d.hash = zbufrandi_hash32(l->hash ^ zbufrandi_hash32(first * 0x9e3779b1u + 0x2545f491u) ^ last);
    d.local = local;
    d.aux = last | (cut->independent ? ZBUFRANDI_LISTED_INDEPENDENT : cut->comb ? ZBUFRANDI_LISTED_COMB : 0u);
    d.z_lo = zbufrandi_float_down(z_min);
    d.z_hi = zbufrandi_float_up(z_max);
    if (raster) {
        d.item = (uint32_t)ZBUFRANDI_DRAW_LISTED_RASTER << ZBUFRANDI_DRAW_SHIFT | first;
        d.count = last - first;
    } else {
        d.item = (uint32_t)ZBUFRANDI_DRAW_LISTED << ZBUFRANDI_DRAW_SHIFT | first;
        d.h_ref = zbufrandi_float_up(h * 1.000001);
        d.iz_ref = zbufrandi_float_up(1.000001 / z_min);
        if (cut->corners) d.step[0] = (float)(2.0 * cut->camera.focal / z_min); /* 1 over half a pixel there */
        expected *= 1.000005;
        expected = expected < 4e8 ? expected : 4e8;
        d.count = (uint32_t)(expected + (double)zbufrandi_unit24(d.hash));
        if (cut->round_up) d.count = (uint32_t)expected + ((double)(uint32_t)expected < expected);
        else if (cut->independent) d.count = zbufrandi_list_poisson(expected, d.hash);
        if (d.count == 0 && !cut->bounds) return;
        p->samples += d.count;
    }
    if (cut->bounds) {
        zbufrandi_bounds *b = &p->bounds[p->draw_count];
        memset(b, 0, sizeof *b);
        b->triangles = zbufrandi_list_triangles(cut->scene, s, first, last);
        b->area = zbufrandi_float_up(area);
        b->h = d.h_ref;
    }
    p->draw[p->draw_count++] = d;
}

/* One triangle on its own. `exact`: rasterise it whatever the rules say. */
static void zbufrandi_list_single(const zbufrandi_cut *cut, const zbufrandi_local *locals, zbufrandi_pick *p,
                                  uint32_t local, uint32_t object, int exact) {
    const zbufrandi_local *l = zbufrandi_list_local(locals, p, local);
    const zbufrandi_structure *s = &cut->scene->structure[l->structure];
    const zbufrandi_camera *v = &cut->camera;
    const float *c[3];
    const zbufrandi_cluster *cluster = zbufrandi_list_triangle(s, s->lists->object[object], c);
    double q[3][3], n[3], z_min = 1e300, z_max = -1e300, h = 0.0, length = 0.0, slack = 0.0;
    int k, r, out[4] = {0, 0, 0, 0}, large;
    for (k = 0; k < 3; k++) {
        for (r = 0; r < 3; r++) {
            q[k][r] = l->to_camera[r][0] * (double)c[k][0] + l->to_camera[r][1] * (double)c[k][1] +
                      l->to_camera[r][2] * (double)c[k][2] + l->to_camera[r][3];
            slack = zbufrandi_max(slack, zbufrandi_abs(q[k][r]) + zbufrandi_abs(l->to_camera[r][3]));
        }
        z_min = zbufrandi_min(z_min, q[k][2]);
        z_max = zbufrandi_max(z_max, q[k][2]);
        out[0] += v->focal * q[k][0] + v->center_x * q[k][2] < 0.0;
        out[1] += ((double)v->width - v->center_x) * q[k][2] - v->focal * q[k][0] < 0.0;
        out[2] += v->center_y * q[k][2] - v->focal * q[k][1] < 0.0;
        out[3] += v->focal * q[k][1] + ((double)v->height - v->center_y) * q[k][2] < 0.0;
    }
    p->counts.tested++;
    if (z_max < v->near_z || z_min > v->far_z || out[0] == 3 || out[1] == 3 || out[2] == 3 || out[3] == 3) {
        p->counts.outside++;
        return;
    }
    zbufrandi_cross(c[0], c[1], c[2], n); /* outwards here; its image points outwards there, mirrored or not */
    for (r = 0; r < 3; r++) {
        const double image = l->to_camera[r][0] * n[0] + l->to_camera[r][1] * n[1] + l->to_camera[r][2] * n[2];
        length += image * image;
        h -= image * q[0][r];
    }
    length = sqrt(length);
    h = length > 0.0 ? h / length : 0.0;
    if (cluster->flags & ZBUFRANDI_TWO_SIDED) h = zbufrandi_abs(h);
    h += 1e-13 * slack;
    if (!(h > 0.0)) {
        p->counts.away++;
        return;
    }
    z_min -= 1e-14 * slack;
    large = !(z_min >= v->near_z && z_max <= (double)cut->depth_ratio * z_min);
    if (large && (cut->hybrid != ZBUFRAND_HYBRID_OFF || !(z_min >= v->near_z))) exact = 1;
    if (!exact) { /* as is cheaper */
        const double area = zbufrandi_run_area(l, s, object, object + 1); /* as it will be drawn, not of the corners */
        const double expected = zbufrandi_run_expected(cut, area, z_min, h);
        exact = !(expected < (double)cut->most);
        if (cut->hybrid == ZBUFRAND_HYBRID_AUTO)
            exact |= (double)cut->triangle + expected * (double)cut->pixel < expected * (double)cut->list_sample;
    }
    zbufrandi_list_emit(cut, locals, p, local, object, object + 1, z_min, z_max, h, exact);
}

/* ---- the walk ---- */

/* Numbers of samples have 32 bits. */
#define ZBUFRANDI_SAMPLES_MAX ((uint64_t)1 << 32)

typedef struct zbufrandi_list_walk {
    const zbufrandi_cut *cut;
    zbufrandi_mem *mem;
    const zbufrandi_local *locals;
    zbufrandi_pick *p;
    zbufrandi_list_open *stack;
    size_t capacity, count;
    const zbufrand_env *env;
    zbufrandi_asker *asker;
    uint64_t asked;            /* work when it asked last */
} zbufrandi_list_walk;

/* Go on? Not if a picture cannot have as many samples, or it was cancelled. */
static int zbufrandi_list_goes_on(zbufrandi_list_walk *w) {
    const zbufrandi_pick *p = w->p;
    const uint64_t work = (p->samples >> 6) + p->counts.tested + p->draw_count;
    if (p->samples > ZBUFRANDI_SAMPLES_MAX) return 0;
    if (work - w->asked < 4096) return 1;
    w->asked = work;
    return zbufrandi_ask(w->env, w->asker, 0);
}

static int zbufrandi_list_room(zbufrandi_list_walk *w, size_t n) { /* for n more of everything */
    zbufrandi_pick *p = w->p;
    if (zbufrandi_list_goes_on(w) &&
        zbufrandi_grow(w->mem, (void **)&w->stack, &w->capacity, w->count, w->count + n, sizeof *w->stack) &&
        zbufrandi_grow(w->mem, (void **)&p->draw, &p->draw_capacity, p->draw_count, p->draw_count + n,
                       sizeof *p->draw) &&
        zbufrandi_grow(w->mem, (void **)&p->local, &p->local_capacity, p->local_count, p->local_count + n,
                       sizeof *p->local) &&
        (!w->cut->bounds || zbufrandi_grow(w->mem, (void **)&p->bounds, &p->bounds_capacity, p->draw_count,
                                           p->draw_count + n, sizeof *p->bounds))) return 1;
    p->failed = 1;
    return 0;
}

static void zbufrandi_list_push(zbufrandi_list_walk *w, const zbufrandi_lists *l, uint32_t node, uint32_t list_class,
                                uint32_t local) {
    zbufrandi_list_open *o = &w->stack[w->count++];
    o->node = node;
    o->list_class = list_class;
    o->local = local;
    o->first = l->node[node].first;
    o->last = l->node[node].last;
    o->_pad = 0;
    o->key = l->node[node].key;
}

/* Objects first..last-1 one by one: dummies are entered. */
static void zbufrandi_list_objects(zbufrandi_list_walk *w, uint32_t local, uint32_t first, uint32_t last, int exact) {
    uint32_t i, run;
    for (i = first; i < last && !w->p->failed; i++) {
        const zbufrandi_local *l;
        const zbufrandi_structure *s;
        const zbufrandi_lists *lists;
        if (!zbufrandi_list_room(w, 1)) return;
        l = zbufrandi_list_local(w->locals, w->p, local);
        s = &w->cut->scene->structure[l->structure];
        lists = s->lists;
        if (lists->object[i] & ZBUFRANDI_LIST_DUMMY) {
            const zbufrandi_dummy *d = &lists->dummy[lists->object[i] & ~ZBUFRANDI_LIST_DUMMY];
            const zbufrandi_lists *to = w->cut->scene->structure[s->instance[d->instance].structure].lists;
            zbufrandi_local_enter(w->cut, l, local, d->instance, &w->p->local[w->p->local_count]);
            w->p->counts.entered++;
            zbufrandi_list_push(w, to, to->list_class[d->list_class].root, d->list_class,
                                ZBUFRANDI_NEW_LOCAL + w->p->local_count++);
        } else if (exact) { /* as many as stand together */
            for (run = i + 1; run < last && !(lists->object[run] & ZBUFRANDI_LIST_DUMMY) && run - i < 4096; run++) { }
            zbufrandi_list_emit(w->cut, w->locals, w->p, local, i, run, w->cut->camera.near_z,
                                zbufrandi_min(w->cut->camera.far_z, 1e30), 1.0, 1);
            i = run - 1;
        } else {
            zbufrandi_list_single(w->cut, w->locals, w->p, local, i, 0);
        }
    }
}

/* The finer classes of a class, each with what it has in the cell of a node. */
static void zbufrandi_list_finer(zbufrandi_list_walk *w, const zbufrandi_lists *l, const zbufrandi_list_open *at) {
    const zbufrandi_list_class *c = &l->list_class[at->list_class];
    const uint64_t cell = at->key, level = cell & 31u;
    const uint64_t after = ((cell >> 5) + ((uint64_t)1 << 3 * (ZBUFRANDI_LIST_LEVELS - level))) << 5;
    uint32_t k;
    if (!zbufrandi_list_room(w, c->children)) return;
    for (k = 0; k < c->children; k++) {
        const zbufrandi_list_class *f = &l->list_class[c->child + k];
        zbufrandi_list_open o;
        uint32_t node = f->root, child;
        o.first = f->first;
        o.last = f->last;
        for (child = 0; child < 2; child++) { /* first object with a key not below `cell`, and `after` */
            const uint64_t key = child == 0 ? cell : after;
            uint32_t lo = f->first, hi = f->last;
            while (lo < hi) {
                const uint32_t mid = lo + (hi - lo) / 2;
                if (l->key[mid] < key) lo = mid + 1;
                else hi = mid;
            }
            if (child == 0) o.first = lo;
            else o.last = lo;
        }
        if (o.first >= o.last) continue;
        for (;;) { /* down to the last node that has them all */
            for (child = node + 1; child < l->node[node].end; child = l->node[child].end) {
                if (l->node[child].first <= o.first && l->node[child].last >= o.last) break;
            }
            if (child >= l->node[node].end || o.first < l->node[node].own) break;
            node = child;
        }
        o.node = node;
        o.list_class = c->child + k;
        o.local = at->local;
        o._pad = 0;
        o.key = cell;
        w->stack[w->count++] = o;
    }
}

static void zbufrandi_list_step(zbufrandi_list_walk *w) {
    const zbufrandi_cut *cut = w->cut;
    const zbufrandi_list_open at = w->stack[--w->count];
    const zbufrandi_local *l; /* good until there is room made again */
    const zbufrandi_lists *lists;
    const zbufrandi_list_node *n;
    const zbufrandi_list_class *c;
    zbufrandi_list_bound b;
    double expected = 0.0;
    uint32_t child, children = 0;
    int seen, depth_ok, angle_ok, leaf, cube = 0;
    if (!zbufrandi_list_room(w, 1)) return;
    l = zbufrandi_list_local(w->locals, w->p, at.local);
    lists = cut->scene->structure[l->structure].lists;
    n = &lists->node[at.node];
    c = &lists->list_class[at.list_class];
    leaf = at.node + 1 == n->end || at.first != n->first || at.last != n->last;
    w->p->counts.nodes++;
    w->p->counts.tested++;
    seen = zbufrandi_list_test(cut, l, n->lo, n->hi, c, &b);
    w->p->counts.outside += seen == 0;
    w->p->counts.away += seen == 1;
    if (seen < 2) return;
    if (cut->hybrid == ZBUFRAND_HYBRID_CUBE) {
        const float reach = cut->cube / l->scale;
        uint32_t a;
        for (a = 0, cube = 1; a < 3; a++) cube &= n->lo[a] <= l->eye[a] + reach && n->hi[a] >= l->eye[a] - reach;
        if (cube && (leaf || b.diameter <= 0.25 * (double)cut->cube)) {
            zbufrandi_list_objects(w, at.local, at.first, at.last, 1);
            return;
        }
    }
    depth_ok = b.z_min >= cut->camera.near_z && b.z_max <= (double)cut->depth_ratio * b.z_min &&
               (b.inside || cut->clip_ratio <= 0.0f || b.diameter <= (double)cut->clip_ratio * b.z_min);
    if (depth_ok) {
        const double area = zbufrandi_run_area(l, &cut->scene->structure[l->structure], at.first, at.last);
        expected = zbufrandi_run_expected(cut, area, b.z_min, b.h);
        depth_ok = expected < (double)cut->most;
    }
    angle_ok = cut->angle_ratio <= 0.0f || (b.cos_lo > 0.0 && b.cos_hi <= (double)cut->angle_ratio * b.cos_lo);
    if (depth_ok && !cube && !angle_ok && c->children != 0 && (!b.wide || leaf)) {
        zbufrandi_list_finer(w, lists, &at);
        return;
    }
    if (depth_ok && !cube && (angle_ok || leaf || !b.wide)) {
        const uint32_t objects = at.last - at.first;
        int raster = 0;
        if (cut->hybrid == ZBUFRAND_HYBRID_AUTO && !n->dummies) {
            raster = (double)objects * (double)cut->triangle + expected * (double)cut->pixel <
                     expected * (double)cut->list_sample;
        }
        if (raster) zbufrandi_list_objects(w, at.local, at.first, at.last, 1);
        else zbufrandi_list_emit(cut, w->locals, w->p, at.local, at.first, at.last, b.z_min, b.z_max, b.h, 0);
        return;
    }
    if (leaf) {
        zbufrandi_list_objects(w, at.local, at.first, at.last, 0);
        return;
    }
    for (child = at.node + 1; child < n->end; child = lists->node[child].end) children++;
    if (!zbufrandi_list_room(w, children + 1u)) return;
    for (child = at.node + 1; child < n->end; child = lists->node[child].end) {
        zbufrandi_list_push(w, lists, child, at.list_class, at.local);
    }
    zbufrandi_list_objects(w, at.local, n->first, n->own, cube);
}

/* Everything that is drawn of a scene with lists, into p->draw. */
static void zbufrandi_list_select(const zbufrandi_cut *cut, zbufrandi_mem *mem, const zbufrand_env *env,
                                  zbufrandi_asker *asker, const zbufrandi_local *locals, uint32_t root,
                                  zbufrandi_pick *p) {
    const zbufrandi_lists *l = cut->scene->structure[0].lists;
    zbufrandi_list_walk w;
    uint32_t c;
    memset(&w, 0, sizeof w);
    w.cut = cut;
    w.mem = mem;
    w.env = env;
    w.asker = asker;
    w.locals = locals;
    w.p = p;
    if (zbufrandi_list_room(&w, l->roots)) {
        for (c = l->roots; c > 0; c--) zbufrandi_list_push(&w, l, l->list_class[c - 1].root, c - 1, root);
        while (w.count > 0 && !p->failed) zbufrandi_list_step(&w);
    }
    zbufrandi_free(mem, w.stack);
}

/* ---- samples ---- */

typedef struct zbufrandi_list_spot { /* sample j of a draw, as its random numbers say */
    double m[3][4];            /* structure of the triangle to camera */
    double scale;
    const zbufrandi_structure *s;
    const zbufrandi_cluster *cluster;
    const float *corner[3];
    uint32_t structure, item;
    float u, v, keep;          /* weights of corners 1 and 2; number for thinning */
} zbufrandi_list_spot;

static void zbufrandi_list_find(const zbufrand_scene *scene, const zbufrandi_local *l,
                                const zbufrandi_draw *d, uint32_t j, zbufrandi_list_spot *out) {
    const uint32_t high = zbufrandi_hash32(d->hash ^ zbufrandi_hash32(j + 1));
    const uint32_t low = zbufrandi_hash32((d->hash + 0x9e3779b9u) ^ zbufrandi_hash32(j + 0x85ebca6bu));
    const zbufrandi_lists *lists;
    uint32_t first = d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u), last = d->aux & ZBUFRANDI_LISTED_LAST;
    uint32_t at, level = 0;
    const int independent = (d->aux & ZBUFRANDI_LISTED_INDEPENDENT) != 0;
    uint64_t place = (uint64_t)high << 32 | low, y;
    memcpy(out->m, l->to_camera, sizeof out->m);
    out->scale = (double)l->scale;
    out->structure = l->structure;
    out->s = &scene->structure[l->structure];
    lists = out->s->lists;
    if (!independent) { /* stratum j of as many equal ones as there are samples; places are 64 bits behind the point */
        const uint64_t part = ~(uint64_t)0 / d->count;
        if (d->aux & ZBUFRANDI_LISTED_COMB) place = (uint64_t)zbufrandi_hash32(d->hash + 0x51ed270bu) << 32;
        place = part * j + zbufrandi_mul_high(place, part);
    }
    y = zbufrandi_mul_high(place, lists->sum[last] - lists->sum[first]);
    for (;;) {
        y += lists->sum[first];
        at = zbufrandi_list_search(lists, first, last, y);
        out->item = lists->object[at];
        if (!(out->item & ZBUFRANDI_LIST_DUMMY)) break;
        { /* into the dummy. Of the place within it the first bits go on, so that strata stay strata; others are new */
            const zbufrandi_dummy *k = &lists->dummy[out->item & ~ZBUFRANDI_LIST_DUMMY];
            const zbufrandi_instance *it = &out->s->instance[k->instance];
            const double part = (double)(y - lists->sum[at]) / (double)(lists->sum[at + 1] - lists->sum[at]) * 65536.0;
            uint64_t fresh;
            level++;
            fresh = (uint64_t)zbufrandi_hash32(high + level * 0x9e3779b1u) << 32 |
                    zbufrandi_hash32(low + level * 0x85ebca77u);
            if (!independent) fresh = fresh >> 16 | (uint64_t)(part < 65535.0 ? part : 65535.0) << 48;
            zbufrandi_m34_mul(ZBUFRANDI_M34(out->m), ZBUFRANDI_M34(it->to_parent), out->m);
            out->scale *= it->scale;
            out->structure = it->structure;
            out->s = &scene->structure[it->structure];
            lists = out->s->lists;
            first = lists->list_class[k->list_class].first;
            last = lists->list_class[k->list_class].last;
            y = zbufrandi_mul_high(fresh, lists->sum[last] - lists->sum[first]);
        }
    }
    out->u = zbufrandi_unit24(zbufrandi_hash32(high + 0x3c6ef372u));
    out->v = zbufrandi_unit24(zbufrandi_hash32(low + 0xbb67ae85u));
    out->keep = zbufrandi_unit24(zbufrandi_hash32(low + 0xa54ff53au));
    zbufrandi_square_to_triangle(&out->u, &out->v);
    out->cluster = zbufrandi_list_triangle(out->s, out->item, out->corner);
    if (d->step[0] > 0.0f && out->scale * (double)d->step[0] *
            sqrt(zbufrandi_longest2(out->corner[0], out->corner[1], out->corner[2])) < 1.0) {
        const uint32_t which = (uint32_t)((uint64_t)zbufrandi_hash32(high + 0x2545f491u) * 3 >> 32);
        out->u = which == 1 ? 1.0f : 0.0f;
        out->v = which == 2 ? 1.0f : 0.0f;
    }
}

/* 0: not seen. */
static int zbufrandi_list_sample(const zbufrandi_target *g, const zbufrandi_draw *d, const zbufrandi_list_spot *at,
                                 zbufrandi_spot *out) {
    const float *const *c = at->corner;
    const double u = (double)at->u, v = (double)at->v;
    double e[2][3], n[3], q[3], p[3], k[3], h = 0.0, length = 0.0, z_lo = 1e300, z_hi = -1e300;
    int a, r;
    for (a = 0; a < 3; a++) {
        e[0][a] = (double)c[1][a] - (double)c[0][a];
        e[1][a] = (double)c[2][a] - (double)c[0][a];
        p[a] = (double)c[0][a] + u * e[0][a] + v * e[1][a];
    }
    zbufrandi_cross(c[0], c[1], c[2], n);
    for (r = 0; r < 3; r++) {
        q[r] = at->m[r][0] * p[0] + at->m[r][1] * p[1] + at->m[r][2] * p[2] + at->m[r][3];
        k[r] = at->m[r][0] * n[0] + at->m[r][1] * n[1] + at->m[r][2] * n[2];
        h -= k[r] * q[r];
        length += k[r] * k[r];
    }
    if ((at->cluster->flags & ZBUFRANDI_TWO_SIDED) && h < 0.0) {
        h = 0.0 - h;
        for (r = 0; r < 3; r++) k[r] = 0.0 - k[r];
    }
    if (!(h > 0.0 && q[2] > 0.0 && q[2] <= (double)g->far_z)) return 0;
    out->x = (float)(q[0] * g->focal / q[2]) + g->center_x;
    out->y = g->center_y - (float)(q[1] * g->focal / q[2]);
    if (!(out->x >= 0.0f && out->x < g->width && out->y >= 0.0f && out->y < g->height)) return 0;
    if (g->thin) { /* keep it with probability prj / bound: H / h_ref (z_min / z)^3 */
        const double z = q[2] * (double)d->iz_ref, t = (double)at->keep * (double)d->h_ref * (z * z * z);
        if (!(t * t * length < h * h)) return 0;
    }
    out->ix = (uint32_t)(int32_t)out->x;
    out->iy = (uint32_t)(int32_t)out->y;
    if (g->cut->veil.opacity != NULL) {
        const zbufrandi_mask m = zbufrandi_veil_cluster(&g->cut->veil, at->cluster);
        if (!zbufrandi_mask_shows(&m, (size_t)out->iy * g->keys.width + out->ix)) return 0;
    }
    out->z = (float)q[2];
    out->shown = out->z;
    out->slope[0] = (float)(0.0 - k[0] / (g->focal * h));
    out->slope[1] = (float)(k[1] / (g->focal * h));
    if (g->plane) { /* 1/z of the plane at the centre of the pixel, within the depths of the triangle */
        const double dx = (double)((float)(int32_t)out->ix + 0.5f - out->x);
        const double dy = (double)((float)(int32_t)out->iy + 0.5f - out->y);
        const double den = h / q[2] - (k[0] * dx - k[1] * dy) / g->focal;
        double z = den > 0.0 ? h / den : 1e30;
        for (r = 0; r < 3; r++) {
            const double t = at->m[2][0] * (double)c[r][0] + at->m[2][1] * (double)c[r][1] +
                             at->m[2][2] * (double)c[r][2] + at->m[2][3];
            z_lo = t < z_lo ? t : z_lo;
            z_hi = t > z_hi ? t : z_hi;
        }
        z = z < z_hi ? z : z_hi;
        z = z > z_lo ? z : z_lo;
        out->shown = (float)z;
    }
    return out->shown <= g->far_z && out->shown > 0.0f;
}

/* Samples first..last-1 of a draw. Returns how many are in the picture. Some are looked up at a time, so that waiting
   for memory overlaps. */
static uint32_t zbufrandi_draw_listed(const zbufrandi_target *g, const zbufrandi_draw *d, uint32_t first,
                                      uint32_t last, const zbufrandi_local *l) {
    enum { RUN = 16 };
    zbufrandi_list_spot at[RUN];
    zbufrandi_spot seen;
    uint32_t j, k, n, accepted = 0;
    for (j = first; j < last; j += n) {
        n = last - j < RUN ? last - j : (uint32_t)RUN;
        for (k = 0; k < n; k++) {
            zbufrandi_list_find(g->cut->scene, l, d, j + k, &at[k]);
            ZBUFRANDI_PREFETCH(at[k].corner[0]);
            ZBUFRANDI_PREFETCH(at[k].corner[1]);
            ZBUFRANDI_PREFETCH(at[k].corner[2]);
        }
        for (k = 0; k < n; k++) {
            if (!zbufrandi_list_sample(g, d, &at[k], &seen)) continue;
            zbufrandi_target_put(g, (size_t)seen.iy * g->keys.width + seen.ix,
                                 zbufrandi_key(seen.shown, d->block * ZBUFRANDI_SET + j + k));
            accepted++;
        }
    }
    return accepted;
}

/* The triangles of a run through the rasteriser, as clusters made for the moment. */
static void zbufrandi_raster_listed(zbufrandi_raster *r, const zbufrandi_structure *s, const zbufrandi_draw *d,
                                    const zbufrandi_veil *veil) {
    enum { RUN = 64 };
    float position[9 * RUN + 24];
    uint8_t tri[3 * RUN + 48];
    const uint32_t first = d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u);
    uint32_t i, n = 0, k, flags = 0, mesh = 0;
    memset(position, 0, sizeof position);
    memset(tri, 0, sizeof tri);
    for (i = 0; i < 3 * RUN; i++) tri[i] = (uint8_t)i;
    for (i = 0; i <= d->count; i++) {
        const float *c[3];
        uint32_t two = flags, of = mesh;
        if (i < d->count) {
            const zbufrandi_cluster *cluster = zbufrandi_list_triangle(s, s->lists->object[first + i], c);
            two = cluster->flags & ZBUFRANDI_TWO_SIDED;
            of = cluster->mesh;
            if (i == 0) mesh = of;
        }
        if (n != 0 && (i == d->count || n == RUN || two != flags || of != mesh)) {
            if (veil->opacity != NULL) r->mask = zbufrandi_veil_mask(veil, veil->scene->mesh[mesh].m.material);
            (void)zbufrandi_raster_cluster(r, position, 3 * n, tri, n, (int)flags,
                                           d->block * ZBUFRANDI_SET + i - n);
            n = 0;
        }
        flags = two;
        mesh = of;
        if (i == d->count) break;
        for (k = 0; k < 3; k++) memcpy(position + 9 * n + 3 * k, c[k], 3 * sizeof(float));
        n++;
    }
}

/* ---------------------------------------------------------------------------
   zbuffer: every triangle of a scene through the rasteriser.                   // >>zbuffer

   What sampling is compared with: the trees serve to drop what is beside the picture, all else is drawn in storage
   order. The time is proportional to the number of triangles in view.
   --------------------------------------------------------------------------- */

enum { ZBUFRANDI_ZBUFFER_ITEMS = 4096, ZBUFRANDI_ZBUFFER_LOCALS = 512, ZBUFRANDI_ZBUFFER_TASK = 32 };

typedef struct zbufrandi_zbuffer_item { uint32_t local, cluster, number; } zbufrandi_zbuffer_item;

typedef struct zbufrandi_zbuffer {
    const zbufrandi_structure *structure;
    const zbufrand_env *env;
    zbufrandi_cut cut;                 /* scene and camera are used */
    zbufrandi_raster raster;
    zbufrandi_zbuffer_item *item;      /* drawn together */
    zbufrandi_local *local;
    uint32_t item_count, local_count, flushes;
    uint64_t triangles;                /* handed to the rasteriser */
    uint32_t covered[2];               /* tally of covered pixels, hidden ones too */
} zbufrandi_zbuffer;

static void zbufrandi_zbuffer_task(void *ctx, uint32_t task) {
    zbufrandi_zbuffer *z = (zbufrandi_zbuffer *)ctx;
    zbufrandi_raster r = z->raster;
    uint32_t i = task * ZBUFRANDI_ZBUFFER_TASK, end = i + ZBUFRANDI_ZBUFFER_TASK, local = ~0u;
    uint64_t covered = 0;
    if (end > z->item_count) end = z->item_count;
    for (; i < end; i++) {
        const zbufrandi_zbuffer_item *item = &z->item[i];
        const zbufrandi_local *l = &z->local[item->local];
        const zbufrandi_structure *s = &z->structure[l->structure];
        const zbufrandi_cluster *c = &s->cluster[item->cluster];
        if (item->local != local) zbufrandi_raster_local(&r, l);
        local = item->local;
        covered += zbufrandi_raster_cluster(&r, s->position + 3 * (size_t)c->first_vertex, c->vertex_count,
                                            s->triangle + 3 * (size_t)c->first_triangle, c->triangle_count,
                                            c->flags & ZBUFRANDI_TWO_SIDED, item->number);
    }
    zbufrandi_tally_add(z->covered, covered);
}

static void zbufrandi_zbuffer_flush(zbufrandi_zbuffer *z) {
    zbufrandi_parallel_for(z->env, zbufrandi_zbuffer_task, z,
                           (z->item_count + ZBUFRANDI_ZBUFFER_TASK - 1) / ZBUFRANDI_ZBUFFER_TASK);
    z->item_count = 0;
    z->local_count = 0;
    z->flushes++;
}

/* Whether a box is beside the picture, behind the near plane or beyond the far one. */
static int zbufrandi_zbuffer_outside(const zbufrandi_zbuffer *z, const zbufrandi_local *l, const zbufrandi_sides *s,
                                     const zbufrandi_node8 *n, uint32_t lane) {
    float q[3], e[3], depth, reach, slack;
    uint32_t a, p;
    for (a = 0; a < 3; a++) {
        e[a] = (n->hi[a][lane] - n->lo[a][lane]) * 0.5f;
        q[a] = (n->lo[a][lane] + n->hi[a][lane]) * 0.5f - l->eye[a];
    }
    slack = (zbufrandi_absf(q[0]) + zbufrandi_absf(q[1]) + zbufrandi_absf(q[2]) + e[0] + e[1] + e[2]) *
            (l->scale * 1e-5f);
    for (p = 0; p < 4; p++) {
        const float d = q[0] * s->side[p][0] + q[1] * s->side[p][1] + q[2] * s->side[p][2];
        reach = e[0] * s->side_e[p][0] + e[1] * s->side_e[p][1] + e[2] * s->side_e[p][2];
        if (d + reach < -slack) return 1;
    }
    depth = q[0] * l->m[2][0] + q[1] * l->m[2][1] + q[2] * l->m[2][2] + l->rest[2];
    reach = e[0] * s->z_e[0] + e[1] * s->z_e[1] + e[2] * s->z_e[2] + slack;
    return depth + reach < (float)z->cut.camera.near_z || depth - reach > (float)z->cut.camera.far_z;
}

/* stored: where l stands in z->local, and since which flush; another flush than the last: it does not stand there. */
static void zbufrandi_zbuffer_node(zbufrandi_zbuffer *z, const zbufrandi_local *l, const zbufrandi_sides *sides,
                                   uint32_t node, uint32_t stored[2]) {
    const zbufrandi_structure *s = &z->structure[l->structure];
    const zbufrandi_node8 *n = &s->node[node];
    uint32_t lane;
    for (lane = 0; lane < n->count; lane++) {
        const uint32_t index = ZBUFRANDI_CHILD_INDEX(n->child[lane]);
        if (zbufrandi_zbuffer_outside(z, l, sides, n, lane)) continue;
        if (ZBUFRANDI_CHILD_KIND(n->child[lane]) == ZBUFRANDI_CHILD_NODE) {
            zbufrandi_zbuffer_node(z, l, sides, index, stored);
        } else if (ZBUFRANDI_CHILD_KIND(n->child[lane]) == ZBUFRANDI_CHILD_INSTANCE) {
            zbufrandi_local inner;
            uint32_t inner_stored[2] = {0, ~0u};
            zbufrandi_sides inner_sides;
            zbufrandi_local_enter(&z->cut, l, ~0u, index, &inner);
            if (z->structure[inner.structure].node_count == 0) continue;
            zbufrandi_sides_of(&z->cut.camera, &inner, &inner_sides);
            zbufrandi_zbuffer_node(z, &inner, &inner_sides, 0, inner_stored);
        } else {
            zbufrandi_zbuffer_item *item;
            if (z->item_count == ZBUFRANDI_ZBUFFER_ITEMS ||
                (stored[1] != z->flushes && z->local_count == ZBUFRANDI_ZBUFFER_LOCALS)) {
                zbufrandi_zbuffer_flush(z);
            }
            if (stored[1] != z->flushes) {
                stored[0] = z->local_count;
                stored[1] = z->flushes;
                z->local[z->local_count++] = *l;
            }
            item = &z->item[z->item_count++];
            item->local = stored[0];
            item->cluster = index;
            item->number = (uint32_t)z->triangles;
            z->triangles += s->cluster[index].triangle_count;
        }
    }
}

/* Draw all of a built scene into the keys, which are not cleared before. Triangles are numbered in the order in which
   they are met, modulo 2^32.
   out_triangles, out_covered  triangles in view; pixels they covered, hidden ones too; may be NULL
   Errors: NO_MEMORY. */
static ZBUFRANDI_UNUSED zbufrand_result zbufrandi_zbuffer_draw(const zbufrand_scene *scene,
                                                               const zbufrandi_camera *camera,
                                                               const zbufrandi_keys *keys, const zbufrand_env *env,
                                                               zbufrandi_mem *mem, int level, uint64_t *out_triangles,
                                                               uint64_t *out_covered) {
    const int alone = env->parallel.for_fn == NULL && zbufrandi_thread_count(env) == 1;
    zbufrandi_zbuffer z;
    zbufrandi_local root;
    zbufrandi_sides sides;
    uint32_t stored[2] = {0, ~0u};
    memset(&z, 0, sizeof z);
    if (out_triangles != NULL) *out_triangles = 0;
    if (out_covered != NULL) *out_covered = 0;
    if (scene->structure_count == 0 || scene->structure[0].node_count == 0) return ZBUFRAND_OK;
    z.structure = scene->structure;
    z.env = env;
    z.cut.scene = scene;
    z.cut.camera = *camera;
    z.item = (zbufrandi_zbuffer_item *)zbufrandi_alloc_array(mem, ZBUFRANDI_ZBUFFER_ITEMS, sizeof *z.item);
    z.local = (zbufrandi_local *)zbufrandi_alloc_array(mem, ZBUFRANDI_ZBUFFER_LOCALS, sizeof *z.local);
    if (z.item == NULL || z.local == NULL) {
        zbufrandi_free(mem, z.item);
        zbufrandi_free(mem, z.local);
        return ZBUFRAND_ERR_NO_MEMORY;
    }
    zbufrandi_raster_begin(&z.raster, camera, keys, alone, level);
    zbufrandi_local_root(camera, &scene->structure[0], 0, &root);
    zbufrandi_sides_of(camera, &root, &sides);
    zbufrandi_zbuffer_node(&z, &root, &sides, 0, stored);
    zbufrandi_zbuffer_flush(&z);
    zbufrandi_free(mem, z.item);
    zbufrandi_free(mem, z.local);
    if (out_triangles != NULL) *out_triangles = z.triangles;
    if (out_covered != NULL) *out_covered = zbufrandi_tally(z.covered);
    return ZBUFRAND_OK;
}

/* ---------------------------------------------------------------------------
   reconstruct: from keys to a picture.                                         // >>reconstruct

   Samples lie in a canvas of keys: the picture and a guard band of `guard` pixels around it.
       occlusion   keys -> keys: which samples are seen. Painting a block of d x d pixels for each sample, nearest in
                   front, is the same as writing one pixel per sample and taking the minimum of the d x d keys around
                   each pixel afterwards: minima commute. The minimum over a square is one over rows, then columns.
       fills       Voronoi: keys -> keys, so that a colour is looked up for what is seen only. Gauss and pull-push work
                   on colours of the samples that are seen.
   Every stage is cut into tasks by rows or columns, each pixel is written by one task from the stage before.
   --------------------------------------------------------------------------- */

ZBUFRANDI_UNUSED static int zbufrandi_level(zbufrand_isa isa) { /* 1 scalar, 2 SSE, 3 AVX2 */
    int level = zbufrandi_cpu_level();
    if (level >= 3 && !ZBUFRANDI_AVX2) level = 2;
    if (isa != ZBUFRAND_ISA_AUTO && (int)isa < level) level = (int)isa;
    return level;
}

static zbufrand_result zbufrandi_size_check(zbufrand_error *error, uint32_t width, uint32_t height) {
    if (width < 1 || height < 1) return zbufrandi_fail(error, ZBUFRAND_ERR_INVALID_ARG, 0, "no pixels");
    if (width > 65535) return zbufrandi_fail(error, ZBUFRAND_ERR_RANGE, width, "width % is above 65535");
    if (height > 65535) return zbufrandi_fail(error, ZBUFRAND_ERR_RANGE, height, "height % is above 65535");
    if ((uint64_t)width * height <= 0x7fffffffu) return ZBUFRAND_OK;
    return zbufrandi_fail(error, ZBUFRAND_ERR_RANGE, (uint64_t)width * height, "% pixels are more than 2^31");
}

/* Depth of a surface at the centre of pixel (ix, iy), of which a sample at (x, y) has depth z. The slope is trusted up
   to a factor of two: at silhouettes it goes to infinity. */
ZBUFRANDI_INLINE float zbufrandi_plane_depth(float z, double x, double y, double slope_x, double slope_y, double ix,
                                             double iy) {
    double inverse = 1.0 / (double)z, at = inverse + (slope_x * (ix + 0.5 - x) + slope_y * (iy + 0.5 - y));
    if (at != at) at = inverse;
    at = zbufrandi_min(zbufrandi_max(at, 0.5 * inverse), 2.0 * inverse);
    return (float)(1.0 / at);
}

/* A key without its low depth bits: depths of one bucket are equal, and the hash lets one of its samples win by chance.
   mask: the bits below a bucket's width; jitter, at most mask, moves the borders. All keys of a canvas have to be made
   so. */
ZBUFRANDI_INLINE uint64_t zbufrandi_key_bucket(float z, uint32_t number, uint32_t mask, uint32_t jitter) {
    uint32_t bits;
    memcpy(&bits, &z, sizeof bits);
    bits = (bits + jitter) & ~mask;
    return (uint64_t)(bits < 0x7f7fffffu ? bits : 0x7f7fffffu) << 32 | zbufrandi_hash32(number);
}

/* ---- rows of keys ----
   In between an empty key is the bit pattern of an infinite double: bits of a positive float in the upper half make a
   finite positive double, so that the processor's minimum of doubles orders keys (there is none of 64-bit integers). */

#define ZBUFRANDI_KEY_INF 0x7ff0000000000000u

#if ZBUFRANDI_AVX2
#define ZBUFRANDI_LOAD4(p) _mm256_loadu_si256((const __m256i *)(const void *)(p))
#define ZBUFRANDI_STORE4(p, v) _mm256_storeu_si256((__m256i *)(void *)(p), v)
#define ZBUFRANDI_LOAD4D(p) _mm256_castsi256_pd(ZBUFRANDI_LOAD4(p))

ZBUFRANDI_TARGET_AVX2 static void zbufrandi_row_min_avx2(uint64_t *dst, const uint64_t *a, const uint64_t *b,
                                                         uint32_t n) {
    uint32_t i = 0;
    for (; i + 8 <= n; i += 8) {
        __m256d v = _mm256_min_pd(ZBUFRANDI_LOAD4D(a + i), ZBUFRANDI_LOAD4D(b + i));
        __m256d w = _mm256_min_pd(ZBUFRANDI_LOAD4D(a + i + 4), ZBUFRANDI_LOAD4D(b + i + 4));
        ZBUFRANDI_STORE4(dst + i, _mm256_castpd_si256(v));
        ZBUFRANDI_STORE4(dst + i + 4, _mm256_castpd_si256(w));
    }
    for (; i < n; i++) dst[i] = a[i] < b[i] ? a[i] : b[i];
}

ZBUFRANDI_TARGET_AVX2 static void zbufrandi_row_open_avx2(uint64_t *dst, const uint64_t *a, uint32_t n) {
    const __m256i empty = _mm256_set1_epi64x(-1), inf = _mm256_set1_epi64x((long long)ZBUFRANDI_KEY_INF);
    uint32_t i = 0;
    for (; i + 4 <= n; i += 4) {
        __m256i v = ZBUFRANDI_LOAD4(a + i);
        ZBUFRANDI_STORE4(dst + i, _mm256_blendv_epi8(v, inf, _mm256_cmpeq_epi64(v, empty)));
    }
    for (; i < n; i++) dst[i] = a[i] == ZBUFRANDI_EMPTY ? ZBUFRANDI_KEY_INF : a[i];
}

/* dst = min(a, b), closed; a, b open; then the minimum with `exact` (closed, may be NULL) */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_row_close_avx2(uint64_t *dst, const uint64_t *a, const uint64_t *b,
                                                           const uint64_t *exact, uint32_t n) {
    const __m256i empty = _mm256_set1_epi64x(-1), inf = _mm256_set1_epi64x((long long)ZBUFRANDI_KEY_INF);
    uint32_t i = 0;
    for (; i + 4 <= n; i += 4) {
        __m256d v = _mm256_min_pd(ZBUFRANDI_LOAD4D(a + i), ZBUFRANDI_LOAD4D(b + i));
        __m256i k;
        if (exact != NULL) {
            k = ZBUFRANDI_LOAD4(exact + i);
            v = _mm256_min_pd(v, _mm256_castsi256_pd(_mm256_blendv_epi8(k, inf, _mm256_cmpeq_epi64(k, empty))));
        }
        k = _mm256_castpd_si256(v);
        ZBUFRANDI_STORE4(dst + i, _mm256_or_si256(k, _mm256_cmpeq_epi64(k, inf)));
    }
    for (; i < n; i++) {
        uint64_t k = a[i] < b[i] ? a[i] : b[i];
        if (k == ZBUFRANDI_KEY_INF) k = ZBUFRANDI_EMPTY;
        dst[i] = exact != NULL && exact[i] < k ? exact[i] : k;
    }
}
#endif

static void zbufrandi_row_min(int level, uint64_t *dst, const uint64_t *a, const uint64_t *b, uint32_t n) {
    uint32_t i;
#if ZBUFRANDI_AVX2
    if (level >= 3) {
        zbufrandi_row_min_avx2(dst, a, b, n);
        return;
    }
#endif
    (void)level;
    for (i = 0; i < n; i++) dst[i] = a[i] < b[i] ? a[i] : b[i];
}

static void zbufrandi_row_open(int level, uint64_t *dst, const uint64_t *a, uint32_t n) {
    uint32_t i;
#if ZBUFRANDI_AVX2
    if (level >= 3) {
        zbufrandi_row_open_avx2(dst, a, n);
        return;
    }
#endif
    (void)level;
    for (i = 0; i < n; i++) dst[i] = a[i] == ZBUFRANDI_EMPTY ? ZBUFRANDI_KEY_INF : a[i];
}

static void zbufrandi_row_close(int level, uint64_t *dst, const uint64_t *a, const uint64_t *b, const uint64_t *exact,
                                uint32_t n) {
    uint32_t i;
#if ZBUFRANDI_AVX2
    if (level >= 3) {
        zbufrandi_row_close_avx2(dst, a, b, exact, n);
        return;
    }
#endif
    (void)level;
    for (i = 0; i < n; i++) {
        uint64_t k = a[i] < b[i] ? a[i] : b[i];
        if (k == ZBUFRANDI_KEY_INF) k = ZBUFRANDI_EMPTY;
        dst[i] = exact != NULL && exact[i] < k ? exact[i] : k;
    }
}

/* ---- minimum over squares ----
   out(x, y) = min of in(i, j), x + shift - back <= i < x + shift - back + d, the same for j; outside `in` is empty.
   Rows by doubling: minima over 2, 4, 8, ... neighbours, two of which make up d: log2 d steps in a line that stays in
   the first cache. Columns: up to 4 rows directly; more by van Herk and Gil & Werman: rows in runs of d, suffix minima
   of the last run and prefix minima of this one make up any d rows: 3 minima a pixel whatever d is. (Rows cannot be
   done so: prefixes would run along the vector.) Strips of 256 columns keep the runs in the cache. */

enum { ZBUFRANDI_STRIP = 256, ZBUFRANDI_STRIDE = ZBUFRANDI_STRIP + 8 }; /* 8: rows in other lines of the cache */

typedef struct zbufrandi_minimum {
    const uint64_t *in, *exact; /* exact: merged unfiltered, aligned with in; or NULL */
    uint64_t *out;
    uint32_t in_width, in_height, out_width, out_height;
    uint32_t shift, back, d;
    uint32_t band;              /* rows of a task */
    uint64_t *scratch;          /* per task: (2 d + 3) strips and 2 d + 8 keys */
    size_t scratch_stride;
    int level;
} zbufrandi_minimum;

static uint32_t zbufrandi_minimum_band(uint32_t d) { return d > 16 ? 4 * d : 64; }
static size_t zbufrandi_minimum_stride(uint32_t d) { return (size_t)(2 * d + 3) * ZBUFRANDI_STRIDE + 2 * d + 8; }
static uint32_t zbufrandi_minimum_tasks(uint32_t height, uint32_t d) {
    uint32_t band = zbufrandi_minimum_band(d);
    return (height + band - 1) / band;
}

/* The minima over d of one row, for columns x0 .. x0+n. */
static void zbufrandi_minimum_line(const zbufrandi_minimum *c, int64_t row, uint32_t x0, uint32_t n, uint64_t *line,
                                   uint64_t *out) {
    int64_t start = (int64_t)x0 + c->shift - c->back;
    uint32_t m = n + c->d - 1, i, from, to, s;
    if (row < 0 || row >= (int64_t)c->in_height) {
        for (i = 0; i < n; i++) out[i] = ZBUFRANDI_KEY_INF;
        return;
    }
    from = start < 0 ? (uint32_t)(start + m <= 0 ? (int64_t)m : -start) : 0;
    to = start + m > (int64_t)c->in_width ? (start >= (int64_t)c->in_width ? 0 : (uint32_t)(c->in_width - start)) : m;
    if (to < from) to = from;
    for (i = 0; i < from; i++) line[i] = ZBUFRANDI_KEY_INF;
    for (i = to; i < m; i++) line[i] = ZBUFRANDI_KEY_INF;
    if (to > from) zbufrandi_row_open(c->level, line + from, c->in + row * c->in_width + (start + from), to - from);
    for (s = 1; 2 * s < c->d; s *= 2) {
        m -= s;
        zbufrandi_row_min(c->level, line, line, line + s, m);
    }
    zbufrandi_row_min(c->level, out, line, line + (c->d - s), n);
}

static void zbufrandi_minimum_task(void *ctx, uint32_t task) {
    const zbufrandi_minimum *c = (const zbufrandi_minimum *)ctx;
    uint64_t *line = c->scratch + task * c->scratch_stride, *prefix = line + ZBUFRANDI_STRIDE + 2 * c->d + 8;
    uint64_t *run[2];
    uint32_t y0 = task * c->band, rows = c->out_height - y0, d = c->d, x0, n, r, k;
    if (rows > c->band) rows = c->band;
    run[0] = prefix + ZBUFRANDI_STRIDE;
    run[1] = run[0] + (size_t)d * ZBUFRANDI_STRIDE;
    for (x0 = 0; x0 < c->out_width; x0 += ZBUFRANDI_STRIP) {
        n = c->out_width - x0;
        if (n > ZBUFRANDI_STRIP) n = ZBUFRANDI_STRIP;
        for (r = 0; r < rows + d - 1; r++) {
            int64_t row = (int64_t)y0 + r + c->shift - c->back;
            uint64_t *here = run[(r / d) & 1] + (size_t)(r % d) * ZBUFRANDI_STRIDE, *out;
            const uint64_t *exact = NULL, *suffix = here;
            zbufrandi_minimum_line(c, row, x0, n, line, here);
            if (d <= 4) { /* the minimum of the last rows is made when it is needed */
                if (r + 1 < d) continue;
                for (k = 1; k + 1 < d; k++) {
                    const uint64_t *other = run[((r - k) / d) & 1] + (size_t)((r - k) % d) * ZBUFRANDI_STRIDE;
                    zbufrandi_row_min(c->level, prefix, k == 1 ? here : prefix, other, n);
                }
                if (d > 1) suffix = run[((r - d + 1) / d) & 1] + (size_t)((r - d + 1) % d) * ZBUFRANDI_STRIDE;
                if (d > 2) here = prefix;
            } else {
                if (r % d == 0) memcpy(prefix, here, n * sizeof *here);
                else zbufrandi_row_min(c->level, prefix, prefix, here, n);
                if (r % d == d - 1) { /* the run is complete: turn its rows into suffix minima */
                    for (k = d - 1; k-- > 0;) {
                        uint64_t *p = run[(r / d) & 1] + (size_t)k * ZBUFRANDI_STRIDE;
                        zbufrandi_row_min(c->level, p, p, p + ZBUFRANDI_STRIDE, n);
                    }
                }
                if (r + 1 < d) continue;
                suffix = run[((r - d + 1) / d) & 1] + (size_t)((r - d + 1) % d) * ZBUFRANDI_STRIDE;
                here = prefix;
            }
            out = c->out + (size_t)(y0 + r + 1 - d) * c->out_width + x0;
            if (c->exact != NULL) exact = c->exact + (size_t)(y0 + r + 1 - d + c->shift) * c->in_width + x0 + c->shift;
            zbufrandi_row_close(c->level, out, suffix, here, exact, n);
        }
    }
}

/* ---- blocks that follow their surface ----
   Each of the d x d samples around a pixel says at which depth its plane passes the pixel; the nearest is shown. */

typedef struct zbufrandi_planes {
    const uint64_t *keys, *exact;
    const float *inverse, *slope_x, *slope_y; /* of the canvas; inverse 0: empty */
    uint64_t *out;
    uint32_t pitch, width, height, guard, back, d;
    int level;
} zbufrandi_planes;

static uint64_t zbufrandi_planes_key(float inverse, uint32_t hash, const uint64_t *exact) {
    uint64_t key = ZBUFRANDI_EMPTY;
    if (inverse > 0.0f) {
        float z = 1.0f / inverse;
        uint32_t bits;
        memcpy(&bits, &z, sizeof bits);
        key = (uint64_t)(bits < 0x7f7fffffu ? bits : 0x7f7fffffu) << 32 | hash;
    }
    return exact != NULL && *exact < key ? *exact : key;
}

/* at: the pixel's place in the canvas */
static uint64_t zbufrandi_planes_pixel(const zbufrandi_planes *c, size_t at) {
    float best = 0.0f;
    uint32_t best_hash = ~0u, i, j;
    for (j = 0; j < c->d; j++) {
        float dy = (float)c->back - (float)j;
        size_t q = at - (size_t)c->back * (c->pitch + 1u) + (size_t)j * c->pitch;
        for (i = 0; i < c->d; i++, q++) {
            float inverse = c->inverse[q], v = c->slope_x[q] * ((float)c->back - (float)i) + c->slope_y[q] * dy;
            uint32_t hash = (uint32_t)c->keys[q];
            v = inverse + v;
            v = v > inverse * 0.5f ? v : inverse * 0.5f;
            v = v < inverse * 2.0f ? v : inverse * 2.0f;
            if (v > best || (v == best && hash < best_hash)) {
                best = v;
                best_hash = hash;
            }
        }
    }
    return zbufrandi_planes_key(best, best_hash, c->exact != NULL ? c->exact + at : NULL);
}

#if ZBUFRANDI_AVX2
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_planes_eight(const zbufrandi_planes *c, size_t at, uint64_t *out) {
    const __m256 half = _mm256_set1_ps(0.5f), two = _mm256_set1_ps(2.0f);
    const __m256i sign = _mm256_set1_epi32((int)0x80000000u);
    __m256 best = _mm256_setzero_ps();
    __m256i best_hash = _mm256_set1_epi32(0x7fffffff); /* ~0, top bit flipped: signed comparison orders hashes then */
    float inverse[8];
    uint32_t hash[8], i, j;
    for (j = 0; j < c->d; j++) {
        const __m256 dy = _mm256_set1_ps((float)c->back - (float)j);
        size_t q = at - (size_t)c->back * (c->pitch + 1u) + (size_t)j * c->pitch;
        for (i = 0; i < c->d; i++, q++) {
            const __m256 dx = _mm256_set1_ps((float)c->back - (float)i);
            __m256 iz = _mm256_loadu_ps(c->inverse + q), v;
            __m256i low = _mm256_castps_si256(_mm256_shuffle_ps(_mm256_castsi256_ps(ZBUFRANDI_LOAD4(c->keys + q)),
                              _mm256_castsi256_ps(ZBUFRANDI_LOAD4(c->keys + q + 4)), 0x88)), take;
            low = _mm256_xor_si256(_mm256_permute4x64_epi64(low, 0xd8), sign);
            v = _mm256_add_ps(_mm256_mul_ps(_mm256_loadu_ps(c->slope_x + q), dx),
                              _mm256_mul_ps(_mm256_loadu_ps(c->slope_y + q), dy));
            v = _mm256_add_ps(iz, v);
            v = _mm256_max_ps(v, _mm256_mul_ps(iz, half));
            v = _mm256_min_ps(v, _mm256_mul_ps(iz, two));
            take = _mm256_and_si256(_mm256_castps_si256(_mm256_cmp_ps(v, best, _CMP_EQ_OQ)),
                                    _mm256_cmpgt_epi32(best_hash, low));
            take = _mm256_or_si256(take, _mm256_castps_si256(_mm256_cmp_ps(v, best, _CMP_GT_OQ)));
            best = _mm256_blendv_ps(best, v, _mm256_castsi256_ps(take));
            best_hash = _mm256_blendv_epi8(best_hash, low, take);
        }
    }
    _mm256_storeu_ps(inverse, best);
    ZBUFRANDI_STORE4(hash, _mm256_xor_si256(best_hash, sign));
    for (i = 0; i < 8; i++) {
        out[i] = zbufrandi_planes_key(inverse[i], hash[i], c->exact != NULL ? c->exact + at + i : NULL);
    }
}
#endif

static void zbufrandi_planes_task(void *ctx, uint32_t task) {
    const zbufrandi_planes *c = (const zbufrandi_planes *)ctx;
    uint32_t y = task * 16, end = y + 16 < c->height ? y + 16 : c->height, x;
    for (; y < end; y++) {
        uint64_t *out = c->out + (size_t)y * c->width;
        size_t at = (size_t)(y + c->guard) * c->pitch + c->guard;
        x = 0;
#if ZBUFRANDI_AVX2
        for (; c->level >= 3 && x + 8 <= c->width; x += 8) zbufrandi_planes_eight(c, at + x, out + x);
#endif
        for (; x < c->width; x++) out[x] = zbufrandi_planes_pixel(c, at + x);
    }
}

/* ---- samples that are seen, as points: cells and squares ---- */

typedef struct zbufrandi_seen {
    const uint64_t *keys, *nearest; /* nearest: minima around; cells find their own */
    uint64_t *out;
    const float *slope_x, *slope_y, *tint;
    const uint8_t *back;
    const zbufrand_reconstruct *o;
    uint32_t width, height, offset;  /* of the canvas; cells begin at `offset`, the guard */
    size_t piece;                    /* pixels of a task for squares */
} zbufrandi_seen;

#define ZBUFRANDI_SOMEWHERE (~(size_t)0)

/* Where the nearest sample is that hides this one; ZBUFRANDI_SOMEWHERE if it is not found. */
static size_t zbufrandi_seen_find(const zbufrandi_seen *c, size_t q, uint64_t nearest) {
    const uint32_t d = c->o->block, x = (uint32_t)(q % c->width), y = (uint32_t)(q / c->width);
    const uint32_t r = 2 * (d / 2);
    const uint32_t x1 = c->width - x > r ? x + r : c->width - 1, y1 = c->height - y > r ? y + r : c->height - 1;
    uint32_t i, j;
    for (j = y > r ? y - r : 0; j <= y1; j++) {
        const size_t row = (size_t)j * c->width;
        for (i = x > r ? x - r : 0; i <= x1; i++) if (c->keys[row + i] == nearest) return row + i;
    }
    return ZBUFRANDI_SOMEWHERE;
}

/* Has a sample about the colour of the nearest one, which is at p? */
static int zbufrandi_seen_alike(const zbufrandi_seen *c, size_t q, size_t p) {
    uint32_t a;
    if (p == ZBUFRANDI_SOMEWHERE) return 0;
    for (a = 0; a < 3; a++)
        if (!(zbufrandi_absf(c->tint[3 * q + a] - c->tint[3 * p + a]) <= c->o->tolerance_color)) return 0;
    return 1;
}

/* at: where the nearest one is, or ZBUFRANDI_SOMEWHERE: it is looked for. */
static int zbufrandi_seen_keep(const zbufrandi_seen *c, size_t q, uint64_t nearest, size_t at) {
    const zbufrand_reconstruct *o = c->o;
    float z = zbufrandi_key_depth(c->keys[q]), z_min = zbufrandi_key_depth(nearest);
    if (c->back != NULL && c->back[q]) return 0;
    if (z <= z_min) return 1;
    if (o->tolerance > 0.0f && z <= z_min * (1.0f + o->tolerance)) return 1;
    if (o->tolerance_projected > 0.0f) {
        double f = (double)o->focal, a = (double)z, b = (double)z_min;
        if (f * a / (f + a) <= f * b / (f + b) + (double)o->tolerance_projected) return 1;
    }
    if (o->tolerance_slope > 0.0f && c->slope_x != NULL) { /* dz = -z^2 d(1/z) */
        float g = sqrtf(c->slope_x[q] * c->slope_x[q] + c->slope_y[q] * c->slope_y[q]) * z * z;
        if (z - z_min <= o->tolerance_slope * g * (float)o->block) return 1;
    }
    if (c->tint == NULL) return 0;
    return zbufrandi_seen_alike(c, q, at != ZBUFRANDI_SOMEWHERE ? at : zbufrandi_seen_find(c, q, nearest));
}

static void zbufrandi_squares_task(void *ctx, uint32_t task) {
    const zbufrandi_seen *c = (const zbufrandi_seen *)ctx;
    const size_t pixels = (size_t)c->width * c->height;
    size_t q = task * c->piece, stop = pixels - q < c->piece ? pixels : q + c->piece;
    for (; q < stop; q++) {
        const uint64_t key = c->keys[q];
        c->out[q] = key != ZBUFRANDI_EMPTY && zbufrandi_seen_keep(c, q, c->nearest[q], ZBUFRANDI_SOMEWHERE)
            ? key : ZBUFRANDI_EMPTY;
    }
}

/* A task is a row of cells. One begins at the picture's corner; the first and the last may be cut by the canvas. */
static void zbufrandi_cells_task(void *ctx, uint32_t task) {
    const zbufrandi_seen *c = (const zbufrandi_seen *)ctx;
    uint32_t d = c->o->block, lead = c->offset % d, x0 = 0, x1, x, y, y0, y1;
    y0 = task == 0 ? 0 : task * d - (lead != 0 ? d - lead : 0);
    y1 = task == 0 && lead != 0 ? lead : y0 + d;
    if (y1 > c->height) y1 = c->height;
    for (x1 = lead != 0 ? lead : d; x0 < c->width; x0 = x1, x1 += d) {
        uint64_t nearest = ZBUFRANDI_EMPTY;
        size_t at = 0;
        if (x1 > c->width) x1 = c->width;
        for (y = y0; y < y1; y++) {
            const size_t row = (size_t)y * c->width;
            for (x = x0; x < x1; x++) {
                if (!(c->keys[row + x] < nearest)) continue;
                nearest = c->keys[row + x];
                at = row + x;
            }
        }
        for (y = y0; y < y1; y++) {
            size_t q = (size_t)y * c->width + x0;
            for (x = x0; x < x1; x++, q++) {
                const uint64_t key = c->keys[q];
                c->out[q] = key != ZBUFRANDI_EMPTY && zbufrandi_seen_keep(c, q, nearest, at) ? key : ZBUFRANDI_EMPTY;
            }
        }
    }
}

/* For squares in their second reading: minima at the places of samples only. */
static void zbufrandi_mask_task(void *ctx, uint32_t task) {
    const zbufrandi_seen *c = (const zbufrandi_seen *)ctx;
    uint32_t y = task * 16, end = y + 16 < c->height ? y + 16 : c->height;
    size_t q = (size_t)y * c->width, stop = (size_t)end * c->width;
    for (; q < stop; q++) c->out[q] = c->keys[q] != ZBUFRANDI_EMPTY ? c->nearest[q] : ZBUFRANDI_EMPTY;
}

/* ---- Voronoi regions ----
   Both distances are separable: first the nearest sample of each column, then the best column of each row. Ties in L1
   go to the smaller hash of the sample, so they favour no direction; in L2 those within a column do. The thesis grows
   the regions with a queue: the same regions but for ties, in about the same time, but on one thread.
   A column's answer is one number, ordered by distance first: distance << 44 | 27 bits of the hash << 17 | row. */

typedef struct zbufrandi_voronoi {
    const uint64_t *keys; /* [pitch * rows] */
    uint64_t *out;        /* [width * height] */
    uint64_t *cost;       /* [pitch * rows]: the nearest sample of the column */
    uint32_t *stack;      /* 2 * pitch for each task */
    uint32_t pitch, rows, width, height, guard, reach;
    int euclidean, level;
} zbufrandi_voronoi;

enum { ZBUFRANDI_VORONOI_COLUMNS = 64, ZBUFRANDI_VORONOI_ROWS = 16 };
#define ZBUFRANDI_STEP ((uint64_t)1 << 44)
#define ZBUFRANDI_NOWHERE ((uint64_t)1 << 62) /* farther than anything, and room for steps */
#define ZBUFRANDI_DISTANCE(cost) ((uint32_t)((cost) >> 44))
#define ZBUFRANDI_ROW(cost) ((uint32_t)(cost) & 0x1ffffu)

/* dst = the pixel's own sample, or `before` one step on */
ZBUFRANDI_INLINE uint64_t zbufrandi_voronoi_own(uint64_t key, uint64_t before, uint32_t y) {
    uint64_t own = (key & 0xffffffe0u) << 12 | y;
    before += ZBUFRANDI_STEP;
    return key != ZBUFRANDI_EMPTY ? own : before;
}

#if ZBUFRANDI_AVX2
/* The first n columns, n a multiple of 4, one row: down from `before` if keys are given, else up. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_voronoi_step_avx2(const uint64_t *keys, const uint64_t *before,
                                                              uint64_t *cost, uint32_t y, uint32_t n) {
    const __m256i step = _mm256_set1_epi64x((long long)ZBUFRANDI_STEP), row = _mm256_set1_epi64x((long long)y);
    const __m256i hash = _mm256_set1_epi64x(0xffffffe0ll), empty = _mm256_set1_epi64x(-1);
    uint32_t x;
    for (x = 0; x < n; x += 4) {
        __m256i b = _mm256_add_epi64(ZBUFRANDI_LOAD4(before + x), step), c;
        if (keys != NULL) {
            __m256i k = ZBUFRANDI_LOAD4(keys + x);
            c = _mm256_or_si256(_mm256_slli_epi64(_mm256_and_si256(k, hash), 12), row);
            c = _mm256_blendv_epi8(c, b, _mm256_cmpeq_epi64(k, empty));
        } else {
            c = ZBUFRANDI_LOAD4(cost + x);
            c = _mm256_blendv_epi8(c, b, _mm256_cmpgt_epi64(c, b));
        }
        ZBUFRANDI_STORE4(cost + x, c);
    }
}
#endif

static void zbufrandi_voronoi_columns(void *ctx, uint32_t task) {
    const zbufrandi_voronoi *c = (const zbufrandi_voronoi *)ctx;
    uint32_t x0 = task * ZBUFRANDI_VORONOI_COLUMNS, n = c->pitch - x0, x, y;
    if (n > ZBUFRANDI_VORONOI_COLUMNS) n = ZBUFRANDI_VORONOI_COLUMNS;
    for (y = 0; y < c->rows; y++) { /* from above */
        const uint64_t *keys = c->keys + (size_t)y * c->pitch + x0;
        uint64_t *cost = c->cost + (size_t)y * c->pitch + x0;
        x = 0;
#if ZBUFRANDI_AVX2
        if (c->level >= 3 && y > 0) {
            x = n & ~3u;
            zbufrandi_voronoi_step_avx2(keys, cost - c->pitch, cost, y, x);
        }
#endif
        for (; x < n; x++) {
            cost[x] = zbufrandi_voronoi_own(keys[x], y > 0 ? *(cost + x - c->pitch) : ZBUFRANDI_NOWHERE, y);
        }
    }
    for (y = c->rows; y-- > 1;) { /* from below */
        uint64_t *cost = c->cost + (size_t)(y - 1) * c->pitch + x0;
        x = 0;
#if ZBUFRANDI_AVX2
        if (c->level >= 3) {
            x = n & ~3u;
            zbufrandi_voronoi_step_avx2(NULL, cost + c->pitch, cost, y, x);
        }
#endif
        for (; x < n; x++) {
            uint64_t below = cost[x + c->pitch] + ZBUFRANDI_STEP;
            cost[x] = below < cost[x] ? below : cost[x];
        }
    }
}

/* L1 along a row: what was best one pixel before costs one step more. In place; `column` keeps where the best of the
   left came from. */
static void zbufrandi_voronoi_row_l1(const zbufrandi_voronoi *c, uint32_t y, uint32_t *column) {
    const uint64_t marked = (uint64_t)1 << 63; /* a column to the left is better than this one */
    uint64_t *cost = c->cost + (size_t)(y + c->guard) * c->pitch, *out = c->out + (size_t)y * c->width;
    uint64_t best = ZBUFRANDI_NOWHERE;
    uint32_t x, from = 0;
    for (x = 0; x < c->pitch; x++) {
        best += ZBUFRANDI_STEP;
        from = cost[x] <= best ? x : from;
        best = cost[x] <= best ? cost[x] : best | marked;
        column[x] = from;
        cost[x] = best;
        best &= ~marked;
    }
    best = ZBUFRANDI_NOWHERE;
    for (x = c->pitch; x-- > 0;) { /* from the right; marked columns are better reached from others */
        uint64_t left = cost[x] & ~marked, key;
        best += ZBUFRANDI_STEP;
        from = cost[x] < best ? x : from; /* never so if marked */
        best = cost[x] < best ? cost[x] : best;
        if (x < c->guard || x >= c->guard + c->width) continue;
        key = c->keys[(size_t)ZBUFRANDI_ROW(left < best ? left : best) * c->pitch + (left < best ? column[x] : from)];
        out[x - c->guard] = ZBUFRANDI_DISTANCE(left < best ? left : best) <= c->reach ? key : ZBUFRANDI_EMPTY;
    }
}

/* L2 along a row: the lower envelope of the parabolas g(i)^2 + (x - i)^2 of all columns that have a sample, kept as a
   stack of columns and of the first x that each of them rules (Meijster, Roerdink & Hesselink 2000). */
static void zbufrandi_voronoi_row_l2(const zbufrandi_voronoi *c, uint32_t y, uint32_t *column, uint32_t *start) {
    const uint64_t *cost = c->cost + (size_t)(y + c->guard) * c->pitch;
    uint64_t *out = c->out + (size_t)y * c->width, reach2 = (uint64_t)c->reach * c->reach;
    uint32_t x, n = 0;
    for (x = 0; x < c->pitch; x++) {
        int64_t g = ZBUFRANDI_DISTANCE(cost[x]), first = 0;
        if (cost[x] >= ZBUFRANDI_NOWHERE) continue;
        while (n > 0) { /* first x that this column rules against the top of the stack */
            int64_t i = column[n - 1], h = ZBUFRANDI_DISTANCE(cost[i]), num = (int64_t)x * x - i * i + g * g - h * h;
            first = num < 0 ? 0 : num / (2 * ((int64_t)x - i)) + 1;
            if (first > (int64_t)start[n - 1]) break;
            first = 0;
            n--;
        }
        if (first >= (int64_t)c->pitch) continue;
        column[n] = x;
        start[n++] = (uint32_t)first;
    }
    for (x = c->guard + c->width; x-- > c->guard;) {
        uint64_t key = ZBUFRANDI_EMPTY;
        while (n > 1 && start[n - 1] > x) n--;
        if (n > 0) {
            uint32_t i = column[n - 1];
            uint64_t g = ZBUFRANDI_DISTANCE(cost[i]), dx = i > x ? i - x : x - i;
            if (g * g + dx * dx <= reach2) key = c->keys[(size_t)ZBUFRANDI_ROW(cost[i]) * c->pitch + i];
        }
        out[x - c->guard] = key;
    }
}

static void zbufrandi_voronoi_rows(void *ctx, uint32_t task) {
    const zbufrandi_voronoi *c = (const zbufrandi_voronoi *)ctx;
    uint32_t y = task * ZBUFRANDI_VORONOI_ROWS, end = y + ZBUFRANDI_VORONOI_ROWS;
    uint32_t *stack = c->stack + (size_t)task * 2 * c->pitch;
    if (end > c->height) end = c->height;
    for (; y < end; y++) {
        if (c->euclidean) zbufrandi_voronoi_row_l2(c, y, stack, stack + c->pitch);
        else zbufrandi_voronoi_row_l1(c, y, stack);
    }
}

/* ---- Gaussian ----
   Colour = sum of weight * colour / sum of weight over the samples within +-support c. With the samples on pixels this
   is a normalised convolution, and exp(-(1.5 r / c)^2) cut off by a square is separable: O(c) a pixel instead of the
   thesis' O(c^2) and its buckets. Alpha is the weight: 1 for a sample, 0 for none. */

enum { ZBUFRANDI_GAUSS_TAPS = 385 }; /* 256 * 1.5, and one */

typedef struct zbufrandi_gauss {
    const float *in;             /* rgba [in_width * in_height] */
    float *between;              /* rgba [width * in_height] */
    float *out;                  /* rgba [width * height] */
    uint32_t in_width, in_height, width, height, shift;
    int32_t taps;                /* weight[0..taps), taps - 1 to each side */
    const float *weight;
    int level;
} zbufrandi_gauss;

/* acc += w (a + b) */
#if ZBUFRANDI_AVX2
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_row_add_avx2(float *acc, const float *a, const float *b, float w,
                                                         uint32_t n) {
    const __m256 k = _mm256_set1_ps(w);
    uint32_t i = 0;
    for (; i + 8 <= n; i += 8) {
        __m256 s = _mm256_mul_ps(k, _mm256_add_ps(_mm256_loadu_ps(a + i), _mm256_loadu_ps(b + i)));
        _mm256_storeu_ps(acc + i, _mm256_add_ps(_mm256_loadu_ps(acc + i), s));
    }
    for (; i < n; i++) acc[i] = acc[i] + w * (a[i] + b[i]);
}
#endif
static void zbufrandi_row_add(int level, float *acc, const float *a, const float *b, float w, uint32_t n) {
    uint32_t i;
#if ZBUFRANDI_AVX2
    if (level >= 3) {
        zbufrandi_row_add_avx2(acc, a, b, w, n);
        return;
    }
#endif
    (void)level;
    for (i = 0; i < n; i++) acc[i] = acc[i] + w * (a[i] + b[i]);
}

static void zbufrandi_gauss_rows(void *ctx, uint32_t task) {
    const zbufrandi_gauss *c = (const zbufrandi_gauss *)ctx;
    uint32_t y = task * 16, end = y + 16 < c->in_height ? y + 16 : c->in_height, i, n, x0;
    for (; y < end; y++) {
        const float *row = c->in + (size_t)y * c->in_width * 4;
        for (x0 = 0; x0 < c->width; x0 += ZBUFRANDI_STRIP) { /* the accumulator stays in the first cache */
            float *acc = c->between + ((size_t)y * c->width + x0) * 4;
            int32_t k;
            n = c->width - x0 < ZBUFRANDI_STRIP ? c->width - x0 : (uint32_t)ZBUFRANDI_STRIP;
            for (i = 0; i < 4 * n; i++) acc[i] = c->weight[0] * row[(size_t)(x0 + c->shift) * 4 + i];
            for (k = 1; k < c->taps; k++) {
                int64_t left = (int64_t)x0 + c->shift - k, right = (int64_t)x0 + c->shift + k;
                if (left >= 0 && right + n <= c->in_width) {
                    zbufrandi_row_add(c->level, acc, row + left * 4, row + right * 4, c->weight[k], 4 * n);
                } else { /* beyond the canvas there is nothing */
                    for (i = 0; i < 4 * n; i++) {
                        int64_t a = left + (int64_t)(i / 4), b = right + (int64_t)(i / 4);
                        float u = a >= 0 && a < (int64_t)c->in_width ? row[a * 4 + (i & 3)] : 0.0f;
                        float v = b < (int64_t)c->in_width ? row[b * 4 + (i & 3)] : 0.0f;
                        acc[i] = acc[i] + c->weight[k] * (u + v);
                    }
                }
            }
        }
    }
}

static void zbufrandi_gauss_columns(void *ctx, uint32_t task) {
    const zbufrandi_gauss *c = (const zbufrandi_gauss *)ctx;
    uint32_t y = task * 16, end = y + 16 < c->height ? y + 16 : c->height, x0, i, n;
    float acc[4 * ZBUFRANDI_STRIP], zero[4 * ZBUFRANDI_STRIP];
    memset(zero, 0, sizeof zero);
    for (; y < end; y++) {
        for (x0 = 0; x0 < c->width; x0 += ZBUFRANDI_STRIP) {
            const float *column = c->between + (size_t)x0 * 4;
            float *out = c->out + ((size_t)y * c->width + x0) * 4;
            size_t pitch = (size_t)c->width * 4;
            int64_t at = (int64_t)y + c->shift;
            int32_t k;
            n = c->width - x0 < ZBUFRANDI_STRIP ? c->width - x0 : (uint32_t)ZBUFRANDI_STRIP;
            memset(acc, 0, sizeof acc);
            for (i = 0; i < 4 * n; i++) acc[i] = c->weight[0] * column[(size_t)at * pitch + i];
            for (k = 1; k < c->taps; k++) {
                const float *a = at - k >= 0 ? column + (size_t)(at - k) * pitch : zero;
                const float *b = at + k < (int64_t)c->in_height ? column + (size_t)(at + k) * pitch : zero;
                zbufrandi_row_add(c->level, acc, a, b, c->weight[k], 4 * n);
            }
            for (i = 0; i < n; i++) {
                float w = acc[4 * i + 3];
                int any = w > 0.0f;
                out[4 * i] = any ? acc[4 * i] / w : 0.0f;
                out[4 * i + 1] = any ? acc[4 * i + 1] / w : 0.0f;
                out[4 * i + 2] = any ? acc[4 * i + 2] / w : 0.0f;
                out[4 * i + 3] = any ? 1.0f : 0.0f;
            }
        }
    }
}

/* weight[k] = exp(-(1.5 k / radius)^2), 0 from support * radius on; returns the number of weights. */
static int32_t zbufrandi_gauss_weights(float radius, float support, float *weight) {
    double c = (double)radius;
    int32_t k = 0;
    for (; k < ZBUFRANDI_GAUSS_TAPS && (k == 0 || (double)k < (double)support * c); k++) {
        double t = 1.5 * (double)k / c;
        weight[k] = (float)zbufrandi_exp2(-t * t * 1.44269504088896340736);
        if (weight[k] == 0.0f) break;
    }
    return k;
}

/* ---- four floats: a colour. The forms do the same operations; the second is NEON and WebAssembly ---- */

#if ZBUFRANDI_X64
typedef __m128 zbufrandi_f4;
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_load(const float *p) { return _mm_loadu_ps(p); }
ZBUFRANDI_INLINE void zbufrandi_f4_store(float *p, zbufrandi_f4 a) { _mm_storeu_ps(p, a); }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_all(float x) { return _mm_set1_ps(x); }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_add(zbufrandi_f4 a, zbufrandi_f4 b) { return _mm_add_ps(a, b); }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_sub(zbufrandi_f4 a, zbufrandi_f4 b) { return _mm_sub_ps(a, b); }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_mul(zbufrandi_f4 a, zbufrandi_f4 b) { return _mm_mul_ps(a, b); }
ZBUFRANDI_INLINE float zbufrandi_f4_last(zbufrandi_f4 a) { return _mm_cvtss_f32(_mm_shuffle_ps(a, a, 0xff)); }
#elif !defined(ZBUFRAND_NO_SIMD) && (defined(__aarch64__) || defined(__wasm_simd128__)) && \
    (defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 9))
typedef float zbufrandi_f4 __attribute__((vector_size(16)));
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_load(const float *p) {
    const zbufrandi_f4 r = {p[0], p[1], p[2], p[3]};
    return r;
}
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_all(float x) {
    const zbufrandi_f4 r = {x, x, x, x};
    return r;
}
ZBUFRANDI_INLINE void zbufrandi_f4_store(float *p, zbufrandi_f4 a) { memcpy(p, &a, sizeof a); }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_add(zbufrandi_f4 a, zbufrandi_f4 b) { return a + b; }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_sub(zbufrandi_f4 a, zbufrandi_f4 b) { return a - b; }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_mul(zbufrandi_f4 a, zbufrandi_f4 b) { return a * b; }
ZBUFRANDI_INLINE float zbufrandi_f4_last(zbufrandi_f4 a) { return a[3]; }
#else
typedef struct zbufrandi_f4 { float v[4]; } zbufrandi_f4;
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_load(const float *p) {
    zbufrandi_f4 r;
    memcpy(r.v, p, 16);
    return r;
}
ZBUFRANDI_INLINE void zbufrandi_f4_store(float *p, zbufrandi_f4 a) { memcpy(p, a.v, 16); }
ZBUFRANDI_INLINE zbufrandi_f4 zbufrandi_f4_all(float x) {
    zbufrandi_f4 r;
    r.v[0] = r.v[1] = r.v[2] = r.v[3] = x;
    return r;
}
#define ZBUFRANDI_F4(name, op) \
    ZBUFRANDI_INLINE zbufrandi_f4 name(zbufrandi_f4 a, zbufrandi_f4 b) { \
        int i; \
        for (i = 0; i < 4; i++) a.v[i] = a.v[i] op b.v[i]; \
        return a; \
    }
ZBUFRANDI_F4(zbufrandi_f4_add, +)
ZBUFRANDI_F4(zbufrandi_f4_sub, -)
ZBUFRANDI_F4(zbufrandi_f4_mul, *)
#undef ZBUFRANDI_F4
ZBUFRANDI_INLINE float zbufrandi_f4_last(zbufrandi_f4 a) { return a.v[3]; }
#endif

/* ---- pull-push ----
   Pull: each coarser pixel is the mean of the up to four below it that have anything, with alpha as their weight. Push:
   from coarse to fine, what a pixel lacks to alpha 1 comes from the coarser level, interpolated linearly. */

enum { ZBUFRANDI_PYRAMID = 18 };

typedef struct zbufrandi_pyramid_level {
    float *rgba;
    uint32_t width, height;
} zbufrandi_pyramid_level;

typedef struct zbufrandi_pull_push {
    zbufrandi_pyramid_level level[ZBUFRANDI_PYRAMID];
    uint32_t count, at;
} zbufrandi_pull_push;

static size_t zbufrandi_pull_push_floats(uint32_t width, uint32_t height) { /* of the levels above the picture */
    size_t n = 0;
    while (width > 1 || height > 1) {
        width = (width + 1) / 2;
        height = (height + 1) / 2;
        n += (size_t)width * height * 4;
    }
    return n;
}

/* out = sum of up to four pixels, alpha cut at 1 */
ZBUFRANDI_INLINE void zbufrandi_pull_pixel(const float *a, const float *b, int right, int below, float *out) {
    zbufrandi_f4 s = zbufrandi_f4_load(a);
    float alpha;
    if (right) s = zbufrandi_f4_add(s, zbufrandi_f4_load(a + 4));
    if (below) {
        zbufrandi_f4 t = zbufrandi_f4_load(b);
        if (right) t = zbufrandi_f4_add(t, zbufrandi_f4_load(b + 4));
        s = zbufrandi_f4_add(s, t);
    }
    alpha = zbufrandi_f4_last(s);
    if (alpha > 1.0f) s = zbufrandi_f4_mul(s, zbufrandi_f4_all(1.0f / alpha));
    zbufrandi_f4_store(out, s);
    if (alpha > 1.0f) out[3] = 1.0f;
}

static void zbufrandi_pull_task(void *ctx, uint32_t task) {
    const zbufrandi_pull_push *c = (const zbufrandi_pull_push *)ctx;
    const zbufrandi_pyramid_level *f = &c->level[c->at], *g = f + 1;
    uint32_t y = task * 16, end = y + 16 < g->height ? y + 16 : g->height, x;
    for (; y < end; y++) {
        float *out = g->rgba + (size_t)y * g->width * 4;
        const float *a = f->rgba + (size_t)(2 * y) * f->width * 4, *b = a + (size_t)f->width * 4;
        int below = 2 * y + 1 < f->height;
        x = 0;
        if (below) for (; x < f->width / 2; x++) zbufrandi_pull_pixel(a + 8 * x, b + 8 * x, 1, 1, out + 4 * x);
        else for (; x < f->width / 2; x++) zbufrandi_pull_pixel(a + 8 * x, a, 1, 0, out + 4 * x);
        if (x < g->width) zbufrandi_pull_pixel(a + 8 * x, b + 8 * x, 0, below, out + 4 * x);
    }
}

static void zbufrandi_push_task(void *ctx, uint32_t task) { /* at: the finer level */
    const zbufrandi_pull_push *c = (const zbufrandi_pull_push *)ctx;
    const zbufrandi_pyramid_level *f = &c->level[c->at], *g = f + 1;
    const zbufrandi_f4 own = zbufrandi_f4_all(0.5625f), side = zbufrandi_f4_all(0.1875f);
    const zbufrandi_f4 corner = zbufrandi_f4_all(0.0625f);
    uint32_t y = task * 16, end = y + 16 < f->height ? y + 16 : f->height, x;
    for (; y < end; y++) {
        float *out = f->rgba + (size_t)y * f->width * 4;
        uint32_t cy = y / 2, ny = y & 1 ? cy + 1 : cy - 1;
        const float *p, *q;
        if (ny >= g->height) ny = cy; /* and below 0 */
        p = g->rgba + (size_t)cy * g->width * 4;
        q = g->rgba + (size_t)ny * g->width * 4;
        for (x = 0; x < f->width; x++, out += 4) {
            uint32_t cx = x / 2, nx = x & 1 ? cx + 1 : cx - 1;
            float lack = 1.0f - out[3], alpha;
            zbufrandi_f4 s, t;
            if (!(lack > 0.0f)) continue;
            if (nx >= g->width) nx = cx;
            s = zbufrandi_f4_mul(own, zbufrandi_f4_load(p + 4 * cx));
            t = zbufrandi_f4_add(zbufrandi_f4_load(p + 4 * nx), zbufrandi_f4_load(q + 4 * cx));
            s = zbufrandi_f4_add(s, zbufrandi_f4_mul(side, t));
            s = zbufrandi_f4_add(s, zbufrandi_f4_mul(corner, zbufrandi_f4_load(q + 4 * nx)));
            alpha = zbufrandi_f4_last(s);
            if (!(alpha > 0.0f)) continue;
            s = zbufrandi_f4_mul(s, zbufrandi_f4_all(lack / alpha));
            zbufrandi_f4_store(out, zbufrandi_f4_add(zbufrandi_f4_load(out), s));
            out[3] = 1.0f;
        }
    }
}

/* In place in `rgba`. levels: memory for zbufrandi_pull_push_floats. reach: 0 without limit. */
static void zbufrandi_pull_push_run(const zbufrand_env *env, zbufrandi_asker *asker, float *rgba, uint32_t width,
                                    uint32_t height, float *levels, uint32_t reach) {
    zbufrandi_pull_push c;
    zbufrandi_pyramid_level *top;
    size_t i, n;
    uint32_t cell = 1;
    memset(&c, 0, sizeof c);
    c.level[0].rgba = rgba;
    c.level[0].width = width;
    c.level[0].height = height;
    for (c.count = 1; c.count < ZBUFRANDI_PYRAMID; c.count++) {
        zbufrandi_pyramid_level *g = &c.level[c.count], *f = g - 1;
        if ((f->width == 1 && f->height == 1) || (reach != 0 && cell >= reach)) break;
        cell *= 2;
        g->width = (f->width + 1) / 2;
        g->height = (f->height + 1) / 2;
        g->rgba = levels;
        levels += (size_t)g->width * g->height * 4;
        c.at = c.count - 1;
        if (!zbufrandi_parallel_ask(env, asker, zbufrandi_pull_task, &c, (g->height + 15) / 16)) return;
    }
    top = &c.level[c.count - 1];
    n = (size_t)top->width * top->height * 4;
    for (i = 0; i < n; i += 4) { /* nothing above it can add to it */
        float a = top->rgba[i + 3];
        if (!(a > 0.0f) || a == 1.0f) continue;
        top->rgba[i] /= a;
        top->rgba[i + 1] /= a;
        top->rgba[i + 2] /= a;
        top->rgba[i + 3] = 1.0f;
    }
    for (c.at = c.count - 1; c.at-- > 0;) {
        (void)zbufrandi_parallel_ask(env, asker, zbufrandi_push_task, &c, (c.level[c.at].height + 15) / 16);
    }
}

/* ---- suspicious pixels ----
   A hole: empty, but enough of the eight neighbours are not. A wrong pixel: enough neighbours are nearer by more than
   the tolerance, on two opposite sides at least, and so is the line through the next two pixels in their direction: the
   bottom of a valley is deeper than all around it, too. And it is as far behind them as they are spread in depth, or
   farther: on a steep surface the depths of single samples scatter by the slope of a pixel. */

typedef struct zbufrandi_suspects {
    const float *depth;
    uint8_t *mask;          /* kind, or 0 */
    uint32_t width, height, hole_count, wrong_count;
    uint32_t reach;         /* neighbours are looked at in this distance, in pixels */
    int sure;               /* 1: as wrong counts all that has enough nearer neighbours, whatever their depths */
    float keep;             /* 1 - tolerance */
    int level;
    const uint8_t *area;    /* of 16 x 16 pixels: 1: look there; NULL: everywhere. Then reach is at most 8 */
} zbufrandi_suspects;

static const int8_t zbufrandi_around[8][2] = {{1, 0}, {1, 1}, {0, 1}, {-1, 1}, {-1, 0}, {-1, -1}, {0, -1}, {1, -1}};

/* Depth at (x + dx, y + dy), INFINITY outside. */
ZBUFRANDI_INLINE float zbufrandi_depth_at(const zbufrandi_suspects *c, uint32_t x, uint32_t y, int dx, int dy) {
    int64_t i = (int64_t)x + dx, j = (int64_t)y + dy;
    if (i < 0 || j < 0 || i >= (int64_t)c->width || j >= (int64_t)c->height) return (float)INFINITY;
    return c->depth[(size_t)j * c->width + (size_t)i];
}

static uint8_t zbufrandi_suspect_pixel(const zbufrandi_suspects *c, uint32_t x, uint32_t y) {
    float z = c->depth[(size_t)y * c->width + x], nearer[8]; /* deepest first */
    const int reach = (int)c->reach;
    uint32_t k, i, n = 0, sides = 0;
    if (!(z < (float)INFINITY)) {
        for (k = 0; k < 8; k++) {
            n += zbufrandi_depth_at(c, x, y, reach * zbufrandi_around[k][0], reach * zbufrandi_around[k][1]) <
                (float)INFINITY;
        }
        return (uint8_t)(n >= c->hole_count ? (int)ZBUFRAND_SUSPECT_HOLE : 0);
    }
    for (k = 0; k < 8; k++) {
        int dx = reach * zbufrandi_around[k][0], dy = reach * zbufrandi_around[k][1];
        float z1 = zbufrandi_depth_at(c, x, y, dx, dy), z2;
        if (!(z1 < z * c->keep)) continue;
        if (c->sure) {
            if (++n >= c->wrong_count) return (uint8_t)ZBUFRAND_SUSPECT_WRONG;
            continue;
        }
        z2 = zbufrandi_depth_at(c, x, y, 2 * dx, 2 * dy);
        /* 1/z runs linearly along a plane: 2/z1 - 1/z2 here; nearer than z by the tolerance? */
        if (z2 < z1 && !((2.0f / z1 - 1.0f / z2) * (z * c->keep) > 1.0f)) continue;
        for (i = n++; i > 0 && nearer[i - 1] < z1; i--) nearer[i] = nearer[i - 1];
        nearer[i] = z1;
        sides |= 1u << k;
    }
    if (c->sure || n < c->wrong_count || (sides & sides >> 4) == 0) return 0;
    return (uint8_t)(z - nearer[0] >= nearer[0] - nearer[c->wrong_count - 1] ? (int)ZBUFRAND_SUSPECT_WRONG : 0);
}

#if ZBUFRANDI_AVX2
/* Which of the 8 pixels from (x, y) have enough nearer neighbours, for holes or for wrong pixels; none of them at the
   border. out_empty: which are empty. */
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_suspect_eight(const zbufrandi_suspects *c, const float *p,
                                                              uint32_t *out_empty) {
    const __m256 here = _mm256_loadu_ps(p);
    const __m256 all = _mm256_set1_ps((float)INFINITY), empty = _mm256_cmp_ps(here, all, _CMP_NLT_UQ);
    const __m256 limit = _mm256_blendv_ps(_mm256_mul_ps(here, _mm256_set1_ps(c->keep)), all, empty); /* also of NaN */
    __m256 least;
    __m256i n = _mm256_setzero_si256();
    const ptrdiff_t r = (ptrdiff_t)c->reach, w = r * (ptrdiff_t)c->width;
    const float *q[8];
    uint32_t k;
    q[0] = p + r; q[1] = p + w + r; q[2] = p + w; q[3] = p + w - r;
    q[4] = p - r; q[5] = p - w - r; q[6] = p - w; q[7] = p - w + r;
    for (k = 0; k < 8; k++) {
        n = _mm256_sub_epi32(n, _mm256_castps_si256(_mm256_cmp_ps(_mm256_loadu_ps(q[k]), limit, _CMP_LT_OQ)));
    }
    least = _mm256_blendv_ps(_mm256_castsi256_ps(_mm256_set1_epi32((int)c->wrong_count - 1)),
                             _mm256_castsi256_ps(_mm256_set1_epi32((int)c->hole_count - 1)), empty);
    *out_empty = (uint32_t)_mm256_movemask_ps(empty);
    return (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpgt_epi32(n, _mm256_castps_si256(least))));
}
#endif

static void zbufrandi_suspect_task(void *ctx, uint32_t task) {
    const zbufrandi_suspects *c = (const zbufrandi_suspects *)ctx;
    const uint8_t *area = c->area != NULL ? c->area + (size_t)task * ((c->width + 15) / 16) : NULL;
    uint32_t y = task * 16, end = y + 16 < c->height ? y + 16 : c->height, x;
    for (; y < end; y++) {
        uint8_t *mask = c->mask + (size_t)y * c->width;
        x = 0;
        if (area != NULL) memset(mask, 0, c->width);
#if ZBUFRANDI_AVX2
        if (c->level >= 3 && y >= c->reach && y + c->reach < c->height && c->width >= 8 + 2 * c->reach) {
            const uint32_t reach = c->reach;
            for (; x < reach; x++)
                if (area == NULL || area[x / 16] == 1) mask[x] = zbufrandi_suspect_pixel(c, x, y);
            for (; x + 8 + reach <= c->width; x += 8) {
                uint32_t empty, bits;
                if (area != NULL && area[x / 16] != 1 && area[(x + 7) / 16] != 1) continue;
                bits = zbufrandi_suspect_eight(c, c->depth + (size_t)y * c->width + x, &empty);
                memset(mask + x, 0, 8);
                for (; bits != 0; bits &= bits - 1) {
                    const uint32_t k = zbufrandi_ctz64(bits);
                    if ((empty >> k & 1u) != 0) mask[x + k] = (uint8_t)ZBUFRAND_SUSPECT_HOLE;
                    else mask[x + k] = c->sure ? (uint8_t)ZBUFRAND_SUSPECT_WRONG : zbufrandi_suspect_pixel(c, x + k, y);
                }
            }
        }
#endif
        for (; x < c->width; x++)
            if (area == NULL || area[x / 16] == 1) mask[x] = zbufrandi_suspect_pixel(c, x, y);
    }
}

/* Index of the first non-zero byte from `at` on, n if there is none. */
static size_t zbufrandi_next_mark(const uint8_t *mask, size_t at, size_t n) {
    for (; at < n && (at & 7) != 0; at++) if (mask[at] != 0) return at;
    for (; at + 8 <= n; at += 8) {
        uint64_t eight;
        memcpy(&eight, mask + at, sizeof eight);
        if (eight != 0) break;
    }
    for (; at < n; at++) if (mask[at] != 0) return at;
    return n;
}

/* One more round for holes: empty pixels beside those of the last round, which count as covered now. What is found in
   this round gets the mark 2 + round and does not count yet, so that the order does not matter. */
static void zbufrandi_suspect_round(const zbufrandi_suspects *c, uint32_t round) {
    size_t n = (size_t)c->width * c->height, at = 0;
    uint8_t last = (uint8_t)(round == 1 ? (uint32_t)ZBUFRAND_SUSPECT_HOLE : round + 1);
    for (;; at++) {
        uint32_t x, y, k, l;
        at = zbufrandi_next_mark(c->mask, at, n);
        if (at >= n) return;
        if (c->mask[at] != last) continue;
        y = (uint32_t)(at / c->width);
        x = (uint32_t)(at % c->width);
        for (k = 0; k < 8; k++) {
            int64_t i = (int64_t)x + zbufrandi_around[k][0], j = (int64_t)y + zbufrandi_around[k][1];
            size_t q = (size_t)j * c->width + (size_t)i;
            uint32_t count = 0;
            if (i < 0 || j < 0 || i >= (int64_t)c->width || j >= (int64_t)c->height) continue;
            if (c->mask[q] != 0 || c->depth[q] < (float)INFINITY) continue;
            for (l = 0; l < 8; l++) {
                int64_t u = i + zbufrandi_around[l][0], v = j + zbufrandi_around[l][1];
                size_t r = (size_t)v * c->width + (size_t)u;
                if (u < 0 || v < 0 || u >= (int64_t)c->width || v >= (int64_t)c->height) continue;
                count += c->depth[r] < (float)INFINITY || (c->mask[r] != 0 && c->mask[r] < round + 2);
            }
            if (count >= c->hole_count) c->mask[q] = (uint8_t)(round + 2);
        }
    }
}

static zbufrand_result zbufrandi_suspect_desc(const zbufrand_suspect_desc *desc, zbufrandi_suspects *c,
                                              zbufrandi_mem *mem) {
    zbufrand_result r;
    memset(c, 0, sizeof *c);
    if (desc == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    r = zbufrandi_env_open(&desc->env, mem);
    if (r != ZBUFRAND_OK) return r;
    r = zbufrandi_size_check(desc->env.error, desc->width, desc->height);
    if (r != ZBUFRAND_OK) return r;
    if ((uint32_t)desc->isa > ZBUFRAND_ISA_AVX512)
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, (uint64_t)desc->isa, "there is no isa %");
    if (!(desc->tolerance >= 0.0f && desc->tolerance < 1.0f)) {
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, 0, "tolerance is not in [0, 1)");
    }
    c->width = desc->width;
    c->height = desc->height;
    c->keep = 1.0f - (desc->tolerance > 0.0f ? desc->tolerance : 0.01f);
    c->hole_count = desc->hole_count != 0 ? desc->hole_count : 4;
    c->wrong_count = desc->wrong_count != 0 ? desc->wrong_count : 5;
    c->reach = 1;
    c->level = zbufrandi_level(desc->isa);
    if (c->hole_count > 8 || c->wrong_count < 2 || c->wrong_count > 9 || desc->hole_rounds > 8) {
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, 0, "a count is out of range");
    }
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_find_suspects(const zbufrand_suspect_desc *desc, const float *depth,
                                                    zbufrand_suspect *suspects, size_t capacity, size_t *out_count) {
    zbufrandi_suspects c;
    zbufrandi_mem mem;
    zbufrand_result r;
    uint32_t rounds, i;
    size_t n, at;
    if (out_count == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    *out_count = 0;
    r = zbufrandi_suspect_desc(desc, &c, &mem);
    if (r != ZBUFRAND_OK) return r;
    if (depth == NULL || (suspects == NULL && capacity != 0)) return ZBUFRAND_ERR_INVALID_ARG;
    n = (size_t)c.width * c.height;
    c.depth = depth;
    c.mask = (uint8_t *)zbufrandi_alloc(&mem, n);
    if (c.mask == NULL) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    zbufrandi_parallel_for(&desc->env, zbufrandi_suspect_task, &c, (c.height + 15) / 16);
    rounds = desc->hole_rounds != 0 ? desc->hole_rounds : 2;
    for (i = 1; i < rounds; i++) zbufrandi_suspect_round(&c, i);
    for (at = 0; (at = zbufrandi_next_mark(c.mask, at, n)) < n; at++) {
        if (*out_count < capacity) {
            suspects[*out_count].pixel = (uint32_t)at;
            suspects[*out_count].kind = ZBUFRAND_SUSPECT_HOLE; /* of any round */
            if (c.mask[at] == ZBUFRAND_SUSPECT_WRONG) suspects[*out_count].kind = ZBUFRAND_SUSPECT_WRONG;
        }
        ++*out_count;
    }
    zbufrandi_free(&mem, c.mask);
    return ZBUFRAND_OK;
}

/* What a suspect gets. Holes of several pixels are closed from their rims, in three rounds at most: `given` holds the
   new values of all suspects until they are complete. In front is what is at most the tolerance behind the second
   nearest neighbour (one neighbour alone may be wrong itself). */
typedef struct zbufrandi_mended {
    float rgba[4];
    float inverse; /* 0: nothing known yet */
} zbufrandi_mended;

static int zbufrandi_mend_pixel(const zbufrandi_suspects *c, const float *rgba, const uint32_t *place,
                                const zbufrandi_mended *given, uint32_t pixel, zbufrandi_mended *out) {
    float z[8], color[8][4], first = (float)INFINITY, second = (float)INFINITY, limit, count = 0.0f;
    uint32_t x = pixel % c->width, y = pixel / c->width, k, i, n = 0;
    for (k = 0; k < 8; k++) {
        int64_t u = (int64_t)x + zbufrandi_around[k][0], v = (int64_t)y + zbufrandi_around[k][1];
        size_t q = (size_t)v * c->width + (size_t)u;
        if (u < 0 || v < 0 || u >= (int64_t)c->width || v >= (int64_t)c->height) continue;
        memset(color[n], 0, sizeof color[n]);
        if (place[q] != 0) {
            if (!(given[place[q] - 1].inverse > 0.0f)) continue;
            z[n] = 1.0f / given[place[q] - 1].inverse;
            memcpy(color[n], given[place[q] - 1].rgba, sizeof color[n]);
        } else {
            if (!(c->depth[q] < (float)INFINITY)) continue;
            z[n] = c->depth[q];
            if (rgba != NULL) memcpy(color[n], rgba + 4 * q, sizeof color[n]);
        }
        if (z[n] < first) {
            second = first;
            first = z[n];
        } else if (z[n] < second) {
            second = z[n];
        }
        n++;
    }
    if (n == 0) return 0;
    limit = (second < (float)INFINITY ? second : first) / c->keep;
    memset(out, 0, sizeof *out);
    for (k = 0; k < n; k++) {
        if (!(z[k] <= limit)) continue;
        for (i = 0; i < 4; i++) out->rgba[i] += color[k][i];
        out->inverse += 1.0f / z[k];
        count += 1.0f;
    }
    for (i = 0; i < 4; i++) out->rgba[i] /= count;
    out->inverse /= count;
    return 1;
}

ZBUFRAND_DEF zbufrand_result zbufrand_mend(const zbufrand_suspect_desc *desc, float *rgba, float *depth,
                                           const zbufrand_suspect *suspects, size_t count) {
    zbufrandi_suspects c;
    zbufrandi_mem mem;
    zbufrandi_mended *given, *next;
    uint32_t *place;
    zbufrand_result r = zbufrandi_suspect_desc(desc, &c, &mem);
    size_t n, i;
    int round;
    if (r != ZBUFRAND_OK) return r;
    if (depth == NULL || (suspects == NULL && count != 0)) return ZBUFRAND_ERR_INVALID_ARG;
    if (count == 0) return ZBUFRAND_OK;
    n = (size_t)c.width * c.height;
    for (i = 0; i < count; i++) {
        if (suspects[i].pixel >= n) {
            return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, i, "suspect % is outside the picture");
        }
    }
    if (count > n) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, count, "% suspects are too many");
    c.depth = depth;
    place = (uint32_t *)zbufrandi_alloc_zero(&mem, n, sizeof *place);
    given = (zbufrandi_mended *)zbufrandi_alloc_zero(&mem, count, 2 * sizeof *given);
    if (place == NULL || given == NULL) {
        zbufrandi_free(&mem, place);
        zbufrandi_free(&mem, given);
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    }
    next = given + count;
    for (i = 0; i < count; i++) place[suspects[i].pixel] = (uint32_t)i + 1;
    for (round = 0; round < 3; round++) {
        size_t found = 0;
        for (i = 0; i < count; i++) {
            next[i] = given[i];
            if (!(given[i].inverse > 0.0f)) {
                found += (size_t)zbufrandi_mend_pixel(&c, rgba, place, given, suspects[i].pixel, &next[i]);
            }
        }
        memcpy(given, next, count * sizeof *given);
        if (found == 0) break;
    }
    for (i = 0; i < count; i++) {
        if (!(given[i].inverse > 0.0f)) continue;
        depth[suspects[i].pixel] = 1.0f / given[i].inverse;
        if (rgba != NULL) memcpy(rgba + 4 * (size_t)suspects[i].pixel, given[i].rgba, sizeof given[i].rgba);
    }
    zbufrandi_free(&mem, place);
    zbufrandi_free(&mem, given);
    return ZBUFRAND_OK;
}

/* ---- all of it: buffers and stages; a frame embeds this ----

   Use:  zbufrandi_recon_open          once for a size and a set of options
         zbufrandi_recon_clear         before each frame
         samples -> recon.canvas       pixels of a rasteriser -> recon.exact if it is there (blocks larger than 1)
         recon.slope_x, slope_y, back, tint
                                       where they are there: filled in for each pixel of the canvas that is not empty
         zbufrandi_recon_keys          -> recon.result: keys of what is seen, result_width x result_height of them; the
                                       picture begins at (result_guard, result_guard)
         shade recon.result            into recon.color if it is there; else right into the picture: the sizes agree
         zbufrandi_recon_colors        if recon.color is there: recon.color -> picture
         zbufrandi_recon_close */

typedef struct zbufrandi_recon {
    zbufrand_env env;
    zbufrandi_asker *asker;          /* for the calls below; NULL: nobody is asked */
    zbufrand_reconstruct o;          /* defaults filled in */
    int level;
    uint32_t width, height, guard;   /* of the picture; around it */
    zbufrandi_keys canvas;           /* width + 2 guard, height + 2 guard */
    uint64_t *exact;                 /* canvas size: what is not to be widened to blocks; or NULL */
    float *slope_x, *slope_y;        /* canvas size, of the winners of the canvas; NULL: not needed */
    uint8_t *back;                   /* the same: 1 if seen from behind */
    float *tint;                     /* the same: linear red, green, blue */
    float *color;                    /* rgba of result size, for fills that mix colours; NULL: not needed */
    uint64_t *result;
    uint32_t result_width, result_height, result_guard;
    /* working memory */
    uint64_t *pass[2], *scratch, *cost;
    uint32_t *stack;
    float *inverse, *between;
} zbufrandi_recon;

/* Check the options and fill in defaults. */
static zbufrand_result zbufrandi_reconstruct_check(const zbufrand_env *env, zbufrand_reconstruct *o) {
    if (o->block == 0) o->block = 1;
    if (o->block > 1024) return zbufrandi_fail(env->error, ZBUFRAND_ERR_RANGE, o->block, "block % is above 1024");
    if (o->plane_depth && o->block > 32) {
        return zbufrandi_fail(env->error, ZBUFRAND_ERR_RANGE, o->block, "block % is above 32 with plane_depth");
    }
    if ((uint32_t)o->occlusion > ZBUFRAND_OCCLUSION_SQUARES_ALL || (uint32_t)o->fill > ZBUFRAND_FILL_REGIONS) {
        return zbufrandi_fail(env->error, ZBUFRAND_ERR_INVALID_ARG, 0, "unknown occlusion or fill");
    }
    if (o->gauss_radius == 0.0f) o->gauss_radius = o->block <= 2 ? 2.0f : o->block < 256 ? (float)o->block : 256.0f;
    if (o->gauss_support == 0.0f) o->gauss_support = 1.0f;
    if (o->focal == 0.0f) o->focal = 1.0f;
    if (!(o->gauss_radius > 0.0f && o->gauss_radius <= 256.0f && o->gauss_support > 0.0f && o->gauss_support <= 1.5f)) {
        return zbufrandi_fail(env->error, ZBUFRAND_ERR_RANGE, 0, "gauss_radius or gauss_support is out of range");
    }
    if (!(o->tolerance >= 0.0f && o->tolerance_projected >= 0.0f && o->tolerance_color >= 0.0f && o->focal > 0.0f) ||
        o->tolerance_slope != o->tolerance_slope) {
        return zbufrandi_fail(env->error, ZBUFRAND_ERR_INVALID_ARG, 0, "a tolerance is negative or not a number");
    }
    if (o->tolerance_slope < 0.0f) o->tolerance_slope = 0.0f;
    else if (o->tolerance + o->tolerance_projected + o->tolerance_slope == 0.0f) o->tolerance_slope = 1.5f;
    return ZBUFRAND_OK;
}

ZBUFRANDI_UNUSED static void zbufrandi_recon_close(zbufrandi_mem *mem, zbufrandi_recon *r) {
    zbufrandi_free(mem, r->canvas.key);
    zbufrandi_free(mem, r->exact);
    zbufrandi_free(mem, r->slope_x);
    zbufrandi_free(mem, r->slope_y);
    zbufrandi_free(mem, r->back);
    zbufrandi_free(mem, r->tint);
    zbufrandi_free(mem, r->color);
    zbufrandi_free(mem, r->pass[0]);
    zbufrandi_free(mem, r->pass[1]);
    zbufrandi_free(mem, r->scratch);
    zbufrandi_free(mem, r->cost);
    zbufrandi_free(mem, r->stack);
    zbufrandi_free(mem, r->inverse);
    zbufrandi_free(mem, r->between);
    memset(r, 0, sizeof *r);
}

static int zbufrandi_recon_regions(const zbufrandi_recon *r) { /* does a pixel show the nearest sample? */
    return r->o.fill == ZBUFRAND_FILL_VORONOI_L1 || r->o.fill == ZBUFRAND_FILL_VORONOI ||
           r->o.fill == ZBUFRAND_FILL_REGIONS;
}

/* want_exact: there will be pixels of a rasteriser. r->exact is allocated only where it differs from the canvas. */
ZBUFRANDI_UNUSED static zbufrand_result zbufrandi_recon_open(zbufrandi_mem *mem, const zbufrand_env *env,
                                                             zbufrand_isa isa, const zbufrand_reconstruct *options,
                                                             uint32_t width, uint32_t height, int want_exact,
                                                             zbufrandi_recon *r) {
    zbufrand_result result;
    uint32_t d, guard, tall, tasks;
    size_t n;
    int ok, blocks, voronoi, mixes, points;
    memset(r, 0, sizeof *r);
    r->env = *env;
    r->o = *options;
    r->level = zbufrandi_level(isa);
    result = zbufrandi_reconstruct_check(env, &r->o);
    if (result != ZBUFRAND_OK) return result;
    result = zbufrandi_size_check(env->error, width, height);
    if (result != ZBUFRAND_OK) return result;
    d = r->o.block;
    blocks = r->o.occlusion == ZBUFRAND_OCCLUSION_BLOCKS;
    voronoi = zbufrandi_recon_regions(r);
    mixes = r->o.fill == ZBUFRAND_FILL_GAUSS || r->o.fill == ZBUFRAND_FILL_PULL_PUSH ||
            r->o.fill == ZBUFRAND_FILL_REGIONS;
    points = !blocks || d == 1; /* fills begin with points in the canvas, not with a picture of blocks */
    guard = blocks ? d / 2 : 2 * (d / 2);
    if (points && r->o.fill == ZBUFRAND_FILL_GAUSS) guard += (uint32_t)(r->o.gauss_radius * r->o.gauss_support) + 1;
    if (points && (voronoi || r->o.fill == ZBUFRAND_FILL_PULL_PUSH)) guard += d > 4 ? d : 4;
    r->width = width;
    r->height = height;
    r->guard = guard;
    r->canvas.width = width + 2 * guard;
    r->canvas.height = tall = height + 2 * guard;
    if ((uint64_t)r->canvas.width * tall > 0x7fffffffu) {
        return zbufrandi_fail(env->error, ZBUFRAND_ERR_RANGE, 0, "more than 2^31 pixels with the guard band");
    }
    n = (size_t)r->canvas.width * tall;
    ok = (r->canvas.key = (uint64_t *)zbufrandi_alloc_array(mem, n, 8)) != NULL;
    if (want_exact && blocks && d > 1) ok = ok && (r->exact = (uint64_t *)zbufrandi_alloc_array(mem, n, 8)) != NULL;
    if (d > 1 || guard > 0 || !blocks) ok = ok && (r->pass[0] = (uint64_t *)zbufrandi_alloc_array(mem, n, 8)) != NULL;
    if (!blocks || voronoi) ok = ok && (r->pass[1] = (uint64_t *)zbufrandi_alloc_array(mem, n, 8)) != NULL;
    if (d > 1 && r->o.occlusion != ZBUFRAND_OCCLUSION_CELLS && !(blocks && r->o.plane_depth)) {
        uint32_t window = blocks ? d : 2 * (d / 2) + 1;
        size_t keys = zbufrandi_minimum_stride(window) * zbufrandi_minimum_tasks(tall, window);
        ok = ok && (r->scratch = (uint64_t *)zbufrandi_alloc_array(mem, keys, 8)) != NULL;
    }
    if ((blocks && d > 1 && r->o.plane_depth) || (!blocks && r->o.tolerance_slope > 0.0f)) {
        ok = ok && (r->slope_x = (float *)zbufrandi_alloc_array(mem, n, 4)) != NULL;
        ok = ok && (r->slope_y = (float *)zbufrandi_alloc_array(mem, n, 4)) != NULL;
    }
    if (blocks && d > 1 && r->o.plane_depth) {
        ok = ok && (r->inverse = (float *)zbufrandi_alloc_array(mem, n, 4)) != NULL;
    }
    if (!blocks && r->o.drop_back) ok = ok && (r->back = (uint8_t *)zbufrandi_alloc(mem, n)) != NULL;
    if (!blocks && r->o.tolerance_color > 0.0f)
        ok = ok && (r->tint = (float *)zbufrandi_alloc_array(mem, n, 3 * sizeof *r->tint)) != NULL;
    if (voronoi) {
        tasks = (height + ZBUFRANDI_VORONOI_ROWS - 1) / ZBUFRANDI_VORONOI_ROWS;
        ok = ok && (r->cost = (uint64_t *)zbufrandi_alloc_array(mem, n, 8)) != NULL;
        ok = ok && (r->stack = (uint32_t *)zbufrandi_alloc_array(mem, (size_t)tasks * 2 * r->canvas.width, 4)) != NULL;
    }
    if (mixes) {
        size_t floats = (size_t)width * tall * 4;
        if (r->o.fill == ZBUFRAND_FILL_PULL_PUSH) floats = zbufrandi_pull_push_floats(r->canvas.width, tall);
        ok = ok && (r->color = (float *)zbufrandi_alloc_array(mem, n, 16)) != NULL;
        ok = ok && (r->between = (float *)zbufrandi_alloc_array(mem, floats != 0 ? floats : 1, 4)) != NULL;
    }
    if (!ok) {
        zbufrandi_recon_close(mem, r);
        return zbufrandi_fail(env->error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    }
    return ZBUFRAND_OK;
}

ZBUFRANDI_UNUSED static void zbufrandi_recon_clear(zbufrandi_recon *r) {
    size_t n = (size_t)r->canvas.width * r->canvas.height;
    memset(r->canvas.key, 0xff, n * 8);
    if (r->exact != NULL) memset(r->exact, 0xff, n * 8);
}

#if ZBUFRANDI_AVX2
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_inverse_avx2(const zbufrandi_recon *r, size_t q, size_t stop) {
    const __m256 one = _mm256_set1_ps(1.0f), zero = _mm256_setzero_ps();
    for (; q < stop; q += 8) {
        __m256 z = _mm256_shuffle_ps(_mm256_castsi256_ps(ZBUFRANDI_LOAD4(r->canvas.key + q)),
                                     _mm256_castsi256_ps(ZBUFRANDI_LOAD4(r->canvas.key + q + 4)), 0xdd);
        __m256 sx = _mm256_loadu_ps(r->slope_x + q), sy = _mm256_loadu_ps(r->slope_y + q), some, ok;
        z = _mm256_castsi256_ps(_mm256_permute4x64_epi64(_mm256_castps_si256(z), 0xd8));
        some = _mm256_cmp_ps(z, zero, _CMP_GE_OQ); /* the upper half of an empty key is NaN */
        ok = _mm256_and_ps(_mm256_cmp_ps(_mm256_sub_ps(sx, sx), zero, _CMP_EQ_OQ),
                           _mm256_cmp_ps(_mm256_sub_ps(sy, sy), zero, _CMP_EQ_OQ));
        ok = _mm256_and_ps(ok, some);
        _mm256_storeu_ps(r->inverse + q, _mm256_and_ps(_mm256_div_ps(one, z), some));
        _mm256_storeu_ps(r->slope_x + q, _mm256_and_ps(sx, ok));
        _mm256_storeu_ps(r->slope_y + q, _mm256_and_ps(sy, ok));
    }
}
#endif

static void zbufrandi_inverse_task(void *ctx, uint32_t task) {
    const zbufrandi_recon *r = (const zbufrandi_recon *)ctx;
    uint32_t y = task * 16, end = y + 16 < r->canvas.height ? y + 16 : r->canvas.height;
    size_t q = (size_t)y * r->canvas.width, stop = (size_t)end * r->canvas.width;
#if ZBUFRANDI_AVX2
    if (r->level >= 3) {
        zbufrandi_inverse_avx2(r, q, q + ((stop - q) & ~(size_t)7));
        q += (stop - q) & ~(size_t)7;
    }
#endif
    for (; q < stop; q++) {
        int empty = r->canvas.key[q] == ZBUFRANDI_EMPTY;
        r->inverse[q] = empty ? 0.0f : 1.0f / zbufrandi_key_depth(r->canvas.key[q]);
        if (empty || !zbufrandi_finite_f(r->slope_x[q]) || !zbufrandi_finite_f(r->slope_y[q])) {
            r->slope_x[q] = r->slope_y[q] = 0.0f;
        }
    }
}

/* A stage of a reconstruction; nothing if it was cancelled before. */
static void zbufrandi_recon_for(const zbufrandi_recon *r, zbufrand_task_fn *task, void *ctx, uint32_t count) {
    (void)zbufrandi_parallel_ask(&r->env, r->asker, task, ctx, count);
}

static void zbufrandi_recon_minimum(const zbufrandi_recon *r, const uint64_t *in, uint64_t *out, int squares) {
    zbufrandi_minimum c;
    memset(&c, 0, sizeof c);
    c.in = in;
    c.out = out;
    c.in_width = r->canvas.width;
    c.in_height = r->canvas.height;
    c.out_width = squares ? r->canvas.width : r->width;
    c.out_height = squares ? r->canvas.height : r->height;
    c.shift = squares ? 0 : r->guard;
    c.d = squares ? 2 * (r->o.block / 2) + 1 : r->o.block;
    c.back = r->o.block / 2;
    c.exact = squares ? NULL : r->exact;
    c.band = zbufrandi_minimum_band(c.d);
    c.scratch = r->scratch;
    c.scratch_stride = zbufrandi_minimum_stride(c.d);
    c.level = r->level;
    zbufrandi_recon_for(r, zbufrandi_minimum_task, &c, zbufrandi_minimum_tasks(c.out_height, c.d));
}

/* Pieces of 16 rows, or fewer pixels if much may have to be looked at for each. */
static void zbufrandi_recon_squares(const zbufrandi_recon *r, zbufrandi_seen *s) {
    const uint64_t side = 4 * (uint64_t)(r->o.block / 2) + 1, most = ((uint64_t)1 << 26) / (side * side);
    const size_t pixels = (size_t)s->width * s->height;
    s->piece = 16 * (size_t)s->width;
    if (s->tint != NULL && most < s->piece) s->piece = (size_t)most;
    zbufrandi_recon_for(r, zbufrandi_squares_task, s, (uint32_t)((pixels + s->piece - 1) / s->piece));
}

/* Occlusion. Leaves the keys that are seen in r->result. */
static void zbufrandi_recon_occlusion(zbufrandi_recon *r) {
    zbufrandi_seen s;
    uint32_t tasks = (r->canvas.height + 15) / 16, d = r->o.block;
    r->result = r->canvas.key;
    r->result_width = r->canvas.width;
    r->result_height = r->canvas.height;
    r->result_guard = r->guard;
    if (r->o.occlusion == ZBUFRAND_OCCLUSION_BLOCKS) {
        if (d == 1) return;
        if (r->inverse != NULL) {
            zbufrandi_planes p;
            zbufrandi_recon_for(r, zbufrandi_inverse_task, r, tasks);
            memset(&p, 0, sizeof p);
            p.keys = r->canvas.key;
            p.exact = r->exact;
            p.inverse = r->inverse;
            p.slope_x = r->slope_x;
            p.slope_y = r->slope_y;
            p.out = r->pass[0];
            p.pitch = r->canvas.width;
            p.width = r->width;
            p.height = r->height;
            p.guard = r->guard;
            p.back = d / 2;
            p.d = d;
            p.level = r->level;
            zbufrandi_recon_for(r, zbufrandi_planes_task, &p, (r->height + 15) / 16);
        } else {
            zbufrandi_recon_minimum(r, r->canvas.key, r->pass[0], 0);
        }
        r->result = r->pass[0];
        r->result_width = r->width;
        r->result_height = r->height;
        r->result_guard = 0;
        return;
    }
    memset(&s, 0, sizeof s);
    s.keys = r->canvas.key;
    s.nearest = r->pass[0];
    s.out = r->pass[1];
    s.slope_x = r->slope_x;
    s.slope_y = r->slope_y;
    s.back = r->back;
    s.tint = r->tint;
    s.o = &r->o;
    s.width = r->canvas.width;
    s.height = r->canvas.height;
    s.offset = r->guard;
    if (r->o.occlusion == ZBUFRAND_OCCLUSION_CELLS) {
        uint32_t lead = r->guard % d;
        zbufrandi_recon_for(r, zbufrandi_cells_task, &s, (lead != 0) + (s.height - lead + d - 1) / d);
    } else if (d == 1) { /* squares of one pixel hide nothing */
        s.nearest = r->canvas.key;
        zbufrandi_recon_squares(r, &s);
    } else {
        zbufrandi_recon_minimum(r, r->canvas.key, r->pass[0], 1);
        if (r->o.occlusion == ZBUFRAND_OCCLUSION_SQUARES_ALL) {
            zbufrandi_recon_for(r, zbufrandi_mask_task, &s, tasks);
            zbufrandi_recon_minimum(r, r->pass[1], r->pass[0], 1);
        }
        zbufrandi_recon_squares(r, &s);
    }
    r->result = r->pass[1];
}

/* keys -> r->result. Slopes and backs have to be filled in before, where there is room for them. */
ZBUFRANDI_UNUSED static void zbufrandi_recon_keys(zbufrandi_recon *r) {
    zbufrandi_recon_occlusion(r);
    if (zbufrandi_recon_regions(r)) {
        zbufrandi_voronoi v;
        memset(&v, 0, sizeof v);
        v.keys = r->result;
        v.out = r->result == r->pass[0] ? r->pass[1] : r->pass[0];
        v.cost = r->cost;
        v.level = r->level;
        v.stack = r->stack;
        v.pitch = r->result_width;
        v.rows = r->result_height;
        v.width = r->width;
        v.height = r->height;
        v.guard = r->result_guard;
        v.reach = r->o.reach != 0 && r->o.reach < 0x20000u ? r->o.reach : 0x20000u;
        v.euclidean = r->o.fill != ZBUFRAND_FILL_VORONOI_L1;
        zbufrandi_recon_for(r, zbufrandi_voronoi_columns, &v,
                            (v.pitch + ZBUFRANDI_VORONOI_COLUMNS - 1) / ZBUFRANDI_VORONOI_COLUMNS);
        zbufrandi_recon_for(r, zbufrandi_voronoi_rows, &v,
                            (v.height + ZBUFRANDI_VORONOI_ROWS - 1) / ZBUFRANDI_VORONOI_ROWS);
        r->result = v.out;
    } else if (r->color == NULL && r->result_guard != 0) { /* crop */
        uint64_t *out = r->result == r->pass[0] ? r->result : r->pass[0];
        uint32_t y;
        for (y = 0; y < r->height; y++) { /* in place it moves towards the front */
            size_t from = (size_t)(y + r->result_guard) * r->result_width + r->result_guard;
            memmove(out + (size_t)y * r->width, r->result + from, (size_t)r->width * 8);
        }
        r->result = out;
    } else {
        return;
    }
    r->result_width = r->width;
    r->result_height = r->height;
    r->result_guard = 0;
}

/* r->color -> picture, rgba [4 * width * height], which may be r->color. r->color is used up. */
ZBUFRANDI_UNUSED static void zbufrandi_recon_colors(zbufrandi_recon *r, float *rgba) {
    uint32_t y;
    if (r->o.fill != ZBUFRAND_FILL_PULL_PUSH) {
        zbufrandi_gauss g;
        float weight[ZBUFRANDI_GAUSS_TAPS];
        memset(&g, 0, sizeof g);
        g.in = r->color;
        g.between = r->between;
        g.out = rgba;
        g.in_width = r->result_width;
        g.in_height = r->result_height;
        g.width = r->width;
        g.height = r->height;
        g.shift = r->result_guard;
        g.taps = zbufrandi_gauss_weights(r->o.gauss_radius, r->o.gauss_support, weight);
        g.weight = weight;
        g.level = r->level;
        zbufrandi_recon_for(r, zbufrandi_gauss_rows, &g, (g.in_height + 15) / 16);
        zbufrandi_recon_for(r, zbufrandi_gauss_columns, &g, (g.height + 15) / 16);
        return;
    }
    zbufrandi_pull_push_run(&r->env, r->asker, r->color, r->result_width, r->result_height, r->between, r->o.reach);
    for (y = 0; y < r->height; y++) {
        size_t from = (size_t)(y + r->result_guard) * r->result_width + r->result_guard;
        memmove(rgba + (size_t)y * r->width * 4, r->color + from * 4, (size_t)r->width * 16);
    }
}

/* ---- projecting points ---- */

static int zbufrandi_view_ok(const zbufrand_view *v) {
    int i, ok = zbufrandi_finite(v->center_x) && zbufrandi_finite(v->center_y);
    for (i = 0; i < 12; i++) ok = ok && zbufrandi_finite(v->world_to_camera[i / 4][i % 4]);
    ok = ok && v->focal > 0.0 && zbufrandi_finite(v->focal) && v->near_z > 0.0 && zbufrandi_finite(v->near_z);
    return ok && v->far_z >= 0.0;
}

static void zbufrandi_rotate(const zbufrand_view *v, const float p[3], double w, double q[3]) {
    int i;
    for (i = 0; i < 3; i++) {
        const double *m = v->world_to_camera[i];
        q[i] = m[0] * (double)p[0] + m[1] * (double)p[1] + m[2] * (double)p[2] + m[3] * w;
    }
}

ZBUFRAND_DEF zbufrand_result zbufrand_project(const zbufrand_view *view, const zbufrand_points *points, size_t first,
                                              size_t count, zbufrand_sample *samples) {
    size_t i, stride, normal_stride, rgb_stride;
    if (view == NULL || points == NULL || (samples == NULL && count != 0)) return ZBUFRAND_ERR_INVALID_ARG;
    if (first > points->count || count > points->count - first) return ZBUFRAND_ERR_INVALID_ARG;
    if ((points->positions == NULL && count != 0) || !zbufrandi_view_ok(view)) return ZBUFRAND_ERR_INVALID_ARG;
    stride = points->position_stride != 0 ? points->position_stride : 12;
    normal_stride = points->normal_stride != 0 ? points->normal_stride : 12;
    rgb_stride = points->rgb_stride != 0 ? points->rgb_stride : 3;
    for (i = 0; i < count; i++) {
        zbufrand_sample *s = &samples[i];
        float p[3];
        double q[3], n[3], d;
        memset(s, 0, sizeof *s);
        memcpy(p, (const uint8_t *)points->positions + (first + i) * stride, sizeof p);
        zbufrandi_rotate(view, p, 1.0, q);
        if (!(q[2] >= view->near_z && (view->far_z == 0.0 || q[2] <= view->far_z) && q[2] < 3e38)) continue;
        if (!zbufrandi_finite(q[0]) || !zbufrandi_finite(q[1])) continue;
        s->x = (float)(view->center_x + view->focal * q[0] / q[2]);
        s->y = (float)(view->center_y - view->focal * q[1] / q[2]);
        s->z = (float)q[2];
        s->rgb[0] = s->rgb[1] = s->rgb[2] = 1.0f;
        if (points->rgb != NULL) {
            const uint8_t *c = points->rgb + (first + i) * rgb_stride;
            int k;
            for (k = 0; k < 3; k++) s->rgb[k] = (float)zbufrandi_srgb_to_linear((double)c[k] / 255.0);
        }
        if (points->normals == NULL) continue;
        memcpy(p, (const uint8_t *)points->normals + (first + i) * normal_stride, sizeof p);
        zbufrandi_rotate(view, p, 0.0, n);
        d = n[0] * q[0] + n[1] * q[1] + n[2] * q[2]; /* the plane n . q = d: 1/z = (n_x x/f - n_y y/f + n_z) / d */
        if (d > 0.0) s->flags |= (uint32_t)ZBUFRAND_SAMPLE_BACK;
        n[0] /= view->focal * d;
        n[1] /= -view->focal * d;
        if (!(zbufrandi_abs(n[0]) < 1e30 && zbufrandi_abs(n[1]) < 1e30)) continue;
        s->slope_x = (float)n[0];
        s->slope_y = (float)n[1];
    }
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF void zbufrand_samples_shade(void *user, const uint32_t *numbers, size_t count, float *rgba) {
    const zbufrand_sample *s = (const zbufrand_sample *)user;
    size_t i;
    for (i = 0; i < count; i++, rgba += 4) {
        memcpy(rgba, s[numbers[i]].rgb, 12);
        rgba[3] = 1.0f;
    }
}

ZBUFRAND_DEF void zbufrand_samples_surface(void *user, const uint32_t *numbers, size_t count, float *slopes,
                                           uint8_t *back) {
    const zbufrand_sample *s = (const zbufrand_sample *)user;
    size_t i;
    for (i = 0; i < count; i++) {
        slopes[2 * i] = s[numbers[i]].slope_x;
        slopes[2 * i + 1] = s[numbers[i]].slope_y;
        back[i] = (uint8_t)(s[numbers[i]].flags & ZBUFRAND_SAMPLE_BACK);
    }
}

ZBUFRAND_DEF void zbufrand_points_shade(void *user, const uint32_t *numbers, size_t count, float *rgba) {
    const zbufrand_points *p = (const zbufrand_points *)user;
    size_t i, stride = p->rgb_stride != 0 ? p->rgb_stride : 3, k;
    for (i = 0; i < count; i++, rgba += 4) {
        rgba[0] = rgba[1] = rgba[2] = rgba[3] = 1.0f;
        if (p->rgb == NULL) continue;
        for (k = 0; k < 3; k++) {
            rgba[k] = (float)zbufrandi_srgb_to_linear((double)p->rgb[numbers[i] * stride + k] / 255.0);
        }
    }
}

/* ---- the canvas ---- */

struct zbufrand_canvas {
    zbufrandi_mem mem;
    zbufrand_env env;
    zbufrand_isa isa;
    zbufrandi_recon recon;
    uint32_t salt;              /* numbers are xor-ed with it before they are hashed: other ties in another frame */
    uint32_t bucket, jitter;    /* mask of the random depth bits, shift of the borders */
    uint32_t bucket_bits;
    uint32_t resolving;         /* atomic: 1 while a picture is made */
};

ZBUFRAND_DEF zbufrand_result zbufrand_canvas_create(const zbufrand_canvas_desc *desc, zbufrand_canvas **out_canvas) {
    zbufrand_canvas *c;
    zbufrandi_mem mem;
    zbufrand_result r;
    if (out_canvas == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    *out_canvas = NULL;
    if (desc == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    r = zbufrandi_env_open(&desc->env, &mem);
    if (r != ZBUFRAND_OK) return r;
    if ((uint32_t)desc->isa > ZBUFRAND_ISA_AVX512)
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, (uint64_t)desc->isa, "there is no isa %");
    if (desc->bucket_bits > 22) {
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_RANGE, desc->bucket_bits, "bucket_bits % is above 22");
    }
    c = (zbufrand_canvas *)zbufrandi_alloc_zero(&mem, 1, sizeof *c);
    if (c == NULL) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    r = zbufrandi_recon_open(&mem, &desc->env, desc->isa, &desc->reconstruct, desc->width, desc->height, 0, &c->recon);
    if (r != ZBUFRAND_OK) {
        zbufrandi_free(&mem, c);
        return r;
    }
    c->env = desc->env;
    c->isa = desc->isa;
    c->bucket_bits = desc->bucket_bits;
    c->mem = mem;
    zbufrand_canvas_clear(c, 0);
    *out_canvas = c;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF void zbufrand_canvas_destroy(zbufrand_canvas *canvas) {
    zbufrandi_mem mem;
    if (canvas == NULL) return;
    mem = canvas->mem;
    zbufrandi_recon_close(&mem, &canvas->recon);
    zbufrandi_free(&mem, canvas);
}

ZBUFRAND_DEF void zbufrand_canvas_clear(zbufrand_canvas *canvas, uint32_t seed) {
    if (canvas == NULL) return;
    zbufrandi_recon_clear(&canvas->recon);
    canvas->salt = zbufrandi_hash32(seed);
    canvas->bucket = canvas->bucket_bits != 0 ? ((uint32_t)1 << (23 - canvas->bucket_bits)) - 1 : 0;
    canvas->jitter = zbufrandi_hash32(canvas->salt + 1) & canvas->bucket;
}

ZBUFRAND_DEF uint32_t zbufrand_canvas_guard(const zbufrand_canvas *canvas) {
    return canvas != NULL ? canvas->recon.guard : 0;
}

ZBUFRAND_DEF zbufrand_result zbufrand_canvas_submit(zbufrand_canvas *canvas, const zbufrand_sample *samples,
                                                    size_t count, uint32_t first_number,
                                                    zbufrand_submit_stats *stats) {
    zbufrand_submit_stats n;
    float x_min, x_max, y_max;
    size_t i;
    int plane;
    if (canvas == NULL || (samples == NULL && count != 0)) return ZBUFRAND_ERR_INVALID_ARG;
    if (zbufrandi_atomic_load(&canvas->resolving)) return ZBUFRAND_ERR_INVALID_ARG;
    memset(&n, 0, sizeof n);
    x_min = -(float)canvas->recon.guard;
    x_max = (float)(canvas->recon.width + canvas->recon.guard);
    y_max = (float)(canvas->recon.height + canvas->recon.guard);
    plane = canvas->recon.o.plane_depth != 0;
    for (i = 0; i < count; i++) {
        const zbufrand_sample *s = &samples[i];
        float z = s->z;
        uint32_t number = (first_number + (uint32_t)i) ^ canvas->salt;
        int32_t ix, iy;
        size_t at;
        if (!(z >= 1.17549435e-38f && z <= 3.40282347e38f) || !zbufrandi_finite_f(s->x) || !zbufrandi_finite_f(s->y)) {
            n.bad++;
            continue;
        }
        if (!(s->x >= x_min && s->x < x_max && s->y >= x_min && s->y < y_max)) {
            n.outside++;
            continue;
        }
        n.accepted++;
        ix = (int32_t)s->x;
        iy = (int32_t)s->y;
        ix -= (float)ix > s->x; /* floor */
        iy -= (float)iy > s->y;
        if (plane) {
            z = zbufrandi_plane_depth(z, (double)s->x, (double)s->y, (double)s->slope_x, (double)s->slope_y, ix, iy);
        }
        at = (size_t)(iy + (int32_t)canvas->recon.guard) * canvas->recon.canvas.width +
             (size_t)(ix + (int32_t)canvas->recon.guard);
        zbufrandi_key_min(&canvas->recon.canvas.key[at], canvas->bucket != 0 ?
                          zbufrandi_key_bucket(z, number, canvas->bucket, canvas->jitter) : zbufrandi_key(z, number));
    }
    if (stats != NULL) {
        stats->accepted += n.accepted;
        stats->outside += n.outside;
        stats->bad += n.bad;
    }
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_canvas_submit_points(zbufrand_canvas *canvas, const zbufrand_view *view,
                                                           const zbufrand_points *points, uint32_t first_number,
                                                           zbufrand_submit_stats *stats) {
    zbufrand_sample sample[64];
    size_t i, n;
    zbufrand_result r = ZBUFRAND_OK;
    if (canvas == NULL || points == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    for (i = 0; i < points->count && r == ZBUFRAND_OK; i += n) {
        n = points->count - i < 64 ? points->count - i : 64;
        r = zbufrand_project(view, points, i, n, sample);
        if (r == ZBUFRAND_OK) r = zbufrand_canvas_submit(canvas, sample, n, first_number + (uint32_t)i, stats);
    }
    return r;
}

/* ---- shading what is seen ----
   A block is a patch of equal keys: pixels whose left or upper neighbour shows the same sample take over its colour, so
   that a sample is asked for once, or a few times where its patch is in pieces or crosses a band. */

typedef struct zbufrandi_shade {
    const zbufrandi_recon *recon;
    const zbufrand_source *source;
    float *rgba, *depth;  /* of result size; may be NULL */
    uint32_t *number;
    uint32_t salt;
    uint32_t covered[2], shaded[2]; /* tallies */
} zbufrandi_shade;

enum { ZBUFRANDI_SHADE_ROWS = 16, ZBUFRANDI_SHADE_BATCH = 256 };

static int zbufrandi_same_sample(uint64_t a, uint64_t b) { /* b not empty */
    return (uint32_t)a == (uint32_t)b && a != ZBUFRANDI_EMPTY;
}

/* above: keys to go back to the row above, 0: not in this band */
static void zbufrandi_shade_row(const zbufrandi_shade *c, const uint64_t *keys, size_t above, uint32_t width,
                                float *rgba, uint64_t *shaded) {
    uint32_t numbers[ZBUFRANDI_SHADE_BATCH], place[ZBUFRANDI_SHADE_BATCH], n = 0, x, i;
    float colors[4 * ZBUFRANDI_SHADE_BATCH];
    for (x = 0; x <= width; x++) {
        if (n == ZBUFRANDI_SHADE_BATCH || (x == width && n != 0)) {
            c->source->shade_fn(c->source->user, numbers, n, colors);
            for (i = 0; i < n; i++) memcpy(rgba + 4 * (size_t)place[i], colors + 4 * i, 16);
            *shaded += n;
            n = 0;
        }
        if (x == width) break;
        if (keys[x] == ZBUFRANDI_EMPTY) continue;
        if (x > 0 && zbufrandi_same_sample(keys[x - 1], keys[x])) continue;
        if (above != 0 && zbufrandi_same_sample(*(keys + x - above), keys[x])) continue;
        numbers[n] = zbufrandi_key_number(keys[x]) ^ c->salt;
        place[n++] = x;
    }
    for (x = 0; x < width; x++) {
        float *p = rgba + 4 * (size_t)x;
        const float *same = NULL;
        if (keys[x] == ZBUFRANDI_EMPTY) memset(p, 0, 16);
        else if (x > 0 && zbufrandi_same_sample(keys[x - 1], keys[x])) same = p - 4;
        else if (above != 0 && zbufrandi_same_sample(*(keys + x - above), keys[x])) same = p - 4 * above;
        if (same != NULL) memcpy(p, same, 16);
    }
}

static void zbufrandi_shade_task(void *ctx, uint32_t task) {
    zbufrandi_shade *c = (zbufrandi_shade *)ctx;
    const zbufrandi_recon *r = c->recon;
    uint32_t y0 = task * ZBUFRANDI_SHADE_ROWS, y = y0, end = y + ZBUFRANDI_SHADE_ROWS, x, w = r->result_width;
    uint64_t covered = 0, shaded = 0;
    if (end > r->result_height) end = r->result_height;
    for (; y < end; y++) {
        const uint64_t *keys = r->result + (size_t)y * w;
        size_t at = (size_t)y * w;
        int inside = y >= r->result_guard && y < r->result_guard + r->height;
        if (c->rgba != NULL) zbufrandi_shade_row(c, keys, y > y0 ? w : 0, w, c->rgba + 4 * at, &shaded);
        if (c->depth != NULL) {
            for (x = 0; x < w; x++) {
                c->depth[at + x] = keys[x] != ZBUFRANDI_EMPTY ? zbufrandi_key_depth(keys[x]) : (float)INFINITY;
            }
        }
        if (c->number != NULL) {
            for (x = 0; x < w; x++) {
                c->number[at + x] = keys[x] != ZBUFRANDI_EMPTY ? zbufrandi_key_number(keys[x]) ^ c->salt : ~(uint32_t)0;
            }
        }
        for (x = 0; inside && x < r->width; x++) covered += keys[x + r->result_guard] != ZBUFRANDI_EMPTY;
    }
    zbufrandi_tally_add(c->covered, covered);
    zbufrandi_tally_add(c->shaded, shaded);
}

static void zbufrandi_surface_task(void *ctx, uint32_t task) { /* slopes and sides of the canvas' winners */
    const zbufrandi_shade *c = (const zbufrandi_shade *)ctx;
    const zbufrandi_recon *r = c->recon;
    uint32_t y = task * ZBUFRANDI_SHADE_ROWS, end = y + ZBUFRANDI_SHADE_ROWS, numbers[ZBUFRANDI_SHADE_BATCH], n = 0, i;
    size_t place[ZBUFRANDI_SHADE_BATCH], q, stop;
    float slopes[2 * ZBUFRANDI_SHADE_BATCH], rgba[4 * ZBUFRANDI_SHADE_BATCH];
    uint8_t back[ZBUFRANDI_SHADE_BATCH];
    memset(rgba, 0, sizeof rgba);
    if (end > r->canvas.height) end = r->canvas.height;
    stop = (size_t)end * r->canvas.width;
    for (q = (size_t)y * r->canvas.width; q <= stop; q++) {
        if (n == ZBUFRANDI_SHADE_BATCH || (q == stop && n != 0)) {
            memset(slopes, 0, sizeof slopes);
            memset(back, 0, sizeof back);
            if (c->source != NULL && c->source->surface_fn != NULL) {
                c->source->surface_fn(c->source->user, numbers, n, slopes, back);
            }
            if (r->tint != NULL && c->source != NULL) c->source->shade_fn(c->source->user, numbers, n, rgba);
            for (i = 0; i < n; i++) {
                if (r->slope_x != NULL) {
                    r->slope_x[place[i]] = slopes[2 * i];
                    r->slope_y[place[i]] = slopes[2 * i + 1];
                }
                if (r->back != NULL) r->back[place[i]] = back[i] != 0;
                if (r->tint != NULL) memcpy(r->tint + 3 * place[i], rgba + 4 * (size_t)i, 3 * sizeof *rgba);
            }
            n = 0;
        }
        if (q == stop || r->canvas.key[q] == ZBUFRANDI_EMPTY) continue;
        numbers[n] = zbufrandi_key_number(r->canvas.key[q]) ^ c->salt;
        place[n++] = q;
    }
}

/* 1/z as a colour, for fills that mix. */
static void zbufrandi_depth_color_task(void *ctx, uint32_t task) {
    const zbufrandi_recon *r = (const zbufrandi_recon *)ctx;
    uint32_t y = task * 16, end = y + 16 < r->result_height ? y + 16 : r->result_height;
    size_t q = (size_t)y * r->result_width, stop = (size_t)end * r->result_width;
    for (; q < stop; q++) {
        float *p = r->color + 4 * q;
        p[0] = p[1] = p[2] = p[3] = 0.0f;
        if (r->result[q] == ZBUFRANDI_EMPTY) continue;
        p[0] = 1.0f / zbufrandi_key_depth(r->result[q]);
        p[3] = 1.0f;
    }
}

static zbufrand_result zbufrandi_canvas_repair(zbufrand_canvas *c, float *rgba, float *depth,
                                               zbufrand_resolve_stats *stats) {
    zbufrand_suspect_desc d;
    zbufrand_suspect *list = NULL;
    size_t count = 0, i;
    zbufrand_result r;
    memset(&d, 0, sizeof d);
    d.env = c->env;
    d.isa = c->isa;
    d.width = c->recon.width;
    d.height = c->recon.height;
    r = zbufrand_find_suspects(&d, depth, NULL, 0, &count);
    if (r != ZBUFRAND_OK || count == 0) return r;
    list = (zbufrand_suspect *)zbufrandi_alloc_array(&c->mem, count, sizeof *list);
    if (list == NULL) return zbufrandi_fail(c->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    r = zbufrand_find_suspects(&d, depth, list, count, &count);
    if (r == ZBUFRAND_OK) r = zbufrand_mend(&d, rgba, depth, list, count);
    for (i = 0; r == ZBUFRAND_OK && i < count; i++) {
        stats->holes += list[i].kind == ZBUFRAND_SUSPECT_HOLE;
        stats->wrong += list[i].kind == ZBUFRAND_SUSPECT_WRONG;
    }
    zbufrandi_free(&c->mem, list);
    return r;
}

/* Calls of zbufrandi_recon_for there may be, with the levels of pull-push up and down, for colours and depths. */
enum { ZBUFRANDI_RESOLVE_STAGES = 80 };

static zbufrand_result zbufrandi_canvas_resolve(zbufrand_canvas *canvas, const zbufrand_source *source,
                                                const zbufrand_picture *picture, zbufrand_resolve_stats *stats) {
    zbufrandi_asker asker;
    zbufrandi_shade s;
    zbufrandi_recon *r;
    zbufrand_resolve_stats n;
    zbufrand_result result = ZBUFRAND_OK;
    float *depth;
    uint32_t tasks;
    size_t i, pixels;
    memset(&n, 0, sizeof n);
    if ((picture->rgba != NULL || canvas->recon.tint != NULL) && (source == NULL || source->shade_fn == NULL))
        return ZBUFRAND_ERR_INVALID_ARG;
    r = &canvas->recon;
    pixels = (size_t)r->width * r->height;
    depth = picture->depth;
    if (r->o.repair && depth == NULL) {
        depth = (float *)zbufrandi_alloc_array(&canvas->mem, pixels, sizeof *depth);
        if (depth == NULL) return zbufrandi_fail(canvas->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    }
    memset(&s, 0, sizeof s);
    memset(&asker, 0, sizeof asker);
    asker.step = 1u << 16;
    asker.total = ZBUFRANDI_RESOLVE_STAGES * asker.step;
    r->asker = &asker;
    s.recon = r;
    s.source = source;
    s.salt = canvas->salt;
    if (r->slope_x != NULL || r->back != NULL || r->tint != NULL) {
        tasks = (r->canvas.height + ZBUFRANDI_SHADE_ROWS - 1) / ZBUFRANDI_SHADE_ROWS;
        zbufrandi_recon_for(r, zbufrandi_surface_task, &s, tasks);
    }
    zbufrandi_recon_keys(r);
    tasks = (r->result_height + ZBUFRANDI_SHADE_ROWS - 1) / ZBUFRANDI_SHADE_ROWS;
    if (r->color == NULL) {
        s.rgba = picture->rgba;
        s.depth = depth;
        s.number = picture->number;
    } else if (picture->rgba != NULL) {
        s.rgba = r->color;
    }
    zbufrandi_recon_for(r, zbufrandi_shade_task, &s, tasks);
    if (r->color != NULL) {
        if (picture->rgba != NULL) zbufrandi_recon_colors(r, picture->rgba);
        if (depth != NULL && !asker.cancelled) { /* 1/z is mixed like the colours */
            zbufrandi_recon_for(r, zbufrandi_depth_color_task, r, tasks);
            zbufrandi_recon_colors(r, r->color);
            for (i = 0; i < pixels && !asker.cancelled; i++) {
                depth[i] = r->color[4 * i + 3] > 0.0f ? 1.0f / r->color[4 * i] : (float)INFINITY;
            }
        }
        if (picture->number != NULL) memset(picture->number, 0xff, pixels * sizeof *picture->number);
    }
    n.covered = zbufrandi_tally(s.covered);
    n.shaded = zbufrandi_tally(s.shaded);
    r->asker = NULL;
    if (asker.cancelled) result = zbufrandi_fail(canvas->env.error, ZBUFRAND_ERR_CANCELLED, 0, "resolve: cancelled");
    if (result == ZBUFRAND_OK && r->o.repair) result = zbufrandi_canvas_repair(canvas, picture->rgba, depth, &n);
    if (depth != picture->depth) zbufrandi_free(&canvas->mem, depth);
    if (stats != NULL) *stats = n;
    return result;
}

ZBUFRAND_DEF zbufrand_result zbufrand_canvas_resolve(zbufrand_canvas *canvas, const zbufrand_source *source,
                                                     const zbufrand_picture *picture, zbufrand_resolve_stats *stats) {
    zbufrand_result result;
    uint32_t idle = 0;
    if (stats != NULL) memset(stats, 0, sizeof *stats);
    if (canvas == NULL || picture == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (!zbufrandi_atomic_swap_if(&canvas->resolving, &idle, 1u)) return ZBUFRAND_ERR_INVALID_ARG;
    result = zbufrandi_canvas_resolve(canvas, source, picture, stats);
    zbufrandi_atomic_store(&canvas->resolving, 0u);
    return result;
}

/* ---- layers ----
   Round 0 finds the nearest depth of each pixel, round k sums the samples of layer k-1 and finds the nearest depth
   behind it. Minima and integer sums commute: any order of samples gives the same bits. */

typedef struct zbufrandi_layer {
    uint32_t *front;   /* bits of the nearest depth; ~0: none */
    uint32_t *count;
    uint32_t *sum;     /* 2 halves x rgb, units of 2^-16 */
} zbufrandi_layer;

struct zbufrand_layers {
    zbufrandi_mem mem;
    zbufrand_env env;
    uint32_t width, height, layers, round;
    float density, tolerance, dispersion;
    zbufrandi_layer layer[4];
};

ZBUFRAND_DEF void zbufrand_layers_destroy(zbufrand_layers *layers) {
    zbufrandi_mem mem;
    uint32_t i;
    if (layers == NULL) return;
    mem = layers->mem;
    for (i = 0; i < 4; i++) {
        zbufrandi_free(&mem, layers->layer[i].front);
        zbufrandi_free(&mem, layers->layer[i].count);
        zbufrandi_free(&mem, layers->layer[i].sum);
    }
    zbufrandi_free(&mem, layers);
}

ZBUFRAND_DEF void zbufrand_layers_clear(zbufrand_layers *layers) {
    uint32_t i;
    size_t n;
    if (layers == NULL) return;
    n = (size_t)layers->width * layers->height;
    for (i = 0; i < layers->layers; i++) {
        memset(layers->layer[i].front, 0xff, n * 4);
        memset(layers->layer[i].count, 0, n * 4);
        memset(layers->layer[i].sum, 0, n * 24);
    }
    layers->round = 0;
}

ZBUFRAND_DEF zbufrand_result zbufrand_layers_create(const zbufrand_layers_desc *desc, zbufrand_layers **out_layers) {
    zbufrand_layers *l;
    zbufrandi_mem mem;
    zbufrand_result r;
    uint32_t i;
    size_t n;
    int ok = 1;
    if (out_layers == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    *out_layers = NULL;
    if (desc == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    r = zbufrandi_env_open(&desc->env, &mem);
    if (r != ZBUFRAND_OK) return r;
    r = zbufrandi_size_check(desc->env.error, desc->width, desc->height);
    if (r != ZBUFRAND_OK) return r;
    if (desc->layers > 4) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_RANGE, desc->layers, "over 4 layers");
    ok = desc->density > 0.0f && zbufrandi_finite_f(desc->density) && desc->tolerance >= 0.0f;
    ok = ok && desc->tolerance < 1.0f && desc->dispersion >= 0.0f && zbufrandi_finite_f(desc->dispersion);
    if (!ok) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, 0, "a field is out of its range");
    l = (zbufrand_layers *)zbufrandi_alloc_zero(&mem, 1, sizeof *l);
    if (l == NULL) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    l->env = desc->env;
    l->width = desc->width;
    l->height = desc->height;
    l->layers = desc->layers != 0 ? desc->layers : 2;
    l->density = desc->density;
    l->tolerance = desc->tolerance > 0.0f ? desc->tolerance : 0.002f;
    l->dispersion = desc->dispersion > 0.0f ? desc->dispersion : 1.0f;
    n = (size_t)l->width * l->height;
    for (i = 0; i < l->layers; i++) {
        ok = ok && (l->layer[i].front = (uint32_t *)zbufrandi_alloc_array(&mem, n, 4)) != NULL;
        ok = ok && (l->layer[i].count = (uint32_t *)zbufrandi_alloc_array(&mem, n, 4)) != NULL;
        ok = ok && (l->layer[i].sum = (uint32_t *)zbufrandi_alloc_array(&mem, n, 24)) != NULL;
    }
    l->mem = mem;
    if (!ok) {
        zbufrand_layers_destroy(l);
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    }
    zbufrand_layers_clear(l);
    *out_layers = l;
    return ZBUFRAND_OK;
}

static float zbufrandi_front(const zbufrandi_layer *layer, size_t at) {
    float z;
    uint32_t bits = layer->front[at];
    memcpy(&z, &bits, sizeof z);
    return bits != ~(uint32_t)0 ? z : (float)INFINITY;
}

/* A sample of depth z with a linear colour in pixel `at`; any thread. */
static void zbufrandi_layers_add(zbufrand_layers *l, size_t at, float z, const float rgb[3]) {
    const float share = 1.0f + l->tolerance;
    uint32_t i, k, bits, seen;
    for (i = 0; i < l->round && i < l->layers; i++) { /* layers that are known: is it one of them? */
        if (z <= zbufrandi_front(&l->layer[i], at) * share) break;
    }
    if (i + 1 == l->round) {
        zbufrandi_layer *layer = &l->layer[i];
        (void)zbufrandi_atomic_add(&layer->count[at], 1u);
        for (k = 0; k < 3; k++) {
            float c = rgb[k] > 0.0f ? (rgb[k] < 16.0f ? rgb[k] : 16.0f) : 0.0f;
            zbufrandi_tally_add(&layer->sum[6 * at + 2 * k], (uint64_t)(c * 65536.0f + 0.5f));
        }
    } else if (i == l->round && i < l->layers) {
        uint32_t *front = &l->layer[i].front[at];
        memcpy(&bits, &z, sizeof bits);
        seen = zbufrandi_atomic_load(front);
        while (bits < seen && !zbufrandi_atomic_swap_if(front, &seen, bits)) { }
    }
}

ZBUFRAND_DEF zbufrand_result zbufrand_layers_submit(zbufrand_layers *layers, const zbufrand_sample *samples,
                                                    size_t count) {
    size_t i;
    float w, h;
    if (layers == NULL || (samples == NULL && count != 0)) return ZBUFRAND_ERR_INVALID_ARG;
    if (layers->round > layers->layers) return ZBUFRAND_OK;
    w = (float)layers->width;
    h = (float)layers->height;
    for (i = 0; i < count; i++) {
        const zbufrand_sample *s = &samples[i];
        uint32_t ix, iy;
        float z;
        if (!(s->z >= 1.17549435e-38f && s->z <= 3.40282347e38f)) continue;
        if (!(s->x >= 0.0f && s->x < w && s->y >= 0.0f && s->y < h)) continue;
        ix = (uint32_t)s->x;
        iy = (uint32_t)s->y;
        z = zbufrandi_plane_depth(s->z, (double)s->x, (double)s->y, (double)s->slope_x, (double)s->slope_y, ix, iy);
        zbufrandi_layers_add(layers, (size_t)iy * layers->width + ix, z, s->rgb);
    }
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF int zbufrand_layers_next(zbufrand_layers *layers) {
    if (layers == NULL) return 0;
    if (layers->round <= layers->layers) layers->round++;
    return layers->round <= layers->layers;
}

typedef struct zbufrandi_compose {
    const zbufrand_layers *l;
    float *rgba, *coverage;
} zbufrandi_compose;

/* Coverage of layer k at (x, y). Inside a surface (all neighbours have a layer at about the same depth) the counts of
   all nine pixels decide whether it is a wall; otherwise the pixel's own count is all there is. */
static float zbufrandi_coverage(const zbufrand_layers *l, uint32_t k, uint32_t x, uint32_t y) {
    size_t at = (size_t)y * l->width + x;
    float z = zbufrandi_front(&l->layer[k], at), slack = 8.0f * l->tolerance, samples = 0.0f, pixels = 0.0f, alpha;
    int i, j, inside = 1;
    uint32_t m;
    slack = 1.0f + (slack > 0.03f ? slack : 0.03f);
    for (j = -1; j <= 1; j++) {
        for (i = -1; i <= 1; i++) {
            int64_t u = (int64_t)x + i, v = (int64_t)y + j;
            size_t q = (size_t)v * l->width + (size_t)u;
            if (u < 0 || v < 0 || u >= (int64_t)l->width || v >= (int64_t)l->height) continue;
            for (m = 0; m < l->layers; m++) {
                float other = zbufrandi_front(&l->layer[m], q);
                if (other < (float)INFINITY && other <= z * slack && z <= other * slack) break;
            }
            if (m == l->layers) {
                inside = 0;
                continue;
            }
            samples += (float)l->layer[m].count[q];
            pixels += 1.0f;
        }
    }
    alpha = samples / (pixels * l->density);
    if (inside && alpha >= 1.0f - 2.0f * sqrtf(l->dispersion / (pixels * l->density))) return 1.0f;
    alpha = (float)l->layer[k].count[at] / l->density;
    return alpha < 1.0f ? alpha : 1.0f;
}

static void zbufrandi_compose_task(void *ctx, uint32_t task) {
    const zbufrandi_compose *c = (const zbufrandi_compose *)ctx;
    const zbufrand_layers *l = c->l;
    uint32_t y = task * 16, end = y + 16 < l->height ? y + 16 : l->height, x, k, i;
    for (; y < end; y++) {
        for (x = 0; x < l->width; x++) {
            size_t at = (size_t)y * l->width + x;
            float out[3] = {0.0f, 0.0f, 0.0f}, open = 1.0f;
            for (k = 0; k < l->layers; k++) {
                float n = (float)l->layer[k].count[at], alpha = n > 0.0f ? zbufrandi_coverage(l, k, x, y) : 0.0f;
                if (c->coverage != NULL) c->coverage[at * l->layers + k] = alpha;
                if (!(n > 0.0f)) continue;
                for (i = 0; i < 3; i++) {
                    const uint32_t *tally = l->layer[k].sum + 6 * at + 2 * i;
                    out[i] = out[i] + open * alpha * (float)((double)zbufrandi_tally(tally) / 65536.0 / (double)n);
                }
                open = open * (1.0f - alpha);
            }
            memcpy(c->rgba + 4 * at, out, sizeof out);
            c->rgba[4 * at + 3] = 1.0f - open;
        }
    }
}

ZBUFRAND_DEF zbufrand_result zbufrand_layers_resolve(const zbufrand_layers *layers, float *rgba, float *coverage) {
    zbufrandi_compose c;
    if (layers == NULL || rgba == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    c.l = layers;
    c.rgba = rgba;
    c.coverage = coverage;
    zbufrandi_parallel_for(&layers->env, zbufrandi_compose_task, &c, (layers->height + 15) / 16);
    return ZBUFRAND_OK;
}

/* ---------------------------------------------------------------------------
   accumulate: means of frames, smoothing, noise, reprojection.                 // >>accumulate

   Frames of independent samples are unbiased guesses of one picture. Each pixel keeps a weighted mean of what it has
   seen, the mean square deviation of red, green and blue from it, and the sum of the squares of the weights: the share
   of a frame's variance that the mean still has. Its inverse is the number of frames a plain mean would need. Samples
   that are not finite leave a pixel as it was.
   Plain mean: after n frames that share is 1/n. Smoothing with epsilon: it goes to epsilon / (2 - epsilon), and what
   moves leaves a trail of about (1 - epsilon) / epsilon frames.
   Adaptive: a pixel is looked up in the last picture at the place where its surface was (both cameras and its depth say
   where). Has it changed? Over 3 x 3 pixels the sum of frame minus history is compared with its standard deviation,
   known from the history itself: what is within it is noise and is averaged on, anything else begins anew. With the
   camera at rest nothing is resampled, so a still picture converges to the mean of all frames.
   --------------------------------------------------------------------------- */

typedef struct zbufrandi_history { /* per pixel */
    float *mean;      /* rgba */
    float *square;    /* red, green, blue: mean square deviation; frames n that the mean is worth, 0: none yet */
    float *depth;     /* of the last frame; adaptive only */
} zbufrandi_history;

struct zbufrand_accumulator {
    zbufrandi_mem mem;
    zbufrand_env env;
    uint32_t width, height;
    zbufrand_accumulation mode;
    float epsilon, blur;
    zbufrandi_history now, then;    /* then: adaptive only */
    zbufrand_view view;             /* of the last frame */
    int have_view;
    uint64_t frames;
};

ZBUFRAND_DEF void zbufrand_accumulator_destroy(zbufrand_accumulator *accumulator) {
    zbufrandi_mem mem;
    if (accumulator == NULL) return;
    mem = accumulator->mem;
    zbufrandi_free(&mem, accumulator->now.mean);
    zbufrandi_free(&mem, accumulator->now.square);
    zbufrandi_free(&mem, accumulator->now.depth);
    zbufrandi_free(&mem, accumulator->then.mean);
    zbufrandi_free(&mem, accumulator->then.square);
    zbufrandi_free(&mem, accumulator->then.depth);
    zbufrandi_free(&mem, accumulator);
}

ZBUFRAND_DEF void zbufrand_accumulator_clear(zbufrand_accumulator *accumulator) {
    size_t n;
    if (accumulator == NULL) return;
    n = (size_t)accumulator->width * accumulator->height;
    memset(accumulator->now.mean, 0, n * 16);
    memset(accumulator->now.square, 0, n * 16);
    accumulator->frames = 0;
    accumulator->have_view = 0;
}

ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_create(const zbufrand_accumulator_desc *desc,
                                                         zbufrand_accumulator **out_accumulator) {
    zbufrand_accumulator *a;
    zbufrandi_mem mem;
    zbufrand_result r;
    size_t n;
    int ok;
    if (out_accumulator == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    *out_accumulator = NULL;
    if (desc == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    r = zbufrandi_env_open(&desc->env, &mem);
    if (r == ZBUFRAND_OK) r = zbufrandi_size_check(desc->env.error, desc->width, desc->height);
    if (r != ZBUFRAND_OK) return r;
    ok = desc->epsilon >= 0.0f && desc->epsilon <= 1.0f && desc->blur >= 0.0f &&
         (uint32_t)desc->mode <= ZBUFRAND_ACCUMULATE_ADAPTIVE;
    if (!ok) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_INVALID_ARG, 0, "a field is out of its range");
    a = (zbufrand_accumulator *)zbufrandi_alloc_zero(&mem, 1, sizeof *a);
    if (a == NULL) return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    n = (size_t)desc->width * desc->height;
    ok = (a->now.mean = (float *)zbufrandi_alloc_array(&mem, n, 16)) != NULL;
    ok = ok && (a->now.square = (float *)zbufrandi_alloc_array(&mem, n, 16)) != NULL;
    if (desc->mode == ZBUFRAND_ACCUMULATE_ADAPTIVE) {
        ok = ok && (a->now.depth = (float *)zbufrandi_alloc_array(&mem, n, 4)) != NULL;
        ok = ok && (a->then.mean = (float *)zbufrandi_alloc_array(&mem, n, 16)) != NULL;
        ok = ok && (a->then.square = (float *)zbufrandi_alloc_array(&mem, n, 16)) != NULL;
        ok = ok && (a->then.depth = (float *)zbufrandi_alloc_array(&mem, n, 4)) != NULL;
    }
    a->env = desc->env;
    a->width = desc->width;
    a->height = desc->height;
    a->mode = desc->mode;
    a->epsilon = desc->epsilon > 0.0f ? desc->epsilon : 0.1f;
    a->blur = desc->blur;
    a->mem = mem;
    if (!ok) {
        zbufrand_accumulator_destroy(a);
        return zbufrandi_fail(desc->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "out of memory");
    }
    zbufrand_accumulator_clear(a);
    *out_accumulator = a;
    return ZBUFRAND_OK;
}

/* One more sample, with weight w, or the first. For w = 1/(n+1) this is Welford's mean and mean square deviation; for
   any weights with sum of squares W = 1/n the deviation is expected to be (1 - W) times the variance of a frame. */
ZBUFRANDI_INLINE void zbufrandi_blend(float *mean, float *square, const float *sample, float w) {
    float n = square[3];
    uint32_t k;
    if (!(n > 0.0f)) {
        memcpy(mean, sample, 16);
        square[0] = square[1] = square[2] = 0.0f;
        square[3] = 1.0f;
        return;
    }
    for (k = 0; k < 4; k++) {
        float d = sample[k] - mean[k];
        mean[k] = mean[k] + w * d;
        if (k < 3) square[k] = (1.0f - w) * (square[k] + w * (d * d));
    }
    square[3] = 1.0f / ((1.0f - w) * (1.0f - w) / n + w * w);
}

ZBUFRANDI_INLINE int zbufrandi_finite4(const float *p) { /* and the sum of many squares is, too */
    return zbufrandi_absf(p[0]) < 1e15f && zbufrandi_absf(p[1]) < 1e15f && zbufrandi_absf(p[2]) < 1e15f &&
           zbufrandi_absf(p[3]) < 1e15f;
}

typedef struct zbufrandi_accumulate {
    zbufrand_accumulator *a;
    const float *rgba, *depth;
    float epsilon;            /* 0: plain mean */
    int moved;
    double step[3][4];        /* camera space of this frame -> of the last */
    const zbufrand_view *view;
} zbufrandi_accumulate;

static void zbufrandi_accumulate_task(void *ctx, uint32_t task) {
    const zbufrandi_accumulate *c = (const zbufrandi_accumulate *)ctx;
    zbufrand_accumulator *a = c->a;
    uint32_t y = task * 16, end = y + 16 < a->height ? y + 16 : a->height;
    size_t q = (size_t)y * a->width, stop = (size_t)end * a->width;
    for (; q < stop; q++) {
        float *square = a->now.square + 4 * q, n = square[3];
        const float *sample = c->rgba + 4 * q;
        if (!zbufrandi_finite4(sample)) continue;
        zbufrandi_blend(a->now.mean + 4 * q, square, sample, c->epsilon > 0.0f ? c->epsilon : 1.0f / (n + 1.0f));
        if (!(c->epsilon > 0.0f)) square[3] = n < 16777215.0f ? n + 1.0f : n; /* exactly */
    }
}

/* ---- history where the surface was ---- */

/* a = b after inverse of c: takes camera space of c to camera space of b. Rows are orthonormal. */
static void zbufrandi_view_step(const zbufrand_view *b, const zbufrand_view *c, double step[3][4]) {
    int i, j, k;
    for (i = 0; i < 3; i++) {
        step[i][3] = b->world_to_camera[i][3];
        for (j = 0; j < 3; j++) {
            step[i][j] = 0.0;
            for (k = 0; k < 3; k++) step[i][j] += b->world_to_camera[i][k] * c->world_to_camera[j][k];
        }
        for (j = 0; j < 3; j++) step[i][3] -= step[i][j] * c->world_to_camera[j][3];
    }
}

/* Where the surface at depth z of pixel (x, y) was in the last picture: pixels, and its depth there. Background: the
   direction counts. 0: behind the camera. */
static int zbufrandi_moved_from(const zbufrandi_accumulate *c, double x, double y, double z, double *out_x,
                                double *out_y, double *out_z) {
    const zbufrand_view *v = c->view, *w = &c->a->view;
    double p[3], q[3], t = 1.0;
    int i;
    p[0] = (x - v->center_x) / v->focal;
    p[1] = (v->center_y - y) / v->focal;
    p[2] = 1.0;
    if (z < (double)INFINITY) {
        for (i = 0; i < 3; i++) p[i] *= z;
    } else {
        t = 0.0;
    }
    for (i = 0; i < 3; i++) {
        q[i] = c->step[i][0] * p[0] + c->step[i][1] * p[1] + c->step[i][2] * p[2] + c->step[i][3] * t;
    }
    if (!(q[2] > 1e-30)) return 0;
    *out_x = w->center_x + w->focal * q[0] / q[2];
    *out_y = w->center_y - w->focal * q[1] / q[2];
    *out_z = z < (double)INFINITY ? q[2] : z;
    return 1;
}

#define ZBUFRANDI_SAME_DEPTH 0.02f /* share by which depths may differ for history to be kept */
#define ZBUFRANDI_CHANGED 4.5f     /* standard deviations beyond which the picture counts as changed */

static int zbufrandi_same_depth(float a, float b, float match) { /* within the share `match`, or both infinite */
    return a == b || (a >= b * (1.0f - match) && b >= a * (1.0f - match) && a < (float)INFINITY);
}

/* Moves history along: then -> now, bilinearly from those of the four pixels around that had the surface's depth. (To
   accept at edges any depth that is seen around both pixels keeps more history, and ghosts of what moved away.) */
static void zbufrandi_reproject_task(void *ctx, uint32_t task) {
    const zbufrandi_accumulate *c = (const zbufrandi_accumulate *)ctx;
    zbufrand_accumulator *a = c->a;
    uint32_t y = task * 16, end = y + 16 < a->height ? y + 16 : a->height, x, k;
    for (; y < end; y++) {
        for (x = 0; x < a->width; x++) {
            size_t q = (size_t)y * a->width + x;
            zbufrandi_f4 mean = zbufrandi_f4_all(0.0f), square = mean, scale;
            float sum = 0.0f, z = c->depth[q];
            double u, v, w;
            if (z > 0.0f && zbufrandi_moved_from(c, x + 0.5, y + 0.5, (double)z, &u, &v, &w) && u > -0.5 && v > -0.5 &&
                u < (double)a->width + 0.5 && v < (double)a->height + 0.5) {
                int32_t i0 = (int32_t)(u + 0.5) - 1, j0 = (int32_t)(v + 0.5) - 1; /* floor of u - 1/2 */
                float fx = (float)(u - 0.5 - (double)i0), fy = (float)(v - 0.5 - (double)j0);
                for (k = 0; k < 4; k++) {
                    int32_t i = i0 + (int32_t)(k & 1), j = j0 + (int32_t)(k >> 1);
                    float weight = (k & 1 ? fx : 1.0f - fx) * (k >> 1 ? fy : 1.0f - fy);
                    size_t p = (size_t)j * a->width + (size_t)i;
                    if (i < 0 || j < 0 || i >= (int32_t)a->width || j >= (int32_t)a->height) continue;
                    if (!(a->then.square[4 * p + 3] > 0.0f && weight > 0.0f)) continue;
                    if (!zbufrandi_same_depth(a->then.depth[p], (float)w, ZBUFRANDI_SAME_DEPTH)) continue;
                    scale = zbufrandi_f4_all(weight);
                    p *= 4;
                    mean = zbufrandi_f4_add(mean, zbufrandi_f4_mul(scale, zbufrandi_f4_load(a->then.mean + p)));
                    square = zbufrandi_f4_add(square, zbufrandi_f4_mul(scale, zbufrandi_f4_load(a->then.square + p)));
                    sum += weight;
                }
            }
            scale = zbufrandi_f4_all(sum > 0.01f ? 1.0f / sum : 0.0f); /* 0: new here */
            zbufrandi_f4_store(a->now.mean + 4 * q, zbufrandi_f4_mul(mean, scale));
            zbufrandi_f4_store(a->now.square + 4 * q, zbufrandi_f4_mul(square, scale));
        }
    }
}

/* ---- has it changed? ----
   Sums over 3 x 3 pixels, of each channel: of the differences d between frame and history, and of their variance, that
   of one frame and 1/n of it of the history. Pixels with a short history do not know their noise yet: how much their
   differences scatter among themselves stands for it. Sums run over columns first, then over rows. */

enum { ZBUFRANDI_CHANGE_COLUMNS = 24 };

typedef struct zbufrandi_change { /* of a pixel, or summed */
    float d[4], known[4];                      /* all; variance of those with history enough */
    float young_d[4], young_d2[4], young[4];   /* the others: d (last: how many), d squared, variance */
} zbufrandi_change;

static void zbufrandi_change_pixel(const zbufrandi_accumulate *c, int64_t x, int64_t y, zbufrandi_change *out) {
    const zbufrand_accumulator *a = c->a;
    const float *s, *m, *q;
    float f, v[4];
    zbufrandi_f4 sample, d, d2, variance;
    size_t p;
    memset(out, 0, sizeof *out);
    if (x < 0 || y < 0 || x >= (int64_t)a->width || y >= (int64_t)a->height) return;
    p = 4 * ((size_t)y * a->width + (size_t)x);
    s = c->rgba + p;
    m = a->then.mean + p;
    q = a->then.square + p;
    if (!(q[3] > 0.0f) || !zbufrandi_finite4(s)) return;
    f = q[3] > 1.001f ? (q[3] + 1.0f) / (q[3] - 1.0f) : 0.0f;
    sample = zbufrandi_f4_load(s);
    d = zbufrandi_f4_sub(sample, zbufrandi_f4_load(m));
    d2 = zbufrandi_f4_mul(d, d);
    variance = zbufrandi_f4_mul(zbufrandi_f4_load(q), zbufrandi_f4_all(f));
    sample = zbufrandi_f4_add(zbufrandi_f4_mul(sample, sample), zbufrandi_f4_all(1.0f));
    variance = zbufrandi_f4_add(variance, zbufrandi_f4_mul(sample, zbufrandi_f4_all(1e-9f))); /* rounding */
    zbufrandi_f4_store(v, variance);
    zbufrandi_f4_store(out->d, d);
    if (q[3] < 7.5f) {
        zbufrandi_f4_store(out->young_d, d);
        out->young_d[3] = 1.0f;
        zbufrandi_f4_store(out->young_d2, d2);
        memcpy(out->young, v, 16);
    } else {
        memcpy(out->known, v, 16);
    }
}

ZBUFRANDI_INLINE void zbufrandi_change_sum(zbufrandi_change *out, const zbufrandi_change *a, const zbufrandi_change *b,
                                           const zbufrandi_change *c) {
#define ZBUFRANDI_SUM(field) zbufrandi_f4_store(out->field, zbufrandi_f4_add(zbufrandi_f4_add( \
    zbufrandi_f4_load(a->field), zbufrandi_f4_load(b->field)), zbufrandi_f4_load(c->field)))
    ZBUFRANDI_SUM(d);
    ZBUFRANDI_SUM(known);
    ZBUFRANDI_SUM(young_d);
    ZBUFRANDI_SUM(young_d2);
    ZBUFRANDI_SUM(young);
#undef ZBUFRANDI_SUM
}

static int zbufrandi_changed(const zbufrandi_change *s, float limit) {
    float n = s->young_d[3];
    int k;
    for (k = 0; k < 3; k++) {
        float variance = s->known[k], scatter = 0.0f;
        if (n > 0.0f) scatter = s->young_d2[k] - s->young_d[k] * s->young_d[k] / n;
        variance += scatter > s->young[k] ? scatter : s->young[k];
        if (s->d[k] * s->d[k] > limit * variance) return 1;
    }
    return 0;
}

static void zbufrandi_adaptive_task(void *ctx, uint32_t task) { /* then: history in place; now: out */
    const zbufrandi_accumulate *c = (const zbufrandi_accumulate *)ctx;
    zbufrand_accumulator *a = c->a;
    zbufrandi_change ring[3][ZBUFRANDI_CHANGE_COLUMNS + 2], column[ZBUFRANDI_CHANGE_COLUMNS + 2], sum;
    uint32_t y0 = task * 16, end = y0 + 16 < a->height ? y0 + 16 : a->height, x0, y, n, i;
    float limit = ZBUFRANDI_CHANGED * ZBUFRANDI_CHANGED;
    for (x0 = 0; x0 < a->width; x0 += ZBUFRANDI_CHANGE_COLUMNS) {
        n = a->width - x0 < ZBUFRANDI_CHANGE_COLUMNS ? a->width - x0 : (uint32_t)ZBUFRANDI_CHANGE_COLUMNS;
        for (i = 0; i < n + 2; i++) {
            zbufrandi_change_pixel(c, (int64_t)x0 + i - 1, (int64_t)y0 - 1, &ring[(y0 + 2) % 3][i]);
            zbufrandi_change_pixel(c, (int64_t)x0 + i - 1, y0, &ring[y0 % 3][i]);
        }
        for (y = y0; y < end; y++) {
            for (i = 0; i < n + 2; i++) {
                zbufrandi_change_pixel(c, (int64_t)x0 + i - 1, (int64_t)y + 1, &ring[(y + 1) % 3][i]);
                zbufrandi_change_sum(&column[i], &ring[(y + 2) % 3][i], &ring[y % 3][i], &ring[(y + 1) % 3][i]);
            }
            for (i = 0; i < n; i++) {
                size_t q = (size_t)y * a->width + x0 + i;
                float *mean = a->now.mean + 4 * q, *square = a->now.square + 4 * q, seen, w;
                const float *sample = c->rgba + 4 * q;
                memcpy(mean, a->then.mean + 4 * q, 16);
                memcpy(square, a->then.square + 4 * q, 16);
                a->now.depth[q] = c->depth[q];
                if (!zbufrandi_finite4(sample)) continue;
                seen = square[3];
                if (seen > 0.0f) {
                    zbufrandi_change_sum(&sum, &column[i], &column[i + 1], &column[i + 2]);
                    if (zbufrandi_changed(&sum, limit)) seen = square[3] = 0.0f;
                }
                w = 1.0f / (seen + 1.0f);
                if (c->moved && w < a->epsilon) w = a->epsilon; /* resampled history: no more than smoothing keeps */
                zbufrandi_blend(mean, square, sample, w);
            }
        }
    }
}

/* ---- frames ---- */

/* How far the picture moves, in pixels: root mean square over a raster of 16 x 16 places. */
static double zbufrandi_speed(const zbufrandi_accumulate *c) {
    const zbufrand_accumulator *a = c->a;
    double sum = 0.0, n = 0.0;
    uint32_t i, j;
    for (j = 0; j < 16; j++) {
        for (i = 0; i < 16; i++) {
            uint32_t x = (2 * i + 1) * a->width / 32, y = (2 * j + 1) * a->height / 32; /* sizes are 16 bits */
            float z = c->depth[(size_t)y * a->width + x];
            double u, v, w;
            if (!(z > 0.0f) || !zbufrandi_moved_from(c, x + 0.5, y + 0.5, (double)z, &u, &v, &w)) continue;
            u -= x + 0.5;
            v -= y + 0.5;
            sum += u * u + v * v;
            n += 1.0;
        }
    }
    return n > 0.0 ? sqrt(sum / n) : 0.0;
}

ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_add(zbufrand_accumulator *accumulator, const float *rgba,
                                                      const float *depth, const zbufrand_view *view) {
    zbufrandi_accumulate c;
    zbufrand_accumulator *a = accumulator;
    zbufrandi_history h;
    uint32_t tasks;
    int adaptive;
    if (a == NULL || rgba == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    adaptive = a->mode == ZBUFRAND_ACCUMULATE_ADAPTIVE;
    if (adaptive && (depth == NULL || view == NULL)) return ZBUFRAND_ERR_INVALID_ARG;
    if (view != NULL && !zbufrandi_view_ok(view)) return ZBUFRAND_ERR_INVALID_ARG;
    memset(&c, 0, sizeof c);
    c.a = a;
    c.rgba = rgba;
    c.depth = depth;
    c.view = view;
    c.epsilon = a->mode == ZBUFRAND_ACCUMULATE_SMOOTH ? a->epsilon : 0.0f;
    tasks = (a->height + 15) / 16;
    if (a->have_view && view != NULL) {
        c.moved = memcmp(&a->view, view, sizeof *view) != 0;
        zbufrandi_view_step(&a->view, view, c.step);
    }
    if (!adaptive) {
        if (a->mode == ZBUFRAND_ACCUMULATE_SMOOTH && a->blur > 0.0f && c.moved && depth != NULL) {
            double speed = zbufrandi_speed(&c), e = speed / (speed + (double)a->blur); /* trail: speed (1 - e) / e */
            if (e > (double)c.epsilon) c.epsilon = (float)e;
        }
        zbufrandi_parallel_for(&a->env, zbufrandi_accumulate_task, &c, tasks);
    } else {
        h = a->then; /* the last result is the history now */
        a->then = a->now;
        a->now = h;
        if (c.moved && a->frames > 0) {
            zbufrandi_parallel_for(&a->env, zbufrandi_reproject_task, &c, tasks);
            h = a->then;
            a->then = a->now;
            a->now = h;
        }
        zbufrandi_parallel_for(&a->env, zbufrandi_adaptive_task, &c, tasks);
    }
    a->frames++;
    if (view != NULL) {
        a->view = *view;
        a->have_view = 1;
    }
    return ZBUFRAND_OK;
}

/* ---- results ---- */

ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_noise(const zbufrand_accumulator *accumulator, double target,
                                                        zbufrand_noise *out_noise) {
    const zbufrand_accumulator *a = accumulator;
    double sum = 0.0, frames = 0.0, known = 0.0, share, want;
    uint32_t x, y;
    if (a == NULL || out_noise == NULL || !(target >= 0.0)) return ZBUFRAND_ERR_INVALID_ARG;
    memset(out_noise, 0, sizeof *out_noise);
    for (y = 0; y < a->height; y++) {
        double row = 0.0, row_frames = 0.0;
        for (x = 0; x < a->width; x++) {
            const float *s = a->now.square + 4 * ((size_t)y * a->width + x);
            double n = (double)s[3];
            row_frames += n;
            if (n < 1.001) continue;
            known += 1.0;
            row += ((double)s[0] + (double)s[1] + (double)s[2]) / (n - 1.0); /* variance of the mean */
        }
        sum += row;
        frames += row_frames;
    }
    frames /= (double)a->width * a->height;
    out_noise->frames = frames;
    out_noise->rmse = (double)INFINITY;
    out_noise->more_frames = 2.0;
    if (known < 0.5) return ZBUFRAND_OK;
    sum /= 3.0 * known;
    out_noise->rmse = sqrt(sum);
    out_noise->more_frames = 0.0;
    if (!(target > 0.0 && out_noise->rmse > target)) return ZBUFRAND_OK;
    share = 1.0 / frames;
    want = share * target * target / sum;
    if (a->mode == ZBUFRAND_ACCUMULATE_SMOOTH) {
        double e = (double)a->epsilon, n = 0.0;
        if (want <= e / (2.0 - e)) n = (double)INFINITY;
        for (; n < 1e6 && share > want; n += 1.0) share = (1.0 - e) * (1.0 - e) * share + e * e;
        out_noise->more_frames = n;
    } else {
        out_noise->more_frames = 1.0 / want - frames > 1.0 ? 1.0 / want - frames : 1.0;
    }
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_accumulator_get(const zbufrand_accumulator *accumulator, float contrast,
                                                      float *rgba) {
    const zbufrand_accumulator *a = accumulator;
    size_t n, i;
    int k;
    if (a == NULL || rgba == NULL || contrast != contrast) return ZBUFRAND_ERR_INVALID_ARG;
    n = (size_t)a->width * a->height;
    for (i = 0; i < n; i++, rgba += 4) {
        const float *m = a->now.mean + 4 * i;
        float g = contrast;
        if (contrast < 0.0f) g = m[3] > 0.0f ? 1.0f / m[3] : 0.0f;
        if (contrast == 0.0f) {
            memcpy(rgba, m, 16);
            continue;
        }
        if (g * m[3] > 1.0f) g = 1.0f / m[3]; /* alpha 1 at most, and the colour that belongs to it */
        for (k = 0; k < 4; k++) { /* an alpha next to 0 makes them large, but numbers */
            const double x = (double)m[k] * zbufrandi_min((double)g, 1e38);
            rgba[k] = (float)zbufrandi_max(zbufrandi_min(x, 1e38), -1e38);
        }
        if (m[3] > 0.0f && g == 1.0f / m[3]) rgba[3] = 1.0f;
    }
    return ZBUFRAND_OK;
}

/* ---------------------------------------------------------------------------
   theory: sample counts, success probabilities, the law of a pixel.            // >>theory
   Formulas of M. Wand's thesis with its slips put right, and sharper ones where there are any.
   --------------------------------------------------------------------------- */

/* ---- elementary functions; errors in units of the last place (ulp), measured over the ranges used ---- */

#define ZBUFRANDI_NAN ((double)NAN)
#define ZBUFRANDI_INFINITY ((double)INFINITY)

/* e^x - 1 for |x| <= 0.35 by its series; 1 ulp */
static double zbufrandi_expm1_series(double x) {
    double r = 0.0;
    int i;
    for (i = 16; i >= 2; i--) r = x / (double)i * (1.0 + r); /* r = x/i + x^2/(i (i+1)) + ... */
    return x * (1.0 + r);
}

/* e^x; 2 ulp */
static double zbufrandi_exp(double x) {
    double n, r, scale;
    uint64_t bits;
    int64_t k;
    if (!(x > -745.2)) return x < 0.0 ? 0.0 : x; /* NaN stays */
    if (x > 709.79) return ZBUFRANDI_INFINITY;
    k = zbufrandi_floor(x * 1.44269504088896340736 + 0.5);
    n = (double)k;
    /* ln 2 in two parts: the first product is exact */
    r = (x - n * 6.93147180369123816490e-01) - n * 1.90821492927058770002e-10;
    r = 1.0 + zbufrandi_expm1_series(r);
    if (k > 1022) { /* the last two powers of two are not normal numbers yet, or not any more */
        r *= 4.0;
        k -= 2;
    }
    if (k < -1021) {
        bits = (uint64_t)(k + 1023 + 64) << 52;
        memcpy(&scale, &bits, sizeof scale);
        return r * scale * 5.421010862427522e-20; /* 2^-64 */
    }
    bits = (uint64_t)(k + 1023) << 52;
    memcpy(&scale, &bits, sizeof scale);
    return r * scale;
}

/* e^x - 1; 3 ulp, also near 0 */
static double zbufrandi_expm1(double x) {
    return x > -0.35 && x < 0.35 ? zbufrandi_expm1_series(x) : zbufrandi_exp(x) - 1.0;
}

/* 2 artanh(s) = ln((1+s)/(1-s)) for |s| < 0.2; 2 ulp */
static double zbufrandi_log_series(double s) {
    double s2 = s * s, r = 0.0;
    int i;
    for (i = 23; i >= 3; i -= 2) r = s2 * (1.0 / (double)i + r);
    return 2.0 * s + 2.0 * s * r;
}

/* ln x; 2 ulp. ln 0 = -INFINITY, of a negative NaN */
static double zbufrandi_log(double x) {
    uint64_t bits;
    int64_t e = 0;
    if (!(x > 0.0)) return x == 0.0 ? -ZBUFRANDI_INFINITY : ZBUFRANDI_NAN;
    if (x == ZBUFRANDI_INFINITY) return x;
    if (x < 2.2250738585072014e-308) {
        x *= 18014398509481984.0; /* 2^54 */
        e = -54;
    }
    memcpy(&bits, &x, sizeof bits);
    e += (int64_t)(bits >> 52) - 1023;
    bits = (bits & 0xfffffffffffffu) | (uint64_t)1023 << 52;
    memcpy(&x, &bits, sizeof x);
    if (x > 1.41421356237309504880) {
        x *= 0.5;
        e++;
    }
    return (double)e * 6.93147180369123816490e-01 +
           ((double)e * 1.90821492927058770002e-10 + zbufrandi_log_series((x - 1.0) / (x + 1.0)));
}

/* ln(1 + x); 3 ulp, also near 0 */
static double zbufrandi_log1p(double x) {
    return x > -0.3 && x < 0.4 ? zbufrandi_log_series(x / (2.0 + x)) : zbufrandi_log(1.0 + x);
}

/* (1 - q)^n for 0 <= q <= 1, n >= 0 */
static double zbufrandi_pow1m(double q, double n) { return n == 0.0 ? 1.0 : zbufrandi_exp(n * zbufrandi_log1p(-q)); }

/* 1 - s^(1/n): about 1e-9 for millions of cells, hence never by subtraction */
static double zbufrandi_one_minus_root(double s, double n) { return -zbufrandi_expm1(zbufrandi_log(s) / n); }

#define ZBUFRANDI_HALF_LOG_2PI 0.91893853320467274178

/* What Stirling's formula (x - 1/2) ln x - x + ln(2 pi)/2 lacks of ln Gamma(x), x >= 12, by his series. */
static double zbufrandi_stirling(double x) {
    const double y = 1.0 / (x * x);
    return (1.0 / 12.0 - y * (1.0 / 360.0 - y * (1.0 / 1260.0 - y * (1.0 / 1680.0 - y * (1.0 / 1188.0 - y *
           (691.0 / 360360.0 - y / 156.0)))))) / x;
}

/* ln Gamma(x), x > 0: Stirling's series from 12 on; error below 2e-14 max(1, |ln Gamma|) */
static double zbufrandi_log_gamma(double x) {
    double product = 1.0;
    while (x < 12.0) {
        product *= x;
        x += 1.0;
    }
    return (x - 0.5) * zbufrandi_log(x) - x + ZBUFRANDI_HALF_LOG_2PI + zbufrandi_stirling(x) - zbufrandi_log(product);
}

/* zbufrandi_stirling for all x > 0 */
static double zbufrandi_stirling_all(double x) {
    if (x >= 12.0) return zbufrandi_stirling(x);
    return zbufrandi_log_gamma(x) - ((x - 0.5) * zbufrandi_log(x) - x + ZBUFRANDI_HALF_LOG_2PI);
}

/* ln(1 + d), also as ln y where 1 + d would cancel */
static double zbufrandi_log_near(double y, double d) {
    return d > -0.3 && d < 0.4 ? zbufrandi_log1p(d) : zbufrandi_log(y);
}

/* Normal law: probability above x >= 0. Power series of erf up to 2.5, continued fraction beyond, evaluated from its
   60th term; relative error below 1e-13. */
static double zbufrandi_normal_above(double x) {
    double phi = 0.39894228040143267794 * zbufrandi_exp(-0.5 * x * x), sum, term;
    int i;
    if (x < 2.5) { /* Phi(x) - 1/2 = phi(x) (x + x^3/3 + x^5/(3 5) + ...) */
        for (sum = term = x, i = 3; i < 121; i += 2) {
            term *= x * x / (double)i;
            sum += term;
        }
        return 0.5 - phi * sum;
    }
    for (sum = x, i = 120; i >= 1; i--) sum = x + (double)i / sum; /* 1/(x + 1/(x + 2/(x + 3/...))) */
    return phi / sum;
}

ZBUFRAND_DEF double zbufrand_normal_quantile(double p) {
    double tail, x, lo = 0.0, hi = 40.0;
    int i;
    if (!(p > 0.0 && p < 1.0)) return ZBUFRANDI_NAN;
    tail = p < 0.5 ? p : 1.0 - p;
    x = sqrt(-2.0 * zbufrandi_log(2.0 * tail)); /* above the solution: the tail is below exp(-x^2/2)/2 */
    for (i = 0; i < 100 && hi - lo > 0.0; i++) { /* Newton, kept in a bracket */
        double above = zbufrandi_normal_above(x), phi = 0.39894228040143267794 * zbufrandi_exp(-0.5 * x * x), next;
        if (above > tail) lo = x;
        else hi = x;
        next = x + (above - tail) / phi;
        if (!(next > lo && next < hi)) next = 0.5 * (lo + hi);
        if (zbufrandi_abs(next - x) <= 1e-15 * (1.0 + x)) break;
        x = next;
    }
    return p < 0.5 ? -x : x;
}

ZBUFRAND_DEF double zbufrand_harmonic(double n) {
    double sum = 0.57721566490153286061, x = n + 1.0, y;
    if (!(n >= 0.0)) return ZBUFRANDI_NAN;
    if (n == ZBUFRANDI_INFINITY) return n;
    while (x < 12.0) {
        sum -= 1.0 / x;
        x += 1.0;
    }
    y = 1.0 / (x * x);
    return sum + zbufrandi_log(x) - 0.5 / x -
           y * (1.0 / 12.0 - y * (1.0 / 120.0 - y * (1.0 / 252.0 - y * (1.0 / 240.0 - y / 132.0))));
}

/* ---- sample counts ---- */

static int zbufrandi_area_ok(double area, double visible, double block) {
    return visible > 0.0 && area >= visible && block >= 1.0 && zbufrandi_finite(area) && zbufrandi_finite(block);
}

ZBUFRAND_DEF double zbufrand_cell_edge(zbufrand_cells rule, double block) {
    if (!(block >= 1.0 && block < 1e15)) return ZBUFRANDI_NAN;
    switch (rule) {
    case ZBUFRAND_CELLS_EXACT: return -(double)zbufrandi_floor(-0.5 * block);
    case ZBUFRAND_CELLS_THESIS: return (double)zbufrandi_floor(0.5 * block);
    case ZBUFRAND_CELLS_PRACTICE: return block;
    case ZBUFRAND_CELLS_FORCE_32BIT: break;
    }
    return ZBUFRANDI_NAN;
}

ZBUFRAND_DEF double zbufrand_samples_lemma2(double cells, double tolerated, double probability) {
    if (!(cells >= 1.0 && tolerated >= 0.0 && tolerated < cells && zbufrandi_finite(cells))) return ZBUFRANDI_NAN;
    if (!(probability > 0.0 && probability < 1.0)) return ZBUFRANDI_NAN;
    if (cells == 1.0) return 1.0; /* the limit: one sample fills the only cell */
    return zbufrandi_log(zbufrandi_one_minus_root(probability, cells - tolerated)) /
           zbufrandi_log_near((cells - 1.0) / cells, -1.0 / cells);
}

/* Visible and hidden cells: the number of samples that hit visible ones is binomial, about normal. Two stages, each
   with probability sqrt(s): enough samples m_v fall on visible cells, and they fill them. exact solves
   m p - q sqrt(m p (1-p)) = m_v; Theorem 5 bounds that by (m_v + q sqrt(m_v)) / p. */
static double zbufrandi_two_stages(double area, double visible, double probability, int exact) {
    double s = sqrt(probability), p = visible / area, q, root;
    double m_v = -visible * zbufrandi_log(zbufrandi_one_minus_root(probability, 2.0 * visible));
    /* 1 - s without cancellation */
    q = s < 0.5 ? zbufrand_normal_quantile(s) : 0.0 - zbufrand_normal_quantile((1.0 - probability) / (1.0 + s));
    if (!(m_v > 0.0)) return 0.0;
    if (!exact) return (m_v + q * sqrt(m_v)) / p;
    root = q * (1.0 - p);
    root = sqrt(0.25 * q * root + m_v) * sqrt(1.0 - p) * q; /* q sqrt(q^2 (1-p)^2 / 4 + (1-p) m_v) */
    return (m_v + 0.5 * q * q * (1.0 - p) + root) / p;
}

ZBUFRAND_DEF double zbufrand_samples(zbufrand_bound bound, double area, double visible, double block,
                                     double probability) {
    double d2 = block * block, n = area, v = visible, m, edge;
    if (!zbufrandi_area_ok(area, visible, block)) return ZBUFRANDI_NAN;
    if (!(probability > 0.0 && probability < 1.0)) return ZBUFRANDI_NAN;
    if (bound != ZBUFRAND_BOUND_UNION && bound != ZBUFRAND_BOUND_DIRECT && block > 1.0) {
        edge = zbufrand_cell_edge(ZBUFRAND_CELLS_EXACT, block);
        n /= edge * edge;
        v /= edge * edge;
    }
    switch (bound) {
    case ZBUFRAND_BOUND_UNION: return area * zbufrand_density(visible, block, probability);
    case ZBUFRAND_BOUND_DIRECT:
        m = -area / d2 * zbufrandi_log(zbufrandi_one_minus_root(probability, visible));
        return m > 0.0 ? m : 0.0;
    case ZBUFRAND_BOUND_LEMMA2: return zbufrand_samples_lemma2(n < 1.0 ? 1.0 : n, 0.0, probability);
    case ZBUFRAND_BOUND_LEMMA3:
        m = -n * zbufrandi_log(zbufrandi_one_minus_root(probability, n));
        return m > 0.0 ? m : 0.0;
    case ZBUFRAND_BOUND_THEOREM1: return n * zbufrand_harmonic(n);
    case ZBUFRAND_BOUND_THEOREM2:
        m = n * (zbufrandi_log(n) - zbufrandi_log(-zbufrandi_log(probability)));
        return m > 0.0 ? m : 0.0;
    case ZBUFRAND_BOUND_LEMMA4: return zbufrandi_two_stages(n, v, probability, 1);
    case ZBUFRAND_BOUND_THEOREM5: return zbufrandi_two_stages(n, v, probability, 0);
    case ZBUFRAND_BOUND_FORCE_32BIT: break;
    }
    return ZBUFRANDI_NAN;
}

ZBUFRAND_DEF double zbufrand_density(double visible, double block, double probability) {
    double m;
    if (!zbufrandi_area_ok(visible, visible, block)) return ZBUFRANDI_NAN;
    if (!(probability > 0.0 && probability < 1.0)) return ZBUFRANDI_NAN;
    m = (zbufrandi_log(visible) - zbufrandi_log1p(-probability)) / (block * block);
    return m > 0.0 ? m : 0.0;
}

ZBUFRAND_DEF double zbufrand_samples_for_share(double area, double block, double share) {
    if (!zbufrandi_area_ok(area, area, block) || !(share > 0.0 && share <= 1.0)) return ZBUFRANDI_NAN;
    return -area / (block * block) * zbufrandi_log(share);
}

/* P(binomial(n, p) <= k) = I_{1-p}(n-k, k+1), the incomplete beta function by its continued fraction (modified Lentz).
   The fraction is taken on the side where it converges fast. Where that is the side of n-k and k is small, its terms
   would cancel if n is large: there the chances of k, k-1, ... are added up. */
static double zbufrandi_binomial_below(double n, double p, double k) {
    double a = n - k, b = k + 1.0, x = -zbufrandi_expm1(zbufrandi_log(p)), c, d, f, i, front;
    int swap = x > (a + 1.0) / (a + b + 2.0);
    /* ln of x^a p^b Gamma(a+b) / (Gamma(a) Gamma(b)), in which numbers as large as a ln a would cancel: by how much
       p (a + b) is off b, and Stirling's formula for the rest */
    d = b - p * (a + b);
    front = a * zbufrandi_log_near(x * (a + b) / a, d / a) + b * zbufrandi_log_near(p * (a + b) / b, -d / b) +
            0.5 * zbufrandi_log(a * (b / (a + b))) - ZBUFRANDI_HALF_LOG_2PI + zbufrandi_stirling_all(a + b) -
            zbufrandi_stirling_all(a) - zbufrandi_stirling_all(b);
    if (!swap && k <= 1e5) {
        for (f = c = 1.0, i = k; i > 0.0 && c > 1e-17 * f; i -= 1.0) {
            c *= i * x / ((n - i + 1.0) * p);
            f += c;
        }
        return zbufrandi_min(1.0, zbufrandi_exp(front) / (a * p) * f);
    }
    if (swap) {
        c = a;
        a = b;
        b = c;
        x = p;
    }
    c = 1.0;
    d = 1.0 - (a + b) * x / (a + 1.0);
    d = 1.0 / (zbufrandi_abs(d) < 1e-300 ? 1e-300 : d);
    f = d;
    for (i = 1.0; i < 4e6; i += 1.0) {
        double t = i * (b - i) * x / ((a + 2.0 * i - 1.0) * (a + 2.0 * i)), step;
        d = 1.0 + t * d;
        c = 1.0 + t / c;
        d = 1.0 / (zbufrandi_abs(d) < 1e-300 ? 1e-300 : d);
        if (zbufrandi_abs(c) < 1e-300) c = 1e-300;
        f *= d * c;
        t = -(a + i) * (a + b + i) * x / ((a + 2.0 * i) * (a + 2.0 * i + 1.0));
        d = 1.0 + t * d;
        c = 1.0 + t / c;
        d = 1.0 / (zbufrandi_abs(d) < 1e-300 ? 1e-300 : d);
        if (zbufrandi_abs(c) < 1e-300) c = 1e-300;
        step = d * c;
        f *= step;
        if (zbufrandi_abs(step - 1.0) < 1e-15) break;
    }
    f *= zbufrandi_exp(front) / a;
    f = swap ? 1.0 - f : f;
    return f < 0.0 ? 0.0 : f > 1.0 ? 1.0 : f;
}

ZBUFRAND_DEF double zbufrand_samples_tolerant(double area, double visible, double tolerated, double probability) {
    double k, lo, hi, mean, p, spread;
    int i;
    if (!zbufrandi_area_ok(area, visible, 1.0) || !(visible >= 1.0 && visible <= 1e12)) return ZBUFRANDI_NAN;
    if (!(tolerated >= 0.0 && tolerated < visible && probability > 0.0 && probability < 1.0)) return ZBUFRANDI_NAN;
    k = (double)zbufrandi_floor(tolerated);
    if (k == 0.0) return zbufrand_samples(ZBUFRAND_BOUND_DIRECT, area, visible, 1.0, probability);
    /* bracket of u = ln(1/p): the normal law says about where, doubling makes it certain */
    mean = (k + 0.5) / visible;
    spread = zbufrandi_abs(zbufrand_normal_quantile(probability)) * sqrt(mean * (1.0 - mean) / visible) + 1.0 / visible;
    for (lo = mean + spread; lo < 1.0; lo += spread) {
        if (!(zbufrandi_binomial_below(visible, lo, k) > probability)) break;
        spread *= 2.0;
    }
    lo = lo < 1.0 ? -zbufrandi_log(lo) : 0.0;
    spread = spread < 0.5 * mean ? spread : 0.5 * mean;
    for (p = mean - spread; zbufrandi_binomial_below(visible, p, k) < probability; p *= 0.5) { }
    hi = -zbufrandi_log(p);
    for (i = 0; i < 60 && hi - lo > 1e-13 * hi; i++) {
        double mid = 0.5 * (lo + hi);
        if (zbufrandi_binomial_below(visible, zbufrandi_exp(-mid), k) < probability) lo = mid;
        else hi = mid;
    }
    return area * hi;
}

/* ---- probabilities ---- */

static int zbufrandi_density_ok(double density, double visible, double block) {
    return density >= 0.0 && visible >= 0.0 && block >= 1.0 && zbufrandi_finite(visible) && zbufrandi_finite(block);
}

ZBUFRAND_DEF double zbufrand_success(double density, double visible, double block) {
    if (!zbufrandi_density_ok(density, visible, block)) return ZBUFRANDI_NAN;
    return zbufrandi_pow1m(zbufrandi_exp(-density * block * block), visible);
}

ZBUFRAND_DEF double zbufrand_success_bound(double density, double visible, double block) {
    double holes = zbufrand_expected_holes(density, visible, block);
    return holes >= 1.0 ? 0.0 : 1.0 - holes;
}

ZBUFRAND_DEF double zbufrand_expected_holes(double density, double visible, double block) {
    if (!zbufrandi_density_ok(density, visible, block)) return ZBUFRANDI_NAN;
    return visible * zbufrandi_exp(-density * block * block);
}

ZBUFRAND_DEF double zbufrand_holes_variance(double samples, double cells) {
    double u = samples / cells, e, r;
    if (!(cells > 0.0 && samples >= 0.0 && zbufrandi_finite(samples))) return ZBUFRANDI_NAN;
    e = zbufrandi_exp(-u);
    r = -zbufrandi_expm1(-u) - u * e;
    if (u < 0.1) { /* the same without cancellation: sum of (-u)^k (k-1) / k! from k = 2 */
        double term = 0.5 * u * u;
        int k;
        for (r = 0.0, k = 2; k < 12; k++) {
            r += term * (double)(k - 1);
            term *= -u / (double)(k + 1);
        }
    }
    return cells * e * r;
}

ZBUFRAND_DEF double zbufrand_holes_tail(double samples, double cells, double deviation) {
    double full, r; /* full: n - E */
    if (!(cells >= 1.0 && samples >= 0.0 && deviation >= 0.0 && zbufrandi_finite(cells))) return ZBUFRANDI_NAN;
    full = samples > 0.0 ? -cells * zbufrandi_expm1(samples * zbufrandi_log1p(-1.0 / cells)) : 0.0;
    if (!(full > 0.0)) return deviation > 0.0 ? 0.0 : 1.0;
    r = 2.0 * zbufrandi_exp(-(deviation / full) * deviation * ((cells - 0.5) / (2.0 * cells - full)));
    return r > 1.0 ? 1.0 : r;
}

ZBUFRAND_DEF double zbufrand_pixel_law(const double *area, size_t count, double density, double *probability) {
    double sum = 0.0, open = 1.0;
    size_t i, bad = 0;
    for (i = 0; i < count; i++) bad |= !(area[i] >= 0.0);
    if (bad != 0 || !(density >= 0.0)) {
        if (probability != NULL) for (i = 0; i < count; i++) probability[i] = ZBUFRANDI_NAN;
        return ZBUFRANDI_NAN;
    }
    for (i = 0; i < count; i++) {
        double u = area[i] > 0.0 ? density * area[i] : 0.0; /* 0 area of infinite density: nothing */
        if (probability != NULL) probability[i] = open * -zbufrandi_expm1(-u);
        sum += u;
        open = zbufrandi_exp(-sum);
    }
    return open;
}

ZBUFRAND_DEF double zbufrand_expected_pixel(const double *area, const double *value, size_t count, double density,
                                            double background, double *out_variance) {
    double mean = 0.0, variance = 0.0, sum, open = 1.0;
    size_t i;
    int pass, ok = density >= 0.0;
    for (pass = 0; pass < (out_variance != NULL ? 2 : 1); pass++) { /* about the background: the mean is without it */
        for (i = 0, sum = 0.0, open = 1.0; i < count && ok; i++) {
            double u = area[i] > 0.0 ? density * area[i] : 0.0, p = open * -zbufrandi_expm1(-u);
            double x = value[i] - background;
            ok = area[i] >= 0.0;
            if (pass == 0) mean += p * x;
            else variance += p * (x - mean) * (x - mean);
            sum += u;
            open = zbufrandi_exp(-sum);
        }
    }
    if (out_variance != NULL) *out_variance = ok ? variance + open * mean * mean : ZBUFRANDI_NAN;
    return ok ? background + mean : ZBUFRANDI_NAN;
}

ZBUFRAND_DEF double zbufrand_front_share(double coverage, double density) {
    if (!(coverage >= 0.0 && coverage <= 1.0 && density >= 0.0)) return ZBUFRANDI_NAN;
    if (density == 0.0 || coverage == 0.0) return coverage;
    return zbufrandi_expm1(-coverage * density) / zbufrandi_expm1(-density);
}

/* Depths in units of `range`: the front lies in [0, 1], the layers in [r, 1 + r], all evenly; r = gap/range. Below 1
   both are there and the first sample is a layer's with chance K/(K+1); beyond 1 only layers are left. */
ZBUFRAND_DEF double zbufrand_bleed(double density, double gap, double range, double layers) {
    double u = density, k = layers, r;
    if (!(density >= 0.0 && gap >= 0.0 && range >= 0.0 && layers >= 0.0)) return ZBUFRANDI_NAN;
    if (u == 0.0 || k == 0.0) return 0.0;
    r = gap < range ? gap / range : 1.0;
    return k / (k + 1.0) * zbufrandi_exp(-u * r) * -zbufrandi_expm1(-(k + 1.0) * u * (1.0 - r)) +
           zbufrandi_exp(-u - k * u * (1.0 - r)) * -zbufrandi_expm1(-k * u * r);
}

ZBUFRAND_DEF double zbufrand_block_spill(double density, double block, double distance) {
    if (!(density >= 0.0 && block >= 1.0 && distance >= 0.0)) return ZBUFRANDI_NAN;
    return distance >= 0.5 * block ? 0.0 : -zbufrandi_expm1(-density * block * (0.5 * block - distance));
}

ZBUFRAND_DEF double zbufrand_multi_hit(double samples, double pixels) {
    double l, u, r, q;
    if (!(samples >= 0.0 && pixels >= 1.0)) return ZBUFRANDI_NAN;
    if (!zbufrandi_finite(samples) || !zbufrandi_finite(pixels)) return ZBUFRANDI_NAN;
    if (samples <= 1.0) return 0.0;
    if (pixels == 1.0) return 1.0;
    l = zbufrandi_log1p(-1.0 / pixels);
    u = samples / pixels;
    if (u < 1e-3) { /* the difference below would cancel: chances of 2, 3, 4, 5 hits */
        q = 1.0 / (pixels - 1.0);
        r = 1.0 + (samples - 4.0) * q / 5.0;
        r = 1.0 + (samples - 3.0) * q / 4.0 * r;
        r = 1.0 + (samples - 2.0) * q / 3.0 * r;
        return 0.5 * u * ((samples - 1.0) / pixels) * zbufrandi_exp((samples - 2.0) * l) * r;
    }
    return -zbufrandi_expm1(samples * l) - u * zbufrandi_exp((samples - 1.0) * l);
}

ZBUFRAND_DEF double zbufrand_empty_bound(double expected, double strata) {
    if (!(expected >= 0.0 && strata >= expected)) return ZBUFRANDI_NAN;
    if (expected == 0.0) return 1.0;
    if (strata == ZBUFRANDI_INFINITY) return zbufrandi_exp(-expected);
    return zbufrandi_pow1m(expected / strata, strata);
}

ZBUFRAND_DEF double zbufrand_thinned_dispersion(double dispersion, double accepted) {
    if (!(dispersion >= 0.0 && accepted >= 0.0 && accepted <= 1.0)) return ZBUFRANDI_NAN;
    return accepted * dispersion + 1.0 - accepted;
}

ZBUFRAND_DEF double zbufrand_smoothing_frames(double epsilon) {
    return epsilon > 0.0 && epsilon <= 1.0 ? (2.0 - epsilon) / epsilon : ZBUFRANDI_NAN;
}

ZBUFRAND_DEF double zbufrand_block_time(double project, double paint, double area, double visible, double block) {
    if (!zbufrandi_area_ok(area, visible, block) || !(project >= 0.0 && paint >= 0.0)) return ZBUFRANDI_NAN;
    if (!(visible > block * block)) return ZBUFRANDI_NAN;
    return (project / (block * block) + paint) * area * zbufrandi_log(visible / (block * block));
}

/* ---------------------------------------------------------------------------
   shade: numbers of samples that are seen -> surfaces -> colours.               // >>shade

   number / 64 is a block, which belongs to a draw; what is left says which stored sample, sample of a cluster or
   triangle it was. Surfaces of triangles are taken where the ray through the centre of the pixel meets them, or as near
   to that as the triangle reaches.
   --------------------------------------------------------------------------- */

enum { ZBUFRANDI_SHADE_RUN = 64 };

typedef struct zbufrandi_look { /* how surfaces become colours; lights in camera coordinates */
    float ambient[3], background[4];
    uint8_t background8[4];
    float (*light)[6];         /* direction, or place; colour */
    const uint8_t *directional;
    uint32_t light_count;
    int unlit, transparent;
    zbufrand_shade_fn *shade_fn;
    void *shade_user;
} zbufrandi_look;

typedef struct zbufrandi_ray_seen { /* what the ray through a pixel hit */
    float depth;
    uint32_t local, cluster, triangle; /* triangle of the cluster */
} zbufrandi_ray_seen;

typedef struct zbufrandi_drawn { /* all that was drawn for a picture */
    const zbufrand_scene *scene;
    const zbufrandi_camera *camera; /* of the keys: with the guard band */
    const zbufrandi_draw *draw;
    const zbufrandi_local *local;
    const uint32_t *block_draw;     /* draw of each block */
    const uint8_t *aux;
    const zbufrandi_ray_seen *seen; /* hits of rays */
    const zbufrand_points *points;
    uint32_t first_block;           /* numbers begin there, modulo 2^26 */
    const zbufrandi_srgb *srgb;
    int need_places;                /* zbufrandi_look_at.p is wanted */
    uint32_t stand_in;              /* local stand_in + i is there for what is below dummies: structure i, no more */
    int level;                      /* instruction set */
} zbufrandi_drawn;

typedef struct zbufrandi_look_at { /* a surface as it is found */
    float normal[3];           /* camera, unit, of the side that is seen */
    float face[3];             /* the same of the surface itself: any length, not turned */
    float p[3];                /* camera */
    float rgb[3];
    uint32_t material, cluster, triangle, local; /* cluster ~0: a stored point */
} zbufrandi_look_at;

/* A power of two that brings the largest component of v to about 1: squares are in the range of floats then, and
   quotients keep their bits. */
ZBUFRANDI_INLINE float zbufrandi_tame(const float v[3]) {
    float most = zbufrandi_absf(v[0]), unit;
    uint32_t bits;
    most = zbufrandi_absf(v[1]) > most ? zbufrandi_absf(v[1]) : most;
    most = zbufrandi_absf(v[2]) > most ? zbufrandi_absf(v[2]) : most;
    memcpy(&bits, &most, sizeof bits);
    bits &= 0x7f800000u;
    bits = 0x7f000000u - (bits < 0x7e800000u ? bits : 0x7e800000u);
    memcpy(&unit, &bits, sizeof unit);
    return unit;
}

/* Unit, of the side that is seen. The surface decides which that is: a smooth normal may look away from the eye. */
static void zbufrandi_turn_normal(float n[3], const float face[3], const float ray[3]) {
    const float d = face[0] * ray[0] + face[1] * ray[1] + face[2] * ray[2], unit = zbufrandi_tame(n);
    float l;
    n[0] = n[0] * unit;
    n[1] = n[1] * unit;
    n[2] = n[2] * unit;
    l = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    l = l > 0.0f ? 1.0f / sqrtf(l) : 0.0f;
    if (d > 0.0f) l = 0.0f - l;
    n[0] = n[0] * l;
    n[1] = n[1] * l;
    n[2] = n[2] * l;
}

ZBUFRANDI_INLINE void zbufrandi_camera_vector(const zbufrandi_local *l, const float v[3], float out[3]) {
    int a;
    for (a = 0; a < 3; a++) out[a] = l->m[a][0] * v[0] + l->m[a][1] * v[1] + l->m[a][2] * v[2];
}

static void zbufrandi_stored_surface(const zbufrandi_drawn *s, const zbufrandi_draw *d, uint32_t i, const float ray[3],
                                     zbufrandi_look_at *out) {
    const zbufrandi_local *l = &s->local[d->local];
    const zbufrandi_structure *structure = &s->scene->structure[l->structure];
    const size_t at = (size_t)(d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)) * ZBUFRANDI_SET + i;
    const uint32_t *word = structure->set + zbufrandi_set_at(at);
    float v[3], q[3];
    uint32_t a, rgb;
    if (s->need_places) {
        q[0] = (float)(int32_t)(word[0] & 2047u);
        q[1] = (float)(int32_t)(word[0] >> 11 & 1023u);
        q[2] = (float)(int32_t)(word[0] >> 21 & 1023u);
        for (a = 0; a < 3; a++) q[a] = (d->lo[a] - l->eye[a]) + (q[a] + 0.5f) * d->step[a];
        zbufrandi_camera_vector(l, q, out->p);
        for (a = 0; a < 3; a++) out->p[a] += l->rest[a];
    }
    zbufrandi_oct32_vector(word[8], v);
    zbufrandi_camera_vector(l, v, out->face);
    if (structure->set_normal != NULL) {
        zbufrandi_oct_decode(structure->set_normal[at], v);
        zbufrandi_camera_vector(l, v, out->normal);
    } else {
        memcpy(out->normal, out->face, sizeof out->normal);
    }
    zbufrandi_turn_normal(out->normal, out->face, ray);
    if (structure->set_rgb != NULL) {
        rgb = structure->set_rgb[at];
        for (a = 0; a < 3; a++) out->rgb[a] = s->srgb->linear[rgb >> 8 * a & 255u];
    } else {
        out->rgb[0] = out->rgb[1] = out->rgb[2] = 1.0f;
    }
    out->material = structure->set_material != NULL ? structure->set_material[at] : structure->material;
    out->cluster = out->triangle = ~0u;
    out->local = d->local;
}

/* Where `ray` (camera) meets the plane of a triangle with corner b (seen from the eye) and edges e, which are
   times unit, and normal n: weights of its corners, moved into the triangle. */
static void zbufrandi_triangle_weights(const zbufrandi_local *l, const float ray[3], const float b[3],
                                       const float (*e)[3], float unit,
                                       const float n[3], float w[3]) {
    float r[3], h[3], t, sum;
    uint32_t a;
    for (a = 0; a < 3; a++) r[a] = l->m[0][a] * ray[0] + l->m[1][a] * ray[1] + l->m[2][a] * ray[2];
    t = (n[0] * b[0] + n[1] * b[1] + n[2] * b[2]) / (n[0] * r[0] + n[1] * r[1] + n[2] * r[2]);
    for (a = 0; a < 3; a++) h[a] = (r[a] * t - b[a]) * unit; /* from corner 0 to the point on the plane */
    sum = 1.0f / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    /* weights of corners 1 and 2: ((h x e1) . n, (e0 x h) . n) / n . n */
    w[1] = ((h[1] * e[1][2] - h[2] * e[1][1]) * n[0] + (h[2] * e[1][0] - h[0] * e[1][2]) * n[1] +
            (h[0] * e[1][1] - h[1] * e[1][0]) * n[2]) * sum;
    w[2] = ((e[0][1] * h[2] - e[0][2] * h[1]) * n[0] + (e[0][2] * h[0] - e[0][0] * h[2]) * n[1] +
            (e[0][0] * h[1] - e[0][1] * h[0]) * n[2]) * sum;
    w[0] = 1.0f - w[1] - w[2];
    for (a = 0, sum = 0.0f; a < 3; a++) {
        w[a] = w[a] > 0.0f ? w[a] : 0.0f; /* NaN, of a triangle seen edge-on, too */
        w[a] = w[a] < 1.0f ? w[a] : 1.0f;
        sum += w[a];
    }
    if (!(sum > 0.0f)) w[0] = sum = 1.0f;
    sum = 1.0f / sum;
    for (a = 0; a < 3; a++) w[a] = w[a] * sum;
}

/* Colour and names of triangle t of a cluster; w: weights of its corners, read only for colours of vertices. */
ZBUFRANDI_INLINE void zbufrandi_triangle_look(const zbufrandi_drawn *s, uint32_t local, uint32_t cluster, uint32_t t,
                                              const float w[3], zbufrandi_look_at *out) {
    const zbufrandi_structure *structure = &s->scene->structure[s->local[local].structure];
    const zbufrandi_cluster *c = &structure->cluster[cluster];
    uint32_t a, k;
    out->rgb[0] = out->rgb[1] = out->rgb[2] = 1.0f;
    if (c->flags & ZBUFRANDI_HAS_TRIANGLE_RGB) {
        const uint8_t *rgb = structure->triangle_rgb + 3 * ((size_t)c->first_triangle + t);
        for (a = 0; a < 3; a++) out->rgb[a] = s->srgb->linear[rgb[a]];
    } else if (c->flags & ZBUFRANDI_HAS_VERTEX_RGB) {
        const uint8_t *tri = structure->triangle + 3 * ((size_t)c->first_triangle + t);
        for (a = 0; a < 3; a++) out->rgb[a] = 0.0f;
        for (k = 0; k < 3; k++) {
            const uint8_t *rgb = structure->vertex_rgb + 3 * ((size_t)c->first_vertex + tri[k]);
            for (a = 0; a < 3; a++) out->rgb[a] += s->srgb->linear[rgb[a]] * w[k];
        }
    }
    out->material = s->scene->mesh[c->mesh].m.material;
    out->cluster = cluster;
    out->triangle = t;
    out->local = local;
}

/* Triangle t of a cluster where `ray` meets it, or as near to that as it reaches. */
static void zbufrandi_triangle_surface(const zbufrandi_drawn *s, uint32_t local, uint32_t cluster, uint32_t t,
                                       const float ray[3],
                                       zbufrandi_look_at *out) {
    const zbufrandi_local *l = &s->local[local];
    const zbufrandi_structure *structure = &s->scene->structure[l->structure];
    const zbufrandi_cluster *c = &structure->cluster[cluster];
    const uint8_t *tri = structure->triangle + 3 * ((size_t)c->first_triangle + t);
    const float *v[3];
    float e[2][3], f[2][3], n[3], w[3] = {0.0f, 0.0f, 0.0f}, b[3], g[3], unit;
    uint32_t k, a;
    for (k = 0; k < 3; k++) v[k] = structure->position + 3 * ((size_t)c->first_vertex + tri[k]);
    for (a = 0; a < 3; a++) {
        e[0][a] = v[1][a] - v[0][a];
        e[1][a] = v[2][a] - v[0][a];
        g[a] = zbufrandi_absf(e[0][a]) > zbufrandi_absf(e[1][a]) ? e[0][a] : e[1][a];
    }
    unit = zbufrandi_tame(g);
    for (a = 0; a < 3; a++) {
        f[0][a] = e[0][a] * unit;
        f[1][a] = e[1][a] * unit;
    }
    n[0] = f[0][1] * f[1][2] - f[0][2] * f[1][1];
    n[1] = f[0][2] * f[1][0] - f[0][0] * f[1][2];
    n[2] = f[0][0] * f[1][1] - f[0][1] * f[1][0];
    if (s->need_places || (c->flags & (ZBUFRANDI_HAS_NORMALS | ZBUFRANDI_HAS_VERTEX_RGB)) != 0) {
        for (a = 0; a < 3; a++) b[a] = (v[0][a] - l->eye[a]) - l->eye_low[a];
        zbufrandi_triangle_weights(l, ray, b, (const float (*)[3])f, unit, n, w);
        if (s->need_places) {
            for (a = 0; a < 3; a++) g[a] = b[a] + e[0][a] * w[1] + e[1][a] * w[2];
            zbufrandi_camera_vector(l, g, out->p);
        }
    }
    zbufrandi_camera_vector(l, n, out->face);
    if (c->flags & ZBUFRANDI_HAS_NORMALS) {
        zbufrandi_point_normal(structure, c, t, w, n);
        zbufrandi_camera_vector(l, n, out->normal);
    } else {
        memcpy(out->normal, out->face, sizeof out->normal);
    }
    zbufrandi_turn_normal(out->normal, out->face, ray);
    zbufrandi_triangle_look(s, local, cluster, t, w, out);
}

static void zbufrandi_point_surface(const zbufrandi_drawn *s, const zbufrandi_draw *d, uint32_t i, const float ray[3],
                                    zbufrandi_look_at *out) {
    const zbufrand_points *p = &s->points[d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)];
    const zbufrandi_camera *c = s->camera;
    float f[3];
    double q[3];
    uint32_t a;
    memcpy(f, (const uint8_t *)p->positions + (size_t)i * (p->position_stride != 0 ? p->position_stride : 12),
           sizeof f);
    for (a = 0; a < 3; a++) q[a] = (double)f[a] - c->eye[a];
    out->p[0] = (float)(q[0] * c->right[0] + q[1] * c->right[1] + q[2] * c->right[2]);
    out->p[1] = (float)(q[0] * c->up[0] + q[1] * c->up[1] + q[2] * c->up[2]);
    out->p[2] = (float)(q[0] * c->dir[0] + q[1] * c->dir[1] + q[2] * c->dir[2]);
    for (a = 0; a < 3; a++) out->normal[a] = ray[a];
    if (p->normals != NULL) {
        memcpy(f, (const uint8_t *)p->normals + (size_t)i * (p->normal_stride != 0 ? p->normal_stride : 12), sizeof f);
        for (a = 0; a < 3; a++) q[a] = (double)f[a];
        out->normal[0] = (float)(q[0] * c->right[0] + q[1] * c->right[1] + q[2] * c->right[2]);
        out->normal[1] = (float)(q[0] * c->up[0] + q[1] * c->up[1] + q[2] * c->up[2]);
        out->normal[2] = (float)(q[0] * c->dir[0] + q[1] * c->dir[1] + q[2] * c->dir[2]);
    }
    memcpy(out->face, out->normal, sizeof out->face);
    zbufrandi_turn_normal(out->normal, out->face, ray);
    out->rgb[0] = out->rgb[1] = out->rgb[2] = 1.0f;
    for (a = 0; a < 3 && p->rgb != NULL; a++) {
        out->rgb[a] = s->srgb->linear[p->rgb[(size_t)i * (p->rgb_stride != 0 ? p->rgb_stride : 3) + a]];
    }
    out->material = 0;
    out->cluster = out->triangle = ~0u;
    out->local = ~0u;
}

/* Sample or triangle i of a draw from a list. */
static void zbufrandi_listed_surface(const zbufrandi_drawn *s, const zbufrandi_draw *d, uint32_t i, const float ray[3],
                                     zbufrandi_look_at *out) {
    const zbufrandi_local *from = &s->local[d->local];
    zbufrandi_list_spot at;
    zbufrandi_local own;
    zbufrandi_drawn there;
    if (d->item >> ZBUFRANDI_DRAW_SHIFT == ZBUFRANDI_DRAW_LISTED_RASTER) {
        const uint32_t first = d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u);
        const uint32_t item = s->scene->structure[from->structure].lists->object[first + i];
        zbufrandi_triangle_surface(s, d->local, item >> 7, item & 127u, ray, out);
        return;
    }
    zbufrandi_list_find(s->scene, from, d, i, &at);
    if (at.structure == from->structure && at.scale == (double)from->scale) {
        zbufrandi_triangle_surface(s, d->local, at.item >> 7, at.item & 127u, ray, out);
        return;
    }
    memset(&own, 0, sizeof own);
    memcpy(own.to_camera, at.m, sizeof own.to_camera);
    own.scale = (float)at.scale;
    own.structure = at.structure;
    zbufrandi_local_finish(&own);
    there = *s;
    there.local = &own;
    zbufrandi_triangle_surface(&there, 0, at.item >> 7, at.item & 127u, ray, out);
    out->local = s->stand_in + at.structure;
}

typedef struct zbufrandi_found { /* a number looked up */
    const zbufrandi_draw *draw;
    uint32_t kind, i;          /* i: of the sample or triangle within the draw */
    uint32_t local, cluster, triangle; /* of what is a triangle */
} zbufrandi_found;

#if ZBUFRANDI_AVX2
typedef struct zbufrandi_shade8 { /* eight triangles, a lane each */
    float m[9][8], eye[3][8], low[3][8], v[9][8], ray[3][8];
    uint32_t code[3][8], smooth[8];             /* normals of the vertices; all ones: there are some */
    float normal[3][8], face[3][8], p[3][8], w[3][8];
} zbufrandi_shade8;

/* zbufrandi_oct_decode, times a weight. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_oct_add8(const uint32_t code[8], __m256 w, __m256 n[3]) {
    const __m256 sign = _mm256_set1_ps(-0.0f), one = _mm256_set1_ps(1.0f), step = _mm256_set1_ps(2.0f / 255.0f);
    const __m256i c = _mm256_loadu_si256((const __m256i *)(const void *)code);
    __m256 x = _mm256_sub_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_and_si256(c, _mm256_set1_epi32(255))), step), one);
    __m256 y = _mm256_sub_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(c, 8)), step), one);
    const __m256 ax = _mm256_andnot_ps(sign, x), ay = _mm256_andnot_ps(sign, y);
    const __m256 z = _mm256_sub_ps(_mm256_sub_ps(one, ax), ay);
    __m256 l = _mm256_or_ps(one, _mm256_and_ps(sign, _mm256_cmp_ps(x, _mm256_setzero_ps(), _CMP_LT_OQ)));
    x = _mm256_blendv_ps(x, _mm256_mul_ps(_mm256_sub_ps(one, ay), l), z);
    l = _mm256_or_ps(one, _mm256_and_ps(sign, _mm256_cmp_ps(y, _mm256_setzero_ps(), _CMP_LT_OQ)));
    y = _mm256_blendv_ps(y, _mm256_mul_ps(_mm256_sub_ps(one, ax), l), z);
    l = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(x, x), _mm256_mul_ps(y, y)), _mm256_mul_ps(z, z));
    l = _mm256_div_ps(one, _mm256_sqrt_ps(l));
    n[0] = _mm256_add_ps(n[0], _mm256_mul_ps(_mm256_mul_ps(x, l), w));
    n[1] = _mm256_add_ps(n[1], _mm256_mul_ps(_mm256_mul_ps(y, l), w));
    n[2] = _mm256_add_ps(n[2], _mm256_mul_ps(_mm256_mul_ps(z, l), w));
}

ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_dot8v(__m256 ax, __m256 ay, __m256 az, __m256 bx, __m256 by,
                                                              __m256 bz) {
    return _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(ax, bx), _mm256_mul_ps(ay, by)), _mm256_mul_ps(az, bz));
}

/* zbufrandi_tame, of the largest component. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE __m256 zbufrandi_tame8(__m256 most) {
    const __m256i bits = _mm256_and_si256(_mm256_castps_si256(most), _mm256_set1_epi32(0x7f800000));
    return _mm256_castsi256_ps(_mm256_sub_epi32(_mm256_set1_epi32(0x7f000000),
                                                _mm256_min_epi32(bits, _mm256_set1_epi32(0x7e800000))));
}

/* The operations of zbufrandi_triangle_surface and what it calls, one for one. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_shade_eight(zbufrandi_shade8 *s) {
    const __m256 zero = _mm256_setzero_ps(), one = _mm256_set1_ps(1.0f), sign = _mm256_set1_ps(-0.0f);
    __m256 m[9], e0[3], e1[3], f0[3], f1[3], n[3], b[3], r[3], h[3], w[3], ray[3], t, sum, l, unit = zero;
    int a;
    for (a = 0; a < 9; a++) m[a] = _mm256_loadu_ps(s->m[a]);
    for (a = 0; a < 3; a++) {
        const __m256 v0 = _mm256_loadu_ps(s->v[a]);
        ray[a] = _mm256_loadu_ps(s->ray[a]);
        e0[a] = _mm256_sub_ps(_mm256_loadu_ps(s->v[3 + a]), v0);
        e1[a] = _mm256_sub_ps(_mm256_loadu_ps(s->v[6 + a]), v0);
        b[a] = _mm256_sub_ps(_mm256_sub_ps(v0, _mm256_loadu_ps(s->eye[a])), _mm256_loadu_ps(s->low[a]));
        unit = _mm256_max_ps(_mm256_max_ps(_mm256_andnot_ps(sign, e0[a]), _mm256_andnot_ps(sign, e1[a])), unit);
    }
    unit = zbufrandi_tame8(unit);
    for (a = 0; a < 3; a++) {
        f0[a] = _mm256_mul_ps(e0[a], unit);
        f1[a] = _mm256_mul_ps(e1[a], unit);
    }
    n[0] = _mm256_sub_ps(_mm256_mul_ps(f0[1], f1[2]), _mm256_mul_ps(f0[2], f1[1]));
    n[1] = _mm256_sub_ps(_mm256_mul_ps(f0[2], f1[0]), _mm256_mul_ps(f0[0], f1[2]));
    n[2] = _mm256_sub_ps(_mm256_mul_ps(f0[0], f1[1]), _mm256_mul_ps(f0[1], f1[0]));
    for (a = 0; a < 3; a++) r[a] = zbufrandi_dot8v(m[a], m[3 + a], m[6 + a], ray[0], ray[1], ray[2]);
    t = _mm256_div_ps(zbufrandi_dot8v(n[0], n[1], n[2], b[0], b[1], b[2]),
                      zbufrandi_dot8v(n[0], n[1], n[2], r[0], r[1], r[2]));
    for (a = 0; a < 3; a++) h[a] = _mm256_mul_ps(_mm256_sub_ps(_mm256_mul_ps(r[a], t), b[a]), unit);
    sum = _mm256_div_ps(one, zbufrandi_dot8v(n[0], n[1], n[2], n[0], n[1], n[2]));
    w[1] = zbufrandi_dot8v(_mm256_sub_ps(_mm256_mul_ps(h[1], f1[2]), _mm256_mul_ps(h[2], f1[1])),
                           _mm256_sub_ps(_mm256_mul_ps(h[2], f1[0]), _mm256_mul_ps(h[0], f1[2])),
                           _mm256_sub_ps(_mm256_mul_ps(h[0], f1[1]), _mm256_mul_ps(h[1], f1[0])), n[0], n[1], n[2]);
    w[2] = zbufrandi_dot8v(_mm256_sub_ps(_mm256_mul_ps(f0[1], h[2]), _mm256_mul_ps(f0[2], h[1])),
                           _mm256_sub_ps(_mm256_mul_ps(f0[2], h[0]), _mm256_mul_ps(f0[0], h[2])),
                           _mm256_sub_ps(_mm256_mul_ps(f0[0], h[1]), _mm256_mul_ps(f0[1], h[0])), n[0], n[1], n[2]);
    w[1] = _mm256_mul_ps(w[1], sum);
    w[2] = _mm256_mul_ps(w[2], sum);
    w[0] = _mm256_sub_ps(_mm256_sub_ps(one, w[1]), w[2]);
    for (a = 0, sum = zero; a < 3; a++) {
        w[a] = _mm256_min_ps(_mm256_max_ps(w[a], zero), one); /* the second one if the first is NaN */
        sum = _mm256_add_ps(sum, w[a]);
    }
    l = _mm256_cmp_ps(sum, zero, _CMP_GT_OQ);
    w[0] = _mm256_blendv_ps(one, w[0], l);
    sum = _mm256_div_ps(one, _mm256_blendv_ps(one, sum, l));
    for (a = 0; a < 3; a++) {
        w[a] = _mm256_mul_ps(w[a], sum);
        _mm256_storeu_ps(s->w[a], w[a]);
    }
    for (a = 0; a < 3; a++) {
        h[a] = _mm256_add_ps(_mm256_add_ps(b[a], _mm256_mul_ps(e0[a], w[1])), _mm256_mul_ps(e1[a], w[2]));
        r[a] = zbufrandi_dot8v(m[3 * a], m[3 * a + 1], m[3 * a + 2], n[0], n[1], n[2]);
        _mm256_storeu_ps(s->face[a], r[a]);
    }
    for (a = 0; a < 3; a++) {
        _mm256_storeu_ps(s->p[a], zbufrandi_dot8v(m[3 * a], m[3 * a + 1], m[3 * a + 2], h[0], h[1], h[2]));
    }
    t = zbufrandi_dot8v(r[0], r[1], r[2], ray[0], ray[1], ray[2]);
    l = _mm256_loadu_ps((const float *)(const void *)s->smooth);
    if (_mm256_movemask_ps(l) != 0) {
        n[0] = n[1] = n[2] = zero;
        for (a = 0; a < 3; a++) zbufrandi_oct_add8(s->code[a], w[a], n);
        for (a = 0; a < 3; a++) {
            h[a] = zbufrandi_dot8v(m[3 * a], m[3 * a + 1], m[3 * a + 2], n[0], n[1], n[2]);
            r[a] = _mm256_blendv_ps(r[a], h[a], l);
        }
    }
    l = _mm256_max_ps(_mm256_andnot_ps(sign, r[1]), _mm256_andnot_ps(sign, r[0])); /* zbufrandi_turn_normal */
    unit = zbufrandi_tame8(_mm256_max_ps(_mm256_andnot_ps(sign, r[2]), l));
    for (a = 0; a < 3; a++) r[a] = _mm256_mul_ps(r[a], unit);
    l = zbufrandi_dot8v(r[0], r[1], r[2], r[0], r[1], r[2]);
    l = _mm256_and_ps(_mm256_cmp_ps(l, zero, _CMP_GT_OQ), _mm256_div_ps(one, _mm256_sqrt_ps(l)));
    l = _mm256_blendv_ps(l, _mm256_sub_ps(zero, l), _mm256_cmp_ps(t, zero, _CMP_GT_OQ));
    for (a = 0; a < 3; a++) _mm256_storeu_ps(s->normal[a], _mm256_mul_ps(r[a], l));
}

/* Surfaces of count <= 8 triangles, found[at[i]], seen along rays[at[i]]. */
static void zbufrandi_triangle_surfaces(const zbufrandi_drawn *s, const zbufrandi_found *found,
                                        const float (*rays)[3], const uint8_t *at, uint32_t count,
                                        zbufrandi_look_at *out) {
    zbufrandi_shade8 e;
    uint32_t i, k, a;
    for (i = 0; i < 8; i++) {
        const zbufrandi_found *f = &found[at[i < count ? i : 0]];
        const float *ray = rays[at[i < count ? i : 0]];
        const zbufrandi_local *l = &s->local[f->local];
        const zbufrandi_structure *structure = &s->scene->structure[l->structure];
        const zbufrandi_cluster *c = &structure->cluster[f->cluster];
        const uint8_t *tri = structure->triangle + 3 * ((size_t)c->first_triangle + f->triangle);
        const int smooth = (c->flags & ZBUFRANDI_HAS_NORMALS) != 0;
        e.smooth[i] = smooth ? ~0u : 0u;
        for (a = 0; a < 3; a++) {
            const size_t vertex = (size_t)c->first_vertex + tri[a];
            const float *v = structure->position + 3 * vertex;
            for (k = 0; k < 3; k++) {
                e.m[3 * a + k][i] = l->m[a][k];
                e.v[3 * a + k][i] = v[k];
            }
            e.eye[a][i] = l->eye[a];
            e.low[a][i] = l->eye_low[a];
            e.ray[a][i] = ray[a];
            e.code[a][i] = smooth ? structure->vertex_normal[vertex] : 0u;
        }
    }
    zbufrandi_shade_eight(&e);
    for (i = 0; i < count; i++) {
        const zbufrandi_found *f = &found[at[i]];
        zbufrandi_look_at *o = &out[at[i]];
        float w[3];
        for (a = 0; a < 3; a++) {
            o->normal[a] = e.normal[a][i];
            o->face[a] = e.face[a][i];
            o->p[a] = e.p[a][i];
            w[a] = e.w[a][i];
        }
        zbufrandi_triangle_look(s, f->local, f->cluster, f->triangle, w, o);
    }
}
#endif

/* Numbers of samples -> their surfaces. rays: directions of the centres of the pixels they are shown in, z = 1. In
   steps, each of which asks for the memory that the next one reads. count <= ZBUFRANDI_SHADE_RUN. */
static void zbufrandi_find_surfaces(const zbufrandi_drawn *s, const uint32_t *numbers, const float (*rays)[3],
                                    uint32_t count,
                                    zbufrandi_look_at *out) {
    zbufrandi_found found[ZBUFRANDI_SHADE_RUN];
    const uint32_t mask = (1u << ZBUFRANDI_DRAW_SHIFT) - 1u;
    uint8_t triangles[ZBUFRANDI_SHADE_RUN];
    uint32_t k, n = 0;
    for (k = 0; k < count; k++) {
        const uint32_t block = ((numbers[k] >> 6) - s->first_block) & 0x3ffffffu;
        found[k].draw = &s->draw[s->block_draw[block]];
        found[k].i = block;
        ZBUFRANDI_PREFETCH(found[k].draw);
    }
    for (k = 0; k < count; k++) {
        zbufrandi_found *f = &found[k];
        const zbufrandi_draw *d = f->draw;
        f->i = ((f->i - d->block) << 6) + (numbers[k] & 63u);
        f->kind = d->item >> ZBUFRANDI_DRAW_SHIFT;
        f->local = d->local;
        f->cluster = d->item & mask;
        if (f->kind == ZBUFRANDI_DRAW_SAMPLED) ZBUFRANDI_PREFETCH(&s->aux[(size_t)d->aux * ZBUFRANDI_SET + f->i]);
        if (f->kind == ZBUFRANDI_DRAW_RAYS) {
            const zbufrandi_ray_seen *seen = &s->seen[f->cluster + f->i];
            f->local = seen->local;
            f->cluster = seen->cluster;
            f->triangle = seen->triangle;
        }
        if (f->kind < ZBUFRANDI_DRAW_POINTS) ZBUFRANDI_PREFETCH(&s->local[f->local]);
    }
    for (k = 0; k < count; k++) {
        zbufrandi_found *f = &found[k];
        const zbufrandi_structure *structure;
        if (f->kind >= ZBUFRANDI_DRAW_POINTS) continue;
        structure = &s->scene->structure[s->local[f->local].structure];
        if (f->kind == ZBUFRANDI_DRAW_STORED) {
            const size_t at = (size_t)f->cluster * ZBUFRANDI_SET + f->i;
            ZBUFRANDI_PREFETCH(&structure->set[zbufrandi_set_at(at)]);
            if (structure->set_normal != NULL) ZBUFRANDI_PREFETCH(&structure->set_normal[at]);
            if (structure->set_rgb != NULL) ZBUFRANDI_PREFETCH(&structure->set_rgb[at]);
        } else {
            if (f->kind == ZBUFRANDI_DRAW_SAMPLED) f->triangle = s->aux[(size_t)f->draw->aux * ZBUFRANDI_SET + f->i];
            if (f->kind == ZBUFRANDI_DRAW_RASTERED) f->triangle = f->i;
            ZBUFRANDI_PREFETCH(&structure->cluster[f->cluster]);
        }
    }
    for (k = 0; k < count; k++) {
        const zbufrandi_found *f = &found[k];
        const zbufrandi_structure *structure;
        if (f->kind >= ZBUFRANDI_DRAW_POINTS || f->kind == ZBUFRANDI_DRAW_STORED) continue;
        structure = &s->scene->structure[s->local[f->local].structure];
        ZBUFRANDI_PREFETCH(structure->triangle + 3 *
                           ((size_t)structure->cluster[f->cluster].first_triangle + f->triangle));
    }
    for (k = 0; k < count; k++) {
        const zbufrandi_found *f = &found[k];
        const zbufrandi_structure *structure;
        const zbufrandi_cluster *c;
        const uint8_t *tri;
        uint32_t a;
        if (f->kind >= ZBUFRANDI_DRAW_POINTS || f->kind == ZBUFRANDI_DRAW_STORED) continue;
        structure = &s->scene->structure[s->local[f->local].structure];
        c = &structure->cluster[f->cluster];
        tri = structure->triangle + 3 * ((size_t)c->first_triangle + f->triangle);
        for (a = 0; a < 3; a++) ZBUFRANDI_PREFETCH(structure->position + 3 * ((size_t)c->first_vertex + tri[a]));
    }
    for (k = 0; k < count; k++) {
        const zbufrandi_found *f = &found[k];
        if (f->kind == ZBUFRANDI_DRAW_STORED) zbufrandi_stored_surface(s, f->draw, f->i, rays[k], &out[k]);
        else if (f->kind >= ZBUFRANDI_DRAW_LISTED) zbufrandi_listed_surface(s, f->draw, f->i, rays[k], &out[k]);
        else if (f->kind == ZBUFRANDI_DRAW_POINTS)
            zbufrandi_point_surface(s, f->draw, f->draw->hash + f->i, rays[k], &out[k]);
#if ZBUFRANDI_AVX2
        else if (s->level >= 3) triangles[n++] = (uint8_t)k;
#endif
        else zbufrandi_triangle_surface(s, f->local, f->cluster, f->triangle, rays[k], &out[k]);
    }
#if ZBUFRANDI_AVX2
    for (k = 0; k < n; k += 8)
        zbufrandi_triangle_surfaces(s, found, rays, triangles + k, n - k < 8 ? n - k : 8, out);
#else
    (void)n;
    (void)triangles;
#endif
}

/* Lambert, or no light at all. */
static void zbufrandi_look_shade(const zbufrandi_look *look, const zbufrandi_look_at *s, float rgba[4]) {
    float bright[3];
    uint32_t i, a;
    rgba[3] = 1.0f;
    if (look->unlit) {
        memcpy(rgba, s->rgb, sizeof s->rgb);
        return;
    }
    memcpy(bright, look->ambient, sizeof bright);
    for (i = 0; i < look->light_count; i++) {
        const float *l = look->light[i];
        float to[3], c;
        for (a = 0; a < 3; a++) to[a] = l[a] - (look->directional[i] ? 0.0f : s->p[a]);
        if (!look->directional[i]) {
            const float unit = zbufrandi_tame(to);
            for (a = 0; a < 3; a++) to[a] *= unit;
        }
        c = s->normal[0] * to[0] + s->normal[1] * to[1] + s->normal[2] * to[2];
        if (!(c > 0.0f)) continue;
        if (!look->directional[i]) c = c / sqrtf(to[0] * to[0] + to[1] * to[1] + to[2] * to[2]);
        for (a = 0; a < 3; a++) bright[a] += l[3 + a] * c;
    }
    for (a = 0; a < 3; a++) rgba[a] = s->rgb[a] * bright[a];
}

/* Mesh of a surface, as a node of the graph; 0: a stored point or one of a cloud. */
static uint32_t zbufrandi_surface_node(const zbufrandi_drawn *s, const zbufrandi_look_at *in) {
    const zbufrandi_structure *structure;
    if (in->cluster == ~0u) return 0;
    structure = &s->scene->structure[s->local[in->local].structure];
    return s->scene->mesh[structure->cluster[in->cluster].mesh].node;
}

/* For the caller's own shading. */
static void zbufrandi_public_surface(const zbufrandi_drawn *s, const zbufrandi_look_at *in, float depth, uint32_t pixel,
                                     zbufrand_surface *out) {
    const zbufrandi_camera *c = s->camera;
    uint32_t a;
    memset(out, 0, sizeof *out);
    for (a = 0; a < 3; a++) {
        out->position[a] = c->eye[a] + (double)in->p[0] * c->right[a] + (double)in->p[1] * c->up[a] +
            (double)in->p[2] * c->dir[a];
        out->normal[a] = (float)((double)in->normal[0] * c->right[a] + (double)in->normal[1] * c->up[a] +
                                 (double)in->normal[2] * c->dir[a]);
        out->rgb[a] = in->rgb[a];
    }
    out->depth = depth;
    out->pixel = pixel;
    out->material = in->material;
    out->triangle = ~0u;
    if (in->cluster != ~0u) {
        const zbufrandi_structure *structure = &s->scene->structure[s->local[in->local].structure];
        const zbufrandi_cluster *cluster = &structure->cluster[in->cluster];
        out->node = zbufrandi_surface_node(s, in);
        if (structure->triangle_id != NULL)
            out->triangle = structure->triangle_id[cluster->first_triangle + in->triangle];
    }
}

/* ---------------------------------------------------------------------------
   render: cameras; the frame object; from a view to a picture.                  // >>render

   Rounds of select and draw until the frontier is empty, each task and each draw by a fixed rule; rays for what is
   empty or suspicious; colours for what is seen; reconstruction.
   --------------------------------------------------------------------------- */

static int zbufrandi_scene_rays(zbufrand_scene *scene) {
    scene->rays = (zbufrandi_rays *)zbufrandi_alloc_zero(&scene->mem, 1, sizeof *scene->rays);
    return scene->rays != NULL && zbufrandi_rays_begin(scene->rays, &scene->mem, &scene->env, scene->structure,
                                                       scene->structure_count, 0);
}
static void zbufrandi_scene_rays_free(zbufrand_scene *scene) {
    if (scene->rays != NULL) zbufrandi_rays_end(scene->rays, &scene->mem);
    zbufrandi_free(&scene->mem, scene->rays);
    scene->rays = NULL;
}

/* ---- cameras ---- */

static int zbufrandi_unit(double v[3]) { /* 0: no direction */
    double l = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    int a;
    if (!(l > 0.0) || !zbufrandi_finite(l)) return 0;
    l = 1.0 / sqrt(l);
    for (a = 0; a < 3; a++) v[a] *= l;
    return 1;
}
/* A direction of any finite length gets one that can be squared. */
static void zbufrandi_direction(double v[3]) {
    const double m = zbufrandi_max(zbufrandi_max(zbufrandi_abs(v[0]), zbufrandi_abs(v[1])), zbufrandi_abs(v[2]));
    int a;
    if ((m > 1e100 && zbufrandi_finite(m)) || (m > 0.0 && m < 1e-100)) for (a = 0; a < 3; a++) v[a] /= m;
}
static void zbufrandi_cross3(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* forward is unit; right and above become so, at right angles to it, above as near to up as can be. */
static void zbufrandi_axes(const double forward[3], const double up[3], double right[3], double above[3]) {
    int a, k = 0;
    for (a = 0; a < 3; a++) above[a] = up[a];
    if (up[0] == 0.0 && up[1] == 0.0 && up[2] == 0.0) above[1] = 1.0;
    if (zbufrandi_unit(above)) {
        zbufrandi_cross3(forward, above, right);
        if (right[0] * right[0] + right[1] * right[1] + right[2] * right[2] > 1e-12) {
            (void)zbufrandi_unit(right);
            zbufrandi_cross3(right, forward, above);
            return;
        }
    }
    for (a = 1; a < 3; a++) k = zbufrandi_abs(forward[a]) < zbufrandi_abs(forward[k]) ? a : k;
    for (a = 0; a < 3; a++) above[a] = a == k ? 1.0 : 0.0;
    zbufrandi_cross3(forward, above, right);
    (void)zbufrandi_unit(right);
    zbufrandi_cross3(right, forward, above);
}

static double zbufrandi_tangent(const zbufrand_camera *c) { /* of half the vertical angle; 0: out of range */
    double angle = c->fov_y == 0.0 ? 40.0 : c->fov_y, s, k;
    if (!(angle > 0.0 && angle < 180.0)) return 0.0;
    zbufrandi_sincos(angle * (3.14159265358979323846 / 360.0), &s, &k);
    return s / k;
}

typedef struct zbufrandi_fit { /* a camera that comes as close as what it has to show allows */
    double right[3], above[3], back[3], tan_x, tan_y, origin[3];
    /* of x + z tan_x, -x + z tan_x, y + z tan_y, -y + z tan_y over the corners, z towards the eye */
    double most[4];
    double size;
} zbufrandi_fit;

static int zbufrandi_fit_open(zbufrandi_fit *f, const zbufrand_camera *camera, const double view[3], uint32_t width,
                              uint32_t height,
                              const double origin[3]) {
    double forward[3];
    int a;
    memset(f, 0, sizeof *f);
    f->tan_y = zbufrandi_tangent(camera);
    f->tan_x = width != 0 && height != 0 ? f->tan_y * (double)width / (double)height : f->tan_y;
    for (a = 0; a < 3; a++) if (!zbufrandi_finite(camera->up[a])) return 0;
    for (a = 0; a < 4; a++) f->most[a] = -1e300;
    memcpy(f->origin, origin, sizeof f->origin);
    if (!(f->tan_y > 0.0)) return 0;
    if (view != NULL) {
        memcpy(f->back, view, sizeof f->back);
    } else { /* `up` and the x axis say where the front is: +z with y up, -y with z up */
        double side[3] = {1.0, 0.0, 0.0}, front[3], up[3];
        memcpy(up, camera->up, sizeof up);
        if (!zbufrandi_unit(up)) {
            up[0] = up[2] = 0.0;
            up[1] = 1.0;
        }
        zbufrandi_cross3(side, up, front);
        if (front[0] * front[0] + front[1] * front[1] + front[2] * front[2] < 1e-3) {
            side[0] = 0.0;
            side[1] = 1.0;
            zbufrandi_cross3(side, up, front);
        }
        (void)zbufrandi_unit(front);
        zbufrandi_cross3(up, front, side);
        for (a = 0; a < 3; a++) f->back[a] = 0.6 * side[a] + 0.42 * up[a] + front[a];
    }
    zbufrandi_direction(f->back);
    if (!zbufrandi_unit(f->back)) return 0;
    for (a = 0; a < 3; a++) forward[a] = -f->back[a];
    zbufrandi_axes(forward, camera->up, f->right, f->above);
    return 1;
}

static void zbufrandi_fit_box(zbufrandi_fit *f, const double lo[3], const double hi[3]) {
    int a, k;
    for (k = 0; k < 4; k++) {
        double most = 0.0;
        for (a = 0; a < 3; a++) {
            double g = (k == 0 ? f->right[a] : k == 1 ? -f->right[a] : k == 2 ? f->above[a] : -f->above[a]) +
                       (k < 2 ? f->tan_x : f->tan_y) * f->back[a];
            most += (0.5 * (lo[a] + hi[a]) - f->origin[a]) * g + 0.5 * (hi[a] - lo[a]) * zbufrandi_abs(g);
            f->size = zbufrandi_max(f->size, hi[a] - lo[a]);
        }
        f->most[k] = zbufrandi_max(f->most[k], most);
    }
}

static zbufrand_result zbufrandi_fit_close(const zbufrandi_fit *f, zbufrand_camera *camera) {
    zbufrand_camera c = *camera;
    double distance = zbufrandi_max((f->most[0] + f->most[1]) / (2.0 * f->tan_x),
                                    (f->most[2] + f->most[3]) / (2.0 * f->tan_y));
    double x = 0.5 * (f->most[0] - f->most[1]), y = 0.5 * (f->most[2] - f->most[3]);
    int a;
    distance = f->size > 0.0 ? 1.04 * distance + 0.01 * f->size : 1.0;
    for (a = 0; a < 3; a++) {
        c.at[a] = f->origin[a] + x * f->right[a] + y * f->above[a];
        c.eye[a] = c.at[a] + distance * f->back[a];
        if (!zbufrandi_finite(c.eye[a])) return ZBUFRAND_ERR_INVALID_ARG;
    }
    *camera = c;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_camera_fit(zbufrand_camera *camera, const double box_min[3],
                                                 const double box_max[3], const double view[3], uint32_t width,
                                                 uint32_t height) {
    zbufrandi_fit f;
    double origin[3];
    int a;
    if (camera == NULL || box_min == NULL || box_max == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++) {
        if (!zbufrandi_finite(box_min[a]) || !zbufrandi_finite(box_max[a]) || box_min[a] > box_max[a])
            return ZBUFRAND_ERR_INVALID_ARG;
        origin[a] = 0.5 * (box_min[a] + box_max[a]);
    }
    if (!zbufrandi_fit_open(&f, camera, view, width, height, origin)) return ZBUFRAND_ERR_INVALID_ARG;
    zbufrandi_fit_box(&f, box_min, box_max);
    return zbufrandi_fit_close(&f, camera);
}

static void zbufrandi_fit_node(zbufrandi_fit *f, const zbufrandi_structure *s, uint32_t node, uint32_t depth) {
    const zbufrandi_node8 *n = &s->node[node];
    uint32_t i;
    int a;
    for (i = 0; i < n->count; i++) {
        double lo[3], hi[3];
        if (depth > 0 && ZBUFRANDI_CHILD_KIND(n->child[i]) == ZBUFRANDI_CHILD_NODE) {
            zbufrandi_fit_node(f, s, ZBUFRANDI_CHILD_INDEX(n->child[i]), depth - 1);
            continue;
        }
        for (a = 0; a < 3; a++) {
            lo[a] = (double)n->lo[a][i] + s->origin[a];
            hi[a] = (double)n->hi[a][i] + s->origin[a];
        }
        zbufrandi_fit_box(f, lo, hi);
    }
}

ZBUFRAND_DEF zbufrand_result zbufrand_camera_fit_scene(zbufrand_camera *camera, const zbufrand_scene *scene,
                                                       const double view[3], uint32_t width, uint32_t height) {
    static const double unit_lo[3] = {-1.0, -1.0, -1.0}, unit_hi[3] = {1.0, 1.0, 1.0};
    zbufrandi_fit f;
    double origin[3];
    int a;
    if (camera == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (scene == NULL || scene->structure_count == 0 || scene->structure[0].node_count == 0) {
        return zbufrand_camera_fit(camera, unit_lo, unit_hi, view, width, height);
    }
    for (a = 0; a < 3; a++) origin[a] = 0.5 * (scene->info.box_min[a] + scene->info.box_max[a]);
    if (!zbufrandi_fit_open(&f, camera, view, width, height, origin)) return ZBUFRAND_ERR_INVALID_ARG;
    zbufrandi_fit_node(&f, &scene->structure[0], 0, 3);
    return zbufrandi_fit_close(&f, camera);
}

/* guard: pixels around the picture that are drawn, too. */
static zbufrand_result zbufrandi_camera_open(const zbufrand_camera *camera, const zbufrand_scene *scene, uint32_t width,
                                             uint32_t height, uint32_t guard, zbufrandi_camera *out) {
    zbufrand_camera c = *camera;
    double tangent, diagonal = 0.0;
    zbufrand_result r;
    int a, empty = scene == NULL || scene->structure_count == 0 || scene->structure[0].node_count == 0;
    memset(out, 0, sizeof *out);
    for (a = 0; a < 3 && !empty; a++) {
        double e = scene->info.box_max[a] - scene->info.box_min[a];
        diagonal += e * e;
    }
    diagonal = sqrt(diagonal);
    for (a = 0; a < 3; a++) {
        if (!zbufrandi_finite(c.eye[a]) || !zbufrandi_finite(c.at[a]) || !zbufrandi_finite(c.up[a]))
            return ZBUFRAND_ERR_INVALID_ARG;
    }
    if (c.eye[0] == c.at[0] && c.eye[1] == c.at[1] && c.eye[2] == c.at[2]) {
        r = zbufrand_camera_fit_scene(&c, scene, NULL, width, height);
        if (r != ZBUFRAND_OK) return r;
    }
    tangent = zbufrandi_tangent(&c);
    for (a = 0; a < 3; a++) {
        out->eye[a] = c.eye[a];
        out->dir[a] = c.at[a] - c.eye[a];
    }
    if (!(tangent > 0.0) || !zbufrandi_unit(out->dir)) return ZBUFRAND_ERR_INVALID_ARG;
    zbufrandi_axes(out->dir, c.up, out->right, out->up);
    out->width = width + 2 * guard;
    out->height = height + 2 * guard;
    out->focal = height != 0 ? 0.5 * (double)height / tangent : 1.0;
    out->center_x = 0.5 * (double)width + (double)guard;
    out->center_y = 0.5 * (double)height + (double)guard;
    out->near_z = c.near_z > 0.0 ? c.near_z : diagonal > 0.0 ? 1e-7 * diagonal : 1e-7;
    out->far_z = c.far_z > 0.0 ? c.far_z : (double)INFINITY;
    if (!(c.near_z >= 0.0) || !(c.far_z >= 0.0) || !(out->near_z < out->far_z) || !(out->near_z < 1e30))
        return ZBUFRAND_ERR_INVALID_ARG;
    if (out->near_z < 1e-30) out->near_z = 1e-30;
    zbufrandi_camera_sides(out);
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_camera_view(const zbufrand_camera *camera, const zbufrand_scene *scene,
                                                  uint32_t width, uint32_t height, zbufrand_view *out_view) {
    zbufrandi_camera c;
    const double *row[3];
    zbufrand_result r;
    int a, k;
    if (out_view == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    memset(out_view, 0, sizeof *out_view);
    if (camera == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    r = zbufrandi_camera_open(camera, scene, width, height, 0, &c);
    if (r != ZBUFRAND_OK) return r;
    row[0] = c.right;
    row[1] = c.up;
    row[2] = c.dir;
    for (a = 0; a < 3; a++) {
        for (k = 0; k < 3; k++) {
            out_view->world_to_camera[a][k] = row[a][k];
            out_view->world_to_camera[a][3] -= row[a][k] * c.eye[k];
        }
    }
    out_view->focal = c.focal;
    out_view->center_x = c.center_x;
    out_view->center_y = c.center_y;
    out_view->near_z = c.near_z;
    out_view->far_z = c.far_z < (double)INFINITY ? c.far_z : 0.0;
    return ZBUFRAND_OK;
}

/* ---- the frame ---- */

typedef struct zbufrandi_picture zbufrandi_picture;

typedef struct zbufrandi_batch { uint32_t draw, sample; } zbufrandi_batch;

struct zbufrand_frame {
    zbufrandi_mem mem;
    zbufrand_env env;
    int level;                         /* instruction set */
    zbufrand_isa isa;
    zbufrandi_recon recon;
    int recon_open;
    zbufrand_reconstruct recon_asked;  /* what it was opened for */
    zbufrandi_pick pick[ZBUFRANDI_ROUND_TASKS];
    zbufrandi_open_node *front, *sorted;
    zbufrandi_draw *draw;
    zbufrandi_bounds *bounds;          /* of the draws, for queries */
    zbufrandi_local *local;
    uint32_t *block_draw;
    zbufrandi_batch *batch;            /* where each task of drawing begins */
    uint8_t *aux;
    zbufrandi_ray_seen *ray_seen;
    zbufrandi_ray_hit *hit;
    uint32_t *suspect;
    float *depth;                      /* for the repair: of the picture */
    uint8_t *mask;
    float (*light)[6];
    uint8_t *directional;
    void *pyramid_memory;
    float *color;                      /* rgba of the picture, before filters or several frames are done with */
    float *large, *large_depth;        /* of a picture that is drawn larger than it was asked for */
    uint32_t *large_node;
    zbufrand_accumulator *accumulator;
    uint32_t accumulator_width, accumulator_height;
    size_t front_capacity, sorted_capacity, draw_capacity, bounds_capacity, local_capacity, block_capacity,
        batch_capacity, aux_capacity;
    size_t ray_capacity, hit_capacity, suspect_capacity, depth_capacity, mask_capacity, light_capacity,
        directional_capacity, pyramid_capacity, color_capacity, large_capacity, large_depth_capacity,
        large_node_capacity;
    size_t front_count, draw_count, local_count, block_count, batch_count, aux_count, aux_written, ray_count,
        suspect_count;
    zbufrandi_picture *picture;        /* the one at work */
    zbufrandi_srgb srgb;
};

/* ---- one picture ---- */

struct zbufrandi_picture {
    zbufrand_frame *f;
    const zbufrand_render_desc *d;
    const zbufrand_scene *scene;
    const zbufrand_image *image;
    zbufrandi_asker asker;
    zbufrand_stats stats;
    zbufrandi_cut cut;
    zbufrandi_target target;
    zbufrandi_keys exact;              /* where rastered triangles go */
    zbufrandi_pyramid pyramid;
    zbufrandi_drawn drawn;
    zbufrandi_look look;
    uint32_t first_block;
    uint32_t done_draws;               /* drawn already */
    uint32_t accepted[2], sampled[2], stored[2], points[2]; /* tallies */
    uint32_t seen[2];                  /* tally: pixels that show something before rays do */
    uint32_t area[2][2];               /* tallies of the first pass: samples with hidden ones, pixels rastered */
    uint32_t pass;
    double first_density;
    uint64_t since_refresh;            /* samples since the pyramid was made */
    double clock;
    int too_many;                      /* samples for numbers of 32 bits */
    int told;                          /* env.error says already what is wrong */
    int keep;                          /* colours go to f->color and not to the caller: one of several frames */
    uint32_t parts;                    /* oversampling: so many of its pixels make one; else 1 */
    uint8_t *where;                    /* repair: of 16 x 16 pixels: 1 samples may be there, 2 beside that; or NULL */
    float jitter[2];                   /* of the centres of pixels, for what is rasterised and for rays */
    zbufrandi_camera raster_camera;    /* shifted by that */
};

ZBUFRAND_DEF zbufrand_result zbufrand_frame_create(const zbufrand_frame_desc *desc, zbufrand_frame **out_frame) {
    zbufrand_frame_desc d;
    zbufrandi_mem mem;
    zbufrand_frame *f;
    zbufrand_result r;
    if (out_frame == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    *out_frame = NULL;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    if ((uint32_t)d.isa > ZBUFRAND_ISA_AVX512)
        return zbufrandi_fail(d.env.error, ZBUFRAND_ERR_INVALID_ARG, (uint64_t)d.isa, "there is no isa %");
    r = zbufrandi_env_open(&d.env, &mem);
    if (r != ZBUFRAND_OK) return zbufrandi_fail(d.env.error, r, 0, "env: only one of alloc_fn and free_fn is set");
    f = (zbufrand_frame *)zbufrandi_alloc_zero(&mem, 1, sizeof *f);
    if (f != NULL) f->picture = (zbufrandi_picture *)zbufrandi_alloc_zero(&mem, 1, sizeof *f->picture);
    if (f == NULL || f->picture == NULL) {
        zbufrandi_free(&mem, f);
        return zbufrandi_fail(d.env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "no memory for a frame");
    }
    f->mem = mem;
    f->env = d.env;
    f->isa = d.isa;
    f->level = zbufrandi_level(d.isa);
    zbufrandi_srgb_open(&f->srgb);
    *out_frame = f;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF void zbufrand_frame_destroy(zbufrand_frame *frame) {
    zbufrandi_mem mem;
    uint32_t i;
    if (frame == NULL) return;
    zbufrand_accumulator_destroy(frame->accumulator);
    if (frame->recon_open) zbufrandi_recon_close(&frame->mem, &frame->recon);
    for (i = 0; i < ZBUFRANDI_ROUND_TASKS; i++) {
        zbufrandi_free(&frame->mem, frame->pick[i].stack);
        zbufrandi_free(&frame->mem, frame->pick[i].draw);
        zbufrandi_free(&frame->mem, frame->pick[i].bounds);
        zbufrandi_free(&frame->mem, frame->pick[i].local);
    }
    zbufrandi_free(&frame->mem, frame->picture);
    zbufrandi_free(&frame->mem, frame->front);
    zbufrandi_free(&frame->mem, frame->sorted);
    zbufrandi_free(&frame->mem, frame->draw);
    zbufrandi_free(&frame->mem, frame->bounds);
    zbufrandi_free(&frame->mem, frame->local);
    zbufrandi_free(&frame->mem, frame->block_draw);
    zbufrandi_free(&frame->mem, frame->batch);
    zbufrandi_free(&frame->mem, frame->aux);
    zbufrandi_free(&frame->mem, frame->ray_seen);
    zbufrandi_free(&frame->mem, frame->hit);
    zbufrandi_free(&frame->mem, frame->suspect);
    zbufrandi_free(&frame->mem, frame->depth);
    zbufrandi_free(&frame->mem, frame->mask);
    zbufrandi_free(&frame->mem, frame->light);
    zbufrandi_free(&frame->mem, frame->directional);
    zbufrandi_free(&frame->mem, frame->pyramid_memory);
    zbufrandi_free(&frame->mem, frame->color);
    zbufrandi_free(&frame->mem, frame->large);
    zbufrandi_free(&frame->mem, frame->large_depth);
    zbufrandi_free(&frame->mem, frame->large_node);
    mem = frame->mem;
    zbufrandi_free(&mem, frame);
}

static void zbufrandi_lap(zbufrandi_picture *p, int stage) { /* book the time since the last call; < 0: just start */
    double now;
    if (p->d->clock_fn == NULL) return;
    now = p->d->clock_fn(p->d->clock_user);
    if (stage >= 0) p->stats.seconds[stage] += now - p->clock;
    p->clock = now;
}

/* What progress_fn hears is about the nodes of the tree: how many there will be nobody knows. 0: cancelled. */
static int zbufrandi_picture_asks(zbufrandi_picture *p) {
    p->asker.done = p->stats.nodes;
    p->asker.total = p->stats.nodes + p->f->front_count;
    return zbufrandi_ask(&p->f->env, &p->asker, 0);
}

/* A parallel-for of a picture. 0: cancelled. */
static int zbufrandi_picture_for(zbufrandi_picture *p, zbufrand_task_fn *task, void *ctx, uint32_t count) {
    p->asker.done = p->stats.nodes;
    p->asker.total = p->stats.nodes + p->f->front_count;
    return zbufrandi_parallel_ask(&p->f->env, &p->asker, task, ctx, count);
}

/* ---- rounds ---- */

static void zbufrandi_select_task(void *ctx, uint32_t task) {
    zbufrandi_picture *p = (zbufrandi_picture *)ctx;
    zbufrandi_pick_run(&p->cut, &p->f->mem, p->f->local, &p->f->pick[task], ZBUFRANDI_ROUND_NODES);
}

/* Sort by depth, equal ones by when they were found: a merge sort from runs of one. */
static void zbufrandi_sort_front(zbufrandi_open_node **list, zbufrandi_open_node **other, size_t n) {
    size_t width, i, j, k, mid, end;
    for (width = 1; width < n; width *= 2) {
        const zbufrandi_open_node *from = *list;
        zbufrandi_open_node *to = *other;
        for (i = 0; i < n; i = end) {
            mid = i + width < n ? i + width : n;
            end = mid + width < n ? mid + width : n;
            for (j = i, k = mid; i < end; i++)
                to[i] = k >= end || (j < mid && from[j].z <= from[k].z) ? from[j++] : from[k++];
        }
        to = *list;
        *list = *other;
        *other = to;
    }
}

/* Give a draw its numbers. 0: no memory, or 2^32 numbers are used up. */
static int zbufrandi_number_draw(zbufrandi_picture *p, zbufrandi_draw *d, uint32_t at) {
    zbufrand_frame *f = p->f;
    uint32_t blocks = (d->count + 63u) / 64u, i, kind = d->item >> ZBUFRANDI_DRAW_SHIFT;
    if (kind == ZBUFRANDI_DRAW_STORED) blocks = 1;
    if (f->block_count + blocks > 0x3ffffffu) {
        p->too_many = 1;
        return 0;
    }
    if (!zbufrandi_grow(&f->mem, (void **)&f->block_draw, &f->block_capacity, f->block_count, f->block_count + blocks,
                        sizeof *f->block_draw)) return 0;
    d->block = (uint32_t)f->block_count;
    for (i = 0; i < blocks; i++) f->block_draw[f->block_count++] = at;
    if (kind == ZBUFRANDI_DRAW_SAMPLED) {
        d->aux = (uint32_t)f->aux_count;
        f->aux_count += blocks;
    }
    return 1;
}

/* What the tasks of a round found goes to the lists of the frame, in the order of the tasks. 0: no memory. */
static int zbufrandi_round_merge(zbufrandi_picture *p, uint32_t tasks) {
    zbufrand_frame *f = p->f;
    uint32_t t, i;
    for (t = 0; t < tasks; t++) {
        zbufrandi_pick *k = &f->pick[t];
        uint32_t shift = (uint32_t)f->local_count - ZBUFRANDI_NEW_LOCAL;
        if (k->failed) {
            p->too_many |= k->samples > ZBUFRANDI_SAMPLES_MAX;
            return 0;
        }
        if (f->local_count + k->local_count >= ZBUFRANDI_NEW_LOCAL ||
            !zbufrandi_grow(&f->mem, (void **)&f->local, &f->local_capacity, f->local_count,
                            f->local_count + k->local_count,
                            sizeof *f->local) ||
            !zbufrandi_grow(&f->mem, (void **)&f->draw, &f->draw_capacity, f->draw_count, f->draw_count + k->draw_count,
                            sizeof *f->draw) ||
            (p->cut.bounds && !zbufrandi_grow(&f->mem, (void **)&f->bounds, &f->bounds_capacity, f->draw_count,
                                              f->draw_count + k->draw_count, sizeof *f->bounds)) ||
            !zbufrandi_grow(&f->mem, (void **)&f->front, &f->front_capacity, f->front_count,
                            f->front_count + k->stack_count,
                            sizeof *f->front)) return 0;
        for (i = 0; i < k->local_count; i++) {
            f->local[f->local_count] = k->local[i];
            if (k->local[i].parent >= ZBUFRANDI_NEW_LOCAL && k->local[i].parent != ~0u)
                f->local[f->local_count].parent += shift;
            f->local_count++;
        }
        for (i = 0; i < k->draw_count; i++) {
            zbufrandi_draw *d = &f->draw[f->draw_count];
            *d = k->draw[i];
            if (d->local >= ZBUFRANDI_NEW_LOCAL) d->local += shift;
            if (!zbufrandi_number_draw(p, d, (uint32_t)f->draw_count)) return 0;
            if (p->cut.bounds) f->bounds[f->draw_count] = k->bounds[i];
            f->draw_count++;
        }
        for (i = 0; i < k->stack_count; i++) { /* nearest first */
            zbufrandi_open_node *e = &f->front[f->front_count++];
            *e = k->stack[k->stack_count - 1 - i];
            if (e->local >= ZBUFRANDI_NEW_LOCAL) e->local += shift;
        }
        p->stats.nodes += k->counts.nodes;
        p->stats.tested += k->counts.tested;
        p->stats.outside += k->counts.outside;
        p->stats.facing_away += k->counts.away;
        p->stats.hidden += k->counts.hidden;
        p->stats.instances += k->counts.entered;
    }
    return 1;
}

/* One round of selection. 0: no memory. */
static int zbufrandi_round_select(zbufrandi_picture *p) {
    zbufrand_frame *f = p->f;
    uint32_t tasks = f->front_count < ZBUFRANDI_ROUND_TASKS
        ? (uint32_t)f->front_count : (uint32_t)ZBUFRANDI_ROUND_TASKS, t;
    size_t left;
    for (t = 0; t < tasks; t++) {
        zbufrandi_pick *k = &f->pick[t];
        k->stack_count = k->draw_count = k->local_count = 0;
        k->samples = 0;
        memset(&k->counts, 0, sizeof k->counts);
        k->failed = !zbufrandi_grow(&f->mem, (void **)&k->stack, &k->stack_capacity, 0, 16, sizeof *k->stack);
        if (k->failed) return 0;
        k->stack[k->stack_count++] = f->front[t];
    }
    f->front_count -= tasks;
    memmove(f->front, f->front + tasks, f->front_count * sizeof *f->front);
    left = f->front_count;
    zbufrandi_parallel_for(&f->env, zbufrandi_select_task, p, tasks);
    if (!zbufrandi_round_merge(p, tasks)) return 0;
    if (f->front_count == 0) return 1;
    if (!zbufrandi_grow(&f->mem, (void **)&f->sorted, &f->sorted_capacity, 0, f->front_count, sizeof *f->sorted))
        return 0;
    { /* what is new is sorted, then both parts are merged */
        zbufrandi_open_node *a = f->front + left, *b = f->sorted + left;
        const size_t capacity = f->front_capacity;
        size_t i, j = 0, k = left, n = f->front_count;
        zbufrandi_sort_front(&a, &b, n - left);
        if (a != f->front + left) memcpy(f->front + left, a, (n - left) * sizeof *a);
        for (i = 0; i < n; i++)
            f->sorted[i] = k >= n || (j < left && f->front[j].z <= f->front[k].z) ? f->front[j++] : f->front[k++];
        a = f->front;
        f->front = f->sorted;
        f->front_capacity = f->sorted_capacity;
        f->sorted = a;
        f->sorted_capacity = capacity;
    }
    return 1;
}

/* What a draw reads first: memory is far away. */
ZBUFRANDI_INLINE void zbufrandi_draw_prefetch(const zbufrandi_picture *p, const zbufrandi_draw *d) {
    const zbufrandi_structure *s = &p->scene->structure[p->f->local[d->local].structure];
    const uint32_t kind = d->item >> ZBUFRANDI_DRAW_SHIFT, index = d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u);
    if (kind == ZBUFRANDI_DRAW_STORED) {
        const uint32_t *set = s->set + (size_t)index * (2 * ZBUFRANDI_SET);
        const zbufrandi_local *l = &p->f->local[d->local];
        const uint32_t first = zbufrandi_stored_first(&p->cut, d, l) & (ZBUFRANDI_SET - 8u);
        uint32_t k;
        float c[3], x, y, z;
        for (k = 0; k < 3; k++) c[k] = d->lo[k] + d->step[k] * (k == 0 ? 1024.0f : 512.0f) - l->eye[k];
        z = (float)p->target.focal / (l->m[2][0] * c[0] + l->m[2][1] * c[1] + l->m[2][2] * c[2]);
        x = (l->m[0][0] * c[0] + l->m[0][1] * c[1] + l->m[0][2] * c[2]) * z + p->target.center_x;
        y = p->target.center_y - (l->m[1][0] * c[0] + l->m[1][1] * c[1] + l->m[1][2] * c[2]) * z;
        if (x >= 0.0f && x < p->target.width && y >= 3.0f && y < p->target.height - 3.0f) {
            const uint64_t *key = p->target.keys.key + ((size_t)(int32_t)y - 3) * p->target.keys.width +
                (size_t)(int32_t)x;
            for (k = 0; k < 7; k++) ZBUFRANDI_PREFETCH(key + (size_t)k * p->target.keys.width);
        }
        for (k = 0; k < d->count; k += 8) ZBUFRANDI_PREFETCH(set + 2 * (k ^ first));
    } else if (kind < ZBUFRANDI_DRAW_LISTED) {
        const zbufrandi_cluster *c = &s->cluster[index];
        const uint8_t *q = (const uint8_t *)(s->position + 3 * (size_t)c->first_vertex);
        const uint8_t *t = s->triangle + 3 * (size_t)c->first_triangle;
        uint32_t k;
        for (k = 0; k < 12u * c->vertex_count; k += 64) ZBUFRANDI_PREFETCH(q + k);
        for (k = 0; k < 3u * c->triangle_count; k += 64) ZBUFRANDI_PREFETCH(t + k);
    }
}

static void zbufrandi_draw_task(void *ctx, uint32_t task) {
    zbufrandi_picture *p = (zbufrandi_picture *)ctx;
    const zbufrand_frame *f = p->f;
    const zbufrandi_batch *b = &f->batch[task];
    const uint32_t end = b[1].draw + (b[1].sample != 0);
    uint32_t i, raster_local = ~0u, samples;
    uint64_t accepted = 0, sampled_seen = 0, sampled = 0, stored = 0, points = 0, covered = 0;
    zbufrandi_waiting wait;
    zbufrandi_raster r;
    wait.count = wait.inside = wait.tried = 0;
    zbufrandi_raster_begin(&r, &p->raster_camera, &p->exact, p->target.exclusive, f->level);
    for (i = b->draw; i < end; i++) {
        zbufrandi_draw d = f->draw[i];
        const uint32_t kind = d.item >> ZBUFRANDI_DRAW_SHIFT;
        const uint32_t first = i == b->draw ? b->sample : 0, last = i == b[1].draw ? b[1].sample : d.count;
        const zbufrandi_local *l;
        const zbufrandi_structure *s;
        d.block += p->first_block;
        if (kind == ZBUFRANDI_DRAW_POINTS) {
            points += zbufrandi_draw_points(&p->target, &d,
                                            &p->d->points[d.item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)]);
            continue;
        }
        l = &f->local[d.local];
        s = &p->scene->structure[l->structure];
        if (i + 6 < end) zbufrandi_draw_prefetch(p, &f->draw[i + 6]);
        if (kind == ZBUFRANDI_DRAW_STORED) {
            accepted += zbufrandi_draw_stored(&p->target, &d, l, s, &wait);
            stored += d.count;
        } else if (kind == ZBUFRANDI_DRAW_SAMPLED) {
            sampled_seen += zbufrandi_draw_sampled(&p->target, &d, first, last, l, s, &wait, &samples);
            sampled += samples;
        } else if (kind == ZBUFRANDI_DRAW_LISTED) {
            accepted += zbufrandi_draw_listed(&p->target, &d, first, last, l);
            sampled += last - first;
        } else if (kind == ZBUFRANDI_DRAW_LISTED_RASTER) {
            if (raster_local != d.local) zbufrandi_raster_local(&r, l);
            raster_local = d.local;
            zbufrandi_raster_listed(&r, s, &d, &p->cut.veil);
        } else {
            const zbufrandi_cluster *c = &s->cluster[d.item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u)];
            if (raster_local != d.local) zbufrandi_raster_local(&r, l);
            raster_local = d.local;
            if (p->cut.veil.opacity != NULL) r.mask = zbufrandi_veil_cluster(&p->cut.veil, c);
            covered += zbufrandi_raster_cluster(&r, s->position + 3 * (size_t)c->first_vertex, c->vertex_count,
                                           s->triangle + 3 * (size_t)c->first_triangle, c->triangle_count,
                                           c->flags & ZBUFRANDI_TWO_SIDED, d.block * ZBUFRANDI_SET);
        }
    }
    zbufrandi_waiting_put(&p->target, &wait);
    zbufrandi_tally_add(p->accepted, accepted + sampled_seen);
    if (p->pass == 0) {
        /* what was left out early would have been thinned as much as the rest */
        if (wait.tried != 0) accepted = accepted * wait.inside / wait.tried;
        zbufrandi_tally_add(p->area[0], accepted + sampled_seen);
        zbufrandi_tally_add(p->area[1], covered);
    }
    zbufrandi_tally_add(p->sampled, sampled);
    zbufrandi_tally_add(p->stored, stored);
    zbufrandi_tally_add(p->points, points);
}

/* A task of drawing begins at a sample of a draw. 0: no memory. */
static int zbufrandi_batch_begin(zbufrand_frame *f, uint32_t draw, uint32_t sample) {
    if (!zbufrandi_grow(&f->mem, (void **)&f->batch, &f->batch_capacity, f->batch_count, f->batch_count + 1,
                        sizeof *f->batch)) return 0;
    f->batch[f->batch_count].draw = draw;
    f->batch[f->batch_count++].sample = sample;
    return 1;
}

/* Samples of a draw that are one task: more would let nobody be asked for long. How many independent ones there are
   takes as long as some of them, and each piece has to know. */
enum { ZBUFRANDI_PIECE = 1 << 18, ZBUFRANDI_PIECE_INDEPENDENT = 1 << 25 };

static uint32_t zbufrandi_draw_piece(const zbufrandi_picture *p, uint32_t kind) {
    if (kind == ZBUFRANDI_DRAW_LISTED) return ZBUFRANDI_PIECE;
    if (kind != ZBUFRANDI_DRAW_SAMPLED) return ~0u;
    return p->cut.independent ? ZBUFRANDI_PIECE_INDEPENDENT : ZBUFRANDI_PIECE;
}

/* Draw what was found since the last call, in tasks of about equal size. */
static zbufrand_result zbufrandi_round_draw(zbufrandi_picture *p) {
    zbufrand_frame *f = p->f;
    uint32_t i, begin = p->done_draws;
    uint64_t work = 0, total = 0;
    f->batch_count = 0;
    if (!zbufrandi_grow(&f->mem, (void **)&f->aux, &f->aux_capacity, f->aux_written, f->aux_count * ZBUFRANDI_SET + 64,
                        1)) return ZBUFRAND_ERR_NO_MEMORY;
    f->aux_written = f->aux_count * ZBUFRANDI_SET;
    for (i = begin; i <= f->draw_count; i++) {
        if (i == begin || work >= 8192 || i == f->draw_count) {
            if (!zbufrandi_batch_begin(f, i, 0)) return ZBUFRAND_ERR_NO_MEMORY;
            total += work;
            work = 0;
        }
        if (i < f->draw_count) {
            const zbufrandi_draw *d = &f->draw[i];
            const uint32_t kind = d->item >> ZBUFRANDI_DRAW_SHIFT, piece = zbufrandi_draw_piece(p, kind);
            uint32_t at;
            for (at = piece; at < d->count; at += piece) {
                if (!zbufrandi_batch_begin(f, i, at)) return ZBUFRAND_ERR_NO_MEMORY;
                if (d->count - at <= piece) break;
            }
            if (kind <= ZBUFRANDI_DRAW_RASTERED) p->stats.draws[kind]++;
            else if (kind >= ZBUFRANDI_DRAW_LISTED) p->stats.draws[1 + (kind == ZBUFRANDI_DRAW_LISTED_RASTER)]++;
            if (kind == ZBUFRANDI_DRAW_RASTERED || kind == ZBUFRANDI_DRAW_LISTED_RASTER)
                p->stats.rastered += d->count;
            work += kind == ZBUFRANDI_DRAW_STORED || kind == ZBUFRANDI_DRAW_POINTS
                ? d->count + 8u : kind == ZBUFRANDI_DRAW_SAMPLED ? 2u * d->count + 64u : 6u * d->count + 32u;
        }
    }
    p->target.aux = f->aux;
    p->since_refresh += total;
    p->done_draws = (uint32_t)f->draw_count;
    if (f->batch_count <= 1) return ZBUFRAND_OK;
    return zbufrandi_picture_for(p, zbufrandi_draw_task, p, (uint32_t)f->batch_count - 1) ? ZBUFRAND_OK
                                                                                        : ZBUFRAND_ERR_CANCELLED;
}

/* Why something could not be given room. */
static zbufrand_result zbufrandi_no_room(const zbufrandi_picture *p) {
    return p->asker.cancelled ? ZBUFRAND_ERR_CANCELLED : p->too_many ? ZBUFRAND_ERR_RANGE : ZBUFRAND_ERR_NO_MEMORY;
}

/* Draws for the caller's clouds of points. 0: no memory, or too many points. */
static int zbufrandi_add_points(zbufrandi_picture *p) {
    zbufrand_frame *f = p->f;
    size_t i, first, n;
    for (i = 0; i < p->d->points_count; i++) {
        const zbufrand_points *c = &p->d->points[i];
        for (first = 0; first < c->count; first += n) {
            zbufrandi_draw *d;
            n = c->count - first < 32768 ? c->count - first : 32768;
            if (!zbufrandi_grow(&f->mem, (void **)&f->draw, &f->draw_capacity, f->draw_count, f->draw_count + 1,
                                sizeof *f->draw)) return 0;
            d = &f->draw[f->draw_count];
            memset(d, 0, sizeof *d);
            d->item = (uint32_t)ZBUFRANDI_DRAW_POINTS << ZBUFRANDI_DRAW_SHIFT | (uint32_t)i;
            d->count = (uint32_t)n;
            d->hash = (uint32_t)first;
            if (!zbufrandi_number_draw(p, d, (uint32_t)f->draw_count)) return 0;
            f->draw_count++;
        }
    }
    return 1;
}

/* All of a scene with lists, seen from local 0: one cut, no rounds, since nothing is hidden from it. */
static zbufrand_result zbufrandi_draw_lists(zbufrandi_picture *p, uint32_t root) {
    zbufrand_frame *f = p->f;
    zbufrandi_pick *k = &f->pick[0];
    uint32_t i;
    zbufrand_result r;
    k->stack_count = k->draw_count = k->local_count = 0;
    k->samples = 0;
    k->failed = 0;
    memset(&k->counts, 0, sizeof k->counts);
    zbufrandi_list_select(&p->cut, &f->mem, &f->env, &p->asker, f->local, root, k);
    f->front_count = 0;
    if (!zbufrandi_round_merge(p, 1)) return zbufrandi_no_room(p);
    if (!zbufrandi_grow(&f->mem, (void **)&f->local, &f->local_capacity, f->local_count,
                        f->local_count + p->scene->structure_count, sizeof *f->local)) return ZBUFRAND_ERR_NO_MEMORY;
    p->drawn.stand_in = (uint32_t)f->local_count;
    for (i = 0; i < p->scene->structure_count; i++) {
        memset(&f->local[f->local_count], 0, sizeof *f->local);
        f->local[f->local_count++].structure = i;
    }
    zbufrandi_lap(p, ZBUFRAND_STAGE_SELECT);
    r = p->cut.bounds ? ZBUFRAND_OK : zbufrandi_round_draw(p);
    zbufrandi_lap(p, ZBUFRAND_STAGE_DRAW);
    return r;
}

/* Independent samples are drawn from clusters, however small: of 10^11 triangles that would take hours. */
enum { ZBUFRANDI_INDEPENDENT_DRAWS = 1 << 22 };

/* A picture has hundreds of short rounds: their threads wait for the next one instead of being started anew. */
#ifndef ZBUFRAND_NO_THREADS
typedef struct zbufrandi_crew {
    pthread_t thread[63];
    pthread_mutex_t lock;
    pthread_cond_t go, done;
    zbufrandi_for work;
    uint32_t started;
    uint32_t wanted; /* threads that have not taken part in `work` yet, and may */
    uint32_t busy;   /* those that do */
    int quit;
} zbufrandi_crew;

static void *zbufrandi_crew_thread(void *arg) {
    zbufrandi_crew *c = (zbufrandi_crew *)arg;
    (void)pthread_mutex_lock(&c->lock);
    for (;;) {
        while (c->wanted == 0 && !c->quit) (void)pthread_cond_wait(&c->go, &c->lock);
        if (c->quit) break;
        c->wanted--;
        c->busy++;
        (void)pthread_mutex_unlock(&c->lock);
        zbufrandi_for_drain(&c->work);
        (void)pthread_mutex_lock(&c->lock);
        if (--c->busy == 0) (void)pthread_cond_signal(&c->done);
    }
    (void)pthread_mutex_unlock(&c->lock);
    return NULL;
}

/* A parallel-for of a zbufrand_env. Who comes after all is done is not waited for. */
static void zbufrandi_crew_for(zbufrand_task_fn *task, void *ctx, uint32_t count, void *user) {
    zbufrandi_crew *c = (zbufrandi_crew *)user;
    uint32_t i, want = count - 1u < c->started ? count - 1u : c->started;
    (void)pthread_mutex_lock(&c->lock);
    c->work.task = task;
    c->work.ctx = ctx;
    c->work.count = count;
    c->work.next = 0;
    c->wanted = want;
    for (i = 0; i < want; i++) (void)pthread_cond_signal(&c->go);
    (void)pthread_mutex_unlock(&c->lock);
    zbufrandi_for_drain(&c->work);
    (void)pthread_mutex_lock(&c->lock);
    c->wanted = 0;
    while (c->busy > 0) (void)pthread_cond_wait(&c->done, &c->lock);
    (void)pthread_mutex_unlock(&c->lock);
}

static void zbufrandi_crew_close(zbufrandi_crew *c, zbufrand_env *env) {
    uint32_t i;
    if (c->started == 0) return;
    (void)pthread_mutex_lock(&c->lock);
    c->quit = 1;
    (void)pthread_cond_broadcast(&c->go);
    (void)pthread_mutex_unlock(&c->lock);
    for (i = 0; i < c->started; i++) (void)pthread_join(c->thread[i], NULL);
    (void)pthread_cond_destroy(&c->done);
    (void)pthread_cond_destroy(&c->go);
    (void)pthread_mutex_destroy(&c->lock);
    env->parallel.for_fn = NULL;
    env->parallel.user = NULL;
}

/* Into env, until it is closed. Where there are no threads, or not enough memory for them, env stays as it is. */
static void zbufrandi_crew_open(zbufrandi_crew *c, zbufrand_env *env) {
    const uint32_t want = env->parallel.for_fn != NULL ? 1 : zbufrandi_thread_count(env);
    pthread_attr_t attr;
    memset(c, 0, sizeof *c);
    if (want < 2 || pthread_attr_init(&attr) != 0) return;
    if (pthread_mutex_init(&c->lock, NULL) == 0) {
        int conds = pthread_cond_init(&c->go, NULL) == 0;
        if (conds && pthread_cond_init(&c->done, NULL) == 0) conds = 2;
        (void)pthread_attr_setstacksize(&attr, 512 * 1024);
        while (conds == 2 && c->started + 1 < want &&
               pthread_create(&c->thread[c->started], &attr, zbufrandi_crew_thread, c) == 0) c->started++;
        if (c->started > 0) {
            env->parallel.for_fn = zbufrandi_crew_for;
            env->parallel.user = c;
        } else {
            if (conds == 2) (void)pthread_cond_destroy(&c->done);
            if (conds > 0) (void)pthread_cond_destroy(&c->go);
            (void)pthread_mutex_destroy(&c->lock);
        }
    }
    (void)pthread_attr_destroy(&attr);
}
#endif

/* What was put into front, until it is empty. */
static zbufrand_result zbufrandi_draw_rounds(zbufrandi_picture *p, uint64_t refresh_after) {
    zbufrand_frame *f = p->f;
    zbufrand_result r;
    while (f->front_count > 0) {
        if (!zbufrandi_picture_asks(p)) return ZBUFRAND_ERR_CANCELLED;
        if (!zbufrandi_round_select(p)) return zbufrandi_no_room(p);
        if (p->cut.independent && f->draw_count > ZBUFRANDI_INDEPENDENT_DRAWS) return ZBUFRAND_ERR_RANGE;
        zbufrandi_lap(p, ZBUFRAND_STAGE_SELECT);
        /* drawn all at once, or not at all */
        if (p->cut.bounds || (p->d->no_occlusion && f->front_count > 0)) continue;
        r = zbufrandi_round_draw(p);
        if (r != ZBUFRAND_OK) return r;
        zbufrandi_lap(p, ZBUFRAND_STAGE_DRAW);
        if (!p->d->no_occlusion && f->front_count > 0 && p->since_refresh >= refresh_after) {
            zbufrandi_pyramid_refresh_all(&f->env, &p->pyramid, &f->recon.canvas,
                                          f->recon.exact != NULL ? &p->exact : NULL, f->level);
            p->cut.pyramid = &p->pyramid;
            p->since_refresh = 0;
            zbufrandi_lap(p, ZBUFRAND_STAGE_OCCLUSION);
        }
    }
    return ZBUFRAND_OK;
}

/* Everything that is to be drawn, into the keys. */
static zbufrand_result zbufrandi_draw_scene(zbufrandi_picture *p) {
    zbufrand_frame *f = p->f;
    const zbufrandi_structure *root;
    /* small boxes are compared with pixels: for the others a pyramid that is a layer old will do */
    const double layers = p->cut.keys != NULL ? (double)p->cut.block : 0.5;
    const uint64_t refresh_after =
        (uint64_t)(layers * p->cut.density * (double)f->recon.width * (double)f->recon.height);
    zbufrandi_lap(p, -1);
    if (!zbufrandi_picture_asks(p)) return ZBUFRAND_ERR_CANCELLED;
    if (f->draw_count == 0 && !p->cut.bounds) {
        zbufrand_result r;
        if (!zbufrandi_add_points(p)) return zbufrandi_no_room(p);
        r = zbufrandi_round_draw(p);
        if (r != ZBUFRAND_OK) return r;
        zbufrandi_lap(p, ZBUFRAND_STAGE_DRAW);
    }
    if (p->scene == NULL || p->scene->structure_count == 0 || p->scene->structure[0].node_count == 0)
        return ZBUFRAND_OK;
    root = &p->scene->structure[0];
    if (!zbufrandi_grow(&f->mem, (void **)&f->local, &f->local_capacity, f->local_count, f->local_count + 1,
                        sizeof *f->local) ||
        !zbufrandi_grow(&f->mem, (void **)&f->front, &f->front_capacity, 0, 1, sizeof *f->front))
            return ZBUFRAND_ERR_NO_MEMORY;
    zbufrandi_local_root(&p->cut.camera, root, p->cut.seed, &f->local[f->local_count]);
    if (root->lists != NULL && !p->d->no_lists && p->cut.hybrid != ZBUFRAND_HYBRID_ALL)
        return zbufrandi_draw_lists(p, (uint32_t)f->local_count++);
    memset(&f->front[0], 0, sizeof f->front[0]);
    f->front[0].local = (uint32_t)f->local_count++;
    f->front_count = 1;
#ifndef ZBUFRAND_NO_THREADS
    {
        zbufrandi_crew crew;
        zbufrand_result r;
        zbufrandi_crew_open(&crew, &f->env);
        r = zbufrandi_draw_rounds(p, refresh_after);
        zbufrandi_crew_close(&crew, &f->env);
        return r;
    }
#else
    return zbufrandi_draw_rounds(p, refresh_after);
#endif
}

/* ---- repair ----

   Of d x d blocks (1: pixels) one that only surfaces which are sampled cover, all of it, gets no sample of them with a
   probability of at most q = exp(-density d^2), n of them that do not overlap none at all with q^n: drawn independently
   or by strata, as many are expected. A pixel that shows something hidden is found when at least 5 of its neighbours
   at a distance of d show what is nearer. So it stays unfound only if 4 of 8 got no sample either, of 70 fours one; an
   empty pixel is found when 4 neighbours are not empty, and stays if 5 are, of 56 fives one. That holds if all that
   has 5 nearer neighbours is found: most of it is right, at the edges of leaves and far hills, but with only what was
   far enough behind for the spread of depths around it, and behind planes through them, up to three of four pictures
   were incomplete. At least 5 because with 6 and 7 the density has to be a quarter and 60 % higher.

   Most suspects are right, and a ray that gets as deep as they are speaks for more than its own pixel: what it sees is
   visible around all the pixels beside it, so that none of them that is no deeper than that is incomplete. So the
   pixel with most suspects around it gets a ray first, and only those it cannot speak for get their own. */

enum { ZBUFRANDI_REPAIR_RAYS = 64, ZBUFRANDI_REPAIR_WRONG = 5, ZBUFRANDI_REPAIR_HOLE = 4, ZBUFRANDI_REPAIR_TILE = 2,
       ZBUFRANDI_REPAIR_AREA = 16,
       /* in the mask of suspects: their kind, another one's ray may speak for it, a ray of its own that may do so */
       ZBUFRANDI_REPAIR_KIND = 63, ZBUFRANDI_REPAIR_SPOKEN = 64, ZBUFRANDI_REPAIR_SPEAKS = 128 };

#if ZBUFRANDI_AVX2
ZBUFRANDI_TARGET_AVX2 static uint32_t zbufrandi_key_depths_avx2(const uint64_t *keys, uint32_t n, uint8_t *out) {
    const __m256i none = _mm256_set1_epi32(0x7f800000);
    uint32_t x, covered = 0;
    for (x = 0; x + 8 <= n; x += 8) {
        const __m256 a = _mm256_castsi256_ps(_mm256_loadu_si256((const __m256i *)(const void *)(keys + x)));
        const __m256 b = _mm256_castsi256_ps(_mm256_loadu_si256((const __m256i *)(const void *)(keys + x + 4)));
        const __m256i high = _mm256_permute4x64_epi64(_mm256_castps_si256(_mm256_shuffle_ps(a, b, 0xdd)), 0xd8);
        const __m256i z = _mm256_min_epu32(high, none);
        const int empty = _mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpeq_epi32(z, none)));
        covered += 8 - zbufrandi_popcount64((uint64_t)(uint32_t)empty);
        _mm256_storeu_si256((__m256i *)(void *)(out + 4 * (size_t)x), z);
    }
    return covered;
}
#endif

/* Depths of keys, INFINITY where there is none. Returns how many there are. */
static uint32_t zbufrandi_key_depths(int level, const uint64_t *keys, uint32_t n, uint8_t *out) {
    uint32_t x = 0, covered = 0;
    (void)level;
#if ZBUFRANDI_AVX2
    if (level >= 3) {
        covered = zbufrandi_key_depths_avx2(keys, n, out);
        x = n & ~7u;
    }
#endif
    for (; x < n; x++) {
        const uint32_t bits = (uint32_t)(keys[x] >> 32) < 0x7f800000u ? (uint32_t)(keys[x] >> 32) : 0x7f800000u;
        memcpy(out + 4 * (size_t)x, &bits, sizeof bits);
        covered += bits < 0x7f800000u;
    }
    return covered;
}

static void zbufrandi_depth_task(void *ctx, uint32_t y) { /* depths of the picture from its keys */
    zbufrandi_picture *p = (zbufrandi_picture *)ctx;
    const zbufrandi_recon *r = &p->f->recon;
    const uint64_t *keys = r->result + (size_t)(y + r->result_guard) * r->result_width + r->result_guard;
    if (p->where != NULL) {
        const uint8_t *area = p->where + (size_t)(y / 16) * ((r->width + 15) / 16);
        uint32_t x, n, covered = 0;
        for (x = 0; x < r->width; x += 16) {
            n = r->width - x < 16 ? r->width - x : 16;
            if (area[x / 16] != 0)
                covered += zbufrandi_key_depths(p->f->level, keys + x, n,
                                                (uint8_t *)(p->f->depth + (size_t)y * r->width + x));
        }
        zbufrandi_tally_add(p->seen, covered);
        return;
    }
    zbufrandi_tally_add(p->seen, zbufrandi_key_depths(p->f->level, keys, r->width,
                                                      (uint8_t *)(p->f->depth + (size_t)y * r->width)));
}

/* Suspects within a block of a pixel that the ray through it speaks for: holes if it is empty itself, else others.
   Returns how many. */
static uint32_t zbufrandi_repair_around(const zbufrandi_picture *p, uint32_t pixel, uint32_t around[25]) {
    const zbufrandi_recon *r = &p->f->recon;
    const int there = p->f->depth[pixel] < (float)INFINITY;
    const int64_t x = pixel % r->width, y = pixel / r->width, d = r->o.block < 2 ? 1 : 2;
    int64_t i, j;
    uint32_t n = 0;
    for (j = y - d; j <= y + d; j++) {
        if (j < 0 || j >= (int64_t)r->height) continue;
        for (i = x - d; i <= x + d; i++) {
            const size_t at = (size_t)j * r->width + (size_t)i;
            if (i < 0 || i >= (int64_t)r->width || (p->f->mask[at] & ZBUFRANDI_REPAIR_KIND) == 0) continue;
            if ((p->f->depth[at] < (float)INFINITY) == there) around[n++] = (uint32_t)at;
        }
    }
    return n;
}

/* The pixel in a suspect's surroundings whose ray speaks for most suspects that nobody speaks for yet: the middle of a
   gap between leaves rather than one of its corners. */
static uint32_t zbufrandi_repair_speaker(const zbufrandi_picture *p, uint32_t pixel) {
    const zbufrandi_recon *r = &p->f->recon;
    const uint8_t *mask = p->f->mask;
    const float *depth = p->f->depth, limit = depth[pixel] * 0.99f;
    const int32_t d = r->o.block < 2 ? 1 : 2, x = (int32_t)(pixel % r->width), y = (int32_t)(pixel / r->width),
        w = (int32_t)r->width, h = (int32_t)r->height;
    uint32_t row[9], best = pixel, most = 0;
    int32_t i, j, k;
    for (j = 0; j <= 4 * d; j++) { /* a bit for each suspect without a speaker, up to two blocks away */
        const int32_t v = y + j - 2 * d;
        row[j] = 0;
        if (v < 0 || v >= h) continue;
        for (i = 0; i <= 4 * d; i++) {
            const int32_t u = x + i - 2 * d;
            if (u < 0 || u >= w) continue;
            k = mask[(size_t)v * r->width + (size_t)u];
            if ((k & ZBUFRANDI_REPAIR_KIND) != 0 && (k & ZBUFRANDI_REPAIR_SPOKEN) == 0) row[j] |= 1u << i;
        }
    }
    for (j = 0; j <= 2 * d; j++) {
        for (i = 0; i <= 2 * d; i++) {
            const int32_t u = x + i - d, v = y + j - d;
            const size_t at = (size_t)v * r->width + (size_t)u;
            uint32_t n = 0;
            if (u < 0 || v < 0 || u >= w || v >= h || !(depth[at] >= limit)) continue;
            if ((depth[at] < (float)INFINITY) != (depth[pixel] < (float)INFINITY)) continue;
            for (k = j; k <= j + 2 * d; k++) n += zbufrandi_popcount64(row[k] >> i & ((2u << 2 * d) - 1u));
            if (n < most || (n == most && mask[at] != 0)) continue;
            most = n;
            best = (uint32_t)at;
        }
    }
    return best;
}

#define ZBUFRANDI_REPAIR_NEARER 0.991 /* room for rounding */

/* How deep the ray through a pixel has to look: as deep as it shows, and all that it speaks for. */
static float zbufrandi_repair_reach(const zbufrandi_picture *p, uint32_t pixel) {
    float most = p->f->depth[pixel];
    uint32_t around[25], n, k;
    if ((p->f->mask[pixel] & ZBUFRANDI_REPAIR_SPEAKS) == 0) return most;
    n = zbufrandi_repair_around(p, pixel, around);
    for (k = 0; k < n; k++) most = p->f->depth[around[k]] > most ? p->f->depth[around[k]] : most;
    return most;
}

static void zbufrandi_repair_task(void *ctx, uint32_t task) { /* rays through suspects */
    zbufrandi_picture *p = (zbufrandi_picture *)ctx;
    zbufrand_frame *f = p->f;
    const zbufrandi_recon *r = &f->recon;
    const zbufrandi_camera *c = &p->cut.camera;
    const size_t begin = (size_t)task * ZBUFRANDI_REPAIR_RAYS, left = f->suspect_count - begin;
    const size_t n = left < ZBUFRANDI_REPAIR_RAYS ? left : (size_t)ZBUFRANDI_REPAIR_RAYS;
    zbufrandi_ray ray[ZBUFRANDI_REPAIR_RAYS];
    uint32_t at[ZBUFRANDI_REPAIR_RAYS];
    size_t i;
    uint32_t a;
    for (i = 0; i < n; i++) {
        const uint32_t pixel = f->suspect[begin + i], x = pixel % r->width + r->guard, y = pixel / r->width + r->guard;
        const double u = ((double)x + 0.5 + (double)p->jitter[0] - c->center_x) / c->focal;
        const double v = (c->center_y - (double)y - 0.5 - (double)p->jitter[1]) / c->focal;
        /* a surface up to 1 % nearer does not make a pixel wrong; most rays need not look at what it shows, then */
        const double shown = ZBUFRANDI_REPAIR_NEARER * (double)zbufrandi_repair_reach(p, pixel);
        at[i] = y * r->canvas.width + x;
        for (a = 0; a < 3; a++) {
            ray[i].o[a] = c->eye[a] - p->scene->structure[0].origin[a];
            ray[i].d[a] = c->dir[a] + u * c->right[a] + v * c->up[a];
        }
        ray[i].t_min = c->near_z;
        ray[i].t_max = zbufrandi_min(c->far_z, shown); /* what is behind does not matter */
    }
    (void)zbufrandi_ray_cast_veiled(p->scene->rays, ray, n, f->hit + begin,
                                    p->cut.veil.opacity != NULL ? &p->cut.veil : NULL, at);
}

/* Local camera of a ray's hit: entered along its path, unless it is the one before. 0: no memory. */
static int zbufrandi_repair_local(zbufrandi_picture *p, const zbufrandi_ray_hit *hit, const zbufrandi_ray_hit *before,
                                  uint32_t *local) {
    zbufrand_frame *f = p->f;
    uint32_t k;
    if (before != NULL && before->levels == hit->levels &&
        memcmp(before->path, hit->path, hit->levels * sizeof *hit->path) == 0) return 1;
    *local = 0;
    for (k = 0; k < hit->levels; k++) {
        zbufrandi_local from;
        if (!zbufrandi_grow(&f->mem, (void **)&f->local, &f->local_capacity, f->local_count, f->local_count + 1,
                            sizeof *f->local)) return 0;
        from = f->local[*local];
        zbufrandi_local_enter(&p->cut, &from, *local, hit->path[k], &f->local[f->local_count]);
        *local = (uint32_t)f->local_count++;
    }
    return 1;
}

/* Were all neighbours of a pixel nearer than it, before rays changed anything? f->depth has that. */
static int zbufrandi_repair_inside(const zbufrandi_picture *p, uint32_t pixel) {
    const zbufrandi_recon *r = &p->f->recon;
    const int64_t x = pixel % r->width, y = pixel / r->width, d = r->o.block;
    int64_t i, j;
    if (x < d || y < d || x + d >= (int64_t)r->width || y + d >= (int64_t)r->height) return 0;
    for (j = y - d; j <= y + d; j += d) {
        for (i = x - d; i <= x + d; i += d) {
            if (i == x && j == y) continue;
            if (!(p->f->depth[(size_t)j * r->width + (size_t)i] < p->f->depth[pixel] * 0.99f)) return 0;
        }
    }
    return 1;
}

/* Put what the rays found into the keys. out_inside: how many changed that all neighbours were nearer than. */
static zbufrand_result zbufrandi_repair_apply(zbufrandi_picture *p, uint32_t *out_inside) {
    zbufrand_frame *f = p->f;
    zbufrandi_recon *r = &f->recon;
    zbufrandi_draw *d;
    const zbufrandi_ray_hit *before = NULL;
    uint32_t local = 0, first = (uint32_t)f->ray_count, count = 0;
    size_t i;
    if (!zbufrandi_grow(&f->mem, (void **)&f->ray_seen, &f->ray_capacity, f->ray_count,
                        f->ray_count + f->suspect_count, sizeof *f->ray_seen) ||
        !zbufrandi_grow(&f->mem, (void **)&f->draw, &f->draw_capacity, f->draw_count, f->draw_count + 1,
                        sizeof *f->draw)) return ZBUFRAND_ERR_NO_MEMORY;
    d = &f->draw[f->draw_count];
    memset(d, 0, sizeof *d);
    d->item = (uint32_t)ZBUFRANDI_DRAW_RAYS << ZBUFRANDI_DRAW_SHIFT | first;
    d->count = (uint32_t)f->suspect_count;
    if (!zbufrandi_number_draw(p, d, (uint32_t)f->draw_count)) return zbufrandi_no_room(p);
    for (i = 0; i < f->suspect_count; i++) {
        const zbufrandi_ray_hit *hit = &f->hit[i];
        const uint32_t x = f->suspect[i] % r->width + r->result_guard, y = f->suspect[i] / r->width + r->result_guard;
        uint64_t *key = &r->result[(size_t)y * r->result_width + x];
        zbufrandi_ray_seen *seen = &f->ray_seen[f->ray_count + count];
        float z = (float)hit->t;
        if (!(hit->t < (double)INFINITY) || !(z > 0.0f) || !(z < 1e37f)) continue;
        if (*key != ZBUFRANDI_EMPTY && !(z < zbufrandi_key_depth(*key) * 0.999f)) continue;
        if (!zbufrandi_repair_local(p, hit, before, &local)) return ZBUFRAND_ERR_NO_MEMORY;
        before = hit;
        *out_inside += (uint32_t)zbufrandi_repair_inside(p, f->suspect[i]);
        seen->depth = z;
        seen->local = local;
        seen->cluster = hit->cluster;
        seen->triangle = hit->triangle - p->scene->structure[hit->structure].cluster[hit->cluster].first_triangle;
        *key = zbufrandi_key(z, (f->draw[f->draw_count].block + p->first_block) * ZBUFRANDI_SET + count);
        count++;
    }
    f->draw_count++;
    p->done_draws = (uint32_t)f->draw_count;
    f->ray_count += count;
    p->stats.repaired += count;
    return ZBUFRAND_OK;
}

/* 2^x and q^n where these may be too small for zbufrandi_exp2: then 0. x <= 0, q <= 1, n >= 0 */
static double zbufrandi_share_exp2(double x) { return x > -999.0 ? zbufrandi_exp2(x) : 0.0; }
static double zbufrandi_share_pow(double q, double n) {
    return q > 0.0 ? zbufrandi_share_exp2(n * zbufrandi_log2(q)) : 0.0;
}

/* Probability that a block gets no sample. */
static double zbufrandi_block_empty(double density, double block) {
    return zbufrandi_share_exp2(-1.4426950408889634 * density * block * block);
}

/* Bound of the probability that a picture of `pixels` covered pixels is wrong somewhere although repaired, when a block
   gets no sample with probability q. */
static double zbufrandi_incomplete(double pixels, double q) {
    const double q2 = q * q;
    return zbufrandi_min(1.0, pixels * q2 * q2 * q * (70.0 + 56.0 * q));
}

/* The same when all of the parts of a pixel have to be wrong: that many blocks of which none overlaps another. 1
   without parts. */
static double zbufrandi_parts_incomplete(const zbufrandi_picture *p, double covered, double q) {
    const double parts = (double)p->parts, block = (double)p->f->recon.o.block;
    if (p->parts <= 1) return 1.0;
    return zbufrandi_min(1.0, covered / parts *
                              zbufrandi_share_pow(q, zbufrandi_max(parts / (block * block), 1.0)));
}

/* What lies among rastered pixels alone is right as it is. Is there a pixel that shows a sample in the tile around this
   one and the eight tiles around it? tile: 0 not looked at yet, 1 no, 2 yes. */
static int zbufrandi_near_samples(const zbufrandi_picture *p, uint8_t *tile, uint32_t pixel) {
    const zbufrand_frame *f = p->f;
    const zbufrandi_recon *r = &f->recon;
    const uint32_t wide = (r->width + ZBUFRANDI_REPAIR_TILE - 1) / ZBUFRANDI_REPAIR_TILE,
        high = (r->height + ZBUFRANDI_REPAIR_TILE - 1) / ZBUFRANDI_REPAIR_TILE,
        tx = pixel % r->width / ZBUFRANDI_REPAIR_TILE, ty = pixel / r->width / ZBUFRANDI_REPAIR_TILE;
    uint32_t i, j, x, y;
    for (j = ty > 0 ? ty - 1 : 0; j <= ty + 1 && j < high; j++) {
        for (i = tx > 0 ? tx - 1 : 0; i <= tx + 1 && i < wide; i++) {
            uint8_t *t = &tile[(size_t)j * wide + i];
            const uint32_t x1 = (i + 1) * ZBUFRANDI_REPAIR_TILE, y1 = (j + 1) * ZBUFRANDI_REPAIR_TILE;
            if (*t == 0) {
                *t = 1;
                for (y = j * ZBUFRANDI_REPAIR_TILE; y < y1 && y < r->height && *t == 1; y++) {
                    const uint64_t *key = r->result + (size_t)(y + r->result_guard) * r->result_width + r->result_guard;
                    for (x = i * ZBUFRANDI_REPAIR_TILE; x < x1 && x < r->width; x++) {
                        uint32_t block;
                        if (key[x] == ZBUFRANDI_EMPTY) continue;
                        block = ((zbufrandi_key_number(key[x]) >> 6) - p->first_block) & 0x3ffffffu;
                        block = f->draw[f->block_draw[block]].item >> ZBUFRANDI_DRAW_SHIFT;
                        if (block == ZBUFRANDI_DRAW_RASTERED || block == ZBUFRANDI_DRAW_LISTED_RASTER) continue;
                        *t = 2;
                        break;
                    }
                }
            }
            if (*t == 2) return 1;
        }
    }
    return 0;
}

static size_t zbufrandi_repair_tiles(const zbufrandi_recon *r) {
    return ((size_t)r->width / ZBUFRANDI_REPAIR_TILE + 1) * ((size_t)r->height / ZBUFRANDI_REPAIR_TILE + 1);
}

/* ---- where samples are, if they are few ---- */

/* So many draws of samples are few: 1024, or one for so many pixels. To mark one takes as long as to look at ten. */
enum { ZBUFRANDI_REPAIR_FEW = 1024, ZBUFRANDI_REPAIR_FEW_PIXELS = 64 };

/* The rectangle of a draw in the picture, `margin` pixels wider: areas there get a 1. */
static void zbufrandi_area_mark(const zbufrandi_picture *p, const zbufrandi_draw *d, float margin, uint8_t *area) {
    const zbufrandi_recon *r = &p->f->recon;
    const zbufrandi_local *l = &p->f->local[d->local];
    const uint32_t wide = (r->width + 15) / 16, index = d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u);
    const zbufrandi_cluster *c = d->item >> ZBUFRANDI_DRAW_SHIFT == ZBUFRANDI_DRAW_SAMPLED
        ? &p->scene->structure[l->structure].cluster[index] : NULL;
    float q[3], e[3], from[2] = {0, 0}, to[2] = {0, 0};
    uint32_t a, k, x, y, lo[2], hi[2];
    for (a = 0; a < 3; a++) {
        const float first = c != NULL ? c->box_lo[a] : d->lo[a];
        const float last = c != NULL ? c->box_hi[a] : d->lo[a] + d->step[a] * (a == 0 ? 2048.0f : 1024.0f);
        e[a] = (last - first) * 0.5f + (zbufrandi_absf(first) + zbufrandi_absf(last)) * 1.2e-7f;
        q[a] = (first + last) * 0.5f - l->eye[a];
    }
    for (a = 0; a < 2; a++) {
        const float size = (float)(int32_t)(a == 0 ? r->width : r->height) - 1.0f;
        const float focal = a == 0 ? p->cut.focal : 0.0f - p->cut.focal;
        const float center = (a == 0 ? p->cut.center_x : p->cut.center_y) - (float)(int32_t)r->guard;
        const float at = (l->m[a][0] * q[0] + l->m[a][1] * q[1] + l->m[a][2] * q[2] + l->rest[a]) * focal;
        const float reach = (zbufrandi_absf(l->m[a][0]) * e[0] + zbufrandi_absf(l->m[a][1]) * e[1] +
                             zbufrandi_absf(l->m[a][2]) * e[2]) * p->cut.focal * 1.00001f;
        for (k = 0; k < 2; k++) {
            const float z = k == 0 ? d->z_lo : d->z_hi, s = (at - reach) / z, t = (at + reach) / z;
            from[a] = k == 0 || s < from[a] ? s : from[a];
            to[a] = k == 0 || t > to[a] ? t : to[a];
        }
        from[a] = from[a] + center - margin;
        to[a] = to[a] + center + margin;
        from[a] = from[a] > 0.0f ? from[a] : 0.0f; /* NaN: all of it */
        to[a] = to[a] < size ? to[a] : size;
        if (!(from[a] <= to[a])) return; /* beside the picture */
        lo[a] = (uint32_t)(int32_t)from[a] / 16;
        hi[a] = (uint32_t)(int32_t)to[a] / 16;
    }
    for (y = lo[1]; y <= hi[1]; y++)
        for (x = lo[0]; x <= hi[0]; x++) area[(size_t)y * wide + x] = 1;
}

/* Only pixels near samples can be wrong: p->where says where these may be, if their draws are few, as where nearly all
   is rastered or little of the picture is covered; NULL if they may be anywhere. Returns how many pixels are there. */
static size_t zbufrandi_repair_areas(zbufrandi_picture *p, uint8_t *area) {
    const zbufrand_frame *f = p->f;
    const zbufrandi_recon *r = &f->recon;
    const uint32_t wide = (r->width + 15) / 16, high = (r->height + 15) / 16, block = r->o.block;
    const size_t few = (size_t)r->width * r->height / ZBUFRANDI_REPAIR_FEW_PIXELS;
    size_t i, n = 0;
    uint32_t x, y, u, v;
    p->where = NULL;
    if (p->stats.draws[0] + p->stats.draws[1] > (few > ZBUFRANDI_REPAIR_FEW ? few : (size_t)ZBUFRANDI_REPAIR_FEW) ||
        block > 8 || p->d->points_count != 0) return (size_t)r->width * r->height;
    memset(area, 0, (size_t)wide * high);
    for (i = 0; i < f->draw_count; i++) {
        const uint32_t kind = f->draw[i].item >> ZBUFRANDI_DRAW_SHIFT;
        if (kind >= ZBUFRANDI_DRAW_POINTS) return (size_t)r->width * r->height;
        if (kind <= ZBUFRANDI_DRAW_SAMPLED)
            zbufrandi_area_mark(p, &f->draw[i], 8.0f + 2.0f * (float)(int32_t)block, area);
    }
    for (y = 0; y < high; y++) {
        for (x = 0; x < wide; x++) {
            if (area[(size_t)y * wide + x] != 1) continue;
            n += 256;
            for (v = y > 0 ? y - 1 : 0; v <= y + 1 && v < high; v++)
                for (u = x > 0 ? x - 1 : 0; u <= x + 1 && u < wide; u++)
                    if (area[(size_t)v * wide + u] == 0) area[(size_t)v * wide + u] = 2;
        }
    }
    p->where = area;
    return n < (size_t)r->width * r->height ? n : (size_t)r->width * r->height;
}

/* Pixels that rays are cast for, by areas of 16 x 16: rays that go the same way share packets. */
static zbufrand_result zbufrandi_find_suspects(zbufrandi_picture *p) {
    zbufrand_frame *f = p->f;
    const zbufrandi_recon *r = &f->recon;
    const size_t n = (size_t)r->width * r->height, tiles = zbufrandi_repair_tiles(r);
    size_t at;
    uint32_t x0, y0, y;
    zbufrandi_suspects s;
    memset(f->mask + n, 0, tiles);
    memset(&s, 0, sizeof s);
    s.depth = f->depth;
    s.mask = f->mask;
    s.width = r->width;
    s.height = r->height;
    s.keep = 0.99f;
    s.hole_count = ZBUFRANDI_REPAIR_HOLE;
    s.wrong_count = ZBUFRANDI_REPAIR_WRONG;
    s.reach = r->o.block;
    s.sure = 1;
    s.level = f->level;
    s.area = p->where;
    zbufrandi_parallel_for(&f->env, zbufrandi_suspect_task, &s, (s.height + 15) / 16);
    zbufrandi_suspect_round(&s, 1);
    for (y0 = 0; y0 < r->height; y0 += ZBUFRANDI_REPAIR_AREA) {
        for (x0 = 0; x0 < r->width; x0 += ZBUFRANDI_REPAIR_AREA) {
            if (p->where != NULL && p->where[(size_t)(y0 / 16) * ((r->width + 15) / 16) + x0 / 16] == 0) continue;
            for (y = y0; y < r->height && y < y0 + ZBUFRANDI_REPAIR_AREA; y++) {
                const size_t row = (size_t)y * r->width,
                    end = row + (r->width - x0 < ZBUFRANDI_REPAIR_AREA ? r->width : x0 + ZBUFRANDI_REPAIR_AREA);
                for (at = row + x0; (at = zbufrandi_next_mark(f->mask, at, end)) < end; at++) {
                    if (p->stats.rastered != 0 && !zbufrandi_near_samples(p, f->mask + n, (uint32_t)at)) {
                        f->mask[at] = 0;
                        continue;
                    }
                    if (!zbufrandi_grow(&f->mem, (void **)&f->suspect, &f->suspect_capacity, f->suspect_count,
                                        f->suspect_count + 1, sizeof *f->suspect)) return ZBUFRAND_ERR_NO_MEMORY;
                    f->suspect[f->suspect_count++] = (uint32_t)at;
                }
            }
        }
    }
    return zbufrandi_grow(&f->mem, (void **)&f->suspect, &f->suspect_capacity, f->suspect_count, 2 * f->suspect_count,
                          sizeof *f->suspect) &&
           zbufrandi_grow(&f->mem, (void **)&f->hit, &f->hit_capacity, 0, f->suspect_count, sizeof *f->hit)
        ? ZBUFRAND_OK : ZBUFRAND_ERR_NO_MEMORY;
}

/* Cast the rays of the list and put what they find into the keys. */
static zbufrand_result zbufrandi_repair_cast(zbufrandi_picture *p, uint32_t *out_inside) {
    zbufrand_frame *f = p->f;
    size_t i;
    if (f->suspect_count == 0) return ZBUFRAND_OK;
    for (i = 0; i < f->suspect_count; i++) {
        if (f->depth[f->suspect[i]] < (float)INFINITY) p->stats.wrong++;
        else p->stats.holes++;
    }
    if (!zbufrandi_picture_for(p, zbufrandi_repair_task, p,
                               (uint32_t)((f->suspect_count + ZBUFRANDI_REPAIR_RAYS - 1) / ZBUFRANDI_REPAIR_RAYS)))
        return ZBUFRAND_ERR_CANCELLED;
    return zbufrandi_repair_apply(p, out_inside);
}

/* All suspects: some get rays, which speak for others; then those that are left. */
static zbufrand_result zbufrandi_repair_suspects(zbufrandi_picture *p, uint32_t *out_inside) {
    zbufrand_frame *f = p->f;
    const size_t all = f->suspect_count;
    uint32_t *list, around[25], n, k;
    size_t i, rays = 0;
    zbufrand_result result;
    if (all == 0) return ZBUFRAND_OK;
    list = f->suspect + all;
    memcpy(list, f->suspect, all * sizeof *list);
    for (i = 0; i < all; i++) {
        uint32_t from;
        if ((f->mask[list[i]] & (ZBUFRANDI_REPAIR_SPOKEN | ZBUFRANDI_REPAIR_SPEAKS)) != 0) continue;
        from = zbufrandi_repair_speaker(p, list[i]);
        n = zbufrandi_repair_around(p, from, around);
        for (k = 0; k < n; k++) f->mask[around[k]] |= ZBUFRANDI_REPAIR_SPOKEN;
        f->mask[from] |= ZBUFRANDI_REPAIR_SPEAKS;
        f->suspect[rays++] = from;
    }
    f->suspect_count = rays;
    result = zbufrandi_repair_cast(p, out_inside);
    if (result != ZBUFRAND_OK) return result;
    for (i = 0; i < rays; i++) {
        const float seen = (float)f->hit[i].t; /* INFINITY: nothing as far as it had to look */
        const uint32_t from = f->suspect[i];
        n = zbufrandi_repair_around(p, from, around);
        for (k = 0; k < n; k++) {
            if ((f->mask[around[k]] & ZBUFRANDI_REPAIR_SPEAKS) == 0 && f->depth[around[k]] <= seen * 1.009f)
                f->mask[around[k]] &= (uint8_t)~(uint32_t)ZBUFRANDI_REPAIR_SPOKEN;
        }
    }
    for (i = 0, rays = 0; i < all; i++) {
        if ((f->mask[list[i]] & (ZBUFRANDI_REPAIR_SPOKEN | ZBUFRANDI_REPAIR_SPEAKS)) == ZBUFRANDI_REPAIR_SPOKEN)
            f->suspect[rays++] = list[i];
    }
    f->suspect_count = rays;
    return zbufrandi_repair_cast(p, out_inside);
}

/* Find suspects, send rays, say how complete the picture is then, or the mean of that many. density: of all passes. */
static zbufrand_result zbufrandi_repair(zbufrandi_picture *p, double density, uint32_t frames) {
    zbufrand_frame *f = p->f;
    const zbufrandi_recon *r = &f->recon;
    const double block = (double)r->o.block;
    const size_t n = (size_t)r->width * r->height, tiles = zbufrandi_repair_tiles(r);
    const size_t areas = (size_t)((r->width + 15) / 16) * ((r->height + 15) / 16);
    size_t sampled;
    uint64_t covered = p->stats.repaired;
    uint32_t inside = 0;
    double failed, q;
    zbufrand_result result = ZBUFRAND_OK;
    if (!zbufrandi_grow(&f->mem, (void **)&f->depth, &f->depth_capacity, 0, n, sizeof *f->depth) ||
        !zbufrandi_grow(&f->mem, (void **)&f->mask, &f->mask_capacity, 0, n + tiles + areas, 1))
            return ZBUFRAND_ERR_NO_MEMORY;
    f->suspect_count = 0;
    p->seen[0] = p->seen[1] = 0;
    sampled = zbufrandi_repair_areas(p, f->mask + n + tiles);
    zbufrandi_parallel_for(&f->env, zbufrandi_depth_task, p, r->height);
    result = zbufrandi_find_suspects(p);
    if (result != ZBUFRAND_OK) return result;
    result = zbufrandi_repair_suspects(p, &inside);
    if (result != ZBUFRAND_OK) return result;
    covered = p->stats.repaired - covered + zbufrandi_tally(p->seen); /* holes are among the first */
    if (p->where != NULL && p->stats.rastered != 0) covered = sampled; /* else those that have a sample */
    /* What the density promises, or more if more had failed than that: four standard deviations more of those whose
       neighbours show that they lie within a surface. Others were changed because it covers a part of them. */
    q = zbufrandi_block_empty(density, block);
    failed = (double)inside - 4.0 * sqrt((double)inside);
    q = zbufrandi_max(q, failed / (zbufrandi_max((double)covered, 1.0) * (1.0 - zbufrandi_min(8.0 * q, 0.5))));
    q = zbufrandi_min(q, 1.0);
    p->stats.incomplete = zbufrandi_min(zbufrandi_incomplete((double)covered, zbufrandi_share_pow(q, (double)frames)),
                                        zbufrandi_parts_incomplete(p, (double)covered, q));
    zbufrandi_lap(p, ZBUFRAND_STAGE_REPAIR);
    return ZBUFRAND_OK;
}

/* ---- colours ---- */

typedef struct zbufrandi_paint {
    zbufrandi_picture *p;
    float *rgba;                       /* of result size; NULL: not kept */
    int colors;                        /* somebody wants them */
    int last;                          /* no filter comes after: write them out at once */
    uint32_t rows;                     /* of a task */
    uint32_t covered[2];
} zbufrandi_paint;

enum { ZBUFRANDI_PAINT_ROWS = 8 };

static uint8_t *zbufrandi_row(void *base, size_t stride, size_t pixel, uint32_t width, uint32_t y) {
    return (uint8_t *)base + (size_t)y * (stride != 0 ? stride : pixel * width);
}

/* Pixels x..x+count-1 of row y of the result. */
static void zbufrandi_paint_run(const zbufrandi_picture *p, const uint64_t *keys, uint32_t x, uint32_t y,
                                uint32_t count, float *rgba) {
    const zbufrandi_recon *r = &p->f->recon;
    const uint32_t shift = r->guard - r->result_guard;
    uint32_t numbers[ZBUFRANDI_SHADE_RUN], at[ZBUFRANDI_SHADE_RUN], n = 0, i;
    float rays[ZBUFRANDI_SHADE_RUN][3];
    zbufrandi_look_at found[ZBUFRANDI_SHADE_RUN];
    for (i = 0; i < count; i++) {
        if (keys[i] == ZBUFRANDI_EMPTY) continue;
        numbers[n] = zbufrandi_key_number(keys[i]);
        rays[n][0] = ((float)(int32_t)(x + i + shift) + 0.5f + p->jitter[0] - p->target.center_x) *
            p->target.inverse_focal;
        rays[n][1] = (p->target.center_y - (float)(int32_t)(y + shift) - 0.5f - p->jitter[1]) * p->target.inverse_focal;
        rays[n][2] = 1.0f;
        at[n++] = i;
    }
    if (n == 0) return;
    zbufrandi_find_surfaces(&p->drawn, numbers, (const float (*)[3])rays, n, found);
    for (i = 0; i < n && p->image->node != NULL; i++) {
        const uint32_t px = x + at[i] - r->result_guard, py = y - r->result_guard,
            node = zbufrandi_surface_node(&p->drawn, &found[i]);
        if (px < r->width && py < r->height)
            memcpy(zbufrandi_row(p->image->node, p->image->node_stride, 4, r->width, py) + 4 * (size_t)px, &node, 4);
    }
    if (p->look.shade_fn != NULL) {
        zbufrand_surface surface[ZBUFRANDI_SHADE_RUN];
        float out[4 * ZBUFRANDI_SHADE_RUN];
        for (i = 0; i < n; i++) {
            uint32_t px = x + at[i] - r->result_guard, py = y - r->result_guard;
            zbufrandi_public_surface(&p->drawn, &found[i], zbufrandi_key_depth(keys[at[i]]),
                                     px < r->width && py < r->height ? py * r->width + px : ~0u, &surface[i]);
        }
        p->look.shade_fn(p->look.shade_user, surface, n, out);
        for (i = 0; i < n; i++) memcpy(rgba + 4 * at[i], out + 4 * i, 4 * sizeof *out);
    } else {
        for (i = 0; i < n; i++) zbufrandi_look_shade(&p->look, &found[i], rgba + 4 * at[i]);
    }
}

/* Slopes and sides of the samples in the canvas, for reconstructions that want them. */
static void zbufrandi_slope_task(void *ctx, uint32_t y) {
    zbufrandi_picture *p = (zbufrandi_picture *)ctx;
    zbufrandi_recon *r = &p->f->recon;
    const uint64_t *keys = r->canvas.key + (size_t)y * r->canvas.width;
    const size_t row = (size_t)y * r->canvas.width;
    uint32_t x, i, n;
    for (x = 0; x < r->canvas.width; x += ZBUFRANDI_SHADE_RUN) {
        uint32_t numbers[ZBUFRANDI_SHADE_RUN], at[ZBUFRANDI_SHADE_RUN];
        float rays[ZBUFRANDI_SHADE_RUN][3];
        zbufrandi_look_at found[ZBUFRANDI_SHADE_RUN];
        for (i = 0, n = 0; i < ZBUFRANDI_SHADE_RUN && x + i < r->canvas.width; i++) {
            if (keys[x + i] == ZBUFRANDI_EMPTY) continue;
            numbers[n] = zbufrandi_key_number(keys[x + i]);
            rays[n][0] = ((float)(int32_t)(x + i) + 0.5f - p->target.center_x) * p->target.inverse_focal;
            rays[n][1] = (p->target.center_y - (float)(int32_t)y - 0.5f) * p->target.inverse_focal;
            rays[n][2] = 1.0f;
            at[n++] = x + i;
        }
        zbufrandi_find_surfaces(&p->drawn, numbers, (const float (*)[3])rays, n, found);
        for (i = 0; i < n; i++) { /* 1/z = n . ray / n . p */
            const float *f = found[i].face, *ray = rays[i];
            const float d = f[0] * ray[0] + f[1] * ray[1] + f[2] * ray[2];
            const float k = p->target.inverse_focal / (d * zbufrandi_key_depth(keys[at[i]]));
            if (r->slope_x != NULL) {
                r->slope_x[row + at[i]] = f[0] * k;
                r->slope_y[row + at[i]] = 0.0f - f[1] * k;
            }
            if (r->back != NULL) r->back[row + at[i]] = d > 0.0f;
            if (r->tint != NULL) {
                float rgba[4];
                zbufrandi_look_shade(&p->look, &found[i], rgba);
                memcpy(r->tint + 3 * (row + at[i]), rgba, 3 * sizeof *rgba);
            }
        }
    }
}

/* ---- output ---- */

/* Linear and premultiplied -> sRGB bytes, not premultiplied. */
static void zbufrandi_color_bytes(const zbufrandi_srgb *srgb, const float rgba[4], uint8_t out[4]) {
    float v[4];
    uint32_t a;
    memcpy(v, rgba, sizeof v);
    if (v[3] > 0.0f && v[3] < 1.0f) {
        for (a = 0; a < 3; a++) v[a] /= v[3];
    }
    for (a = 0; a < 3; a++) out[a] = zbufrandi_srgb_byte(srgb, v[a]);
    out[3] = v[3] >= 1.0f ? 255u : v[3] > 0.0f ? (uint8_t)(v[3] * 255.0f + 0.5f) : 0u;
}

/* Finished pixels x..x+count-1 of row y of the picture. */
static void zbufrandi_write_colors(const zbufrandi_picture *p, uint32_t x, uint32_t y, uint32_t count,
                                   const float *rgba) {
    const zbufrand_image *m = p->image;
    const zbufrandi_look *look = &p->look;
    uint32_t i, a;
    uint8_t *out = m->rgba8 != NULL ? zbufrandi_row(m->rgba8, m->rgba8_stride, 4, m->width, y) + 4 * (size_t)x : NULL;
    uint8_t *raw = m->rgba != NULL ? zbufrandi_row(m->rgba, m->rgba_stride, 16, m->width, y) + 16 * (size_t)x : NULL;
    for (i = 0; i < count; i++, rgba += 4) {
        float v[4];
        memcpy(v, rgba, sizeof v);
        if (v[0] == 0.0f && v[1] == 0.0f && v[2] == 0.0f && v[3] == 0.0f) { /* nothing */
            if (raw != NULL) memcpy(raw + 16 * (size_t)i, look->background, sizeof look->background);
            if (out != NULL) memcpy(out + 4 * i, look->background8, 4);
            continue;
        }
        if (!look->transparent) for (a = 0; a < 4; a++) v[a] += look->background[a] * (1.0f - v[3]);
        if (raw != NULL) memcpy(raw + 16 * (size_t)i, v, sizeof v);
        if (out != NULL) zbufrandi_color_bytes(&p->f->srgb, v, out + 4 * i);
    }
}

/* Depths and meshes of row y of the picture, from its keys. Returns the number of pixels that show something. */
static uint64_t zbufrandi_write_keys(const zbufrandi_picture *p, uint32_t y, const uint64_t *keys) {
    const zbufrand_image *m = p->image;
    uint64_t covered = 0;
    uint32_t x;
    uint8_t *out = m->depth != NULL ? zbufrandi_row(m->depth, m->depth_stride, 4, m->width, y) : NULL;
    if (out != NULL) covered = zbufrandi_key_depths(p->f->level, keys, m->width, out);
    for (x = 0; x < m->width && out == NULL; x++) covered += keys[x] != ZBUFRANDI_EMPTY;
    for (x = 0; x < m->width && m->node != NULL; x++) {
        if (keys[x] == ZBUFRANDI_EMPTY)
            memset(zbufrandi_row(m->node, m->node_stride, 4, m->width, y) + 4 * (size_t)x, 0, 4);
    }
    return covered;
}

static void zbufrandi_paint_task(void *ctx, uint32_t task) {
    zbufrandi_paint *c = (zbufrandi_paint *)ctx;
    const zbufrandi_picture *p = c->p;
    const zbufrandi_recon *r = &p->f->recon;
    uint32_t y = task * c->rows, end = y + c->rows, x, i, w = r->result_width;
    uint64_t covered = 0;
    if (end > r->result_height) end = r->result_height;
    for (; y < end; y++) {
        const uint64_t *keys = r->result + (size_t)y * w;
        for (x = 0; x < w && c->colors; x += ZBUFRANDI_SHADE_RUN) {
            float local[4 * ZBUFRANDI_SHADE_RUN], *rgba = c->rgba != NULL ? c->rgba + 4 * ((size_t)y * w + x) : local;
            uint32_t n = w - x < ZBUFRANDI_SHADE_RUN ? w - x : (uint32_t)ZBUFRANDI_SHADE_RUN;
            for (i = 0; i < n && keys[x + i] == ZBUFRANDI_EMPTY; i++) { }
            memset(rgba, 0, 16 * (size_t)n);
            if (i < n) zbufrandi_paint_run(p, keys + x, x, y, n, rgba);
            if (!c->last) continue;
            if (i == n && p->look.transparent && p->image->rgba == NULL) {
                if (p->image->rgba8 != NULL)
                    memset(zbufrandi_row(p->image->rgba8, p->image->rgba8_stride, 4, w, y) + 4 * (size_t)x, 0,
                           4 * (size_t)n);
            } else {
                zbufrandi_write_colors(p, x, y, n, rgba);
            }
        }
        if (y >= r->result_guard && y < r->result_guard + r->height) {
            covered += zbufrandi_write_keys(p, y - r->result_guard, keys + r->result_guard);
        }
    }
    zbufrandi_tally_add(c->covered, covered);
}

static void zbufrandi_output_task(void *ctx, uint32_t y) {
    const zbufrandi_picture *p = ((zbufrandi_paint *)ctx)->p;
    zbufrandi_write_colors(p, 0, y, p->image->width, p->f->color + (size_t)y * p->image->width * 4);
}

/* ---- opening a picture ---- */

/* ns on the machine that this was written on, by least squares over the clusters of five scenes */
static const zbufrand_costs zbufrandi_default_costs = {4.0f, 1.5f, 1.5f, 5.5f, 6.5f, 60.0f, 3.5f, 2000.0f, 200.0f};

static float zbufrandi_cost(float v, float otherwise) { return v > 0.0f ? v : otherwise; }

static zbufrand_result zbufrandi_open_lights(zbufrandi_picture *p) {
    static const float place[2][3] = {{-0.75f, 0.85f, -0.6f}, {0.9f, -0.05f, -0.5f}};
    static const float color[2][3] = {{0.76f, 0.74f, 0.7f}, {0.1f, 0.115f, 0.14f}};
    const zbufrand_render_desc *d = p->d;
    const zbufrandi_camera *c = &p->cut.camera;
    zbufrand_frame *f = p->f;
    size_t n = d->lights != NULL ? d->light_count : 2, i;
    uint32_t a;
    if (n > 0xffff) {
        p->told = 1;
        return zbufrandi_fail(f->env.error, ZBUFRAND_ERR_RANGE, n, "render: % lights are more than 65535");
    }
    if (!zbufrandi_grow(&f->mem, (void **)&f->light, &f->light_capacity, 0, n, sizeof *f->light) ||
        !zbufrandi_grow(&f->mem, (void **)&f->directional, &f->directional_capacity, 0, n, 1))
            return ZBUFRAND_ERR_NO_MEMORY;
    for (i = 0; i < n; i++) {
        double v[3], q[3];
        f->directional[i] = d->lights == NULL || d->lights[i].directional != 0;
        for (a = 0; a < 3; a++) f->light[i][3 + a] = d->lights == NULL ? color[i][a] : d->lights[i].color[a];
        if (d->lights == NULL) {
            for (a = 0; a < 3; a++) v[a] = (double)place[i][a];
        } else {
            double far_off = 0.0;
            for (a = 0; a < 3; a++) {
                if (!zbufrandi_finite(d->lights[i].position[a]) || !zbufrandi_finite_f(d->lights[i].color[a]))
                    return ZBUFRAND_ERR_INVALID_ARG;
                q[a] = d->lights[i].position[a] - (f->directional[i] ? 0.0 : c->eye[a]);
                q[a] = zbufrandi_min(zbufrandi_max(q[a], -1e300), 1e300);
                far_off = zbufrandi_max(far_off, zbufrandi_abs(q[a]));
            }
            if (f->directional[i]) zbufrandi_direction(q);
            else if (far_off > 1e37) for (a = 0; a < 3; a++) q[a] *= 1e37 / far_off; /* beyond all that is drawn */
            v[0] = q[0] * c->right[0] + q[1] * c->right[1] + q[2] * c->right[2];
            v[1] = q[0] * c->up[0] + q[1] * c->up[1] + q[2] * c->up[2];
            v[2] = q[0] * c->dir[0] + q[1] * c->dir[1] + q[2] * c->dir[2];
        }
        if (f->directional[i]) (void)zbufrandi_unit(v);
        for (a = 0; a < 3; a++) f->light[i][a] = (float)v[a];
    }
    p->look.light = f->light;
    p->look.directional = f->directional;
    p->look.light_count = (uint32_t)n;
    p->look.transparent = 1;
    for (a = 0; a < 3; a++) p->look.ambient[a] = d->ambient[a];
    if (d->ambient[0] == 0.0f && d->ambient[1] == 0.0f && d->ambient[2] == 0.0f) {
        for (a = 0; a < 3; a++) p->look.ambient[a] = 0.05f;
    }
    for (a = 0; a < 4; a++) {
        if (!zbufrandi_finite_f(d->background[a]) || (a < 3 && !zbufrandi_finite_f(d->ambient[a])))
            return ZBUFRAND_ERR_INVALID_ARG;
        p->look.background[a] = d->background[a];
        p->look.transparent &= d->background[a] == 0.0f;
    }
    zbufrandi_color_bytes(&f->srgb, p->look.background, p->look.background8);
    p->look.unlit = d->unlit != 0;
    p->look.shade_fn = d->shade_fn;
    p->look.shade_user = d->shade_user;
    return ZBUFRAND_OK;
}

/* Samples per square pixel. */
/* One of several frames, which together have to be complete. Most frames are wrong in some pixel then, of a million in
   seven with strata and rays; with half of these samples it would be 2 of 100, which no mean takes out. */
enum { ZBUFRANDI_MEAN_DENSITY = 2 };
static int zbufrandi_shares_samples(const zbufrand_render_desc *d) {
    return d->noise > 0.0 && !(d->tolerance > 0.0) && !(d->density > 0.0) && !d->no_repair;
}

/* Less is nothing that 1 - tolerance can say. */
static double zbufrandi_tolerance(const zbufrand_render_desc *d) {
    return d->tolerance > 0.0 ? zbufrandi_max(d->tolerance, 1e-15) : 0.05;
}

static double zbufrandi_choose_density(const zbufrandi_picture *p) {
    const zbufrand_render_desc *d = p->d;
    const double block = d->reconstruct.block != 0 ? (double)d->reconstruct.block : 1.0, parts = (double)p->parts;
    const double pixels = (double)p->image->width * (double)p->image->height;
    const double tolerance = zbufrandi_tolerance(d);
    double density;
    if (d->density > 0.0) return d->density;
    if (d->no_repair) density = zbufrand_density(pixels, block, 1.0 - tolerance);
    else if (zbufrandi_shares_samples(d)) density = (double)ZBUFRANDI_MEAN_DENSITY / (block * block);
    /* zbufrandi_incomplete is at most the tolerance then: 70 + 56 q is below 80 */
    else density = zbufrandi_max(0.2 * 0.6931471805599453 * zbufrandi_log2(80.0 * pixels / tolerance), 2.0) /
            (block * block);
    if (p->parts > 1) /* one of the parts of a pixel that is right is enough; fewer samples than that look no better */
        density = zbufrandi_min(density, zbufrandi_max(zbufrand_density(pixels / parts, 1.0, 1.0 - tolerance) / parts,
                                                       1.0 / (block * block)));
    return density;
}

static void zbufrandi_set_density(zbufrandi_picture *p) {
    const zbufrand_costs *c = &p->d->costs;
    /* stratified samples leave a share of about exp(-1.6 density) of the pixels to the rays */
    double block = (double)p->f->recon.o.block,
        rays = zbufrandi_exp2(-2.3 * zbufrandi_min(p->cut.density * block * block, 100.0)) / p->cut.density;
    const zbufrand_costs *o = &zbufrandi_default_costs;
    const float ray = p->d->no_repair ? 0.0f : zbufrandi_cost(c->ray, o->ray) * (float)rays;
    p->cut.density_f2 = (float)(p->cut.density * p->cut.camera.focal * p->cut.camera.focal);
    p->cut.triangle = zbufrandi_cost(c->triangle, o->triangle);
    p->cut.edge = zbufrandi_cost(c->edge, o->edge);
    p->cut.pixel = zbufrandi_cost(c->pixel, o->pixel) / (float)p->cut.density;
    p->cut.cluster = zbufrandi_cost(c->cluster, o->cluster);
    p->cut.sample = zbufrandi_cost(c->sample, o->sample) + ray;
    p->cut.set_cost = zbufrandi_cost(c->set, o->set);
    p->cut.stored_cost = zbufrandi_cost(c->stored, o->stored) + ray;
    p->cut.list_sample = zbufrandi_cost(c->listed, o->listed) + ray;
}

/* All but camera, lights, background, reconstruction and the rules of the thesis, which are checked where they are
   taken. */
static int zbufrandi_render_desc_ok(const zbufrand_render_desc *d) {
    size_t i;
    if ((uint32_t)d->hybrid > ZBUFRAND_HYBRID_LARGE || !(d->tolerance >= 0.0 && d->tolerance < 1.0) ||
        !(d->density >= 0.0 && d->density < 1e6) || !(d->noise >= 0.0) || !(d->hybrid_radius >= 0.0) ||
        (d->lights == NULL && d->light_count != 0) || (d->points == NULL && d->points_count != 0) ||
        (d->opacity == NULL && d->opacity_count != 0) || (d->spread & (d->spread - 1u)) != 0) return 0;
    for (i = 0; i < d->opacity_count; i++) if (!(d->opacity[i] >= 0.0f && d->opacity[i] <= 1.0f)) return 0;
    for (i = 0; i < d->points_count; i++)
        if (d->points[i].positions == NULL && d->points[i].count != 0) return 0;
    return 1;
}

static zbufrand_result zbufrandi_open_picture(zbufrandi_picture *p) {
    const zbufrand_render_desc *d = p->d;
    zbufrand_frame *f = p->f;
    zbufrand_result r;
    size_t bytes;
    uint32_t h = zbufrandi_hash32(d->seed ^ zbufrandi_hash32(d->frame + 0x9e3779b9u));
    double spread = d->spread != 0 ? (double)d->spread : 1.0;
    zbufrand_reconstruct o = d->reconstruct;
    int same = f->recon_open && memcmp(&f->recon_asked, &d->reconstruct, sizeof d->reconstruct) == 0 &&
               f->recon.width == p->image->width && f->recon.height == p->image->height;
    if (!zbufrandi_render_desc_ok(d) || !zbufrandi_list_rules(d, p->scene, &p->cut)) return ZBUFRAND_ERR_INVALID_ARG;
    if (p->image->width > ZBUFRANDI_RASTER_MAX_SIZE || p->image->height > ZBUFRANDI_RASTER_MAX_SIZE)
        return ZBUFRAND_ERR_RANGE;
    if (!same) {
        if (f->recon_open) zbufrandi_recon_close(&f->mem, &f->recon);
        f->recon_open = 0;
        if (o.reach == 0) o.reach = o.block != 0 ? 2 * o.block : 2u; /* or there is no background left */
        r = zbufrandi_recon_open(&f->mem, &f->env, f->isa, &o, p->image->width, p->image->height, 1, &f->recon);
        p->told = r != ZBUFRAND_OK;
        if (r != ZBUFRAND_OK) return r;
        f->recon_open = 1;
        f->recon_asked = d->reconstruct;
    }
    r = zbufrandi_camera_open(&d->camera, p->scene, p->image->width, p->image->height, f->recon.guard, &p->cut.camera);
    if (r != ZBUFRAND_OK) return r;
    p->raster_camera = p->cut.camera;
    if (d->noise > 0.0 || d->spread > 1) { /* the mean of many frames is antialiased: places of the R2 sequence */
        const uint32_t place = zbufrandi_hash32(d->seed + 2);
        p->jitter[0] = zbufrandi_unit24(place + d->frame * 3242174889u) - 0.5f;
        p->jitter[1] = zbufrandi_unit24(zbufrandi_hash32(place) + d->frame * 2447445414u) - 0.5f;
        p->raster_camera.center_x -= (double)p->jitter[0];
        p->raster_camera.center_y -= (double)p->jitter[1];
    }
    r = zbufrandi_open_lights(p);
    if (r != ZBUFRAND_OK) return r;
    p->cut.scene = p->scene;
    p->cut.focal = (float)p->cut.camera.focal;
    p->cut.center_x = (float)p->cut.camera.center_x;
    p->cut.center_y = (float)p->cut.camera.center_y;
    if (!d->no_occlusion && f->recon.o.block <= 2 && f->recon.o.occlusion == ZBUFRAND_OCCLUSION_BLOCKS) {
        p->cut.keys = &f->recon.canvas;
        p->cut.exact = f->recon.exact;
        p->cut.block = f->recon.o.block;
    }
    p->cut.density = zbufrandi_choose_density(p);
    zbufrandi_set_density(p);
    p->cut.stored = (float)(64.0 / spread);
    p->cut.most = (float)zbufrandi_min(zbufrandi_max(1e6, 64.0 * p->cut.density * (double)p->cut.camera.width *
                                                     (double)p->cut.camera.height), 4e8);
    p->cut.runs = spread < 64.0 ? (uint32_t)spread : 64u;
    p->cut.run = d->frame & (p->cut.runs - 1u);
    p->cut.near_z = (float)p->cut.camera.near_z;
    p->cut.far_z = (float)zbufrandi_min(p->cut.camera.far_z, 1e37);
    p->cut.hybrid = d->hybrid;
    p->cut.cube = (float)d->hybrid_radius;
    p->cut.independent = d->independent != 0;
    p->cut.round_up = d->round_up != 0;
    p->cut.corners = d->corners != 0;
    p->cut.comb = d->comb != 0;
    p->cut.seed = h;
    p->cut.veil.scene = p->scene;
    p->cut.veil.opacity = d->opacity;
    p->cut.veil.count = (uint32_t)(d->opacity_count < 0xffffffffu ? d->opacity_count : 0xffffffffu);
    p->cut.veil.seed = zbufrandi_hash32(h + 2);
    p->cut.level = f->level;
    p->target.cut = &p->cut;
    p->target.keys = f->recon.canvas;
    p->target.width = (float)f->recon.canvas.width;
    p->target.height = (float)f->recon.canvas.height;
    p->target.center_x = (float)p->cut.camera.center_x;
    p->target.center_y = (float)p->cut.camera.center_y;
    p->target.focal = p->cut.camera.focal;
    p->target.inverse_focal = (float)(1.0 / p->cut.camera.focal);
    p->target.far_z = p->cut.far_z;
    p->target.plane = !d->no_plane_depth;
    p->target.thin = !d->no_thinning;
    p->target.level = f->level;
    p->target.early = !d->no_occlusion;
    p->target.exclusive = f->env.parallel.for_fn == NULL && zbufrandi_thread_count(&f->env) == 1;
    p->exact = f->recon.canvas;
    if (f->recon.exact != NULL) p->exact.key = f->recon.exact;
    p->first_block = zbufrandi_hash32(h + 1) & 0x3ffffffu;
    f->recon.asker = &p->asker;
    zbufrandi_recon_clear(&f->recon);
    bytes = zbufrandi_pyramid_bytes(f->recon.canvas.width, f->recon.canvas.height);
    if (!zbufrandi_grow(&f->mem, &f->pyramid_memory, &f->pyramid_capacity, 0, bytes, 1)) return ZBUFRAND_ERR_NO_MEMORY;
    zbufrandi_pyramid_begin(&p->pyramid, f->pyramid_memory, f->recon.canvas.width, f->recon.canvas.height,
                            f->recon.o.occlusion == ZBUFRAND_OCCLUSION_BLOCKS ? f->recon.o.block : 1u);
    f->front_count = f->draw_count = f->local_count = f->block_count = f->aux_count = f->aux_written = f->ray_count = 0;
    return ZBUFRAND_OK;
}

static void zbufrandi_open_drawn(zbufrandi_picture *p) {
    const zbufrand_frame *f = p->f;
    uint32_t i;
    p->drawn.scene = p->scene;
    p->drawn.camera = &p->cut.camera;
    p->drawn.draw = f->draw;
    p->drawn.local = f->local;
    p->drawn.block_draw = f->block_draw;
    p->drawn.aux = f->aux;
    p->drawn.seen = f->ray_seen;
    p->drawn.points = p->d->points;
    p->drawn.first_block = p->first_block;
    p->drawn.srgb = &f->srgb;
    p->drawn.level = f->level;
    p->drawn.need_places = p->look.shade_fn != NULL;
    for (i = 0; i < p->look.light_count; i++) p->drawn.need_places |= !p->look.directional[i];
}

/* Draw, look how complete it is, draw more if the wanted probability is not reached. */
static zbufrand_result zbufrandi_draw_picture(zbufrandi_picture *p) {
    const zbufrand_render_desc *d = p->d;
    zbufrandi_recon *r = &p->f->recon;
    double pixels = (double)p->image->width * (double)p->image->height, block = (double)r->o.block,
        density = p->cut.density;
    double tolerance = zbufrandi_tolerance(d);
    uint32_t pass;
    zbufrand_result result;
    p->first_density = density;
    for (pass = 0;; pass++) {
        double failed, wanted;
        p->pass = pass;
        result = zbufrandi_draw_scene(p);
        if (result != ZBUFRAND_OK) return result;
        zbufrandi_open_drawn(p);
        if (r->slope_x != NULL || r->back != NULL || r->tint != NULL)
            (void)zbufrandi_picture_for(p, zbufrandi_slope_task, p, r->canvas.height);
        zbufrandi_recon_keys(r);
        if (p->asker.cancelled) return ZBUFRAND_ERR_CANCELLED; /* keys are what they were before */
        p->stats.incomplete = zbufrandi_min(1.0 - zbufrand_success_bound(density, pixels, block),
            zbufrandi_parts_incomplete(p, pixels, zbufrandi_block_empty(density, block)));
        if (p->stats.draws[0] + p->stats.draws[1] == 0) p->stats.incomplete = 0.0;
        if (d->no_repair || p->scene == NULL || p->stats.draws[0] + p->stats.draws[1] == 0) break;
        /* a pixel covered with a margin expects 27 or more: with so few there is none, nearly all is rastered */
        if (zbufrandi_tally(p->stored) + zbufrandi_tally(p->sampled) < 8 && density * block * block >= 3.0) {
            p->stats.incomplete = zbufrandi_min(p->stats.incomplete, 1e-4);
            break;
        }
        if (zbufrandi_shares_samples(d)) {
            result = zbufrandi_repair(p, density, p->stats.frames);
            if (result != ZBUFRAND_OK) return result;
            break;
        }
        result = zbufrandi_repair(p, density, 1);
        if (result != ZBUFRAND_OK) return result;
        if (p->stats.incomplete <= tolerance || d->density > 0.0 || pass == 3) break;
        /* the share that failed falls like exp(-density): how much density is missing */
        failed = zbufrandi_pow(p->stats.incomplete / (80.0 * pixels), 0.2);
        wanted = zbufrandi_pow(tolerance / (80.0 * pixels), 0.2);
        p->cut.density = density * (zbufrandi_log2(wanted) / zbufrandi_log2(zbufrandi_min(failed, 0.9)) - 1.0) * 1.1;
        p->cut.density = zbufrandi_min(zbufrandi_max(p->cut.density, 0.25 * density), 4.0 * density);
        density += p->cut.density;
        zbufrandi_set_density(p);
        p->cut.seed = zbufrandi_hash32(p->cut.seed + 0x9e3779b9u);
    }
    p->stats.density = density;
    return ZBUFRAND_OK;
}

static zbufrand_result zbufrandi_finish_picture(zbufrandi_picture *p) {
    zbufrand_frame *f = p->f;
    zbufrandi_recon *r = &f->recon;
    const zbufrand_image *m = p->image;
    zbufrandi_paint paint;
    zbufrandi_open_drawn(p);
    memset(&paint, 0, sizeof paint);
    paint.p = p;
    paint.colors = p->keep || m->rgba != NULL || m->rgba8 != NULL || m->node != NULL;
    paint.rgba = r->color;
    paint.last = r->color == NULL && !p->keep;
    if ((p->keep || r->color != NULL) &&
        !zbufrandi_grow(&f->mem, (void **)&f->color, &f->color_capacity, 0, (size_t)m->width * m->height * 4,
                        sizeof *f->color)) {
        return ZBUFRAND_ERR_NO_MEMORY;
    }
    if (p->keep && r->color == NULL) paint.rgba = f->color; /* the result has the size of the picture then */
    paint.rows = p->look.light_count <= 64 ? ZBUFRANDI_PAINT_ROWS : 1;
    (void)zbufrandi_picture_for(p, zbufrandi_paint_task, &paint, (r->result_height + paint.rows - 1) / paint.rows);
    if (paint.colors && r->color != NULL) zbufrandi_recon_colors(r, f->color);
    if (p->asker.cancelled) return ZBUFRAND_ERR_CANCELLED;
    if (paint.colors && r->color != NULL) {
        if (!p->keep) zbufrandi_parallel_for(&f->env, zbufrandi_output_task, &paint, m->height);
    }
    p->stats.covered = zbufrandi_tally(paint.covered);
    zbufrandi_lap(p, ZBUFRAND_STAGE_SHADE);
    return ZBUFRAND_OK;
}

/* One frame, or as many as the noise asks for. d: the desc, whose frame and spread change. */
static zbufrand_result zbufrandi_render_frames(zbufrandi_picture *p, zbufrand_render_desc *d) {
    zbufrand_frame *f = p->f;
    const zbufrand_image *m = p->image;
    const uint32_t frames = d->max_frames != 0 ? d->max_frames : 256, first = d->frame;
    zbufrand_accumulator_desc ad;
    zbufrandi_paint paint;
    zbufrand_noise noise;
    zbufrand_result r = ZBUFRAND_OK;
    uint32_t i;
    p->stats.frames = 1;
    if (!(d->noise > 0.0)) {
        r = zbufrandi_open_picture(p);
        if (r == ZBUFRAND_OK) r = zbufrandi_draw_picture(p);
        return r == ZBUFRAND_OK ? zbufrandi_finish_picture(p) : r;
    }
    if (f->accumulator != NULL && (f->accumulator_width != m->width || f->accumulator_height != m->height)) {
        if (f->mem.limit != 0) f->mem.limit += f->accumulator->mem.used;
        zbufrand_accumulator_destroy(f->accumulator);
        f->accumulator = NULL;
    }
    if (f->accumulator == NULL) {
        const size_t limit = f->mem.limit, used = zbufrandi_atomic_load(&f->mem.used);
        memset(&ad, 0, sizeof ad);
        ad.env = f->env;
        if (limit != 0) ad.env.memory_limit = limit > used ? limit - used : 1; /* one limit for both */
        ad.width = m->width;
        ad.height = m->height;
        r = zbufrand_accumulator_create(&ad, &f->accumulator);
        if (r != ZBUFRAND_OK || f->accumulator == NULL) return r;
        if (limit != 0) f->mem.limit = limit - f->accumulator->mem.used;
        f->accumulator_width = m->width;
        f->accumulator_height = m->height;
    }
    zbufrand_accumulator_clear(f->accumulator);
    p->keep = 1;
    /* The first four frames tell how many will be needed; that many share out the stored points. Frames that had
       points in common would look less noisy than their mean is wrong. */
    d->spread = 4;
    for (i = 0; i < frames; i++) {
        if (i == 4) {
            const double wanted = p->stats.rmse / d->noise, more = 4.0 * wanted * wanted;
            while (d->spread < ZBUFRANDI_SET && (double)d->spread < more && d->spread < frames) d->spread *= 2;
        }
        d->frame = first + i;
        p->stats.frames = i + 1;
        r = zbufrandi_open_picture(p);
        if (r == ZBUFRAND_OK) r = zbufrandi_draw_picture(p);
        if (r == ZBUFRAND_OK) r = zbufrandi_finish_picture(p);
        if (r == ZBUFRAND_OK) r = zbufrand_accumulator_add(f->accumulator, f->color, NULL, NULL);
        if (r != ZBUFRAND_OK) return r;
        if (i < 3) continue;
        r = zbufrand_accumulator_noise(f->accumulator, d->noise, &noise);
        if (r != ZBUFRAND_OK) return r;
        p->stats.rmse = noise.rmse;
        if (noise.rmse <= d->noise) break;
    }
    r = zbufrand_accumulator_get(f->accumulator, 0.0f, f->color);
    if (r != ZBUFRAND_OK) return r;
    memset(&paint, 0, sizeof paint);
    paint.p = p;
    zbufrandi_parallel_for(&f->env, zbufrandi_output_task, &paint, m->height);
    return ZBUFRAND_OK;
}

static zbufrand_result zbufrandi_render(zbufrand_frame *frame, zbufrand_render_desc *d, const zbufrand_scene *scene,
                                        const zbufrand_image *image, uint32_t parts, zbufrand_stats *stats) {
    zbufrandi_picture *p = frame->picture;
    zbufrand_result r;
    memset(p, 0, sizeof *p);
    p->f = frame;
    p->d = d;
    p->parts = parts;
    p->scene = scene;
    p->image = image;
    r = zbufrandi_render_frames(p, d);
    p->stats.triangles = scene != NULL ? scene->info.triangles : 0;
    p->stats.accepted = zbufrandi_tally(p->accepted);
    p->stats.samples[0] = zbufrandi_tally(p->stored);
    p->stats.samples[1] = zbufrandi_tally(p->sampled);
    p->stats.points = zbufrandi_tally(p->points);
    if (p->first_density > 0.0) {
        p->stats.projected_area = (double)zbufrandi_tally(p->area[0]) / p->first_density +
            (double)zbufrandi_tally(p->area[1]);
    }
    if (p->stats.frames > 1) p->stats.projected_area /= (double)p->stats.frames;
    p->stats.bytes = zbufrandi_atomic_load(&frame->mem.used);
    if (frame->accumulator != NULL) p->stats.bytes += frame->accumulator->mem.used;
    if (stats != NULL) *stats = p->stats;
    if (r != ZBUFRAND_OK && p->told) return r;
    if (r == ZBUFRAND_ERR_RANGE)
        return zbufrandi_fail(frame->env.error, r, 0, p->cut.independent && /* set after sizes are checked */
                              frame->draw_count > ZBUFRANDI_INDEPENDENT_DRAWS
            ? "render: independent samples of so many instances need one of the thesis' trees"
            : "render: the picture is too large, or takes more than 2^32 samples");
    if (r == ZBUFRAND_ERR_CANCELLED) return zbufrandi_fail(frame->env.error, r, 0, "render: cancelled");
    if (r != ZBUFRAND_OK)
        return zbufrandi_fail(frame->env.error, r, 0, r == ZBUFRAND_ERR_INVALID_ARG
            ? "render: a camera, light, cloud or option is wrong" : zbufrand_result_string(r));
    return ZBUFRAND_OK;
}

/* ---- oversampling ---- */

enum { ZBUFRANDI_OVERSAMPLE_MAX = 16 };

typedef struct zbufrandi_shrink {
    const zbufrandi_srgb *srgb;
    const zbufrand_image *from, *to;   /* from: rows lie close together */
    uint32_t k;
} zbufrandi_shrink;

static void zbufrandi_shrink_task(void *ctx, uint32_t y) {
    const zbufrandi_shrink *s = (const zbufrandi_shrink *)ctx;
    const zbufrand_image *to = s->to;
    const size_t wide = s->from->width;
    const float share = 1.0f / (float)(int32_t)(s->k * s->k);
    uint8_t *raw = to->rgba != NULL ? zbufrandi_row(to->rgba, to->rgba_stride, 16, to->width, y) : NULL,
        *bytes = to->rgba8 != NULL ? zbufrandi_row(to->rgba8, to->rgba8_stride, 4, to->width, y) : NULL,
        *depth = to->depth != NULL ? zbufrandi_row(to->depth, to->depth_stride, 4, to->width, y) : NULL,
        *nodes = to->node != NULL ? zbufrandi_row(to->node, to->node_stride, 4, to->width, y) : NULL;
    uint32_t x, i, j, a;
    for (x = 0; x < to->width; x++) {
        const size_t corner = (size_t)y * s->k * wide + (size_t)x * s->k;
        float sum[4] = {0.0f, 0.0f, 0.0f, 0.0f}, nearest = INFINITY;
        uint32_t node = 0;
        for (j = 0; j < s->k; j++) {
            const size_t row = corner + j * wide;
            for (i = 0; i < s->k; i++) {
                if (s->from->rgba != NULL) for (a = 0; a < 4; a++) sum[a] += s->from->rgba[4 * (row + i) + a];
                if (s->from->depth == NULL || !(s->from->depth[row + i] < nearest)) continue;
                nearest = s->from->depth[row + i];
                if (s->from->node != NULL) node = s->from->node[row + i];
            }
        }
        for (a = 0; a < 4; a++) sum[a] *= share;
        if (raw != NULL) memcpy(raw + 16 * (size_t)x, sum, 16);
        if (bytes != NULL) zbufrandi_color_bytes(s->srgb, sum, bytes + 4 * (size_t)x);
        if (depth != NULL) memcpy(depth + 4 * (size_t)x, &nearest, 4);
        if (nodes != NULL) memcpy(nodes + 4 * (size_t)x, &node, 4);
    }
}

/* The picture oversample times as large, then each pixel from its part of it. */
static zbufrand_result zbufrandi_render_larger(zbufrand_frame *f, zbufrand_render_desc *d, const zbufrand_scene *scene,
                                               const zbufrand_image *image, zbufrand_stats *stats) {
    zbufrandi_shrink s;
    zbufrand_image from;
    zbufrand_result r;
    double start = 0.0;
    size_t pixels;
    const int nodes = image->node != NULL, depths = nodes || image->depth != NULL;
    const int colors = image->rgba != NULL || image->rgba8 != NULL;
    if (d->oversample > ZBUFRANDI_OVERSAMPLE_MAX)
        return zbufrandi_fail(f->env.error, ZBUFRAND_ERR_INVALID_ARG, 0, "render: oversample is above 16");
    if (image->width > ZBUFRANDI_RASTER_MAX_SIZE / d->oversample ||
        image->height > ZBUFRANDI_RASTER_MAX_SIZE / d->oversample)
        return zbufrandi_fail(f->env.error, ZBUFRAND_ERR_RANGE, 0, "render: the picture is too large for oversample");
    memset(&from, 0, sizeof from);
    s.k = d->oversample;
    from.width = image->width * s.k;
    from.height = image->height * s.k;
    pixels = (size_t)from.width * from.height;
    if ((colors && !zbufrandi_grow(&f->mem, (void **)&f->large, &f->large_capacity, 0, 4 * pixels, sizeof *f->large)) ||
        (depths && !zbufrandi_grow(&f->mem, (void **)&f->large_depth, &f->large_depth_capacity, 0, pixels,
                                   sizeof *f->large_depth)) ||
        (nodes && !zbufrandi_grow(&f->mem, (void **)&f->large_node, &f->large_node_capacity, 0, pixels,
                                  sizeof *f->large_node)))
        return zbufrandi_fail(f->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "render: no memory for the larger picture");
    if (colors) from.rgba = f->large;
    if (depths) from.depth = f->large_depth;
    if (nodes) from.node = f->large_node;
    r = zbufrandi_render(f, d, scene, &from, s.k * s.k, stats);
    if (r != ZBUFRAND_OK) return r;
    if (d->clock_fn != NULL) start = d->clock_fn(d->clock_user);
    s.srgb = &f->srgb;
    s.from = &from;
    s.to = image;
    zbufrandi_parallel_for(&f->env, zbufrandi_shrink_task, &s, image->height);
    if (d->clock_fn != NULL && stats != NULL)
        stats->seconds[ZBUFRAND_STAGE_SHADE] += d->clock_fn(d->clock_user) - start;
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_render(zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                             const zbufrand_scene *scene, const zbufrand_image *image,
                                             zbufrand_stats *stats) {
    zbufrand_render_desc d;
    if (stats != NULL) memset(stats, 0, sizeof *stats);
    if (frame == NULL || image == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    if (image->width == 0 || image->height == 0) return ZBUFRAND_OK;
    if (d.oversample > 1) return zbufrandi_render_larger(frame, &d, scene, image, stats);
    return zbufrandi_render(frame, &d, scene, image, 1, stats);
}

/* ---------------------------------------------------------------------------
   costs: what raster and samples take on this machine.                          // >>costs

   The model of zbufrandi_pick_child, solved for its constants: times of drawing a plane across the view in several
   sizes and densities, each in one way only.
   --------------------------------------------------------------------------- */

enum { ZBUFRANDI_MEASURE_SIDE = 180, ZBUFRANDI_MEASURE_SIZE = 400, ZBUFRANDI_MEASURE_ROUNDS = 9 };

typedef struct zbufrandi_measure {
    zbufrand_scene *scene;
    zbufrand_frame *frame;
    zbufrand_render_desc d;
    zbufrand_stats stats;      /* of the last picture */
    zbufrand_result result;    /* the first failure */
} zbufrandi_measure;

/* A plane of 2 x 2, a little rough, towards +z. */
static void zbufrandi_measure_plane(float *position, uint32_t *index) {
    const uint32_t n = ZBUFRANDI_MEASURE_SIDE;
    uint32_t i, j, k = 0;
    for (j = 0; j <= n; j++) {
        for (i = 0; i <= n; i++) {
            float *p = position + 3 * ((size_t)j * (n + 1) + i);
            const uint32_t h = zbufrandi_hash32(j * 1009u + i);
            p[0] = ((float)(int32_t)i + 0.3f * zbufrandi_unit24(h)) * (2.0f / 180.0f) - 1.0f;
            p[1] = ((float)(int32_t)j + 0.3f * zbufrandi_unit24(zbufrandi_hash32(h))) * (2.0f / 180.0f) - 1.0f;
            p[2] = 0.001f * zbufrandi_unit24(h * 3u);
        }
    }
    for (j = 0; j < n; j++) {
        for (i = 0; i < n; i++) {
            const uint32_t a = j * (n + 1) + i, b = a + n + 1;
            index[k++] = a;
            index[k++] = a + 1;
            index[k++] = b + 1;
            index[k++] = a;
            index[k++] = b + 1;
            index[k++] = b;
        }
    }
}

static zbufrand_result zbufrandi_measure_open(zbufrandi_measure *m, const zbufrand_frame_desc *desc) {
    const size_t n = ZBUFRANDI_MEASURE_SIDE;
    zbufrand_frame_desc fd;
    zbufrand_scene_desc sd;
    zbufrandi_mem mem;
    zbufrand_mesh mesh;
    float *position;
    uint32_t *index;
    memset(&fd, 0, sizeof fd);
    memset(&sd, 0, sizeof sd);
    memset(&mesh, 0, sizeof mesh);
    if (desc != NULL) fd = *desc;
    fd.env.thread_count = 1;
    fd.env.parallel.for_fn = NULL;
    fd.env.progress_fn = NULL;
    m->result = zbufrand_frame_create(&fd, &m->frame);
    if (m->result != ZBUFRAND_OK) return m->result;
    sd.env = fd.env;
    m->result = zbufrand_scene_create(&sd, &m->scene);
    if (m->result != ZBUFRAND_OK) return m->result;
    (void)zbufrandi_env_open(&fd.env, &mem);
    position = (float *)zbufrandi_alloc(&mem, 3 * (n + 1) * (n + 1) * sizeof *position);
    index = (uint32_t *)zbufrandi_alloc(&mem, 6 * n * n * sizeof *index);
    m->result = ZBUFRAND_ERR_NO_MEMORY;
    if (position != NULL && index != NULL) {
        zbufrandi_measure_plane(position, index);
        mesh.positions = position;
        mesh.vertex_count = (n + 1) * (n + 1);
        mesh.indices = index;
        mesh.triangle_count = 2 * n * n;
        m->result = zbufrand_add_mesh(m->scene, ZBUFRAND_ROOT, NULL, 0, &mesh, NULL);
        if (m->result == ZBUFRAND_OK) m->result = zbufrand_scene_build(m->scene, NULL, NULL);
    }
    zbufrandi_free(&mem, position);
    zbufrandi_free(&mem, index);
    return m->result;
}

/* Nanoseconds for drawing the plane with `cell` pixels for an edge of its squares: the least of some rounds. */
static double zbufrandi_measure_draw(zbufrandi_measure *m, double cell, double density, zbufrand_hybrid hybrid,
                                     float no_sets, float no_clusters) {
    zbufrand_image image;
    double least = 1e30;
    uint32_t i;
    memset(&image, 0, sizeof image);
    image.width = image.height = ZBUFRANDI_MEASURE_SIZE; /* keys stay in the caches, as those of a cluster do */
    m->d.camera.eye[2] = 0.001 + 2.7474774194546221 * (double)ZBUFRANDI_MEASURE_SIZE /
        (cell * (double)ZBUFRANDI_MEASURE_SIDE);
    m->d.density = density;
    m->d.hybrid = hybrid;
    m->d.costs.set = no_sets;
    m->d.costs.cluster = m->d.costs.sample = no_clusters;
    for (i = 0; i < ZBUFRANDI_MEASURE_ROUNDS && m->result == ZBUFRAND_OK; i++) {
        m->result = zbufrand_render(m->frame, &m->d, m->scene, &image, &m->stats);
        if (i > 0) least = zbufrandi_min(least, m->stats.seconds[ZBUFRAND_STAGE_DRAW]);
    }
    return 1e9 * zbufrandi_max(least, 1e-9);
}

/* Two costs from two times: t = n0 x + n1 y. Times are noisy: neither gets less than a twentieth of its share by
   default. */
static void zbufrandi_measure_two(const double t[2], const double n[2][2], double x0, double y0, float *x, float *y) {
    const double det = n[0][0] * n[1][1] - n[0][1] * n[1][0], all = t[0] + t[1];
    const double scale = all / ((n[0][0] + n[1][0]) * x0 + (n[0][1] + n[1][1]) * y0);
    double a = zbufrandi_abs(det) > 0.0 ? (t[0] * n[1][1] - t[1] * n[0][1]) / det : 0.0;
    a = zbufrandi_min(zbufrandi_max(a, 0.05 * scale * x0), 0.95 * all / zbufrandi_max(n[0][0] + n[1][0], 1.0));
    *x = (float)a;
    *y = (float)zbufrandi_max((all - a * (n[0][0] + n[1][0])) / zbufrandi_max(n[0][1] + n[1][1], 1.0),
                              0.05 * scale * y0);
}

ZBUFRAND_DEF zbufrand_result zbufrand_measure_costs(const zbufrand_frame_desc *desc, double (*clock_fn)(void *user),
                                                    void *clock_user, zbufrand_costs *out_costs) {
    static const double cell[3] = {0.4, 2.2, 7.0};
    const zbufrand_costs *o = &zbufrandi_default_costs;
    zbufrandi_measure m;
    zbufrand_costs c;
    double t[3], n[3][2];
    uint32_t i;
    if (out_costs == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    memset(out_costs, 0, sizeof *out_costs);
    if (clock_fn == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    memset(&m, 0, sizeof m);
    memset(&c, 0, sizeof c);
    if (zbufrandi_measure_open(&m, desc) == ZBUFRAND_OK) {
        m.d.no_occlusion = m.d.no_repair = 1;
        m.d.clock_fn = clock_fn;
        m.d.clock_user = clock_user;
        for (i = 0; i < 3; i++) { /* rastered: triangles, their longest edges, pixels */
            t[i] = zbufrandi_measure_draw(&m, cell[i], 1.0, ZBUFRAND_HYBRID_ALL, 0.0f, 0.0f);
            n[i][0] = (double)m.stats.rastered;
            n[i][1] = m.stats.projected_area;
        }
        { /* tiny ones cost what a triangle costs; what is left of the others is edges and pixels */
            double rest[2], of[2][2];
            c.triangle = (float)zbufrandi_max(t[0] / zbufrandi_max(n[0][0], 1.0) - 1.5 * cell[0] * 1.5, 0.1);
            for (i = 0; i < 2; i++) {
                rest[i] = zbufrandi_max(t[i + 1] - n[i + 1][0] * (double)c.triangle, 1.0);
                of[i][0] = n[i + 1][0] * zbufrandi_min(1.5 * cell[i + 1], 12.0);
                of[i][1] = n[i + 1][1];
            }
            zbufrandi_measure_two(rest, (const double (*)[2])of, (double)o->edge, (double)o->pixel, &c.edge, &c.pixel);
        }
        for (i = 0; i < 2; i++) { /* clusters sampled: triangles, samples */
            t[i] = zbufrandi_measure_draw(&m, 2.2, i == 0 ? 0.5 : 6.0, ZBUFRAND_HYBRID_OFF, 1e9f, 1e-3f);
            n[i][0] = zbufrandi_max((double)(2 * ZBUFRANDI_MEASURE_SIDE * ZBUFRANDI_MEASURE_SIDE), 1.0);
            n[i][1] = (double)m.stats.samples[1];
        }
        zbufrandi_measure_two(t, (const double (*)[2])n, (double)o->cluster, (double)o->sample, &c.cluster, &c.sample);
        for (i = 0; i < 2; i++) { /* stored points, 9 and 50 of each cluster: sets, samples */
            t[i] = zbufrandi_measure_draw(&m, 0.4, i == 0 ? 0.9 : 5.0, ZBUFRAND_HYBRID_OFF, 1e-3f, 1e9f);
            n[i][0] = (double)m.stats.draws[0];
            n[i][1] = (double)m.stats.samples[0];
        }
        zbufrandi_measure_two(t, (const double (*)[2])n, (double)o->set, (double)o->stored, &c.set, &c.stored);
        c.ray = o->ray * (c.stored / o->stored);
        c.listed = o->listed * (c.stored / o->stored);
    }
    zbufrand_frame_destroy(m.frame);
    zbufrand_scene_destroy(m.scene);
    if (m.result == ZBUFRAND_OK) *out_costs = c;
    return m.result;
}

/* ---------------------------------------------------------------------------
   query: what a picture would be made of: the cut as a list, samples as a       // >>query
   stream.
   --------------------------------------------------------------------------- */

/* Open a picture without buffers and select everything, hidden or not. */
static zbufrand_result zbufrandi_query_open(zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                            zbufrand_render_desc *d,
                                            const zbufrand_scene *scene, zbufrand_image *image,
                                                zbufrandi_picture **out) {
    zbufrandi_picture *p;
    zbufrand_result r;
    *out = NULL;
    memset(d, 0, sizeof *d);
    if (desc != NULL) *d = *desc;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    if (frame == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (image->width == 0 || image->height == 0)
        return zbufrandi_fail(frame->env.error, ZBUFRAND_ERR_INVALID_ARG, 0, "query: a picture without pixels");
    d->no_occlusion = 1;
    d->points_count = 0;
    d->points = NULL;
    p = frame->picture;
    memset(p, 0, sizeof *p);
    p->f = frame;
    p->d = d;
    p->scene = scene;
    p->image = image;
    p->cut.bounds = 1;
    r = zbufrandi_open_picture(p);
    if (r == ZBUFRAND_OK) r = zbufrandi_draw_scene(p);
    if (r != ZBUFRAND_OK && p->told) return r;
    if (r == ZBUFRAND_ERR_CANCELLED) return zbufrandi_fail(frame->env.error, r, 0, "query: cancelled");
    if (r != ZBUFRAND_OK) return zbufrandi_fail(frame->env.error, r, 0, zbufrand_result_string(r));
    p->stats.triangles = scene != NULL ? scene->info.triangles : 0;
    p->stats.density = p->cut.density;
    zbufrandi_open_drawn(p);
    *out = p;
    return ZBUFRAND_OK;
}

/* A draw and the child it came from. */
static void zbufrandi_query_group(const zbufrandi_picture *p, const zbufrandi_draw *d, zbufrand_group *g) {
    const zbufrandi_local *l = &p->f->local[d->local];
    const zbufrandi_structure *s = &p->scene->structure[l->structure];
    const uint32_t kind = d->item >> ZBUFRANDI_DRAW_SHIFT, index = d->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u);
    const double f2 = p->cut.camera.focal * p->cut.camera.focal;
    const zbufrandi_bounds *b = &p->f->bounds[d - p->f->draw];
    memset(g, 0, sizeof *g);
    g->kind = (zbufrand_draw_kind)kind;
    g->structure = l->structure;
    g->triangles = b->triangles;
    g->area = (double)b->area;
    g->z_min = (double)d->z_lo;
    g->z_max = (double)d->z_hi;
    g->factor_max = d->z_lo >= p->cut.near_z
        ? f2 * (double)b->h / ((double)d->z_lo * (double)d->z_lo * (double)d->z_lo) : (double)INFINITY;
    g->factor_min = f2 * (double)b->h_min / ((double)d->z_hi * (double)d->z_hi * (double)d->z_hi);
    g->expected = d->aux & ZBUFRANDI_STORED_VIEW && kind == ZBUFRANDI_DRAW_STORED
        ? (double)b->expected : p->cut.density * g->area * g->factor_max;
    if (!(g->z_min <= g->z_max)) { /* out of the range of floats: nothing is known */
        g->z_min = g->factor_min = 0.0;
        g->z_max = g->factor_max = (double)INFINITY;
    }
    if (!(g->factor_min >= 0.0)) g->factor_min = 0.0;
    if (!(g->expected >= 0.0)) g->expected = (double)INFINITY;
    g->count = d->count;
    if (kind >= ZBUFRANDI_DRAW_LISTED) {
        g->kind = kind == ZBUFRANDI_DRAW_LISTED ? ZBUFRAND_DRAW_SAMPLED : ZBUFRAND_DRAW_RASTERED;
        g->child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NONE, index);
    } else if (kind != ZBUFRANDI_DRAW_STORED) {
        g->child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_CLUSTER, index);
    } else if (index < s->cluster_count) {
        g->child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_CLUSTER, index);
    } else if ((index == s->cluster_count || d->aux & ZBUFRANDI_STORED_VIEW) && l->instance != ~0u) {
        /* the root of a structure: the instance as a whole */
        g->structure = p->f->local[l->parent].structure;
        g->child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_INSTANCE, l->instance);
    } else {
        g->child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, index - s->cluster_count);
    }
}

ZBUFRAND_DEF zbufrand_result zbufrand_select(zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                             const zbufrand_scene *scene, uint32_t width, uint32_t height,
                                             zbufrand_group *groups, size_t capacity, size_t *out_count,
                                             zbufrand_stats *stats) {
    zbufrand_render_desc d;
    zbufrand_image image;
    zbufrandi_picture *p;
    zbufrand_result r;
    size_t i, n;
    if (stats != NULL) memset(stats, 0, sizeof *stats);
    if (out_count == NULL || (groups == NULL && capacity != 0)) return ZBUFRAND_ERR_INVALID_ARG;
    *out_count = 0;
    memset(&image, 0, sizeof image);
    image.width = width;
    image.height = height;
    r = zbufrandi_query_open(frame, desc, &d, scene, &image, &p);
    if (r != ZBUFRAND_OK || p == NULL) return r;
    for (i = 0, n = 0; i < frame->draw_count; i++) {
        const zbufrandi_draw *draw = &frame->draw[i];
        if (draw->item >> ZBUFRANDI_DRAW_SHIFT == ZBUFRANDI_DRAW_STORED && (draw->aux & ZBUFRANDI_STORED_MORE) != 0) {
            if (n != 0 && n <= capacity) groups[n - 1].count += draw->count;
            continue;
        }
        if (n < capacity) zbufrandi_query_group(p, draw, &groups[n]);
        n++;
    }
    *out_count = n;
    if (stats != NULL) *stats = p->stats;
    return ZBUFRAND_OK;
}

typedef struct zbufrandi_stream {
    const zbufrandi_picture *p;
    zbufrand_sample_fn *fn;
    void *user;
    zbufrand_sample sample[ZBUFRANDI_SHADE_RUN];
    uint32_t number[ZBUFRANDI_SHADE_RUN];
    uint32_t count;
    int stop;
    zbufrandi_asker *asker;
    uint32_t tried;            /* samples, seen or not */
} zbufrandi_stream;

/* Another sample, seen or not. 0: no more. */
static int zbufrandi_stream_goes_on(zbufrandi_stream *s) {
    if ((++s->tried & 4095u) == 0 && !zbufrandi_ask(&s->p->f->env, s->asker, 0)) s->stop = 1;
    return !s->stop;
}

/* Colours of what waits, then hand it over. */
static void zbufrandi_stream_flush(zbufrandi_stream *s) {
    float rays[ZBUFRANDI_SHADE_RUN][3];
    zbufrandi_look_at found[ZBUFRANDI_SHADE_RUN];
    const zbufrandi_picture *p = s->p;
    const float guard = (float)(int32_t)p->f->recon.guard;
    uint32_t i;
    if (s->count == 0 || s->stop) {
        s->count = 0;
        return;
    }
    for (i = 0; i < s->count; i++) {
        rays[i][0] = (s->sample[i].x - p->target.center_x) * p->target.inverse_focal;
        rays[i][1] = (p->target.center_y - s->sample[i].y) * p->target.inverse_focal;
        rays[i][2] = 1.0f;
    }
    zbufrandi_find_surfaces(&p->drawn, s->number, (const float (*)[3])rays, s->count, found);
    for (i = 0; i < s->count; i++) {
        const float *f = found[i].face, *ray = rays[i];
        memcpy(s->sample[i].rgb, found[i].rgb, sizeof s->sample[i].rgb);
        if (f[0] * ray[0] + f[1] * ray[1] + f[2] * ray[2] > 0.0f) s->sample[i].flags |= ZBUFRAND_SAMPLE_BACK;
        s->sample[i].x -= guard;
        s->sample[i].y -= guard;
    }
    s->stop = s->fn(s->user, s->sample, s->number, s->count) != 0;
    s->count = 0;
}

static void zbufrandi_stream_add(zbufrandi_stream *s, const zbufrandi_spot *spot, uint32_t number) {
    zbufrand_sample *out = &s->sample[s->count];
    memset(out, 0, sizeof *out);
    out->x = spot->x;
    out->y = spot->y;
    out->z = spot->z;
    if (zbufrandi_absf(spot->slope[0]) < 1e30f && zbufrandi_absf(spot->slope[1]) < 1e30f) { /* of an area */
        out->slope_x = spot->slope[0];
        out->slope_y = spot->slope[1];
    }
    s->number[s->count++] = number;
    if (s->count == ZBUFRANDI_SHADE_RUN) zbufrandi_stream_flush(s);
}

static void zbufrandi_stream_draw(zbufrandi_stream *s, const zbufrandi_draw *draw) {
    const zbufrandi_picture *p = s->p;
    const zbufrandi_local *l = &p->f->local[draw->local];
    const zbufrandi_structure *structure = &p->scene->structure[l->structure];
    const uint32_t kind = draw->item >> ZBUFRANDI_DRAW_SHIFT, index = draw->item & ((1u << ZBUFRANDI_DRAW_SHIFT) - 1u);
    const uint32_t number = (draw->block + p->first_block) * ZBUFRANDI_SET;
    zbufrandi_spot spot;
    uint32_t k, j, begin, end;
    if (kind == ZBUFRANDI_DRAW_STORED) {
        const uint32_t *set = structure->set + (size_t)index * (2 * ZBUFRANDI_SET);
        zbufrandi_stored c;
        zbufrandi_stored_begin(&p->target, draw, l, structure, &c);
        for (k = 0; k < draw->count && zbufrandi_stream_goes_on(s); k++) {
            uint32_t i = k ^ c.first;
            if (zbufrandi_stored_sample(&p->target, &c, set + zbufrandi_set_at(i), i, &spot))
                zbufrandi_stream_add(s, &spot, number + i);
        }
    } else if (kind == ZBUFRANDI_DRAW_LISTED) {
        zbufrandi_list_spot at;
        for (k = 0; k < draw->count && zbufrandi_stream_goes_on(s); k++) {
            zbufrandi_list_find(p->scene, l, draw, k, &at);
            if (zbufrandi_list_sample(&p->target, draw, &at, &spot)) zbufrandi_stream_add(s, &spot, number + k);
        }
    } else if (kind == ZBUFRANDI_DRAW_SAMPLED) {
        const zbufrandi_cluster *cluster = &structure->cluster[index];
        const uint8_t *tri = structure->triangle + 3 * (size_t)cluster->first_triangle;
        const uint32_t at_u = zbufrandi_hash32(draw->hash + 0x3c6ef372u), at_v = zbufrandi_hash32(at_u);
        zbufrandi_flatten constants;
        zbufrandi_flat f;
        zbufrandi_flatten_begin(&p->target, draw, l, &constants, &f);
        zbufrandi_flatten_cluster(&p->target, &constants, structure, cluster, &f);
        k = zbufrandi_flat_count(&p->target, draw, &f);
        zbufrandi_flat_begin(draw, k, p->cut.comb, &f);
        for (begin = 0; begin < k && !s->stop; begin = end) {
            end = k - begin > ZBUFRANDI_FLAT_CHUNK ? begin + ZBUFRANDI_FLAT_CHUNK : k;
            if (p->cut.independent) zbufrandi_flat_independent(draw, &f, cluster->triangle_count, begin, end);
            else zbufrandi_flat_strata(&f, cluster->triangle_count, k, begin, end);
            memcpy(p->f->aux + (size_t)draw->aux * ZBUFRANDI_SET + begin, f.triangle, end - begin);
            for (j = begin; j < end && zbufrandi_stream_goes_on(s); j++) {
                if (zbufrandi_flat_sample(&p->target, &f, tri, at_u, at_v, j, f.triangle[j - begin], &spot)) {
                    zbufrandi_stream_add(s, &spot, number + j);
                }
            }
        }
    }
}

ZBUFRAND_DEF zbufrand_result zbufrand_sample_scene(zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                                   const zbufrand_scene *scene, uint32_t width, uint32_t height,
                                                   zbufrand_sample_fn *sample_fn, void *user, zbufrand_stats *stats) {
    zbufrand_render_desc d;
    zbufrand_image image;
    zbufrandi_picture *p;
    zbufrandi_stream s;
    zbufrand_result r;
    size_t i;
    if (stats != NULL) memset(stats, 0, sizeof *stats);
    if (sample_fn == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    memset(&image, 0, sizeof image);
    image.width = width;
    image.height = height;
    r = zbufrandi_query_open(frame, desc, &d, scene, &image, &p);
    if (r != ZBUFRAND_OK || p == NULL) return r;
    if (!zbufrandi_grow(&frame->mem, (void **)&frame->aux, &frame->aux_capacity, 0,
                        frame->aux_count * ZBUFRANDI_SET + 64, 1)) {
        return zbufrandi_fail(frame->env.error, ZBUFRAND_ERR_NO_MEMORY, 0,
                              zbufrand_result_string(ZBUFRAND_ERR_NO_MEMORY));
    }
    p->drawn.aux = frame->aux;
    memset(&s, 0, sizeof s);
    s.p = p;
    s.asker = &p->asker;
    s.fn = sample_fn;
    s.user = user;
    for (i = 0; i < frame->draw_count && !s.stop; i++) zbufrandi_stream_draw(&s, &frame->draw[i]);
    zbufrandi_stream_flush(&s);
    if (stats != NULL) *stats = p->stats;
    return s.stop ? zbufrandi_fail(frame->env.error, ZBUFRAND_ERR_CANCELLED, 0, "query: cancelled") : ZBUFRAND_OK;
}

/* ---------------------------------------------------------------------------
   points: any number of random points of a surface, in random order.            // >>points

   Points come in pages of 2^20, one for each of as many equal strata of the area along the clusters (and the clusters
   of the instances). Stratum = 256 * run + offset. The points of a page are given out in 256 chapters of 4096: a
   chapter takes one stratum out of each run, by a permutation of the offsets that is the run's own, and its runs come
   in bit-reversed order. So any prefix is spread over the whole surface; which point stands where follows from its
   index alone. A page is made in the order of the strata, so that each cluster is looked at once.
   --------------------------------------------------------------------------- */

enum {
    ZBUFRANDI_PAGE = 1 << 20, ZBUFRANDI_RUNS = 4096, ZBUFRANDI_OFFSETS = 256, ZBUFRANDI_ASKED = 1 << 17,
    /* chapters that wait for their order stand apart by 64 bytes more, so that they do not meet in the caches */
    ZBUFRANDI_CHAPTER_PAD = 16
};
#define ZBUFRANDI_SLIVER 1e-15f /* in units of zbufrandi_areas_unit: the square of less loses bits */

/* a point that is wanted: it lies at stratum + jitter on the scale of 0..2^20 for all the area */
typedef struct zbufrandi_asked {
    uint32_t stratum;
    float jitter;
    uint32_t index;            /* of the output, less the first of this call */
    uint32_t counter;          /* for the place on the triangle */
} zbufrandi_asked;

typedef struct zbufrandi_points_job {
    const zbufrand_scene *scene;
    const zbufrandi_srgb *srgb;
    float *positions, *normals;
    uint8_t *rgb;
    uint32_t *triangles;
    uint32_t key, at_u, at_v;  /* of the page */
    int independent, vertex_normals, level;
    double **sum;              /* per structure: item_sum, or what takes its place after an edit */
    /* a whole page at once: points by chapter and run, to be put in order afterwards */
    float *wait;               /* position, and normal if it is wanted: 3 or 6 floats a point */
    uint32_t wait_floats;
    uint32_t chapter[ZBUFRANDI_OFFSETS]; /* where the chapter that takes an offset begins, of the run below */
    uint32_t run;
} zbufrandi_points_job;

typedef struct zbufrandi_areas { /* a cluster measured, in floats */
    float sum[ZBUFRANDI_CLUSTER_TRIANGLES + 8];
    float normal[ZBUFRANDI_CLUSTER_TRIANGLES + 8][4];
    uint32_t after[ZBUFRANDI_CLUSTER_TRIANGLES + 8];
    uint8_t triangle[ZBUFRANDI_FLAT_CHUNK + 32];
} zbufrandi_areas;

/* an end of a child or triangle on that scale: point (s, j) lies before it if s + j < whole + part */
typedef struct zbufrandi_at {
    uint32_t whole;
    float part;
} zbufrandi_at;

ZBUFRANDI_INLINE zbufrandi_at zbufrandi_at_of(double y) {
    zbufrandi_at at;
    at.whole = (uint32_t)y;
    at.part = (float)(y - (double)at.whole);
    return at;
}
ZBUFRANDI_INLINE int zbufrandi_at_before(uint32_t stratum, float jitter, zbufrandi_at end) {
    return stratum < end.whole || (stratum == end.whole && jitter < end.part);
}

/* ---- the places of points: bijections ---- */

/* Offsets that chapters take out of a run: rounds of multiply, add, and xor of the upper half, modulo 256. */
static void zbufrandi_offsets(uint32_t key, uint32_t first, uint32_t end, uint8_t offset[ZBUFRANDI_OFFSETS]) {
    uint32_t c, k1 = zbufrandi_hash32(key), k2 = zbufrandi_hash32(k1);
    const uint32_t m0 = key | 1u, m1 = k1 | 1u, m2 = k2 | 1u, a0 = key >> 8, a1 = k1 >> 8, a2 = k2 >> 8;
    for (c = first; c < end; c++) {
        uint32_t x = (c * m0 + a0) & 255u;
        x ^= x >> 4;
        x = (x * m1 + a1) & 255u;
        x ^= x >> 4;
        x = (x * m2 + a2) & 255u;
        offset[c] = (uint8_t)(x ^ x >> 4);
    }
}

ZBUFRANDI_INLINE uint32_t zbufrandi_reverse12(uint32_t x) {
    x = (x & 0x555u) << 1 | (x >> 1 & 0x555u);
    x = (x & 0x333u) << 2 | (x >> 2 & 0x333u); /* pairs: now groups of four are reversed within */
    return (x & 0x00fu) << 8 | (x & 0x0f0u) | (x >> 8 & 0x00fu);
}

/* ---- points of a cluster ---- */

/* A power of two that brings the edges of a cluster to about 1: squares of areas are in the range of floats then. */
ZBUFRANDI_INLINE float zbufrandi_areas_unit(const zbufrandi_cluster *c) {
    float e = 1.17549435e-38f, unit;
    uint32_t a, bits;
    for (a = 0; a < 3; a++) e = c->box_hi[a] - c->box_lo[a] > e ? c->box_hi[a] - c->box_lo[a] : e;
    memcpy(&bits, &e, sizeof bits);
    bits = 254u - (bits >> 23); /* exponents of a normal number and of its inverse, rounded to powers of two */
    bits = (bits < 230u ? bits : 230u) << 23;
    memcpy(&unit, &bits, sizeof unit);
    return unit;
}

/* A cluster with slivers whose squared areas are below the range of floats even so: all in double, of a sum of 1. */
static void zbufrandi_areas_slivers(const float *position, const uint8_t *tri, uint32_t count, zbufrandi_areas *m) {
    double all = 1e-300, length = 0.0, n[3];
    uint32_t i, t;
    int a;
    for (i = 0; i < 2 * count; i++) {
        t = i < count ? i : i - count;
        zbufrandi_cross(position + 3 * tri[3 * t], position + 3 * tri[3 * t + 1], position + 3 * tri[3 * t + 2], n);
        length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        if (i < count) all += length;
        for (a = 0; a < 3; a++) m->normal[t][a] = length > 0.0 ? (float)(n[a] / length) : 0.0f;
        m->sum[t] = (float)(length / all);
    }
}

/* The area of all (twice), and where the triangles lie in it: a cluster has one at least. */
static float zbufrandi_areas_of(const zbufrandi_structure *s, const zbufrandi_cluster *c, zbufrandi_areas *m) {
    const float *position = s->position + 3 * (size_t)c->first_vertex;
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    const float unit = zbufrandi_areas_unit(c);
    float sum = 0.0f;
    int slivers = 0;
    uint32_t t = 0;
    do {
        const float *p = position + 3 * tri[3 * t], *q = position + 3 * tri[3 * t + 1],
            *r = position + 3 * tri[3 * t + 2];
        const float ux = (q[0] - p[0]) * unit, uy = (q[1] - p[1]) * unit, uz = (q[2] - p[2]) * unit;
        const float vx = (r[0] - p[0]) * unit, vy = (r[1] - p[1]) * unit, vz = (r[2] - p[2]) * unit;
        const float x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
        const float length = sqrtf(x * x + y * y + z * z);
        m->normal[t][0] = x / length;
        m->normal[t][1] = y / length;
        m->normal[t][2] = z / length;
        m->sum[t] = length;
        slivers |= length < ZBUFRANDI_SLIVER;
    } while (++t < c->triangle_count);
    if (slivers) zbufrandi_areas_slivers(position, tri, c->triangle_count, m);
    for (t = 0; t < c->triangle_count; t++) m->sum[t] = sum += m->sum[t];
    return sum;
}

#if ZBUFRANDI_AVX2
/* Three floats of eight lanes as rows of four. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_rows8(__m256 x, __m256 y, __m256 z, float out[8][4]) {
    const __m256 a = _mm256_unpacklo_ps(x, y), b = _mm256_unpackhi_ps(x, y), c = _mm256_unpacklo_ps(z, z),
        d = _mm256_unpackhi_ps(z, z);
    const __m256 r0 = _mm256_shuffle_ps(a, c, 0x44), r1 = _mm256_shuffle_ps(a, c, 0xee);
    const __m256 r2 = _mm256_shuffle_ps(b, d, 0x44), r3 = _mm256_shuffle_ps(b, d, 0xee);
    _mm256_storeu_ps(out[0], _mm256_permute2f128_ps(r0, r1, 0x20));
    _mm256_storeu_ps(out[2], _mm256_permute2f128_ps(r2, r3, 0x20));
    _mm256_storeu_ps(out[4], _mm256_permute2f128_ps(r0, r1, 0x31));
    _mm256_storeu_ps(out[6], _mm256_permute2f128_ps(r2, r3, 0x31));
}

ZBUFRANDI_TARGET_AVX2 static float zbufrandi_areas_avx2(const zbufrandi_structure *s, const zbufrandi_cluster *c,
                                                        zbufrandi_areas *m) {
    const float *position = s->position + 3 * (size_t)c->first_vertex;
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    const __m256 unit = _mm256_set1_ps(zbufrandi_areas_unit(c)), sliver = _mm256_set1_ps(ZBUFRANDI_SLIVER);
    float sum = 0.0f;
    uint32_t i, k, t[8], slivers = 0;
    for (i = 0; i < c->triangle_count; i += 8) {
        __m256 px, py, pz, ux, uy, uz, vx, vy, vz, x, y, z, length;
        for (k = 0; k < 8; k++) t[k] = i + k < c->triangle_count ? i + k : c->triangle_count - 1u;
        zbufrandi_fetch8(position, 3, tri, t, 0, &px, &py, &pz);
        zbufrandi_fetch8(position, 3, tri, t, 1, &ux, &uy, &uz);
        zbufrandi_fetch8(position, 3, tri, t, 2, &vx, &vy, &vz);
        ux = _mm256_mul_ps(_mm256_sub_ps(ux, px), unit);
        uy = _mm256_mul_ps(_mm256_sub_ps(uy, py), unit);
        uz = _mm256_mul_ps(_mm256_sub_ps(uz, pz), unit);
        vx = _mm256_mul_ps(_mm256_sub_ps(vx, px), unit);
        vy = _mm256_mul_ps(_mm256_sub_ps(vy, py), unit);
        vz = _mm256_mul_ps(_mm256_sub_ps(vz, pz), unit);
        x = _mm256_sub_ps(_mm256_mul_ps(uy, vz), _mm256_mul_ps(uz, vy));
        y = _mm256_sub_ps(_mm256_mul_ps(uz, vx), _mm256_mul_ps(ux, vz));
        z = _mm256_sub_ps(_mm256_mul_ps(ux, vy), _mm256_mul_ps(uy, vx));
        length = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(x, x), _mm256_mul_ps(y, y)), _mm256_mul_ps(z, z));
        length = _mm256_sqrt_ps(length);
        zbufrandi_rows8(_mm256_div_ps(x, length), _mm256_div_ps(y, length), _mm256_div_ps(z, length), &m->normal[i]);
        _mm256_storeu_ps(m->sum + i, length);
        slivers |= (uint32_t)_mm256_movemask_ps(_mm256_cmp_ps(length, sliver, _CMP_LT_OQ));
    }
    if (slivers) zbufrandi_areas_slivers(position, tri, c->triangle_count, m);
    for (i = 0; i < c->triangle_count; i++) m->sum[i] = sum += m->sum[i];
    return sum;
}
#endif

typedef struct zbufrandi_place_at { /* from a structure to the world */
    double m[3][4];
    double scale;
} zbufrandi_place_at;

/* Everything about a point but its place: in the coordinates of the structure, `place` leads to the world. */
static void zbufrandi_point_rest(const zbufrandi_points_job *j, const zbufrandi_structure *s,
                                 const zbufrandi_cluster *c, uint32_t t,
                                 const float bary[3], const zbufrandi_place_at *place, const float normal[3],
                                     uint32_t index) {
    if (j->normals != NULL) {
        float n[3], r[3];
        int a;
        memcpy(n, normal, sizeof n);
        if (j->vertex_normals && (c->flags & ZBUFRANDI_HAS_NORMALS)) {
            zbufrandi_point_normal(s, c, t, bary, n);
            if (!zbufrandi_normalize(n)) memcpy(n, normal, sizeof n);
        }
        for (a = 0; a < 3; a++) {
            const float turn[3] = {(float)(place->m[a][0] / place->scale), (float)(place->m[a][1] / place->scale),
                                   (float)(place->m[a][2] / place->scale)};
            r[a] = turn[0] * n[0] + turn[1] * n[1] + turn[2] * n[2];
        }
        memcpy(j->normals + 3 * (size_t)index, r, sizeof r);
    }
    if (j->rgb != NULL) {
        uint32_t rgb = zbufrandi_point_rgb(s, c, t, bary, j->srgb);
        zbufrandi_store_u16(j->rgb + 3 * (size_t)index, rgb);
        j->rgb[3 * (size_t)index + 2] = (uint8_t)(rgb >> 16);
    }
    if (j->triangles != NULL) {
        j->triangles[2 * (size_t)index] = j->scene->mesh[c->mesh].node;
        j->triangles[2 * (size_t)index + 1] = s->triangle_id[c->first_triangle + t];
    }
}

/* Where the triangles of a cluster end, relative to stratum first.whole. */
ZBUFRANDI_INLINE zbufrandi_at zbufrandi_triangle_end(const zbufrandi_areas *m, uint32_t t, float part, float k) {
    const float y = part + m->sum[t] * k;
    zbufrandi_at at;
    at.whole = (uint32_t)(int32_t)y;
    at.part = y - (float)(int32_t)at.whole;
    return at;
}

static float zbufrandi_measure_areas(const zbufrandi_points_job *j, const zbufrandi_structure *s,
                                     const zbufrandi_cluster *c, zbufrandi_areas *m) {
#if ZBUFRANDI_AVX2
    if (j->level >= 3) return zbufrandi_areas_avx2(s, c, m);
#endif
    (void)j;
    return zbufrandi_areas_of(s, c, m);
}

/* The `count` points asked for of one cluster, which covers begin..end of the scale. */
static void zbufrandi_points_cluster(const zbufrandi_points_job *j, const zbufrandi_structure *s, uint32_t cluster,
                                     const zbufrandi_place_at *place, const zbufrandi_asked *asked, uint32_t count,
                                         double begin, double end) {
    const zbufrandi_cluster *c = &s->cluster[cluster];
    const float *position = s->position + 3 * (size_t)c->first_vertex;
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    const int more = j->normals != NULL || j->rgb != NULL || j->triangles != NULL;
    const zbufrandi_at first = zbufrandi_at_of(begin);
    zbufrandi_areas m;
    zbufrandi_at at;
    float k, move[3][4];
    uint32_t i, t = 0, last = c->triangle_count - 1u;
    int a, b;
    k = (float)((end - begin) / (double)zbufrandi_measure_areas(j, s, c, &m));
    at = zbufrandi_triangle_end(&m, 0, first.part, k);
    for (a = 0; a < 3; a++) for (b = 0; b < 4; b++) move[a][b] = (float)place->m[a][b];
    for (i = 0; i < count; i++) {
        float u, v, w, q[3], r[3];
        const float *p[3];
        uint32_t e;
        while (t < last && !zbufrandi_at_before(asked[i].stratum - first.whole, asked[i].jitter, at)) {
            at = zbufrandi_triangle_end(&m, ++t, first.part, k);
        }
        zbufrandi_flat_weights(j->at_u, j->at_v, asked[i].counter, j->independent, &u, &v);
        w = 1.0f - u - v;
        for (e = 0; e < 3; e++) p[e] = position + 3 * tri[3 * t + e];
        for (a = 0; a < 3; a++) q[a] = p[0][a] * w + p[1][a] * u + p[2][a] * v;
        for (a = 0; a < 3; a++) r[a] = move[a][0] * q[0] + move[a][1] * q[1] + move[a][2] * q[2] + move[a][3];
        memcpy(j->positions + 3 * (size_t)asked[i].index, r, sizeof r);
        if (more) {
            float bary[3];
            bary[0] = w;
            bary[1] = u;
            bary[2] = v;
            zbufrandi_point_rest(j, s, c, t, bary, place, m.normal[t], asked[i].index);
        }
    }
}

/* Does an item of a structure begin at a point or before? sum: areas of the items, added up. */
ZBUFRANDI_INLINE int zbufrandi_item_begins(const double *sum, uint32_t item, double begin, double f,
                                           const zbufrandi_asked *asked) {
    return !zbufrandi_at_before(asked->stratum, asked->jitter, zbufrandi_at_of(begin + sum[item] * f));
}

/* Items of a structure, without those at its end that have no area. */
ZBUFRANDI_INLINE uint32_t zbufrandi_points_items(const zbufrandi_structure *s, const double *sum) {
    uint32_t items = s->cluster_count + s->instance_count;
    while (items > 1 && !(sum[items - 1] < sum[items])) items--;
    return items;
}

static void zbufrandi_points_structure(const zbufrandi_points_job *j, uint32_t structure,
                                       const zbufrandi_place_at *place, const zbufrandi_asked *asked, uint32_t count,
                                       double begin, double end);

/* Does begin..end of the scale have too few places for what is in a structure? There are 2^24 in a stratum. */
ZBUFRANDI_INLINE int zbufrandi_points_narrow(const zbufrandi_structure *s, double begin, double end) {
    return (end - begin) * 1048576.0 < (s->virtual_triangles < 1048576 ? (double)s->virtual_triangles : 1048576.0);
}

/* The same of such a structure: each point gets a scale of its own, and 48 bits more for its place on it. Of more than
   2^44 things it would else be the first one, everywhere, where a structure is in another in powers of two. */
static void zbufrandi_points_afresh(const zbufrandi_points_job *j, uint32_t structure, const zbufrandi_place_at *place,
                                    const zbufrandi_asked *asked, uint32_t count, double begin, double end) {
    uint32_t i;
    for (i = 0; i < count; i++) {
        zbufrandi_asked a = asked[i];
        const uint32_t h = zbufrandi_hash32(j->key ^ zbufrandi_hash32(a.counter ^ zbufrandi_hash32(
            a.stratum ^ (uint32_t)(int32_t)(a.jitter * 16777216.0f)))), low = zbufrandi_hash32(h + 0x9e3779b9u);
        double y = (double)zbufrandi_unit24(h) + (double)zbufrandi_unit24(low) * (1.0 / 16777216.0);
        y = ((double)a.stratum - begin) + ((double)a.jitter + y * (1.0 / 16777216.0));
        y = y / (end - begin) * (double)ZBUFRANDI_PAGE;
        y = y > 0.0 ? zbufrandi_min(y, (double)ZBUFRANDI_PAGE - 1e-6) : 0.0; /* rounding */
        a.stratum = (uint32_t)y;
        a.jitter = (float)(y - (double)a.stratum);
        zbufrandi_points_structure(j, structure, place, &a, 1, 0.0, (double)ZBUFRANDI_PAGE);
    }
}

/* Points asked for of a structure that covers begin..end of the scale; ascending. */
static void zbufrandi_points_structure(const zbufrandi_points_job *j, uint32_t structure,
                                       const zbufrandi_place_at *place,
                                       const zbufrandi_asked *asked, uint32_t count, double begin, double end) {
    const zbufrandi_structure *s = &j->scene->structure[structure];
    const double *sum = j->sum[structure];
    const uint32_t items = zbufrandi_points_items(s, sum);
    const double f = (end - begin) / sum[items];
    uint32_t item = 0, i = 0, n;
    while (i < count) {
        uint32_t lo = item, hi, step = 1;
        zbufrandi_at next;
        /* gallop, then halve: the last item that begins there or before */
        while (lo + step < items && zbufrandi_item_begins(sum, lo + step, begin, f, &asked[i])) {
            lo += step;
            step *= 2;
        }
        hi = lo + step < items ? lo + step : items;
        while (hi - lo > 1) {
            uint32_t mid = (lo + hi) / 2;
            if (zbufrandi_item_begins(sum, mid, begin, f, &asked[i])) lo = mid;
            else hi = mid;
        }
        item = lo;
        next = zbufrandi_at_of(begin + sum[item + 1] * f);
        for (n = 1; i + n < count &&
             (item + 1 == items || zbufrandi_at_before(asked[i + n].stratum, asked[i + n].jitter, next)); n++) { }
        if (item < s->cluster_count) {
            zbufrandi_points_cluster(j, s, item, place, asked + i, n, begin + sum[item] * f,
                                     begin + sum[item + 1] * f);
        } else {
            const zbufrandi_instance *it = &s->instance[item - s->cluster_count];
            zbufrandi_place_at inside;
            const double from = begin + sum[item] * f, to = begin + sum[item + 1] * f;
            zbufrandi_m34_mul(ZBUFRANDI_M34(place->m), ZBUFRANDI_M34(it->to_parent), inside.m);
            inside.scale = place->scale * it->scale;
            if (zbufrandi_points_narrow(&j->scene->structure[it->structure], from, to))
                zbufrandi_points_afresh(j, it->structure, &inside, asked + i, n, from, to);
            else zbufrandi_points_structure(j, it->structure, &inside, asked + i, n, from, to);
        }
        i += n;
    }
}

/* ---- whole pages: all strata one after the other, eight points at a time; the same points ---- */

ZBUFRANDI_INLINE float zbufrandi_page_jitter(uint32_t key, uint32_t stratum) {
    return zbufrandi_unit24(zbufrandi_hash32(key + stratum * 0x9e3779b1u));
}

#if ZBUFRANDI_AVX2
/* Chapters of the offsets of a run: zbufrandi_offsets in 16-bit lanes, turned round. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_page_run_avx2(zbufrandi_points_job *j, uint32_t run) {
    const uint32_t key = zbufrandi_hash32(j->key ^ zbufrandi_hash32(run + 1000)), k1 = zbufrandi_hash32(key),
        k2 = zbufrandi_hash32(k1);
    const __m256i m0 = _mm256_set1_epi16((short)(key | 1u)), m1 = _mm256_set1_epi16((short)(k1 | 1u)),
        m2 = _mm256_set1_epi16((short)(k2 | 1u)), a0 = _mm256_set1_epi16((short)(key >> 8)),
        a1 = _mm256_set1_epi16((short)(k1 >> 8)), a2 = _mm256_set1_epi16((short)(k2 >> 8)),
        byte = _mm256_set1_epi16(255);
    __m256i c = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    uint16_t offset[ZBUFRANDI_OFFSETS];
    uint32_t i;
    for (i = 0; i < ZBUFRANDI_OFFSETS; i += 16) {
        __m256i x = _mm256_and_si256(_mm256_add_epi16(_mm256_mullo_epi16(c, m0), a0), byte);
        x = _mm256_xor_si256(x, _mm256_srli_epi16(x, 4));
        x = _mm256_and_si256(_mm256_add_epi16(_mm256_mullo_epi16(x, m1), a1), byte);
        x = _mm256_xor_si256(x, _mm256_srli_epi16(x, 4));
        x = _mm256_and_si256(_mm256_add_epi16(_mm256_mullo_epi16(x, m2), a2), byte);
        _mm256_storeu_si256((__m256i *)(void *)(offset + i), _mm256_xor_si256(x, _mm256_srli_epi16(x, 4)));
        c = _mm256_add_epi16(c, _mm256_set1_epi16(16));
    }
    for (i = 0; i < ZBUFRANDI_OFFSETS; i++)
        j->chapter[offset[i]] = i * (j->wait_floats * (uint32_t)ZBUFRANDI_RUNS + (uint32_t)ZBUFRANDI_CHAPTER_PAD);
    j->run = run;
}

/* Normals of a measured cluster into the world: per component the operations of zbufrandi_point_rest. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_page_turn(zbufrandi_areas *m, uint32_t count, const float turn[3][4]) {
    const __m128 x = _mm_setr_ps(turn[0][0], turn[1][0], turn[2][0], 0.0f),
        y = _mm_setr_ps(turn[0][1], turn[1][1], turn[2][1], 0.0f),
        z = _mm_setr_ps(turn[0][2], turn[1][2], turn[2][2], 0.0f);
    uint32_t t;
    for (t = 0; t < count; t++) {
        const __m128 n = _mm_loadu_ps(m->normal[t]);
        const __m128 sum = _mm_add_ps(_mm_mul_ps(x, _mm_shuffle_ps(n, n, 0x00)),
                                      _mm_mul_ps(y, _mm_shuffle_ps(n, n, 0x55)));
        _mm_storeu_ps(m->normal[t], _mm_add_ps(sum, _mm_mul_ps(z, _mm_shuffle_ps(n, n, 0xaa))));
    }
}

/* Three floats of each, and two that do not count. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_page_both(const float *a, const float *b, float *to) {
    const __m256 both = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(a)), _mm_loadu_ps(b), 1);
    _mm256_storeu_ps(to, _mm256_permutevar8x32_ps(both, _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 3, 7)));
}

/* First stratum after each triangle: n of them lie one after the other behind `first`, k strata for each unit of their
   areas. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_page_after(zbufrandi_areas *m, uint32_t n, zbufrandi_at first,
                                                                 __m256 k, uint32_t key) {
    const __m256 unit = _mm256_set1_ps(1.0f / 16777216.0f);
    uint32_t t;
    for (t = 0; t < n; t += 8) {
        const __m256 y = _mm256_add_ps(_mm256_set1_ps(first.part), _mm256_mul_ps(_mm256_loadu_ps(m->sum + t), k));
        const __m256i whole = _mm256_cvttps_epi32(y),
            stratum = _mm256_add_epi32(whole, _mm256_set1_epi32((int)first.whole));
        __m256i h = _mm256_add_epi32(_mm256_mullo_epi32(stratum, _mm256_set1_epi32((int)0x9e3779b1u)),
                                     _mm256_set1_epi32((int)key));
        __m256 u = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(zbufrandi_mix8(h), 8)), unit);
        u = _mm256_cmp_ps(u, _mm256_sub_ps(y, _mm256_cvtepi32_ps(whole)), _CMP_LT_OQ);
        _mm256_storeu_si256((__m256i *)(void *)(m->after + t), _mm256_sub_epi32(stratum, _mm256_castps_si256(u)));
    }
}

/* Strata from..to-1, all in the cluster that covers begin..end. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_page_cluster(zbufrandi_points_job *j, const zbufrandi_structure *s,
                                                         uint32_t cluster,
                                                         const zbufrandi_place_at *place, uint32_t from, uint32_t to,
                                                             double begin, double end) {
    const zbufrandi_cluster *c = &s->cluster[cluster];
    const float *position = s->position + 3 * (size_t)c->first_vertex;
    const uint8_t *tri = s->triangle + 3 * (size_t)c->first_triangle;
    const __m256i lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const __m256 one = _mm256_set1_ps(1.0f), half = _mm256_set1_ps(0.5f), unit = _mm256_set1_ps(1.0f / 16777216.0f);
    zbufrandi_areas m;
    float move[3][4], turn[3][4];
    __m256 k;
    uint32_t i, t, before, at, size, n = c->triangle_count;
    int a, b;
    k = _mm256_set1_ps((float)((end - begin) / (double)zbufrandi_areas_avx2(s, c, &m)));
    for (a = 0; a < 3; a++) {
        for (b = 0; b < 4; b++) {
            move[a][b] = (float)place->m[a][b];
            turn[a][b] = (float)(place->m[a][b] / place->scale);
        }
    }
    if (j->normals != NULL) zbufrandi_page_turn(&m, n, (const float (*)[4])turn);
    zbufrandi_page_after(&m, n, zbufrandi_at_of(begin), k, j->key);
    m.after[n - 1] = to;
    for (t = 0, before = from; from < to; from += size) {
        size = to - from < ZBUFRANDI_FLAT_CHUNK ? to - from : (uint32_t)ZBUFRANDI_FLAT_CHUNK;
        for (; t < n; t++) { /* which triangle each of them is in */
            const __m128i byte = _mm_set1_epi8((char)t);
            const uint32_t stop = m.after[t] < from + size ? m.after[t] : from + size;
            /* most have about one: no branch on whether there is any, the next one writes over what is too much */
            _mm_storeu_si128((__m128i *)(void *)(m.triangle + (before - from)), byte);
            while (stop - before > 16) {
                before += 16;
                _mm_storeu_si128((__m128i *)(void *)(m.triangle + (before - from)), byte);
            }
            before = stop;
            if (m.after[t] > from + size) break;
        }
        for (at = 0; at < size; at += 8) {
            const uint32_t stratum = from + at;
            const __m256i number = _mm256_add_epi32(lanes, _mm256_set1_epi32((int)stratum));
            __m256 ax, ay, az, bx, by, bz, cx, cy, cz, u, v, w, x, y, less;
            float out[8][4];
            uint32_t index[8], tt[8], here;
            for (i = 0; i < 8; i++) tt[i] = m.triangle[at + i < size ? at + i : at]; /* those too many do not count */
            zbufrandi_fetch8(position, 3, tri, tt, 0, &ax, &ay, &az);
            zbufrandi_fetch8(position, 3, tri, tt, 1, &bx, &by, &bz);
            zbufrandi_fetch8(position, 3, tri, tt, 2, &cx, &cy, &cz);
            u = _mm256_cvtepi32_ps(_mm256_srli_epi32(_mm256_add_epi32(_mm256_set1_epi32((int)j->at_u),
                                   _mm256_mullo_epi32(number, _mm256_set1_epi32((int)3242174889u))), 8));
            v = _mm256_cvtepi32_ps(_mm256_srli_epi32(_mm256_add_epi32(_mm256_set1_epi32((int)j->at_v),
                                   _mm256_mullo_epi32(number, _mm256_set1_epi32((int)2447445414u))), 8));
            u = _mm256_mul_ps(u, unit);
            v = _mm256_mul_ps(v, unit);
            less = _mm256_cmp_ps(v, u, _CMP_GT_OQ);
            x = _mm256_mul_ps(u, half);
            y = _mm256_mul_ps(v, half);
            w = _mm256_blendv_ps(_mm256_sub_ps(u, y), x, less);
            v = _mm256_blendv_ps(y, _mm256_sub_ps(v, x), less);
            u = w;
            w = _mm256_sub_ps(_mm256_sub_ps(one, u), v);
            ax = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(ax, w), _mm256_mul_ps(bx, u)), _mm256_mul_ps(cx, v));
            ay = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(ay, w), _mm256_mul_ps(by, u)), _mm256_mul_ps(cy, v));
            az = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(az, w), _mm256_mul_ps(bz, u)), _mm256_mul_ps(cz, v));
            zbufrandi_rows8(_mm256_add_ps(zbufrandi_dot8(move[0], ax, ay, az), _mm256_set1_ps(move[0][3])),
                            _mm256_add_ps(zbufrandi_dot8(move[1], ax, ay, az), _mm256_set1_ps(move[1][3])),
                            _mm256_add_ps(zbufrandi_dot8(move[2], ax, ay, az), _mm256_set1_ps(move[2][3])), out);
            here = size - at < 8 ? size - at : 8;
            if (stratum >> 8 != j->run) zbufrandi_page_run_avx2(j, stratum >> 8);
            if ((stratum & 255u) <= 248) {
                const uint32_t shift = j->wait_floats * j->run;
                for (i = 0; i < 8; i++) index[i] = j->chapter[(stratum & 255u) + i] + shift;
            } else {
                for (i = 0; i < here; i++) {
                    const uint32_t run = (stratum + i) >> 8;
                    if (run != j->run) zbufrandi_page_run_avx2(j, run);
                    index[i] = j->chapter[(stratum + i) & 255u] + j->wait_floats * run;
                }
            }
            if (j->normals == NULL) { /* what is written too far is written over by the next run */
                for (i = 0; i < here; i++) _mm_storeu_ps(j->wait + index[i], _mm_loadu_ps(out[i]));
            } else if (here == 8) {
                for (i = 0; i < 8; i++) zbufrandi_page_both(out[i], m.normal[tt[i]], j->wait + index[i]);
            } else {
                for (i = 0; i < here; i++) zbufrandi_page_both(out[i], m.normal[tt[i]], j->wait + index[i]);
            }
        }
    }
}

/* Strata from..to-1, all in a structure that covers too little of the scale. */
static void zbufrandi_page_afresh(zbufrandi_points_job *j, uint32_t structure, const zbufrandi_place_at *place,
                                  uint32_t from, uint32_t to, double begin, double end) {
    zbufrandi_points_job one = *j;
    float p[3], n[3] = {0.0f, 0.0f, 0.0f};
    zbufrandi_asked a;
    one.positions = p;
    one.normals = j->normals != NULL ? n : NULL;
    a.index = 0;
    for (; from < to; from++) {
        float *out;
        a.stratum = a.counter = from;
        a.jitter = zbufrandi_page_jitter(j->key, from);
        zbufrandi_points_afresh(&one, structure, place, &a, 1, begin, end);
        if (from >> 8 != j->run) zbufrandi_page_run_avx2(j, from >> 8);
        out = j->wait + j->chapter[from & 255u] + j->wait_floats * j->run;
        memcpy(out, p, sizeof p);
        if (j->normals != NULL) memcpy(out + 3, n, sizeof n);
    }
}

/* Strata from..to-1, all in a structure that covers begin..end. */
static void zbufrandi_page_structure(zbufrandi_points_job *j, uint32_t structure, const zbufrandi_place_at *place,
                                     uint32_t from, uint32_t to,
                                     double begin, double end) {
    const zbufrandi_structure *s = &j->scene->structure[structure];
    const double *sum = j->sum[structure];
    const uint32_t items = zbufrandi_points_items(s, sum);
    const double f = (end - begin) / sum[items];
    uint32_t item;
    for (item = 0; item < items && from < to; item++) {
        const zbufrandi_at next = zbufrandi_at_of(begin + sum[item + 1] * f);
        uint32_t stop = next.whole;
        if (stop < to && zbufrandi_page_jitter(j->key, stop) < next.part) stop++;
        if (stop > to || item + 1 == items) stop = to;
        if (stop <= from) continue;
        if (item < s->cluster_count) {
            zbufrandi_page_cluster(j, s, item, place, from, stop, begin + sum[item] * f,
                                   begin + sum[item + 1] * f);
        } else {
            const zbufrandi_instance *it = &s->instance[item - s->cluster_count];
            const double first = begin + sum[item] * f, last = begin + sum[item + 1] * f;
            zbufrandi_place_at inside;
            zbufrandi_m34_mul(ZBUFRANDI_M34(place->m), ZBUFRANDI_M34(it->to_parent), inside.m);
            inside.scale = place->scale * it->scale;
            if (zbufrandi_points_narrow(&j->scene->structure[it->structure], first, last))
                zbufrandi_page_afresh(j, it->structure, &inside, from, stop, first, last);
            else zbufrandi_page_structure(j, it->structure, &inside, from, stop, first, last);
        }
        from = stop;
    }
}
#endif

/* ---- pages ---- */

static void zbufrandi_points_open(zbufrandi_points_job *j, uint32_t key, zbufrandi_place_at *place) {
    int a;
    j->key = key;
    j->at_u = zbufrandi_hash32(key + 1);
    j->at_v = zbufrandi_hash32(j->at_u);
    zbufrandi_m34_identity(place->m);
    for (a = 0; a < 3; a++) place->m[a][3] = j->scene->structure[0].origin[a];
    place->scale = 1.0;
}

ZBUFRANDI_INLINE uint32_t zbufrandi_chapter_key(uint32_t key, uint32_t chapter) {
    return zbufrandi_hash32(key ^ zbufrandi_hash32(chapter + 77)) & (ZBUFRANDI_RUNS - 1u);
}

#if ZBUFRANDI_AVX2
/* 48 floats where nobody reads them soon. */
ZBUFRANDI_TARGET_AVX2 ZBUFRANDI_INLINE void zbufrandi_stream48(const float *from, float *to, int aligned) {
    uint32_t k;
    if (aligned) for (k = 0; k < 48; k += 4) _mm_stream_ps(to + k, _mm_loadu_ps(from + k));
    else memcpy(to, from, 48 * sizeof *to);
}

/* The points of a chapter into their order; the next chapter is fetched meanwhile. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_points_order(const float *p, const float *next, uint32_t floats,
                                                         uint32_t key,
                                                         float *positions, float *normals) {
    static const uint16_t reverse[16] = {0, 2048, 1024, 3072, 512, 2560, 1536, 3584, 256, 2304, 1280, 3328, 768, 2816,
                                         1792,
                                         3840};
    const int aligned = (((uintptr_t)positions | (uintptr_t)normals) & 15u) == 0;
    float a[52], b[52];
    uint32_t i, k;
    for (i = 0; i < ZBUFRANDI_RUNS; i += 16) {
        const uint32_t first = zbufrandi_reverse12(i) ^ key;
        for (k = 0; k < floats; k++) ZBUFRANDI_PREFETCH(next + floats * i + 16 * k);
        for (k = 0; k < 16; k++) {
            const float *q = p + (size_t)floats * (first ^ reverse[k]);
            _mm_storeu_ps(a + 3 * k, _mm_loadu_ps(q));
            if (floats == 6) _mm_storeu_ps(b + 3 * k, _mm_loadu_ps(q + 3));
        }
        zbufrandi_stream48(a, positions + 3 * i, aligned);
        if (floats == 6) zbufrandi_stream48(b, normals + 3 * i, aligned);
    }
}

/* All points of a page. */
ZBUFRANDI_TARGET_AVX2 static void zbufrandi_points_whole(zbufrandi_points_job *j, uint32_t key) {
    const size_t chapter = (size_t)j->wait_floats * ZBUFRANDI_RUNS + ZBUFRANDI_CHAPTER_PAD;
    zbufrandi_place_at place;
    uint32_t c;
    zbufrandi_points_open(j, key, &place);
    j->run = ~0u;
    zbufrandi_page_structure(j, 0, &place, 0, ZBUFRANDI_PAGE, 0.0, (double)ZBUFRANDI_PAGE);
    for (c = 0; c < ZBUFRANDI_OFFSETS; c++) {
        const float *p = j->wait + c * chapter, *next = c + 1 < ZBUFRANDI_OFFSETS ? p + chapter : p;
        zbufrandi_points_order(p, next, j->wait_floats, zbufrandi_chapter_key(key, c),
                               j->positions + (size_t)c * (3 * ZBUFRANDI_RUNS),
                               j->normals != NULL ? j->normals + (size_t)c * (3 * ZBUFRANDI_RUNS) : NULL);
    }
    _mm_sfence();
}
#else
static void zbufrandi_points_whole(zbufrandi_points_job *j, uint32_t key) {
    (void)j;
    (void)key;
}
#endif

/* Points begin..end-1 of a page, into outputs that start with the first of them. */
static void zbufrandi_points_page(zbufrandi_points_job *j, zbufrandi_asked *asked, uint32_t key, uint32_t begin,
                                  uint32_t end) {
    const uint32_t first = begin >> 12, last = (end - 1) >> 12; /* chapters */
    zbufrandi_place_at place;
    uint32_t run, c, n = 0, chapter_key[ZBUFRANDI_OFFSETS];
    zbufrandi_points_open(j, key, &place);
    memset(chapter_key, 0, sizeof chapter_key);
    for (c = first; c <= last; c++) chapter_key[c] = zbufrandi_chapter_key(key, c);
    for (run = 0; run < ZBUFRANDI_RUNS; run++) {
        uint64_t wanted[ZBUFRANDI_OFFSETS / 64];
        uint8_t offset[ZBUFRANDI_OFFSETS], chapter[ZBUFRANDI_OFFSETS];
        uint32_t w;
        zbufrandi_offsets(zbufrandi_hash32(key ^ zbufrandi_hash32(run + 1000)), first, last + 1, offset);
        memset(wanted, 0, sizeof wanted);
        memset(chapter, 0, sizeof chapter);
        for (c = first; c <= last; c++) {
            chapter[offset[c]] = (uint8_t)c;
            wanted[offset[c] >> 6] |= (uint64_t)1 << (offset[c] & 63u);
        }
        for (w = 0; w < ZBUFRANDI_OFFSETS / 64; w++) {
            for (; wanted[w] != 0; wanted[w] &= wanted[w] - 1) {
                const uint32_t at = 64 * w + zbufrandi_ctz64(wanted[w]),
                    stratum = run * (uint32_t)ZBUFRANDI_OFFSETS + at;
                const uint32_t index = (uint32_t)chapter[at] << 12 |
                    zbufrandi_reverse12(run ^ chapter_key[chapter[at]]);
                if (index < begin || index >= end) continue;
                asked[n].stratum = asked[n].counter = stratum;
                asked[n].jitter = zbufrandi_page_jitter(key, stratum);
                asked[n].index = index - begin;
                if (++n < ZBUFRANDI_ASKED) continue;
                zbufrandi_points_structure(j, 0, &place, asked, n, 0.0, (double)ZBUFRANDI_PAGE);
                n = 0;
            }
        }
    }
    if (n != 0) zbufrandi_points_structure(j, 0, &place, asked, n, 0.0, (double)ZBUFRANDI_PAGE);
}

/* 64 bits that number n of a sequence has. Of all 64 together none comes twice, which is far too rare to notice; with a
   bijection of 32 bits 10^8 points would lie more evenly than independent ones. Source: Steele et al. 2014 (the mixer
   of David Stafford, his variant 13). */
ZBUFRANDI_INLINE uint64_t zbufrandi_hash64(uint32_t seed, uint64_t n) {
    uint64_t x = ((uint64_t)zbufrandi_hash32(seed) << 32 | seed) + n * 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

/* Independent points first..first+count-1, count <= ZBUFRANDI_ASKED: sorted by place, so that clusters come in
   order. */
static void zbufrandi_points_independent(zbufrandi_points_job *j, zbufrandi_asked *asked, uint64_t *sorted,
                                         uint32_t seed, uint64_t first,
                                         uint32_t count) {
    uint64_t *from = sorted, *to = sorted + ZBUFRANDI_ASKED, *swap;
    uint32_t i, pass, histogram[2048], sum, k;
    zbufrandi_place_at place;
    for (i = 0; i < count; i++) { /* 44 bits of place, 20 of index */
        from[i] = zbufrandi_hash64(seed, first + i) >> 20 << 20 | i;
    }
    for (pass = 0; pass < 4; pass++) { /* all of the place: it is compared exactly */
        memset(histogram, 0, sizeof histogram);
        for (i = 0; i < count; i++) histogram[from[i] >> (20 + 11 * pass) & 2047u]++;
        for (k = 0, sum = 0; k < 2048; k++) {
            i = histogram[k];
            histogram[k] = sum;
            sum += i;
        }
        for (i = 0; i < count; i++) to[histogram[from[i] >> (20 + 11 * pass) & 2047u]++] = from[i];
        swap = from;
        from = to;
        to = swap;
    }
    zbufrandi_points_open(j, seed, &place);
    for (i = 0; i < count; i++) {
        const uint32_t index = (uint32_t)from[i] & 0xfffffu;
        asked[i].stratum = (uint32_t)(from[i] >> 44);
        asked[i].jitter = (float)(int32_t)(from[i] >> 20 & 0xffffffu) * (1.0f / 16777216.0f);
        asked[i].index = index;
        asked[i].counter = (uint32_t)(zbufrandi_hash64(seed + 1, first + index) >> 32); /* where in its triangle */
    }
    zbufrandi_points_structure(j, 0, &place, asked, count, 0.0, (double)ZBUFRANDI_PAGE);
}

/* Give the job its memory for whole pages, if there is any. */
static void zbufrandi_points_wait(zbufrandi_points_job *j, zbufrandi_mem *mem, int normals) {
    j->wait_floats = normals ? 6 : 3;
    j->wait = (float *)zbufrandi_alloc_array(mem, ZBUFRANDI_OFFSETS,
                                             (j->wait_floats * ZBUFRANDI_RUNS + ZBUFRANDI_CHAPTER_PAD) * sizeof(float));
}

static int zbufrandi_edit_sums(const zbufrand_scene *scene, zbufrandi_mem *mem, double **sum);

static void zbufrandi_points_end(const zbufrand_scene *scene, zbufrandi_mem *mem, double **sum) {
    uint32_t i;
    for (i = 0; sum != NULL && i < scene->structure_count; i++)
        if (sum[i] != scene->structure[i].item_sum) zbufrandi_free(mem, sum[i]);
    zbufrandi_free(mem, sum);
}

/* Floats hold all places of the scene. */
static int zbufrandi_points_fit(const zbufrandi_structure *root) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const double lo = root->origin[a] + (double)root->box_lo[a], hi = root->origin[a] + (double)root->box_hi[a];
        if (!(lo >= -3.4e38 && hi <= 3.4e38)) return 0;
    }
    return 1;
}

ZBUFRAND_DEF zbufrand_result zbufrand_surface_points(const zbufrand_scene *scene,
                                                     const zbufrand_surface_points_desc *desc, size_t count,
                                                     float *positions, float *normals, uint8_t *rgb,
                                                     uint32_t *triangles) {
    zbufrand_surface_points_desc d;
    zbufrandi_points_job j;
    zbufrandi_srgb *srgb;
    zbufrandi_asked *asked;
    uint64_t *sorted = NULL, at;
    zbufrandi_mem mem;
    uint32_t seed, i;
    size_t done = 0;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return ZBUFRAND_ERR_UNINIT_DESC;
    if (scene == NULL || (positions == NULL && count != 0) || d.first > UINT64_MAX - count)
        return ZBUFRAND_ERR_INVALID_ARG;
    if (scene->structure_count == 0 || !(scene->structure[0].area > 0.0)) return ZBUFRAND_ERR_EMPTY;
    if (!(scene->structure[0].area < (double)INFINITY) || !zbufrandi_points_fit(&scene->structure[0]))
        return ZBUFRAND_ERR_RANGE;
    for (i = 0; i < scene->structure_count && triangles != NULL; i++) {
        if (scene->structure[i].triangle_count != 0 && scene->structure[i].triangle_id == NULL)
            return ZBUFRAND_ERR_INVALID_ARG;
    }
    if (zbufrandi_env_open(&scene->env, &mem) != ZBUFRAND_OK) return ZBUFRAND_ERR_INVALID_ARG;
    asked = (zbufrandi_asked *)zbufrandi_alloc_array(&mem, ZBUFRANDI_ASKED, sizeof *asked);
    srgb = (zbufrandi_srgb *)zbufrandi_alloc(&mem, sizeof *srgb);
    if (d.independent) sorted = (uint64_t *)zbufrandi_alloc_array(&mem, 2 * ZBUFRANDI_ASKED, sizeof *sorted);
    memset(&j, 0, sizeof j);
    j.sum = (double **)zbufrandi_alloc_zero(&mem, scene->structure_count, sizeof *j.sum);
    i = asked != NULL && srgb != NULL && (!d.independent || sorted != NULL) && j.sum != NULL &&
        zbufrandi_edit_sums(scene, &mem, j.sum);
    if (i) {
        zbufrandi_srgb_open(srgb);
        j.scene = scene;
        j.srgb = srgb;
        j.independent = d.independent != 0;
        j.vertex_normals = d.vertex_normals != 0;
        j.level = zbufrandi_level(ZBUFRAND_ISA_AUTO);
        seed = zbufrandi_hash32(d.seed + 0x51ed270bu);
        if (j.level >= 3 && !j.independent && !j.vertex_normals && rgb == NULL && triangles == NULL &&
            count >= ZBUFRANDI_PAGE) {
            zbufrandi_points_wait(&j, &mem, normals != NULL);
        }
        for (at = d.first; done < count;) {
            const uint32_t size = j.independent ? (uint32_t)ZBUFRANDI_ASKED : (uint32_t)ZBUFRANDI_PAGE;
            const uint32_t begin = (uint32_t)(at % size), end = count - done < size - begin
                ? begin + (uint32_t)(count - done) : size;
            const uint64_t page = at / size;
            const uint32_t key =
                zbufrandi_hash32(seed ^ zbufrandi_hash32((uint32_t)page ^ zbufrandi_hash32((uint32_t)(page >> 32) +
                                                                                           1)));
            j.positions = positions + 3 * done;
            j.normals = normals != NULL ? normals + 3 * done : NULL;
            j.rgb = rgb != NULL ? rgb + 3 * done : NULL;
            j.triangles = triangles != NULL ? triangles + 2 * done : NULL;
            if (sorted != NULL) zbufrandi_points_independent(&j, asked, sorted, seed, at, end - begin);
            else if (j.wait != NULL && end - begin == size) zbufrandi_points_whole(&j, key);
            else zbufrandi_points_page(&j, asked, key, begin, end);
            done += end - begin;
            at += end - begin;
        }
    }
    zbufrandi_points_end(scene, &mem, j.sum);
    zbufrandi_free(&mem, asked);
    zbufrandi_free(&mem, srgb);
    zbufrandi_free(&mem, sorted);
    zbufrandi_free(&mem, j.wait);
    return i ? ZBUFRAND_OK : ZBUFRAND_ERR_NO_MEMORY;
}
/* ---------------------------------------------------------------------------
   edit: nodes are added, removed and moved in a scene that is built.            // >>edit

   Clusters never change once they are built. What is added becomes a structure of its own; what is moved is one, or
   becomes one now: its clusters are copied as they are (zbufrandi_edit_promote), which changes nothing in the picture.
   So all that ever changes in a structure are its instances and which of its clusters are still there, and an edit is
   the insertion, removal or new box of a leaf of its tree. Then boxes, cones, areas, counts and stored points are made
   anew from the touched leaves up to the root, by the functions that made them first, and from there on in all
   structures that have instances of this one. Nothing is summed up over edits, so nothing drifts.
   Leaves go where boxes grow least. Subtrees that got worse than they were made (the surfaces of all boxes over that of
   their own, 1.5 times, a quarter of the leaves edited) are made anew over their upper 2048 parts.
   An update first builds and reserves all it will need: where memory runs out, nothing has happened yet.
   --------------------------------------------------------------------------- */

#define ZBUFRANDI_NIL (~0u)
enum { ZBUFRANDI_TREELET = 2048, ZBUFRANDI_DEEP = 44 };

typedef struct zbufrandi_use {    /* an instance */
    uint32_t structure, instance; /* the structure that it is in; NIL: none */
} zbufrandi_use;

typedef struct zbufrandi_health { /* of a node of a tree */
    uint32_t up;                  /* 8 * parent + lane; NIL: the root. Of a node that is not in use: the next such */
    uint32_t leaves, edits;       /* leaves below; edits of them since the node was made */
    float cost, built;            /* half surfaces of all boxes below; this over its own when it was made */
    uint32_t level;               /* below the root; only while nodes are made anew */
} zbufrandi_health;

typedef struct zbufrandi_live_structure {
    uint32_t *at;                 /* 8 * node + lane of each cluster, then of each instance; NIL: not in the tree */
    zbufrandi_use *next, *prev;   /* of each instance: of the same structure. Slots not in use: next.instance */
    zbufrandi_health *health;
    uint32_t *dirty;              /* nodes to be made anew */
    uint8_t *is_dirty;
    zbufrandi_ray_box *box;       /* NULL: they are among those that the build made */
    double base[3][4], base_inverse[3][4]; /* coordinates of its node to those of the structure, and back */
    size_t instance_capacity, node_capacity;
    zbufrandi_use first;          /* of the instances of this structure */
    uint32_t dirty_count;
    uint32_t free_node, free_nodes, free_instance, free_instances; /* first, and how many */
    uint32_t promised;            /* nodes that are kept for what is yet to be put in by this update */
    uint32_t dead_clusters, dead_triangles, dead_vertices;
    uint32_t used;                /* 0: a slot for the next structure */
    uint32_t node;                /* of the graph */
    uint32_t touched;
    uint32_t above, walk;         /* levels above it, as found by that walk */
} zbufrandi_live_structure;

typedef struct zbufrandi_live {
    zbufrandi_live_structure *s;
    size_t capacity;              /* of these, of scene->structure and of scene->rays->box */
    uint32_t *touched;            /* structures in which something changed */
    uint32_t touched_count, free_structures;
    uint32_t first_free;          /* structures before it are all used */
    uint32_t walks;               /* number of the last one upwards */
} zbufrandi_live;

/* ---- what is known of the structures ---- */

static void zbufrandi_m34_inverse(const double m[3][4], double out[3][4]) { /* of a similarity, or nearly so */
    const double d = 1.0 / zbufrandi_m34_det(m);
    double r[3][4];
    int i, j;
    for (i = 0; i < 3; i++) {
        const int a = (i + 1) % 3, b = (i + 2) % 3;
        for (j = 0; j < 3; j++) {
            const int c = (j + 1) % 3, e = (j + 2) % 3;
            r[j][i] = (m[a][c] * m[b][e] - m[a][e] * m[b][c]) * d;
        }
    }
    for (i = 0; i < 3; i++) r[i][3] = -(r[i][0] * m[0][3] + r[i][1] * m[1][3] + r[i][2] * m[2][3]);
    memcpy(out, r, sizeof r);
}

static void zbufrandi_live_close(zbufrandi_mem *mem, zbufrandi_live_structure *l) {
    zbufrandi_free(mem, l->at);
    zbufrandi_free(mem, l->next);
    zbufrandi_free(mem, l->prev);
    zbufrandi_free(mem, l->health);
    zbufrandi_free(mem, l->dirty);
    zbufrandi_free(mem, l->is_dirty);
    zbufrandi_free(mem, l->box);
    memset(l, 0, sizeof *l);
}

static void zbufrandi_live_free(zbufrand_scene *scene) {
    uint32_t i;
    if (scene->live == NULL) return;
    for (i = 0; i < scene->structure_count; i++) zbufrandi_live_close(&scene->mem, &scene->live->s[i]);
    zbufrandi_free(&scene->mem, scene->live->s);
    zbufrandi_free(&scene->mem, scene->live->touched);
    zbufrandi_free(&scene->mem, scene->live);
    scene->live = NULL;
}

static void zbufrandi_live_totals(const zbufrand_scene *scene, zbufrand_scene_info *info) {
    uint32_t i;
    if (scene->live == NULL) return;
    for (i = 0; i < scene->structure_count; i++) {
        const zbufrandi_live_structure *l = &scene->live->s[i];
        if (!l->used) info->structures--;
        info->stored_triangles -= l->dead_triangles;
        info->stored_vertices -= l->dead_vertices;
        info->clusters -= l->dead_clusters;
        info->instances -= l->free_instances;
        info->tree_nodes -= l->free_nodes;
    }
}

/* Areas of items added up, of each structure; where edits changed them, in memory of the caller's. 0: no memory. */
static int zbufrandi_edit_sums(const zbufrand_scene *scene, zbufrandi_mem *mem, double **sum) {
    uint32_t i, k;
    for (i = 0; i < scene->structure_count; i++) {
        const zbufrandi_structure *s = &scene->structure[i];
        const uint32_t items = s->cluster_count + s->instance_count;
        sum[i] = s->item_sum;
        if (!s->sum_stale || items == 0) continue;
        sum[i] = (double *)zbufrandi_alloc_array(mem, (size_t)items + 1, sizeof **sum);
        if (sum[i] == NULL) return 0;
        sum[i][0] = 0.0;
        for (k = 0; k < items; k++) {
            const uint32_t at = scene->live->s[i].at[k];
            sum[i][k + 1] = sum[i][k];
            if (at != ZBUFRANDI_NIL) sum[i][k + 1] += (double)s->node[at >> 3].area[at & 7u];
        }
    }
    return 1;
}

static void zbufrandi_use_link(zbufrand_scene *scene, uint32_t structure, uint32_t instance) {
    zbufrandi_live_structure *s = scene->live->s, *l = &s[structure],
        *to = &s[scene->structure[structure].instance[instance].structure];
    l->next[instance] = to->first;
    l->prev[instance].structure = ZBUFRANDI_NIL;
    if (to->first.structure != ZBUFRANDI_NIL) {
        s[to->first.structure].prev[to->first.instance].structure = structure;
        s[to->first.structure].prev[to->first.instance].instance = instance;
    }
    to->first.structure = structure;
    to->first.instance = instance;
}

static void zbufrandi_use_unlink(zbufrand_scene *scene, uint32_t structure, uint32_t instance) {
    zbufrandi_live_structure *s = scene->live->s, *l = &s[structure];
    const zbufrandi_use next = l->next[instance], prev = l->prev[instance];
    if (next.structure != ZBUFRANDI_NIL) s[next.structure].prev[next.instance] = prev;
    if (prev.structure != ZBUFRANDI_NIL) s[prev.structure].next[prev.instance] = next;
    else s[scene->structure[structure].instance[instance].structure].first = next;
}

/* Where a child of a node stands. */
static void zbufrandi_live_place(const zbufrandi_structure *s, zbufrandi_live_structure *l, uint32_t child,
                                 uint32_t at) {
    const uint32_t index = ZBUFRANDI_CHILD_INDEX(child);
    switch (ZBUFRANDI_CHILD_KIND(child)) {
    case ZBUFRANDI_CHILD_NODE: l->health[index].up = at; break;
    case ZBUFRANDI_CHILD_CLUSTER: l->at[index] = at; break;
    default: l->at[s->cluster_count + index] = at; break;
    }
}

ZBUFRANDI_INLINE float zbufrandi_lane_surface(const zbufrandi_node8 *n, uint32_t i) {
    const float x = n->hi[0][i] - n->lo[0][i], y = n->hi[1][i] - n->lo[1][i], z = n->hi[2][i] - n->lo[2][i];
    return x >= 0.0f ? x * y + y * z + z * x : 0.0f;
}

/* Leaves and cost of a node whose children are known. Returns the cost over its own half surface. */
static float zbufrandi_live_measure(const zbufrandi_structure *s, zbufrandi_live_structure *l, uint32_t node,
                                    int made) {
    const zbufrandi_node8 *n = &s->node[node];
    zbufrandi_health *h = &l->health[node];
    float lo[3], hi[3], own;
    uint32_t i, a;
    zbufrandi_box_empty(lo, hi);
    h->leaves = 0;
    h->cost = 0.0f;
    for (i = 0; i < n->count; i++) {
        h->cost += zbufrandi_lane_surface(n, i);
        for (a = 0; a < 3; a++) {
            lo[a] = n->lo[a][i] < lo[a] ? n->lo[a][i] : lo[a];
            hi[a] = n->hi[a][i] > hi[a] ? n->hi[a][i] : hi[a];
        }
        if (ZBUFRANDI_CHILD_KIND(n->child[i]) == ZBUFRANDI_CHILD_NODE) {
            h->leaves += l->health[ZBUFRANDI_CHILD_INDEX(n->child[i])].leaves;
            h->cost += l->health[ZBUFRANDI_CHILD_INDEX(n->child[i])].cost;
        } else {
            h->leaves++;
        }
    }
    own = zbufrandi_half_surface(lo, hi);
    own = own > 0.0f ? h->cost / own : 1e30f; /* flat: never worse than made */
    if (made) {
        h->built = own;
        h->edits = 0;
    }
    return own;
}

/* Look at a structure: O(its size). 0: no memory, nothing is changed. */
static int zbufrandi_live_look(zbufrand_scene *scene, uint32_t index) {
    const zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_live_structure *l = &scene->live->s[index];
    zbufrandi_mem *mem = &scene->mem;
    const zbufrandi_use first = l->first;
    uint32_t i, k;
    const size_t items = (size_t)s->cluster_count + s->instance_count;
    l->at = (uint32_t *)zbufrandi_alloc_array(mem, items + 1, sizeof *l->at);
    l->next = (zbufrandi_use *)zbufrandi_alloc_array(mem, (size_t)s->instance_count + 1, sizeof *l->next);
    l->prev = (zbufrandi_use *)zbufrandi_alloc_array(mem, (size_t)s->instance_count + 1, sizeof *l->prev);
    l->health = (zbufrandi_health *)zbufrandi_alloc_zero(mem, (size_t)s->node_count + 1, sizeof *l->health);
    l->dirty = (uint32_t *)zbufrandi_alloc_array(mem, (size_t)s->node_count + 1, sizeof *l->dirty);
    l->is_dirty = (uint8_t *)zbufrandi_alloc_zero(mem, (size_t)s->node_count + 1, 1);
    if (l->at == NULL || l->next == NULL || l->prev == NULL || l->health == NULL || l->dirty == NULL ||
        l->is_dirty == NULL) {
        zbufrandi_live_close(mem, l);
        l->first = first;
        return 0;
    }
    l->instance_capacity = s->instance_count;
    l->node_capacity = s->node_count;
    l->free_node = l->free_instance = ZBUFRANDI_NIL;
    l->used = 1;
    zbufrandi_m34_identity(l->base);
    zbufrandi_m34_identity(l->base_inverse);
    memset(l->at, 0xff, (items + 1) * sizeof *l->at);
    if (s->node_count != 0) l->health[0].up = ZBUFRANDI_NIL;
    for (i = 0; i < s->node_count; i++)
        for (k = 0; k < s->node[i].count; k++) zbufrandi_live_place(s, l, s->node[i].child[k], 8 * i + k);
    /* children come after their parents */
    for (i = s->node_count; i > 0; i--) (void)zbufrandi_live_measure(s, l, i - 1, 1);
    return 1;
}

static void zbufrandi_live_link(zbufrand_scene *scene, uint32_t index) {
    uint32_t i;
    for (i = 0; i < scene->structure[index].instance_count; i++) zbufrandi_use_link(scene, index, i);
}

/* Levels of instances below a structure; those of empty ones, which builds do not count, may not stay empty. */
static uint32_t zbufrandi_live_depth(const zbufrand_scene *scene, uint32_t index) {
    const zbufrandi_structure *s = &scene->structure[index];
    uint32_t depth = 0, i;
    for (i = 0; i < s->instance_count; i++) {
        const uint32_t below = scene->structure[s->instance[i].structure].depth + 1;
        if (s->instance[i].scale > 0.0 && below > depth) depth = below;
    }
    return depth;
}

/* The first update looks at everything. 0: no memory. */
static int zbufrandi_live_open(zbufrand_scene *scene) {
    zbufrandi_live *live;
    uint32_t i;
    size_t k;
    if (scene->live != NULL) return 1;
    live = (zbufrandi_live *)zbufrandi_alloc_zero(&scene->mem, 1, sizeof *live);
    if (live == NULL) return 0;
    live->capacity = scene->structure_count;
    live->s = (zbufrandi_live_structure *)zbufrandi_alloc_zero(&scene->mem, live->capacity, sizeof *live->s);
    live->touched = (uint32_t *)zbufrandi_alloc_array(&scene->mem, live->capacity, sizeof *live->touched);
    scene->live = live;
    if (live->s == NULL || live->touched == NULL) {
        zbufrandi_free(&scene->mem, live->s);
        zbufrandi_free(&scene->mem, live->touched);
        zbufrandi_free(&scene->mem, live);
        scene->live = NULL;
        return 0;
    }
    for (i = 0; i < scene->structure_count; i++) live->s[i].first.structure = ZBUFRANDI_NIL;
    for (i = 0; i < scene->structure_count; i++) {
        if (zbufrandi_live_look(scene, i)) continue;
        zbufrandi_live_free(scene);
        return 0;
    }
    for (i = 0; i < scene->structure_count; i++) zbufrandi_live_link(scene, i);
    for (i = scene->structure_count; i > 0; i--) /* what they have instances of comes behind them */
        scene->structure[i - 1].depth = zbufrandi_live_depth(scene, i - 1);
    for (k = 1; k < scene->graph_count; k++) {
        if (scene->graph[k].kind != ZBUFRANDI_DEAD && scene->graph[k].structure != 0)
            live->s[scene->graph[k].structure - 1].node = (uint32_t)k;
    }
    return 1;
}

/* ---- room ---- */

/* More instances and nodes than there are. 0: no memory, nothing is changed. */
static int zbufrandi_edit_reserve(zbufrand_scene *scene, uint32_t index, size_t instances, size_t nodes) {
    zbufrandi_mem *mem = &scene->mem;
    zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_live_structure *l = &scene->live->s[index];
    size_t need = (size_t)s->instance_count + instances, used;
    if (need > l->instance_capacity) {
        need += need / 4 + 8;
        if (need >= 1u << 28 ||
            !zbufrandi_reserve(mem, (void **)&s->instance, s->instance_count, need, sizeof *s->instance, 0) ||
            !zbufrandi_reserve(mem, (void **)&l->at, (size_t)s->cluster_count + s->instance_count,
                               s->cluster_count + need, sizeof *l->at, 0) ||
            !zbufrandi_reserve(mem, (void **)&l->next, s->instance_count, need, sizeof *l->next, 0) ||
            !zbufrandi_reserve(mem, (void **)&l->prev, s->instance_count, need, sizeof *l->prev, 0)) return 0;
        l->instance_capacity = need;
    }
    need = (size_t)s->node_count + nodes;
    if (need > l->node_capacity) {
        need += need / 4 + 8;
        s->first_view = s->first_more = 0;
        used = s->set != NULL ? ((size_t)s->cluster_count + s->node_count) * ZBUFRANDI_SET : 0;
        if (need >= 1u << 28 || !zbufrandi_reserve(mem, (void **)&s->node, s->node_count, need, sizeof *s->node, 0) ||
            !zbufrandi_reserve(mem, (void **)&l->health, s->node_count, need, sizeof *l->health, 0) ||
            !zbufrandi_reserve(mem, (void **)&l->dirty, l->dirty_count, need, sizeof *l->dirty, 0) ||
            !zbufrandi_reserve(mem, (void **)&l->is_dirty, s->node_count, need, 1, 0)) return 0;
        need += s->cluster_count;
        if (!zbufrandi_reserve(mem, (void **)&s->set, used, need * ZBUFRANDI_SET, 2 * sizeof *s->set, 0) ||
            (s->set_rgb != NULL && !zbufrandi_reserve(mem, (void **)&s->set_rgb, used, need * ZBUFRANDI_SET,
                                                      sizeof *s->set_rgb, 0)) ||
            (s->set_normal != NULL && !zbufrandi_reserve(mem, (void **)&s->set_normal, used, need * ZBUFRANDI_SET,
                                                         sizeof *s->set_normal, 0)) ||
            (s->set_material != NULL && !zbufrandi_reserve(mem, (void **)&s->set_material, used,
                                                           need * ZBUFRANDI_SET, sizeof *s->set_material, 0))) {
            return 0;
        }
        l->node_capacity = need - s->cluster_count;
    }
    return 1;
}

/* The stored points of a structure, and of all that have instances of it, get the attributes that `from` has.
   0: no memory; what was done by then does no harm. */
static int zbufrandi_edit_attributes(zbufrand_scene *scene, uint32_t index, const zbufrandi_structure *from) {
    zbufrandi_mem *mem = &scene->mem;
    zbufrandi_structure *s = &scene->structure[index];
    const zbufrandi_live_structure *l = &scene->live->s[index];
    const size_t used = ((size_t)s->cluster_count + s->node_count) * ZBUFRANDI_SET,
        count = ((size_t)s->cluster_count + l->node_capacity) * ZBUFRANDI_SET;
    const int rgb = from->set_rgb != NULL && s->set_rgb == NULL,
        normal = from->set_normal != NULL && s->set_normal == NULL,
        material = (from->set_material != NULL || from->material != s->material) && s->set_material == NULL;
    zbufrandi_use use;
    size_t i;
    if (!rgb && !normal && !material) return 1;
    s->first_view = s->first_more = 0;
    if (rgb) {
        if (!zbufrandi_reserve(mem, (void **)&s->set_rgb, 0, count, sizeof *s->set_rgb, 0)) return 0;
        for (i = 0; i < used; i++) s->set_rgb[i] = 0xffffffu;
    }
    if (normal) {
        if (!zbufrandi_reserve(mem, (void **)&s->set_normal, 0, count, sizeof *s->set_normal, 0)) return 0;
        for (i = 0; i < used; i++) {
            float n[3];
            zbufrandi_oct32_decode(s->set[zbufrandi_set_at(i) + 8], n);
            s->set_normal[i] = (uint16_t)zbufrandi_oct_encode(n);
        }
    }
    if (material) {
        if (!zbufrandi_reserve(mem, (void **)&s->set_material, 0, count, sizeof *s->set_material, 0)) return 0;
        for (i = 0; i < used; i++) s->set_material[i] = s->material;
    }
    for (use = l->first; use.structure != ZBUFRANDI_NIL; use = scene->live->s[use.structure].next[use.instance])
        if (!zbufrandi_edit_attributes(scene, use.structure, s)) return 0;
    return 1;
}

/* A slot for a new structure; NIL: no memory. */
static uint32_t zbufrandi_edit_slot(zbufrand_scene *scene) {
    zbufrandi_live *live = scene->live;
    uint32_t i;
    size_t cap;
    if (live->free_structures != 0) {
        for (i = live->first_free; live->s[i].used; i++) { }
        live->first_free = i + 1;
        live->free_structures--;
    } else {
        i = scene->structure_count;
        if (i == live->capacity) {
            cap = live->capacity + live->capacity / 2 + 8;
            if (!zbufrandi_reserve(&scene->mem, (void **)&scene->structure, i, cap, sizeof *scene->structure, 0))
                return ZBUFRANDI_NIL;
            scene->rays->structure = scene->structure;
            if (!zbufrandi_reserve(&scene->mem, (void **)&live->s, i, cap, sizeof *live->s, 0) ||
                !zbufrandi_reserve(&scene->mem, (void **)&live->touched, live->touched_count, cap,
                                   sizeof *live->touched, 0) ||
                !zbufrandi_reserve(&scene->mem, (void **)&scene->rays->box, i, cap, sizeof *scene->rays->box, 0)) {
                return ZBUFRANDI_NIL;
            }
            live->capacity = cap;
        }
        scene->structure_count++;
        scene->rays->structure_count++;
    }
    memset(&scene->structure[i], 0, sizeof scene->structure[i]);
    memset(&live->s[i], 0, sizeof live->s[i]);
    live->s[i].first.structure = ZBUFRANDI_NIL;
    live->s[i].used = 1;
    scene->rays->box[i] = NULL;
    return i;
}

static void zbufrandi_edit_slot_free(zbufrand_scene *scene, uint32_t index) {
    zbufrandi_structure_free(&scene->mem, &scene->structure[index]);
    zbufrandi_live_close(&scene->mem, &scene->live->s[index]);
    scene->rays->box[index] = NULL;
    scene->live->free_structures++;
    if (index < scene->live->first_free) scene->live->first_free = index;
}

/* Rays through a new structure, and what edits need to know of it. 0: no memory. */
static int zbufrandi_edit_ready(zbufrand_scene *scene, uint32_t index, uint32_t node) {
    const zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_live_structure *l = &scene->live->s[index];
    zbufrandi_rays_job j;
    if (!zbufrandi_live_look(scene, index)) return 0;
    l->node = node;
    l->box = (zbufrandi_ray_box *)zbufrandi_alloc_array(&scene->mem, (size_t)s->cluster_count + 1, sizeof *l->box);
    if (l->box == NULL) {
        zbufrandi_live_close(&scene->mem, l);
        return 0;
    }
    j.s = s;
    j.box = scene->rays->box[index] = l->box;
    zbufrandi_parallel_for(&scene->env, zbufrandi_rays_task, &j,
                           (s->cluster_count + ZBUFRANDI_RAYS_TASK - 1) / ZBUFRANDI_RAYS_TASK);
    zbufrandi_live_link(scene, index);
    return 1;
}

/* ---- leaves come and go ---- */

static void zbufrandi_edit_touch(zbufrand_scene *scene, uint32_t index) {
    zbufrandi_live *live = scene->live;
    scene->structure[index].first_view = scene->structure[index].first_more = 0; /* made by builds only */
    if (live->s[index].touched) return;
    live->s[index].touched = 1;
    live->touched[live->touched_count++] = index;
}

static void zbufrandi_edit_dirty(zbufrand_scene *scene, uint32_t index, uint32_t node) {
    zbufrandi_live_structure *l = &scene->live->s[index];
    zbufrandi_edit_touch(scene, index);
    if (l->is_dirty[node]) return;
    l->is_dirty[node] = 1;
    l->dirty[l->dirty_count++] = node;
}

static void zbufrandi_lane_clear(zbufrandi_node8 *n, uint32_t i) {
    zbufrandi_lane lane;
    memset(&lane, 0, sizeof lane);
    zbufrandi_box_empty(lane.lo, lane.hi);
    lane.cosine = 1.0f;
    zbufrandi_lane_put(n, i, &lane);
    n->child[i] = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NONE, 0);
}

/* An empty node. There is room. */
static uint32_t zbufrandi_edit_node(zbufrandi_structure *s, zbufrandi_live_structure *l) {
    uint32_t node = l->free_node, i;
    if (node != ZBUFRANDI_NIL) {
        l->free_node = l->health[node].up;
        l->free_nodes--;
    } else {
        node = s->node_count++;
        l->is_dirty[node] = 0;
    }
    memset(&s->node[node], 0, sizeof s->node[node]);
    memset(&l->health[node], 0, sizeof l->health[node]);
    for (i = 0; i < 8; i++) zbufrandi_lane_clear(&s->node[node], i);
    return node;
}

static void zbufrandi_edit_node_free(zbufrandi_structure *s, zbufrandi_live_structure *l, uint32_t node) {
    s->node[node].count = 0;
    l->health[node].up = l->free_node;
    l->free_node = node;
    l->free_nodes++;
}

/* Lane `from` of a node becomes lane `to` of another. */
static void zbufrandi_edit_lane(zbufrandi_structure *s, zbufrandi_live_structure *l, uint32_t from_node, uint32_t from,
                                uint32_t to_node, uint32_t to) {
    zbufrandi_lane lane;
    zbufrandi_lane_get(&s->node[from_node], from, &lane);
    zbufrandi_lane_put(&s->node[to_node], to, &lane);
    s->node[to_node].child[to] = s->node[from_node].child[from];
    zbufrandi_live_place(s, l, s->node[to_node].child[to], 8 * to_node + to);
}

/* Take a cluster or instance out of the tree. */
static void zbufrandi_edit_take(zbufrand_scene *scene, uint32_t index, uint32_t item) {
    zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_live_structure *l = &scene->live->s[index];
    uint32_t at = l->at[item], node, up;
    if (at == ZBUFRANDI_NIL) return;
    l->at[item] = ZBUFRANDI_NIL;
    for (;;) {
        zbufrandi_node8 *n = &s->node[node = at >> 3];
        n->count--;
        if ((at & 7u) != n->count) zbufrandi_edit_lane(s, l, node, n->count, node, at & 7u);
        zbufrandi_lane_clear(n, n->count);
        up = l->health[node].up;
        if (n->count > 0 || up == ZBUFRANDI_NIL) break;
        zbufrandi_edit_node_free(s, l, node); /* its lane in its parent goes, too */
        at = up;
    }
    if (s->node[node].count == 0) { /* the root: nothing is left */
        for (node = 0; node < l->dirty_count; node++) l->is_dirty[l->dirty[node]] = 0;
        l->dirty_count = 0;
        s->node_count = 0;
        l->free_node = ZBUFRANDI_NIL;
        l->free_nodes = 0;
        zbufrandi_edit_touch(scene, index);
        return;
    }
    if (s->node[node].count == 1 && up != ZBUFRANDI_NIL) { /* one child needs no node */
        zbufrandi_edit_lane(s, l, node, 0, up >> 3, up & 7u);
        zbufrandi_edit_node_free(s, l, node);
        node = up >> 3;
    }
    zbufrandi_edit_dirty(scene, index, node);
    for (;; node = up >> 3) {
        l->health[node].edits++;
        up = l->health[node].up;
        if (up == ZBUFRANDI_NIL) break;
    }
}

/* Put it in, at the lane where boxes grow least. There is room for a node. */
static void zbufrandi_edit_put(zbufrand_scene *scene, uint32_t index, uint32_t child, const zbufrandi_lane *lane) {
    zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_live_structure *l = &scene->live->s[index];
    uint32_t node = 0, depth, i;
    if (s->node_count == 0) {
        (void)zbufrandi_edit_node(s, l);
        l->health[0].up = ZBUFRANDI_NIL;
        l->health[0].built = INFINITY;
    }
    for (depth = 0;; depth++) {
        zbufrandi_node8 *n = &s->node[node];
        uint32_t best = 8, fresh;
        float least = INFINITY, size = 0.0f;
        l->health[node].edits++;
        for (i = 0; i < n->count; i++) {
            float lo[3], hi[3], own = zbufrandi_lane_surface(n, i), grown;
            uint32_t a;
            for (a = 0; a < 3; a++) {
                lo[a] = n->lo[a][i] < lane->lo[a] ? n->lo[a][i] : lane->lo[a];
                hi[a] = n->hi[a][i] > lane->hi[a] ? n->hi[a][i] : lane->hi[a];
            }
            grown = zbufrandi_half_surface(lo, hi) - own;
            if (best < 8 && (grown > least || (grown == least && !(own < size)))) continue;
            best = i;
            least = grown;
            size = own;
        }
        if (n->count < 8 && (best == 8 || ZBUFRANDI_CHILD_KIND(n->child[best]) != ZBUFRANDI_CHILD_NODE ||
                             least > 0.25f * size)) { /* a free lane */
            best = n->count++;
        } else if (ZBUFRANDI_CHILD_KIND(n->child[best]) == ZBUFRANDI_CHILD_NODE) {
            uint32_t a;
            for (a = 0; a < 3; a++) { /* for the next that is put in; the rest follows later */
                n->lo[a][best] = n->lo[a][best] < lane->lo[a] ? n->lo[a][best] : lane->lo[a];
                n->hi[a][best] = n->hi[a][best] > lane->hi[a] ? n->hi[a][best] : lane->hi[a];
            }
            node = ZBUFRANDI_CHILD_INDEX(n->child[best]);
            continue;
        } else { /* a node for two leaves */
            fresh = zbufrandi_edit_node(s, l);
            n = &s->node[node];
            zbufrandi_edit_lane(s, l, node, best, fresh, 0);
            s->node[fresh].count = 2;
            n->child[best] = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, fresh);
            l->health[fresh].up = 8 * node + best;
            l->health[fresh].built = INFINITY;
            zbufrandi_edit_dirty(scene, index, node);
            node = fresh;
            best = 1;
        }
        zbufrandi_lane_put(&s->node[node], best, lane);
        s->node[node].child[best] = child;
        zbufrandi_live_place(s, l, child, 8 * node + best);
        zbufrandi_edit_dirty(scene, index, node);
        if (depth > ZBUFRANDI_DEEP) l->health[0].edits = 0xffffffffu; /* to be made anew at once */
        return;
    }
}

/* An instance whose structure or place changed: into the tree, out of it, or a new box. */
static void zbufrandi_edit_instance(zbufrand_scene *scene, uint32_t index, uint32_t instance) {
    zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_live_structure *l = &scene->live->s[index];
    const zbufrandi_instance *it = &s->instance[instance];
    const zbufrandi_structure *to = &scene->structure[it->structure];
    const uint32_t item = s->cluster_count + instance, child = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_INSTANCE, instance);
    zbufrandi_lane lane;
    uint32_t at = l->at[item], a, apart = 0;
    if (to->node_count == 0 || it->hidden) {
        zbufrandi_edit_take(scene, index, item);
        return;
    }
    memset(&lane, 0, sizeof lane);
    lane.cosine = -1.0f;
    lane.area = 1.0f;
    (void)zbufrandi_instance_box(it, to, lane.lo, lane.hi);
    if (at != ZBUFRANDI_NIL) {
        zbufrandi_node8 *n = &s->node[at >> 3];
        for (a = 0; a < 3; a++) apart |= lane.lo[a] > n->hi[a][at & 7u] || lane.hi[a] < n->lo[a][at & 7u];
        if (!apart || l->free_nodes + (l->node_capacity - s->node_count) <= l->promised) {
            for (a = 0; a < 3; a++) {
                n->lo[a][at & 7u] = lane.lo[a];
                n->hi[a][at & 7u] = lane.hi[a];
            }
            zbufrandi_edit_dirty(scene, index, at >> 3);
            for (at >>= 3;; at = l->health[at].up >> 3) {
                l->health[at].edits++;
                if (l->health[at].up == ZBUFRANDI_NIL) break;
            }
            return;
        }
        zbufrandi_edit_take(scene, index, item);
    } else if (l->promised > 0) {
        l->promised--;
    }
    zbufrandi_edit_put(scene, index, child, &lane);
}

/* The slot of an instance is free again. */
static void zbufrandi_edit_instance_free(zbufrand_scene *scene, uint32_t index, uint32_t instance) {
    zbufrandi_live_structure *l = &scene->live->s[index];
    zbufrandi_edit_take(scene, index, scene->structure[index].cluster_count + instance);
    zbufrandi_use_unlink(scene, index, instance);
    memset(&scene->structure[index].instance[instance], 0, sizeof scene->structure[index].instance[instance]);
    l->next[instance].instance = l->free_instance;
    l->free_instance = instance;
    l->free_instances++;
}

/* ---- trees made anew ---- */

typedef struct zbufrandi_treelet { /* the upper part of a subtree, to be made anew */
    zbufrandi_item *item;          /* _pad: its lane */
    zbufrandi_lane *lane;
    uint32_t *node;                /* between the top and the items; then those that were made */
    zbufrandi_range *stack;
    uint32_t count, nodes;
} zbufrandi_treelet;

/* Open nodes below `top`, level by level, as long as there are no more than `most` parts. */
static void zbufrandi_treelet_open(const zbufrandi_structure *s, uint32_t top, uint32_t most, zbufrandi_treelet *t) {
    uint32_t i, k, a, end, opened = 1;
    t->nodes = 0;
    t->count = s->node[top].count;
    for (k = 0; k < t->count; k++) {
        zbufrandi_lane_get(&s->node[top], k, &t->lane[k]);
        t->item[k].child = s->node[top].child[k];
    }
    while (opened) {
        opened = 0;
        end = t->count;
        for (i = 0; i < end; i++) {
            const uint32_t node = ZBUFRANDI_CHILD_INDEX(t->item[i].child);
            const zbufrandi_node8 *n = &s->node[node];
            if (ZBUFRANDI_CHILD_KIND(t->item[i].child) != ZBUFRANDI_CHILD_NODE || t->count + n->count - 1 > most)
                continue;
            t->node[t->nodes++] = node;
            opened = 1;
            for (k = 0; k < n->count; k++) { /* the first takes the place of what is opened */
                const uint32_t to = k == 0 ? i : t->count++;
                zbufrandi_lane_get(n, k, &t->lane[to]);
                t->item[to].child = n->child[k];
            }
        }
    }
    for (i = 0; i < t->count; i++) {
        for (a = 0; a < 3; a++) {
            t->item[i].lo[a] = t->lane[i].lo[a];
            t->item[i].hi[a] = t->lane[i].hi[a];
        }
        t->item[i]._pad = i;
    }
}

static void zbufrandi_treelet_build(zbufrandi_build *b, zbufrandi_live_structure *l, uint32_t top, uint32_t level,
                                    zbufrandi_treelet *t) {
    zbufrandi_structure *s = b->s;
    uint32_t depth = 1, i, a, n;
    for (i = 0; i < t->nodes; i++) zbufrandi_edit_node_free(s, l, t->node[i]);
    t->nodes = 0;
    memset(&t->stack[0], 0, sizeof t->stack[0]);
    t->stack[0].end = t->count;
    t->stack[0].node = top;
    t->stack[0].level = level;
    while (depth > 0) {
        const zbufrandi_range at = t->stack[--depth];
        zbufrandi_range range[8];
        zbufrandi_node8 *node = &s->node[at.node];
        float lo[8][3], hi[8][3];
        t->node[t->nodes++] = at.node;
        n = zbufrandi_open_range(t->item, at, range, lo, hi);
        for (i = 0; i < 8; i++) zbufrandi_lane_clear(node, i);
        node->count = n;
        for (i = n; i > 0; i--) {
            const zbufrandi_range *r = &range[i - 1];
            if (r->end - r->begin == 1) {
                zbufrandi_lane_put(node, i - 1, &t->lane[t->item[r->begin]._pad]);
                node->child[i - 1] = t->item[r->begin].child;
            } else {
                for (a = 0; a < 3; a++) {
                    node->lo[a][i - 1] = lo[i - 1][a];
                    node->hi[a][i - 1] = hi[i - 1][a];
                }
                t->stack[depth] = *r;
                t->stack[depth].level = at.level + 1;
                t->stack[depth].node = zbufrandi_edit_node(s, l);
                node->child[i - 1] = ZBUFRANDI_CHILD(ZBUFRANDI_CHILD_NODE, t->stack[depth++].node);
            }
            zbufrandi_live_place(s, l, node->child[i - 1], 8 * at.node + i - 1);
        }
    }
    for (i = t->nodes; i > 0; i--) {
        zbufrandi_node_finish(b, t->node[i - 1]);
        (void)zbufrandi_live_measure(s, l, t->node[i - 1], 1);
    }
}

/* What is below a node, made anew: its upper parts, or `all` of it, in halves. Nothing happens if memory is short. */
static void zbufrandi_edit_rebuild(zbufrandi_build *b, uint32_t top, int all) {
    zbufrand_scene *scene = b->scene;
    zbufrandi_mem *mem = &scene->mem;
    zbufrandi_live_structure *l = &scene->live->s[b->index];
    const uint32_t most = all ? l->health[top].leaves + 8u : (uint32_t)ZBUFRANDI_TREELET + 8u;
    zbufrandi_treelet t;
    size_t there;
    t.item = (zbufrandi_item *)zbufrandi_alloc_array(mem, most, sizeof *t.item);
    t.lane = (zbufrandi_lane *)zbufrandi_alloc_array(mem, most, sizeof *t.lane);
    t.node = (uint32_t *)zbufrandi_alloc_array(mem, (size_t)b->s->node_count + most, sizeof *t.node);
    t.stack = (zbufrandi_range *)zbufrandi_alloc_array(mem, most, sizeof *t.stack);
    if (t.item != NULL && t.lane != NULL && t.node != NULL && t.stack != NULL) {
        zbufrandi_treelet_open(b->s, top, most - 8, &t);
        there = l->node_capacity - b->s->node_count + l->free_nodes + t.nodes;
        if (there >= t.count || zbufrandi_edit_reserve(scene, b->index, 0, t.count)) {
            zbufrandi_treelet_build(b, l, top, all ? 64u : 0u, &t);
        }
    }
    zbufrandi_free(mem, t.item);
    zbufrandi_free(mem, t.lane);
    zbufrandi_free(mem, t.node);
    zbufrandi_free(mem, t.stack);
}

static void zbufrandi_sort_dirty(uint32_t *v, size_t n, const zbufrandi_health *h) { /* deepest first: Shell sort */
    size_t gap, i, j;
    for (gap = n / 2; gap > 0; gap = gap == 2 ? 1 : gap * 5 / 11) {
        for (i = gap; i < n; i++) {
            const uint32_t x = v[i];
            for (j = i; j >= gap && (h[v[j - gap]].level < h[x].level ||
                                     (h[v[j - gap]].level == h[x].level && v[j - gap] > x)); j -= gap) {
                v[j] = v[j - gap];
            }
            v[j] = x;
        }
    }
}

/* Everything that follows from the touched leaves within a structure. */
static void zbufrandi_edit_refit(zbufrand_scene *scene, uint32_t index) {
    zbufrandi_structure *s = &scene->structure[index];
    zbufrandi_live_structure *l = &scene->live->s[index];
    zbufrandi_build b;
    zbufrandi_leaf_job j;
    uint32_t i, k, end, up, n = 0, forced = 0;
    memset(&b, 0, sizeof b);
    memset(&j, 0, sizeof j);
    b.scene = scene;
    b.s = s;
    b.index = index;
    j.b = &b;
    for (i = 0; i < l->dirty_count; i++) { /* and all above */
        const uint32_t node = l->dirty[i];
        if (node >= s->node_count || s->node[node].count == 0) continue;
        up = l->health[node].up;
        if (up != ZBUFRANDI_NIL) zbufrandi_edit_dirty(scene, index, up >> 3);
    }
    for (i = 0; i < l->dirty_count; i++) {
        const uint32_t node = l->dirty[i];
        l->is_dirty[node] = 0;
        if (node >= s->node_count || s->node[node].count == 0) continue;
        l->health[node].level = 0;
        for (up = l->health[node].up; up != ZBUFRANDI_NIL; up = l->health[up >> 3].up) l->health[node].level++;
        l->dirty[n++] = node;
    }
    l->dirty_count = n;
    zbufrandi_sort_dirty(l->dirty, n, l->health);
    if (s->node_count != 0) forced = l->health[0].edits == 0xffffffffu;
    for (i = 0; i < n; i = end) {
        for (end = i + 1; end < n && l->health[l->dirty[end]].level == l->health[l->dirty[i]].level; end++) { }
        j.order = l->dirty + i;
        j.count = end - i;
        zbufrandi_parallel_for(&scene->env, zbufrandi_node_task, &j,
                               (j.count + ZBUFRANDI_TASK_NODES - 1) / ZBUFRANDI_TASK_NODES);
        for (k = i; k < end; k++) {
            const uint32_t node = l->dirty[k];
            zbufrandi_health *h = &l->health[node];
            const int made = !(h->built < INFINITY);
            const float ratio = zbufrandi_live_measure(s, l, node, made);
            h = &l->health[node];
            if (!made && h->leaves >= 32 && h->edits >= h->leaves / 4 && ratio > 1.5f * h->built)
                zbufrandi_edit_rebuild(&b, node, 0);
        }
    }
    if (forced && s->node_count != 0) zbufrandi_edit_rebuild(&b, 0, 1);
    l->dirty_count = 0;
    s->sum_stale = 1;
}

/* Box, area and count of a structure, from its root. */
static void zbufrandi_edit_totals(zbufrandi_structure *s) {
    zbufrandi_lane root;
    double diagonal = 0.0;
    uint32_t i;
    int a;
    s->area = 0.0;
    s->virtual_triangles = 0;
    memset(s->box_lo, 0, sizeof s->box_lo);
    memset(s->box_hi, 0, sizeof s->box_hi);
    s->radius = 0.0f;
    if (s->node_count == 0) return;
    zbufrandi_node_lane(&s->node[0], &root);
    memcpy(s->box_lo, root.lo, sizeof s->box_lo);
    memcpy(s->box_hi, root.hi, sizeof s->box_hi);
    for (a = 0; a < 3; a++) {
        const double e = 0.5 * ((double)s->box_hi[a] - (double)s->box_lo[a]);
        diagonal += e * e;
    }
    s->radius = zbufrandi_float_up(sqrt(diagonal) * (1.0 + 1e-6)); /* of the box: nothing else is at hand */
    for (i = 0; i < s->node[0].count; i++) s->area += (double)s->node[0].area[i];
    s->virtual_triangles = root.triangles;
}

/* All that was touched, prototypes first, and what has instances of it. Allocates only where trees are made anew. */
static void zbufrandi_edit_finish(zbufrand_scene *scene) {
    zbufrandi_live *live = scene->live;
    uint32_t depth, i;
    for (depth = 0; depth <= ZBUFRANDI_MAX_LEVELS; depth++) {
        for (i = 0; i < live->touched_count; i++) {
            const uint32_t index = live->touched[i];
            zbufrandi_use use;
            if (!live->s[index].used || live->s[index].touched != 1 || scene->structure[index].depth != depth) continue;
            zbufrandi_edit_refit(scene, index);
            zbufrandi_edit_totals(&scene->structure[index]);
            live->s[index].touched = 2; /* done */
            for (use = live->s[index].first; use.structure != ZBUFRANDI_NIL;
                 use = live->s[use.structure].next[use.instance]) {
                zbufrandi_edit_instance(scene, use.structure, use.instance);
            }
        }
    }
    for (i = 0; i < live->touched_count; i++)
        live->s[live->touched[i]].touched = live->s[live->touched[i]].promised = 0;
    live->touched_count = 0;
}

/* ---- what the edits of a graph mean for its structures ---- */

typedef struct zbufrandi_edit_step {  /* an instance that comes or gets another place */
    zbufrandi_instance it;
    uint32_t home, item;           /* item NIL: it is new */
    uint32_t node;                 /* new: gets the first of its slots */
} zbufrandi_edit_step;

typedef struct zbufrandi_nodes { uint32_t *v; size_t count, capacity; } zbufrandi_nodes;

typedef struct zbufrandi_edit {
    zbufrand_scene *scene;
    zbufrandi_walk *stack;
    size_t stack_capacity;
    zbufrandi_nodes top;           /* new nodes in what is built */
    zbufrandi_nodes melted;        /* nodes that become structures where they are */
    zbufrandi_nodes fresh;         /* nodes that become structures; what they use comes before them */
    zbufrandi_edit_step *change;
    size_t change_count, change_capacity;
    int promoted;                  /* 1: structures changed, though not what they look like */
} zbufrandi_edit;

static int zbufrandi_nodes_add(zbufrand_scene *scene, zbufrandi_nodes *list, uint32_t node) { /* 0: no memory */
    if (!zbufrandi_grow(&scene->mem, (void **)&list->v, &list->capacity, list->count, list->count + 1, sizeof *list->v))
        return 0;
    list->v[list->count++] = node;
    return 1;
}

static int zbufrandi_is_new(const zbufrand_scene *scene, uint32_t node) {
    const uint32_t p = scene->graph[node].pending;
    return p != 0 && !scene->pending[p - 1].moved;
}

/* The structure that a node is drawn in; NIL: in none. *below_new: a list above it is new, too. */
static uint32_t zbufrandi_edit_home(const zbufrand_scene *scene, uint32_t node, int *below_new) {
    const zbufrandi_graph *g = scene->graph;
    size_t steps;
    *below_new = 0;
    for (steps = 0; steps < scene->graph_count; steps++) {
        if (g[node].flags & ZBUFRAND_HIDDEN) return ZBUFRANDI_NIL;
        node = g[node].parent;
        if (node == 0) return ZBUFRANDI_NIL;
        if (g[node].structure != 0) return g[node].structure - 1;
        *below_new |= zbufrandi_is_new(scene, node);
    }
    return ZBUFRANDI_NIL; /* lists in a ring */
}

/* A node's coordinates to those of the structure that it is drawn in; old: as they were built. */
static void zbufrandi_edit_matrix(const zbufrand_scene *scene, uint32_t node, int old, double out[3][4]) {
    const zbufrandi_graph *g = scene->graph;
    zbufrandi_m34_identity(out);
    for (;; node = g[node].parent) {
        const zbufrandi_pending *p = g[node].pending != 0 ? &scene->pending[g[node].pending - 1] : NULL;
        zbufrandi_m34_mul(old && p != NULL && p->moved ? ZBUFRANDI_M34(p->old) : ZBUFRANDI_M34(g[node].m),
                          ZBUFRANDI_M34(out), out);
        if (g[g[node].parent].structure == 0) continue;
        zbufrandi_m34_mul(ZBUFRANDI_M34(scene->live->s[g[g[node].parent].structure - 1].base), ZBUFRANDI_M34(out), out);
        return;
    }
}

/* An instance of a structure in another; m: own coordinates of its node to the other structure. RANGE: too far, too
   large or too small. */
static zbufrand_result zbufrandi_edit_place(zbufrand_scene *scene, uint32_t home, uint32_t structure, uint32_t node,
                                            const double m[3][4], zbufrandi_instance *it) {
    const zbufrandi_structure *to = &scene->structure[structure];
    double p[3];
    float lo[3], hi[3];
    int a;
    memset(it, 0, sizeof *it);
    zbufrandi_m34_mul(m, ZBUFRANDI_M34(scene->live->s[structure].base_inverse), it->to_parent);
    it->scale = zbufrandi_m34_scale(ZBUFRANDI_M34(it->to_parent), ZBUFRANDI_SIMILAR_PRODUCT);
    it->structure = structure;
    it->mirrored = zbufrandi_m34_det(ZBUFRANDI_M34(it->to_parent)) < 0.0;
    it->node = node;
    zbufrandi_m34_point(ZBUFRANDI_M34(it->to_parent), to->origin, p);
    for (a = 0; a < 3; a++) it->to_parent[a][3] = p[a] - scene->structure[home].origin[a];
    if (it->scale != 0.0 && (to->node_count == 0 || zbufrandi_instance_box(it, to, lo, hi))) return ZBUFRAND_OK;
    return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, node, "node %: its place or scale is out of range");
}

/* Walk all that a new node leads to: finds cycles, nodes that become structures. */
static zbufrand_result zbufrandi_edit_walk(zbufrandi_edit *e, uint32_t start) {
    zbufrand_scene *scene = e->scene;
    zbufrandi_graph *g = scene->graph;
    const uint32_t on_path = 4 + 2 * scene->stamp, done = on_path + 1;
    size_t depth = 1;
    if (g[start].state == done) { /* in a list that a new reference led to before: it melts there, but not here */
        if (g[start].structure != 0 || g[start].refs != 0 || (g[start].flags & ZBUFRAND_OWN_STRUCTURE) ||
            g[start].kind == ZBUFRANDI_REFERENCES) return ZBUFRAND_OK;
        return zbufrandi_nodes_add(scene, &e->fresh, start) ? ZBUFRAND_OK : ZBUFRAND_ERR_NO_MEMORY;
    }
    if (!zbufrandi_grow(&scene->mem, (void **)&e->stack, &e->stack_capacity, 0, 64, sizeof *e->stack))
        return ZBUFRAND_ERR_NO_MEMORY;
    e->stack[0].node = start;
    e->stack[0].edge = 0;
    g[start].state = on_path;
    while (depth > 0) {
        zbufrandi_walk *at = &e->stack[depth - 1];
        const uint32_t node = at->node, below = zbufrandi_walk_next(g, node, at->edge);
        int below_new;
        if (below == 0) {
            depth--;
            g[node].state = done;
            if (g[node].structure != 0) continue;
            if (g[node].refs == 0 && !(g[node].flags & ZBUFRAND_OWN_STRUCTURE) &&
                (node != start || g[node].kind == ZBUFRANDI_REFERENCES)) continue; /* melts */
            if (!zbufrandi_is_new(scene, node) && zbufrandi_edit_home(scene, node, &below_new) != ZBUFRANDI_NIL &&
                !below_new) {
                if (!zbufrandi_nodes_add(scene, &e->melted, node)) return ZBUFRAND_ERR_NO_MEMORY;
            } else if (!zbufrandi_nodes_add(scene, &e->fresh, node)) {
                return ZBUFRAND_ERR_NO_MEMORY;
            }
            continue;
        }
        at->edge = below;
        if (g[node].kind == ZBUFRANDI_REFERENCES && g[below].parent == 0 && below != ZBUFRAND_ROOT) {
            return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, node,
                                  "reference %: its target is in no list");
        }
        if (g[below].state == on_path)
            return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, node, "node %: closes a cycle");
        if (g[below].state == done) continue;
        if (!zbufrandi_grow(&scene->mem, (void **)&e->stack, &e->stack_capacity, depth, depth + 1, sizeof *e->stack))
            return ZBUFRAND_ERR_NO_MEMORY;
        g[below].state = on_path;
        e->stack[depth].node = below;
        e->stack[depth].edge = 0;
        depth++;
    }
    return ZBUFRAND_OK;
}

static uint32_t zbufrandi_edit_depth(const zbufrandi_graph *g, uint32_t node) {
    uint32_t depth = 0;
    for (; node != 0; node = g[node].parent) depth++;
    return depth;
}

/* The next node that stands for something within `root`, which melts; 0: no more. Lists in it are walked through. */
static uint32_t zbufrandi_edit_next(const zbufrandi_graph *g, uint32_t root, uint32_t node) {
    for (;;) {
        if (g[node].kind == ZBUFRANDI_LIST && (node == root || g[node].structure == 0) &&
            (node == root || !(g[node].flags & ZBUFRAND_HIDDEN)) && g[node].first != 0) {
            node = g[node].first;
        } else {
            while (node != root && g[node].next == 0) node = g[node].parent;
            if (node == root) return 0;
            node = g[node].next;
        }
        if (g[node].flags & ZBUFRAND_HIDDEN) continue;
        if (g[node].kind != ZBUFRANDI_LIST || g[node].structure != 0) return node;
    }
}

/* ---- what melted becomes a structure where it is ---- */

/* One array of a structure's vertices or triangles, for the clusters of another. */
static int zbufrandi_copy_array(zbufrandi_mem *mem, void **to, const void *from, size_t count, size_t size,
                                size_t pad) { /* room for it; 0: no memory */
    return from == NULL || zbufrandi_reserve(mem, to, 0, count, size, pad);
}

static void zbufrandi_copy_cluster(const zbufrandi_structure *from, uint32_t index, zbufrandi_structure *to) {
    const zbufrandi_cluster *c = &from->cluster[index];
    zbufrandi_cluster *d = &to->cluster[to->cluster_count++];
    const size_t v = c->first_vertex, t = c->first_triangle, w = to->vertex_count, u = to->triangle_count;
    *d = *c;
    d->first_vertex = to->vertex_count;
    d->first_triangle = to->triangle_count;
    memcpy(to->position + 3 * w, from->position + 3 * v, 12 * (size_t)c->vertex_count);
    memcpy(to->triangle + 3 * u, from->triangle + 3 * t, 3 * (size_t)c->triangle_count);
    if (from->vertex_normal != NULL)
        memcpy(to->vertex_normal + w, from->vertex_normal + v, 2 * (size_t)c->vertex_count);
    if (from->vertex_rgb != NULL) memcpy(to->vertex_rgb + 3 * w, from->vertex_rgb + 3 * v, 3 * (size_t)c->vertex_count);
    if (from->triangle_rgb != NULL)
        memcpy(to->triangle_rgb + 3 * u, from->triangle_rgb + 3 * t, 3 * (size_t)c->triangle_count);
    if (from->triangle_id != NULL) memcpy(to->triangle_id + u, from->triangle_id + t, 4 * (size_t)c->triangle_count);
    to->vertex_count += c->vertex_count;
    to->triangle_count += c->triangle_count;
}

/* The items of node `node` within structure `home`, copied; counted only if `to` has no arrays yet. */
static void zbufrandi_promote_node(const zbufrand_scene *scene, uint32_t home, uint32_t node, int count,
                                   zbufrandi_structure *to) {
    const zbufrandi_graph *n = &scene->graph[node];
    const zbufrandi_structure *from = &scene->structure[home];
    uint32_t i;
    if (n->home != home + 1) return;
    for (i = 0; i < n->item_count; i++) {
        if (n->kind != ZBUFRANDI_MESH || n->structure != 0) {
            if (count) to->instance_count++;
            else to->instance[to->instance_count++] = from->instance[n->item + i];
        } else if (count) {
            to->cluster_count++;
            to->vertex_count += from->cluster[n->item + i].vertex_count;
            to->triangle_count += from->cluster[n->item + i].triangle_count;
        } else {
            zbufrandi_copy_cluster(from, n->item + i, to);
        }
    }
}

/* A structure with everything that stands for the nodes within `node`. */
static zbufrand_result zbufrandi_promote_build(zbufrandi_build *b, uint32_t home, uint32_t node) {
    zbufrand_scene *scene = b->scene;
    zbufrandi_mem *mem = &scene->mem;
    const zbufrandi_graph *g = scene->graph;
    const zbufrandi_structure *from = &scene->structure[home];
    zbufrandi_structure *s = b->s, all;
    uint32_t k;
    int pass;
    for (pass = 0; pass < 2; pass++) {
        memset(&all, 0, sizeof all);
        if (pass == 1) all = *s;
        zbufrandi_promote_node(scene, home, node, pass == 0, &all);
        for (k = zbufrandi_edit_next(g, node, node); k != 0; k = zbufrandi_edit_next(g, node, k))
            zbufrandi_promote_node(scene, home, k, pass == 0, &all);
        if (pass == 1) {
            *s = all;
            break;
        }
        memcpy(s->origin, from->origin, sizeof s->origin);
        if (!zbufrandi_copy_array(mem, (void **)&s->position, from->position, all.vertex_count, 12, 96) ||
            !zbufrandi_copy_array(mem, (void **)&s->vertex_normal, from->vertex_normal, all.vertex_count, 2, 16) ||
            !zbufrandi_copy_array(mem, (void **)&s->vertex_rgb, from->vertex_rgb, all.vertex_count, 3, 16) ||
            !zbufrandi_copy_array(mem, (void **)&s->triangle, from->triangle, all.triangle_count, 3, 48) ||
            !zbufrandi_copy_array(mem, (void **)&s->triangle_rgb, from->triangle_rgb, all.triangle_count, 3, 16) ||
            !zbufrandi_copy_array(mem, (void **)&s->triangle_id, from->triangle_id, all.triangle_count, 4, 0) ||
            !zbufrandi_copy_array(mem, (void **)&s->cluster, from->cluster, all.cluster_count, sizeof *s->cluster, 0) ||
            !zbufrandi_copy_array(mem, (void **)&s->instance, from->instance, all.instance_count,
                                  sizeof *s->instance, 0)) {
            return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, node, "node %: out of memory");
        }
    }
    return zbufrandi_build_over(b);
}

/* The graph learns where its items are now; they leave the structure that they were in. */
static void zbufrandi_promote_move(zbufrand_scene *scene, uint32_t home, uint32_t to, uint32_t node, uint32_t *clusters,
                                   uint32_t *instances) {
    zbufrandi_graph *n = &scene->graph[node];
    zbufrandi_structure *s = &scene->structure[home];
    zbufrandi_live_structure *l = &scene->live->s[home];
    const int is_cluster = n->kind == ZBUFRANDI_MESH && n->structure == 0;
    uint32_t i;
    if (n->home != home + 1) return;
    for (i = n->item; i < n->item + n->item_count; i++) {
        if (is_cluster) {
            zbufrandi_edit_take(scene, home, i);
            l->dead_clusters++;
            l->dead_triangles += s->cluster[i].triangle_count;
            l->dead_vertices += s->cluster[i].vertex_count;
        } else {
            zbufrandi_edit_instance_free(scene, home, i);
        }
    }
    n->home = to + 1;
    n->item = is_cluster ? *clusters : *instances;
    *(is_cluster ? clusters : instances) += n->item_count;
}

/* A slot for an instance, not yet in the tree. There is room. */
static uint32_t zbufrandi_edit_instance_new(zbufrand_scene *scene, uint32_t home, const zbufrandi_instance *it,
                                            int reuse) {
    zbufrandi_structure *s = &scene->structure[home];
    zbufrandi_live_structure *l = &scene->live->s[home];
    uint32_t i = l->free_instance;
    if (reuse && i != ZBUFRANDI_NIL) {
        l->free_instance = l->next[i].instance;
        l->free_instances--;
    } else {
        i = s->instance_count++;
    }
    s->instance[i] = *it;
    l->at[s->cluster_count + i] = ZBUFRANDI_NIL;
    zbufrandi_use_link(scene, home, i);
    s->sum_stale = 1;
    return i;
}

/* Levels of instances below a structure, and below all that have instances of it. */
static void zbufrandi_edit_raise(zbufrand_scene *scene, uint32_t index, uint32_t depth) {
    zbufrandi_use use;
    if (scene->structure[index].depth >= depth) return;
    scene->structure[index].depth = depth;
    for (use = scene->live->s[index].first; use.structure != ZBUFRANDI_NIL;
         use = scene->live->s[use.structure].next[use.instance]) zbufrandi_edit_raise(scene, use.structure, depth + 1);
}

/* Levels above a structure. Each structure above is looked at once by a walk, however many ways lead to it. */
static uint32_t zbufrandi_edit_above(const zbufrand_scene *scene, uint32_t index, uint32_t walk) {
    zbufrandi_live_structure *l = &scene->live->s[index];
    uint32_t most = 0;
    zbufrandi_use use;
    if (l->walk == walk) return l->above;
    for (use = l->first; use.structure != ZBUFRANDI_NIL; use = scene->live->s[use.structure].next[use.instance]) {
        const uint32_t above = zbufrandi_edit_above(scene, use.structure, walk) + 1;
        most = above > most ? above : most;
    }
    l->walk = walk;
    l->above = most;
    return most;
}

/* Changes nothing in the picture. On failure nothing has changed at all. */
static zbufrand_result zbufrandi_edit_promote(zbufrandi_edit *e, uint32_t node) {
    zbufrand_scene *scene = e->scene;
    zbufrandi_graph *g = scene->graph;
    zbufrandi_build b;
    zbufrandi_instance it;
    double old[3][4];
    uint32_t home, p, k, clusters = 0, instances = 0;
    int below_new;
    zbufrand_result r;
    if (g[node].structure != 0) return ZBUFRAND_OK;
    home = zbufrandi_edit_home(scene, node, &below_new);
    p = zbufrandi_edit_slot(scene);
    if (p == ZBUFRANDI_NIL)
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, node, "node %: out of memory");
    memset(&b, 0, sizeof b);
    b.scene = scene;
    b.desc = &scene->built;
    b.s = &scene->structure[p];
    b.index = p;
    r = zbufrandi_promote_build(&b, home, node);
    if (r == ZBUFRAND_OK) scene->structure[p].depth = zbufrandi_live_depth(scene, p);
    if (r == ZBUFRAND_OK && zbufrandi_edit_above(scene, home, ++scene->live->walks) + 1 + scene->structure[p].depth >
                            ZBUFRANDI_MAX_LEVELS) {
        r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, node, "node %: too many levels of instances");
    }
    if (r == ZBUFRAND_OK && (!zbufrandi_edit_reserve(scene, home, 1, 1) || !zbufrandi_edit_ready(scene, p, node))) {
        r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, node, "node %: out of memory");
    }
    if (r != ZBUFRAND_OK) {
        zbufrandi_edit_slot_free(scene, p);
        return r;
    }
    e->promoted = 1;
    zbufrandi_edit_matrix(scene, node, 1, old);
    memcpy(scene->live->s[p].base, old, sizeof old);
    zbufrandi_m34_inverse(ZBUFRANDI_M34(old), scene->live->s[p].base_inverse);
    zbufrandi_promote_move(scene, home, p, node, &clusters, &instances);
    for (k = zbufrandi_edit_next(g, node, node); k != 0; k = zbufrandi_edit_next(g, node, k))
        zbufrandi_promote_move(scene, home, p, k, &clusters, &instances);
    g[node].structure = p + 1;
    memset(&it, 0, sizeof it); /* same coordinates, same origin */
    zbufrandi_m34_identity(it.to_parent);
    it.scale = 1.0;
    it.structure = p;
    it.node = node;
    g[node].home = home + 1;
    g[node].item = zbufrandi_edit_instance_new(scene, home, &it, 1);
    g[node].item_count = 1;
    zbufrandi_edit_raise(scene, home, scene->structure[p].depth + 1);
    zbufrandi_edit_instance(scene, home, g[node].item);
    zbufrandi_edit_touch(scene, home);
    return ZBUFRAND_OK;
}

/* ---- an update ---- */

static zbufrand_result zbufrandi_edit_no_memory(const zbufrand_scene *scene) {
    return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_NO_MEMORY, 0, "no memory for the edits");
}

/* What is new, and what becomes a structure. */
static zbufrand_result zbufrandi_edit_plan(zbufrandi_edit *e) {
    zbufrand_scene *scene = e->scene;
    zbufrandi_graph *g = scene->graph;
    zbufrand_result r = ZBUFRAND_OK;
    size_t i, k;
    int below_new;
    if (scene->stamp > 0x70000000u) {
        for (i = 0; i < scene->graph_count; i++) g[i].state = 0;
        scene->stamp = 0;
    }
    scene->stamp++;
    for (i = 0; i < scene->pending_count && r == ZBUFRAND_OK; i++) {
        const zbufrandi_pending *p = &scene->pending[i];
        if (g[p->node].kind == ZBUFRANDI_DEAD ||
            zbufrandi_edit_home(scene, p->node, &below_new) == ZBUFRANDI_NIL || below_new) continue;
        if (!p->moved) {
            if (!zbufrandi_nodes_add(scene, &e->top, p->node)) r = ZBUFRAND_ERR_NO_MEMORY;
            else r = zbufrandi_edit_walk(e, p->node);
        } else if (g[p->node].structure == 0 &&
                   (g[p->node].kind != ZBUFRANDI_REFERENCES || g[p->node].transforms != NULL)) {
            if (!zbufrandi_nodes_add(scene, &e->melted, p->node)) r = ZBUFRAND_ERR_NO_MEMORY;
        }
    }
    for (i = 1; i < e->melted.count; i++) { /* lists before what is in them */
        const uint32_t x = e->melted.v[i], depth = zbufrandi_edit_depth(g, x);
        for (k = i; k > 0 && zbufrandi_edit_depth(g, e->melted.v[k - 1]) > depth; k--)
            e->melted.v[k] = e->melted.v[k - 1];
        e->melted.v[k] = x;
    }
    return r == ZBUFRAND_ERR_NO_MEMORY ? zbufrandi_edit_no_memory(scene) : r;
}

/* Build a structure of a node that is drawn nowhere yet. */
static zbufrand_result zbufrandi_edit_build(zbufrandi_edit *e, uint32_t node, uint64_t *skipped) {
    zbufrand_scene *scene = e->scene;
    const uint32_t index = scene->graph[node].structure - 1;
    zbufrandi_gather gather;
    zbufrandi_build b;
    zbufrand_result r;
    size_t i;
    memset(&gather, 0, sizeof gather);
    memset(&b, 0, sizeof b);
    r = zbufrandi_gather_structure(scene, node, &gather);
    if (r != ZBUFRAND_OK) return r;
    for (i = 0; i < gather.instance_count; i++) {
        zbufrandi_instance *it = &gather.instance[i];
        zbufrandi_m34_mul(ZBUFRANDI_M34(it->to_parent), ZBUFRANDI_M34(scene->live->s[it->structure].base_inverse),
                          it->to_parent);
        it->scale = zbufrandi_m34_scale(ZBUFRANDI_M34(it->to_parent), ZBUFRANDI_SIMILAR_PRODUCT);
        it->mirrored = zbufrandi_m34_det(ZBUFRANDI_M34(it->to_parent)) < 0.0;
        if (it->scale != 0.0) continue;
        r = zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, it->node, "node %: its scale is out of range");
        zbufrandi_gather_free(&scene->mem, &gather);
        return r;
    }
    b.scene = scene;
    b.desc = &scene->built;
    b.s = &scene->structure[index];
    b.gather = &gather;
    b.index = index;
    r = zbufrandi_build_structure(&b);
    zbufrandi_gather_free(&scene->mem, &gather);
    *skipped += b.skipped;
    if (r == ZBUFRAND_OK) scene->structure[index].depth = zbufrandi_live_depth(scene, index);
    if (r == ZBUFRAND_OK && !zbufrandi_edit_ready(scene, index, node)) r = zbufrandi_edit_no_memory(scene);
    return r;
}

static int zbufrandi_edit_change(zbufrandi_edit *e, uint32_t home, uint32_t item, uint32_t node,
                                 const zbufrandi_instance *it) { /* 0: no memory */
    zbufrandi_edit_step *c;
    if (!zbufrandi_grow(&e->scene->mem, (void **)&e->change, &e->change_capacity, e->change_count, e->change_count + 1,
                        sizeof *e->change)) return 0;
    c = &e->change[e->change_count++];
    c->it = *it;
    c->home = home;
    c->item = item;
    c->node = node;
    return 1;
}

/* The instances of a new node, or the one of a node that was moved. */
static zbufrand_result zbufrandi_edit_node_changes(zbufrandi_edit *e, uint32_t node, int moved) {
    zbufrand_scene *scene = e->scene;
    const zbufrandi_graph *n = &scene->graph[node];
    const int many = n->kind == ZBUFRANDI_REFERENCES && n->structure == 0;
    double m[3][4], t[3][4];
    zbufrandi_instance it;
    uint32_t home;
    size_t i, count = many ? n->count : 1;
    int below_new;
    zbufrand_result r;
    home = zbufrandi_edit_home(scene, node, &below_new);
    if (moved && n->home == 0) return ZBUFRAND_OK; /* nothing stands for it */
    zbufrandi_edit_matrix(scene, node, 0, m);
    for (i = 0; i < count; i++) {
        memcpy(t, m, sizeof t);
        if (many && n->transforms != NULL) {
            if (zbufrandi_m34_scale(ZBUFRANDI_M34(n->transforms[i].m), ZBUFRANDI_SIMILAR) == 0.0) {
                return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, node,
                                      "references %: a transform is no similarity");
            }
            zbufrandi_m34_mul(ZBUFRANDI_M34(m), ZBUFRANDI_M34(n->transforms[i].m), t);
        }
        r = zbufrandi_edit_place(scene, home, (many ? scene->graph[n->target].structure : n->structure) - 1, node,
                                 ZBUFRANDI_M34(t), &it);
        if (r != ZBUFRAND_OK) return r;
        if (moved) it.hidden = scene->structure[home].instance[n->item].hidden;
        if (!zbufrandi_edit_change(e, home, moved ? n->item : ZBUFRANDI_NIL, node, &it))
            return zbufrandi_edit_no_memory(scene);
    }
    return ZBUFRAND_OK;
}

/* Where a reference out of many stands: structure, and first instance of the node there. 0: nowhere. */
static int zbufrandi_edit_entries(const zbufrand_scene *scene, uint32_t node, uint32_t *home, uint32_t *first) {
    const zbufrandi_graph *n = &scene->graph[node];
    *home = (n->structure != 0 ? n->structure : n->home) - 1;
    *first = n->structure != 0 ? 0 : n->item;
    return n->structure != 0 || n->home != 0;
}

static zbufrand_result zbufrandi_edit_set_changes(zbufrandi_edit *e, const zbufrandi_set *set) {
    zbufrand_scene *scene = e->scene;
    const zbufrandi_graph *n = &scene->graph[set->node];
    double m[3][4];
    zbufrandi_instance it;
    uint32_t home, first;
    zbufrand_result r;
    if (n->kind == ZBUFRANDI_DEAD || !zbufrandi_edit_entries(scene, set->node, &home, &first)) return ZBUFRAND_OK;
    it = scene->structure[home].instance[first + set->index];
    it.hidden = !set->drawn;
    if (set->drawn) {
        if (n->structure != 0) memcpy(m, scene->live->s[home].base, sizeof m);
        else zbufrandi_edit_matrix(scene, set->node, 0, m);
        zbufrandi_m34_mul(ZBUFRANDI_M34(m), ZBUFRANDI_M34(set->m), m);
        r = zbufrandi_edit_place(scene, home, scene->graph[n->target].structure - 1, set->node, ZBUFRANDI_M34(m), &it);
        if (r != ZBUFRAND_OK) return r;
    }
    return zbufrandi_edit_change(e, home, first + set->index, set->node, &it) ? ZBUFRAND_OK
                                                                             : zbufrandi_edit_no_memory(scene);
}

/* Room for all changes, levels in range. Structures that are empty now may not be so afterwards, and then all their
   instances go into trees. */
static zbufrand_result zbufrandi_edit_room(zbufrandi_edit *e) {
    zbufrand_scene *scene = e->scene;
    const size_t count = scene->structure_count;
    uint32_t *instances = (uint32_t *)zbufrandi_alloc_zero(&scene->mem, count, 3 * sizeof *instances);
    uint32_t *nodes = instances + count, *levels = nodes + count;
    zbufrandi_live_structure *live = scene->live->s;
    zbufrandi_use use;
    size_t i, k;
    int more = 1, ok = instances != NULL, deep = 0;
    if (!ok) return zbufrandi_edit_no_memory(scene);
    for (i = 0; i < count; i++) live[i].promised = 0;
    for (i = 0; i < e->change_count; i++) {
        const uint32_t home = e->change[i].home, item = e->change[i].item;
        if (item == ZBUFRANDI_NIL) instances[home]++;
        if (item == ZBUFRANDI_NIL || live[home].at[scene->structure[home].cluster_count + item] == ZBUFRANDI_NIL)
            live[home].promised++;
        nodes[home]++;
    }
    for (k = 0; more && k <= ZBUFRANDI_MAX_LEVELS; k++) { /* what is empty passes its need on to what it is in */
        more = 0;
        for (i = 0; i < count; i++) {
            if (nodes[i] == 0 || scene->structure[i].node_count != 0 || (nodes[i] & 0x80000000u) != 0) continue;
            nodes[i] |= 0x80000000u;
            for (use = scene->live->s[i].first; use.structure != ZBUFRANDI_NIL;
                 use = scene->live->s[use.structure].next[use.instance]) {
                nodes[use.structure]++;
                live[use.structure].promised++;
                more = 1;
            }
        }
    }
    for (i = 0; i < count; i++) levels[i] = scene->structure[i].depth;
    for (more = 1; more && !deep;) { /* levels below, with all that is new */
        more = 0;
        for (i = 0; i < e->change_count; i++) {
            const uint32_t home = e->change[i].home, below = levels[e->change[i].it.structure] + 1;
            if (below <= levels[home]) continue;
            levels[home] = below;
            more = 1;
        }
        for (i = 0; i < count; i++) {
            if (levels[i] == scene->structure[i].depth) continue;
            for (use = scene->live->s[i].first; use.structure != ZBUFRANDI_NIL;
                 use = scene->live->s[use.structure].next[use.instance]) {
                if (levels[use.structure] > levels[i]) continue;
                levels[use.structure] = levels[i] + 1;
                more = 1;
            }
            deep |= levels[i] > ZBUFRANDI_MAX_LEVELS;
        }
    }
    for (i = 0; ok && !deep && i < count; i++) {
        if ((nodes[i] & 0x7fffffffu) == 0) continue;
        ok = zbufrandi_edit_reserve(scene, (uint32_t)i, instances[i], nodes[i] & 0x7fffffffu);
    }
    for (i = 0; ok && !deep && i < e->change_count; i++)
        ok = zbufrandi_edit_attributes(scene, e->change[i].home, &scene->structure[e->change[i].it.structure]);
    zbufrandi_free(&scene->mem, instances);
    if (deep) return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_RANGE, ZBUFRANDI_MAX_LEVELS,
                                    "more than % levels of instances");
    return ok ? ZBUFRAND_OK : zbufrandi_edit_no_memory(scene);
}

/* From here on nothing fails. */
static void zbufrandi_edit_apply(zbufrandi_edit *e) {
    zbufrand_scene *scene = e->scene;
    zbufrandi_graph *g = scene->graph;
    size_t i;
    uint32_t k;
    for (i = 0; i < scene->gone_count; i++) {
        const zbufrandi_gone *o = &scene->gone[i];
        zbufrandi_live_structure *l;
        if (o->home == 0) continue;
        l = &scene->live->s[o->home - 1];
        for (k = o->item; k < o->item + o->item_count; k++) {
            if (!o->clusters) {
                zbufrandi_edit_instance_free(scene, o->home - 1, k);
                continue;
            }
            zbufrandi_edit_take(scene, o->home - 1, k);
            l->dead_clusters++;
            l->dead_triangles += scene->structure[o->home - 1].cluster[k].triangle_count;
            l->dead_vertices += scene->structure[o->home - 1].cluster[k].vertex_count;
        }
    }
    for (i = 0; i < scene->gone_count; i++) { /* nothing has instances of them any more */
        const uint32_t index = scene->gone[i].structure - 1;
        if (scene->gone[i].structure == 0) continue;
        for (k = 0; k < scene->structure[index].instance_count; k++)
            if (scene->structure[index].instance[k].scale > 0.0) zbufrandi_use_unlink(scene, index, k);
        zbufrandi_edit_slot_free(scene, index);
    }
    for (i = 0; i < e->change_count; i++) {
        zbufrandi_edit_step *c = &e->change[i];
        if (c->item == ZBUFRANDI_NIL) {
            const int first = g[c->node].home == 0;
            c->item = zbufrandi_edit_instance_new(scene, c->home, &c->it, first && (i + 1 == e->change_count ||
                                                  e->change[i + 1].node != c->node));
            if (first) g[c->node].item = c->item;
            if (first) g[c->node].item_count = 0;
            g[c->node].home = c->home + 1;
            g[c->node].item_count++;
        } else {
            scene->structure[c->home].instance[c->item] = c->it;
        }
        zbufrandi_edit_raise(scene, c->home, scene->structure[c->it.structure].depth + 1);
        zbufrandi_edit_instance(scene, c->home, c->item);
        zbufrandi_edit_touch(scene, c->home);
    }
}

/* Structures that were made for nothing. */
static void zbufrandi_edit_undo(zbufrandi_edit *e, size_t made) {
    zbufrand_scene *scene = e->scene;
    zbufrandi_graph *g = scene->graph;
    size_t i, k;
    for (i = e->fresh.count; i > 0; i--) {
        const uint32_t index = g[e->fresh.v[i - 1]].structure - 1;
        uint32_t n;
        if (g[e->fresh.v[i - 1]].structure == 0) continue;
        g[e->fresh.v[i - 1]].structure = 0;
        for (n = 0; i - 1 < made && n < scene->structure[index].instance_count; n++)
            zbufrandi_use_unlink(scene, index, n);
        zbufrandi_edit_slot_free(scene, index);
    }
    for (k = 0; k < scene->graph_count; k++)
        if (g[k].home != 0 && !scene->live->s[g[k].home - 1].used) g[k].home = 0;
}

static zbufrand_result zbufrandi_edit_run(zbufrandi_edit *e) {
    zbufrand_scene *scene = e->scene;
    zbufrandi_graph *g = scene->graph;
    uint64_t skipped = 0;
    size_t i, made = 0;
    int below_new;
    zbufrand_result r = zbufrandi_edit_plan(e);
    for (i = 0; i < e->melted.count && r == ZBUFRAND_OK; i++) r = zbufrandi_edit_promote(e, e->melted.v[i]);
    /* before what is new is built: what was moved in that has its new place then, and nothing that stands for it */
    for (i = 0; i < scene->pending_count && r == ZBUFRAND_OK; i++) {
        const zbufrandi_pending *p = &scene->pending[i];
        if (!p->moved || g[p->node].kind == ZBUFRANDI_DEAD || g[p->node].home == 0) continue;
        if (zbufrandi_edit_home(scene, p->node, &below_new) == ZBUFRANDI_NIL) continue;
        r = zbufrandi_edit_node_changes(e, p->node, 1);
    }
    for (i = 0; i < e->fresh.count && r == ZBUFRAND_OK; i++) {
        const uint32_t slot = zbufrandi_edit_slot(scene);
        if (slot == ZBUFRANDI_NIL) r = zbufrandi_edit_no_memory(scene);
        else g[e->fresh.v[i]].structure = slot + 1;
    }
    while (made < e->fresh.count && r == ZBUFRAND_OK) {
        r = zbufrandi_edit_build(e, e->fresh.v[made], &skipped);
        if (r == ZBUFRAND_OK) made++;
    }
    for (i = 0; i < e->top.count && r == ZBUFRAND_OK; i++) r = zbufrandi_edit_node_changes(e, e->top.v[i], 0);
    for (i = 0; i < scene->set_count && r == ZBUFRAND_OK; i++) r = zbufrandi_edit_set_changes(e, &scene->set[i]);
    if (r == ZBUFRAND_OK) r = zbufrandi_edit_room(e);
    if (r == ZBUFRAND_OK) {
        zbufrandi_edit_apply(e);
        scene->skipped += skipped;
        zbufrandi_edits_forget(scene);
    } else {
        zbufrandi_edit_undo(e, made);
    }
    zbufrandi_edit_finish(scene);
    return r;
}

ZBUFRAND_DEF zbufrand_result zbufrand_scene_update(zbufrand_scene *scene, zbufrand_scene_info *info) {
    zbufrandi_edit e;
    zbufrand_result r = ZBUFRAND_OK;
    if (info != NULL) memset(info, 0, sizeof *info);
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    if (scene->structure_count == 0)
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_EMPTY, 0, "update: the scene is not built");
    if (scene->pending_count + scene->gone_count + scene->set_count != 0) {
        memset(&e, 0, sizeof e);
        e.scene = scene;
        zbufrandi_atomic_store(&scene->mem.peak, zbufrandi_atomic_load(&scene->mem.used));
        r = zbufrandi_live_open(scene) ? zbufrandi_edit_run(&e) : zbufrandi_edit_no_memory(scene);
        if (r == ZBUFRAND_OK || e.promoted) zbufrandi_scene_lists_free(scene); /* they know instances by their slots */
        zbufrandi_free(&scene->mem, e.stack);
        zbufrandi_free(&scene->mem, e.top.v);
        zbufrandi_free(&scene->mem, e.melted.v);
        zbufrandi_free(&scene->mem, e.fresh.v);
        zbufrandi_free(&scene->mem, e.change);
        zbufrandi_scene_totals(scene);
    }
    if (info != NULL && r == ZBUFRAND_OK) *info = scene->info;
    return r;
}

/* ---- edits ---- */

static zbufrand_result zbufrandi_edit_check(const zbufrand_scene *scene, uint32_t node, const zbufrand_transform *m) {
    zbufrand_error *e = scene->env.error;
    if (node == 0 || node >= scene->graph_count || scene->graph[node].kind == ZBUFRANDI_DEAD)
        return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, node, "node %: no such node");
    if (node == ZBUFRAND_ROOT)
        return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, node, "node %: the root stays where it is");
    if (m != NULL && zbufrandi_m34_scale(ZBUFRANDI_M34(m->m), ZBUFRANDI_SIMILAR) == 0.0)
        return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, node, "node %: the transform is no similarity");
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_move(zbufrand_scene *scene, zbufrand_node node,
                                           const zbufrand_transform *transform) {
    zbufrand_result r;
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    r = zbufrandi_edit_check(scene, node, transform);
    if (r != ZBUFRAND_OK) return r;
    if (!zbufrandi_pending_room(scene)) return zbufrandi_edit_no_memory(scene);
    if (scene->graph[node].parent != 0) zbufrandi_pending_add(scene, node, 1, ZBUFRANDI_M34(scene->graph[node].m));
    if (transform != NULL) memcpy(scene->graph[node].m, transform->m, sizeof transform->m);
    else zbufrandi_m34_identity(scene->graph[node].m);
    return ZBUFRAND_OK;
}

ZBUFRAND_DEF zbufrand_result zbufrand_set_reference(zbufrand_scene *scene, zbufrand_node node, size_t index,
                                                    const zbufrand_transform *transform) {
    zbufrandi_set *set;
    uint32_t home, first;
    zbufrand_result r;
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    r = zbufrandi_edit_check(scene, node, transform);
    if (r != ZBUFRAND_OK) return r;
    if (scene->graph[node].kind != ZBUFRANDI_REFERENCES || scene->graph[node].transforms == NULL ||
        index >= scene->graph[node].count || scene->structure_count == 0 ||
        !zbufrandi_edit_entries(scene, node, &home, &first)) {
        return zbufrandi_fail(scene->env.error, ZBUFRAND_ERR_INVALID_ARG, node,
                              "node %: not several references that are built, or not so many");
    }
    if (!zbufrandi_grow(&scene->mem, (void **)&scene->set, &scene->set_capacity, scene->set_count,
                        scene->set_count + 1, sizeof *scene->set)) return zbufrandi_edit_no_memory(scene);
    set = &scene->set[scene->set_count++];
    memset(set, 0, sizeof *set);
    set->node = node;
    set->index = (uint32_t)index;
    set->drawn = transform != NULL;
    if (transform != NULL) memcpy(set->m, transform->m, sizeof set->m);
    return ZBUFRAND_OK;
}

/* All nodes below `root`, hidden ones too; 0: no more. */
static uint32_t zbufrandi_below_next(const zbufrandi_graph *g, uint32_t root, uint32_t node) {
    if (g[node].kind == ZBUFRANDI_LIST && g[node].first != 0) return g[node].first;
    while (node != root && g[node].next == 0) node = g[node].parent;
    return node == root ? 0 : g[node].next;
}

ZBUFRAND_DEF zbufrand_result zbufrand_remove(zbufrand_scene *scene, zbufrand_node node) {
    zbufrandi_graph *g;
    zbufrand_error *e;
    zbufrand_result r;
    uint32_t k, next, mark;
    size_t count = 0;
    if (scene == NULL) return ZBUFRAND_ERR_INVALID_ARG;
    r = zbufrandi_edit_check(scene, node, NULL);
    if (r != ZBUFRAND_OK) return r;
    g = scene->graph;
    e = scene->env.error;
    mark = 4 + 2 * ++scene->stamp;
    for (k = node; k != 0; k = zbufrandi_below_next(g, node, k)) {
        if (++count > scene->graph_count)
            return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, node, "node %: lists in a ring");
        g[k].state = mark;
        g[k].levels = 0;
    }
    for (k = node; k != 0; k = zbufrandi_below_next(g, node, k))
        if (g[k].kind == ZBUFRANDI_REFERENCES && g[g[k].target].state == mark) g[g[k].target].levels++;
    for (k = node; k != 0; k = zbufrandi_below_next(g, node, k)) {
        if (g[k].refs > g[k].levels)
            return zbufrandi_fail(e, ZBUFRAND_ERR_INVALID_ARG, k, "node %: something still refers to it");
    }
    if (!zbufrandi_grow(&scene->mem, (void **)&scene->gone, &scene->gone_capacity, scene->gone_count,
                        scene->gone_count + count, sizeof *scene->gone)) return zbufrandi_edit_no_memory(scene);
    if (g[node].parent != 0) {
        zbufrandi_graph *list = &g[g[node].parent];
        if (g[node].prev != 0) g[g[node].prev].next = g[node].next;
        else list->first = g[node].next;
        if (g[node].next != 0) g[g[node].next].prev = g[node].prev;
        else list->last = g[node].prev;
    }
    for (k = node; k != 0; k = next) {
        zbufrandi_gone *o = &scene->gone[scene->gone_count++];
        next = zbufrandi_below_next(g, node, k);
        memset(o, 0, sizeof *o);
        o->node = k;
        o->home = g[k].home;
        o->item = g[k].item;
        o->item_count = g[k].item_count;
        o->structure = g[k].structure;
        o->clusters = g[k].kind == ZBUFRANDI_MESH && g[k].structure == 0;
        if (g[k].kind == ZBUFRANDI_MESH) o->mesh = g[k].target + 1;
        if (g[k].kind == ZBUFRANDI_REFERENCES) g[g[k].target].refs--;
        g[k].kind = ZBUFRANDI_DEAD;
        g[k].structure = g[k].home = 0;
    }
    if (scene->structure_count == 0) zbufrandi_edits_forget(scene);
    return ZBUFRAND_OK;
}

/* ---------------------------------------------------------------------------
   misc: names and versions.                                                     // >>misc
   --------------------------------------------------------------------------- */

ZBUFRAND_DEF const char *zbufrand_result_string(zbufrand_result result) {
    switch (result) {
#define ZBUFRANDI_X(name, value, text) case ZBUFRAND_##name: return text;
    ZBUFRAND_RESULT_LIST(ZBUFRANDI_X)
#undef ZBUFRANDI_X
    case ZBUFRAND_RESULT_FORCE_32BIT: break;
    }
    return "unknown result";
}

ZBUFRAND_DEF uint32_t zbufrand_version(void) { return ZBUFRAND_VERSION; }

ZBUFRAND_DEF const char *zbufrand_isa_name(zbufrand_isa isa) {
    switch (isa) {
    case ZBUFRAND_ISA_AUTO: return "auto";
    case ZBUFRAND_ISA_SCALAR: return "scalar";
    case ZBUFRAND_ISA_SSE: return "sse";
    case ZBUFRAND_ISA_AVX2: return "avx2";
    case ZBUFRAND_ISA_AVX512: return "avx512";
    case ZBUFRAND_ISA_FORCE_32BIT: break;
    }
    return "unknown";
}

ZBUFRAND_DEF zbufrand_isa zbufrand_isa_best(void) {
    int level = zbufrandi_cpu_level();
    if (level >= 3 && ZBUFRANDI_AVX2) return ZBUFRAND_ISA_AVX2;
    return level >= 2 ? ZBUFRAND_ISA_SSE : ZBUFRAND_ISA_SCALAR;
}

#ifdef __cplusplus
}
#endif
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC pop_options
#endif
#endif /* ZBUFRAND_IMPLEMENTATION */

/*
Choose either licence.

MIT License

Copyright (c) 2026 the zbufrand authors

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
